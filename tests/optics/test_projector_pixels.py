"""Camera pixel to projector pixel and back, and the residual across the epipolar line."""

from dataclasses import replace

import cv2
import numpy as np
import oracles
import pytest

import virtual_sensor as vs
from virtual_sensor.medium.exact_fields import hot_spot
from virtual_sensor.optics.projector_pixels import ProjectorPixelStatus, projector_pixels
from virtual_sensor.optics.rays import March

GRID = np.stack(np.meshgrid(np.linspace(620, 1420, 4), np.linspace(200, 1800, 4)), -1)
GRID = GRID.reshape(-1, 2)
QUICK = March(1.0, "leapfrog", "double")


@pytest.fixture(scope="module")
def hot():
    return vs.load_scene("fringe_cylinder")


@pytest.fixture(scope="module")
def cold(hot):
    return hot.cold()


@pytest.fixture(scope="module")
def found(hot):
    return projector_pixels(hot, GRID, march=QUICK)


def with_family(scene, family):
    """The scene with other rays of its projector."""
    return replace(scene, sources={"projector": replace(scene.projector, family=family)})


def by_opencv(family, points):
    """Pixels of points by OpenCV, from a family's K, distortion and pose."""
    to_family = family.pose.rotation.T
    turn, shift = cv2.Rodrigues(to_family)[0], -to_family @ family.pose.origin_mm
    pixel = cv2.projectPoints(points, turn, shift, family.matrix, family.distortion)[0]
    return pixel[:, 0]


def test_straight_pixels_are_opencvs(cold):
    """Rationale: OpenCV projects, with distortion on the projector's side; SciPy is not needed.

    Points on the cylinder come from the closed formula of the line of sight.
    """
    lens = np.array([-0.1, 0.5, 1e-3, -2e-3, 0.3])
    scene = with_family(cold, replace(cold.projector.family, distortion=lens))
    found = projector_pixels(scene, GRID)
    assert np.all(found.status == ProjectorPixelStatus.OK)
    origin, direction = scene.camera.pose.origin_mm, scene.camera.lines_of_sight(GRID)
    y, z = origin[1], origin[2] + 13.5
    a = direction[:, 1] ** 2 + direction[:, 2] ** 2
    b = y * direction[:, 1] + z * direction[:, 2]
    length = (-b - np.sqrt(b**2 - a * (y**2 + z**2 - 13.5**2))) / a
    point = origin + length[:, None] * direction
    np.testing.assert_allclose(found.point_mm, point, atol=1e-9)
    expected = by_opencv(scene.projector.family, point)
    np.testing.assert_allclose(found.projector_pixel, expected, atol=1e-8)


def test_bent_pixels_are_scipys(hot):
    """Rationale: SciPy's integrator, in arc length, of a warm spot's formula above the part.

    The camera's bent ray and the projector's, of the pixel found, come to the same point of the
    cylinder, within 1e-6 mm: 2e-5 of their pixels.
    """
    scene = hot.with_medium(hot_spot(0.02, 12.0, box=np.array([[-70.0] * 3, [70.0] * 3])))
    pixel = GRID[[0, 6, 11]]
    found = projector_pixels(scene, pixel)
    assert np.all(found.status == ProjectorPixelStatus.OK)

    def index(p):
        dip = 0.02 * np.exp(-np.sum(p**2, axis=1) / 288.0)
        n = np.sqrt(1.0 - dip)
        return n, p * (dip / 288.0 / n)[:, None]

    point, projector = found.point_mm, scene.projector.family
    for family, seen in ((scene.camera, pixel), (projector, found.projector_pixel)):
        ahead = np.column_stack([seen, np.ones(3)]) @ np.linalg.inv(family.matrix).T
        starts = np.tile(family.pose.origin_mm, (3, 1))
        rays = oracles.integrate(index, starts, ahead @ family.pose.rotation.T, 320.0)
        axis = family.pose.rotation[:, 2]
        arcs = rays.arcs_to(lambda p, axis=axis: (p - point) @ axis, 250.0, 320.0)
        ends = np.array([rays.position(arc)[i] for i, arc in enumerate(arcs)])
        np.testing.assert_allclose(ends, point, rtol=0, atol=1e-6)
    np.testing.assert_allclose(np.hypot(point[:, 1], point[:, 2] + 13.5), 13.5, atol=1e-9)
    assert np.abs(projector.project(point) - found.projector_pixel).max() > 1.0


@pytest.mark.parametrize("method", ["newton", "tabulated"])
def test_searching_back_leads_to_the_cameras_pixel(hot, found, method):
    """The projector ray is marched to the part, and only then the camera pixel is sought."""
    assert np.all(found.status == ProjectorPixelStatus.OK)
    back = vs.ray_search(hot, projector_pixel=found.projector_pixel, method=method, march=QUICK)
    within = {"newton": 1e-5, "tabulated": 2e-3}[method]
    np.testing.assert_allclose(back.pixel, GRID, atol=within)
    np.testing.assert_allclose(back.laser_point_mm, found.point_mm, atol=within * 0.02)


def test_the_papers_search_takes_projectors_too(hot, found):
    some = slice(5, 7)
    back = vs.ray_search(hot, projector_pixel=found.projector_pixel[some], march=QUICK)
    assert np.all(back.distance_um < 1.0)
    np.testing.assert_allclose(back.pixel, GRID[some], atol=0.1)


