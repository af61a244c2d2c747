"""OpenCV's lens distortion as a formula, for NumPy's arrays as for Dr.Jit's.

Where pixels are wanted of NumPy's arrays alone, OpenCV itself gives them (`ray_families`).
"""

import math
from typing import Any

import numpy as np
from numpy.typing import NDArray

from virtual_sensor.arrays import number_for, solved, where

COEFFICIENTS = (0, 4, 5, 8, 12, 14)
"""So many a distortion of OpenCV's may have."""
_MOST_STEPS, _STEP, _SOLVED = 6, 1e-6, 1e-12  # of Newton's method, and for its derivatives


def distorted(x: Any, y: Any, coefficients: NDArray[np.float64]) -> tuple[Any, Any]:
    """Where a lens puts light of coordinates x/z and y/z, in the same unit.

    Parameters
    ----------
    x, y : array
    coefficients : ndarray of shape (0,), (4,), (5,), (8,), (12,) or (14,)
        OpenCV's k_1, k_2, p_1, p_2, k_3 ... s_4, tau_x, tau_y.

    Notes
    -----
    Radial as a quotient of polynomials, tangential, thin prism, and a tilt of the sensor: "Camera
    calibration and 3D reconstruction" of OpenCV's documentation.
    """
    if not np.any(coefficients):
        return x, y
    padded = np.pad(np.asarray(coefficients, float), (0, COEFFICIENTS[-1] - len(coefficients)))
    k1, k2, p1, p2, k3, k4, k5, k6, s1, s2, s3, s4 = (number_for(x, float(k)) for k in padded[:12])
    r2 = x * x + y * y
    radial = 1.0 + r2 * (k1 + r2 * (k2 + r2 * k3))
    if padded[5:8].any():
        radial = radial / (1.0 + r2 * (k4 + r2 * (k5 + r2 * k6)))
    xy = 2.0 * x * y
    moved_x = x * radial + p1 * xy + p2 * (r2 + 2.0 * x * x) + r2 * (s1 + r2 * s2)
    moved_y = y * radial + p2 * xy + p1 * (r2 + 2.0 * y * y) + r2 * (s3 + r2 * s4)
    if not padded[12:].any():
        return moved_x, moved_y
    rows = _tilt(*padded[12:]).tolist()
    a, b, c = (
        number_for(x, row[0]) * moved_x + number_for(x, row[1]) * moved_y + number_for(x, row[2])
        for row in rows
    )
    return a / c, b / c


def undistorted(x: Any, y: Any, coefficients: NDArray[np.float64]) -> tuple[Any, Any]:
    """Coordinates x/z and y/z of the light that a lens puts at places: `distorted` undone.

    By Newton's method, to 1e-12; NaN where it does not get there.  Beyond a fold of the image it
    may find other light than the lens shows: `PixelFamily.undistorted` looks for that, one by one.
    """
    if not np.any(coefficients):
        return x, y
    step = number_for(x, _STEP)
    s, t = x, y
    for _ in range(_MOST_STEPS):
        at_s, at_t = distorted(s, t, coefficients)
        beside, below = distorted(s + step, t, coefficients), distorted(s, t + step, coefficients)
        by_s, by_t = (
            [(b - a) / step for a, b in zip((at_s, at_t), v, strict=True)] for v in (beside, below)
        )
        more_s, more_t = solved((by_s[0], by_t[0], by_s[1], by_t[1]), x - at_s, y - at_t)
        s, t = s + more_s, t + more_t
    at_s, at_t = distorted(s, t, coefficients)
    near = (abs(at_s - x) < _SOLVED) & (abs(at_t - y) < _SOLVED)
    return where(near, s, math.nan), where(near, t, math.nan)


def _tilt(tau_x: float, tau_y: float) -> NDArray[np.float64]:
    """The homography (3, 3) of a sensor tilted by two angles, rad."""
    (sin_x, cos_x), (sin_y, cos_y) = ((math.sin(tau), math.cos(tau)) for tau in (tau_x, tau_y))
    about_x = np.array([[1.0, 0.0, 0.0], [0.0, cos_x, sin_x], [0.0, -sin_x, cos_x]])
    about_y = np.array([[cos_y, 0.0, -sin_y], [0.0, 1.0, 0.0], [sin_y, 0.0, cos_y]])
    R = about_y @ about_x
    to_axis = np.array([[R[2, 2], 0.0, -R[0, 2]], [0.0, R[2, 2], -R[1, 2]], [0.0, 0.0, 1.0]])
    return to_axis @ R
