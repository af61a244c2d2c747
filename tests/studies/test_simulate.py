"""Simulations of the air by real OpenFOAM, from the command to the field, and when they end."""

import json
import signal
import subprocess
import sys
import time
from pathlib import Path

import numpy as np
import pytest
import trimesh

from virtual_sensor.errors import InputError
from virtual_sensor.imaging.scene import load_scene
from virtual_sensor.imaging.scene_file import shipped_scenes
from virtual_sensor.medium.heat_flow.openfoam import find_openfoam
from virtual_sensor.medium.heat_flow.sample import SampleGrid, sample
from virtual_sensor.medium.heat_flow.setup import HeatFlow, Until
from virtual_sensor.medium.imports.meshes import read_openfoam
from virtual_sensor.medium.index_field import IndexField
from virtual_sensor.medium.netcdf import GriddedQuantity, field_times
from virtual_sensor.studies.scene_air import SceneAir, scene_air
from virtual_sensor.studies.simulate import Steadiness, duration, simulate

SECTION = HeatFlow(section=True, cell_mm=1.2)
COMMAND = (
    *("field", "simulate", "--section", "--cell", "1.2", "--time", "0.4", "--every", "0.1"),
    *("--grid", "3,1.5,3", "-o", "air.nc"),
)
POINTS = np.random.default_rng(1).uniform([-50, -20, 5], [50, 20, 150], (2000, 3))


def alone(flow) -> SceneAir:
    """A flow without a scene."""
    return scene_air(None, {}, flow)


@pytest.fixture(scope="session")
def simulator():
    """What a simulation needs; without it these tests are skipped, with what is missing."""
    pytest.importorskip("pyvista", reason="needs PyVista: pip install 'virtual-sensor[fields]'")
    try:
        find_openfoam()
    except InputError as error:
        pytest.skip(f"{error}")


def start(folder, *more):
    program = "from virtual_sensor import cli; cli.main()"
    words = [sys.executable, "-c", program, *COMMAND, *more]
    return subprocess.Popen(
        words, cwd=folder, stdout=subprocess.PIPE, stderr=subprocess.STDOUT, text=True
    )


@pytest.fixture(scope="session")
def uninterrupted(simulator, tmp_path_factory):
    """A folder with a field that was simulated in one go, and what was said."""
    folder = tmp_path_factory.mktemp("uninterrupted")
    run = start(folder)
    said, _ = run.communicate(timeout=300)
    assert run.returncode == 0, said
    return folder, said


@pytest.mark.slow
def test_the_command_leaves_a_field_that_says_how_it_was_made(uninterrupted):
    """Rationale: a field of unknown origin is worth nothing a year later."""
    folder, said = uninterrupted
    air = IndexField.read(folder / "air.nc")
    assert "OpenFOAM v" in air.source
    assert "1250 degC" in air.source
    assert "flow time 0.4 s" in air.source
    top = air.refractivity([[0.0, 0.0, 0.5]])[0]
    assert 0.18 < top / air.ambient < 0.23  # 293 K over 1523 K, and a little air in between
    assert "Nusselt" in said
    assert "air.nc" in said
    assert json.loads((folder / "air.case/setup.json").read_text())["cell_mm"] == 1.2


@pytest.mark.slow
@pytest.mark.parametrize("number", [signal.SIGKILL, signal.SIGINT])
def test_a_simulation_killed_half_way_goes_on_to_the_same_field(uninterrupted, tmp_path, number):
    """Rationale: hours of computing must survive a power cut, and leave no trace in the result."""
    run = start(tmp_path)
    saved = tmp_path / "air.case/0.2/uniform/time"
    patience = time.monotonic() + 120.0
    while not saved.exists() and time.monotonic() < patience and run.poll() is None:
        time.sleep(0.02)
    assert run.poll() is None, run.communicate()[0]
    run.send_signal(number)
    said, _ = run.communicate(timeout=120)
    assert run.returncode == (-9 if number == signal.SIGKILL else 130), said
    assert not (tmp_path / "air.nc").exists()
    if number == signal.SIGINT:
        assert "the same command goes on" in said
    again = start(tmp_path)
    said, _ = again.communicate(timeout=300)
    assert again.returncode == 0, said
    fields = [IndexField.read(folder / "air.nc") for folder in (uninterrupted[0], tmp_path)]
    refractivity = [air.refractivity(POINTS) for air in fields]
    np.testing.assert_allclose(refractivity[1], refractivity[0], rtol=1e-4)  # a step of 16 bits


