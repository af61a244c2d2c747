"""The refractivity of air on a regular grid, as a smooth function of position.

Between the nodes the field is the cubic spline through them (continuous up to its second
derivative), evaluated by Dr.Jit; `simplified` gives cruder ones to compare with. It holds the
difference from the surrounding air, which float32 resolves far better than n, and ends at the
grid's border: what is left there is a jump in n.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, field, replace
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import ArrayLike

from virtual_sensor.arrays import (
    LARGEST,
    SMALLEST,
    number_within,
    numbers_of,
    one_of,
    to_vectors,
    unmasked,
    whole_number,
)
from virtual_sensor.calls import public
from virtual_sensor.display import listed, place, span
from virtual_sensor.engine import mi
from virtual_sensor.errors import InputError, naming, short
from virtual_sensor.files import path_of
from virtual_sensor.medium.evaluated import Evaluated
from virtual_sensor.medium.find_field import find_field
from virtual_sensor.medium.lookups import SPLINES, GridLookup
from virtual_sensor.medium.netcdf import GriddedQuantity, read_field_file, write_quantity
from virtual_sensor.medium.netcdf_elements import check_box
from virtual_sensor.medium.quantities import AMBIENT_LIMITS, check_limits
from virtual_sensor.medium.solid import fill_solid
from virtual_sensor.medium.spline import MIN_NODES
from virtual_sensor.medium.units import ATMOSPHERE_PA, LEAST_PA, MOST_PA, PRESSURES
from virtual_sensor.poses import Pose
from virtual_sensor.records import vectors

_SAME_BORDER = 0.01  # of the field's range: so much a border may vary that is the ambient air's


@public
@dataclass(frozen=True, eq=False)
class IndexField(Evaluated):
    """Refractivity on a regular grid, in surroundings of uniform air.

    Build one with `from_arrays` or `read`.

    Attributes
    ----------
    nodes : ndarray of shape (nx, ny, nz)
        n - 1 at the nodes.
    origin, spacing : ndarray of shape (3,)
        Position of node [0, 0, 0] in the field's frame, and the distance of nodes, mm.
    ambient : float
        n - 1 of the surrounding air, also outside the box.
    mirror : tuple of three bool
        Whether the field is even about the plane through an axis's first node.
    pressure_pa : float
        Of the surrounding air, Pa; 1 atm where nobody says.
    source : str
        Where the field comes from, in words.
    interpolation : str
        "cubic" or "linear", between the nodes.
    dimensions : int
        3, or 2 for a field that does not vary along x.
    notes : tuple of str
        What of its file is ignored.
    pose : Pose or None
        Of the field's frame, after `moved`; None: it is the world's.
    solid : ndarray of bool of shape (nx, ny, nz) or None
        True at the nodes inside the solid, whose values are made up; None: not known.
    """

    nodes: np.ndarray
    origin: np.ndarray
    spacing: np.ndarray
    ambient: float
    mirror: tuple[bool, ...]
    source: str = ""
    interpolation: str = "cubic"
    dimensions: int = 3
    notes: tuple[str, ...] = ()
    pose: Pose | None = None
    solid: np.ndarray | None = None
    pressure_pa: float = ATMOSPHERE_PA
    _lookups: dict[tuple[str, str], GridLookup] = field(default_factory=dict, repr=False)
    _parts: tuple[tuple[float, IndexField], ...] = field(default=(), repr=False)

    def _line(self) -> str:
        low, high = self.box
        nodes, ambient = " x ".join(map(str, self.shape)), f"ambient {self.ambient:.4g}"
        where = f"from {place(low)} to {place(high)} mm"
        moved = "moved" if self.pose else ""
        return listed(f"{nodes} nodes", where, span("n - 1", self.nodes), ambient, moved)

    def _columns(self) -> dict[str, Any]:
        at = np.indices(self.shape).reshape(3, -1).T
        points = self.to_world(self.origin + at * self.spacing)
        return {**vectors("point_mm", points, "xyz"), "refractivity": self.nodes.ravel()}

    @classmethod
    @public
    def from_arrays(
        cls,
        refractivity: ArrayLike,
        origin_mm: ArrayLike,
        spacing_mm: ArrayLike,
        *,
        ambient: float | None = None,
        mirror: Sequence[bool] = (False, False, False),
        solid: ArrayLike | None = None,
        pressure_pa: float = ATMOSPHERE_PA,
        source: str = "",
    ) -> IndexField:
        """Make a field of values at grid nodes.

        Parameters
        ----------
        refractivity : array_like of shape (nx, ny, nz)
            n - 1 at the nodes, at least four along each axis. Finite, except inside the solid.
        origin_mm, spacing_mm : array_like of shape (3,)
            Position of node [0, 0, 0], and the distance of nodes, mm.
        ambient : float, optional
            n - 1 of the surrounding air; by default that of the field's border, which must then
            have the same all round, within 1 % of what the field varies by.
        mirror : sequence of three bool
            True: the field is even about the plane through this axis's first node.
        solid : array_like of bool of shape (nx, ny, nz), optional
            True inside the solid, where the values are replaced (`fill_solid`).
        pressure_pa : float
            Of the surrounding air, Pa: what `at_pressure` compares with.
        source : str
            Where the field comes from, in words.

        Raises
        ------
        InputError
            If a shape or a value is unfit.
        """
        nodes = numbers_of("refractivity", refractivity)
        origin, spacing = numbers_of("origin_mm", origin_mm), numbers_of("spacing_mm", spacing_mm)
        if nodes.ndim != 3 or min(nodes.shape) < MIN_NODES:
            raise InputError(
                f"a field needs at least {MIN_NODES} nodes along each of x, y and z; "
                f"this refractivity has the shape {nodes.shape}"
            )
        if origin.shape != (3,) or spacing.shape != (3,) or unmasked(mirror).shape != (3,):
            raise InputError("origin_mm, spacing_mm and mirror need three entries each: x, y, z")
        if not (np.isfinite(origin).all() and np.isfinite(spacing).all() and (spacing > 0).all()):
            raise InputError("origin_mm must be finite, and spacing_mm finite and positive")
        check_box(origin, spacing, nodes.shape)
        if solid is not None:
            solid = unmasked(solid).astype(bool)
            nodes = fill_solid(nodes, solid, spacing)

        missing = ~np.isfinite(nodes)
        if missing.any():
            raise InputError(
                f"{missing.sum()} nodes have no finite value, the first is "
                f"{np.argwhere(missing)[0].tolist()}; give them one, or mark those that lie in the "
                "solid (`solid`, 1 there and 0 in the air)"
            )
        remedy = (
            "give n - 1, some 2.7e-4 of air, not n, and no temperature (vs.air_refractivity makes"
            " n - 1 of it)"
        )
        check_limits("refractivity", nodes, "refractivity", remedy)
        even = tuple(bool(m) for m in mirror)
        if ambient is None:
            ambient = _ambient_of(nodes, even)
        low, high, _ = AMBIENT_LIMITS["ambient_refractivity"]
        number_within("ambient", ambient, low, high, "n - 1 of the surrounding air")
        low, high, _ = AMBIENT_LIMITS["ambient_pressure"]
        pressure = number_within("pressure_pa", pressure_pa, low, high, "it in Pa, as 101325")
        marked = solid if solid is not None and solid.any() else None
        for array in (nodes, origin, spacing, *([] if marked is None else [marked])):
            array.flags.writeable = False
        around = float(ambient), even, source
        return cls(nodes, origin, spacing, *around, solid=marked, pressure_pa=pressure)

    @classmethod
    @public
    def read(
        cls,
        path: str | Path,
        *,
        wavelength_nm: float = 532.0,
        mirror: Sequence[bool] | None = None,
        time_s: float | None = None,
    ) -> IndexField:
        """Read one instant of a NetCDF-3 file of temperature, density or refractivity.

        Parameters
        ----------
        path : str or Path
            The file; or the name of a field that comes with the program, such as
            "hot_cylinder_1250C_quarter". `virtual_sensor.medium.netcdf` describes what is in one.
        wavelength_nm : float
            Vacuum wavelength at which temperature or density become n - 1.
        mirror : sequence of three bool, optional
            Overrides what the file says about mirror planes.
        time_s : float, optional
            Flow time, s, of a file with a time axis; between its instants the stored quantity is
            interpolated linearly. The last instant by default.

        Raises
        ------
        InputError
            If the file cannot be used; the message names the file, the element and the remedy.
        """
        number_within("wavelength_nm", wavelength_nm, SMALLEST, LARGEST, "the light's in nm")
        if time_s is not None and numbers_of("time_s", time_s).shape:
            raise InputError(f"time_s is {short(time_s)}; give one time in s, or leave it out")
        if mirror is not None and numbers_of("mirror", mirror).shape != (3,):
            raise InputError(f"mirror is {short(mirror)}; give True or False for x, y and z")
        path = find_field(path)
        f = read_field_file(path, wavelength_nm, mirror, time_s)
        said = {name: value for name, value in vars(f).items() if name != "notes"}
        with naming(path):
            return replace(cls.from_arrays(**said), notes=f.notes)

    def __getstate__(self) -> dict[str, object]:
        """What is pickled: all but Dr.Jit's memory."""
        return vars(self) | {"_lookups": {}, "_parts": ()}

    @public
    def write(self, path: str | Path) -> None:
        """Write the field as a NetCDF-3 file that `read` takes back, all of it or nothing.

        Raises
        ------
        InputError
            If the folder does not exist, n - 1 is 0.9 or more, or the field is turned.
        """
        path = path_of("write: path", path)
        if not np.array_equal(self.axes(), np.eye(3)):
            raise InputError(
                f"{path}: a field file's axes are the world's, and this field is turned; write it"
                " before it is moved, and move what is read (IndexField.moved)"
            )
        quantity = GriddedQuantity(
            "refractivity",
            self.nodes,
            self.to_world(self.origin),
            self.spacing,
            ambient={"ambient_refractivity": self.ambient, "ambient_pressure": self.pressure_pa},
            mirror=self.mirror,
            solid=self.solid,
            attributes={"source": self.source} if self.source else {},
        )
        write_quantity(path, quantity, packed=False)

    def with_nodes(
        self,
        refractivity: ArrayLike,
        origin_mm: ArrayLike | None = None,
        spacing_mm: ArrayLike | None = None,
        *,
        solid: ArrayLike | None = None,
        source: str = "",
    ) -> IndexField:
        """Other values, on the same grid or another one, with what else the field has.

        Surroundings, mirror planes and pose stay; see `from_arrays` for the rest.
        """
        made = self.from_arrays(
            refractivity,
            self.origin if origin_mm is None else origin_mm,
            self.spacing if spacing_mm is None else spacing_mm,
            ambient=self.ambient,
            mirror=self.mirror,
            solid=solid,
            pressure_pa=self.pressure_pa,
            source=source,
        )
        return replace(made, pose=self.pose)

    @public
    def at_pressure(self, pressure_pa: float) -> IndexField:
        """The same flow in air of another pressure: n - 1 goes with it, of the surroundings too.

        A real flow changes a little: denser air is driven harder. What is simulated at a pressure
        (`virtual-sensor field simulate --pressure`) has that, too.

        Parameters
        ----------
        pressure_pa : float
            10e3 to 140e3 Pa; that of the field: the same object.

        Raises
        ------
        InputError
            If it is none of air's.
        """
        pressure = number_within("pressure_pa", pressure_pa, LEAST_PA, MOST_PA, PRESSURES)
        if pressure == self.pressure_pa:
            return self
        denser = pressure / self.pressure_pa
        kind = self.interpolation, self.dimensions
        whole = [(denser, self)]
        made = IndexField.sum_of(whole, ambient=denser * self.ambient, source=self.source)
        made = replace(made, pressure_pa=pressure, solid=self.solid, notes=self.notes)
        return made if kind == ("cubic", 3) else made.simplified(*kind)

    @staticmethod
    def sum_of(
        parts: Sequence[tuple[float, IndexField]],
        *,
        ambient: float | None = None,
        stretch: ArrayLike = (1.0, 1.0, 1.0),
        source: str = "",
    ) -> IndexField:
        """Weighted sum of what fields on one grid differ by from their surroundings.

        It has mirror planes and pose of the first. A ray finds its way in it at once: the sum of
        the splines is that of their coefficients.

        Parameters
        ----------
        parts : sequence of (float, IndexField)
            Weights and fields.
        ambient : float, optional
            n - 1 of the surroundings; by default that of the first field.
        stretch : array_like of shape (3,)
            Factors along x, y and z, about the origin of the fields' frame.
        source : str
            Where it comes from, in words.
        """
        first = parts[0][1]
        around = first.ambient if ambient is None else ambient
        nodes = first.nodes
        if ambient is not None or [weight for weight, _ in parts] != [1.0]:
            nodes = np.full(first.shape, around)
            for weight, each in parts:
                nodes += weight * (each.nodes - each.ambient)
        made = IndexField.from_arrays(
            nodes,
            first.origin * np.asarray(stretch),
            first.spacing * np.asarray(stretch),
            ambient=around,
            mirror=first.mirror,
            pressure_pa=first.pressure_pa,
            source=source,
        )
        smooth = all((each.interpolation, each.dimensions) == ("cubic", 3) for _, each in parts)
        return replace(made, pose=first.pose, _parts=tuple(parts) if smooth else ())

    @public
    def simplified(self, interpolation: str = "cubic", dimensions: int = 3) -> IndexField:
        """Give the same nodes seen more simply: what a cruder model of the air would make of them.

        It is to be the last that is done to a field: what makes another one of its nodes, or
        reads it again from a file, gives a cubic field in three dimensions.

        Parameters
        ----------
        interpolation : str
            "cubic"; or "linear", that of the value along each axis. Its gradient jumps from cell
            to cell, and no ray through it is accurate whatever the step.
        dimensions : int
            3; or 2: the section x = 0 of the field's frame, whatever x is. Rays then keep their
            slope along x.

        Raises
        ------
        InputError
            If there is no such field.
        """
        one_of("interpolation", interpolation, SPLINES)
        whole_number("dimensions", dimensions, 2, 3)
        low, high = self.box[:, 0]
        if dimensions == 2 and not low <= 0.0 <= high:
            raise InputError(
                f"dimensions 2: the field, from x = {low:g} to {high:g} mm, has no section x = 0"
            )
        return replace(
            self, interpolation=interpolation, dimensions=dimensions, _lookups={}, _parts=()
        )

    def _section(self) -> np.ndarray:
        """Difference from ambient at the nodes of the section x = 0; shape (ny, nz)."""
        y, z = (self.origin[i] + self.spacing[i] * np.arange(self.shape[i]) for i in (1, 2))
        points = np.stack(np.meshgrid(0.0, y, z, indexing="ij"), axis=-1).reshape(-1, 3)
        whole = self.simplified(self.interpolation, 3).lookup("double")
        return whole.delta(to_vectors(points)).numpy().reshape(self.shape[1:])

    @property
    def shape(self) -> tuple[int, ...]:
        """Numbers of nodes (nx, ny, nz), mirrored parts not counted."""
        return self.nodes.shape

    @property
    def box(self) -> np.ndarray:
        """Lowest and highest corner in the field's frame, mirrored parts included: (2, 3), mm."""
        size = (np.array(self.shape) - 1) * self.spacing
        return np.array([self.origin - np.where(self.mirror, size, 0.0), self.origin + size])

    def border_jump(self) -> np.ndarray:
        """Largest jump of n across each face of the box, where it should have faded to zero.

        Returns
        -------
        ndarray of shape (6,)
            Largest abs(n - n_ambient) on the faces x-, x+, y-, y+, z-, z+; a face that is the
            mirror image of another has the other's.
        """
        difference = abs(self.nodes - self.ambient)
        return np.array(
            [
                difference.take(node, axis).max()
                for axis, even in enumerate(self.mirror)
                for node in (-1 if even else 0, -1)
            ]
        )

    def lookup(self, precision: str) -> GridLookup:
        """Return the field in Dr.Jit memory, for the code that marches rays; made only once."""
        key = (precision, mi.variant())
        if key not in self._lookups and self._parts:
            parts = [(weight, each.lookup(precision)) for weight, each in self._parts]
            self._lookups[key] = GridLookup.sum_of(parts, self.origin, self.spacing)
        elif key not in self._lookups:
            axes = (0, 1, 2)[3 - self.dimensions :]
            delta = self.nodes - self.ambient if self.dimensions == 3 else self._section()
            where = self.origin, self.spacing, self.mirror, axes
            self._lookups[key] = GridLookup(delta, *where, self.interpolation, precision)
        return self._lookups[key]


