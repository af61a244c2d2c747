"""Where lines of sight meet a projector's light of known pixels: the core of range images.

On the line of sight (p, q) of a camera the point at depth Z is lit by one ray of the projector,
which has the pixel (u, v)(Z).  The depth at which that is the decoded pixel is found by Gauss and
Newton's method, with one coordinate or both by least squares: with g = d pixel/dZ of straight
light,

    Z <- Z + sum_i w_i g_i (decoded_i - pixel_i(Z)) / sum_i w_i g_i^2.

Through air the point comes from the camera's forward map and its ray from the projector's inverse
map (`ray_maps`); slopes of straight light do, since bent light differs by a thousandth.  All pixels
are computed at once in Dr.Jit, in double precision beside the maps' displacements.
"""

from __future__ import annotations

from contextlib import suppress
from dataclasses import dataclass, replace
from typing import Any, ClassVar

import numpy as np
from numpy.typing import NDArray

from virtual_sensor.arrays import by_rows, in_own_memory, shares, to_numpy
from virtual_sensor.display import Displayed, tally
from virtual_sensor.engine import dr, mi
from virtual_sensor.optics.bent_points import marched_crossings
from virtual_sensor.optics.covering_maps import (
    by_octaves,
    covering_inverse_map,
    covering_map,
    in_mm,
)
from virtual_sensor.optics.crossing_status import CrossingStatus
from virtual_sensor.optics.crossings import crossings
from virtual_sensor.optics.distortion import distorted
from virtual_sensor.optics.family_frames import FamilyFrame
from virtual_sensor.optics.field_border import uncovered
from virtual_sensor.optics.grid_tables import LinearTable
from virtual_sensor.optics.ray_families import Pinhole, PixelFamily
from virtual_sensor.optics.ray_maps import ForwardMap, InverseMap, NoMapError
from virtual_sensor.optics.rays import Field

Array = NDArray[np.float64]
Mask = NDArray[np.bool_]

_MOST_STEPS = 12
_SETTLED = 1e-9  # of the depth: a step so small is the last
_LINEAR = 1e-6  # of the depth: steps for slopes
_PARALLEL_PX = 1e-3  # by so little the projector's pixel tells no depth, as the depth doubles
_LANES, _FEW = 1 << 18, 1 << 17  # pixels at once: memory stays bounded
_ROOMS_MM = 3.0, 12.0, 48.0  # that bent points may lie deeper or nearer than straight ones
_ROOM = 1.5  # times how far lines of sight are seen to be moved
_BESIDE = 0.05  # images that a ray may lie beside the projector's
_FEW_RAYS, _FEW_SHARE = 300, 0.01  # pixels whose rays are marched rather than tabulated
_SAMPLE = 4096  # points that are asked first whether the air covers their light


@dataclass(frozen=True)
class SightPoints(Displayed):
    """What N lines of sight meet; NaN unless OK.

    Attributes
    ----------
    point_mm : ndarray of shape (N, 3)
        World.
    depth_mm : ndarray of shape (N,)
        Along the camera's axis.
    projector_pixel : ndarray of shape (N, 2)
        Of the ray that lights the point: near the decoded one, and equal to it along an axis that
        alone was used.
    px_per_mm : ndarray of shape (N, 2)
        By how much it changes along the line of sight.
    status : ndarray of shape (N,)
        `CrossingStatus`.
    """

    _field_units: ClassVar = {"projector_pixel": "px"}
    _statuses: ClassVar = {"status": CrossingStatus}
    _by_row: ClassVar = True

    point_mm: Array
    depth_mm: Array
    projector_pixel: Array
    px_per_mm: Array
    status: NDArray[np.uint8]

    def _line(self) -> str:
        return tally(self.status, CrossingStatus.OK)


