"""A sweep's results: one tidy table over all cases, a picture, a summary."""

from collections.abc import Sequence
from pathlib import Path
from typing import Any

import numpy as np
from matplotlib.figure import Figure

from virtual_sensor.files import RESULTS_SIGN, written_whole
from virtual_sensor.studies.finished_cases import fingerprint
from virtual_sensor.studies.sweep import (
    CaseStatus,
    Finished,
    differing,
    program_notes,
    sweep_notes,
    table,
)
from virtual_sensor.studies.tables import write_csv, write_json

_MAIN = "largest_B_m-A_m_um"
_LEGEND = 16  # more names would cover the curves


def save_sweep(finished: Sequence[Finished], folder: Path) -> dict[str, list[Any]]:
    """Write ``sweep.csv``, ``sweep.png`` and, last, ``summary.json`` beside the cases.

    The table holds no times: the same cases give the same bytes.

    Returns
    -------
    dict
        The table's columns (see `table`).

    Raises
    ------
    InputError
        If a case's summary can't be read, or the files can't be written.
    """
    columns = table(finished, folder)
    swept = differing([end.case for end in finished])
    write_csv(folder / "sweep.csv", columns)
    draw_sweep(columns, swept, folder / "sweep.png")
    failed = {end.case.name: end.message for end in finished if end.status == CaseStatus.FAILED}
    names = [end.case.name for end in finished]
    summary = {
        "scene": finished[0].case.scene if finished else None,
        "swept": {name: list(dict.fromkeys(columns[name])) for name in swept},
        "cases": len(finished),
        "failed": failed,
        "nothing found": [
            name
            for name, status in zip(names, columns["status"], strict=True)
            if status == CaseStatus.NOTHING_FOUND
        ],
        "notes": [*program_notes(finished, folder), *sweep_notes(finished, columns)],
        "program": fingerprint(),
    }
    write_json(folder / RESULTS_SIGN, summary)
    return columns


def draw_sweep(columns: dict[str, list[Any]], swept: Sequence[str], path: Path) -> None:
    """Draw the line's shift by the hot air, and rendered minus searched, over the first parameter.

    One curve for each combination of the other parameters' values.
    """
    figure = Figure(figsize=(11.0, 4.6), dpi=110, layout="constrained")
    shift, apart = figure.subplots(1, 2)
    first, others = (swept[0] if swept else None), swept[1:]
    places, labels = _places(columns[first] if first else ["the scene"] * len(columns["status"]))
    curves: dict[tuple[str, ...], list[int]] = {}
    for i in range(len(places)):
        curves.setdefault(tuple(columns[name][i] for name in others), []).append(i)
    for values, rows in curves.items():
        at = sorted(rows, key=places.__getitem__)
        x = [places[i] for i in at]
        words = ", ".join(f"{name}={value}" for name, value in zip(others, values, strict=True))
        [line] = shift.plot(x, [columns[_MAIN][i] for i in at], "o-", ms=4, label=words or None)
        for name, style in (("hot", "o-"), ("cold", "s:")):
            y = np.array([_apart(columns, name, i) for i in at])
            if np.isfinite(y).any():
                label = f"{words} {name}".strip()
                apart.plot(x, y, style, ms=4, lw=1.0, color=line.get_color(), label=label)
    for axes in (shift, apart):
        axes.set_xlabel(first or "")
        if labels:
            axes.set_xticks(range(len(labels)), labels)
        axes.set_ylim(bottom=0.0)
        axes.grid(alpha=0.3)
    shift.set(
        title="Probe rays: how far hot air moves the point",
        ylabel="largest |B$_m$ - A$_m$| in µm",
    )
    apart.set(title="Rendered minus ray search (dots: largest)", ylabel="rms in px")
    for axes in (shift, apart):
        labelled = axes.get_legend_handles_labels()[1]
        if 0 < len(labelled) <= _LEGEND:
            axes.legend(fontsize=7)
    with written_whole(path) as temporary:
        figure.savefig(temporary, format="png")


def _apart(columns: dict[str, list[Any]], state: str, row: int) -> float:
    dots = (columns[f"{state}_dots_largest_{axis}_px"][row] for axis in "uv")
    line = columns[f"{state}_line_rms_px"][row]
    return float(line if np.isfinite(line) else max(dots))


def _places(values: Sequence[str]) -> tuple[list[float], list[str]]:
    """Where values stand on an axis: numbers at themselves, words one by one under their labels."""
    try:
        return [float(value) for value in values], []
    except ValueError:
        words = list(dict.fromkeys(values))
        return [float(words.index(value)) for value in values], [word[-24:] for word in words]
