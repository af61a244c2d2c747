"""Where a line goes on by its unclipped neighbours: what a clipped centre is held against.

Where something as bright as a spark touches a line, one plateau covers both.  Its middle is not the
line's, and its flanks do not tell: the columns on either side do, where the line is not clipped.
What lies along the line to a tenth of its width is not seen so.
"""

import numpy as np
from numpy.lib.stride_tricks import sliding_window_view
from numpy.typing import NDArray

from virtual_sensor.metrology.line_profiles import Array, Index

Mask = NDArray[np.bool_]

_FIT = 12  # columns that tell where a line leads, and how steeply
_FAR = 64  # columns: as far as that
_SURE = 3.0  # standard errors
_LEAST_PX = 0.05  # by which a straight line may err
_HIDDEN = 3.0  # widths from a plateau's middle: so far it covers another line


def off_the_line(row: Array, clear: Mask, clipped: Index, width: Array) -> Array:
    """How far clipped centres are from where their neighbours lead, beyond doubt: px, (L,).

    0 where that is not known, as in a line that is clipped nearly everywhere.

    Parameters
    ----------
    row : ndarray of shape (W,)
        Of a line's centres.
    clear : ndarray of bool of shape (W,)
        Those that are OK.
    clipped : ndarray of int of shape (L,)
        Columns of those that are clipped,
    width : ndarray of shape (L,)
        and of a Gaussian as broad as their plateaus with their flanks: what leads beyond these
        is another part of the line, as behind a step.
    """
    column = np.flatnonzero(clear)
    if column.size < _FIT:
        return np.zeros(clipped.size)
    x, y = (sliding_window_view(values, _FIT) for values in (column.astype(float), row[column]))
    middle, height = x.mean(axis=1), y.mean(axis=1)
    away = x - middle[:, None]
    squares = (away**2).sum(axis=1)
    slope = (away * y).sum(axis=1) / squares
    left = y - height[:, None] - slope[:, None] * away
    variance = (left**2).sum(axis=1) / (_FIT - 2)
    after = np.searchsorted(column, clipped)  # the first clear one behind each
    places, doubts, ends = [], [], []
    for first, end in ((after - _FIT, -1), (after, 0)):
        at = np.clip(first, 0, middle.size - 1)
        far = clipped - middle[at]
        known = (first == at) & (np.abs(clipped - x[at, end]) <= _FAR)
        places.append(np.where(known, height[at] + slope[at] * far, np.nan))
        doubts.append(np.sqrt(variance[at] * (1.0 / _FIT + far**2 / squares[at])))
        ends.append((middle[at], height[at], slope[at]))
    before, behind = ends
    between = _between(before, behind, clipped)
    places.append(between + 0.0 * places[0] * places[1])
    doubts.append(np.fmin(*doubts))
    away = np.abs(row[clipped] - places)
    beyond = np.fmin.reduce(away - _SURE * np.array(doubts) - _LEAST_PX, axis=0)
    hidden = np.fmin.reduce(away, axis=0) < _HIDDEN * width
    return np.where(hidden, np.maximum(beyond, 0.0), 0.0)


def _between(before: tuple[Array, ...], behind: tuple[Array, ...], column: Index) -> Array:
    """The cubic that goes on from one end, and into the other, smoothly."""
    (x0, y0, slope0), (x1, y1, slope1) = before, behind
    length = np.where(x1 > x0, x1 - x0, 1.0)
    t = (column - x0) / length
    s = 1.0 - t
    return s**2 * ((1.0 + 2.0 * t) * y0 + t * length * slope0) + t**2 * (
        (1.0 + 2.0 * s) * y1 - s * length * slope1
    )
