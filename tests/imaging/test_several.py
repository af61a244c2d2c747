"""Scenes with several cameras and sources, one or none: each is a scene, and says what it has."""

import numpy as np
import pytest
from several import LAMP, ORTHOGRAPHIC, element, text_of, two_by_two

import virtual_sensor as vs
from virtual_sensor.imaging.checks import check_scene
from virtual_sensor.optics.ray_search import SearchStatus

Y = [0.0, -4.0]


@pytest.fixture(scope="module")
def two(tmp_path_factory):
    return two_by_two(tmp_path_factory.mktemp("two"))


@pytest.fixture
def written(tmp_path):
    """A scene of cameras and sources, loaded."""

    def write(cameras, sources, more="", name="cold_cylinder", **parameters):
        path = tmp_path / "scene.xml"
        path.write_text(text_of(name, cameras, sources, more), encoding="utf-8")
        if cameras:
            parameters = {"width": 128, "height": 128, "spp": 1} | parameters
        if sources:
            parameters = {"line_radius": 0.5} | parameters
        return vs.load_scene(path, **parameters)

    return write


def test_all_cameras_and_sources_are_there_by_name(two):
    """In the order of the file, each with its own pose, film and light."""
    assert list(two.cameras) == ["near", "far"]
    assert list(two.sources) == ["red", "blue"]
    assert list(two.poses) == ["near", "far", "red", "blue"]
    assert two.cameras["near"].size == (128, 128)
    assert two.cameras["far"].size == (192, 128)
    single = vs.load_scene("hot_cylinder", width=128, height=128)
    np.testing.assert_array_equal(two.cameras["near"].matrix, single.camera.matrix)
    np.testing.assert_array_equal(two.poses["near"].rotation, single.poses["camera"].rotation)
    np.testing.assert_array_equal(two.poses["red"].origin_mm, single.poses["laser"].origin_mm)
    axes = [two.poses[name].rotation[:, 2] for name in two.poses]
    assert np.degrees(np.arccos(axes[0] @ axes[1])) == pytest.approx(20.0, abs=1e-3)
    assert np.degrees(np.arccos(axes[2] @ axes[3])) == pytest.approx(15.0, abs=1e-3)


@pytest.mark.parametrize(
    ("ask", "words"),
    [
        (lambda scene: scene.camera, "2 cameras: near, far; say which (camera=, or --camera"),
        (lambda scene: scene.source, "2 sources: red, blue; say which (source=, or --source"),
        (lambda scene: scene.sensor, "2 cameras: near, far; say which"),
        (lambda scene: scene.only("near").sensor, "2 sources: red, blue; say which"),
        (lambda scene: scene.only(source="red").sensor, "2 cameras: near, far; say which"),
        (lambda scene: scene.only("left"), "no camera 'left'; the scene has: near, far"),
        (lambda scene: scene.only("red"), "no camera 'red'; the scene has: near, far"),
        (lambda scene: scene.only(source="far"), "no source 'far'; the scene has: red, blue"),
        (lambda scene: scene.only("near").only("far"), "no camera 'far'; the scene has: near"),
        (lambda scene: scene.only(camera=""), "no camera ''; the scene has: near, far"),
        (lambda scene: vs.ray_search(scene, Y), "2 cameras: near, far; say which"),
        (lambda scene: vs.ray_search(scene, Y, camera="far"), "2 sources: red, blue; say which"),
        (lambda scene: vs.ray_search(scene, Y, source="x"), "no source 'x'"),
    ],
)
def test_what_needs_one_and_finds_several_says_which_there_are(two, ask, words):
    """With the scene's file."""
    with pytest.raises(vs.InputError) as refusal:
        ask(two)
    assert words in str(refusal.value)
    assert "two_hot_cylinder.xml: " in str(refusal.value)


def test_only_leaves_one_of_each(two):
    """The rest of the scene, its changes among it, stays as it is."""
    for camera in two.cameras:
        for source in two.sources:
            one = two.cold().only(camera, source)
            assert one.camera is two.cameras[camera]
            assert one.source is two.sources[source]
            assert one.mitsuba_camera.id() == camera
            assert list(one.sources) == [source]
            assert one.medium is None
            assert one == two.only(source=source).only(camera=camera).cold()
    assert two.only() == two


def test_a_search_of_one_pair_is_that_of_a_scene_with_no_other(two, written):
    """Rationale: other cameras and lasers must not disturb, nor be taken for the one asked for."""
    for camera, degrees in (("near", 0), ("far", 20)):
        single = written([(camera, degrees, 1)], [("blue", 15, 4)], name="hot_cylinder")
        expected = vs.ray_search(single, Y, "newton")
        found = vs.ray_search(two, Y, "newton", camera=camera, source="blue")
        shift = np.array([32.0, 0.0]) if camera == "far" else 0.0
        scale = 1.5 if camera == "far" else 1.0
        np.testing.assert_allclose(found.laser_point_mm, expected.laser_point_mm, atol=1e-9)
        middle = expected.pixel - 63.5
        np.testing.assert_allclose(found.pixel - 63.5 - shift, scale * middle, atol=1e-4)


def test_one_of_several_can_be_posed(two):
    """Its neighbours stay; and what was chosen stays chosen."""
    pose = two.poses["blue"]
    moved = two.with_pose("near", two.poses["far"]).only("near", "blue")
    np.testing.assert_allclose(moved.camera.pose.rotation, two.poses["far"].rotation, atol=1e-6)
    np.testing.assert_array_equal(moved.source.pose.rotation, pose.rotation)
    chosen = two.only("near", "blue").with_pose("near", two.poses["far"])
    assert chosen == moved
    with pytest.raises(vs.InputError, match="no camera or source 'far'; the scene has: near, blue"):
        chosen.with_pose("far", pose)


