"""The reproduction as files: figures, tables, and a page that sets them beside the paper."""

from __future__ import annotations

from collections.abc import Iterable, Mapping, Sequence
from pathlib import Path
from string import ascii_lowercase
from typing import Any

import numpy as np

from virtual_sensor.files import RESULTS_SIGN, folder_written_whole
from virtual_sensor.reporting.files import FileOf, write_results
from virtual_sensor.reporting.page import PAGE, Content, Details, Listing, Page, Paragraph, Section
from virtual_sensor.reporting.pictures import Picture
from virtual_sensor.reporting.reproduction_pictures import (
    FIGURES,
    WHOLE_LINE,
    draw_airs,
    draw_figure,
    draw_fits,
    draw_poses,
    draw_reconstruction,
    figure_columns,
)
from virtual_sensor.reporting.tables import Column, Link, TextTable, text_table
from virtual_sensor.reporting.words import heading, in_words, listed
from virtual_sensor.studies.reproduction.broadening_fit import Fit
from virtual_sensor.studies.reproduction.curves import Curve, Rays, together
from virtual_sensor.studies.reproduction.paper import FITTED, TOLERANCE, StatementTable, Verdict
from virtual_sensor.studies.reproduction.reconstruction import FittedCylinders, Reconstruction
from virtual_sensor.studies.reproduction.reproduce import Reproduction, Summary
from virtual_sensor.studies.reproduction.settings import AIRS, RESOLVED, Setting
from virtual_sensor.studies.sweep_table import SweepTable

COMMAND = "reproduce"
FILES = (
    FileOf(PAGE, "The page to open first."),
    FileOf("figure_*.png", "A figure of the paper's: a column for each air."),
    FileOf("airs.png", "Norms of figure 7 in the three airs."),
    FileOf("whole_line.png", "Both sides of the line."),
    FileOf("all_poses.png", "The whole line from above to the side."),
    FileOf("broadening_fit.png", "How the broadening of the airs was found."),
    FileOf("reconstruction.png", "Cylinders fitted to scans."),
    FileOf("statements.csv", "Every statement of the paper's section 5.", StatementTable),
    FileOf("statements.md", "The same for a README."),
    FileOf("figure_*.csv", "Columns of a diagram of the paper's, in one air.", Rays),
    FileOf("whole_line.csv", "Both sides of the line, in all settings.", Rays),
    FileOf("all_poses_*.csv", "The whole line from above to the side, in one air.", Rays),
    FileOf("reconstruction.csv", "Cylinders fitted to scans.", FittedCylinders),
    FileOf("rendered_sections.csv", "Cylinders through rendered lines.", FittedCylinders),
    FileOf("rendered_minus_searched.csv", "Table of the sweep in measurements/.", SweepTable),
    FileOf(RESULTS_SIGN, "What the reproduction comes to.", Summary),
)
"""What lies in ``report/``."""

_PAPER = Paragraph(
    (
        "The paper measures a hot cylinder by simulation: Beermann, Quentin, Stein, Reithmeier and"
        " Kästner, Full simulation model for laser triangulation measurement in an inhomogeneous"
        " refractive index field, Optical Engineering 57(11), 2018,",
        Link("doi:10.1117/1.OE.57.11.114107", "https://doi.org/10.1117/1.OE.57.11.114107"),
    )
)
_AIRS = (
    "A laminar plume above such a cylinder is narrow, and a mesh that resolves it gives flanks"
    " several times as strong as those of the paper's figures. So each result stands here in three"
    " airs. The width of the Gaussian is fitted to the paper's numbers. The resolved air is our"
    " best knowledge; the other two say what the paper's air must have been like, and that its"
    " deviations are a lower bound."
)
_OF_AIRS = {
    "resolved": "as simulated on a fine mesh",
    "blurred": "the same, smeared by a Gaussian, as a coarse mesh smears it",
    "widened": "stretched across the plume and then smeared, so that its middle stays hotter",
}
_RENDERED = (
    "Lines are the ray search. Open markers are rendered dots, crosses are a rendered line, which"
    " says nothing along itself. Frames are rendered in resolved air, and in the others for 1250 °C"
    " from above. Dashed: the paper's numbers."
)
_MET = f"Numbers are met within {100 * TOLERANCE:g} %, bounds if they hold."
_POSES = (
    "How far the measured point moves at 1250 °C. White lines: 7, 20 and 75 µm, which the paper"
    " states. Grey: not found."
)
_FITS = (
    "The width of each broadened air's blur is fitted to these numbers of the paper's: the sum of"
    " squares of relative residuals is least."
)
_CASES = "A line across itself; dots along (u) and across (v) the line."


