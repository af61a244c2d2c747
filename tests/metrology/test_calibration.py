"""Calibration files: what OpenCV writes is read, what is no calibration is refused in words."""

import json
import subprocess
import sys
from dataclasses import replace
from typing import Any

import cv2
import numpy as np
import pytest
import yaml
from artificial import paper_sensor

from virtual_sensor.errors import InputError
from virtual_sensor.metrology.calibration import (
    calibration_of,
    calibration_text,
    read_calibration,
)
from virtual_sensor.metrology.triangulation import triangulate

GOOD: dict[str, Any] = {
    "image_width": 2048,
    "image_height": 1536,
    "camera_matrix": np.array([[5000.0, 0, 1023.5], [0, 5000.0, 767.5], [0, 0, 1]]),
    "distortion_coefficients": np.array([[-0.1, 0.2, 1e-3, -1e-3, 0.05]]),
    "rotation": np.array([[0.1], [0.4], [-0.2]]),
    "translation": np.array([[10.0], [-20.0], [300.0]]),
    "laser_plane": np.array([[0.0, 0.0, 2.0, 20.0]]),
}


def written(path, **changed):
    """The good calibration, by OpenCV itself, with some elements changed or left out."""
    storage = cv2.FileStorage(str(path), cv2.FILE_STORAGE_WRITE)
    for name, value in (GOOD | changed).items():
        if value is not None:
            storage.write(name, value)
    storage.release()
    return path


@pytest.mark.parametrize("ending", ["yaml", "yml", "xml", "json"])
def test_opencvs_own_files_are_read(tmp_path, ending):
    """A point of the laser plane, projected by OpenCV, comes back through the file."""
    calibration = read_calibration(written(tmp_path / f"sensor.{ending}"))
    rng = np.random.default_rng(0)
    points = np.column_stack([rng.uniform(-15.0, 15.0, (20, 2)), np.full(20, 10.0)])
    names = ("rotation", "translation", "camera_matrix", "distortion_coefficients")
    pixel = cv2.projectPoints(points, *(GOOD[name] for name in names))[0][:, 0]
    np.testing.assert_allclose(triangulate(calibration, pixel), points, atol=1e-8)
    assert calibration.camera.size == (2048, 1536)


@pytest.mark.parametrize("ending", ["yaml", "xml", "json"])
def test_a_simulated_sensor_goes_through_a_file(tmp_path, ending):
    """What `measure` writes beside its frames measures as the scene itself does."""
    sensor = paper_sensor()
    path = tmp_path / f"sensor.{ending}"
    path.write_text(calibration_text(calibration_of(sensor), path.name), encoding="utf-8")
    pixel = np.random.default_rng(1).uniform(900.0, 1100.0, (30, 2))
    read = read_calibration(path)
    np.testing.assert_allclose(triangulate(read, pixel), triangulate(sensor, pixel), atol=1e-9)
    assert read.notes == ()


def test_what_may_be_left_out_has_its_natural_value(tmp_path):
    """Without a pose the world is the camera's; without coefficients it is a pinhole."""
    path = written(
        tmp_path / "c.yaml",
        rotation=None,
        translation=None,
        distortion_coefficients=None,
        laser_plane=np.array([0.6, 0.0, 0.8, 240.0]),
    )
    calibration = read_calibration(path)
    point = triangulate(calibration, [[1023.5, 767.5]])
    np.testing.assert_allclose(point, [[0.0, 0.0, 300.0]], atol=1e-9)
    lens, pose = calibration.notes
    assert lens == f"{path}: has no 'distortion_coefficients': the lens is taken as ideal."
    assert pose == f"{path}: has no 'rotation' and 'translation': the world is the camera's."


