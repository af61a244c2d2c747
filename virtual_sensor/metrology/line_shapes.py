"""The shape of a peak: the Gaussian that fits it best, and whether it is one line at all.

Two lines that merge, or an edge across one, shift its centre; they show in the third and fourth
Hermite terms that are left beside the Gaussian.  Least squares in a tapered window is linear about
a place and a width; its matrices are tabulated for 16 places in a pixel and 16 widths an octave.
"""

from functools import lru_cache
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray
from scipy.ndimage import median_filter, uniform_filter1d

from virtual_sensor.metrology.line_profiles import (
    QUARTILE,
    REACH,
    Array,
    Index,
    Noise,
    Peaks,
    median_of_squares,
    pixel_gaussian,
    running_scatter,
    windows,
)

Single = NDArray[np.float32]

MAX_SKEW = 0.02  # of the third Hermite term; a skewed profile's centre is off by as many px or more
MAX_FLAT = 0.03  # of the fourth: two lines of the same height, 2 sigma apart or more
MAX_STEP = 0.1  # of the level below the line from one side to the other, relative to its height
SIGNIFICANCE = 3.0  # times the noise, beyond these
_OUTER = 2.5  # sigma from the centre on which the level below the line is seen
_ROUGH_FROM_PX = 1.5  # sigma from which on adjacent rows separate noise from shape
_CLOSE, _MOST_STEPS = 0.2, 3  # in sigma: the last step before the shape is judged

_ALIKE = 1.5  # times the noise that neighbours' differences show
_ABRUPT = 0.65  # of the misfit's changes, in two adjacent rows: an edge, where another line has 0.5
_SHARP_FROM_PX = 0.8  # sigma from which on an edge differs from another line

_NEIGHBOURS, _NEXT = 31, 9
_PHASES = 16
_WIDTHS = 16  # an octave
_IN_GROUP = 8  # of these share a window
_NARROWEST_PX = 0.35
_EXCESS = 1.5  # times the given variance: from there on the residuals' is used
_MOST_EXCESS = 1e6
_GRAINY = 1.5  # shapes that scatter by so much more than the residuals say
_BLOCK = 16  # columns whose mean misfit is compared with the noise, and four times as many
_LOPSIDED = 0.004  # of the height: lopsided misfit of a block's mean that shifts a centre,
_CERTAIN = 7.0  # and times the variance that the noise makes
_RIDGE = 1e-12  # no normal matrix is singular


class Shapes(NamedTuple):
    """The peaks at the Gaussians that fit best, and which of them are no such line: (L,) each.

    `stepped`: because the level below them differs from side to side.  `sharp`: what is left
    beside the Gaussian is one abrupt change, as where an edge cuts the line; `noisy`: how large a
    part of the rest is noise.  `uneven`: rms of the lopsided misfit that neighbours have in
    common, relative to the height, 0 where there is none: that of an edge of the reflectance hides
    in the noise of each.
    """

    peaks: Peaks
    skewed: NDArray[np.bool_]
    flat: NDArray[np.bool_]
    stepped: NDArray[np.bool_]
    sharp: NDArray[np.bool_]
    noisy: Array
    uneven: Array


class _Design(NamedTuple):
    """Least squares about L places and widths, in windows of n rows.

    `basis` (L, 4, n): 1, the Gaussian, its derivatives by place and width, whose coefficients
    `gaussian` (L, 4, n) gives; `tests` (L, 3, n) gives the two Hermite terms', fitted with the
    rest, and the step of the level from side to side.  In white noise of unit variance `left`
    (L, 2) is what the Hermite terms take of the squares, `spread` (L, 3) the tests' variance.
    """

    taper: Single
    basis: Single
    gaussian: Single
    tests: Single
    left: Single
    spread: Single


class _Near(NamedTuple):
    """L peaks of one group: the tabulated places and widths next to them, and their pixels (L, n).

    `values` are above the background `level`.
    """

    place: Array
    sigma: Array
    level: Array
    values: Single
    table: _Design
    entry: Index  # in the table
    cut: Index  # those that the image cuts,
    of_cut: _Design  # and the designs of these

    def design(self, name: str) -> Single:
        """A part of the designs."""
        values = getattr(self.table, name)[self.entry]
        if self.cut.size:
            values[self.cut] = getattr(self.of_cut, name)
        return values


