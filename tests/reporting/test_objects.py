"""Objects drawn, shown in notebooks and saved, read back by other programs' readers."""

import json
import re

import cv2
import numpy as np
import pytest
import tifffile
import trimesh
from artificial import line_image
from matplotlib.backends.backend_agg import FigureCanvasAgg
from matplotlib.colors import to_rgba
from matplotlib.figure import Figure
from matplotlib.patches import PathPatch

import virtual_sensor as vs
from virtual_sensor.display import LONGEST_LINE
from virtual_sensor.errors import InputError
from virtual_sensor.imaging.image_files import Image
from virtual_sensor.imaging.parts import Part
from virtual_sensor.imaging.scene_file import shipped_scenes
from virtual_sensor.metrology.calibration import calibration_of, read_calibration
from virtual_sensor.metrology.cylinder_fit import fit_cylinder
from virtual_sensor.metrology.dot_peaks import DotCentres
from virtual_sensor.metrology.triangulation import triangulated_points
from virtual_sensor.optics.lens import Lens
from virtual_sensor.optics.surfaces import SceneSurface
from virtual_sensor.reporting.objects import _silhouette, drawing_of
from virtual_sensor.reporting.style import colour
from virtual_sensor.studies.measure import SearchedRays
from virtual_sensor.studies.search import SearchTable

POINTS = np.array([[0.0, -1.0, 2.0], [np.nan] * 3, [3.0, 4.0, -5.0]])


@pytest.fixture(scope="module")
def made():
    """What a user meets in a first hour, by name; a small film."""
    scene = vs.load_scene("hot_cylinder", width=128, height=128, spp=1, line_radius=1)
    frame = vs.render_frame(scene)
    line = vs.line_centres(frame.radiance)
    starts, down = [[0.0, y, 200.0] for y in (-5.0, 0.0, 5.0)], [[0.0, 0.0, -1.0]] * 3
    corners = np.array([[0.0, 0, 0], [1, 0, 0], [0, 1, 0], [0, 0, 1]])
    points = triangulated_points(scene, line.pixel)
    return {
        "scene": scene,
        "frame": frame,
        "truth": frame.truth,
        "shot": vs.record(scene, frame, peak=2.0),
        "line": line,
        "points": points,
        "found": vs.ray_search(scene, [0.0, 5.0, 300.0], "newton"),
        "sensor": scene.sensor,
        "camera": scene.camera,
        "laser": scene.source,
        "sheet": scene.source.family,
        "pose": scene.camera.pose,
        "field": scene.medium,
        "rays": vs.trace(scene.medium, starts, down, 300.0),
        "lens": Lens.of_f_number(75.0, 300.0, 8.0),
        "noise": vs.ImageSensor(),
        "calibration": calibration_of(scene.sensor),
        "fit": fit_cylinder(points.point_mm, direction=[1.0, 0.0, 0.0]),
        "no fit": fit_cylinder(np.zeros((2, 3))),
        "no dots": DotCentres(np.zeros((0, 2)), np.zeros(0), np.zeros(0, np.uint8)),
        "part": Part(corners, np.array([[0, 2, 1], [0, 1, 3], [0, 3, 2], [1, 2, 3]])),
    }


def test_all_are_shown_drawn_and_described(made):
    for name, thing in made.items():
        assert len(repr(thing)) <= LONGEST_LINE, name
        assert "\n" not in repr(thing), name
        html = thing._repr_html_()
        assert "<table" in html, name
        assert len(html) < 200_000, name
        assert ("<img" in html) == (drawing_of(thing) is not None), name
        axes = thing.plot(Figure().add_subplot())
        assert axes.lines or axes.collections or axes.images or axes.patches, name
        assert thing.to_dataframe().columns.is_unique, name


