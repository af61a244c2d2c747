"""Whole surfaces in a correction's results: maps before and after, a table, files of all pixels."""

from __future__ import annotations

from collections.abc import Sequence
from pathlib import Path
from typing import Any

from matplotlib.axes import Axes
from numpy.typing import NDArray

from virtual_sensor.records import Described, write_layers
from virtual_sensor.reporting.maps import Scale, draw_map, scale_of
from virtual_sensor.reporting.pictures import Panel
from virtual_sensor.reporting.style import drawable
from virtual_sensor.reporting.tables import Column, TextTable, text_table
from virtual_sensor.reporting.words import micrometres
from virtual_sensor.studies.correct.correction import Corrected, CorrectedSummary
from virtual_sensor.studies.correct.surface import CorrectedSurface

LAYERS = (
    Described("point.X, point.Y, point.Z", "mm", "Corrected world point; NaN where there is none."),
    Described(
        "uncorrected.X, uncorrected.Y, uncorrected.Z", "mm", "The same, light taken straight."
    ),
    Described("distance", "µm", "Of the corrected point from the scene's part, positive outside."),
    Described("distance_uncorrected", "µm", "The same of the uncorrected point."),
    Described(
        "sigma", "µm", "Standard deviation along the line of sight, of the decoding's noise."
    ),
    Described("epipolar", "px", "Residual across the epipolar line of straight light."),
)
"""Layers of a surface's file, float32."""

_MOST_MAPS = 4
"""Surfaces that are drawn."""


def write_surface(path: Path, surface: CorrectedSurface) -> None:
    """Write a surface's pixels as float32 layers (`LAYERS`) of OpenEXR.

    Raises
    ------
    InputError
        If the file can't be written.
    """
    layers: dict[str, NDArray[Any] | None] = {
        f"{name}.{axis}": image.point_mm[..., i]
        for name, image in (("point", surface.corrected), ("uncorrected", surface.uncorrected))
        for i, axis in enumerate("XYZ")
    }
    layers |= {
        "distance": surface.corrected_um,
        "distance_uncorrected": surface.uncorrected_um,
        "sigma": surface.corrected.sigma_um,
        "epipolar": surface.uncorrected.epipolar_px,
    }
    write_layers(path, layers)


def surface_table(measurements: dict[str, CorrectedSummary]) -> TextTable | None:
    """All pixels of each surface before and after; None where there is no surface."""
    rows = [{"name": n, **vars(each.surface)} for n, each in measurements.items() if each.surface]
    if not rows:
        return None
    return text_table(
        rows,
        (
            Column("name", "measurement"),
            Column("pixels", "pixels", "{:,}"),
            Column("uncorrected_rms_um", "before"),
            Column("rms_um", "after"),
            Column("mean_um", "mean after"),
            Column("epipolar_px", "epipolar, px"),
        ),
        "All pixels of the surface: distance from the scene's part, rms, in µm",
    )


def surface_panels(measurements: Sequence[Corrected]) -> dict[str, Panel]:
    """Maps of the first surfaces: before and after, each kind in one scale, and the residual."""
    found = [(each, each.surface) for each in measurements if each.surface][:_MOST_MAPS]
    if not found:
        return {}
    before = scale_of("signed", *(surface.uncorrected_um for _, surface in found))
    after = scale_of("signed", *(surface.corrected_um for _, surface in found))
    panels = {}
    for number, (each, surface) in enumerate(found, 1):
        name = f"{drawable(each.name)}, " if len(found) > 1 else ""
        errors = surface.errors
        panels[f"before_{number}"] = _map(
            f"{name}before: {micrometres(errors.uncorrected_rms_um)} rms",
            surface.uncorrected_um,
            before,
        )
        panels[f"after_{number}"] = _map(
            f"{name}after: {micrometres(errors.rms_um)} rms", surface.corrected_um, after
        )
        residual = surface.uncorrected.epipolar_px
        if residual is not None and errors.epipolar_px is not None:
            title = f"{name}epipolar residual: {errors.epipolar_px:.2g} px rms"
            panels[f"epipolar_{number}"] = _map(title, residual, scale_of("signed", residual), "px")
    return panels


def _map(title: str, values: NDArray[Any], scale: Scale, unit: str = "µm") -> Panel:
    def draw(axes: Axes) -> None:
        draw_map(axes, values, unit, scale)

    return Panel(title[:1].upper() + title[1:], draw, f"Map over the camera's pixels, {title}.")
