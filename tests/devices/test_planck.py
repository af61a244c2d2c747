"""Planck's law against Stefan and Boltzmann's, Wien's, and figures worked out for the project."""

from itertools import pairwise

import numpy as np
import pytest
from scipy.constants import Stefan_Boltzmann, Wien
from scipy.integrate import quad

from virtual_sensor.devices.planck import band_radiance, spectral_radiance


@pytest.mark.parametrize("celsius", [20.0, 900.0, 1250.0, 5500.0])
def test_all_of_it_is_stefan_and_boltzmanns(celsius):
    """Over all wavelengths sigma T^4/pi."""
    kelvin = celsius + 273.15
    peak = Wien / kelvin * 1e9
    edges = peak * np.array([0.05, 0.3, 1.0, 3.0, 10.0, 100.0, 3000.0])
    total = sum(
        quad(spectral_radiance, a, b, args=(celsius,), epsrel=1e-9)[0] for a, b in pairwise(edges)
    )
    assert total == pytest.approx(Stefan_Boltzmann * kelvin**4 / np.pi * 1e-6, rel=1e-5)


def test_it_is_strongest_where_wien_says():
    """At 1250 degC in the infrared, at 1902 nm."""
    peak = Wien / 1523.15 * 1e9
    near = [spectral_radiance(peak * (1.0 + s), 1250.0) for s in (-0.01, 0.0, 0.01)]
    assert near[1] > max(near[0], near[2])
    assert near[0] == pytest.approx(near[1], rel=1e-3)


@pytest.mark.parametrize(("celsius", "stated"), [(900.0, 3e-6), (1250.0, 7e-4)])
def test_a_filter_makes_the_glow_as_small_as_was_worked_out(celsius, stated):
    """physics.md: in 10 nm at 532 nm against a 100 mW line of 0.2 x 50 mm; steel of emissivity 0.8.

    What is opaque reflects the rest: 0.2 of the laser's light, into all directions.
    """
    line = 0.1 / (0.2 * 50.0) * 0.2 / np.pi
    assert 0.8 * band_radiance(532.0, 10.0, celsius) / line == pytest.approx(stated, rel=0.15)


def test_cold_bodies_are_dark_without_a_warning():
    """At absolute zero, and where the exponent is beyond any number."""
    assert band_radiance(532.0, 10.0, -273.15) == 0.0
    assert band_radiance(532.0, 10.0, -200.0) < 1e-100
