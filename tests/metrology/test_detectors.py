"""Detectors against the Cramer-Rao bound, published biases, and the errors that they predict."""

import re
from importlib import metadata
from itertools import product

import numpy as np
import pytest
from artificial import cramer_rao, line_image

from virtual_sensor.errors import InputError
from virtual_sensor.metrology import detectors
from virtual_sensor.metrology.centres import LineCentres, Status
from virtual_sensor.metrology.detectors import COLUMNWISE
from virtual_sensor.metrology.line_peaks import line_centres

DARK = 2.0  # electrons, of a modern CMOS sensor
WIDTHS = (1.0, 1.5, 2.0, 3.0, 4.0)
ELECTRONS = (200, 632, 2000, 6320, 20000)


def electrons(sigma, count, columns, seed, dark=DARK, height=64):
    """Image of lines of `count` electrons a column in shot and read noise, and the true rows."""
    rng = np.random.default_rng(seed)
    centre = rng.uniform(-0.5, 0.5, columns) + height / 2
    expected = line_image(centre, sigma, count / np.sqrt(2.0 * np.pi) / sigma, height=height)
    return rng.poisson(expected) + rng.normal(0.0, dark, expected.shape), centre


def bound_px(sigma, count, dark=DARK):
    """Rms over the sub-pixel offsets of the smallest error that any detector can have."""
    flux = np.sqrt(2.0 * np.pi) * sigma  # of a line of unit amplitude
    each = [
        cramer_rao(sigma, lambda mu: (mu + dark**2 * flux / count) * flux / count, offset)
        for offset in np.linspace(-0.5, 0.5, 21)
    ]
    return float(np.sqrt(np.mean(np.square(each))))


def rms(values):
    return float(np.sqrt(np.mean(np.square(values))))


@pytest.mark.slow
def test_maximum_likelihood_stays_within_5_percent_of_the_bound():
    """With 20,000 columns the rms itself is known to half a percent; under 2 % are refused."""
    for case in product(ELECTRONS, WIDTHS):
        count, sigma = case
        image, centre = electrons(sigma, count, 20_000, seed=int(10 * sigma) + count)
        line = line_centres(image, "max_likelihood", noise=DARK, gain=1.0)
        found = line.status == Status.OK
        assert found.mean() > 0.98, case
        assert 0.98 < rms((line.row - centre)[found]) / bound_px(sigma, count) < 1.05, case


def test_maximum_likelihood_attains_the_bound_at_the_corners():
    """The quick form of the test above."""
    for case in product((200, 20000), (1.0, 4.0)):
        count, sigma = case
        image, centre = electrons(sigma, count, 4000, seed=count)
        line = line_centres(image, "max_likelihood", noise=DARK, gain=1.0)
        found = line.status == Status.OK
        assert rms((line.row - centre)[found]) / bound_px(sigma, count) == pytest.approx(
            1.0, abs=0.06
        ), case


def assert_sigma_is_the_error_or_nan(sigma, count):
    """For all detectors, of lines of one width and brightness."""
    image, centre = electrons(sigma, count, 4000, seed=int(10 * sigma) + count)
    for method in COLUMNWISE:
        line = line_centres(image, method, noise=DARK, gain=1.0)
        told = np.isfinite(line.sigma)
        if told.mean() > 0.01:
            ratio = rms(line.sigma[told]) / rms((line.row - centre)[told])
            assert ratio == pytest.approx(1.0, abs=0.1), (method, sigma, count)
        whole_line = method in (
            "gaussian",
            "weighted_gaussian",
            "max_likelihood",
            "centre_of_gravity",
        )
        if whole_line or (sigma == 1.0 and count == 20000):  # three rows tell of a bright line only
            assert told.mean() > 0.95, (method, sigma, count)


def test_predicted_sigma_is_the_error_that_is_made_or_nan():
    """Within 10 %, bias included; only a few columns tell, or all of them."""
    for case in ((1.0, 20000), (2.0, 2000), (4.0, 200)):
        assert_sigma_is_the_error_or_nan(*case)


@pytest.mark.slow
def test_predicted_sigma_is_the_error_at_any_width_and_brightness():
    """The same for all widths and brightnesses."""
    for case in product(WIDTHS, ELECTRONS):
        assert_sigma_is_the_error_or_nan(*case)


def test_the_gain_alone_tells_the_shot_noise():
    """Camera noise is taken from the image then: sigma is still the error, peak or skirt."""
    for method in COLUMNWISE:
        image, centre = electrons(1.0, 20000, 4000, seed=7)
        line = line_centres(image, method, gain=1.0)
        told = np.isfinite(line.sigma)
        assert told.mean() > 0.99, method
        assert rms(line.sigma[told]) / rms((line.row - centre)[told]) == pytest.approx(
            1.0, abs=0.1
        ), method


def test_without_a_word_about_the_noise_sigma_comes_from_the_image():
    """White noise, which the image and the residuals show."""
    for method in COLUMNWISE:
        rng = np.random.default_rng(3)
        centre = rng.uniform(31.0, 33.0, 4000)
        image = line_image(centre, 1.5, height=128) + rng.normal(0.0, 0.01, (128, 4000))
        line = line_centres(image, method)
        assert rms(line.sigma) / rms(line.row - centre) == pytest.approx(1.0, abs=0.1), method


