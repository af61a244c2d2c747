"""A field's nodes in Dr.Jit: value, gradient and Hessian between them, cubic and linear.

Positions are those of the field's frame, *inside the box*, mm, in vectors of the lookup's precision
(`mi.Array3f64` for double, `mi.Vector3f` or the like for single). The methods only trace, so
symbolic loops may call them; the derivatives cannot themselves be differentiated.
"""

from __future__ import annotations

import copy
import math
from collections.abc import Callable, Sequence
from dataclasses import dataclass
from itertools import product
from typing import Any

import numpy as np

from virtual_sensor.arrays import in_own_memory
from virtual_sensor.engine import dr, mi
from virtual_sensor.errors import InputError
from virtual_sensor.medium.spline import bspline_coefficients

MOST_PACKED = 2**25
"""Coefficients up to which a lookup takes four times their memory: half a GB in float32."""

_BEYOND = 3  # cells at the border


class GridLookup:
    """Derivatives at points: sums of the coefficients around each, with a spline's weights.

    The coefficients along the last axis are read by one load: they are stored side by side for each
    cell, which, of four, takes four times the memory and halves the time.

    Parameters
    ----------
    difference : ndarray of shape (nx, ny, nz), or (ny, nz)
        n - n_ambient at the nodes.
    origin, spacing : ndarray of shape (3,)
        Position of the first node and distance of nodes, mm.
    mirror : sequence of three bool
        The field is even about the plane through an axis's first node.
    axes : tuple of int
        Axes of `difference`; the field does not vary along the one that is left out.
    interpolation : str
        A key of `SPLINES`.
    precision : str
        "single" or "double".
    """

    def __init__(
        self,
        difference: np.ndarray,
        origin: np.ndarray,
        spacing: np.ndarray,
        mirror: Sequence[bool],
        axes: tuple[int, ...],
        interpolation: str,
        precision: str,
    ) -> None:
        if precision not in ("single", "double"):
            raise InputError(f"precision '{precision}': give 'single' or 'double'")
        double = precision == "double"
        self._scalar = mi.Float64 if double else mi.Float
        self._vector = mi.Array3f64 if double else mi.Array3f
        self._matrix = mi.Matrix3f64 if double else mi.Matrix3f
        flat = mi.Array2f64 if double else mi.Array2f
        self._grid_vector = self._vector if len(axes) == 3 else flat
        self._axes = axes
        self._mirror = [mirror[i] for i in axes]
        self._spline = spline = SPLINES[interpolation]
        four = mi.Array4f64 if double else mi.Array4f
        self._packet = {2: flat, 4: four}[spline.count]

        coefficients, before = spline.coefficients(difference, self._mirror)
        shape, size = coefficients.shape, coefficients.size
        self._coefficients = in_own_memory(coefficients, self._scalar)
        self._packed = size <= MOST_PACKED
        if self._packed:
            i = dr.arange(mi.UInt32, spline.count * size)
            each = (i >> (spline.count.bit_length() - 1)) + (i & (spline.count - 1))
            each = dr.minimum(each, dr.opaque(mi.UInt32, size - 1))
            self._coefficients = dr.gather(self._scalar, self._coefficients, each)
            dr.eval(self._coefficients)

        # Opaque: one kernel for any grid.
        self._strides = [
            dr.opaque(mi.UInt32, math.prod(shape[axis + 1 :])) for axis in range(len(shape))
        ]
        self._last = [dr.opaque(mi.UInt32, count - spline.count) for count in shape]
        self._end = self._opaque(np.array(shape) - spline.count + 1)
        self._first = self._opaque(np.array(before))
        # Of axes that it does not vary along: no literal, which loops would take for a constant.
        self._zero = dr.opaque(self._scalar, 0.0)
        self._put(origin, spacing)

    def _put(self, origin: np.ndarray, spacing: np.ndarray) -> None:
        self._scale = self._opaque(1.0 / spacing[list(self._axes)])
        self._origin = self._opaque(origin[list(self._axes)])

    @staticmethod
    def sum_of(
        parts: Sequence[tuple[float, GridLookup]], origin: np.ndarray, spacing: np.ndarray
    ) -> GridLookup:
        """Weighted sum of lookups of alike nodes, on a grid of this origin and spacing.

        A spline's coefficients are linear in its nodes: they need not be found again.
        """
        first = copy.copy(parts[0][1])
        first._put(origin, spacing)
        if [weight for weight, _ in parts] != [1.0]:
            first._coefficients = sum(
                each._coefficients * dr.opaque(first._scalar, weight) for weight, each in parts
            )
            dr.eval(first._coefficients)
        return first

    def delta(self, p: Any) -> Any:
        """Return n - n_ambient at `p`."""
        along, _ = self._derivatives(p, 0)
        return along[self._order()]

    def delta_and_gradient(self, p: Any) -> tuple[Any, Any]:
        """Return n - n_ambient and its gradient, 1/mm, in a vector of `p`'s type."""
        along, scale = self._derivatives(p, 1)
        gradient = [along[self._order(i)] for i in range(len(self._axes))]
        return along[self._order()], self._in_world(p, gradient, scale)

    def delta_gradient_hessian(self, p: Any) -> tuple[Any, Any, Any]:
        """Return n - n_ambient, its gradient (1/mm) and its 3 x 3 Hessian matrix (1/mm^2)."""
        along, scale = self._derivatives(p, 2)
        axes = range(len(self._axes))
        gradient = [along[self._order(i)] for i in axes]
        hessian = self._matrix(0.0)  # the corner of it that the axes take
        for i, j in product(axes, repeat=2):
            hessian[i, j] = along[self._order(i, j)]
        in_world = self._in_world(p, gradient, scale)
        return along[self._order()], in_world, self._matrix_in_world(hessian, scale)

    def _order(self, *by: int) -> tuple[int, ...]:
        """Orders along each axis of a derivative by these axes."""
        return tuple(by.count(axis) for axis in range(len(self._axes)))

    def _derivatives(self, p: Any, most: int) -> tuple[dict[tuple[int, ...], Any], Any]:
        """Derivatives by grid coordinates, by their orders, and those by the field's of these."""
        u, scale = self._on_grid(p)
        cell = [dr.minimum(mi.UInt32(x), last) for x, last in zip(u, self._last, strict=True)]
        within = [x - self._scalar(i) for x, i in zip(u, cell, strict=True)]
        first = sum(i * stride for i, stride in zip(cell, self._strides, strict=True))
        *across, last = (self._spline.weights(t) for t in within)
        rows = contracted(self._row, first, self._strides, across, most)
        # Those along the last axis are contracted last: twice as fast as first.
        along = {
            (*orders, order): dr.dot(row, self._packet(*last[order]))
            for orders, row in rows.items()
            for order in range(most - sum(orders) + 1)
        }
        return along, scale

    def _row(self, first: Any) -> Any:
        """Coefficients side by side."""
        if self._packed:
            return dr.gather(self._packet, self._coefficients, first)
        places = (first + i for i in range(self._spline.count))
        return self._packet(*(dr.gather(self._scalar, self._coefficients, i) for i in places))

    def _opaque(self, numbers: np.ndarray) -> Any:
        """Numbers for the axes, which compile no kernel of their own."""
        return dr.opaque(self._grid_vector(*np.asarray(numbers, dtype=np.float64).tolist()))

    def _on_grid(self, p: Any) -> tuple[Any, Any]:
        """Coordinates among the coefficients, and their derivative by the world coordinates."""
        q = self._vector(p)
        q = self._grid_vector(*(q[i] for i in self._axes)) - self._origin
        scale = self._grid_vector(self._scale)
        for i, even in enumerate(self._mirror):
            if even:
                scale[i] = dr.mulsign(scale[i], q[i])
        return dr.clip(dr.fma(q, scale, self._first), 0.0, self._end), scale

    def _in_world(self, p: Any, gradient: Any, scale: Any) -> Any:
        """Gradient by world coordinates, in a vector of `p`'s type."""
        world = [self._zero] * 3
        for i, axis in enumerate(self._axes):
            world[axis] = gradient[i] * scale[i]
        return type(p)(*world)

    def _matrix_in_world(self, hessian: Any, scale: Any) -> Any:
        rows = [[self._zero] * 3 for _ in range(3)]
        for (i, row), (j, column) in product(enumerate(self._axes), repeat=2):
            rows[row][column] = hessian[i, j] * scale[i] * scale[j]
        return self._matrix(rows)


