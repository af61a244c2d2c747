"""Poses of a fringe sensor that were compared: maps of one scale, figures, and a page."""

from __future__ import annotations

from collections.abc import Iterator
from pathlib import Path

import numpy as np
from matplotlib.axes import Axes

from virtual_sensor.files import RESULTS_SIGN, folder_written_whole
from virtual_sensor.records import Described, write_arrays
from virtual_sensor.reporting.files import FileOf, write_results
from virtual_sensor.reporting.maps import Scale, draw_map, scale_of
from virtual_sensor.reporting.page import PAGE, Content, Page, Section
from virtual_sensor.reporting.pictures import Panel, Picture, draw_picture
from virtual_sensor.reporting.style import ALONG, LINES, colour, drawable
from virtual_sensor.reporting.tables import Column, TextTable, text_table
from virtual_sensor.reporting.words import listed, micrometres
from virtual_sensor.studies.fringes.poses import (
    CRITERIA,
    PoseMaps,
    PosesCompared,
    PosesSummary,
    PoseTable,
)

COMMAND = "fringes poses"
MAPS = "maps.npz"
_MOST_MAPS = 12
"""Poses whose maps are drawn."""

_LAYERS = (
    Described("name", "", "Of each of K poses."),
    Described("pixel", "px", "Camera pixels (K, R, C, 2)."),
    Described("projector_pixel", "px", "That they see (K, R, C, 2); NaN where none."),
    Described("point_mm", "mm", "Of the part, world (K, R, C, 3)."),
    Described("straight_um", "µm", "Distance from the part as if light ran straight (K, R, C)."),
    Described("bent_um", "µm", "The same through the scene's air."),
    Described("epipolar_px", "px", "Epipolar residual (K, R, C)."),
)
FILES = (
    FileOf(PAGE, "The page to open first."),
    FileOf("report.png", "The maps and figures at a glance."),
    FileOf("poses.csv", "The figures of all poses.", PoseTable),
    FileOf(MAPS, "The maps of all poses, NumPy's arrays by name.", _LAYERS),
    FileOf(RESULTS_SIGN, "The figures, and what they were made with.", PosesSummary),
)


def save(
    result: PosesCompared, folder: Path, command: str, overwrite: bool = False
) -> PosesSummary:
    """Write the files (`FILES`), all of them or none, and give the summary.

    Raises
    ------
    InputError
        If the folder exists (and `overwrite` is not set) or can't be written.
    """
    with folder_written_whole(folder, overwrite) as place:
        layers = {
            each.name: np.stack([getattr(pose, each.name) for pose in result.poses])
            for each in _LAYERS[1:]
        }
        names = np.array([each.figures.name for each in result.poses])
        write_arrays(place / MAPS, {"name": names, **layers})
        drawn = picture(result)
        contents = {
            "poses.csv": result.table,
            "report.png": drawn,
            PAGE: page(result, drawn, command),
            RESULTS_SIGN: result.summary,
        }
        write_results(place, FILES, contents)
    return result.summary


def pose_table(result: PosesCompared) -> TextTable:
    """What a pose is chosen by."""
    best = result.best.name
    return text_table(
        result.table,
        (
            Column("name", "pose"),
            Column("score", "score", "{:.2f}"),
            Column("mean_distance_mm", "distance", "{:.1f}"),
            Column("resolution_um", "pixel", "{:.1f}"),
            Column("incidence_deg", "incidence", "{:.1f}"),
            Column("coverage", "coverage", "{:.1%}"),
        ),
        f"Distance in mm, pixel in µm, incidence in °; the score weighs {_weights(result)}",
        [each.figures.name == best for each in result.poses],
    )


