"""Which laser ray lights a point: sent off again, it must arrive there with its share of flux."""

from dataclasses import replace

import numpy as np
import pytest
from oracles import unit

import virtual_sensor as vs
from virtual_sensor.arrays import to_numpy, to_vectors
from virtual_sensor.engine import dr, mi
from virtual_sensor.medium.exact_fields import ExactField
from virtual_sensor.optics.eikonal import March, Straight, bend, in_plane
from virtual_sensor.optics.illumination import LightStatus, illuminate
from virtual_sensor.optics.ray_families import Sheet
from virtual_sensor.optics.ray_status import RayStatus
from virtual_sensor.optics.surfaces import NoSurface
from virtual_sensor.poses import Pose

MARCH = March(step_mm=0.5, method="leapfrog")


@pytest.fixture(scope="module")
def scene():
    return vs.load_scene("hot_cylinder")


@pytest.fixture(scope="module", params=[0.0, 6.0], ids=["telecentric", "fan"])
def laser(request, scene):
    fan_per_mm = 2.0 * np.tan(np.radians(request.param / 2.0)) / scene.sensor.laser.length_mm
    return replace(scene.sensor.laser.family, fan_per_mm=fan_per_mm)


def on_cylinder(angle, x):
    """Points of the paper's cylinder, by the angle from its top line, in world mm."""
    y, z = 13.5 * np.sin(angle), 13.5 * np.cos(angle) - 13.5
    return np.stack(np.broadcast_arrays(x, y, z), axis=-1)


@pytest.fixture(scope="module")
def points():
    """Round the top of the cylinder, within the laser line and a millimetre to either side."""
    rng = np.random.default_rng(1)
    return on_cylinder(rng.uniform(-0.85, 0.85, 60), rng.uniform(-1.0, 3.0, 60))


def light_at(laser, field, surface, points, march=MARCH, active=True, near=None):
    p, mask = march.vector(to_vectors(points)), mi.Mask(np.broadcast_to(active, len(points)))
    light = illuminate(laser, field, surface, p, march, near=near, active=mask)
    dr.eval(light)
    return light


def arrivals(laser, field, a, b, points):
    """Where laser rays, sent off from the exit, cross the planes square to the axis at points."""
    origins, directions = laser.rays(a, b)
    axis = laser.pose.rotation[:, 2]
    line = Straight.through(to_vectors(origins), to_vectors(directions), MARCH)
    offset = (to_vectors(points) - line.anchor) @ mi.Array3f64(axis)
    ends = in_plane(mi.Array3f64(axis), offset)
    ray = bend(field, NoSurface(), line, MARCH, remaining=ends)
    assert np.all(np.array(ray.status) == RayStatus.ENDED)
    return to_numpy(ray.position(line)), unit(to_numpy(ray.tangent(line)))


def numbers(*values):
    return tuple(np.array(v, float) for v in values)


def test_the_ray_that_was_found_arrives_at_the_point(scene, laser, points):
    """To a hundredth of a micrometre, where the bent rays go astray by a tenth of a millimetre."""
    light = light_at(laser, scene.field, scene.surface, points)
    assert np.all(np.array(light.status) == LightStatus.LIT)
    a, b = numbers(light.s, light.t)
    arrived, heading = arrivals(laser, scene.field, a, b, points)
    np.testing.assert_allclose(arrived, points, rtol=0, atol=1e-5)
    np.testing.assert_allclose(to_numpy(light.heading), heading, rtol=0, atol=1e-6)
    assert np.abs(light.shift[1]).max() > 0.1


def test_where_light_runs_straight_it_is_plain_geometry(scene, laser, points):
    """The ray of the very coordinates passes through the point, and nothing is shifted."""
    light = light_at(laser, None, scene.surface, points)
    a, b = numbers(light.s, light.t)
    origins, directions = laser.rays(a, b)
    np.testing.assert_allclose(np.cross(points - origins, directions), 0.0, rtol=0, atol=1e-9)
    np.testing.assert_allclose(to_numpy(light.heading), directions, rtol=0, atol=1e-14)
    np.testing.assert_allclose(numbers(*light.shift), 0.0, rtol=0, atol=1e-10)


def area_between(laser, field, a, b, points, e):
    """Area square to the light that the tube of rays a +- e, b +- e has at the points, in mm^2."""
    ends = {
        (i, j): arrivals(laser, field, a + i * e, b + j * e, points)[0]
        for i, j in ((1, 0), (-1, 0), (0, 1), (0, -1))
    }
    heading = arrivals(laser, field, a, b, points)[1]
    sides = ends[1, 0] - ends[-1, 0], ends[0, 1] - ends[0, -1]
    return np.einsum("ij,ij->i", np.cross(*sides), heading)


@pytest.mark.parametrize("hot", [False, True], ids=["cold", "hot"])
def test_flux_is_conserved_between_neighbouring_rays(scene, laser, points, hot):
    """What (2e)^2 carries through the reference plane is spread over the tube's area."""
    field, e = (scene.field if hot else None), 1e-3
    light = light_at(laser, field, scene.surface, points)
    a, b, concentration = numbers(light.s, light.t, light.concentration)
    expected = (2.0 * e) ** 2 / area_between(laser, field, a, b, points, e)
    np.testing.assert_allclose(concentration, expected, rtol=0.01 if hot else 1e-8)
    if hot:
        assert np.ptp(concentration) > 0.05  # hot air makes bright and dark places


