"""The images of a trial, with the true rows of their lines and the smallest error possible."""

from __future__ import annotations

from dataclasses import dataclass, field
from typing import TYPE_CHECKING, Any

import numpy as np
from numpy.typing import NDArray

from virtual_sensor.devices.image_sensor import ImageSensor, image_sensor
from virtual_sensor.display import Displayed, span
from virtual_sensor.imaging.grey_values import exposed, grey_values
from virtual_sensor.imaging.speckle import Aperture, speckled
from virtual_sensor.metrology.drawn_lines import cramer_rao_px, line_shares
from virtual_sensor.metrology.truth import TrueLine
from virtual_sensor.records import Record

if TYPE_CHECKING:  # the processes that try detectors need no renderer
    from virtual_sensor.imaging.render import Frame

Array = NDArray[np.float64]

HEIGHT_PX = 64
SPECKLE = Aperture(5.6, pixel_um=5.5, polarisations=2)
CLIPPED = 2.0  # times the full well: the peak of a saturated line
AMBIENT_ELECTRONS = 100.0  # of a pixel
EXPOSED = 0.8  # of what a sensor can tell is where a line's peak lies, unless it is given
HARD_WELL_E, HARD_NOISE_E = 10_000.0, 3.0  # of the camera of hard frames
AMOUNTS = {
    "clipped frame": ("{:g} times the full well", "times the full well at the line's peak"),
    "edged frame": ("edges of {:g}:1", "bright over dark at edges of the reflectance"),
    "speckled frame": ("f/{:g}", "f-number"),
    "ambient frame": ("ambient light of {:.0%}", "ambient light over the line's peak"),
    "spattered frame": ("{:g} sparks", "sparks in 1000 columns"),
    "ghostly frame": ("roughness {:g}", "roughness of the steel of a V-groove"),
}
"""Hard frames by their kind: how an amount of what makes them hard is written, and what it is."""

_FULL_WELL_ELECTRONS = 60_000.0
_SWING_PX, _WAVE_PX = 2.0, 600.0  # amplitude and length of a drawn line's waves


@dataclass(frozen=True)
class Condition(Record):
    """What an image is like.

    Attributes
    ----------
    kind : str
        "task", "clean": a drawn line in shot and read noise; "saturated", "speckle",
        "ambient light": the same with that too; "cold frame", "hot frame": rendered; so are the
        hard ones: "clipped frame", "edged frame", "speckled frame", "ambient frame", "spattered
        frame", "ghostly frame".
    width_px : float
        Standard deviation of the line's profile; of a rendered frame the median, as measured.
    column_electrons : float
        That a column of the line makes; of a rendered frame its brightest column.
    read_noise_electrons : float
        Of the camera, for each pixel.
    sensor : str
        Image sensor that records, by its name or file; empty: one that has this noise alone.
    amount : float
        Of what makes a hard frame hard, as `AMOUNTS` says; 0 in all others.
    """

    kind: str
    width_px: float
    column_electrons: float
    read_noise_electrons: float
    sensor: str = field(default="", kw_only=True)
    amount: float = field(default=0.0, kw_only=True)

    @classmethod
    def of_peak(
        cls,
        kind: str,
        width_px: float,
        peak_electrons: float,
        read_noise_electrons: float,
        sensor: str = "",
    ) -> Condition:
        """The condition whose line makes so many electrons in a pixel at its peak."""
        electrons = peak_electrons * np.sqrt(2.0 * np.pi) * width_px
        return cls(kind, width_px, float(electrons), read_noise_electrons, sensor=sensor)

    @classmethod
    def of_sensor(cls, kind: str, width_px: float, sensor: str, peak_e: float | None) -> Condition:
        """A line that an image sensor records, by its name or file.

        Its peak makes `peak_e` electrons, by default 80 % of what the sensor can tell.
        """
        sheet = image_sensor(sensor)
        peak = EXPOSED * sheet.saturation_e if peak_e is None else peak_e
        return cls.of_peak(kind, width_px, peak, sheet.dark_noise_e, sensor)

    @property
    def peak_electrons(self) -> float:
        """Height of the profile, electrons/px: what a pixel at the peak collects."""
        return float(self.column_electrons / (np.sqrt(2.0 * np.pi) * self.width_px))

    @property
    def camera(self) -> ImageSensor:
        """The sensor; else one grey value an electron, and a well that no clean line fills."""
        if self.sensor:
            return image_sensor(self.sensor)
        well = _FULL_WELL_ELECTRONS
        if self.kind in AMOUNTS:
            well = HARD_WELL_E
        elif self.kind == "saturated":
            well = self.peak_electrons / CLIPPED
        return ImageSensor(
            quantum_efficiency=1.0,
            gain=1.0,
            dark_noise_e=self.read_noise_electrons,
            full_well_e=well,
            bit_depth=16,
            black_level=100.0,
            dsnu_e=0.0,
            prnu=0.0,
        )


