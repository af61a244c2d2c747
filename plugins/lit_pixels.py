"""Which pixels the sources light, and what is seen at their centres: the truth of a frame."""

from collections.abc import Mapping
from dataclasses import dataclass, field, replace
from types import MappingProxyType
from typing import Any

import cv2
import numpy as np
from numpy.typing import NDArray
from virtual_sensor_plugins.views import StraightSight, View

from virtual_sensor.arrays import in_own_memory
from virtual_sensor.engine import dr, mi
from virtual_sensor.optics.eikonal import Field, March
from virtual_sensor.optics.family_frames import FamilyFrame
from virtual_sensor.optics.illumination import LightStatus
from virtual_sensor.optics.map_cache import MAPS
from virtual_sensor.optics.ray_families import Pinhole
from virtual_sensor.optics.ray_maps import (
    InverseMap,
    MapRequest,
    NoMapError,
    displaced,
    in_coordinates,
)
from virtual_sensor.optics.sources import Source
from virtual_sensor.optics.surfaces import SceneSurface
from virtual_sensor.optics.transports import (
    Marched,
    Sight,
    Tabulated,
    Tracer,
    Transport,
    opaque,
)
from virtual_sensor.records import Record

Array = NDArray[np.float64]
Pixels = NDArray[np.uint32]
Image = NDArray[np.float32]
Columns = NDArray[np.intp]

_SPARE = 1.5  # times what the probes were moved by
_MOST_LEAN = 0.1  # cosine: of surfaces that lean more, less is known than the probes show
_EDGE_PX = 10.0  # a pixel's size that distances differ by within three pixels at an edge
_PROBES = 64  # rays of a source that show how far light is moved, about
FIRST_MARGIN_MM = 1.5  # refraction is taken to move no light further, until the probes show more
_FAR_MM = 2.0  # likewise where there are no probes
_MOST_TRIALS = 6
_OF_EACH = 0.5  # of the tolerance, of the camera and the source: other parts of a frame err too
_PAD_PX = 2.0  # what the maps hold round the lit pixels
_PAD_MM = 0.2
_WIDE_MM = 5.0  # light that is wider along both coordinates falls on a surface
_NOISE = 0.15  # of a map's tolerance is for the march there
_MOST_HALVINGS = 4
_MOST_NODES = 2_000_000  # of a map: light of a projector may fall on all that is seen
_FARTHEST_MM = np.float32(1e6)
_THREE = np.ones((3, 3), np.uint8)


@dataclass(frozen=True)
class RenderReport(Record):
    """How a frame was made.

    Attributes
    ----------
    transport : str
        How light was carried through the air: "tabulated", or another of `TRANSPORTS`.
    reason : str or None
        Why not as asked.
    map_nodes : dict
        Nodes of the ray maps, three numbers each, by "camera" and the sources' names.
    map_error_px : float
        Their own estimate of their error; NaN without maps.
    march_px : float
        What half the march's step changes at some lit pixels, at most; NaN where none were asked.
    samples : int
        Samples for which the sources' light was searched.
    marched_samples : int
        Those of them that were marched: the maps had no answer.
    folded_pixels : int
        Pixels near the light to whose centre no single ray of a source was found: they are black.
    pupil_points : int
        Points of the lens's pupil that the frame is seen through; 0: a pinhole.
    pupil_gap_px : float
        How far apart neighbouring ones of these show what is lit, along u or v, at most: blur is
        drawn by so many images side by side. NaN of a pinhole.
    """

    transport: str
    reason: str | None = None
    map_nodes: Mapping[str, tuple[int, int, int]] = field(default_factory=dict)
    map_error_px: float = float("nan")
    march_px: float = float("nan")
    samples: int = 0
    marched_samples: int = 0
    folded_pixels: int = 0
    pupil_points: int = 0
    pupil_gap_px: float = float("nan")


