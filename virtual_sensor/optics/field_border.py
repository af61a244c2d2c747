"""Where light enters a field, and whether the field holds all that bends it."""

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from virtual_sensor.arrays import by_rows, to_vectors
from virtual_sensor.display import Displayed
from virtual_sensor.display import place as place_words
from virtual_sensor.optics.ray_families import Pinhole, RayFamily
from virtual_sensor.optics.rays import Field

Array = NDArray[np.float64]
Mask = NDArray[np.bool_]

FACES = ("x-", "x+", "y-", "y+", "z-", "z+")
"""Of a field's box, in the order of `IndexField.border_jump`."""

JUMP_TOLD_PX = 0.003
"""A border jump that moves the image by more than this is noted..."""

JUMP_REFUSED_PX = 0.1
"""...and one that moves it by more than this is refused."""

FADED = 1e-6
"""So little n may differ from the surroundings where points lie beyond a border."""

_INSIDE_MM = 1e-4


@dataclass(frozen=True)
class BorderCrossing(Displayed):
    """Where light enters a field, and what the jump of n there does to the image.

    Attributes
    ----------
    face : ndarray of int of shape (N,)
        Index into `FACES`; -1 for rays that start inside the field.
    place_mm : ndarray of shape (N, 3)
        Where the ray enters, world.
    jump : ndarray of shape (N,)
        abs(n - n_ambient) there; 0 for rays that start inside.
    shift_px : ndarray of shape (N,)
        By how much the refraction at this jump would move the point that the ray ends at, as the
        camera sees it.
    """

    face: NDArray[np.int64]
    place_mm: Array
    jump: Array
    shift_px: Array


def border_crossing(
    field: Field, camera: Pinhole, family: RayFamily, points_mm: Array
) -> BorderCrossing:
    """Where a family's straight rays to points (N, 3) enter a field.

    Snell's law for a small jump: the ray turns by jump * tan(angle of incidence).
    """
    origin = family.origins(points_mm)
    start = field.to_local(origin)
    ray = field.to_local(points_mm) - start
    distance = np.linalg.norm(ray, axis=1)
    with np.errstate(divide="ignore", invalid="ignore"):
        entered = (np.where(ray >= 0.0, field.box[0], field.box[1]) - start) / ray
    axis = np.nanargmax(entered, axis=1)
    along = np.clip(np.nanmax(entered, axis=1), 0.0, 1.0)
    place = start + along[:, None] * ray
    outside = along > 0.0
    jump = np.where(outside, _difference(field, place), 0.0)
    across = ray[np.arange(len(ray)), axis]
    cosine = np.abs(across) / distance
    turn = jump * np.sqrt(1.0 - cosine**2) / np.maximum(cosine, 1e-3)
    shift = turn * (1.0 - along) * distance / camera.pixel_mm(points_mm)
    face = np.where(outside, 2 * axis + (across < 0.0), -1)
    return BorderCrossing(face, origin + along[:, None] * (points_mm - origin), jump, shift)


def uncovered(field: Field, camera: Pinhole, source: RayFamily, points_mm: Array) -> Mask:
    """Which points (N, 3) light reaches by ways that the field does not hold: shape (N,).

    It ends, on the way or before the point, where it has not faded to its surroundings: what bends
    the light beyond is not known.
    """
    short = _beyond(field, points_mm)
    for family in (camera, source):
        short |= border_crossing(field, camera, family, points_mm).shift_px > JUMP_REFUSED_PX
    return short


def cover_words(
    field: Field,
    camera: Pinhole,
    source: RayFamily,
    points_mm: Array,
    least_px: float = JUMP_REFUSED_PX,
) -> str:
    """Why some of the points (N, 3) are `uncovered`, for messages: where the worst is; else "".

    With a smaller `least_px`, also of points that a smaller jump moves by more than that.
    """
    beyond = np.flatnonzero(_beyond(field, points_mm))
    if beyond.size:
        place = field.to_local(points_mm[beyond])
        short_mm = np.maximum(field.box[0] - place, place - field.box[1])
        row, axis = np.unravel_index(np.argmax(short_mm), short_mm.shape)
        return (
            f"it ends before {len(beyond)} of {len(points_mm)} points, the farthest at"
            f" {place_words(points_mm[beyond[row]])} mm, {short_mm[row, axis]:.3g} mm beyond its"
            f" end along {'xyz'[axis]}, and has not faded to its surroundings there"
        )
    for name, family in (("camera", camera), ("source", source)):
        crossing = border_crossing(field, camera, family, points_mm)
        if np.any(crossing.shift_px > least_px):
            worst = int(np.argmax(crossing.shift_px))
            entry = place_words(crossing.place_mm[worst])
            return (
                f"it ends on the {name}'s side, at {entry} mm, where it has not faded to its"
                f" surroundings: n - 1 jumps by {crossing.jump[worst]:.1e}, which alone moves the"
                f" image by about {crossing.shift_px[worst]:.2g} px"
            )
    return ""


def _beyond(field: Field, points_mm: Array) -> Mask:
    """Which points (N, 3) lie beyond a border where the field has not faded."""
    place = field.to_local(points_mm)
    outside: Mask = np.any((place < field.box[0]) | (place > field.box[1]), axis=1)
    if outside.any():
        outside[outside] = _difference(field, place[outside]) > FADED
    return outside


def _difference(field: Field, place: Array) -> Array:
    """abs(n - n_ambient) (N,) at places in the field's frame, or the nearest ones in its box."""
    inner = np.clip(place, field.box[0] + _INSIDE_MM, field.box[1] - _INSIDE_MM)

    def delta(inner: Array) -> Array:
        return np.array(field.lookup("double").delta_and_gradient(to_vectors(inner))[0], float)

    return np.abs(by_rows(delta, inner))
