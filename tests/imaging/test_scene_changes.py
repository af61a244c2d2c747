"""Scenes never change: `with_medium` and its kin give others, and all of them can be pickled."""

import copy
import multiprocessing
import os
import pickle
import shutil
from dataclasses import FrozenInstanceError, replace
from functools import partial
from pathlib import Path

import child_functions
import cloudpickle
import dask
import numpy as np
import pytest
from scipy.spatial.transform import Rotation
from several import two_by_two

import virtual_sensor as vs
from virtual_sensor.engine import mi
from virtual_sensor.errors import EngineError, InputError
from virtual_sensor.imaging import scene as scenes
from virtual_sensor.imaging.scene_file import shipped_scenes
from virtual_sensor.medium.description import MediumDescription
from virtual_sensor.optics.transports import Transport
from virtual_sensor.poses import Pose

FILM = {"width": 128, "height": 128, "spp": 1, "line_radius": 0.5}
Y = [0.0, -4.0]


@pytest.fixture(scope="module")
def hot():
    return vs.load_scene("hot_cylinder", **FILM)


@pytest.fixture(scope="module")
def two(tmp_path_factory):
    return two_by_two(tmp_path_factory.mktemp("two"))


def turned(pose, degrees=2.0, shift_mm=(1.0, -2.0, 3.0), mirror=(1.0, 1.0, 1.0)):
    """A pose turned about the world's y axis, shifted, and mirrored along its own axes."""
    turn = Rotation.from_euler("y", degrees, degrees=True).as_matrix()
    return Pose(turn @ pose.rotation * mirror, turn @ pose.origin_mm + shift_mm)


def assert_same(one, other):
    """Two scenes see the same: to the bit, by what is read of them, marched and rendered."""
    assert list(one.cameras) == list(other.cameras)
    assert list(one.sources) == list(other.sources)
    assert one.parameters == other.parameters
    assert one.transport == other.transport
    assert one.notes == other.notes
    for name, camera in one.cameras.items():
        np.testing.assert_array_equal(other.cameras[name].pose.rotation, camera.pose.rotation)
        np.testing.assert_array_equal(other.cameras[name].matrix, camera.matrix)
    for name, source in one.sources.items():
        np.testing.assert_array_equal(other.sources[name].pose.origin_mm, source.pose.origin_mm)
    assert (one.medium is None) == (other.medium is None)
    if one.medium:
        np.testing.assert_array_equal(other.medium.nodes, one.medium.nodes)
        np.testing.assert_array_equal(other.medium.box, one.medium.box)
    np.testing.assert_array_equal(vs.render(other), vs.render(one))


def test_a_scene_knows_its_cameras_and_sources_by_their_ids(hot):
    """What the shipped scenes call them, and the one of each."""
    assert list(hot.cameras) == ["camera"]
    assert list(hot.sources) == ["laser"]
    assert hot.camera is hot.cameras["camera"]
    assert hot.source is hot.sources["laser"]
    assert (hot.sensor.camera, hot.sensor.laser) == (hot.camera, hot.source)
    assert hot.mitsuba_camera.id() == "camera"
    assert hot.sources["laser"] is hot.loaded.sources["laser"].source


def test_elements_without_an_id_get_a_name_that_no_other_has(tmp_path):
    """Rationale: "camera" may be a shape's or the laser's name, and a scene may name nothing."""
    text = (shipped_scenes() / "cold_cylinder.xml").read_text(encoding="utf-8")
    included = '<include filename="materials/$material.xml"/>'
    text = text.replace(included, '<bsdf type="diffuse" id="steel"/>')
    path = tmp_path / "scene.xml"
    for changes, camera, source in (
        ([(' id="camera"', ""), (' id="laser"', "")], "camera", "laser"),
        ([(' id="camera"', ""), ('"laser"', '"camera"')], "camera_2", "camera"),
        (
            [(' id="laser"', ""), ('"part"', '"laser"'), ('"steel"', '"laser_2"')],
            "camera",
            "laser_3",
        ),
        ([('id="camera"', 'id="on the left, 60°"')], "on the left, 60°", "laser"),
    ):
        changed = text
        for before, after in changes:
            changed = changed.replace(before, after)
        path.write_text(changed, encoding="utf-8")
        scene = vs.load_scene(path)
        assert (list(scene.cameras), list(scene.sources)) == ([camera], [source])


def test_a_scene_does_not_change(hot):
    """Nor do the mappings that it shows."""
    with pytest.raises(FrozenInstanceError):
        hot.medium = None
    for named in (hot.cameras, hot.sources):
        with pytest.raises(TypeError, match="does not support item assignment"):
            named["other"] = None
    before = hot.medium
    hot.cold(), hot.with_medium(before), hot.with_pose("camera", turned(hot.camera.pose))
    assert hot.medium is before


