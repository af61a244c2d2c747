"""Where columns of an image have their peaks: what every columnwise detector starts from."""

from os import PathLike
from typing import Any, NamedTuple

import cv2
import numpy as np
from numpy.lib.stride_tricks import sliding_window_view
from numpy.typing import ArrayLike, NDArray
from scipy.ndimage import median_filter
from scipy.special import ndtr

from virtual_sensor.arrays import GOLDEN, LARGEST, number_within, unmasked
from virtual_sensor.errors import InputError, short

Array = NDArray[np.float64]
Index = NDArray[np.intp]

SMOOTHING_PX = 1.5  # sigma of the filter that the coarse search runs on
SIGNIFICANCE = 6.0  # a peak stands out by so many sigma of the smoothed noise
REACH = 4.0  # half width of the fit's window in sigma; the outermost sigma is tapered
MIN_SIGMA_PX = 0.5  # below it the pixels no longer sample the profile
QUARTILE = 0.6745  # of Gaussian noise, in its standard deviations
_KERNEL = cv2.getGaussianKernel(2 * int(4 * SMOOTHING_PX) + 1, SMOOTHING_PX)
_FEWEST_ROWS = 8  # that show the noise
_PAIRS = 128  # of rows, at most, in which it is seen,
_BLOCK_COLUMNS, _SAMPLED_COLUMNS = 64, 8  # and columns
_CLEARLY = 4.0  # about three standard errors of such a median
_GREY_VALUES = 16.0  # from which on an image of whole floats is a camera's
_AT_ONCE = 5  # rows that are read for all peaks, before those that are broader
_PEDESTAL = 0.75  # of its height: a peak that rises less above its valleys stands on other light
_PROMINENCE = 0.1  # of its height: by so much a further peak rises above the valleys beside it


class Noise(NamedTuple):
    """The image's noise: its variance is dark^2 + gain * signal (EMVA 1288).

    Attributes
    ----------
    dark : ndarray of shape (W,)
        Standard deviation beside the line in each column, in the image's unit: the camera's own,
        and the shot noise of ambient light.
    gain : float
        Growth of the variance per unit of signal: K in grey values per electron; 0: none.
    known : bool
        Whether it was given; else it is estimated from the residuals of fitted Gaussians too.
    """

    dark: Array
    gain: float
    known: bool

    def variance(self, signal: Array, column: Index) -> Array:
        """Of pixels (..., L) with so much `signal` above the background, of L columns."""
        return self.dark[column] ** 2 + self.gain * np.maximum(signal, 0.0)

    def variance_near(self, at: "Peaks", signal: Array) -> Array:
        """Of the pixels (n, L) near peaks: as given, or as the residuals show."""
        if self.known:
            return self.variance(signal, at.column) * at.excess
        return np.broadcast_to(at.noise**2, signal.shape)


class Peaks(NamedTuple):
    """L peaks, where they are, and about their shape: arrays of shape (L,)."""

    column: Index
    rank: Index  # 0: the highest of its column, or the line, once it is chosen
    peak: Index
    row: Array
    sigma: Array
    amplitude: Array
    background: Array
    level: Array  # of the unlit rows of the column
    second: Array  # height of the next peak, relative; 0 where several were asked for
    residual: Array  # rms misfit of the Gaussian; NaN before there is one
    noise: Array  # the same of the neighbours, in which its own shape does not show
    excess: Array  # of its variance over the given one, where that is clear; else 1
    speckle: Array  # noise that would scatter the neighbours' shapes as they are

    def take(self, chosen: NDArray) -> "Peaks":
        """Some of them: by their index, or by a mask."""
        if chosen.dtype == bool and chosen.all():
            return self
        return Peaks._make(values[chosen] for values in self)


class Profile(NamedTuple):
    """What a detector says about L peaks: arrays of shape (L,); NaN where it fails."""

    row: Array
    row_error: Array
    sigma: Array
    amplitude: Array
    background: Array


