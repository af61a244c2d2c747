"""The convergence study of the air's field: table, picture, page and files."""

from __future__ import annotations

from collections.abc import Sequence
from functools import partial
from pathlib import Path

import numpy as np
from matplotlib.axes import Axes

from virtual_sensor.files import RESULTS_SIGN, folder_written_whole
from virtual_sensor.records import plain, record_columns
from virtual_sensor.reporting.files import FileOf, write_results
from virtual_sensor.reporting.page import PAGE, Details, Page, Section
from virtual_sensor.reporting.pictures import Panel, Picture, draw_picture
from virtual_sensor.reporting.style import (
    BLACK,
    GREEN,
    colour,
    decimal_ticks,
    write_beside,
    write_on_line,
)
from virtual_sensor.reporting.tables import Column, TextTable, text_table
from virtual_sensor.reporting.words import capital, unbroken
from virtual_sensor.studies.convergence import BOUNDS_PX, SHIPPED, Change, Convergence

COMMAND = "field convergence"
FILES = (
    FileOf(PAGE, "Page with the chart and all settings."),
    FileOf("convergence.png", "Change against mesh, flow time, grid and the solver's time."),
    FileOf("convergence.md", "The settings of interest as a table."),
    FileOf("convergence.csv", "The change that each setting makes; the longer run last.", Change),
    FileOf(RESULTS_SIGN, "The settings of interest.", Convergence),
)

_CURVES = (
    ("rays_px", "probe rays", colour("search"), "s"),
    ("line_px", "line", colour("line"), "o"),
)
_SETTINGS = {  # what is varied, its axis, and a value of it
    "cell_mm": ("Mesh", "mesh cell across the plume in mm", "{:g} mm mesh"),
    "time_s": ("Flow time", "flow time in s", "{:g} s of flow"),
    "grid_y_mm": ("Grid", "distance of nodes across the plume in mm", "{:g} mm grid"),
}
_BANDS = ("#E3EFE3", "#F3F8F0")  # within the smaller bound, and the larger one


def save(result: Convergence, folder: Path, command: str, overwrite: bool = False) -> None:
    """Write the study's files (`FILES`), all of them or none.

    Raises
    ------
    InputError
        If the folder exists (and `overwrite` is not set) or can't be written.
    """
    picture = draw(result)
    contents = {
        "convergence.csv": record_columns(Change, (*result.changes, result.longer_run)),
        "convergence.png": picture,
        "convergence.md": markdown(result),
        PAGE: page(result, picture, command),
        RESULTS_SIGN: result,
    }
    with folder_written_whole(folder, overwrite) as place:
        write_results(place, FILES, contents)


# Words and tables


def outcome(result: Convergence) -> list[str]:
    """What the study finds, a sentence each."""
    long, reference = result.longer_run, result.reference
    sentences = []
    for each in result.coarsest:
        found = each.change
        sentences.append(
            f"No coarser setting stays within {each.bound_px:g} px of the finest."
            if found is None
            else f"The line stays within {each.bound_px:g} px of the finest with a mesh of"
            f" {found.cell_mm:g} mm, {found.time_s:g} s of flow and a grid of"
            f" {found.grid_y_mm:g} x {found.grid_z_mm:g} mm: {found.line_px:.2g} px, which are"
            f" {found.points_um:.2g} µm of the measured points (probe rays {found.rays_px:.2g} px;"
            f" solver {found.solver_s:.0f} s, file {found.file_mb:.1f} MB). A line that is seen"
            " through the finest air and corrected through this one is left"
            f" {found.left_surface_um:.2g} µm off the surface."
        )
    sentences.append(
        f"{long.time_s:g} s of flow in place of {reference.time_s:g} s change {long.line_px:.2g} px"
        f" and {long.points_um:.2g} µm ({long.cell_mm:g} mm mesh)."
    )
    return sentences


def table(result: Convergence) -> TextTable:
    """The coarsest settings within the bounds, the shipped fields' setting, the longer run."""
    rows = {f"coarsest within {each.bound_px:g} px": each.change for each in result.coarsest}
    rows["as the shipped fields"] = result.shipped
    rows[f"against {result.reference.time_s:g} s on the same mesh"] = result.longer_run
    return _table([(name, change) for name, change in rows.items() if change])


