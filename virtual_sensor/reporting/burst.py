"""A burst's files: the sway along the line and of the probe rays, frames, a picture and a page."""

from __future__ import annotations

from functools import partial
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np
from matplotlib.axes import Axes
from matplotlib.figure import Figure
from numpy.typing import NDArray

from virtual_sensor.files import RESULTS_SIGN
from virtual_sensor.imaging.image_files import save_png
from virtual_sensor.imaging.render import EXR_LAYERS, Frame, write_exr
from virtual_sensor.imaging.scene import Scene
from virtual_sensor.records import write_ply
from virtual_sensor.reporting.files import FileOf, write_results
from virtual_sensor.reporting.page import PAGE, Page, Section
from virtual_sensor.reporting.pictures import Panel, Picture, draw_picture
from virtual_sensor.reporting.style import colour, drawable, write_beside
from virtual_sensor.reporting.tables import Column, TextTable, text_table
from virtual_sensor.reporting.words import counted, in_words
from virtual_sensor.studies.burst import (
    Burst,
    BurstSummary,
    FrameTable,
    RayTable,
    Sway,
    SwayTable,
    spread,
)

if TYPE_CHECKING:
    from virtual_sensor.imaging.recording import RecordedFrame

FRAMES, PICTURE = "frames", "report.png"
_WHITE = 1.5  # of the first frame's brightest pixel: others may be brighter
FILES = (
    FileOf(PAGE, "The burst as a page."),
    FileOf(PICTURE, "The same figures at a glance."),
    FileOf("sway.csv", "Mean and standard deviation along the line.", SwayTable),
    FileOf("probe_rays.csv", "Mean and standard deviation of the probe rays.", RayTable),
    FileOf("frames.csv", "Each frame's line and points.", FrameTable),
    FileOf("sway.ply", "The mean points, mm, world; their intensity is the height's sway in µm."),
    FileOf(RESULTS_SIGN, "The figures of the burst; written last.", BurstSummary),
    FileOf(f"{FRAMES}/*.exr", "With --images, each frame with its ground truth.", EXR_LAYERS),
    FileOf(
        f"{FRAMES}/*.png",
        f"With --images, each frame in 16 bits; white is {_WHITE:g} times the first one's maximum."
        " Of recorded frames those that end with _recorded.png are the sensor's grey values.",
    ),
)

Array = NDArray[np.float64]


class FrameFiles:
    """Writes each frame of a burst into a folder, as EXR and as PNG, named by number and instant.

    Parameters
    ----------
    folder : Path
        Of the burst's results.
    scene : Scene
        Whose parameters the EXR files name.
    """

    def __init__(self, folder: Path, scene: Scene) -> None:
        self._folder = folder / FRAMES
        self._header = {f"virtual_sensor/{k}": v for k, v in scene.parameters.items()}
        self._white = 0.0

    def __call__(
        self, number: int, instant_s: float, frame: Frame, shot: RecordedFrame | None = None
    ) -> None:
        """Write one frame."""
        self._white = self._white or _WHITE * float(frame.radiance.max())
        name = f"{number:04d}_{instant_s:.6f}s"
        header = self._header | {"virtual_sensor/time": f"{instant_s:.9g}"}
        write_exr(self._folder / f"{name}.exr", frame, header)
        save_png(frame.radiance, self._folder / f"{name}.png", 16, white=self._white or None)
        if shot is not None:
            save_png(shot, self._folder / f"{name}_recorded.png")


def save(result: Burst, folder: Path, command: str) -> None:
    """Write a burst's files (`FILES`, but for the frames) into a folder that is there.

    Raises
    ------
    InputError
        If they can't be written.
    """
    picture, line = draw(result), result.sway_table
    write_ply(folder / "sway.ply", line.mean_mm, line.std_height_um)
    contents = {
        "sway.csv": line,
        "probe_rays.csv": result.ray_table,
        "frames.csv": result.frame_table,
        PICTURE: picture,
        PAGE: page(result, picture, command),
        RESULTS_SIGN: result.summary,
    }
    write_results(folder, FILES, contents)


def table(figures: BurstSummary) -> TextTable:
    """What sways how much, and where most."""
    rows = {
        "line: centre v, px": figures.line.v_px,
        "... by moving air alone, px": figures.line.ideal_v_px,
        "... by the sensor alone, px": figures.line.noise_v_px,
        "line: measured y, µm": figures.line.y_um,
        "line: measured height, µm": figures.line.height_um,
        "probe rays: pixel u, px": figures.rays.u_px,
        "probe rays: pixel v, px": figures.rays.v_px,
        "probe rays: measured height, µm": figures.rays.measured_height_um,
    }
    shown = [
        {"what": what, "sway": sway}
        for what, sway in rows.items()
        if sway is not None and sway.largest_frames
    ]
    return text_table(
        shown,
        [
            Column("what", "standard deviation"),
            Column("sway.median", "median"),
            Column("sway.largest", "largest"),
            Column("sway.largest_y_mm", "at y along the line, in mm"),
            Column("sway.largest_frames", "frames", "{:d}"),
        ],
    )


