"""What a field file holds, what it does to light, and whether its grid is fine enough."""

import dataclasses
from collections.abc import Callable, Mapping
from dataclasses import dataclass
from enum import IntEnum
from functools import partial
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import ArrayLike, NDArray

from virtual_sensor.arrays import by_rows, to_vectors
from virtual_sensor.errors import InputError
from virtual_sensor.imaging.checks import (
    LitLine,
    border_crossings,
    lit_line,
)
from virtual_sensor.imaging.field_notes import field_notes
from virtual_sensor.imaging.scene import Scene, load_scene
from virtual_sensor.medium.description import MediumDescription
from virtual_sensor.medium.find_field import find_field
from virtual_sensor.medium.index_field import IndexField
from virtual_sensor.medium.netcdf import AMBIENT_TEMPERATURE_K, UNITS, ambient_of, read_field_file
from virtual_sensor.medium.netcdf_elements import open_netcdf, read_times, text
from virtual_sensor.medium.quantities import implied_temperature_c
from virtual_sensor.metrology.truth import FINE_PX
from virtual_sensor.optics.field_border import FACES, JUMP_REFUSED_PX, JUMP_TOLD_PX
from virtual_sensor.optics.ray_search import ray_search
from virtual_sensor.optics.trace import trace
from virtual_sensor.records import Record
from virtual_sensor.studies.field_grid import (
    COARSE_PX,
    Loss,
    Structure,
    grid_losses,
    narrowest_structures,
)
from virtual_sensor.studies.probes import probe_rays
from virtual_sensor.studies.provenance import MadeWith, made_with

Array = NDArray[np.float64]

USUAL_SCENE = "hot_cylinder"
"""The scene that a field is tried on if none is named."""

_ANGLE_STEP_MM = 2.0
_INTERNAL = {"internal": True}
_CROSSED = ("jump", "shift_px")


class Border(IntEnum):
    """Whether the jump of n at the field's border matters to light that enters there."""

    SOUND = 0
    TOLERABLE = 1
    TOO_CLOSE = 2
    UNKNOWN = 3


class Grid(IntEnum):
    """Whether the field's grid is fine enough."""

    FINE = 0
    FAIR = 1
    TOO_COARSE = 2
    TOO_FEW_NODES = 3
    UNKNOWN = 4


@dataclass(frozen=True)
class Face(Record):
    """A face of the field's box.

    Attributes
    ----------
    name : str
        "x-", "x+", ... "z+".
    largest_jump : float
        Largest abs(n - n_ambient) on it.
    laser_jump, camera_jump : float
        The same where the laser's light and the camera's lines of sight cross it; nothing where
        none does.
    laser_shift_px, camera_shift_px : float
        By how much refraction at that jump moves the image.
    """

    name: str
    largest_jump: float
    laser_jump: float
    camera_jump: float
    laser_shift_px: float
    camera_shift_px: float

    @property
    def shift_px(self) -> float:
        """The larger one; 0 if no light crosses the face."""
        return float(np.nanmax([0.0, self.laser_shift_px, self.camera_shift_px]))


@dataclass(frozen=True)
class Light(Record):
    """What the field does to the light of a scene.

    Attributes
    ----------
    scene : Path
        Its file.
    parameters : dict of str
        Values of the scene's parameters.
    laser_angle_mrad, camera_angle_mrad : float
        Largest angle by which the field turns the laser's light and the camera's lines of sight on
        their paths to the lit line.
    largest_shift_px : float
        Largest shift of what the camera sees of a probe ray, hot minus cold.
    largest_shift_y_mm : float
        Position of that probe ray along the line.
    probe_y_mm : ndarray
        Positions of the probe rays along the line.
    shift_px : ndarray of shape (N, 2)
        Shifts of their pixels (u, v), hot minus cold; nothing where a ray isn't found.
    """

    scene: Path
    parameters: dict[str, str]
    laser_angle_mrad: float
    camera_angle_mrad: float
    largest_shift_px: float
    largest_shift_y_mm: float
    probe_y_mm: Array
    shift_px: Array


