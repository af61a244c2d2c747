"""COMSOL's text exports."""

from __future__ import annotations

import csv
import re
from collections.abc import Sequence
from dataclasses import replace
from pathlib import Path

import numpy as np

from virtual_sensor.errors import InputError
from virtual_sensor.medium.imports.columns import (
    ascending,
    at_time,
    delimiter,
    from_columns,
    numbers,
    read_lines,
    real_numbers,
    split_sweep,
)
from virtual_sensor.medium.imports.sources import Grid, Source, Variable

_PARAMETERS = r"(?:\d+:\s*)?\w+\s*=\s*[^\s,]+(?:\s(?:ms|s|min|h)\b)?"
# An expression, its unit, and the parameters of a sweep, which have blanks and commas themselves.
LABEL = re.compile(rf"[^\s,;@][^\s;@]*(?: \([^)]*\))?(?: @ {_PARAMETERS}(?:,\s*{_PARAMETERS})*)?")


def read_comsol(path: Path, time_s: float | None) -> Source:
    """Read a text export of COMSOL, .txt or .csv: its header's lines begin with %.

    ===========================  ===================================================
    Feature                      What is done
    ===========================  ===================================================
    spreadsheet form             heeded: points, or a grid if they lie on one
    grid form                    heeded: axes, then blocks of values
    sectionwise form             refused
    ``Length unit``              heeded
    ``Nodes``                    heeded: another number of rows is refused
    ``T (K)``                    heeded: name and unit
    ``T (K) @ t=1``              heeded: --time chooses, the last by default
    ``T (K) @ t=1, P0=50``       heeded: --variable chooses among other parameters
    ``NaN``                      heeded: no data, as outside of COMSOL's domains
    complex numbers              read as real ones and noted; with an imaginary part refused
    columns r, z                 refused: axisymmetric
    no header                    refused
    ``Version``                  heeded: it goes into the field's `source`
    ``Model``, ``Date``, others  ignored
    ===========================  ===================================================

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
    lines = read_lines(path)
    header = (re.fullmatch(r'%\s*"?([\w ]+?)"?[:,;]\s*(.*?)\s*', line.strip()) for line in lines)
    said = {match[1]: match[2].strip('"') for match in header if match}
    if any(re.match(r"%\s*(Coordinates|Elements)\b(?![:,])", line) for line in lines):
        raise InputError("is in COMSOL's sectionwise form; export as spreadsheet, grid or VTK file")
    reader = f"COMSOL's text export ({said.get('Version', 'unknown version')}), NumPy"
    unit = said.get("Length unit", "")
    if any(re.match(r"%\s*Grid\s*$", line) for line in lines):
        variables, geometry, notes = _grid(lines)
        return at_time(Source(variables, geometry, unit, reader, notes), time_s)
    count = next((i for i, line in enumerate(lines) if not line.startswith("%")), len(lines))
    if count == 0:
        raise InputError("has no header; export from COMSOL with the header included")
    table = numbers(lines[count:], count)
    labels = _labels(lines[count - 1].lstrip("% ").strip(), table.shape[1])
    nodes = said.get("Nodes", "")
    if nodes.isdecimal() and int(nodes) != len(table):
        raise InputError(
            f"is truncated: its header says {nodes} nodes, there are {len(table)} rows;"
            " export or copy it again"
        )
    return at_time(replace(from_columns(labels, table, reader), length_units=unit), time_s)


def _labels(line: str, count: int) -> list[str]:
    """Column names of a header line, which COMSOL parts by several blanks, one, or a delimiter."""
    mark = delimiter(re.sub(r"\([^)]*\)|@[^@]*", "", line))
    parted = re.split(r"\s{2,}", line)
    if mark and '"' in line:
        parted = next(csv.reader([line], delimiter=mark, skipinitialspace=True))
    elif mark:
        parted = re.split(rf"{mark}(?!\s*{_PARAMETERS})", line)
    if len(parted) != count:
        parted = LABEL.findall(line)
    if re.fullmatch(r"r", parted[0].strip(), re.I):
        raise InputError("is axisymmetric (r, z); export from a 2-D revolution data set in COMSOL")
    return [label.strip() for label in parted]


def _grid(lines: Sequence[str]) -> tuple[list[Variable], Grid, tuple[str, ...]]:
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
    nodes = [
        real_numbers(f"axis {name}", np.ravel(numbers([line], first)))[0]
        for name, line in zip("xyz", axes, strict=False)
    ] + [np.zeros(1)] * (3 - len(axes))
    shape = [len(axis) for axis in nodes]
    variables, notes = [], set()
    for label, rows in blocks:
        table, note = real_numbers(label, numbers(rows, first + len(axes)))
        notes |= {note} - {""}
        if table.size != np.prod(shape):
            raise InputError(
                f"is truncated: {table.size} values of '{label}' on a grid of "
                f"{' x '.join(map(str, shape))} nodes; export or copy it again"
            )
        # Each row runs along x; the rows go through y first, then z.
        variables.append(Variable(*split_sweep(label), table.reshape(shape[::-1]).T))
    return *ascending(variables, nodes), tuple(notes)
