"""What a field file holds, whether it suits a scene, and whether its grid is fine enough."""

from collections.abc import Callable, Mapping
from dataclasses import dataclass
from functools import partial
from pathlib import Path

import numpy as np
from numpy.typing import ArrayLike, NDArray

from virtual_sensor.arrays import by_rows, to_vectors
from virtual_sensor.errors import InputError
from virtual_sensor.imaging.checks import FACES, LitLine, border_crossings, lit_line
from virtual_sensor.imaging.scene import Scene, load_scene
from virtual_sensor.medium.index_field import IndexField
from virtual_sensor.medium.netcdf import AMBIENT_TEMPERATURE_K, UNITS, read_field_file
from virtual_sensor.medium.netcdf_elements import number, open_netcdf, read_times, text, units_of
from virtual_sensor.optics.ray_search import ray_search
from virtual_sensor.studies.field_grid import Loss, Structure, grid_losses, narrowest_structures
from virtual_sensor.studies.probes import probe_rays

Array = NDArray[np.float64]

USUAL_SCENE = "hot_cylinder"
"""The scene that a field is tried on if none is named."""


@dataclass(frozen=True)
class Contents:
    """What a field file says of itself.

    Attributes
    ----------
    kind : str
        "temperature", "density" or "refractivity".
    size_bytes : int
    attributes : dict
        The file's own text: title, source, comment, history...
    times_s : ndarray of shape (nt,) or None
        Its instants; None without a time axis.
    ambient_temperature_k : float
        Of the surrounding air; 293.15 K unless a temperature's file says otherwise.
    """

    kind: str
    size_bytes: int
    attributes: dict[str, str]
    times_s: Array | None
    ambient_temperature_k: float


@dataclass(frozen=True)
class Face:
    """A face of the field's box.

    Attributes
    ----------
    name : str
        One of `checks.FACES`.
    jump : float
        Largest abs(n - n_ambient) on it.
    crossed_jump : dict
        The same where the "camera"'s and the "laser"'s light crosses it; empty if none does.
    shift_px : dict
        What it does there to the image, px.
    """

    name: str
    jump: float
    crossed_jump: dict[str, float]
    shift_px: dict[str, float]

    @property
    def largest_px(self) -> float:
        """Of both kinds of light; 0 if none crosses the face."""
        return max(self.shift_px.values(), default=0.0)


@dataclass(frozen=True)
class FieldInfo:
    """All that is told of a field.

    Attributes
    ----------
    path : Path
    contents : Contents
    time_s : float or None
        The instant looked at; None without a time axis.
    wavelength_nm : float
        At which a temperature or density becomes n - 1.
    field : IndexField
    solid : ndarray of bool of shape (nx, ny, nz) or None
        The part, by the file or else by the scene.
    faces : list of Face
    structures : list of Structure
    losses : list of Loss
    scene : Scene or None
        In this field; None if the field suits none.
    line : LitLine or None
        Where the scene's laser lights its part.
    probe_y_mm : ndarray of shape (N,)
        Positions of the scene's probe rays along the line; empty without a scene.
    effect_px : ndarray of shape (N, 2) or None
        By how much the field moves their pixels; NaN for those not found.
    notes : tuple of str
        What of the file is ignored; what is not in here, and why.
    """

    path: Path
    contents: Contents
    time_s: float | None
    wavelength_nm: float
    field: IndexField
    solid: NDArray[np.bool_] | None
    faces: list[Face]
    structures: list[Structure]
    losses: list[Loss]
    scene: Scene | None
    line: LitLine | None
    probe_y_mm: Array
    effect_px: Array | None
    notes: tuple[str, ...]

    @property
    def refractivity_range(self) -> tuple[float, float]:
        """Lowest and highest n - 1 at the nodes in the air."""
        nodes = self.field.nodes if self.solid is None else self.field.nodes[~self.solid]
        return float(nodes.min()), float(nodes.max())

    @property
    def temperature_range_c(self) -> tuple[float, float] | None:
        """Lowest and highest temperature that they imply, degC; None if they can't be air's."""
        low, high = self.refractivity_range
        if low <= 0.0 or self.field.ambient <= 0.0:
            return None
        coldest, hottest = self.temperature_c(np.array([high, low]))
        return float(coldest), float(hottest)

    def temperature_c(self, refractivity: Array) -> Array:
        """Temperature in degC of an ideal gas at ambient pressure with these n - 1."""
        ratio = self.field.ambient / refractivity
        return np.asarray(ratio * self.contents.ambient_temperature_k - 273.15)