@dataclass(frozen=True)
class LitPixels:
    """Pixels that may receive light of sources, and what is seen at their centres.

    Attributes
    ----------
    index : ndarray of shape (N,)
        Row-major numbers within the film's crop window.
    names : tuple of str
        Of the sources whose light is seen, as the tracer has them.
    tracer : Tracer
        That traces the pixels' samples.
    report : RenderReport
    sight : Sight or None
        At the pixels' centres, in their order; None if there are none.
    margins : dict of ndarray of shape (2,)
        By how much the sources' light on the part may be moved by refraction, in the coordinates of
        each whose light is seen.
    sight_px : float
        By how many pixels what a pixel sees may be moved.
    """

    index: Pixels
    names: tuple[str, ...]
    tracer: Tracer
    report: RenderReport
    sight: Sight | None = None
    margins: Mapping[str, Array] = field(default_factory=dict)
    sight_px: float = 0.0

    @property
    def maps(self) -> dict[str, InverseMap]:
        """Of the sources, by name; none if rays are marched."""
        maps = self.tracer.maps if isinstance(self.tracer, Tabulated) else ()
        return dict(zip(self.names, maps, strict=False))

    def with_edges(self, view: View, px: int) -> "LitPixels":
        """With the pixels up to so many beside them, which see past edges from somewhere else."""
        row, column = np.divmod(self.index, np.uint32(view.width))
        ends = _ends((row, column), 1)
        first = np.maximum(ends[0] - px, 0).astype(int)
        last = np.minimum(ends[1] + 1 + px, (view.height, view.width)).astype(int)
        window = slice(first[0], last[0]), slice(first[1], last[1])
        mask, square = _mask(window), np.ones((2 * px + 1, 2 * px + 1), np.uint8)
        mask[_places_in(window, self.index, view.width)] = 1
        row, column = np.nonzero(cv2.dilate(mask, square))
        index = ((row + first[0]) * view.width + column + first[1]).astype(np.uint32)
        sight, _ = self.tracer.sight(view.centres(index))
        return replace(self, index=index, sight=sight, sight_px=self.sight_px + px)


def find_lit_pixels(
    straight: StraightSight,
    medium: Field | None,
    sources: Mapping[str, Source],
    transport: Transport,
    column: Columns | None = None,
    drift_mm: float = 0.0,
    maps: Mapping[str, InverseMap] = MappingProxyType({}),
) -> LitPixels:
    """Find the pixels that sources light; of some columns, if they are given.

    1. Straight rays of all pixels, and a few bent ones, show where to search.
    2. Maps of what is there are made to the tolerance, if the transport is by maps.
    3. The transport finds which pixels are lit; their neighbours count too.

    Camera and sources may drift by up to a distance, for which the sources have room: they are
    `Widened`.  `maps` are of sources, made to the same tolerance: those that hold what is there are
    taken.
    """
    field, march = (None if transport.name == "straight" else medium), transport.march
    by_maps = transport.name in ("tabulated", "straight")
    report, reason = RenderReport(transport.name), None
    try:
        region = _searched(straight, field, march, sources)
    except NoMapError as why:
        region, reason = _guessed(straight, sources), str(why)
    if column is not None:
        region = region.in_columns(column)
    beams = region.beams
    marched = Marched(field, straight.surface, tuple(beam.source for beam in beams.values()), march)
    tracer: Tracer = marched
    if not beams:
        return LitPixels(np.zeros(0, np.uint32), (), tracer, report)
    report = replace(report, march_px=region.march_px)
    if by_maps:
        try:
            if reason:
                raise NoMapError(reason)
            tracer = region.tabulated(marched, transport.tolerance_px, maps)
            report = _with_maps(report, tracer, tuple(beams), region.pixel_mm)
        except NoMapError as why:
            report = replace(report, transport="marched", reason=str(why))
    sight, _ = tracer.sight(straight.view.centres(region.candidates))
    lit, folded = region.lit(sight)
    report = replace(report, folded_pixels=folded)
    if not lit.size:
        return LitPixels(np.zeros(0, np.uint32), (), tracer, report)
    sight = dr.gather(Sight, sight, in_own_memory(lit, mi.UInt32))
    margins = {name: beam.margin for name, beam in beams.items()}
    what = region.candidates[lit], tuple(beams), tracer, report, sight
    found = LitPixels(*what, margins, region.sight_px)
    if not drift_mm:
        return found
    return found.with_edges(straight.view, int(np.ceil(drift_mm / region.pixel_mm)) + 1)


