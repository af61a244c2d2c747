"""Deviation maps over poses and temperatures, by search, and figures by which a pose is chosen.

On a grid of the camera's pixels the search says which projector pixel each sees: noise-free
fringes, without an image. Its points by straight light are what a user measures, those through the
scene's own air what can be made of it.

The figures of a pose are those of Sensors 2025, 25, 1663 (mean distance, resolution, incidence
angle, coverage) and what the air does. Each counts by its ratio to that of the best pose
(1/distance, 1/resolution, the incidence's cosine, coverage, 1/deviation), and their weighted mean
is the pose's score; these ratios are ours.
"""

from __future__ import annotations

import itertools
import time
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, fields, replace
from functools import cached_property
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from virtual_sensor.arrays import LARGEST, number_within
from virtual_sensor.display import Displayed, listed
from virtual_sensor.errors import InputError, few, nearest
from virtual_sensor.imaging.scene import Scene, find_scene, load_scene, scene_parameters
from virtual_sensor.metrology.cylinder_fit import FitStatus, fit_cylinder
from virtual_sensor.metrology.deviation import UM_PER_MM, euclidean
from virtual_sensor.metrology.range_image import check_columns
from virtual_sensor.metrology.shapes import PartShape
from virtual_sensor.metrology.triangulation import triangulated_points
from virtual_sensor.metrology.truth import farthest, mean, rms
from virtual_sensor.optics.epipolar import epipolar_residual
from virtual_sensor.optics.projector_pixels import projector_pixels
from virtual_sensor.optics.surfaces import Cylinder
from virtual_sensor.records import Record, Table
from virtual_sensor.studies.fringes.sections import SectionPair, Sections, off_part_um, sections
from virtual_sensor.studies.provenance import MadeWith, made_with

Array = NDArray[np.float64]
Report = Callable[[str, float], None]

GRID = 64
"""Rows and columns of the pixels that are searched, of a square image."""

OVER = {"temperature": ("900", "1100", "1250"), "beta": ("0", "15", "30")}
"""What is compared where nothing is said, of the parameters that the scene has."""

MOST_POSES = 200

CRITERIA: dict[str, Callable[[PoseFigures], float]] = {
    "distance": lambda each: 1.0 / each.mean_distance_mm,
    "resolution": lambda each: 1.0 / each.resolution_um,
    "incidence": lambda each: float(np.cos(np.radians(each.incidence_deg))),
    "coverage": lambda each: each.coverage,
    "air": lambda each: 1.0 / max(each.straight.rms_um, _LEAST_UM),
}
"""What poses are chosen by: the more, the better."""

_LEAST_UM = 1e-3  # deviation below which no pose is better than another


@dataclass(frozen=True)
class DeviationFigures(Record):
    """How far points lie from the scene's part, along its normal.

    Attributes
    ----------
    mean_um, rms_um, largest_um : float
        Of their signed distances, positive outside; the largest in magnitude.
    radius_error_um : float or None
        Radius of the cylinder through them minus the part's; None of other parts.
    fit_std_um : float or None
        Standard deviation of their distances from that cylinder.
    """

    mean_um: float
    rms_um: float
    largest_um: float
    radius_error_um: float | None
    fit_std_um: float | None


@dataclass(frozen=True)
class PoseFigures(Record):
    """One pose, or one temperature.

    Attributes
    ----------
    name : str
        Of the parameters that differ.
    parameters : dict
        Their values.
    pixels, points : int
        Searched pixels, and those of them that see the part in the projector's light.
    coverage : float
        The latter's share.
    area_mm2 : float
        Of the surface that they see, about.
    mean_distance_mm : float
        From the camera to the points.
    resolution_um : float
        Edge of the surface that a camera pixel sees: the root of its mean area.
    incidence_deg, light_incidence_deg : float
        Mean angle of the lines of sight, and of the projector's light, to the surface's normals.
    straight, bent : DeviationFigures or None
        As if light ran straight, and through the scene's own air; the latter None where light runs
        straight.
    epipolar_px : float
        Residual across the epipolar line, camera px, rms: what no shape can cause.
    section : SectionPair or None
        Beside a laser line in the projector's place; None where that has no line.
    score : float
        Weighted mean of the criteria, 0 ... 1, among the poses that are compared.
    """

    name: str
    parameters: dict[str, str]
    pixels: int
    points: int
    coverage: float
    area_mm2: float
    mean_distance_mm: float
    resolution_um: float
    incidence_deg: float
    light_incidence_deg: float
    straight: DeviationFigures
    bent: DeviationFigures | None
    epipolar_px: float
    section: SectionPair | None
    score: float = float("nan")

    def figure(self, name: str) -> float:
        """A figure by its name; dots lead into records, and NaN is where there is none."""
        value: Any = self
        for part in name.split("."):
            value = getattr(value, part) if value is not None else None
        return np.nan if value is None else float(value)


