"""The convergence study of the air's field: table, picture, page and files."""

from __future__ import annotations

from collections.abc import Callable, Sequence
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
            f" solver {found.solver_s:.0f} s, file {found.file_mb:.1f} MB)."
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
        " coarsest is chosen by the line's. Solver: on one core, up to this flow time. File: of a"
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
    finest = result.reference
    cells = sorted({c.cell_mm for c in result.changes})
    times = sorted({c.time_s for c in result.changes})
    grids = sorted({c.grid_mm for c in result.changes})
    mesh, flow, grid = (
        f"{finest.cell_mm:g} mm mesh",
        f"{finest.time_s:g} s of flow",
        f"{finest.grid_y_mm:g} mm grid",
    )
    along = (
        (
            f"Mesh ({flow}, {grid})",
            "mesh cell across the plume in mm",
            {c: result.change(c, finest.time_s, finest.grid_mm) for c in cells},
            SHIPPED.cell_mm,
        ),
        (
            f"Flow time ({mesh}, {grid})",
            "flow time in s",
            {t: result.change(finest.cell_mm, t, finest.grid_mm) for t in times},
            SHIPPED.time_s,
        ),
        (
            f"Grid ({mesh}, {flow})",
            "distance of nodes across the plume in mm",
            {g[0]: result.change(finest.cell_mm, finest.time_s, g) for g in grids},
            SHIPPED.grid_y_mm,
        ),
    )
    panels = [
        Panel(
            title,
            partial(_draw_changes, label=label, changes=changes, shipped=shipped, result=result),
            f"{title}: change of the line and of the probe rays in px over the {label}.",
        )
        for title, label, changes, shipped in along
    ]
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


def _draw_changes(
    axes: Axes, label: str, changes: dict[float, Change], shipped: float, result: Convergence
) -> None:
    """Curves of the line and the probe rays, with the bounds; the shipped fields' value marked."""
    places = np.array(list(changes))
    ends = []
    for name, words, shade, marker in _CURVES:
        values = np.array([getattr(c, name) for c in changes.values()])
        known = values > 0.0  # the finest changes nothing
        axes.plot(places[known], values[known], marker + "-", color=shade)
        if known.any():
            top = int(np.argmax(np.where(known, values, -1.0)))
            ends.append((values[top], places[top], words, shade))
    axes.set(xscale="log", yscale="log", xlabel=label, ylabel="change in px")
    axes.set_xticks(places, [f"{p:g}" for p in places])
    axes.minorticks_off()
    axes.set_xlim(0.88 * places.min(), 1.14 * places.max())
    axes.margins(y=0.15)
    _label_ends(axes, ends)
    if shipped in changes:
        axes.axvline(shipped, color=GREEN, lw=1.0, ls=":")
        left = shipped > np.sqrt(np.prod(axes.get_xlim()))
        axes.text(
            *(shipped, 0.03, " shipped fields "),
            transform=axes.get_xaxis_transform(),
            **{"color": GREEN, "va": "bottom", "ha": "right" if left else "left", "fontsize": 9.5},
        )
    _draw_bounds(axes)
    scale = _um_per_px(result)
    of_points = axes.secondary_yaxis("right", functions=_scaled(scale))
    of_points.set_ylabel("change of the points in µm")
    decimal_ticks(of_points.yaxis)


def _label_ends(axes: Axes, ends: Sequence[tuple[float, float, str, str]]) -> None:
    """Names of curves at their highest points, one above the other where they come close."""
    middle = np.sqrt(np.prod(axes.get_xlim()))
    ordered = sorted(ends, reverse=True)
    for rank, (value, place, words, shade) in enumerate(ordered):
        right = place < middle
        close = len(ordered) > 1 and ordered[0][0] < 3.0 * ordered[1][0]
        offset = (12, -12)[rank] if close else 9
        style = {"color": shade, "fontweight": "bold", "fontsize": 10.0}
        write_beside(axes, words, (place, value), (10 if right else -10, offset), **style)


def _draw_cost(axes: Axes, result: Convergence) -> None:
    """Change over the solver's time, a curve for each mesh; the chosen settings marked."""
    finest = result.reference
    cells = sorted({c.cell_mm for c in result.changes})
    shades = [str(0.15 + 0.5 * i / max(len(cells) - 1, 1)) for i in range(len(cells))]
    for cell, shade in zip(cells, shades, strict=True):
        curve = [
            c
            for c in result.changes
            if c.cell_mm == cell and c.grid_mm == finest.grid_mm and c.line_px > 0.0
        ]
        if not curve:
            continue
        axes.plot(
            [c.solver_s for c in curve], [c.line_px for c in curve], "o-", color=shade, lw=1.0
        )
        first = curve[0]
        words = f"{cell:g} mm mesh" if cell == cells[0] else f"{cell:g}"
        write_beside(axes, words, (first.solver_s, first.line_px), (0, 11), color=shade)
    axes.set(xscale="log", yscale="log", xlabel="solver's time on one core in s")
    axes.set_ylabel("change of the line in px")
    for each, marker in zip(result.coarsest, ("D", "*"), strict=False):
        if each.change:
            shown = f"coarsest within {each.bound_px:g} px: {_setting(each.change)}"
            place = each.change.solver_s, each.change.line_px
            axes.plot(*place, marker, ms=9, mec=BLACK, color=GREEN, ls="", label=shown)
    decimal_ticks(axes.xaxis)
    axes.margins(y=0.12)
    _draw_bounds(axes)
    if axes.get_legend_handles_labels()[0]:
        axes.figure.legend(loc="outside lower left")


def _setting(change: Change) -> str:
    return f"{change.cell_mm:g} mm, {change.time_s:g} s, grid {change.grid_y_mm:g} mm"


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


def _scaled(scale: float) -> tuple[Callable[[float], float], Callable[[float], float]]:
    return lambda value: value * scale, lambda value: value / scale
