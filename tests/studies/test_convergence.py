"""Convergence of the air's field: what the study compares and chooses."""

import numpy as np
import pytest
from invented_convergence import CELLS, GRIDS, invented

from virtual_sensor.errors import InputError
from virtual_sensor.imaging.scene import load_scene
from virtual_sensor.medium.heat_flow.openfoam import find_openfoam
from virtual_sensor.optics.ray_search import ray_search
from virtual_sensor.studies.convergence import (
    Seen,
    Setting,
    coarsest,
    compare,
    convergence,
    corrected,
    seen_through,
    solver_seconds,
)


@pytest.mark.parametrize(
    ("bound", "chosen"),
    [
        (1.0, Setting(2.0, 1.0, *GRIDS[0])),
        (0.1, Setting(0.8, 1.0, *GRIDS[0])),
        (0.055, Setting(0.8, 1.0, *GRIDS[1])),
        (0.02, Setting(0.8, 4.0, *GRIDS[0])),
        (0.001, Setting(0.8, 4.0, *GRIDS[1])),
    ],
)
def test_the_coarsest_is_the_quickest_run_and_then_the_smallest_file(bound, chosen):
    """Rationale: no more than the scene needs; the errors are the invented ones."""
    assert coarsest(invented().changes, bound).setting == chosen


def test_nothing_is_chosen_where_nothing_stays_within_the_bound():
    """Rationale: a wish is no answer."""
    assert coarsest(invented().changes[:-1], 1e-4) is None  # the last is the reference itself


def test_the_study_chooses_for_each_bound_and_knows_the_shipped_fields_setting():
    """Rationale: these are what is printed, drawn and written."""
    study = invented()
    assert [(each.bound_px, each.change.time_s) for each in study.coarsest] == [
        *((0.1, 1.0), (0.02, 4.0))
    ]
    assert study.shipped.setting == Setting(CELLS[-1], 4.0, *GRIDS[-1])


def test_a_line_shifted_by_a_pixel_is_a_pixel_and_its_height_off():
    """Rationale: 22 um a pixel at 300 mm, seen at 60 degrees: 25.4 um of height."""
    scene = load_scene("cold_cylinder")
    seen = seen_through(scene)
    moved = Seen(seen.line.moved(1.0), seen.found, seen.rays_px)
    rows, points = compare(scene, moved, seen)
    np.testing.assert_allclose(rows, 1.0, rtol=1e-9)
    assert points.mean() == pytest.approx(22.0 / np.sin(np.radians(60.0)), rel=0.02)


def test_the_air_that_was_there_leaves_nothing_and_no_air_the_whole_error():
    """Rationale: 333 um at most and 107 um rms off the surface are the shipped field's (facts)."""
    scene = load_scene("hot_cylinder")
    found = ray_search(scene, np.linspace(-10.0, 10.0, 61), "newton")
    for left in corrected(scene, found, scene.medium):
        assert np.abs(left).max() < 0.05
    surface, points = corrected(scene, found, None)
    assert np.sqrt(np.mean(surface**2)) == pytest.approx(107.0, rel=0.03)
    assert points.max() == pytest.approx(333.0, rel=0.03)


@pytest.mark.slow
def test_a_small_study_runs_and_goes_on(tmp_path):
    """Rationale: real flow; the finest differs by nothing from itself, a coarser mesh by more."""
    pytest.importorskip("pyvista", reason="needs PyVista: pip install 'virtual-sensor[fields]'")
    try:
        find_openfoam()
    except InputError as error:
        pytest.skip(f"{error}")
    asked = {"cells_mm": (3.0, 2.0), "times_s": (0.75, 1.0), "grids_mm": ((1.5, 2.5),)}
    study = convergence(tmp_path, **asked, long=(3.0, 1.25))
    coarse, fine = (c for c in study.changes if c.time_s == 1.0)
    assert (coarse.setting, fine.setting) == (Setting(3.0, 1.0, 1.5, 2.5), study.reference)
    assert fine.rays_px == 0.0
    assert fine.left_points_um < 0.05  # its own air
    assert coarse.left_points_um > coarse.left_surface_um > 1.0
    assert coarse.rays_px > 0.1
    assert coarse.solver_s < fine.solver_s
    assert study.longer_run.time_s == 1.25
    spent = solver_seconds(tmp_path / "section_1250C_2mm", 1.0)
    again = convergence(tmp_path, **asked, long=(3.0, 1.25))
    assert solver_seconds(tmp_path / "section_1250C_2mm", 1.0) == spent  # not run again
    assert again.changes == study.changes
