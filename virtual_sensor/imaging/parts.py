"""Parts from files of meshes: STL, OBJ, PLY and 3MF, checked before Mitsuba is given them.

A file that Mitsuba reads right is left to it.  Others are read here and handed on as triangles in
the scene's own place; no vertices are merged.

============================  =====================================================================
Feature                       What becomes of it
============================  =====================================================================
triangles                     heeded
quads and other polygons      heeded: cut into triangles from a corner that sees all others, with a
                              note; refused where no corner does
vertex normals                heeded, for shading; `face_normals` leaves them out; all ignored, with
                              a note, where one is nil or no finite number
fewer than three corners      left out, with a note
indices out of range          refused, and so are vertices that are no finite numbers
no vertices, no faces, no     refused
area
counts that don't fit         refused
further vertex properties,    left to Mitsuba in a file that it reads, else left out, with a note
texture coordinates
**PLY**
ASCII, binary, either order   heeded, with any number types, lists of various lengths
`comment`, `obj_info`         ignored: they are remarks
other elements than vertex    ignored, with a note
and face
**OBJ**
groups, objects, smoothing    ignored: all faces make one part
negative indices              heeded: they count from the end
materials                     ignored, with a note: the scene's <bsdf> holds
curves and free surfaces      refused
**STL**
ASCII, binary                 heeded, by trimesh; binary is known by its size, not a word
several solids in a file      heeded: they make one part
facet normals                 the order of the corners holds, with a note where they contradict it
attribute bytes               ignored: colours of some programs
**3MF**
unit                          heeded: lengths become mm, with a note; the other formats have none
items, components             heeded with their transforms: what is built makes one part
supports, materials, beams    ignored, with a note
============================  =====================================================================

Lengths are in mm as in all scenes.
"""

from collections.abc import Callable
from dataclasses import dataclass, replace
from importlib import resources
from pathlib import Path
from typing import Any

import numpy as np

from virtual_sensor.display import Displayed, place
from virtual_sensor.errors import InputError, naming
from virtual_sensor.files import exists, readable
from virtual_sensor.imaging.part_files import read_obj, read_stl
from virtual_sensor.imaging.part_kinds import other_kind
from virtual_sensor.imaging.ply_files import read_ply
from virtual_sensor.imaging.polygons import Array, Indices, Polygons, triangulated
from virtual_sensor.imaging.threemf_files import read_3mf
from virtual_sensor.records import vectors


@dataclass(frozen=True)
class Part(Displayed):
    """A mesh of triangles from a file, in the file's own frame.

    Attributes
    ----------
    vertices : ndarray of shape (N, 3)
        mm.
    faces : ndarray of int of shape (M, 3)
        Indices of each triangle's corners, counter-clockwise seen from outside.
    normals : ndarray of shape (N, 3) or None
        At the vertices, as the file has them.
    by_mitsuba : bool
        Whether Mitsuba's own reader reads the file right.
    notes : tuple of str
    """

    vertices: Array
    faces: Indices
    normals: Array | None = None
    by_mitsuba: bool = False
    notes: tuple[str, ...] = ()

    def placed(self, to_world: Array) -> "Part":
        """The part at another place, by a matrix (4, 4); a mirrored one keeps its outside."""
        turn, normals = to_world[:3, :3], self.normals
        if normals is not None:
            normals = normals @ np.linalg.inv(turn)
            normals = normals / np.linalg.norm(normals, axis=1, keepdims=True)
        faces = self.faces[:, ::-1] if np.linalg.det(turn) < 0.0 else self.faces
        vertices = self.vertices @ turn.T + to_world[:3, 3]
        return replace(self, vertices=vertices, faces=faces, normals=normals)

    def _line(self) -> str:
        low, high = self.vertices.min(axis=0), self.vertices.max(axis=0)
        return f"{len(self.faces)} triangles, from {place(low)} to {place(high)} mm"

    def _columns(self) -> dict[str, Any]:
        return vectors("vertex_mm", self.vertices, "xyz")


def find_part(name: str | Path) -> Path:
    """A part's file, by its path or by the name of one that comes with the program."""
    file = Path(name).expanduser()
    installed = Path(str(resources.files("virtual_sensor_scenes"))) / "meshes" / file
    return installed if not exists(file) and exists(installed) else file


def read_part(path: Path, kind: str) -> Part:
    """Read a part and check it.

    Parameters
    ----------
    path : Path
    kind : str
        One of `KINDS`, whatever the file's name.

    Raises
    ------
    InputError
        If the file can't be read, or is no part that can be measured: see the table above.
    """
    data = readable(path).read_bytes()
    with naming(path):
        if (other := other_kind(data)) and other[0] != kind:
            raise InputError(f"it is no {kind.upper()} file but {other[1]}")
        with np.errstate(invalid="ignore"):  # a NaN that is cast; it is refused below
            read = _READERS[kind](data)
        vertices = read.vertices
        _check_vertices(vertices)
        triangles, notes = triangulated(read)
        corner = vertices[triangles]
        if not np.any(np.cross(corner[:, 1] - corner[:, 0], corner[:, 2] - corner[:, 0])):
            raise InputError("its faces have no area; give a part with a surface")
    normals = read.normals
    if normals is not None:
        with np.errstate(over="ignore", invalid="ignore"):
            length = np.linalg.norm(normals, axis=1)
        wrong = int(np.sum(~(np.isfinite(length) & (length > 0.0))))
        if wrong:
            normals = None
            notes.append(f"its vertex normals are ignored: {wrong} are nil or no finite numbers")
    by_mitsuba = read.plain and not notes
    notes += read.notes + ([] if by_mitsuba else read.only_mitsubas)
    notes = [f"{path}: {note}" for note in notes]
    return Part(vertices, triangles, normals, by_mitsuba, tuple(notes))


def _check_vertices(vertices: Array) -> None:
    if not len(vertices):
        raise InputError("it has no vertices; give a mesh")
    with np.errstate(over="ignore"):
        wrong = ~np.isfinite(vertices.astype(np.float32)).all(axis=1)
    if wrong.any():
        number = int(np.argmax(wrong))
        raise InputError(
            f"vertex {number} is at {vertices[number].tolist()}; give finite numbers in mm"
        )


_READERS: dict[str, Callable[[bytes], Polygons]] = {
    "stl": read_stl,
    "obj": read_obj,
    "ply": read_ply,
    "3mf": read_3mf,
}
