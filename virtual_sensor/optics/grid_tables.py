"""Smooth functions of three coordinates on regular grids: splines for NumPy, linear for Dr.Jit."""

import threading
from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import NDArray
from scipy.sparse import csr_array

from virtual_sensor.arrays import by_rows, in_own_memory, to_numpy, to_vectors
from virtual_sensor.display import Displayed
from virtual_sensor.engine import dr, mi
from virtual_sensor.medium.lookups import contracted, cubic_weights
from virtual_sensor.medium.spline import bspline_coefficients

Array = NDArray[np.float64]

_PACKET = 4  # functions side by side, which one load reads
_SLACK = 1e-3  # of a cell: places this far out of the grid are still in it, but for rounding


@dataclass(frozen=True)
class Grid(Displayed):
    """A regular grid in three coordinates.

    Attributes
    ----------
    low, high : ndarray of shape (3,)
        First and last node.
    shape : tuple of three int
        Nodes along each.
    """

    low: Array
    high: Array
    shape: tuple[int, int, int]

    @property
    def spacing(self) -> Array:
        """Distance of nodes, shape (3,)."""
        return (self.high - self.low) / (np.array(self.shape) - 1.0)

    def axes(self) -> list[Array]:
        """The nodes along each coordinate."""
        return [np.linspace(*x) for x in zip(self.low, self.high, self.shape, strict=True)]

    def nodes(self) -> Array:
        """All nodes, (N, 3), the last coordinate fastest."""
        return np.stack(np.meshgrid(*self.axes(), indexing="ij"), axis=-1).reshape(-1, 3)

    def holds(self, places: Array) -> NDArray[np.bool_]:
        """Which places (N, 3) lie on the grid, but for rounding; NaN does not."""
        slack = _SLACK * self.spacing
        return np.all((places >= self.low - slack) & (places <= self.high + slack), axis=1)


class SplineTable:
    """Some functions of three coordinates: cubic B-splines through their values at nodes, float64.

    Parameters
    ----------
    grid : Grid
    values : ndarray of shape (N, C)
        C functions at the grid's nodes.
    """

    def __init__(self, grid: Grid, values: Array) -> None:
        self.grid = grid
        shaped = values.reshape(*grid.shape, -1)
        self._coefficients = bspline_coefficients(shaped, (False, False, False))
        self._cubic: dict[str, _CubicTable] = {}
        self._linear: dict[tuple[str, int, tuple[int, ...]], LinearTable] = {}

    def at(self, places: Array, functions: int | None = None) -> Array:
        """The functions, or the first of them, at places (N, 3): (N, C).

        Beyond the grid, the outermost cubics go on.
        """
        return self.with_slopes(places, (), functions)[0]

    def with_slopes(
        self, places: Array, axes: tuple[int, ...] = (0, 1), functions: int | None = None
    ) -> tuple[Array, ...]:
        """The functions at places (N, 3), and their derivatives by coordinates: (N, C) each."""
        variant, count = mi.variant(), functions or self.functions
        if variant not in self._cubic:
            self._cubic[variant] = _CubicTable(self.grid, self._coefficients)
        table = self._cubic[variant]
        return by_rows(lambda some: table.at(to_vectors(some), axes, count), places)

    def on_grid(self, grid: Grid, order: tuple[int, int, int] = (0, 0, 0)) -> Array:
        """The functions, or derivatives of some order, at a grid's nodes: (N, C); quickly."""
        values = self._coefficients
        for axis, (at, nodes) in enumerate(zip(grid.axes(), self.grid.shape, strict=True)):
            step = self.grid.spacing[axis]
            places = (at - self.grid.low[axis]) / step
            matrix = _basis(places, nodes, order[axis]) / step ** order[axis]
            values = _along(matrix, values, axis)
        return values.reshape(-1, self.functions)

    @property
    def functions(self) -> int:
        """How many they are."""
        return self._coefficients.shape[-1]

    @property
    def bytes(self) -> int:
        """Memory that it takes, with the tables for Dr.Jit made of it."""
        tables: list[_CubicTable | LinearTable] = [*self._cubic.values(), *self._linear.values()]
        return self._coefficients.nbytes + sum(table.bytes for table in tables)

    def finer(self, tolerances: Array) -> tuple[int, list[int]]:
        """How a linear table is to be made that errs by no more.

        Parameters
        ----------
        tolerances : ndarray of shape (F,)
            For the first F functions, each in the function's unit.

        Returns
        -------
        cubic : int
            The coordinate along which linear interpolation needs most nodes: there is none there.
        finer : list of three int
            How many times finer the grid is to be along each coordinate.
        """
        scaled = self._coefficients[..., : len(tolerances)] / tolerances
        bends = [float(np.abs(np.diff(scaled, 2, axis=k)).max()) for k in range(3)]  # f'' h^2
        cubic = int(np.argmax(bends * (np.array(self.grid.shape) - 1.0) ** 2))
        bends[cubic] = 0.0
        return cubic, [max(int(np.ceil(np.sqrt(bend * 2.0 / 8.0))), 1) for bend in bends]

    def linear(self, cubic: int, finer: list[int]) -> "LinearTable":
        """The same functions for Dr.Jit; see `finer`."""
        key = mi.variant(), cubic, tuple(finer)
        if key not in self._linear:
            self._linear[key] = self._finer_table(cubic, finer)
        return self._linear[key]

    def _finer_table(self, cubic: int, finer: list[int]) -> "LinearTable":
        values, shape = self._coefficients.astype(np.float32), list(self.grid.shape)
        for axis in set(range(3)) - {cubic}:
            nodes = shape[axis]
            at = np.linspace(0.0, nodes - 1.0, finer[axis] * (nodes - 1) + 1)
            values = _along(_basis(at, nodes).astype(np.float32), values, axis)
            shape[axis] = at.size
        grid = Grid(self.grid.low, self.grid.high, (shape[0], shape[1], shape[2]))
        return LinearTable(grid, values, cubic)


