"""Cameras as they are built, by scenes and by hand: lens, tilt, distortion, calibration, sensor."""

import pickle
import re
from dataclasses import replace

import cv2
import numpy as np
import pytest
from scipy.interpolate import CubicSpline

import virtual_sensor as vs
from virtual_sensor.devices.camera import LensCamera
from virtual_sensor.imaging.checks import check_scene
from virtual_sensor.imaging.scene_file import shipped_scenes
from virtual_sensor.optics.lens import Lens

SMALL = {"width": 256, "height": 192, "spp": 4}
THIN = '<sensor type="thinlens" id="camera">'
DISTORTION = "-3, 20, 0.004, 0.003, 0, 0.1, 0, 0"


def cold(**parameters):
    """The cold cylinder in small."""
    return vs.load_scene("cold_cylinder", **(SMALL | parameters))


def _row(line, column):
    """Rows of a line at columns, by a cubic spline through its centres."""
    ok = line.status == 0
    return CubicSpline(line.column[ok], line.row[ok])(column)


def test_a_lens_is_that_of_the_thin_lens_formula():
    """The paper's: b = 75 and g = 300 make F = 60; its numbers go with the parameters."""
    camera = cold(f_number=8, sub_pupils=4, exposure="2ms", sensor_model="cmos_5um5").camera
    lens = camera.lens
    assert (lens.image_distance_mm, lens.focus_distance_mm) == pytest.approx((75.0, 300.0))
    assert (lens.focal_length_mm, lens.f_number) == pytest.approx((60.0, 8.0))
    assert (camera.sub_pupils, camera.exposure_s) == (4, 0.002)
    assert camera.sensor == vs.image_sensor("cmos_5um5")
    assert camera.pixel_um == pytest.approx(11264.0 / 256)
    assert cold(f_number=0).camera == cold().camera
    near = cold(f_number=8, focus_distance=290).camera.lens
    assert 1.0 / near.focal_length_mm == pytest.approx(1.0 / 75.0 + 1.0 / 290.0)


def test_the_lasers_plane_is_in_focus_where_the_tilt_says_so():
    """Scheimpflug: tan phi' = m tan phi is 8.2 degrees; all points of the plane are sharp."""
    for beta in (0, 20):
        scene = cold(f_number=8, sensor_tilt="laser_plane", beta=beta)
        camera, lens = scene.camera, scene.camera.lens
        angle = np.degrees(np.arctan(0.25 * np.tan(np.radians(30.0))))
        np.testing.assert_allclose(np.abs(lens.sensor_tilt_deg), [angle, 0.0], atol=1e-3)
        np.testing.assert_allclose(np.degrees(camera.distortion[-2:]), lens.sensor_tilt_deg)
        s, t, depth = np.zeros(5), np.linspace(-10.0, 10.0, 5), np.linspace(250.0, 350.0, 5)
        x, y = scene.laser.family.place(s, t, depth)
        points = scene.laser.pose.to_world(np.column_stack([x, y, depth]))
        p, q, away = camera.coordinates(points).T
        np.testing.assert_allclose(lens.in_focus(p, q), 1.0 / away, rtol=1e-6)


def test_a_plane_that_leans_both_ways_is_focused_where_it_lies():
    """All of its points, the nearest and the farthest; the axis meets it at 280 mm."""
    camera = cold(f_number=8).camera
    normal = camera.pose.rotation @ [0.5, -0.7, 1.0]
    at = camera.pose.to_world([0.0, 0.0, 280.0])
    focused = camera.focused_on(normal, float(normal @ at))
    assert focused.lens.focus_distance_mm == pytest.approx(280.0)
    u, v = np.random.default_rng(0).uniform(-20.0, 20.0, (2, 20, 1))
    one, other = np.cross(normal, [1.0, 0.0, 0.0]), np.cross(normal, [0.0, 1.0, 0.0])
    p, q, away = camera.coordinates(at + u * one + v * other).T
    assert np.ptp(away) > 20.0
    np.testing.assert_allclose(focused.lens.in_focus(p, q), 1.0 / away, rtol=1e-9)


