"""A measurement's results: its picture, page and tables, and all files that it writes."""

from collections.abc import Iterator, Mapping, Sequence
from concurrent.futures import Future, ThreadPoolExecutor
from itertools import product, starmap
from operator import attrgetter
from pathlib import Path
from textwrap import shorten
from typing import Any

import numpy as np
from matplotlib.axes import Axes
from matplotlib.cm import ScalarMappable
from matplotlib.colors import Normalize
from matplotlib.figure import Figure
from numpy.typing import NDArray

from virtual_sensor.files import RESULTS_SIGN, folder_written_whole
from virtual_sensor.imaging.checks import LitLine
from virtual_sensor.imaging.column_truth import ColumnTruth
from virtual_sensor.imaging.image_files import save_png
from virtual_sensor.imaging.render import EXR_LAYERS, write_exr
from virtual_sensor.medium.index_field import IndexField
from virtual_sensor.metrology.calibration import calibration_of, calibration_text
from virtual_sensor.metrology.deviation import LETTERS, euclidean
from virtual_sensor.metrology.truth import DotErrors
from virtual_sensor.records import Table, write_ply
from virtual_sensor.reporting.error_split import (
    known_splits,
    part_table,
    split_on_console,
    split_panel,
    split_table,
    split_words,
)
from virtual_sensor.reporting.files import FileOf, write_results
from virtual_sensor.reporting.page import LIMITS, PAGE, Details, Page, Section
from virtual_sensor.reporting.pictures import (
    Panel,
    PanelPicture,
    Picture,
    beside,
    draw_picture,
    key_above,
)
from virtual_sensor.reporting.style import ALONG, LINES, MARKERS, colour, drawable
from virtual_sensor.reporting.tables import Column, TextTable, pair_table, text_table
from virtual_sensor.reporting.words import (
    NIL_UM,
    capital,
    counted,
    in_words,
    listed,
    micrometres,
    rounded,
    time_in_words,
)
from virtual_sensor.studies.error_split import SplitSummary, SplitTable
from virtual_sensor.studies.measure import (
    DenseTable,
    DotTable,
    LineTable,
    Measurement,
    ProbeTable,
    State,
    StateSummary,
    Summary,
    dense_table,
    dot_table,
    line_table,
    probe_deviations,
    probe_table,
    summary,
)

Array = NDArray[np.float64]
Curve = tuple[Array, Array, dict[str, Any]]
"""Its places, its values, and how `Axes.plot` draws it."""

CALIBRATION = "calibration.yaml"
"""The sensor as `detect --calibration` reads it."""

_U = "u along the line in px"
_MARGIN_PX = 12
_ON_BLACK = ("#56B4E9", "#FF7A2F")  # colours of cold and hot, as light as a black ground needs
_SEARCHED_EVERY = 10  # of the searched rays, drawn as circles
_AIR_NODES = 200
_LEAST_CONTRAST = 0.1  # of the planes' colours, 1e-5
_TITLE, _CLAUSE = 400, 130  # most letters: three lines, and less than one
_WHOLE_PX = 0.5  # a difference from which on a picture's unit is no longer 0.001 px
_LONGEST_STEP = 4.0  # times the usual one of searched points
_LETTERS = {
    name: letters.replace("-", "\N{MINUS SIGN}").replace("_m", "ₘ")
    for name, letters in LETTERS.items()
}
_UM, _PX, _COUNT = "µm", "{:.4f} px", "{}"
_AT_Y = "at y along line, mm"  # from its middle
_GHOST_WORDS = (
    "The part reflects light onto itself. What of it is brighter than the direct light is a ghost"
    " of the line; the frames' files have the light of each number of reflections by itself"
    " (indirect1.Y, ...), and which of the laser's rays make it."
)
_FIGURES = (  # key, words in the table of all, heading on the console ("" where not shown), format
    ("section.rms_um", "Measured minus true section, rms", "rms, µm", _UM),
    ("section.largest_um", "... the largest", "largest, µm", _UM),
    ("section.largest_y_mm", "... at y along the line, from its middle", _AT_Y, "{:.3g} mm"),
    ("section.points", "", "points", _COUNT),
    ("dots_minus_search.rms_px", "{seen} dots minus ray search, rms", "rms, px", _PX),
    ("dots_minus_search.largest_u_px", "... at most, along the line", "largest in u, px", _PX),
    ("dots_minus_search.largest_v_px", "... at most, across the line", "largest in v, px", _PX),
    ("dots_minus_search.found", "Dots found", "found", _COUNT),
    ("dots_minus_search.dots", "", "dots", _COUNT),
    ("line_minus_search.rms_px", "{seen} line minus ray search, rms", "rms, px", _PX),
    ("line_minus_search.largest_px", "... at most, line ends included", "largest, px", _PX),
    ("line_minus_search.centres", "Centres found", "centres", _COUNT),
    ("line_minus_search.compared", "... compared with the search", "compared", _COUNT),
    ("line_minus_search.cut_centres", "... left out, an edge cuts the line", "", _COUNT),
    ("line_minus_search.stray_centres", "... left out, off the searched line", "", _COUNT),
    ("line_minus_truth.wrong", "Centres that are ok and wrong by the frame's truth", "", _COUNT),
    ("ghosts.ghost_columns", "Columns that see a ghost of 1 % or more", "with a ghost", _COUNT),
    ("ghosts.columns", "... of columns with light of the line", "of columns", _COUNT),
    ("ghosts.ghost_over_line", "Ghost over line, median of the columns", "ghost / line", "{:.2g}"),
    ("ghosts.largest_ghost_over_line", "... in 95 % of them at most", "95 % below", "{:.2g}"),
    ("ghosts.indirect_share", "Light that was reflected in between", "of all light", "{:.1%}"),
    ("paper_search.largest_distance_um", "The paper's search: distance of {probes} rays", "", _UM),
    ("newton_search.largest_distance_um", "Newton's search: the same", "", _UM),
    ("newton_search.iterations", "Newton's search: marches a ray", "", _COUNT),
    ("render_time_s", "Frame of {film} px, {spp} samples per pixel", "rendered in", "{:.2f} s"),
    ("record_time_s", "Recording it", "", "{:.2f} s"),
    ("search_time_s", "Search of {rays} rays", "", "{:.2f} s"),
)


