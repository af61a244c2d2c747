"""Maps of bent rays against closed forms, and against SciPy's integrator."""

from dataclasses import dataclass

import numpy as np
import pytest
from oracles import unit
from scipy.integrate import solve_ivp

from virtual_sensor.arrays import to_numpy, to_vectors
from virtual_sensor.engine import dr, mi
from virtual_sensor.medium import exact_fields
from virtual_sensor.medium.exact_fields import ExactField
from virtual_sensor.optics import ray_maps
from virtual_sensor.optics.eikonal import March
from virtual_sensor.optics.illumination import LightStatus, illuminate
from virtual_sensor.optics.ray_families import Pinhole, RayFamily, Sheet
from virtual_sensor.optics.ray_maps import (
    CausticError,
    MapRequest,
    MapStatus,
    NoMapError,
    displaced,
    forward_map,
    inverse_map,
)
from virtual_sensor.optics.surfaces import NoSurface
from virtual_sensor.optics.tabulated_light import hits, light
from virtual_sensor.poses import Pose

MARCH = March(step_mm=1.0, method="rk4", precision="double")


def numbers(values):
    """Columns (N, C) of Dr.Jit arrays."""
    dr.eval(values)
    return np.array([np.array(v) for v in values], float).T


def read(table, places):
    """A linear table's functions at places (N, 3)."""
    return numbers(table.at(mi.Array3f(np.ascontiguousarray(places.T, np.float32))))


def around(grid, count):
    """Places anywhere on a grid, as float32 has them."""
    places = grid.low + np.random.default_rng(count).random((count, 3)) * (grid.high - grid.low)
    return places.astype(np.float32).astype(float)


# ------------------------------------------------------------------------------ independent rays


@dataclass(frozen=True)
class Spot:
    """n^2 = 1 - depth exp(-r^2 / 2 w^2), and its rays in a frame by SciPy."""

    depth: float = 0.04
    width_mm: float = 8.0

    @property
    def field(self):
        """The project's own; at the border of its box 1 - n is 2e-11."""
        box = np.array([[-50.0] * 3, [50.0] * 3])
        return exact_fields.hot_spot(self.depth, self.width_mm, box=box)

    def rays(self, pose, start, slope, depth):
        """Places and slopes (N, 4) at depths (N,) of a frame, of rays straight up to z = -60.

        With z as the variable: dx/dz = Tx/Tz and dTx/dz = (d n^2/dx) / 2 Tz.
        """

        def rate(z, state):
            x, y, tx, ty = state.reshape(4, -1)
            world = np.stack([x, y, np.full_like(x, z)], axis=1) @ pose.rotation.T
            world = world + pose.origin_mm
            dip = self.depth * np.exp(-np.sum(world**2, axis=1) / (2.0 * self.width_mm**2))
            gradient = (world * (dip / self.width_mm**2)[:, None]) @ pose.rotation
            tz = np.sqrt(1.0 - dip - tx**2 - ty**2)
            return np.concatenate([tx, ty, gradient[:, 0] / 2, gradient[:, 1] / 2]) / np.tile(tz, 4)

        first = float(pose.rotation[:, 2] @ -pose.origin_mm) - 60.0
        begin = start + slope * first
        tangent = slope / np.sqrt(1.0 + np.sum(slope**2, axis=1))[:, None]
        state = np.concatenate([begin.T.ravel(), tangent.T.ravel()])
        stops, number = np.unique(depth, return_inverse=True)
        solved = solve_ivp(rate, (first, stops[-1]), state, "DOP853", stops, rtol=1e-12, atol=1e-12)
        x, y, tx, ty = solved.y.reshape(4, len(depth), -1)[:, np.arange(len(depth)), number]
        world = np.stack([x, y, depth], axis=1) @ pose.rotation.T + pose.origin_mm
        r2 = np.sum(world**2, axis=1)
        n2 = 1.0 - self.depth * np.exp(-r2 / (2.0 * self.width_mm**2))
        tz = np.sqrt(n2 - tx**2 - ty**2)
        return np.stack([x, y, tx / tz, ty / tz], axis=1)


