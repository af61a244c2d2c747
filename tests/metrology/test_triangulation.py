"""Plane-line intersection against points whose place is known."""

import dataclasses
from itertools import product

import numpy as np
import pytest
from artificial import paper_sensor

from virtual_sensor.devices.sensor import SensorModel
from virtual_sensor.errors import InputError
from virtual_sensor.metrology.centres import LineCentres
from virtual_sensor.metrology.triangulation import triangulate
from virtual_sensor.optics.sensor_geometry import check_geometry
from virtual_sensor.poses import Pose


def turned(sensor, rotation, origin_mm=(0.0, 0.0, 0.0)):
    """Turn a sensor as a rigid body about the world's origin, then move it."""

    def move(pose):
        return Pose(rotation @ pose.rotation, rotation @ pose.origin_mm + np.array(origin_mm))

    return SensorModel(
        camera=sensor.camera.with_pose(move(sensor.camera.pose)),
        laser=sensor.laser.with_pose(move(sensor.laser.pose)),
    )


def side_by_side():
    """Sensor with both axes parallel, the camera 20 mm beside the laser plane."""
    sensor = paper_sensor(alpha_deg=0.0)
    normal, _ = sensor.laser.plane
    pose = sensor.camera.pose
    beside = Pose(pose.rotation, pose.origin_mm + 20.0 * normal)
    return SensorModel(sensor.camera.with_pose(beside), sensor.laser)


def test_points_on_the_laser_plane_come_back():
    """Projecting and triangulating are inverse on the laser plane, at any angle of the sensor."""
    for case in product((5.0, 60.0, 120.0, -60.0), (0.0, 20.0)):
        alpha_deg, fan_deg = case
        rng = np.random.default_rng(1)
        rotation = np.linalg.qr(rng.normal(size=(3, 3)))[0]
        rotation *= np.linalg.det(rotation)
        sensor = turned(paper_sensor(alpha_deg, fan_deg), rotation, (10.0, -20.0, 30.0))
        start, direction = sensor.laser.family.rays(np.zeros(50), rng.uniform(-10.0, 10.0, 50))
        points = start + rng.uniform(280.0, 320.0, (50, 1)) * direction
        measured = triangulate(sensor, sensor.camera.project(points))
        np.testing.assert_allclose(measured, points, atol=1e-9, err_msg=f"{case}")


def test_one_pixel_across_the_line_is_a_known_height():
    """At alpha = 60 deg a pixel of 22 um across is 22/sin(60) um along the laser's axis."""
    sensor = paper_sensor()
    step = np.diff(triangulate(sensor, [[1023.5, 1023.49], [1023.5, 1023.51]]), axis=0)[0]
    assert np.linalg.norm(step) / 0.02 == pytest.approx(0.022 / np.sin(np.radians(60.0)), rel=1e-6)


def test_one_pixel_along_the_line_is_22_um_in_y():
    """U runs along +y of the world."""
    step = np.diff(triangulate(paper_sensor(), [[1023.0, 1023.5], [1024.0, 1023.5]]), axis=0)[0]
    np.testing.assert_allclose(step, [0.0, 0.022, 0.0], atol=1e-12)


def test_pixels_without_a_point_are_nan():
    """No pixel, a line of sight parallel to the plane, and one that meets it behind the camera."""
    middle = 1023.5
    pixel = [[np.nan, 5.0], [5.0, np.inf], [middle, middle], [middle, 500.0], [middle, 1500.0]]
    points = triangulate(side_by_side(), pixel)
    assert np.all(np.isnan(points[:3]))
    # The plane lies on one side of the axis only: one of the last two sees it, one has it behind.
    np.testing.assert_array_equal(np.sort(np.isnan(points[3:]).all(axis=1)), [False, True])


def test_shape_follows_the_pixels():
    """No pixel, one pixel, a block of pixels."""
    assert triangulate(paper_sensor(), np.empty((0, 2))).shape == (0, 3)
    assert triangulate(paper_sensor(), [3.0, 4.0]).shape == (3,)
    assert triangulate(paper_sensor(), np.ones((4, 5, 2))).shape == (4, 5, 3)


def test_what_are_no_pixels_is_refused():
    """Points instead of pixels are an easy mistake."""
    with pytest.raises(InputError, match=r"\(4, 3\)"):
        triangulate(paper_sensor(), np.zeros((4, 3)))


def test_a_line_of_an_image_of_another_size_is_refused():
    """Rationale: its pixels would be taken for others, and make a wrong profile without a word."""
    sensor = paper_sensor()
    width, height = sensor.camera.size
    line, whole = (LineCentres.of_rows(np.full(count, 900.0)) for count in (512, width))
    assert np.isfinite(triangulate(sensor, whole)).all()
    with pytest.raises(InputError, match=f"line has 512 columns, the camera {width}"):
        triangulate(sensor, line)
    with pytest.raises(InputError, match=f"line has 512 rows, the camera {height}"):
        triangulate(sensor, line.transposed)
    part = [getattr(whole, field.name)[100:200] for field in dataclasses.fields(whole)]
    assert len(triangulate(sensor, LineCentres(*part))) == 100  # whose columns are known


@pytest.mark.parametrize("alpha_deg", [0.0, 180.0])
def test_camera_in_the_laser_plane_is_refused(alpha_deg):
    """There every point of the plane falls on one line of the image."""
    with pytest.raises(InputError, match=r"alpha = \d+ deg.*turn the camera"):
        triangulate(paper_sensor(alpha_deg), [[1023.5, 1023.5]])


def test_camera_turned_within_the_laser_plane_is_refused():
    """Alpha is 60 deg here too, but about the wrong axis: the camera sees the plane edge on."""
    sensor = paper_sensor()
    normal, _ = sensor.laser.plane
    across = np.cross(normal, sensor.laser.pose.rotation[:, 2])
    z = np.cos(np.pi / 3) * sensor.laser.pose.rotation[:, 2] + np.sin(np.pi / 3) * across
    pose = Pose(np.column_stack([normal, np.cross(z, normal), z]), -300.0 * z)
    edge_on = SensorModel(sensor.camera.with_pose(pose), sensor.laser)
    assert edge_on.triangulation_angle_deg == pytest.approx(60.0)
    with pytest.raises(InputError, match="alpha"):
        check_geometry(edge_on)


def test_parallel_axes_beside_each_other_still_measure():
    """A camera beside the laser with both axes parallel has a base, and so a depth."""
    sensor, point = side_by_side(), np.array([[0.0, 3.0, 2.0]])
    np.testing.assert_allclose(triangulate(sensor, sensor.camera.project(point)), point, atol=1e-9)
