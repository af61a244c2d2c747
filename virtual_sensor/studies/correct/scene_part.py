"""A scene's part as corrected points are compared with it: in space, off the laser's plane too."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from virtual_sensor.devices.laser import LaserLine
from virtual_sensor.display import Displayed
from virtual_sensor.imaging.scene import Scene
from virtual_sensor.metrology.deviation import UM_PER_MM
from virtual_sensor.optics.surfaces import Cylinder
from virtual_sensor.studies.section import true_section

Array = NDArray[np.float64]


@dataclass(frozen=True)
class ScenePart(Displayed):
    """The part of a scene, and the line along which it is measured.

    Attributes
    ----------
    scene : Scene
    """

    scene: Scene

    @staticmethod
    def of(scene: Scene) -> ScenePart:
        """The part of a scene with one camera and one source."""
        return ScenePart(scene)

    @property
    def laser(self) -> LaserLine:
        """The scene's."""
        return self.scene.source

    def along_mm(self, points_mm: Array) -> Array:
        """Position (N,) along the line of world points (N, 3)."""
        return self.laser.family.coordinates(points_mm)[..., 1]

    def distance_um(self, points_mm: Array) -> Array:
        """Distance (N,) of world points (N, 3): positive outside the part; NaN at its edges."""
        part = self.scene.surface
        if isinstance(part, Cylinder):
            radial = np.hypot(points_mm[:, 1] - part.axis_y_mm, points_mm[:, 2] - part.axis_z_mm)
            return UM_PER_MM * (radial - part.radius_mm)
        return true_section(self.scene).distance_um(points_mm)

    def normals(self, points_mm: Array) -> Array:
        """Unit normals (N, 3) of the surface there."""
        part = self.scene.surface
        if isinstance(part, Cylinder):
            away = points_mm - [0.0, part.axis_y_mm, part.axis_z_mm]
            away[:, 0] = 0.0
            return away / np.linalg.norm(away, axis=1, keepdims=True)
        up = -self.laser.pose.rotation[:, 2]
        return np.broadcast_to(up, points_mm.shape)
