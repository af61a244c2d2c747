"""The part of a new scene: a file's, or a cylinder."""

from __future__ import annotations

import re
from dataclasses import dataclass, replace
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from virtual_sensor.errors import InputError
from virtual_sensor.files import readable
from virtual_sensor.imaging.new_scene.options import SPELT, UPWARD, NewScene
from virtual_sensor.imaging.part_kinds import check_kind
from virtual_sensor.imaging.part_survey import UNITS_MM, PartSurvey, survey_part, unit_note
from virtual_sensor.imaging.parts import find_part, read_part
from virtual_sensor.poses import Pose

Array = NDArray[np.float64]

_DIAMETER_MM, _LENGTH_MM = 27.0, 170.0
_CORNERS = 720  # of a cylinder, as it is cut here
_FAR_MM = 1000.0  # from the origin: float32 leaves a doubt of 0.1 um there
_FAR = 10.0  # sizes of the part


@dataclass(frozen=True)
class Move:
    """An element of a part's ``to_world``, and why it is there.

    Attributes
    ----------
    tag : str
    attributes : dict
    words : str
    """

    tag: str
    attributes: dict[str, str]
    words: str


@dataclass(frozen=True)
class NewPart:
    """A part as a new scene has it.

    Attributes
    ----------
    corners_mm : ndarray of shape (M, 3, 3)
        Of its triangles, world.
    title, world : str
        What it is, and whose frame the world's is.
    file : Path or None
        None of a cylinder along x, whose top line goes through the world's origin.
    kind : str
        Of the file: "stl", for example.
    moves : tuple of Move
        From the file's frame to the world's.
    survey : PartSurvey or None
        Of the file.
    radius_mm, half_length_mm : float
        Of the cylinder.
    unit_note : str
        Of a file that seems to be in another unit than mm, if none was said.
    """

    corners_mm: Array
    title: str
    world: str
    file: Path | None = None
    kind: str = ""
    moves: tuple[Move, ...] = ()
    survey: PartSurvey | None = None
    radius_mm: float = 0.0
    half_length_mm: float = 0.0
    unit_note: str = ""

    @property
    def box_mm(self) -> tuple[Array, Array]:
        """Its lowest and highest corner, each (3,)."""
        return self.corners_mm.min(axis=(0, 1)), self.corners_mm.max(axis=(0, 1))

    @property
    def size_mm(self) -> float:
        """Diagonal of its box."""
        return float(np.linalg.norm(np.subtract(*self.box_mm)))


def part_of(said: NewScene) -> NewPart:
    """The part that a new scene is told.

    Raises
    ------
    InputError
        If its file can't be read.
    """
    return _from_file(find_part(said.part), said) if said.part else _cylinder(said)


def _cylinder(said: NewScene) -> NewPart:
    radius = (said.diameter_mm or _DIAMETER_MM) / 2.0
    half = (said.length_mm or _LENGTH_MM) / 2.0
    angle = np.linspace(0.0, 2.0 * np.pi, _CORNERS + 1)
    rim = radius * np.column_stack([np.zeros_like(angle), np.sin(angle), np.cos(angle) - 1.0])
    end = np.array([half, 0.0, 0.0])
    near, far = rim - end, rim + end
    quads = near[:-1], far[:-1], far[1:], near[1:]
    corners = np.concatenate(
        [np.stack([quads[i] for i in one], 1) for one in ((0, 1, 2), (0, 2, 3))]
    )
    return NewPart(
        corners,
        f"A cylinder of {2.0 * radius:g} x {2.0 * half:g} mm",
        "origin on the cylinder's top line, x along its axis, z up",
        radius_mm=radius,
        half_length_mm=half,
    )


def _from_file(file: Path, said: NewScene) -> NewPart:
    kind = check_kind(readable(file))
    if kind == "3mf" and said.unit:
        raise InputError(f"--unit {said.unit}: {file} has its unit in it; leave this out")
    part = read_part(file, kind)
    unit = SPELT.get(said.unit or "", said.unit or "mm")
    scale, moves = UNITS_MM[unit], []
    places = part.vertices * scale
    survey = survey_part(replace(part, vertices=places))
    world = "that of the part's file, z up"
    if scale != 1.0:
        moves.append(Move("scale", {"value": f"{scale:g}"}, f"from {unit} to mm"))
    if said.up != "z":
        axis, angle = UPWARD[said.up]
        places = places @ Pose.turn(angle, np.eye(3)["xyz".index(axis)]).rotation.T
        moves.append(Move("rotate", {axis: "1", "angle": f"{angle:g}"}, f"its {said.up} is up"))
        world = "that of the part's file, turned so that z is up"
    corners = places[part.faces]
    low, high = corners.min(axis=(0, 1)), corners.max(axis=(0, 1))
    middle = np.rint((low + high) / 2.0)
    if np.abs(middle).max() > max(_FAR_MM, _FAR * float(np.linalg.norm(high - low))):
        corners = corners - middle
        shift = {axis: f"{-value:.10g}" for axis, value in zip("xyz", middle, strict=True)}
        moves.append(Move("translate", shift, "to the origin: float32 is coarse far from it"))
        world += ", moved to the origin"
    title = re.sub(r"-(?=-)", "- ", file.name)  # two of them would end a comment
    doubt = "" if said.unit or kind == "3mf" else unit_note(survey.size_mm)
    return NewPart(corners, title, world, file, kind, tuple(moves), survey, unit_note=doubt)