def checked_image(image: ArrayLike) -> NDArray:
    """Return `image` (H, W) as a contiguous array of native byte order, or raise InputError.

    What a NumPy mask hides is NaN, a missing pixel.  Integers of other types become float64, and
    half floats float32.
    """
    if isinstance(image, str | PathLike):
        raise InputError(f"image is {short(image)}, a file's name; give vs.read_image of it")
    image = unmasked(image)
    image = image[..., 0] if image.ndim == 3 and image.shape[2] == 1 else image
    kind, size = image.dtype.kind, image.dtype.itemsize
    if kind not in "iuf" or size > 8:
        raise InputError(
            f"image is of type {image.dtype}; give grey values: integers, float32 or float64"
        )
    if image.ndim != 2 or image.size == 0:
        problem = f"image: shape {image.shape} is not (height, width)"
        raise InputError(f"{problem}; give one grey channel, such as image[..., 1]")
    if kind == "f":
        return np.ascontiguousarray(image, np.float32 if size <= 4 else np.float64)
    kept = image.dtype.newbyteorder("=") in (np.uint8, np.uint16)
    return np.ascontiguousarray(image, image.dtype.newbyteorder("=") if kept else np.float64)


def grey_value_facts(name: str, image: Any, sensor: Any) -> dict[str, float]:
    """What is known of an image's grey values: by the sensor that is given, else by itself.

    Raises
    ------
    InputError
        Naming it, if it is no sensor.
    """
    if sensor is not None and not hasattr(sensor, "detector_options"):
        raise InputError(f"{name} is {short(sensor)}; give an ImageSensor")
    return known_of(image) | known_of(sensor)


def known_of(image: Any) -> dict[str, float]:
    """What a recorded frame says of its grey values: noise, gain, saturation and black level.

    It is the attribute `detector_options` of whatever has one; of several, what all say.
    """
    if isinstance(image, list | tuple) and image:
        first, *others = map(known_of, image)
        return {n: x for n, x in first.items() if all(each.get(n) == x for each in others)}
    known = getattr(image, "detector_options", None)
    return {name: value for name, value in (known or {}).items() if value is not None}


def linear_of(image: Any) -> Any:
    """The grey values of a recorded frame in proportion to the light; other images as they are.

    It is the attribute `linear_grey` of whatever has one: a profile that a sensor's knee-point
    flattens is no line's.
    """
    return getattr(image, "linear_grey", image)


def saturation_level(image: ArrayLike, saturation: float | None) -> float:
    """Grey value from which on the pixels of `image` are clipped; infinity where there is none.

    An image of `read_image` knows it, and a recorded frame.
    """
    if saturation is None:
        saturation = known_of(image).get("saturation", getattr(image, "largest", None))
    if saturation is not None:
        return number_within("image: saturation", saturation, -LARGEST, np.inf, "a grey value")
    dtype = getattr(image, "dtype", None) or unmasked(image).dtype  # of a masked image its own
    return float(np.iinfo(dtype).max) if dtype in (np.uint8, np.uint16) else np.inf


