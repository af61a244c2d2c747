"""Materials of scenes, which are Mitsuba's own BSDFs, and the parts that shine most."""

import numpy as np
import pytest
from virtual_sensor_scenes.make_v_groove import extruded, profile

import virtual_sensor as vs
from virtual_sensor.engine import mi
from virtual_sensor.imaging.scene_file import shipped_scenes

SMALL = {"width": 64, "height": 64, "spp": 1}


def bsdf_of(scene):
    """The BSDF of a scene's part."""
    return next(shape.bsdf() for shape in scene.mitsuba.shapes() if shape.id() == "part")


def ggx(cosine, alpha):
    """Density of the normals of GGX (Walter et al. 2007, equation 33)."""
    return alpha**2 / (np.pi * ((alpha**2 - 1.0) * cosine**2 + 1.0) ** 2)


@pytest.mark.parametrize(("roughness", "fraction"), [(0.1, 1 / 660), (0.3, 1 / 12)])
def test_ground_steel_has_the_normals_of_ggx(roughness, fraction):
    """Rationale: where light comes back to where it came from, the half vector is its direction.

    Seen from 30 degrees off the normal and from the normal, the values of the BSDF differ as the
    density of normals does, but for Smith's masking, which is known.
    """
    density = ggx(np.cos(np.radians(30.0)), roughness) / ggx(1.0, roughness)
    assert density == pytest.approx(fraction, rel=0.05)
    scene = vs.load_scene("v_groove", material="ground_steel", roughness=roughness, **SMALL)
    wi = mi.Vector3f([0.0, 0.5], [0.0, 0.0], [1.0, np.sqrt(0.75)])
    si = mi.SurfaceInteraction3f()
    si.wi = wi
    straight, slanted = np.ravel(bsdf_of(scene).eval(mi.BSDFContext(), si, wi))
    shadow = 2.0 / (1.0 + np.sqrt(1.0 + roughness**2 * np.tan(np.radians(30.0)) ** 2))
    expected = density * shadow**2 / np.cos(np.radians(30.0))  # D G / 4 cos, of equal directions
    assert slanted / straight == pytest.approx(expected, rel=1e-4)
    n, k = 2.9, 3.3
    mirror = ((n - 1) ** 2 + k**2) / ((n + 1) ** 2 + k**2)
    assert straight == pytest.approx(mirror * ggx(1.0, roughness) / 4.0, rel=0.01)


def test_v_groove_is_closed_and_what_its_script_makes():
    """Each edge has two triangles that run along it in opposite directions; walls at 45 degrees."""
    vertices, faces = extruded(profile())
    _, same = np.unique(vertices[:, :3], axis=0, return_inverse=True)
    corners = same.ravel()[faces]
    edges = np.concatenate([corners[:, [i, (i + 1) % 3]] for i in range(3)])
    there = set(map(tuple, edges.tolist()))
    assert len(there) == len(edges)
    assert there == {(end, start) for start, end in there}
    a, b, c = (vertices[faces[:, i], :3].astype(float) for i in range(3))
    volume = np.einsum("ij,ij->", a, np.cross(b, c)) / 6.0
    assert volume == pytest.approx(80.0 * (60.0 * 12.0 - 8.0**2))
    file = shipped_scenes() / "meshes" / "v_groove.ply"
    mesh = mi.traverse(mi.load_dict({"type": "ply", "filename": str(file)}))
    np.testing.assert_array_equal(np.ravel(mesh["faces"]), faces.ravel())
    np.testing.assert_array_equal(np.reshape(mesh["vertex_positions"], (-1, 3)), vertices[:, :3])
    np.testing.assert_array_equal(np.reshape(mesh["vertex_texcoords"], (-1, 2)), vertices[:, 6:])


def test_both_walls_of_the_groove_are_seen():
    """The whole line, on walls at 45 degrees and on the plates beside them."""
    scene = vs.load_scene("v_groove", **SMALL)
    assert scene.notes == ()
    found = vs.ray_search(scene, y := np.linspace(-10.9, 10.9, 41), "newton")
    assert np.all(found.status == vs.SearchStatus.FOUND)
    z = np.minimum(np.abs(y) - 8.0, 0.0)
    np.testing.assert_allclose(found.laser_point_mm[:, 2], z, atol=1e-4)
