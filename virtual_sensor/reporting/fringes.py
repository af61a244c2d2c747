"""A measurement by fringes: its picture, page and tables, and all files that it writes."""

from __future__ import annotations

from collections.abc import Iterator, Mapping, Sequence
from concurrent.futures import Future, ThreadPoolExecutor
from dataclasses import fields, replace
from math import ceil
from pathlib import Path
from typing import Any

import numpy as np
from matplotlib.axes import Axes
from numpy.typing import NDArray

from virtual_sensor.errors import InputError
from virtual_sensor.files import RESULTS_SIGN, folder_written_whole
from virtual_sensor.imaging.image_files import save_png
from virtual_sensor.metrology.fringes.decoded import COORDINATES, DecodedFringes, FringeStatus
from virtual_sensor.records import Described, counts_in_words, write_ply_mesh
from virtual_sensor.reporting.files import FileOf, write_results
from virtual_sensor.reporting.maps import (
    Window,
    frames_panel,
    map_panel,
    scale_of,
    status_panel,
    window_of,
    within,
)
from virtual_sensor.reporting.page import LIMITS, PAGE, Content, Details, Page, Section
from virtual_sensor.reporting.pictures import (
    Panel,
    PanelPicture,
    Picture,
    beside,
    draw_picture,
    key_above,
)
from virtual_sensor.reporting.style import LINES, colour, drawable
from virtual_sensor.reporting.tables import Column, TextTable, pair_table, text_table
from virtual_sensor.reporting.words import capital, counted, listed, micrometres, time_in_words
from virtual_sensor.studies.fringes.decoded_files import LAYERS as DECODED_LAYERS
from virtual_sensor.studies.fringes.decoded_files import write_decoded
from virtual_sensor.studies.fringes.result import (
    FringeMeasurement,
    FringeSearchTable,
    FringeState,
    FringeStateSummary,
    FringeSummary,
    Surface,
    search_table,
)

MOST_VERTICES = 400_000
"""Of a surface in a file, unless all are asked for."""

_OUTSIDE = "outside (+) or inside (−) the part, µm"
_LIGHT = {"straight": "as if light ran straight", "bent": "along the bent light"}
_BINS = 80
_USUAL = 99.5  # percent of the differences that the histogram shows
_FRAMES = 24  # that are drawn
_FULL = 0.9  # of the fullest row's values

LAYERS = (
    *DECODED_LAYERS,
    Described(
        "straight.deviation, bent.deviation",
        "µm",
        "Distance of the pixel's point from the true surface, positive outside the part: found as"
        " if light ran straight, and along the bent light.",
    ),
    Described("straight.Z, bent.Z", "mm", "The point's depth along the camera's axis."),
    Described(
        "epipolar", "px", "The pixel's distance from the epipolar line of its projector pixel."
    ),
)

FILES = (
    FileOf(PAGE, "The page to open first."),
    FileOf("report.png", "The measurement at a glance."),
    FileOf(RESULTS_SIGN, "The figures of the measurement.", FringeSummary),
    FileOf("table.md", "The figures as tables."),
    FileOf(
        "*.exr",
        "What was decoded at each pixel of the cold and the hot frames, and the points.",
        LAYERS,
    ),
    FileOf(
        "surface_*.ply",
        "The measured surface as triangles, mm, world; the vertices have their deviation_um. Of"
        " large frames every so many-th pixel is a vertex.",
    ),
    FileOf(
        "search_*.csv", "Pixels that were searched, beside the decoded ones.", FringeSearchTable
    ),
    FileOf(
        "frames_*/*.png", "The frames (--frames), in the order in which fringes decode takes them."
    ),
)


# The files.


