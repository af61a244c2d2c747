"""A measurement's results in a folder: frames, centres, points, searches, summary and picture."""

from concurrent.futures import ThreadPoolExecutor
from pathlib import Path
from typing import Any

import numpy as np

from virtual_sensor.files import RESULTS_SIGN, folder_written_whole, written_whole
from virtual_sensor.imaging.render import write_exr, write_png
from virtual_sensor.metrology.calibration import calibration_of, calibration_text
from virtual_sensor.metrology.centres import Status
from virtual_sensor.metrology.deviation import euclidean, separate_paths
from virtual_sensor.metrology.triangulation import triangulate
from virtual_sensor.optics.ray_search import SearchStatus
from virtual_sensor.studies.measure import (
    Measurement,
    State,
    probe_deviations,
)
from virtual_sensor.studies.notes import TRUTH, WRONG
from virtual_sensor.studies.report import draw_report
from virtual_sensor.studies.tables import (
    in_words,
    status_names,
    vectors,
    write_csv,
    write_json,
    write_ply,
)

CALIBRATION = "calibration.yaml"
"""The sensor as `virtual-sensor detect --calibration` reads it."""


def save(
    result: Measurement, figures: dict[str, Any], folder: Path, overwrite: bool = False
) -> None:
    """Write frames, centres, points, searches, summary and picture; all of them or none.

    `figures` is the measurement's summary.

    Raises
    ------
    InputError
        If the folder exists (and `overwrite` is not set) or can't be written.
    """
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
            write_csv(place / f"line_{name}.csv", _line_table(state))
            if state.dots:
                seen = state.dots
                write_csv(
                    place / f"dots_{name}.csv",
                    {
                        "b_mm": state.scene.sensor.laser.dots_mm,
                        **vectors("pixel", seen.pixel, "uv"),
                        "flux": seen.flux,
                        **vectors("searched_pixel", seen.true_pixel, "uv"),
                        **vectors("point_mm", state.points_mm, "xyz"),
                        "status": np.where(seen.found, "ok", "not_found"),
                        "status_search": status_names(state.dense.status, SearchStatus),
                    },
                )
            brightness = state.dots.flux if state.dots else state.line.amplitude
            write_ply(place / f"points_{name}.ply", state.points_mm, brightness)
        write_csv(place / "probe_rays.csv", _probe_rays_table(result))
        write_csv(place / "dense_search.csv", _dense_table(result))
        sensor = result.cold.scene.sensor
        with written_whole(place / CALIBRATION) as temporary:
            text = calibration_text(calibration_of(sensor), CALIBRATION)
            temporary.write_text(text, encoding="utf-8")
        draw_report(result, figures, place / "report.png")
        with written_whole(place / "table.md") as temporary:
            temporary.write_text(markdown_table(result, figures), encoding="utf-8")
        for frame in written:
            frame.result()
        write_json(place / RESULTS_SIGN, figures)


