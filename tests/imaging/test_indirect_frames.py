"""Frames of a part that lights itself: layers, ghosts, what moves, what is projected, recorded."""

from dataclasses import replace

import numpy as np
import pytest

import virtual_sensor as vs
from virtual_sensor.imaging.recording import sensor_of
from virtual_sensor.imaging.scene import scene_parameters
from virtual_sensor.imaging.scene_file import shipped_scenes
from virtual_sensor.imaging.self_lighting import self_lighting
from virtual_sensor.imaging.speckle import Aperture
from virtual_sensor.studies.ghosts import bounces, ghost_facts

FILM = {"width": 96, "height": 96, "line_radius": 0.5, "spp": 4}
STEEL = {"material": "ground_steel", "roughness": 0.3}


def groove(**parameters):
    """The V-groove in ground steel, with one reflection between its walls."""
    return vs.load_scene("v_groove", **(FILM | STEEL | {"max_depth": 3} | parameters))


LAMP = """<emitter type="point"><point name="position" x="0" y="0" z="200"/>
    <spectrum name="intensity" value="100"/></emitter>"""
SECOND = """<emitter type="laser_line" id="blue"><float name="length" value="10"/>
    <float name="radius" value="0.5"/><float name="power" value="0.1"/>
    <float name="distance" value="300"/><transform name="to_world">
    <lookat origin="-160, 0, 250" target="6, 0, 0" up="0, 1, 0"/></transform></emitter>"""


def of_groove(folder, emitter):
    """The groove with another emitter."""
    path = groove().path
    text = path.read_text(encoding="utf-8").replace("</scene>", f"{emitter}</scene>")
    for name in ("meshes", "materials"):
        text = text.replace(f"{name}/", f"{path.parent}/{name}/")
    edited = folder / "edited.xml"
    edited.write_text(text, encoding="utf-8")
    return vs.load_scene(edited, **FILM, **STEEL, max_depth=3)


@pytest.fixture(scope="module")
def scene():
    return groove()


@pytest.fixture(scope="module")
def frame(scene):
    return vs.render_frame(scene)


def test_each_scene_that_comes_with_the_program_has_the_parameters():
    """Rationale: `-D max_depth=3` is the same word for all of them."""
    for path in shipped_scenes().glob("*.xml"):
        assert {"max_depth", "indirect_samples"} <= scene_parameters(path, {}).keys(), path.name


def test_layers_add_up_and_direct_light_is_that_of_a_frame_without(scene, frame):
    """To the bit; `render` gives the sum."""
    direct = vs.render(groove(max_depth=2))
    np.testing.assert_array_equal(frame.direct, direct)
    assert frame.indirect.shape == (1, 96, 96)
    assert frame.indirect.max() > 0.01 * frame.direct.max()
    whole = frame.direct + frame.indirect.sum(axis=0) + frame.background
    np.testing.assert_allclose(frame.radiance, whole, rtol=1e-6)
    np.testing.assert_allclose(vs.render(scene), frame.radiance, rtol=1e-5, atol=1e-12)
    without = vs.render_frame(groove(max_depth=2))
    assert (without.direct, without.indirect, without.ghosts, without.background) == (None,) * 4


def test_a_ghost_is_of_the_ray_that_makes_it():
    """Rationale: of one dot alone, whose place is known, and not of a mean over the line."""
    dot_mm, radius_mm = -5.0, 0.3
    frame = vs.render_frame(groove(dots=dot_mm, line_radius=radius_mm, max_depth=4))
    for bounce in (1, 2):
        s, t = np.moveaxis(frame.ghost_coordinates(bounce), -1, 0)
        seen = np.isfinite(s)
        assert seen.sum() > 200
        reach = 2.7 * radius_mm
        assert np.abs(s[seen]).max() < reach
        assert np.abs(t[seen] - dot_mm).max() < reach
        np.testing.assert_array_equal(seen, frame.indirect[bounce - 1] > 0.0)
    assert np.nanmax(frame.ghosts.spread["laser"]) < 2.0 * radius_mm


def test_ghosts_of_two_lasers_are_told_apart(tmp_path):
    """Each laser's are those of a scene in which it is alone; the layer holds both."""
    scene = of_groove(tmp_path, SECOND)
    both = vs.render_frame(scene)
    alone = [vs.render_frame(scene, source=name) for name in scene.sources]
    for frame, name in zip(alone, scene.sources, strict=True):
        ours = both.ghosts.radiance[name][0].sum()
        assert ours == pytest.approx(frame.indirect.sum(), rel=0.05)
        s = both.ghost_coordinates(1, name)[..., 0]
        assert np.nanmax(np.abs(s)) < 2.7 * FILM["line_radius"]
    total = sum(each.indirect.sum() for each in alone)
    assert both.indirect.sum() == pytest.approx(total, rel=0.05)
    with pytest.raises(vs.InputError, match="laser, blue"):
        both.ghost_coordinates(1)


def test_light_of_lamps_stays_apart_from_light_that_bounces(tmp_path):
    """A lamp lights all of the part: the background holds it, the direct layer none."""
    lit = vs.render_frame(of_groove(tmp_path, LAMP))
    dark = vs.render_frame(groove())
    assert lit.background.mean() > 0.1 * dark.direct.max()
    np.testing.assert_allclose(lit.direct, dark.direct, atol=1e-5 * lit.radiance.max())
    np.testing.assert_array_equal(lit.indirect, dark.indirect)
    rest = vs.render_exposure(of_groove(tmp_path, LAMP), 1e-3)
    np.testing.assert_allclose(rest.background, lit.background, rtol=1e-5)


