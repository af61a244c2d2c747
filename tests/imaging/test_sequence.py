"""Sequences of patterns: each frame is that of a scene of its own, and rays are traced once."""

from dataclasses import replace

import cv2
import numpy as np
import pytest
from virtual_sensor_plugins.renderer import Prepared

import virtual_sensor as vs
from virtual_sensor.devices.laser import LaserLine
from virtual_sensor.devices.patterns import Picture, Sine, pattern_of
from virtual_sensor.imaging import sequence
from virtual_sensor.optics.ray_families import Sheet

SMALL = {"width": 96, "height": 80, "spp": 4, "projector_width": 320, "projector_height": 200}
STEPS = [f"sine u 32 {2.0 * np.pi * k / 3}" for k in range(3)]
MIXED = [*STEPS, "gray v 3 inverted", "checker 20", "stripe u 160 30", "black", "white"]


def load(**parameters):
    return vs.load_scene("fringe_cylinder", **(SMALL | parameters))


def alone(scene, pattern, **options):
    """The frame of one pattern, rendered by itself."""
    name = scene.projector_name
    lamp = scene.projector.with_pattern(pattern_of(pattern))
    return vs.render(replace(scene, sources={**scene.sources, name: lamp}), **options)


@pytest.fixture
def traced(monkeypatch):
    """How often frames were exposed: a list that grows."""
    found, expose = [], Prepared.exposed

    def spied(self, *given, **named):
        found.append(named.get("frames", 1))
        return expose(self, *given, **named)

    monkeypatch.setattr(Prepared, "exposed", spied)
    return found


def test_each_frame_is_that_of_a_scene_with_its_pattern_and_rays_are_traced_once(traced):
    """Hot, glowing, of a projector with pixels, gamma and contrast, and beside another source."""
    scene = load(emissivity=0.8, gamma=1.4, contrast=50, bits=6)
    sheet = Sheet(scene.projector.pose, 300.0)
    laser = LaserLine(sheet, 20.0, 0.5, 2e-3, np.zeros(0))
    scene = replace(scene, sources={"laser": laser, **scene.sources})
    frames = vs.render_sequence(scene, MIXED, seed=3)
    assert traced == [len(MIXED)]
    assert frames.traces == 1
    assert frames.radiance.dtype == np.float32
    assert [pattern.text for pattern in frames.patterns] == [pattern_of(p).text for p in MIXED]
    for number in (0, 3, 4, 7):
        expected = alone(scene, MIXED[number], seed=3)
        np.testing.assert_allclose(frames.radiance[number], expected, rtol=1e-6)
    apart = frames.radiance.std(axis=0) > 0.1 * frames.radiance[-1]
    assert np.count_nonzero(apart) > 2000
    assert frames.report.samples == 4 * frames.truth.index.size


def test_the_true_projector_pixel_is_that_of_the_marched_search():
    """Rationale: it is what decoders are measured by; black frames have it too."""
    scene = load(tolerance=0.01)
    frames = vs.render_sequence(scene, ["black"])
    known = np.isfinite(frames.projector_pixel[..., 0])
    assert 2500 < np.count_nonzero(known) < 96 * 80
    v, u = np.nonzero(known)
    some = np.linspace(0, u.size - 1, 50).astype(int)
    pixel = np.stack([u, v], axis=1)[some].astype(float)
    found = vs.projector_pixels(scene, pixel)
    apart = np.abs(frames.projector_pixel[v[some], u[some]] - found.projector_pixel)
    seen = np.isfinite(found.projector_pixel[:, 0])
    assert seen.sum() > 45
    assert apart[seen].max() < 0.01
    assert np.abs(found.projector_pixel[seen]).max() > 100.0


def test_where_something_moves_each_frame_is_that_of_its_own_scene(traced):
    """Air, glow and pose change; a scene that stays as it was is not traced again."""
    hot = load(emissivity=0.9, temperature=1100)
    turned = load(emissivity=0.9, temperature=1250, beta=5)
    scenes = [hot, hot.cold(), turned, turned]
    frames = vs.render_sequence(hot, [*STEPS, "white"], scenes=iter(scenes))
    assert traced == [1, 1, 2]
    assert frames.traces == 3
    for radiance, scene, pattern in zip(frames.radiance, scenes, [*STEPS, "white"], strict=True):
        np.testing.assert_allclose(radiance, alone(scene, pattern), rtol=1e-6)
    of_first = vs.render_sequence(hot, STEPS)
    np.testing.assert_array_equal(frames.projector_pixel, of_first.projector_pixel)
    by_air = vs.render_sequence(hot, STEPS, media=[hot.medium, None, turned.medium])
    np.testing.assert_array_equal(by_air.radiance[:2], frames.radiance[:2])
    np.testing.assert_allclose(by_air.radiance[2], alone(hot.with_medium(turned.medium), STEPS[2]))


