"""What all codecs share: their patterns, images as they come, and the statuses of pixels."""

from __future__ import annotations

import math
from abc import ABC, abstractmethod
from collections.abc import Iterator, Mapping, Sequence
from concurrent.futures import ThreadPoolExecutor
from dataclasses import dataclass, field, replace
from os import PathLike
from typing import Any

import cv2
import numpy as np
from numpy.typing import ArrayLike, NDArray
from threadpoolctl import threadpool_limits

from virtual_sensor.arrays import LARGEST, number_within, size_of, truth_of, unmasked
from virtual_sensor.devices.patterns import AXES, Pattern
from virtual_sensor.display import Displayed, listed
from virtual_sensor.errors import InputError, short
from virtual_sensor.metrology.covariance import SIGMA_BY_MEDIAN
from virtual_sensor.metrology.fringes.decoded import DecodedFringes, FringeStatus
from virtual_sensor.metrology.line_profiles import grey_value_facts, linear_of, saturation_level

Block = NDArray[Any]
"""Grey values (K, P) of P pixels in K images."""

LEAST_MODULATION = 0.02
"""Of the image's strongest fringes: weaker ones are none."""
NOISIEST_PHASE_RAD = 1.0 / 3.0
"""Standard deviation of a phase from which on its fringes drown."""

_MOST_PX = 65_536  # along a side of the projector
_ROUNDED = 1e-5  # of the mean: float32 knows no weaker fringes
_BLOCK_PX = 65_536  # pixels that are decoded at a time: they stay in the processor's cache
_REGION_PX = 9  # so many pixels side by side are no noise
_SQUARE = np.ones((3, 3), np.uint8)
_DISPLACED_PX = 0.014  # of a pixel's mean from its centre, from which on there is an edge
_STEP_PX = 1.3  # second difference that square pixels make, and a few samples of them
_GATHERED = 0.1  # mean of unit vectors that stand for places within a projector pixel
_SAMPLE_PX = 40_000
BEND, _SLOPE = np.array([1.0, -2.0, 1.0]), np.array([-0.5, 0.0, 0.5])
_FAR = 6.0  # spreads of the second differences
_THREADS = 2


@dataclass(frozen=True)
class GreyNoise(Displayed):
    """The noise of grey values.

    Attributes
    ----------
    read : float
        Standard deviation in the dark, before values are rounded.
    gain : float
        Growth of the variance per unit of signal: grey values per electron.
    black : float
        Grey value of a pixel without light.
    step : float
        Of the rounding; 0: none.
    misfit : float
        Standard deviation of what a sequence's steps leave over, noise and all; 0: unknown.
    """

    read: float = 0.0
    gain: float = 0.0
    black: float = 0.0
    step: float = 0.0
    misfit: float = 0.0

    def variance(self, mean: NDArray[Any]) -> NDArray[Any]:
        """Of a grey value, where images have such means."""
        shot = np.float32(self.gain) * np.maximum(mean - np.float32(self.black), 0.0)
        return shot + np.float32(self.read**2 + self.step**2 / 12.0)

    def as_seen(self, variance: float) -> GreyNoise:
        """The same with the read noise of images whose grey values have such a variance."""
        return replace(self, read=math.sqrt(max(variance - self.step**2 / 12.0, 0.0)))


@dataclass
class AxisBlock:
    """What is known of an axis in some pixels: arrays (P,); None of what a codec does not have.

    `coordinate` is in px of the projector, `disagreement` the distance from the fringe order in
    half periods.
    """

    coordinate: NDArray[np.float64]
    sigma: NDArray[np.float32]
    modulation: NDArray[np.float32]
    mean: NDArray[np.float32]
    phase: NDArray[np.float32] | None = None
    disagreement: NDArray[np.float32] | None = None
    drowned: NDArray[np.bool_] | None = None


