"""Where bent lines of sight meet a source's bent rays of one first coordinate s.

On the line of sight (p, q) of the camera, at the depth Z, lies the point C(p, q, Z); in the
source's frame it has a place (X, Y) and a depth z. On the source's ray (s, t) lies, at that depth,
the place S(s, t, z). Two equations,

    (X, Y)(Z) - S(s, t, z(Z)) = 0,

for the two unknowns Z and t are solved by Newton's method. C and S are straight rays plus the
displacements of two forward maps (`ray_maps`), which give the derivatives as well.
"""

from dataclasses import dataclass
from typing import ClassVar

import numpy as np
from numpy.typing import NDArray

from virtual_sensor.display import Displayed, tally
from virtual_sensor.optics.covering_maps import by_octaves, covering_map, first_march, in_mm
from virtual_sensor.optics.crossing_status import CrossingStatus
from virtual_sensor.optics.field_border import uncovered
from virtual_sensor.optics.ray_families import Pinhole, RayFamily
from virtual_sensor.optics.ray_maps import ForwardMap, MapStatus, along, displaced
from virtual_sensor.optics.rays import Field

Array = NDArray[np.float64]
Mask = NDArray[np.bool_]

_MOST_STEPS = 20
_SETTLED_MM = 1e-9
_PROBES = 32  # straight crossings that show how far bent ones may lie from them
_ROOM = 3.0  # times the displacements there
_MOST_MAPS = 4
_FARTHEST = 2.0  # times its straight depth, a bent crossing is given up


@dataclass(frozen=True)
class Crossings(Displayed):
    """Points of N pixels.

    Attributes
    ----------
    point_mm : ndarray of shape (N, 3)
        World; NaN unless OK.
    along : ndarray of shape (N,)
        Second coordinate t of the source's ray there; NaN unless OK.
    status : ndarray of shape (N,)
        `CrossingStatus`.
    """

    _statuses: ClassVar = {"status": CrossingStatus}
    _by_row: ClassVar = True

    point_mm: Array
    along: Array
    status: NDArray[np.uint8]

    def _line(self) -> str:
        return tally(self.status, CrossingStatus.OK)


def crossings(
    field: Field | None,
    camera: Pinhole,
    family: RayFamily,
    pixel: Array,
    s: Array,
    tolerance_px: float,
) -> Crossings:
    """Points at which lines of sight meet the source's rays.

    Parameters
    ----------
    field : Field or None
        None: light runs straight.
    camera : Pinhole
    family : RayFamily
        The source's.
    pixel : ndarray of shape (N, 2)
    s : ndarray of shape (N,)
        The rays' first coordinate.
    tolerance_px : float
        Of the maps of camera and source.

    Raises
    ------
    NoMapError
        If the tolerance can't be met, or a ray does not reach its depth.
    """
    finite = np.isfinite(pixel).all(axis=1, keepdims=True)
    sight = np.stack(camera.of_pixels(np.where(finite, pixel, np.nan)), axis=1)
    known = np.isfinite(sight).all(axis=1) & np.isfinite(s)
    pairs = _Pairs(camera, family, np.nan_to_num(sight), np.where(known, s, 0.0))
    depth, t, settled = pairs.solved(*pairs.start(), None, None)
    place, beyond = pairs.places(depth, None)
    ahead = (depth > 0.0) & ((beyond[:, 2] > 0.0) | (field is None))
    reasons = {
        CrossingStatus.NO_PIXEL: ~known,
        CrossingStatus.NO_CROSSING: ~settled,
        CrossingStatus.BEHIND: ~ahead,
    }
    status = np.select([*reasons.values()], [*reasons], CrossingStatus.OK).astype(np.uint8)
    if field is not None:
        bent = np.flatnonzero(status == CrossingStatus.OK)
        for some in by_octaves(depth[bent]):
            rows = bent[some]
            tolerance_mm = in_mm(tolerance_px, camera, depth[rows])
            place[rows], t[rows], status[rows] = _bent(
                field, pairs.of(rows), depth[rows], t[rows], tolerance_mm
            )
    point = camera.pose.to_world(place)
    if field is not None:
        met = np.flatnonzero(status == CrossingStatus.OK)
        status[met[uncovered(field, camera, family, point[met])]] = CrossingStatus.UNCOVERED
    ok = status == CrossingStatus.OK
    point = np.where(ok[:, None], point, np.nan)
    return Crossings(point, np.where(ok, t, np.nan), status)


def _bent(
    field: Field, pairs: "_Pairs", depth: Array, t: Array, tolerance_mm: float
) -> tuple[Array, Array, NDArray[np.uint8]]:
    """Bent crossings, from straight ones: places in the camera's frame, t, and `CrossingStatus`."""
    seen, lit = pairs.about(field, depth, t)
    for _ in range(_MOST_MAPS):
        sight = covering_map(field, pairs.camera, seen, tolerance_mm)
        light = covering_map(field, pairs.family, lit, tolerance_mm)
        root, root_t, settled = pairs.solved(depth, t, sight, light)
        place, beyond = pairs.places(root, sight)
        on_sight, on_light = pairs.on_maps(root, root_t, beyond)
        held = sight.table.grid.holds(on_sight) & light.table.grid.holds(on_light)
        more = ~held & (root > depth / _FARTHEST) & (root < depth * _FARTHEST)
        if not more.any():
            break
        seen, lit = np.vstack([seen, on_sight[more]]), np.vstack([lit, on_light[more]])
    folded = held & ~settled
    folded[held] |= light.points(on_light[held]).status == MapStatus.FOLDED
    status = np.where(held, CrossingStatus.OK, CrossingStatus.OFF)
    return place, root_t, np.where(folded, CrossingStatus.FOLDED, status).astype(np.uint8)


