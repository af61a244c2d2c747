"""What a NetCDF file is made of, each element read with every check."""

from __future__ import annotations

import importlib.util
import io
import re
from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np
from scipy.io import netcdf_file

from virtual_sensor.child import run_in_child
from virtual_sensor.errors import InputError, cause_of, printable
from virtual_sensor.files import readable
from virtual_sensor.medium.units import unit_of

AXES = ("x", "y", "z")
MM = {"mm": 1.0, "m": 1e3, "cm": 10.0}
SECONDS = {"s": 1.0, "ms": 1e-3, "min": 60.0, "h": 3600.0}
UNEVEN = 1e-4  # of the spacing
SPACINGS_MM = (1e-6, 1e6)  # between nodes
FARTHEST_MM = 1e8
LEAST_MEMORY, MEMORY_PER_BYTE = 4_000_000_000, 100  # for a NetCDF-4 file, and per byte of it
LEAST_SECONDS, LEAST_BYTES_PER_S = 20.0, 1e6  # a damaged one may be read for ever
DEFAULT_FILLS = {"f4": 9.969209968386869e36, "f8": 9.969209968386869e36, "i4": -2147483647}


class _File(netcdf_file):
    """SciPy's; but what attributes of the file are called, such as "mode", is the file's matter."""

    def _read_gatt_array(self) -> None:
        self._attributes.update(self._read_att_array())


_OF_VARIABLES = {
    "data",
    "dimensions",
    "maskandscale",
    "_attributes",
    "_shape",
    "_size",
    "_typecode",
}
"""What SciPy would take of a variable's attributes for its own."""


@dataclass(frozen=True)
class Variable:
    """A variable as it is stored.

    Attributes
    ----------
    dimensions : tuple of str
    data : ndarray
        Not decoded.
    attributes : dict
        Texts and numbers.
    """

    dimensions: tuple[str, ...]
    data: np.ndarray
    attributes: dict[str, Any]


@dataclass(frozen=True)
class Contents:
    """What a file holds: variables by their names, and attributes of the file."""

    variables: dict[str, Variable]
    attributes: dict[str, Any]


def open_netcdf(path: Path) -> Contents:
    """Read and parse the whole file."""
    content = readable(path).read_bytes()
    if content.startswith((b"\x89HDF", b"CDF\x05")):
        return _open_netcdf4(path)
    if not content.startswith((b"CDF\x01", b"CDF\x02")):
        raise InputError(
            "is not a NetCDF file (it begins with neither 'CDF' nor 'HDF'); virtual-sensor field"
            " import makes one of another solver's file"
        )
    try:
        nc = _File(io.BytesIO(content), "r", mmap=False)
    except Exception as error:  # of struct, NumPy and others, as the damage will have it
        raise InputError(f"is truncated or damaged ({cause_of(error)}); copy it again") from error
    for name, variable in nc.variables.items():
        attributes = getattr(variable, "_attributes", None)
        taken = _OF_VARIABLES & set(attributes if isinstance(attributes, dict) else _OF_VARIABLES)
        if taken:
            raise InputError(
                f"variable '{printable(name)}' has an attribute '{min(taken)}'; rename it"
            )
    return Contents(
        {
            name: Variable(v.dimensions, v.data, _decoded_texts(v._attributes))
            for name, v in nc.variables.items()
        },
        _decoded_texts(nc._attributes),
    )


def _decoded_texts(attributes: dict[str, Any]) -> dict[str, Any]:
    return {
        name: value.decode("utf-8", "replace") if isinstance(value, bytes) else value
        for name, value in attributes.items()
    }


def _open_netcdf4(path: Path) -> Contents:
    """By the package netCDF4, in a child process: HDF5 may crash on a damaged file."""
    if importlib.util.find_spec("netCDF4") is None:
        raise InputError(
            "is NetCDF-4 or CDF-5: pip install 'virtual-sensor[netcdf4]'; or convert it with"
            ' `nccopy -3 in.nc out.nc`, or in xarray .to_netcdf(..., format="NETCDF3_64BIT")'
        )
    size = path.stat().st_size
    made: Contents = run_in_child(
        "virtual_sensor.medium.netcdf4:read",
        str(path),
        subject=f"{path}",
        memory_bytes=LEAST_MEMORY + MEMORY_PER_BYTE * size,
        seconds=LEAST_SECONDS + size / LEAST_BYTES_PER_S,
    )
    return made


def text(owner: Contents | Variable, name: str) -> str:
    """Return a text attribute of the file or of a variable, empty if there is none."""
    return printable(str(owner.attributes.get(name, "")))


