"""Which laser ray lights a point: the bent laser ray through a given point, found by Newton.

A laser ray is named by its coordinates (a, b), across the sheet and along the line, in the
reference plane (see `sensor_model.LaserLine`).  The ray through a point P is the root of

    F(a, b) = where the bent ray crosses the plane through P square to the laser's axis, minus P,

and the same Jacobian dF/d(a, b) that Newton needs tells how the field concentrates the light: flux
is conserved in a tube of rays.
"""

from dataclasses import dataclass, replace
from enum import IntEnum
from typing import Any

from virtual_sensor.engine import dr, mi
from virtual_sensor.optics.eikonal import BentRays, Field, March, Straight, bend, in_plane
from virtual_sensor.optics.ray_status import RayStatus
from virtual_sensor.optics.sensor_model import LaserLine
from virtual_sensor.optics.surfaces import NoSurface, Surface

_SETTLED_MM = 5e-3  # a Newton correction below this leaves an error of about 0.01 um
_MAX_MARCHES = 8
_CLEARANCE_MM = 0.05  # shadows are looked for up to here before the point itself


class LightStatus(IntEnum):
    """Whether the laser reaches a point."""

    LIT = 0
    """A laser ray of these coordinates arrives (its intensity may still be nil)."""
    SHADOWED = 1
    """Something stands in its way."""
    FOLDED = 2
    """Newton found no single laser ray: a caustic, or rays turned away."""
    NO_POINT = 3
    """There was no point to light."""


@dataclass
class Illumination:
    """Light of the laser at points; Dr.Jit arrays over the points.

    Attributes
    ----------
    a, b : scalar
        Coordinates in mm of the laser ray that arrives; NaN unless LIT.
    heading : vector
        Unit direction of the arriving light, world.
    shift : tuple of two scalars
        (a, b) minus the coordinates of the straight ray through the point, mm.
    jacobian : tuple of four scalars, or None
        dF/d(a, b) by rows: (aa, ab, ba, bb); None of light that a table tells of.
    concentration : scalar
        Flux density square to the light over that in the reference plane.
    status : int
        `LightStatus`.
    """

    a: Any
    b: Any
    heading: Any
    shift: tuple[Any, Any]
    jacobian: tuple[Any, Any, Any, Any] | None
    concentration: Any
    status: Any


@dataclass(frozen=True)
class LaserFrame:
    """The laser's frame in Dr.Jit: unit axes, and the reference plane's centre along each (mm)."""

    across: Any
    along: Any
    axis: Any
    centre: tuple[Any, Any, Any]
    distance_mm: float
    fan_per_mm: float

    @staticmethod
    def of(laser: LaserLine, vector: Any) -> "LaserFrame":
        """Take over a laser in the precision of a vector type."""
        rotation = laser.pose.rotation
        middle = (laser.pose.origin_mm + laser.distance_mm * rotation[:, 2]) @ rotation
        across, along, axis = (vector(*map(float, rotation[:, i])) for i in range(3))
        x, y, z = map(float, middle)
        centre = (x, y, z)
        return LaserFrame(across, along, axis, centre, laser.distance_mm, laser.fan_per_mm)

    def opaque(self) -> "LaserFrame":
        """The same with its pose out of the compiler's sight: one kernel serves all poses."""
        scalar = type(self.axis.x)
        return replace(
            self,
            across=dr.opaque(self.across),
            along=dr.opaque(self.along),
            axis=dr.opaque(self.axis),
            centre=tuple(dr.opaque(scalar, number) for number in self.centre),
        )

    def coordinates(self, p: Any) -> tuple[Any, Any, Any]:
        """Across, along and depth beyond the reference plane of points, in mm."""
        x, y, z = self.centre
        return dr.dot(self.across, p) - x, dr.dot(self.along, p) - y, dr.dot(self.axis, p) - z

    def straight(self, p: Any) -> tuple[Any, Any]:
        """Coordinates (a, b) of the laser ray through points if light runs straight."""
        a, y, depth = self.coordinates(p)
        return a, y / (1.0 + self.fan_per_mm * depth)

    def rays(self, a: Any, b: Any) -> tuple[Any, Any, tuple[tuple[Any, Any], ...]]:
        """Origins, unit directions, and their derivatives by a and by b."""
        g, exit_scale = self.fan_per_mm, 1.0 - self.fan_per_mm * self.distance_mm
        x, y, z = self.centre
        origin = (
            self.across * (a + x)
            + self.along * (b * exit_scale + y)
            + self.axis * (z - self.distance_mm)
        )
        slope = self.axis + self.along * (g * b)
        norm = dr.sqrt(1.0 + dr.square(g * b))
        by_a = (self.across + 0.0 * origin, 0.0 * origin)
        by_b = (
            self.along * exit_scale + 0.0 * origin,
            self.along * (g / norm) - slope * (g * g * b / norm**3),
        )
        return origin, slope / norm, (by_a, by_b)