def test_what_is_clipped_in_a_recorded_frame_is_seen_in_its_picture(made):
    """By the grey values alone; of a sequence, and of light without its truth, all is shown."""
    shot, scene = made["shot"], made["scene"]
    axes = shot.plot(Figure().add_subplot())
    v, u = np.nonzero(shot.grey >= shot.grey.max())
    assert len(u) > 10
    assert set(map(tuple, axes.lines[0].get_xydata())) == set(zip(u, v, strict=True))
    light = made["frame"].radiance
    left, right, bottom, top = (
        vs.record(scene, light).plot(Figure().add_subplot()).images[0].get_extent()
    )
    assert (left, right, top, bottom) == (-0.5, 127.5, -0.5, 127.5)
    assert vs.record(scene, np.stack([light, light])).plot(Figure().add_subplot()).images


def test_rays_are_drawn_from_where_they_started(made):
    """Rationale: two rays of 200 mm, 5 mm apart, were shown as stubs of 2.6 mm."""
    start = made["rays"].plot(Figure().add_subplot()).lines[0].get_xydata()[0]
    assert start == pytest.approx([-5.0, 200.0], abs=1.0)


def test_what_can_not_be_shown_is_told_with_its_article(made):
    """Rationale: "a IndexField", and an empty table, without a word."""
    with pytest.raises(InputError, match=r"\.xlsx: an IndexField is written as"):
        made["field"].save("field.xlsx")
    with pytest.raises(InputError, match="a SceneSurface has no table"):
        SceneSurface(None).to_dataframe()
    twenty, ninety = (vs.Pose.turn(angle, (0, 0, 1)) for angle in (20.0, 90.0))
    assert repr(twenty) != repr(ninety)


def test_a_line_of_one_pixel_is_seen_in_the_picture_of_a_large_image():
    image = np.zeros((3000, 6000), np.float32)
    image[1234] = 1.0
    drawn = Image(image, None).plot(Figure().add_subplot()).images[0]
    assert max(drawn.get_array().shape) <= 600
    left, _, bottom, top = drawn.get_extent()
    row = np.argmax(drawn.get_array().max(axis=1))
    assert (left, top) == (-0.5, -0.5)
    high = (bottom - top) / drawn.get_array().shape[0]
    assert top + row * high <= 1234 < top + (row + 1) * high
    assert drawn.get_array()[row].min() == 1.0


def test_points_and_parts_are_read_by_trimesh(made, tmp_path):
    found = made["points"]
    cloud = trimesh.load(found.save(tmp_path / "points.ply"))
    known = np.isfinite(found.point_mm).all(axis=1)
    np.testing.assert_allclose(cloud.vertices, found.point_mm[known], atol=1e-5)
    for suffix in (".ply", ".stl", ".obj"):
        part = trimesh.load(made["part"].save(tmp_path / f"part{suffix}"))
        assert part.is_watertight, suffix
        assert part.volume == pytest.approx(1.0 / 6.0), suffix


def test_a_frame_is_an_image_or_all_its_layers(made, tmp_path):
    import OpenEXR

    frame = made["frame"]
    np.testing.assert_array_equal(
        tifffile.imread(frame.save(tmp_path / "frame.tif")), frame.radiance
    )
    grey = cv2.imread(str(frame.save(tmp_path / "frame.png")), cv2.IMREAD_UNCHANGED)
    assert grey.dtype == np.uint16
    assert np.corrcoef(grey.ravel(), frame.radiance.ravel())[0, 1] > 0.999999
    layers = OpenEXR.File(str(frame.save(tmp_path / "frame.exr")), separate_channels=True)
    np.testing.assert_array_equal(layers.channels()["depth.Z"].pixels, frame.depth_mm)
    rows = frame.to_dataframe()
    lit = rows[rows["laser_status"] == "lit"]
    row, column = int(lit["row"].iloc[0]), int(lit["column"].iloc[0])
    assert frame.radiance[row, column] == lit["radiance"].iloc[0]


def test_fields_and_calibrations_are_read_back(made, tmp_path):
    field = vs.IndexField.from_arrays(
        1e-4 * np.random.default_rng(0).random((4, 5, 6)),
        [0, 0, 0],
        [1, 2, 3],
        ambient=0.0,
        mirror=(1, 0, 0),
    )
    again = vs.IndexField.read(field.save(tmp_path / "field.nc"))
    np.testing.assert_allclose(again.nodes, field.nodes, rtol=1e-6)
    rows = field.to_dataframe()
    at = rows[(rows.point_mm_x == 1) & (rows.point_mm_y == 4) & (rows.point_mm_z == 9)]
    assert at.refractivity.tolist() == [field.nodes[1, 2, 3]]
    for suffix in (".yaml", ".xml", ".json"):
        read = read_calibration(made["calibration"].save(tmp_path / f"sensor{suffix}"))
        assert read.triangulation_angle_deg == pytest.approx(60.0), suffix


