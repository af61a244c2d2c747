"""One page of pictures of a measurement: for people who would rather look than read."""

import textwrap
from itertools import product
from pathlib import Path

import numpy as np
from matplotlib.axes import Axes
from matplotlib.figure import Figure
from numpy.typing import NDArray

from virtual_sensor.files import written_whole
from virtual_sensor.metrology.deviation import UM_PER_MM, euclidean
from virtual_sensor.metrology.triangulation import triangulate
from virtual_sensor.metrology.truth import DotErrors
from virtual_sensor.optics.ray_search import incidence_points
from virtual_sensor.studies.measure import Measurement, Summary, probe_deviations

Array = NDArray[np.float64]

_COLOURS = {"cold": "#1f5fa8", "hot": "#c8321e"}
_MARGIN_PX = 12
_TEXT_LETTERS, _TEXT_LINES = 68, 24


def draw_report(result: Measurement, figures: Summary, path: Path) -> None:
    """Draw the page as a PNG; `figures` is the measurement's summary."""
    # Fixed margins: a layout engine would draw all of it twice, to see how large the labels are.
    figure = Figure(figsize=(13.5, 9.5), dpi=110)
    axes = figure.subplot_mosaic(
        [
            ["frame", "frame", "along"],
            ["height", "probes", "across"],
            ["residual", "residual", "text"],
        ],
        height_ratios=[1.3, 1.2, 0.8],
        width_ratios=[1.0, 1.0, 0.9],
        gridspec_kw={
            **{"left": 0.075, "right": 0.975, "bottom": 0.055, "top": 0.92},
            **{"wspace": 0.22, "hspace": 0.38},
        },
    )
    scene = (result.hot or result.cold).scene
    figure.suptitle(f"{scene.path.stem}: what the sensor sees and measures", fontsize=13)
    _frame(axes["frame"], result)
    _air(axes["along"], result, across=False)
    _air(axes["across"], result, across=True)
    _height(axes["height"], result)
    _probe_rays(axes["probes"], result)
    _residual(axes["residual"], result)
    _text(axes["text"], result, figures)
    with written_whole(path) as temporary:
        figure.savefig(temporary, format="png", pil_kwargs={"compress_level": 1})


def _frame(axes: Axes, result: Measurement) -> None:
    name, state = list(result.states.items())[-1]
    image = state.frame.radiance
    rows, columns = np.nonzero(image > 0.01 * image.max())
    height, width = image.shape
    top, bottom = max(rows.min() - _MARGIN_PX, 0), min(rows.max() + _MARGIN_PX, height)
    left, right = max(columns.min() - _MARGIN_PX, 0), min(columns.max() + _MARGIN_PX, width)
    extent = (left - 0.5, right - 0.5, bottom - 0.5, top - 0.5)
    axes.imshow(image[top:bottom, left:right], cmap="gray", aspect="auto", extent=extent)
    for label, drawn in result.states.items():
        style = "+" if drawn.dots else "-"
        axes.plot(*drawn.centres_px.T, style, color=_COLOURS[label], lw=0.9, label=label)
    axes.set(xlim=extent[:2], ylim=extent[2:], xlabel="u in px (along the line)")
    axes.set(ylabel="v in px", title=f"Camera frame, {name} part, with the line centres found")
    axes.legend(loc="lower center", ncols=2)


