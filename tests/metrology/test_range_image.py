"""Range images from projector pixels that are known: searched for, or by OpenCV."""

import re
from dataclasses import replace
from types import SimpleNamespace

import cv2
import numpy as np
import pytest

import virtual_sensor as vs
from virtual_sensor.imaging.scene_file import shipped_scenes
from virtual_sensor.metrology.range_image import reconstruct
from virtual_sensor.optics import sight_points
from virtual_sensor.optics.ray_families import Telecentric
from virtual_sensor.optics.ray_maps import CausticError
from virtual_sensor.optics.rays import March

SIZE = 48
QUICK = March(0.5, "leapfrog", "double")
MATRIX = np.array([[6400.0, 0.0, 3200.0], [0.0, 6400.0, 2000.0], [0.0, 0.0, 1.0]])
MIDDLE = [[0.0, 0.0, -13.5]]
LENS = np.array([-0.2, 0.8, 1e-3, -2e-3, 0.0])
STRONG = np.array([-2.0, 1.0, 0.01, -0.02])  # which no point is found with from a start far off


@pytest.fixture(scope="module")
def hot():
    return vs.load_scene("fringe_cylinder", width=SIZE, height=SIZE)


@pytest.fixture(scope="module")
def searched(hot):
    """Projector pixels of all of the hot scene's pixels, and the points that they see."""
    v, u = np.mgrid[:SIZE, :SIZE]
    return vs.projector_pixels(hot, np.stack([u.ravel(), v.ravel()], axis=1), march=QUICK)


def decoded_of(projector_pixel, status=None, sigma=0.01, size=(SIZE, SIZE)):
    """What a decoder would give of pixels (N, 2)."""
    column, row = projector_pixel.T.reshape(2, *size).copy()
    if status is not None:
        column[status.reshape(size) != 0] = row[status.reshape(size) != 0] = np.nan
    sigmas = np.where(np.isfinite(column), np.float32(sigma), np.float32(np.nan))
    return SimpleNamespace(column=column, row=row, sigma_column=sigmas, sigma_row=sigmas)


def off_cylinder_um(points):
    return 1e3 * (np.hypot(points[..., 1], points[..., 2] + 13.5) - 13.5)


def rms(values):
    return float(np.sqrt(np.nanmean(values**2)))


def seen(camera, function):
    """Points (H W, 3) where lines of sight, by OpenCV, meet a surface: length = function(o, d)."""
    width, height = camera.size
    v, u = np.mgrid[:height, :width]
    pixel = np.stack([u.ravel(), v.ravel()], axis=1).astype(float)
    criteria = (cv2.TERM_CRITERIA_COUNT + cv2.TERM_CRITERIA_EPS, 100, 1e-14)
    ideal = cv2.undistortPoints(pixel, camera.matrix, camera.distortion, criteria=criteria)
    direction = (
        np.column_stack([ideal.reshape(-1, 2), np.ones(len(pixel))]) @ camera.pose.rotation.T
    )
    direction /= np.linalg.norm(direction, axis=1, keepdims=True)
    origin = camera.pose.origin_mm
    return origin + function(origin, direction)[:, None] * direction


def by_opencv(family, points):
    """Pixels (N, 2) of points (N, 3)."""
    to_family = family.pose.rotation.T
    turn, shift = cv2.Rodrigues(to_family)[0], -to_family @ family.pose.origin_mm
    return cv2.projectPoints(points, turn, shift, family.matrix, family.distortion)[0][:, 0]


def sphere(origin, direction):
    """Distances to a sphere of radius 12 mm about (0, 0, -13.5); NaN beside it."""
    away = origin - MIDDLE[0]
    b = direction @ away
    with np.errstate(invalid="ignore"):
        return -b - np.sqrt(b**2 - away @ away + 12.0**2)


def plane(origin, direction):
    return -origin[2] / direction[:, 2]


