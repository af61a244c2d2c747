"""The figures of the reproduction: the paper's, as rows of diagrams with an air in each column."""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass
from functools import partial
from typing import Any

import numpy as np
from matplotlib.axes import Axes
from matplotlib.colors import LogNorm
from matplotlib.figure import Figure
from matplotlib.lines import Line2D
from numpy.typing import NDArray

from virtual_sensor.metrology.deviation import euclidean
from virtual_sensor.reporting.pictures import Panel, Picture, draw_picture
from virtual_sensor.reporting.style import GREY, colour, decimal_ticks
from virtual_sensor.studies.reproduction.broadening_fit import Fit
from virtual_sensor.studies.reproduction.curves import (
    DOTS,
    LINE,
    METHODS,
    ROUNDED_PX,
    SEARCHED,
    Curve,
    Curves,
    Rays,
    near,
    together,
)
from virtual_sensor.studies.reproduction.paper import FITTED, STATEMENTS, TOLERANCE, Statement
from virtual_sensor.studies.reproduction.reconstruction import STATES, Reconstruction
from virtual_sensor.studies.reproduction.settings import (
    AIRS,
    BETAS_DEG,
    TEMPERATURES_C,
    Setting,
)

Array = NDArray[np.float64]
CELL_IN = (4.2, 3.2)
"""A diagram of the three beside each other: as wide as a phone."""
HOTTEST_C = TEMPERATURES_C[-1]
FROM_ABOVE = ((HOTTEST_C, 0.0),)
HOTTER = tuple((t, 0.0) for t in TEMPERATURES_C)
TURNED = tuple((TEMPERATURES_C[0], b) for b in BETAS_DEG)
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
    ends : pair of str
        Of an arrow on the sensor, which one ray is drawn as: the pixels that it joins.
    log : bool
        Whether the axis is logarithmic: where small curves stand beside a large one.
    """

    part: str
    title: str
    series: str
    settings: tuple[tuple[float, float], ...] = FROM_ABOVE
    step_px: float = 0.0
    ends: tuple[str, ...] = ()
    log: bool = False

    def rays(self, curves: Curves, air: str) -> Rays | None:
        """Its rays in an air, by all methods that know something of them; None if none does."""
        found = []
        for method in METHODS:
            for at in self.settings:
                curve = curves.nine.get((Setting(air, *at), method))
                if curve is None:
                    continue
                rays = (near(curve, SEEN_RAY_MM) if self.ends else curve).rays(self.step_px)
                if np.isfinite(getattr(rays, self.series)).any():
                    found.append(rays)
        return together(found) if found else None

    @property
    def stated(self) -> list[Statement]:
        """Statements whose numbers are drawn in it."""
        mine = [s for s in STATEMENTS if s.panel == self.part and s.of]
        return [s for s in mine if s.of and s.of.series.startswith(self.series)]


@dataclass(frozen=True)
class PaperFigure:
    """One of the paper's figures.

    Attributes
    ----------
    name, caption, words : str
        Its number; what it shows; the same for those who have not read the paper.
    diagrams : tuple of Diagram
    """

    name: str
    caption: str
    words: str
    diagrams: tuple[Diagram, ...]


_ARROW = {"series": "laser_to_object_px", "ends": ("pixel_cold", "pixel_straight")}
FIGURES = (
    PaperFigure(
        "6",
        "how near the paper's search comes to the laser point",
        "How far beside its goal on the object the paper's search for a light path ends. Only the"
        " search has such a distance, no frame.",
        (Diagram("6", "6: distance h_d_min", "search_distance_um"),),
    ),
    PaperFigure(
        "7",
        "incidence points, measured points and pixels, cold and hot",
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
    PaperFigure(
        "9",
        "the pixel's displacement, separated by light path",
        "Figure 7(d) split by path: what bends the laser's light on its way to the part moves the"
        " spot one way, what bends the light on its way to the camera moves it back. (d) to (f)"
        " show one ray, y = -7.5 mm, on the sensor.",
        (
            Diagram("9a", "9(a): laser → object", "laser_to_object_px"),
            Diagram("9b", "9(b): object → camera", "object_to_camera_px"),
            Diagram("9c", "9(c): laser → camera", "laser_to_camera_px"),
            Diagram(
                "9d",
                "9(d): laser → object",
                "laser_to_object_px",
                ends=("pixel_cold", "pixel_straight"),
            ),
            Diagram(
                "9e",
                "9(e): object → camera",
                "object_to_camera_px",
                ends=("pixel_straight", "pixel_hot"),
            ),
            Diagram(
                "9f", "9(f): laser → camera", "laser_to_camera_px", ends=("pixel_cold", "pixel_hot")
            ),
        ),
    ),
    PaperFigure(
        "10b",
        "with pixels rounded to 0.25 px",
        "The spot on the sensor for a camera that finds it in steps of 0.25 px, and the measured"
        " points that this makes.",
        (
            Diagram("10b", "10(b): B − A on the sensor", "pixel_shift_px", step_px=ROUNDED_PX),
            Diagram("10b", "10(b): Bₘ − Aₘ", "measured_shift_um", step_px=ROUNDED_PX),
        ),
    ),
    PaperFigure(
        "11",
        "temperatures and poses",
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
OVERVIEW = dict(
    zip(
        ("|B − A| on the part", "|B − Bₘ|, hot", "|Bₘ − Aₘ|", "|B − A| on the sensor"),
        FIGURES[1].diagrams,
        strict=False,
    )
)


def figure_columns(part: str, curves: Curves, air: str) -> dict[str, NDArray[Any]]:
    """Columns of the file of one of the paper's diagrams in an air; none if there is nothing.

    y_mm, method, temperature and pose where there are several; the series with its norm.
    """
    columns: dict[str, NDArray[Any]] = {}
    for diagram in (d for figure in FIGURES for d in figure.diagrams if d.part == part):
        rays = diagram.rays(curves, air)
        if rays is None:
            continue
        names = ["y_mm", "method", *(["temperature_c", "beta_deg"] * bool(diagram.settings[1:]))]
        names += [*diagram.ends, diagram.series]
        every = rays.columns()
        for name in names:
            columns |= {k: v for k, v in every.items() if k == name or k[:-2] == name}
        if getattr(rays, diagram.series).ndim == 2:
            columns[f"{diagram.series}_norm"] = euclidean(getattr(rays, diagram.series))
    return columns


def draw_figure(figure: PaperFigure, curves: Curves) -> Picture | None:
    """One of the paper's figures: its diagrams below each other, beside each other the airs."""
    panels = []
    for diagram in figure.diagrams:
        for air in AIRS:
            rays = diagram.rays(curves, air)
            if rays and not (diagram.ends and np.isnan(_norm(diagram, rays)).all()):
                draw = _draw_arrow if diagram.ends else _draw_rays
                panels.append(
                    Panel(
                        f"{diagram.title}, {air}",
                        partial(draw, diagram=diagram, rays=rays),
                        _in_words(diagram, rays, air),
                        layout=None,
                    )
                )
    if not panels:
        return None
    title = f"Figure {figure.name} of Beermann et al. 2018: {figure.caption}"
    return draw_picture(
        f"{title}. Lines: ray search. Markers: rendered frames.", panels, 3, CELL_IN
    )


