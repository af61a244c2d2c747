"""CSV files: what the reader's table says of each feature is done."""

import numpy as np
import pytest
from import_checks import (
    HEADER,
    PART,
    ROWS,
    error,
    imported,
    refused,
    rows,
    same,
    table_of,
    written,
)
from plume_files import K, temperature

from virtual_sensor.medium.imports.tables import read_csv


def csv_units(folder):
    celsius = ROWS - [0, 0, 0, 273.15]
    for number, header in enumerate(("x [m],y [m],z [m],T [degC]", "x (m),y (m),z (m),T (°C)")):
        table = rows(values=celsius / [1e3, 1e3, 1e3, 1])
        path = written(folder / f"{number}.csv", f"{header}\n{table}")
        same(imported(path))


def csv_names(folder):
    header = '"T","Points:0","Points:1","Points:2"\n'
    same(imported(written(folder / "a.csv", header + rows(values=ROWS[:, [3, 0, 1, 2]])), **K))
    header = "nodenumber,x-coordinate,y-coordinate,z-coordinate,temperature\n"
    table = np.column_stack([np.arange(len(ROWS)), ROWS])
    same(imported(written(folder / "b.csv", header + rows(values=table)), **K))


def csv_delimiters(folder):
    for mark in (",", ";", "\t", " ", " , "):
        same(imported(written(folder / "a.csv", HEADER.replace(",", mark) + rows(mark))))
    trailing = rows().replace("\n", ",\n")
    same(imported(written(folder / "b.csv", HEADER + trailing)))
    same(imported(written(folder / "c.csv", HEADER.replace("\n", ",\n") + trailing)))


def csv_decimal_commas(folder):
    for mark in (";", "\t"):
        text = HEADER.replace(",", mark) + rows(mark).replace(".", ",")
        same(imported(written(folder / "a.csv", text)))
    refused(
        written(folder / "b.csv", HEADER + rows().replace(".", ",")), "no comma as decimal mark"
    )
    text = HEADER.replace(",", ";") + "0;0;0;1.293,15\n"
    refused(written(folder / "c.csv", text), r"'1\.293,15'|comma as decimal mark")


def csv_missing(folder):
    for word in ("", "NaN", "nan", "NA", "#N/A", "null"):
        table = [row.split(",") for row in rows().splitlines()]
        for row, inside in zip(table, PART.ravel(), strict=True):
            row[3] = word if inside else row[3]
        text = HEADER + "".join(",".join(row) + "\n" for row in table)
        made = imported(written(folder / "a.csv", text))
        same(made)
        np.testing.assert_array_equal(made.quantity.solid, PART)
        first = "T [K],x [mm],y [mm],z [mm]\n"
        text = first + "".join(",".join([row[3], *row[:3]]) + "\n" for row in table)
        np.testing.assert_array_equal(
            imported(written(folder / "b.csv", text)).quantity.solid, PART
        )
    refused(written(folder / "c.csv", HEADER + "0,0,,300\n"), "a coordinate is not finite")


def csv_quotes_and_comments(folder):
    quoted = "".join(",".join(f'"{v!r}"' for v in row) + "\n" for row in ROWS.tolist())
    text = "# written by hand\nthe plume, of course\n" + HEADER + quoted
    same(imported(written(folder / "a.csv", text)))


def csv_encodings(folder):
    text = "x [mm],y [mm],z [mm],T [°C]\n" + rows(values=ROWS - [0, 0, 0, 273.15])
    for encoding in ("utf-8", "utf-8-sig", "utf-16", "utf-32", "latin-1"):
        same(imported(written(folder / "a.csv", text, encoding)))
    refused(written(folder / "b.csv", text, "utf-16-le"), "UTF-16 without a byte order mark")
    cut = written(folder / "c.csv", text, "utf-16")
    cut.write_bytes(cut.read_bytes()[:-1])
    refused(cut, "truncated")
    same(imported(written(folder / "d.csv", text.replace("\n", "\r\n\r\n"))))


