"""A correction's results: tables, points, and the figures that judge them."""

from pathlib import Path

import numpy as np

from virtual_sensor.files import RESULTS_SIGN, folder_written_whole
from virtual_sensor.records import write_ply
from virtual_sensor.reporting.files import FileOf, write_results
from virtual_sensor.reporting.tables import Column, TextTable, text_table
from virtual_sensor.studies.correct.correction import (
    CorrectedTable,
    Correction,
    CorrectionSummary,
)

FILES = (
    FileOf("points_*.csv", "Corrected points with their covariance.", CorrectedTable),
    FileOf("points_*_uncorrected.ply", "The points as if light ran straight, mm, world."),
    FileOf("points_*.ply", "The corrected points, mm, world; intensity is their sigma in µm."),
    FileOf(RESULTS_SIGN, "The figures of the correction.", CorrectionSummary),
)


def save(result: Correction, folder: Path, command: str, overwrite: bool = False) -> None:
    """Write a correction's files (`FILES`), all of them or none.

    Raises
    ------
    InputError
        If the folder exists (and `overwrite` is not set) or can't be written.
    """
    with folder_written_whole(folder, overwrite) as place:
        for each in result.measurements:
            sigma = np.nan_to_num(each.sigma_um)
            write_ply(place / f"points_{each.name}.ply", each.point_mm, sigma)
            uncorrected = place / f"points_{each.name}_uncorrected.ply"
            write_ply(uncorrected, each.point_uncorrected_mm, sigma)
        tables = {f"points_{each.name}.csv": each.table for each in result.measurements}
        write_results(place, FILES, {**tables, RESULTS_SIGN: result.summary})


def on_console(result: Correction) -> list[TextTable | str]:
    """What the command prints: how far points were moved, and what is left."""
    rows = [{"name": each.name, "of": each.summary} for each in result.measurements]
    columns = [
        Column("name", " "),
        Column("of.points", "points", "{:d}"),
        Column("of.moved_rms_um", "moved, rms µm", "{:.3g}"),
        Column("of.distance_uncorrected.rms_um", "off the part before, rms µm", "{:.3g}"),
        Column("of.distance.rms_um", "after, rms µm", "{:.3g}"),
        Column("of.median_sigma_um", "sigma, µm", "{:.2g}"),
    ]
    return [text_table(rows, columns, "Corrected through the air")]
