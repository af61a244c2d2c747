"""The paper's figures 6 to 11 as pictures: ray search and rendered frames side by side."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import Any

import numpy as np
from matplotlib import rc_context
from matplotlib.axes import Axes
from matplotlib.axis import Axis
from matplotlib.figure import Figure
from matplotlib.lines import Line2D
from matplotlib.ticker import FixedLocator, LogLocator, NullLocator

from virtual_sensor.files import written_whole
from virtual_sensor.studies.reproduction.curves import DOTS, LINE, RESOLVED, SEARCHED, Curves
from virtual_sensor.studies.reproduction.figures import FIGURES, WAYS, Table
from virtual_sensor.studies.reproduction.panels import (
    ARROWS,
    GROUPS,
    LOOKS,
    PICTURES,
    POINTS,
    Look,
    Panel,
    Picture,
)

DPI = 110
PAPERS = "0.35"
"""Colour of what the paper states."""

_QUICK = {"compress_level": 1}  # half the time of the usual 6, a tenth larger
_HALVES = {"Ray search": (SEARCHED,), "Rendered frames": (DOTS, LINE)}
_OF = {DOTS: " of dots", LINE: " of a line (×, across it only)"}
_NOT_SEEN = "not rendered; faint: the search"
_TICKS_MM = (0.0, -2.5, -5.0, -7.5, -10.0)
_LEAST_PX = 0.1  # of the sensor around a displacement, however small
_WIDE_IN, _NARROW_IN = 15.6, 8.6
_HEAD_IN, _FOOT_IN = 1.65, 0.95
_CENTRED = {"ha": "center", "va": "center"}


def draw_figures(
    curves: Curves, airs: Sequence[str], folder: Path, widths: Mapping[str, str]
) -> None:
    """Draw ``figure_7_resolved.png`` and so on, each figure once for each air.

    Parameters
    ----------
    curves : Curves
    airs : sequence of str
        Airs that are in it.
    folder : Path
    widths : mapping
        For some airs, in words, what was done to them: "blurred by 7.2 mm".

    Raises
    ------
    InputError
        If a file can't be written.
    """
    for air in airs:
        for picture in PICTURES:
            tables = {p.name: FIGURES[p.name](curves, air) for p in picture.panels}
            if any(_seen(p, tables[p.name], WAYS) for p in picture.panels):
                told = widths.get(air) or ("as simulated" if air == RESOLVED else air)
                write_png(_draw(picture, tables, told), folder / f"figure_{picture.name}_{air}.png")


def write_png(figure: Figure, path: Path) -> None:
    """Write a picture; InputError if it can't be written."""
    # Hinted letters take a fifth of the time of such a picture, and look no better.
    with written_whole(path) as temporary, rc_context({"text.hinting": "none"}):
        figure.savefig(temporary, format="png", pil_kwargs=_QUICK)


def plain_ticks(axis: Axis) -> None:
    """Ticks of a logarithmic axis at 1, 2, 5, 10 and so on, written in full."""
    axis.set_major_locator(LogLocator(subs=(1.0, 2.0, 5.0)))
    axis.set_major_formatter("{x:g}")
    axis.set_minor_locator(NullLocator())


def _draw(picture: Picture, tables: Mapping[str, Table], air: str) -> Figure:
    halves = {
        heading: ways
        for heading, ways in _HALVES.items()
        if any(_seen(panel, tables[panel.name], ways) for panel in picture.panels)
    }
    rows, columns = picture.grid
    width = _WIDE_IN if len(halves) > 1 else _NARROW_IN
    height = _HEAD_IN + rows * picture.row_in + _FOOT_IN
    figure = Figure(figsize=(width, height), dpi=DPI)
    title = f"Figure {picture.name} of Beermann et al. 2018: {picture.setting}, air {air}"
    size = 15.0 if len(halves) > 1 else min(13.0, 1050.0 / len(title))
    figure.text(0.5, 1.0 - 0.28 / height, title, fontsize=size, **_CENTRED)
    words = picture.words if len(halves) > 1 else _folded(picture.words)
    figure.text(0.5, 1.0 - 0.66 / height, words, fontsize=10.5, **_CENTRED)
    first: dict[Panel, Axes] = {}
    for number, (heading, ways) in enumerate(halves.items()):
        left, right = number / len(halves), (number + 1) / len(halves)
        grid = figure.add_gridspec(
            rows,
            columns,
            left=left + 0.7 / width,
            right=right - 0.25 / width,
            bottom=_FOOT_IN / height,
            top=1.0 - _HEAD_IN / height,
            wspace=1.0 if columns == 6 else 0.62,
            hspace=0.55 if rows > 2 else 0.42,
        )
        for panel in picture.panels:
            row, start, end = panel.place
            share = first.get(panel)
            axes = figure.add_subplot(grid[row, start:end], sharex=share, sharey=share)
            first.setdefault(panel, axes)
            if not tables[panel.name]:
                axes.set_axis_off()
            elif panel.columns:
                _draw_curves(axes, panel, tables[panel.name], ways)
                if row == max(p.place[0] for p in picture.panels if p.columns):
                    axes.set_xlabel("y of the laser ray in mm", fontsize=9, labelpad=1)
            else:
                _draw_arrow(axes, panel, tables, ways)
        shown = {way for p in picture.panels for way in _seen(p, tables[p.name], ways)}
        heading += " and".join(words for way, words in _OF.items() if way in shown)
        place = 0.5 * (left + right), 1.0 - 1.06 / height
        figure.text(*place, heading, fontsize=12.5, weight="bold", **_CENTRED)
    handles = _key(picture)
    if handles[1:]:
        most = 3 if len(halves) == 1 else len(handles)
        figure.legend(handles=handles, loc="lower center", ncols=most, fontsize=9.5)
    return figure


