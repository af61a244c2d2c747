"""The files of results, with what the data dictionary says of their columns and keys.

Each module of this room that writes files lists them as `FILES`; the words are those of the
records and tables that the files hold.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace
from fnmatch import fnmatchcase
from pathlib import Path
from typing import Any
from urllib.parse import quote

from virtual_sensor.files import written_whole
from virtual_sensor.records import Described, documented, write_csv, write_json
from virtual_sensor.reporting.page import PAGE, Page, Section, write_page
from virtual_sensor.reporting.pictures import Picture
from virtual_sensor.reporting.tables import Link, TextTable

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


def file_table(files: Sequence[FileOf], names: Sequence[str]) -> TextTable:
    """Files beside a page, with links and words; of many alike their pattern, with its folder."""
    found: dict[FileOf, list[str]] = {each: [] for each in files}
    for name in names:
        if name != PAGE and (file := file_of(files, name)):
            found[file].append(name)
    rows: list[tuple[str | Link, str]] = []
    for file, alike in found.items():
        for name in alike if len(alike) <= _MOST_NAMED else [file.pattern]:
            place = name if "*" not in name else name[: name.rfind("/", 0, name.index("*")) + 1]
            rows.append((Link(name, quote(place)) if place else name, file.words))
    return TextTable(("file", "what it holds"), tuple(rows))


def file_of(files: Sequence[FileOf], name: str) -> FileOf | None:
    """The first whose pattern a name has."""
    return next((each for each in files if fnmatchcase(name, each.pattern)), None)
