"""Dot centroids against images of known truth."""

import numpy as np
import pytest
from artificial import dot_image

from virtual_sensor.errors import InputError
from virtual_sensor.metrology.dot_peaks import DotStatus, dot_centres


@pytest.mark.parametrize("scale", [1e-6, 1e4])
@pytest.mark.parametrize("sigma", [1.0, 2.0, 4.0])
def test_centroid_and_flux_are_those_of_the_dots(sigma, scale):
    """The window holds the whole dot, so neither its rim nor the threshold shifts the centroid."""
    rng = np.random.default_rng(1)
    centres = np.column_stack([np.arange(12, 92, 20), [20.0, 28.0, 22.0, 26.0]]) * sigma
    centres += rng.uniform(-0.5, 0.5, centres.shape)
    shape = (int(48 * sigma), int(96 * sigma))
    image = scale * dot_image(centres, sigma, flux=7.0, shape=shape, background=0.2)
    dots = dot_centres(image)
    np.testing.assert_array_equal(dots.status, DotStatus.OK)
    np.testing.assert_allclose(dots.pixel, centres, atol=1e-4)
    np.testing.assert_allclose(dots.flux, 7.0 * scale, rtol=1e-3)


def test_dots_are_sorted_along_the_line():
    """By u, whatever their row."""
    centres = np.array([[80.0, 20.0], [20.0, 44.0], [50.0, 30.0]])
    dots = dot_centres(dot_image(centres, 2.0, shape=(64, 100)))
    np.testing.assert_allclose(dots.pixel, centres[[1, 2, 0]], atol=1e-3)


@pytest.mark.parametrize("dtype", [np.uint8, np.uint16, np.float32])
def test_camera_images_are_read(dtype):
    """Integers and noise: hundredths of a pixel remain."""
    rng = np.random.default_rng(2)
    image = 10.0 + dot_image([[30.3, 25.6]], 3.0, flux=200.0 * 2.0 * np.pi * 9.0, shape=(50, 60))
    dots = dot_centres((image + rng.normal(0.0, 1.0, image.shape)).astype(dtype))
    np.testing.assert_array_equal(dots.status, [DotStatus.OK])
    np.testing.assert_allclose(dots.pixel, [[30.3, 25.6]], atol=0.1)


def test_statuses_name_what_is_wrong():
    """Hot pixel, border, close neighbour, clipping, missing pixel; the last is good."""
    peak = 2.0 * np.pi * 4.0
    centres = [[50.0, 3.0], [90.0, 30.0], [98.0, 30.0], [170.0, 30.0], [210.0, 30.0]]
    image = dot_image(centres, 2.0, flux=peak, shape=(64, 240))
    image += dot_image([[130.0, 30.0]], 2.0, flux=1.5 * peak, shape=(64, 240))
    image[30, 20] = 1.1
    image[31, 171] = np.nan
    dots = dot_centres(image, saturation=1.2)
    names = [DotStatus(status).name for status in dots.status]
    assert names == ["TOO_SMALL", "AT_BORDER", "OVERLAPPING", "SATURATED", "BAD_PIXELS", "OK"]
    np.testing.assert_array_equal(np.isnan(dots.pixel).all(axis=1), dots.status != DotStatus.OK)
    np.testing.assert_array_equal(np.isnan(dots.flux), dots.status != DotStatus.OK)


@pytest.mark.parametrize("distance", [3.0, 4.0, 6.0, 8.0, 10.0, 14.0])
def test_neighbours_are_apart_or_refused(distance):
    """Where two dots touch there is no centroid of one; where there is one, it is right."""
    centres = np.array([[40.2, 30.4], [40.2 + 2.0 * distance, 31.1]])
    dots = dot_centres(dot_image(centres, 2.0, shape=(64, 110)))
    if distance < 8.5:
        assert np.all(dots.status == DotStatus.OVERLAPPING)
    if distance > 10:
        np.testing.assert_allclose(dots.pixel, centres, atol=1e-3)


@pytest.mark.parametrize(
    "image",
    [
        np.zeros((9, 9)),
        np.full((9, 9), np.nan),
        np.full((9, 9), np.inf),
        np.full((9, 9), 255, np.uint8),
        np.full((9, 9), -1.0),
        np.ones((1, 40)),
        np.ones((1, 1), np.float32),
        np.random.default_rng(3).normal(0.0, 1.0, (200, 200)),
    ],
    ids=lambda image: f"{image.dtype}{image.shape}",
)
def test_images_without_a_dot_have_none(image):
    """Shapes stay those of M dots, M = 0."""
    dots = dot_centres(image)
    assert dots.pixel.shape == (0, 2)
    assert dots.flux.shape == dots.status.shape == (0,)


def test_what_it_cannot_work_with_is_refused():
    """A colour image and a threshold beyond the brightest dot."""
    with pytest.raises(InputError, match="grey"):
        dot_centres(np.zeros((5, 5, 3)))
    with pytest.raises(InputError, match="threshold"):
        dot_centres(np.zeros((5, 5)), threshold=1.0)
