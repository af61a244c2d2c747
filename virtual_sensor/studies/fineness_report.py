"""The study of how fine a field must be: table, chart and files."""

from __future__ import annotations

import dataclasses
from pathlib import Path
from typing import Any

import numpy as np
from matplotlib.axes import Axes
from matplotlib.figure import Figure

from virtual_sensor.files import RESULTS_SIGN, folder_written_whole, written_whole
from virtual_sensor.studies.fineness import BOUNDS_PX, SHIPPED, Change, Fineness
from virtual_sensor.studies.tables import write_csv, write_json

_BOUND = {"color": "0.4", "linewidth": 0.8, "linestyle": "--"}


def save(result: Fineness, folder: Path, overwrite: bool = False) -> None:
    """Write `fineness.csv`, `fineness.md`, `fineness.png` and a summary; all of them or none.

    Raises
    ------
    InputError
        If the folder exists (and `overwrite` is not set) or can't be written.
    """
    with folder_written_whole(folder, overwrite) as place:
        rows = [*result.changes, result.long]
        columns: dict[str, Any] = {
            "cell_mm": [c.choice.cell_mm for c in rows],
            "time_s": [c.choice.time_s for c in rows],
            "grid_y_mm": [c.choice.grid_mm[0] for c in rows],
            "grid_z_mm": [c.choice.grid_mm[1] for c in rows],
        }
        for name in ("line_px", "line_rms_px", "rays_px", "points_um", "run_s", "cells", "file_mb"):
            columns[name] = [getattr(c, name) for c in rows]
        write_csv(place / "fineness.csv", {k: np.array(v) for k, v in columns.items()})
        draw_chart(result, place / "fineness.png")
        with written_whole(place / "fineness.md") as temporary:
            temporary.write_text(markdown_table(result), encoding="utf-8")
        kept = {f"{bound:g} px": result.coarsest(bound) for bound in BOUNDS_PX}
        summary = {
            "temperature_c": result.temperature_c,
            "reference": dataclasses.asdict(result.reference),
            "coarsest within": {k: dataclasses.asdict(c) if c else None for k, c in kept.items()},
            "longer run": dataclasses.asdict(result.long),
            "notes": result.notes,
        }
        write_json(place / RESULTS_SIGN, summary)


def outcome(result: Fineness) -> list[str]:
    """What it comes to, in words."""
    lines = []
    for bound in BOUNDS_PX:
        kept = result.coarsest(bound)
        lines.append(
            f"within {bound:g} px of the finest: "
            + (_words(kept) if kept else "none of the coarser")
        )
    long = result.long
    lines.append(
        f"{long.choice.time_s:g} s of flow in place of {result.reference.time_s:g} s"
        f" ({long.choice.cell_mm:g} mm mesh): {long.line_px:.2g} px, {long.points_um:.2g} µm"
    )
    return lines


def markdown_table(result: Fineness) -> str:
    """The coarsest that keep within the bounds, the shipped fields' choice, the longer run."""
    reference = result.reference
    rows = {f"coarsest within {bound:g} px": result.coarsest(bound) for bound in BOUNDS_PX}
    rows["as the shipped fields"] = next((c for c in result.changes if c.choice == SHIPPED), None)
    rows[f"against {reference.time_s:g} s on the same mesh"] = result.long
    lines = [
        "| | mesh cell | flow time | field grid y x z | line, across itself | probe rays, both axes"
        " | points | solver | file |",
        "|---|---|---|---|---|---|---|---|---|",
        *(_row(name, c) for name, c in rows.items() if c),
        "",
        f"Made by `virtual-sensor field fineness`: sections of a cylinder of"
        f" {result.temperature_c:g} °C, against a mesh of {reference.cell_mm:g} mm,"
        f" {reference.time_s:g} s and a grid of {reference.grid_mm[0]:g} x"
        f" {reference.grid_mm[1]:g} mm. Changes are the largest; the coarsest is chosen by the"
        " line's. Solver: on one core, up to this flow time. File: of a three-dimensional field.",
    ]
    return "\n".join(lines) + "\n"


