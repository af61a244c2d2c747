"""How the laser line's place in the image answers to the sensor's pose and to the air.

Exact derivatives in forward mode: a march carries, beside its ray, how the ray would move if its
start were shifted or turned along each of the world's axes, or if the field changed.  Any motion of
camera and laser is a sum of these, so that two marches, one of the laser ray and one of the line of
sight, give the derivatives by all parameters at once:

- the laser ray's incidence point P moves by dP = w - T (N.w)/(N.T), with w the ray's derivative,
  T its tangent and N the surface's normal;
- the pixel (u, v) that sees P is the root of r(u, v) = P along the line of sight, whose derivative
  is that of an implicit function: r_u du + r_v dv + T dt = dP - w.
"""

from collections.abc import Iterable, Mapping
from dataclasses import dataclass
from typing import ClassVar

import numpy as np
from numpy.typing import ArrayLike, NDArray
from scipy.interpolate import CubicSpline

from virtual_sensor.arrays import by_rows, to_numpy, to_scalars, to_vectors
from virtual_sensor.display import Displayed, listed, tally
from virtual_sensor.engine import dr, mi
from virtual_sensor.errors import InputError, few
from virtual_sensor.optics.eikonal import LAST_PIECE_MM, bend
from virtual_sensor.optics.family_frames import FamilyFrame
from virtual_sensor.optics.ray_families import RayFamily
from virtual_sensor.optics.ray_search import SearchStatus, ray_search
from virtual_sensor.optics.ray_status import RayStatus
from virtual_sensor.optics.rays import Field, March, Straight
from virtual_sensor.optics.sight import REFERENCE, SearchScene, chosen
from virtual_sensor.optics.surfaces import Cylinder, SceneSurface

Array = NDArray[np.float64]

_BODIES = {"camera": ("camera",), "laser": ("laser",), "sensor": ("camera", "laser")}


@dataclass(frozen=True)
class Motion(Displayed):
    """Rate at which parts of the sensor, as one rigid body, move with a parameter.

    Attributes
    ----------
    parts : tuple of str
        "camera", "laser" or both.
    shift_mm : ndarray of shape (3,)
        Of the pivot, along the world's axes, per unit of the parameter.
    turn_rad : ndarray of shape (3,)
        About axes through the pivot, along the world's, per unit of the parameter.
    pivot_mm : ndarray of shape (3,)
        World.
    """

    parts: tuple[str, ...]
    shift_mm: Array
    turn_rad: Array
    pivot_mm: Array


@dataclass(frozen=True)
class RayStarts(Displayed):
    """Rays as they start, and how they change with their coordinates and with their device's pose.

    Attributes
    ----------
    origin, direction : ndarray of shape (N, 3)
        In mm, and unit vectors, world.
    by_coordinate : tuple of two (ndarray of shape (N, 3), ndarray of shape (N, 3))
        Derivatives of both by s and by t.
    """

    origin: Array
    direction: Array
    by_coordinate: tuple[tuple[Array, Array], tuple[Array, Array]]

    @staticmethod
    def of(family: RayFamily, s: ArrayLike, t: ArrayLike) -> "RayStarts":
        """Rays of coordinates (N,)."""
        s, t = np.broadcast_arrays(np.asarray(s, float), np.asarray(t, float))
        frame = FamilyFrame.of(family, mi.Array3f64)
        _, _, by = frame.rays(to_scalars(s), to_scalars(t))
        by_s, by_t = ((to_numpy(shift), to_numpy(turn)) for shift, turn in by)
        return RayStarts(*family.rays(s, t), (by_s, by_t))

    def by_motion(self, motion: Motion) -> tuple[Array, Array]:
        """Derivatives (N, 3) of origins and directions by a motion of their device."""
        moved = motion.shift_mm + np.cross(motion.turn_rad, self.origin - motion.pivot_mm)
        return moved, np.cross(motion.turn_rad, self.direction)


def pose_parameters(pivot_mm: ArrayLike = (0.0, 0.0, 0.0)) -> dict[str, Motion]:
    """The pose parameters by name.

    ``camera_x``, ``camera_y``, ``camera_z`` are shifts along the world's axes in mm, and
    ``camera_turn_x`` ... turns in degrees about axes through the pivot, along the world's, as
    Mitsuba's <rotate> counts them; likewise ``laser_...`` and, for both together, ``sensor_...``.
    """
    named, none, pivot = {}, np.zeros(3), np.array(pivot_mm, float)
    for body, parts in _BODIES.items():
        for axis, unit in zip("xyz", np.eye(3), strict=True):
            named[f"{body}_{axis}"] = Motion(parts, unit, none, pivot)
            named[f"{body}_turn_{axis}"] = Motion(parts, none, np.radians(unit), pivot)
    return named