def _basis(places: Array, nodes: int, order: int = 0) -> csr_array:
    """What coefficients contribute at places, in units of the spacing: (places, nodes + 2).

    Beyond the nodes, the outermost cubics go on.
    """
    cell = np.clip(np.floor(places), 0, nodes - 2).astype(int)
    f = places - cell
    g = 1.0 - f
    weights = {
        0: (g**3, 4.0 - 6.0 * f**2 + 3.0 * f**3, 4.0 - 6.0 * g**2 + 3.0 * g**3, f**3),
        1: (-3.0 * g**2, 9.0 * f**2 - 12.0 * f, 12.0 * g - 9.0 * g**2, 3.0 * f**2),
    }[order]
    columns = cell[:, None] + np.arange(4)
    rows = 4 * np.arange(len(places) + 1)
    values = np.stack(weights, axis=1).ravel() / 6.0
    return csr_array((values, columns.ravel(), rows), shape=(len(places), nodes + 2))


def _along(matrix: csr_array, values: NDArray[np.floating], axis: int) -> Any:
    """A matrix applied along an axis."""
    along = np.moveaxis(values, axis, 0)
    applied = matrix @ along.reshape(len(along), -1)
    return np.moveaxis(applied.reshape(-1, *along.shape[1:]), 0, axis)


