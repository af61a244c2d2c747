"""A calibration by rendered frames: OpenCV's file, the marks, figures beside the truth, a page."""

from __future__ import annotations

from collections.abc import Callable
from pathlib import Path
from typing import Any

import numpy as np
from matplotlib.axes import Axes

from virtual_sensor.files import RESULTS_SIGN, folder_written_whole
from virtual_sensor.imaging.image_files import save_png
from virtual_sensor.imaging.scene import Scene
from virtual_sensor.metrology.fringes.target import MarkStatus
from virtual_sensor.reporting.files import FileOf, write_results
from virtual_sensor.reporting.page import PAGE, Page, Section
from virtual_sensor.reporting.pictures import Panel, Picture, draw_picture
from virtual_sensor.reporting.style import colour, drawable
from virtual_sensor.reporting.tables import Column, TextTable, text_table
from virtual_sensor.reporting.words import micrometres
from virtual_sensor.studies.fringes.calibrate import (
    CalibrationMarks,
    CalibrationSettings,
    CalibrationSummary,
    PoseFrames,
    VirtualCalibration,
    calibrate_scene,
)

COMMAND = "fringes calibrate"
CALIBRATION = "calibration.yaml"
FILES = (
    FileOf(PAGE, "The page to open first."),
    FileOf("report.png", "The target, and the residuals of its marks."),
    FileOf(CALIBRATION, "The camera and the projector in the scene's world: OpenCV's YAML."),
    FileOf("marks.csv", "The marks in all poses of the target.", CalibrationMarks),
    FileOf(
        "frames/pose_*.png",
        "The frames (`--frames`): a pose's patterns are in one scale.",
    ),
    FileOf(RESULTS_SIGN, "The figures, and what they were made with.", CalibrationSummary),
)
_TARGETS = {"checkerboard": "A checkerboard", "dots": "A plate of dots"}
_ARROWS = 40.0  # lengths of residuals as drawn: the rms is a so-many'th of the image's width
_BEYOND_SIGMAS = 3.0


def save(
    scene: Scene,
    settings: CalibrationSettings,
    folder: Path,
    command: str,
    frames: bool = False,
    overwrite: bool = False,
    report: Callable[[str, float], None] = lambda stage, fraction: None,
) -> VirtualCalibration:
    """Calibrate, and write the files (`FILES`), all of them or none.

    Parameters
    ----------
    scene : Scene
    settings : CalibrationSettings
    folder : Path
    command : str
        That was given.
    frames : bool
        Whether all frames are written.
    overwrite : bool
        Whether results that exist are replaced.
    report : callable
        Called with what is being done, and the fraction done.

    Raises
    ------
    InputError
        If the scene can't be calibrated, or the folder exists or can't be written.
    """
    bits = settings.recording.bits_of(scene)
    with folder_written_whole(folder, overwrite) as place:

        def keep(number: int, shots: PoseFrames) -> None:
            patterns = [f"pattern_{n:02d}" for n in range(len(shots.patterns))]
            both = (shots.lit[None], ["lamp"]), (shots.patterns, patterns)
            for (images, names), said in zip(both, shots.metadata, strict=True):
                white = None if bits else float(images.max()) or None
                for image, name in zip(images, names, strict=True):
                    path = place / "frames" / f"pose_{number:02d}_{name}.png"
                    save_png(image, path, bits or 16, white=white, metadata=said)

        result = calibrate_scene(scene, settings, report, keep if frames else None)
        report("writing the results", 0.98)
        result.calibration.write(place / CALIBRATION)
        drawn = picture(result)
        contents: dict[str, Any] = {
            "marks.csv": result.marks,
            "report.png": drawn,
            PAGE: page(result, drawn, command),
            RESULTS_SIGN: result.summary,
        }
        write_results(place, FILES, contents)
    return result


def _number(value: float) -> str:
    """Three digits, or all before the point."""
    return f"{value:.0f}" if abs(value) >= 100.0 else f"{value:.3g}"


