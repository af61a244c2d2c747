"""Field files of a temperature that is linear in x, y and z, by SciPy, and what spoils them."""

from __future__ import annotations

import io
from dataclasses import dataclass, field
from typing import Any

import numpy as np
from hostile.cases import Case, Result
from hostile.mutations import GARBAGE, cut, flipped, spliced, stamped
from hypothesis import reject
from hypothesis import strategies as st
from scipy.io import netcdf_file

SLOPES = np.array([0.9, 1.7, -1.3])  # K/mm: no two axes alike
MIDDLE_K = 420.0
AMBIENT_K = 293.15
# Dry air at 15 degC and 1 atm, 532 nm (Edlen, 1966): n - 1. The rest is the ideal gas.
_AIR_15 = 2.7826e-4
AIR = _AIR_15 * 288.15 / AMBIENT_K
GLADSTONE_DALE = _AIR_15 / 1.2250  # m3/kg
FAR_MM, NEAR_MM = 1e6, 1e-6
MOST_INDEX = 0.9


def kelvin(x, y, z):
    """The formula, K."""
    return MIDDLE_K + SLOPES[0] * x + SLOPES[1] * y + SLOPES[2] * z


@dataclass(frozen=True)
class Air:
    """A whole field.

    Attributes
    ----------
    axes : tuple of three ndarray
        mm.
    kind : str
        "temperature", "density" or "refractivity".
    solid : ndarray of bool or None
    packing : str
        "f4", "f8", "i2" or "u2".
    """

    axes: tuple[np.ndarray, ...]
    kind: str
    packing: str
    solid: np.ndarray | None = None

    def ratio(self, axes=None):
        """(n - 1) / (n_ambient - 1) at the nodes, by the ideal gas."""
        return AMBIENT_K / kelvin(*np.meshgrid(*(axes or self.axes), indexing="ij"))


@dataclass(frozen=True)
class Written:
    """A file and what is known of it."""

    data: bytes
    air: Air
    values: tuple[int, int]
    options: dict[str, Any] = field(default_factory=dict)
    label: str = ""
    plain: bool = True


def _started(buffer: io.BytesIO, version: int = 2) -> netcdf_file:
    """A NetCDF file that is not written when it is collected, if its making is broken off."""
    nc = netcdf_file(buffer, "w", version=version)
    nc.__dict__["mode"] = "r"
    return nc


def _finish(nc: netcdf_file) -> None:
    nc.__dict__["mode"] = "w"
    try:
        with np.errstate(all="ignore"):
            nc.flush()
    finally:
        nc.__dict__["mode"] = "r"


@st.composite
def airs(draw):
    axes = []
    for _ in range(3):
        nodes = draw(st.integers(4, 7))
        first, step = draw(st.integers(-30, 10)), draw(st.sampled_from((2.0, 4.0, 5.5)))
        axes.append(first + step * np.arange(nodes))
    kind = draw(st.sampled_from(("temperature", "temperature", "density", "refractivity")))
    packing = draw(st.sampled_from(("f8", "f4", "i2", "u2")))
    solid = None
    if draw(st.booleans()):
        solid = np.zeros([len(a) for a in axes], bool)
        solid[1:3, 1:3, :2] = True
    return Air(tuple(axes), kind, packing, solid)


