"""Values on meshes, interpolated by VTK through PyVista (an optional extra).

What VTK interpolates in a cell is linear along its edges, so that its gradient, which is what bends
light, jumps from cell to cell. Its interpolation is therefore done of value and gradient at the
points, f(x) = sum of w_i (f_i + g_i . (x - p_i) / 2), which is exact for quadratic fields.

Values at cells are values at the cells' centres. Those of the cells round a point are continued to
it with the mean of the gradients at either end, which is exact for quadratic fields too.
"""

from __future__ import annotations

from collections.abc import Callable
from typing import Any

import numpy as np
from scipy import sparse

from virtual_sensor.medium.imports.meshes import moved, pyvista, raise_vtk_errors
from virtual_sensor.medium.imports.sources import Mesh
from virtual_sensor.medium.imports.vtk_arrays import cell_corners, data_of, with_only

PASSES = 2
FLAT = 1e-3  # fullness of a tetrahedron, of which a regular one has 0.04
ON_PLANE = 1e-4  # of the width that is reflected
CHUNKS = 8  # of a sampling: VTK locates the cells again for each


def at_points(mesh: Mesh, values: np.ndarray, cells: Any) -> tuple[np.ndarray, np.ndarray]:
    """Values and gradients at a mesh's points.

    Parameters
    ----------
    mesh : Mesh
        In mm.
    values : ndarray of shape (number of cells,) or (number of points,)
        As `mesh.at_cells` says.
    cells : pyvista.UnstructuredGrid
        The mesh's cells, `without_polyhedra`.

    Returns
    -------
    values : ndarray of shape (number of points,)
    gradients : ndarray of shape (number of points, 3)
        Per mm.
    """
    f, points = np.asarray(values, dtype=np.float64), np.asarray(mesh.cells.points)
    if not mesh.at_cells:
        return f, _gradient(cells, points, f)
    corners, around = _means(mesh.cells)
    centres = _centres(mesh.cells, cells)
    places, f, g, missed = around @ centres, np.zeros(len(points)), np.zeros_like(points), f
    for _ in range(PASSES):
        more = _gradient(cells, places, around @ missed)
        at_centres = corners @ more
        # For each cell around a point, value + (g_centre + g_point) / 2 . (point - centre).
        f = f + (
            around @ (missed - 0.5 * (at_centres * centres).sum(axis=1))
            + 0.5 * ((around @ at_centres) * points).sum(axis=1)
            + 0.5 * (more * (points - places)).sum(axis=1)
        )
        g = g + more
        back = (corners @ g * centres).sum(axis=1) - corners @ (g * points).sum(axis=1)
        missed = values - (corners @ f + 0.5 * back)
    return f, g


def sample(
    mesh: Mesh,
    values: np.ndarray,
    axes: tuple[np.ndarray, ...],
    report: Callable[[float], None] = lambda fraction: None,
) -> np.ndarray:
    """Interpolate a mesh's values to the nodes of a grid.

    Parameters
    ----------
    mesh : Mesh
        In mm.
    values : ndarray
        At its cells or points.
    axes : tuple of three ndarray
        Coordinates of the nodes, mm.
    report : callable, optional
        Called with the fraction done.

    Returns
    -------
    ndarray of shape (nx, ny, nz)
        NaN at nodes outside of all cells.
    """
    pv = pyvista()
    whole = without_polyhedra(mesh.cells)
    f, g = at_points(mesh, values, whole)
    cells = with_only(whole, f=f, g=g, gp=(g * whole.points).sum(axis=1))
    if whole is not mesh.cells:  # beside a flat tetrahedron's plane its weights are far from 0 to 1
        cells = cells.extract_cells(_fullness(whole) > FLAT)
    report(0.2)

    low, high = np.reshape(cells.bounds, (3, 2)).T
    inner = [_inside(*each, (high - low).max()) for each in zip(axes, low, high, strict=True)]
    result = []
    longest = int(np.argmax([len(axis) for axis in inner]))
    for i, part in enumerate(np.array_split(inner[longest], CHUNKS)):
        if not len(part):
            continue
        target = pv.RectilinearGrid(*(part if a == longest else inner[a] for a in range(3)))
        with raise_vtk_errors():
            found = target.sample(cells)
        x = target.points
        value = found["f"] + 0.5 * ((found["g"] * x).sum(axis=1) - found["gp"])
        value = np.where(found["vtkValidPointMask"] > 0, value, np.nan)
        result.append(value.reshape(target.dimensions, order="F"))
        report(0.2 + 0.8 * (i + 1) / CHUNKS)
    return np.concatenate(result, axis=longest)


