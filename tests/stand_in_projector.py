"""A projector of plain rays in the laser's place, for tests of what needs no radiometry."""

from dataclasses import dataclass, replace

import numpy as np

import virtual_sensor as vs
from virtual_sensor.optics.ray_families import Pinhole

MATRIX = np.array([[6400.0, 0.0, 639.5], [0.0, 6400.0, 399.5], [0.0, 0.0, 1.0]])
SIZE = (1280, 800)


@dataclass(frozen=True)
class PlainProjector:
    """Which rays there are: all of the image."""

    family: Pinhole

    @property
    def pose(self):
        return self.family.pose

    @property
    def extent(self):
        p, q = self.family.of_pixels(np.array([[-0.5, -0.5], np.array(self.family.size) - 0.5]))
        return np.array([p[0], q[0]]), np.array([p[1], q[1]])

    def reaches(self, s, t, margin=(0.0, 0.0)):
        return self.family.inside(self.family.pixels(s, t))


def with_projector(name="hot_cylinder", distortion=(), pose=None, **parameters):
    """A scene whose laser is replaced by a projector; 60 mm x 37.5 mm at 300 mm."""
    scene = vs.load_scene(name, **parameters)
    family = Pinhole(MATRIX, pose or scene.source.pose, SIZE, np.array(distortion, float))
    return replace(scene, sources={"projector": PlainProjector(family)})
