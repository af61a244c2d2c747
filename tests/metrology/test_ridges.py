"""Lines of any direction: against lines drawn at known places, in noise, and what is not a line."""

from itertools import product

import numpy as np
import pytest
from artificial import line_image

from virtual_sensor.metrology.centres import Status
from virtual_sensor.metrology.line_peaks import line_centres

FINE = 5


def drawn(away, width=2.0, height=100.0, level=0.0, step=0.0, size=120):
    """Image of a line at `away`(points) = 0, from FINE x FINE samples a pixel; a step beyond it."""
    place = (np.arange(size * FINE) + 0.5) / FINE - 0.5
    distance = away(np.stack(np.meshgrid(place, place), axis=-1))
    fine = level + height * np.exp(-(distance**2) / (2.0 * width**2)) + step * (distance > 0.0)
    return fine.reshape(size, FINE, size, FINE).mean(axis=(1, 3))


def straight(degrees, offset=0.3, size=120):
    normal = np.array([np.cos(np.radians(degrees)), np.sin(np.radians(degrees))])
    return lambda points: (points - size / 2.0) @ normal - offset


def circle(radius, size=120):
    middle = np.array([size / 2.0 - radius + 3.3, size / 2.0 + 0.2])
    return lambda points: np.linalg.norm(points - middle, axis=-1) - radius


def found(line):
    good = line.status == Status.OK
    return line.pixel[good], good


@pytest.mark.parametrize("width", [1.0, 4.0, pytest.param(2.0, marks=pytest.mark.slow)])
def test_straight_lines_of_any_direction_are_found_to_a_thousandth_of_a_pixel(width):
    """One point a pixel along the line, with its width, height and direction."""
    for degrees in (0.0, 10.0, 30.0, 45.0, 77.0, 90.0, 120.0, 165.0):
        case = width, degrees
        away = straight(degrees)
        line = line_centres(drawn(away, width, level=7.0), "steger")
        points, good = found(line)
        assert len(points) > 120 - 10 * 1.3 * max(width, 1.2) - 6, case
        assert np.abs(away(points)).max() < 1e-3, case
        assert np.abs(np.sin(np.radians(line.normal_deg[good] - degrees))).max() < 2e-3, case
        np.testing.assert_allclose(line.width[good], width, rtol=0.02, err_msg=f"{case}")
        np.testing.assert_allclose(line.amplitude[good], 100.0, rtol=0.02, err_msg=f"{case}")
        np.testing.assert_allclose(line.background[good], 7.0, atol=0.5, err_msg=f"{case}")


@pytest.mark.parametrize("radius", [40.0, 60.0, 80.0, 300.0])
def test_a_curved_line_is_not_drawn_inwards(radius):
    """Smoothing alone would draw it in by scale^2/(2 R): 0.08 px at 40 px."""
    away = circle(radius)
    points, _ = found(line_centres(drawn(away), "steger"))
    assert abs(np.mean(away(points))) < 0.07 * 2.6**2 / (2.0 * radius)
    assert np.abs(away(points)).max() < 0.15 * 2.6**2 / (2.0 * radius) + 1e-3


@pytest.mark.parametrize("degrees", [0.0, 35.0, 90.0])
def test_a_step_of_the_background_under_the_line_shifts_it_by_a_hundredth_of_a_pixel(degrees):
    """Steger's bias correction: without it the centre would be off by half a pixel."""
    away = straight(degrees)
    points, _ = found(line_centres(drawn(away, step=30.0, level=20.0), "steger"))
    assert len(points) > 80
    assert np.abs(away(points)).max() < 0.02


@pytest.mark.parametrize("step", [-50.0, pytest.param(30.0, marks=pytest.mark.slow)])
def test_a_step_of_the_background_loses_no_point_at_any_phase(step):
    """The ridge is a pixel or more off the line: whose pixel it lies in must not matter."""
    for case in product(np.arange(-0.4, 0.5, 0.2), (0.0, 10.0, 90.0)):
        offset, degrees = case
        away = straight(degrees, offset)
        points, _ = found(line_centres(drawn(away, step=step, level=60.0), "steger"))
        angle = np.radians(degrees)
        along = np.sort(points @ [-np.sin(angle), np.cos(angle)])
        assert np.ptp(along) > 95.0, case
        assert np.diff(along).max() < 1.5, case


@pytest.mark.parametrize(
    ("noise", "step", "images", "within"),
    [
        (1.0, 30.0, 12, 0.2),
        pytest.param(1.0, 30.0, 48, 0.1, marks=pytest.mark.slow),
        pytest.param(1.0, 0.0, 48, 0.1, marks=pytest.mark.slow),
        pytest.param(10.0, -50.0, 48, 0.1, marks=pytest.mark.slow),
    ],
)
def test_predicted_sigma_holds_in_any_direction_and_on_a_step(noise, step, images, within):
    """White noise: the noise of what is taken off for the step and the bend counts too.

    Neighbours share their noise: of 12 images the ratio has a standard error of 0.046, of 48 half.
    """
    rng = np.random.default_rng(int(noise + step) + 100)
    error, sigma = [], []
    for _ in range(images):
        away = straight(rng.uniform(0.0, 180.0), rng.uniform(-1.0, 1.0))
        image = drawn(away, step=step, level=60.0)
        line = line_centres(image + rng.normal(0.0, noise, image.shape), "steger", noise=noise)
        points, good = found(line)
        error.append(away(points))
        sigma.append(line.sigma[good])
    observed = np.sqrt(np.mean(np.concatenate(error) ** 2))
    assert len(np.concatenate(error)) > images * 90
    predicted = np.sqrt(np.mean(np.concatenate(sigma) ** 2))
    assert predicted / observed == pytest.approx(1.0, abs=within)


