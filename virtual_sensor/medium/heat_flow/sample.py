"""A simulated instant on a regular grid: smoothly, since light feels the gradient.

The mesh of a cylinder is a stack of equal layers along x. Across it, within each layer, a Clough-
Tocher interpolant (piecewise cubic with a continuous gradient) goes through the cells' centres and
the wall; along x Akima splines join the layers. Linear interpolation gives a step of the gradient
at every cell, which moves the image by pixels where the mesh is coarse.

The mesh round another part is sampled with the gradients at its points; see `mesh_values`.
"""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path

import numpy as np
from numpy.typing import NDArray
from scipy.interpolate import Akima1DInterpolator, CloughTocher2DInterpolator
from scipy.spatial import cKDTree
from threadpoolctl import threadpool_limits

from virtual_sensor.errors import InputError
from virtual_sensor.medium.heat_flow.setup import RAMP_S, HeatFlow
from virtual_sensor.medium.heat_flow.snapped_mesh import SURFACE, Part, read_part
from virtual_sensor.medium.imports import mesh_values
from virtual_sensor.medium.imports.import_field import SECTION_LENGTH_MM
from virtual_sensor.medium.imports.meshes import moved, read_openfoam
from virtual_sensor.medium.imports.sources import Mesh
from virtual_sensor.medium.netcdf import GriddedQuantity

Array = NDArray[np.float64]

SPACING_MM = (3.0, 0.5, 1.25)
TOP_MM = 300.0
PART_NODES = 9e5  # of a part's field by default, for a file of 2 MB
BELOW_TOP_MM = 5.0  # a part's field ends, below the end of the simulated air
PART_MARGIN_MM, PART_UNDER_MM = 25.0, 9.0  # of air beside and below it
SECTION_NODES = 4  # along x, the fewest that a field may have
WALL_POINTS = 240  # on half the circle: finer than the mesh
_LAYER_MM = 1e-3  # centres nearer than this in x are in one layer
_WALL_MM = 1e-6
_GRADIENT_TOLERANCE = 1e-4  # relative, of its iteration: 4e-4 K


@dataclass(frozen=True)
class SampleGrid:
    """Nodes of the field that a simulation is sampled on; shapes (nx,), (ny,), (nz,), mm."""

    x: Array
    y: Array
    z: Array

    @classmethod
    def of(cls, flow: HeatFlow, spacing_mm: tuple[float, float, float] | None = None) -> SampleGrid:
        """The air over a part, up to where the sensor is; a mirror plane is its first node.

        Raises
        ------
        InputError
            If an STL file is not fit; see `read_part`.
        """
        if flow.stl:
            return cls._of_part(flow, read_part(flow.stl), spacing_mm)
        R = flow.radius_mm
        length = SECTION_LENGTH_MM if flow.section else flow.length_mm / 2.0 + 35.0
        width, low = max(36.0, 2.7 * R), -2.0 * R - 9.0
        dx, dy, dz = spacing_mm or SPACING_MM
        x = np.arange(0.0, length + 1e-9, dx)
        if flow.section:
            x = np.linspace(0.0, length, SECTION_NODES)
        y = np.arange(0.0, width + 1e-9, dy)
        if flow.whole:
            y = np.concatenate([-y[:0:-1], y])
        return cls(x, y, np.arange(low, TOP_MM + 1e-9, dz))

    @classmethod
    def _of_part(
        cls, flow: HeatFlow, part: Part, spacing_mm: tuple[float, float, float] | None
    ) -> SampleGrid:
        """By default coarser along a long part, in whose middle the air is the same everywhere."""
        margin = np.array([PART_MARGIN_MM, PART_MARGIN_MM, 0.0])
        low, high = part.low_mm - margin, part.high_mm + margin
        low[2], high[2] = part.low_mm[2] - PART_UNDER_MM, flow.light_mm[2] - BELOW_TOP_MM
        if spacing_mm is None:
            size = part.high_mm[:2] - part.low_mm[:2]
            shape = np.array([*np.clip(size / size.min(), 1.0, 4.0), 2.0])
            spacing = shape * (np.prod((high - low) / shape) / PART_NODES) ** (1.0 / 3.0)
        else:
            spacing = np.array(spacing_mm)
        x, y, z = (np.arange(a, b + 1e-9, d) for a, b, d in zip(low, high, spacing, strict=True))
        return cls(x, y, z)

    @property
    def spacing(self) -> Array:
        """Distance of nodes along x, y, z, mm."""
        return np.array([axis[1] - axis[0] for axis in (self.x, self.y, self.z)])


