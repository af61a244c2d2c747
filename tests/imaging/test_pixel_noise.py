"""Random numbers by place: their distributions, and that nothing but their place decides."""

import subprocess
import sys

import numpy as np
import pytest
from scipy.special import ndtr
from scipy.stats import kstest
from scipy.stats import poisson as exact

import virtual_sensor as vs
from virtual_sensor.imaging import grey_values as module
from virtual_sensor.imaging.pixel_noise import PixelNoise, poisson

SENSOR = vs.ImageSensor(dark_current_e_s=50.0)
LIGHT = np.random.default_rng(0).uniform(0.0, 4000.0, (90, 700)) ** 2 / 4000.0
CHILD = """
import sys, numpy as np, virtual_sensor as vs
light = np.random.default_rng(0).uniform(0.0, 4000.0, (90, 700)) ** 2 / 4000.0
sensor = vs.ImageSensor(dark_current_e_s=50.0)
sys.stdout.buffer.write(vs.grey_values(light, sensor, 7, exposure_s=0.01).tobytes())
"""


def test_normal_numbers_are_normal_and_independent():
    """Of each other, of their neighbours, of other frames, pairs, parts and seeds."""
    noise = PixelNoise(1, 0)
    first, second = noise.normals(range(300), 400)
    others = [
        second,
        np.roll(first, 1, 0),
        np.roll(first, 1, 1),
        noise.normals(range(300, 600), 400)[0],
        noise.normals(range(300), 400, frame=1)[0],
        noise.normals(range(300), 400, pair=1)[0],
        PixelNoise(1, 1).normals(range(300), 400)[0],
        PixelNoise(2, 0).normals(range(300), 400)[0],
    ]
    for other in others:
        assert kstest(other.ravel(), "norm").pvalue > 1e-3
        for one, two in ((first, other), (first**2, other**2)):
            correlation = np.corrcoef(one.ravel(), two.ravel())[0, 1]
            assert abs(correlation) < 4.5 / np.sqrt(first.size)


def test_poisson_numbers_are_quantiles_of_the_exact_distribution():
    """Against SciPy's inverse: the same number, from 32 electrons on but for 1 of 2,000, by 1."""
    normal = PixelNoise(3, 0).normals(range(20), 1000)[0]
    for mean in (0.0, 0.01, 0.9, 3.9, 4.1, 9.0, 31.0, 33.0, 200.0, 5000.0):
        means = np.full(normal.shape, mean, np.float32)
        found = poisson(means, normal)
        wanted = exact.ppf(ndtr(normal.astype(float)), means.astype(float))
        wrong = found != wanted
        assert np.mean(wrong) <= (0.0 if mean < 32.0 else 5e-4 + mean * 1e-7), mean
        assert np.abs(found - wanted).max() <= 1.0


def test_more_light_makes_more_electrons():
    """Of the same seed: so derivatives of what is measured are smooth."""
    noise = PixelNoise(4, 0).normals(range(1), 20_000)[0]
    for mean in (0.5, 3.99, 31.9, 400.0):
        one, more = (poisson(np.full_like(noise, m), noise) for m in (mean, mean * 1.01 + 0.1))
        assert np.mean(more < one) < 2e-4


def test_the_bits_are_the_same_in_any_order_and_process_and_number_of_threads(monkeypatch):
    """Also those of a part of the image, and of one frame of a sequence alone."""
    grey = vs.grey_values(LIGHT, SENSOR, 7, exposure_s=0.01)
    part = vs.grey_values(LIGHT[:50, :300], SENSOR, 7, exposure_s=0.01)
    np.testing.assert_array_equal(part, grey[:50, :300])
    frames = vs.grey_values(np.stack([LIGHT] * 3), SENSOR, 7, exposure_s=0.01)
    np.testing.assert_array_equal(frames[0], grey)
    assert np.any(frames[1] != frames[2])
    alone = vs.grey_values(LIGHT, SENSOR, (7, 2), exposure_s=0.01)
    np.testing.assert_array_equal(alone, frames[2])
    for threads, block in ((1, 100), (5, 1), (2, 1 << 20)):
        monkeypatch.setattr(module, "_THREADS", threads)
        monkeypatch.setattr(module, "_BLOCK_PX", block)
        module._pattern.cache_clear()
        again = vs.grey_values(LIGHT, SENSOR, 7, exposure_s=0.01)
        np.testing.assert_array_equal(again, grey)
    child = subprocess.run([sys.executable, "-c", CHILD], check=True, capture_output=True)
    assert child.stdout == grey.tobytes()


def test_a_seed_that_is_none_is_refused():
    """In words."""
    for seed in (-1, 1.5, "1", (1, 2, 3), (1, -1), (1, None), True):
        with pytest.raises(vs.InputError, match="grey_values: seed"):
            vs.grey_values(LIGHT, SENSOR, seed)
