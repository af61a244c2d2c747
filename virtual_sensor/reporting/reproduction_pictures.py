"""The figures of the reproduction: the paper's, as rows of diagrams with an air in each column."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from functools import partial
from itertools import product
from typing import Any

import numpy as np
from matplotlib.axes import Axes
from matplotlib.colors import LogNorm
from matplotlib.figure import Figure
from numpy.typing import NDArray

from virtual_sensor.metrology.deviation import euclidean
from virtual_sensor.reporting.pictures import Panel, Picture, draw_picture
from virtual_sensor.reporting.style import GREY, colour, decimal_ticks, key
from virtual_sensor.studies.reproduction.broadening_fit import Fit
from virtual_sensor.studies.reproduction.curves import (
    DOTS,
    LINE,
    METHODS,
    ROUNDED_PX,
    SEARCHED,
    BySetting,
    Curves,
    Rays,
    near,
    together,
)
from virtual_sensor.studies.reproduction.paper import FITTED, STATEMENTS, Statement
from virtual_sensor.studies.reproduction.reconstruction import STATES, Reconstruction
from virtual_sensor.studies.reproduction.settings import AIRS, BETAS_DEG, TEMPERATURES_C, Setting

Array = NDArray[np.float64]
CELL_IN = (4.2, 3.2)
"""A diagram of the three beside each other: as wide as a phone."""
HOTTEST_C = TEMPERATURES_C[-1]
FROM_ABOVE = ((HOTTEST_C, 0.0),)
HOTTER = tuple((t, 0.0) for t in TEMPERATURES_C)
TURNED = tuple((TEMPERATURES_C[0], b) for b in BETAS_DEG)
HOTTEST_TURNED = tuple((HOTTEST_C, b) for b in BETAS_DEG)
"""Settings of the figures: temperature in degC, beta in degrees."""
SEEN_RAY_MM = -7.5
"""The laser ray whose displacement figures 9(d) to 9(f) show on the sensor."""
PAPERS_HALF_MM = (-10.0, 0.0)

_TEMPERATURES = dict(zip(TEMPERATURES_C, ("#F0B080", "#D55E00", "#702F00"), strict=True))
_POSES = dict(zip(BETAS_DEG, ("#000000", "#6B6B6B", "#A8A8A8"), strict=True))
_MARKERS = ("o", "s", "^")
_POINTS = {
    "pixel_cold": ("A (cold)", "cold", None),
    "pixel_straight": ("B (hot), if seen straight", "hot", "white"),
    "pixel_hot": ("B as the camera sees it", "hot", None),
}
_ENDS = {
    "laser_to_object_px": ("pixel_cold", "pixel_straight"),
    "object_to_camera_px": ("pixel_straight", "pixel_hot"),
    "laser_to_camera_px": ("pixel_cold", "pixel_hot"),
}
"""The pixels that these displacements join."""
_COMPONENTS = {1: "", 2: "uv", 3: "xyz"}
_MARKER_OF = {"x": "o", "y": "s", "u": "s", "z": "^", "v": "^"}  # u runs along y
_METHOD_MARKS: dict[str, dict[str, Any]] = {
    SEARCHED: {"marker": ""},
    DOTS: {"ls": "none", "mfc": "white"},
    LINE: {"marker": "x", "ls": "none", "ms": 6.0},
}
"""The search is a line, rendered dots are markers of their curve, a rendered line is crosses."""
_KEY_IN = 0.8  # below the axes, for their labels and the key
_LEAST_PX = 0.1  # of the sensor around a displacement, however small
_MAP_GREY = "#D9D9D9"


@dataclass(frozen=True)
class Diagram:
    """One of the paper's diagrams: a series of the nine rays.

    Attributes
    ----------
    part : str
        The paper's name of it, and of its file: "7b".
    title : str
    series : str
        Of `Rays`.
    settings : sequence of pair of float
        One, or those in which the series' norm is compared.
    step_px : float
        To which pixels are rounded.
    arrow : bool
        Whether one ray is drawn, as an arrow on the sensor.
    log : bool
        Whether the axis is logarithmic: where small curves stand beside a large one.
    """

    part: str
    title: str
    series: str
    settings: tuple[tuple[float, float], ...] = FROM_ABOVE
    step_px: float = 0.0
    arrow: bool = False
    log: bool = False

    def rays(self, curves: BySetting, air: str) -> Rays | None:
        """Its rays in an air, by all methods that know something of them; None if none does."""
        wanted = [(Setting(air, *at), method) for method in METHODS for at in self.settings]
        some = [curves[each] for each in wanted if each in curves]
        rays = [(near(c, SEEN_RAY_MM) if self.arrow else c).rays(self.step_px) for c in some]
        known = [each for each in rays if np.isfinite(each.of(self.series)).any()]
        return together(known) if known else None

    @property
    def stated(self) -> list[Statement]:
        """Statements whose numbers are drawn in it."""
        mine = [s for s in STATEMENTS if s.panel == self.part]
        return [s for s in mine if self.part and s.of.series.startswith(self.series)]


@dataclass(frozen=True)
class DiagramFigure:
    """Diagrams below each other, with an air in each column.

    Attributes
    ----------
    name : str
        Of its file.
    title, words : str
        What it shows; the same for those who have not read the paper.
    diagrams : tuple of Diagram
    """

    name: str
    title: str
    words: str
    diagrams: tuple[Diagram, ...]


FIGURES = (
    DiagramFigure(
        "figure_6",
        "Figure 6: how near the paper's search comes to the laser point",
        "How far beside its goal on the object the paper's search for a light path ends. Only the"
        " search has such a distance, no frame.",
        (Diagram("6", "6: distance h_d_min", "search_distance_um"),),
    ),
    DiagramFigure(
        "figure_7",
        "Figure 7: incidence points, measured points and pixels, cold and hot",
        "Hot air moves the laser's spot from A (cold) to B (hot), and the point that the sensor"
        " measures from Aₘ to Bₘ. 7(e) is cold, with pixels rounded to 0.25 px: one that lies just"
        " between two steps may be rounded up in a frame, and down in the search.",
        (
            Diagram("7a", "7(a): B − A on the part", "incidence_shift_um"),
            Diagram("7b", "7(b): B − Bₘ, hot", "hot_error_um"),
            Diagram("7c", "7(c): Bₘ − Aₘ", "measured_shift_um"),
            Diagram("7d", "7(d): B − A on the sensor", "pixel_shift_px"),
            Diagram("7e", "7(e): A − Aₘ, cold", "cold_error_um", step_px=ROUNDED_PX),
        ),
    ),
    DiagramFigure(
        "figure_9",
        "Figure 9: the pixel's displacement, separated by light path",
        "Figure 7(d) split by path: what bends the laser's light before the part moves the"
        " spot, what bends the light between part and camera moves it back. (d) to (f)"
        " show one ray, y = -7.5 mm, on the sensor.",
        (
            Diagram("9a", "9(a): laser → object", "laser_to_object_px"),
            Diagram("9b", "9(b): object → camera", "object_to_camera_px"),
            Diagram("9c", "9(c): laser → camera", "laser_to_camera_px"),
            Diagram("9d", "9(d): laser → object", "laser_to_object_px", arrow=True),
            Diagram("9e", "9(e): object → camera", "object_to_camera_px", arrow=True),
            Diagram("9f", "9(f): laser → camera", "laser_to_camera_px", arrow=True),
        ),
    ),
    DiagramFigure(
        "figure_10b",
        "Figure 10(b): with pixels rounded to 0.25 px",
        "The spot on the sensor for a camera that finds it in steps of 0.25 px, and the measured"
        " points that this makes.",
        (
            Diagram("10b", "10(b): B − A on the sensor", "pixel_shift_px", step_px=ROUNDED_PX),
            Diagram("10b", "10(b): Bₘ − Aₘ", "measured_shift_um", step_px=ROUNDED_PX),
        ),
    ),
    DiagramFigure(
        "figure_11",
        "Figure 11: temperatures and poses",
        "How far the measured points and the pixels move: (a) to (c) for a hotter cylinder, seen"
        " from above; (d) for a sensor turned aside. The paper states the last diagram's bounds"
        " and does not draw it.",
        (
            Diagram("11a", "11(a.1): |Bₘ − Aₘ|", "measured_shift_um", HOTTER),
            Diagram("11b", "11(a.2): in steps of 0.25 px", "measured_shift_um", HOTTER, ROUNDED_PX),
            Diagram("11c", "11(c): |B − A| on the sensor", "pixel_shift_px", HOTTER),
            Diagram("11d", "11(d): 900 °C, on the sensor", "pixel_shift_px", TURNED),
            Diagram("11d", "900 °C, |Bₘ − Aₘ|", "measured_shift_um", TURNED, log=True),
        ),
    ),
)
"""The paper's."""