FILES = (
    FileOf(PAGE, "The page to open first."),
    FileOf("report.png", "The measurement at a glance."),
    FileOf("summary.json", "The figures of the measurement.", Summary),
    FileOf("table.md", "Accuracy and speed as a table."),
    FileOf("*.exr", "The frame, cold or hot, with its ground truth.", EXR_LAYERS),
    FileOf(
        "recorded_*.png",
        "The frame as it was recorded: grey values of the sensor's bits, with what made them.",
    ),
    FileOf("*.png", "The frame as a picture of 16 bits; cold and hot have one white."),
    FileOf("truth_*.csv", "What is true of the recorded line in each column.", ColumnTruth),
    FileOf("split_*.csv", "What the error of each recorded point is made of.", SplitTable),
    FileOf("line_*.csv", "The line's centres and the points measured there.", LineTable),
    FileOf("dots_*.csv", "The laser's dots, where it makes some.", DotTable),
    FileOf("points_*.ply", "The measured points, mm, world, with the line's brightness."),
    FileOf("probe_rays.csv", "The probe rays: points lit and measured.", ProbeTable),
    FileOf("dense_search.csv", "The rays searched along the whole line.", DenseTable),
    FileOf(CALIBRATION, "The sensor, as `detect --calibration` reads it."),
)


# The files.


def save(result: Measurement, folder: Path, command: str, overwrite: bool = False) -> Summary:
    """Write a measurement's files (`FILES`), all of them or none, and give its summary.

    `command` is the exact one that the results come from.

    Raises
    ------
    InputError
        If the folder exists (and `overwrite` is not set) or can't be written.
    """
    figures = summary(result)
    white = max(float(state.frame.radiance.max()) for state in result.states.values())
    with folder_written_whole(folder, overwrite) as place, ThreadPoolExecutor() as aside:
        written: list[Future[Any]] = []
        tables: dict[str, Table] = {}
        for name, state in result.states.items():
            facts = {**state.scene.parameters, "state": name}
            header = {f"virtual_sensor/{key}": value for key, value in facts.items()}
            # To compress one takes half a second, in which all the rest is written.
            written.append(aside.submit(write_exr, place / f"{name}.exr", state.frame, header))
            image = state.frame.radiance
            written.append(aside.submit(save_png, image, place / f"{name}.png", 16, white=white))
            tables[f"line_{name}.csv"] = line_table(state)
            if state.shot is not None:
                path = place / f"recorded_{name}.png"
                written.append(aside.submit(save_png, state.shot, path))
                tables[f"truth_{name}.csv"] = state.shot.truth
            if state.split is not None:
                tables[f"split_{name}.csv"] = state.split.table
            if state.dots:
                tables[f"dots_{name}.csv"] = dot_table(state)
            write_ply(place / f"points_{name}.ply", state.points_mm, state.brightness)
        sensor = calibration_of(result.cold.scene.sensor)
        whole, panels = picture(result, figures)
        contents = {
            **tables,
            "probe_rays.csv": probe_table(result),
            "dense_search.csv": dense_table(result),
            CALIBRATION: calibration_text(sensor, CALIBRATION),
            "report.png": whole,
            "table.md": _table_page(result, figures, command),
            PAGE: page(result, figures, panels, command),
            RESULTS_SIGN: figures,
        }
        for frame in written:
            frame.result()
        write_results(place, FILES, contents)
    return figures


