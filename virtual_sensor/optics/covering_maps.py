"""Ray maps that hold given places: which box, which march, how fine.

The box is that of the places, made larger to a lattice (`map_cache`), a forward map's also
wider by how far rays are moved.  The march's step is the longest that errs by a fifth of the
tolerance, by rays of the box.
"""

from collections.abc import Iterator
from dataclasses import replace

import numpy as np
from numpy.typing import NDArray

from virtual_sensor.optics.map_cache import MapCache
from virtual_sensor.optics.ray_families import Pinhole, RayFamily
from virtual_sensor.optics.ray_maps import (
    ForwardMap,
    InverseMap,
    MapRequest,
    NoMapError,
    PointRays,
    forward_map,
    in_coordinates,
    inverse_map,
)
from virtual_sensor.optics.rays import Field, March

Array = NDArray[np.float64]

_LONGEST_MM = 4.0  # step that is tried; it is halved until it errs little enough
_SHORTEST_MM = 0.05
_THINNEST = 1e-5  # a box is, as a part of its coordinates or absolutely
_MARCH_SHARE = 0.2  # of the tolerance is for the march
_ROOM = 1.5  # times the shifts that these show
_ANYWHERE = 1000  # rays in a box that show how far light is moved, and how march and map err
_BESIDE = 0.5  # images to each side of the sensor
_SAFE = 0.7  # of the tolerance is asked for where a map errs by more
_MOST_MAPS = 4
_MOST_NODES = 2_000_000
_LATTICE = np.full(3, 8.0)  # a box grows by a sixteenth to each side at most


def covering_map(
    field: Field | None, family: RayFamily, places: Array, tolerance_mm: float
) -> ForwardMap:
    """The map of a family's bent rays round places, and of the rays through them.

    Parameters
    ----------
    field : Field or None
        None: light runs straight.
    family : RayFamily
    places : ndarray of shape (N, 3)
        (s, t, depth) of straight rays, finite. Beyond a caustic, bent rays through them may come
        from beside the map.
    tolerance_mm : float
        Largest error of the map and of its march.

    Raises
    ------
    NoMapError
        If the tolerance can't be met, or a ray does not reach its depth.
    """
    return MAPS.forward(_covering(field, family, places, tolerance_mm))


def covering_inverse_map(
    field: Field | None, family: RayFamily, places: Array, tolerance_mm: float
) -> InverseMap:
    """The map of a family's bent rays through points, by the straight rays through these.

    As `covering_map`; places (N, 3) are (s, t, depth) of straight rays.

    Raises
    ------
    NoMapError
        If the tolerance can't be met, or a ray does not reach its depth; as CausticError, if more
        than one ray goes through a point.
    """
    return MAPS.inverse(_covering(field, family, places, tolerance_mm))


def rays_through(
    field: Field | None, family: RayFamily, points_mm: Array, tolerance_mm: float
) -> PointRays:
    """A family's bent rays through world points (N, 3), which straight ones reach as well.

    By the inverse map; beside a caustic, where there is none, by the forward one.

    Raises
    ------
    NoMapError
        If there is neither.
    """
    asked = _covering(field, family, family.coordinates(points_mm), tolerance_mm)
    try:
        return MAPS.inverse(asked).rays(points_mm)
    except NoMapError:
        return MAPS.forward(asked).rays(points_mm)


def _covering(
    field: Field | None, family: RayFamily, places: Array, tolerance_mm: float
) -> MapRequest:
    """A map of the box of places (N, 3); never of a flat one."""
    low, high = places.min(axis=0), places.max(axis=0)
    thin = _THINNEST * np.maximum(1.0, np.maximum(np.abs(low), np.abs(high)))
    low, high = np.minimum(low, high - thin), np.maximum(high, low + thin)
    return MapRequest(field, family, low, high, first_march(field), tolerance_mm, _MOST_NODES)


