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
from scipy.special import ndtr, ndtri

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
from virtual_sensor.metrology.scatter import is_rough

Mask = NDArray[np.bool_]

_DOUBTED = (Status.SKEWED, Status.CUT, Status.DOUBLED)
_MENDED = (Status.OK, *_DOUBTED, Status.POOR_FIT, Status.TOO_NARROW, Status.NO_PEAK)
_BROADEST_PX = 16.0  # sigma: over a broader line no edge is sought
_GAP = 12  # columns between two of one edge
_FEWEST = 12  # columns that show an edge
_FEWEST_PIXELS = 6  # of a column, that are neither clipped nor missing
_MARGIN, _MOST_MARGIN = 48, 300  # columns beside them, to which their number is added; at most
_LOST = 8  # columns without a line end it
_REACH = 4.2  # sigma of the pixels that count
_NEAR = 3.5  # sigma: an edge so near shifts the centre
_FIRST_BLUR = 0.3  # sigma
_EACH = 1  # ratios of each sign
_LEVELS = 1.2  # times as bright on one side of an edge that crosses the line
_STILL = 5  # columns
_CHANGE = 2.0  # cost of a change by a sigma from place to place
_RATIOS = (1.5, 2.5, 5.0, 12.0)
_ROW_STEPS = np.arange(-2.0, 2.01, 0.5)  # sigma
_EDGE_STEPS = np.arange(-3.0, 3.01, 0.5)
_NODES, _SEVERAL = (32, 96), 2  # places along the edge at which it is sought first, columns of each
_LEAST_RATIO, _MOST_RATIO = 1.1, 40.0
_ROUGH = 0.03  # noise that is added at first, of the height, so that no fit is caught
_STARTS, _FIRST_STEPS = 2, 6
_LOOKED_AT, _FINE = 16, 0.01  # columns that are looked at first, and noise of their height
_DARKEST, _MORE = -0.1, 1.5  # light on the dark side; what an edge leaves over what a Gaussian does
_GRAINY = 0.03  # change of the height, of which few places do not tell enough
_GRAINS = 3.0  # contrast of a pixel's speckle, in what it makes of the height's changes
_PERHAPS = 1.3  # times as much is left by a first fit in some columns
_ROUNDS = 2  # of fits with the noise that the last one shows
_ENOUGH_CLEAN = 16  # columns that show the line's own width
_MIDDLE = 0.7  # of the columns near an edge: those that show what it is
_AS_GOOD, _BETTER = 1.12, 0.9  # what is left, over that of other models; without clean columns
_CROSSING, _JUMP = 40, 0.5  # columns, and part of the log ratio
_USUAL = 1.4  # times the misfit of the columns beside it
_TOGETHER, _AMONG = 15, 61  # columns whose misfits are averaged; those of which the powers are
_CHANCE, _NEARLY_CHANCE = 1.5, 2.0  # times the power of a mean of noise: in all, and in places
_FAR_BETTER = 0.7  # what is left, over that of other models, where it is more than noise
_OWN_WIDTH = 0.1  # by which part the fit's width may differ from that of clean columns
_CLEAR = 6.0  # what is gained, in columns' square roots
_DOUBT = 5.0  # widths by which a centre may be off, for each lopsided misfit
_DOUBTED_WIDTH = 1.5  # times as much as its width is unusual
_FORM = 0.002  # widths: what a profile that is no Gaussian's shifts a centre by, at least
_WORST = 0.7  # widths: no larger error is a centre's
_BROADEST_BLUR = 0.8  # sigma
_BROADER = 2.0  # widths: no line is so broad
_ALLOWED = 0.3  # widths, and once its shift: so far a peak may be from its edge's centroid


class Line(NamedTuple):
    """What is known of one line in W columns; NaN where nothing is: (W,) each."""

    row: Array
    width: Array
    height: Array
    level: Array


