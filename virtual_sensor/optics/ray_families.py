"""Ray families: the straight rays of a device, each named by two coordinates (s, t).

In a family's frame (x, y, z; z forward, along the light or the sight; right-handed) the depth is z,
and a ray is ``foot(s, t) + depth * slope(s, t)`` in x and y.  A family writes these two, their
inverse and their derivatives once, in +, -, * and / alone, so that the same lines serve NumPy's
arrays and Dr.Jit's (`family_frames`); all else follows from them.

Frames: world (mm), camera (x along u, y along v) and laser (x across the sheet, y along the line).
Pixels are (u, v) with integers at pixel centres, as in OpenCV.
"""

from abc import ABC, abstractmethod
from dataclasses import dataclass, field, replace
from functools import lru_cache
from typing import Any, Self

import cv2
import numpy as np
from numpy.typing import ArrayLike, NDArray

from virtual_sensor.display import Displayed, listed
from virtual_sensor.errors import InputError
from virtual_sensor.poses import Pose

Array = NDArray[np.float64]

_FAR_MM = 1024.0  # a ray is linear in the depth: its slope's derivatives come from so far apart
_PLANAR = 1e-9  # rays of one coordinate lie in a plane if they leave it by no more, rad

# Of undoing a distortion.
_MOST_STEPS = 30
_SMALL_PX, _SOLVED_PX = 1e-3, 1e-10
_REGULAR = 1e-6  # determinant from which on pixels next to each other see different things
_SAMPLES = 33  # for a fold, between the middle of the image and a pixel
_SPARE = 0.01  # of an image's extent: its border is known at samples
_CACHED = 64
_NEAR = 2.0  # images: within so many, samples on a grid miss no fold


class RayFamily(Displayed, ABC):
    """Straight rays named by two coordinates; subclasses are frozen dataclasses.

    Their fields of type float are parameters that Dr.Jit's kernels are compiled without.

    Attributes
    ----------
    pose : Pose
        The family's frame; rays start at depth 0.
    """

    pose: Pose

    # What a family writes: of NumPy's arrays as of Dr.Jit's.

    @abstractmethod
    def foot(self, s: Any, t: Any) -> tuple[Any, Any]:
        """Where rays are at depth 0: x and y in mm."""

    @abstractmethod
    def slope(self, s: Any, t: Any) -> tuple[Any, Any]:
        """dx/dz and dy/dz of rays."""

    @abstractmethod
    def straight(self, x: Any, y: Any, depth: Any) -> tuple[Any, Any]:
        """Coordinates (s, t) of the rays through points of the frame, mm."""

    @abstractmethod
    def by_coordinates(self, s: Any, t: Any, depth: Any) -> tuple[Any, Any, Any, Any]:
        """dx/ds, dx/dt, dy/ds, dy/dt at a depth; linear in it."""

    # What follows: likewise.

    def place(self, s: Any, t: Any, depth: Any) -> tuple[Any, Any]:
        """Where rays are at a depth: x and y in mm."""
        (x, y), (along_x, along_y) = self.foot(s, t), self.slope(s, t)
        return x + depth * along_x, y + depth * along_y

    def spread(self, s: Any, t: Any, depth: Any) -> Any:
        """Area square to z, in mm^2, of a tube of rays per unit of both coordinates."""
        x_s, x_t, y_s, y_t = self.by_coordinates(s, t, depth)
        return x_s * y_t - x_t * y_s

    def starts_by_coordinates(self, s: Any, t: Any) -> tuple[tuple[Any, ...], tuple[Any, ...]]:
        """Derivatives of foot and slope: dx/ds, dx/dt, dy/ds, dy/dt of either."""
        near, far = (self.by_coordinates(s, t, depth) for depth in (0.0, _FAR_MM))
        return near, tuple((b - a) * (1.0 / _FAR_MM) for a, b in zip(near, far, strict=True))

    def with_pose(self, pose: Pose) -> Self:
        """The same rays from another place."""
        return replace(self, pose=pose)  # type: ignore[type-var]

    # Of NumPy's arrays alone.

    def rays(self, s: ArrayLike, t: ArrayLike) -> tuple[Array, Array]:
        """Origins and unit directions (N, 3), world, of rays of coordinates (N,)."""
        s, t = np.broadcast_arrays(np.asarray(s, float), np.asarray(t, float))
        direction = _columns(*self.slope(s, t), 1.0, s)
        direction = direction / np.abs(direction).max(axis=-1, keepdims=True)  # however steep
        unit = direction / np.linalg.norm(direction, axis=-1, keepdims=True) @ self.pose.rotation.T
        return self.pose.to_world(_columns(*self.foot(s, t), 0.0, s)), unit

    def coordinates(self, points_mm: ArrayLike) -> Array:
        """(s, t, depth) of the straight rays through world points (N, 3): shape (N, 3)."""
        with np.errstate(all="ignore"):  # no ray goes there, or none is known
            x, y, depth = np.moveaxis(self.pose.to_local(points_mm), -1, 0)
            return _columns(*self.straight(x, y, depth), depth, depth)

    def origins(self, points_mm: ArrayLike) -> Array:
        """Where the straight rays through world points (N, 3) start: world, (N, 3)."""
        s, t, _ = np.moveaxis(self.coordinates(points_mm), -1, 0)
        return self.rays(s, t)[0]

    def plane(self, s: ArrayLike) -> tuple[Array, Array]:
        """The plane of all rays with a first coordinate s, in Hessian form: normal . x = offset.

        Parameters
        ----------
        s : array_like of shape (...)

        Returns
        -------
        normal : ndarray of shape (..., 3)
            Unit vectors, world.
        offset : ndarray of shape (...)
            mm.

        Raises
        ------
        InputError
            If rays of one s don't lie in a plane.
        """
        s = np.asarray(s, float)
        origin, direction = self.rays(s, 0.0)
        by = self.by_coordinates(s, np.zeros_like(s), _FAR_MM)
        beside = _columns(by[1], by[3], 0.0, s) @ self.pose.rotation.T
        normal = np.cross(beside, direction)
        normal /= np.linalg.norm(normal, axis=-1, keepdims=True)
        offset = np.sum(normal * origin, axis=-1)
        for t in (-1.0, 1.0):
            other, heading = self.rays(s, t)
            off_mm = np.abs(np.sum(normal * other, axis=-1) - offset)
            off_rad = np.abs(np.sum(normal * heading, axis=-1))
            if np.any((off_mm > _PLANAR * _FAR_MM) | (off_rad > _PLANAR)):
                raise InputError(
                    f"rays of a {type(self).__name__} with one first coordinate lie in no plane;"
                    " triangulate with its rays, not with its planes"
                )
        return normal, offset


