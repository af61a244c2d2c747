"""A field of air is that of the scene's part, or that is said."""

import re

import numpy as np
import pytest

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


@pytest.fixture
def judged(tmp_path):
    """What is said of a part in the field of the cylinder of radius 13.5 and length 170 mm."""

    def judge(shape, **parameters):
        path = tmp_path / "scene.xml"
        path.write_text(HOT.replace(SHAPES, shape), encoding="utf-8")
        try:
            return check_scene(vs.load_scene(path, **parameters))
        except InputError as error:
            return str(error)

    return judge


@pytest.mark.parametrize(
    ("shape", "share"),
    # Of the cylinder's cross-section 13.5^2 pi times 170 mm, each part leaves so much uncovered.
    [(ball(13.5), 1 - 27 / 170), (ball(8.0), 1 - 16 / 170), (cylinder(13.5, 30, -13.5), 110 / 170)],
    ids=["ball", "small ball", "short cylinder"],
)
def test_another_part_in_a_cylinders_field_is_refused(judged, shape, share):
    """Rationale: a ball gave 2e4 um without a word."""
    said = judged(shape)
    assert isinstance(said, str)
    found = re.search(
        r"the field hot_cylinder_1250C_quarter\.nc is not of this part: (\d+)% of its solid lies"
        r" outside the part; give a field of this part, or none",
        said,
    )
    assert float(found[1]) / 100.0 == pytest.approx(share, abs=0.06)


def test_a_part_that_is_somewhat_other_gets_a_note(judged):
    """A cylinder that is shorter, thinner, or so thick that it lies in the field's open air."""
    (shorter,) = judged(cylinder(13.5, 60, -13.5))
    assert re.search(r"not of this part: 2\d% of its solid lies outside", shorter)
    (thinner,) = judged(cylinder(10.0, 85, -13.5))
    assert re.search(r"not of this part: 1\d% of its solid", thinner)
    (thicker,) = judged(cylinder(20.0, 85, -13.5))
    away = float(re.search(r"the laser's line lies (\S+) mm from its solid", thicker)[1])
    assert away == pytest.approx(20.0 - 13.5, abs=1.0)
    assert "from its solid; give a field of this part" in judged(cylinder(26.0, 85, -13.5))


@pytest.mark.parametrize("name", ["hot_cylinder", "stepped_shaft"])
@pytest.mark.parametrize("beta", [0, 45])
def test_the_parts_own_field_is_silent(name, beta):
    """The shaft is up to 1.5 mm thinner than the cylinder: less than a cell of the field."""
    assert check_scene(vs.load_scene(name, beta=beta)) == []


def test_a_field_without_a_solid_is_silent(judged, tmp_path):
    """Rationale: nothing is known of its part."""
    origin, spacing = np.array([-90.0, -20.0, -16.0]), np.array([22.5, 5.0, 14.5])
    air = GriddedQuantity("temperature", np.full((9, 9, 9), 293.15), origin, spacing)
    write_quantity(tmp_path / "air.nc", air)
    assert judged(ball(13.5), field=tmp_path / "air.nc") == []