def correct_edges(
    image: NDArray,
    line: Line,
    uneven: Array,
    status: Index,
    profile: Array,
    noise: Noise,
    saturation: float,
) -> None:
    """Correct the profiles (5, W) of a detector, and their status (W,), where an edge shifts them.

    What is uneven and no edge, as far as can be told, gets a larger standard deviation.  A line of
    nothing but grains stays as it is.

    Parameters
    ----------
    image : ndarray of shape (H, W)
    line : Line
        The peaks as they were found.
    uneven : ndarray of shape (W,)
        Lopsided misfit that neighbours share, relative to the height; 0 where there is none.
    status : ndarray of shape (W,)
    profile : ndarray of shape (5, W)
        As in `Profile`.
    """
    segments = _segments(line, uneven, status)
    if not (segments or uneven.any()) or is_rough(line.width):
        return
    for first, last in segments:
        part = slice(first, last)
        own = Line._make(values[part] for values in line)
        near, found = _segment(image, first, own, uneven[part], status[part], noise, saturation)
        good = near & np.isin(status[part], _MENDED) & (found[1] < _WORST * found[2])
        good &= _within(own.width, found[2])
        status[part] = np.where(good, Status.CORRECTED, status[part])
        profile[:, part] = np.where(good, found, profile[:, part])
        lost = near & ~good & (status[part] == Status.OK)
        status[part] = np.where(lost, Status.SKEWED, status[part])
        if not near.any():
            off = _DOUBTED_WIDTH * _unusual(own.width, uneven[part], status[part])
            profile[1, part] = np.hypot(profile[1, part], off)
    doubtful = (status == Status.OK) & (uneven > 0.0)
    if doubtful.any():
        off = _DOUBT * uneven * profile[2]
        profile[1] = np.where(doubtful, np.hypot(profile[1], off), profile[1])


def _unusual(width: Array, uneven: Array, status: Index) -> Array:
    """By what the widths (L,) differ from those of clean columns, between columns in doubt."""
    doubted = np.flatnonzero((uneven > 0.0) | np.isin(status, _DOUBTED))
    clean = (status == Status.OK) & (uneven == 0.0)
    off = np.zeros(width.size)
    if clean.sum() > _ENOUGH_CLEAN:
        between = slice(doubted[0], doubted[-1] + 1)
        off[between] = np.abs(np.nan_to_num(width - np.median(width[clean])))[between]
    return off


def _within(width: Array, found: Array) -> Mask:
    """Where corrected widths (L,) are still those of the line, and not of a glow beside it."""
    known = np.isfinite(width)
    near: Mask = found < _BROADER * (np.median(width[known]) if known.any() else 0.0)
    return near


