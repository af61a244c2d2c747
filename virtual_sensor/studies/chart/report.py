"""The chart as files: tables, pictures, and a page that holds all of it."""

from __future__ import annotations

from html import escape
from pathlib import Path
from typing import Any

import numpy as np

from virtual_sensor.files import RESULTS_SIGN, folder_written_whole, written_whole
from virtual_sensor.studies.chart.chart import PANELS, Chart
from virtual_sensor.studies.chart.drawing import PICTURE, draw_chart, label
from virtual_sensor.studies.chart.rows import (
    FAILURES,
    RUNGS,
    SCALINGS,
    failure_columns,
    rung_columns,
    scaling_columns,
)
from virtual_sensor.studies.chart.rung import Rung
from virtual_sensor.studies.pages import html_head, html_table, told_time
from virtual_sensor.studies.tables import write_csv, write_json

PAGE = "index.html"
FRONT_TABLE = "front.md"
_MACHINE = ("processor", "threads", "variant")

_HOW = (
    "Each rung's time is the median of several runs of the whole work, warmed up before, with"
    " Dr.Jit's threads waited for; a rung that takes long is run less often. Errors are against"
    " closed-form rays where there are some, and else against float64 at its finest: each row"
    " names its reference. One pixel is 22 µm on the part, on a film of 2048 px. The front holds"
    " the rungs that no other beats in both time and error; what fails in 1 % of its items more"
    " often than the most reliable rung is not on it."
)


def save_chart(chart: Chart, folder: Path, overwrite: bool = False) -> None:
    """Write tables, pictures and page; all of them or none.

    Raises
    ------
    InputError
        If the folder exists (and `overwrite` is not set) or can't be written.
    """
    front = [rung for name in chart.panels for rung in chart.front(name)]
    with folder_written_whole(folder, overwrite) as place:
        write_csv(place / RUNGS, rung_columns(chart.rungs, front))
        write_csv(place / FAILURES, failure_columns(chart.failures))
        write_csv(place / SCALINGS, scaling_columns(chart.scalings))
        draw_chart(chart, place)
        for name, text in (
            (PAGE, page(chart)),
            (FRONT_TABLE, front_table(chart)),
        ):
            with written_whole(place / name) as temporary:
                temporary.write_text(text, encoding="utf-8")
        write_json(place / RESULTS_SIGN, summary(chart))


def summary(chart: Chart) -> dict[str, Any]:
    """The fronts, the failures and the machine, for `summary.json`."""
    return {
        "machine": chart.machine,
        "notes": chart.notes,
        "fronts": {
            name: [
                {
                    "rung": label(rung, chart.of(name)),
                    "error, px": rung.error_px,
                    "largest, px": rung.largest_px,
                    "seconds": rung.seconds,
                }
                for rung in chart.front(name)
            ]
            for name in chart.panels
        },
        "exponents": {
            s.name: s.exponent if np.isfinite(s.exponent) else None for s in chart.scalings
        },
        "failures": {f"{f.what}: {f.method}": f.first_at or "never" for f in chart.failures},
        "seconds": round(chart.seconds, 1),
    }


def told_number(value: float, unit: str) -> str:
    """An error with two digits; nothing where there is none."""
    return f"{value:.2g} {unit}" if np.isfinite(value) else ""


def front_rows(chart: Chart, panel: str) -> list[list[str]]:
    """The front of a panel as words: rung, error in px and um, the largest, time."""
    return [
        [label(r, chart.of(panel)), *_errors(r), told_time(r.seconds)] for r in chart.front(panel)
    ]


FRONT_HEAD = ["rung", "error, rms", "on the part", "largest", "time"]


