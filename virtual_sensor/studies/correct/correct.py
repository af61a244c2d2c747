"""Correct measurements through air that is known, or found from the same measurements."""

from __future__ import annotations

import time
from collections.abc import Callable, Sequence
from dataclasses import dataclass
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from virtual_sensor.imaging.scene import Scene
from virtual_sensor.metrology.cylinder_fit import FitStatus, fit_cylinder
from virtual_sensor.metrology.deviation import UM_PER_MM
from virtual_sensor.metrology.triangulation import triangulate, triangulated_points
from virtual_sensor.metrology.truth import rms
from virtual_sensor.optics.surfaces import Cylinder
from virtual_sensor.records import Record
from virtual_sensor.studies.correct.correction import (
    AirFacts,
    Corrected,
    Correction,
    RadiusFit,
)
from virtual_sensor.studies.correct.measured import Measured
from virtual_sensor.studies.correct.scene_part import ScenePart

Array = NDArray[np.float64]
Report = Callable[[str, float], None]

_STEP_PX = 0.5


@dataclass(frozen=True)
class Settings(Record):
    """What is known of the air, and what is to be found.

    Attributes
    ----------
    medium : Path or None
        File of a known field; None: the scene's own air.
    temperature_c : float or None
        Wall temperature of the air, between those of the scene's fields.
    """

    medium: Path | None = None
    temperature_c: float | None = None


def correct(
    measured: Sequence[Measured],
    settings: Settings = Settings(),
    report: Report = lambda stage, fraction: None,
) -> Correction:
    """Give the points that measurements hold, along bent lines of sight and laser rays.

    Parameters
    ----------
    measured : sequence of Measured
        See `read_measured`.
    settings : Settings
    report : callable
        Called with what is being done, and the fraction of the whole that is done.

    Raises
    ------
    InputError
        Where nothing can be corrected; it names the remedy.
    """
    began = time.perf_counter()
    notes = [note for each in measured for note in each.notes]
    scenes, air, said = _known_air(measured, settings)
    notes += said
    found = []
    for number, (each, scene) in enumerate(zip(measured, scenes, strict=True)):
        report(f"{each.name}: points through the air", number / len(measured))
        found.append(_corrected(each, scene))
    seconds = time.perf_counter() - began
    media = {id(scene.medium): scene.medium for scene in scenes}
    medium = next(iter(media.values())) if len(media) == 1 else None
    return Correction(
        tuple(found),
        air,
        medium,
        None,
        None,
        _circle(scenes, [each.point_mm for each in found]),
        _circle(scenes, [each.point_uncorrected_mm for each in found]),
        tuple(dict.fromkeys(notes)),
        (),
        seconds,
    )


def _known_air(
    measured: Sequence[Measured], settings: Settings
) -> tuple[list[Scene], AirFacts, list[str]]:
    """The measurements' scenes in the air that is known, what it is, and notes."""
    scenes, notes = [each.scene for each in measured], []
    origin = "scene"
    if settings.medium is not None:
        scenes, origin = [scene.with_medium(settings.medium) for scene in scenes], "medium"
    elif scenes[0].medium is None:
        origin = "none"
    first = scenes[0].medium
    source = str(settings.medium or scenes[0].air.path or (first.source if first else ""))
    if origin == "scene":
        notes.append(
            f"nothing is said of the air: the scene's own is taken ({scenes[0].air_name});"
            " --medium names another, --estimate finds it from the measurements"
        )
    return scenes, AirFacts(origin, source, {}, {}), notes


def _corrected(measured: Measured, scene: Scene) -> Corrected:
    """One measurement through its scene's air."""
    pixel = measured.pixel
    shifts = np.array([[0.0, 0.0], *(s * _STEP_PX * np.eye(2)[i] for i in (0, 1) for s in (1, -1))])
    found = triangulated_points(scene, pixel + shifts[:, None], medium=scene.medium)
    point, u_up, u_down, v_up, v_down = found.point_mm
    by_pixel = np.stack([u_up - u_down, v_up - v_down], axis=-1) / (2.0 * _STEP_PX)
    return Corrected(
        measured.name,
        scene,
        pixel,
        measured.sigma_px,
        measured.centre_status,
        found.status[0],
        triangulate(scene, pixel),
        point,
        pixel_covariance(measured, by_pixel),
        None,
        ScenePart.of(scene),
    )


def pixel_covariance(measured: Measured, by_pixel: Array) -> Array:
    """Covariance (N, 3, 3) of points by their pixels' noise; `by_pixel` (N, 3, 2) in mm/px."""
    angle = np.radians(measured.normal_deg)
    across = np.stack([np.cos(angle), np.sin(angle)], axis=1)
    one_way = np.einsum("nij,nj->ni", by_pixel, across)
    anyway = np.einsum("nik,njk->nij", by_pixel, by_pixel)
    shape = np.where(
        np.isnan(angle)[:, None, None], anyway, one_way[:, :, None] * one_way[:, None, :]
    )
    covariance: Array = measured.sigma_px[:, None, None] ** 2 * shape
    return covariance


def _circle(scenes: Sequence[Scene], points: Sequence[Array]) -> RadiusFit | None:
    """A circle through all points of a cylinder along x; None of other parts, and of few points."""
    part = scenes[0].surface
    if not isinstance(part, Cylinder) or any(scene.surface != part for scene in scenes):
        return None
    fit = fit_cylinder(np.concatenate(points), direction=(1.0, 0.0, 0.0))
    if fit.status != FitStatus.FITTED:
        return None
    _, y, z = fit.axis_point_mm
    error = UM_PER_MM * (fit.radius_mm - part.radius_mm)
    left = rms(fit.residual_um)
    return RadiusFit(fit.radius_mm, float(y), float(z), part.radius_mm, error, left, fit.count)
