"""Rendered frames against the ray search, the sensor model and the part's shape."""

import numpy as np
import OpenEXR
import pytest
from scipy.interpolate import CubicSpline
from scipy.ndimage import map_coordinates
from several import two_by_two

import virtual_sensor as vs
from virtual_sensor.arrays import to_vectors
from virtual_sensor.engine import dr, mi
from virtual_sensor.imaging.render import render_frame, write_exr
from virtual_sensor.imaging.scene_file import shipped_scenes
from virtual_sensor.metrology.dot_peaks import DotStatus, dot_centres
from virtual_sensor.metrology.line_peaks import Status
from virtual_sensor.optics.ray_search import SearchStatus
from virtual_sensor.optics.rays import March
from virtual_sensor.optics.surfaces import SceneSurface
from virtual_sensor.optics.transports import Marched

TEMPERATURES = ["cold", "hot"]
SCENE_OF = {"cylinder": "hot_cylinder", "shaft": "stepped_shaft"}


def load(temperature, **parameters):
    """The cylinder's scene, cold or hot."""
    return vs.load_scene(f"{temperature}_cylinder", **parameters)


def on_cylinder(y):
    """Where straight laser rays at y meet the cylinder: the plane z = -x tan(60 deg)."""
    z = np.sqrt(13.5**2 - y**2) - 13.5
    return np.column_stack([-z / np.tan(np.radians(60.0)), y, z])


@pytest.mark.parametrize("size", [(1999, 1500), (1500, 1801)])
def test_projected_point_is_where_its_dot_is_rendered(size):
    """Mitsuba's pixel i reaches from i to i + 1, ours has its centre at i: that half would show."""
    y = np.array([-5.0, -1.25, 0.0, 2.5])
    scene = load("cold", width=size[0], height=size[1], line_radius=0.05, dots="-5, -1.25, 0, 2.5")
    dots = dot_centres(vs.render(scene))
    np.testing.assert_array_equal(dots.status, DotStatus.OK)
    np.testing.assert_allclose(dots.pixel, scene.sensor.camera.project(on_cylinder(y)), atol=0.003)


def test_shifted_principal_point_is_where_mitsuba_has_it(tmp_path):
    """Mitsuba's offset moves the film, not the point: with the wrong sign dots part by 100 px."""
    text = (shipped_scenes() / "cold_cylinder.xml").read_text(encoding="utf-8")
    shift = '<float name="principal_point_offset_x" value="0.05"/>'
    shift += '<float name="principal_point_offset_y" value="-0.02"/>'
    path = tmp_path / "shifted.xml"
    path.write_text(text.replace('<float name="near_clip"', shift + '<float name="near_clip"'))
    scene = vs.load_scene(path, width=1024, height=800, line_radius=0.05, dots="-5, 0, 5")
    dots = dot_centres(vs.render(scene))
    expected = scene.sensor.camera.project(on_cylinder(np.array([-5.0, 0.0, 5.0])))
    np.testing.assert_allclose(dots.pixel, expected, atol=0.003)


@pytest.mark.parametrize("temperature", TEMPERATURES)
@pytest.mark.parametrize("length", [6, pytest.param(22, marks=pytest.mark.slow)])
def test_line_centres_agree_with_the_ray_search(temperature, length):
    """A noise-free frame, up to both ends of the line: two methods for the same bent light."""
    scene = load(temperature, line_length=length, spp=4)
    found = vs.ray_search(scene, np.linspace(-0.5, 0.5, 401) * length, "newton")
    u, v = found.pixel[np.argsort(found.pixel[:, 0])].T
    line = vs.line_centres(vs.render(scene))
    held = (line.status == Status.OK) & (line.column > u[0]) & (line.column < u[-1])
    column, error = line.column[held], line.row[held] - CubicSpline(u, v)(line.column[held])
    assert np.sqrt(np.mean(error**2)) < 0.003
    assert np.abs(error).max() < 0.01
    assert column[0] - u[0] < 2.5
    assert u[-1] - column[-1] < 2.5
    assert np.all(np.diff(column) == 1)


