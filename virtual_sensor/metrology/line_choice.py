"""Which peaks of an image are the laser line, and which are ghosts: reflections, spatter, lamps.

Peaks of adjoining columns are linked to tracklets, as particles are from frame to frame (Jaqaman et
al. 2008, Nature Methods 5, 695): each to the nearest of the next column, where both agree.  Where a
tracklet ends beside another, as where a ghost crosses the line, both are cut.  The line is the path
from left to right through the tracklets that has the most merit, by dynamic programming (Viterbi's
algorithm: Forney 1973, Proc. IEEE 61, 268).  A column counts by how high and how narrow its peak
is; to go on with another tracklet costs up to `BREAK` columns, the less the better it continues the
last one.  So a line may step, break off and come back, and what lies beside it in the same columns
is a ghost, even where it is the brighter.
"""

from functools import partial
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray
from scipy.ndimage import median_filter

from virtual_sensor.metrology.line_profiles import (
    SMOOTHING_PX,
    Array,
    Coarse,
    Index,
    Peaks,
    coarse_search,
    find_peaks,
    noise_beside,
    pixels,
)

Mask = NDArray[np.bool_]

CANDIDATES = 6  # peaks of a column that may be the line
BREAK = 4.0  # columns' worth that it costs to go on somewhere else
FAINT = 0.3  # height, relative to the usual one, that counts half
LEAST = 0.2  # a column's worth: with less, it rather is no line
_BESIDE = 3.0  # usual widths from a peak at which it is down to what is beside it
AS_GOOD = 0.85  # of the line's merit: from there on, about 0.65 of its height, another is as good
STANDS = 1.2  # times what columns show of a line: from there on it is read in rows
SAME_LINE = (3.0, 2.0)  # px, and widths: so near lie peaks of one line in adjoining columns
STEEP = 2.0  # px a column that a line may climb where columns are missing
_JOINED = 0.05  # columns' worth, at the least, of what continues the line
_CUTS = 8  # columns: so long is what cuts another where it ends
_END = 12  # columns in which a tracklet's end shows where it leads
_SHARED = 0.2  # of the shorter of two: in so many columns may two tracklets of the line lie
_SPECK, _SPECKS = 8, 0.1  # columns, and of the line's: where all that is so short are so few
_COHERENT = 0.5  # of the columns with peaks lie on the line, or there is none to speak of
_NEAR, _MERGED = 101, 2.0  # columns, and their usual width: what is so broad is not the line alone
_MOST = 1500  # tracklets
_WIDEST_PX = 32.0  # peaks, where it is asked how the line lies


class Choice(NamedTuple):
    """Of L candidates those that are the line, and those that are ghosts: (L,) each.

    What is neither is as good as the line.
    """

    line: Mask
    ghost: Mask


class _Sorted(NamedTuple):
    """What counts of L peaks, by column and row: see `Peaks`."""

    column: Index
    peak: Index
    row: Array
    sigma: Array
    amplitude: Array


class _Tracklets(NamedTuple):
    """N tracklets by their first columns; (2, N): at their first column, and at their last."""

    merit: Array
    columns: Index
    column: Array
    row: Array
    slope: Array
    height: Array
    width: Array


def with_line_first(
    peaks: Peaks, count: int, same_height: float, coarse: Coarse, max_sigma: float
) -> tuple[Peaks, Mask]:
    """The `count` peaks of each column that are the line or come next, and which are ghosts: (L,).

    Where the highest peaks make one line, with none of the `same_height` beside it, they stay.

    Parameters
    ----------
    peaks : Peaks
        The `count` highest of each column; with `second`, where it is one.
    count : int
        1: the line alone, or in columns without one the highest ghost.
    same_height : float
        Relative height from which on a second peak may be the line as well.
    coarse : Coarse
        In which they were found.
    max_sigma : float
        Broadest line in px.
    """
    if _is_clear(peaks, same_height):
        return peaks, np.zeros(peaks.row.size, bool)
    search = partial(find_peaks, coarse, max_sigma, max(count, CANDIDATES))
    line, ghost = _choose(search(), coarse.smooth)
    at = search(local=True)  # the same, as a fit starts on a glow
    order = np.lexsort((-at.amplitude, ~line, at.column))
    at, line, ghost = at.take(order), line[order], ghost[order]
    first = _first_of_column(at.column)
    start = np.maximum.accumulate(np.where(first, np.arange(first.size), 0))
    # A column without the line has no first peak, where several are sought.
    rank = np.arange(first.size) - start + ((count > 1) & ~line[start])
    few = rank < count
    chosen = at._replace(rank=rank).take(few)
    return (_as_found(chosen, peaks, at, ghost) if count == 1 else chosen), ghost[few]


