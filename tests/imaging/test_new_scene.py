"""Scenes that `new` writes: what they measure is the part, wherever and however large it is."""

import itertools
import json
import re
from pathlib import Path

import numpy as np
import pytest
import trimesh

import virtual_sensor as vs
from virtual_sensor.errors import InputError
from virtual_sensor.imaging import loading
from virtual_sensor.imaging.materials import material_words
from virtual_sensor.imaging.new_scene.options import NewScene
from virtual_sensor.imaging.new_scene.write import write_scene
from virtual_sensor.imaging.parts import find_part
from virtual_sensor.imaging.scene_file import parameter_words
from virtual_sensor.optics.surfaces import Cylinder
from virtual_sensor.reporting.new_scene import next_steps
from virtual_sensor.studies.lines_by_source import expected_light

SMALL = {
    "film": "612x512",
    "pixel_um": 13.8,
    "line_radius_mm": 0.25,
}  # a field as of 2448 x 2048 px


def bracket():
    """An angle bracket of 40 x 60 x 30 mm with a round boss: its box's middle is no corner."""
    base = trimesh.creation.box((40, 60, 6), trimesh.transformations.translation_matrix((0, 0, 3)))
    wall = trimesh.creation.box(
        (40, 6, 30), trimesh.transformations.translation_matrix((0, 27, 15))
    )
    boss = trimesh.creation.cylinder(8, 10, sections=180)
    boss.apply_transform(trimesh.transformations.translation_matrix((0, -10, 8)))
    return trimesh.util.concatenate([base, wall, boss])


def pipe():
    """A thick ring of 60 mm: nothing is under the middle of its box."""
    return trimesh.creation.annulus(10, 30, 20, sections=120)


def tilted():
    """The bracket, askew."""
    mesh = bracket()
    mesh.apply_transform(trimesh.transformations.rotation_matrix(0.4, (1, 2, 0.5)))
    return mesh


def measured(scene):
    """Points (N, 3) of the one camera and the one laser, in cold air."""
    points = vs.triangulate(scene, vs.line_centres(vs.render(scene.cold())).pixel)
    return points[np.isfinite(points[:, 0])]


