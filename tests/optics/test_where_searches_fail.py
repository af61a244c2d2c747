"""Where searches fail, each is reported: no pixel that is called FOUND is another point's."""

import numpy as np
import pytest

import virtual_sensor as vs
from virtual_sensor import ray_search
from virtual_sensor.optics.ray_search import METHODS, March, SearchStatus
from virtual_sensor.poses import Pose

MARCH = March(0.5, "leapfrog", "double")  # 1e-5 px off: a thousandth of what is looked for
UM_PER_PX = 22.0


@pytest.fixture(scope="module")
def scene():
    return vs.load_scene("hot_cylinder")


@pytest.fixture(scope="module")
def y():
    return np.random.default_rng(6).uniform(-10.0, 10.0, 300)


def assert_found_is_right(scene, found, y):
    """Within r_max on the part, which air magnifies by a few per cent, of Newton's root."""
    root = ray_search(scene, y, "newton", march=MARCH)
    apart = np.linalg.norm(found.pixel - root.pixel, axis=1) * UM_PER_PX
    good = found.status == SearchStatus.FOUND
    assert np.all(root.status[good] == SearchStatus.FOUND)
    assert np.all(apart[good] < 1.1)


@pytest.mark.parametrize(("beta", "along"), [(0.0, 0.0), (25.0, -10.0)])
def test_halving_may_end_above_the_radius_and_newton_does_not(y, beta, along):
    """Both axes are halved together: where one runs ahead of the other, the paper's stops."""
    there = vs.load_scene("hot_cylinder", beta=beta, along=along)
    papers = ray_search(there, y, "paper", march=MARCH)
    above = papers.status == SearchStatus.ABOVE_RADIUS
    assert np.all((papers.distance_um > 1.0) == above)
    assert above.mean() < 0.02
    assert_found_is_right(there, papers, y)
    newtons = ray_search(there, y, "newton", march=MARCH)
    assert np.all(newtons.status == SearchStatus.FOUND)
    assert newtons.distance_um.max() < 1e-5


def test_a_moved_scene_is_the_posed_one(scene):
    """The sensor turned round the cylinder's axis, and shifted along it, by its file or by hand."""
    c, s = np.cos(np.radians(20.0)), np.sin(np.radians(20.0))
    turn, axis = np.array([[1.0, 0, 0], [0, c, -s], [0, s, c]]), np.array([0.0, 0.0, -13.5])
    motion = Pose(turn, axis - turn @ axis + [7.0, 0.0, 0.0])
    for name, pose in scene.poses.items():
        scene = scene.with_pose(name, pose.moved(motion))
    posed, here = vs.load_scene("hot_cylinder", beta=20.0, along=7.0).sensor, scene.sensor
    for one, other in ((posed.camera, here.camera), (posed.laser, here.laser)):
        np.testing.assert_allclose(one.pose.rotation, other.pose.rotation, atol=1e-6)
        np.testing.assert_allclose(one.pose.origin_mm, other.pose.origin_mm, atol=1e-4)


@pytest.mark.parametrize(
    "options",
    [{"grid_px": (g, g)} for g in (16.0, 4.0, 1.0)] + [{"k_stop": k} for k in (11, 8, 4)],
    ids=str,
)
def test_too_small_a_grid_and_too_few_steps_are_told(scene, y, options):
    """What the grid can't reach, or the steps can't halve away, is ABOVE_RADIUS."""
    found = ray_search(scene, y, "paper", march=MARCH, **options)
    assert set(found.status) <= {SearchStatus.FOUND, SearchStatus.ABOVE_RADIUS}
    above = found.status == SearchStatus.ABOVE_RADIUS
    assert above.any()
    assert np.all((found.distance_um > 1.0) == above)
    assert_found_is_right(scene, found, y)


@pytest.mark.parametrize("method", METHODS)
def test_undercut_points_are_rejected_by_a_small_z_max_and_accepted_by_a_large(method):
    """The ledge hides 7.2 < |y| < 8.7 mm of the shaft's line: too large a z_max lets them in."""
    shaft = vs.load_scene("stepped_shaft").cold()
    y = np.linspace(6.0, 9.5, 141)
    hidden = (y > 7.3) & (y < 8.6)
    strict = ray_search(shaft, y, method, march=MARCH)
    told = strict.status == SearchStatus.UNDERCUT
    assert np.all(told[hidden])
    assert not np.any(told[(y < 7.1) | (y > 8.8)])
    assert np.all(np.isnan(strict.pixel[told]))
    lenient = ray_search(shaft, y, method, march=MARCH, z_max_mm=1.0)
    # Only the paper's search arrived at what hides the point.
    ends = SearchStatus.FOUND if method == "paper" else SearchStatus.ABOVE_RADIUS
    assert np.all(lenient.status[hidden] == ends)
    depth = np.linalg.norm(lenient.seen_point_mm - lenient.laser_point_mm, axis=1)
    assert depth[hidden].min() > 0.1  # what is seen is told all the same


@pytest.mark.parametrize("method", ["newton", "tabulated"])
def test_the_limb_is_told(method):
    """Of a line wider than the part: from where it grazes on, another status, no wrong pixel."""
    scene = vs.load_scene("hot_cylinder", line_length=28)
    y = np.linspace(13.3, 13.6, 61)
    found = ray_search(scene, y, method, march=MARCH)
    assert found.status[0] == SearchStatus.FOUND
    assert found.status[-1] == SearchStatus.LASER_MISSED
    used = np.isfinite(found.pixel[:, 0])
    assert np.all(used == (found.status == SearchStatus.FOUND) | (found.distance_um > 1.0) & used)
    assert np.all(found.distance_um[found.status == SearchStatus.FOUND] < 1e-3)


@pytest.mark.slow
def test_what_no_map_can_keep_is_marched(scene, y):
    """Of a tolerance beyond maps: slower, and right to it all the same."""
    by_maps, marched = (
        ray_search(scene, y, "tabulated", tolerance_px=tolerance) for tolerance in (1e-3, 1e-9)
    )
    assert not by_maps.iterations.any()
    assert np.all(marched.iterations > 0)
    for found in (by_maps, marched):
        assert np.all(found.status == SearchStatus.FOUND)
        assert_found_is_right(scene, found, y)
    assert np.abs(by_maps.pixel - marched.pixel).max() < 1e-3
