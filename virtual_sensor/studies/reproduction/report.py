"""The reproduction as files: figures, tables, and a page that sets them beside the paper."""

from __future__ import annotations

from collections.abc import Sequence
from html import escape
from pathlib import Path
from string import ascii_lowercase
from typing import Any

import numpy as np
from numpy.typing import NDArray

from virtual_sensor.files import RESULTS_SIGN, folder_written_whole, written_whole
from virtual_sensor.metrology.deviation import euclidean
from virtual_sensor.studies.reproduction.beta_map import BetaMap
from virtual_sensor.studies.reproduction.curves import (
    BLURRED,
    DOTS,
    RESOLVED,
    SEARCHED,
    WIDENED,
    Curve,
    Curves,
)
from virtual_sensor.studies.reproduction.drawing import draw_figures
from virtual_sensor.studies.reproduction.extra_drawing import (
    draw_beta_map,
    draw_fit,
    draw_reconstruction,
    draw_whole_line,
)
from virtual_sensor.studies.reproduction.figures import write_figures
from virtual_sensor.studies.reproduction.reconstruction import columns as reconstruction_columns
from virtual_sensor.studies.reproduction.reconstruction import told as reconstruction_told
from virtual_sensor.studies.reproduction.reproduce import Reproduction, worst
from virtual_sensor.studies.reproduction.statements import Verdict
from virtual_sensor.studies.tables import in_words, write_csv, write_json

Array = NDArray[np.float64]

PAGE = "report.html"
PAPER = "Beermann et al. 2018 (https://doi.org/10.1117/1.OE.57.11.114107)"

WHY_BROADENED = (
    "A laminar plume above such a cylinder is narrow, and a mesh that resolves it gives flanks"
    " several times as strong as the paper's figures tell of. So each result stands here in three"
    " airs: resolved, as simulated on a fine mesh; blurred, the same smeared by a Gaussian, as a"
    " coarse mesh smears it; and widened, stretched across the plume and then smeared, so that its"
    " middle stays hotter. The Gaussian's width is fitted to the paper's numbers. The resolved air"
    " is our best knowledge; the other two tell what the paper's air must have been like, and that"
    " its deviations are a lower bound."
)


def save_reproduction(result: Reproduction, folder: Path) -> dict[str, Any]:
    """Write ``report/`` into the reproduction's folder, all of it or nothing; an earlier one goes.

    Returns
    -------
    dict
        The summary.

    Raises
    ------
    InputError
        If it can't be written.
    """
    widths = {air: str(broadening) for air, broadening in result.airs.items()}
    figures = summary(result)
    with folder_written_whole(folder / "report", overwrite=True) as place:
        write_figures(result.curves, list(result.airs), place)
        draw_figures(result.curves, list(result.airs), place, widths)
        draw_whole_line(result.curves, place / "whole_line.png")
        draw_beta_map(result.maps, place / "all_poses.png")
        draw_fit(result.fits, place / "broadening_fit.png")
        draw_reconstruction(result.reconstructions, place / "reconstruction.png")
        write_csv(place / "reconstruction.csv", reconstruction_columns(result.reconstructions))
        write_csv(place / "rendered_sections.csv", result.sections)
        write_csv(place / "whole_line.csv", _whole_line_columns(result.curves))
        for air, each in result.maps.items():
            write_csv(place / f"all_poses_{air}.csv", _map_columns(each))
        write_csv(place / "statements.csv", _statement_columns(result.verdicts))
        write_csv(place / "rendered_minus_searched.csv", result.measured)
        for name, text in (
            ("statements.md", markdown_table(result)),
            (PAGE, page(result, figures, sorted(p.name for p in place.glob("*.png")))),
        ):
            with written_whole(place / name) as temporary:
                temporary.write_text(text, encoding="utf-8")
        write_json(place / RESULTS_SIGN, figures)
    return figures


def summary(result: Reproduction) -> dict[str, Any]:
    """What the reproduction comes to."""
    measured = result.measured
    kept = {air: sum(v.found[air].met for v in result.verdicts) for air in result.airs}
    return {
        "statements": len(result.verdicts),
        "borne out": kept,
        "not borne out": {
            air: [v.statement.claim for v in result.verdicts if not v.found[air].met]
            for air in result.airs
        },
        "airs": {air: str(broadening) for air, broadening in result.airs.items()},
        "rendered minus searched, px": {
            "line across itself, worst rms of all cases": worst(
                measured, ["cold_line_rms_px", "hot_line_rms_px"]
            ),
            "dots, largest in u": worst(measured, _dots("u")),
            "dots, largest in v": worst(measured, _dots("v")),
            "dots of the figures, largest": _between_the_curves(result.curves),
        },
        "sum of the separated paths minus the whole, px": max(
            float(np.abs(_left_over(curve)).max()) for curve in result.curves.nine.values()
        ),
        "cylinder fit": reconstruction_told(result.reconstructions).split("  "),
        "notes": [
            f"{Path(folder).name}: {message}"
            for folder, message in zip(measured["folder"], measured["message"], strict=True)
            if message
        ],
        "measured now": result.made,
        "seconds": round(result.seconds, 1),
    }


