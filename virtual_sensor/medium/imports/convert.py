"""The import itself, which `import_field` does in a child process."""

from __future__ import annotations

import contextlib
import re
from collections.abc import Callable, Sequence
from dataclasses import replace
from datetime import UTC, datetime
from pathlib import Path

import numpy as np
from scipy import ndimage

from virtual_sensor.errors import InputError, naming
from virtual_sensor.medium.air import air_refractivity
from virtual_sensor.medium.imports.import_field import Choices, Imported, Report
from virtual_sensor.medium.imports.placement import (
    Frame,
    bounds,
    check_size,
    is_sized,
    output_axes,
    unfold,
)
from virtual_sensor.medium.imports.readers import read_source
from virtual_sensor.medium.imports.resample import is_flat, resample, solid_of
from virtual_sensor.medium.imports.sources import (
    LENGTHS,
    UNITS,
    Cloud,
    Source,
    Variable,
    agreed,
    choose,
    in_order,
)
from virtual_sensor.medium.netcdf import (
    AMBIENT_DENSITY,
    AMBIENT_TEMPERATURE_K,
    GriddedQuantity,
)
from virtual_sensor.medium.quantities import AMBIENT_LIMITS, LIMITS
from virtual_sensor.medium.units import ZERO_CELSIUS_K, unit_of

with contextlib.suppress(ImportError):  # once, before children are forked
    import pyvista  # noqa: F401

FLOAT32_INDEX = 1.2e-7  # distance of float32 numbers above 1
BORDER_DIFFERS = 0.01  # of n - 1, between the field's border and the surrounding air
COLDEST_C = -50.0
WALL_MM = 1e-4  # a node so near to the part is the part's
KELVIN_OF_ROOMS = (230.0, 340.0)  # as a coldest value in degC it is rather K
LEAST_DENSITY, MOST_DENSITY = 0.02, 50.0  # kg/m3, for the densest air in the field
LARGEST_NUMBER = 1e12  # of an option: products of a few of them are finite
MOST_REFRACTIVITY = 0.01  # no gas near atmospheric pressure has more


def import_here(
    path: str | Path,
    choices: Choices,
    history: str = "",
    report: Report = lambda stage, fraction: None,
) -> Imported:
    """Do as `import_field`, in this process."""
    with naming(path):
        _check(choices)
        report("reading", 0.0)
        source = read_source(path, choices.time_s, choices.spacing_mm, choices.region)
        source, variable, quantity = choose(source, choices.variable, choices.quantity)
        kind, values, ambient, notes = _in_si(variable, quantity, choices)
        geometry = source.geometry
        if isinstance(geometry, Cloud):
            geometry, values, more = in_order(geometry.points, values)
            notes += more

        report("resampling", 0.3)
        at_nodes, solid, mirror, nodes = _on_nodes(
            replace(source, geometry=geometry),
            values,
            choices,
            lambda fraction: report("resampling", 0.3 + 0.6 * fraction),
        )
        at_nodes[solid] = np.nan
        notes += _border(kind, at_nodes, mirror, ambient)
        stated = {f"ambient_{kind}": ambient} if ambient is not None else {}
        if choices.pressure_pa is not None:
            stated["ambient_pressure"] = choices.pressure_pa
        made = GriddedQuantity(
            kind,
            at_nodes,
            np.array([axis[0] for axis in nodes]),
            np.array([axis[1] - axis[0] for axis in nodes]),
            ambient=stated,
            mirror=mirror,
            solid=solid if solid.any() else None,
            attributes=_provenance(Path(path), source, variable, kind, history),
        )
    return Imported(made, (*source.notes, *notes))


def _check(choices: Choices) -> None:
    """Refuse options that no file makes sense of."""
    if choices.quantity is not None and choices.quantity not in UNITS:
        raise InputError(f"--quantity {choices.quantity}: choose one of {', '.join(UNITS)}")
    for name in choices.mirror:
        if name not in ("x", "y", "z"):
            raise InputError(f"--mirror {name}: name axes, such as x,y")
    for option, given, shape in (
        ("--origin", choices.origin_mm, (3,)),
        ("--box", choices.box_mm, (6,)),
        ("--spacing", choices.spacing_mm, (3,)),
        ("--extrude", choices.extrude_mm, (2,)),
        ("--ambient", choices.ambient, ()),
        ("--time", choices.time_s, ()),
    ):
        if given is not None and not (
            np.shape(given) == shape and (np.abs(given) < LARGEST_NUMBER).all()
        ):
            count = f"{shape[0]} finite numbers" if shape else "a finite number"
            raise InputError(f"{option} {given}: give {count} below {LARGEST_NUMBER:g}")
    if choices.spacing_mm is not None and not min(choices.spacing_mm) > 0.0:
        raise InputError(f"--spacing {choices.spacing_mm}: give positive lengths")
    if choices.extrude_mm is not None and not choices.extrude_mm[0] < choices.extrude_mm[1]:
        low, high = choices.extrude_mm
        raise InputError(f"--extrude {low:g},{high:g}: the first must be below the second")
    if choices.pressure_pa is not None:
        low, high, unit = AMBIENT_LIMITS["ambient_pressure"]
        if not low <= choices.pressure_pa <= high:
            raise InputError(
                f"--pressure {choices.pressure_pa:g}: give one from {low:g} to {high:g}{unit}"
            )


