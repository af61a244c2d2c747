"""Making deflection maps: march rays at the nodes, estimate the error between them, refine."""

from collections.abc import Callable
from dataclasses import dataclass, replace
from typing import Any

import numpy as np
from numpy.typing import NDArray

from virtual_sensor.arrays import to_scalars, to_vectors
from virtual_sensor.engine import dr
from virtual_sensor.optics.deflection_map import CameraMap, Grid, LaserMap, LinearTable, Table
from virtual_sensor.optics.eikonal import Field, March, Straight, bend, in_plane
from virtual_sensor.optics.ray_status import RayStatus
from virtual_sensor.optics.sensor_model import LaserLine, Pose
from virtual_sensor.optics.surfaces import NoSurface

Array = NDArray[np.float64]

_STRAIGHT = (2, 2, 2)
_FIRST_CAMERA, _FIRST_LASER = (57, 9, 4), (7, 161, 4)  # nodes to begin with
_LINEAR = 0.4  # of the tolerance is for the linear interpolation between the spline's values
_MOST_NODES, _MOST_LINEAR_NODES = 250_000, 10_000_000
_LEVELS = 8
_CHECKS = 96  # rays between the nodes of each axis, and as many anywhere
_SETTLED = 0.05  # of the tolerance: what is left when a laser ray is found
_MOST_STEPS = 12


class NoMapError(Exception):
    """Why there is no map that can be trusted."""


@dataclass(frozen=True)
class Fineness:
    """How fine a map is.

    Attributes
    ----------
    nodes : tuple of three int
    error_mm : float
        Largest error of all rays marched between the nodes.
    largest_mm : float
        Largest displacement at the nodes.
    """

    nodes: tuple[int, int, int]
    error_mm: float = 0.0
    largest_mm: float = 0.0


def camera_map(
    field: Field | None,
    pose: Pose,
    low: Array,
    high: Array,
    march: March,
    tolerance_mm: float,
) -> tuple[CameraMap, Fineness]:
    """Tabulate the bent lines of sight of a pinhole camera.

    Parameters
    ----------
    field : Field or None
        None: light runs straight, and the map is of nought.
    pose : Pose
        Of the projection centre; z forward.
    low, high : ndarray of shape (3,)
        The box of (p, q, Z) to be tabulated.
    march : March
    tolerance_mm : float
        Largest error of the displacement that the estimate may show.

    Raises
    ------
    NoMapError
        If a ray does not reach its depth, or the tolerance can't be met.
    """
    if field is None:
        nought = LinearTable(Grid(low, high, _STRAIGHT), np.zeros((*_STRAIGHT, 4)))
        return CameraMap(pose, nought), Fineness(_STRAIGHT)

    def marched(place: Array) -> Array:
        return sight_moved(field, march, pose, *place.T)

    linear_mm, spline_mm = _LINEAR * tolerance_mm, (1.0 - _LINEAR) * tolerance_mm
    table, fineness = _refined(marched, Grid(low, high, _FIRST_CAMERA), spline_mm)
    error_mm = fineness.error_mm + linear_mm
    return CameraMap(pose, _linear(table, linear_mm)), replace(fineness, error_mm=error_mm)


