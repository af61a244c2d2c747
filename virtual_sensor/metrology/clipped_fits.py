"""Centres of clipped lines: a Gaussian whose clipped pixels are only known to be at least so high.

Each clipped pixel adds the probability that its grey value reaches the saturation: a censored
regression (Tobin 1958, "Estimation of relationships for limited dependent variables", Econometrica
26, 24).  The flanks that are left carry nearly all of what the whole profile says of its place.
Newton's method with Levenberg's damping, all columns at once.

A line whose flanks are no Gaussian's, as where pixels bloom or glow lies beside the line, has its
centre midway between its flanks, at heights that both of them pass.
"""

from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray
from scipy.ndimage import median_filter
from scipy.special import log_ndtr

from virtual_sensor.metrology.centres import Status
from virtual_sensor.metrology.line_profiles import (
    MIN_SIGMA_PX,
    QUARTILE,
    REACH,
    Array,
    Index,
    Noise,
    Peaks,
    Profile,
    by_width,
    median_of_squares,
    pixel_gaussian,
    pixels,
)

Mask = NDArray[np.bool_]

_BLOCK = 700  # peaks at a time, so that a core's cache holds their windows
_CONNECTED = 0.75  # of the clipped height: so high are all pixels of one plateau
_RISE, _RISE_NOISE = 0.03, 5.0  # of it, and of the noise: where a flank rises, other light begins
_STARTS = (0.8, 0.3)  # of it: heights at which the flanks say where a fit begins
_BESIDE = 3.0  # sigma beyond the plateau that a fit counts; the outermost is tapered
_STEPS, _TOLERANCE = 40, 0.02  # the last step, in the centre's predicted error
_NARROWEST_PX, _MOST_LOG_HEIGHT = 0.3, 14.0
_LEVELS = np.linspace(0.2, 0.8, 7)  # of what both flanks pass: where their middles are taken
_SEEN_PX, _MIDDLE = 0.1, 0.05  # the least error of such a middle, and of half the plateau
_MISFIT, _MISFIT_NOISE = 0.04, 2.5  # of the clipped height, and of the noise: no Gaussian beyond
_SHORT = 0.15  # of it: no clipped pixel of a Gaussian should be so much lower
_LEAST_NOISE = 1e-6  # of the clipped height: an image without noise has some
_EXCESS = 1.5  # times the given variance: from there on that of the misfit is used
_CLEARLY = 3.0  # standard errors
_UNSURE_PX, _UNSURE = 1.0, 0.3  # and widths: the largest error of a centre
_IN_VIEW = 2.5  # sigma of a line on either side that lie in the image
_FARTHEST = 1e6  # sigma from the saturation: beyond it squares are too large
_RIDGE, _LEAST_SEEN = 1e-10, 1e-20  # of a normal matrix's diagonal, and of its largest value
_FLAT, _DROP, _STEPS_DOWN = 3, 0.1, 4.0  # rows; of the height and grey values: no Gaussian has such
_FEWEST_FLAT, _SOME_FLAT = 8, 0.05  # columns, and of those that reach the highest value
_MOST_COLUMNS = 512  # in which a picture is looked at
_UNEVEN, _DEEPEST = 0.03, 0.02  # of the plateaus' pixels, and of their height
_NEIGHBOURS = 31
_ALIKE = (_NEIGHBOURS, 3.0), (201, 2.0)  # columns, and standard errors of what they share


