"""The paper's sensor: what its camera sees, where its laser rays go, and how the axes run."""

import cv2
import numpy as np
import pytest
from artificial import paper_sensor

from virtual_sensor.poses import Pose


def random_pose(seed):
    rng = np.random.default_rng(seed)
    rotation = cv2.Rodrigues(rng.normal(size=3))[0]
    return Pose(rotation, rng.normal(0.0, 100.0, 3))


def test_field_of_view_is_the_papers():
    """Table 1: 45.056 mm on 2048 px in a distance of 300 mm, 22 um each."""
    camera = paper_sensor().camera
    np.testing.assert_allclose(camera.project([[0.0, 0.0, 0.0]]), [[1023.5, 1023.5]])
    ends = np.array([[0.0, -45.056 / 2, 0.0], [0.0, 45.056 / 2, 0.0]])
    np.testing.assert_allclose(camera.project(ends)[:, 0], [-0.5, 2047.5])
    np.testing.assert_allclose(np.diff(camera.project([[0, 0, 0], [0, 0.022, 0]])[:, 0]), 1.0)


def test_u_runs_along_the_line():
    """+y of the world is +u; a higher point moves along v only, and the line lies flat."""
    camera = paper_sensor().camera
    origin, along, up = camera.project([[0, 0, 0], [0, 1.0, 0], [0, 0, 1.0]])
    assert along[0] > origin[0]
    assert along[1] == pytest.approx(origin[1])
    assert up[0] == pytest.approx(origin[0])
    assert abs(up[1] - origin[1]) > 10.0


@pytest.mark.parametrize("seed", range(3))
def test_projection_is_opencvs(seed):
    """cv2.projectPoints takes the same K, the inverse pose, and counts pixels alike."""
    rng = np.random.default_rng(seed)
    camera = paper_sensor().camera
    points = rng.uniform(-20.0, 20.0, (30, 3))
    to_camera = camera.pose.rotation.T
    expected, _ = cv2.projectPoints(
        points, cv2.Rodrigues(to_camera)[0], -to_camera @ camera.pose.origin_mm, camera.matrix, None
    )
    np.testing.assert_allclose(camera.project(points), expected[:, 0], atol=1e-6)


def test_points_behind_the_camera_have_no_pixel():
    """They would come out mirrored."""
    camera = paper_sensor().camera
    assert np.all(np.isnan(camera.project([2.0 * camera.pose.origin_mm])))


@pytest.mark.parametrize("seed", range(3))
def test_poses_go_there_and_back(seed):
    """Equation 4 and its inverse; the frame's own origin and axes are where it says."""
    pose = random_pose(seed)
    points = np.random.default_rng(seed).normal(0.0, 50.0, (20, 3))
    np.testing.assert_allclose(pose.to_local(pose.to_world(points)), points, atol=1e-12)
    np.testing.assert_allclose(pose.to_local(pose.origin_mm), 0.0, atol=1e-12)
    ahead = pose.origin_mm + pose.rotation[:, 2]
    np.testing.assert_allclose(pose.to_local(ahead), [0.0, 0.0, 1.0], atol=1e-12)


def test_frames_are_right_handed():
    """Camera and laser: z = x cross y, with z towards the object."""
    sensor = paper_sensor()
    for pose in (sensor.camera.pose, sensor.laser.pose):
        assert np.linalg.det(pose.rotation) == pytest.approx(1.0)
        np.testing.assert_allclose(pose.to_world([0.0, 0.0, 300.0]), 0.0, atol=1e-12)


def test_lines_of_sight_pass_through_what_they_see():
    """Equation 3 undoes equation 2, up to the unknown depth."""
    camera = paper_sensor().camera
    points = np.random.default_rng(1).uniform(-20.0, 20.0, (30, 3))
    direction = camera.lines_of_sight(camera.project(points))
    np.testing.assert_allclose(np.linalg.norm(direction, axis=1), 1.0)
    offset = points - camera.pose.origin_mm
    np.testing.assert_allclose(np.cross(direction, offset), 0.0, atol=1e-9)
    assert np.all(np.sum(direction * offset, axis=1) > 0.0)


def test_sensor_ends_half_a_pixel_outside_the_outer_centres():
    """Integers are pixel centres, so the sensor runs from -0.5 to 2047.5."""
    pixel = [[-0.5, 2047.5], [-0.6, 5.0], [5.0, 2047.6], [np.nan, 5.0]]
    np.testing.assert_array_equal(paper_sensor().camera.inside(pixel), [True, False, False, False])


@pytest.mark.parametrize("fan_deg", [0.0, 30.0])
def test_laser_rays_meet_the_reference_plane_where_their_name_says(fan_deg):
    """Ray (a, b) crosses the plane square to the axis at 300 mm in local x = a, y = b."""
    laser = paper_sensor(fan_deg=fan_deg).laser
    a, b = np.array([0.0, 0.1, -0.1, 0.0]), np.array([-10.0, 10.0, 3.0, 0.0])
    start, direction = laser.family.rays(a, b)
    np.testing.assert_allclose(np.linalg.norm(direction, axis=1), 1.0)
    axis = laser.pose.rotation[:, 2]
    depth = (300.0 - laser.pose.to_local(start)[:, 2]) / (direction @ axis)
    crossing = laser.pose.to_local(start + depth[:, None] * direction)
    np.testing.assert_allclose(crossing, np.column_stack([a, b, np.full(4, 300.0)]), atol=1e-9)


def test_fan_opens_by_its_angle():
    """The outermost rays of the line enclose the fan angle; telecentric ones are parallel."""
    for fan_deg in (0.0, 30.0):
        _, direction = paper_sensor(fan_deg=fan_deg).laser.family.rays(0.0, [-10.0, 10.0])
        sine = np.linalg.norm(np.cross(*direction))
        assert np.degrees(np.arcsin(sine)) == pytest.approx(fan_deg)


def test_laser_plane_holds_the_middle_rays():
    """Hessian form: unit normal, and every ray with a = 0 satisfies normal . x = offset."""
    laser = paper_sensor(fan_deg=25.0).laser
    normal, offset = laser.plane
    start, direction = laser.family.rays(np.zeros(7), np.linspace(-10.0, 10.0, 7))
    assert np.linalg.norm(normal) == pytest.approx(1.0)
    np.testing.assert_allclose(start @ normal, offset, atol=1e-12)
    np.testing.assert_allclose(direction @ normal, 0.0, atol=1e-12)


@pytest.mark.parametrize("alpha_deg", [0.0, 30.0, 60.0, 150.0])
def test_triangulation_angle_is_alpha(alpha_deg):
    """Between the axes of camera and laser."""
    found = paper_sensor(alpha_deg).triangulation_angle_deg
    assert found == pytest.approx(alpha_deg, abs=1e-5)
