"""Where bent rays fail: each failure has a status, or is one that no status can know of."""

import numpy as np
import pytest
from oracles import integrate

import virtual_sensor as vs
from virtual_sensor import IndexField, InputError, RayStatus
from virtual_sensor.arrays import to_numpy, to_vectors
from virtual_sensor.engine import dr, mi
from virtual_sensor.imaging.checks import check_scene
from virtual_sensor.medium.exact_fields import ExactField, hot_spot, linear
from virtual_sensor.optics.eikonal import March, Straight, bend, never
from virtual_sensor.optics.field_border import JUMP_REFUSED_PX
from virtual_sensor.optics.sight import incidence_points, lines_of_sight, seen_points
from virtual_sensor.optics.surfaces import Cylinder, NoSurface

TOO_MUCH_PX, MM_PER_PX = 0.01, 0.022
MARCHES = (
    March(0.05, "euler", "double"),
    March(2.0, "leapfrog", "double"),
    March(2.0, "leapfrog", "single"),
    March(2.0, "sharma", "double"),
    March(2.0, "rk4", "double"),
    March(10.0, "dopri5", "double"),
    March(10.0, "dopri5", "single"),
)

# n^2 falls linearly from 1 at z = -40 mm to 0.2 at z = 40: a ray is thrown back like a stone.
FALL, FLOOR_MM, CEILING_MM = 0.01, -40.0, 40.0
RADIUS_MM, AXIS_Z_MM = 13.5, -13.5  # of the paper's cylinder
LAYER_DIP, LAYER_MM = 5e-4, 8.0  # of hot air round it


def march_rays(field, starts, directions, march, surface):
    """Positions (N, 3) in mm and status (N,) of rays that run on until something stops them."""
    line = Straight.through(to_vectors(starts), to_vectors(directions), march)
    ray = bend(field, surface, line, march, remaining=never)
    dr.eval(ray)
    return to_numpy(ray.position(line)), np.array(ray.status)


def throwing_field():
    box = np.array([[-900.0, -900.0, FLOOR_MM], [900.0, 900.0, CEILING_MM]])
    return linear(float(np.sqrt(1.0 + FALL * FLOOR_MM)), (0.0, 0.0, -FALL), box=box)


# ------------------------------------------------------------------------------- rays with a status


@pytest.mark.parametrize("march", MARCHES, ids=str)
def test_rays_are_turned_back_where_total_reflection_says(march):
    """TURNED_BACK under the critical angle and LEFT over it; on the parabola's other foot.

    The border, which is overstepped by up to 2 um, costs 0.02 px in so strong a field.
    """
    T_z = np.sqrt(FALL * (CEILING_MM - FLOOR_MM)) + np.linspace(-0.15, 0.05, 101)
    directions = np.stack([np.sqrt(1.0 - T_z**2), 0.0 * T_z, T_z], axis=1)
    starts = [-100.0, 0.0, FLOOR_MM] - 10.0 * directions
    position, status = march_rays(throwing_field(), starts, directions, march, NoSurface())
    apex_mm = T_z**2 / FALL + FLOOR_MM  # like stones
    clear = abs(apex_mm - CEILING_MM) > 0.01  # the border is overstepped by some um
    back = clear & (apex_mm < CEILING_MM)
    assert np.all(status[back] == RayStatus.TURNED_BACK)
    assert np.all(status[clear & ~back] == RayStatus.LEFT)
    # The range of a stone; it ends a little under the floor, along its last slope.
    reached = -100.0 + 4.0 * T_z * directions[:, 0] / FALL
    reached += (FLOOR_MM - position[:, 2]) * directions[:, 0] / T_z
    miss_px = abs(position[:, 0] - reached) * T_z / MM_PER_PX
    assert back.sum() > 50
    assert miss_px[back].max() < (3.0 if march.method == "euler" else 0.1)


def hot_layer(dip):
    """n^2 = 1 - dip exp(-(rho^2 - R^2) / 2w^2) round the paper's cylinder."""

    def n_squared(p):
        across = type(p)(0.0, p.y, p.z - AXIS_Z_MM)
        fall = dip * dr.exp((RADIUS_MM**2 - dr.squared_norm(across)) / (2.0 * LAYER_MM**2))
        matrix = mi.Matrix3f64 if dr.type_v(p) == dr.VarType.Float64 else mi.Matrix3f
        return 1.0 - fall, across * (fall / LAYER_MM**2), dr.zeros(matrix)  # no derivatives asked

    return ExactField(n_squared, box=np.array([[-100.0, -70.0, -83.5], [100.0, 70.0, 56.5]]))


