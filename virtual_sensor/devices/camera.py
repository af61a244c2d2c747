"""The camera as it is built: the lines of sight of a pinhole, and the lens and sensor behind them.

Nothing of what lies behind the projection centre changes where a camera looks: a search and a
triangulation know its chief rays alone, which are those of a `Pinhole` with its distortion.
"""

from __future__ import annotations

import math
from dataclasses import dataclass, fields, replace
from typing import Any

import numpy as np
from numpy.typing import ArrayLike, NDArray

from virtual_sensor.arrays import LARGEST, SMALLEST, number_within, vector_of, whole_number
from virtual_sensor.devices.image_sensor import ImageSensor
from virtual_sensor.display import listed
from virtual_sensor.errors import InputError
from virtual_sensor.optics.lens import MOST_POINTS, USUAL_SUB_PUPILS, Lens
from virtual_sensor.optics.ray_families import Pinhole

Array = NDArray[np.float64]

MM_PER_UM = 1e-3

_CHIEF = tuple(each.name for each in fields(Pinhole))
_TILTED = 14  # coefficients of a distortion whose last two are the sensor's tilt
_WIDEST_UM = 1e6
_ASLANT = 1e-3  # cosine between a camera's axis and a plane's normal, at least


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

    lens: Lens | None = None
    sub_pupils: int = USUAL_SUB_PUPILS
    pixel_um: float | None = None
    sensor: ImageSensor | None = None
    exposure_s: float | None = None
    transmission: float = 1.0

    def __post_init__(self) -> None:
        whole_number("LensCamera: sub_pupils", self.sub_pupils, 1, MOST_POINTS)
        for name, most, advice in (
            ("pixel_um", _WIDEST_UM, "the pitch of the pixels in um"),
            ("exposure_s", LARGEST, "a time in s, or None for the time that the sensor needs"),
            ("transmission", 1.0, "a part, above 0 and up to 1"),
        ):
            if (value := getattr(self, name)) is not None:
                value = number_within(f"LensCamera: {name}", value, SMALLEST, most, advice)
                object.__setattr__(self, name, value)

    def _line(self) -> str:
        lens = self.lens._line() if self.lens else ""
        return listed(super()._line(), lens, self.sensor.name if self.sensor else "")

    @property
    def chief(self) -> Pinhole:
        """Its chief rays alone."""
        return Pinhole(*(getattr(self, name) for name in _CHIEF))

    @property
    def lens_with_pupil(self) -> Lens | None:
        """Its lens if that has an aperture; None of a pinhole."""
        return self.lens if self.lens and self.lens.pupil_radius_mm else None

    @property
    def blurs(self) -> bool:
        """Whether frames are rendered through more of a pupil than its middle."""
        return self.lens_with_pupil is not None and self.sub_pupils > 1

    @property
    def image_distance_mm(self) -> float | None:
        """From the lens to the sensor, along the axis; None where the pixels' pitch is unknown."""
        if self.lens:
            return self.lens.image_distance_mm
        return abs(float(self.matrix[0, 0])) * self.pixel_um * MM_PER_UM if self.pixel_um else None

    def focused_on(self, normal: ArrayLike, offset_mm: float) -> LensCamera:
        """The same with its sensor tilted, and its lens focused, as a plane is in focus.

        Scheimpflug's rule: the image distance stays, and the focus distance is where the camera's
        axis meets the plane, such as a laser's (``scene.laser.plane``).

        Parameters
        ----------
        normal : array_like of shape (3,)
        offset_mm : float
            The plane is normal . x = offset, world.

        Raises
        ------
        InputError
            If the plane is not before the camera or holds its axis, or the pixels' pitch is not
            known.
        """
        image_mm = self.image_distance_mm
        if image_mm is None:
            raise InputError(
                "the tilt that focuses a plane needs the image distance; give the pixels' pitch"
            )
        across = vector_of("focused_on: normal", normal) @ self.pose.rotation
        away_mm = offset_mm - float(np.dot(normal, self.pose.origin_mm))
        if not across[2] * away_mm > _ASLANT * abs(away_mm) * np.linalg.norm(across):
            raise InputError(
                "the plane that is to be in focus holds the camera's axis, or is not before it;"
                " turn the camera"
            )
        # 1/g - w . (p, q) is 1/z on the plane, whose points are z (p, q, 1).
        by_p, by_q = -image_mm * across[:2] / away_mm
        tau_x = -math.atan(by_q)
        tau_y = math.atan(by_p * math.cos(tau_x))
        focus_mm = float(away_mm / across[2])
        lens = replace(self.lens, focus_distance_mm=focus_mm) if self.lens else None
        tilt_deg = math.degrees(tau_x) + 0.0, math.degrees(tau_y) + 0.0  # without -0
        return with_tilt(replace(self, lens=lens), tilt_deg)

    @staticmethod
    def of(chief: Pinhole, **built: Any) -> LensCamera:
        """The camera of a pinhole's lines of sight, and what it is built of."""
        return LensCamera(*(getattr(chief, name) for name in _CHIEF), **built)

    def with_chief(self, pinhole: Pinhole) -> LensCamera:
        """The same lens and sensor behind other lines of sight, such as calibrated ones."""
        return replace(self, **{name: getattr(pinhole, name) for name in _CHIEF})


def tilt_of(camera: Pinhole) -> tuple[float, float]:
    """By how much a camera's sensor is tilted about x, then about y, degrees."""
    tilted = camera.distortion.size == _TILTED and not camera.fisheye
    tau_x, tau_y = np.degrees(camera.distortion[-2:]).tolist() if tilted else (0.0, 0.0)
    return tau_x, tau_y


def with_tilt(camera: LensCamera, tilt_deg: tuple[float, float]) -> LensCamera:
    """A camera with its sensor tilted about x, then about y, instead of as it was.

    The tilt of the chief rays is the distortion's; that of what is in focus, the lens's.
    """
    if camera.fisheye:
        raise InputError("a fisheye's sensor can't be tilted; give OpenCV's usual lens")
    distortion = np.zeros(_TILTED)
    distortion[: camera.distortion.size] = camera.distortion
    distortion[-2:] = np.radians(tilt_deg)
    lens = replace(camera.lens, sensor_tilt_deg=tilt_deg) if camera.lens else None
    return replace(camera, distortion=distortion, lens=lens)
