"""A new source is a family of rays in a test, and all else follows: no other code knows it.

One is a sheet that converges to a focal line, behind the part or before it, and fans out along the
line; another is a line of light from a pinhole, as a projector would draw it, whose coordinates are
no lengths.
Their frames, searched lines, ray maps, triangulation and derivatives through hot air are checked
against marches of rays that are written out here, and against each other.
"""

import re
from dataclasses import dataclass, replace

import numpy as np
import pytest
from artificial import HeldScene
from scipy.interpolate import CubicSpline
from scipy.ndimage import map_coordinates
from scipy.spatial.transform import Rotation
from virtual_sensor_plugins import laser_line, properties

import virtual_sensor as vs
from virtual_sensor.arrays import to_vectors
from virtual_sensor.devices.laser import LaserLine
from virtual_sensor.devices.sensor import SensorModel
from virtual_sensor.engine import dr, mi
from virtual_sensor.imaging.render import render_frame
from virtual_sensor.imaging.scene_file import shipped_scenes
from virtual_sensor.metrology.centres import Status
from virtual_sensor.optics.illumination import illuminate
from virtual_sensor.optics.ray_families import Pinhole, RayFamily
from virtual_sensor.optics.ray_maps import MapRequest, MapStatus, forward_map, inverse_map
from virtual_sensor.optics.ray_search import REFERENCE, SearchStatus
from virtual_sensor.optics.sensitivity import line_sensitivity
from virtual_sensor.optics.surfaces import NoSurface
from virtual_sensor.poses import Pose

# ------------------------------------------------------------- all that there is of a new source

FAN_PER_MM = 5e-4


@dataclass(frozen=True)
class FocusedSheet(RayFamily):
    """Rays from (s, t) mm on the exit, which all meet the line x = 0 at the depth of the focus."""

    pose: Pose
    focus_mm: float
    fan_per_mm: float

    def foot(self, s, t):
        return s, t

    def slope(self, s, t):
        return -s / self.focus_mm, self.fan_per_mm * t

    def straight(self, x, y, depth):
        return x / (1.0 - depth / self.focus_mm), y / (1.0 + self.fan_per_mm * depth)

    def by_coordinates(self, s, t, depth):
        return 1.0 - depth / self.focus_mm, 0.0, 0.0, 1.0 + self.fan_per_mm * depth


class FocusedLine(laser_line.SourceEmitter):
    """The emitter `focused_line`: that sheet with a Gaussian line's light."""

    def __init__(self, props):
        family = FocusedSheet(properties.pose_of(props), float(props["focus"]), FAN_PER_MM)
        super().__init__(props, LaserLine(family, 19.0, 0.35, 0.1, np.empty(0)))


mi.register_emitter("focused_line", FocusedLine)


class DrawnLine(laser_line.SourceEmitter):
    """The emitter `drawn_line`: a line of a pinhole's light."""

    def __init__(self, props):
        family = Pinhole(np.eye(3), properties.pose_of(props), (1, 1))
        super().__init__(props, LaserLine(family, 0.072, 4e-4, 0.1, np.empty(0)))


mi.register_emitter("drawn_line", DrawnLine)

# ------------------------------------------------------------------- and what a test knows of it


@dataclass(frozen=True)
class Known:
    """A source as the tests know it: its rays, written out once more, and where they go.

    `start` and `slope` are of (s, t), in its frame; `half_length` and `half_width`, where 1/e^2 of
    the light is left, in units of t and s.
    """

    emitter: str  # its element's beginning
    start: object
    slope: object
    half_length: float
    half_width: float
    planes: tuple  # depths, with the width and the length of what light crosses there, mm

    def rays(self, pose, s, t):
        """Origins and unit directions (N, 3), world."""
        s, t = np.broadcast_arrays(np.asarray(s, float), np.asarray(t, float))
        (x, y), (along_x, along_y) = self.start(s, t), self.slope(s, t)
        way = np.stack([along_x, along_y, np.ones_like(s)], axis=1) @ pose.rotation.T
        start = np.stack([x, y, 0.0 * s], axis=1) @ pose.rotation.T + pose.origin_mm
        return start, way / np.linalg.norm(way, axis=1, keepdims=True)

    def per_unit(self, depth):
        """Mm across and along, at a depth, per unit of s and of t: from two rays of each."""
        sides = []
        for s, t in ((0.01, 0.0), (0.0, 0.01)):
            (x, y), (along_x, along_y) = self.start(s, t), self.slope(s, t)
            sides.append(np.hypot(x + depth * along_x, y + depth * along_y) / 0.01)
        return np.stack(sides, axis=-1)


