"""The camera as it is built: the lines of sight of a pinhole, and the lens and sensor behind them.

Nothing of what lies behind the projection centre changes where a camera looks: a search and a
triangulation know its chief rays alone, which are those of a `Pinhole` with its distortion.
"""

from __future__ import annotations

from dataclasses import dataclass, fields, replace
from typing import Any

import numpy as np
from numpy.typing import NDArray

from virtual_sensor.display import listed
from virtual_sensor.optics.ray_families import Pinhole

Array = NDArray[np.float64]

SUB_PUPILS = 16
"""Points of the pupil that a frame is rendered through, unless others are asked for."""


@dataclass(frozen=True)
class LensCamera(Pinhole):
    """A camera with what it is built of; what a pinhole has not is None.

    Attributes
    ----------
    matrix, pose, size, distortion, fisheye
        Of the chief rays, those through the middle of the pupil: as a `Pinhole`'s.
    lens : Lens or None
        Its blur and its light; None: a pinhole, which is sharp everywhere.
    sub_pupils : int
        Points of the lens's pupil that a frame is rendered through; 1: only the middle, so that the
        lens gives the light and no blur.
    pixel_um : float or None
        Pitch of the sensor's pixels.
    sensor : ImageSensor or None
        What turns light into grey values; None: frames are radiance.
    exposure_s : float or None
        None: as long as the sensor needs.
    transmission : float
        Of the lens: the part of the light that it lets through.
    """

    lens: Any = None
    sub_pupils: int = SUB_PUPILS
    pixel_um: float | None = None
    sensor: Any = None
    exposure_s: float | None = None
    transmission: float = 1.0

    def _line(self) -> str:
        lens = self.lens._line() if self.lens else ""
        return listed(super()._line(), lens, self.sensor.name if self.sensor else "")

    @property
    def chief(self) -> Pinhole:
        """Its chief rays alone."""
        return Pinhole(self.matrix, self.pose, self.size, self.distortion, self.fisheye)

    def with_chief(self, pinhole: Pinhole) -> LensCamera:
        """The same lens and sensor behind other lines of sight, such as calibrated ones."""
        names = (field.name for field in fields(Pinhole))
        return replace(self, **{name: getattr(pinhole, name) for name in names})
