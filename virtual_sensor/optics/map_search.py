"""The ray search by maps: where bent rays meet the part, and which pixel sees that, from tables.

A ray is followed by tangents: from before the part along the tangent at about where the ray ends,
then from half a millimetre before the place found, along the tangent there. A line of sight needs
no more than the tangent in the point that it is to see, unless something is met before it. Rays
that run off a map, or see a caustic, are left to Newton's search.
"""

import numpy as np
from numpy.typing import NDArray

from virtual_sensor.arrays import by_rows, to_scalars, to_vectors
from virtual_sensor.engine import mi
from virtual_sensor.optics.covering_maps import (
    by_octaves,
    covering_map,
    in_mm,
    in_view,
    rays_through,
)
from virtual_sensor.optics.newton_search import Roots
from virtual_sensor.optics.ray_families import Pinhole
from virtual_sensor.optics.ray_maps import ForwardMap, MapStatus
from virtual_sensor.optics.sight import SearchScene
from virtual_sensor.optics.surfaces import Surface

Array = NDArray[np.float64]
Mask = NDArray[np.bool_]

_TANGENTS = 3
_DEEPER = 0.05  # of a map's depths, beside them: for bent rays, where straight ones end
_NUDGE_MM, _FLAT = 1e-3, 8.0  # a ray so far beside another meets the part so much farther, at most
_REACH_MM = 0.5  # along the later tangents, before and behind the place found


def tabulated_roots(
    scene: SearchScene, s: Array, t: Array, tolerance_px: float
) -> tuple[Roots, Mask]:
    """Incidence points and their pixels by maps, and which rays the maps hold.

    Parameters
    ----------
    scene : SearchScene
    s, t : ndarray of shape (N,)
        Coordinates of the source's rays; NaN counts as held: it misses.  Unlit rays don't.
    tolerance_px : float
        Of the maps.

    Raises
    ------
    NoMapError
        If the tolerance can't be met, or a ray does not reach its depth.
    """
    nothing = np.full((len(t), 3), np.nan)
    slopes, marches = np.full((len(t), 2, 2), np.nan), np.zeros(len(t), int)
    found = Roots(nothing, nothing[:, :2].copy(), slopes, nothing.copy(), marches)
    mapped, lit = np.isnan(s + t), scene.source.reaches(s, t)
    camera, family, rows = scene.camera, scene.source.family, np.flatnonzero(lit)
    if not rows.size:
        return found, mapped
    origins, directions = family.rays(s[rows], t[rows])
    ahead = directions @ family.pose.rotation[:, 2]
    met = _distance(scene.surface, origins, directions, np.full(len(rows), np.inf))
    if not np.isfinite(met).any():
        return found, mapped
    met = np.where(np.isfinite(met), met, np.median(met[np.isfinite(met)]))
    straight = origins + directions * met[:, None]
    near = in_view(camera, straight)
    if not near.any():
        return found, mapped
    rows = rows[near]
    tolerance_mm = in_mm(tolerance_px, camera, camera.pose.to_local(straight[near])[:, 2])
    places = np.column_stack([s[rows], t[rows], (met * ahead)[near]])
    light = covering_map(scene.medium, family, _deeper(places), tolerance_mm)
    target, known = _met(light, places, scene.surface)
    found.target[rows] = target
    hit = np.flatnonzero(known & np.isfinite(target[:, 0]))
    places[hit, 2] = family.pose.to_local(target[hit])[:, 2]
    known[hit] = ~_grazes(scene.surface, target[hit], light.lines(places[hit])[1])
    mapped[rows] = known

    seen_at = in_view(camera, target)
    mapped[rows] &= seen_at | np.isnan(target[:, 0])
    rows = rows[known & seen_at]
    places = camera.coordinates(found.target[rows])
    for some in by_octaves(places[:, 2]):
        ray = rays_through(scene.medium, camera, found.target[rows[some]], tolerance_mm)
        ok = ray.status == MapStatus.OK
        at, sight = rows[some][ok], np.column_stack([ray.coordinates, places[some, 2]])[ok]
        found.pixel[at] = camera.pixels(*sight[:, :2].T)
        found.seen[at] = _there(scene.surface, camera, found.target[at], ray.direction[ok])
        mapped[rows[some]] = ok
        other = np.flatnonzero(np.isnan(found.seen[at, 0]))  # something is met before or behind
        if other.size:
            bent = covering_map(scene.medium, camera, _deeper(sight[other]), tolerance_mm)
            found.seen[at[other]], mapped[at[other]] = _met(bent, sight[other], scene.surface)
    return found, mapped


