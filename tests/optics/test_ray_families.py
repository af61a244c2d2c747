"""Ray families: their formulas against each other's inverses, differences, geometry and OpenCV."""

from dataclasses import dataclass, replace

import artificial
import cv2
import numpy as np
import pytest
from numpy.testing import assert_allclose
from scipy.spatial.transform import Rotation

from virtual_sensor.engine import dr, mi
from virtual_sensor.errors import InputError
from virtual_sensor.optics.carried_rays import Motion, RayStarts
from virtual_sensor.optics.family_frames import FamilyFrame
from virtual_sensor.optics.ray_families import Pinhole, RayFamily, Sheet
from virtual_sensor.optics.trace import to_numpy
from virtual_sensor.poses import Pose

POSE = Pose(
    Rotation.from_euler("xyz", [20.0, -40.0, 110.0], degrees=True).as_matrix(),
    np.array([70.0, -30.0, 250.0]),
)
K = np.array([[6000.0, 0.0, 1023.5], [0.0, 6100.0, 1000.0], [0.0, 0.0, 1.0]])


@dataclass(frozen=True)
class Twist(RayFamily):
    """Rays of a ruled surface: those of one s lie in no plane."""

    pose: Pose
    per_mm: float

    def foot(self, s, t):
        return s, t

    def slope(self, s, t):
        return -self.per_mm * t, self.per_mm * s

    def straight(self, x, y, depth):
        g = self.per_mm * depth
        return (x + g * y) / (1.0 + g * g), (y - g * x) / (1.0 + g * g)

    def by_coordinates(self, s, t, depth):
        g = self.per_mm * depth
        return 1.0, -g, g, 1.0


FAMILIES = {
    "pinhole": (Pinhole(K, POSE, (2048, 2000)), 0.15),
    "telecentric sheet": (Sheet(POSE, 300.0), 30.0),
    "fanned sheet": (Sheet(POSE, 300.0, 2e-3), 30.0),
    "diverging sheet": (Sheet(POSE, 280.0, 1.0 / 280.0), 30.0),  # from one point of the exit
    "twist": (Twist(POSE, 1e-3), 30.0),
}


@pytest.fixture(params=FAMILIES, ids=lambda name: name.replace(" ", "-"))
def family(request):
    return FAMILIES[request.param][0]


@pytest.fixture
def places(request, family):
    """Coordinates and depths (N,) that the family's rays may have."""
    reach = next(reach for known, reach in FAMILIES.values() if known is family)
    s, t, depth = np.random.default_rng(1).uniform(-1.0, 1.0, (3, 50))
    return s * reach, t * reach, 260.0 + 60.0 * depth


def along(family, s, t, depth):
    """World points on rays, from their origins and directions alone."""
    origin, direction = family.rays(s, t)
    return origin + direction * (depth / (direction @ family.pose.rotation[:, 2]))[:, None]


def test_a_point_of_a_ray_has_the_rays_coordinates(family, places):
    found = family.coordinates(along(family, *places))
    assert_allclose(found, np.stack(places, axis=1), rtol=1e-12, atol=1e-10)


def test_rays_through_points_start_where_the_rays_do(family, places):
    s, t, _ = places
    found = family.origins(along(family, *places))
    assert_allclose(found, family.rays(s, t)[0], rtol=0, atol=1e-10)


def test_rays_are_where_their_place_says(family, places):
    s, t, depth = places
    local = family.pose.to_local(along(family, s, t, depth))
    assert_allclose(np.stack(family.place(s, t, depth), axis=1), local[:, :2], atol=1e-11)


def test_directions_are_of_length_one(family, places):
    s, t, _ = places
    assert_allclose(np.linalg.norm(family.rays(s, t)[1], axis=1), 1.0, rtol=1e-14)


def differences(function, s, t, reach):
    """Derivatives by s and t, by central differences."""
    e = 1e-4 * reach
    return [
        (function(s + e * i, t + e * j) - function(s - e * i, t - e * j)) / (2.0 * e)
        for i, j in ((1, 0), (0, 1))
    ]


def test_places_change_with_coordinates_as_differences_say(family, places):
    s, t, depth = places
    by_s, by_t = differences(
        lambda s, t: np.stack(family.place(s, t, depth)), s, t, np.abs(s).max()
    )
    x_s, x_t, y_s, y_t = np.broadcast_arrays(*family.by_coordinates(s, t, depth), s)[:4]
    scale = max(abs(by_s).max(), abs(by_t).max())
    assert_allclose([x_s, y_s], by_s, rtol=0, atol=1e-9 * scale)
    assert_allclose([x_t, y_t], by_t, rtol=0, atol=1e-9 * scale)


