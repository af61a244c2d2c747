"""What a NetCDF-3 file is made of, each element read with every check."""

from __future__ import annotations

import io
import re
from pathlib import Path
from typing import Any

import numpy as np
from scipy.io import netcdf_file

from virtual_sensor.errors import InputError

AXES = ("x", "y", "z")
MM = {"mm": 1.0, "millimeter": 1.0, "millimetre": 1.0, "m": 1e3, "meter": 1e3, "metre": 1e3}
SECONDS = {"s": 1.0, "second": 1.0, "seconds": 1.0, "ms": 1e-3}
UNEVEN = 1e-4  # of the spacing


def open_netcdf(path: Path) -> netcdf_file:
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


def text(owner: Any, name: str) -> str:
    """Return a text attribute of the file or of a variable, empty if there is none."""
    value = owner._attributes.get(name, b"")
    return value.decode("utf-8", "replace") if isinstance(value, bytes) else str(value)


def number(owner: Any, name: str, default: float) -> float:
    """Return a numeric attribute; a float32 stands for the shortest decimal that rounds to it."""
    value = owner._attributes.get(name, default)
    try:
        return float(str(np.ravel(value)[0]))
    except ValueError:
        raise InputError(f"attribute '{name}' must be a number, not {value!r}") from None


def units_of(nc: netcdf_file, name: str, known: dict[str, float]) -> float:
    """Look a variable's units up in the table `known`."""
    units = text(nc.variables[name], "units")
    if units not in known:
        found = f"has units '{units}'" if units else "has no attribute 'units'"
        raise InputError(f"variable '{name}' {found}; give one of: {', '.join(known)}")
    return known[units]


def read_axis(nc: netcdf_file, axis: str) -> tuple[float, float, float]:
    """Read first coordinate and spacing in mm, and the coordinate's unit in mm."""
    if axis not in nc.variables or nc.variables[axis].dimensions != (axis,):
        raise InputError(f"there is no coordinate variable '{axis}' along a dimension '{axis}'")
    scale = units_of(nc, axis, MM)
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


def read_times(nc: netcdf_file, name: str) -> np.ndarray | None:
    """Read the instants of a variable in s; None if it has no time axis.

    Solvers write one instant with any coordinate or none: unless it is in seconds, it is no axis.
    """
    variable = nc.variables[name]
    if "time" not in variable.dimensions:
        return None
    count = variable.data.shape[variable.dimensions.index("time")]
    described = "time" in nc.variables and nc.variables["time"].dimensions == ("time",)
    if count == 1 and not (described and text(nc.variables["time"], "units") in SECONDS):
        return None
    if not described:
        raise InputError(
            f"variable '{name}' has {count} times and there is no coordinate variable 'time' along"
            " the dimension 'time'; add it, with units 's'"
        )
    scale = units_of(nc, "time", SECONDS)
    times = scale * np.asarray(nc.variables["time"].data, dtype=np.float64)
    if len(times) < 1 or not (np.isfinite(times).all() and (np.diff(times) > 0.0).all()):
        raise InputError(
            "coordinate 'time' must hold at least one instant, all finite and ascending; sort them"
        )
    return times


def on_grid(nc: netcdf_file, name: str, instant: int = 0) -> np.ndarray:
    """Return the raw data of a variable as (nx, ny, nz), at one instant if it has a time axis."""
    variable = nc.variables[name]
    dimensions, data = variable.dimensions, variable.data
    if "time" in dimensions:
        data = data.take(instant, axis=dimensions.index("time"))
        dimensions = tuple(d for d in dimensions if d != "time")
    if dimensions != AXES:
        raise InputError(
            f"variable '{name}' has the dimensions ({', '.join(dimensions)}), not (x, y, z); "
            "reorder them (`ncpdq -a x,y,z`)"
        )
    return data


def read_solid(nc: netcdf_file) -> np.ndarray | None:
    """Read the solid's mask, if there is one."""
    for name, variable in nc.variables.items():
        if text(variable, "fill_value_means") == "solid":
            return on_grid(nc, name) == variable._attributes["_FillValue"]
    if "solid" not in nc.variables:
        return None
    if nc.variables["solid"].data.ndim > 3 and len(nc.variables["solid"].data) > 1:
        raise InputError("variable 'solid' changes with time; give one mask of (x, y, z) for all")
    flags = on_grid(nc, "solid")
    if not np.isin(flags, (0, 1)).all():
        raise InputError("variable 'solid' must be 0 in the air and 1 in the solid everywhere")
    return flags == 1


def read_mirror(
    nc: netcdf_file, origin: np.ndarray, spacing: np.ndarray, scale: np.ndarray
) -> list[bool]:
    """Read which axes have a mirror plane at their first node."""
    mirror = [False, False, False]
    planes = text(nc, "mirror_planes")
    if planes == "none":
        return mirror
    if not planes:
        tail = text(nc, "title").partition("mirror at ")[2]
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