@pytest.mark.parametrize("width", [1.0, 2.0, pytest.param(4.0, marks=pytest.mark.slow)])
@pytest.mark.parametrize("count", [200, 2000, 20000])
def test_predicted_sigma_is_the_error_that_is_made(width, count):
    """Shot and read noise; neighbours share their noise, so many columns are needed for 10 %."""
    rng = np.random.default_rng(count + int(width))
    peak = count / np.sqrt(2.0 * np.pi) / width
    columns = 6_000 if width > 2.0 else 3_000
    expected = line_image(np.full(columns, 32.3), width, peak)
    image = rng.poisson(expected) + rng.normal(0.0, 2.0, expected.shape)
    line = line_centres(image, "steger", noise=2.0, gain=1.0)
    points, good = found(line)
    assert len(points) > 0.97 * columns
    error = np.sqrt(np.mean((points[:, 1] - 32.3) ** 2))
    assert np.sqrt(np.mean(line.sigma[good] ** 2)) / error == pytest.approx(1.0, abs=0.1)


def test_it_says_what_is_wrong_with_a_point():
    """Clipped, missing and border pixels: no point there is OK, and those far away are."""
    image = drawn(straight(90.0))
    image[:, 20] = np.where(np.arange(120) == 60, np.nan, image[:, 20])
    image[60, 80] = 200.0
    line = line_centres(image, "steger", saturation=150.0)
    by_column = dict(zip(np.rint(line.column).astype(int), line.status, strict=True))
    assert by_column[20] == Status.BAD_PIXELS
    assert by_column[80] == Status.SATURATED
    assert by_column[2] == Status.AT_BORDER
    assert by_column[50] == by_column[100] == Status.OK
    bad = line.status != Status.OK
    for values in (line.row, line.sigma, line.width, line.amplitude):
        np.testing.assert_array_equal(np.isnan(values), bad)


@pytest.mark.parametrize("degrees", [90.0, 60.0, 125.0])
def test_where_a_line_ends_no_wrong_point_is_called_right(degrees):
    """Cut off by columns, oblique lines' smoothed ends hang aside by more than a pixel."""
    away = straight(degrees)
    image = drawn(away)
    image[:, :30] = image[:, 95:] = 0.0
    line = line_centres(image, "steger")
    points, _ = found(line)
    assert len(points) > 35
    assert np.abs(away(points)).max() < 0.05
    assert np.sum(line.status == Status.LINE_END) > 8
    u = line.column[line.status == Status.LINE_END]
    assert np.all((u < 50) | (u > 75))


def test_a_fragment_too_short_to_be_a_line_is_none():
    """A speck of dirt, or a bright grain: its direction and place are chance."""
    image = drawn(straight(90.0))
    image[:, :55] = image[:, 67:] = 0.0
    assert not np.any(line_centres(image, "steger").status == Status.OK)


def test_two_lines_that_cross_are_both_found():
    """Away from where they cross; no branch in between is made up."""
    first, second = straight(80.0), straight(20.0, offset=-4.0)
    image = drawn(first) + drawn(second, height=60.0)
    points, _ = found(line_centres(image, "steger"))
    away = np.minimum(np.abs(first(points)), np.abs(second(points)))
    near_cross = (np.abs(first(points)) < 16.0) & (np.abs(second(points)) < 16.0)
    assert away[~near_cross].max() < 0.1
    assert np.sum(np.abs(first(points)) < 0.1) > 60
    assert np.sum(np.abs(second(points)) < 0.1) > 60


@pytest.mark.parametrize("dtype", [np.uint8, np.uint16, np.float32, np.float64])
def test_units_and_offsets_do_not_matter(dtype):
    """The same line in grey values of any type and size."""
    away = straight(33.0)
    scale = {np.uint8: 2.0, np.uint16: 500.0, np.float32: 1e-6, np.float64: 1e12}[dtype]
    image = (drawn(away, level=10.0) * scale).astype(dtype)
    points, _ = found(line_centres(image, "steger"))
    assert np.abs(away(points)).max() < (0.02 if dtype == np.uint8 else 2e-3)


@pytest.mark.parametrize(
    "image",
    [
        np.zeros((40, 30)),
        np.full((40, 30), 0.1, np.float32),
        np.full((40, 30), np.nan),
        np.full((40, 30), np.inf, np.float32),
        np.full((40, 30), -1e300),
        np.random.default_rng(4).normal(0.0, 1.0, (400, 300)),
        np.random.default_rng(5).poisson(3.0, (400, 300)).astype(np.uint16),
        np.random.default_rng(6).uniform(-1.0, 1.0, (1, 50)),
        np.ones((1, 1)),
        np.eye(3),
    ],
    ids=lambda image: f"{image.dtype}{image.shape}",
)
def test_images_without_a_line_have_no_point(image):
    """Not one made-up number, and no warning (pytest makes them errors)."""
    line = line_centres(image, "steger")
    assert not np.any(line.status == Status.OK)
    assert np.all(np.isnan(line.row))
