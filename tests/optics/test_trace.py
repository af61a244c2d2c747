"""Traced rays against closed forms and SciPy: order of convergence, foci, and the odd cases."""

import math

import numpy as np
import oracles
import pytest
from oracles import unit

import virtual_sensor as vs
from virtual_sensor import IndexField, InputError, RayStatus, trace
from virtual_sensor.arrays import to_numpy, to_vectors
from virtual_sensor.engine import mi
from virtual_sensor.medium.exact_fields import fish_eye, hot_spot, linear, luneburg, selfoc
from virtual_sensor.optics.eikonal import March, Straight, bend, in_plane
from virtual_sensor.optics.steppers import STEPPERS
from virtual_sensor.optics.surfaces import NoSurface

BOX = np.array([[-40.0] * 3, [40.0] * 3])
STARTS = np.array([[-12.0, 3.0, 1.0], [-10.0, -4.0, 5.0], [-11.0, 0.5, -6.0]])
DIRECTIONS = unit([[1.0, 0.2, -0.1], [1.0, 0.0, 0.3], [1.0, -0.3, 0.2]])


# ------------------------------------------------------------- order of convergence, closed forms


def ends_of_paths(paths, length):
    """Positions, directions and optical paths of closed-form paths after an arc."""
    times = [path.t_at_arc(length) for path in paths]
    positions, tangents, optical = zip(
        *[
            (p.position(t), p.tangent(t), p.optical_path(t))
            for p, t in zip(paths, times, strict=True)
        ],
        strict=True,
    )
    return np.array(positions), unit(tangents), np.array(optical)


def in_selfoc():
    """Two skew rays, and a helix: T_phi = omega rho, at rho = 10 round the axis."""
    n0, a = 1.5, 0.03
    omega = n0 * a
    T_x = np.sqrt(n0**2 - 2.0 * (omega * 10.0) ** 2)
    starts = np.vstack([STARTS[:2], [0.0, 10.0, 0.0]])
    directions = np.vstack([DIRECTIONS[:2], unit([T_x, 0.0, omega * 10.0])])
    length = 60.0
    paths = [
        oracles.parabolic(n0, [0.0, omega, omega], r0, d)
        for r0, d in zip(starts, directions, strict=True)
    ]
    field = selfoc(n0, a, box=np.array([[-20.0, -20, -20], [100.0, 20, 20]]))
    return field, starts, directions, length, ends_of_paths(paths, length), 2.4


def in_luneburg():
    omega = [1 / 20.0] * 3
    rays = zip(STARTS, DIRECTIONS, strict=True)
    paths = [oracles.parabolic(math.sqrt(2.0), omega, r0, d) for r0, d in rays]
    field = luneburg(20.0, box=np.array([[-28.0] * 3, [28.0] * 3]))
    return field, STARTS, DIRECTIONS, 25.0, ends_of_paths(paths, 25.0), 1.2


def in_fish_eye():
    ends = [
        oracles.fish_eye(1.8, 15.0, r0, d, 25.0) for r0, d in zip(STARTS, DIRECTIONS, strict=True)
    ]
    expected = tuple(np.array(column) for column in zip(*ends, strict=True))
    return fish_eye(1.8, 15.0, box=BOX), STARTS, DIRECTIONS, 25.0, expected, 0.6


def in_hot_spot():
    """No closed form for the path, so SciPy's method of order 8 to nearly its last digit."""

    def index(p):
        dip = 0.3 * np.exp(-np.sum(p**2, axis=1) / 128.0)
        n = np.sqrt(1.0 - dip)
        return n, p * (dip / 128.0 / n)[:, None]

    rays = oracles.integrate(index, STARTS, DIRECTIONS, 25.0, rtol=1e-13)
    expected = rays.position(25.0), rays.direction(25.0), rays.optical_path(25.0)
    return hot_spot(0.3, 8.0, box=BOX), STARTS, DIRECTIONS, 25.0, expected, 1.2


CASES = {
    "selfoc": in_selfoc,
    "luneburg": in_luneburg,
    "fish_eye": in_fish_eye,
    "hot_spot": in_hot_spot,
}


@pytest.fixture(scope="module", params=CASES)
def case(request):
    """Field, starts, directions, arc length, the known ends, and a step that is small enough."""
    return CASES[request.param]()


