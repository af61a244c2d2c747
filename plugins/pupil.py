"""The points of a lens's pupil that a frame is rendered through, and what is lit for each."""

import random
from collections.abc import Mapping
from dataclasses import dataclass, replace
from functools import cached_property, lru_cache
from typing import Any

import numpy as np
from numpy.typing import NDArray
from virtual_sensor_plugins.lit_pixels import (
    FIRST_MARGIN_MM,
    Columns,
    LitPixels,
    RenderReport,
    find_lit_pixels,
    units_per_mm,
)
from virtual_sensor_plugins.views import StraightSight, View

from virtual_sensor.arrays import in_own_memory, to_numpy
from virtual_sensor.engine import dr, mi
from virtual_sensor.optics.eikonal import Field
from virtual_sensor.optics.family_frames import FamilyFrame
from virtual_sensor.optics.lens import PupilPoint
from virtual_sensor.optics.sources import Source
from virtual_sensor.optics.surfaces import SceneSurface
from virtual_sensor.optics.transports import Tabulated, Transport, opaque

Array = NDArray[np.float64]

_STRIDE = 4  # px: so far apart are the rays that show where a point of the pupil sees light
_BESIDE_PX = 8.0  # of a window, beyond what refraction moves
_SPARE = 1.25  # times what refraction moves light by, seen from the middle of the pupil
_MOST_SIGHTS = 1 << 22  # of pixels' centres that are held for marches, of all points
_PROBES = 256  # points that the chief rays see lit
_ORDERS = 12  # of places within pixels
_SWAPS, _MOST_SWAPS = 10, 1000  # of each order, for each of them
_SAME = 1e-9


@dataclass(frozen=True)
class SubPupil:
    """One point of the pupil.

    Attributes
    ----------
    view : View
        Its rays through the film.
    surface : SceneSurface
    lit : LitPixels
        Those that are lit as seen from it, by their numbers on the film.
    shift : tuple of two float
        By how much its samples are moved within pixels, in units of their distance there.
    """

    view: View
    surface: SceneSurface
    lit: LitPixels
    shift: tuple[float, float]

    @property
    def straight(self) -> StraightSight:
        """What it would see of all pixels if light ran straight."""
        return StraightSight(self.view, self.surface)


@dataclass(frozen=True)
class Pupil:
    """The points of a lens's pupil that a frame is rendered through.

    Attributes
    ----------
    points : tuple of SubPupil
    gap_px : float
        How far apart neighbouring points show what is lit, along u or v, at most.
    """

    points: tuple[SubPupil, ...]
    gap_px: float = 0.0

    @staticmethod
    def of(
        straight: StraightSight,
        points: tuple[PupilPoint, ...],
        chief: LitPixels,
        medium: Field | None,
        sources: Mapping[str, Source],
        transport: Transport,
        column: Columns | None = None,
        drift_mm: float = 0.0,
    ) -> "Pupil":
        """Find the pixels that are lit as seen from each point.

        Each has a map of its own of the bent lines of sight; maps of the sources' light are those
        of the chief rays.

        Parameters
        ----------
        straight : StraightSight
            Of the chief rays.
        points : tuple of PupilPoint
        chief : LitPixels
            As the chief rays see them.
        medium, sources, transport, column, drift_mm
            As of `find_lit_pixels`.
        """
        surface, found, held = straight.surface, [], 0
        shifts = shifts_within(tuple(point.at_mm for point in points))
        for point, shift in zip(points, shifts, strict=True):
            view = View(straight.view.sensor, point)
            window = _window(view, surface, sources, chief)
            if window is None:
                lit = replace(chief, index=chief.index[:0], sight=None, names=())
            else:
                within = View(view.sensor, point, window)
                some = None if column is None else np.asarray(column) - window[1].start
                near = StraightSight(within, surface)
                given = medium, sources, transport, some, drift_mm, chief.maps
                lit = find_lit_pixels(near, *given)
                row, across = np.divmod(lit.index, np.uint32(within.width))
                index = (row + window[0].start) * view.width + across + window[1].start
                lit = replace(lit, index=index.astype(np.uint32))
            held += lit.index.size
            if isinstance(lit.tracer, Tabulated) or held > _MOST_SIGHTS:
                lit = replace(lit, sight=None)  # only marches start from it
            found.append(SubPupil(view, surface, lit, shift))
        return Pupil(tuple(found), _gap_px(points, _probes(chief)))

    @cached_property
    def lit(self) -> NDArray[np.uint32]:
        """Pixels that are lit as seen from any point."""
        return np.unique(np.concatenate([each.lit.index for each in self.points]))

    def report(self, chief: RenderReport) -> RenderReport:
        """How frames are made, beside the report on the chief rays: the worst of all."""
        reports = [each.lit.report for each in self.points]
        marched = [each for each in reports if each.transport != chief.transport]
        reason = chief.reason
        if marched and not reason:
            count = f"{len(marched)} of {len(reports)} points of the pupil"
            reason = f"as seen from {count} pixels were marched: {marched[0].reason}"
        return replace(
            chief,
            reason=reason,
            pupil_points=len(self.points),
            pupil_gap_px=self.gap_px,
            map_error_px=_largest(each.map_error_px for each in (chief, *reports)),
            march_px=_largest(each.march_px for each in (chief, *reports)),
            folded_pixels=max(each.folded_pixels for each in (chief, *reports)),
        )


def _probes(chief: LitPixels) -> Array:
    """Some of the points (N, 3) that the chief rays see lit."""
    if chief.sight is None:
        return np.zeros((0, 3))
    some = np.linspace(0, chief.index.size - 1, _PROBES).astype(np.uint32)
    which = in_own_memory(some, mi.UInt32)
    points = to_numpy(dr.gather(type(chief.sight.point), chief.sight.point, which))
    return points[np.array(dr.gather(mi.Bool, chief.sight.hit, which))]