def test_a_tube_of_rays_spreads_as_its_corners_do(family, places):
    s, t, depth = places
    e = 1e-3 * np.abs(s).max()
    corners = [
        np.stack(family.place(s + e * i, t + e * j, depth))
        for i, j in ((-1, -1), (1, -1), (1, 1), (-1, 1))
    ]
    rounds = zip(corners, corners[1:] + corners[:1], strict=True)
    area = sum((x0 * y1 - x1 * y0) / 2.0 for (x0, y0), (x1, y1) in rounds)
    expected = area / (2.0 * e) ** 2
    assert_allclose(family.spread(s, t, depth) + 0.0 * s, expected, rtol=1e-6)


def test_starts_change_with_coordinates_as_differences_say(family, places):
    s, t, _ = places
    reach = np.abs(s).max()
    starts = RayStarts.of(family, s, t)
    assert_allclose([starts.origin, starts.direction], family.rays(s, t), atol=0)
    by = differences(lambda *c: np.array(family.rays(*c)), s, t, reach)
    for found, expected in zip(starts.by_coordinate, by, strict=True):
        for one, other in zip(found, expected, strict=True):
            assert_allclose(one, other, rtol=0, atol=1e-8 * max(1.0, abs(other).max()))


def test_starts_change_with_the_pose_as_differences_say(family, places):
    """By SciPy's rotations about a point."""
    s, t, _ = places
    motion = Motion(
        ("laser",), np.array([1.0, -2.0, 0.5]), np.array([0.02, 0.03, -0.01]), np.array([5.0, 6, 7])
    )

    def moved(amount):
        turn = Rotation.from_rotvec(amount * motion.turn_rad).as_matrix()
        at = turn @ (POSE.origin_mm - motion.pivot_mm) + motion.pivot_mm + amount * motion.shift_mm
        return replace(family, pose=Pose(turn @ POSE.rotation, at)).rays(s, t)

    e = 1e-3
    for found, plus, minus in zip(
        RayStarts.of(family, s, t).by_motion(motion), moved(e), moved(-e), strict=True
    ):
        assert_allclose(found, (plus - minus) / (2.0 * e), rtol=0, atol=1e-6)


def test_drjit_computes_the_same(family, places):
    """The formulas stand once; their world and their poses stand twice."""
    s, t, depth = places
    frame = FamilyFrame.of(family, mi.Array3f64)
    origins, directions = family.rays(s, t)
    origin, direction, _ = frame.rays(*(mi.Float64(c) for c in (s, t)))
    assert_allclose(to_numpy(origin), origins, atol=1e-11)
    assert_allclose(to_numpy(direction), directions, atol=1e-14)
    points = mi.Array3f64(*np.ascontiguousarray(along(family, s, t, depth).T))
    for found, expected in zip(frame.coordinates(points), places, strict=True):
        assert_allclose(np.array(found), expected, rtol=1e-12, atol=1e-10)


def test_one_kernel_serves_all_poses_and_parameters(family, places):
    s, t, _ = places
    other = replace(family, pose=Pose(np.eye(3), np.array([1.0, 2.0, 3.0])))
    if isinstance(family, Sheet):
        other = replace(other, fan_per_mm=0.7 * family.fan_per_mm + 1e-4, distance_mm=123.0)
    hashes = []
    for each in (family, other):
        frame = FamilyFrame.of(each, mi.Array3f)
        coordinates = [mi.Float(c.astype(np.float32)) * dr.opaque(mi.Float, 1.0) for c in (s, t)]
        dr.eval(coordinates)
        with dr.scoped_set_flag(dr.JitFlag.KernelHistory, True):
            dr.kernel_history_clear()
            dr.eval(frame.rays(*coordinates)[:2])
            history = dr.kernel_history([dr.KernelType.JIT])
        hashes.append([entry["hash"] for entry in history])
    assert hashes[0] == hashes[1] != []


# ----------------------------------------------------------------------------------------- planes


@pytest.mark.parametrize("name", ["pinhole", "telecentric sheet", "fanned sheet"])
def test_rays_of_one_first_coordinate_lie_in_their_plane(name):
    family, reach = FAMILIES[name]
    s = np.linspace(-reach, reach, 7)
    normal, offset = family.plane(s)
    assert_allclose(np.linalg.norm(normal, axis=1), 1.0, rtol=1e-14)
    for t in (-reach, 0.0, reach):
        for depth in (10.0, 300.0):
            points = along(family, s, np.full_like(s, t), np.full_like(s, depth))
            assert_allclose(np.sum(points * normal, axis=1), offset, rtol=0, atol=1e-10)
    assert family.plane(0.0)[0].shape == (3,)


