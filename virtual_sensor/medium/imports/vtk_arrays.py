"""The arrays of a data set of VTK: which are read, and where they hold no data."""

from __future__ import annotations

from typing import Any

import numpy as np

from virtual_sensor.errors import InputError
from virtual_sensor.medium.imports.sources import Variable, split_units

HIDDEN_POINT = 2  # VTK's flags, of points and of cells
DUPLICATE, REFINED, HIDDEN_CELL = 1, 8, 32
ANY_ORDER = 40  # types of cells below it have a fixed number of corners, or any


def left_out(data: Any) -> tuple[str, ...]:
    """Note the arrays that are no scalars."""
    names = [
        f"{name} ({array.shape[1]} components)" if array.ndim > 1 else f"{name} (text)"
        for arrays in (data.point_data, data.cell_data)
        for name, array in arrays.items()
        if array.ndim > 1 or array.dtype.kind not in "fiub"
    ]
    names += [f"field data {name}" for name in data.field_data.keys()]  # noqa: SIM118
    return (f"not read: {', '.join(dict.fromkeys(names))}",) if names else ()


def joined_neighbours(flags: np.ndarray, join: np.ufunc) -> np.ndarray:
    """Join the flags of neighbours along each axis, which gets shorter by one unless it is flat."""
    for axis, n in enumerate(flags.shape):
        if n > 1:
            flags = join(flags.take(range(n - 1), axis), flags.take(range(1, n), axis))
    return flags


def blank_points(data: Any) -> np.ndarray:
    """Which points have no data."""
    blank = ghosts(data.point_data, HIDDEN_POINT)
    if "vtkValidPointMask" in data.point_data:
        blank |= np.asarray(data.point_data["vtkValidPointMask"]) == 0
    return blank


def ghosts(arrays: Any, flags: int) -> np.ndarray:
    """Where one of VTK's ghost flags is set; empty if there is nothing to flag."""
    count = arrays.valid_array_len or 0
    if "vtkGhostType" not in arrays:
        return np.zeros(count, bool)
    return (np.asarray(arrays["vtkGhostType"]).astype(int) & flags) != 0


def data_of(cells: Any, at_cells: bool) -> Any:
    """The arrays at a data set's cells, or those at its points."""
    return cells.cell_data if at_cells else cells.point_data


def with_only(cells: Any, at_cells: bool = False, **arrays: np.ndarray) -> Any:
    """A shallow copy of cells that has these arrays, at its points or its cells, and no others."""
    result = cells.copy(deep=False)
    result.clear_data()
    data_of(result, at_cells).update(arrays)
    return result


def cell_corners(cells: Any) -> tuple[np.ndarray, np.ndarray]:
    """Where each cell's points start in the list of points, and that list; of a vtkCellArray."""
    from vtkmodules.util.numpy_support import vtk_to_numpy

    arrays = (cells.GetOffsetsArray(), cells.GetConnectivityArray())
    starts, corners = (vtk_to_numpy(array).astype(np.int64) for array in arrays)
    return starts, corners


def scalars(data: Any, at_cells: bool) -> list[Variable]:
    """The real scalars among the arrays at a data set's cells, or at its points."""
    return [
        Variable(*split_units(name), np.asarray(array))
        for name, array in data_of(data, at_cells).items()
        if array.ndim == 1 and array.dtype.kind in "fiu" and not name.startswith("vtk")
    ]


def check_mesh(cells: Any) -> None:
    """Refuse a mesh whose cells refer to points that are not there, or that is nowhere.

    Parameters
    ----------
    cells : pyvista.UnstructuredGrid or pyvista.PolyData
        As it was read.

    Raises
    ------
    InputError
        It names the cell or the point.
    """
    points = np.asarray(cells.points)
    names = ("GetCells",) if hasattr(cells, "GetCells") else ("GetVerts", "GetLines", "GetPolys")
    for name in names:
        array = getattr(cells, name)()
        if array is None or array.GetNumberOfCells() == 0:
            continue
        starts, corners = cell_corners(array)
        if starts[0] != 0 or (np.diff(starts) < 0).any() or starts[-1] > len(corners):
            raise InputError("is damaged: its cells' offsets do not ascend; write it again")
        wrong = (corners < 0) | (corners >= len(points))
        if wrong.any():
            where = int(np.searchsorted(starts, np.flatnonzero(wrong)[0], "right")) - 1
            raise InputError(
                f"is damaged: cell {where} refers to point {corners[wrong][0]}, and there are"
                f" {len(points)} points; write it again"
            )
        if name == "GetCells":
            _check_corners(np.asarray(cells.celltypes), np.diff(starts))
    bad = ~np.isfinite(points).all(axis=1)
    if bad.any():
        raise InputError(
            f"the coordinates of {bad.sum()} points are not finite, of point"
            f" {np.flatnonzero(bad)[0]} for one; remove them"
        )


def _check_corners(kinds: np.ndarray, counts: np.ndarray) -> None:
    """Refuse cells that have another number of corners than their type, or no type."""
    from vtkmodules.vtkCommonDataModel import vtkGenericCell

    wanted = np.zeros(256, dtype=np.int64)  # 0: any
    for kind in np.unique(kinds[kinds < ANY_ORDER]).tolist():
        cell = vtkGenericCell.InstantiateCell(kind)
        wanted[kind] = cell.GetNumberOfPoints() if cell else 0
    fixed = wanted[kinds]
    wrong = (fixed > 0) & (fixed != counts) | (kinds == 0) | (counts == 0)
    if wrong.any():
        where = int(np.flatnonzero(wrong)[0])
        raise InputError(
            f"is damaged: cell {where}, of VTK's type {kinds[where]}, has {counts[where]} corners;"
            " write it again"
        )
