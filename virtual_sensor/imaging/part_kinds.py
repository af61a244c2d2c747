"""Which kind of part a file holds: by its suffix, and by its first bytes."""

import re
from pathlib import Path

from virtual_sensor.errors import InputError

KINDS = ("stl", "obj", "ply", "3mf")
"""Types of shapes that are read from files of meshes."""

AS_MESH = "export it as STL or 3MF from the CAD program, with a chord tolerance of 0.001 mm"
"""What to do with a file of exact surfaces."""

EXACT_KINDS = (
    *("step", "stp", "iges", "igs", "dxf", "dwg", "sldprt", "sldasm", "ipt", "fcstd", "brep"),
    *("x_t", "x_b", "sat", "3dm", "catpart", "prt", "par", "jt", "f3d"),
)
"""Suffixes of files that hold no mesh, and so make no part."""

_MAGIC = {  # by its first bytes: what a file is, and the remedy
    "ply": (rb"ply\r?\n", 'a PLY file; say <shape type="ply">, and name it .ply'),
    "3mf": (rb"PK\x03\x04", 'a ZIP archive, such as 3MF; say <shape type="3mf">, and name it .3mf'),
    "step": (rb"\s*ISO-10303-21;", f"a STEP file; {AS_MESH}"),
    "iges": (rb"[^\r\n]{72}S[ 0]{6}1\s*\n", f"an IGES file; {AS_MESH}"),
    "dxf": (rb"\s*0\s*\n\s*SECTION\s", f"a DXF file; {AS_MESH}"),
    "dwg": (rb"AC10\d\d", f"a DWG file; {AS_MESH}"),
    "glb": (rb"glTF", "a glTF file; export it as STL or PLY"),
}


def other_kind(data: bytes) -> tuple[str, str] | None:
    """What a file is by its first bytes, and what to do with it."""
    for kind, (begins, words) in _MAGIC.items():
        if re.match(begins, data):
            return kind, words
    return None


def is_part(path: Path, data: bytes) -> bool:
    """Whether a file is of a part, by its first bytes or its suffix; of a mesh or of surfaces."""
    if path.suffix.lower().removeprefix(".") in (*KINDS, *EXACT_KINDS):
        return True
    found = other_kind(data)
    return found is not None and found[0] != "3mf"  # many files are ZIP archives


def check_kind(path: Path) -> str:
    """The kind that a part's file is by its suffix, one of `KINDS`.

    Raises
    ------
    InputError
        Which says how to come by such a file.
    """
    kind = path.suffix.lower().removeprefix(".")
    if kind in KINDS:
        return kind
    if kind in EXACT_KINDS:
        raise InputError(f"{path}: it is a file of exact surfaces; {AS_MESH}")
    kinds = ", ".join(KINDS)
    raise InputError(f"{path}: parts are read from {kinds}; export it as one of these")
