"""Blur keeps the light and the line's place; distortion moves it as OpenCV says."""

import numpy as np
import pytest
from artificial import line_image, paper_sensor
from scipy.ndimage import map_coordinates

from virtual_sensor.devices.image_sensor import ImageSensor
from virtual_sensor.errors import InputError
from virtual_sensor.imaging.grey_values import exposed, grey_values
from virtual_sensor.imaging.image_blur import defocus_blur, distorted, gaussian_blur
from virtual_sensor.metrology.line_peaks import line_centres
from virtual_sensor.optics.ray_families import Pinhole

SIZE = (200, 160)
MILD = [-0.2, 0.1, 0.0, 0.0]


def camera(coefficients):
    matrix = np.array([[400.0, 0, 99.5], [0, 400.0, 79.5], [0, 0, 1]])
    return Pinhole(matrix, paper_sensor().camera.pose, SIZE, np.array(coefficients, float))


def test_gaussian_blur_adds_its_variance_to_the_lines():
    """Widths add in squares, and the line stays where it is to 1e-4 px."""
    centre = np.linspace(60.0, 61.0, 41)
    line = line_centres(gaussian_blur(line_image(centre, 1.5, height=120), 2.0))
    inner = slice(13, -13)  # beside them, light has left the image
    np.testing.assert_allclose(line.width[inner], np.hypot(1.5, 2.0), rtol=2e-3)
    np.testing.assert_allclose(line.row[inner], centre[inner], atol=1e-4)


@pytest.mark.parametrize("radius", [0.3, 1.0, 2.5, 4.2])
def test_defocus_is_a_disc_that_keeps_the_light(radius):
    """Its variance is R^2/4 along each axis, and no line is shifted by 1e-4 px."""
    v, u = np.indices((61, 61)) - 30.0
    spot = np.exp(-(u**2 + v**2) / (2.0 * 1.5**2))
    seen = defocus_blur(spot, radius)
    assert seen.sum() == pytest.approx(spot.sum())
    variance = [(image * v**2).sum() / image.sum() for image in (spot, seen)]
    assert variance[1] - variance[0] == pytest.approx(radius**2 / 4.0, rel=1e-3)
    np.testing.assert_allclose(seen, seen[::-1, ::-1], atol=1e-12)
    image = line_image(np.full(41, 60.27), 1.5, height=120)
    line = line_centres(defocus_blur(image, radius), max_sigma=8.0)
    np.testing.assert_allclose(line.row[12:-12], 60.27, atol=1e-4)


@pytest.mark.parametrize("blur", [gaussian_blur, defocus_blur])
@pytest.mark.parametrize("size", [0.3, 1.0, 2.5])
def test_sharp_edges_neither_make_light_nor_go_below_zero(blur, size):
    """A lone bright pixel and a renderer's noise: no light is negative, none is added."""
    sharp = np.zeros((101, 101))
    sharp[50, 50] = 100.0
    sharp[20:40, 20:40] = np.random.default_rng(0).gamma(2.0, size=(20, 20))
    seen = blur(sharp, size)
    assert seen.min() >= 0.0
    assert seen.sum() == pytest.approx(sharp.sum(), rel=1e-3)


def test_no_blur_changes_nothing():
    """Off by default, and nothing when it is zero."""
    image = line_image(np.full(30, 20.3), 1.5, height=40)
    np.testing.assert_allclose(gaussian_blur(image, 0.0), image)
    assert distorted(np.ones(SIZE[::-1]), camera([])) is not None


@pytest.mark.parametrize(
    "coefficients",
    [
        MILD,
        [0.1, 0.0, 1e-3, -2e-3, 0.0],
        [0.0] * 12 + [0.05, -0.03],
    ],
    ids=["barrel", "pincushion, decentred", "Scheimpflug"],
)
def test_a_distorted_line_comes_back_by_undistortion_to_a_thousandth_of_a_pixel(coefficients):
    """The centre found in the distorted image, undistorted, lies on the line that was drawn."""
    seeing = camera(coefficients)
    row = 55.3 + 0.08 * np.arange(SIZE[0])
    image = distorted(line_image(row, 1.6, height=SIZE[1]), seeing)
    line = line_centres(image)
    found = line.pixel[np.isfinite(line.row)]
    assert len(found) > 150
    moved = np.abs(found[:, 1] - (55.3 + 0.08 * found[:, 0]))
    assert moved.max() > 0.03
    ideal = seeing.undistorted(found)
    inner = (ideal[:, 0] > 8) & (ideal[:, 0] < SIZE[0] - 9)
    np.testing.assert_allclose(ideal[inner, 1], 55.3 + 0.08 * ideal[inner, 0], atol=1e-3)


@pytest.mark.parametrize("angle", [0.1, 0.8, -0.7])
def test_only_dark_pixels_are_left_out(angle):
    """A spline read at every pixel gives the same, wherever in the frame the light is."""
    seeing = camera([-0.3, 0.2, 2e-3, -1e-3])
    v, u = np.indices(SIZE[::-1]).astype(float)
    across = (v - 70.0) * np.cos(angle) - (u - 90.0) * np.sin(angle)
    image = np.where(np.abs(across) < 9.0, np.exp(-(across**2) / (2.0 * 1.5**2)), 0.0)
    ideal = seeing.undistorted(np.stack([u, v], axis=-1))
    everywhere = map_coordinates(image, [ideal[..., 1], ideal[..., 0]], order=5)
    np.testing.assert_allclose(distorted(image, seeing), np.maximum(everywhere, 0.0), atol=1e-6)


def test_a_distorted_frame_can_be_recorded():
    """The spline swings below zero about a renderer's noise; a camera takes no negative light."""
    noise = np.random.default_rng(0).gamma(4.0, 0.25, SIZE[::-1])
    frame = distorted(line_image(np.full(SIZE[0], 70.3), 1.0, height=SIZE[1]) * noise, camera(MILD))
    assert grey_values(exposed(frame, 4000.0, ImageSensor()), ImageSensor()).max() > 1000


@pytest.mark.parametrize(
    ("blur", "says"),
    [
        (lambda image: gaussian_blur(image, -1.0), "sigma_px is -1.0"),
        (lambda image: defocus_blur(image, np.nan), "radius_px is nan"),
        (lambda image: gaussian_blur(image * np.nan, 1.0), "finite"),
        (lambda image: distorted(image, camera([0.1, 0, 0, 0])), "has 200 x 160 px"),
    ],
)
def test_what_can_not_be_is_refused(blur, says):
    """In words that name the number or the size."""
    with pytest.raises(InputError, match=says):
        blur(np.ones((20, 20)))