@dataclass(frozen=True)
class PoseMaps(Displayed):
    """What a pose's grid of (R, C) pixels measures.

    Attributes
    ----------
    scene : Scene
    figures : PoseFigures
    pixel : ndarray of shape (R, C, 2)
        (u, v) of the camera.
    projector_pixel : ndarray of shape (R, C, 2)
        That they see; NaN where the part is not seen in the projector's light.
    point_mm : ndarray of shape (R, C, 3)
        Of the part, world.
    straight_um, bent_um : ndarray of shape (R, C)
        Signed distance of measured points from the part; `bent_um` through the scene's own air.
    epipolar_px : ndarray of shape (R, C)
    sections : Sections
        Along a laser line in the projector's place.
    """

    scene: Scene
    figures: PoseFigures
    pixel: Array
    projector_pixel: Array
    point_mm: Array
    straight_um: Array
    bent_um: Array
    epipolar_px: Array
    sections: Sections

    def _line(self) -> str:
        figures = self.figures
        straight = f"straight {figures.straight.rms_um:.3g} µm rms"
        return listed(figures.name, f"{figures.points} points", straight)


@dataclass(frozen=True)
class PoseTable(Table):
    """Poses and temperatures, a row for each.

    Attributes
    ----------
    name : sequence of str
        Of the parameters that differ.
    coverage, score : ndarray of shape (N,)
        See `PoseFigures`.
    area_mm2, mean_distance_mm, resolution_um : ndarray of shape (N,)
        See `PoseFigures`.
    incidence_deg, light_incidence_deg : ndarray of shape (N,)
        See `PoseFigures`.
    epipolar_px : ndarray of shape (N,)
        Residual across the epipolar line, rms.
    straight_rms_um, bent_rms_um : ndarray of shape (N,)
        Distance from the part, as if light ran straight and through the air.
    straight_radius_error_um, bent_radius_error_um : ndarray of shape (N,)
        Of the cylinder through the points; empty of other parts.
    straight_fit_std_um, bent_fit_std_um : ndarray of shape (N,)
        Standard deviation of the points' distances from that cylinder.
    section_straight_um, section_bent_um : ndarray of shape (N,)
        Fringes minus laser line, rms along the line.
    """

    name: Sequence[str]
    coverage: Array
    score: Array
    area_mm2: Array
    mean_distance_mm: Array
    resolution_um: Array
    incidence_deg: Array
    light_incidence_deg: Array
    epipolar_px: Array
    straight_rms_um: Array
    bent_rms_um: Array
    straight_radius_error_um: Array
    bent_radius_error_um: Array
    straight_fit_std_um: Array
    bent_fit_std_um: Array
    section_straight_um: Array
    section_bent_um: Array

    @staticmethod
    def of(poses: Sequence[PoseFigures]) -> PoseTable:
        """The table of some poses."""

        def column(name: str) -> Array:
            return np.array([each.figure(name) for each in poses])

        of_figures = {
            f"{light}_{name}": column(f"{light}.{name}")
            for name in ("rms_um", "radius_error_um", "fit_std_um")
            for light in ("straight", "bent")
        }
        plain = [each.name for each in fields(PoseFigures)]
        return PoseTable(
            name=[each.name for each in poses],
            section_straight_um=column("section.straight.difference_rms_um"),
            section_bent_um=column("section.bent.difference_rms_um"),
            **of_figures,
            **{f.name: column(f.name) for f in fields(PoseTable) if f.name in plain[3:]},
        )


@dataclass(frozen=True)
class PosesSummary(Record):
    """Poses that were compared.

    Attributes
    ----------
    scene : str
        Its file.
    weights : dict of float
        Of the criteria.
    best : str
        Name of the pose with the highest score.
    poses : tuple of PoseFigures
        In the order in which they were asked for.
    notes : tuple of str
        What the user should know of the scenes.
    made_with : MadeWith
        Engine and versions.
    time_s : float
        Of the comparison, without the writing of results.
    """

    scene: str
    weights: dict[str, float]
    best: str
    poses: tuple[PoseFigures, ...]
    notes: tuple[str, ...]
    made_with: MadeWith
    time_s: float


