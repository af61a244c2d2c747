"""A thin lens before a sensor that may be tilted, and its pupil: each point of it is a pinhole.

The lens lies in the plane z = 0 of the camera's frame, centred in the projection centre.  Rays
through the centre are the chief rays, those of the pinhole; the sensor is at the image distance b
behind it, along the axis, and sees sharply what is at the distance g before it: 1/F = 1/b + 1/g.

Where the sensor is tilted by tau_x and tau_y, as OpenCV's last two coefficients say, the reciprocal
of its distance along a chief ray (p, q) is linear in (p, q).  So is that of the distance in focus,

    1/g(p, q) = 1/g - w . (p, q),  w = (tan tau_y / cos tau_x, -tan tau_x) / b,

which is a plane of object points: Scheimpflug's rule.  The ray that leaves the point A = (ax, ay)
of the pupil towards what the chief ray (p, q) has in focus has the slope (p, q) - A/g(p, q): affine
in (p, q).  So all pixels, seen from one point of the pupil, are a pinhole's with another matrix.

The rays within the lens are those of Gauss: no aberrations but the distortion that the camera has;
its chief rays are distorted, their distance in focus is that of the undistorted ones.
"""

from __future__ import annotations

from dataclasses import dataclass, field, replace
from itertools import pairwise
from typing import Any, Self

import numpy as np
from numpy.typing import ArrayLike, NDArray

from virtual_sensor.arrays import number_within, numbers_of, whole_number
from virtual_sensor.calls import public
from virtual_sensor.display import Displayed, listed
from virtual_sensor.errors import InputError, short
from virtual_sensor.optics.ray_families import Pinhole
from virtual_sensor.poses import Pose

Array = NDArray[np.float64]

MOST_POINTS = 4096
"""Of a pupil."""

USUAL_SUB_PUPILS = 16
"""Points of the pupil that a frame is rendered through, unless others are asked for."""

F_NUMBERS = 0.5, 1e4
"""Of lenses; none in air is faster, since the sine of its cone's half angle is 1/(2 N)."""

_LEAST_MM, _MOST_MM = 1e-6, 1e6
_STEEPEST_DEG = 80.0
_LEAST_OF_TWO = 6  # points that make two rings: in one of three all directions count alike
_TURNS = 0.1, 0.18  # of a ring's points, in units of their distance


