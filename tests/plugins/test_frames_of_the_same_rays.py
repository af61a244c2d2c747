"""Frames that differ in their sources' flux alone: samples of the same rays, traced once."""

from dataclasses import replace

import numpy as np
import pytest
from virtual_sensor_plugins.renderer import Prepared

import virtual_sensor as vs
from virtual_sensor.imaging.render import arrangement

SMALL = {"width": 96, "height": 80, "spp": 4, "line_radius": 4}


@pytest.mark.parametrize(("emissivity", "filter_"), [(0.8, "box"), (0.0, "gaussian")])
def test_frames_of_the_same_rays_are_those_of_scenes_of_their_own(tmp_path, emissivity, filter_):
    """Each with a laser of its own power, with and without a glow, whatever the film."""
    text = vs.load_scene("hot_cylinder").path.read_text().replace('"box"', f'"{filter_}"')
    (tmp_path / "own.xml").write_text(text)
    scene = vs.load_scene(tmp_path / "own.xml", **SMALL, emissivity=emissivity, field="").cold()
    scene = replace(scene, hot=True)
    laser = scene.source
    lasers = [replace(laser, power_w=power) for power in (0.1, 3.0, 0.02)]
    prepared = Prepared.of(arrangement(scene))
    fluxes = {"laser": lambda s, t, depth: [each.flux(s, t) for each in lasers]}
    exposure, report = prepared.exposed(0, 0, frames=3, fluxes=fluxes)
    images = exposure.images()
    assert images.shape == (3, 80, 96)
    assert images.dtype == np.float32
    assert report.samples == 4 * prepared.lit.index.size
    for image, each in zip(images, lasers, strict=True):
        alone = vs.render(replace(scene, sources={"laser": each}))
        assert np.count_nonzero(alone) > 500
        np.testing.assert_allclose(image, alone, rtol=2e-6)