def focused(focus_mm, planes):
    """The sheet, as the tests know it."""
    return Known(
        f'<emitter type="focused_line" id="laser"><float name="focus" value="{focus_mm}"/>',
        lambda s, t: (s, t),
        lambda s, t: (-s / focus_mm, FAN_PER_MM * t),
        half_length=9.5,
        half_width=0.35,
        planes=planes,
    )


SOURCES = {
    "focused": focused(380.0, ((30.0, 2.2, 26.0), (300.0, 0.6, 26.0), (600.0, 1.6, 26.0))),
    "past its focus": focused(240.0, ((30.0, 2.2, 26.0), (300.0, 0.6, 26.0))),
    "drawn": Known(
        '<emitter type="drawn_line" id="laser">',
        lambda s, t: (0.0 * s, 0.0 * t),
        lambda s, t: (s, t),
        half_length=0.036,
        half_width=4e-4,
        planes=((30.0, 0.08, 2.4), (300.0, 0.8, 24.0)),
    ),
}


def pytest_generate_tests(metafunc):
    """All of each source; of the sheet past its focus with the slow tests but for its line."""
    if "known" not in metafunc.fixturenames:
        return
    always = metafunc.function in (
        test_its_rays_are_those_that_are_written_out,
        test_the_rendered_line_is_the_searched_one,
    )
    sources = [
        pytest.param(
            name,
            id=name.replace(" ", "-"),
            marks=[] if always or name != "past its focus" else pytest.mark.slow,
        )
        for name in SOURCES
    ]
    metafunc.parametrize("known", sources, indirect=True, scope="module")


@pytest.fixture(scope="module")
def known(request):
    return SOURCES[request.param]


@pytest.fixture(scope="module")
def load(known, tmp_path_factory):
    """Load the shipped scene with this source in place of its laser, or beside it."""
    text = (shipped_scenes() / "hot_cylinder.xml").read_text(encoding="utf-8")
    text = text.replace('"fields/', f'"{shipped_scenes()}/fields/')
    laser = re.search('<emitter type="laser_line".*?</emitter>', text, re.DOTALL)[0]
    source = re.sub("<emitter .*?(?=<transform)", known.emitter, laser, flags=re.DOTALL)
    folder = tmp_path_factory.mktemp("scene")
    (folder / "alone.xml").write_text(text.replace(laser, source), encoding="utf-8")
    other = laser.replace('id="laser"', 'id="other"').replace('x="$along"', 'x="4"')
    (folder / "beside.xml").write_text(text.replace(laser, source + other), encoding="utf-8")
    return lambda name="alone", **parameters: vs.load_scene(folder / f"{name}.xml", **parameters)


@pytest.fixture(scope="module")
def scene(load):
    return load()


@pytest.fixture(scope="module")
def t(known):
    """Rays along the line."""
    return np.linspace(-0.95, 0.95, 31) * known.half_length


def test_its_rays_are_those_that_are_written_out(known, scene):
    """Rationale: the formulas against the picture that they are to draw; and back again."""
    family, (s, t) = scene.source.family, np.random.default_rng(3).uniform(-0.02, 0.02, (2, 30))
    for found, expected in zip(family.rays(s, t), known.rays(family.pose, s, t), strict=True):
        np.testing.assert_allclose(found, expected, rtol=0, atol=1e-12)
    start, direction = family.rays(s, t)
    np.testing.assert_allclose(
        family.coordinates(start + 290.0 * direction)[:, :2], np.stack([s, t], axis=1), atol=1e-11
    )


def test_its_light_carries_its_power_through_every_plane(known, scene):
    """Rationale: the flux per unit of coordinates, the spread and the cosine make irradiance."""
    (emitter,) = (e for e in scene.mitsuba.emitters() if isinstance(e, laser_line.SourceEmitter))
    axis = mi.Vector3f(*scene.source.pose.rotation[:, 2].tolist())
    x, y = ((np.arange(n) + 0.5) / n - 0.5 for n in (60, 3000))
    for depth, width, length in known.planes:
        local = np.stack(np.meshgrid(width * x, length * y, [depth], indexing="ij"), -1)
        it = dr.zeros(mi.Interaction3f, x.size * y.size)
        it.p = mi.Point3f(to_vectors(scene.source.pose.to_world(local.reshape(-1, 3))))
        sample, weight = emitter.sample_direction(it, mi.Point2f(0.5))
        flux = dr.sum(weight[0] * dr.abs(dr.dot(sample.d, axis)))
        cell = width * length / (x.size * y.size)
        assert float(flux[0]) * cell == pytest.approx(0.1, rel=2e-3)


# ------------------------------------------------------------------------- search and frames


