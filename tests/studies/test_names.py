"""Commands and studies of scenes with several cameras and lasers take their names."""

import json
import re

import numpy as np
import pytest
from several import two_by_two
from typer.testing import CliRunner

from virtual_sensor import cli
from virtual_sensor.imaging.scene import load_scene
from virtual_sensor.optics.ray_search import ray_search

FILM = ["-D", "width=128", "-D", "height=128", "-D", "spp=4", "-D", "line_radius=0.5"]


@pytest.fixture(scope="module")
def scene(tmp_path_factory):
    """File of a scene with two cameras and two lasers."""
    return two_by_two(tmp_path_factory.mktemp("two")).path


def run(*words, status=0):
    """What a command prints."""
    ended = CliRunner().invoke(cli.app, [str(word) for word in words])
    said = ended.output or str(ended.exception)
    assert ended.exit_code == status, said
    return str(ended.exception) if status else said


def commands(scene, folder):
    """Every command that takes a scene, without its names."""
    air = load_scene("hot_cylinder").air.path
    return {
        "measure": ["measure", scene, *FILM, "-o", folder / "measured"],
        "measure to a tolerance": [
            "measure",
            scene,
            *FILM,
            "--tolerance",
            "0.05",
            "-o",
            folder / "t",
        ],
        "search": ["search", scene, *FILM],
        "burst": ["burst", scene, *FILM, "-o", folder / "burst"],
        "field info": ["field", "info", air, "--scene", scene, *FILM],
    }


def test_every_command_says_which_there_are(scene, tmp_path):
    """And takes the name that it asks for; `measure` measures all pairs."""
    for name, words in commands(scene, tmp_path).items():
        if name != "measure":
            ended = CliRunner().invoke(cli.app, [str(word) for word in words])
            assert ended.exit_code != 0, name
            said = str(ended.exception)
            assert "2 cameras: near, far; say which (camera=, or --camera" in said, name
            ended = CliRunner().invoke(cli.app, [*map(str, words), "--camera", "near"])
            said = str(ended.exception)
            assert "2 sources: red, blue; say which (source=, or --source" in said, name
        ended = CliRunner().invoke(cli.app, [*map(str, words), "--source", "green"])
        assert "no source 'green'; the scene has: red, blue" in str(ended.exception), name


def test_a_search_by_name_is_that_pairs(scene, tmp_path):
    """Each pair's own pixels, to the digits of the table."""
    film = dict(word.split("=") for word in FILM[1::2])
    loaded = load_scene(scene, **film)
    seen = {}
    for camera in loaded.cameras:
        for source in loaded.sources:
            file = tmp_path / f"{camera}_{source}.csv"
            run(
                "search", scene, *FILM, "-y", -3, "--camera", camera, "--source", source, "-o", file
            )
            head, row = (line.split(",") for line in file.read_text().splitlines())
            u, v = (float(row[head.index(name)]) for name in ("pixel_u", "pixel_v"))
            expected = ray_search(loaded, -3.0, "paper", camera=camera, source=source)
            np.testing.assert_allclose([[u, v]], expected.pixel, atol=1e-3)
            seen[camera, source] = v
    assert len({round(v, 1) for v in seen.values()}) == 4


@pytest.mark.parametrize(
    "words", [[], pytest.param(["--tolerance", "0.05"], marks=pytest.mark.slow)]
)
def test_a_measurement_by_name_is_that_pairs(scene, tmp_path, words):
    """Measured, also to a tolerance: the summary names it, and its line agrees with its search."""
    names = ["--camera", "far", "--source", "blue"]
    folder = tmp_path / "measured"
    run("measure", scene, *FILM, *names, *words, "-o", folder)
    summary = json.loads((folder / "summary.json").read_text(encoding="utf-8"))
    assert (summary["camera"], summary["source"]) == ("far", "blue")
    for state in summary["states"].values():
        agreement = state["line_minus_search"]
        assert agreement["compared"] > 50
        assert agreement["rms_px"] < 0.02


def test_a_sweep_by_name_is_kept_by_its_names(tmp_path):
    """Rationale: another camera's results must not be taken for those of the one asked for."""
    words = ["sweep", two_by_two(tmp_path, "cold_cylinder").path, *FILM, "-o", tmp_path / "swept"]
    run(*words, "--camera", "near", "--source", "red")
    assert re.search("1 already there", run(*words, "--camera", "near", "--source", "red"))
    said = run(*words, "--camera", "far", "--source", "red")
    assert re.search("1 measured, 0 already there", said)
