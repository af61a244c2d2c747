"""The readers of OBJ and STL files; what is used is listed in `virtual_sensor.imaging.parts`."""

import logging
import re
from codecs import BOM_UTF8
from collections import defaultdict
from io import BytesIO
from itertools import chain
from typing import Any

import numpy as np

from virtual_sensor.errors import InputError
from virtual_sensor.imaging.polygons import Array, Indices, Polygons, numbers
from virtual_sensor.imaging.scene_file import shortened

logging.getLogger("trimesh").addHandler(logging.NullHandler())  # it would show tracebacks

_OBJ_KINDS = "v", "vt", "vn"
_FREE_FORM = ("surf", "curv", "curv2", "cstype")
_NONE = 2**40  # in place of an index
_STL_HEAD, _STL_FACET = 84, 50


def read_obj(data: bytes) -> Polygons:
    """Read an OBJ file's bytes."""
    text = re.sub(r"\\\r?\n", " ", data.decode("utf-8-sig", "replace"))
    text = re.sub(r"#.*", "", text).replace("\t", " ")
    rows: defaultdict[str, list[str]] = defaultdict(list)
    before: list[tuple[int, ...]] = []  # of each face: negative indices count from there
    backwards = re.search(r"^ *f .*-", text, re.MULTILINE) is not None
    for line in text.splitlines():
        word, _, rest = line.strip().partition(" ")
        rows[word].append(rest)
        if backwards and word == "f":
            before.append(tuple(len(rows[kind]) for kind in _OBJ_KINDS))
    if free := next((word for word in _FREE_FORM if word in rows), None):
        raise InputError(f'it has free forms ("{free}"); export it as a mesh of polygons')
    notes = ["its materials are ignored; the scene's <bsdf> holds"] if "usemtl" in rows else []
    corners = [row.split() for row in rows["f"]]
    sizes = [len(row) for row in corners]
    index = _obj_corners(list(chain.from_iterable(corners)))
    face = np.repeat(np.arange(len(sizes)), sizes)
    if backwards:
        index = np.where(index < 0, np.array(before)[face] + index, index)
    lengths = np.array([len(rows[kind]) for kind in _OBJ_KINDS])
    missing = index == _NONE
    outside = ~missing & ((index < 0) | (index >= lengths))
    if outside.any():
        row, column = np.argwhere(outside)[0]
        raise InputError(
            f'face {face[row]} refers to a "{_OBJ_KINDS[column]}" that is not there, of'
            f" {lengths[column]}; mend the file"
        )
    places, corner, normals = _obj_table(rows["v"], "v"), index[:, 0], None
    if len(index) and not missing[:, 2].any():  # a vertex may have several normals
        pairs = corner * lengths[2] + index[:, 2]
        pairs, corner = np.unique(pairs, return_inverse=True)
        normals = _obj_table(rows["vn"], "vn")[pairs % lengths[2]]
        places = places[pairs // lengths[2]]
    lost = ["its texture coordinates are ignored"] if not missing[:, 1].all() else []
    plain = not (backwards or data.startswith(BOM_UTF8))
    return Polygons(places, corner, sizes, normals, plain, notes, lost)


def _obj_corners(words: list[str]) -> Indices:
    """Indices (N, 3) of corners' vertices, texture coordinates and normals; `_NONE` for none.

    From 0, or from -1 backwards.
    """
    slashes = [word.count("/") for word in words]
    most = max(slashes, default=0)
    if min(slashes, default=0) < most:
        words = [
            word + f"/{_NONE + 1}" * (most - n) for word, n in zip(words, slashes, strict=True)
        ]
    text = re.sub(r"/(?=[/ ])", f"/{_NONE + 1}", " ".join([*words, ""]))
    try:
        found = np.array(list(map(int, text.replace("/", " ").split())), np.int64)
        index = np.full((len(words), 3), _NONE + 1)
        index[:, : most + 1] = found.reshape(len(words), most + 1)
        wrong = (index == 0).any(axis=1) | (index[:, 0] > _NONE)
    except (ValueError, OverflowError):
        wrong = np.array([not re.fullmatch(r"-?\d{1,9}(/-?\d{0,9}){0,2}", w) for w in words])
    if wrong.any():
        word = shortened(words[int(np.argmax(wrong))].replace(f"{_NONE + 1}", ""))
        raise InputError(f'it has a face with the corner "{word}"; mend the file')
    return np.where(index > 0, index - 1, index)


def _obj_table(rows: list[str], kind: str) -> Array:
    words = [row.split()[:3] for row in rows]
    if any(len(row) < 3 for row in words):
        raise InputError(f'it has a "{kind}" of fewer than three numbers; mend the file')
    return numbers(list(chain.from_iterable(words))).reshape(-1, 3)


def read_stl(data: bytes) -> Polygons:
    """Read an STL file's bytes."""
    data = data.removeprefix(BOM_UTF8)
    facets = int.from_bytes(data[80:_STL_HEAD], "little")
    more = len(data) - (_STL_HEAD + _STL_FACET * facets)
    notes = []
    if facets and 0 < more < _STL_FACET:  # as some programs write
        notes = [f"{more} bytes after its facets are ignored"]
        data = data[:-more]
    elif more:  # not binary: its size would fit
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
    from trimesh.exchange.stl import load_stl  # most scenes have no such part

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
        np.arange(len(corner)),
        np.full(facets, 3),
        notes=notes + _contradicted([solid["face_normals"] for solid in solids], corner),
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
