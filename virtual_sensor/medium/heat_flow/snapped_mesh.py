"""The mesh round a part from an STL file: a box of cells, cut and snapped by `snappyHexMesh`.

The box is uniform round the part and grows coarser above it. `snappyHexMesh` halves its cells, in
each direction, three times in the plume and four times at the part, removes those inside the part,
and moves the others' corners onto its surface and edges.
"""

from __future__ import annotations

import math
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from virtual_sensor.errors import InputError, naming
from virtual_sensor.medium.heat_flow.mesh import TOP_MM, Division, dictionary, listed
from virtual_sensor.medium.imports.meshes import pyvista, raise_vtk_errors

Array = NDArray[np.float64]

SURFACE = "constant/triSurface/part.stl"
"""Where a case keeps its part."""

SMALLEST_MM, LARGEST_MM = 2.0, 2000.0
ROOM_MM = 45.0  # of air beside and below the part, at least
ROOM_SHARE = 0.3  # of the part's longer side
HEADROOM_MM = 100.0  # for the plume
PLUME_MM = 8.0  # the plume's cells begin so far beside the part
PLUME_LEVEL, WALL_LEVEL = 3, 4  # how often cells are halved
CELLS_OF_A_LEVEL = 3  # at least, before the next one
STRETCH = 6.0  # height of the highest cells over that of those round the part
MOST_CELLS = 2e7
_PLACES = 30  # along each axis, at which a part of several bodies is tried


@dataclass(frozen=True)
class Part:
    """A part's surface in the world frame.

    Attributes
    ----------
    surface : pyvista.PolyData
        Triangles, closed; mm. Of each body they face outwards.
    bodies : tuple of pyvista.PolyData
        The same, body by body.
    low_mm, high_mm : ndarray of shape (3,)
        Corners of its bounding box.
    """

    surface: Any
    bodies: tuple[Any, ...]
    low_mm: Array
    high_mm: Array

    @property
    def height_mm(self) -> float:
        """Along z."""
        return float(self.high_mm[2] - self.low_mm[2])

    @property
    def volume_mm3(self) -> float:
        """What it fills; bodies that overlap count twice."""
        return float(sum(body.volume for body in self.bodies))

    @property
    def filled_mm3(self) -> float:
        """What it fills, however bodies overlap: within a few per cent if there are several."""
        if len(self.bodies) == 1:
            return self.volume_mm3
        size = self.high_mm - self.low_mm
        places = np.stack(np.meshgrid(*[(np.arange(_PLACES) + 0.5) / _PLACES] * 3), axis=-1)
        inside = self.holds(self.low_mm + places.reshape(-1, 3) * size)
        return float(inside.mean() * size.prod())

    @property
    def thickness_mm(self) -> float:
        """Of a sheet with as much volume and surface."""
        return 2.0 * self.volume_mm3 / float(self.surface.area)

    def holds(self, points_mm: Array) -> NDArray[np.bool_]:
        """Which points (N, 3) lie inside."""
        points = pyvista().PolyData(points_mm)
        inside = np.zeros(len(points_mm), dtype=bool)
        for body in self.bodies:
            inside |= points.compute_implicit_distance(body)["implicit_distance"] <= 0.0
        return inside


def read_part(path: Path) -> Part:
    """Read an STL file, ASCII or binary, in mm, z up.

    Raises
    ------
    InputError
        If it is missing, damaged, not closed or of an unlikely size, or PyVista is not installed.
    """
    if not path.is_file():
        raise InputError(f"{path}: there is no such file")
    with naming(path), raise_vtk_errors():
        surface = pyvista().STLReader(f"{path}").read()
    if not surface.n_cells:
        raise InputError(f"{path}: holds no triangles; is it an STL file?")
    low, high = np.reshape(np.asarray(surface.bounds, dtype=np.float64), (3, 2)).T
    _check_size(path, high - low)
    open_edges = surface.extract_feature_edges(
        boundary_edges=True, non_manifold_edges=False, feature_edges=False, manifold_edges=False
    )
    if open_edges.n_cells:
        x, y, z = open_edges.points[0]
        raise InputError(
            f"{path}: the surface is not closed: {open_edges.n_cells} edges belong to one triangle"
            f" only, the first at ({x:.4g}, {y:.4g}, {z:.4g}) mm, and air would fill the part;"
            " export a solid, or close it in the program that made it"
        )
    if (high - low).min() <= 0.0:
        raise InputError(f"{path}: the part is flat; export a solid")
    bodies = tuple(_outwards(body) for body in surface.split_bodies())
    return Part(surface, bodies, low, high)


