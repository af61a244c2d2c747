"""The paper's figures as tables, of rays that are made up."""

import csv

import numpy as np
import pytest
from invented_curves import NINE_MM, WAYS, invented_curves, only

from virtual_sensor.studies.reproduction.curves import BLURRED, DOTS, LINE, RESOLVED, SEARCHED
from virtual_sensor.studies.reproduction.figures import FIGURES, write_figures

OF_THE_ISSUE = [
    *("6", "7a", "7b", "7c", "7d", "7e", "9a", "9b", "9c", "9d", "9e", "9f"),
    *("10b", "11a", "11b", "11c", "11d"),
]
UM, PX = ("dx_um", "dy_um", "dz_um"), ("du_px", "dv_px")


@pytest.fixture(scope="module")
def curves():
    """All ways in the resolved air, the search alone in the blurred one."""
    return invented_curves()


def measured_mm(sensor, pixel):
    """Where lines of sight meet the laser's plane: camera + t sight = origin + p along + q down."""
    points = []
    for u, v in pixel:
        sight = sensor.camera.pose.rotation @ np.linalg.solve(sensor.camera.matrix, [u, v, 1.0])
        laser = sensor.laser.pose
        span = np.stack([laser.rotation[:, 1], laser.rotation[:, 2]], axis=1)
        p, q, _ = np.linalg.solve(
            np.column_stack([span, -sight]), sensor.camera.pose.origin_mm - laser.origin_mm
        )
        points.append(laser.origin_mm + span @ [p, q])
    return np.array(points)


def stacked(table, names, rows):
    return np.stack([table[name][rows] for name in names], axis=1)


def test_every_figure_of_the_paper_has_a_table(curves):
    """Rationale: figure 8 and 10(a) are sketches; all others of section 5 are to be remade."""
    assert list(FIGURES) == OF_THE_ISSUE
    for name in OF_THE_ISSUE:
        table = FIGURES[name](curves, RESOLVED)
        assert len({len(column) for column in table.values()}) == 1
        assert set(table["way"]) == ({SEARCHED} if name in ("6", "7a") else set(WAYS))


@pytest.mark.parametrize("way", [SEARCHED, DOTS])
def test_differences_are_those_of_the_captions(curves, way):
    """Rationale: which point is taken from which is what a reader can't see in a curve."""
    curve = curves.rays(RESOLVED, way=way)
    A, B = curve.A_mm, curve.B_mm
    A_m, B_m = (measured_mm(curve.sensor, pixel) for pixel in (curve.pixel_A, curve.pixel_B))
    coarse = measured_mm(curve.sensor, 0.25 * np.rint(curve.pixel_A / 0.25))
    expected = {"7b": B - B_m, "7c": B_m - A_m, "7e": A - coarse, "11a": B_m - A_m}
    if way == SEARCHED:
        expected["7a"] = B - A
    for name, difference_mm in expected.items():
        table = FIGURES[name](curves, RESOLVED)
        rows = table["way"] == way
        if "temperature_c" in table:
            rows &= table["temperature_c"] == 1250.0
        np.testing.assert_allclose(stacked(table, UM, rows), 1e3 * difference_mm, atol=1e-6)
        np.testing.assert_array_equal(table["y_mm"][rows], NINE_MM)
    table = FIGURES["7d"](curves, RESOLVED)
    moved = stacked(table, PX, table["way"] == way)
    np.testing.assert_allclose(moved, curve.pixel_B - curve.pixel_A, atol=1e-12)


def test_the_distance_of_the_search_is_the_searchs(curves):
    """Rationale: figure 6 judges the paper's search, not the rays."""
    table = FIGURES["6"](curves, RESOLVED)
    np.testing.assert_allclose(table["h_d_min_um"], 0.5 + 0.04 * NINE_MM)


@pytest.mark.parametrize("name", OF_THE_ISSUE[1:])
def test_norms_are_those_of_their_components(curves, name):
    """Rationale: the paper's d_euclid; a line's, which lacks a component, has none."""
    table = FIGURES[name](curves, RESOLVED)
    for components, norm in ((UM, "d_um"), (PX, "d_px")):
        if norm in table:
            parts = stacked(table, components, slice(None))
            np.testing.assert_allclose(table[norm], np.sqrt((parts**2).sum(axis=1)), rtol=1e-12)
            assert (np.isnan(table[norm]) == (table["way"] == LINE)).all()


def test_the_two_paths_make_up_the_whole(curves):
    """Rationale: figure 8's separation explains 7(d) only if nothing is lost in it."""
    tables = [FIGURES[name](curves, RESOLVED) for name in ("9a", "9b", "9c")]
    first, second, both = (stacked(table, PX, slice(None)) for table in tables)
    np.testing.assert_allclose(first + second, both, rtol=0.0, atol=1e-9)
    assert np.isfinite(both).all(axis=1).sum() == 18  # of the search and the dots
    searched = tables[0]["way"] == SEARCHED
    curve = curves.rays(RESOLVED)
    straight = curve.sensor.camera.project(curve.B_mm) - curve.sensor.camera.project(curve.A_mm)
    np.testing.assert_allclose(first[searched], straight, atol=1e-9)