def _segments(line: Line, uneven: Array, status: Index) -> list[tuple[int, int]]:
    """Runs of columns that an edge may be in, with some beside them."""
    doubted = (uneven > 0.0) | np.isin(status, _DOUBTED)
    doubted &= ~(line.width > _BROADEST_PX)
    if doubted.sum() < _FEWEST:
        return []  # as of most lines
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
        margin = min(_MARGIN + columns.size, _MOST_MARGIN)
        lines = parts[columns][parts[columns] > 0]
        if not lines.size:
            continue
        inside = np.flatnonzero(parts == lines[lines.size // 2])
        first = max(columns[0] - margin, inside[0])
        last = min(columns[-1] + margin, inside[-1]) + 1
        if result and first < result[-1][1]:  # one edge, whose effect vanishes in between
            first = result.pop()[0]
        result.append((first, last))
    return result


def _segment(
    image: NDArray,
    first: int,
    line: Line,
    uneven: Array,
    status: Index,
    noise: Noise,
    saturation: float,
) -> tuple[Mask, Array]:
    """In which columns an edge lies, and the profiles (5, L) that are corrected for it."""
    clean = (status == Status.OK) & (uneven == 0.0) & np.isfinite(line.width)
    column = np.arange(first, first + line.row.size)
    row, width = _guessed(line, clean)
    none = np.zeros(column.size, bool), np.full((5, column.size), np.nan)
    doubted = (uneven > 0.0) | np.isin(status, _DOUBTED)
    if not _may_be_edge(image, first, line, row, width, doubted, noise, saturation):
        return none
    broader = (1.0,) if clean.sum() > _ENOUGH_CLEAN else (1.0, 1.3, 1.7)
    for nodes in _NODES if _unevenness(line) > _GRAINY else _NODES[:1]:
        some = np.unique(np.linspace(0, column.size - 1, _SEVERAL * nodes).round().astype(int))
        thin = Line._make(values[some] for values in line)
        window = _window(image, first + some, row[some], broader[-1] * width[some], saturation)
        fit = _first_fit(
            window, row[some], np.outer(broader, width[some]), thin, noise, first + some
        )
        if not _is_edge(window, fit, thin, clean[some], _PERHAPS):
            return none
    window = _window(image, column, row, broader[-1] * width, saturation)
    own = np.stack([np.interp(column - first, some, values) for values in fit.own])
    shared, smooth = fit.shared, _smoothness(fit, column.size / some.size)
    variance = _first_variance(window, line, noise, column)
    for _ in range(_ROUNDS):
        fit = fit_edge(window, own, shared, variance, smooth)
        own, shared, smooth = fit.own, fit.shared, _smoothness(fit)
        variance = _noise_of(window, fit, noise, column)
    fit = fit_edge(window, own, shared, variance, smooth)
    near = _near(fit, 1.0)
    if not (_is_edge(window, fit, line, clean) and _goes_on(fit, line, clean)):
        return none
    own, (ratio, blur) = fit.own, fit.shared
    below = ndtr((own[ROW] - own[EDGE]) / np.exp(blur))
    reflected = np.exp(-0.5 * ratio) + (np.exp(0.5 * ratio) - np.exp(-0.5 * ratio)) * below
    error = np.hypot(fit.row_error * _underestimated(window, fit), _FORM * np.exp(own[WIDTH]))
    alike = _alike(window, fit)
    error = error * np.sqrt(np.maximum(alike, 1.0))
    noisy = alike < _NEARLY_CHANCE * max(np.median(alike[near]), 1.0)
    error = np.where(noisy & _is_moved(fit, line), error, np.inf)
    height = np.exp(own[HEIGHT]) * reflected
    return near, np.stack([own[ROW], error, np.exp(own[WIDTH]), height, own[LEVEL]])


def _near(fit: EdgeFit, share: float) -> Mask:
    """Columns (L,) in which the edge is so near that it shifts the centre."""
    width = np.hypot(np.exp(fit.own[WIDTH]), np.exp(fit.shared[BLUR]))
    near: Mask = np.abs(fit.own[EDGE] - fit.own[ROW]) < share * _NEAR * width
    return near


def _first_fit(
    window: Window, row: Array, widths: Array, line: Line, noise: Noise, column: Index
) -> EdgeFit:
    """The fit in some columns that is best of some first guesses, of some widths (k, L)."""
    height, step = np.nanmax(line.height), np.ptp(column) / max(column.size - 1, 1)
    even = _unevenness(line)
    smooth = Smooth(even=even / np.sqrt(_SEVERAL)).over(step)
    above = np.maximum(window.values - np.nanmedian(line.level), 0.0)
    variance = _first_variance(window, line, noise, column) + (_GRAINS * even * above) ** 2
    variance += (_ROUGH * height) ** 2
    sought = [each for width in widths for each in _sought(window, row, width, variance, even)]
    sought.sort(key=lambda each: -each[0])
    starts = [(own, shared) for _, own, shared in sought[:_STARTS]]
    starts += _by_levels(window, widths[0], line)
    fits = [fit_edge(window, *start, variance, smooth, _FIRST_STEPS) for start in starts]
    best = min(fits, key=lambda fit: fit.cost)
    variance = _noise_of(window, best, noise, column)
    return fit_edge(window, best.own, best.shared, variance, smooth)


def _is_edge(window: Window, fit: EdgeFit, line: Line, clean: Mask, loosely: float = 1.0) -> bool:
    """Whether this is an edge, and no second line, cut line or skewed one."""
    ratio, blur = np.abs(fit.shared[RATIO]), np.exp(fit.shared[BLUR])
    width = np.exp(fit.own[WIDTH])
    near = _near(fit, _MIDDLE)
    if not (
        near.sum() >= _FEWEST / _SEVERAL
        and np.log(_LEAST_RATIO) < ratio < np.log(_MOST_RATIO)
        and fit.ratio_error < 0.3 * ratio
        and blur < _BROADEST_BLUR * np.median(width)
        and _is_even(fit, loosely)
    ):
        return False
    part = Window._make(values[:, near] for values in window)
    weight = part.use / fit.variance[:, near]
    at = np.where(np.isfinite(line.row), line.row, fit.own[ROW])[near]
    broad = np.where(np.isfinite(line.width), line.width, width)[near]
    pixels = part.use.sum()
    left = (weight * fit.residual[:, near] ** 2).sum() / (pixels - 4.2 * near.sum())
    gaussian, *others = _alternatives(part, weight, at, broad, fit.own[ROW, near], width[near])
    aside = ~_near(fit, 1.0)
    beside = (window.use * fit.residual**2 / fit.variance)[:, aside].sum()
    usual = max(beside / max(window.use[:, aside].sum() - 4.0 * aside.sum(), 1.0), 1.0)
    limit = _AS_GOOD if clean.sum() > _ENOUGH_CLEAN else _BETTER
    gained = gaussian * (pixels - 3.0 * near.sum()) - left * (pixels - 4.2 * near.sum())
    limit = loosely * min(limit * min(others), _USUAL * usual)
    if loosely == 1.0:  # the fit's variance is of what it leaves: its amount alone tells nothing
        together, each = _powers(window, fit)[:, near].sum(axis=1)
        beside_it = clean.sum() > _ENOUGH_CLEAN
        if together > _CHANCE * each:  # neighbours share what is no noise
            limit = min(limit, _FAR_BETTER * min(others)) if beside_it else 0.0
    return bool(left < limit and gained > _CLEAR * np.sqrt(near.sum()))


def _goes_on(fit: EdgeFit, line: Line, clean: Mask) -> bool:
    """Whether the line is as broad as where it is clean, if it is so anywhere."""
    if clean.sum() <= _ENOUGH_CLEAN:
        return True
    ratio = np.median(np.exp(fit.own[WIDTH][clean]) / line.width[clean])
    return bool(abs(ratio - 1.0) < _OWN_WIDTH)


def _is_moved(fit: EdgeFit, line: Line) -> Mask:
    """Where the peaks (L,) are about where the edge moves the line's centroid to."""
    own, width, blur = fit.own, np.exp(fit.own[WIDTH]), np.exp(fit.shared[BLUR])
    brighter, both = np.expm1(fit.shared[RATIO]), np.hypot(width, blur)
    away = (own[ROW] - own[EDGE]) / both
    shift = brighter * np.exp(-0.5 * away**2) / np.sqrt(2.0 * np.pi)
    shift *= width**2 / both / (1.0 + brighter * ndtr(away))
    off = np.nan_to_num(line.row - own[ROW] - shift)
    moved: Mask = np.abs(off) < np.abs(shift) + _ALLOWED * width
    return moved


def _alike(window: Window, fit: EdgeFit) -> Array:
    """Power (L,) of what neighbouring columns leave alike, over what it is of noise."""
    together, each = uniform_filter1d(_powers(window, fit), _AMONG, axis=1, mode="nearest")
    return np.asarray(together / np.maximum(each, 1e-300))


def _powers(window: Window, fit: EdgeFit) -> Array:
    """Of what is left in each column (2, L): of means along the line, were they noise; in all."""
    lit = window.use & (fit.signal > 0.05 * fit.signal.max(axis=0))
    normed = np.where(lit, fit.residual / np.sqrt(fit.variance), 0.0)
    mean = uniform_filter1d(normed, _TOGETHER, axis=1, mode="constant")
    return np.stack([_TOGETHER * (lit * mean**2).sum(axis=0), (normed**2).sum(axis=0)])


def _is_even(fit: EdgeFit, loosely: float) -> bool:
    """Whether the line's own height goes on where the edge crosses it.

    Where it jumps as much the other way, the edge has been put on the wrong side.
    """
    own, ratio = fit.own, fit.shared[RATIO]
    below = ndtr((own[ROW] - own[EDGE]) / np.exp(own[WIDTH]))
    reflected = np.log(np.exp(-0.5 * ratio) * (1.0 - below) + np.exp(0.5 * ratio) * below)
    far = min(_CROSSING, below.size - 1)
    height, reflected = (values[far:] - values[:-far] for values in (own[HEIGHT], reflected))
    against = np.where(height * reflected < 0.0, np.fmin(np.abs(height), np.abs(reflected)), 0.0)
    return bool(against.max(initial=0.0) < loosely * _JUMP * np.abs(ratio))


def _alternatives(
    window: Window, weight: Array, row: Array, width: Array, own_row: Array, own_width: Array
) -> tuple[float, float, float]:
    """What a Gaussian of the line's own width leaves, a skewed and flat one, and two lines.

    Of each degree of freedom.
    """
    z = (window.rows - row) / width
    gaussian = np.exp(-0.5 * z**2)
    one = np.ones_like(z)
    powers = [one, gaussian, z * gaussian, (z**2 - 1.0) * gaussian]
    hermite = [*powers, (z**3 - 3.0 * z) * gaussian, (z**4 - 6.0 * z**2 + 3.0) * gaussian]
    lines = np.full(row.size, np.inf)
    for moved in (-0.7, 0.0, 0.7):
        x = (window.rows - own_row) / own_width - moved
        first = np.exp(-0.5 * x**2)
        for apart in (-3.0, -2.0, -1.0, 1.0, 2.0, 3.0):
            second = np.exp(-0.5 * (x - apart) ** 2)
            both = [one, first, x * first, second, (x - apart) * second]
            lines = np.minimum(lines, _left(window, weight, both))
    count = window.use.sum()
    x = (window.rows - row) / own_width
    narrow = np.exp(-0.5 * x**2)
    parts = (
        (_left(window, weight, [one, narrow, x * narrow]), 3),
        (_left(window, weight, hermite), 6),
        (lines, 7),
    )
    plain, skewed, two = (each.sum() / (count - free * row.size) for each, free in parts)
    return float(plain), float(skewed), float(two)


def _left(window: Window, weight: Array, basis: list[Array]) -> Array:
    """Weighted squares (L,) that are left by a linear fit of each column."""
    terms = np.stack(basis)
    weighted = weight * terms
    normal = np.einsum("inl,jnl->lij", weighted, terms)
    ridge = 1e-9 * np.einsum("lii->l", normal) + np.finfo(float).tiny  # all pixels may be missing
    normal += ridge[:, None, None] * np.eye(len(basis))
    right = np.einsum("inl,nl->li", weighted, window.values)
    solved = np.linalg.solve(normal, right[..., None])[..., 0]
    left: Array = (weight * (window.values - np.einsum("li,inl->nl", solved, terms)) ** 2).sum(0)
    return left


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


def _window(image: NDArray, column: Index, row: Array, width: Array, saturation: float) -> Window:
    half = int(np.ceil((_REACH + 1.5) * width.max())) + 1
    rows = np.rint(row).astype(int) + np.arange(-half, half + 1)[:, None]
    values = image[np.clip(rows, 0, len(image) - 1), column].astype(float)
    use = (rows >= 0) & (rows < len(image)) & np.isfinite(values) & (values < saturation)
    return Window(rows, np.where(use, values, 0.0), use)


def _first_variance(window: Window, line: Line, noise: Noise, column: Index) -> Array:
    above = np.maximum(window.values - np.nanmedian(line.level), 0.0)
    least = (1e-4 * above.max()) ** 2 + np.finfo(float).tiny  # of an image without noise
    if noise.known:
        return np.maximum(noise.variance(above, column), least)
    return np.maximum(noise.dark[column] ** 2 + 1e-4 * above**2, least)


def _unevenness(line: Line) -> float:
    """By which part the height changes by chance between places at which the edge is sought."""
    height = np.log(line.height[::_SEVERAL])
    bends = np.abs(np.diff(height[np.isfinite(height)], 2))
    change = np.median(bends) / (QUARTILE * np.sqrt(6.0 * _SEVERAL)) if bends.size else 0.0
    return float(np.clip(change, 0.005, 0.2))


def _products(
    window: Window, row: Array, width: Array, variance: Array
) -> tuple[Array, Array, Array, Array]:
    """Of the values and S states of a sharp edge: (L, S, 4), (L, S, 4, 4); and the states (S,).

    These are the line, its bright side, and the derivatives by the row: every ratio is made of
    them.  A state is where the line's row is, and where the edge is from there, in widths.
    """
    weight = window.use / variance
    z = ((window.rows - row) / width).astype(np.float32)
    moved, away = (grid.ravel() for grid in np.meshgrid(_ROW_STEPS, _EDGE_STEPS, indexing="ij"))
    off = z[:, None] - moved[:, None].astype(np.float32)
    gaussian = np.exp(-0.5 * off**2)
    bright = gaussian * ndtr((off - away[:, None].astype(np.float32)) / np.float32(_FIRST_BLUR))
    basis = np.stack([gaussian, bright, off * gaussian, off * bright], dtype=np.float32)
    share = np.sqrt(weight).astype(np.float32)
    part = _parts(weight)
    mean = np.einsum("nl,insl->isl", part.astype(np.float32), basis)
    basis = ((basis - mean[:, None]) * share[:, None]).transpose(3, 2, 0, 1)
    level = (part * window.values).sum(axis=0)
    seen = (share * (window.values - level)).astype(np.float32).T
    matches = (basis @ seen[:, None, :, None])[..., 0].astype(float)
    return matches, (basis @ basis.swapaxes(2, 3)).astype(float), moved, away


def _parts(weight: Array) -> Array:
    """Weights (n, L) with the sum 1 in each column; 0 in one whose pixels are all missing."""
    return weight / np.maximum(weight.sum(axis=0), np.finfo(float).tiny)


def _may_be_edge(
    image: NDArray,
    first: int,
    line: Line,
    row: Array,
    width: Array,
    doubted: Mask,
    noise: Noise,
    saturation: float,
) -> bool:
    """Whether it is worth while to look closer, by what a sharp edge leaves in some columns.

    Of what a part hides there is no light at all on the dark side; of a line that is skewed all
    over, or of a shape of its own, a Gaussian leaves less.
    """
    columns = np.flatnonzero(doubted & np.isfinite(line.row) & np.isfinite(line.width))
    if columns.size < _FEWEST:
        return False
    some = columns[np.linspace(0, columns.size - 1, _LOOKED_AT).round().astype(int)]
    own = Line._make(values[some] for values in line)
    window = _window(image, first + some, own.row, width[some], saturation)
    if window.use.sum(axis=0).min() < _FEWEST_PIXELS:
        return False
    variance = _first_variance(window, own, noise, first + some) + (_FINE * own.height) ** 2
    matches, squares, _, _ = _products(window, own.row, width[some], variance)
    match, square = matches[..., :2], squares[..., :2, :2] + 1e-6 * np.eye(2)
    sides = np.linalg.solve(square, match[..., None])[..., 0]
    gains = (sides * match).sum(axis=2)
    best = np.arange(some.size), gains.argmax(axis=1)
    one, more = sides[best].T
    bright = np.fmax(one, one + more)
    dark = np.divide(np.fmin(one, one + more), bright, np.zeros_like(bright), where=bright > 0.0)
    weight = window.use / variance
    mean = (_parts(weight) * window.values).sum(axis=0)
    left = (weight * (window.values - mean) ** 2).sum(axis=0) - gains[best]
    z = (window.rows - own.row) / own.width
    gaussian = np.exp(-0.5 * z**2)
    powers = [np.ones_like(z), gaussian, z * gaussian, (z**2 - 1.0) * gaussian]
    usual = np.maximum(_left(window, weight, powers), 2.0 * window.use.sum(axis=0))
    return bool(np.median(dark) > _DARKEST and np.median(left / usual) < _MORE)


def _sought(
    window: Window, row: Array, width: Array, variance: Array, even: float
) -> list[tuple[float, Array, Array]]:
    """First guesses of the parameters, of the likeliest ratios of each sign, and what they gain.

    By dynamic programming: the path through the states of places along the edge whose misfit and
    changes are the least (Viterbi 1967).
    """
    count = row.size
    node = np.arange(count) // _SEVERAL
    matches, squares, moved, away = _products(window, row, width, variance)
    members = np.bincount(node)[:, None]
    results = []
    for ratio in (*_RATIOS, *(1.0 / each for each in _RATIOS)):
        mix = np.zeros((2, 4))
        mix[[0, 1], [0, 2]], mix[[0, 1], [1, 3]] = ratio**-0.5, ratio**0.5 - ratio**-0.5
        match = np.moveaxis(matches @ mix.T, -1, 0)
        (a, b), (_, d) = np.moveaxis(mix @ squares @ mix.T, (-2, -1), (0, 1))
        height = (d * match[0] - b * match[1]) / (a * d - b * b)
        shift = (a * match[1] - b * match[0]) / (a * d - b * b)
        gain = height * match[0] + shift * match[1]
        possible = (height > 0.0) & (np.abs(shift) < 0.5 * height)
        gain, height = np.where(possible, gain, 0.0), np.where(possible, height, 0.0)
        gains, heights = np.zeros((2, node[-1] + 1, moved.size))
        np.add.at(gains, node, gain)
        np.add.at(heights, node, height / members[node])
        heights = np.log(np.maximum(heights, 1e-9 * heights.max() + 1e-300))
        path, total = _path(gains, heights / even, moved, away)
        results.append((total, ratio, path, height))
    results.sort(key=lambda each: -each[0])
    least = 1e-3 * np.nanmax(results[0][3]) + 1e-300
    guesses = []
    chosen = [
        *[each for each in results if each[1] > 1.0][:_EACH],
        *[each for each in results if each[1] < 1.0][:_EACH],
    ]
    for total, ratio, path, height in chosen:
        own = np.empty((5, count))
        own[ROW] = row + width * moved[path[node]]
        own[EDGE] = own[ROW] + width * away[path[node]]
        own[WIDTH] = np.log(width)
        heights = np.maximum(median_filter(height[np.arange(count), path[node]], 5), least)
        own[HEIGHT] = np.log(heights)
        own[LEVEL] = np.median(window.values[[0, 1, -2, -1]], axis=0)
        shared = np.array([np.log(ratio), np.log(_FIRST_BLUR * np.median(width))])
        guesses.append((total, own, shared))
    return guesses


def _by_levels(window: Window, width: Array, line: Line) -> list[tuple[Array, Array]]:
    """First guesses where an edge crosses the line, which is brighter before it than behind it.

    The light of each column says how much of the line is on the bright side, which is the one or
    the other; and by how much its centroid is off.
    """
    columns = np.arange(line.row.size)
    there = np.isfinite(line.row)
    row, light = (
        median_filter(np.interp(columns, columns[there], values[there]), _STILL, mode="nearest")
        for values in (line.row, line.height * line.width)
    )
    few = max(columns.size // 10, 1)
    before, behind = np.median(light[:few]), np.median(light[-few:])
    bright, dark = max(before, behind), min(before, behind)
    if not dark * _LEVELS < bright:
        return []
    share = np.clip((light - dark) / (bright - dark), 1e-3, 1.0 - 1e-3)
    away = ndtri(share)
    shift = (bright - dark) * np.exp(-0.5 * away**2) / np.sqrt(2.0 * np.pi) / light
    guesses = []
    for sign in (1.0, -1.0):  # the bright side is below, or above
        own = np.empty((5, columns.size))
        own[ROW] = row - sign * shift * width
        own[EDGE] = own[ROW] - sign * away * width
        own[WIDTH] = np.log(width)
        own[HEIGHT] = np.log(np.sqrt(bright * dark) / np.median(width))
        own[LEVEL] = np.median(window.values[[0, 1, -2, -1]], axis=0)
        blur = np.log(_FIRST_BLUR * np.median(width))
        guesses.append((own, np.array([sign * np.log(bright / dark), blur])))
    return guesses


def _path(gains: Array, heights: Array, moved: Array, away: Array) -> tuple[Index, float]:
    """The states of each node (N,) whose sum of gains (N, S), less the changes, is the largest."""
    changes = (moved[:, None] - moved) ** 2 + (away[:, None] - away) ** 2
    changes = _CHANGE * changes
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


def _smoothness(fit: EdgeFit, step: float = 1.0) -> Smooth:
    """How much the edge's slope and the height change from column to column: as it was found.

    `step`: columns between those of the fit.
    """
    near = _near(fit, _MIDDLE)
    bends, changes = np.diff(fit.own[EDGE], 2)[near[1:-1]], np.diff(fit.own[HEIGHT])
    if bends.size < 10:
        return Smooth()
    bend, change = (np.median(np.abs(each)) / QUARTILE for each in (bends, changes))
    bend, change = bend / step**1.5, change / step**0.5
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
        own = np.maximum(own, 1e-12 * power.max() + 1e-300)
        speckle = max(nnls((level**2 / own)[:, None], np.maximum(power / own - 1.0, 0.0))[0][0], 0)
        variance = noise.variance(fit.signal, column) + speckle * fit.signal**2
        return np.maximum(variance, (1e-4 * fit.signal.max()) ** 2 + np.finfo(float).tiny)
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
