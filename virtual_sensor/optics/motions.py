"""How laser rays and lines of sight start, and how that changes when camera or laser move."""

from dataclasses import dataclass

import numpy as np
from numpy.typing import ArrayLike, NDArray

from virtual_sensor.optics.sensor_model import Camera, LaserLine

Array = NDArray[np.float64]

_BODIES = {"camera": ("camera",), "laser": ("laser",), "sensor": ("camera", "laser")}


@dataclass(frozen=True)
class Motion:
    """Rate at which parts of the sensor move, rigidly, with a parameter.

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

    def of(self, starts: Array, directions: Array) -> tuple[Array, Array]:
        """Derivatives (N, 3) of rays' starts (mm) and directions, all that belong to a part."""
        moved = self.shift_mm + np.cross(self.turn_rad, starts - self.pivot_mm)
        return moved, np.cross(self.turn_rad, directions)


def motions(pivot_mm: ArrayLike = (0.0, 0.0, 0.0)) -> dict[str, Motion]:
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
class Starts:
    """Rays as they start, and how they change with the coordinates that name them.

    Attributes
    ----------
    start, direction : ndarray of shape (N, 3)
        In mm, and unit vectors, world.
    by_coordinate : tuple of (ndarray of shape (N, 3), ndarray of shape (N, 3))
        Derivatives of both: by u and v in px, or by b in mm.
    """

    start: Array
    direction: Array
    by_coordinate: tuple[tuple[Array, Array], ...]

    @staticmethod
    def of_pixels(camera: Camera, pixel: Array) -> "Starts":
        """Lines of sight, by u and v."""
        pixel = np.nan_to_num(pixel)
        direction = camera.lines_of_sight(pixel)
        start = np.broadcast_to(camera.pose.origin_mm, direction.shape)
        inverse = np.linalg.inv(camera.matrix)
        homogeneous = np.column_stack([pixel, np.ones(len(pixel))]) @ inverse.T
        turns = (camera.pose.rotation @ inverse[:, i] for i in (0, 1))
        stays = np.zeros_like(direction)
        by = tuple((stays, _unit_changes(direction, homogeneous, turn)) for turn in turns)
        return Starts(start, direction, by)

    @staticmethod
    def of_laser(laser: LaserLine, b: Array) -> "Starts":
        """Laser rays in the middle of the sheet, by b."""
        start, direction = laser.rays(0.0, b)
        g, (_, along, _) = laser.fan_per_mm, laser.pose.rotation.T
        local = np.column_stack([0.0 * b, g * b, np.ones_like(b)])
        shift = np.broadcast_to(along * (1.0 - g * laser.distance_mm), start.shape)
        return Starts(start, direction, ((shift, _unit_changes(direction, local, g * along)),))


def _unit_changes(direction: Array, long: Array, change: Array) -> Array:
    """Derivatives of unit directions (N, 3), from those of the vectors that were scaled."""
    change = change / np.linalg.norm(long, axis=1, keepdims=True)
    return change - direction * np.einsum("ij,ij->i", change, direction)[:, None]