def test_tilt_and_distortion_are_opencvs():
    """Points are seen where OpenCV's own projection puts them, to 1e-6 px."""
    points = np.random.default_rng(0).uniform(-8.0, 8.0, (200, 3)) * [1.0, 1.0, 0.3]
    for given in ({"sensor_tilt": "8.2, -5"}, {"distortion": DISTORTION}):
        camera = cold(**given).camera
        turn = camera.pose.rotation.T
        where = cv2.Rodrigues(turn)[0], -turn @ camera.pose.origin_mm
        if "distortion" in given:
            bends = np.array([float(word) for word in DISTORTION.split(",")])
        else:
            bends = np.append(np.zeros(12), np.radians([8.2, -5.0]))
        seen = cv2.projectPoints(points, *where, camera.matrix, bends)[0][:, 0]
        assert np.abs(seen - cold().camera.project(points)).max() > 0.1
        np.testing.assert_allclose(camera.project(points), seen, atol=1e-6)
        np.testing.assert_allclose(vs.project(cold(**given), points), seen, atol=1e-6)


def test_a_rendered_line_is_where_the_search_has_it():
    """Through distortion and tilt, cold and in hot air, in a film whose rows are cropped too."""
    for given in ({"distortion": DISTORTION}, {"sensor_tilt": "laser_plane"}):
        hot = vs.load_scene("hot_cylinder", width=512, height=384, spp=9, line_radius=0.1, **given)
        for scene in (hot, hot.cold()):
            y = np.linspace(-8.0, 8.0, 33)
            line = vs.line_centres(vs.render(scene))
            found = vs.ray_search(scene, y, "newton").pixel
            row = _row(line, found[:, 0])
            assert np.sqrt(np.mean((row - found[:, 1]) ** 2)) < 0.003


def test_a_rendered_dot_is_where_opencv_has_it():
    """To 0.003 px, over the image."""
    scene = cold(width=1024, height=768, spp=16, distortion=DISTORTION, line_radius=0.06)
    scene = scene.with_parameters(dots="-9, -4, 0, 4, 9")
    camera = scene.camera
    points = vs.ray_search(scene, scene.laser.dots_mm).laser_point_mm
    turn = camera.pose.rotation.T
    where = cv2.Rodrigues(turn)[0], -turn @ camera.pose.origin_mm
    seen = cv2.projectPoints(points, *where, camera.matrix, camera.distortion)[0][:, 0]
    image = vs.render(scene).astype(float)
    v, u = np.mgrid[: image.shape[0], : image.shape[1]]
    for place in seen:
        near = np.hypot(u - place[0], v - place[1]) < 12.0
        light = image[near] / image[near].sum()
        assert np.abs([u[near] @ light, v[near] @ light] - place).max() < 0.003


def test_fringes_are_decoded_through_distortion_and_tilt():
    """To the projector pixels that the search finds, cold and in hot air."""
    size = {"width": 96, "height": 96, "spp": 4, "pixels": False}
    hot = vs.load_scene("fringe_cylinder", distortion="-2, 0, 0.01, 0.01", **size)
    tilted = vs.load_scene("fringe_cylinder", sensor_tilt="10, -6", **size)
    codec = vs.PhaseShift(axes="u", periods_px=(40.0, 160.0, 1280.0))
    for scene in (hot, hot.cold(), tilted):
        decoded = codec.decode(vs.render_sequence(scene, codec.patterns).radiance)
        rows, columns = np.mgrid[30:70:8, 30:70:8]
        pixel = np.stack([columns.ravel(), rows.ravel()], axis=-1)
        found = vs.projector_pixels(scene, pixel).projector_pixel[:, 0]
        apart = decoded.column[rows.ravel(), columns.ravel()] - found
        assert np.abs(apart).max() < 0.02


