"""Distortion undone by a table, against OpenCV's own projection."""

import cv2
import numpy as np
import pytest

from virtual_sensor.engine import mi
from virtual_sensor.errors import InputError
from virtual_sensor.optics.ray_families import Pinhole
from virtual_sensor.optics.undistortion import Undistortion, check_unfolded
from virtual_sensor.poses import Pose

MATRIX = np.array([[3400.0, 0.0, 320.0], [0.0, 3390.0, 250.0], [0.0, 0.0, 1.0]])
LENSES = {
    "four": [-0.9, 4.0, 1e-3, -2e-3],
    "eight": [2.5, 2.0, 1e-3, 1e-3, 1.0, 0.4, 0.1, 0.2],
    "tilted": [-0.5, 0.0, 0.0, 0.0, 0.0, 0.0, 0.0, 0.0, 0.01, 0.0, 0.02, 0.0, 0.14, -0.1],
}


def _camera(coefficients, fisheye=False):
    pose = Pose(np.eye(3), np.zeros(3))
    return Pinhole(MATRIX, pose, (640, 480), np.array(coefficients, float), fisheye)


def _undone(camera, place):
    """An ideal pinhole's pixels of places on the film, which are Mitsuba's."""
    moved = Undistortion(camera).at(mi.Point2f(place.T.astype(np.float32)))
    return place - 0.5 + np.stack([np.array(by, float) for by in moved], axis=1)


def test_opencv_puts_what_is_undone_back_to_where_it_was():
    """Over the whole film, its corners too."""
    corners = [[0.0, 0.0], [640.0, 0.0], [0.0, 480.0], [640.0, 480.0]]
    places = np.random.default_rng(0).uniform(0.0, 1.0, (2000, 2)) * [640.0, 480.0]
    place = np.vstack([corners, np.float32(places)])
    for lens, coefficients in LENSES.items():
        ideal = _undone(_camera(coefficients), place)
        assert np.abs(ideal - place + 0.5).max() > 1.0
        rays = np.column_stack([ideal, np.ones(len(ideal))]) @ np.linalg.inv(MATRIX).T
        seen, _ = cv2.projectPoints(rays, np.zeros(3), np.zeros(3), MATRIX, np.array(coefficients))
        np.testing.assert_allclose(seen[:, 0], place - 0.5, atol=3e-5, err_msg=lens)


def test_a_fisheye_is_undone_too():
    """As OpenCV's own function for it does."""
    place = np.random.default_rng(1).uniform(0.0, 1.0, (500, 2)) * [640.0, 480.0]
    ideal = _undone(_camera([0.1, 0.2, 0.0, 0.0], fisheye=True), np.float32(place))
    coefficients = np.array([0.1, 0.2, 0.0, 0.0])
    rays = np.column_stack([ideal, np.ones(len(ideal))]) @ np.linalg.inv(MATRIX).T
    seen, _ = cv2.fisheye.projectPoints(
        rays[:, None], np.zeros(3), np.zeros(3), MATRIX, coefficients
    )
    np.testing.assert_allclose(seen[:, 0], place - 0.5, atol=6e-5)


def test_a_distortion_that_folds_within_the_image_is_refused():
    """It says about where."""
    with pytest.raises(InputError, match=r"folds the image.* about the pixel \(0, 0\) of 640"):
        check_unfolded(_camera([-30.0, 0.0, 0.0, 0.0]))
    check_unfolded(_camera([-3.0, 0.0, 0.0, 0.0]))


def test_what_lies_beyond_the_image_is_not_folded_back_into_it():
    """The polynomial has its turning point just beyond the corner: no lens goes on from there."""
    camera = _camera([-7.0, 0.0, 0.0, 0.0])
    check_unfolded(camera)
    r = np.linspace(0.0, 0.5, 501)
    seen = camera.pixels(r, 0.0 * r)
    folded = np.isnan(seen[:, 0])
    assert not folded[r < 0.12].any()
    assert np.array_equal(folded, ~np.isfinite(seen).all(axis=1))
    assert not camera.inside(seen[r > 0.13]).any()
    by_opencv = camera.matrix[0, 2] + camera.matrix[0, 0] * r * (1.0 - 7.0 * r * r)
    np.testing.assert_allclose(seen[~folded, 0], by_opencv[~folded], atol=1e-9)
    assert (folded & (by_opencv > 0.0)).any()
    tilted = _camera(LENSES["tilted"])
    places = np.random.default_rng(2).uniform(0.0, 1.0, (2000, 2)) * [640.0, 480.0] - 0.5
    assert np.isfinite(tilted.pixels(*tilted.of_pixels(places))).all()
