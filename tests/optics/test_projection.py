"""Points to pixels through a medium, against marched lines of sight and SciPy's integrator."""

from dataclasses import replace

import numpy as np
import pytest
from oracles import integrate, unit

import virtual_sensor as vs
from virtual_sensor.errors import InputError
from virtual_sensor.medium.exact_fields import hot_spot
from virtual_sensor.optics.projection import ProjectionStatus, projected_points
from virtual_sensor.optics.ray_families import Pinhole
from virtual_sensor.optics.sight import seen_points
from virtual_sensor.poses import Pose

DEPTH, WIDTH_MM = 0.006, 8.0
MATRIX = np.array([[4000.0, 0.0, 511.5], [0.0, 4000.0, 511.5], [0.0, 0.0, 1.0]])
METHODS = "tabulated", "newton"
LENS = np.array([-0.2, 0.1, 1e-3, -2e-3, 0.05])


@pytest.fixture(scope="module")
def scene():
    return vs.load_scene("hot_cylinder")


@pytest.fixture(scope="module")
def points(scene):
    """10,000 world points up to 10 mm above what the camera sees of the part, and beside it."""
    rng, camera = np.random.default_rng(0), scene.camera
    pixel = rng.uniform([0.0, 0.0], camera.size, (10_000, 2))
    sight = camera.lines_of_sight(pixel)
    depth = camera.pose.to_local(seen_points(scene.cold(), pixel))[:, 2]
    above = np.where(np.isfinite(depth), depth, 305.0) - rng.uniform(0.0, 10.0, len(depth))
    along = above / (sight @ camera.pose.rotation[:, 2])
    return camera.pose.origin_mm + sight * along[:, None]


@pytest.fixture(scope="module")
def some(points):
    """Every tenth of them."""
    return points[::10]


@pytest.fixture(scope="module")
def marched(scene, some):
    """Their pixels by Newton's method."""
    return projected_points(scene, some, method="newton")


def spot(box_mm=50.0):
    """A field in closed form, and n with its gradient for SciPy."""

    def index(p):
        dip = DEPTH * np.exp(-np.sum(p**2, axis=1) / (2.0 * WIDTH_MM**2))
        n = np.sqrt(1.0 - dip)
        return n, p * (dip / (2.0 * n * WIDTH_MM**2))[:, None]

    return hot_spot(DEPTH, WIDTH_MM, box=np.array([[-box_mm] * 3, [box_mm] * 3])), index


def looking(origin, distortion=()):
    """A camera of 1024 px that looks from a place to the world's origin."""
    z = -unit(origin)
    x = unit(np.cross([0.0, 1.0, 0.0], z))
    pose = Pose(np.stack([x, np.cross(z, x), z], axis=1), np.asarray(origin, float))
    return Pinhole(MATRIX, pose, (1024, 1024), np.asarray(distortion, float))


def seen_by(scene, camera, medium):
    """The scene with another camera, in another medium."""
    return replace(scene, cameras={"camera": camera}, medium=medium)


@pytest.mark.slow
def test_ten_thousand_points_have_the_pixels_of_marched_lines_of_sight(scene, points):
    """Rationale: 0.002 px is a tenth of what a detector resolves; the air moves them by 8 px."""
    marched = projected_points(scene, points, method="newton")
    pixel = vs.project(scene, points)
    assert (marched.status == ProjectionStatus.OK).all()
    assert 0.0 < np.abs(pixel - marched.pixel).max() <= 0.002  # by a map: they are not the same
    assert np.abs(scene.camera.project(points) - marched.pixel).max() > 5.0


@pytest.mark.parametrize("tolerance_px", [0.02, 0.005, pytest.param(0.002, marks=pytest.mark.slow)])
def test_the_error_keeps_the_tolerance_that_is_asked_for(scene, some, marched, tolerance_px):
    """Rationale: who needs less has it sooner."""
    found = projected_points(scene, some, method="tabulated", tolerance_px=tolerance_px)
    assert np.abs(found.pixel - marched.pixel).max() <= tolerance_px