@pytest.mark.parametrize(
    ("changed", "says"),
    [
        ({"camera_matrix": None}, "lacks 'camera_matrix'"),
        ({"camera_matrix": np.eye(2)}, "'camera_matrix' must hold 9 finite numbers"),
        ({"rotation": np.diag([1e308, 1.0, 1.0])}, "'rotation' must hold 3 or 9 finite .* 1e\\+12"),
        ({"camera_matrix": np.full((3, 3), np.nan)}, "'camera_matrix' must hold 9 finite"),
        ({"camera_matrix": np.zeros((3, 3))}, "positive f"),
        ({"distortion_coefficients": np.zeros((1, 3))}, "0 or 4 or 5 or 8 or 12 or 14"),
        ({"rotation": 2.0 * np.eye(3)}, "no rotation"),
        ({"rotation": -np.eye(3)}, "reflection"),
        ({"translation": "far"}, "'translation' must hold 3"),
        ({"image_width": 0}, "'image_width' is 0; give a whole number of px, from 1"),
        ({"image_width": 20.5}, "whole number"),
        ({"image_height": 1e300}, "whole number"),
        ({"image_height": "many"}, "'image_height' must hold 1 finite"),
        ({"camera_matrix": GOOD["camera_matrix"] + 3.0 * np.eye(3, k=1)}, "no skew"),
        ({"laser_plane": np.zeros(4)}, "no normal"),
        ({"laser_plane": None}, "lacks 'laser_plane'"),
        ({"laser_plane": np.array([0.0, 0.0, 1.0, -276.0]), "rotation": np.eye(3)}, None),
        (
            {
                "rotation": np.eye(3),
                "translation": np.zeros(3),
                "laser_plane": np.array([1.0, 0.0, 0.0, 0.0]),
            },
            "projection centre lies 0 mm from the laser plane",
        ),
        (
            {
                "rotation": None,
                "translation": None,
                "laser_plane": np.array([1.0, 0.0, 0.0, 1e-12]),
            },
            "projection centre lies 1e-12 mm from the laser plane",
        ),
    ],
)
def test_what_is_no_calibration_is_refused(tmp_path, changed, says):
    """The message names the file, the element and what it should be."""
    path = written(tmp_path / "sensor.yaml", **changed)
    if says is None:
        read_calibration(path)
        return
    with pytest.raises(InputError, match=says) as told:
        read_calibration(path)
    assert str(path) in str(told.value)


def test_a_rotation_of_few_digits_is_taken_as_the_nearest_one(tmp_path):
    """What is triangulated must project to where it was seen, whatever a file was rounded to."""
    rounded = np.round(cv2.Rodrigues(GOOD["rotation"])[0], 5)
    sensor = read_calibration(written(tmp_path / "sensor.yaml", rotation=rounded))
    pixel = np.array([[100.0, 200.0], [1000.0, 700.0], [1900.0, 1400.0]])
    back = sensor.camera.project(triangulate(sensor, pixel))
    np.testing.assert_allclose(back, pixel, atol=1e-9)


def test_a_matrix_that_lacks_its_columns_does_not_end_the_process(tmp_path):
    """OpenCV 5.0's own `mat()` writes past its memory there: in a process of its own, many times.

    Its numbers are all there, so they are read; what counts is that the process lives.
    """
    paths = [
        written(tmp_path / f"sensor.{ending}", rotation=np.eye(3))
        for ending in ("yaml", "xml", "json")
    ]
    for path in paths:
        text = path.read_text(encoding="utf-8")
        assert text.count("cols") >= 2
        path.write_text(text.replace("cols", "kols"), encoding="utf-8")
    code = (
        "import sys, pathlib\n"
        "from virtual_sensor.metrology.calibration import read_calibration\n"
        "for path in 100 * sys.argv[1:]: read_calibration(pathlib.Path(path))\n"
    )
    ended = subprocess.run([sys.executable, "-c", code, *paths], capture_output=True, text=True)
    assert (ended.returncode, ended.stderr) == (0, "")


FISHEYE = np.array([0.05, -0.02, 0.01, -0.003])
TURN = cv2.Rodrigues(GOOD["rotation"])[0]


def plane_points(angle_deg, count=200):
    """Points of the plane z = 10 that the camera of GOOD sees, up to an angle to its axis."""
    rng = np.random.default_rng(4)
    theta = np.radians(angle_deg) * np.sqrt(rng.random(count))
    phi = rng.uniform(0.0, 2.0 * np.pi, count)
    local = np.stack(
        [np.sin(theta) * np.cos(phi), np.sin(theta) * np.sin(phi), np.cos(theta)], axis=-1
    )
    start, direction = -TURN.T @ GOOD["translation"].ravel(), local @ TURN
    distance = (10.0 - start[2]) / direction[:, 2]
    return (start + distance[:, None] * direction)[(distance > 0.0) & (distance < 1e5)]