def test_with_pose_moves_one_element_and_keeps_the_rest(hot):
    """To float32's resolution, camera and laser alike; the air is the very same."""
    for name in ("camera", "laser"):
        pose = turned(hot.poses[name])
        moved = hot.with_pose(name, pose)
        there = moved.poses[name]
        np.testing.assert_allclose(there.rotation, pose.rotation, atol=2e-7)
        np.testing.assert_allclose(there.origin_mm, pose.origin_mm, atol=2e-5)
        assert moved.medium is hot.medium
        assert moved.air == hot.air
        (other,) = {"camera", "laser"} - {name}
        kept, before = moved.poses[other], hot.poses[other]
        np.testing.assert_array_equal(kept.rotation, before.rotation)
        np.testing.assert_array_equal(kept.origin_mm, before.origin_mm)


def test_a_sensor_moved_by_its_poses_is_one_moved_by_its_parameters(hot):
    """Rationale: `to_world` is made of parameters; what is rendered and searched must follow."""
    there = vs.load_scene("hot_cylinder", **FILM, beta=7, along=3)
    moved = hot
    for name, pose in there.poses.items():
        moved = moved.with_pose(name, pose)
    expected, found = (vs.ray_search(s, Y, "newton") for s in (there, moved))
    np.testing.assert_allclose(found.pixel, expected.pixel, atol=1e-4)
    frames = [vs.render(s) for s in (there, moved)]
    np.testing.assert_allclose(frames[1], frames[0], atol=1e-3 * frames[0].max())


def test_a_mirrored_pose_is_heeded_and_noted(hot):
    """As a mirrored to_world of the file is: the image is mirrored, and so it says."""
    pose = turned(hot.camera.pose, 0.0, (0, 0, 0), mirror=(-1.0, 1.0, 1.0))
    mirrored = hot.with_pose("camera", pose)
    np.testing.assert_allclose(mirrored.camera.pose.rotation, pose.rotation, atol=2e-7)
    assert any("to_world mirrors it" in note for note in mirrored.notes)
    image = vs.render(hot)
    np.testing.assert_allclose(vs.render(mirrored), image[:, ::-1], atol=1e-4 * image.max())


@pytest.mark.parametrize(
    ("name", "change", "words"),
    [
        ("sphere", {}, "no camera or source 'sphere'; the scene has: camera, laser"),
        ("camera", {"rotation": 2.0 * np.eye(3)}, "scales or shears"),
        ("laser", {"rotation": np.diag([1.0, 1.0, 0.5])}, "scales or shears"),
        ("camera", {"origin_mm": np.array([0.0, 0.0, np.nan])}, "not a finite number"),
        ("laser", {"origin_mm": np.array([0.0, 0.0, 2e6])}, "from the origin"),
        ("camera", {"origin_mm": np.zeros(3)}, "stands on a surface"),
    ],
)
def test_a_pose_that_can_not_be_is_refused(hot, name, change, words):
    """With the file and the element, as for any other."""
    with pytest.raises(vs.InputError) as refusal:
        hot.with_pose(name, replace(hot.camera.pose, **change))
    assert words in str(refusal.value)
    assert "hot_cylinder.xml" in str(refusal.value)


def test_changes_add_up_whatever_their_order(hot):
    """Rationale: a change that loads the scene again must not lose those before it."""
    pose, marched = turned(hot.camera.pose), hot.transport.by("marched", step_mm=4.0)
    one = hot.with_pose("camera", pose).cold().with_transport(marched)
    other = hot.cold().with_transport(marched).with_pose("camera", pose)
    assert one == other
    assert hash(one) == hash(other)
    assert_same(one, other)
    assert not one.hot
    assert one.with_medium(hot.medium).hot


def test_other_parameters_keep_what_was_changed(hot):
    """Rationale: pose and air of a changed scene were lost when a tolerance chose its samples."""
    pose, marched = turned(hot.camera.pose), hot.transport.by("marched", step_mm=4.0)
    assert hot.with_parameters() == hot
    assert hot.with_parameters(beta=3) == vs.load_scene("hot_cylinder", **FILM, beta=3)
    assert hot.with_parameters(beta=3).medium is hot.medium  # its file says the same
    fine = hot.with_parameters(step=1, transport="first_order")
    assert (fine.transport.name, fine.transport.march.step_mm) == ("first_order", 1.0)
    cooler = hot.with_pose("camera", pose).with_parameters(temperature=900, spp=4)
    assert cooler.air.path.name == "hot_cylinder_900C_quarter.nc"
    np.testing.assert_array_equal(
        cooler.camera.pose.rotation, hot.with_pose("camera", pose).camera.pose.rotation
    )
    assert cooler.mitsuba_camera.sampler().sample_count() == 4
    changed = hot.cold().with_transport(marched).only("camera", "laser")
    assert changed.with_parameters(spp=4).medium is None
    assert changed.with_parameters(spp=4).transport == marched
    air = replace(hot.medium)
    assert hot.with_medium(air).with_parameters(temperature=900).medium is air
    with pytest.raises(vs.InputError, match="no parameter 'tempreature'; the scene has"):
        hot.with_parameters(tempreature=900)
    with pytest.raises(vs.InputError, match=r"line \d+: refractive: a step of 500 mm is longer"):
        hot.with_parameters(step=500)


