"""The tabulated way: maps of the two bent light paths, made where a scene's light goes."""

from dataclasses import dataclass, fields, is_dataclass, replace
from typing import Any

import cv2
import numpy as np
from numpy.typing import NDArray
from virtual_sensor_plugins.laser_line import SourceEmitter
from virtual_sensor_plugins.lit_pixels import (
    Account,
    LitPixels,
    Sight,
    centre_rays,
    grown,
    pinhole,
    reached,
    rows,
)

from virtual_sensor.arrays import in_own_memory, to_numpy
from virtual_sensor.engine import dr, mi
from virtual_sensor.optics.eikonal import Field, March
from virtual_sensor.optics.family_frames import FamilyFrame
from virtual_sensor.optics.map_cache import MAPS
from virtual_sensor.optics.ray_families import Pinhole, RayFamily
from virtual_sensor.optics.ray_maps import (
    ForwardMap,
    InverseMap,
    NoMapError,
    displaced,
    in_coordinates,
)
from virtual_sensor.optics.surfaces import SceneSurface
from virtual_sensor.optics.tabulated_light import hits, light

Array = NDArray[np.float64]

_SPARE = 1.5  # times what the probes were moved by
_MOST_LEAN = 0.1  # cosine: of surfaces that lean more, less is known than the probes tell
_EDGE_PX = 10.0  # a pixel's size that distances differ by within three pixels at an edge
_PROBES = 64  # rays that tell about how far light is moved
_FIRST_MARGIN_MM = 1.5  # refraction is taken to move no light further, until the probes tell
_MOST_TRIALS = 6
_OF_EACH = 0.5  # of the tolerance, of the camera and the laser: other parts of a frame err too
_PAD_PX = 2.0  # what the maps hold round the lit pixels
_PAD_MM = 0.2
_NEAR_MM = 1.0  # from a surface: Mitsuba's float32 hits from so near are good to 0.03 um
_ASIDE_MM = 1e-3
_ELSEWHERE_PX = 0.1  # tolerance of the map for light that is not the laser's


@dataclass(frozen=True)
class Tables:
    """Maps of a scene's camera and laser.

    Attributes
    ----------
    camera : ForwardMap
    laser : InverseMap
    emitter : SourceEmitter
    surface : SceneSurface
    march : March
    """

    camera: ForwardMap
    laser: InverseMap
    emitter: SourceEmitter
    surface: SceneSurface
    march: March

    def look(self, ray: Any) -> tuple[Sight, Any]:
        """What camera rays see, and the mask of those of which the maps can't tell.

        Everything is evaluated, so that one kernel serves pixels and samples of any number.
        """
        dr.eval(ray)
        seen = hits(self.camera, self.surface, ray, self.march)
        lit, off = light(self.laser, self.surface, seen.point, seen.hit)
        near = self.emitter.source.reaches(lit.s, lit.t, (_PAD_MM, _PAD_MM))
        doubtful = seen.lost | (seen.hit & near & (seen.off | off))
        sight = Sight(seen.point, seen.heading, seen.hit, lit)
        dr.eval(sight, doubtful)
        return sight, doubtful