def _between_the_curves(curves: Curves) -> float:
    """Largest distance of rendered dots from the searched curve that they are drawn beside."""
    return max(
        float(np.abs(getattr(curve, pixel) - getattr(curves.nine[setting, SEARCHED], pixel)).max())
        for (setting, way), curve in curves.nine.items()
        for pixel in ("pixel_A", "pixel_B")
        if way == DOTS
    )


def _dots(axis: str) -> list[str]:
    return [f"{state}_dots_largest_{axis}_px" for state in ("cold", "hot")]


def _left_over(curve: Curve) -> Array:
    """Sum of the paths minus the whole, of a searched curve; a rendered one has its own error."""
    if curve.way != SEARCHED:
        return np.zeros(1)
    paths = curve.paths
    return paths.laser_to_object_px + paths.object_to_camera_px - paths.laser_to_camera_px


def _whole_line_columns(curves: Curves) -> dict[str, Any]:
    """B_m - A_m and the pixel's displacement of all whole lines, one row for each ray."""
    settings, lines = zip(*curves.whole.items(), strict=True)
    moved = np.concatenate([line.exact.measured_um for line in lines])
    pixel = np.concatenate([line.exact.pixel_px for line in lines])
    rays = [len(line.y_mm) for line in lines]
    return {
        "air": np.repeat([setting.air for setting in settings], rays),
        "temperature_c": np.repeat([setting.temperature_c for setting in settings], rays),
        "beta_deg": np.repeat([setting.beta_deg for setting in settings], rays),
        "y_mm": np.concatenate([line.y_mm for line in lines]),
        **_displacements(moved, pixel),
    }


def _displacements(moved_um: Array, pixel_px: Array) -> dict[str, Any]:
    """Columns of displacements of points (N, 3) and pixels (N, 2)."""
    return {
        **{f"d{axis}_um": moved_um[:, i] for i, axis in enumerate("xyz")},
        "d_um": euclidean(moved_um),
        **{f"d{axis}_px": pixel_px[:, i] for i, axis in enumerate("uv")},
    }


def _map_columns(each: BetaMap) -> dict[str, Any]:
    beta, y = (grid.ravel() for grid in np.meshgrid(each.beta_deg, each.y_mm, indexing="ij"))
    moved, pixel = each.measured_um.reshape(-1, 3), each.pixel_px.reshape(-1, 2)
    return {"beta_deg": beta, "y_mm": y, **_displacements(moved, pixel)}


def _statement_columns(verdicts: Sequence[Verdict]) -> dict[str, list[str]]:
    columns = {
        "where": [v.statement.where for v in verdicts],
        "statement": [v.statement.claim for v in verdicts],
        "paper": [v.statement.paper for v in verdicts],
    }
    for air in verdicts[0].found:
        columns[air] = [v.found[air].words for v in verdicts]
        columns[f"{air}_met"] = [str(v.found[air].met).lower() for v in verdicts]
    columns["verdict"] = [v.words for v in verdicts]
    columns["why"] = [v.why for v in verdicts]
    return columns


def _head(result: Reproduction) -> list[str]:
    airs = [
        f"ours, {air}" + (f" ({b})" if air != RESOLVED else "") for air, b in result.airs.items()
    ]
    return ["section, figure", "what the paper states", "the paper", *airs, "verdict"]


def _rows(result: Reproduction) -> tuple[list[list[str]], list[str]]:
    """Cells of the table of statements, and the reasons that its letters stand for.

    Ours has a sign for whether it bears the paper out.
    """
    reasons = list(dict.fromkeys(v.why for v in result.verdicts if v.why))
    rows = [
        [
            v.statement.where,
            v.statement.claim,
            v.statement.paper,
            *(f"{'✓' if found.met else '✗'} {found.words}" for found in v.found.values()),
            v.words + (f" ({ascii_lowercase[reasons.index(v.why)]})" if v.why else ""),
        ]
        for v in result.verdicts
    ]
    return rows, [f"({ascii_lowercase[i]}) {reason}." for i, reason in enumerate(reasons)]


def markdown_table(result: Reproduction) -> str:
    """The table of statements for a README."""
    figures = summary(result)
    head = _head(result)
    rows, reasons = _rows(result)
    cells = [" | ".join(cell.replace("|", "\\|") for cell in row) for row in rows]
    kept = ", ".join(f"{number} {air}" for air, number in figures["borne out"].items())
    lines = [
        "| " + " | ".join(head) + " |",
        "|" + "---|" * len(head),
        *(f"| {row} |" for row in cells),
        "",
        *(line.replace("|", "\\|") + "  " for line in reasons),
        "",
        f"Of {len(rows)} statements our air bears out: {kept}. Made by `virtual-sensor reproduce`;"
        " numbers are met within 15 %, bounds if kept.",
    ]
    return "\n".join(lines) + "\n"


