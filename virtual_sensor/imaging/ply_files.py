"""The readers of PLY files; what is used is listed in `virtual_sensor.imaging.parts`."""

import re
from contextlib import suppress
from dataclasses import dataclass, field
from itertools import chain, islice
from typing import Any

import numpy as np

from virtual_sensor.errors import InputError
from virtual_sensor.imaging.polygons import Array, Polygons, numbers, whole
from virtual_sensor.imaging.scene_file import shortened

_PLY_TYPES = {
    **{"char": "i1", "uchar": "u1", "short": "i2", "ushort": "u2", "int": "i4", "uint": "u4"},
    **{"int8": "i1", "uint8": "u1", "int16": "i2", "uint16": "u2", "int32": "i4", "uint32": "u4"},
    **{"int64": "i8", "uint64": "u8", "float": "f4", "double": "f8"},
    **{"float32": "f4", "float64": "f8"},
}
_PLY_FACES = ("vertex_indices", "vertex_index")
_MOST_ITEMS = 10_000  # of a list


@dataclass
class _Element:
    """An element of a PLY header: each property's type, or those of a list's count and items."""

    name: str
    count: int
    properties: dict[str, tuple[str, ...]] = field(default_factory=dict)


def read_ply(data: bytes) -> Polygons:
    """Read a PLY file's bytes."""
    end = re.search(rb"^end_header[ \t]*\r?\n", data, re.MULTILINE)
    if not (data.startswith(b"ply") and end):
        raise InputError('it is no PLY file: it has no header from "ply" to "end_header"')
    order, elements, remarks = _ply_header(data[: end.start()].decode("latin-1"))
    body = data[end.end() :]
    source = _Ascii(body.split()) if order == "ascii" else _Binary(body, order)
    values = {element.name: _ply_element(element, source) for element in elements}
    if source.left:
        raise InputError("more follows than its header counts; mend the file")
    vertex = values.get("vertex")
    if not vertex:
        raise InputError("it has no vertices; give a mesh")
    places, normals = (
        np.stack([np.asarray(vertex[name], float) for name in names], axis=1)
        if all(name in vertex for name in names)
        else None
        for names in ("xyz", ("nx", "ny", "nz"))
    )
    if places is None:
        raise InputError("its vertices have no x, y and z; give a mesh")
    face = values.get("face", {})
    name = next((name for name in _PLY_FACES if name in face), "")
    notes = []
    others = [e.name for e in elements if e.name not in ("vertex", "face") and e.count]
    if others:
        notes.append(f"its elements {shortened(', '.join(others))} are ignored")
    kinds = {types for e in elements for types in e.properties.values()}
    plain = (
        not others
        and not remarks
        and kinds <= {("f4",), ("u1",), ("u1", "i4"), ("u1", "u4")}
        and [e.name for e in elements] == ["vertex", "face"]
        and list(elements[0].properties)[:3] == ["x", "y", "z"]
        and list(elements[1].properties) == [name]
    )
    known = {"x", "y", "z", "nx", "ny", "nz"}
    unused = shortened(", ".join(key for key in vertex if key not in known))
    lost = [f"its vertices' {unused} are ignored"] if unused else []
    rows = face.get(name, [])
    corners = rows.ravel() if isinstance(rows, np.ndarray) else list(chain.from_iterable(rows))
    return Polygons(places, corners, [len(row) for row in rows], normals, plain, notes, lost)


