"""Sub-pixel centres of a laser line that lies flat in the image: one peak in each column.

A smoothed copy shows where the line is; its centre comes from the untouched pixels, so that the
filter cannot shift it.
"""

from dataclasses import dataclass
from enum import IntEnum
from typing import NamedTuple

import cv2
import numpy as np
from numpy.typing import ArrayLike, NDArray
from scipy.ndimage import median_filter
from scipy.special import ndtr

from virtual_sensor.errors import InputError

Array = NDArray[np.float64]
Index = NDArray[np.intp]

SMOOTHING_PX = 1.5  # sigma of the filter that the coarse search runs on
SIGNIFICANCE = 6.0  # a peak stands out by so many sigma of the smoothed noise
REACH = 4.0  # half width of the fit's window in sigma; the outermost sigma is tapered
IN_VIEW = 2.5  # a line counts as seen when so many sigma either side lie in the image
MIN_SIGMA_PX = 0.5  # below it the pixels no longer sample the profile
MAX_RESIDUAL = 0.3  # rms misfit, relative to the amplitude, that is still a line
LINE_END_STEP = 0.02  # relative drop of amplitude that betrays a partly lit column
TOLERANCE = 1e-5  # in sigma: the last Gauss-Newton step
MAX_STEPS = 40


class Status(IntEnum):
    """Why a column has a centre, or has none."""

    OK = 0
    NO_PEAK = 1
    SATURATED = 2
    TOO_NARROW = 3
    AT_BORDER = 4
    LINE_END = 5
    POOR_FIT = 6
    BAD_PIXELS = 7


@dataclass(frozen=True)
class LineCentres:
    """The line's centre in every column of an image of W columns; NaN where `status` is not OK.

    Attributes
    ----------
    column : ndarray of shape (W,)
        u in px, 0 ... W-1.
    row : ndarray of shape (W,)
        v of the centre in px, integer at pixel centres.
    sigma : ndarray of shape (W,)
        Standard deviation along the column in px, before the pixels integrate the profile.
    amplitude, background : ndarray of shape (W,)
        Height of that profile above the level below it, and that level, in the image's unit.
    row_error : ndarray of shape (W,)
        Standard error of `row` in px, from the fit's residuals or the image's noise.
    status : ndarray of shape (W,)
        `Status` of each column.
    """

    column: Index
    row: Array
    sigma: Array
    amplitude: Array
    background: Array
    row_error: Array
    status: NDArray[np.uint8]

    @property
    def pixel(self) -> Array:
        """The centres as pixels (u, v), shape (W, 2); NaN where there is none."""
        u = np.where(self.status == Status.OK, self.column, np.nan)
        return np.stack([u, self.row], axis=-1)


class _Peaks(NamedTuple):
    """Where L lit columns have their peak and about what it looks like: arrays of shape (L,)."""

    column: Index
    peak: Index
    row: Array
    sigma: Array
    amplitude: Array
    background: Array

    def take(self, chosen: NDArray) -> "_Peaks":
        return _Peaks(*(values[chosen] for values in self))


class _Profile(NamedTuple):
    """What an estimator says about L columns: arrays of shape (L,); NaN where it fails."""

    row: Array
    sigma: Array
    amplitude: Array
    background: Array
    row_error: Array
    residual: Array