def save(result: Reproduction, folder: Path, command: str) -> None:
    """Write ``report/`` into the reproduction's folder, all of it or nothing; an earlier one goes.

    Raises
    ------
    InputError
        If it can't be written.
    """
    curves = result.curves
    pictures = {
        **{figure.name: draw_figure(figure, curves.nine) for figure in FIGURES},
        WHOLE_LINE.name: draw_figure(WHOLE_LINE, curves.whole),
        "airs": draw_airs(curves),
        "all_poses": draw_poses(curves.poses),
        "broadening_fit": draw_fits(result.fits),
        "reconstruction": draw_reconstruction(result.reconstructions),
    }
    drawn = {name: picture for name, picture in pictures.items() if picture}
    contents: dict[str, Any] = {f"{name}.png": picture for name, picture in drawn.items()}
    for air in result.airs:
        for part in dict.fromkeys(d.part for figure in FIGURES for d in figure.diagrams):
            if columns := figure_columns(part, curves, air):
                contents[f"figure_{part}_{air}.csv"] = columns
        if poses := [curve for (at, _), curve in curves.poses.items() if at.air == air]:
            contents[f"all_poses_{air}.csv"] = _lines(poses)
    contents |= {
        "whole_line.csv": _lines(curves.whole.values()),
        "reconstruction.csv": result.cylinders,
        "rendered_sections.csv": result.sections,
        "rendered_minus_searched.csv": result.measured,
        "statements.csv": statement_table(result.verdicts),
        "statements.md": markdown(result),
    }
    tables = [name for name in contents if name.startswith("figure_") and name.endswith(".csv")]
    contents |= {PAGE: page(result, drawn, tables, command), RESULTS_SIGN: result.summary}
    with folder_written_whole(folder / "report", overwrite=True) as place:
        write_results(place, FILES, contents)


def _lines(curves: Iterable[Curve]) -> dict[str, Any]:
    """Columns of whole lines, setting by setting."""
    setting = ("air", "temperature_c", "beta_deg")
    rays = together(curve.rays() for curve in curves)
    return rays.columns_of(*setting, "y_mm", "measured_shift_um", "pixel_shift_px")


def statement_table(verdicts: Sequence[Verdict]) -> StatementTable:
    """The statements as a file holds them."""
    found = {air: [v.found[air].words for v in verdicts] for air in AIRS}
    met = {f"{air}_met": [str(v.found[air].met).lower() for v in verdicts] for air in AIRS}
    return StatementTable(
        where=[v.statement.where for v in verdicts],
        statement=[v.statement.claim for v in verdicts],
        paper=[v.statement.paper for v in verdicts],
        verdict=[v.words for v in verdicts],
        why=[v.why for v in verdicts],
        **found,
        **met,
    )


