"""What hot air does to a measurement: the differences of figures 7 to 10 of Beermann et al. 2018.

A is where a laser ray meets the cold object and B where it meets the hot one, A_m and B_m are the
points measured there by triangulation, all in the world frame.
"""

from collections.abc import Mapping
from dataclasses import dataclass
from typing import ClassVar

import numpy as np
from numpy.typing import ArrayLike, NDArray

from virtual_sensor.arrays import LARGEST, SMALLEST, number_within
from virtual_sensor.display import Displayed
from virtual_sensor.optics.ray_families import Pinhole

Array = NDArray[np.float64]

UM_PER_MM = 1000.0

LETTERS = {
    "incidence_shift_um": "B - A",
    "hot_error_um": "B - B_m",
    "measured_shift_um": "B_m - A_m",
    "cold_error_um": "A - A_m",
}
"""Each of the differences in space in the paper's letters."""


@dataclass(frozen=True)
class Deviation(Displayed):
    """Differences in N laser rays; NaN where one of the two points is missing.

    Attributes
    ----------
    incidence_shift_um : ndarray of shape (N, 3)
        B - A: how far the laser spot moves on the object, figure 7(a).
    hot_error_um : ndarray of shape (N, 3)
        B - B_m: real minus measured point in hot air, figure 7(b).
    measured_shift_um : ndarray of shape (N, 3)
        B_m - A_m: how far the measured point moves, figure 7(c).
    pixel_shift_px : ndarray of shape (N, 2)
        Hot minus cold pixel (Delta u, Delta v), figure 7(d).
    cold_error_um : ndarray of shape (N, 3)
        A - A_m: real minus measured point in cold air, figure 7(e).
    """

    _by_row: ClassVar = True

    incidence_shift_um: Array
    hot_error_um: Array
    measured_shift_um: Array
    pixel_shift_px: Array
    cold_error_um: Array

    def _line(self) -> str:
        return _most(vars(self))


@dataclass(frozen=True)
class PathDisplacement(Displayed):
    """Pixel displacement (Delta u, Delta v), split by light path: figures 8 and 9.

    Attributes
    ----------
    laser_to_object_px : ndarray of shape (N, 2)
        By the laser's path: B and A both seen straight.
    object_to_camera_px : ndarray of shape (N, 2)
        By the camera's path: the hot pixel against B seen straight.
    laser_to_camera_px : ndarray of shape (N, 2)
        By both: hot minus cold pixel.  It is the sum of the other two, but for the error with which
        the cold pixel shows A.
    """

    _by_row: ClassVar = True

    laser_to_object_px: Array
    object_to_camera_px: Array
    laser_to_camera_px: Array

    def _line(self) -> str:
        return _most(vars(self))


def deviations(
    A_mm: ArrayLike,
    B_mm: ArrayLike,
    A_m_mm: ArrayLike,
    B_m_mm: ArrayLike,
    pixel_A: ArrayLike,
    pixel_B: ArrayLike,
) -> Deviation:
    """Compare points (N, 3) in mm and pixels (N, 2) of the cold (A) and the hot (B) object."""
    A, B, A_m, B_m = (np.asarray(points, float) for points in (A_mm, B_mm, A_m_mm, B_m_mm))
    return Deviation(
        incidence_shift_um=UM_PER_MM * (B - A),
        hot_error_um=UM_PER_MM * (B - B_m),
        measured_shift_um=UM_PER_MM * (B_m - A_m),
        pixel_shift_px=np.asarray(pixel_B, float) - np.asarray(pixel_A, float),
        cold_error_um=UM_PER_MM * (A - A_m),
    )


def euclidean(difference: ArrayLike) -> Array:
    """Length (N,) of each difference (N, 2) or (N, 3) in its own unit: the paper's d_euclid."""
    return np.linalg.norm(np.asarray(difference, float), axis=-1)


def _most(differences: Mapping[str, Array]) -> str:
    """The largest length of each difference (N, K), as a line says it."""
    words = []
    for name, values in differences.items():
        lengths = euclidean(values)
        known = lengths[np.isfinite(lengths)]
        words += [f"{name} {known.max():.3g}"] if known.size else []
    count = f"{len(next(iter(differences.values())))} rays"
    return f"{count}, at most {', '.join(words)}" if words else f"{count}, none with both points"


def round_pixel(pixel: ArrayLike, step: float = 0.25) -> Array:
    """Round pixels to the sensor's sub-pixel step in px, the paper's discretisation (section 4.2).

    Raises
    ------
    InputError
        Where `step` is not positive.
    """
    number_within(
        "round_pixel: step", step, SMALLEST, LARGEST, "a positive one, 0.25 px in the paper"
    )
    return np.round(np.asarray(pixel, float) / step) * step


def separate_paths(
    camera: Pinhole, A_mm: ArrayLike, B_mm: ArrayLike, pixel_A: ArrayLike, pixel_B: ArrayLike
) -> PathDisplacement:
    """Split the displacement of the laser spot in the image by light path, as figure 8 does.

    Parameters
    ----------
    camera : Pinhole
    A_mm, B_mm : array_like of shape (N, 3)
        Where the laser ray meets the cold and the hot object, world frame.
    pixel_A, pixel_B : array_like of shape (N, 2)
        Where the camera sees them, in px: straight (A) and through the hot air (B).
    """
    A_straight, B_straight = camera.project(A_mm), camera.project(B_mm)
    pixel_A, pixel_B = np.asarray(pixel_A, float), np.asarray(pixel_B, float)
    return PathDisplacement(
        laser_to_object_px=B_straight - A_straight,
        object_to_camera_px=pixel_B - B_straight,
        laser_to_camera_px=pixel_B - pixel_A,
    )
