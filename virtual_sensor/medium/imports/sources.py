"""What another solver's file holds: where its values lie, and which of them is the wanted one."""

from __future__ import annotations

import re
from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace
from typing import Any

import numpy as np

from virtual_sensor.errors import InputError
from virtual_sensor.medium.netcdf_elements import MM
from virtual_sensor.medium.units import ZERO_CELSIUS_K, unit_of

# For each quantity, what makes K, kg/m3 or 1 of a value in these units: factor, then addend.
UNITS: dict[str, dict[str, tuple[float, float]]] = {
    "temperature": {"K": (1.0, 0.0), "degC": (1.0, ZERO_CELSIUS_K)},
    "density": {"kg/m3": (1.0, 0.0), "g/cm3": (1e3, 0.0)},
    "refractivity": {"1": (1.0, 0.0)},
    "index": {"1": (1.0, -1.0)},
}
LENGTHS = MM | {"um": 1e-3, "inch": 25.4}
NAMES = {
    "temperature": {"t", "temp", "temperature", "statictemperature"},
    "density": {"rho", "density"},
    "refractivity": {"refractivity", "n-1", "nminus1", "nm1"},
    "index": {"n", "index", "refractiveindex", "indexofrefraction"},
}
SAME_PLANE = 1e-6  # of the extent: float32's and printed coordinates' rounding
MOST_MISSING = 0.5  # of a lattice's nodes; with more it is none
CONTRADICTION = 1e-3  # of the range: values of one point that differ by more are no rounding


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

    @property
    def size(self) -> int:
        """Number of nodes."""
        return int(np.prod([len(axis) for axis in self.axes]))


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
    notes : tuple of str
        What the reader ignored, converted or assumed.
    at_cells : Source or None
        Of a file that has values at points and at cells: those at cells.
    """

    variables: Sequence[Variable]
    geometry: Grid | Cloud | Mesh
    length_units: str
    reader: str
    notes: tuple[str, ...] = ()
    at_cells: Source | None = None


def split_units(label: str) -> tuple[str, str]:
    """Split a label such as ``T (K)`` or ``x [mm]`` into name and units."""
    match = re.fullmatch(r"\s*(.*?)\s*(?:\[([^\]]*)\]|\(([^()]*)\))\s*", label)
    if not match or not match[1]:
        return label.strip(), ""
    return match[1], (match[2] or match[3] or "").strip()


def quantity_of(variable: Variable) -> str:
    """The quantity by a variable's name or else by its units; empty if neither shows it."""
    name = variable.name.partition(" @")[0]  # without the parameters of COMSOL's sweeps
    bare = re.sub(r"[\s_]", "", name.rpartition(".")[2]).lower()
    named = next((kind for kind, names in NAMES.items() if bare in names), "")
    if named or unit_of(variable.units, UNITS["index"]):
        return named
    return next((kind for kind, units in UNITS.items() if unit_of(variable.units, units)), "")


def choose(source: Source, name: str | None, quantity: str | None) -> tuple[Source, Variable, str]:
    """Choose the variable to import.

    Parameters
    ----------
    source : Source
        What there is, at its points and at its cells.
    name : str, optional
        The wanted one's name; else the only one whose name or units show the quantity, or the only
        one.
    quantity : str, optional
        A key of `UNITS`; else what the name or the units say.

    Returns
    -------
    source : Source
        Where the variable is: the one that was given, or its `at_cells`.
    variable : Variable
    quantity : str

    Raises
    ------
    InputError
        If there is none, there are several candidates, or nothing shows the quantity.
    """
    sources = [source, *([source.at_cells] if source.at_cells else [])]
    everything = [(where, v) for where in sources for v in where.variables]
    listed = ", ".join(str(v) for _, v in everything)
    if not everything:
        raise InputError("holds no scalar; export the temperature, the density or the index")
    if name is not None:
        found = [(s, v) for s, v in everything if name in (v.name, str(v))]
        if not found:
            raise InputError(f"there is no variable '{name}'; there are: {listed}")
    else:
        kinds = [quantity] if quantity else list(UNITS)
        found = [(s, v) for s, v in everything if quantity_of(v) in kinds] or everything
    names = [v.name for _, v in found]
    where, variable = found[0]
    notes = where.notes
    if len(found) == 2 and names[0] == names[1] and found[1][0] is source.at_cells:
        notes += (f"{variable.name} is given at points and at cells; that at points is taken",)
    elif len(found) > 1 and len(set(names)) == 1:
        raise InputError(f"{len(found)} variables are named '{names[0]}'; rename all but one")
    elif len(found) > 1:
        raise InputError(
            f"{len(found)} variables come into question, {', '.join(str(v) for _, v in found)};"
            f" choose one with --variable, such as --variable '{names[0]}'"
        )
    quantity = quantity or quantity_of(variable)
    if not quantity:
        raise InputError(
            f"what is variable '{variable}'? Say --quantity {', '.join(UNITS)} (index is n itself)"
        )
    return replace(where, notes=notes), variable, quantity


