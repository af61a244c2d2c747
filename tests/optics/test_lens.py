"""The thin lens and its pupil, against rays that are refracted by hand at a physical lens."""

import numpy as np
import pytest
from scipy.spatial.transform import Rotation

from virtual_sensor.errors import InputError
from virtual_sensor.optics.lens import MOST_POINTS, Lens, PupilPoint, circle_of_confusion
from virtual_sensor.optics.ray_families import Pinhole
from virtual_sensor.poses import Pose

POSE = Pose.turn(40.0, (1.0, 2.0, 0.5), (3.0, 1.0, 7.0))
PITCH_MM = 0.01
LENS = Lens.of_f_number(75.0, 300.0, 4.0, (8.2, -3.0))
RANDOM = np.random.default_rng(0)


def camera(distortion=()):
    px = 75.0 / PITCH_MM
    matrix = np.array([[px, 0.0, 511.5], [0.0, px, 400.0], [0.0, 0.0, 1.0]])
    return Pinhole(matrix, POSE, (1024, 801), np.array(distortion, float))


def tilted(lens, more=(0.0,) * 12):
    return camera([*more, *np.radians(lens.sensor_tilt_deg)])


def test_the_papers_lens_has_the_focal_length_of_the_thin_lens_formula():
    lens = Lens.of_f_number(75.0, 300.0, 8.0)
    assert lens.focal_length_mm == pytest.approx(60.0, rel=1e-15)
    assert lens.pupil_radius_mm == pytest.approx(3.75, rel=1e-15)
    assert lens.f_number == pytest.approx(8.0, rel=1e-15)
    assert (lens.magnification, lens.working_f_number) == (0.25, 10.0)
    assert Lens(75.0, 300.0, 0.0).f_number == np.inf
    assert "f/8, focused at 300 mm" in repr(lens)


def test_pixels_seen_from_the_pupil_are_those_of_light_that_a_thin_lens_refracts():
    """Rays leave the physical pixel of a sensor that SciPy tilts; slopes change by -A/F."""
    view, at = tilted(LENS), np.array([4.0, -5.5])
    point = PupilPoint.of(view, LENS, at)
    pixel = RANDOM.uniform(0.0, 800.0, (50, 2))
    # Where pixels are, in the camera's frame, the sensor being mirrored before the lens.
    tau_x, tau_y = LENS.sensor_tilt_deg
    turned = Rotation.from_euler("xy", [-tau_x, -tau_y], degrees=True).as_matrix()
    in_plane = np.column_stack([(pixel - view.matrix[:2, 2]) * PITCH_MM, np.zeros(50)])
    behind = -(np.array([0.0, 0.0, 75.0]) + in_plane @ turned)
    leaves = (np.append(at, 0.0) - behind) / -behind[:, 2:]
    slope = leaves[:, :2] - at / LENS.focal_length_mm
    found = np.column_stack(point.of_pixels(pixel))
    np.testing.assert_allclose(found, slope, atol=1e-13)
    # The same points of space are seen, by cv2, where the chief rays' pixels are.
    there = POSE.to_world(np.append(at, 0.0) + 700.0 * np.column_stack([slope, np.ones(50)]))
    np.testing.assert_allclose(point.project(there), pixel, atol=1e-8)
    np.testing.assert_allclose(point.pose.origin_mm, POSE.to_world(np.append(at, 0.0)))


def test_all_points_of_the_pupil_see_the_plane_in_focus_in_the_same_pixels():
    view = tilted(LENS, np.array([-0.1, 0.05, 1e-3, -2e-3, 0, 0, 0, 0, 0, 0, 0, 0]))
    pixel = RANDOM.uniform(0.0, 800.0, (20, 2))
    p, q = view.of_pixels(pixel)
    sharp = POSE.to_world(np.column_stack([p, q, np.ones(20)]) / LENS.in_focus(p, q)[:, None])
    for at in LENS.pupil(16):
        seen = PupilPoint.of(view, LENS, at).project(sharp)
        np.testing.assert_allclose(seen, pixel, atol=1e-7)
    # Scheimpflug: a plane, that meets the lens's plane where the sensor's mirror image does.
    centre, _, (_, _, normal) = np.linalg.svd(sharp - sharp.mean(axis=0))[0:3]
    assert np.abs((sharp - sharp.mean(axis=0)) @ normal).max() < 1e-10
    assert np.abs(circle_of_confusion(LENS, view, sharp)).max() < 1e-9
    assert centre.size