def save(
    result: FringeMeasurement,
    folder: Path,
    command: str,
    overwrite: bool = False,
    *,
    frames: bool = False,
) -> FringeSummary:
    """Write a measurement's files (`FILES`), all of them or none, and give its summary.

    `command` is the exact one that the results come from; `frames` asks for the frames too.

    Raises
    ------
    InputError
        If the folder exists (and `overwrite` is not set) or can't be written; or frames are asked
        for that were not kept.
    """
    figures = result.summary
    if frames and any(s.images.shape[1:] != s.decoded.status.shape for s in result.states.values()):
        raise InputError(
            f"{folder}: the frames were not kept; measure with Settings(frames=True) to write them"
        )
    with folder_written_whole(folder, overwrite) as place, ThreadPoolExecutor() as aside:
        written: list[Future[Any]] = []
        contents: dict[str, Any] = {}
        for name, state in result.states.items():
            facts = {**state.scene.parameters, "state": name, "codec": figures.codec}
            header = {f"virtual_sensor/{key}": value for key, value in facts.items()}
            # To compress one takes a second, in which all the rest is written.
            written.append(
                aside.submit(
                    write_decoded, place / f"{name}.exr", state.decoded, _layers(state), header
                )
            )
            for light, surface in state.surfaces.items():
                written.append(
                    aside.submit(write_surface, place / f"surface_{name}_{light}.ply", surface)
                )
            contents[f"search_{name}.csv"] = search_table(state)
            if frames:
                written += _frames_written(place, name, state, result.codec.names, aside)
        whole, panels = picture(result)
        contents |= {
            "report.png": whole,
            "table.md": _table_page(figures, command),
            PAGE: page(result, panels, command),
            RESULTS_SIGN: figures,
        }
        for each in written:
            each.result()
        write_results(place, FILES, contents)
    return figures


def _layers(state: FringeState) -> dict[str, NDArray[np.float32]]:
    """What stands in a state's file beside what was decoded."""
    layers = {}
    for light, surface in state.surfaces.items():
        layers[f"{light}.deviation"] = surface.deviation_um
        layers[f"{light}.Z"] = surface.range_image.depth_mm
    if state.summary.epipolar is not None:
        layers["epipolar"] = state.straight.range_image.epipolar_px
    return layers


def _frames_written(
    place: Path, name: str, state: FringeState, names: Sequence[str], aside: ThreadPoolExecutor
) -> list[Future[Any]]:
    """The frames as PNG, in the order in which `fringes decode` takes them."""
    folder = place / f"frames_{name}"
    folder.mkdir()
    bits = state.summary.frames.bits or 16
    white = None if state.summary.frames.bits else float(state.images.max())
    digits = len(str(len(state.images) - 1))
    files = [folder / f"{number:0{digits}d}.png" for number in range(len(state.images))]
    said = state.metadata
    return [
        aside.submit(save_png, image, file, bits, white=white, metadata=said)
        for image, file in zip(state.images, files, strict=True)
    ]


def write_surface(path: Path, surface: Surface, most: int | None = MOST_VERTICES) -> None:
    """Write a surface's triangles as a PLY file, whose vertices have a property `deviation_um`.

    Of many pixels every so many-th row and column is taken, so that there are at most so many
    vertices; None takes all.
    """
    image = surface.range_image
    step = 1 if most is None else max(ceil(np.sqrt(np.isfinite(image.depth_mm).sum() / most)), 1)
    coarse = replace(
        image,
        **{
            each.name: values[::step, ::step]
            for each in fields(image)
            if (values := getattr(image, each.name)) is not None
        },
    )
    mesh = coarse.mesh()
    deviation_um = surface.deviation_um[::step, ::step].ravel()[mesh.index]
    write_ply_mesh(path, mesh.vertices, mesh.faces, deviation_um=deviation_um)


def _table_page(figures: FringeSummary, command: str) -> str:
    made = figures.made_with
    tables = [surface_table(figures), *fit_tables(figures), check_table(figures)]
    shown = "\n".join(f"{each.caption}\n\n{each.markdown()}" for each in tables)
    return (
        f"{shown}\nMade by `{command}` in {figures.time_s:.0f} s, with"
        f" {counted(made.threads, 'thread')} ({made.variant}); patterns: {figures.codec}.\n"
    )


# The console.


def on_console(figures: FringeSummary) -> list[TextTable | str]:
    """What the command prints: how wrong the surface is, its fits, and whether the check holds."""
    return [surface_table(figures), *fit_tables(figures), check_table(figures)]


def surface_table(figures: FringeSummary) -> TextTable:
    """How far the measured surfaces are from the true one."""
    return text_table(
        _surface_rows(figures),
        (
            Column("state", " "),
            Column("light", "points found"),
            Column("facts.compared", "points", "{}"),
            Column("facts.rms_um", "rms", nothing="none"),
            Column("facts.mean_um", "mean", "{:+.3g}", "none"),
            Column("facts.largest_um", "largest", "{:+.3g}", "none"),
            Column("facts.sigma_um", "sigma", nothing="none"),
        ),
        "Measured minus true surface, µm (positive: outside the part)",
    )


