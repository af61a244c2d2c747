"""Bent rays from tables: a straight ray plus a displacement that is smooth in where it goes.

Two maps are tabulated, both through the air alone: they know nothing of the part's shape.

* The camera's.  Through the pixel direction (p, q), its straight line of sight is at (p Z, q Z) at
  the depth Z of the camera frame; the bent one is at (p Z, q Z) + displacement(p, q, Z).
* The laser's, inverted.  The bent laser ray through a point P has the coordinates
  (a0, b0) + shift(a0, b0, depth), where (a0, b0) are those of the straight ray through P.

Only differences from straight rays are stored, so that float32 is exact to a nanometre.
"""

from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import NDArray
from scipy.interpolate import BSpline, NdBSpline

from virtual_sensor.arrays import in_own_memory
from virtual_sensor.engine import dr, mi
from virtual_sensor.medium.spline import bspline_coefficients
from virtual_sensor.optics.eikonal import March, Straight
from virtual_sensor.optics.illumination import Illumination, LaserFrame, LightStatus
from virtual_sensor.optics.sensor_model import LaserLine, Pose
from virtual_sensor.optics.surfaces import SceneSurface

Array = NDArray[np.float64]

_REACH_MM = 0.5  # the last look for a surface reaches so far before and behind the place guessed
_SLACK = 1e-3  # of a cell: points this far out of the grid are still in it, but for rounding


@dataclass(frozen=True)
class Grid:
    """A regular grid in three coordinates.

    Attributes
    ----------
    low, high : ndarray of shape (3,)
        First and last node.
    shape : tuple of three int
        Nodes along each.
    """

    low: Array
    high: Array
    shape: tuple[int, int, int]

    @property
    def spacing(self) -> Array:
        """Distance of nodes, shape (3,)."""
        return (self.high - self.low) / (np.array(self.shape) - 1.0)

    def nodes(self) -> Array:
        """All nodes, (N, 3), the last coordinate fastest."""
        axes = [np.linspace(*x) for x in zip(self.low, self.high, self.shape, strict=True)]
        return np.stack(np.meshgrid(*axes, indexing="ij"), axis=-1).reshape(-1, 3)


class Table:
    """Some functions of three coordinates: cubic B-splines through their values at nodes.

    Parameters
    ----------
    grid : Grid
    values : ndarray of shape (N, C)
        C functions at the grid's nodes.
    """

    def __init__(self, grid: Grid, values: Array) -> None:
        self.grid = grid
        shaped = values.reshape(*grid.shape, -1)
        self._coefficients = bspline_coefficients(shaped, (False, False, False))
        axes = zip(grid.low, grid.spacing, grid.shape, strict=True)
        knots = tuple(low + step * (np.arange(n + 6) - 3.0) for low, step, n in axes)
        self._spline = NdBSpline(knots, self._coefficients, 3, extrapolate=True)

    def at(self, places: Array) -> Array:
        """The functions at places (N, 3): (N, C)."""
        return self._spline(places)

    def slopes(self, axis: int) -> Array:
        """Derivatives of the functions by a coordinate at the nodes, (N, C)."""
        order = [0, 0, 0]
        order[axis] = 1
        return self._spline(self.grid.nodes(), nu=order)

    def finer(self, tolerance: float) -> list[int]:
        """How many times finer along each axis a linear table must be to err by no more.

        The tolerance is for the first two functions, the displacements.
        """
        bends = (np.diff(self._coefficients[..., :2], 2, axis=k) for k in range(3))  # f'' h^2
        share = tolerance / 3.0
        return [max(int(np.ceil(np.sqrt(np.abs(b).max() / 8.0 / share))), 1) for b in bends]

    def linear(self, finer: list[int]) -> "LinearTable":
        """The same functions for Dr.Jit, linear on a grid so many times finer along each axis."""
        values, shape = self._coefficients.astype(np.float32), list(self.grid.shape)
        for axis in np.argsort(shape):  # the longest last: the others stay short meanwhile
            nodes = shape[axis]
            at = np.linspace(0.0, nodes - 1.0, finer[axis] * (nodes - 1) + 1)
            matrix = BSpline.design_matrix(at, np.arange(nodes + 6) - 3.0, 3).astype(np.float32)
            along = np.moveaxis(values, axis, 0)
            fine = matrix @ along.reshape(len(along), -1)
            values = np.moveaxis(fine.reshape(-1, *along.shape[1:]), 0, axis)
            shape[axis] = at.size
        grid = Grid(self.grid.low, self.grid.high, (shape[0], shape[1], shape[2]))
        return LinearTable(grid, values)