def deviation_tables(result: PosesCompared) -> list[TextTable]:
    """What the air does in each pose, and the cylinder through the points."""
    lights = {"straight": "As if light ran straight"}
    if np.isfinite(result.table.bent_rms_um).any():
        lights["bent"] = "Through the air"
    tables = []
    for light, words in lights.items():
        columns = [Column("name", "pose"), Column(f"{light}_rms_um", "rms", micrometres)]
        if np.isfinite(getattr(result.table, f"{light}_fit_std_um")).any():
            columns += [
                Column(f"{light}_radius_error_um", "radius off", micrometres),
                Column(f"{light}_fit_std_um", "std", micrometres),
            ]
        if light == "straight":
            columns.append(Column("epipolar_px", "epipolar, px"))
        caption = f"{words}: distance from the part, and the cylinder through the points"
        tables.append(text_table(result.table, columns, caption))
    return tables


def section_table(result: PosesCompared) -> TextTable | None:
    """Fringes beside a laser line; None where no pose has both."""
    pairs = [(each.figures.name, each.figures.section) for each in result.poses]
    rows = [{"name": name, "pair": pair} for name, pair in pairs if pair is not None]
    if not rows:
        return None
    return text_table(
        rows,
        (
            Column("name", "pose"),
            Column("pair.straight.line_rms_um", "line", micrometres),
            Column("pair.straight.areal_rms_um", "fringes", micrometres),
            Column("pair.straight.difference_rms_um", "apart", micrometres),
            Column("pair.bent.difference_rms_um", "apart in air", micrometres),
        ),
        "Along a laser line in the projector's place, rms; as if light ran straight",
    )


def on_console(result: PosesCompared) -> list[TextTable | str]:
    """What the command prints."""
    section = section_table(result)
    return [pose_table(result), *deviation_tables(result), *([section] if section else [])]


def lead(result: PosesCompared) -> str:
    """The best pose, and how much the air does over all."""
    rms = result.table.straight_rms_um
    worst, least = int(np.nanargmax(rms)), int(np.nanargmin(rms))
    names = result.table.name
    hot = np.nanmax(rms) > 1e-3
    criteria = listed([name for name in CRITERIA if result.weights[name]])
    without = "" if result.weights["air"] or not hot else ", which leaves the air out (--weights)"
    chosen = f"By {criteria}{without}, {result.best.name} is the best."
    best = chosen if len(names) > 1 else ""
    if not hot:
        return best or "Light runs straight, and the points lie on the part."
    spread = (
        f"Measured as if light ran straight, the surface is off by {micrometres(rms[least])} rms"
        f" ({names[least]}) to {micrometres(rms[worst])} ({names[worst]})."
        if len(names) > 1
        else f"Measured as if light ran straight, the surface is off by {micrometres(rms[0])} rms."
    )
    return f"{spread} {best}".strip()


def _weights(result: PosesCompared) -> str:
    """The criteria and their weights, in words."""
    whole = sum(result.weights.values())
    return listed([f"{n} {w / whole:.0%}" for n, w in result.weights.items() if w])


def picture(result: PosesCompared) -> Picture:
    """Maps of all poses in one scale, and what they do over the poses."""
    shown = result.poses[:_MOST_MAPS]
    scales = {
        name: scale_of("signed", *(getattr(each, name) for each in shown))
        for name in ("straight_um", "epipolar_px")
    }
    panels = [deviation_panel(each, scales["straight_um"]) for each in shown]
    if len(result.poses) > 1:
        panels.append(score_panel(result))
    hottest = max(shown, key=lambda each: each.figures.epipolar_px)
    if hottest.figures.epipolar_px > 1e-3:
        panels.append(epipolar_panel(hottest, scales["epipolar_px"]))
    if hottest.figures.section is not None:
        panels.append(section_panel(hottest))
    title = f"{drawable(result.poses[0].scene.path.stem)}: {lead(result)}"
    return draw_picture(title, panels, columns=3)


def deviation_panel(pose: PoseMaps, scale: Scale) -> Panel:
    """Distance of points by straight light from the part, pixel by pixel."""
    figures = pose.figures.straight
    rms = micrometres(figures.rms_um)

    def draw(axes: Axes) -> None:
        draw_map(axes, pose.straight_um, "µm", scale)
        _in_camera(axes, pose)

    alt = f"Distance from the part as if light ran straight, {pose.figures.name}: {rms} rms."
    return Panel(f"{drawable(pose.figures.name)}: {rms} rms", draw, alt)