def fit_tables(figures: FringeSummary) -> list[TextTable]:
    """The shapes that were fitted to the surfaces; none of a part that is no such shape."""
    rows = [
        {"state": row["state"], "light": row["light"], "fit": row["facts"].fit}
        for row in _surface_rows(figures)
        if row["facts"].fit
    ]
    if not rows:
        return []
    kind = rows[0]["fit"].kind
    radius = (
        Column("fit.radius_mm", "radius, mm", "{:.4f}", "none"),
        Column("fit.radius_error_um", "off the part, µm", "{:+.3g}", "none"),
    )
    columns = (
        Column("state", " "),
        Column("light", "points found"),
        *(radius if kind != "plane" else ()),
        Column("fit.std_um", "std, µm"),
        Column("fit.points", "points", "{}"),
    )
    return [
        text_table(rows, columns, f"A {kind} through the points, and how they scatter about it")
    ]


def check_table(figures: FringeSummary) -> TextTable:
    """Decoded beside searched projector pixels, and the epipolar residual."""
    rows = [{"state": name, **vars(each)} for name, each in figures.states.items()]
    axes = [
        Column(f"decoded_minus_search.{axis}.{what}_px", words, "{:.4f}", "none")
        for axis in COORDINATES.values()
        if any(getattr(each.decoded_minus_search, axis) for each in figures.states.values())
        for what, words in (("rms", f"{axis}, rms"), ("largest", "most"))
    ]
    epipolar = (
        Column("epipolar.rms_px", "epipolar, rms", "{:.4f}", "none"),
        Column("epipolar.searched_rms_px", "searched", "{:.4f}", "none"),
    )
    shown = any(each.epipolar for each in figures.states.values())
    return text_table(
        rows,
        (Column("state", " "), *axes, *(epipolar if shown else ())),
        f"Check: decoded minus searched projector pixel{', and epipolar residual' * shown}, px",
    )


def _surface_rows(figures: FringeSummary) -> list[dict[str, Any]]:
    """A row for each surface of each state."""
    return [
        {"state": name, "light": light, "facts": facts}
        for name, each in figures.states.items()
        for light, facts in (("straight", each.straight), ("bent", each.bent))
        if facts is not None
    ]


# The page.


def headline(figures: FringeSummary) -> str:
    """How wrong the measured surface is, straight and bent; or why none is measured."""
    said = []
    for name, state in reversed(figures.states.items()):
        if not state.straight.points:
            counts = [f"{key} {n}" for key, n in state.decoded.status.items() if n]
            said.append(f"in {name} air nothing is measured: the pixels are {listed(counts)}")
            continue
        if not state.straight.compared:
            said.append(f"in {name} air no point has a true surface to be compared with")
            continue
        wrong = (
            f"in {name} air the measured surface is wrong by {micrometres(state.straight.rms_um)}"
            f" rms, at most by {micrometres(state.straight.largest_um)}"
        )
        if state.bent is not None and state.bent.compared:
            wrong += f", and found along the bent light by {micrometres(state.bent.rms_um)} rms"
        said.append(wrong)
    return "; ".join(said)


