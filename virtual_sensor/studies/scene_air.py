"""What is to be simulated so that a scene has the air of its own part."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, replace
from pathlib import Path
from typing import TYPE_CHECKING

import numpy as np

from virtual_sensor.display import Displayed
from virtual_sensor.errors import InputError
from virtual_sensor.imaging.checks import lit_line
from virtual_sensor.imaging.part_mesh import part_mesh
from virtual_sensor.imaging.scene import (
    Scene,
    find_scene,
    load_scene,
    scene_parameters,
    shipped_scenes,
)
from virtual_sensor.medium.heat_flow.setup import HeatFlow
from virtual_sensor.optics.surfaces import Cylinder

if TYPE_CHECKING:
    from trimesh import Trimesh

USUAL_SCENE = "hot_cylinder"

_OVER_SENSOR_MM = 10.0  # the air ends, above camera and laser
_LEAST_MM, _MOST_MM = 155.0, 600.0  # of air above the part


@dataclass(frozen=True)
class SceneAir(Displayed):
    """A scene and the flow that is to be simulated for it.

    Attributes
    ----------
    scene : Scene
        With one camera and one source, cold.
    flow : HeatFlow
        The part's; of a part that is no cylinder the STL file is yet to be written.
    part : trimesh.Trimesh or None
        Surface of a part that is no cylinder, in the world, mm.
    field : Path or None
        The file in which the scene looks for its air; None where it names none of its own.
    parameters : dict of str
        Values of the scene's parameters that are not its own defaults, `field` left out.
    notes : tuple of str
    """

    scene: Scene
    flow: HeatFlow
    part: Trimesh | None
    field: Path | None
    parameters: dict[str, str]
    notes: tuple[str, ...]

    @property
    def output(self) -> Path | None:
        """A place for the field: where the scene looks for it, or else beside its file."""
        if self.field or _is_shipped(self.scene.path):
            return self.field
        return self.scene.path.with_name(f"{self.scene.path.stem}_air.nc")


def scene_air(
    name: str | Path | None,
    parameters: Mapping[str, str],
    flow: HeatFlow,
    temperature_c: float | None = None,
    camera: str | None = None,
    source: str | None = None,
) -> SceneAir:
    """Take part, temperature and light from a scene.

    Parameters
    ----------
    name : str or Path, optional
        The scene; without one, the flow's own cylinder or STL file is simulated, and only the
        rays of hot_cylinder are followed in its air. An STL file is taken in place of the part.
    parameters : mapping
        Values of the scene's ``$parameters``.
    flow : HeatFlow
        What else is asked for.
    temperature_c : float, optional
        Of the part; by default the scene's parameter `temperature`.
    camera, source : str, optional
        Names of the scene's, where it has several.

    Raises
    ------
    InputError
        If the scene has no temperature, its laser misses the part, or its part has no surface that
        can be simulated.
    """
    given = dict(parameters)
    path = find_scene(name or USUAL_SCENE)
    known = scene_parameters(path, given)
    if temperature_c is not None and "temperature" in known:
        given["temperature"] = f"{temperature_c:g}"
        known = scene_parameters(path, given)
    field = None if name is None else _own_field(path, known.get("field", ""))
    given.pop("field", None)
    scene = load_scene(path, **given, **({"field": ""} if "field" in known else {})).cold()
    one = scene.only(camera, source)
    if temperature_c is None and name is not None:
        if "temperature" not in known:
            raise InputError(
                f"{path}: has no parameter temperature; give the part's by --temperature, degC"
            )
        temperature_c = float(known["temperature"])
    if temperature_c is not None:
        flow = replace(flow, temperature_c=temperature_c)
    if name is None:
        return SceneAir(one, flow, None, field, given, ())
    if flow.stl:
        return SceneAir(one, replace(flow, light_mm=_light_mm(one)), None, field, given, ())
    surface = scene.surface
    if isinstance(surface, Cylinder) and surface == Cylinder(
        surface.radius_mm, surface.half_length_mm, 0.0, -surface.radius_mm
    ):
        flow = replace(flow, radius_mm=surface.radius_mm, length_mm=2.0 * surface.half_length_mm)
        return SceneAir(one, flow, None, field, given, ())
    if flow.section:
        raise InputError(
            f"{path}: --section is of a cylinder along x whose top line goes through the origin,"
            " and the scene's part is another; leave it out, --quick is quick too"
        )
    flow = replace(flow, light_mm=_light_mm(one))
    part, notes = part_mesh(scene)
    return SceneAir(one, flow, part, field, given, tuple(f"{path}: {note}" for note in notes))


def _light_mm(scene: Scene) -> tuple[float, float, float]:
    """Where light comes down to a scene's part, and how high air is simulated over it, mm."""
    x, y = lit_line(scene).points_mm[:, :2].mean(axis=0)
    top = float(scene.mitsuba.bbox().max[2])
    highest = max(pose.origin_mm[2] for pose in scene.poses.values()) + _OVER_SENSOR_MM
    return float(x), float(y), top + float(np.clip(highest - top, _LEAST_MM, _MOST_MM))


def _own_field(scene: Path, name: str) -> Path | None:
    """The file that a scene's parameter `field` names, if it is not one that is shipped."""
    if not name or _is_shipped(scene):
        return None
    path = scene.parent / name
    path = path if path.suffix else path.with_suffix(".nc")
    shipped = (shipped_scenes() / "fields" / path.name).exists()
    return path if path.exists() or not shipped else None


def _is_shipped(scene: Path) -> bool:
    return scene.resolve().is_relative_to(shipped_scenes().resolve())
