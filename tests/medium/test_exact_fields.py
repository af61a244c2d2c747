"""Closed-form fields: their derivatives against differences, their values where they are known."""

import numpy as np
import pytest

from virtual_sensor.engine import mi
from virtual_sensor.medium.exact_fields import fish_eye, hot_spot, linear, luneburg, selfoc

FIELDS = {
    "linear": linear(1.3, (0.01, -0.02, 0.005)),
    "selfoc": selfoc(1.5, 0.02),
    "fish_eye": fish_eye(1.8, 15.0),
    "luneburg": luneburg(20.0),
    "hot_spot": hot_spot(0.3, 6.0),
}


@pytest.fixture(params=FIELDS)
def field(request):
    return FIELDS[request.param]


@pytest.fixture(scope="module")
def points():
    return np.random.default_rng(1).uniform(-10.0, 10.0, (50, 3))


def look(field, points):
    """Value, gradient (N, 3) and Hessian (N, 3, 3) in float64."""
    f, g, hessian = field.delta_gradient_hessian(mi.Array3f64(points.T))
    return f.numpy(), g.numpy().T, np.moveaxis(hessian.numpy(), -1, 0)


def by_differences(function, points, h=1e-3):
    """Central differences of order 4 along x, y and z, as the last axis."""
    steps = h * np.eye(3)
    return np.stack(
        [
            (8.0 * (function(points + e) - function(points - e)))
            - (function(points + 2.0 * e) - function(points - 2.0 * e))
            for e in steps
        ],
        axis=-1,
    ) / (12.0 * h)


def test_gradient_is_the_values_derivative(field, points):
    """Numerical differences of n - 1 know nothing of the rules of differentiation."""
    expected = by_differences(lambda p: look(field, p)[0], points)
    np.testing.assert_allclose(look(field, points)[1], expected, rtol=0, atol=1e-11)


def test_hessian_is_the_gradients_derivative(field, points):
    """All nine entries, which the derivatives carried along a ray depend on."""
    expected = by_differences(lambda p: look(field, p)[1], points)
    np.testing.assert_allclose(look(field, points)[2], expected, rtol=0, atol=1e-11)


@pytest.mark.parametrize("precision", ["double", "single"])
def test_both_lookups_give_the_same(field, points, precision):
    """The march takes the Hessian only where derivatives travel along; types follow the points."""
    vector, scalar = (mi.Array3f64, mi.Float64) if precision == "double" else (mi.Array3f, mi.Float)
    p = vector(points.T)
    value, gradient = field.lookup(precision).delta_and_gradient(p)
    assert isinstance(value, scalar)
    assert isinstance(gradient, vector)
    exact = look(field, points)
    tolerance = 1e-15 if precision == "double" else 1e-6
    np.testing.assert_allclose(value.numpy(), exact[0], rtol=0, atol=tolerance)
    np.testing.assert_allclose(gradient.numpy().T, exact[1], rtol=0, atol=tolerance)


@pytest.mark.parametrize(
    ("name", "point", "n"),
    [
        ("linear", [0.0, 0.0, 0.0], 1.3),
        ("linear", [100.0, 50.0, 0.0], 1.3),  # along g nothing changes: 0.01 * 100 = 0.02 * 50
        ("selfoc", [77.0, 0.0, 0.0], 1.5),  # the fibre's axis
        ("selfoc", [-3.0, 30.0, 40.0], 0.0),  # where a rho = 1
        ("fish_eye", [0.0, 0.0, 0.0], 1.8),
        ("fish_eye", [0.0, 9.0, 12.0], 0.9),  # half of n0 at r = a
        ("luneburg", [0.0, 0.0, 0.0], np.sqrt(2.0)),
        ("luneburg", [0.0, 12.0, 16.0], 1.0),  # matched to vacuum on the rim
        ("hot_spot", [0.0, 0.0, 0.0], np.sqrt(0.7)),
        ("hot_spot", [0.0, 0.0, 60.0], 1.0),
    ],
)
def test_index_where_everybody_knows_it(name, point, n):
    """Axes, centres and rims as the fields' definitions name them; ambient is vacuum."""
    value, _ = FIELDS[name].delta_and_gradient(mi.Array3f64(point))
    assert value.numpy()[0] == pytest.approx(n - 1.0, abs=1e-12)
    assert FIELDS[name].ambient == 0.0