def _ply_header(text: str) -> tuple[str, list[_Element], bool]:
    """Byte order or "ascii", the elements, and whether there are `obj_info` lines."""
    order, elements, remarks = "", [], False
    for line in text.splitlines()[1:]:
        match line.split():
            case ["format", "ascii", _]:
                order = "ascii"
            case ["format", ("binary_little_endian" | "binary_big_endian") as name, _]:
                order = "<" if "little" in name else ">"
            case ["obj_info", *_]:
                remarks = True
            case [] | ["comment", *_]:
                pass
            case ["element", name, count] if count.isdecimal():
                elements.append(_Element(name, int(count)))
            case ["property", "list", *types, name] if elements and len(types) == 2:
                elements[-1].properties[name] = tuple(_ply_type(word) for word in types)
            case ["property", word, name] if elements:
                elements[-1].properties[name] = (_ply_type(word),)
            case _:
                raise InputError(f'its header has the line "{shortened(line)}"; mend it')
    if not order:
        raise InputError("its header names no format that is ascii or binary; mend it")
    return order, elements, remarks


def _ply_type(word: str) -> str:
    if word not in _PLY_TYPES:
        raise InputError(f'its header has the type "{shortened(word)}"; PLY knows no such type')
    return _PLY_TYPES[word]


@dataclass
class _Ascii:
    """Numbers of an ASCII file, taken one after another."""

    tokens: list[bytes]
    at: int = 0

    def take(self, kinds: list[str], count: int) -> list[Array]:
        """Columns of `count` rows of numbers of some types."""
        size = len(kinds) * count
        if size > self.left:
            raise InputError("it ends before what its header counts; give the whole file")
        words = self.tokens[self.at : self.at + size]
        self.at += size
        return list(numbers(words).reshape(count, len(kinds)).T)

    @property
    def left(self) -> int:
        return len(self.tokens) - self.at


@dataclass
class _Binary:
    """The same of a binary file; `order` is NumPy's of its bytes."""

    body: bytes
    order: str
    at: int = 0

    def take(self, kinds: list[str], count: int) -> list[Array]:
        """Columns of `count` rows of numbers of some types."""
        row = np.dtype([(f"{number}", self.order + kind) for number, kind in enumerate(kinds)])
        if row.itemsize * count > self.left:
            raise InputError("it ends before what its header counts; give the whole file")
        table = np.frombuffer(self.body, row, count, self.at)
        self.at += table.nbytes
        return [table[name] for name in row.names or ()]

    @property
    def left(self) -> int:
        return len(self.body) - self.at


def _ply_element(element: _Element, source: _Ascii | _Binary) -> dict[str, Any]:
    """Its properties: an array (N,) each, lists as polygons."""
    if not element.count:
        return {}
    if not any(len(types) > 1 for types in element.properties.values()):
        kinds = [types[0] for types in element.properties.values()]
        return dict(zip(element.properties, source.take(kinds, element.count), strict=True))
    begun, first = source.at, _ply_row(element, source)
    source.at = begun
    with suppress(InputError):  # all rows as long as the first? then they are read at once
        kinds = [
            kind
            for (*sizes, item), row in zip(element.properties.values(), first, strict=True)
            for kind in (*sizes, *[item] * len(row))
        ]
        columns, values = iter(source.take(kinds, element.count)), {}
        for (name, types), row in zip(element.properties.items(), first, strict=True):
            if len(types) > 1 and np.any(next(columns) != len(row)):
                raise InputError("rows of various lengths")
            cells = list(islice(columns, len(row)))
            values[name] = np.stack(cells, axis=1) if cells else np.zeros((element.count, 0))
        return {
            name: v if len(element.properties[name]) > 1 else v[:, 0] for name, v in values.items()
        }
    source.at = begun
    rows = [_ply_row(element, source) for _ in range(element.count)]
    return dict(zip(element.properties, zip(*rows, strict=True), strict=True))


def _ply_row(element: _Element, source: _Ascii | _Binary) -> list[list[float]]:
    row = []
    for *sizes, item in element.properties.values():
        size = 1
        for kind in sizes:
            size = int(whole(source.take([kind], 1)[0])[0])
        if not 0 <= size <= min(source.left, _MOST_ITEMS):
            raise InputError(
                f"a list of its element {shortened(element.name)} counts {size} items, and is not"
                " that long; mend the file"
            )
        row.append([float(column[0]) for column in source.take([item] * size, 1)] if size else [])
    return row
