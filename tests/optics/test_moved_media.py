"""Rays through a medium that was moved are the moved rays; so are searches and derivatives."""

from dataclasses import dataclass
from typing import Any

import numpy as np
import oracles
import pytest
from artificial import HeldScene, paper_sensor
from oracles import unit
from scipy.spatial.transform import Rotation

import virtual_sensor as vs
from virtual_sensor import ray_search
from virtual_sensor.arrays import to_numpy, to_scalars, to_vectors
from virtual_sensor.devices.sensor import SensorModel
from virtual_sensor.engine import dr
from virtual_sensor.errors import InputError
from virtual_sensor.medium.exact_fields import hot_spot, linear, selfoc
from virtual_sensor.medium.index_field import IndexField
from virtual_sensor.optics.eikonal import after_length, bend, in_plane, never
from virtual_sensor.optics.ray_families import Pinhole
from virtual_sensor.optics.ray_maps import MapRequest, forward_map, inverse_map
from virtual_sensor.optics.ray_status import RayStatus
from virtual_sensor.optics.rays import March, Straight
from virtual_sensor.optics.sensitivity import line_sensitivity
from virtual_sensor.optics.steppers import STEPPERS
from virtual_sensor.optics.surfaces import Cylinder, NoSurface
from virtual_sensor.poses import Pose

TURN = Rotation.from_euler("xyz", [20.0, -35.0, 110.0], degrees=True)
MOTION = Pose(TURN.as_matrix(), np.array([30.0, -25.0, 12.0]))
BOX = np.array([[-40.0] * 3, [40.0] * 3])


def there(points):
    """Points after the motion, by SciPy."""
    return TURN.apply(points) + MOTION.origin_mm


@dataclass(frozen=True)
class Moved:
    """A surface after the motion: asked in its own place."""

    surface: Any

    def _own(self, origin, direction):
        rotation = MOTION.rotation.tolist()

        def back(v):
            return type(v)(*(sum(rotation[k][i] * v[k] for k in range(3)) for i in range(3)))

        return back(origin - type(origin)(*MOTION.origin_mm.tolist())), back(direction)

    def distance(self, origin, direction, limit, active):
        return self.surface.distance(*self._own(origin, direction), limit, active)

    def starts_inside(self, origin, direction):
        return self.surface.starts_inside(*self._own(origin, direction))


def plume(dimensions=3, interpolation="cubic"):
    """Hot air over a cylinder of 13.5 mm along x, rough enough to bend rays in any direction."""
    x, y, z = np.linspace(-40, 40, 9), np.linspace(-30, 30, 25), np.linspace(-20, 60, 33)
    shape = np.exp(-((y[:, None] / 9.0) ** 2) - ((z - 10.0) / 25.0) ** 2)
    nodes = -2e-3 * shape * (1.0 + 0.3 * np.cos(x / 20.0))[:, None, None]
    made = IndexField.from_arrays(nodes, [-40, -30, -20], [10.0, 2.5, 2.5], ambient=0.0)
    return made.simplified(interpolation, dimensions)


STARTS = np.random.default_rng(1).uniform(-1, 1, (40, 3)) * [20.0, 15.0, 8.0] + [0.0, 0.0, 90.0]
AIMS = np.random.default_rng(2).uniform(-1, 1, (40, 3)) * [20.0, 12.0, 5.0]


def rays(field, starts, aims, march, surface, remaining=None, normal=None, **how):
    """Where rays end: position, tangent, derivatives, excess of arc and path, status."""
    line = Straight.through(to_vectors(starts), to_vectors(unit(aims - starts)), march)
    ends = never
    if remaining == "length":
        ends = after_length(march.scalar(85.0))
    elif remaining == "plane":
        at = march.scalar(to_scalars(aims @ normal))
        vector = march.vector(*normal.tolist())
        ends = in_plane(vector, at - dr.dot(vector, line.anchor))
    ray = bend(field, surface, line, march, remaining=ends, **how)
    dr.eval(ray)
    vectors = [to_numpy(v) for v in (*ray.offset[1:], *ray.tau[1:])]
    scalars = np.array([ray.arc, ray.path], float)
    tangent = to_numpy(ray.tangent(line))
    return to_numpy(ray.position(line)), tangent, vectors, scalars, np.array(ray.status)


