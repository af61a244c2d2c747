"""Which pixel sees a source's light through bent air: the paper's search, and Newton's.

Beermann et al. 2018, section 4.2: a laser ray is traced to its incidence point B_l; then the
camera's pixel is sought whose bent line of sight meets the surface there.  A projector in the
laser's place (section 7) has its pixels' rays traced instead.  Everything is float64 and batched
over all rays at once.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass, replace
from pathlib import Path
from typing import ClassVar

import numpy as np
from numpy.typing import ArrayLike, NDArray

from virtual_sensor.arrays import (
    SMALLEST,
    number_within,
    numbers_of,
    one_of,
    points_of,
    whole_number,
)
from virtual_sensor.calls import public
from virtual_sensor.display import Displayed, listed, span, tally
from virtual_sensor.errors import InputError, naming, short
from virtual_sensor.optics.map_search import tabulated_roots
from virtual_sensor.optics.newton_search import Roots, newton, newton_along_line
from virtual_sensor.optics.ray_families import Pinhole
from virtual_sensor.optics.ray_maps import NoMapError
from virtual_sensor.optics.rays import March
from virtual_sensor.optics.sight import (
    REFERENCE,
    SearchScene,
    check_progress,
    chosen,
    incidence_points,
    pixel_family,
    scene_of,
    seen_points,
    with_projector,
)
from virtual_sensor.statuses import StatusEnum

__all__ = [
    "REFERENCE",
    "FoundPixels",
    "March",
    "SearchScene",
    "SearchStatus",
    "incidence_points",
    "ray_search",
]

Array = NDArray[np.float64]

METHODS = ("paper", "newton", "tabulated")

_MOST_STEPS = 1000  # of the paper's search: its step is halved in each
_LEAN = 5e-3  # a bent line of sight leans from the straight one by some milliradians


class SearchStatus(StatusEnum):
    """How the search for a ray of laser or projector ended."""

    FOUND = 0, "The pixel is good to r_max."
    ABOVE_RADIUS = (
        1,
        "The best pixel's distance is above r_max, the paper's first warning: allow more steps "
        "(k_stop), or search by newton.",
    )
    UNDERCUT = (
        2,
        "The pixel sees something else in front of the point, or behind it, and is not used: the "
        "part hides the point from the camera.",
    )
    LASER_MISSED = 3, "The ray meets no surface: choose a y, or a pixel, at which the part is."
    OUTSIDE_IMAGE = (
        4,
        "The pixel would lie outside the sensor: choose a ray within the camera's view.",
    )
    UNLIT = (
        5,
        "No light is sent along this ray, beyond the line, at no dot or beside the projector's "
        "image: choose a y on the line (line_length, dots), or a pixel of the image.",
    )


@dataclass(frozen=True)
class FoundPixels(Displayed):
    """What a search found, one row per ray of laser or projector.

    Attributes
    ----------
    laser_point_mm : ndarray of shape (N, 3)
        Incidence point on the surface, world: the paper's A (cold) or B (hot); NaN if missed
        or unlit.
    pixel : ndarray of shape (N, 2)
        (u, v) that sees it; NaN unless FOUND, or ABOVE_RADIUS and within z_max.
    seen_point_mm : ndarray of shape (N, 3)
        Where that pixel's line of sight meets the surface: B_k,min.
    distance_um : ndarray of shape (N,)
        Between the two, parallel to the sensor: h_d_min.
    iterations : ndarray of shape (N,)
        Marches of the camera's ray that were spent, those with longer steps not counted.
    status : ndarray of shape (N,)
        `SearchStatus`.
    """

    _field_units: ClassVar = {"pixel": "px"}
    _statuses: ClassVar = {"status": SearchStatus}
    _by_row: ClassVar = True

    laser_point_mm: Array
    pixel: Array
    seen_point_mm: Array
    distance_um: Array
    iterations: NDArray[np.int64]
    status: NDArray[np.int64]

    def _line(self) -> str:
        return listed(
            tally(self.status, SearchStatus.FOUND),
            span("columns", self.pixel[:, 0]),
            span("rows", self.pixel[:, 1]),
        )


@public
def ray_search(
    scene: SearchScene | str | Path,
    laser_y_mm: ArrayLike | None = None,
    method: str = "paper",
    *,
    projector_pixel: ArrayLike | None = None,
    grid_px: tuple[float, float] = (32.0, 32.0),
    k_stop: int = 15,
    r_max_um: float = 1.0,
    z_max_mm: float = 0.1,
    march: March | None = None,
    tolerance_px: float = 1e-3,
    camera: str | None = None,
    source: str | None = None,
    progress: Callable[[float], None] | None = None,
) -> FoundPixels:
    """Find the pixels that see the incidence points of a laser's or projector's rays.

    Parameters
    ----------
    scene : Scene, str or Path
        From `load_scene`, or its name or path.
    laser_y_mm : array_like of shape (N,)
        Of a laser: positions of the rays along the line, in its reference plane (the paper's
        discharge locations y).
    method : str
        "paper": step 2 of section 4.2 to the letter.  "newton": the same root by Newton's method,
        to 1e-6 px on the shipped field.  "tabulated": by ray maps, which take
        a while to make and then serve any number of rays; rays that they don't hold are searched
        by Newton's method.
    projector_pixel : array_like of shape (N, 2)
        Of a projector, in the place of `laser_y_mm`: its pixels (u, v), integers at their centres.
    grid_px : tuple of float
        Width and height of the paper's search grid, w_sg and h_sg.
    k_stop : int
        The paper's largest number of steps.
    r_max_um, z_max_mm : float
        Largest distance parallel to the sensor, and along the camera's axis, that are accepted.
    march : March, optional
        How all rays are marched; by default as `REFERENCE` is.  Newton's search then is faster for
        thousands of laser points than one by one (`newton_along_line`).  Maps choose their own.
    tolerance_px : float
        Of the maps of "tabulated".
    camera, source : str, optional
        Names of the scene's, where it has several.
    progress : callable, optional
        Called with the fraction of the whole that is done, at the paper's steps.

    Returns
    -------
    FoundPixels

    Raises
    ------
    InputError
        If the method is neither, a number can't be searched with, or the source is not of the kind
        whose rays are given.
    """
    if (laser_y_mm is None) == (projector_pixel is None):
        raise InputError(
            "ray_search: give either laser_y_mm, of a laser, or projector_pixel, of a projector"
        )
    loaded: SearchScene = scene_of("ray_search", scene)
    if projector_pixel is None:
        scene = chosen(loaded, camera, source)
    else:
        with naming("ray_search: projector_pixel"):
            scene = with_projector(loaded, camera, source)
    check_progress("ray_search", progress)
    progress = progress or (lambda fraction: None)
    one_of("ray_search: method", method, METHODS)
    seeing = scene.camera
    if laser_y_mm is not None:
        if hasattr(scene.source, "pixels_of"):
            raise InputError(
                "ray_search: laser_y_mm is of a laser, and the source is a projector; give"
                " projector_pixel"
            )
        s, t = _on_line(laser_y_mm)
    elif projector_pixel is not None:
        s, t = _of_pixels(scene, projector_pixel)
    whole_number("ray_search: k_stop", k_stop, 1, _MOST_STEPS)
    grid = numbers_of("ray_search: grid_px", grid_px)
    if grid.shape != (2,) or not np.all((grid > 0.0) & (grid < np.inf)):
        raise InputError(f"ray_search: grid_px must be two positive numbers of px, not {grid_px}")
    limits = {"r_max_um": r_max_um, "z_max_mm": z_max_mm, "tolerance_px": tolerance_px}
    for name, value in limits.items():
        number_within(f"ray_search: {name}", value, SMALLEST, np.inf, "a positive number")
    if march is not None and not isinstance(march, March):
        raise InputError(f"ray_search: march is {short(march)}; give a March, or leave it out")
    (march or REFERENCE).check(scene.medium)
    progress(0.0)
    if method == "paper":
        found = _paper(scene, s, t, grid_px, k_stop, r_max_um, march or REFERENCE, progress)
    elif method == "newton":
        found = _found(scene, _newton(scene, s, t, march))
    else:
        found = _found(scene, _tabulated(scene, s, t, march, tolerance_px))
    lit = scene.source.reaches(s, t)
    return _checked(seeing, found, lit, r_max_um, z_max_mm)


def _on_line(laser_y_mm: ArrayLike) -> tuple[Array, Array]:
    """Coordinates (N,) of rays in the middle of a laser's sheet; NaN of what is not finite."""
    t = np.atleast_1d(numbers_of("ray_search: laser_y_mm", laser_y_mm))
    if t.ndim > 1:
        raise InputError(f"ray_search: laser_y_mm has the shape {t.shape}; give a list, (N,)")
    return np.zeros(t.shape), np.where(np.isfinite(t), t, np.nan)


