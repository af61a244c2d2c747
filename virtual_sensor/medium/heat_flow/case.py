"""The OpenFOAM case: a folder that a person would be glad to open.

Its dictionaries come from the folder `case` beside this file, as they are. What differs from case
to case stands in one file, `parameters`, which they include; the mesh is in `system/blockMeshDict`.
"""

from __future__ import annotations

import dataclasses
import hashlib
import json
import math
import shutil
from collections.abc import Mapping
from importlib import resources
from pathlib import Path
from typing import Any

from virtual_sensor.files import folder_written_whole, readable
from virtual_sensor.medium.heat_flow import setup, snapped_mesh
from virtual_sensor.medium.heat_flow.mesh import block_mesh_dict, cylinder_mesh
from virtual_sensor.medium.heat_flow.setup import HeatFlow
from virtual_sensor.medium.imports.import_field import CASE_SETUP

SETUP = CASE_SETUP
"""What the case was made from; a case whose setup is another is not gone on with."""

_OF_CYLINDERS = ("mirrorMeshDict",)
_OF_PARTS = ("snappyHexMeshDict", "surfaceFeatureExtractDict")

_HEADER = """FoamFile
{{
    version     2.0;
    format      ascii;
    class       dictionary;
    object      {name};
}}

"""


def write_case(
    flow: HeatFlow, folder: Path, end_s: float, write_interval_s: float, processes: int = 1
) -> None:
    """Write the case, all of it or nothing.

    Raises
    ------
    InputError
        If the folder exists or can't be written, or an STL file is not fit; see `read_part`.
    """
    with folder_written_whole(folder) as new:
        templates = resources.files("virtual_sensor.medium.heat_flow") / "case"
        with resources.as_file(templates) as path:
            unused = shutil.ignore_patterns(*(_OF_CYLINDERS if flow.stl else _OF_PARTS))
            shutil.copytree(path, new, dirs_exist_ok=True, ignore=unused)
        write_parameters(flow, new, end_s, write_interval_s, processes)
        if flow.stl:
            mesh = _write_part(flow.stl, flow, new)
        else:
            mesh = block_mesh_dict(cylinder_mesh(flow))
        text = _HEADER.format(name="blockMeshDict") + mesh
        (new / "system/blockMeshDict").write_text(text, encoding="utf-8")
        (new / SETUP).write_text(json.dumps(setup_record(flow), indent=2) + "\n", encoding="utf-8")


def setup_record(flow: HeatFlow) -> dict[str, Any]:
    """What `setup.json` holds."""
    record = dataclasses.asdict(flow) | {"light_mm": list(flow.light_mm)}
    if flow.stl:
        content = readable(flow.stl).read_bytes()
        record |= {"stl": flow.stl.name, "stl_sha256": hashlib.sha256(content).hexdigest()}
    return record


def mesh_commands(record: Mapping[str, Any]) -> list[tuple[str, ...]]:
    """Tools, with their arguments, that make the mesh of a case with this `setup_record`."""
    if record.get("stl"):
        return [("surfaceFeatureExtract",), ("blockMesh",), ("snappyHexMesh", "-overwrite")]
    mirror = [("mirrorMesh", "-overwrite")] if record.get("whole") else []
    return [("blockMesh",), *mirror]


def _write_part(stl: Path, flow: HeatFlow, folder: Path) -> str:
    """Write the part and what `snappyHexMesh` needs; give the body of `blockMeshDict`."""
    part = snapped_mesh.read_part(stl)
    snapped_mesh.check_place(stl, part, flow.light_mm)
    mesh = snapped_mesh.snapped_mesh(part, flow.cell_mm, flow.light_mm[2])
    surface = folder / snapped_mesh.SURFACE
    surface.parent.mkdir()
    part.surface.save(surface)  # one patch, also where the file has several solids
    with (folder / "parameters").open("a", encoding="utf-8") as file:
        file.write("\n" + _entries(snapped_mesh.snapping_parameters(mesh)))
    return snapped_mesh.box_mesh_dict(mesh)


def divisions(processes: int, section: bool) -> str:
    """How many slabs the processes share along x, y and z."""
    along_x = max(n for n in range(1, math.isqrt(processes) + 1) if processes % n == 0)
    x = 1 if section else along_x
    return f"({x} 1 {processes // x})"


def whole_step(write_interval_s: float, longest_s: float) -> str:
    """Time step, s, that goes into the interval a whole number of times; for `maxTimeStep`.

    OpenFOAM rounds interval / step to whole steps. Where it lies midway between two (100 ms in
    steps of 8 ms), the last bit decided, and a run that was stopped went on with other steps.
    """
    count = math.ceil(write_interval_s / longest_s * (1.0 - 1e-9))
    return f"{write_interval_s / count:.12g}" if count > 1 else f"{longest_s:.12g}"


def write_parameters(
    flow: HeatFlow, folder: Path, end_s: float, write_interval_s: float, processes: int
) -> None:
    """Write the file that the case's dictionaries include."""
    courant, longest_s, first_s, iterations = 14.0, 8e-3, 1e-5, 8
    if flow.unsteady:
        courant, longest_s = 0.7, 2e-3
    if flow.quick:
        longest_s, first_s, iterations = 16e-3, 5e-4, 4
    values = {
        "wallTemperature": (f"{flow.wall_k:g}", "K"),
        "ambientTemperature": (f"{flow.ambient_k:g}", "K"),
        "ambientPressure": (f"{flow.pressure_pa:g}", "Pa"),
        "initialVelocity": ("(0 0.02 0)" if flow.whole else "(0 0 0)", "m/s"),
        "gravity": (f"(0 0 {-setup.GRAVITY:g})", "m/s^2"),
        "ambientWeight": (f"{flow.density(flow.ambient_k) * setup.GRAVITY:.9g}", "N/m^3"),
        "molarMass": (f"{1e3 * setup.MOLAR_MASS:g}", "g/mol"),
        "heatCapacity": (f"{setup.HEAT_CAPACITY:g}", "J/(kg K)"),
        "sutherlandA": (f"{setup.SUTHERLAND_A:g}", "kg/(m s sqrt(K))"),
        "sutherlandT": (f"{setup.SUTHERLAND_T:g}", "K"),
        "rampTime": (f"{setup.RAMP_S:g}", "s"),
        "endTime": (f"{end_s:g}", "s"),
        "writeInterval": (f"{write_interval_s:g}", "s"),
        "timesKept": ("0", "0: all"),
        "maxCourant": (f"{courant:g}", ""),
        "maxTimeStep": (whole_step(write_interval_s, flow.time_step_s or longest_s), "s"),
        "firstTimeStep": (f"{first_s:g}", "s"),
        "outerIterations": (f"{iterations}", "of a time step"),
        "processes": (f"{processes}", ""),
        "divisions": (divisions(processes, flow.section), "along x, y, z"),
    }
    text = "// What differs from case to case; the other files include this one.\n\n"
    (folder / "parameters").write_text(text + _entries(values), encoding="utf-8")


def _entries(values: Mapping[str, tuple[str, str]]) -> str:
    """Lines of a dictionary, from names to values with a comment."""
    lines = [f"{name:<24}{value + ';':<23} // {words}" for name, (value, words) in values.items()]
    return "\n".join(lines) + "\n"
