"""Hard frames: rendered, with what makes a line hard to find, and so with its truth.

All are of a flat plate in the cylinder's place, leaning a little, so that the line wanders over
the sub-pixel places of its pixels; but for ghosts, which the steel walls of a V-groove make.
"""

from __future__ import annotations

from collections.abc import Callable, Iterator
from dataclasses import dataclass, replace
from typing import Any

import numpy as np
from numpy.typing import NDArray
from scipy.ndimage import gaussian_filter

from virtual_sensor.display import Displayed
from virtual_sensor.imaging.plate import plate_scenes
from virtual_sensor.imaging.render import Frame, render, render_frame
from virtual_sensor.imaging.scene import load_scene
from virtual_sensor.imaging.speckle import Aperture, broad_line_noise_px, speckled
from virtual_sensor.metrology.line_peaks import line_centres
from virtual_sensor.metrology.truth import TrueLine
from virtual_sensor.poses import Pose
from virtual_sensor.studies.trial.images import (
    AMOUNTS,
    EXPOSED,
    HARD_NOISE_E,
    HARD_WELL_E,
    Condition,
    TrialImage,
    known_of,
    recorded,
)

Array = NDArray[np.float64]
Say = Callable[[str], None]

AMOUNTS_TRIED = {
    "clipped frame": (1.0, 2.0, 4.0, 8.0, 16.0),
    "edged frame": (2.0, 5.0, 10.0),
    "speckled frame": (5.6, 16.0),
    "ambient frame": (0.05, 0.5),
    "spattered frame": (10.0, 50.0),
    "ghostly frame": (0.5, 0.3, 0.2, 0.1),
}
QUICK_AMOUNTS = {
    "clipped frame": (8.0,),
    "edged frame": (10.0,),
    "speckled frame": (16.0,),
    "ambient frame": (0.5,),
    "spattered frame": (50.0,),
    "ghostly frame": (0.2,),
}

_SCENE = "hot_cylinder"
_FILM_PX, _QUICK_FILM_PX, _HEIGHT_PX = 1024, 512, 128
_FIELD_MM = 45.0  # of view, along the line
_LENGTH_MM = 40.0  # of the line
_SIGMA_PX = 2.0
_PLATE_MM, _TEXELS = (48.0, 14.0), (4096, 1024)
_LEAN_DEG = 1.5
_EDGES = 6  # that run slowly through the line, each from this many sigma below it to as many above
_EDGE_REACH = 4.0
_PATCHES, _MOTTLED = 6.0, 0.05  # 128ths of the plate, and the contrast: what ambient light shows
_BRIGHT_GRAINS = 3.0  # times the mean: how much darker a frame with speckle is exposed
_POLARISATIONS = 2
_GROOVE, _GROOVE_SIGMA_PX = "v_groove", 1.2
_GROOVE_PEAK = 0.25  # of the full well: the median column's; brighter ones may clip
_LIT = 0.01  # of that peak: what is darker is as if there were no light
_MARGIN_PX = 32  # rows above and below what is lit
_SHOWN_PX = 150, 60  # columns and rows of a sample


def hard_frames(
    quick: bool, seed: int, sensor: str, kinds: tuple[str, ...], say: Say
) -> Iterator[tuple[Condition, TrialImage]]:
    """Every kind of hard frame, in each of its amounts.

    Parameters
    ----------
    quick : bool
        Small frames, in one amount each.
    seed : int
        Of noise, speckle and spatter.
    sensor : str
        Image sensor that records them; empty: one of 10,000 electrons, with 3 electrons of noise.
    kinds : tuple of str
        Those that are wanted.
    say : callable
        Gets what is being rendered.
    """
    tried = QUICK_AMOUNTS if quick else AMOUNTS_TRIED
    bench = Bench(_QUICK_FILM_PX if quick else _FILM_PX)
    for number, kind in enumerate(AMOUNTS):
        if kind not in kinds or kind not in tried:
            continue
        say(f"rendering the {kind}")
        for amount in tried[kind]:
            condition = hard_condition(kind, amount, sensor)
            rng = np.random.default_rng((seed, number, round(1000 * amount)))
            yield condition, bench.image(condition, rng)


def hard_condition(kind: str, amount: float, sensor: str = "") -> Condition:
    """A line whose peak lies at 80 % of what the sensor can tell, or clips as often as asked."""
    width_px = _GROOVE_SIGMA_PX if kind == "ghostly frame" else _SIGMA_PX
    if sensor:
        made = Condition.of_sensor(kind, width_px, sensor, None)
    else:
        made = Condition.of_peak(kind, width_px, EXPOSED * HARD_WELL_E, HARD_NOISE_E)
    wells = {"clipped frame": amount, "ghostly frame": _GROOVE_PEAK}.get(kind, EXPOSED)
    electrons = made.column_electrons * wells / EXPOSED
    return replace(made, column_electrons=electrons, amount=amount)


