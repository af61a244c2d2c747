"""The gridded field against SciPy's splines, and against itself folded, filled and refined."""

from dataclasses import replace
from itertools import product

import numpy as np
import pytest
from scipy.interpolate import NdBSpline, make_interp_spline

from virtual_sensor.engine import dr, mi
from virtual_sensor.errors import InputError
from virtual_sensor.medium import lookups
from virtual_sensor.medium.index_field import IndexField, fill_solid

ORIGIN = np.array([-4.0, 2.0, 10.0])
SPACING = np.array([0.5, 0.75, 1.25])
AMBIENT = 2.7e-4


def scipy_spline(values, origin, spacing):
    """SciPy's tensor product of not-a-knot cubic splines through the values."""
    knots, coefficients = [], values
    for axis in range(3):
        x = origin[axis] + spacing[axis] * np.arange(values.shape[axis])
        spline = make_interp_spline(x, coefficients, k=3, axis=axis)
        knots.append(spline.t)
        coefficients = np.moveaxis(spline.c, 0, axis) if axis else spline.c
    return NdBSpline(tuple(knots), coefficients, k=3)


@pytest.fixture(scope="module")
def rough():
    """Random values on a small grid of unequal sides, at some distance from ambient."""
    rng = np.random.default_rng(1)
    return AMBIENT - 2e-4 * rng.random((9, 4, 7))


@pytest.fixture(scope="module")
def field(rough):
    return IndexField.from_arrays(rough, ORIGIN, SPACING, ambient=AMBIENT)


@pytest.fixture(scope="module")
def points(field):
    low, high = field.box
    return low + (high - low) * np.random.default_rng(2).random((500, 3))


def nodes_of(field):
    index = np.indices(field.shape).reshape(3, -1).T
    return field.origin + index * field.spacing


def test_the_nodes_keep_their_values(field, rough):
    """An interpolating spline, border nodes included: B-splines as such only approximate."""
    np.testing.assert_allclose(field.refractivity(nodes_of(field)), rough.ravel(), rtol=1e-13)


def test_value_and_gradient_are_scipys(field, rough, points):
    """SciPy's ends are not-a-knot too, so the two are one and the same function."""
    reference = scipy_spline(rough, ORIGIN, SPACING)
    np.testing.assert_allclose(field.refractivity(points), reference(points), rtol=1e-12)
    expected = np.transpose([reference(points, nu=nu) for nu in np.eye(3, dtype=int)])
    np.testing.assert_allclose(field.gradient(points), expected, atol=1e-12 * abs(expected).max())


def test_hessian_is_scipys(field, rough, points):
    """All nine entries, so that no axis is exchanged for another."""
    reference = scipy_spline(rough, ORIGIN, SPACING)
    axes = np.eye(3, dtype=int)
    expected = np.array([[reference(points, nu=i + j) for j in axes] for i in axes])
    value, gradient, hessian = field.lookup("double").delta_gradient_hessian(mi.Array3f64(points.T))
    np.testing.assert_allclose(hessian.numpy(), expected, atol=1e-11 * abs(expected).max())
    np.testing.assert_allclose(AMBIENT + value.numpy(), field.refractivity(points), rtol=1e-13)
    np.testing.assert_allclose(gradient.numpy().T, field.gradient(points), rtol=0, atol=1e-16)


def test_nothing_jumps_between_cells(field):
    """Value, gradient and Hessian agree from both sides of every interior node."""
    inner = nodes_of(field).reshape(*field.shape, 3)[1:-1, 1:-1, 1:-1].reshape(-1, 3)
    sides = [
        field.lookup("double").delta_gradient_hessian(mi.Array3f64((inner + shift).T))
        for shift in (-1e-10, 1e-10)
    ]
    for left, right in zip(*sides, strict=True):
        left, right = left.numpy(), right.numpy()
        np.testing.assert_allclose(left, right, atol=1e-8 * abs(left).max())


def test_a_mirrored_field_is_the_unfolded_one(points):
    """Folding changes signs of the gradient and of mixed second derivatives, nothing else."""
    rng = np.random.default_rng(3)
    half = 1e-4 * rng.random((6, 7, 5))
    folded = IndexField.from_arrays(half, ORIGIN, SPACING, ambient=0.0, mirror=(True, False, True))
    whole = np.concatenate((half[:0:-1], half), axis=0)
    whole = np.concatenate((whole[:, :, :0:-1], whole), axis=2)
    first = ORIGIN - SPACING * [5, 0, 4]
    unfolded = IndexField.from_arrays(whole, first, SPACING, ambient=0.0)

    np.testing.assert_allclose(folded.box, unfolded.box)
    low, high = folded.box
    p = mi.Array3f64((low + (high - low) * rng.random((400, 3))).T)
    results = (f.lookup("double").delta_gradient_hessian(p) for f in (folded, unfolded))
    for a, b in zip(*results, strict=True):
        np.testing.assert_allclose(a.numpy(), b.numpy(), atol=1e-12 * abs(b.numpy()).max())


