"""From pixels to points: the line of sight meets the laser plane (Beermann et al. 2018, 3.3)."""

from typing import Protocol

import numpy as np
from numpy.typing import ArrayLike, NDArray

from virtual_sensor.arrays import points_of, unmasked
from virtual_sensor.errors import InputError
from virtual_sensor.metrology.deviation import UM_PER_MM, euclidean
from virtual_sensor.metrology.truth import LineErrors
from virtual_sensor.optics.ray_families import Pinhole

Array = NDArray[np.float64]

PARALLEL = 1e-12  # sine of the angle to the laser plane: below it a line of sight never meets it
SINGULAR = 1e-6  # the same angle, subtended by the triangulation base: below it there is no depth
NEAREST_MM = 1.0  # to a projection centre, of all that is ever measured


class LaserPlane(Protocol):
    """A laser plane, and about where on it things are measured (3,), mm."""

    @property
    def plane(self) -> tuple[Array, float]: ...  # noqa: D102

    @property
    def target_mm(self) -> Array: ...  # noqa: D102


class Sensor(Protocol):
    """A camera and a laser plane: the sensor of a scene, or a real one's calibration."""

    @property
    def camera(self) -> Pinhole: ...  # noqa: D102

    @property
    def laser(self) -> LaserPlane: ...  # noqa: D102

    @property
    def triangulation_angle_deg(self) -> float: ...  # noqa: D102


def check_geometry(sensor: Sensor) -> None:
    """Check that the camera sees the laser plane from the side.

    From a projection centre in the laser plane every line of sight that meets the plane does so at
    the projection centre itself, whatever the depth of the object.

    Raises
    ------
    InputError
        Where C_proj lies in the laser plane, as with a triangulation angle alpha of zero.
    """
    normal, offset = sensor.laser.plane
    centre = sensor.camera.pose.origin_mm
    base = abs(normal @ centre - offset)
    distance = max(float(np.linalg.norm(centre - sensor.laser.target_mm)), NEAREST_MM)
    if not base > SINGULAR * distance:
        raise InputError(
            f"sensor: the camera's projection centre lies {base:.3g} mm from the laser plane "
            f"(triangulation angle alpha = {sensor.triangulation_angle_deg:.3g} deg), so that no "
            "depth can be measured; turn the camera out of the plane, to alpha = 60 deg for example"
        )


def triangulate(sensor: Sensor, pixel: ArrayLike) -> Array:
    """Measure the points on the laser plane E that pixels see along straight lines of sight g.

    Parameters
    ----------
    sensor : SensorModel or Calibration
    pixel : array_like of shape (N, 2)
        (u, v) in px, integer at pixel centres; undistorted first, where the camera distorts.

    Returns
    -------
    ndarray of shape (N, 3)
        World points in mm, g intersected with E (figure 3); NaN where the pixel is not finite, or
        its line of sight runs parallel to the plane or meets it behind the camera.

    Raises
    ------
    InputError
        Where `pixel` is no list of (u, v), or the camera stands in the laser plane.
    """
    check_geometry(sensor)
    pixel = points_of(unmasked(pixel), 2)
    if pixel.shape[-1:] != (2,):
        raise InputError(f"triangulate: pixel has shape {pixel.shape}; give it (N, 2), (u, v) each")
    finite = np.isfinite(pixel).all(axis=-1, keepdims=True)
    direction = sensor.camera.lines_of_sight(np.where(finite, pixel, np.nan))
    normal, offset = sensor.laser.plane
    centre = sensor.camera.pose.origin_mm

    approach = direction @ normal
    meets = np.abs(approach) > PARALLEL
    distance_mm = (offset - normal @ centre) / np.where(meets, approach, np.nan)
    distance_mm = np.where(distance_mm > 0.0, distance_mm, np.nan)
    return centre + distance_mm[..., None] * direction


def error_um(sensor: Sensor, errors: LineErrors) -> Array:
    """Distance (N,) in um of the points measured from a line's centres to those from the truth."""
    rows = errors.row, errors.true_row
    found, true = (triangulate(sensor, np.stack([errors.column, row], axis=1)) for row in rows)
    return UM_PER_MM * euclidean(found - true)