def table(result: Measurement, figures: Summary) -> TextTable:
    """Accuracy and speed of a measurement, as the README shows them."""
    facts = {
        "film": " x ".join(map(str, result.scene.sensor.camera.size)),
        "spp": figures.made_with.samples_per_pixel,
        "probes": len(result.probe_y_mm),
        "rays": result.rays,
        "seen": _seen(figures).capitalize(),
    }
    states = figures.states
    without = ["line_" if result.cold.dots else "dots_"]
    without += ["record_time_s"] * (not _splits(figures)) + ["ghosts."] * (not _bounces(figures))
    rows = tuple(
        (words.format(**facts), *(_cell(attrgetter(key)(each), shape) for each in states.values()))
        for key, words, _, shape in _FIGURES
        if words and not key.startswith(tuple(without))
    )
    return TextTable(("", *states), rows, numeric=(False, *(True for _ in states)))


def _cell(value: Any, shape: str) -> str:
    return micrometres(value) if shape == _UM else in_words(value, shape)


def _table_page(result: Measurement, figures: Summary, command: str) -> str:
    made = figures.made_with
    return (
        f"{table(result, figures).markdown()}\nMade by `{command}` in"
        f" {figures.time_s:.0f} s, with"
        f" {counted(made.threads, 'thread')} ({made.variant}); the frames' march: {made.march}.\n"
    )


def on_console(figures: Summary) -> list[TextTable | str]:
    """What the command prints: how wrong the section is, why, and whether the check holds."""
    splits = known_splits(_splits(figures))
    said: list[TextTable | str] = [section_table(figures), *why(figures)]
    if splits:
        said += [split_on_console(splits), *split_words(splits)]
    said += [ghost_table(figures)] if _bounces(figures) else []
    return [*said, check_table(figures)]


def _bounces(figures: Summary) -> bool:
    """Whether light that was reflected in between was rendered."""
    return any(state.ghosts for state in figures.states.values())


def ghost_table(figures: Summary) -> TextTable:
    """How bright ghosts are beside the line."""
    return _on_console(
        figures,
        "Ghosts: light reflected in between; ghost over line is the median of columns",
        "ghosts.",
    )


def _splits(figures: Summary) -> dict[str, SplitSummary]:
    """What the error is made of, by the states that were recorded."""
    return {name: state.split for name, state in figures.states.items() if state.split}


def _seen(figures: Summary) -> str:
    """What the line was found in."""
    return "recorded" if _splits(figures) else "rendered"


def _seen_in(result: Measurement) -> str:
    """The same, of a measurement."""
    return "rendered" if result.cold.shot is None else "recorded"


def section_table(figures: Summary) -> TextTable:
    """How wrong the measured section is."""
    caption = "Measured minus true section (positive: outside the part)"
    return _on_console(figures, caption, "section", "render_time_s")


def check_table(figures: Summary) -> TextTable:
    """Whether renderer and ray search agree."""
    what = "dots" if any(s.dots_minus_search for s in figures.states.values()) else "line"
    return _on_console(
        figures, f"Check: {_seen(figures)} {what} minus ray search", f"{what}_minus_search"
    )


def _on_console(figures: Summary, caption: str, *keys: str) -> TextTable:
    """Those of the figures that have a heading, and keys that begin so; a row for each state."""
    columns = [Column("state", " ")]
    for key, _, heading, shape in _FIGURES:
        if heading and key.startswith(keys):
            shape = {_UM: "{:.3g}", "{:.3g} mm": "{:.3g}", _PX: "{:.4f}"}.get(shape, shape)
            columns.append(Column(key, heading, shape, "none"))
    rows = [{"state": name, **vars(state)} for name, state in figures.states.items()]
    return text_table(rows, columns, caption)


def _counts(statuses: Mapping[str, int]) -> str:
    """How many have each status, of those that occur."""
    return listed([f"{status} {count}" for status, count in statuses.items() if count])