def frame(origin, target, up=(0.1, 1.0, 0.2)):
    """A pose that looks from one place to another, turned so that no axis is the world's."""
    z = unit(np.subtract(target, origin))
    x = unit(np.cross(up, z))
    return Pose(np.stack([x, np.cross(z, x), z], axis=-1), np.asarray(origin, float))


def view(pose):
    """Lines of sight of a camera."""
    return Pinhole(np.eye(3), pose, (1, 1))


CAMERA = frame([70.0, 20.0, 90.0], [1.0, 2.0, -1.0])
CAMERA_BOX = np.array([-0.02, -0.05, 110.0]), np.array([0.08, 0.03, 123.0])
SPOT = Spot()


def spot_seen(p, q, depth):
    """Displacements and their slopes (N, 4) of bent lines of sight through the hot spot."""
    slope = np.stack([p, q], axis=1)
    rays = SPOT.rays(CAMERA, np.zeros_like(slope), slope, depth)
    return rays - np.hstack([slope * depth[:, None], slope])


FIBRE_N, FIBRE_A = 1.2, 0.02
FIBRE = exact_fields.selfoc(
    FIBRE_N, FIBRE_A, box=np.array([[-1.0, -30.0, -30.0], [99.0, 30.0, 30.0]])
)
FIBRE_CAMERA = Pose(
    np.array([[0.0, 0.0, 1.0], [0.6, -0.8, 0.0], [0.8, 0.6, 0.0]]), np.array([0.0, 3.0, -2.0])
)
FIBRE_BOX = np.array([-0.08, -0.05, 20.0]), np.array([0.07, 0.06, 60.0])


def fibre_seen(p, q, depth):
    """The same in a fibre along the camera's axis, by the oscillation of its rays."""
    slope, w = np.stack([p, q], axis=1), FIBRE_N * FIBRE_A
    start = FIBRE_CAMERA.origin_mm @ FIBRE_CAMERA.rotation[:, :2]
    n = np.sqrt(FIBRE_N**2 - w**2 * start @ start)
    ahead = n / np.sqrt(1.0 + np.sum(slope**2, axis=1, keepdims=True))
    t, depth = depth[:, None] / ahead, depth[:, None]
    place = start * (np.cos(w * t) - 1.0) + slope * ahead * np.sin(w * t) / w
    heading = slope * np.cos(w * t) - start * (w / ahead) * np.sin(w * t)
    return np.hstack([place - slope * depth, heading - slope])


CAMERA_CASES = {
    "hot spot": (SPOT.field, CAMERA, CAMERA_BOX, spot_seen),
    "fibre": (FIBRE, FIBRE_CAMERA, FIBRE_BOX, fibre_seen),
}


# --------------------------------------------------------------------------------- the camera's


@pytest.mark.parametrize("case", CAMERA_CASES)
@pytest.mark.parametrize("tolerance_mm", [2e-3, 2e-4, 2e-5])
def test_lines_of_sight_are_tabulated_to_the_tolerance_asked(case, tolerance_mm):
    """Rationale: the table's own estimate is all that a user has; it must be worth its word.

    It is pessimistic, for it allows the linear interpolation its whole share of the tolerance.
    """
    field, pose, box, seen = CAMERA_CASES[case]
    camera = forward_map(MapRequest(field, view(pose), *box, MARCH, tolerance_mm))
    error_mm, places = camera.linear_error_mm, around(camera.table.grid, 200)
    truth, told = seen(*places.T), read(camera.linear, places)
    wrong = np.linalg.norm((told - truth)[:, :2], axis=1).max()
    assert np.abs(truth[:, :2]).max() > 0.1
    assert error_mm <= tolerance_mm
    assert wrong <= 1.5 * tolerance_mm
    assert wrong / 3.0 <= error_mm <= 6.0 * wrong
    cell_mm = camera.linear.grid.spacing * [places[:, 2].min(), places[:, 2].min(), 1.0]
    assert np.abs((told - truth)[:, 2:]).max() <= 10.0 * tolerance_mm / cell_mm.min()


