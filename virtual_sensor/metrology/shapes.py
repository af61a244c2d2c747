"""Shapes that measured points lie on: known ones, and ones whose size and place are to be found.

A shape is plain data. Its numbers are its parameters, by the names of its fields, and `distance`
says how far points are from it, with exact derivatives by the points and by every parameter: all
that a fit needs. Lengths are in mm, turns in degrees, points of the world.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, field, replace
from typing import Any, ClassVar, Self

import numpy as np
from numpy.typing import ArrayLike, NDArray
from scipy.optimize import least_squares

from virtual_sensor.arrays import points_of
from virtual_sensor.calls import public
from virtual_sensor.display import Displayed
from virtual_sensor.errors import InputError, nearest
from virtual_sensor.poses import Pose

Array = NDArray[np.float64]

_BEFORE_MM = 2.0  # from so far before a known part, points look for it
_FARTHEST_MM = 5.0  # and no farther than so
_SAME_FACE = 0.9  # cosine of the normals of places on one face


@dataclass(frozen=True)
class Distances(Displayed):
    """How far N points are from a shape; NaN where a point is, or where the shape is nowhere near.

    Attributes
    ----------
    distance_mm : ndarray of shape (N,)
        Along the shape's normal, positive outside.
    by_point : ndarray of shape (N, 3)
        Derivatives by the points: unit normals, world.
    by_parameter : dict from str to ndarray of shape (N,)
        Derivatives by every parameter: mm per mm, mm per degree.
    """

    _by_row: ClassVar = True

    distance_mm: Array
    by_point: Array
    by_parameter: dict[str, Array]


class Shape(Displayed):
    """A shape; subclasses are frozen dataclasses, whose parameters are fields of type float."""

    names: ClassVar[tuple[str, ...]] = ()
    """Of all its parameters."""

    @property
    def values(self) -> dict[str, float]:
        """Its parameters."""
        return {name: float(getattr(self, name)) for name in self.names}

    def with_values(self, **values: float) -> Self:
        """The same shape with other values of some parameters."""
        return replace(self, **{name: float(value) for name, value in values.items()})  # type: ignore[type-var]

    def distance(self, points_mm: ArrayLike) -> Distances:
        """How far world points (N, 3) are from it."""
        raise NotImplementedError

    def fitted(self, points_mm: ArrayLike, free: Sequence[str] | None = None) -> Self:
        """The one that is nearest to points (N, 3), by orthogonal least squares.

        Parameters
        ----------
        points_mm : array_like of shape (N, 3)
            World; those that are not finite are left out.
        free : sequence of str, optional
            Parameters to be found; the others stay. All by default.

        Raises
        ------
        InputError
            If there is no such parameter, or there are fewer points than free ones.
        """
        free = self.checked(self.names if free is None else free)
        points = points_of("fitted: points_mm", points_mm)
        points = points[np.isfinite(points).all(axis=1)]
        if len(points) < len(free):
            raise InputError(
                f"{type(self).__name__}: {len(points)} points for {len(free)} unknowns"
                f" ({', '.join(free)}); give more points, or leave fewer free"
            )
        if not free:
            return self

        def at(x: Array) -> Distances:
            return self.with_values(**dict(zip(free, x, strict=True))).distance(points)

        found = least_squares(
            lambda x: np.nan_to_num(at(x).distance_mm),
            [self.values[name] for name in free],
            lambda x: np.nan_to_num(np.column_stack([at(x).by_parameter[n] for n in free])),
            x_scale="jac",
            xtol=1e-14,
            ftol=1e-14,
            gtol=1e-14,
            max_nfev=100,
        )
        return self.with_values(**dict(zip(free, found.x, strict=True)))

    def checked(self, free: Sequence[str]) -> tuple[str, ...]:
        """Names of parameters, each once.

        Raises
        ------
        InputError
            If there is none of such a name; it says which there are.
        """
        for name in free:
            if name not in self.names:
                raise InputError(
                    f"{type(self).__name__}: free: there is no parameter '{name}'; there are"
                    f" {', '.join(self.names)}{nearest(name, self.names)}"
                )
        return tuple(dict.fromkeys(free))


@public
@dataclass(frozen=True)
class CylinderShape(Shape):
    """A round cylinder without ends, whose axis is near the x axis of its frame.

    Attributes
    ----------
    radius_mm : float
    y_mm, z_mm : float
        Where the axis goes through the plane x = 0 of its frame.
    turn_y_deg, turn_z_deg : float
        How the axis is turned out of x: about y first, then about z.
    pose : Pose or None
        Of its frame; None: it is the world's.
    """

    names: ClassVar = ("radius_mm", "y_mm", "z_mm", "turn_y_deg", "turn_z_deg")

    radius_mm: float = 13.5
    y_mm: float = 0.0
    z_mm: float = -13.5
    turn_y_deg: float = 0.0
    turn_z_deg: float = 0.0
    pose: Pose | None = None

    @property
    def axis(self) -> tuple[Array, Array]:
        """A point (3,) of its axis, and the axis' direction, a unit vector: world."""
        place, along = np.array([0.0, self.y_mm, self.z_mm]), self._along
        return (
            (self.pose.to_world(place), self.pose.rotation @ along) if self.pose else (place, along)
        )

    @property
    def _along(self) -> Array:
        by_y, by_z = np.radians([self.turn_y_deg, self.turn_z_deg])
        return np.array([np.cos(by_z) * np.cos(by_y), np.sin(by_z) * np.cos(by_y), -np.sin(by_y)])

    def distance(self, points_mm: ArrayLike) -> Distances:
        """How far world points (N, 3) are from it."""
        local, axes = _local(self.pose, points_mm)
        by_y, by_z = np.radians([self.turn_y_deg, self.turn_z_deg])
        axis = self._along
        axis_by = {
            "turn_y_deg": [
                -np.cos(by_z) * np.sin(by_y),
                -np.sin(by_z) * np.sin(by_y),
                -np.cos(by_y),
            ],
            "turn_z_deg": [-axis[1], axis[0], 0.0],
        }
        from_place = local - [0.0, self.y_mm, self.z_mm]
        depth = from_place @ axis
        across = from_place - depth[:, None] * axis
        from_axis = np.linalg.norm(across, axis=1)
        normal = across / np.where(from_axis > 0.0, from_axis, 1.0)[:, None]
        by = {"radius_mm": -np.ones(len(local)), "y_mm": -normal[:, 1], "z_mm": -normal[:, 2]}
        by |= {name: -depth * (normal @ np.radians(turn)) for name, turn in axis_by.items()}
        return Distances(from_axis - self.radius_mm, normal @ axes.T, by)