def why(figures: Summary) -> list[str]:
    """Sentences on how far hot air moves points, and by which light path; [] of a cold part."""
    hot = figures.states.get("hot")
    if hot is None or hot.paths is None:
        return []
    rays, paths = figures.probe_rays, hot.paths
    shift_um, across_um = rays.largest_measured_shift_um, abs(hot.section.largest_um)
    along = ": mostly along the section, where it does no harm" * (across_um < 0.5 * shift_um)
    return [
        f"Hot air bends both light paths: the laser's makes {micrometres(paths.laser_rms_um)} rms"
        f" of the section's error, the camera's {micrometres(paths.camera_rms_um)} rms.",
        f"Hot air moves the lit point by up to {micrometres(rays.largest_incidence_shift_um)}, the"
        f" measured one by up to {micrometres(shift_um)}{along} ({rays.lit} of {rays.rays} probe"
        " rays are lit).",
    ]


# The page.


def page(
    result: Measurement,
    figures: Summary,
    panels: Mapping[str, PanelPicture],
    command: str,
) -> Page:
    """The page of a measurement."""
    sections = [
        Section(
            "The measured section",
            *why(figures)[:1],
            beside(panels, "section", "paths"),
            section_table(figures),
            "The true section is where straight light of the sheet's middle meets the part. Each"
            " point's distance from it is positive outside the part. y is counted along the line,"
            " from its middle: where the laser's axis meets the part.",
            *_at_edges(figures),
        ),
        Section("What the camera sees", beside(panels, "frame", "air")),
    ]
    if _bounces(figures):
        sections.append(Section("Ghosts", _GHOST_WORDS, ghost_table(figures)))
    if splits := known_splits(_splits(figures)):
        sections.insert(
            1,
            Section(
                "What the error is made of",
                *split_words(splits),
                beside(panels, "split"),
                split_table(splits),
                part_table(splits),
                "Stage by stage, from straight light to grey values, the line's place moves. What a"
                " stage adds is the distance of the point measured there from the true section,"
                " minus the one before it: the parts of each point add up to its error, those of"
                " all points are split_*.csv. Squares of parts that have nothing to do with each"
                " other add up to that of the whole.",
            ),
        )
    if result.hot:
        sections.append(
            Section(
                "Points lit and measured",
                *why(figures)[1:],
                beside(panels, "letters", "probes"),
                _probe_rays_table(result),
            )
        )
    parameters = pair_table(("parameter", "value"), figures.parameters)
    each = figures.states.items()
    sections += [
        Section(
            f"Check: {_seen(figures)} line against ray search",
            f"The line's centres in the {_seen(figures)} frames stand beside a search by rays,"
            " without any image: what separates them is the error of rendering and detecting"
            + (", and what recording adds." if _splits(figures) else "."),
            beside(panels, "check"),
            table(result, figures),
            *starmap(_compared, each),
        ),
        Section(
            "Settings",
            *starmap(_frame_words, each),
            Details("All parameters of the scene", (parameters,)),
        ),
    ]
    title = f"{result.scene.path.stem}: a measurement"
    lead = f"{capital(headline(figures))}."
    notes = tuple(note for note in figures.notes if note not in figures.caveats)
    return Page(title, lead, tuple(sections), command, figures.made_with, notes, figures.caveats)


def _at_edges(figures: Summary) -> list[str]:
    """How many points have no distance."""
    edges = {n: s.section.edge_points for n, s in figures.states.items() if s.section.edge_points}
    if not edges:
        return []
    words = listed([f"{counted(count, 'point')} ({name})" for name, count in edges.items()])
    return [f"Left out: {words} at edges of the part, where the true section ends."]


def _compared(name: str, state: StateSummary) -> str:
    """How many centres were compared with the search, and why others weren't."""
    if dots := state.dots_minus_search:
        return f"{name}: {dots.found} of {counted(dots.dots, 'dot')} were found."
    line = state.line_minus_search
    assert line is not None
    if not line.centres:
        reasons = _counts(state.line_status)
        return f"{name}: no line centre was found; the image's columns are: {reasons}."
    words = f"{name}: {line.compared} of {counted(line.centres, 'centre')} were compared"
    left_out = {
        "in whose columns an edge of the part hides some of the line's profile": line.cut_centres,
        "in whose columns the search found no row": line.stray_centres,
    }
    why_not = [f"{count} {reason}" for reason, count in left_out.items() if count]
    return f"{words}, without {listed(why_not)}." if why_not else f"{words}."


