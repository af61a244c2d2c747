"""What a part's file is found to hold, beside solids whose faults and facets are known."""

import re

import numpy as np
import pytest
import trimesh

import virtual_sensor as vs
from virtual_sensor.errors import InputError
from virtual_sensor.imaging.checks import check_scene
from virtual_sensor.imaging.part_survey import scale_note, survey, survey_part
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
    """A cavity's faces look into it; those of a ball in a ring's middle should not."""
    hollow = make.icosphere(2, 13.5) + trimesh.Trimesh(
        make.icosphere(2, 9.0).vertices, make.icosphere(2, 9.0).faces[:, ::-1], process=False
    )
    assert surveyed(hollow).flipped_faces == 0
    ball = make.icosphere(2, 5.0)
    ball.invert()
    assert surveyed(make.torus(30, 8) + ball).flipped_faces == len(ball.faces)
    assert surveyed(ball.apply_translation([30, 0, 0]) + make.torus(30, 8)).flipped_faces == 0


def test_a_file_is_surveyed_in_its_unit(tmp_path):
    """Inches; a name with a space and an umlaut; the shipped mesh is sound."""
    path = tmp_path / "Teil für 1.stl"
    path.write_bytes(make.box((2, 1, 0.5)).export(file_type="stl"))
    found = survey(path, "inch")
    np.testing.assert_allclose(found.size_mm, [50.8, 25.4, 12.7], rtol=1e-6)
    np.testing.assert_allclose(found.top_mm, [0, 0, 6.35], atol=1e-5)
    with pytest.raises(InputError, match=r"unit is 'yard'; take one of um, mm"):
        survey(path, "yard")
    assert survey(shipped_scenes() / "meshes" / "stepped_shaft.ply").notes == ()


def test_facets_without_area_and_t_junctions_are_no_faults():
    """A vertex on another face's edge leaves a crack of no width; slivers have no normal."""
    box = make.box((60, 40, 10))
    slivers = [[[0, 0, 5], [0, 0, 5], [1, 1, 5]], [[0, 0, 5], [1, 0, 5], [2, 0, 5]]]
    with_slivers = surveyed(
        trimesh.Trimesh(**trimesh.triangles.to_kwargs([*box.triangles, *slivers]))
    )
    assert with_slivers.notes == ()
    assert with_slivers.facet_error_um == 0.0
    place = [[0, 0, 0], [9, 0, 0], [9, 9, 0], [0, 9, 0], [0, 0, 5], [9, 0, 5], [9, 9, 5], [0, 9, 5]]
    faces = [[0, 3, 2], [0, 2, 1], [4, 8, 7], [8, 6, 7], [8, 5, 6], [0, 1, 5], [0, 5, 4]]
    faces += [[1, 2, 6], [1, 6, 5], [2, 3, 7], [2, 7, 6], [3, 0, 4], [3, 4, 7]]
    crack = surveyed(trimesh.Trimesh([*place, [5, 0, 5]], faces, process=False))
    assert (crack.holes, crack.notes) == (0, ())


def test_a_part_at_another_scale_is_noted_with_the_factor():
    """A part of 60 mm before a camera that sees 45 mm, in a file in metres and in inches."""
    assert scale_note(60.0, 45.0) == ""
    assert scale_note(8.0, 45.0) == ""
    assert '<scale value="1000"/> if its file is in m' in scale_note(0.06, 45.0)
    assert '<scale value="25.4"/> if its file is in inches' in scale_note(60.0 / 25.4 / 2.0, 45.0)
    assert '<scale value="0.001"/> if its file is in um' in scale_note(60_000.0, 45.0)


def test_a_scene_tells_of_its_parts_faults_and_of_facets_under_the_line(tmp_path):
    """A cylinder of 64 facets round, in metres, mirrored, with a hole: R (1 - cos(pi / 64))."""
    turned = trimesh.transformations.rotation_matrix(np.pi / 2.0, [0, 1, 0])
    mesh = make.cylinder(13.5, 170, sections=64).apply_transform(turned)
    mesh.apply_translation([0, 0, -13.5]).apply_scale(1e-3)
    mesh.update_faces(np.arange(len(mesh.faces)) > 0)
    (tmp_path / "Welle ü.stl").write_bytes(mesh.export(file_type="stl"))
    cold = (shipped_scenes() / "cold_cylinder.xml").read_text(encoding="utf-8")
    shape = '<shape type="stl"><string name="filename" value="Welle ü.stl"/><transform'
    shape += ' name="to_world"><scale x="-1000" y="1000" z="1000"/></transform></shape></scene>'
    path = tmp_path / "scene.xml"
    path.write_text(cold[: cold.index("    <shape")] + shape, encoding="utf-8")
    scene = vs.load_scene(path)
    assert [note for note in scene.notes if "Welle ü.stl: it has 1 hole, up to" in note]
    assert not [note for note in scene.notes if "inside out" in note or "scale" in note]
    (note,) = check_scene(scene)
    error_um = float(re.search(r"facets lie up to (\S+) um \(\S+ px\) beside", note)[1])
    assert error_um == pytest.approx(13.5e3 * (1.0 - np.cos(np.pi / 64)), rel=0.05)


def test_a_part_far_from_the_origin_is_told_of_rounding():
    """In float32 places near 2^17 mm are 2^-6 mm apart."""
    box = make.box((60, 40, 10))
    assert surveyed(box.apply_translation([9e3, 0, 0])).notes == ()
    (note,) = surveyed(box.apply_translation([2.0**17, 0, 0])).notes
    assert "float32 rounds places to 16 um: move it to the origin" in note