def test_epipolar_lines_are_opencvs(cold, hot, found):
    """The fundamental matrix's lines; cold, pixels lie on them, hot some pixels beside."""
    camera, projector = hot.camera, hot.projector.family
    turn = camera.pose.rotation.T @ projector.pose.rotation
    x, y, z = camera.pose.to_local(projector.pose.origin_mm)
    essential = np.array([[0, -z, y], [z, 0, -x], [-y, x, 0]]) @ turn
    of_projector = np.linalg.inv(projector.matrix)
    for flat in (2.0, 1.0):  # pixels that are no squares, too
        seeing = replace(camera, matrix=np.diag([1.0, flat, 1.0]) @ camera.matrix)
        fundamental = np.linalg.inv(seeing.matrix).T @ essential @ of_projector
        lines = cv2.computeCorrespondEpilines(found.projector_pixel, 1, fundamental)[:, 0]
        expected = np.sum(lines * np.column_stack([GRID, np.ones(len(GRID))]), axis=1)
        residual = vs.epipolar_residual(seeing, projector, GRID, found.projector_pixel)
        np.testing.assert_allclose(np.abs(residual), np.abs(expected), atol=1e-7)
    assert 3.0 < np.sqrt(np.mean(residual**2)) < 8.0

    straight = projector_pixels(cold, GRID, march=QUICK)
    residual = vs.epipolar_residual(camera, projector, GRID, straight.projector_pixel)
    np.testing.assert_allclose(residual, 0.0, atol=1e-9)


def test_right_of_the_epipolar_line_is_positive(hot, found):
    """Seen as the line runs from near to far, u to the right, v down."""
    camera, projector = hot.camera, hot.projector.family
    light = projector.lines_of_sight(found.projector_pixel[:1])
    near, far = (camera.project(projector.pose.origin_mm + d * light)[0] for d in (290.0, 300.0))
    along = (far - near) / np.linalg.norm(far - near)
    right = np.array([-along[1], along[0]])
    residual = vs.epipolar_residual(
        camera, projector, [far + 2.5 * right], found.projector_pixel[:1]
    )
    np.testing.assert_allclose(residual, 2.5, atol=1e-9)


def test_no_value_without_a_reason(cold):
    """Beside the part, beside the projector's image, in the part's own shadow, no pixel at all."""
    pixel = np.array([[10.0, 1000.0], [np.nan, 3.0], [1000.0, 1000.0]])
    found = projector_pixels(cold, pixel, march=QUICK)
    expected = [ProjectorPixelStatus.MISSED, ProjectorPixelStatus.NO_PIXEL, ProjectorPixelStatus.OK]
    np.testing.assert_array_equal(found.status, expected)
    np.testing.assert_array_equal(np.isnan(found.projector_pixel[:, 0]), [True, True, False])

    family = cold.projector.family
    narrow = replace(family, matrix=np.diag([3.0, 3.0, 1.0]) @ family.matrix)
    beside = projector_pixels(with_family(cold, narrow), GRID, march=QUICK)
    pixel = by_opencv(narrow, beside.point_mm)
    inside = np.all((pixel > -0.5) & (pixel < np.array(narrow.size) - 0.5), axis=1)
    np.testing.assert_array_equal(beside.status == ProjectorPixelStatus.OUTSIDE, ~inside)
    assert 0 < inside.sum() < len(GRID)

    about_axis = vs.Pose.turn(100.0, [1.0, 0.0, 0.0], [0.0, 0.0, -13.5])
    pose = family.pose.moved(about_axis)
    row = np.column_stack([np.linspace(560.0, 1490.0, 200), np.full(200, 1023.0)])
    turned = projector_pixels(with_family(cold, family.with_pose(pose)), row, march=QUICK)
    lit = np.isfinite(turned.projector_pixel[:, 0])
    shadowed = turned.status == ProjectorPixelStatus.SHADOWED
    assert lit.sum() > 20
    assert shadowed.sum() > 60
    # The cylinder is lit where its normal faces the projector, but for a pixel at the terminator.
    normal = turned.point_mm - [0.0, 0.0, -13.5]
    normal[:, 0] = 0.0
    faces = np.sum((pose.origin_mm - turned.point_mm) * normal, axis=1)
    assert np.all(faces[lit] > 0.0)
    assert np.all(faces[shadowed] < 0.05 * np.nanmax(faces))


def test_pixels_with_an_edge_within_are_named(cold):
    """The cylinder's silhouette, the border of the projector's image: within half a pixel."""
    u = np.arange(415.0, 445.0, 0.25)
    found = projector_pixels(cold, np.column_stack([u, np.full_like(u, 1023.0)]), march=QUICK)
    missed = found.status == ProjectorPixelStatus.MISSED
    edge = found.status == ProjectorPixelStatus.EDGE
    assert 0 < missed.sum() < len(u)
    first = u[~missed].min()
    assert np.all(edge[(u >= first) & (u < first + 0.5)])
    assert np.isfinite(found.projector_pixel[edge]).all()


def test_lasers_have_no_pixels():
    with pytest.raises(vs.InputError, match='needs one; add <emitter type="pattern_projector'):
        projector_pixels("hot_cylinder", GRID)
    with pytest.raises(vs.InputError, match="pattern_projector"):
        vs.ray_search("hot_cylinder", projector_pixel=GRID)
    with pytest.raises(vs.InputError, match="either laser_y_mm"):
        vs.ray_search("hot_cylinder")