@public
@dataclass(frozen=True)
class Lens(Displayed):
    """A thin lens, its pupil and the sensor behind it.

    Attributes
    ----------
    image_distance_mm : float
        b, from the lens to the sensor along the axis.
    focus_distance_mm : float
        g, from the lens to what is in focus, along the axis.
    pupil_radius_mm : float
        0: a pinhole.
    sensor_tilt_deg : tuple of two float
        OpenCV's tau_x and tau_y: about the camera's x axis, then about its y axis.

    Raises
    ------
    InputError
        If a number is none that a lens has.
    """

    image_distance_mm: float
    focus_distance_mm: float
    pupil_radius_mm: float
    sensor_tilt_deg: tuple[float, float] = (0.0, 0.0)

    def __post_init__(self) -> None:
        for name, least in (
            ("image_distance_mm", _LEAST_MM),
            ("focus_distance_mm", _LEAST_MM),
            ("pupil_radius_mm", 0.0),
        ):
            advice = "a length in mm" if least else "a length in mm, 0 for a pinhole"
            value = number_within(f"Lens: {name}", getattr(self, name), least, _MOST_MM, advice)
            object.__setattr__(self, name, value)
        tilt = numbers_of("Lens: sensor_tilt_deg", self.sensor_tilt_deg)
        if tilt.shape != (2,) or not np.all(np.abs(tilt) <= _STEEPEST_DEG):
            raise InputError(
                f"Lens: sensor_tilt_deg is {short(self.sensor_tilt_deg)}; give two angles, about x"
                f" and about y, of at most {_STEEPEST_DEG:g} degrees"
            )
        object.__setattr__(self, "sensor_tilt_deg", (float(tilt[0]), float(tilt[1])))

    @staticmethod
    def of_f_number(
        image_distance_mm: float,
        focus_distance_mm: float,
        f_number: float,
        sensor_tilt_deg: tuple[float, float] = (0.0, 0.0),
    ) -> Lens:
        """The lens whose pupil is its focal length by an f-number wide."""
        f_number = number_within("Lens: f_number", f_number, *F_NUMBERS, "it from 0.5, such as 8")
        pinhole = Lens(image_distance_mm, focus_distance_mm, 0.0, sensor_tilt_deg)
        return replace(pinhole, pupil_radius_mm=pinhole.focal_length_mm / (2.0 * f_number))

    def _line(self) -> str:
        aperture = f"f/{self.f_number:.3g}" if self.pupil_radius_mm else "a pinhole"
        sharp = f"focused at {self.focus_distance_mm:.5g} mm"
        tilt = "sensor tilted by {:.3g} and {:.3g} degrees".format(*self.sensor_tilt_deg)
        tilted = tilt if any(self.sensor_tilt_deg) else ""
        return listed(f"F {self.focal_length_mm:.5g} mm", aperture, sharp, tilted)

    @property
    def focal_length_mm(self) -> float:
        """F."""
        return 1.0 / (1.0 / self.image_distance_mm + 1.0 / self.focus_distance_mm)

    @property
    def f_number(self) -> float:
        """N = F by the pupil's diameter; infinite of a pinhole."""
        diameter = 2.0 * self.pupil_radius_mm
        return self.focal_length_mm / diameter if diameter else float("inf")

    @property
    def magnification(self) -> float:
        """Size of the image by that of what is in focus on the axis: m = b/g."""
        return self.image_distance_mm / self.focus_distance_mm

    @property
    def working_f_number(self) -> float:
        """N (1 + m): of the cone of light that meets the sensor on the axis."""
        return self.f_number * (1.0 + self.magnification)

    @property
    def lean(self) -> Array:
        """By how much 1/g falls with p and q, 1/mm: shape (2,)."""
        tau_x, tau_y = np.radians(self.sensor_tilt_deg)
        return np.array([np.tan(tau_y) / np.cos(tau_x), -np.tan(tau_x)]) / self.image_distance_mm

    def in_focus(self, p: Any, q: Any) -> Any:
        """1/g(p, q): the reciprocal of the depth in focus along chief rays, 1/mm.

        Of NumPy's arrays as of Dr.Jit's; 0 is infinity, and below it nothing is in focus.
        """
        by_p, by_q = map(float, self.lean)
        return 1.0 / self.focus_distance_mm - (by_p * p + by_q * q)

    def pupil(self, count: int) -> Array:
        """Points (count, 2) of the pupil, mm: one in each of so many parts of equal area.

        What changes with the place in the pupil as a polynomial of the third degree has its true
        mean from 6 points on; of the seventh degree, from 16 points on that make equal rings.

        Raises
        ------
        InputError
            If it is no number from 1 to `MOST_POINTS`.
        """
        count = whole_number("Lens: the number of points of the pupil", count, 1, MOST_POINTS)
        return self.pupil_radius_mm * _points_of_disc(count)


def _points_of_disc(count: int) -> Array:
    """Points (count, 2) in parts of equal area of the unit disc: rings, cut into sectors.

    Two rings of points in each annulus lie at the two nodes of Gauss's rule for the square of the
    radius, by which the disc's area goes.  So few points as have one ring lie at the root mean
    square radius.  All are turned so that no two of them are side by side along x or y.
    """
    if count == 1:
        return np.zeros((1, 2))
    annuli = max(1, round(np.sqrt(count) / 4.0))
    ends = np.rint(count * np.arange(annuli + 1) / annuli).astype(int)
    points = []
    for first, last in pairwise(ends):
        number = last - first
        middle, sigma = (first + last) / (2.0 * count), number / (np.sqrt(12.0) * count)
        inner = number // 2 if count >= _LEAST_OF_TWO else 0
        outer = number - inner
        beside = sigma * np.sqrt([outer / inner, inner / outer]) if inner else np.zeros(2)
        for ring, squared, turn in (
            (inner, middle - beside[0], _TURNS[0]),
            (outer, middle + beside[1], _TURNS[1]),
        ):
            angle = 2.0 * np.pi * (np.arange(ring) + turn) / max(ring, 1)
            points.append(np.sqrt(squared) * np.stack([np.cos(angle), np.sin(angle)], axis=1))
    return np.concatenate(points)