def test_three_point_gaussian_has_its_published_bias():
    """Pixel locking by d (1 - 4 d^2)/(1440 s^6), s^2 = sigma^2 + 1/12 (physics.md), within 5 %.

    That is the first term of a series, from the pixel's fourth cumulant, -1/120.  The next, of the
    sixth, 1/252, makes it larger by 5/(21 s^2): 10 % at 1.5 px, under 5 % from 2.2 px on.
    """
    for sigma in (1.5, 2.0, 2.5, 3.0, 4.0, 6.0):
        offset = np.linspace(-0.45, 0.45, 19)
        line = line_centres(line_image(100.0 + offset, sigma, height=200), "log_parabola")
        s2 = sigma**2 + 1.0 / 12.0
        first = offset * (1.0 - 4.0 * offset**2) / (1440.0 * s2**3)
        both = first * (1.0 + 5.0 / (21.0 * s2))
        bias = line.row - 100.0 - offset
        assert np.max(np.abs(bias - both)) < 0.02 * np.max(np.abs(both)), sigma
        within = 0.05 if sigma > 2.2 else 0.105
        assert np.max(np.abs(bias - first)) < within * np.max(np.abs(first)), sigma


def test_fits_that_integrate_over_the_pixel_lock_to_none():
    """No bias above 1e-4 px at any sub-pixel phase: measured, it is below 1e-6."""
    for case in product(
        (0.55, 0.7, 1.0, 1.5, 3.0, 6.0), ("gaussian", "weighted_gaussian", "max_likelihood")
    ):
        sigma, method = case
        offset = np.linspace(-0.5, 0.5, 41)
        line = line_centres(line_image(60.0 + offset, sigma, height=120), method)
        seen = np.isfinite(line.row)
        assert seen.mean() > 0.9, case
        assert np.max(np.abs(line.row - 60.0 - offset)[seen]) < 1e-6, case


@pytest.mark.parametrize(
    ("method", "largest"),
    [
        ("parabola", 0.04),
        ("linear_interpolation", 0.06),
        ("centre_of_gravity", 0.004),
        ("fir4", 0.02),
        ("fir8", 0.02),
    ],
)
def test_other_closed_forms_lock_to_pixels_and_say_by_how_much(method, largest):
    """Fisher and Naidu 1996: hundredths of a pixel; the sigma that they tell is that bias here."""
    offset = np.linspace(-0.5, 0.5, 41)
    line = line_centres(line_image(40.0 + offset, 1.2, height=80), method, noise=1e-9)
    bias = np.abs(line.row - 40.0 - offset)
    assert largest / 20.0 < bias.max() < largest
    np.testing.assert_allclose(line.sigma, bias, atol=0.2 * largest)


def test_the_centre_of_gravity_takes_as_much_of_either_skirt():
    """By whole pixels its window would lie aside of the line: up to 0.03 px, back and forth."""
    for sigma in (1.0, 1.5, 2.0, 3.0, 4.0):
        offset = np.linspace(-0.5, 0.5, 41)
        line = line_centres(line_image(40.0 + offset, sigma, height=80), "centre_of_gravity")
        assert np.max(np.abs(line.row - 40.0 - offset)) < 3e-3 / sigma**2 + 1e-4, sigma


def test_along_rows_it_is_the_transposed_image():
    """A line that stands upright is found by the same numbers."""
    for method in COLUMNWISE:
        image, _ = electrons(1.5, 20000, 200, seed=1)
        flat, upright = line_centres(image, method), line_centres(image.T, method, along="rows")
        for name in ("sigma", "width", "amplitude", "background", "status"):
            np.testing.assert_array_equal(
                getattr(flat, name), getattr(upright, name), err_msg=f"{method=}"
            )
        np.testing.assert_array_equal(flat.pixel, upright.pixel[:, ::-1], err_msg=f"{method=}")
        assert set(flat.normal_deg) == {90.0}, method
        assert set(upright.normal_deg) == {0.0}, method


def test_amplitude_width_and_background_come_with_every_centre():
    """What HALCON and the cameras that extract lines give besides the centre."""
    for method in COLUMNWISE:
        line = line_centres(
            line_image(np.full(30, 40.2), 2.3, 7.0, background=100.0, height=80), method
        )
        np.testing.assert_allclose(line.width, 2.3, rtol=1e-3, err_msg=f"{method=}")
        np.testing.assert_allclose(line.amplitude, 7.0, rtol=1e-3, err_msg=f"{method=}")
        np.testing.assert_allclose(line.background, 100.0, rtol=1e-4, err_msg=f"{method=}")


