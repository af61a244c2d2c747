"""The arrays of a data set of VTK: which are read, and where they hold no data."""

from __future__ import annotations

from typing import Any

import numpy as np

from virtual_sensor.medium.imports.sources import Variable, split_units

HIDDEN_POINT = 2  # VTK's flags, of points and of cells
DUPLICATE, REFINED, HIDDEN_CELL = 1, 8, 32


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
    if not len(blank):
        blank = np.zeros(data.n_points, bool)
    if "vtkValidPointMask" in data.point_data:
        blank |= np.asarray(data.point_data["vtkValidPointMask"]) == 0
    return blank


def ghosts(arrays: Any, flags: int) -> np.ndarray:
    """Where one of VTK's ghost flags is set; empty if there is nothing to flag."""
    count = arrays.valid_array_len or 0
    if "vtkGhostType" not in arrays:
        return np.zeros(count, bool)
    return (np.asarray(arrays["vtkGhostType"]).astype(int) & flags) != 0


def scalars(data: Any) -> list[Variable]:
    """The real scalars among a data set's arrays."""
    return [
        Variable(*split_units(name), np.asarray(array))
        for name, array in data.items()
        if array.ndim == 1 and array.dtype.kind in "fiu" and not name.startswith("vtk")
    ]
