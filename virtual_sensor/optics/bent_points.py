"""Points that pixels see on a source's bent rays, with their exact derivatives.

A pixel's line of sight C and the source's ray of coordinates (s, t) are marched to where they are
nearest; there both go on in straight lines, along their tangents T and U. They meet if

    C + T l = S + S_t dt + U m,

three equations for the lengths l and m and for the change of t: one of Newton's steps. Its
derivative is that of an implicit function: if a parameter moves the two rays by c and s, with M the
matrix of the columns T, -S_t and -U,

    (l', t', m') = M^-1 (s - c),   and the point moves by   P' = c + T l'.

Two or three steps need long marches, and one the march asked for, which gives all derivatives, too;
from a point and a t that are known well, that one is enough.
"""

from __future__ import annotations

from collections.abc import Iterable, Iterator, Mapping
from dataclasses import dataclass, fields, replace
from functools import partial
from pathlib import Path
from typing import Any, ClassVar

import numpy as np
from numpy.typing import ArrayLike, NDArray

from virtual_sensor.arrays import by_rows, determinant, numbers_of, points_of, solved
from virtual_sensor.calls import public
from virtual_sensor.display import Displayed, listed, span, tally
from virtual_sensor.errors import InputError, short
from virtual_sensor.optics.carried_rays import (
    CarriedRays,
    Motion,
    RayStarts,
    carry,
    parameters_of,
)
from virtual_sensor.optics.crossing_status import CrossingStatus
from virtual_sensor.optics.crossings import crossings
from virtual_sensor.optics.field_border import uncovered
from virtual_sensor.optics.ray_families import Pinhole, RayFamily
from virtual_sensor.optics.rays import Field, March, Variation
from virtual_sensor.optics.sight import REFERENCE, SearchScene, chosen, scene_of
from virtual_sensor.optics.sources import first_coordinate

Array = NDArray[np.float64]
Mask = NDArray[np.bool_]

_LONG_MM = 2.0  # steps that err by 1e-4 mm on the shipped fields
_LINEAR_MM = 1e-3  # rays that are so near each other meet where their tangents do, to 1e-8 mm
_MOST_LONG, _MOST_FINE, _MOST_NEAR = 8, 3, 2  # steps of Newton's method; the last, from a start


@dataclass(frozen=True)
class BentPoints(Displayed):
    """Points that N pixels see on a source's rays; NaN unless OK.

    Attributes
    ----------
    point_mm : ndarray of shape (N, 3)
        World.
    along_mm : ndarray of shape (N,)
        Second coordinate t of the source's ray there: along a laser's line; a pinhole's has no
        unit.
    status : ndarray of shape (N,)
        `CrossingStatus`.
    point_by_pixel : ndarray of shape (N, 3, 2)
        d(x, y, z)/d(u, v) in mm/px.
    along_by_pixel : ndarray of shape (N, 2)
    point_by_coordinate : ndarray of shape (N, 3)
        By the source's first coordinate s.
    along_by_coordinate : ndarray of shape (N,)
    point_by : dict from str to ndarray of shape (N, 3)
        By each parameter: in mm per mm, mm per degree, mm per unit of any other.
    along_by : dict from str to ndarray of shape (N,)
    """

    _statuses: ClassVar = {"status": CrossingStatus}
    _by_row: ClassVar = True

    point_mm: Array
    along_mm: Array
    status: NDArray[np.uint8]
    point_by_pixel: Array
    along_by_pixel: Array
    point_by_coordinate: Array
    along_by_coordinate: Array
    point_by: dict[str, Array]
    along_by: dict[str, Array]

    def _line(self) -> str:
        axes = zip("xyz", self.point_mm.T, strict=True)
        spans = (span(axis, values, "mm") for axis, values in axes)
        return listed(tally(self.status, CrossingStatus.OK), *spans)


