"""A laser line in the projector's place: its section beside that of the fringes, on the same part.

Both are seen by the same pixels of the same camera. Where light runs straight, and where both are
triangulated through the air, they give the same points. As if light ran straight, hot, they differ:
the sheet's light is telecentric, the projector's spreads from a point, and they reach the part by
other paths.
"""

from __future__ import annotations

from dataclasses import dataclass, replace
from typing import Any

import numpy as np
from numpy.typing import NDArray
from scipy.ndimage import map_coordinates

from virtual_sensor.devices.laser import LaserLine
from virtual_sensor.display import Displayed, listed
from virtual_sensor.errors import InputError
from virtual_sensor.imaging.scene import Scene
from virtual_sensor.metrology.deviation import UM_PER_MM
from virtual_sensor.metrology.shapes import PartShape
from virtual_sensor.metrology.triangulation import triangulated_points
from virtual_sensor.metrology.truth import largest, rms
from virtual_sensor.optics.projector_pixels import projector_pixels
from virtual_sensor.optics.ray_families import Pinhole, Sheet
from virtual_sensor.optics.ray_search import ray_search
from virtual_sensor.optics.surfaces import Cylinder
from virtual_sensor.records import Record

Array = NDArray[np.float64]

RAYS = 101
"""Of the line, that are searched."""

_SAME_FACE_UM = 50.0  # by which a curved face and its tangent plane may differ
_LINE_RADIUS_MM = 0.15
_POWER_W = 0.1


@dataclass(frozen=True)
class SectionDifference(Record):
    """Points by fringes beside those by a laser line, in the same pixels of the camera.

    Attributes
    ----------
    points : int
        That both have.
    line_rms_um, areal_rms_um : float
        Their distances from the part along its normal.
    difference_rms_um, difference_largest_um : float
        Areal minus line.
    """

    points: int
    line_rms_um: float
    areal_rms_um: float
    difference_rms_um: float
    difference_largest_um: float


@dataclass(frozen=True)
class SectionPair(Record):
    """The section along a laser's line, by both sensors.

    Attributes
    ----------
    straight : SectionDifference
        As if light ran straight.
    bent : SectionDifference or None
        Through the scene's air; None where light runs straight.
    """

    straight: SectionDifference
    bent: SectionDifference | None


@dataclass(frozen=True)
class Sections(Displayed):
    """Distances from the part along a laser's line, in N of the camera's pixels.

    Attributes
    ----------
    along_mm : ndarray of shape (N,)
        Place on the line.
    pixel : ndarray of shape (N, 2)
        Of the camera, that sees the line there.
    line_um, areal_um : dict from str to ndarray of shape (N,)
        By "straight" and "bent": of the points by the line, and by fringes. Positive outside the
        part; NaN where there is none.
    """

    along_mm: Array
    pixel: Array
    line_um: dict[str, Array]
    areal_um: dict[str, Array]

    def _line(self) -> str:
        return listed(f"{len(self.along_mm)} points", *self.line_um)

    @property
    def figures(self) -> SectionPair | None:
        """What both have; None where there is no such point."""
        found: dict[str, SectionDifference | None] = {"bent": None}
        for name, line in self.line_um.items():
            areal = self.areal_um[name]
            both: Any = np.isfinite(line) & np.isfinite(areal)
            if not both.any():
                return None
            apart = areal[both] - line[both]
            of_both = rms(line[both]), rms(areal[both])
            found[name] = SectionDifference(int(both.sum()), *of_both, rms(apart), largest(apart))
        return SectionPair(**found)  # type: ignore[arg-type]


def line_sensor(scene: Scene) -> Scene:
    """The scene with a telecentric laser line in the projector's place, as long as its image."""
    projector = scene.projector
    pose = projector.pose
    away = float(pose.to_local(projector.target_mm)[2])
    (_, low), (_, high) = projector.extent
    length = (high - low) * (away if isinstance(projector.family, Pinhole) else 1.0)
    laser = LaserLine(Sheet(pose, away), float(length), _LINE_RADIUS_MM, _POWER_W, np.zeros(0))
    return replace(scene, sources={scene.source_name: laser})


def sections(
    scene: Scene, *, decoded: Any = None, rays: int = RAYS, line: Scene | None = None
) -> Sections:
    """The section along a laser's line, by that line and by fringes.

    Parameters
    ----------
    scene : Scene
        With one camera and one projector.
    decoded : DecodedFringes, optional
        Of the camera's frames, which are read between its pixels; by default the fringes are
        searched, too.
    rays : int
    line : Scene, optional
        With the line sensor; by default a telecentric line in the projector's place.

    Raises
    ------
    InputError
        If the decoded image has no column.
    """
    other = line or line_sensor(scene)
    laser = other.laser
    along = np.linspace(-0.5, 0.5, rays) * laser.length_mm
    found = ray_search(other, along, "newton")
    pixel = found.pixel
    if decoded is None:
        seen = np.full((rays, 2), np.nan)
        known = np.isfinite(pixel).all(axis=1)
        if known.any():
            seen[known] = projector_pixels(scene, pixel[known]).projector_pixel
        column, row = seen.T
    elif decoded.column is None:
        raise InputError("the column was not decoded; give fringes along u, or along both axes")
    else:
        column = _between(decoded.column, pixel)
        row = column * 0.0 + (scene.projector.size[1] - 1) / 2.0
        row = row if decoded.row is None else _between(decoded.row, pixel)
    s, _ = scene.projector.family.of_pixels(np.column_stack([column, row]))
    media = {"straight": None} | ({"bent": scene.medium} if scene.medium is not None else {})

    def distance(sensor: Scene, s: Any, medium: Any) -> Array:
        points = triangulated_points(sensor, pixel, medium=medium, coordinate=s).point_mm
        return off_part_um(scene, points, found.laser_point_mm)

    return Sections(
        along,
        pixel,
        {name: distance(other, 0.0, medium) for name, medium in media.items()},
        {name: distance(scene, s, medium) for name, medium in media.items()},
    )


def off_part_um(scene: Scene, points: Array, true_mm: Array) -> Array:
    """Distances (N,) of measured points (N, 3) from the part, on whose faces the true ones lie.

    Beside a step another face may be nearer than the one that was seen: of that the tangent plane
    counts.
    """
    distance: Array = UM_PER_MM * PartShape.of(scene).distance(points).distance_mm
    surface: Any = scene.surface
    if isinstance(surface, Cylinder):
        return distance
    known: Any = np.isfinite(true_mm).all(axis=1)
    found = np.full(len(points), np.nan)
    if known.any():
        sight = true_mm[known] - scene.camera.pose.origin_mm
        sight /= np.linalg.norm(sight, axis=1, keepdims=True)
        normal = surface.normals(true_mm[known], sight)
        normal = np.where(np.sum(normal * sight, axis=1, keepdims=True) > 0.0, -normal, normal)
        seen = UM_PER_MM * np.sum((points[known] - true_mm[known]) * normal, axis=1)
        same = np.abs(distance[known] - seen) < _SAME_FACE_UM
        found[known] = np.where(same, distance[known], seen)
    return found


def _between(image: Array, pixel: Array) -> Array:
    """An image (H, W) read between its pixels, at (u, v) (N, 2); NaN beside what is known."""
    known: Any = np.isfinite(pixel).all(axis=1)
    at = np.where(known[:, None], pixel, -9.0)[:, ::-1].T
    found: Array = map_coordinates(
        np.asarray(image, float), at, order=1, mode="constant", cval=np.nan, prefilter=False
    )
    return found
