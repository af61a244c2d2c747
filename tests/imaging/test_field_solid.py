"""A field of air is that of the scene's part, or that is said."""

import re
import shutil
from dataclasses import replace

import numpy as np
import pytest
import trimesh

import virtual_sensor as vs
from virtual_sensor.errors import InputError
from virtual_sensor.imaging.checks import check_scene
from virtual_sensor.imaging.scene_file import shipped_scenes
from virtual_sensor.medium.netcdf import GriddedQuantity, write_quantity

HOT = (shipped_scenes() / "hot_cylinder.xml").read_text(encoding="utf-8")
HOT = HOT.replace("fields/", f"{shipped_scenes()}/fields/")
SHAPES = re.search(r"<shape.*</shape>", HOT, re.DOTALL)[0]
STEEL = '<ref id="steel"/></shape>'


def cylinder(radius, half, axis_z):
    """An open cylinder along x."""
    ends = "".join(
        f'<point name="p{n}" x="{x}" y="0" z="{axis_z}"/>' for n, x in enumerate((-half, half))
    )
    return f'<shape type="cylinder">{ends}<float name="radius" value="{radius}"/>{STEEL}'


def ball(radius):
    """A ball that touches z = 0 from below."""
    place = f'<point name="center" x="0" y="0" z="{-radius}"/>'
    return f'<shape type="sphere">{place}<float name="radius" value="{radius}"/>{STEEL}'


def mesh(path, solid):
    """A mesh of trimesh's in a file, as a shape."""
    solid.export(path)
    return f'<shape type="ply"><string name="filename" value="{path}"/>{STEEL}'


@pytest.fixture
def judged(tmp_path):
    """Notes on a part in the field of the cylinder of radius 13.5 and length 170 mm; a refusal."""

    def judge(shape, air="", **parameters):
        path = tmp_path / "scene.xml"
        text = HOT.replace(SHAPES, shape).replace('"refractive">', f'"refractive">{air}')
        path.write_text(text, encoding="utf-8")
        scene = vs.load_scene(path, **parameters)
        try:
            assert all("facets" in note for note in check_scene(scene))
        except InputError as error:
            return "\n".join(scene.loading_notes), str(error)
        return "\n".join(scene.loading_notes), ""

    return judge


def off_mm(words):
    """How far the solid and the part are said to differ."""
    return float(re.search(r"its solid and the part differ by (\S+) mm or more", words)[1])


@pytest.mark.parametrize(
    ("shape", "share", "far_mm"),
    # Of the cylinder's cross-section 13.5^2 pi times 170 mm, each part leaves so much uncovered.
    [
        (ball(13.5), 1 - 27 / 170, 85 - 13.5),
        (ball(8.0), 1 - 16 / 170, 85 - 8.0),
        (cylinder(13.5, 30, -13.5), 110 / 170, 55),
    ],
    ids=["ball", "small ball", "short cylinder"],
)
def test_another_part_in_a_cylinders_field_is_refused(judged, shape, share, far_mm):
    """Rationale: a ball gave 2e4 um without a word."""
    note, refusal = judged(shape)
    for said in (note, refusal):
        found = re.search(
            r"quarter\.nc is not of this part: .* or more, (\d+)% of it lies out", said
        )
        assert float(found[1]) / 100.0 == pytest.approx(share, abs=0.06)
        assert off_mm(said) == pytest.approx(far_mm, abs=5.0)
        assert "virtual-sensor field simulate --scene" in said
    assert "or give none (field=)" in refusal


def test_a_part_that_is_somewhat_other_gets_a_note(judged, tmp_path):
    """Shorter, thinner, thicker or turned: by how much; so thick that it stands in the open: no."""
    turned = trimesh.creation.cylinder(13.5, 170.0, sections=64)
    for angle, axis in ((90.0, (0, 1, 0)), (5.0, (0, 0, 1))):
        turned.apply_transform(trimesh.transformations.rotation_matrix(np.radians(angle), axis))
    turned.apply_translation((0.0, 0.0, -13.5))
    for shape, far_mm, doubt_mm in (
        (cylinder(13.5, 60, -13.5), 85 - 60, 3.0),
        (cylinder(20.0, 85, -13.5), 20 - 13.5, 1.0),
        (cylinder(10.0, 85, -13.5), 13.5 - 10.0, 1.0),
        (mesh(tmp_path / "turned.ply", turned), 42 * np.sin(np.radians(5.0)), 1.5),  # on average
    ):
        note, refusal = judged(shape)
        assert off_mm(note) == pytest.approx(far_mm, abs=doubt_mm)
        assert "make this part's own: virtual-sensor field simulate" in note
        assert not refusal
    assert re.search(r"1\d% of it lies outside", judged(cylinder(10.0, 85, -13.5))[0])
    assert "the laser's line lies 12 mm above it" in judged(cylinder(26.0, 85, -13.5))[1]