def silhouette(march, field, count=1001, rounds=3):
    """How far from Bouguer's n(R) R the last HIT is, px; each round samples closer.

    All are HIT or LEFT, and none is HIT beyond one that missed by more than rounding.
    """
    expected = RADIUS_MM * np.sqrt(1.0 - LAYER_DIP)
    low, high = expected - 0.5, expected + 0.5
    rounding_mm = 1e-5 if march.precision == "single" else 1e-12  # of positions near the part
    for _ in range(rounds):
        b = np.linspace(low, high, count)
        starts = np.stack([0.0 * b, 0.0 * b - 100.0, AXIS_Z_MM + b], axis=1)
        directions = np.tile([0.0, 1.0, 0.0], (count, 1))
        _, status = march_rays(field, starts, directions, march, Cylinder())
        hit = status == RayStatus.HIT
        assert np.all(hit | (status == RayStatus.LEFT))
        assert not np.any(hit & (b > np.append(b[~hit], np.inf)[0] + rounding_mm))
        last = int(np.flatnonzero(hit)[-1]) if hit.any() else 0
        low, high = b[max(last - 1, 0)], b[min(last + 2, count - 1)]
    return abs(0.5 * (low + high) - expected) / MM_PER_PX


@pytest.mark.parametrize("march", MARCHES, ids=str)
def test_no_ray_both_meets_and_misses_the_silhouette(march):
    """The last HIT is at Bouguer's n(R) R, all beyond are LEFT, and no third thing happens."""
    assert silhouette(march, hot_layer(LAYER_DIP)) < TOO_MUCH_PX


def test_straight_rays_do_not_find_the_silhouette():
    """They miss it by much more than is allowed above: there, the layer must bend them."""
    for march in MARCHES[1:3]:
        assert silhouette(march, hot_layer(1e-12)) > 10 * TOO_MUCH_PX


def test_scipys_ray_grazes_the_cylinder_where_bouguer_says():
    """The silhouette's n(R) R, by another integrator in the same layer of hot air."""

    def layer(p):
        across = p * [0.0, 1.0, 1.0] - [0.0, 0.0, AXIS_Z_MM]
        rho2 = np.sum(across**2, axis=1)
        dip = LAYER_DIP * np.exp((RADIUS_MM**2 - rho2) / (2.0 * LAYER_MM**2))
        n = np.sqrt(1.0 - dip)
        return n, across * (dip / (2.0 * LAYER_MM**2 * n))[:, None]

    points = np.random.default_rng(3).uniform(-30.0, 30.0, (50, 3))
    marched = hot_layer(LAYER_DIP).delta_and_gradient(to_vectors(points))
    np.testing.assert_allclose(marched[0], layer(points)[0] - 1.0, rtol=0, atol=1e-15)
    np.testing.assert_allclose(to_numpy(marched[1]), layer(points)[1], rtol=0, atol=1e-16)
    start = [0.0, -100.0, AXIS_Z_MM + RADIUS_MM * np.sqrt(1.0 - LAYER_DIP)]
    ray = integrate(layer, [start], [[0.0, 1.0, 0.0]], 200.0)
    arcs = np.linspace(90.0, 110.0, 2001)
    path = np.array([ray.position(arc)[0] for arc in arcs])
    nearest = np.hypot(path[:, 1], path[:, 2] - AXIS_Z_MM).min()
    assert nearest == pytest.approx(RADIUS_MM, abs=1e-5)


def test_a_ray_out_of_steps_says_so():
    rays = vs.trace(throwing_field(), [[0.0, 0.0, 0.0]], [[1.0, 0.0, 0.0]], 50.0, 0.001)
    assert rays.status == [RayStatus.OUT_OF_STEPS]


