"""What the paper could not draw: whole lines, all poses, the fit of its air, fitted cylinders."""

from __future__ import annotations

from collections.abc import Mapping
from pathlib import Path
from typing import Any

import numpy as np
from matplotlib.axes import Axes
from matplotlib.colors import LogNorm
from matplotlib.figure import Figure
from numpy.typing import NDArray

from virtual_sensor.metrology.deviation import UM_PER_MM, euclidean
from virtual_sensor.studies.reproduction.beta_map import BetaMap
from virtual_sensor.studies.reproduction.broadening_fit import Fit
from virtual_sensor.studies.reproduction.curves import Curves, Setting
from virtual_sensor.studies.reproduction.drawing import DPI, PAPERS, plain_ticks, write_png
from virtual_sensor.studies.reproduction.numbers import TOLERANCE
from virtual_sensor.studies.reproduction.panels import POSES, TEMPERATURES
from virtual_sensor.studies.reproduction.reconstruction import STATES, Reconstruction

Array = NDArray[np.float64]

PAPERS_HALF_MM = (-10.0, 0.0)
_LINE_MM = (11.5, -11.5)  # 0 to the left of -10, as the paper has it
CONTOURS_UM = (7.0, 20.0, 75.0)
"""Numbers that the paper states: of beta = 30 deg, of 15 deg, and the largest from above."""

_HOTTEST_C, _ABOVE_DEG = 1250.0, 0.0
_GREY = "0.85"
_STATE_COLOURS = ("#1f5fa8", "#c8321e")
_ARC_MARKERS = "o^sDv"
_PERCENT = 100.0
_SHOWN_PERCENT = 100.0  # a longer bar is cut, with its number beside it


def draw_whole_line(curves: Curves, path: Path) -> None:
    """Draw B_m - A_m on both sides of the line, by temperature and by pose, in each air.

    Raises
    ------
    InputError
        If the file can't be written.
    """
    airs = list(dict.fromkeys(setting.air for setting in curves.whole))
    rows = ("norm", "Δx", "Δy", "Δz")
    figure = Figure(figsize=(15.8, 9.4), dpi=DPI)
    _title(
        figure,
        "Both sides of the line: how far the measured point moves when the part is hot, Bₘ − Aₘ",
        "Ray search. Shaded: the part of the line that the paper looks at.",
    )
    grid = figure.subplots(
        len(rows),
        2 * len(airs),
        sharex=True,
        sharey="row",
        squeeze=False,
        gridspec_kw=_inside(figure, 0.75, 0.95, wspace=0.06, hspace=0.08),
    )
    for number, air in enumerate(airs):
        groups = (
            (f"{air}, β = {_ABOVE_DEG:g}°", TEMPERATURES, lambda v: (v, _ABOVE_DEG)),
            (f"{air}, {_HOTTEST_C:g} °C", POSES, lambda v: (_HOTTEST_C, v)),
        )
        for column, (title, looks, setting) in enumerate(groups, 2 * number):
            grid[0, column].set_title(title, fontsize=11)
            for value, (_, colour, _) in looks.items():
                curve = curves.whole.get(Setting(air, *setting(value)))
                if curve is None:
                    continue
                moved = curve.exact.measured_um
                for axes, values in zip(grid[:, column], [euclidean(moved), *moved.T], strict=True):
                    axes.plot(curve.y_mm, values, color=colour, lw=1.3)
    for axes in grid.ravel():
        axes.axvspan(*PAPERS_HALF_MM, color="0.95", zorder=0)
        axes.axhline(0.0, color="0.7", lw=0.6)
        axes.grid(alpha=0.25)
    grid[0, 0].set_xlim(*_LINE_MM)
    for axes, name in zip(grid[:, 0], rows, strict=True):
        axes.set_ylabel(f"{name} in µm")
    for axes in grid[-1]:
        axes.set_xlabel("y of the laser ray in mm", fontsize=9)
    keys = [*TEMPERATURES.values(), *POSES.values()]
    handles = [grid[0, 0].plot([], [], color=colour, label=label)[0] for label, colour, _ in keys]
    figure.legend(handles=handles, loc="lower center", ncols=len(handles), fontsize=9.5)
    write_png(figure, path)


