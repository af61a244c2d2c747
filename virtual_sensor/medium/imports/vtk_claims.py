"""What a VTK file claims to hold, held against what is there, before VTK reads it.

VTK's reader of legacy files fills an array that ends too early with what lay in memory, and its
readers of XML files make room for whatever is claimed.
"""

from __future__ import annotations

import math
import re
from collections.abc import Callable, Iterator
from pathlib import Path

import numpy as np

from virtual_sensor.errors import InputError
from virtual_sensor.medium.imports.vtk_arrays import cell_corners

BYTES = {
    **dict.fromkeys(("char", "unsigned_char", "signed_char"), 1),
    **dict.fromkeys(("short", "unsigned_short"), 2),
    **dict.fromkeys(("int", "unsigned_int", "float", "vtkidtype"), 4),  # ids are written as int
    **dict.fromkeys(("long", "unsigned_long", "double"), 8),
    **dict.fromkeys(("long_long", "unsigned_long_long"), 8),
}
COMPONENTS = {"VECTORS": 3, "NORMALS": 3, "TENSORS": 9, "TENSORS6": 6}
CELLS = ("CELLS", "VERTICES", "LINES", "POLYGONS", "TRIANGLE_STRIPS")
MOST_PACKED = 2000  # a value takes this part of a byte at least, compressed
HEADER = 100_000  # bytes of an XML file's beginning, where its claims are searched
ANY_ORDER = 40  # types of cells below it have a fixed number of corners, or any
NUMBER = rb"[-+]?(?:(?:\d++\.?+\d*+|\.\d++)(?:[eE][-+]?\d++)?+|(?i:nan|inf(?:inity)?+))(?=\s|\Z)"
TYPE = re.compile(r"vtktype(?:u?int|float)(8|16|32|64)")