def test_scenes_are_equal_if_they_are_loaded_and_changed_alike(hot):
    """By value; air that comes from no file is the same if it is the same object."""
    assert hot == vs.load_scene("hot_cylinder", **FILM)
    assert len({hot, hot.cold(), hot.cold().cold(), vs.load_scene("hot_cylinder", **FILM)}) == 2
    air = replace(hot.medium)
    others = [
        hot.cold(),
        hot.with_medium(air),
        hot.with_transport(hot.transport.by("straight")),
        hot.with_pose("laser", turned(hot.source.pose)),
        vs.load_scene("hot_cylinder", **FILM, beta=1),
        vs.load_scene("stepped_shaft", **FILM),
    ]
    for other in others:
        assert hot != other
    assert hot.with_medium(air) == hot.with_medium(air)
    assert hot.with_medium(air) != hot.with_medium(replace(air))
    assert hot != "hot_cylinder"


def test_a_scene_says_what_it_is_in_a_line(hot):
    assert repr(hot) == (
        "Scene: hot_cylinder.xml, camera, laser, air hot_cylinder_1250C_quarter.nc, tabulated"
    )


def changed_scenes(hot):
    """A scene in each of its forms, by name."""
    weaker = replace(hot.medium, nodes=0.5 * (hot.medium.nodes + hot.medium.ambient), _lookups={})
    return {
        "as loaded": hot,
        "cold": hot.cold(),
        "other air": hot.with_medium(weaker),
        "posed": hot.with_pose("camera", turned(hot.camera.pose)),
        "cold and posed": hot.with_pose("laser", turned(hot.source.pose, 1.0)).cold(),
        "marched": hot.with_transport(hot.transport.by("marched", step_mm=3.0)),
        "only": hot.only(camera="camera", source="laser"),
    }


def test_scenes_travel_by_pickle_and_cloudpickle(hot):
    """Multiprocessing's and Dask's; small, but for air that comes from no file."""
    for name, scene in changed_scenes(hot).items():
        # Both ask the scene itself, so that the second is tried on few.
        both = name in ("as loaded", "other air")
        for module in (pickle, cloudpickle)[: 1 + both]:
            data = module.dumps(scene)
            assert (len(data) < 20_000) == (name != "other air"), name
            assert_same(scene, pickle.loads(data))
        if name != "other air":
            assert pickle.loads(data) == scene


@pytest.mark.slow
def test_another_process_sees_the_same(hot, two, tmp_path):
    """Rationale: a spawned process shares no memory, and has another working folder."""
    scenes = [*changed_scenes(hot).values(), two.only("far", "blue")]
    with multiprocessing.get_context("spawn").Pool(1, os.chdir, (tmp_path,)) as pool:
        there = pool.map(child_functions.pixels_and_radiance, scenes)
    task = dask.delayed(child_functions.pixels_and_radiance)(scenes[-1])
    there += dask.compute(task, scheduler="processes", num_workers=1)  # it spawns them too
    for scene, (pixel, radiance) in zip([*scenes, scenes[-1]], there, strict=True):
        np.testing.assert_array_equal(pixel, vs.ray_search(scene, Y, "newton").pixel)
        np.testing.assert_array_equal(radiance, vs.render(scene))


@pytest.fixture
def copied(tmp_path, monkeypatch):
    """A shipped scene of one's own in the working folder, with its field beside it."""
    monkeypatch.chdir(tmp_path)
    shutil.copy(shipped_scenes() / "hot_cylinder.xml", "own.xml")
    Path("air").mkdir()
    shutil.copy(shipped_scenes() / "fields" / "hot_cylinder_1250C_quarter.nc", "air/own.nc")
    return vs.load_scene("own.xml", field="air/own.nc", **FILM)


def test_a_scene_of_relative_paths_can_be_loaded_again_from_elsewhere(copied, monkeypatch):
    """Pickled, posed and at another place: paths start where the scene was loaded."""
    data, image = pickle.dumps(copied), vs.render(copied)
    monkeypatch.chdir("/")
    again = pickle.loads(data)
    assert again == copied
    np.testing.assert_array_equal(vs.render(again), image)
    for scene in (copied, again):
        moved = scene.with_pose("camera", copied.camera.pose)
        np.testing.assert_allclose(vs.render(moved), image, atol=1e-3 * image.max())