@st.composite
def written(draw, air: Air):
    """The field as a NetCDF-3 file."""
    values = kelvin(*np.meshgrid(*air.axes, indexing="ij"))
    units, ambient = "K", {"ambient_temperature": AMBIENT_K}
    options, label, plain = {}, f"{air.kind} {air.packing}", True
    if air.kind == "temperature":
        if draw(st.booleans()):
            units, values = "degC", values - 273.15
            ambient = {"ambient_temperature": AMBIENT_K - 273.15}
    elif air.kind == "density":
        units, values = "kg/m3", 1.2041 * AMBIENT_K / values
        ambient = {"ambient_density": 1.2041}
    else:
        units, values, ambient = "1", AIR * AMBIENT_K / values, {"ambient_refractivity": AIR}
    more: dict[str, Any] = dict(ambient)
    stored = values
    if air.packing in ("i2", "u2"):
        low, high = values.min(), values.max()
        step = (high - low) / 60000
        more |= {"scale_factor": step, "add_offset": low}
        stored = np.rint((values - low) / step)
        if air.packing == "i2":
            more["add_offset"] = low + 30000 * step
            stored -= 30000
        else:
            more["_Unsigned"] = "true"
            plain = False
        fill = -32000 if air.packing == "i2" else 65000
    else:
        fill = 1e30 if air.kind != "refractivity" else -9.0
    masked = air.solid is not None and draw(st.sampled_from(("mask", "fill", "means")))
    if air.solid is not None:
        stored = np.where(air.solid, fill, stored)
        if masked != "mask":
            more["_FillValue" if draw(st.booleans()) or masked == "means" else "missing_value"] = (
                fill
            )
            if masked == "means":
                more["fill_value_means"] = "solid"
            else:
                plain = False  # nothing says that it is solid
    if draw(st.integers(0, 4)) == 0:
        bounds = draw(st.sampled_from(("valid_range", "valid_min", "valid_max")))
        inside = stored[~air.solid] if air.solid is not None else stored
        low, high = inside.min() - 1, inside.max() + 1
        more[bounds] = {"valid_range": (low, high), "valid_min": low, "valid_max": high}[bounds]
        plain = False
    unit = draw(st.sampled_from(("mm", "m")))
    buffer = io.BytesIO()
    nc = _started(buffer, draw(st.sampled_from((1, 2))))
    names = ("x", "y", "z")
    instants = draw(st.sampled_from((0, 1, 3, 3)))
    for name, axis in zip(names, air.axes, strict=True):
        nc.createDimension(name, len(axis))
        variable = nc.createVariable(name, "f8", (name,))
        variable[:] = axis / (1000.0 if unit == "m" else 1.0)
        variable.units = unit
    if masked == "mask":
        mask = nc.createVariable("solid", "i1", names)
        mask[:] = air.solid
        mask.units = "1"
    if instants:
        nc.createDimension("time", instants)
        variable = nc.createVariable("time", "f8", ("time",))
        variable[:] = np.arange(instants)
        variable.units = "s"
        names = ("time", *names)
        stored = np.stack([stored] * instants)
        options = draw(st.sampled_from(({}, {"time_s": 0.0}, {"time_s": (instants - 1) / 2})))
    kind = {"u2": "i2"}.get(air.packing, air.packing)
    typed = np.asarray(stored).astype(air.packing).view(kind)
    variable = nc.createVariable(air.kind, kind, names)
    variable[:] = typed
    variable.units = units
    for name, value in more.items():
        if name in ("_FillValue", "missing_value", "valid_range", "valid_min", "valid_max"):
            value = np.asarray(value).astype(air.packing).view(kind)
        setattr(variable, name, value)
    planes = draw(st.sampled_from((None, "none", "x")))
    if planes:
        first = air.axes[0][0] / (1000.0 if unit == "m" else 1.0)
        nc.mirror_planes = planes if planes == "none" else f"x={float(first)!r}"
    _finish(nc)
    data = buffer.getvalue()
    raw = typed.astype(typed.dtype.newbyteorder(">")).tobytes()
    first = data.rfind(raw)
    return Written(data, air, (first, first + len(raw)), options, label, plain)


def plain_file(axes: tuple[np.ndarray, ...]) -> bytes:
    """A file of the formula's temperature in K."""
    buffer = io.BytesIO()
    nc = _started(buffer)
    for name, axis in zip("xyz", axes, strict=True):
        nc.createDimension(name, len(axis))
        variable = nc.createVariable(name, "f8", (name,))
        variable[:] = axis
        variable.units = "mm"
    variable = nc.createVariable("temperature", "f8", tuple("xyz"))
    variable[:] = kelvin(*np.meshgrid(*axes, indexing="ij"))
    variable.units = "K"
    _finish(nc)
    return buffer.getvalue()


HOSTILE_VALUES = (
    "x", "", b"", np.float64("nan"), np.float64("inf"), -1.0, 0.0, 1e300, -0.5, 1e9, 3e38,
    np.array([], "f8"), np.array([1, 2, 3], "f4"), np.array([], "i2"), "x=nan", "x=0 x=0", "w=1",
    "\x1b]0;OWNED\x07\x1b[31mred", "é" * 50, "solid", "none", "true", "K", "degC", "1", np.int16(0),
    "x=inf", "x=1e999", "y=", "=", 1e-300, "a" * 5000,
)  # fmt: skip
ATTRIBUTES = (
    "_FillValue", "missing_value", "scale_factor", "add_offset", "units", "fill_value_means",
    "ambient_temperature", "ambient_pressure", "ambient_relative_humidity", "ambient_density",
    "ambient_refractivity", "valid_range", "valid_min", "valid_max", "_Unsigned", "mirror_planes",
    "title", "source", "mode", "fp", "variables", "dimensions", "data", "_attributes", "isrec",
)  # fmt: skip


def _often(usual: tuple[Any, ...], seldom: tuple[Any, ...]):
    """One of the usual nine times of ten."""
    return st.integers(0, 9).flatmap(lambda n: st.sampled_from(usual if n else seldom))