def number(owner: Contents | Variable, name: str, default: float) -> float:
    """Return a numeric attribute; a float32 stands for the shortest decimal that rounds to it."""
    value = np.ravel(owner.attributes.get(name, default))
    if value.size == 1 and value.dtype.kind in "iuf":
        result = float(str(value[0]))
        if np.isfinite(result):
            return result
    shown = text(owner, name) if value.dtype.kind == "U" else ", ".join(map(str, value[:4]))
    raise InputError(f"attribute '{name}' must be a number, not '{shown}'; correct or remove it")


def units_of(nc: Contents, name: str, known: dict[str, float]) -> float:
    """Give the value in the table `known` of a variable's units."""
    said = text(nc.variables[name], "units")
    units = unit_of(said, known)
    if units is None:
        found = f"has units '{said}'" if said else "has no attribute 'units'"
        raise InputError(f"variable '{name}' {found}; give one of: {', '.join(known)}")
    return known[units]


def decoded(nc: Contents, name: str, raw: np.ndarray) -> np.ndarray:
    """Decode stored numbers of a variable as the CF conventions say.

    Heeded are ``_Unsigned``, ``scale_factor``, ``add_offset``, ``_FillValue``, ``missing_value``
    (one or several), ``valid_range``, ``valid_min`` and ``valid_max``, and of variables without a
    ``_FillValue`` the default one of float, double and int.

    Returns
    -------
    ndarray of float64
        NaN where the file has no valid value.

    Raises
    ------
    InputError
        If the variable is text, or an attribute is unfit.
    """
    variable = nc.variables[name]
    if raw.dtype.kind not in "iuf":
        raise InputError(f"variable '{name}' holds text, no numbers; write it as float or short")
    packed = {"scale_factor", "add_offset"} & variable.attributes.keys()
    scale, offset = number(variable, "scale_factor", 1.0), number(variable, "add_offset", 0.0)
    if scale == 0.0:
        raise InputError(f"variable '{name}': its scale_factor is 0; correct it")
    stored = _unsigned(variable, raw)
    values = stored.astype(np.float64) * scale + offset
    missing = _filled(nc, name, raw)
    for value in _numbers(variable, name, "missing_value", None):
        missing |= stored == value
    for attribute, count in (("valid_range", 2), ("valid_min", 1), ("valid_max", 1)):
        limits = _numbers(variable, name, attribute, count)
        if limits:
            # The range of a packed variable is packed, unless its type is that of unpacked values.
            unpacked = packed and raw.dtype.kind != "f" and limits[0].dtype.kind == "f"
            held = values if unpacked else stored
            if attribute != "valid_max":
                missing |= held < limits[0]
            if attribute != "valid_min":
                missing |= held > limits[-1]
    values[missing] = np.nan
    return values


def _unsigned(variable: Variable, array: np.ndarray) -> np.ndarray:
    """Take signed integers for unsigned ones, if the variable says so."""
    if text(variable, "_Unsigned").strip().lower() != "true" or array.dtype.kind != "i":
        return array
    return array.view(array.dtype.str.replace("i", "u"))


def _numbers(variable: Variable, name: str, attribute: str, count: int | None) -> list[Any]:
    """Numbers of an attribute of a variable, of the variable's own type; none without it."""
    value = variable.attributes.get(attribute)
    if value is None:
        return []
    array = np.ravel(value)
    if array.dtype.kind not in "iuf" or not array.size or count not in (None, array.size):
        wanted = {None: "numbers", 1: "one number"}.get(count, f"{count} numbers")
        raise InputError(
            f"variable '{name}': its attribute '{attribute}' must be {wanted}; correct or remove it"
        )
    stored = variable.data.dtype
    if array.dtype.kind == stored.kind and array.dtype.itemsize == stored.itemsize:
        array = _unsigned(variable, array)
    elif stored.kind == "f":
        array = array.astype(stored)
    return list(array)


def _filled(nc: Contents, name: str, raw: np.ndarray) -> np.ndarray:
    """Where a variable was never written: its `_FillValue`, or the default of its type."""
    variable = nc.variables[name]
    fills = _numbers(variable, name, "_FillValue", 1)
    if not fills:
        fills = [DEFAULT_FILLS[raw.dtype.str[1:]]] if raw.dtype.str[1:] in DEFAULT_FILLS else []
        fills = list(np.asarray(fills).astype(raw.dtype))
    stored = _unsigned(variable, raw)
    return np.any([stored == fill for fill in fills], axis=0) | np.zeros(raw.shape, bool)


