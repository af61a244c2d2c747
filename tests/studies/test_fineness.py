"""How fine a field must be: what the study compares, chooses, draws and writes."""

import csv
import json
from itertools import product

import numpy as np
import pytest

from virtual_sensor.errors import InputError
from virtual_sensor.imaging.scene import load_scene
from virtual_sensor.medium.heat_flow.openfoam import find_openfoam
from virtual_sensor.studies.fineness import (
    Change,
    Choice,
    Fineness,
    Seen,
    compare,
    fineness,
    look,
    solver_seconds,
)
from virtual_sensor.studies.fineness_report import markdown_table, outcome, save

CELLS, TIMES, GRIDS = (2.0, 0.8), (1.0, 4.0), ((1.5, 2.5), (0.5, 1.25))


def invented():
    """A study in which every step back costs a known error and saves a known time."""
    changes = []
    for cell, time_s, grid in product(CELLS, TIMES, GRIDS):
        error = 0.3 * (cell > 1.0) + 0.05 * (time_s < 2.0) + 0.01 * (grid[0] > 1.0)
        choice = Choice(cell, time_s, grid)
        seconds = time_s / cell**2
        changes.append(Change(choice, error, error / 2, error, 20 * error, seconds, 9, 1 / grid[0]))
    long = Change(Choice(2.0, 15.0, GRIDS[-1]), 0.001, 0.001, 0.001, 0.01, 9.0, 9, 2.0)
    return Fineness(1250.0, Choice(CELLS[-1], TIMES[-1], GRIDS[-1]), changes, long)


@pytest.mark.parametrize(
    ("bound", "kept"),
    [
        (1.0, Choice(2.0, 1.0, GRIDS[0])),
        (0.1, Choice(0.8, 1.0, GRIDS[0])),
        (0.055, Choice(0.8, 1.0, GRIDS[1])),
        (0.02, Choice(0.8, 4.0, GRIDS[0])),
        (0.001, Choice(0.8, 4.0, GRIDS[1])),
    ],
)
def test_the_coarsest_is_the_quickest_run_and_then_the_smallest_file(bound, kept):
    """Rationale: no more than the scene needs; the errors are the invented ones."""
    assert invented().coarsest(bound).choice == kept


def test_nothing_is_chosen_where_nothing_keeps_the_bound():
    """Rationale: a wish is no answer."""
    study = invented()
    study.changes.pop()  # the reference itself
    assert study.coarsest(1e-4) is None


def test_results_are_written_with_table_chart_and_summary(tmp_path):
    """Rationale: people look at the chart, the README takes the table, programs the rest."""
    study = invented()
    save(study, tmp_path / "out")
    assert sorted(p.name for p in (tmp_path / "out").iterdir()) == [
        *("fineness.csv", "fineness.md", "fineness.png", "summary.json")
    ]
    with (tmp_path / "out/fineness.csv").open() as file:
        assert len(list(csv.DictReader(file))) == len(study.changes) + 1
    summary = json.loads((tmp_path / "out/summary.json").read_text())
    assert summary["coarsest within"]["0.1 px"]["choice"]["time_s"] == 1.0
    table = markdown_table(study)
    assert table.count("| 0.8 mm |") == 3  # two bounds, and as shipped
    assert "0.3 px" not in "".join(outcome(study))
    with pytest.raises(InputError, match="exists"):
        save(study, tmp_path / "out")


def test_a_line_shifted_by_a_pixel_is_a_pixel_and_its_height_off():
    """Rationale: 22 um a pixel at 300 mm, seen at 60 degrees: 25.4 um of height."""
    scene = load_scene("cold_cylinder")
    seen = look(scene)
    moved = Seen(seen.line.moved(1.0), seen.rays_px)
    rows, points = compare(scene, moved, seen)
    np.testing.assert_allclose(rows, 1.0, rtol=1e-9)
    assert points.mean() == pytest.approx(22.0 / np.sin(np.radians(60.0)), rel=0.02)


@pytest.mark.slow
def test_a_small_study_runs_and_goes_on(tmp_path):
    """Rationale: real flow; the finest differs by nothing from itself, a coarser mesh by more."""
    pytest.importorskip("pyvista", reason="needs PyVista: pip install 'virtual-sensor[fields]'")
    try:
        find_openfoam()
    except InputError as error:
        pytest.skip(f"{error}")
    asked = {"cells_mm": (3.0, 2.0), "times_s": (0.75, 1.0), "grids_mm": ((1.5, 2.5),)}
    study = fineness(tmp_path, **asked, long=(3.0, 1.25))
    assert study.change(2.0, 1.0, (1.5, 2.5)).rays_px == 0.0
    assert study.change(3.0, 1.0, (1.5, 2.5)).rays_px > 0.1
    assert study.change(3.0, 1.0, (1.5, 2.5)).run_s < study.change(2.0, 1.0, (1.5, 2.5)).run_s
    assert study.long.choice.time_s == 1.25
    spent = solver_seconds(tmp_path / "section_1250C_2mm", 1.0)
    again = fineness(tmp_path, **asked, long=(3.0, 1.25))
    assert solver_seconds(tmp_path / "section_1250C_2mm", 1.0) == spent  # not run anew
    assert again.changes == study.changes