def test_a_calibration_is_the_cameras(tmp_path):
    """OpenCV's file with K and distortion; of another resolution it is refused, with both."""
    path = tmp_path / "camera.yaml"
    matrix = np.array([[1700.0, 0.0, 130.0], [0.0, 1690.0, 90.0], [0.0, 0.0, 1.0]])
    file = cv2.FileStorage(str(path), cv2.FILE_STORAGE_WRITE)
    for name, value in (("image_width", 256), ("image_height", 192), ("camera_matrix", matrix)):
        file.write(name, value)
    file.write("distortion_coefficients", np.array([[-0.5, 2.0, 1e-3, 2e-3, 0.0]]))
    file.release()
    scene = cold(calibration=path, f_number=8, line_radius=0.5)
    np.testing.assert_array_equal(scene.camera.matrix, matrix)
    np.testing.assert_allclose(scene.camera.pose.rotation, cold().camera.pose.rotation, atol=1e-6)
    assert scene.camera.distortion.tolist() == [-0.5, 2.0, 1e-3, 2e-3, 0.0]
    assert scene.camera.lens.image_distance_mm == pytest.approx(1700.0 * 0.044)
    y = np.linspace(-6.0, 6.0, 9)
    sharp = scene.with_camera(replace(scene.camera, lens=None))
    line, found = vs.line_centres(vs.render(sharp)), vs.ray_search(sharp, y).pixel
    np.testing.assert_allclose(_row(line, found[:, 0]), found[:, 1], atol=0.01)
    with pytest.raises(vs.InputError, match=r"camera.yaml: is of 256 x 192 px, .*has 128 x 192"):
        cold(calibration=path, width=128)
    with pytest.raises(vs.InputError, match=r"calibration=.* has it; give one of them"):
        cold(calibration=path, fov=5)
    with pytest.raises(vs.InputError, match="'calibration' and a 'distortion'"):
        cold(calibration=path, distortion=DISTORTION)
    with pytest.raises(vs.InputError, match=r"there is no file .none\.yaml. where"):
        cold(calibration="none.yaml")


def test_a_film_larger_than_its_sensor_is_noted():
    """A frame may be a part of a sensor, and no more."""
    assert cold(sensor_model="cmos_5um5").notes == ()
    (note,) = cold(sensor_model="profile_sensor", width=4096, spp=1).notes
    assert '<sensor id="camera">: its film is larger than its sensor, of' in note


def test_what_no_camera_can_be_is_refused_with_the_remedy():
    """One line that names the element."""
    for given, words in (
        ({"distortion": "-300, 0, 0, 0"}, "the distortion folds the image"),
        (
            {"distortion": "-300, 0, 0, 0", "sensor_tilt": "laser_plane"},
            "lens_camera: the distortion folds the image",  # not the tilt
        ),
        ({"distortion": "1, 2, 3"}, "give 4, 5, 8, 12 or 14 numbers"),
        ({"distortion": "a"}, "give 4, 5, 8, 12 or 14 numbers"),
        ({"f_number": -8}, "f_number is -8.0"),
        ({"f_number": "f/8"}, "'f_number' must be an f-number, such as 8"),
        ({"f_number": 8, "focus_distance": -1}, "'focus_distance' is -1"),
        ({"f_number": 8, "sub_pupils": 0}, "sub_pupils must be a whole number from 1"),
        ({"sub_pupils": 2.5}, "sub_pupils must be a whole number from 1"),
        ({"sub_pupils": "nan"}, "sub_pupils must be a whole number from 1"),
        ({"sensor_tilt": "steep"}, "give an angle about x in degrees"),
        ({"sensor_tilt": 89}, "the distortion folds|at most 80 degrees"),
        ({"sensor_tilt": 5, "distortion": f"{'0, ' * 13}0.1"}, "its distortion has one too"),
        ({"sensor_tilt": "laser_plane", "alpha": 0.01}, "holds the camera's axis"),
        ({"sensor_model": "cmos"}, "no such image sensor"),
        ({"exposure": "0"}, "'exposure' is '0'; give an exposure time"),
        ({"exposure": "-2ms"}, "give an exposure time"),
        ({"exposure": "soon"}, "give an exposure time"),
    ):
        with pytest.raises(vs.InputError, match=r'cold_cylinder.*type="?lens_camera|lens_camera'):
            cold(**given)
        with pytest.raises(vs.InputError, match=words):
            cold(**given)


def test_a_camera_is_exchanged_and_stays_so():
    """Its lens and distortion, in other poses and air too, and where the scene is unpickled."""
    scene = cold()
    lens = Lens.of_f_number(75.0, 300.0, 16.0)
    camera = replace(scene.camera, lens=lens, distortion=np.array([-3.0, 0.0, 0.0, 0.0]))
    other = scene.with_camera(camera)
    assert other.camera is camera
    assert other != scene
    assert scene.with_camera(scene.camera) == scene
    moved = other.with_sensor_moved(vs.Pose.shift([1.0, 0.0, 0.0]))
    assert moved.camera.lens == lens
    np.testing.assert_allclose(moved.camera.pose.origin_mm - camera.pose.origin_mm, [1, 0, 0])
    assert other.with_parameters(line_radius=0.3).camera == camera
    assert scene.with_parameters(f_number=8).camera.lens.f_number == pytest.approx(8.0)
    assert pickle.loads(pickle.dumps(other)).camera == camera
    assert pickle.loads(pickle.dumps(other)) == other
    image = vs.render(other.with_camera(replace(camera, lens=None)))
    straight = vs.render(scene)
    assert np.abs(image - straight).max() > 0.1 * straight.max()
    for wrong in (
        None,
        scene.camera.chief,
        camera.with_pose(vs.Pose.shift([1, 0, 0])),
        replace(camera, size=(128, 128)),
        replace(camera, distortion=np.array([-300.0, 0.0, 0.0, 0.0])),
    ):
        with pytest.raises(vs.InputError):
            scene.with_camera(wrong)
    with pytest.raises(vs.InputError, match="no camera 'x'"):
        scene.with_camera(camera, "x")