def _of_pixels(scene: SearchScene, projector_pixel: ArrayLike) -> tuple[Array, Array]:
    """Coordinates (N,) of the rays of a projector's pixels (N, 2); NaN of what is not finite."""
    pixel = points_of("ray_search: projector_pixel", projector_pixel, 2)
    if pixel.ndim != 2 or pixel.shape[1] != 2:
        raise InputError(
            f"ray_search: projector_pixel has the shape {pixel.shape}; give it (N, 2), (u, v) each"
        )
    return pixel_family("ray_search", scene).of_pixels(pixel)


def _paper(
    scene: SearchScene,
    s: Array,
    t: Array,
    grid_px: tuple[float, float],
    k_stop: int,
    r_max_um: float,
    march: March,
    progress: Callable[[float], None],
) -> FoundPixels:
    """Section 4.2, step 1 and step 2: halve the step, keep the best."""
    camera = scene.camera
    target = incidence_points(scene, t, march, s)
    pixel = camera.project(target)  # 2.1: the start pixel u_s
    best = FoundPixels(
        target,
        pixel,
        np.full_like(target, np.nan),
        np.full(len(target), np.inf),
        np.zeros(len(target), int),
        np.zeros(len(target), int),
    )
    toward = np.ones_like(pixel)  # signs of h_delta_B_xy,min
    for k in range(1, k_stop + 1):
        searching = np.isfinite(target[:, 0]) & ~(best.distance_um < r_max_um)
        if not searching.any():
            break
        progress((k - 1) / k_stop)
        seen = np.full_like(target, np.nan)
        seen[searching] = seen_points(scene, pixel[searching], march)  # 2.3
        delta = ((seen - target) @ camera.pose.rotation)[:, :2] * 1e3
        distance = np.linalg.norm(delta, axis=1)  # 2.4
        better = searching & (distance < best.distance_um)
        best = replace(
            best,
            pixel=np.where(better[:, None], pixel, best.pixel),
            seen_point_mm=np.where(better[:, None], seen, best.seen_point_mm),
            distance_um=np.where(better, distance, best.distance_um),
            iterations=np.where(searching, k, best.iterations),
        )
        toward = np.where(better[:, None], delta, toward)
        step = np.array(grid_px) / 2.0**k  # 2.5
        pixel = best.pixel + np.where(toward <= 0.0, step, -step)
    return best