@pytest.mark.parametrize(("method", "order"), [("rk4", 4), ("sharma", 4), ("leapfrog", 2)])
def test_the_error_falls_with_the_methods_order(case, method, order):
    """Of position and of optical path: the fitted log-log slopes are within 0.2 of the order."""
    field, starts, directions, length, expected, coarsest = case
    steps = coarsest / 2.0 ** np.arange(4)
    errors = []
    for step in steps:
        rays = trace(field, starts, directions, length, step, method)
        assert np.all(rays.status == RayStatus.ENDED)
        errors.append(
            [
                np.linalg.norm(rays.position - expected[0]),
                np.linalg.norm(rays.optical_path_mm - expected[2]),
            ]
        )
    slopes = np.polyfit(np.log(steps), np.log(errors), 1)[0]
    np.testing.assert_allclose(slopes, order, rtol=0, atol=0.2)
    assert np.max(errors[-1]) < (1e-7 if order == 4 else 1e-2)
    error = np.abs(rays.direction - expected[1]).max()
    assert error < (1e-9 if order == 4 else 1e-4)


def test_a_helix_stays_a_helix():
    """A skew ray with T_phi = omega rho keeps its distance from the fibre's axis."""
    field, starts, directions, *_ = in_selfoc()
    lengths = np.linspace(1.0, 99.0, 30)
    rays = trace(field, np.tile(starts[2], (30, 1)), np.tile(directions[2], (30, 1)), lengths, 0.2)
    np.testing.assert_allclose(np.hypot(*rays.position[:, 1:].T), 10.0, rtol=0, atol=1e-6)
    assert np.ptp(rays.position[:, 1]) > 19.0  # and it does go round


@pytest.mark.parametrize("method", sorted(STEPPERS.keys() - {"euler"}))
def test_parabolas_are_exact(method):
    """In n^2 = n0^2 + g.r every method but Euler's is exact in t, however coarse the step.

    Arc length is exact for none, so rays are ended in a plane, where t is known as well.
    """
    g = (0.004, -0.01, 0.006)
    field, march = linear(1.2, g, box=BOX), March(7.0, method)
    line = Straight.through(to_vectors(STARTS), to_vectors(DIRECTIONS), march)
    ends = in_plane(march.vector(1, 0, 0), 30.0 - line.anchor.x)
    ray = bend(field, NoSurface(), line, march, remaining=ends)
    t = np.array(ray.t) - np.array(line.start)
    optical = t + np.array(ray.path)
    for i, (start, direction) in enumerate(zip(STARTS, DIRECTIONS, strict=True)):
        path = oracles.linear(1.2, g, start, direction)
        r, T = to_numpy(ray.position(line))[i], to_numpy(ray.tangent(line))[i]
        np.testing.assert_allclose(r, path.position(t[i]), rtol=0, atol=1e-12)
        np.testing.assert_allclose(T, path.tangent(t[i]), rtol=0, atol=1e-11)
        if method != "leapfrog":  # its optical path is a midpoint rule, which is not exact
            assert optical[i] == pytest.approx(path.optical_path(t[i]), abs=1e-9)


def test_optical_path_of_a_parabola():
    """A cubic in t; its surroundings are vacuum, so it is the whole integral of n ds."""
    g = (0.0, -0.01, 0.006)
    rays = trace(linear(1.2, g, box=BOX), STARTS, DIRECTIONS, 30.0, 0.2)
    paths = [oracles.linear(1.2, g, r0, d) for r0, d in zip(STARTS, DIRECTIONS, strict=True)]
    expected = ends_of_paths(paths, 30.0)
    np.testing.assert_allclose(rays.optical_path_mm, expected[2], rtol=0, atol=1e-8)
    np.testing.assert_allclose(rays.position, expected[0], rtol=0, atol=1e-8)


# -------------------------------------------------------------------------------------------- foci


