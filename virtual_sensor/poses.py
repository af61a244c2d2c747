"""Where things stand in the world: rigid frames, of devices and of the medium.

Frames: world (mm), camera (x along u, y along v, z forward), laser (x across the sheet, y along the
line, z forward) and medium (that of its grid).
"""

from __future__ import annotations

from dataclasses import dataclass, replace
from typing import Self

import numpy as np
from numpy.typing import ArrayLike, NDArray

from virtual_sensor.arrays import number_within, numbers_of, points_of, vector_of
from virtual_sensor.calls import public
from virtual_sensor.display import Displayed, listed, place
from virtual_sensor.errors import InputError, short

Array = NDArray[np.float64]

_SQUARE = 1e-4  # float32's rounding, of some turns after one another


@public
@dataclass(frozen=True, eq=False)
class Pose(Displayed):
    """Where a frame stands in the world: ``world = rotation @ local + origin_mm``.

    Also a rigid motion, from places before to places after.

    Attributes
    ----------
    rotation : ndarray of shape (3, 3)
        Columns are the frame's x, y and z axes in world coordinates.
    origin_mm : ndarray of shape (3,)
    """

    rotation: Array
    origin_mm: Array

    def __post_init__(self) -> None:
        for name, shape in (("rotation", (3, 3)), ("origin_mm", (3,))):
            numbers = points_of(f"Pose: {name}", getattr(self, name))
            if numbers.shape != shape:
                raise InputError(f"Pose: {name} has the shape {numbers.shape}; give it {shape}")
            object.__setattr__(self, name, numbers)

    def _line(self) -> str:
        x, _, z = self.rotation.T
        return listed(f"at {place(self.origin_mm)} mm", f"x axis {place(x)}", f"z axis {place(z)}")

    def __eq__(self, other: object) -> bool:
        return isinstance(other, Pose) and all(
            np.array_equal(one, two)
            for one, two in zip(vars(self).values(), vars(other).values(), strict=True)
        )

    def __hash__(self) -> int:
        return hash((np.shape(self.rotation), float(np.sum(self.origin_mm))))

    @staticmethod
    def from_matrix(to_world: ArrayLike) -> Pose:
        """Pose of a matrix (4, 4) in float32: with the nearest rotation, whose inverse is exact."""
        matrix = numbers_of("Pose.from_matrix: to_world", to_world)
        if matrix.shape != (4, 4) or not np.isfinite(matrix).all():
            raise InputError(
                f"Pose.from_matrix: to_world is {short(to_world)}; give finite numbers (4, 4)"
            )
        u, _, vt = np.linalg.svd(matrix[:3, :3])
        return Pose(u @ vt, matrix[:3, 3])

    @staticmethod
    def shift(by_mm: ArrayLike) -> Pose:
        """The motion by (x, y, z), mm, that turns nothing.

        Raises
        ------
        InputError
            If it is not three finite numbers.
        """
        return Pose(np.eye(3), vector_of("a motion's by_mm", by_mm))

    @staticmethod
    def turn(angle_deg: float, axis: ArrayLike, about_mm: ArrayLike = (0.0, 0.0, 0.0)) -> Pose:
        """The motion that turns by an angle about an axis through a point, by the right-hand rule.

        Parameters
        ----------
        angle_deg : float
        axis : array_like of shape (3,)
            Its direction, of any length: (0, 0, 1) is the world's z.
        about_mm : array_like of shape (3,)
            A point on it.

        Raises
        ------
        InputError
            If a number is not finite, or the axis has no length.
        """
        angle_deg = number_within("Pose.turn: angle_deg", angle_deg, -1e9, 1e9, "a finite angle")
        direction, point = (
            vector_of("a motion's axis", axis),
            vector_of("a motion's about_mm", about_mm),
        )
        length, angle = np.linalg.norm(direction), np.radians(angle_deg)
        if not length > 0.0:
            raise InputError("Pose.turn: axis has no length; give one that is not zero")
        x, y, z = direction / length  # Rodrigues' formula
        cross = np.array([[0.0, -z, y], [z, 0.0, -x], [-y, x, 0.0]])
        rotation = np.eye(3) + np.sin(angle) * cross + (1.0 - np.cos(angle)) * cross @ cross
        return Pose(rotation, point - rotation @ point)

    def to_world(self, points_mm: ArrayLike) -> Array:
        """Local points (N, 3) in world coordinates (inverse of equation 4)."""
        return _rows(points_mm) @ self.rotation.T + self.origin_mm

    def to_local(self, points_mm: ArrayLike) -> Array:
        """World points (N, 3) in this frame (equation 4)."""
        return (_rows(points_mm) - self.origin_mm) @ self.rotation

    def axes_angle_deg(self, other: Pose) -> float:
        """Angle between the z axes of this frame and another: of devices, between their views."""
        cosine = self.rotation[:, 2] @ other.rotation[:, 2]
        return float(np.degrees(np.arccos(np.clip(cosine, -1.0, 1.0))))

    def moved(self, motion: Pose) -> Pose:
        """The frame after a rigid motion of the world's points."""
        return Pose(motion.rotation @ self.rotation, motion.to_world(self.origin_mm))


def _rows(points_mm: ArrayLike) -> Array:
    """Points (..., 3) as an array."""
    points = points_of("points_mm", points_mm)
    if points.shape[-1:] != (3,):
        raise InputError(f"points_mm has the shape {points.shape}; give it (N, 3), or (3,)")
    return points


def keeps_lengths(turn: Array, tolerance: float = _SQUARE) -> bool:
    """Whether a matrix (3, 3) only turns and mirrors, but for rounding."""
    return bool(np.abs(turn.T @ turn - np.eye(3)).max() <= tolerance)


class Movable(Displayed):
    """Something in a frame of its own, in which it never changes; a frozen dataclass.

    Attributes
    ----------
    pose : Pose or None
        Of its frame; None: the world's.
    """

    pose: Pose | None

    def moved(self, motion: Pose) -> Self:
        """The same after a rigid motion, which may follow others.

        Raises
        ------
        InputError
            If the motion is none: no rotation, or not finite.
        """
        if not isinstance(motion, Pose):
            raise InputError(f"moved: motion is {short(motion)}; give a Pose, such as Pose.shift")
        turn, shift = motion.rotation, motion.origin_mm
        if not np.isfinite(shift).all():
            raise InputError("moved: the motion's origin_mm is not finite; give finite numbers")
        if not (keeps_lengths(turn, 1e-9) and np.linalg.det(turn) > 0.0):
            raise InputError(
                "the motion's rotation does more than turn; give an orthogonal matrix of"
                " determinant 1"
            )
        return replace(self, pose=self.pose.moved(motion) if self.pose else motion)  # type: ignore[type-var]

    def to_local(self, points_mm: ArrayLike) -> Array:
        """World points (N, 3) in its frame, mm."""
        points = np.asarray(points_mm, float)
        return self.pose.to_local(points) if self.pose else points

    def to_world(self, points_mm: ArrayLike) -> Array:
        """Points (N, 3) of its frame in the world's, mm."""
        points = np.asarray(points_mm, float)
        return self.pose.to_world(points) if self.pose else points

    def axes(self) -> Array:
        """Unit vectors of its frame's axes, world, as columns: (3, 3)."""
        return self.pose.rotation if self.pose else np.eye(3)
