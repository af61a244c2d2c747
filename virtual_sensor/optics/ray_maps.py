"""Ray maps: a family's bent rays through a medium, tabulated over a box of (s, t, depth).

*Forward*: at a depth, the bent ray (s, t) is beside the straight one by a displacement (x, y) in mm
of the family's frame, and runs at another slope.  *Inverse*: the bent ray through the point where
the straight ray (s0, t0) is at a depth has the coordinates (s0, t0) + shift.  Both know nothing of
any part's shape.  Only differences from straight rays are stored, so that float32 is exact to a
nanometre.

A map is made to a tolerance.  Rays along lines through the box show about how many nodes each
coordinate needs; rays are marched to some depths, with cubics between them, and between the nodes,
and the grid is refined along the axes that need it.  The inverse is found at the nodes of its own
grid from the forward map by Newton's method, and checked by marching.

Where a map folds (a caustic), two rays of the family pass through a point: there is no inverse map
of such a box, and the forward one marks the places.
"""

from collections.abc import Callable
from dataclasses import dataclass, replace
from functools import cached_property, lru_cache
from typing import Any

import numpy as np
from numpy.typing import NDArray
from scipy.interpolate import CubicHermiteSpline, CubicSpline

from virtual_sensor.arrays import by_rows, determinant, solved, to_scalars, to_vectors
from virtual_sensor.display import Displayed
from virtual_sensor.engine import dr, mi
from virtual_sensor.optics.eikonal import Field, March, Straight, bend, in_plane
from virtual_sensor.optics.family_frames import FamilyFrame
from virtual_sensor.optics.grid_tables import Grid, LinearTable, SplineTable
from virtual_sensor.optics.ray_families import RayFamily
from virtual_sensor.optics.ray_status import RayStatus
from virtual_sensor.optics.surfaces import NoSurface
from virtual_sensor.statuses import StatusEnum

Array = NDArray[np.float64]

_SPLINE = 0.6  # of the tolerance is for the splines; the rest for linear interpolation of them
_FORWARD = 0.75  # of an inverse map's share is for the forward one that it is made from
_FEWEST = 4  # nodes of a cubic spline that ends in no knot
_FEWEST_CELLS, _PER_CELL = np.array([3, 3, 1]), np.array([1, 1, 3])  # marched ones, and nodes
_ALONG = 193, 193, 17  # rays of a line along s, t and depth: they show how fine a first grid is
_LEAST_FIRST, _MOST_FIRST, _MOST_NODES, _MOST_LINEAR_NODES = 1_500, 30_000, 250_000, 10_000_000
_MOST_FIRST_ALONG = 500
_MANY = 20_000  # nodes, whose rays are marched once through all depths
_LEVELS = 8
_PATIENCE = 2.5  # grids are refined as if errors were so many times larger than was seen
_STRETCH = 2e-4  # error of derivatives by s and t, mm per mm: light is concentrated by them
_CHECKS = 96  # rays between the nodes of each axis, and as many anywhere
_SETTLED = 0.03  # of the tolerance: what is left when a ray through a point is found
_MOST_STEPS = 12
_SLOW = 0.1  # of the miss before: a step of Newton's that leaves more has old derivatives
_ROOM = 1.3  # times the shifts that were seen: an inverse map's forward one reaches so far beyond
_MOST_PADS = 4


class NoMapError(Exception):
    """Why there is no map that can be trusted."""


class CausticError(NoMapError):
    """The map folds: two rays of the family pass through one point of its box."""


class MapStatus(StatusEnum):
    """What a map says of a place."""

    OK = 0, "The values are within the map's error."
    OFF = (
        1,
        "The place is not in the map's box, or the ray through it is not: march this ray instead.",
    )
    FOLDED = 2, "At or beyond a caustic, where more than one ray may pass: leave this place out."


@dataclass(frozen=True)
class RayPoints(Displayed):
    """Points on bent rays.

    Attributes
    ----------
    point_mm, direction : ndarray of shape (N, 3)
        World; unit vectors along the rays.  NaN where they are off the map.
    status : ndarray of shape (N,)
        `MapStatus`; a point beyond a caustic is on its ray none the less.
    """

    point_mm: Array
    direction: Array
    status: NDArray[np.uint8]


