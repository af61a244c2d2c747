"""The ray search: against SciPy end to end, the paper's method against Newton's, each status."""

from dataclasses import replace
from itertools import product
from types import SimpleNamespace

import numpy as np
import oracles
import pytest

import virtual_sensor as vs
from virtual_sensor import ray_search
from virtual_sensor.engine import mi
from virtual_sensor.errors import InputError
from virtual_sensor.optics.ray_search import METHODS, REFERENCE, SearchStatus
from virtual_sensor.optics.surfaces import SceneSurface

NINE = np.linspace(0.0, -10.0, 9)
PIXEL_UM = 22.0  # on the object: 5.5 um, 300 mm and 75 mm


@pytest.fixture(scope="module")
def scene():
    return vs.load_scene("hot_cylinder")


@pytest.fixture(scope="module")
def newton(scene):
    return ray_search(scene, NINE, "newton")


@pytest.fixture(scope="module")
def paper(scene):
    return ray_search(scene, NINE, "paper")


def entered(field, origins, directions):
    """Where straight rays from outside enter the field's box."""
    with np.errstate(divide="ignore"):
        crossings = (field.box[:, None] - origins) / directions
    near = crossings.min(axis=0).max(axis=1, keepdims=True)
    return origins + near * directions


def above_cylinder(points):
    return np.hypot(points[:, 1], points[:, 2] + 13.5) - 13.5


def scipys_hits(field, index, origins, directions):
    """Where SciPy's rays meet the paper's cylinder: points (N, 3)."""
    starts = entered(field, origins, directions)
    to_top = np.min(-starts[:, 2] / directions[:, 2])
    rays = oracles.integrate(index, starts, directions, to_top + 15.0)
    arcs = rays.arcs_to(above_cylinder, to_top - 15.0, to_top + 15.0)
    return np.array([rays.position(s)[i] for i, s in enumerate(arcs)])


@pytest.mark.parametrize("rays", [5, pytest.param(50, marks=pytest.mark.slow)])
def test_newtons_pixels_are_scipys(scene, rays):
    """Laser rays to the cylinder and as many lines of sight back to it, to 1e-5 px.

    SciPy has its own spline through the nodes, its own integrator and its own variable, arc length;
    where its line of sight misses its laser point, the pixel was wrong by as much.
    """
    y = np.linspace(-10.5, 10.5, rays)
    found = ray_search(scene, y, "newton")
    assert np.all(found.status == SearchStatus.FOUND)
    field, camera = scene.field, scene.sensor.camera
    index = oracles.spline_index(field.nodes, field.origin, field.spacing, field.mirror)
    laser_points = scipys_hits(field, index, *scene.sensor.laser.family.rays(0.0, y))
    sight = camera.lines_of_sight(found.pixel)
    seen = scipys_hits(field, index, np.tile(camera.pose.origin_mm, (rays, 1)), sight)
    for difference in (found.laser_point_mm - laser_points, seen - laser_points):
        on_sensor = difference @ camera.pose.rotation[:, :2]
        assert np.linalg.norm(on_sensor, axis=1).max() * 1e3 / PIXEL_UM < 1e-5
    straight = np.linalg.norm(camera.project(laser_points) - found.pixel, axis=1)
    assert straight.max() > 1.0  # px: what refraction does, and the search has found


def test_newton_meets_the_laser_point_in_few_marches(newton):
    assert np.all(newton.status == SearchStatus.FOUND)
    assert newton.distance_um.max() < 1e-6
    assert newton.iterations.max() <= 6
    np.testing.assert_allclose(newton.seen_point_mm, newton.laser_point_mm, rtol=0, atol=1e-9)


def test_the_papers_search_ends_within_a_micrometre(paper):
    """Its stop criterion, r_max = 1 um, within its k_stop = 15 steps, for its nine rays."""
    assert np.all(paper.status == SearchStatus.FOUND)
    assert paper.distance_um.max() < 1.0
    assert paper.iterations.max() <= 15
    on_cylinder = [above_cylinder(p) for p in (paper.laser_point_mm, paper.seen_point_mm)]
    np.testing.assert_allclose(on_cylinder, 0.0, rtol=0, atol=1e-9)


def test_both_searches_find_the_same_pixels(paper, newton):
    """Within the paper's own radius; its distances are those between its two points."""
    np.testing.assert_allclose(paper.laser_point_mm, newton.laser_point_mm, rtol=0, atol=1e-12)
    apart = np.linalg.norm(paper.pixel - newton.pixel, axis=1)
    assert apart.max() * PIXEL_UM < 1.05  # refraction itself magnifies by a few per cent
    assert apart.min() > 0.0