def _frame_words(name: str, state: StateSummary) -> str:
    """How a frame was made."""
    frame = state.frame
    text = f"The {name} frame's light was {frame.transport}"
    if frame.reason:
        text += f" ({frame.reason})"
    if frame.map_error_px > 0.0:
        text += f", by ray maps with an estimated error of {frame.map_error_px:.2g} px"
    text += f"; rendered in {time_in_words(state.render_time_s)}"
    if (recording := state.recording) is None:
        return f"{text}."
    sensor, time_s = recording.sensor, recording.exposure_s
    exposed = f"for {time_in_words(time_s)}" if time_s else "automatically"
    speckled = ", its laser light speckled" * recording.speckled
    clipped = counted(recording.saturated_columns, "column")
    return (
        f"{text}. It was exposed {exposed} on the sensor {sensor['name'] or 'given'}, of"
        f" {sensor['bit_depth']} bits{speckled}: {clipped} of the line"
        f" {'has' if recording.saturated_columns == 1 else 'have'} clipped pixels; seed"
        f" {recording.seed}."
    )


def _probe_rays_table(result: Measurement) -> TextTable:
    return text_table(
        probe_table(result),
        (
            Column("y_mm", "y, mm"),
            *(Column(f"{name}_norm", f"{_LETTERS[name]}, µm") for name in list(_LETTERS)[:3]),
            Column("pixel_shift_px_u", "shift in u, px"),
            Column("pixel_shift_px_v", "shift in v, px"),
            Column("status_hot", "status"),
        ),
        "Distances between points lit and measured, for each probe ray",
    )


# The picture.


def picture(result: Measurement, figures: Summary) -> tuple[Picture, dict[str, PanelPicture]]:
    """Draw a measurement: the whole picture, and its panels by name; of a cold part fewer."""
    hot = result.hot
    panels = {"section": _section_panel(result, figures)}
    if splits := known_splits(_splits(figures)):
        panels["split"] = split_panel(splits)
    check = {"check": _check_panel(result)} if result.centres else {}
    if hot:
        panels |= {"paths": _paths_panel(hot), "frame": _frame_panel(result, 2)}
        panels |= {"air": _air_panel(result, hot), "probes": _probe_panel(result)}
        panels |= {"letters": _letters_panel()} | check
    else:
        panels |= check | {"frame": _frame_panel(result, 3)}
    whole = f"{drawable(result.scene.path.stem)}: {findings(figures)}"
    title = shorten(whole, _TITLE, placeholder=" ...")
    drawn = draw_picture(title, list(panels.values()), columns=3)
    return drawn, dict(zip(panels, drawn.panels, strict=True))


def findings(figures: Summary) -> str:
    """How wrong the measured section is, and in short what limits that figure."""
    short = [caveat.split(";")[0] for caveat in figures.caveats]  # without the remedy
    short = [shorten(words, _CLAUSE, placeholder=" ...") for words in short]
    limits = f". {LIMITS}: {'; '.join(short)}" if short else ""
    return headline(figures) + limits


def headline(figures: Summary) -> str:
    """How wrong the measured section is, and where; or why none is measured."""
    unknown: list[str] = []
    wrong: list[str] = []
    for name, state in reversed(figures.states.items()):
        section = state.section
        if section.edge_points and not section.points:
            unknown.append(f"in {name} air all measured points lie at edges of the part")
        elif not section.points:
            reasons = f": the columns are {_counts(state.line_status)}" * (
                not state.dots_minus_search
            )
            unknown.append(f"in {name} air no point is measured{reasons}")
        elif not wrong:
            wrong.append(
                f"in {name} air the measured section is wrong by"
                f" {micrometres(section.rms_um)} rms, at most by"
                f" {micrometres(section.largest_um)} at y = {rounded(section.largest_y_mm)} mm"
                " along the line"
            )
        else:
            wrong.append(f"in {name} air by {micrometres(section.rms_um)} rms")
    return "; ".join([*unknown, *wrong])


def _curve(x: Array, y_um: Array, name: str, label: str | None = None, **style: Any) -> Curve:
    """A curve in the colour of a thing that has a name; lengths that are rounding are zero."""
    y = np.where(np.abs(y_um) < NIL_UM, 0.0, y_um)
    known = np.concatenate([[False], np.isfinite(y), [False]])
    alone = np.flatnonzero(known[1:-1] & ~known[:-2] & ~known[2:])  # no line goes through them
    dots = {"marker": ".", "ms": 3, "markevery": alone.tolist()} if alone.size else {}
    return x, y, {"color": colour(name), "label": label} | dots | style


def _style(state: State, number: int = 0) -> dict[str, Any]:
    """How the curve of some number is drawn; of dots, points only."""
    return {"ls": "", "marker": MARKERS[number], "ms": 6} if state.dots else {"ls": LINES[number]}


