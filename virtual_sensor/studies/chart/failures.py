"""Where methods fail: the table that comes with this version, made by `benchmarks/failures.py`.

It is a property of the methods, not of the machine: no chart measures it again.
"""

from __future__ import annotations

import csv
from collections.abc import Iterable, Mapping, Sequence
from dataclasses import dataclass, fields
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from virtual_sensor.records import Table

FILE = Path(__file__).with_name("failures.csv")

_KINDS = {"NDArray[np.float64]": float, "NDArray[np.int64]": int}
"""Of the columns of numbers, by the annotations of their fields."""


@dataclass(frozen=True)
class Failures(Table):
    """Where methods first fail, as a trouble is made worse: one row for each trouble and method.

    Attributes
    ----------
    panel : sequence of str
        Panel of the chart whose methods they are: rays, frames, search, correction, fringes,
        camera, bounces or lines.
    trouble : sequence of str
        What is made worse.
    method : sequence of str
        What has to cope with it.
    unit : sequence of str
        Unit of all four amounts.
    mildest : ndarray of shape (N,)
        Amount that the trouble begins with.
    severest : ndarray of shape (N,)
        Amount that it ends with.
    reported_from : ndarray of shape (N,)
        First amount that a status, an error or a note reports; empty where nothing does.
    reported : ndarray of int of shape (N,)
        Items of which it is reported there.
    reports : sequence of str
        Statuses that report it there, by their names.
    wrong_from : ndarray of shape (N,)
        First amount at which results that count as good are wrong; empty where none ever is.
    wrong : ndarray of int of shape (N,)
        Items that are wrong there.
    largest_error_px : ndarray of shape (N,)
        Largest error of what counts as good: there, or at any amount if none is wrong; empty where
        it is not measured.
    items : ndarray of int of shape (N,)
        Rays, pixels, laser points or columns that are looked at.
    conditions : sequence of str
        What else was chosen, and what counts as wrong if not an error above 0.01 px.
    note : sequence of str
        What to do about it, or why it is so.
    """

    panel: Sequence[str]
    trouble: Sequence[str]
    method: Sequence[str]
    unit: Sequence[str]
    mildest: NDArray[np.float64]
    severest: NDArray[np.float64]
    reported_from: NDArray[np.float64]
    reported: NDArray[np.int64]
    reports: Sequence[str]
    wrong_from: NDArray[np.float64]
    wrong: NDArray[np.int64]
    largest_error_px: NDArray[np.float64]
    items: NDArray[np.int64]
    conditions: Sequence[str]
    note: Sequence[str]


def failures(panels: Sequence[str] = ()) -> Failures:
    """The table that comes with this version; of some panels only, if they are named."""
    with FILE.open(encoding="utf-8", newline="") as file:
        file.readline()  # see made_by
        rows = csv.DictReader(file)
        return table([row for row in rows if not panels or row["panel"] in panels])


def made_by() -> str:
    """Version and command that made the table."""
    with FILE.open(encoding="utf-8") as file:
        return file.readline().lstrip("# ").strip()


def table(rows: Iterable[Mapping[str, Any]]) -> Failures:
    """The table of rows, whose values may be texts; an empty number is NaN."""
    given, columns = list(rows), dict[str, Any]()
    for each in fields(Failures):
        values, kind = [row[each.name] for row in given], _KINDS.get(str(each.type))
        numbers = np.array(["nan" if value == "" else value for value in values])
        columns[each.name] = numbers.astype(kind) if kind else [str(value) for value in values]
    return Failures(**columns)
