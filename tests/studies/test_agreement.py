"""The comparison of image and search neither hides a difference nor makes one up."""

from dataclasses import replace

import numpy as np
import pytest

from virtual_sensor.metrology.centres import LineCentres, Status
from virtual_sensor.metrology.dot_peaks import DotCentres, DotStatus
from virtual_sensor.optics.ray_search import FoundPixels, SearchStatus
from virtual_sensor.studies.agreement import compare, match_dots, sound

HEIGHT, WIDTH = 256, 400
RADIUS_MM = 0.15
PIXEL_MM = 0.022
REACH_PX = 17  # where the light ends, 2.5 radii from the middle


def arc(u):
    """A line's rows: a circle's arc, as the paper's cylinder makes one."""
    return 1000.0 - np.sqrt(900.0**2 - (u - 200.0) ** 2)


def searched(u, v, status=None):
    """What a search along pixels (u, v) gives; NaN where `status` says that there is none."""
    status = np.full(len(u), SearchStatus.FOUND) if status is None else status
    pixel = np.where((status == SearchStatus.FOUND)[:, None], np.stack([u, v], axis=1), np.nan)
    blank = np.full((len(u), 3), np.nan)
    return FoundPixels(blank, pixel, blank, np.zeros(len(u)), np.ones(len(u), int), status)


def line(row, status=None):
    """Line centres at rows (W,)."""
    status = np.full(WIDTH, Status.OK, np.uint8) if status is None else status
    blank = np.full(WIDTH, np.nan)
    return LineCentres(np.arange(WIDTH), row, blank, blank, blank, blank, blank, status)


def across(row):
    """Image (H, W) of the coordinate across the sheet for a line at rows (W,); NaN in the dark."""
    beside = np.arange(HEIGHT)[:, None] - row
    return np.where(np.abs(beside) <= REACH_PX, beside * PIXEL_MM, np.nan)


@pytest.fixture
def u():
    """Columns of 150 rays, unevenly placed, from 40.3 to 359.7."""
    steps = np.random.default_rng(3).uniform(0.5, 1.5, 149)
    return 40.3 + 319.4 * np.concatenate([[0.0], np.cumsum(steps)]) / steps.sum()


COLUMNS = np.arange(WIDTH)
ROWS = arc(COLUMNS)


@pytest.mark.parametrize("direction", [1, -1])
def test_a_known_difference_comes_out_in_every_column(u, direction):
    """Rationale: a wave of 0.01 px must not vanish in the spline, nor the order of rays matter."""
    wave = 0.01 * np.sin(COLUMNS)
    found = searched(u[::direction], arc(u)[::direction])
    result = compare(line(ROWS + wave), found, across(ROWS), RADIUS_MM)
    np.testing.assert_array_equal(result.column, np.arange(41, 360))
    np.testing.assert_allclose(result.difference_px, wave[41:360], atol=1e-7)
    assert result.expected == 319  # 41 to 359 lie on it from edge to edge
    assert result.cut == 0
    assert result.rms_px == pytest.approx(0.01 / np.sqrt(2.0), rel=1e-2)
    assert result.largest_px == pytest.approx(0.01, rel=1e-3)


def test_columns_that_the_line_only_partly_covers_are_not_expected(u):
    """Rationale: column 40 has its centre on the line and its left edge beside it."""
    found = searched(u - 0.4, arc(u - 0.4))  # from 39.9 to 359.3
    result = compare(line(ROWS), found, across(ROWS), RADIUS_MM)
    assert (result.column[0], result.column[-1]) == (40, 359)
    assert result.expected == len(range(41, 359))


def test_a_column_without_a_centre_is_expected_and_not_compared(u):
    """Rationale: what the line detection loses must show as columns compared < expected."""
    status = np.full(WIDTH, Status.OK, np.uint8)
    status[100:110] = Status.POOR_FIT
    lost = np.where(status == Status.OK, ROWS, np.nan)
    result = compare(line(lost, status), searched(u, arc(u)), across(ROWS), RADIUS_MM)
    assert result.expected - result.column.size == 10
    assert not np.isin(np.arange(100, 110), result.column).any()