@pytest.mark.parametrize(
    "said", [{"fisheye_model": 1}, {"distortion_model": "equidistant"}, {"fisheye_model": "1"}]
)
def test_a_fisheye_is_read_as_one(tmp_path, said):
    """OpenCV's flag and ROS's word: points that cv2.fisheye projects come back, up to 80 degrees.

    As a radial-tangential model the same file gives points that are millimetres off.
    """
    matrix = GOOD["camera_matrix"] * [[0.1, 1, 1], [1, 0.1, 1], [1, 1, 1]]
    changed = {"camera_matrix": matrix, "distortion_coefficients": FISHEYE}
    points = plane_points(80.0)
    assert len(points) > 100
    projected = cv2.fisheye.projectPoints(
        points[:, None], GOOD["rotation"], GOOD["translation"], matrix, FISHEYE
    )[0][:, 0]
    calibration = read_calibration(written(tmp_path / "c.yaml", **changed, **said))
    distance = np.linalg.norm(points, axis=-1, keepdims=True)
    np.testing.assert_allclose(
        (triangulate(calibration, projected) - points) / distance, 0, atol=1e-9
    )
    np.testing.assert_allclose(calibration.camera.project(points), projected, atol=1e-9)
    flat = read_calibration(written(tmp_path / "d.yaml", **changed))
    near = points[np.linalg.norm(points[:, :2], axis=-1) < 200.0]
    there = cv2.fisheye.projectPoints(
        near[:, None], GOOD["rotation"], GOOD["translation"], matrix, FISHEYE
    )[0][:, 0]
    assert np.nanmax(np.abs(triangulate(flat, there) - near)) > 1.0
    path = tmp_path / "again.json"
    path.write_text(calibration_text(calibration, path.name))
    np.testing.assert_allclose(
        triangulate(read_calibration(path), projected), triangulate(calibration, projected)
    )


def test_what_a_fisheye_sees_beside_the_half_space_has_no_point(tmp_path):
    """By r = f theta a pixel of 91 degrees is none of an ideal pinhole; one of 85 degrees is."""
    matrix = np.array([[300.0, 0, 1023.5], [0, 300.0, 767.5], [0, 0, 1]])
    changed = {"camera_matrix": matrix, "distortion_coefficients": np.zeros(4), "fisheye_model": 1}
    camera = read_calibration(written(tmp_path / "c.yaml", **changed)).camera
    angles = np.radians([85.0, -85.0, 91.0, 120.0])
    pixel = np.column_stack([1023.5 + 300.0 * angles, np.full(4, 767.5)])
    expected = TURN.T @ np.array([np.sin(angles), 0 * angles, np.cos(angles)])
    sight = camera.lines_of_sight(pixel)
    np.testing.assert_allclose(sight[:2], expected.T[:2], atol=1e-9)
    assert np.isnan(sight[2:]).all()


@pytest.mark.parametrize(
    ("model", "count"), [("plumb_bob", 5), ("rational_polynomial", 8), ("radtan", 4), ("", 12)]
)
def test_ros_files_and_other_names_are_read_and_noted(tmp_path, model, count):
    """ROS's plain lists under `data`, others' names: the point is OpenCV's by the same numbers."""
    rng = np.random.default_rng(6)
    bends = rng.uniform(-0.05, 0.05, count)
    matrix, rotation = GOOD["camera_matrix"].ravel().tolist(), TURN.ravel().tolist()
    text = (
        "image_width: 2048\nimage_height: 1536\ncamera_name: head\n"
        f"camera_matrix:\n  rows: 3\n  cols: 3\n  data: {matrix}\n"
        + (f"distortion_model: {model}\n" if model else "")
        + f"dist_coeffs: {bends.tolist()}\nR: {rotation}\ntvec: [10.0, -20.0, 300.0]\n"
        "rectification_matrix: [1, 0, 0, 0, 1, 0, 0, 0, 1]\nlaser_plane: [0.0, 0.0, 2.0, 20.0]\n"
    )
    path = tmp_path / "ros.yaml"
    path.write_text(text)
    calibration = read_calibration(path)
    points = plane_points(8.0)
    pixel = cv2.projectPoints(points, TURN, GOOD["translation"], GOOD["camera_matrix"], bends)[0]
    np.testing.assert_allclose(triangulate(calibration, pixel[:, 0]), points, atol=1e-8)
    assert calibration.notes == (
        f"{path}: 'dist_coeffs' is taken as 'distortion_coefficients'.",
        f"{path}: 'R' is taken as 'rotation'.",
        f"{path}: 'tvec' is taken as 'translation'.",
        f"{path}: not used: 'camera_name', 'rectification_matrix'.",
    )


