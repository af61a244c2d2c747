"""Scenes with a projector: where it stands, what asks for a laser, and what is checked."""

import pickle
import re
from pathlib import Path

import numpy as np
import pytest

import virtual_sensor as vs
from virtual_sensor.imaging.checks import check_scene
from virtual_sensor.imaging.scene_file import shipped_scenes

FRINGE = ["fringe_cylinder", "fringe_stepped_shaft"]
SMALL = {"width": 64, "height": 64, "spp": 1}


def written(folder: Path, change) -> Path:
    """A scene of one's own, made of the fringe cylinder's text."""
    text = (shipped_scenes() / "fringe_cylinder.xml").read_text(encoding="utf-8")
    text = change(text.replace('"fields/', f'"{shipped_scenes()}/fields/'))
    path = folder / "own.xml"
    path.write_text(text, encoding="utf-8")
    return path


def test_the_projector_stands_in_the_lasers_place() -> None:
    """Its frame is the laser's: u along s of the sheet, v along the line; 60 mm x 37.5 mm."""
    line = vs.load_scene("hot_cylinder", **SMALL)
    for name in FRINGE:
        for beta in (0.0, 20.0):
            scene = vs.load_scene(name, beta=beta, along=3, **SMALL)
            laser = vs.load_scene("hot_cylinder", beta=beta, along=3, **SMALL).laser
            np.testing.assert_allclose(
                scene.projector.pose.rotation, laser.pose.rotation, atol=1e-6
            )
            np.testing.assert_allclose(scene.projector.pose.origin_mm, laser.pose.origin_mm)
        scene = vs.load_scene(name)
        assert scene.camera.size == (2048, 2048)
        np.testing.assert_allclose(scene.camera.pose.origin_mm, line.camera.pose.origin_mm)
        projector = scene.projector
        assert projector.size == (1280, 800)
        assert projector is scene.source
        assert projector.power_w == pytest.approx(0.1)
        low, high = projector.extent
        np.testing.assert_allclose(300.0 * (high - low), [60.0, 37.5], rtol=1e-6)
        np.testing.assert_allclose(300.0 * (high + low), 0.0, atol=1e-5)
        # The middle of the image falls on the part's top line.
        origin, direction = projector.family.rays(*projector.rays_of(639.5, 399.5))
        np.testing.assert_allclose(origin + 300.0 * direction, 0.0, atol=1e-3)
        np.testing.assert_allclose(projector.target_mm, 0.0, atol=1e-3)


def test_its_parameters_say_what_is_thrown() -> None:
    given = {"pattern": "gray u 3", "pixels": False, "gamma": 2.2, "bits": 8, "contrast": 400}
    size = {"projector_width": 640, "projector_height": 400, "defocus": 0.6, "power": 0.5}
    projector = vs.load_scene("fringe_cylinder", **SMALL, **given, **size).projector
    assert projector.pattern == vs.GrayBit("u", 3)
    assert (projector.gamma, projector.bits, projector.contrast) == (2.2, 8, 400.0)
    assert (projector.size, projector.defocus_px, projector.power_w) == ((640, 400), 0.6, 0.5)
    assert not projector.pixels


def test_what_needs_a_laser_says_what_to_use_instead() -> None:
    scene = vs.load_scene("fringe_cylinder", **SMALL)
    for ask in (
        lambda: scene.sensor,
        lambda: scene.laser,
        lambda: vs.TrueLine.of_frame(vs.render_frame(scene.cold())),
    ):
        with pytest.raises(vs.InputError, match="laser line"):
            ask()
    pixel = [[30.0, 30.0]]
    for call in (
        lambda: vs.triangulate(scene, pixel),
        lambda: vs.triangulated_points(scene, pixel, medium=scene.medium),
        lambda: vs.bent_points(scene, pixel),
        lambda: vs.Observation(scene, pixel),
        lambda: vs.ray_search(scene, [0.0]),
        lambda: vs.lines_by_source(scene, np.ones((64, 64))),
    ):
        with pytest.raises(vs.InputError, match="projector"):
            call()
    assert np.isfinite(vs.triangulate(scene, pixel, coordinate=0.01)).all()
    with pytest.raises(vs.InputError, match="virtual-sensor fringes"):
        _ = scene.sensor
    with pytest.raises(vs.InputError, match=r"no projector.*pattern_projector"):
        _ = vs.load_scene("hot_cylinder", **SMALL).projector