def test_distances_are_parallel_to_the_sensor(scene, paper):
    """Equation 3's pixel size turns them into pixels, which depth along the axis must not."""
    camera = scene.sensor.camera
    apart = camera.project(paper.seen_point_mm) - camera.project(paper.laser_point_mm)
    in_pixels = np.linalg.norm(apart, axis=1) * PIXEL_UM
    np.testing.assert_allclose(paper.distance_um, in_pixels, rtol=0.05)


@pytest.mark.parametrize("method", ["newton", "paper"])
def test_left_and_right_of_the_cylinder_are_mirror_images(scene, method):
    """The field is even in y, and u runs along y about the middle of the image."""
    y = np.array([2.0, 5.0, 7.5, 10.0])
    left, right = ray_search(scene, -y, method), ray_search(scene, y, method)
    flip = np.array([1.0, -1.0, 1.0])
    np.testing.assert_allclose(right.laser_point_mm, flip * left.laser_point_mm, rtol=0, atol=1e-9)
    if method == "newton":  # the paper's steps are not symmetric
        middle = scene.sensor.camera.matrix[0, 2]
        mirrored = np.stack([2.0 * middle - left.pixel[:, 0], left.pixel[:, 1]], axis=-1)
        np.testing.assert_allclose(right.pixel, mirrored, rtol=0, atol=1e-7)
        np.testing.assert_allclose(right.seen_point_mm, flip * left.seen_point_mm, atol=1e-9)


def test_the_middle_ray_stays_in_the_middle(newton):
    """At y = 0 symmetry leaves only the height: B lies on the top line, its pixel on c_x."""
    np.testing.assert_allclose(newton.laser_point_mm[0, 1:], 0.0, rtol=0, atol=1e-12)
    assert newton.pixel[0, 0] == pytest.approx(1023.5, abs=1e-9)


def test_cold_light_is_found_at_once(scene):
    """The start pixel of step 2.1 is the straight projection, and light runs straight."""
    for method in METHODS:
        found = ray_search(scene.cold(), NINE, method)
        expected = scene.sensor.camera.project(found.laser_point_mm)
        assert np.all(found.status == SearchStatus.FOUND), method
        assert found.distance_um.max() < 1e-8, method
        np.testing.assert_allclose(found.pixel, expected, rtol=0, atol=1e-9, err_msg=f"{method=}")
        np.testing.assert_allclose(
            found.laser_point_mm[:, 1], NINE, rtol=0, atol=1e-12, err_msg=f"{method=}"
        )
        assert np.all(found.iterations == {"paper": 1, "newton": 2, "tabulated": 0}[method]), method


# ------------------------------------------------------------------------------------- statuses


def test_a_ray_beside_the_cylinder_has_no_pixel(scene):
    """And does not disturb its neighbours; nor do they need it."""
    for case in product((True, False), METHODS):
        hot, method = case
        found = ray_search(scene if hot else scene.cold(), [-4.0, 20.0, -6.0, -15.0], method)
        missed = np.array([False, True, False, True])
        np.testing.assert_array_equal(
            found.status == SearchStatus.LASER_MISSED, missed, err_msg=f"{case}"
        )
        np.testing.assert_array_equal(
            found.status == SearchStatus.FOUND, ~missed, err_msg=f"{case}"
        )
        for values in (found.laser_point_mm, found.pixel, found.seen_point_mm):
            np.testing.assert_array_equal(np.isnan(values).all(axis=1), missed, err_msg=f"{case}")
        np.testing.assert_array_equal(np.isnan(found.distance_um), missed, err_msg=f"{case}")
        assert np.all(found.iterations[missed] == 0), case


def test_no_ray_at_all_may_meet_the_cylinder(scene):
    """Then there is nothing to march back to; a single ray may come as a plain number."""
    for method in METHODS:
        found = ray_search(scene, [20.0, 15.0], method)
        np.testing.assert_array_equal(found.status, SearchStatus.LASER_MISSED, err_msg=f"{method=}")
        found = ray_search(scene.cold(), 20.0, method)
        assert found.pixel.shape == (1, 2), method
        np.testing.assert_array_equal(found.status, SearchStatus.LASER_MISSED, err_msg=f"{method=}")


