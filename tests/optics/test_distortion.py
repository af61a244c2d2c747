"""OpenCV's distortion, tilt included: away and back, and as OpenCV itself projects."""

from dataclasses import replace

import cv2
import numpy as np
import pytest
from artificial import paper_sensor

from virtual_sensor.metrology.triangulation import triangulate
from virtual_sensor.optics import epipolar
from virtual_sensor.optics.distortion import undistorted

COEFFICIENTS = {
    "four": [-0.3, 0.5, 1e-3, -2e-3],
    "five": [-0.3, 0.5, 1e-3, -2e-3, 0.2],
    "rational": [-0.3, 0.5, 1e-3, -2e-3, 0.2, 0.1, -0.2, 0.05],
    "thin prism": [-0.3, 0.5, 1e-3, -2e-3, 0.2, 0.1, -0.2, 0.05, 1e-3, 2e-3, -1e-3, 1e-3],
    "Scheimpflug": [-0.3, 0.5, 1e-3, -2e-3, 0.2, 0, 0, 0, 0, 0, 0, 0, 0.15, -0.1],
}


def camera(coefficients):
    return replace(paper_sensor().camera, distortion=np.array(coefficients, float))


@pytest.mark.parametrize("name", COEFFICIENTS)
def test_points_are_projected_as_opencv_does(name):
    """The model is OpenCV's own; a tilted sensor too."""
    seeing = camera(COEFFICIENTS[name])
    points = np.random.default_rng(0).uniform(-15.0, 15.0, (50, 3))
    rotation = seeing.pose.rotation.T
    expected = cv2.projectPoints(
        points,
        cv2.Rodrigues(rotation)[0],
        -rotation @ seeing.pose.origin_mm,
        seeing.matrix,
        seeing.distortion,
    )[0][:, 0]
    np.testing.assert_allclose(seeing.project(points), expected, atol=1e-8)


@pytest.mark.parametrize("name", COEFFICIENTS)
def test_lines_of_sight_undo_it_to_a_billionth_of_a_pixel(name):
    """Pixels all over the sensor: out along their lines of sight, and projected again."""
    seeing = camera(COEFFICIENTS[name])
    u, v = np.meshgrid(np.linspace(0, 2047, 21), np.linspace(0, 2047, 21))
    pixel = np.stack([u.ravel(), v.ravel()], axis=1)
    points = seeing.pose.origin_mm + 300.0 * seeing.lines_of_sight(pixel)
    np.testing.assert_allclose(seeing.project(points), pixel, atol=1e-9)


def test_without_coefficients_nothing_changes():
    """To the bit: all off by default."""
    ideal = paper_sensor().camera
    pixel = np.random.default_rng(1).uniform(0.0, 2047.0, (20, 2))
    np.testing.assert_array_equal(ideal.undistorted(pixel), pixel)
    np.testing.assert_allclose(
        camera([0.0] * 4).lines_of_sight(pixel), ideal.lines_of_sight(pixel), atol=1e-15
    )


def test_what_can_not_be_undone_is_nan():
    """A distortion so strong that the image folds: no made-up line of sight, and no warning."""
    seeing = camera([-80.0, 0.0, 0.0, 0.0])
    lines = seeing.lines_of_sight([[1023.5, 1023.5], [60.0, 60.0], [np.nan, 3.0]])
    assert np.isfinite(lines[0]).all()
    assert np.isnan(lines[1:]).all()
    assert np.isnan(
        camera([-0.1, 0.0, 0.0, 1e308]).lines_of_sight([[60.0, 60.0], [9.0, 3.0]])
    ).all()


@pytest.mark.parametrize(
    ("k1", "k2"), [(-0.3, 0.0), (-1.0, 0.0), (-0.6, 0.1), (0.3, -0.4), (1.0, -2.0)]
)
def test_pixels_beyond_the_turning_point_see_nothing(k1, k2):
    """Past the largest radius that r(1 + k1 r^2 + k2 r^4) gives, other roots are no lens's."""
    matrix = np.array([[600.0, 0.0, 1023.5], [0.0, 600.0, 1023.5], [0.0, 0.0, 1.0]])
    seeing = replace(camera([k1, k2, 0.0, 0.0]), matrix=matrix)
    r = np.linspace(0.0, 3.0, 300_001)
    distorted = r * (1.0 + k1 * r**2 + k2 * r**4)
    turn = np.argmax(np.diff(distorted) < 0.0)
    u, v = np.meshgrid(np.linspace(0, 2047, 40), np.linspace(0, 2047, 40))
    pixel = np.stack([u.ravel(), v.ravel()], axis=1)
    radius = np.hypot(*(pixel - 1023.5).T) / 600.0
    ideal = np.hypot(*(seeing.undistorted(pixel) - 1023.5).T) / 600.0
    inside = radius < 0.999 * distorted[turn]
    expected = np.interp(radius[inside], distorted[:turn], r[:turn])
    np.testing.assert_allclose(ideal[inside], expected, atol=1e-6)
    assert np.isnan(ideal[radius > distorted[turn]]).all()


def test_points_are_measured_through_a_tilted_sensor():
    """Undistortion comes before triangulation: points on the laser plane come back."""
    sensor = replace(paper_sensor(), camera=camera(COEFFICIENTS["Scheimpflug"]))
    start, direction = sensor.laser.family.rays(np.zeros(9), np.linspace(-10.0, 10.0, 9))
    points = start + 299.0 * direction
    measured = triangulate(sensor, sensor.camera.project(points))
    np.testing.assert_allclose(measured, points, atol=1e-8)


@pytest.mark.parametrize("name", COEFFICIENTS)
def test_millions_of_pixels_are_undone_as_one_is(name, monkeypatch):
    """By the formula in Dr.Jit: beside the image, and where there is nothing, as one by one."""
    monkeypatch.setattr(epipolar, "_MANY", 10)
    seeing = camera(COEFFICIENTS[name])
    pixel = np.random.default_rng(2).uniform(-300.0, np.array(seeing.size) + 300.0, (200, 2))
    pixel[3] = np.nan
    expected = np.stack(seeing.of_pixels(pixel), axis=1)
    found = epipolar.coordinates_of(seeing, pixel)
    np.testing.assert_allclose(found, expected, atol=1e-12)
    assert np.isfinite(found).all(axis=1).sum() == 199


def test_a_lens_that_folds_is_undone_one_by_one(monkeypatch):
    monkeypatch.setattr(epipolar, "_MANY", 10)
    folded = camera([-80.0, 0.0, 0.0, 0.0])
    pixel = np.random.default_rng(2).uniform(-0.5, np.array(folded.size) - 0.5, (100, 2))
    found = epipolar.coordinates_of(folded, pixel)
    np.testing.assert_array_equal(found, np.stack(folded.of_pixels(pixel), axis=1))
    assert 0 < np.isnan(found[:, 0]).sum() < 100


def test_light_that_no_lens_puts_there_is_nan():
    """By x (1 - 80 x^2), which is 0.043 at most: nothing is at 0.06, something at 0.02."""
    x, y = undistorted(np.array([0.06, 0.02]), np.zeros(2), np.array([-80.0, 0.0, 0.0, 0.0]))
    assert np.isnan(x[0])
    assert np.isnan(y[0])
    assert x[1] * (1.0 - 80.0 * x[1] ** 2) == pytest.approx(0.02, abs=1e-12)
