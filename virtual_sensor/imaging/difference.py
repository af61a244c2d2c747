"""Laser on, laser off: the difference of two frames, or images, holds the laser's light alone.

Ambient light, the part's glow, the dark current and the fixed pattern of offsets are in both frames
and cancel; their noise adds up.
"""

from __future__ import annotations

import math
from dataclasses import dataclass, fields, replace
from functools import cached_property
from typing import Any, overload

import numpy as np
from numpy.typing import NDArray

from virtual_sensor.calls import public
from virtual_sensor.devices.image_sensor import ImageSensor
from virtual_sensor.display import listed
from virtual_sensor.errors import InputError, naming, short
from virtual_sensor.imaging.dark_images import without_other_light
from virtual_sensor.imaging.image_files import Image
from virtual_sensor.imaging.recording import RecordedFrame, grey_of_radiance
from virtual_sensor.imaging.render import Frame
from virtual_sensor.seeds import part_seed

_MOST_BITS = 16
_SIGMAS = 6.0  # of the noise lie above 0, so that none of it is cut off there


@dataclass(frozen=True, eq=False)
class DifferenceFrame(RecordedFrame):
    """A frame with the laser on minus one with it off, above a pedestal.

    Attributes
    ----------
    grey : ndarray of shape (H, W)
        On minus off plus the pedestal; white where a pixel is saturated in either.
    ideal, sensor, exposure_s, electrons_per_radiance, seed, drawn, parameters, scene, camera
        Of the frame with the laser on: see `RecordedFrame`.
    notes, speckled
        Likewise.
    on_grey, off_grey : ndarray of shape (H, W)
        Grey values of the two, as the camera gave them.
    on_sensor : ImageSensor
        That recorded both; `sensor` is one without a knee-point that gives the difference.
    pedestal : float
        Grey value of no light: so high that noise does not reach down to 0.
    """

    on_grey: NDArray = None  # type: ignore[assignment]
    off_grey: NDArray = None  # type: ignore[assignment]
    on_sensor: ImageSensor = None  # type: ignore[assignment]
    pedestal: float = 0.0

    def _line(self) -> str:
        return listed(super()._line(), f"on minus off, above {self.pedestal:g}")

    @cached_property
    def on(self) -> RecordedFrame:
        """The frame with the laser on."""
        held = {each.name: getattr(self, each.name) for each in fields(RecordedFrame)}
        return RecordedFrame(**{**held, "grey": self.on_grey, "sensor": self.on_sensor})

    @property
    def detector_options(self) -> dict[str, float]:
        """As those of a `RecordedFrame`: with the noise of both frames, and of the other light."""
        return {
            **self.on.detector_options,
            "noise": _noise(self.on, self.off_grey),
            "saturation": self.sensor.saturation,
            "black": self.pedestal,
        }

    @property
    def linear_grey(self) -> RecordedFrame:
        """Itself: frames of a sensor with a knee-point are stretched back before."""
        return self


