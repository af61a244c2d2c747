"""Newton's search for the pixels that see laser points, and its short cut along a long line.

Long steps find the root and its slopes first.  They err by a thousandth of a pixel, so that one or
two fine marches are left to make.  Along a line of thousands of rays even those are made for some
only: by how much long steps err is a smooth function of the place along the line, and a small one.
"""

from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray

from virtual_sensor.arrays import determinant, solved
from virtual_sensor.display import Displayed
from virtual_sensor.optics.rays import March
from virtual_sensor.optics.sight import (
    REFERENCE,
    SearchScene,
    incidence_points,
    misses,
    seen_points,
)
from virtual_sensor.optics.surfaces import SceneSurface

Array = NDArray[np.float64]
Mask = NDArray[np.bool_]

MANY = 2000
"""So many laser rays lie close enough for the short cut."""

# Levels of the march, coarse to fine: step in mm (2e-3 and 1e-5 px off on the shipped field), and
# the number of nodes at which its error is determined.
_LEVELS = ((2.0, 2001), (0.5, 301))
_GAIN = 4.0  # at least so much less do cubics err when their nodes are doubled
_ALLOWED_PX = 1e-6  # estimate of what is interpolated wrongly
_NEAR_MM = 0.01  # a point farther from where it is expected lies behind an edge, or is hidden
_LINEAR_PX = 1e-3  # so near the root the slopes do: they are good to 1e-4
_NUDGE_PX = 0.01  # for slopes
_SETTLED_PX = 1e-5  # what remains is this times the slopes' error
_MOST_MARCHES = 8
_FOUND_PX = 1e-4  # by which a root may be missed at most


@dataclass(frozen=True)
class Roots(Displayed):
    """Pixels whose lines of sight meet incidence points, one row per ray of the source.

    Attributes
    ----------
    target : ndarray of shape (N, 3)
        Where the source's ray meets the surface, world, mm; NaN if it misses.
    pixel : ndarray of shape (N, 2)
    slopes : ndarray of shape (N, 2, 2)
        Derivative by the pixel of where its line of sight goes, parallel to the sensor, mm/px.
    seen : ndarray of shape (N, 3)
        What the line of sight meets, mm: the target, or what hides it; NaN if nothing.
    marches : ndarray of shape (N,)
        Fine marches of the camera's ray.
    """

    target: Array
    pixel: Array
    slopes: Array
    seen: Array
    marches: NDArray[np.int64]

    def put(self, rows: Mask, better: "Roots") -> None:
        """Put other roots in the place of some rows."""
        for values, others in zip(vars(self).values(), vars(better).values(), strict=True):
            values[rows] = others


def newton(scene: SearchScene, t: Array, march: March, s: Array | float = 0.0) -> Roots:
    """Search by Newton's method, all marches of the result being those asked for.

    Parameters
    ----------
    scene : SearchScene
    t : ndarray of shape (N,)
        Second coordinates of the source's rays: their places along a laser line, mm.
    march : March
    s : ndarray of shape (N,) or float
        Their first coordinates: 0, the middle of a laser's sheet.
    """
    target = incidence_points(scene, t, march, s)
    pixel, slopes, marches = _roots(scene, target, march)
    seen = seen_points(scene, pixel, march)
    known = np.isfinite(target[:, 0])
    return Roots(target, pixel, slopes, seen, np.where(known, marches + 1, 0))


def marched_pixels(scene: SearchScene, points: Array, march: March = REFERENCE) -> Array:
    """Pixels (N, 2) whose marched lines of sight go through points (N, 3), whatever hides them.

    NaN where Newton's method does not settle, or only where lines of sight are turned over beside
    straight ones: beyond a caustic (see `ray_maps`).
    """
    camera = scene.camera
    pixel, slopes, _ = _roots(scene, points, march)
    left = _step(slopes, misses(scene, points, pixel, march))
    s, t, depth = camera.coordinates(points).T
    straight = np.stack(np.broadcast_arrays(*camera.by_coordinates(s, t, depth)), axis=-1)
    with np.errstate(all="ignore"):
        bent = (slopes @ camera.pixel_slopes(s, t)).reshape(-1, 4).T
        (a, c), (b, d) = (solved(straight.T, *each) for each in (bent[[0, 2]], bent[[1, 3]]))
    area, trace = determinant((a, b, c, d)), a + d
    found = (np.abs(left).max(axis=1) <= _FOUND_PX) & (area > 0.0) & (trace > 0.0)
    return np.where(found[:, None], pixel, np.nan)