def draw_beta_map(maps: Mapping[str, BetaMap], path: Path) -> None:
    """Draw abs(B_m - A_m) over beta and y, one map for each air, in logarithmic colours.

    Grey where a point was not found.

    Raises
    ------
    InputError
        If the file can't be written.
    """
    sizes = {air: euclidean(each.measured_um) for air, each in maps.items()}
    known = np.concatenate([size[np.isfinite(size) & (size > 0.0)] for size in sizes.values()])
    norm = LogNorm(*((known.min(), known.max()) if known.size else (1.0, 10.0)))
    figure = Figure(figsize=(15.6, 6.6), dpi=DPI)
    temperatures = dict.fromkeys(f"{each.temperature_c:g} °C" for each in maps.values())
    stated = ", ".join(f"{level:g}" for level in CONTOURS_UM)
    _title(
        figure,
        f"From every side: how far the measured point moves, |Bₘ − Aₘ|, {', '.join(temperatures)}",
        f"Lines: {stated} µm, which the paper states. Dotted: the paper's poses. Grey: not found.",
    )
    *panels, scale = figure.subplots(
        1,
        len(maps) + 1,
        gridspec_kw=_inside(figure, 0.6, 0.55, wspace=0.12) | {"right": 0.96},
        width_ratios=[*(1.0 for _ in maps), 0.05],
    )
    for axes, (air, each) in zip(panels, maps.items(), strict=True):
        size = sizes[air]
        drawn = axes.pcolormesh(
            each.y_mm, each.beta_deg, size, norm=norm, cmap="viridis", shading="nearest"
        )
        axes.set_facecolor(_GREY)
        low, high = (np.nanmin(size), np.nanmax(size)) if np.isfinite(size).any() else (0.0, 0.0)
        levels = [level for level in CONTOURS_UM if low < level < high]
        if levels and min(size.shape) > 1:
            masked = np.ma.masked_invalid(size)
            lines = axes.contour(each.y_mm, each.beta_deg, masked, levels, colors="white")
            axes.clabel(lines, fmt="%g µm", fontsize=9)
        for beta in POSES:
            axes.axhline(beta, color="white", lw=0.8, ls=":")
        axes.set(title=f"{air} air", xlabel="y of the laser ray in mm")
        axes.invert_xaxis()
    panels[0].set_ylabel("β in degrees: 0 from above, 90 from the side", labelpad=1)
    plain_ticks(figure.colorbar(drawn, cax=scale, label="µm").ax.yaxis)
    write_png(figure, path)


def draw_fit(fits: Mapping[str, Fit], path: Path) -> None:
    """Draw for each way to broaden the air: the cost of its parameter, and what the fit leaves.

    Raises
    ------
    InputError
        If the file can't be written.
    """
    figure = Figure(figsize=(15.6, 1.6 + 3.6 * len(fits)), dpi=DPI)
    _title(
        figure,
        "How broad was the paper's plume?",
        "One parameter is fitted to the numbers that the paper states.  Orange: missed by more than"
        f" {_PERCENT * TOLERANCE:.0f} %.",
    )
    grid = figure.subplots(
        len(fits),
        2,
        squeeze=False,
        gridspec_kw=_inside(figure, 0.75, 0.55, wspace=0.6, hspace=0.32),
    )
    for (cost, bars), fit in zip(grid, fits.values(), strict=True):
        cost.plot(fit.tried, fit.cost, "o-", color="black", ms=4, lw=1.0)
        cost.axvline(fit.fitted, color="#c8321e", lw=1.2, label=f"fitted: {fit.broadening}")
        cost.set(yscale="log", xlabel=f"parameter, {fit.unit}")
        cost.set(title=f"{fit.air} air: sum of squared relative residuals")
        plain_ticks(cost.yaxis)
        cost.grid(alpha=0.25)
        cost.legend(fontsize=9)
        _draw_residuals(bars, fit)
    write_png(figure, path)


def _draw_residuals(axes: Axes, fit: Fit) -> None:
    """Relative difference of each number as a bar, the numbers themselves beside its name."""
    percent = _PERCENT * np.asarray(fit.residual)
    place = np.arange(len(percent))
    within = np.abs(percent) <= _PERCENT * TOLERANCE
    shown = np.clip(percent, -_SHOWN_PERCENT, _SHOWN_PERCENT)
    axes.barh(place, shown, color=np.where(within, "#2a9d8f", "#e69f00"), height=0.6)
    for y, value, bar, kind in zip(place, percent, shown, fit.kind, strict=True):
        words = f"{value:+.0f} %".replace("-", "−") if np.isfinite(value) else "unknown"
        axes.annotate(
            "kept" if value == 0.0 and kind != "about" else words,
            (bar if np.isfinite(bar) else 0.0, y),
            (-4 if value < 0.0 else 4, 0),
            textcoords="offset points",
            ha="right" if value < 0.0 else "left",
            va="center",
            fontsize=9,
        )
    axes.set_yticks(
        place,
        [
            f"{name}\npaper {kind} {paper:g}, ours {ours:.3g}, as simulated {resolved:.3g}"
            for name, kind, paper, ours, resolved in zip(
                fit.names, fit.kind, fit.paper, fit.ours, fit.resolved, strict=True
            )
        ],
        fontsize=9,
    )
    axes.invert_yaxis()
    for bound in (-_PERCENT * TOLERANCE, _PERCENT * TOLERANCE):
        axes.axvline(bound, color=PAPERS, lw=0.9, ls="--")
    axes.axvline(0.0, color="black", lw=0.6)
    largest = max(2.0 * _PERCENT * TOLERANCE, float(np.nanmax(np.abs(shown), initial=0.0)))
    axes.set_xlim(-1.25 * largest, 1.25 * largest)
    axes.set(xlabel="ours minus the paper's, %", title=f"{fit.air} air: residuals")