def _columns(x: Any, y: Any, z: Any, like: Array) -> Array:
    """Numbers of the shape (...), or that broadcast to it, as rows (..., 3)."""
    return np.stack([np.broadcast_to(v, like.shape) for v in (x, y, z)], axis=-1)


@dataclass(frozen=True)
class PixelFamily(RayFamily):
    """Rays of a device with pixels: a camera's lines of sight, or the light of a projector.

    The matrix and the distortion give the pixel that has a ray's coordinates.

    Attributes
    ----------
    matrix : ndarray of shape (3, 3)
        K, from coordinates (s, t, 1) to pixels of an ideal lens.
    pose : Pose
    size : tuple of int
        Width and height in px.
    distortion : ndarray of shape (0,), (4,), (5,), (8,), (12,) or (14,)
        OpenCV's coefficients.  Empty: none.
    fisheye : bool
        Whether the lens is OpenCV's fisheye.
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

    @property
    def ideal_matrix(self) -> Array:
        """From coordinates (s, t, 1) to the pixels of an ideal lens, (3, 3): K."""
        return self.matrix

    def pixels(self, p: ArrayLike, q: ArrayLike) -> Array:
        """The pixels (..., 2) that see rays of coordinates (...); NaN of NaN.

        NaN too where a distortion folds rays from beyond the image back into it: no lens does.
        """
        homogeneous = _columns(p, q, 1.0, np.asarray(p, float))
        seen = self._distorted(homogeneous)
        if not self.distorts:
            return seen
        low, high = self._extent
        beyond = ((homogeneous[..., :2] < low) | (homogeneous[..., :2] > high)).any(axis=-1)
        return np.where((beyond & self.inside(seen))[..., None], np.nan, seen)

    def of_pixels(self, pixel: ArrayLike) -> tuple[Array, Array]:
        """Coordinates p and q (...) of what pixels (..., 2) see.

        NaN where a distortion can't be undone.
        """
        pixel = np.asarray(pixel, float)
        pixel = np.where(np.isfinite(pixel), pixel, np.nan)
        homogeneous = self._homogeneous(self.undistorted(pixel))
        return homogeneous[..., 0], homogeneous[..., 1]

    def pixel_slopes(self, p: ArrayLike, q: ArrayLike) -> Array:
        """d(u, v)/d(p, q) of rays' pixels (...): shape (..., 2, 2)."""
        ideal = _columns(p, q, 1.0, np.asarray(p, float)) @ self.matrix[:2].T
        by_pq = np.broadcast_to(self.matrix[:2, :2], (*ideal.shape, 2))
        if not self.distorts:
            return by_pq
        _, by_ideal, _ = self._derivatives(ideal)
        return np.stack(by_ideal, axis=-1).reshape(by_pq.shape) @ by_pq

    def project(self, points_mm: ArrayLike) -> Array:
        """Project world points (N, 3) straight onto the sensor: pixels (N, 2), equation 2.

        NaN for points behind the projection centre.
        """
        p, q, depth = np.moveaxis(self.coordinates(points_mm), -1, 0)
        return self.pixels(np.where(depth > 0.0, p, np.nan), q)

    def lines_of_sight(self, pixel: ArrayLike) -> Array:
        """Unit directions (N, 3) in the world of the straight lines of sight, equation 3.

        NaN where a distortion can't be undone.
        """
        return self.rays(*self.of_pixels(pixel))[1]

    def inside(self, pixel: ArrayLike) -> NDArray[np.bool_]:
        """Which pixels (N, 2) lie on the sensor: shape (N,); NaN does not."""
        pixel = np.asarray(pixel, float)
        return np.all((pixel >= -0.5) & (pixel <= np.array(self.size) - 0.5), axis=-1)

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

    @property
    def _extent(self) -> tuple[Array, Array]:
        """Lowest and highest coordinates that the image sees, (2,) each, and a little more."""
        numbers = (tuple(each.ravel().tolist()) for each in (self.matrix, self.distortion))
        return _extent_of(*numbers, tuple(self.size), self.fisheye)

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
        sides = np.linspace(some.min(axis=0), some.max(axis=0), _SAMPLES)
        around = np.stack(np.meshgrid(*sides.T), axis=-1)
        near = np.abs(some - middle).max() < _NEAR * max(self.size)
        if near and (self._derivatives(around)[2] > _REGULAR).all():  # as usual, and cheap
            return unfolded
        for share in np.linspace(0.0, 1.0, _SAMPLES):
            area = self._derivatives(middle + share * (ideal - middle))[2]
            unfolded &= area > _REGULAR
        return unfolded

    def _homogeneous(self, pixel: Array) -> Array:
        """Camera coordinates x/z, y/z, 1, shape (..., 3), of an ideal pinhole's pixels."""
        ones = np.ones((*pixel.shape[:-1], 1))
        return np.concatenate([pixel, ones], axis=-1) @ np.linalg.inv(self.matrix).T


