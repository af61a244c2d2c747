"""The laser's light: power, shape and direction against closed forms, and flux through hot air."""

from itertools import product

import numpy as np
import pytest
from virtual_sensor_plugins.laser_line import SourceEmitter

import virtual_sensor as vs
from virtual_sensor.engine import dr, mi
from virtual_sensor.optics.eikonal import March
from virtual_sensor.optics.illumination import illuminate
from virtual_sensor.optics.ray_families import Sheet
from virtual_sensor.optics.surfaces import NoSurface

POWER_W, LENGTH_MM, RADIUS_MM = 0.1, 20.0, 0.15
KINDS = {"line": {}, "fan": {"fan": 3.0}, "dots": {"dots": "-4, 0.5, 3"}}


def laser(**properties):
    """A laser 300 mm above the origin that shines down, its line along y."""
    exit_pose = mi.ScalarTransform4f().look_at([0, 0, 300], [0, 0, 0], [0, 1, 0])
    shape = {"length": LENGTH_MM, "radius": RADIUS_MM, "power": POWER_W}
    return mi.load_dict({"type": "laser_line", "to_world": exit_pose, **shape, **properties})


def light_at(emitter: SourceEmitter, x, y, z):
    """Direction to the laser (N, 3) and flux density (N,) as Mitsuba's integrators ask for them."""
    it = dr.zeros(mi.Interaction3f, np.size(x))
    it.p = mi.Point3f(mi.Float(np.ravel(x)), mi.Float(np.ravel(y)), mi.Float(np.ravel(z)))
    sample, weight = emitter.sample_direction(it, mi.Point2f(0.5))
    return sample, np.array(weight[0])


def on_plane(z, width=1.2, length=24.0, cells=(60, 3000)):
    """Midpoints of the cells of a grid on a plane of constant z, and a cell's area."""
    x, y = ((np.arange(n) + 0.5) / n - 0.5 for n in cells)
    x, y = np.meshgrid(width * x, length * y, indexing="ij")
    return x.ravel(), y.ravel(), np.full(x.size, z), width * length / x.size


def test_flux_through_every_plane_is_the_power():
    """What leaves the generator arrives, however far and however wide it fans out."""
    for case in product(KINDS, (-30.0, 0.0, 20.0)):
        kind, z = case
        x, y, z, cell = on_plane(z)
        sample, density = light_at(laser(**KINDS[kind]), x, y, z)
        flux = np.sum(density * np.array(sample.d)[2]) * cell
        assert flux == pytest.approx(POWER_W, rel=1e-3), case


def test_dots_share_the_power():
    """Each of M dots has 1/M of it."""
    x, y, z, cell = on_plane(0.0)
    _, density = light_at(laser(dots="-4, 0.5, 3"), x, y, z)
    for dot in (-4.0, 0.5, 3.0):
        own = np.abs(y - dot) < 1.0
        assert density[own].sum() * cell == pytest.approx(POWER_W / 3.0, rel=1e-3)


def test_line_is_gaussian_across_and_even_along():
    """ISO 11146: at one radius 1/e^2 of the peak is left; the ends are sharp."""
    y = np.array([0.0, 0.0, 0.0, 9.99, -9.99, 10.01, -10.01])
    x = np.array([0.0, 1.0, -1.0, 0.0, 0.0, 0.0, 0.0]) * RADIUS_MM
    _, density = light_at(laser(), x, y, 0.0 * x)
    np.testing.assert_allclose(density / density[0], [1, *[np.exp(-2)] * 2, 1, 1, 0, 0], rtol=1e-4)


def test_dot_is_round():
    """The same radius in every direction."""
    angle = np.linspace(0.0, 2.0 * np.pi, 8)
    x, y = RADIUS_MM * np.cos(angle), RADIUS_MM * np.sin(angle)
    _, density = light_at(laser(dots="0"), np.append(x, 0.0), np.append(y, 0.0), np.zeros(9))
    np.testing.assert_allclose(density[:-1] / density[-1], np.exp(-2.0), rtol=1e-4)


def test_fan_spreads_from_one_point():
    """The full angle spans the length at the distance: the apex is L / (2 tan(angle/2)) away."""
    y = np.linspace(-9.0, 9.0, 7)
    sample, _ = light_at(laser(fan=3.0), 0.0 * y, y, 0.0 * y)
    towards = np.array(sample.d)
    apex = LENGTH_MM / 2.0 / np.tan(np.radians(1.5))
    np.testing.assert_allclose(y + towards[1] / towards[2] * apex, 0.0, atol=1e-3)
    np.testing.assert_allclose(np.array(sample.p)[2], 300.0, atol=1e-3)


@pytest.mark.parametrize("kind", ["line", "fan"])
def test_points_on_a_laser_ray_have_its_coordinates(kind):
    """The rays and the inverse that lights points are written apart from each other."""
    sheet = laser(**KINDS[kind]).source.family
    a, b = np.array([-0.2, 0.0, 0.1]), np.array([-9.0, 0.3, 7.0])
    origins, directions = sheet.rays(a, b)
    for distance in (250.0, 300.0, 330.0):
        points = mi.Array3f((origins + distance * directions).T)
        light = illuminate(sheet, None, NoSurface(), points, March(precision="single"))
        np.testing.assert_allclose([light.s, light.t], [a, b], atol=1e-4)


def test_hot_air_concentrates_light_and_loses_none():
    """By finite differences of the coordinates found, and by the flux past a plane near the part.

    The plume thins the light out by a tenth in places.
    """
    scene = vs.load_scene("hot_cylinder")
    line, cells = scene.source, (56, 480)
    assert isinstance(line.family, Sheet)
    x, y, depth, cell = on_plane(line.family.distance_mm - 5.0, width=1.4, cells=cells)
    points = mi.Array3f(line.pose.to_world(np.column_stack([x, y, depth])).T)
    light = illuminate(line.family, scene.field, NoSurface(), points, scene.transport.march)
    cosine = np.array(light.heading).T @ line.pose.rotation[:, 2]

    density = np.array(line.flux(light.s, light.t) * light.concentration)
    assert np.sum(density * cosine) * cell == pytest.approx(line.power_w, rel=0.005)

    x, y = x.reshape(cells)[:, 0], y.reshape(cells)[0]
    a_x, a_y = np.gradient(np.reshape(light.s, cells), x, y)
    b_x, b_y = np.gradient(np.reshape(light.t, cells), x, y)
    by_area = (a_x * b_y - a_y * b_x)[1:-1, 1:-1]
    concentration = (np.array(light.concentration) * cosine).reshape(cells)[1:-1, 1:-1]
    np.testing.assert_allclose(concentration, by_area, rtol=0.01)
    assert concentration.min() < 0.92
