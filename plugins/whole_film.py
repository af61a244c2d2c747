"""What all pixels of a film see: for the light of lamps."""

from dataclasses import dataclass
from typing import Any

import numpy as np
from virtual_sensor_plugins.views import StraightSight

from virtual_sensor.engine import dr, mi
from virtual_sensor.optics.eikonal import Field, March
from virtual_sensor.optics.family_frames import FamilyFrame
from virtual_sensor.optics.map_cache import MAPS
from virtual_sensor.optics.ray_maps import MapRequest, NoMapError

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
    offset, turn : tuple of two scalars
        By how much the tangents of the bent rays start beside the straight rays along these axes,
        mm, and what is added to their directions.
    """

    axes: tuple[Any, Any]
    offset: tuple[Any, Any]
    turn: tuple[Any, Any]

    @staticmethod
    def of(straight: StraightSight, medium: Field | None, march: March) -> "WholeFilm":
        """Tabulate the bent rays of all that is seen.

        Raises
        ------
        NoMapError
            If there is no map that can be trusted.
        """
        view, distance = straight.view, straight.distance
        if view.camera is None:
            raise NoMapError("the camera is no pinhole")
        ray, frame = view.centres(), FamilyFrame.of(view.camera, mi.Array3f)
        direction, seen = mi.Array3f(ray.d), dr.isfinite(distance)
        ahead = dr.dot(direction, frame.z)
        depth = dr.select(seen, distance * ahead, dr.nan)
        dr.eval(depth)
        ends = dr.min(dr.select(seen, depth, dr.inf)), dr.max(dr.select(seen, depth, -dr.inf))
        near, far = (float(end[0]) for end in ends)
        if far < near:
            raise NoMapError("the camera sees nothing")
        far += _BEHIND_MM
        (p0, q0), (p1, q1) = view.corners
        low, high = np.array([p0, q0, near]), np.array([p1, q1, far])
        error_mm = _TOLERANCE_PX * view.pitch * near
        asked = MapRequest(medium, view.camera, low, high, march, error_mm)
        p, q = dr.dot(direction, frame.x) / ahead, dr.dot(direction, frame.y) / ahead
        place = mi.Array3f(p, q, dr.select(seen, depth, dr.opaque(mi.Float, far)))
        x, y, along_x, along_y = MAPS.forward(asked).linear.at(place)
        turn = along_x * ahead, along_y * ahead
        told_at = place.z / ahead
        offset = x - told_at * turn[0], y - told_at * turn[1]
        dr.eval(offset, turn)
        return WholeFilm((frame.x, frame.y), offset, turn)

    def bent(self, ray: Any, pixel: Any) -> Any:
        """The tangents of the bent rays of samples in pixels, as rays from the camera."""
        x, y = (mi.Vector3f(axis) for axis in self.axes)
        by_x, by_y, turn_x, turn_y = (
            dr.gather(mi.Float, numbers, pixel) for numbers in (*self.offset, *self.turn)
        )
        heading = dr.normalize(ray.d + x * turn_x + y * turn_y)
        return mi.Ray3f(ray.o + x * by_x + y * by_y, heading)