class _Legacy:
    """Walks through a legacy file, array by array."""

    def __init__(self, content: bytes) -> None:
        self.content, self.at = content, 0
        self.claimed: dict[str, int] = {}  # numbers of points and cells
        self.kind = ""

    def lines(self) -> Iterator[list[str]]:
        """Step over lines one by one, and give their words."""
        while self.at < len(self.content):
            end = self.content.find(b"\n", self.at)
            end = len(self.content) if end < 0 else end
            line, self.at = self.content[self.at : end], end + 1
            yield line.decode("latin-1").split()

    def line(self) -> list[str]:
        """Words of the next line that is not empty; none at the end."""
        return next(filter(None, self.lines()), [])

    def line_of(self, keyword: str) -> list[str]:
        """Words of the next line if it begins with a keyword; else none, and it stays the next."""
        place, words = self.at, self.line()
        if words and words[0].upper() == keyword:
            return words
        self.at = place
        return []

    def skip_metadata(self) -> None:
        """Step behind the empty line that ends metadata."""
        next((words for words in self.lines() if not words), None)

    def array(self, what: str, count: int, kind: str) -> None:
        """Step over an array."""
        if count < 0:
            raise InputError(f"is damaged: it claims {count} values of {what}")
        if self.kind == "BINARY":
            size = -(-count // 8) if kind == "bit" else count * self._bytes(what, kind)
            if self.at + size > len(self.content):
                self._short(what, count, (len(self.content) - self.at) * count // max(size, 1))
            self.at += size
            return
        if count * 2 - 1 > len(self.content) - self.at:  # a digit and a blank each
            self._short(what, count, (len(self.content) - self.at) // 2)
        whole = re.compile(rb"(?:\s*+%s){%d}+" % (NUMBER, count)).match(self.content, self.at)
        if not whole:
            found = re.compile(rb"(?:\s*+%s)*+" % NUMBER).match(self.content, self.at)
            self._short(what, count, len(found[0].split()) if found else 0)
        self.at = whole.end() if whole else self.at

    def _bytes(self, what: str, kind: str) -> int:
        sized = TYPE.fullmatch(kind)
        if kind not in BYTES and not sized:
            raise InputError(f"{what} is of type '{kind}', which holds no numbers; leave it out")
        return int(sized[1]) // 8 if sized else BYTES[kind]

    @staticmethod
    def _short(what: str, count: int, found: int) -> None:
        raise InputError(
            f"is truncated or damaged: it claims {count} values of {what}, and holds {found};"
            " write or copy it again"
        )


def check_legacy(path: Path) -> None:
    """Refuse a legacy .vtk file that holds less than it claims.

    Raises
    ------
    InputError
        It names the array.
    """
    file = _Legacy(path.read_bytes())
    if not file.content.startswith(b"# vtk DataFile Version"):
        raise InputError("is no legacy VTK file: it does not begin with '# vtk DataFile Version'")
    for _ in range(2):  # version and title, which may be empty
        file.at = file.content.find(b"\n", file.at) + 1 or len(file.content)
    file.kind = " ".join(file.line()).upper()
    last = file.content[-4000:].split()[-33:]
    if (
        file.kind == "ASCII"
        and not file.content[-1:].isspace()
        and (len(last) < 9 or len(last[-1]) < min(map(len, last[:-1])))
    ):
        raise InputError(
            f"ends with '{last[-1].decode('latin-1')[-40:]}' and without a line end: truncated?"
            " Write or copy it again; if it is whole, end its last line"
        )
    if file.kind not in ("ASCII", "BINARY"):
        said = f"'{file.kind[:40]}'"
        raise InputError(f"is damaged: its third line is neither ASCII nor BINARY ({said})")
    try:
        tuples = 0
        while words := file.line():
            tuples = _section(file, words, tuples)
    except (ValueError, IndexError) as error:
        if isinstance(error, InputError):
            raise
        raise InputError(f"is truncated or damaged ({error}); write or copy it again") from error


def _section(file: _Legacy, words: list[str], tuples: int) -> int:
    """Step over what a keyword begins; give the number of tuples of the arrays that follow."""
    key = words[0].upper()
    step: Callable[[str, int, str], None] = file.array
    if key == "DATASET":
        if words[1].upper() not in DATASETS:
            raise InputError(f"holds a {words[1]}, no {', '.join(DATASETS).lower()}")
    elif key in ("DIMENSIONS", "EXTENT", "ORIGIN", "SPACING", "ASPECT_RATIO"):
        values = [float(word) for word in words[1:]]
        if len(values) < (6 if key == "EXTENT" else 3) or not np.isfinite(values).all():
            raise InputError(f"is truncated or damaged at '{' '.join(words)}'")
        if key == "DIMENSIONS":
            if min(values) < 1:
                raise InputError(f"has no nodes: its dimensions are {' '.join(words[1:])}")
            counts = [int(value) for value in values[:3]]
            file.claimed["POINT_DATA"] = math.prod(counts)
            file.claimed["CELL_DATA"] = math.prod(max(count - 1, 1) for count in counts)
    elif key == "POINTS":
        file.claimed["POINT_DATA"] = int(words[1])
        step("POINTS", 3 * int(words[1]), words[2].lower())
    elif key in ("X_COORDINATES", "Y_COORDINATES", "Z_COORDINATES"):
        step(key, int(words[1]), words[2].lower())
    elif key in CELLS:
        _cells(file, words)
    elif key == "CELL_TYPES":
        step(key, int(words[1]), "int")
    elif key in ("POINT_DATA", "CELL_DATA"):
        count, claimed = int(words[1]), file.claimed.get(key, 0)
        if 0 <= count < claimed:  # VTK would ask for their memory first
            raise InputError(
                f"is damaged: its size makes {claimed} of {key}, which says {count}; write or copy"
                " it again"
            )
        return count
    elif key == "SCALARS":
        components = int(words[3]) if len(words) > 3 else 1
        file.line_of("LOOKUP_TABLE")
        step(words[1], components * tuples, words[2].lower())
    elif key in COMPONENTS:
        step(words[1], COMPONENTS[key] * tuples, words[2].lower())
    elif key == "TEXTURE_COORDINATES":
        step(words[1], int(words[2]) * tuples, words[3].lower())
    elif key in ("GLOBAL_IDS", "PEDIGREE_IDS", "EDGE_FLAGS"):
        step(words[1], tuples, words[2].lower())
    elif key == "COLOR_SCALARS":
        step(words[1], int(words[2]) * tuples, "unsigned_char")
    elif key == "LOOKUP_TABLE":
        step(words[1], 4 * int(words[2]), "unsigned_char")
    elif key == "FIELD":
        for _ in range(int(words[2])):
            name, components, length, kind = _field_array(file)
            if kind == "string":
                for _ in range(components * length):
                    file.line()
            else:
                step(name, components * length, kind)
    elif key == "METADATA":
        file.skip_metadata()
    else:
        raise InputError(f"is damaged: '{key[:40]}' is no keyword of a VTK file")
    return tuples


DATASETS = (
    "STRUCTURED_POINTS",
    "STRUCTURED_GRID",
    "RECTILINEAR_GRID",
    "UNSTRUCTURED_GRID",
    "POLYDATA",
)


def _field_array(file: _Legacy) -> tuple[str, int, int, str]:
    """Head of an array of a FIELD; the metadata of the one before are skipped."""
    if file.line_of("METADATA"):
        file.skip_metadata()
    words = file.line()
    if len(words) < 4:
        raise InputError(f"is truncated or damaged at '{' '.join(words)}', an array of a FIELD")
    return words[0], int(words[1]), int(words[2]), words[3].lower()


def _cells(file: _Legacy, words: list[str]) -> None:
    """Step over cells, in the form of version 5 (offsets and connectivity) or of older ones."""
    count, size = int(words[1]), int(words[2])
    offsets = file.line_of("OFFSETS")
    if not offsets:
        file.array(words[0], size, "int")
        return
    file.array(f"{words[0]}, offsets", count, offsets[1].lower())
    corners = file.line_of("CONNECTIVITY")
    if not corners:
        raise InputError(f"is truncated or damaged: {words[0]} without a connectivity")
    file.array(f"{words[0]}, connectivity", size, corners[1].lower())


def check_xml(path: Path) -> None:
    """Refuse an XML file of VTK that claims impossible numbers of points or cells.

    Raises
    ------
    InputError
        It names the claim.
    """
    size = path.stat().st_size
    with path.open("rb") as file:
        header = file.read(HEADER).decode("latin-1")
    if "<VTKFile" not in header:
        raise InputError("is no XML file of VTK: there is no <VTKFile ...> in it")
    for name, claim in re.findall(r'\b(WholeExtent|Extent)\s*=\s*"([^"]*)"', header):
        try:
            ends = np.reshape([int(word) for word in claim.split()], (3, 2))
        except (ValueError, OverflowError):
            raise InputError(f'is damaged: {name}="{claim[:60]}" is no three pairs') from None
        nodes = [int(high) - int(low) + 1 for low, high in ends.tolist()]
        if min(nodes) < 1:
            raise InputError(f'has no nodes: {name}="{claim}" runs backwards')
        _refuse_more(name, claim, int(np.prod(nodes, dtype=object)), size, path)
    for name, claim in re.findall(r'\b(NumberOf(?:Points|Cells))\s*=\s*"([^"]*)"', header):
        try:
            count = int(claim)
        except ValueError:
            raise InputError(f'is damaged: {name}="{claim[:60]}" is no number') from None
        if count < 0:
            raise InputError(f'is damaged: {name}="{claim}" is negative')
        _refuse_more(name, claim, count, size, path)


def _refuse_more(name: str, claim: str, count: int, size: int, path: Path) -> None:
    if count > MOST_PACKED * size and not path.suffix.lower().startswith(".p"):
        raise InputError(
            f'is truncated or damaged: {name}="{claim}" claims {count:.3g} points or cells, in a'
            f" file of {size} bytes; write or copy it again"
        )


def check_mesh(cells: object) -> None:
    """Refuse a mesh whose cells refer to points that are not there, or that is nowhere.

    Parameters
    ----------
    cells : pyvista.UnstructuredGrid or pyvista.PolyData
        As it was read.

    Raises
    ------
    InputError
        It names the cell or the point.
    """
    points = np.asarray(cells.points)  # type: ignore[attr-defined]
    names = ("GetCells",) if hasattr(cells, "GetCells") else ("GetVerts", "GetLines", "GetPolys")
    for name in names:
        array = getattr(cells, name)()
        if array is None or array.GetNumberOfCells() == 0:
            continue
        starts, corners = cell_corners(array)
        if starts[0] != 0 or (np.diff(starts) < 0).any() or starts[-1] > len(corners):
            raise InputError("is damaged: its cells' offsets do not ascend; write it again")
        wrong = (corners < 0) | (corners >= len(points))
        if wrong.any():
            where = int(np.searchsorted(starts, np.flatnonzero(wrong)[0], "right")) - 1
            raise InputError(
                f"is damaged: cell {where} refers to point {corners[wrong][0]}, and there are"
                f" {len(points)} points; write it again"
            )
        if name == "GetCells":
            _check_corners(np.asarray(cells.celltypes), np.diff(starts))  # type: ignore[attr-defined]
    bad = ~np.isfinite(points).all(axis=1)
    if bad.any():
        raise InputError(
            f"the coordinates of {bad.sum()} points are not finite, of point"
            f" {np.flatnonzero(bad)[0]} for one; remove them"
        )


def _check_corners(kinds: np.ndarray, counts: np.ndarray) -> None:
    """Refuse cells that have another number of corners than their type, or no type."""
    from vtkmodules.vtkCommonDataModel import vtkGenericCell

    wanted = np.zeros(256, dtype=np.int64)  # 0: any
    for kind in np.unique(kinds[kinds < ANY_ORDER]).tolist():
        cell = vtkGenericCell.InstantiateCell(kind)
        wanted[kind] = cell.GetNumberOfPoints() if cell else 0
    fixed = wanted[kinds]
    wrong = (fixed > 0) & (fixed != counts) | (kinds == 0) | (counts == 0)
    if wrong.any():
        where = int(np.flatnonzero(wrong)[0])
        raise InputError(
            f"is damaged: cell {where}, of VTK's type {kinds[where]}, has {counts[where]} corners;"
            " write it again"
        )
