"""Where the columns of a frame see a laser's sheet, by the sheet's coordinate in each pixel.

`across_mm`, an image (H, W), is the coordinate across the sheet of the light that each pixel sees;
NaN where none is.
"""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

Array = NDArray[np.float64]
Index = NDArray[np.intp]
Mask = NDArray[np.bool_]

_PROFILE = 1.5  # seen out to so many 1/e^2 radii on both sides, the profile is whole


def _jump(across_mm: NDArray[np.floating], radius_mm: float) -> float:
    """The step of a between two pixels, mm, from which on it is an edge: on a coarse film more."""
    steps = np.abs(np.diff(across_mm, axis=0))
    known = steps[np.isfinite(steps)]
    return max(radius_mm, 2.0 * float(np.median(known))) if known.size else radius_mm


def _lit(across_mm: NDArray[np.floating]) -> tuple[int, NDArray[np.floating]]:
    """The rows that see light, from which on; a dark one on each side stands for those beyond."""
    light = np.flatnonzero(np.isfinite(across_mm).any(axis=1))
    if not light.size:
        return 0, across_mm[:0]
    top = max(int(light[0]) - 1, 0)
    return top, across_mm[top : light[-1] + 2]


def crossings(across_mm: NDArray[np.floating], radius_mm: float) -> tuple[Index, Index, Array]:
    """Where columns see the sheet's middle: the pixel before, the column, the row; (L,) each.

    The row is that of a cubic through the four pixels about it, or of a line through two.
    """
    top, across_mm = _lit(across_mm)
    upper, lower, jump = across_mm[:-1], across_mm[1:], _jump(across_mm, radius_mm)
    near = np.abs(lower - upper) < jump
    number, column = np.nonzero((np.signbit(upper) != np.signbit(lower)) & near)
    a = across_mm[(number + np.arange(-1, 3)[:, None]).clip(0, len(across_mm) - 1), column]
    a = a.astype(float)
    place = number + a[1] / (a[1] - a[2])
    steps = np.diff(a, axis=0)
    smooth = (number >= 1) & (number + 2 < len(across_mm))
    smooth &= (np.abs(steps) < jump).all(axis=0)
    smooth &= (steps > 0.0).all(axis=0) | (steps < 0.0).all(axis=0)
    a = a[:, smooth]
    cubic = np.zeros(a.shape[1])  # v as a polynomial of a, at a = 0, by Lagrange
    for i in range(4):
        others = [j for j in range(4) if j != i]
        weight = np.prod([a[j] / (a[j] - a[i]) for j in others], axis=0)
        cubic += weight * (number[smooth] + i - 1)
    place[smooth] = cubic
    return number + top, column, place + top


def sees_whole_profile(row: Array, across_mm: NDArray[np.floating], radius_mm: float) -> Mask:
    """Whether rows (K, W) see the profile from edge to edge, on one part of the surface."""
    known = np.isfinite(row)
    first, last = run_of(row, across_mm, radius_mm)
    column = np.arange(across_mm.shape[1])
    a = np.stack([across_mm[first, column], across_mm[last, column]])
    reach = _PROFILE * radius_mm
    return known & (a.min(axis=0) < -reach) & (a.max(axis=0) > reach)


def run_of(row: Array, across_mm: NDArray[np.floating], radius_mm: float) -> tuple[Index, Index]:
    """The first and the last pixel (K, W) of the part of a surface that rows (K, W) see lit.

    Both are 0 where a row is NaN.
    """
    known = np.isfinite(row)
    top, lit_mm = _lit(across_mm)
    if not lit_mm.size:
        return np.zeros(row.shape, int), np.zeros(row.shape, int)
    middle = np.where(known, np.rint(row) - top, 0).astype(int).clip(0, len(lit_mm) - 1)
    column = np.arange(lit_mm.shape[1])
    number = np.arange(len(lit_mm))[:, None]
    # A pixel starts a new part where there was no light before, or that of another place.
    starts = np.ones(lit_mm.shape, bool)
    starts[1:] = ~(np.abs(np.diff(lit_mm, axis=0)) < _jump(lit_mm, radius_mm))
    ends = np.ones(lit_mm.shape, bool)
    ends[:-1] = starts[1:]
    first = np.maximum.accumulate(np.where(starts, number, 0), axis=0)[middle, column]
    backwards = np.where(ends, number, len(lit_mm) - 1)[::-1]
    last = np.minimum.accumulate(backwards, axis=0)[::-1][middle, column]
    return np.where(known, first + top, 0), np.where(known, last + top, 0)
