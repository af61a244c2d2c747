"""Scenes whose part, air and sensor were moved together: what they see does not change."""

from dataclasses import replace

import numpy as np
import pytest

import virtual_sensor as vs
from virtual_sensor.errors import InputError
from virtual_sensor.imaging.checks import border_crossings, check_scene, lit_line
from virtual_sensor.imaging.scene import shipped_scenes
from virtual_sensor.poses import Pose

# Axes change places, so that float32 says it exactly: x is where y was, and so on.
MOTION = Pose(np.roll(np.eye(3), 1, axis=0), np.array([32.0, -40.0, 24.0]))
MOVES = (
    f'<matrix value="{" ".join(f"{v:g}" for v in MOTION.rotation.ravel())}"/>'
    f'<translate x="{MOTION.origin_mm[0]}" y="{MOTION.origin_mm[1]}" z="{MOTION.origin_mm[2]}"/>'
)
FILM = {"width": 512, "height": 512, "spp": 4, "line_radius": 0.5}
Y = np.linspace(-9.7, 9.5, 12)


@pytest.fixture(scope="module")
def still():
    return vs.load_scene("hot_cylinder", **FILM)


@pytest.fixture(scope="module")
def file(tmp_path_factory):
    """The shipped scene with one more motion of every part, but not of its air."""
    text = (shipped_scenes() / "hot_cylinder.xml").read_text(encoding="utf-8")
    assert text.count("</transform>") == 4
    text = text.replace("</transform>", f"{MOVES}</transform>")
    tube = '<float name="radius" value="13.5"/>'
    assert text.count(tube) == 1
    text = text.replace(tube, f'{tube}<transform name="to_world">{MOVES}</transform>')
    text = text.replace('value="fields/', f'value="{shipped_scenes()}/fields/')
    path = tmp_path_factory.mktemp("moved") / "moved.xml"
    path.write_text(text, encoding="utf-8")
    return path


@pytest.fixture(scope="module")
def moved(file):
    scene = vs.load_scene(file, **FILM)
    return scene.with_medium(scene.medium.moved(MOTION))


def test_the_search_finds_the_same_pixels(still, moved):
    """By Mitsuba's float32 cylinder, which the moved one is: it lies along no x any more."""
    one, other = (vs.ray_search(scene, Y, "newton") for scene in (still, moved))
    np.testing.assert_array_equal(one.status, other.status)
    np.testing.assert_allclose(other.pixel, one.pixel, rtol=0, atol=1e-4)
    cold = vs.ray_search(still.cold(), Y, "newton").pixel
    assert np.abs(other.pixel - cold).max() > 0.5  # px: the air is there


@pytest.mark.parametrize("transport", ["tabulated", "marched"])
def test_frames_show_the_same_line(still, moved, transport):
    """Centres in every column, by maps and by marches."""
    rows = []
    for scene in (still, moved):
        frame = vs.render(scene.with_transport(replace(scene.transport, name=transport)))
        line = vs.line_centres(frame, "gaussian")
        rows.append(np.where(line.status == 0, line.row, np.nan))
    assert np.isfinite(rows[0]).sum() > 200
    np.testing.assert_allclose(rows[1], rows[0], rtol=0, atol=5e-4)


def test_checks_ask_at_the_place_of_the_air(still, moved):
    """The same faces are crossed at moved places, with the same jumps, and the line is covered."""
    assert check_scene(moved) == [note.replace(str(still.path), "") for note in check_scene(still)]
    one, other = (
        border_crossings(scene.medium, scene.sensor, lit_line(scene)) for scene in (still, moved)
    )
    for name in ("camera", "laser"):
        np.testing.assert_array_equal(other[name].face, one[name].face)
        places = MOTION.to_world(one[name].place_mm)
        np.testing.assert_allclose(other[name].place_mm, places, rtol=0, atol=1e-4)
        np.testing.assert_allclose(other[name].jump, one[name].jump, rtol=1e-3, atol=1e-12)
        np.testing.assert_allclose(other[name].shift_px, one[name].shift_px, rtol=1e-3, atol=1e-9)


def test_air_that_stays_behind_is_refused(file, still):
    """A part that leaves its air, and air that leaves its part."""
    behind = vs.load_scene(file, **FILM)
    with pytest.raises(InputError, match=r"does not cover|floor"):
        check_scene(behind)
    away = still.with_medium(still.medium.moved(Pose(np.eye(3), np.array([0.0, 90.0, 0.0]))))
    with pytest.raises(InputError, match="in the moved field's own frame; give a larger field"):
        check_scene(away)
    above = still.with_medium(still.medium.moved(Pose(np.eye(3), np.array([0.0, 0.0, 300.0]))))
    with pytest.raises(InputError, match="under the floor of the air's field"):
        check_scene(above)
