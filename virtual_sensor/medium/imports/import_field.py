"""Fields of other solvers, made fit for a field file: `import_field`."""

from __future__ import annotations

import importlib.util
import json
from collections.abc import Callable, Sequence
from dataclasses import dataclass, field, replace
from pathlib import Path
from typing import TYPE_CHECKING

from virtual_sensor.child import run_in_child
from virtual_sensor.display import Displayed
from virtual_sensor.errors import InputError
from virtual_sensor.medium.units import ZERO_CELSIUS_K

if TYPE_CHECKING:
    from virtual_sensor.medium.netcdf import GriddedQuantity

CASE_SETUP = "setup.json"
"""What a case of `field simulate` was made from."""

SECTION_LENGTH_MM = 180.0
"""Half of what the air of a section reaches along x: far enough for slanting light."""

NEEDS_PYVISTA = "needs PyVista, which is not installed; pip install 'virtual-sensor[fields]'"

LEAST_MEMORY, MEMORY_PER_BYTE = 6 * 10**9, 2000  # so that a small file can't claim all there is

Report = Callable[[str, float], None]


@dataclass(frozen=True)
class Choices(Displayed):
    """What a user says about a file; None is what the file says, or the default.

    Of fields with several entries, `counts` says how many numbers a command takes; () are words.

    Attributes
    ----------
    variable : str, optional
        Which variable; by default the only one that suits.
    quantity : str, optional
        temperature, density, refractivity (n - 1) or index (n); by default what the variable's
        name or units say.
    units : str, optional
        K, degC, kg/m3 or g/cm3, if the file does not say.
    length_units : str, optional
        m, cm or mm, if the file does not say.
    axes : str
        Axes of the file that become the world's x, y, z: x,-y,z or y,z,x.
    origin_mm : sequence of three float
        Point of the file, mm along its axes, that becomes the world's origin: the middle of the
        part's top line.
    scale : float
        Factor on all lengths.
    mirror : sequence of str
        Axes about whose planes through 0 the field is even, such as x,y.
    box_mm : sequence of six float, optional
        Extent x0,x1,y0,y1,z0,z1 of the field, mm; by default the data's.
    spacing_mm : sequence of three float, optional
        Distance of nodes, mm, one number or three; by default the data's own, or their median. Of
        a plain .npy array its own.
    extrude_mm : sequence of two float, optional
        From where to where along x a cross-section holds, mm.
    solid : str
        What has no air: auto (an enclosed gap in the data), enclosed (several), none, or
        cylinder:RADIUS[,LENGTH] in mm, along x under the origin.
    ambient : float, optional
        Value in the surrounding air, in the variable's units; else 20 °C.
    pressure_pa : float, optional
        Air pressure, Pa, with a temperature; else 101325.
    time_s : float, optional
        Flow time, s, of a file with many; by default the last.
    region : str, optional
        Of an OpenFOAM case of several; by default the only fluid.
    """

    variable: str | None = None
    quantity: str | None = None
    units: str | None = None
    length_units: str | None = None
    axes: str = "x,y,z"
    origin_mm: Sequence[float] = field(default=(0.0, 0.0, 0.0), metadata={"counts": (3,)})
    scale: float = 1.0
    mirror: Sequence[str] = field(default=(), metadata={"counts": ()})
    box_mm: Sequence[float] | None = field(default=None, metadata={"counts": (6,)})
    spacing_mm: Sequence[float] | None = field(default=None, metadata={"counts": (1, 3)})
    extrude_mm: Sequence[float] | None = field(default=None, metadata={"counts": (2,)})
    solid: str = "auto"
    ambient: float | None = None
    pressure_pa: float | None = None
    time_s: float | None = None
    region: str | None = None


@dataclass(frozen=True)
class Imported(Displayed):
    """A field that has been imported, and what its user should know.

    Attributes
    ----------
    quantity : GriddedQuantity
    notes : tuple of str
        What was ignored, converted or assumed.
    """

    quantity: GriddedQuantity
    notes: tuple[str, ...] = ()


def import_field(
    path: str | Path,
    choices: Choices,
    history: str = "",
    report: Report = lambda stage, fraction: None,
) -> Imported:
    """Read another solver's field and put it on a regular grid in the world frame.

    This is done in a child process, which damaged files may kill.

    Parameters
    ----------
    path : str or Path
        What `readers.read_source` reads.
    choices : Choices
        What the file cannot say itself.
    history : str
        The command, for the attributes.
    report : callable, optional
        Called with what is being done, and the fraction done.

    Returns
    -------
    Imported
        For `netcdf.write_quantity`.

    Raises
    ------
    InputError
        If the file cannot be read, something about it is not known or contradicts, the numbers
        cannot be what they are said to be, or there is a hole in the light path.
    """
    by_vtk = Path(path).is_dir() or Path(path).suffix.lower().startswith((".vt", ".pvt", ".foam"))
    if by_vtk and Path(path).exists() and importlib.util.find_spec("pyvista") is None:
        raise InputError(f"{path}: {NEEDS_PYVISTA}")
    made: Imported = run_in_child(
        "virtual_sensor.medium.imports.convert:import_here",
        path,
        of_own_case(Path(path), choices),
        history,
        subject=f"{path}",
        memory_bytes=_memory(Path(path)),
        report=report,
    )
    return made


def of_own_case(path: Path, choices: Choices) -> Choices:
    """What a case of `field simulate` says of itself, where the user says nothing else."""
    try:
        made = json.loads((path / CASE_SETUP).read_text(encoding="utf-8"))
        section, whole, part = (bool(made[name]) for name in ("section", "whole", "stl"))
        ambient_k = float(made["ambient_c"]) + ZERO_CELSIUS_K
        pressure_pa = float(made["pressure_pa"])
    except (OSError, ValueError, KeyError, TypeError):
        return choices
    mirror = choices.mirror or (() if part else ("x",) if whole else ("x", "y"))
    extrude = choices.extrude_mm
    if section and extrude is None:
        extrude = (0.0 if "x" in mirror else -SECTION_LENGTH_MM, SECTION_LENGTH_MM)
    return replace(
        choices,
        variable=choices.variable or "T",
        mirror=mirror,
        extrude_mm=extrude,
        ambient=ambient_k if choices.ambient is None else choices.ambient,
        pressure_pa=pressure_pa if choices.pressure_pa is None else choices.pressure_pa,
    )


def _memory(path: Path) -> int | None:
    """Memory that an import may need; None if its size isn't that of one file."""
    if not path.is_file() or path.suffix.lower().startswith((".p", ".foam")):
        return None
    return LEAST_MEMORY + MEMORY_PER_BYTE * path.stat().st_size