def _outwards(body: Any) -> Any:
    """A closed surface with its faces outwards, whatever the file says."""
    return body.extract_surface(algorithm="dataset_surface").compute_normals(
        auto_orient_normals=True, consistent_normals=True, split_vertices=False
    )


def _check_size(path: Path, size: Array) -> None:
    if SMALLEST_MM <= size.max() <= LARGEST_MM:
        return
    long = " x ".join(f"{s:.3g}" for s in size)
    likely, factor = ("m", "1000") if size.max() < SMALLEST_MM else ("um", "0.001")
    raise InputError(
        f"{path}: the part is {long} mm; parts of {SMALLEST_MM:g} to {LARGEST_MM:g} mm can be"
        f" simulated. The file must be in mm; if it is in {likely}, scale it by {factor}"
    )


def check_place(path: Path, part: Part, light_mm: tuple[float, float, float]) -> None:
    """Refuse a part that is not where the light is.

    Raises
    ------
    InputError
        Which says where the part is, and where it should be.
    """
    low, high = part.low_mm, part.high_mm
    *across, top = light_mm
    for axis, light, a, b in zip("xy", across, low, high, strict=False):
        if a > light + ROOM_MM or b < light - ROOM_MM:
            raise InputError(
                f"{path}: the part lies at {axis} = {a:.4g} to {b:.4g} mm, outside the domain: the"
                f" light is at x = {across[0]:g}, y = {across[1]:g}; move the part there, or give"
                " its scene by --scene"
            )
    if high[2] > top - HEADROOM_MM:
        raise InputError(
            f"{path}: the part reaches up to z = {high[2]:.4g} mm; the domain ends at {top:g}"
            f" mm, and the plume needs {HEADROOM_MM:g} mm. The sensor's working point is at z = 0:"
            " move the part down to it, or give its scene by --scene"
        )


@dataclass(frozen=True)
class SnappedMesh:
    """The box of cells that `snappyHexMesh` starts from, and where it refines.

    Attributes
    ----------
    low_mm, high_mm : ndarray of shape (3,)
        Corners of the box.
    middle_mm : float
        Height z up to which its cells are uniform.
    cells : tuple of three int
        Of the uniform part, along x, y and z.
    above : Division
        Of the part above it, along z.
    cell_mm : float
        Width of its uniform cells.
    plume_mm : tuple of two ndarray of shape (3,)
        Corners of the box in which cells are as fine as the plume needs.
    """

    low_mm: Array
    high_mm: Array
    middle_mm: float
    cells: tuple[int, int, int]
    above: Division
    cell_mm: float
    plume_mm: tuple[Array, Array]


def snapped_mesh(
    part: Part, cell_mm: float, top_mm: float = TOP_MM, most: float = MOST_CELLS
) -> SnappedMesh:
    """Lay out the mesh: cells `cell_mm` wide across the plume, the others in proportion.

    The air reaches up to `top_mm`; there are `most` cells, or fewer.

    Raises
    ------
    InputError
        If there would be too many cells.
    """
    width = cell_mm * 2**PLUME_LEVEL
    middle = float(part.high_mm[2]) + min(width, HEADROOM_MM / 4.0)
    room = max(ROOM_MM, ROOM_SHARE * float((part.high_mm - part.low_mm)[:2].max()))
    low, high = part.low_mm - room, part.high_mm + room
    high[2] = middle
    counts = np.ceil((high - low) / width)
    excess = counts * width - (high - low)
    low -= excess * (0.5, 0.5, 1.0)
    high += excess * (0.5, 0.5, 0.0)
    high[2] = top_mm
    length = top_mm - middle
    first = min(width, length / 4.0)
    above = Division.between(length, first, min(STRETCH * first, length / 3.0))

    beside = np.array([PLUME_MM, PLUME_MM, 0.0])
    plume = (part.low_mm - beside, part.high_mm + beside)
    plume[1][2] = top_mm
    nx, ny, nz = (int(n) for n in counts)
    mesh = SnappedMesh(low, high, middle, (nx, ny, nz), above, width, plume)
    if (expected := expected_cells(part, mesh)) > most:
        raise InputError(
            f"cells of {cell_mm:g} mm would be about {expected / 1e6:.0f} million for this part;"
            f" {most / 1e6:.0f} million is the limit: take coarser ones"
        )
    return mesh