def beside_um(mesh, points):
    """Distances of some points from a mesh, by trimesh."""
    some = points[:: max(len(points) // 40, 1)]
    near = [
        trimesh.triangles.closest_point(mesh.triangles, np.tile(p, (len(mesh.faces), 1)))
        for p in some
    ]
    apart = np.linalg.norm(np.array(near) - some[:, None], axis=2).min(axis=1)
    return 1e3 * apart


def test_measured_points_lie_on_the_part(tmp_path):
    """Rationale: of a bracket askew, in inches, far off, and a ring: to a micrometre and a half."""
    far = np.array([40_000.0, -7_000.0, 300.0])
    cases = {
        "askew für 1.stl": (tilted(), 1.0, {"turn": 20, "tilt": 10, "alpha": -35}),
        "inch.obj": (bracket(), 1 / 25.4, {"unit": "in"}),
        "ring.ply": (pipe(), 1.0, {"fan": 15}),
        "far.ply": (bracket(), 1.0, {}),
    }
    for name, (mesh, scale, options) in cases.items():
        shift = far if name == "far.ply" else np.zeros(3)
        trimesh.Trimesh(mesh.vertices * scale + shift, mesh.faces).export(tmp_path / name)
        path = vs.new_scene(tmp_path / Path(name).stem, part=tmp_path / name, **SMALL, **options)
        points = measured(vs.load_scene(path))
        if shift.any():  # the part was moved to the origin by whole millimetres
            assert "moved to the origin" in path.read_text("utf-8")
            points = points + np.rint(mesh.bounds.mean(axis=0) + shift) - shift
        error_um = beside_um(mesh, points)
        assert len(points) > 80
        assert np.median(error_um) < 1.0, name  # a hundredth of a pixel
        assert np.quantile(error_um, 0.9) < 2.0, name


def test_a_camera_sees_what_its_laser_lights(tmp_path):
    """What is chosen suits the lens, the distance and the film that are given."""
    part = tmp_path / "part.stl"
    bracket().export(part)
    for said in (
        {},
        {"focal_length_mm": 75},
        {"distance_mm": 150},
        {"film": "640x2048", "pixel_um": 5},
        {"alpha": (60, -20), "tilt": (-30,)},
        {"up": "-z", "line_length_mm": 20},
    ):
        written = write_scene(tmp_path / "s", NewScene(f"{part}", "mm", **said), overwrite=True)
        for line in written.lines.values():
            assert line.outside == 0.0, said
            assert line.seen + line.hidden > 0.95, said
        scene = vs.load_scene(written.path)
        middle = [float(scene.parameters[f"at_{axis}"]) for axis in "xyz"]
        for camera in scene.cameras.values():
            width, height = camera.size
            middle_px = (width - 1) / 2, (height - 1) / 2
            np.testing.assert_allclose(camera.project([middle])[0], middle_px, atol=1e-2)


def test_where_there_is_no_surface_in_the_middle_the_line_lies_beside_it(tmp_path):
    """A ring off the origin, turned or not; two blocks apart; and a place of two numbers."""
    ring, blocks = pipe(), [trimesh.creation.box((10, 10, 10)) for _ in range(2)]
    for block, x in zip(blocks, (-40, 40), strict=True):
        block.apply_translation((x, 0, 0))
    for mesh, said, place in (
        (ring, {}, (11.25, 0, 10)),
        (ring, {"turn": 90}, (0, 11.25, 10)),
        (trimesh.util.concatenate(blocks), {}, (36.5625, 0, 5)),
        (ring, {"at_mm": (-20, 3)}, (-20, 3, 10)),
    ):
        mesh = mesh.copy()
        mesh.apply_translation((76, -50, 40))
        mesh.export(tmp_path / "part.stl")
        shift = (76, -50)
        if "at_mm" in said:
            said = {"at_mm": tuple(np.add(said["at_mm"], shift))}
        said = NewScene(f"{tmp_path / 'part.stl'}", "mm", **said)
        written = write_scene(tmp_path / "s", said, overwrite=True)
        at = [float(written.parameters[f"at_{axis}"]) for axis in "xyz"]
        np.testing.assert_allclose(at, np.add(place, (*shift, 40)), atol=2e-3)
        assert written.aside is (said.at_mm is None)
        assert written.lines["camera", "laser"].seen > 0.95 or said.at_mm


def test_a_part_in_metres_is_told(tmp_path):
    """By `survey`, by `new`, and as a warning of `new_scene`; not where the unit was said."""
    part = tmp_path / "plate.stl"
    trimesh.creation.box((0.05, 0.08, 0.0075)).export(part)
    words = "the part is 0.05 x 0.08 x 0.0075 mm: is its file in metres? then say --unit m"
    assert any(words in note for note in vs.survey(part).notes)
    assert vs.survey(part, "m").notes == ()
    with pytest.warns(UserWarning, match=re.escape(words)):
        vs.new_scene(tmp_path / "small", part=part)
    vs.new_scene(tmp_path / "plate", part=part, unit="m")


def test_a_line_is_no_longer_than_what_a_told_camera_sees(tmp_path):
    """Of a part of 80 mm before a camera that sees 36 mm."""
    part = tmp_path / "plate.stl"
    trimesh.creation.box((50, 80, 8)).export(part)
    said = NewScene(f"{part}", focal_length_mm=35, distance_mm=150)
    (line,) = write_scene(tmp_path / "s", said).lines.values()
    assert line.outside == 0.0


def test_a_part_that_stays_is_read_and_looked_over_once(tmp_path, monkeypatch):
    """Rationale: a scan moves the sensor thousands of times. A file that changed is read again."""
    files, reader = [], loading.read_part

    def read(file, kind):
        files.append(file)
        return reader(file, kind)

    monkeypatch.setattr(loading, "read_part", read)
    part = tmp_path / "part.stl"
    mesh = bracket()
    trimesh.Trimesh(mesh.vertices, mesh.faces[2:]).export(part)  # with a hole
    path = vs.new_scene(tmp_path / "scene", part=part, **SMALL)
    scene = vs.load_scene(path)
    files.clear()
    moved = scene.with_sensor_moved(vs.Pose.shift((1, 0, 0))).with_parameters(beta=1)
    assert files == []
    assert moved.notes == scene.notes
    assert any("hole" in note for note in moved.notes)
    mesh.export(part)
    assert not any("hole" in note for note in vs.load_scene(path).notes)


def test_sensors_stand_as_they_are_told(tmp_path):
    """Angles between axes, by their dot products; distances; K by focal length over pixel."""
    path = vs.new_scene(
        tmp_path / "pair",
        **{"alpha": (25, -40), "tilt": (5, 20), "laser_offset_mm": (0, 3), "turn": 90},
        **{"distance_mm": 333, "focal_length_mm": 20, "pixel_um": 4, "film": (600, 500)},
    )
    scene = vs.load_scene(path)
    assert [*scene.cameras, *scene.sources] == ["camera_1", "camera_2", "laser_1", "laser_2"]
    axis = {name: pose.rotation[:, 2] for name, pose in scene.poses.items()}

    def between(one, other):
        return np.degrees(np.arccos(axis[one] @ axis[other]))

    assert between("camera_1", "laser_1") == pytest.approx(25, abs=1e-3)
    assert between("camera_2", "laser_1") == pytest.approx(40, abs=1e-3)
    assert between("camera_2", "laser_2") == pytest.approx(55, abs=1e-3)
    assert np.degrees(np.arccos(-axis["laser_1"][2])) == pytest.approx(5, abs=1e-3)
    np.testing.assert_allclose(np.abs(scene.poses["laser_1"].rotation[:, 1]), [1, 0, 0], atol=1e-6)
    for camera in scene.cameras.values():
        assert np.linalg.norm(camera.pose.origin_mm) == pytest.approx(333)
        np.testing.assert_allclose(np.diag(camera.matrix)[:2], 20 / 4e-3, rtol=1e-6)
    # The second laser's sheet passes the origin 3 mm aside: along -y or y, turned by 90 degrees.
    _, offset = scene.only(source="laser_2").source.plane
    assert abs(offset) == pytest.approx(3.0 * np.cos(np.radians(20)), abs=1e-4)


def test_what_is_written_explains_itself(tmp_path):
    """Each parameter has words; a cylinder is the analytic one; a name with and without suffix."""
    path = vs.new_scene(tmp_path / "shaft & 1", diameter_mm=40, length_mm=90, temperature_c=900)
    assert path == tmp_path / "shaft & 1.xml"
    scene = vs.load_scene(tmp_path / "shaft & 1")
    words = material_words() | parameter_words(path)
    assert {name for name in scene.parameters if not words.get(name)} == set()
    assert isinstance(scene.surface, Cylinder)
    assert scene.surface.radius_mm == 20.0
    assert (scene.parameters["temperature"], scene.medium) == ("900", None)
    assert not re.search(r"\n\s*\n\s*\n", path.read_text("utf-8"))


def test_a_scene_is_copied_with_what_it_needs(tmp_path):
    """Its fields of all temperatures, its mesh; options become its parameters."""
    said = {"focal_length_mm": 50, "pixel_um": 3.45, "film": "245x205", "distance_mm": 400}
    said |= {"temperature_c": 900, "alpha": 50}
    path = vs.new_scene(tmp_path / "a b" / "mine", from_scene="stepped_shaft", **said)
    files = {f.relative_to(path.parent).as_posix() for f in path.parent.rglob("*") if f.is_file()}
    fields = {f"fields/hot_cylinder_{t}C_quarter.nc" for t in (900, 1100, 1250)}
    assert files == {"mine.xml", "meshes/stepped_shaft.ply", *fields}
    scene = vs.load_scene(path)
    assert scene.air.path == path.parent / "fields/hot_cylinder_900C_quarter.nc"
    assert scene.camera.matrix[0, 0] == pytest.approx(50 / 3.45e-3)
    with pytest.raises(InputError, match="it has no parameter roughness that --roughness could"):
        vs.new_scene(tmp_path / "other", from_scene="stepped_shaft", roughness=0.2)


def test_nothing_is_overwritten_and_nothing_is_left_of_what_is_refused(tmp_path):
    """The message names the option; files of before stay as they are."""
    part, folder = tmp_path / "part.stl", tmp_path / "scenes"
    folder.mkdir()
    bracket().export(part)
    (folder / "part.stl").write_text("another", encoding="utf-8")
    (folder / "there.xml").write_text("<scene/>", encoding="utf-8")
    before = {file: file.read_bytes() for file in folder.iterdir()}
    refused = (
        ("there", {}, r"there\.xml: exists; choose another name, or say overwrite=True"),
        ("new", {"part": part}, r"part\.stl: exists, and .* would be copied there"),
        ("hot_cylinder", {}, "a scene that is installed has this name"),
        ("new", {"part": "nope.stl"}, r"nope\.stl: can't be read"),
        ("new", {"part": part, "unit": "yard"}, "--unit yard: give one of in, ft, um, mm"),
        ("new", {"focal_length_mm": float("nan")}, "--focal-length nan: give a number"),
        ("new", {"alpha": 0}, "--alpha 0: the camera would look along the laser"),
        ("new", {"film": "2448"}, "--film 2448: give width x height"),
        ("new", {"at_mm": (0, 60, 0), "line_length_mm": 9}, "line misses the part; give --at"),
        ("new", {"at_mm": (500, 0, 0)}, "--at 500,0,0: the laser's sheet misses the part there"),
        (
            "new",
            {"distance_mm": 30, "focal_length_mm": 99, "at_mm": (0, 0, 9)},
            "longer --distance",
        ),
        ("new", {"tilt": (1, 1)}, "two lasers make the same line"),
        ("new", {"colour": 1}, "no option 'colour'; there are part, unit"),
    )
    for name, options, words in refused:
        with pytest.raises(InputError, match=words):
            vs.new_scene(folder / name, **options)
    assert {file: file.read_bytes() for file in folder.iterdir()} == before
    vs.new_scene(folder / "there", part=part, overwrite=True)
    assert (folder / "part.stl").read_bytes() == part.read_bytes()


def test_lasers_whose_light_meets_in_the_image_are_noted(tmp_path):
    """Rationale: `lines_by_source` then finds no centre; the pixels that are lit say so as well."""
    part = tmp_path / "plate.stl"
    trimesh.creation.box((60, 40, 8)).export(part)
    for offset_mm, meet in ((0.0, True), (2.4, True), (6.0, False)):
        options = {"tilt": (0, 15), "laser_offset_mm": (0, offset_mm), "film": "240x200"}
        made = write_scene(tmp_path / "two", NewScene(part=f"{part}", **options), overwrite=True)
        note = any("laser_1 and laser_2 lie within" in note for note in made.notes)
        one, other = expected_light(vs.load_scene(made.path)).values()
        assert note == meet == bool((one & other).any()), offset_mm


def test_a_part_that_is_installed_is_found_by_its_name_and_ones_own_comes_first(
    tmp_path, monkeypatch
):
    """Rationale: what the help shows can be typed in an empty folder."""
    monkeypatch.chdir(tmp_path)
    assert find_part("bracket.stl").parent.name == "meshes"
    (tmp_path / "bracket.stl").write_bytes(find_part("gear_blank.stl").read_bytes())
    assert find_part("bracket.stl") == Path("bracket.stl")
    assert find_part("no such.stl") == Path("no such.stl")


def test_a_projector_in_the_lasers_place_lights_what_the_camera_sees(tmp_path):
    """Of a part from a file and of a cylinder, with several cameras or projectors."""
    film = {"film": "128x107", "pixel_um": 66.0, "projector": True}
    cases: dict[str, dict] = {
        "bracket": {"part": "bracket.stl", "tilt": (-15.0,)},
        "cylinder": {"diameter_mm": 40, "alpha": (30.0, -30.0), "beta": 10},
        "two": {"part": "bracket.stl", "tilt": (-15.0, 15.0), "alpha": (40.0,)},
    }
    for name, options in cases.items():
        written = write_scene(tmp_path / name, NewScene(**options, **film))
        assert written.projects
        (asked,) = next_steps(written, NewScene(**options, **film))
        assert ("--camera camera_1" in asked) == (name == "cylinder")
        assert ("--source projector_1" in asked) == (name == "two")
        whole = vs.load_scene(written.path, spp=1).cold()
        assert len(whole.sources) == len(options.get("tilt", (0.0,)))
        for camera, source in itertools.product(whole.cameras, whole.sources):
            scene = whole.only(camera, source)
            assert vs.render_frame(scene).lit.mean() > 0.3
            # The middle of its image lies in the middle of the camera's.
            middle = vs.projector_pixels(scene, [[63.5, 53.0]]).projector_pixel
            assert np.abs(middle - [639.5, 399.5]).max() < 5.0
    with pytest.raises(InputError, match="--fan: of a laser line"):
        write_scene(tmp_path / "x", NewScene(projector=True, fan=3.0))


def test_a_camera_as_it_is_built_goes_into_the_scene_with_its_files(tmp_path, monkeypatch):
    """Its sensor's pixels are the film's, its calibration the camera's; both are copied."""
    monkeypatch.chdir(tmp_path)
    asked = {"f_number": 8, "sensor_tilt": "laser_plane", "sensor_model": "profile_sensor"}
    camera = vs.load_scene(vs.new_scene("shaft", exposure="2ms", **asked)).camera
    sensor = vs.image_sensor("profile_sensor")
    assert (camera.sensor, camera.pixel_um, camera.exposure_s) == (sensor, sensor.pixel_um, 0.002)
    assert camera.size == (sensor.width_px, sensor.height_px)
    assert camera.lens.f_number == pytest.approx(8.0)
    assert abs(camera.lens.sensor_tilt_deg[0]) > 1.0
    for folder in ("files", "scenes"):
        (tmp_path / folder).mkdir()
    sheet, cv = tmp_path / "files" / "mine.toml", tmp_path / "files" / "camera.json"
    sheet.write_text("pixel_um = 5.5\ngain = 0.3\n")
    numbers = {"data": [3000.0, 0, 255, 0, 3000.0, 250, 0, 0, 1]}
    cv.write_text(
        json.dumps(
            {
                "image_width": 512,
                "image_height": 500,
                "camera_matrix": numbers,
                "distortion_coefficients": [0.1, 0, 0, 0],
            }
        )
    )
    own = Path("scenes/mine.xml")
    written = write_scene(own, NewScene(calibration=f"{cv}", sensor_model=f"{sheet}"))
    assert {file.name for file in written.copied} == {"mine.toml", "camera.json"}
    sheet.unlink()
    cv.unlink()
    camera = vs.load_scene(own).camera
    assert camera.size == (512, 500)
    np.testing.assert_array_equal(camera.matrix.ravel(), numbers["data"])
    assert camera.distortion.tolist() == [0.1, 0.0, 0.0, 0.0]
    assert camera.sensor.gain == 0.3
    with pytest.raises(InputError, match="--calibration, --focal-length: give one of them"):
        write_scene(Path("no"), NewScene(calibration="no.json", focal_length_mm=35))
    with pytest.raises(InputError, match=r"--f-number 0\.01: give a number between"):
        write_scene(Path("no"), NewScene(f_number=0.01))
