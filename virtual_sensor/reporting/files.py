"""The data dictionary: every file that a command writes, with what its columns and keys mean.

Each module of this room that writes files lists them as `FILES`; the words are those of the
records and tables that the files hold.
"""

from __future__ import annotations

import csv
import json
from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass
from fnmatch import fnmatchcase
from pathlib import Path
from types import UnionType
from typing import Any, Union, get_args, get_origin, get_type_hints
from urllib.parse import quote

from virtual_sensor.records import Described, Record, documented
from virtual_sensor.reporting.page import PAGE
from virtual_sensor.reporting.tables import Link, TextTable

_AXES = {f"_{axis}" for axis in (*"xyzuv", "norm")}


@dataclass(frozen=True)
class FileOf:
    """A file that a command writes.

    Attributes
    ----------
    pattern : str
        Its name, with ``*`` where it varies: "line_*.csv".
    words : str
        What it holds.
    kind : type, tuple of Described, or None
        The `Record` or `Table` whose documented fields it holds, or its layers; None of pictures
        and pages.
    """

    pattern: str
    words: str
    kind: type | tuple[Described, ...] | None = None

    @property
    def fields(self) -> list[Described]:
        """Its columns, keys or layers."""
        if self.kind is None:
            return []
        return list(self.kind) if isinstance(self.kind, tuple) else documented(self.kind)


def dictionary(files: Mapping[str, Sequence[FileOf]]) -> str:
    """The data dictionary in Markdown: command by command, then the objects within JSON files."""
    parts = [
        "# Data dictionary\n\nEvery file that a command writes, with its columns, keys and layers."
        " Names end with their unit. CSV columns of vectors end with their axis: `point_mm` is"
        " `point_mm_x`, `point_mm_y`, `point_mm_z`, and `pixel` is `pixel_u`, `pixel_v`. What has"
        " no answer is an empty cell, or `null`. Objects within an object are listed"
        " [at the end](#objects), each once.\n"
    ]
    objects: dict[str, type] = {}
    for command, written in files.items():
        parts.append(f"## {command}\n")
        for each in written:
            parts.append(f"### {each.pattern}\n\n{each.words}\n".replace("*", "\\*"))
            parts += _listed(each.fields, objects)
    parts.append("## Objects\n")
    done: set[str] = set()
    while waiting := sorted(objects.keys() - done):
        name = waiting[0]
        done.add(name)
        words = (objects[name].__doc__ or "").splitlines()[0]
        parts += [f"### {name}\n\n{words}\n", *_listed(documented(objects[name]), objects)]
    return "\n".join(parts)


def file_table(files: Sequence[FileOf], names: Sequence[str] | None = None) -> TextTable:
    """Files beside a page, with links and words: `names`, or a row for each pattern.

    A pattern leads to its folder.
    """
    rows: list[tuple[str | Link, str]] = []
    for name in [each.pattern for each in files] if names is None else names:
        file = next((each for each in files if fnmatchcase(name, each.pattern)), None)
        if file and name != PAGE:
            place = name if "*" not in name else name[: name.rfind("/", 0, name.index("*")) + 1]
            rows.append((Link(name, quote(place)) if place else name, file.words))
    return TextTable(("file", "what it holds"), tuple(rows))


def _listed(fields: Sequence[Described], objects: dict[str, type]) -> list[str]:
    """A table of fields, if there are any; records within them are added to `objects`."""
    if not fields:
        return []
    rows = []
    for each in fields:
        objects |= {kind.__name__: kind for kind in each.records}
        links = ", ".join(f"[{kind.__name__}](#{kind.__name__.lower()})" for kind in each.records)
        rows.append((f"`{each.name}`", each.unit, f"{each.words} {links}".strip()))
    return [TextTable(("name", "unit", "what it is"), tuple(rows)).markdown().replace("\\`", "`")]


def undocumented(folder: Path, files: Sequence[FileOf]) -> list[str]:
    """What a folder of results holds and no dictionary lists: files, columns, keys."""
    found = []
    for path in sorted(p for p in folder.rglob("*") if p.is_file()):
        name = path.relative_to(folder).as_posix()
        file = next((each for each in files if fnmatchcase(name, each.pattern)), None)
        if file is None:
            found.append(name)
        elif isinstance(file.kind, type) and path.suffix == ".csv":
            known = _column_names(file.fields)
            found += [f"{name}: {each}" for each in _csv_names(path) if each not in known]
        elif isinstance(file.kind, type) and path.suffix == ".json":
            value = json.loads(path.read_text(encoding="utf-8"))
            found += [f"{name}: {each}" for each in _unknown(value, file.kind, "")]
    return found


def _column_names(fields: Sequence[Described]) -> set[str]:
    names = {each.name for each in fields}
    return names | {name + axis for name in names for axis in _AXES}


def _csv_names(path: Path) -> list[str]:
    with path.open(encoding="utf-8", newline="") as file:
        return next(csv.reader(file))


def _unknown(value: Any, hint: Any, above: str) -> Iterator[str]:
    """Keys of an object that no record of its type has, with dots."""
    arguments = [kind for kind in get_args(hint) if kind not in (type(None), Ellipsis)]
    if isinstance(hint, type) and issubclass(hint, Record) and isinstance(value, dict):
        hints = get_type_hints(hint)
        for key, each in value.items():
            if key in hints:
                yield from _unknown(each, hints[key], f"{above}{key}.")
            else:
                yield f"{above}{key}"
    elif isinstance(hint, UnionType) or get_origin(hint) is Union:
        yield from min((list(_unknown(value, kind, above)) for kind in arguments), key=len)
    elif isinstance(value, dict) and arguments:
        for key, each in value.items():
            yield from _unknown(each, arguments[-1], f"{above}{key}.")
    elif isinstance(value, list) and arguments:
        for each in value:
            yield from _unknown(each, arguments[0], above)
