"""Rays that are known without the program: closed forms, and SciPy's integrator.

Imports nothing of the project, so that no mistake can stand on both sides of a test.  Fish-eye:
Born and Wolf, Principles of Optics, section 4.2.2; fields whose n^2 is linear or quadratic: their
rays are the paths of a stone and of a spring.
"""

from collections.abc import Callable, Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import ArrayLike, NDArray
from scipy.integrate import quad, solve_ivp
from scipy.interpolate import NdBSpline, make_interp_spline
from scipy.optimize import brentq

Array = NDArray[np.float64]
Index = Callable[[Array], tuple[Array, Array]]
"""Points (N, 3) in mm to n (N,) and grad n (N, 3) in 1/mm."""


@dataclass(frozen=True)
class Path:
    """A ray as closed forms of t in mm, where dt = ds / n.

    Attributes
    ----------
    position, tangent, optical_path : callable
        r(t) in mm, T(t) = n dr/ds, and the integral of n ds from 0 to t in mm.
    """

    position: Callable[[float], Array]
    tangent: Callable[[float], Array]
    optical_path: Callable[[float], float]

    def arc(self, t: float) -> float:
        """Arc length from 0 to t, the integral of |T| dt."""
        return quad(lambda u: np.linalg.norm(self.tangent(u)), 0, t, epsabs=1e-12, epsrel=1e-13)[0]

    def t_at_arc(self, length_mm: float) -> float:
        """Value of t after an arc length, for n between 1/10 and 10."""
        return brentq(lambda t: self.arc(t) - length_mm, 0.0, 10.0 * length_mm, xtol=1e-13)


def linear(n0: float, gradient: ArrayLike, start: ArrayLike, direction: ArrayLike) -> Path:
    """n^2 = n0^2 + g . r: a parabola."""
    g, r0 = np.asarray(gradient, float), np.asarray(start, float)
    n2 = n0**2 + g @ r0
    T0 = np.sqrt(n2) * unit(direction)
    return Path(
        lambda t: r0 + T0 * t + g * t**2 / 4,
        lambda t: T0 + g * t / 2,
        lambda t: n2 * t + g @ T0 * t**2 / 2 + g @ g * t**3 / 12,
    )


def parabolic(n0: float, omega: ArrayLike, start: ArrayLike, direction: ArrayLike) -> Path:
    """n^2 = n0^2 - sum of (omega_i x_i)^2: an oscillation along each axis.

    A selfoc fibre has omega = n0 a across it; a Luneburg lens n0^2 = 2 and omega = 1/R.
    """
    w, r0 = np.asarray(omega, float), np.asarray(start, float)
    T0 = np.sqrt(n0**2 - np.sum((w * r0) ** 2)) * unit(direction)

    def position(t: float) -> Array:
        return r0 * np.cos(w * t) + T0 * t * np.sinc(w * t / np.pi)

    def tangent(t: float) -> Array:
        return T0 * np.cos(w * t) - r0 * w * np.sin(w * t)

    def optical_path(t: float) -> float:
        # d(r . T)/dt = 2 n^2 - n0^2, by |T| = n.
        return float(n0**2 * t + position(t) @ tangent(t) - r0 @ T0) / 2

    return Path(position, tangent, optical_path)


def fish_eye(
    n0: float, a_mm: float, start: ArrayLike, direction: ArrayLike, length_mm: float
) -> tuple[Array, Array, float]:
    """Maxwell's n = n0 / (1 + r^2/a^2): the circle through r0 and its image -a^2 r0/|r0|^2.

    Returns
    -------
    position, direction, optical path
        After an arc of `length_mm`, not beyond the image.  The optical path is n0 a / 2 times the
        angle on the unit sphere whose stereographic projection the fish-eye is.
    """
    r0, d = np.asarray(start, float), unit(direction)
    chord = -r0 * (1.0 + a_mm**2 / (r0 @ r0))
    normal = unit(chord - d * (chord @ d))
    radius = chord @ chord / (2.0 * chord @ normal)
    turn = length_mm / radius
    position = r0 + radius * (d * np.sin(turn) + normal * (1.0 - np.cos(turn)))
    here, there = _on_sphere(r0 / a_mm), _on_sphere(position / a_mm)
    angle = 2.0 * np.arctan2(np.linalg.norm(there - here), np.linalg.norm(there + here))
    return position, d * np.cos(turn) + normal * np.sin(turn), n0 * a_mm / 2.0 * angle