@pytest.mark.parametrize("method", METHODS)
@pytest.mark.parametrize("lens", [(), LENS], ids=["pinhole", "lens"])
@pytest.mark.parametrize("origin", [(0.0, -150.0, 60.0), (25.0, 20.0, 10.0)], ids=["out", "in"])
def test_lines_of_sight_of_the_pixels_go_through_the_points(scene, method, lens, origin):
    """Rationale: SciPy follows the light from the camera, which may stand in the hot air itself."""
    medium, index = spot()
    camera = looking(origin, lens)
    far = np.linalg.norm(origin)
    rng = np.random.default_rng(3)
    sight = camera.lines_of_sight(rng.uniform(100.0, 900.0, (40, 2)))
    points = camera.pose.origin_mm + sight * rng.uniform(0.8, 1.2, (40, 1)) * far
    found = projected_points(seen_by(scene, camera, medium), points, method=method)
    assert (found.status == ProjectionStatus.OK).all()
    starts = np.broadcast_to(camera.pose.origin_mm, points.shape)
    rays = integrate(index, starts, camera.lines_of_sight(found.pixel), 1.5 * far)
    axis = camera.pose.rotation[:, 2]
    arcs = rays.arcs_to(lambda p: (p - points) @ axis, 0.1 * far, 1.5 * far)
    ends = np.stack([rays.position(arc)[i] for i, arc in enumerate(arcs)])
    off_px = np.linalg.norm(ends - points, axis=1) / ((points - starts) @ axis) * MATRIX[0, 0]
    assert off_px.max() < (0.002 if method == "tabulated" else 1e-4)
    straight = camera.project(points)
    assert np.linalg.norm(found.pixel - straight, axis=1).max() > 1.0


@pytest.mark.parametrize("lens", [(), LENS], ids=["pinhole", "lens"])
def test_straight_light_is_equation_2(scene, lens):
    """Rationale: without air, and where none is asked for, to the last bit."""
    camera = looking((0.0, -150.0, 60.0), lens)
    points = np.random.default_rng(1).uniform(-25.0, 25.0, (200, 3))
    expected = camera.project(points)
    for straight in (
        vs.project(seen_by(scene, camera, spot()[0]), points, through_medium=False),
        vs.project(seen_by(scene, camera, None), points),
    ):
        np.testing.assert_array_equal(straight, expected)
    assert not camera.inside(expected).all()


@pytest.mark.parametrize("method", METHODS)
def test_why_a_point_has_no_pixel_is_said(scene, method):
    """Rationale: a NaN alone leaves a user puzzled."""
    camera, pose = scene.camera, scene.camera.pose
    inside = pose.to_world([[0.0, 0.0, 290.0]])
    behind, level = pose.to_world([[0.0, 0.0, -10.0], [5.0, 0.0, 0.0]])
    beside, far_off = pose.to_world([[30.0, 0.0, 290.0], [200.0, 0.0, 290.0]])
    points = np.vstack([inside, behind, level, beside, far_off, [np.nan, 0, 0], [np.inf, 0, 0]])
    found = projected_points(scene, points, method=method)
    status = ProjectionStatus
    expected = [status.OK, status.BEHIND, status.BEHIND, status.OK, status.OFF]
    expected += [status.NO_POINT] * 2
    np.testing.assert_array_equal(found.status, expected)
    np.testing.assert_array_equal(np.isfinite(found.pixel).all(axis=1), found.status == status.OK)
    assert not camera.inside(found.pixel[3:4]).any()
    straight = projected_points(scene, points, through_medium=False)
    np.testing.assert_array_equal(straight.status[:5], [0, 1 + 1, 1 + 1, 0, 0])


def test_the_shape_follows_the_points(scene, some, marched):
    """Rationale: none, one, a block: a script need not count; one is found as among thousands."""
    assert vs.project(scene, []).shape == (0, 2)
    assert vs.project(scene, np.zeros((0, 3))).shape == (0, 2)
    one = vs.project(scene, some[7])
    assert one.shape == (2,)
    np.testing.assert_allclose(one, marched.pixel[7], atol=0.001)
    block = vs.project(scene, some[:60].reshape(4, 15, 3))
    np.testing.assert_allclose(block.reshape(60, 2), marched.pixel[:60], atol=0.002)


