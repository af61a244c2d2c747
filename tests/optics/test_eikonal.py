"""The ray march: what it conserves, what it carries along, and why its rays stop."""

import math
from itertools import product

import numpy as np
import oracles
import pytest
from oracles import unit
from scipy.optimize import brentq

import virtual_sensor as vs
from virtual_sensor.arrays import to_numpy, to_vectors
from virtual_sensor.engine import dr, mi
from virtual_sensor.medium.exact_fields import fish_eye, hot_spot, linear, luneburg, selfoc
from virtual_sensor.medium.index_field import IndexField
from virtual_sensor.optics.eikonal import (
    March,
    Straight,
    after_length,
    bend,
    in_plane,
    never,
)
from virtual_sensor.optics.ray_status import RayStatus
from virtual_sensor.optics.steppers import STEPPERS
from virtual_sensor.optics.surfaces import Cylinder, NoSurface

BOX = np.array([[-40.0] * 3, [40.0] * 3])
STARTS = np.array([[-12.0, 3.0, 1.0], [-10.0, -4.0, 5.0], [-14.0, 0.5, -2.0]])
DIRECTIONS = unit([[1.0, 0.2, -0.1], [1.0, 0.0, 0.3], [1.0, -0.3, 0.2]])


COARSE = March(1.0)
NOTHING = NoSurface()


def bent(field, starts, directions, march=COARSE, surface=NOTHING, **how):
    """Positions (N, 3), tangents (N, 3) and status (N,) of marched rays, and the rays."""
    line = Straight.through(to_vectors(starts), to_vectors(unit(directions)), march)
    if "length" in how:
        how["remaining"] = after_length(march.scalar(mi.Float64(how.pop("length"))))
    if "plane_x" in how:
        how["remaining"] = in_plane(march.vector(1, 0, 0), how.pop("plane_x") - line.anchor.x)
    ray = bend(field, surface, line, march, **how)
    dr.eval(ray)
    position, tangent = (to_numpy(v) for v in (ray.position(line), ray.tangent(line)))
    return position, tangent, np.array(ray.status), ray


def index(field, points):
    """Index of a closed-form field at points (N, 3)."""
    return 1.0 + field.delta_and_gradient(mi.Array3f64(points.T))[0].numpy()


# ---------------------------------------------------------------------------------------- steppers


def ball(t, x):
    """Acceleration in n^2 = 1 - 0.3 exp(-r^2 / 128), in NumPy; steppers take any arrays."""
    dip = 0.3 * np.exp(-(x[0] @ x[0]) / 128.0)
    return (x[0] * dip / 128.0,), np.sqrt(1.0 - dip) - 1.0


def there_and_back(method, steps=200, h=0.5):
    """How far the start is missed by steps forward and as many with -h."""
    start = (STARTS[0],), (DIRECTIONS[0],)
    x, v = start
    for sign in (1.0, -1.0):
        for _ in range(steps):
            x, v, *_ = STEPPERS[method](ball, 0.0, x, v, sign * h)
    return max(abs(x[0] - start[0][0]).max(), abs(v[0] - start[1][0]).max())


def test_leapfrog_goes_back_the_way_it_came():
    """A symmetric method undoes itself to rounding; Runge-Kutta's leaves its error twice."""
    assert there_and_back("leapfrog") < 1e-12
    assert there_and_back("rk4") > 1e-9


# ------------------------------------------------------------------------------------- invariants


@pytest.mark.parametrize(("precision", "rounding"), [("double", 1e-14), ("single", 3e-7)])
def test_tangents_are_unit_vectors_outside_however_strong_the_border(precision, rounding):
    """Inside |T| is n, which is 1.1 at this field's border and jumps to 1 there."""
    field = linear(1.2, (0.01, 0.0, 0.002), box=np.array([[-10.0] * 3, [10.0] * 3]))
    _, T, status, _ = bent(
        field, STARTS * [2.0, 1.0, 1.0], DIRECTIONS, March(1.0, "rk4", precision)
    )
    np.testing.assert_array_equal(status, RayStatus.LEFT)
    np.testing.assert_allclose(np.linalg.norm(T, axis=1), 1.0, rtol=0, atol=rounding)
    turned = np.linalg.norm(np.cross(T, DIRECTIONS), axis=1)
    assert turned.min() > 1e-3


SPHERICAL = {
    "hot_spot": hot_spot(0.3, 8.0, box=BOX),
    "fish_eye": fish_eye(1.8, 15.0, box=BOX),
    "luneburg": luneburg(20.0, box=np.array([[-27.0] * 3, [27.0] * 3])),
}


