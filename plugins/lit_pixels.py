"""Which pixels the laser lights, and what is seen at their centres: the ground truth of a frame."""

from collections.abc import Callable
from dataclasses import dataclass, fields, is_dataclass, replace
from typing import Any

import cv2
import numpy as np
from numpy.typing import NDArray
from virtual_sensor_plugins.laser_line import LaserLineEmitter

from virtual_sensor.engine import dr, mi
from virtual_sensor.optics.illumination import Illumination, LaserFrame

_LATTICE_PX = 16  # displacement is looked at this often to bound it before every pixel is marched
_FAR_MM = 2.0  # refraction is taken to move no light further than this


@dataclass
class Sight:
    """What camera rays see; Dr.Jit arrays over the rays.

    Attributes
    ----------
    point : vector
        Hit point, world, mm.
    heading : vector
        Unit direction of the camera ray there.
    path_mm : scalar
        Length of the ray from the camera.
    hit : mask
    light : Illumination
        The laser's at the points.
    """

    point: Any
    heading: Any
    path_mm: Any
    hit: Any
    light: Illumination


@dataclass
class LitPixels:
    """Pixels that may receive laser light, and what is seen at their centres.

    Attributes
    ----------
    index : ndarray of shape (N,)
        Row-major numbers within the film's crop window.
    sight : Sight
        At the pixels' centres, in the same order.
    """

    index: NDArray[np.uint32]
    sight: Sight


def film_rays(sensor: mi.Sensor, x: Any, y: Any, aperture: Any) -> tuple[Any, Any]:
    """Camera rays and weights through film positions, in px of the whole film (centres at .5)."""
    film = sensor.film()
    offset, size = film.crop_offset(), film.crop_size()
    place = mi.Point2f((x - offset.x) / size.x, (y - offset.y) / size.y)
    return sensor.sample_ray_differential(0.0, 0.5, place, aperture)


def centre_rays(sensor: mi.Sensor, index: Any) -> Any:
    """Camera rays through the centres of pixels."""
    film = sensor.film()
    offset, width = film.crop_offset(), film.crop_size().x
    x, y = mi.Float(index % width) + offset.x + 0.5, mi.Float(index // width) + offset.y + 0.5
    return film_rays(sensor, x, y, mi.Point2f(0.5))[0]


def rows(tree: Any, index: Any) -> Any:
    """Gather some rows of Dr.Jit arrays nested in tuples and dataclasses."""
    if isinstance(tree, tuple):
        return tuple(rows(leaf, index) for leaf in tree)
    if is_dataclass(tree) and not isinstance(tree, type):
        return replace(tree, **{f.name: rows(getattr(tree, f.name), index) for f in fields(tree)})
    return tree if tree is None else dr.gather(type(tree), tree, index)


def find_lit_pixels(
    scene: mi.Scene, sensor: mi.Sensor, emitter: LaserLineEmitter, look: Callable[[Any], Sight]
) -> LitPixels:
    """Find the pixels that the laser reaches, marching no more rays than that takes.

    1. Straight rays of all pixels give each one's laser coordinates without refraction.
    2. Bent rays of a lattice of pixels bound how far refraction moves these.
    3. Bent rays of the pixels within that bound tell which are lit; their neighbours count too.
    """
    width, height = (int(n) for n in sensor.film().crop_size())
    a, b, pixel_mm = _straight_coordinates(scene, sensor, emitter)
    every = np.arange(width * height, dtype=np.uint32)
    on_lattice = (every % width % _LATTICE_PX == 0) & (every // width % _LATTICE_PX == 0)
    near = every[on_lattice & _reached(emitter, a, b, (_FAR_MM, _FAR_MM))]
    margin = (pixel_mm, pixel_mm)
    if near.size:
        seen = look(centre_rays(sensor, mi.UInt32(near)))
        margin = (
            pixel_mm + _largest(seen.light.a.numpy() - a[near]),
            pixel_mm + _largest(seen.light.b.numpy() - b[near]),
        )
    # A pixel whose centre looks past an edge may see light beside it: neighbours are candidates too.
    candidates = every[_grown(_reached(emitter, a, b, margin), height, width)]
    if not candidates.size:
        candidates = every[:1]  # Dr.Jit knows no empty array
    sight = look(centre_rays(sensor, mi.UInt32(candidates)))
    dr.eval(sight)
    lit = np.zeros(width * height, bool)
    lit[candidates] = emitter.reaches(sight.light.a, sight.light.b, (pixel_mm, pixel_mm)).numpy()
    keep = np.flatnonzero(_grown(lit, height, width)[candidates]).astype(np.uint32)
    if not keep.size:
        keep = np.zeros(1, np.uint32)
    return LitPixels(candidates[keep], rows(sight, mi.UInt32(keep)))


def _straight_coordinates(
    scene: mi.Scene, sensor: mi.Sensor, emitter: LaserLineEmitter
) -> tuple[NDArray[np.float32], NDArray[np.float32], float]:
    """Straight laser coordinates (a, b) in mm at all pixels' centres, and a pixel's size there."""
    size = sensor.film().crop_size()
    ray = centre_rays(sensor, dr.arange(mi.UInt32, size.x * size.y))
    met = scene.ray_intersect_preliminary(ray)
    frame = LaserFrame.of(emitter.line, mi.Array3f)
    a, b = frame.straight(mi.Array3f(ray(met.t)))
    missed = ~met.is_valid()
    a[missed], b[missed] = dr.nan, dr.nan
    spread = dr.norm(ray.d_x - ray.d) * dr.select(missed, 0.0, met.t)
    return a.numpy(), b.numpy(), float(dr.max(spread)[0])


def _largest(moved_mm: NDArray[np.floating]) -> float:
    """A bound for displacements between the ones looked at."""
    found = np.abs(moved_mm[np.isfinite(moved_mm)])
    return min(1.25 * float(np.max(found, initial=0.0)), _FAR_MM)


def _reached(
    emitter: LaserLineEmitter, a: Any, b: Any, margin_mm: tuple[float, float]
) -> NDArray[np.bool_]:
    return np.asarray(emitter.reaches(mi.Float(a), mi.Float(b), margin_mm).numpy(), bool)


def _grown(mask: NDArray[np.bool_], height: int, width: int) -> NDArray[np.bool_]:
    """The pixels of a mask and their neighbours."""
    image = mask.astype(np.uint8).reshape(height, width)
    return cv2.dilate(image, np.ones((3, 3), np.uint8)).ravel() > 0