WHOLE_LINE = DiagramFigure(
    "whole_line",
    "Beyond the paper: the whole line, both sides",
    "How far the measured point moves when the part is hot. Shaded: the paper's half.",
    (
        Diagram("", "|Bₘ − Aₘ| from above", "measured_shift_um", HOTTER),
        Diagram("", "|Bₘ − Aₘ| at 1250 °C", "measured_shift_um", HOTTEST_TURNED),
        Diagram("", "Bₘ − Aₘ at 1250 °C", "measured_shift_um"),
    ),
)
OVERVIEW = ("|B − A| on the part", "|B − Bₘ|, hot", "|Bₘ − Aₘ|", "|B − A| on the sensor")
"""Titles of the norms of figure 7(a) to 7(d)."""


def figure_columns(part: str, curves: Curves, air: str) -> dict[str, NDArray[Any]]:
    """Columns of the file of one of the paper's diagrams in an air; none if there is nothing.

    y_mm, method, temperature and pose where there are several; the series with its norm.
    """
    columns: dict[str, NDArray[Any]] = {}
    for diagram in (d for figure in FIGURES for d in figure.diagrams if d.part == part):
        if rays := diagram.rays(curves.nine, air):
            setting = ("temperature_c", "beta_deg") if diagram.settings[1:] else ()
            ends = _ENDS[diagram.series] if diagram.arrow else ()
            columns |= rays.columns_of("y_mm", "method", *setting, *ends, diagram.series)
    return columns