def table(result: Reproduction, verdict_first: bool = False) -> tuple[TextTable, list[str]]:
    """The table of statements, and the reasons that its letters stand for.

    Ours has a sign for whether it bears the paper out.
    """
    reasons = list(dict.fromkeys(v.why for v in result.verdicts if v.why))
    airs = [
        f"ours, {air}" + (f" ({words})" if air != RESOLVED and not verdict_first else "")
        for air, words in result.summary.airs.items()
    ]
    head = ["section, figure", "what the paper states", "the paper", *airs, "verdict"]
    rows = []
    for v in result.verdicts:
        met = [air for air, found in v.found.items() if found.met]
        letter = f" ({ascii_lowercase[reasons.index(v.why)]})" if v.why else ""
        short = f"only {' and '.join(met)}" if v.words.startswith("met in") else v.words
        ours = [f"{'✓' if found.met else '✗'} {found.words}" for found in v.found.values()]
        verdict = (short if verdict_first else v.words) + letter
        stated = v.statement
        rows.append([stated.where, stated.claim, stated.paper, *ours, verdict])
    if verdict_first:
        head, *rows = ([row[-1], *row[1:-1], row[0]] for row in (head, *rows))
    text = TextTable(tuple(head), tuple(map(tuple, rows)))
    return text, [f"({ascii_lowercase[i]}) {reason}." for i, reason in enumerate(reasons)]


def markdown(result: Reproduction) -> str:
    """The table of statements for a README."""
    statements, reasons = table(result)
    met = ", ".join(f"{number} {air}" for air, number in result.summary.met.items())
    return "\n".join(
        [
            statements.markdown(),
            *(reason.replace("|", "\\|") + "  " for reason in reasons),
            "",
            f"Of {len(result.verdicts)} statements our air bears out: {met}. Made by"
            f" `virtual-sensor reproduce`. {_MET}\n",
        ]
    )


def page(
    result: Reproduction, pictures: Mapping[str, Picture], tables: Sequence[str], command: str
) -> Page:
    """The page that sets all beside the paper; `tables` are the figures' files beside it."""
    summary, scans = result.summary, result.reconstructions
    apart = summary.rendered_minus_searched
    statements, reasons = table(result, verdict_first=True)
    airs = [
        f"{air}: {_OF_AIRS[air]}" + (f" ({words})" if air != RESOLVED else "")
        for air, words in summary.airs.items()
    ]
    figures = [each for each in (*FIGURES, WHOLE_LINE) if each.name in pictures]
    links = Listing(tuple(Link(name, name) for name in tables))
    fits = fit_table(result.fits)
    answer, cylinders = cylinder_answer(scans), cylinder_table(scans)
    rendered = [_agreement(result.measured, kind) for kind in ("line", "dots")]
    sections: dict[str, tuple[Content, ...]] = {
        "Three airs": (_PAPER, _AIRS, Listing(tuple(airs)), pictures["airs"]),
        "What the paper states, and what we find": (_MET, statements, Listing(tuple(reasons))),
        "How to read the figures": (_RENDERED,),
        **{figure.title: (figure.words, pictures[figure.name]) for figure in figures},
        "Beyond the paper: all poses, from above to the side": (_POSES, pictures["all_poses"]),
        "How broad the paper's plume was": (_FITS, fits, pictures["broadening_fit"]),
        "Does a hot cylinder measure too small?": (answer, cylinders, pictures["reconstruction"]),
        "Rendered minus searched, case by case": (_CASES, *rendered),
        "The figures as tables": (Details(f"All {len(tables)}", (links,)),),
    }
    met = [f"{number} in {air} air" for air, number in summary.met.items()]
    return Page(
        "Section 5 of Beermann et al. 2018, remade",
        f"Of the paper's {summary.statements} statements our simulation bears out {listed(met)}."
        " Rendered frames and ray search agree to"
        f" {in_words(apart.line_rms_px)} px rms across the line, and to"
        f" {in_words(max(apart.dots_u_px, apart.dots_v_px))} px in dots.",
        tuple(Section(title, *content) for title, content in sections.items()),
        command,
        {"versions": summary.made_with, "cases measured now": summary.made_now},
        tuple(summary.notes),
    )


