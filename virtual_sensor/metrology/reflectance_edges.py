"""Edges of the reflectance that lie within a line's width and run nearly along it.

A painted edge, or the border of an oxide scale, makes one side of the profile brighter: every
detector's centre moves towards it, by sigma sqrt(2/pi) (1 - r)/(1 + r) and more (Curless and Levoy
1995), and one column alone does not show it.  Columns beside each other do: their misfits are
alike, and lopsided.  There `fit_edge` takes the place of the detector, if the profile is one of an
edge better than that of a skewed line or of two lines.
"""

from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray
from scipy.ndimage import (
    binary_closing,
    gaussian_filter1d,
    label,
    median_filter,
    uniform_filter1d,
)
from scipy.optimize import nnls
from scipy.special import ndtr

from virtual_sensor.metrology.centres import Status
from virtual_sensor.metrology.edge_fits import (
    BLUR,
    EDGE,
    HEIGHT,
    LEVEL,
    RATIO,
    ROW,
    WIDTH,
    EdgeFit,
    Smooth,
    Window,
    fit_edge,
)
from virtual_sensor.metrology.line_profiles import QUARTILE, Array, Index, Noise

Mask = NDArray[np.bool_]

_DOUBTED = (Status.SKEWED, Status.CUT, Status.DOUBLED, Status.POOR_FIT)
_GAP = 12  # columns between two of one edge
_FEWEST = 12  # columns that show an edge
_MARGIN = 32  # columns beside them, and half of their number
_LOST = 8  # columns without a line end it
_REACH = 4.2  # sigma of the pixels that count
_NEAR = 3.5  # sigma: an edge so near shifts the centre
_RATIOS = (1.4, 2.0, 3.0, 5.0, 9.0, 16.0)
_ROW_STEPS = np.arange(-2.0, 2.01, 0.4)  # sigma
_EDGE_STEPS = np.arange(-3.0, 3.01, 0.5)
_NODES = 64  # places along the edge at which it is sought first
_LEAST_RATIO, _MOST_RATIO = 1.1, 40.0
_ROUGH = 0.03  # of the height: noise that is added at first, so that no fit is caught
_BROADEST_BLUR = 0.8  # sigma


class Line(NamedTuple):
    """What is known of one line in W columns; NaN where nothing is: (W,) each."""

    row: Array
    width: Array
    height: Array
    level: Array


def corrected(
    image: NDArray, line: Line, uneven: Mask, status: Index, noise: Noise, saturation: float
) -> tuple[Array, Index]:
    """Profiles (5, W), as of a detector, and the status where an edge was corrected.

    Elsewhere they are NaN, and the status is as given.

    Parameters
    ----------
    image : ndarray of shape (H, W)
    line : Line
        The peaks as they were found.
    uneven : ndarray of bool of shape (W,)
        Where neighbours share a lopsided misfit.
    status : ndarray of shape (W,)
    """
    found = np.full((5, status.size), np.nan)
    status = status.copy()
    for first, last in _segments(line, uneven, status):
        part = slice(first, last)
        own = Line._make(values[part] for values in line)
        _segment(image, first, own, uneven[part], status[part], found[:, part], noise, saturation)
    return found, status