def noise_beside(image: NDArray, given: float | None = None) -> Array:
    """Standard deviation (W,) of the grey values beside the line, in each column.

    It is the median difference of adjacent rows, over a block of columns, in the darker half of the
    rows: neither the line nor a slope of the background counts.  How dark a pair of rows is, the
    rows beside it say, or the choice would favour small differences.

    Parameters
    ----------
    image : ndarray of shape (H, W)
    given : float, optional
        The camera's own; what the image shows counts where it is clearly more: ambient light adds
        its shot noise.
    """
    height, width = image.shape
    if height < _FEWEST_ROWS:
        return np.full(width, max(given or 0.0, 12**-0.5 if image.dtype.kind == "u" else 0.0))
    first = np.arange(0, height - 3, max((height - 3) // _PAIRS, 1))
    blocks = -(-width // _BLOCK_COLUMNS)
    column = np.linspace(0, width - 1, blocks * _SAMPLED_COLUMNS).round().astype(int)
    outer, upper, lower, last = (image[first + k][:, column].astype(float) for k in range(4))
    level = outer + last
    change = np.abs(lower - upper)
    whole = image.dtype.kind == "u" or bool(
        np.all(upper == np.rint(upper)) and np.abs(upper).max() >= _GREY_VALUES
    )
    if whole:  # their median would be whole too: each is spread evenly over its unit
        dither = (np.arange(change.size).reshape(change.shape) * GOLDEN) % 1.0 - 0.5
        change = np.abs(change + dither)
    change[level > np.median(level, axis=0)] = np.inf
    change = np.sort(change.reshape(len(first), blocks, -1).swapaxes(0, 1).reshape(blocks, -1))
    seen = np.isfinite(change).sum(axis=1)
    noise = change[np.arange(blocks), seen // 2] / (QUARTILE * np.sqrt(2.0))
    if given is not None:
        # A narrow image has not as many pixels as are looked at.
        count = seen * min(width / column.size, 1.0)
        noise[noise < given * (1.0 + _CLEARLY / np.sqrt(count))] = given
    noise = np.maximum(noise, max(given or 0.0, 12**-0.5 if whole else 0.0))
    return noise[np.arange(width) * blocks // width]


class Coarse(NamedTuple):
    """An image (H, W) smoothed along its columns, and what stands out in these: (W,) each."""

    smooth: NDArray
    peak: Index  # the highest row
    background: Array
    level: Array  # of the unlit rows
    lowest: Array  # height above the background from which on a peak is one


def coarse_search(image: NDArray, noise: Array, min_amplitude: float) -> Coarse:
    """Where an image's columns are highest, and by how much a line stands out of their noise (W,).

    The noise is that beside the line.
    """
    depth = cv2.CV_64F if image.dtype == np.float64 else cv2.CV_32F
    smooth = cv2.sepFilter2D(image, depth, np.ones(1), _KERNEL, borderType=cv2.BORDER_REFLECT_101)

    peak = cv2.reduceArgMax(smooth, 0)[0].astype(int)  # NumPy's takes three times as long
    top = smooth[peak, np.arange(peak.size)].astype(float)
    # Smoothed rows next to each other are alike.
    sparse = np.ascontiguousarray(smooth[:: max(len(smooth) // 128, 2)].T)
    quartile = sparse.shape[1] // 4
    background = np.partition(sparse, quartile, axis=1)[:, quartile].astype(float)
    contrast = top - background
    level = background + QUARTILE * smoothed_noise(noise)
    lowest = max(
        min_amplitude * median_filter(contrast, 3, mode="nearest").max(),  # blind to hot pixels
        16.0 * np.finfo(smooth.dtype).eps * np.abs([top, background]).max(),  # rounding
    )
    lowest = np.maximum(lowest, SIGNIFICANCE * smoothed_noise(noise) + level - background)
    return Coarse(smooth, peak, background, level, lowest)


def find_peaks(coarse: Coarse, max_sigma: float, count: int = 1, local: bool = False) -> Peaks:
    """Find the `count` highest peaks of each column, and their half widths.

    Where several are sought, heights and widths are those above the column's background, or
    `local`: above the valleys beside each, where they are clearly higher.
    """
    smooth, peak, background, level, lowest = coarse
    column = np.arange(peak.size)
    rank = np.zeros_like(peak)
    if count > 1:
        column, peak, rank, stands = _ranked(smooth, background + lowest, lowest, count)
        background = background[column]
    contrast = smooth[peak, column].astype(float) - background
    if count > 1 and local:
        raised = stands < _PEDESTAL * contrast
        background = np.where(raised, background + contrast - stands, background)
        contrast = np.where(raised, stands, contrast)

    lit = contrast > lowest[column]
    column, peak, rank = (values[lit] for values in (column, peak, rank))
    contrast, background = contrast[lit], background[lit]
    half = background + contrast / 2.0
    to_half = np.sqrt(2.0 * np.log(2.0))  # half width at half height in sigma
    farthest = int(2.0 * to_half * np.hypot(max_sigma, SMOOTHING_PX)) + 2
    up, down = _rows_to(half, smooth, column, peak, farthest)
    above = _beyond(half, smooth, column, peak, -up)
    below = _beyond(half, smooth, column, peak, down)
    broadened = (up - above + down - below) / 2.0 / to_half
    sigma = np.sqrt(np.maximum(broadened**2 - SMOOTHING_PX**2, MIN_SIGMA_PX**2))
    second = np.zeros_like(contrast)
    if count == 1:
        second = _next_height(smooth, column, peak, up, down) - background
        second = np.maximum(second, 0.0) / contrast
    middle = peak + (down - below - up + above) / 2.0
    profile = (middle, sigma, contrast, background, level[column], second)
    return Peaks(column, rank, peak, *profile, *np.full((4, peak.size), np.nan))


def median_of_squares(free: Array) -> Array:
    """Of the mean of so many free squared deviations: the median, in the variance.

    By Wilson and Hilferty 1931, Proc. Natl. Acad. Sci. 17, 684.
    """
    return (1.0 - 2.0 / (9.0 * free)) ** 3


def running_scatter(values: Array, near: int) -> tuple[Array, Array]:
    """Running median of values (N,), and how far they scatter about it, as a sigma."""
    middle = median_filter(values, near, mode="nearest")
    away = median_filter(np.abs(values - middle), near, mode="nearest")
    return middle, away / QUARTILE


def smoothed_noise(noise: Array) -> Array:
    """What the filter of the coarse search leaves of white noise."""
    return noise * float(np.linalg.norm(_KERNEL))


def _ranked(
    smooth: NDArray, height: Array, prominence: Array, count: int
) -> tuple[Index, Index, Index, Array]:
    """The `count` highest local maxima of each column: columns, rows, ranks, prominences (L,)."""
    crest = cv2.dilate(smooth, np.ones((3, 1), np.uint8)) == smooth
    crest &= smooth > height.astype(smooth.dtype)
    row, column = np.divmod(np.flatnonzero(crest), smooth.shape[1])
    order = np.argsort(column, kind="stable")
    row, column = row[order], column[order]
    begins = np.flatnonzero((np.diff(column, prepend=-1) != 0) | (np.diff(row, prepend=-2) != 1))
    ends = np.append(begins[1:], row.size)[: begins.size] - 1  # of plateaus
    column, peak = column[begins], (row[begins] + row[ends]) // 2
    tops = smooth[peak, column].astype(float)
    stands = _prominence(smooth, column, peak, tops)
    own = _PROMINENCE * (tops - height[column] + prominence[column])
    stands_out = stands > np.maximum(own, prominence[column])
    column, peak, tops, stands = (a[stands_out] for a in (column, peak, tops, stands))
    order = np.lexsort((-tops, column))
    column, peak, stands = column[order], peak[order], stands[order]
    rank = np.arange(column.size) - np.searchsorted(column, column)
    few = rank < count
    return column[few], peak[few], rank[few], stands[few]


def _prominence(smooth: NDArray, column: Index, peak: Index, tops: Array) -> Array:
    """By how much maxima (L,) rise above the valleys to higher ones of their columns.

    They are sorted by column and row.  Infinity for the highest of a column.
    """
    base = np.full(tops.size, -np.inf)
    among = np.flatnonzero(np.bincount(column)[column] > 1)
    if not among.size:
        return tops - base
    column, peak, height = column[among], peak[among], tops[among]
    first, last = peak.min(), peak.max()
    columns, number = np.unique(column, return_inverse=True)
    upright = np.ascontiguousarray(smooth[first : last + 1, columns].T)
    # The valley behind each; behind the last of a column it counts for none.
    valley = np.minimum.reduceat(upright.ravel(), number * upright.shape[1] + peak - first)
    for sign in (1, -1):
        here = np.arange(among.size)
        lowest = np.full(among.size, np.inf)
        for away in range(1, among.size):
            other = here - sign * away
            inside = (other >= 0) & (other < among.size)
            here, other = here[inside], other[inside]
            same = column[other] == column[here]
            here, other = here[same], other[same]
            if not here.size:
                break
            lowest[here] = np.minimum(lowest[here], valley[other if sign > 0 else other - 1])
            higher = height[other] > height[here]
            found = here[higher]
            base[among[found]] = np.maximum(base[among[found]], lowest[found])
            here = here[~higher]
    return tops - base


def _next_height(smooth: NDArray, column: Index, peak: Index, up: Index, down: Index) -> Array:
    """Highest value of each column beside its peak."""
    half_width = max(up.max(initial=1), down.max(initial=1))
    rows = peak + np.arange(1 - half_width, half_width)[:, None]
    own = (rows > peak - up) & (rows < peak + down) & (rows >= 0) & (rows < len(smooth))
    at = np.where(own, rows, peak), column
    hidden = smooth[at]
    smooth[at] = -np.inf
    highest: Array = smooth.max(axis=0)[column]
    smooth[at] = hidden
    return highest


def _rows_to(
    level: Array, image: NDArray, column: Index, peak: Index, farthest: int
) -> tuple[Index, Index]:
    """Count the rows from each peak, up and down, to the first at `level`."""
    at_once = min(_AT_ONCE, farthest)
    near = windows(image, column, peak - at_once, 2 * at_once + 1) > level[:, None]
    distances = []
    for step, room in ((-1, peak), (1, len(image) - 1 - peak)):
        above = near[:, at_once + step :: step][:, :at_once]
        above = above & (np.arange(at_once) < room[:, None])
        walking = np.flatnonzero(above.all(axis=1))
        distance = above.argmin(axis=1) + 1
        for reached in range(at_once + 1, farthest + 1):
            if not walking.size:
                break
            distance[walking] = reached
            row = peak[walking] + step * reached
            inside = (row >= 0) & (row < len(image))
            walking, row = walking[inside], row[inside]
            walking = walking[image[row, column[walking]] > level[walking]]
        distances.append(distance)
    return distances[0], distances[1]


def _beyond(level: Array, image: NDArray, column: Index, peak: Index, to: Index) -> Array:
    """By which part of a row the profile is at `level` before the row that `_rows_to` counts."""
    last = np.clip(peak + to, 0, len(image) - 1)
    here, before = image[last, column], image[last - np.sign(to), column]
    drop = np.where(before > here, before - here, np.inf)
    return np.clip((level - here) / drop, 0.0, 1.0)


def by_width(sigma: Array) -> list[NDArray[np.bool_]]:
    """Masks (L,) of peaks of about one width; the octaves lie so that most are in one of them."""
    if not sigma.size:
        return []
    octave = np.rint(np.log2(sigma / np.median(sigma)))
    return [octave == each for each in np.unique(octave)]


def window(image: NDArray, at: Peaks) -> tuple[Index, NDArray[np.bool_], Array]:
    """Rows round each peak, which of them lie in the image, and its values there: (n, L) each."""
    half = int(np.ceil(REACH * max(at.sigma.max(initial=0.0), 1.0)))
    rows = np.rint(at.row).astype(int) + np.arange(-half, half + 1)[:, None]
    inside = (rows >= 0) & (rows < len(image))
    return rows, inside, pixels(image, rows, at.column).astype(float)


def windows(image: NDArray, column: Index, first: Index, count: int) -> NDArray:
    """Values (L, count) of columns from their `first` row on; beyond the border those at it."""
    if not column.size:
        return np.empty((0, count), image.dtype)
    lowest = first.min()
    rows = np.clip(np.arange(lowest, first.max() + count), 0, len(image) - 1)
    upright = np.ascontiguousarray(image[rows].T)
    return sliding_window_view(upright, count, axis=1)[column, first - lowest]


def pixels(image: NDArray, rows: Index, column: Index) -> NDArray:
    """Values of a contiguous image at rows and columns; beyond its border those at it."""
    rows = np.clip(rows, 0, len(image) - 1)
    return image.ravel().take(rows * image.shape[1] + column, mode="clip")


def pixel_means(rows: Index, row: Array, sigma: Array) -> Array:
    """Unit Gaussian, averaged over pixels (n, L) whose rows follow each other."""
    return _averaged(_edges(rows, row, sigma), sigma)


def pixel_gaussian(rows: Index, row: Array, sigma: Array) -> Array:
    """1, G = unit Gaussian integrated over a pixel, sigma dG/drow, sigma dG/dsigma: (4, n, L).

    `rows` (n, L) follow each other.
    """
    edges = _edges(rows, row, sigma)
    at_edges = np.exp(-0.5 * edges**2)
    basis = np.empty((4, *rows.shape))
    basis[0] = 1.0
    basis[1] = _averaged(edges, sigma)
    basis[2] = -sigma * np.diff(at_edges, axis=0)
    basis[3] = basis[1] - sigma * np.diff(edges * at_edges, axis=0)
    return basis


def _edges(rows: Index, row: Array, sigma: Array) -> Array:
    """Edges (n + 1, L) of pixels whose rows follow each other, from the centre, in sigma."""
    return (np.concatenate([rows, rows[-1:] + 1]) - 0.5 - row) / sigma


def _averaged(edges: Array, sigma: Array) -> Array:
    """Unit Gaussian, averaged between edges."""
    return np.sqrt(2.0 * np.pi) * sigma * np.diff(ndtr(edges), axis=0)
