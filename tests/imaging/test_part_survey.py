"""What a part's file is found to hold, beside solids whose faults and facets are known."""

import numpy as np
import pytest
import trimesh

from virtual_sensor.errors import InputError
from virtual_sensor.imaging.part_survey import survey, survey_part
from virtual_sensor.imaging.parts import Part
from virtual_sensor.imaging.scene_file import shipped_scenes

make = trimesh.creation


def surveyed(mesh):
    """The survey of a mesh of trimesh's."""
    return survey_part(Part(np.array(mesh.vertices), np.array(mesh.faces)))


def places_on(mesh):
    """Points all over the facets of a mesh, (N, 3)."""
    weight = np.random.default_rng(0).dirichlet([1, 1, 1], 20)
    return np.einsum("bk,fki->fbi", weight, mesh.triangles).reshape(-1, 3)


def test_facets_cost_what_they_lie_beside_the_solid_that_they_stand_for():
    """The estimate is within 20 % of the distance by the solid's own formula."""
    for n in (16, 48):
        truth = {
            make.cylinder(13.5, 60, sections=n): lambda p: np.hypot(p[:, 0], p[:, 1]) - 13.5,
            make.uv_sphere(13.5, count=(n, n)): lambda p: np.linalg.norm(p, axis=1) - 13.5,
            make.torus(30, 8, n, 2 * n): lambda p: (
                np.hypot(np.hypot(p[:, 0], p[:, 1]) - 30.0, p[:, 2]) - 8.0
            ),
            make.icosphere(2 if n == 16 else 4, 13.5): lambda p: np.linalg.norm(p, axis=1) - 13.5,
        }
        for mesh, distance in truth.items():
            points = places_on(mesh)
            points = points[np.abs(points[:, 2]) < 0.999 * mesh.bounds[1, 2]]  # no end face
            worst_um = 1e3 * np.abs(distance(points)).max()
            assert surveyed(mesh).facet_error_um == pytest.approx(worst_um, rel=0.2)


def test_a_solid_of_flat_faces_has_no_facet_error():
    """A box, a hexagonal bar, and the steps of a staircase in its side."""
    for mesh in (make.box((60, 40, 10)), make.cylinder(10, 40, sections=6)):
        assert surveyed(mesh).facet_error_um == 0.0


def test_faults_of_a_mesh_are_counted_and_a_sound_one_is_silent():
    """A box in 192 triangles: with a hole, faces turned, all turned, faces twice; an open sheet."""
    box = make.box((60, 40, 10)).subdivide().subdivide()
    count = len(box.faces)
    sound = surveyed(box)
    assert (sound.triangles, sound.holes, sound.flipped_faces, sound.double_faces) == (192, 0, 0, 0)
    assert sound.notes == ()
    np.testing.assert_allclose(sound.top_mm, [0, 0, 5])

    def changed(faces):
        return surveyed(trimesh.Trimesh(box.vertices, faces, process=False))

    assert (found := changed(box.faces[1:])).holes == 1
    assert "1 hole, up to" in found.notes[0]
    turned = box.faces.copy()
    turned[:7] = turned[:7, ::-1]
    assert (found := changed(turned)).flipped_faces == 7
    assert "7 of its 192 triangles are turned inside out" in found.notes[0]
    assert changed(box.faces[:, ::-1]).flipped_faces == count
    assert changed([*box.faces, *box.faces[:3]]).double_faces == 3
    sheet = surveyed(trimesh.Trimesh(box.vertices, box.faces[box.face_normals[:, 2] > 0.9]))
    assert (sheet.holes, sheet.flipped_faces, sheet.notes) == (0, 0, ())


def test_the_inner_wall_of_a_hollow_part_is_not_turned_inside_out():
    """A cavity's faces look into it."""
    hollow = make.icosphere(2, 13.5) + trimesh.Trimesh(
        make.icosphere(2, 9.0).vertices, make.icosphere(2, 9.0).faces[:, ::-1], process=False
    )
    assert surveyed(hollow).flipped_faces == 0


def test_a_file_is_surveyed_in_its_unit(tmp_path):
    """Inches; a name with a space and an umlaut; the shipped mesh is sound."""
    path = tmp_path / "Teil für 1.stl"
    path.write_bytes(make.box((2, 1, 0.5)).export(file_type="stl"))
    found = survey(path, "inch")
    np.testing.assert_allclose(found.size_mm, [50.8, 25.4, 12.7], rtol=1e-6)
    np.testing.assert_allclose(found.top_mm, [0, 0, 6.35], atol=1e-5)
    with pytest.raises(InputError, match=r"unit yard: there is no such unit; give one of um, mm"):
        survey(path, "yard")
    assert survey(shipped_scenes() / "meshes" / "stepped_shaft.ply").notes == ()
