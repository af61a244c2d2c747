"""Where line detectors fail, the column says so: no centre that is wrong is called OK."""

from itertools import product

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
        (0.95, 1.02, 2.0, 8.0, 64.0),
        lambda times, row: line_image(row, SIGMA, times),
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
    "line saturated": {Status.CLIPPED},
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
# Whether a column is doubted does not depend on the detector, but for what its own fit says.
METHODS = [
    ("weighted_gaussian",),
    pytest.param(COLUMNWISE, marks=pytest.mark.slow),
]
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


@pytest.mark.parametrize("methods", METHODS, ids=len)
def test_each_trouble_has_a_status_and_hides_no_wrong_centre(methods):
    """From none to much: the worst is refused whole, and what is OK is right in between."""
    for what, allowed in TOLD.items():
        amounts = TROUBLES[what][0]
        for amount in amounts:
            image, truth = drawn(what, amount)
            saturation = 1.0 if what == "line saturated" else None
            for method in methods:
                case = what, amount, method
                line = line_centres(image, method, saturation=saturation)
                found = line.status == Status.OK
                assert wrong(line, truth).mean() < 0.02, case
                assert statuses(line) <= allowed | {Status.LINE_END}, case
                if amount == amounts[0]:
                    assert np.all(found), case
                elif what == "line saturated":
                    assert np.all(line.found), case
                elif amount == amounts[-1]:
                    broken = what == "line broken"
                    expected = broken & (np.arange(300) % 20 >= 10)
                    np.testing.assert_array_equal(found, expected, err_msg=f"{case}")


@pytest.mark.parametrize("methods", METHODS, ids=len)
def test_two_lines_from_two_sigma_apart_are_no_line(methods):
    """Merged they are SKEWED or flat; apart, of much the same height, either may be the line."""
    for ratio, apart in product((1.0, 0.9, 0.5), (2.0, 2.5, 3.0, 4.0, 6.0, 10.0)):
        image, truth = doubled(ratio, apart)
        for method in methods:
            case = ratio, apart, method
            line = line_centres(image, method)
            assert wrong(line, truth).mean() < 0.02, case
            if ratio > 0.8:
                assert np.mean(line.status == Status.OK) < 0.02, case
                allowed = {Status.DOUBLED, Status.SKEWED, Status.POOR_FIT, Status.AT_BORDER}
                assert statuses(line) <= allowed, case
            elif apart < 4.0:
                assert np.mean(line.status == Status.SKEWED) > 0.98, case


def test_a_weak_line_far_away_is_no_harm():
    """The highest is the line, as long as nothing near it is nearly as high."""
    for method in COLUMNWISE:
        image = line_image(20.3, 2.0, np.ones(50)) + line_image(44.0, 2.0, 0.6 * np.ones(50))
        line = line_centres(image, method)
        assert np.all(line.status == Status.OK), method
        np.testing.assert_allclose(
            line.row, 20.3, atol=1e-4 if method in UNBIASED else 0.07, err_msg=f"{method=}"
        )


@pytest.mark.parametrize("methods", METHODS, ids=len)
def test_noise_is_not_taken_for_trouble(methods):
    """Of sound lines under 1 % are called skewed or doubled, however narrow."""
    for snr, sigma in product((20.0, 100.0), (0.7, 1.0, 2.0, 6.0)):
        rng = np.random.default_rng(9)
        centre = rng.uniform(63.0, 65.0, 1500)
        image = line_image(centre, sigma, height=128) + rng.normal(0.0, 1.0 / snr, (128, 1500))
        for method in methods:
            status = line_centres(image.astype(np.float32), method).status
            doubted = np.isin(status, (Status.SKEWED, Status.DOUBLED))
            assert np.mean(doubted) < 0.01, (snr, sigma, method)


def test_slopes_and_photons_are_not_taken_for_trouble():
    """A steep line's profile is broader and flatter, a bright one's noise is of its own height."""
    rng = np.random.default_rng(10)
    u = (np.arange(60)[:, None] + (np.arange(8) + 0.5) / 8 - 0.5)[None]
    fine = line_image((30.0 + 2.0 * u).ravel(), 1.0, height=200)
    steep = fine.reshape(200, 60, 8).mean(axis=2)
    electrons = rng.poisson(line_image(np.full(800, 31.7), 2.5, 500.0))
    electrons = electrons + rng.normal(0, 3, electrons.shape)
    for method in COLUMNWISE:
        assert np.all(line_centres(steep, method).status == Status.OK), method
        line = line_centres(electrons, method, noise=3.0, gain=1.0)
        assert np.mean(line.status == Status.OK) > 0.98, method


def test_two_lines_nearer_than_that_are_one_whose_centre_lies_between():
    """A limit, not a promise: no pixel tells them from one line a little broader."""
    for apart in (0.5, 1.0, UNRESOLVED):
        image, truth = doubled(1.0, apart)
        middle = truth + 0.5 * apart * SIGMA
        for method in COLUMNWISE:
            line = line_centres(image, method)
            good = line.status == Status.OK
            assert good.mean() > 0.9, (apart, method)
            error, told = np.abs(line.row - middle)[good], np.nan_to_num(line.sigma[good], nan=0.1)
            assert np.all(error < 0.15 + 5.0 * told), (apart, method)