def assert_moved(field, march, tolerance, surface=None, remaining=None, tangents=0, air=()):
    """A march in the moved field, towards the moved surface, is the moved march."""
    none = dr.zeros(march.vector, len(STARTS))
    x, y, z = (none + march.vector(*axis) for axis in np.eye(3).tolist())
    turned = [none + march.vector(*axis) for axis in MOTION.rotation.T.tolist()]
    by = [
        tuple([(v, none) for v in axes] + [(none, v) for v in axes])[:tangents]
        for axes in ((x, y, z), turned)
    ]
    normal = unit(np.array([0.2, -0.1, 1.0]))
    still = rays(
        field,
        STARTS,
        AIMS,
        march,
        surface or NoSurface(),
        remaining,
        normal,
        tangents=by[0],
        variations=tuple(air),
    )
    found = rays(
        field.moved(MOTION),
        there(STARTS),
        there(AIMS),
        march,
        Moved(surface) if surface else NoSurface(),
        remaining,
        TURN.apply(normal),
        tangents=by[1],
        variations=tuple(each.moved(MOTION) for each in air),
    )
    np.testing.assert_array_equal(found[4], still[4])
    np.testing.assert_allclose(found[0], there(still[0]), rtol=0, atol=tolerance)
    np.testing.assert_allclose(found[1], TURN.apply(still[1]), rtol=0, atol=tolerance)
    np.testing.assert_allclose(found[3], still[3], rtol=0, atol=tolerance)
    for one, other in zip(found[2], still[2], strict=True):
        np.testing.assert_allclose(one, TURN.apply(other), rtol=0, atol=100 * tolerance)
    return still


@pytest.mark.parametrize("method", STEPPERS)
def test_a_march_in_a_moved_field_is_the_moved_march(method):
    """Every method, on the same spline, onto a part that moved along."""
    *_, status = assert_moved(plume(), March(1.0, method), 1e-9, Cylinder())
    assert {RayStatus.HIT, RayStatus.LEFT} <= set(status)


@pytest.mark.parametrize("remaining", ["length", "plane"])
def test_rays_end_where_they_are_asked_to(remaining):
    """A length and a plane are the world's; both end rays within the air."""
    *_, status = assert_moved(plume(), March(0.7, "leapfrog"), 1e-9, remaining=remaining)
    assert np.mean(status == RayStatus.ENDED) > 0.9


def test_derivatives_are_carried_along():
    """By start and heading, and by the field's contrast."""
    field = plume()
    *_, status = assert_moved(
        field, March(0.7, "leapfrog"), 1e-9, Cylinder(), tangents=6, air=[field]
    )
    assert np.any(status == RayStatus.HIT)


@pytest.mark.parametrize(("dimensions", "interpolation"), [(2, "cubic"), (3, "linear")])
def test_a_simpler_field_moves_too(dimensions, interpolation):
    assert_moved(plume(dimensions, interpolation), March(1.0, "leapfrog"), 1e-9, Cylinder())


def test_the_deflection_integral_moves_too():
    assert_moved(plume(), March(1.0, "rk4", first_order=True), 1e-9, Cylinder())


def test_float32_is_as_good_in_a_moved_field():
    """A tenth of a thousandth of a pixel of 22 um, as world coordinates of 100 mm allow."""
    assert_moved(plume(), March(1.0, "leapfrog", "single"), 4e-5)


def test_a_variation_elsewhere_than_its_field_is_refused():
    """Derivatives by one air of rays through another have no meaning."""
    field = plume()
    for one, other in ((field, field.moved(MOTION)), (field.moved(MOTION), field)):
        line = Straight.through(to_vectors(STARTS), to_vectors(unit(AIMS - STARTS)), March())
        with pytest.raises(InputError, match="same motions"):
            bend(one, NoSurface(), line, March(), variations=(other,))


# ------------------------------------------------------------------------------- closed-form rays

OMEGA, N0 = 0.02, 1.5
INNER = np.array([[-12.0, 3.0, 1.0], [-10.0, -4.0, 5.0], [-14.0, 0.5, -2.0]])
AHEAD = unit([[1.0, 0.2, -0.1], [1.0, 0.0, 0.3], [1.0, -0.3, 0.2]])
CLOSED = {
    "linear": (linear(N0, (0.0, 0.01, -0.02), box=BOX), oracles.linear, (N0, (0.0, 0.01, -0.02))),
    "selfoc": (selfoc(N0, OMEGA, box=BOX), oracles.parabolic, (N0, (0.0, N0 * OMEGA, N0 * OMEGA))),
}


@pytest.mark.parametrize("name", CLOSED)
def test_rays_in_turned_closed_form_fields(name):
    """Parabolas and swings, turned with their field: the paths are the textbooks'."""
    field, path, arguments = CLOSED[name]
    found = vs.trace(field.moved(MOTION), there(INNER), TURN.apply(AHEAD), 30.0, 0.05)
    assert np.all(found.status == RayStatus.ENDED)
    for k, (start, heading) in enumerate(zip(INNER, AHEAD, strict=True)):
        exact = path(*arguments, start, heading)
        t = exact.t_at_arc(30.0)
        position, tangent = there(exact.position(t)), TURN.apply(exact.tangent(t))
        np.testing.assert_allclose(found.position[k], position, rtol=0, atol=1e-7)
        np.testing.assert_allclose(found.direction[k], unit(tangent), rtol=0, atol=1e-7)
        np.testing.assert_allclose(found.optical_path_mm[k], exact.optical_path(t), atol=1e-7)


