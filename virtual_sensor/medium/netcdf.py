"""Index fields as NetCDF files: what is in one, reading it with every check, writing it.

A file has the dimensions ``(x, y, z)``, coordinate variables of those names in mm or m, ascending
and equally spaced, and one variable ``temperature`` (K or degC), ``density`` (kg/m3) or
``refractivity`` (1, that is n - 1), packed or not. Everything has a ``units`` attribute. Optional:

- a dimension ``time`` of that variable, with a coordinate variable ``time`` in s, ascending:
  instants of the flow. Between two of them the stored quantity is interpolated linearly. A single
  instant needs no coordinate;
- a variable ``solid`` (x, y, z), 1 inside the solid: its nodes are filled from the air around, and
  whatever the file has there, fill values or NaN, is ignored;
- the surrounding air, as attributes of the variable or of the file: ``ambient_temperature`` (in the
  variable's units), ``ambient_pressure`` (Pa) and ``ambient_relative_humidity`` (0 to 1) go with a
  temperature, ``ambient_density`` with a density, ``ambient_refractivity`` with a refractivity,
  and an ``ambient_pressure`` for other pressures to be compared with. Without them it is dry air at
  20 degC and 1 atm;
- ``mirror_planes`` of the file, such as ``"x=0 y=0"`` or ``"none"``: planes through an axis's first
  node about which the field is even. The fields shipped first say "mirror at x=0" in their title
  instead.

What is done of the format's other features, as the CF conventions say:

================================  ==================================================
Feature                           What is done
================================  ==================================================
scale_factor, add_offset          heeded, of coordinates too
_Unsigned                         heeded: bytes, shorts and ints are unsigned
_FillValue, missing_value         heeded: no data; missing_value may be several
default fill value                heeded: of float, double and int without _FillValue
valid_range, valid_min, valid_max heeded: what is outside is no data
NaN                               heeded: no data
units in other spellings          heeded: Kelvin, celsius, kg m-3, metre, hours
64-bit offsets, record dimension  heeded
text where numbers belong         refused
attributes of several numbers     refused, where one belongs
descending or uneven axes         refused
dimensions in another order       refused
impossible values or extents      refused, of the surrounding air too
NetCDF-4, CDF-5                   by the package netCDF4, of the extra `netcdf4`
groups of NetCDF-4                ignored
other variables                   ignored, with a note
other attributes                  ignored
================================  ==================================================

Written is NetCDF-3: mm, s, K, kg/m3 and 1. Packed means 16-bit integers whose ``scale_factor`` and
``add_offset`` span the range of the values in the air, with a ``_FillValue`` in the solid; the
variable then says ``fill_value_means = "solid"`` and there is no mask.
"""

from __future__ import annotations

import io
from collections.abc import Sequence
from dataclasses import dataclass, field
from pathlib import Path

import numpy as np
from scipy.io import netcdf_file

from virtual_sensor.display import Displayed
from virtual_sensor.errors import InputError, naming, printable
from virtual_sensor.files import written_whole
from virtual_sensor.medium.air import air_refractivity, refractivity_of_density
from virtual_sensor.medium.netcdf_elements import (
    AXES,
    Contents,
    check_box,
    decoded,
    number,
    on_grid,
    open_netcdf,
    read_axis,
    read_mirror,
    read_solid,
    read_times,
    text,
    units_of,
)
from virtual_sensor.medium.quantities import UNITS, check_limits, possible_ambient
from virtual_sensor.medium.units import ATMOSPHERE_PA, ZERO_CELSIUS_K

AMBIENT = {
    "temperature": ("ambient_temperature", "ambient_pressure", "ambient_relative_humidity"),
    "density": ("ambient_density", "ambient_pressure"),
    "refractivity": ("ambient_refractivity", "ambient_pressure"),
}
AMBIENT_TEMPERATURE_K = 293.15
AMBIENT_DENSITY = 1.2041  # kg/m^3, dry air at 20 degC and 1 atm as an ideal gas
PACKED_MAX = 32767  # and its negative; the one integer left, -32768, fills the solid
TIME_DOUBT = 1e-6  # of the time itself: a float32 coordinate's rounding is no other instant


