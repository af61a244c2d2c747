"""A clipped centre is worth what its unclipped neighbours make of it."""

import numpy as np
import pytest
from artificial import line_image

from virtual_sensor.metrology.centres import Status
from virtual_sensor.metrology.continued_lines import off_the_line
from virtual_sensor.metrology.line_peaks import line_centres

U = np.arange(300)
LINE = 40.0 + 0.1 * U
CAMERA = {"saturation": 10_000.0, "noise": 3.0, "gain": 1.0}


def recorded(light, seed=0):
    """Electrons of a full well of 10,000, with noise of both kinds."""
    rng = np.random.default_rng(seed)
    return np.minimum(rng.poisson(light) + rng.normal(0.0, 3.0, light.shape), 10_000.0)


@pytest.mark.parametrize("across", [0.5, 0.2])
def test_where_a_spark_merges_with_the_line_no_centre_is_far_off(across):
    """Rationale: the middle of one plateau for both was off by 8 px, of a sigma of 0.2 px."""
    at = (U > 120) & (U < 180)
    spark = LINE + across * (U - 150.0)
    light = line_image(LINE, 2.0, 8000.0, height=120)
    light += line_image(spark, 1.8, np.where(at, 20_000.0, 0.0), height=120)
    line = line_centres(recorded(light), **CAMERA)
    wrong = line.found & ~(np.abs(line.row - LINE) <= 6.0 * line.sigma)
    assert wrong.sum() <= 3
    assert line.found[~at].mean() > 0.97


def test_a_line_that_clips_in_a_part_keeps_its_centres():
    """In the rise of a roof too, at its ridge, and behind a step."""
    brighter = np.where((U > 120) & (U < 180), 50_000.0, 8000.0)
    for truth in (LINE, 40.0 + np.abs(U - 150.0) / 4.0, LINE + 30.0 * ((U > 120) & (U < 180))):
        line = line_centres(recorded(line_image(truth, 2.0, brighter, height=120)), **CAMERA)
        inside = slice(130, 171)
        assert np.mean(line.status[inside] == Status.CLIPPED) > 0.9
        assert np.nanmedian(line.sigma[inside]) < 0.03


def test_how_far_off_is_known_from_either_side():
    """A curved line's neighbours lead along it; one that none precede is held to those behind."""
    row = 0.002 * (U - 150.0) ** 2
    clear, clipped = (U < 130) | (U > 170), np.arange(140, 161)
    width = np.full(clipped.size, 4.0)
    assert np.all(off_the_line(row, clear, clipped, width) < 0.05)
    row[clipped] += 3.0
    np.testing.assert_allclose(off_the_line(row, clear, clipped, width), 3.0, atol=1.0)
    row = 5.0 + np.where(U < 100, 2.0, 0.0)
    far = off_the_line(row, U > 110, np.array([10, 60, 99]), np.full(3, 4.0))
    np.testing.assert_allclose(far, [0.0, 1.95, 1.95], atol=1e-6)
    assert not off_the_line(row, U > 290, np.arange(290), np.full(290, 4.0)).any()
