"""What a triangulation sensor must be to measure depth: a scene's, or a real one's calibration."""

from typing import Protocol

import numpy as np
from numpy.typing import NDArray

from virtual_sensor.errors import InputError
from virtual_sensor.optics.ray_families import Pinhole

Array = NDArray[np.float64]

SINGULAR = 1e-6  # sine of the laser plane's angle to the line to the target: below it, no depth
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
