"""Which projector pixel lights what a camera pixel sees: the reference for decoded fringes.

A pixel's line of sight is marched to the surface; the projector's ray through the point found is
sought by Newton's method on marched rays, as the camera's is in `projection`: camera and projector
are the same family, turned round.  Everything is float64; no image is rendered.
"""

from __future__ import annotations

from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any, ClassVar

import numpy as np
from numpy.typing import ArrayLike, NDArray

from virtual_sensor.arrays import points_of
from virtual_sensor.calls import public
from virtual_sensor.display import Displayed, listed, span, tally
from virtual_sensor.errors import InputError, short
from virtual_sensor.optics.illumination import CLEARANCE_MM
from virtual_sensor.optics.newton_search import marched_pixels
from virtual_sensor.optics.rays import Field, March
from virtual_sensor.optics.sight import (
    REFERENCE,
    SearchScene,
    pixel_family,
    scene_of,
    seen_points,
    with_projector,
)
from virtual_sensor.optics.sources import Source
from virtual_sensor.optics.surfaces import Surface
from virtual_sensor.statuses import StatusEnum

Array = NDArray[np.float64]
Mask = NDArray[np.bool_]

_LONG = replace(REFERENCE, step_mm=2.0)  # where 2e-3 px do, as on the shipped fields
_CORNERS = np.array([[-0.5, -0.5], [0.5, 0.5], [-0.5, 0.5], [0.5, -0.5]])  # opposite ones in pairs

_FEW = 1 << 16  # pixels at once: memory stays bounded
_EDGE = 0.1  # of a pixel's extent in the projector's image: what lies smoothly bends by less


class ProjectorPixelStatus(StatusEnum):
    """Whether a projector pixel was found for a camera's, and if not, why."""

    OK = 0, "The projector's pixel lights what the whole camera pixel sees."
    EDGE = (
        1,
        "An edge of the surface, of a shadow or of the projector's image lies within the pixel, or "
        "the surface bends away: the value is that of its centre, a mean over it is another.",
    )
    SHADOWED = (
        2,
        "Another part of the surface stands in the projector's light: measure from another pose.",
    )
    OUTSIDE = 3, "The point lies beside the projector's image: turn the projector to it."
    MISSED = 4, "The line of sight meets no surface: choose a pixel that sees the part."
    FOLDED = (
        5,
        "A caustic of the projector's light, where more than one ray may light the point, or no "
        "ray was found: leave this pixel out.",
    )
    NO_PIXEL = 6, "The pixel is not finite, or the lens shows nothing there: give numbers."


@dataclass(frozen=True)
class ProjectorPixels(Displayed):
    """What N camera pixels see of a projector's image.

    Attributes
    ----------
    projector_pixel : ndarray of shape (N, 2)
        (u, v) in px of the projector, integers at pixel centres; NaN unless OK or EDGE.
    point_mm : ndarray of shape (N, 3)
        Where the line of sight meets the surface, world; NaN if it misses.
    status : ndarray of shape (N,)
        `ProjectorPixelStatus`.
    """

    _field_units: ClassVar = {"projector_pixel": "px"}
    _statuses: ClassVar = {"status": ProjectorPixelStatus}
    _by_row: ClassVar = True

    projector_pixel: Array
    point_mm: Array
    status: NDArray[np.uint8]

    def _line(self) -> str:
        return listed(
            tally(self.status, ProjectorPixelStatus.OK),
            span("columns", self.projector_pixel[..., 0]),
            span("rows", self.projector_pixel[..., 1]),
        )


@dataclass(frozen=True)
class _Setting(Displayed):
    """What a search needs of a scene, with whom it is seen by."""

    camera: Any
    source: Source
    medium: Field | None
    surface: Surface


