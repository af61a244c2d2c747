"""How many speckle patterns add, and what an element of a scene says of it."""

import numpy as np
import pytest

from virtual_sensor.devices.coherence import Coherence, weights_of
from virtual_sensor.errors import InputError
from virtual_sensor.imaging.scene import load_scene
from virtual_sensor.imaging.speckle import Aperture
from virtual_sensor.optics.lens import Lens


@pytest.mark.parametrize("patterns", [1.0, 1.001, 1.7, 2.0, 2.6, 7.0, 255.9])
def test_the_fewest_patterns_have_the_contrast_that_is_wanted(patterns):
    """Variances of independent parts add: the sum of the squared weights is 1/patterns."""
    weights = weights_of(patterns)
    assert weights.size == np.ceil(patterns)
    assert weights.sum() == pytest.approx(1.0)
    assert np.sum(weights**2) == pytest.approx(1.0 / patterns)
    assert np.all(weights >= 0.0)


def test_light_of_one_wavelength_or_from_one_depth_has_one_pattern():
    """And 1/2 of the contrast is four patterns: 16 (sigma_h sigma_k)^2 = 15."""
    for one in (Coherence(roughness_um=50.0), Coherence(linewidth_nm=5.0), Coherence()):
        assert one.patterns_at(532.0) == 1.0
    wavelength_um, spread_um = 0.532, np.sqrt(15.0) / (4.0 * 30.0)
    linewidth_nm = spread_um * wavelength_um**2 / (2.0 * np.pi) * 2.3548 * 1e3
    both = Coherence(roughness_um=30.0, linewidth_nm=linewidth_nm)
    assert both.patterns_at(532.0) == pytest.approx(4.0, rel=1e-4)


def test_a_scenes_laser_says_how_coherent_its_light_comes_back():
    """By the element's properties, which the scene's parameters fill; and what can't be is told."""
    small = {"width": 16, "height": 16}
    scene = load_scene("cold_cylinder", linewidth=2, rq=30, polarisations=2, modes=1.5, **small)
    wanted = Coherence(polarisations=2, linewidth_nm=2.0, roughness_um=30.0, modes=1.5)
    assert scene.laser.coherence == wanted
    aperture = Aperture.of(Lens.of_f_number(75.0, 300.0, 16.0), 5.5, 532.0, wanted)
    assert aperture.resolution_px == pytest.approx(0.532 * 16.0 * 1.25 / 5.5)
    assert aperture.patterns == wanted.patterns_at(532.0)
    for name, value in (("linewidth", -1), ("polarisations", 3), ("modes", "nan"), ("rq", "-2")):
        with pytest.raises(InputError, match=r"line \d+: laser_line: (\w+) (is|must)"):
            load_scene("cold_cylinder", **small, **{name: value})
