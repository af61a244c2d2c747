"""Sub-pixel centres of a laser line that lies flat in the image: one peak in each column.

A smoothed copy shows where the line is; its centre comes from the untouched pixels, so that the
filter cannot shift it.
"""

from dataclasses import dataclass
from enum import IntEnum

import numpy as np
from numpy.typing import ArrayLike, NDArray

from virtual_sensor.errors import InputError
from virtual_sensor.metrology.line_fits import METHODS, Noise
from virtual_sensor.metrology.line_profiles import (
    MIN_SIGMA_PX,
    REACH,
    Array,
    Index,
    Peaks,
    Profile,
    find_peaks,
    noise_of,
    window,
)
from virtual_sensor.metrology.line_shapes import skewed_and_flat

IN_VIEW = 2.5  # a line counts as seen when so many sigma either side lie in the image
MAX_RESIDUAL = 0.15  # rms misfit, relative to the amplitude, that is still a line
LINE_END_STEP = 0.02  # relative drop of amplitude that betrays a partly lit column
SAME_HEIGHT = 0.7  # from which on a second peak may be the line as well


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
    SKEWED = 8
    """Lopsided: a second line in its skirt, or an edge across it, would shift the centre."""
    DOUBLED = 9
    """Two peaks of much the same height, apart or merged into one flat one."""


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
        What either finds is looked at for a second line and for edges (`line_shapes`).
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
    if method not in METHODS:
        known = " or ".join(repr(name) for name in METHODS)
        raise InputError(f"line_centres: no method {method!r}; take {known}")
    if not 0.0 <= min_amplitude < 1.0:
        raise InputError(f"line_centres: min_amplitude is {min_amplitude}; give it 0 <= ... < 1")
    if not (max_sigma > MIN_SIGMA_PX and shot_noise >= 0.0):
        raise InputError(f"line_centres: give max_sigma > {MIN_SIGMA_PX} px and shot_noise >= 0")

    finite = np.isfinite(image)
    filled = image if finite.all() else np.where(finite, image, image[finite].min(initial=0))
    noise = Noise(noise_of(filled), shot_noise)
    peaks = find_peaks(filled, noise.dark, min_amplitude, max_sigma)

    status = np.where(finite.any(axis=0), Status.NO_PEAK, Status.BAD_PIXELS).astype(np.uint8)
    status[peaks.column] = _screen(image, peaks, saturation_level(image, saturation), max_sigma)
    peaks = peaks.take(status[peaks.column] == Status.OK)

    found = np.full((len(Profile._fields), status.size), np.nan)
    octave = np.ceil(np.log2(peaks.sigma))  # so that one broad peak widens no other's window
    for group in (peaks.take(octave == each) for each in np.unique(octave)):
        profile = METHODS[method](image, group, noise, max_sigma)
        status[group.column] = _judge(image, profile, group, noise)
        found[:, group.column] = profile

    found[:, status != Status.OK] = np.nan
    status[_line_ends(status, Profile(*found)) & (status == Status.OK)] = Status.LINE_END
    found[:, status != Status.OK] = np.nan
    return LineCentres(np.arange(status.size), *Profile(*found)[:-1], status)


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


def _screen(image: NDArray, at: Peaks, saturation: float, max_sigma: float) -> Index:
    """Status of each peak before any fit: (L,)."""
    rows, inside, values = window(image, at)
    near = inside & (np.abs(rows - at.row) <= REACH * np.maximum(at.sigma, 1.0))
    reasons = {
        Status.BAD_PIXELS: (near & ~np.isfinite(values)).any(axis=0),
        Status.SATURATED: (near & (values >= saturation)).any(axis=0),
        Status.AT_BORDER: (at.peak == 0) | (at.peak == len(image) - 1),
        Status.POOR_FIT: at.sigma > max_sigma,
        Status.DOUBLED: at.second > SAME_HEIGHT,
    }
    return np.select(list(reasons.values()), list(reasons), Status.OK)


def _judge(image: NDArray, profile: Profile, at: Peaks, noise: Noise) -> Index:
    """Status of each fitted column: (L,)."""
    margin = IN_VIEW * profile.sigma
    in_view = (profile.row - margin >= -0.5) & (profile.row + margin <= len(image) - 0.5)
    misfit = profile.residual > MAX_RESIDUAL * profile.amplitude + 2.0 * noise.dark
    skewed, flat = skewed_and_flat(image, profile, at, noise)
    reasons = {
        # In noise a line too narrow may seem broad enough: its error then is large.
        Status.TOO_NARROW: profile.sigma - np.nan_to_num(profile.row_error) < MIN_SIGMA_PX,
        Status.POOR_FIT: np.isnan(profile.row) | misfit,
        Status.AT_BORDER: ~in_view,
        Status.DOUBLED: flat,
        Status.SKEWED: skewed,
    }
    return np.select(list(reasons.values()), list(reasons), Status.OK)


def _line_ends(status: NDArray[np.uint8], profile: Profile) -> NDArray[np.bool_]:
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