def test_json_holds_a_scene_with_a_line_of_its_air_and_no_image(made, tmp_path):
    said = json.loads(made["scene"].save(tmp_path / "scene.json").read_text())
    assert said["parameters"]["width"] == "128"
    assert said["cameras"]["camera"]["size"] == [128, 128]
    assert said["medium"] == repr(made["field"])
    big = vs.IndexField.from_arrays(np.zeros((200, 100, 60)), [0, 0, 0], [1, 1, 1])
    with pytest.raises(InputError, match=r"air\.json: .*too large for JSON; write \.npz"):
        big.save(tmp_path / "air.json")
    assert not (tmp_path / "air.json").exists()


def test_the_noise_that_is_drawn_is_the_noise_of_recorded_frames(made):
    camera = vs.ImageSensor(prnu=0.0, dsnu_e=0.0)
    axes = camera.plot(Figure().add_subplot())
    signal, noise = axes.lines[0].get_data()
    rng = np.random.default_rng(1)
    for electrons in (10.0, 1000.0):
        photons = np.full((300, 300), electrons / camera.quantum_efficiency)
        grey = vs.grey_values(photons, camera, rng)
        measured = grey.std() / camera.gain
        assert np.interp(electrons, signal, noise) == pytest.approx(measured, rel=0.02)


def test_beyond_a_knee_the_noise_that_is_drawn_is_that_of_the_light():
    """From frames alone: the spread of the grey values over the slope of their mean."""
    sensor = vs.ImageSensor(knee=(0.6, 6.0), prnu=0.01, dsnu_e=0.0, bit_depth=16)
    signal, noise = sensor.plot(Figure().add_subplot()).lines[0].get_data()
    assert signal[-1] == pytest.approx(6.0 * sensor.full_well_e)
    for electrons in (3000.0, 20_000.0, 50_000.0):
        grey = [
            vs.grey_values(np.full((300, 300), e / sensor.quantum_efficiency), sensor, 1)
            for e in (0.97 * electrons, electrons, 1.03 * electrons)
        ]
        slope = (grey[2].mean() - grey[0].mean()) / (0.06 * electrons)
        measured = grey[1].std() / slope
        assert np.interp(electrons, signal, noise) == pytest.approx(measured, rel=0.02)


def test_what_cannot_be_drawn_or_saved_is_told(made, tmp_path):
    with pytest.raises(InputError, match=r"a March has no picture; to_dataframe\(\)"):
        made["scene"].transport.march.plot()
    with pytest.raises(InputError, match=r"a Frame is written as \.csv, \.exr, .*\.tif or \.tiff"):
        made["frame"].save(tmp_path / "frame.xlsx")
    with pytest.raises(InputError, match="written as"):
        made["frame"].save(tmp_path / "frame")


def test_a_table_is_drawn_as_its_first_measured_column_over_its_first(made):
    table = SearchedRays(
        y_mm=np.arange(3.0), incidence_mm={"hot": POINTS}, pixel={"hot": POINTS[:, :2]}, status={}
    )
    axes = table.plot(Figure().add_subplot())
    assert [line.get_label()[-1] for line in axes.lines] == ["x", "y", "z"]
    np.testing.assert_array_equal(axes.lines[2].get_ydata(), POINTS[:, 2])
    assert axes.get_xlabel() == "y_mm"
    found = SearchTable(*[np.zeros(3)] * 6, status=np.array(["found", "unlit", "found"]))
    assert "2 found, 1 unlit" in found._repr_html_()