def front_table(chart: Chart) -> str:
    """The main front of each panel in Markdown, as the README shows it."""
    lines = ["| job | the fastest way to this error | error, rms | largest | time |"]
    lines.append("|---|---|---|---|---|")
    for name in chart.panels:
        front = next(iter(chart.fronts(name).values()))
        for number, r in enumerate(front):
            title = "" if number else PANELS[name].title
            error, _, largest = _errors(r)
            way = label(r, chart.of(name))
            each = f"{told_time(r.seconds)} a {PANELS[name].counted}"
            lines.append(f"| {title} | {way} | {error} | {largest} | {each} |")
    lines += [
        "",
        f"Made by `virtual-sensor chart` in {chart.seconds:.0f} s; "
        + ", ".join(f"{name} {chart.machine.get(name, 'unknown')}" for name in _MACHINE)
        + ".",
    ]
    return "\n".join(lines) + "\n"


def _errors(rung: Rung) -> list[str]:
    return [
        told_number(rung.error_px, "px"),
        told_number(rung.error_um, "µm"),
        told_number(rung.largest_px, "px"),
    ]


def page(chart: Chart) -> str:
    """The page as HTML; its pictures lie beside it."""
    parts = [
        *html_head("Speed against accuracy"),
        *(f"<p><b>{escape(words)}</b></p>" for words in chart.notes),
        f'<img src="{PICTURE}" alt="all panels: error over time">',
        "<h2>How it was measured</h2>",
        f"<p>{escape(_HOW)}</p>",
        html_table(["", ""], [[name, fact] for name, fact in chart.machine.items()]),
    ]
    for name in chart.panels:
        parts += _panel(chart, name)
    parts += [
        "<h2>Where methods fail</h2>",
        "<p>Each trouble was made worse step by step, up to where the method first failed. No line"
        " here is a plausible wrong number that nobody tells of: a status says which ray, pixel or"
        " column it is, or the line says that none can.</p>",
        html_table(
            ["trouble", "method", "first fails at", "tried", "how it is told", "failed", "note"],
            [
                [
                    f.what,
                    f.method,
                    f.first_at or "never within what was tried",
                    f.tried,
                    f.status,
                    f"{f.failed} of {f.of}" if f.of else "",
                    f.note,
                ]
                for f in chart.failures
            ],
        ),
    ]
    if chart.scalings:
        parts += [
            "<h2>How the time grows</h2>",
            "<p>Time goes as size to the power of the exponent.</p>",
            html_table(
                ["time of a", "exponent", "size: seconds", "note"],
                [
                    [
                        s.name,
                        f"{s.exponent:.2f}" if np.isfinite(s.exponent) else "",
                        ", ".join(f"{size:g}: {seconds:.3g}" for size, seconds in s.points),
                        s.note,
                    ]
                    for s in chart.scalings
                ],
            ),
        ]
    parts += [f"<p>Measured in {chart.seconds:.0f} s.</p>", "</body></html>"]
    return "\n".join(parts) + "\n"


def _panel(chart: Chart, name: str) -> list[str]:
    """A panel's picture and all its rungs, the most accurate first, the front's in bold."""
    front, panel = chart.front(name), PANELS[name]
    rungs = sorted(chart.of(name), key=lambda r: (not np.isfinite(r.error_px), r.error_px))
    references = dict.fromkeys(r.reference for r in rungs)
    rows = [
        [
            r.name,
            ", ".join(f"{key} {value}" for key, value in r.settings.items()),
            *_errors(r),
            told_time(r.seconds),
            f"{r.failed} of {r.items}" if r.failed else "",
            r.reference if len(references) > 1 else "",
            r.note,
        ]
        for r in rungs
    ]
    head = [
        "rung",
        "settings",
        "error, rms",
        "on the part",
        "largest",
        f"time of a {panel.counted}",
    ]
    return [
        f"<h2>{escape(panel.title)}</h2>",
        f'<img src="{name}.png" alt="{escape(panel.title)}: error over time">',
        "<p>Errors are against: " + escape("; ".join(references)) + ".</p>",
        html_table([*head, "failed", "against", "note"], rows, [r in front for r in rungs]),
    ]
