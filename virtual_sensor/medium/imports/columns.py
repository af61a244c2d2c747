"""What the readers of text share: lines, rows of numbers, and columns with names."""

from __future__ import annotations

import codecs
import re
from collections.abc import Sequence
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np

from virtual_sensor.errors import InputError
from virtual_sensor.medium.imports.sources import Cloud, Grid, Source, Variable, split_units
from virtual_sensor.medium.netcdf_elements import SECONDS

# Coordinates by the names that COMSOL, ParaView, Fluent and STAR-CCM+ give them.
COORDINATE = re.compile(r"([xyz])(?:[-_ ]?coord(?:inate)?)?|(?:points|centers?)[:_]([012])", re.I)
TIME = re.compile(r"(?:\d+:\s*)?t\s*=\s*(\S*?)\s*(ms|s|min|h)?")
SAME_TIME = 1e-6  # of the time itself
MISSING = {"", "nan", "na", "n/a", "#n/a", "null", "none", "-nan", "-nan(ind)", "1.#qnan"}
NIL = 1e-9  # an imaginary part of this times the real one is rounding
MARKS = (
    (codecs.BOM_UTF8, "utf-8-sig"),
    (codecs.BOM_UTF32_LE, "utf-32"),
    (codecs.BOM_UTF32_BE, "utf-32"),
    (codecs.BOM_UTF16_LE, "utf-16"),
    (codecs.BOM_UTF16_BE, "utf-16"),
)


def read_lines(path: Path) -> list[str]:
    """Lines of a text file that are not empty; UTF-8, Latin-1, or what its byte order mark says.

    The last one ends with a line feed if it does so in the file.

    Raises
    ------
    InputError
        If it is no text.
    """
    content = path.read_bytes()
    encoding = next((name for mark, name in MARKS if content.startswith(mark)), "utf-8")
    try:
        text = content.decode(encoding)
    except UnicodeDecodeError as error:
        if encoding != "utf-8":
            raise InputError(f"is truncated: no whole {encoding} ({error.reason})") from error
        text = content.decode("latin-1")
    if "\0" in text:
        raise InputError("is binary, or UTF-16 without a byte order mark; save it as UTF-8 text")
    lines = [line for line in text.splitlines() if line.strip()]
    if lines and text.endswith(("\n", "\r")):
        lines[-1] += "\n"
    return lines


def delimiter(line: str) -> str | None:
    """The character between a line's cells; None means white space."""
    return next((mark for mark in (";", "\t", ",") if mark in line.strip()), None)


def cells(line: str, mark: str | None) -> list[str]:
    """A row's cells."""
    if mark is None:
        return line.split()
    return [cell.strip().strip('"').strip() for cell in line.strip("\r\n").split(mark)]


def is_numbers(line: str) -> bool:
    """Whether a line's first cell is a number, or all its cells are numbers or missing."""
    row = cells(line, delimiter(line))
    given = [cell for cell in row if cell.casefold() not in MISSING]

    def is_number(cell: str) -> bool:
        return bool(re.fullmatch(r"[-+]?(inf|nan|[\d.].*)", cell, re.I))

    return bool(row and given) and (
        is_number(row[0]) or (all(map(is_number, given)) and row[0] != given[0])
    )


def numbers(lines: Sequence[str], skipped: int, names: int | None = None) -> np.ndarray:
    """Parse lines of as many numbers each; NaN where a cell is empty, or says that it is missing.

    Parameters
    ----------
    lines : sequence of str
        The rows.
    skipped : int
        Lines of the header, for the messages.
    names : int, optional
        Columns that the header names: a delimiter after each row's last cell is none.

    Returns
    -------
    ndarray of shape (rows, columns)
        float64, or complex128 if there are complex numbers.

    Raises
    ------
    InputError
        If a row is no numbers or has another length, or the last one seems to be cut.
    """
    if not lines:
        raise InputError("holds no numbers; it is truncated")
    mark = delimiter(lines[0])
    _refuse_cut(lines, mark)
    if mark and names and all(len(cells(line, mark)) == names + 1 for line in lines):
        lines = [line.rstrip(" \r\n").removesuffix(mark) for line in lines]
    rows = [_plain(line, mark) for line in lines]
    kind: Any = float
    if any(re.search(r"[\d.]i\b", row) for row in rows):
        kind = complex
        rows = [re.sub(r"(?<=[\d.])i\b", "j", row) for row in rows]
    try:
        return np.loadtxt(rows, kind, delimiter=mark, comments=None, ndmin=2)
    except ValueError as error:
        # Of a cell NumPy counts the rows from 0, of a change of columns from 1.
        place = re.sub(r"at row (\d+)(?=, col)", lambda m: f"at row {int(m[1]) + 1}", f"{error}")
        place = place.partition(";")[0].rstrip(".")
        raise InputError(
            f"{place}, below {skipped} header lines; a truncated file, or a comma as decimal mark?"
        ) from error


