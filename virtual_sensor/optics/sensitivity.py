"""How the laser line's place in the image answers to the sensor's pose and to the air.

Exact derivatives in forward mode: two marches that carry how their rays would move
(`carried_rays`), one of the laser ray and one of the line of sight, give the derivatives by all
parameters at once:

- the laser ray's incidence point P moves by dP = w - T (N.w)/(N.T), with w the ray's derivative,
  T its tangent and N the surface's normal;
- the pixel (u, v) that sees P is the root of r(u, v) = P along the line of sight, whose derivative
  is that of an implicit function: r_u du + r_v dv + T dt = dP - w.
"""

from collections.abc import Iterable, Mapping
from dataclasses import dataclass
from typing import ClassVar

import numpy as np
from numpy.typing import ArrayLike, NDArray
from scipy.interpolate import CubicSpline

from virtual_sensor.arrays import by_rows
from virtual_sensor.display import Displayed, listed, tally
from virtual_sensor.errors import InputError, few
from virtual_sensor.optics.carried_rays import (
    CarriedRays,
    Motion,
    RayStarts,
    carry,
    parameters_of,
)
from virtual_sensor.optics.eikonal import LAST_PIECE_MM
from virtual_sensor.optics.ray_search import SearchStatus, ray_search
from virtual_sensor.optics.rays import March, Variation
from virtual_sensor.optics.sight import REFERENCE, SearchScene, chosen
from virtual_sensor.optics.surfaces import Cylinder, SceneSurface

Array = NDArray[np.float64]


@dataclass(frozen=True)
class Sensitivity(Displayed):
    """Derivatives of the line's place in the image, one row per laser ray; NaN unless FOUND.

    Attributes
    ----------
    laser_y_mm : ndarray of shape (N,)
        The laser rays' coordinates b along the line.
    laser_point_mm : ndarray of shape (N, 3)
        Their incidence points, world.
    pixel : ndarray of shape (N, 2)
        (u, v) that see them.
    along_line : ndarray of shape (N, 2)
        d(u, v)/db in px/mm: the direction of the line in the image.
    of_pixel : dict from str to ndarray of shape (N, 2)
        d(u, v)/dp of the pixel that sees the same laser ray, by parameter: in px per mm, px per
        degree, px per unit of `field_scale`, px per unit of any other.
    status : ndarray of shape (N,)
        `SearchStatus`.
    """

    _field_units: ClassVar = {"pixel": "px", "along_line": "px/mm"}
    _statuses: ClassVar = {"status": SearchStatus}
    _by_row: ClassVar = True

    laser_y_mm: Array
    laser_point_mm: Array
    pixel: Array
    along_line: Array
    of_pixel: dict[str, Array]
    status: NDArray[np.int64]

    def _line(self) -> str:
        return listed(tally(self.status, SearchStatus.FOUND), f"by {few([*self.of_pixel], 6)}")

    @property
    def of_centre(self) -> dict[str, Array]:
        """Derivatives dv/dp (N,) of the line's centre in an image column that stays the same.

        A column then sees another laser ray, further along the line.
        """
        slope = self.along_line[:, 1] / self.along_line[:, 0]
        return {name: by[:, 1] - slope * by[:, 0] for name, by in self.of_pixel.items()}


def line_sensitivity(
    scene: SearchScene,
    laser_y_mm: ArrayLike,
    parameters: Iterable[str] | None = None,
    *,
    variations: Mapping[str, Variation] | None = None,
    pivot_mm: ArrayLike = (0.0, 0.0, 0.0),
    march: March = REFERENCE,
    camera: str | None = None,
    source: str | None = None,
) -> Sensitivity:
    """Find the pixels that see laser rays' incidence points, and their derivatives.

    Parameters
    ----------
    scene : Scene
        From `load_scene`, or what else a search can do with.
    laser_y_mm : array_like of shape (N,)
        Positions b of the rays along the line; `laser_y_at` gives those that image columns see.
    parameters : iterable of str, optional
        Of `pose_parameters`; ``beta``, the sensor's turn in degrees about the analytic cylinder's
        axis; ``field_scale``, a factor at the field's difference from its surroundings, where it
        is 1.
        All of them if not given, but ``beta`` only where there is such a cylinder.
    variations : mapping from str to Variation, optional
        Further parameters: the field's derivative by each, such as
        `AirModel.derivatives` gives.
    pivot_mm : array_like of shape (3,)
        World point that turns are about, other than ``beta``.
    march : March
    camera, source : str, optional
        Names of the scene's, where it has several.

    Raises
    ------
    InputError
        If a parameter is unknown, or the air is asked to vary where there is none.
    """
    scene = chosen(scene, camera, source)
    b = np.atleast_1d(np.asarray(laser_y_mm, float))
    known, asked, air = parameters_of("line_sensitivity", scene, parameters, variations, pivot_mm)
    return by_rows(lambda b: _sensitivity(scene, b, asked, known, air, march), b)


