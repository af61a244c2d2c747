"""Calibration files: what OpenCV writes is read, what is no calibration is refused in words."""

import subprocess
import sys

import cv2
import numpy as np
import pytest
from artificial import paper_sensor

from virtual_sensor.errors import InputError
from virtual_sensor.metrology.calibration import (
    calibration_of,
    calibration_text,
    read_calibration,
)
from virtual_sensor.metrology.triangulation import triangulate

GOOD = {
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


def test_what_may_be_left_out_has_its_natural_value(tmp_path):
    """Without a pose the world is the camera's; without coefficients it is a pinhole."""
    path = written(
        tmp_path / "c.yaml",
        rotation=None,
        translation=None,
        distortion_coefficients=None,
        laser_plane=np.array([0.6, 0.0, 0.8, 240.0]),
    )
    point = triangulate(read_calibration(path), [[1023.5, 767.5]])
    np.testing.assert_allclose(point, [[0.0, 0.0, 300.0]], atol=1e-9)


@pytest.mark.parametrize(
    ("changed", "says"),
    [
        ({"camera_matrix": None}, "lacks 'camera_matrix'"),
        ({"camera_matrix": np.eye(2)}, "'camera_matrix' must hold 9 finite numbers"),
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


@pytest.mark.parametrize("ending", ["yaml", "xml", "json"])
def test_a_matrix_that_lacks_its_columns_does_not_end_the_process(tmp_path, ending):
    """OpenCV 5.0's own `mat()` writes past its memory there: in a process of its own, many times.

    Its numbers are all there, so they are read; what counts is that the process lives.
    """
    path = written(tmp_path / f"sensor.{ending}", rotation=np.eye(3))
    text = path.read_text(encoding="utf-8")
    assert text.count("cols") >= 2
    path.write_text(text.replace("cols", "kols"), encoding="utf-8")
    code = (
        "import sys, pathlib\n"
        "from virtual_sensor.metrology.calibration import read_calibration\n"
        "for _ in range(100): read_calibration(pathlib.Path(sys.argv[1]))\n"
    )
    ended = subprocess.run([sys.executable, "-c", code, path], capture_output=True, text=True)
    assert (ended.returncode, ended.stderr) == (0, "")


@pytest.mark.parametrize(
    "content",
    [
        b"",
        b"\x00\xff\x00",
        b"hello",
        b"%YAML:1.0\n---\na: [1, 2",
        b"{",
        b"%YAML:1.0\n---\n- 1\n",
        b"[1, 2]",
    ],
)
def test_files_that_are_something_else_are_refused(tmp_path, content):
    """Empty, binary, text, truncated: an error of ours, none of OpenCV's."""
    path = tmp_path / "sensor.yaml"
    path.write_bytes(content)
    with pytest.raises(InputError, match=r"sensor\.yaml"):
        read_calibration(path)
    with pytest.raises(InputError, match=r"missing\.yaml"):
        read_calibration(tmp_path / "missing.yaml")