@dataclass(frozen=True)
class Sensitivity(Displayed):
    """Derivatives of the line's place in the image, one row per laser ray; NaN unless FOUND.

    Attributes
    ----------
    laser_y_mm : ndarray of shape (N,)
        The laser rays' coordinates b along the line.
    laser_point_mm : ndarray of shape (N, 3)
        Their incidence points, world.
    pixel : ndarray of shape (N, 2)
        (u, v) that see them.
    along_line : ndarray of shape (N, 2)
        d(u, v)/db in px/mm: the direction of the line in the image.
    of_pixel : dict from str to ndarray of shape (N, 2)
        d(u, v)/dp of the pixel that sees the same laser ray, by parameter: in px per mm, px per
        degree, px per unit of `field_scale`, px per unit of any other.
    status : ndarray of shape (N,)
        `SearchStatus`.
    """

    _field_units: ClassVar = {"pixel": "px", "along_line": "px/mm"}
    _statuses: ClassVar = {"status": SearchStatus}
    _by_row: ClassVar = True

    laser_y_mm: Array
    laser_point_mm: Array
    pixel: Array
    along_line: Array
    of_pixel: dict[str, Array]
    status: NDArray[np.int64]

    def _line(self) -> str:
        return listed(tally(self.status, SearchStatus.FOUND), f"by {few([*self.of_pixel], 6)}")

    @property
    def of_centre(self) -> dict[str, Array]:
        """Derivatives dv/dp (N,) of the line's centre in an image column that stays the same.

        A column then sees another laser ray, further along the line.
        """
        slope = self.along_line[:, 1] / self.along_line[:, 0]
        return {name: by[:, 1] - slope * by[:, 0] for name, by in self.of_pixel.items()}


def line_sensitivity(
    scene: SearchScene,
    laser_y_mm: ArrayLike,
    parameters: Iterable[str] | None = None,
    *,
    variations: Mapping[str, Field] | None = None,
    pivot_mm: ArrayLike = (0.0, 0.0, 0.0),
    march: March = REFERENCE,
    camera: str | None = None,
    source: str | None = None,
) -> Sensitivity:
    """Find the pixels that see laser rays' incidence points, and their derivatives.

    Parameters
    ----------
    scene : Scene
        From `load_scene`, or what else a search can do with.
    laser_y_mm : array_like of shape (N,)
        Positions b of the rays along the line; `laser_y_at` gives those that image columns see.
    parameters : iterable of str, optional
        Of `pose_parameters`; ``beta``, the sensor's turn in degrees about the analytic cylinder's
        axis; ``field_scale``, a factor at the field's difference from its surroundings, where it
        is 1.
        All of them if not given, but ``beta`` only where there is such a cylinder.
    variations : mapping from str to Field, optional
        Further parameters: the field's derivative by each, such as `FieldFamily.derivative`.
    pivot_mm : array_like of shape (3,)
        World point that turns are about, other than ``beta``.
    march : March
    camera, source : str, optional
        Names of the scene's, where it has several.

    Raises
    ------
    InputError
        If a parameter is unknown, or the air is asked to vary where there is none.
    """
    scene = chosen(scene, camera, source)
    b = np.atleast_1d(np.asarray(laser_y_mm, float))
    known = _known_parameters(scene, pivot_mm)
    asked = [*known, "field_scale"] if parameters is None else list(parameters)
    air = dict(variations or {})
    unknown = [name for name in asked if name not in (*known, "field_scale", *air)]
    if unknown:
        names = ", ".join([*known, "field_scale", *air])
        raise InputError(f"line_sensitivity: no parameter '{unknown[0]}'; there are: {names}")
    taken = [name for name in air if name in (*known, "field_scale")]
    if taken:
        raise InputError(f"line_sensitivity: '{taken[0]}' has a meaning; choose another name")
    asked = list(dict.fromkeys([*asked, *air]))
    if air and scene.medium is None:
        raise InputError("line_sensitivity: the scene has no field that could vary; give it one")
    if "field_scale" in asked and scene.medium is not None:
        air["field_scale"] = scene.medium

    return by_rows(lambda b: _sensitivity(scene, b, asked, known, air, march), b)


