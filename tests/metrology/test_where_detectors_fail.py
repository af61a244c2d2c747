"""Where line detectors fail, the column says so: no centre that is wrong is called OK."""

import numpy as np
import pytest
from artificial import line_image

from virtual_sensor.metrology.centres import Status
from virtual_sensor.metrology.detectors import COLUMNWISE
from virtual_sensor.metrology.line_peaks import line_centres

SIGMA, NOISE = 2.0, 0.005  # px, and of the line's height
ROWS = np.arange(64)[:, None]
TROUBLES = {  # from none to much, and an image of lines at rows (W,) with so much of it
    "line thinner than a pixel": (
        (0.6, 0.5, 0.4, 0.3, 0.2),
        lambda sigma, row: line_image(row, sigma) / line_image(row, sigma).max(),
    ),
    "line saturated": (
        (0.0, 0.02, 0.1, 0.3, 0.6),
        lambda share, row: line_image(row, SIGMA, 1.0 / (1.0 - share) if share else 0.95),
    ),
    "line broken": (
        (0, 1, 3, 10),
        lambda dark, row: line_image(row, SIGMA, 1.0 * (np.arange(row.size) % 20 >= dark)),
    ),
    "line cut by an edge": (
        (4.0, 3.0, 2.0, 1.0, 0.0, -1.0),
        lambda beyond, row: line_image(row, SIGMA) * (np.rint(30.0 + beyond * SIGMA) >= ROWS),
    ),
    "line on an edge of the background": (
        (6.0, 4.0, 3.0, 2.0, 1.0, 0.0),
        lambda away, row: line_image(row, SIGMA) + 0.5 * (np.rint(30.0 + away * SIGMA) < ROWS),
    ),
    "line at the border": (
        (5.0, 3.0, 2.0, 1.0, 0.0, -1.0),
        lambda _, row: line_image(row, SIGMA),
    ),
}
TOLD = {
    "line thinner than a pixel": {Status.TOO_NARROW, Status.POOR_FIT},
    "line saturated": {Status.SATURATED},
    "line broken": {Status.NO_PEAK, Status.LINE_END},
    "line cut by an edge": {
        Status.CUT,
        Status.SKEWED,
        Status.TOO_NARROW,
        Status.POOR_FIT,
        Status.NO_PEAK,
    },
    "line on an edge of the background": {
        Status.SKEWED,
        Status.DOUBLED,
        Status.POOR_FIT,
        Status.AT_BORDER,
    },
    "line at the border": {
        Status.AT_BORDER,
        Status.NO_PEAK,
        Status.TOO_NARROW,
        Status.POOR_FIT,
    },
}
UNBIASED = ("gaussian", "weighted_gaussian", "max_likelihood", "log_parabola")
UNRESOLVED = 1.5  # sigma apart, up to which two lines are one: see the last test


def wrong(line, truth):
    """Columns called OK whose centre is neither near the truth nor within its stated error."""
    error = np.abs(line.row - truth)
    return (error > 0.05) & (error > 3.0 * line.sigma)


def drawn(what, amount, columns=300):
    """An image of lines with so much trouble, in some noise, and the true rows."""
    rng = np.random.default_rng(8)
    row = rng.uniform(29.5, 30.5, columns)
    if what == "line at the border":
        row = row - 30.0 + amount * SIGMA
    image = TROUBLES[what][1](amount, row)
    image = image + rng.normal(0.0, NOISE, image.shape)
    return np.minimum(image, 1.0) if what == "line saturated" else image, row


def doubled(ratio, apart):
    """Two lines, so many sigma apart, and the true rows of the first."""
    rng = np.random.default_rng(8)
    row = rng.uniform(29.5, 30.5, 300)
    image = line_image(row, SIGMA) + ratio * line_image(row + apart * SIGMA, SIGMA)
    return image + rng.normal(0.0, NOISE, image.shape), row


def statuses(line):
    return {Status(status) for status in np.unique(line.status)} - {Status.OK}