def line_centres(
    image: ArrayLike,
    method: str = "gaussian",
    *,
    min_amplitude: float = 0.01,
    saturation: float | None = None,
    max_sigma: float = 32.0,
    shot_noise: float = 0.0,
) -> LineCentres:
    """Find the centre of a laser line in every column of an image.

    Parameters
    ----------
    image : array_like of shape (H, W)
        Grey values: uint8, uint16, float32 or float64.  NaN and infinity mark missing pixels.
    method : {"gaussian", "log_parabola"}
        "gaussian" fits a pixel-integrated Gaussian on a level background by least squares in a
        window that follows its width; it attains the Cramer-Rao bound.
        "log_parabola" puts a parabola through the logarithms of the three highest rows; its
        bias is d (1 - 4 d^2)/(1440 s^6) px at sub-pixel offset d and width s^2 = sigma^2 + 1/12.
    min_amplitude : float
        Smallest height of a line, relative to the highest in the image.  What stands out by less
        than six sigma of the smoothed noise is no line either.
    saturation : float, optional
        Grey value from which on pixels are clipped: 4095 for a 12-bit camera.  By default the
        largest value of an integer image; a float image has none.
    max_sigma : float
        Broadest line in px; broader peaks are POOR_FIT.
    shot_noise : float
        For "gaussian": growth of the noise's variance per unit of signal, relative to that in the
        dark (EMVA 1288: K / sigma_dark^2 in grey values); 0 is white noise.

    Raises
    ------
    InputError
        Where the image is not a grey image of a known type, or an option is out of its range.
    """
    image = checked_image(image)
    if method not in ("gaussian", "log_parabola"):
        raise InputError(f"line_centres: no method {method!r}; take 'gaussian' or 'log_parabola'")
    if not 0.0 <= min_amplitude < 1.0:
        raise InputError(f"line_centres: min_amplitude is {min_amplitude}; give it 0 <= ... < 1")
    if not (max_sigma > MIN_SIGMA_PX and shot_noise >= 0.0):
        raise InputError(f"line_centres: give max_sigma > {MIN_SIGMA_PX} px and shot_noise >= 0")

    finite = np.isfinite(image)
    filled = image if finite.all() else np.where(finite, image, image[finite].min(initial=0))
    noise = _noise(filled)
    peaks = _find_peaks(filled, noise, min_amplitude, max_sigma)

    status = np.where(finite.any(axis=0), Status.NO_PEAK, Status.BAD_PIXELS).astype(np.uint8)
    status[peaks.column] = _screen(image, peaks, saturation_level(image, saturation), max_sigma)
    peaks = peaks.take(status[peaks.column] == Status.OK)

    found = np.full((len(_Profile._fields), status.size), np.nan)
    octave = np.ceil(np.log2(peaks.sigma))  # so that one broad peak widens no other's window
    for group in (peaks.take(octave == each) for each in np.unique(octave)):
        if method == "gaussian":
            profile = _fit_gaussian(image, group, shot_noise, max_sigma)
        else:
            profile = _log_parabola(image, group, noise)
        status[group.column] = _judge(profile, len(image), noise)
        found[:, group.column] = profile

    found[:, status != Status.OK] = np.nan
    status[_line_ends(status, _Profile(*found)) & (status == Status.OK)] = Status.LINE_END
    found[:, status != Status.OK] = np.nan
    return LineCentres(np.arange(status.size), *_Profile(*found)[:-1], status)


def checked_image(image: ArrayLike) -> NDArray:
    """Return `image` (H, W) as a contiguous array of native byte order, or raise InputError."""
    image = np.asarray(image)
    if image.ndim != 2 or image.size == 0:
        problem = f"image: shape {image.shape} is not (height, width)"
        raise InputError(f"{problem}; give one grey channel, such as image[..., 1]")
    native = image.dtype.newbyteorder("=")
    if native not in (np.uint8, np.uint16, np.float32, np.float64):
        problem = f"image: type {image.dtype} is not uint8, uint16, float32 or float64"
        raise InputError(f"{problem}; convert it with image.astype('float32')")
    return np.ascontiguousarray(image, native)


def saturation_level(image: NDArray, saturation: float | None) -> float:
    """Grey value from which on the pixels of `image` are clipped; infinity where there is none."""
    if saturation is not None:
        return float(saturation)
    return float(np.iinfo(image.dtype).max) if image.dtype.kind == "u" else np.inf