@dataclass(frozen=True)
class PointRays(Displayed):
    """The bent rays through points.

    Attributes
    ----------
    coordinates : ndarray of shape (N, 2)
        (s, t) of the rays; NaN unless OK.
    direction : ndarray of shape (N, 3)
        Unit vectors along the rays in the points, world; NaN unless OK.
    status : ndarray of shape (N,)
        `MapStatus`.
    """

    coordinates: Array
    direction: Array
    status: NDArray[np.uint8]


@dataclass(frozen=True, eq=False)
class RayMap(Displayed):
    """What both directions have in common.

    Attributes
    ----------
    family : RayFamily
    table : SplineTable
        Of (s, t, depth).
    error_mm : float
        Of `table`: the largest of all rays marched between its nodes.
    linear_mm : float
        What linear interpolation may add in `linear`.
    largest_mm : float
        Largest displacement at the nodes.
    """

    family: RayFamily
    table: SplineTable
    error_mm: float
    linear_mm: float
    largest_mm: float

    @property
    def nodes(self) -> tuple[int, int, int]:
        """Nodes of the splines along s, t and depth."""
        return self.table.grid.shape

    def at(self, places: Array) -> Array:
        """What is tabulated at places (N, 3) of (s, t, depth): (N, C); NaN off the box."""
        held = self.table.grid.holds(places)
        values = np.full((len(places), self.table.functions), np.nan)
        values[held] = self.table.at(places[held])
        return values

    def _units(self) -> tuple[float, float]:
        """What one mm of error is in the two first functions' units, at least."""
        return 1.0, 1.0

    @property
    def linear(self) -> LinearTable:
        """The same for Dr.Jit, good to `error_mm` + `linear_mm`; made when first asked for.

        Raises
        ------
        NoMapError
            If it would have too many nodes.
        """
        cubic, finer = self._finer
        shape = [k * (n - 1) + 1 for k, n in zip(finer, self.nodes, strict=True)]
        if np.prod(shape, dtype=float) > _MOST_LINEAR_NODES:
            raise NoMapError(
                f"a table within {self.linear_mm:.1e} mm would have {' x '.join(map(str, shape))}"
                " nodes"
            )
        return self.table.linear(cubic, finer)

    @cached_property
    def _finer(self) -> tuple[int, list[int]]:
        return self.table.finer(self.linear_mm * np.array(self._units()))

    @property
    def linear_error_mm(self) -> float:
        """What the errors of `linear` are at most: none where light runs straight."""
        return self.error_mm + self.linear_mm if self.largest_mm else 0.0