def test_a_part_that_was_moved_is_recognised(judged, tmp_path):
    """Of a mesh too: how far its field must follow; where that does, there is nothing to say."""
    bar = trimesh.creation.cylinder(13.5, 170.0, sections=64)
    bar.apply_transform(trimesh.transformations.rotation_matrix(np.pi / 2.0, (0, 1, 0)))
    bar.apply_translation((0.0, 0.0, -11.5))
    shape = mesh(tmp_path / "bar.ply", bar)
    note, refusal = judged(shape)
    assert off_mm(note) == pytest.approx(2.0, abs=0.6)
    assert "they are of one size, and it lies (0, 0, -2) mm off" in note
    assert "move the field by (0, 0, 2) mm (to_world of the integrator), or make" in note
    move = '<transform name="to_world"><translate z="2"/></transform>'
    assert judged(shape, move) == ("", refusal)
    along = cylinder(13.5, 85, -13.5).replace("-85", "-73").replace("85", "97")
    assert "lies (-12, 0, 0) mm off" in judged(along)[0]


def test_a_table_under_the_part_is_not_the_part(judged):
    """Rationale: it may stand in the scene and not in the air; a thicker part on it is found."""
    move = '<transform name="to_world"><scale value="150"/><translate z="-35"/></transform>'
    table = f'<shape type="rectangle">{move}{STEEL}'
    (note,) = judged(cylinder(13.5, 85, -13.5) + table)[0].splitlines()
    assert "not of all that is in the scene: surfaces lie up to 32 mm beside its solid" in note
    assert off_mm(judged(cylinder(20.0, 85, -13.5) + table)[0]) == pytest.approx(6.5, abs=1.0)


def test_a_section_is_of_every_length(judged, tmp_path):
    """Rationale: `field simulate --section`, the first that is documented, was refused."""
    _, y, z = np.meshgrid(*map(np.arange, (-180, -36, -36), (181, 37, 61), (60, 1.5, 1.5)))
    solid = np.hypot(y, z + 13.5).swapaxes(0, 1) < 13.5
    kelvin = np.where(solid, np.nan, 293.15)
    grid = np.array([-180.0, -36.0, -36.0]), np.array([60.0, 1.5, 1.5])
    write_quantity(tmp_path / "air.nc", GriddedQuantity("temperature", kelvin, *grid, solid=solid))
    own, other = (judged(cylinder(r, 85, -13.5), field=tmp_path / "air.nc") for r in (13.5, 18))
    assert "not of this part" not in own[0]
    assert off_mm(other[0]) == pytest.approx(18 - 13.5, abs=1.0)


@pytest.mark.parametrize("beta", [0, 45])
def test_the_parts_own_field_is_silent(beta):
    """Only the shaft's is not its own, and it is up to 1.5 mm thinner where it is lit."""
    assert vs.load_scene("hot_cylinder", beta=beta).notes == ()
    shaft = vs.load_scene("stepped_shaft", beta=beta)
    assert check_scene(shaft) == []
    assert "simulate --scene stepped_shaft --quick -o air.nc" in shaft.notes[0]


def test_a_field_without_a_solid_says_so(judged, tmp_path):
    """Rationale: nothing is known of its part but how hot its air is."""
    air = vs.IndexField.read("hot_cylinder_1250C_quarter")
    replace(air, solid=None).write(tmp_path / "air.nc")  # of n - 1
    field = tmp_path / "air.nc"
    own = cylinder(13.5, 85, -13.5)
    note, _ = judged(own, field=field)
    assert note.endswith("air.nc marks no solid: whether it is of this part can't be checked")
    assert "hotter than the part, up to 1250 degC" in judged(own, field=field, temperature=900)[0]
    assert "colder than the part, up to 1250 degC" in judged(own, field=field, temperature=1990)[0]


def test_a_field_of_another_temperature_is_told(tmp_path):
    """By what `field simulate` wrote of the part; a scene that says nothing is believed."""
    field = "hot_cylinder_900C_quarter"
    (note,) = vs.load_scene("hot_cylinder", field=field).notes
    assert "900C_quarter.nc is of a part of 900 degC, and the scene's temperature is 1250" in note
    assert vs.load_scene("hot_cylinder", field=field, temperature=900.5).notes == ()


def test_notes_of_a_field_that_is_gone_are_those_of_the_scene(tmp_path):
    """Rationale: they are asked for later than the field is read."""
    shutil.copy(shipped_scenes() / "fields" / "hot_cylinder_900C_quarter.nc", tmp_path / "air.nc")
    scene = vs.load_scene("hot_cylinder", field=tmp_path / "air.nc")
    (tmp_path / "air.nc").unlink()
    assert scene.notes == ()


def test_air_that_is_given_is_looked_at_too():
    """Rationale: only what stood in the scene's own file was: a render in other air was silent."""
    scene, air = vs.load_scene("hot_cylinder"), vs.IndexField.read("hot_cylinder_1250C_quarter")
    assert scene.with_medium(air).notes == ()
    aside = scene.with_medium(air.moved(vs.Pose.shift([0.0, 0.0, 3.0])))
    assert any("the given air is not of this part: its solid" in note for note in aside.notes)