@public
def projector_pixels(
    scene: SearchScene | str | Path,
    pixel: ArrayLike,
    *,
    march: March = REFERENCE,
    camera: str | None = None,
    source: str | None = None,
) -> ProjectorPixels:
    """Find the projector's pixels that light what camera pixels see, by marched rays.

    Parameters
    ----------
    scene : Scene, str or Path
        From `load_scene`, or its name or path; `scene.cold()` for straight light.
    pixel : array_like of shape (N, 2)
        (u, v) in px of the camera, integers at pixel centres.
    march : March
        How all rays are marched.
    camera, source : str, optional
        Names of the scene's, where it has several.

    Returns
    -------
    ProjectorPixels

    Raises
    ------
    InputError
        If `pixel` is no list of (u, v), or the scene's source is no projector.
    """
    scene = with_projector(scene_of("projector_pixels", scene), camera, source)
    pixel = points_of("projector_pixels: pixel", pixel, 2)
    if pixel.ndim != 2 or pixel.shape[1] != 2:
        raise InputError(
            f"projector_pixels: pixel has the shape {pixel.shape}; give it (N, 2), (u, v) each"
        )
    if not isinstance(march, March):
        raise InputError(
            f"projector_pixels: march is {short(march)}; give a March, or leave it out"
        )
    march.check(scene.medium)
    family = pixel_family("projector_pixels", scene)
    seen = _Setting(scene.camera, scene.source, scene.medium, scene.surface)
    lit = replace(seen, camera=family)
    parts = [
        _found(seen, lit, pixel[first : first + _FEW], march)
        for first in range(0, max(len(pixel), 1), _FEW)
    ]
    projector_pixel, point, status = map(np.concatenate, zip(*parts, strict=True))
    return ProjectorPixels(projector_pixel, point, status)


def pixel_grid(size: tuple[int, int], most: int) -> NDArray[np.int64]:
    """Pixels (u, v), (N, 2), on a grid over the whole image of (W, H) px: about so many."""
    width, height = size
    step = int(np.ceil(np.sqrt(width * height / most)))
    v, u = np.mgrid[step // 2 : height : step, step // 2 : width : step]
    return np.stack([u.ravel(), v.ravel()], axis=1)


def _found(
    seen: SearchScene, lit: SearchScene, pixel: Array, march: March
) -> tuple[Array, Array, NDArray[np.uint8]]:
    """Projector pixels, points and statuses of pixels (N, 2).

    `lit` is the scene as its projector would see it: as camera it has the projector's rays.
    """
    pixel = np.where(np.isfinite(pixel).all(axis=1, keepdims=True), pixel, np.nan)
    known = np.asarray(np.isfinite(seen.camera.of_pixels(pixel)).all(axis=0))
    point = seen_points(seen, np.where(known[:, None], pixel, np.nan), march)
    found = marched_pixels(lit, point, march)
    reasons = {
        ProjectorPixelStatus.NO_PIXEL: ~known,
        ProjectorPixelStatus.MISSED: np.isnan(point[:, 0]),
        ProjectorPixelStatus.FOLDED: np.isnan(found[:, 0]),
        ProjectorPixelStatus.OUTSIDE: ~lit.camera.inside(found),
        ProjectorPixelStatus.SHADOWED: _shadowed(lit, point, found),
    }
    status = np.select([*reasons.values()], [*reasons], ProjectorPixelStatus.OK)
    ok = np.flatnonzero(status == ProjectorPixelStatus.OK)
    status[ok[_edges(seen, lit, pixel[ok], found[ok])]] = ProjectorPixelStatus.EDGE
    used = (status == ProjectorPixelStatus.OK) | (status == ProjectorPixelStatus.EDGE)
    return np.where(used[:, None], found, np.nan), point, status.astype(np.uint8)


def _shadowed(lit: SearchScene, point: Array, projector_pixel: Array) -> Mask:
    """Which points (N, 3) the projector's rays to them don't reach: something stands before."""
    axis = lit.camera.pose.rotation[:, 2]
    before_mm: Array = (point - seen_points(lit, projector_pixel, _LONG)) @ axis
    return np.asarray(before_mm > CLEARANCE_MM)


def _edges(seen: SearchScene, lit: SearchScene, pixel: Array, found: Array) -> Mask:
    """Within which pixels (N, 2) of the camera the projector's pixel is no smooth function.

    By the pixels' corners; the projector's light is taken as bent there as in the middle.
    """
    around = (pixel + _CORNERS[:, None]).reshape(-1, 2)
    point = seen_points(seen, around, _LONG)
    centre = lit.camera.project(seen_points(seen, pixel, _LONG))
    bent = np.tile(found - centre, (4, 1))
    corner = lit.camera.project(point) + bent
    shadowed = _shadowed(lit, point, corner) | ~lit.camera.inside(corner)
    corner[shadowed] = np.nan
    one, two, three, four = corner.reshape(4, -1, 2)
    extent = np.maximum(np.abs(two - one), np.abs(four - three)).max(axis=1)
    bends = np.abs(one + two - 2.0 * found) + np.abs(three + four - 2.0 * found)
    return ~(bends.max(axis=1) <= _EDGE * extent)