def test_single_precision_is_the_same_field(field, points):
    """What float32 costs: a few units in its last place of the largest value or derivative."""
    exact = field.lookup("double").delta_gradient_hessian(mi.Array3f64(points.T))
    single = field.lookup("single").delta_gradient_hessian(mi.Point3f(points.T))
    assert isinstance(single[0], mi.Float)
    assert isinstance(single[1], mi.Point3f)
    for a, b in zip(single, exact, strict=True):
        np.testing.assert_allclose(a.numpy(), b.numpy(), atol=1e-5 * abs(b.numpy()).max())


def test_all_lookups_give_the_same_value(field, points):
    """The march takes the value with or without derivatives."""
    lookup, p = field.lookup("double"), mi.Array3f64(points.T)
    with_gradient, _ = lookup.delta_and_gradient(p)
    np.testing.assert_allclose(lookup.delta(p).numpy(), with_gradient.numpy(), atol=1e-18)


@pytest.mark.parametrize("precision", ["single", "double"])
def test_a_large_field_takes_less_memory_and_gives_the_same(field, points, monkeypatch, precision):
    """Coefficients that are stored once are read one by one, not four by four."""
    vector = mi.Array3f64 if precision == "double" else mi.Array3f
    packed = field.lookup(precision).delta_gradient_hessian(vector(points.T))
    monkeypatch.setattr(lookups, "MOST_PACKED", 0)
    large = replace(field, _lookups={}).lookup(precision).delta_gradient_hessian(vector(points.T))
    for a, b in zip(packed, large, strict=True):
        np.testing.assert_array_equal(a.numpy(), b.numpy())


def test_beyond_the_border_it_goes_over_into_a_constant(field):
    """A first-order ray asks there: the field runs on smoothly and ends within three cells."""
    low, high = field.box
    middle = low + (high - low) * [0.4, 0.6, 0.3]
    for axis, (side, outward) in product(range(3), enumerate((-1.0, 1.0))):
        cells = np.array([-1e-9, 1e-9, 0.5, 1.5, 3.0, 3.5, 400.0])[:, None]
        places = np.repeat(middle[None], len(cells), axis=0)
        places[:, axis] = (field.box[side, axis] + outward * cells * SPACING[axis])[:, 0]
        delta, gradient = field.lookup("double").delta_and_gradient(mi.Array3f64(places.T))
        delta, gradient = delta.numpy(), gradient.numpy().T
        np.testing.assert_allclose(gradient[0], gradient[1], atol=1e-12)
        np.testing.assert_allclose(delta[4:], delta[4], rtol=1e-14)
        np.testing.assert_allclose(gradient[4:, axis], 0.0, atol=1e-18)


def test_a_symbolic_loop_can_look_up(field):
    """Walking uphill in a recorded loop ends where the same walk in NumPy does."""
    start = field.box.mean(axis=0) + np.array([[0.1, 0.2, 0.3], [-0.3, 0.4, 0.2]])
    step = 100.0  # mm^2
    lookup = field.lookup("double")

    def uphill(i, p):
        return i + 1, p + step * lookup.delta_and_gradient(p)[1]

    _, end = dr.while_loop(
        (mi.UInt32(0), mi.Array3f64(start.T)), lambda i, p: i < 20, uphill, mode="symbolic"
    )
    walked = start
    for _ in range(20):
        walked = walked + step * field.gradient(walked)
    np.testing.assert_allclose(end.numpy().T, walked, atol=1e-12)
    assert abs(walked - start).max() > 0.01


def test_refining_the_grid_converges_with_order_four():
    """Right up to the border, which simpler end conditions would spoil."""

    def error(n):
        x = np.linspace(-1.0, 1.0, n)
        grid = np.meshgrid(x, x, x, indexing="ij")
        values = np.exp(-(grid[0] ** 2)) * np.cos(grid[1] + 2.0 * grid[2])
        f = IndexField.from_arrays(0.1 * values, 3 * [-1.0], 3 * [2.0 / (n - 1)], ambient=0.0)
        p = np.random.default_rng(4).uniform(-1.0, 1.0, (4000, 3))
        exact = 0.1 * np.exp(-(p[:, 0] ** 2)) * np.cos(p[:, 1] + 2.0 * p[:, 2])
        return abs(f.refractivity(p) - exact).max()

    coarse, fine = error(17), error(33)
    assert np.log2(coarse / fine) == pytest.approx(4.0, abs=0.3)


def test_outside_the_box_the_air_is_uniform(field):
    """Ambient refractivity and no gradient there; no answer for a position that is none."""
    outside = np.array([[100.0, 0.0, 0.0], [-4.01, 3.0, 12.0], [np.nan, 3.0, 12.0]])
    np.testing.assert_array_equal(field.refractivity(outside), [AMBIENT, AMBIENT, np.nan])
    np.testing.assert_array_equal(field.gradient(outside)[:2], np.zeros((2, 3)))
    assert np.isnan(field.gradient(outside)[2]).all()
    assert field.refractivity(np.empty((0, 3))).shape == (0,)


