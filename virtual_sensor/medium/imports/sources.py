"""What another solver's file holds: where its values lie, and which of them is the wanted one."""

from __future__ import annotations

import re
from collections.abc import Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np

from virtual_sensor.errors import InputError
from virtual_sensor.medium.air import ZERO_CELSIUS_K
from virtual_sensor.medium.netcdf_elements import MM

# For each quantity, what makes K, kg/m3 or 1 of a value in these units: factor, then addend.
UNITS: dict[str, dict[str, tuple[float, float]]] = {
    "temperature": {
        "K": (1.0, 0.0),
        "degC": (1.0, ZERO_CELSIUS_K),
        "kelvin": (1.0, 0.0),
        **dict.fromkeys(("°C", "C", "Celsius"), (1.0, ZERO_CELSIUS_K)),
    },
    "density": {
        "kg/m3": (1.0, 0.0),
        "g/cm3": (1e3, 0.0),
        **dict.fromkeys(("kg/m^3", "kg m^-3", "kg m-3", "kg/m³"), (1.0, 0.0)),
        **dict.fromkeys(("g/cm^3", "g cm^-3", "g cm-3", "g/cm³"), (1e3, 0.0)),
    },
    "refractivity": dict.fromkeys(("1", "dimensionless"), (1.0, 0.0)),
    "index": dict.fromkeys(("1", "dimensionless"), (1.0, -1.0)),
}
LENGTHS = {"mm": 1.0, "m": 1e3, **MM, "cm": 10.0, "um": 1e-3, "µm": 1e-3}
NAMES = {
    "temperature": {"t", "temp", "temperature", "statictemperature"},
    "density": {"rho", "density"},
    "refractivity": {"refractivity", "n-1", "nminus1", "nm1"},
    "index": {"n", "index", "refractiveindex", "indexofrefraction"},
}
SAME_PLANE = 1e-6  # of the extent: float32's and printed coordinates' rounding
MOST_MISSING = 0.5  # of a lattice's nodes; with more it is none


@dataclass(frozen=True)
class Variable:
    """One scalar of a file.

    Attributes
    ----------
    name : str
        As in the file, without units.
    units : str
        As in the file; empty if it does not say.
    values : ndarray
        Shape (nx, ny, nz) on a grid, else (N,); NaN where the file has none.
    """

    name: str
    units: str
    values: np.ndarray

    def __str__(self) -> str:
        return f"{self.name} [{self.units}]" if self.units else self.name


@dataclass(frozen=True)
class Grid:
    """Nodes on the product of three coordinate axes, each ascending; a flat axis has one node."""

    axes: tuple[np.ndarray, np.ndarray, np.ndarray]


@dataclass(frozen=True)
class Cloud:
    """Points without cells, shape (N, 3)."""

    points: np.ndarray


@dataclass(frozen=True)
class Mesh:
    """Cells: a `pyvista.UnstructuredGrid`, and whether values belong to the cells or the points."""

    cells: Any
    at_cells: bool


@dataclass(frozen=True)
class Source:
    """A file that has been read.

    Attributes
    ----------
    variables : sequence of Variable
        The scalars, at one time.
    geometry : Grid, Cloud or Mesh
        Where their values lie, in `length_units`.
    length_units : str
        Of the coordinates; empty if the file does not say.
    reader : str
        What read it, with version, and the time that was read, in words.
    """

    variables: Sequence[Variable]
    geometry: Grid | Cloud | Mesh
    length_units: str
    reader: str


def split_units(label: str) -> tuple[str, str]:
    """Split a label such as ``T (K)`` or ``x [mm]`` into name and units."""
    match = re.fullmatch(r"\s*(.*?)\s*(?:\[([^\]]*)\]|\(([^()]*)\))\s*", label)
    if not match or not match[1]:
        return label.strip(), ""
    return match[1], (match[2] or match[3] or "").strip()


def quantity_of(variable: Variable) -> str:
    """Tell the quantity from a variable's name or else from its units; empty if neither tells."""
    bare = re.sub(r"[\s_]", "", variable.name.rpartition(".")[2]).lower()
    named = next((kind for kind, names in NAMES.items() if bare in names), "")
    if named or variable.units in UNITS["index"]:
        return named
    return next((kind for kind, units in UNITS.items() if variable.units in units), "")