def draw_airs(curves: Curves) -> Picture:
    """Norms of figure 7, from all airs in one diagram each."""
    panels = []
    for title, diagram in OVERVIEW.items():
        rays = {air: each for air in AIRS if (each := diagram.rays(curves, air))}
        sizes = [f"{air} {np.nanmax(_norm(diagram, each)):.3g}" for air, each in rays.items()]
        alt = (
            f"Norm of the nine rays in three airs. Largest in {_unit(diagram)}: {', '.join(sizes)}."
        )
        draw = partial(_draw_airs, diagram=diagram, rays=rays)
        panels.append(Panel(title, draw, f"{title}: {alt}", layout=None))
    return draw_picture("What the three airs do, seen from above at 1250 °C", panels)


def _draw_airs(axes: Axes, diagram: Diagram, rays: Mapping[str, Rays]) -> None:
    keys = []
    for number, (air, each) in enumerate(rays.items()):
        keys.append(_curve(axes, each, _norm(diagram, each), air, colour(air), _MARKERS[number]))
    _finish(axes, diagram, keys)


def _norm(diagram: Diagram, rays: Rays) -> Array:
    values = getattr(rays, diagram.series)
    return euclidean(values) if values.ndim == 2 else values


def _unit(diagram: Diagram) -> str:
    return "px" if diagram.series.endswith("px") else "µm"