def sight_points(
    field: Field | None,
    camera: Pinhole,
    projector: PixelFamily,
    sight: Array,
    decoded: Array,
    weight: Array,
    tolerance_px: float,
) -> SightPoints:
    """Points on lines of sight that the projector's decoded pixels light.

    Parameters
    ----------
    field : Field or None
        None: light runs straight.
    camera : Pinhole
    projector : PixelFamily
    sight : ndarray of shape (N, 2)
        (p, q) of the camera's lines of sight.
    decoded : ndarray of shape (N, 2)
        The projector's (u, v) that they see.
    weight : ndarray of shape (N, 2)
        Of these two, such as one over their variances; 0 of one that is not used, and may be NaN.
    tolerance_px : float
        Of the maps of camera and projector, camera px.
    """
    used = weight > 0.0
    known: Any = np.isfinite(sight).all(axis=1) & used.any(axis=1)
    known &= (np.isfinite(decoded) | ~used).all(axis=1)
    found = _Found.nowhere(np.where(known, CrossingStatus.OK, CrossingStatus.NO_PIXEL))
    decoded, weight = np.where(used, decoded, 0.0), np.where(used, weight, 0.0)
    task = _Task(camera, projector, sight, decoded, weight)
    task.solve(found, found.ok)
    if field is not None and (rows := found.ok).size:
        found.put(rows, _bent(field, task.of(rows), found.of(rows), tolerance_px))
        found.status[_uncovered(field, task, found)] = CrossingStatus.UNCOVERED
    return found.points(sight)


@dataclass
class _Found:
    """What was found so far, by rows; numbers of points that are not OK are any."""

    point: Array
    depth: Array
    pixel: Array
    slope: Array  # d pixel/dZ
    status: NDArray[np.uint8]

    @staticmethod
    def nowhere(status: NDArray[Any]) -> _Found:
        """Nothing but a status, shape (N,)."""
        point, depth, pixel, slope = (np.full((len(status), k), np.nan) for k in (3, 1, 2, 2))
        return _Found(point, depth[:, 0], pixel, slope, status.astype(np.uint8))

    @property
    def ok(self) -> NDArray[np.intp]:
        return np.flatnonzero(self.status == CrossingStatus.OK)

    def of(self, rows: NDArray[np.intp]) -> _Found:
        """Some rows; all of them share these arrays."""
        return _Found(*(_taken(values, rows) for values in vars(self).values()))

    def put(self, rows: NDArray[np.intp], better: _Found) -> None:
        for values, others in zip(vars(self).values(), vars(better).values(), strict=True):
            if values is not others:
                values[rows] = others

    def points(self, sight: Array) -> SightPoints:
        """The result; its slopes are those along the lines of sight (N, 2)."""
        bad = self.status != CrossingStatus.OK
        for values in (self.point, self.depth, self.pixel, self.slope):
            values[bad] = np.nan
        length = np.sqrt(1.0 + np.einsum("ni,ni->n", sight, sight))
        along = self.slope / length[:, None]
        return SightPoints(self.point, self.depth, self.pixel, along, self.status)


@dataclass(frozen=True)
class _Task:
    """Lines of sight (N, 2), the projector's pixels that they see, and how much these count."""

    camera: Pinhole
    projector: PixelFamily
    sight: Array
    decoded: Array
    weight: Array

    def of(self, rows: NDArray[np.intp]) -> _Task:
        """Some of them."""
        numbers = (_taken(each, rows) for each in self._numbers)
        return _Task(self.camera, self.projector, *numbers)

    def solve(
        self,
        found: _Found,
        rows: NDArray[np.intp],
        depth: Array | None = None,
        sight: ForwardMap | None = None,
        light: InverseMap | None = None,
    ) -> None:
        """Find points of some rows by Newton's method.

        They begin at depths (N,) of all rows, or where ideal straight light meets.
        """
        kernel = _Kernel.of(self.camera, self.projector, sight, light)
        for first in range(0, len(rows), _LANES):
            some = rows[first : first + _LANES]
            columns = [each[some, k] for each in self._numbers for k in range(2)]
            if depth is not None:
                columns.append(depth[some])
            found.put(some, by_rows(kernel.solved, *columns))

    @property
    def _numbers(self) -> tuple[Array, Array, Array]:
        return self.sight, self.decoded, self.weight