@dataclass(frozen=True, eq=False)
class ForwardMap(RayMap):
    """Where a family's bent rays are at depths.

    `table` has four functions: the displacement from the straight ray along the frame's x and y, in
    mm, and its derivatives by the depth.
    """

    def points(self, places: Array) -> RayPoints:
        """Points on the rays (s, t) at depths, of places (N, 3)."""
        held = self.table.grid.holds(places)
        moved, jacobian = self._bent(places[held])
        point, direction = np.full((2, len(places), 3), np.nan)
        point[held], direction[held] = self._lines(places[held], moved)
        status = np.full(len(places), MapStatus.OFF, np.uint8)
        folded = self._folded(places[held], jacobian)
        status[held] = np.where(folded, MapStatus.FOLDED, MapStatus.OK)
        return RayPoints(point, direction, status)

    def lines(self, places: Array) -> tuple[Array, Array]:
        """Points and unit directions (N, 3), world, as `points` has them; off the box guesses."""
        return self._lines(places, self.table.at(places))

    def _lines(self, places: Array, moved: Array) -> tuple[Array, Array]:
        place, slope = along(self.family, places, moved)
        return self.family.pose.to_world(place), _unit(slope @ self.family.pose.rotation.T)

    def rays(self, points_mm: Array) -> PointRays:
        """The bent rays through world points (N, 3), by Newton's method on the splines.

        It works beside a caustic too, where there is no `InverseMap`.
        """
        places = self.family.coordinates(points_mm)
        found = self._through(places, *self._bent(places))
        off = ~self.table.grid.holds(found.start)
        status = np.where(off, MapStatus.OFF, MapStatus.OK)
        status = np.where(found.folded | (found.missed & ~off), MapStatus.FOLDED, status)
        ok = status == MapStatus.OK
        start = np.where(ok[:, None], found.start, np.nan)
        _, direction = self._lines(start, found.moved)
        return PointRays(start[:, :2], direction, status.astype(np.uint8))

    def jacobian(self, places: Array) -> Array:
        """d(x, y)/d(s, t) in mm of the bent rays at places (N, 3): (N, 2, 2)."""
        return self._bent(places)[1]

    def _bent(self, places: Array) -> tuple[Array, Array]:
        """The table (N, 4) and `jacobian` (N, 2, 2) at places (N, 3)."""
        moved, by_s, by_t = self.table.with_slopes(places)
        return moved, _jacobian(self.family, places, by_s, by_t)

    def missed_mm(self, places: Array, marched: Callable[[Array], Array]) -> Array:
        """How far (N,) the map is beside marched rays (`displaced`) at places (N, 3)."""
        moved = self.table.at(places, 2)
        return np.asarray(np.linalg.norm(moved - marched(places)[:, :2], axis=1))

    def _folded(self, places: Array, jacobian: Array) -> NDArray[np.bool_]:
        """Where tubes of bent rays are turned over beside straight ones: beyond a fold, or a focus.

        Of the matrix that makes bent ones of straight ones both eigenvalues are positive, or have a
        positive real part, until a fold; a focus turns both over, which leaves the area positive.
        """
        x_s, x_t, y_s, y_t = self.family.by_coordinates(*places.T)
        spread = self.family.spread(*places.T)
        entries = jacobian.reshape(-1, 4).T
        a, b, c, d = entries
        trace = (y_t * a - x_t * c - y_s * b + x_s * d) / spread
        return np.asarray((determinant(entries) / spread <= 0.0) | (trace <= 0.0))

    def _turned(self, places: Array, jacobian: Array) -> NDArray[np.bool_]:
        """Where tubes are known to be turned over: only the map's own places show it."""
        return self.table.grid.holds(places) & self._folded(places, jacobian)

    def _through(self, places: Array, moved: Array, jacobian: Array) -> "_Through":
        """The bent rays through where straight ones are, by Newton's method.

        `moved` and `jacobian` are those of the bent rays at the places, to start with.
        """
        start, moved, jacobian = places.copy(), moved.copy(), jacobian.copy()
        settled_mm = _SETTLED * self.error_mm if self.error_mm else 1e-9
        wanted = _straight(self.family, places)
        folded = self._turned(places, jacobian)
        before = np.full(len(places), np.inf)
        for _ in range(_MOST_STEPS):
            away = wanted - _straight(self.family, start) - moved[:, :2]
            miss = np.abs(away).max(axis=1)
            missed = ~(miss < settled_mm)
            go = missed & ~folded
            if not go.any():
                break
            slow = go & ~(miss < _SLOW * before)  # derivatives of close by do, while they do
            if slow.any() and np.isfinite(before).all():
                jacobian[slow] = self.jacobian(start[slow])
                folded[slow] |= self._turned(start[slow], jacobian[slow])
            before = miss
            some = slice(None) if go.all() else go
            here = jacobian[some].reshape(-1, 4).T
            start[some, :2] += np.stack(solved(here, *away[some].T), axis=1)
            moved[some] = self.table.at(start[some])
        jacobian = self.jacobian(start)
        return _Through(start, moved, jacobian, folded | self._turned(start, jacobian), missed)


@dataclass(frozen=True)
class _Through:
    """The bent rays through places.

    Attributes
    ----------
    start : ndarray of shape (N, 3)
        (s, t) of the rays, and the depth.  Off the map they are guesses: splines extrapolate.
    moved : ndarray of shape (N, 4)
        The map there.
    jacobian : ndarray of shape (N, 2, 2)
        There.
    folded, missed : ndarray of shape (N,)
        Rays that met a fold on their path, and those that were not found.
    """

    start: Array
    moved: Array
    jacobian: Array
    folded: NDArray[np.bool_]
    missed: NDArray[np.bool_]


