"""Focal length, film and working distance of the shipped scenes, and what follows from them."""

import numpy as np
import pytest

from virtual_sensor.errors import InputError
from virtual_sensor.imaging.scene import load_scene

COLD = "cold_cylinder"


def test_the_lens_and_the_film_make_the_camera():
    """The focal length in pixels is the focal length over the pitch; no angle is needed for it."""
    asked = {"focal_length": 50, "pixel": 3.45, "width": 2448, "height": 2048, "distance": 400}
    scene = load_scene(COLD, **asked)
    np.testing.assert_allclose(np.diag(scene.camera.matrix)[:2], 50.0 / 3.45e-3, rtol=1e-6)
    for pose in scene.poses.values():
        assert np.linalg.norm(pose.origin_mm) == pytest.approx(400.0)
    assert float(scene.parameters["film_width"]) == pytest.approx(8.4456)
    # What was worked out is worked out again where the scene is changed.
    coarse = scene.with_parameters(pixel=6.9, width=1224, height=1024)
    np.testing.assert_allclose(coarse.camera.matrix[0, 0], 50.0 / 6.9e-3, rtol=1e-6)


def test_a_smaller_frame_has_the_same_field_of_view():
    """Rationale: a quick look is `-D width=512`."""
    scene = load_scene(COLD, width=512, height=512)
    np.testing.assert_allclose(scene.camera.matrix[0, 0], 75.0 / 11.264 * 512, rtol=1e-6)
    assert scene.parameters["pixel"] == "22"


def test_a_field_of_view_that_is_given_stays():
    """The focal length follows from it; all values may be given if they are one camera's."""
    scene = load_scene(COLD, fov=10.0)
    assert float(scene.parameters["focal_length"]) == pytest.approx(5.632 / np.tan(np.radians(5.0)))
    again = load_scene(COLD, **scene.parameters)
    assert again.parameters == scene.parameters
    np.testing.assert_array_equal(again.camera.matrix, scene.camera.matrix)


def test_what_makes_no_camera_is_refused():
    """The message names the parameter, and the one that it contradicts."""
    for given, words in (
        ({"pixel": 3, "film_width": 10}, "film_width=10 contradicts pixel=3, which makes it 6.144"),
        ({"fov": 10, "focal_length": 50}, "focal_length=50 contradicts fov=10"),
        ({"pixel": -1}, "pixel=-1 is no number above 0"),
        ({"focal_length": "50mm"}, "focal_length=50mm is no number"),
        ({"fov": 180}, "below 180"),
        ({"distance": 0}, "its origin is its target"),
    ):
        with pytest.raises(InputError, match=rf"cold_cylinder\.xml.*: .*{words}"):
            load_scene(COLD, **given)