def _noise(image: NDArray) -> float:
    """Estimate the noise's standard deviation from the differences of neighbouring rows."""
    sample = image[:, :: max(1, image.shape[1] // 64)].astype(float)
    steps = np.abs(np.diff(sample, axis=0))
    # The median of their magnitude does not see the few rows that the line covers.
    noise = float(np.median(steps)) / (0.6745 * np.sqrt(2.0)) if steps.size else 0.0
    return max(noise, 12**-0.5) if image.dtype.kind == "u" else noise


def _find_peaks(image: NDArray, noise: float, min_amplitude: float, max_sigma: float) -> _Peaks:
    """Find the highest peak of each column in a smoothed copy, and its width at half height."""
    kernel = cv2.getGaussianKernel(2 * int(4 * SMOOTHING_PX) + 1, SMOOTHING_PX)
    depth = cv2.CV_64F if image.dtype == np.float64 else cv2.CV_32F
    smooth = cv2.sepFilter2D(image, depth, np.ones(1), kernel, borderType=cv2.BORDER_REFLECT_101)

    column = np.arange(image.shape[1])
    peak = smooth.argmax(axis=0)
    top = smooth[peak, column].astype(float)
    sparse = smooth[:: max(1, len(smooth) // 128)]
    quartile = len(sparse) // 4
    background = np.partition(sparse, quartile, axis=0)[quartile].astype(float)
    contrast = top - background
    lit = contrast > max(
        min_amplitude * median_filter(contrast, 3, mode="nearest").max(),  # blind to hot pixels
        SIGNIFICANCE * noise * float(np.linalg.norm(kernel)),
        16.0 * np.finfo(smooth.dtype).eps * np.abs([top, background]).max(),  # rounding
    )

    column, peak, contrast, background = (a[lit] for a in (column, peak, contrast, background))
    half = background + contrast / 2.0
    to_half = np.sqrt(2.0 * np.log(2.0))  # half width at half height in sigma
    farthest = int(2.0 * to_half * np.hypot(max_sigma, SMOOTHING_PX)) + 2
    up = _rows_to(half, smooth, column, peak, -farthest)
    down = _rows_to(half, smooth, column, peak, farthest)
    broadened = (up + down - 1) / 2.0 / to_half
    sigma = np.sqrt(np.maximum(broadened**2 - SMOOTHING_PX**2, MIN_SIGMA_PX**2))
    return _Peaks(column, peak, peak + (down - up) / 2.0, sigma, contrast, background)


def _rows_to(level: Array, image: NDArray, column: Index, peak: Index, farthest: int) -> Index:
    """Count the rows from each peak, up where `farthest` is negative, to the first at `level`."""
    distance = np.zeros_like(peak)
    walking = np.arange(peak.size)
    for reached in range(1, abs(farthest) + 1):
        distance[walking] = reached
        row = peak[walking] + np.sign(farthest) * reached
        inside = (row >= 0) & (row < len(image))
        walking, row = walking[inside], row[inside]
        walking = walking[image[row, column[walking]] > level[walking]]
    return distance


def _window(image: NDArray, at: _Peaks) -> tuple[Index, NDArray[np.bool_], Array]:
    """Rows round each peak, which of them lie in the image, and its values there: (n, L) each."""
    half = int(np.ceil(REACH * max(at.sigma.max(initial=0.0), 1.0)))
    rows = np.rint(at.row).astype(int) + np.arange(-half, half + 1)[:, None]
    inside = (rows >= 0) & (rows < len(image))
    values = image[np.clip(rows, 0, len(image) - 1), at.column].astype(float)
    return rows, inside, values


def _screen(image: NDArray, at: _Peaks, saturation: float, max_sigma: float) -> Index:
    """Status of each peak before any fit: (L,)."""
    rows, inside, values = _window(image, at)
    window = inside & (np.abs(rows - at.row) <= REACH * np.maximum(at.sigma, 1.0))
    reasons = {
        Status.BAD_PIXELS: (window & ~np.isfinite(values)).any(axis=0),
        Status.SATURATED: (window & (values >= saturation)).any(axis=0),
        Status.AT_BORDER: (at.peak == 0) | (at.peak == len(image) - 1),
        Status.POOR_FIT: at.sigma > max_sigma,
    }
    return np.select(list(reasons.values()), list(reasons), Status.OK)


def _judge(profile: _Profile, height: int, noise: float) -> Index:
    """Status of each fitted column: (L,)."""
    margin = IN_VIEW * profile.sigma
    in_view = (profile.row - margin >= -0.5) & (profile.row + margin <= height - 0.5)
    misfit = profile.residual > MAX_RESIDUAL * profile.amplitude + 2.0 * noise
    reasons = {
        Status.TOO_NARROW: profile.sigma < MIN_SIGMA_PX,
        Status.POOR_FIT: np.isnan(profile.row) | misfit,
        Status.AT_BORDER: ~in_view,
    }
    return np.select(list(reasons.values()), list(reasons), Status.OK)


def _fit_gaussian(image: NDArray, at: _Peaks, shot_noise: float, max_sigma: float) -> _Profile:
    """Fit pixel-integrated Gaussians by Gauss-Newton, all columns at once."""
    result = np.full((len(_Profile._fields), at.column.size), np.nan)
    index = np.arange(at.column.size)
    for number in range(MAX_STEPS):
        profile, step = _gauss_newton(image, at, shot_noise)
        done = step < TOLERANCE + 0.02 * profile.row_error / profile.sigma
        result[:, index[done]] = np.array(profile)[:, done]
        near = np.abs(profile.row - at.peak) < REACH * np.maximum(at.sigma, 1.0)
        going = ~done & near & (profile.sigma < 2.0 * max_sigma)
        if not going.any():
            break
        # In noise the window and the fit inside it can chase each other in a cycle of two.
        damping = 1.0 if number < 6 else 0.5
        at = at._replace(
            row=at.row + damping * (profile.row - at.row),
            sigma=at.sigma + damping * (profile.sigma - at.sigma),
            amplitude=profile.amplitude,
        ).take(going)
        index = index[going]
    return _Profile(*result)


def _gauss_newton(image: NDArray, at: _Peaks, shot_noise: float) -> tuple[_Profile, Array]:
    """Take one step; return the new profile and the length of the step in sigma.

    Fitting b + A G + p sigma dG/drow + q sigma dG/dsigma is linear; p/A and q/A are the step.
    """
    rows, inside, values = _window(image, at)
    basis = _pixel_gaussian(rows, at.row, at.sigma)
    taper = inside * np.clip(REACH - np.abs(rows - at.row) / np.maximum(at.sigma, 1.0), 0.0, 1.0)
    weight = taper / (1.0 + shot_noise * at.amplitude * basis[1])

    weighted = weight * basis
    normal = np.einsum("inl,jnl->lij", weighted, basis) + 1e-12 * np.eye(4)  # never singular
    covariance = np.linalg.inv(normal)
    coefficients = np.einsum("lij,jnl,nl->il", covariance, weighted, values, optimize=True)
    background, amplitude, p, q = coefficients
    amplitude = np.maximum(amplitude, 0.05 * at.amplitude)  # a peak stays a peak on its way
    shift = np.clip(p / amplitude, -0.5, 0.5)
    growth = np.clip(q / amplitude, -0.3, 0.5)

    misfit = values - np.einsum("il,inl->nl", coefficients, basis)
    free = np.maximum(taper.sum(axis=0) - 4.0, 1.0)
    variance = (weight * misfit**2).sum(axis=0) / free
    profile = _Profile(
        row=at.row + at.sigma * shift,
        sigma=np.maximum(at.sigma * (1.0 + growth), 0.1),
        amplitude=amplitude,
        background=background,
        row_error=at.sigma / amplitude * np.sqrt(variance * covariance[:, 2, 2]),
        residual=np.sqrt((taper * misfit**2).sum(axis=0) / free),
    )
    return profile, np.hypot(shift, growth)


def _pixel_gaussian(rows: Index, row: Array, sigma: Array) -> Array:
    """1, G = unit Gaussian integrated over a pixel, sigma dG/drow, sigma dG/dsigma: (4, n, L)."""
    lower, upper = (rows - 0.5 - row) / sigma, (rows + 0.5 - row) / sigma
    at_lower, at_upper = np.exp(-(lower**2) / 2.0), np.exp(-(upper**2) / 2.0)
    value = np.sqrt(2.0 * np.pi) * sigma * (ndtr(upper) - ndtr(lower))
    by_row = sigma * (at_lower - at_upper)
    by_sigma = value + sigma * (lower * at_lower - upper * at_upper)
    return np.stack([np.ones_like(value), value, by_row, by_sigma])


def _log_parabola(image: NDArray, at: _Peaks, noise: float) -> _Profile:
    """Three-point Gaussian: a parabola through the logarithms round the highest row."""
    near = np.clip(at.peak + np.arange(-2, 3)[:, None], 1, len(image) - 2)
    top = np.take_along_axis(near, image[near, at.column].argmax(axis=0)[None], axis=0)[0]
    above = image[top + np.arange(-1, 2)[:, None], at.column] - at.background
    usable = (above > 0.0).all(axis=0)
    above = np.where(usable, above, 1.0)
    left, middle, right = np.log(above)
    curvature = left - 2.0 * middle + right
    curvature = np.where(usable & (curvature < 0.0), curvature, np.nan)
    offset = (left - right) / (2.0 * curvature)
    offset = np.where(np.abs(offset) <= 1.0, offset, np.nan)

    broadened = -1.0 / curvature  # s^2 = sigma^2 + 1/12: the pixel adds the variance of its width
    sigma = np.sqrt(np.maximum(broadened - 1.0 / 12.0, 0.01))
    slopes = np.stack([0.5 - offset, 2.0 * offset, -0.5 - offset]) / curvature
    return _Profile(
        row=top + offset,
        sigma=np.where(usable, sigma, 0.0),  # fewer than three rows stand out
        amplitude=np.exp(middle - curvature * offset**2 / 2.0) * np.sqrt(broadened) / sigma,
        background=at.background,
        row_error=noise * np.linalg.norm(slopes / above, axis=0),
        residual=np.zeros_like(offset),
    )


def _line_ends(status: NDArray[np.uint8], profile: _Profile) -> NDArray[np.bool_]:
    """Find columns, at most two at each end of a run of lit ones, that the line only partly covers.

    There the centre is off by slope/2 times the missing part, and the amplitude is not what the
    two columns further in extrapolate to.
    """
    lit = np.concatenate([[False], status != Status.NO_PEAK, [False]])
    change = np.diff(lit.astype(int))
    first, last = np.flatnonzero(change > 0), np.flatnonzero(change < 0) - 1
    beyond = 3  # columns off the image that the look inward may touch
    amplitude = np.pad(profile.amplitude, beyond, constant_values=np.nan)
    # Noise moves the amplitude by about row_error/sigma of itself, its extrapolation by 3 times.
    noise = np.pad(10.0 * profile.row_error / profile.sigma, beyond, constant_values=np.nan)
    ends = np.zeros(amplitude.size, bool)
    for outer, inward in ((first[first > 0], 1), (last[last < status.size - 1], -1)):
        suspect = outer + beyond
        for _ in range(2):
            inner, innermost = suspect + inward, suspect + 2 * inward
            expected = 2.0 * amplitude[inner] - amplitude[innermost]
            allowed = (LINE_END_STEP + noise[inner]) * expected
            whole = np.abs(amplitude[suspect] - expected) <= allowed
            ends[suspect[~whole]] = True
            suspect = inner[~whole]
    return ends[beyond:-beyond]