@pytest.mark.parametrize("use", ["column", "both"])
@pytest.mark.parametrize("lens", [None, LENS, STRONG])
def test_straight_points_lie_on_the_plane_and_the_sphere(hot, use, lens):
    """Known surfaces, seen and lit by OpenCV's cameras, with distortion on both sides or none."""
    camera, projector = hot.camera, hot.projector.family
    if lens is not None:
        camera, projector = (replace(each, distortion=lens) for each in (camera, projector))
    calibration = SimpleNamespace(camera=camera, projector=projector)
    for surface in (plane, sphere):
        points = seen(camera, surface)
        decoded = decoded_of(by_opencv(projector, np.nan_to_num(points)))
        decoded.column[np.isnan(points[:, 0]).reshape(SIZE, SIZE)] = np.nan
        found = reconstruct(calibration, decoded, use=use)
        assert found.ok.sum() == np.isfinite(points[:, 0]).sum() > 200
        flat = found.point_mm.reshape(-1, 3)
        np.testing.assert_allclose(flat, points, atol=1e-6)  # undistorting to 1e-9 px
        assert np.nanmax(np.abs(found.epipolar_px)) < 1e-5
        depth = camera.pose.to_local(points)[:, 2].reshape(SIZE, SIZE)
        np.testing.assert_allclose(found.depth_mm, depth, atol=1e-6)


def test_rows_give_the_points_where_they_tell_the_depth(hot):
    """Rationale: turned by 90 degrees, a projector's columns say next to nothing of the depth."""
    camera, projector = hot.camera, hot.projector.family
    turn = cv2.Rodrigues(np.array([0.0, 0.0, np.pi / 2.0]))[0]
    pose = replace(projector.pose, rotation=projector.pose.rotation @ turn)
    points = seen(camera, plane)
    for family, wrong in ((projector, "row"), (replace(projector, pose=pose), "column")):
        calibration = SimpleNamespace(camera=camera, projector=family)
        decoded = decoded_of(by_opencv(family, points))
        getattr(decoded, wrong)[:] += 0.1  # which moves no point
        found = reconstruct(calibration, decoded)
        np.testing.assert_allclose(found.point_mm.reshape(-1, 3), points, atol=1e-6)
        setattr(decoded, {"row": "column", "column": "row"}[wrong], None)
        assert np.abs(reconstruct(calibration, decoded).point_mm[..., 2]).max() > 0.1


def test_bent_points_are_where_the_search_says(hot, searched):
    """The hot cylinder within 0.2 um rms of its true surface; straight it is off by 100 um."""
    decoded = decoded_of(searched.projector_pixel, searched.status)
    found = reconstruct(hot, decoded, medium=hot.medium, tolerance_px=1e-4)  # of few large pixels
    assert np.array_equal(found.ok.ravel(), searched.status == 0)
    point = found.point_mm.reshape(-1, 3)
    away_um = 1e3 * np.linalg.norm(point - searched.point_mm, axis=1)
    assert rms(away_um) < 0.02
    assert rms(off_cylinder_um(found.point_mm)) < 0.02
    # The row that the column's point should have is the searched one, though it was not used.
    at = found.projector_pixel.reshape(-1, 2)[searched.status == 0]
    np.testing.assert_allclose(at, searched.projector_pixel[searched.status == 0], atol=1e-3)

    straight = reconstruct(hot, decoded)
    s, _ = hot.projector.family.of_pixels(searched.projector_pixel)
    v, u = np.mgrid[:SIZE, :SIZE]
    pixel = np.stack([u.ravel(), v.ravel()], axis=1)
    normal, offset = hot.projector.family.plane(s)
    direction = hot.camera.lines_of_sight(pixel)
    centre = hot.camera.pose.origin_mm
    along = (offset - normal @ centre) / np.sum(normal * direction, axis=1)
    expected = off_cylinder_um(centre + along[:, None] * direction)
    expected = np.where(searched.status == 0, expected, np.nan)
    np.testing.assert_allclose(off_cylinder_um(straight.point_mm).ravel(), expected, atol=1e-5)
    assert 50.0 < rms(expected) < 200.0


def test_beside_a_caustic_there_is_a_slower_way(hot, searched, monkeypatch):
    """Without the inverse map, points come from forward maps, as those of laser lines do."""

    def folds(*given):
        raise CausticError("the map folds")

    monkeypatch.setattr(sight_points, "covering_inverse_map", folds)
    decoded = decoded_of(searched.projector_pixel, searched.status)
    found = reconstruct(hot, decoded, medium=hot.medium)
    assert found.ok.sum() > 0.99 * np.sum(searched.status == 0)
    assert rms(off_cylinder_um(found.point_mm)) < 0.1


