"""How the commands of fringes record the frames of a sequence of patterns.

Nothing here loads the engine or NumPy before a frame is recorded: a command's help is quick.
"""

from __future__ import annotations

from dataclasses import dataclass, field
from typing import TYPE_CHECKING, Any

from virtual_sensor.devices.exposure_time import AUTO
from virtual_sensor.errors import InputError
from virtual_sensor.imaging.recording_options import RecordingOptions

if TYPE_CHECKING:
    import numpy as np
    from numpy.typing import NDArray

    from virtual_sensor.devices.image_sensor import ImageSensor
    from virtual_sensor.imaging.recording import RecordedFrame
    from virtual_sensor.imaging.scene import Scene
    from virtual_sensor.imaging.sequence import PatternFrames

_EXPOSED = 0.9  # of the grey values is where the brightest pixel lies, of frames without noise


@dataclass(frozen=True)
class FringeRecording(RecordingOptions):
    """How frames of fringes are recorded, all exposed alike; without any of it they are ideal.

    Attributes
    ----------
    seed : int
        Of the noise.
    speckle : bool
        A projector's light has none.
    velocity : str, optional
        The part is at rest while the patterns are shown.
    difference : bool
        Codecs find the light that does not change by themselves.
    electrons : float, optional
        Record the frames with a sensor's noise, so exposed that the brightest pixel of all has so
        many electrons, in place of --exposure.
    bits : int, optional
        Of the sensor, in place of --sensor-model; by default 12 with --electrons. Without
        --electrons grey values are rounded, and have no noise.
    """

    speckle: bool = field(default=False, metadata={"internal": True})
    velocity: str | None = field(default=None, metadata={"internal": True})
    difference: bool = field(default=False, metadata={"internal": True})
    electrons: float | None = None
    bits: int | None = None

    def __post_init__(self) -> None:
        super().__post_init__()
        if self.electrons is None and self.bits is None:
            return
        from virtual_sensor.arrays import number_within, whole_number

        if self.electrons is not None:
            number_within("--electrons", self.electrons, 1.0, 1e9, "1 to 1e9")
            if self.exposure is not None:
                raise InputError("--electrons and --exposure both say the exposure; leave out one")
        if self.bits is not None:
            whole_number("--bits", self.bits, 1, 16)
            if self.sensor_model is not None:
                raise InputError(
                    f"--bits {self.bits}: {self.sensor_model} has bits of its own; leave out --bits"
                    " or --sensor-model"
                )

    @property
    def asked(self) -> bool:
        """Whether frames are to be recorded, whatever the scene's camera has."""
        return self.electrons is not None or super().asked

    def of(self, scene: Scene) -> ImageSensor | None:
        """The sensor that records a scene's frames, of so many bits; None: they have no noise."""
        sensor = super().of(scene)
        return sensor if sensor is None or self.bits is None else sensor.with_bits(self.bits)

    def bits_of(self, scene: Scene) -> int | None:
        """Of the grey values; None where they are not rounded."""
        sensor = self.of(scene)
        return self.bits if sensor is None else sensor.bit_depth

    def shot(
        self, scene: Scene, frames: PatternFrames | NDArray[Any], *parts: int | str
    ) -> RecordedFrame | NDArray[Any]:
        """Frames (..., H, W) of one exposure as recorded, or rounded, or as they are.

        `parts` name what is recorded, where there are several sequences: their noise differs.

        Raises
        ------
        InputError
            As `record` does.
        """
        import numpy as np

        from virtual_sensor.imaging.recording import record

        sensor = self.of(scene)
        if sensor is None:
            radiance = np.asarray(frames)
            return radiance if self.bits is None else _rounded(radiance, self.bits)
        seed = self.frame_seed(*parts)
        return record(scene, frames, seed, sensor=sensor, **self._exposed(sensor))

    def electrons_of(self, scene: Scene, brightest: float) -> float:
        """Electrons of the brightest pixel of frames with such a radiance there; 0 without noise.

        Raises
        ------
        InputError
            As `record` does.
        """
        import numpy as np

        from virtual_sensor.imaging.recording import exposure_of

        sensor = self.of(scene)
        if sensor is None:
            return 0.0
        factor, _, _ = exposure_of(scene, sensor, np.array([[brightest]]), **self._exposed(sensor))
        return factor * brightest

    def _exposed(self, sensor: ImageSensor) -> dict[str, Any]:
        """The exposure, as `record` takes it."""
        if self.electrons is None:
            return {"exposure_s": self.exposure}
        return {"exposure_s": AUTO, "peak": self.electrons / sensor.saturation_e}

    def facts(self, shot: RecordedFrame | NDArray[Any]) -> dict[str, Any]:
        """How frames were recorded, for the results: bits, seed, sensor, exposure, electrons."""
        import numpy as np

        told = {"bits": self.bits, "seed": self.seed}
        if isinstance(shot, np.ndarray):
            return {**told, "electrons": None, "sensor": None, "exposure_s": None}
        brightest = float(np.max(np.asarray(shot.ideal))) * shot.electrons_per_radiance
        return {
            **told,
            "bits": shot.sensor.bit_depth,
            "electrons": self.electrons or float(f"{brightest:.4g}"),
            "sensor": shot.sensor.name or "usual",
            "exposure_s": shot.exposure_s,
        }

    @staticmethod
    def decoded(codec: Any, images: Any, **options: Any) -> Any:
        """Frames as `shot` gives them, decoded with what is known of their noise."""
        known = {} if hasattr(images, "detector_options") else {"noise": 0.0}
        return codec.decode(images, **known, **options)


def _rounded(radiance: NDArray[Any], bits: int) -> NDArray[np.uint16]:
    """Grey values of so many bits, of which the brightest pixel has nine tenths."""
    import numpy as np

    brightest = float(radiance.max(initial=0.0)) or 1.0
    scale = np.float32(_EXPOSED * (2**bits - 1) / brightest)
    grey = np.empty(radiance.shape, np.uint16)
    for frame, rounded in zip(radiance, grey, strict=True):
        np.rint(frame * scale, out=rounded, casting="unsafe")
    return grey