def _in_words(diagram: Diagram, rays: Rays, air: str) -> str:
    """Alternative text of a diagram."""
    norm = _norm(diagram, rays)
    most = f", up to {np.nanmax(norm):.3g} {_unit(diagram)}" if np.isfinite(norm).any() else ""
    what = "one ray on the sensor" if diagram.ends else "over y from 0 to -10 mm"
    methods = ", ".join(dict.fromkeys(rays.method.tolist()))
    stated = "".join(f" The paper: {s.claim} {s.paper}." for s in diagram.stated)
    return f"{diagram.title} {what} in {air} air: {methods}{most}.{stated}"


def _draw_rays(axes: Axes, diagram: Diagram, rays: Rays) -> None:
    """Components and norm in one setting, or the norm in several."""
    values = getattr(rays, diagram.series)
    keys = []
    if diagram.settings[1:]:
        by, colours, words = (
            (rays.temperature_c, _TEMPERATURES, "{:g} °C")
            if diagram.settings == HOTTER
            else (rays.beta_deg, _POSES, "β = {:g}°")
        )
        norm = euclidean(values)
        for (value, each), marker in zip(colours.items(), _MARKERS, strict=True):
            of = np.where(by == value, norm, np.nan)
            keys.append(_curve(axes, rays, of, words.format(value), each, marker, by == value))
    else:
        components = "" if values.ndim == 1 else "uv" if values.shape[1] == 2 else "xyz"
        for name, of in zip(components, values.T, strict=False):
            marker = {"x": "o", "y": "s", "u": "s", "z": "^", "v": "^"}[name]  # u runs along y
            keys.append(_curve(axes, rays, of, f"Δ{name}", colour(name), marker))
        last = "norm" if components else "distance"
        keys.append(_curve(axes, rays, _norm(diagram, rays), last, colour("norm"), "D"))
    _finish(axes, diagram, keys)


def _curve(
    axes: Axes,
    rays: Rays,
    values: Array,
    label: str,
    shade: str,
    marker: str,
    rows: NDArray[np.bool_] | None = None,
) -> Line2D:
    """The search as a line, rendered dots as markers, a rendered line as crosses."""
    rows = np.full(len(values), True) if rows is None else rows
    looks: dict[str, dict[str, Any]] = {
        SEARCHED: {},
        DOTS: {"marker": marker, "ls": "none", "mfc": "white"},
        LINE: {"marker": "x", "ls": "none", "ms": 6.0},
    }
    for method, look in looks.items():
        mine = rows & (rays.method == method)
        axes.plot(rays.y_mm[mine], values[mine], color=shade, **look)
    return Line2D([], [], color=shade, marker=marker, mfc="white", label=label)


def _finish(axes: Axes, diagram: Diagram, keys: Sequence[Line2D]) -> None:
    """The paper's numbers, axes and key."""
    handles = list(keys)
    for statement in diagram.stated:
        axes.axhline(statement.stated, color=GREY, ls="--", lw=1.0, zorder=1)
    if diagram.stated:
        said = [f"{statement.stated:g}" for statement in diagram.stated]
        said = said if said[1:] else [statement.paper for statement in diagram.stated]
        handles.append(Line2D([], [], color=GREY, ls="--", label=f"paper: {', '.join(said)}"))
    if diagram.log:
        axes.set_yscale("log")
        decimal_ticks(axes.yaxis)
    axes.set_xlim(0.5, -10.5)
    axes.set_xticks([0.0, -2.5, -5.0, -7.5, -10.0])
    axes.set_xlabel("y of the laser ray in mm", labelpad=1)
    axes.set_ylabel(_unit(diagram), labelpad=1)
    _key_below(axes, handles)


