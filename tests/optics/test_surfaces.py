"""What stops a ray: the analytic cylinder against its own points, Mitsuba's shapes against it."""

import numpy as np
import pytest
from oracles import unit

import virtual_sensor as vs
from virtual_sensor.arrays import to_numpy, to_vectors
from virtual_sensor.engine import dr, mi
from virtual_sensor.optics.eikonal import March, Straight, bend
from virtual_sensor.optics.ray_status import RayStatus
from virtual_sensor.optics.surfaces import Cylinder, NoSurface, SceneSurface

CYLINDER = Cylinder(radius_mm=13.5, half_length_mm=85.0, axis_y_mm=2.0, axis_z_mm=-13.5)
VECTORS = {"double": mi.Array3f64, "single": mi.Array3f}


def distances(origins, directions, precision="double", limit=np.inf):
    """Of the test cylinder, as NumPy; directions of any length."""
    o, d = (VECTORS[precision](np.transpose(x)) for x in (origins, unit(directions)))
    return np.array(CYLINDER.distance(o, d, limit, True), float)


def starts_inside(surface, origins, directions):
    return np.array(surface.starts_inside(to_vectors(origins), to_vectors(directions)), bool)


def points_on(part, count=300, seed=1):
    """Random points of the cylinder's mantle or end faces, with their outward normals."""
    rng = np.random.default_rng(seed)
    angle, x = rng.uniform(0.0, 2.0 * np.pi, count), rng.uniform(-84.9, 84.9, count)
    radius = 13.5 * np.ones(count)
    normal = np.stack([0.0 * x, np.cos(angle), np.sin(angle)], axis=-1)
    if part == "end faces":
        x, radius = 85.0 * np.sign(x), 13.4 * np.sqrt(rng.random(count))
        points = np.stack([x, radius * np.cos(angle), radius * np.sin(angle)], axis=-1)
        normal = np.sign(x)[:, None] * [1.0, 0.0, 0.0]
    else:
        points = np.stack([x, radius * np.cos(angle), radius * np.sin(angle)], axis=-1)
    return points + np.array([0.0, 2.0, -13.5]), normal


def arriving(normals, seed=2):
    """Random unit directions that meet the surface at less than 78 degrees from its normal."""
    d = unit(np.random.default_rng(seed).normal(size=normals.shape))
    cosine = np.sum(d * normals, axis=1, keepdims=True)
    d = d - 2.0 * normals * np.maximum(cosine, 0.0)
    return unit(d - 0.25 * normals)


@pytest.mark.parametrize("part", ["mantle", "end faces"])
@pytest.mark.parametrize(("precision", "tolerance"), [("double", 1e-11), ("single", 1e-4)])
def test_a_ray_sent_at_a_point_of_the_cylinder_meets_it_there(part, precision, tolerance):
    """A convex solid's point, approached from outside, is the first one that the ray meets."""
    points, normals = points_on(part)
    d = arriving(normals)
    away = np.random.default_rng(3).uniform(0.5, 20.0, len(d))
    origins = points - away[:, None] * d
    np.testing.assert_allclose(distances(origins, d, precision), away, rtol=0, atol=tolerance)


@pytest.mark.parametrize("precision", VECTORS)
def test_what_lies_beyond_the_limit_or_behind_is_not_met(precision):
    """Pieces of a ray ask only for themselves."""
    points, normals = points_on("mantle")
    d = arriving(normals)
    origins = points - 5.0 * d
    assert np.all(np.isinf(distances(origins, d, precision, limit=4.99)))
    assert np.all(np.isfinite(distances(origins, d, precision, limit=5.01)))
    assert np.all(np.isinf(distances(origins, -d, precision)))


@pytest.mark.parametrize(("height", "met"), [(-1e-7, True), (1e-7, False)])
def test_a_tangent_decides_between_hit_and_miss(height, met):
    """A tenth of a nanometre below the top line a ray meets the cylinder, above it passes."""
    origins = np.array([[0.0, -50.0, height], [-3.0, -50.0, height]])
    directions = np.array([[0.0, 1.0, 0.0], [0.3, 1.0, 0.0]])
    assert np.all(np.isfinite(distances(origins, directions)) == met)