@pytest.mark.parametrize("step_px", [0.0, 40.0])
def test_the_line_is_not_continued_over_a_break(step_px):
    """Rationale: at a shoulder the searched line jumps; a spline through it would swing."""
    u = np.concatenate([np.linspace(40.0, 180.0, 80), np.linspace(210.0, 360.0, 80)])
    truth = ROWS + step_px * (COLUMNS > 195)
    found = searched(u, arc(u) + step_px * (u > 195.0))
    result = compare(line(truth), found, across(truth), RADIUS_MM)
    np.testing.assert_array_equal(result.column, [*range(40, 181), *range(210, 361)])
    assert result.largest_px < 1e-6
    assert result.expected == len(range(41, 180)) + len(range(211, 360))


def test_rays_that_the_camera_does_not_see_part_the_line(u):
    """Rationale: nothing is known of the image where the search found nothing."""
    status = np.full(len(u), SearchStatus.FOUND)
    status[70:80] = SearchStatus.UNDERCUT
    result = compare(line(ROWS), searched(u, arc(u), status), across(ROWS), RADIUS_MM)
    gap = (result.column > u[69]) & (result.column < u[80])
    assert not gap.any()
    assert result.largest_px < 1e-6


@pytest.mark.parametrize("reason", ["edge", "other surface"])
def test_a_profile_that_an_edge_cuts_is_counted_and_left_out(u, reason):
    """Rationale: the centre of half a profile is not the line's, and no fault of the renderer."""
    light = across(ROWS)
    middle = np.rint(ROWS[200:220]).astype(int)
    for column, row in zip(range(200, 220), middle, strict=True):
        beyond = light[row + 4 :, column]
        beyond[:] = np.nan if reason == "edge" else beyond + 2.0 * RADIUS_MM
    wrong = ROWS + 1.0 * ((COLUMNS >= 200) & (COLUMNS < 220))
    result = compare(line(wrong), searched(u, arc(u)), light, RADIUS_MM)
    assert result.cut == 20
    assert result.column.size == result.expected == 319 - 20
    assert result.largest_px < 1e-6


def test_it_is_counted_why_centres_and_columns_are_left_out(u):
    """Rationale: 0.0055 px stood above 696 centres, of which 254 were compared."""
    status = np.full(WIDTH, Status.OK, np.uint8)
    status[100:110] = Status.POOR_FIT
    light = across(ROWS)
    for column in range(200, 220):
        light[int(np.rint(ROWS[column])) + 4 :, column] = np.nan
    result = compare(line(ROWS, status), searched(u, arc(u)), light, RADIUS_MM)
    assert result.cut_centres == 20
    assert result.stray_centres == WIDTH - 319  # 41 to 359 lie on the searched line
    assert result.lost.tolist() == [Status.POOR_FIT] * 10
    centres = int(np.sum(status == Status.OK))
    assert result.count + result.cut_centres + result.stray_centres == centres


@pytest.mark.parametrize("pixel_mm", [PIXEL_MM, 0.18])
def test_a_coarse_film_is_no_edge(u, pixel_mm):
    """Rationale: of pixels larger than the line's radius none was compared: "nan nan 12"."""
    light = across(ROWS) * pixel_mm / PIXEL_MM
    result = compare(line(ROWS), searched(u, arc(u)), light, RADIUS_MM)
    assert (result.count, result.cut) == (319, 0)