@pytest.mark.parametrize("file", ["own.xml", "air/own.nc"])
def test_a_scene_whose_files_were_changed_since_is_refused(copied, file):
    """Rationale: half of it would be of one file and half of another."""
    data = pickle.dumps(copied)
    with Path(file).open("ab") as stream:
        stream.write(b"\n")
    for load in (
        partial(pickle.loads, data),
        partial(copied.with_pose, "laser", copied.source.pose),
    ):
        with pytest.raises(vs.InputError, match=rf"can't be loaded again.*{file} was changed"):
            load()
    assert vs.render(copied).max() > 0.0  # what is loaded stays
    Path(file).unlink()
    with pytest.raises(vs.InputError, match=rf"{file} is gone"):
        pickle.loads(data)


def test_a_shipped_scene_is_that_of_the_program_that_unpickles_it(hot, monkeypatch, tmp_path):
    """Rationale: on another machine the program, and its scenes, may lie in another folder."""
    data = pickle.dumps(hot)
    shutil.copytree(shipped_scenes(), tmp_path / "another")
    monkeypatch.setattr(scenes, "shipped_scenes", lambda: tmp_path / "another")
    again = pickle.loads(data)
    assert again.path == tmp_path / "another" / "hot_cylinder.xml"
    assert again.air.path.is_relative_to(tmp_path)
    np.testing.assert_array_equal(again.medium.nodes, hot.medium.nodes)


def test_copies_are_the_scene_itself(hot):
    """Rationale: it never changes, and to load it again would take as long as the first time."""
    assert copy.copy(hot) is hot
    assert copy.deepcopy([hot]) == [hot]


def test_air_and_transport_are_plain_values(hot):
    """They can be compared, hashed, printed and given."""
    assert hot.air == MediumDescription(hot.air.path)
    assert hot.air.path.name == "hot_cylinder_1250C_quarter.nc"
    assert hot.cold().air == MediumDescription()
    assert isinstance(hot.transport, Transport)
    assert hot.transport.name == "tabulated"


def test_at_is_of_the_fields_file_only(hot):
    """After other air there are no instants to choose from."""
    with pytest.raises(vs.InputError, match="there is no 'field' to have instants"):
        hot.with_medium(hot.medium).at(1.0)


def test_a_scene_keeps_its_variant_in_another_process(hot):
    """Rationale: a worker starts with the usual one, and would compute something else."""
    usual = mi.variant()
    try:
        mi.set_variant("llvm_ad_rgb")
        scene = vs.load_scene("cold_cylinder", **FILM)
        image, data = vs.render(scene), pickle.dumps(scene)
        with multiprocessing.get_context("spawn").Pool(1) as pool:
            variant, radiance = pool.apply(child_functions.variant_and_radiance, (scene,))
    finally:
        mi.set_variant(usual)
    assert variant == "llvm_ad_rgb"
    np.testing.assert_array_equal(radiance, image)
    with pytest.raises(EngineError, match="is active, too late for 'llvm_ad_rgb'"):
        pickle.loads(data)
    assert hot != scene


def test_parameters_do_not_change_either(hot):
    """Rationale: a scene would be another one than its parameters say."""
    with pytest.raises(TypeError, match="does not support item assignment"):
        hot.parameters["beta"] = "5"


def test_a_sensor_that_is_moved_stands_where_its_scene_parameters_would_put_it():
    """Rationale: the file's own transforms, multiplied by Mitsuba, are the independent way."""
    scene = vs.load_scene("cold_cylinder", width=64, height=64)
    axis_mm = (0.0, 0.0, -13.5)
    motions = {
        "along": (3.0, vs.Pose.shift([3.0, 0.0, 0.0])),
        "beta": (15.0, vs.Pose.turn(15.0, [2.0, 0.0, 0.0], axis_mm)),
    }
    for parameter, (value, motion) in motions.items():
        moved, expected = (
            scene.with_sensor_moved(motion),
            scene.with_parameters(**{parameter: value}),
        )
        assert moved.poses.keys() == expected.poses.keys() == {"camera", "laser"}
        for name, pose in moved.poses.items():
            np.testing.assert_allclose(pose.origin_mm, expected.poses[name].origin_mm, atol=1e-4)
            np.testing.assert_allclose(pose.rotation, expected.poses[name].rotation, atol=1e-6)
        assert np.abs(moved.poses["camera"].origin_mm - scene.poses["camera"].origin_mm).max() > 2
    for wrong in (
        lambda: vs.Pose.shift([1.0, 2.0]),
        lambda: vs.Pose.shift("x"),
        lambda: vs.Pose.turn(3.0, [0.0, 0.0, 0.0]),
        lambda: vs.Pose.turn(np.nan, [0.0, 0.0, 1.0]),
    ):
        with pytest.raises(InputError, match="give"):
            wrong()