@public
@dataclass(frozen=True)
class PlaneShape(Shape):
    """A plane near z = 0 of its frame.

    Attributes
    ----------
    z_mm : float
        Where it goes through the z axis of its frame.
    turn_x_deg, turn_y_deg : float
        How it is turned about that point: about x first, then about y.
    pose : Pose or None
        Of its frame; None: it is the world's.
    """

    names: ClassVar = ("z_mm", "turn_x_deg", "turn_y_deg")

    z_mm: float = 0.0
    turn_x_deg: float = 0.0
    turn_y_deg: float = 0.0
    pose: Pose | None = None

    @property
    def axis(self) -> tuple[Array, Array]:
        """A point (3,) of it, and its normal, a unit vector: world."""
        place = np.array([0.0, 0.0, self.z_mm])
        normal = _turn(self.turn_x_deg, self.turn_y_deg, 0.0)[0][:, 2]
        return (
            (self.pose.to_world(place), self.pose.rotation @ normal)
            if self.pose
            else (place, normal)
        )

    def distance(self, points_mm: ArrayLike) -> Distances:
        """How far world points (N, 3) are from it, positive above."""
        local, axes = _local(self.pose, points_mm)
        turn, by_turn = _turn(self.turn_x_deg, self.turn_y_deg, 0.0)
        from_place, normal = local - [0.0, 0.0, self.z_mm], turn[:, 2]
        by = {"z_mm": np.full(len(local), -normal[2])}
        by |= {f"turn_{a}_deg": from_place @ t[:, 2] for a, t in zip("xy", by_turn, strict=False)}
        return Distances(from_place @ normal, np.tile(axes @ normal, (len(local), 1)), by)