def contracted(
    read: Callable[[Any], Any], first: Any, strides: Sequence[Any], weights: list[Any], most: int
) -> dict[tuple[int, ...], Any]:
    """Sums of coefficients with a spline's weights: derivatives at a point, of `most` at most.

    Parameters
    ----------
    read : callable
        Gives the coefficients, numbers or vectors, at an index.
    first : int
        Index of the first coefficient along each axis.
    strides : sequence of int
        From one coefficient to the next along each axis.
    weights : list
        As of `cubic_weights`, along each axis.

    Returns
    -------
    dict
        By the derivatives' order along each axis.
    """
    if not weights:
        return {(): read(first)}
    across, *rest = weights
    sums: dict[tuple[int, ...], Any] = {}
    for number in range(len(across[0])):
        row = first + number * strides[0]
        for orders, part in contracted(read, row, strides[1:], rest, most).items():
            for order in range(most - sum(orders) + 1):
                key, weight = (order, *orders), across[order][number]
                sums[key] = dr.fma(part, weight, sums[key]) if key in sums else part * weight
    return sums


def cubic_weights(t: Any) -> tuple[list[Any], list[Any], list[Any]]:
    """Of four coefficients for the value, slope and curvature of a cubic B-spline, t in [0, 1]."""
    s = 1.0 - t
    t2, s2 = t * t, s * s
    value = [
        s2 * s * (1 / 6),
        dr.fma(t2, dr.fma(t, 0.5, -1.0), 2 / 3),
        dr.fma(s2, dr.fma(s, 0.5, -1.0), 2 / 3),
        t2 * t * (1 / 6),
    ]
    slope = [-0.5 * s2, t * dr.fma(t, 1.5, -2.0), -s * dr.fma(s, 1.5, -2.0), 0.5 * t2]
    curvature = [s, dr.fma(t, 3.0, -2.0), dr.fma(s, 3.0, -2.0), t]
    return value, slope, curvature


