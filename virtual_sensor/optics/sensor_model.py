"""The triangulation sensor where light runs straight: pinhole camera, laser sheet, poses.

Plain NumPy, after Beermann et al. 2018, section 3.3.  Frames: world (mm), camera (x along u, y
along v, z forward, right-handed) and laser (x across the sheet, y along the line, z forward).
Pixels are (u, v) with integers at pixel centres, as in OpenCV.
"""

from dataclasses import dataclass, field
from functools import reduce
from operator import or_
from typing import Any

import cv2
import numpy as np
from numpy.typing import ArrayLike, NDArray

from virtual_sensor.optics.ray_families import Pose

Array = NDArray[np.float64]

_FAINT = 1e-6  # light below this fraction of the peak is taken as none: 2.6 radii out
_REACH = float(np.sqrt(-np.log(_FAINT) / 2.0))  # the same in 1/e^2 radii

# Of undoing a distortion.
_MOST_STEPS = 30
_SMALL_PX, _SOLVED_PX = 1e-3, 1e-10
_REGULAR = 1e-6  # determinant from which on pixels next to each other see different things
_LOOKS = 33  # for a fold, between the middle of the image and a pixel
_NEAR = 2.0  # images: within so many, looks on a grid miss no fold


@dataclass(frozen=True)
class Camera:
    """The pinhole camera of equations 2 and 3, ideal unless it has a distortion.

    Attributes
    ----------
    matrix : ndarray of shape (3, 3)
        K = [[f/m_x, 0, c_x], [0, f/m_y, c_y], [0, 0, 1]] in px.
    pose : Pose
        Camera frame; its origin is the projection centre C_proj.
    size : tuple of int
        Width and height in px.
    distortion : ndarray of shape (0,), (4,), (5,), (8,), (12,) or (14,)
        OpenCV's coefficients k_1, k_2, p_1, p_2, k_3 ... s_4, tau_x, tau_y; the last two are the
        tilt of the sensor (Scheimpflug).  Empty: none, as in every scene that is rendered.
    fisheye : bool
        Whether the lens is OpenCV's fisheye (Kannala and Brandt's; ROS calls it equidistant), and
        `distortion` its k_1 ... k_4: r = theta (1 + k_1 theta^2 + ... + k_4 theta^8) for light at
        theta < 90 degrees to the axis.
    """

    matrix: Array
    pose: Pose
    size: tuple[int, int]
    distortion: Array = field(default_factory=lambda: np.zeros(0))
    fisheye: bool = False

    @property
    def distorts(self) -> bool:
        """Whether the camera is no ideal pinhole."""
        return self.fisheye or self.distortion.size > 0

    def project(self, points_mm: ArrayLike) -> Array:
        """Project world points (N, 3) straight onto the sensor: pixels (N, 2), equation 2.

        NaN for points behind the projection centre.
        """
        local = self.pose.to_local(points_mm)
        depth = np.where(local[..., 2:] > 0.0, local[..., 2:], np.nan)
        return self._distorted(local / depth)

    def _distorted(self, homogeneous: Array) -> Array:
        """Pixels (..., 2) of camera coordinates x/z, y/z, 1, shape (..., 3)."""
        if not self.distorts:
            return homogeneous @ self.matrix[:2].T
        known = np.nan_to_num(homogeneous.reshape(-1, 3))
        nowhere, K, d = np.zeros(3), self.matrix, self.distortion
        pixel = known[:, :2]
        if known.size and self.fisheye:
            pixel = cv2.fisheye.projectPoints(known[:, None], nowhere, nowhere, K, d)[0]
        elif known.size:
            pixel = cv2.projectPoints(known, nowhere, nowhere, K, d)[0]
        seen = np.isfinite(homogeneous).all(axis=-1, keepdims=True)
        return np.where(seen, pixel.reshape(*homogeneous.shape[:-1], 2), np.nan)

    def distort(self, pixel: ArrayLike) -> Array:
        """The pixels (..., 2) at which the camera sees what an ideal pinhole sees at `pixel`."""
        return self._distorted(self._homogeneous(np.asarray(pixel, float)))

    @np.errstate(over="ignore", invalid="ignore")  # beyond a fold polynomials may overflow
    def undistorted(self, pixel: ArrayLike) -> Array:
        """The pixels (..., 2) at which an ideal pinhole would see what pixels (..., 2) see.

        By Newton's method to 1e-9 px; NaN where it does not get there, or only beyond a fold of
        the image, where no lens sees: past its turning point a polynomial has other roots.
        """
        pixel = np.asarray(pixel, float)
        if not self.distorts:
            return pixel
        ideal = pixel.copy()
        for _ in range(_MOST_STEPS):
            here, (a, b, c, d), area = self._derivatives(ideal)
            x, y = np.moveaxis(pixel - here, -1, 0)
            area = np.where(np.abs(area) > _REGULAR, area, np.nan)
            step = np.stack([(d * x - b * y) / area, (a * y - c * x) / area], axis=-1)
            ideal = ideal + step
            if not np.any(np.abs(step) > _SOLVED_PX):
                break
        missed = np.abs(self.distort(ideal) - pixel).max(axis=-1)
        ideal = np.where((missed < 10.0 * _SOLVED_PX)[..., None], ideal, np.nan)
        return np.where(self._unfolded(ideal)[..., None], ideal, np.nan)

    def _derivatives(self, ideal: Array) -> tuple[Array, tuple[Array, ...], Array]:
        """Where ideal pixels (..., 2) are seen, du/du, du/dv, dv/du, dv/dv and the determinant."""
        here, along_u, along_v = (
            self.distort(ideal + shift) for shift in (0.0, [_SMALL_PX, 0.0], [0.0, _SMALL_PX])
        )
        (a, c), (b, d) = (
            np.moveaxis((moved - here) / _SMALL_PX, -1, 0) for moved in (along_u, along_v)
        )
        return here, (a, b, c, d), a * d - b * c

    def _unfolded(self, ideal: Array) -> NDArray[np.bool_]:
        """Which ideal pixels (..., 2) have no fold between them and the middle: shape (...)."""
        unfolded = np.asarray(np.isfinite(ideal).all(axis=-1))
        if not unfolded.any():
            return unfolded
        middle = self.matrix[:2, 2]
        some = np.vstack([ideal[unfolded], middle])
        sides = np.linspace(some.min(axis=0), some.max(axis=0), _LOOKS)
        around = np.stack(np.meshgrid(*sides.T), axis=-1)
        near = np.abs(some - middle).max() < _NEAR * max(self.size)
        if near and (self._derivatives(around)[2] > _REGULAR).all():  # as usual, and cheap
            return unfolded
        for share in np.linspace(0.0, 1.0, _LOOKS):
            area = self._derivatives(middle + share * (ideal - middle))[2]
            unfolded &= area > _REGULAR
        return unfolded

    def _homogeneous(self, pixel: Array) -> Array:
        """Camera coordinates x/z, y/z, 1, shape (..., 3), of an ideal pinhole's pixels."""
        ones = np.ones((*pixel.shape[:-1], 1))
        return np.concatenate([pixel, ones], axis=-1) @ np.linalg.inv(self.matrix).T

    def lines_of_sight(self, pixel: ArrayLike) -> Array:
        """Unit directions (N, 3) in the world of the straight lines of sight, equation 3.

        NaN where a distortion can't be undone.
        """
        local = self._homogeneous(self.undistorted(pixel))
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

    @property
    def reach_mm(self) -> float:
        """How far across the sheet, and round a dot, there is light that counts."""
        return _REACH * self.radius_mm

    def reaches(self, a: Any, b: Any, margin_mm: tuple[Any, Any] = (0.0, 0.0)) -> Any:
        """Mask of the coordinates in mm with light that counts, or near it; NaN has none.

        Of NumPy's arrays as of Dr.Jit's.
        """
        if self.dots_mm.size:
            reach = self.reach_mm + margin_mm[1]
            along = reduce(or_, (abs(b - float(y)) <= reach for y in self.dots_mm))
        else:
            along = abs(b) <= self.length_mm / 2.0 + margin_mm[1]
        return along & (abs(a) <= self.reach_mm + margin_mm[0])

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
    def target_mm(self) -> Array:
        """Middle of the reference plane (3,), world."""
        return self.pose.to_world([0.0, 0.0, self.distance_mm])

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
