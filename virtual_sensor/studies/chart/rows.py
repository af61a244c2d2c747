"""The chart's tables as files: rungs, failures and scalings as CSV, and rungs read back."""

from __future__ import annotations

import csv
import json
from collections.abc import Sequence
from dataclasses import fields
from pathlib import Path
from typing import Any

import numpy as np

from virtual_sensor.errors import InputError
from virtual_sensor.studies.chart.rung import Failure, Rung, Scaling

RUNGS, FAILURES, SCALINGS = "rungs.csv", "failures.csv", "scaling.csv"

_NUMBERS = ("error_px", "largest_px", "error_um", "seconds")
_COUNTS = ("items", "failed")


def rung_columns(rungs: Sequence[Rung], front: Sequence[Rung]) -> dict[str, list[Any]]:
    """One row for each rung; ``settings`` is JSON, ``on_front`` yes or no."""
    columns: dict[str, list[Any]] = {
        f.name: [getattr(rung, f.name) for rung in rungs] for f in fields(Rung)
    }
    columns["settings"] = [json.dumps(s, default=_plain) for s in columns["settings"]]
    columns["on_front"] = ["yes" if rung in front else "no" for rung in rungs]
    return columns


def failure_columns(failures: Sequence[Failure]) -> dict[str, list[Any]]:
    """One row for each failure."""
    return {f.name: [getattr(failure, f.name) for failure in failures] for f in fields(Failure)}


def scaling_columns(scalings: Sequence[Scaling]) -> dict[str, list[Any]]:
    """One row for each size; the fitted exponent stands in all rows of its task."""
    rows = [(s, size, seconds) for s in scalings for size, seconds in s.points]
    return {
        "name": [s.name for s, _, _ in rows],
        "size": [size for _, size, _ in rows],
        "seconds": [seconds for _, _, seconds in rows],
        "exponent": [s.exponent for s, _, _ in rows],
        "note": [s.note for s, _, _ in rows],
    }


def read_rungs(path: Path) -> list[Rung]:
    """The rungs of a file that `rung_columns` was written to.

    Raises
    ------
    InputError
        If it can't be read, or is no such file.
    """
    try:
        with path.open(encoding="utf-8", newline="") as file:
            return [_rung(row) for row in csv.DictReader(file)]
    except (OSError, KeyError, ValueError) as error:
        raise InputError(f"{path}: can't be read as a table of rungs ({error})") from None


def _rung(row: dict[str, str]) -> Rung:
    values: dict[str, Any] = {f.name: row[f.name] for f in fields(Rung)}
    values["settings"] = json.loads(row["settings"])
    values |= {name: float(row[name] or "nan") for name in _NUMBERS}
    values |= {name: int(row[name]) for name in _COUNTS}
    return Rung(**values)


def _plain(value: Any) -> Any:
    """A NumPy number or array, or whatever it is, as JSON has it."""
    return value.tolist() if isinstance(value, (np.generic, np.ndarray)) else str(value)