def lead(result: VirtualCalibration) -> str:
    """What was found, in a sentence or two."""
    s = result.summary
    place = float(np.linalg.norm(s.position_error_um))
    turn = float(np.linalg.norm(s.turn_error_urad))
    air = "in the scene's hot air" if s.hot else "in homogeneous air"
    return (
        f"Calibrated {air} by {s.marks['found']} marks in {len(s.poses)} poses: marks lie"
        f" {s.camera_rms_px:.2g} px (camera) and {s.projector_rms_px:.2g} px (projector) rms from"
        f" the fit. The projector is found {micrometres(place)} and {_number(turn)} µrad from where"
        f" it stands, at most {_number(s.largest_sigmas)} of its standard deviations; the marks'"
        f" form is measured to {micrometres(s.shape_rms_um)} rms."
    )


def pose_table(result: VirtualCalibration) -> TextTable:
    """The projector's place and turns in the camera's frame, beside the truth."""
    s = result.summary
    rows: list[dict[str, Any]] = [
        {"name": f"{kind} {axis}", "error": error, "sigma": sigma, "by": abs(error) / sigma}
        for kind, errors, sigmas in (
            ("place, µm:", s.position_error_um, s.position_sigma_um),
            ("turn, µrad:", s.turn_error_urad, s.turn_sigma_urad),
        )
        for axis, error, sigma in zip("xyz", errors, sigmas, strict=True)
    ]
    columns = (
        Column("name", "projector to camera"),
        Column("error", "error", _number),
        Column("sigma", "standard deviation", _number),
        Column("by", "error by it", "{:.2f}"),
    )
    beyond = [float(row["by"]) > _BEYOND_SIGMAS for row in rows]
    return text_table(rows, columns, emphasised=beyond)


def parameter_table(result: VirtualCalibration) -> TextTable:
    """All parameters that were fitted."""
    columns = (
        Column("name", "parameter", str),
        Column("value", "found", "{:.8g}"),
        Column("truth", "truth", "{:.8g}"),
        Column("error", "error", "{:.2g}"),
        Column("sigma", "standard deviation", "{:.2g}"),
        Column("sigmas", "error by it", "{:.2f}"),
    )
    beyond = [each.sigmas > _BEYOND_SIGMAS for each in result.summary.estimated]
    return text_table(result.summary.estimated, columns, emphasised=beyond)


def figure_table(result: VirtualCalibration) -> TextTable:
    """What is left over, and what it does to points."""
    s = result.summary
    rows = (
        ("marks from the fit, camera, px", s.camera_rms_px),
        ("marks from the fit, projector, px", s.projector_rms_px),
        ("marks from the truth, camera, px", s.camera_error_px),
        ("marks from the truth, projector, px", s.projector_error_px),
        ("points by this calibration, from where they are, µm", s.volume_rms_um),
        ("the same, moved as one: their form, µm", s.shape_rms_um),
        ("points as seen, by this calibration, µm", s.seen_rms_um),
        ("points as seen, by the true devices, µm", s.seen_by_truth_rms_um),
    )
    named = [{"what": what, "rms": value} for what, value in rows]
    return text_table(named, (Column("what", ""), Column("rms", "rms", _number)))


def target_table(result: VirtualCalibration) -> TextTable:
    """The target's poses."""
    rows = [
        {
            "number": number,
            "tilt": each.tilt_deg,
            "height": each.position_mm[2],
            "found": each.marks["found"],
            "camera": each.camera_rms_px,
            "projector": each.projector_rms_px,
        }
        for number, each in enumerate(result.summary.poses)
    ]
    columns = (
        Column("number", "pose", "{}"),
        Column("tilt", "tilt, °", "{:.1f}"),
        Column("height", "z, mm", "{:.1f}"),
        Column("found", "marks", "{}"),
        Column("camera", "camera rms, px", "{:.2g}", "left out"),
        Column("projector", "projector rms, px", "{:.2g}", "left out"),
    )
    return text_table(rows, columns)


def on_console(result: VirtualCalibration) -> list[TextTable | str]:
    """What the command prints."""
    return [lead(result), pose_table(result), figure_table(result)]