def _sensitivity(
    scene: SearchScene,
    b: Array,
    asked: Iterable[str],
    known: Mapping[str, Motion],
    air: Mapping[str, Field],
    march: March,
) -> Sensitivity:
    """The derivatives asked for, of laser rays at b (N,)."""
    found = ray_search(scene, b, "newton", march=march)
    camera, laser = scene.camera, scene.source
    lit = _carry(scene, "laser", RayStarts.of(laser.family, 0.0, b), air, march)
    p, q = camera.of_pixels(np.nan_to_num(found.pixel))
    seen = _carry(scene, "camera", RayStarts.of(camera, p, q), air, march)
    by_pq = camera.pixel_slopes(p, q)
    normal = _normals(scene, lit)
    columns = np.stack([*seen.by_coordinate(), seen.tangent], axis=-1)  # of p, q and t
    inverse = np.full_like(columns, np.nan)
    good = (found.status == SearchStatus.FOUND) & seen.hit & lit.hit
    lost = (found.status == SearchStatus.FOUND) & ~good
    inverse[good] = np.linalg.inv(columns[good])

    def pixels(of_light: Array, of_sight: Array | float) -> Array:
        """Derivatives of the pixels, from those of both rays at the same t."""
        with np.errstate(invalid="ignore", divide="ignore"):  # where nothing was met
            slip = np.sum(normal * of_light, axis=1) / np.sum(normal * lit.tangent, axis=1)
        of_point = of_light - lit.tangent * slip[:, None]
        of_pq = (inverse @ (of_point - of_sight)[:, :, None])[:, :2]
        return (by_pq @ of_pq)[:, :, 0]

    _, by_b = lit.by_coordinate()
    return Sensitivity(
        b,
        found.laser_point_mm,
        found.pixel,
        pixels(by_b, 0.0),
        {name: pixels(lit.by(name, known), seen.by(name, known)) for name in asked},
        np.where(lost, SearchStatus.LASER_MISSED, found.status),
    )


def laser_y_at(scene: SearchScene, columns: ArrayLike, march: March = REFERENCE) -> Array:
    """Positions b (N,) in mm of the laser rays that image columns u (N,) see on the line.

    NaN where a column sees none, or several.
    """
    u = np.atleast_1d(np.asarray(columns, float))
    low, high = scene.source.extent
    b = np.linspace(low[1], high[1], 65)
    along = ray_search(scene, b, "newton", march=march).pixel[:, 0]
    b, along = b[np.isfinite(along)], along[np.isfinite(along)]
    rising = np.diff(along) * np.sign(along[-1:] - along[:1]) > 0.0
    if not rising.size or not rising.all():
        return np.full_like(u, np.nan)
    order = np.argsort(along)
    y = CubicSpline(along[order], b[order], extrapolate=False)(u)
    seen = np.isfinite(y)
    for _ in range(2):  # from a spline's error of some 0.01 px, quadratically
        if seen.any():
            at = line_sensitivity(scene, y[seen], (), march=march)
            y[seen] += (u[seen] - at.pixel[:, 0]) / at.along_line[:, 0]
            seen = np.isfinite(y)
    return y


def _known_parameters(scene: SearchScene, pivot_mm: ArrayLike) -> dict[str, Motion]:
    """All pose parameters that the scene has."""
    known = pose_parameters(pivot_mm)
    part = scene.surface
    if isinstance(part, Cylinder):
        axis = (0.0, part.axis_y_mm, part.axis_z_mm)
        known["beta"] = pose_parameters(axis)["sensor_turn_x"]
    return known


@dataclass(frozen=True)
class _Carried:
    """Rays where they meet the surface, and how they would move there, at the same t.

    Attributes
    ----------
    part : str
        What sends them: "camera" or "laser".
    rays : RayStarts
    point, tangent : ndarray of shape (N, 3)
    by_start : ndarray of shape (N, 3, 6)
        By shifts of the start along x, y, z and by additions to the direction along x, y, z.
    by_air : dict from str to ndarray of shape (N, 3)
        By the field's parameters.
    hit : ndarray of shape (N,)
    """

    part: str
    rays: RayStarts
    point: Array
    tangent: Array
    by_start: Array
    by_air: dict[str, Array]
    hit: NDArray[np.bool_]

    def by(self, name: str, known: Mapping[str, Motion]) -> Array:
        """Derivatives (N, 3) of the points by a parameter: of the pose, or one of the field."""
        motion = known.get(name)
        if motion is None:
            return self.by_air.get(name, np.zeros_like(self.point))
        if self.part not in motion.parts:
            return np.zeros_like(self.point)
        return self._follow(*self.rays.by_motion(motion))

    def by_coordinate(self) -> list[Array]:
        """Derivatives (N, 3) of the points by the coordinates that name the rays."""
        return [self._follow(*change) for change in self.rays.by_coordinate]

    def _follow(self, shift: Array, turn: Array) -> Array:
        """Derivatives of the points, given those of starts and unit directions."""
        start = np.concatenate([shift, turn], axis=1)
        return np.einsum("ijk,ik->ij", self.by_start, start)