@dataclass(frozen=True)
class _Kernel:
    """Frames, lens and maps as Dr.Jit takes them; poses and numbers are opaque."""

    camera: FamilyFrame
    projector: FamilyFrame
    matrix: tuple[Any, ...]
    inverse: tuple[Any, ...]
    distortion: Array
    sight: LinearTable | None
    light: LinearTable | None

    @staticmethod
    def of(
        camera: Pinhole,
        projector: PixelFamily,
        sight: ForwardMap | None,
        light: InverseMap | None,
    ) -> _Kernel:
        def opaque(matrix: NDArray[Any]) -> tuple[Any, ...]:
            return tuple(dr.opaque(mi.Float64, float(k)) for k in matrix[:2].ravel())

        return _Kernel(
            FamilyFrame.of(camera, mi.Array3f64),
            FamilyFrame.of(projector, mi.Array3f64),
            opaque(projector.matrix),
            opaque(np.linalg.inv(projector.matrix)),
            projector.distortion,
            sight.linear if sight else None,
            light.linear if light else None,
        )

    def solved(self, *columns: Array) -> _Found:
        """Points of p, q, u, v, the weights of u and v, and depths from which to begin, if any."""
        return self._solved(*(in_own_memory(column, mi.Float64) for column in columns))

    def _solved(
        self, p: Any, q: Any, u: Any, v: Any, of_u: Any, of_v: Any, z: Any = None
    ) -> _Found:
        z = self._start(p, q, u, v, of_u, of_v) if z is None else z
        for _ in range(_MOST_STEPS):
            point, held, ahead, (x, y), (by_x, by_y) = self._at(p, q, z)
            information = of_u * by_x * by_x + of_v * by_y * by_y
            change = (of_u * by_x * (u - x) + of_v * by_y * (v - y)) / information
            settled = dr.abs(change) <= _SETTLED * dr.abs(z)
            px = dr.sqrt(information / dr.maximum(of_u, of_v)) * dr.abs(z)
            reasons = {
                CrossingStatus.NO_CROSSING: ~(px > _PARALLEL_PX) | (held & ~settled),
                CrossingStatus.BEHIND: ~((z > 0.0) & (ahead > 0.0)),
                CrossingStatus.OFF: ~held,
            }
            status = mi.UInt32(int(CrossingStatus.OK))
            for why, where in reversed(reasons.items()):
                status = dr.select(where, int(why), status)
            going = held & ~settled & dr.isfinite(change)
            here, z = z, z + change
            dr.eval(point, x, y, by_x, by_y, status, going, here, z)
            if not dr.any(going):
                break
        return _Found(
            to_numpy(point),
            np.array(here, float),
            np.stack([np.array(x, float), np.array(y, float)], axis=1),
            np.stack([np.array(by_x, float), np.array(by_y, float)], axis=1),
            np.array(status, np.uint8),
        )

    def _start(self, p: Any, q: Any, u: Any, v: Any, of_u: Any, of_v: Any) -> Any:
        """Depths at which straight lines of sight meet rays of an ideal lens, by least squares."""
        a, b, c, d, e, f = self.inverse
        s, t = a * u + b * v + c, d * u + e * v + f
        (x, y), (along_x, along_y) = (
            self.projector.family.foot(s, t),
            self.projector.family.slope(s, t),
        )
        none = mi.Float64(0.0)
        start, end = (
            self.projector.local(self.camera.world(p * depth, q * depth, mi.Float64(depth) + none))
            for depth in (0.0, 1.0)
        )
        heading = [there - here for here, there in zip(start, end, strict=True)]
        top, bottom = none, none
        for weight, foot, slope, here, ahead in (
            (of_u, x, along_x, start[0], heading[0]),
            (of_v, y, along_y, start[1], heading[1]),
        ):
            by_depth = ahead - heading[2] * slope
            # Not +=, which in Dr.Jit changes the number that both began with.
            top = top + weight * by_depth * (foot + start[2] * slope - here)
            bottom = bottom + weight * by_depth * by_depth
        return top / bottom

    def _at(self, p: Any, q: Any, z: Any) -> tuple[Any, Any, Any, Any, Any]:
        """Points at depths, whether maps hold them, the projector's depth, pixel and slopes."""
        x, y, held = p * z, q * z, mi.Mask(True)
        line = self.camera.world(x, y, z)
        if self.sight is not None:
            place = mi.Array3f(p, q, z)
            moved_x, moved_y, *_ = self.sight.at(place)
            x, y = x + mi.Float64(moved_x), y + mi.Float64(moved_y)
            held = self.sight.holds(place)
        point = self.camera.world(x, y, z)
        s, t, depth = self.projector.coordinates(point)
        if self.light is not None:
            place = mi.Array3f(s, t, depth)
            shift_s, shift_t, *_ = self.light.at(place)
            s, t = s + mi.Float64(shift_s), t + mi.Float64(shift_t)
            held &= self.light.holds(place)
        step = z * _LINEAR
        here = self._pixel(*self.projector.coordinates(line)[:2])
        beyond = self.camera.world(p * (z + step), q * (z + step), z + step)
        there = self._pixel(*self.projector.coordinates(beyond)[:2])
        slopes = tuple((b - a) / step for a, b in zip(here, there, strict=True))
        return point, held, depth, self._pixel(s, t), slopes

    def _pixel(self, s: Any, t: Any) -> tuple[Any, Any]:
        a, b, c, d, e, f = self.matrix
        x, y = distorted(s, t, self.distortion)
        return a * x + b * y + c, d * x + e * y + f