@dataclass(frozen=True)
class _Pairs:
    """Lines of sight, `sight` (N, 2) of (p, q), and the source's rays that they meet, s (N,)."""

    camera: Pinhole
    family: RayFamily
    sight: Array
    s: Array

    def of(self, rows: NDArray[np.intp]) -> "_Pairs":
        return _Pairs(self.camera, self.family, self.sight[rows], self.s[rows])

    @np.errstate(all="ignore")  # parallel ones are nowhere near each other
    def start(self) -> tuple[Array, Array]:
        """Depth at which straight lines of sight come nearest to the rays (s, 0), and t there."""
        origin, direction = self.camera.rays(*self.sight.T)
        other, heading = self.family.rays(self.s, 0.0)
        gap = origin - other
        cosine, ahead, behind = (
            np.sum(a * b, axis=1)
            for a, b in ((direction, heading), (gap, direction), (gap, heading))
        )
        length = (cosine * behind - ahead) / (1.0 - cosine**2)
        depth = length * (direction @ self.camera.pose.rotation[:, 2])
        point = origin + length[:, None] * direction
        return depth, self.family.coordinates(point)[:, 1]

    def places(self, depth: Array, sight: ForwardMap | None) -> tuple[Array, Array]:
        """Points on the lines of sight (N, 3) in the camera's frame and in the source's."""
        here, _ = self._seen(depth, sight)
        return here, self.family.pose.to_local(self.camera.pose.to_world(here))

    def on_maps(self, depth: Array, t: Array, beyond: Array) -> tuple[Array, Array]:
        """The same points as (s, t, depth), (N, 3), of both families."""
        return np.column_stack([self.sight, depth]), np.column_stack([self.s, t, beyond[:, 2]])

    @np.errstate(all="ignore")
    def solved(
        self, depth: Array, t: Array, sight: ForwardMap | None, light: ForwardMap | None
    ) -> tuple[Array, Array, Mask]:
        """Depths and t from a start, by Newton's method, and which of them settled."""
        turn = self.camera.pose.rotation.T @ self.family.pose.rotation
        for _ in range(_MOST_STEPS):
            here, slope = self._seen(depth, sight)
            place = self.family.pose.to_local(self.camera.pose.to_world(here))
            there, light_slope, (x_t, y_t) = self._lit(t, place[:, 2], light)
            x, y = (place - there)[:, :2].T
            settled = np.maximum(np.abs(x), np.abs(y)) <= _SETTLED_MM
            if settled.all():
                break
            heading = slope @ turn
            x_z, y_z, _ = (heading - heading[:, 2:] * light_slope).T
            area = np.where(settled, np.inf, y_z * x_t - x_z * y_t)
            depth, t = depth - (x_t * y - y_t * x) / area, t - (x_z * y - y_z * x) / area
        return depth, t, settled

    def about(self, field: Field, depth: Array, t: Array) -> tuple[Array, Array]:
        """Places (M, 3) on both families' maps, between which bent crossings lie, by straight ones.

        A ray that is moved by d crosses another, at an angle, d / sin(angle) away.
        """
        _, beyond = self.places(depth, None)
        seen, lit = self.on_maps(depth, t, beyond)
        some = np.linspace(0, len(depth) - 1, min(_PROBES, len(depth))).astype(int)
        moved_mm = 0.0
        for family, places in ((self.camera, seen), (self.family, lit)):
            moved = displaced(field, family, first_march(field), places[some])
            moved_mm += float(np.linalg.norm(moved[:, :2], axis=1).max())
        (_, one), (_, other) = self.camera.rays(*self.sight.T), self.family.rays(self.s, t)
        sine = np.linalg.norm(np.cross(one, other), axis=1).min()
        room = _ROOM * moved_mm / sine
        by_t = np.hypot(*self._lit(t, lit[:, 2], None)[2]).min()
        seen_room, lit_room = np.array([0.0, 0.0, room]), np.array([0.0, room / by_t, room])
        return (
            np.concatenate([seen - seen_room, seen + seen_room]),
            np.concatenate([lit - lit_room, lit + lit_room]),
        )

    def _seen(self, depth: Array, sight: ForwardMap | None) -> tuple[Array, Array]:
        """Points on the lines of sight and their slopes, in the camera's frame."""
        places = np.column_stack([self.sight, depth])
        return along(self.camera, places, sight.table.at(places) if sight else None)

    def _lit(
        self, t: Array, depth: Array, light: ForwardMap | None
    ) -> tuple[Array, Array, tuple[Array, Array]]:
        """Points on the source's rays, their slopes, and dx/dt and dy/dt; in the source's frame."""
        places = np.column_stack([self.s, t, depth])
        _, x_t, _, y_t = self.family.by_coordinates(self.s, t, depth)
        moved = None
        if light is not None:
            moved, _, by_t = light.table.with_slopes(places)
            x_t, y_t = x_t + by_t[:, 0], y_t + by_t[:, 1]
        return *along(self.family, places, moved), (x_t + 0.0 * depth, y_t + 0.0 * depth)
