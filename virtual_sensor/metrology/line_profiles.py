"""Where columns of an image have their peak: what every line detector starts from."""

from typing import NamedTuple

import cv2
import numpy as np
from numpy.typing import NDArray
from scipy.ndimage import median_filter
from scipy.special import ndtr

Array = NDArray[np.float64]
Index = NDArray[np.intp]

SMOOTHING_PX = 1.5  # sigma of the filter that the coarse search runs on
SIGNIFICANCE = 6.0  # a peak stands out by so many sigma of the smoothed noise
REACH = 4.0  # half width of the fit's window in sigma; the outermost sigma is tapered
MIN_SIGMA_PX = 0.5  # below it the pixels no longer sample the profile


class Peaks(NamedTuple):
    """Where L lit columns have their peak and about what it looks like: arrays of shape (L,)."""

    column: Index
    peak: Index
    row: Array
    sigma: Array
    amplitude: Array
    background: Array
    second: Array  # height of the next peak, relative

    def take(self, chosen: NDArray) -> "Peaks":
        """Some of them."""
        return Peaks(*(values[chosen] for values in self))


class Profile(NamedTuple):
    """What an estimator says about L columns: arrays of shape (L,); NaN where it fails."""

    row: Array
    sigma: Array
    amplitude: Array
    background: Array
    row_error: Array
    residual: Array


def noise_of(image: NDArray) -> float:
    """Estimate the noise's standard deviation from the differences of neighbouring rows."""
    sample = image[:, :: max(1, image.shape[1] // 64)].astype(float)
    steps = np.abs(np.diff(sample, axis=0))
    # The median of their magnitude does not see the few rows that the line covers.
    noise = float(np.median(steps)) / (0.6745 * np.sqrt(2.0)) if steps.size else 0.0
    return max(noise, 12**-0.5) if image.dtype.kind == "u" else noise


def find_peaks(image: NDArray, noise: float, min_amplitude: float, max_sigma: float) -> Peaks:
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
    half_width = max(up.max(initial=1), down.max(initial=1))
    rows = peak + np.arange(1 - half_width, half_width)[:, None]
    own = (rows > peak - up) & (rows < peak + down) & (rows >= 0) & (rows < len(smooth))
    smooth[np.where(own, rows, peak), column] = -np.inf
    second = np.maximum(smooth.max(axis=0)[column] - background, 0.0) / contrast
    return Peaks(column, peak, peak + (down - up) / 2.0, sigma, contrast, background, second)


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


def window(image: NDArray, at: Peaks) -> tuple[Index, NDArray[np.bool_], Array]:
    """Rows round each peak, which of them lie in the image, and its values there: (n, L) each."""
    half = int(np.ceil(REACH * max(at.sigma.max(initial=0.0), 1.0)))
    rows = np.rint(at.row).astype(int) + np.arange(-half, half + 1)[:, None]
    inside = (rows >= 0) & (rows < len(image))
    values = image[np.clip(rows, 0, len(image) - 1), at.column].astype(float)
    return rows, inside, values


def pixel_gaussian(rows: Index, row: Array, sigma: Array) -> Array:
    """1, G = unit Gaussian integrated over a pixel, sigma dG/drow, sigma dG/dsigma: (4, n, L)."""
    lower, upper = (rows - 0.5 - row) / sigma, (rows + 0.5 - row) / sigma
    at_lower, at_upper = np.exp(-(lower**2) / 2.0), np.exp(-(upper**2) / 2.0)
    value = np.sqrt(2.0 * np.pi) * sigma * (ndtr(upper) - ndtr(lower))
    by_row = sigma * (at_lower - at_upper)
    by_sigma = value + sigma * (lower * at_lower - upper * at_upper)
    return np.stack([np.ones_like(value), value, by_row, by_sigma])