def border_of(nodes: np.ndarray, mirror: Sequence[bool]) -> np.ndarray:
    """Values (N,) at the nodes (nx, ny, nz) of a field's border; a plane of symmetry is none."""
    faces = [
        nodes.take(node, axis).ravel()
        for axis, even in enumerate(mirror)
        for node in ([-1] if even else [0, -1])
    ]
    return np.concatenate(faces)


def _ambient_of(nodes: np.ndarray, mirror: Sequence[bool]) -> float:
    """The one value of a field's border, where nobody says what surrounds it."""
    border = border_of(nodes, mirror)
    low, high = border.min(), border.max()
    if high - low > _SAME_BORDER * (nodes.max() - nodes.min()):
        raise InputError(
            f"ambient is missing: n - 1 of the surrounding air can't be told from the field's"
            f" border, where it is {low:.4g} to {high:.4g}; give it, such as"
            f" ambient={np.median(border):.4g}"
        )
    return float(np.median(border))


def field_of(name: str, given: Any, wavelength_nm: float = 532.0) -> Any:
    """A field that a caller gives: itself, one to be read by its path or name, or None.

    Raises
    ------
    InputError
        Naming it, if it is none, or can't be read.
    """
    if isinstance(given, str | Path):
        return IndexField.read(given, wavelength_nm=wavelength_nm)
    if given is not None and not hasattr(given, "lookup"):
        raise InputError(
            f"{name} is {short(given)}; give an IndexField, such as scene.medium, or its file"
        )
    return given