@pytest.mark.parametrize(
    ("laser", "lit"),
    [
        ({"line_length": 6}, [0.0, -1.25, -2.5]),
        pytest.param({"line_length": 6, "fan": 1}, [0.0, -1.25, -2.5], marks=pytest.mark.slow),
        pytest.param({"line_length": 20}, NINE, marks=pytest.mark.slow),  # to its very end
        ({"dots": "-2.5 -5.1"}, [-2.5, -5.0]),  # 0.1 mm beside the middle of a dot
        ({"dots": "-12"}, []),
    ],
    ids=str,
)
def test_a_ray_without_light_is_unlit_and_has_no_figure(laser, lit):
    """Rationale: of a line of 6 mm all nine rays were found, to y = -10 mm."""
    scene, dark = vs.load_scene("hot_cylinder", **laser), ~np.isin(NINE, lit)
    for method in METHODS:
        found = ray_search(scene, NINE, method)
        np.testing.assert_array_equal(
            found.status == SearchStatus.UNLIT, dark, err_msg=f"{method=}"
        )
        np.testing.assert_array_equal(
            found.status == SearchStatus.FOUND, ~dark, err_msg=f"{method=}"
        )
        for values in (found.laser_point_mm, found.pixel, found.seen_point_mm, found.distance_um):
            np.testing.assert_array_equal(
                np.isnan(values).reshape(9, -1).all(axis=1), dark, err_msg=f"{method=}"
            )
        assert np.all(found.iterations[dark] == 0), method


def test_a_grid_too_small_leaves_the_point_above_the_radius(scene, newton):
    """One pixel wide, it can't reach what refraction moves by several; the best is told."""
    found = ray_search(scene, NINE, "paper", grid_px=(1.0, 1.0))
    far = np.abs(scene.sensor.camera.project(newton.laser_point_mm) - newton.pixel) > 1.1
    expected = np.where(far.any(axis=1), SearchStatus.ABOVE_RADIUS, found.status)
    np.testing.assert_array_equal(found.status, expected)
    above = found.status == SearchStatus.ABOVE_RADIUS
    assert above.any()
    assert np.all(found.distance_um[above] > 1.0)
    depth = (found.seen_point_mm - found.laser_point_mm) @ scene.sensor.camera.pose.rotation[:, 2]
    np.testing.assert_array_equal(np.isfinite(found.pixel[:, 0]), np.abs(depth) <= 0.1)
    assert np.all(found.iterations[above] == 15)


def test_a_pixel_beside_the_sensor_is_not_used(scene, newton):
    """A narrower sensor about the same axis loses the outer rays."""
    camera = replace(scene.sensor.camera, size=(900, 2048))
    narrow = SimpleNamespace(
        camera=camera, source=scene.source, medium=scene.medium, surface=scene.surface
    )
    outside = newton.pixel[:, 0] > 899.5
    assert 0 < outside.sum() < len(NINE)
    for method in METHODS:
        found = ray_search(narrow, NINE, method)
        np.testing.assert_array_equal(
            found.status == SearchStatus.OUTSIDE_IMAGE, outside, err_msg=f"{method=}"
        )
        np.testing.assert_array_equal(
            np.isnan(found.pixel).all(axis=1), outside, err_msg=f"{method=}"
        )
        assert np.all(np.isfinite(found.laser_point_mm)), method


def test_something_in_the_line_of_sight_is_an_undercut(scene):
    """A bead before the camera hides one laser point; its pixel sees the bead and is not used."""
    cold = scene.cold()
    free = ray_search(cold, [-2.0, -4.0, -6.0], "newton")
    toward = scene.sensor.camera.pose.origin_mm - free.laser_point_mm[1]
    bead = free.laser_point_mm[1] + 20.0 * oracles.unit(toward)
    surface = SceneSurface(
        mi.load_dict(
            {
                "type": "scene",
                "part": {
                    "type": "cylinder",
                    "p0": [-85, 0, -13.5],
                    "p1": [85, 0, -13.5],
                    "radius": 13.5,
                },
                "bead": {"type": "sphere", "center": bead.tolist(), "radius": 1.0},
            }
        )
    )
    screened = SimpleNamespace(camera=cold.camera, source=cold.source, medium=None, surface=surface)
    for method in METHODS:
        found = ray_search(screened, [-2.0, -4.0, -6.0], method)
        expected = [SearchStatus.FOUND, SearchStatus.UNDERCUT, SearchStatus.FOUND]
        np.testing.assert_array_equal(found.status, expected, err_msg=f"{method=}")
        assert np.all(np.isnan(found.pixel[1])), method
        assert np.linalg.norm(found.seen_point_mm[1] - bead) == pytest.approx(1.0, abs=1e-4), method


def test_an_unknown_method_is_refused(scene):
    with pytest.raises(InputError, match="take one of paper, newton, tabulated"):
        ray_search(scene, NINE, "secant")


# --------------------------------------------------------------------------------------- by maps