def _plain(line: str, mark: str | None) -> str:
    """A row as NumPy parses it: no quotes, points as decimal marks, nan for what is missing."""
    row = cells(line, mark)
    if mark in (";", "\t") and any("," in cell for cell in row):
        row = [re.sub(r"^([-+]?\d*),(\d+(?:[eE][-+]?\d+)?)$", r"\1.\2", cell) for cell in row]
    row = ["nan" if cell.casefold() in MISSING else cell for cell in row]
    return (mark or " ").join(row)


def _refuse_cut(lines: Sequence[str], mark: str | None) -> None:
    """Refuse a last row whose last number seems to have lost its end."""
    if lines[-1].endswith("\n") or len(lines) < 2:
        return
    last = cells(lines[-1], mark)
    others = [cells(line, mark) for line in lines[-101:-1]]
    lengths = [len(row[len(last) - 1]) for row in others if len(row) >= len(last)]
    if last and lengths and len(last[-1]) < min(lengths):
        raise InputError(
            f"its last row ends with '{last[-1]}' and without a line end: truncated? Write or copy"
            " it again; if it is whole, end its last line"
        )


def coordinates_among(names: Sequence[str], what: str) -> tuple[dict[int, int], str]:
    """Find the coordinates among the names of columns or arrays.

    Returns
    -------
    places : dict of int to int
        By the axis, which of the names is its coordinate's.
    units : str
        Of all coordinates.

    Raises
    ------
    InputError
        If there are fewer than two, two of one axis, or their units differ.
    """
    found = [(i, COORDINATE.fullmatch(split_units(name)[0])) for i, name in enumerate(names)]
    axes = [(m[1].lower() if m[1] else "xyz"[int(m[2])], i) for i, m in found if m]
    places = {"xyz".index(axis): i for axis, i in axes}
    listed = ", ".join(names) or "none"
    if len(places) < 2:
        raise InputError(
            f"needs {what} x, y and z; there are: {listed} (for a cross-section two will do)"
        )
    if len(places) < len(axes):
        raise InputError(f"two of the {what} {listed} are the same axis; leave one out")
    units = {split_units(names[i])[1] for i in places.values()}
    if len(units) > 1:
        raise InputError(f"coordinates in different units: {', '.join(sorted(units))}; use one")
    return places, units.pop()


def from_columns(labels: Sequence[str], table: np.ndarray, reader: str) -> Source:
    """Make a source, of points without cells, of a table's columns.

    Raises
    ------
    InputError
        If columns and names don't fit each other, or a coordinate is absent or missing.
    """
    if len(labels) != table.shape[1]:
        raise InputError(
            f"the header names {len(labels)} columns ({', '.join(labels)}), the rows have "
            f"{table.shape[1]}; name each column once"
            + (", and use no comma as decimal mark" if table.shape[1] > len(labels) else "")
        )
    places, units = coordinates_among(labels, "columns")
    points = np.zeros((len(table), 3))
    for axis, i in places.items():
        points[:, axis] = real_numbers(labels[i], table[:, i])[0]
    if not np.isfinite(points).all():
        raise InputError("a coordinate is not finite; remove such rows")
    variables, notes = [], ""
    for i, label in enumerate(labels):
        if i not in places.values():
            values, note = real_numbers(label, table[:, i])
            variables.append(Variable(*split_sweep(label), values))
            notes = notes or note
    return Source(variables, Cloud(points), units, reader, (notes,) if notes else ())