@pytest.mark.parametrize("case", CAMERA_CASES)
@pytest.mark.parametrize("tolerance_mm", [2e-3, 2e-4, 2e-5])
def test_splines_keep_their_own_error_and_give_points_on_the_rays(case, tolerance_mm):
    """Rationale: who triangulates or projects reads these, not the linear table."""
    field, pose, box, seen = CAMERA_CASES[case]
    camera = forward_map(MapRequest(field, view(pose), *box, MARCH, tolerance_mm))
    places = around(camera.table.grid, 200)
    p, q, depth = places.T
    truth = seen(p, q, depth)
    wrong = np.linalg.norm((camera.at(places) - truth)[:, :2], axis=1).max()
    assert wrong <= 1.5 * camera.error_mm
    assert camera.error_mm <= 0.6 * tolerance_mm
    found = camera.points(places)
    np.testing.assert_array_equal(found.status, MapStatus.OK)
    local = np.stack([p * depth + truth[:, 0], q * depth + truth[:, 1], depth], axis=1)
    np.testing.assert_allclose(found.point_mm, pose.to_world(local), rtol=0, atol=tolerance_mm)
    slope = np.stack([p + truth[:, 2], q + truth[:, 3], np.ones(len(p))], axis=1)
    np.testing.assert_allclose(
        found.direction, unit(slope @ pose.rotation.T), rtol=0, atol=3.0 * tolerance_mm
    )


@pytest.mark.parametrize("many", [20_000, 0])
def test_first_order_rays_are_tabulated_as_first_order_rays(many, monkeypatch):
    """Rationale: a table must tell of the march that was asked for, not of a better one.

    Rays of many nodes go on from depth to depth, which those of first order can't.
    """
    monkeypatch.setattr(ray_maps, "_MANY", many)
    march = March(step_mm=1.0, method="rk4", first_order=True)
    camera = forward_map(MapRequest(SPOT.field, view(CAMERA), *CAMERA_BOX, march, 1e-4))
    places = around(camera.table.grid, 200)
    marched = displaced(SPOT.field, view(CAMERA), march, places)
    told = read(camera.linear, places)
    np.testing.assert_allclose(told[:, :2], marched[:, :2], rtol=0, atol=1.5e-4)
    assert np.abs(told[:, :2] - spot_seen(*places.T)[:, :2]).max() > 5e-4


@dataclass(frozen=True)
class Plane:
    """A surface: normal . r = offset."""

    normal: tuple
    offset: float

    def distance(self, origin, direction, limit, active):
        n = type(direction)(*map(float, self.normal))
        met = (self.offset - dr.dot(n, origin)) / dr.dot(n, direction)
        return dr.select((met >= 0.0) & (met <= limit) & active, met, dr.inf)


def test_bent_lines_of_sight_meet_a_leaning_plane_where_they_should():
    """Rationale: the depth at which the table is read is not known before the point is found."""
    normal, offset = unit([0.3, 0.2, 1.0]), 0.4
    camera = forward_map(MapRequest(SPOT.field, view(CAMERA), *CAMERA_BOX, MARCH, 2e-5))
    low, high = CAMERA_BOX
    p, q = (low[:2] + np.random.default_rng(5).random((50, 2)) * (high - low)[:2]).T * 0.6
    local = np.stack([p, q, np.ones(len(p))], axis=1)
    direction = to_vectors(unit(local @ CAMERA.rotation.T))
    origin = to_vectors(np.tile(CAMERA.origin_mm, (len(p), 1)))
    ray = mi.Ray3f(mi.Point3f(origin), mi.Vector3f(direction))
    seen = hits(camera, Plane(tuple(normal), offset), ray, MARCH)
    assert np.all(numbers([seen.hit]))
    assert not np.any(numbers([seen.lost, seen.off]))

    depth = np.full(len(p), 115.0)
    for _ in range(6):  # Newton on the true ray's depth
        place = spot_seen(p, q, depth)
        x, y = place[:, 0] + p * depth, place[:, 1] + q * depth
        world = CAMERA.to_world(np.stack([x, y, depth], axis=1))
        slope = np.stack([place[:, 2] + p, place[:, 3] + q, np.ones(len(p))], axis=1)
        heading = slope @ CAMERA.rotation.T
        depth = depth + (offset - world @ normal) / (heading @ normal)
    np.testing.assert_allclose(to_numpy(seen.point), world, rtol=0, atol=3e-5)
    np.testing.assert_allclose(to_numpy(seen.heading), unit(heading), rtol=0, atol=3e-5)