def _row(name: str, c: Change) -> str:
    y, z = c.choice.grid_mm
    return (
        f"| {name} | {c.choice.cell_mm:g} mm | {c.choice.time_s:g} s | {y:g} x {z:g} mm"
        f" | {c.line_px:.2g} px | {c.rays_px:.2g} px | {c.points_um:.2g} µm | {c.run_s:.0f} s"
        f" | {c.file_mb:.1f} MB |"
    )


def _words(c: Change) -> str:
    y, z = c.choice.grid_mm
    return (
        f"a mesh of {c.choice.cell_mm:g} mm, {c.choice.time_s:g} s of flow, a grid of {y:g} x"
        f" {z:g} mm (line {c.line_px:.2g} px, rays {c.rays_px:.2g} px, points {c.points_um:.2g} µm;"
        f" solver {c.run_s:.0f} s, file {c.file_mb:.1f} MB)"
    )


def draw_chart(result: Fineness, path: Path) -> None:
    """Draw error against mesh, time and grid, and against the solver's time, as a PNG."""
    figure = Figure(figsize=(12.5, 7.5), dpi=110, layout="constrained")
    figure.suptitle(
        "How fine must the air's field be?  Change of what the sensor sees against the finest"
        f" field, {result.temperature_c:g} °C"
    )
    mesh, time, grid, cost = figure.subplots(2, 2).ravel()
    finest = result.reference
    grids = sorted({c.choice.grid_mm for c in result.changes}, reverse=True)
    times = sorted({c.choice.time_s for c in result.changes})
    cells = sorted({c.choice.cell_mm for c in result.changes}, reverse=True)

    _lines(mesh, [result.change(c, finest.time_s, finest.grid_mm) for c in cells], cells)
    mesh.set_xlabel("mesh cell across the plume, mm")
    _lines(time, [result.change(finest.cell_mm, t, finest.grid_mm) for t in times], times)
    time.set_xlabel("flow time, s")
    widths = [g[0] for g in grids]
    _lines(grid, [result.change(finest.cell_mm, finest.time_s, g) for g in grids], widths)
    grid.set_xlabel("field grid across the plume, mm")

    scatter = cost.scatter(
        [c.run_s for c in result.changes],
        [_floor(c.line_px) for c in result.changes],
        c=[c.choice.cell_mm for c in result.changes],
        s=[12.0 + 12.0 * c.file_mb for c in result.changes],
        cmap="viridis_r",
        alpha=0.8,
    )
    figure.colorbar(scatter, ax=cost, label="mesh cell, mm")
    for bound in BOUNDS_PX:
        if kept := result.coarsest(bound):
            cost.annotate(
                f"coarsest within {bound:g} px",
                (kept.run_s, _floor(kept.line_px)),
                xytext=(-90, 12),
                textcoords="offset points",
                arrowprops={"arrowstyle": "->"},
            )
    cost.set(xscale="log", yscale="log", xlabel="solver's time on one core, s (dot: file size)")
    for axes in (mesh, time, grid, cost):
        axes.set_ylabel("line, at most, px" if axes is cost else "change, px")
        for bound in BOUNDS_PX:
            axes.axhline(bound, **_BOUND)
        axes.grid(alpha=0.3)
    mesh.legend(loc="best")
    with written_whole(path) as temporary:
        figure.savefig(temporary, format="png")


def _lines(axes: Axes, changes: list[Change], places: list[float]) -> None:
    for name, label in (
        ("rays_px", "probe rays, both axes, at most"),
        ("line_px", "line, across itself, at most"),
    ):
        axes.plot(places, [_floor(getattr(c, name)) for c in changes], "o-", label=label)
    axes.set(xscale="log", yscale="log")
    axes.set_xticks(places, [f"{p:g}" for p in places])
    axes.minorticks_off()


def _floor(value: float) -> float:
    """The reference itself changes nothing: NaN, so that a logarithmic axis leaves it out."""
    return value if value > 0.0 else np.nan
