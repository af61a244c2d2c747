"""Results as data: documented dataclasses, and the JSON, CSV and PLY files that hold them.

A `Record` becomes a JSON object, a `Table` a CSV file. Their fields are named in snake_case, with
the unit at the end, and documented under "Attributes" of their docstrings, from which the data
dictionary is made.
"""

from __future__ import annotations

import dataclasses
import json
import re
import types
import typing
from collections.abc import Iterable, Iterator, Mapping, Sequence
from dataclasses import dataclass
from enum import Enum, IntEnum
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import ArrayLike, NDArray

from virtual_sensor.display import Displayed, attribute_words
from virtual_sensor.files import written_whole

UNITS = {
    **{"px": "px", "mm": "mm", "um": "µm", "nm": "nm", "m": "m", "s": "s", "ms": "ms", "us": "µs"},
    **{"ns": "ns", "deg": "°", "c": "°C", "k": "K", "w": "W", "mw": "mW", "pa": "Pa", "mb": "MB"},
    **{"electrons": "e", "percent": "%", "mrad": "mrad", "per_mm": "1/mm"},
}
"""Units as names end with them, and as people read them."""

WITH_NORM = {"norm": True}
"""Metadata of a `Table`'s field whose vectors have their length as a column too."""

_AXES = {2: "uv", 3: "xyz"}
_SPECIAL = set(',"\r\n')


def unit_of(name: str) -> str:
    """Unit that a name ends with, as people read it; "" if it has none.

    An axis or "norm" may follow the unit: ``point_mm_x``, ``shift_um_norm``.
    """
    stem = re.sub(r"(_(x|y|z|u|v|norm|height))+$", "", name)
    found = [unit for unit in UNITS if stem == unit or stem.endswith(f"_{unit}")]
    return UNITS[max(found, key=len)] if found else ""


class Record(Displayed):
    """Mixin of a frozen dataclass whose fields are a JSON object's."""

    def to_dict(self) -> dict[str, Any]:
        """The fields as plain Python: what the JSON file holds (see `plain`)."""
        return {each.name: plain(getattr(self, each.name)) for each in _fields(self)}


class Table(Record):
    """Mixin of a frozen dataclass whose fields are columns of equal length.

    A field is a sequence or an array (N,); an array (N, 3) makes the columns ``name_x``, ``_y``,
    ``_z``, and one of (N, 2) ``name_u``, ``_v``; and ``name_norm``, their length, if the field is
    one `WITH_NORM`. A mapping of them makes columns for each of its keys, which stand before the
    unit: "cold" in ``depth_mm`` makes ``depth_cold_mm``; its type is `Annotated` with all keys that
    it may have. What is None makes no column.
    """

    def columns(self) -> dict[str, NDArray[Any]]:
        """The columns, each of shape (N,), by their names."""
        found: dict[str, NDArray[Any]] = {}
        for each in _fields(self):
            value = getattr(self, each.name)
            by_key = value if isinstance(value, Mapping) else {"": value}
            for key, values in by_key.items():
                name, array = _with_key(each.name, key), np.asarray(values)
                if values is None:
                    continue
                if array.ndim == 1:
                    found[name] = array
                    continue
                axes = _AXES[array.shape[1]]
                found |= {f"{name}_{axis}": array[:, i] for i, axis in enumerate(axes)}
                if each.metadata.get("norm"):
                    found[f"{name}_norm"] = np.linalg.norm(array, axis=1)
        lengths = {name: len(column) for name, column in found.items()}
        if len(set(lengths.values())) > 1:
            raise ValueError(f"{type(self).__name__}: columns of different lengths, {lengths}")
        return found

    def rows(self) -> Iterator[dict[str, Any]]:
        """Each row, by the columns' names."""
        columns = self.columns()
        for values in zip(*columns.values(), strict=True):
            yield dict(zip(columns, values, strict=True))

    def _line(self) -> str:
        columns = self.columns()
        return f"{len(self)} rows of {', '.join(columns)}"

    def __len__(self) -> int:
        return next((len(column) for column in self.columns().values()), 0)


def _with_key(name: str, key: str) -> str:
    """A field's name with a key before its unit."""
    stem, _, last = name.rpartition("_")
    parts = (stem, key, last) if last in UNITS else (name, key)
    return "_".join(filter(None, parts))