KINDS = (
    *("clean", "saturated", "speckle", "ambient light", "cold frame", "hot frame"),
    *AMOUNTS,
)
"""Images that a trial is of, besides the task's."""

STATED = Condition.of_peak("task", 1.5, peak_electrons=5000.0, read_noise_electrons=2.0)
"""The task in which detectors are compared where one has to stand for all: `drawn_line(STATED)`."""


@dataclass(frozen=True)
class TrialImage(Displayed):
    """A noisy image and its truth.

    Attributes
    ----------
    grey : ndarray of uint16 of shape (H, W)
    truth : TrueLine
    bound_px : ndarray of shape (W,)
        Cramer-Rao bound of each column's centre, in hard frames with speckle what grains make of
        it; NaN where noise is not all.
    options : dict
        What `line_centres` is to know of the camera: noise, gain, saturation.
    """

    grey: NDArray[np.uint16]
    truth: TrueLine
    bound_px: Array
    options: dict[str, Any]

    def _line(self) -> str:
        height, width = self.grey.shape
        return f"{width} x {height} px, {span('', self.grey)}"


def drawn_line(
    condition: Condition = STATED, columns: int = 2000, seed: int | tuple[int, ...] = 0
) -> TrialImage:
    """A Gaussian line, integrated over each pixel, that wanders over all sub-pixel places.

    It does so slowly: detectors that use neighbouring columns too find it straight.

    Parameters
    ----------
    condition : Condition
        Of a kind that is drawn.
    columns : int
    seed : int or tuple of int
        The same seed makes the same image, to the bit.
    """
    rng = np.random.default_rng(seed)
    wave = np.sin(2.0 * np.pi * (np.arange(columns) / _WAVE_PX + rng.random()))
    truth = HEIGHT_PX / 2.0 + _SWING_PX * wave
    shares, slopes = line_shares(truth, condition.width_px, HEIGHT_PX)
    mean = condition.column_electrons * shares
    if condition.kind == "ambient light":
        mean = mean + AMBIENT_ELECTRONS
    slope = condition.column_electrons * slopes
    bound_px = cramer_rao_px(mean, slope, condition.read_noise_electrons)
    if condition.kind == "speckle":
        mean = speckled(mean, SPECKLE, rng)
    if condition.kind in ("speckle", "saturated"):
        bound_px = np.full(columns, np.nan)
    camera = condition.camera
    grey = recorded(mean / camera.quantum_efficiency, camera, rng)
    return TrialImage(grey, TrueLine.of_rows(truth), bound_px, known_of(condition))


def frame_line(
    condition: Condition, frame: Frame, truth: TrueLine, seed: tuple[int, ...]
) -> TrialImage:
    """A rendered frame as a camera records it."""
    camera = condition.camera
    light = exposed(frame.radiance, condition.peak_electrons, camera)
    lit = np.flatnonzero(frame.lit.any(axis=1))
    rows = slice(max(lit[0] - HEIGHT_PX // 2, 0), lit[-1] + HEIGHT_PX // 2)
    light = light[rows]
    grey = recorded(light, camera, np.random.default_rng(seed))
    mean = light * camera.quantum_efficiency
    bound_px = cramer_rao_px(mean, shifted(mean), condition.read_noise_electrons)
    return TrialImage(grey, truth.moved(-rows.start), bound_px, known_of(condition))


def recorded(photons: Array, sensor: ImageSensor, rng: np.random.Generator) -> NDArray[Any]:
    """Grey values, in proportion to the light where the sensor has a knee-point."""
    grey = grey_values(photons, sensor, rng)
    return grey.astype(np.uint16) if sensor.knee is None else sensor.without_knee(grey)


def shifted(mean: Array) -> Array:
    """Derivative of an image (H, W) by a shift along its columns, of the band its rows sample."""
    frequency = 2j * np.pi * np.fft.rfftfreq(len(mean))[:, None]
    return np.fft.irfft(np.fft.rfft(mean, axis=0) * frequency, len(mean), axis=0)


def known_of(condition: Condition) -> dict[str, Any]:
    """What a detector is to know of the camera."""
    camera = condition.camera
    ambient = AMBIENT_ELECTRONS if condition.kind == "ambient light" else 0.0
    known = camera.linear([], camera.detector_options_above(ambient)).detector_options
    return {name: known[name] for name in ("noise", "gain", "saturation")}