def illuminate(
    laser: LaserLine,
    field: Field | None,
    surface: Surface,
    points: Any,
    march: March,
    *,
    guess: tuple[Any, Any, tuple[Any, Any, Any, Any]] | None = None,
    active: Any = True,
) -> Illumination:
    """Find the laser ray that lights each point.

    Parameters
    ----------
    points : vector
        World points in mm in the march's precision, on the surface or free.
    guess : tuple, optional
        What is known from a near-by point: its ``shift`` and its Jacobian.  It saves marches.
    active : mask

    Notes
    -----
    Without a guess the first two marches carry tangents, which give the Jacobian; the later ones
    keep it (the chord method), and also look for shadows.
    """
    frame = LaserFrame.of(laser, march.vector).opaque()
    x, y, depth = frame.coordinates(points)
    wanted = dr.full(mi.Mask, True, dr.width(points)) & active
    straight = frame.straight(points)
    a, b = straight
    jacobian: Any = None
    if guess is not None:
        a, b, jacobian = a + guess[0], b + guess[1], guess[2]
    heading = frame.axis + 0.0 * points
    shadowed = dr.full(mi.Mask, False, dr.width(points))
    settled = dr.full(mi.Mask, False, dr.width(points))
    for number in range(_MAX_MARCHES):
        newton = guess is None and number < 2
        origin, direction, by_start = frame.rays(a, b)
        line = Straight.through(origin, direction, march)
        to_plane = depth + frame.centre[2] - dr.dot(frame.axis, line.anchor)
        ray = bend(
            field,
            NoSurface() if newton else surface,
            line,
            march,
            remaining=in_plane(frame.axis, to_plane - _CLEARANCE_MM),
            tangents=by_start if newton else (),
            active=wanted & ~settled,
        )
        arrived = ray.status == int(RayStatus.ENDED)
        ray = ray.moved(_CLEARANCE_MM / dr.dot(frame.axis, ray.tangent(line)))
        if newton:
            jacobian = _jacobian(frame, line, ray)
        at = frame.coordinates(ray.position(line))
        da, db = _solve(jacobian, x - at[0], y - at[1])
        go = wanted & ~settled & arrived
        heading = dr.select(go, dr.normalize(ray.tangent(line)), heading)
        a, b = dr.select(go, a + da, a), dr.select(go, b + db, b)
        if not newton:
            shadowed |= wanted & ~settled & (ray.status == int(RayStatus.HIT))
            settled |= shadowed
        settled |= go & (dr.maximum(dr.abs(da), dr.abs(db)) < _SETTLED_MM) & (not newton)
        dr.eval(a, b, jacobian, heading, settled, shadowed)
        if not dr.any(wanted & ~settled):
            break
    folded = wanted & (~settled | (_determinant(jacobian) <= 0.0))
    status = dr.select(shadowed, int(LightStatus.SHADOWED), int(LightStatus.LIT))
    status = dr.select(folded, int(LightStatus.FOLDED), mi.UInt32(status))
    status = dr.select(wanted, status, int(LightStatus.NO_POINT))
    lit = wanted & (status == int(LightStatus.LIT))
    spread = _determinant(jacobian) * dr.dot(frame.axis, heading)
    return Illumination(
        dr.select(lit, a, dr.nan),
        dr.select(lit, b, dr.nan),
        heading,
        (a - straight[0], b - straight[1]),
        jacobian,
        dr.select(lit, dr.rcp(spread), 0.0),
        status,
    )


def _jacobian(frame: LaserFrame, line: Straight, ray: BentRays) -> tuple[Any, Any, Any, Any]:
    """How the place in the plane square to the axis changes with (a, b), by the tangents."""
    T = ray.tangent(line)
    columns = [w - T * (dr.dot(frame.axis, w) / dr.dot(frame.axis, T)) for w in ray.offset[1:]]
    (aa, ab), (ba, bb) = (
        [dr.dot(axis, w) for w in columns] for axis in (frame.across, frame.along)
    )
    return aa, ab, ba, bb


def _determinant(j: tuple[Any, Any, Any, Any]) -> Any:
    return j[0] * j[3] - j[1] * j[2]


def _solve(j: tuple[Any, Any, Any, Any], x: Any, y: Any) -> tuple[Any, Any]:
    """Cramer's rule."""
    det = _determinant(j)
    return (j[3] * x - j[1] * y) / det, (j[0] * y - j[2] * x) / det