def draw_figure(figure: DiagramFigure, curves: BySetting) -> Picture | None:
    """Diagrams below each other, beside each other the airs; None if there is nothing to draw."""
    panels = []
    for diagram, air in product(figure.diagrams, AIRS):
        rays = diagram.rays(curves, air)
        if rays and not (diagram.arrow and np.isnan(_norm(diagram, rays)).all()):
            draw = partial(_draw_arrow if diagram.arrow else _draw_rays, diagram, rays)
            alt = _in_words(diagram, rays, air)
            panels.append(Panel(f"{diagram.title}, {air}", draw, alt, layout=None))
    return draw_picture(figure.title, panels, len(AIRS), CELL_IN) if panels else None


def draw_airs(curves: Curves) -> Picture:
    """Norms of figure 7, from all airs in one diagram each."""
    panels = []
    for title, diagram in zip(OVERVIEW, FIGURES[1].diagrams, strict=False):
        rays = {air: each for air in AIRS if (each := diagram.rays(curves.nine, air))}
        sizes = [f"{air} {np.nanmax(_norm(diagram, each)):.3g}" for air, each in rays.items()]
        alt = f"{title} of the nine rays, at most {', '.join(sizes)} {_unit(diagram)}."
        panels.append(Panel(title, partial(_draw_airs, diagram, rays), alt, layout=None))
    return draw_picture("What the three airs do, seen from above at 1250 °C", panels)


def _norm(diagram: Diagram, rays: Rays) -> Array:
    values = rays.of(diagram.series)
    return euclidean(values) if values.ndim == 2 else values


def _unit(diagram: Diagram) -> str:
    return "px" if diagram.series.endswith("px") else "µm"