@dataclass(frozen=True)
class PosesCompared(Displayed):
    """Poses, with their maps.

    Attributes
    ----------
    poses : tuple of PoseMaps
    weights : dict of float
    notes : tuple of str
    time_s : float
    """

    poses: tuple[PoseMaps, ...]
    weights: dict[str, float]
    notes: tuple[str, ...]
    time_s: float

    def _line(self) -> str:
        return listed(f"{len(self.poses)} poses", f"best {self.best.name}")

    def _columns(self) -> dict[str, Any]:
        return self.table.columns()

    @cached_property
    def table(self) -> PoseTable:
        """The figures, a row for each pose."""
        return PoseTable.of([each.figures for each in self.poses])

    @property
    def best(self) -> PoseFigures:
        """The one with the highest score."""
        return max((each.figures for each in self.poses), key=lambda each: each.score)

    @cached_property
    def summary(self) -> PosesSummary:
        """The figures, for ``summary.json``."""
        scene = self.poses[0].scene
        return PosesSummary(
            f"{scene.path}",
            dict(self.weights),
            self.best.name,
            tuple(each.figures for each in self.poses),
            self.notes,
            made_with(scene),
            round(self.time_s, 3),
        )


def compare_poses(
    scene: str | Path,
    over: Mapping[str, Sequence[str]] | None = None,
    *,
    weights: Mapping[str, float] | None = None,
    grid: int = GRID,
    camera: str | None = None,
    source: str | None = None,
    report: Report = lambda stage, fraction: None,
) -> PosesCompared:
    """Deviation maps and figures of a scene with a projector, over any of its parameters.

    Parameters
    ----------
    scene : str or Path
    over : mapping from str to sequence of str, optional
        Values of parameters; all are combined. By default `OVER`.
    weights : mapping from str to float, optional
        Of `CRITERIA` in the score. By default 1 each, and of "air" 0.
    grid : int
        Columns of the pixels that are searched; as many rows as make their steps equal.
    camera, source : str, optional
        Names, where a scene has several.
    report : callable

    Raises
    ------
    InputError
        If there is no such parameter or criterion, a scene has no projector, or none of its pixels
        sees the part in the projector's light.
    """
    began = time.perf_counter()
    shares = weights_of(weights or {})
    path = find_scene(scene)
    choices = _choices(path, over)
    found: list[PoseMaps] = []
    notes: list[str] = []
    names = [name for name, values in choices.items() if len(values) > 1] or list(choices)
    cases = [dict(zip(choices, case, strict=True)) for case in itertools.product(*choices.values())]
    for number, case in enumerate(cases):
        name = " ".join(f"{key}={case[key]}" for key in names) or path.stem
        report(name, number / len(cases))
        loaded = load_scene(path, **case)
        loaded = loaded.only(camera, source or loaded.projector_name)
        notes += loaded.loading_notes
        found.append(pose_maps(loaded, name, {key: case[key] for key in names}, grid))
    scores = scored([each.figures for each in found], shares)
    found = [
        replace(each, figures=replace(each.figures, score=score))
        for each, score in zip(found, scores, strict=True)
    ]
    return PosesCompared(
        tuple(found), shares, tuple(dict.fromkeys(notes)), time.perf_counter() - began
    )


def weights_of(given: Mapping[str, float]) -> dict[str, float]:
    """The weights of all criteria.

    Raises
    ------
    InputError
        If one is unknown or negative, or all are 0.
    """
    for name, value in given.items():
        if name not in CRITERIA:
            raise InputError(
                f"--weights {name}: there are {', '.join(CRITERIA)}{nearest(name, CRITERIA)}"
            )
        number_within(f"--weights {name}", value, 0.0, LARGEST, "0 or more")
    usual = dict.fromkeys(CRITERIA, 0.0) if given else dict.fromkeys(CRITERIA, 1.0) | {"air": 0.0}
    found = usual | dict(given)
    if not any(found.values()):
        raise InputError("--weights: all are 0; give one that counts")
    return found


def scored(poses: Sequence[PoseFigures], weights: Mapping[str, float]) -> list[float]:
    """The weighted mean of each pose's criteria, each over the best pose's: 0 ... 1."""
    total = np.zeros(len(poses))
    for name, weight in weights.items():
        good = np.nan_to_num([CRITERIA[name](each) for each in poses])
        total += weight * good / good.max()
    return [float(each) for each in total / sum(weights.values())]