def test_the_arrows_lead_from_the_cold_to_the_hot_pixel(curves):
    """Rationale: 9(d) to 9(f) draw one ray's displacement as a way over three points."""
    d, e, f = (FIGURES[name](curves, RESOLVED) for name in ("9d", "9e", "9f"))
    assert list(d["way"]) == WAYS
    ends = [[f"{side}_{axis}_px" for axis in "uv"] for side in ("from", "to")]
    for before, after in (((d, 1), (e, 0)), ((d, 0), (f, 0)), ((e, 1), (f, 1))):
        one, other = (stacked(table, ends[side], slice(None)) for table, side in (before, after))
        np.testing.assert_array_equal(one, other)
    assert (d["y_mm"] == -7.5).all()
    for row, way in enumerate(WAYS[:2]):
        curve = curves.rays(RESOLVED, way=way)
        np.testing.assert_allclose(stacked(f, ends[0], [row])[0], curve.pixel_A[6], atol=1e-9)
        np.testing.assert_allclose(stacked(f, ends[1], [row])[0], curve.pixel_B[6], atol=1e-9)


@pytest.mark.parametrize("way", [SEARCHED, DOTS])
def test_rounded_pixels_are_quarters(curves, way):
    """Rationale: figures 10(b) and 11(a.2) show what the sensor's steps do, so steps must be."""
    table = FIGURES["10b"](curves, RESOLVED)
    quarters = stacked(table, PX, table["way"] == way) / 0.25
    np.testing.assert_allclose(quarters, np.rint(quarters), atol=1e-9)
    exact = FIGURES["7d"](curves, RESOLVED)
    moved = stacked(exact, PX, exact["way"] == way)
    assert 0.0 < np.abs(0.25 * quarters - moved).max() <= 0.25
    coarse, fine = (FIGURES[name](curves, RESOLVED) for name in ("11b", "11a"))
    same = FIGURES["10b"](curves, RESOLVED)
    hottest = (coarse["way"] == way) & (coarse["temperature_c"] == 1250.0)
    np.testing.assert_array_equal(coarse["d_um"][hottest], same["d_um"][same["way"] == way])
    assert not np.allclose(coarse["d_um"][hottest], fine["d_um"][hottest], atol=0.1)


def test_of_a_line_only_what_is_across_it_is_told(curves):
    """Rationale: along a line its image is blind; a number there would be the search's."""
    pixels = FIGURES["7d"](curves, RESOLVED)
    rows = pixels["way"] == LINE
    assert np.isnan(pixels["du_px"][rows]).all()
    assert np.isfinite(pixels["dv_px"][rows]).all()
    for beta_deg, known in ((0.0, [True, False, True]), (30.0, [True, False, False])):
        table = FIGURES["11d"](curves, RESOLVED)  # from the side, u has a part in y and in z
        rows = (table["way"] == LINE) & (table["beta_deg"] == beta_deg)
        assert rows.sum() == 9
        assert (np.isfinite(stacked(table, UM, rows)) == known).all()


def test_figure_11_has_the_papers_settings(curves):
    """Rationale: temperatures from above, poses at 900 degC."""
    tables = {name: FIGURES[name](curves, RESOLVED) for name in ("11a", "11b", "11c", "11d")}
    settings = {
        name: sorted(set(zip(t["temperature_c"], t["beta_deg"], strict=True)))
        for name, t in tables.items()
    }
    hotter = [(900.0, 0.0), (1100.0, 0.0), (1250.0, 0.0)]
    assert settings == dict.fromkeys(("11a", "11b", "11c"), hotter) | {
        "11d": [(900.0, 0.0), (900.0, 15.0), (900.0, 30.0)]
    }


def test_what_was_not_rendered_is_left_out(curves):
    """Rationale: rendering every air takes minutes; the search's figures don't wait for it."""
    for name in OF_THE_ISSUE:
        assert set(FIGURES[name](curves, BLURRED)["way"]) == {SEARCHED}
    hottest = only(curves, lambda setting, way: setting.temperature_c == 1250.0)
    assert set(FIGURES["11a"](hottest, RESOLVED)["temperature_c"]) == {1250.0}
    assert FIGURES["11d"](hottest, RESOLVED) == {}
    assert FIGURES["7a"](hottest, "no such air") == {}


def test_tables_are_written_for_other_programs(curves, tmp_path):
    """Rationale: what is drawn must be there to be drawn again, differently."""
    write_figures(curves, [RESOLVED, BLURRED], tmp_path)
    assert {path.name for path in tmp_path.iterdir()} == {
        f"figure_{name}_{air}.csv" for name in OF_THE_ISSUE for air in (RESOLVED, BLURRED)
    }
    with (tmp_path / "figure_7d_resolved.csv").open(encoding="utf-8", newline="") as file:
        rows = list(csv.DictReader(file))
    assert list(rows[0]) == ["y_mm", "way", "du_px", "dv_px", "d_px"]
    table = FIGURES["7d"](curves, RESOLVED)
    assert [row["way"] for row in rows] == list(table["way"])
    for name in ("y_mm", "du_px", "dv_px", "d_px"):
        read = [float(row[name] or "nan") for row in rows]
        np.testing.assert_allclose(read, table[name], rtol=1e-9, atol=1e-15)


def test_tables_that_would_be_empty_are_not_written(curves, tmp_path):
    """Rationale: a file without rows looks like a result."""
    above = only(curves, lambda setting, way: setting.temperature_c == 1250.0)
    write_figures(above, [RESOLVED], tmp_path)
    assert {path.name for path in tmp_path.iterdir()} == {
        f"figure_{name}_resolved.csv" for name in OF_THE_ISSUE if name != "11d"
    }
