"""Grids made ready for hand-written lookups: without a line of the program's own splines."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray
from problem import Grid
from scipy.interpolate import make_interp_spline

Array = NDArray[np.float64]


def spline_coefficients(grid: Grid) -> tuple[Array, Array]:
    """Coefficients of the not-a-knot spline on uniform knots, two more than nodes along each axis.

    Also the place of node 0.
    """
    values, origin = grid.unfolded()
    for axis in range(3):
        count = values.shape[axis]
        spline = make_interp_spline(np.arange(count), np.moveaxis(values, axis, 0), k=3)
        # In uniform B-splines: c[i-1] + 4 c[i] + c[i+1] = 6 f, and f'' = c[i-1] - 2 c[i] + c[i+1].
        at = np.arange(count)
        f, bend = spline(at), spline(at, 2)
        middle = f - bend / 6.0
        first = 6.0 * f[:1] - 4.0 * middle[:1] - middle[1:2]
        last = 6.0 * f[-1:] - 4.0 * middle[-1:] - middle[-2:-1]
        values = np.moveaxis(np.concatenate([first, middle, last]), 0, axis)
    return np.ascontiguousarray(values), origin


def linear_nodes(grid: Grid) -> tuple[Array, Array]:
    """Index and its gradient by differences at the nodes, (nx, ny, nz, 4); the place of node 0."""
    values, origin = grid.unfolded()
    return np.stack([values, *np.gradient(values, *grid.spacing)], axis=-1), origin