@st.composite
def contradictory(draw):
    """A file by SciPy, with elements that no field has."""
    kinds = {"temperature": ("K", 400.0), "density": ("kg/m3", 1.1), "refractivity": ("1", 2e-4)}
    kind = draw(st.sampled_from(list(kinds)))
    units, middle = kinds[kind]
    type_ = draw(_often(("f4", "f8"), ("i1", "i2", "i4", "c")))
    buffer = io.BytesIO()
    nc = _started(buffer)
    for name in "xyz":
        count = draw(_often((4, 5), (1, 2)))
        nc.createDimension(name, count)
        coordinate = draw(_often(("f8", "f4"), ("i2", "c")))
        nodes = np.arange(count) * draw(_often((20.0,), (-5.0, 0.0, 1e150, 1e-150)))
        nodes = nodes + draw(_often((-30.0, 0.0), (np.nan, np.inf, 1e300)))
        variable = nc.createVariable(name, coordinate, (name,))
        with np.errstate(all="ignore"):
            made = nodes.astype("S1") if coordinate == "c" else nodes.astype(coordinate)
        variable[:] = made
        if draw(_often((True,), (False,))):
            variable.units = "mm"
    names = draw(_often((tuple("xyz"),), (tuple("zyx"), tuple("xy"), ())))
    shape = tuple(nc.dimensions[n] for n in names)
    special = draw(_often((1.0,), (np.nan, np.inf, -1.0, 0.0, 1e30, 1e-30, 1e300)))
    values = np.full(shape, middle)
    if shape:
        values.flat[draw(st.integers(0, values.size - 1))] *= special
    variable = nc.createVariable(kind, type_, names)
    with np.errstate(all="ignore"):
        made = values.astype("S1") if type_ == "c" else values.astype(type_)
    if shape:
        variable[:] = made
    if draw(_often((True,), (False,))):
        variable.units = units
    for _ in range(draw(st.integers(0, 2))):
        owner = draw(st.sampled_from((variable, nc)))
        value = draw(st.sampled_from(HOSTILE_VALUES))
        owner._attributes[draw(st.sampled_from(ATTRIBUTES))] = value
    try:
        _finish(nc)
    except (ValueError, TypeError):  # SciPy can't write it
        reject()
    return buffer.getvalue()


def judged(written: Written, wrong: int = 0):
    """Whether the air's values are the formula's, but for so many."""
    air = written.air
    quantum = {"f4": 1e-6, "f8": 1e-7}.get(air.packing, 2e-5)

    def judge(result: Result) -> str:
        if failed := possible(result):
            return failed
        if abs(result["ambient"] / AIR - 1.0) > 5e-3:
            return f"the ambient n - 1 is {result['ambient']:g}, not {AIR:g}"
        nodes = result["nodes"]
        axes = [
            o + s * np.arange(n)
            for o, s, n in zip(result["origin"], result["spacing"], nodes.shape, strict=True)
        ]
        whole = tuple(len(axis) for axis in air.axes)
        if nodes.shape != whole:
            return f"{nodes.shape} nodes, and {whole} were written"
        away = np.abs(nodes / result["ambient"] / air.ratio(axes) - 1.0)
        if air.solid is not None:
            away = away[~air.solid]
        off = away > quantum
        if off.sum() > wrong:
            return f"{off.sum()} values are off the formula, by up to {away.max():.2g} of ambient"
        return ""

    return judge


def possible(result: Result) -> str:
    """Whether it is air at all."""
    nodes, ambient = result["nodes"], result["ambient"]
    if nodes.ndim != 3 or not np.isfinite(nodes).all():
        return f"nodes of shape {nodes.shape}, {np.isnan(nodes).sum()} NaN"
    if not (nodes.min() > -1.0 and nodes.max() < MOST_INDEX):
        return f"n - 1 from {nodes.min():g} to {nodes.max():g}"
    if not -1e-3 < ambient < MOST_INDEX:
        return f"the ambient n - 1 is {ambient:g}"
    origin, spacing = result["origin"], result["spacing"]
    if not (np.isfinite(origin).all() and (np.abs(origin) < FAR_MM).all()):
        return f"the origin is {origin} mm"
    if not ((spacing > NEAR_MM) & (spacing < FAR_MM)).all():
        return f"the spacing is {spacing} mm"
    return ""


@st.composite
def cases(draw):
    """A field file that is whole, or spoilt."""
    hows = (
        "whole",
        "cut",
        "cut",
        "header",
        "values",
        "spliced",
        "made",
        "made",
        "garbage",
        "times",
    )
    how = draw(st.sampled_from(hows))
    options: dict[str, Any] = {}
    label, judge, must = "netcdf", possible, False
    if how == "made":
        data = draw(contradictory())
    elif how == "garbage":
        data = draw(st.sampled_from((b"", b"CDF\x01", b"CDF\x02")).flatmap(_followed))
    else:
        whole = draw(draw(airs().map(written)))
        data, options, label = whole.data, dict(whole.options), whole.label
        if how in ("whole", "cut"):
            judge, must = judged(whole), how == "whole" and whole.plain
            data = draw(cut(data)) if how == "cut" else data
        elif how == "header":
            span = (0, max(whole.values[0], 8))
            change = flipped(data, [span]) if draw(st.booleans()) else stamped(data, span)
            data = draw(change)
        elif how == "values" and whole.values[0] > 0 and whole.air.solid is None:
            data = draw(flipped(data, [whole.values]))
            judge = judged(whole, wrong=4)
        elif how == "times":
            times = (0.5, 0.0, 1.5, 1.0, -1.0, float("nan"), float("inf"), 1e300, 5.0)
            options["time_s"] = draw(st.sampled_from(times))
            judge = judged(whole)
        else:
            data = draw(spliced(data))
    return Case("field", f"{label}/{how}", {"air.nc": data}, "air.nc", judge, options, must)


def _followed(start: bytes):
    return GARBAGE.map(lambda rest: start + rest)