@pytest.mark.parametrize(
    ("rays", "tolerances_px"),
    [
        (50, (1e-2, 1e-3)),
        pytest.param(200, (1e-2, 1e-3, 1e-4), marks=pytest.mark.slow),
    ],
)
def test_the_search_by_maps_keeps_its_tolerance(scene, rays, tolerances_px):
    """Rationale: its pixels are Newton's to within what was asked for, and so are its points."""
    y = np.random.default_rng(1).uniform(-10.9, 10.9, rays)
    exact = ray_search(scene, y, "newton", march=REFERENCE)
    for tolerance_px in tolerances_px:
        found = ray_search(scene, y, "tabulated", tolerance_px=tolerance_px)
        np.testing.assert_array_equal(found.status, exact.status, err_msg=f"{tolerance_px=}")
        assert np.abs(found.pixel - exact.pixel).max() <= tolerance_px
        off_um = 1e3 * np.linalg.norm(found.laser_point_mm - exact.laser_point_mm, axis=1)
        assert off_um.max() <= 2.0 * tolerance_px * PIXEL_UM
        assert found.distance_um.max() < 1e-2, tolerance_px
        assert found.iterations.max() == 0, tolerance_px  # no line of sight was marched


@pytest.mark.parametrize(
    ("name", "parameters", "y"),
    [
        ("stepped_shaft", {}, np.linspace(-11.5, 11.5, 601)),
        ("hot_cylinder", {"line_length": 28, "beta": 20}, np.linspace(-13.6, 13.6, 401)),
        ("hot_cylinder", {"fan": 3, "alpha": 40}, np.linspace(-10.9, 10.9, 201)),
        ("cold_cylinder", {}, np.linspace(-13.6, 13.6, 201)),
    ],
    ids=lambda each: each if isinstance(each, str) else "",
)
def test_the_search_by_maps_has_newtons_statuses(name, parameters, y):
    """Rationale: undercuts, the limb, what is missed and unlit; a ray in 200 may be borderline."""
    scene = vs.load_scene(name, **parameters)
    exact = ray_search(scene, y, "newton", march=replace(REFERENCE, step_mm=0.5))
    found = ray_search(scene, y, "tabulated")
    other = found.status != exact.status
    assert other.mean() <= 0.005
    both = ~other & np.isfinite(found.pixel[:, 0])
    assert both.sum() > 0.5 * len(y)
    grazing = exact.distance_um > 1e-2
    assert np.abs(found.pixel - exact.pixel)[both & ~grazing].max() <= 0.005


def test_rays_without_a_map_are_searched_by_newtons_method(scene):
    """Rationale: no ray is lost, and none is made up, where a tolerance can't be met."""
    y = [-5.0, 0.0, np.nan, 30.0]
    found = ray_search(scene, y, "tabulated", tolerance_px=1e-9)
    exact = ray_search(scene, y, "newton")
    np.testing.assert_array_equal(found.status, exact.status)
    np.testing.assert_allclose(found.pixel, exact.pixel, atol=1e-9)
    assert found.iterations.max() > 0


def test_thousands_of_rays_and_none_are_searched_by_maps(scene):
    """Rationale: what is looked up does not depend on how many rays there are, or on which."""
    y = np.linspace(-10.9, 10.9, 5001)
    many = ray_search(scene, y, "tabulated")
    assert (many.status == SearchStatus.FOUND).all()
    few = ray_search(scene, y[::1000], "tabulated")
    np.testing.assert_allclose(few.pixel, many.pixel[::1000], atol=1e-3)
    assert ray_search(scene, [], "tabulated").pixel.shape == (0, 2)


def test_rays_far_beside_the_line_are_no_burden_to_the_maps(scene):
    """Rationale: a box that holds numbers which overflow has no map; such rays are missed."""
    y = np.array([1.0, 1e300, -1e15, np.inf, np.nan, 300.0, 1e-300])
    found, exact = (ray_search(scene, y, method) for method in ("tabulated", "newton"))
    np.testing.assert_array_equal(found.status, exact.status)
    assert found.iterations[0] == 0


def test_rays_that_graze_the_part_are_not_left_to_the_maps():
    """Rationale: at the limb a thousandth of a pixel across the ray is one along the surface."""
    scene = vs.load_scene("hot_cylinder", line_length=28)
    y = np.linspace(13.0, 13.6, 301)
    exact = ray_search(scene, y, "newton", march=replace(REFERENCE, step_mm=0.5))
    found = ray_search(scene, y, "tabulated")
    both = (found.status == SearchStatus.FOUND) & (exact.status == SearchStatus.FOUND)
    assert both.sum() > 200
    assert np.abs(found.pixel - exact.pixel)[both].max() < 0.01
    assert (found.iterations > 0).any()  # they were marched
