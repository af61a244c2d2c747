"""Which pixels the laser lights, and what is seen at their centres: the ground truth of a frame."""

from collections.abc import Callable, Sequence
from dataclasses import dataclass, field, fields, is_dataclass, replace
from typing import Any

import cv2
import numpy as np
from numpy.typing import NDArray
from scipy.ndimage import distance_transform_edt
from virtual_sensor_plugins.laser_line import SourceEmitter

from virtual_sensor.arrays import at_least, in_own_memory
from virtual_sensor.engine import dr, mi
from virtual_sensor.optics.family_frames import FamilyFrame
from virtual_sensor.optics.illumination import Illumination, LightStatus
from virtual_sensor.optics.ray_maps import Fineness
from virtual_sensor.poses import Pose

_LATTICE_PX = 16  # displacements are looked at this often before every lit pixel is marched
_FAR_MM = 2.0  # refraction is taken to move no light further than this


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
    light : Illumination
        The laser's at the points.
    """

    point: Any
    heading: Any
    hit: Any
    light: Illumination


@dataclass
class Account:
    """How a frame was made.

    Attributes
    ----------
    transport : str
        "tabulated" or another of `TRANSPORTS`.
    reason : str
        Why it is not the transport that was asked for; "" if it is.
    camera, laser : Fineness or None
        Of the tables.
    error_px : float
        The tables' own estimate of their error; NaN without tables.
    march_px : float
        What half the march's step changes at some lit pixels, at most; NaN where none were asked.
    samples, marched : int
        Samples that looked for the laser's light, and those of them that the tables couldn't tell
        of and that were marched.
    folded : int
        Pixels near the line to whose centre no single laser ray was found: they are black.
    """

    transport: str
    reason: str = ""
    camera: Fineness | None = None
    laser: Fineness | None = None
    error_px: float = float("nan")
    march_px: float = float("nan")
    samples: int = 0
    marched: int = 0
    folded: int = 0


@dataclass
class LitPixels:
    """Pixels that may receive laser light, and what is seen at their centres.

    Attributes
    ----------
    index : ndarray of shape (N,)
        Row-major numbers within the film's crop window.
    sight : Sight
        At the pixels' centres, in the same order.
    account : Account
    tables : Tables or None
        That tell of their samples; None: these are to be marched.
    """

    index: NDArray[np.uint32]
    sight: Sight
    account: Account = field(default_factory=lambda: Account("marched"))
    tables: Any = None


def film_place(film: mi.Film, index: Any, within: Any) -> Any:
    """Place in px on the whole film of points within pixels, both coordinates from 0 to 1."""
    offset, width = film.crop_offset(), film.crop_size().x
    corner = mi.Point2f(mi.Float(index % width), mi.Float(index // width))
    return corner + mi.Point2f(offset) + within


def film_rays(sensor: mi.Sensor, place: Any, aperture: Any) -> tuple[Any, Any]:
    """Camera rays and their weights through places on the film.

    A pinhole's start at the projection centre, not at Mitsuba's near plane: where a camera stands
    in hot air, light bends in between.
    """
    film = sensor.film()
    in_window = (place - mi.Point2f(film.crop_offset())) / mi.Point2f(film.crop_size())
    ray, weight = sensor.sample_ray_differential(0.0, 0.5, in_window, aperture)
    if _has_pinhole(sensor):  # no pose is read: to read numbers waits for all that is under way
        ray.o = mi.Point3f(sensor.world_transform().translation()) + mi.Vector3f(0.0 * ray.d)
    return ray, weight


def _has_pinhole(sensor: mi.Sensor) -> bool:
    return sensor.class_name() == "PerspectiveCamera"


def pinhole(sensor: mi.Sensor) -> Pose | None:
    """Pose of a pinhole camera's projection centre, z forward; None of any other camera."""
    if not _has_pinhole(sensor):
        return None
    to_world = np.array(sensor.world_transform().matrix, float).reshape(-1)[:16].reshape(4, 4)
    return Pose.from_matrix(to_world)


def centre_rays(sensor: mi.Sensor, pixels: NDArray[np.uint32] | None = None) -> Any:
    """Camera rays through the centres of pixels; of all without their numbers."""
    film, middle = sensor.film(), mi.Point2f(0.5)
    if pixels is None:
        size = film.crop_size()
        index = dr.arange(mi.UInt32, size.x * size.y)
    else:
        index = in_own_memory(pixels, mi.UInt32)
    return film_rays(sensor, film_place(film, index, middle), middle)[0]


def rows(tree: Any, index: Any) -> Any:
    """Gather some rows of Dr.Jit arrays nested in tuples and dataclasses; NumPy's numbers serve."""
    if isinstance(index, np.ndarray):
        index = in_own_memory(index, mi.UInt32)
    if isinstance(tree, tuple):
        return tuple(rows(leaf, index) for leaf in tree)
    if is_dataclass(tree) and not isinstance(tree, type):
        return replace(tree, **{f.name: rows(getattr(tree, f.name), index) for f in fields(tree)})
    return tree if tree is None else dr.gather(type(tree), tree, index)