def test_elements_without_names_get_their_own(written):
    """They are "camera", "camera_2" and so on, past the names that are taken."""
    scene = written([("", 0, 1), ("", 20, 1), ("camera_2", 5, 1)], [("", 0, 0), ("laser", 9, 4)])
    assert list(scene.cameras) == ["camera", "camera_3", "camera_2"]
    assert list(scene.sources) == ["laser_2", "laser"]


def test_each_pair_is_checked_and_named(written):
    """A pair that sees nothing is noted while another does, and refused when none does."""
    cameras, lasers = [("near", 0, 1), ("away", 90, 1)], [("red", 0, 0)]
    (note,) = check_scene(written(cameras, lasers))
    assert note.startswith("away with red: ")
    hidden = '<sensor id="away">: the part hides the laser line from the camera'
    assert hidden in note
    with pytest.raises(vs.InputError, match=hidden):
        check_scene(written(cameras[1:], lasers))
    with pytest.raises(vs.InputError, match=hidden):
        check_scene(written(cameras, lasers).only(camera="away"))
    with pytest.raises(vs.InputError, match='<emitter id="blue">: the laser misses the part'):
        check_scene(written(cameras[:1], [("blue", 0, 100)]))


def test_a_scene_without_a_source_is_one(written):
    """With a lamp or in the dark; what needs a laser says what to add."""
    for more in (LAMP, ""):
        scene = written([("near", 0, 1)], [], more)
        assert dict(scene.sources) == {}
        assert scene.camera is scene.cameras["near"]
        assert check_scene(scene) == []
        with pytest.raises(vs.InputError, match=r'the scene has no source.*type="laser_line"'):
            vs.ray_search(scene, Y)
        with pytest.raises(vs.InputError, match="no source 'lamp'; the scene has: none"):
            scene.only(source="lamp")


def test_a_camera_that_is_no_pinhole_is_left_out_and_noted(written):
    """Beside one that is; alone it is refused."""
    scene = written([("near", 0, 1)], [("red", 0, 0)], ORTHOGRAPHIC)
    assert list(scene.cameras) == ["near"]
    (note,) = scene.notes
    assert '<sensor id="flat"> is no <sensor type="lens_camera">; it is left out' in note
    assert vs.ray_search(scene, Y).status.tolist() == [SearchStatus.FOUND] * 2
    with pytest.raises(vs.InputError, match=r'<sensor id="flat"> is no .*a camera must be one'):
        written([], [("red", 0, 0)], ORTHOGRAPHIC)


def test_each_cameras_sampler_is_asked(written, tmp_path):
    """Rationale: the second one's number was never compared with what it takes."""
    text = text_of("cold_cylinder", [("near", 0, 1), ("far", 20, 1)], [("red", 0, 0)])
    at = text.rindex('value="$spp"')
    path = tmp_path / "uneven.xml"
    path.write_text(text[:at] + 'value="7"' + text[at + len('value="$spp"') :], encoding="utf-8")
    with pytest.raises(vs.InputError, match=r"line \d+.*sample_count of 7: it would take 9"):
        vs.load_scene(path)


def test_bent_triangulation_of_each_pair_gives_the_incidence_points(written):
    """Rationale: air bends every pair's light differently; straight lines miss by far more."""
    scene = written(
        [("near", 0, 1), ("far", 20, 1)],
        [("red", 0, 0), ("blue", 15, 4)],
        name="hot_cylinder",
        **{"width": 2048, "height": 2048, "line_radius": 0.15},
    )
    y = np.linspace(-10.0, 10.0, 101)
    for camera in scene.cameras:
        for source in scene.sources:
            names = {"camera": camera, "source": source}
            found = vs.ray_search(scene, y, "newton", **names)
            pixel, point = found.pixel, found.laser_point_mm
            assert np.all(found.status == SearchStatus.FOUND)
            bent = vs.triangulate(scene, pixel, medium=scene.medium, **names)
            straight = vs.triangulate(scene, pixel, **names)
            assert np.linalg.norm(bent - point, axis=1).max() < 5e-5
            assert np.linalg.norm(straight - point, axis=1).max() > 5e-3
            seen = vs.project(scene, point, camera=camera)
            np.testing.assert_allclose(seen, pixel, atol=2e-3)


def test_lasers_in_other_files_and_inside_shapes_are_sources(written, tmp_path):
    """Named in their order, and each light is there once though a <ref> names it again."""
    text = text_of("cold_cylinder", [("", 0, 1)], [("", 0, 0)])
    laser = element(text, "emitter")
    (tmp_path / "laser.xml").write_text(f'<scene version="3.0.0">{laser}</scene>', encoding="utf-8")
    include, part = '<include filename="laser.xml"/>', '<float name="radius" value="13.5"/>'
    image = None
    for changed, names in (
        (text.replace(laser, include), ["laser"]),
        (text.replace(laser, "").replace(part, part + laser), ["laser"]),
        (text.replace(laser, laser.replace(">", ' id="red">', 1)) + "", ["red"]),
        (text.replace(laser, laser.replace(">", ' id="red">', 1) + '<ref id="red"/>'), ["red"]),
        (text.replace(laser, laser + include + include), ["laser", "laser_2", "laser_3"]),
    ):
        path = tmp_path / "odd.xml"
        path.write_text(changed, encoding="utf-8")
        scene = vs.load_scene(path, width=64, height=64, spp=1, line_radius=0.8)
        assert list(scene.sources) == names
        frame = vs.render(scene, source=names[-1])
        image = frame if image is None else image
        np.testing.assert_allclose(frame, image, atol=1e-5 * image.max())
        np.testing.assert_allclose(vs.render(scene), len(names) * image, atol=1e-4 * image.max())