def test_a_start_that_is_no_number_is_refused_and_never_hits():
    field, nowhere = throwing_field(), np.array([[np.nan, 0.0, 0.0]])
    with pytest.raises(InputError, match="finite"):
        vs.trace(field, nowhere, [[1.0, 0.0, 0.0]], 10.0)
    for surface in (NoSurface(), Cylinder()):  # within the program
        position, status = march_rays(field, nowhere, np.eye(3)[:1], MARCHES[1], surface)
        assert status != RayStatus.HIT
        assert not np.isfinite(position).all()


# ----------------------------------------------------------------------- what no status can know of


@pytest.mark.parametrize(("carries", "loses"), [("difference", False), ("position", True)])
def test_absolute_positions_in_float32_lose_what_the_difference_keeps(carries, loses):
    """Thousands of times as much: the reason why the march carries the difference.

    Rays that start 300 mm off, through a ball of hot air, beside the same in float64.
    """
    y = np.linspace(-10.0, 10.0, 201)
    starts = np.stack([0.0 * y - 300.0, y + 20.0, 0.0 * y + 7.0], axis=1)
    directions = np.tile([1.0, -20.0 / 300.0, -6.0 / 300.0], (y.size, 1))
    directions /= np.linalg.norm(directions, axis=1, keepdims=True)
    run = {"difference": offset_behind_the_ball, "position": position_behind_the_ball}[carries]
    single, double = (
        run(starts.astype(dtype), directions.astype(dtype)) for dtype in (np.float32, np.float64)
    )
    along = np.einsum("ij,ij->i", single - double, directions)[:, None] * directions
    lost_px = np.linalg.norm(single - double - along, axis=1).max() / MM_PER_PX
    assert (lost_px > TOO_MUCH_PX) if loses else (lost_px < 1e-4)


def offset_behind_the_ball(starts, directions):
    """What the march carries: the offset from the straight ray, 100 mm behind the middle."""
    field = hot_spot(4e-4, 5.0, box=np.array([[-60.0] * 3, [60.0] * 3]))
    march = March(0.5, "leapfrog", "single" if starts.dtype == np.float32 else "double")
    exact = to_vectors(starts.astype(float)), to_vectors(directions.astype(float))
    line = Straight.through(*exact, march)
    ray = bend(field, NoSurface(), line, march)
    dr.eval(ray)
    rest = (100.0 - np.array(ray.t, float))[:, None]
    return to_numpy(ray.offset[0]) + to_numpy(ray.tau[0]) * rest


def position_behind_the_ball(starts, directions):
    """What one writes first: r and T themselves, step by step, all in one precision."""
    r, T = starts, directions
    h, limit, w2, depth = (starts.dtype.type(x) for x in (0.5, 60.0, 25.0, 4e-4))
    for _ in range(800):
        r = r + T * (h / 2)
        inside = np.all(abs(r) < limit, axis=1)[:, None]
        dip = depth * np.exp(-np.sum(r**2, axis=1, keepdims=True) / (2 * w2))
        T = T + np.where(inside, r * (dip / (2 * w2)) * h, 0).astype(starts.dtype)
        r = r + T * (h / 2)
    return r.astype(float)


class Plume:
    """Lines of sight through the shipped hot air, and where they truly end."""

    def __init__(self):
        self.scene = vs.load_scene("hot_cylinder")
        self.field = self.scene.field
        cold, camera = self.scene.cold(), self.scene.camera
        pixel = camera.project(incidence_points(cold, np.linspace(-10.0, 10.0, 60)))
        self.starts, self.directions = lines_of_sight(camera, pixel)
        self.length_mm = np.linalg.norm(seen_points(cold, pixel) - self.starts, axis=1)
        self.truth = self.ends(self.field, 0.2)

    def ends(self, field, step_mm=2.0, method="rk4"):
        rays = vs.trace(field, self.starts, self.directions, self.length_mm, step_mm, method)
        assert np.all(np.isin(rays.status, (RayStatus.ENDED, RayStatus.LEFT)))
        return rays.position

    def errors_px(self, field, step_mm=2.0, method="rk4", truth=None):
        """Error (N,) of each ray, square to it."""
        apart = self.ends(field, step_mm, method) - (self.truth if truth is None else truth)
        along = np.einsum("ij,ij->i", apart, self.directions)[:, None] * self.directions
        return np.linalg.norm(apart - along, axis=1) / MM_PER_PX


@pytest.fixture(scope="module")
def plume():
    return Plume()