# ---------------------------------------------------------------------------------- the laser's

REFERENCE_MM = 90.0  # the reference plane's distance
LASER_LOW = np.array([-3.0, -9.0, REFERENCE_MM - 12.0])
LASER_HIGH = np.array([5.0, 8.0, REFERENCE_MM + 14.0])
LASER_TOLERANCE_MM = 1e-4


@pytest.fixture(scope="module", params=[0.0, 6.0], ids=["telecentric", "fan"])
def laser(request):
    pose = frame([-40.0, 15.0, 80.0], [1.0, -1.0, 0.5])
    return Sheet(pose, REFERENCE_MM, 2.0 * np.tan(np.radians(request.param / 2.0)) / 20.0)


@pytest.fixture(scope="module")
def mapped(laser):
    return inverse_map(
        MapRequest(SPOT.field, laser, LASER_LOW, LASER_HIGH, MARCH, LASER_TOLERANCE_MM)
    )


def centre(laser):
    """The frame in the middle of the laser's reference plane."""
    rotation = laser.pose.rotation
    return Pose(rotation, laser.pose.origin_mm + laser.distance_mm * rotation[:, 2])


def sent(laser, a, b, depth):
    """Places and slopes (N, 4) of laser rays (a, b) by SciPy, in the laser's frame."""
    depth = depth - laser.distance_mm
    slope = np.stack([np.zeros_like(b), laser.fan_per_mm * b], axis=1)
    return SPOT.rays(centre(laser), np.stack([a, b], axis=1), slope, depth)


def test_the_ray_that_the_map_tells_passes_through_the_point(laser, mapped):
    """Rationale: to the tolerance, and with the slope; sent off from the exit by SciPy."""
    error_mm, places = mapped.linear_error_mm, around(mapped.table.grid, 150)
    a0, b0, depth = places.T
    told = read(mapped.linear, places)
    arrived = sent(laser, a0 + told[:, 0], b0 + told[:, 1], depth)
    scale = 1.0 + laser.fan_per_mm * (depth - laser.distance_mm)
    miss = np.hypot(arrived[:, 0] - a0, arrived[:, 1] / scale - b0)
    assert np.abs(told[:, :2]).max() > 0.1
    assert miss.max() <= 1.5 * LASER_TOLERANCE_MM
    assert error_mm <= LASER_TOLERANCE_MM
    assert miss.max() / 3.0 <= error_mm <= 6.0 * miss.max()
    straight = np.stack([np.zeros_like(b0), laser.fan_per_mm * b0], axis=1)
    np.testing.assert_allclose(told[:, 2:4], arrived[:, 2:] - straight, rtol=0, atol=5e-5)


