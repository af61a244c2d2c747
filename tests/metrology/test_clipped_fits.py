"""Clipped lines: their centres, and what is said of them, against images of known truth."""

import cv2
import numpy as np
import pytest
from artificial import line_image

import virtual_sensor as vs
from virtual_sensor.metrology.clipped_fits import _normal, clipping_level
from virtual_sensor.metrology.detectors import COLUMNWISE

WELL = 10_000.0
CAMERA = vs.ImageSensor(
    quantum_efficiency=1.0, gain=0.4, dark_noise_e=3.0, full_well_e=WELL, black_level=50.0,
    dsnu_e=0.0, prnu=0.0,
)  # fmt: skip


def recorded(row, sigma, times, height=72, seed=5):
    """A line that would make so many times what the well holds, on a little light."""
    electrons = 20.0 + line_image(row, sigma, times * WELL, height=height)
    return vs.grey_values(electrons, CAMERA, seed)


def rows_of(count, phase=None, seed=3):
    """Rows at any sub-pixel place, or at one."""
    rng = np.random.default_rng(seed)
    whole = 36.0 + np.rint(3.0 * np.sin(np.arange(count) / 100.0))
    return whole + (rng.uniform(-0.5, 0.5, count) if phase is None else phase)


def check(line, row, most_px=0.05, share=0.95):
    """Nearly all centres are there, so near, and as sure as they say."""
    assert line.found.mean() >= share
    assert {*line.status[line.found]} <= {vs.Status.OK, vs.Status.CLIPPED}
    error = (line.row - row)[line.found]
    rms = np.sqrt(np.mean(error**2))
    assert rms <= most_px
    assert 0.8 <= np.sqrt(np.mean(line.sigma[line.found] ** 2)) / rms <= 1.25
    assert np.mean(np.abs(error) > 6.0 * line.sigma[line.found]) < 0.001
    assert abs(error.mean()) < 4.0 * rms / np.sqrt(error.size)


@pytest.mark.parametrize("sigma", [1.5, 2.0, 3.0])
def test_a_clipped_lines_centre_is_found_and_its_error_predicted(sigma):
    """Rationale: the accuracy that is asked for, whether or not the camera's noise is known."""
    row = rows_of(600)
    for times in (1.1, 2.0, 8.0, 16.0):
        image = recorded(row, sigma, times)
        for facts in ({"sensor": CAMERA}, {"saturation": CAMERA.saturation}):
            line = vs.line_centres(image, **facts)
            check(line, row, most_px=0.012)
            np.testing.assert_allclose(np.median(line.width), sigma, rtol=0.01)


def test_symmetric_and_lopsided_clipping_alike():
    """Rationale: a plateau is lopsided about most centres; its middle is off by half a pixel."""
    for phase in (0.0, 0.25, 0.5):
        row = rows_of(400, phase)
        for sigma in (1.5, 3.0):
            check(vs.line_centres(recorded(row, sigma, 8.0), sensor=CAMERA), row, most_px=0.012)


def test_whatever_the_detector_and_along_rows_and_as_a_second_peak():
    row = rows_of(200)
    image = recorded(row, 2.0, 6.0)
    first = vs.line_centres(image, sensor=CAMERA)
    for method in COLUMNWISE:
        line = vs.line_centres(image, method, sensor=CAMERA)
        np.testing.assert_array_equal(line.row, first.row, err_msg=method)
    turned = vs.line_centres(np.ascontiguousarray(image.T), along="rows", sensor=CAMERA)
    np.testing.assert_array_equal(turned.column, first.row)
    both = 20.0 + line_image(row, 2.0, 6.0 * WELL, height=144)
    both += line_image(row + 60.0, 2.0, 0.5 * WELL, height=144)
    two = vs.line_centres(vs.grey_values(both, CAMERA, 1), sensor=CAMERA, peaks=2)
    assert {*two.status[0]} == {vs.Status.CLIPPED}
    assert {*two.status[1]} == {vs.Status.GHOST}  # the line is the clipped one
    for line, truth in ((0, row), (1, row + 60.0)):
        assert np.sqrt(np.mean((two.row[line] - truth) ** 2)) < 0.02


