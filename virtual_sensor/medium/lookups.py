"""A field's nodes in Dr.Jit: value, gradient and Hessian between them, cubic and linear.

Positions are world positions *inside the box*, mm, in vectors of the lookup's precision
(`mi.Array3f64` for double, `mi.Vector3f` or the like for single). The methods only trace, so
symbolic loops may call them; the derivatives cannot themselves be differentiated.
"""

from __future__ import annotations

from abc import ABC, abstractmethod
from collections.abc import Sequence
from itertools import product
from typing import Any

import numpy as np

from virtual_sensor.arrays import in_own_memory
from virtual_sensor.engine import dr, mi
from virtual_sensor.errors import InputError
from virtual_sensor.medium.spline import bspline_coefficients


class GridLookup(ABC):
    """What the lookups have in common.

    Parameters
    ----------
    difference : ndarray of shape (nx, ny, nz), or (ny, nz)
        n - n_ambient at the nodes.
    origin, spacing : ndarray of shape (3,)
        World position of the first node and distance of nodes, mm.
    mirror : sequence of three bool
        The field is even about the plane through an axis's first node.
    axes : tuple of int
        World axes of `difference`; the field does not vary along the one that is left out.
    precision : str
        "single" or "double".
    """

    def __init__(
        self,
        difference: np.ndarray,
        origin: np.ndarray,
        spacing: np.ndarray,
        mirror: Sequence[bool],
        axes: tuple[int, ...],
        precision: str,
    ) -> None:
        if precision not in ("single", "double"):
            raise InputError(f"precision '{precision}': give 'single' or 'double'")
        double = precision == "double"
        self._scalar = mi.Float64 if double else mi.Float
        self._vector = mi.Array3f64 if double else mi.Array3f
        self._matrix = mi.Matrix3f64 if double else mi.Matrix3f
        flat = mi.Array2f64 if double else mi.Array2f
        self._grid_vector = self._vector if len(axes) == 3 else flat
        self._axes = axes
        self._mirror = [mirror[i] for i in axes]
        self._origin = self._opaque(origin[list(axes)])
        self._take(difference, spacing[list(axes)])

    @abstractmethod
    def _take(self, difference: np.ndarray, spacing: np.ndarray) -> None:
        """Bring the nodes into Dr.Jit's memory; spacing is that of the axes."""

    @abstractmethod
    def delta(self, p: Any) -> Any:
        """Return n - n_ambient at `p`."""

    @abstractmethod
    def delta_and_gradient(self, p: Any) -> tuple[Any, Any]:
        """Return n - n_ambient and its gradient, 1/mm, in a vector of `p`'s type."""

    @abstractmethod
    def delta_gradient_hessian(self, p: Any) -> tuple[Any, Any, Any]:
        """Return n - n_ambient, its gradient (1/mm) and its 3 x 3 Hessian matrix (1/mm^2)."""

    def _opaque(self, numbers: np.ndarray) -> Any:
        """Numbers for the axes, which compile no kernel of their own."""
        return dr.opaque(self._grid_vector(*np.asarray(numbers, dtype=np.float64).tolist()))

    def _on_grid(self, p: Any, scale: Any, first: Any) -> tuple[Any, Any]:
        """Coordinates on the grid, and their derivative by the world coordinates."""
        q = self._vector(p)
        q = self._grid_vector(*(q[i] for i in self._axes)) - self._origin
        scale = self._grid_vector(scale)
        for i, even in enumerate(self._mirror):
            if even:
                scale[i] = dr.mulsign(scale[i], q[i])
        return dr.fma(q, scale, first), scale

    def _in_world(self, p: Any, gradient: Any, scale: Any) -> Any:
        """Gradient by world coordinates, in a vector of `p`'s type."""
        world = [self._scalar(0.0)] * 3
        for i, axis in enumerate(self._axes):
            world[axis] = gradient[i] * scale[i]
        return type(p)(*world)

    def _matrix_in_world(self, hessian: Any, scale: Any) -> Any:
        rows = [[self._scalar(0.0)] * 3 for _ in range(3)]
        for (i, row), (j, column) in product(enumerate(self._axes), repeat=2):
            rows[row][column] = hessian[i, j] * scale[i] * scale[j]
        return self._matrix(rows)


