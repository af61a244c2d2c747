"""The readers of OBJ and STL files; `virtual_sensor.imaging.parts` says what becomes of what."""

import logging
import re
from io import BytesIO
from typing import Any

import numpy as np
from trimesh.exchange.stl import load_stl

from virtual_sensor.errors import InputError
from virtual_sensor.imaging.polygons import Array, Polygons, numbers
from virtual_sensor.imaging.scene_file import shortened

logging.getLogger("trimesh").addHandler(logging.NullHandler())  # it would show tracebacks

_FREE_FORM = ("surf", "curv", "curv2", "cstype")
_STL_HEAD, _STL_FACET = 84, 50


def read_obj(data: bytes) -> Polygons:
    """Read an OBJ file's bytes."""
    text = re.sub(r"\\\r?\n", " ", data.decode("utf-8", "replace"))
    found: dict[str, list[list[str]]] = {"v": [], "vt": [], "vn": []}
    corners: list[list[int]] = []
    sizes: list[int] = []
    notes: list[str] = []
    plain = True
    for line in text.splitlines():
        word, *rest = line.partition("#")[0].split() or [""]
        if word in found:
            found[word].append(rest)
        elif word == "f":
            before = [len(rows) for rows in found.values()]
            corners += [_obj_corner(corner, before) for corner in rest]
            sizes.append(len(rest))
            plain &= "-" not in line
        elif word in _FREE_FORM:
            raise InputError(f'it has free forms ("{word}"); export it as a mesh of polygons')
        elif word == "usemtl" and not notes:
            notes = ["its materials are ignored; the scene's <bsdf> holds"]
    index = np.array(corners, np.int64).reshape(-1, 3)
    for kind, column in zip(found, index.T, strict=True):
        if np.any((column < -1) | (column >= len(found[kind]))):
            number = int(np.argmax((column < -1) | (column >= len(found[kind]))))
            raise InputError(
                f'face {np.searchsorted(np.cumsum(sizes), number, "right")} refers to a "{kind}"'
                f" that is not there, of {len(found[kind])}; mend the file"
            )
    places, corner, normals = _obj_table(found["v"], "v"), index[:, 0], None
    if len(index) and np.all(index[:, 2] >= 0):  # a vertex may have several normals
        pairs, same = np.unique(index[:, [0, 2]], axis=0, return_inverse=True)
        normals = _obj_table(found["vn"], "vn")[pairs[:, 1]]
        places, corner = places[pairs[:, 0]], same.ravel()
    polygons = np.split(corner, np.cumsum(sizes)[:-1]) if sizes else []
    lost = ["its texture coordinates are ignored"] if np.any(index[:, 1] >= 0) else []
    return Polygons(places, polygons, normals, plain, notes, lost)


def _obj_corner(word: str, before: list[int]) -> list[int]:
    """Indices from 0 of a corner's vertex, texture coordinates and normal; -1 for none."""
    texts = word.split("/")
    try:
        numbers = [int(text) if text else None for text in texts]
    except ValueError:
        numbers = []
    if not 1 <= len(numbers) <= 3 or numbers[0] is None or 0 in numbers:
        raise InputError(f'it has a face with the corner "{shortened(word)}"; mend the file')
    return [
        -1 if number is None else number - 1 if number > 0 else max(there + number, -2)
        for number, there in zip([*numbers, None, None][:3], before, strict=True)
    ]


def _obj_table(rows: list[list[str]], kind: str) -> Array:
    if any(len(row) < 3 for row in rows):
        raise InputError(f'it has a "{kind}" of fewer than three numbers; mend the file')
    return numbers([word for row in rows for word in row[:3]]).reshape(-1, 3)


def read_stl(data: bytes) -> Polygons:
    """Read an STL file's bytes."""
    facets = int.from_bytes(data[80:_STL_HEAD], "little")
    if len(data) != _STL_HEAD + _STL_FACET * facets:  # not binary: its size would fit
        if data[:1024].lstrip()[:5].lower() != b"solid" or b"\0" in data[:1024]:
            held = max(0, len(data) - _STL_HEAD) // _STL_FACET
            raise InputError(
                f"it is no ASCII STL, and as a binary one it counts {facets} facets and holds"
                f" {held}; give the whole file"
            )
        counts = [
            len(re.findall(rb"^\s*" + word + rb"\b", data, re.MULTILINE | re.IGNORECASE))
            for word in (b"facet", b"endfacet", b"vertex")
        ]
        facets = counts[0]
        if counts != [facets, facets, 3 * facets]:
            raise InputError(
                "it has {} facets, {} of them ended, and {} vertices; give the whole file".format(
                    *counts
                )
            )
    try:
        loaded = load_stl(BytesIO(data))
    except ValueError as error:
        raise InputError(f"trimesh can't read it ({error}); mend the file") from None
    solids = list(loaded["geometry"].values()) if "geometry" in loaded else [loaded]
    if not solids:
        raise InputError("it has no facets; give a mesh")
    corner = np.concatenate([np.asarray(solid["vertices"], float) for solid in solids])
    if len(corner) != 3 * facets:
        raise InputError(
            f"it has {facets} facets, and trimesh reads {len(corner) // 3}; is a solid named like a"
            " word of the format? Mend the file"
        )
    return Polygons(
        corner,
        np.arange(len(corner)).reshape(-1, 3),
        notes=_contradicted([solid["face_normals"] for solid in solids], corner),
    )


def _contradicted(normals: list[Any], corner: Array) -> list[str]:
    """Whether facet normals contradict the order of the corners (3 M, 3)."""
    if any(each is None for each in normals):
        return []
    place = corner.reshape(-1, 3, 3)
    with np.errstate(all="ignore"):
        ordered = np.cross(place[:, 1] - place[:, 0], place[:, 2] - place[:, 0])
        count = int(np.sum(np.einsum("fi,fi->f", np.concatenate(normals), ordered) < 0.0))
    if not count:
        return []
    return [f"the normals of {count} facets contradict the order of their corners, which holds"]