@pytest.mark.slow
def test_the_sampled_field_is_what_the_solver_has_in_its_cells(uninterrupted):
    """Rationale: sampled at the cells' own centres in free air, VTK's reader is the reference."""
    case = uninterrupted[0] / "air.case"
    source = read_openfoam(case, 0.4)
    centres = 1e3 * np.asarray(source.geometry.cells.cell_centers().points, dtype=float)
    kelvin = next(v.values for v in source.variables if v.name == "T")
    _, y, z = centres.T
    free = (np.hypot(y, z + 13.5) > 16.0) & (y < 30.0) & (z > -30.0) & (z < 280.0)
    fine = SampleGrid.of(SECTION, (3.0, 0.25, 0.5))
    quantity = sample(SECTION, case, (0.4,), fine)
    place = np.stack([(y[free] - fine.y[0]) / 0.25, (z[free] - fine.z[0]) / 0.5])
    j, k = np.rint(place).astype(int)
    on_node = (abs(place - np.rint(place)) < 0.1).all(axis=0)
    assert on_node.sum() > 20
    found = quantity.values[0, j[on_node], k[on_node]]
    assert np.abs(found - kelvin[free][on_node]).max() < 6.0  # a tenth of a node beside, 60 K/mm


@pytest.mark.slow
def test_recorded_instants_become_a_time_axis(simulator, uninterrupted, tmp_path):
    """Rationale: a burst needs the instants between which the air moves."""
    folder = uninterrupted[0]
    path = tmp_path / "sway.nc"
    until = Until(0.4, 0.4, 0.0)
    simulate(alone(SECTION), folder / "air.case", path, until, record_s=0.2, every_s=0.1)
    np.testing.assert_allclose(field_times(path), [0.2, 0.3, 0.4])


@pytest.mark.slow
def test_a_scene_finds_the_air_of_its_own_part(simulator, tmp_path):
    """Rationale: a part of one's own to a measurement in its air, with nothing said twice."""
    folder = tmp_path / "größe 1"
    folder.mkdir()
    part = trimesh.creation.box((24.0, 16.0, 8.0))
    part.apply_translation([200.0, -50.0, -4.0])
    part.invert()  # its faces look inwards
    part.export(folder / "part.stl")
    text = (shipped_scenes() / "hot_cylinder.xml").read_text(encoding="utf-8")
    shape = (
        '<shape type="stl"><string name="filename" value="part.stl"/><transform name="to_world">'
        '<translate x="-200" y="50"/></transform></shape></scene>'
    )
    text = text[: text.index('<shape type="cylinder"')] + shape
    text = text.replace("fields/hot_cylinder_$temperatureC_quarter.nc", "mine_air.nc")
    scene = folder / "mine.xml"
    scene.write_text(text, encoding="utf-8")
    command = "from virtual_sensor import cli; cli.main()"
    words = ("field", "simulate", "--scene", "mine", "--quick", "--cell", "5", "--time", "0.5")
    ended = subprocess.run(
        [sys.executable, "-c", command, *words], cwd=folder, capture_output=True, text=True
    )
    assert ended.returncode == 0, ended.stderr
    assert "a first look" in ended.stdout
    assert "virtual-sensor measure mine`" in " ".join(ended.stdout.split())
    loaded = load_scene(scene)
    assert loaded.medium is not None
    assert not [note for note in loaded.notes if "not of this part" in note]
    above, beside = loaded.medium.refractivity([[0.0, 0.0, 3.0], [0.0, 30.0, -4.0]])
    ambient = loaded.medium.ambient
    assert above < 0.5 * ambient  # hot
    assert beside > 0.9 * ambient
    light = loaded.cameras["camera"].pose.origin_mm[2]
    assert loaded.medium.box[1, 2] > light