def test_the_fish_eye_images_each_point():
    """All rays from r0 meet in -a^2 r0/|r0|^2, over the same optical path pi n0 a / 2."""
    n0, a = 1.8, 15.0
    r0 = np.array([-9.0, 4.0, 2.0])
    axis = unit(-r0)
    image = -(a**2) * r0 / (r0 @ r0)
    directions = unit(axis + 0.8 * np.random.default_rng(1).uniform(-1.0, 1.0, (20, 3)))
    march = March(0.05)
    line = Straight.through(to_vectors(np.tile(r0, (20, 1))), to_vectors(directions), march)
    normal = march.vector(*map(float, axis))
    anchors = to_numpy(line.anchor) @ axis
    ends = in_plane(normal, mi.Float64(image @ axis - anchors))
    box = np.array([[-60.0] * 3, [60.0] * 3])
    ray = bend(fish_eye(n0, a, box=box), NoSurface(), line, march, remaining=ends)
    np.testing.assert_array_equal(np.array(ray.status), RayStatus.ENDED)
    np.testing.assert_allclose(to_numpy(ray.position(line)), np.tile(image, (20, 1)), atol=1e-6)
    optical = np.array(ray.t) - np.array(line.start) + np.array(ray.path)
    np.testing.assert_allclose(optical, math.pi * n0 * a / 2.0, rtol=0, atol=1e-6)


def test_the_luneburg_lens_focuses_parallel_light_on_its_rim():
    """Rays along x that start on the sphere of radius R meet in (R, 0, 0)."""
    angle = np.linspace(-1.2, 1.2, 9)
    starts = 20.0 * np.stack([-np.cos(angle), np.sin(angle), 0.0 * angle], axis=-1)
    directions = np.tile([1.0, 0.0, 0.0], (9, 1))
    lengths = [
        oracles.parabolic(math.sqrt(2.0), [1 / 20.0] * 3, r0, d).arc(10.0 * math.pi)
        for r0, d in zip(starts, directions, strict=True)
    ]
    field = luneburg(20.0, box=np.array([[-28.0] * 3, [28.0] * 3]))
    rays = trace(field, starts, directions, lengths, 0.1)
    np.testing.assert_allclose(rays.position, np.tile([20.0, 0, 0], (9, 1)), rtol=0, atol=1e-6)


def test_light_goes_back_the_way_it_came():
    """Reversibility end to end: every ray, turned round where it ended, returns to its start."""
    field = hot_spot(0.3, 8.0, box=BOX)
    there = trace(field, STARTS, DIRECTIONS, 26.0, 0.05)
    back = trace(field, there.position, -there.direction, 26.0, 0.05)
    np.testing.assert_allclose(back.position, STARTS, rtol=0, atol=1e-8)
    np.testing.assert_allclose(back.direction, -DIRECTIONS, rtol=0, atol=1e-9)
    np.testing.assert_allclose(back.optical_path_mm, there.optical_path_mm, rtol=0, atol=1e-8)


# --------------------------------------------------------------------------------- gridded fields


@pytest.fixture(scope="module")
def shipped():
    return vs.load_scene("hot_cylinder").field


@pytest.fixture(scope="module")
def scipys(shipped):
    """Starts, directions, and rays by SciPy's spline through the unfolded nodes."""
    index = oracles.spline_index(shipped.nodes, shipped.origin, shipped.spacing, shipped.mirror)
    rng = np.random.default_rng(4)
    starts = rng.uniform([-60.0, -20.0, 5.0], [60.0, 20.0, 30.0], (8, 3))
    directions = unit(rng.normal([0.0, 0.0, 1.0], 0.15, (8, 3)))
    return starts, directions, oracles.integrate(index, starts, directions, 80.0)


@pytest.mark.parametrize(("method", "step"), [("rk4", 0.5), ("leapfrog", 0.1)])
def test_rays_through_the_hot_air_are_scipys(shipped, scipys, method, step):
    """Another spline code, another integrator, and arc length for its variable."""
    starts, directions, expected = scipys
    rays = trace(shipped, starts, directions, 80.0, step, method)
    np.testing.assert_array_equal(rays.status, RayStatus.ENDED)
    np.testing.assert_allclose(rays.position, expected.position(80.0), rtol=0, atol=1e-6)
    np.testing.assert_allclose(rays.direction, expected.direction(80.0), rtol=0, atol=3e-8)
    np.testing.assert_allclose(rays.optical_path_mm, expected.optical_path(80.0), rtol=0, atol=1e-7)
    bent = np.linalg.norm(rays.position - starts - 80.0 * directions, axis=1)
    assert bent.max() > 0.03  # or there is nothing to compare


def uniform(**changes):
    """A box of ambient air, 40 mm wide, with the given changes."""
    settings = {"origin_mm": [-20.0] * 3, "spacing_mm": [8.0] * 3, "ambient": 2.7e-4} | changes
    return IndexField.from_arrays(np.full((6, 6, 6), 2.7e-4), **settings)


