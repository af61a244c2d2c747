"""The command `fringes`: a scene or a word, and what a scene's measurement leaves."""

import json

import pytest
import typer
from command_line import command
from data_dictionary import undocumented

from virtual_sensor.cli.fringes import SceneOrWord
from virtual_sensor.reporting.fringes import FILES
from virtual_sensor.studies.fringes import measure
from virtual_sensor.studies.fringes.decoded_files import read_decoded

SMALL = ["-D", "width=96", "-D", "height=96", "-D", "pixel=11", "-D", "spp=1", "-D", "pixels=false"]


def said(*arguments):
    """What a command that takes a scene or the word `decode` is called with."""
    calls = []
    app = typer.Typer(cls=SceneOrWord, invoke_without_command=True)

    @app.callback()
    def run(scene: str, bits: int = 8):
        calls.append(("scene", scene, bits))

    @app.command()
    def decode(shots: str, bits: int = 12):
        calls.append(("decode", shots, bits))

    typer.main.get_command(app)(arguments, standalone_mode=False)
    return calls


def test_a_word_stands_in_the_scenes_place():
    """Rationale: options of a command with words below it must stand before its arguments."""
    assert said("mine.xml", "--bits", "10") == [("scene", "mine.xml", 10)]
    assert said("--bits", "10", "mine.xml") == [("scene", "mine.xml", 10)]
    assert said("decode", "shots", "--bits", "10") == [("decode", "shots", 10)]
    assert said("./decode") == [("scene", "./decode", 8)]


@pytest.mark.usefixtures("unpainted")
def test_a_scene_is_measured_cold_and_hot(tmp_path, monkeypatch):
    """Rationale: `correct` and people read the files; each is in the data dictionary."""
    monkeypatch.chdir(tmp_path)
    monkeypatch.setattr(measure, "SEARCHED", 200)
    status, out, err = command(
        "fringes", "fringe_cylinder", *SMALL, "--electrons", "8000", "--frames"
    )
    assert (status, err) == (0, "")
    assert "results in fringes, open fringes/report.html first" in out
    folder = tmp_path / "fringes"
    assert undocumented(folder, FILES) == []
    summary = json.loads((folder / "summary.json").read_text())
    assert summary["codec"] == "phase 4 16,128,1280 uv"
    assert summary["parameters"]["temperature"] == "1250"
    hot = summary["states"]["hot"]
    assert hot["bent"]["rms_um"] < 0.5 * hot["straight"]["rms_um"]
    decoded = read_decoded(folder / "hot.exr")
    assert int(decoded.ok.sum()) == hot["decoded"]["pixels"] > 9000
    assert len(list((folder / "frames_cold").glob("*.png"))) == 24
    assert command("fringes", "fringe_cylinder", *SMALL)[0] == 2  # fringes/ is there


@pytest.mark.usefixtures("unpainted")
def test_no_phase_at_all_has_its_exit_status(tmp_path):
    arguments = ["--cold", "--codec", "phase 4 u", "--electrons", "3", "-o", tmp_path / "dark"]
    status, out, _ = command("fringes", "fringe_cylinder", *SMALL, *arguments)
    assert status == 3
    assert "Note: cold: no pixel has a phase: black" in out