def _gap_px(points: tuple[PupilPoint, ...], lit: Array) -> float:
    """How far apart points of the pupil, side by side, show lit points (N, 3), at most."""
    seen = np.stack([point.project(lit) for point in points])
    seen = seen[:, np.isfinite(seen).all(axis=(0, 2))]
    return float(np.diff(np.sort(seen, axis=0), axis=0).max(initial=0.0))


def _largest(numbers: Any) -> float:
    """NaN only if all are."""
    known = [number for number in numbers if number == number]
    return max(known, default=float("nan"))


def _window(
    view: View, surface: SceneSurface, sources: Mapping[str, Source], chief: LitPixels
) -> tuple[slice, slice] | None:
    """Rows and columns of the film in which a point of the pupil may see the sources' light.

    By straight rays through some pixels; None if there is no light.
    """
    across, down = -(-view.width // _STRIDE), -(-view.height // _STRIDE)
    index = dr.arange(mi.UInt32, across * down)
    wide = dr.opaque(mi.UInt32, across)
    corner = mi.Point2f(mi.Float(index % wide), mi.Float(index // wide)) + 0.5
    offset = dr.opaque(mi.Point2f(*map(float, view.offset)))
    ray, _ = view.rays(corner * float(_STRIDE) + offset, mi.Point2f(0.5))
    distance = surface.distance(mi.Array3f(ray.o), mi.Array3f(ray.d), ray.maxt, True)
    point = mi.Array3f(ray(distance))
    aside_mm = _STRIDE * view.pitch * distance  # of light between these rays, square to them
    near = mi.Mask(False)
    for name, source in sources.items():
        per_mm = units_per_mm(source, surface)
        margin = chief.margins.get(name, FIRST_MARGIN_MM * per_mm) * _SPARE
        s, t, _ = FamilyFrame.of(source.family, mi.Array3f).coordinates(point)
        by_s, by_t = opaque(2.0 * per_mm)
        first, second = opaque(margin)
        reached = source.reaches(s, t, (first + by_s * aside_mm, second + by_t * aside_mm))
        near |= dr.isfinite(distance) & reached
    row, column = np.divmod(np.array(dr.compress(near), np.int64), across)
    seen = np.stack([column, row], axis=1) * _STRIDE + _STRIDE / 2.0
    if len(points := _probes(chief)):  # of parts that are thinner than a stride, the same points
        assert view.camera is not None
        projected = view.camera.project(points) - view.offset
        seen = np.concatenate([seen, projected[np.isfinite(projected).all(axis=1)]])
    if not len(seen):
        return None
    pad = np.ceil(2.0 * chief.sight_px + _BESIDE_PX) + _STRIDE
    size = view.width, view.height
    left, top = np.clip(seen.min(axis=0) - pad, 0, size).astype(int)
    right, bottom = np.clip(seen.max(axis=0) + pad, 0, size).astype(int)
    empty = bottom <= top or right <= left
    return None if empty else (slice(top, bottom), slice(left, right))


def _lattice(count: int, steps: int) -> Array:
    """Places (count, 2) from -1/2 to 1/2, opposite of which are others of them; steps are odd."""
    number = np.arange(count)
    across = (steps * number + (steps - 1) // 2) % count
    return (np.stack([number, across], axis=1) + 0.5) / count - 0.5


@lru_cache
def shifts_within(at_mm: tuple[tuple[float, float], ...]) -> tuple[tuple[float, float], ...]:
    """Where points of a pupil take their samples within pixels, from -1/2 to 1/2.

    On a lattice, each row and column of which has one.  What goes with the place in the pupil would
    change the width of the blur: points opposite to each other have opposite shifts, and of some
    orders that one is taken in which the shifts go least with place and cube.
    """
    count, at = len(at_mm), np.array(at_mm)
    number = np.arange(count)
    lattices = [_lattice(count, steps) for steps in range(1, 2 * count, 2)]
    coprime = [each for each in lattices if len(np.unique(each[:, 1])) == count]
    lattice = min(coprime, key=lambda each: round(abs(float(each[:, 0] @ each[:, 1])), 9))
    opposite = np.abs(at[:, None] + at).sum(axis=2).argmin(axis=1)
    paired = count % 2 == 0 and np.abs(at + at[opposite]).max() < _SAME * np.abs(at).max()
    free = np.flatnonzero(number < opposite) if paired else number
    x, y = at.T / np.abs(at).max()
    goes_with = np.stack([4.0 * x, 4.0 * y, x**3, x**2 * y, x * y**2, y**3])

    def together(shifts: Array) -> float:
        return float(np.sum((goes_with @ shifts) ** 2))

    drawn, best, least = random.Random(0), lattice, np.inf
    for _ in range(_ORDERS):
        order = list(range(len(free)))
        drawn.shuffle(order)
        here = lattice.copy()
        here[free] = lattice[order]
        if paired:
            here[opposite[free]] = -here[free]
        low = together(here)
        for _ in range(min(_SWAPS * count, _MOST_SWAPS) if len(free) > 1 else 0):
            two, swapped = drawn.sample(free.tolist(), 2), here.copy()
            swapped[two] = swapped[two[::-1]]
            if paired:
                swapped[two[0]] *= drawn.choice((-1.0, 1.0))
                swapped[opposite[two]] = -swapped[two]
            if (less := together(swapped)) <= low:
                here, low = swapped, less
        if low < least:
            best, least = here, low
    return tuple((float(u), float(v)) for u, v in best)