def draw_reconstruction(results: Mapping[Setting, Reconstruction], path: Path) -> None:
    """Draw residuals of the fitted cylinders along the line, and the errors of their radii.

    Raises
    ------
    InputError
        If the file can't be written.
    """
    airs = list(dict.fromkeys(setting.air for setting in results))
    figure = Figure(figsize=(15.6, 9.2), dpi=DPI)
    _title(
        figure,
        "A cylinder fitted to the points of a scan: does a hot one measure too small?",
        "Left: what a fit leaves, distance of the points from the cylinder, positive outside."
        " Right: what it gives. Blue: cold; red: hot.",
    )
    grid = figure.add_gridspec(len(airs), 2, **_inside(figure, 0.75, 0.55, wspace=0.5, hspace=0.35))
    for number, air in enumerate(airs):
        axes = figure.add_subplot(grid[number, 0])
        mine = [setting for setting in results if setting.air == air]
        shown = max(mine, key=lambda setting: (-setting.beta_deg, setting.temperature_c))
        for state, colour in enumerate(_STATE_COLOURS):
            residual = radial_residual_um(results[shown], state)
            axes.plot(results[shown].y_mm, residual, color=colour, lw=1.3)
        axes.set(title=f"{shown}: mean of all lines", ylabel="residual in µm", xlim=_LINE_MM)
        axes.grid(alpha=0.25)
    axes.set_xlabel("y of the laser ray in mm")
    _draw_radii(figure.add_subplot(grid[:, 1]), results)
    write_png(figure, path)


def radial_residual_um(result: Reconstruction, state: int) -> Array:
    """Distance (K,) of the points from the cylinder through the widest arc, mean of all lines.

    Positive outside; NaN where no line has a point or nothing was fitted.
    """
    points = result.points_mm[state] - result.axis_point_mm[-1, state]
    axis = result.axis_direction[-1, state]
    across = points - (points @ axis)[:, None] * axis
    residual = UM_PER_MM * (np.linalg.norm(across, axis=1) - result.radius_mm[-1, state])
    by_line = residual.reshape(len(result.along_mm), len(result.y_mm))
    known = np.isfinite(by_line)
    total = np.where(known, by_line, 0.0).sum(axis=0)
    return np.asarray(total / np.where(known.any(axis=0), known.sum(axis=0), np.nan))


def _draw_radii(axes: Axes, results: Mapping[Setting, Reconstruction]) -> None:
    """Error of the radius with its interval: a row for each setting, a marker for each arc."""
    labelled = set()
    for row, result in enumerate(results.values()):
        for number, arc in enumerate(result.arc_mm):
            for state, colour in enumerate(_STATE_COLOURS):
                error = result.error_um[number, state]
                low, high = result.interval_um[number, state]
                name = f"{STATES[state]}, rays of |y| ≤ {arc:g} mm"
                axes.errorbar(
                    error,
                    row + 0.18 * (number - 0.5 * (len(result.arc_mm) - 1)),
                    xerr=np.abs([[error - low], [high - error]]),
                    fmt=_ARC_MARKERS[number % len(_ARC_MARKERS)],
                    color=colour,
                    ms=5,
                    capsize=3,
                    label=None if name in labelled else name,
                )
                labelled.add(name)
    axes.axvline(0.0, color="black", lw=0.6)
    axes.set_xscale("symlog", linthresh=10.0)
    axes.xaxis.set_major_formatter("{x:g}")
    axes.set_yticks(range(len(results)), [str(setting) for setting in results], fontsize=9)
    axes.invert_yaxis()
    axes.grid(alpha=0.25)
    axes.set_title("Error of the radius: fitted minus true, with 95 % interval")
    axes.set_xlabel("µm; the scale is linear up to ±10 µm, logarithmic beyond")
    axes.legend(fontsize=8.5)


def _title(figure: Figure, title: str, below: str) -> None:
    height = figure.get_figheight()
    figure.text(0.5, 1.0 - 0.25 / height, title, ha="center", va="center", fontsize=15)
    figure.text(0.5, 1.0 - 0.58 / height, below, ha="center", va="center", fontsize=10.5)


def _inside(figure: Figure, left_in: float, bottom_in: float, **spaces: float) -> dict[str, Any]:
    """Where a grid lies in a figure: constrained layout would draw everything twice."""
    width, height = figure.get_size_inches()
    edges = {"left": left_in / width, "right": 1.0 - 0.25 / width}
    return edges | {"bottom": bottom_in / height, "top": 1.0 - 1.05 / height} | spaces
