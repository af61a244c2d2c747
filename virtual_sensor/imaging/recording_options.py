"""How a command records what it renders: options of `measure` and its kin.

Nothing here loads the engine or NumPy before a frame is recorded: a command's help is quick.
"""

from __future__ import annotations

import math
from collections.abc import Callable
from dataclasses import asdict, dataclass, fields, replace
from pathlib import Path
from typing import TYPE_CHECKING, Any

from virtual_sensor.devices.exposure_time import exposure_time_s
from virtual_sensor.display import Displayed
from virtual_sensor.errors import InputError
from virtual_sensor.files import exists
from virtual_sensor.seeds import LARGEST_SEED, part_seed

if TYPE_CHECKING:
    from virtual_sensor.devices.image_sensor import ImageSensor
    from virtual_sensor.imaging.recording import RecordedFrame
    from virtual_sensor.imaging.render import Frame
    from virtual_sensor.imaging.scene import Scene
    from virtual_sensor.imaging.sequence import PatternFrames

_AXES = 3


@dataclass(frozen=True)
class RecordingOptions(Displayed):
    """How a command records what it renders: options of `measure` and its kin.

    Attributes
    ----------
    sensor_model : str, optional
        Record frames by this image sensor: the name of one that comes with the program
        (cmos_5um5, cmos_3um45, profile_sensor), or a .toml file of your own. By default by that of
        the scene's camera, if it has one; else frames are ideal.
    exposure : str, optional
        Exposure time, such as 2ms or 500us, for which the scene's camera needs an f-number; or
        auto, which puts the brightest pixel at 80 % of the saturation. By default the camera's own,
        else auto.
    seed : int
        Of the noise and the speckle; each frame's own follows from it.
    speckle : bool
        Speckle the laser's light, for which the scene's camera needs an f-number.
    velocity : str, optional
        Of the part, x, y, z in mm/s, such as 0,0,100: it smears the frame in its exposure time, and
        the rows of a rolling shutter (row_time_us of the sensor) skew it.
    difference : bool
        Record a second frame with the laser off, and take the difference: without the light of
        lamps and glow.
    """

    sensor_model: str | None = None
    exposure: str | None = None
    seed: int = 0
    speckle: bool = False
    velocity: str | None = None
    difference: bool = False

    def __post_init__(self) -> None:
        if self.velocity is not None and len(self.velocity_mm_s) != _AXES:
            raise InputError(
                f"--velocity {self.velocity[:40]}: give the part's x, y, z in mm/s, such as 0,0,100"
            )
        if self.exposure is not None:
            exposure_time_s("--exposure", self.exposure)
        if type(self.seed) is not int or not 0 <= self.seed <= LARGEST_SEED:
            from virtual_sensor.arrays import whole_number  # which loads NumPy

            whole_number("--seed", self.seed, 0, LARGEST_SEED)

    @property
    def asked(self) -> bool:
        """Whether frames are to be recorded, whatever the scene's camera has."""
        by_sensor = self.sensor_model is not None or self.exposure is not None
        return by_sensor or self.speckle or self.difference

    @property
    def velocity_mm_s(self) -> tuple[float, ...]:
        """Of the part; what is no three numbers is none."""
        try:
            found = tuple(map(float, (self.velocity or "0,0,0").split(",")))
        except ValueError:
            return ()
        return found if all(map(math.isfinite, found)) else ()

    @property
    def words(self) -> list[str]:
        """The options of a command that give these, where they are not the defaults."""
        said = []
        for each in fields(self):
            value, flag = getattr(self, each.name), f"--{each.name.replace('_', '-')}"
            if value != each.default:
                said.append(flag if value is True else f"{flag}={value}")
        return said

    def of(self, scene: Scene) -> ImageSensor | None:
        """The sensor that records a scene's frames; None: they stay ideal."""
        from virtual_sensor.imaging.recording import sensor_of

        own = scene.camera.sensor
        return sensor_of(scene, self.sensor_model) if self.asked or own is not None else None

    def unheeded(self, scene: Scene) -> list[str]:
        """Notes of what is said of recording, by options or the scene, and changes nothing."""
        from virtual_sensor.devices.coherence import Coherence
        from virtual_sensor.devices.laser import LaserLine

        notes = []
        if self.of(scene) is None:
            if self.seed:
                notes.append("--seed has no effect: frames are ideal; record them (--sensor-model)")
            if scene.camera.exposure_s is not None:
                notes.append(
                    f"{scene.camera_element}: exposure has no effect: frames are ideal; give a"
                    " sensor_model"
                )
        lasers = (each for each in scene.sources.values() if isinstance(each, LaserLine))
        if not self.speckle and any(each.coherence != Coherence() for each in lasers):
            notes.append(
                f"{scene.path}: what the scene says of the laser's coherence has no effect: its"
                " light is not speckled (--speckle)"
            )
        return notes

    def frame_seed(self, *parts: int | str) -> int:
        """Seed of a frame by its number, name or both, such as ("hot", 12); without, the own."""
        return part_seed(self.seed, *parts) if parts else self.seed

    def rendered(self, scene: Scene, progress: Callable[[float], None] | None = None) -> Frame:
        """The ideal frame, with the light of lamps and glow beside it where speckle needs that."""
        background = self.speckle or self.difference
        if not any(self.velocity_mm_s):
            from virtual_sensor.imaging.render import render_frame

            return render_frame(scene, progress=progress, background=background)
        from virtual_sensor.imaging.exposures import render_exposure

        said = scene.camera.exposure_s if self.exposure is None else self.exposure
        exposure_s = exposure_time_s("--exposure", said)
        if exposure_s is None:
            raise InputError(
                f"{scene.path}: --velocity {self.velocity}: how far the part moves in a frame"
                " follows from its exposure time; give one, such as --exposure 2ms"
            )
        sensor = self.of(scene)
        return render_exposure(
            scene,
            exposure_s,
            self.velocity_mm_s,
            row_time_s=sensor.row_time_s if sensor else 0.0,
            background=background,
            progress=progress,
        )

    def recorded(
        self, scene: Scene, frame: Frame | PatternFrames, *parts: int | str
    ) -> RecordedFrame | None:
        """A frame as recorded, with a seed of its own by its number or name; None: it stays ideal.

        All frames show one surface: a part at rest keeps its speckle.

        Raises
        ------
        InputError
            As `record` does.
        """
        from virtual_sensor.imaging.recording import record

        sensor = self.of(scene)
        if sensor is None:
            return None
        shot = record(
            scene,
            frame,
            self.frame_seed(*parts),
            sensor=sensor,
            exposure_s=None if any(self.velocity_mm_s) else self.exposure,  # the frame's own
            speckle=self.speckle,
            surface_seed=self.seed,
        )
        if not self.difference:
            return shot
        from virtual_sensor.imaging.difference import difference

        return difference(shot)

    def anywhere(self) -> RecordingOptions:
        """The same, with a sensor's file that is found from any folder."""
        file = Path(self.sensor_model or "")
        if not (file.suffix and exists(file)):
            return self
        return replace(self, sensor_model=str(file.absolute()))

    def inputs(self) -> dict[str, Any]:
        """What a recorded frame depends on beside the scene: the sensor's data sheet as a whole.

        Raises
        ------
        InputError
            If there is no such sensor.
        """
        from virtual_sensor.devices.image_sensor import image_sensor

        sensor = asdict(image_sensor(self.sensor_model)) if self.sensor_model else None
        return {**asdict(self), "sensor_model": sensor}
