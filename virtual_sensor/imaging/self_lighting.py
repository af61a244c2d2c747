"""How much of a source's light a part throws onto itself: an estimate, before a frame is rendered.

Straight rays of the source are followed to the part, and on by one ray each that the surface's
reflection draws.  What these meet of the part again is seen as a ghost.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import NDArray

from virtual_sensor.arrays import GOLDEN, in_own_memory, to_numpy, to_vectors
from virtual_sensor.devices.laser import LaserLine
from virtual_sensor.display import Displayed
from virtual_sensor.engine import dr, mi
from virtual_sensor.imaging.checks import FAINT
from virtual_sensor.imaging.scene import Scene
from virtual_sensor.medium.index_field import IndexField
from virtual_sensor.optics.surfaces import slab

Array = NDArray[np.float64]

_RAYS = 1 << 14
_PLASTIC = 0.7548776662466927
_NEAR_MM = 1.0  # before the shapes' box rays start: float32 hits from there are good to 0.03 um
_COLUMNS = _ROWS = 32  # bins of the image in which the light of line and ghosts is gathered
_WORST = 0.1  # of the line's columns
_STEPS = 8  # of a segment along which the air's gradient is added up
_MOST = 0.95  # of the ghosts' light lies no farther off


@dataclass(frozen=True)
class SelfLighting(Displayed):
    """Light of a scene's sources that meets the part a second time.

    Attributes
    ----------
    share : float
        Of the light that the part reflects.
    ghost_over_line : float
        How bright ghosts are beside the line, about, in a tenth of its columns; NaN of a projector.
    bent_px : float
        By how much the air bends light between the two surfaces, in the image, for nearly all of
        it; 0 without a field, NaN where no light takes such a way.
    """

    share: float
    ghost_over_line: float
    bent_px: float


def self_lighting(scene: Scene) -> SelfLighting:
    """Estimate what a scene's light does on its second way; some hundredths of a second."""
    found = [_of_source(scene, source) for source in scene.sources.values()]
    return SelfLighting(*(float(np.fmax.reduce(each)) for each in zip(*found, strict=True)))


def _of_source(scene: Scene, source: Any) -> tuple[float, float, float]:
    """The three figures of `SelfLighting` for one source."""
    number = np.arange(_RAYS)
    low, high = source.extent
    u = np.stack([(number * GOLDEN + 0.5) % 1.0, (number + 0.5) / _RAYS], axis=1)
    s, t = (low + u * (high - low)).T
    origin, direction = source.family.rays(s, t)
    loaded, context = scene.mitsuba, mi.BSDFContext()
    heading = mi.Vector3f(to_vectors(direction))
    lit = _met(loaded, mi.Point3f(to_vectors(origin)), heading)
    depth = source.family.coordinates(to_numpy(lit.p))[:, 2]
    power = np.where(np.array(lit.is_valid()), source.flux(s, t, depth), 0.0)
    drawn = [
        in_own_memory((number * step % 1.0).astype(np.float32), mi.Float)
        for step in (_PLASTIC, GOLDEN**2, _PLASTIC**2)
    ]
    bsdf = lit.bsdf()
    sample, weight = bsdf.sample(context, lit, drawn[0], mi.Point2f(*drawn[1:]), lit.is_valid())
    reflected = power * np.array(dr.mean(weight, axis=0), float)
    onward = lit.spawn_ray(lit.to_world(sample.wo))
    again = loaded.ray_intersect(onward, lit.is_valid() & dr.any(weight != 0.0))
    met = np.array(again.is_valid())
    twice = np.where(met, reflected, 0.0)
    share = float(twice.sum() / reflected.sum()) if reflected.sum() > 0.0 else 0.0
    if not share:
        return 0.0, 0.0, np.nan
    over = np.nan
    if isinstance(source, LaserLine):
        over = _ghost_over_line(scene, source, _seen(scene, lit, power), _seen(scene, again, twice))
    if scene.medium is None:
        return share, over, 0.0
    first, last = to_numpy(lit.p)[met], to_numpy(again.p)[met]
    bent_mm = _bent_mm(scene.medium, first, last)
    order = np.argsort(bent_mm)
    below = np.cumsum(twice[met][order])
    at = int(np.searchsorted(below, _MOST * below[-1]))
    pixel_mm = float(np.median(scene.camera.pixel_mm(last)))
    return share, over, float(bent_mm[order[min(at, len(order) - 1)]] / pixel_mm)


def _met(loaded: Any, origin: Any, heading: Any) -> Any:
    """What straight rays meet, started close to the shapes."""
    box = loaded.bbox()
    enters, _ = slab(origin, heading, (mi.Point3f(box.min), mi.Point3f(box.max)))
    start = dr.maximum(enters - _NEAR_MM, 0.0)
    return loaded.ray_intersect(mi.Ray3f(origin + heading * start, heading))


def _ghost_over_line(scene: Scene, laser: LaserLine, line: Array, ghost: Array) -> float:
    """By the light of columns' bins: that of the line lies in rows as wide as it, a ghost's in all.

    So bright or brighter are ghosts in a tenth of the columns that have a line.
    """
    in_line = line.sum(axis=0)
    columns = in_line > FAINT * in_line.max()
    if not columns.any():
        return np.nan
    middle = laser.target_mm[None]
    radius_px = float(laser.working_radius_mm / scene.camera.pixel_mm(middle)[0])
    per_row = in_line[columns] / (np.sqrt(np.pi / 2.0) * max(radius_px, 1.0))
    rows = scene.camera.size[1] / _ROWS
    over = ghost[:, columns].max(axis=0) / rows / per_row
    return float(np.quantile(over, 1.0 - _WORST))


def _seen(scene: Scene, at: Any, power: Array) -> Array:
    """Light that goes from points with so much power to the camera, in bins of its image."""
    loaded, camera = scene.mitsuba, scene.camera
    points = to_numpy(at.p)
    away = camera.pose.origin_mm - points
    square = np.sum(away**2, axis=1)
    to_camera = mi.Vector3f(to_vectors(np.nan_to_num(away / np.sqrt(square)[:, None])))
    valid = at.is_valid() & (in_own_memory(power.astype(np.float32), mi.Float) > 0.0)
    value = at.bsdf().eval(mi.BSDFContext(), at, at.to_local(to_camera), valid)
    hidden = loaded.ray_test(at.spawn_ray(to_camera), valid)
    seen = np.array(valid) & ~np.array(hidden)
    light = power * np.array(dr.mean(value, axis=0), float) / square * seen
    pixel = camera.project(points)
    inside = camera.inside(pixel) & (light > 0.0)
    width, height = camera.size
    edges = ((-0.5, height - 0.5), (-0.5, width - 0.5))
    u, v = pixel[inside].T
    gathered, *_ = np.histogram2d(v, u, (_ROWS, _COLUMNS), edges, weights=light[inside])
    return gathered


def _bent_mm(field: IndexField, first: Array, last: Array) -> Array:
    """How far the air moves light that starts at points (N, 3) towards others, where it arrives."""
    way = last - first
    length = np.linalg.norm(way, axis=1, keepdims=True)
    unit = way / np.maximum(length, 1e-9)
    shift = np.zeros_like(first)
    for step in (np.arange(_STEPS) + 0.5) / _STEPS:
        gradient = field.gradient(first + step * way)
        across = gradient - np.sum(gradient * unit, axis=1, keepdims=True) * unit
        shift += across * (1.0 - step) * length**2 / _STEPS
    return np.linalg.norm(shift, axis=1)