def _bent(field: Field, task: _Task, straight: _Found, tolerance_px: float) -> _Found:
    """Points through air, from those of straight light.

    A map serves depths within an octave.  Those of a few pixels, such as were decoded wrongly,
    are worth none.
    """
    projector, points = task.projector, straight.point
    lit = np.concatenate([projector.coordinates(points[some]) for some in shares(len(points))])
    inside = np.abs(straight.pixel / projector.size - 0.5).max(axis=1) < 0.5 + _BESIDE
    found = replace(straight, status=np.full_like(straight.status, CrossingStatus.OFF))
    rows = np.flatnonzero(inside & (lit[:, 2] > 0.0))
    for near in by_octaves(straight.depth[rows]):
        for some in by_octaves(lit[rows[near], 2]):
            here = rows[near[some]]
            given = field, task.of(here), straight.of(here)
            few = here.size < min(_FEW_RAYS, _FEW_SHARE * rows.size)
            if few and task.weight[here, 0].all():
                found.put(here, _one_by_one(*given, tolerance_px))
            else:
                found.put(here, _by_maps(*given, _taken(lit, here), tolerance_px))
    return found


def _by_maps(
    field: Field, task: _Task, straight: _Found, lit: Array, tolerance_px: float
) -> _Found:
    """Points through air, of light whose straight rays are at places `lit` (N, 3)."""
    camera, projector = task.camera, task.projector
    tolerance_mm = in_mm(tolerance_px, camera, straight.depth)
    seen = np.column_stack([task.sight, straight.depth])
    found = replace(straight, status=np.full_like(straight.status, CrossingStatus.OFF))
    off = np.arange(len(seen))
    for room_mm in _ROOMS_MM:
        some = off[:: max(1, off.size // _SAMPLE)]
        try:
            room = np.array([0.0, 0.0, room_mm])
            sight = covering_map(field, camera, _box(_taken(seen, off), room), tolerance_mm)
            # Bent points lie beside straight ones by what bends their lines of sight, and deeper.
            beside_mm = _ROOM * np.abs(sight.table.at(seen[some], 2)).max()
            ahead = np.column_stack([task.sight[some], np.ones(some.size)])
            shifts = [room_mm * ahead @ camera.pose.rotation.T]
            shifts += [beside_mm * axis for axis in camera.pose.rotation.T[:2]]
            moved = (projector.coordinates(straight.point[some] + each) for each in shifts)
            room = np.sum([np.abs(each - lit[some]).max(axis=0) for each in moved], axis=0)
            box = _box(_taken(lit, off), room)
            light = covering_inverse_map(field, projector, box, tolerance_mm)
            task.solve(found, off, straight.depth, sight, light)
        except NoMapError:
            found.put(off, _one_by_one(field, task.of(off), straight.of(off), tolerance_px))
            break
        still = off[found.status[off] == CrossingStatus.OFF]
        if not 0 < still.size < off.size:
            break
        off = still
    return found


def _taken(values: NDArray[Any], rows: NDArray[np.intp]) -> NDArray[Any]:
    """Some rows, which are in their order; all of them are not copied."""
    return values if len(rows) == len(values) else values[rows]


def _box(places: Array, room: Array) -> Array:
    """Lowest and highest places (2, 3), with room."""
    return np.stack([places.min(axis=0) - room, places.max(axis=0) + room])


def _one_by_one(field: Field, task: _Task, straight: _Found, tolerance_px: float) -> _Found:
    """The same by the projector's column alone: for few, and beside a caustic of its light.

    Few rays are marched; more come from forward maps, if there are any.  A row that was not decoded
    is that of straight light, which matters to a distortion alone.
    """
    if not task.weight[:, 0].all():
        return replace(straight, status=np.full_like(straight.status, CrossingStatus.FOLDED))
    camera, projector = task.camera, task.projector
    row = np.where(task.weight[:, 1] > 0.0, task.decoded[:, 1], straight.pixel[:, 1])
    s, _ = projector.of_pixels(np.column_stack([task.decoded[:, 0], row]))
    pixel = camera.pixels(*task.sight.T)
    found = replace(straight)
    for first in range(0, len(s), _FEW):
        rows = slice(first, first + _FEW)
        point, along, status = _crossed(
            field, camera, projector, pixel[rows], s[rows], tolerance_px
        )
        found.point[rows], found.status[rows] = point, status
        found.pixel[rows] = projector.pixels(s[rows], along)
    found.depth[:] = camera.pose.to_local(found.point)[:, 2]
    return found


def _crossed(
    field: Field, camera: Pinhole, projector: PixelFamily, pixel: Array, s: Array, tolerance: float
) -> tuple[Array, Array, NDArray[np.uint8]]:
    """Points, the second coordinate t of their light, and `CrossingStatus`."""
    if len(s) >= _FEW_RAYS:
        with suppress(NoMapError):
            mapped = crossings(field, camera, projector, pixel, s, tolerance)
            return mapped.point_mm, mapped.along, mapped.status
    marched = marched_crossings(field, camera, projector, pixel, s)
    return marched.point_mm, marched.along_mm, marched.status


def _uncovered(field: Field, task: _Task, found: _Found) -> NDArray[np.intp]:
    """Rows whose light the field does not hold all the way; all are asked if one of some is so."""
    rows = found.ok
    few = rows[:: max(1, rows.size // _SAMPLE)]
    if not (few.size and uncovered(field, task.camera, task.projector, found.point[few]).any()):
        return rows[:0]
    parts = [rows[i : i + _FEW] for i in range(0, rows.size, _FEW)]
    return np.concatenate(
        [part[uncovered(field, task.camera, task.projector, found.point[part])] for part in parts]
    )