def _as_found(chosen: Peaks, highest: Peaks, at: Peaks, ghost: Mask) -> Peaks:
    """Chosen peaks as the search for the highest found them, where they are these.

    What is beside them counts as a second peak only if it is no ghost.
    """
    of_column = np.full(int(chosen.column.max()) + 1, -1)
    known = highest.column < of_column.size
    of_column[highest.column[known]] = np.flatnonzero(known)
    same = highest.take(of_column[chosen.column])
    near = np.abs(same.peak - chosen.peak) <= same.sigma  # the same plateau, if it is one
    is_same = (same.column == chosen.column) & (same.amplitude == chosen.amplitude) & near
    first = _first_of_column(at.column)
    rivals, ghosts = (
        np.maximum.reduceat(np.where(~first & which, at.amplitude, 0.0), np.flatnonzero(first))
        for which in (~ghost, ghost)
    )
    parts = (np.where(is_same, a, b) for a, b in zip(same, chosen, strict=True))
    merged = Peaks._make(parts)
    second = np.where(is_same & (ghosts == 0.0), same.second, rivals / merged.amplitude)
    return merged._replace(second=second)


def _is_clear(peaks: Peaks, same_height: float) -> bool:
    if peaks.row.size < 2:
        return True
    if peaks.rank.any() or peaks.second.max() > same_height:
        return False
    missing = np.diff(peaks.column) - 1
    near = np.abs(np.diff(peaks.peak)) <= _reach(peaks.sigma[1:], peaks.sigma[:-1], missing)
    return bool(near.all())


def lies_along_rows(image: NDArray, noise: float | None, min_amplitude: float) -> bool:
    """Whether an image (H, W) shows more of a line row by row than column by column.

    That is, the line stands, and crosses rows: as many of these show a narrow peak that goes on in
    the next one.  Of a line at 45 degrees both show as much: it is read in columns.
    """
    found = []
    for turned in (image, np.ascontiguousarray(image.T)):
        coarse = coarse_search(turned, noise_beside(turned, noise), min_amplitude)
        found.append((coarse.smooth, find_peaks(coarse, _WIDEST_PX)))
    widths = [float(np.median(peaks.sigma)) for _, peaks in found if peaks.sigma.size]
    heights = []
    for smooth, peaks in found:
        height = _above_beside(peaks, smooth, min(widths, default=1.0))
        goes_on = (np.diff(peaks.column) == 1) & (
            np.abs(np.diff(peaks.peak)) <= _reach(peaks.sigma[1:], peaks.sigma[:-1])
        )
        heights.append(height[1:][goes_on])
    usual = max((np.median(each) for each in heights if each.size), default=0.0)  # of the line
    columns, rows = (np.sum(each / (each + FAINT * usual)) if usual else 0.0 for each in heights)
    return bool(rows > STANDS * columns)


def _reach(one: Array, other: Array, missing: Index | int = 0) -> Array:
    """How far peaks of such widths in one line are apart, with so many columns between them."""
    return SAME_LINE[0] + SAME_LINE[1] * np.minimum(one, other) + STEEP * missing


def _first_of_column(column: Index) -> Mask:
    """Which of L peaks, sorted by their columns, are the first of theirs."""
    return np.diff(column, prepend=-1) != 0


def _choose(peaks: Peaks, smooth: NDArray) -> Choice:
    order = np.lexsort((peaks.peak, peaks.column))
    at = _Sorted._make(getattr(peaks, name)[order] for name in _Sorted._fields)
    merit = _merit(at, smooth)
    label = _labels(_links(at))
    tracklets = _tracklets(at, merit, label)
    on_path, line_of = _best_path(tracklets)
    choice = Choice(*np.zeros((2, order.size), bool))
    for values, part in zip(
        choice, _judged(at, merit, label, tracklets, on_path, line_of), strict=True
    ):
        values[order] = part
    return choice


def _highest(at: _Sorted, value: Array) -> Mask:
    """Which peak of each column has the highest value; none where it is not finite."""
    first = _first_of_column(at.column)
    highest = np.maximum.reduceat(value, np.flatnonzero(first))[np.cumsum(first) - 1]
    return (value == highest) & np.isfinite(value)


