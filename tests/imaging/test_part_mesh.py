"""A scene's part as one mesh in the world, for solvers of the air."""

import numpy as np
import pytest
import trimesh

from virtual_sensor.errors import InputError
from virtual_sensor.imaging.part_mesh import part_mesh
from virtual_sensor.imaging.scene import load_scene
from virtual_sensor.imaging.scene_file import shipped_scenes

INCH = '<scale value="25.4"/>'


def with_part(folder, shapes):
    """The cold scene with other shapes."""
    text = (shipped_scenes() / "cold_cylinder.xml").read_text()
    path = folder / "mine.xml"
    path.write_text(text[: text.index("<shape")] + shapes + "</scene>")
    return load_scene(path)


def test_shipped_parts_are_closed_and_as_large_as_they_are():
    """Rationale: air would fill an open part; the cylinder's formula is the reference."""
    mesh, notes = part_mesh(load_scene("hot_cylinder", field=""))
    assert notes == ()
    assert mesh.is_watertight
    assert mesh.volume == pytest.approx(np.pi * 13.5**2 * 170.0, rel=1e-6)
    np.testing.assert_allclose(mesh.bounds, [[-85, -13.5, -27], [85, 13.5, 0]], atol=0.01)
    shaft, _ = part_mesh(load_scene("stepped_shaft", field=""))
    assert shaft.is_watertight
    assert shaft.bounds[1, 2] == pytest.approx(0.0, abs=1e-6)


def test_a_part_of_several_shapes_lies_where_the_scene_puts_it(tmp_path):
    """Rationale: inches, a part off the origin, mirrored and moved shapes, all in one scene."""
    trimesh.creation.box((2.0, 1.0, 0.5)).export(tmp_path / "größe 1.stl")
    place = f'{INCH}<scale x="-1"/><rotate z="1" angle="90"/><translate x="100" y="50" z="-20"/>'
    shapes = (
        '<shape type="stl"><string name="filename" value="größe 1.stl"/>'
        f'<transform name="to_world">{place}</transform></shape>'
        '<shape type="sphere"><point name="center" x="1" y="2" z="-3"/>'
        '<float name="radius" value="3"/></shape>'
        '<shape type="cube"><transform name="to_world"><scale x="40" y="5" z="6"/>'
        '<translate z="-6"/></transform></shape>'
    )
    mesh, _ = part_mesh(with_part(tmp_path, shapes))
    assert mesh.is_watertight
    bodies = mesh.split(only_watertight=False)
    ball, cube, box = sorted(bodies, key=lambda body: body.volume)
    np.testing.assert_allclose(box.extents, [25.4, 50.8, 12.7], atol=1e-3)
    np.testing.assert_allclose(box.bounds.mean(axis=0), [100, 50, -20], atol=1e-3)
    np.testing.assert_allclose(cube.bounds, [[-40, -5, -12], [40, 5, 0]], atol=1e-3)
    assert ball.volume == pytest.approx(36.0 * np.pi, rel=0.02)
    np.testing.assert_allclose(ball.bounds.mean(axis=0), [1, 2, -3], atol=0.01)


def test_what_does_not_glow_is_no_hot_part(tmp_path):
    """Rationale: a table under the part is not at 900 degC."""
    glow = '<emitter type="glow"><float name="temperature" value="900"/></emitter>'
    shapes = (
        f'<shape type="cube" id="part">{glow}</shape>'
        '<shape type="rectangle" id="table"><transform name="to_world"><scale value="99"/>'
        '<translate z="-1"/></transform></shape>'
    )
    mesh, notes = part_mesh(with_part(tmp_path, shapes))
    np.testing.assert_allclose(mesh.bounds, [[-1, -1, -1], [1, 1, 1]], atol=1e-6)
    assert notes == ("left out of the air, since they do not glow: table",)


def test_a_shape_without_a_mesh_is_told(tmp_path):
    """Rationale: a part that silently lacks a piece has other air."""
    shapes = (
        '<shape type="shapegroup" id="g"><shape type="sphere"/></shape>'
        '<shape type="instance"><ref id="g"/></shape>'
    )
    with pytest.raises(InputError, match=r"mine.xml: the shape .* give its surface as a mesh"):
        part_mesh(with_part(tmp_path, shapes))