def test_a_part_at_rest_has_the_ghosts_of_a_frame(frame, scene):
    """And one whose ghosts would take an hour is refused."""
    rest = vs.render_exposure(scene, 1e-3)
    np.testing.assert_allclose(rest.indirect, frame.indirect, rtol=1e-5)
    np.testing.assert_array_equal(rest.direct, frame.direct)
    rolling = vs.render_exposure(scene, 1e-3, row_time_s=1e-5)
    np.testing.assert_allclose(rolling.indirect, frame.indirect, rtol=1e-5)
    with pytest.raises(vs.InputError, match=r"moves by \d+ px, .*max_depth=2"):
        vs.render_exposure(scene, 1e-3, velocity_mm_s=(0.0, 1e5, 0.0), instants=2)


@pytest.mark.slow
def test_ghosts_of_a_part_that_moves_are_those_of_the_places_between(frame, scene):
    """Two pixels of motion across the line, by two frames half way to either side."""
    pixel_mm = 45.0 / 96
    moved = vs.render_exposure(scene, 1e-3, velocity_mm_s=(0.0, 2e3 * pixel_mm, 0.0))
    ends = [
        vs.render_frame(scene.with_sensor_moved(vs.Pose.shift([0.0, y * pixel_mm, 0.0])))
        for y in (-0.5, 0.5)
    ]
    between = np.mean([each.indirect for each in ends], axis=0)
    assert np.abs(moved.indirect - between).mean() < 0.1 * frame.indirect.mean()
    assert np.abs(moved.indirect - frame.indirect).mean() > np.abs(moved.indirect - between).mean()


def test_projected_patterns_bounce_too():
    """A black frame has none; a white one what a frame of white light has."""
    small = {"width": 64, "height": 48, "spp": 1, "max_depth": 3}
    scene = vs.load_scene("fringe_stepped_shaft", **small)
    frames = vs.render_sequence(scene, ["white", "black"])
    white = vs.render_frame(vs.load_scene("fringe_stepped_shaft", **small, pattern="white"))
    assert white.indirect.max() > 0.0
    np.testing.assert_allclose(frames.radiance[0], white.radiance, rtol=1e-5, atol=1e-12)
    assert frames.radiance[1].max() == 0.0


def test_light_that_bounced_is_speckled_by_itself_unless_it_is_one_wave(scene, frame):
    """The mean stays; the line's own grains are those of direct light alone."""
    broad = Aperture(16.0, linewidth_nm=1.0, roughness_um=5.0)
    direct = replace(frame, radiance=frame.direct, indirect=None, direct=None, ghosts=None)
    alone = vs.record(scene, direct, speckle=broad).light
    both = vs.record(scene, frame, speckle=broad).light
    added = both - alone
    assert added.min() > -1e-6 * both.max()
    assert added.sum() == pytest.approx(frame.indirect.sum(), rel=0.1)
    for one in (Aperture(16.0), Aperture(16.0, linewidth_nm=0.01)):  # which is coherent over 28 mm
        together, alone = (vs.record(scene, each, speckle=one).light for each in (frame, direct))
        assert (together - alone).min() < 0.0
    assert sensor_of(scene).bit_depth == 12


def test_truth_of_a_recorded_line_counts_its_direct_light(scene, frame):
    """Electrons of a column are those of the line, not of the ghost beneath."""
    shot = vs.record(scene, frame, seed=1)
    alone = replace(frame, radiance=frame.direct, indirect=None)
    again = vs.record(scene, alone, seed=1)
    scale = again.electrons_per_radiance / shot.electrons_per_radiance
    np.testing.assert_allclose(again.truth.electrons, shot.truth.electrons * scale, rtol=1e-4)


def test_a_shiny_groove_says_that_direct_light_is_too_little_and_a_cylinder_does_not(frame):
    """The estimate before rendering is of the size of the rendered ghosts, and goes with them."""
    for roughness in (0.1, 0.3):
        (note,) = bounces(groove(max_depth=2, roughness=roughness))
        assert "-D max_depth=3 has them" in note
    for convex in ("hot_cylinder", "cold_cylinder"):
        assert self_lighting(vs.load_scene(convex, **FILM)).share == 0.0
    for dull in ("hot_cylinder", "stepped_shaft", "bearing_ring", "v_groove"):
        assert bounces(vs.load_scene(dull)) == [], dull
    rough = [self_lighting(groove(roughness=alpha)).ghost_over_line for alpha in (0.5, 0.3, 0.1)]
    assert np.all(np.diff(rough) > 0.0)
    rendered = ghost_facts(frame)
    assert 0.1 < rough[1] / np.quantile(frame.ghost_columns.over_line, 0.9) < 3.0
    assert rendered.ghost_columns > 0.5 * rendered.columns
    assert bounces(groove()) == []
    (bent,) = bounces(groove(field="hot_cylinder_1250C_quarter.nc"))
    assert "ghosts by up to 0.0" in bent