def _newton(scene: SearchScene, s: Array, t: Array, march: March | None) -> Roots:
    if march is None and not s.any():
        return newton_along_line(scene, t)
    return newton(scene, t, march or REFERENCE, s)


def _tabulated(
    scene: SearchScene, s: Array, t: Array, march: March | None, tolerance_px: float
) -> Roots:
    """Roots by maps, and by Newton's method where those don't hold a ray."""
    try:
        roots, mapped = tabulated_roots(scene, s, t, tolerance_px)
    except NoMapError:
        return _newton(scene, s, t, march)
    if not mapped.all():
        roots.put(~mapped, _newton(scene, s[~mapped], t[~mapped], march))
    return roots


def _found(scene: SearchScene, roots: Roots) -> FoundPixels:
    """Roots with how far from the incidence point the surface is that their pixels see."""
    delta = (roots.seen - roots.target) @ scene.camera.pose.rotation[:, :2] * 1e3
    distance = np.linalg.norm(delta, axis=1)
    status = np.zeros(len(distance), int)
    return FoundPixels(roots.target, roots.pixel, roots.seen, distance, roots.marches, status)


def _checked(
    camera: Pinhole,
    found: FoundPixels,
    lit: NDArray[np.bool_],
    r_max_um: float,
    z_max_mm: float,
) -> FoundPixels:
    """Step 3.1: the quality check. Rays without light have no figures.

    A point too far along the camera's axis is not used.  It is an undercut if the search did
    arrive: the points coincide parallel to the sensor, or lie on one line of sight.
    """
    delta = (found.seen_point_mm - found.laser_point_mm) @ camera.pose.rotation
    depth_um = np.abs(delta[:, 2]) * 1e3
    near = depth_um <= z_max_mm * 1e3
    apart_px = camera.project(found.seen_point_mm) - camera.project(found.laser_point_mm)
    um_per_px = camera.pixel_mm(found.laser_point_mm) * 1e3
    apart_um = np.linalg.norm(apart_px, axis=1) * um_per_px
    in_line = apart_um <= r_max_um + _LEAN * depth_um
    close = found.distance_um <= r_max_um
    missed = np.isnan(found.laser_point_mm[:, 0])
    reasons = {
        SearchStatus.LASER_MISSED: missed,
        SearchStatus.UNLIT: ~lit,
        SearchStatus.OUTSIDE_IMAGE: ~camera.inside(found.pixel),
        SearchStatus.UNDERCUT: ~near & (in_line | close),
        SearchStatus.ABOVE_RADIUS: ~close,
    }
    status = np.select(list(reasons.values()), list(reasons), SearchStatus.FOUND)
    used = near & np.isin(status, (SearchStatus.FOUND, SearchStatus.ABOVE_RADIUS))
    return FoundPixels(
        np.where(lit[:, None], found.laser_point_mm, np.nan),
        np.where(used[:, None], found.pixel, np.nan),
        np.where(lit[:, None], found.seen_point_mm, np.nan),
        np.where(lit & ~missed, found.distance_um, np.nan),
        np.where(lit, found.iterations, 0),
        status,
    )
