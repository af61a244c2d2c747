"""The comparison of centres with the truth neither hides a difference nor makes one up."""

from dataclasses import replace
from types import SimpleNamespace

import numpy as np
import pytest

from virtual_sensor.errors import InputError
from virtual_sensor.metrology.centres import LineCentres, Status
from virtual_sensor.metrology.dot_peaks import DotCentres, DotStatus
from virtual_sensor.metrology.truth import TrueLine, TruthStatus, compare_dots, compare_line

HEIGHT, WIDTH = 256, 400
RADIUS_MM = 0.15
PIXEL_MM = 0.022
REACH_PX = 17  # where the light ends, 2.5 radii from the middle


def arc(u):
    """A line's rows: a circle's arc, as the paper's cylinder makes one."""
    return 1000.0 - np.sqrt(900.0**2 - (u - 200.0) ** 2)


def searched(u, v, found=True):
    """The truth of a search along pixels (u, v), of which some are not found."""
    found = np.broadcast_to(found, u.shape)
    pixel = np.where(found[:, None], np.stack([u, v], axis=1), np.nan)
    return TrueLine.of_search(pixel, found, WIDTH)


def compare(found, truth, light, radius_mm):
    """The centres beside a search, in a frame that shows where an edge cuts the line."""
    return compare_line(found, truth.seen_in(light, radius_mm))


def by_frame(found, light, radius_mm):
    """The centres beside the frame's own truth."""
    return compare_line(found, TrueLine.of_coordinates(light, radius_mm), cut=True)


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
    np.testing.assert_allclose(result.error_px, wave[41:360], atol=1e-7)
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
    found = (np.arange(len(u)) < 70) | (np.arange(len(u)) >= 80)
    result = compare(line(ROWS), searched(u, arc(u), found), across(ROWS), RADIUS_MM)
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
    result = by_frame(found, light, RADIUS_MM)
    assert (result.count, result.wrong().sum()) == (WIDTH - 2, 2)
    assert result.largest_px == pytest.approx(0.11, abs=1e-6)


def test_the_truth_of_a_column_is_on_the_surface_that_was_found():
    """Rationale: over a shoulder a column sees the sheet twice; a step between is no crossing."""
    light = across(ROWS)
    second = np.roll(light, 60, axis=0)
    both = np.where(np.isfinite(light), light, second)
    for found in (ROWS, ROWS + 60.0):
        assert by_frame(line(found), both, RADIUS_MM).largest_px < 1e-6
    jump = np.where(np.arange(HEIGHT)[:, None] < 100, -1.0, 1.0) * np.ones(WIDTH)
    assert by_frame(line(np.full(WIDTH, 99.5)), jump, RADIUS_MM).count == 0


def test_a_line_that_folds_back_is_not_compared():
    """Rationale: behind a caustic one column sees the line twice; a spline would mix the two."""
    t = np.linspace(0.0, 1.0, 100)
    u, v = 40.0 + 900.0 * t * (1.0 - 0.6 * t), 50.0 + 100.0 * t
    assert np.diff(u)[0] > 0.0 > np.diff(u)[-1]
    result = compare(line(ROWS), searched(u, v), across(ROWS), RADIUS_MM)
    assert (result.column.size, result.expected) == (0, 0)
    assert set(result.left_out) == {TruthStatus.FOLDED, TruthStatus.NO_LINE}


@pytest.mark.parametrize("number", [1, 3])
def test_too_few_rays_give_nan_and_no_figure(number):
    """Rationale: a rms of 0 over no column would read as perfect agreement."""
    u = np.linspace(100.0, 110.0, number)
    result = compare(line(ROWS), searched(u, arc(u)), across(ROWS), RADIUS_MM)
    assert np.isnan([result.rms_px, result.largest_px]).all()


def test_rays_of_which_none_was_found_give_nan(u):
    """Rationale: a part that is out of sight is an answer, not a crash."""
    result = compare(line(ROWS), searched(u, arc(u), False), across(ROWS), RADIUS_MM)
    assert np.isnan(result.rms_px)
    assert result.expected == 0


