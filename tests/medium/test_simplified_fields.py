"""Fields seen more simply: linear between the nodes, and a section extruded along x."""

import numpy as np
import pytest
from oracles import unit
from scipy.interpolate import RegularGridInterpolator

from virtual_sensor import IndexField, InputError, RayStatus, trace
from virtual_sensor.arrays import to_numpy, to_vectors
from virtual_sensor.engine import dr, mi
from virtual_sensor.optics.eikonal import bend, in_plane
from virtual_sensor.optics.rays import March, Straight
from virtual_sensor.optics.surfaces import NoSurface

ORIGIN = np.array([-4.0, 2.0, -3.0])
SPACING = np.array([1.5, 0.75, 1.25])
AMBIENT = 2.7e-4


def random_air(shape=(9, 6, 7), seed=1, **where):
    values = AMBIENT - 2e-4 * np.random.default_rng(seed).random(shape)
    return IndexField.from_arrays(values, ORIGIN, SPACING, ambient=AMBIENT, **where)


def within(field, count=400):
    low, high = field.box
    return low + (high - low) * np.random.default_rng(2).random((count, 3))


def derivatives(field, points, precision="double"):
    """Gradient (N, 3) and Hessian (3, 3, N)."""
    p = (mi.Array3f64 if precision == "double" else mi.Array3f)(points.T)
    _, gradient, hessian = field.lookup(precision).delta_gradient_hessian(p)
    return gradient.numpy().T, hessian.numpy()


def test_linear_is_scipys():
    """RegularGridInterpolator's value, to the nodes of the last border."""
    field = random_air()
    axes = [ORIGIN[i] + SPACING[i] * np.arange(field.shape[i]) for i in range(3)]
    scipys = RegularGridInterpolator(axes, field.nodes)
    corners = np.array([[x[i] for x in axes] for i in (0, -1)])
    points = np.vstack([within(field), corners])
    linear = field.simplified("linear")
    np.testing.assert_allclose(linear.refractivity(points), scipys(points), rtol=1e-13)
    assert abs(field.refractivity(points) - scipys(points)).max() > 1e-5


@pytest.mark.parametrize("dimensions", [2, 3])
def test_linears_gradient_is_its_own(dimensions):
    """Differences within a cell, where it is exactly linear along each axis; mixed ones too."""
    linear = random_air(mirror=(False, True, True)).simplified("linear", dimensions)
    cells = np.floor((within(linear) - ORIGIN) / SPACING)
    centres = ORIGIN + SPACING * (cells + np.random.default_rng(3).uniform(0.3, 0.7, (1, 3)))
    gradient, hessian = derivatives(linear, centres)
    for axis in range(3):
        step = 0.1 * SPACING[axis] * np.eye(3)[axis]
        sides = [linear.refractivity(centres + s * step) for s in (1.0, -1.0)]
        expected = (sides[0] - sides[1]) / (0.2 * SPACING[axis])
        np.testing.assert_allclose(gradient[:, axis], expected, rtol=0, atol=1e-15)
        np.testing.assert_allclose(linear.gradient(centres)[:, axis], expected, atol=1e-15)
        slopes = [derivatives(linear, centres + s * step)[0] for s in (1.0, -1.0)]
        curvature = (slopes[0] - slopes[1]) / (0.2 * SPACING[axis])
        np.testing.assert_allclose(hessian[:, axis].T, curvature, rtol=0, atol=1e-15)
    assert abs(hessian).max() > 1e-6


def test_linears_gradient_jumps_and_the_cubics_does_not():
    """Across a face: the simplification that has to fail."""
    field = random_air()
    face = ORIGIN + SPACING * [3.0, 2.4, 1.6]
    sides = face + np.array([[-1e-9, 0.0, 0.0], [1e-9, 0.0, 0.0]])
    for interpolation, jumps in (("linear", True), ("cubic", False)):
        gradient = field.simplified(interpolation).gradient(sides)
        assert (np.ptp(gradient, axis=0)[0] > 1e-5) == jumps


@pytest.mark.parametrize("interpolation", ["cubic", "linear"])
def test_two_dimensions_are_the_section(interpolation):
    """Of value, gradient and Hessian at x = 0, which is no node here, for every x."""
    field = random_air(mirror=(False, False, True)).simplified(interpolation)
    flat = field.simplified(interpolation, 2)
    np.testing.assert_allclose(flat.box, field.box)
    points = within(field)
    section = points * [0.0, 1.0, 1.0]
    np.testing.assert_allclose(flat.refractivity(points), field.refractivity(section), rtol=1e-13)
    gradient, hessian = derivatives(flat, points)
    there, curved = derivatives(field, section)
    np.testing.assert_allclose(gradient[:, 1:], there[:, 1:], rtol=0, atol=1e-16)
    np.testing.assert_allclose(hessian[1:, 1:], curved[1:, 1:], rtol=0, atol=1e-15)
    assert not gradient[:, 0].any()
    assert not hessian[0].any()
    assert not hessian[:, 0].any()