def test_bouguers_invariant_is_kept():
    """The vector r x T in spherical symmetry; leapfrog's kicks are central, so to rounding."""
    for case in product(SPHERICAL, (("rk4", 1e-7), ("sharma", 1e-7), ("leapfrog", 1e-12))):
        name, (method, tolerance) = case
        field = SPHERICAL[name]
        before = np.cross(STARTS, index(field, STARTS)[:, None] * DIRECTIONS)
        r, T, status, _ = bent(field, STARTS, DIRECTIONS, March(0.2, method), length=25.0)
        assert np.all(status == RayStatus.ENDED), case
        np.testing.assert_allclose(
            np.cross(r, T), before, rtol=0, atol=tolerance, err_msg=f"{case}"
        )


@pytest.mark.parametrize("method", sorted(STEPPERS.keys() - {"euler"}))
def test_a_fibre_keeps_the_axial_component_and_the_skewness(method):
    """T along the axis of a cylindrical field to rounding, and (r x T) along it."""
    field = selfoc(1.5, 0.02, box=np.array([[-200.0, -30, -30], [200.0, 30, 30]]))
    T0 = index(field, STARTS)[:, None] * DIRECTIONS
    r, T, *_ = bent(field, STARTS, DIRECTIONS, March(0.2, method), length=150.0)
    np.testing.assert_allclose(T[:, 0], T0[:, 0], rtol=1e-14)
    skewness = np.cross(r, T)[:, 0], np.cross(STARTS, T0)[:, 0]
    np.testing.assert_allclose(*skewness, rtol=0, atol=1e-12 if method == "leapfrog" else 1e-7)


def test_a_grid_that_does_not_vary_along_x_keeps_the_x_component():
    """The middle of a long part: the spline must not invent a gradient along it."""
    profile = -2e-4 * np.random.default_rng(2).random((12, 11))
    nodes = np.repeat(profile[None], 9, axis=0)
    field = IndexField.from_arrays(nodes, [-40.0, -25.0, -25.0], [10.0, 5.0, 5.0], ambient=0.0)
    _, T, status, _ = bent(field, STARTS, DIRECTIONS, March(1.0, "leapfrog"), length=40.0)
    ambient_to_inside = 1.0 + field.refractivity(STARTS)
    assert np.all(status == RayStatus.ENDED)
    np.testing.assert_allclose(T[:, 0], ambient_to_inside * DIRECTIONS[:, 0], rtol=1e-14)
    assert np.abs(T[:, 1:] - ambient_to_inside[:, None] * DIRECTIONS[:, 1:]).max() > 1e-5


def test_the_tangents_length_is_the_index():
    """|T| = n, which nothing in the march enforces."""
    for case in product(SPHERICAL, (("rk4", 1e-7), ("sharma", 1e-7), ("leapfrog", 1e-3))):
        name, (method, tolerance) = case
        r, T, *_ = bent(SPHERICAL[name], STARTS, DIRECTIONS, March(0.2, method), length=25.0)
        n = index(SPHERICAL[name], r)
        np.testing.assert_allclose(
            np.linalg.norm(T, axis=1), n, rtol=0, atol=tolerance, err_msg=f"{case}"
        )


def test_leapfrogs_energy_error_does_not_grow():
    """Over fifty swings in a fibre it stays what it was over five; Runge-Kutta's grows tenfold."""
    period = 2.0 * np.pi / 0.05
    field = selfoc(1.5, 0.05, box=np.array([[-1.0, -15, -15], [60.0 * period, 15, 15]]))
    swings = np.concatenate([np.linspace(4.0, 5.0, 40), np.linspace(49.0, 50.0, 40)])
    starts = np.tile([0.0, 4.0, 2.0], (80, 1))
    directions = np.tile([1.0, 0.3, -0.2], (80, 1))
    growth = {}
    for method in ("leapfrog", "rk4"):
        r, T, status, _ = bent(
            field, starts, directions, March(4.0, method), length=swings * period
        )
        assert np.all(status == RayStatus.ENDED)
        error = np.abs(np.linalg.norm(T, axis=1) - index(field, r)).reshape(2, 40).max(axis=1)
        growth[method] = error[1] / error[0]
    assert growth["leapfrog"] == pytest.approx(1.0, abs=0.1)
    assert growth["rk4"] > 5.0


# --------------------------------------------------------------------------------------- tangents