def _key_below(axes: Axes, handles: Sequence[Any]) -> None:
    """The key in a strip of its own below the axes."""
    assert isinstance(axes.figure, Figure)
    axes.figure.subplots_adjust(bottom=_KEY_IN / axes.figure.get_figheight())
    axes.figure.legend(
        handles=handles, loc="lower center", ncols=len(handles), columnspacing=0.8, handlelength=1.3
    )


def _draw_arrow(axes: Axes, diagram: Diagram, rays: Rays) -> None:
    """One ray's displacement on the sensor, with the other points for orientation."""
    known = np.flatnonzero(np.isfinite(_norm(diagram, rays)))
    row = int(known[-1])  # rendered, if there is such a one
    places = {name: getattr(rays, name)[row] for name in _POINTS}
    start, end = (places[name] for name in diagram.ends)
    arrow = {"arrowstyle": "-|>", "color": "black", "shrinkA": 0, "shrinkB": 0, "lw": 1.6}
    axes.annotate("", end, start, arrowprops=arrow)
    axes.plot([start[0], end[0], end[0]], [start[1], start[1], end[1]], color=GREY, lw=0.8, ls=":")
    keys = []
    for name, (label, of, filling) in _POINTS.items():
        look = {"color": colour(of), "mfc": filling or colour(of), "marker": "o", "ms": 6.0}
        axes.plot(*places[name], ls="none", **look)
        keys.append(Line2D([], [], ls="none", label=label.replace("B (hot), if", "B,"), **look))
    corners = np.array(list(places.values()))
    half = 0.65 * max(float(np.ptp(corners, axis=0).max()), _LEAST_PX)
    u, v = 0.5 * (corners.min(axis=0) + corners.max(axis=0))
    axes.set(
        xlim=(u - half, u + half), ylim=(v + half, v - half), xlabel="u in px", ylabel="v in px"
    )
    axes.set_box_aspect(1.0)
    axes.set_anchor("W")
    axes.locator_params(nbins=5)
    du, dv = end - start
    axes.text(
        1.05, 0.5, f"Δu = {du:.2f} px\nΔv = {dv:.2f} px\n\n{rays.method[row]}".replace("-", "−"),
        transform=axes.transAxes, va="center",
    )  # fmt: skip
    _key_below(axes, keys)


def draw_whole_line(whole: Mapping[Setting, Curve]) -> Picture:
    """B_m - A_m on both sides of the line: by temperature, by pose, by component; airs beside."""
    panels = []
    airs = [air for air in AIRS if any(setting.air == air for setting in whole)]
    for title, of in (
        ("|Bₘ − Aₘ| from above", {Setting("", t, 0.0): c for t, c in _TEMPERATURES.items()}),
        ("|Bₘ − Aₘ| at 1250 °C", {Setting("", HOTTEST_C, b): c for b, c in _POSES.items()}),
        ("Bₘ − Aₘ from above, 1250 °C", {}),
    ):
        for air in airs:
            draw = partial(_draw_line, whole=whole, air=air, of=of)
            alt = f"{title} over y from -11 to 11 mm in {air} air, by ray search."
            panels.append(Panel(f"{title}, {air}", draw, alt, layout=None))
    title = "Both sides of the line: how far the measured point moves when the part is hot"
    return draw_picture(f"{title}. Shaded: the paper's half.", panels, len(airs), CELL_IN)


def _draw_line(
    axes: Axes, whole: Mapping[Setting, Curve], air: str, of: Mapping[Setting, str]
) -> None:
    axes.axvspan(*PAPERS_HALF_MM, color="0.95", zorder=0)
    if of:
        by_pose = len({setting.beta_deg for setting in of}) > 1
        for setting, shade in of.items():
            curve = whole.get(Setting(air, setting.temperature_c, setting.beta_deg))
            if curve is not None:
                label = f"β = {setting.beta_deg:g}°" if by_pose else f"{setting.temperature_c:g} °C"
                norm = euclidean(curve.rays().measured_shift_um)
                axes.plot(curve.y_mm, norm, color=shade, label=label)
    elif (curve := whole.get(Setting(air))) is not None:
        moved = curve.rays().measured_shift_um
        for name, values in zip("xyz", moved.T, strict=True):
            axes.plot(curve.y_mm, values, color=colour(name), label=f"Δ{name}")
    axes.set(xlim=(11.5, -11.5), xlabel="y of the laser ray in mm", ylabel="µm")
    _key_below(axes, axes.get_lines())


