"""Parts from files of meshes: PLY, OBJ and STL, checked before Mitsuba is given them.

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
============================  =====================================================================

Lengths are in mm as in all scenes: none of these formats has units.
"""

from collections.abc import Callable
from dataclasses import dataclass
from pathlib import Path

import numpy as np

from virtual_sensor.display import Displayed, place
from virtual_sensor.errors import InputError, naming
from virtual_sensor.files import readable
from virtual_sensor.imaging.part_files import read_obj, read_stl
from virtual_sensor.imaging.ply_files import read_ply
from virtual_sensor.imaging.polygons import Array, Indices, Polygons, triangulated


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

    def _line(self) -> str:
        low, high = self.vertices.min(axis=0), self.vertices.max(axis=0)
        return f"{len(self.faces)} triangles, from {place(low)} to {place(high)} mm"


def read_part(path: Path, kind: str) -> Part:
    """Read a part and check it.

    Parameters
    ----------
    path : Path
    kind : str
        "ply", "obj" or "stl", whatever the file's name.

    Raises
    ------
    InputError
        If the file can't be read, or is no part that can be measured: see the table above.
    """
    data = readable(path).read_bytes()
    with naming(path):
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
    "ply": read_ply,
    "obj": read_obj,
    "stl": read_stl,
}

KINDS = tuple(_READERS)
"""Types of shapes that are read from such files."""