def shifted(time_s):
    """Air whose plume moves by ever less: (4, ny, nz) on the grid of a section."""
    grid = SampleGrid.of(SECTION, (60.0, 1.5, 6.0))
    y, z = np.meshgrid(grid.y, grid.z, indexing="ij")
    width = 5.0 + np.exp(-3.0 * time_s)
    plane = 293.15 + 400.0 * np.exp(-((y / width) ** 2)) * np.exp(-(((z - 100.0) / 60.0) ** 2))
    return GriddedQuantity(
        "temperature",
        np.repeat(plane[None], len(grid.x), axis=0),
        np.array([grid.x[0], grid.y[0], grid.z[0]]),
        grid.spacing,
        None,
        {"ambient_temperature": 293.15},
        (True, True, False),
    )


def test_it_ends_once_the_rays_stand_still_and_not_before_its_time():
    """Rationale: the field is for light; the drift of a plume that settles as exp(-3t) is known."""
    steadiness = Steadiness(load_scene("hot_cylinder"), Until(5.0, 1.0, 0.3), shifted)
    drifts = {}
    for time_s in np.arange(0.25, 5.1, 0.25):
        ends = steadiness(float(time_s))
        drifts[float(time_s)] = steadiness.drift_px_per_s
        if ends:
            break
    assert np.isnan(drifts[0.5])  # not searched yet
    searched = [t for t in drifts if np.isfinite(drifts[t])]
    assert searched[0] == 1.0
    assert drifts[searched[-1]] < 0.3 <= drifts[searched[-2]]
    # As the width's: each quarter of a second divides it by exp(3/4).
    assert drifts[searched[-2]] / drifts[searched[-1]] == pytest.approx(np.exp(0.75), rel=0.15)


def test_air_at_the_start_is_compared_with_nothing():
    """Rationale: a flow of 0.3 s has no earlier field, and its start is a formula, not a field."""
    searched = []
    steadiness = Steadiness(
        load_scene("hot_cylinder"), Until(0.3, 0.3), lambda t: searched.append(t) or shifted(t)
    )
    steadiness.look_back([0.0, 0.25, 0.3])
    assert np.isnan(steadiness.drift_px_per_s)
    steadiness.look_back([0.0, 0.25, 0.5])
    assert steadiness.drift_px_per_s > 0.0
    assert searched == [0.25, 0.5]


def test_zero_steadiness_runs_to_the_end():
    """Rationale: who wants 15 s gets 15 s."""
    steadiness = Steadiness(load_scene("hot_cylinder"), Until(5.0, 1.0, 0.0), shifted)
    assert not any(steadiness(t) for t in (1.0, 2.0, 5.0))


@pytest.mark.parametrize(
    ("asked", "said"),
    [
        (lambda: Until(1.0, 2.0), "--at-least 2 s, --time 1 s"),
        (lambda: HeatFlow(temperature_c=10.0), "the part must be the hotter one"),
        (lambda: HeatFlow(radius_mm=-1.0), "must be positive"),
        (lambda: HeatFlow(whole=True), "in a section only"),
        (lambda: HeatFlow(stl=Path("a.stl"), section=True), "leave the STL file or the section"),
        (
            lambda: simulate(
                alone(HeatFlow(section=True, cell_mm=3.0)), Path("case"), Path("a.nc"), Until()
            ),
            "resolves the wall layer with 2 cells; at least 6 are needed: take 1.2 mm or less",
        ),
    ],
)
def test_what_cannot_be_simulated_is_refused_before_any_work(asked, said, tmp_path, monkeypatch):
    """Rationale: a clear error, and nothing lost or left behind."""
    monkeypatch.chdir(tmp_path)
    with pytest.raises(InputError, match=said):
        asked()
    assert not list(tmp_path.iterdir())


def test_a_missing_reader_is_told_before_hours_of_computing(tmp_path, monkeypatch):
    """Rationale: the results are read only at the end, and a run of hours would be in vain."""
    monkeypatch.setattr("virtual_sensor.studies.simulate.find_openfoam", lambda parallel: None)
    monkeypatch.setitem(sys.modules, "pyvista", None)
    with pytest.raises(InputError, match=r"pip install 'virtual-sensor\[fields\]'"):
        simulate(alone(SECTION), tmp_path / "case", tmp_path / "air.nc", Until())
    assert not list(tmp_path.iterdir())


def test_durations_read_as_people_say_them():
    """Rationale: '5400 s left' is no estimate that anybody can use."""
    assert [duration(s) for s in (5.2, 61.0, 5400.0)] == ["5 s", "1 min 1 s", "1 h 30 min"]
