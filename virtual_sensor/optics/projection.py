"""Points to pixels, through a medium: which pixel sees a point along a bent line of sight.

By maps, the ray of the camera through the point is read from a table of its bent lines of sight
(`ray_maps`); by Newton's method on marched rays, each point's own line of sight is marched until it
meets the point. Parts hide nothing: a point within one or behind it has its pixel too.
"""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path
from typing import Any, ClassVar

import numpy as np
from numpy.typing import ArrayLike, NDArray

from virtual_sensor.arrays import number_within, one_of, points_of, truth_of
from virtual_sensor.calls import public
from virtual_sensor.display import Displayed, listed, span, tally
from virtual_sensor.errors import InputError
from virtual_sensor.optics.covering_maps import by_octaves, in_mm, in_view, rays_through
from virtual_sensor.optics.newton_search import marched_pixels
from virtual_sensor.optics.ray_families import Pinhole
from virtual_sensor.optics.ray_maps import MapStatus, NoMapError
from virtual_sensor.optics.sight import SearchScene, chosen, scene_of
from virtual_sensor.statuses import StatusEnum

Array = NDArray[np.float64]

TOLERANCE_PX = 1e-3
"""Of pixels by maps, unless another is asked for."""

MANY = 5000
"""So many points are projected by maps."""


class ProjectionStatus(StatusEnum):
    """Whether a point has a pixel, and if not, why."""

    OK = 0, "The pixel is good to the tolerance; it may lie beside the sensor."
    NO_POINT = 1, "The point is not finite: give numbers."
    BEHIND = 2, "The point is behind the camera, or in its plane: no pixel sees it."
    OFF = (
        3,
        "The point would be seen more than half an image beside the sensor: turn the camera to it.",
    )
    FOLDED = (
        4,
        "A caustic, where more than one pixel may see the point, or no line of sight was found: "
        "leave this point out.",
    )


@dataclass(frozen=True)
class ProjectedPoints(Displayed):
    """Where points are seen.

    Attributes
    ----------
    pixel : ndarray of shape (..., 2)
        (u, v) in px; NaN unless OK.
    status : ndarray of shape (...)
        `ProjectionStatus`.
    """

    _field_units: ClassVar = {"pixel": "px"}
    _statuses: ClassVar = {"status": ProjectionStatus}
    _by_row: ClassVar = True

    pixel: Array
    status: NDArray[np.uint8]

    def _line(self) -> str:
        return listed(
            tally(self.status, ProjectionStatus.OK),
            span("columns", self.pixel[..., 0]),
            span("rows", self.pixel[..., 1]),
        )


@public
def project(
    scene: SearchScene | str | Path,
    points_mm: ArrayLike,
    through_medium: bool = True,
    camera: str | None = None,
) -> Array:
    """The pixels at which a scene's camera sees points, along bent lines of sight.

    Good to 0.001 px; `projected_points` says why a point has no pixel, and takes a tolerance.

    Parameters
    ----------
    scene : Scene, str or Path
        From `load_scene`, or its name or path.
    points_mm : array_like of shape (..., 3)
        World, mm; whether a part hides them is not asked.
    through_medium : bool
        False: along straight lines of sight, equation 2.
    camera : str, optional
        Its name, where the scene has several.

    Returns
    -------
    ndarray of shape (..., 2)
        (u, v) in px, integers at pixel centres, with the lens' distortion; beside the sensor too.
        NaN where `projected_points` has another status than OK.

    Raises
    ------
    InputError
        If these are no points, or there is no such camera.
    """
    return projected_points(scene, points_mm, through_medium, camera).pixel


@public
def projected_points(
    scene: SearchScene | str | Path,
    points_mm: ArrayLike,
    through_medium: bool = True,
    camera: str | None = None,
    *,
    method: str | None = None,
    tolerance_px: float = TOLERANCE_PX,
) -> ProjectedPoints:
    """`project` with a status for each point.

    Parameters
    ----------
    scene, points_mm, through_medium, camera
        See `project`.
    method : str, optional
        "tabulated": by a map of the camera's lines of sight that is made to the tolerance; by
        Newton's method where there is no such map.  "newton": by Newton's method on marched lines
        of sight, to 1e-6 px.  By default maps for `MANY` points and more, since to make one takes
        longer than to march to a few points.
    tolerance_px : float
        Of "tabulated".
    """
    points = points_of("project: points_mm", points_mm)
    if points.shape[-1:] != (3,):
        raise InputError(f"project: points_mm has the shape {points.shape}; give it (N, 3)")
    if method is not None:
        one_of("project: method", method, ("tabulated", "newton"))
    truth_of("project: through_medium", through_medium)
    number_within("project: tolerance_px", tolerance_px, 1e-9, 1e3, "a positive number of px")
    scene = chosen(scene_of("project", scene), camera, None)
    view, rows = scene.camera, points.reshape(-1, 3)
    finite = np.asarray(np.isfinite(rows).all(axis=1))
    rows = np.where(finite[:, None], rows, np.nan)
    straight, depth = view.project(rows), view.pose.to_local(rows)[:, 2]
    near = in_view(view, rows)
    reasons = {
        ProjectionStatus.NO_POINT: ~finite,
        ProjectionStatus.BEHIND: ~(depth > 0.0),
        ProjectionStatus.OFF: ~near,
    }
    status = np.select(list(reasons.values()), list(reasons), ProjectionStatus.OK)
    pixel = np.full((len(rows), 2), np.nan)
    if not through_medium or scene.medium is None:
        beside = finite & (depth > 0.0) & np.isfinite(straight[:, 0])
        pixel, status = np.where(beside[:, None], straight, np.nan), np.where(beside, 0, status)
    elif near.any():
        by_maps = len(rows) >= MANY if method is None else method == "tabulated"
        pixel[near], status[near] = (
            _tabulated(scene, rows[near], tolerance_px) if by_maps else _marched(scene, rows[near])
        )
    shape = points.shape[:-1]
    return ProjectedPoints(pixel.reshape(*shape, 2), status.reshape(shape).astype(np.uint8))


def _tabulated(scene: Any, points: Array, tolerance_px: float) -> tuple[Array, NDArray[np.uint8]]:
    """Pixels and statuses of points before the camera, by one map for each octave of depth."""
    camera: Pinhole = scene.camera
    places = camera.coordinates(points)
    pixel, status = np.full((len(points), 2), np.nan), np.zeros(len(points), np.uint8)
    for some in by_octaves(places[:, 2]):
        tolerance_mm = in_mm(tolerance_px, camera, places[some, 2])
        try:
            found = rays_through(scene.medium, camera, points[some], tolerance_mm)
        except NoMapError:
            pixel[some], status[some] = _marched(scene, points[some])
            continue
        pixel[some] = camera.pixels(*found.coordinates.T)
        status[some] = np.where(
            found.status == MapStatus.FOLDED, ProjectionStatus.FOLDED, ProjectionStatus.OK
        )
        off = some[found.status == MapStatus.OFF]
        if off.size:
            pixel[off], status[off] = _marched(scene, points[off])
    return pixel, status


def _marched(scene: Any, points: Array) -> tuple[Array, NDArray[np.uint8]]:
    """The same by Newton's method on marched lines of sight."""
    pixel = marched_pixels(scene, points)
    found = np.isfinite(pixel).all(axis=1)
    return pixel, np.where(found, ProjectionStatus.OK, ProjectionStatus.FOLDED).astype(np.uint8)