def without_polyhedra(cells: Any) -> Any:
    """Tetrahedra with the same points in place of cells, if any is a polyhedron.

    VTK is slow with those, which meshes of hexahedra have where they are refined.
    Each tetrahedron knows in `cell` whose part it is.
    """
    if pyvista().CellType.POLYHEDRON not in cells.celltypes:
        return cells
    return with_only(cells, at_cells=True, cell=np.arange(cells.n_cells)).triangulate()


def centre_section(mesh: Mesh, values: np.ndarray) -> tuple[Mesh, np.ndarray]:
    """Cut a mesh that is one layer of cells along x in its middle.

    Returns
    -------
    mesh : Mesh
        The plane mesh, put to x = 0.
    values : ndarray
        Its values.
    """
    cells = with_only(mesh.cells, mesh.at_cells, f=values)
    low, high = np.reshape(cells.bounds, (3, 2)).T
    if high[0] - low[0] > 1e-6 * (high - low).max():
        middle = (0.5 * (low[0] + high[0]), 0.0, 0.0)
        cut = cells.slice(normal="x", origin=middle, generate_triangles=False)
        cells = cut.cast_to_unstructured_grid()
    cells = moved(cells, np.asarray(cells.points) * [0.0, 1.0, 1.0])
    return Mesh(cells, mesh.at_cells), np.asarray(data_of(cells, mesh.at_cells)["f"])


def reflected(mesh: Mesh, values: np.ndarray, axis: int, near: float) -> tuple[Mesh, np.ndarray]:
    """Join a mesh with the mirror image of its cells that are nearer than `near` to axis = 0."""
    pv = pyvista()
    points = np.array(mesh.cells.points, dtype=np.float64)
    points[abs(points[:, axis]) < ON_PLANE * near, axis] = 0.0  # where the halves are joined
    cells = with_only(moved(mesh.cells, points), mesh.at_cells, f=values)
    image = cells.extract_cells(cells.cell_centers().points[:, axis] < near)
    image = moved(image, np.asarray(image.points) * np.where(np.arange(3) == axis, -1.0, 1.0))
    for name in ("vtkOriginalPointIds", "vtkOriginalCellIds"):
        for data in (image.point_data, image.cell_data):
            if name in data:
                del data[name]
    joined = pv.merge([cells, image], merge_points=True)
    return Mesh(joined, mesh.at_cells), np.asarray(data_of(joined, mesh.at_cells)["f"])


def cell_sizes(mesh: Mesh) -> np.ndarray:
    """Median extent of the cells along x, y and z; shape (3,)."""
    return np.median(_extents(mesh.cells), axis=0)


def _inside(axis: np.ndarray, low: float, high: float, size: float) -> np.ndarray:
    """Move nodes that are on the mesh's border inside, which rounding may otherwise leave out."""
    inset = min(1e-7 * size, 0.5 * (high - low))
    near = np.minimum(abs(axis - low), abs(axis - high)) < 1e-6 * size
    return np.where(near, np.clip(axis, low + inset, high - inset), axis)


def _extents(cells: Any) -> np.ndarray:
    """Extents of the cells along x, y and z; shape (number of cells, 3)."""
    starts, corners = cell_corners(cells.GetCells())
    points = np.asarray(cells.points)[corners]
    highest = np.maximum.reduceat(points, starts[:-1])
    return highest - np.minimum.reduceat(points, starts[:-1])


