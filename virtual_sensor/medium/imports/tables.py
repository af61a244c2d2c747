"""Tables of numbers: COMSOL's text exports, CSV and NumPy files."""

from __future__ import annotations

import csv
import re
import zipfile
from collections.abc import Sequence
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np

from virtual_sensor.errors import InputError
from virtual_sensor.medium.imports.sources import (
    Cloud,
    Grid,
    Source,
    Variable,
    as_lattice,
    on_lattice,
    split_units,
)

AT_TIME = re.compile(r"\s*@.*?\bt=([-+.\deE]+)\s*(s|min|h)?")
# Coordinates by the names that COMSOL, ParaView, Fluent and STAR-CCM+ give them.
COORDINATE = re.compile(r"([xyz])(?:[-_ ]?coord(?:inate)?)?|(?:points|centers?)[:_]([012])", re.I)
SAME_TIME = 1e-6  # of the time itself


def read_comsol(path: Path, time_s: float | None) -> Source:
    """Read a text export of COMSOL: "spreadsheet" (points) or "grid" (axes, then the values).

    The header's lines begin with %; it tells the length unit, the columns' names and units, and how
    many nodes there are. NaN, which COMSOL writes outside its domains, stays NaN.

    Parameters
    ----------
    path : Path
        The file.
    time_s : float, optional
        Which of the times in the columns' names, s; the last by default.

    Raises
    ------
    InputError
        If the file is truncated, or in another form.
    """
    lines = _lines(path)
    header = (re.fullmatch(r"%\s*([\w ]+?):\s*(.*?)\s*", line) for line in lines)
    said = {match[1]: match[2] for match in header if match}
    if any(re.match(r"%\s*(Coordinates|Elements)\b(?!:)", line) for line in lines):
        raise InputError("is in COMSOL's sectionwise form; export as spreadsheet, grid or VTK file")
    reader = f"COMSOL's text export ({said.get('Version', 'unknown version')}), NumPy"
    variables: list[Variable]
    geometry: Grid | Cloud
    if any(re.match(r"%\s*Grid\s*$", line) for line in lines):
        variables, geometry = _comsol_grid(lines)
    else:
        count = next((i for i, line in enumerate(lines) if not line.startswith("%")), len(lines))
        if count == 0:
            raise InputError("has no header; export from COMSOL with the header included")
        table = _numbers(lines[count:], count)
        labels = _comsol_labels(lines[count - 1].lstrip("% "), table.shape[1])
        variables, geometry, _ = _columns(labels, table)
        if said.get("Nodes", "").isdigit() and int(said["Nodes"]) != len(table):
            raise InputError(
                f"is truncated: its header says {said['Nodes']} nodes, there are {len(table)} rows;"
                " export or copy it again"
            )
    chosen, at = _at_time(variables, time_s)
    return Source(chosen, geometry, said.get("Length unit", ""), reader + at)


def read_csv(path: Path, time_s: float | None) -> Source:
    """Read a CSV file: a header row with names and, in brackets, units, then one row per point.

    The delimiter is a comma, a semicolon, a tab or white space. The columns x, y, z may be in any
    place, one of them may be absent; ParaView's ``Points:0`` and Fluent's ``x-coordinate`` will do.

    Parameters
    ----------
    path : Path
        The file.
    time_s : float, optional
        As for `read_comsol`.

    Raises
    ------
    InputError
        If there is no header, or a row that is not numbers, or has too few.
    """
    lines = _lines(path)
    header = next((i for i, line in enumerate(lines) if not _is_numbers(line)), None)
    start = next((i for i, line in enumerate(lines) if _is_numbers(line)), len(lines))
    if header is None or start <= header or start == len(lines):
        raise InputError(
            "needs a header row with names and units, such as x [mm],y [mm],z [mm],T [K], and then "
            "rows of numbers"
        )
    row = lines[start - 1].lstrip("#% ")
    delimiter = _delimiter(row)
    if delimiter:
        labels = next(csv.reader([row], delimiter=delimiter, skipinitialspace=True))
    else:
        labels = re.findall(r"\S+(?: [\[(][^\])]*[\])])?", row)
    table = _numbers(lines[start:], start)
    variables, geometry, length = _columns(labels, table)
    chosen, at = _at_time(variables, time_s)
    return Source(chosen, geometry, length, f"NumPy {np.__version__}, CSV{at}")