@pytest.mark.parametrize("start_x", [-12.0, -80.0], ids=["from inside", "from outside"])
@pytest.mark.parametrize("precision", ["double", "single"])
def test_carried_derivatives_are_those_of_neighbouring_rays(start_x, precision):
    """By the start's position and by its direction, on a plane behind a strong lens."""
    field = hot_spot(0.3, 8.0, box=1.5 * BOX)  # faded to 5e-13 at the border
    starts = STARTS * [0.0, 1.0, 1.0] + [start_x, 0.0, 0.0]
    shift, turn = np.array([0.0, 0.6, -0.8]), np.array([0.3, 0.0, 1.0])
    turns = turn - DIRECTIONS * (DIRECTIONS @ turn)[:, None]
    zero = np.zeros_like(starts)
    march = March(0.2, precision=precision)
    tangents = ((zero + shift, zero), (zero, turns))
    _, T, _, ray = bent(
        field,
        starts,
        DIRECTIONS,
        march,
        plane_x=35.0,
        tangents=tuple(
            (march.vector(to_vectors(x)), march.vector(to_vectors(v))) for x, v in tangents
        ),
    )
    for (x, v), carried in zip(tangents, ray.offset[1:], strict=True):
        w = to_numpy(carried)
        e = 1e-4
        ends = [
            bent(field, starts + s * e * x, DIRECTIONS + s * e * v, March(0.2), plane_x=35.0)[0]
            for s in (1.0, -1.0)
        ]
        expected = (ends[0] - ends[1]) / (2.0 * e)
        in_the_plane = w - T * (w[:, :1] / T[:, :1])
        tolerance = 2e-6 if precision == "double" else 2e-5
        np.testing.assert_allclose(
            in_the_plane, expected, rtol=0, atol=tolerance * abs(expected).max()
        )


# --------------------------------------------------------------------------------- where rays end


@pytest.mark.parametrize(("precision", "tolerance"), [("double", 1e-10), ("single", 3e-5)])
def test_rays_end_where_they_are_asked_to(precision, tolerance):
    """In a plane in the field, and after a length of arc that closed forms know."""
    g = (0.004, -0.01, 0.006)
    field = linear(1.2, g, box=BOX)
    march = March(0.7, precision=precision)
    r, _, status, _ = bent(field, STARTS, DIRECTIONS, march, plane_x=20.0)
    assert np.all(status == RayStatus.ENDED)
    np.testing.assert_allclose(r[:, 0], 20.0, rtol=0, atol=tolerance)

    r, *_ = bent(field, STARTS, DIRECTIONS, march, length=31.0)
    for position, start, direction in zip(r, STARTS, DIRECTIONS, strict=True):
        path = oracles.linear(1.2, g, start, direction)
        expected = path.position(path.t_at_arc(31.0))
        np.testing.assert_allclose(position, expected, rtol=0, atol=1e2 * tolerance)


def test_a_bent_ray_meets_a_cylinder_where_its_parabola_does():
    """To a nanometre, although chords of the step's length lie up to a micrometre beside it."""
    g = (0.0, 0.004, -0.012)
    cylinder = Cylinder(radius_mm=6.0, half_length_mm=30.0, axis_y_mm=0.0, axis_z_mm=-6.0)
    field = linear(1.2, g, box=BOX)
    starts = np.array([[-15.0, -3.0, 9.0], [-10.0, 1.0, 12.0], [-12.0, 4.0, 6.0]])
    directions = unit([[1.0, 0.1, -0.3], [0.6, -0.1, -0.8], [1.0, -0.2, -0.3]])
    r, _, status, _ = bent(field, starts, directions, March(2.0), cylinder)
    assert np.all(status == RayStatus.HIT)
    for position, start, direction in zip(r, starts, directions, strict=True):
        path = oracles.linear(1.2, g, start, direction)
        above = lambda t, p=path: np.hypot(p.position(t)[1], p.position(t)[2] + 6.0) - 6.0  # noqa: E731
        times = np.linspace(0.0, 40.0, 400)
        first = next(t for t in times if above(t) < 0.0)
        expected = path.position(brentq(above, first - 0.2, first, xtol=1e-13))
        np.testing.assert_allclose(position, expected, rtol=0, atol=1e-6)


# From vacuum at z = -40 the index falls to zero at z = 60: rays are thrown back like stones.
THROWING_BOX = np.array([[-150.0, -150.0, -40.0], [150.0, 150.0, 40.0]])
THROWN = linear(math.sqrt(0.6), (0.0, 0.0, -0.01), box=THROWING_BOX)