@dataclass(frozen=True)
class GriddedQuantity(Displayed):
    """What goes into a field file.

    Attributes
    ----------
    kind : str
        "temperature" (K), "density" (kg/m3) or "refractivity" (n - 1).
    values : ndarray of shape (nx, ny, nz), or (nt, nx, ny, nz) with `time_s`
        At the nodes; may be NaN inside the solid, and only there.
    origin_mm, spacing_mm : ndarray of shape (3,)
        World position of node [0, 0, 0], and the distance of nodes, mm.
    time_s : ndarray of shape (nt,) or None
        Flow time of the instants, s, ascending.
    ambient : dict
        The surrounding air, by the attributes' names in this module's docstring; units as `values`.
    mirror : tuple of three bool
        Whether the field is even about the plane through an axis's first node.
    solid : ndarray of bool of shape (nx, ny, nz) or None
        True inside the solid.
    attributes : dict
        Where the field comes from, as attributes of the file: title, source, comment, history ...
    """

    kind: str
    values: np.ndarray
    origin_mm: np.ndarray
    spacing_mm: np.ndarray
    time_s: np.ndarray | None = None
    ambient: dict[str, float] = field(default_factory=dict)
    mirror: tuple[bool, ...] = (False, False, False)
    solid: np.ndarray | None = None
    attributes: dict[str, str] = field(default_factory=dict)


@dataclass(frozen=True)
class FieldFile(Displayed):
    """What a field file says of one instant, in mm, s, K and n - 1.

    Attributes
    ----------
    refractivity : ndarray of shape (nx, ny, nz)
        n - 1 at the nodes; NaN where the file has no value.
    origin_mm, spacing_mm, mirror, solid
        As those of `GriddedQuantity`.
    ambient : float
        n - 1 of the surrounding air.
    pressure_pa : float
        Its pressure, Pa.
    source : str
        Where the field comes from, in words; empty if the file does not say.
    notes : tuple of str
        What of the file is ignored.
    """

    refractivity: np.ndarray
    origin_mm: np.ndarray
    spacing_mm: np.ndarray
    ambient: float
    mirror: tuple[bool, ...]
    solid: np.ndarray | None = None
    pressure_pa: float = ATMOSPHERE_PA
    source: str = ""
    notes: tuple[str, ...] = ()


def read_field_file(
    path: str | Path,
    wavelength_nm: float,
    mirror: Sequence[bool] | None = None,
    time_s: float | None = None,
) -> FieldFile:
    """Read one instant of a field file.

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
    time_s : float, optional
        Flow time, s, between the first and the last instant of the file; the last by default.

    Raises
    ------
    InputError
        If the file is missing, damaged, or not as this module's docstring describes it, or the time
        is not in its range.
    """
    with naming(path):
        nc = open_netcdf(Path(path))
        origin, spacing, scale = np.transpose([read_axis(nc, axis) for axis in AXES])
        solid = read_solid(nc)
        refractivity, ambient = _read_refractivity(nc, solid, wavelength_nm, time_s)
        if mirror is None:
            mirror = read_mirror(nc, origin, spacing, scale)
        source = text(nc, "source")
        pressure = ambient_of(nc, _kind(nc), "ambient_pressure", ATMOSPHERE_PA)
        further = sorted(nc.variables.keys() - {*AXES, "time", "solid", _kind(nc)})
    notes = (f"{path}: ignored: {printable(', '.join(further))}",) if further else ()
    where = origin, spacing, ambient, tuple(mirror), solid
    return FieldFile(refractivity, *where, pressure, source, notes)


def field_times(path: str | Path) -> np.ndarray | None:
    """Flow times of a field file's instants.

    Returns
    -------
    ndarray of shape (nt,) or None
        In s, ascending; None of a file without a time axis.

    Raises
    ------
    InputError
        If the file is missing or damaged, or its time axis is unfit.
    """
    with naming(path):
        nc = open_netcdf(Path(path))
        return read_times(nc, _kind(nc))


