"""The files of results, and the data dictionary: what each file's columns and keys mean.

Each module of this room that writes files lists them as `FILES`; the words are those of the
records and tables that the files hold.
"""

from __future__ import annotations

import csv
import json
from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass, replace
from fnmatch import fnmatchcase
from pathlib import Path
from types import UnionType
from typing import Any, Union, get_args, get_origin, get_type_hints
from urllib.parse import quote

from virtual_sensor.files import written_whole
from virtual_sensor.records import Described, Record, documented, write_csv, write_json
from virtual_sensor.reporting.page import PAGE, Page, Section, write_page
from virtual_sensor.reporting.pictures import Picture
from virtual_sensor.reporting.tables import Link, TextTable

_AXES = {f"_{axis}" for axis in (*"xyzuv", "norm")}
_MOST_NAMED = 3  # files of a pattern that a page names one by one


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


def write_results(folder: Path, files: Sequence[FileOf], contents: Mapping[str, Any]) -> None:
    """Write files of results, each as what it is; the page gets a section that lists them all.

    Parameters
    ----------
    folder : Path
        What is in it already is listed too.
    files : sequence of FileOf
        With what the list says of each.
    contents : dict of str to Page, Picture, bytes, str, Table or columns (CSV), or Record (JSON)
        By their names, in the order in which they are written.

    Raises
    ------
    InputError
        If one can't be written.
    """
    there = [path.relative_to(folder).as_posix() for path in folder.rglob("*") if path.is_file()]
    for name, content in contents.items():
        path = folder / name
        if isinstance(content, Page):
            listed = Section("Files", file_table(files, sorted({*there, *contents})))
            write_page(path, replace(content, sections=(*content.sections, listed)))
        elif isinstance(content, Picture):
            content.write(path)
        elif isinstance(content, bytes):
            with written_whole(path) as temporary:
                temporary.write_bytes(content)
        elif isinstance(content, str):
            with written_whole(path) as temporary:
                temporary.write_text(content, encoding="utf-8", errors="backslashreplace")
        else:
            (write_csv if path.suffix == ".csv" else write_json)(path, content)


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


def file_table(files: Sequence[FileOf], names: Sequence[str]) -> TextTable:
    """Files beside a page, with links and words; of many alike their pattern, with its folder."""
    found: dict[FileOf, list[str]] = {each: [] for each in files}
    for name in names:
        if name != PAGE and (file := _file_of(files, name)):
            found[file].append(name)
    rows: list[tuple[str | Link, str]] = []
    for file, alike in found.items():
        for name in alike if len(alike) <= _MOST_NAMED else [file.pattern]:
            place = name if "*" not in name else name[: name.rfind("/", 0, name.index("*")) + 1]
            rows.append((Link(name, quote(place)) if place else name, file.words))
    return TextTable(("file", "what it holds"), tuple(rows))


def _file_of(files: Sequence[FileOf], name: str) -> FileOf | None:
    """The first whose pattern a name has."""
    return next((each for each in files if fnmatchcase(name, each.pattern)), None)


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
        file = _file_of(files, name)
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