def test_a_lens_is_drawn_by_scheimpflugs_rule():
    """Sensor, lens and what is in focus meet in a line, and each point's light in its image."""
    axes = Lens.of_f_number(75.0, 300.0, 8.0, (8.2, 0.0)).plot(Figure().add_subplot())
    lines = [line.get_xydata() for line in axes.lines]
    (sharp, sensor) = (each for each in lines if len(each) == 3 and np.ptp(each[:, 0]) < 50.0)
    meet = []
    for (x, y), (x_end, y_end) in (sharp[[0, -1]], sensor[[0, -1]]):
        meet.append(y - x * (y_end - y) / (x_end - x))  # in the lens's plane, x = 0
    assert meet[0] == pytest.approx(meet[1], rel=1e-9)
    angle = [np.degrees(np.arctan2(*np.abs(np.ptp(each, axis=0)))) for each in (sensor, sharp)]
    assert angle[0] == pytest.approx(8.2)
    assert np.tan(np.radians(angle[0])) == pytest.approx(0.25 * np.tan(np.radians(angle[1])))


def test_what_a_cameras_lens_has_in_focus_is_drawn():
    """By a tilted sensor it is the laser's plane, which is seen edge-on; a pinhole has none."""
    lens = {"f_number": 8, "sensor_tilt": "laser_plane"}
    tilted, pinhole = (
        vs.load_scene("cold_cylinder", width=64, height=64, **built) for built in (lens, {})
    )
    normal, offset = tilted.laser.plane
    for drawn in (tilted, tilted.camera):
        axes = drawn.plot(Figure().add_subplot())
        (sharp,) = (each for each in axes.patches if each.get_label() == "in focus")
        np.testing.assert_allclose(sharp.get_xy() @ normal[[0, 2]], offset, atol=1e-3)
        assert np.ptp(sharp.get_xy(), axis=0).max() > 10.0
    assert not any(
        p.get_label() == "in focus" for p in pinhole.plot(Figure().add_subplot()).patches
    )


def test_a_ball_is_drawn_round(tmp_path):
    cold = (shipped_scenes() / "cold_cylinder.xml").read_text(encoding="utf-8")
    ball = (
        '<shape type="sphere"><point name="center" x="5" y="0" z="-20"/>'
        '<float name="radius" value="20"/><bsdf type="diffuse"/></shape>'
    )
    path = tmp_path / "ball.xml"
    path.write_text(re.sub("<shape.*</shape>", ball, cold, flags=re.DOTALL), encoding="utf-8")
    axes = vs.load_scene(path, width=64, height=64).plot(Figure().add_subplot())
    (outline,) = next(c for c in axes.collections if c.get_paths()).get_paths()
    distance = np.linalg.norm(outline.vertices - [5.0, -20.0], axis=1)
    assert len(distance) > 20
    np.testing.assert_allclose(distance, 20.0, atol=0.01)


def test_of_a_part_its_faces_are_drawn_that_look_at_the_viewer():
    """Seen from above, the upper side of a plate hides the lower one."""
    square, up_mm = np.array([[0.0, 0, 0], [1, 0, 0], [1, 1, 0], [0, 1, 0]]), np.array([0, 0, 1])
    corners, up = np.concatenate([square + up_mm, square]), np.array([[0, 1, 2], [0, 2, 3]])
    plate = Part(corners, np.concatenate([up, 4 + up[:, ::-1]]))
    (drawn,) = plate.plot(Figure().add_subplot()).collections
    (alone,) = Part(corners[:4], up).plot(Figure().add_subplot()).collections
    ends = [np.concatenate([path.vertices for path in c.get_paths()]) for c in (drawn, alone)]
    np.testing.assert_allclose(ends[0].max(axis=0), ends[1].max(axis=0))
    np.testing.assert_allclose(ends[0].min(axis=0), ends[1].min(axis=0))


