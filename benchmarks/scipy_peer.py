"""SciPy: solve_ivp through a cubic spline, ray by ray or all rays in one state."""

from __future__ import annotations

from collections.abc import Callable

import numpy as np
from numpy.typing import NDArray
from problem import Grid, Peer, Problem
from scipy.integrate import solve_ivp
from scipy.interpolate import NdBSpline, RegularGridInterpolator, make_interp_spline

Array = NDArray[np.float64]
Index = Callable[[Array], tuple[Array, Array]]
"""Points (N, 3) to n (N,) and grad n (N, 3), 1/mm."""


def spline_index(grid: Grid) -> Index:
    """The tensor product of SciPy's not-a-knot splines through the nodes."""
    values, origin = grid.unfolded()
    knots = []
    for axis in range(3):
        x = origin[axis] + grid.spacing[axis] * np.arange(values.shape[axis])
        spline = make_interp_spline(x, np.moveaxis(values, axis, 0), k=3)
        knots.append(spline.t)
        values = np.moveaxis(spline.c, 0, axis)
    spline = NdBSpline(tuple(knots), np.ascontiguousarray(values), k=3)

    def index(p: Array) -> tuple[Array, Array]:
        gradient = np.stack([spline(p, nu=nu) for nu in np.eye(3, dtype=int)], axis=-1)
        return 1.0 + spline(p), gradient

    return index


def linear_index(grid: Grid) -> Index:
    """Node gradients by differences, interpolated linearly: what most tracers of grids do."""
    values, origin = grid.unfolded()
    nodes = [origin[i] + grid.spacing[i] * np.arange(values.shape[i]) for i in range(3)]
    four = np.stack([values, *np.gradient(values, *grid.spacing)], axis=-1)
    interpolate = RegularGridInterpolator(nodes, four, bounds_error=False, fill_value=0.0)

    def index(p: Array) -> tuple[Array, Array]:
        found = interpolate(p)
        return 1.0 + found[:, 0], found[:, 1:]

    return index


def all_rays(method: str, index_of: Callable[[Grid], Index]) -> Callable[..., Callable[[], Array]]:
    """All rays in one state vector, whose error norm they share."""

    def prepare(problem: Problem, rtol: float) -> Callable[[], Array]:
        index = index_of(problem.grid)

        def work() -> Array:
            # Of t / length, so that all rays arrive at once; what is solved for is the difference
            # from the straight rays, which needs no digits for the distance to the sensor.
            d, lengths = problem.directions, problem.lengths[:, None]

            def slope(s: float, state: Array) -> Array:
                offset, tau = state.reshape(2, -1, 3)
                n, gradient = index(problem.starts + d * (s * lengths) + offset)
                return np.stack([tau * lengths, gradient * n[:, None] * lengths]).ravel()

            tau = (index(problem.starts)[0] - 1.0)[:, None] * d
            start = np.stack([np.zeros_like(tau), tau]).ravel()
            found = solve_ivp(slope, (0.0, 1.0), start, method, rtol=rtol, atol=rtol * 0.1)
            offset, tau = found.y[:, -1].reshape(2, -1, 3)
            return problem.in_plane(problem.starts + d * lengths + offset, d + tau)

        return work

    return prepare


def ray_by_ray(
    method: str, index_of: Callable[[Grid], Index]
) -> Callable[..., Callable[[], Array]]:
    """A call of solve_ivp for each ray."""

    def prepare(problem: Problem, rtol: float) -> Callable[[], Array]:
        index = index_of(problem.grid)
        alone = all_rays(method, lambda grid: index)
        each = [alone(problem.part([i]), rtol) for i in range(len(problem))]
        return lambda: np.concatenate([work() for work in each])

    return prepare


RTOL = tuple(10.0 ** (-0.5 * k) for k in range(4, 19))  # 1e-2 to 1e-9


def peers() -> list[Peer]:
    """Orders 5 and 8, in both forms, and what linear gradients come to."""
    found = []
    for method in ("RK45", "DOP853"):
        together, alone = all_rays(method, spline_index), ray_by_ray(method, spline_index)
        for words, prepare, rays in (("all rays in one state", together, 1000),
                                     ("ray by ray", alone, 20)):  # fmt: skip
            name = f"SciPy {method}, {words}"
            judged = min(rays, 200)
            found.append(Peer(name, "cubic spline", RTOL, "rtol", prepare, rays, judged))
    linear = all_rays("RK45", linear_index)
    name = "SciPy RK45, linear gradients"
    found.append(Peer(name, "linear gradients", RTOL[2::4], "rtol", linear, 200, 200))
    return found
