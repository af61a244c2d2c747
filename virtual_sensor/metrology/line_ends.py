"""Where a line ends, or an edge cuts it: columns that it covers in part, and those among them."""

import numpy as np
from numpy.typing import NDArray

from virtual_sensor.metrology.centres import Status, is_found
from virtual_sensor.metrology.line_profiles import Array, Index

STEP = 0.02  # relative drop of amplitude that betrays a partly lit column
_MOST = 2  # columns at each end
_BEYOND = _MOST + 1  # columns off the image that the search inward may touch
_FEW = 8  # centres in a row that are OK, between others: fewer are cut as those near them are
_NEAR, _FAR = 2 * _FEW, 6 * _FEW  # columns
_THIN = 0.6  # times the usual width
_SAME_LINE = (3.0, 2.0)  # px, and widths: so near lie peaks of one line in adjoining columns


def line_ends(
    lit: NDArray[np.bool_], row: Array, row_error: Array, width: Array, amplitude: Array
) -> NDArray[np.bool_]:
    """Find peaks, at most two at each end of a line, that the line only partly covers.

    There the centre is off by slope/2 times the missing part, and the amplitude is not what the
    two columns further in extrapolate to.

    Parameters
    ----------
    lit : ndarray of bool of shape (K, W)
        Where there is a peak, whether or not its centre was found; K peaks in each column.
    row, row_error, width, amplitude : ndarray of shape (K, W)
        NaN where the centre was not found.

    Returns
    -------
    ndarray of bool of shape (K, W)
    """
    ends = np.zeros(lit.shape, bool)
    if len(lit) == 1 and lit.all():
        return ends  # as most lines
    aside = ((0, 0), (_BEYOND, _BEYOND))
    lit = np.pad(lit, aside)
    amplitude, place, error, width = (
        np.pad(values, aside, constant_values=np.nan)
        for values in (amplitude, row, row_error, width)
    )
    # Noise moves the amplitude by about row_error/width of itself, its extrapolation by 3 times.
    noise = 10.0 * np.nan_to_num(error) / width
    ends = np.pad(ends, aside)
    for inward in (1, -1):
        outward = _next(lit, place, width, -inward)
        inner = _next(lit, place, width, inward)
        suspect = np.argwhere(lit & (outward < 0)).T
        at_edge = _BEYOND if inward > 0 else lit.shape[1] - 1 - _BEYOND
        suspect = suspect[:, suspect[1] != at_edge]
        for _ in range(_MOST):
            first = _followed(suspect, inner, inward)
            second = _followed(first, inner, inward)
            expected = 2.0 * _at(amplitude, first) - _at(amplitude, second)
            allowed = (STEP + _at(noise, first)) * expected
            whole = np.abs(_at(amplitude, suspect) - expected) <= allowed
            ends[tuple(suspect[:, ~whole])] = True
            suspect = first[:, ~whole & (first[0] >= 0)]
    return ends[:, _BEYOND:-_BEYOND]


def _next(lit: NDArray[np.bool_], row: Array, width: Array, step: int) -> Index:
    """Which peak of the adjoining column goes on with the same line: (K, W), -1: none."""
    beside = np.roll(lit, -step, axis=1)
    if len(lit) == 1:  # one peak a column: there is no other to mistake it for
        return np.where(lit & beside, 0, -1)
    apart = np.abs(np.roll(row, -step, axis=1)[None] - row[:, None])  # (K, its neighbours, W)
    apart = np.where(np.isfinite(apart) & beside[None], apart, np.inf)
    near = apart.min(axis=1) <= _SAME_LINE[0] + _SAME_LINE[1] * np.nan_to_num(width)
    return np.where(lit & near, apart.argmin(axis=1), -1)


def _followed(peaks: Index, towards: Index, step: int) -> Index:
    """The next peaks (rank, column) of each; (-1, column) where there is none."""
    rank, column = peaks
    there = np.where(rank >= 0, towards[rank, column], -1)
    return np.stack([there, np.clip(column + step, 0, towards.shape[1] - 1)])


def _at(values: Array, peaks: Index) -> Array:
    rank, column = peaks
    return np.where(rank >= 0, values[rank, column], np.nan)


def among_cuts(status: NDArray[np.integer], width: Array) -> NDArray[np.bool_]:
    """Centres (K, W) among cut ones, or between these and the line's end: they are cut as well.

    What is SKEWED between two that are CUT is so by the same edge.  A few that are found, or what
    is left of a line and much narrower than the rest, only seem to be whole.
    """
    cut = status == Status.CUT
    for line, widths, here in zip(status, width, cut, strict=True):
        if not here.any():
            continue
        for first, last in _runs(line == Status.SKEWED):
            here[first:last] = last - first <= _NEAR and here[[first - 1, last % line.size]].all()
        ok = is_found(line)
        thin = _THIN * np.median(widths[ok]) if ok.any() else 0.0
        for first, last in _runs(ok):
            narrow = np.median(widths[first:last]) < thin
            reach = _FAR if narrow else _NEAR
            near = here[max(first - reach, 0) : last + reach].sum() > 1
            here[first:last] = near and (narrow or last - first <= _FEW)
    return cut


def _runs(mask: NDArray[np.bool_]) -> Index:
    """First and behind the last of each run in a mask (W,): (N, 2)."""
    return np.flatnonzero(np.diff(mask, prepend=False, append=False)).reshape(-1, 2)