def _table(rows: Sequence[tuple[str, Change]], caption: str = "") -> TextTable:
    columns = (
        Column("name", " "),
        Column("cell_mm", "mesh cell", "{:g} mm"),
        Column("time_s", "flow time", "{:g} s"),
        Column("grid", "field grid y x z"),
        Column("line_px", "line, across itself", "{:.2g} px"),
        Column("rays_px", "probe rays, both axes", "{:.2g} px"),
        Column("points_um", "points", "{:.3g} µm"),
        Column("left_surface_um", "left on the surface", "{:.3g} µm"),
        Column("left_points_um", "left of the points", "{:.3g} µm"),
        Column("solver_s", "solver", "{:.1f} s"),
        Column("file_mb", "file", "{:.1f} MB"),
    )
    shown = [
        {"name": name, "grid": unbroken(f"{c.grid_y_mm:g} x {c.grid_z_mm:g} mm")} | plain(c)
        for name, c in rows
    ]
    return text_table(shown, columns if any(name for name, _ in rows) else columns[1:], caption)


def markdown(result: Convergence) -> str:
    """The table as a page's part."""
    return (
        f"{table(result).markdown()}\nMade by `virtual-sensor {COMMAND}`: {_conditions(result)}\n"
    )


def _conditions(result: Convergence) -> str:
    reference = result.reference
    return (
        f"sections of a cylinder of {result.temperature_c:g} °C, compared with a mesh of"
        f" {reference.cell_mm:g} mm, {reference.time_s:g} s of flow and a grid of"
        f" {reference.grid_y_mm:g} x {reference.grid_z_mm:g} mm. Changes are the largest; the"
        " coarsest is chosen by the line's. Left: of a line that is seen through the finest air and"
        " corrected through this one, its points' distance from the surface, and from the points"
        " that were lit. Solver: on one core, up to this flow time. File: of a"
        " three-dimensional field."
    )


def page(result: Convergence, picture: Picture, command: str) -> Page:
    """The page: what suffices, the chart, and every setting."""
    settings = _table(
        [("", change) for change in result.changes],
        "All settings, against the finest one, which is the last",
    )
    return Page(
        title="Convergence of the air's field",
        lead=outcome(result)[-2],
        sections=(
            Section("What suffices", table(result), *outcome(result), capital(_conditions(result))),
            Section("Mesh, flow time and grid", picture),
            Section("Every setting", Details(f"All {len(result.changes)}", (settings,))),
        ),
        command=command,
        made_with=result.made_with,
        notes=result.notes,
    )


# Picture


def draw(result: Convergence) -> Picture:
    """Change against mesh, flow time and grid, each with the others finest; and against time."""
    panels = []
    for name, (what, label, _) in _SETTINGS.items():
        others = {each: getattr(result.reference, each) for each in _SETTINGS if each != name}
        changes = [c for c in result.changes if others.items() <= vars(c).items()]
        kept = ", ".join(_SETTINGS[each][2].format(value) for each, value in others.items())
        title = f"{what} ({kept})"
        panels.append(
            Panel(
                title,
                partial(_draw_changes, name=name, changes=changes, scale=_um_per_px(result)),
                f"{title}: change of the line and of the probe rays in px over the {label}.",
            )
        )
    panels.append(
        Panel(
            "What it costs (finest grid)",
            partial(_draw_cost, result=result),
            "Change of the line in px over the solver's time in s, a curve for each mesh.",
        )
    )
    return draw_picture(
        f"Convergence of the air's field at {result.temperature_c:g} °C: change of what the sensor"
        " sees, at most, against the finest setting",
        panels,
    )