@public
@dataclass(frozen=True)
class SphereShape(Shape):
    """A sphere.

    Attributes
    ----------
    radius_mm : float
    x_mm, y_mm, z_mm : float
        Its centre, world.
    """

    names: ClassVar = ("radius_mm", "x_mm", "y_mm", "z_mm")

    radius_mm: float
    x_mm: float = 0.0
    y_mm: float = 0.0
    z_mm: float = 0.0

    def distance(self, points_mm: ArrayLike) -> Distances:
        """How far world points (N, 3) are from it."""
        points = _points(points_mm)
        from_centre = points - [self.x_mm, self.y_mm, self.z_mm]
        length = np.linalg.norm(from_centre, axis=1)
        normal = from_centre / np.where(length > 0.0, length, 1.0)[:, None]
        by = {"radius_mm": -np.ones(len(points))}
        by |= {f"{axis}_mm": -normal[:, i] for i, axis in enumerate("xyz")}
        return Distances(length - self.radius_mm, normal, by)


@public
@dataclass(frozen=True)
class PartShape(Shape):
    """A known part, such as a scene's: its form is given, where it lies may be found.

    Attributes
    ----------
    surface : Cylinder or SceneSurface
        `scene.surface`: the analytic cylinder, without its end faces, or Mitsuba's shapes.
    towards : tuple of three float
        Unit vector from the part to those that measure it, such as `scene.towards_sensors`.
    x_mm, y_mm, z_mm : float
        By how much the part is shifted along the world's axes.
    turn_x_deg, turn_y_deg, turn_z_deg : float
        And turned before, about axes through the pivot: about x first, then y, then z.
    pivot_mm : tuple of three float
        World.
    """

    names: ClassVar = ("x_mm", "y_mm", "z_mm", "turn_x_deg", "turn_y_deg", "turn_z_deg")

    surface: Any = field(repr=False)
    towards: tuple[float, float, float] = (0.0, 0.0, 1.0)
    x_mm: float = 0.0
    y_mm: float = 0.0
    z_mm: float = 0.0
    turn_x_deg: float = 0.0
    turn_y_deg: float = 0.0
    turn_z_deg: float = 0.0
    pivot_mm: tuple[float, float, float] = (0.0, 0.0, 0.0)

    @staticmethod
    def of(scene: Any) -> PartShape:
        """The part of a scene, where it lies."""
        return PartShape(scene.surface, tuple(scene.towards_sensors.tolist()))

    def distance(self, points_mm: ArrayLike) -> Distances:
        """How far world points (N, 3) are from it: from the tangent plane under or above them."""
        turn, by_turn = _turn(self.turn_x_deg, self.turn_y_deg, self.turn_z_deg)
        away = _points(points_mm) - self.pivot_mm - [self.x_mm, self.y_mm, self.z_mm]
        at_rest = away @ turn + self.pivot_mm
        if hasattr(self.surface, "radius_mm"):
            part = self.surface
            round_part = CylinderShape(part.radius_mm, part.axis_y_mm, part.axis_z_mm)
            found = round_part.distance(at_rest)
            distance, normal = found.distance_mm, found.by_point
        else:
            distance, normal = self._from_tangent(at_rest, np.asarray(self.towards) @ turn)
        world = normal @ turn.T
        by = {f"{axis}_mm": -world[:, i] for i, axis in enumerate("xyz")}
        by |= {
            f"turn_{axis}_deg": np.sum(normal * (away @ rate), axis=1)
            for axis, rate in zip("xyz", by_turn, strict=True)
        }
        return Distances(distance, world, by)

    def _from_tangent(self, points: Array, towards: Array) -> tuple[Array, Array]:
        """Distance (N,) and normals (N, 3) of the faces that are met from the sensors' side."""
        from virtual_sensor.arrays import by_rows, to_scalars, to_vectors

        known: Any = np.isfinite(points).all(axis=1)

        def met(start: Array, heading: Array) -> tuple[Array, Array]:
            origin, direction = to_vectors(start), to_vectors(heading)
            limit = to_scalars(np.full(len(start), _BEFORE_MM + _FARTHEST_MM))
            reach = np.array(self.surface.distance(origin, direction, limit, True))
            there = start + np.where(np.isfinite(reach), reach, 0.0)[:, None] * heading
            normal = np.where(
                np.isfinite(reach)[:, None], self.surface.normals(there, heading), np.nan
            )
            return there, normal

        at = np.where(known[:, None], points, 0.0)
        there, normal = by_rows(met, at + _BEFORE_MM * towards, np.tile(-towards, (len(at), 1)))
        normal = np.where(known[:, None] & (normal @ towards > 0.0)[:, None], normal, np.nan)
        distance = np.sum((points - there) * normal, axis=1)
        # Once more along that normal: a curved face turns away on the way that the first one took.
        ahead = np.where(np.isfinite(normal), normal, towards)
        nearest, closer = by_rows(met, at + _BEFORE_MM * ahead, -ahead)
        again = np.sum((points - nearest) * closer, axis=1)
        same = (np.sum(closer * ahead, axis=1) > _SAME_FACE) & np.isfinite(distance)
        distance = np.where(same, again, distance)
        return distance, np.where(same[:, None], closer, normal)


