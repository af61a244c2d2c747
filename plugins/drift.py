"""A frame's camera and sources on their way, a little beside where its maps have them."""

from dataclasses import dataclass, replace
from typing import Any

import numpy as np
from numpy.typing import NDArray

from virtual_sensor.engine import dr, mi
from virtual_sensor.optics.family_frames import FamilyFrame
from virtual_sensor.optics.illumination import Illumination
from virtual_sensor.optics.sources import Source

Array = NDArray[np.float64]

_LEAN = 3.0  # light on a part that leans moves so many times as far as the sensor, up to 70 degrees


@dataclass(frozen=True)
class Drift:
    """How far camera and sources are from where they stand while rows of the film are exposed.

    All by the same shift, which turns nothing.  Each row may have its own, as of a rolling shutter.

    Attributes
    ----------
    first_mm : ndarray of shape (3,)
        World, at the film's row 0.
    per_row_mm : ndarray of shape (3,)
        What each row adds.
    rows : slice
        Rows of the film that are exposed.
    within_px : tuple of two float
        By how much the samples are moved within their pixels.
    spread : float
        By how much farther from the pixel's middle they are.
    """

    first_mm: Array
    per_row_mm: Array
    rows: slice
    within_px: tuple[float, float] = (0.0, 0.0)
    spread: float = 1.0

    def at(self, row: Any) -> Any:
        """The shift in rows of the film, Dr.Jit's: a vector, mm."""
        first, step = (
            dr.opaque(mi.Array3f(*map(float, numbers)))
            for numbers in (self.first_mm, self.per_row_mm)
        )
        return first + step * mi.Float(row)

    def shifts(self, row: Array) -> Array:
        """Likewise NumPy's: (N, 3) of rows (N,)."""
        return self.first_mm + row[:, None] * self.per_row_mm

    def within(self, place: Any) -> Any:
        """Places of samples within pixels, from 0 to 1."""
        aside = (place - 0.5) * dr.opaque(mi.Float, self.spread)
        moved = aside + 0.5 + dr.opaque(mi.Point2f, self.within_px)
        return moved - dr.floor(moved)

    def ray(self, ray: Any, row: Any) -> Any:
        """Rays of the camera from where it is then."""
        moved = mi.Ray3f(mi.Point3f(mi.Array3f(ray.o) + self.at(row)), ray.d)
        moved.maxt = ray.maxt
        return moved

    def lights(
        self,
        lights: tuple[Illumination, ...],
        sources: tuple[Source, ...],
        point: Any,
        row: Any,
    ) -> tuple[Illumination, ...]:
        """The sources' light at points from where they are then.

        Refraction and shadows are taken from where they stand, a fraction of a mm away.
        """
        shift = self.at(row)
        pairs = zip(lights, sources, strict=True)
        return tuple(_moved(light, source, mi.Array3f(point), shift) for light, source in pairs)


def _moved(light: Illumination, source: Source, point: Any, shift: Any) -> Illumination:
    frame = FamilyFrame.of(source.family, mi.Array3f)
    s, t, depth = frame.coordinates(point)
    new_s, new_t, new_depth = frame.coordinates(point - shift)
    spread = frame.family.spread(s, t, depth) / frame.family.spread(new_s, new_t, new_depth)
    return replace(
        light,
        s=light.s + (new_s - s),
        t=light.t + (new_t - t),
        depth=light.depth + (new_depth - depth),
        concentration=light.concentration * dr.abs(spread),
    )


@dataclass(frozen=True)
class Widened:
    """A source with room beside its light: for light that moves over a part meanwhile.

    Attributes
    ----------
    source : Source
    room : ndarray of shape (2,)
        In its coordinates.
    """

    source: Source
    room: Array

    @staticmethod
    def of(source: Source, drift_mm: float, per_mm: Array) -> "Widened":
        """With room for a drift up to a distance, given the units of its coordinates per mm."""
        return Widened(source, _LEAN * drift_mm * per_mm)

    @property
    def family(self) -> Any:
        """Its rays."""
        return self.source.family

    @property
    def extent(self) -> tuple[Array, Array]:
        """Lowest and highest (s, t) with light that counts, or room."""
        low, high = self.source.extent
        return low - self.room, high + self.room

    def reaches(
        self, s: Any, t: Any, margin: tuple[Any, Any] = (0.0, 0.0), depth: Any = None
    ) -> Any:
        """Mask of the coordinates with light or room, or near them; NaN has none."""
        wide = tuple(by + float(room) for by, room in zip(margin, self.room, strict=True))
        return self.source.reaches(s, t, (wide[0], wide[1]), depth)
