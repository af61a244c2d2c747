"""The trial is fair: known truth, the bound by its formula, the same images for a seed."""

import numpy as np
import pytest
from artificial import cramer_rao

from virtual_sensor.errors import InputError
from virtual_sensor.imaging.render import render_frame
from virtual_sensor.imaging.scene import load_scene
from virtual_sensor.metrology.drawn_lines import cramer_rao_px, line_shares
from virtual_sensor.metrology.truth import TrueLine, rms
from virtual_sensor.optics.ray_search import SearchStatus, ray_search
from virtual_sensor.studies.trial.images import (
    STATED,
    Condition,
    drawn_line,
    frame_line,
    shifted,
)
from virtual_sensor.studies.trial.scores import PHASES, phase_bias, score
from virtual_sensor.studies.trial.trial import trial

CLEAN = Condition("clean", 2.0, 2000.0, 2.0)


@pytest.mark.parametrize("width", [0.5, 1.0, 4.0])
def test_the_bound_is_that_of_the_formula(width):
    """Beside the tests' own, written with SciPy's distributions."""
    shares, slopes = line_shares(np.array([32.0, 32.3]), width, 64)
    bound = cramer_rao_px(2000.0 * shares, 2000.0 * slopes, 3.0)
    flux = np.sqrt(2.0 * np.pi) * width
    for offset, value in zip((0.0, 0.3), bound, strict=True):
        expected = cramer_rao(
            width, lambda mu: (mu + (9.0 + 1 / 12) * flux / 2000.0) * flux / 2000.0, offset
        )
        assert value == pytest.approx(expected, rel=1e-6)


def test_the_derivative_by_the_spectrum_is_that_of_the_line():
    """For rendered frames, whose lines are broad enough to be sampled by their pixels."""
    shares, slopes = line_shares(np.array([32.0, 32.3]), 2.0, 64)
    np.testing.assert_allclose(-shifted(shares), slopes, atol=1e-7)


def test_the_stated_task_has_its_peak_and_its_bound():
    """A line of sigma 1.5 px, 5000 e at its peak, read noise 2 e, beside the tests' own bound."""
    image = drawn_line(STATED, 400, seed=3)
    light = (image.grey - STATED.camera.black_level).sum(axis=0)
    assert np.mean(light) == pytest.approx(5000.0 * np.sqrt(2.0 * np.pi) * 1.5, rel=1e-3)
    expected = cramer_rao(1.5, lambda mu: (mu + (4.0 + 1 / 12) / 5000.0) / 5000.0)
    assert rms(image.bound_px) == pytest.approx(expected, rel=0.01)


def test_images_repeat_to_the_bit_by_their_seed():
    """Whoever has the seed has the images."""
    for kind in ("clean", "saturated", "speckle", "ambient light"):
        condition = Condition(kind, 2.0, 6320.0, 2.0)
        one, same, other = (drawn_line(condition, 200, (seed, 0)) for seed in (1, 1, 2))
        assert one.grey.tobytes() == same.grey.tobytes()
        assert one.grey.tobytes() != other.grey.tobytes()


def test_a_likelihood_fit_scores_the_bound_and_a_poor_one_what_it_errs_by():
    """Bias, deviation and prediction agree with what is known of the detectors."""
    image = drawn_line(CLEAN, 3000, (0, 1))
    best = score("max_likelihood", CLEAN, image)
    assert best.rms_px / best.bound_px == pytest.approx(1.0, abs=0.06)
    assert best.predicted_px / best.rms_px == pytest.approx(1.0, abs=0.06)
    assert abs(best.bias_px) < 4.0 * best.std_px / np.sqrt(3000)
    assert best.outlier_share == 0.0
    assert best.lost_share < 0.01
    assert best.time_us > 0.0
    poor = score("parabola", CLEAN, image)
    assert poor.rms_px > 3.0 * best.rms_px