@dataclass(frozen=True)
class FieldInfo(Record):
    """What a field file holds, and what it does to light.

    Attributes
    ----------
    file : Path
        Its path.
    size_mb : float
        Size of the file.
    quantity : str
        "temperature", "density" or "refractivity".
    attributes : dict of str
        The file's own texts: title, source, comment, history...
    times_s : ndarray or None
        Its instants; None without a time axis.
    time_s : float or None
        The instant that the figures are of.
    nodes : tuple of int
        Along x, y, z.
    spacing_mm : ndarray
        Distance of nodes along x, y, z.
    mirrored : tuple of bool
        Whether the field is even about the plane through the first node of x, y, z.
    box_mm : ndarray of shape (2, 3)
        Lowest and highest corner, mirror images included.
    wavelength_nm : float
        At which a temperature or density becomes n - 1.
    lowest_refractivity, highest_refractivity, ambient_refractivity : float
        n - 1 at the nodes in the air, and of the surrounding air.
    lowest_temperature_c, highest_temperature_c : float
        That they imply, of an ideal gas at ambient pressure; nothing if they can't be air's.
    ambient_temperature_c : float
        20 degC unless a temperature's file says otherwise.
    light : Light or None
        None if the field suits no scene, or no probe ray is in the picture.
    border : Border
        How the field ends at its box.
    faces : tuple of Face
        Its six faces.
    grid : Grid
        Whether its nodes are close enough.
    losses : tuple of Loss
        What fewer nodes lose, along x, y, z and all together.
    structures : tuple of Structure
        The narrowest ones.
    made_with : MadeWith
        Engine and versions.
    notes : tuple of str
        What of the file is ignored; what is left out here, and why.
    """

    file: Path
    size_mb: float
    quantity: str
    attributes: dict[str, str]
    times_s: Array | None
    time_s: float | None
    nodes: tuple[int, ...]
    spacing_mm: Array
    mirrored: tuple[bool, ...]
    box_mm: Array
    wavelength_nm: float
    lowest_refractivity: float
    highest_refractivity: float
    ambient_refractivity: float
    lowest_temperature_c: float
    highest_temperature_c: float
    ambient_temperature_c: float
    light: Light | None
    border: Border
    faces: tuple[Face, ...]
    grid: Grid
    losses: tuple[Loss, ...]
    structures: tuple[Structure, ...]
    made_with: MadeWith
    notes: tuple[str, ...]
    # For pictures: the field, its solid nodes (nx, ny, nz), the scene in it and where it is lit.
    field: IndexField = dataclasses.field(metadata=_INTERNAL, repr=False)
    solid: NDArray[np.bool_] | None = dataclasses.field(metadata=_INTERNAL, repr=False)
    scene: Scene | None = dataclasses.field(metadata=_INTERNAL, repr=False)
    line: LitLine | None = dataclasses.field(metadata=_INTERNAL, repr=False)

    @property
    def rough_axes(self) -> list[str]:
        """Axes along which structures are as narrow as the grid, as far as that is seen."""
        return [
            loss.axes
            for loss in self.losses[:-1]
            if loss.shift_px and not loss.shift_px.converges and loss.shift_px.every_2nd > FINE_PX
        ]

    def temperature_c(self, refractivity: Array) -> Array:
        """Temperature in degC of an ideal gas at ambient pressure with these n - 1."""
        return implied_temperature_c(
            refractivity, self.ambient_refractivity, self.ambient_temperature_c
        )