@public
def bent_points(
    scene: SearchScene | str | Path,
    pixel: ArrayLike,
    parameters: Iterable[str] = (),
    *,
    variations: Mapping[str, Variation] | None = None,
    coordinate: ArrayLike | None = None,
    pivot_mm: ArrayLike = (0.0, 0.0, 0.0),
    march: March = REFERENCE,
    start_mm: ArrayLike | None = None,
    start_along_mm: ArrayLike | None = None,
    camera: str | None = None,
    source: str | None = None,
) -> BentPoints:
    """Find the points that pixels see on a source's rays, and their derivatives, by marched rays.

    Parameters
    ----------
    scene : Scene, str or Path
        From `load_scene`, or its name or path; or what else has a camera, a source, a medium and a
        surface. The surface hides nothing: only the turn ``beta`` is about it.
    pixel : array_like of shape (N, 2)
        (u, v) in px, integer at pixel centres.
    parameters : iterable of str, optional
        By which the points are differentiated: of `pose_parameters`; ``beta``, the sensor's turn in
        degrees about the analytic cylinder's axis; ``field_scale``, a factor at the field's
        difference from its surroundings, where it is 1.
    variations : mapping from str to Variation, optional
        Further parameters: the field's derivative by each, such as
        `AirModel.derivatives` gives.
    coordinate : array_like of shape (N,)
        First coordinate s of the source's rays, for each pixel or one for all. By default 0, the
        middle of a laser's sheet; a projector has no such.
    pivot_mm : array_like of shape (3,)
        World point that turns are about, other than ``beta``.
    march : March
        Of the points and derivatives.
    start_mm : array_like of shape (N, 3), optional
        Points near those that are sought, such as those in air that is a little different. By
        default, and where NaN, where straight light would meet.
    start_along_mm : array_like of shape (N,), optional
        Second coordinates t near those of their rays. By default those of straight light.
    camera, source : str, optional
        Names of the scene's, where it has several.

    Raises
    ------
    InputError
        If `pixel` is no list of (u, v), a parameter is unknown, or the air is asked to vary where
        there is none.
    """
    scene = chosen(scene_of("bent_points", scene), camera, source)
    pixel = points_of("bent_points: pixel", pixel, 2)
    if pixel.ndim != 2 or pixel.shape[1] != 2:
        raise InputError(f"bent_points: pixel has shape {pixel.shape}; give it (N, 2), (u, v) each")
    s = first_coordinate("bent_points", scene.source, coordinate)
    if s.shape not in ((), pixel.shape[:1]):
        raise InputError(
            f"bent_points: coordinate has shape {s.shape}; give one number, or one for each pixel"
        )
    s = np.broadcast_to(np.where(np.isfinite(s), s, np.nan), pixel.shape[:1])
    if not isinstance(march, March):
        raise InputError(f"bent_points: march is {short(march)}; give a March, or leave it out")
    march.check(scene.medium)
    known, asked, air = parameters_of("bent_points", scene, parameters, variations, pivot_mm)

    light = _Light(scene.medium, scene.camera, scene.source.family, march, asked, known, air)
    if start_mm is None:
        return light.points(pixel, s)
    start = points_of("bent_points: start_mm", start_mm)
    if start.shape != (len(pixel), 3):
        raise InputError(
            f"bent_points: start_mm has shape {start.shape}; give a point for each pixel"
        )
    none = np.full(len(pixel), np.nan)
    along = numbers_of(
        "bent_points: start_along_mm", none if start_along_mm is None else start_along_mm
    )
    if along.shape != none.shape:
        raise InputError(
            f"bent_points: start_along_mm has shape {along.shape}; give a number for each pixel"
        )
    return light.points(pixel, s, np.column_stack([start, along]))


def marched_crossings(
    field: Field | None, camera: Pinhole, family: RayFamily, pixel: Array, s: Array
) -> BentPoints:
    """Points of pixels (N, 2) on a source's rays of first coordinates (N,), as `crossings`."""
    return _Light(field, camera, family, REFERENCE, (), {}, {}).points(pixel, s)


@dataclass(frozen=True)
class _Light:
    """Light through a field, how it is marched, and by what its points are differentiated."""

    field: Field | None
    camera: Pinhole
    family: RayFamily
    march: March
    asked: Iterable[str]
    known: Mapping[str, Motion]
    air: Mapping[str, Variation]

    def points(self, pixel: Array, s: Array, start: Array | None = None) -> BentPoints:
        """Of pixels (N, 2) on rays s (N,), from (x, y, z, t) near them (N, 4) where finite."""
        straight = crossings(None, self.camera, self.family, pixel, s, 1.0)
        point = straight.point_mm
        if start is not None:
            point = np.where(
                np.isfinite(start[:, :3]).all(axis=1, keepdims=True), start[:, :3], point
            )
        t = self.family.coordinates(point)[:, 1]
        if start is not None:
            t = np.where(np.isfinite(start).all(axis=1), start[:, 3], t)
        rows = np.flatnonzero(straight.status == CrossingStatus.OK)
        marched = partial(_marched, self, _MOST_NEAR if start is not None else 0)
        found = by_rows(marched, pixel[rows], s[rows], point[rows], t[rows])
        return _spread(found, rows, straight.status)


