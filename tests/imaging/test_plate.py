"""A plate in the part's place: its marks are where the scene's devices have them."""

import numpy as np
import pytest

import virtual_sensor as vs
from virtual_sensor.errors import InputError
from virtual_sensor.imaging.plate import plate_scenes

POSE = vs.Pose(
    np.array([[0.0, -1.0, 0.0], [1.0, 0.0, 0.0], [0.0, 0.0, 1.0]])
    @ vs.Pose.turn(160.0, (1.0, 0.2, 0.1)).rotation,
    np.array([0.5, -1.0, 2.0]),
)


@pytest.fixture(scope="module")
def scene():
    return vs.load_scene("fringe_cylinder", width=256, height=256, spp=16)


def test_a_plate_stands_where_it_is_asked_to(scene):
    """Expected: the marks of a rendered plate within 0.03 px of their points' projection."""
    target = vs.CalibrationTarget("dots", 6, 5, 5.0)
    with plate_scenes(scene.cold(), target.drawn(16), target.size_mm) as plates:
        lit = plates.at(POSE, 1.0)
        image = vs.render(lit)
    true = scene.camera.project(POSE.to_world(target.points_mm))
    found = vs.find_marks(image, target, true)
    assert (found.status == vs.MarkStatus.FOUND).all()
    assert np.abs(found.pixel - true).max() < 0.03
    assert image.max() == pytest.approx(target.bright / np.pi, rel=1e-4)  # its lamp's 1 W/mm^2


def test_devices_and_air_stay_and_the_part_goes(scene):
    with plate_scenes(scene, np.ones((4, 4), np.float32), (40.0, 40.0)) as plates:
        dark, lit = plates.at(POSE), plates.at(POSE, 2.0)
    assert len(dark.mitsuba.shapes()) == 1
    assert dark.cameras == scene.cameras
    assert dark.projector == scene.projector
    assert dark.medium == scene.medium
    assert not lit.sources
    colder = vs.Pose(scene.camera.pose.rotation, scene.camera.pose.origin_mm + 1.0)
    moved = scene.with_pose("camera", colder).cold()
    with plate_scenes(moved, np.ones((4, 4), np.float32), (40.0, 40.0)) as plates:
        dark = plates.at(POSE)
    np.testing.assert_allclose(dark.camera.pose.origin_mm, colder.origin_mm, atol=1e-4)
    assert dark.medium is None


def test_a_part_in_another_file_is_told(scene, tmp_path):
    text = scene.path.read_text(encoding="utf-8")
    head, tail = text.split('<shape type="cylinder"', 1)
    part, rest = tail.split("</shape>", 1)
    part = '<scene version="3.0.0"><shape type="cylinder"' + part + "</shape></scene>"
    (tmp_path / "part.xml").write_text(part, encoding="utf-8")
    main = tmp_path / "scene.xml"
    main.write_text(f'{head}<include filename="part.xml"/>{rest}', encoding="utf-8")
    cold = vs.load_scene(main, field="").cold()
    with (
        pytest.raises(InputError, match="put its elements into the scene file"),
        plate_scenes(cold, np.ones((4, 4), np.float32), (40.0, 40.0)),
    ):
        pass
