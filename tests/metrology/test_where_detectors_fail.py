"""Where line detectors fail, the column says so: no centre that is wrong is called OK."""

import numpy as np
import pytest
from artificial import line_image

from virtual_sensor.metrology.centres import Status
from virtual_sensor.metrology.detectors import COLUMNWISE
from virtual_sensor.metrology.line_peaks import line_centres
from virtual_sensor.studies.chart import detectors, line_failures
from virtual_sensor.studies.chart.line_failures import examples, troubles

TROUBLES = {trouble.what: trouble for trouble in troubles()}
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


def statuses(line):
    return {Status(status) for status in np.unique(line.status)} - {Status.OK}


@pytest.mark.parametrize("method", COLUMNWISE)
@pytest.mark.parametrize("what", TOLD)
def test_each_trouble_has_a_status_and_hides_no_wrong_centre(method, what):
    """From none to much: the worst is refused whole, and what is OK is right in between."""
    trouble = TROUBLES[what]
    for amount in trouble.amounts:
        image, truth = examples(trouble, amount, 300)
        line = line_centres(image, method, saturation=trouble.saturation)
        assert wrong(line, truth).mean() < 0.02
        assert statuses(line) <= TOLD[what] | {Status.LINE_END}
        if amount == trouble.amounts[0]:
            assert np.all(line.status == Status.OK)
    if what == "line broken":
        np.testing.assert_array_equal(line.status == Status.OK, np.arange(300) % 20 >= 10)
    else:
        assert not np.any(line.status == Status.OK)


@pytest.mark.parametrize("method", COLUMNWISE)
@pytest.mark.parametrize("ratio", [1.0, 0.9, 0.5])
def test_two_lines_from_two_sigma_apart_are_no_line(method, ratio):
    """Merged they are SKEWED or flat; apart, of much the same height, either may be the line."""
    trouble = TROUBLES[f"line doubled, the second of {ratio:g} times the height"]
    for apart in (2.0, 2.5, 3.0, 4.0, 6.0, 10.0):
        image, truth = examples(trouble, apart, 300)
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
    trouble = TROUBLES["line doubled, the second of 1 times the height"]
    for apart in (0.5, 1.0, UNRESOLVED):
        image, truth = examples(trouble, apart, 300)
        line = line_centres(image, method)
        good = line.status == Status.OK
        assert good.mean() > 0.9
        middle = truth + 0.5 * apart * line_failures.SIGMA_PX
        error, told = np.abs(line.row - middle)[good], np.nan_to_num(line.sigma[good], nan=0.1)
        assert np.all(error < 0.15 + 5.0 * told)


def test_the_panel_has_a_line_for_each_trouble_and_method():
    """In the small: what the chart prints; only lines too near each other go untold."""
    told = line_failures.failures(lambda stage, fraction: None, quick=True)
    assert len(told) == len(TROUBLES) * len(COLUMNWISE)
    for failure in told:
        assert failure.first_at
        assert failure.status
        assert 0 < failure.failed <= failure.of
        if "doubled" not in failure.what:
            assert failure.note == "none called OK is wrong"


def test_the_panels_lines_are_drawn_as_the_tests_are():
    """With the error function over the pixel's edges, written twice."""
    centre = np.linspace(30.0, 31.0, 7)
    drawn = detectors.gaussian_lines(centre, 1.3, 64, 5.0)
    np.testing.assert_allclose(drawn, line_image(centre, 1.3, 5.0), atol=1e-12)