def lit_pixels_and_tables(
    scene: mi.Scene,
    sensor: mi.Sensor,
    emitter: SourceEmitter,
    field: Field | None,
    march: March,
    tolerance_px: float,
    account: Account,
) -> LitPixels | None:
    """Find the pixels that the laser reaches, and make the maps that tell of their samples.

    None if there are no such pixels.  `account` is told of the tables.

    1. Straight rays of all pixels, and a few bent ones, tell where to look.
    2. Maps of what is there are made to the tolerance.
    3. They tell which pixels are lit; their neighbours count too.

    Raises
    ------
    NoMapError
        If there is no map that can be trusted.
    """
    view, sheet = _view(sensor), emitter.source.family
    width, height = (int(n) for n in sensor.film().crop_size())
    margin = np.full(2, _FIRST_MARGIN_MM)
    for _ in range(_MOST_TRIALS):
        index, distance = _straight_candidates(scene, sensor, emitter, margin)
        if not index.size:
            return None
        places = _places(sensor, index, distance[index], view, sheet)
        moves = _probe(scene, field, view, sheet, march, places)
        account.march_px = moves.march_px
        if np.all(moves.light_mm <= margin):
            break
        margin = 2.0 * moves.light_mm
    else:
        raise NoMapError("refraction moves light too far for what is lit to be found beforehand")
    near = _near(emitter, places, moves.light_mm)
    size = 2 * int(np.ceil(moves.sight_px)) + 1
    candidates = _candidates(index[near], distance.reshape(height, width), size, places.pixel_mm)
    places = places.of(near)

    error_mm = _OF_EACH * tolerance_px * places.pixel_mm
    pad_p = places.pitch * (_beyond(candidates, index[near], width) + _PAD_PX)
    pad = np.array([pad_p, pad_p, _PAD_MM])
    seen = places.camera.min(axis=0) - pad, places.camera.max(axis=0) + pad
    depth = places.laser[:, 2]
    pad_ab, seen_ab = moves.laser_mm + _PAD_MM, places.laser[:, :2]
    first, last = emitter.source.extent
    low, high = first - pad_ab, last + pad_ab
    # A line may be much longer than what of it is seen.
    low = np.maximum(low, seen_ab.min(axis=0) - moves.light_mm - _PAD_MM)
    high = np.minimum(high, seen_ab.max(axis=0) + moves.light_mm + _PAD_MM)
    lit = np.append(low, depth.min() - _PAD_MM), np.append(high, depth.max() + _PAD_MM)
    camera = MAPS.forward(field, view, *seen, march, error_mm)
    laser = MAPS.inverse(field, sheet, *lit, march, error_mm)
    tables = Tables(camera, laser, emitter, SceneSurface(scene), march)
    sight, _ = tables.look(centre_rays(sensor, candidates))
    account.camera, account.laser = camera.fineness, laser.fineness
    account.error_px = (account.camera.error_mm + account.laser.error_mm) / places.pixel_mm
    pixel_mm = dr.opaque(mi.Float, places.pixel_mm)
    is_lit = emitter.source.reaches(sight.light.s, sight.light.t, (pixel_mm, pixel_mm))
    mask = np.zeros(height * width, bool)
    mask[candidates[np.array(is_lit)]] = True
    keep = np.flatnonzero(grown(mask, height, width)[candidates]).astype(np.uint32)
    if not keep.size:
        return None
    return LitPixels(candidates[keep], rows(sight, keep), account, tables)


@dataclass(frozen=True)
class _Places:
    """Where pixels look: (p, q, Z) of the camera's map and (a0, b0, depth) of the laser's, (N, 3).

    `ray` are their straight rays, `pitch` is the distance of pixels in p and q.
    """

    camera: Array
    laser: Array
    ray: Any
    pitch: float

    @property
    def pixel_mm(self) -> float:
        """A pixel's size in the middle of the places."""
        return self.pitch * float(np.mean(self.camera[:, 2]))

    def of(self, which: NDArray[np.bool_]) -> "_Places":
        """Some of them."""
        return replace(self, camera=self.camera[which], laser=self.laser[which])


@dataclass(frozen=True)
class _Moves:
    """How far refraction moves things at most, with something to spare.

    `laser_mm` along a and b: the laser's rays; `light_mm`, likewise, (a0, b0) of what a pixel sees
    and of what lights it; `sight_px`: what a pixel sees.
    """

    laser_mm: Array
    light_mm: Array
    sight_px: float
    march_px: float


def _view(sensor: mi.Sensor) -> RayFamily:
    """The camera's lines of sight: (p, q) name them, and no lens or film bends them."""
    pose = pinhole(sensor)
    if pose is None:
        raise NoMapError("the camera is no pinhole")
    return Pinhole(np.eye(3), pose, (1, 1))


def _straight_candidates(
    scene: mi.Scene, sensor: mi.Sensor, emitter: SourceEmitter, margin_mm: Array
) -> tuple[NDArray[np.uint32], NDArray[np.float32]]:
    """Pixels whose straight ray meets what the straight laser lights, or nearly; all distances."""
    ray = centre_rays(sensor)
    met = scene.ray_intersect_preliminary(ray)
    frame = FamilyFrame.of(emitter.source.family, mi.Array3f)
    a, b, _ = frame.coordinates(mi.Array3f(ray(met.t)))
    margin = tuple(dr.opaque(mi.Float, float(m)) for m in margin_mm)
    near = met.is_valid() & emitter.source.reaches(a, b, margin)
    distance = dr.select(met.is_valid(), met.t, dr.inf)
    dr.eval(near, distance)
    return np.array(dr.compress(near)), distance.numpy()