def test_a_traced_ray_leaves_a_field_where_that_is_now():
    """Whether it ended within is asked at the field's place, and its index is the moved one's."""
    field = hot_spot(0.02, 8.0, box=BOX).moved(Pose(np.eye(3), np.array([500.0, 0.0, 0.0])))
    found = vs.trace(field, [[440.0, 3.0, 0.0]], [[1.0, 0.0, 0.0]], 90.0)
    assert found.status[0] == RayStatus.ENDED
    through = vs.trace(field, [[440.0, 3.0, 0.0]], [[1.0, 0.0, 0.0]], 200.0)
    assert through.status[0] == RayStatus.LEFT
    assert abs(through.direction[0, 1]) > 1e-3
    beside = vs.trace(field, [[0.0, 3.0, 0.0]], [[0.0, 0.0, 1.0]], 90.0)
    np.testing.assert_array_equal(beside.direction, [[0.0, 0.0, 1.0]])


# ------------------------------------------------------------------------------- the whole sensor


@pytest.fixture(scope="module")
def scene():
    return HeldScene(paper_sensor(fan_deg=6.0), vs.load_scene("hot_cylinder").medium, Cylinder())


@pytest.fixture(scope="module")
def moved(scene):
    """The same with part, air and sensor moved together."""
    parts = (scene.sensor.camera, scene.sensor.laser)
    camera, laser = (part.with_pose(part.pose.moved(MOTION)) for part in parts)
    return HeldScene(SensorModel(camera, laser), scene.medium.moved(MOTION), Moved(scene.surface))


Y = np.linspace(-9.8, 9.6, 9)

# A turn about x after which the cylinder still lies along x.
AXIAL = Pose(Rotation.from_euler("x", 25.0, degrees=True).as_matrix(), np.array([0.0, 40.0, -7.0]))
AXIS = AXIAL.to_world(np.array([0.0, 0.0, -13.5]))
AXIAL_CYLINDER = Cylinder(axis_y_mm=float(AXIS[1]), axis_z_mm=float(AXIS[2]))


@pytest.mark.parametrize("method", ["paper", "newton"])
def test_a_search_in_a_moved_scene_finds_the_same_pixels(scene, moved, method):
    still, found = (ray_search(each, Y, method) for each in (scene, moved))
    np.testing.assert_array_equal(found.status, still.status)
    np.testing.assert_allclose(found.pixel, still.pixel, rtol=0, atol=1e-6)
    points = there(still.laser_point_mm)
    np.testing.assert_allclose(found.laser_point_mm, points, rtol=0, atol=1e-8)


def test_ray_maps_of_a_moved_scene_are_the_same(scene, moved):
    """Forward and inverse, of a camera in air that moved with it."""
    low, high = np.array([-0.04, -0.04, 295.0]), np.array([0.04, 0.04, 303.0])
    march = March(2.0, "leapfrog")
    places = low + (high - low) * np.random.default_rng(3).random((60, 3))
    for make in (forward_map, inverse_map):
        still, found = (
            make(MapRequest(each.medium, each.sensor.camera, low, high, march, 1e-4))
            for each in (scene, moved)
        )
        assert isinstance(scene.sensor.camera, Pinhole)
        assert found.nodes == still.nodes
        assert found.largest_mm > 0.05
        np.testing.assert_allclose(found.at(places), still.at(places), rtol=0, atol=1e-9)


def test_derivatives_of_a_moved_scene_are_turned_ones(scene):
    """By shifts along axes that moved along; in air cut off where it pulls, which counts too."""
    cut = scene.medium.with_nodes(scene.medium.nodes[:, :, :54])
    still = HeldScene(scene.sensor, cut, Cylinder())
    expected = line_sensitivity(still, Y).of_pixel
    parts = (scene.sensor.camera, scene.sensor.laser)
    camera, laser = (part.with_pose(part.pose.moved(AXIAL)) for part in parts)
    there = HeldScene(SensorModel(camera, laser), cut.moved(AXIAL), AXIAL_CYLINDER)
    found = line_sensitivity(there, Y).of_pixel
    for body in ("camera", "laser", "sensor"):
        by = [np.stack([each[f"{body}_{a}"] for a in "xyz"], axis=-1) for each in (expected, found)]
        np.testing.assert_allclose(by[1] @ AXIAL.rotation, by[0], rtol=0, atol=5e-5)
