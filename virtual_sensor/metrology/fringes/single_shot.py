"""A single image of fringes: Fourier transform profilometry.

The band about the carrier's frequency, moved back, is B/2 exp(i phi): Takeda and Mutoh 1983,
Applied Optics 22, 3977.  What changes within less than about two fringes is lost.
"""

from __future__ import annotations

import math
from collections.abc import Iterator
from dataclasses import dataclass
from typing import Any

import cv2
import numpy as np
from numpy.typing import NDArray
from scipy import fft

from virtual_sensor.arrays import number_within
from virtual_sensor.calls import public
from virtual_sensor.devices.patterns import Pattern, Sine
from virtual_sensor.metrology.covariance import SIGMA_BY_MEDIAN
from virtual_sensor.metrology.fringes.codec import (
    BEND,
    NOISIEST_PHASE_RAD,
    AxisBlock,
    Block,
    Codec,
    Found,
    GreyNoise,
    checked_axes,
    checked_size,
    described,
    unwrap_in_space,
)

_FEWEST_FRINGES = 4.0  # within the image: fewer are none apart from its brightness
_FAINT = 1e-9  # of the image's brightness: a carrier of that strength is rounding
_REACH = 4.0  # of the band's window, in its widths
_LONGEST_PX = 1e6
_TURN = 2.0 * math.pi


@public
@dataclass(frozen=True, kw_only=True)
class SingleShot(Codec):
    """Sinusoidal fringes of one period, decoded from one image of each axis.

    The coordinates lack whole periods: as many for each connected region.  Columns are taken to
    grow along the camera's u, rows along its v.

    Attributes
    ----------
    size_px : tuple of int
        (W, H) of the projector.
    period_px : float
        Of the fringes.
    axes : str
        "u", "v", or "uv": an image of each.
    """

    size_px: tuple[int, int] = (1280, 800)
    period_px: float = 16.0
    axes: str = "u"

    def __post_init__(self) -> None:
        object.__setattr__(self, "size_px", checked_size(self.size_px))
        object.__setattr__(self, "axes", checked_axes(self.axes))
        number_within("period_px", self.period_px, 2.0, _LONGEST_PX, "a period from 2 px on")

    def _line(self) -> str:
        return described(self, f"period {self.period_px:g} px", f"axes {self.axes}")

    @property
    def text(self) -> str:
        """The codec as `codec_of` takes it."""
        return f"single {self.period_px:.12g} {self.axes}"

    def _patterns_of(self, axis: Any) -> Iterator[tuple[str, Pattern]]:
        yield f"{axis} {self.period_px:g} px", Sine(axis, self.period_px)

    @property
    def absolute(self) -> bool:
        """Whether coordinates are the projector's own, not lacking whole periods."""
        return False

    def _all_blocks(self, stack: NDArray[Any], light: GreyNoise, clipped: float) -> Found:
        """The spectrum is one of the whole image."""
        shape = stack.shape[1:]
        found, all_rows = Found.empty(shape, self.axes), slice(0, shape[0])
        for axis in self.axes:
            image = stack[self.images_of(axis)][0]
            if clipped < np.inf:
                found.clipped |= image >= clipped
            found.put(axis, all_rows, self._decode_image(axis, image, light))
        return found

    def _seen_noise(self, stack: NDArray[Any], light: GreyNoise, clipped: float) -> GreyNoise:
        """From differences of second differences, which fringes hardly have (Immerkaer 1996)."""
        found = []
        for image in stack:
            if min(image.shape) < 3:
                return light
            grey = image.astype(np.float32)
            rough = np.abs(cv2.filter2D(grey, -1, np.outer(BEND, BEND))[1:-1, 1:-1])
            rough = rough[np.isfinite(rough) & (grey[1:-1, 1:-1] < clipped)]
            lit = rough[rough > 0.0]
            found.append(float(np.median(lit)) / 6.0 * SIGMA_BY_MEDIAN if lit.size else 0.0)
        return light.as_seen(float(np.mean(found)) ** 2)

    def _decode_image(self, axis: str, image: NDArray[Any], noise: GreyNoise) -> AxisBlock:
        holes = ~np.isfinite(image)
        grey = image.astype(float)
        grey[holes] = 0.0
        spectrum = fft.fft2(grey, workers=-1)
        carrier, wide = _carrier(spectrum, axis)
        band, share = _band(spectrum, carrier, wide)
        signal = fft.ifft2(band, workers=-1)
        background, _ = _band(spectrum, np.zeros(2), wide)
        turns = np.angle(signal).astype(np.float32) * np.float32(1.0 / _TURN)
        turns += turns < 0.0
        modulation = (2.0 * np.abs(signal)).astype(np.float32)
        mean = fft.ifft2(background, workers=-1).real.astype(np.float32)
        modulation[holes] = np.nan
        with np.errstate(divide="ignore", invalid="ignore"):
            sigma = np.sqrt(2.0 * share * noise.variance(mean)) / modulation
        return AxisBlock(
            coordinate=turns * float(self.period_px) - 0.5,
            sigma=np.float32(self.period_px / _TURN) * sigma,
            modulation=modulation,
            mean=mean,
            phase=np.float32(_TURN) * turns,
            drowned=sigma > NOISIEST_PHASE_RAD,
        )

    def _decode_axis(self, axis: str, block: Block, noise: GreyNoise) -> AxisBlock:
        raise NotImplementedError  # it is never asked for blocks

    def _clipped(self, block: Block, saturation: float) -> NDArray[np.bool_]:
        raise NotImplementedError

    def _unwrap_space(self, found: Found, status: NDArray[np.uint8]) -> None:
        unwrap_in_space(found, status, self.period_px, self.size_px)


def _carrier(spectrum: NDArray[Any], axis: str) -> tuple[NDArray[np.float64], float]:
    """The fringes' frequency (u, v) in a spectrum (H, W), per px, and how wide their band is.

    It is the strongest of more than a few fringes in the image that runs rather along the axis than
    across it.  Where there is none, the band is 0 wide.
    """
    across, along = _frequencies(spectrum)
    ahead, beside = (along, across) if axis == "u" else (across, along)
    least = _FEWEST_FRINGES / spectrum.shape[1 if axis == "u" else 0]
    power = np.where((ahead >= least) & (np.abs(beside) <= ahead), np.abs(spectrum), 0.0)
    row, column = np.unravel_index(int(np.argmax(power)), power.shape)
    if not power[row, column] > _FAINT * np.abs(spectrum[0, 0]):
        return np.zeros(2), 0.0
    carrier = np.array([along[0, column], across[row, 0]])
    return carrier, float(np.hypot(*carrier)) / 4.0


def _band(
    spectrum: NDArray[Any], middle: NDArray[np.float64], wide: float
) -> tuple[NDArray[Any], float]:
    """The part of a spectrum about a frequency, and which share of white noise it passes.

    The window is Gaussian.
    """
    if not wide:
        return np.zeros_like(spectrum), 0.0
    across, along = _frequencies(spectrum)
    far2 = ((along - middle[0]) ** 2 + (across - middle[1]) ** 2) / wide**2
    window = np.exp(-0.5 * far2) * (far2 < _REACH**2)
    return spectrum * window, float(np.mean(window**2))


def _frequencies(spectrum: NDArray[Any]) -> tuple[NDArray[np.float64], NDArray[np.float64]]:
    """Along v and along u, each of shape (H, W) by broadcasting."""
    height, width = spectrum.shape
    return fft.fftfreq(height)[:, None], fft.fftfreq(width)[None]
