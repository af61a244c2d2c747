"""How a camera records rendered frames: with noise and rounding, or as they are."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import NDArray

from virtual_sensor.arrays import number_within, whole_number
from virtual_sensor.devices.image_sensor import ImageSensor
from virtual_sensor.display import Displayed
from virtual_sensor.imaging.grey_values import grey_values
from virtual_sensor.metrology.fringes.codec import Codec
from virtual_sensor.metrology.fringes.decoded import DecodedFringes

_EXPOSED = 0.9  # of the grey values is where the brightest pixel lies


@dataclass(frozen=True)
class Recording(Displayed):
    """How a camera records the frames.

    Attributes
    ----------
    electrons : float or None
        Of the brightest pixel of all frames; None: without noise.
    bits : int or None
        To which grey values are rounded; None: 12 with noise, else not at all.
    seed : int
        Of the noise.
    """

    electrons: float | None = None
    bits: int | None = None
    seed: int = 0

    def __post_init__(self) -> None:
        if self.electrons is not None:
            number_within("--electrons", self.electrons, 1.0, 1e9, "1 to 1e9")
        if self.bits is not None:
            whole_number("--bits", self.bits, 1, 16)

    @property
    def resolved_bits(self) -> int | None:
        """Of the grey values; None where they are not rounded."""
        return self.bits or (None if self.electrons is None else ImageSensor().bit_depth)

    @property
    def camera(self) -> ImageSensor | None:
        """Of so many bits, whose largest grey values are those of a full well."""
        bits, usual = self.resolved_bits, ImageSensor()
        if self.electrons is None or bits is None:
            return None
        finer = (2**bits - 1) / usual.white
        gain, black = usual.gain * finer, usual.black_level * finer
        return ImageSensor(gain=gain, black_level=black, bit_depth=bits)

    def recorded(self, radiance: NDArray[np.float32], seed: int | None = None) -> NDArray[Any]:
        """Grey values of frames (..., H, W) of one exposure; the radiance as it is without either.

        `seed` stands for the recording's own, where there are several sequences.
        """
        if self.electrons is not None:
            seed = self.seed if seed is None else seed
            return grey_values(radiance, self.camera, seed, peak_e=self.electrons)
        return radiance if self.bits is None else _rounded(radiance, self.bits)

    def decoded(self, codec: Codec, images: NDArray[Any], **options: Any) -> DecodedFringes:
        """Recorded frames (K, H, W), decoded with what is known of the camera."""
        if self.electrons is not None:
            return codec.decode(images, sensor=self.camera, **options)
        return codec.decode(images, noise=0.0, **options)


def _rounded(radiance: NDArray[np.float32], bits: int) -> NDArray[np.uint16]:
    """Grey values of so many bits, of which the brightest pixel has nine tenths."""
    brightest = float(radiance.max(initial=0.0)) or 1.0
    scale = np.float32(_EXPOSED * (2**bits - 1) / brightest)
    grey = np.empty(radiance.shape, np.uint16)
    for frame, rounded in zip(radiance, grey, strict=True):
        np.rint(frame * scale, out=rounded, casting="unsafe")
    return grey