def _curve_panel(
    title: str, x: str, y: str, alt: str, curves: Sequence[Curve], width: int = 1
) -> Panel:
    """Curves about zero over the line, with the words of their axes and a key above."""

    def draw(axes: Axes) -> None:
        for places, values, style in curves:
            axes.plot(places, values, **style)
        axes.axhline(0.0, color="0.5", lw=0.8)
        axes.set(xlabel=x, ylabel=y)
        key_above(axes)

    return Panel(title, draw, alt, width, layout=None)


def _section_panel(result: Measurement, figures: Summary) -> Panel:
    curves = []
    for name, state in result.states.items():
        errors = figures.states[name].section
        label = f"{name}: {micrometres(errors.rms_um)} rms" if errors.points else f"{name}: none"
        y, style = state.section.along_mm(state.points_mm), _style(state)
        curves.append(_curve(y, state.section_error_um, name, label, **style))
        if errors.points and abs(errors.largest_um) >= NIL_UM and state.scene.field:
            x, y = np.array([[errors.largest_y_mm], [errors.largest_um]])
            curves.append(_curve(x, y, name, marker="s", ms=11, mfc="none", zorder=5))
    for state in result.states.values():
        some = slice(None, None, 1 if state.dots else _SEARCHED_EVERY)
        y, error = state.section.along_mm(state.searched_mm)[some], state.searched_error_um[some]
        first = "by ray search" if state is result.cold else None
        curves.append(_curve(y, error, "search", first, marker="o", mfc="none", ms=4, ls=""))
    return _curve_panel(
        "Measured minus true section",
        ALONG,
        "outside (+) or inside the part (−), µm",
        f"Error of the measured section along the line. {capital(findings(figures))}.",
        curves,
        width=2,
    )


def _paths_panel(hot: State) -> Panel:
    """Which of the two bent light paths makes the error."""
    y = hot.section.along_mm(hot.searched_mm)
    steps = np.linalg.norm(np.diff(hot.searched_mm, axis=0), axis=1)
    longest = np.inf if hot.dots else _LONGEST_STEP * np.nanmedian(steps)
    paths = (
        ("hot", "both", hot.searched_error_um),
        ("laser", "laser's path", hot.laser_path_um),
        ("camera", "camera's path", hot.camera_path_um),
    )
    return _curve_panel(
        "Why: hot air bends both paths",
        ALONG,
        "error of the section, µm",
        "The section's error of the hot part, split into what the bent laser light alone makes and"
        " what the camera's bent lines of sight add.",
        [
            _curve(*_with_gaps(y, error, steps, longest), name, label, **_style(hot, number))
            for number, (name, label, error) in enumerate(paths)
        ],
    )


def _probe_panel(result: Measurement) -> Panel:
    """The norms of the paper's figure 7."""
    found, y = probe_deviations(result), result.probe_y_mm
    return _curve_panel(
        "Probe rays",
        ALONG,
        "distance, µm",
        "Distances between the points lit (A cold, B hot) and measured (A_m cold, B_m hot), for"
        " each probe ray.",
        [
            _curve(y, euclidean(getattr(found, name)), name, letters, marker=marker)
            for (name, letters), marker in zip(_LETTERS.items(), MARKERS, strict=False)
        ],
    )


def _check_panel(result: Measurement) -> Panel:
    curves = []
    sizes = [np.abs(state.compared.error_px).ravel() for state in result.states.values()]
    large = bool((np.concatenate(sizes) > _WHOLE_PX).any())
    unit, factor = ("px", 1.0) if large else ("0.001 px", 1e3)
    for number, (name, state) in enumerate(result.states.items()):
        compared = state.compared
        rms = f"{in_words(compared.rms_px)} px rms " if compared.count else ""
        label = f"{name}: {rms}({compared.count} of {state.centres})"
        style = _style(state, number)
        if isinstance(compared, DotErrors):
            u, dv = compared.true_pixel[:, 0], compared.error_px[:, 1]
        else:
            u, dv = compared.column, compared.error_px
            u, dv = _with_gaps(u, dv, np.diff(u), 1.5)
            style["lw"] = 0.9
        curves.append(_curve(u, factor * dv, name, label, **style))
    what = "dots" if result.cold.dots else "line"
    seen = _seen_in(result)
    return _curve_panel(
        f"Check: {seen} {what} minus search",
        _U,
        f"difference in v, {unit}",
        f"The {seen} {what} minus the ray search, px, along the line.",
        curves,
    )


