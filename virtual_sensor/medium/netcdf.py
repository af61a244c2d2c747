"""Index fields as NetCDF-3 files: what is in one, reading it with every check, writing it.

A file has the dimensions ``(x, y, z)``, coordinate variables of those names in mm or m, ascending
and equally spaced, and one variable ``temperature`` (K or degC), ``density`` (kg/m3) or
``refractivity`` (1, that is n - 1), packed or not. Everything has a ``units`` attribute. Optional:

- a dimension ``time`` of length 1;
- a variable ``solid`` (x, y, z), 1 inside the solid: its nodes are filled from the air around;
- the surrounding air, as attributes of the variable or of the file: ``ambient_temperature`` (in the
  variable's units), ``ambient_pressure`` (Pa) and ``ambient_relative_humidity`` (0 to 1) go with a
  temperature, ``ambient_density`` with a density, ``ambient_refractivity`` with a refractivity.
  Without them it is dry air at 20 degC and 1 atm;
- ``mirror_planes`` of the file, such as ``"x=0 y=0"``: planes through an axis's first node about
  which the field is even. The fields shipped first say "mirror at x=0" in their title instead.
"""

from __future__ import annotations

import io
import re
from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np
from scipy.io import netcdf_file

from virtual_sensor.errors import InputError
from virtual_sensor.files import written_whole
from virtual_sensor.medium.air import (
    ATMOSPHERE_PA,
    ZERO_CELSIUS_K,
    air_refractivity,
    refractivity_of_density,
)

AXES = ("x", "y", "z")
MM = {"mm": 1.0, "millimeter": 1.0, "millimetre": 1.0, "m": 1e3, "meter": 1e3, "metre": 1e3}
# What must be added to a value in these units to have it in K, kg/m3, 1.
UNITS = {
    "temperature": {"K": 0.0, "kelvin": 0.0, "degC": ZERO_CELSIUS_K, "Celsius": ZERO_CELSIUS_K},
    "density": dict.fromkeys(("kg/m3", "kg/m^3", "kg m-3", "kg m^-3"), 0.0),
    "refractivity": dict.fromkeys(("1", "dimensionless"), 0.0),
}
# Values beyond these are not such a field; n itself, stored instead of n - 1, is the common one.
LIMITS = {
    "temperature": (0.0, 6000.0, " K"),
    "density": (0.0, 100.0, " kg/m3"),
    "refractivity": (-1.0, 0.9, ""),
}
AMBIENT_TEMPERATURE_K = 293.15
AMBIENT_DENSITY = 1.2041  # kg/m^3, dry air at 20 degC and 1 atm as an ideal gas
UNEVEN = 1e-4  # of the spacing


@dataclass(frozen=True)
class FieldFile:
    """What a field file says, in the units of this house.

    Attributes
    ----------
    refractivity : ndarray of shape (nx, ny, nz)
        n - 1 at the nodes; NaN where the file has no value.
    origin_mm, spacing_mm : ndarray of shape (3,)
        World position of node [0, 0, 0], and the distance of nodes, mm.
    ambient : float
        n - 1 of the surrounding air.
    mirror : tuple of three bool
        Whether the field is even about the plane through an axis's first node.
    solid : ndarray of bool of shape (nx, ny, nz) or None
        True inside the solid.
    source : str
        Where the field comes from, in words; empty if the file does not say.
    """

    refractivity: np.ndarray
    origin_mm: np.ndarray
    spacing_mm: np.ndarray
    ambient: float
    mirror: tuple[bool, ...]
    solid: np.ndarray | None = None
    source: str = ""


def read_field_file(
    path: str | Path, wavelength_nm: float, mirror: Sequence[bool] | None = None
) -> FieldFile:
    """Read a field file.

    A temperature becomes n - 1 as in the paper: that of the surrounding air (Ciddor) times the
    ratio of ideal-gas densities at equal pressure, T_ambient / T. A refractivity is taken as it is,
    whatever the wavelength.

    Parameters
    ----------
    path : str or Path
        The file.
    wavelength_nm : float
        Vacuum wavelength, nm.
    mirror : sequence of three bool, optional
        Overrides what the file says about mirror planes.

    Raises
    ------
    InputError
        If the file is missing, damaged, or not as this module's docstring describes it.
    """
    nc = _open(Path(path))
    origin, spacing, scale = np.transpose([_read_axis(nc, axis) for axis in AXES])
    solid = _read_solid(nc)
    refractivity, ambient = _read_refractivity(nc, solid, wavelength_nm)
    if mirror is None:
        mirror = _read_mirror(nc, origin, spacing, scale)
    source = _text(nc, "source")
    return FieldFile(refractivity, origin, spacing, ambient, tuple(mirror), solid, source)