@dataclass(frozen=True)
class PupilPoint(Pinhole):
    """All pixels of a camera with a lens, seen from one point of its pupil.

    A pinhole in that point, `pose.origin_mm`.  The coordinates (p, q) of its rays are their slopes
    in the camera's frame; chief rays of the same pixels have others, and the matrix and the
    distortion are of those.

    Attributes
    ----------
    at_mm : tuple of two float
        The point in the camera's frame: x and y from the middle of the lens.
    of_chief : ndarray of shape (2, 3)
        Slopes of the point's rays from those of the chief rays, p_A = of_chief @ (p, q, 1).
    """

    at_mm: tuple[float, float] = (0.0, 0.0)
    of_chief: Array = field(default_factory=lambda: np.eye(2, 3))

    @staticmethod
    def of(camera: Pinhole, lens: Lens, at_mm: ArrayLike) -> PupilPoint:
        """A point (x, y) of a camera's lens, mm from its middle."""
        at = np.asarray(at_mm, float)
        of_chief = np.column_stack([np.eye(2) + np.outer(at, lens.lean), -at * lens.in_focus(0, 0)])
        origin = camera.pose.to_world(np.append(at, 0.0))
        numbers = camera.matrix, Pose(camera.pose.rotation, origin), camera.size
        bends = camera.distortion, camera.fisheye
        return PupilPoint(*numbers, *bends, (float(at[0]), float(at[1])), of_chief)

    def _line(self) -> str:
        x, y = self.at_mm
        return listed(f"x {x:.3g}, y {y:.3g} mm of the pupil", super()._line())

    def with_pose(self, pose: Pose) -> Self:
        """The same point of the same lens in another place; the pose is that of the point."""
        return replace(self, pose=pose)

    def from_chief(self, p: Any, q: Any) -> tuple[Any, Any]:
        """Slopes of the point's rays in the pixels of chief rays; Dr.Jit's numbers too."""
        return _affine(self.of_chief, p, q)

    def to_chief(self, p: Any, q: Any) -> tuple[Any, Any]:
        """Slopes of the chief rays in the pixels of the point's rays; Dr.Jit's numbers too."""
        return _affine(self._to_chief, p, q)

    @property
    def _to_chief(self) -> Array:
        back = np.linalg.inv(self.of_chief[:, :2])
        return np.column_stack([back, -back @ self.of_chief[:, 2]])

    @property
    def ideal_matrix(self) -> Array:
        """From this point's (p, q, 1) to the pixels of an ideal lens, (3, 3)."""
        return self.matrix @ np.vstack([self._to_chief, [0.0, 0.0, 1.0]])

    def pixels(self, p: ArrayLike, q: ArrayLike) -> Array:
        """The pixels (..., 2) that see rays of coordinates (...); NaN of NaN."""
        return super().pixels(*self.to_chief(np.asarray(p, float), np.asarray(q, float)))

    def of_pixels(self, pixel: ArrayLike) -> tuple[Array, Array]:
        """Coordinates p and q (...) of what pixels (..., 2) see from this point."""
        p, q = self.from_chief(*super().of_pixels(pixel))
        return p, q

    def pixel_slopes(self, p: ArrayLike, q: ArrayLike) -> Array:
        """d(u, v)/d(p, q) of rays' pixels (...): shape (..., 2, 2)."""
        chief = self.to_chief(np.asarray(p, float), np.asarray(q, float))
        return super().pixel_slopes(*chief) @ self._to_chief[:, :2]


def _affine(numbers: Array, x: Any, y: Any) -> tuple[Any, Any]:
    """Numbers (2, 3) @ (x, y, 1)."""
    (a, b, c), (d, e, f) = numbers.tolist()
    return a * x + b * y + c, d * x + e * y + f


def circle_of_confusion(lens: Lens, camera: Pinhole, points_mm: ArrayLike) -> Array:
    """How wide points' images are along u and v: shape (N, 2), px.

    Parameters
    ----------
    lens : Lens
    camera : Pinhole
        Its chief rays.
    points_mm : array_like of shape (N, 3)
        World; along straight lines of sight.

    Notes
    -----
    Seen from the point A of the pupil, the image of a point at the depth z is moved by
    A (1/g - 1/z)/(1 + w . A) in (p, q), of which the denominator is left out: the pupil of a tilted
    sensor is small beside the distance to the line in which sensor and lens meet.
    """
    p, q, depth = np.moveaxis(camera.coordinates(points_mm), -1, 0)
    with np.errstate(divide="ignore", invalid="ignore"):
        away = np.where(depth > 0.0, np.abs(lens.in_focus(p, q) - 1.0 / depth), np.nan)
    extent: Array = np.linalg.norm(camera.pixel_slopes(p, q), axis=-1)
    return 2.0 * lens.pupil_radius_mm * away[..., None] * extent