def _marched(
    light: _Light, near_steps: int, pixel: Array, s: Array, point: Array, t: Array
) -> BentPoints:
    """Points of pixels (N, 2) on rays s (N,), with derivatives, from points and t near them.

    The first steps, so many as `near_steps`, take these as near; the long way follows if they fail.
    """
    field, camera, family = light.field, light.camera, light.family
    march, known = light.march, light.known
    p, q = camera.of_pixels(pixel)
    sight = RayStarts.of(camera, p, q)

    def pair(march: March, air: Mapping[str, Variation]) -> _Pair:
        rays = RayStarts.of(family, s, t)
        return _Pair(
            carry(field, "camera", sight, air, march, abreast_of=point),
            carry(field, "laser", rays, air, march, abreast_of=point),
        )

    def stepped(
        by: March, air: Mapping[str, Variation], most: int, lost: Mask
    ) -> tuple[_Pair, Mask]:
        """So many steps at most, until all rays meet but those lost before; which are lost then."""
        nonlocal point, t
        for _ in range(most):
            rays = pair(by, air)
            moved, along, off_mm = rays.meeting()
            near = off_mm <= _LINEAR_MM
            point = np.where(np.isfinite(moved), moved, point)
            t = np.where(np.isfinite(along), t + along, t)
            if (near | lost).all():
                break
        return rays, ~near

    none, first = np.zeros(len(point), bool), (point, t)
    lost = ~none
    if near_steps:
        rays, lost = stepped(march, light.air, near_steps, none)
    if lost.any():
        point, t = np.where(lost[:, None], first[0], point), np.where(lost, first[1], t)
        long = replace(march, step_mm=max(march.step_mm, _LONG_MM))
        _, lost = stepped(long, {}, _MOST_LONG, none)
        rays, lost = stepped(march, light.air, _MOST_FINE, lost)
    folded = _folded(camera, p, q, rays.seen) | _folded(family, s, t, rays.lit)
    depths = [each.pose.to_local(point)[:, 2] for each in (camera, family)]
    reasons = {
        CrossingStatus.FOLDED: folded,
        CrossingStatus.OFF: lost,
        CrossingStatus.BEHIND: ~(np.minimum(*depths) > 0.0),
    }
    if field is not None:
        reasons[CrossingStatus.UNCOVERED] = uncovered(field, camera, family, point)
    status = np.select([*reasons.values()], [*reasons], CrossingStatus.OK)

    by_pq = np.stack(rays.seen.by_coordinate(), axis=-1)
    by_pixel = by_pq @ np.linalg.inv(camera.pixel_slopes(p, q))
    of_u, of_v = (rays.by(by_pixel[..., i], 0.0) for i in range(2))
    by_s, _ = rays.lit.by_coordinate()
    of_s = rays.by(0.0, by_s)
    of = {name: rays.by(*(each.by(name, known) for each in rays)) for name in light.asked}
    return BentPoints(
        point,
        t,
        status.astype(np.uint8),
        np.stack([of_u[0], of_v[0]], axis=-1),
        np.stack([of_u[1], of_v[1]], axis=-1),
        *of_s,
        {name: of_point for name, (of_point, _) in of.items()},
        {name: of_along for name, (_, of_along) in of.items()},
    )


class _Pair:
    """Lines of sight and the source's rays, close to where they meet."""

    def __init__(self, seen: CarriedRays, lit: CarriedRays) -> None:
        self.seen, self.lit = seen, lit
        _, self._by_t = lit.by_coordinate()
        columns = np.stack([seen.tangent, -self._by_t, -lit.tangent], axis=-1)
        good = np.isfinite(columns).all(axis=(1, 2)) & seen.arrived & lit.arrived
        good[good] = np.linalg.det(columns[good]) != 0.0
        self._inverse = np.full_like(columns, np.nan)
        self._inverse[good] = np.linalg.inv(columns[good])

    def __iter__(self) -> Iterator[CarriedRays]:
        return iter((self.seen, self.lit))

    def meeting(self) -> tuple[Array, Array, Array]:
        """Where tangents meet, (N, 3); the change of t (N,); and how far that is, in mm (N,)."""
        gap = self.lit.point - self.seen.point
        ahead, along, beyond = (self._inverse @ gap[:, :, None])[:, :, 0].T
        reach = np.abs([ahead, beyond, along * np.linalg.norm(self._by_t, axis=1)])
        return self.seen.point + self.seen.tangent * ahead[:, None], along, reach.max(axis=0)

    def by(self, of_sight: Array | float, of_light: Array | float) -> tuple[Array, Array]:
        """Derivatives of the point (N, 3) and of t (N,), from those of both rays at the same t."""
        change = np.zeros_like(self.seen.point) + of_light - of_sight
        ahead, along, _ = (self._inverse @ change[:, :, None])[:, :, 0].T
        return of_sight + self.seen.tangent * ahead[:, None], along


def _folded(family: RayFamily, s: Array, t: Array, rays: CarriedRays) -> Mask:
    """Where rays are turned over beside straight ones: beyond a caustic (see `ray_maps`)."""
    x, y, z = family.pose.rotation.T
    heading = rays.tangent / (rays.tangent @ z)[:, None]
    by_s, by_t = (by - heading * (by @ z)[:, None] for by in rays.by_coordinate())
    straight = family.by_coordinates(s, t, family.pose.to_local(rays.point)[:, 2])
    with np.errstate(all="ignore"):  # where no ray goes
        (a, c), (b, d) = (solved(straight, by @ x, by @ y) for by in (by_s, by_t))
    return (determinant((a, b, c, d)) <= 0.0) | (a + d <= 0.0)


def _spread(found: BentPoints, rows: NDArray[np.intp], status: NDArray[np.uint8]) -> BentPoints:
    """Rows that were found, among all: NaN beside them, and where their status is not OK."""
    ok = found.status == CrossingStatus.OK

    def among(values: Any) -> Any:
        if isinstance(values, dict):
            return {name: among(each) for name, each in values.items()}
        spread = np.full((len(status), *values.shape[1:]), np.nan)
        spread[rows[ok]] = values[ok]
        return spread

    values = {f.name: among(getattr(found, f.name)) for f in fields(found)}
    values["status"] = status.copy()
    values["status"][rows] = found.status
    return BentPoints(**values)