class _CubicTable:
    """The splines in Dr.Jit, in double precision."""

    def __init__(self, grid: Grid, coefficients: Array) -> None:
        functions = coefficients.shape[-1]
        packed = np.zeros((*coefficients.shape[:-1], -(-functions // _PACKET) * _PACKET))
        packed[..., :functions] = coefficients
        firsts = range(0, functions, _PACKET)
        self._fours = [in_own_memory(packed[..., i : i + _PACKET], mi.Float64) for i in firsts]
        # Opaque: one kernel for any grid.
        numbers = grid.low, 1.0 / grid.spacing, np.array(grid.shape) - 2.0
        self._axes = [dr.opaque(mi.Array3f64(*np.asarray(v, float).tolist())) for v in numbers]
        _, n1, n2 = coefficients.shape[:3]
        self._strides = [dr.opaque(mi.UInt32, stride) for stride in (n1 * n2, n2, 1)]
        self.bytes = packed.nbytes

    def at(self, places: Any, axes: tuple[int, ...], functions: int) -> tuple[Array, ...]:
        """The first functions at places, and their derivatives along axes: each (N, C)."""
        with _ONE_AT_A_TIME:
            fours = [
                _four_functions(places, *self._axes, self._strides, four, axes)
                for four in self._fours[: -(-functions // _PACKET)]
            ]
        dr.eval(fours)
        together = (
            np.hstack([to_numpy(part) for part in parts]) for parts in zip(*fours, strict=True)
        )
        return tuple(values[:, :functions] for values in together)


_ONE_AT_A_TIME = threading.Lock()


@dr.freeze  # to trace it takes longer than to compute thousands of places
def _four_functions(
    places: Any, low: Any, scale: Any, last: Any, strides: list[Any], four: Any, axes: Any
) -> list[Any]:
    """Four functions that lie side by side, which one load reads, and their derivatives."""
    u = (places - low) * scale
    cell = dr.floor(dr.clip(u, 0.0, last))
    weights = [cubic_weights(t) for t in u - cell]
    first = sum(mi.UInt32(i) * stride for i, stride in zip(cell, strides, strict=True))

    def read(at: Any) -> Any:
        return dr.gather(mi.Array4f64, four, at)

    along = contracted(read, first, strides, weights, min(len(axes), 1))
    slopes = (along[tuple(int(k == axis) for k in range(3))] * scale[axis] for axis in axes)
    return [along[0, 0, 0], *slopes]


class LinearTable:
    """Some functions of three coordinates in Dr.Jit: linear along two of them, cubic along one.

    A cubic along the coordinate that would need most nodes, out of two linear lookups (Sigg and
    Hadwiger 2005, GPU Gems 2, chapter 20), keeps the table in the processor's cache.

    Parameters
    ----------
    grid : Grid
    values : ndarray of shape (n0, n1, n2, C)
        C functions at the grid's nodes; along `cubic`, B-spline coefficients instead, n + 2 of n
        nodes.
    cubic : int
        That coordinate.
    """

    def __init__(self, grid: Grid, values: NDArray[np.floating], cubic: int) -> None:
        self.grid = grid
        self._cubic = cubic
        flat = in_own_memory(values, mi.Float)
        tensor = mi.TensorXf(flat, values.shape)
        self._texture = mi.Texture3f(tensor, use_accel=False, wrap_mode=dr.WrapMode.Clamp)
        # Texel centres are at (i + 1/2) / N.  Opaque: one kernel for any grid.
        texels = np.array(values.shape[:3])
        self._low, self._scale, self._last, self._inverse = (
            dr.opaque(mi.Array3f(*np.asarray(v, float).tolist()))
            for v in (grid.low, 1.0 / grid.spacing, np.array(grid.shape) - 1.0, 1.0 / texels)
        )
        self.bytes = 4 * values.size

    def at(self, place: Any) -> list[Any]:
        """The functions at places, float32; beyond the grid as at its border."""
        node = dr.clip(self._on_grid(place), 0.0, self._last)
        k = self._cubic
        cell = dr.minimum(dr.floor(node[k]), dr.maximum(self._last[k] - 1.0, 0.0))
        f = node[k] - cell
        g = 1.0 - f
        # Weights of the four coefficients; a pair is one linear lookup between the two.
        first, third = g * g * g / 6.0, (1.0 + 3.0 * f * (1.0 + f * g)) / 6.0
        second, fourth = (1.0 + 3.0 * g * (1.0 + g * f)) / 6.0, f * f * f / 6.0
        values = []
        for one, other, start in ((first, second, 0.0), (third, fourth, 2.0)):
            both = one + other
            texel = mi.Array3f(node)
            texel[k] = cell + start + other / both
            u = (texel + 0.5) * self._inverse
            values.append([both * v for v in self._texture.eval(mi.Point3f(u.z, u.y, u.x))])
        return [a + b for a, b in zip(*values, strict=True)]

    def holds(self, place: Any) -> Any:
        """Which places lie on the grid."""
        node = self._on_grid(place)
        return dr.all((node >= -_SLACK) & (node <= self._last + _SLACK))

    def _on_grid(self, place: Any) -> Any:
        return (mi.Array3f(place) - self._low) * self._scale