def test_sigma_is_the_spread_of_the_points(hot):
    """Rationale: what is predicted is what noise on the decoded pixels does, axis by axis."""
    rng = np.random.default_rng(1)
    projector = hot.projector.family
    wide = np.array([[34.0, 0.0, 23.5], [0.0, 34.0, 23.5], [0.0, 0.0, 1.0]])  # of 35 degrees
    for camera, use, noise in (
        (hot.camera, "column", (0.05, 0.0)),
        (hot.camera, "row", (0.0, 0.01)),
        (hot.camera, "both", (0.05, 0.002)),
        (replace(hot.camera, matrix=wide), "column", (0.05, 0.0)),
    ):
        points = seen(camera, plane)
        pixel = by_opencv(projector, points)
        noisy = decoded_of(pixel + rng.normal(0.0, 1.0, pixel.shape) * noise)
        for name, sigma in zip(("sigma_column", "sigma_row"), noise, strict=True):
            setattr(noisy, name, np.full((SIZE, SIZE), sigma, np.float32))
        calibration = SimpleNamespace(camera=camera, projector=projector)
        found = reconstruct(calibration, noisy, use=use)
        away_um = 1e3 * np.linalg.norm(found.point_mm.reshape(-1, 3) - points, axis=1)
        share = away_um / found.sigma_um.ravel()
        assert 0.95 < rms(share) < 1.05


def test_no_point_without_a_status(hot, searched):
    """NaN, wrong orders, a projector's pixel far beside: each pixel has a point, or a reason."""
    decoded = decoded_of(searched.projector_pixel, searched.status)
    good = np.flatnonzero(searched.status == 0)
    column = decoded.column.ravel()
    column[good[:5]] = np.nan
    column[good[5:10]] += 16.0 * 40
    column[good[10:15]] = 1e9
    column[good[15:20]] = np.inf
    for medium in (None, hot.medium):
        found = reconstruct(hot, decoded, medium=medium)
        finite = np.isfinite(found.point_mm).all(axis=-1)
        assert np.array_equal(found.ok, finite)
        for values in (found.depth_mm, found.sigma_um, found.epipolar_px):
            assert np.array_equal(found.ok, np.isfinite(values))
        status = found.status.ravel()
        assert np.all(status[good[:5]] == vs.CrossingStatus.NO_PIXEL)
        assert np.all(status[good[15:20]] == vs.CrossingStatus.NO_PIXEL)
        assert np.all(status[good[10:15]] != vs.CrossingStatus.OK)
        np.testing.assert_allclose(
            off_cylinder_um(found.point_mm).ravel()[good[20:]], 0.0, atol=500
        )