def _with_maps(
    report: RenderReport, tracer: Tabulated, names: tuple[str, ...], pixel_mm: float
) -> RenderReport:
    maps = tracer.camera, *tracer.maps
    nodes = {name: each.nodes for name, each in zip(("camera", *names), maps, strict=True)}
    error_mm = tracer.camera.linear_error_mm + max(each.linear_error_mm for each in tracer.maps)
    return replace(report, map_nodes=nodes, map_error_px=error_mm / pixel_mm)


@dataclass(frozen=True)
class _Beam:
    """What of a source's light may be seen.

    Attributes
    ----------
    source : Source
    per_mm : ndarray of shape (2,)
        Units of its coordinates per mm, at most.
    pixel_mm : float
        A pixel's size in the middle of them.
    index : ndarray of shape (N,)
        Pixels.
    seen, own : ndarray of shape (N, 3)
        Where they see if light runs straight, in the camera's coordinates and in the source's.
    margin : ndarray of shape (2,)
        By how much the source's light on the part may be moved, in its coordinates.
    moved : ndarray of shape (2,)
        Likewise its rays.
    sight_mm, march_mm : float
        By how much what a pixel sees may be moved; and what half the march's step changes.
    """

    source: Source
    per_mm: Array
    pixel_mm: float
    index: Pixels
    seen: Image
    own: Image
    margin: Array
    moved: Array
    sight_mm: float = 0.0
    march_mm: float = float("nan")

    @property
    def wide(self) -> bool:
        """Whether its light falls on a surface, not on a line, however far round it is searched."""
        low, high = self.source.extent
        size = np.minimum(np.ptp(self.own[:, :2], axis=0), high - low)
        return bool(np.all(size > _WIDE_MM * self.per_mm))

    def near(self) -> "_Beam":
        """Those of its pixels that are within the margin; all, if none is."""
        s, t, depth = self.own.T
        near = np.asarray(self.source.reaches(s, t, tuple(self.margin), depth))
        if not near.any():
            return self
        return replace(self, index=self.index[near], seen=self.seen[near], own=self.own[near])