def test_a_twisted_family_has_no_planes():
    with pytest.raises(InputError, match=r"rays of a Twist .* lie in no plane"):
        FAMILIES["twist"][0].plane(1.0)


# --------------------------------------------------------------------------------------- pinholes

LENSES = {
    "ideal": ([], False),
    "four terms": ([-0.2, 0.1, 1e-3, -2e-3], False),
    "eight terms": ([-0.2, 0.1, 1e-3, -2e-3, 0.02, 0.1, -0.05, 0.01], False),
    "tilted sensor": ([-0.1, 0.1, 1e-3, -2e-3, 0.0, 0.0, 0.0, 0.0, 0, 0, 0, 0, 0.05, -0.1], False),
    "fisheye": ([0.1, -0.05, 0.01, 0.0], True),
}


@pytest.fixture(params=LENSES, ids=lambda name: name.replace(" ", "-"))
def lens(request):
    terms, fisheye = LENSES[request.param]
    return replace(FAMILIES["pinhole"][0], distortion=np.array(terms, float), fisheye=fisheye)


def opencv_pixels(camera, points):
    """OpenCV's projection of world points."""
    turn, shift = camera.pose.rotation.T, -camera.pose.rotation.T @ camera.pose.origin_mm
    given = points[:, None], cv2.Rodrigues(turn)[0], shift, camera.matrix, camera.distortion
    if camera.fisheye:
        return cv2.fisheye.projectPoints(*given)[0][:, 0]
    return cv2.projectPoints(*given)[0][:, 0]


def test_pixels_are_opencvs(lens):
    rng = np.random.default_rng(2)
    p, q = rng.uniform(-0.16, 0.16, (2, 40))
    points = along(lens, p, q, np.full_like(p, 300.0))
    expected = opencv_pixels(lens, points)
    assert_allclose(lens.pixels(p, q), expected, rtol=0, atol=1e-8)
    assert_allclose(lens.project(points), expected, rtol=0, atol=1e-8)


def test_what_pixels_see_is_opencvs(lens):
    """OpenCV's own search for the undistorted point stops at 1e-7, or so."""
    pixel = np.random.default_rng(3).uniform(0.0, 2000.0, (40, 2))
    found = np.stack(lens.of_pixels(pixel), axis=1)
    until = (cv2.TERM_CRITERIA_COUNT + cv2.TERM_CRITERIA_EPS, 200, 1e-12)
    known = cv2.fisheye.undistortPoints if lens.fisheye else cv2.undistortPoints
    expected = known(pixel[:, None], lens.matrix, lens.distortion, criteria=until)
    assert_allclose(found, expected[:, 0], rtol=0, atol=1e-7)
    assert_allclose(lens.pixels(*found.T), pixel, rtol=0, atol=1e-8)


def test_pixels_change_with_coordinates_as_differences_say(lens):
    p, q = np.random.default_rng(4).uniform(-0.15, 0.15, (2, 40))
    expected = differences(lens.pixels, p, q, 1e-1)
    assert_allclose(lens.pixel_slopes(p, q), np.stack(expected, axis=-1), rtol=0, atol=0.02)
    assert lens.pixel_slopes(p, q)[..., 0, 0].min() > 5000.0


def test_a_pixel_is_as_large_as_what_it_sees(lens):
    """In the middle of the image: two points beside each other, a pixel apart."""
    p, q = lens.of_pixels([[1023.5, 1000.0], [1024.5, 1000.0]])
    points = along(lens, p, q, np.full(2, 280.0))
    apart = np.linalg.norm(points[1] - points[0])
    assert_allclose(lens.pixel_mm(points), apart, rtol=0.02)


def test_numbers_of_any_size_warn_of_nothing(lens):
    """Rationale: a script that treats warnings as errors must not stop at one bad pixel."""
    for size in (1e150, 1e300, np.inf, np.nan):
        lines = lens.lines_of_sight([[size, 5.0], [5.0, -size]])
        lengths = np.linalg.norm(lines, axis=1)
        assert np.all(np.isnan(lengths) | (np.abs(lengths - 1.0) < 1e-12)), size
        pixel = lens.project([[size, 0.0, 0.0], [0.0, size, -size]])
        assert pixel.shape == (2, 2), size


def test_the_papers_camera_is_a_pinhole():
    """`artificial` describes it apart from the scenes: its axis meets the origin, 300 mm away."""
    camera = artificial.paper_sensor().camera
    assert_allclose(camera.project([[0.0, 0.0, 0.0]]), [[1023.5, 1023.5]], atol=1e-9)
