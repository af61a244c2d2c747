"""What is asked of a correction: which air, which shape, which parameters, with which priors."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from virtual_sensor.errors import InputError, nearest
from virtual_sensor.metrology.cylinder_fit import FitStatus, fit_cylinder
from virtual_sensor.metrology.observations import Prior
from virtual_sensor.metrology.shapes import (
    CylinderShape,
    PartShape,
    PlaneShape,
    Shape,
    SphereShape,
)
from virtual_sensor.optics.surfaces import Cylinder
from virtual_sensor.poses import Pose
from virtual_sensor.records import Record
from virtual_sensor.studies.correct.measured import Measured

Array = NDArray[np.float64]

SHAPES = ("cylinder", "plane", "sphere", "part", "none")


@dataclass(frozen=True)
class Settings(Record):
    """What is known of the air, and what is to be found.

    Attributes
    ----------
    medium : Path or None
        File of a field; None: the scene's own air.
    temperature_c : float or None
        Wall temperature of the air, between those of the scene's fields.
    estimate : tuple of str
        Parameters that are found from the measurements, of the air, or of poses; () where the air
        is known.
    shape : str or None
        That the part has: one of `SHAPES`; None: a cylinder where the scene's part is one along x,
        none where all measurements are dots, else the scene's part.
    free : tuple of str or None
        Parameters of the shape that are found too; None: those that one section determines.
    priors : dict of Prior
        By the parameters' names, of what is found; of poses that are not, and of known air, the
        standard deviations go into the error budget.
    tolerance_px : float
        Change of the residuals, rms, below which the estimate ends.
    """

    medium: Path | None = None
    temperature_c: float | None = None
    estimate: tuple[str, ...] = ()
    shape: str | None = None
    free: tuple[str, ...] | None = None
    priors: Mapping[str, Prior] = field(default_factory=dict)
    tolerance_px: float = 1e-5

    def __post_init__(self) -> None:
        if self.shape is not None and self.shape not in SHAPES:
            raise InputError(
                f"--shape {self.shape}: there are {', '.join(SHAPES)}{nearest(self.shape, SHAPES)}"
            )
        if self.medium is not None and self.temperature_c is not None:
            raise InputError("--medium and --temperature: choose one of them")
        if not self.estimate and (self.shape or self.free):
            raise InputError(
                "--shape and --free are of an estimate; say what is to be found, such as --estimate"
                " scale,width"
            )


def names_of(text: str | None) -> tuple[str, ...]:
    """Names that an option gives with commas in between."""
    return tuple(dict.fromkeys(filter(None, (text or "").replace(" ", "").split(","))))


def priors_of(texts: Sequence[str]) -> dict[str, Prior]:
    """Priors as an option gives them: ``scale=1:0.05``, several with commas in between.

    Raises
    ------
    InputError
        If one is written otherwise.
    """
    found = {}
    for text in (part for given in texts for part in given.replace(" ", "").split(",") if part):
        name, equals, behind = text.partition("=")
        try:
            value, sigma = (float(number) for number in behind.split(":"))
            found[name] = Prior(value, sigma)
        except ValueError as error:
            why = f" ({error})" if isinstance(error, InputError) else ""
            raise InputError(
                f"--prior {text}: write it as NAME=VALUE:SIGMA, such as scale=1:0.05{why}"
            ) from None
        if not (name and equals):
            raise InputError(f"--prior {text}: write it as NAME=VALUE:SIGMA, such as scale=1:0.05")
    return found


def shape_of(
    settings: Settings, measured: Sequence[Measured], points: Sequence[Array]
) -> tuple[Shape | None, tuple[str, ...]]:
    """The shape that measurements are of, near their points, and its free parameters.

    Raises
    ------
    InputError
        If there is none of that kind, or it has no such parameter.
    """
    kind, scene = settings.shape, measured[0].scene
    if kind is None:
        dots = all(each.along_mm is not None for each in measured)
        round_part = isinstance(scene.surface, Cylinder)
        kind = "none" if dots else "cylinder" if round_part else "part"
    if kind == "none":
        return None, ()
    known = np.concatenate([p[np.isfinite(p).all(axis=1)] for p in points])
    shape, free = {
        "part": _part,
        "cylinder": _cylinder,
        "plane": _plane,
        "sphere": _sphere,
    }[kind](scene, known)
    if settings.free is not None:
        free = tuple(_of_shape(name, shape) for name in settings.free if name != "none")
    return shape, free


def full_name(name: str, shape: Shape | None) -> str:
    """A parameter's name, of a shape's from one without its unit: ``radius`` is radius_mm."""
    return next((full for full in (shape.names if shape else ()) if name == _stem(full)), name)


def _stem(full: str) -> str:
    return full.rpartition("_")[0]


def _of_shape(name: str, shape: Shape) -> str:
    """The full name of a shape's parameter.

    Raises
    ------
    InputError
        If it has none of that name.
    """
    full = full_name(name, shape)
    if full not in shape.names:
        stems = [_stem(each) for each in shape.names]
        raise InputError(f"--free {name}: the shape has {', '.join(stems)}{nearest(name, stems)}")
    return full


def _part(scene: Any, points: Array) -> tuple[Shape, tuple[str, ...]]:
    return PartShape.of(scene), ()


def _cylinder(scene: Any, points: Array) -> tuple[Shape, tuple[str, ...]]:
    free = ("radius_mm", "y_mm", "z_mm")
    part = scene.surface
    if isinstance(part, Cylinder):
        return CylinderShape(part.radius_mm, part.axis_y_mm, part.axis_z_mm), free
    across = scene.source.pose.rotation[:, 0]
    axis = np.eye(3)[np.argmax(np.abs(across))]  # of the world's, the one across the line
    fit = fit_cylinder(points, direction=axis)
    if fit.status != FitStatus.FITTED:
        raise InputError(
            f"--shape cylinder: the points determine none. {FitStatus(fit.status).message}"
        )
    return CylinderShape(fit.radius_mm, 0.0, 0.0, pose=_frame(axis, fit.axis_point_mm)), free


def _frame(x: Array, origin: Array) -> Pose:
    """A frame whose x axis is one of the world's."""
    y = np.roll(x, 1)
    return Pose(np.stack([x, y, np.cross(x, y)], axis=1), origin)


def _plane(scene: Any, points: Array) -> tuple[Shape, tuple[str, ...]]:
    """One line of a plane says nothing of its turn about that line."""
    if len(points) < 2:
        raise InputError("--shape plane: there are fewer than two points")
    middle, up = points.mean(axis=0), scene.towards_sensors
    along = scene.source.pose.rotation[:, 1]
    along = along - (along @ up) * up
    along /= np.linalg.norm(along)
    pose = Pose(np.stack([np.cross(along, up), along, up], axis=1), middle)
    return PlaneShape(pose=pose), ("z_mm", "turn_x_deg")


def _sphere(scene: Any, points: Array) -> tuple[Shape, tuple[str, ...]]:
    """The sphere nearest to the points, by Kasa's linear fit."""
    if len(points) < 4:
        raise InputError("--shape sphere: there are fewer than four points")
    middle = points.mean(axis=0)
    local = points - middle
    columns = np.column_stack([local, np.ones(len(local))])
    solution = np.linalg.lstsq(columns, (local**2).sum(axis=1), rcond=1e-9)[0]
    centre = solution[:3] / 2.0
    radius = float(np.sqrt(max(solution[3] + centre @ centre, 1e-12)))
    # Of points of one section the centre lies in its plane, where the sphere would be smallest.
    return SphereShape(radius, *(centre + middle)), ("radius_mm", "x_mm", "y_mm", "z_mm")