@overload
def difference(on: RecordedFrame, off: RecordedFrame | None = None) -> DifferenceFrame: ...
@overload
def difference(on: Image, off: Image) -> Image: ...
@public
def difference(
    on: RecordedFrame | Image, off: RecordedFrame | Image | None = None
) -> DifferenceFrame | Image:
    """A recorded frame or image with the laser on, minus one with it off.

    >>> frame = vs.render_frame(scene, background=True)
    >>> shot = vs.difference(vs.record(scene, frame, seed=1))
    >>> line = vs.line_centres(shot)
    >>> seen = vs.difference(vs.read_image("on.png"), vs.read_image("off.png"))

    Parameters
    ----------
    on : RecordedFrame or Image
    off : RecordedFrame or Image, optional
        By the same sensor, exposed as long; by default what that records of the first frame's
        `background`, with noise of its own.

    Returns
    -------
    DifferenceFrame or Image
        An image's pixels are float32, negative ones too; where `on` is clipped they are at
        `largest`, and NaN where `off` is.  Its notes say where the two don't go together.

    Raises
    ------
    InputError
        If one is no recorded frame or image, or a sequence; they differ in sensor, exposure or
        size, or are the same image; or there is no `off` and the first frame knows no background.
    """
    if isinstance(on, Image):
        if not isinstance(off, Image):
            raise InputError(f"difference: off is {short(off)}; give an image (vs.read_image)")
        with naming("difference"):
            return without_other_light(on, off)
    if not isinstance(on, RecordedFrame) or np.ndim(on.grey) != 2:
        raise InputError(
            f"difference: on is {short(on)}; give one recorded frame (vs.record), or an image"
            " (vs.read_image)"
        )
    if off is None:
        dark, seed = _off_grey(on), _seed(on)
    else:
        checked = _checked(on, off)
        dark, seed = checked.grey, checked.seed
    sensor = on.sensor
    straight = sensor.without_knee
    pedestal = float(math.ceil(max(sensor.black_level, _SIGMAS * _noise(on, dark))))
    level = straight(on.grey) - straight(dark) + np.float32(pedestal)
    saturated = (on.grey >= sensor.saturation) | (dark >= sensor.saturation)
    if sensor.knee is not None:  # as a sensor would give it whose range is that of the light
        well_e = float(straight(sensor.white)) / sensor.gain
        sensor = replace(sensor, knee=None, bit_depth=_MOST_BITS, full_well_e=well_e)
    grey = np.rint(np.clip(np.where(saturated, sensor.white, level), 0.0, sensor.white))
    grey = grey.astype(sensor.kind)
    held: dict[str, Any] = {each.name: getattr(on, each.name) for each in fields(RecordedFrame)}
    held |= {"grey": grey, "sensor": sensor}
    held |= {"drawn": {**on.drawn, "off": seed}}
    return DifferenceFrame(
        **held, on_grey=on.grey, off_grey=dark, on_sensor=on.sensor, pedestal=pedestal
    )


def _seed(on: RecordedFrame) -> int:
    return part_seed(on.seed, "off")


def _off_grey(on: RecordedFrame) -> NDArray:
    """What the sensor records of a frame's background, exposed as long."""
    background = on.ideal.background if isinstance(on.ideal, Frame) else None
    if background is None:
        raise InputError(
            "difference: the frame knows no light without the laser; render it by"
            " vs.render_frame(scene, background=True), or give the recorded one too (off=)"
        )
    return grey_of_radiance(
        background, on.electrons_per_radiance, on.specimen, _seed(on), on.exposure_s
    )


def _checked(on: RecordedFrame, off: Any) -> RecordedFrame:
    if not isinstance(off, RecordedFrame):
        raise InputError(f"difference: off is {short(off)}; give a recorded frame (vs.record)")
    if off.grey.shape != on.grey.shape or off.sensor != on.sensor:
        raise InputError(
            "difference: on and off are of two sensors, or of two sizes; record both by the same"
        )
    ratio = off.electrons_per_radiance / on.electrons_per_radiance if on.electrons.any() else 1.0
    if not math.isclose(ratio, 1.0, rel_tol=1e-6):
        raise InputError(
            f"difference: off is exposed {ratio:.4g} times as long as on; record it with"
            " exposure_s=on.exposure_s, or leave it out"
        )
    return off


def _noise(on: RecordedFrame, off_grey: NDArray) -> float:
    """Of the difference where no laser light is, grey values: twice the dark's and the light's."""
    known = on.detector_options
    light = on.sensor.without_knee(off_grey)
    lit = getattr(on.ideal, "lit", None)
    if lit is not None and lit.any():
        light = light[lit]
    shot = max(float(np.median(light)) - known["black"], 0.0) * known["gain"]
    return math.sqrt(2.0 * (known["noise"] ** 2 + shot))