def real_numbers(label: str, values: np.ndarray) -> tuple[np.ndarray, str]:
    """Give the real numbers of complex ones, and a note on it.

    Raises
    ------
    InputError
        If they have an imaginary part.
    """
    if not np.iscomplexobj(values):
        return values, ""
    real = np.where(np.isnan(values), np.nan, values.real)
    imaginary = np.nan_to_num(abs(values.imag)).max(initial=0.0)
    if imaginary > NIL * np.nan_to_num(abs(real)).max(initial=0.0):
        raise InputError(
            f"'{label}' is complex, with imaginary parts up to {imaginary:.3g}; export its real"
            " part or its absolute value"
        )
    return real, "complex numbers without imaginary parts are read as real ones"


def split_sweep(label: str) -> tuple[str, str]:
    """Name, with COMSOL's "@ t=..., P0=..." behind it, and units of a column."""
    before, at, after = label.partition("@")
    name, units = split_units(before)
    return f"{name} @ {after.strip()}" if at else name, units


def at_time(source: Source, time_s: float | None) -> Source:
    """Keep the variables of one time, without the time in their names, and say which it is.

    Raises
    ------
    InputError
        If there is no such time, or one cannot be read.
    """
    found = [(v, *_time_of(v)) for v in source.variables]
    times = sorted({t for _, _, t in found if t is not None})
    if not times:
        if time_s is not None:
            raise InputError("holds no times; leave --time out")
        return source
    wanted = pick_time(times, time_s)
    chosen = [replace(v, name=name) for v, name, t in found if t is None or t == wanted]
    return replace(source, variables=chosen, reader=f"{source.reader}, t = {wanted:g} s")


def _time_of(variable: Variable) -> tuple[str, float | None]:
    """Name without the time, and the time in s; None if it has none."""
    name, at, after = variable.name.partition(" @ ")
    parameters = [p.strip() for p in after.split(",") if p.strip()] if at else []
    for parameter in parameters:
        match = TIME.fullmatch(parameter)
        if not match:
            continue
        try:
            time = float(match[1]) * SECONDS[match[2] or "s"]
        except ValueError:
            time = np.nan
        if not np.isfinite(time):
            raise InputError(
                f"column '{variable.name}': '{parameter}' is no time; the header is damaged,"
                " export it again"
            )
        others = [p for p in parameters if p != parameter]
        return f"{name} @ {', '.join(others)}" if others else name, time
    return variable.name, None


def pick_time(times: Sequence[float], wanted: float | None) -> float:
    """The wanted one of a file's times, the last by default.

    Raises
    ------
    InputError
        If it is none of them.
    """
    if wanted is None:
        return max(times)
    nearest = min(times, key=lambda t: abs(t - wanted))
    if not abs(nearest - wanted) <= SAME_TIME * max(abs(wanted), abs(nearest)):
        some = ", ".join(f"{t:g}" for t in sorted(times)[-8:])
        raise InputError(f"there is no time {wanted:g} s; the last ones are {some} (--time)")
    return nearest


def ascending(variables: Sequence[Variable], nodes: Sequence[Any]) -> tuple[list[Variable], Grid]:
    """Make a grid of axes that ascend or descend, with the values in its order.

    Parameters
    ----------
    variables : sequence of Variable
        Their values have the shape (nx, ny, nz).
    nodes : sequence of three array_like
        The axes.

    Raises
    ------
    InputError
        If an axis does neither.
    """
    for name, axis in zip("xyz", nodes, strict=True):
        steps = np.sign(np.diff(axis))
        if not (len(axis) and np.isfinite(axis).all() and abs(steps.sum()) == len(steps)):
            raise InputError(
                f"the axis {name} neither ascends nor descends throughout; sort its nodes, each"
                " once and finite"
            )
    down = tuple(i for i, axis in enumerate(nodes) if len(axis) > 1 and axis[0] > axis[-1])
    grid = [np.sort(np.asarray(axis, dtype=np.float64)) for axis in nodes]
    values = [replace(v, values=np.flip(v.values, down)) for v in variables]
    return values, Grid((grid[0], grid[1], grid[2]))