@dataclass(frozen=True)
class _Region:
    """Where light of the sources may be seen.

    Attributes
    ----------
    view : View
    beams : dict of _Beam
        By the sources' names; those that none of is seen are left out.
    candidates : ndarray of shape (N,)
        Pixels.
    window : tuple of two slice
        Rows and columns of the film that hold these.
    beyond_px : float
        By how many pixels they reach beyond the beams'.
    pixel_mm : float
        A pixel's size in the middle of them.
    """

    view: View
    beams: dict[str, _Beam]
    candidates: Pixels
    window: tuple[slice, slice]
    beyond_px: float
    pixel_mm: float

    def in_columns(self, column: Columns) -> "_Region":
        """The same with the candidates of some columns only; none if there is none."""
        keep = self.candidates[np.isin(self.candidates % self.view.width, column)]
        return replace(self, candidates=keep, beams=self.beams if keep.size else {})

    @property
    def march_px(self) -> float:
        """What half the march's step changes, at most."""
        return max(beam.march_mm for beam in self.beams.values()) / self.pixel_mm

    @property
    def sight_px(self) -> float:
        """By how many pixels what a pixel sees may be moved."""
        return max(beam.sight_mm for beam in self.beams.values()) / self.pixel_mm

    def tabulated(
        self, marched: Marched, tolerance_px: float, given: Mapping[str, InverseMap]
    ) -> Tabulated:
        """Maps of the camera's and the sources' rays, made to a tolerance.

        Raises
        ------
        NoMapError
            If there is none that can be trusted.
        """
        camera, medium = self.view.camera, marched.medium
        assert camera is not None
        error_mm = _OF_EACH * tolerance_px * self.pixel_mm
        march = self._finer(marched.march, error_mm)
        places = np.concatenate([_ends(beam.seen) for beam in self.beams.values()])
        pad = np.append(np.full(2, (self.beyond_px + _PAD_PX) * self.view.pitch), _PAD_MM)
        seen = places.min(axis=0) - pad, places.max(axis=0) + pad
        maps, pads = [], []
        for name, beam in self.beams.items():
            family, spare = beam.source.family, _PAD_MM * beam.per_mm
            low, high = beam.source.extent
            # A line may be much longer than what of it is seen.
            around = np.append(beam.margin + spare, _PAD_MM)
            first, last = _ends(beam.own) + np.array([-around, around])
            first[:2] = np.maximum(first[:2], low - beam.moved - spare)
            last[:2] = np.minimum(last[:2], high + beam.moved + spare)
            if name in given and given[name].table.grid.holds(np.stack([first, last])).all():
                maps.append(given[name])
            else:
                asked = MapRequest(medium, family, first, last, march, error_mm, _MOST_NODES)
                maps.append(MAPS.inverse(asked))
            pads.append(spare)
        asked = MapRequest(medium, camera, *seen, march, error_mm, _MOST_NODES)
        sight = MAPS.forward(asked)
        return Tabulated(sight, tuple(maps), tuple(pads), marched)

    def _finer(self, march: March, error_mm: float) -> March:
        """The march for maps: where light is wide, its own error must be small beside theirs.

        That error depends on where a ray's steps end, and so differs from ray to ray.
        """
        noise_mm = max((beam.march_mm for beam in self.beams.values() if beam.wide), default=0.0)
        times = max(noise_mm / (_NOISE * error_mm), 1.0)
        halvings = min(int(np.ceil(np.log2(times) / 2.0)), _MOST_HALVINGS)  # of order 2
        return replace(march, step_mm=march.step_mm / 2**halvings) if halvings else march

    def lit(self, sight: Sight) -> tuple[NDArray[np.intp], int]:
        """Which candidates are lit, or beside such; and how many have light that is folded."""
        lit, folded = mi.Mask(False), mi.Mask(False)
        for beam, light in zip(self.beams.values(), sight.lights, strict=True):
            margin = opaque(self.pixel_mm * beam.per_mm)
            lit |= beam.source.reaches(light.s, light.t, margin, light.depth)
            folded |= light.status == int(LightStatus.FOLDED)
        dr.eval(lit, folded)
        row, column = _places_in(self.window, self.candidates, self.view.width)
        mask = _mask(self.window)
        mask[row, column] = np.array(lit)
        beside = cv2.dilate(mask, _THREE)[row, column]
        return np.flatnonzero(beside), int(np.sum(np.array(folded)))


def _searched(
    straight: StraightSight,
    field: Field | None,
    march: March,
    sources: Mapping[str, Source],
) -> _Region:
    """Where light may be seen, by a few bent rays.

    Raises
    ------
    NoMapError
        If they can't.
    """
    camera, surface = straight.view.camera, straight.surface
    if camera is None:
        raise NoMapError("the camera is no pinhole")
    per_mm = {name: units_per_mm(source, surface) for name, source in sources.items()}
    margins = {name: FIRST_MARGIN_MM * per_mm[name] for name in sources}
    for _ in range(_MOST_TRIALS):
        beams = _beams(straight, sources, per_mm, margins)
        found = {n: _probed(beam, camera, surface, field, march) for n, beam in beams.items()}
        if all(np.all(beam.margin <= margins[name]) for name, beam in found.items()):
            return _region(straight, {name: beam.near() for name, beam in found.items()})
        margins |= {name: 2.0 * beam.margin for name, beam in found.items()}
    raise NoMapError("refraction moves light too far for what is lit to be found beforehand")


