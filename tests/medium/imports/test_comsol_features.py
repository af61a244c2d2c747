"""COMSOL's text exports: what the reader's table says of each feature is done."""

import numpy as np
import plume_files as plume
import pytest
from import_checks import (
    NODES,
    PART,
    ROWS,
    VALUES,
    X,
    Y,
    Z,
    error,
    imported,
    refused,
    rows,
    same,
    table_of,
    written,
)
from plume_files import temperature

from virtual_sensor.medium.imports.comsol import read_comsol

COMSOL_HEAD = """% Model{c}air.mph
% Version{c}COMSOL 6.0.0.354
% Nodes{c}{nodes}
% Length unit{c}mm
"""


def comsol(path, columns, table=ROWS, mark=",", nodes=None, end=""):
    """A spreadsheet export, as .csv or .txt."""
    head = COMSOL_HEAD.format(c="," if mark == "," else ":    ", nodes=nodes or len(table))
    text = rows(mark, np.asarray(table)) if np.isrealobj(table) else table
    return written(path, f"{head}% {columns}\n{text}{end}")


def comsol_sheet(folder):
    same(imported(comsol(folder / "a.csv", "x,y,z,T (K)")))
    same(imported(comsol(folder / "b.csv", 'x,y,z,"T (K)"')))
    same(imported(comsol(folder / "a.txt", "x    y    z    T (K)", mark="   ")))
    scattered = np.column_stack([plume.warped(NODES).reshape(-1, 3), VALUES.ravel()])
    scattered[:, 3] = temperature(scattered[:, :3])
    made = imported(comsol(folder / "c.csv", "x,y,z,T (K)", scattered), spacing_mm=(20, 8, 8))
    assert error(made) < 25.0


def comsol_forms(folder):
    same(imported(plume.write_comsol_grid(folder / "a.txt", X, Y, Z, VALUES)))
    text = "% Coordinates\n1 2 3\n% Elements\n1\n% Data\n300\n"
    refused(written(folder / "b.txt", text), "sectionwise form")


def comsol_counted(folder):
    for name, mark, columns in (("a.csv", ",", "x,y,z,T (K)"), ("a.txt", "  ", "x  y  z  T (K)")):
        path = comsol(folder / name, columns, ROWS[:-35], mark, nodes=210)
        refused(path, "is truncated: its header says 210 nodes, there are 175 rows")


def comsol_sweeps(folder):
    later = np.column_stack([ROWS, ROWS[:, 3] + 50.0])
    for name, mark, columns in (
        ("a.csv", ",", "x,y,z,T (K) @ t=1,T (K) @ t=2"),
        ("a.txt", "  ", "x   y   z   T (K) @ t=1 T (K) @ t=2"),
    ):
        path = comsol(folder / name, columns, later, mark)
        same(imported(path, time_s=1.0))
        assert error(imported(path), lambda p: temperature(p) + 50.0) < 1e-3
        refused(path, "no time 3 s; the last ones are 1, 2", time_s=3.0)
    for name, mark, columns in (
        ("b.csv", ",", "x,y,z,T (K) @ t=1, P0=50,T (K) @ t=1, P0=100"),
        ("c.csv", ",", 'x,y,z,"T (K) @ t=1, P0=50","T (K) @ t=1, P0=100"'),
        ("b.txt", "  ", "X      Y      Z      T (K) @ t=1, P0=50 T (K) @ t=1, P0=100"),
    ):
        path = comsol(folder / name, columns, later, mark)
        refused(path, r"2 variables come into question, T @ P0=50 \[K\], T @ P0=100 \[K\];")
        same(imported(path, variable="T @ P0=50"))
        made = imported(path, variable="T @ P0=100")
        assert error(made, lambda p: temperature(p) + 50.0) < 1e-3
    for damaged in ("t=1e", "t=", "t=nan", "t=one"):
        path = comsol(folder / "d.txt", f"x  y  z  T (K) @ {damaged}", mark="  ")
        refused(path, "is no time; the header is damaged|the header names")


def comsol_nan(folder):
    table = ROWS.copy()
    table[PART.ravel(), 3] = np.nan
    made = imported(comsol(folder / "a.csv", "x,y,z,T (K)", table))
    same(made)
    np.testing.assert_array_equal(made.quantity.solid, PART)


def comsol_complex(folder):
    def table(imaginary):
        return "".join(f"{x!r},{y!r},{z!r},{t!r}{imaginary}\n" for x, y, z, t in ROWS.tolist())

    def path(imaginary):
        head = COMSOL_HEAD.format(c=",", nodes=len(ROWS))
        return written(folder / "a.csv", f"{head}% x,y,z,T (K)\n{table(imaginary)}")

    for nil in ("+0i", "-0.0i", "+1.5E-14i"):
        made = imported(path(nil))
        same(made)
        assert any("complex" in note for note in made.notes)
    refused(path("+2.5i"), "'T .K.' is complex, with imaginary parts up to 2.5; export its real")
    grid = plume.write_comsol_grid(folder / "b.txt", X, Y, Z, VALUES)
    lines = grid.read_text(encoding="utf-8").splitlines()
    axis, first = lines.index("% Grid") + 1, 1 + lines.index("% T (K)")
    for row, imaginary, said in (
        (first, "+0i", ""),
        (first, "+2.5i", "'T .K.'"),
        (axis, "-1i", "x"),
    ):
        changed = [*lines[:row], lines[row] + imaginary, *lines[row + 1 :]]
        path = written(folder / "c.txt", "\n".join(changed) + "\n")
        if said:
            refused(path, f"{said}.* is complex, with imaginary parts up to")
        else:
            made = imported(path)
            same(made)
            assert any("complex" in note for note in made.notes)


def comsol_unfit(folder):
    refused(comsol(folder / "a.csv", "r,z,x,T (K)"), "axisymmetric")
    refused(written(folder / "a.txt", rows("  ")), "needs a header row")


def comsol_source(folder):
    made = imported(comsol(folder / "a.csv", "x,y,z,T (K)"))
    assert "COMSOL's text export (COMSOL 6.0.0.354)" in made.quantity.attributes["source"]


COMSOL = {
    "spreadsheet form": comsol_sheet,
    "grid form": comsol_forms,
    "sectionwise form": comsol_forms,
    "``Length unit``": comsol_sheet,
    "``Nodes``": comsol_counted,
    "``T (K)``": comsol_sheet,
    "``T (K) @ t=1``": comsol_sweeps,
    "``T (K) @ t=1, P0=50``": comsol_sweeps,
    "``NaN``": comsol_nan,
    "complex numbers": comsol_complex,
    "columns r, z": comsol_unfit,
    "no header": comsol_unfit,
    "``Version``": comsol_source,
    "``Model``, ``Date``, others": comsol_source,
}


@pytest.mark.parametrize("check", dict.fromkeys(COMSOL.values()))
def test_comsol_is_read_as_its_table_says(check, tmp_path):
    """Rationale: the reader's docstring is a promise."""
    assert set(COMSOL) == set(table_of(read_comsol))
    check(tmp_path)