class CubicLookup(GridLookup):
    """The cubic spline through the nodes: continuous up to the second derivative."""

    def _take(self, difference: np.ndarray, spacing: np.ndarray) -> None:
        # Texels are one coefficient wider than the nodes at either end; the last index is x.
        coefficients = bspline_coefficients(difference, self._mirror).T
        double = self._scalar is mi.Float64
        tensor = mi.TensorXf64 if double else mi.TensorXf
        texture = {
            (3, True): mi.Texture3d,
            (3, False): mi.Texture3f,
            (2, True): mi.Texture2d,
            (2, False): mi.Texture2f,
        }[difference.ndim, double]
        values = tensor(in_own_memory(coefficients, self._scalar), (*coefficients.shape, 1))
        self._texture = texture(values, use_accel=False)

        # Texel centres are at (i + 1/2) / N and node 0 is texel 1. Opaque: one kernel for any grid.
        texels = np.array(difference.shape) + 2
        self._scale, self._first = map(self._opaque, (1.0 / (texels * spacing), 1.5 / texels))

    def delta(self, p: Any) -> Any:
        """See `GridLookup`."""
        u, _ = self._on_grid(p, self._scale, self._first)
        return self._texture.eval_cubic(u)[0]

    def delta_and_gradient(self, p: Any) -> tuple[Any, Any]:
        """See `GridLookup`."""
        u, scale = self._on_grid(p, self._scale, self._first)
        value, gradient = self._texture.eval_cubic_grad(u)
        return value[0], self._in_world(p, gradient[0], scale)

    def delta_gradient_hessian(self, p: Any) -> tuple[Any, Any, Any]:
        """See `GridLookup`."""
        u, scale = self._on_grid(p, self._scale, self._first)
        value, gradient, hessian = self._texture.eval_cubic_hessian(u)
        in_world = self._in_world(p, gradient[0], scale)
        return value[0], in_world, self._matrix_in_world(hessian[0], scale)


class LinearLookup(GridLookup):
    """Linear interpolation along each axis: continuous, with a gradient that jumps."""

    def _take(self, difference: np.ndarray, spacing: np.ndarray) -> None:
        self._nodes = in_own_memory(difference, self._scalar)
        self._scale = self._opaque(1.0 / spacing)
        self._last = dr.opaque(
            dr.int32_array_t(self._grid_vector)(*(n - 2 for n in difference.shape))
        )
        strides = np.cumprod([1, *difference.shape[:0:-1]])[::-1].tolist()
        self._strides = [dr.opaque(mi.UInt32, stride) for stride in strides]

    def delta(self, p: Any) -> Any:
        """See `GridLookup`."""
        return self.delta_and_gradient(p)[0]

    def delta_and_gradient(self, p: Any) -> tuple[Any, Any]:
        """See `GridLookup`."""
        value, gradient, _ = self.delta_gradient_hessian(p)
        return value, gradient

    def delta_gradient_hessian(self, p: Any) -> tuple[Any, Any, Any]:
        """See `GridLookup`.  The Hessian within a cell: zero but for its mixed derivatives."""
        u, scale = self._on_grid(p, self._scale, self._grid_vector(0.0))
        cell = dr.clip(type(self._last)(dr.floor(u)), 0, self._last)
        within = u - self._grid_vector(cell)
        axes = range(len(self._axes))
        first = sum(mi.UInt32(cell[i]) * self._strides[i] for i in axes)
        weights = [(1.0 - within[i], within[i]) for i in axes]
        slopes = (-1.0, 1.0)
        value, gradient = self._scalar(0.0), self._grid_vector(0.0)
        hessian = self._matrix(0.0)  # the corner of it that the axes take
        for corner in product((0, 1), repeat=len(axes)):
            at = first + sum(self._strides[i] for i in axes if corner[i])
            node = dr.gather(self._scalar, self._nodes, at)
            value = value + node * dr.prod([weights[i][corner[i]] for i in axes])
            for i in axes:
                others = [weights[k][corner[k]] for k in axes if k != i]
                gradient[i] += node * slopes[corner[i]] * dr.prod(others)
                for j in range(i):
                    rest = [weights[k][corner[k]] for k in axes if k not in (i, j)]
                    mixed = node * slopes[corner[i]] * slopes[corner[j]] * dr.prod([1.0, *rest])
                    hessian[i, j] += mixed
                    hessian[j, i] += mixed
        return (
            value,
            self._in_world(p, gradient, scale),
            self._matrix_in_world(hessian, scale),
        )


LOOKUPS: dict[str, type[GridLookup]] = {"cubic": CubicLookup, "linear": LinearLookup}
"""By the name of the interpolation."""