def read_numpy(path: Path, spacing_mm: Sequence[float] | None) -> Source:
    """Read a NumPy file.

    An .npz holds arrays x, y, z and others: either three axes and arrays of shape (nx, ny, nz), or
    the coordinates of points and as many values. An .npy holds a structured array with such fields,
    or a plain (nx, ny, nz) array; its node [0, 0, 0] is at 0 and the spacing must be told.

    Parameters
    ----------
    path : Path
        The file.
    spacing_mm : sequence of three float, optional
        Distance of a plain array's nodes, mm.

    Raises
    ------
    InputError
        If the file is damaged, the coordinates are missing, or shapes do not fit.
    """
    try:
        with path.open("rb") as file:  # NumPy leaves a damaged one open
            content = np.load(file, allow_pickle=False)
            if isinstance(content, np.ndarray):
                arrays = {n: content[n] for n in content.dtype.names or ()}
            else:
                arrays = {name: content[name] for name in content.files}
    except (ValueError, EOFError, OSError, zipfile.BadZipFile) as error:
        raise InputError(f"is truncated, damaged or no NumPy file ({error})") from error
    reader = f"NumPy {np.__version__}"
    if not arrays:
        if content.ndim != 3 or spacing_mm is None:
            raise InputError(
                f"is a plain array of shape {content.shape}; give one of shape (nx, ny, nz) and its"
                " --spacing in mm, or an .npz with arrays x, y, z and the quantity"
            )
        nodes = tuple(s * np.arange(n) for s, n in zip(spacing_mm, content.shape, strict=True))
        return Source([Variable("values", "", _real(content))], _grid(nodes), "mm", reader)

    places = {axis: name for name in arrays if (axis := _coordinate(name)) is not None}
    others = {name: a for name, a in arrays.items() if name not in places.values()}
    if len(places) < 2:
        raise InputError(f"needs arrays x, y and z; there are: {', '.join(arrays)}")
    coordinates = [_real(arrays[places[i]]) if i in places else np.zeros(1) for i in range(3)]
    shape = tuple(a.size for a in coordinates)
    on_axes = [n for n, a in others.items() if a.ndim > 1 and a.size == np.prod(shape)]
    if on_axes:
        values = [
            Variable(*split_units(name), _real(others[name]).reshape(shape)) for name in on_axes
        ]
        return Source(*_ascending(values, coordinates), "", reader)
    labels = [*(places[i] for i in sorted(places)), *others]
    columns = [np.ravel(_real(arrays[name])) for name in labels]
    if len({len(c) for c in columns}) > 1:
        shapes = ", ".join(f"{name} {a.shape}" for name, a in arrays.items())
        raise InputError(f"the arrays do not fit each other: {shapes}; give x, y, z as axes")
    variables, geometry, length = _columns(labels, np.stack(columns, axis=1))
    return Source(variables, geometry, length, reader)


def _lines(path: Path) -> list[str]:
    """Lines of a text file that are not empty."""
    try:
        text = path.read_text(encoding="utf-8-sig")
    except UnicodeDecodeError:
        text = path.read_text(encoding="latin-1")
    return [line for line in text.splitlines() if line.strip()]


def _delimiter(line: str) -> str | None:
    """The character between a line's cells; None means white space."""
    return next((mark for mark in (";", ",", "\t") if mark in line), None)


def _is_numbers(line: str) -> bool:
    """Whether a line's first cell is a number."""
    cell = (line.split(_delimiter(line)) or [""])[0].strip()
    return bool(re.fullmatch(r"[-+]?(nan|inf|[\d.].*)", cell, re.I))


def _numbers(lines: list[str], skipped: int) -> np.ndarray:
    """Parse lines of as many numbers each."""
    if not lines:
        raise InputError("holds no numbers; it is truncated")
    try:
        return np.loadtxt(lines, delimiter=_delimiter(lines[0]), comments=None, ndmin=2)
    except ValueError as error:
        # Of a cell NumPy counts the rows from 0, of a change of columns from 1.
        place = re.sub(r"at row (\d+)(?=, col)", lambda m: f"at row {int(m[1]) + 1}", f"{error}")
        place = place.partition(";")[0].rstrip(".")
        raise InputError(
            f"{place}, below {skipped} header lines; a truncated file, or a comma as decimal mark?"
        ) from error


def _real(array: np.ndarray) -> np.ndarray:
    """A numeric array as float32 or float64."""
    if array.dtype.kind not in "fiu":
        raise InputError(f"an array of type {array.dtype} holds no real numbers")
    return array.astype(np.result_type(array.dtype, np.float32))


def _coordinate(name: str) -> int | None:
    """Which axis a column is; None if none."""
    match = COORDINATE.fullmatch(split_units(name)[0])
    if not match:
        return None
    return "xyz".index(match[1].lower()) if match[1] else int(match[2])


def _columns(labels: Sequence[str], table: np.ndarray) -> tuple[list[Variable], Grid | Cloud, str]:
    """Make variables and points of a table's columns; also the coordinates' units."""
    if len(labels) != table.shape[1]:
        raise InputError(
            f"the header names {len(labels)} columns ({', '.join(labels)}), the rows have "
            f"{table.shape[1]}; name each column once"
        )
    places = {axis: i for i, n in enumerate(labels) if (axis := _coordinate(n)) is not None}
    if len(places) < 2:
        raise InputError(
            f"needs columns x, y and z, or two for a cross-section; it has {', '.join(labels)}"
        )
    units = {split_units(labels[i])[1] for i in places.values()}
    if len(units) > 1:
        raise InputError(f"coordinates in different units: {', '.join(sorted(units))}; use one")
    points = np.zeros((len(table), 3))
    for axis, i in places.items():
        points[:, axis] = table[:, i]
    if not np.isfinite(points).all():
        raise InputError("a coordinate is not finite; remove such rows")
    variables = [
        Variable(*_split_time(label), table[:, i])
        for i, label in enumerate(labels)
        if i not in places.values()
    ]
    lattice = as_lattice(points)
    if lattice is None:
        return variables, Cloud(points), units.pop()
    variables = [replace(v, values=on_lattice(*lattice, v.values)) for v in variables]
    return variables, lattice[0], units.pop()