def picture(result: VirtualCalibration) -> Picture:
    """The target with its marks, and the residuals of all."""
    size = {"camera": result.scene.camera.size, "projector": result.scene.projector.size}
    panels = [_target_panel(result)]
    panels += [_residual_panel(result, name, *size[name]) for name in size]
    return draw_picture(f"{drawable(result.scene.path.stem)}: calibration", panels, columns=3)


def _target_panel(result: VirtualCalibration) -> Panel:
    image, marks = result.first.lit, result.marks
    step = max(1, max(image.shape) // 600)
    first = marks.pose == 0
    good = first & (marks.status == MarkStatus.FOUND.name.lower())

    def draw(axes: Axes) -> None:
        height, width = image.shape
        extent = (-0.5, width - 0.5, height - 0.5, -0.5)
        axes.imshow(image[::step, ::step], cmap="gray", extent=extent, aspect="equal")
        for some, paint, label in (
            (good, "cold", "found"),
            (first & ~good & np.isfinite(marks.camera_px[:, 0]), "hot", "of the camera alone"),
        ):
            if some.any():
                u, v = marks.camera_px[some].T
                axes.plot(u, v, "+", color=colour(paint), ms=7, mew=1.5, label=label)
        axes.set(xlabel="u, px", ylabel="v, px")
        axes.grid(False)
        if axes.get_legend_handles_labels()[0]:
            axes.legend(loc="upper left", bbox_to_anchor=(1.0, 1.0))

    alt = f"The camera's image of the target in its first pose: {int(good.sum())} marks are found."
    return Panel("The target in its first pose", draw, alt)


def _residual_panel(result: VirtualCalibration, name: str, width: int, height: int) -> Panel:
    marks = result.marks
    pixel, residual = getattr(marks, f"{name}_px"), getattr(marks, f"{name}_residual_px")
    rms = getattr(result.summary, f"{name}_rms_px")
    scale = width / _ARROWS / max(rms, 1e-9)

    def draw(axes: Axes) -> None:
        known = np.isfinite(residual).all(axis=1)
        (u, v), (x, y) = pixel[known].T, residual[known].T * scale
        axes.quiver(
            u, v, x, y, color=colour("cold"), angles="xy", scale_units="xy", scale=1.0, width=0.002
        )
        axes.set(xlim=(-0.5, width - 0.5), ylim=(height - 0.5, -0.5), xlabel="u, px")
        axes.set(ylabel="v, px", aspect="equal")

    alt = f"Residuals of the marks in the {name}'s image, {rms:.2g} px rms, as arrows."
    return Panel(f"{name}: residuals, {rms:.2g} px rms, {scale:.0f} times as long", draw, alt)


def page(result: VirtualCalibration, drawn: Picture, command: str) -> Page:
    """The page."""
    s = result.summary
    sections = (
        Section(
            "The projector's pose",
            pose_table(result),
            "Found less truth, in the camera's frame. The standard deviations come from the fit's"
            " own residuals: they know what scatters, and nothing of what air does to all marks"
            " alike.",
        ),
        Section(
            "Residuals",
            drawn,
            figure_table(result),
            "Points are where the rays of camera and projector are nearest. A calibration that"
            " moves all points as one changes no form that is measured with it.",
        ),
        Section("All parameters", parameter_table(result)),
        Section(
            "The target",
            f"{_TARGETS[s.target]}: {s.columns} x {s.rows} marks, {s.pitch_mm:g} mm apart.",
            target_table(result),
        ),
        Section(
            "How to use it",
            f"`{CALIBRATION}` holds camera and projector in the scene's world, the camera where the"
            " scene has it. In Python `vs.FringeCalibration.read` reads it, and `vs.reconstruct`"
            " takes it in the scene's place. `projector_rotation` and `projector_translation` are R"
            " and T of OpenCV's `stereoCalibrate`.",
        ),
    )
    title = f"{result.scene.path.stem}: camera and projector calibrated"
    return Page(title, lead(result), sections, command, s.made_with, s.notes)