@dataclass(frozen=True)
class Sheet(RayFamily):
    """A plane of laser light with its thickness: telecentric, or fanned in the plane.

    s = a across the sheet and t = b along the line, in mm, are where a ray crosses the reference
    plane, which is square to z at `distance_mm`.

    Attributes
    ----------
    pose : Pose
        Its origin is the middle of the generator's exit, where rays start.
    distance_mm : float
        From the exit to the reference plane.
    fan_per_mm : float
        Growth of the line per mm of depth, relative to the reference plane: 1/mm; 0 is telecentric.
    """

    pose: Pose
    distance_mm: float
    fan_per_mm: float = 0.0

    def _line(self) -> str:
        fan = f"fanned by {self.fan_per_mm:g}/mm" if self.fan_per_mm else "telecentric"
        return listed(fan, self.pose._line(), f"{self.distance_mm:g} mm to its reference plane")

    def foot(self, s: Any, t: Any) -> tuple[Any, Any]:
        """On the exit, which fanned rays leave closer together."""
        return s, t * (1.0 - self.fan_per_mm * self.distance_mm)

    def slope(self, s: Any, t: Any) -> tuple[Any, Any]:
        """Fanned along the line alone."""
        return 0.0 * s, self.fan_per_mm * t

    def straight(self, x: Any, y: Any, depth: Any) -> tuple[Any, Any]:
        """(a, b) of points of the frame."""
        return x, y / (1.0 + self.fan_per_mm * (depth - self.distance_mm))

    def by_coordinates(self, s: Any, t: Any, depth: Any) -> tuple[Any, Any, Any, Any]:
        """Across and along don't mix."""
        return 1.0, 0.0, 0.0, 1.0 + self.fan_per_mm * (depth - self.distance_mm)


