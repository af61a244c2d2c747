"""A trial as files: scores and phases as CSV, charts, and a page that holds all of it."""

from __future__ import annotations

from html import escape
from pathlib import Path
from typing import Any

import numpy as np

from virtual_sensor.files import RESULTS_SIGN, folder_written_whole, written_whole
from virtual_sensor.studies.pages import html_head, html_table, told_time
from virtual_sensor.studies.tables import write_csv, write_json
from virtual_sensor.studies.trial.drawing import chosen_for_front, draw_trial, front
from virtual_sensor.studies.trial.scores import PHASES, Score
from virtual_sensor.studies.trial.trial import Trial

PAGE = "index.html"
TABLE = "table.md"
HEAD = ("detector", "rms, px", "/ bound", "predicted", "outliers", "no centre", "time")
_HOW = (
    "Every detector sees the same images. Clean lines are pixel-integrated Gaussians whose place"
    " wanders over all sub-pixel phases, with Poisson and read noise, one grey value an electron;"
    " the detectors are told the noise and the gain. Outliers are off by more than 0.5 px and six"
    " bounds; they are counted, and are not in the errors. The bound is that of one column, var >="
    " 1/sum((d mu/d x)^2/(mu + sigma_d^2)); a detector that also looks along the line may go below"
    " it. Times are the best of three, on one core, while the other cores do the same. Saturated"
    " lines are clipped at half their height; speckle is of an aperture f/5.6 at 532 nm, 5.5 µm"
    " pixels, light of both polarisations; frames are of the hot cylinder, and their truth is where"
    " the laser's axis meets the surface, in each column."
)


def save_trial(trial: Trial, folder: Path, overwrite: bool = False) -> None:
    """Write tables, charts and page; all of them or none.

    Raises
    ------
    InputError
        If the folder exists (and `overwrite` is not set) or can't be written.
    """
    with folder_written_whole(folder, overwrite) as place:
        write_csv(place / "scores.csv", score_table(trial.scores))
        if trial.phases:
            write_csv(place / "phases.csv", phase_table(trial))
        charts = draw_trial(trial, place)
        summary = {
            "seed": trial.seed,
            "columns": trial.columns,
            "seconds": round(trial.seconds, 1),
            "front": [each.detector for each in front(chosen_for_front(trial))],
            "machine": trial.machine,
        }
        for name, text in (
            (PAGE, page(trial, charts)),
            (TABLE, markdown(trial)),
        ):
            with written_whole(place / name) as temporary:
                temporary.write_text(text, encoding="utf-8")
        write_json(place / RESULTS_SIGN, summary)


def score_table(scores: list[Score]) -> dict[str, list[Any]]:
    """Columns of one row for each detector on each image."""
    of_score = ("bias_px", "std_px", "rms_px", "predicted_px", "bound_px", "outliers", "failures")
    table: dict[str, list[Any]] = {"detector": [each.detector for each in scores]}
    for name in ("kind", "width_px", "column_electrons", "read_noise_electrons"):
        table[name] = [getattr(each.condition, name) for each in scores]
    for name in (*of_score, "columns"):
        table[name] = [getattr(each, name) for each in scores]
    table["us_per_column"] = [1e6 * each.seconds for each in scores]
    return table


def phase_table(trial: Trial) -> dict[str, Any]:
    """Columns of one row for each detector, width and phase."""
    pairs = list(trial.phases)
    return {
        "detector": np.repeat([name for name, _ in pairs], PHASES.size),
        "width_px": np.repeat([width for _, width in pairs], PHASES.size),
        "phase_px": np.tile(PHASES, len(pairs)),
        "bias_px": np.concatenate([trial.phases[pair] for pair in pairs]),
    }


def rows(scores: list[Score]) -> list[list[str]]:
    """What the tables tell of some scores, in words, the most accurate first."""

    def told(value: float, digits: int) -> str:
        return f"{value:.{digits}f}" if np.isfinite(value) else ""

    ordered = sorted(scores, key=lambda s: (not np.isfinite(s.rms_px), s.rms_px))
    return [
        [
            each.detector,
            told(each.rms_px, 4),
            told(each.rms_px / each.bound_px, 2),
            told(each.predicted_px, 4),
            f"{each.outliers:.1%}",
            f"{each.failures:.1%}",
            told_time(each.seconds),
        ]
        for each in ordered
    ]


def markdown(trial: Trial) -> str:
    """The scores on the image of the chart of speed, as the README shows them."""
    scores = chosen_for_front(trial)
    condition = scores[0].condition
    lines = ["| " + " | ".join(HEAD) + " |", "|" + "---|" * len(HEAD)]
    lines += ["| " + " | ".join(row) + " |" for row in rows(scores)]
    lines += [
        "",
        f"Line of {condition.width_px:g} px, {condition.column_electrons:g} electrons a column,"
        f" read noise {condition.read_noise_electrons:g} e; made by `virtual-sensor trial` in"
        f" {trial.seconds:.0f} s.",
    ]
    return "\n".join(lines) + "\n"


def page(trial: Trial, charts: dict[str, str]) -> str:
    """The page as HTML; its charts lie beside it."""
    parts = [*html_head("A trial of line detectors"), f"<p>{escape(_HOW)}</p>"]
    parts += [
        f'<h2>{escape(title)}</h2>\n<img src="{name}" alt="{escape(title)}">'
        for name, title in charts.items()
    ]
    parts += ["<h2>All images</h2>"]
    for condition in dict.fromkeys(each.condition for each in trial.scores):
        own = [each for each in trial.scores if each.condition == condition]
        best = {each.detector for each in front(own)}
        told = rows(own)
        unit = "at the brightest pixel" if "frame" in condition.kind else "a column"
        parts += [
            f"<h3>{escape(condition.kind)}: {condition.width_px:g} px,"
            f" {condition.column_electrons:g} electrons {unit},"
            f" read noise {condition.read_noise_electrons:g} e</h3>",
            html_table(HEAD, told, [row[0] in best for row in told]),
        ]
    facts = {"seed": str(trial.seed), "columns": str(trial.columns), **trial.machine}
    parts += ["<h2>Made with</h2>", html_table(["", ""], [[k, f"{v}"] for k, v in facts.items()])]
    parts += [f"<p>Tried in {trial.seconds:.0f} s.</p>", "</body></html>"]
    return "\n".join(parts) + "\n"