def write_field_file(path: str | Path, field: FieldFile) -> None:
    """Write a field as ``refractivity``, in float64; all of the file appears at once or not at all.

    Raises
    ------
    InputError
        If the folder does not exist.
    """
    path = Path(path)
    if not path.parent.is_dir():
        raise InputError(f"{path}: there is no folder {path.parent}; create it first")

    buffer = io.BytesIO()
    nc = netcdf_file(buffer, "w", version=2)  # 64-bit offsets
    nc.title = "Refractivity n - 1 on a regular grid"
    if field.source:
        nc.source = field.source.encode()
    planes = [f"{AXES[i]}={float(field.origin_mm[i])}" for i in range(3) if field.mirror[i]]
    if planes:
        nc.mirror_planes = " ".join(planes)

    for i, axis in enumerate(AXES):
        size = field.refractivity.shape[i]
        nc.createDimension(axis, size)
        coordinate = nc.createVariable(axis, "f8", (axis,))
        coordinate[:] = field.origin_mm[i] + field.spacing_mm[i] * np.arange(size)
        coordinate.units = "mm"
    variable = nc.createVariable("refractivity", "f8", AXES)
    variable[:] = field.refractivity
    variable.units = "1"
    variable.ambient_refractivity = np.float64(field.ambient)
    nc.flush()

    with written_whole(path) as unfinished:
        unfinished.write_bytes(buffer.getvalue())


def _open(path: Path) -> netcdf_file:
    """Read and parse the whole file."""
    if not path.is_file():
        present = sorted(p.name for p in path.parent.glob("*.nc"))
        beside = f"in that folder: {', '.join(present)}" if present else "no .nc file is there"
        raise InputError(f"there is no such file; {beside}")
    content = path.read_bytes()
    if content.startswith(b"\x89HDF") or content.startswith(b"CDF\x05"):
        raise InputError(
            "is NetCDF-4 or CDF-5, and only NetCDF-3 is read; convert it with "
            '`nccopy -3 in.nc out.nc`, or in xarray .to_netcdf(..., format="NETCDF3_64BIT")'
        )
    if not content.startswith((b"CDF\x01", b"CDF\x02")):
        raise InputError("is not a NetCDF-3 file (it does not begin with 'CDF')")
    try:
        return netcdf_file(io.BytesIO(content), "r", mmap=False)
    except (ValueError, IndexError, KeyError, TypeError) as error:
        raise InputError(f"is truncated or damaged ({error}); copy it again") from error


def _text(owner: Any, name: str) -> str:
    """Return a text attribute of the file or of a variable, empty if there is none."""
    value = owner._attributes.get(name, b"")
    return value.decode("utf-8", "replace") if isinstance(value, bytes) else str(value)


def _number(owner: Any, name: str, default: float) -> float:
    """Return a numeric attribute; a float32 stands for the shortest decimal that rounds to it."""
    value = owner._attributes.get(name, default)
    try:
        return float(str(np.ravel(value)[0]))
    except ValueError:
        raise InputError(f"attribute '{name}' must be a number, not {value!r}") from None


def _units(nc: netcdf_file, name: str, known: dict[str, float]) -> float:
    """Look a variable's units up in the table `known`."""
    units = _text(nc.variables[name], "units")
    if units not in known:
        found = f"has units '{units}'" if units else "has no attribute 'units'"
        raise InputError(f"variable '{name}' {found}; give one of: {', '.join(known)}")
    return known[units]


def _read_axis(nc: netcdf_file, axis: str) -> tuple[float, float, float]:
    """Read first coordinate and spacing in mm, and the coordinate's unit in mm."""
    if axis not in nc.variables or nc.variables[axis].dimensions != (axis,):
        raise InputError(f"there is no coordinate variable '{axis}' along a dimension '{axis}'")
    scale = _units(nc, axis, MM)
    nodes = scale * np.asarray(nc.variables[axis].data, dtype=np.float64)
    if len(nodes) < 2 or not np.isfinite(nodes).all():
        raise InputError(f"coordinate '{axis}' needs at least two nodes, all of them finite")
    steps = np.diff(nodes)
    if (steps <= 0.0).any():
        raise InputError(f"coordinate '{axis}' does not ascend; reverse it (`ncpdq -a -{axis}`)")
    spacing = (nodes[-1] - nodes[0]) / len(steps)
    if (abs(steps - spacing) > UNEVEN * spacing).any():
        raise InputError(
            f"coordinate '{axis}' is unevenly spaced ({steps.min():g} to {steps.max():g} mm); "
            "interpolate the field to a regular grid"
        )
    return nodes[0], spacing, scale


