"""Lines of two sources in one image: each is found as if it were alone, or not at all."""

from itertools import product

import numpy as np
import pytest
from artificial import line_image
from scipy.ndimage import binary_erosion

from virtual_sensor.errors import InputError
from virtual_sensor.metrology.bands import lines_in_bands
from virtual_sensor.metrology.centres import Status
from virtual_sensor.metrology.line_peaks import line_centres
from virtual_sensor.metrology.truth import TrueLine

HEIGHT, WIDTH = 200, 600
COLUMNS = np.arange(WIDTH)
SIGMA = 2.0
HALF_PX = 6.0 * SIGMA
# They cross in column 300 at an angle, where the second is also the brighter.
ROWS = {"left": 100.0 + 0.25 * (COLUMNS - 300.3), "right": 100.0 - 0.2 * (COLUMNS - 300.3)}


def bands(rows=ROWS, half_px=HALF_PX):
    return {name: TrueLine.of_rows(row).band(HEIGHT, half_px) for name, row in rows.items()}


def alone(heights):
    """By source, the image of its line without the others."""
    return {name: line_image(ROWS[name], SIGMA, heights[name], height=HEIGHT) for name in ROWS}


FREE = np.abs(ROWS["left"] - ROWS["right"]) > 2.0 * HALF_PX + 1.0
FAR = binary_erosion(FREE, np.ones(55), border_value=True)


def test_each_line_is_found_as_if_it_were_alone():
    """Rationale: two lasers in a scene must measure what each would; 0.002 px is the promise."""
    for case in product(
        ("gaussian", "max_likelihood", "centre_of_gravity", "steger"), (1.0, 10.0, 100.0)
    ):
        method, ratio = case
        images = alone({"left": 1.0, "right": ratio})
        found = lines_in_bands(sum(images.values()), bands(), method)
        for name, line in found.items():
            if method == "steger":
                good = line.status == Status.OK
                at = np.rint(line.column[good]).astype(int)
                assert np.isin(np.flatnonzero(FAR)[12:-12], at).all(), case
                expected = np.interp(line.column[good], COLUMNS, ROWS[name])
                np.testing.assert_allclose(line.row[good], expected, atol=0.002, err_msg=f"{case}")
                continue
            by_itself = line_centres(images[name], method)
            np.testing.assert_array_equal(
                line.status[FREE], by_itself.status[FREE], err_msg=f"{case}"
            )
            np.testing.assert_allclose(
                line.row[FREE], by_itself.row[FREE], atol=1e-4, err_msg=f"{case}"
            )
            assert np.all(line.status[~FREE][1:-1] == Status.OVERLAPPING), case
            assert np.isnan(line.row[~FREE][1:-1]).all(), case


def test_no_column_in_which_both_bands_hold_light_has_a_centre():
    """Rationale: a centre of two lines' light is nobody's, and must not be OK."""
    images = alone({"left": 1.0, "right": 2.0})
    band = bands()
    together = (band["left"] & band["right"]).any(axis=0)
    assert together.sum() > 50
    for line in lines_in_bands(sum(images.values()), band).values():
        assert np.all(line.status[together] == Status.OVERLAPPING)


@pytest.mark.parametrize("seeds", [range(8), pytest.param(range(8, 30), marks=pytest.mark.slow)])
def test_random_lines_are_told_apart_where_they_are_apart_and_nowhere_else(seeds):
    """Rationale: three waves of any brightness and width; which columns are free, by hand."""
    for seed in seeds:
        rng = np.random.default_rng(seed)
        rows, widths, images = {}, {}, {}
        for name in "abc":
            height, slope, swing, wave, phase = rng.uniform(
                [40.0, -0.1, 0.0, 80.0, 0.0], [160.0, 0.1, 20.0, 300.0, 6.0]
            )
            rows[name] = height + slope * (COLUMNS - 300) + swing * np.sin(COLUMNS / wave + phase)
            widths[name], light = rng.uniform(1.0, 3.0), 10.0 ** rng.uniform(0.0, 2.0)
            images[name] = line_image(rows[name], widths[name], light, height=HEIGHT)
        half = {name: 6.0 * width for name, width in widths.items()}
        truth = {name: TrueLine.of_rows(row).band(HEIGHT, half[name]) for name, row in rows.items()}
        found = lines_in_bands(sum(images.values()), truth)
        for name, line in found.items():
            alone = line_centres(images[name])
            gap = np.min(
                [
                    np.abs(rows[name] - rows[other]) - half[name] - half[other]
                    for other in rows
                    if other != name
                ],
                axis=0,
            )
            free = gap > 1.0
            np.testing.assert_array_equal(line.status[free], alone.status[free], f"{seed=}")
            np.testing.assert_allclose(line.row[free], alone.row[free], rtol=0, atol=0.001)
            assert np.all(line.status[gap < 0.0] == Status.OVERLAPPING), seed


