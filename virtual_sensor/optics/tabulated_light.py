"""Light by ray maps, in Dr.Jit: what bent rays of a family meet, and which ones light a point."""

from dataclasses import dataclass
from typing import Any

from virtual_sensor.engine import dr, mi
from virtual_sensor.optics.eikonal import March, Straight
from virtual_sensor.optics.family_frames import FamilyFrame
from virtual_sensor.optics.illumination import CLEARANCE_MM, Illumination, LightStatus
from virtual_sensor.optics.ray_maps import ForwardMap, InverseMap
from virtual_sensor.optics.surfaces import SceneSurface

_REACH_MM = 0.5  # the last search for a surface reaches so far before and behind the place guessed


@dataclass
class Hits:
    """What bent rays meet; Dr.Jit arrays over the rays.

    Attributes
    ----------
    point : vector
        World, mm.
    heading : vector
        Unit direction of the ray there.
    hit : mask
    lost : mask
        Rays that seemed to meet it at first and then did not, as they do at edges.
    off : mask
        Rays off the map's box.
    """

    point: Any
    heading: Any
    hit: Any
    lost: Any
    off: Any


def hits(rays: ForwardMap, surface: SceneSurface, ray: Any, march: March) -> Hits:
    """Where bent rays meet a surface.

    The straight ray gives a first estimate, the bent ray's tangent there a second, and the tangent
    at that place the result.

    Parameters
    ----------
    rays : ForwardMap
    surface : SceneSurface
    ray : mi.Ray3f
        Straight rays of the map's family.
    march : March
        Its precision says how finely places are computed.
    """
    frame = FamilyFrame.of(rays.family, mi.Array3f)
    table = rays.linear
    line = Straight.through(ray.o, ray.d, march)
    direction, anchor = mi.Array3f(line.direction), mi.Array3f(line.anchor)
    ahead = dr.dot(direction, frame.z)
    depth_0 = frame.local(anchor)[2]
    near, far = (dr.opaque(mi.Float, float(z)) for z in (table.grid.low[2], table.grid.high[2]))
    t_middle = ((near + far) * 0.5 - depth_0) / ahead
    s, t, _ = frame.coordinates(anchor + direction * t_middle)

    def tangent(along: Any) -> tuple[Any, Any, Any]:
        """Place and unit heading of the bent ray beside the straight one at `along`."""
        place = mi.Array3f(s, t, dr.fma(along, ahead, depth_0))
        x, y, along_x, along_y = table.at(place)
        position = line.anchor + line.direction * along + frame.x * x + frame.y * y
        heading = direction + (frame.x * along_x + frame.y * along_y) * ahead
        return position, dr.normalize(heading), place

    start = mi.Float(line.start)
    met = surface.distance(mi.Array3f(ray.o), direction, dr.inf, True)
    along = dr.select(dr.isfinite(met), start + met, t_middle)
    position, heading, _ = tangent(along)
    # From before all that can be met, but not from behind the rays' start.
    back = dr.maximum(along - (near - depth_0) / ahead, 0.0) + _REACH_MM
    back = dr.minimum(back, along - start)
    met = surface.distance(position - heading * back, heading, dr.inf, True)
    hit = dr.isfinite(met)
    along = dr.select(hit, along + met - back, along)
    position, heading, place = tangent(along)
    begin = position - heading * _REACH_MM
    met = surface.distance(begin, heading, 2.0 * _REACH_MM, hit)
    met_again = dr.isfinite(met)
    point = begin + heading * dr.select(met_again, met, 0.0)
    return Hits(point, heading, hit & met_again, hit & ~met_again, ~table.holds(place))


def light(
    rays: InverseMap, surface: SceneSurface, point: Any, active: Any
) -> tuple[Illumination, Any]:
    """Light of a family's bent rays at points, and which of these are off the map.

    A shadow is searched along the chord from where the ray comes among the shapes.
    """
    frame = FamilyFrame.of(rays.family, mi.Array3f)
    table, family = rays.linear, frame.family
    point = mi.Array3f(point)
    s, t, depth = frame.coordinates(point)
    place = mi.Array3f(s, t, depth)
    shift_s, shift_t, along_x, along_y, more = table.at(place)

    def heading_of(s: Any, t: Any, beside_x: Any, beside_y: Any) -> Any:
        straight_x, straight_y = family.slope(s, t)
        return frame.heading(straight_x + beside_x, straight_y + beside_y)

    heading = heading_of(s, t, along_x, along_y)
    low, high = (dr.opaque(mi.Array3f(c)) for c in surface.corners)
    room = dr.select(heading > 0.0, point - low, high - point)
    room = dr.min(dr.abs(room) / dr.maximum(dr.abs(heading), 1e-6)) + _REACH_MM
    halfway = mi.Array3f(*frame.coordinates(point - heading * (0.5 * room)))
    chord = heading_of(s, t, *table.at(halfway)[2:4])
    lift = dr.minimum(0.1, room)
    met = surface.distance(
        point - chord * room,
        chord,
        room - dr.opaque(mi.Float, CLEARANCE_MM),
        active & (room > lift),
    )
    shadowed = active & dr.isfinite(met)
    status = dr.select(shadowed, int(LightStatus.SHADOWED), int(LightStatus.LIT))
    status = dr.select(active, status, int(LightStatus.NO_POINT))
    lit = active & ~shadowed
    spread = dr.abs(family.spread(s, t, depth)) * dr.dot(frame.z, heading)
    illumination = Illumination(
        dr.select(lit, s + shift_s, dr.nan),
        dr.select(lit, t + shift_t, dr.nan),
        heading,
        (shift_s, shift_t),
        (),
        depth,
        dr.select(lit, (1.0 + more) / spread, 0.0),
        mi.UInt32(status),
    )
    return illumination, active & ~table.holds(place)