def linear_weights(t: Any) -> tuple[list[Any], list[Any], list[Any]]:
    """Of two values for those in between, their slope and their curvature; t in [0, 1]."""
    return [1.0 - t, t], [-1.0, 1.0], [0.0, 0.0]


def _of_cubic(nodes: np.ndarray, mirror: Sequence[bool]) -> tuple[np.ndarray, list[int]]:
    """Coefficients, constant from three cells beyond the border: all four are then the last one."""
    beyond = [(0 if even else _BEYOND, _BEYOND) for even in mirror]
    padded = np.pad(bspline_coefficients(nodes, mirror), beyond, mode="edge")
    return padded, [low for low, _ in beyond]


def _of_linear(nodes: np.ndarray, mirror: Sequence[bool]) -> tuple[np.ndarray, list[int]]:
    """The nodes are their own coefficients."""
    return nodes, [0] * nodes.ndim


@dataclass(frozen=True)
class Spline:
    """An interpolation between nodes.

    Attributes
    ----------
    count : int
        Coefficients along each axis that a value is made of: 2 or 4.
    coefficients : callable
        Of the nodes, and how many of them lie before the first node's along each axis.
    weights : callable
        Of the coefficients around a place t in [0, 1] of a cell, for value, slope and curvature.
    """

    count: int
    coefficients: Callable[[np.ndarray, Sequence[bool]], tuple[np.ndarray, list[int]]]
    weights: Callable[[Any], tuple[list[Any], list[Any], list[Any]]]


SPLINES = {
    "cubic": Spline(4, _of_cubic, cubic_weights),
    "linear": Spline(2, _of_linear, linear_weights),
}
"""By the name of the interpolation.

Cubic: continuous up to the second derivative. Linear along each axis: continuous, with a gradient
that jumps, and a Hessian of mixed derivatives only.
"""