def test_each_ray_gets_its_own_dot_or_none():
    """Rationale: a dot that is missing or unfit must leave its ray empty, not take a neighbour."""
    u = np.array([100.0, 150.0, 200.0, 250.0])
    centres = np.stack([u + 0.02, arc(u) - 0.01], axis=1)
    status = np.array([DotStatus.OK, DotStatus.OVERLAPPING, DotStatus.OK, DotStatus.OK], np.uint8)
    centres[1] = np.nan
    centres[3, 0] += 20.0  # another reflection
    truth = np.stack([u, arc(u)], axis=1)
    result = compare_dots(DotCentres(centres, np.ones(4), status), truth)
    np.testing.assert_allclose(result.error_px[[0, 2]], [[0.02, -0.01]] * 2, atol=1e-12)
    assert np.isnan(result.error_px[[1, 3]]).all()
    assert result.stray == 1


def test_no_dots_at_all_leave_every_ray_empty():
    """Rationale: a black frame is an answer, not a crash."""
    none = DotCentres(np.empty((0, 2)), np.empty(0), np.empty(0, np.uint8))
    assert np.isnan(compare_dots(none, np.array([[100.0, 80.0], [150.0, 80.0]])).pixel).all()
    assert compare_dots(none, np.empty((0, 2))).count == 0


def test_two_rays_do_not_share_a_dot():
    """Rationale: of two dots that nearly touch one is lost; its ray must not take the other's."""
    dots = DotCentres(np.array([[100.0, 50.0]]), np.ones(1), np.zeros(1, np.uint8))
    result = compare_dots(dots, np.array([[100.1, 50.0], [101.0, 50.0], [np.nan, np.nan]]))
    assert result.found.tolist() == [True, False, False]
    assert compare_dots(dots, np.array([[101.0, 50.0]]), reach_px=0.5).count == 0


def test_a_frame_tells_the_row_of_a_curved_profile_to_a_ten_thousandth():
    """Rationale: through a lens or a plume the coordinate is not linear; its zero is known."""
    v = np.arange(HEIGHT)[:, None] - ROWS
    light = np.where(np.abs(v) < 20.0, 0.4 * np.tan(v / 20.0) + 0.1 * (v / 20.0) ** 2, np.nan)
    truth = TrueLine.of_coordinates(light.astype(np.float32), RADIUS_MM)
    assert truth.row.shape == (1, WIDTH)
    np.testing.assert_allclose(truth.row[0], ROWS, atol=1e-4)


def test_margins_are_counted_from_where_the_line_ends():
    """Rationale: columns at its ends are lit in part; the image's border is no end."""
    row = np.full(WIDTH, 80.0)
    row[[100, 101, 102, 200]] = np.nan
    truth = TrueLine.of_rows(row)
    kept = np.setdiff1d(COLUMNS, [*range(97, 106), *range(197, 204)])
    np.testing.assert_array_equal(truth.columns(3.5), kept)
    result = compare_line(line(np.full(WIDTH, 80.5)), truth, end_px=3.5)
    np.testing.assert_array_equal(result.column, kept)
    assert result.expected == kept.size
    assert result.left_out == {TruthStatus.BROKEN: 4, TruthStatus.NEAR_END: 12}
    truth = searched(np.linspace(40.0, 360.0, 321), np.full(321, 80.0))
    np.testing.assert_array_equal(truth.columns(2.5), np.arange(43, 358))
    np.testing.assert_array_equal(truth.centres(2.5).status == Status.OK, abs(COLUMNS - 200) < 158)


def test_what_was_left_out_is_said_in_a_line():
    """Rationale: who prints it sees first what a person wants to know."""
    truth = TrueLine.of_rows(np.where(COLUMNS < 390, 80.0, np.nan))
    assert repr(truth) == "TrueLine: of 400 columns 390 known, 10 no_line"
    assert repr(compare_line(line(np.full(WIDTH, 80.01)), truth)) == (
        "LineErrors: 390 centres, rms 0.01 px, at most 0.01 px; 0 of 390 columns lost;"
        " left out: 10 no_line"
    )


def random_search(rng):
    """Parts of a line as (first, last, row(u), folded), and rays along them; some turn back."""
    parts, rays, first = [], [], rng.uniform(-3.0, 20.0)
    while first < WIDTH - 60.0:
        last = min(first + rng.uniform(30.0, 150.0), WIDTH + 2.0)
        height, slope, wave = rng.uniform([60.0, -0.2, 0.0], [190.0, 0.2, 2.0])
        u = np.arange(first, last, 1.5)
        folded = rng.random() < 0.2
        if folded:
            u = np.concatenate([u, u[::-1][1:] + 0.3])
        v = height + slope * (u - 200.0) + wave * np.sin(u / 20.0)
        parts.append((u.min(), u.max(), (height, slope, wave), folded))
        rays += [np.stack([u, v], axis=1), np.full((2, 2), np.nan)]  # two that nothing sees
        first = last + rng.uniform(15.0, 40.0)
        if rng.random() < 0.3:  # behind a shoulder: the same columns again
            first = max(last - 10.0, 0.0)
    pixel = np.concatenate(rays)
    return parts, pixel[:: rng.choice([1, -1])]