def _with_gaps(x: Array, y: Array, steps: Array, longest: float) -> tuple[Array, Array]:
    """The same with NaN between points that are farther apart: no line is drawn across."""
    gaps = np.flatnonzero(steps > longest) + 1
    return np.insert(x, gaps, np.nan), np.insert(y, gaps, np.nan)


def _frame_panel(result: Measurement, width: int) -> Panel:
    name, state = list(result.states.items())[-1]
    light = state.frame.radiance
    image = light if state.shot is None else state.shot.grey

    def draw(axes: Axes) -> None:
        found = np.concatenate([s.centres_px for s in result.states.values()])
        found = found[np.isfinite(found).all(axis=1)]
        lit = np.argwhere(light > 0.01 * light.max())[:, ::-1]
        both = np.concatenate([found, lit])
        left, top = np.maximum(both.min(axis=0).astype(int) - _MARGIN_PX, 0)
        ends = np.ceil(both.max(axis=0)).astype(int) + _MARGIN_PX
        right, bottom = np.minimum(ends, image.shape[::-1])
        extent = (left - 0.5, right - 0.5, bottom - 0.5, top - 0.5)
        axes.imshow(image[top:bottom, left:right], cmap="gray", aspect="auto", extent=extent)
        for number, (label, drawn) in enumerate(result.states.items()):
            line = ("+", "x")[number] if drawn.dots else LINES[number]
            label = f"{label}: {drawn.centres} {'dots' if drawn.dots else 'line centres'}"
            paint = _ON_BLACK[number]
            axes.plot(*drawn.centres_px.T, line, color=paint, lw=1.2, ms=8, label=label)
        axes.grid(False)
        axes.set(xlim=extent[:2], ylim=extent[2:], xlabel=_U, ylabel="v in px")
        key_above(axes)

    return Panel(
        f"What the camera sees of the {name} part",
        draw,
        f"The camera's {_seen_in(result)} frame of the {name} part, cut to the lit pixels,"
        " with the centres found.",
        width,
        layout=None,
    )


def _air_panel(result: Measurement, hot: State) -> Panel:
    """The air in two planes through the line's middle, with the light paths drawn in."""
    field = hot.scene.field
    assert field is not None
    middle = LitLine(result.dense_y_mm, result.cold.dense.laser_point_mm).middle_mm
    names = [f"plane {name} = {rounded(middle[i], 4)} mm" for i, name in ((1, "y"), (0, "x"))]

    def draw(figure: Figure) -> None:
        axes = figure.subplots(1, 2, gridspec_kw={"wspace": 0.1})
        figure.subplots_adjust(left=0.12, right=0.83, bottom=0.14, top=0.78)
        planes = [_air_plane(field, middle, axis) for axis in (0, 1)]
        n = np.concatenate([plane.ravel() for plane, _ in planes])
        norm = Normalize(n.min(), max(n.max(), n.min() + _LEAST_CONTRAST))
        for axis, each in enumerate(axes):
            drawn = _draw_air(each, hot, axis, *planes[axis], norm)
            each.set_title(names[axis], fontsize=9.5, fontweight="normal", loc="center")
        axes[0].set_ylabel("z in mm")
        axes[1].set_yticklabels([])
        bar = figure.add_axes((0.85, 0.14, 0.03, 0.64))
        figure.colorbar(drawn, cax=bar)
        bar.set_title("10⁵ (n − 1)", fontsize=9.5, loc="center", fontweight="normal")
        figure.legend(*axes[0].get_legend_handles_labels(), loc=(0.12, 0.86), ncols=2)

    return Panel(
        "The air and the light paths",
        draw,
        f"Refractivity of the air in the {names[0]} and the {names[1]}, through the line's middle,"
        " with the laser's and the camera's light paths to both ends and the middle of the line.",
        axes=False,
        layout=None,
    )


def _air_plane(field: IndexField, middle_mm: Array, axis: int) -> tuple[Array, Array]:
    """10^5 (n - 1) of (z, x) for axis 0, or (z, y) for 1, ambient outside the field; and the ends.

    The plane goes through a point of the world; of its ends (2, 2) the first are the lower ones.
    """
    corners = field.to_world(np.array(list(product(*field.box.T))))
    low, high = corners.min(axis=0), corners.max(axis=0)
    side, z = (np.linspace(low[i], high[i], _AIR_NODES) for i in (axis, 2))
    points = np.tile(middle_mm, (len(z), len(side), 1))
    points[..., axis], points[..., 2] = side, z[:, None]
    n = field.refractivity(points.reshape(-1, 3)).reshape(len(z), len(side))
    return 1e5 * n, np.stack([low, high])[:, [axis, 2]]