def sample(
    flow: HeatFlow,
    case: Path,
    times_s: tuple[float, ...],
    grid: SampleGrid,
    attributes: dict[str, str] | None = None,
) -> GriddedQuantity:
    """Temperature of the air at some instants of a simulation.

    Parameters
    ----------
    flow : HeatFlow
        What was simulated.
    case : Path
        The OpenFOAM case.
    times_s : tuple of float
        Saved flow times, s; with more than one the result has a time axis.
    grid : SampleGrid
        The nodes.
    attributes : dict, optional
        Where the field comes from.

    Raises
    ------
    InputError
        If PyVista is missing, the case has no such time, or the grid reaches beyond its air.
    """
    frames, solid = (_round_part if flow.stl else _round_cylinder)(flow, case, times_s, grid)
    single = len(times_s) == 1
    return GriddedQuantity(
        "temperature",
        frames[0] if single else frames,
        np.array([grid.x[0], grid.y[0], grid.z[0]]),
        grid.spacing,
        None if single else np.array(times_s),
        {"ambient_temperature": flow.ambient_k, "ambient_pressure": flow.pressure_pa},
        (not flow.stl, not (flow.stl or flow.whole), False),
        solid,
        attributes or {},
    )


def _round_part(
    flow: HeatFlow, case: Path, times_s: tuple[float, ...], grid: SampleGrid
) -> tuple[Array, NDArray[np.bool_]]:
    """Temperatures (nt, nx, ny, nz), K, round a part from an STL file; nodes inside it."""
    part = read_part(case / SURFACE)
    axes = (grid.x, grid.y, grid.z)
    frames = []
    for time_s in times_s:
        mesh, temperature = _mesh(case, time_s)
        low, high = np.reshape(mesh.cells.bounds, (3, 2)).T
        if any(a[0] < b or a[-1] > c for a, b, c in zip(axes, low, high, strict=True)):
            raise InputError(f"{case}: the grid reaches beyond the simulated air; make it smaller")
        frames.append(mesh_values.sample(mesh, temperature, axes))
    nodes = np.stack(np.meshgrid(*axes, indexing="ij"), axis=-1)
    # Where the part is concave the mesh leaves a gap to it, which has no values either.
    solid: NDArray[np.bool_] = np.isnan(np.stack(frames)).any(axis=0)
    near = np.all((nodes >= part.low_mm) & (nodes <= part.high_mm), axis=-1) & ~solid
    solid[near] = part.holds(nodes[near])
    # Where the mesh is coarse, interpolation overshoots; no air is colder or hotter than these.
    return np.clip(np.stack(frames), flow.ambient_k, flow.wall_k), solid


def _round_cylinder(
    flow: HeatFlow, case: Path, times_s: tuple[float, ...], grid: SampleGrid
) -> tuple[Array, NDArray[np.bool_]]:
    """Temperatures (nt, nx, ny, nz), K, over a cylinder; nodes inside it."""
    return np.stack([_instant(flow, case, t, grid) for t in times_s]), _solid(flow, grid)


def _solid(flow: HeatFlow, grid: SampleGrid) -> NDArray[np.bool_]:
    """Which nodes are inside the cylinder; shape (nx, ny, nz)."""
    x, y, z = np.meshgrid(grid.x, grid.y, grid.z, indexing="ij")
    inside = np.hypot(y, z + flow.radius_mm) < flow.radius_mm - _WALL_MM
    return inside if flow.section else inside & (x < flow.length_mm / 2.0 - _WALL_MM)