def choose(
    variables: Sequence[Variable], name: str | None, quantity: str | None
) -> tuple[Variable, str]:
    """Choose the variable to import.

    Parameters
    ----------
    variables : sequence of Variable
        What there is.
    name : str, optional
        The wanted one's name; else the only one whose name or units tell the quantity, or the only
        one.
    quantity : str, optional
        A key of `UNITS`; else what the name or the units tell.

    Returns
    -------
    variable : Variable
    quantity : str

    Raises
    ------
    InputError
        If there is none, more than one comes into question, or nothing tells the quantity.
    """
    listed = ", ".join(map(str, variables))
    if not variables:
        raise InputError("holds no scalar; export the temperature, the density or the index")
    if name is not None:
        found = [v for v in variables if v.name == name]
        if not found:
            raise InputError(f"there is no variable '{name}'; there are: {listed}")
    else:
        kinds = [quantity] if quantity else list(UNITS)
        found = [v for v in variables if quantity_of(v) in kinds] or list(variables)
    if len(found) > 1:
        raise InputError(
            f"{len(found)} variables come into question, {', '.join(map(str, found))}; choose one "
            f"with --variable, such as --variable '{found[0].name}'"
        )
    quantity = quantity or quantity_of(found[0])
    if not quantity:
        raise InputError(
            f"what is variable '{found[0]}'? Say --quantity {', '.join(UNITS)} (index is n itself)"
        )
    return found[0], quantity


def agreed(what: str, option: str, told: str | None, said: str, known: Sequence[str]) -> str:
    """Units that the option tells or the file says, which must not contradict each other.

    Parameters
    ----------
    what, option : str
        What has the units, and the name of the option, for the messages.
    told : str or None
        The option's value.
    said : str
        What the file says; empty if nothing.
    known : sequence of str
        The units that make sense.

    Raises
    ------
    InputError
        If nobody says, the units are unknown, or the two differ.
    """
    units = told or said
    if not units:
        raise InputError(
            f"the file does not say the units of {what}; say {option} {' or '.join(known[:2])}"
        )
    if units not in known:
        raise InputError(f"{what} in '{units}'? Known are: {', '.join(known)} (see {option})")
    if told and said and said != told and said in known:
        raise InputError(f"the file says that {what} is in {said}; leave {option} {told} out")
    return units


def as_lattice(points: np.ndarray) -> tuple[Grid, np.ndarray] | None:
    """Recognise points that lie on the product of three axes.

    Parameters
    ----------
    points : ndarray of shape (N, 3)
        In any order; some nodes may be absent, such as those in a solid.

    Returns
    -------
    grid : Grid
    index : ndarray of int of shape (N,)
        Each point's node, into the flattened grid. Or None, if the points are no lattice.
    """
    tolerance = SAME_PLANE * np.ptp(points, axis=0).max()
    axes, index = [], np.zeros(len(points), dtype=np.int64)
    for along in points.T:
        ordered = np.sort(along)
        first = np.concatenate([[True], np.diff(ordered) > tolerance])
        starts = np.flatnonzero(first)
        axis = np.add.reduceat(ordered, starts) / np.diff([*starts, len(ordered)])
        if len(axis) * MOST_MISSING > len(points):
            return None
        nearest = np.clip(np.searchsorted(ordered[first], along, "right") - 1, 0, len(axis) - 1)
        if (abs(along - axis[nearest]) > tolerance).any():
            return None
        index = index * len(axis) + nearest
        axes.append(axis)
    distinct = len(np.unique(index))
    if distinct < len(points) or distinct < MOST_MISSING * np.prod([len(a) for a in axes]):
        return None
    return Grid((axes[0], axes[1], axes[2])), index


def on_lattice(grid: Grid, index: np.ndarray, values: np.ndarray) -> np.ndarray:
    """Values of `as_lattice`'s points in the grid's shape, NaN at absent nodes."""
    shape = [len(axis) for axis in grid.axes]
    nodes = np.full(np.prod(shape), np.nan, np.result_type(values, np.float32))
    nodes[index] = values
    return nodes.reshape(shape)
