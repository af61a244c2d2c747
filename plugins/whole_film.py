"""What all pixels of a film see: for the light of lamps."""

from dataclasses import dataclass
from typing import Any

import numpy as np
from virtual_sensor_plugins.views import View

from virtual_sensor.engine import dr, mi
from virtual_sensor.optics.eikonal import Field, March
from virtual_sensor.optics.family_frames import FamilyFrame
from virtual_sensor.optics.map_cache import MAPS
from virtual_sensor.optics.ray_maps import NoMapError
from virtual_sensor.optics.surfaces import SceneSurface

_TOLERANCE_PX = 0.1  # of the map
_BEHIND_MM = 1.0  # what is seen lies before the map's far end


@dataclass(frozen=True)
class WholeFilm:
    """The camera's bent rays of a whole film.

    Each pixel has one displacement, that of its centre: within a pixel it changes by less than a
    tenth of one.

    Attributes
    ----------
    axes : tuple of two vectors
        The camera's x and y.
    distance : scalar
        From the camera to where the displacement is told, mm.
    moved, turned : tuple of two scalars
        Displacement there along the axes, mm, and what it adds to a ray's direction.
    """

    axes: tuple[Any, Any]
    distance: Any
    moved: tuple[Any, Any]
    turned: tuple[Any, Any]

    @staticmethod
    def of(view: View, surface: SceneSurface, medium: Field | None, march: March) -> "WholeFilm":
        """Tabulate the bent rays of all that is seen.

        Raises
        ------
        NoMapError
            If there is no map that can be trusted.
        """
        if view.camera is None:
            raise NoMapError("the camera is no pinhole")
        ray = view.centres()
        direction = mi.Array3f(ray.d)
        distance = surface.distance(mi.Array3f(ray.o), direction, dr.inf, True)
        frame = FamilyFrame.of(view.camera, mi.Array3f)
        ahead = dr.dot(direction, frame.z)
        p, q = dr.dot(direction, frame.x) / ahead, dr.dot(direction, frame.y) / ahead
        depth, valid = distance * ahead, dr.isfinite(distance)
        dr.eval(p, q, depth, ahead, valid)
        if not dr.any(valid):
            raise NoMapError("the camera sees nothing")
        low = dr.min(p), dr.min(q), dr.min(dr.select(valid, depth, dr.inf))
        high = dr.max(p), dr.max(q), dr.max(dr.select(valid, depth, -dr.inf)) + _BEHIND_MM
        first, last = (np.array([float(c[0]) for c in corner]) for corner in (low, high))
        error_mm = _TOLERANCE_PX * view.pitch * float(first[2])
        camera = MAPS.forward(medium, view.camera, first, last, march, error_mm)
        depth = dr.select(valid, depth, dr.opaque(mi.Float, float(last[2])))
        x, y, along_x, along_y = camera.linear.at(mi.Array3f(p, q, depth))
        film = WholeFilm(
            (frame.x, frame.y), depth / ahead, (x, y), (along_x * ahead, along_y * ahead)
        )
        dr.eval(film.distance, film.moved, film.turned)
        return film

    def bent(self, ray: Any, pixel: Any) -> Any:
        """The tangents of the bent rays of samples in pixels, as rays from before the camera."""
        distance, moved, turned = (
            dr.gather(mi.Float, numbers, pixel)
            if not isinstance(numbers, tuple)
            else tuple(dr.gather(mi.Float, each, pixel) for each in numbers)
            for numbers in (self.distance, self.moved, self.turned)
        )
        x, y = (mi.Vector3f(axis) for axis in self.axes)
        heading = dr.normalize(ray.d + x * turned[0] + y * turned[1])
        there = ray(distance) + x * moved[0] + y * moved[1]
        return mi.Ray3f(there - heading * distance, heading)