def _guessed(straight: StraightSight, sources: Mapping[str, Source]) -> _Region:
    """Where light may be seen if refraction moves none of it far."""
    per_mm = {name: units_per_mm(source, straight.surface) for name, source in sources.items()}
    margins = {name: _FAR_MM * per_mm[name] for name in sources}
    return _region(straight, _beams(straight, sources, per_mm, margins))


def units_per_mm(source: Source, surface: SceneSurface) -> Array:
    """Units of a source's coordinates per mm among the shapes, at most."""
    low, high = (np.array(corner, float) for corner in surface.corners)
    corners = np.array([np.where(pick, high, low) for pick in np.ndindex(2, 2, 2)])
    s, t, depth = source.family.coordinates(corners).T
    x_s, x_t, y_s, y_t = source.family.by_coordinates(s, t, depth)
    return np.array([1.0 / np.min(np.hypot(x_s, y_s)), 1.0 / np.min(np.hypot(x_t, y_t))])


def _beams(
    straight: StraightSight,
    sources: Mapping[str, Source],
    per_mm: Mapping[str, Array],
    margins: Mapping[str, Array],
) -> dict[str, _Beam]:
    """What straight rays of pixels meet near the sources' straight light."""
    view, distance = straight.view, straight.distance
    point = mi.Array3f(view.centres()(distance))
    near = {}
    for name, source in sources.items():
        s, t, depth = FamilyFrame.of(source.family, mi.Array3f).coordinates(point)
        lit = source.reaches(s, t, opaque(margins[name]), depth)
        near[name] = dr.isfinite(distance) & lit
    dr.eval(*near.values())
    distances, beams = distance.numpy(), {}
    for name, mask in near.items():
        index = np.array(dr.compress(mask), np.uint32)
        if index.size:
            pixel_mm = view.pitch * float(np.mean(distances[index]))
            places = _places(view, index, distances[index], sources[name])
            what = sources[name], per_mm[name], pixel_mm, index, *places
            beams[name] = _Beam(*what, margins[name], margins[name])
    return beams


def _places(
    view: View, index: Pixels, distance: NDArray[np.float32], source: Source
) -> tuple[Image, Image]:
    """Where straight rays of pixels are at distances from the camera: its coordinates and others.

    A camera that is no pinhole has none.
    """
    ray = view.centres(index)
    point = mi.Array3f(ray(in_own_memory(distance, mi.Float)))
    frames = [FamilyFrame.of(f, mi.Array3f) for f in (view.camera, source.family) if f]
    places = [mi.Array3f(frame.coordinates(point)) for frame in frames]
    dr.eval(places)
    seen, own = (np.array(each, np.float32).T for each in (places[0], places[-1]))
    return seen, own