def _on_sphere(p: Array) -> Array:
    """Inverse stereographic projection."""
    return np.append(2.0 * p, p @ p - 1.0) / (p @ p + 1.0)


def unit(v: ArrayLike) -> Array:
    """Vectors (..., 3) scaled to length 1."""
    v = np.asarray(v, float)
    return v / np.linalg.norm(v, axis=-1, keepdims=True)


@dataclass(frozen=True)
class Integrated:
    """Rays (N) integrated by SciPy, as functions of arc length: what they deviate from straight."""

    starts: Array
    directions: Array
    deviation: Callable[[float], Array]

    def position(self, length_mm: float) -> Array:
        """World positions (N, 3) after an arc."""
        straight = self.starts + length_mm * self.directions
        return straight + self.deviation(length_mm).reshape(7, -1)[:3].T

    def direction(self, length_mm: float) -> Array:
        """Unit directions (N, 3) after an arc."""
        return unit(self.directions + self.deviation(length_mm).reshape(7, -1)[3:6].T)

    def optical_path(self, length_mm: float) -> Array:
        """Integrals (N,) of n ds."""
        return length_mm + self.deviation(length_mm).reshape(7, -1)[6]

    def arcs_to(self, distance: Callable[[Array], Array], low: float, high: float) -> Array:
        """Arc lengths (N,) between two bounds where distance(positions) (N,) changes sign."""
        return np.array(
            [
                brentq(lambda s, i=i: distance(self.position(s))[i], low, high, xtol=1e-12)
                for i in range(len(self.starts))
            ]
        )


def integrate(
    index: Index, starts: ArrayLike, directions: ArrayLike, length_mm: float, rtol: float = 1e-11
) -> Integrated:
    """Solve d/ds (n dr/ds) = grad n by Dormand and Prince's method of order 8, all rays at once."""
    r0, d = np.atleast_2d(np.asarray(starts, float)), unit(np.atleast_2d(directions))

    def slope(s: float, deviation: Array) -> Array:
        offset, tau = deviation.reshape(7, -1)[:3].T, deviation.reshape(7, -1)[3:6].T
        n, gradient = index(r0 + s * d + offset)
        bend = (d + tau) / n[:, None] - d
        return np.concatenate([bend.T.ravel(), gradient.T.ravel(), n - 1.0])

    start = np.concatenate([0.0 * r0.T, (index(r0)[0] - 1.0) * d.T, np.zeros((1, len(r0)))])
    solution = solve_ivp(
        slope, (0.0, length_mm), start.ravel(), "DOP853", dense_output=True, rtol=rtol, atol=rtol
    )
    return Integrated(r0, d, solution.sol)


def spline_index(
    refractivity: Array, origin_mm: Array, spacing_mm: Array, mirror: Sequence[bool]
) -> Index:
    """SciPy's not-a-knot cubic spline through the nodes of a field, unfolded at mirror planes."""
    knots, values = [], np.asarray(refractivity, float)
    for axis, (first, step, even) in enumerate(zip(origin_mm, spacing_mm, mirror, strict=True)):
        if even:
            image = np.flip(values.take(range(1, values.shape[axis]), axis), axis)
            first -= step * image.shape[axis]
            values = np.concatenate([image, values], axis)
        x = first + step * np.arange(values.shape[axis])
        spline = make_interp_spline(x, np.moveaxis(values, axis, 0), k=3)
        knots.append(spline.t)
        values = np.moveaxis(spline.c, 0, axis)
    spline = NdBSpline(tuple(knots), values, k=3)

    def index(p: Array) -> tuple[Array, Array]:
        gradient = np.stack([spline(p, nu=nu) for nu in np.eye(3, dtype=int)], axis=-1)
        return 1.0 + spline(p), gradient

    return index