def field_info(
    path: str | Path | None,
    scene: str | None = None,
    parameters: Mapping[str, str] | None = None,
    time_s: float | None = None,
    report: Callable[[str, float], None] = lambda stage, fraction: None,
    y_mm: ArrayLike | None = None,
    camera: str | None = None,
    source: str | None = None,
) -> FieldInfo:
    """Examine a field, by itself and with the light of a scene.

    Parameters
    ----------
    path : str, Path or None
        A field file, or the name of one that comes with the program; None: that of the scene.
    scene : str, optional
        Name or file of the scene; by default hot_cylinder, which is left out if it does not suit.
    parameters : mapping, optional
        Values of the scene's ``$parameters``.
    time_s : float, optional
        The instant, in s of flow time; the last by default.
    report : callable
        Called with what is being done and the fraction done.
    y_mm : array_like of shape (N,), optional
        Positions of the probe rays along the line, mm; by default the scene's own (`probe_rays`).
    camera, source : str, optional
        Names of the scene's, where it has several.

    Raises
    ------
    InputError
        If the file is no field, or the scene that is asked for can't be loaded or does not suit.
    """
    report("reading the field", 0.0)
    path = None if path is None else find_field(path)
    loaded = load_scene(scene or USUAL_SCENE, **dict(parameters or {})).only(camera, source)
    if path is None:
        if loaded.air.path is None:
            raise InputError(f"{loaded.path}: the scene has no field; name one (FIELD)")
        path, time_s = loaded.air.path, loaded.air.time_s if time_s is None else time_s
    wavelength_nm = loaded.air.wavelength_nm
    air = IndexField.read(path, wavelength_nm=wavelength_nm, time_s=time_s)
    if loaded.air.pose:
        air = air.moved(loaded.air.pose)
    contents = _contents(path)
    times_s = contents["times_s"]
    if time_s is None and times_s is not None:
        time_s = float(times_s[-1])

    report("tracing light", 0.1)
    in_it = loaded.with_medium(air)
    line, pixels, light, notes = None, None, None, [*air.notes]
    if scene or parameters:
        name, temperature = f"the field {path.name}", loaded.parameters.get("temperature", "")
        described = MediumDescription(path, time_s)
        notes += field_notes(described, name, in_it.field_fit, temperature, loaded.simulate_command)
    if air.pose:
        notes.append("the scene moves the field (to_world): boxes and cuts are of its own frame")
    try:
        line = lit_line(in_it)
    except InputError as error:
        if scene or parameters or camera or source:
            raise InputError(f"{path}: does not suit the scene: {error}") from None
        notes.append(f"left out: what it does to light; it does not suit a scene ({error})")
    if line:
        probe_y_mm = probe_rays(in_it, y_mm)
        pixels = partial(searched_pixels, in_it, probe_y_mm)
        shift = pixels(air) - pixels(None)
        if np.isnan(shift).all():
            pixels = None
            notes.append("left out: the shift in px; none of the probe rays is in the picture")
        else:
            light = _light(in_it, air, line, probe_y_mm, shift)

    solid = read_field_file(path, wavelength_nm, time_s=time_s).solid
    refilled = solid is not None
    if line and not refilled:
        solid = inside_part(in_it, _node_places(air)).reshape(air.shape)
    if solid is None:
        notes.append("left out: what is at the wall; neither the file nor a scene has the solid")
    losses = grid_losses(
        *(air, solid, refilled, pixels),
        lambda fraction: report("comparing coarser grids", 0.2 + 0.6 * fraction),
    )
    faces = _faces(air, in_it, line)
    nodes = air.nodes if solid is None else air.nodes[~solid]
    low, high = float(nodes.min()), float(nodes.max())
    coldest = hottest = np.nan
    if low > 0.0 and air.ambient > 0.0:
        ambient_c = contents["ambient_temperature_c"]
        coldest, hottest = implied_temperature_c(np.array([high, low]), air.ambient, ambient_c)
    return FieldInfo(
        file=path,
        size_mb=path.stat().st_size / 1e6,
        **contents,
        time_s=time_s,
        nodes=air.shape,
        spacing_mm=air.spacing,
        mirrored=air.mirror,
        box_mm=air.box,
        wavelength_nm=wavelength_nm,
        lowest_refractivity=low,
        highest_refractivity=high,
        ambient_refractivity=air.ambient,
        lowest_temperature_c=float(coldest),
        highest_temperature_c=float(hottest),
        light=light,
        border=_border(faces) if line else Border.UNKNOWN,
        faces=faces,
        grid=_grid(losses[-1]),
        losses=losses,
        structures=narrowest_structures(air, solid),
        made_with=made_with(in_it),
        notes=tuple(notes),
        field=air,
        solid=solid,
        scene=in_it if line else None,
        line=line,
    )