def test_concentration_is_the_share_of_a_tube_of_independent_rays(laser, mapped):
    """Rationale: flux is conserved; the tube's area is by finite differences of SciPy's rays."""
    places, e = around(mapped.table.grid, 60), 1e-3
    a0, b0, depth = places.T
    told = read(mapped.linear, places)
    a, b = a0 + told[:, 0], b0 + told[:, 1]
    ends = [sent(laser, a + i * e, b + j * e, depth)[:, :2] for i, j in ((1, 0), (-1, 0))]
    ends += [sent(laser, a + i * e, b + j * e, depth)[:, :2] for i, j in ((0, 1), (0, -1))]
    by_a, by_b = (ends[0] - ends[1]) / (2 * e), (ends[2] - ends[3]) / (2 * e)
    area = by_a[:, 0] * by_b[:, 1] - by_a[:, 1] * by_b[:, 0]
    expected = (1.0 + laser.fan_per_mm * (depth - laser.distance_mm)) / area
    np.testing.assert_allclose(1.0 + told[:, 4], expected, rtol=1e-3)
    assert np.ptp(expected) > 0.1


@dataclass(frozen=True)
class Uneven(RayFamily):
    """Parallel rays whose names lie the denser the farther out: y = t + k t^2."""

    pose: Pose
    per_mm: float

    def foot(self, s, t):
        return s, t + self.per_mm * t * t

    def slope(self, s, t):
        return 0.0 * s, 0.0 * t

    def straight(self, x, y, depth):
        return x, 2.0 * y / (1.0 + np.sqrt(1.0 + 4.0 * self.per_mm * y))

    def by_coordinates(self, s, t, depth):
        return 1.0, 0.0, 0.0, 1.0 + 2.0 * self.per_mm * t


def test_the_determinant_is_that_of_the_shifts_where_names_lie_unevenly():
    """Where a tube's spread changes with its name, too: by the shifts' own derivatives."""
    family = Uneven(frame([-40.0, 15.0, 80.0], [1.0, -1.0, 0.5]), 0.02)
    mapped = inverse_map(
        MapRequest(SPOT.field, family, LASER_LOW, LASER_HIGH, MARCH, LASER_TOLERANCE_MM)
    )
    places = around(mapped.table.grid, 60)
    by_s, by_t = (slopes[:, :2] for slopes in mapped.table.with_slopes(places)[1:])
    determinant = (1.0 + by_s[:, 0]) * (1.0 + by_t[:, 1]) - by_s[:, 1] * by_t[:, 0]
    told = mapped.table.at(places)[:, 4]
    np.testing.assert_allclose(1.0 + told, determinant, rtol=2e-3)
    assert np.ptp(determinant) > 0.1


def points_of(laser, places):
    """World points (N, 3) of places (a0, b0, depth)."""
    scaled = places - [0.0, 0.0, laser.distance_mm]
    scaled[:, 1] *= 1.0 + laser.fan_per_mm * scaled[:, 2]
    return centre(laser).to_world(scaled)


class Open(NoSurface):
    """Nothing between, but shapes somewhere."""

    corners = mi.ScalarPoint3f(-30.0), mi.ScalarPoint3f(30.0)


def test_light_is_that_of_newtons_marches(laser, mapped):
    """Rationale: a frame may mix the two; they must be the same light."""
    vectors = to_vectors(points_of(laser, around(mapped.table.grid, 200)))
    told, off = light(mapped, Open(), vectors, dr.full(mi.Mask, True, 200))
    exact = illuminate(laser, SPOT.field, NoSurface(), vectors, MARCH)
    assert not np.any(numbers([off]))
    np.testing.assert_array_equal(np.array(told.status), np.array(exact.status))
    assert np.all(np.array(told.status) == LightStatus.LIT)
    for mine, theirs, within in (
        ((told.s, told.t), (exact.s, exact.t), 1.5 * LASER_TOLERANCE_MM),
        (told.shift, exact.shift, 1.5 * LASER_TOLERANCE_MM),
        (told.heading, exact.heading, 1e-4),
        ((told.concentration,), (exact.concentration,), 1e-3),
    ):
        np.testing.assert_allclose(numbers(list(mine)), numbers(list(theirs)), rtol=0, atol=within)