def test_a_fine_mesh_is_drawn_whole_with_its_bore():
    """Rationale: of 309,440 triangles some were left out, and a plate looked like a comb."""
    x, y = np.meshgrid(np.arange(100.0), np.arange(60.0), indexing="ij")
    low = np.stack([x, y], -1)[:-1, :-1].reshape(-1, 1, 2)
    halves = [[[0, 0], [1, 0], [1, 1]], [[0, 0], [1, 1], [0, 1]]]
    triangles = np.concatenate([low + np.array(half) for half in halves])
    bored = triangles[np.linalg.norm(triangles.mean(axis=1) - [50.0, 30.0], axis=1) > 10.0]
    axes = Figure(dpi=100).add_subplot()
    canvas = FigureCanvasAgg(axes.figure)
    axes.add_patch(PathPatch(_silhouette(bored), fc="k", ec="k"))
    axes.set(xlim=(0, 99), ylim=(0, 59))
    axes.set_position((0.0, 0.0, 1.0, 1.0))
    axes.set_axis_off()
    axes.figure.set_size_inches(0.99, 0.59)
    canvas.draw()
    black = np.asarray(canvas.buffer_rgba())[..., 0] < 128
    away = np.hypot(*(np.indices(black.shape) - np.array([[[29.0]], [[49.5]]])))
    assert black[away > 13.0].all()
    assert not black[away < 7.0].any()


def test_a_projector_is_drawn_with_all_its_light_and_patterns_as_they_are_thrown():
    scene = vs.load_scene("fringe_cylinder", width=64, height=64, pattern="sine v 100 0")
    for thing in (scene, scene.projector):
        axes = thing.plot(Figure().add_subplot())
        paint = to_rgba(colour("laser"))
        (light,) = (p.get_xy() for p in axes.patches if p.get_edgecolor() == paint)
        # 60 mm along the world's x, seen at 30 degrees.
        low = light[light[:, 1] < 100.0]
        assert np.linalg.norm(np.ptp(low, axis=0)) == pytest.approx(60.0, rel=0.02)
    drawn = scene.projector.pattern.plot(Figure().add_subplot()).images[0]
    assert drawn.get_array().shape == (800, 1280)
    assert drawn.get_extent() == [-0.5, 1279.5, 799.5, -0.5]
    assert drawn.get_array()[49].max() < 0.01  # half a period from the upper border


def test_a_camera_with_its_projector_is_drawn_where_both_look_and_written_as_its_file(tmp_path):
    scene = vs.load_scene("fringe_cylinder", width=64, height=64)
    both = vs.FringeCalibration(scene.camera, scene.projector.family, np.zeros((0, 0)))
    axes = both.plot(Figure().add_subplot())
    assert {"camera", "projector"} <= {text.get_text() for text in axes.texts}
    far = [p.get_xy() for p in axes.patches]
    assert min(xy[:, 1].min() for xy in far) == pytest.approx(-15.0, abs=5.0)  # at the part
    again = vs.FringeCalibration.read(both.save(tmp_path / "system.yaml"))
    np.testing.assert_allclose(again.projector.matrix, scene.projector.family.matrix)


def test_a_sequence_is_drawn_frame_by_frame_and_points_as_a_map():
    scene = vs.load_scene("fringe_cylinder", width=64, height=64, spp=1, pixels=False)
    codec = vs.PhaseShift(periods_px=(64, 1280))
    frames = vs.render_sequence(scene, codec.patterns)
    axes = frames.plot(Figure().add_subplot())
    names = [text.get_text() for text in axes.texts]
    assert len(names) == 16
    assert names[1] == "sine u 64 1.57"
    found = vs.reconstruct(scene, codec.decode(frames.radiance))
    for thing in (codec.decode(frames.radiance), found):
        axes = thing.plot(Figure().add_subplot())
        assert len(axes.figure.axes) == 2  # with a bar
        left, _, bottom, top = axes.images[0].get_extent()
        assert (left + 0.5) % 1.0 == (top + 0.5) % 1.0 == 0.0
        assert bottom > top


def test_ghosts_of_a_line_are_drawn_where_they_are():
    """Beside the line, not only as marks at the edge of the picture."""
    image = line_image(np.full(40, 20.0), 2.0, 100.0) + line_image(np.full(40, 45.0), 2.0, 40.0)
    line = vs.line_centres(image, peaks=2)
    assert np.all(line.status[1] == vs.Status.GHOST)
    drawn = [curve.get_ydata() for curve in line.plot().lines]
    assert any(len(rows) == 40 and np.allclose(rows, 45.0, atol=0.05) for rows in drawn)