def newton_along_line(
    scene: SearchScene, b: Array, levels: tuple[tuple[float, int], ...] = _LEVELS
) -> Roots:
    """Search by Newton's method with `REFERENCE`, with fine marches at some places b only.

    Every ray is marched with long steps, to the surface and back, from where its neighbours predict
    that its pixel is: what is seen is off by some 1e-5 px, and one of Newton's steps, without a
    march, puts the pixel right.  By how much long steps err is interpolated between nodes, which
    are searched likewise on the finer `levels`.  Rays where that is not good to 1e-6 px by
    an estimate, or that see something else than their point, are searched with `newton`; and so
    are all where hits are rounded to float32.
    """
    rounded = isinstance(scene.surface, SceneSurface)  # the hits: they err by more than long steps
    few = len(b) < MANY or not np.isfinite(b).all() or np.ptp(b) == 0.0
    if scene.medium is None or rounded or few:
        return newton(scene, b, REFERENCE)
    (step_mm, nodes), *finer = levels
    camera, long = scene.camera, _steps_of(step_mm)
    at = np.linspace(b.min(), b.max(), nodes)
    table, settled = _long_steps(scene, at, long, tuple(finer))
    interval = np.clip(np.searchsorted(at, b) - 1, 0, len(settled) - 1)
    known = np.where(settled[interval, None], _interpolated(at, table, b), np.nan)
    expected, bent_px, slopes, target_off, pixel_off = np.split(known, [3, 5, 9, 12], axis=1)
    slopes = slopes.reshape(-1, 2, 2)
    target = incidence_points(scene, b, long)
    start = camera.project(target) + bent_px
    seen = seen_points(scene, start, long)

    away = (target - seen) @ camera.pose.rotation
    sight = camera.lines_of_sight(np.nan_to_num(start)) @ camera.pose.rotation
    change = _step(slopes, away[:, :2] - sight[:, :2] * (away[:, 2] / sight[:, 2])[:, None])
    linear = np.abs(change).max(axis=1) <= _LINEAR_PX
    near = np.linalg.norm(np.stack([away, target - expected]), axis=2).max(axis=0) <= _NEAR_MM
    off = ~(linear & near)  # NaN too
    pixel, marches = start + change + pixel_off, np.zeros(len(b), int)
    found = Roots(target + target_off, pixel, slopes, seen + target_off, marches)
    if off.any():
        found.put(off, newton(scene, b[off], REFERENCE))
    return found