def test_points_off_the_map_and_inactive_ones_are_told(laser, mapped):
    """Rationale: those are marched; a clamped table would give them a plausible wrong ray."""
    inside = 0.5 * (LASER_LOW + LASER_HIGH)
    places = np.tile(inside, (4, 1))
    beyond = LASER_HIGH[0] + 0.1, LASER_LOW[1] - 0.1, LASER_HIGH[2] + 0.1
    places[1, 0], places[2, 1], places[3, 2] = beyond
    vectors = to_vectors(points_of(laser, places))
    told, off = light(mapped, Open(), vectors, dr.full(mi.Mask, True, 4))
    np.testing.assert_array_equal(np.array(off), [False, True, True, True])
    told, off = light(mapped, Open(), vectors, mi.Mask(np.arange(4) == 0))
    np.testing.assert_array_equal(np.array(off), [False] * 4)
    np.testing.assert_array_equal(np.array(told.status)[1:], LightStatus.NO_POINT)
    assert np.all(np.isnan(np.array(told.s)[1:]) & (np.array(told.concentration)[1:] == 0.0))


# --------------------------------------------------------------------------- where there is none


FOCUS_MM, SLAB_N = 40.0, 1.5


def slab(contrast):
    """A lens that focuses light along x to a line at 40 mm for a contrast of 1, and closer above.

    n^2 = n0^2 - (w z)^2, with a millionth of that across y: Dr.Jit takes for constant what at first
    does not change.
    """
    w = contrast * SLAB_N * np.pi / 2.0 / FOCUS_MM

    def n_squared(p):
        curvature = type(p)(0.0, 1e-6 * w**2, w**2)
        hessian = mi.Matrix3f64(dr.diag(-2.0 * curvature))
        return SLAB_N**2 - dr.dot(curvature, p * p), -2.0 * curvature * p, hessian

    return ExactField(n_squared, box=np.array([[0.0, -20.0, -20.0], [200.0, 20.0, 20.0]]))


BEAM = Sheet(
    Pose(np.array([[0.0, 0.0, 1.0], [0.0, -1.0, 0.0], [1.0, 0.0, 0.0]]).T, np.array([-50.0, 0, 0])),
    50.0,
)
SLAB_BOX = np.array([-0.2, -1.0, 51.0]), np.array([0.2, 1.0, 50.0 + FOCUS_MM])


def slab_map(contrast, tolerance_mm=1e-3, march=MARCH):
    """The map of a beam into that lens, from its face to 40 mm behind it."""
    return inverse_map(MapRequest(slab(contrast), BEAM, *SLAB_BOX, march, tolerance_mm))


def test_a_caustic_in_the_box_is_refused_and_none_before_it():
    """Rationale: beyond a focus three rays may light a point; a table would give one of them."""
    beam = slab_map(0.85)
    a0, within_mm = np.full(20, 0.15), np.linspace(2.0, FOCUS_MM, 20)
    places = np.stack([a0, 0.5 + 0.0 * a0, 50.0 + within_mm], axis=1)
    told = read(beam.linear, places)
    gain = 1.0 / np.cos(0.85 * np.pi / 2.0 * within_mm / FOCUS_MM)
    assert gain.max() > 4.0
    np.testing.assert_allclose((a0 + told[:, 0]) / gain, a0, rtol=0, atol=1e-3)
    np.testing.assert_allclose(1.0 + told[:, 4], gain, rtol=0.02)
    for contrast in (1.05, 1.5):
        with pytest.raises(CausticError, match="caustic"):
            slab_map(contrast)


def test_rays_that_are_turned_away_leave_no_map(laser):
    """Rationale: a ray that never gets to its depth has no displacement there to be tabulated."""
    against = tuple(map(float, -0.04 * laser.pose.rotation[:, 2]))  # light gets 25 mm deep
    wall = exact_fields.linear(1.0, against, box=np.array([[-40.0] * 3, [40.0] * 3]))
    with pytest.raises(NoMapError, match="turned away"):
        inverse_map(MapRequest(wall, laser, LASER_LOW, LASER_HIGH + 30.0, MARCH, 1e-3))
    low, high = np.array([-0.1, -0.1, 100.0]), np.array([0.1, 0.1, 160.0])
    with pytest.raises(NoMapError, match="turned away"):
        forward_map(MapRequest(wall, view(laser.pose), low, high, MARCH, 1e-3))