class LinearTable:
    """Some functions of three coordinates in Dr.Jit, linear between their values at nodes.

    Cheaper than splines, and quick to compile.

    Parameters
    ----------
    grid : Grid
    values : ndarray of shape (n0, n1, n2, C)
        C functions at the grid's nodes.
    """

    def __init__(self, grid: Grid, values: NDArray[np.floating]) -> None:
        self.grid = grid
        flat = in_own_memory(values, mi.Float)
        tensor = mi.TensorXf(flat, values.shape)
        self._texture = mi.Texture3f(tensor, use_accel=False, wrap_mode=dr.WrapMode.Clamp)
        # Texel centres are at (i + 1/2) / N.  Opaque: one kernel for any grid.
        nodes = np.array(grid.shape)
        self._low, self._scale, self._first = (
            dr.opaque(mi.Array3f(*np.asarray(v, float).tolist()))
            for v in (grid.low, 1.0 / (nodes * grid.spacing), 0.5 / nodes)
        )

    def at(self, place: Any) -> list[Any]:
        """The functions at places, float32; beyond the grid as at its border."""
        u = dr.fma(mi.Array3f(place) - self._low, self._scale, self._first)
        return self._texture.eval(mi.Point3f(u.z, u.y, u.x))

    def holds(self, place: Any) -> Any:
        """Which places lie on the grid."""
        u = dr.fma(mi.Array3f(place) - self._low, self._scale, self._first)
        slack = _SLACK * self._first
        return dr.all((u >= self._first - slack) & (u <= 1.0 - self._first + slack))


@dataclass(frozen=True)
class CameraMap:
    """Bent lines of sight of a pinhole camera.

    Attributes
    ----------
    pose : Pose
        Of the projection centre; z forward.
    table : LinearTable
        Of (p, q, Z): displacement in mm along the camera's x and y at the depth Z, and its
        derivative by Z.
    """

    pose: Pose
    table: LinearTable

    def seen(self, surface: SceneSurface, ray: Any, march: March) -> "Seen":
        """Where bent lines of sight meet a surface.

        A straight look tells about where; the bent ray's tangent there, where nearly; the tangent
        at this place, where.

        Parameters
        ----------
        surface : SceneSurface
        ray : mi.Ray3f
            Straight rays of the camera.
        march : March
            Its precision says how finely places are told.
        """
        frame = [dr.opaque(mi.Array3f(*map(float, self.pose.rotation[:, k]))) for k in range(3)]
        centre = dr.opaque(mi.Array3f(*map(float, self.pose.origin_mm)))
        line = Straight.through(ray.o, ray.d, march)
        direction = mi.Array3f(line.direction)
        ahead = dr.dot(direction, frame[2])
        p, q = dr.dot(direction, frame[0]) / ahead, dr.dot(direction, frame[1]) / ahead
        anchor = mi.Array3f(line.anchor)
        depth_0 = dr.dot(anchor - centre, frame[2])
        grid = self.table.grid
        near, far = (dr.opaque(mi.Float, float(z)) for z in (grid.low[2], grid.high[2]))

        def tangent(t: Any) -> tuple[Any, Any, Any]:
            """Place and unit heading of the bent ray beside the straight one at t."""
            depth = dr.fma(t, ahead, depth_0)
            place = mi.Array3f(p, q, depth)
            x, y, along_x, along_y = self.table.at(place)
            position = line.anchor + line.direction * t + frame[0] * x + frame[1] * y
            heading = direction + (frame[0] * along_x + frame[1] * along_y) * ahead
            return position, dr.normalize(heading), place

        start = mi.Float(line.start)
        met = surface.distance(mi.Array3f(ray.o), direction, dr.inf, True)
        t = dr.select(dr.isfinite(met), start + met, ((near + far) * 0.5 - depth_0) / ahead)
        position, heading, _ = tangent(t)
        # From before all that can be seen, but not from behind the camera.
        back = dr.minimum(dr.maximum(t - (near - depth_0) / ahead, 0.0) + _REACH_MM, t - start)
        met = surface.distance(position - heading * back, heading, dr.inf, True)
        hit = dr.isfinite(met)
        t = dr.select(hit, t + met - back, t)
        position, heading, place = tangent(t)
        begin = position - heading * _REACH_MM
        met = surface.distance(begin, heading, 2.0 * _REACH_MM, hit)
        met_again = dr.isfinite(met)
        point = begin + heading * dr.select(met_again, met, 0.0)
        return Seen(point, heading, hit & met_again, hit & ~met_again, ~self.table.holds(place))