class Codec(Displayed, ABC):
    """A sequence of patterns, and what decodes images of it; subclasses are frozen dataclasses.

    Attributes
    ----------
    size_px : tuple of int
        (W, H) of the projector.
    axes : str
        "uv": columns and rows; "u" or "v": one of them.
    """

    size_px: tuple[int, int]
    axes: str

    @property
    def patterns(self) -> tuple[Pattern, ...]:
        """All patterns, in the order of the images."""
        return tuple(pattern for axis in self.axes for _, pattern in self._patterns_of(axis))

    @property
    def names(self) -> tuple[str, ...]:
        """What each pattern is, such as "u 16 px, step 2 of 4"."""
        return tuple(name for axis in self.axes for name, _ in self._patterns_of(axis))

    def __len__(self) -> int:
        return len(self.patterns)

    @property
    @abstractmethod
    def text(self) -> str:
        """The codec as `codec_of` takes it."""

    @abstractmethod
    def _patterns_of(self, axis: Any) -> Iterator[tuple[str, Pattern]]:
        """Names and patterns of an axis, in the order of the images."""

    @abstractmethod
    def _decode_axis(self, axis: str, block: Block, noise: GreyNoise) -> AxisBlock:
        """An axis in a block of the axis's own images."""

    @abstractmethod
    def _clipped(self, block: Block, saturation: float) -> NDArray[np.bool_]:
        """Which pixels of a block of the axis's own images can't be decoded for clipping."""

    def axis_px(self, axis: str) -> int:
        """The projector's columns, or rows: its size along an axis."""
        return self.size_px[AXES.index(axis)]

    def images_of(self, axis: str) -> slice:
        """Which images show an axis."""
        counts = [sum(1 for _ in self._patterns_of(each)) for each in self.axes]
        number = self.axes.index(axis)
        return slice(sum(counts[:number]), sum(counts[: number + 1]))

    def decode(
        self,
        images: ArrayLike | Sequence[ArrayLike],
        *,
        noise: float | None = None,
        gain: float = 0.0,
        sensor: Any = None,
        black: float | None = None,
        saturation: float | None = None,
        least_modulation: float = LEAST_MODULATION,
        most_disagreement: float = 0.75,
        edges: bool = True,
        border_px: float = 0.0,
    ) -> DecodedFringes:
        """Decode a sequence of images.

        Parameters
        ----------
        images : array_like of shape (K, H, W)
            Grey values, one image for each of the codec's `patterns`, in their order; or a sequence
            of K images.  NaN and infinity mark missing pixels, as a NumPy mask does.  A
            `RecordedFrame` knows its noise, gain, black level and saturation.
        noise : float, optional
            Standard deviation of dark grey values, before they are rounded.  By default as the
            images show it.
        gain : float
            Growth of the noise's variance per unit of signal: EMVA 1288's K, in grey values per
            electron; 1 for images in electrons; 0, none.
        sensor : ImageSensor, optional
            That took the images: it knows `noise`, `gain`, `black` and `saturation`, where they are
            not given.
        black : float, optional
            Grey value of a pixel without light; by default 0.
        saturation : float, optional
            Grey value from which on pixels are clipped.  By default the largest value of uint8 or
            uint16 images; others have none.
        least_modulation : float
            Amplitude of the weakest fringes, relative to the image's strongest.
        most_disagreement : float
            Of the periods on the fringe order, in half periods: beyond it a pixel is ORDER.  1
            takes all.
        edges : bool
            Whether pixels at edges are sought and left out.
        border_px : float
            Width of the border of the projector's image, px, whose pixels are OUTSIDE: three times
            its blur, say, which mixes their light with the dark beside the image.

        Raises
        ------
        InputError
            If there is another number of images than of patterns, they are not of one size, or an
            option is out of its range.
        """
        images = linear_of(images)
        told = grey_value_facts("sensor", images, sensor)
        saturation = told.get("saturation") if saturation is None else saturation
        stack, clipped = _stack(images, saturation, self)
        light = _noise_of(noise, gain, black, stack, told)
        within = "a fraction from 0 to 1"
        least = number_within("least_modulation", least_modulation, 0.0, 1.0, within)
        most = number_within("most_disagreement", most_disagreement, 0.0, 1.0, within)
        truth_of("edges", edges)
        number_within("border_px", border_px, 0.0, _MOST_PX, "px >= 0")
        if noise is None and "noise" not in told:
            light = self._seen_noise(stack, light, clipped)
        found = self._all_blocks(stack, light, clipped)
        return self._judged(found, light, stack.shape[1:], least, most, edges, border_px)

    def _seen_noise(self, stack: NDArray[Any], light: GreyNoise, clipped: float) -> GreyNoise:
        """The noise as images show it, if they do."""
        return light

    def _all_blocks(self, stack: NDArray[Any], light: GreyNoise, clipped: float) -> Found:
        """Decode block by block, on all cores."""
        shape = stack.shape[1:]
        found = Found.empty(shape, self.axes)
        rows = max(1, _BLOCK_PX // shape[1])

        def work(first: int) -> None:
            here = slice(first, min(first + rows, shape[0]))
            for axis in self.axes:
                images = stack[self.images_of(axis), here]
                block = images.reshape(len(images), -1)
                with np.errstate(all="ignore"):
                    part = self._decode_axis(axis, block, light)
                    if clipped < np.inf:
                        lost = self._clipped(block, clipped)
                        found.clipped[here] |= lost.reshape(-1, shape[1])
                found.put(axis, here, part)

        # The products' own threads, within each of ours, would wait for one another.
        with threadpool_limits(1, "blas"), ThreadPoolExecutor(_THREADS) as pool:
            list(pool.map(work, range(0, shape[0], rows)))
        return found

    def _judged(
        self,
        found: Found,
        light: GreyNoise,
        shape: tuple[int, ...],
        least: float,
        most: float,
        edges: bool,
        border_px: float,
    ) -> DecodedFringes:
        """The statuses of all pixels, and NaN where there is no answer."""
        modulation, mean = found.modulation, found.mean
        known = np.isfinite(modulation)
        seen = known & ~found.clipped
        strongest = float(modulation[seen].max(initial=0.0)) if seen.any() else 0.0
        weak = ~(modulation > least * strongest) | found.drowned
        weak |= modulation <= _ROUNDED * np.abs(mean)
        status = np.zeros(shape, np.uint8)
        for axis, coordinate in found.coordinate.items():
            low, high = border_px - 0.5, self.axis_px(axis) - border_px - 0.5
            status[~((coordinate >= low) & (coordinate <= high))] = FringeStatus.OUTSIDE
        status[found.disagreement > most] = FringeStatus.ORDER
        status[weak] = FringeStatus.LOW_MODULATION
        status[weak & ~(mean - np.float32(light.black) > least * strongest)] = FringeStatus.BLACK
        status[found.clipped] = FringeStatus.SATURATED
        status[~known] = FringeStatus.NOT_FINITE
        self._unwrap_space(found, status)
        for coordinate in found.coordinate.values():
            coordinate[status != FringeStatus.OK] = np.nan
        if edges:
            edge, lit = _beside_dark(status), mean - np.float32(light.black)
            for axis, coordinate in found.coordinate.items():
                edge |= _mixed(coordinate, found.sigma[axis], lit)
            status[edge & (status == FringeStatus.OK)] = FringeStatus.EDGE
            ok = status == FringeStatus.OK
            status[ok & _in_splinters(ok)] = FringeStatus.EDGE
        bad = status != FringeStatus.OK
        for coordinate in found.coordinate.values():
            coordinate[bad] = np.nan
        for sigma in found.sigma.values():
            sigma[bad] = np.nan
        wrong, notes = self._doubts(found, ~bad, light)
        return DecodedFringes(
            column=found.coordinate.get("u"),
            row=found.coordinate.get("v"),
            sigma_column=found.sigma.get("u"),
            sigma_row=found.sigma.get("v"),
            modulation=modulation,
            mean=mean,
            phase=found.phase if self._has_phase else {},
            status=status,
            size_px=self.size_px,
            absolute=self.absolute,
            wrong_orders=wrong,
            noise=light.read,
            notes=notes,
        )

    @property
    def absolute(self) -> bool:
        """Whether coordinates are the projector's own, not lacking whole periods."""
        return True

    @property
    def _has_phase(self) -> bool:
        return True

    def _unwrap_space(self, found: Found, status: NDArray[np.uint8]) -> None:
        """Make wrapped coordinates continuous over the image, where time does not tell them."""

    def _doubts(
        self, found: Found, ok: NDArray[np.bool_], light: GreyNoise
    ) -> tuple[float, tuple[str, ...]]:
        """Share of wrong fringe orders that is expected, and notes."""
        return 0.0, ()


@dataclass
class Found:
    """Images of all that is decoded, by axis, while they are filled.

    Attributes
    ----------
    coordinate, sigma, phase : dict of str to ndarray of shape (H, W)
    modulation, mean, disagreement : ndarray of shape (H, W)
    clipped, drowned : ndarray of bool of shape (H, W)
        Where images are clipped, and where fringes are too weak for the noise.
    first : str
        The first axis.
    """

    coordinate: dict[str, NDArray[np.float64]]
    sigma: dict[str, NDArray[np.float32]]
    phase: dict[str, NDArray[np.float32]]
    modulation: NDArray[np.float32]
    mean: NDArray[np.float32]
    disagreement: NDArray[np.float32]
    clipped: NDArray[np.bool_]
    drowned: NDArray[np.bool_]
    first: str = field(default="u")

    @classmethod
    def empty(cls, shape: tuple[int, ...], axes: str) -> Found:
        """Without anything yet."""

        def by_axis(kind: Any) -> dict[str, Any]:
            return {axis: np.empty(shape, kind) for axis in axes}

        return cls(
            coordinate=by_axis(np.float64),
            sigma=by_axis(np.float32),
            phase=by_axis(np.float32),
            modulation=np.empty(shape, np.float32),
            mean=np.empty(shape, np.float32),
            disagreement=np.zeros(shape, np.float32),
            clipped=np.zeros(shape, bool),
            drowned=np.zeros(shape, bool),
            first=axes[0],
        )

    def put(self, axis: str, rows: slice, part: AxisBlock) -> None:
        """An axis in some rows; of both axes the weaker modulation counts."""
        shape = self.mean[rows].shape
        self.coordinate[axis][rows] = part.coordinate.reshape(shape)
        self.sigma[axis][rows] = part.sigma.reshape(shape)
        if part.phase is not None:
            self.phase[axis][rows] = part.phase.reshape(shape)
        modulation, mean = part.modulation.reshape(shape), part.mean.reshape(shape)
        if axis != self.first:
            modulation = np.minimum(modulation, self.modulation[rows])
            mean = 0.5 * (mean + self.mean[rows])
        self.modulation[rows], self.mean[rows] = modulation, mean
        if part.disagreement is not None:
            worse = np.fmax(self.disagreement[rows], part.disagreement.reshape(shape))
            self.disagreement[rows] = worse
        if part.drowned is not None:
            self.drowned[rows] |= part.drowned.reshape(shape)


def unwrap_in_space(
    found: Found, status: NDArray[np.uint8], period_px: float, size_px: tuple[int, int]
) -> None:
    """Make wrapped phases continuous from pixel to pixel where the status is OK.

    By reliability sorting, scikit-image (Herraez et al. 2002, Applied Optics 41, 7437).  Of the
    whole periods that may be missing, those are taken that put the median in the image's middle.
    """
    from skimage.restoration import unwrap_phase

    hidden = status != FringeStatus.OK
    for axis, coordinate in found.coordinate.items():
        phase = found.phase[axis]
        if hidden.all():
            continue
        whole = unwrap_phase(np.ma.MaskedArray(phase.astype(float), hidden), rng=0)
        length = np.ma.getdata(whole) * (period_px / (2.0 * np.pi))
        middle = 0.5 * size_px[AXES.index(axis)]
        length += period_px * np.rint((middle - np.median(length[~hidden])) / period_px)
        coordinate[...] = length - 0.5


def _stack(images: Any, saturation: float | None, codec: Codec) -> tuple[NDArray[Any], float]:
    """Images (K, H, W) of float32 or small integers, and the level of clipping."""
    if isinstance(images, str | PathLike | Mapping):
        raise InputError(f"images is {short(images)}; give an array (images, height, width)")
    if isinstance(images, Sequence) and not isinstance(images, np.ndarray) and len(images):
        levels = [saturation_level(each, saturation) for each in images]
        shapes = {np.shape(each) for each in images}
        if len(shapes) > 1:
            sizes = ", ".join(sorted(" x ".join(map(str, each[::-1])) for each in shapes))
            raise InputError(f"images are of different sizes, {sizes} px; give those of one camera")
        clipped = min(levels)
        stack = np.stack([unmasked(each) for each in images])
    else:
        clipped = saturation_level(images, saturation)
        stack = unmasked(images)
    if stack.dtype.kind not in "iuf" or stack.dtype.itemsize > 8:
        raise InputError(f"images are of type {stack.dtype}; give grey values: integers or floats")
    if stack.ndim != 3 or not stack.size:
        raise InputError(
            f"images are of shape {stack.shape}; give (images, height, width) of one grey channel"
        )
    if len(stack) != len(codec):
        raise InputError(
            f"{len(stack)} images, but '{codec.text}' has {len(codec)} patterns:"
            f" {codec.names[0]}, ... {codec.names[-1]}; give one image of each, in this order"
        )
    return stack, clipped


def _noise_of(
    noise: float | None,
    gain: float,
    black: float | None,
    stack: NDArray[Any],
    told: dict[str, float],
) -> GreyNoise:
    step = 1.0 if stack.dtype.kind in "iu" else 0.0
    noise = _before_rounding(told.get("noise")) if noise is None else noise
    black = told.get("black") if black is None else black
    read = 0.0 if noise is None else number_within("noise", noise, 0.0, LARGEST, "grey values >= 0")
    gain = number_within("gain", gain, 0.0, LARGEST, "grey values per electron >= 0")
    gain = gain or told.get("gain", 0.0)
    black = 0.0 if black is None else black
    dark = number_within("black", black, -LARGEST, LARGEST, "a grey value")
    return GreyNoise(read, gain, dark, step)


def _before_rounding(noise: float | None) -> float | None:
    """Standard deviation of grey values before they were rounded, from that of whole ones."""
    return None if noise is None else math.sqrt(max(noise**2 - 1.0 / 12.0, 0.0))


def checked_size(size_px: Any) -> tuple[int, int]:
    """A projector's (W, H); raises InputError if it is none."""
    return size_of("size_px", size_px, _MOST_PX)


def checked_axes(axes: Any) -> str:
    """Axes "u", "v" or both, as given; raises InputError else."""
    if not isinstance(axes, str) or sorted(axes) not in (["u"], ["v"], ["u", "v"]):
        raise InputError(f"axes is {short(axes)}; give 'uv', 'u' or 'v'")
    return axes


# --------------------------------------------------------------------- edges


def _beside_dark(status: NDArray[np.uint8]) -> NDArray[np.bool_]:
    """Pixels next to a region without light, which light of a part of their area alone."""
    reasons = (FringeStatus.BLACK, FringeStatus.LOW_MODULATION, FringeStatus.NOT_FINITE)
    return cv2.dilate(_regions(np.isin(status, reasons)), _SQUARE) > 0


def _in_splinters(ok: NDArray[np.bool_]) -> NDArray[np.bool_]:
    """Pixels of what is narrower than three, whose neighbours do not tell whether it is an edge."""
    good = 1 - _regions(~ok)
    return cv2.morphologyEx(good, cv2.MORPH_OPEN, _SQUARE) == 0


def _regions(mask: NDArray[np.bool_]) -> NDArray[np.uint8]:
    """A mask's connected regions of several pixels, 1 in them: single ones are noise."""
    whole = mask.astype(np.uint8)
    count, labels, sizes, _ = cv2.connectedComponentsWithStats(whole, connectivity=8)
    if count <= 2:
        return whole
    large = (sizes[:, cv2.CC_STAT_AREA] >= _REGION_PX).astype(np.uint8)
    large[0] = 0
    found: NDArray[np.uint8] = large[labels]
    return found


def _mixed(
    coordinate: NDArray[np.float64], sigma: NDArray[np.float32], mean: NDArray[np.float32]
) -> NDArray[np.bool_]:
    """Pixels whose coordinate is not that of their centre, as their neighbours show.

    They jump; or the surface's bend, and the light's change over the pixel, displace its mean by
    up to slope change/12 + bend/24.  Steps of a projector's square pixels are none.
    """
    place = coordinate.astype(np.float32)
    stairs = _STEP_PX if _stepped(coordinate) else 0.0
    found = np.zeros(place.shape, bool)
    for along in (0, 1):
        if place.shape[along] < 3:
            continue
        inner = np.s_[1:-1] if along == 0 else np.s_[:, 1:-1]
        bend, slope, change = (
            _filtered(image, kernel, along)[inner]
            for image, kernel in ((place, BEND), (place, _SLOPE), (mean, _SLOPE))
        )
        some = np.abs(bend[:: max(1, bend.shape[0] // 256), :: max(1, bend.shape[1] // 256)])
        middle = float(np.nanmedian(some)) if np.isfinite(some).any() else 0.0
        usual = max(_FAR * SIGMA_BY_MEDIAN * middle, stairs)
        spread = sigma[inner]
        found[inner] |= np.abs(bend) > np.float32(np.sqrt(6.0) * _FAR) * spread + (
            24.0 * _DISPLACED_PX + usual
        )
        with np.errstate(all="ignore"):
            slope *= change / mean[inner]
        displaced = np.abs(slope, out=slope) + 0.5 * np.abs(bend)
        most = np.maximum(spread, max(_DISPLACED_PX, usual / 24.0))
        found[inner] |= displaced > 12.0 * most
    return found


def _stepped(coordinate: NDArray[np.float64]) -> bool:
    """Whether coordinates gather at whole projector pixels, or at halves, thirds or quarters.

    So they do where a camera's pixel is the mean of a few samples of them.
    """
    known = coordinate[np.isfinite(coordinate)]
    known = known[:: max(1, known.size // _SAMPLE_PX)]
    turn = np.exp(2j * np.pi * known)
    return known.size > 0 and any(abs(np.mean(turn**part)) > _GATHERED for part in (1, 2, 3, 4))


def _filtered(image: NDArray[Any], kernel: NDArray[Any], along: int) -> NDArray[Any]:
    """An image with each pixel replaced by a sum over itself and its neighbours along an axis."""
    shape = (3, 1) if along == 0 else (1, 3)
    return np.asarray(cv2.filter2D(image, -1, kernel.reshape(shape)))


def described(codec: Codec, *words: str) -> str:
    """A codec's line."""
    width, height = codec.size_px
    return listed(f"{len(codec)} patterns of {width} x {height} px", *words)