def _segments(line: Line, uneven: Mask, status: Index) -> list[tuple[int, int]]:
    """Runs of columns that an edge may be in, with some beside them."""
    doubted = uneven | np.isin(status, _DOUBTED)
    closed = binary_closing(np.pad(doubted, _GAP), np.ones(_GAP))[_GAP:-_GAP] | doubted
    runs, _ = label(closed)
    whole = np.arange(1, runs.max() + 1)
    there = np.isfinite(line.row)
    there = binary_closing(np.pad(there, _LOST), np.ones(_LOST))[_LOST:-_LOST] | there
    parts, _ = label(there)
    result: list[tuple[int, int]] = []
    for each in whole:
        columns = np.flatnonzero(runs == each)
        if doubted[columns].sum() < _FEWEST:
            continue
        margin = _MARGIN + columns.size // 2
        inside = np.flatnonzero(parts == parts[columns[columns.size // 2]])
        first = max(columns[0] - margin, inside[0])
        last = min(columns[-1] + margin, inside[-1]) + 1
        if result and first < result[-1][1]:  # two edges are apart, or one
            middle = (first + result[-1][1]) // 2
            result[-1], first = (result[-1][0], middle), middle
        result.append((first, last))
    return result


def _segment(
    image: NDArray,
    first: int,
    line: Line,
    uneven: Mask,
    status: Index,
    found: Array,
    noise: Noise,
    saturation: float,
) -> None:
    count = line.row.size
    clean = (status == Status.OK) & ~uneven & np.isfinite(line.width)
    row, width = _guessed(line, clean)
    window = _window(image, first, row, width, saturation)
    column = np.arange(first, first + count)
    variance = _first_variance(window, line, clean, noise, column)
    rough = variance + (_ROUGH * np.nanmax(line.height)) ** 2
    starts = _sought(window, row, width, rough, _unevenness(line))
    fits = [fit_edge(window, own, shared, rough) for own, shared in starts]
    fit = min(fits, key=lambda fit: fit.cost)
    for straight_px in (None, None):
        variance = _noise_of(window, fit, noise, column)
        fit = fit_edge(window, fit.own, fit.shared, variance, _smoothness(fit))
    global LAST
    LAST = fit, window
    row, width, edge = fit.own[ROW], np.exp(fit.own[WIDTH]), fit.own[EDGE]
    near = np.abs(edge - row) < _NEAR * width
    error = fit.row_error * _underestimated(window, fit)
    half = 0.5 * np.abs(fit.shared[RATIO])
    height = np.exp(fit.own[HEIGHT] + half)
    found[:, near] = np.stack([row, error, width, height, fit.own[LEVEL]])[:, near]
    status[near] = 13


def _guessed(line: Line, clean: Mask) -> tuple[Array, Array]:
    """Where the line may be, and how wide it is where no edge is near."""
    column = np.arange(line.row.size)
    there = np.isfinite(line.row)
    row = np.interp(column, column[there], line.row[there])
    row = gaussian_filter1d(median_filter(row, 15, mode="nearest"), 5.0, mode="nearest")
    if clean.sum() >= 5:
        widths = median_filter(line.width[clean], 9, mode="nearest")
        width = np.interp(column, column[clean], widths)
    else:
        width = np.full(row.size, np.nanquantile(line.width, 0.75))
    return row, width


def _window(image: NDArray, first: int, row: Array, width: Array, saturation: float) -> Window:
    half = int(np.ceil((_REACH + 1.5) * width.max())) + 1
    rows = np.rint(row).astype(int) + np.arange(-half, half + 1)[:, None]
    column = np.arange(first, first + row.size)
    values = image[np.clip(rows, 0, len(image) - 1), column].astype(float)
    use = (rows >= 0) & (rows < len(image)) & np.isfinite(values) & (values < saturation)
    return Window(rows, np.where(use, values, 0.0), use)


def _first_variance(
    window: Window, line: Line, clean: Mask, noise: Noise, column: Index
) -> Array:
    above = np.maximum(window.values - np.nanmedian(line.level), 0.0)
    if noise.known:
        return noise.variance(above, column)
    return np.broadcast_to(noise.dark[column] ** 2, above.shape) + 1e-4 * above**2


def _unevenness(line: Line) -> float:
    """By which part the height changes by chance between places at which the edge is sought."""
    step = max(line.row.size // _NODES, 1)
    height = np.log(line.height[::step])
    bends = np.abs(np.diff(height[np.isfinite(height)], 2))
    return float(np.clip(np.median(bends) / (QUARTILE * np.sqrt(6.0)), 0.01, 0.3))


def _sought(
    window: Window, row: Array, width: Array, variance: Array, even: float
) -> list[tuple[Array, Array]]:
    """First guesses of the parameters, of the two most likely ratios, by dynamic programming."""
    count = row.size
    chosen = np.unique(np.linspace(0, count - 1, 3 * _NODES).round().astype(int))
    node = np.minimum(np.arange(chosen.size) // max(chosen.size // _NODES, 1), _NODES - 1)
    rows, values = window.rows[:, chosen], window.values[:, chosen]
    weight = window.use[:, chosen] / variance[:, chosen]
    z = (rows - row[chosen]) / width[chosen]
    moved, away = (grid.ravel() for grid in np.meshgrid(_ROW_STEPS, _EDGE_STEPS, indexing="ij"))
    gaussian = np.exp(-0.5 * (z[:, None] - _ROW_STEPS[:, None]) ** 2).repeat(_EDGE_STEPS.size, 1)
    below = ndtr((z[:, None] - (moved + away)[:, None]) / 0.25)
    sums = weight.sum(axis=0)
    centred = values - (weight * values).sum(axis=0) / sums
    results = []
    for ratio in (*_RATIOS, *(1.0 / each for each in _RATIOS)):
        template = gaussian * (ratio**-0.5 + (ratio**0.5 - ratio**-0.5) * below)
        template -= (np.einsum("nl,nsl->sl", weight, template) / sums)[None]
        power = np.einsum("nl,nsl,nsl->sl", weight, template, template)
        match = np.einsum("nl,nsl->sl", weight * centred, template)
        height = np.maximum(match, 0.0) / power
        gain = height * match
        gains, heights = np.zeros((2, node[-1] + 1, moved.size))
        np.add.at(gains, node, gain.T)
        np.add.at(heights, node, height.T)
        heights = np.log(np.maximum(heights, 1e-9 * heights.max() + 1e-300))
        path, total = _path(gains, heights / even, moved, away)
        results.append((total, ratio, path, height))
    results.sort(key=lambda each: -each[0])
    guesses = []
    for _, ratio, path, height in results[:2]:
        columns = np.arange(count)
        places = chosen[np.searchsorted(node, np.arange(node[-1] + 1))]
        own = np.empty((5, count))
        own[ROW] = row + width * np.interp(columns, places, moved[path])
        own[EDGE] = own[ROW] + width * np.interp(columns, places, away[path])
        own[WIDTH] = np.log(width)
        heights = height[path[node], np.arange(chosen.size)]
        heights = np.maximum(median_filter(heights, 5), 1e-3 * heights.max() + 1e-300)
        own[HEIGHT] = np.interp(columns, chosen, np.log(heights))
        own[LEVEL] = np.median(window.values[[0, 1, -2, -1]], axis=0)
        shared = np.array([np.log(ratio), np.log(0.25 * np.median(width))])
        guesses.append((own, shared))
    return guesses


def _path(gains: Array, heights: Array, moved: Array, away: Array) -> tuple[Index, float]:
    """The states of each node (N,) whose sum of gains (N, S), less the changes, is the largest."""
    changes = ((moved[:, None] - moved) / 0.4) ** 2 + ((away[:, None] - away) / 0.5) ** 2
    changes = 2.0 * changes
    total, back = gains[0], np.zeros(gains.shape, int)
    for number in range(1, len(gains)):
        uneven = (heights[number - 1][:, None] - heights[number]) ** 2
        options = total[:, None] - changes - uneven
        back[number] = options.argmax(axis=0)
        total = options.max(axis=0) + gains[number]
    path = np.empty(len(gains), int)
    path[-1] = total.argmax()
    for number in range(len(gains) - 1, 0, -1):
        path[number - 1] = back[number, path[number]]
    return path, float(total.max())


def _smoothness(fit: EdgeFit) -> Smooth:
    """How much the edge's slope and the height change from column to column: as it was found."""
    near = np.abs(fit.own[EDGE] - fit.own[ROW]) < 2.0 * np.exp(fit.own[WIDTH])
    bends, changes = np.diff(fit.own[EDGE], 2)[near[1:-1]], np.diff(fit.own[HEIGHT])
    if bends.size < 10:
        return Smooth()
    bend, change = (np.median(np.abs(each)) / QUARTILE for each in (bends, changes))
    return Smooth(float(np.clip(bend, 0.02, 0.5)), float(np.clip(change, 0.002, 0.5)))


def _noise_of(window: Window, fit: EdgeFit, noise: Noise, column: Index) -> Array:
    """Variance (n, L) as the residuals have it: of the camera, of shot noise, and of speckle."""
    signal, square = fit.signal[window.use], fit.residual[window.use] ** 2
    square = square * fit.residual.shape[0] / (fit.residual.shape[0] - 4.0)
    order = np.argsort(signal)
    groups = [part for part in np.array_split(order, 24) if part.size]
    level = np.array([signal[part].mean() for part in groups])
    power = np.array([square[part].mean() for part in groups])
    if noise.known:
        given = noise.variance(signal, np.broadcast_to(column, window.use.shape)[window.use])
        own = np.array([given[part].mean() for part in groups])
        speckle = max(nnls((level**2 / own)[:, None], np.maximum(power / own - 1.0, 0.0))[0][0], 0)
        return noise.variance(fit.signal, column) + speckle * fit.signal**2
    scale = np.maximum(power, 1e-12 * power.max() + 1e-300)
    basis = np.stack([np.ones_like(level), level, level**2], axis=1) / scale[:, None]
    constant, shot, speckle = nnls(basis, power / scale)[0]
    least = max(1e-6 * power.max(), 1e-300)
    return np.maximum(constant + shot * fit.signal + speckle * fit.signal**2, least)


def _underestimated(window: Window, fit: EdgeFit) -> Array:
    """By what the errors (L,) are larger: where the misfit is, and where grains span pixels."""
    normed = np.where(window.use, fit.residual / np.sqrt(fit.variance), 0.0)
    lit = fit.signal > 0.05 * fit.signal.max(axis=0)
    pairs = (normed[1:] * normed[:-1])[lit[1:] & lit[:-1]].mean()
    like = np.clip(pairs / np.mean(normed[lit] ** 2), 0.0, 0.8)
    counted = np.maximum(window.use.sum(axis=0) - 4.0, 1.0)
    misfit = uniform_filter1d((normed**2).sum(axis=0) / counted, 31, mode="nearest")
    return np.sqrt(np.maximum(misfit, 1.0) * (1.0 + like) / (1.0 - like))