def _probed(
    beam: _Beam, camera: Pinhole, surface: SceneSurface, field: Field | None, march: March
) -> _Beam:
    """How far a few bent rays are moved."""
    family, spare = beam.source.family, 2.0 * beam.pixel_mm * beam.per_mm
    if field is None:
        return replace(beam, margin=spare, moved=np.zeros(2), sight_mm=0.0, march_mm=0.0)
    some = np.linspace(0, len(beam.index) - 1, _PROBES).astype(int)
    seen_at, lit_at = (places[some].astype(float) for places in (beam.seen, beam.own))

    def moved_by(steps: March) -> list[Array]:
        """By how much rays of the camera and of the source are moved, mm."""
        rays = (camera, seen_at), (family, lit_at)
        return [displaced(field, each, steps, places)[:, :2] for each, places in rays]

    sideways, moved = moved_by(march)
    finer = moved_by(replace(march, step_mm=march.step_mm / 2.0))
    apart = (np.abs(one - two).max() for one, two in zip((sideways, moved), finer, strict=True))
    # On the surface's tangent plane, the point seen moves along the ray too.
    centre, heading = camera.rays(*seen_at[:, :2].T)
    distance = seen_at[:, 2:] / (heading @ camera.pose.rotation[:, 2:])
    normal = surface.normals(centre + distance * heading, heading)
    lean = np.einsum("ij,ij->i", normal, heading)
    lean = np.sign(lean) * np.maximum(np.abs(lean), _MOST_LEAN) + (lean == 0.0)
    seen = sideways @ camera.pose.rotation[:, :2].T
    seen = seen - heading * (np.einsum("ij,ij->i", normal, seen) / lean)[:, None]
    local = seen @ family.pose.rotation
    slope = np.stack(np.broadcast_arrays(*family.slope(*lit_at[:, :2].T)), axis=1)
    seen = in_coordinates(family, lit_at, local[:, :2] - slope * local[:, 2:])
    rays = _SPARE * np.abs(in_coordinates(family, lit_at, moved)).max(axis=0) + spare
    return replace(
        beam,
        margin=rays + _SPARE * np.abs(seen).max(axis=0),
        moved=rays,
        sight_mm=_SPARE * float(np.abs(sideways).max()),
        march_mm=float(sum(apart)),
    )


def _region(straight: StraightSight, beams: dict[str, _Beam]) -> _Region:
    """The beams' pixels, those beside them, and more where there are edges.

    Bent rays see past edges of the part.
    """
    view = straight.view
    if not beams:
        nothing = slice(0, 0)
        none = np.zeros(0, np.uint32), (nothing, nothing)
        return _Region(view, beams, *none, 0.0, float("nan"))
    pixel_mm = float(np.mean([beam.pixel_mm for beam in beams.values()]))
    sight_px = int(np.ceil(max(beam.sight_mm for beam in beams.values()) / pixel_mm))
    ends = np.concatenate([_ends(np.divmod(b.index, view.width), 1) for b in beams.values()])
    inner = np.array([ends.min(axis=0), ends.max(axis=0) + 1], int)
    border = 2 * sight_px + 2
    first = np.maximum(inner[0] - border, 0)
    last = np.minimum(inner[1] + border, (view.height, view.width))
    window = slice(first[0], last[0]), slice(first[1], last[1])
    mask = _mask(window)
    for beam in beams.values():
        mask[_places_in(window, beam.index, view.width)] = 1
    square = np.ones((border - 1, border - 1), np.uint8)
    distance = straight.distance.numpy().reshape(view.height, view.width)[window]
    depth = np.minimum(distance, _FARTHEST_MM)
    edge = cv2.dilate(depth, _THREE) - cv2.erode(depth, _THREE) > _EDGE_PX * pixel_mm
    beside = cv2.dilate(mask, square) & cv2.dilate(edge.astype(np.uint8), square)
    row, column = np.nonzero(cv2.dilate(mask, _THREE) | beside)
    outer = first + np.array([[row.min(), column.min()], [row.max() + 1, column.max() + 1]])
    beyond = float(np.max([inner[0] - outer[0], outer[1] - inner[1]]))
    candidates = ((row + first[0]) * view.width + column + first[1]).astype(np.uint32)
    return _Region(view, beams, candidates, window, beyond, pixel_mm)


def _mask(window: tuple[slice, slice]) -> NDArray[np.uint8]:
    """An empty mask of a window."""
    return np.zeros([side.stop - side.start for side in window], np.uint8)


def _places_in(
    window: tuple[slice, slice], index: Pixels, width: int
) -> tuple[NDArray[np.uint32], NDArray[np.uint32]]:
    """Rows and columns in a window of a film's pixels."""
    row, column = np.divmod(index, np.uint32(width))
    return row - np.uint32(window[0].start), column - np.uint32(window[1].start)


def _ends(places: Any, axis: int = 0) -> Array:
    """Lowest and highest of each coordinate, (2, C)."""
    places = np.asarray(places)
    return np.array([places.min(axis=axis), places.max(axis=axis)], float)