def page(result: FringeMeasurement, panels: Mapping[str, PanelPicture], command: str) -> Page:
    """The page of a measurement by fringes."""
    figures = result.summary
    each = figures.states.items()
    sections = [
        Section(
            "The measured surface",
            beside(panels, *(n for n in panels if n.startswith("deviation")), "profile"),
            *_own_colours(result),
            surface_table(figures),
            "Each pixel's point has a distance from the true surface along its normal, positive"
            " outside the part. Points found straight take light for straight, as a sensor that is"
            " calibrated cold does; bent points are found along the light that the air has bent."
            " Sigma is the standard deviation that the frames' noise makes.",
            *(f"{name}: {_compared(state)}" for name, state in each),
            *fit_tables(figures),
        ),
        Section("What the camera sees", beside(panels, "frames", "modulation")),
        Section(
            "What is decoded",
            beside(panels, "column", "row", "phase", "sigma"),
            _decoded_table(figures),
        ),
        Section("The range image", beside(panels, "depth", "status")),
    ]
    if any(name.startswith("epipolar") for name in panels):
        sections.append(
            Section(
                "What shape can't fake",
                "Straight light keeps column and row of the projector together: the camera's pixel"
                " lies on the epipolar line of the projector's, whatever the shape. Its distance"
                " from there, the epipolar residual, is the air's alone.",
                beside(panels, *(name for name in panels if name.startswith("epipolar"))),
                _epipolar_table(figures),
            )
        )
    sections += [
        Section(
            "Check: decoded against searched",
            "Projector pixels that were decoded from the frames stand beside a search by rays,"
            " without any image: what separates them is the error of rendering and decoding.",
            beside(panels, "check"),
            check_table(figures),
            *(line for name, state in each for line in _left_out(name, state)),
        ),
        Section(
            "Settings",
            f"Patterns: {figures.codec}. Air of bent points: {figures.medium or 'none'}.",
            *(f"{name}: {_frames_words(state)}" for name, state in each),
            Details("Times", tuple(_times_table(name, state) for name, state in each)),
            Details(
                "All parameters of the scene",
                (pair_table(("parameter", "value"), figures.parameters),),
            ),
        ),
    ]
    notes = tuple(note for note in figures.notes if note not in figures.caveats)
    title = f"{result.scene.path.stem}: a surface by fringes"
    lead = f"{capital(headline(figures))}."
    return Page(title, lead, tuple(sections), command, figures.made_with, notes, figures.caveats)


def _compared(state: FringeStateSummary) -> str:
    """How many pixels became points, and how many points are compared."""
    width, height = state.frames.size_px
    facts = state.straight
    words = (
        f"{counted(state.decoded.pixels, 'pixel')} of {width * height} decoded,"
        f" {counted(facts.points, 'point')}"
    )
    beyond = facts.points - facts.compared
    if not beyond:
        return f"{words}."
    return f"{words}, {beyond} of them at the part's edges or beyond them, and not compared."


def _decoded_table(figures: FringeSummary) -> TextTable:
    return text_table(
        [{"state": name, **vars(each.decoded)} for name, each in figures.states.items()],
        (
            Column("state", " "),
            Column("pixels", "pixels", "{}"),
            Column("modulation_median", "modulation, median"),
            Column("sigma_column_px", "sigma of the column, median, px", nothing="none"),
            Column("sigma_row_px", "of the row", nothing="none"),
        ),
    )


def _epipolar_table(figures: FringeSummary) -> TextTable:
    return text_table(
        [
            {"state": name, **vars(each.epipolar)}
            for name, each in figures.states.items()
            if each.epipolar
        ],
        (
            Column("state", " "),
            Column("rms_px", "rms, px", "{:.4f}"),
            Column("largest_px", "largest, px", "{:.4f}"),
            Column("pixels", "pixels", "{}"),
            Column("searched_rms_px", "searched: rms, px", "{:.4f}"),
            Column("searched_largest_px", "largest, px", "{:.4f}"),
            Column("difference_rms_px", "decoded minus searched, rms, px", "{:.4f}"),
        ),
        "Epipolar residual, px of the camera",
    )


def _left_out(name: str, state: FringeStateSummary) -> Iterator[Content]:
    """Pixels of the search's grid that are not compared, and why."""
    found = state.decoded_minus_search
    compared = max(each.compared if each else 0 for each in (found.column, found.row))
    words = f"{name}: {compared} of {counted(found.searched, 'searched pixel')} are compared"
    reasons = [
        f"{sum(counts.values())} {what} ({counts_in_words(counts)})"
        for what, counts in (
            ("are not decoded", found.only_searched),
            ("are decoded and not found by the search", found.only_decoded),
        )
        if sum(counts.values())
    ]
    yield f"{words}; {listed(reasons)}." if reasons else f"{words}."


def _frames_words(state: FringeStateSummary) -> str:
    """How a state's frames were made."""
    facts, report = state.frames, state.frames.report
    text = (
        f"{counted(facts.frames, 'frame')} with {counted(facts.samples_per_pixel, 'sample')} per"
        f" pixel; light was {report.transport}"
    )
    if report.reason:
        text += f" ({report.reason})"
    if report.map_error_px > 0.0:
        text += f", by ray maps with an estimated error of {report.map_error_px:.2g} px"
    noise = "without noise" if facts.electrons is None else f"{facts.electrons:g} electrons at most"
    bits = "not rounded" if facts.bits is None else f"{facts.bits} bits"
    sensor = [f"recorded by the {facts.sensor} sensor"] if facts.sensor else []
    time = [f"exposed for {1e3 * facts.exposure_s:.4g} ms"] if facts.exposure_s else []
    return f"{text}; {', '.join([*sensor, *time, noise, bits])}."