def write_quantity(path: str | Path, quantity: GriddedQuantity, packed: bool = True) -> None:
    """Write a field file, all of it or nothing.

    Parameters
    ----------
    path : str or Path
        The file; one that exists is replaced.
    quantity : GriddedQuantity
        What goes into it.
    packed : bool
        In 16-bit integers that span the range of the values in the air, else in float64.

    Raises
    ------
    InputError
        If the folder does not exist, or the quantity is not as its docstring describes it.
    """
    path = Path(path)
    with naming(path):
        if not path.parent.is_dir():
            raise InputError(f"there is no folder {path.parent}; create it first")
        values, solid = _checked(quantity)
    kind = quantity.kind

    buffer = io.BytesIO()
    nc = netcdf_file(buffer, "w", version=2)  # 64-bit offsets
    planes = [f"{AXES[i]}={float(quantity.origin_mm[i])}" for i in range(3) if quantity.mirror[i]]
    described = {"title": f"Air {kind} on a regular grid"} | quantity.attributes
    for name, words in (described | {"mirror_planes": " ".join(planes) or "none"}).items():
        setattr(nc, name, str(words).encode())

    coordinates = {
        axis: (quantity.origin_mm[i] + quantity.spacing_mm[i] * np.arange(size), "mm")
        for i, (axis, size) in enumerate(zip(AXES, values.shape[-3:], strict=True))
    }
    if quantity.time_s is not None:
        coordinates = {"time": (np.asarray(quantity.time_s), "s")} | coordinates
    for name, (nodes, units) in coordinates.items():
        nc.createDimension(name, len(nodes))
        coordinate = nc.createVariable(name, "f8", (name,))
        coordinate[:] = nodes
        coordinate.units = units

    variable = nc.createVariable(kind, "i2" if packed else "f8", tuple(coordinates))
    variable.units = next(iter(UNITS[kind]))
    for name, value in quantity.ambient.items():
        setattr(variable, name, np.float64(value))
    if packed:
        low, high = np.nanmin(values), np.nanmax(values)
        offset, step = (low + high) / 2.0, (high - low) / (2 * PACKED_MAX) or 1.0
        integers = np.rint((values - offset) / step)
        variable[:] = np.where(np.isnan(integers), -PACKED_MAX - 1, integers).astype(np.int16)
        variable.scale_factor, variable.add_offset = np.float64(step), np.float64(offset)
        variable._FillValue = np.int16(-PACKED_MAX - 1)
    else:
        variable[:] = values
    if solid is not None and packed:  # its fill values are mask enough
        variable.fill_value_means = "solid"
    elif solid is not None:
        mask = nc.createVariable("solid", "i1", AXES)
        mask[:] = solid
        mask.units = "1"
    nc.flush()

    with written_whole(path) as unfinished:
        unfinished.write_bytes(buffer.getvalue())


def _checked(quantity: GriddedQuantity) -> tuple[np.ndarray, np.ndarray | None]:
    """Values with NaN in all of the solid, and its mask, if all is fit to be written."""
    kind, times = quantity.kind, quantity.time_s
    if kind not in UNITS:
        raise InputError(f"kind '{kind}': give one of {', '.join(UNITS)}")
    if unknown := quantity.ambient.keys() - set(AMBIENT[kind]):
        raise InputError(
            f"ambient '{sorted(unknown)[0]}' does not go with a {kind}; give "
            f"{', '.join(AMBIENT[kind])}"
        )
    for name, value in quantity.ambient.items():
        possible_ambient(name, value)
    values = np.array(quantity.values, dtype=np.float64)
    if values.ndim != (3 if times is None else 4):
        raise InputError(
            f"values of the shape {values.shape}; give (nx, ny, nz), with time_s (nt, nx, ny, nz)"
        )
    if times is not None:
        instants = np.asarray(times, dtype=np.float64)
        ascending = np.isfinite(instants).all() and (np.diff(instants) > 0.0).all()
        if instants.shape != values.shape[:1] or not ascending:
            raise InputError(
                f"time_s must hold the {values.shape[0]} instants of the values, finite, ascending"
            )
    origin, spacing = (np.asarray(v, float) for v in (quantity.origin_mm, quantity.spacing_mm))
    check_box(origin, spacing, values.shape[-3:])
    solid = None
    if quantity.solid is not None:
        solid = np.asarray(quantity.solid, dtype=bool)
        if solid.shape != values.shape[-3:] or solid.all():
            raise InputError(f"solid must have the shape {values.shape[-3:]} and leave some air")
        values[..., solid] = np.nan
    missing = np.isnan(values) if solid is None else np.isnan(values) & ~solid
    if missing.any():
        raise InputError(
            f"{missing.sum()} nodes in the air have no value, the first is "
            f"{np.argwhere(missing)[0].tolist()}; fill them, or mark what is solid"
        )
    check_limits(kind, values)
    return values, solid