def random_centres(rng, rows):
    """Centres of which some are lost and some far off, each near one of its column's rows."""
    row = np.array([rng.choice(each) if each else 90.0 for each in rows])
    row = row + rng.normal(0.0, 0.05, WIDTH)
    stray = rng.random(WIDTH) < 0.05
    row[stray] += rng.uniform(-20.0, 20.0, stray.sum())
    status = np.where(rng.random(WIDTH) < 0.1, Status.POOR_FIT, Status.OK).astype(np.uint8)
    return line(row, status)


def by_hand(found, rows, counts, wanted):
    """Errors by column, columns expected, statuses of those lost, and the centres left out.

    `rows` are the true ones of each column; `counts` and `wanted` tell which of them a centre is
    compared with, and which make the column expected.
    """
    errors, expected, lost, left_out = {}, 0, [], 0
    for c in COLUMNS:
        expected += any(wanted[c])
        if found.status[c] != Status.OK:
            lost += [found.status[c]] * any(wanted[c])
            continue
        apart = [abs(found.row[c] - row) for row in rows[c]]
        nearest = apart.index(min(apart)) if apart else None
        if apart and counts[c][nearest]:
            errors[c] = found.row[c] - rows[c][nearest]
        else:
            left_out += 1
    return errors, expected, lost, left_out


def assert_scored(result, expected_of_it, px, seed):
    errors, expected, lost, left_out = expected_of_it
    assert result.column.tolist() == list(errors), seed
    np.testing.assert_allclose(result.error_px, list(errors.values()), atol=px, err_msg=f"{seed=}")
    assert (result.expected, result.lost.tolist()) == (expected, lost), seed
    assert sum(result.left_out.values()) == left_out, seed


def test_random_searched_lines_are_scored_as_by_hand():
    """Rationale: column by column, with the rows in closed form and no spline, no arrays."""
    for seed in range(40):
        rng = np.random.default_rng(seed)
        parts, pixel = random_search(rng)
        truth = TrueLine.of_search(pixel, np.isfinite(pixel[:, 0]), WIDTH)
        end_px = rng.choice([0.0, 0.5, 3.0])
        rows, counts, wanted = ([[] for _ in COLUMNS] for _ in range(3))
        for c in COLUMNS:
            for first, last, (height, slope, wave), folded in parts:
                if first <= c <= last and not folded:
                    rows[c].append(height + slope * (c - 200.0) + wave * np.sin(c / 20.0))
                    counts[c].append(min(c - first, last - c) >= end_px)
                    wanted[c].append(min(c - first, last - c) >= max(end_px, 0.5))
        found = random_centres(rng, rows)
        result = compare_line(found, truth, end_px=end_px)
        assert_scored(result, by_hand(found, rows, counts, wanted), 1e-4, seed)


def test_random_frames_are_scored_as_by_hand():
    """Rationale: light on up to two surfaces, cut by edges at random places, gone in columns."""
    for seed in range(40):
        rng = np.random.default_rng(seed)
        lines = (
            90.0 + rng.uniform(-0.1, 0.1) * (COLUMNS - 200.0),
            170.0 + 2.0 * np.sin(COLUMNS / 9.0),
        )
        light = np.full((HEIGHT, WIDTH), np.nan)
        rows, whole = ([[] for _ in COLUMNS] for _ in range(2))
        needed = 1.5 * RADIUS_MM / PIXEL_MM  # px on either side
        for c in COLUMNS:
            for row in (each[c] for each in lines[: rng.integers(0, 3)]):
                seen = [REACH_PX if rng.random() < 0.95 else rng.uniform(-2.0, 14.0) for _ in "ab"]
                at = np.arange(int(np.ceil(row - seen[0])), int(np.floor(row + seen[1])) + 1)
                light[at, c] = (at - row) * PIXEL_MM
                if at.size and at[0] <= row <= at[-1]:
                    rows[c].append(row)
                    whole[c].append(min(row - at[0], at[-1] - row) > needed)
        found = random_centres(rng, rows)
        truth = TrueLine.of_coordinates(light, RADIUS_MM)
        assert_scored(compare_line(found, truth), by_hand(found, rows, whole, whole), 1e-9, seed)
        every = [[True] * len(each) for each in rows]
        with_cut = compare_line(found, truth, cut=True)
        assert_scored(with_cut, by_hand(found, rows, every, every), 1e-9, seed)