def laser_map(
    field: Field | None,
    laser: LaserLine,
    low: Array,
    high: Array,
    moved_mm: Array,
    march: March,
    tolerance_mm: float,
) -> tuple[LaserMap, Fineness]:
    """Tabulate the laser ray through each point of a box of (a0, b0, depth); see `camera_map`.

    The rays are tabulated as they go, then the table is inverted by Newton's method.

    Parameters
    ----------
    moved_mm : ndarray of shape (2,)
        About how far rays are moved along a and b at most.

    Raises
    ------
    NoMapError
        Also if the map folds: two laser rays through one point, a caustic.
    """
    if field is None:
        nought = LinearTable(Grid(low, high, _STRAIGHT), np.zeros((*_STRAIGHT, 5)))
        return LaserMap(laser, nought), Fineness(_STRAIGHT)

    def marched(start: Array) -> Array:
        return laser_moved(field, march, laser, *start.T)

    pad = np.array([*moved_mm, 0.0])
    linear_mm, spline_mm = _LINEAR * tolerance_mm, (1.0 - _LINEAR) * tolerance_mm
    ahead, fineness = _refined(marched, Grid(low - pad, high + pad, _FIRST_LASER), 0.75 * spline_mm)
    nodes = zip(high - low, ahead.grid.spacing, strict=True)
    shape = [max(int(np.ceil(extent / step)) + 1, 4) for extent, step in nodes]
    for _ in range(_LEVELS):
        grid = Grid(low, high, (shape[0], shape[1], shape[2]))
        table = Table(grid, _inverted(ahead, grid, laser, _SETTLED * tolerance_mm))
        checks = _checks(grid)
        start = checks.copy()
        start[:, :2] += table.at(checks)[:, :2]
        miss = np.linalg.norm(checks[:, :2] - start[:, :2] - marched(start)[:, :2], axis=1)
        if miss.max() <= spline_mm:
            error_mm = float(miss.max()) + linear_mm
            fineness = replace(fineness, nodes=grid.shape, error_mm=error_mm)
            return LaserMap(laser, _linear(table, linear_mm)), fineness
        shape = [int(1.3 * n) for n in shape]
    raise _too_coarse(grid, float(miss.max()), spline_mm)


def _inverted(ahead: Table, grid: Grid, laser: LaserLine, settled_mm: float) -> Array:
    """From where rays go to which ray comes: the columns of `LaserMap.table`, (N, 5)."""
    slopes = Table(ahead.grid, np.hstack([ahead.slopes(axis)[:, :2] for axis in (0, 1)]))
    place = grid.nodes()
    start = place.copy()
    for _ in range(_MOST_STEPS):
        by_a, by_b = np.split(slopes.at(start), 2, axis=1)
        jacobian = np.eye(2) + np.stack([by_a, by_b], axis=2)
        determinant = np.linalg.det(jacobian)
        if not np.all(determinant > 0.0):
            raise NoMapError("the laser's map folds: a caustic")
        moved = ahead.at(start)
        miss = place[:, :2] - start[:, :2] - moved[:, :2]
        if np.abs(miss).max() < settled_mm:
            break
        start[:, :2] += np.linalg.solve(jacobian, miss[:, :, None])[:, :, 0]
    else:
        raise NoMapError("no single laser ray was found through each point: a caustic may be near")
    shift, slope = start[:, :2] - place[:, :2], moved[:, 2:]
    # The ray itself is another than the straight one through the place: its slope is, too.
    slope[:, 1] += laser.fan_per_mm * shift[:, 1]
    return np.column_stack([shift, slope, 1.0 / determinant - 1.0])


def sight_moved(field: Field, march: March, pose: Pose, p: Array, q: Array, depth: Array) -> Array:
    """How bent lines of sight (p, q) differ from straight ones at depths; see `displaced`.

    Parameters
    ----------
    p, q, depth : ndarray of shape (N,)
        Of the camera's frame, `pose`; depth in mm.
    """
    local = np.stack([p, q, np.ones_like(p)], axis=1)
    origins = np.broadcast_to(pose.origin_mm, local.shape)
    return displaced(field, march, pose, origins, local, depth)


def laser_moved(
    field: Field, march: March, laser: LaserLine, a: Array, b: Array, depth: Array
) -> Array:
    """How bent laser rays (a, b) differ from straight ones at depths behind the reference plane.

    Parameters
    ----------
    a, b, depth : ndarray of shape (N,)
        In mm.

    Returns
    -------
    ndarray of shape (N, 4)
        Differences of the straight coordinates (a0, b0) of where they are, mm, and of the slopes
        across and along.

    Raises
    ------
    NoMapError
        If a ray does not get there.
    """
    rotation = laser.pose.rotation
    centre = Pose(rotation, laser.pose.origin_mm + laser.distance_mm * rotation[:, 2])
    origins, directions = laser.rays(a, b)
    moved = displaced(field, march, centre, origins, directions @ rotation, depth)
    moved[:, 1] /= 1.0 + laser.fan_per_mm * depth
    return moved


def _finer(error_mm: Array, tolerance_mm: float) -> Array:
    """By how much to refine: a cubic spline's error falls with the fourth power of the spacing."""
    return (2.5 * np.maximum(error_mm, 1e-12) / tolerance_mm) ** 0.25