def test_every_ray_says_why_it_stopped():
    """One ray for each reason, in one batch, and they do not disturb each other."""
    part = Cylinder(radius_mm=5.0, half_length_mm=20.0, axis_y_mm=100.0, axis_z_mm=-30.0)
    rays = {
        RayStatus.HIT: ([0.0, 100.0, -60.0], [0.0, 0.0, 1.0]),
        RayStatus.ENDED: ([-60.0, 0.0, -50.0], [1.0, 0.0, 0.1]),
        RayStatus.LEFT: ([0.0, 0.0, -60.0], [0.0, 1.0, -0.5]),
        RayStatus.TURNED_BACK: ([-102.0, 0.0, -60.0], [0.6, 0.0, 1.0]),
        RayStatus.STARTED_INSIDE: ([0.0, 100.0, -28.0], [0.0, 0.0, 1.0]),
    }
    starts, directions = map(np.array, zip(*rays.values(), strict=True))

    def remaining(line, ray):
        second = dr.arange(mi.UInt32, len(rays)) == 1
        return dr.select(second, after_length(30.0)(line, ray), never(line, ray))

    r, T, status, _ = bent(THROWN, starts, directions, March(1.0), part, remaining=remaining)
    np.testing.assert_array_equal(status, list(rays))
    np.testing.assert_array_equal(r[4], starts[4])
    # A stone's flight from (-90, 0, -40): T_z is reversed, and the range is 4 T_x T_z / |g|.
    np.testing.assert_allclose(T[3], unit([0.6, 0.0, -1.0]), rtol=0, atol=1e-4)
    flight = 4.0 * 0.6 / 1.36 / 0.01
    np.testing.assert_allclose(r[3], [flight - 90.0, 0.0, -40.0], rtol=0, atol=0.01)


@pytest.mark.parametrize("precision", ["double", "single"])
def test_a_ray_that_only_just_reaches_the_border_does_not_hang_there(precision):
    """Stones thrown to within 10 um of the ceiling, and exactly to it, come back or leave."""
    apex = 40.0 + np.linspace(-1e-2, 1e-2, 41)
    T_z = np.sqrt(0.01 * (apex + 40.0))
    directions = np.stack([np.sqrt(1.0 - T_z**2), 0.0 * T_z, T_z], axis=-1)
    starts = [-90.0, 0.0, -40.0] - 20.0 * directions
    _, _, status, _ = bent(THROWN, starts, directions, March(1.0, precision=precision))
    assert set(status) == {RayStatus.LEFT, RayStatus.TURNED_BACK}
    assert status[0] == RayStatus.TURNED_BACK
    assert status[-1] == RayStatus.LEFT


def test_a_ray_that_runs_out_of_steps_says_so():
    """It stops in the field, after the length that it was allowed."""
    field = luneburg(20.0, box=np.array([[-27.0] * 3, [27.0] * 3]))
    _, _, status, ray = bent(field, STARTS, DIRECTIONS, March(0.5, max_steps=7))
    assert np.all(status == RayStatus.OUT_OF_STEPS)
    np.testing.assert_allclose(np.array(ray.t) - np.sum(STARTS * DIRECTIONS, axis=1), 3.5)


def test_only_active_rays_move():
    r, _, status, _ = bent(
        luneburg(20.0, box=BOX / 2),
        STARTS,
        DIRECTIONS,
        length=5.0,
        active=mi.Mask([True, False, True]),
    )
    np.testing.assert_array_equal(status, [RayStatus.ENDED, RayStatus.LEFT, RayStatus.ENDED])
    np.testing.assert_allclose(r[1], STARTS[1], rtol=0, atol=1e-14)
    assert np.all(np.linalg.norm(r - STARTS, axis=1)[[0, 2]] > 4.9)


@pytest.mark.parametrize(
    "unfit", [{"step_mm": 0.0}, {"step_mm": np.nan}, {"method": "heun"}, {"precision": "half"}]
)
def test_an_impossible_march_is_refused(unfit):
    with pytest.raises(ValueError, match=next(iter(unfit))):
        March(**unfit)


# ---------------------------------------------------------------------------- the camera's light


def test_float32_costs_less_than_two_thousandths_of_a_pixel():
    """Camera rays through the hot air to the cylinder: 0.044 um square to the line of sight."""
    scene = vs.load_scene("hot_cylinder")
    u, v = np.meshgrid(np.linspace(480.0, 1560.0, 55), np.linspace(1000.0, 1260.0, 14))
    sight = scene.sensor.camera.lines_of_sight(np.stack([u.ravel(), v.ravel()], axis=-1))
    starts = np.broadcast_to(scene.sensor.camera.pose.origin_mm, sight.shape)
    hits = {}
    for precision in ("single", "double"):
        march = March(2.0, "leapfrog", precision)
        hits[precision], _, status, _ = bent(scene.field, starts, sight, march, scene.surface)
        assert np.all(status == RayStatus.HIT)
    miss = np.cross(hits["single"] - hits["double"], sight)
    assert np.linalg.norm(miss, axis=1).max() < 0.044e-3