@pytest.mark.parametrize("method", COLUMNWISE)
@pytest.mark.parametrize("what", TOLD)
def test_each_trouble_has_a_status_and_hides_no_wrong_centre(method, what):
    """From none to much: the worst is refused whole, and what is OK is right in between."""
    for amount in TROUBLES[what][0]:
        image, truth = drawn(what, amount)
        line = line_centres(image, method, saturation=1.0 if what == "line saturated" else None)
        assert wrong(line, truth).mean() < 0.02
        assert statuses(line) <= TOLD[what] | {Status.LINE_END}
        if amount == TROUBLES[what][0][0]:
            assert np.all(line.status == Status.OK)
    if what == "line broken":
        np.testing.assert_array_equal(line.status == Status.OK, np.arange(300) % 20 >= 10)
    else:
        assert not np.any(line.status == Status.OK)


@pytest.mark.parametrize("method", COLUMNWISE)
@pytest.mark.parametrize("ratio", [1.0, 0.9, 0.5])
def test_two_lines_from_two_sigma_apart_are_no_line(method, ratio):
    """Merged they are SKEWED or flat; apart, of much the same height, either may be the line."""
    for apart in (2.0, 2.5, 3.0, 4.0, 6.0, 10.0):
        image, truth = doubled(ratio, apart)
        line = line_centres(image, method)
        assert wrong(line, truth).mean() < 0.02
        if ratio > 0.8:
            assert np.mean(line.status == Status.OK) < 0.02
            allowed = {Status.DOUBLED, Status.SKEWED, Status.POOR_FIT, Status.AT_BORDER}
            assert statuses(line) <= allowed
        elif apart < 4.0:
            assert np.mean(line.status == Status.SKEWED) > 0.98


@pytest.mark.parametrize("method", COLUMNWISE)
def test_a_weak_line_far_away_is_no_harm(method):
    """The highest is the line, as long as nothing near it is nearly as high."""
    image = line_image(20.3, 2.0, np.ones(50)) + line_image(44.0, 2.0, 0.6 * np.ones(50))
    line = line_centres(image, method)
    assert np.all(line.status == Status.OK)
    np.testing.assert_allclose(line.row, 20.3, atol=1e-4 if method in UNBIASED else 0.07)


@pytest.mark.parametrize("method", COLUMNWISE)
@pytest.mark.parametrize("sigma", [0.7, 1.0, 2.0, 6.0])
@pytest.mark.parametrize("snr", [20.0, 100.0])
def test_noise_is_not_taken_for_trouble(method, sigma, snr):
    """Of sound lines under 1 % are called skewed or doubled, however narrow."""
    rng = np.random.default_rng(9)
    centre = rng.uniform(63.0, 65.0, 1500)
    image = line_image(centre, sigma, height=128) + rng.normal(0.0, 1.0 / snr, (128, 1500))
    line = line_centres(image.astype(np.float32), method)
    assert np.mean(np.isin(line.status, (Status.SKEWED, Status.DOUBLED))) < 0.01


@pytest.mark.parametrize("method", COLUMNWISE)
def test_slopes_and_photons_are_not_taken_for_trouble(method):
    """A steep line's profile is broader and flatter, a bright one's noise is of its own height."""
    rng = np.random.default_rng(10)
    u = (np.arange(60)[:, None] + (np.arange(8) + 0.5) / 8 - 0.5)[None]
    fine = line_image((30.0 + 2.0 * u).ravel(), 1.0, height=200)
    steep = fine.reshape(200, 60, 8).mean(axis=2)
    assert np.all(line_centres(steep, method).status == Status.OK)
    electrons = rng.poisson(line_image(np.full(800, 31.7), 2.5, 500.0)) + rng.normal(
        0, 3, (64, 800)
    )
    line = line_centres(electrons, method, noise=3.0, gain=1.0)
    assert np.mean(line.status == Status.OK) > 0.98


@pytest.mark.parametrize("method", COLUMNWISE)
def test_two_lines_nearer_than_that_are_one_whose_centre_lies_between(method):
    """A limit, not a promise: no pixel tells them from one line a little broader."""
    for apart in (0.5, 1.0, UNRESOLVED):
        image, truth = doubled(1.0, apart)
        line = line_centres(image, method)
        good = line.status == Status.OK
        assert good.mean() > 0.9
        middle = truth + 0.5 * apart * SIGMA
        error, told = np.abs(line.row - middle)[good], np.nan_to_num(line.sigma[good], nan=0.1)
        assert np.all(error < 0.15 + 5.0 * told)
