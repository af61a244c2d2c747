"""The laser line's radiometry: its power, its sizes and what it reaches, in closed forms."""

import numpy as np
import pytest
from artificial import paper_sensor
from numpy.testing import assert_allclose

from virtual_sensor.devices.laser import LaserLine
from virtual_sensor.engine import mi
from virtual_sensor.optics.ray_families import Sheet

POWER_W, LENGTH_MM, RADIUS_MM = 0.1, 20.0, 0.15
KINDS = {"line": (0.0, []), "fan": (3e-3, []), "dots": (3e-3, [-4.0, 0.5, 3.0])}


@pytest.fixture(params=KINDS)
def laser(request):
    fan_per_mm, dots = KINDS[request.param]
    family = Sheet(paper_sensor().laser.pose, 300.0, fan_per_mm)
    return LaserLine(family, LENGTH_MM, RADIUS_MM, POWER_W, np.array(dots, float))


def grid(width, length, cells=(120, 4000)):
    """Midpoints of cells over the sheet, flat, and a cell's area."""
    x, y = ((np.arange(n) + 0.5) / n - 0.5 for n in cells)
    x, y = np.meshgrid(width * x, length * y, indexing="ij")
    return x.ravel(), y.ravel(), width * length / x.size


def test_the_flux_of_all_rays_is_the_power(laser):
    """But for the millionth of the peak below which there is none."""
    s, t, cell = grid(1.0, 24.0)
    assert np.sum(laser.flux(s, t)) * cell == pytest.approx(POWER_W, rel=1e-3)


def test_irradiance_on_a_plane_is_the_power(laser):
    """Square to the light it is flux density; the plane is square to the axis."""
    x, y, cell = grid(1.0, 36.0, (20, 2000))
    for depth in (200.0, 300.0, 420.0):
        points = laser.pose.to_world(np.stack([x, y, np.full_like(x, depth)], axis=1))
        light = laser.family.rays(*laser.family.coordinates(points)[:, :2].T)[1]
        density = laser.irradiance(points) * (light @ laser.pose.rotation[:, 2])
        assert np.sum(density) * cell == pytest.approx(POWER_W, rel=1e-3), depth


def test_the_peak_is_that_of_a_gaussian(laser):
    """On the line P / L sqrt(2 / pi) / w; of a dot 2 P / (M pi w^2)."""
    t = laser.along(3)[1]
    line = POWER_W / LENGTH_MM * np.sqrt(2.0 / np.pi) / RADIUS_MM
    dots = 2.0 * POWER_W / (3.0 * np.pi * RADIUS_MM**2)
    assert laser.flux(0.0, t) == pytest.approx(dots if laser.dots_mm.size else line, rel=1e-12)
    assert laser.flux(RADIUS_MM, t) == pytest.approx(np.exp(-2.0) * laser.flux(0.0, t))


def test_the_extent_holds_all_light_and_no_more(laser):
    s, t, _ = grid(2.0, 30.0)
    reached = laser.reaches(s, t)
    np.testing.assert_array_equal(laser.flux(s, t) > 0.0, reached)
    low, high = laser.extent
    assert_allclose([s[reached].min(), t[reached].min()], low, rtol=0, atol=0.02)
    assert_allclose([s[reached].max(), t[reached].max()], high, rtol=0, atol=0.02)
    assert laser.flux(0.999 * high[0], laser.along(3)[1]) == pytest.approx(
        1e-6 * laser.flux(0.0, laser.along(3)[1]), rel=0.05
    )


def test_nothing_is_reached_by_no_number(laser):
    assert not laser.reaches(np.array([np.nan, 0.0]), np.array([0.0, np.nan])).any()
    assert_allclose(laser.flux(np.array([np.nan]), np.array([0.0])), 0.0)


def test_drjit_computes_the_same(laser):
    """Rationale: what is said of the light in NumPy is what is rendered."""
    s, t, _ = grid(1.0, 24.0, (12, 100))
    found = laser.flux(mi.Float64(s), mi.Float64(t))
    assert_allclose(np.array(found), laser.flux(s, t), rtol=1e-12)


def test_the_sheet_keeps_its_thickness(laser):
    points = laser.pose.to_world([[0.1, 3.0, 250.0], [-0.2, 1.0, 400.0]])
    assert_allclose(laser.radius_at(points), RADIUS_MM)


def test_rays_along_it_are_those_asked_for(laser):
    """Of a line, from end to end; of dots, each one's."""
    ends = laser.along(5)[[0, -1]]
    expected = [-4.0, 3.0] if laser.dots_mm.size else [-10.0, 10.0]
    assert_allclose(ends, expected)


def test_its_target_is_where_the_papers_axes_meet():
    """And its plane holds it."""
    laser = paper_sensor().laser
    assert_allclose(laser.target_mm, 0.0, atol=1e-12)
    normal, offset = laser.plane
    assert normal @ laser.target_mm == pytest.approx(offset, abs=1e-12)