def test_a_tolerance_that_cannot_be_met_is_refused_with_the_error_reached():
    """Rationale: single precision is good for a nanometre; the user must know how far it got."""
    march = March(step_mm=10.0, method="leapfrog", precision="single")
    field = ExactField(SPOT.field.n_squared, box=SPOT.field.box)
    reached = r"the table's error is \d\.\de-\d\d mm with \d+ x \d+ x \d+ nodes, above"
    with pytest.raises(NoMapError, match=reached):
        forward_map(MapRequest(field, view(CAMERA), *CAMERA_BOX, march, 1e-9))
    with pytest.raises(NoMapError, match=reached):
        slab_map(0.5, 1e-13)


def test_a_tolerance_that_is_not_refused_is_kept():
    """Rationale: the linear table is made no more than so much finer; what is left must be told."""
    field, pose, box, seen = CAMERA_CASES["fibre"]
    try:
        camera = forward_map(MapRequest(field, view(pose), *box, MARCH, 5e-6))
        linear = camera.linear
    except NoMapError:
        return
    places = around(camera.table.grid, 500)
    wrong = np.linalg.norm((read(linear, places) - seen(*places.T))[:, :2], axis=1).max()
    assert wrong <= 1.5 * camera.linear_error_mm


def test_where_light_runs_straight_the_maps_are_zero(laser):
    """Rationale: cold frames are rendered by the same code; nothing may be moved by rounding."""
    camera = forward_map(MapRequest(None, view(CAMERA), *CAMERA_BOX, MARCH, 1e-3))
    beam = inverse_map(MapRequest(None, laser, LASER_LOW, LASER_HIGH, MARCH, 1e-3))
    for each in (camera, beam):
        places = around(each.table.grid, 50)
        assert np.all(read(each.linear, places) == 0.0)
        assert np.all(each.at(places) == 0.0)
        assert each.linear_error_mm == 0.0


# --------------------------------------------------------------------------------- point by point


def test_rays_through_points_are_found_by_either_map(laser, mapped):
    """Rationale: projection and triangulation ask point by point; SciPy's rays must pass there."""
    more = np.array([1.0, 1.0, 0.0])
    box = LASER_LOW - more, LASER_HIGH + more
    ahead = forward_map(MapRequest(SPOT.field, laser, *box, MARCH, 1e-4))
    places = around(mapped.table.grid, 150)
    points = points_of(laser, places)
    for rays in (mapped.rays(points), ahead.rays(points)):
        np.testing.assert_array_equal(rays.status, MapStatus.OK)
        a, b = rays.coordinates.T
        arrived = sent(laser, a, b, places[:, 2])
        local = np.column_stack([arrived[:, :2], places[:, 2] - laser.distance_mm])
        np.testing.assert_allclose(centre(laser).to_world(local), points, rtol=0, atol=1e-4)
        slope = np.column_stack([arrived[:, 2:], np.ones(len(places))])
        heading = unit(slope @ laser.pose.rotation.T)
        np.testing.assert_allclose(rays.direction, heading, rtol=0, atol=1e-4)


def test_lines_of_sight_are_inverted_as_laser_rays_are():
    """Rationale: a projected point's pixel; the generic inverse knows of no family."""
    low, high = CAMERA_BOX
    camera = inverse_map(MapRequest(SPOT.field, view(CAMERA), low, high, MARCH, 1e-4))
    places = around(camera.table.grid, 100)
    s, t, depth = places.T
    points = CAMERA.to_world(np.stack([s * depth, t * depth, depth], axis=1))
    found = camera.rays(points)
    np.testing.assert_array_equal(found.status, MapStatus.OK)
    p, q = found.coordinates.T
    moved = spot_seen(p, q, depth)
    local = np.stack([p * depth + moved[:, 0], q * depth + moved[:, 1], depth], axis=1)
    np.testing.assert_allclose(CAMERA.to_world(local), points, rtol=0, atol=1e-4)
    assert np.abs(found.coordinates - places[:, :2]).max() > 1e-3