@dataclass
class Seen:
    """What bent lines of sight meet; Dr.Jit arrays over the rays.

    Attributes
    ----------
    point : vector
        World, mm.
    heading : vector
        Unit direction of the line of sight there.
    hit : mask
    lost : mask
        Rays that seemed to meet it at first and then did not, as they do at edges.
    off : mask
        Rays off the table's grid.
    """

    point: Any
    heading: Any
    hit: Any
    lost: Any
    off: Any


@dataclass(frozen=True)
class LaserMap:
    """The bent laser ray through a point.

    Attributes
    ----------
    laser : LaserLine
    table : LinearTable
        Of (a0, b0, depth), the straight ray's coordinates and the depth behind the reference
        plane, in mm: shift of a and b in mm, slope of the ray across and along beside the straight
        one's, and the determinant of d(a, b) / d(a0, b0), minus one.
    """

    laser: LaserLine
    table: LinearTable

    def light(self, surface: SceneSurface, point: Any, active: Any) -> tuple[Illumination, Any]:
        """Light at points, and which of them the table does not tell of.

        A shadow is looked for along the chord from where the ray comes among the shapes.
        """
        frame = LaserFrame.of(self.laser, mi.Array3f).opaque()
        point = mi.Array3f(point)
        a0, b0 = frame.straight(point)
        depth = frame.coordinates(point)[2]
        place = mi.Array3f(a0, b0, depth)
        shift_a, shift_b, across, along, more = self.table.at(place)

        def direction(across: Any, along: Any) -> Any:
            slope = frame.axis + frame.across * across
            return dr.normalize(slope + frame.along * (along + frame.fan_per_mm * b0))

        heading = direction(across, along)
        low, high = (dr.opaque(mi.Array3f(c)) for c in surface.corners)
        room = dr.select(heading > 0.0, point - low, high - point)
        room = dr.min(dr.abs(room) / dr.maximum(dr.abs(heading), 1e-6)) + _REACH_MM
        middle = point - heading * (0.5 * room)
        halfway = mi.Array3f(*frame.straight(middle), frame.coordinates(middle)[2])
        chord = direction(*self.table.at(halfway)[2:4])
        lift = dr.minimum(0.1, room)
        met = surface.distance(
            point - chord * room, chord, room - dr.opaque(mi.Float, 0.05), active & (room > lift)
        )
        shadowed = active & dr.isfinite(met)
        status = dr.select(shadowed, int(LightStatus.SHADOWED), int(LightStatus.LIT))
        status = dr.select(active, status, int(LightStatus.NO_POINT))
        lit = active & ~shadowed
        spread = (1.0 + frame.fan_per_mm * depth) * dr.dot(frame.axis, heading)
        light = Illumination(
            dr.select(lit, a0 + shift_a, dr.nan),
            dr.select(lit, b0 + shift_b, dr.nan),
            heading,
            (shift_a, shift_b),
            None,
            dr.select(lit, (1.0 + more) / spread, 0.0),
            mi.UInt32(status),
        )
        return light, active & ~self.table.holds(place)
