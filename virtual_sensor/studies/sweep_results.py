"""A sweep's results: one tidy table over all cases, a picture, a summary."""

import json
from collections.abc import Sequence
from pathlib import Path
from typing import Any

import numpy as np
from matplotlib.figure import Figure

from virtual_sensor.errors import InputError
from virtual_sensor.files import RESULTS_SIGN, written_whole
from virtual_sensor.studies.kept import by_other_programs, fingerprint
from virtual_sensor.studies.notes import TRUTH, WRONG
from virtual_sensor.studies.sweep import CASES, CaseStatus, Finished, differing
from virtual_sensor.studies.tables import write_csv, write_json

STATES = ("cold", "hot")
_PROBE_RAYS = {
    f"largest_{d}_um": f"largest |{d.replace('-', ' - ')}|" for d in ("B-A", "B-B_m", "B_m-A_m")
}
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


def program_notes(finished: Sequence[Finished], folder: Path) -> list[str]:
    """What has become of results of another version of the program, or of a package under it."""
    again = sum(end.made_again for end in finished)
    others = len(by_other_programs(folder / CASES))
    replaced = (
        f"{again} cases were measured again, since this program or a package under it has changed;"
        " their earlier results are removed"
    )
    unused = (
        f"{CASES}/ holds {others} results of another version of this program, or of a package under"
        f" it, that were not used; delete what does not end with -{fingerprint()}"
    )
    return [note for count, note in ((again, replaced), (others, unused)) if count]


def sweep_notes(finished: Sequence[Finished], columns: dict[str, list[Any]]) -> list[str]:
    """The notes of all cases that were measured, each after the case's name."""
    return [
        f"{end.case.name}: {message}"
        for end, message in zip(finished, columns["message"], strict=True)
        if message and end.status != CaseStatus.FAILED
    ]


def table(finished: Sequence[Finished], folder: Path) -> dict[str, list[Any]]:
    """Columns of the tidy table, one row for each case.

    The given parameters as they were used; status; of each state the number of centres, those that
    were compared and those that are ok and wrong, and rms and largest distance of rendered from
    searched in px, across the line, or of a laser that makes dots along u and v; how many of the
    probe rays are lit, and their largest differences in um; the case's folder, relative to
    `folder`, and its message.  What a case does not have is NaN.

    Raises
    ------
    InputError
        If a case's summary can't be read.
    """
    given = list(dict.fromkeys(name for end in finished for name in end.case.parameters))
    rows = [_row(end, folder) for end in finished]
    columns: dict[str, list[Any]] = {
        name: [end.case.values.get(name, "") for end in finished] for name in given
    }
    columns["status"] = [_status(end, row).value for end, row in zip(finished, rows, strict=True)]
    for name in _figures({}):
        columns[name] = [row[name] for row in rows]
    columns["folder"] = [_relative(end.folder, folder) for end in finished]
    columns["message"] = [row["message"] for row in rows]
    return columns


def _status(end: Finished, row: dict[str, Any]) -> CaseStatus:
    nothing = not any(row[f"{name}_centres"] > 0.0 for name in STATES)
    return CaseStatus.NOTHING_FOUND if nothing and end.status == CaseStatus.OK else end.status


def _row(end: Finished, folder: Path) -> dict[str, Any]:
    if end.folder is None:
        return {**_figures({}), "message": end.message}
    path = end.folder / RESULTS_SIGN
    try:
        summary = json.loads(path.read_text(encoding="utf-8"))
        return {**_figures(summary), "message": "; ".join(summary["notes"])}
    except (OSError, ValueError, KeyError) as error:
        raise InputError(
            f"{path}: can't be read ({error!r}); delete the case's folder, and it is measured again"
        ) from None


def _figures(summary: dict[str, Any]) -> dict[str, float]:
    """The figures of one case's summary; NaN where it has none."""
    figures: dict[str, float | None] = {}
    for name in STATES:
        state = summary.get("states", {}).get(name, {})
        dots = state.get("rendered dots minus search, px") or {}
        line = {} if dots else state.get("rendered line minus search, px", {})
        figures |= {
            f"{name}_centres": dots.get("found", state.get("line", {}).get("ok")),
            f"{name}_compared": dots.get("found", line.get("columns compared")),
            f"{name}_wrong": state.get(TRUTH, {}).get(WRONG) if line else None,
            f"{name}_line_rms_px": line.get("rms"),
            f"{name}_line_largest_px": line.get("largest"),
            f"{name}_dots_largest_u_px": dots.get("largest in u"),
            f"{name}_dots_largest_v_px": dots.get("largest in v"),
        }
    moved = summary.get("probe_rays_um", {})
    figures["rays_lit"] = summary.get("rays lit")
    figures |= {name: moved.get(key) for name, key in _PROBE_RAYS.items()}
    return {name: np.nan if value is None else value for name, value in figures.items()}


def _relative(path: Path | None, folder: Path) -> str:
    return str(path.relative_to(folder.absolute())) if path else ""


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