def _draw_changes(axes: Axes, name: str, changes: Sequence[Change], scale: float) -> None:
    """Curves of the line and the probe rays, with the bounds; the shipped fields' value marked.

    `scale` is the change of the points, um, for a change of the line of 1 px.
    """
    places = np.array([getattr(c, name) for c in changes])
    axes.set(xscale="log", yscale="log", xlabel=_SETTINGS[name][1], ylabel="change in px")
    axes.set_xticks(places, [f"{p:g}" for p in places])
    axes.minorticks_off()
    axes.set_xlim(0.88 * places.min(), 1.14 * places.max())
    axes.margins(y=0.15)
    middle = np.sqrt(np.prod(axes.get_xlim()))
    tops = []
    for of, words, shade, marker in _CURVES:
        values = np.array([getattr(c, of) for c in changes])
        known = values > 0.0  # the finest changes nothing
        axes.plot(places[known], values[known], marker + "-", color=shade)
        if known.any():
            tops.append((values.max(), places[values.argmax()], words, shade))
    # Names of curves at their highest points, one above the other where they come close.
    tops.sort(reverse=True)
    close = len(tops) > 1 and tops[0][0] < 3.0 * tops[1][0]
    for (top, place, words, shade), up in zip(tops, (12, -12) if close else (9, 9), strict=False):
        style = {"color": shade, "fontweight": "bold", "fontsize": 10.0}
        write_beside(axes, words, (place, top), (10 if place < middle else -10, up), **style)
    shipped = getattr(SHIPPED, name)
    if shipped in places:
        axes.axvline(shipped, color=GREEN, lw=1.0, ls=":")
        at, side = (shipped, 0.03), "right" if shipped > middle else "left"
        style = {"color": GREEN, "va": "bottom", "ha": side, "fontsize": 9.5}
        axes.text(*at, " shipped fields ", transform=axes.get_xaxis_transform(), **style)
    _draw_bounds(axes)
    of_points = axes.secondary_yaxis("right", functions=(lambda v: v * scale, lambda v: v / scale))
    of_points.set_ylabel("change of the points in µm")
    decimal_ticks(of_points.yaxis)


def _draw_cost(axes: Axes, result: Convergence) -> None:
    """Change over the solver's time, a curve for each mesh; the chosen settings marked."""
    finest = [c for c in result.changes if c.grid_mm == result.reference.grid_mm]
    cells = sorted({c.cell_mm for c in finest})
    for cell, grey in zip(cells, np.linspace(0.15, 0.65, len(cells)), strict=True):
        curve = [(c.solver_s, c.line_px) for c in finest if c.cell_mm == cell and c.line_px > 0.0]
        if curve:
            axes.plot(*zip(*curve, strict=True), "o-", color=f"{grey}", lw=1.0)
            words = f"{cell:g} mm mesh" if cell == cells[0] else f"{cell:g}"
            write_beside(axes, words, curve[0], (0, 11), color=f"{grey}")
    axes.set(xscale="log", yscale="log", xlabel="solver's time on one core in s")
    axes.set_ylabel("change of the line in px")
    for each, marker in zip(result.coarsest, ("D", "*"), strict=False):
        if each.change:
            setting = ", ".join(
                _SETTINGS[name][2].format(getattr(each.change, name)) for name in _SETTINGS
            )
            shown = f"coarsest within {each.bound_px:g} px: {setting}"
            place = each.change.solver_s, each.change.line_px
            axes.plot(*place, marker, ms=9, mec=BLACK, color=GREEN, ls="", label=shown)
    decimal_ticks(axes.xaxis)
    axes.margins(y=0.12)
    _draw_bounds(axes)
    if axes.get_legend_handles_labels()[0]:
        axes.figure.legend(loc="outside lower left")


def _draw_bounds(axes: Axes) -> None:
    """Bands that the curves should reach: what a sensor can resolve, what a measurement must."""
    low, high = axes.get_ylim()
    fine, coarse = min(BOUNDS_PX), max(BOUNDS_PX)
    low = min(low, 0.5 * fine)
    axes.axhspan(low, fine, color=_BANDS[0], zorder=0)
    axes.axhspan(fine, coarse, color=_BANDS[1], zorder=0)
    for bound in BOUNDS_PX:
        axes.axhline(bound, color=GREEN, lw=0.8)
        write_on_line(axes, f"{bound:g} px", bound, color=GREEN)
    axes.set_ylim(low, max(high, 2.0 * coarse))
    decimal_ticks(axes.yaxis)


def _um_per_px(result: Convergence) -> float:
    """Change of the measured points for a change of the line."""
    ratios = [c.points_um / c.line_px for c in result.changes if c.line_px > 0.0]
    return float(np.median(ratios)) if ratios else 1.0
