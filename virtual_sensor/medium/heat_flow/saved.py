"""What a run leaves in its case's folder: the saved times, and series of figures over time."""

from __future__ import annotations

import os
import re
import shutil
from dataclasses import dataclass
from pathlib import Path

import numpy as np

from virtual_sensor.display import Displayed
from virtual_sensor.errors import InputError

FIELDS = ("T", "U", "p", "phi", "rho")  # from which a run goes on as if it had not stopped
CLOSING = b"***** //"
_NUMBER = re.compile(r"\d+(\.\d*)?(e[-+]?\d+)?")


@dataclass(frozen=True, order=True)
class SavedTime(Displayed):
    """A whole time folder, s; `decomposed` where it lies in the folders of the processes only."""

    time_s: float
    name: str
    decomposed: bool = False


def times(folder: Path) -> tuple[SavedTime, ...]:
    """List the saved times that are whole, of serial and decomposed cases, ascending."""
    joined = {float(p.name): p.name for p in time_folders(folder) if _whole(p)}
    parts = processor_folders(folder)
    apart: dict[float, str] = {}
    if parts:
        names = (p.name for p in time_folders(parts[0]))
        apart = {float(n): n for n in names if all(_whole(part / n) for part in parts)}
    found = [SavedTime(t, name) for t, name in joined.items()]
    found += [SavedTime(t, name, True) for t, name in apart.items() if t not in joined]
    return tuple(sorted(found))


def processor_folders(folder: Path) -> list[Path]:
    """List the folders of a decomposed case's processes, in order."""
    found = [p for p in folder.glob("processor*") if p.name[9:].isdigit()]
    return sorted(found, key=lambda p: int(p.name[9:]))


def remove_unfinished(folder: Path) -> None:
    """Remove time folders that a killed run left half-written."""
    for path in time_folders(folder):
        if not _whole(path):
            remove_folder(path)
    parts = processor_folders(folder)
    for name in {p.name for part in parts for p in time_folders(part)}:
        if not all(_whole(part / name) for part in parts):
            for part in parts:
                remove_folder(part / name)


def remove_later(folder: Path, time_s: float) -> None:
    """Remove saved times later than a time."""
    for place in (folder, *processor_folders(folder)):
        for path, when in time_folders(place).items():
            if when > time_s:
                remove_folder(path)


def remove_series_from(folder: Path, time_s: float) -> None:
    """Remove series that start at a time or later, which the run will write again."""
    for start, path in _series_folders(folder, "*"):
        if start >= time_s:
            remove_folder(path)


def _series_folders(folder: Path, name: str) -> list[tuple[float, Path]]:
    """A function object's folders, named for the times in s from which they hold; ascending."""
    found = folder.glob(f"postProcessing/{name}/*")
    return sorted((float(p.name), p) for p in found if _NUMBER.fullmatch(p.name))


def series(folder: Path, name: str) -> tuple[np.ndarray, dict[str, np.ndarray]]:
    """Read what a function object has recorded, over all runs of a case.

    Each run writes into a folder named for its starting time; from there on it holds.

    Parameters
    ----------
    folder : Path
        Of the case.
    name : str
        Of the function object, such as "extremes".

    Returns
    -------
    times_s : ndarray, shape (n,)
        Flow time, s, ascending.
    columns : dict of str to ndarray, shape (n,)
        Numeric columns by the file's headings, such as "max(T)".

    Raises
    ------
    InputError
        If there is none of that name.
    """
    headings: list[str] = []
    rows: list[list[str]] = []
    for start, path in _series_folders(folder, name):
        rows = [row for row in rows if float(row[0]) <= start]
        for file in sorted(path.glob("*.dat")):
            found, records = _records(file)
            headings = found or headings
            rows += [r for r in records if len(r) == len(headings)]
    if not rows:
        raise InputError(f"{folder}: no records in postProcessing/{name}; has the case been run?")
    table = dict(zip(headings, zip(*rows, strict=True), strict=True))
    numeric = {k: np.array(v, dtype=float) for k, v in table.items() if _is_number(v[0])}
    return numeric.pop(headings[0]), numeric


def last_record(folder: Path, name: str) -> list[float] | None:
    """The latest row that a function object has recorded: time in s, then its figures."""
    folders = _series_folders(folder, name)
    files = sorted(folders[-1][1].glob("*.dat")) if folders else []
    if not files:
        return None
    with files[-1].open("rb") as stream:
        stream.seek(max(0, stream.seek(0, os.SEEK_END) - 1000))
        rows = stream.read().rpartition(b"\n")[0].splitlines()
    row = rows[-1].decode(errors="replace").split() if rows else ["#"]
    return [float(word) for word in row] if all(map(_is_number, row)) else None


def _records(file: Path) -> tuple[list[str], list[list[str]]]:
    """Headings and rows of a file; a last line that is still being written is left out."""
    text = file.read_text(encoding="utf-8", errors="replace")
    lines = text[: text.rfind("\n") + 1].splitlines()
    comments = [line.lstrip("# ") for line in lines if line.startswith("#")]
    heading = next((c for c in reversed(comments) if c.startswith("Time")), "")
    return heading.split(), [s.split() for s in lines if s.strip() and not s.startswith("#")]


def _is_number(text: str) -> bool:
    try:
        float(text)
    except ValueError:
        return False
    return True


def time_folders(folder: Path) -> dict[Path, float]:
    """Folders that are named for a time, whole or not, with that time, s."""
    with os.scandir(folder) as entries:
        names = [e.name for e in entries if _NUMBER.fullmatch(e.name) and e.is_dir()]
    return {folder / name: float(name) for name in names}


def _whole(folder: Path) -> bool:
    """Whether all fields of a time are there, written to their last line."""
    if float(folder.name) == 0.0:
        return True  # not a run's: the case's own initial fields
    needed = {*FIELDS, "uniform/time"}
    try:
        present = {p.name for p in folder.iterdir() if p.is_file()}
        return all(_closed(folder / name) for name in needed | present)
    except OSError:
        return False


def _closed(file: Path) -> bool:
    """Whether a file of OpenFOAM ends as such files end."""
    with file.open("rb") as stream:
        stream.seek(max(0, stream.seek(0, os.SEEK_END) - 200))
        return stream.read().rstrip().endswith(CLOSING)


def remove_folder(path: Path) -> None:
    """Remove a folder, so that half of it is never taken for the whole."""
    if path.is_dir():
        gone = path.with_name(f".{path.name}.removed")
        shutil.rmtree(gone, ignore_errors=True)
        path.rename(gone)
        shutil.rmtree(gone)
