"""From pixels to points: the line of sight meets the laser plane (Beermann et al. 2018, 3.3)."""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path
from typing import Any, ClassVar, NamedTuple

import numpy as np
from numpy.typing import ArrayLike, NDArray

from virtual_sensor.arrays import number_within, one_of, points_of
from virtual_sensor.calls import public
from virtual_sensor.display import Displayed, listed, span, tally
from virtual_sensor.errors import InputError, short
from virtual_sensor.metrology.centres import LineCentres
from virtual_sensor.metrology.deviation import UM_PER_MM, euclidean
from virtual_sensor.metrology.truth import LineErrors
from virtual_sensor.optics.crossing_status import CrossingStatus
from virtual_sensor.optics.ray_families import Pinhole
from virtual_sensor.optics.sensor_geometry import Sensor, check_geometry
from virtual_sensor.optics.sources import first_coordinate

Array = NDArray[np.float64]

MANY = 300
"""So many pixels are triangulated through bent light by maps."""

PARALLEL = 1e-12  # sine of the angle to the laser plane: below it a line of sight never meets it


@dataclass(frozen=True)
class TriangulatedPoints(Displayed):
    """What pixels measure.

    Attributes
    ----------
    point_mm : ndarray of shape (..., 3)
        World; NaN unless OK.
    status : ndarray of shape (...)
        `CrossingStatus`.
    """

    _statuses: ClassVar = {"status": CrossingStatus}
    _by_row: ClassVar = True

    point_mm: Array
    status: NDArray[np.uint8]

    def _line(self) -> str:
        axes = zip("xyz", np.moveaxis(self.point_mm, -1, 0), strict=True)
        spans = (span(axis, values, "mm") for axis, values in axes)
        return listed(tally(self.status, CrossingStatus.OK), *spans)


@public
def triangulate(
    sensor: Any,
    pixel: ArrayLike | LineCentres,
    *,
    medium: Any = None,
    camera: str | None = None,
    source: str | None = None,
    coordinate: ArrayLike | None = None,
) -> Array:
    """Measure the points that pixels see on a source's rays, along straight or bent lines of sight.

    `triangulated_points` says why a pixel has no point, and takes a tolerance.

    Parameters
    ----------
    sensor : Scene, SensorModel, Calibration, str or Path
        Or the scene's name or path.
    pixel : array_like of shape (..., 2)
        (u, v) in px, integer at pixel centres; undistorted first, where the camera distorts.
        What has such pixels may be given itself: `LineCentres`, say.
    medium : IndexField, str or Path, optional
        That bends both lines of sight and laser: the scene's, say (`scene.medium`), or the file of
        another. By default light runs straight. A calibration knows no rays that a medium could
        bend.
    camera, source : str, optional
        Names, where the scene has several.
    coordinate : array_like of shape (...)
        First coordinate s of the source's rays, for each pixel or one for all. By default 0, the
        middle of a laser's sheet; a projector has no such.

    Returns
    -------
    ndarray of shape (..., 3)
        World points in mm: where light runs straight, the line of sight g intersected with the
        plane of the rays, E (figure 3); else where bent lines of sight meet bent rays, good to
        what 0.001 px is. NaN where `triangulated_points` has another status than OK.

    Raises
    ------
    InputError
        Where `pixel` is no list of (u, v), or a line in an image of another size; there is no such
        camera or source, or the camera stands in the laser plane.
    """
    points = triangulated_points(
        sensor, pixel, medium=medium, camera=camera, source=source, coordinate=coordinate
    )
    return points.point_mm


@public
def triangulated_points(
    sensor: Any,
    pixel: ArrayLike | LineCentres,
    *,
    medium: Any = None,
    camera: str | None = None,
    source: str | None = None,
    coordinate: ArrayLike | None = None,
    method: str | None = None,
    tolerance_px: float = 1e-3,
) -> TriangulatedPoints:
    """`triangulate` with a status for each pixel, and a tolerance in px.

    Parameters
    ----------
    sensor, pixel, medium, camera, source, coordinate
        As those of `triangulate`.
    method : str, optional
        Of bent light. "tabulated": by maps of lines of sight and of the source's rays that are made
        to the tolerance, and kept for the next call; by Newton's method where there are no such
        maps. "newton": by Newton's method on marched rays, to 1e-7 mm. By default maps for `MANY`
        pixels and more.
    tolerance_px : float
        Of "tabulated".

    Raises
    ------
    InputError
        As `triangulate` does.
    """
    if method is not None:
        one_of("triangulate: method", method, ("tabulated", "newton"))
    number_within("triangulate: tolerance_px", tolerance_px, 1e-9, 1e3, "a positive number of px")
    scene = _scene_of(sensor)
    if scene is not None:
        if isinstance(medium, str | Path):
            medium = scene.with_medium(medium).medium
        scene = scene.only(camera, source)
        sensor = _Sensor(scene.camera, scene.source)
    _check_size(pixel, sensor.camera.size, scene)
    places: Any = pixel.pixel if hasattr(pixel, "pixel") else pixel
    pixel = points_of("triangulate: pixel", places, 2)
    if pixel.shape[-1:] != (2,):
        raise InputError(f"triangulate: pixel has shape {pixel.shape}; give it (N, 2), (u, v) each")
    shape, s = pixel.shape[:-1], first_coordinate("triangulate", sensor.laser, coordinate)
    if s.shape not in ((), shape):
        raise InputError(
            f"triangulate: coordinate has shape {s.shape}; give one number, or one for each pixel"
        )
    if medium is not None and not hasattr(medium, "lookup"):
        raise InputError(
            f"triangulate: medium is {short(medium)}; give an IndexField, such as scene.medium"
        )
    s = np.where(np.isfinite(s), s, np.nan)
    plane = _plane(sensor.laser, s)
    if plane:
        check_geometry(sensor)
    if plane and medium is None:
        point, status = _straight(sensor.camera, pixel, *plane)
    else:
        rows = pixel.reshape(-1, 2), np.broadcast_to(s, shape).ravel()
        by_maps = medium is None or np.isfinite(rows[0]).all(axis=1).sum() >= MANY
        method = method or ("tabulated" if by_maps else "newton")
        point, status = _on_rays(sensor, *rows, medium, method, tolerance_px)
    return TriangulatedPoints(point.reshape(*shape, 3), status.reshape(shape))