@pytest.mark.parametrize("precision", VECTORS)
def test_rays_along_the_axes(precision):
    """Zero components, where a naive formula divides zero by zero."""
    rays = [
        ([-100.0, 2.0, -13.5], [1, 0, 0], 15.0),  # along the axis, onto an end face
        ([100.0, 7.0, -10.0], [-1, 0, 0], 15.0),  # parallel to it, inside the radius
        ([-100.0, 2.0, 1.0], [1, 0, 0], np.inf),  # parallel to it, outside the radius
        ([0.0, 2.0, 20.0], [0, 0, -1], 20.0),  # straight down
        ([86.0, 2.0, 20.0], [0, 0, -1], np.inf),  # straight down, beyond an end face
        ([0.0, -31.5, -13.5], [0, 1, 0], 20.0),
    ]
    origins, directions, expected = map(np.array, zip(*rays, strict=True))
    np.testing.assert_allclose(distances(origins, directions, precision), expected, rtol=1e-6)


def test_inside_is_inside():
    """By the distance from the axis and from the end faces, whichever surface is asked."""
    points, normals = points_on("mantle")
    assert starts_inside(CYLINDER, points - 1e-3 * normals, normals).all()
    assert not starts_inside(CYLINDER, points + 1e-3 * normals, normals).any()
    points, normals = points_on("end faces")
    assert starts_inside(CYLINDER, points - 1e-3 * normals, normals).all()
    assert not starts_inside(CYLINDER, points + 1e-3 * normals, normals).any()


def test_nothing_is_met_where_nothing_stands():
    origins, directions = np.zeros((2, 3)), np.eye(3)[:2]
    met = NoSurface().distance(to_vectors(origins), to_vectors(directions), 10.0, True)
    assert np.all(np.isinf(np.array(met)))
    assert not starts_inside(NoSurface(), origins, directions).any()


@pytest.fixture(scope="module")
def scene():
    return vs.load_scene("hot_cylinder")


@pytest.mark.parametrize("bent", [False, True], ids=["cold", "hot"])
def test_mitsubas_shapes_stop_rays_where_the_analytic_cylinder_does(scene, bent):
    """Although Mitsuba intersects in float32: only parts of a tenth of a millimetre are asked."""
    march = March(step_mm=1.0, method="leapfrog")
    u, v = np.meshgrid(np.linspace(500.0, 1550.0, 40), np.linspace(300.0, 1750.0, 10))
    directions = scene.sensor.camera.lines_of_sight(np.stack([u.ravel(), v.ravel()], axis=-1))
    origins = np.broadcast_to(scene.sensor.camera.pose.origin_mm, directions.shape)
    hits = []
    for surface in (scene.surface, SceneSurface(scene.mitsuba)):
        line = Straight.through(to_vectors(origins), to_vectors(directions), march)
        ray = bend(scene.field if bent else None, surface, line, march)
        assert np.all(np.array(ray.status) == RayStatus.HIT)
        hits.append(to_numpy(ray.position(line)))
    np.testing.assert_allclose(hits[0], hits[1], rtol=0, atol=1e-5)


def test_both_surfaces_agree_on_misses_and_on_starts_inside(scene):
    """Rays beside the cylinder, and rays that set out in its middle."""
    origins = np.array([[0.0, 25.0, 50.0], [90.0, 0.0, 50.0], [0.0, 0.0, -13.5], [80.0, 3.0, -5.0]])
    directions = unit([[0.0, 0.1, -1.0], [0.0, 0.0, -1.0], [0.0, 0.3, 1.0], [0.2, 0.0, 1.0]])
    march = March()
    for surface in (scene.surface, SceneSurface(scene.mitsuba)):
        line = Straight.through(to_vectors(origins), to_vectors(directions), march)
        ray = bend(None, surface, line, march)
        status = np.array(ray.status)
        np.testing.assert_array_equal(status[:2], RayStatus.LEFT)
        np.testing.assert_array_equal(status[2:], RayStatus.STARTED_INSIDE)
        assert dr.allclose(ray.offset[0], 0.0)