def _kind(nc: netcdf_file) -> str:
    """Find which of the three quantities the file holds."""
    found = [kind for kind in UNITS if kind in nc.variables]
    if len(found) != 1:
        others = [name for name in nc.variables if name not in AXES]
        raise InputError(
            f"must hold exactly one of the variables {', '.join(UNITS)}; it holds "
            f"{' and '.join(found) or ', '.join(others) or 'none'}"
        )
    return found[0]


def _on_grid(nc: netcdf_file, name: str) -> np.ndarray:
    """Return the raw data of a variable as (nx, ny, nz)."""
    variable = nc.variables[name]
    dimensions, data = variable.dimensions, variable.data
    if "time" in dimensions:
        along = dimensions.index("time")
        if data.shape[along] != 1:
            raise InputError(
                f"variable '{name}' has {data.shape[along]} times; fields that change with time "
                "are not read yet: take one out with `ncks -d time,0`"
            )
        data = np.squeeze(data, axis=along)
        dimensions = tuple(d for d in dimensions if d != "time")
    if dimensions != AXES:
        raise InputError(
            f"variable '{name}' has the dimensions ({', '.join(dimensions)}), not (x, y, z); "
            "reorder them (`ncpdq -a x,y,z`)"
        )
    return data


def _read_solid(nc: netcdf_file) -> np.ndarray | None:
    """Read the solid's mask, if there is one."""
    if "solid" not in nc.variables:
        return None
    flags = _on_grid(nc, "solid")
    if not np.isin(flags, (0, 1)).all():
        raise InputError("variable 'solid' must be 0 in the air and 1 in the solid everywhere")
    return flags == 1


def _read_refractivity(
    nc: netcdf_file, solid: np.ndarray | None, wavelength_nm: float
) -> tuple[np.ndarray, float]:
    """Read n - 1 at the nodes, NaN where missing or solid, and of the surrounding air."""
    kind = _kind(nc)
    variable, raw = nc.variables[kind], _on_grid(nc, kind)
    offset = _units(nc, kind, UNITS[kind])
    scale, shift = _number(variable, "scale_factor", 1.0), _number(variable, "add_offset", 0.0)
    values = raw.astype(np.float64) * scale + shift + offset
    for fill in ("_FillValue", "missing_value"):
        if fill in variable._attributes:
            values[raw == variable._attributes[fill]] = np.nan
    if solid is not None:
        values[solid] = np.nan

    low, high, unit = LIMITS[kind]
    wrong = (values <= low) | (values >= high)
    if wrong.any():
        raise InputError(
            f"variable '{kind}' is {values[wrong][0]:g}{unit} at node "
            f"{np.argwhere(wrong)[0].tolist()}, outside {low:g} to {high:g}{unit}; "
            "check its units and packing"
            + (" (n - 1 is wanted, not n)" if kind == "refractivity" else "")
        )

    def ambient(name: str, default: float) -> float:
        return _number(variable if name in variable._attributes else nc, name, default)

    if kind == "temperature":
        T = ambient("ambient_temperature", AMBIENT_TEMPERATURE_K - offset) + offset
        pressure = ambient("ambient_pressure", ATMOSPHERE_PA)
        humidity = ambient("ambient_relative_humidity", 0.0)
        n = float(air_refractivity(wavelength_nm, T - ZERO_CELSIUS_K, pressure, humidity))
        return n * (T / values), n
    if kind == "density":
        K = float(refractivity_of_density(1.0, wavelength_nm))  # m^3/kg
        return K * values, K * ambient("ambient_density", AMBIENT_DENSITY)
    return values, ambient("ambient_refractivity", float(air_refractivity(wavelength_nm)))


def _read_mirror(
    nc: netcdf_file, origin: np.ndarray, spacing: np.ndarray, scale: np.ndarray
) -> list[bool]:
    """Read which axes have a mirror plane at their first node."""
    mirror = [False, False, False]
    planes = _text(nc, "mirror_planes")
    if not planes:
        tail = _text(nc, "title").partition("mirror at ")[2]
        planes = " ".join(re.findall(r"\b[xyz]=-?[\d.]+", tail))
    for plane in planes.split():
        name, _, number = plane.partition("=")
        try:
            axis = AXES.index(name)
            position = scale[axis] * float(number)
        except ValueError:
            raise InputError(
                f"attribute 'mirror_planes': cannot read '{plane}'; write it like 'x=0 y=0'"
            ) from None
        if abs(position - origin[axis]) > UNEVEN * spacing[axis]:
            raise InputError(
                f"the mirror plane {plane} is not at the first node of {name}, "
                f"{origin[axis]:g} mm; cut the field there"
            )
        mirror[axis] = True
    return mirror
