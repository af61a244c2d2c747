"""One page of pictures of a measurement: for people who would rather look than read."""

from pathlib import Path

import numpy as np
from matplotlib.axes import Axes
from matplotlib.figure import Figure
from numpy.typing import NDArray

from virtual_sensor.files import written_whole
from virtual_sensor.metrology.deviation import euclidean
from virtual_sensor.metrology.line_peaks import Status
from virtual_sensor.metrology.triangulation import triangulate
from virtual_sensor.optics.ray_search import ray_search
from virtual_sensor.studies.measure import (
    NINE_RAYS_MM,
    Measurement,
    State,
    nine_ray_deviations,
    summary,
)

_COLOURS = {"cold": "#1f5fa8", "hot": "#c8321e"}
_MARGIN_PX = 12


def draw_report(result: Measurement, path: Path) -> None:
    """Draw the page as a PNG."""
    figure = Figure(figsize=(13.0, 9.2), dpi=110, layout="constrained")
    axes = figure.subplot_mosaic(
        [["frame", "frame", "air"], ["height", "nine", "air"], ["residual", "residual", "text"]],
        height_ratios=[1.25, 1.0, 0.8],
    )
    scene = (result.hot or result.cold).scene
    figure.suptitle(f"{scene.path.stem}: what the sensor sees and measures", fontsize=13)
    _frame(axes["frame"], result)
    _air(axes["air"], result)
    _height(axes["height"], result)
    _nine_rays(axes["nine"], result)
    _residual(axes["residual"], result)
    _text(axes["text"], result)
    with written_whole(path) as temporary:
        figure.savefig(temporary, format="png")


def _frame(axes: Axes, result: Measurement) -> None:
    name, state = list(result.states.items())[-1]
    image = state.frame.radiance
    rows, columns = np.nonzero(image > 0.01 * image.max())
    top, bottom = rows.min() - _MARGIN_PX, rows.max() + _MARGIN_PX
    left, right = columns.min() - _MARGIN_PX, columns.max() + _MARGIN_PX
    axes.imshow(image, cmap="gray", aspect="auto", interpolation="nearest")
    for label, drawn in result.states.items():
        axes.plot(drawn.line.column, drawn.line.row, color=_COLOURS[label], lw=0.9, label=label)
    axes.set(xlim=(left, right), ylim=(bottom, top), xlabel="u in px (along the line)")
    axes.set(ylabel="v in px", title=f"Camera frame, {name} part, with the line centres found")
    axes.legend(loc="lower center", ncols=2)


def _air(axes: Axes, result: Measurement) -> None:
    """The air in the plane x = 0, with the light's ways drawn in."""
    state = result.hot
    if state is None or state.scene.field is None:
        axes.text(0.5, 0.5, "no index field:\nlight runs straight", ha="center", va="center")
        axes.set_axis_off()
        return
    low, high = state.scene.field.box
    x, z = np.linspace(low[0], high[0], 200), np.linspace(low[2], high[2], 300)
    grid = np.stack(np.meshgrid(x, [0.0], z, indexing="ij"), axis=-1)
    n = state.scene.field.refractivity(grid.reshape(-1, 3)).reshape(len(x), len(z))
    drawn = axes.pcolormesh(x, z, n.T * 1e5, cmap="magma", shading="nearest", rasterized=True)
    axes.figure.colorbar(drawn, ax=axes, label="$10^5\\,(n-1)$ at y = 0", shrink=0.8)
    sensor = state.scene.sensor
    middle = state.dense.laser_point_mm[len(state.dense.status) // 2]
    for name, pose in (("laser", sensor.laser.pose), ("camera", sensor.camera.pose)):
        origin = pose.origin_mm
        axes.plot([origin[0], middle[0]], [origin[2], middle[2]], "c-", lw=1.0)
        axes.annotate(name, (origin[0], origin[2]), color="c", ha="center", va="bottom")
    axes.set(xlabel="x in mm", ylabel="z in mm", title="Air and light paths (seen along y)")
    axes.set_aspect("equal")


def _height(axes: Axes, result: Measurement) -> None:
    """How far the measured section is from the true one, across the whole line."""
    for name, state in result.states.items():
        y, error = _section_error(state, state.points_mm[state.line.status == Status.OK])
        axes.plot(y, error, color=_COLOURS[name], lw=1.2, label=f"{name}, rendered")
        searched = triangulate(state.scene.sensor, state.dense.pixel)
        y, error = _section_error(state, searched[np.isfinite(searched[:, 0])])
        axes.plot(y[::8], error[::8], "o", ms=2.5, mfc="none", color=_COLOURS[name])
    axes.plot([], [], "o", ms=2.5, mfc="none", color="k", label="ray search")
    axes.axhline(0.0, color="0.7", lw=0.6)
    axes.set(xlabel="y in mm", ylabel="measured - true z in µm", title="Error of the section")
    axes.legend(fontsize=8)


def _section_error(
    state: State, measured_mm: NDArray[np.float64]
) -> tuple[NDArray[np.float64], NDArray[np.float64]]:
    """Height of measured points over the true section in the laser plane, in um, by y.

    The true section is where the straight sheet meets the surface: the cold incidence points.
    """
    half = 0.55 * state.scene.sensor.laser.length_mm
    cold = ray_search(state.scene.cold(), np.linspace(-half, half, 801)).laser_point_mm
    cold = cold[np.isfinite(cold[:, 0])]
    order = np.argsort(cold[:, 1])
    height = np.interp(measured_mm[:, 1], cold[order, 1], cold[order, 2], left=np.nan, right=np.nan)
    return measured_mm[:, 1], np.asarray((measured_mm[:, 2] - height) * 1e3)


def _nine_rays(axes: Axes, result: Measurement) -> None:
    """The paper's figure 7: norms of its differences."""
    d = nine_ray_deviations(result)
    for label, values in (
        ("B - A", d.incidence_um),
        ("B - B$_m$", d.hot_um),
        ("B$_m$ - A$_m$", d.measured_um),
        ("A - A$_m$", d.cold_um),
    ):
        axes.plot(NINE_RAYS_MM, euclidean(values), "o-", ms=3, lw=1.0, label=label)
    axes.invert_xaxis()
    axes.set(xlabel="y of the laser ray in mm", ylabel="distance in µm")
    axes.set_title("The paper's nine rays")
    axes.legend(fontsize=8)


def _residual(axes: Axes, result: Measurement) -> None:
    for name, state in result.states.items():
        agreement = state.agreement
        label = f"{name}: rms {agreement.rms_px:.4f} px, at most {agreement.largest_px:.4f} px"
        axes.plot(
            agreement.column, agreement.difference_px, color=_COLOURS[name], lw=0.8, label=label
        )
    axes.axhline(0.0, color="0.7", lw=0.6)
    axes.set(xlabel="u in px", ylabel="Δv in px", title="Rendered line minus ray search")
    axes.legend(fontsize=8)


def _text(axes: Axes, result: Measurement) -> None:
    figures = summary(result)
    lines = [f"{name}  {value:.3g} µm" for name, value in figures["nine_rays_um"].items() if value]
    for name, state in result.states.items():
        found = int(np.sum(state.line.status == Status.OK))
        spent = state.seconds["render"]
        lines.append(f"{name}: {found} line centres, rendered in {spent:.1f} s")
    lines += [f"whole measurement: {result.seconds:.1f} s", *result.told]
    axes.text(0.0, 1.0, "\n".join(lines), va="top", fontsize=8.5, wrap=True)
    axes.set_axis_off()
