"""Whether a field of air is that of the scene's part: of its shape, its place, its temperature."""

from __future__ import annotations

import json
from contextlib import suppress
from functools import lru_cache
from pathlib import Path

import numpy as np

from virtual_sensor.imaging.field_solid import SolidFit
from virtual_sensor.medium.description import MediumDescription
from virtual_sensor.medium.netcdf import AMBIENT_TEMPERATURE_K, ambient_of, read_field_file
from virtual_sensor.medium.netcdf_elements import open_netcdf
from virtual_sensor.medium.quantities import implied_temperature_c
from virtual_sensor.medium.units import ZERO_CELSIUS_K

_SAME_C = 1.0
_HOTTER, _COLDER = 0.03, 0.3  # of what the part has above the air: its hottest air may be so


def field_notes(
    air: MediumDescription, name: str, fit: SolidFit | None, temperature: str, simulate: str
) -> list[str]:
    """Notes of a field that is not that of a scene's part, with the remedy.

    Parameters
    ----------
    air : MediumDescription
        With the field's file, if it is in one.
    name : str
        What the field is called.
    fit : SolidFit or None
        Of its solid; None if it marks none.
    temperature : str
        The part's in the scene, degC; empty where the scene does not say.
    simulate : str
        Command that makes the field of this part.
    """
    notes = []
    if fit is None:
        if air.path:
            notes.append(f"{name} marks no solid: whether it is of this part can't be checked")
    elif not fit.alike:
        move = ""
        if fit.shift_mm is not None:
            by = ", ".join(f"{-mm + 0.0:.4g}" for mm in fit.shift_mm)
            move = f"move the field by ({by}) mm (to_world of the integrator), or "
        notes.append(
            f"{name} is not of this part: {fit.words}; {move}make this part's own: {simulate}"
        )
    elif fit.holds_more:
        notes.append(
            f"{name} is not of all that is in the scene: surfaces lie up to {fit.largest_mm:.2g} mm"
            f" beside its solid; make the field of them all: {simulate}"
        )
    if temperature and air.path:
        notes += _temperature_notes(name, air, float(temperature), simulate)
    return notes


def _temperature_notes(
    name: str, air: MediumDescription, part_c: float, simulate: str
) -> list[str]:
    assert air.path
    simulated_c, hottest_c, ambient_c = _temperatures(
        air.path, air.path.stat().st_mtime_ns, air.time_s
    )
    rise = part_c - ambient_c
    if simulated_c is not None:
        if abs(simulated_c - part_c) <= _SAME_C:
            return []
        said, other = "is of a part of", f"{simulated_c:g}"
    elif hottest_c > part_c + _HOTTER * abs(rise) + _SAME_C:
        said, other = "is hotter than the part, up to", f"{hottest_c:.0f}"
    elif hottest_c < part_c - _COLDER * rise:
        said, other = "is much colder than the part, up to", f"{hottest_c:.0f}"
    else:
        return []
    return [
        f"{name} {said} {other} degC, and the scene's temperature is {part_c:g} degC; give a field"
        f" of {part_c:g} degC, or temperature={other}, or make its own: {simulate}"
    ]


@lru_cache(maxsize=8)
def _temperatures(
    file: Path, modified: int, time_s: float | None
) -> tuple[float | None, float, float]:
    """Temperatures of a field's file in degC: the simulated part's, its hottest and ambient air."""
    nc = open_netcdf(file)
    ambient_k = AMBIENT_TEMPERATURE_K
    if "temperature" in nc.variables:
        ambient_k = ambient_of(nc, "temperature", "ambient_temperature", ambient_k)
    ambient_c = ambient_k - ZERO_CELSIUS_K
    simulated_c = None
    with suppress(ValueError, TypeError, KeyError):  # not by `field simulate`
        simulated_c = float(json.loads(str(nc.attributes["parameters"]))["temperature_c"])
    read = read_field_file(file, 532.0, time_s=time_s)
    with np.errstate(divide="ignore"):
        hottest = implied_temperature_c(np.nanmin(read.refractivity), read.ambient, ambient_c)
    return simulated_c, float(hottest), ambient_c