def _in_words(diagram: Diagram, rays: Rays, air: str) -> str:
    """Alternative text of a diagram."""
    norm = _norm(diagram, rays)
    most = f", up to {np.nanmax(norm):.3g} {_unit(diagram)}" if np.isfinite(norm).any() else ""
    what = "one ray on the sensor" if diagram.arrow else "over y"
    methods = ", ".join(dict.fromkeys(rays.method.tolist()))
    stated = "".join(f" The paper: {s.claim} {s.paper}." for s in diagram.stated)
    return f"{diagram.title} {what} in {air} air: {methods}{most}.{stated}"


def _draw_airs(diagram: Diagram, rays: Mapping[str, Rays], axes: Axes) -> None:
    curves = [
        (each, _norm(diagram, each), air, colour(air), marker)
        for marker, (air, each) in zip(_MARKERS, rays.items(), strict=False)
    ]
    _draw_curves(diagram, curves, axes)


def _draw_rays(diagram: Diagram, rays: Rays, axes: Axes) -> None:
    """Components and norm in one setting, or the norm in several."""
    values, norm, curves = rays.of(diagram.series), _norm(diagram, rays), []
    if diagram.settings[1:]:
        poses = diagram.settings in (TURNED, HOTTEST_TURNED)
        by, shades = (rays.beta_deg, _POSES) if poses else (rays.temperature_c, _TEMPERATURES)
        for (value, shade), marker in zip(shades.items(), _MARKERS, strict=True):
            label = f"β = {value:g}°" if poses else f"{value:g} °C"
            curves.append((rays, np.where(by == value, norm, np.nan), label, shade, marker))
    else:
        components = _COMPONENTS[values.size // len(values)]
        for name, of in zip(components, values.T, strict=False):
            curves.append((rays, of, f"Δ{name}", colour(name), _MARKER_OF[name]))
        if diagram.part:
            last = "norm" if components else "distance"
            curves.append((rays, norm, last, colour("norm"), "D"))
    _draw_curves(diagram, curves, axes)


def _draw_curves(
    diagram: Diagram, curves: Sequence[tuple[Rays, Array, str, str, str]], axes: Axes
) -> None:
    """Rays with their values, label, colour and marker; the paper's numbers, axes and key."""
    keys = []
    for rays, values, label, shade, marker in curves:
        for method, mark in _METHOD_MARKS.items():
            mine = (rays.method == method) & np.isfinite(values)
            axes.plot(rays.y_mm[mine], values[mine], **{"color": shade, "marker": marker} | mark)
        seen = marker if (rays.method != SEARCHED).any() else ""
        keys.append(key(label, color=shade, marker=seen, mfc="white"))
    for statement in diagram.stated:
        axes.axhline(statement.stated, color=GREY, ls="--", lw=1.0, zorder=1)
    if diagram.stated:
        said = [f"{statement.stated:g}" for statement in diagram.stated]
        said = said if said[1:] else [statement.paper for statement in diagram.stated]
        keys.append(key(f"paper: {', '.join(said)}", color=GREY, ls="--"))
    if diagram.log:
        axes.set_yscale("log")
        decimal_ticks(axes.yaxis)
    if diagram.part:
        axes.set(xlim=(0.5, -10.5), xticks=[0.0, -2.5, -5.0, -7.5, -10.0])
    else:
        axes.axvspan(*PAPERS_HALF_MM, color="0.95", zorder=0)
        axes.set(xlim=(11.5, -11.5), xticks=[10, 5, 0, -5, -10])
    axes.set_xlabel("y of the laser ray in mm", labelpad=1)
    axes.set_ylabel(_unit(diagram), labelpad=1)
    _key_below(axes, keys)


def _key_below(axes: Axes, handles: Sequence[Any]) -> None:
    """The key in a strip of its own below the axes."""
    assert isinstance(axes.figure, Figure)
    axes.figure.subplots_adjust(bottom=_KEY_IN / axes.figure.get_figheight())
    style: dict[str, Any] = {"ncols": len(handles), "columnspacing": 0.8, "handlelength": 1.3}
    axes.figure.legend(handles=handles, loc="lower center", **style)


def _draw_arrow(diagram: Diagram, rays: Rays, axes: Axes) -> None:
    """One ray's displacement on the sensor, with the other points for orientation."""
    known = np.flatnonzero(np.isfinite(_norm(diagram, rays)))
    row = int(known[-1])  # rendered, if there is such a one
    places = {name: getattr(rays, name)[row] for name in _POINTS}
    start, end = (places[name] for name in _ENDS[diagram.series])
    arrow = {"arrowstyle": "-|>", "color": "black", "shrinkA": 0, "shrinkB": 0, "lw": 1.6}
    axes.annotate("", end, start, arrowprops=arrow)
    axes.plot([start[0], end[0], end[0]], [start[1], start[1], end[1]], color=GREY, lw=0.8, ls=":")
    keys = []
    for name, (label, of, filling) in _POINTS.items():
        mark = {"color": colour(of), "mfc": filling or colour(of), "marker": "o", "ms": 6.0}
        axes.plot(*places[name], ls="none", **mark)
        keys.append(key(label.replace("B (hot), if", "B,"), ls="none", **mark))
    corners = np.array(list(places.values()))
    half = 0.65 * max(float(np.ptp(corners, axis=0).max()), _LEAST_PX)
    u, v = 0.5 * (corners.min(axis=0) + corners.max(axis=0))
    axes.set(xlim=(u - half, u + half), ylim=(v + half, v - half))
    axes.set(xlabel="u in px", ylabel="v in px")
    axes.set_box_aspect(1.0)
    axes.set_anchor("W")
    axes.locator_params(nbins=5)
    du, dv = end - start
    words = f"Δu = {du:.2f} px\nΔv = {dv:.2f} px\n\n{rays.method[row]}".replace("-", "−")
    axes.text(1.05, 0.5, words, transform=axes.transAxes, va="center")
    _key_below(axes, keys)


def draw_poses(poses: BySetting) -> Picture:
    """abs(B_m - A_m) over beta and y, a map for each air, in logarithmic colours.

    Grey where a point was not found.
    """
    norms = {at: euclidean(curve.rays().measured_shift_um) for at, curve in poses.items()}
    every = np.concatenate(list(norms.values()))
    known = every[np.isfinite(every) & (every > 0.0)]
    shades = LogNorm(*((known.min(), known.max()) if known.size else (1.0, 10.0)))
    panels = []
    for air in dict.fromkeys(setting.air for setting, _ in poses):
        mine = [at for at in poses if at[0].air == air]
        beta, y = np.array([setting.beta_deg for setting, _ in mine]), poses[mine[0]].y_mm
        size = np.array([norms[at] for at in mine])
        alt = (
            f"Map over beta from 0 to 90° and y from -11 to 11 mm in {air} air: largest from above"
            f" ({_most(size[0])} µm), least from the side ({_most(size[-1])} µm at most)."
        )
        draw = partial(_draw_map, beta, y, size, shades)
        panels.append(Panel(f"|Bₘ − Aₘ| from all poses, {air}", draw, alt))
    levels = ", ".join(f"{level:g}" for level in _levels())
    title = f"From every side, 1250 °C. Lines: {levels} µm, which the paper states. Grey: not found"
    return draw_picture(title, panels, 3, CELL_IN)


def _most(size: Array) -> str:
    return f"{np.nanmax(size):.3g}" if np.isfinite(size).any() else "unknown"


def _levels() -> list[float]:
    """Numbers of the paper's that are sizes of deviations."""
    return sorted(s.stated for s in FITTED if s.of.series.endswith("_um.norm"))


def _draw_map(beta_deg: Array, y_mm: Array, size: Array, norm: LogNorm, axes: Axes) -> None:
    drawn = axes.pcolormesh(y_mm, beta_deg, size, norm=norm, shading="nearest")
    axes.set_facecolor(_MAP_GREY)
    axes.grid(visible=False)
    low, high = (np.nanmin(size), np.nanmax(size)) if np.isfinite(size).any() else (0.0, 0.0)
    levels = [level for level in _levels() if low < level < high]
    if levels and min(size.shape) > 1:
        lines = axes.contour(y_mm, beta_deg, np.ma.masked_invalid(size), levels, colors="white")
        axes.clabel(lines, fmt="%g µm", fontsize=9)
    axes.set(xlabel="y of the laser ray in mm", ylabel="β in degrees, 0 from above")
    axes.invert_xaxis()
    assert isinstance(axes.figure, Figure)
    bar = axes.figure.colorbar(drawn, ax=axes, label="µm")
    decimal_ticks(bar.ax.yaxis)


def draw_fits(fits: Mapping[str, Fit]) -> Picture:
    """The cost of each broadened air's parameter."""
    least = ", ".join(f"{air} {fit.fitted_mm:g} mm" for air, fit in fits.items())
    alt = f"Sum of squared relative residuals over the width of the blur; least at {least}."
    return draw_picture("", [Panel("Cost of a blur's width", partial(_draw_costs, fits), alt)])


def _draw_costs(fits: Mapping[str, Fit], axes: Axes) -> None:
    for marker, (air, fit) in zip(_MARKERS, fits.items(), strict=False):
        mark = {"color": colour(air), "marker": marker}
        axes.plot(fit.tried_mm, fit.cost, label=f"{air}, least at {fit.fitted_mm:g} mm", **mark)
        axes.axvline(fit.fitted_mm, color=colour(air), ls=":")
    axes.set(yscale="log", xlabel="blur in mm", ylabel="sum of squared relative residuals")
    decimal_ticks(axes.yaxis)
    axes.legend()


def draw_reconstruction(results: Mapping[Setting, Reconstruction]) -> Picture:
    """Residuals of the fitted cylinders along the line, and the errors of their radii."""
    panels = []
    for air in dict.fromkeys(setting.air for setting in results):
        mine = [setting for setting in results if setting.air == air]
        shown = max(mine, key=lambda setting: (-setting.beta_deg, setting.temperature_c))
        draw = partial(_draw_residual, results[shown])
        alt = (
            f"Distance of the measured points from the fitted cylinder over y: {shown}; standard"
            f" deviation {results[shown].residual_std_um[-1, 1]:.3g} µm when hot."
        )
        panels.append(Panel(f"Residual of the fit, {air}", draw, alt, layout=None))
    alt = "Error of the hot radius with its 95 % interval, by setting and arc: see the table."
    radii = partial(_draw_radii, results)
    errors = Panel("Error of the radius, hot", radii, alt, height=len(panels))
    title = "Does a hot cylinder measure too small? Fits to its scans"
    return draw_picture(title, [errors, *panels], 2, CELL_IN)


def _draw_residual(result: Reconstruction, axes: Axes) -> None:
    for state, name in enumerate(STATES):
        axes.plot(result.y_mm, result.radial_residual_um(state), color=colour(name), label=name)
    axes.set(xlim=(11.5, -11.5), xlabel="y of the laser ray in mm", ylabel="point − cylinder in µm")
    _key_below(axes, axes.get_lines())


def _draw_radii(results: Mapping[Setting, Reconstruction], axes: Axes) -> None:
    """Errors of the hot radius: a row for each setting, a marker for each arc."""
    arcs = next(iter(results.values())).arc_mm
    for number, arc in enumerate(arcs):
        error = np.array([result.error_um[number, 1] for result in results.values()])
        bounds = np.array([result.interval_um[number, 1] for result in results.values()])
        axes.errorbar(
            error,
            np.arange(len(results)) + 0.2 * (number - 0.5 * (len(arcs) - 1)),
            xerr=np.abs(bounds.T - error),
            fmt="o^sDv"[number % 5],
            color=colour("hot"),
            capsize=3,
            label=f"|y| ≤ {arc:g} mm",
        )
    axes.axvline(0.0, color="black", lw=0.6)
    axes.set_xscale("symlog", linthresh=10.0)
    axes.set_xticks([-1000, -100, -10, 0, 10, 100], ["−1000", "−100", "−10", "0", "10", "100"])
    axes.set_yticks(range(len(results)), [str(s).replace(", ", "\n", 1) for s in results])
    axes.invert_yaxis()
    axes.set_xlabel("fitted − true radius in µm")
    axes.margins(x=0.1)
    axes.legend(loc="upper right", frameon=True, edgecolor="white", framealpha=1.0)