def test_a_lopsided_profile_says_so_by_its_sigma():
    """Rationale: only flanks are seen, and where their widths differ the centre is unsure."""
    row = rows_of(400)
    pixel = np.arange(72.0)[:, None]
    for more in (1.05, 1.1):
        width = np.where(pixel > row, 2.0 * more, 2.0 / more)
        electrons = 20.0 + 8.0 * WELL * np.exp(-0.5 * ((pixel - row) / width) ** 2)
        line = vs.line_centres(vs.grey_values(electrons, CAMERA, 2), sensor=CAMERA)
        assert line.found.mean() > 0.95
        error = np.abs(line.row - row)[line.found]
        assert np.median(error) > 0.05
        assert np.mean(error > 3.0 * line.sigma[line.found]) < 0.05


def test_a_few_columns_that_are_lopsided_say_so_too():
    """Their neighbours, which are not, can't say it for them."""
    row = rows_of(400)
    pixel, few = np.arange(72.0)[:, None], (np.arange(400) > 200) & (np.arange(400) < 240)
    more = np.where(few, 1.2, 1.0)
    width = np.where(pixel > row, 2.0 * more, 2.0 / more)
    electrons = 20.0 + 8.0 * WELL * np.exp(-0.5 * ((pixel - row) / width) ** 2)
    line = vs.line_centres(vs.grey_values(electrons, CAMERA, 2), sensor=CAMERA)
    error = np.abs(line.row - row)
    assert np.median(error[few]) > 0.2
    assert np.all((error < 6.0 * line.sigma)[few & line.found])
    assert line.found[few].mean() > 0.9
    assert np.nanmedian(line.sigma[~few]) < 0.02


def test_at_the_border_and_where_only_one_flank_is_seen():
    rows = np.linspace(-6.0, 14.0, 200)
    line = vs.line_centres(recorded(rows, 2.0, 8.0), sensor=CAMERA)
    cut = rows < 4.0  # closer to the border than two and a half of its sigmas
    assert not line.found[cut].any()
    assert {*line.status[cut]} <= {vs.Status.AT_BORDER, vs.Status.SATURATED}
    seen = rows > 6.0
    assert np.all(line.found[seen])
    good = line.found
    assert np.all(np.abs(line.row - rows)[good] < 6.0 * line.sigma[good] + 0.01)


def test_glare_that_fills_the_image_stays_saturated():
    line = vs.line_centres(np.full((40, 30), 255, np.uint8))
    assert not line.found.any()
    wide = np.full((40, 30), 20, np.uint8)
    wide[:30] = 255
    assert not vs.line_centres(wide).found.any()
    broad = np.full((100, 30), 20, np.uint8)
    broad[15:85] = 255  # both of its borders are seen, and are all that is
    assert {*vs.line_centres(broad).status} == {vs.Status.SATURATED}


def test_other_light_beside_a_clipped_line_does_not_draw_its_centre():
    """Rationale: a flank ends where another light rises."""
    row = rows_of(300)
    electrons = 20.0 + line_image(row, 2.0, 6.0 * WELL, height=90)
    electrons += line_image(row + 13.0, 2.5, 0.2 * WELL, height=90)
    line = vs.line_centres(vs.grey_values(electrons, CAMERA, 4), sensor=CAMERA)
    assert line.found.mean() > 0.95
    error = np.abs(line.row - row)[line.found]
    assert np.mean(error < 3.0 * line.sigma[line.found]) > 0.98
    assert np.median(error) < 0.05


def bloomed(row, above, below, jitter=0.0):
    """A plateau from `row` so far up and down, with steep flanks that end in a glow."""
    row = row + jitter * np.random.default_rng(6).normal(size=row.size)
    v = np.arange(90.0)[:, None]
    away = np.maximum(row - above - v, v - row - below)
    light = 0.6 * np.clip(0.5 - away / 2.0, 0.0, 1.0) + 0.4 * np.exp(-np.maximum(away, 0.0) / 6.0)
    return np.rint(10.0 + 400.0 * light).clip(0, 255).astype(np.uint8)


def test_where_pixels_bloom_the_centre_is_between_the_flanks_and_less_sure():
    """No width is given, as the profile is not the line's; the two sides may differ by a tenth."""
    row = 45.0 + 0.01 * np.arange(300)
    for sides, most in (((10.0, 10.0), 0.1), ((9.4, 10.6), 0.7)):
        line = vs.line_centres(bloomed(row, *sides))
        assert {*line.status} == {vs.Status.CLIPPED}
        assert np.isnan(line.width).all()
        error = np.abs(line.row - row)
        assert error.max() < most
        assert np.mean(error < 2.0 * line.sigma) > 0.99


