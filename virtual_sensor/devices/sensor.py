"""The triangulation sensor: a camera beside a laser line."""

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from virtual_sensor.devices.laser import LaserLine
from virtual_sensor.display import Displayed
from virtual_sensor.optics.ray_families import Pinhole

Array = NDArray[np.float64]


@dataclass(frozen=True)
class SensorModel(Displayed):
    """A camera and a laser line generator in one world: all that triangulation needs.

    Attributes
    ----------
    camera : Pinhole
    laser : LaserLine
    """

    camera: Pinhole
    laser: LaserLine

    def _line(self) -> str:
        angle = f"{self.triangulation_angle_deg:.4g}° between their axes"
        return f"{angle}; camera {self.camera._line()}; laser {self.laser._line()}"

    @property
    def triangulation_angle_deg(self) -> float:
        """Angle between the camera's axis and the laser's: the paper's alpha."""
        return self.camera.pose.axes_angle_deg(self.laser.pose)
