"""The parts of a recorded measurement's error, each against something that knows nothing of it."""

from dataclasses import replace

import numpy as np
import pytest

from virtual_sensor.devices.image_sensor import ImageSensor
from virtual_sensor.imaging.recording import record
from virtual_sensor.imaging.recording_options import RecordingOptions
from virtual_sensor.imaging.render import render
from virtual_sensor.imaging.scene import load_scene
from virtual_sensor.metrology.line_peaks import line_centres
from virtual_sensor.metrology.truth import TrueLine, rms
from virtual_sensor.reporting.error_split import split_words
from virtual_sensor.studies.error_split import (
    ErrorSplit,
    half_a_pixel_lower,
    nearest_rows,
    split_error,
    split_summary,
)
from virtual_sensor.studies.measure import measure, searched_line
from virtual_sensor.studies.notes import unsplit

FILM = {"width": 256, "height": 256, "spp": 4, "line_radius": 0.4}
TEMPORAL = ImageSensor(prnu=0.0, dsnu_e=0.0, dark_noise_e=20.0)


@pytest.fixture(scope="module")
def hot():
    """The hot cylinder, recorded by a sensor without a fixed pattern."""
    return measure(
        load_scene("hot_cylinder", **FILM), recording=RecordingOptions(TEMPORAL, seed=1)
    ).hot


def test_the_parts_of_each_point_add_up_to_its_error(hot):
    """Rationale: what a designer mends must come off the whole."""
    split = hot.split
    known = split.known
    assert known.sum() > 0.95 * hot.centres
    whole = np.sum([*split.parts_um.values()], axis=0)
    np.testing.assert_allclose(whole[known], hot.section_error_um[known], atol=1e-9)
    np.testing.assert_array_equal(split.error_um, hot.section_error_um)
    np.testing.assert_array_equal(split.pixel, hot.centres_px)
    assert list(split.parts_um) == ["refraction", "detector", "pixels", "noise", "rounding"]


def test_refraction_is_what_rays_find_without_an_image(hot):
    """Rationale: along the whole line it is the searched section's error, at the rays' own places.

    It is read off between the rays, a hundredth of a pixel off.
    """
    part, y = hot.split.parts_um["refraction"], hot.split.y_mm
    known = hot.split.known
    at = hot.section.along_mm(hot.searched_mm)
    right = np.interp(y[known], at, hot.searched_error_um)
    assert rms(part[known]) == pytest.approx(rms(right), rel=0.01)
    assert np.abs(part[known] - right).max() < 0.02 * np.abs(right).max()


def test_noise_is_that_of_fifty_seeds(hot):
    """Rationale: one frame's columns show what one column shows frame after frame.

    The standard deviation of 120 columns is known to 6 %.
    """
    rows = np.array(
        [
            line_centres(record(hot.scene, hot.frame, seed, sensor=TEMPORAL)).row
            for seed in range(100, 150)
        ]
    )
    of_seeds = rms(np.nanstd(rows[:, hot.split.known], axis=0))
    assert split_summary(hot.split).parts["noise"].rms_px == pytest.approx(
        of_seeds, rel=0.15
    )  # 3 sigma


def test_rounding_is_the_noise_of_a_twelfth_of_its_step():
    """Rationale: below a noise of a grey value, rounding is white noise of variance 1/12.

    So it moves the line by as much less than the noise does as its standard deviation is less.
    """
    coarse = ImageSensor(
        gain=1e-3, full_well_e=1e9, dark_noise_e=800.0, bit_depth=8, prnu=0.0, dsnu_e=0.0
    )
    recording = RecordingOptions(coarse)
    state = measure(load_scene("cold_cylinder", **FILM), recording=recording).cold
    parts = split_summary(state.split).parts
    signal = float(np.nanmedian(state.line.amplitude)) / 2.0
    noise = np.sqrt(0.8**2 + coarse.gain * signal)
    expected = np.sqrt(1.0 / 12.0) / noise
    assert parts["rounding"].rms_px / parts["noise"].rms_px == pytest.approx(expected, rel=0.2)


def test_the_pixels_part_follows_the_pixels_and_the_detectors_does_not():
    """Rationale: a parabola through three pixels errs by the sine of where the line lies in them.

    The bias of the same detector that has nothing to do with the pixels is a slow one.
    """
    scene = load_scene("cold_cylinder", **FILM | {"line_radius": 0.25})
    state = measure(scene).cold
    column = state.line.column

    def centres(image):
        return line_centres(image, "parabola").pixel

    at = centres(state.frame.radiance)
    row = nearest_rows(searched_line(state.scene, state.dense), at[:, 1])
    straight = np.stack([column, row], axis=1)
    lower = centres(render(half_a_pixel_lower(state.scene)))
    split = split_error(state.scene, state.section, straight, straight, lower, {"pixels": at})
    known = split.known
    phase = 2.0 * np.pi * row[known]
    pixels, detector = split.parts_px["pixels"][known], split.parts_px["detector"][known]
    size = 2.0 * np.mean(pixels * np.sin(phase))
    assert abs(size) > 0.01
    assert rms(pixels - size * np.sin(phase)) < 0.15 * rms(pixels)
    assert abs(2.0 * np.mean((detector - detector.mean()) * np.sin(phase))) < 0.05 * abs(size)