def pose_maps(scene: Scene, name: str, parameters: Mapping[str, str], grid: int = GRID) -> PoseMaps:
    """Maps of one scene with one camera and one projector, on a grid of pixels.

    Raises
    ------
    InputError
        If no pixel sees the part in the projector's light, or its columns don't tell the depth.
    """
    camera, family = scene.camera, scene.projector.family
    width, height = camera.size
    step = max(width / grid, 1.0)
    sides = [np.arange(step / 2.0 - 0.5, size - 0.5, step) for size in (width, height)]
    pixel = np.stack(np.meshgrid(*sides), axis=-1)
    shape = pixel.shape[:2]
    seen = projector_pixels(scene, pixel.reshape(-1, 2))
    known: Any = np.isfinite(seen.projector_pixel).all(axis=1)
    if not known.any():
        raise InputError(
            f"{scene.path} ({name}): no pixel sees the part in the projector's light; do camera and"
            " projector point at it?"
        )
    points, lit_px = seen.point_mm[known], seen.projector_pixel[known]
    at = pixel.reshape(-1, 2)[known]
    check_columns(f"{scene.path} ({name})", camera, family, at, lit_px)
    s, _ = family.of_pixels(lit_px)
    part = PartShape.of(scene)
    normal = part.distance(points).by_point
    epipolar = epipolar_residual(camera, family, at, lit_px)
    media = {"straight": None} | ({"bent": scene.medium} if scene.medium is not None else {})
    off = {
        key: triangulated_points(scene, at, medium=medium, coordinate=s).point_mm
        for key, medium in media.items()
    }
    deviation = {key: off_part_um(scene, each, points) for key, each in off.items()}
    sight = camera.pose.origin_mm - points
    light = family.origins(points) - points
    cosines, lit = (np.abs(np.sum(normal * to, axis=1)) / euclidean(to) for to in (sight, light))
    aside = np.abs(sight @ camera.pose.rotation[:, 2]) / euclidean(sight)  # a cosine
    area_px = camera.pixel_mm(points) ** 2 * aside / np.maximum(cosines, 1e-3)
    incidence, light_incidence = (
        float(np.degrees(np.arccos(each.clip(0.0, 1.0))).mean()) for each in (cosines, lit)
    )
    of = {key: _figures(deviation[key], off[key], scene.surface) for key in media}
    along_line = sections(scene)
    figures = PoseFigures(
        name=name,
        parameters=dict(parameters),
        pixels=int(known.size),
        points=int(known.sum()),
        coverage=float(known.mean()),
        area_mm2=float(area_px.sum() * step**2),
        mean_distance_mm=float(euclidean(sight).mean()),
        resolution_um=float(UM_PER_MM * np.sqrt(area_px.mean())),
        incidence_deg=incidence,
        light_incidence_deg=light_incidence,
        straight=of["straight"],
        bent=of.get("bent"),
        epipolar_px=rms(epipolar),
        section=along_line.figures,
    )

    def spread(values: Array) -> Array:
        whole = np.full((known.size, *values.shape[1:]), np.nan)
        whole[known] = values
        return whole.reshape(*shape, *values.shape[1:])

    none = np.full(len(points), np.nan)
    return PoseMaps(
        scene,
        figures,
        pixel,
        spread(lit_px),
        spread(points),
        spread(deviation["straight"]),
        spread(deviation.get("bent", none)),
        spread(epipolar),
        along_line,
    )


def _figures(distance_um: Array, points: Array, surface: Any) -> DeviationFigures:
    """The figures of points (N, 3) with distances (N,) from the part."""
    error_um = std_um = None
    if isinstance(surface, Cylinder):
        fit = fit_cylinder(points, direction=(1.0, 0.0, 0.0))
        if fit.status == FitStatus.FITTED:
            error_um = UM_PER_MM * (fit.radius_mm - surface.radius_mm)
            std_um = fit.residual_std_um
    figures = mean(distance_um), rms(distance_um), farthest(distance_um)
    return DeviationFigures(*figures, error_um, std_um)


def _choices(path: Path, over: Mapping[str, Sequence[str]] | None) -> dict[str, Sequence[str]]:
    """The values of parameters, checked; those of `OVER` that a scene has, where none are given."""
    known = scene_parameters(path, {})
    chosen = {name: values for name, values in (over or {}).items() if len(values)}
    for name in chosen:
        if name not in known:
            raise InputError(
                f"-D {name}: {path} has the parameters {few(list(known), 60)}{nearest(name, known)}"
            )
    if not any(len(values) > 1 for values in chosen.values()):
        usual = {name: values for name, values in OVER.items() if name in known}
        if "field" in chosen:  # which the temperature would choose
            usual.pop("temperature", None)
        chosen = usual | chosen
    count = int(np.prod([len(values) for values in chosen.values()]))
    if count > MOST_POSES:
        raise InputError(f"-D: {count} poses; give at most {MOST_POSES}")
    return chosen
