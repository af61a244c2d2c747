"""A measurement's results: frames, points, tables, the summary, a picture and a page."""

from concurrent.futures import ThreadPoolExecutor
from pathlib import Path

from virtual_sensor.files import RESULTS_SIGN, folder_written_whole, written_whole
from virtual_sensor.imaging.render import EXR_LAYERS, write_exr, write_png
from virtual_sensor.metrology.calibration import calibration_of, calibration_text
from virtual_sensor.records import write_csv, write_json, write_ply
from virtual_sensor.reporting.files import FileOf
from virtual_sensor.reporting.measure_picture import draw_report
from virtual_sensor.reporting.tables import Column, TextTable, text_table
from virtual_sensor.reporting.words import in_words
from virtual_sensor.studies.measure import (
    DenseTable,
    DotTable,
    LineTable,
    Measurement,
    ProbeTable,
    StateSummary,
    Summary,
    dense_table,
    dot_table,
    line_table,
    probe_table,
    summary,
)

CALIBRATION = "calibration.yaml"
"""The sensor as `virtual-sensor detect --calibration` reads it."""

FILES = (
    FileOf("report.png", "The measurement at a glance."),
    FileOf("summary.json", "The figures of the measurement.", Summary),
    FileOf("table.md", "Accuracy and speed as a table."),
    FileOf("*.exr", "The frame, cold or hot, with its ground truth.", EXR_LAYERS),
    FileOf("*.png", "The frame as a picture of 16 bits; cold and hot have one white."),
    FileOf("line_*.csv", "The line's centres and the points measured there.", LineTable),
    FileOf("dots_*.csv", "The laser's dots, where it makes some.", DotTable),
    FileOf("points_*.ply", "The measured points, mm, world, with the line's brightness."),
    FileOf("probe_rays.csv", "The probe rays: points lit and measured.", ProbeTable),
    FileOf("dense_search.csv", "The rays searched along the whole line.", DenseTable),
    FileOf(CALIBRATION, "The sensor, as `virtual-sensor detect --calibration` reads it."),
)


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
        written = []
        for name, state in result.states.items():
            header = {f"virtual_sensor/{k}": v for k, v in state.scene.parameters.items()}
            header["virtual_sensor/state"] = name
            # To compress one takes half a second, in which all the rest is written.
            written.append(aside.submit(write_exr, place / f"{name}.exr", state.frame, header))
            image = state.frame.radiance
            written.append(aside.submit(write_png, place / f"{name}.png", image, white))
            write_csv(place / f"line_{name}.csv", line_table(state))
            if state.dots:
                write_csv(place / f"dots_{name}.csv", dot_table(state))
            brightness = state.dots.flux if state.dots else state.line.amplitude
            write_ply(place / f"points_{name}.ply", state.points_mm, brightness)
        write_csv(place / "probe_rays.csv", probe_table(result))
        write_csv(place / "dense_search.csv", dense_table(result))
        sensor = result.cold.scene.sensor
        with written_whole(place / CALIBRATION) as temporary:
            text = calibration_text(calibration_of(sensor), CALIBRATION)
            temporary.write_text(text, encoding="utf-8")
        draw_report(result, figures, place / "report.png")
        with written_whole(place / "table.md") as temporary:
            temporary.write_text(_table_page(result, figures), encoding="utf-8")
        for frame in written:
            frame.result()
        write_json(place / RESULTS_SIGN, figures)
    return figures


