"""Scenes whose part, air and sensor were moved together: what they see does not change."""

from dataclasses import replace

import numpy as np
import pytest

import virtual_sensor as vs
from virtual_sensor.errors import InputError
from virtual_sensor.imaging.checks import border_crossings, check_scene, lit_line
from virtual_sensor.imaging.scene_file import shipped_scenes
from virtual_sensor.medium.netcdf import read_field_file
from virtual_sensor.poses import Pose
from virtual_sensor.reporting.field import make_cut
from virtual_sensor.studies.field_info import field_info

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


AIR = f'<transform name="to_world">{MOVES}</transform>'


@pytest.fixture(scope="module")
def write(tmp_path_factory):
    """Write the shipped scene with one more motion of all but its air, whose is given."""
    text = (shipped_scenes() / "hot_cylinder.xml").read_text(encoding="utf-8")
    assert text.count("</transform>") == 4
    text = text.replace("</transform>", f"{MOVES}</transform>")
    tube = '<float name="radius" value="13.5"/>'
    assert text.count(tube) == 1
    text = text.replace(tube, f'{tube}<transform name="to_world">{MOVES}</transform>')
    text = text.replace('value="fields/', f'value="{shipped_scenes()}/fields/')
    assert text.count("</integrator>") == 1

    def write(of_air):
        path = tmp_path_factory.mktemp("moved") / "moved.xml"
        path.write_text(text.replace("</integrator>", f"{of_air}</integrator>"), encoding="utf-8")
        return path

    return write


@pytest.fixture(scope="module")
def moved(write):
    return vs.load_scene(write(AIR), **FILM)


def test_the_search_finds_the_same_pixels(still, moved):
    """By Mitsuba's float32 cylinder, which the moved one is: it lies along no x any more."""
    one, other = (vs.ray_search(scene, Y, "newton") for scene in (still, moved))
    np.testing.assert_array_equal(one.status, other.status)
    np.testing.assert_allclose(other.pixel, one.pixel, rtol=0, atol=1e-4)
    cold = vs.ray_search(still.cold(), Y, "newton").pixel
    assert np.abs(other.pixel - cold).max() > 0.5  # px: the air is there


def test_points_are_projected_and_triangulated_as_before(still, moved):
    """Through the air that moved along, on both paths."""
    lit = vs.ray_search(still, Y, "newton")
    pixel = vs.project(still, lit.laser_point_mm)
    there = MOTION.to_world(lit.laser_point_mm)
    np.testing.assert_allclose(vs.project(moved, there), pixel, rtol=0, atol=1e-4)
    points = vs.triangulate(still.sensor, lit.pixel, medium=still.medium)
    found = vs.triangulate(moved.sensor, lit.pixel, medium=moved.medium)
    np.testing.assert_allclose(found, MOTION.to_world(points), rtol=0, atol=1e-5)
    np.testing.assert_allclose(found, there, rtol=0, atol=1e-3)


@pytest.mark.parametrize(
    "transport", ["tabulated", pytest.param("marched", marks=pytest.mark.slow)]
)
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
        border_crossings(scene.medium, scene.camera, scene.source, lit_line(scene))
        for scene in (still, moved)
    )
    for name in ("camera", "laser"):
        np.testing.assert_array_equal(other[name].face, one[name].face)
        places = MOTION.to_world(one[name].place_mm)
        np.testing.assert_allclose(other[name].place_mm, places, rtol=0, atol=1e-4)
        np.testing.assert_allclose(other[name].jump, one[name].jump, rtol=1e-3, atol=1e-12)
        np.testing.assert_allclose(other[name].shift_px, one[name].shift_px, rtol=1e-3, atol=1e-9)


def test_the_air_of_a_file_is_moved_as_by_hand(write, moved):
    """The integrator's to_world, and `with_medium`: to the bit."""
    scene = vs.load_scene(write(""), **FILM)
    assert scene.medium.pose is None
    by_hand = scene.with_medium(scene.medium.moved(moved.medium.pose))
    np.testing.assert_allclose(moved.medium.pose.origin_mm, MOTION.origin_mm, rtol=0, atol=1e-5)
    np.testing.assert_array_equal(vs.render(by_hand), vs.render(moved))
    for nothing in ("", AIR.replace(MOVES, '<translate x="0"/>')):
        assert vs.load_scene(write(nothing), **FILM).medium.pose is None


@pytest.mark.parametrize("motion", ['<scale value="2"/>', '<scale x="-1"/>'])
def test_air_is_turned_and_shifted_and_nothing_else(write, motion):
    with pytest.raises(InputError, match="'to_world' does more than turn and move"):
        vs.load_scene(write(AIR.replace(MOVES, motion)), **FILM)


def test_no_air_is_not_moved(write):
    path = write(AIR)
    text = path.read_text(encoding="utf-8").replace('<string name="field" value="$field"/>', "")
    path.write_text(text, encoding="utf-8")
    with pytest.raises(InputError, match="'to_world' moves a field"):
        vs.load_scene(path, **FILM)


def test_the_fields_solid_moves_along(write):
    """Air of another place is recognised by its solid too, where the line is still in its box."""
    solid = vs.load_scene("hot_cylinder", **FILM).air.path
    assert read_field_file(solid, 532.0).solid.any()
    aside = AIR.replace(MOVES, f'<translate y="20"/>{MOVES}')
    with pytest.raises(InputError, match="is not of this part"):
        check_scene(vs.load_scene(write(aside), **FILM))


@pytest.mark.slow
def test_a_field_is_examined_where_the_scene_has_it(write, still):
    """What it does to light, what its grid loses and its solid are those of the scene at rest."""
    one, other = (
        field_info(still.air.path, str(scene), FILM) for scene in ("hot_cylinder", write(AIR))
    )
    np.testing.assert_allclose(other.light.shift_px, one.light.shift_px, rtol=0, atol=1e-4)
    np.testing.assert_array_equal(other.solid, one.solid)
    assert "the scene moves the field" in "".join(other.notes)
    for normal in (0, 2):
        cuts = [make_cut(each, normal, 5.0) for each in (one, other)]
        np.testing.assert_allclose(cuts[1].refractivity, cuts[0].refractivity, rtol=1e-9)
        assert np.mean(cuts[1].solid != cuts[0].solid) < 1e-3


def test_air_that_stays_behind_is_refused(write, still):
    """A part that leaves its air, and air that leaves its part."""
    behind = vs.load_scene(write(""), **FILM)
    with pytest.raises(InputError, match=r"does not cover|floor"):
        check_scene(behind)
    away = still.with_medium(still.medium.moved(Pose(np.eye(3), np.array([0.0, 90.0, 0.0]))))
    with pytest.raises(InputError, match=r"in the moved field's own frame, .* give a larger field"):
        check_scene(away)
    above = still.with_medium(still.medium.moved(Pose(np.eye(3), np.array([0.0, 0.0, 300.0]))))
    with pytest.raises(InputError, match="under the floor of the air's field"):
        check_scene(above)