class _Sensor(NamedTuple):
    """A scene's camera, and its laser line or projector."""

    camera: Any
    laser: Any

    @property
    def triangulation_angle_deg(self) -> float:
        """Between their axes."""
        angle: float = self.camera.pose.axes_angle_deg(self.laser.pose)
        return angle


def _check_size(line: Any, size: tuple[int, int], scene: Any) -> None:
    """Refuse the centres of a line in an image of another size than the camera's."""
    searched, count = getattr(line, "searched", ("columns", 0))
    name = {"columns": "width", "rows": "height"}[searched]
    of_camera = dict(zip(("width", "height"), size, strict=True))[name]
    if count not in (0, of_camera):
        remedy = "give its own image" if scene is None else f"load the scene with {name}={count}"
        raise InputError(
            f"triangulate: the line has {count} {searched}, the camera {of_camera}; {remedy}, or"
            " give (u, v) of the whole image"
        )


def _scene_of(sensor: Any) -> Any:
    """A scene that is given, or by whose name or path it is; None of another sensor."""
    if isinstance(sensor, str | Path):
        from virtual_sensor.optics.sight import scene_of

        return scene_of("triangulate", sensor)
    if hasattr(sensor, "cameras"):
        return sensor
    if not (hasattr(sensor, "camera") and hasattr(sensor, "laser")):
        raise InputError(
            f"triangulate: sensor is {short(sensor)}; give a scene of load_scene, its name or path,"
            " or a Calibration"
        )
    return None


def _plane(laser: Any, s: Array) -> tuple[Array, Array] | None:
    """The planes of the rays of a first coordinate s; None where they lie in none."""
    family = getattr(laser, "family", None)
    if family is None:
        if np.any(s != 0.0):
            raise InputError("triangulate: a calibration knows no coordinate but 0")
        normal, offset = laser.plane
        return normal, np.asarray(offset)
    try:
        planes: tuple[Array, Array] = family.plane(s)
    except InputError:
        return None
    return planes


def _straight(
    camera: Pinhole, pixel: Array, normal: Array, offset: Array
) -> tuple[Array, NDArray[np.uint8]]:
    """Lines of sight of pixels (..., 2) intersected with planes."""
    finite = np.isfinite(pixel).all(axis=-1, keepdims=True)
    direction = camera.lines_of_sight(np.where(finite, pixel, np.nan))
    centre = camera.pose.origin_mm
    approach = np.sum(direction * normal, axis=-1)
    meets = np.abs(approach) > PARALLEL
    distance_mm = (offset - normal @ centre) / np.where(meets, approach, np.nan)
    reasons = {
        CrossingStatus.NO_PIXEL: ~np.isfinite(approach),
        CrossingStatus.NO_CROSSING: ~meets,
        CrossingStatus.BEHIND: ~(distance_mm > 0.0),
    }
    status = np.select([*reasons.values()], [*reasons], CrossingStatus.OK).astype(np.uint8)
    distance_mm = np.where(status == CrossingStatus.OK, distance_mm, np.nan)
    return centre + distance_mm[..., None] * direction, status


def _on_rays(
    sensor: Any, pixel: Array, s: Array, medium: Any, method: str, tolerance_px: float
) -> tuple[Array, NDArray[np.uint8]]:
    """Lines of sight of pixels (N, 2) crossed with the source's rays (N,)."""
    from virtual_sensor.optics.bent_points import marched_crossings
    from virtual_sensor.optics.crossings import crossings
    from virtual_sensor.optics.ray_maps import NoMapError

    family = getattr(sensor.laser, "family", None)
    if family is None:
        raise InputError(
            "triangulate: a calibration knows the laser's plane and not its rays, which the medium"
            " bends; give a scene, or leave the medium out"
        )
    if method == "tabulated":
        try:
            found = crossings(medium, sensor.camera, family, pixel, s, tolerance_px)
        except NoMapError:
            pass
        else:
            return found.point_mm, found.status
    marched = marched_crossings(medium, sensor.camera, family, pixel, s)
    return marched.point_mm, marched.status


def error_um(sensor: Sensor, errors: LineErrors) -> Array:
    """Distance (N,) in um of the points measured from a line's centres to those from the truth."""
    rows = errors.row, errors.true_row
    found, true = (triangulate(sensor, np.stack([errors.column, row], axis=1)) for row in rows)
    return UM_PER_MM * euclidean(found - true)