@dataclass(frozen=True, eq=False)
class InverseMap(RayMap):
    """Which of a family's bent rays comes through a point.

    `table` is of the coordinates (s0, t0, depth) of the straight ray through the point and has five
    functions: the shifts of s and of t, the ray's slopes dx/dz and dy/dz beside those of the
    straight one, and the determinant of d(s, t)/d(s0, t0), minus one.
    """

    def rays(self, points_mm: Array) -> PointRays:
        """The bent rays through world points (N, 3)."""
        places = self.family.coordinates(points_mm)
        held = self.table.grid.holds(places)
        s, t, _ = places[held].T
        shift = self.table.at(places[held], 4)
        along_x, along_y = self.family.slope(s, t)
        slope = np.stack([along_x + shift[:, 2], along_y + shift[:, 3], np.ones(len(s))], axis=1)
        coordinates = np.full((len(places), 2), np.nan)
        coordinates[held] = places[held, :2] + shift[:, :2]
        direction = np.full((len(places), 3), np.nan)
        direction[held] = _unit(slope @ self.family.pose.rotation.T)
        status = np.where(held, MapStatus.OK, MapStatus.OFF).astype(np.uint8)
        return PointRays(coordinates, direction, status)

    def missed_mm(self, places: Array, marched: Callable[[Array], Array]) -> Array:
        """How far (N,) the rays through places (N, 3) are beside them when they are marched."""
        start = places.copy()
        start[:, :2] += self.table.at(places, 2)
        beside = _straight(self.family, places) - _straight(self.family, start)
        return np.asarray(np.linalg.norm(beside - marched(start)[:, :2], axis=1))

    def _units(self) -> tuple[float, float]:
        corners = self.table.grid.nodes()
        x_s, x_t, y_s, y_t = self.family.by_coordinates(*corners.T)
        return 1.0 / float(np.max(np.hypot(x_s, y_s))), 1.0 / float(np.max(np.hypot(x_t, y_t)))


def along(family: RayFamily, places: Array, moved: Array | None) -> tuple[Array, Array]:
    """Points on rays at places (N, 3) and their slopes by the depth, (N, 3), in the family's frame.

    `moved` (N, 4) is what a forward map's table has there; None: straight rays.
    """
    s, t, depth = places.T
    (x, y), (x_z, y_z) = family.place(s, t, depth), family.slope(s, t)
    if moved is not None:
        x, y, x_z, y_z = x + moved[:, 0], y + moved[:, 1], x_z + moved[:, 2], y_z + moved[:, 3]
    return np.column_stack([x, y, depth]), np.column_stack([x_z, y_z, np.ones_like(depth)])


@dataclass(frozen=True, eq=False)
class MapRequest(Displayed):
    """Which map is asked for.

    Attributes
    ----------
    field : Field or None
        None: light runs straight, and the map is zero.
    family : RayFamily
    low, high : ndarray of shape (3,)
        The box of (s, t, depth); of an inverse map, of the straight rays through the points.
    march : March
    tolerance_mm : float
        Largest error that the linear table's estimate may have; the splines have 0.6 of it.
    most_nodes : int
        Beyond so many the tolerance is given up.
    """

    field: Field | None
    family: RayFamily
    low: Array
    high: Array
    march: March
    tolerance_mm: float
    most_nodes: int = _MOST_NODES

    def displaced(self, places: Array) -> Array:
        """`displaced` of its rays at places (N, 3)."""
        return displaced(self.field, self.family, self.march, places)


def forward_map(asked: MapRequest) -> ForwardMap:
    """Tabulate where a family's bent rays are.

    Raises
    ------
    NoMapError
        If a ray does not reach its depth, or the tolerance can't be met.
    """
    linear_mm = (1.0 - _SPLINE) * asked.tolerance_mm
    if asked.field is None:
        return ForwardMap(asked.family, _zero(asked, 4), 0.0, linear_mm, 0.0)
    spline = replace(asked, tolerance_mm=_SPLINE * asked.tolerance_mm)
    return _refined(spline, _Lines.through(asked).shape(spline, np.inf), linear_mm)