def check_box(origin: np.ndarray, spacing: np.ndarray, shape: Sequence[int]) -> None:
    """Refuse a grid of impossible extent.

    Parameters
    ----------
    origin, spacing : ndarray of shape (3,)
        Of the nodes, mm.
    shape : sequence of three int
        Numbers of nodes.

    Raises
    ------
    InputError
        It names the axis.
    """
    ends = origin + spacing * (np.array(shape) - 1)
    for axis, first, last, step in zip(AXES, origin, ends, spacing, strict=True):
        if not (
            SPACINGS_MM[0] <= step <= SPACINGS_MM[1] and max(abs(first), abs(last)) <= FARTHEST_MM
        ):
            raise InputError(
                f"'{axis}' runs from {first:g} to {last:g} mm with nodes {step:g} mm apart; give"
                f" spacings from {SPACINGS_MM[0]:g} to {SPACINGS_MM[1]:g} mm, and check the units"
            )


def read_axis(nc: Contents, axis: str) -> tuple[float, float, float]:
    """Read first coordinate and spacing in mm, and the coordinate's unit in mm."""
    if axis not in nc.variables or nc.variables[axis].dimensions != (axis,):
        raise InputError(f"there is no coordinate variable '{axis}' along a dimension '{axis}'")
    scale = units_of(nc, axis, MM)
    with np.errstate(over="ignore"):
        nodes = scale * decoded(nc, axis, np.asarray(nc.variables[axis].data))
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


def read_times(nc: Contents, name: str) -> np.ndarray | None:
    """Read the instants of a variable in s; None if it has no time axis.

    Solvers write one instant with any coordinate or none: unless it is in seconds, it is no axis.
    """
    variable = nc.variables[name]
    if "time" not in variable.dimensions:
        return None
    count = variable.data.shape[variable.dimensions.index("time")]
    described = "time" in nc.variables and nc.variables["time"].dimensions == ("time",)
    units = text(nc.variables["time"], "units") if described else ""
    if count == 1 and unit_of(units, SECONDS) is None:
        return None
    if not described:
        raise InputError(
            f"variable '{name}' has {count} times and there is no coordinate variable 'time' along"
            " the dimension 'time'; add it, with units 's'"
        )
    scale = units_of(nc, "time", SECONDS)
    times = scale * decoded(nc, "time", np.asarray(nc.variables["time"].data))
    if len(times) < 1 or not (np.isfinite(times).all() and (np.diff(times) > 0.0).all()):
        raise InputError(
            "coordinate 'time' must hold at least one instant, all finite and ascending; sort them"
        )
    return times


def on_grid(nc: Contents, name: str, instant: int = 0) -> np.ndarray:
    """Return the raw data of a variable as (nx, ny, nz), at one instant if it has a time axis."""
    variable = nc.variables[name]
    dimensions, data = variable.dimensions, variable.data
    if "time" in dimensions:
        along = dimensions.index("time")
        if not data.shape[along]:
            raise InputError(f"variable '{name}' has no instants; write one")
        data = data.take(instant, axis=along)
        dimensions = tuple(d for d in dimensions if d != "time")
    if dimensions != AXES:
        raise InputError(
            f"variable '{name}' has the dimensions ({', '.join(dimensions)}), not (x, y, z); "
            "reorder them (`ncpdq -a x,y,z`)"
        )
    return np.asarray(data)


def read_solid(nc: Contents) -> np.ndarray | None:
    """Read the solid's mask, if there is one."""
    for name, variable in nc.variables.items():
        if text(variable, "fill_value_means") == "solid":
            if "_FillValue" not in variable.attributes:
                raise InputError(
                    f"variable '{name}' says fill_value_means = 'solid' and has no _FillValue; give"
                    " it one"
                )
            return _filled(nc, name, on_grid(nc, name))
    if "solid" not in nc.variables:
        return None
    if nc.variables["solid"].data.ndim > 3 and len(nc.variables["solid"].data) > 1:
        raise InputError("variable 'solid' changes with time; give one mask of (x, y, z) for all")
    flags = decoded(nc, "solid", on_grid(nc, "solid"))
    if not np.isin(flags, (0, 1)).all():
        raise InputError("variable 'solid' must be 0 in the air and 1 in the solid everywhere")
    return flags == 1


def read_mirror(
    nc: Contents, origin: np.ndarray, spacing: np.ndarray, scale: np.ndarray
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
        if not abs(position - origin[axis]) <= UNEVEN * spacing[axis]:
            raise InputError(
                f"the mirror plane {plane} is not at the first node of {name}, "
                f"{origin[axis]:g} mm; cut the field there"
            )
        mirror[axis] = True
    return mirror