def thinned(field, k):
    """Every k-th node along each axis."""
    return field.with_nodes(field.nodes[::k, ::k, ::k], spacing_mm=field.spacing * k)


def test_long_steps_are_wrong_by_more_and_more(plume):
    """Leapfrog's 2 mm are fine, and 16 mm are not."""
    errors = [plume.errors_px(plume.field, step, "leapfrog").max() for step in (2.0, 8.0, 16.0)]
    assert errors[0] < TOO_MUCH_PX < errors[1] < errors[2]


def test_coarse_grids_are_wrong_by_more_and_more(plume):
    """Cubic loses to thinning, and linear is lost with all nodes; nothing but comparing tells."""
    errors = [plume.errors_px(thinned(plume.field, k)).max() for k in (1, 2, 4)]
    assert errors[0] < TOO_MUCH_PX < errors[1] < errors[2]
    assert plume.errors_px(plume.field.simplified("linear")).max() > TOO_MUCH_PX


def test_noise_spoils_numbers_but_no_status(plume):
    """Every ray still ends, at a place that is off in proportion to the noise."""
    noise = np.random.default_rng(5).normal(size=plume.field.shape)
    hotter = plume.field.nodes - plume.field.ambient
    errors = [
        plume.errors_px(plume.field.with_nodes(plume.field.nodes + hotter * level * noise)).max()
        for level in (1e-5, 1e-2, 1e-1)
    ]
    assert errors[0] < TOO_MUCH_PX < errors[1]
    assert errors[2] == pytest.approx(10.0 * errors[1], rel=0.5)


def test_a_trilinear_gradient_costs_the_order_and_leaves_a_floor(plume):
    """Shorter steps do not help: 0.1 px and more remain, and order 4 is lost."""
    field, steps = plume.field.simplified("linear"), (2.0, 1.0, 0.5)
    errors = [plume.errors_px(field, step).max() for step in steps]
    assert min(errors) > 0.1
    assert errors[0] == pytest.approx(errors[2], rel=0.1)
    limit = plume.ends(field, steps[-1] / 8.0)
    own = [np.sqrt(np.mean(plume.errors_px(field, step, truth=limit) ** 2)) for step in steps]
    assert np.polyfit(np.log(steps), np.log(own), 1)[0] < 2.5


def test_a_cropped_plume_is_refused(plume):
    """The march leaves the jump out and is off; the scene is refused before it is measured."""
    field = plume.field.with_nodes(plume.field.nodes[:, :, : plume.field.shape[2] // 5])
    assert plume.errors_px(field).max() > TOO_MUCH_PX
    with pytest.raises(InputError, match="does not fade to ambient"):
        check_scene(plume.scene.with_medium(field))


def test_a_flat_border_does_not_refract():
    """The march goes straight where Snell's law turns: known, and more than the check lets pass."""
    ambient, jump, depth_mm, sine = 2.7e-4, 2e-4, 100.0, np.sqrt(0.5)
    nodes = np.full((4, 4, 4), ambient - jump)
    field = IndexField.from_arrays(nodes, [-200.0, -200.0, 0.0], [150.0] * 3, ambient=ambient)
    direction = np.array([sine, 0.0, sine])
    ray = vs.trace(field, [-10.0 * direction], [direction], 10.0 + depth_mm / sine)
    inside = sine * (1.0 + ambient) / (1.0 + ambient - jump)
    snells = depth_mm * inside / np.sqrt(1.0 - inside**2)
    assert abs(ray.position[0, 0] - snells) * sine / MM_PER_PX > JUMP_REFUSED_PX


def test_noise_does_not_stop_rays():
    """In a field of pure noise, of the strength of hot air, all rays come out."""
    rng = np.random.default_rng(8)
    field = IndexField.from_arrays(
        1e-4 * rng.normal(size=(20, 20, 20)), [-10.0] * 3, [1.0] * 3, ambient=0.0
    )
    starts = np.stack([np.full(50, -20.0), *rng.uniform(-8.0, 8.0, (2, 50))], axis=1)
    for method in ("leapfrog", "dopri5"):
        rays = vs.trace(field, starts, np.tile([1.0, 0, 0], (50, 1)), 60.0, 1.0, method, "single")
        assert np.all(rays.status == RayStatus.LEFT)
        assert np.isfinite(rays.position).all()
