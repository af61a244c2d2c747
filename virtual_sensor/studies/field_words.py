"""A field's figures in words, as tables, and for other programs."""

from typing import Any

import numpy as np

from virtual_sensor.imaging.checks import JUMP_REFUSED_PX, JUMP_TOLD_PX
from virtual_sensor.metrology.truth import FINE_PX
from virtual_sensor.studies.field_grid import Convergence, Loss
from virtual_sensor.studies.field_info import FieldInfo

COARSE_PX = 0.1
"""Loss that a field's grid may cause: what a measurement must resolve; `FINE_PX` is what it can."""

_LEAST_PX = 1e-4

Table = tuple[tuple[str, ...], list[tuple[str, ...]]]
"""Headings, and rows of as many cells."""


def facts(info: FieldInfo) -> dict[str, str]:
    """What the file holds, under a short name each."""
    contents, field = info.contents, info.field
    planes = [
        f"{axis} = {start:g}"
        for axis, start, even in zip("xyz", field.origin, field.mirror, strict=True)
        if even
    ]
    told = {
        "file": f"{info.path}, {contents.size_bytes / 1e6:.2f} MB, holds {contents.kind}",
        **contents.attributes,
        "times": _times(info),
        "grid": f"{' x '.join(map(str, field.shape))} nodes (x, y, z), spacing"
        f" {' x '.join(f'{s:g}' for s in field.spacing)} mm",
        "extent": ", ".join(
            f"{axis} {low:g} to {high:g}" for axis, low, high in zip("xyz", *field.box, strict=True)
        )
        + " mm"
        + (f", mirror images at {' and '.join(planes)} mm included" if planes else ""),
        "n - 1": "{:.4g} to {:.4g} in the air, ambient".format(*info.refractivity_range)
        + f" {field.ambient:.4g}, at {info.wavelength_nm:g} nm",
    }
    temperature = info.temperature_range_c
    if temperature:
        told["implied temperature"] = (
            "{:.0f} to {:.0f} degC (ideal gas at ambient pressure,".format(*temperature)
            + f" ambient {contents.ambient_temperature_k - 273.15:g} degC)"
        )
    if info.scene and info.effect_px is not None:
        shift = np.linalg.norm(info.effect_px, axis=1)
        worst = int(np.nanargmax(shift))
        told["effect"] = (
            "moves what the camera sees of the probe rays by up to"
            f" {_pixels(shift[worst])} px (hot minus cold; the ray at y ="
            f" {info.probe_y_mm[worst]:g} mm; scene {info.scene.path.stem})"
        )
    return told


def _times(info: FieldInfo) -> str:
    times = info.contents.times_s
    if times is None:
        return "one instant, no time axis"
    return (
        f"{len(times)} from {times[0]:g} to {times[-1]:g} s; what follows is at {info.time_s:g} s"
    )


def tables(info: FieldInfo) -> list[Table]:
    """All that is told in tables; those that would be empty are left out."""
    return [t for t in (border_table(info), structure_table(info), grid_table(info)) if t[1]]


def border_table(info: FieldInfo) -> Table:
    """Jump of n at each face of the border, and what it does to light that crosses it."""
    rows: list[tuple[str, ...]] = []
    for face in info.faces:
        effects = [f"{who} {_pixels(shift)} px" for who, shift in face.shift_px.items()]
        jumps = [f"{jump:.1e}" for jump in face.crossed_jump.values()]
        rows.append((face.name, f"{face.jump:.1e}", ", ".join(jumps), ", ".join(effects)))
    return ("face", "largest jump of n", "where light enters", "moves the image by"), rows


def structure_table(info: FieldInfo) -> Table:
    """The narrowest structures, in mm and nodes."""
    rows: list[tuple[str, ...]] = [
        (
            f"along {structure.axis}, {'at the wall' if structure.at_wall else 'in free air'}",
            f"{structure.half_width_mm:.2f} mm",
            f"{structure.nodes:.1f}",
            "({:g}, {:g}, {:g}) mm".format(*structure.place_mm),
        )
        for structure in info.structures
    ]
    return ("narrowest structure", "half width", "in nodes", "peak at"), rows


def grid_table(info: FieldInfo) -> Table:
    """What fewer nodes would change, and what the present ones lose."""
    heads = (
        "nodes along",
        "every 2nd: n, max",
        "rms",
        "rays, px",
        "every 4th: rays, px",
        "order",
        "present grid loses, px",
    )
    rows = []
    for loss in info.losses:
        pixel = loss.pixel or Convergence(np.nan, np.nan)
        change = (f"{n:.1e}" if np.isfinite(n) else "-" for n in (loss.largest, loss.rms.twice))
        order = f"{pixel.order:.1f}" if np.isfinite(pixel.order) else "-"
        twice, fourfold, lost = map(_pixels, (pixel.twice, pixel.fourfold, pixel.present))
        rows.append((loss.axes, *change, twice, fourfold, order, lost))
    return heads, rows