def _draw_air(
    axes: Axes, state: State, axis: int, plane: Array, box: Array, norm: Normalize
) -> ScalarMappable:
    """Draw a plane of the air with z upwards, and the light as it is seen square to it."""
    field = state.scene.field
    assert field is not None
    (left, low), (right, high) = box
    extent = (left, right, low, high)
    drawn = axes.imshow(
        plane, origin="lower", extent=extent, aspect="auto", cmap="YlOrRd_r", norm=norm
    )
    axes.set_facecolor(drawn.cmap(drawn.norm(1e5 * field.ambient)))
    ends = list(box)
    for number, path in enumerate(_light_paths(state)):
        for style, (name, points_mm) in zip(LINES, path.items(), strict=False):
            label = f"{name}'s light" if number == 0 else None
            flat = points_mm[:, [axis, 2]]
            axes.plot(*flat.T, style, color=colour(name), lw=1.5, label=label)
            ends += list(flat)
    xlim, ylim = np.stack([np.min(ends, axis=0), np.max(ends, axis=0)], axis=1)
    axes.set(xlim=xlim, ylim=ylim, xlabel=f"{'xy'[axis]} in mm")
    axes.grid(False)
    return drawn


def _light_paths(state: State) -> Iterator[dict[str, Array]]:
    """Start and end (2, 3) of the laser's and the camera's light, at both ends and the middle."""
    ends = state.dense.laser_point_mm[np.isfinite(state.dense.pixel[:, 0])]
    sensor = state.scene.sensor
    for end in ends[[0, len(ends) // 2, -1]] if len(ends) else ():
        t = sensor.laser.family.coordinates(end[None])[:, 1]
        start = sensor.laser.family.rays(0.0, t)[0][0]
        yield {
            "laser": np.stack([start, end]),
            "camera": np.stack([sensor.camera.pose.origin_mm, end]),
        }


def _letters_panel() -> Panel:
    """A sketch of what the letters mean."""

    def draw(axes: Axes) -> None:
        x = np.linspace(-1.0, 1.0, 100)
        axes.fill_between(x, -0.35 * x**2, -1.0, color="0.85", lw=0)
        axes.plot(x, -0.35 * x**2, color="0.4")
        laser, camera, A, B = np.array([[-0.55, 1.1], [0.85, 1.0], [0.0, 0.0], [0.3, -0.0315]])
        leaves = _bent(B, camera, 0.09)
        axes.plot(*np.stack([laser, A, camera]).T, "--", color=colour("cold"))
        for path in (_bent(laser, B, 0.10), leaves):
            axes.plot(*path.T, "-", color=colour("hot"))
        towards = leaves[-2] - camera  # the line of sight, as the camera believes it
        share = np.linalg.solve(np.stack([towards, laser - A], axis=1), A - camera)[0]
        B_m = camera + share * towards
        axes.plot(*np.stack([camera, B_m]).T, ":", color=colour("hot"))
        marks = {"A = Aₘ": (A, -0.52, -0.22), "B": (B, 0.05, -0.22), "Bₘ": (B_m, -0.3, 0.0)}
        for letters, (point, *aside) in marks.items():
            axes.plot(*point, "o", color="k", ms=5)
            axes.annotate(letters, point, point + aside, fontsize=12)
        axes.text(laser[0] - 0.05, laser[1], "laser", ha="right", va="center")
        axes.text(camera[0], camera[1] + 0.05, "camera", ha="center")
        words = (
            "A, B: lit point on the cold, the hot part\n"
            "Aₘ, Bₘ: the points measured there\n"
            "dashed: cold; solid: hot; dotted: the line of\n"
            "sight if it were straight (not to scale)"
        )
        axes.text(-1.05, -0.48, words, va="top", fontsize=9.5)
        axes.set(xlim=(-1.1, 1.1), ylim=(-1.0, 1.25))
        axes.set_axis_off()

    return Panel(
        "What A, B, Aₘ and Bₘ are",
        draw,
        "Sketch: straight laser light meets the part at A, which is measured rightly as A_m. Bent"
        " by hot air it meets it at B; the camera's line of sight is bent too, and where it would"
        " cross the laser's plane if it were straight, B_m is measured.",
        layout=None,
    )


def _bent(start: Array, end: Array, by: float) -> Array:
    """A path from start to end (N, 2) that bulges to its left by so much of its length."""
    share = np.linspace(0.0, 1.0, 30)[:, None]
    aside = np.array([start[1] - end[1], end[0] - start[0]])
    return start + share * (end - start) + by * 4.0 * share**2 * (1.0 - share) * aside
