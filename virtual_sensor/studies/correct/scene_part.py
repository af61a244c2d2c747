"""A scene's part as corrected points are compared with it: in space, off the laser's plane too."""

from __future__ import annotations

from dataclasses import dataclass
from functools import cached_property
from typing import Any

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
_OFF_FACE_UM = 1000.0  # of points of a whole surface, which lie before another face if farther off


@dataclass(frozen=True)
class ScenePart(Displayed):
    """The part of a scene, and the line or the area in which it is measured.

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
    def source(self) -> Any:
        """The scene's: a laser line, or a projector."""
        return self.scene.source

    @property
    def areal(self) -> bool:
        """Whether a surface is measured, and not a line."""
        return not isinstance(self.source, LaserLine)

    def along_mm(self, points_mm: Array) -> Array:
        """Position (N,) of world points (N, 3) along the line; of a projector's, along its rows' v.

        From the middle of the light.
        """
        if self.areal:
            points = self.source.pose.to_local(points_mm)
            return np.asarray(points[..., 1] - self.source.pose.to_local(self.source.target_mm)[1])
        return np.asarray(self.source.family.coordinates(points_mm)[..., 1])

    @cached_property
    def shape(self) -> PartShape:
        """As the source's light comes down on it, which reaches walls that others hide."""
        return PartShape(self.scene.surface, tuple((-self.source.pose.rotation[:, 2]).tolist()))

    @cached_property
    def section(self) -> Section:
        """The part's in the laser's plane."""
        return true_section(self.scene)

    def distance_um(self, points_mm: Array) -> Array:
        """Distance (N,) of world points (N, 3): positive outside the part; NaN at its edges."""
        distance: Array = UM_PER_MM * self.shape.distance(points_mm).distance_mm
        if isinstance(self.scene.surface, Cylinder):
            return distance
        if self.areal:
            return np.where(np.abs(distance) < _OFF_FACE_UM, distance, np.nan)
        # Of a step, straight light meets one face and the point may lie before the other.
        same_face = np.abs(distance - self.section.distance_um(points_mm)) < _OFF_PLANE_UM
        return np.where(same_face, distance, np.nan)

    def normals(self, points_mm: Array) -> Array:
        """Unit normals (N, 3) of the surface there."""
        return self.shape.distance(points_mm).by_point
