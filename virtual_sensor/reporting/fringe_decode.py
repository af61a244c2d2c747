"""What was decoded in a user's images of fringes, as files: layers, pictures and a page."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from virtual_sensor.files import RESULTS_SIGN, folder_written_whole
from virtual_sensor.metrology.fringes.decoded import COORDINATES, DecodedFringes, FringeStatus
from virtual_sensor.records import Described, Record, plain, write_arrays, write_csv
from virtual_sensor.reporting.files import FileOf, write_results
from virtual_sensor.reporting.maps import frames_panel, map_panel, status_panel, window_of
from virtual_sensor.reporting.page import PAGE, Page, Section
from virtual_sensor.reporting.pictures import Panel, Picture, draw_picture
from virtual_sensor.reporting.style import drawable
from virtual_sensor.reporting.tables import Column, TextTable, pair_table, text_table
from virtual_sensor.reporting.words import counted, heading, in_words, time_in_words
from virtual_sensor.studies.fringes.decode import (
    DecodedSequence,
    DecodeSettings,
    SequenceSummary,
    SequenceTable,
)
from virtual_sensor.studies.fringes.decoded_files import LAYERS, write_decoded
from virtual_sensor.studies.provenance import Versions, versions

COMMAND = "fringes decode"

FORMATS = ("exr", "npz", "csv")

_PLACE = (
    Described("u_px, v_px", "px", "Pixel of the camera."),
    Described("column_px, row_px", "px", "The projector's pixel; no column of an axis without."),
    Described("sigma_column_px, sigma_row_px", "px", "Predicted standard deviations."),
    Described("modulation, mean", "", "Amplitude of the finest fringes, and mean grey value."),
)
_FILES = (
    FileOf(PAGE, "Page with the figures, the maps and the images."),
    FileOf("report.png", "The maps as one picture."),
    FileOf("decoded.exr", "What was decoded at each pixel, as layers.", LAYERS),
    FileOf("decoded.npz", "The same as NumPy's arrays, in double precision (--format npz)."),
    FileOf("decoded.csv", "A row for each pixel that was decoded (--format csv).", _PLACE),
    FileOf("images.csv", "Which image shows which pattern.", SequenceTable),
)


@dataclass(frozen=True)
class Summary(Record):
    """What was decoded, and how.

    Attributes
    ----------
    command : str
        The exact command that was given.
    made_with : Versions
        Versions.
    settings : DecodeSettings
        How the sequence was decoded.
    found : SequenceSummary
        What it shows.
    notes : tuple of str
        What was converted, assumed or is doubtful.
    """

    command: str
    made_with: Versions
    settings: DecodeSettings
    found: SequenceSummary
    notes: tuple[str, ...]


FILES = (*_FILES, FileOf(RESULTS_SIGN, "Settings, and what the sequence shows.", Summary))


def save(
    result: DecodedSequence,
    settings: DecodeSettings,
    folder: Path,
    command: str,
    overwrite: bool = False,
    formats: tuple[str, ...] = FORMATS[:1],
    notes: tuple[str, ...] = (),
) -> Summary:
    """Write layers, tables, pictures and page (`FILES`), all of them or none.

    Raises
    ------
    InputError
        If the folder can't be written.
    """
    summary = Summary(command, versions(), settings, result.summary, (*notes, *result.notes))
    with folder_written_whole(folder, overwrite) as place:
        if "exr" in formats:
            write_decoded(place / "decoded.exr", result.decoded)
        if "npz" in formats:
            write_arrays(place / "decoded.npz", _arrays(result.decoded), compressed=False)
        if "csv" in formats:
            write_csv(place / "decoded.csv", _rows(result.decoded))
        picture = draw(result)
        contents: Mapping[str, Any] = {
            "images.csv": result.table,
            "report.png": picture,
            PAGE: page(result, summary, picture),
            RESULTS_SIGN: summary,
        }
        write_results(place, FILES, contents)
    return summary


def _arrays(decoded: DecodedFringes) -> dict[str, Any]:
    names = ("column", "row", "sigma_column", "sigma_row", "modulation", "mean", "status")
    held = {name: getattr(decoded, name) for name in (*names, "size_px")}
    phases = {f"phase_{axis}": phase for axis, phase in decoded.phase.items()}
    return {name: each for name, each in (held | phases).items() if each is not None}


def _rows(decoded: DecodedFringes) -> dict[str, NDArray[Any]]:
    ok = decoded.ok
    v, u = np.nonzero(ok)
    found: dict[str, NDArray[Any]] = {"u_px": u, "v_px": v}
    for name in ("column", "row", "sigma_column", "sigma_row"):
        if (values := getattr(decoded, name)) is not None:
            found[f"{name}_px"] = values[ok]
    return found | {"modulation": decoded.modulation[ok], "mean": decoded.mean[ok]}


def lead(result: DecodedSequence) -> str:
    """What a reader wants to know first."""
    found = result.summary
    share = found.pixels / result.decoded.status.size
    if not found.pixels:
        return f"No pixel has a projector pixel: {_statuses(found)}."
    sigma = [
        f"{each:.2g} px ({name}s)"
        for name, each in (("column", found.sigma_column_px), ("row", found.sigma_row_px))
        if each is not None
    ]
    return (
        f"{counted(found.pixels, 'pixel')} of {result.decoded.status.size} ({share:.0%}) have a"
        f" projector pixel, with a predicted error of {' and '.join(sigma)}, median."
    )


def _statuses(found: SequenceSummary) -> str:
    """How many pixels have each status."""
    return ", ".join(f"{n} {name.replace('_', ' ')}" for name, n in found.status.items() if n)


def table(result: DecodedSequence) -> TextTable:
    """How many pixels have each status, and what it means."""
    rows = [
        {"status": status.name.lower().replace("_", " "), "pixels": count, "why": status.message}
        for status, count in FringeStatus.counts(result.decoded.status).items()
    ]
    columns = [Column("status"), Column("pixels", shape="{}"), Column("why", "what it means")]
    return text_table(rows, columns)


def figures(result: DecodedSequence) -> TextTable:
    """The figures of the sequence."""
    found = result.summary
    said: dict[str, Any] = {
        "images": found.images,
        "size": f"{found.size_px[0]} x {found.size_px[1]} px",
        "projector columns": _span(found.columns),
        "projector rows": _span(found.rows),
        "noise of the grey values": f"{found.noise:.3g}",
        "modulation, median": in_words(found.modulation_median, "{:.4g}", "not known"),
        "wrong fringe orders, expected": f"{found.wrong_orders:.2g}",
        "disorder of the images (0: none)": found.disorder and f"{found.disorder:.2f}",
        "time to decode": time_in_words(found.time_s),
    }
    return pair_table(("figure", "value"), said, "not known")


def _span(ends: tuple[float, float] | None) -> str:
    return f"{ends[0]:.1f} to {ends[1]:.1f} px" if ends else "none"


def page(result: DecodedSequence, summary: Summary, picture: Picture) -> Page:
    """The page: figures, maps, which image shows which pattern, settings."""
    columns = [
        Column("pattern"),
        Column("file", "image"),
        Column("mean_grey", "mean grey value", "{:.4g}"),
        Column("largest_grey", "largest", "{:.5g}"),
        Column("clipped_percent", "clipped in %", "{:.2g}"),
    ]
    images = text_table([*result.table.rows()], columns)
    settings = {heading(name): value for name, value in plain(summary.settings).items()}
    return Page(
        title=f"Fringes decoded: {summary.settings.codec}",
        lead=lead(result),
        sections=(
            Section("Figures", figures(result)),
            Section("Maps", picture),
            Section("What became of the pixels", table(result)),
            Section("Images and patterns", images),
            Section("Settings", pair_table(("setting", "value"), settings, "not given")),
        ),
        command=summary.command,
        made_with=summary.made_with,
        notes=summary.notes,
    )


def draw(result: DecodedSequence) -> Picture:
    """The images small, what was decoded, its predicted error, phase, modulation and statuses."""
    decoded, panels = result.decoded, []
    found = {"u": decoded.column, "v": decoded.row}
    errors = {"u": decoded.sigma_column, "v": decoded.sigma_row}
    known = [each for each in found.values() if each is not None]
    window = window_of(*known)
    names = result.codec.names
    alt = f"The images in the order of the patterns: {', '.join(names)}."
    title = f"The {len(result.images)} images in their order"
    panels.append(replace(frames_panel(title, result.images, names, None, alt), width=2))
    alt = f"What became of each pixel: {_statuses(result.summary)}."
    panels.append(status_panel("Status of each pixel", decoded.status, FringeStatus, alt))
    for axis, values in found.items():
        if values is None:
            continue
        name = COORDINATES[axis]
        title, words = f"Projector {name}", f"projector {name} in px"
        panels.append(map_panel(title, values, words, "span", window))
        if axis in decoded.phase:
            phase = np.where(decoded.ok, decoded.phase[axis], np.nan)
            title, words = f"Wrapped phase along {axis}", "phase of the finest period in rad"
            panels.append(map_panel(title, phase, words, "phase", window))
        sigma = errors[axis]
        if sigma is not None:
            title, words = f"Predicted error of the {name}", "sigma in projector px"
            panels.append(map_panel(title, sigma, words, "size", window))
    panels.append(_modulation(decoded))
    return draw_picture(drawable(result.codec.text), panels, columns=2)


def _modulation(decoded: DecodedFringes) -> Panel:
    words = "amplitude of the finest fringes, grey values"
    return map_panel("Modulation", decoded.modulation, words, "size")