def expected_cells(part: Part, mesh: SnappedMesh) -> float:
    """Estimate how many cells there will be: in the box, in the plume and at the part."""
    nx, ny, nz = mesh.cells
    width, depth, _ = mesh.plume_mm[1] - mesh.plume_mm[0]
    rows = 2**PLUME_LEVEL * (mesh.above.cells + part.height_mm / mesh.cell_mm)
    plume = width * depth / (mesh.cell_mm / 2**PLUME_LEVEL) ** 2 * rows
    at_part = 2 * CELLS_OF_A_LEVEL * part.surface.area / (mesh.cell_mm / 2**WALL_LEVEL) ** 2
    return float(nx * ny * (nz + mesh.above.cells) + plume + at_part)


def wall_faces_mm(cell_mm: float) -> Array:
    """Distance of the cells' faces from the part, until they are as wide as the box's own; mm."""
    width = cell_mm * 2.0**PLUME_LEVEL
    levels = np.repeat(np.arange(WALL_LEVEL, 0, -1), CELLS_OF_A_LEVEL)
    return np.cumsum(width / 2.0**levels)


def box_mesh_dict(mesh: SnappedMesh) -> str:
    """The body of `system/blockMeshDict`."""
    (x0, y0, z0), (x1, y1, z2) = mesh.low_mm, mesh.high_mm
    nx, ny, _ = mesh.cells
    above = mesh.above
    vertices = [
        listed((x, y, z))
        for z in (z0, mesh.middle_mm, z2)
        for x, y in ((x0, y0), (x1, y0), (x1, y1), (x0, y1))
    ]
    blocks = [
        f"hex (0 1 2 3 4 5 6 7) {listed(mesh.cells)} simpleGrading (1 1 1)    // round the part",
        f"hex (4 5 6 7 8 9 10 11) {listed((nx, ny, above.cells))}"
        f" simpleGrading {listed((1, 1, above.ratio))}    // above",
    ]
    sides = [
        (k + i, k + (i + 1) % 4, k + 4 + (i + 1) % 4, k + 4 + i) for k in (0, 4) for i in range(4)
    ]
    patches = (("open", "patch", [(0, 3, 2, 1), *sides]), ("top", "patch", [(8, 9, 10, 11)]))
    return dictionary(vertices, blocks, [], patches)


def snapping_parameters(mesh: SnappedMesh) -> dict[str, tuple[str, str]]:
    """What `system/snappyHexMeshDict` includes: entries, with units in words."""
    beside_corner = mesh.low_mm + mesh.cell_mm / math.e  # on no face of a cell of any level
    return {
        "plumeLow": (_point_in_m(mesh.plume_mm[0]), "m, of the box with the plume's cells"),
        "plumeHigh": (_point_in_m(mesh.plume_mm[1]), "m"),
        "pointInAir": (_point_in_m(beside_corner), "m"),
        "plumeLevel": (f"{PLUME_LEVEL}", "halvings of the box's cells"),
        "wallLevel": (f"{WALL_LEVEL}", ""),
        "cellsOfALevel": (f"{CELLS_OF_A_LEVEL}", "at least"),
    }


def _point_in_m(point_mm: Array) -> str:
    return "(" + " ".join(f"{1e-3 * v:.8g}" for v in point_mm) + ")"