def field_info(
    path: Path,
    scene: str | None = None,
    parameters: Mapping[str, str] | None = None,
    time_s: float | None = None,
    report: Callable[[str, float], None] = lambda stage, fraction: None,
    y_mm: ArrayLike | None = None,
    camera: str | None = None,
    source: str | None = None,
) -> FieldInfo:
    """Look at a field, by itself and as a scene's light sees it.

    Parameters
    ----------
    path : Path
        A field file.
    scene : str, optional
        Name or file of the scene; by default hot_cylinder, which is left out if it does not suit.
    parameters : mapping, optional
        Values of the scene's ``$parameters``.
    time_s : float, optional
        The instant, in s of flow time; the last by default.
    report : callable
        Is told what is being done, and which fraction of the whole is.
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
    loaded = load_scene(scene or USUAL_SCENE, **dict(parameters or {})).only(camera, source)
    wavelength_nm = loaded.air.wavelength_nm
    field = IndexField.read(path, wavelength_nm=wavelength_nm, time_s=time_s)
    if loaded.air.pose:
        field = field.moved(loaded.air.pose)
    contents = _contents(path)
    if time_s is None and contents.times_s is not None:
        time_s = float(contents.times_s[-1])

    report("following the light", 0.1)
    in_it = loaded.with_medium(field)
    line, probes, effect, pixels, notes = None, np.zeros(0), None, None, [*field.notes]
    if field.pose:
        notes.append("the scene moves the field (to_world): boxes and cuts are of its own frame")
    try:
        line = lit_line(in_it)
    except InputError as error:
        if scene or parameters or camera or source:
            raise InputError(f"{path}: does not suit the scene: {error}") from None
        notes.append(f"left out: what it does to light; it does not suit a scene ({error})")
    if line:
        probes = probe_rays(in_it, y_mm)
        pixels = partial(searched_pixels, in_it, probes)
        effect = pixels(field) - pixels(None)
        if np.isnan(effect).all():
            effect, pixels = None, None
            notes.append("left out: the effect in px; none of the probe rays is in the picture")

    solid = read_field_file(path, wavelength_nm, time_s=time_s).solid
    refilled = solid is not None
    if line and not refilled:
        solid = inside_part(in_it, _node_places(field)).reshape(field.shape)
    if solid is None:
        notes.append("left out: what is at the wall; neither the file nor a scene tells the solid")

    def thinning(fraction: float) -> None:
        report("thinning out the grid", 0.2 + 0.6 * fraction)

    losses = grid_losses(field, solid, refilled, pixels, thinning)
    structures = narrowest_structures(field, solid)
    faces = _faces(field, in_it, line)
    return FieldInfo(
        path,
        contents,
        time_s,
        wavelength_nm,
        field,
        solid,
        faces,
        structures,
        losses,
        in_it if line else None,
        line,
        probes,
        effect,
        tuple(notes),
    )


def inside_part(scene: Scene, points_mm: Array) -> NDArray[np.bool_]:
    """Which world points (N, 3) lie inside the scene's part; shape (N,)."""
    up = np.broadcast_to([0.0, 0.0, 1.0], points_mm.shape)

    def inside(points_mm: Array, up: Array) -> NDArray[np.bool_]:
        return np.array(scene.surface.starts_inside(to_vectors(points_mm), to_vectors(up)))

    return by_rows(inside, points_mm, up)


def _node_places(field: IndexField) -> Array:
    """World positions of all nodes, (nx * ny * nz, 3)."""
    nodes = np.indices(field.shape).reshape(3, -1).T
    return field.to_world(field.origin + nodes * field.spacing)


def searched_pixels(scene: Scene, y_mm: Array, field: IndexField | None) -> Array:
    """Pixels (N, 2) that see laser rays at y_mm (N,) through a field."""
    return ray_search(scene.with_medium(field), y_mm, "newton").pixel


def _contents(path: Path) -> Contents:
    """Read what a file says of itself; it is known to be a field's."""
    nc = open_netcdf(path)
    kind = next(name for name in UNITS if name in nc.variables)
    ambient = AMBIENT_TEMPERATURE_K
    if kind == "temperature":
        offset, variable = units_of(nc, kind, UNITS[kind]), nc.variables[kind]
        owner = variable if "ambient_temperature" in variable._attributes else nc
        ambient = number(owner, "ambient_temperature", ambient - offset) + offset
    said = {name: text(nc, name) for name, v in nc._attributes.items() if isinstance(v, bytes)}
    return Contents(kind, path.stat().st_size, said, read_times(nc, kind), ambient)


def _faces(field: IndexField, scene: Scene, line: LitLine | None) -> list[Face]:
    """Find the jump at each face of the border, and its effect where light crosses it."""
    crossings = border_crossings(field, scene.sensor, line) if line else {}
    faces = []
    for index, (name, jump) in enumerate(zip(FACES, field.border_jump(), strict=True)):
        here = {who: crossing.face == index for who, crossing in crossings.items()}
        met = {who: mask for who, mask in here.items() if mask.any()}
        jumps = {who: float(crossings[who].jump[mask].max()) for who, mask in met.items()}
        shifts = {who: float(crossings[who].shift_px[mask].max()) for who, mask in met.items()}
        faces.append(Face(name, float(jump), jumps, shifts))
    return faces