@dataclass(frozen=True)
class Sample(Displayed):
    """A part of a hard frame, and what a detector finds there.

    Attributes
    ----------
    condition : Condition
    detector : str
    grey : ndarray of shape (H, W)
    true_row : ndarray of shape (W,)
        Of the line; NaN where there is none.
    column, row : ndarray of shape (N,)
        The centres that count as found.
    """

    condition: Condition
    detector: str
    grey: NDArray[np.uint16]
    true_row: Array
    column: Array
    row: Array

    @classmethod
    def of(cls, condition: Condition, image: TrialImage, detector: str) -> Sample:
        """The part of the frame about the line's first third."""
        line = line_centres(image.grey, detector, **image.options)
        truth = image.truth.centres().row
        known = np.flatnonzero(np.isfinite(truth))
        first = int(known[known.size // 3])
        columns = slice(first, min(first + _SHOWN_PX[0], truth.size))
        middle = int(np.nanmedian(truth[columns]))
        top = int(np.clip(middle - _SHOWN_PX[1] // 2, 0, max(len(image.grey) - _SHOWN_PX[1], 0)))
        rows = slice(top, top + _SHOWN_PX[1])
        u, v = line.pixel.reshape(-1, 2).T - np.array([[first], [top]])
        grey = image.grey[rows, columns]
        inside = (u >= 0) & (u < grey.shape[1]) & (v >= 0) & (v < grey.shape[0])
        return cls(condition, detector, grey, truth[columns] - top, u[inside], v[inside])

    def _line(self) -> str:
        return f"{self.condition.kind}, {self.column.size} centres by {self.detector}"


@dataclass(frozen=True)
class Bench(Displayed):
    """A plate under the laser and the camera of the cylinder, in frames so many px wide."""

    film_px: int

    def _line(self) -> str:
        return f"frames of {self.film_px} x {_HEIGHT_PX} px"

    def image(self, condition: Condition, rng: np.random.Generator) -> TrialImage:
        """A hard frame as its camera records it."""
        if condition.kind == "ghostly frame":
            return groove(condition, self.film_px, rng)
        light, truth = self.light(condition, rng)
        camera = condition.camera
        grey = recorded(light / camera.quantum_efficiency, camera, rng)
        bound_px = np.full(grey.shape[1], np.nan)
        if condition.kind == "speckled frame":  # not of a single column's likelihood, but of grains
            aperture = Aperture(condition.amount, polarisations=_POLARISATIONS)
            bound_px[:] = broad_line_noise_px(aperture, condition.width_px)
        return TrialImage(grey, truth, bound_px, known_of(condition))

    def light(self, condition: Condition, rng: np.random.Generator) -> tuple[Array, TrueLine]:
        """Electrons, on average, of each pixel, and the line's truth."""
        kind, amount, peak_e = condition.kind, condition.amount, condition.peak_electrons
        if kind == "edged frame":
            frame, _ = self._seen(self._edged(1.0 / amount))
            return peak_e * _unit(frame.radiance), TrueLine.of_frame(frame)
        if kind == "ambient frame":
            frame, lamp = self._seen(_mottled(rng), lamp=True)
            uneven = np.linspace(0.4, 1.6, lamp.shape[1])
            ambient = amount * uneven * lamp / lamp.mean()
            return peak_e * _unit(_unit(frame.radiance) + ambient), TrueLine.of_frame(frame)
        frame, _ = self._seen(np.full((4, 4), 0.8))
        light = peak_e * _unit(frame.radiance)
        if kind == "speckled frame":
            aperture = Aperture(amount, polarisations=_POLARISATIONS)
            light = speckled(light / _BRIGHT_GRAINS, aperture, rng)
        if kind == "spattered frame":
            count = round(amount * self.film_px / 1000.0)
            light = light + peak_e * sparks(light.shape, count, rng)
        return light, TrueLine.of_frame(frame)

    def _seen(self, reflectance: Array, lamp: bool = False) -> tuple[Frame, Array]:
        """A plate with a reflectance: its frame, and its image in even light, if that is wanted."""
        film = {"width": self.film_px, "height": _HEIGHT_PX, "line_length": _LENGTH_MM}
        pixel_mm = _FIELD_MM / self.film_px
        scene = load_scene(_SCENE, **film, line_radius=2.0 * _SIGMA_PX * pixel_mm).cold()
        with plate_scenes(scene, reflectance.astype(np.float32), _PLATE_MM) as plates:
            frame = render_frame(plates.at(_POSE))
            even = render(plates.at(_POSE, 1.0)) if lamp else np.empty((0, 0))
        return frame, even.astype(float)

    def _edged(self, dark: float) -> Array:
        """Reflectance whose edges run through the line, slowly, with either side dark."""
        along, across = _plate_points_mm()
        sigma_mm = _SIGMA_PX * _FIELD_MM / self.film_px / np.cos(np.radians(30.0))
        part, place = np.divmod(_EDGES * (along / _LENGTH_MM + 0.5), 1.0)
        beyond = across - _EDGE_REACH * (2.0 * place - 1.0) * sigma_mm
        beyond = np.where(part % 2, -beyond, beyond) / (_PLATE_MM[1] / _TEXELS[1])
        return 0.9 * (dark + (1.0 - dark) * np.clip(beyond + 0.5, 0.0, 1.0))


def groove(condition: Condition, film_px: int, rng: np.random.Generator) -> TrialImage:
    """A V-groove of steel, whose walls reflect the line once more."""
    scene = load_scene(
        _GROOVE,
        material="ground_steel",
        roughness=condition.amount,
        max_depth=3,
        width=film_px,
        height=film_px,
        line_radius=2.0 * condition.width_px * _FIELD_MM / film_px,
    )
    frame = render_frame(scene)
    direct = frame.radiance if frame.direct is None else frame.direct
    peak = direct.max(axis=0)
    usual = float(np.median(peak[peak > _LIT * peak.max()]))
    lit = np.flatnonzero((frame.radiance > _LIT * usual).any(axis=1))
    rows = slice(max(int(lit[0]) - _MARGIN_PX, 0), int(lit[-1]) + _MARGIN_PX)
    electrons = frame.radiance[rows].astype(float) * (condition.peak_electrons / usual)
    camera = condition.camera
    grey = recorded(electrons / camera.quantum_efficiency, camera, rng)
    unknown = np.full(grey.shape[1], np.nan)
    truth = TrueLine.of_frame(frame).moved(-rows.start)
    return TrialImage(grey, truth, unknown, known_of(condition))


def _mottled(rng: np.random.Generator) -> Array:
    """Reflectance of a surface in patches."""
    patches = gaussian_filter(rng.normal(size=(16, 128)), _PATCHES)
    return np.clip(0.6 * (1.0 + _MOTTLED * patches / patches.std()), 0.1, 1.0)


def sparks(shape: tuple[int, ...], count: int, rng: np.random.Generator) -> Array:
    """Streaks of hot spatter that fly through an image (H, W): 1 is the line's peak.

    Short and long, faint and brighter than the line, of any direction, and as sharp as a line.
    """
    image = np.zeros(shape)
    rows, columns = np.indices(shape, sparse=True)
    middle = rng.uniform(0.0, shape, (count, 2))
    turn, half = rng.uniform(0.0, np.pi, count), rng.exponential(12.0, count)
    sigma, height = rng.uniform(0.8, 2.0, count), rng.uniform(0.2, 3.0, count)
    for (v, u), angle, length, width, peak in zip(middle, turn, half, sigma, height, strict=True):
        aside, ahead = np.sin(angle), np.cos(angle)
        down, right = rows - v, columns - u
        beyond = np.maximum(np.abs(ahead * right + aside * down) - length, 0.0)
        distance = np.hypot(ahead * down - aside * right, beyond)
        image += peak * np.exp(-0.5 * (distance / width) ** 2)
    return image


def _plate_points_mm() -> tuple[Array, Array]:
    """Of the plate's texels: along the line (columns,), and from it on across (rows, columns)."""
    (width, height), (columns, rows) = _PLATE_MM, _TEXELS
    along = ((np.arange(columns) + 0.5) / columns - 0.5) * width
    across = ((0.5 - (np.arange(rows) + 0.5) / rows) * height)[:, None]
    # The laser comes at 30 degrees: where the plate leans towards it, the line moves aside.
    lean = np.sin(np.radians(_LEAN_DEG)) * np.tan(np.radians(30.0))
    return along, across + lean * along


def _leaning() -> Pose:
    flat = np.array([[0.0, 1.0, 0.0], [1.0, 0.0, 0.0], [0.0, 0.0, -1.0]])
    return Pose(Pose.turn(_LEAN_DEG, (1.0, 0.0, 0.0)).rotation @ flat, np.zeros(3))


_POSE = _leaning()


def _unit(image: NDArray[Any]) -> Array:
    """An image whose brightest pixel is 1."""
    return np.asarray(image, float) / float(image.max())
