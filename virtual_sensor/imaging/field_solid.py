"""Whether a field of air belongs to the scene's part: its solid is compared with the part."""

from __future__ import annotations

from dataclasses import dataclass
from functools import lru_cache
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray
from scipy import ndimage

from virtual_sensor.arrays import by_rows, to_vectors
from virtual_sensor.display import Displayed
from virtual_sensor.engine import dr, mi
from virtual_sensor.medium.index_field import IndexField
from virtual_sensor.medium.netcdf import read_field_file

Array = NDArray[np.float64]

NOTED, REFUSED = 0.1, 0.5
"""Share of the field's solid that lies outside the part: noted from, and refused from."""

_OFF = 0.1  # of the part's surface: that so much lies beside the solid is noted
_MOST_NODES = 20_000
_RAYS = 64  # each way, on the part
_AROUND_MM = 20.0  # the solid: farther away it is not known how far
_CLEAR_MM = 1.0
_SCALES = 0.02, 200.0  # of a part's size: a field round it is larger, and smaller


@dataclass(frozen=True)
class Solid(Displayed):
    """The solid of a field's file, in the field's frame, known to half a cell.

    Attributes
    ----------
    nodes_mm : ndarray of shape (N, 3)
        Some of its nodes, those next to the air left out.
    level_mm : ndarray of shape (nx, ny, nz)
        Of the nodes round it: distance to the nearest node of the other kind; negative in it.
    slope : ndarray of shape (3, nx, ny, nz)
        Its gradient.
    origin_mm, spacing_mm : ndarray of shape (3,)
        Of those nodes.
    mirror : tuple of three bool
        Whether it is even about the plane 0 of an axis, as `IndexField.mirror`.
    plane_mm : ndarray of shape (3,)
        Where those planes are.
    known_mm : ndarray of shape (2, 3)
        Corners of its bounding box; NaN where the field's border cuts it.
    """

    nodes_mm: Array
    level_mm: Array
    slope: Array
    origin_mm: Array
    spacing_mm: Array
    mirror: tuple[bool, ...]
    plane_mm: Array
    known_mm: Array

    @property
    def cell_mm(self) -> float:
        """Diagonal of a cell."""
        return float(np.linalg.norm(self.spacing_mm))

    def height_mm(self, points_mm: Array) -> Array:
        """How high points (N, 3) lie above its surface, in it negative; mm, shape (N,).

        0 where the grid leaves open on which side they are.
        """
        beside = points_mm - self.plane_mm
        unfolded = np.where(self.mirror, self.plane_mm + np.abs(beside), points_mm)
        index = ((unfolded - self.origin_mm) / self.spacing_mm).T
        level = ndimage.map_coordinates(self.level_mm, index, order=1, mode="nearest")
        slopes = [
            ndimage.map_coordinates(slope, index, order=1, mode="nearest") for slope in self.slope
        ]
        steepness = np.maximum(np.linalg.norm(slopes, axis=0), 1e-6)
        cell = np.abs(slopes / steepness).T @ self.spacing_mm  # across its surface
        return np.where(np.abs(level) > cell, level - np.sign(level) * cell / 2.0, 0.0)


@dataclass(frozen=True)
class SolidFit(Displayed):
    """How a field's solid and the scene's part lie to each other.

    Attributes
    ----------
    name : str
        What the field is called.
    solid : Solid
    outside : float
        Share of the solid that lies outside the part.
    beside : float
        Share of the part's surface, where the solid is, that lies beside that of the solid.
    more : float
        Share of all surface in the field that does.
    largest_mm : float
        Largest distance between the two, but for the last hundredth; there may be more where only
        one of them is.
    shift_mm : ndarray of shape (3,) or None
        What the part would have to be moved by; None if that would not do.
    """

    name: str
    solid: Solid
    outside: float
    beside: float
    more: float
    largest_mm: float
    shift_mm: Array | None

    @property
    def alike(self) -> bool:
        """Whether the solid is this part."""
        return self.outside <= NOTED and self.beside <= _OFF and self.shift_mm is None

    @property
    def holds_more(self) -> bool:
        """Whether there is more than this part in the scene."""
        return self.alike and self.more > _OFF

    @property
    def words(self) -> str:
        """How far they are off."""
        text = f"its solid and the part differ by {self.largest_mm:.2g} mm or more"
        if self.outside > NOTED:
            text += f", {self.outside:.0%} of it lies outside the part"
        if self.shift_mm is not None:
            dx, dy, dz = self.shift_mm + 0.0
            text += f"; they are of one size, and it lies ({dx:.3g}, {dy:.3g}, {dz:.3g}) mm off"
        return text


