"""Polygons as readers of parts give them, and their triangles."""

from dataclasses import dataclass, field
from typing import Any

import numpy as np
from numpy.typing import NDArray

from virtual_sensor.errors import InputError
from virtual_sensor.imaging.scene_file import shortened

Array = NDArray[np.float64]
Indices = NDArray[np.int64]

_FLAT = 1e-9  # of a polygon's area: a fan's triangle that is turned by less is only thin


@dataclass
class Polygons:
    """What a reader found: vertices (N, 3), and polygons as their corners one after another."""

    vertices: Array
    corners: Any
    sizes: Any
    normals: Array | None = None
    plain: bool = False  # Mitsuba's reader knows all that the file has, but for polygons
    notes: list[str] = field(default_factory=list)
    only_mitsubas: list[str] = field(default_factory=list)  # notes, unless Mitsuba reads the file


def triangulated(read: Polygons) -> tuple[Indices, list[str]]:
    """Triangles (M, 3) of polygons, in their order, and notes."""
    notes = []
    vertices, corners, sizes = read.vertices, whole(read.corners), np.asarray(read.sizes, int)
    outside = (corners < 0) | (corners >= len(vertices))
    if outside.any():
        first = int(np.argmax(outside))
        face = int(np.searchsorted(np.cumsum(sizes), first, side="right"))
        raise InputError(
            f"face {face} refers to vertex {corners[first]}, and there are 0 to"
            f" {len(vertices) - 1}; mend the file"
        )
    if not np.any(sizes >= 3):
        raise InputError("it has no faces; give a mesh with faces, not points alone")
    starts = np.cumsum(sizes) - sizes
    fans, order = [], []
    for size in np.unique(sizes[sizes >= 3]):
        which = np.flatnonzero(sizes == size)
        polygon = corners[starts[which, None] + np.arange(size)]
        fans.append(_fans(vertices, polygon, which).reshape(-1, 3))
        order.append(np.repeat(which, size - 2))
    triangles = np.concatenate(fans)[np.argsort(np.concatenate(order), kind="stable")]
    if np.any(sizes > 3):
        notes.append(f"{int(np.sum(sizes > 3))} faces of more than three corners cut to triangles")
    if np.any(sizes < 3):
        notes.append(f"{int(np.sum(sizes < 3))} faces of fewer than three corners left out")
    return triangles, notes


def _fans(vertices: Array, polygons: Indices, which: Indices) -> Indices:
    """Triangles (M, n - 2, 3) of polygons (M, n), each from a corner that sees all others."""
    size = polygons.shape[1]
    if size == 3:
        return polygons[:, None]
    place = vertices[polygons]
    across = place - place[:, :1]
    normal = np.cross(across, np.roll(across, -1, axis=1)).sum(axis=1)  # twice the area
    area = np.linalg.norm(normal, axis=1)
    fans = np.zeros((len(polygons), size - 2, 3), np.int64)
    waiting = np.ones(len(polygons), bool)
    for first in range(size):
        turned = np.roll(polygons[waiting], -first, axis=1)
        fan = np.stack(
            [np.repeat(turned[:, :1], size - 2, axis=1), turned[:, 1:-1], turned[:, 2:]], axis=-1
        )
        corner = vertices[fan]
        part = np.cross(corner[:, :, 1] - corner[:, :, 0], corner[:, :, 2] - corner[:, :, 0])
        along = np.einsum("fti,fi->ft", part, normal[waiting])
        sound = np.all(along >= -_FLAT * area[waiting, None] ** 2, axis=1)
        index = np.flatnonzero(waiting)[sound]
        fans[index] = fan[sound]
        waiting[index] = False
        if not waiting.any():
            return fans
    raise InputError(
        f"face {which[int(np.argmax(waiting))]} has {size} corners, and none from which all"
        " others can be seen; triangulate the mesh in the program that made it"
    )


def numbers(words: list[bytes] | list[str]) -> Array:
    """Words as float64."""
    try:
        return np.array([float(word) for word in words])
    except ValueError as error:
        raise InputError(f"it has a word for a number ({shortened(str(error))}); mend it") from None


def whole(values: Any) -> Indices:
    """Numbers as int64; -1 where they are none that could be an index."""
    values = np.asarray(values, float)
    with np.errstate(invalid="ignore"):
        return np.where((values == np.rint(values)) & (np.abs(values) < 2**40), values, -1).astype(
            np.int64
        )