def ambient_of(nc: Contents, kind: str, name: str, default: float) -> float:
    """A property of the surrounding air, an attribute of the variable or the file, in K, Pa, ..."""
    variable = nc.variables[kind]
    owner = variable if name in variable.attributes else nc
    addend = units_of(nc, kind, UNITS[kind]) if name == f"ambient_{kind}" else 0.0
    return possible_ambient(name, number(owner, name, default - addend) + addend)


def _kind(nc: Contents) -> str:
    """Find which of the three quantities the file holds."""
    found = [kind for kind in UNITS if kind in nc.variables]
    if len(found) != 1:
        others = [name for name in nc.variables if name not in AXES]
        raise InputError(
            f"must hold exactly one of the variables {', '.join(UNITS)}; it holds "
            f"{' and '.join(found) or ', '.join(others) or 'none'}"
        )
    return found[0]


def _read_values(nc: Contents, kind: str, time_s: float | None) -> np.ndarray:
    """Read the quantity at one instant, in the variable's units; NaN where missing."""
    times = read_times(nc, kind)

    def stored(instant: int) -> np.ndarray:
        return decoded(nc, kind, on_grid(nc, kind, instant))

    if time_s is None:
        return stored(-1)
    if times is None:
        raise InputError(
            f"it holds one instant without a time axis, so not that at {time_s:g} s; leave the time"
            " out"
        )
    doubt = TIME_DOUBT * abs(times).max()
    if not times[0] - doubt <= time_s <= times[-1] + doubt:
        raise InputError(
            f"it has no instant at {time_s:g} s; give a time from {times[0]:g} to {times[-1]:g} s"
        )
    place = float(np.interp(time_s, times, np.arange(len(times))))
    before = int(place)
    values = stored(before)
    if place > before:
        values += (place - before) * (stored(before + 1) - values)
    return values


def _read_refractivity(
    nc: Contents, solid: np.ndarray | None, wavelength_nm: float, time_s: float | None
) -> tuple[np.ndarray, float]:
    """Read n - 1 at the nodes, NaN where missing or solid, and of the surrounding air."""
    kind = _kind(nc)
    values = _read_values(nc, kind, time_s) + units_of(nc, kind, UNITS[kind])
    if solid is not None:
        values[solid] = np.nan
    check_limits(kind, values)

    if kind == "temperature":
        T = ambient_of(nc, kind, "ambient_temperature", AMBIENT_TEMPERATURE_K)
        pressure = ambient_of(nc, kind, "ambient_pressure", ATMOSPHERE_PA)
        humidity = ambient_of(nc, kind, "ambient_relative_humidity", 0.0)
        n = float(air_refractivity(wavelength_nm, T - ZERO_CELSIUS_K, pressure, humidity))
        return n * (T / values), n
    if kind == "density":
        K = float(refractivity_of_density(1.0, wavelength_nm))  # m^3/kg
        return K * values, K * ambient_of(nc, kind, "ambient_density", AMBIENT_DENSITY)
    default = float(air_refractivity(wavelength_nm))
    return values, ambient_of(nc, kind, "ambient_refractivity", default)
