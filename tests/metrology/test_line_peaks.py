"""Line centres against images of known truth, the Cramer-Rao bound and published biases."""

from functools import partial
from itertools import product

import numpy as np
import pytest
from artificial import cramer_rao, line_image, rendered_line

from virtual_sensor.errors import InputError
from virtual_sensor.metrology.centres import Status
from virtual_sensor.metrology.line_peaks import line_centres

METHODS = ("gaussian", "log_parabola")


def test_rendered_line_is_found_to_a_thousandth_of_a_pixel():
    """Few samples per pixel, a cut skirt and a slope widen the profile but do not shift it."""
    for case in product((1.0, 2.0, 4.0, 6.0), (0.0, 0.013, -0.4, 1.0, 2.0), (1e-6, 1e4)):
        sigma, slope, amplitude = case
        centre = partial(np.polyval, [slope, 69.7 - 20.0 * slope])
        image = rendered_line(centre, sigma, amplitude, height=140, width=40).astype(np.float32)
        line = line_centres(image)
        assert np.all(line.status == Status.OK), case
        np.testing.assert_allclose(
            line.row, centre(np.arange(40)), atol=1e-3 if sigma > 4 else 1e-4, err_msg=f"{case}"
        )


@pytest.mark.parametrize("sigma", [0.6, 1.0, 3.0, 20.0])
def test_profile_is_recovered_exactly(sigma):
    """The model integrates over the pixel: all its parameters come back, not the row only."""
    centre = np.linspace(149.0, 150.0, 23)
    line = line_centres(line_image(centre, sigma, 7.0, background=100.0, height=300))
    np.testing.assert_allclose(line.row, centre, atol=1e-7)
    np.testing.assert_allclose(line.width, sigma, rtol=1e-6)
    np.testing.assert_allclose(line.amplitude, 7.0, rtol=1e-6)
    np.testing.assert_allclose(line.background, 100.0, rtol=1e-6)


@pytest.mark.parametrize(("sigma", "snr"), [(1.0, 20.0), (2.0, 10.0), (3.0, 100.0), (6.0, 10.0)])
def test_gaussian_reaches_the_bound_of_read_noise(sigma, snr):
    """Within 10 % of the Cramer-Rao bound, and the error it states is the error it makes."""
    rng = np.random.default_rng(1)
    centre = rng.uniform(63.0, 65.0, 4000)
    image = line_image(centre, sigma, height=128) + rng.normal(0.0, 1.0 / snr, (128, 4000))
    line = line_centres(image.astype(np.float32))
    found = line.status == Status.OK
    error = (line.row - centre)[found]
    bound = cramer_rao(sigma, lambda mu: np.full_like(mu, snr**-2))
    assert found.mean() > 0.99
    assert np.std(error) / bound == pytest.approx(1.0, abs=0.1)
    assert abs(np.mean(error)) < 4.0 * bound / np.sqrt(error.size)
    assert np.sqrt(np.mean(line.sigma[found] ** 2)) / np.std(error) == pytest.approx(1, abs=0.1)


def test_maximum_likelihood_reaches_the_bound_of_shot_noise():
    """In photon noise the bright rows are the noisy ones: white weights lose a fifth there."""
    rng = np.random.default_rng(2)
    peak, dark = 2000.0, 5.0
    centre = rng.uniform(31.0, 33.0, 4000)
    electrons = rng.poisson(line_image(centre, 2.5, peak)) + rng.normal(0.0, dark, (64, 4000))
    bound = cramer_rao(2.5, lambda mu: mu / peak + (dark / peak) ** 2)
    likeliest = line_centres(electrons, "max_likelihood", noise=dark, gain=1.0).row - centre
    white = line_centres(electrons).row - centre
    assert np.nanstd(likeliest) / bound == pytest.approx(1.0, abs=0.1)
    assert np.nanstd(white) / bound > 1.15


def test_every_grey_type_is_read():
    """A rounded 8-bit image still gives hundredths of a pixel."""
    for case in product(
        ((np.uint8, 200), (np.uint16, 5e4), (np.float32, 1), (np.float64, 1), (">f4", 1)), METHODS
    ):
        (dtype, amplitude), method = case
        centre = np.linspace(20.0, 22.0, 100)
        image = line_image(centre, 3.0, amplitude, background=0.1 * amplitude)
        line = line_centres((np.rint(image) if amplitude > 1 else image).astype(dtype), method)
        assert np.all(line.status == Status.OK), case
        np.testing.assert_allclose(
            line.row, centre, atol=0.02 if method == "gaussian" else 0.06, err_msg=f"{case}"
        )