def test_nothing_lights_the_back_of_the_cylinder(scene, laser):
    """Beyond the terminator, 90 degrees from the top, the cylinder stands in its own light."""
    angle = np.concatenate([np.linspace(-1.3, 1.3, 9), np.linspace(1.8, 2.0 * np.pi - 1.8, 12)])
    light = light_at(laser, scene.field, scene.surface, on_cylinder(angle, 0.0))
    a, b, concentration = numbers(light.s, light.t, light.concentration)
    status = np.array(light.status)
    np.testing.assert_array_equal(status[:9], LightStatus.LIT)
    np.testing.assert_array_equal(status[9:], LightStatus.SHADOWED)
    assert np.all(np.isnan(a[9:]) & np.isnan(b[9:]) & (concentration[9:] == 0.0))
    assert np.all(np.isfinite(a[:9]) & np.isfinite(b[:9]))


def test_a_guess_changes_nothing_but_the_work(scene, laser, points):
    """From the answer half a pixel away the same rays are found as from none."""
    alone = light_at(laser, scene.field, scene.surface, points)
    near = light_at(laser, scene.field, scene.surface, points + np.array([0.01, 0.01, 0.0]))
    led = light_at(laser, scene.field, scene.surface, points, near=near)
    for mine, theirs in ((led.s, alone.s), (led.t, alone.t)):
        np.testing.assert_allclose(*numbers(mine, theirs), rtol=0, atol=5e-5)
    np.testing.assert_array_equal(np.array(led.status), np.array(alone.status))
    np.testing.assert_allclose(*numbers(led.concentration, alone.concentration), rtol=0.01)


def test_float32_finds_the_same_rays(scene, points):
    """What the renderer computes with: a tenth of a micrometre."""
    laser = scene.sensor.laser.family
    exact = light_at(laser, scene.field, scene.surface, points)
    single = light_at(laser, scene.field, scene.surface, points, March(0.5, "leapfrog", "single"))
    np.testing.assert_allclose(*numbers(single.s, exact.s), rtol=0, atol=1e-4)
    np.testing.assert_allclose(*numbers(single.t, exact.t), rtol=0, atol=1e-4)
    np.testing.assert_allclose(*numbers(single.concentration, exact.concentration), rtol=1e-4)


def test_inactive_points_are_left_alone(scene, points):
    active = np.arange(len(points)) % 3 > 0
    light = light_at(scene.sensor.laser.family, scene.field, scene.surface, points, active=active)
    a, concentration = numbers(light.s, light.concentration)
    np.testing.assert_array_equal(np.isfinite(a), active)
    np.testing.assert_array_equal(concentration > 0.0, active)


# ---------------------------------------------------------------------- beyond a line focus


def slab_lens(p):
    """n^2 = 1.5^2 - (0.05 z)^2: rays along x cross the plane z = 0 after a quarter pitch.

    A millionth of that across y, since Dr.Jit takes for constant what at first does not change.
    """
    curvature = type(p)(0.0, 1e-6 * 0.05**2, 0.05**2)
    hessian = mi.Matrix3f64(dr.diag(-2.0 * curvature))
    return 2.25 - dr.dot(curvature, p * p), -2.0 * curvature * p, hessian


def test_light_that_has_crossed_a_line_focus_is_not_made_up():
    """One ray arrives at each point before the focus, z0 = z / cos(w t); then the map folds."""
    field = ExactField(slab_lens, box=np.array([[0.0, -20.0, -20.0], [200.0, 20.0, 20.0]]))
    axes = [[0.0, 0.0, 1.0], [0.0, -1.0, 0.0], [1.0, 0.0, 0.0]]
    pose = Pose(np.stack(axes, axis=-1), np.zeros(3))
    laser = Sheet(pose, 50.0)
    focus = 1.5 * np.pi / 2.0 / 0.05
    fraction = np.array([0.2, 0.5, 0.8, 1.3, 1.6])
    points = np.stack(np.broadcast_arrays(focus * fraction, 0.3, 0.05), axis=-1)
    light = light_at(laser, field, NoSurface(), points, March(0.2))
    expected = [LightStatus.LIT] * 3 + [LightStatus.FOLDED] * 2
    np.testing.assert_array_equal(np.array(light.status), expected)
    a, b, concentration = numbers(light.s, light.t, light.concentration)
    gain = 1.0 / np.cos(np.pi / 2.0 * fraction[:3])
    np.testing.assert_allclose(a[:3], 0.05 * gain, rtol=1e-4)
    np.testing.assert_allclose(b[:3], -0.3, rtol=1e-5)
    np.testing.assert_allclose(concentration[:3], gain, rtol=1e-3)
    assert np.all(np.isnan(a[3:]) & (concentration[3:] == 0.0))