def test_flanks_that_scatter_from_column_to_column_say_how_sure_a_centre_is():
    """Rationale: what one column's flanks do not show, its neighbours do."""
    row = 45.0 + 0.01 * np.arange(300)
    line = vs.line_centres(bloomed(row, 4.0, 4.0, jitter=0.6))
    found = line.found
    assert found.mean() > 0.9
    actual = np.std((line.row - row)[found])
    assert 0.8 < np.sqrt(np.mean(line.sigma[found] ** 2)) / actual < 1.4


def test_one_clipped_pixel_is_a_lines_if_those_beside_it_are_bright_too():
    """Rationale: every fourth row of photographs that clip; but a hot pixel is no line."""
    sharpened = np.array([20, 0, 30, 190, 225, 255, 225, 190, 30, 0, 20], np.uint8)
    hot = np.array([20, 20, 20, 20, 100, 255, 130, 20, 20, 20, 20], np.uint8)
    for profile, there in ((sharpened, True), (hot, False)):
        image = np.full((72, 40), 20, np.uint8)
        image[31:42] = profile[:, None]
        line = vs.line_centres(image)
        assert line.found.all() == line.found.any() == there
        assert not there or np.abs(line.row - 36.0).max() < 0.05


def test_lines_without_clipped_pixels_are_as_before():
    """Rationale: one clipped column changes no other."""
    row = rows_of(120)
    image = recorded(row, 2.0, 0.6)
    before = vs.line_centres(image, sensor=CAMERA)
    image[:, 60] = recorded(row, 2.0, 5.0)[:, 60]
    after = vs.line_centres(image, sensor=CAMERA)
    others = np.abs(np.arange(120) - 60) > 40
    assert after.status[60] == vs.Status.CLIPPED
    np.testing.assert_array_equal(after.row[others], before.row[others])


def test_where_a_camera_clips_below_its_types_range_flat_tops_say():
    """Rationale: 12 bits in a file of 16, and nothing that says so; webcams clip at 235."""
    row = rows_of(200)
    for image in (recorded(row, 2.0, 4.0), np.minimum(line_image(row, 2.0, 900.0, 16.0), 235.0)):
        kept = image.astype(np.uint8 if image.max() < 256 else np.uint16)
        line = vs.line_centres(kept)
        assert {*line.status} == {vs.Status.CLIPPED}
        np.testing.assert_allclose(line.row, row, atol=0.06)


def test_tops_that_are_only_coarse_are_not_clipped():
    """Rationale: of a broad line several rows share the highest grey value, and it is whole."""
    for sigma in (3.0, 6.0, 12.0):
        for height in (20.0, 60.0, 200.0):
            image = np.rint(line_image(np.full(60, 100.0), sigma, height, 10.0, height=200))
            line = vs.line_centres(image.astype(np.uint8))
            assert not np.any(line.status == vs.Status.CLIPPED), (sigma, height)
    image = np.random.default_rng(0).integers(0, 200, (50, 400)).astype(np.uint8)
    assert not np.any(vs.line_centres(image).status == vs.Status.CLIPPED)


def test_a_compressed_picture_varies_where_it_was_clipped():
    row = 40.0 + 0.05 * np.arange(300)
    electrons = line_image(row, 2.5, 5.0 * 255.0, 30.0, height=104)
    noisy = electrons + np.random.default_rng(1).normal(0.0, 4.0, electrons.shape)
    grey = np.clip(np.rint(noisy), 0.0, 255.0).astype(np.uint8)
    coded = cv2.imencode(".jpg", grey, [cv2.IMWRITE_JPEG_QUALITY, 75])[1]
    picture = cv2.imdecode(coded, cv2.IMREAD_GRAYSCALE)
    assert clipping_level(picture, 255.0) < 255.0 == clipping_level(grey, 255.0)
    line = vs.line_centres(picture)
    assert line.found.mean() > 0.95
    error = (line.row - row)[line.found]
    assert np.sqrt(np.mean(error**2)) < 0.1
    assert np.mean(np.abs(error) > 3.0 * line.sigma[line.found]) < 0.03


def test_a_normal_matrix_is_never_singular():
    """Rationale: a line so far from the pixels that its share in them all but underflows."""
    for slopes in ([1.0, 1e-160, 0.0, 1e-170], [0.0, 0.0, 0.0, 0.0]):
        matrix = _normal(np.array(slopes)[:, None, None] * np.ones((4, 9, 1)), np.ones((9, 1)))
        assert np.isfinite(np.linalg.inv(matrix)).all()
