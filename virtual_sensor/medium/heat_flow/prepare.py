"""Make a case ready to run: set-up, parameters, mesh, parts for several processes."""

from __future__ import annotations

import json
import re
import shutil
from collections.abc import Mapping
from pathlib import Path

import numpy as np

from virtual_sensor.errors import InputError
from virtual_sensor.files import written_whole
from virtual_sensor.medium.heat_flow import saved
from virtual_sensor.medium.heat_flow.case import (
    SETUP,
    divisions,
    mesh_commands,
    setup_record,
    whole_step,
    write_case,
)
from virtual_sensor.medium.heat_flow.openfoam import OpenFoam, run_tool
from virtual_sensor.medium.heat_flow.setup import HeatFlow
from virtual_sensor.medium.heat_flow.snapped_mesh import SURFACE, read_part

LEAST_HELD = 0.7
"""Share of a part's volume that its mesh must leave out of the air."""


def prepare_case(
    flow: HeatFlow, folder: Path, end_s: float, write_interval_s: float, processes: int = 1
) -> None:
    """Write a case, or make sure that the one in the folder is the same flow, to be gone on with.

    Raises
    ------
    InputError
        If the folder holds something else, or a case whose set-up differs; it says wherein.
    """
    if not folder.exists():
        return write_case(flow, folder, end_s, write_interval_s, processes)
    made, asked = setup_of(folder), setup_record(flow)
    made = setup_record(HeatFlow()) | made  # an older version's has fewer entries
    for name in asked:
        if made.get(name) != asked[name]:
            raise InputError(
                f"{folder}: was made with {name} = {made.get(name)}, not {asked[name]}; name"
                " another folder, or ask for what it was made with"
            )
    step = whole_step(write_interval_s, float(parameters(folder)["maxTimeStep"]))
    return set_parameters(folder, writeInterval=f"{write_interval_s:g}", maxTimeStep=step)


def make_mesh(foam: OpenFoam, folder: Path) -> None:
    """Make the mesh, if there is none that has passed `checkMesh`.

    Raises
    ------
    InputError
        If a tool fails, the mesh does not pass, or it lacks much of the part.
    """
    checked, mesh = folder / "log.checkMesh", folder / "constant/polyMesh"
    made = setup_of(folder)
    if (mesh / "points").exists() and checked.exists() and "Mesh OK." in checked.read_text():
        return _check_part(folder, made, checked.read_text())
    shutil.rmtree(mesh, ignore_errors=True)
    for command in mesh_commands(made):
        run_tool(foam, folder, *command)
    output = run_tool(foam, folder, "checkMesh", "-time", "0")
    if "Mesh OK." not in output:
        faults = [line.strip(" *") for line in output.splitlines() if line.startswith(" ***")]
        raise InputError(f"{folder}: the mesh does not pass checkMesh: {'; '.join(faults)}")
    return _check_part(folder, made, output)


def _check_part(folder: Path, made: Mapping[str, object], checked: str) -> None:
    """Refuse a mesh that fills thin walls of its part with air."""
    if not made.get("stl"):
        return
    box = re.search(r"domain bounding box \((.*?)\) \((.*?)\)", checked)
    total = re.search(r"Total volume = (\S+)\. ", checked)
    if not (box and total):
        return
    low, high = (np.array(corner.split(), dtype=float) for corner in box.groups())
    held_mm3 = 1e9 * (float(np.prod(high - low)) - float(total[1]))
    part = read_part(folder / SURFACE)
    if held_mm3 < LEAST_HELD * part.filled_mm3:
        raise InputError(
            f"{folder}: the mesh has only {held_mm3 / part.filled_mm3:.0%} of the part: walls"
            f" thinner than its cells of {made.get('cell_mm'):g} mm are lost; take --cell"
            f" {part.thickness_mm / 2.0:.2g}, with another -o or --case"
        )


def reconstruct(foam: OpenFoam, folder: Path) -> None:
    """Join the processes' parts of all times that are not yet there as a whole."""
    if any(s.decomposed for s in saved.times(folder)):
        run_tool(foam, folder, "reconstructPar", "-newTimes")
    lost = [s.name for s in saved.times(folder) if s.decomposed]
    if lost:
        raise InputError(f"{folder}: reconstructPar left out {', '.join(lost)}; see its log")


def distribute(foam: OpenFoam, folder: Path, processes: int, section: bool) -> None:
    """Have the case decomposed for this number of processes, or not at all for one.

    Raises
    ------
    InputError
        If a tool fails.
    """
    set_parameters(folder, processes=f"{processes}", divisions=divisions(processes, section))
    present, log = saved.processor_folders(folder), folder / "log.decomposePar"
    done = not log.exists() or log.read_text(errors="replace").rstrip().endswith("End")
    if len(present) == (processes if processes > 1 else 0) and done:
        return
    reconstruct(foam, folder)
    for path in present:
        saved.remove_folder(path)
    if processes > 1:
        run_tool(foam, folder, "decomposePar", "-latestTime", "-copyUniform")


def parameters(folder: Path) -> dict[str, str]:
    """Read the case's file `parameters`."""
    text = (folder / "parameters").read_text(encoding="utf-8")
    return dict(re.findall(r"^(\w+)\s+([^;]+);", text, re.M))


def set_parameters(folder: Path, **values: str) -> None:
    """Change values in the case's file `parameters`; the rest, a user's changes too, stays.

    Raises
    ------
    InputError
        If the file does not have one of them, or can't be written.
    """
    path = folder / "parameters"
    old = text = path.read_text(encoding="utf-8")
    for name, value in values.items():
        text, found = re.subn(rf"^({name}\s+)[^;]+;", rf"\g<1>{value};", text, flags=re.M)
        if not found:
            raise InputError(f"{path}: has no entry {name}; write the case again")
    if text != old:
        with written_whole(path) as new:
            new.write_text(text, encoding="utf-8")


def setup_of(folder: Path) -> dict[str, object]:
    """What a case was made from.

    Raises
    ------
    InputError
        If it is not a case of ours.
    """
    try:
        return dict(json.loads((folder / SETUP).read_text(encoding="utf-8")))
    except FileNotFoundError as error:
        raise InputError(
            f"{folder}: is not a case of ours (there is no {SETUP}); name another folder"
        ) from error
    except (OSError, ValueError) as error:
        raise InputError(
            f"{folder / SETUP}: can't be read ({error}); write the case again"
        ) from error
