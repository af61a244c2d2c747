"""Bent triangulation: searched pixels give back their points; SciPy's rays meet in them."""

import re
from dataclasses import dataclass, replace
from itertools import product

import numpy as np
import pytest
from oracles import integrate, unit
from scipy.spatial.transform import Rotation

import virtual_sensor as vs
from virtual_sensor.errors import InputError
from virtual_sensor.imaging.scene_file import find_scene
from virtual_sensor.medium.exact_fields import hot_spot
from virtual_sensor.metrology.calibration import calibration_of
from virtual_sensor.metrology.triangulation import triangulated_points
from virtual_sensor.optics.bent_points import bent_points, marched_crossings
from virtual_sensor.optics.crossing_status import CrossingStatus
from virtual_sensor.optics.crossings import crossings
from virtual_sensor.optics.projection import projected_points
from virtual_sensor.optics.ray_families import Pinhole, RayFamily, Sheet
from virtual_sensor.optics.ray_maps import NoMapError
from virtual_sensor.optics.sensitivity import laser_y_at
from virtual_sensor.poses import Pose

MATRIX = np.array([[4000.0, 0.0, 511.5], [0.0, 4000.0, 511.5], [0.0, 0.0, 1.0]])
DEPTH, WIDTH_MM = 0.006, 8.0
LENS = (-0.2, 0.1, 1e-3, -2e-3, 0.05)
UM = 1e3


@pytest.fixture(scope="module")
def scene():
    return vs.load_scene("hot_cylinder")


@pytest.fixture(scope="module")
def pairs(tmp_path_factory):
    """The hot cylinder with two cameras and two lasers."""
    text = find_scene("hot_cylinder").read_text(encoding="utf-8")
    folder = find_scene("hot_cylinder").parent / "fields"
    camera, laser = (
        re.search(rf"<{tag}.*?</{tag}>", text, re.DOTALL)[0] for tag in ("sensor", "emitter")
    )
    others = camera.replace('id="camera"', 'id="steep"').replace('"$alpha"', '"80"')
    others += laser.replace('id="laser"', 'id="upright"').replace('"$tilt"', '"-12"')
    path = tmp_path_factory.mktemp("scene") / "pairs.xml"
    text = text.replace('value="fields/', f'value="{folder}/')
    path.write_text(text.replace(laser, laser + others), encoding="utf-8")
    return vs.load_scene(path)


def spot():
    """A field in closed form, and n with its gradient for SciPy."""

    def index(p):
        dip = DEPTH * np.exp(-np.sum(p**2, axis=1) / (2.0 * WIDTH_MM**2))
        n = np.sqrt(1.0 - dip)
        return n, p * (dip / (2.0 * n * WIDTH_MM**2))[:, None]

    return hot_spot(DEPTH, WIDTH_MM, box=np.array([[-50.0] * 3, [50.0] * 3])), index


def toward_origin(origin, beside=(0.0, 1.0, 0.0)):
    """A frame at a place whose z looks to the world's origin."""
    z = -unit(origin)
    x = unit(np.cross(beside, z))
    return Pose(np.stack([x, np.cross(z, x), z], axis=1), np.asarray(origin, float))


def camera(distortion=()):
    pose = toward_origin((90.0, 10.0, 120.0))
    return Pinhole(MATRIX, pose, (1024, 1024), np.asarray(distortion, float))


@dataclass(frozen=True)
class Converging(RayFamily):
    """A sheet that converges across to a focal line: its rays of one s > 0 lie in a plane, too.

    Unless they are twisted: s turns the ray about its own axis by `twist_per_mm`.
    """

    pose: Pose
    focal_mm: float
    twist_per_mm: float = 0.0

    def foot(self, s, t):
        return s, t

    def slope(self, s, t):
        return 0.0 * t - s / self.focal_mm + self.twist_per_mm * t, 0.0 * s

    def straight(self, x, y, depth):
        return (x - depth * self.twist_per_mm * y) / (1.0 - depth / self.focal_mm), y

    def by_coordinates(self, s, t, depth):
        return 1.0 - depth / self.focal_mm, depth * self.twist_per_mm, 0.0, 1.0


SOURCES = {
    "sheet": Sheet(toward_origin((-40.0, 0.0, 140.0)), 145.0),
    "fan": Sheet(toward_origin((-40.0, 0.0, 140.0)), 145.0, 0.02),
    "projector": Pinhole(MATRIX, toward_origin((-40.0, 0.0, 140.0)), (1024, 1024)),
    "converging": Converging(toward_origin((-40.0, 0.0, 140.0)), 400.0),
    "twisted": Converging(toward_origin((-40.0, 0.0, 140.0)), 400.0, 2e-5),
}


