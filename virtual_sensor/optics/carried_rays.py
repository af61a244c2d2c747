"""Rays marched with their derivatives: how each would move if its start, or the air, changed.

A march carries, beside its ray, how the ray would move if its start were shifted or turned along
each of the world's axes, or if the field changed.  Any motion of camera and source, and any change
of the coordinates that name a ray, is a sum of these.
"""

from collections.abc import Iterable, Mapping
from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import ArrayLike, NDArray

from virtual_sensor.arrays import to_numpy, to_scalars, to_vectors, vector_of
from virtual_sensor.display import Displayed
from virtual_sensor.engine import dr, mi
from virtual_sensor.errors import InputError, short
from virtual_sensor.medium.field_derivative import FieldDerivative
from virtual_sensor.optics.eikonal import Remaining, bend, in_plane, never
from virtual_sensor.optics.family_frames import FamilyFrame
from virtual_sensor.optics.ray_families import RayFamily
from virtual_sensor.optics.ray_status import RayStatus
from virtual_sensor.optics.rays import Field, March, Straight, Variation
from virtual_sensor.optics.sight import SearchScene
from virtual_sensor.optics.surfaces import Cylinder, NoSurface, Surface

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


def _names(asker: str, names: Iterable[str]) -> list[str]:
    """The names asked for."""
    try:
        found: list[Any] = [None] if isinstance(names, str | bytes) else list(names)
    except TypeError:
        found = [None]
    if not all(isinstance(name, str) for name in found):
        raise InputError(f"{asker}: parameters is {short(names)}; give a list of names")
    return found


def parameters_of(
    asker: str,
    scene: SearchScene,
    parameters: Iterable[str] | None,
    variations: Mapping[str, Variation] | None,
    pivot_mm: ArrayLike,
) -> tuple[dict[str, Motion], list[str], dict[str, Variation]]:
    """All pose parameters that a scene has, those asked for, and derivatives of its field.

    None asks for all; variations are asked for by being given.

    Raises
    ------
    InputError
        If a parameter is unknown, or the air is asked to vary where there is none.
    """
    pivot = vector_of(f"{asker}: pivot_mm", pivot_mm)
    air = {} if variations is None else variations
    if not isinstance(air, Mapping) or not all(hasattr(each, "lookup") for each in air.values()):
        raise InputError(
            f"{asker}: variations is {short(variations)}; give derivatives of the field by name,"
            " such as those of an AirModel"
        )
    known = pose_parameters(pivot)
    part = scene.surface
    if isinstance(part, Cylinder):
        axis = (0.0, part.axis_y_mm, part.axis_z_mm)
        known["beta"] = pose_parameters(axis)["sensor_turn_x"]
    asked = [*known, "field_scale"] if parameters is None else _names(asker, parameters)
    air = dict(air)
    unknown = [name for name in asked if name not in (*known, "field_scale", *air)]
    if unknown:
        names = ", ".join([*known, "field_scale", *air])
        raise InputError(f"{asker}: parameters: no parameter '{unknown[0]}'; there are: {names}")
    taken = [name for name in air if name in (*known, "field_scale")]
    if taken:
        raise InputError(f"{asker}: '{taken[0]}' has a meaning; choose another name")
    asked = list(dict.fromkeys([*asked, *air]))
    if air and scene.medium is None:
        raise InputError(f"{asker}: the scene has no field that could vary; give it one")
    if "field_scale" in asked and scene.medium is not None:
        air["field_scale"] = FieldDerivative(scene.medium, share=1.0)
    return known, asked, air


@dataclass(frozen=True)
class CarriedRays(Displayed):
    """Rays where they end, and how they would move there, at the same t.

    Attributes
    ----------
    part : str
        What sends them: "camera" or "laser", which any source counts as.
    rays : RayStarts
    point, tangent : ndarray of shape (N, 3)
    by_start : ndarray of shape (N, 3, 6)
        By shifts of the start along x, y, z and by additions to the direction along x, y, z.
    by_air : dict from str to ndarray of shape (N, 3)
        By the field's parameters.
    arrived : ndarray of shape (N,)
        Whether they have met the surface, or the plane they were to end in.
    """

    part: str
    rays: RayStarts
    point: Array
    tangent: Array
    by_start: Array
    by_air: dict[str, Array]
    arrived: NDArray[np.bool_]

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


def carry(
    field: Field | None,
    part: str,
    rays: RayStarts,
    air: Mapping[str, Variation],
    march: March,
    *,
    surface: Surface | None = None,
    abreast_of: Array | None = None,
) -> CarriedRays:
    """March rays with all derivatives; one kernel for sources and cameras.

    Parameters
    ----------
    field : Field or None
        None: light runs straight.
    part : str
        What sends them: "camera" or "laser".
    rays : RayStarts
    air : mapping from str to Field
        Derivatives of the field by its parameters.
    march : March
    surface : Surface, optional
        What stops them.
    abreast_of : ndarray of shape (N, 3), optional
        Points, world, mm: each ray ends in the plane through its point, square to its start.
    """
    line = Straight.through(to_vectors(rays.origin), to_vectors(rays.direction), march)
    none = dr.zeros(march.vector, len(rays.origin))
    axes = [none + march.vector(*axis) for axis in np.eye(3).tolist()]
    ends: Remaining = never
    if abreast_of is not None:
        length = march.scalar(to_scalars(np.sum(abreast_of * rays.direction, axis=1)))
        ends = in_plane(line.direction, length)  # the anchor is square to the direction
    ray = bend(
        field,
        surface or NoSurface(),
        line,
        march,
        remaining=ends,
        tangents=(*((axis, none) for axis in axes), *((none, axis) for axis in axes)),
        variations=tuple(air.values()),
    )
    dr.eval(ray)
    point = to_numpy(ray.position(line))
    carried = [to_numpy(w) for w in ray.offset[1:]]
    by_start = np.stack(carried[:6], axis=-1)
    if field is not None:
        by_start += _at_the_border(field, rays, point, by_start)
    return CarriedRays(
        part,
        rays,
        point,
        to_numpy(ray.tangent(line)),
        by_start,
        dict(zip(air, carried[6:], strict=True)),
        np.isin(np.array(ray.status), (RayStatus.HIT, RayStatus.ENDED)),
    )


def _at_the_border(field: Field, rays: RayStarts, point: Array, by_start: Array) -> Array:
    """What `by_start` (N, 3, 6) lacks: rays shifted at their start enter it later or earlier.

    Where it has not quite faded at its border, they miss some of its pull, as if they were kicked
    there.  The march itself knows nothing of it: it carries derivatives through smooth fields.
    """
    origin, direction = field.to_local(rays.origin), rays.direction @ field.axes()
    steep = np.where(direction == 0.0, 1e-30, direction)
    crossings = (field.box[:, None] - origin) / steep
    near, far = crossings.min(axis=0), crossings.max(axis=0)
    distance = near.max(axis=1, keepdims=True)
    length = np.sum((point - rays.origin) * rays.direction, axis=1, keepdims=True)
    enters = (distance > 0.0) & (distance < np.minimum(far.min(axis=1, keepdims=True), length))
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