@pytest.mark.parametrize("precision", ["single", "double"])
@pytest.mark.parametrize("interpolation", ["cubic", "linear"])
def test_rays_through_air_that_does_not_vary_along_x_are_the_same(interpolation, precision):
    """To rounding."""
    profile = -2e-4 * np.random.default_rng(3).random((12, 11))
    field = IndexField.from_arrays(
        np.repeat(profile[None], 9, axis=0), [-40.0, -25.0, -25.0], [10.0, 5.0, 5.0], ambient=0.0
    ).simplified(interpolation)
    starts = np.array([[-12.0, 3.0, -40.0], [-10.0, -4.0, -40.0]])
    directions = [[0.1, 0.2, 1.0], [-0.2, 0.0, 1.0]]
    rays = [
        trace(air, starts, directions, 60.0, 0.5, "leapfrog", precision)
        for air in (field, field.simplified(interpolation, 2))
    ]
    assert np.all(rays[0].status == RayStatus.ENDED)
    atol = 1e-13 if precision == "double" else 1e-5
    np.testing.assert_allclose(rays[0].position, rays[1].position, rtol=0, atol=atol)


def test_rays_through_such_air_carry_their_derivatives():
    """Rationale: loops took the slope along x for a constant: an error of Dr.Jit's, no ray."""
    profile = -2e-4 * np.random.default_rng(3).random((12, 11))
    field = IndexField.from_arrays(
        np.repeat(profile[None], 9, axis=0), [-40.0, -25.0, -25.0], [10.0, 5.0, 5.0], ambient=0.0
    )

    def carried(air):
        """Derivatives (2, N, 3) of rays' ends by a start along x, and by a direction along y."""
        march = March(1.0, "leapfrog", "double")
        starts = to_vectors(np.array([[-12.0, 3.0, -20.0], [-10.0, -4.0, -20.0]]))
        line = Straight.through(starts, to_vectors(unit([[0.1, 0.2, 1.0], [-0.2, 0, 1.0]])), march)
        none = dr.zeros(march.vector, 2)
        by = (none + march.vector(1, 0, 0), none), (none, none + march.vector(0, 1, 0))
        ends = in_plane(line.direction, line.start + 40.0)
        ray = bend(air, NoSurface(), line, march, remaining=ends, tangents=by)
        return np.array([to_numpy(w) for w in ray.offset[1:]])

    whole, flat = (carried(air) for air in (field, field.simplified(dimensions=2)))
    assert np.abs(whole - carried(None)).max() > 1e-4
    np.testing.assert_allclose(flat, whole, rtol=0, atol=1e-12)


@pytest.mark.parametrize("interpolation", ["cubic", "linear"])
@pytest.mark.parametrize("dimensions", [2, 3])
def test_single_precision_is_the_same_field(interpolation, dimensions):
    """Away from faces, where rounding may put a point into the other cell."""
    field = random_air(mirror=(False, True, False)).simplified(interpolation, dimensions)
    points = within(field)
    offset = (points - ORIGIN) / SPACING
    points = points[np.all(abs(offset - np.round(offset)) > 1e-4, axis=1)]
    for one, two in zip(
        derivatives(field, points, "single"), derivatives(field, points), strict=True
    ):
        np.testing.assert_allclose(one, two, rtol=0, atol=1e-5 * abs(two).max())


def test_the_simplest_comes_back_as_it_was():
    """The choices are of interpolation: the nodes, the border and the file stay."""
    field = random_air()
    points = within(field)
    back = field.simplified("linear").simplified()
    np.testing.assert_array_equal(back.refractivity(points), field.refractivity(points))
    assert field.simplified("linear", 2).nodes is field.nodes


@pytest.mark.parametrize(
    ("choice", "message"),
    [
        ({"interpolation": "quintic"}, "interpolation is 'quintic'; take one of cubic, linear"),
        ({"dimensions": 1}, "dimensions must be a whole number from 2 to 3, not 1"),
    ],
)
def test_other_choices_are_refused(choice, message):
    with pytest.raises(InputError, match=message):
        random_air().simplified(**choice)


def test_a_field_without_a_section_is_refused():
    """Nothing to extrude, where the field does not reach x = 0."""
    beside = IndexField.from_arrays(np.zeros((4, 4, 4)), [1.0, 0.0, 0.0], SPACING)
    with pytest.raises(InputError, match=r"from x = 1 to 5.5 mm, has no section x = 0"):
        beside.simplified(dimensions=2)
