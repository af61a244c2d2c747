"""What stops a ray: any Mitsuba scene, or the analytic cylinder in the rays' own precision."""

from dataclasses import dataclass
from typing import Any, Protocol

import numpy as np
from numpy.typing import NDArray

from virtual_sensor.arrays import to_numpy, to_vectors
from virtual_sensor.display import Displayed
from virtual_sensor.engine import dr, mi
from virtual_sensor.errors import EngineError

Array = NDArray[np.float64]

_NEAR_MM = 1.0  # float32 hits from so near are good to 0.03 um


class Surface(Protocol):
    """Something that straight segments of a ray can meet."""

    def distance(self, origin: Any, direction: Any, limit: Any, active: Any) -> Any:
        """Distance in mm to the first point met along unit directions; inf for none in reach."""

    def starts_inside(self, origin: Any, direction: Any) -> Any:
        """Mask of the rays that start inside the solid."""


@dataclass(frozen=True)
class NoSurface(Displayed):
    """There is nothing to meet."""

    def distance(self, origin: Any, direction: Any, limit: Any, active: Any) -> Any:
        """Infinite."""
        return dr.full(type(direction.x), dr.inf, dr.width(direction))

    def starts_inside(self, origin: Any, direction: Any) -> Any:
        """Nowhere."""
        return dr.full(mi.Mask, False, dr.width(direction))


def own_variant(scene: Any) -> None:
    """Ask whether a Mitsuba scene is of the variant that is set.

    Raises
    ------
    EngineError
        If it was loaded under another: its numbers are of other types.
    """
    if not isinstance(scene, mi.Scene):
        raise EngineError(
            f"the scene was loaded under another Mitsuba variant than {mi.variant()!r}, which is"
            " set now: set its own again (mitsuba.set_variant), or load it again"
        )


@dataclass(frozen=True)
class SceneSurface(Displayed):
    """All shapes of a Mitsuba scene.  Its intersections are float32: keep the segments short."""

    scene: Any

    def _line(self) -> str:
        return "of the scene's shapes"

    @property
    def corners(self) -> tuple[Any, Any]:
        """Lower and upper corner of the box that holds all shapes, mm."""
        box = self.scene.bbox()
        return box.min, box.max

    def distance(self, origin: Any, direction: Any, limit: Any, active: Any) -> Any:
        """See `Surface`."""
        own_variant(self.scene)
        ray = mi.Ray3f(mi.Point3f(origin), mi.Vector3f(direction))
        ray.maxt = mi.Float(limit)
        met = self.scene.ray_intersect_preliminary(ray, active=active)
        return type(direction.x)(dr.select(met.is_valid(), met.t, dr.inf))

    def normals(self, points: Array, directions: Array, before_mm: float = _NEAR_MM) -> Array:
        """Normals (N, 3) at points on it that unit directions come to, from so far before; 0: none.

        They are the shapes' own, not those that are interpolated for shading.
        """
        start, heading = to_vectors(points - before_mm * directions), to_vectors(directions)
        met = self.scene.ray_intersect(mi.Ray3f(mi.Point3f(start), mi.Vector3f(heading)))
        return to_numpy(met.n)

    def starts_inside(self, origin: Any, direction: Any) -> Any:
        """True where the first face met is seen from behind, by a ray from among the shapes."""
        own_variant(self.scene)
        box = self.scene.bbox()
        among = dr.all((origin >= box.min) & (origin <= box.max))
        ray = mi.Ray3f(mi.Point3f(origin), mi.Vector3f(direction))
        si = self.scene.ray_intersect(ray)
        return among & si.is_valid() & (dr.dot(si.n, ray.d) > 0.0)


@dataclass(frozen=True)
class Cylinder(Displayed):
    """A solid cylinder with its end faces, along x; in the precision of the rays.

    Attributes
    ----------
    radius_mm, half_length_mm : float
    axis_y_mm, axis_z_mm : float
        Where the axis lies; x = 0 is its middle.  The defaults are the paper's cylinder.
    """

    radius_mm: float = 13.5
    half_length_mm: float = 85.0
    axis_y_mm: float = 0.0
    axis_z_mm: float = -13.5

    def distance(self, origin: Any, direction: Any, limit: Any, active: Any) -> Any:
        """Where the ray enters both the round tube and the slab between the end faces."""
        y, z = origin.y - self.axis_y_mm, origin.z - self.axis_z_mm
        # Not zero, so that a ray along the axis is in the tube for its whole length, or never.
        a = dr.maximum(dr.square(direction.y) + dr.square(direction.z), 1e-30)
        b = y * direction.y + z * direction.z
        c = dr.square(y) + dr.square(z) - self.radius_mm**2
        root = dr.safe_sqrt(dr.square(b) - a * c)
        # The stable form of (-b -+ root) / a: no cancellation.
        q = -(b + dr.copysign(root, b))
        tube_in, tube_out = dr.minimum(q / a, c / q), dr.maximum(q / a, c / q)
        ends = [(s * self.half_length_mm - origin.x) / direction.x for s in (-1.0, 1.0)]
        enters = dr.maximum(tube_in, dr.minimum(*ends))
        leaves = dr.minimum(tube_out, dr.maximum(*ends))
        met = (dr.square(b) > a * c) & (enters < leaves) & (enters >= 0.0) & (enters <= limit)
        return dr.select(met, enters, dr.inf)

    def normals(self, points: Array, directions: Array, before_mm: float = _NEAR_MM) -> Array:
        """Normals (N, 3) at points on it, of any length, whatever the directions."""
        x, y, z = (points - [0.0, self.axis_y_mm, self.axis_z_mm]).T
        on_end = np.abs(x) > self.half_length_mm - 1e-6
        on_end &= np.hypot(y, z) < self.radius_mm - 1e-6
        return np.column_stack([np.where(on_end, x, 0.0), ~on_end * y, ~on_end * z])

    def starts_inside(self, origin: Any, direction: Any) -> Any:
        """See `Surface`."""
        y, z = origin.y - self.axis_y_mm, origin.z - self.axis_z_mm
        within = dr.square(y) + dr.square(z) < self.radius_mm**2
        return within & (dr.abs(origin.x) < self.half_length_mm)


def slab(p: Any, direction: Any, box: tuple[Any, Any]) -> tuple[Any, Any]:
    """Where lines enter and leave a box, in units of the direction's length."""
    inverse = dr.rcp(dr.select(direction == 0.0, 1e-30, direction))
    one, two = (box[0] - p) * inverse, (box[1] - p) * inverse
    return dr.max(dr.minimum(one, two)), dr.min(dr.maximum(one, two))