def _grazes(surface: Surface, point: Array, direction: Array) -> Mask:
    """Which rays meet a surface in points (N, 3) so flat that an error beside them grows along it.

    Where they do, rays close beside them meet it far before or behind, or not at all.
    """
    across = np.cross(direction, np.eye(3)[np.argmin(np.abs(direction), axis=1)])
    across /= np.linalg.norm(across, axis=1, keepdims=True)
    begin, limit = point - _REACH_MM * direction, np.full(len(point), 2.0 * _REACH_MM)
    apart = np.zeros(len(point))
    for side in (across, np.cross(direction, across)):
        met = _distance(surface, begin + _NUDGE_MM * side, direction, limit)
        apart = np.maximum(apart, np.abs(met - _REACH_MM))
    return ~(apart <= _FLAT * _NUDGE_MM)


def _there(surface: Surface, camera: Pinhole, point: Array, direction: Array) -> Array:
    """Where lines of sight through points (N, 3) meet a surface close to those; else NaN.

    They are followed along their tangents in the points, from the camera on.
    """
    seen, near = np.full_like(point, np.nan), np.arange(len(point))
    back = np.linalg.norm(point - camera.pose.origin_mm, axis=1)
    for _ in range(2):  # for the second time from near by: a hit from afar is rounded
        ahead = direction[near]
        begin = point[near] - ahead * back[:, None]
        met = _distance(surface, begin, ahead, back + _REACH_MM)
        here = np.abs(met - back) <= _REACH_MM
        near, back = near[here], np.full(np.count_nonzero(here), _REACH_MM)
    seen[near] = begin[here] + ahead[here] * met[here, None]
    return seen


def _deeper(places: Array) -> Array:
    """Places (N, 3) and some before and behind them, where bent rays may end as well."""
    room = np.array([0.0, 0.0, max(_DEEPER * float(np.ptp(places[:, 2])), _REACH_MM)])
    return np.concatenate([places - room, places + room])


def _met(bent: ForwardMap, places: Array, surface: Surface) -> tuple[Array, Mask]:
    """Where the rays of places (N, 3) meet a surface, which is searched from their depths on.

    Returns
    -------
    point_mm : ndarray of shape (N, 3)
        World; NaN where they miss.
    mapped : ndarray of shape (N,)
        Which rays stayed on the map.
    """
    places, axis = places.copy(), bent.family.pose.rotation[:, 2]
    mapped = bent.table.grid.holds(places)
    point = np.full((len(places), 3), np.nan)
    going = np.flatnonzero(mapped)
    for turn in range(_TANGENTS):
        here, heading = bent.lines(places[going])
        ahead = heading @ axis
        # At first from where the ray starts: whatever stands before is met.
        back = np.full(len(going), _REACH_MM) if turn else places[going, 2] / ahead
        begin = here - heading * back[:, None]
        limit = np.full(len(going), 2.0 * _REACH_MM if turn else np.inf)
        met = _distance(surface, begin, heading, limit)
        hit = np.isfinite(met)
        point[going] = begin + heading * np.where(hit, met, np.nan)[:, None]
        going = going[hit]
        places[going, 2] += ((met - back) * ahead)[hit]
        held = bent.table.grid.holds(places[going])
        mapped[going] = held
        point[going[~held]] = np.nan
        going = going[held]
    return point, mapped


def _distance(surface: Surface, origins: Array, directions: Array, limit_mm: Array) -> Array:
    """Distances (N,) in mm to a surface, infinite where it is not met."""
    if not len(origins):
        return np.zeros(0)

    def met(origins: Array, directions: Array, limit_mm: Array) -> Array:
        start, heading = to_vectors(origins), to_vectors(directions)
        distance = surface.distance(start, heading, to_scalars(limit_mm), mi.Mask(True))
        return np.array(distance, float)

    return by_rows(met, origins, directions, limit_mm)