def shapes(image: NDArray, at: Peaks, noise: Noise, max_sigma: float) -> Shapes:
    """Fit Gaussians to L peaks, and find those that are skewed or flatter than one line can be.

    Parameters
    ----------
    image : ndarray of shape (H, W)
    at : Peaks
    noise : Noise
    max_sigma : float
        Broadest line in px.
    """
    at = at._replace(sigma=np.clip(at.sigma, _NARROWEST_PX, 2.0 * max_sigma))
    found = np.stack([at.row, at.sigma, at.amplitude, at.background])
    going = np.arange(at.row.size)
    for _ in range(_MOST_STEPS):
        if not going.size:
            break
        here = _moved(at.take(going), found[:, going])
        for chosen, half in _groups(here.sigma):
            near = _near(image, here.take(chosen), half)
            gaussian = np.einsum("lin,ln->il", near.design("gaussian"), near.values)
            found[:, going[chosen]] = _stepped(near, gaussian, here.take(chosen), max_sigma)
        row, sigma = found[:2, going]
        going = going[np.hypot(row - here.row, sigma - here.sigma) > _CLOSE * here.sigma]
    residual, tests, errors, spread, expected, abrupt, uneven = (
        np.empty((n, at.row.size)) for n in (1, 3, 3, 3, 1, 1, 1)
    )
    at = _moved(at, found)
    for chosen, half in _groups(at.sigma):
        here = at.take(chosen)
        near = _near(image, here, half)
        gaussian = np.einsum("lin,ln->il", near.design("gaussian"), near.values)
        judged = _judged(near, gaussian, here, noise)
        of_each = residual, tests, errors, expected, abrupt, uneven
        for values, part in zip(of_each, judged, strict=True):
            values[:, chosen] = part
        spread[:, chosen] = near.design("spread").T
        found[:, chosen] = _stepped(near, gaussian, here, max_sigma)
    sharp = (abrupt[0] > _ABRUPT) & (at.sigma > _SHARP_FROM_PX)
    # Neighbours are not abrupt in two rows each by chance: only the other rows show the noise.
    shared = sharp & _most_near(abrupt[0] > _ABRUPT)
    shared &= np.abs(tests[0]) > 0.25 * MAX_SKEW  # without any the misfit is negligible
    noisy = np.where(shared, np.sqrt(1.0 - abrupt[0]), 1.0)
    if not noise.known:
        errors *= noisy
    errors[0] = _shared(tests[0], errors[0], at.sigma)
    # What is flat and not skewed may be out of focus: symmetric, and its centre is right.
    leaning = np.abs(tests[0]) > MAX_SKEW
    errors[1] = np.where(leaning, _shared(tests[1], errors[1], at.sigma), errors[1])
    limits = np.array([MAX_SKEW, MAX_FLAT, MAX_STEP])[:, None]
    # Only what seems to be wrong may be so by chance; the speckle comes from the skewness.
    doubtful = np.abs(tests) > limits + SIGNIFICANCE * errors
    scatter = np.zeros_like(tests)
    for number, each in enumerate(doubtful):
        if number == 0 or each.any():
            scatter[number] = _scatter(tests[number])
    skew, flat, step = tests
    skew_limit, flat_limit, step_limit = limits + SIGNIFICANCE * np.fmax(errors, scatter)
    leans = (np.abs(skew) > skew_limit) | (np.abs(step) > step_limit)
    # As much noise in each pixel would scatter the shapes so.
    speckle = np.nan_to_num(scatter[0] * at.amplitude / np.sqrt(spread[0]))
    local = _local(residual[0], at.sigma)
    local = np.where(speckle > _GRAINY * local, speckle, local)
    excess = np.where(local**2 > _EXCESS * expected[0] ** 2, local, expected[0])
    # Where no noise at all was given there is nothing to multiply.
    sensible = (expected[0] > local / _MOST_EXCESS) & np.isfinite(expected[0])
    excess = np.where(sensible, excess, 1.0) / np.where(sensible, expected[0], 1.0)
    at = _moved(at, found)._replace(
        residual=residual[0], noise=local, excess=excess**2, speckle=speckle
    )
    stepped = np.abs(step) > np.abs(skew)  # twice it, where a step of the level makes both
    return Shapes(at, leans, flat > flat_limit, stepped, sharp & ~stepped, noisy, uneven[0])


