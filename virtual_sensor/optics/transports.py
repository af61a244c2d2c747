"""Transports: how light gets from a camera to a surface, and from there to its sources."""

from dataclasses import dataclass, fields, is_dataclass, replace
from typing import Any

import numpy as np
from numpy.typing import NDArray

from virtual_sensor.display import Displayed, listed
from virtual_sensor.engine import dr, mi
from virtual_sensor.errors import InputError
from virtual_sensor.optics.eikonal import LAST_PIECE_MM, bend
from virtual_sensor.optics.illumination import Illumination, LightStatus, illuminate
from virtual_sensor.optics.ray_maps import ForwardMap, InverseMap
from virtual_sensor.optics.ray_status import RayStatus
from virtual_sensor.optics.rays import Field, March, Straight
from virtual_sensor.optics.sources import Source
from virtual_sensor.optics.surfaces import SceneSurface
from virtual_sensor.optics.tabulated_light import hits
from virtual_sensor.optics.tabulated_light import light as light_by

Array = NDArray[np.float64]

TRANSPORTS = ("tabulated", "marched", "first_order", "straight")
"""How bent rays are found, by name."""


@dataclass(frozen=True)
class Transport(Displayed):
    """How bent rays are found.

    Attributes
    ----------
    name : str
        "tabulated": from maps of the bent rays; "marched": each sample's rays are marched, its
        source's ray found by Newton; "first_order": so, but deflected as if it ran straight;
        "straight": no refraction.
    march : March
        Its `first_order` is as the name says.
    tolerance_px : float
        Largest error of the maps.

    Raises
    ------
    InputError
        If there is no such transport, or the tolerance is no positive number.
    """

    name: str
    march: March
    tolerance_px: float = 0.003

    def __post_init__(self) -> None:
        if self.name not in TRANSPORTS:
            raise InputError(f"'transport' must be one of {', '.join(TRANSPORTS)}, not {self.name}")
        if not 0.0 < self.tolerance_px < np.inf:
            raise InputError(
                f"'tolerance' must be a positive number of px, not {self.tolerance_px}"
            )
        march = replace(self.march, first_order=self.name == "first_order")
        object.__setattr__(self, "march", march)

    def _line(self) -> str:
        error = f"to {self.tolerance_px:g} px" if self.name == "tabulated" else ""
        return listed(f"{self.name} {error}".rstrip(), f"{self.march}")

    def check(self, medium: Field | None) -> None:
        """Raise InputError if the march can't get through the air."""
        self.march.check(None if self.name == "straight" else medium)

    def by(self, name: str | None = None, **march: Any) -> "Transport":
        """Another transport, or the same one with other settings of its march."""
        return replace(self, name=name or self.name, march=replace(self.march, **march))


@dataclass
class Sight:
    """What camera rays see; Dr.Jit arrays over the rays.

    Attributes
    ----------
    point : vector
        Hit point, world, mm.
    heading : vector
        Unit direction of the camera ray there.
    hit : mask
    lights : tuple of Illumination
        Of each source, at the points.
    """

    point: Any
    heading: Any
    hit: Any
    lights: tuple[Illumination, ...]

    def met(self, scene: mi.Scene) -> tuple[Any, Any, Any]:
        """What the rays meet in Mitsuba's scene, their directions there, and which do."""
        heading = mi.Vector3f(self.heading)
        last = mi.Ray3f(mi.Point3f(self.point) - heading * LAST_PIECE_MM, heading)
        si = scene.ray_intersect(last, self.hit)
        return si, heading, self.hit & si.is_valid()


