"""A frame of an unchanged scene searches for nothing twice, and equals that of one loaded again."""

import gc
import weakref
from dataclasses import replace

import numpy as np
import pytest
from virtual_sensor_plugins.renderer import Prepared

import virtual_sensor as vs
from virtual_sensor.engine import mi
from virtual_sensor.imaging import render as imaging
from virtual_sensor.imaging.render import render_frame

SMALL = {"width": 128, "height": 128, "spp": 4, "line_radius": 0.5}


@pytest.fixture
def load():
    """Another loading of the hot cylinder."""
    return lambda **parameters: vs.load_scene("hot_cylinder", **(SMALL | parameters))


@pytest.fixture
def prepared(monkeypatch):
    """What was looked for: a list of transports that grows."""
    found, prepare = [], Prepared.of

    def spied(arrangement, column=None):
        found.append(arrangement.transport.name)
        return prepare(arrangement, column)

    monkeypatch.setattr(Prepared, "of", spied)
    return found


@pytest.mark.parametrize("transport", ["tabulated", "marched"])
def test_a_second_frame_is_a_first_one_to_the_bit(load, transport):
    """With another seed and other samples between, and its truth too."""
    scene, fresh = load(transport=transport), load(transport=transport)
    first = render_frame(scene, spp=4, seed=3)
    for change in ({"spp": 1, "seed": 4}, {"spp": 9, "seed": 5}):
        render_frame(scene, **change)
    again, reloaded = render_frame(scene, spp=4, seed=3), render_frame(fresh, spp=4, seed=3)
    for other in (again, reloaded):
        np.testing.assert_array_equal(other.radiance, first.radiance)
        np.testing.assert_array_equal(other.point_mm, first.point_mm)
        np.testing.assert_array_equal(other.coordinates(), first.coordinates())
    assert again.report == first.report


def test_nothing_is_looked_for_twice(load, prepared):
    """Whatever is asked of a scene: frames, images, its lit pixels."""
    scene = load()
    for seed in range(3):
        vs.render(scene, seed=seed)
        render_frame(scene, spp=1, seed=seed)
        imaging.lit_pixels(scene)
    assert prepared == ["tabulated"]
    vs.render(scene.only(camera="camera", source="laser"))
    assert prepared == ["tabulated"]


def test_what_changes_a_scene_is_searched_again(load, prepared):
    """Other air, another transport, a laser that is moved; and the first scene is still there."""
    scene = load()
    before = vs.render(scene)
    moved = scene.poses["laser"]
    changed = [
        scene.cold(),
        scene.with_transport(scene.transport.by("marched")),
        scene.with_pose("laser", replace(moved, origin_mm=moved.origin_mm + np.array([0.5, 0, 0]))),
    ]
    for number, other in enumerate(changed):
        assert np.abs(vs.render(other) - before).max() > 1e-6 * before.max()
        assert len(prepared) == 2 + number
    np.testing.assert_array_equal(vs.render(scene), before)
    assert len(prepared) == 4


def test_what_is_kept_is_bounded_and_goes_with_its_scene(load, prepared):
    """Rationale: frames of a sweep have a scene each; a film's worth of each would fill memory."""
    scenes = [load(beta=beta, width=64, height=64, spp=1) for beta in range(6)]
    for scene in scenes:
        vs.render(scene)
    vs.render(scenes[-1])
    assert len(prepared) == len(scenes)
    vs.render(scenes[0])  # as the first, it had to go
    assert len(prepared) == len(scenes) + 1
    gone = weakref.ref(scenes[-1].loaded)
    del scene, scenes
    gc.collect()
    assert gone() is None


def test_mitsuba_renders_a_scene_file_by_itself(load):
    """The plugin reads air, camera and laser from there; Mitsuba's film rounds once more."""
    scene = load()
    parameters = {name: str(value) for name, value in SMALL.items()}
    loaded = mi.load_file(str(scene.path), **parameters)
    image = np.array(mi.render(loaded, spp=4, seed=2))[..., 0]
    np.testing.assert_allclose(image, vs.render(scene, spp=4, seed=2), rtol=3e-7)