def on_console(result: Reproduction) -> list[TextTable | str]:
    """What the command prints: how many statements are borne out, whether both methods agree."""
    summary = result.summary
    met = ((air, summary.airs[air], f"{number}") for air, number in summary.met.items())
    apart = vars(summary.rendered_minus_searched)
    return [
        TextTable(("air", "", f"of {summary.statements} statements borne out"), tuple(met)),
        *(f"rendered minus searched, {heading(n)}: {in_words(v)}" for n, v in apart.items()),
        cylinder_answer(result.reconstructions),
        cylinder_table(result.reconstructions, narrow=True),
        f"{summary.made_now} of {summary.cases} cases measured now",
    ]


def fit_table(fits: Mapping[str, Fit]) -> TextTable:
    """The numbers that the broadening is fitted to: the paper's and ours in each air."""
    head = ("number", "the paper", RESOLVED, *fits)
    rows = []
    for i, statement in enumerate(FITTED):
        cells = [statement.claim, statement.paper, f"{next(iter(fits.values())).resolved[i]:.3g}"]
        for fit in fits.values():
            apart, words = fit.residual[i], in_words(fit.ours[i], "{:.3g}", "unknown")
            words += f" ({100.0 * apart:+.0f} %)" if apart else ""
            words = "unknown" if np.isnan(apart) else words
            cells.append(f"{'✓' if statement.met(fit.ours[i]) else '✗'} {words}")
        rows.append(tuple(cells))
    return TextTable(head, tuple(rows))


def cylinder_answer(results: Mapping[Setting, Reconstruction]) -> str:
    """Whether a hot cylinder measures too small, seen from above."""
    above = [result for setting, result in results.items() if setting.beta_deg == 0.0]
    small = sum(bool(result.interval_um[-1, 1, 1] < 0.0) for result in above)
    return (
        f"Seen from above, the hot cylinder measures too small in {small} of {len(above)} scans:"
        " the 95 % interval of its radius' error lies below 0."
    )


def cylinder_table(results: Mapping[Setting, Reconstruction], narrow: bool = False) -> TextTable:
    """The same in each setting, by the interval of the widest arc; `narrow` has that arc alone."""
    rows: list[dict[str, Any]] = []
    for setting, result in results.items():
        low, high = result.interval_um[-1, 1]
        errors = result.error_um[:, 1]
        answer = "yes" if high < 0.0 else "too large" if low > 0.0 else "not for sure"
        rows.append(
            vars(setting)
            | {f"arc {arc:g}": error for arc, error in zip(result.arc_mm, errors, strict=True)}
            | {
                "answer": "no fit" if np.isnan(low) else answer,
                "interval": "" if np.isnan(low) else f"{low:+.1f} to {high:+.1f}",
                "std": result.residual_std_um[-1, 1],
            }
        )
    widest, *arcs = [
        Column(f"arc {arc:g}", f"|y| ≤ {arc:g} mm", "{:+.1f}", "no fit")
        for arc in reversed(next(iter(results.values())).arc_mm)
    ]
    columns = [
        Column("air"),
        Column("temperature_c", "°C", "{:g}"),
        Column("beta_deg", "β in °", "{:g}"),
        Column("answer", "too small?"),
        widest,
        Column("interval", "95 % interval"),
        *([] if narrow else [*arcs, Column("std", "residual, std", "{:.1f}")]),
    ]
    return text_table(rows, columns, "Fitted minus true radius of the hot cylinder in µm")


def _agreement(measured: SweepTable, kind: str) -> TextTable:
    """What the sweep's table says of rendered lines or dots."""
    rows = [
        row | {"case": Path(str(row["folder"])).name.rsplit("-", 2)[0]} for row in measured.rows()
    ]
    names = [name for name in rows[0] if f"_{kind}_" in name and name.endswith("_px")]
    columns = [Column(name, heading(name.replace(f"_{kind}", "")), "{:.4f}") for name in names]
    known = [row for row in rows if np.isfinite([row[name] for name in names]).any()]
    return text_table(known, ["case", *columns], f"Rendered {kind} minus ray search")