def test_hot_dots_agree_with_the_ray_search():
    """Along the line, too, where refraction moves dots by pixels and a line shows nothing."""
    y = np.array([-8.75, -6.25, -3.75, -1.25, 0.0, 5.0])
    dots = ", ".join(map(str, y))
    scene = load("hot", line_radius=0.08, dots=dots, spp=4)
    seen, found = dot_centres(vs.render(scene)), vs.ray_search(scene, y, "newton")
    np.testing.assert_array_equal(seen.status, DotStatus.OK)
    straight = scene.sensor.camera.project(on_cylinder(y))
    np.testing.assert_allclose(seen.pixel, found.pixel, atol=0.02)
    assert np.abs(found.pixel - straight)[:, 0].max() > 5.0


def test_float32_march_agrees_with_float64():
    """End to end: what is carried is the difference from the straight ray."""
    rows = [
        vs.line_centres(vs.render(load("hot", line_length=3, spp=4, precision=precision))).row
        for precision in ("single", "double")
    ]
    error = np.abs(rows[1] - rows[0])
    assert np.isfinite(error).sum() > 100
    assert np.nanmax(error) < 0.002


@pytest.fixture(scope="module", params=TEMPERATURES)
def coarse(request):
    """A scene and its frame on a coarse film."""
    scene = load(request.param, width=512, height=512, spp=4)
    return scene, render_frame(scene)


def test_lit_points_lie_on_the_part(coarse):
    """In float32, to a ten-thousandth of a millimetre; and in front of the camera."""
    _, frame = coarse
    point = frame.point_mm[frame.lit].astype(float)
    np.testing.assert_allclose(np.hypot(point[:, 1], point[:, 2] + 13.5), 13.5, atol=1e-4)
    assert np.all((frame.depth_mm[frame.lit] > 250.0) & (frame.depth_mm[frame.lit] < 350.0))


@pytest.mark.parametrize("temperature", TEMPERATURES)
@pytest.mark.parametrize("name", ["cylinder", "shaft"])
def test_the_lit_pixels_are_those_of_rays_marched_at_every_pixel(temperature, name):
    """Rationale: the mask was held against itself.  Here nothing is searched for nor tabulated.

    Each pixel's line of sight, by the camera's numbers, is marched to the part in float64, and the
    laser's ray there found by Newton.  Within 2 um of the beam's border it may be either.
    """
    film = {"width": 128, "height": 128, "spp": 1, "line_radius": 0.6}
    scene = vs.load_scene(SCENE_OF[name], **film)
    scene = scene.cold() if temperature == "cold" else scene
    frame, laser, march = render_frame(scene), scene.source, March(1.0, "leapfrog", "double")
    v, u = np.mgrid[:128, :128]
    heading = scene.camera.lines_of_sight(np.stack([u, v], axis=-1).reshape(-1, 2))
    start = np.broadcast_to(scene.camera.pose.origin_mm, heading.shape)
    ray = mi.Ray3f(mi.Point3f(to_vectors(start)), mi.Vector3f(to_vectors(heading)))
    tracer = Marched(scene.medium, SceneSurface(scene.mitsuba), (laser,), march)
    (light,) = tracer.sight(ray)[0].lights
    s, t = (np.array(x, float).reshape(128, 128) for x in (light.s, light.t))
    surely, maybe = (laser.reaches(s, t, (margin, margin)) for margin in (-2e-3, 2e-3))
    assert np.count_nonzero(surely) > 400
    np.testing.assert_array_equal(frame.lit & surely, surely)
    np.testing.assert_array_equal(frame.lit & ~maybe, False)
    for truth in (frame.point_mm[..., 0], frame.depth_mm, *np.moveaxis(frame.coordinates(), -1, 0)):
        np.testing.assert_array_equal(np.isfinite(truth), frame.lit)
    both = frame.lit & surely
    apart = np.abs(frame.coordinates() - np.stack([s, t], axis=-1))[both].max(axis=-1)
    assert np.quantile(apart, 0.99) < 2e-3  # mm: a hundredth of a pixel


