"""Parts that are larger when they are hot."""

from typing import Any

import numpy as np
import pytest

import virtual_sensor as vs
from virtual_sensor.errors import InputError
from virtual_sensor.imaging.scene_file import shipped_scenes
from virtual_sensor.optics.surfaces import Cylinder

PER_K = 12e-6
LARGER = 1.0 + PER_K * (900.0 - 20.0)
COARSE = {"temperature": 900, "width": 256, "height": 256, "spp": 1}


def bounds(scene):
    """Of all shapes, mm."""
    box = scene.mitsuba.bbox()
    return np.array([box.min, box.max], float)


def test_a_part_grows_about_the_origin():
    """The analytic cylinder stays one; a mesh grows evenly; at 20 degC nothing changes."""
    cold, hot = (vs.load_scene("hot_cylinder", expansion=e, **COARSE) for e in (0, PER_K))
    assert cold.surface == Cylinder()
    radius = 13.5 * LARGER
    expected = [radius, 85.0 * LARGER, 0.0, -radius]
    np.testing.assert_allclose([*vars(hot.surface).values()], expected, atol=2e-6)
    mesh = [vs.load_scene("stepped_shaft", expansion=e, **COARSE) for e in (0, PER_K)]
    np.testing.assert_allclose(bounds(mesh[1]), LARGER * bounds(mesh[0]), rtol=1e-6)
    assert any("1.056 % larger than at 20 degC" in note for note in hot.notes)
    assert not any("larger" in note for note in cold.notes)


def test_a_point_that_stays_and_a_part_of_ones_own(tmp_path):
    """The point: on the axis. The part: an STL file in inches, which its to_world scales too."""
    text = (shipped_scenes() / "hot_cylinder.xml").read_text(encoding="utf-8")
    before = '<float name="expansion" value="$expansion"/>'
    fixed = '<point name="fixed_point" x="0" y="0" z="-13.5"/>'
    path = tmp_path / "axis.xml"
    path.write_text(text.replace(before, before + fixed), encoding="utf-8")
    air = shipped_scenes() / "fields" / "hot_cylinder_900C_quarter.nc"
    part: Any = vs.load_scene(path, field=air, expansion=PER_K, **COARSE).surface
    assert (part.axis_y_mm, part.axis_z_mm) == (0.0, -13.5)
    np.testing.assert_allclose(part.radius_mm, 13.5 * LARGER, atol=2e-6)
    stl = shipped_scenes() / "meshes" / "bracket.stl"
    made = vs.new_scene(tmp_path / "bracket", part=stl, unit="inch", temperature_c=900)
    cold, hot = (vs.load_scene(made, expansion=e, field="") for e in (0, PER_K))
    np.testing.assert_allclose(bounds(hot), LARGER * bounds(cold), rtol=1e-6)


def test_the_line_rises_with_the_part():
    """Light meets the larger cylinder, whose top line stays where it is."""
    y = np.linspace(-8.0, 8.0, 5)
    hot = vs.load_scene("hot_cylinder", expansion=PER_K, **COARSE).cold()
    found = vs.ray_search(hot, y, "newton").laser_point_mm
    radius = 13.5 * LARGER
    z = np.sqrt(radius**2 - y**2) - radius
    np.testing.assert_allclose(found[:, 2], z, atol=1e-5)


@pytest.mark.parametrize(
    ("change", "expected"),
    [
        ({"expansion": 12}, "expansion of 12 1/K; steel has 12e-6"),
        ({"expansion": "nan"}, "expansion is not a finite number"),
    ],
)
def test_an_expansion_that_nothing_has_is_refused(change, expected):
    with pytest.raises(InputError, match=expected):
        vs.load_scene("hot_cylinder", **change)


def test_an_expansion_needs_a_temperature(tmp_path):
    text = (shipped_scenes() / "cold_cylinder.xml").read_text(encoding="utf-8")
    path = tmp_path / "cold.xml"
    glow = '<emitter type="glow"><float name="expansion" value="1e-5"/></emitter>'
    path.write_text(text.replace('id="part">', 'id="part">' + glow))
    with pytest.raises(InputError, match="'temperature' is missing; give it in degC"):
        vs.load_scene(path)