def test_a_line_out_of_focus_and_a_pupil_in_the_part_are_told():
    """The blur by hand: 2 r |1/g - 1/z| f at the sharpest place."""
    near = cold(f_number=8, focus_distance=200)
    (note,) = check_scene(near)
    lens, z = near.camera.lens, near.camera.pose.to_local([[0.0, 0.0, 0.0]])[0, 2]
    blur = 2.0 * lens.pupil_radius_mm * (1.0 / 200.0 - 1.0 / z) * near.camera.matrix[0, 0]
    assert f"is nowhere in focus: its blur is {blur:.2g}" in note
    assert check_scene(cold(f_number=8)) == []
    close = {"f_number": 0.5, "distance": 20, "focal_length": 20}
    with pytest.raises(vs.InputError, match=r"a shape reaches into the lens's pupil.*f_number"):
        cold(**close, alpha=80, tilt=0)
    scene = cold(**(close | {"f_number": 8}), alpha=80, tilt=0)
    wide = replace(scene.camera, lens=replace(scene.camera.lens, pupil_radius_mm=10.0))
    with pytest.raises(vs.InputError, match="a shape reaches into the lens's pupil"):
        scene.with_camera(wide)


def test_a_sensor_stays_tilted_where_the_laser_is_moved():
    """As one that was built so; other parameters count all the same, where it is unpickled too."""
    scene = cold(sensor_tilt="laser_plane", f_number=8)
    pose = scene.laser.pose.moved(vs.Pose.turn(2.0, [0.0, 1.0, 0.0]))
    moved = scene.with_pose("laser", pose)
    assert moved.camera == scene.camera
    for same in (moved, pickle.loads(pickle.dumps(moved))):
        again = same.with_parameters(f_number=4)
        assert again.camera.lens.f_number == pytest.approx(4.0)
        assert again.camera.lens.sensor_tilt_deg != scene.camera.lens.sensor_tilt_deg


def test_mitsubas_thinlens_is_a_camera_of_an_assumed_film(tmp_path):
    """Its pupil and its distance are the element's; a note says what is assumed."""
    text = (shipped_scenes() / "cold_cylinder.xml").read_text(encoding="utf-8")
    lens = '<float name="aperture_radius" value="3"/><float name="focus_distance" value="295"/>'
    text = re.sub(r'\s*<string name="(?!fov_axis)\w+" value="\$\w+"/>', "", text)
    path = tmp_path / "thin.xml"
    path.write_text(text.replace('<sensor type="lens_camera" id="camera">', f"{THIN}{lens}"))
    scene = vs.load_scene(path, **SMALL)
    camera = scene.camera
    assert (camera.lens.pupil_radius_mm, camera.lens.focus_distance_mm) == (3.0, 295.0)
    np.testing.assert_array_equal(camera.matrix, cold().camera.matrix)
    assert camera.lens.image_distance_mm == pytest.approx(36.0 / 256 * camera.matrix[0, 0])
    (note,) = scene.notes
    assert "a thinlens has no film in mm; one 36 mm wide is assumed" in note


def test_by_hand_its_numbers_are_checked():
    """Those that a pinhole has not."""
    chief = cold().camera.chief
    for name, value in (
        ("sub_pupils", 0),
        ("sub_pupils", 2.0),
        ("pixel_um", 0.0),
        ("exposure_s", -1.0),
        ("exposure_s", np.nan),
        ("transmission", 1.5),
    ):
        with pytest.raises(vs.InputError, match=f"LensCamera: {name}"):
            LensCamera.of(chief, **{name: value})