def epipolar_panel(pose: PoseMaps, scale: Scale) -> Panel:
    """What no shape can cause."""

    def draw(axes: Axes) -> None:
        draw_map(axes, pose.epipolar_px, "px", scale)
        _in_camera(axes, pose)

    alt = f"Epipolar residual, {pose.figures.name}: {pose.figures.epipolar_px:.3g} px rms."
    return Panel(f"Epipolar residual, {drawable(pose.figures.name)}", draw, alt)


def section_panel(pose: PoseMaps) -> Panel:
    """A laser line's section, and that of the fringes in the same pixels of the camera."""
    found, name = pose.sections, drawable(pose.figures.name)
    words = {"straight": "straight", "bent": "through the air"}

    def draw(axes: Axes) -> None:
        for number, light in enumerate(found.line_um):
            style = {"ls": LINES[number], "lw": 1.3}
            lines = (("laser line", found.line_um, "cold"), ("fringes", found.areal_um, "hot"))
            for sensor, distance, paint in lines:
                label = f"{sensor}, {words[light]}"
                axes.plot(
                    found.along_mm, distance[light], color=colour(paint), label=label, **style
                )
        axes.set(xlabel=ALONG, ylabel="outside (+) or inside the part (−), µm")
        axes.legend()

    alt = f"Distance from the part along a laser line, by that line and by fringes, {name}."
    return Panel(f"Line sensor and areal sensor, {name}", draw, alt)


def _in_camera(axes: Axes, pose: PoseMaps) -> None:
    """Ticks of a grid's map in the camera's pixels."""
    u, v = pose.pixel[0, :, 0], pose.pixel[:, 0, 1]
    for axis, values in ((axes.xaxis, u), (axes.yaxis, v)):
        low, high = sorted(axis.get_view_interval())
        at = np.unique(np.linspace(np.ceil(low), np.floor(high), 4).round().astype(int))
        at = at[at < len(values)]
        axis.set_ticks(at, labels=[f"{values[i]:.0f}" for i in at])


def score_panel(result: PosesCompared) -> Panel:
    """The scores, the best first in sight."""
    names = [drawable(name) for name in result.table.name]

    def draw(axes: Axes) -> None:
        paints = [
            colour("hot" if each.figures.name == result.best.name else "cold")
            for each in result.poses
        ]
        axes.barh(range(len(names)), result.table.score, color=paints, height=0.6)
        axes.set_yticks(range(len(names)), names)
        axes.invert_yaxis()
        axes.set(xlabel="score, 0 to 1", xlim=(0.0, 1.05))

    return Panel("Which pose to choose", draw, f"Scores of the poses, by {_weights(result)}.")


def page(result: PosesCompared, drawn: Picture, command: str) -> Page:
    """The page."""
    section = section_table(result)
    figures = result.summary
    criteria = listed([name for name in CRITERIA if result.weights[name]])
    sections = [
        Section("Deviation maps", drawn, *deviation_tables(result)),
        Section(
            "Which pose to choose",
            pose_table(result),
            f"The score is the weighted mean of {criteria}, each as its ratio to that of the best"
            " pose. Distance is the mean from the camera to the surface, the pixel what one sees of"
            " the surface, incidence the mean angle of the line of sight to the surface's normal"
            " (its cosine counts), and coverage the share of the camera's pixels that see the part"
            " in the projector's light.",
        ),
        *([Section("Line sensor and areal sensor", *_of_section(section))] if section else []),
    ]
    return Page(
        f"{Path(figures.scene).stem}: {len(result.poses)} poses compared",
        lead(result),
        tuple(sections),
        command,
        figures.made_with,
        figures.notes,
    )


def _of_section(table: TextTable) -> Iterator[Content]:
    yield table
    yield (
        "A telecentric laser line stands in the projector's place, and both are seen by the same"
        " pixels of the camera. As if light ran straight they differ in hot air, since their light"
        " takes other paths to the part; through the air they agree."
    )
