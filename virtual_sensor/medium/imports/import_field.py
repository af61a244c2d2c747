"""Fields of other solvers, made fit for a field file: `import_field`."""

from __future__ import annotations

import importlib.util
from collections.abc import Callable, Sequence
from dataclasses import dataclass
from pathlib import Path

from virtual_sensor.child import physical_memory, run_in_child
from virtual_sensor.errors import InputError
from virtual_sensor.medium.netcdf import GriddedQuantity

NEEDS_PYVISTA = "needs PyVista, which is not installed; pip install 'virtual-sensor[fields]'"

LEAST_MEMORY, MEMORY_PER_BYTE = 6 * 10**9, 2000  # so that a small file can't claim all there is

Report = Callable[[str, float], None]


@dataclass(frozen=True)
class Choices:
    """What a user says about a file; None is what the file says, or the default.

    Attributes
    ----------
    variable : str, optional
        Name of the variable.
    quantity : str, optional
        "temperature", "density", "refractivity" (n - 1) or "index" (n).
    units, length_units : str, optional
        Of the variable and of the coordinates.
    axes : str
        Axes of the source that become the world's x, y and z, such as "x,-y,z".
    origin_mm : sequence of three float
        Point of the source that becomes the world's origin.
    scale : float
        Factor on all lengths.
    mirror : sequence of str
        Axes, through 0, about whose planes the field is even; the data are of one side.
    box_mm : sequence of six float, optional
        Extent of the output: x0, x1, y0, y1, z0, z1.
    spacing_mm : sequence of three float, optional
        At most this between its nodes.
    extrude_mm : sequence of two float, optional
        Extent along x of a 2-D cross-section.
    solid : str
        "auto" (one enclosed region without data), "enclosed" (all of them), "none", or
        "cylinder:RADIUS[,LENGTH]" in mm: along x, top line at z = 0, middle at x = 0.
    ambient : float, optional
        Value in the surrounding air, in the variable's units.
    pressure_pa : float, optional
        Of a temperature's surrounding air.
    time_s : float, optional
        Which time of the file.
    region : str, optional
        Of an OpenFOAM case of several.
    """

    variable: str | None = None
    quantity: str | None = None
    units: str | None = None
    length_units: str | None = None
    axes: str = "x,y,z"
    origin_mm: Sequence[float] = (0.0, 0.0, 0.0)
    scale: float = 1.0
    mirror: Sequence[str] = ()
    box_mm: Sequence[float] | None = None
    spacing_mm: Sequence[float] | None = None
    extrude_mm: Sequence[float] | None = None
    solid: str = "auto"
    ambient: float | None = None
    pressure_pa: float | None = None
    time_s: float | None = None
    region: str | None = None


@dataclass(frozen=True)
class Imported:
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
        choices,
        history,
        subject=f"{path}",
        memory_bytes=_memory(Path(path)),
        report=report,
    )
    return made


def _memory(path: Path) -> int | None:
    """Memory that an import may need; None if its size isn't that of one file."""
    if not path.is_file() or path.suffix.lower().startswith((".p", ".foam")):
        return None
    return min(LEAST_MEMORY + MEMORY_PER_BYTE * path.stat().st_size, physical_memory())