def test_patterns_are_texts_objects_and_pictures_of_the_projectors_size(tmp_path):
    grey = np.linspace(0.0, 1.0, 320 * 200).reshape(200, 320)
    cv2.imwrite(str(tmp_path / "own.png"), np.rint(255.0 * grey).astype(np.uint8))
    scene = load(pixels="false").cold()
    frames = vs.render_sequence(scene, [Sine("v", 50.0), Picture(grey), tmp_path / "own.png"])
    np.testing.assert_allclose(*frames.radiance[1:], atol=0.01 * frames.radiance.max())
    assert len(frames) == 3
    assert np.asarray(frames).shape == (3, 80, 96)
    assert "3 of 96 x 80 px, traced once" in repr(frames)
    assert frames.frame(0).lit.sum() > 2500
    assert frames.to_dataframe()["pattern"][0] == "sine v 50 0"
    grey = vs.grey_values(frames, vs.ImageSensor(bit_depth=8), peak_e=5000.0)
    assert grey.shape == (3, 80, 96)


def test_progress_is_told_from_nothing_to_all():
    told = []
    scene = load(width=32, height=32)
    vs.render_sequence(scene, STEPS, media=[None, scene.medium, None], progress=told.append)
    assert told == sorted(told)
    assert told[-1] == 1.0
    assert 0.3 < told[0] < 0.4


def test_of_several_traces_the_worst_is_reported():
    """Rationale: one frame that was made otherwise than asked makes the sequence so."""
    report = vs.render_sequence(load(width=32, height=32).cold(), ["white"]).report
    traced = [
        replace(report, samples=3, reason=None, map_error_px=np.nan, march_px=0.3),
        replace(report, samples=5, reason="one", transport="marched", map_error_px=0.2),
        replace(report, samples=7, reason="two", map_error_px=0.1, march_px=0.1),
    ]
    found = sequence.report_of_all(traced)
    assert (found.samples, found.reason, found.transport) == (15, "one; two", "marched")
    assert (found.map_error_px, found.march_px) == (0.2, 0.3)


def test_what_can_not_be_shown_is_refused(tmp_path, monkeypatch):
    monkeypatch.setattr(sequence, "physical_memory", lambda: 2e6)
    scene = load(width=32, height=32).cold()
    cv2.imwrite(str(tmp_path / "small.png"), np.zeros((100, 160), np.uint8))
    for patterns, says in (
        ([], r"patterns is \[\]; give one Pattern or text for each"),
        (3, "patterns is 3; give one"),
        (["white", "sien u 16"], r"patterns: number 1: .*sine"),
        ([tmp_path / "small.png"], "160 x 100 px, and the projector has 320 x 200"),
        (["white"] * 300, r"300 frames of 32 x 32 px take .* render at most 244 at a time"),
    ):
        with pytest.raises(vs.InputError, match=says):
            vs.render_sequence(scene, patterns)
    for named, says in (
        ({"media": [None]}, "media: 1 given for 3 patterns; give one for each"),
        ({"scenes": [scene] * 4}, "scenes: more than 3 given for 3 patterns"),
        ({"scenes": [scene] * 3, "media": [None] * 3}, "both given"),
        ({"scenes": 5}, "scenes is 5; give a list"),
        ({"scenes": [scene, load(width=33, height=32), scene]}, "frame 1 is of 33 x 32 px"),
        ({"scenes": [scene, vs.load_scene("hot_cylinder", width=32, height=32), scene]}, "no proj"),
        ({"media": ["no_air.nc"] * 3}, "no_air"),
        ({"progress": 1}, "progress is 1"),
        ({"spp": 3}, "3 samples per pixel"),
    ):
        with pytest.raises(vs.InputError, match=says):
            vs.render_sequence(scene, STEPS, **named)
    with pytest.raises(vs.InputError, match="has no projector"):
        vs.render_sequence("hot_cylinder", STEPS)
