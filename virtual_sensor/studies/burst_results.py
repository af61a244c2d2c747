"""A burst's results in a folder: the sway along the line and of the probe rays, frames, picture."""

from pathlib import Path
from typing import Any

import numpy as np

from virtual_sensor.files import RESULTS_SIGN, folder_written_whole
from virtual_sensor.metrology.deviation import UM_PER_MM
from virtual_sensor.metrology.line_peaks import Status
from virtual_sensor.studies.burst import Burst, spread
from virtual_sensor.studies.burst_report import draw_burst
from virtual_sensor.studies.tables import status_names, vectors, write_csv, write_json, write_ply

_POINT = ("x", "y", "z", "height")


def save_burst(
    result: Burst, figures: dict[str, Any], folder: Path, overwrite: bool = False
) -> None:
    """Write tables, points, summary and picture; all of them or none.

    `figures` is the burst's summary.

    Raises
    ------
    InputError
        If the folder exists (and `overwrite` is not set) or can't be written.
    """
    with folder_written_whole(folder, overwrite) as place:
        write_csv(place / "sway.csv", _sway_table(result))
        write_csv(place / "probe_rays.csv", _probe_rays_table(result))
        write_csv(place / "frames.csv", _frames_table(result))
        points = spread(result.with_height(result.points_mm))
        write_ply(place / "sway.ply", points.mean[:, :3], points.std[:, 3] * UM_PER_MM)
        draw_burst(result, figures, place / "report.png")
        write_json(place / RESULTS_SIGN, figures)


def _sway_table(result: Burst) -> dict[str, Any]:
    """Mean and standard deviation of the line's centre and point, one row per image column."""
    line = spread(result.centres_px)
    points = spread(result.with_height(result.points_mm))
    return {
        "column": result.lines[0].column,
        "frames": line.frames,
        "mean_v_px": line.mean[:, 1],
        "std_v_px": line.std[:, 1],
        **vectors("mean_mm", points.mean, _POINT),
        **vectors("std_um", points.std * UM_PER_MM, _POINT),
        "status": result.column_status,
    }


def _probe_rays_table(result: Burst) -> dict[str, Any]:
    """Mean and standard deviation of the probe rays' pixels, points B and measured points B_m."""
    pixel = spread(result.rays_px)
    incidence = spread(result.with_height(result.incidence_mm))
    measured = spread(result.with_height(result.measured_mm))
    return {
        "y_mm": result.probe_y_mm,
        "frames": pixel.frames,
        **vectors("mean_px", pixel.mean, "uv"),
        **vectors("std_px", pixel.std, "uv"),
        **vectors("mean_B_mm", incidence.mean, _POINT),
        **vectors("std_B_um", incidence.std * UM_PER_MM, _POINT),
        **vectors("mean_B_m_mm", measured.mean, _POINT),
        **vectors("std_B_m_um", measured.std * UM_PER_MM, _POINT),
        "status": result.ray_status,
    }


def _frames_table(result: Burst) -> dict[str, Any]:
    """Every frame's centres and points, one row per frame and column."""
    lines = result.lines
    columns = lines[0].column
    return {
        "time_s": np.repeat(result.time_s, len(columns)),
        "column": np.tile(columns, len(lines)),
        "row": np.concatenate([line.row for line in lines]),
        "sigma": np.concatenate([line.sigma for line in lines]),
        **vectors("point_mm", result.points_mm.reshape(-1, 3), "xyz"),
        "status": np.concatenate([status_names(line.status, Status) for line in lines]),
    }