def draw_poses(poses: Mapping[Setting, Curve]) -> Picture:
    """abs(B_m - A_m) over beta and y, a map for each air, in logarithmic colours.

    Grey where a point was not found.
    """
    maps: dict[str, tuple[Array, Array, Array]] = {}
    for air in dict.fromkeys(setting.air for setting in poses):
        mine = {setting.beta_deg: curve for setting, curve in poses.items() if setting.air == air}
        norms = [euclidean(curve.rays().measured_shift_um) for curve in mine.values()]
        maps[air] = np.array(list(mine)), next(iter(mine.values())).y_mm, np.array(norms)
    every = np.concatenate([size.ravel() for _, _, size in maps.values()])
    known = every[np.isfinite(every) & (every > 0.0)]
    norm = LogNorm(*((known.min(), known.max()) if known.size else (1.0, 10.0)))
    panels = [
        Panel(
            f"|Bₘ − Aₘ| from all poses, {air}",
            partial(_draw_map, beta_deg=beta, y_mm=y, size=size, norm=norm),
            f"Map over beta from 0 to 90° and y from -11 to 11 mm in {air} air: largest from above"
            f" ({_most(size[0])} µm), least from the side ({_most(size[-1])} µm at most).",
        )
        for air, (beta, y, size) in maps.items()
    ]
    levels = ", ".join(f"{level:g}" for level in _levels())
    title = f"From every side, 1250 °C. Lines: {levels} µm, which the paper states. Grey: not found"
    return draw_picture(title, panels, 3, CELL_IN)


def _most(size: Array) -> str:
    return f"{np.nanmax(size):.3g}" if np.isfinite(size).any() else "unknown"


def _levels() -> list[float]:
    """Numbers of the paper's that are sizes of deviations."""
    return sorted(s.stated for s in FITTED if s.of and s.of.series.endswith("_um.norm"))


def _draw_map(axes: Axes, beta_deg: Array, y_mm: Array, size: Array, norm: LogNorm) -> None:
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
    """For each broadened air the cost of its parameter, and what the fit leaves."""
    panels = []
    for air, fit in fits.items():
        missed = int(np.sum(np.abs(fit.residual) > TOLERANCE))
        panels += [
            Panel(
                f"Cost of a blur, {air} air",
                partial(_draw_cost, fit=fit),
                f"Sum of squared relative residuals over the blur of {air} air; least at"
                f" {fit.fitted_mm:g} mm.",
            ),
            Panel(
                f"Ours minus the paper's, {air} air",
                partial(_draw_residuals, fit=fit),
                f"Relative residuals of {len(fit.residual)} numbers in {air} air;"
                f" {missed} are missed by more than {100 * TOLERANCE:g} %.",
            ),
        ]
    return draw_picture("How broad was the paper's plume? One parameter, fitted", panels)


def _draw_cost(axes: Axes, fit: Fit) -> None:
    axes.plot(fit.tried_mm, fit.cost, "o-", color="black")
    axes.axvline(fit.fitted_mm, color=colour(fit.air), label=f"fitted: {fit.broadening}")
    axes.set(yscale="log", xlabel="blur in mm", ylabel="sum of squared relative residuals")
    decimal_ticks(axes.yaxis)
    axes.legend()


