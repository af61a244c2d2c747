"""Coefficients of the cubic B-spline that passes through values on a regular grid."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np
from scipy.linalg import solve_banded

MIN_NODES = 4  # not-a-knot ends take four nodes


def bspline_coefficients(values: np.ndarray, even_start: Sequence[bool]) -> np.ndarray:
    """Coefficients of the interpolating tensor-product cubic B-spline.

    Parameters
    ----------
    values : ndarray of shape (n0, n1, ...)
        Values at the nodes, at least `MIN_NODES` along each axis.
    even_start : sequence of bool, one per axis
        True: the spline is even about the axis's first node. Other ends are "not-a-knot": the first
        two cells share one cubic, which keeps the fourth order of accuracy up to the border.

    Returns
    -------
    ndarray of shape (n0 + 2, n1 + 2, ...)
        Coefficient i + 1 belongs to node i: (c[i] + 4 c[i+1] + c[i+2]) / 6 = f[i] along each axis.
    """
    for axis, even in enumerate(even_start):
        along = np.moveaxis(values, axis, 0)
        solved = _along_first_axis(along.reshape(len(along), -1), even)
        values = np.moveaxis(solved.reshape(-1, *along.shape[1:]), 0, axis)
    return values


def _along_first_axis(f: np.ndarray, even: bool) -> np.ndarray:
    """`bspline_coefficients` along the first of two axes."""
    n = len(f)
    first = 0 if even else 1  # the first node whose coefficient the band matrix finds

    band = np.array([1.0, 4.0, 1.0])[:, None] * np.ones(n - 1 - first)
    right = 6.0 * f[first : n - 1]
    if even:
        band[0, 1] = 2.0  # c[-1] = c[1] about the plane
    else:
        # Equal third derivatives either side of node 1 make its coefficient explicit.
        band[1, 0], band[0, 1] = 1.0, 0.0
        right[0] = (8.0 * f[1] - f[0] - f[2]) / 6.0
    band[1, -1], band[2, -2] = 1.0, 0.0
    right[-1] = (8.0 * f[n - 2] - f[n - 1] - f[n - 3]) / 6.0

    c = np.empty((n + 2, f.shape[1]))
    c[first + 1 : n] = solve_banded((1, 1), band, right, overwrite_b=True, check_finite=False)
    if even:
        c[0] = c[2]
    else:
        c[1] = 6.0 * f[1] - 4.0 * c[2] - c[3]
        c[0] = 6.0 * f[0] - 4.0 * c[1] - c[2]
    c[n] = 6.0 * f[n - 2] - 4.0 * c[n - 1] - c[n - 2]
    c[n + 1] = 6.0 * f[n - 1] - 4.0 * c[n] - c[n - 1]
    return c
