"""The paper's differences: signs, units, and how they hang together."""

import dataclasses

import numpy as np
import pytest
from artificial import paper_sensor

from virtual_sensor.errors import InputError
from virtual_sensor.metrology.deviation import (
    deviations,
    euclidean,
    round_pixel,
    separate_paths,
)
from virtual_sensor.metrology.triangulation import triangulate

RNG = np.random.default_rng(7)
A, B, A_M, B_M = RNG.normal(size=(4, 9, 3))
PIXEL_A, PIXEL_B = RNG.uniform(0.0, 2047.0, (2, 9, 2))


def test_signs_and_units_are_the_papers():
    """A spot that moves by +1 um in y gives Delta y = +1 in figure 7(a), and so on."""
    zero, y, pixel = np.zeros((1, 3)), np.array([[0.0, 1e-3, 0.0]]), np.zeros((1, 2))
    moved = deviations(zero, y, zero, 3 * y, pixel, [[-4.0, 2.0]])
    np.testing.assert_allclose(moved.incidence_shift_um, [[0.0, 1.0, 0.0]])
    np.testing.assert_allclose(moved.hot_error_um, [[0.0, -2.0, 0.0]])
    np.testing.assert_allclose(moved.measured_shift_um, [[0.0, 3.0, 0.0]])
    np.testing.assert_allclose(moved.cold_error_um, 0.0)
    np.testing.assert_allclose(moved.pixel_shift_px, [[-4.0, 2.0]])


def test_the_papers_thought_experiment():
    """Section 5.1: light that is bent in the laser's plane alone, and seen straight, is no error.

    Seen straight, a spot that leaves the plane by d is measured d/sin(60 deg) away from itself.
    """
    sensor = paper_sensor()
    along, down = np.array([0.0, 1.0, 0.0]), np.array([-0.5, 0.0, np.sqrt(0.75)])  # in the plane
    out = np.array([np.sqrt(0.75), 0.0, 0.5])
    spot = np.zeros((2, 3))
    hot = np.stack([0.05 * along - 0.03 * down, 0.02 * out])
    pixels = [sensor.camera.project(points) for points in (spot, hot)]
    d = deviations(spot, hot, *(triangulate(sensor, pixel) for pixel in pixels), *pixels)
    np.testing.assert_allclose(d.incidence_shift_um[0], d.measured_shift_um[0], atol=1e-6)
    np.testing.assert_allclose(euclidean(d.incidence_shift_um), [np.hypot(50.0, 30.0), 20.0])
    np.testing.assert_allclose(d.hot_error_um[0], 0.0, atol=1e-6)
    expected = 20.0 / np.sin(np.radians(60.0))
    np.testing.assert_allclose(euclidean(d.hot_error_um)[1], expected, rtol=1e-4)  # nearly central
    np.testing.assert_allclose(d.cold_error_um, 0.0, atol=1e-6)
    np.testing.assert_allclose(
        d.pixel_shift_px[0, 0], 50.0 / 22.0, rtol=2e-4
    )  # the paper's resolution


def test_missing_points_stay_missing():
    """NaN in a hot point leaves the cold difference alone."""
    hot = B_M.copy()
    hot[4] = np.nan
    d = deviations(A, B, A_M, hot, PIXEL_A, PIXEL_B)
    np.testing.assert_array_equal(np.isnan(euclidean(d.hot_error_um)), np.arange(9) == 4)
    np.testing.assert_array_equal(np.isnan(euclidean(d.measured_shift_um)), np.arange(9) == 4)
    assert np.isfinite(d.cold_error_um).all()


def test_euclidean_is_the_length():
    """Three-four-five, in the plane and in space."""
    np.testing.assert_allclose(euclidean([[3.0, 4.0]]), [5.0])
    np.testing.assert_allclose(euclidean([[2.0, 3.0, 6.0]]), [7.0])


def test_pixels_are_rounded_to_quarters():
    """The paper's sub-pixel step; a pixel that is missing stays so."""
    rounded = round_pixel([[1023.1, 1023.13], [np.nan, -0.3]])
    np.testing.assert_array_equal(rounded, [[1023.0, 1023.25], [np.nan, -0.25]])
    np.testing.assert_array_equal(round_pixel([0.74], step=0.5), [0.5])


@pytest.mark.parametrize("step", [0.0, -0.25, np.nan])
def test_a_step_that_is_none_is_refused(step):
    """Zero would divide by it."""
    with pytest.raises(InputError, match="step"):
        round_pixel([[1.0, 1.0]], step)


def test_rounding_errs_by_the_papers_few_micrometres():
    """Figure 7(e): |A - A_m| of the cold object stays below about 2.7 um when rounded to 1/4 px.

    Rounding by up to 1/8 px of 22 um is 2.75 um in the image, and v counts 1/sin(60 deg) of that.
    """
    sensor = paper_sensor()
    y = np.linspace(-10.0, 0.0, 9)
    height = np.sqrt(13.5**2 - y**2) - 13.5
    # On the cylinder's surface, in the laser plane through the y axis tilted by 30 deg.
    points = np.column_stack([-height * np.tan(np.radians(30.0)), y, height])
    normal, offset = sensor.laser.plane
    np.testing.assert_allclose(points @ normal, offset, atol=1e-12)
    pixel = sensor.camera.project(points)
    measured = triangulate(sensor, round_pixel(pixel))
    error_um = euclidean(deviations(points, points, measured, measured, pixel, pixel).cold_error_um)
    assert 1.0 < error_um.max() < 2.75 * np.hypot(1.0, 1.0 / np.sin(np.radians(60.0)))


def test_paths_are_told_apart():
    """A spot that moves by 88 um in -y, seen straight, is -4 px; the rest is the camera's path."""
    camera = paper_sensor().camera
    A_mm = np.array([[0.0, 0.0, 0.0]])
    B_mm = np.array([[0.0, -0.088, 0.0]])
    pixel_A, pixel_B = camera.project(A_mm), np.array([[1023.5 - 1.0, 1023.5 + 0.5]])
    split = separate_paths(camera, A_mm, B_mm, pixel_A, pixel_B)
    np.testing.assert_allclose(split.laser_to_object_px, [[-4.0, 0.0]], atol=1e-9)
    np.testing.assert_allclose(split.object_to_camera_px, [[3.0, 0.5]], atol=1e-9)
    np.testing.assert_allclose(split.laser_to_camera_px, [[-1.0, 0.5]], atol=1e-9)


def test_paths_sum_up_but_for_the_cold_pixels_error():
    """The total is what figure 7(d) shows, also where the cold pixel was found with an error."""
    camera = paper_sensor().camera
    error = np.array([0.1, -0.2])
    split = separate_paths(camera, A, B, camera.project(A) + error, PIXEL_B)
    parts = split.laser_to_object_px + split.object_to_camera_px
    np.testing.assert_allclose(parts - split.laser_to_camera_px, np.tile(error, (9, 1)), atol=1e-9)


def test_results_cannot_be_overwritten():
    """They are records."""
    d = deviations(A, B, A_M, B_M, PIXEL_A, PIXEL_B)
    with pytest.raises(dataclasses.FrozenInstanceError):
        d.hot_error_um = A