def _places(
    sensor: mi.Sensor,
    index: NDArray[np.uint32],
    distance: NDArray[np.float32],
    view: RayFamily,
    sheet: RayFamily,
) -> _Places:
    """Where pixels look if light runs straight."""
    ray = centre_rays(sensor, index)
    camera, laser = (FamilyFrame.of(family, mi.Array3f) for family in (view, sheet))
    pitch = dr.max(dr.norm(ray.d_x - ray.d) / dr.dot(mi.Array3f(ray.d), camera.z))
    point = mi.Array3f(ray(in_own_memory(distance, mi.Float)))
    numbers = [*camera.coordinates(point), *laser.coordinates(point)]
    dr.eval(numbers, ray)
    table = np.stack([n.numpy() for n in numbers], axis=1).astype(float)
    return _Places(table[:, :3], table[:, 3:], ray, float(pitch[0]))


def _probe(
    scene: mi.Scene,
    field: Field | None,
    view: RayFamily,
    sheet: RayFamily,
    march: March,
    places: _Places,
) -> _Moves:
    """How far a few bent rays are moved."""
    spare_mm = 2.0 * places.pixel_mm
    if field is None:
        return _Moves(np.zeros(2), np.full(2, spare_mm), 0.0, 0.0)
    some = np.linspace(0, len(places.camera) - 1, _PROBES).astype(int)
    seen_at, lit_at = places.camera[some], places.laser[some]
    (sideways, laser), finer = (
        (
            displaced(field, view, steps, seen_at)[:, :2],
            displaced(field, sheet, steps, lit_at)[:, :2],
        )
        for steps in (march, replace(march, step_mm=march.step_mm / 2.0))
    )
    apart = (np.abs(one - two).max() for one, two in zip((sideways, laser), finer, strict=True))
    march_px = float(sum(apart)) / places.pixel_mm
    seen = sideways @ view.pose.rotation[:, :2].T
    # On the surface's tangent plane, the point seen moves along the ray too.
    ray = rows(places.ray, some)
    normal = to_numpy(scene.ray_intersect(ray).n)
    heading = to_numpy(ray.d)
    lean = np.einsum("ij,ij->i", normal, heading)
    lean = np.sign(lean) * np.maximum(np.abs(lean), _MOST_LEAN) + (lean == 0.0)
    seen = seen - heading * (np.einsum("ij,ij->i", normal, seen) / lean)[:, None]
    seen_mm = np.abs(seen @ sheet.pose.rotation[:, :2]).max(axis=0)
    laser_mm = _SPARE * np.abs(in_coordinates(sheet, lit_at, laser)).max(axis=0) + spare_mm
    sight_px = float(np.abs(sideways).max()) / places.pixel_mm
    return _Moves(laser_mm, laser_mm + _SPARE * seen_mm, _SPARE * sight_px, march_px)


def _near(emitter: SourceEmitter, places: _Places, margin_mm: Array) -> NDArray[np.bool_]:
    near = reached(emitter, places.laser[:, 0], places.laser[:, 1], margin_mm.tolist())
    return near if near.any() else ~near


def _candidates(
    index: NDArray[np.uint32], distance: NDArray[np.float32], size: int, pixel_mm: float
) -> NDArray[np.uint32]:
    """Pixels that may be lit: the given ones, those beside them, and more where there are edges.

    Bent rays see past edges of the part by as many pixels as half the odd `size` of a square.
    """
    mask = np.zeros(distance.shape, np.uint8)
    mask.ravel()[index] = 1
    three, square = np.ones((3, 3), np.uint8), np.ones((size, size), np.uint8)
    left, top, width, height = cv2.boundingRect(mask)
    border = size + 1
    part = (
        slice(max(top - border, 0), top + height + border),
        slice(max(left - border, 0), left + width + border),
    )
    depth = np.minimum(distance[part], np.float32(1e6))
    edge = cv2.dilate(depth, three) - cv2.erode(depth, three) > _EDGE_PX * pixel_mm
    round_it = cv2.dilate(mask[part], square) & cv2.dilate(edge.astype(np.uint8), square)
    mask[part] = cv2.dilate(mask[part], three) | round_it
    return np.flatnonzero(mask).astype(np.uint32)