def _forward(asked: MapRequest) -> ForwardMap:
    """The map of a box and of the rays through it, by a march that is fine enough."""
    if asked.field is None:
        return forward_map(asked)
    asked, shift = _probed(asked)
    pad, low, high = _ROOM * shift, asked.low, asked.high
    allowed_mm = asked_mm = asked.tolerance_mm
    for _ in range(_MOST_MAPS):
        asked = replace(asked, low=low - pad, high=high + pad, tolerance_mm=asked_mm)
        made = forward_map(asked)
        error_mm = float(made.missed_mm(_anywhere(asked), asked.displaced).max())
        nodes = made.table.grid.nodes()
        shift = _shifts(asked.family, nodes, made.table.at(nodes))
        if np.all(shift <= pad) and error_mm <= allowed_mm:
            break
        pad = np.maximum(pad, _ROOM * shift)
        if error_mm > allowed_mm:
            asked_mm *= _SAFE * allowed_mm / error_mm
    return made


def _inverse(asked: MapRequest) -> InverseMap:
    """The map of a box, by a march that is fine enough."""
    if asked.field is None:
        return inverse_map(asked)
    asked, _ = _probed(asked)
    allowed_mm, checks = asked.tolerance_mm, _anywhere(asked)
    for _ in range(_MOST_MAPS):
        made = inverse_map(asked)
        error_mm = float(made.missed_mm(checks, asked.displaced).max())
        if error_mm <= allowed_mm:
            break
        tighter_mm = asked.tolerance_mm * (_SAFE * allowed_mm / error_mm)
        asked = replace(asked, tolerance_mm=tighter_mm)
    return made


MAPS = MapCache(forward=_forward, inverse=_inverse, lattice=_LATTICE)
"""Covering maps of this process."""


def _anywhere(asked: MapRequest) -> Array:
    """Places (N, 3) in a map's box, the same for the same box."""
    random = np.random.default_rng(0).random((_ANYWHERE, 3))
    return asked.low + random * (asked.high - asked.low)


def first_march(field: Field | None) -> March:
    """The march with the longest step that is tried."""
    if field is None:
        return March()
    shortest = float(np.ptp(np.asarray(field.box, float), axis=0).min())
    return March(min(_LONGEST_MM, shortest / 4.0), "leapfrog", "double")


@np.errstate(over="ignore", invalid="ignore")
def in_view(camera: Pinhole, points_mm: Array) -> NDArray[np.bool_]:
    """Which points (N, 3) a camera's map may hold: seen on the sensor, or not too far beside it."""
    place = camera.project(points_mm) / np.array(camera.size)
    return np.asarray(np.all((place >= -_BESIDE) & (place <= 1.0 + _BESIDE), axis=1))


def in_mm(tolerance_px: float, camera: Pinhole, depth: Array) -> float:
    """A tolerance in mm, where things are seen at depths (N,): the same within an octave."""
    nearest = 2.0 ** np.floor(np.log2(depth.min()))
    return float(tolerance_px * nearest / camera.matrix[0, 0])


def by_octaves(depth: Array) -> Iterator[NDArray[np.intp]]:
    """Rows of positive depths (N,) that differ by a factor of two at most: one map suits them."""
    octave = np.floor(np.log2(depth))
    for each in np.unique(octave):
        yield np.flatnonzero(octave == each)


def _probed(asked: MapRequest) -> tuple[MapRequest, Array]:
    """By a march that errs little enough, to what that leaves of the tolerance; and the shifts.

    (3,): by how much the coordinates of rays of the box are shifted.
    """
    places = _anywhere(asked)
    moved = asked.displaced(places)
    while True:
        march = replace(asked.march, step_mm=asked.march.step_mm / 2.0)
        finer = replace(asked, march=march)
        better = finer.displaced(places)
        error_mm = float(np.abs(better - moved)[:, :2].max())
        if error_mm <= _MARCH_SHARE * asked.tolerance_mm:
            left_mm = (1.0 - _MARCH_SHARE) * asked.tolerance_mm
            shifts = _shifts(asked.family, places, better)
            return replace(asked, tolerance_mm=left_mm), shifts
        if march.step_mm < _SHORTEST_MM:
            raise NoMapError(
                f"steps of {asked.march.step_mm:g} mm err by {error_mm:.1e} mm, where the tolerance"
                f" is {asked.tolerance_mm:.1e} mm"
            )
        asked, moved = finer, better


def _shifts(family: RayFamily, places: Array, moved: Array) -> Array:
    """How far displacements carry rays at most, in their coordinates; depth stays: (3,)."""
    return np.append(np.abs(in_coordinates(family, places, moved[:, :2])).max(axis=0), 0.0)
