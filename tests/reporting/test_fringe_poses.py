"""Pages of poses that were compared, and of surfaces that were corrected."""

import numpy as np
import pytest

import virtual_sensor as vs
from virtual_sensor.optics.rays import March
from virtual_sensor.reporting import correct as corrected
from virtual_sensor.reporting.fringe_poses import on_console, save
from virtual_sensor.studies.correct.correct import correct
from virtual_sensor.studies.correct.measured import of_fringes
from virtual_sensor.studies.fringes.poses import compare_poses

SIDE = 32
QUICK = March(0.5, "leapfrog", "double")
SIZE = {"width": f"{SIDE}", "height": f"{SIDE}"}


@pytest.fixture(scope="module")
def compared():
    """Two poses on a coarse grid."""
    over = {"temperature": ["1250"], "beta": ["0", "30"]}
    return compare_poses("fringe_cylinder", over | {k: [v] for k, v in SIZE.items()}, grid=4)


def test_the_page_of_poses_stands_in_a_browser(compared, faults_of, tmp_path):
    """Rationale: pictures, tables and links, at the sizes of a desk and a phone."""
    save(compared, tmp_path / "poses", "virtual-sensor fringes poses fringe_cylinder")
    assert faults_of(tmp_path / "poses" / "report.html") == []


def test_tables_of_poses_fit_a_terminal(compared):
    """Rationale: wider ones are printed row by row, and nothing can be compared."""
    for each in on_console(compared):
        widths = [
            max(map(len, map(str, column))) for column in zip(each.head, *each.rows, strict=True)
        ]
        assert sum(widths) + 3 * len(widths) + 1 <= 80


def test_the_page_of_a_corrected_surface_stands_in_a_browser(faults_of, tmp_path):
    """Rationale: maps stand before the plots along a line, which have points for lines."""
    scene = vs.load_scene("fringe_cylinder", **SIZE)
    v, u = np.mgrid[:SIDE, :SIDE]
    found = vs.projector_pixels(scene, np.stack([u.ravel(), v.ravel()], axis=1), march=QUICK)
    column, row = np.moveaxis(found.projector_pixel.reshape(SIDE, SIDE, 2), -1, 0)
    sigma = np.full(column.shape, 0.02, np.float32)
    status = np.where(np.isfinite(column), 0, 1).astype(np.uint8)
    rest = {"modulation": sigma, "mean": sigma, "phase": {}, "size_px": (1280, 800)}
    decoded = vs.DecodedFringes(column, row, sigma, sigma, status=status, **rest)
    result = correct([of_fringes("hot", scene, decoded)])
    corrected.save(result, tmp_path / "corrected", "virtual-sensor correct fringes")
    assert faults_of(tmp_path / "corrected" / "report.html") == []
    panels = list(corrected.picture(result)[1])
    assert panels[:3] == ["before_1", "after_1", "epipolar_1"]