def _times_table(name: str, state: FringeStateSummary) -> TextTable:
    times = {what: time_in_words(seconds) for what, seconds in state.times_s.items()}
    return pair_table((name, "time"), times)


def _own_colours(result: FringeMeasurement) -> list[Content]:
    """The cold surface where the hot one's colours hide it, folded."""
    surface = result.cold.straight
    if not (result.hot and surface.facts.compared):
        return []
    title = f"Cold, straight: {micrometres(surface.facts.rms_um)} rms, own colours"
    panel = map_panel(title, surface.deviation_um, _OUTSIDE, "signed")
    return [Details("The cold surface with colours of its own", (draw_picture("", [panel]),))]


# The picture.


def picture(result: FringeMeasurement) -> tuple[Picture, dict[str, PanelPicture]]:
    """Draw a measurement: the whole picture, and its panels by name; of a cold part fewer."""
    states = result.states
    last = list(states.values())[-1]
    where = f"the {list(states)[-1]} part" if result.hot else "the part"
    shown = window_of(*(_known(each) for each in states.values()))
    panels = deviation_panels(states, shown)
    panels["profile"] = _profile_panel(states, shown)
    panels |= _epipolar_panels(states, shown)
    if any(np.isfinite(each.grid.difference_px).any() for each in states.values()):
        panels["check"] = _check_panel(states)
    panels["frames"] = _frames_panel(result, last, where, shown)
    panels |= decoded_panels(last.decoded, where, shown)
    panels["depth"] = map_panel(
        f"Range image of {where}",
        last.surfaces.get("bent", last.straight).range_image.depth_mm,
        "depth along the camera's axis, mm",
        "span",
        shown,
    )
    title = f"{drawable(result.scene.path.stem)}: {headline(result.summary)}"
    if result.summary.caveats:
        title += f". {LIMITS}: {'; '.join(c.split(';')[0] for c in result.summary.caveats)}"
    drawn = draw_picture(title, list(panels.values()), columns=3)
    return drawn, dict(zip(panels, drawn.panels, strict=True))


def _known(state: FringeState) -> NDArray[Any]:
    """Decoded columns, or rows where there are no columns."""
    decoded = state.decoded
    return decoded.column if decoded.column is not None else decoded.row


def deviation_panels(states: dict[str, FringeState], window: Window) -> dict[str, Panel]:
    """Straight points cold and hot with the same colours; bent points with their own."""
    straight = scale_of("signed", *(s.straight.deviation_um[window] for s in states.values()))
    panels = {}
    for name, state in reversed(states.items()):
        for light, surface in state.surfaces.items():
            scale: Any = straight if light == "straight" else "signed"
            rms = micrometres(surface.facts.rms_um)
            own = ", own colours" if light == "bent" else ""
            panels[f"deviation_{name}_{light}"] = map_panel(
                f"{capital(name)}, {light}: {rms} rms{own}",
                surface.deviation_um,
                _OUTSIDE,
                scale,
                window,
                f"Deviation of the {name} surface from the true one, found {_LIGHT[light]}: {rms}"
                " rms.",
            )
    return panels


def _profile_panel(states: dict[str, FringeState], window: Window) -> Panel:
    """Deviations along a row of the image, and of bent points."""
    row = _full_row([s.straight.deviation_um for s in states.values()], window)
    u = np.arange(window[1].start, window[1].stop)

    def draw(axes: Axes) -> None:
        for name, state in states.items():
            for number, (light, surface) in enumerate(state.surfaces.items()):
                axes.plot(
                    u,
                    surface.deviation_um[row, window[1]],
                    LINES[number],
                    color=colour(name),
                    label=f"{name}, {light}",
                )
        axes.axhline(0.0, color="0.5", lw=0.8)
        axes.set(xlabel="u in px", ylabel=_OUTSIDE)
        key_above(axes)

    title = f"Along v = {row} px"
    return Panel(title, draw, f"Deviation of the points along the row {row}.", layout=None)