@pytest.mark.parametrize("method", METHODS)
def test_statuses_name_what_is_wrong(method):
    """One column of each kind; the ones beside them are untouched."""
    image = line_image(np.full(40, 30.3), 2.5, 100.0)
    image[:, 3] = 0.0
    image[:, 8] = 0.0
    image[30, 8] = 100.0
    image[31, 13] = np.nan
    image[32, 14] = -np.inf
    image[2, 15] = np.nan  # far from the line: no harm
    image[:, [20]] = line_image(0.4, 2.5, 100.0)
    image[:, [21]] = line_image(62.0, 2.5, 100.0)
    image[36, 27] = 150.0  # no line's: a hot pixel in its skirt
    image[:, 34] = np.nan
    wrong = {3: "NO_PEAK", 8: "TOO_NARROW", 13: "BAD_PIXELS", 14: "BAD_PIXELS"}
    wrong |= {20: "AT_BORDER", 21: "AT_BORDER", 27: "SATURATED", 34: "BAD_PIXELS"}
    line = line_centres(image, method, saturation=150.0)
    names = [Status(status).name for status in line.status]
    assert names == [wrong.get(column, "OK") for column in range(40)]
    bad = line.status != Status.OK
    for values in (line.row, line.width, line.amplitude, line.background, line.sigma):
        np.testing.assert_array_equal(np.isnan(values), bad)
    np.testing.assert_array_equal(np.isnan(line.pixel).all(axis=1), bad)


def test_clipped_columns_are_clipped_whatever_the_detector():
    """A three-point fit on a plateau errs by more than a pixel: it must not be made."""
    for case in product(
        (
            (np.uint8, None, 255),
            (np.uint16, None, 65535),
            (np.uint16, 4095, 4095),
            (float, 0.8, 0.8),
        ),
        METHODS,
    ):
        (dtype, saturation, top), method = case
        amplitude = top * np.where(np.arange(30) < 15, 0.9, 1.5)
        image = np.minimum(line_image(30.3, 3.0, amplitude), top).astype(dtype)
        line = line_centres(image, method, saturation=saturation)
        np.testing.assert_array_equal(
            line.status,
            np.where(np.arange(30) < 15, Status.OK, Status.CLIPPED),
            err_msg=f"{case}",
        )
        np.testing.assert_allclose(line.row, 30.3, atol=0.02, err_msg=f"{case}")


@pytest.mark.parametrize("slope", [0.0, 0.5, -2.0])
def test_partly_lit_columns_are_line_ends(slope):
    """A column lit over 3/8 of its width has its centre slope times 5/16 px off."""
    begin, end, samples = 20.0 + 1 / 8, 70.0 - 1 / 8, 8
    u = (np.arange(100 * samples) + 0.5) / samples - 0.5
    v = np.arange(260)
    fine = np.exp(-((v[:, None] - 130.2 - slope * (u - 45.0)) ** 2) / 8.0)
    image = (fine * ((u > begin) & (u < end))).reshape(260, 100, samples).mean(axis=2)
    line = line_centres(image)
    np.testing.assert_array_equal(np.flatnonzero(line.status == Status.LINE_END), [20, 70])
    np.testing.assert_array_equal(np.flatnonzero(line.status == Status.OK), np.arange(21, 70))
    np.testing.assert_allclose(line.row[21:70], 130.2 + slope * (np.arange(21, 70) - 45), atol=1e-4)


def test_whole_columns_at_the_ends_are_kept():
    """A line that begins with a column, fades smoothly or leaves the image sideways has no ends."""
    amplitude = 1.0 + 0.5 * np.cos(np.arange(60) / 20.0)
    amplitude[:10] = 0.0
    line = line_centres(line_image(30.3, 2.0, amplitude))
    np.testing.assert_array_equal(line.status[:10], Status.NO_PEAK)
    np.testing.assert_array_equal(line.status[10:], Status.OK)


def test_a_soft_end_costs_two_columns_and_a_lone_column_itself():
    """A pixel filter spreads the end over two columns; a lone column has none to compare with."""
    amplitude = np.ones(60)
    amplitude[:10], amplitude[10:12] = 0.0, (0.3, 0.9)
    amplitude[40:], amplitude[50] = 0.0, 1.0
    line = line_centres(line_image(30.3, 2.0, amplitude))
    np.testing.assert_array_equal(np.flatnonzero(line.status == Status.LINE_END), [10, 11, 50])
    np.testing.assert_array_equal(np.flatnonzero(line.status == Status.OK), np.arange(12, 40))


def test_what_is_broader_than_a_line_is_a_poor_fit():
    """A glow of the whole object is a peak too, and the user says how broad a line may be."""
    image = line_image(200.3, 20.0, height=400)
    assert line_centres(image).status == Status.OK
    assert line_centres(image, max_sigma=10.0).status == Status.POOR_FIT


@pytest.mark.parametrize("sigma", [1.0, 4.0])
def test_line_running_out_of_the_image_is_unbiased_to_the_last(sigma):
    """Columns whose profile the border cuts are dropped before it shifts their centre."""

    def centre(u):
        return 0.21 + u

    line = line_centres(rendered_line(centre, sigma, height=80, width=100))
    found = line.status == Status.OK
    assert found.sum() > 80 - 6 * sigma
    assert set(line.status) <= {Status.OK, Status.NO_PEAK, Status.AT_BORDER}
    np.testing.assert_allclose(line.row[found], centre(np.flatnonzero(found)), atol=1e-4)