def _sensitivity(
    scene: SearchScene,
    b: Array,
    asked: Iterable[str],
    known: Mapping[str, Motion],
    air: Mapping[str, Variation],
    march: March,
) -> Sensitivity:
    """The derivatives asked for, of laser rays at b (N,)."""
    found = ray_search(scene, b, "newton", march=march)
    camera, laser, surface = scene.camera, scene.source, scene.surface
    lit = carry(
        scene.medium, "laser", RayStarts.of(laser.family, 0.0, b), air, march, surface=surface
    )
    p, q = camera.of_pixels(np.nan_to_num(found.pixel))
    sight = RayStarts.of(camera, p, q)
    seen = carry(scene.medium, "camera", sight, air, march, surface=surface)
    by_pq = camera.pixel_slopes(p, q)
    normal = _normals(scene, lit)
    columns = np.stack([*seen.by_coordinate(), seen.tangent], axis=-1)  # of p, q and t
    inverse = np.full_like(columns, np.nan)
    good = (found.status == SearchStatus.FOUND) & seen.arrived & lit.arrived
    lost = (found.status == SearchStatus.FOUND) & ~good
    inverse[good] = np.linalg.inv(columns[good])

    def pixels(of_light: Array, of_sight: Array | float) -> Array:
        """Derivatives of the pixels, from those of both rays at the same t."""
        with np.errstate(invalid="ignore", divide="ignore"):  # where nothing was met
            slip = np.sum(normal * of_light, axis=1) / np.sum(normal * lit.tangent, axis=1)
        of_point = of_light - lit.tangent * slip[:, None]
        of_pq = (inverse @ (of_point - of_sight)[:, :, None])[:, :2]
        return (by_pq @ of_pq)[:, :, 0]

    _, by_b = lit.by_coordinate()
    return Sensitivity(
        b,
        found.laser_point_mm,
        found.pixel,
        pixels(by_b, 0.0),
        {name: pixels(lit.by(name, known), seen.by(name, known)) for name in asked},
        np.where(lost, SearchStatus.LASER_MISSED, found.status),
    )


def laser_y_at(scene: SearchScene, columns: ArrayLike, march: March = REFERENCE) -> Array:
    """Positions b (N,) in mm of the laser rays that image columns u (N,) see on the line.

    NaN where a column sees none, or several.
    """
    u = np.atleast_1d(np.asarray(columns, float))
    low, high = scene.source.extent
    b = np.linspace(low[1], high[1], 65)
    along = ray_search(scene, b, "newton", march=march).pixel[:, 0]
    b, along = b[np.isfinite(along)], along[np.isfinite(along)]
    rising = np.diff(along) * np.sign(along[-1:] - along[:1]) > 0.0
    if not rising.size or not rising.all():
        return np.full_like(u, np.nan)
    order = np.argsort(along)
    y = CubicSpline(along[order], b[order], extrapolate=False)(u)
    seen = np.isfinite(y)
    for _ in range(2):  # from a spline's error of some 0.01 px, quadratically
        if seen.any():
            at = line_sensitivity(scene, y[seen], (), march=march)
            y[seen] += (u[seen] - at.pixel[:, 0]) / at.along_line[:, 0]
            seen = np.isfinite(y)
    return y


def _normals(scene: SearchScene, rays: CarriedRays) -> Array:
    """Normals (N, 3) of the surface where rays have met it, of any length and sign."""
    surface = scene.surface
    if not isinstance(surface, Cylinder | SceneSurface):
        raise InputError("line_sensitivity: the surface is neither a cylinder nor Mitsuba's shapes")
    heading = rays.tangent / np.linalg.norm(rays.tangent, axis=1, keepdims=True)
    return surface.normals(rays.point, heading, LAST_PIECE_MM)
