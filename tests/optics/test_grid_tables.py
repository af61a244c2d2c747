"""Interpolation in tables on grids against SciPy's splines."""

from concurrent.futures import ThreadPoolExecutor
from itertools import product

import numpy as np
import pytest
from scipy.interpolate import NdBSpline, RegularGridInterpolator, make_interp_spline

from virtual_sensor.arrays import to_vectors
from virtual_sensor.engine import dr, mi
from virtual_sensor.optics.grid_tables import Grid, LinearTable, SplineTable

RNG = np.random.default_rng(5)
NODES = (7, 5, 6)
GRID = Grid(np.array([-1.0, 20.0, 0.3]), np.array([2.0, 24.0, 0.8]), NODES)


def numbers(values):
    """Columns (N, C) of Dr.Jit arrays."""
    dr.eval(values)
    return np.array([np.array(v) for v in values], float).T


def read(table, places):
    """A linear table's functions at places (N, 3)."""
    return numbers(table.at(mi.Array3f(np.ascontiguousarray(places.T, np.float32))))


def around(grid, count, beyond=0.0):
    """Places anywhere on a grid, or also so much of its size beyond, as float32 has them."""
    size = grid.high - grid.low
    where = np.random.default_rng(count).random((count, 3))
    places = grid.low - beyond * size + where * (1.0 + 2.0 * beyond) * size
    return places.astype(np.float32).astype(float)


@pytest.fixture(scope="module")
def values():
    """Two functions at the nodes, as rough as can be."""
    return RNG.normal(size=(*NODES, 2))


@pytest.fixture(scope="module")
def table(values):
    return SplineTable(GRID, values.reshape(-1, 2))


def spline(grid, values):
    """SciPy's not-a-knot cubic spline through all nodes."""
    knots = []
    for axis, (low, high, n) in enumerate(zip(grid.low, grid.high, grid.shape, strict=True)):
        one = make_interp_spline(np.linspace(low, high, n), np.moveaxis(values, axis, 0), k=3)
        knots.append(one.t)
        values = np.moveaxis(one.c, 0, axis)
    return NdBSpline(tuple(knots), values, k=3)


def test_a_table_is_scipys_cubic_spline(table, values):
    """Rationale: other end conditions would err most in the outermost cells."""
    places = around(GRID, 1000)
    np.testing.assert_allclose(table.at(places), spline(GRID, values)(places), rtol=0, atol=1e-11)


def test_slopes_are_the_splines_derivatives(table, values):
    """Rationale: Newton's Jacobian and the light's concentration are made of them."""
    for axis in (0, 1, 2):
        expected = spline(GRID, values)(GRID.nodes(), nu=np.eye(3, dtype=int)[axis])
        _, slopes = table.with_slopes(GRID.nodes(), (axis,))
        np.testing.assert_allclose(slopes, expected, rtol=0, atol=1e-10, err_msg=f"{axis=}")


def test_any_number_of_functions_is_told_at_any_number_of_places():
    """Rationale: four of them are read at once, and Dr.Jit knows no empty array."""
    for case in product((0, 1, 700), (1, 3, 4, 5, 9)):
        count, functions = case
        values = RNG.normal(size=(*NODES, functions))
        table, places = SplineTable(GRID, values.reshape(-1, functions)), around(GRID, count)
        truth = spline(GRID, values)
        found = table.with_slopes(places)
        for order, values_found in zip([(0, 0, 0), (1, 0, 0), (0, 1, 0)], found, strict=True):
            expected = truth(places, nu=order).reshape(count, functions)
            np.testing.assert_allclose(
                values_found, expected, rtol=0, atol=1e-10, err_msg=f"{case}"
            )
        first = (functions + 1) // 2
        np.testing.assert_array_equal(
            table.at(places, first), found[0][:, :first], err_msg=f"{case}"
        )


def test_nothing_is_known_at_no_place(table):
    """Rationale: an index made of NaN must not be read."""
    places = np.vstack([around(GRID, 5), np.full(3, np.nan)])
    at = table.at(places)
    assert np.isnan(at[5]).all()
    np.testing.assert_array_equal(at[:5], table.at(places[:5]))


