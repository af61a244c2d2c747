"""The images of a trial, with the true rows of their lines and the smallest error possible."""

from __future__ import annotations

from dataclasses import dataclass
from typing import TYPE_CHECKING, Any

import numpy as np
from numpy.typing import NDArray
from scipy.special import ndtr

from virtual_sensor.imaging.camera_noise import CameraNoise, exposed, record
from virtual_sensor.imaging.speckle import Aperture, speckled
from virtual_sensor.metrology.truth import TrueLine

if TYPE_CHECKING:  # the processes that try detectors need no renderer
    from virtual_sensor.imaging.render import Frame

Array = NDArray[np.float64]

HEIGHT_PX = 64
SPECKLE = Aperture(5.6, pixel_um=5.5, polarisations=2)
CLIPPED = 2.0  # times the full well: the peak of a saturated line
BACKGROUND_E = 100.0  # ambient light, electrons a pixel
_SWING_PX, _WAVE_PX = 2.0, 600.0  # amplitude and length of a drawn line's waves


@dataclass(frozen=True)
class Condition:
    """What an image is like.

    Attributes
    ----------
    kind : str
        "clean": a drawn line in shot and read noise; "saturated", "speckle", "background": with
        that too; "cold frame", "hot frame": rendered.
    width_px : float
        Of the line, standard deviation; of a rendered frame the median, as measured.
    electrons : float
        That a column of the line makes; in a rendered frame, its brightest pixel.
    dark_noise_e : float
        Of the camera.
    """

    kind: str
    width_px: float
    electrons: float
    dark_noise_e: float

    @property
    def camera(self) -> CameraNoise:
        """One grey value an electron and a well that no clean line fills: nothing but noise."""
        well = 60_000.0
        if self.kind == "saturated":
            well = self.electrons / (np.sqrt(2.0 * np.pi) * self.width_px) / CLIPPED
        return CameraNoise(1.0, 1.0, self.dark_noise_e, well, 16, 100.0, 0.0, 0.0)


@dataclass(frozen=True)
class TrialImage:
    """A noisy image and its truth.

    Attributes
    ----------
    grey : ndarray of uint16 of shape (H, W)
    truth : TrueLine
    bound : ndarray of shape (W,)
        Cramer-Rao bound of each column's standard deviation, px; NaN where noise is not all.
    options : dict
        What `line_centres` is told of the camera.
    """

    grey: NDArray[np.uint16]
    truth: TrueLine
    bound: Array
    options: dict[str, Any]


def drawn_line(condition: Condition, columns: int, seed: tuple[int, ...]) -> TrialImage:
    """A Gaussian line, integrated over each pixel, that wanders over all sub-pixel places.

    It does so slowly: detectors that look along the line too find it straight.
    """
    rng = np.random.default_rng(seed)
    wave = np.sin(2.0 * np.pi * (np.arange(columns) / _WAVE_PX + rng.random()))
    truth = HEIGHT_PX / 2.0 + _SWING_PX * wave
    shares, slopes = line_shares(truth, condition.width_px)
    mean = condition.electrons * shares
    if condition.kind == "background":
        mean = mean + BACKGROUND_E
    bound = bound_px(mean, condition.electrons * slopes, condition)
    if condition.kind == "speckle":
        mean = speckled(mean, SPECKLE, rng)
    if condition.kind in ("speckle", "saturated"):
        bound = np.full(columns, np.nan)
    grey = record(mean, condition.camera, rng)
    line = TrueLine.of_rows(truth)
    return TrialImage(grey.astype(np.uint16), line, bound, _told(condition))


def line_shares(
    centre: Array, width_px: float | Array, height: int = HEIGHT_PX
) -> tuple[Array, Array]:
    """Shares (height, W) of a Gaussian line's light in each row's pixels, and d shares/d centre."""
    edges = (np.arange(height + 1)[:, None] - 0.5 - centre) / width_px
    density = np.exp(-0.5 * edges**2) / (np.sqrt(2.0 * np.pi) * width_px)
    return np.diff(ndtr(edges), axis=0), -np.diff(density, axis=0)


def frame_line(
    condition: Condition, frame: Frame, truth: TrueLine, seed: tuple[int, ...]
) -> TrialImage:
    """A rendered frame as a camera records it."""
    camera = condition.camera
    light = exposed(frame.radiance, condition.electrons, camera)
    lit = np.flatnonzero(frame.lit.any(axis=1))
    rows = slice(max(lit[0] - HEIGHT_PX // 2, 0), lit[-1] + HEIGHT_PX // 2)
    light = light[rows]
    grey = record(light, camera, np.random.default_rng(seed))
    bound = bound_px(light, shifted(light), condition)
    return TrialImage(grey.astype(np.uint16), truth.moved(-rows.start), bound, _told(condition))


def shifted(mean: Array) -> Array:
    """Derivative of an image (H, W) by a shift along its columns, of the band its rows sample."""
    frequency = 2j * np.pi * np.fft.rfftfreq(len(mean))[:, None]
    return np.fft.irfft(np.fft.rfft(mean, axis=0) * frequency, len(mean), axis=0)


def bound_px(mean: Array, slope: Array, condition: Condition) -> Array:
    """Cramer-Rao bound (W,) of the centre, px, of expected electrons and their derivative (H, W).

    var >= 1/sum((d mu/d row)^2/(mu + sigma_d^2 + 1/12)).
    """
    variance = mean + condition.dark_noise_e**2 + 1.0 / 12.0
    information = (slope**2 / variance).sum(axis=0)
    return np.where(information > 0.0, information, np.nan) ** -0.5


def _told(condition: Condition) -> dict[str, Any]:
    camera = condition.camera
    ambient = BACKGROUND_E if condition.kind == "background" else 0.0
    return {
        "noise": float(np.hypot(camera.grey_noise, camera.gain * np.sqrt(ambient))),
        "gain": camera.gain,
        "saturation": camera.saturation,
    }