def test_a_scene_may_have_projectors_beside_a_laser(tmp_path) -> None:
    def with_laser(text: str) -> str:
        hot = (shipped_scenes() / "hot_cylinder.xml").read_text(encoding="utf-8")
        laser = hot[hot.index("    <emitter ") : hot.index("    <include ")]
        for name, value in re.findall(r'<default name="(\w+)" value="([^"]*)"', hot):
            if f'name="{name}"' not in text:
                laser = laser.replace(f'"${name}"', f'"{value}"')
        return text.replace("    <include ", laser + "    <include ", 1)

    scene = vs.load_scene(written(tmp_path, with_laser), **SMALL)
    assert list(scene.sources) == ["projector", "laser"]
    assert scene.projector is scene.sources["projector"]
    assert scene.only(source="laser").laser is scene.sources["laser"]
    assert check_scene(scene) == []
    cold = scene.cold()
    both = vs.render(cold)
    alone = [vs.render(cold, source=name) for name in cold.sources]
    np.testing.assert_allclose(both, sum(alone), rtol=1e-3, atol=1e-3 * both.max())
    with pytest.raises(vs.InputError, match="2 sources"):
        _ = scene.source

    def twice(text: str) -> str:
        own = text[text.index("    <emitter ") : text.index("    <include ")]
        return text.replace(own, own + own.replace(' id="projector"', ""))

    scene = vs.load_scene(written(tmp_path, twice), **SMALL)
    assert list(scene.sources) == ["projector", "projector_2"]
    with pytest.raises(vs.InputError, match=r"2 projectors: .*--source"):
        _ = scene.projector


def test_scenes_with_a_projector_are_moved_and_pickled() -> None:
    """Mitsuba's axes of a projector are a camera's; ours stay as they are given."""
    scene = vs.load_scene("fringe_cylinder", **SMALL, pattern="checker 40")
    motion = vs.Pose.turn(5.0, (0, 0, 1)).moved(vs.Pose.shift((1.0, 2.0, 3.0)))
    pose = scene.projector.pose.moved(motion)
    moved = scene.with_pose("projector", pose)
    np.testing.assert_allclose(moved.projector.pose.rotation, pose.rotation, atol=1e-6)
    np.testing.assert_allclose(moved.projector.pose.origin_mm, pose.origin_mm, atol=1e-4)
    again = pickle.loads(pickle.dumps(moved))
    assert again == moved
    assert again.projector == moved.projector
    together = scene.with_sensor_moved(motion)
    np.testing.assert_allclose(together.projector.pose.rotation, pose.rotation, atol=1e-6)
    still = vs.render(scene.cold())
    assert np.array_equal(
        vs.render(scene.with_pose("projector", scene.projector.pose).cold()), still
    )
    assert not np.allclose(vs.render(moved.cold()), still, atol=0.1 * still.max())


def test_scenes_are_checked_by_the_light_of_their_projector() -> None:
    assert check_scene(vs.load_scene("fringe_cylinder", **SMALL)) == []
    for given, said in (
        ({"along": 200}, "projector misses the part"),
        ({"alpha": 0}, "from the projector's axis"),
        ({"tilt": 40}, "under the floor"),
        ({"field": "hot_cylinder_1250C_quarter", "along": 200}, "misses"),
    ):
        scene = vs.load_scene("fringe_cylinder", **SMALL, **given)
        with pytest.raises(vs.InputError, match=said):
            check_scene(scene)
        assert any(said in note for note in scene.notes), given
    (note,) = check_scene(vs.load_scene("fringe_cylinder", **SMALL, emissivity=0.8))
    assert "of the projector's light" in note
    shaft = vs.load_scene("fringe_stepped_shaft", **SMALL)
    assert any("is not of this part" in note for note in shaft.notes)


def test_a_camera_that_looks_elsewhere_is_told(tmp_path) -> None:
    aside = written(
        tmp_path, lambda text: text.replace('target="0, 0, 0" up="-1', 'target="95, 0, 0" up="-1')
    )
    with pytest.raises(vs.InputError, match="does not hold the projector's light"):
        check_scene(vs.load_scene(aside, **SMALL))


def test_the_shafts_steps_break_the_light_off() -> None:
    """Its shadows and steps are in the truth: pixels without light beside lit ones."""
    scene = vs.load_scene("fringe_stepped_shaft", width=160, height=160, spp=1).cold()
    frame = vs.render_frame(scene)
    lit = frame.lit[:, 80]
    rows = np.flatnonzero(lit)
    assert len(rows) > 120
    dark = rows[0] + np.flatnonzero(~lit[rows[0] : rows[-1]])
    assert 3 <= len(dark) <= 12
    depth = frame.depth_mm[[dark[0] - 1, dark[-1] + 1], 80]
    pitch = np.median(np.abs(np.diff(frame.depth_mm[rows[:40], 80])))
    assert abs(depth[1] - depth[0]) > 2.0 * pitch