def agreed(
    what: str,
    option: str,
    wanted: str | None,
    said: str,
    known: Sequence[str],
    possible: Callable[[str], bool] = lambda units: True,
) -> str:
    """Units that the option gives or the file says.

    Parameters
    ----------
    what, option : str
        What has the units, and the name of the option, for the messages.
    wanted : str or None
        The option's value.
    said : str
        What the file says; empty if nothing.
    known : sequence of str
        The units that make sense.
    possible : callable
        Whether the values can be in the units that the file says. Where they can't, the option may
        contradict the file.

    Returns
    -------
    str
        One of `known`.

    Raises
    ------
    InputError
        If nobody says, the units are unknown, or the two differ.
    """
    if not (wanted or said):
        raise InputError(
            f"the file does not say the units of {what}; say {option} {' or '.join(known[:2])}"
        )
    units, of_file = unit_of(wanted or said, known), unit_of(said, known)
    if units is None:
        raise InputError(
            f"{what} in '{wanted or said}'? Known are: {', '.join(known)} (see {option})"
        )
    if wanted and of_file and units != of_file and possible(of_file):
        raise InputError(f"the file says that {what} is in {said}; leave {option} {wanted} out")
    return units


def as_lattice(points: np.ndarray) -> tuple[Grid, np.ndarray] | None:
    """Recognise points that lie on the product of three axes.

    Parameters
    ----------
    points : ndarray of shape (N, 3)
        In any order; some nodes may be absent, such as those in a solid, and some there twice.

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
    if len(np.unique(index)) < MOST_MISSING * np.prod([len(a) for a in axes], dtype=float):
        return None
    return Grid((axes[0], axes[1], axes[2])), index


def on_lattice(grid: Grid, index: np.ndarray, values: np.ndarray) -> np.ndarray:
    """Values of `as_lattice`'s points in the grid's shape, NaN at absent nodes."""
    shape = [len(axis) for axis in grid.axes]
    nodes = np.full(np.prod(shape), np.nan, np.result_type(values, np.float32))
    nodes[index] = values
    return nodes.reshape(shape)


def in_order(points: np.ndarray, values: np.ndarray) -> tuple[Grid | Cloud, np.ndarray, list[str]]:
    """Put points onto a lattice if they lie on one, and each once.

    Parameters
    ----------
    points : ndarray of shape (N, 3)
    values : ndarray of shape (N,)
        NaN where there are none; of a point that is there twice, the other value holds.

    Returns
    -------
    geometry : Grid or Cloud
    values : ndarray
    notes : list of str

    Raises
    ------
    InputError
        If one point has two values.
    """
    lattice = as_lattice(points)
    place = lattice[1] if lattice else _same_place(points)
    order = np.argsort(place, kind="stable")
    starts = np.flatnonzero(np.diff(place[order], prepend=-1))
    ordered = np.asarray(values, dtype=np.float64)[order]
    known = ~np.isnan(ordered)
    low = np.minimum.reduceat(np.where(known, ordered, np.inf), starts)
    high = np.maximum.reduceat(np.where(known, ordered, -np.inf), starts)
    count = np.add.reduceat(known.astype(float), starts)
    sums = np.add.reduceat(np.where(known, ordered, 0.0), starts)
    means = np.where(count > 0.0, sums / np.maximum(count, 1.0), np.nan)
    spread = np.where(count > 1.0, high - low, 0.0)
    worst, notes = int(spread.argmax()), []
    if spread[worst] > CONTRADICTION * (np.nanmax(ordered) - np.nanmin(ordered)):
        at = ", ".join(f"{c:g}" for c in points[order[starts[worst]]])
        raise InputError(
            f"the point ({at}) is there with several values, {low[worst]:.6g} to {high[worst]:.6g}:"
            " instants, or cases of a sweep, below each other? Leave the rows of one"
        )
    if spread.any():
        notes.append(
            f"{(spread > 0.0).sum()} points are there several times with values that differ by up"
            f" to {spread.max():.2g}; their means are taken"
        )
    first = order[starts]
    if lattice:
        return lattice[0], on_lattice(lattice[0], place[first], means), notes
    return Cloud(points[first]), means, notes


def _same_place(points: np.ndarray) -> np.ndarray:
    """Number of each point among the distinct ones."""
    order = np.lexsort(points.T)
    new = np.concatenate([[False], (np.diff(points[order], axis=0) != 0.0).any(axis=1)])
    place = np.empty(len(points), dtype=np.int64)
    place[order] = np.cumsum(new)
    return place
