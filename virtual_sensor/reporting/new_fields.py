"""What is printed of a field that was simulated or imported."""

from __future__ import annotations

import shlex
from pathlib import Path
from typing import TYPE_CHECKING

import numpy as np
from scipy import ndimage

from virtual_sensor.medium.units import ZERO_CELSIUS_K

if TYPE_CHECKING:
    from virtual_sensor.medium.imports.import_field import Imported
    from virtual_sensor.studies.simulate import Simulation


def simulated(result: Simulation, command: list[str] | None = None) -> list[str]:
    """When it ended, and how sound it is: heat balance, Nusselt number, wall layer.

    `command` is the one that simulated it, its output left out: that of a second look is made of
    it.
    """
    end = f"ended at {result.end.time_s:g} s of flow"
    if np.isfinite(result.drift_px_per_s):
        end += f", when the probe rays moved by {result.drift_px_per_s:.2g} px per s of flow"
    if result.quick:
        end += ": --quick ends there, steady or not"
    balance = result.balance
    lines = [
        end,
        f"heat: {balance.wall_w:.4g} W given off, {balance.outflow_w:.4g} W carried out"
        f" ({balance.mismatch:+.1%})",
    ]
    if np.isfinite(result.nusselt):
        lines.append(f"mean Nusselt number {result.nusselt:.3g}, by air of film temperature")
    lines.append(f"cells of {result.cell_mm:g} mm, {result.wall_layer_cells} in the wall layer")
    if result.quick:
        words = [*(command or []), "--cell", f"{result.cell_mm / 1.5:.2g}", "-o", "finer_cells.nc"]
        lines.append(
            "a first look: what it does to light is right to some tenths, and wrong where bent"
            " paths cancel"
        )
        if command:
            lines.append(f"`{shlex.join(words)}` shows how much still changes")
    return lines


def imported(result: Imported) -> list[str]:
    """Range, extent, nodes and solid of a field that was imported, a line each."""
    made = result.quantity
    axes = [
        o + s * np.arange(n)
        for o, s, n in zip(made.origin_mm, made.spacing_mm, made.values.shape, strict=True)
    ]
    extent = ", ".join(
        f"{name} {axis[0]:.6g} to {axis[-1]:.6g}" + (" (mirrored)" if even else "")
        for name, axis, even in zip("xyz", axes, made.mirror, strict=True)
    )
    low, high = np.nanmin(made.values), np.nanmax(made.values)
    shown = {
        "temperature": f"{low - ZERO_CELSIUS_K:.5g} to {high - ZERO_CELSIUS_K:.5g} °C",
        "density": f"{low:.5g} to {high:.5g} kg/m³",
        "refractivity": f"n - 1 from {low:.5g} to {high:.5g}",
    }[made.kind]
    steps = " x ".join(f"{s:.4g}" for s in made.spacing_mm)
    lines = [
        f"{made.kind}: {shown}",
        f"extent: {extent} mm",
        f"nodes: {' x '.join(map(str, made.values.shape))}, {steps} mm apart",
    ]
    if made.solid is not None:
        places = ndimage.find_objects(made.solid.astype(int))[0]
        box = ", ".join(
            f"{name} {axis[s.start]:.4g} to {axis[s.stop - 1]:.4g}"
            for name, axis, s in zip("xyz", axes, places, strict=True)
        )
        lines.append(f"solid: {made.solid.sum()} nodes in {box} mm")
    return lines


def written(path: Path, measured: list[str] | None = None) -> str:
    """Where a field is, and what to do with it: if given, the command that measures in it."""
    name = shlex.quote(f"{path}")
    next_command = f"examine it with `virtual-sensor field info {name} -o picture.png`"
    if measured:
        next_command = f"measure in it with `{shlex.join(measured)}`"
    return f"{path.stat().st_size / 1e6:.3g} MB in {path}; {next_command}"