def csv_points_twice(folder):
    blocks = np.concatenate([ROWS[ROWS[:, 0] <= 0], ROWS[ROWS[:, 0] >= 0]])
    made = imported(written(folder / "a.csv", HEADER + rows(values=blocks)))
    same(made)
    assert not any("several times" in note for note in made.notes)
    many = np.concatenate([ROWS] * 20)
    same(imported(written(folder / "b.csv", HEADER + rows(values=many))))
    blocks[-1, 3] += 0.01
    shifted = np.concatenate([blocks, np.add(blocks[-1:], [0, 0, 0, 0.02])])
    made = imported(written(folder / "c.csv", HEADER + rows(values=shifted)))
    assert any("1 points are there several times" in note for note in made.notes)
    blank = np.concatenate([ROWS, ROWS[:9] * [1, 1, 1, np.nan]])
    same(imported(written(folder / "d.csv", HEADER + rows(values=blank))))
    instants = np.concatenate([ROWS, np.add(ROWS, [0, 0, 0, 40])])
    refused(written(folder / "e.csv", HEADER + rows(values=instants)), "is there with several val")


def csv_section(folder):
    flat = np.column_stack([ROWS[:, 1:3], temperature(ROWS[:, :3] * [0, 1, 1])])[:42]
    path = written(folder / "a.csv", "x [mm],y [mm],T [K]\n" + rows(values=flat))
    made = imported(path, axes="z,x,y", extrude_mm=(-120.0, 120.0))
    assert error(made, lambda p: temperature(p * [0, 1, 1])) < 1e-3
    np.testing.assert_allclose(made.quantity.origin_mm, [-120, -24, 0])


def csv_times(folder):
    header = "x [mm],y [mm],z [mm],T (K) @ t=1,T (K) @ t=2\n"
    table = np.column_stack([ROWS, ROWS[:, 3] + 50])
    same(imported(written(folder / "a.csv", header + rows(values=table)), time_s=1.0))


def csv_damaged(folder):
    refused(written(folder / "a.csv", HEADER + "0,0,0,300\n0,0,300\n"), "columns changed")
    text = HEADER + rows()
    refused(written(folder / "b.csv", text[:-6]), "without a line end: truncated")
    same(imported(written(folder / "c.csv", text[:-1])))
    refused(written(folder / "d.csv", rows()), "needs a header row")
    refused(written(folder / "e.csv", "x [m],y [mm],T [K]\n1,2,300\n"), "in different units")
    refused(written(folder / "f.csv", "x,X,y,z,T\n1,1,2,3,300\n"), "are the same axis")
    table = np.column_stack([ROWS, ROWS[:, 3]])
    path = written(folder / "g.csv", "x,y,z,T,T\n" + rows(values=table))
    refused(path, "2 variables are named 'T'; rename all but one", **K)


CSV = {
    "``x [mm]``, ``T (K)``": csv_units,
    "``Points:0``": csv_names,
    "columns in any order": csv_names,
    "comma, semicolon, tab, blank": csv_delimiters,
    "decimal comma": csv_decimal_commas,
    "empty cell, ``NaN``, ``NA``": csv_missing,
    "quoted cells": csv_quotes_and_comments,
    "comments above the header": csv_quotes_and_comments,
    "UTF-8, UTF-16, Latin-1": csv_encodings,
    "CRLF, empty lines": csv_encodings,
    "points there several times": csv_points_twice,
    "points with several values": csv_points_twice,
    "one of x, y, z absent": csv_section,
    "``T (K) @ t=1``": csv_times,
    "rows of other lengths": csv_damaged,
    "a last number that is cut": csv_damaged,
    "no header row": csv_damaged,
    "coordinates in two units": csv_damaged,
    "two columns of one axis": csv_damaged,
}


@pytest.mark.parametrize("check", dict.fromkeys(CSV.values()))
def test_csv_is_read_as_its_table_says(check, tmp_path):
    """Rationale: the reader's docstring is a promise."""
    assert set(CSV) == set(table_of(read_csv))
    check(tmp_path)