def _pixels(shift: float) -> str:
    """Two digits of a shift in px, as far as a march is good for."""
    if np.isnan(shift):
        return "-"
    return f"{shift:.2g}" if shift >= _LEAST_PX else f"< {_LEAST_PX:g}"


def verdicts(info: FieldInfo) -> list[str]:
    """Whether it matters: of the border and of the grid, in a sentence each."""
    told = []
    if info.line:
        told.append(_border_verdict(info))
    together = info.losses[-1]
    if together.pixel and np.isfinite(together.pixel.twice):
        told.append(_grid_verdict(info.losses))
    elif not together.pixel:
        told.append("Grid: how much its loss is in px can't be told without light.")
    else:
        told.append("Grid: too few nodes along each axis to leave any out and see.")
    return told


def _border_verdict(info: FieldInfo) -> str:
    worst = max(info.faces, key=lambda face: face.largest_px)
    if worst.largest_px <= JUMP_TOLD_PX:
        return (
            f"Border: sound. Where light enters, the jump of n moves the image by"
            f" {_pixels(worst.largest_px)} px at most; {JUMP_TOLD_PX:g} px would not be seen."
        )
    where = f"the jump of n at {worst.name} moves the image by {worst.largest_px:.2g} px"
    if worst.largest_px <= JUMP_REFUSED_PX:
        return f"Border: tolerable. {where}; every measurement in this field will say so."
    return (
        f"Border: too close. {where}, and above {JUMP_REFUSED_PX:g} px no measurement is made in"
        " it; give a field that reaches further out."
    )


def _grid_verdict(losses: list[Loss]) -> str:
    together = losses[-1].pixel
    assert together  # asked only then
    lost = f"between its nodes this grid loses {_pixels(together.present)} px of the probe rays"
    if together.present <= FINE_PX:
        verdict = f"Grid: fine enough for {FINE_PX:g} px: {lost}."
    elif together.present <= COARSE_PX:
        verdict = f"Grid: fine enough for {COARSE_PX:g} px but not for {FINE_PX:g} px: {lost}."
    else:
        verdict = f"Grid: not fine enough for {COARSE_PX:g} px: {lost}."
    rough = [
        loss.axes
        for loss in losses[:-1]
        if loss.pixel and not loss.pixel.converges and loss.pixel.twice > FINE_PX
    ]
    if rough:
        verdict += (
            f" Along {' and '.join(rough)} every 4th node is hardly worse than every 2nd: the field"
            " has structures as narrow as its grid, such as the kinks that linear interpolation"
            " from a coarser mesh leaves, so this is no more than an order of magnitude."
        )
    return f"{verdict} What the mesh of its simulation lost is not in it."


def figures(info: FieldInfo) -> dict[str, Any]:
    """The same for other programs; None where there is no number."""
    contents, field = info.contents, info.field
    return {
        "file": str(info.path),
        "bytes": contents.size_bytes,
        "quantity": contents.kind,
        "attributes": contents.attributes,
        "times, s": None if contents.times_s is None else contents.times_s.tolist(),
        "time, s": info.time_s,
        "nodes": list(field.shape),
        "spacing, mm": field.spacing.tolist(),
        "mirrored": list(field.mirror),
        "box, mm": field.box.tolist(),
        "wavelength, nm": info.wavelength_nm,
        "n - 1": list(info.refractivity_range),
        "ambient n - 1": field.ambient,
        "implied temperature, degC": info.temperature_range_c,
        "scene": str(info.scene.path) if info.scene else None,
        "parameters": dict(info.scene.parameters) if info.scene else None,
        "border": {
            face.name: {
                "largest jump of n": face.jump,
                "jump where light enters": face.crossed_jump,
                "effect, px": face.shift_px,
            }
            for face in info.faces
        },
        "narrowest structures": [
            {
                "axis": structure.axis,
                "at the wall": structure.at_wall,
                "half width, mm": structure.half_width_mm,
                "nodes": structure.nodes,
                "peak, mm": structure.place_mm.tolist(),
            }
            for structure in info.structures
        ],
        "fewer nodes": {
            loss.axes: {
                "largest change of n, every 2nd": _known(loss.largest),
                "rms change of n": _convergence(loss.rms),
                "largest shift of the probe rays, px": _convergence(loss.pixel),
            }
            for loss in info.losses
        },
        "effect on the probe rays (u, v), px": None
        if info.effect_px is None
        else [[_known(px) for px in row] for row in info.effect_px],
        "verdicts": verdicts(info),
        "notes": info.notes,
    }


def _convergence(loss: Convergence | None) -> dict[str, float | None] | None:
    if loss is None:
        return None
    return {
        "every 2nd": _known(loss.twice),
        "every 4th": _known(loss.fourfold),
        "order": _known(loss.order),
        "present grid": _known(loss.present),
    }


def _known(value: float) -> float | None:
    return float(value) if np.isfinite(value) else None