def test_places_off_a_map_are_said_to_be_off(laser, mapped):
    """Rationale: an extrapolated spline would give a plausible wrong ray; NaN has none either."""
    middle = 0.5 * (LASER_LOW + LASER_HIGH)
    places = np.tile(middle, (5, 1))
    places[1, 0], places[2, 1], places[3, 2] = LASER_LOW[0] - 2.0, LASER_HIGH[1] + 2.0, 50.0
    points = points_of(laser, places)
    points[4] = np.nan
    ahead = forward_map(MapRequest(SPOT.field, laser, LASER_LOW, LASER_HIGH, MARCH, 1e-3))
    status = [MapStatus.OK, *[MapStatus.OFF] * 4]
    for rays in (mapped.rays(points), ahead.rays(points)):
        np.testing.assert_array_equal(rays.status, status)
        assert np.isfinite(rays.coordinates[0]).all()
        assert np.isfinite(rays.direction[0]).all()
        assert np.isnan(rays.coordinates[1:]).all()
        assert np.isnan(rays.direction[1:]).all()
    places[4] = np.nan
    there = ahead.points(places)
    np.testing.assert_array_equal(there.status, status)
    assert np.isfinite(there.point_mm[0]).all()
    assert np.isnan(there.point_mm[1:]).all()
    assert np.isnan(ahead.at(places)[1:]).all()
    assert np.isfinite(ahead.at(places)[0]).all()
    for none in (mapped.rays(points[:0]), ahead.rays(points[:0])):
        assert none.coordinates.shape == (0, 2)
        assert none.status.shape == (0,)
    assert ahead.points(places[:0]).point_mm.shape == (0, 3)


def test_beyond_a_caustic_points_have_no_single_ray_and_rays_go_on():
    """Rationale: before the focus the lens has one ray for a point; behind it, no answer is right.

    The rays themselves are known there: x = a cos(w z / n0), as in the closed form.
    """
    low, high = SLAB_BOX
    contrast, far = 1.3, np.array([0.6, 0.0, 0.0])
    ahead = forward_map(MapRequest(slab(contrast), BEAM, low - far, high + far, MARCH, 1e-4))
    within_mm = np.linspace(2.0, FOCUS_MM, 40)
    phase = contrast * np.pi / 2.0 * within_mm / FOCUS_MM
    places = np.stack([np.full(40, 0.1), np.full(40, 0.5), 50.0 + within_mm], axis=1)
    seen = ahead.points(places)
    local = np.stack([0.1 * np.cos(phase), places[:, 1], places[:, 2]], axis=1)
    np.testing.assert_allclose(seen.point_mm, BEAM.pose.to_world(local), rtol=0, atol=1e-3)
    before, behind = np.cos(phase) > 0.05, np.cos(phase) < -0.05
    assert before.sum() > 20
    assert behind.sum() > 5
    np.testing.assert_array_equal(seen.status[before], MapStatus.OK)
    np.testing.assert_array_equal(seen.status[behind], MapStatus.FOLDED)
    rays = ahead.rays(BEAM.pose.to_world(local))
    near = np.cos(phase) > 0.4  # else the rays come from beyond the map
    np.testing.assert_array_equal(rays.status[near], MapStatus.OK)
    np.testing.assert_allclose(rays.coordinates[near], places[near, :2], rtol=0, atol=2e-3)
    assert not np.any(rays.status[behind] == MapStatus.OK)
    assert np.isnan(rays.coordinates[behind]).all()