def _beyond(some: NDArray[np.uint32], inner: NDArray[np.uint32], width: int) -> float:
    """By how many pixels some pixels reach beyond the box of others, at most."""
    corners = [
        np.array([f(index % width), f(index // width)], float)
        for f in (np.min, np.max)
        for index in (some, inner)
    ]
    return float(np.max([corners[1] - corners[0], corners[2] - corners[3]]))


def merged(sight: Any, which: Any, exact: Any) -> Any:
    """Dr.Jit arrays nested in dataclasses and tuples, with some rows replaced."""
    if isinstance(sight, tuple):
        return tuple(merged(s, which, e) for s, e in zip(sight, exact, strict=True))
    if is_dataclass(sight) and not isinstance(sight, type):
        names = [f.name for f in fields(sight)]
        new = {n: merged(getattr(sight, n), which, getattr(exact, n)) for n in names}
        return replace(sight, **new)
    if sight is None:
        return None
    copy = type(sight)(sight)
    dr.scatter(copy, type(sight)(exact), which)
    return copy


class Elsewhere:
    """The camera's bent rays of a whole film, for the light that is not the laser's.

    Each pixel has one displacement, that of its centre: within a pixel it changes by less than a
    tenth of one.
    """

    def __init__(
        self, scene: mi.Scene, sensor: mi.Sensor, field: Field | None, march: March
    ) -> None:
        view = _view(sensor)
        self._scene = scene
        ray = centre_rays(sensor)
        met = scene.ray_intersect_preliminary(ray)
        frame = FamilyFrame.of(view, mi.Array3f)
        axes = [frame.x, frame.y, frame.z]
        x, y, z = (dr.dot(mi.Array3f(ray.d), axis) for axis in axes)
        before = frame.local(mi.Array3f(ray.o))[2]
        depth = before + z * met.t
        p, q = x / z, y / z
        valid = met.is_valid()
        dr.eval(p, q, depth, valid)
        if not dr.any(valid):
            raise NoMapError("the camera sees nothing")
        low = [dr.min(p), dr.min(q), dr.min(dr.select(valid, depth, dr.inf))]
        high = [dr.max(p), dr.max(q), dr.max(dr.select(valid, depth, -dr.inf))]
        corners = [np.array([float(c[0]) for c in corner]) for corner in (low, high)]
        corners[1][2] += 1.0
        pixel_mm = float(dr.max(dr.norm(ray.d_x - ray.d))[0]) * corners[0][2]
        camera = MAPS.forward(field, view, corners[0], corners[1], march, _ELSEWHERE_PX * pixel_mm)
        depth = dr.select(valid, depth, float(corners[1][2]))
        across, along, by_x, by_y = camera.linear.at(mi.Array3f(p, q, depth))
        self._distance = (depth - before) / z
        self._moved = axes[0] * across + axes[1] * along
        self._turned = (axes[0] * by_x + axes[1] * by_y) * z
        dr.eval(self._distance, self._moved, self._turned)

    def bent(self, ray: Any, pixel: Any) -> Any:
        """Tangents of the bent rays of samples in pixels, started close to the part."""
        distance = dr.gather(mi.Float, self._distance, pixel)
        heading = dr.normalize(ray.d + mi.Vector3f(dr.gather(mi.Array3f, self._turned, pixel)))
        there = ray(distance) + mi.Vector3f(dr.gather(mi.Array3f, self._moved, pixel))
        bent = mi.RayDifferential3f(there - heading * distance, heading)
        bent.wavelengths = ray.wavelengths
        return self._before_surface(bent)

    def _before_surface(self, ray: Any) -> Any:
        """The same rays, started close to what they meet.

        From afar, Mitsuba's float32 puts hits inside a cylinder, where no lamp shines.  A ray in
        some millions slips through the seam of two triangles, and meets the next face from behind:
        it looks again from a micrometre aside.
        """
        near = self._started_near(ray)
        met = self._scene.ray_intersect(near)
        slipped = met.is_valid() & (dr.dot(met.n, near.d) > 0.0)
        dr.eval(ray, near.o, slipped)
        if dr.any(slipped):
            which = dr.compress(slipped)
            again = dr.gather(mi.Ray3f, mi.Ray3f(ray), which)
            again.o += mi.Frame3f(again.d).s * _ASIDE_MM
            dr.scatter(near.o, self._started_near(again).o, which)
        return near

    def _started_near(self, ray: Any) -> Any:
        met = self._scene.ray_intersect_preliminary(ray)
        ahead = dr.select(met.is_valid(), dr.maximum(met.t - _NEAR_MM, 0.0), 0.0)
        near = type(ray)(ray)
        near.o = ray(ahead)
        return near
