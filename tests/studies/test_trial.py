"""The trial is fair: known truth, the bound by its formula, the same images for a seed."""

import dataclasses

import numpy as np
import pytest
from artificial import cramer_rao

from virtual_sensor.errors import InputError
from virtual_sensor.imaging.render import render_frame
from virtual_sensor.imaging.scene import load_scene
from virtual_sensor.metrology.centres import LineCentres, Status
from virtual_sensor.metrology.detectors import NAMES
from virtual_sensor.metrology.drawn_lines import cramer_rao_px, line_shares
from virtual_sensor.metrology.truth import TrueLine, rms
from virtual_sensor.optics.ray_search import SearchStatus, ray_search
from virtual_sensor.studies.trial.hard import (
    QUICK_AMOUNTS,
    Bench,
    Sample,
    hard_condition,
    hard_frames,
    sparks,
)
from virtual_sensor.studies.trial.images import (
    AMOUNTS,
    KINDS,
    STATED,
    Condition,
    drawn_line,
    frame_line,
    shifted,
)
from virtual_sensor.studies.trial.scores import PHASES, phase_bias, score
from virtual_sensor.studies.trial.trial import kinds_of, trial

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
    assert found.wrong_share == 0.0  # it predicts no error, and promises none


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


def boastful(image):
    """A user's detector that is off by 0.1 px, and claims 0.01 px in every second column."""
    row = np.full(image.shape[1], 32.1)
    claimed = np.where(np.arange(row.size) % 2, 0.01, 0.03)
    return dataclasses.replace(LineCentres.of_rows(row), sigma=claimed)


def test_a_centre_is_held_against_the_error_that_its_detector_predicts():
    """Off by ten of its sigmas in every second column, by three in the others."""
    flat = drawn_line(CLEAN, 200, (0, 2))
    rows = np.where(np.arange(200) < 180, 32.0, np.nan)
    still = dataclasses.replace(flat, truth=TrueLine.of_rows(rows), options={})
    found = score(f"{__name__}:boastful", CLEAN, still)
    of_nothing = 20  # columns beyond the line's end
    assert found.wrong_share * found.columns == pytest.approx(found.columns // 2 + of_nothing)
    assert found.breaks_the_rule
    assert not score("max_likelihood", CLEAN, flat).breaks_the_rule


def marked(image):
    """The same, whose first half is CLIPPED."""
    line = boastful(image)
    return dataclasses.replace(line, status=np.where(np.arange(200) < 100, Status.CLIPPED, 0))


def test_what_is_marked_as_worth_less_is_counted_apart():
    """The rule is about OK."""
    still = dataclasses.replace(
        drawn_line(CLEAN, 200, (0, 2)), truth=TrueLine.of_rows(np.full(200, 32.0)), options={}
    )
    found = score(f"{__name__}:marked", CLEAN, still)
    assert found.wrong_share == found.marked_wrong_share == 0.25


@pytest.fixture(scope="module")
def hard():
    """A hard frame of each kind, small."""
    return {at.kind: (at, image) for at, image in hard_frames(True, 0, "", KINDS, str)}


PROMISE_TOO_MUCH = {
    kind: {"steger"} for kind in ("edged frame", "spattered frame", "ghostly frame")
}
"""Detectors whose centres are OK, and wrong by more than they say, in hard frames of a kind.

Steger's points have no column's profile behind them, which shows an edge or a second light to the
others; and ridges join where lights touch.
"""


@pytest.mark.parametrize(
    "names", ["gaussian steger", pytest.param(" ".join(NAMES), marks=pytest.mark.slow)]
)
def test_no_detector_promises_more_than_it_keeps_but_those_that_are_named(hard, names):
    """Over 1 % of the columns OK, and off by over six of the sigmas that it predicts."""
    for kind, (condition, image) in hard.items():
        for name in {*names.split()} - PROMISE_TOO_MUCH.get(kind, set()):
            found = score(name, condition, image)
            assert not found.breaks_the_rule, (kind, name, found.wrong_share)


def test_an_edge_of_the_reflectance_shifts_the_light_by_the_formula():
    """Curless and Levoy 1995: by sigma sqrt(2/pi) (1 - r)/(1 + r) where it is in the middle."""
    condition = hard_condition("edged frame", 10.0)
    light, truth = Bench(512).light(condition, np.random.default_rng(0))
    row = truth.centres(5.0).row
    known = np.isfinite(row)
    moment = (light * np.arange(len(light))[:, None]).sum(axis=0)
    shift = moment[known] / light.sum(axis=0)[known] - row[known]
    y = np.linspace(-20.0, 20.0, 512)[known] * 45.0 / 40.0  # mm along the line, of a film of 45
    middles = np.interp(np.arange(-2.5, 3.0) * 40.0 / 6.0, y, shift)
    expected = condition.width_px * np.sqrt(2.0 / np.pi) * 0.9 / 1.1
    np.testing.assert_allclose(np.abs(middles), expected, atol=0.1)
    np.testing.assert_array_equal(np.sign(middles), -np.sign(np.roll(middles, 1)))


def test_hard_frames_are_as_hard_as_they_say(hard):
    """Each has its truth; the clipped one clips, the one in ambient light has it."""
    assert set(hard) == set(QUICK_AMOUNTS)
    for condition, image in hard.values():
        assert image.truth.columns(4.0).size > (230 if condition.kind == "ghostly frame" else 400)
        assert condition.amount == QUICK_AMOUNTS[condition.kind][-1]
    _, clipped = hard["clipped frame"]
    full = (clipped.grey >= clipped.options["saturation"]).sum(axis=0)
    # A Gaussian of sigma 2 px, 8 times over-exposed, lies above the brim for 2 sqrt(2 ln 8) sigma.
    broad = 2.0 * 2.0 * np.sqrt(2.0 * np.log(8.0))
    assert np.median(full) == pytest.approx(broad, abs=1.0)
    _, ambient = hard["ambient frame"]
    assert np.median(ambient.grey) > 1000.0
    for condition, image in hard.values():
        sample = Sample.of(condition, image, "gaussian")
        assert sample.grey.shape == (60, 150)
        assert np.isfinite(sample.true_row).mean() > 0.8
        assert np.all((sample.row >= 0) & (sample.row < 60))


def test_sparks_are_bright_and_repeat_by_their_seed():
    """None makes no light; as many as asked, anywhere."""
    one, same = (sparks((40, 90), 30, np.random.default_rng(3)) for _ in range(2))
    assert one.tobytes() == same.tobytes()
    assert 1.0 < one.max() < 30.0
    assert not sparks((40, 90), 0, np.random.default_rng(3)).any()


def test_kinds_of_images_are_found_by_name():
    """As the command line gives them: "clipped" for a clipped frame, "hard" for all hard ones."""
    assert kinds_of([]) == KINDS
    assert kinds_of(["hard"]) == tuple(AMOUNTS)
    assert kinds_of(["Clipped", "edged_frame", "clipped frame"]) == ("clipped frame", "edged frame")
    assert kinds_of(["saturated", "hot"]) == ("saturated", "hot frame")
    with pytest.raises(InputError, match="no images of the kind 'cliped'"):
        trial(kinds=["cliped"])