def _carry(
    scene: SearchScene, part: str, rays: RayStarts, air: Mapping[str, Field], march: March
) -> _Carried:
    """March rays to the surface with all derivatives; one kernel for laser and camera."""
    line = Straight.through(to_vectors(rays.origin), to_vectors(rays.direction), march)
    none = dr.zeros(march.vector, len(rays.origin))
    axes = [none + march.vector(*axis) for axis in np.eye(3).tolist()]
    ray = bend(
        scene.medium,
        scene.surface,
        line,
        march,
        tangents=(*((axis, none) for axis in axes), *((none, axis) for axis in axes)),
        variations=tuple(air.values()),
    )
    dr.eval(ray)
    carried = [to_numpy(w) for w in ray.offset[1:]]
    by_start = np.stack(carried[:6], axis=-1)
    if scene.medium is not None:
        by_start += _at_the_border(scene.medium, rays, by_start)
    return _Carried(
        part,
        rays,
        to_numpy(ray.position(line)),
        to_numpy(ray.tangent(line)),
        by_start,
        dict(zip(air, carried[6:], strict=True)),
        np.array(ray.status) == RayStatus.HIT,
    )


def _at_the_border(field: Field, rays: RayStarts, by_start: Array) -> Array:
    """What `by_start` (N, 3, 6) lacks: rays shifted at their start enter it later or earlier.

    Where it has not quite faded at its border, they miss some of its pull, as if they were kicked
    there.  The march itself knows nothing of it: it carries derivatives through smooth fields.
    """
    origin, direction = field.to_local(rays.origin), rays.direction @ field.axes()
    steep = np.where(direction == 0.0, 1e-30, direction)
    crossings = (field.box[:, None] - origin) / steep
    near, far = crossings.min(axis=0), crossings.max(axis=0)
    distance = near.max(axis=1, keepdims=True)
    enters = (distance > 0.0) & (distance < far.min(axis=1, keepdims=True))
    distance = np.where(enters, distance, 0.0)
    sooner = np.where(enters & (near == distance), 1.0 / steep, 0.0)  # by which shift of the start
    entry = np.clip(origin + distance * direction, *field.box)
    delta, gradient = field.lookup("double").delta_and_gradient(to_vectors(entry))
    n = 1.0 + np.array(delta)[:, None] / (1.0 + field.ambient)
    pull = n * to_numpy(gradient) / (1.0 + field.ambient)
    sooner, pull = sooner @ field.axes().T, pull @ field.axes().T
    # A kick there is a turn at the start together with a shift back.
    by_kick = by_start[:, :, 3:] - distance[:, :, None] * by_start[:, :, :3]
    moves = (by_kick @ pull[:, :, None]) * sooner[:, None]
    return np.concatenate([moves, moves * distance[:, :, None]], axis=2)


def _normals(scene: SearchScene, rays: _Carried) -> Array:
    """Normals (N, 3) of the surface where rays have met it, of any length and sign."""
    surface = scene.surface
    if isinstance(surface, Cylinder):
        x, y, z = (rays.point - [0.0, surface.axis_y_mm, surface.axis_z_mm]).T
        on_end = np.abs(x) > surface.half_length_mm - 1e-6
        on_end &= np.hypot(y, z) < surface.radius_mm - 1e-6
        return np.column_stack([np.where(on_end, x, 0.0), ~on_end * y, ~on_end * z])
    if not isinstance(surface, SceneSurface):
        raise InputError("line_sensitivity: the surface is neither a cylinder nor Mitsuba's shapes")
    heading = rays.tangent / np.linalg.norm(rays.tangent, axis=1, keepdims=True)
    return surface.normals(rays.point, heading, LAST_PIECE_MM)