@pytest.fixture(scope="module")
def found(scene, t):
    return vs.ray_search(scene, t, "newton")


def test_a_search_by_maps_finds_the_same_pixels(scene, found, t):
    by_maps = vs.ray_search(scene, t, "tabulated")
    np.testing.assert_array_equal(by_maps.status, SearchStatus.FOUND)
    np.testing.assert_allclose(by_maps.pixel, found.pixel, rtol=0, atol=1e-3)


def assert_on_marched_rays(known, scene, s, t, points, within_mm):
    """Points (N, 3) lie on the bent rays whose straight starts are written out here."""
    start, direction = known.rays(scene.source.pose, s, t)
    length = np.linalg.norm(points - start, axis=1)
    for one in range(0, len(points), 3):
        ray = vs.trace(scene.medium, start[[one]], direction[[one]], length[one], 0.1)
        miss = np.cross(ray.position - points[one], ray.direction)
        np.testing.assert_allclose(miss, 0.0, rtol=0, atol=within_mm)


def test_searched_points_lie_on_its_bent_rays(known, scene, found, t):
    np.testing.assert_array_equal(found.status, SearchStatus.FOUND)
    assert_on_marched_rays(known, scene, 0.0, t, found.laser_point_mm, 1e-6)


@pytest.fixture(scope="module")
def frame(scene):
    return render_frame(scene)


@pytest.mark.parametrize("air", ["hot", pytest.param("cold", marks=pytest.mark.slow)])
def test_the_rendered_line_is_the_searched_one(known, scene, frame, air):
    """Two methods for the same row: 0.0006 px rms, as for the shipped laser."""
    if air == "cold":
        scene = scene.cold()
        frame = render_frame(scene)
    assert not frame.report.reason
    line = vs.line_centres(frame.radiance)
    many = np.linspace(-0.99, 0.99, 400) * known.half_length
    u, v = vs.ray_search(scene, many, "newton").pixel.T
    order = np.argsort(u)
    row = CubicSpline(u[order], v[order], extrapolate=False)(np.arange(len(line.row)))
    both = (line.status == Status.OK) & np.isfinite(row)
    assert both.sum() > 0.45 * len(row)
    assert np.sqrt(np.mean((line.row - row)[both] ** 2)) < 1e-3


def test_maps_and_marches_give_the_same_frame(load):
    """Rationale: each transport finds the family's rays by its own method."""
    small = {"width": 512, "height": 512, "spp": 4}
    rows = []
    for transport in ("tabulated", "marched"):
        image = render_frame(load(transport=transport, **small)).radiance.astype(float)
        bright = image.sum(axis=0)
        lit = bright > 0.5 * bright.max()
        rows.append((np.arange(512) @ image)[lit] / bright[lit])
    assert len(rows[0]) > 200
    np.testing.assert_allclose(*rows, rtol=0, atol=1e-3)


def test_beside_a_laser_its_light_is_added(load):
    """Rationale: sources of different families share the camera's rays, and nothing else."""
    both = load("beside", width=512, height=512, spp=4)
    each = [render_frame(both.only(source=name)).radiance for name in ("laser", "other")]
    assert all(radiance.max() > 0.0 for radiance in each)
    together = render_frame(both)
    assert not together.report.reason
    peak = max(radiance.max() for radiance in each)
    np.testing.assert_allclose(together.radiance, each[0] + each[1], rtol=0, atol=1e-3 * peak)


def test_a_frame_knows_the_coordinates_of_its_light(known, found, frame, t):
    """At the pixel that sees ray t, the frame says: across the sheet 0, along the line t."""
    u, v = found.pixel.T
    (rays,) = frame.source_coordinates.values()
    across, along = (map_coordinates(rays[..., i], [v, u], order=1) for i in (0, 1))
    np.testing.assert_allclose(across, 0.0, atol=0.01 * known.half_width)
    np.testing.assert_allclose(along, t, atol=1e-4 * known.half_length)


# -------------------------------------------------------------------------------------- ray maps

TOLERANCE_MM = 1e-4


@pytest.fixture(scope="module")
def box(known):
    """Lowest and highest (s, t, depth)."""
    side = np.array([3.0 * known.half_width, known.half_length])
    return np.append(-side, 297.0), np.append(side, 306.0)


def test_a_forward_map_tells_where_the_rays_are(known, scene, box):
    low, high = box
    places = low + np.random.default_rng(1).random((60, 3)) * (high - low)
    map_ = forward_map(
        MapRequest(scene.medium, scene.source.family, low, high, REFERENCE, TOLERANCE_MM)
    )
    points = map_.points(places)
    np.testing.assert_array_equal(points.status, MapStatus.OK)
    s, t, _ = places.T
    assert_on_marched_rays(known, scene, s, t, points.point_mm, TOLERANCE_MM)