@pytest.mark.parametrize(("method", "precision"), [("rk4", "double"), ("leapfrog", "single")])
def test_light_runs_straight_in_a_uniform_field(method, precision):
    """To 1e-12 (float32: to its rounding), and over n times the length."""
    rng = np.random.default_rng(5)
    starts = rng.uniform(-60.0, 60.0, (50, 3))
    directions = unit(rng.uniform(-20.0, 20.0, (50, 3)) - starts)
    rays = trace(uniform(), starts, directions, 150.0, 1.0, method, precision)
    tolerance = 1e-12 if precision == "double" else 1e-5
    np.testing.assert_allclose(rays.position, starts + 150.0 * directions, atol=100 * tolerance)
    off_line = np.cross(rays.position - starts, directions)
    assert abs(off_line).max() < 20 * tolerance
    np.testing.assert_allclose(rays.direction, directions, rtol=0, atol=tolerance)
    np.testing.assert_allclose(rays.optical_path_mm, 150.0 * 1.00027, rtol=tolerance)
    assert set(rays.status) == {RayStatus.LEFT}


def test_rays_that_miss_the_box_go_straight():
    """Beside it, away from it, and short of it."""
    dent = np.zeros((6, 6, 6))
    dent[2:4, 2:4, 2:4] = -1e-3
    field = IndexField.from_arrays(dent, [-20.0] * 3, [8.0] * 3)
    starts = np.array([[-50.0, 25.0, 0.0], [30.0, 0.0, 0.0], [-50.0, 1.0, 1.0], [-50.0, 1.0, 1.0]])
    directions = unit([[1.0, 0.1, 0.0], [1.0, 0.0, 0.2], [1.0, 0.0, 0.0], [1.0, 0.0, 0.0]])
    lengths = np.array([80.0, 80.0, 29.0, 80.0])
    rays = trace(field, starts, directions, lengths, method="leapfrog")
    straight = starts + lengths[:, None] * directions
    np.testing.assert_array_equal(rays.status, RayStatus.LEFT)
    np.testing.assert_allclose(rays.position[:3], straight[:3], rtol=0, atol=1e-12)
    np.testing.assert_allclose(rays.optical_path_mm[:3], lengths[:3], rtol=1e-14)
    assert np.linalg.norm(rays.position[3] - straight[3]) > 1e-3  # the one that does not miss


@pytest.mark.parametrize(("method", "precision"), [("rk4", "double"), ("leapfrog", "single")])
def test_rays_along_the_axes_and_along_the_faces(method, precision):
    """Exact zeros in the direction, starts exactly on faces, edges and corners."""
    axes = np.concatenate([np.eye(3), -np.eye(3)])
    places = np.array([-20.0, 0.0, 3.0, 20.0])
    starts = np.stack(np.meshgrid(places, places, places), axis=-1).reshape(-1, 3)
    starts, directions = np.repeat(starts, 6, axis=0), np.tile(axes, (len(starts), 1))
    rays = trace(uniform(), starts, directions, 50.0, 1.0, method, precision)
    tolerance = 1e-12 if precision == "double" else 1e-5
    np.testing.assert_allclose(rays.position, starts + 50.0 * directions, atol=10 * tolerance)
    np.testing.assert_array_equal(rays.status, RayStatus.LEFT)


def test_a_ray_in_the_mirror_plane_stays_there():
    """An even field has no gradient across its plane; on either side rays are mirror images."""
    half = -1e-3 * np.random.default_rng(6).random((6, 9, 9))
    field = IndexField.from_arrays(
        half, [0.0, -16.0, -16.0], [4.0] * 3, ambient=0.0, mirror=(True, False, False)
    )
    starts = np.array([[0.0, 3.0, -15.0], [2.0, 3.0, -15.0], [-2.0, 3.0, -15.0]])
    directions = unit([[0.0, 0.1, 1.0], [0.2, 0.1, 1.0], [-0.2, 0.1, 1.0]])
    rays = trace(field, starts, directions, 28.0, method="leapfrog")
    assert abs(rays.position[0, 0]) < 1e-15
    np.testing.assert_allclose(rays.position[1], rays.position[2] * [-1.0, 1.0, 1.0], atol=1e-13)
    assert np.all(rays.status == RayStatus.ENDED)


