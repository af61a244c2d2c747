"""What a part throws onto itself, before it is rendered: how far air bends it, and how much."""

import numpy as np
import pytest

import virtual_sensor as vs
from virtual_sensor.imaging.self_lighting import _bent_mm, self_lighting

STEEL = {"material": "ground_steel", "roughness": 0.3}
SLOPE = np.array([0.0, 0.0, 2e-6])  # of the refractive index, 1/mm


class Air:
    """Whose refractive index changes alike everywhere: a ray in it is a parabola."""

    def gradient(self, points):
        return np.broadcast_to(SLOPE, points.shape)


def test_air_of_an_even_slope_bends_light_to_a_parabola():
    """By half the slope times the square of the length, and none that runs along the slope."""
    first = np.zeros((3, 3))
    last = np.array([[40.0, 0.0, 0.0], [0.0, 80.0, 0.0], [0.0, 0.0, 80.0]])
    expected = 0.5 * SLOPE[2] * np.array([40.0**2, 80.0**2, 0.0])
    np.testing.assert_allclose(_bent_mm(Air(), first, last), expected, rtol=1e-6, atol=1e-12)


def test_what_air_bends_is_counted_in_pixels():
    """On a film of twice the pixels twice as many."""
    field = {"field": "hot_cylinder_1250C_quarter.nc", "max_depth": 3, "spp": 1}
    coarse, fine = (
        self_lighting(vs.load_scene("v_groove", width=n, height=n, **STEEL, **field)).bent_px
        for n in (64, 128)
    )
    assert fine == pytest.approx(2.0 * coarse, rel=0.02)


def test_the_share_is_of_the_light_that_is_reflected():
    """Of a groove with walls at right angles, of diffuse light: by the form factor of its walls.

    Each wall throws 1 - 1/sqrt(2) of its light onto the other one, if all of it is lit alike.
    """
    shares = [
        self_lighting(vs.load_scene("v_groove", width=64, height=64, reflectance=r)).share
        for r in (0.2, 0.8)
    ]
    assert shares[0] == pytest.approx(shares[1], rel=1e-3)
    assert 0.5 * (1.0 - 0.5**0.5) < shares[0] < 1.0 - 0.5**0.5