def test_the_blur_of_a_point_is_as_wide_as_the_pupils_images_of_it():
    """Where the sensor is much tilted about both axes, a pixel's columns lean on its rows too."""
    points = POSE.to_world(RANDOM.uniform([-20, -20, 270], [20, 20, 330], (30, 3)))
    angle = np.linspace(0.0, 2 * np.pi, 720)
    for lens in (LENS, Lens.of_f_number(75.0, 300.0, 16.0, (30.0, -25.0))):
        view = tilted(lens)
        around = lens.pupil_radius_mm * np.stack([np.cos(angle), np.sin(angle)], axis=1)
        seen = np.stack([PupilPoint.of(view, lens, at).project(points) for at in around])
        wide = circle_of_confusion(lens, view, points)
        np.testing.assert_allclose(np.ptp(seen, axis=0), wide, rtol=2e-3, atol=1e-3)
    behind = circle_of_confusion(LENS, view, POSE.to_world([[0.0, 0.0, -5.0]]))
    assert np.isnan(behind).all()


def test_the_middle_of_the_pupil_is_the_camera():
    view = tilted(LENS, np.array([-0.1, 0.05, 1e-3, -2e-3, 0, 0, 0, 0, 0, 0, 0, 0]))
    point = PupilPoint.of(view, LENS, LENS.pupil(1)[0])
    pixel = RANDOM.uniform(0.0, 800.0, (20, 2))
    np.testing.assert_array_equal(point.of_pixels(pixel), view.of_pixels(pixel))
    p, q = view.of_pixels(pixel)
    np.testing.assert_array_equal(point.pixels(p, q), view.pixels(p, q))


def test_slopes_of_pixels_are_their_derivatives():
    view = tilted(LENS, np.array([-0.1, 0.05, 1e-3, -2e-3, 0, 0, 0, 0, 0, 0, 0, 0]))
    point = PupilPoint.of(view, LENS, (3.0, 2.0))
    p, q = RANDOM.uniform(-0.03, 0.03, (2, 9))
    small = 1e-6
    by_p = (point.pixels(p + small, q) - point.pixels(p - small, q)) / (2 * small)
    by_q = (point.pixels(p, q + small) - point.pixels(p, q - small)) / (2 * small)
    slopes = point.pixel_slopes(p, q)
    np.testing.assert_allclose(slopes, np.stack([by_p, by_q], axis=-1), rtol=1e-5, atol=0.1)
    bare = PupilPoint.of(camera(), LENS, (3.0, 2.0))
    homogeneous = np.column_stack([p, q, np.ones(9)])
    np.testing.assert_allclose(
        bare.pixels(p, q), (homogeneous @ bare.ideal_matrix.T)[:, :2], rtol=1e-12
    )


def test_a_pupils_points_stand_for_equal_areas():
    """Moments of the disc, <x^2> = r^2/4, <x^4> = r^4/8, <x^2 y^2> = r^4/24, <x^6> = 5 r^6/64."""
    for count in (3, 5, 6, 8, 12, 16, 17, 24, 64, 256):
        x, y = Lens(75.0, 300.0, 2.0).pupil(count).T
        assert len(x) == count
        np.testing.assert_allclose([x.mean(), y.mean(), (x * y).mean()], 0.0, atol=1e-14)
        np.testing.assert_allclose([(x**2).mean(), (y**2).mean()], 1.0, rtol=1e-12)
        assert np.hypot(x, y).max() < 2.0
        if count >= 12:
            cubes = [(x**3).mean(), (x**2 * y).mean(), (x * y**2).mean(), (y**3).mean()]
            np.testing.assert_allclose(cubes, 0.0, atol=1e-13)
            np.testing.assert_allclose([(x**4).mean(), (y**4).mean()], 2.0, rtol=1e-12)
            assert (x**2 * y**2).mean() == pytest.approx(2.0 / 3.0, rel=1e-12)
        if count in (16, 24, 64, 256):
            np.testing.assert_allclose([(x**6).mean(), (y**6).mean()], 5.0, rtol=1e-12)
    for share in (0.25, 0.5, 0.75, 1.0):  # as many points as there is area
        assert np.sum(x**2 + y**2 < 4.0 * share) == 256 * share
    sixteen = Lens(75.0, 300.0, 1.0).pupil(16)
    gaps = np.diff(np.sort(sixteen, axis=0), axis=0)
    assert gaps.min() > 0.005  # none beside another along u or v
    assert gaps.max() < 0.18


def test_what_is_no_lens_is_refused():
    for numbers in (
        (0.0, 300.0, 1.0),
        (75.0, -300.0, 1.0),
        (75.0, np.nan, 1.0),
        (75.0, 300.0, -1.0),
        (75.0, 300.0, 1.0, (90.0, 0.0)),
        (75.0, 300.0, 1.0, (np.nan, 0.0)),
        (75.0, 300.0, 1.0, 8.2),
    ):
        with pytest.raises(InputError, match="Lens: "):
            Lens(*numbers)
    for f_number in (0.0, 0.3, -8.0, np.inf):
        with pytest.raises(InputError, match="f_number"):
            Lens.of_f_number(75.0, 300.0, f_number)
    for count in (0, MOST_POINTS + 1, 2.5):
        with pytest.raises(InputError, match="pupil"):
            LENS.pupil(count)
