"""What is printed of a field that was simulated or imported."""

import shlex

import numpy as np
import pytest
from command_line import command

from virtual_sensor.medium.heat_flow.balance import HeatBalance
from virtual_sensor.medium.heat_flow.run import RunEnd
from virtual_sensor.reporting.new_fields import simulated, written
from virtual_sensor.studies.simulate import Simulation


@pytest.mark.parametrize("known", [True, False])
def test_a_simulation_says_when_it_ended_and_how_sound_it_is(known):
    """Rationale: heat that is given off must be carried out; what was not searched is not said."""
    figures = (6.87, 9, 0.031) if known else (np.nan, 5, np.nan)
    balance = HeatBalance(50.0, 49.5, 0.001)
    result = Simulation(RunEnd(3.25, None, known), balance, *figures, 0.8, quick=not known)
    said = simulated(result, ["virtual-sensor", "field", "simulate", "--scene", "my a", "--quick"])
    assert said[0] == "ended at 3.25 s of flow" + (
        ", when the probe rays moved by 0.031 px per s of flow"
        if known
        else ": --quick ends there, steady or not"
    )
    assert said[1] == "heat: 50 W given off, 49.5 W carried out (-1.0%)"
    assert ("mean Nusselt number 6.87, by air of film temperature" in said) == known
    assert f"cells of 0.8 mm, {figures[1]} in the wall layer" in said
    if not known:
        assert "a first look" in said[-2]
        again = "virtual-sensor field simulate --scene 'my a' --quick --cell 0.53 -o finer_cells.nc"
        assert said[-1] == f"`{again}` shows how much still changes"


def test_the_command_that_examines_a_field_can_be_copied(tmp_path):
    """Rationale: a file's name may hold blanks and more."""
    path = tmp_path / "air of $(a) part.nc"
    path.write_bytes(bytes(1_500_000))
    said = written(path)
    assert said.startswith("1.5 MB in ")
    shown = said.partition("`")[2].partition("`")[0]
    assert shlex.split(shown) == ["virtual-sensor", "field", "info", str(path), "-o", "picture.png"]
    shown = (
        written(path, ["virtual-sensor", "measure", "my part.xml"])
        .partition("`")[2]
        .partition("`")[0]
    )
    assert shlex.split(shown) == ["virtual-sensor", "measure", "my part.xml"]


@pytest.mark.parametrize("words", ["simulate --section", "import air.vtu"])
def test_a_field_is_not_written_as_what_it_is_not(tmp_path, monkeypatch, words):
    """Rationale: asked before minutes of work."""
    monkeypatch.chdir(tmp_path)
    status, _, err = command("field", *words.split(), "-o", "air.h5")
    assert (status, err) == (2, "Error: -o air.h5: a field is written as .nc; name it so\n")
    assert not list(tmp_path.iterdir())