@dataclass(frozen=True)
class Marched(Displayed):
    """Rays are marched to the surface; there, each source's ray is found by Newton's method.

    Attributes
    ----------
    medium : Field or None
        None: light runs straight.
    surface : SceneSurface
    sources : tuple of Source
    march : March
    """

    medium: Field | None
    surface: SceneSurface
    sources: tuple[Source, ...]
    march: March

    def hits(self, ray: Any) -> Sight:
        """Where camera rays meet the surface, and none of the light there."""
        line = Straight.through(ray.o, ray.d, self.march)
        bent = bend(self.medium, self.surface, line, self.march)
        hit = bent.status == int(RayStatus.HIT)
        point, heading = bent.position(line), dr.normalize(bent.tangent(line))
        dr.eval(point, heading, hit)  # else what uses them would march again
        return Sight(point, heading, hit, ())

    def lights(
        self, points: Any, active: Any, near: Sight | None = None
    ) -> tuple[Illumination, ...]:
        """Light of each source at points of the surface, evaluated; `near` as of `sight`."""
        points, lights = self.march.vector(points), []
        for i, source in enumerate(self.sources):
            light = illuminate(
                source.family,
                self.medium,
                self.surface,
                points,
                self.march,
                near=near.lights[i] if near else None,
                active=active,
            )
            dr.eval(light)
            lights.append(light)
        return tuple(lights)

    def sight(self, ray: Any, near: Sight | None = None) -> tuple[Sight, int]:
        """What camera rays see, evaluated; and how many of them were marched.

        Parameters
        ----------
        ray : mi.Ray3f
            Straight rays of the camera.
        near : Sight, optional
            What rays close by see, one for each: it saves marches.
        """
        seen, count = self.hits(ray), dr.width(ray.d)
        seen = replace(seen, lights=self.lights(seen.point, seen.hit, near))
        if near is None:
            return seen, count
        doubtful = mi.Mask(False)
        for light, centre in zip(seen.lights, near.lights, strict=True):
            # A dark centre beside a step leads astray; a folded one stays dark.
            folded = centre.status == int(LightStatus.FOLDED)
            light.concentration = dr.select(folded, 0.0, light.concentration)
            sure = dr.isfinite(centre.s) & (light.status == int(LightStatus.LIT))
            doubtful |= seen.hit & ~sure & ~folded
        dr.eval(seen, doubtful)
        return self.again(ray, seen, doubtful)[0], count

    def again(self, ray: Any, seen: Sight, doubtful: Any) -> tuple[Sight, int]:
        """A sight whose doubtful rows are marched, from nothing known; and their number."""
        if not dr.any(doubtful):
            return seen, 0
        which = dr.compress(doubtful)
        marched, count = self.sight(dr.gather(type(ray), ray, which))
        return with_rows(seen, which, marched), count


@dataclass(frozen=True)
class Tabulated(Displayed):
    """Ray maps answer for camera and sources; rays that they don't hold are marched.

    Attributes
    ----------
    camera : ForwardMap
    maps : tuple of InverseMap
        Of the sources.
    pads : tuple of ndarray of shape (2,)
        How near to a source's light, in its coordinates, its map must hold a ray.
    marched : Marched
    """

    camera: ForwardMap
    maps: tuple[InverseMap, ...]
    pads: tuple[Array, ...]
    marched: Marched

    def sight(self, ray: Any, near: Sight | None = None) -> tuple[Sight, int]:
        """As `Marched.sight`, which `near` is for; one kernel serves any number of rays."""
        dr.eval(ray.o, ray.d)
        seen = hits(self.camera, self.marched.surface, ray, self.marched.march)
        lights, doubtful = self._by_maps(seen.point, seen.hit, seen.off)
        sight = Sight(seen.point, seen.heading, seen.hit, lights)
        doubtful |= seen.lost
        dr.eval(sight, doubtful)
        return self.marched.again(ray, sight, doubtful)

    def lights(self, points: Any, active: Any) -> tuple[Illumination, ...]:
        """Light of each source at points of the surface, evaluated."""
        lights, doubtful = self._by_maps(points, active, mi.Mask(False))
        dr.eval(lights, doubtful)
        if not dr.any(doubtful):
            return lights
        which = dr.compress(doubtful)
        marched = self.marched.lights(dr.gather(type(points), points, which), True)
        found: tuple[Illumination, ...] = with_rows(lights, which, marched)
        return found

    def _by_maps(self, points: Any, active: Any, off: Any) -> tuple[tuple[Illumination, ...], Any]:
        """Light at points, and at which of these it is to be marched; `off` the camera's map."""
        lights: tuple[Illumination, ...] = ()
        doubtful = mi.Mask(False)
        for source, table, pad in zip(self.marched.sources, self.maps, self.pads, strict=True):
            light, off_map = light_by(table, self.marched.surface, points, active)
            near_light = source.reaches(light.s, light.t, opaque(pad), light.depth)
            doubtful |= active & near_light & (off | off_map)
            lights = (*lights, light)
        return lights, doubtful


Tracer = Marched | Tabulated
"""A transport through a scene's air, to its surface and from its sources."""


def opaque(margin: Array) -> tuple[Any, ...]:
    """A margin out of the compiler's sight: another air has another, and one kernel serves all."""
    return tuple(dr.opaque(mi.Float, float(m)) for m in margin)


def with_rows(tree: Any, index: Any, given: Any) -> Any:
    """Dr.Jit arrays nested in dataclasses and tuples, with some rows replaced by those given."""
    if isinstance(tree, tuple):
        # Light by maps has no Jacobian.
        return tuple(with_rows(a, index, b) for a, b in zip(tree, given, strict=False))
    if is_dataclass(tree) and not isinstance(tree, type):
        names = [f.name for f in fields(tree)]
        new = {n: with_rows(getattr(tree, n), index, getattr(given, n)) for n in names}
        return replace(tree, **new)
    copy = type(tree)(tree)
    dr.scatter(copy, type(tree)(given), index)
    return copy
