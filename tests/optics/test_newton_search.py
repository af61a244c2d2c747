"""Newton's search along a long line: what is interpolated there, against marches of every ray."""

import operator
from dataclasses import dataclass, replace
from functools import reduce
from types import SimpleNamespace
from typing import Any

import numpy as np
import oracles
import pytest

import virtual_sensor as vs
from virtual_sensor import ray_search
from virtual_sensor.engine import dr, mi
from virtual_sensor.optics import newton_search
from virtual_sensor.optics.ray_search import SearchStatus
from virtual_sensor.optics.rays import March
from virtual_sensor.optics.sight import REFERENCE, misses
from virtual_sensor.optics.surfaces import Cylinder, SceneSurface


@dataclass(frozen=True)
class Nearest:
    """The nearest of some surfaces."""

    surfaces: tuple[Any, ...]

    def distance(self, *ray):
        return reduce(dr.minimum, (surface.distance(*ray) for surface in self.surfaces))

    def starts_inside(self, *ray):
        return reduce(operator.or_, (surface.starts_inside(*ray) for surface in self.surfaces))


FINE = March(step_mm=0.04, method="leapfrog")


@pytest.fixture(scope="module")
def scene():
    return vs.load_scene("hot_cylinder")


def some(rng, count, of=60):
    return rng.choice(count, of, replace=False)


@pytest.mark.parametrize("pose", [{}, {"beta": 12.0}], ids=["above", "turned"])
def test_long_lines_are_found_to_a_millionth_of_a_pixel(pose):
    """Against every ray marched with much finer steps: the paper's own are no better."""
    rng = np.random.default_rng(1)
    scene = vs.load_scene("hot_cylinder", **pose)
    y = rng.uniform(-10.4, 10.4, newton_search.MANY)
    found = ray_search(scene, y, "newton")
    assert np.all(found.status == SearchStatus.FOUND)
    assert found.distance_um.max() < 1e-3
    assert np.mean(found.iterations == 0) > 0.8  # no fine march of their own
    rows = some(rng, y.size)
    fine = ray_search(scene, y[rows], "newton", march=FINE)
    error = np.linalg.norm(found.pixel[rows] - fine.pixel, axis=1)
    assert np.sqrt(np.mean(error**2)) < 6e-7
    assert error.max() < 2e-6
    assert np.linalg.norm(found.laser_point_mm[rows] - fine.laser_point_mm, axis=1).max() < 5e-8


def test_rays_beside_the_part_and_at_its_limb_are_marched(scene):
    """Nothing is interpolated where there is nothing, nor where the surface bends away."""
    rng = np.random.default_rng(2)
    y = rng.uniform(-14.5, 14.5, newton_search.MANY)
    found = ray_search(scene, y, "newton")
    rows = np.concatenate([some(rng, y.size), np.flatnonzero(np.abs(np.abs(y) - 13.3) < 0.15)])
    single = ray_search(scene, y[rows], "newton", march=REFERENCE)
    np.testing.assert_array_equal(found.status[rows], single.status)
    assert {SearchStatus.FOUND, SearchStatus.LASER_MISSED} <= set(single.status)
    np.testing.assert_allclose(found.pixel[rows], single.pixel, rtol=0, atol=2e-6)


def test_what_hides_a_point_or_lies_on_the_line_is_seen(scene):
    """Every ray is its own search: what hides one point, or lies on the line, is no one else's."""
    rng = np.random.default_rng(3)
    y = np.sort(rng.uniform(-10.0, 10.0, newton_search.MANY))
    free = ray_search(scene, y, "newton", march=replace(REFERENCE, step_mm=2.0))
    hidden, raised = 700, 1300
    toward = scene.sensor.camera.pose.origin_mm - free.laser_point_mm[hidden]
    bead = free.laser_point_mm[hidden] + 20.0 * oracles.unit(toward)
    spheres = {
        "bead": {"type": "sphere", "center": bead.tolist(), "radius": 0.3},
        "speck": {
            "type": "sphere",
            "center": free.laser_point_mm[raised].tolist(),
            "radius": 0.02,
        },
    }
    surface = Nearest((Cylinder(), SceneSurface(mi.load_dict({"type": "scene", **spheres}))))
    with_beads = SimpleNamespace(
        camera=scene.camera, source=scene.source, medium=scene.medium, surface=surface
    )
    rows = np.concatenate([np.arange(at - 60, at + 61, 5) for at in (hidden, raised)])
    found = ray_search(with_beads, y, "newton")
    assert np.mean(found.iterations == 0) > 0.8
    single = ray_search(with_beads, y[rows], "newton", march=REFERENCE)
    np.testing.assert_array_equal(found.status[rows], single.status)
    assert single.status[12] == SearchStatus.UNDERCUT
    np.testing.assert_allclose(found.laser_point_mm[rows], single.laser_point_mm, atol=1e-6)
    np.testing.assert_allclose(found.pixel[rows], single.pixel, rtol=0, atol=2e-5)  # float32's hits


@pytest.mark.parametrize("along_px", [0.0, 3.0])
def test_a_miss_leads_from_the_line_of_sight_to_the_point(along_px):
    """In air of no field: by a pinhole's own geometry, in the plane through the point."""
    cold = vs.load_scene("hot_cylinder", beta=12.0).cold()
    camera, f = cold.camera, cold.camera.matrix[0, 0]
    points = np.array([[1.0, -4.0, 2.0], [0.0, 0.0, 0.0], [-2.0, 6.0, -3.0]])
    pixel = camera.project(points) - [along_px, 2.0 * along_px]
    depth_mm = camera.pose.to_local(points)[:, 2]
    expected = np.column_stack([along_px * depth_mm / f, 2.0 * along_px * depth_mm / f])
    for count in (3, 1):
        found = misses(cold, points[:count], pixel[:count])
        np.testing.assert_allclose(found, expected[:count], rtol=0, atol=1e-9)