def _in_si(
    variable: Variable, quantity: str, choices: Choices
) -> tuple[str, np.ndarray, float | None, list[str]]:
    """Kind, values and ambient in K, kg/m3 or as n - 1, and notes; refuse what cannot be."""
    known = UNITS[quantity]
    kind = "refractivity" if quantity == "index" else quantity
    raw = np.asarray(variable.values, dtype=np.float64)
    if choices.pressure_pa is not None and kind != "temperature":
        raise InputError(f"--pressure goes with a temperature, not with a {kind}")
    if np.isinf(raw).any():
        raise InputError(
            f"'{variable.name}' is infinite at {np.isinf(raw).sum()} places; write NaN where there"
            " are no data"
        )
    if not np.isfinite(raw).any():
        raise InputError(f"'{variable.name}' has no finite value; choose another --variable")

    def read_in(units: str) -> tuple[np.ndarray, float | None]:
        factor, addend = known[units]
        values = raw * factor + addend
        ambient = None if choices.ambient is None else choices.ambient * factor + addend
        _refuse(kind, values, units, quantity, ambient)
        if ambient is not None:
            _refuse(kind, np.array([ambient]), units, quantity, ambient)
        return values, ambient

    def possible(units: str) -> bool:
        try:
            read_in(units)
        except InputError:
            return False
        return True

    said = variable.units or ("1" if "1" in known else "")
    units = agreed(f"'{variable.name}'", "--units", choices.units, said, list(known), possible)
    values, ambient = read_in(units)
    notes = []
    if choices.units and unit_of(said, known) not in (None, units):
        notes.append(
            f"the file says that '{variable.name}' is in {said}, which its values can't be;"
            f" they are read in {units}"
        )
    if quantity == "index" and variable.values.dtype == np.float32:
        notes.append(
            f"n is stored as float32, which resolves n - 1 by {FLOAT32_INDEX:g} only, "
            f"{FLOAT32_INDEX / 2.7e-4:.1g} of that of air; export n - 1, the density or float64"
        )
    return kind, values, ambient, notes


def _refuse(
    kind: str, values: np.ndarray, units: str, quantity: str, ambient: float | None
) -> None:
    """Refuse values that are likely to be in other units."""
    low, high = float(np.nanmin(values)), float(np.nanmax(values))
    if kind == "temperature":
        low_c, celsius = low - ZERO_CELSIUS_K, UNITS[kind][units][1] != 0.0
        others = values[values > low]  # NaN is not
        if low_c < COLDEST_C and low in (0.0, ZERO_CELSIUS_K) and others.size:
            second = float(others.min())
            if second - ZERO_CELSIUS_K >= COLDEST_C:
                raise InputError(
                    f"a temperature of {low:g} K at {(values == low).sum()} places, and"
                    f" {second:.5g} K or more at all others: no data there? Write NaN in their"
                    " place"
                )
        if low_c < COLDEST_C or high > 6000.0:
            raise InputError(
                f"a temperature of {low if low_c < COLDEST_C else high:.5g} K, read in {units}: "
                + (
                    "degC, said to be K? Say --units degC"
                    if low_c < COLDEST_C and low >= COLDEST_C and not celsius
                    else "check the units, and that missing values are NaN"
                )
            )
        if celsius and KELVIN_OF_ROOMS[0] < low_c < KELVIN_OF_ROOMS[1] and ambient is None:
            raise InputError(
                f"the coldest air is at {low_c:.5g} degC, read in {units}: K, said to be degC? "
                "Say --units K; or, if the surroundings are so hot, --ambient"
            )
    elif kind == "density" and not (LEAST_DENSITY < high < MOST_DENSITY and low > 0.0):
        raise InputError(
            f"densities of {low:.5g} to {high:.5g} kg/m3, read in {units}: say --units kg/m3 or "
            "g/cm3 as it is, or choose another --variable"
        )
    elif kind == "refractivity" and quantity == "index" and low < -0.5:
        raise InputError(
            f"an index of {low + 1.0:.5g}: n - 1, said to be n? Say --quantity refractivity"
        )
    elif kind == "refractivity" and not -MOST_REFRACTIVITY < low <= high < MOST_REFRACTIVITY:
        raise InputError(
            f"n - 1 from {low:.5g} to {high:.5g}, which no gas has: "
            + ("n, said to be n - 1? Say --quantity index" if high > 0.9 else "check the units")
        )