def inverse_map(asked: MapRequest) -> InverseMap:
    """Tabulate which of a family's bent rays comes through a point.

    Raises
    ------
    NoMapError
        As `forward_map` does; also, as CausticError, if the map folds.
    """
    family, low, high = asked.family, asked.low, asked.high
    linear_mm = (1.0 - _SPLINE) * asked.tolerance_mm
    if asked.field is None:
        return InverseMap(family, _zero(asked, 5), 0.0, linear_mm, 0.0)

    spline_mm = _SPLINE * asked.tolerance_mm
    lines = _Lines.through(asked)
    shift = in_coordinates(family, lines.places, lines.values[:, :2])
    pad = _ROOM * np.append(np.abs(shift).max(axis=0), 0.0)
    for _ in range(_MOST_PADS):
        wider = replace(asked, low=low - pad, high=high + pad, tolerance_mm=_FORWARD * spline_mm)
        ahead = _refined(wider, lines.shape(wider, _STRETCH), linear_mm)
        grid = Grid(low, high, _shape_like(ahead.table.grid, low, high))
        values, reach = _inverted(ahead, grid)
        if np.all(ahead.table.grid.holds(reach)):
            break
        beyond = np.maximum(low - reach.min(axis=0), reach.max(axis=0) - high)
        pad = _ROOM * np.maximum(pad, beyond)
    else:
        raise CausticError("rays through the box come from far off: a caustic may be near")
    for _ in range(_LEVELS):
        table, checks = SplineTable(grid, values), _checks(grid)
        back = InverseMap(family, table, 0.0, linear_mm, ahead.largest_mm)
        error_mm = float(back.missed_mm(checks, asked.displaced).max())
        if error_mm <= spline_mm:
            return replace(back, error_mm=error_mm)
        finer = [int(1.3 * n) for n in grid.shape]
        grid = Grid(low, high, (finer[0], finer[1], finer[2]))
        values, _ = _inverted(ahead, grid)
    raise _too_coarse(grid.shape, error_mm, spline_mm)


def displaced(field: Field | None, family: RayFamily, march: March, places: Array) -> Array:
    """March rays of a family to depths.

    Parameters
    ----------
    places : ndarray of shape (N, 3)
        (s, t, depth).

    Returns
    -------
    ndarray of shape (N, 4)
        Displacement along the frame's x and y, mm, and slope by the depth, both beside the straight
        ray's.

    Raises
    ------
    NoMapError
        If a ray does not get there.
    """

    def marched(places: Array) -> Array:
        s, t, depth = to_vectors(places)
        frame = FamilyFrame.of(family, mi.Array3f64)
        origin, direction, _ = frame.rays(s, t)
        return _rows(frame, *_beside(field, march, frame, origin, direction, depth))

    return by_rows(marched, places)


def _displaced_on(asked: MapRequest, grid: Grid, checks: Array) -> tuple[Array, Array]:
    """`displaced` at the nodes of a grid, and at places (N, 3) between them.

    Of many nodes, rays go on from one depth to the next; of few, all are marched at once.  Those of
    first order can't go on: they are deflected by the air along the straight ray from their start.
    """
    alone = grid.low[2] <= 0.0 or asked.march.first_order  # or before rays start
    if alone or np.prod(grid.shape) < _MANY:
        together = asked.displaced(np.concatenate([grid.nodes(), checks]))
        return together[: -len(checks)], together[-len(checks) :]
    s, t, _ = Grid(grid.low, grid.high, (*grid.shape[:2], 1)).nodes().T
    frame = FamilyFrame.of(asked.family, mi.Array3f64)
    first, course, _ = frame.rays(to_scalars(s), to_scalars(t))
    origin, direction = first, course
    values = []
    for node in grid.axes()[2]:
        depth = dr.opaque(mi.Float64, float(node))
        moved, turned, ended = _beside(asked.field, asked.march, frame, origin, direction, depth)
        straight, slope = _at_depth(frame, origin, direction, depth)
        origin, slope = straight + moved, slope + turned
        direction = dr.normalize(slope)
        started, first_slope = _at_depth(frame, first, course, depth)
        dr.eval(origin, direction)
        values.append(_rows(frame, origin - started, slope - first_slope, ended))
    nodes = np.stack(values, axis=1).reshape(-1, 4)
    return nodes, asked.displaced(checks)


def _at_depth(frame: FamilyFrame, origin: Any, direction: Any, depth: Any) -> tuple[Any, Any]:
    """Points on straight rays at a depth of a frame, and their slopes: world vectors by depth."""
    slope = direction / dr.dot(direction, frame.z)
    return origin + slope * (depth + frame.centre[2] - dr.dot(origin, frame.z)), slope


def _beside(
    field: Field | None, march: March, frame: FamilyFrame, origin: Any, direction: Any, depth: Any
) -> tuple[Any, Any, Any]:
    """How far bent rays are beside their straight ones at a depth; which of them got there.

    World vectors, the displacement in mm and the slope by depth, in double precision; taken in the
    same plane they are free of the rounding of either ray's own place.
    """
    line = Straight.through(origin, direction, march)
    z = march.vector(frame.z)
    plane = march.scalar(depth + frame.centre[2])
    ends = in_plane(z, plane - dr.dot(z, line.anchor))
    ray = bend(field, NoSurface(), line, march, remaining=ends)
    d, offset, tau = line.direction, ray.offset[0], ray.tau[0]
    ahead = dr.dot(d, z)
    moved = offset - d * (dr.dot(offset, z) / ahead)
    turned = (tau - d * (dr.dot(tau, z) / ahead)) / (ahead + dr.dot(tau, z))
    return mi.Array3f64(moved), mi.Array3f64(turned), ray.status == int(RayStatus.ENDED)