BEAMS = {
    "line": {"line_radius": 0.3},
    "short": {"line_length": 6},
    "fan": {"fan": 4, "line_radius": 0.3},
    "dots": {"dots": "-12, -3, 0.5, 4", "line_radius": 0.3},
    "dot beyond the length": {"dots": -12, "line_radius": 0.3},
}


def in_beam(scene, margin_mm):
    """Pixels (H, W) whose centre looks at the cold cylinder's lit part, by closed forms.

    Light below a millionth of the peak is none: sqrt(ln(1e6) / 2) = 2.63 radii out.  The margin
    widens the beam, or narrows it.
    """
    camera, laser, radius = scene.sensor.camera, scene.sensor.laser, 13.5
    sheet = laser.family
    width, height = camera.size
    v, u = np.mgrid[:height, :width]
    sight = camera.lines_of_sight(np.stack([u, v], axis=-1).reshape(-1, 2))
    start = camera.pose.origin_mm - np.array([0.0, 0.0, -radius])
    a, b = sight[:, 1:] @ start[1:], np.sum(sight[:, 1:] ** 2, axis=1)
    inside = a**2 - b * (start[1:] @ start[1:] - radius**2)
    t = (-a - np.sqrt(np.where(inside > 0.0, inside, np.nan))) / b
    point = camera.pose.origin_mm + t[:, None] * sight
    across, along, depth = laser.pose.to_local(point).T
    along /= 1.0 + sheet.fan_per_mm * (depth - sheet.distance_mm)
    normal = point[:, 1:] + [0.0, radius]
    faces = normal @ laser.pose.rotation[1:, 2] + sheet.fan_per_mm * along * normal[:, 0] < 0.0
    out = np.sqrt(np.log(1e6) / 2.0) * laser.radius_mm + margin_mm
    if laser.dots_mm.size:
        on = np.min(np.abs(along[:, None] - laser.dots_mm), axis=1) <= out
    else:
        on = np.abs(along) <= laser.length_mm / 2.0 + margin_mm
    return (on & faces & (np.abs(across) <= out)).reshape(height, width)


@pytest.mark.parametrize("beam", BEAMS)
def test_the_lit_pixels_of_a_cold_part_are_those_in_the_beam(beam):
    """Rationale: by closed forms.  1,234 of 5,640 lay beyond it, and none of a dot at -12 mm."""
    scene = load("cold", width=320, height=320, **BEAMS[beam])
    lit = render_frame(scene).lit
    surely, maybe = in_beam(scene, -2e-3), in_beam(scene, 2e-3)
    assert np.count_nonzero(surely) > 100
    np.testing.assert_array_equal(lit & surely, surely)
    np.testing.assert_array_equal(lit & ~maybe, False)


@pytest.mark.parametrize("beam", BEAMS)
@pytest.mark.parametrize("temperature", TEMPERATURES)
def test_a_pixel_is_lit_where_its_centre_is_bright(temperature, beam):
    """Rationale: for both, one sample a pixel is its centre, and has light or has none."""
    frame = render_frame(load(temperature, width=512, height=512, spp=1, **BEAMS[beam]))
    bright = frame.radiance > 0.0
    assert np.count_nonzero(bright) > 100
    apart = np.count_nonzero(frame.lit != bright)
    assert apart <= 2e-4 * np.count_nonzero(bright)  # rounding, at the very border
    for truth in (frame.point_mm[..., 0], frame.depth_mm, *np.moveaxis(frame.coordinates(), -1, 0)):
        np.testing.assert_array_equal(np.isfinite(truth), frame.lit)