def wrong_scale(part: Any, field: IndexField) -> str:
    """What to do about a field whose lengths are in another unit than its file says; else ""."""
    size = float(np.max(np.array(part.bbox().max) - np.array(part.bbox().min)))
    share = float(np.max(field.box[1] - field.box[0])) / size
    if _SCALES[0] < share < _SCALES[1]:
        return ""
    unit = "m" if share < 1.0 else "mm"
    return (
        f"its lengths seem to be in {unit}: let the units of its coordinates say so, or import it"
        f" again with --length-units {unit}"
    )


def fit_of(
    part: Any, field: IndexField, solid: Solid | None, name: str, up: Array
) -> SolidFit | None:
    """Compare a field's solid with a part.

    Parameters
    ----------
    part : mitsuba.Scene
    field : IndexField
        As it is placed.
    solid : Solid or None
    name : str
        What the field is called.
    up : ndarray of shape (3,)
        Unit vector from the part to where it is seen from.

    Returns
    -------
    SolidFit or None
        None of a field that marks no solid.
    """
    if solid is None:
        return None
    box = np.array([part.bbox().min, part.bbox().max], float)
    nodes = field.to_world(solid.nodes_mm)
    if field.pose is None:  # it may be endless, as a section is
        beyond = np.isnan(solid.known_mm).all(axis=0) & ((nodes < box[0]) | (nodes > box[1]))
        nodes = nodes[~beyond.any(axis=1)]
    front = _in_front(part, nodes, up, solid.cell_mm)
    where, everywhere = (
        np.abs(solid.height_mm(_within(field, _met(part, start, -up))))
        for start in (nodes + 2.0 * _size(box) * up, _all_over(box, up))
    )
    away = np.zeros(len(nodes))
    if front.any():
        from scipy.spatial import cKDTree  # most fields are their part's

        views = [sign * axis for axis in np.eye(3) for sign in (-1.0, 1.0)]
        skin = np.concatenate([_met(part, _all_over(box, view), -view) for view in views])
        away[front] = cKDTree(skin).query(nodes[front])[0]
    beside, more, outside = (_share(each > 0.0) for each in (where, everywhere, front))
    far = [where, away] if beside > _OFF or outside > NOTED else [everywhere]
    largest_mm = max((float(np.percentile(each, 99.0)) for each in far if len(each)), default=0.0)
    shift_mm = _shift(box, solid) if field.pose is None else None
    return SolidFit(name, solid, outside, beside, more, largest_mm, shift_mm)


def _share(mask: NDArray[np.bool_]) -> float:
    return float(np.mean(mask)) if len(mask) else 1.0


def _size(box: Array) -> float:
    return float(np.linalg.norm(box[1] - box[0]))


def _within(field: IndexField, points_mm: Array) -> Array:
    """Those of some world points (N, 3) that lie in a field, in its frame."""
    local = field.to_local(points_mm)
    return local[np.all((local >= field.box[0]) & (local <= field.box[1]), axis=1)]


def _shift(box: Array, solid: Solid) -> Array | None:
    """By what a solid lies beside a part of the same size."""
    off = solid.known_mm - box
    known = np.isfinite(off)
    if not known.any(axis=0).all() or np.any(np.abs(off[1] - off[0]) > solid.spacing_mm):
        return None
    shift = np.nanmean(off, axis=0)
    shift[np.abs(shift) <= solid.spacing_mm] = 0.0
    return shift if shift.any() else None


