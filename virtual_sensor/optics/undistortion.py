"""A camera's distortion undone for many places on its film, by a table for Dr.Jit.

Newton's method on OpenCV's formula finds what an ideal pinhole would see at the nodes of a grid; a
cubic spline goes through how far that is from each node.  In float32 this difference is exact to
1e-5 px, where a place on the film itself is to 1e-4 px.
"""

from functools import lru_cache
from typing import Any

import numpy as np
from numpy.typing import NDArray

from virtual_sensor.arrays import in_own_memory
from virtual_sensor.engine import dr, mi
from virtual_sensor.errors import InputError
from virtual_sensor.medium.lookups import contracted, cubic_weights
from virtual_sensor.medium.spline import bspline_coefficients
from virtual_sensor.optics.ray_families import Pinhole, PixelFamily
from virtual_sensor.poses import Pose

Array = NDArray[np.float64]

ERROR_PX = 1e-5
"""Of a table, at most, in the middles of its cells."""

_FEWEST, _MOST = 17, 257  # nodes along the longer side
_CHECKED = 48  # cells along a side, at whose nodes a fold is looked for
_CACHED = 16


class Undistortion:
    """How far an ideal pinhole would see from where a camera that distorts does.

    Places on the film are Mitsuba's: pixel i reaches from i to i + 1.

    Parameters
    ----------
    family : PixelFamily

    Raises
    ------
    InputError
        If the distortion can't be undone somewhere on the film: it folds there.
    """

    def __init__(self, family: PixelFamily) -> None:
        nodes, coefficients = _spline(family)
        # Opaque: one kernel for any grid.
        cells = np.array(nodes) - 1.0
        self._scale = dr.opaque(mi.Array2f(*(cells / family.size).tolist()))
        self._last = dr.opaque(mi.Array2f(*(cells - 1.0).tolist()))
        self._stride = dr.opaque(mi.UInt32, coefficients.shape[1])
        self._coefficients = in_own_memory(coefficients, mi.Float)

    def at(self, place: Any) -> tuple[Any, Any]:
        """What is to be added to places to find an ideal pinhole's: along u and along v, px."""
        node = mi.Array2f(place) * self._scale
        cell = dr.floor(dr.clip(node, 0.0, self._last))
        column, row = node - cell
        first = mi.UInt32(cell.y) * self._stride + mi.UInt32(cell.x)
        found = contracted(
            lambda index: dr.gather(mi.Array2f, self._coefficients, index),
            first,
            [self._stride, 1],
            [cubic_weights(row), cubic_weights(column)],
            0,
        )[0, 0]
        return found.x, found.y


def check_unfolded(family: PixelFamily) -> None:
    """Raise InputError if a distortion can't be undone somewhere on the film."""
    if family.distorts:
        _moved(family, [_CHECKED, _CHECKED])


def _spline(family: PixelFamily) -> tuple[tuple[int, int], NDArray[np.float32]]:
    """Nodes along u and v, and coefficients (rows, columns, 2) of the spline through them."""
    numbers = (tuple(each.ravel().tolist()) for each in (family.matrix, family.distortion))
    return _spline_of(*numbers, tuple(family.size), family.fisheye)


@lru_cache(maxsize=_CACHED)  # a camera that moves keeps it
def _spline_of(
    matrix: tuple[float, ...], distortion: tuple[float, ...], size: tuple[int, int], fisheye: bool
) -> tuple[tuple[int, int], NDArray[np.float32]]:
    nowhere, K = Pose(np.eye(3), np.zeros(3)), np.array(matrix).reshape(3, 3)
    family, most = Pinhole(K, nowhere, size, np.array(distortion), fisheye), _FEWEST
    while True:
        cells = [max(4, -(-(most - 1) * n // max(size))) for n in size]
        coefficients = bspline_coefficients(_moved(family, cells), (False, False))
        missed = _between(coefficients) - _moved(family, cells, 0.5)
        if np.abs(missed).max() <= ERROR_PX or most >= _MOST:
            return (cells[0] + 1, cells[1] + 1), coefficients.astype(np.float32)
        most = 2 * most - 1


def _moved(family: PixelFamily, cells: list[int], first: float = 0.0) -> Array:
    """The differences (rows, columns, 2), px, at the nodes of cells over the film, or from within.

    `first` is where in its cell the first place lies; 0.5: the places are the cells' middles.
    """
    sides = zip(family.size, cells, strict=True)
    u, v = (np.arange(first, n + 1 - first) * (side / n) - 0.5 for side, n in sides)
    places = np.stack(np.meshgrid(u, v), axis=-1)
    moved = family.undistorted(places) - places
    if not np.isfinite(moved).all():
        row, column = np.argwhere(~np.isfinite(moved[..., 0]))[0]
        width, height = family.size
        raise InputError(
            f"the distortion folds the image, or has no inverse, about the pixel"
            f" ({abs(u[column]):.0f}, {abs(v[row]):.0f}) of {width} x {height}; give coefficients"
            " that hold up to its corners"
        )
    return moved


def _between(coefficients: Array) -> Array:
    """The spline in the middles of its cells."""
    weights = np.array([1.0, 23.0, 23.0, 1.0]) / 48.0
    for axis in (0, 1):
        rows = np.moveaxis(coefficients, axis, 0)
        count = len(rows) - 3
        summed = sum(w * rows[k : k + count] for k, w in enumerate(weights))
        coefficients = np.moveaxis(np.asarray(summed), 0, axis)
    return coefficients