def test_light_that_leaves_the_air_where_it_has_not_faded_is_told(hot, searched):
    nodes = hot.medium.nodes
    field = hot.medium.with_nodes(nodes[:, :, : nodes.shape[2] // 9])  # ends 1 mm above the part
    decoded = decoded_of(searched.projector_pixel, searched.status)
    found = reconstruct(hot, decoded, medium=field)
    status = found.status[np.isfinite(decoded.column)]
    assert 0.3 < np.mean(status == vs.CrossingStatus.UNCOVERED) < 0.6  # the light along the top


def test_what_cant_be_reconstructed_is_told(hot, searched):
    decoded = decoded_of(searched.projector_pixel, searched.status)
    no_row = SimpleNamespace(**vars(decoded) | {"row": None})
    assert reconstruct(hot.cold(), no_row).epipolar_px is None
    with pytest.raises(vs.InputError, match="no row was decoded"):
        reconstruct(hot, no_row, use="both")
    with pytest.raises(vs.InputError, match="load the scene with width=48 height=48"):
        reconstruct(vs.load_scene("fringe_cylinder", width=64, height=64), decoded)
    with pytest.raises(vs.InputError, match="pattern_projector"):
        reconstruct("hot_cylinder", decoded)
    relative = SimpleNamespace(**vars(decoded) | {"absolute": False})
    with pytest.raises(vs.InputError, match="whole periods"):
        reconstruct(hot, relative)
    nothing = decoded_of(np.full((SIZE * SIZE, 2), np.nan))
    assert not reconstruct(hot, nothing, medium=hot.medium).ok.any()


def test_no_pixel_is_lost_at_the_border_of_what_is_seen(hot):
    """Rationale: bent light lies beside straight light, and maps that ended with it lost 2 %."""
    scene = vs.load_scene("fringe_cylinder", width=24, height=24, pixel=44)
    v, u = np.mgrid[:24, :24]
    found = vs.projector_pixels(scene, np.stack([u.ravel(), v.ravel()], axis=1), march=QUICK)
    decoded = decoded_of(found.projector_pixel, size=(24, 24))
    image = reconstruct(scene, decoded, medium=scene.medium)
    assert image.ok.all()
    assert rms(off_cylinder_um(image.point_mm)) < 0.05


def test_a_telecentric_projector_gives_points_too(hot):
    """Its rays are parallel: pixels by orthogonal projection onto its axes."""
    pose = hot.projector.pose
    matrix = np.array([[20.0, 0.0, 639.5], [0.0, 20.0, 499.5], [0.0, 0.0, 1.0]])
    light = Telecentric(matrix, pose, (1280, 1000))
    points = seen(hot.camera, plane)
    local = (points - pose.origin_mm) @ pose.rotation
    decoded = decoded_of(20.0 * local[:, :2] + [639.5, 499.5])
    calibration = SimpleNamespace(camera=hot.camera, projector=light)
    for use in ("column", "both"):
        found = reconstruct(calibration, decoded, use=use)
        np.testing.assert_allclose(found.point_mm.reshape(-1, 3), points, atol=1e-9)
        assert np.abs(found.epipolar_px).max() < 1e-8
    bent = reconstruct(calibration, decoded, medium=hot.medium)
    assert bent.ok.all()
    assert 20.0 < 1e3 * np.abs(bent.point_mm.reshape(-1, 3) - points).max() < 1000.0


SPHERE = (
    '<shape type="sphere"><point name="center" x="0" y="0" z="-13.5"/>'
    '<float name="radius" value="13.5"/>'
)
PLANE = '<shape type="rectangle"><transform name="to_world"><scale value="60"/></transform>'


@pytest.mark.parametrize(
    ("part", "shape"),
    [(PLANE, vs.PlaneShape()), (SPHERE, vs.SphereShape(13.5, z_mm=-13.5))],
    ids=["plane", "sphere"],
)
def test_cold_surfaces_are_measured_within_a_micrometre(part, shape, tmp_path):
    """From rendered fringes to points: 64 x 64 of the camera's own pixels, without noise."""
    text = (shipped_scenes() / "fringe_cylinder.xml").read_text()
    bare = re.sub(r"<shape .*</shape>", f'{part}<ref id="steel"/></shape>', text, flags=re.DOTALL)
    (tmp_path / "part.xml").write_text(bare)
    scene = vs.load_scene(
        tmp_path / "part.xml", field="", width=64, height=64, pixel=5.5, pixels=False, spp=4
    )
    codec = vs.PhaseShift(size_px=scene.projector.size)
    decoded = codec.decode(vs.render_sequence(scene, codec.patterns).radiance)
    image = reconstruct(scene, decoded, use="both")
    assert image.ok.mean() > 0.99
    assert rms(image.deviation_um(shape)) < 0.1
    assert np.abs(image.epipolar_px[image.ok]).max() < 0.003


def test_far_backgrounds_and_few_wrong_pixels_have_points_as_marched_rays_have(hot):
    """The part's plane, a wall twice as far, and pixels of a wrong fringe order in between."""
    near, far = (
        seen(hot.camera, lambda o, d, z=z: (z - o[2]) / d[:, 2]).reshape(SIZE, SIZE, 3)
        for z in (0.0, -350.0)
    )
    points = np.where(np.arange(SIZE)[:, None, None] < 24, near, far)  # rows: along the cylinder
    wide = replace(hot.projector.family, matrix=np.diag([0.1, 0.1, 1.0]) @ MATRIX)
    pixel = by_opencv(wide, points.reshape(-1, 3))
    pixel[7 * SIZE : 7 * SIZE + 9, 0] += 60.0
    decoded = decoded_of(pixel)
    calibration = SimpleNamespace(camera=hot.camera, projector=wide)
    found = reconstruct(calibration, decoded, medium=hot.medium)
    scene = replace(hot, sources={"projector": replace(hot.projector, family=wide)})
    some = np.r_[7 * SIZE : 7 * SIZE + 9, 10 * SIZE + 3, 30 * SIZE + 20, 40 * SIZE + 9]
    u, v = some % SIZE, some // SIZE
    s, _ = wide.of_pixels(pixel[some])
    marched = vs.triangulated_points(
        scene, np.stack([u, v], axis=1), medium=hot.medium, coordinate=s, method="newton"
    )
    np.testing.assert_array_equal(found.status[v, u], marched.status)
    assert np.sum(marched.status == vs.CrossingStatus.OK) > 5
    np.testing.assert_allclose(found.point_mm[v, u], marched.point_mm, atol=2e-3)
    assert not np.any(found.status == vs.CrossingStatus.OFF)