def plain(value: Any) -> Any:
    """A value as JSON has it: NaN and infinity are None, an `IntEnum` its name in lower case."""
    if dataclasses.is_dataclass(value) and not isinstance(value, type):
        return {each.name: plain(getattr(value, each.name)) for each in _fields(value)}
    if isinstance(value, IntEnum):
        return value.name.lower()
    if isinstance(value, Enum):
        return plain(value.value)
    if isinstance(value, np.ndarray | np.generic):
        value = value.tolist()
    if isinstance(value, Mapping):
        return {_key(key): plain(each) for key, each in value.items()}
    if isinstance(value, list | tuple | set | frozenset):
        return [plain(each) for each in value]
    if isinstance(value, Path):
        return str(value)
    if isinstance(value, float) and not np.isfinite(value):
        return None
    return value


def _key(key: Any) -> str:
    return key.name.lower() if isinstance(key, IntEnum) else str(key)


def status_names(status: ArrayLike, kind: type[IntEnum]) -> NDArray[np.str_]:
    """Names of status numbers, in lower case."""
    numbers, place = np.unique(np.asarray(status).ravel(), return_inverse=True)
    return np.array([kind(n).name.lower() for n in numbers], np.str_)[place]


def counts_of(status: ArrayLike, kind: type[IntEnum], *, occurring: bool = False) -> dict[str, int]:
    """How many have each status, or each that occurs, by its name in lower case."""
    status = np.asarray(status)
    counts = {member.name.lower(): int(np.sum(status == member)) for member in kind}
    return {name: n for name, n in counts.items() if n or not occurring}


def counts_in_words(counts: Mapping[str, int]) -> str:
    """Counts that are not 0, such as "edge 12, order 3"."""
    return ", ".join(f"{name} {number}" for name, number in counts.items() if number)


@dataclass(frozen=True)
class Described:
    """A field of a record as a data dictionary lists it.

    Attributes
    ----------
    name : str
        Its key or column.
    unit : str
        As people read it; "" if it has none.
    words : str
        What it is.
    records : tuple of type
        Records that it holds: itself, or by name, or in a row.
    """

    name: str
    unit: str
    words: str
    records: tuple[type, ...] = ()


def documented(kind: type) -> list[Described]:
    """The fields of a record with their words; of a table, a field for each key of a mapping.

    Raises
    ------
    ValueError
        If a field is not documented, or what is documented is no field.
    """
    words = attribute_words(kind)
    names = [each.name for each in _fields(kind)]
    if set(words) != set(names):
        raise ValueError(
            f"{kind.__name__}: documented are {sorted(words)}, fields are {sorted(names)}"
        )
    hints = typing.get_type_hints(kind, include_extras=True)
    found = []
    for field in _fields(kind):
        hint = hints[field.name]
        records = tuple(_records_in(hint))
        for key in getattr(hint, "__metadata__", ("",)):
            name = _with_key(field.name, key)
            found.append(Described(name, unit_of(name), words[field.name], records))
            if field.metadata.get("norm"):
                found.append(Described(f"{name}_norm", unit_of(name), "Its length."))
    return found


def _fields(record: Any) -> list[dataclasses.Field[Any]]:
    """Fields that are data; those of `metadata={"internal": True}` stay inside the program."""
    return [f for f in dataclasses.fields(record) if not f.metadata.get("internal")]


def _records_in(hint: Any) -> list[type]:
    """Records that a type holds: itself, or within a union, sequence or mapping."""
    if isinstance(hint, type) and not isinstance(hint, types.GenericAlias):
        return [hint] if issubclass(hint, Record) else []
    return [kind for argument in typing.get_args(hint) for kind in _records_in(argument)]


def write_json(path: Path, value: Any) -> None:
    """Write a record, or dictionaries, sequences, texts and numbers (see `plain`)."""
    text = json.dumps(plain(value), indent=2, ensure_ascii=False, allow_nan=False)
    with written_whole(path) as temporary:
        temporary.write_text(text + "\n", encoding="utf-8", errors="backslashreplace")


def write_csv(path: Path, table: Table | Mapping[str, ArrayLike]) -> None:
    """Write columns of equal length under their names; NaN stays empty.

    Numbers have 13 digits, in which a pixel of 1000 keeps its 1e-9 px; float32 has its nine.
    """
    columns = table.columns() if isinstance(table, Table) else table
    cells = [[_cell(value) for value in np.asarray(values)] for values in columns.values()]
    lines = [",".join(map(_cell, columns)), *(",".join(row) for row in zip(*cells, strict=True))]
    with written_whole(path) as temporary:
        temporary.write_text("\n".join(lines) + "\n", encoding="utf-8", errors="backslashreplace")