def _instant(flow: HeatFlow, case: Path, time_s: float, grid: SampleGrid) -> Array:
    """Temperature at the nodes, K; shape (nx, ny, nz)."""
    mesh, temperature = _mesh(case, time_s)
    centres = np.asarray(mesh.cells.cell_centers().points, dtype=np.float64)
    order = np.argsort(centres[:, 0], kind="stable")
    layers = np.split(order, np.flatnonzero(np.diff(centres[order, 0]) > _LAYER_MM) + 1)
    wall_k = flow.ambient_k + min(time_s / RAMP_S, 1.0) * (flow.wall_k - flow.ambient_k)

    places = np.array([centres[cells, 0].mean() for cells in layers])
    y, z = (axis.ravel() for axis in np.meshgrid(grid.y, grid.z, indexing="ij"))
    half = np.inf if flow.section else flow.length_mm / 2.0
    stack = np.empty((len(layers), len(y)))
    for some, wall in ((places < half, wall_k), (places > half, None)):
        if some.any():
            cells = [layers[i] for i in np.flatnonzero(some)]
            stack[some] = _across(flow, centres[:, 1:], temperature, cells, wall, y, z)

    if flow.section:
        sampled = np.repeat(stack, len(grid.x), axis=0)
    else:
        sampled = _along(places, stack, grid.x, mirrored=True)
        behind = np.hypot(y, z + flow.radius_mm) < flow.radius_mm  # as seen along the axis
        beyond = places > half
        sampled[:, behind] = _along(
            np.concatenate([[half], places[beyond]]),
            np.concatenate([np.full((1, behind.sum()), wall_k), stack[beyond][:, behind]]),
            np.maximum(grid.x, half),
            mirrored=False,
        )
    return sampled.reshape(len(grid.x), len(grid.y), len(grid.z))


def _mesh(case: Path, time_s: float) -> tuple[Mesh, Array]:
    """The mesh in mm, and the cells' temperature, K."""
    source = read_openfoam(case, time_s)
    temperature = next((v.values for v in source.variables if v.name == "T"), np.empty(0))
    if not isinstance(source.geometry, Mesh) or len(temperature) == 0:
        raise InputError(f"{case}: holds no mesh of cells at {time_s:g} s; run it again")
    cells = source.geometry.cells
    in_mm = moved(cells, 1e3 * np.asarray(cells.points, dtype=np.float64))
    return Mesh(in_mm, at_cells=True), temperature


def _across(
    flow: HeatFlow,
    centres: Array,
    temperature: Array,
    layers: list[NDArray[np.intp]],
    wall_k: float | None,
    y: Array,
    z: Array,
) -> Array:
    """Temperature of equal layers at the nodes (y, z); shape (layers, N), K."""
    points = centres[layers[0]]
    alike = cKDTree(points)  # a decomposed case numbers its cells differently in each layer
    values = np.empty((len(points), len(layers)))
    for i, cells in enumerate(layers):
        values[alike.query(centres[cells])[1], i] = temperature[cells]
    if wall_k is not None:
        angle = np.linspace(-np.pi, np.pi, 2 * WALL_POINTS, endpoint=False)
        R = flow.radius_mm
        circle = np.stack([R * np.cos(angle), R * (np.sin(angle) - 1.0)], axis=1)
        circle = circle if flow.whole else circle[circle[:, 0] > -_WALL_MM]
        points = np.concatenate([points, circle])
        values = np.concatenate([values, np.full((len(circle), len(layers)), wall_k)])
    if not flow.whole:  # the other half, so that the plane of symmetry is no border
        near = points[:, 0] > _WALL_MM
        points = np.concatenate([points, points[near] * (-1.0, 1.0)])
        values = np.concatenate([values, values[near]])
    with threadpool_limits(1):  # a thousand tiny matrices: threads would only wait for each other
        sampled = CloughTocher2DInterpolator(points, values, tol=_GRADIENT_TOLERANCE)(y, z).T
    return np.where(np.isnan(sampled), flow.ambient_k, sampled)


def _along(places: Array, values: Array, x: Array, mirrored: bool) -> Array:
    """Akima spline along x through the layers, which does not overshoot; shape (nx, N)."""
    if mirrored:
        places = np.concatenate([-places[2::-1], places])
        values = np.concatenate([values[2::-1], values])
    spline = Akima1DInterpolator(places, values, axis=0, method="makima")
    return spline(np.minimum(x, places[-1]))