def test_laser_coordinates_are_those_of_the_ray_search(coarse):
    """At the pixel that sees laser ray y, the frame says: across the sheet 0, along the line y."""
    scene, frame = coarse
    y = np.linspace(-10.5, 10.5, 31)
    u, v = vs.ray_search(scene, y, "newton").pixel.T
    a, b = (map_coordinates(frame.coordinates()[..., i], [v, u], order=1) for i in (0, 1))
    np.testing.assert_allclose(a, 0.0, atol=1e-3)
    np.testing.assert_allclose(b, y, atol=1e-3)


def test_exr_file_holds_the_frame_and_its_truth(coarse, tmp_path):
    """Read back by OpenEXR under the names that the channels have, header included."""
    _, frame = coarse
    write_exr(tmp_path / "frame.exr", frame, {"temperature": "1250"})
    with OpenEXR.File(str(tmp_path / "frame.exr"), separate_channels=True) as file:
        held = {name: channel.pixels for name, channel in file.channels().items()}
        assert file.header()["temperature"] == "1250"
    np.testing.assert_array_equal(held["Y"], frame.radiance)
    np.testing.assert_array_equal(held["lit"] > 0.0, frame.lit)
    np.testing.assert_array_equal(held["depth.Z"], frame.depth_mm)
    point = np.stack([held[f"point.{axis}"] for axis in "XYZ"], axis=-1)
    np.testing.assert_array_equal(point, frame.point_mm)
    laser = np.stack([held["laser.a"], held["laser.b"]], axis=-1)
    np.testing.assert_array_equal(laser, frame.coordinates())


def test_exr_file_of_two_lasers_names_each(tmp_path):
    """Their coordinates are there by the sources' names, NaN where that one does not reach."""
    scene = two_by_two(tmp_path)
    frame = render_frame(scene, camera="near")
    write_exr(tmp_path / "frame.exr", frame, {})
    with OpenEXR.File(str(tmp_path / "frame.exr"), separate_channels=True) as file:
        held = {name: channel.pixels for name, channel in file.channels().items()}
    assert {"red.a", "red.b", "blue.a", "blue.b"} < set(held)
    lit = held["lit"] > 0.0
    for name in scene.sources:
        reached = np.isfinite(held[f"{name}.a"])
        assert 100 < np.count_nonzero(reached) < np.count_nonzero(lit)
        np.testing.assert_array_equal(reached & ~lit, False)


def test_line_breaks_off_where_the_camera_cannot_look():
    """The groove of the stepped shaft hides the laser: the frame and the search agree where."""
    scene = vs.load_scene("stepped_shaft", width=1024, height=1024, spp=4).cold()
    frame = render_frame(scene)
    a, b = np.moveaxis(frame.coordinates(), -1, 0)
    lit = np.sort(b[(frame.radiance > 0.0) & (np.abs(a) < 0.02)])
    y = np.linspace(-10.9, 10.9, 219)
    seen = vs.ray_search(scene, y, "newton").status == SearchStatus.FOUND
    nearest = np.min(np.abs(y[:, None] - lit), axis=1)
    assert (~seen).sum() > 20
    assert nearest[seen].max() < 0.3
    assert nearest[~seen].max() > 0.6
    assert np.median(nearest[~seen]) > 0.2


def test_a_frame_is_the_same_to_the_bit_with_any_number_of_threads():
    """Rationale: a worker of a cluster has other cores, and its results are compared as bytes.

    25 samples per pixel do not fill up the blocks that threads take, so that two threads make a
    pixel's samples.
    """
    scene = load("cold", spp=25, line_radius=1.0, width=640, height=640)
    threads, frames = dr.thread_count(), []
    try:
        for count in (1, 2, 2, 4, 4):
            dr.set_thread_count(count)
            frames.append(render_frame(scene))
    finally:
        dr.set_thread_count(threads)
    for frame in frames[1:]:
        assert (frame.radiance != frames[0].radiance).sum() == 0
        np.testing.assert_array_equal(frame.coordinates(), frames[0].coordinates())