@pytest.mark.parametrize("ambient", [0.0, 200.0])
def test_in_noise_and_ambient_light_the_errors_are_those_of_the_line_alone(ambient):
    """Rationale: what is put in place of the other line must be neither brighter nor smoother."""
    rng = np.random.default_rng(4)
    images = alone({"left": 400.0, "right": 4000.0})
    slope = ambient * (1.0 + 0.3 * np.arange(HEIGHT)[:, None] / HEIGHT)

    def recorded(light):
        return np.rint(rng.poisson(light + slope) + rng.normal(0.0, 3.0, light.shape))

    found = lines_in_bands(recorded(sum(images.values())), bands())
    for name, line in found.items():
        by_itself = line_centres(recorded(images[name]))
        error, own = (each.row[FREE] - ROWS[name][FREE] for each in (line, by_itself))
        assert np.isfinite(error).mean() >= np.isfinite(own).mean() - 0.01
        assert np.nanstd(error) == pytest.approx(np.nanstd(own), rel=0.15)
        assert abs(np.nanmean(error)) < 4.0 * np.nanstd(error) / np.sqrt(FREE.sum())
        told = np.nanmedian(line.sigma[FREE]), np.nanmedian(by_itself.sigma[FREE])
        assert told[0] == pytest.approx(told[1], rel=0.1)


def test_what_lies_off_its_own_band_is_not_the_sources():
    """Rationale: a reflection must not become a point, nor ambient light a line where none is."""
    rows = {"left": np.where(COLUMNS < 300, 60.0, np.nan), "right": np.full(WIDTH, 140.0)}
    image = line_image(np.full(WIDTH, 140.0), SIGMA, height=HEIGHT)
    image += line_image(
        np.full(WIDTH, 60.0), SIGMA, np.where(COLUMNS < 100, 1.0, 0.0), height=HEIGHT
    )
    image += line_image(np.full(WIDTH, 20.0), SIGMA, 0.5, height=HEIGHT)  # of neither
    found = lines_in_bands(image, bands(rows))
    assert np.all(found["right"].status == Status.OK)
    assert np.all(found["left"].status[2:97] == Status.OK)
    assert np.all(found["left"].status[102:] == Status.NO_PEAK)
    assert np.isnan(found["left"].row[102:]).all()


@pytest.mark.parametrize("kind", [np.uint8, np.uint16, np.float32])
def test_any_image_will_do_and_rows_as_well_as_columns(kind):
    """Rationale: a camera's image is whole, may be clipped, and may stand upright."""
    images = alone({"left": 90.0, "right": 120.0})
    image = (10.0 + sum(images.values())).astype(kind)
    across = lines_in_bands(image, bands())
    upright = lines_in_bands(
        image.T, {name: band.T for name, band in bands().items()}, along="rows"
    )
    for name in ROWS:
        assert np.all(across[name].status[FREE] == Status.OK)
        np.testing.assert_array_equal(upright[name].column, across[name].row)
        np.testing.assert_array_equal(upright[name].status, across[name].status)
    image[np.arange(20, 30)] = np.iinfo(kind).max if kind is not np.float32 else 200.0
    clipped = lines_in_bands(image, bands(), saturation=None if kind is not np.float32 else 200.0)
    assert np.any(clipped["left"].status == Status.CLIPPED)


def test_a_missing_pixel_in_one_line_is_no_matter_of_the_other():
    """Rationale: NaN in what is taken out must not come back as the mirrored background."""
    images = alone({"left": 1.0, "right": 1.0})
    image = sum(images.values())
    image[int(ROWS["right"][100]), 100] = np.nan
    found = lines_in_bands(image, bands())
    assert found["right"].status[100] == Status.BAD_PIXELS
    assert found["left"].status[100] == Status.OK


def test_a_band_reaches_beyond_the_ends_and_is_no_wider_than_asked():
    """Rationale: light that is not expected to the pixel must not be left to the other source."""
    row = np.where((COLUMNS >= 100) & (COLUMNS < 200), 80.0 + 0.1 * COLUMNS, np.nan)
    band = TrueLine.of_rows(row).band(HEIGHT, 5.0)
    np.testing.assert_array_equal(np.flatnonzero(band.any(axis=0)), np.arange(95, 205))
    for column in (100, 150, 199):
        v = np.flatnonzero(band[:, column])
        assert 4.0 < row[column] - v[0] <= 5.0
        assert 4.0 < v[-1] - row[column] <= 5.0
    assert not TrueLine.of_rows(np.full(WIDTH, np.nan)).band(HEIGHT, 5.0).any()


def test_several_parts_of_a_line_make_one_band():
    """Rationale: over a shoulder a column sees a line twice."""
    both = TrueLine.of_rows(np.stack([np.full(WIDTH, 50.0), np.full(WIDTH, 150.0)]))
    band = both.band(HEIGHT, 3.0)
    assert band.sum(axis=0).tolist() == [14] * WIDTH


def test_a_band_of_another_shape_is_refused_by_its_sources_name():
    """Rationale: of two bands one may be of another camera."""
    image = np.zeros((HEIGHT, WIDTH), np.float32)
    for wrong in (np.zeros((WIDTH, HEIGHT), bool), np.zeros((HEIGHT, WIDTH))):
        with pytest.raises(InputError, match="band of 'right'"):
            lines_in_bands(image, {"left": np.zeros((HEIGHT, WIDTH), bool), "right": wrong})
