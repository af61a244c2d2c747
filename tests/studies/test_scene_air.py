"""What is simulated for a scene: its part, its temperature, air up to its sensor."""

from dataclasses import replace

import numpy as np
import pytest
import trimesh
from command_line import command

from virtual_sensor.errors import InputError
from virtual_sensor.imaging.scene_file import shipped_scenes
from virtual_sensor.medium.heat_flow.mesh import cylinder_mesh
from virtual_sensor.medium.heat_flow.quick import CELLS, quick_cell_mm, quick_time_s
from virtual_sensor.medium.heat_flow.setup import HeatFlow
from virtual_sensor.medium.heat_flow.snapped_mesh import expected_cells, read_part, snapped_mesh
from virtual_sensor.studies.scene_air import scene_air

SHAFT = shipped_scenes() / "stepped_shaft.xml"


@pytest.fixture
def mine(tmp_path):
    """A scene of one's own, whose field does not exist yet, in a folder with a blank."""
    folder = tmp_path / "größe 1"
    folder.mkdir()
    text = SHAFT.read_text(encoding="utf-8")
    text = text.replace("meshes/stepped_shaft.ply", str(SHAFT.parent / "meshes/stepped_shaft.ply"))
    text = text.replace("fields/hot_cylinder_$temperatureC_quarter.nc", "mine_$temperatureC.nc")
    path = folder / "mine.xml"
    path.write_text(text, encoding="utf-8")
    return path


def test_a_scene_says_part_temperature_light_and_where_its_air_belongs(mine):
    """Rationale: nothing needs to be said twice; the field is missing, since it is to be made."""
    air = scene_air(mine, {"beta": "0"}, HeatFlow())
    assert air.flow.temperature_c == 1250.0
    assert air.output == air.field == mine.parent / "mine_1250C.nc"
    low, high = air.part.bounds
    np.testing.assert_allclose([low[0], high[0], high[2]], [-85, 85, 0], atol=1e-3)
    x, y, top = air.flow.light_mm
    assert max(abs(x), abs(y)) < 3.0  # the line lies deeper in grooves, and slants
    assert 255.0 < top < 275.0  # camera and laser are 300 mm away, 30 degrees from the vertical
    warm = scene_air(mine, {}, HeatFlow(), temperature_c=600.0)
    assert (warm.flow.temperature_c, warm.field.name) == (600.0, "mine_600C.nc")
    assert warm.parameters == {"temperature": "600"}


def test_a_shipped_cylinder_is_simulated_as_a_quarter():
    """Rationale: its mesh of blocks is finer and quicker than one that is cut and snapped."""
    air = scene_air("hot_cylinder", {"temperature": "900"}, HeatFlow())
    assert air.part is None
    assert (air.flow.radius_mm, air.flow.length_mm) == pytest.approx((13.5, 170.0))
    assert air.flow.temperature_c == 900.0
    assert air.output is None  # nobody writes among the shipped fields


@pytest.mark.parametrize(
    ("given", "said"),
    [
        ({"flow": HeatFlow(section=True)}, "--section is of a cylinder .*; leave it out"),
        ({"parameters": {"along": "120"}}, "the laser misses the part"),
        ({"temperature_c": 5.0}, "the part must be the hotter one"),
    ],
)
def test_what_has_no_air_is_refused_before_the_solver_starts(mine, given, said):
    """Rationale: told in a second, not after minutes."""
    given = {"parameters": {}, "flow": HeatFlow()} | given
    with pytest.raises(InputError, match=said):
        scene_air(mine, **given)


def test_a_first_look_is_as_fine_as_its_cells_allow(tmp_path, mine):
    """Rationale: a minute or two, whatever the part's size; thin walls must not get lost."""
    pytest.importorskip("pyvista")
    path = tmp_path / "part.stl"
    air = scene_air(mine, {}, HeatFlow(quick=True))
    for scale in (0.1, 1.0, 6.0):
        air.part.copy().apply_scale(scale).export(path)
        part = read_part(path)
        width = quick_cell_mm(air.flow, part)
        count = expected_cells(part, snapped_mesh(part, width, air.flow.light_mm[2]))
        assert 0.7 * CELLS < count < 2.0 * CELLS
    trimesh.creation.box((60.0, 40.0, 1.0)).export(path)
    assert quick_cell_mm(air.flow, read_part(path)) <= 1.5
    trimesh.creation.box((60.0, 40.0, 0.2)).export(path)
    with pytest.raises(InputError, match=r"walls of some 0.2 mm .* million: no quick look"):
        quick_cell_mm(air.flow, read_part(path))
    for radius in (2.0, 13.5, 100.0):  # cylinders as well, with room for their blocks
        flow = HeatFlow(radius_mm=radius, length_mm=12.0 * radius, quick=True)
        flow = replace(flow, cell_mm=quick_cell_mm(flow, None))
        assert cylinder_mesh(flow).cells < 8.0 * CELLS
    assert quick_cell_mm(HeatFlow(section=True, quick=True), None) == 1.2
    assert quick_time_s(HeatFlow(900.0)) == 2.0
    assert quick_time_s(HeatFlow(240.0)) == 4.0


def test_a_machine_without_openfoam_is_told_what_else_there_is(mine, monkeypatch):
    """Rationale: a stranger has none, and a field is to be had without."""
    monkeypatch.setenv("PATH", "/nowhere")
    monkeypatch.setattr("virtual_sensor.medium.heat_flow.openfoam.PLACES", ())
    monkeypatch.chdir(mine.parent)
    status, _, err = command("field", "simulate", "--scene", "mine.xml", "--quick")
    assert status == 2
    assert "apt-get install openfoam" in err
    assert "virtual-sensor field import --help" in err
    assert sorted(p.name for p in mine.parent.iterdir()) == ["mine.xml"]
    status, _, err = command("field", "simulate", "--scene", "hot_cylinder", "--quick")
    assert "name the field's file with -o" in err
