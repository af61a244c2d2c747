"""Which peaks are the line, beside ghosts that are brighter, cross it, or go on where it ends."""

import numpy as np
import pytest
from artificial import line_image

from virtual_sensor.metrology.centres import Status
from virtual_sensor.metrology.line_peaks import line_centres

COLUMNS, HEIGHT = 600, 200
U = np.arange(COLUMNS)
LINE = 60.0 + 0.05 * U


def drawn(*lights, seed=0, noise=0.005):
    """Image of lights (row, sigma, amplitude), in noise."""
    image = sum(line_image(*light, height=HEIGHT) for light in lights)
    return image + np.random.default_rng(seed).normal(0.0, noise, image.shape)


def outliers(line, truth):
    """How many of the centres are not on the line."""
    off = np.abs(line.row - truth) > 1.0
    return np.sum(line.found & (off | np.isnan(truth)))


def test_a_ghost_that_is_brighter_over_half_the_line_is_a_ghost():
    """Rationale: the highest peak of each column jumps to the ghost; a line goes on."""
    ghost = 150.0 - 0.05 * U
    image = drawn((LINE, 2.0, 1.0), (ghost, 2.5, np.where(U < COLUMNS // 2, 1.5, 0.0)))
    assert outliers(line_centres(image, choose="highest"), LINE) > 290
    line = line_centres(image)
    assert np.mean(line.found) > 0.99
    assert not outliers(line, LINE)
    both = line_centres(image, peaks=3)
    np.testing.assert_array_equal(both.row[0], line.row)
    np.testing.assert_array_equal(both.status[1, :298], Status.GHOST)
    np.testing.assert_allclose(both.row[1, :298], ghost[:298], atol=0.1)
    assert np.all(both.status[2] == Status.NO_PEAK)
    assert np.isnan(both.pixel[1]).all()


@pytest.mark.parametrize("height", [0.3, 1.0, 1.5])
def test_where_the_line_is_missing_no_ghost_takes_its_place(height):
    """The ghost shows beside the line too: there it is known as one."""
    gap = (U > 200) & (U < 320)
    beyond = (U > 150) & (U < 370)
    image = drawn((LINE, 2.0, np.where(gap, 0.0, 1.0)), (150.0, 2.5, np.where(beyond, height, 0.0)))
    line = line_centres(image)
    assert not outliers(line, np.where(gap, np.nan, LINE))
    assert np.mean(line.found[~gap]) > 0.98
    assert np.mean(line.status[gap] == Status.GHOST) > 0.98
    assert np.isnan(line.row[gap]).all()
    several = line_centres(image, peaks=2)
    assert np.isin(several.status[0, gap], (Status.NO_PEAK, Status.LINE_END)).all()
    np.testing.assert_allclose(several.row[1, 205:315], 150.0, atol=0.1)


def test_a_ghost_that_crosses_the_line_does_not_lead_off_it():
    """Where both merge there is no centre; behind it the line goes on as before."""
    ghost = 20.0 + 0.25 * U
    image = drawn((LINE, 2.0, 1.0), (ghost, 2.5, 0.8 + 0.6 * np.sin(U / 30.0)))
    line = line_centres(image)
    assert outliers(line, LINE) <= 3
    assert np.mean(line.found[np.abs(ghost - LINE) > 15.0]) > 0.98


def test_steps_and_gaps_are_no_ghosts():
    """A line may step, even in a comb, break off and come back: bits as of the highest peaks."""
    for row, lit in (
        (np.where(U // 50 % 2, 100.0, 140.0), 1.0),
        (np.where(U // 7 % 2, 100.0, 140.0), 1.0),
        (np.where(U < 300, 50.0, 160.0), np.where(U % 90 < 60, 1.0, 0.0)),
        (np.random.default_rng(1).uniform(20.0, 180.0, COLUMNS), 1.0),
        (LINE, np.where(U < 300, 1.0, 0.15)),
    ):
        image = drawn((row, 2.0, lit))
        line, highest = (line_centres(image, choose=choose) for choose in ("path", "highest"))
        np.testing.assert_array_equal(line.status, highest.status)
        np.testing.assert_array_equal(line.row, highest.row)


def test_spatter_is_not_the_line():
    """Blobs that are up to three times as bright, and of all sizes."""
    image = drawn((LINE, 2.0, np.where((U > 300) & (U < 340), 0.0, 1.0)))
    rng = np.random.default_rng(2)
    v = np.arange(HEIGHT)[:, None]
    for u0, v0 in rng.uniform((0.0, 0.0), (COLUMNS, HEIGHT), (30, 2)):
        broad, tall, bright = rng.uniform((1.0, 1.0, 0.5), (6.0, 15.0, 3.0))
        image += bright * np.exp(-0.5 * (((U - u0) / broad) ** 2 + ((v - v0) / tall) ** 2))
    assert np.sum(np.abs(image.argmax(axis=0) - LINE) > 2.0) > 80  # the gap's 39 among them
    assert outliers(line_centres(image), LINE) <= 3


def test_of_two_lines_as_good_as_each_other_none_is_chosen():
    """Two lasers: DOUBLED if one is asked for; if two are, neither is a ghost."""
    image = drawn((LINE, 2.0, 1.0), (150.0, 2.0, 0.9))
    assert np.mean(line_centres(image).status == Status.DOUBLED) > 0.95
    assert np.all(line_centres(image, peaks=2).status == Status.OK)
    fainter = line_centres(drawn((LINE, 2.0, 1.0), (150.0, 2.0, 0.4)), peaks=2)
    assert np.all(fainter.status[1] == Status.GHOST)


def test_how_a_line_lies_is_seen():
    """Flat, steep or broken; at 45 degrees it is read in columns, as where nothing shows."""
    u = np.arange(150)
    for slope, better in ((0.0, "columns"), (0.7, "columns"), (1.0, "columns"), (1.6, "rows")):
        image = line_image(20.0 + slope * u, 2.0 * np.hypot(1.0, slope), 1.0, height=280)
        image += np.random.default_rng(0).normal(0.0, 0.01, image.shape)
        image[:, 70:80] = 0.0
        for picture, said in ((image, better), (image.T, "columns")):
            if picture is not image and slope < 0.9:
                said = "rows"
            found = line_centres(picture, along="auto")
            assert found.searched[0] == said, slope
            given = line_centres(picture, along=said)
            np.testing.assert_array_equal(found.status, given.status)
    for nothing in (np.zeros((3, 4)), np.full((5, 1), np.nan), np.zeros((30, 40), np.uint8)):
        assert line_centres(nothing, along="auto").searched[0] == "columns"


def test_a_faint_line_across_a_wide_image_does_not_turn_it():
    """A table's edge shows in more columns than there are rows; the laser line stands upright."""
    image = 25.0 * line_image(np.full(200, 90.0), 4.0, 1.0, height=120)
    image += 150.0 * line_image(np.full(120, 60.0), 2.5, 1.0, height=200).T
    image += np.random.default_rng(0).normal(0.0, 1.0, image.shape)
    assert line_centres(image, along="auto").searched[0] == "rows"
    assert line_centres(image.T, along="auto").searched[0] == "columns"


def test_a_glow_beside_the_line_does_not_draw_it_away():
    """As the walls of a shiny groove reflect it: broad, over the line, and as bright in places.

    Rationale: a line on such a slope is lopsided, and must not be corrected onto the glow.
    """
    v = np.arange(HEIGHT)[:, None]
    height = 0.5 * np.clip(1.0 - np.abs(U - 300.0) / 200.0, 0.0, 1.0)
    glow = height * np.exp(-0.5 * ((v - 100.0 - 0.02 * U) / 25.0) ** 2)
    image = 1000.0 * (drawn((LINE, 1.7, 0.3), noise=0.0) + glow) + 10.0
    image = np.random.default_rng(3).poisson(image).astype(float)
    for method in ("gaussian", "centre_of_gravity"):
        line = line_centres(image, method, noise=3.0, gain=1.0)
        assert outliers(line, LINE) <= 6, method
        assert np.mean(line.found) > 0.5, method