def test_threads_may_ask_several_tables_at_once():
    """Rationale: all share one kernel, which is recorded by the first and replayed."""
    tables = []
    for nodes in range(4, 9):
        grid = Grid(GRID.low, GRID.high, (nodes, 5, 6))
        tables.append(SplineTable(grid, RNG.normal(size=(nodes * 30, 4))))
    places = around(GRID, 5000)
    alone = [table.with_slopes(places) for table in tables]
    with ThreadPoolExecutor(4) as threads:
        together = list(threads.map(lambda table: table.with_slopes(places), 10 * tables))
    for i, found in enumerate(together):
        np.testing.assert_array_equal(found, alone[i % len(tables)])


def test_on_another_grid_the_functions_are_the_same(table):
    """Rationale: it is quicker there, and beyond the nodes the outermost cubics go on."""
    for order in ((0, 0, 0), (1, 0, 0), (0, 1, 0), (0, 0, 1)):
        low, high = np.array([-1.1, 20.0, 0.28]), np.array([2.0, 24.3, 0.8])  # some of it beyond
        other = Grid(low, high, (9, 4, 11))
        axes = tuple(np.flatnonzero(order).tolist())
        places = other.nodes()
        expected = table.with_slopes(places, axes)[-1]
        np.testing.assert_allclose(
            table.on_grid(other, order), expected, rtol=1e-9, atol=1e-9, err_msg=f"{order=}"
        )


def smooth_along(values, axis):
    """B-spline coefficients along an axis of values at the nodes."""
    spline = make_interp_spline(np.arange(NODES[axis]), np.moveaxis(values, axis, 0), k=3)
    # On uniform knots: by the values of the spline and its second derivative at the nodes.
    at = np.arange(NODES[axis], dtype=float)
    second = spline.derivative(2)(at)
    inner = spline(at) - second / 6.0
    first, last = 2.0 * inner[0] - inner[1] + second[0], 2.0 * inner[-1] - inner[-2] + second[-1]
    return np.moveaxis(np.concatenate([first[None], inner, last[None]]), 0, axis)


@pytest.mark.parametrize("cubic", [0, 1, 2])
def test_a_linear_table_is_scipys_interpolation_and_stays_as_at_its_border(values, cubic):
    """Rationale: its texels lie beside where the nodes do; what is beyond must not come round.

    Cubic along one coordinate, linear along the others.
    """
    axes = [np.linspace(*x) for x in zip(GRID.low, GRID.high, NODES, strict=True)]
    places = np.clip(around(GRID, 2000, beyond=0.2), GRID.low, GRID.high)
    along = make_interp_spline(axes[cubic], np.moveaxis(values, cubic, 0), k=3)
    others = [axis for k, axis in enumerate(axes) if k != cubic]
    beside = np.delete(places, cubic, axis=1)
    expected = [
        RegularGridInterpolator(others, along(place[cubic]))(b)[0]
        for place, b in zip(places, beside, strict=True)
    ]
    table = LinearTable(GRID, smooth_along(values, cubic), cubic)
    beyond = around(GRID, 2000, beyond=0.2)
    np.testing.assert_allclose(read(table, beyond), expected, atol=3e-5)


@pytest.mark.parametrize("tolerance", [0.3, 0.1])
def test_a_finer_linear_table_is_the_spline_to_its_tolerance(table, values, tolerance):
    """Rationale: it is the linear one that the samples read; no finer than it need be."""
    linear = table.linear(*table.finer(np.full(2, tolerance)))
    places = around(GRID, 5000)
    wrong = np.abs(read(linear, places) - spline(GRID, values)(places)).max()
    assert tolerance / 100.0 < wrong <= tolerance
    assert linear.grid.shape != GRID.shape
    assert any(n == m for n, m in zip(linear.grid.shape, GRID.shape, strict=True))


def test_a_linear_table_knows_what_it_holds(values):
    """Rationale: what is beyond it must be marched; what is on its border must not."""
    linear, size = LinearTable(GRID, smooth_along(values, 0), 0), GRID.high - GRID.low
    corners = np.stack([GRID.low, GRID.high])
    assert np.all(numbers([linear.holds(to_vectors(corners))]))
    for axis in range(3):
        step = 0.01 * np.eye(3)[axis] * size
        beyond = np.stack([GRID.low - step, GRID.high + step])
        assert not np.any(numbers([linear.holds(to_vectors(beyond))]))