def _merit(at: _Sorted, smooth: NDArray) -> Array:
    """What each peak speaks for a line, in columns: up to 1 - LEAST; below 0 it speaks against.

    It is the more the higher a peak stands above what is beside it, at a few of the usual widths:
    of a broad one little.
    """
    usual = float(np.median(at.sigma[_highest(at, at.amplitude)]))
    height = _above_beside(at, smooth, usual)
    height /= np.median(height[_highest(at, height)]) or 1.0
    return height / (height + FAINT) - LEAST


def _above_beside(at: "_Sorted | Peaks", smooth: NDArray, width: float) -> Array:
    """Height of peaks above what is beside them, at a few widths: of a slope none."""
    beside = int(np.ceil(_BESIDE * np.hypot(width, SMOOTHING_PX)))
    before, top, behind = (
        pixels(smooth, at.peak + away, at.column).astype(float) for away in (-beside, 0, beside)
    )
    return np.maximum(top - (before + behind) / 2.0, 0.0)


def _nearest(at: _Sorted, step: int) -> tuple[Index, Array, Mask]:
    """The peak in the next column, or the last, that is nearest to each (L,), and how far it is.

    And whether that is in reach of a line.
    """
    span = float(np.ptp(at.peak)) + 1.0
    place = at.column * (4.0 * span) + (at.peak - at.peak.min())
    beyond = np.searchsorted(place, place + step * 4.0 * span)
    pair = np.stack([beyond - 1, beyond])
    inside = np.clip(pair, 0, at.peak.size - 1)
    away = 1.0 * np.abs(at.peak[inside] - at.peak)
    away[(inside != pair) | (at.column[inside] != at.column + step)] = np.inf
    which = away.argmin(axis=0), np.arange(at.peak.size)
    nearest, away = inside[which], away[which]
    return nearest, away, away <= _reach(at.sigma, at.sigma[nearest])


def _links(at: _Sorted) -> Index:
    """The peak in the next column that goes on with each one's line; -1: none.

    None either beside the end of a long tracklet, where two may merge.
    """
    (after, ahead, near), (before, behind, _) = _nearest(at, 1), _nearest(at, -1)
    agreed = near & (before[after] == np.arange(after.size))
    links = np.where(agreed, after, -1)
    label = _labels(links)
    long = np.bincount(label)[label] >= _CUTS
    first = np.ones(links.size, bool)
    first[links[agreed]] = False
    ends = ~agreed & long & (ahead <= SAME_LINE[0] + SAME_LINE[1] * at.sigma)
    starts = first & long & (behind <= SAME_LINE[0] + SAME_LINE[1] * at.sigma)
    met = np.zeros(links.size, bool)
    met[after[ends]] = True
    links[agreed & met[after]] = -1
    links[before[starts]] = -1
    return links


def _labels(links: Index) -> Index:
    """Number of each peak's tracklet; by rising first peak."""
    first = np.arange(links.size)
    first[links[links >= 0]] = np.flatnonzero(links >= 0)
    while True:  # each turn doubles the distance
        further = first[first]
        if np.array_equal(further, first):
            return np.unique(first, return_inverse=True)[1]
        first = further


def _tracklets(at: _Sorted, merit: Array, label: Index) -> _Tracklets:
    order = np.argsort(label, kind="stable")
    count = np.bincount(label)
    start = np.cumsum(count) - count
    number = label[order]
    place = np.arange(order.size) - start[number]
    column, row = at.column[order], at.peak[order]
    height, width = np.log(at.amplitude[order]), np.log(at.sigma[order])
    ends = []
    for end, near in (
        (start, place < _END),
        (start + count - 1, count[number] - 1 - place < _END),
    ):
        x = column - column[end][number]
        n, sx, sy, sxx, sxy, high, wide = (
            np.add.reduceat(np.where(near, values, 0.0), start)
            for values in (np.ones(x.size), x, row, x * x, x * row, height, width)
        )
        slope = (n * sxy - sx * sy) / np.maximum(n * sxx - sx * sx, 1.0)
        slope = np.where(n > 3, slope, 0.0)
        fitted = (sy - slope * sx) / n
        ends.append((column[end].astype(float), fitted, slope, high / n, wide / n))
    at_column, at_row, slope, high, wide = (np.stack(pair) for pair in zip(*ends, strict=True))
    total = np.add.reduceat(merit[order], start)
    return _Tracklets(total, count, at_column, at_row, slope, high, wide)