def table(result: Measurement, figures: Summary) -> TextTable:
    """Accuracy and speed of a measurement, as the README shows them."""
    states = figures.states
    size, spp = result.scene.sensor.camera.size, figures.made_with.samples_per_pixel
    shown = {
        "Measured minus true section, rms": ("{:.3g} µm", "section.rms_um"),
        "... the largest": ("{:.3g} µm", "section.largest_um"),
        "... where along the line": ("{:.3g} mm", "section.largest_y_mm"),
    }
    if result.cold.dots:
        shown |= {
            "Rendered dots minus ray search, rms": ("{:.4f} px", "dots_minus_search.rms_px"),
            "... at most, along the line": ("{:.4f} px", "dots_minus_search.largest_u_px"),
            "... at most, across the line": ("{:.4f} px", "dots_minus_search.largest_v_px"),
            "Dots found": ("{}", "dots_minus_search.found"),
        }
    else:
        line = "line_minus_search"
        shown |= {
            "Rendered line minus ray search, rms": ("{:.4f} px", f"{line}.rms_px"),
            "... at most, line ends included": ("{:.4f} px", f"{line}.largest_px"),
            "Centres found": ("{}", f"{line}.centres"),
            "... compared with the search": ("{}", f"{line}.compared"),
            "... left out, an edge cuts the line": ("{}", f"{line}.cut_centres"),
            "... left out, off the searched line": ("{}", f"{line}.stray_centres"),
            "Centres that are ok and wrong by the frame's truth": ("{}", "line_minus_truth.wrong"),
        }
    searched = f"{len(result.probe_y_mm)} rays"
    shown |= {
        f"The paper's search: largest distance of {searched}": (
            "{:.2g} µm",
            "paper_search.largest_distance_um",
        ),
        "Newton's search: the same": ("{:.1g} µm", "newton_search.largest_distance_um"),
        "Newton's search: marches a ray": ("{}", "newton_search.iterations"),
        f"Frame of {size[0]} x {size[1]} px, {spp} samples a lit pixel": (
            "{:.1f} s",
            "render_time_s",
        ),
        f"Search of {result.rays} rays": ("{:.2f} s", "search_time_s"),
    }
    rows = tuple(
        (name, *(in_words(_value(state, key), shape) for state in states.values()))
        for name, (shape, key) in shown.items()
    )
    return TextTable(("", *states), rows, numeric=(False, *(True for _ in states)))


def _value(state: StateSummary, key: str) -> float | int | None:
    value: object = state
    for name in key.split("."):
        value = getattr(value, name)
    return value  # type: ignore[return-value]


def _table_page(result: Measurement, figures: Summary) -> str:
    made = figures.made_with
    return (
        f"{table(result, figures).markdown()}\nMade by `virtual-sensor measure"
        f" {result.scene.path.stem}` in {figures.time_s:.0f} s, with {made.threads} threads"
        f" ({made.variant}); the frames' march: {made.march}.\n"
    )


def on_console(figures: Summary) -> list[TextTable | str]:
    """What the command prints: how wrong the section is, why, and whether the check holds."""
    states = [{"state": name} | state.to_dict() for name, state in figures.states.items()]
    dots = any(state["dots_minus_search"] for state in states)
    section = text_table(
        states,
        (
            Column("state", " "),
            Column("section.rms_um", "rms, µm"),
            Column("section.largest_um", "largest, µm", nothing="none"),
            Column("section.largest_y_mm", "at y, mm"),
            Column("section.points", "points", "{}"),
            Column("render_time_s", "rendered in", "{:.1f} s"),
        ),
        "Measured minus true section (positive: outside the part)",
    )
    check = text_table(
        states,
        (
            Column("state", " "),
            *(
                (
                    Column("dots_minus_search.rms_px", "rms, px", "{:.4f}", "none"),
                    Column("dots_minus_search.largest_u_px", "largest in u, px", "{:.4f}", "none"),
                    Column("dots_minus_search.largest_v_px", "largest in v, px", "{:.4f}", "none"),
                    Column("dots_minus_search.found", "dots found", "{}"),
                    Column("dots_minus_search.dots", "of", "{}"),
                )
                if dots
                else (
                    Column("line_minus_search.rms_px", "rms, px", "{:.4f}", "none"),
                    Column("line_minus_search.largest_px", "largest, px", "{:.4f}", "none"),
                    Column("line_minus_search.compared", "centres compared", "{}"),
                    Column("line_minus_search.centres", "of", "{}"),
                )
            ),
        ),
        f"Check: rendered {'dots' if dots else 'line'} minus ray search",
    )
    return [section, *why(figures), check]


def why(figures: Summary) -> list[str]:
    """Sentences on how far hot air moves points, and by which light path; [] of a cold part."""
    hot = figures.states.get("hot")
    if hot is None or hot.paths is None:
        return []
    rays, paths = figures.probe_rays, hot.paths
    return [
        f"Hot air bends both light paths: the laser's makes"
        f" {in_words(paths.laser_rms_um, '{:.3g}')} µm rms of the section's"
        f" error, the camera's {in_words(paths.camera_rms_um, '{:.3g}')} µm rms.",
        f"It moves the lit point by up to {in_words(rays.largest_incidence_shift_um, '{:.3g}')} µm,"
        f" the measured one by up to {in_words(rays.largest_measured_shift_um, '{:.3g}')} µm"
        f" ({rays.lit} of {rays.rays} probe rays are lit).",
    ]