_STYLE = """\
body { font: 15px/1.45 sans-serif; max-width: 76em; margin: 2em auto; padding: 0 1em; color: #222; }
table { border-collapse: collapse; font-size: 13px; }
td, th { border: 1px solid #ccc; padding: 3px 7px; text-align: left; vertical-align: top; }
th { background: #f2f2f2; }
img { max-width: 100%; border: 1px solid #ddd; margin: 0.5em 0 1.5em; }
.no { color: #a02010; }
"""

_CAPTIONS = {
    "figure_6": "Figure 6: how near the paper's search comes to the laser point",
    "figure_7": "Figure 7: incidence points, measured points and pixels, cold and hot",
    "figure_9": "Figure 9: the pixel's displacement, separated by light path",
    "figure_10b": "Figure 10(b): with pixels rounded to 0.25 px",
    "figure_11": "Figure 11: temperatures and poses",
    "broadening_fit": "How broad the paper's plume was: one parameter, fitted to its numbers",
    "whole_line": "Beyond the paper: the whole line, both sides",
    "all_poses": "Beyond the paper: all poses from above (beta = 0) to the side (90 deg)",
    "reconstruction": "The paper's forthcoming work: a cylinder fitted to densely measured points",
}


def page(result: Reproduction, figures: dict[str, Any], pictures: Sequence[str]) -> str:
    """The page that sets all beside the paper, as HTML; its pictures lie beside it."""
    apart = figures["rendered minus searched, px"]
    rows, reasons = _rows(result)
    parts = [
        "<!DOCTYPE html>",
        '<html lang="en"><head><meta charset="utf-8">',
        f"<title>Section 5 remade</title><style>{_STYLE}</style></head><body>",
        "<h1>Section 5 of Beermann et al. 2018, remade</h1>",
        f"<p>{escape(PAPER)}: the virtual measurement of a hot cylinder. Every curve comes from the"
        " ray search and from rendered camera frames.</p>",
        f"<p>{escape(WHY_BROADENED)}</p>",
        "<ul>",
        *(
            f"<li>{escape(air)} ({escape(figures['airs'][air])}): {number} of"
            f" {figures['statements']} statements borne out</li>"
            for air, number in figures["borne out"].items()
        ),
        "<li>rendered and searched: the line across itself to"
        f" {in_words(apart[LINE_RMS])} px rms in the worst case, dots to"
        f" {in_words(apart['dots, largest in u'])} px in u and"
        f" {in_words(apart['dots, largest in v'])} px in v</li>",
        *(f"<li>{escape(line)}</li>" for line in figures["cylinder fit"]),
        "</ul>",
        "<h2>What the paper states, and what we find</h2>",
        _html_table(_head(result), rows),
        *(f"<p>{escape(reason)}</p>" for reason in reasons),
    ]
    for stem, caption in _CAPTIONS.items():
        names = [name for name in pictures if name.startswith(stem)]
        parts.append(f"<h2>{escape(caption)}</h2>")
        for name in sorted(names, key=_by_air):
            parts.append(f'<img src="{escape(name)}" alt="{escape(caption)}">')
    parts += [
        "<h2>Rendered minus searched, case by case</h2>",
        _html_table(*_agreement(result)),
        f"<p>{figures['measured now']} cases measured now, the others kept;"
        f" {figures['seconds']:.0f} s.</p>",
        "</body></html>",
    ]
    return "\n".join(parts) + "\n"


LINE_RMS = "line across itself, worst rms of all cases"


def _by_air(name: str) -> tuple[int, str]:
    order = [RESOLVED, WIDENED, BLURRED]
    return next((i for i, air in enumerate(order) if air in name), 0), name


def _agreement(result: Reproduction) -> tuple[list[str], list[list[str]]]:
    """Rows of the sweep's table that a reader looks at."""
    columns = {name: values for name, values in result.measured.items() if name.endswith("_px")}
    cases = [Path(folder).name.rsplit("-", 1)[0] for folder in result.measured["folder"]]
    cells = [
        ["" if np.isnan(value) else f"{value:.4f}" for value in values]
        for values in zip(*columns.values(), strict=True)
    ]
    head = ["case", *(name.removesuffix("_px").replace("_", " ") + ", px" for name in columns)]
    return head, [[case, *row] for case, row in zip(cases, cells, strict=True)]


def _html_table(head: Sequence[str], rows: Sequence[Sequence[str]]) -> str:
    def cell(text: str) -> str:
        kind = ' class="no"' if text.startswith("✗") else ""
        return f"<td{kind}>{escape(text)}</td>"

    lines = ["<table><tr>" + "".join(f"<th>{escape(text)}</th>" for text in head) + "</tr>"]
    lines += ["<tr>" + "".join(map(cell, row)) + "</tr>" for row in rows]
    return "\n".join([*lines, "</table>"])
