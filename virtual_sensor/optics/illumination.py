"""Which ray of a source lights a point: the bent ray through a given point, found by Newton.

The ray of a family (`ray_families`) through a point P is the root of

    F(s, t) = where the bent ray crosses the plane through P square to the family's axis, minus P,

and the same Jacobian dF/d(s, t) that Newton needs gives how the field concentrates the light: flux
is conserved in a tube of rays.
"""

from dataclasses import dataclass
from typing import Any

from virtual_sensor.arrays import determinant, solved
from virtual_sensor.engine import dr, mi
from virtual_sensor.optics.eikonal import BentRays, Field, March, Straight, bend, in_plane
from virtual_sensor.optics.family_frames import FamilyFrame
from virtual_sensor.optics.ray_families import RayFamily
from virtual_sensor.optics.ray_status import RayStatus
from virtual_sensor.optics.surfaces import NoSurface, Surface
from virtual_sensor.statuses import StatusEnum

_SETTLED_MM = 5e-3  # of a miss: Newton's correction of it leaves about 0.01 um
_MAX_MARCHES = 8

CLEARANCE_MM = 0.05
"""Shadows are searched up to here before the point itself."""


class LightStatus(StatusEnum):
    """Whether a source reaches a point."""

    LIT = 0, "A ray of these coordinates arrives, though its intensity may be nil."
    SHADOWED = 1, "The ray is blocked: another part of the surface stands in the light."
    FOLDED = 2, "No single ray was found, at a caustic or where rays turn away: the pixel is black."
    NO_POINT = 3, "There was no point to light: the line of sight meets no surface."


@dataclass
class Illumination:
    """Light of a source at points; Dr.Jit arrays over the points.

    Attributes
    ----------
    s, t : scalar
        Coordinates of the ray that arrives; NaN unless LIT.
    heading : vector
        Unit direction of the arriving light, world.
    shift : tuple of two scalars
        (s, t) minus the coordinates of the straight ray through the point.
    jacobian : tuple of four scalars
        dF/d(s, t) by rows: (x by s, x by t, y by s, y by t); empty of light that was found by maps.
    depth : scalar
        Of the point in the family's frame.
    concentration : scalar
        Flux density square to the light over the flux per unit of both coordinates.
    status : int
        `LightStatus`.
    """

    s: Any
    t: Any
    heading: Any
    shift: tuple[Any, Any]
    jacobian: tuple[Any, ...]
    depth: Any
    concentration: Any
    status: Any


def illuminate(
    family: RayFamily,
    field: Field | None,
    surface: Surface,
    points: Any,
    march: March,
    *,
    near: Illumination | None = None,
    active: Any = True,
) -> Illumination:
    """Find the ray of a source that lights each point.

    Parameters
    ----------
    family : RayFamily
        The source's.
    points : vector
        World points in mm in the march's precision, on the surface or free.
    near : Illumination, optional
        Marched light at a point close to each: it saves marches.
    active : mask

    Notes
    -----
    Without light near by the first two marches carry tangents, which give the Jacobian; the later
    ones keep it (the chord method), and also search for shadows.
    """
    frame = FamilyFrame.of(family, march.vector)
    x, y, depth = frame.local(points)
    wanted = dr.full(mi.Mask, True, dr.width(points)) & active
    straight = frame.coordinates(points)[:2]
    s, t = straight
    jacobian: Any = None
    if near is not None and near.jacobian:
        known = dr.isfinite(near.s)
        s, t = (x0 + dr.select(known, d, 0.0) for x0, d in zip(straight, near.shift, strict=True))
        pairs = zip(near.jacobian, frame.family.by_coordinates(*straight, depth), strict=True)
        jacobian = tuple(dr.select(known, j, march.scalar(j0)) for j, j0 in pairs)
    heading = frame.z + 0.0 * points
    shadowed = dr.full(mi.Mask, False, dr.width(points))
    settled = dr.full(mi.Mask, False, dr.width(points))
    for number in range(_MAX_MARCHES):
        newton = near is None and number < 2
        origin, direction, by_start = frame.rays(s, t)
        line = Straight.through(origin, direction, march)
        to_plane = depth - frame.local(line.anchor)[2]
        ray = bend(
            field,
            NoSurface() if newton else surface,
            line,
            march,
            remaining=in_plane(frame.z, to_plane - CLEARANCE_MM),
            tangents=by_start if newton else (),
            active=wanted & ~settled,
        )
        arrived = ray.status == int(RayStatus.ENDED)
        ray = ray.moved(CLEARANCE_MM / dr.dot(frame.z, ray.tangent(line)))
        if newton:
            jacobian = _jacobian(frame, line, ray)
        at_x, at_y, _ = frame.local(ray.position(line))
        miss = x - at_x, y - at_y
        ds, dt = solved(jacobian, *miss)
        go = wanted & ~settled & arrived
        heading = dr.select(go, dr.normalize(ray.tangent(line)), heading)
        s, t = dr.select(go, s + ds, s), dr.select(go, t + dt, t)
        if not newton:
            shadowed |= wanted & ~settled & (ray.status == int(RayStatus.HIT))
            settled |= shadowed
        close = dr.maximum(dr.abs(miss[0]), dr.abs(miss[1])) < _SETTLED_MM
        settled |= go & close & (not newton)
        dr.eval(s, t, jacobian, heading, settled, shadowed)
        if not dr.any(wanted & ~settled):
            break
    spread = determinant(jacobian) * dr.sign(frame.family.spread(s, t, depth))
    folded = wanted & (~settled | (spread <= 0.0))
    status = dr.select(shadowed, int(LightStatus.SHADOWED), int(LightStatus.LIT))
    status = dr.select(folded, int(LightStatus.FOLDED), mi.UInt32(status))
    status = dr.select(wanted, status, int(LightStatus.NO_POINT))
    lit = wanted & (status == int(LightStatus.LIT))
    return Illumination(
        dr.select(lit, s, dr.nan),
        dr.select(lit, t, dr.nan),
        heading,
        (s - straight[0], t - straight[1]),
        jacobian,
        depth,
        dr.select(lit, dr.rcp(spread * dr.dot(frame.z, heading)), 0.0),
        status,
    )


def _jacobian(frame: FamilyFrame, line: Straight, ray: BentRays) -> tuple[Any, Any, Any, Any]:
    """How the place in the plane square to the axis changes with (s, t), by the tangents."""
    T = ray.tangent(line)
    columns = [w - T * (dr.dot(frame.z, w) / dr.dot(frame.z, T)) for w in ray.offset[1:]]
    (x_s, x_t), (y_s, y_t) = ([dr.dot(axis, w) for w in columns] for axis in (frame.x, frame.y))
    return x_s, x_t, y_s, y_t
