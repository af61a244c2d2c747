"""CSV and NumPy files."""

from __future__ import annotations

import csv
import re
from collections.abc import Sequence
from pathlib import Path

import numpy as np

from virtual_sensor.errors import InputError, cause_of
from virtual_sensor.medium.imports.columns import (
    ascending,
    at_time,
    coordinates_among,
    delimiter,
    from_columns,
    is_numbers,
    numbers,
    read_lines,
)
from virtual_sensor.medium.imports.sources import Source, Variable, split_units


def read_csv(path: Path, time_s: float | None) -> Source:
    """Read a CSV file: a header row with names and, in brackets, units, then one row per point.

    ============================  ====================================================
    Feature                       What is done
    ============================  ====================================================
    ``x [mm]``, ``T (K)``         heeded: name and unit
    ``Points:0``                  heeded, ParaView's; ``x-coordinate`` too, Fluent's
    columns in any order          heeded
    comma, semicolon, tab, blank  heeded as delimiters, also after each row's last cell
    decimal comma                 heeded between semicolons or tabs; else refused
    empty cell, ``NaN``, ``NA``   heeded: no data; refused in a coordinate
    quoted cells                  heeded
    comments above the header     ignored
    UTF-8, UTF-16, Latin-1        heeded, with or without byte order mark; UTF-16 only with
    CRLF, empty lines             heeded
    points there several times    heeded if their values agree, noted if these differ by rounding
    points with several values    refused, such as instants below each other
    one of x, y, z absent         heeded: a cross-section
    ``T (K) @ t=1``               heeded as COMSOL's
    rows of other lengths         refused
    a last number that is cut     refused
    no header row                 refused
    coordinates in two units      refused
    two columns of one axis       refused
    ============================  ====================================================

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
    lines = read_lines(path)
    start = next((i for i, line in enumerate(lines) if is_numbers(line)), 0)
    if not start:  # no header, or no numbers
        raise InputError(
            "needs a header row with names and units, such as x [mm],y [mm],z [mm],T [K], and then "
            "rows of numbers"
        )
    row = lines[start - 1].lstrip("#% ").rstrip()
    mark = delimiter(row)
    if mark:
        labels = next(csv.reader([row], delimiter=mark, skipinitialspace=True))
        labels = labels[:-1] if len(labels) > 1 and not labels[-1].strip() else labels
    else:
        labels = re.findall(r"\S+(?: [\[(][^\])]*[\])])?", row)
    table = numbers(lines[start:], start, len(labels))
    source = from_columns(
        [label.strip() for label in labels], table, f"NumPy {np.__version__}, CSV"
    )
    return at_time(source, time_s)


def read_numpy(path: Path, spacing_mm: Sequence[float] | None) -> Source:
    """Read a NumPy file.

    ===========================  =====================================================
    Feature                      What is done
    ===========================  =====================================================
    .npz of axes and arrays      heeded: x, y, z and others of shape (nx, ny, nz)
    .npz of points               heeded: coordinates and as many values
    .npy with fields             heeded: a structured array as a table of points
    plain .npy (nx, ny, nz)      heeded: node [0, 0, 0] is at 0, --spacing must be given
    descending axes              heeded: reversed
    integers, any byte order     heeded
    NaN                          heeded: no data
    complex or other types       refused
    Python objects (pickles)     refused
    damaged, or claims too much  refused
    other shapes                 refused
    ===========================  =====================================================

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
    content, arrays = _loaded(path)
    reader = f"NumPy {np.__version__}"
    if content is not None:
        if content.ndim != 3 or spacing_mm is None:
            raise InputError(
                f"is a plain array of shape {content.shape}; give one of shape (nx, ny, nz) and its"
                " --spacing in mm, or an .npz with arrays x, y, z and the quantity"
            )
        nodes = [s * np.arange(n) for s, n in zip(spacing_mm, content.shape, strict=True)]
        plain = Variable("values", "", _real("values", content))
        return Source(*ascending([plain], nodes), "mm", reader)

    names = list(arrays)
    found, units = coordinates_among(names, "arrays")
    places = {axis: names[i] for axis, i in found.items()}
    others = {name: a for name, a in arrays.items() if name not in places.values()}
    real = {name: _real(name, arrays[name]) for name in places.values()}
    coordinates = [np.ravel(real[places[i]]) if i in places else np.zeros(1) for i in range(3)]
    shape = tuple(a.size for a in coordinates)
    on_axes = [n for n, a in others.items() if a.ndim > 1 and a.size == np.prod(shape, dtype=float)]
    if on_axes and all(a.ndim == 1 for a in real.values()):
        values = [
            Variable(*split_units(name), _real(name, others[name]).reshape(shape))
            for name in on_axes
        ]
        return Source(*ascending(values, coordinates), units, reader)
    labels = [*(places[i] for i in sorted(places)), *others]
    columns = [np.ravel(_real(name, arrays[name])) for name in labels]
    if len({len(c) for c in columns}) > 1:
        shapes = ", ".join(f"{name} {a.shape}" for name, a in arrays.items())
        raise InputError(f"the arrays do not fit each other: {shapes}; give x, y, z as axes")
    return from_columns(labels, np.stack(columns, axis=1), reader)


def _loaded(path: Path) -> tuple[np.ndarray | None, dict[str, np.ndarray]]:
    """A plain array; or else arrays by their names."""
    try:
        with path.open("rb") as file:  # NumPy leaves a damaged one open
            content = np.load(file, allow_pickle=False)
            if not isinstance(content, np.ndarray):
                return None, {name: np.asarray(content[name]) for name in content.files}
    except (
        Exception
    ) as error:  # of tokenize, ast, zipfile, zlib, struct, as the damage will have it
        raise InputError(
            f"is truncated, damaged or no NumPy file of numbers ({cause_of(error)}); write or copy"
            " it again"
        ) from error
    names = content.dtype.names or ()
    return (None, {n: content[n] for n in names}) if names else (content, {})


def _real(name: str, array: np.ndarray) -> np.ndarray:
    """A numeric array as float32 or float64."""
    if array.dtype.kind not in "fiu":
        raise InputError(f"'{name}', an array of type {array.dtype}, holds no real numbers")
    return array.astype(np.result_type(array.dtype, np.float32))