def _all_over(box: Array, up: Array) -> Array:
    """Points (N, 3) of a grid above a box, from which all of it is seen."""
    middle, radius = box.mean(axis=0), _size(box) / 2.0
    side = np.cross(up, np.eye(3)[np.argmin(np.abs(up))])
    axes = side / np.linalg.norm(side), np.cross(up, side / np.linalg.norm(side))
    corners = np.array(np.meshgrid(*box.T)).reshape(3, -1).T - middle
    steps = (np.arange(_RAYS) + 0.5) / _RAYS * 2.0 - 1.0
    reach = (steps * np.abs(corners @ axis).max() for axis in axes)
    a, b = (grid.ravel() for grid in np.meshgrid(*reach))
    return middle + (radius + _CLEAR_MM) * up + a[:, None] * axes[0] + b[:, None] * axes[1]


def _met(part: Any, start_mm: Array, heading: Array) -> Array:
    """Points (M, 3) of a part that rays from N points meet; M <= N."""

    def distance(start: Array, heading: Array) -> Array:
        ray = mi.Ray3f(mi.Point3f(to_vectors(start)), mi.Vector3f(to_vectors(heading)))
        met = part.ray_intersect_preliminary(ray, coherent=False)
        return np.array(dr.select(met.is_valid(), met.t, dr.inf), float)

    found = by_rows(distance, start_mm, np.broadcast_to(heading, start_mm.shape))
    met = np.isfinite(found)
    return start_mm[met] + found[met, None] * heading


def _in_front(part: Any, nodes_mm: Array, up: Array, cell_mm: float) -> NDArray[np.bool_]:
    """Which nodes (N, 3) of the solid are not behind the part's surface, as the sensor sees it."""

    def in_front(nodes_mm: Array, up: Array) -> NDArray[np.bool_]:
        origin, heading = mi.Point3f(to_vectors(nodes_mm)), mi.Vector3f(to_vectors(up))
        covered = part.ray_test(mi.Ray3f(origin, heading))
        below = mi.Ray3f(origin, -heading)
        below.maxt = dr.opaque(mi.Float, cell_mm, len(nodes_mm))
        return np.array(~(covered | part.ray_test(below)), bool)

    return by_rows(in_front, nodes_mm, np.broadcast_to(up, nodes_mm.shape))


@lru_cache(maxsize=4)
def solid_in_file(file: Path, modified: int) -> Solid | None:
    """The solid that a field's file marks; None if it marks none."""
    air = read_field_file(file, 532.0)
    return _solid(air.solid, air.origin_mm, air.spacing_mm, tuple(air.mirror))


def solid_of(field: IndexField) -> Solid | None:
    """The solid that a field marks; None if it marks none."""
    return _solid(field.solid, field.origin, field.spacing, field.mirror)


def _solid(
    marked: NDArray[np.bool_] | None, origin_mm: Array, spacing_mm: Array, mirror: tuple[bool, ...]
) -> Solid | None:
    if marked is None or not marked.any():
        return None
    even = [(1, 0) if each else (0, 0) for each in mirror]
    core = ndimage.binary_erosion(np.pad(marked, even, mode="reflect"), border_value=1)
    core = core[tuple(slice(first, None) for first, _ in even)]
    index = np.argwhere(core if core.any() else marked)
    index = index[:: -(-len(index) // _MOST_NODES)]
    around = ndimage.find_objects(marked.astype(np.int8))[0]
    margin = np.ceil(_AROUND_MM / spacing_mm).astype(int)
    cut = tuple(
        slice(max(s.start - more, 0), s.stop + more) for s, more in zip(around, margin, strict=True)
    )
    near = marked[cut]
    level = ndimage.distance_transform_edt(~near, sampling=spacing_mm)
    if not near.all():
        level = level - ndimage.distance_transform_edt(near, sampling=spacing_mm)
    ends = np.array([[s.start - 0.5, s.stop - 0.5] for s in around]).T
    known = origin_mm + ends * spacing_mm
    for axis, (place, even_axis) in enumerate(zip(around, mirror, strict=True)):
        if place.stop == marked.shape[axis]:
            known[1, axis] = np.nan
        if even_axis:
            known[0, axis] = 2.0 * origin_mm[axis] - known[1, axis]
        elif place.start == 0:
            known[0, axis] = np.nan
    return Solid(
        origin_mm + index * spacing_mm,
        level,
        np.array(np.gradient(level, *spacing_mm)),
        origin_mm + np.array([s.start for s in cut]) * spacing_mm,
        spacing_mm,
        mirror,
        origin_mm,
        known,
    )