@pytest.mark.parametrize("ending", ["yaml", "json"])
def test_lists_within_lists_are_matrices(tmp_path, ending):
    """As json.dumps writes an array's tolist()."""
    values = {name: np.asarray(value).tolist() for name, value in GOOD.items()}
    values["rotation"] = TURN.tolist()
    path = tmp_path / f"c.{ending}"
    path.write_text(json.dumps(values))
    points = plane_points(8.0)
    names = ("rotation", "translation", "camera_matrix", "distortion_coefficients")
    pixel = cv2.projectPoints(points, *(GOOD[name] for name in names))[0][:, 0]
    np.testing.assert_allclose(triangulate(read_calibration(path), pixel), points, atol=1e-8)
    for ragged in ([[1, 2], [3]], [[1, 2, 3], "no"], [], {"data": [[]]}, {"rows": 3}):
        path.write_text(json.dumps(values | {"translation": ragged}))
        with pytest.raises(InputError, match="'translation' must hold 3 finite"):
            read_calibration(path)


@pytest.mark.parametrize(
    ("changed", "says"),
    [
        ({"translation": None}, "has 'rotation' but no 'translation'; give both"),
        ({"rotation": None}, "has 'translation' but no 'rotation'; give both"),
        ({"R": TURN}, "'rotation' and 'R', which mean the same"),
        ({"distortion_model": "kannala"}, "known are 0 or 1, and plumb_bob, radtan"),
        ({"fisheye_model": 2}, "'fisheye_model' 2"),
        ({"fisheye_model": 0, "distortion_model": "equidistant"}, "'fisheye_model' 0 and"),
        ({"fisheye_model": 1}, "'distortion_coefficients' must hold 4"),
        ({"fisheye_model": 1, "distortion_coefficients": None}, "lacks 'distortion_coefficients'"),
        ({"xi": 1.2}, "omnidirectional"),
        ({"camera_matrix": np.diag([-5e3, -5e3, 1.0])}, "positive f"),
        ({"camera_matrix": np.diag([-5e3, 0.0, 1.0])}, "positive f"),
    ],
)
def test_half_a_pose_and_unknown_lenses_are_refused(tmp_path, changed, says):
    """Whoever left them out had the world where the camera isn't, or the lens as it isn't."""
    path = written(tmp_path / "sensor.yaml", **changed)
    with pytest.raises(InputError, match=says) as told:
        read_calibration(path)
    assert str(path) in str(told.value)


def test_a_mirrored_camera_goes_through_a_file(tmp_path):
    """By a negative f and a true rotation, with which K (R x + t) is the mirrored image."""
    sensor = paper_sensor()
    pose = replace(sensor.camera.pose, rotation=sensor.camera.pose.rotation @ np.diag([-1, 1, 1]))
    mirrored = replace(sensor, camera=replace(sensor.camera, pose=pose))
    path = tmp_path / "mirrored.yaml"
    path.write_text(calibration_text(calibration_of(mirrored), path.name))
    read = read_calibration(path)
    assert np.linalg.det(read.camera.pose.rotation) > 0.0
    assert "negative f" in read.notes[0]
    normal, _ = sensor.laser.plane
    points = np.cross(normal, np.random.default_rng(2).uniform(-5.0, 5.0, (20, 3)))
    pixel = sensor.camera.project(points)
    pixel[:, 0] = 2047.0 - pixel[:, 0]  # the principal point is the middle of 2048 px
    np.testing.assert_allclose(triangulate(read, pixel), points, atol=1e-8)
    np.testing.assert_allclose(read.camera.project(points), pixel, atol=1e-8)
    bent = replace(mirrored, camera=replace(mirrored.camera, distortion=np.zeros(4)))
    with pytest.raises(InputError, match="mirrored camera that distorts"):
        calibration_text(calibration_of(bent), path.name)


def test_yaml_is_read_however_it_is_laid_out(tmp_path):
    """As PyYAML dumps it, with comments, OpenCV's header or none: the numbers are the same."""
    values = {name: np.asarray(value).tolist() for name, value in GOOD.items()}
    path = tmp_path / "c.yaml"
    points = plane_points(8.0)
    names = ("rotation", "translation", "camera_matrix", "distortion_coefficients")
    pixel = cv2.projectPoints(points, *(GOOD[name] for name in names))[0][:, 0]
    texts = [yaml.safe_dump(values, default_flow_style=flow) for flow in (None, True, False)]
    texts += ["%YAML:1.0\n---\n" + texts[0], "# measured on a Monday\n" + texts[2]]
    texts += [texts[0].replace("image_width:", "image_width:   # px\n "), "\ufeff" + texts[2]]
    for text in texts:
        for newline in ("\n", "\r\n"):
            path.write_bytes(text.replace("\n", newline).encode())
            np.testing.assert_allclose(
                triangulate(read_calibration(path), pixel), points, atol=1e-8
            )