def test_an_inverse_map_tells_the_ray_that_newton_finds(known, scene, box):
    """Rationale: what lights a point is found by a table or by marches, and is the same."""
    family, (low, high) = scene.source.family, box
    places = low + np.random.default_rng(2).random((50, 3)) * (high - low)
    x, y = family.place(*places.T)
    points = family.pose.to_world(np.stack([x, y, places[:, 2]], axis=1))
    map_ = inverse_map(MapRequest(scene.medium, family, low, high, REFERENCE, TOLERANCE_MM))
    found = map_.rays(points)
    march = replace(REFERENCE, step_mm=0.5)
    light = illuminate(family, scene.medium, NoSurface(), to_vectors(points), march)
    newton = np.stack([np.array(light.s), np.array(light.t)], axis=1)
    scale = known.per_unit(places[:, 2])
    assert np.abs((newton - places[:, :2]) * scale).max() > 0.05  # mm, by the air
    np.testing.assert_array_less(np.abs(found.coordinates - newton) * scale, TOLERANCE_MM)


# --------------------------------------------------------------------------------- triangulation


def test_cold_points_are_triangulated_in_the_plane_of_the_middle_rays(scene, t):
    cold = scene.cold()
    found = vs.ray_search(cold, t, "newton")
    measured = vs.triangulate(cold.sensor, found.pixel)
    np.testing.assert_allclose(measured, found.laser_point_mm, rtol=0, atol=1e-5)


def test_hot_points_are_triangulated_along_bent_rays(scene, found):
    """To 0.05 um, where straight lines are off by a hundred."""
    bent, straight = (
        vs.triangulate(scene, found.pixel, medium=medium) for medium in (scene.medium, None)
    )
    np.testing.assert_allclose(bent, found.laser_point_mm, rtol=0, atol=5e-5)
    assert np.abs(straight - found.laser_point_mm).max() > 0.1


def test_any_ray_of_its_is_triangulated(known, scene, frame):
    """By its first coordinate, as a frame tells it of pixels beside the middle of the line."""
    (rays,) = frame.source_coordinates.values()
    inner = np.abs(rays[..., 0]) < 0.8 * known.half_width
    v, u = np.argwhere(inner & np.isfinite(rays[..., 0]))[::97].T
    measured = vs.triangulate(
        scene, np.stack([u, v], 1), medium=scene.medium, coordinate=rays[v, u, 0]
    )
    apart = np.linalg.norm(measured - frame.point_mm[v, u], axis=1)
    assert len(apart) > 50
    assert np.sqrt(np.mean(apart**2)) < 2e-4  # what the frame's own maps allow


# ----------------------------------------------------------------------------------- derivatives


def moved(held, turn_deg, shift_mm):
    """With the source turned about the world's origin, then shifted."""
    turn = Rotation.from_rotvec(np.radians(turn_deg)).as_matrix()
    camera, laser = held.sensor.camera, held.sensor.laser
    pose = Pose(turn @ laser.pose.rotation, turn @ laser.pose.origin_mm + shift_mm)
    return replace(held, sensor=SensorModel(camera, laser.with_pose(pose)))


@pytest.fixture(scope="module")
def held(scene):
    """The scene without Mitsuba's: its parts can be moved."""
    return HeldScene(scene.sensor, scene.medium, scene.surface)


@pytest.fixture(scope="module")
def exact(held, t):
    """All derivatives of the line."""
    return line_sensitivity(held, t)


@pytest.mark.parametrize("parameter", ["laser_x", "laser_z", "laser_turn_y", "laser_turn_z", "t"])
def test_derivatives_are_those_of_central_differences(known, held, exact, t, parameter):
    """Rationale: they come from the family's own, carried through the air."""
    none = np.zeros(3)
    axis = none if parameter == "t" else np.eye(3)["xyz".index(parameter[-1])]
    turns = "turn" in parameter
    e = 0.0005 if turns else 0.002 if parameter != "t" else 2e-4 * known.half_length
    ends = []
    for step in (e, -e):
        turn_deg, shift_mm = (step * axis, none) if turns else (none, step * axis)
        rays = t + step if parameter == "t" else t
        there = moved(held, turn_deg, shift_mm)
        ends.append(vs.ray_search(there, rays, "newton", march=REFERENCE).pixel)
    expected = (ends[0] - ends[1]) / (2.0 * e)
    derivative = exact.along_line if parameter == "t" else exact.of_pixel[parameter]
    np.testing.assert_allclose(derivative, expected, rtol=0, atol=1e-4 * abs(expected).max())