def test_weak_lines_count_from_min_amplitude_on():
    """Relative to the strongest line; a single hot pixel is no line to compare with."""
    amplitude = np.repeat([1.0, 0.05], 20)
    image = line_image(30.3, 2.0, amplitude)
    image[50, 5] = 100.0
    assert np.all(line_centres(image).status[20:] == Status.OK)
    assert np.all(line_centres(image, min_amplitude=0.1).status[20:] == Status.NO_PEAK)


@pytest.mark.parametrize(
    "image",
    [
        np.zeros((40, 30)),
        np.full((40, 30), 0.1, np.float32),
        np.full((40, 30), 255, np.uint8),
        np.full((40, 30), -3.0),
        np.full((40, 30), np.nan),
        np.full((40, 30), np.inf, np.float32),
        np.outer(np.arange(40.0), np.ones(30)),
        np.outer(np.ones(40), np.arange(30.0)),
        np.random.default_rng(4).normal(0.0, 1.0, (400, 300)),
        np.random.default_rng(5).poisson(3.0, (400, 300)).astype(np.uint16),
        np.random.default_rng(6).uniform(-1.0, 1.0, (1, 50)),
        np.random.default_rng(6).uniform(-1.0, 1.0, (2, 50)),
        np.eye(3),
        np.ones((1, 1)),
        np.outer(np.hanning(400), np.ones(30)),
    ],
    ids=lambda image: f"{image.dtype}{image.shape}",
)
def test_images_without_a_line_have_no_centre(image):
    """Not one made-up number, and no warning (pytest makes them errors)."""
    for method in METHODS:
        line = line_centres(image, method)
        assert line.row.shape == image.shape[1:], method
        assert not np.any(line.status == Status.OK), method
        assert np.all(np.isnan(line.row)), method


def test_centres_stay_in_the_image():
    """Whatever the clutter: smooth random landscapes, positive and negative."""
    for case in product(range(5), METHODS):
        seed, method = case
        rng = np.random.default_rng(seed)
        image = np.cumsum(rng.normal(0.0, 1.0, (50, 80)), axis=0) * 10.0 ** rng.integers(-8, 8)
        line = line_centres(image, method)
        row = line.row[line.status == Status.OK]
        assert np.all((row >= -0.5) & (row <= 49.5)), case


def test_one_column_and_a_dark_offset_are_enough():
    """A slit camera's single column; after dark subtraction grey values may be negative."""
    line = line_centres(line_image(20.3, 3.0, background=-5.0))
    np.testing.assert_allclose(line.row, [20.3], atol=1e-6)


@pytest.mark.parametrize(
    ("image", "says"),
    [
        (np.zeros((0, 5)), "shape"),
        (np.zeros(5), "shape"),
        (np.zeros((5, 5, 3), np.uint8), "one grey channel"),
        (np.zeros((5, 5), complex), "complex128"),
        (np.zeros((5, 5), bool), "bool"),
        (np.array([["a", "b"]]), "float32"),
    ],
)
def test_what_is_no_grey_image_is_refused(image, says):
    """The message names the shape or the type, and what to do."""
    with pytest.raises(InputError, match=says):
        line_centres(image)


@pytest.mark.parametrize(
    "options",
    [{"method": "centroid"}, {"min_amplitude": 1.5}, {"max_sigma": 0.0}, {"gain": -1.0}],
)
def test_options_out_of_range_are_refused(options):
    """Rather than found in the results."""
    with pytest.raises(InputError, match="line_centres"):
        line_centres(np.zeros((5, 5)), **options)


@pytest.mark.parametrize("kind", [np.uint8, np.uint16, np.float32, float])
def test_what_a_numpy_mask_hides_is_missing(kind):
    """The brighter line is masked: the other is found; saturation stays that of the type."""
    image = 200.0 * line_image(np.full(50, 20.0), 2.0, height=100)
    image += 120.0 * line_image(np.full(50, 70.25), 2.0, height=100)
    masked = np.ma.masked_array(image.astype(kind), np.zeros(image.shape, bool))
    masked[10:31] = np.ma.masked
    for along, pixels in (("columns", masked), ("rows", masked.T)):
        line = line_centres(pixels, along=along)
        place = line.row if along == "columns" else line.column
        np.testing.assert_array_equal(line.status, Status.OK)
        np.testing.assert_allclose(place, 70.25, atol=0.01)
    masked[69:72] = np.ma.masked
    assert set(line_centres(masked).status) == {Status.BAD_PIXELS}
    clipped = np.ma.masked_array(np.minimum(4 * image, 255).astype(np.uint8))
    clipped[0] = np.ma.masked
    assert set(line_centres(clipped).status) == {Status.DOUBLED}  # both of them are clipped