def find_lit_pixels(
    scene: mi.Scene,
    sensor: mi.Sensor,
    emitter: SourceEmitter,
    look: Callable[[Any], Sight],
    account: Account,
) -> LitPixels:
    """Find the pixels that the laser reaches, marching no more rays than that takes.

    1. Straight rays of all pixels give each one's laser coordinates without refraction.
    2. Bent rays of a lattice of pixels tell about how far refraction moves these.
    3. Bent rays of the pixels that may be lit then tell which are; their neighbours count too.
    """
    width, height = (int(n) for n in sensor.film().crop_size())
    a, b, pixel_mm = _straight_coordinates(scene, sensor, emitter)
    every = np.arange(width * height, dtype=np.uint32)
    middle = _LATTICE_PX // 2
    on_lattice = (every % width % _LATTICE_PX == middle) & (every // width % _LATTICE_PX == middle)
    near = every[on_lattice & reached(emitter, a, b, (_FAR_MM, _FAR_MM))]
    margin = (_FAR_MM, _FAR_MM)
    if near.size:
        light = look(centre_rays(sensor, near)).light
        moved_a, margin_a = _spread(light.s.numpy() - a[near], near, width, height)
        moved_b, margin_b = _spread(light.t.numpy() - b[near], near, width, height)
        a, b = a + moved_a, b + moved_b
        margin = (pixel_mm + margin_a, pixel_mm + margin_b)
    # A pixel whose centre looks past an edge may see light beside it: neighbours count too.
    candidates = at_least(1, every[grown(reached(emitter, a, b, margin), height, width)])
    sight = look(centre_rays(sensor, candidates))
    dr.eval(sight)
    account.folded = int(np.sum(np.array(sight.light.status) == LightStatus.FOLDED))
    lit = np.zeros(width * height, bool)
    near = emitter.source.reaches(sight.light.s, sight.light.t, (pixel_mm, pixel_mm))
    lit[candidates] = near.numpy()
    keep = at_least(1, np.flatnonzero(grown(lit, height, width)[candidates]).astype(np.uint32))
    return LitPixels(candidates[keep], rows(sight, keep), account)


def _straight_coordinates(
    scene: mi.Scene, sensor: mi.Sensor, emitter: SourceEmitter
) -> tuple[NDArray[np.float32], NDArray[np.float32], float]:
    """Straight laser coordinates (a, b) in mm at all pixels' centres, and a pixel's size there."""
    ray = centre_rays(sensor)
    met = scene.ray_intersect_preliminary(ray)
    frame = FamilyFrame.of(emitter.source.family, mi.Array3f)
    a, b, _ = frame.coordinates(mi.Array3f(ray(met.t)))
    missed = ~met.is_valid()
    a[missed], b[missed] = dr.nan, dr.nan
    spread = dr.norm(ray.d_x - ray.d) * dr.select(missed, 0.0, met.t)
    return a.numpy(), b.numpy(), float(dr.max(spread)[0])


def _spread(
    moved_mm: NDArray[np.floating], at: NDArray[np.uint32], width: int, height: int
) -> tuple[NDArray[np.float32], float]:
    """Displacements of all pixels by the nearest on the lattice, and a bound for what is left.

    The bound is what neighbours on the lattice differ by, with something to spare.
    """
    shape = -(-height // _LATTICE_PX), -(-width // _LATTICE_PX)
    lattice = np.full(shape, np.nan, np.float32)
    lattice[at // width // _LATTICE_PX, at % width // _LATTICE_PX] = moved_mm
    steps = np.concatenate([np.diff(lattice, axis=axis).ravel() for axis in (0, 1)])
    bound = float(np.nanmax(np.abs(steps), initial=0.0)) if np.isfinite(steps).any() else _FAR_MM
    unknown = np.isnan(lattice)
    if unknown.all():
        return np.zeros(width * height, np.float32), _FAR_MM
    nearest = distance_transform_edt(unknown, return_distances=False, return_indices=True)
    whole = lattice[tuple(nearest)].repeat(_LATTICE_PX, axis=0).repeat(_LATTICE_PX, axis=1)
    return whole[:height, :width].ravel(), min(1.5 * bound, _FAR_MM)


def reached(
    emitter: SourceEmitter,
    a: NDArray[np.floating],
    b: NDArray[np.floating],
    margin_mm: Sequence[float],
) -> NDArray[np.bool_]:
    """Which laser coordinates in mm the line reaches, or misses by no more than a margin."""
    # Opaque, since it is another number for any air, and the kernel is to serve them all.
    margin = tuple(dr.opaque(mi.Float, float(m)) for m in margin_mm)
    a, b = (in_own_memory(x, mi.Float) for x in (a, b))
    return np.asarray(emitter.source.reaches(a, b, margin).numpy(), bool)


def grown(mask: NDArray[np.bool_], height: int, width: int) -> NDArray[np.bool_]:
    """The pixels of a mask and their neighbours."""
    image = mask.astype(np.uint8).reshape(height, width)
    return cv2.dilate(image, np.ones((3, 3), np.uint8)).ravel() > 0


def guess_from(light: Illumination) -> tuple[Any, Any, tuple[Any, Any, Any, Any]]:
    """What is known near samples, from the light at their pixels' centres; straight if nothing."""
    sound = dr.isfinite(light.s)
    identity = (1.0, 0.0, 0.0, 1.0)
    known = light.jacobian or identity
    jacobian = (dr.select(sound, j, i) for j, i in zip(known, identity, strict=True))
    return *(dr.select(sound, shift, 0.0) for shift in light.shift), tuple(jacobian)
