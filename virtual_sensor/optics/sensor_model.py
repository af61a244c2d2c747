"""The triangulation sensor where light runs straight: pinhole camera, laser sheet, poses.

Plain NumPy, after Beermann et al. 2018, section 3.3.  Frames: world (mm), camera (x along u, y
along v, z forward, right-handed) and laser (x across the sheet, y along the line, z forward).
Pixels are (u, v) with integers at pixel centres, as in OpenCV.
"""

from dataclasses import dataclass

import numpy as np
from numpy.typing import ArrayLike, NDArray

Array = NDArray[np.float64]


@dataclass(frozen=True)
class Pose:
    """Where a frame stands in the world: ``world = rotation @ local + origin_mm``.

    Attributes
    ----------
    rotation : ndarray of shape (3, 3)
        Columns are the frame's x, y and z axes in world coordinates.
    origin_mm : ndarray of shape (3,)
    """

    rotation: Array
    origin_mm: Array

    @staticmethod
    def from_matrix(to_world: ArrayLike) -> "Pose":
        """Pose of a matrix (4, 4) in float32: with the nearest rotation, whose inverse is exact."""
        matrix = np.asarray(to_world, float)
        u, _, vt = np.linalg.svd(matrix[:3, :3])
        return Pose(u @ vt, matrix[:3, 3])

    def to_world(self, points_mm: ArrayLike) -> Array:
        """Local points (N, 3) in world coordinates (inverse of equation 4)."""
        return np.asarray(points_mm, float) @ self.rotation.T + self.origin_mm

    def to_local(self, points_mm: ArrayLike) -> Array:
        """World points (N, 3) in this frame (equation 4)."""
        return (np.asarray(points_mm, float) - self.origin_mm) @ self.rotation


@dataclass(frozen=True)
class Camera:
    """The ideal pinhole camera of equations 2 and 3.

    Attributes
    ----------
    matrix : ndarray of shape (3, 3)
        K = [[f/m_x, 0, c_x], [0, f/m_y, c_y], [0, 0, 1]] in px.
    pose : Pose
        Camera frame; its origin is the projection centre C_proj.
    size : tuple of int
        Width and height in px.
    """

    matrix: Array
    pose: Pose
    size: tuple[int, int]

    def project(self, points_mm: ArrayLike) -> Array:
        """Project world points (N, 3) straight onto the sensor: pixels (N, 2), equation 2.

        NaN for points behind the projection centre.
        """
        local = self.pose.to_local(points_mm)
        depth = np.where(local[..., 2:] > 0.0, local[..., 2:], np.nan)
        return (local / depth) @ self.matrix[:2].T

    def lines_of_sight(self, pixel: ArrayLike) -> Array:
        """Unit directions (N, 3) in the world of the straight lines of sight, equation 3."""
        pixel = np.asarray(pixel, float)
        homogeneous = np.concatenate([pixel, np.ones((*pixel.shape[:-1], 1))], axis=-1)
        local = homogeneous @ np.linalg.inv(self.matrix).T
        direction = local @ self.pose.rotation.T
        return direction / np.linalg.norm(direction, axis=-1, keepdims=True)

    def inside(self, pixel: ArrayLike) -> NDArray[np.bool_]:
        """Which pixels (N, 2) lie on the sensor: shape (N,); NaN does not."""
        pixel = np.asarray(pixel, float)
        return np.all((pixel >= -0.5) & (pixel <= np.array(self.size) - 0.5), axis=-1)


@dataclass(frozen=True)
class LaserLine:
    """A laser line generator whose sheet is thin and whose intensity across is Gaussian.

    A laser ray is named by its coordinates (a, b) in mm, across the sheet and along the line, where
    it would cross the reference plane if light ran straight.  The reference plane is square to the
    axis at `distance_mm`.

    Attributes
    ----------
    pose : Pose
        Laser frame; its origin is the middle of the generator's exit.
    distance_mm : float
        From the exit to the reference plane.
    length_mm : float
        Length of the line in the reference plane.
    radius_mm : float
        Distance across the sheet at which the intensity falls to 1/e^2.
    power_w : float
    fan_deg : float
        Full fan angle in the laser plane; 0 is telecentric.
    dots_mm : ndarray of shape (M,)
        Where the light is a row of round Gaussian beams: their b; empty for a line.
    """

    pose: Pose
    distance_mm: float
    length_mm: float
    radius_mm: float
    power_w: float
    fan_deg: float
    dots_mm: Array

    @property
    def fan_per_mm(self) -> float:
        """Growth of the line per mm of depth, relative to the reference plane: 1/mm."""
        return float(2.0 * np.tan(np.radians(self.fan_deg) / 2.0) / self.length_mm)

    def rays(self, a_mm: ArrayLike, b_mm: ArrayLike) -> tuple[Array, Array]:
        """Origins (N, 3) on the exit and unit directions (N, 3) of laser rays, in the world."""
        a, b = np.broadcast_arrays(np.asarray(a_mm, float), np.asarray(b_mm, float))
        g = self.fan_per_mm
        start = np.stack([a, b * (1.0 - g * self.distance_mm), np.zeros_like(a)], axis=-1)
        local = np.stack([np.zeros_like(a), g * b, np.ones_like(a)], axis=-1)
        direction = local @ self.pose.rotation.T
        unit = direction / np.linalg.norm(direction, axis=-1, keepdims=True)
        return self.pose.to_world(start), unit

    @property
    def plane(self) -> tuple[Array, float]:
        """Unit normal (3,) and offset of the laser plane E in Hessian form: normal . x = offset."""
        normal = self.pose.rotation[:, 0]
        return normal, float(normal @ self.pose.origin_mm)


@dataclass(frozen=True)
class SensorModel:
    """A camera and a laser line generator in one world: all that triangulation needs."""

    camera: Camera
    laser: LaserLine

    @property
    def triangulation_angle_deg(self) -> float:
        """Angle between the camera's axis and the laser's: the paper's alpha."""
        cosine = self.camera.pose.rotation[:, 2] @ self.laser.pose.rotation[:, 2]
        return float(np.degrees(np.arccos(np.clip(cosine, -1.0, 1.0))))
