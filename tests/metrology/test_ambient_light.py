"""Ambient light brings shot noise of its own: no detector may take it for lines, nor lose any.

The camera is written here again, in NumPy alone: Poisson electrons, Gaussian read noise, a gain.
"""

from itertools import product

import numpy as np
import pytest

from virtual_sensor.metrology.centres import Status
from virtual_sensor.metrology.detectors import COLUMNWISE, NAMES
from virtual_sensor.metrology.line_peaks import line_centres

GAIN, READ_E, BLACK, WHITE = 0.37, 2.4, 64, 4095
DARK = float(np.hypot(GAIN * READ_E, 12**-0.5))  # in grey values, rounding included
GIVEN = {"noise": DARK, "gain": GAIN, "saturation": WHITE}
OPTIONS = (GIVEN, {"noise": DARK}, {"gain": GAIN}, {})
BACKGROUNDS_E = (0, 1, 20, 200, 2000)


CASES = tuple(product(BACKGROUNDS_E, NAMES, (GIVEN, {})))


def photographed(expected_e, seed):
    """Grey values of a camera that expects so many electrons in each pixel."""
    rng = np.random.default_rng(seed)
    electrons = rng.poisson(expected_e) + rng.normal(0.0, READ_E, np.shape(expected_e))
    return np.clip(np.rint(GAIN * electrons + BLACK), 0, WHITE).astype(np.uint16)


def grey_noise(background_e):
    """Standard deviation of the grey values, as the law of the camera above says."""
    return np.sqrt(GAIN**2 * (background_e + READ_E**2) + 1.0 / 12.0)


def a_line(height, width, sigma, amplitude_e):
    """Electrons of a Gaussian line that wanders, and its rows."""
    row = height / 2.0 + 3.0 * np.sin(np.arange(width) / 90.0)
    return amplitude_e * np.exp(-0.5 * ((np.arange(height)[:, None] - row) / sigma) ** 2), row


def test_of_10_000_dark_columns_in_ambient_light_none_has_a_centre():
    """Whatever is said of the camera: its dark noise is not the noise beside a line."""
    for number, background in enumerate(BACKGROUNDS_E):
        image = photographed(np.full((128, 2100), float(background)), seed=number)
        last_but_one = number == len(BACKGROUNDS_E) - 2
        for method, options in product(NAMES, OPTIONS if last_but_one else (GIVEN, {})):
            for along, turned in (("columns", image), ("rows", image.T))[: 1 + last_but_one]:
                line = line_centres(turned, method, along=along, **options)
                case = method, along, background, options
                assert np.all(line.status == Status.NO_PEAK), case


def test_coarse_grey_values_hide_no_noise():
    """A median of whole numbers is one itself: it said 1.05 where the noise is 1.55."""
    for background, seed in product((3, 12), range(3)):
        image = photographed(np.full((256, 2048), background + 0.4), seed)
        for dtype in (np.uint16, np.float32, np.float64):
            line = line_centres(image.astype(dtype))
            assert np.all(line.status == Status.NO_PEAK), (background, seed, dtype)


def test_telling_the_true_noise_leaves_dark_columns_dark():
    """The case reported: a line from column 150 to 350, and 200 electrons of ambient light."""
    line, row = a_line(512, 512, 2.0, 1600.0)
    line[:, :150] = line[:, 350:] = 0.0
    image = photographed(200.0 + line, seed=0)
    for method in NAMES:
        found = line_centres(image, method, **GIVEN)
        good = found.status == Status.OK
        u = found.column[good]
        assert np.all((u > 149) & (u < 350)), method
        assert len(np.unique(np.rint(u))) > 180, method
        assert np.all(np.abs(found.row[good] - np.interp(u, np.arange(512), row)) < 1.0), method
        if method in COLUMNWISE:
            assert np.all(found.status[:149] == Status.NO_PEAK), method
            assert np.all(found.status[351:] == Status.NO_PEAK), method


@pytest.mark.parametrize(
    "cases",
    [CASES[::3], pytest.param(CASES, marks=pytest.mark.slow)],
    ids=["a third of all", "all"],
)
def test_no_line_of_8_sigmas_of_the_background_is_lost(cases):
    """In any ambient light, given or not; a centre for all but the few that noise deforms."""
    images = {}
    for number, background in enumerate(BACKGROUNDS_E):
        line, row = a_line(128, 1500, 2.5, 8.0 * grey_noise(background) / GAIN)
        images[background] = photographed(background + line, seed=number)
    for case in cases:
        background, method, options = case
        found = line_centres(images[background], method, **options)
        good = found.status == Status.OK
        seen = np.unique(np.rint(found.column[good]))
        assert not np.any(found.status == Status.NO_PEAK), case
        assert len(seen) > 0.97 * row.size, case
        error = found.row[good] - np.interp(found.column[good], np.arange(row.size), row)
        assert np.median(np.abs(error)) < 0.7, case


def test_uneven_ambient_light_makes_no_centres():
    """A lamp on one side of the image, or below: its noise is not that of the dark side."""
    v, u = np.indices((256, 1024))
    lamps = (
        np.where(u > 500, 1000.0, 5.0),
        np.where(v > 120, 1000.0, 5.0),
        2000.0 * np.exp(-(((u - 512) / 450) ** 2) - ((v - 128) / 150) ** 2),
        4.0 * v,
    )
    for number, lamp in enumerate(lamps):
        image = photographed(lamp, seed=number)
        for case in product(COLUMNWISE, (GIVEN, {})):
            method, options = case
            line = line_centres(image, method, **options)
            assert not np.any(line.status == Status.OK), (number, *case)


def test_sigma_counts_the_shot_noise_of_ambient_light():
    """The likelihood fit at its bound, and the error it states within 10 %, by the same options."""
    line, row = a_line(128, 4000, 2.0, 600.0)
    image = photographed(800.0 + line, seed=3)
    found = line_centres(image, "max_likelihood", **GIVEN)
    good = found.status == Status.OK
    rms = np.sqrt(np.mean((found.row - row)[good] ** 2))
    assert good.mean() > 0.99
    assert np.sqrt(np.mean(found.sigma[good] ** 2)) / rms == pytest.approx(1.0, abs=0.1)
    # Cramer and Rao's bound: a Gaussian sampled by pixels, in the noise of background and line.
    away = np.arange(-20, 21)
    shape = 600.0 * np.exp(-0.5 * (away / 2.0) ** 2)
    information = (shape * away / 4.0) ** 2 / (800.0 + shape + (DARK / GAIN) ** 2)
    assert rms * np.sqrt(information.sum()) == pytest.approx(1.0, abs=0.06)


@pytest.mark.parametrize("amplitude", [1e-9, 1.0, 1e6])
def test_a_dark_rendered_background_has_no_noise_of_rounding(amplitude):
    """Zeros are whole numbers as well, but no grey values: nothing is added to them."""
    row = 40.0 + 0.01 * np.arange(200)
    away = np.arange(90)[:, None] - row
    image = amplitude * np.exp(-0.5 * (away / 2.0) ** 2) * (np.abs(away) < 9.0)
    for picture in (image, image.astype(np.float32)):
        assert np.all(line_centres(picture).status == Status.OK)