@pytest.mark.slow
def test_points_anywhere_have_their_pixels(scene):
    """Rationale: on the field's border and beyond it, within the part, and close to the camera."""
    low, high = scene.medium.box
    rng = np.random.default_rng(5)
    border = rng.uniform(low, high, (60, 3))
    border[:30, 0] = rng.choice([low[0], high[0]], 30)
    border[30:, 2] = rng.choice([low[2], high[2]], 30)
    within = np.column_stack(
        [rng.uniform(-20, 20, 20), rng.uniform(-8, 8, 20), rng.uniform(-22, -5, 20)]
    )
    near = scene.camera.pose.to_world(rng.uniform([-0.5, -0.5, 2.0], [0.5, 0.5, 60.0], (30, 3)))
    points = np.vstack([border, within, near])
    found = projected_points(scene, points, method="tabulated")
    exact = projected_points(scene, points)
    np.testing.assert_array_equal(found.status, exact.status)
    seen = found.status == ProjectionStatus.OK
    assert seen.sum() > 50
    assert np.abs(found.pixel - exact.pixel)[seen].max() <= 0.002


@pytest.mark.parametrize("method", METHODS)
def test_behind_a_strong_lens_a_point_has_no_single_pixel(scene, method):
    """Rationale: beyond the caustic several lines of sight meet in a point; before it one does."""
    box = np.array([[-60.0] * 3, [60.0] * 3])
    lens = hot_spot(-0.5, WIDTH_MM, box=box)  # denser in its middle: it gathers light
    camera = looking((0.0, 0.0, 150.0))
    scene = seen_by(scene, camera, lens)
    x = np.linspace(-1.0, 1.0, 5)
    before = np.column_stack([x, 0.0 * x, 0.0 * x + 40.0])
    beyond = before * [1.0, 1.0, -1.0] * [0.1, 1.0, 1.2]
    found = projected_points(scene, np.vstack([before, beyond]), method=method)
    assert (found.status[:5] == ProjectionStatus.OK).all()
    other = projected_points(scene, before, method=METHODS[method == METHODS[0]])
    np.testing.assert_allclose(found.pixel[:5], other.pixel, atol=0.002)
    assert (found.status[5:] == ProjectionStatus.FOLDED).all()
    assert np.isnan(found.pixel[5:]).all()


@pytest.mark.parametrize(
    ("ask", "said"),
    [
        (lambda scene: vs.project(scene, np.zeros((4, 2))), r"shape \(4, 2\); give it \(N, 3\)"),
        (lambda scene: vs.project(scene, "abc"), "give real numbers"),
        (lambda scene: vs.project(scene, [[1, 2, 3], [1, 2]]), "give real numbers"),
        (lambda scene: vs.project(scene, 1j * np.ones((2, 3))), "give real numbers"),
        (lambda scene: vs.project(scene, [[0, 0, 0]], camera="left"), "camera"),
        (lambda _: vs.project(5, [[0, 0, 0]]), "load_scene"),
        (lambda scene: projected_points(scene, [[0, 0, 0]], method="paper"), "tabulated, newton"),
        (lambda scene: projected_points(scene, [[0, 0, 0]], tolerance_px=0.0), "tolerance_px is"),
    ],
)
def test_what_cannot_be_projected_is_told(scene, ask, said):
    """Rationale: one line that names the argument and the remedy."""
    with pytest.raises(InputError, match=said):
        ask(scene)


def test_masked_and_impossible_points_have_no_pixel(scene):
    """Rationale: a mask is no place, and numbers that overflow are none that a camera sees."""
    masked = np.ma.masked_greater(np.array([[0.0, 0.0, -1.0], [0.0, 5.0, -1.0]]), 4.0)
    found = projected_points(scene, masked)
    np.testing.assert_array_equal(found.status, [0, ProjectionStatus.NO_POINT])
    huge = np.array([[1e300, 0.0, 0.0], [0.0, -1e300, 1e300], [1e-300, 0.0, 1e15]])
    for method in METHODS:
        found = projected_points(scene, huge, method=method)
        assert not (found.status == ProjectionStatus.OK).any()
        assert np.isnan(found.pixel).all()