def _refined(
    marched: Callable[[Array], Array], grid: Grid, tolerance_mm: float
) -> tuple[Table, Fineness]:
    """Refine a table along the axes that need it, until the error between nodes is small enough."""
    for _ in range(_LEVELS):
        nodes, checks = grid.nodes(), _checks(grid)
        values = marched(np.concatenate([nodes, checks]))
        values, truth = values[: len(nodes)], values[len(nodes) :]
        table = Table(grid, values)
        wrong = np.linalg.norm((table.at(checks) - truth)[:, :2], axis=1).reshape(4, -1)
        by_axis = wrong.max(axis=1)
        if by_axis.max() <= tolerance_mm:
            largest_mm = float(np.abs(values[:, :2]).max())
            return table, Fineness(grid.shape, float(by_axis.max()), largest_mm)
        factor = np.clip(_finer(by_axis[:3], tolerance_mm), 1.0, 4.0)
        worst = int(np.argmax(by_axis[:3]))
        factor[worst] = max(factor[worst], 1.2)
        finer = [int(np.ceil((n - 1) * f)) + 1 for n, f in zip(grid.shape, factor, strict=True)]
        if np.prod(finer) > _MOST_NODES:
            break
        grid = Grid(grid.low, grid.high, (finer[0], finer[1], finer[2]))
    raise _too_coarse(grid, float(by_axis.max()), tolerance_mm)


def _linear(table: Table, tolerance_mm: float) -> LinearTable:
    """A linear table of the same, if there is room for one that keeps the tolerance."""
    finer = table.finer(tolerance_mm)
    shape = [k * (n - 1) + 1 for k, n in zip(finer, table.grid.shape, strict=True)]
    if np.prod(shape, dtype=float) > _MOST_LINEAR_NODES:
        raise NoMapError(
            f"a table within {tolerance_mm:.1e} mm would have {' x '.join(map(str, shape))} nodes"
        )
    return table.linear(finer)


def _too_coarse(grid: Grid, error_mm: float, tolerance_mm: float) -> NoMapError:
    nodes = " x ".join(map(str, grid.shape))
    return NoMapError(
        f"the table's error is {error_mm:.1e} mm with {nodes} nodes, above the tolerance of"
        f" {tolerance_mm:.1e} mm"
    )


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


def displaced(
    field: Field,
    march: March,
    pose: Pose,
    origins: Array,
    local: Array,
    depth: Array,
) -> Array:
    """March rays to planes z = depth of a frame.

    Parameters
    ----------
    origins, local : ndarray of shape (N, 3)
        World, mm; and directions in the frame, of any length.
    depth : ndarray of shape (N,)

    Returns
    -------
    ndarray of shape (N, 4)
        Displacement along the frame's x and y, mm, and slope by z, both beside the straight ray's.

    Raises
    ------
    NoMapError
        If a ray does not get there.
    """
    world = local @ pose.rotation.T
    unit = world / np.linalg.norm(world, axis=1, keepdims=True)
    line = Straight.through(to_vectors(origins), to_vectors(unit), march)
    x, y, z = (dr.opaque(march.vector(*map(float, pose.rotation[:, k]))) for k in range(3))
    plane = march.scalar(to_scalars(depth + float(pose.rotation[:, 2] @ pose.origin_mm)))
    ray = bend(
        field,
        NoSurface(),
        line,
        march,
        remaining=in_plane(z, plane - dr.dot(z, line.anchor)),
    )
    # Beside the straight ray in the same plane: free of the rounding of either's own place.
    d, offset, tau = line.direction, ray.offset[0], ray.tau[0]
    ahead = dr.dot(d, z)
    moved = offset - d * (dr.dot(offset, z) / ahead)
    turned = (tau - d * (dr.dot(tau, z) / ahead)) / (ahead + dr.dot(tau, z))
    numbers: list[Any] = [dr.dot(moved, x), dr.dot(moved, y), dr.dot(turned, x), dr.dot(turned, y)]
    dr.eval(*numbers, ray.status)
    if not np.all(np.array(ray.status) == RayStatus.ENDED):
        raise NoMapError("a ray did not reach its depth: it was turned away, or ran out of steps")
    return np.stack([np.array(n, float) for n in numbers], axis=1)