@dataclass(frozen=True)
class Pinhole(PixelFamily):
    """Rays through one point: a camera's lines of sight, or the light of a projector.

    s = p and t = q are x/z and y/z of an ideal pinhole; the matrix and the distortion give the
    pixel that has them (equations 2 and 3 of Beermann et al. 2018, where there is no distortion).

    Attributes
    ----------
    matrix : ndarray of shape (3, 3)
        K = [[f/m_x, 0, c_x], [0, f/m_y, c_y], [0, 0, 1]] in px.
    pose : Pose
        Its origin is the projection centre C_proj.
    size : tuple of int
        Width and height in px.
    distortion : ndarray of shape (0,), (4,), (5,), (8,), (12,) or (14,)
        OpenCV's coefficients k_1, k_2, p_1, p_2, k_3 ... s_4, tau_x, tau_y; the last two are the
        tilt of the sensor (Scheimpflug).  Empty: none.
    fisheye : bool
        Whether the lens is OpenCV's fisheye (Kannala and Brandt's; ROS calls it equidistant), and
        `distortion` its k_1 ... k_4: r = theta (1 + k_1 theta^2 + ... + k_4 theta^8) for light at
        theta < 90 degrees to the axis.
    """

    def _line(self) -> str:
        width, height = self.size
        focal = f"f {abs(self.matrix[0, 0]):.5g} px"
        lens = "fisheye" if self.fisheye else "distorts" if self.distorts else ""
        return listed(f"{width} x {height} px", focal, lens, self.pose._line())

    def foot(self, s: Any, t: Any) -> tuple[Any, Any]:
        """All in the projection centre."""
        return 0.0 * s, 0.0 * t

    def slope(self, s: Any, t: Any) -> tuple[Any, Any]:
        """(p, q) themselves."""
        return s, t

    def straight(self, x: Any, y: Any, depth: Any) -> tuple[Any, Any]:
        """(p, q) of points of the frame."""
        return x / depth, y / depth

    def by_coordinates(self, s: Any, t: Any, depth: Any) -> tuple[Any, Any, Any, Any]:
        """Rays spread with their depth."""
        return depth, 0.0, 0.0, depth

    def pixel_mm(self, points_mm: ArrayLike) -> Array:
        """Size (N,) of a pixel along u at the depths of world points (N, 3), mm per px."""
        return self.pose.to_local(points_mm)[..., 2] / abs(self.matrix[0, 0])


@lru_cache(maxsize=_CACHED)  # a camera that moves keeps it
def _extent_of(
    matrix: tuple[float, ...], distortion: tuple[float, ...], size: tuple[int, int], fisheye: bool
) -> tuple[Array, Array]:
    """Of a camera's image, by its border; infinite where the image itself is folded there."""
    K, nowhere = np.array(matrix).reshape(3, 3), Pose(np.eye(3), np.zeros(3))
    camera = Pinhole(K, nowhere, size, np.array(distortion), fisheye)
    u, v = (np.linspace(-0.5, n - 0.5, _SAMPLES) for n in size)
    sides = [(u, v[0]), (u, v[-1]), (u[0], v), (u[-1], v)]
    border = [np.stack(np.broadcast_arrays(*side), axis=-1) for side in sides]
    places = np.stack(camera.of_pixels(np.concatenate(border)), axis=-1)
    if not np.isfinite(places).all():
        return np.full(2, -np.inf), np.full(2, np.inf)
    low, high = places.min(axis=0), places.max(axis=0)
    spare = _SPARE * (high - low)
    return low - spare, high + spare


@dataclass(frozen=True)
class Telecentric(PixelFamily):
    """Parallel rays: of a telecentric lens, whose pixels are of one size at any depth.

    s and t are x and y in mm, square to z.

    Attributes
    ----------
    matrix : ndarray of shape (3, 3)
        K = [[1/m_x, 0, c_x], [0, 1/m_y, c_y], [0, 0, 1]] with m a pixel's size on the part, mm.
    pose : Pose
        Its origin is the middle of the lens, where rays start.
    size : tuple of int
        Width and height in px.
    distortion, fisheye
        As a `Pinhole`'s, in terms of s and t in mm.
    """

    def _line(self) -> str:
        width, height = self.size
        pixel = f"telecentric, {1e3 / abs(self.matrix[0, 0]):.5g} um per px"
        return listed(f"{width} x {height} px", pixel, self.pose._line())

    def foot(self, s: Any, t: Any) -> tuple[Any, Any]:
        """Side by side."""
        return s, t

    def slope(self, s: Any, t: Any) -> tuple[Any, Any]:
        """All along the axis."""
        return 0.0 * s, 0.0 * t

    def straight(self, x: Any, y: Any, depth: Any) -> tuple[Any, Any]:
        """They are x and y."""
        return x, y

    def by_coordinates(self, s: Any, t: Any, depth: Any) -> tuple[Any, Any, Any, Any]:
        """The same at any depth."""
        return 1.0 + 0.0 * depth, 0.0, 0.0, 1.0 + 0.0 * depth

    def pixel_mm(self, points_mm: ArrayLike) -> Array:
        """Size (N,) of a pixel along u, the same at all world points (N, 3), mm per px."""
        depth = self.pose.to_local(points_mm)[..., 2]
        return np.full_like(depth, 1.0 / abs(self.matrix[0, 0]))