def lead(figures: BurstSummary) -> str:
    """Where the measured height sways most, how much, and beside which error that stays."""
    sway = figures.line.height_um
    if not sway.largest_frames:
        return "No column of the image has a line in three frames: nothing is known of its sway."
    in_some = sway.largest_frames < figures.frames
    seen = f", seen in {sway.largest_frames} of them" if in_some else ""
    there = in_words(figures.static_error_at_largest_um, "{:.3g}")
    along = in_words(figures.static_error.rms_um, "{:.3g}")
    return (
        f"Over {figures.frames} frames the measured height sways by up to {sway.largest:.3g} µm"
        f" (standard deviation), at y = {sway.largest_y_mm:.3g} mm along the line{seen}; the"
        f" median along it is {sway.median:.3g} µm. The error that stays, of the mean points, is"
        f" {there} µm there and {along} µm rms along the line."
    )


def page(result: Burst, picture: Picture, command: str) -> Page:
    """The page of a burst."""
    figures = result.summary
    name = result.scene.path.stem
    of_field = (
        f"Field: {figures.field.file}, {figures.field.source or 'of unknown source'};"
        f" {counted(figures.field.instants, 'instant')} from {figures.field.first_s:g} to"
        f" {figures.field.last_s:g} s. A frame took {figures.time_per_frame_s:.2g} s."
    )
    return Page(
        f"Sway of {name} in moving air",
        lead(figures),
        (
            Section("How the line sways", picture),
            Section("Figures", table(figures), of_field),
            Section(
                "Some frames",
                "Each frame, cut to what is lit, and below it its difference to the mean of all"
                " frames: where the line has moved, one side is brighter and the other darker.",
                draw_views(result),
            ),
        ),
        command,
        figures.made_with,
        figures.notes,
    )


# The picture.


def draw(result: Burst) -> Picture:
    """Draw the line's sway over time, in the image and of the points, and the error that stays."""
    line, rays, figures = result.sway_table, result.ray_table, result.summary
    panels = [
        Panel(
            "The line's centre minus its mean, over time",
            partial(draw_over_time, result=result),
            "A map of the line's centre minus its mean, over column and time",
            width=2,
        ),
        Panel(
            "Sway of the measured height",
            partial(
                _std, line=line, x=line.y_mm, std=line.std_height_um, unit="µm", label="y in mm"
            ),
            "Standard deviation of the measured height over y,"
            f" {_words(figures.line.height_um, 'µm')}",
        ),
        Panel(
            "Sway of the line in the image",
            partial(_std, line=line, x=line.column, std=line.std_v_px, unit="px", label="u in px"),
            "Standard deviation of the line's row over the column,"
            f" {_words(figures.line.v_px, 'px')}",
        ),
        Panel(
            "The error that stays, and the sway about it",
            partial(_static, line=line),
            "Distance of the mean points from the true section over y,"
            f" {in_words(figures.static_error.rms_um, '{:.3g}')} µm rms",
        ),
        Panel(
            "Probe rays: measured above lit point",
            partial(_ray_heights, rays=rays),
            "Mean and standard deviation of the probe rays' measured height over the true one",
        ),
        Panel(
            "Sway of the probe rays' pixels",
            partial(_ray_pixels, rays=rays),
            f"Standard deviation of the probe rays' pixels, {_words(figures.rays.v_px, 'px')}",
            width=2,
        ),
    ]
    first, last = figures.first_frame_s, figures.last_frame_s
    name = drawable(result.scene.path.stem)
    title = f"{name}: {figures.frames} frames of moving air, {first:.4g} to {last:.4g} s"
    return draw_picture(title, panels)


def _words(sway: Sway, unit: str) -> str:
    largest, median = (in_words(value, "{:.3g}") for value in (sway.largest, sway.median))
    return f"at most {largest} {unit}, median {median} {unit}"


def draw_over_time(axes: Axes, result: Burst) -> None:
    """The line's centre minus its mean, over column and time."""
    centres = result.centres_px
    sway = centres[..., 1] - spread(centres).mean[:, 1]
    seen = np.flatnonzero(np.isfinite(sway).any(axis=0))
    first, end = (seen[0], seen[-1] + 1) if seen.size else (0, sway.shape[1])
    shown = sway[:, first:end]
    largest = float(np.nanmax(np.abs(shown), initial=0.0)) or 1.0
    drawn = axes.pcolormesh(
        *(np.arange(first, end), result.time_s, shown),
        cmap="RdBu_r",
        vmin=-largest,
        vmax=largest,
        shading="nearest",
        rasterized=True,
    )
    axes.figure.colorbar(drawn, ax=axes, label="v - mean in px", pad=0.01)
    axes.grid(False)
    axes.set(xlabel="u in px, along the line", ylabel="flow time in s")