def test_several_peaks_come_ranked_by_height():
    """Reflections and undercuts: two lines that cross each other, and a third in some columns."""
    for method in COLUMNWISE:
        u = np.arange(120)
        bright, faint = 40.0 + 0.4 * u, 150.0 - 0.4 * u
        third = np.where(u > 70, 190.0 + 0 * u, np.nan)
        image = line_image(bright, 1.6, 1.0, height=220) + line_image(faint, 1.6, 0.5, height=220)
        image[:, u > 70] += line_image(third[u > 70], 1.6, 0.2, height=220)
        line = line_centres(image, method, peaks=3)
        assert line.row.shape == line.status.shape == (3, 120), method
        assert np.all(line.status[0] == Status.OK), method
        tolerance = 0.08  # of the coarsest detector's bias
        np.testing.assert_allclose(line.row[0], bright, atol=tolerance, err_msg=f"{method=}")
        np.testing.assert_allclose(line.row[1], faint, atol=tolerance, err_msg=f"{method=}")
        there = u > 71
        np.testing.assert_allclose(
            line.row[2, there], third[there], atol=tolerance, err_msg=f"{method=}"
        )
        assert set(line.status[2, u < 70]) == {Status.NO_PEAK}, method
        assert line.pixel.shape == (3, 120, 2), method


def test_one_peak_and_the_first_of_several_are_the_same():
    """Asking for more changes nothing of the highest."""
    image, _ = electrons(2.0, 5000, 300, seed=2)
    one, more = line_centres(image), line_centres(image, peaks=3)
    np.testing.assert_array_equal(one.row, more.row[0])
    assert np.all(np.isnan(more.row[1:]))


def test_noise_makes_no_further_peaks():
    """Three peaks asked for, one there: under 1 % of the columns show another."""
    image, _ = electrons(3.0, 20000, 3000, seed=4, height=128)
    line = line_centres(image, peaks=3, noise=DARK, gain=1.0)
    assert np.mean(line.status[1:] == Status.OK) < 0.01


def brightest_row(image):
    """A user's detector, as it might be."""
    return np.where(image.max(axis=0) > 10.0, image.argmax(axis=0), np.nan)


def test_a_function_of_ones_own_is_a_detector():
    """Rows in, centres out, along columns or rows; sigma, width and the like are not made up."""
    image = line_image(np.full(30, 12.2), 2.0, np.where(np.arange(30) < 20, 100.0, 1.0), height=40)
    line = line_centres(image, brightest_row)
    np.testing.assert_array_equal(line.row[:20], 12.0)
    assert set(line.status[20:]) == {Status.NO_PEAK}
    assert np.all(np.isnan(line.sigma))
    upright = line_centres(image.T, brightest_row, along="rows")
    np.testing.assert_array_equal(upright.column[:20], 12.0)


def test_where_a_detector_of_ones_own_fails_is_told():
    """By the line of its own file: whoever wrote it is the one who reads this."""

    def broken(image):
        return image.argmax(axis=7)

    with pytest.raises(
        InputError, match=r"detector broken: fails on .*\(8, 6\) .*AxisError"
    ) as told:
        line_centres(np.zeros((8, 6)), broken)
    assert f"test_detectors.py, line {broken.__code__.co_firstlineno + 1}" in str(told.value)


def test_a_detector_of_ones_own_may_give_all_that_ours_do():
    """A `LineCentres` goes through; what it places off the image does not."""

    def doubled(image):
        found = line_centres(image, "parabola")
        return LineCentres(**{**vars(found), "row": found.row * 2.0})

    image = line_image(np.array([12.0, 32.0]), 2.0, height=40)
    line = line_centres(image, doubled)
    assert [Status(s).name for s in line.status] == ["OK", "POOR_FIT"]
    assert line.row[0] == pytest.approx(24.0, abs=0.1)
    assert np.isnan(line.row[1])


def test_an_entry_point_is_found_by_its_name(monkeypatch):
    """A package that is installed puts its detector beside ours."""
    point = metadata.EntryPoint("brightest", f"{__name__}:brightest_row", detectors.ENTRY_POINTS)
    monkeypatch.setattr(metadata.EntryPoint, "load", lambda self: brightest_row)
    monkeypatch.setattr(detectors.metadata, "entry_points", lambda group: [point])
    line = line_centres(line_image(np.full(5, 12.2), 2.0, 100.0, height=40), "brightest")
    np.testing.assert_array_equal(line.row, 12.0)
    with pytest.raises(InputError, match=r"no method 'dimmest'.*steger, brightest"):
        line_centres(np.zeros((5, 5)), "dimmest")


@pytest.mark.parametrize(
    ("name", "says"),
    [
        ("no.such_module:function", "can't be loaded.*PYTHONPATH"),
        ("numpy:no_such_function", "can't be loaded"),
        ("numpy:pi", "not a function"),
        ("numpy:fliplr", r"gives ndarray of shape \(8, 6\); give a row for each of the 6 columns"),
        ("numpy:shape", r"gives tuple of shape \(2,\)"),
    ],
)
def test_what_is_no_detector_is_refused(name, says):
    """The message names it and what it should be."""
    with pytest.raises(InputError, match=says):
        line_centres(np.zeros((8, 6)), name)


def test_every_detector_names_its_source():
    """Whoever reads a chart can read what it was made after; the year is in it."""
    for method, estimate in COLUMNWISE.items():
        assert re.search(r"[A-Z][a-z]+ .*\b(19|20)\d\d\b", estimate.__doc__), method
