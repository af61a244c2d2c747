"""Predicted errors where a line is grainy: no less than its neighbours show, and as they were."""

import numpy as np
import pytest
from artificial import line_image

from virtual_sensor.imaging.speckle import Aperture, speckled
from virtual_sensor.metrology.centres import Status
from virtual_sensor.metrology.line_peaks import line_centres
from virtual_sensor.metrology.scatter import is_rough, with_scatter, with_scatter_of_ridge

ROW = 31.7 + 0.01 * np.arange(600)


def grainy(f_number):
    """A line of 8000 electrons under a lens that makes grains of up to 1.9 px radius."""
    light = line_image(ROW, 2.0, 2700.0, height=80)
    seen = speckled(light, Aperture(f_number, polarisations=2), 3)
    return np.random.default_rng(4).poisson(seen) + np.random.default_rng(5).normal(
        0.0, 3.0, seen.shape
    )


def test_in_speckle_centres_are_off_by_what_is_predicted():
    """Rationale: fits took lone grains for narrow lines, Steger's detector knew of no grain.

    Expected: beyond six predicted errors less than 1 %, and errors of the predicted size.
    """
    for f_number in (5.6, 16.0):
        image = grainy(f_number)
        for method in ("gaussian", "max_likelihood", "centre_of_gravity", "steger"):
            for options in ({"noise": 3.0, "gain": 1.0}, {}):
                line = line_centres(image, method, **options)
                good = line.found & np.isfinite(line.sigma)
                true = np.interp(line.column[good], np.arange(ROW.size), ROW)
                ratio = np.abs(line.row[good] - true) / line.sigma[good]
                case = f_number, method, options
                assert good.sum() > 300, case
                wrong, size = (0.011, 2.0) if options else (0.05, 4.0)
                assert np.mean(ratio > 6.0) < wrong, (case, np.mean(ratio > 6.0))
                assert 0.4 < np.median(ratio) / 0.6745 < size, (case, np.median(ratio))


def test_grains_are_not_taken_for_edges_of_the_reflectance():
    """Neighbours share them, and are lopsided alike: half of the columns were "corrected"."""
    line = line_centres(grainy(16.0), "gaussian", noise=3.0, gain=1.0)
    assert not np.any(line.status == Status.CORRECTED)
    assert line.found.mean() > 0.5
    assert not is_rough(np.full(500, 2.0))
    assert not is_rough(np.full(500, np.nan))


def test_a_good_line_keeps_its_predicted_errors_to_the_bit():
    """Of widths that change slowly, scatter little, or in a few columns only."""
    rng = np.random.default_rng(1)
    sigma = rng.uniform(0.01, 0.02, 500)
    found = np.ones(500, bool)
    slow = 2.0 + np.sin(np.arange(500) / 60.0)
    noisy = 2.0 + rng.normal(0.0, 0.02, 500)
    step = np.where(np.arange(500) < 250, 1.0, 3.0)
    for width in (slow, noisy, step):
        for known in (True, False):
            assert with_scatter(sigma, width, found, known).tobytes() == sigma.tobytes()
    assert with_scatter_of_ridge(sigma, slow, True).tobytes() == sigma.tobytes()


def test_widths_that_scatter_raise_the_errors_beside_them_alone():
    """Of 500 columns 100 are grainy; each line of several is judged by itself."""
    rng = np.random.default_rng(2)
    width = np.full((2, 500), 2.0)
    width[1, 200:300] += rng.normal(0.0, 0.6, 100)
    sigma, found = np.full((2, 500), 0.05), np.ones((2, 500), bool)
    sigma[1, 240] = np.nan
    honest = with_scatter(sigma, width, found, True)
    assert honest[0].tobytes() == sigma[0].tobytes()
    assert np.nanmedian(honest[1, 215:285]) == pytest.approx(0.8 * 0.6, rel=0.3)
    assert np.isnan(honest[1, 240])
    assert np.all(np.delete(honest[1], np.arange(180, 320)) == 0.05)
    assert np.nanmedian(with_scatter_of_ridge(sigma[0], width[1], True)[220:280]) > 0.5