def _centres(cells: Any, parts: Any) -> np.ndarray:
    """The cells' centres, of polyhedra from their parts; shape (number of cells, 3)."""
    if parts is cells:
        return cells.cell_centers().points.astype(np.float64)
    whose, volume = parts.cell_data["cell"], _sizes(parts, "Volume")
    moments = (volume[:, None] * parts.cell_centers().points).T
    sums = np.stack([np.bincount(whose, m, cells.n_cells) for m in moments], axis=1)
    return sums / np.bincount(whose, volume, cells.n_cells)[:, None]


def _sizes(cells: Any, name: str) -> np.ndarray:
    """Area or volume of the cells, also of inverted ones."""
    return np.abs(cells.compute_cell_sizes(length=False).cell_data[name])


def _fullness(cells: Any) -> np.ndarray:
    """Volume or area of the cells over that of a cube or square as wide as their diagonal."""
    area, volume = (_sizes(cells, name) for name in ("Area", "Volume"))
    longest = np.maximum(np.linalg.norm(_extents(cells), axis=1), 1e-30)
    return np.where(volume > 0.0, volume / longest**3, area / longest**2)


def _means(cells: Any, weight: np.ndarray | float = 1.0) -> tuple[Any, Any]:
    """Sparse matrices: the mean of each cell's points, and that of the cells at each point."""
    starts, corners = cell_corners(cells.GetCells())
    ones = np.ones(len(corners))
    at_cells = sparse.csr_array((ones, corners, starts), shape=(cells.n_cells, cells.n_points))
    at_points = at_cells.T.tocsr() @ sparse.diags_array(np.broadcast_to(weight, cells.n_cells))
    of_points, of_cells = (
        sparse.diags_array(1.0 / np.maximum(m.sum(axis=1), 1e-30)) @ m
        for m in (at_cells, at_points)
    )
    return of_points, of_cells


def _gradient(cells: Any, places: np.ndarray, values: np.ndarray) -> np.ndarray:
    """Gradient at the points of a smooth function that is known at other places.

    Each cell's gradient is that at the mean of its corners' places. Its means over the cells at a
    point belong to the means of those, and are continued linearly from there to the point.

    Parameters
    ----------
    cells : pyvista.UnstructuredGrid
        The cells, with the points.
    places : ndarray of shape (N, 3)
        Where, in place of the points, the values are known.
    values : ndarray of shape (N,)
        The values.

    Returns
    -------
    ndarray of shape (N, 3)
    """
    means, at = _mean_slopes(moved(cells, places), values)
    slopes = [_mean_slopes(moved(cells, at), component)[0] for component in means.T]
    return means + np.einsum("nij,nj->ni", np.stack(slopes, axis=1), cells.points - at)


def _mean_slopes(cells: Any, values: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Means of the adjacent cells' gradients at each point, and of the places they belong to."""
    from vtkmodules.vtkFiltersGeneral import vtkCellDerivatives

    # Across it a sliver knows nothing; but where there are only such, they still have a place.
    of_points, of_cells = _means(cells, _fullness(cells) ** 2 + 1e-12)
    bare = with_only(cells, f=values)
    bare.set_active_scalars("f")
    of_each = vtkCellDerivatives()
    of_each.SetInputData(bare)
    of_each.SetVectorModeToComputeGradient()
    of_each.SetTensorModeToPassTensors()
    with raise_vtk_errors(fatal=None):
        of_each.Update()
        slopes = pyvista().wrap(of_each.GetOutput()).cell_data["ScalarGradient"]
    slopes = np.nan_to_num(np.asarray(slopes, dtype=np.float64), posinf=0.0, neginf=0.0)
    return of_cells @ slopes, of_cells @ (of_points @ np.asarray(cells.points))