def _rows(frame: FamilyFrame, moved: Any, turned: Any, ended: Any) -> Array:
    """World vectors as rows of `displaced`, (N, 4)."""
    numbers = [dr.dot(v, axis) for v in (moved, turned) for axis in (frame.x, frame.y)]
    dr.eval(*numbers, ended)
    if not np.all(np.array(ended)):
        raise NoMapError("a ray did not reach its depth: it was turned away, or ran out of steps")
    return np.stack([np.array(n, float) for n in numbers], axis=1)


def _inverted(ahead: ForwardMap, grid: Grid) -> tuple[Array, Array]:
    """From where rays go to which ray comes, at the nodes of a grid.

    Returns
    -------
    values : ndarray of shape (N, 5)
        The functions of `InverseMap.table`.
    start : ndarray of shape (N, 3)
        The rays; values of those that are off the map are guesses.
    """
    family, places = ahead.family, grid.nodes()
    moved, by_s, by_t = (
        ahead.table.on_grid(grid, order) for order in ((0, 0, 0), (1, 0, 0), (0, 1, 0))
    )
    found = ahead._through(places, moved, _jacobian(family, places, by_s, by_t))
    if found.folded.any():
        raise CausticError("the map folds: a caustic")
    if found.missed.any():
        raise CausticError("no single ray was found through each point: a caustic may be near")
    start = found.start
    bent, straight = (
        np.stack(np.broadcast_arrays(*family.slope(*p.T[:2])), axis=1) for p in (start, places)
    )
    shift, slope = start[:, :2] - places[:, :2], bent - straight + found.moved[:, 2:]
    more = family.spread(*places.T) / determinant(found.jacobian.reshape(-1, 4).T) - 1.0
    return np.column_stack([shift, slope, more]), start


def in_coordinates(family: RayFamily, places: Array, moved_mm: Array) -> Array:
    """By how much straight coordinates change with displacements (N, 2) at places (N, 3)."""
    return np.stack(solved(family.by_coordinates(*places.T), *moved_mm.T), axis=1)


def _refined(asked: MapRequest, shape: tuple[int, int, int], linear_mm: float) -> ForwardMap:
    """A map refined along the axes that need it; its splines keep the tolerance."""
    grid = Grid(asked.low, asked.high, shape)
    for _ in range(_LEVELS):
        if np.prod(grid.shape, dtype=float) > asked.most_nodes:
            break
        planes, checks = _planes(grid), _checks(grid)
        values, truth = _displaced_on(asked, planes, checks)
        table = SplineTable(grid, _between_planes(planes, values))
        wrong = np.linalg.norm((table.at(checks) - truth)[:, :2], axis=1).reshape(4, -1)
        by_axis = wrong.max(axis=1)
        reached = grid.shape, float(by_axis.max())
        if by_axis.max() <= asked.tolerance_mm:
            largest_mm = float(np.abs(values[:, :2]).max())
            return ForwardMap(asked.family, table, reached[1], linear_mm, largest_mm)
        factor = np.clip(_finer(by_axis[:3], asked.tolerance_mm), 1.0, 4.0)
        worst = int(np.argmax(by_axis[:3]))
        factor[worst] = max(factor[worst], 1.2)
        cells = (np.array(grid.shape) - 1.0) / _PER_CELL * factor
        grid = Grid(grid.low, grid.high, _shape(cells))
    raise _too_coarse(*reached, asked.tolerance_mm)


def _shape(cells: Array) -> tuple[int, int, int]:
    """Nodes of so many cells; along the depth, those between marched planes."""
    s, t, depth = np.maximum(np.ceil(cells - 1e-9).astype(int), _FEWEST_CELLS) * _PER_CELL + 1
    return int(s), int(t), int(depth)