def _best_path(of: _Tracklets) -> tuple[Mask, Index]:
    """Which tracklets (N,) are on it, and the number of the line each goes on with."""
    number = of.columns.size
    able = np.ones(number, bool)
    if number > _MOST:
        able[np.argsort(-of.merit)[_MOST:]] = False
    index = np.flatnonzero(able).tolist()
    best, before, joined = np.full(number, -np.inf), np.full(number, -1), np.zeros(number, bool)
    for place, j in enumerate(index):
        best[j] = of.merit[j]
        i = np.array(index[:place], int)
        missing = of.column[0, j] - of.column[1, i] - 1
        shared = np.maximum(-missing, 0)
        fewest = np.minimum(of.columns[i], of.columns[j])
        i_free = (shared <= _SHARED * fewest) & (of.column[1, i] < of.column[1, j])
        i, missing, shared = i[i_free], missing[i_free], shared[i_free]
        if not i.size:
            continue
        apart, cost = _break(of, i, j, np.maximum(missing, 0))
        mean = np.minimum(of.merit[i] / of.columns[i], of.merit[j] / of.columns[j])
        own = np.where(apart < 0.5, np.maximum(of.merit[j], _JOINED * of.columns[j]), of.merit[j])
        total = best[i] + own - cost - shared * np.maximum(mean, 0.0)
        k = int(total.argmax())
        if total[k] > best[j]:
            best[j], before[j], joined[j] = total[k], i[k], apart[k] < 0.5
    on_path, line_of = np.zeros(number, bool), np.full(number, -1)
    j, line = int(best.argmax()), 0
    while j >= 0:
        on_path[j], line_of[j] = True, line
        line += not joined[j]
        j = before[j]
    return on_path, line_of


def _break(of: _Tracklets, i: Index, j: int, missing: Array) -> tuple[Array, Array]:
    """How far apart the ends of tracklets i and the start of j are, 0 to 1; and what that costs."""
    away = missing + 1.0
    jump = of.row[0, j] - of.row[1, i]
    bent = np.minimum(np.abs(jump - away * of.slope[1, i]), np.abs(jump - away * of.slope[0, j]))
    bent = np.minimum(bent, np.abs(jump))
    width = np.exp(np.minimum(of.width[1, i], of.width[0, j]))
    apart = 1.0 / (1.0 + (_reach(width, width) / np.maximum(bent, 1e-9)) ** 2)
    unlike = 1.0 - np.exp(
        -((of.height[1, i] - of.height[0, j]) ** 2) / 4.0 - (of.width[1, i] - of.width[0, j]) ** 2
    )
    return apart, BREAK * (1.0 - (1.0 - apart) * (1.0 - 0.5 * unlike))


def _judged(
    at: _Sorted, merit: Array, label: Index, of: _Tracklets, on_path: Mask, line_of: Index
) -> Choice:
    peaks = np.arange(at.row.size)
    line = _highest(at, np.where(on_path[label], merit, -np.inf))
    lit = np.flatnonzero(np.bincount(at.column))
    if line.sum() < _COHERENT * lit.size:
        return Choice(_highest(at, at.amplitude), np.zeros(line.size, bool))
    beside = np.full(at.column.max() + 1, -1)
    beside[at.column[line]] = peaks[line]
    beside = beside[at.column]  # the line's peak in each one's column
    covered = beside >= 0
    totals = np.bincount(line_of[on_path], of.merit[on_path])
    own, lines, shared = (
        np.bincount(label[covered], values[covered], of.columns.size)
        for values in (merit, merit[beside], np.ones(merit.size))
    )
    rival = np.zeros(of.columns.size)
    np.maximum.at(rival, label[covered], totals[line_of[label[beside[covered]]]])
    as_good = (shared > 0) & (own >= AS_GOOD * lines) & (of.merit >= AS_GOOD * rival)
    specks = ~on_path & (of.columns <= _SPECK)
    few = of.columns[specks & (shared == 0)].sum() <= _SPECKS * line.sum()
    ghost = (shared > _SHARED * of.columns) | (of.merit < 0.0) | (specks & few)
    ghost &= ~as_good & ~on_path
    left_over = ~ghost & ~as_good & ~on_path
    line |= _highest(at, np.where(left_over[label] & ~covered, at.amplitude, -np.inf))
    blobs = np.flatnonzero(line)[_merged(_Sorted._make(values[line] for values in at))]
    line[blobs] = False
    ghosts = ghost[label]
    ghosts[blobs] = True
    return Choice(line, ghosts)


def _merged(line: _Sorted) -> Mask:
    """Which peaks of a line are much broader than those near them, and off them: others' light."""
    broad = line.sigma > _MERGED * np.median(line.sigma)
    if not broad.any():
        return broad
    width = median_filter(line.sigma, _NEAR, mode="nearest")
    place = median_filter(line.peak, _NEAR, mode="nearest")
    return (line.sigma > _MERGED * width) & (np.abs(line.row - place) > width)