def _scatter(shape: Array) -> Array:
    """How much the shapes (L,) of neighbours differ, where they differ by chance: by speckle.

    Their median absolute deviation from the local median, as a standard deviation; none where that
    median is larger: a trouble of many columns.
    """
    shape = np.nan_to_num(shape)
    middle, away = running_scatter(shape, _NEIGHBOURS)
    return np.where(np.abs(middle) < away, away, 0.0)


def _shared(shape: Array, error: Array, sigma: Array) -> Array:
    """The noise of a shape (L,), less where neighbours share it: there it is none.

    An edge across the line seems to be noise in each profile of its own; and the pixels deform
    every narrow one.
    """
    shape = np.nan_to_num(shape)
    alike = _block_medians(np.abs(np.diff(shape, append=shape[-1:])))
    alike *= _ALIKE / (QUARTILE * np.sqrt(2.0))
    shared = (_most_near(shape > alike) | _most_near(shape < -alike)) & (sigma > _SHARP_FROM_PX)
    return np.where(shared, np.fmin(error, alike), error)


def _block_medians(values: Array) -> Array:
    """The median of each block of neighbours, in place of them: a running one takes longer."""
    blocks = -(-values.size // _NEIGHBOURS)
    padded = np.pad(values, (0, blocks * _NEIGHBOURS - values.size), mode="symmetric")
    medians = np.median(padded.reshape(blocks, _NEIGHBOURS), axis=1)
    return np.repeat(medians, _NEIGHBOURS)[: values.size]


def _most_near(mask: NDArray[np.bool_]) -> NDArray[np.bool_]:
    """Where most of the nearest neighbours (L,) are so."""
    return uniform_filter1d(mask.astype(np.float32), _NEXT, mode="nearest") > 0.5


def _moved(at: Peaks, found: Array) -> Peaks:
    """The peaks at other rows, of other widths, heights and backgrounds (4, L)."""
    row, sigma, amplitude, background = found
    return at._replace(row=row, sigma=sigma, amplitude=amplitude, background=background)


def _stepped(near: "_Near", gaussian: Array, at: Peaks, max_sigma: float) -> Array:
    """Row, width, height and background (4, L) after a step to where the fits (4, L) point."""
    background, amplitude, p, q = gaussian
    amplitude = np.maximum(amplitude, 0.05 * at.amplitude)  # a peak stays a peak between steps
    row = near.place + near.sigma * np.clip(p / amplitude, -0.5, 0.5)
    sigma = near.sigma * (1.0 + np.clip(q / amplitude, -0.3, 0.5))
    # What runs away is no line; the detectors will say so.
    row = np.clip(row, at.peak - REACH * at.sigma - 2.0, at.peak + REACH * at.sigma + 2.0)
    sigma = np.clip(sigma, _NARROWEST_PX, 2.0 * max_sigma)
    return np.stack([row, sigma, amplitude, background + near.level])


def _judged(
    near: "_Near", gaussian: Array, at: Peaks, noise: Noise
) -> tuple[Array, Array, Array, Array, Array, Array]:
    """Misfit of the fits (4, L); skewness, flatness and step (3, L), and their noise (3, L).

    And the misfit (L,) that the noise makes which was given, infinity if none was; and which part
    of the misfit's changes from row to row lies in two of them; and where neighbours' is lopsided.
    """
    taper, basis, tests = near.design("taper"), near.design("basis"), near.design("tests")
    beyond = np.einsum("lin,ln->il", tests, near.values)
    misfit = near.values - np.einsum("il,lin->ln", gaussian, basis)
    left = np.einsum("ln,ln->l", taper * misfit, misfit)
    weight = taper.sum(axis=1)
    pair = np.minimum(taper[:, 1:], taper[:, :-1])
    change = pair * (misfit[:, 1:] - misfit[:, :-1]) ** 2
    if noise.known:
        variance = noise.variance((at.amplitude[:, None] * basis[:, 1]).T, at.column).T.astype(
            np.float32
        )
        errors = np.einsum("lin,lin,ln->il", tests, tests, variance)
        expected = np.sqrt(np.einsum("ln,ln->l", taper, variance) / weight)
    else:
        hermite = (beyond[:2] ** 2 / near.design("left").T).sum(axis=0)
        whole = np.maximum(left - hermite, 0.0) / np.maximum(weight - 6.0, 1.0)
        measured = _noise_variance(change, pair, near.sigma, whole)
        errors = near.design("spread").T * np.maximum(measured, noise.dark[at.column] ** 2)
        expected = np.full(at.row.size, np.inf)
    height = np.where(gaussian[1] > 0.0, gaussian[1], np.nan)
    shape = beyond / height * [[1.0], [-1.0], [1.0]]
    residual = np.sqrt(left / np.maximum(weight - 4.0, 1.0))
    change *= pair  # less of the window's ends, where there are but few of these
    most = (change[:, 1:] + change[:, :-1]).max(axis=1)
    abrupt = most / np.maximum(change.sum(axis=1), np.finfo(np.float32).tiny)
    uneven = _uneven(taper * misfit, height)
    return residual, shape, np.sqrt(errors) / height, expected, abrupt, uneven


def _uneven(misfit: Single, height: Single) -> Array:
    """Lopsided part (L,) of the mean misfit (L, n) of neighbours, where it is not by chance."""
    count, rows = misfit.shape
    blocks = count // _BLOCK
    if not blocks:
        return np.zeros(count)
    half = rows // 2
    odd = misfit[:, :half] - misfit[:, : -half - 1 : -1]
    parts = odd[: blocks * _BLOCK].reshape(blocks, _BLOCK, half)
    mean = parts.mean(axis=1)
    square = np.einsum("bki,bki->b", parts, parts) / _BLOCK
    noise = (square - np.einsum("bi,bi->b", mean, mean)) / (_BLOCK - 1)
    tops = height[: blocks * _BLOCK].reshape(blocks, _BLOCK).mean(axis=1)
    found = np.zeros(blocks)
    for several in (1, 4):
        wide = uniform_filter1d(mean, several, axis=0, mode="nearest")
        power = np.einsum("bi,bi->b", wide, wide)
        chance = uniform_filter1d(noise, several, mode="nearest") / several
        share = np.sqrt(power / (2.0 * rows)) / tops
        certain = (share > _LOPSIDED) & (power > _CERTAIN * chance)
        found = np.maximum(found, np.where(certain, share, 0.0))
    return np.pad(np.repeat(found, _BLOCK), (0, count - blocks * _BLOCK), mode="edge")


def _groups(sigma: Array) -> list[tuple[Index, int]]:
    """Peaks of about one width, and the half height of their windows in rows."""
    group = _width(sigma) // _IN_GROUP
    return [(np.flatnonzero(group == each), _half(int(each))) for each in np.unique(group)]


def _width(sigma: Array) -> Index:
    """Number of the tabulated width that is nearest."""
    return np.rint(_WIDTHS * np.log2(sigma / _NARROWEST_PX)).astype(int)


def _half(group: int) -> int:
    broadest = _NARROWEST_PX * 2.0 ** ((group + 1) * _IN_GROUP / _WIDTHS)
    return int(np.ceil(REACH * max(broadest, 1.0)))


def _tabulated(width: Index) -> Array:
    return _NARROWEST_PX * 2.0 ** (width / _WIDTHS)


def _near(image: NDArray, at: Peaks, half: int) -> _Near:
    """What lies near peaks of one group."""
    middle = np.rint(at.row).astype(int)
    phase = np.rint((at.row - middle) * _PHASES).astype(int)
    width = _width(at.sigma)
    values = windows(image, at.column, middle - half, 2 * half + 1) - at.background[:, None]
    group = int(width[0]) // _IN_GROUP
    entry = (width - _IN_GROUP * group) * (_PHASES + 1) + phase + _PHASES // 2
    table, place, sigma = _table(group, half), phase / _PHASES, _tabulated(width)
    cut = np.flatnonzero((middle < half) | (middle + half >= len(image)))
    of_cut = table
    if cut.size:
        offset = np.arange(-half, half + 1)
        rows = middle[cut, None] + offset
        inside = (rows >= 0) & (rows < len(image))
        of_cut = _design(offset, place[cut], sigma[cut], inside)
    above = values.astype(np.float32)
    return _Near(middle + place, sigma, at.background, above, table, entry, cut, of_cut)


@lru_cache(maxsize=64)
def _table(group: int, half: int) -> _Design:
    """Designs of a group's widths and all phases, with the phase as the faster index."""
    phase = np.arange(-_PHASES // 2, _PHASES // 2 + 1) / _PHASES
    sigma = _tabulated(_IN_GROUP * group + np.arange(_IN_GROUP))
    offset = np.arange(-half, half + 1)
    place, width = np.tile(phase, sigma.size), np.repeat(sigma, phase.size)
    return _design(offset, place, width, np.ones((place.size, offset.size), bool))


def _design(offset: Index, place: Array, sigma: Array, inside: NDArray[np.bool_]) -> _Design:
    away = (offset[:, None] - place).T
    rows = np.repeat(offset[:, None], place.size, axis=1)
    gaussian = np.moveaxis(pixel_gaussian(rows, place, sigma), -1, 0)
    z = (away / sigma[:, None])[:, None]
    hermite = np.concatenate([z**3 - 3.0 * z, z**4 - 6.0 * z**2 + 3.0], axis=1)
    basis = np.concatenate([gaussian, hermite * gaussian[:, 1:2]], axis=1)
    reach = np.maximum(sigma, 1.0)[:, None]
    taper = np.clip(REACH - np.abs(away) / reach, 0.0, 1.0) * inside
    four, six = (_solved(basis[:, :k], taper) for k in (4, 6))
    step = np.zeros_like(taper)
    for sign in (1.0, -1.0):
        side = (taper > 0.0) & (sign * away > _OUTER * reach)
        step += sign * side / np.maximum(side.sum(axis=1, keepdims=True), 1)
    # Where the image cuts a side off there is no level to compare with.
    step *= (inside | (np.abs(away) > REACH * reach)).all(axis=1, keepdims=True)
    tests = np.concatenate([six[:, 4:], step[:, None]], axis=1)
    normal = np.einsum("lin,ln,ljn->lij", basis, taper, basis) + _RIDGE * np.eye(6)
    left = np.linalg.inv(normal)[:, [4, 5], [4, 5]]
    parts = (taper, basis[:, :4], four, tests, left, (tests**2).sum(axis=2))
    return _Design(*(part.astype(np.float32, order="C") for part in parts))


def _solved(basis: Array, taper: Array) -> Array:
    """Weights (L, k, n) that give the coefficients of a basis (L, k, n) by least squares."""
    weighted = taper[:, None] * basis
    normal = np.einsum("lin,ljn->lij", weighted, basis) + _RIDGE * np.eye(basis.shape[1])
    return np.linalg.solve(normal, weighted)


def _local(residual: Array, sigma: Array) -> Array:
    """The neighbours' median residual, rms: one peak has too few rows to estimate its noise."""
    free = np.maximum(2.0 * REACH * np.maximum(sigma, 1.0) - REACH - 4.0, 1.0)
    local = median_filter(residual**2, _NEIGHBOURS, mode="nearest")
    return np.sqrt(local / median_of_squares(free))


def _noise_variance(change: Array, pair: Single, sigma: Array, whole: Array) -> Array:
    """Of the noise alone: of adjacent rows, in which a wrong shape hardly shows.

    `change` (L, n - 1) are its squares there, with the weights `pair`.  Narrow lines have too few
    rows for that; there the `whole` of the misfit counts.
    """
    rough = change.sum(axis=1) / np.maximum(2.0 * pair.sum(axis=1) - 6.0, 1.0)
    return np.where(sigma < _ROUGH_FROM_PX, np.maximum(rough, whole), rough)