def lit_points(family, medium, index, s, t):
    """Points on a source's rays (s, t) by SciPy, at some distance along each."""
    starts, directions = family.rays(s, t)
    along = np.random.default_rng(2).uniform(120.0, 150.0, len(starts))
    if medium is None:
        return starts + along[:, None] * directions
    rays = integrate(index, starts, directions, 160.0)
    return np.stack([rays.position(a)[i] for i, a in enumerate(along)])


@pytest.mark.parametrize(
    ("lens", "hot"),
    [
        ((), False),
        (LENS, True),
        pytest.param(LENS, False, marks=pytest.mark.slow),
        pytest.param((), True, marks=pytest.mark.slow),
    ],
)
def test_points_on_the_sources_rays_come_back(lens, hot):
    """Rationale: of any family of rays, and of any of its first coordinates; SciPy lights them."""
    cold = vs.load_scene("cold_cylinder")
    medium, index = spot()
    medium = medium if hot else None
    for name, family in SOURCES.items():
        view = camera(lens)
        rng = np.random.default_rng(1)
        size = 0.1 if name == "projector" else 10.0
        s, t = 0.1 * size * rng.uniform(-1.0, 1.0, 60), size * rng.uniform(-1.0, 1.0, 60)
        points = lit_points(family, medium, index, s, t)
        seen = projected_points(
            replace(cold, cameras={"camera": view}, medium=medium),
            points,
            method="newton",
        )
        found = crossings(medium, view, family, seen.pixel, s, 1e-3)
        assert (found.status == CrossingStatus.OK).all(), name
        assert np.linalg.norm(found.point_mm - points, axis=1).max() < (1e-4 if hot else 1e-8), name
        assert np.abs(found.along - t).max() < (1e-5 if hot else 1e-10) * size, name
        marched = marched_crossings(medium, view, family, seen.pixel, s)
        assert (marched.status == CrossingStatus.OK).all(), name
        assert np.linalg.norm(marched.point_mm - points, axis=1).max() < 1e-6, name
        assert np.abs(marched.along_mm - t).max() < 1e-7 * size, name
        e = 1e-4 * size
        ends = [
            marched_crossings(medium, view, family, seen.pixel, s + x).point_mm for x in (e, -e)
        ]
        by_s = (ends[0] - ends[1]) / (2.0 * e)
        off = np.abs(marched.point_by_coordinate - by_s).max()
        assert off < 1e-4 * np.abs(by_s).max(), name
        if hot:
            straight = crossings(None, view, family, seen.pixel, s, 1e-3)
            assert np.nanmax(np.linalg.norm(straight.point_mm - points, axis=1)) > 0.01, name


def test_searched_pixels_of_the_hot_cylinder_give_back_their_incidence_points(scene):
    """Rationale: 0.05 um of 333 um; what is left is what the maps err by."""
    y = np.linspace(-11.0, 11.0, 401)
    found = vs.ray_search(scene, y, "newton")
    points = vs.triangulate(scene, found.pixel, medium=scene.medium)
    off_um = UM * np.linalg.norm(points - found.laser_point_mm, axis=1)
    assert off_um.max() <= 0.05
    straight = vs.triangulate(scene, found.pixel)
    np.testing.assert_array_equal(straight, vs.triangulate(scene.sensor, found.pixel))
    assert UM * np.linalg.norm(straight - found.laser_point_mm, axis=1).max() > 300.0


@pytest.mark.slow
def test_each_pair_of_two_cameras_and_two_lasers_does(pairs):
    """Rationale: a scene owns its parts; what needs one of them is given its name."""
    for case in product(("camera", "steep"), ("laser", "upright")):
        view, source = case
        y = np.linspace(-10.0, 10.0, 101)
        found = vs.ray_search(pairs, y, "newton", camera=view, source=source)
        assert (found.status == 0).all(), case
        names = {"camera": view, "source": source}
        points = vs.triangulate(pairs, found.pixel, medium=pairs.medium, **names)
        assert UM * np.linalg.norm(points - found.laser_point_mm, axis=1).max() <= 0.05, case
        straight = vs.triangulate(pairs, found.pixel, **names)
        assert UM * np.linalg.norm(straight - found.laser_point_mm, axis=1).max() > 30.0, case
        np.testing.assert_allclose(
            vs.project(pairs, found.laser_point_mm, camera=view),
            found.pixel,
            atol=0.002,
            err_msg=f"{case}",
        )
        with pytest.raises(InputError, match="camera"):
            vs.triangulate(pairs, found.pixel, source=source)