def test_wrong_centres_that_are_ok_are_counted_by_the_frames_truth():
    """Rationale: centres that an edge had cut were OK, up to 1.5 px off or 1,581 sigmas."""
    off = np.zeros(WIDTH)
    off[[10, 20]] = 0.09, -0.11  # only the second is too far off by itself
    off[[30, 40, 50]] = 0.03, 0.03, 0.015
    off[60] = 5.0
    sigma = np.full(WIDTH, 0.01)
    sigma[30] = 0.0029  # 0.03 px are over 10 of these
    sigma[50] = 0.0001  # 150 sigmas, but less than anyone resolves
    status = np.full(WIDTH, Status.OK, np.uint8)
    status[60] = Status.POOR_FIT  # and so nobody is deceived
    light = across(ROWS)
    light[:, 70] = np.nan  # no truth there
    found = replace(line(ROWS + off, status), sigma=sigma)
    result = sound(found, light, RADIUS_MM)
    assert (result.known, result.wrong) == (WIDTH - 2, 2)
    assert result.largest_px == pytest.approx(0.11, abs=1e-6)


def test_the_truth_of_a_column_is_on_the_surface_that_was_found():
    """Rationale: over a shoulder a column sees the sheet twice; a step between is no crossing."""
    light = across(ROWS)
    second = np.roll(light, 60, axis=0)
    both = np.where(np.isfinite(light), light, second)
    for found in (ROWS, ROWS + 60.0):
        assert sound(line(found), both, RADIUS_MM).largest_px < 1e-6
    jump = np.where(np.arange(HEIGHT)[:, None] < 100, -1.0, 1.0) * np.ones(WIDTH)
    assert sound(line(np.full(WIDTH, 99.5)), jump, RADIUS_MM).known == 0


def test_a_line_that_folds_back_is_not_compared():
    """Rationale: behind a caustic one column sees the line twice; a spline would mix the two."""
    t = np.linspace(0.0, 1.0, 100)
    u, v = 40.0 + 900.0 * t * (1.0 - 0.6 * t), 50.0 + 100.0 * t
    assert np.diff(u)[0] > 0.0 > np.diff(u)[-1]
    result = compare(line(ROWS), searched(u, v), across(ROWS), RADIUS_MM)
    assert (result.column.size, result.expected) == (0, 0)


@pytest.mark.parametrize("number", [1, 3])
def test_too_few_rays_give_nan_and_no_figure(number):
    """Rationale: a rms of 0 over no column would read as perfect agreement."""
    u = np.linspace(100.0, 110.0, number)
    result = compare(line(ROWS), searched(u, arc(u)), across(ROWS), RADIUS_MM)
    assert np.isnan([result.rms_px, result.largest_px]).all()


def test_rays_of_which_none_was_found_give_nan(u):
    """Rationale: a part that is out of sight is an answer, not a crash."""
    status = np.full(len(u), SearchStatus.OUTSIDE_IMAGE)
    result = compare(line(ROWS), searched(u, arc(u), status), across(ROWS), RADIUS_MM)
    assert np.isnan(result.rms_px)
    assert result.expected == 0


def test_each_ray_gets_its_own_dot_or_none():
    """Rationale: a dot that is missing or unfit must leave its ray empty, not take a neighbour."""
    u = np.array([100.0, 150.0, 200.0, 250.0])
    centres = np.stack([u + 0.02, arc(u) - 0.01], axis=1)
    status = np.array([DotStatus.OK, DotStatus.OVERLAPPING, DotStatus.OK, DotStatus.OK], np.uint8)
    centres[1] = np.nan
    centres[3, 0] += 20.0  # another reflection
    result = match_dots(DotCentres(centres, np.ones(4), status), searched(u, arc(u)))
    np.testing.assert_allclose(result.difference_px[[0, 2]], [[0.02, -0.01]] * 2, atol=1e-12)
    assert np.isnan(result.difference_px[[1, 3]]).all()


def test_no_dots_at_all_leave_every_ray_empty():
    """Rationale: a black frame is an answer, not a crash."""
    none = DotCentres(np.empty((0, 2)), np.empty(0), np.empty(0, np.uint8))
    u = np.array([100.0, 150.0])
    assert np.isnan(match_dots(none, searched(u, arc(u))).pixel).all()