def _on_nodes(
    source: Source, values: np.ndarray, choices: Choices, report: Callable[[float], None]
) -> tuple[np.ndarray, np.ndarray, tuple[bool, ...], tuple[np.ndarray, ...]]:
    """Values, solid and mirror planes on the output grid, and the grid's axes."""
    frame = Frame.parse(choices.axes, choices.origin_mm, choices.scale)
    has = bounds(source.geometry)
    units = agreed(
        "length",
        "--length-units",
        choices.length_units,
        source.length_units,
        list(LENGTHS),
        lambda said: is_sized(has * LENGTHS[said] * choices.scale),
    )
    geometry, values = frame.place(source.geometry, values, LENGTHS[units])
    check_size(bounds(geometry), units)
    flat = [is_flat(geometry, i) for i in range(3)]
    if any(flat[1:]):
        names = [choices.axes.split(",")[i].lstrip("+-") for i in range(3) if flat[i]]
        raise InputError(
            f"is 2-D, flat along its {' and '.join(names)}: say which axes are the world's y and z "
            f"(up) of a cross-section, such as --axes {names[0]},x,y"
        )
    if flat[0] and choices.extrude_mm is None:
        raise InputError("is a 2-D cross-section; say from where to where along x with --extrude")
    if not flat[0] and choices.extrude_mm is not None:
        raise InputError("--extrude is for a 2-D cross-section, and the data are 3-D; see --box")
    mirror = tuple(name in choices.mirror for name in "xyz")
    for i in range(3):
        if mirror[i]:
            geometry, values = unfold(geometry, values, i, flat[0])
    axes = output_axes(geometry, mirror, choices.box_mm, choices.spacing_mm, choices.extrude_mm)
    at_nodes = resample(geometry, values, axes, report)
    solid = _solid(at_nodes, axes, mirror, flat[0], choices.solid)
    return at_nodes, solid, mirror, axes


def _solid(
    values: np.ndarray,
    axes: Sequence[np.ndarray],
    mirror: Sequence[bool],
    flat: bool,
    chosen: str,
) -> np.ndarray:
    """Nodes in the solid, as `Choices.solid` says; other holes are refused."""
    missing = ~np.isfinite(values)
    open_faces = [(not even, True) for even in mirror]
    if flat:
        open_faces[0] = (False, False)
    if chosen in ("auto", "enclosed"):
        most = 1 if chosen == "auto" else missing.size
        return solid_of(missing, axes, open_faces, most)
    solid = np.zeros(missing.shape, dtype=bool)
    if chosen != "none":
        number = r"(\d+\.?\d*|\.\d+)"
        match = re.fullmatch(rf"cylinder:{number}(?:,{number})?", chosen)
        if not match:
            raise InputError(
                f"--solid {chosen}: say auto, enclosed, none or cylinder:RADIUS[,LENGTH] in mm"
            )
        radius, length = float(match[1]), float(match[2] or np.inf)
        x, y, z = np.meshgrid(*axes, indexing="ij", sparse=True)
        solid = (np.hypot(y, z + radius) < radius + WALL_MM) & (abs(x) < 0.5 * length + WALL_MM)
        if not solid.any():
            raise InputError(f"--solid {chosen}: no node of the grid is inside; see --origin")
    # A mesh's facets leave nodes just outside of a round part without a cell.
    skin = ndimage.binary_dilation(solid, np.ones((3, 3, 3))) & missing
    solid_of(missing & ~solid & ~skin, axes, open_faces, most=0)
    return solid | skin


def _border(
    kind: str, values: np.ndarray, mirror: Sequence[bool], ambient: float | None
) -> list[str]:
    """Note that the field's border is not at the surrounding air's value."""
    faces = [
        values.take(node, axis).ravel()
        for axis in range(3)
        for node in ((-1,) if mirror[axis] else (0, -1))
    ]
    border = float(np.nanmedian(np.concatenate(faces)))
    default = {
        "temperature": AMBIENT_TEMPERATURE_K,
        "density": AMBIENT_DENSITY,
        "refractivity": float(air_refractivity()),
    }[kind]
    around = default if ambient is None else ambient
    if abs(border / around - 1.0) < BORDER_DIFFERS:
        return []
    *_, unit = LIMITS[kind]
    taken = "taken as" if ambient is None else "said to be"
    return [
        f"the {'n - 1' if kind == 'refractivity' else kind} at the field's border is {border:.5g}"
        f"{unit} in the median, the surrounding air is {taken} {around:.5g}{unit}: such a jump "
        "refracts; see --ambient and --box"
    ]


def _provenance(
    path: Path, source: Source, variable: Variable, kind: str, history: str
) -> dict[str, str]:
    """Attributes of the file."""
    now = datetime.now(UTC).isoformat(timespec="seconds")
    return {
        "title": f"{kind.capitalize()} imported from {path.resolve().name}",
        "source": f"{path.resolve().name}, variable {variable}; read by {source.reader}",
        "date": now,
        "history": f"{now} {history}".strip(),
    }