def _std(axes: Axes, line: SwayTable, x: NDArray[Any], std: Array, unit: str, label: str) -> None:
    """A standard deviation along the line: columns of every frame as a line, others as rings."""
    always = line.frames == line.frames.max(initial=0)
    hot = colour("hot")
    axes.plot(x, np.where(always, std, np.nan), color=hot)
    axes.plot(x[~always], std[~always], "o", ms=4, mfc="none", color=hot)
    axes.set(xlabel=label, ylabel=f"standard deviation in {unit}")
    known = np.isfinite(std)
    if not known.any():
        return
    at = int(np.nanargmax(std))
    axes.set_ylim(0.0, 1.2 * std[at])
    where = f"{std[at]:.3g} {unit}"
    if not always[at]:
        where += f", in {line.frames[at]} of {line.frames.max()} frames"
    left = x[at] < np.nanmean(x[known])
    write_beside(axes, f"largest: {where}", (x[at], std[at]), (8 if left else -8, 12))
    axes.plot(x[at], std[at], "o", ms=6, color=hot)
    if np.any(known & ~always):
        axes.set_xlabel(f"{label}   (○ not in every frame)")


def _static(axes: Axes, line: SwayTable) -> None:
    """The mean points' distance from the true section, and a standard deviation on either side."""
    y, error, std = line.y_mm, line.static_error_um, line.std_height_um  # gaps are NaN
    axes.fill_between(y, error - std, error + std, color=colour("hot"), alpha=0.3, lw=0)
    axes.plot(y, error, color=colour("hot"))
    axes.axhline(0.0, color="0.6", lw=0.8)
    axes.set(xlabel="y in mm", ylabel="mean minus true in µm, ± sway")


def _ray_heights(axes: Axes, rays: RayTable) -> None:
    """How far above its true place each ray's point is measured, and how steadily."""
    figures = rays.y_mm, rays.mean_error_um, rays.std_error_um
    axes.errorbar(*figures, fmt="s", capsize=4, color=colour("search"))
    axes.axhline(0.0, color="0.6", lw=0.8)
    axes.set(xlabel="y of the ray in mm", ylabel="height of B$_m$ over B in µm, ± sway")


def _ray_pixels(axes: Axes, rays: RayTable) -> None:
    shade = colour("search")
    styles = {"along the line (u)": ("o--", shade), "across it (v)": ("s-", "white")}
    for std, (name, (style, fill)) in zip(rays.std_px.T, styles.items(), strict=True):
        axes.plot(rays.y_mm, std, style, color=shade, mfc=fill, label=name)
    axes.set(xlabel="y of the ray in mm", ylabel="standard deviation in px")
    top = np.nanmax(rays.std_px, initial=0.0) or 1.0
    axes.set_ylim(0.0, 1.25 * top)
    axes.legend(loc="upper center", ncols=2)


def draw_views(result: Burst) -> Picture:
    """Draw some frames, each above its difference to the mean of all."""
    views = result.views
    peak = float(views.mean.max()) or 1.0
    percent = {t: 100.0 * (each - views.mean) / peak for t, each in views.radiance.items()}
    most = {time: float(np.abs(each).max()) for time, each in percent.items()}
    largest = max(most.values()) or 100.0
    (height, width), left, top = views.mean.shape, views.first_column - 0.5, views.first_row - 0.5
    box: dict[str, Any] = {"aspect": "auto", "extent": (left, left + width, top + height, top)}

    def draw(figure: Figure, time: float) -> None:
        above, below = figure.subplots(2, 1, sharex=True)
        above.imshow(views.radiance[time] / peak, cmap="gray", vmin=0.0, vmax=1.0, **box)
        shown = below.imshow(percent[time], cmap="RdBu_r", vmin=-largest, vmax=largest, **box)
        figure.colorbar(shown, ax=below, label="% of peak", pad=0.01)
        for axes in (above, below):
            axes.grid(False)
            axes.set_ylabel("v in px")
        below.set_xlabel("u in px")

    panels = [
        Panel(
            f"At {time:.4g} s, and minus the mean",
            partial(draw, time=time),
            f"The frame at {time:.4g} s and its difference to the mean of all, at most"
            f" {most[time]:.2g} % of the peak",
            width=2,
            axes=False,
        )
        for time in views.radiance
    ]
    return draw_picture("", panels)