def inside_part(scene: Scene, points_mm: Array) -> NDArray[np.bool_]:
    """Which world points (N, 3) lie inside the scene's part; shape (N,)."""
    up = np.broadcast_to([0.0, 0.0, 1.0], points_mm.shape)

    def inside(points_mm: Array, up: Array) -> NDArray[np.bool_]:
        return np.array(scene.surface.starts_inside(to_vectors(points_mm), to_vectors(up)))

    return by_rows(inside, points_mm, up)


def _node_places(air: IndexField) -> Array:
    """World positions of all nodes, (nx * ny * nz, 3)."""
    nodes = np.indices(air.shape).reshape(3, -1).T
    return air.to_world(air.origin + nodes * air.spacing)


def searched_pixels(scene: Scene, y_mm: Array, air: IndexField | None) -> Array:
    """Pixels (N, 2) that see laser rays at y_mm (N,) through a field."""
    return ray_search(scene.with_medium(air), y_mm, "newton").pixel


def _contents(path: Path) -> dict[str, Any]:
    """Fields of `FieldInfo` that stand in a file; it is known to be a field's."""
    nc = open_netcdf(path)
    quantity = next(name for name in UNITS if name in nc.variables)
    ambient = AMBIENT_TEMPERATURE_K
    if quantity == "temperature":
        ambient = ambient_of(nc, quantity, "ambient_temperature", ambient)
    texts = {name: text(nc, name) for name, v in nc.attributes.items() if isinstance(v, str)}
    return {
        "quantity": quantity,
        "attributes": texts,
        "times_s": read_times(nc, quantity),
        "ambient_temperature_c": ambient - 273.15,
    }


def _light(
    scene: Scene, air: IndexField, line: LitLine, probe_y_mm: Array, shift_px: Array
) -> Light:
    """What a field does to the light of a scene; some of the shifts (N, 2) are known."""
    size = np.linalg.norm(shift_px, axis=1)
    furthest = int(np.nanargmax(size))
    angles: dict[str, float] = {}
    for of, family in (("laser", scene.sensor.laser.family), ("camera", scene.sensor.camera)):
        starts = family.origins(line.points_mm)
        paths = line.points_mm - starts
        length = np.linalg.norm(paths, axis=1)
        bent = trace(air, starts, paths, length, _ANGLE_STEP_MM, "leapfrog")
        turned = np.linalg.norm(bent.direction - paths / length[:, None], axis=1)
        angles[f"{of}_angle_mrad"] = float(2e3 * np.arcsin(0.5 * turned.max()))
    return Light(
        scene=scene.path,
        parameters=dict(scene.parameters),
        **angles,
        largest_shift_px=float(size[furthest]),
        largest_shift_y_mm=float(probe_y_mm[furthest]),
        probe_y_mm=probe_y_mm,
        shift_px=shift_px,
    )


def _faces(air: IndexField, scene: Scene, line: LitLine | None) -> tuple[Face, ...]:
    """The jump at each face of the border, and its effect where light crosses it."""
    crossings = border_crossings(air, scene.camera, scene.source, line) if line else {}
    faces = []
    for index, (name, jump) in enumerate(zip(FACES, air.border_jump(), strict=True)):
        figures = {f"{of}_{what}": np.nan for of in ("laser", "camera") for what in _CROSSED}
        for of, crossing in crossings.items():
            here = crossing.face == index
            if here.any():
                figures |= {f"{of}_{w}": float(getattr(crossing, w)[here].max()) for w in _CROSSED}
        faces.append(Face(name, float(jump), **figures))
    return tuple(faces)


def _border(faces: tuple[Face, ...]) -> Border:
    """By the limits at which a measurement has a note, and is refused."""
    shift_px = max(face.shift_px for face in faces)
    if shift_px <= JUMP_TOLD_PX:
        return Border.SOUND
    return Border.TOLERABLE if shift_px <= JUMP_REFUSED_PX else Border.TOO_CLOSE


def _grid(together: Loss) -> Grid:
    """By what the grid loses along all axes together."""
    if together.shift_px is None:
        return Grid.UNKNOWN
    if np.isnan(together.shift_px.every_2nd):
        return Grid.TOO_FEW_NODES
    if together.shift_px.present <= FINE_PX:
        return Grid.FINE
    return Grid.FAIR if together.shift_px.present <= COARSE_PX else Grid.TOO_COARSE
