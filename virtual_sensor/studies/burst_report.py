"""One page of pictures of a burst: how the line and the points measured on it sway."""

import textwrap
from pathlib import Path
from typing import Any

import numpy as np
from matplotlib.axes import Axes
from matplotlib.figure import Figure

from virtual_sensor.files import written_whole
from virtual_sensor.metrology.deviation import UM_PER_MM
from virtual_sensor.studies.burst import Burst, spread

_RAYS = "#c8321e"


def draw_burst(result: Burst, figures: dict[str, Any], path: Path) -> None:
    """Draw the page as a PNG; `figures` is the burst's summary."""
    figure = Figure(figsize=(13.5, 9.5), dpi=110, layout="constrained")
    axes = figure.subplot_mosaic(
        [["film", "film", "film"], ["pixel", "point", "probes"], ["text", "text", "rays"]],
        height_ratios=[1.2, 1.2, 0.8],
    )
    figure.suptitle(
        f"{result.scene.path.stem}: {len(result.time_s)} frames from {result.time_s[0]:.3g} to"
        f" {result.time_s[-1]:.3g} s of moving air",
        fontsize=13,
    )
    _film(axes["film"], result)
    _pixel(axes["pixel"], result)
    _point(axes["point"], result)
    _probes(axes["probes"], result)
    _ray_pixels(axes["rays"], result)
    _text(axes["text"], result, figures)
    with written_whole(path) as temporary:
        figure.savefig(temporary, format="png")


def _film(axes: Axes, result: Burst) -> None:
    """The line's centre minus its mean, over column and time."""
    centres = result.centres_px
    sway = centres[..., 1] - spread(centres).mean[:, 1]
    seen = np.flatnonzero(np.isfinite(sway).any(axis=0))
    shown = sway[:, seen[0] : seen[-1] + 1] if seen.size else sway
    largest = float(np.nanmax(np.abs(shown), initial=0.0)) or 1.0
    u = np.arange(shown.shape[1]) + (seen[0] if seen.size else 0)
    drawn = axes.pcolormesh(
        *(u, result.time_s, shown),
        cmap="RdBu_r",
        vmin=-largest,
        vmax=largest,
        shading="nearest",
        rasterized=True,
    )
    axes.figure.colorbar(drawn, ax=axes, label="v - mean in px", pad=0.01)
    axes.set(xlabel="u in px (along the line)", ylabel="flow time in s")
    axes.set_title("The line's centre minus its mean over the burst")


def _pixel(axes: Axes, result: Burst) -> None:
    line = spread(result.centres_px)
    always = line.frames == len(result.time_s)  # the ends' columns are often beside the line
    axes.plot(result.lines[0].column, np.where(always, line.std[:, 1], np.nan), lw=1.0)
    axes.set(xlabel="u in px", ylabel="standard deviation of v in px")
    axes.set_title("Sway of the line in the image")
    axes.set_ylim(bottom=0.0)


def _point(axes: Axes, result: Burst) -> None:
    points = spread(result.with_height(result.points_mm))
    always = points.frames == len(result.time_s)
    y, std_um = points.mean[always, 1], points.std[always] * UM_PER_MM
    for component, label in enumerate(("x", "y", "z", "height along the laser's axis")):
        axes.plot(y, std_um[:, component], lw=1.6 if component == 3 else 0.8, label=label)
    axes.set(xlabel="y in mm", ylabel="standard deviation in µm")
    axes.set_title("Sway of the points measured in a column")
    axes.set_ylim(0.0, 1.3 * axes.get_ylim()[1])  # room for the legend
    axes.legend(fontsize=8, loc="upper center", ncols=2)


def _probes(axes: Axes, result: Burst) -> None:
    """How far above its true place each ray's point is measured, and how steadily."""
    error = (result.measured_mm - result.incidence_mm) @ result.up * UM_PER_MM
    of_rays = spread(error[..., None])
    axes.errorbar(
        *(result.probe_y_mm, of_rays.mean[:, 0]),
        yerr=of_rays.std[:, 0],
        fmt="o",
        ms=4,
        capsize=4,
        color=_RAYS,
    )
    axes.axhline(0.0, color="0.7", lw=0.6)
    axes.invert_xaxis()
    axes.set(xlabel="y of the laser ray in mm", ylabel="height of B$_m$ above B in µm")
    axes.set_title("Probe rays, mean ± standard deviation")


def _ray_pixels(axes: Axes, result: Burst) -> None:
    rays = spread(result.rays_px)
    for axis, name in enumerate("uv"):
        axes.plot(result.probe_y_mm, rays.std[:, axis], "o-", ms=3, lw=1.0, label=name)
    axes.invert_xaxis()
    axes.set(xlabel="y of the laser ray in mm", ylabel="standard deviation in px")
    axes.set_title("Sway of the probe rays' pixels")
    axes.set_ylim(bottom=0.0)
    axes.legend(fontsize=8)


def _text(axes: Axes, result: Burst, figures: dict[str, Any]) -> None:
    """The figures that a reader asks for first."""
    lines = []
    for group in ("standard deviation along the line", "standard deviation of the probe rays"):
        lines.append(f"{group[0].upper()}{group[1:]}:")
        for name, value in figures[group].items():
            if value.get("median") is not None:
                lines.append(
                    f"  {name}: median {value['median']:.3g}, at most {value['largest']:.3g}"
                )
    seconds = ", ".join(f"{name} {value:.1f} s" for name, value in result.seconds.items())
    lines += [f"{figures['seconds per frame']:.1f} s per frame (all frames: {seconds})"]
    for words in (figures["field"]["source"], *result.notes):
        lines += textwrap.wrap(words, 110)
    text = axes.text(0.0, 1.0, "\n".join(lines), va="top", fontsize=8.5)
    text.set_in_layout(False)
    axes.set_axis_off()
