"""A scene's part as corrected points are compared with it: in space, off the laser's plane too."""

from __future__ import annotations

from dataclasses import dataclass
from functools import cached_property

import numpy as np
from numpy.typing import NDArray

from virtual_sensor.devices.laser import LaserLine
from virtual_sensor.display import Displayed
from virtual_sensor.imaging.scene import Scene
from virtual_sensor.metrology.deviation import UM_PER_MM
from virtual_sensor.metrology.shapes import PartShape
from virtual_sensor.optics.surfaces import Cylinder
from virtual_sensor.studies.section import Section, true_section

Array = NDArray[np.float64]

_OFF_PLANE_UM = 200.0  # bent light leaves the laser's plane by less


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
        return self.scene.laser

    def along_mm(self, points_mm: Array) -> Array:
        """Position (N,) along the line of world points (N, 3)."""
        return self.laser.family.coordinates(points_mm)[..., 1]

    @cached_property
    def shape(self) -> PartShape:
        """As the laser's light comes down on it, which reaches walls that others hide."""
        return PartShape(self.scene.surface, tuple((-self.laser.pose.rotation[:, 2]).tolist()))

    @cached_property
    def section(self) -> Section:
        """The part's in the laser's plane."""
        return true_section(self.scene)

    def distance_um(self, points_mm: Array) -> Array:
        """Distance (N,) of world points (N, 3): positive outside the part; NaN at its edges."""
        distance: Array = UM_PER_MM * self.shape.distance(points_mm).distance_mm
        if isinstance(self.scene.surface, Cylinder):
            return distance
        # Of a step, straight light meets one face and the point may lie before the other.
        same_face = np.abs(distance - self.section.distance_um(points_mm)) < _OFF_PLANE_UM
        return np.where(same_face, distance, np.nan)

    def normals(self, points_mm: Array) -> Array:
        """Unit normals (N, 3) of the surface there."""
        return self.shape.distance(points_mm).by_point