def _long_steps(
    scene: SearchScene, b: Array, long: March, finer: tuple[tuple[float, int], ...]
) -> tuple[Array, Mask]:
    """What long steps find of rays at b (N,), and by how much they err.

    Returns
    -------
    rows : ndarray of shape (N, 14)
        Where the laser goes by long steps (3), how far the pixel is from the straight projection
        (2), the slopes (4); what the target (3) and the pixel (2) lack.
    settled : ndarray of shape (N - 1,)
        Between which nodes cubics through these rows hold.
    """
    target = incidence_points(scene, b, long)
    if finer:
        fine = newton_along_line(scene, b, finer)
        fine_target, fine_pixel, slopes = fine.target, fine.pixel, fine.slopes
    else:
        fine_target = incidence_points(scene, b, REFERENCE)
        fine_pixel, slopes = _rough_roots(scene, fine_target, _rough(long))
        for march in (long, REFERENCE):
            fine_pixel, _ = _chords(scene, fine_target, fine_pixel, slopes, march, most=1)
    pixel, _ = _chords(scene, target, fine_pixel, slopes, long, most=1)
    target_off, pixel_off = fine_target - target, fine_pixel - pixel
    # Every other node predicts the one between: cubics through all of them err less.
    mm_per_px = np.linalg.norm(slopes.reshape(-1, 4), axis=1) / np.sqrt(2.0)
    both = np.concatenate([pixel_off, target_off / mm_per_px[:, None]], axis=1)
    between = (9.0 * (both[2:-4] + both[4:-2]) - both[:-6] - both[6:]) / 16.0
    wrong = np.abs(between - both[3:-3]).max(axis=1)
    wrong = np.pad(wrong, 3, mode="edge") / _GAIN
    settled = np.maximum(wrong[:-1], wrong[1:]) <= _ALLOWED_PX  # not so beside NaN
    bent_px = pixel - scene.camera.project(target)
    rows = target, bent_px, slopes.reshape(-1, 4), target_off, pixel_off
    return np.concatenate(rows, axis=1), settled


def _steps_of(step_mm: float) -> March:
    """The reference's march with other steps: the same kernels."""
    return replace(REFERENCE, step_mm=step_mm)


def _rough(march: March) -> March:
    """The march with long steps."""
    return replace(march, step_mm=max(march.step_mm, _LEVELS[0][0]))


def _roots(scene: SearchScene, target: Array, march: March) -> tuple[Array, Array, int]:
    """Pixels (N, 2) of points (N, 3), the slopes there (N, 2, 2), and how many marches it took."""
    pixel, slopes = _rough_roots(scene, target, _rough(march))
    pixel, marches = _chords(scene, target, pixel, slopes, march)
    return pixel, slopes, marches


def _rough_roots(scene: SearchScene, target: Array, rough: March) -> tuple[Array, Array]:
    """Two of Newton's steps from the straight projection: pixels (N, 2), and slopes (N, 2, 2)."""
    pixel = scene.camera.project(target)
    nudges = _NUDGE_PX * np.array([[[0.0, 0.0]], [[1.0, 0.0]], [[0.0, 1.0]]])
    for _ in range(2):
        three = (pixel + nudges).reshape(-1, 2)
        miss, by_u, by_v = misses(scene, np.tile(target, (3, 1)), three, rough).reshape(3, -1, 2)
        slopes = np.stack([miss - by_u, miss - by_v], axis=-1) / _NUDGE_PX
        pixel = pixel + _step(slopes, miss)
    return pixel, slopes


def _chords(
    scene: SearchScene,
    target: Array,
    pixel: Array,
    slopes: Array,
    march: March,
    most: int = _MOST_MARCHES,
) -> tuple[Array, int]:
    """Newton's method with slopes that stay: the pixels, and how many marches it took."""
    marches, change = 0, np.array([np.inf])
    while marches < most and np.nanmax(np.abs(change), initial=0.0) > _SETTLED_PX:
        change = _step(slopes, misses(scene, target, pixel, march))
        pixel = pixel + change
        marches += 1
    return pixel, marches


def _step(slopes: Array, miss: Array) -> Array:
    """Solve slopes @ step = miss, (N, 2, 2) and (N, 2); NaN where it can't be."""
    with np.errstate(divide="ignore", invalid="ignore"):
        return np.stack(solved(slopes.reshape(-1, 4).T, *miss.T), axis=-1)


def _interpolated(x: Array, values: Array, at: Array) -> Array:
    """Cubics through four rows each of values (N, C) at rising x (N,); NaN beside a NaN."""
    first = np.clip(np.searchsorted(x, at) - 2, 0, len(x) - 4)
    four = first[:, None] + np.arange(4)
    nodes = x[four]
    result = np.zeros((len(at), values.shape[1]))
    for k in range(4):
        others = np.delete(nodes, k, axis=1)
        weight = np.prod((at[:, None] - others) / (nodes[:, [k]] - others), axis=1)
        result += weight[:, None] * values[four[:, k]]
    return result