def test_the_border_jump_is_told_per_face():
    """One node off ambient on one face, and a mirrored axis whose low face is the high one's."""
    values = np.zeros((5, 5, 5))
    values[2, 4, 2], values[4, 2, 2], values[0, 2, 2], values[2, 2, 0] = 1e-6, 2e-6, 9e-6, -3e-6
    jump = IndexField.from_arrays(
        values, 3 * [0], 3 * [1], ambient=0.0, mirror=(True, False, False)
    )
    np.testing.assert_array_equal(jump.border_jump(), [2e-6, 2e-6, 0.0, 1e-6, 3e-6, 0.0])


def test_the_field_keeps_its_own_copy():
    """Changing the array afterwards must not change the field, whose tables are made later."""
    values = np.zeros((4, 4, 4))
    kept = IndexField.from_arrays(values, 3 * [0], 3 * [1])
    values[:] = 1.0
    assert kept.refractivity([[1.5, 1.5, 1.5]]) == 0.0
    assert kept.lookup("double") is kept.lookup("double")


def test_the_border_s_one_value_is_the_ambient_air_s():
    """A forgotten `ambient` is no vacuum; a plane of symmetry is no border."""
    values = np.full((5, 5, 5), 2.7e-4)
    values[:3, 2, 2] = 1e-4
    found = IndexField.from_arrays(values, 3 * [0], 3 * [1], mirror=(True, False, False))
    assert (found.ambient, found.border_jump().max()) == (2.7e-4, 0.0)


def test_the_solid_is_filled_smoothly_from_the_air():
    """Air as it was, no new extremes, no step at the wall, no seam across the middle."""
    x, _, z = np.meshgrid(*3 * [np.linspace(-3.0, 3.0, 25)], indexing="ij")
    solid = x**2 + z**2 < 1.5**2
    air = 1e-4 * np.tanh(x + 0.3 * z)
    nodes = np.where(solid, np.nan, air)
    filled = fill_solid(nodes, solid, np.array(3 * [0.25]))

    np.testing.assert_array_equal(filled[~solid], air[~solid])
    assert air[~solid].min() <= filled[solid].min() < filled[solid].max() <= air[~solid].max()
    # The nearest air alone leaves steps of twice the wall's value where left meets right.
    steepest = max(abs(np.diff(air, axis=axis)).max() for axis in range(3))
    for axis in range(3):
        assert abs(np.diff(filled, axis=axis)).max() < 1.5 * steepest


def test_steel_in_the_solid_does_not_reach_the_air():
    """Whatever stands inside the solid, number or NaN, the field around it is the same."""
    rng = np.random.default_rng(5)
    values = 1e-4 * rng.random((8, 8, 8))
    solid = np.zeros((8, 8, 8), dtype=bool)
    solid[3:6, :, :4] = True
    fields = [
        IndexField.from_arrays(
            np.where(solid, inside, values), 3 * [0], 3 * [1], ambient=0.0, solid=solid
        )
        for inside in (np.nan, 0.5)
    ]
    np.testing.assert_array_equal(fields[0].nodes, fields[1].nodes)


@pytest.mark.parametrize(
    ("changes", "message"),
    [
        ({"refractivity": np.zeros((4, 4))}, "at least 4 nodes"),
        ({"refractivity": np.zeros((3, 4, 4))}, "at least 4 nodes"),
        ({"refractivity": np.full((4, 4, 4), np.nan)}, "64 nodes have no finite value"),
        ({"refractivity": np.full((4, 4, 4), -1.5)}, "outside -1 to 0.9; give n - 1"),
        ({"refractivity": np.full((4, 4, 4), 600.0)}, "is 600 at node .* no temperature"),
        ({"refractivity": np.full((4, 4, 4), 1.00027)}, "not n"),
        ({"refractivity": np.linspace(0.0, 2e-4, 64).reshape(4, 4, 4)}, "ambient is missing"),
        ({"origin_mm": [0.0, 0.0]}, "three entries"),
        ({"origin_mm": [0.0, np.inf, 0.0]}, "origin_mm must be finite"),
        ({"spacing_mm": [1.0, -1.0, 1.0]}, "positive"),
        ({"mirror": (True,)}, "three entries"),
        ({"ambient": np.nan}, "surrounding air"),
        ({"solid": np.ones((4, 4, 4), dtype=bool)}, "leave some air"),
        ({"solid": np.ones((4, 4, 3), dtype=bool)}, "field's shape"),
    ],
)
def test_unfit_arrays_are_refused(changes, message):
    """Each message says which argument and what it should be."""
    fit = {"refractivity": np.zeros((4, 4, 4)), "origin_mm": 3 * [0.0], "spacing_mm": 3 * [1.0]}
    with pytest.raises(InputError, match=message):
        IndexField.from_arrays(**(fit | changes))


def test_unfit_questions_are_refused(field):
    """A transposed array of points and an unknown precision."""
    with pytest.raises(InputError, match=r"shape \(N, 3\)"):
        field.refractivity(np.zeros((3, 5)))
    with pytest.raises(InputError, match="'single' or 'double'"):
        field.lookup("half")