def _full_row(maps: Sequence[NDArray[Any]], window: Window) -> int:
    """The row nearest the window's middle that has nearly as many values as the fullest one."""
    values = np.sum([np.isfinite(each[window]).sum(axis=1) for each in maps], axis=0)
    middle = (window[0].stop - window[0].start) // 2
    full = np.flatnonzero(values >= _FULL * values.max())
    return window[0].start + int(full[np.abs(full - middle).argmin()])


def _epipolar_panels(states: dict[str, FringeState], window: Window) -> dict[str, Panel]:
    """The residual cold and hot, with the same colours."""
    maps = {
        name: state.straight.range_image.epipolar_px
        for name, state in reversed(states.items())
        if state.summary.epipolar is not None
    }
    if not maps:
        return {}
    scale = scale_of("signed", *(each[window] for each in maps.values()))
    return {
        f"epipolar_{name}": map_panel(
            f"Epipolar residual, {name}: {_rms_px(states[name])}",
            values,
            "beside the epipolar line, px",
            scale,
            window,
        )
        for name, values in maps.items()
    }


def _rms_px(state: FringeState) -> str:
    assert state.summary.epipolar is not None
    return f"{state.summary.epipolar.rms_px:.3g} px rms"


def _check_panel(states: dict[str, FringeState]) -> Panel:
    """How many of the searched pixels are decoded how far off."""
    found = {}
    for name, state in states.items():
        for number, (axis, differences) in enumerate(
            zip(COORDINATES.values(), state.grid.difference_px.T, strict=True)
        ):
            known = 1e3 * differences[np.isfinite(differences)]
            if known.size:
                found[f"{name}, {axis}"] = known, colour(name), LINES[number]
    every = np.abs(np.concatenate([known for known, *_ in found.values()]))
    most = float(np.percentile(every, _USUAL)) or 1.0

    def draw(axes: Axes) -> None:
        for label, (known, paint, line) in found.items():
            counts, edges = np.histogram(known, _BINS, (-most, most))
            axes.stairs(counts, edges, color=paint, ls=line, label=label, lw=1.3)
        axes.set(xlabel="decoded minus searched, 0.001 projector px", ylabel="pixels")
        key_above(axes)

    alt = "Histogram of decoded minus searched projector pixels."
    return Panel("Check: decoded minus searched", draw, alt, layout=None)


def _frames_panel(
    result: FringeMeasurement, state: FringeState, where: str, window: Window
) -> Panel:
    names = result.codec.names[:_FRAMES]
    images = state.images[:_FRAMES]
    more = len(state.images) - len(images)
    first = f", the first {len(images)}" if more else ""
    window = within(window, images.shape[1:], state.decoded.status.shape)
    alt = f"Frames of {where}, each with the pattern that is shown."
    return frames_panel(f"Frames of {where}{first}", images, names, window, alt)


def decoded_panels(decoded: DecodedFringes, where: str, window: Window) -> dict[str, Panel]:
    """What was decoded, by "column", "row", "sigma", "modulation", "phase" and "status"."""
    panels = {}
    for axis, name in COORDINATES.items():
        values = getattr(decoded, name)
        if values is not None:
            panels[name] = map_panel(
                f"Decoded {name} of {where}", values, f"{axis} in projector px", "span", window
            )
    known = [n for n in ("sigma_column", "sigma_row") if getattr(decoded, n) is not None]
    if known and np.nanmax(getattr(decoded, known[0]), initial=0.0) > 0.0:  # there is noise
        axis = known[0].removeprefix("sigma_")
        panels["sigma"] = map_panel(
            f"Predicted sigma of the {axis}",
            np.where(decoded.ok, getattr(decoded, known[0]), np.nan),
            "projector px",
            "size",
            window,
        )
    panels["modulation"] = map_panel(
        f"Modulation of {where}", decoded.modulation, "as the frames' grey", "size", window
    )
    for axis, phase in list(decoded.phase.items())[:1]:
        panels["phase"] = map_panel(
            f"Phase of the finest fringes along {axis}",
            np.where(decoded.ok, phase, np.nan),
            "phase, rad",
            "phase",
            window,
        )
    panels["status"] = status_panel(
        "What became of each pixel",
        decoded.status,
        FringeStatus,
        f"What became of each pixel of {where}.",
    )
    return panels
