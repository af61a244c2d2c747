"""Gray code: each column, or row, has a number whose bits are shown one after the other.

Neighbours differ in a single bit, so that a pixel at a border is wrong by one at most.  The order
of the patterns is that of OpenCV's `structured_light.GrayCodePattern`: the coarsest bit first, each
followed by its inverse, the columns before the rows.
"""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import NDArray

from virtual_sensor.arrays import truth_of
from virtual_sensor.calls import public
from virtual_sensor.devices.patterns import GrayBit, Pattern, Uniform
from virtual_sensor.metrology.fringes.codec import (
    AxisBlock,
    Block,
    Codec,
    Found,
    GreyNoise,
    checked_axes,
    checked_size,
    described,
)

_SIGMA_PX = 1.0 / np.sqrt(12.0)  # of a place that is anywhere within a pixel
_SAMPLE_PX = 40_000
_RESOLVED_PX = 3.0  # of the projector within a pixel: over four, stripes of two look inverted
_CLEAR = 3.0  # spreads by which a bit's two images must differ


def position(
    bright: NDArray[np.bool_], bits: Sequence[int]
) -> tuple[NDArray[np.float32], NDArray[np.int64]]:
    """Where stripes of Gray code are.

    Parameters
    ----------
    bright : ndarray of bool of shape (B, P)
        What of B bits is white, the coarsest first.
    bits : sequence of B int
        Their numbers; all coarser ones are there.

    Returns
    -------
    middle : ndarray of shape (P,)
        Of the stripe, in px from the image's border.
    stripe : ndarray of int of shape (P,)
        Its number.
    """
    number = np.zeros(bright.shape[1:], np.int64)
    last = np.zeros(bright.shape[1:], bool)
    for each in bright:
        last = last ^ each
        number = (number << 1) | last
    return ((number + 0.5) * 2.0 ** bits[-1]).astype(np.float32), number


@public
@dataclass(frozen=True, kw_only=True)
class GrayCode(Codec):
    """The Gray code of columns and rows, to whole projector pixels.

    Attributes
    ----------
    size_px : tuple of int
        (W, H) of the projector.
    axes : str
        "uv": columns and rows; "u" or "v": one of them.
    inverted : bool
        Whether each bit is followed by its inverse, with which it is compared; if not, a white and
        a black image come first, and bits are compared with their mean.
    """

    size_px: tuple[int, int] = (1280, 800)
    axes: str = "uv"
    inverted: bool = True

    def __post_init__(self) -> None:
        object.__setattr__(self, "size_px", checked_size(self.size_px))
        object.__setattr__(self, "axes", checked_axes(self.axes))
        truth_of("inverted", self.inverted)

    def _line(self) -> str:
        return described(self, f"axes {self.axes}", "inverted too" if self.inverted else "")

    @property
    def text(self) -> str:
        """The codec as `codec_of` takes it."""
        return f"gray {self.axes}{'' if self.inverted else ' single'}"

    def bits_of(self, axis: str) -> range:
        """Of an axis, the coarsest first."""
        return range(max((self.axis_px(axis) - 1).bit_length(), 1) - 1, -1, -1)

    def _patterns_of(self, axis: Any) -> Iterator[tuple[str, Pattern]]:
        if not self.inverted:
            yield f"{axis} white", Uniform(1.0)
            yield f"{axis} black", Uniform(0.0)
        for bit in self.bits_of(axis):
            for inverted in (False, True)[: 1 + self.inverted]:
                yield (
                    f"{axis} Gray bit {bit}{' inverted' * inverted}",
                    GrayBit(axis, bit, inverted),
                )

    @property
    def _has_phase(self) -> bool:
        return False

    def _pairs(self, block: Block) -> tuple[NDArray[Any], NDArray[Any]]:
        """Of each bit its images, and what they are compared with: (B, P) each."""
        grey = block.astype(np.float32, copy=False)
        if self.inverted:
            return grey[::2], grey[1::2]
        half = 0.5 * (grey[0] + grey[1])
        return grey[2:], np.broadcast_to(half, grey[2:].shape)

    def _seen_noise(self, stack: NDArray[Any], light: GreyNoise, clipped: float) -> GreyNoise:
        """From the spread of the sums of bits and their inverses, which should be the same."""
        if not self.inverted or len(stack) < 4:
            return light
        pixels = stack.shape[1] * stack.shape[2]
        grey = stack.reshape(len(stack), -1)[:, :: max(1, pixels // _SAMPLE_PX)].astype(float)
        with np.errstate(all="ignore"):
            variance = np.var(grey[::2] + grey[1::2], axis=0, ddof=1) / 2.0
        lit = variance[variance > 0.0]
        usual = float(np.median(lit)) if lit.size else 0.0
        return light.as_seen(usual)

    def _decode_axis(self, axis: str, block: Block, noise: GreyNoise) -> AxisBlock:
        lit, other = self._pairs(block)
        apart = np.abs(lit - other)
        middle, _ = position(lit > other, self.bits_of(axis))
        # One bit may be split between two stripes, at their border: the next to lowest counts.
        contrast = np.partition(apart, min(1, len(apart) - 1), axis=0)[min(1, len(apart) - 1)]
        contrast = contrast + 0.0 * apart.sum(axis=0)
        mean = 0.5 * (lit + other).mean(axis=0)
        coordinate = middle.astype(float) - 0.5
        coordinate[coordinate > self.axis_px(axis) - 0.5] = np.inf
        spread = np.sqrt(noise.variance(mean))
        return AxisBlock(
            coordinate=coordinate,
            sigma=np.full(mean.shape, _SIGMA_PX, np.float32),
            modulation=0.5 * contrast * (1.0 if self.inverted else 2.0),
            mean=mean,
            drowned=contrast < _CLEAR * spread,
        )

    def _doubts(
        self, found: Found, ok: NDArray[np.bool_], light: GreyNoise
    ) -> tuple[float, tuple[str, ...]]:
        notes = []
        for axis, coordinate in found.coordinate.items():
            steps = (np.abs(np.diff(coordinate, axis=along)) for along in (0, 1))
            known = [step[np.isfinite(step)] for step in steps]
            seen_px = sum(float(np.median(each)) for each in known if each.size)
            if seen_px > _RESOLVED_PX:
                notes.append(
                    f"A camera pixel sees about {seen_px:g} of the projector's pixels along {axis}:"
                    " the finest stripes are lost in it, and pixels wrong by more than their sigma;"
                    " count fringes by Gray code ('phase 4 16 uv gray'), or take smaller pixels."
                )
        return 0.0, tuple(notes)

    def _clipped(self, block: Block, saturation: float) -> NDArray[np.bool_]:
        """Where both images of a bit are clipped, the bit is lost."""
        lit, other = self._pairs(block)
        both = np.asarray((lit >= saturation) & (other >= saturation))
        return np.asarray(both.any(axis=0))