def markdown_table(result: Measurement, figures: dict[str, Any]) -> str:
    """Accuracy and speed of a measurement, as the README shows them."""
    states = figures["states"]
    line, dots = "rendered line minus search, px", "rendered dots minus search, px"
    of_dots = {
        "Rendered dots minus ray search, rms": ("{:.4f} px", (dots, "rms")),
        "... at most, along the line": ("{:.4f} px", (dots, "largest in u")),
        "... at most, across the line": ("{:.4f} px", (dots, "largest in v")),
        "Dots found": ("{}", (dots, "found")),
    }
    of_line = {
        "Rendered line minus ray search, rms": ("{:.4f} px", (line, "rms")),
        "... at most, line ends included": ("{:.4f} px", (line, "largest")),
        "Centres found": ("{}", (line, "centres")),
        "... compared with the search": ("{}", (line, "columns compared")),
        "... left out, an edge cuts the line": ("{}", (line, "centres cut by an edge")),
        "... left out, off the searched line": ("{}", (line, "centres off the searched line")),
        "Centres that are ok and wrong by the frame's truth": ("{}", (TRUTH, WRONG)),
    }
    rows = {
        **(of_dots if result.cold.dots else of_line),
        "The paper's search: largest distance of {probes} rays": (
            "{:.2g} µm",
            ("paper's search, probe rays", "largest distance, um"),
        ),
        "Newton's search: the same": (
            "{:.1g} µm",
            ("Newton's search, probe rays", "largest distance, um"),
        ),
        "Newton's search: marches a ray": ("{}", ("Newton's search, probe rays", "marches")),
        "Frame of {0} x {1} px, {spp} samples a lit pixel": ("{:.1f} s", ("seconds", "render")),
        "Search of {rays} rays": ("{:.2f} s", ("seconds", "search")),
    }
    scene = result.cold.scene
    words = {"spp": figures["made_with"]["samples per pixel"], "rays": result.rays}
    words["probes"] = len(result.probe_y_mm)
    lines = ["| | " + " | ".join(states) + " |", "|---|" + "---|" * len(states)]
    for name, (shape, (group, key)) in rows.items():
        values = [state[group][key] for state in states.values()]
        cells = (in_words(value, shape) for value in values)
        lines.append(f"| {name.format(*scene.sensor.camera.size, **words)} | {' | '.join(cells)} |")
    made = figures["made_with"]
    lines += [
        "",
        f"Made by `virtual-sensor measure {scene.path.stem}` in {figures['seconds']:.0f} s, with"
        f" {made['threads']} threads ({made['variant']}); the frames' march: {made['march']}.",
    ]
    return "\n".join(lines) + "\n"


def _line_table(state: State) -> dict[str, Any]:
    line = state.line
    return {
        "column": line.column,
        "row": line.row,
        "sigma": line.sigma,
        "width": line.width,
        "amplitude": line.amplitude,
        "status": status_names(line.status, Status),
        **vectors("point_mm", triangulate(state.scene.sensor, line.pixel), "xyz"),
    }


def _probe_rays_table(result: Measurement) -> dict[str, Any]:
    table: dict[str, Any] = {"y_mm": result.probe_y_mm}
    for letter, state in zip("AB", result.states.values(), strict=False):
        table |= {
            **vectors(f"{letter}_mm", state.newton.laser_point_mm, "xyz"),
            **vectors(f"pixel_{letter}", state.newton.pixel, "uv"),
            **vectors(f"pixel_{letter}_paper", state.paper.pixel, "uv"),
            f"distance_{letter}_paper_um": state.paper.distance_um,
            f"status_{letter}": status_names(state.newton.status, SearchStatus),
            f"status_{letter}_paper": status_names(state.paper.status, SearchStatus),
        }
    for suffix, step in (("", None), ("_rounded", 0.25)):
        d = probe_deviations(result, step)
        for name, values, axes in (
            ("B-A_um", d.incidence_um, "xyz"),
            ("B-B_m_um", d.hot_um, "xyz"),
            ("B_m-A_m_um", d.measured_um, "xyz"),
            ("A-A_m_um", d.cold_um, "xyz"),
            ("pixel_B-A", d.pixel_px, "uv"),
        ):
            table |= vectors(name + suffix, values, axes)
            table[f"{name}{suffix}_norm"] = euclidean(values)
    if result.hot:
        A, B = result.cold.newton, result.hot.newton
        paths = separate_paths(
            result.hot.scene.sensor.camera, A.laser_point_mm, B.laser_point_mm, A.pixel, B.pixel
        )
        table |= vectors("laser_to_object_px", paths.laser_to_object_px, "uv")
        table |= vectors("object_to_camera_px", paths.object_to_camera_px, "uv")
    return table


def _dense_table(result: Measurement) -> dict[str, Any]:
    table: dict[str, Any] = {"y_mm": result.dense_y_mm}
    for letter, state in zip("AB", result.states.values(), strict=False):
        found = state.dense
        table |= {
            **vectors(f"{letter}_mm", found.laser_point_mm, "xyz"),
            **vectors(f"pixel_{letter}", found.pixel, "uv"),
            **vectors(f"{letter}_m_mm", triangulate(state.scene.sensor, found.pixel), "xyz"),
            f"status_{letter}": status_names(found.status, SearchStatus),
        }
    return table