def off_by_a_quarter(image):
    """A user's detector, wrong by 0.25 px, by 9 px in a tenth of the columns, blind in a fifth."""
    row = 32.25 + 0.0 * image[0]
    row[::10] += 9.0
    row[1::5] = np.nan
    return row


def test_what_a_users_detector_does_is_counted():
    """Bias, outliers and failures of one whose faults are known."""
    flat = drawn_line(CLEAN, 1000, (0, 2))
    still = type(flat)(flat.grey, TrueLine.of_rows(np.full(1000, 32.0)), flat.bound_px, {})
    found = score(f"{__name__}:off_by_a_quarter", CLEAN, still)
    assert found.bias_px == pytest.approx(0.25)
    assert found.std_px == pytest.approx(0.0, abs=1e-12)
    assert found.outlier_share == pytest.approx(0.1)
    assert found.lost_share == pytest.approx(0.2)
    assert np.isnan(found.predicted_px)


def test_phases_show_the_published_bias():
    """Of the three-point Gaussian at 2 px; a fit has none."""
    s2 = 4.0 + 1.0 / 12.0
    expected = PHASES * (1 - 4 * PHASES**2) / (1440 * s2**3) * (1 + 5 / (21 * s2))
    np.testing.assert_allclose(phase_bias("log_parabola", 2.0), expected, atol=1e-7)
    assert np.nanmax(np.abs(phase_bias("gaussian", 2.0))) < 1e-6


@pytest.fixture(scope="module")
def hot():
    scene = load_scene("hot_cylinder", width=512, height=512)
    return scene, render_frame(scene)


def truth_of(scene, frame):
    return TrueLine.of_coordinates(frame.coordinates()[:, :, 0], scene.sensor.laser.radius_mm)


def test_the_truth_of_a_frame_is_the_ray_searchs(hot):
    """From the ground truth of its pixels, against rays searched one by one: 1e-3 px."""
    scene, frame = hot
    truth = truth_of(scene, frame).centres(3.5).row
    found = ray_search(scene, np.linspace(-10.0, 10.0, 201), "newton")
    u, v = found.pixel[found.status == SearchStatus.FOUND].T
    order = np.argsort(u)
    column = np.flatnonzero(np.isfinite(truth))
    inner = column[(column > u.min() + 1) & (column < u.max() - 1)]
    assert inner.size > 150
    from scipy.interpolate import CubicSpline

    spline = CubicSpline(u[order], v[order])
    np.testing.assert_allclose(truth[inner], spline(inner), atol=2e-3)


def test_a_recorded_frame_is_found_to_its_bound(hot):
    """The bound of a rendered column, by the spectrum of its own profile."""
    _, frame = hot
    condition = Condition.of_peak("hot frame", 1.6, 1000.0, 2.0)
    image = frame_line(condition, frame, truth_of(*hot), (0, 0))
    found = score("max_likelihood", condition, image)
    assert found.rms_px / found.bound_px == pytest.approx(1.0, abs=0.15)


def test_an_unknown_detector_is_refused_before_any_work():
    """In a line that has all names."""
    with pytest.raises(InputError, match="no method 'centroid'; take gaussian"):
        trial(["centroid"])
    with pytest.raises(InputError, match="columns is 3"):
        trial(columns=3)


def test_a_line_that_an_image_sensor_records_is_of_its_data_sheet():
    """Its peak at 80 % of what the sensor can tell, its noise and its fixed pattern."""
    for name in ("cmos_5um5", "profile_sensor"):  # one with a knee-point
        condition = Condition.of_sensor("task", 2.0, name, None)
        sheet = condition.camera
        image = drawn_line(condition, 300, seed=1)
        assert condition.read_noise_electrons == sheet.dark_noise_e
        top = np.median(image.grey.max(axis=0)) - sheet.black_level
        assert top == pytest.approx(0.8 * sheet.saturation_e * sheet.gain, rel=0.15)
        found = score("max_likelihood", condition, image)
        assert found.condition == condition
        assert found.lost_share < 0.05
        assert found.ratio < 4.0
