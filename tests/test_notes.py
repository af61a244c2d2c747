"""What a reader ignored or assumed, every command says once and keeps in its summary."""

import json
from pathlib import Path

import numpy as np
import pytest
from typer.testing import CliRunner

from virtual_sensor import cli
from virtual_sensor.imaging.scene import Scene
from virtual_sensor.medium.netcdf import GriddedQuantity, write_quantity

pytestmark = pytest.mark.usefixtures("unpainted")

NOTE = "scene.xml: <made up> is ignored"
FILM = ["-D", "width=256", "-D", "height=256", "-D", "spp=1"]


@pytest.fixture
def here(tmp_path, monkeypatch):
    """A folder of one's own, and scenes of which something is to be noted."""
    noted = vars(Scene)["loading_notes"].fget
    monkeypatch.setattr(Scene, "loading_notes", property(lambda scene: (*noted(scene), NOTE)))
    monkeypatch.chdir(tmp_path)
    return tmp_path


def run(*arguments, status=0):
    """What a command prints."""
    ended = CliRunner().invoke(cli.app, arguments)
    assert ended.exit_code == status, ended.output
    return ended.output


def refuse(word):
    raise AssertionError(f"{word} is no JSON")


def kept(folder):
    """The notes in a summary, which is valid JSON."""
    text = (Path(folder) / "summary.json").read_text(encoding="utf-8")
    return json.loads(text, parse_constant=refuse)["notes"]


@pytest.mark.parametrize("name", ["measure", "sweep"])
@pytest.mark.parametrize("line_radius", ["0.5", "0.05"], ids=["line", "nothing found"])
def test_a_note_is_printed_once_and_is_in_the_summary(here, name, line_radius):
    """Rationale: also where no line is found, of which 72 of 199 scenes wrote invalid JSON."""
    status = 3 if line_radius == "0.05" else 0
    given = [*FILM, "-D", f"line_radius={line_radius}"]
    printed = run(name, "cold_cylinder", *given, "-o", "out", status=status)
    assert printed.count(NOTE) == 1
    assert sum(NOTE in note for note in kept("out")) == 1
    assert "nan" not in printed.split()


def test_a_search_prints_the_notes(here):
    """Rationale: it has no summary, and the scene is the same."""
    assert run("search", "cold_cylinder", "-y", "0").count(f"Note: {NOTE}") == 1
    assert run("search", "cold_cylinder", "-y", "0", "-o", "a.csv").count(NOTE) == 1


def test_a_burst_prints_and_keeps_the_notes(here):
    """Rationale: of its scene, and of the rays asked for that its line does not light."""
    shape = (2, 5, 5, 5)
    air = GriddedQuantity(
        "temperature", np.full(shape, 293.15), [-96, -24, -16], [48, 12, 48], np.array([0.0, 1.0])
    )
    write_quantity(here / "air.nc", air)
    given = [*FILM, "-D", "line_radius=0.5", "-D", "line_length=6", "--frames", "3"]
    given += ["-D", f"field={here / 'air.nc'}", "-y", "0", "-y", "-2", "-y", "4"]
    printed = run("burst", "hot_cylinder", *given, "-o", "out")
    assert printed.count(NOTE) == 1
    assert sum(note == NOTE for note in kept("out")) == 1
    assert any("1 of 3 probe rays are not lit, at y = 4 mm" in note for note in kept("out"))
    rows = (here / "out/probe_rays.csv").read_text().splitlines()[1:]
    assert [row.rpartition(",")[2] for row in rows] == ["found", "found", "unlit"]