def clipping_level(image: NDArray, saturation: float) -> float:
    """Grey value from which on an image's pixels are clipped, where it shows less than was said.

    A camera's converter, or a picture's range, may end below what its type can hold: then many
    columns have flat tops of the image's highest value, beside which it drops.  A picture that was
    compressed is no longer flat where it was clipped: what varies there is clipped too.

    Parameters
    ----------
    image : ndarray of shape (H, W)
        Finite.
    saturation : float
        As it is said; infinity where nothing is.
    """
    tops = image.max(axis=0)
    most = float(tops.max())
    if most < saturation:
        columns = np.flatnonzero(tops == most)
        if columns.size < _FEWEST_FLAT or len(image) < _FLAT + 2:
            return saturation
        if _flat_tops(image[:, columns], most) < max(_FEWEST_FLAT, _SOME_FLAT * columns.size):
            return saturation
        saturation = most
    columns = np.flatnonzero(tops >= saturation)
    columns = columns[:: -(-columns.size // _MOST_COLUMNS)]
    values = image[:, columns].astype(float)
    level = np.median(values, axis=0)
    row = np.arange(len(values))[:, None]
    clipped = values >= saturation
    other = values < level + _CONNECTED * (saturation - level)
    within = ~other
    for step in (1, -1):  # between clipped pixels of one plateau
        of_plateau, beside = (
            np.maximum.accumulate(np.where(mask[::step], row, -1))[::step]
            for mask in (clipped, other)
        )
        within &= of_plateau > beside
    if np.mean(~clipped[within]) < _UNEVEN:
        return saturation
    lowest = saturation - _DEEPEST * (saturation - float(np.median(level)))
    return max(float(np.quantile(values[within], _UNEVEN)), lowest)


def _flat_tops(values: NDArray, most: float) -> int:
    """How many columns have several rows of the highest value, and drop beside them."""
    at = np.arange(len(values))[:, None]
    top = values == most
    first, last = np.where(top, at, len(values)).min(axis=0), np.where(top, at, -1).max(axis=0)
    whole = (last - first + 1 >= _FLAT) & (top.sum(axis=0) == last - first + 1)
    whole &= (first > 0) & (last < len(values) - 1)
    column = np.flatnonzero(whole)
    beside = np.maximum(values[first[column] - 1, column], values[last[column] + 1, column])
    drop = _DROP * (most - np.median(values[:, column], axis=0))
    if values.dtype.kind == "u":
        drop = np.maximum(drop, _STEPS_DOWN)
    return int(np.sum(most - beside.astype(float) >= drop))


class ClippedFits(NamedTuple):
    """What the fits say of L clipped peaks: arrays of shape (L,).

    `height_error` is the standard deviation of the amplitude's logarithm; infinite where unknown.
    """

    profile: Profile
    status: Index
    height_error: Array


class _Plateaus(NamedTuple):
    """Pixels (n, L) about L plateaus, whose rows count from `origin` (L,).

    `clipped` are a plateau's own, from the first of `ends` (2, L) to the last; `flanks` those above
    and below it up to where another light begins, with the least value `foot` (2, L) of either.
    """

    origin: Index
    values: Array
    clipped: Mask
    flanks: Mask
    ends: Index
    foot: Array
    saturation: float

    def take(self, chosen: Mask) -> "_Plateaus":
        """Some of them."""
        return _Plateaus._make([*(values[..., chosen] for values in self[:-1]), self.saturation])

    @property
    def height(self) -> Array:
        """Of the saturation above the feet of the flanks."""
        return self.saturation - self.foot.mean(axis=0)

    @property
    def seen(self) -> Mask:
        """Where the peak is clipped, and both its flanks are in view."""
        first, last = self.ends
        row = np.arange(len(self.values))[:, None]
        above, below = (np.any(self.flanks & side, axis=0) for side in (row < first, row > last))
        return above & below & self.clipped.any(axis=0) & (self.height > 0.0)

    @property
    def hot(self) -> Mask:
        """Where one pixel alone is clipped, and no line's: a pixel beside it is less than half."""
        first, last = self.ends
        line = np.arange(first.size)
        beside = np.minimum(self.values[first - 1, line], self.values[last + 1, line])
        return (first == last) & (beside < self.saturation - 0.5 * self.height)

    def crossings(self, level: Array) -> Array:
        """Rows (2, L) between which the values are beyond levels (L,), to parts of a pixel."""
        count, lines = self.values.shape
        row, line = np.arange(count)[:, None], np.arange(lines)
        under = self.values < level
        first, last = self.ends
        above = np.where(under & (row < first), row, 0).max(axis=0)
        below = np.where(under & (row > last), row, count - 1).min(axis=0)
        found = np.empty((2, lines))
        for number, (outer, step) in enumerate(((above, 1), (below, -1))):
            low, high = self.values[outer, line], self.values[outer + step, line]
            high = np.minimum(high, self.saturation)
            part = (level - low) / np.where(high > low, high - low, np.inf)
            found[number] = outer + step * np.clip(part, 0.0, 1.0)
        return found


class _Fit(NamedTuple):
    """L fits: arrays of shape (L,)."""

    row: Array
    sigma: Array
    amplitude: Array
    background: Array
    error: Array  # of the row
    height_error: Array
    shift: Array  # of the row, where the flanks may differ in width,
    doubt: Array  # and its standard deviation
    excess: Array  # of the misfit's variance over the noise's
    free: Array  # pixels beyond those that determine the parameters
    misfit: Array  # rms
    noise: Array  # at half the height
    middle: Array  # between the flanks,
    spread: Array  # and its error
    half: Array  # rows of half the plateau
    height: Array  # of the saturation


def fit_clipped(
    image: NDArray, at: Peaks, noise: Noise, saturation: float, max_sigma: float
) -> ClippedFits:
    """Fit L peaks whose pixels are clipped from `saturation` on, or say why that can't be.

    Parameters
    ----------
    image : ndarray of shape (H, W)
    at : Peaks
    noise : Noise
    saturation : float
    max_sigma : float
        Broadest line in px.
    """
    values = np.full((len(_Fit._fields), at.row.size), np.nan)
    for group in by_width(at.sigma):
        each = np.flatnonzero(group)
        for some in np.array_split(each, -(-each.size // _BLOCK)):
            peaks = at.take(some)
            plateaus = _plateaus(image, peaks, noise, saturation)
            seen = plateaus.seen
            fit = _fitted(plateaus.take(seen), peaks.take(seen), noise, max_sigma)
            values[:, some[seen]] = fit
    return _judged(_Fit(*values), at, len(image), max_sigma)


def _plateaus(image: NDArray, at: Peaks, noise: Noise, saturation: float) -> _Plateaus:
    half = int(np.ceil(REACH * max(at.sigma.max(initial=0.0), 1.0))) + 4
    origin = np.rint(at.row).astype(int) - half
    row = np.arange(2 * half + 1)[:, None]
    inside = (origin + row >= 0) & (origin + row < len(image))
    values = pixels(image, origin + row, at.column).astype(float)
    connected = values >= at.background + _CONNECTED * (saturation - at.background)
    peak = at.peak - origin
    before = np.where(~connected & (row < peak), row, -1).max(axis=0)
    behind = np.where(~connected & (row > peak), row, len(row)).min(axis=0)
    clipped = inside & (values >= saturation) & (row > before) & (row < behind)
    first = np.where(clipped, row, len(row)).min(axis=0)
    last = np.where(clipped, row, -1).max(axis=0)
    flanks, foot = np.zeros(values.shape, bool), np.empty((2, at.row.size))
    rise = _RISE * (saturation - at.background)
    for number, (side, step) in enumerate(((row < first, -1), (row > last, 1))):
        # From the plateau outwards.
        lit, values_there = (inside & side)[::step], values[::step]
        least = np.minimum.accumulate(np.where(lit, values_there, np.inf), axis=0)
        signal = np.minimum(least, saturation) - at.background
        allowed = rise + _RISE_NOISE * np.sqrt(noise.variance(signal, at.column))
        ended = np.logical_or.accumulate(lit & (values_there > least + allowed), axis=0)
        flanks |= (lit & ~ended)[::step]
        foot[number] = np.where(lit & ~ended, values_there, np.inf).min(axis=0)
    return _Plateaus(origin, values, clipped, flanks, np.stack([first, last]), foot, saturation)


def _fitted(at: _Plateaus, peaks: Peaks, noise: Noise, max_sigma: float) -> _Fit:
    """The fits of L plateaus that show both flanks."""
    middle, spread = _between_flanks(at, noise, peaks.column)
    start, weight = _started(at)
    used = np.flatnonzero((at.clipped | (weight > 0.0)).any(axis=1))
    rows = slice(used[0], used[-1] + 1) if used.size else slice(0)
    problem = _Problem(
        np.arange(len(at.values))[rows, None],
        at.values[rows],
        at.clipped[rows],
        weight[rows],
        at.height,
        at.saturation,
        np.maximum(noise.dark[peaks.column], _LEAST_NOISE * at.height) ** 2,
        np.full(at.height.size, noise.gain),
    )
    if not noise.known:  # a first fit shows how it grows with the signal
        problem = problem._replace(gain=_MISFIT**2 * at.height)
        start = _likeliest(problem, start, max_sigma)
        problem = problem._replace(gain=problem.gain_shown(start))
    found = _likeliest(problem, start, max_sigma)
    if noise.known:  # beyond a knee-point it is more than the sensor says
        noisier = _local(*problem.misfit(found)[:2]) > _EXCESS
        if noisier.any():
            gain = np.maximum(problem.gain, problem.gain_shown(found))
            problem = problem._replace(gain=np.where(noisier, gain, problem.gain))
            found = _likeliest(problem, found, max_sigma)
    background, log_height, place, log_sigma = found
    return _Fit(
        at.origin + place,
        np.exp(log_sigma),
        at.height * np.exp(log_height),
        at.height * background,
        *problem.errors(found),
        *problem.misfit(found),
        np.sqrt(noise.variance(0.5 * at.height, peaks.column)),
        at.origin + middle,
        spread,
        0.5 * (at.ends[1] - at.ends[0] + 1.0),
        at.height,
    )


def _between_flanks(at: _Plateaus, noise: Noise, column: Index) -> tuple[Array, Array]:
    """Where the middle between both flanks is, and its error: (L,) each."""
    lowest = at.foot.max(axis=0)
    room = at.saturation - lowest
    passed = np.stack([at.crossings(lowest + part * room) for part in _LEVELS])  # (levels, 2, L)
    middles = passed.mean(axis=1)
    steep = (_LEVELS[-1] - _LEVELS[0]) * room / np.maximum(np.abs(passed[0] - passed[-1]), 0.5)
    grain = np.sqrt(noise.variance(0.5 * room, column))
    of_noise = np.sqrt(((grain / steep) ** 2).sum(axis=0)) / 2.0
    spread = np.sqrt(middles.var(axis=0) + of_noise**2 + _SEEN_PX**2)
    return middles.mean(axis=0), np.where(at.hot, np.inf, spread)


def _started(at: _Plateaus) -> tuple[Array, Array]:
    """Where a fit begins (4, L), by the widths at two heights; and what each pixel counts."""
    foot = at.foot.mean(axis=0)
    high, low = (at.crossings(foot + part * at.height) for part in _STARTS)
    wide, wider = (0.5 * (below - above) for above, below in (high, low))
    drop = 2.0 * np.log(_STARTS[0] / _STARTS[1])
    sigma = np.sqrt(np.maximum((wider**2 - wide**2) / drop, 0.25))
    sigma = np.clip(sigma, MIN_SIGMA_PX, np.maximum(1.2 * wide, 0.6))
    log_height = np.clip(0.5 * (wide / sigma) ** 2 + np.log(_STARTS[0]), -0.2, _MOST_LOG_HEIGHT)
    place = 0.25 * (high + low).sum(axis=0)
    reach = np.maximum(REACH * sigma, wide + _BESIDE * sigma)
    away = np.abs(np.arange(len(at.values))[:, None] - place)
    weight = at.flanks * np.clip((reach - away) / np.maximum(sigma, 1.0), 0.0, 1.0)
    return np.stack([foot / at.height, log_height, place, np.log(sigma)]), weight


class _Problem(NamedTuple):
    """L censored fits: pixels (n, L) at rows (n, 1), and what each counts.

    The parameters (4, L) are the background and the logarithm of the amplitude, relative to
    `height`, the place, and the logarithm of the width.
    """

    row: Index
    values: Array
    clipped: Mask
    weight: Array
    height: Array
    saturation: float
    dark: Array  # variance of the noise without signal,
    gain: Array  # and its growth with it

    def take(self, chosen: Index) -> "_Problem":
        """Some of them."""
        return self._replace(
            values=self.values[:, chosen],
            clipped=self.clipped[:, chosen],
            weight=self.weight[:, chosen],
            height=self.height[chosen],
            dark=self.dark[chosen],
            gain=self.gain[chosen],
        )

    def model(self, found: Array) -> tuple[Array, Array, Array]:
        """Expected values, their variance, and derivatives (4, n, L): by shifts in sigma."""
        background, log_height, place, log_sigma = found
        rows = self.row + np.zeros(self.values.shape[1], int)
        basis = pixel_gaussian(rows, place, np.exp(log_sigma))
        basis[1:] *= self.height * np.exp(log_height)
        basis[0] = self.height
        signal = np.clip(basis[1], 0.0, self.height)
        return self.height * background + basis[1], self.dark + self.gain * signal, basis

    def beyond(self, mean: Array, variance: Array) -> tuple[Array, Array, Array]:
        """Of clipped pixels: their log likelihood, its first derivative and minus its second."""
        spread = np.sqrt(variance[self.clipped])
        z = np.clip((mean[self.clipped] - self.saturation) / spread, -_FARTHEST, _FARTHEST)
        log_share = log_ndtr(z)
        ratio = np.exp(-0.5 * z**2 - log_share) / np.sqrt(2.0 * np.pi)
        bend = np.where(z > -100.0, ratio * (ratio + z), 1.0)  # beyond, the sum would cancel
        return log_share, ratio / spread, np.clip(bend, 0.0, 1.0) / spread**2

    def cost(self, mean: Array, variance: Array) -> Array:
        """Minus the log likelihood (L,), with the variance as it is given."""
        lost = 0.5 * self.weight * (self.values - mean) ** 2 / variance
        lost[self.clipped] = -self.beyond(mean, variance)[0]
        return lost.sum(axis=0)

    def pull(self, mean: Array, variance: Array) -> tuple[Array, Array]:
        """Gradient of the log likelihood by the mean of each pixel (n, L), and its information."""
        information = self.weight / variance
        gradient = information * (self.values - mean)
        _, gradient[self.clipped], information[self.clipped] = self.beyond(mean, variance)
        return gradient, information

    def errors(self, found: Array) -> tuple[Array, Array, Array, Array]:
        """Standard deviations of the row and of the amplitude's logarithm: (L,) each.

        And by how much the row would shift if the flanks had widths of their own, and how sure
        that is: a step towards that fit.
        """
        mean, variance, slopes = self.model(found)
        gradient, information = self.pull(mean, variance)
        lopsided = slopes[3] * np.sign(self.row - found[2])
        slopes = np.concatenate([slopes, lopsided[None]])
        normal = _normal(slopes, information)
        sigma = np.exp(found[3])
        least, most = (np.linalg.inv(part) for part in (normal[:, :4, :4], normal))
        height_error, place_error = np.sqrt(np.abs(least[:, [1, 2], [1, 2]].T))
        pulled = (lopsided * gradient).sum(axis=0)
        certain = np.sqrt(np.maximum(np.abs(most[:, 4, 4]), np.finfo(float).tiny))
        moved = sigma * most[:, 2, 4]
        shift, doubt = np.clip([moved * pulled, np.abs(moved) / certain], -_FARTHEST, _FARTHEST)
        return sigma * place_error, height_error, shift, doubt

    def gain_shown(self, found: Array) -> Array:
        """Growth of the noise's variance with the signal, as the neighbours' misfits show it."""
        mean, variance, slopes = self.model(found)
        _, information = self.pull(mean, variance)
        inverse = np.linalg.inv(_normal(slopes, information))
        fitted = information * np.einsum("inl,lij,jnl->nl", slopes, inverse, slopes, optimize=True)
        left = self.weight * np.clip(1.0 - fitted, 0.0, 1.0)
        lit = left * np.clip(slopes[1], 0.0, self.height)
        squares = self.weight * (self.values - mean) ** 2 - left * self.dark
        weight = np.maximum(lit.sum(axis=0), _LEAST_NOISE * self.height)
        gain = np.maximum(squares.sum(axis=0), 0.0) / weight
        return _local(gain, weight**2 / np.maximum((lit**2).sum(axis=0), weight**2 / len(lit)))

    def misfit(self, found: Array) -> tuple[Array, Array, Array]:
        """Misfit beside the clipped pixels: relative to the noise, squared; free pixels; rms.

        Infinity where a pixel is clipped that should be far from it.
        """
        mean, variance, _ = self.model(found)
        squares = self.weight * (self.values - mean) ** 2
        short = np.where(self.clipped, self.saturation - mean, 0.0).max(axis=0, initial=0.0)
        pixels = self.weight.sum(axis=0)
        free = np.maximum(pixels - 4.0, 1.0)
        excess = (squares / variance).sum(axis=0) / free
        misfit = np.sqrt(squares.sum(axis=0) / free)
        return excess, free, np.where(short > _SHORT * self.height, np.inf, misfit)


def _local(squares: Array, free: Array) -> Array:
    """The mean of squares (L,) of so many free values each, by the median of the neighbours."""
    middle = median_of_squares(np.maximum(free, 1.0))
    return median_filter(squares / middle, _NEIGHBOURS, mode="reflect")


def _shared(shift: Array, doubt: Array) -> Array:
    """By how much a shift (L,) that near or far neighbours share is clearly more than none."""
    found = np.zeros(shift.size)
    for neighbours, clearly in _ALIKE if shift.size else ():
        shared, unsure = (median_filter(x, neighbours, mode="reflect") for x in (shift, doubt))
        error = np.sqrt(np.pi / 2.0 / min(neighbours, shift.size)) * unsure
        found = np.maximum(found, np.abs(shared) - clearly * error)
    return found


def _unsteady(row: Array) -> Array:
    """By how much rows (L,) scatter about those of their neighbours: twice differenced."""
    if row.size < _FEWEST_FLAT:
        return np.zeros(row.size)
    change = np.abs(np.diff(row, 2, prepend=row[:1], append=row[-1:]))
    return median_filter(change, _NEIGHBOURS, mode="reflect") / (QUARTILE * np.sqrt(6.0))


def _normal(slopes: Array, information: Array) -> Array:
    """Normal matrices (L, k, k) of derivatives (k, n, L), never singular."""
    normal: Array = np.einsum("inl,jnl->lij", slopes * information, slopes)
    own = np.einsum("lii->li", normal)
    most = own.max(axis=1, keepdims=True, initial=0.0)
    least = np.where(most > 0.0, _LEAST_SEEN * most, 1.0)  # what is not seen at all has some too
    return normal + (_RIDGE * np.maximum(own, least))[:, None] * np.eye(len(slopes))


def _likeliest(problem: _Problem, start: Array, max_sigma: float) -> Array:
    """The parameters (4, L) that are likeliest, from those with which to start."""
    found, damping = start.copy(), np.full(start.shape[1], 1e-3)
    going = np.arange(damping.size)
    most = np.array([0.3, 1.0, 0.7, 0.4])[:, None]
    low = np.array([-np.inf, -2.0, -np.inf, np.log(_NARROWEST_PX)])[:, None]
    high = np.array([np.inf, _MOST_LOG_HEIGHT, np.inf, np.log(2.0 * max_sigma)])[:, None]
    for _ in range(_STEPS):
        if not going.size:
            break
        here, at = problem.take(going), found[:, going]
        mean, variance, slopes = here.model(at)
        gradient, information = here.pull(mean, variance)
        normal = _normal(slopes, information)
        right = np.einsum("inl,nl->li", slopes, gradient)
        normal += damping[going, None, None] * normal * np.eye(4)
        step = np.linalg.solve(normal, right[:, :, None])[:, :, 0].T
        gain = (step * right.T).sum(axis=0)  # in squared standard errors
        step = np.clip(step, -most, most)
        step[2] *= np.exp(at[3])
        trial = np.clip(at + step, low, high)
        better = here.cost(here.model(trial)[0], variance) <= here.cost(mean, variance)
        found[:, going[better]] = trial[:, better]
        damping[going] *= np.where(better, 0.2, 8.0)
        going = going[~((better & (gain < _TOLERANCE**2)) | (damping[going] > 1e8))]
    return found


def is_unsure(error: Array, width: Array) -> Mask:
    """Whether centres of lines so broad (NaN: unknown) may err too much to be centres at all."""
    return ~(error < np.fmax(_UNSURE_PX, _UNSURE * width))


def _judged(fit: _Fit, at: Peaks, rows: int, max_sigma: float) -> ClippedFits:
    """The centres with their errors, and their status."""
    seen = np.isfinite(fit.row)
    excess = np.ones(at.row.size)
    if seen.any():
        local = _local(fit.excess[seen], fit.free[seen])
        local = np.where(local > _EXCESS, local, 1.0)
        clear = fit.excess[seen] > local * (1.0 + _CLEARLY * np.sqrt(2.0 / fit.free[seen]))
        excess[seen] = np.where(clear, fit.excess[seen], local)
    gaussian = fit.misfit <= _MISFIT * fit.height + _MISFIT_NOISE * fit.noise
    gaussian &= fit.sigma <= max_sigma
    doubt = np.sqrt(excess) * fit.doubt
    lopsided = np.maximum(np.abs(fit.shift) - _CLEARLY * doubt, 0.0)
    shared = _shared(fit.shift[gaussian], doubt[gaussian])
    lopsided[gaussian] = np.maximum(lopsided[gaussian], shared)
    error = np.hypot(np.sqrt(excess) * fit.error, lopsided)
    spread = np.hypot(fit.spread, _MIDDLE * fit.half)
    spread[seen] = np.hypot(spread[seen], _unsteady(fit.middle[seen]))
    gaussian &= error <= spread
    row = np.where(gaussian, fit.row, fit.middle)
    error = np.where(gaussian, error, spread)
    width = np.where(gaussian, fit.sigma, np.nan)
    profile = Profile(
        row,
        error,
        width,
        np.where(gaussian, fit.amplitude, np.nan),
        np.where(gaussian, fit.background, np.nan),
    )
    margin = np.fmax(fit.half, _IN_VIEW * width)
    margin, near = np.where(seen, margin, at.sigma), np.where(seen, row, at.row)
    reasons = (
        (Status.AT_BORDER, (near - margin < -0.5) | (near + margin > rows - 0.5)),
        (Status.SATURATED, is_unsure(error, width)),
    )
    status = np.select([so for _, so in reasons], [why for why, _ in reasons], Status.CLIPPED)
    return ClippedFits(profile, status, np.where(gaussian, fit.height_error, np.inf))