def test_rays_tell_how_they_ended():
    """ENDED in the field, LEFT ahead of it, TURNED_BACK from it; each with its numbers."""
    # The index falls from 1 at z = -40 to zero at z = 60.
    box = np.array([[-150.0, -150.0, -40.0], [150.0, 150.0, 40.0]])
    field = linear(math.sqrt(0.6), (0.0, 0.0, -0.01), box=box)
    starts = [[-102.0, 0.0, -60.0], [0.0, 0.0, -50.0], [-102.0, 0.0, -60.0]]
    directions = [[0.6, 0.0, 1.0], [1.0, 0.0, -0.2], [0.6, 0.0, 1.0]]
    rays = trace(field, starts, directions, [80.0, 80.0, 400.0])
    assert list(rays.status) == [RayStatus.ENDED, RayStatus.LEFT, RayStatus.TURNED_BACK]
    assert np.all(np.isfinite(rays.position))
    np.testing.assert_allclose(rays.direction[2], unit([0.6, 0.0, -1.0]), rtol=0, atol=1e-4)
    assert rays.position[2, 2] < -100.0


def test_a_march_without_end_says_so(shipped):
    """20,000 steps of 2 um do not cross the field; the numbers are those of the last step."""
    rays = trace(shipped, [[0.0, 0.0, 20.0]], [[0.0, 0.0, 1.0]], 100.0, 0.002, "leapfrog")
    assert list(rays.status) == [RayStatus.OUT_OF_STEPS]
    np.testing.assert_allclose(rays.position[0], [0.0, 0.0, 60.0], rtol=0, atol=0.02)


# ------------------------------------------------------------------------------------------ input


def test_one_ray_and_many_directions_lengths():
    """A single ray may come as two plain vectors; directions need not be unit vectors."""
    field = hot_spot(0.3, 8.0, box=BOX)
    one = trace(field, STARTS[0], 17.0 * DIRECTIONS[0], 20.0)
    many = trace(field, STARTS, DIRECTIONS, [20.0, 10.0, 5.0])
    assert one.position.shape == one.direction.shape == (1, 3)
    assert one.optical_path_mm.shape == one.status.shape == (1,)
    np.testing.assert_allclose(one.position[0], many.position[0], rtol=0, atol=1e-12)
    np.testing.assert_allclose(np.linalg.norm(many.direction, axis=1), 1.0, rtol=1e-15)
    all_one_way = trace(field, STARTS, DIRECTIONS[1], 10.0)
    np.testing.assert_allclose(all_one_way.position[1], many.position[1], rtol=0, atol=1e-12)
    assert len(all_one_way.position) == 3


@pytest.mark.parametrize(
    ("changes", "message"),
    [
        ({"origins_mm": np.zeros((3, 2))}, r"must both be \(N, 3\)"),
        ({"origins_mm": np.zeros((2, 3))}, r"must both be \(N, 3\)"),
        ({"origins_mm": STARTS * [1.0, np.nan, 1.0]}, "finite"),
        ({"directions": DIRECTIONS * [[1.0], [0.0], [1.0]]}, "not zero"),
        ({"directions": DIRECTIONS + np.array([0.0, np.inf, 0.0])}, "finite"),
        ({"length_mm": [1.0, np.inf, 1.0]}, "finite"),
        ({"length_mm": [1.0, 2.0]}, "length"),
        ({"length_mm": -1.0}, "negative"),
    ],
)
def test_unfit_rays_are_refused(changes, message):
    """Each message says what is wrong, before anything is marched."""
    fit = {"origins_mm": STARTS, "directions": DIRECTIONS, "length_mm": 10.0}
    with pytest.raises(InputError, match=message):
        trace(uniform(), **(fit | changes))


def test_directions_may_have_any_length():
    """The square of 1e300 is infinite, that of 1e-300 zero: the ray is the same."""
    air = IndexField.from_arrays(np.full((4, 4, 4), 1e-4), [-3.0] * 3, [2.0] * 3)
    ends = [
        trace(air, [[0.0, 0.0, -9.0]], [[0.3 * long, 0.0, 0.4 * long]], 10.0).position
        for long in (1.0, 1e300, 1e-300)
    ]
    np.testing.assert_allclose(ends, [[[6.0, 0.0, -1.0]]] * 3, atol=1e-9)