def test_a_scene_that_is_moved_as_a_whole_sees_and_measures_the_same(scene):
    """Rationale: maps are of where rays run in the medium, wherever in the world that stands."""
    turn = Rotation.from_euler("xyz", [20.0, -35.0, 50.0], degrees=True).as_matrix()
    motion = Pose(turn, np.array([100.0, -40.0, 25.0]))
    moved = replace(
        scene,
        cameras={"camera": scene.camera.with_pose(scene.camera.pose.moved(motion))},
        sources={"laser": scene.source.with_pose(scene.source.pose.moved(motion))},
        medium=scene.medium.moved(motion),
    )
    found = vs.ray_search(scene, np.linspace(-10.0, 10.0, 41), "newton")
    there = motion.to_world(found.laser_point_mm)
    np.testing.assert_allclose(vs.project(moved, there), found.pixel, atol=1e-4)
    tabulated = projected_points(moved, there, method="tabulated")
    np.testing.assert_allclose(tabulated.pixel, found.pixel, atol=1e-3)
    points = vs.triangulate(moved, found.pixel, medium=moved.medium)
    assert UM * np.linalg.norm(points - there, axis=1).max() <= 0.05


def test_where_there_is_no_map_rays_are_marched(scene, monkeypatch):
    """Rationale: a table may be impossible, or too large; each ray can be marched all the same."""

    def impossible(*_):
        raise NoMapError("a ray is turned away")

    y = np.linspace(-10.0, 10.0, 11)
    pixel = np.vstack([vs.ray_search(scene, y, "newton").pixel, [np.nan, 0.0]])
    marched = bent_points(scene, pixel)
    monkeypatch.setattr("virtual_sensor.optics.crossings.crossings", impossible)
    found = triangulated_points(scene, pixel, medium=scene.medium, method="tabulated")
    np.testing.assert_array_equal(found.point_mm, marched.point_mm)
    np.testing.assert_array_equal(found.status, marched.status)


@pytest.mark.slow
@pytest.mark.parametrize("beta", [0, 30])
def test_rendered_frames_give_back_the_part(beta):
    """Rationale: what a camera sees, and not a search: 0.1 um rms of 250, the radius within 1 um.

    Turned by 30 degrees, where there is little to correct, no more than 0.5 um is added.
    """
    scene = vs.load_scene("hot_cylinder", beta=beta)
    pixel = vs.line_centres(vs.render(scene)).pixel
    pixel = pixel[np.isfinite(pixel).all(axis=1)]
    true = vs.ray_search(scene, laser_y_at(scene, pixel[:, 0]), "newton").laser_point_mm
    points = vs.triangulate(scene, pixel, medium=scene.medium)
    off_um = UM * np.linalg.norm(points - true, axis=1)
    assert len(pixel) > 900
    assert np.sqrt(np.mean(off_um**2)) <= 0.1
    assert off_um.max() <= 0.5
    fit = vs.fit_cylinder(points[np.abs(points[:, 1]) <= 10.9], direction=(1.0, 0.0, 0.0))
    assert abs(fit.radius_mm - 13.5) * UM <= 1.0


def test_several_coordinates_are_triangulated_at_once(scene):
    """Rationale: a pattern tells each pixel's own; straight, each has its plane."""
    family = scene.source.family
    s = np.repeat([-2.0, 1.5], 20)
    starts, directions = family.rays(s, np.tile(np.linspace(-8.0, 8.0, 20), 2))
    points = starts + 290.0 * directions
    pixel = vs.project(scene, points, through_medium=False)
    np.testing.assert_allclose(vs.triangulate(scene, pixel, coordinate=s), points, atol=1e-9)
    bent = vs.triangulate(
        scene, pixel.reshape(2, 20, 2), medium=scene.medium, coordinate=s.reshape(2, 20)
    )
    one_by_one = [
        vs.triangulate(scene, pixel[s == each], medium=scene.medium, coordinate=each)
        for each in (-2.0, 1.5)
    ]
    np.testing.assert_allclose(bent, one_by_one, atol=2e-5)


def test_the_shape_follows_the_pixels(scene):
    """Rationale: none, one, a block: as straight."""
    pixel = vs.ray_search(scene, [0.0, 3.0], "newton").pixel
    bent = {"medium": scene.medium}
    assert vs.triangulate(scene, np.empty((0, 2)), **bent).shape == (0, 3)
    assert vs.triangulate(scene, [], **bent).shape == (0, 3)
    both = vs.triangulate(scene, pixel, **bent)
    one = vs.triangulate(scene, pixel[1], **bent)
    assert one.shape == (3,)
    np.testing.assert_allclose(one, both[1], atol=2e-5)
    block = vs.triangulate(scene, np.broadcast_to(pixel, (3, 2, 2)), **bent)
    np.testing.assert_allclose(block, np.broadcast_to(both, (3, 2, 3)), atol=2e-5)