def _folded(words: str) -> str:
    """On two lines."""
    middle = words.find(" ", len(words) // 2)
    return words[:middle] + "\n" + words[middle + 1 :]


def _seen(panel: Panel, table: Table, ways: Sequence[str]) -> list[str]:
    """The ways in which there is something to draw."""
    columns = panel.columns or ("d_px",)
    return [
        way
        for way in ways
        if table and any(np.isfinite(table[c][table["way"] == way]).any() for c in columns)
    ]


def _draw_curves(axes: Axes, panel: Panel, table: Table, ways: Sequence[str]) -> None:
    """Draw what was seen in these ways; the search's faint in place of what was not."""
    missed = False
    for value in np.unique(table[panel.by]) if panel.by else [np.nan]:
        group = table[panel.by] == value if panel.by else np.full(len(table["way"]), True)
        for column in panel.columns:
            known = group & np.isfinite(table[column].astype(float))
            seen = [way for way in ways if (known & (table["way"] == way)).any()]
            missed |= not seen
            _, colour, marker = GROUPS[panel.by][float(value)] if panel.by else LOOKS[column]
            for way in seen or (SEARCHED,):
                rows = group & (table["way"] == way)
                style: dict[str, Any] = {"color": colour, "marker": marker, "ms": 4.5, "lw": 1.3}
                if way == LINE:
                    style |= {"marker": "x", "ls": "none", "ms": 8, "mew": 1.3}
                if not seen:
                    style["alpha"] = 0.3
                axes.plot(table["y_mm"][rows], table[column][rows], **style)
    for number in panel.stated:
        axes.axhline(number, color=PAPERS, lw=0.9, ls="--", zorder=1)
    told = f"- -  paper: {panel.told}" if panel.told else ""
    _name(axes, panel, _NOT_SEEN if missed and ways != (SEARCHED,) else told)
    if not panel.log:
        axes.axhline(0.0, color="0.8", lw=0.6, zorder=0)
    axes.set_xlim(0.5, -10.5)
    axes.xaxis.set_major_locator(FixedLocator(_TICKS_MM))
    axes.margins(y=0.1)
    if panel.log:
        axes.set_yscale("log")
        plain_ticks(axes.yaxis)
    axes.set_ylabel("px" if panel.columns[0].endswith("px") else "µm", labelpad=1)


def _name(axes: Axes, panel: Panel, below: str) -> None:
    """Title with a smaller line below it, where no curve can run through it."""
    # A title with a place of its own needs no search for one, which costs a tenth of a second.
    axes.set_title(panel.title, fontsize=10.5, y=1.0, pad=17 if below else 6)
    if below:
        place = {"xycoords": "axes fraction", "textcoords": "offset points", "ha": "center"}
        axes.annotate(below, (0.5, 1.0), (0, 4), fontsize=9, color=PAPERS, **place)
    axes.grid(alpha=0.25)


def _draw_arrow(axes: Axes, panel: Panel, tables: Mapping[str, Table], ways: Sequence[str]) -> None:
    """One ray's displacement on the sensor, with the other points for orientation."""
    seen = _seen(panel, tables[panel.name], ways)
    way, alpha = (seen[0], 1.0) if seen else (SEARCHED, 0.3)
    ends: dict[str, Any] = {}
    for name, points in ARROWS.items():
        row = np.flatnonzero(tables[name]["way"] == way)[:1]
        for point, side in zip(points, ("from", "to"), strict=True):
            ends[point] = np.array([tables[name][f"{side}_{axis}_px"][row] for axis in "uv"])
    corners = np.concatenate(list(ends.values()), axis=1)
    if not (corners.size and np.isfinite(corners).all()):
        axes.set_axis_off()
        return
    start, end = (ends[point][:, 0] for point in ARROWS[panel.name])
    arrow = {"arrowstyle": "-|>", "color": "black", "shrinkA": 0, "shrinkB": 0, "lw": 1.6}
    axes.annotate("", end, start, arrowprops=arrow | {"alpha": alpha})
    axes.plot([start[0], end[0], end[0]], [start[1], start[1], end[1]], color="0.6", lw=0.8, ls=":")
    for point, pixel in ends.items():
        axes.plot(*pixel, **_spot(POINTS[point]), alpha=alpha)
    half = 0.65 * max(np.ptp(corners, axis=1).max(), _LEAST_PX)
    u, v = 0.5 * (corners.min(axis=1) + corners.max(axis=1))
    axes.set(xlim=(u - half, u + half), ylim=(v + half, v - half))
    axes.set_xlabel("u in px", fontsize=9, labelpad=1)
    axes.set_ylabel("v in px" if panel.place[1] == 0 else "", fontsize=9, labelpad=1)
    axes.set_box_aspect(1.0)
    axes.locator_params(nbins=5)
    du, dv = end - start
    moved = f"Δu = {du:.2f} px, Δv = {dv:.2f} px".replace("-", "−")
    _name(axes, panel, moved if seen else _NOT_SEEN)


def _spot(look: Look) -> dict[str, Any]:
    return {"marker": "o", "ls": "none", "ms": 6, "color": look[1], "mfc": look[2]}


def _key(picture: Picture) -> list[Line2D]:
    """What the colours and the markers mean."""
    looks: dict[Look, None] = {}  # in the order in which they come
    for panel in picture.panels:
        each = GROUPS[panel.by].values() if panel.by else [LOOKS[c] for c in panel.columns]
        looks |= dict.fromkeys(each)
    handles = [Line2D([], [], color=c, marker=m, ms=4.5, lw=1.3, label=n) for n, c, m in looks]
    if any(panel.name in ARROWS for panel in picture.panels):
        handles += [Line2D([], [], label=look[0], **_spot(look)) for look in POINTS.values()]
    return handles