@public
@dataclass(frozen=True, eq=False)
class SectionShape(Shape):
    """A known section, such as the part's when it was cold: points on a curve in a plane.

    Attributes
    ----------
    points_mm : ndarray of shape (M, 3)
        World, in any order; joined by straight lines along the section.
    towards : tuple of three float
        To the outside.
    slide_mm, offset_mm : float
        By how much the section is shifted: along its length, and to the outside.
    """

    names: ClassVar = ("slide_mm", "offset_mm")

    points_mm: Array
    towards: tuple[float, float, float] = (0.0, 0.0, 1.0)
    slide_mm: float = 0.0
    offset_mm: float = 0.0

    def __post_init__(self) -> None:
        points = _points(self.points_mm)
        points = points[np.isfinite(points).all(axis=1)]
        if len(points) < 3:
            raise InputError(
                f"SectionShape: {len(points)} finite points; give a section of three or more"
            )
        object.__setattr__(self, "points_mm", points)

    def distance(self, points_mm: ArrayLike) -> Distances:
        """How far world points (N, 3) are from its lines, in its plane; NaN beside its ends."""
        middle = self.points_mm.mean(axis=0)
        along = np.linalg.svd(self.points_mm - middle, full_matrices=False)[2][0]
        up = np.asarray(self.towards) - (along @ self.towards) * along
        up /= np.linalg.norm(up)
        known = (self.points_mm - middle) @ np.stack([along, up], axis=1)
        known = known[np.argsort(known[:, 0], kind="stable")] + [self.slide_mm, self.offset_mm]
        x, y = ((_points(points_mm) - middle) @ np.stack([along, up], axis=1)).T
        k = np.clip(np.searchsorted(known[:, 0], np.nan_to_num(x)) - 1, 0, len(known) - 2)
        step = known[k + 1] - known[k]
        length = np.hypot(*step.T)
        inside = (x >= known[0, 0]) & (x <= known[-1, 0])
        tilt = np.where(inside, -step[:, 1] / length, np.nan)  # of the normal, along and up
        rise = np.where(inside, step[:, 0] / length, np.nan)
        distance = tilt * (x - known[k, 0]) + rise * (y - known[k, 1])
        normal = tilt[:, None] * along + rise[:, None] * up
        return Distances(distance, normal, {"slide_mm": -tilt, "offset_mm": -rise})


def _points(points_mm: ArrayLike) -> Array:
    points = points_of("distance: points_mm", points_mm)
    if points.ndim != 2 or points.shape[1] != 3:
        raise InputError(f"distance: points_mm has the shape {points.shape}; give (N, 3)")
    return points


def _local(pose: Pose | None, points_mm: ArrayLike) -> tuple[Array, Array]:
    """World points (N, 3) in a frame, and the frame's axes as columns."""
    points = _points(points_mm)
    return (pose.to_local(points), pose.rotation) if pose else (points, np.eye(3))


def _turn(*angles_deg: float) -> tuple[Array, list[Array]]:
    """The rotation (3, 3) about x, then y, then z, and its derivatives by each, per degree."""
    turns, rates = [], []
    for axis, angle in enumerate(np.radians(angles_deg)):
        i, j = [(1, 2), (2, 0), (0, 1)][axis]
        turn, rate = np.eye(3), np.zeros((3, 3))
        turn[[i, i, j, j], [i, j, i, j]] = (
            np.cos(angle),
            -np.sin(angle),
            np.sin(angle),
            np.cos(angle),
        )
        rate[[i, i, j, j], [i, j, i, j]] = (
            -np.sin(angle),
            -np.cos(angle),
            np.cos(angle),
            -np.sin(angle),
        )
        turns.append(turn)
        rates.append(np.radians(rate))
    x, y, z = turns
    by_x, by_y, by_z = rates
    return z @ y @ x, [z @ y @ by_x, z @ by_y @ x, by_z @ y @ x]