@pytest.mark.parametrize("hot", [False, True], ids=["cold", "hot"])
def test_why_a_pixel_has_no_point_is_said(scene, hot):
    """Rationale: no pixel; a line of sight that never meets the sheet before camera and laser."""
    good = vs.ray_search(scene, [1.0], "newton").pixel[0]
    beside = scene.camera.pose.origin_mm + 300.0 * scene.source.pose.rotation[:, 2]
    along = vs.project(scene, beside, through_medium=False)  # with the sheet: they are parallel
    behind = 2.0 * along - good
    pixel = np.array([good, [np.nan, 5.0], [5.0, np.inf], along, behind])
    found = triangulated_points(scene, pixel, medium=scene.medium if hot else None)
    status = CrossingStatus
    expected = [status.OK, status.NO_PIXEL, status.NO_PIXEL]
    np.testing.assert_array_equal(found.status[:3], expected)
    np.testing.assert_array_equal(found.status[4], status.BEHIND)
    np.testing.assert_array_equal(np.isfinite(found.point_mm[:, 0]), found.status == status.OK)


def test_a_crossing_behind_the_camera_is_none(scene):
    """Rationale: rays that are sought by Newton's method are lines, which go on behind."""
    camera, family = scene.camera, Sheet(toward_origin((0.0, 0.0, 900.0)), 900.0)
    point = camera.pose.origin_mm - 100.0 * camera.pose.rotation[:, 2]  # before the source
    mirrored = 2.0 * camera.pose.origin_mm - point
    pixel, s = camera.project(mirrored[None]), family.coordinates(point[None])[:, 0]
    assert family.coordinates(point[None])[0, 2] > 100.0
    found = crossings(None, camera, family, pixel, s, 1e-3)
    np.testing.assert_array_equal(found.status, CrossingStatus.BEHIND)
    assert np.isnan(found.point_mm).all()


def test_beyond_a_caustic_of_the_sources_light_no_point_is_made_up():
    """Rationale: a ball lens turns the sheet's rays over: more than one lights a point there."""
    lens = hot_spot(-0.5, WIDTH_MM, box=np.array([[-60.0] * 3, [60.0] * 3]))
    family = Sheet(toward_origin((0.0, 0.0, 140.0)), 140.0)
    view = Pinhole(MATRIX / [[8.0], [8.0], [1.0]], toward_origin((200.0, 0.0, -60.0)), (128, 128))
    above, below = (
        view.project(np.column_stack([0.0 * y, y, 0.0 * y + z]))
        for y, z in ((np.linspace(-1.0, 1.0, 5), 30.0), (np.linspace(-0.2, 0.2, 5), -50.0))
    )
    clear = crossings(lens, view, family, above, np.zeros(5), 1e-2)
    folded = crossings(lens, view, family, below, np.zeros(5), 1e-2)
    assert (clear.status == CrossingStatus.OK).all()
    assert (folded.status == CrossingStatus.FOLDED).all()
    assert np.isnan(folded.point_mm).all()


@pytest.mark.parametrize(
    ("ask", "said"),
    [
        (
            lambda scene: vs.triangulate(
                calibration_of(scene.sensor), [[5.0, 5.0]], medium=scene.medium
            ),
            "a calibration knows the laser's plane and not its rays",
        ),
        (
            lambda scene: vs.triangulate(
                calibration_of(scene.sensor), [[5.0, 5.0]], coordinate=1.0
            ),
            "a calibration knows no coordinate but 0",
        ),
        (
            lambda scene: vs.triangulate(scene, np.zeros((4, 2)), coordinate=np.zeros(3)),
            "coordinate has shape",
        ),
        (lambda scene: vs.triangulate(scene, [[5.0, 5.0]], camera="left"), "left"),
        (lambda scene: vs.triangulate(scene, "abc"), "give real numbers"),
        (
            lambda scene: vs.triangulate(scene, [[5.0, 5.0]], coordinate="a"),
            "coordinate is 'a'; give an array",
        ),
        (lambda scene: vs.triangulate(scene, [[5.0, 5.0]], medium=5), "give an IndexField"),
        (
            lambda scene: triangulated_points(scene, [[5.0, 5.0]], method="paper"),
            "take one of tabulated, newton",
        ),
        (
            lambda scene: triangulated_points(scene, [[5.0, 5.0]], tolerance_px=-1.0),
            "tolerance_px is",
        ),
    ],
)
def test_what_cannot_be_triangulated_is_told(scene, ask, said):
    """Rationale: one line that names the argument and the remedy."""
    with pytest.raises(InputError, match=said):
        ask(scene)