def test_an_image_half_a_pixel_lower_shows_the_line_there():
    """Rationale: with the sign wrong the pixels' part would be the detector's."""
    scene = load_scene("cold_cylinder", **FILM)
    lower, image = (line_centres(render(each)).row for each in (half_a_pixel_lower(scene), scene))
    assert np.nanmax(np.abs(lower - image - 0.5)) < 2e-3


def test_a_column_that_sees_the_line_twice_is_split_by_the_nearer_row():
    """Rationale: behind an edge the other row is hundreds of micrometres off."""
    line = TrueLine.of_rows([[10.0, 10.0, np.nan], [20.0, np.nan, np.nan]])
    np.testing.assert_array_equal(nearest_rows(line, np.array([19.0, 30.0, 5.0])), [20, 10, np.nan])
    np.testing.assert_array_equal(nearest_rows(line, np.full(3, np.nan)), [10, 10, np.nan])


def test_that_no_point_is_split_is_told(hot):
    """Rationale: a sweep has nothing to say of noise then, and would not say why."""
    assert unsplit(hot.split) == []
    parts = dict.fromkeys(hot.split.parts_um, np.full(hot.split.error_um.size, np.nan))
    assert "too narrow" in unsplit(replace(hot.split, parts_um=parts))[0]
    lost = replace(hot.split, parts_um=parts, error_um=np.full(hot.split.error_um.size, np.nan))
    assert unsplit(lost) == []  # there is no centre, which another note says


def test_dots_are_split_too(hot):
    """Rationale: their error is that of points as well."""
    scene = load_scene("hot_cylinder", **FILM | {"dots": "-3, 0, 4"})
    state = measure(scene, recording=RecordingOptions(TEMPORAL, seed=1)).hot
    split = state.split
    assert split.known.all()
    whole = np.sum([*split.parts_um.values()], axis=0)
    np.testing.assert_allclose(whole, state.section_error_um, atol=1e-9)
    np.testing.assert_allclose(split.parts_um["refraction"], state.searched_error_um, atol=1e-9)


@pytest.mark.slow
def test_the_lens_s_part_is_what_frames_through_it_show():
    """Rationale: hot air makes another lens of each point of the pupil, which no detector mends.

    The frame through the pupil knows nothing of the search: what it shows beside is the detector's.
    Cold, the lens moves the line by a hundredth of that.
    """
    scene = load_scene("hot_cylinder", **FILM, f_number=4)
    result = measure(scene, recording=RecordingOptions(replace(TEMPORAL, pixel_um=44.0)))
    cold, hot = (split_summary(state.split).parts for state in result.states.values())
    assert list(hot)[:3] == ["refraction", "lens", "detector"]
    assert hot["lens"].rms_px > 0.02
    assert hot["detector"].rms_px < 0.15 * hot["lens"].rms_px
    assert cold["lens"].rms_px < 0.1 * hot["lens"].rms_px


def test_a_difference_of_frames_is_split_without_the_light_that_it_leaves_out():
    """Rationale: glow bends the profile's foot in the ideal frame, and not in the difference.

    Its noise is that of two frames: of the dark one by the dark noise, with as many electrons here.
    """
    glowing = load_scene("hot_cylinder", **FILM, emissivity=0.8)
    dark = replace(TEMPORAL, dark_noise_e=300.0)
    noise, detector = [], []
    for difference in (False, True):
        options = RecordingOptions(dark, seed=2, difference=difference)
        parts = split_summary(measure(glowing, recording=options).hot.split).parts
        noise.append(parts["noise"].rms_px)
        detector.append(parts["detector"].rms_px)
        assert parts["rounding"].rms_px < 0.02 * parts["noise"].rms_px
    assert noise[1] / noise[0] == pytest.approx(np.sqrt(2.0), rel=0.25)
    assert detector[1] < 0.003


def test_where_nothing_is_found_no_part_is_known(hot):
    """Rationale: no figure where there is none, and no failure."""
    over = RecordingOptions(replace(TEMPORAL, dark_noise_e=9000.0))
    state = measure(load_scene("cold_cylinder", **FILM), recording=over).cold
    figures = split_summary(state.split)
    assert (figures.points, figures.others, figures.largest) == (0, 0, "")
    assert np.isnan(figures.whole.rms_um)


def test_points_of_which_not_all_parts_are_known_are_counted():
    """Rationale: an rms of the easy points alone says too little, and must say of how many it is.

    One point has no centre in the ideal frame, one none at all.
    """
    nothing, error = np.nan, np.array([3.0, 4.0, 5.0, np.nan])
    parts = {"detector": np.array([1.0, 1.0, nothing, nothing]), "noise": error - 1.0}
    split = ErrorSplit(np.zeros((4, 2)), np.zeros(4), error, parts, parts)
    figures = split_summary(split)
    assert (figures.points, figures.others) == (2, 1)
    assert figures.whole.rms_um == pytest.approx(np.sqrt(12.5))
    assert figures.parts["noise"].mean_um == 2.5
    assert split_words({"hot": figures}) == [
        "In hot air the error of 3.54 µm rms is made of: noise 2.55 and detector 1 µm. Of 1 point"
        " more not all parts are known."
    ]