def _planes(grid: Grid) -> Grid:
    """The nodes of a grid that rays are marched to: every third depth."""
    s, t, depth = grid.shape
    return Grid(grid.low, grid.high, (s, t, (depth - 1) // int(_PER_CELL[2]) + 1))


def _between_planes(planes: Grid, values: Array) -> Array:
    """Displacements and slopes (N, 4) at all depths of a grid, out of those at its planes.

    Hermite's cubic: rays are known with their slopes, and every plane more takes as long again.
    """
    shaped = values.reshape(*planes.shape, 2, 2)  # ..., displacement or slope, x or y
    step = planes.spacing[2]
    u = np.arange(1.0, _PER_CELL[2])[:, None] / _PER_CELL[2]
    here, there = shaped[:, :, :-1, None], shaped[:, :, 1:, None]
    rise = there[..., 0, :] - here[..., 0, :]
    bend, turn = step * here[..., 1, :] - rise, rise - step * there[..., 1, :]
    swing = (1.0 - u) * bend + u * turn
    moved = here[..., 0, :] + u * (rise + (1.0 - u) * swing)
    slope = (rise + (1.0 - 2.0 * u) * swing + u * (1.0 - u) * (turn - bend)) / step
    cells = np.concatenate([here, np.stack([moved, slope], axis=-2)], axis=3)
    inner = cells.reshape(*planes.shape[:2], -1, 4)
    last = values.reshape(*planes.shape, 4)[:, :, -1:]
    return np.concatenate([inner, last], axis=2).reshape(-1, 4)


@dataclass(frozen=True)
class _Lines:
    """Rays along lines through a box: about how fine a grid must be.

    Three lines along each axis; `values` (N, 4) are the displacements at `places` (N, 3), and
    `spacing_mm` (3,) is how far places next to each other are apart along s, t and depth.
    """

    low: Array
    high: Array
    places: Array
    values: Array
    spacing_mm: Array

    @staticmethod
    def through(asked: MapRequest) -> "_Lines":
        low, high = asked.low, asked.high
        lines, spacing = [], []
        for axis, count in enumerate(_ALONG):
            for share in (0.2, 0.5, 0.8):
                place = np.full((count, 3), share)
                place[:, axis] = np.linspace(0.0, 1.0, count)
                lines.append(low + place * (high - low))
            apart = np.diff(_straight(asked.family, lines[-1]), axis=0)
            spacing.append(np.linalg.norm(apart, axis=1).max() if axis < 2 else np.inf)
        places = np.concatenate(lines)
        return _Lines(low, high, places, asked.displaced(places), np.array(spacing))

    def shape(self, asked: MapRequest, stretch: float) -> tuple[int, int, int]:
        """About how many nodes each axis of a map of a box like this one needs."""
        cells, first = np.zeros(3), 0
        tolerance_mm = asked.tolerance_mm / _PATIENCE
        for axis, count in enumerate(_ALONG):
            line = self.values[first : first + 3 * count].reshape(3, count, 4)
            along, slopes = line.transpose(1, 2, 0).reshape(count, 2, 6).transpose(1, 0, 2)
            larger = (asked.high[axis] - asked.low[axis]) / (self.high[axis] - self.low[axis])
            if axis < 2:
                slope_mm = stretch * self.spacing_mm[axis]
                needed = _cells_for(along, tolerance_mm, slope_mm)
            else:
                step = (self.high[axis] - self.low[axis]) / (count - 1)
                needed = _depths_for(along, slopes * step, tolerance_mm)
            cells[axis] = larger * needed
            first += 3 * count
        cells = np.clip(cells, _FEWEST_CELLS, _MOST_FIRST_ALONG)
        rays = float(np.prod(cells + 1.0))
        # Few rays take as long as some thousand; and where no grid will do, for noise, the error
        # reached is to be known in no time.
        cells[:2] *= max(_LEAST_FIRST / rays, 1.0) ** (1.0 / 2.0)
        cells *= min(_MOST_FIRST / rays, 1.0) ** (1.0 / 3.0)
        return _shape(cells)


def _shape_like(grid: Grid, low: Array, high: Array) -> tuple[int, int, int]:
    """Nodes of a box that has them as close as a grid."""
    apart = grid.spacing * [1.0, 1.0, 1.5]  # no Hermite's cubics here: two nodes for each do
    s, t, depth = np.maximum(np.ceil((high - low) / apart - 1e-9).astype(int) + 1, _FEWEST)
    return int(s), int(t), int(depth)


def _cells_for(values: Array, tolerance_mm: float, slope_mm: float) -> float:
    """How many cells a cubic spline through evenly spaced values (N, C) needs.

    Its error is to keep a tolerance, and that of its slope another, per space between the values.
    """
    cells = len(values) - 1
    skip = 1 << ((cells // (_FEWEST - 1)).bit_length() - 1)  # the most whose cells are whole
    while True:
        at_all, slopes_of = _splines_through(cells, skip)
        wrong = float(np.abs(at_all @ values).max()) / tolerance_mm
        turned = float(np.abs(slopes_of @ values).max()) / slope_mm
        if max(wrong, turned) <= 1.0 or skip == 2:
            break
        skip //= 2
    # Of smooth rays errors fall with the fourth and the third power of the spacing; through a field
    # on a grid, whose cubics have kinks in their third derivative, more slowly.
    finer = max(wrong ** (1.0 / 3.0), turned ** (1.0 / 2.0))
    return cells / skip * max(finer, 0.5)


@lru_cache(64)
def _splines_through(cells: int, skip: int) -> tuple[Array, Array]:
    """What a cubic spline through every so many of some values errs by, as matrices of the values.

    At all of them; and in its slope at quarters of cells, beside the spline through all: at half a
    cell a spline's slope is nearly right.
    """
    at, quarters = np.arange(cells + 1.0), np.arange(0.0, cells, 0.5)
    unit = np.eye(cells + 1)
    spline, every = CubicSpline(at[::skip], unit[::skip]), CubicSpline(at, unit)
    return spline(at) - unit, spline(quarters, 1) - every(quarters, 1)


def _depths_for(values: Array, slopes: Array, tolerance_mm: float) -> float:
    """How many cells Hermite's cubics need along evenly spaced values and slopes (N, C)."""
    cells = len(values) - 1
    at, skip = np.arange(cells + 1.0), cells
    while True:
        cubic = CubicHermiteSpline(at[::skip], values[::skip], slopes[::skip])
        wrong = float(np.abs(cubic(at) - values).max()) / tolerance_mm
        if wrong <= 1.0 or skip == 2:
            break
        skip //= 2
    return float(cells / skip * max(wrong ** (1.0 / 4.0), 0.5))


def _finer(error_mm: Array, tolerance_mm: float) -> Array:
    """By how much to refine: a cubic spline's error falls with the fourth power of the spacing."""
    return (_PATIENCE * np.maximum(error_mm, 1e-12) / tolerance_mm) ** 0.25


def _checks(grid: Grid) -> Array:
    """Places midway between nodes along each axis, on nodes along the others; and anywhere."""
    random = np.random.default_rng(grid.shape)
    last = np.array(grid.shape) - 1
    places = []
    for axis in range(3):
        place = random.integers(0, last + 1, (_CHECKS, 3)).astype(float)
        place[:, axis] = random.integers(0, last[axis], _CHECKS) + 0.5
        places.append(grid.low + place * grid.spacing)
    anywhere = grid.low + random.random((_CHECKS, 3)) * (grid.high - grid.low)
    return np.concatenate([*places, anywhere])


def _too_coarse(shape: tuple[int, int, int], error_mm: float, tolerance_mm: float) -> NoMapError:
    return NoMapError(
        f"the table's error is {error_mm:.1e} mm with {' x '.join(map(str, shape))} nodes, above"
        f" the tolerance of {tolerance_mm:.1e} mm"
    )


def _straight(family: RayFamily, places: Array) -> Array:
    """X and y (N, 2) of straight rays at places (N, 3)."""
    return np.stack(np.broadcast_arrays(*family.place(*places.T)), axis=1)


def _zero(asked: MapRequest, functions: int) -> SplineTable:
    grid = Grid(asked.low, asked.high, (_FEWEST, _FEWEST, _FEWEST))
    return SplineTable(grid, np.zeros((_FEWEST**3, functions)))


def _jacobian(family: RayFamily, places: Array, by_s: Array, by_t: Array) -> Array:
    """d(x, y)/d(s, t) (N, 2, 2) of bent rays, of a map's derivatives by s and by t."""
    x_s, x_t, y_s, y_t = family.by_coordinates(*places.T)
    entries = x_s + by_s[:, 0], x_t + by_t[:, 0], y_s + by_s[:, 1], y_t + by_t[:, 1]
    return np.stack(entries, axis=1).reshape(-1, 2, 2)


def _unit(vectors: Array) -> Array:
    unit: Array = vectors / np.linalg.norm(vectors, axis=1, keepdims=True)
    return unit