def _split_time(label: str) -> tuple[str, str]:
    """Name, with COMSOL's "@ t=..." kept, and units of a column."""
    before, at, after = label.partition("@")
    name, units = split_units(before)
    return f"{name} @{after}" if at else name, units


def _at_time(variables: list[Variable], time_s: float | None) -> tuple[list[Variable], str]:
    """Keep the columns of one time, without the time in their names; and tell it."""
    scale = {"s": 1.0, "min": 60.0, "h": 3600.0, None: 1.0}
    found = [(v, AT_TIME.search(v.name)) for v in variables]
    times = sorted({float(m[1]) * scale[m[2]] for _, m in found if m})
    if not times:
        if time_s is not None:
            raise InputError("holds no times; leave --time out")
        return variables, ""
    wanted = pick_time(times, time_s)
    kept = [
        replace(v, name=v.name[: m.start()]) if m else v
        for v, m in found
        if not m or float(m[1]) * scale[m[2]] == wanted
    ]
    return kept, f", t = {wanted:g} s"


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
    if abs(nearest - wanted) > SAME_TIME * max(abs(wanted), abs(nearest)):
        some = ", ".join(f"{t:g}" for t in sorted(times)[-8:])
        raise InputError(f"there is no time {wanted:g} s; the last ones are {some} (--time)")
    return nearest


def _comsol_labels(line: str, count: int) -> list[str]:
    """Column names of a header line, which COMSOL parts by several blanks or by the delimiter."""
    mark = _delimiter(re.sub(r"\([^)]*\)", "", line))
    parted = line.split(mark) if mark else re.split(r"\s{2,}", line.strip())
    if len(parted) != count:
        parted = re.findall(r"\S+(?: \([^)]*\))?(?: @ \S+)?", line)
    if re.fullmatch(r"r", parted[0].strip(), re.I):
        raise InputError("is axisymmetric (r, z); export from a 2-D revolution data set in COMSOL")
    return [label.strip() for label in parted]


def _comsol_grid(lines: list[str]) -> tuple[list[Variable], Grid]:
    """Parse the grid form: % Grid, one line per axis, then % Data and blocks of values."""
    first = next(i for i, line in enumerate(lines) if re.match(r"%\s*Grid\s*$", line)) + 1
    blocks: list[tuple[str, list[str]]] = []
    axes: list[str] = []
    for line in lines[first:]:
        name = line.lstrip("% ").strip()
        if not line.startswith("%"):
            (blocks[-1][1] if blocks else axes).append(line)
        elif not name.startswith("Data"):
            blocks[-1:] = [(name, [])]  # the name stands in the line after % Data
        else:
            inner = re.fullmatch(r"Data\s*\((.*)\)", name)
            blocks.append((inner[1] if inner else "", []))
    if len(axes) not in (2, 3) or not blocks or not blocks[-1][1]:
        raise InputError("is truncated: no two or three axes after % Grid, or no values after them")
    nodes = [np.ravel(_numbers([line], first)) for line in axes] + [np.zeros(1)] * (3 - len(axes))
    shape = [len(axis) for axis in nodes]
    variables = []
    for label, rows in blocks:
        table = _numbers(rows, first + len(axes))
        if table.size != np.prod(shape):
            raise InputError(
                f"is truncated: {table.size} values of '{label}' on a grid of "
                f"{' x '.join(map(str, shape))} nodes; export or copy it again"
            )
        # Each row runs along x; the rows go through y first, then z.
        variables.append(Variable(*_split_time(label), table.reshape(shape[::-1]).T))
    return _ascending(variables, nodes)


def _ascending(variables: list[Variable], nodes: Sequence[Any]) -> tuple[list[Variable], Grid]:
    """Reverse axes that descend."""
    for i, axis in enumerate(nodes):
        steps = np.sign(np.diff(axis))
        if not (np.isfinite(axis).all() and (abs(steps.sum()) == len(steps))):
            raise InputError(f"the axis {'xyz'[i]} neither ascends nor descends; sort its nodes")
    down = tuple(i for i, axis in enumerate(nodes) if len(axis) > 1 and axis[0] > axis[-1])
    grid = _grid([np.sort(np.asarray(axis, dtype=np.float64)) for axis in nodes])
    return [replace(v, values=np.flip(v.values, down)) for v in variables], grid


def _grid(nodes: Sequence[np.ndarray]) -> Grid:
    return Grid((nodes[0], nodes[1], nodes[2]))