def test_points_between_columns_are_compared_with_the_line_between():
    """Rationale: a detector of lines of any direction has its points anywhere along them."""
    for seed in range(20):
        rng = np.random.default_rng(seed)
        truth = np.where(rng.random(WIDTH) < 0.05, np.nan, 80.0 + 0.3 * COLUMNS)
        u = rng.uniform(-2.0, WIDTH + 1.0, 500)
        v = 80.0 + 0.3 * u + rng.normal(0.0, 0.1, u.size)
        blank = np.full(u.size, np.nan)
        status = np.where(rng.random(u.size) < 0.2, Status.SKEWED, Status.OK)
        result = compare_line(
            LineCentres(u, v, blank, blank, blank, blank, blank, status), TrueLine.of_rows(truth)
        )
        expected = []
        for each, row, given in zip(u, v, status, strict=True):
            column = round(each)
            if given != Status.OK or not 0 <= column < WIDTH or np.isnan(truth[column]):
                continue
            beside = column + (1 if each > column else -1)
            joined = 0 <= beside < WIDTH and np.isfinite(truth[beside])
            expected.append(row - (80.0 + 0.3 * (each if joined else column)))
        np.testing.assert_allclose(result.error_px, expected, atol=1e-9, err_msg=f"{seed=}")


def test_of_several_peaks_each_is_compared_with_its_own_row():
    """Rationale: over a shoulder a column has two lines, and a detector may be asked for both."""
    rows = np.stack([ROWS, ROWS + 60.0])
    blank = np.full((2, WIDTH), np.nan)
    status = np.zeros((2, WIDTH), np.uint8)
    status[1, 50] = Status.AT_BORDER
    peaks = LineCentres(
        np.stack([COLUMNS] * 2), rows[::-1] + 0.01, blank, blank, blank, blank, blank, status
    )
    result = compare_line(peaks, TrueLine.of_rows(rows))
    assert result.count == 2 * WIDTH - 1
    np.testing.assert_allclose(result.error_px, 0.01, atol=1e-9)
    assert result.lost.size == 0


def test_a_frames_line_ends_at_a_step_and_at_no_slope():
    """Rationale: where the line jumps to another surface its columns are lit in part."""
    row = 40.0 + 0.4 * COLUMNS + np.where(COLUMNS >= 150, 30.0, 0.0)
    truth = TrueLine.of_coordinates(across(row), RADIUS_MM)
    np.testing.assert_array_equal(truth.columns(3.5), np.setdiff1d(COLUMNS, range(147, 153)))


def test_a_column_that_sees_one_whole_line_is_not_cut():
    """Rationale: columns are counted once: over a shoulder the second line may be cut."""
    light = across(ROWS)
    below = across(ROWS + 60.0)
    below[np.arange(HEIGHT)[:, None] > ROWS + 64.0] = np.nan
    light = np.where(np.isfinite(light), light, below)
    truth = TrueLine.of_coordinates(light, RADIUS_MM)
    result = compare_line(line(ROWS), truth)
    assert (result.count, result.expected, result.cut) == (WIDTH, WIDTH, 0)
    result = compare_line(line(ROWS + 60.0), truth)
    assert (result.count, result.cut_centres, result.cut) == (0, WIDTH, 0)


def test_a_frame_and_an_array_of_rows_serve_as_truth():
    """Rationale: a user has a frame, or drew the line; neither should need to know TrueLine."""
    light = (np.arange(float(HEIGHT))[:, None] - ROWS) * 0.02
    frame = SimpleNamespace(
        source_coordinates={"laser": light},
        radius_mm={"laser": 0.1},
        source_name=lambda name: name or "laser",
        coordinates=lambda name: np.stack([light, 0.0 * light], axis=-1),
    )
    found = line(ROWS + 0.25)
    for truth in (frame, ROWS):
        result = compare_line(found, truth)
        assert result.count > WIDTH - 10, type(truth)
        np.testing.assert_allclose(result.error_px, 0.25, atol=1e-9)
    with pytest.raises(InputError, match="give a frame"):
        compare_line(found, 3.0)
    part = LineCentres.of_rows(ROWS[:100])
    with pytest.raises(InputError, match=f"line has 100 columns, the frame {WIDTH}; compare"):
        compare_line(part, frame)