def _draw_residuals(axes: Axes, fit: Fit) -> None:
    """Relative difference of each number as a bar, the numbers themselves above it."""
    percent = 100.0 * fit.residual
    shown = np.clip(percent, -100.0, 100.0)
    within = np.abs(fit.residual) <= TOLERANCE
    place = np.arange(len(percent))
    axes.barh(place, shown, color=np.where(within, colour("ok"), colour("failed")), height=0.35)
    most = max(200.0 * TOLERANCE, float(np.nanmax(np.abs(shown), initial=0.0)))
    for y, statement, value, ours in zip(place, FITTED, percent, fit.ours, strict=True):
        kept = value == 0.0 and statement.check == "bound"
        apart = "kept" if kept else f"{value:+.0f} %" if np.isfinite(value) else "unknown"
        words = f"{statement.claim}: {statement.paper}, ours {ours:.3g} ({apart})"
        box = {"facecolor": "white", "edgecolor": "none", "pad": 0.5}
        axes.text(-1.2 * most, y - 0.25, words.replace("-", "−"), fontsize=9, va="bottom", bbox=box)
    for bound in (-TOLERANCE, TOLERANCE):
        axes.axvline(100.0 * bound, color=GREY, ls="--", lw=0.9)
    axes.axvline(0.0, color="black", lw=0.6)
    axes.set(xlim=(-1.2 * most, 1.2 * most), ylim=(len(place) - 0.5, -0.8), yticks=[])
    axes.set_xlabel(f"relative difference in %; dashed: {100 * TOLERANCE:g} %")


def draw_reconstruction(results: Mapping[Setting, Reconstruction]) -> Picture:
    """Residuals of the fitted cylinders along the line, and the errors of their radii."""
    panels = []
    for air in dict.fromkeys(setting.air for setting in results):
        mine = [setting for setting in results if setting.air == air]
        shown = max(mine, key=lambda setting: (-setting.beta_deg, setting.temperature_c))
        spread = results[shown].residual_std_um[-1, 1]
        panels.append(
            Panel(
                f"Residual of the fit, {air}",
                partial(_draw_residual, result=results[shown]),
                f"Distance of the measured points from the fitted cylinder over y: {shown};"
                f" standard deviation {spread:.3g} µm when hot.",
                layout=None,
            )
        )
    draw: Callable[..., None] = partial(_draw_radii, results=results)
    alt = "Error of the fitted radius with its 95 % interval, by setting and arc: see the table."
    panels.append(Panel("Error of the radius", draw, alt, width=min(2, len(panels)), height=2))
    title = "A cylinder fitted to the points of a scan: does a hot one measure too small?"
    return draw_picture(title, panels, 3, CELL_IN)


def _draw_residual(axes: Axes, result: Reconstruction) -> None:
    for state, name in enumerate(STATES):
        axes.plot(result.y_mm, result.radial_residual_um(state), color=colour(name), label=name)
    axes.set(xlim=(11.5, -11.5), xlabel="y of the laser ray in mm", ylabel="point − cylinder in µm")
    _key_below(axes, axes.get_lines())


def _draw_radii(axes: Axes, results: Mapping[Setting, Reconstruction]) -> None:
    """Error of the radius with its interval: a row for each setting, a marker for each arc."""
    labelled = set()
    for row, result in enumerate(results.values()):
        for number, arc in enumerate(result.arc_mm):
            for state, name in enumerate(STATES):
                error = result.error_um[number, state]
                low, high = result.interval_um[number, state]
                label = f"{name}, |y| ≤ {arc:g} mm"
                axes.errorbar(
                    error,
                    row + 0.2 * (number - 0.5 * (len(result.arc_mm) - 1)),
                    xerr=np.abs([[error - low], [high - error]]),
                    fmt="o^sDv"[number % 5],
                    color=colour(name),
                    ms=5,
                    capsize=3,
                    label=None if label in labelled else label,
                )
                labelled.add(label)
    axes.axvline(0.0, color="black", lw=0.6)
    axes.set_xscale("symlog", linthresh=10.0)
    axes.xaxis.set_major_formatter("{x:g}")
    axes.set_yticks(range(len(results)), [str(setting) for setting in results])
    axes.invert_yaxis()
    axes.set_xlabel("fitted minus true radius in µm; linear up to ±10 µm, logarithmic beyond")
    axes.legend(loc="lower right")