def _air(axes: Axes, result: Measurement, across: bool) -> None:
    """The air in a plane through the part, with the light's ways drawn in: x = 0, or y = 0."""
    state = result.hot
    if state is None or state.scene.field is None:
        axes.text(0.5, 0.5, "no index field:\nlight runs straight", ha="center", va="center")
        axes.set_axis_off()
        return
    field, axis = state.scene.field, 1 if across else 0
    corners = field.to_world(np.array(list(product(*field.box.T))))
    low, high = corners.min(axis=0), corners.max(axis=0)
    side, z = np.linspace(low[axis], high[axis], 240), np.linspace(low[2], high[2], 320)
    points = np.zeros((len(side), len(z), 3))
    points[..., axis], points[..., 2] = side[:, None], z
    n = field.refractivity(points.reshape(-1, 3)).reshape(len(side), len(z))
    drawn = axes.pcolormesh(side, z, n.T * 1e5, cmap="magma", shading="nearest", rasterized=True)
    axes.figure.colorbar(drawn, ax=axes, label="$10^5\\,(n-1)$", pad=0.02)
    ends = state.dense.laser_point_mm[np.isfinite(state.dense.laser_point_mm[:, 0])]
    for name, pose, colour in (
        ("laser", state.scene.sensor.laser.pose, "#35e06a"),
        ("camera", state.scene.sensor.camera.pose, "#4fd2ff"),
    ):
        for number, end in enumerate(ends[[0, len(ends) // 2, -1]]):
            start = pose.origin_mm
            if name == "laser":
                start, _ = (v[0] for v in state.scene.sensor.laser.family.rays(0.0, [end[1]]))
            way = np.stack([start, end])
            label = name if number == 0 else None
            axes.plot(way[:, axis], way[:, 2], color=colour, lw=0.9, label=label)
    axes.set_xlim(min(low[axis], axes.get_xlim()[0]), max(high[axis], axes.get_xlim()[1]))
    axes.legend(loc="upper right", fontsize=8)
    plane = "x = 0" if across else "y = 0"
    axes.set(xlabel="y in mm" if across else "x in mm", ylabel="z in mm")
    axes.set_title(f"The air in the plane {plane}, and the light's ways")


def _height(axes: Axes, result: Measurement) -> None:
    """How far the measured section is from the true one, across the whole line.

    The true section is where the straight sheet meets the surface.
    """
    half = 0.55 * result.cold.scene.sensor.laser.length_mm
    section = incidence_points(result.cold.scene, np.linspace(-half, half, 801))
    section = section[np.isfinite(section[:, 0])]
    section = section[np.argsort(section[:, 1])]

    def error(points_mm: Array) -> tuple[Array, Array]:
        y, z = points_mm[:, 1:].T
        true = np.interp(y, section[:, 1], section[:, 2], left=np.nan, right=np.nan)
        return y, np.asarray((z - true) * UM_PER_MM)

    for name, state in result.states.items():
        style = "+" if state.dots else "-"
        y, error_um = error(state.points_mm)
        axes.plot(y, error_um, style, color=_COLOURS[name], lw=1.2, label=f"{name}, rendered")
        y, error_um = error(triangulate(state.scene.sensor, state.dense.pixel))
        some = slice(None, None, 1 if state.dots else 8)
        axes.plot(y[some], error_um[some], "o", ms=2.5, mfc="none", color=_COLOURS[name])
    axes.plot([], [], "o", ms=2.5, mfc="none", color="k", label="ray search")
    axes.axhline(0.0, color="0.7", lw=0.6)
    axes.set(xlabel="y in mm", ylabel="measured - true z in µm", title="Error of the section")
    axes.legend(fontsize=8)


def _probe_rays(axes: Axes, result: Measurement) -> None:
    """The paper's figure 7: norms of its differences."""
    d = probe_deviations(result)
    for label, values in (
        ("B - A", d.incidence_um),
        ("B - B$_m$", d.hot_um),
        ("B$_m$ - A$_m$", d.measured_um),
        ("A - A$_m$", d.cold_um),
    ):
        axes.plot(result.probe_y_mm, euclidean(values), "o-", ms=3, lw=1.0, label=label)
    axes.invert_xaxis()
    axes.set(xlabel="y of the laser ray in mm", ylabel="distance in µm")
    axes.set_title("Probe rays: points lit and measured")
    axes.legend(fontsize=8)


def _residual(axes: Axes, result: Measurement) -> None:
    for name, state in result.states.items():
        compared = state.compared
        label = f"{name}: nothing to compare"
        if np.isfinite(compared.rms_px):
            label = f"{name}: rms {compared.rms_px:.4f} px, at most {compared.largest_px:.4f} px"
        if isinstance(compared, DotErrors):
            u, dv = compared.true_pixel[:, 0], compared.error_px[:, 1]
            axes.plot(u, dv, "o", ms=3, color=_COLOURS[name], label=label)
        else:
            label += f", in {compared.column.size} of {state.centres} columns"
            u, dv = compared.column, compared.error_px
            gaps = np.flatnonzero(np.diff(u) > 1.5) + 1
            u, dv = np.insert(u, gaps, np.nan), np.insert(dv, gaps, np.nan)
            axes.plot(u, dv, color=_COLOURS[name], lw=0.8, label=label)
    axes.axhline(0.0, color="0.7", lw=0.6)
    what = "dots" if result.cold.dots else "line"
    axes.set(xlabel="u in px", ylabel="Δv in px", title=f"Rendered {what} minus ray search")
    axes.legend(fontsize=8)


def _text(axes: Axes, result: Measurement, figures: Summary) -> None:
    """The figures that a reader asks for first."""
    rays = figures.probe_rays
    lines = [f"{rays.rays} probe rays, {rays.lit} of them lit:"]
    for name, state in result.states.items():
        lines.append(f"{name}: {state.centres} centres, rendered in {state.render_time_s:.1f} s")
    lines.append(f"whole measurement: {result.time_s:.1f} s")
    lines += [line for note in result.notes for line in textwrap.wrap(note, _TEXT_LETTERS)]
    if len(lines) > _TEXT_LINES:
        lines = [*lines[: _TEXT_LINES - 1], "... and more in summary.json"]
    text = axes.text(0.0, 1.08, "\n".join(lines), va="top", fontsize=7.0)
    text.set_in_layout(False)
    axes.set_axis_off()