def record_columns(kind: type[Record], records: Iterable[Record]) -> dict[str, list[Any]]:
    """Columns of a table with a row for each record; mappings are JSON, truths yes or no."""

    def cell(value: Any) -> Any:
        if isinstance(value, Mapping):
            return json.dumps(plain(value))
        return value if not isinstance(value, bool) else "yes" if value else "no"

    rows = list(records)
    return {f.name: [cell(getattr(row, f.name)) for row in rows] for f in _fields(kind)}


def _cell(value: object) -> str:
    if isinstance(value, float | np.floating):
        digits = 9 if isinstance(value, np.float32) else 13
        return "" if np.isnan(value) else f"{value:.{digits}g}"
    text = str(value)
    return '"' + text.replace('"', '""') + '"' if _SPECIAL & set(text) else text


def vectors(name: str, values: NDArray[np.floating], axes: Sequence[str]) -> dict[str, ArrayLike]:
    """Columns ``name_x``, ... of an array (N, len(axes))."""
    return {f"{name}_{axis}": values[:, i] for i, axis in enumerate(axes)}


def write_ply(
    path: Path,
    points_mm: NDArray[np.floating],
    intensity: NDArray[np.floating],
    **whole: NDArray[np.integer],
) -> None:
    """Write the finite points (N, 3) in mm, world frame, with an intensity (N,) as binary PLY.

    `whole` are further properties (N,) of whole numbers.
    """
    finite = np.isfinite(points_mm).all(axis=1)
    floats = [(name, "<f4") for name in ("x", "y", "z", "intensity")]
    vertex = np.zeros(int(finite.sum()), [*floats, *((name, "<i4") for name in whole)])
    for i, name in enumerate("xyz"):
        vertex[name] = points_mm[finite, i]
    vertex["intensity"] = intensity[finite]
    for name, numbers in whole.items():
        vertex[name] = numbers[finite]
    properties = "".join(f"property float {name}\n" for name, _ in floats)
    properties += "".join(f"property int {name}\n" for name in whole)
    _write_ply(path, vertex, properties)


def write_ply_mesh(
    path: Path,
    vertices_mm: NDArray[np.floating],
    faces: NDArray[np.integer],
    **values: NDArray[np.floating],
) -> None:
    """Write triangles (M, 3) of points (N, 3), world frame, mm, as binary PLY with values (N,)."""
    named = dict(zip("xyz", np.asarray(vertices_mm).T, strict=True)) | values
    vertex = np.zeros(len(vertices_mm), [(name, "<f4") for name in named])
    for name, numbers in named.items():
        vertex[name] = numbers
    face = np.zeros(len(faces), [("count", "u1"), ("corners", "<i4", 3)])
    face["count"], face["corners"] = 3, faces
    properties = "".join(f"property float {name}\n" for name in named)
    _write_ply(path, vertex, properties, face)


def _write_ply(
    path: Path,
    vertex: NDArray[np.void],
    properties: str,
    face: NDArray[np.void] | None = None,
) -> None:
    header = (
        "ply\nformat binary_little_endian 1.0\ncomment points in mm, world frame\n"
        f"element vertex {len(vertex)}\n{properties}"
    )
    if face is not None:
        header += f"element face {len(face)}\nproperty list uchar int vertex_indices\n"
    parts = [f"{header}end_header\n".encode("ascii"), vertex.tobytes()]
    with written_whole(path) as temporary:
        temporary.write_bytes(b"".join(parts + ([face.tobytes()] if face is not None else [])))


def write_layers(
    path: Path,
    layers: Mapping[str, NDArray[Any] | None],
    header: Mapping[str, str] | None = None,
) -> None:
    """Write images (H, W) as float32 layers of OpenEXR, with attributes; None is left out."""
    import OpenEXR

    attributes = {
        "compression": OpenEXR.ZIP_COMPRESSION,
        "type": OpenEXR.scanlineimage,
        **(header or {}),
    }
    pixels = {
        name: np.ascontiguousarray(image, np.float32)
        for name, image in layers.items()
        if image is not None
    }
    with written_whole(path) as temporary:
        OpenEXR.File(attributes, pixels).write(str(temporary))


def write_arrays(path: Path, arrays: Mapping[str, Any], *, compressed: bool = True) -> None:
    """Write arrays as an npz file of NumPy's."""
    write = np.savez_compressed if compressed else np.savez
    with written_whole(path) as temporary, temporary.open("wb") as file:
        write(file, allow_pickle=False, **arrays)
