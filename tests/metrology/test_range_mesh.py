"""A range image's triangles: all of a surface, and none across an edge."""

from types import SimpleNamespace

import numpy as np
import pytest

import virtual_sensor as vs
from virtual_sensor.metrology.range_image import RangeImage, reconstruct

SIZE = 40


def image_of(depth, pitch=1e-3):
    """A range image of a camera in the world's origin that looks along z."""
    v, u = np.mgrid[: depth.shape[0], : depth.shape[1]]
    points = np.stack([pitch * (u - 20.0) * depth, pitch * (v - 20.0) * depth, depth], axis=-1)
    status = np.where(np.isfinite(depth), 0, 1).astype(np.uint8)
    none = np.full(depth.shape, np.nan, np.float32)
    return RangeImage(points, depth, none, None, status, np.full((*depth.shape, 2), np.nan))


def corners(mesh):
    return mesh.vertices[mesh.faces]


def test_a_plane_is_covered_once_and_faces_the_camera():
    depth = np.full((SIZE, SIZE), 300.0)
    mesh = image_of(depth).mesh()
    a, b, c = corners(mesh).transpose(1, 0, 2)
    twice = np.cross(b - a, c - a)
    np.testing.assert_allclose(twice[:, 2].sum() / 2.0, -((0.3 * (SIZE - 1)) ** 2))
    assert np.all(twice[:, 2] < 0.0)
    assert len(mesh.faces) == 2 * (SIZE - 1) ** 2
    np.testing.assert_array_equal(mesh.index, np.arange(SIZE**2))


def test_squares_are_cut_along_their_flatter_diagonal():
    """Of a trough along either diagonal no triangle bridges its bottom, and all face the camera."""
    v, u = np.mgrid[:SIZE, :SIZE]
    for along in (u + v, u - v):
        mesh = image_of(300.0 + 0.01 * (along - along.mean() - 0.3) ** 2).mesh()
        a, b, c = corners(mesh).transpose(1, 0, 2)
        assert np.all(np.cross(b - a, c - a)[:, 2] < 0.0)
        assert len(mesh.faces) == 2 * (SIZE - 1) ** 2
        heights = along.ravel()[mesh.index[mesh.faces]]
        assert np.all(np.ptp(heights, axis=1) == 1)


def test_no_triangle_bridges_a_step_or_a_hole():
    depth = np.full((SIZE, SIZE), 300.0)
    depth[:, 17:] = 305.0
    depth[5:9, 30] = np.nan
    depth[20, 3] = np.nan
    image = image_of(depth)
    mesh = image.mesh()
    assert np.ptp(corners(mesh)[..., 2], axis=1).max() == 0.0
    assert not np.isin(np.flatnonzero(np.isnan(depth)), mesh.index).any()
    # Squares: all but those of the step and of the holes; beside a hole of one pixel, and at the
    # ends of a longer one, half of each square is left.
    whole = (SIZE - 1) ** 2 - (SIZE - 1) - 10 - 4
    assert len(mesh.faces) == 2 * whole + 4 + 4
    assert len(image.mesh(89.5).faces) > len(mesh.faces)  # so steep a face is no edge


def test_steep_sides_stay_and_deep_jumps_go():
    """A ramp of 70 degrees is a surface, whatever the distance."""
    for far in (1.0, 10.0):
        ramp = far * (300.0 + 0.3 * np.tan(np.radians(70.0)) * np.arange(SIZE))
        mesh = image_of(np.tile(ramp, (SIZE, 1))).mesh()
        assert len(mesh.faces) == 2 * (SIZE - 1) ** 2
        assert len(image_of(np.tile(ramp, (SIZE, 1))).mesh(50.0).faces) == 0


def test_nothing_gives_no_triangle():
    mesh = image_of(np.full((5, 7), np.nan)).mesh()
    assert (mesh.vertices.shape, mesh.faces.shape) == ((0, 3), (0, 3))
    with pytest.raises(vs.InputError, match="steepest_deg"):
        image_of(np.full((5, 7), 1.0)).mesh(90.0)


def test_deviations_are_signed_along_the_normal():
    """A cold plane that is measured as if it lay where it does; the true one lies deeper."""
    scene = vs.load_scene("fringe_cylinder", width=SIZE, height=SIZE).cold()
    v, u = np.mgrid[:SIZE, :SIZE]
    direction = scene.camera.lines_of_sight(np.stack([u.ravel(), v.ravel()], axis=1))
    points = scene.camera.pose.origin_mm - direction * (
        scene.camera.pose.origin_mm[2] / direction[:, 2:]
    )
    pixel = scene.projector.family.project(points)
    column, row = pixel.T.reshape(2, SIZE, SIZE)
    decoded = SimpleNamespace(column=np.where(column > 300.0, column, np.nan), row=row)
    image = reconstruct(scene, decoded)
    deviation = image.deviation_um(vs.PlaneShape(z_mm=-0.025))
    assert np.array_equal(np.isfinite(deviation), image.ok)
    np.testing.assert_allclose(deviation[image.ok], 25.0, atol=1e-4)
    with pytest.raises(vs.InputError, match="deviation_um: shape"):
        image.deviation_um("plane")


def test_distances_from_a_mesh_are_along_its_own_normal():
    """Rationale: taken along the sensors' view, points 0.3 mm off a steep side were 10 um wrong."""
    from virtual_sensor.engine import mi
    from virtual_sensor.optics.surfaces import SceneSurface

    ball = SceneSurface(mi.load_dict({"type": "scene", "ball": {"type": "sphere", "radius": 13.5}}))
    angle = np.radians([0.0, 30.0, 50.0, 65.0])
    out = np.column_stack([np.sin(angle), 0.0 * angle, np.cos(angle)])
    for off_mm in (-0.3, 0.3):
        found = vs.PartShape(ball).distance(out * (13.5 + off_mm))
        np.testing.assert_allclose(found.distance_mm, off_mm, atol=1e-4)
        np.testing.assert_allclose(found.by_point, out, atol=2e-3)
