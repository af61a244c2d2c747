"""Closed-form fields whose rays are known: the references of the ray march.

Each is given by n^2 in its own Dr.Jit expression and can stand wherever an `IndexField` can.  The
paths themselves are in `tests/oracles.py`, which shares no code with this module.
"""

from collections.abc import Callable
from dataclasses import dataclass, field
from typing import Any

import numpy as np

from virtual_sensor.display import place
from virtual_sensor.engine import dr, mi
from virtual_sensor.poses import Movable, Pose

NSquared = Callable[[Any], tuple[Any, Any, Any]]


@dataclass(frozen=True)
class ExactField(Movable):
    """A field given by n^2, its gradient and its Hessian at points, in vacuum.

    Attributes
    ----------
    n_squared : callable
        ``n_squared(p) -> (n^2, gradient in 1/mm, Hessian in 1/mm^2)`` for Dr.Jit points of the
        field's frame, in mm.
    box : ndarray of shape (2, 3)
        Where it is defined, in the field's frame; outside is vacuum.
    pose : Pose or None
        Of the field's frame; None: the world's.
    """

    n_squared: NSquared
    box: np.ndarray = field(default_factory=lambda: np.array([[-1e3] * 3, [1e3] * 3]))
    ambient: float = 0.0
    pose: Pose | None = None

    def _line(self) -> str:
        low, high = self.box
        return f"of a formula, from {place(low)} to {place(high)} mm"

    def lookup(self, precision: str) -> "ExactField":
        """Itself: an expression has no precision of its own."""
        return self

    def delta_and_gradient(self, p: Any) -> tuple[Any, Any]:
        """Refractivity n - 1 and grad n = grad(n^2) / 2n."""
        value, gradient, _ = self.n_squared(p)
        n = dr.sqrt(value)
        return (value - 1.0) / (n + 1.0), gradient / (2.0 * n)

    def delta_gradient_hessian(self, p: Any) -> tuple[Any, Any, Any]:
        """As above, with the Hessian of n."""
        value, gradient, hessian = self.n_squared(p)
        n = dr.sqrt(value)
        g = gradient / (2.0 * n)
        outer = type(hessian)(*[[g[i] * g[j] for j in range(3)] for i in range(3)])
        return (value - 1.0) / (n + 1.0), g, (hessian * 0.5 - outer) / n


def _matrix(p: Any) -> Any:
    return mi.Matrix3f if type(p) in (mi.Array3f, mi.Vector3f, mi.Point3f) else mi.Matrix3f64


def linear(n0: float, gradient: tuple[float, float, float], **where: Any) -> ExactField:
    """n^2 = n0^2 + g . r: parabolas."""

    def n_squared(p: Any) -> tuple[Any, Any, Any]:
        g = type(p)(*gradient)
        return n0**2 + dr.dot(g, p), g, dr.zeros(_matrix(p))

    return ExactField(n_squared, **where)


def selfoc(n0: float, a_per_mm: float, **where: Any) -> ExactField:
    """n^2 = n0^2 (1 - a^2 (y^2 + z^2)): a fibre along x, whose rays swing harmonically."""

    def n_squared(p: Any) -> tuple[Any, Any, Any]:
        k = (n0 * a_per_mm) ** 2
        across = type(p)(0.0, p.y, p.z)
        curvature = dr.diag(type(p)(0.0, -2.0 * k, -2.0 * k))
        return n0**2 - k * dr.squared_norm(across), across * (-2.0 * k), _matrix(p)(curvature)

    return ExactField(n_squared, **where)


def fish_eye(n0: float, a_mm: float, **where: Any) -> ExactField:
    """Maxwell's n = n0 / (1 + r^2/a^2): circles; a ray from r0 meets -a^2 r0/|r0|^2."""

    def n_squared(p: Any) -> tuple[Any, Any, Any]:
        u = 1.0 + dr.squared_norm(p) / a_mm**2
        value = (n0 / u) ** 2
        slope = -4.0 * value / (u * a_mm**2)
        outer = _outer(p) * (24.0 * value / (u * a_mm**2) ** 2)
        return value, p * slope, outer + dr.identity(_matrix(p)) * slope

    return ExactField(n_squared, **where)


def luneburg(radius_mm: float, **where: Any) -> ExactField:
    """n^2 = 2 - r^2/R^2: ellipses."""

    def n_squared(p: Any) -> tuple[Any, Any, Any]:
        k = -2.0 / radius_mm**2
        return 2.0 - dr.squared_norm(p) / radius_mm**2, p * k, dr.identity(_matrix(p)) * k

    return ExactField(n_squared, **where)


def hot_spot(depth: float, width_mm: float, **where: Any) -> ExactField:
    """n^2 = 1 - depth exp(-r^2/2w^2): a soft ball of hot air; Bouguer's r x T is conserved."""

    def n_squared(p: Any) -> tuple[Any, Any, Any]:
        w2 = width_mm**2
        dip = depth * dr.exp(-dr.squared_norm(p) / (2.0 * w2))
        hessian = (dr.identity(_matrix(p)) - _outer(p) * (1.0 / w2)) * (dip / w2)
        return 1.0 - dip, p * (dip / w2), hessian

    return ExactField(n_squared, **where)


def _outer(p: Any) -> Any:
    return _matrix(p)(*[[p[i] * p[j] for j in range(3)] for i in range(3)])
