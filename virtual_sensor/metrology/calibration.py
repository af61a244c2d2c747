"""A real sensor's calibration, as OpenCV and ROS store it: YAML, XML or JSON.

=======================  ===========================================================================
image_width, _height     px
camera_matrix            K, 3 x 3, integer at pixel centres; also cameraMatrix, K, mtx.  One f < 0
                         where the image is mirrored (noted); skew is refused
distortion_coefficients  4, 5, 8, 12 or 14 of OpenCV's (of rational, thin-prism and tilted models
                         too), 4 of a fisheye; also dist_coeffs, distCoeffs, D ...; left out
                         (noted): none
distortion_model         ROS's plumb_bob, rational_polynomial, equidistant, Kalibr's radtan; others
                         are refused
fisheye_model            OpenCV's: 1 of a fisheye, 0
rotation, translation    from the world to the camera, x_c = R x_w + t, mm; R as 3 x 3 or as
                         Rodrigues' vector; also R, rvec, T, tvec ...; one without the other is
                         refused; both left out (noted): the world is the camera's
laser_plane              n_x, n_y, n_z, d with n . x = d in the world, mm
=======================  ===========================================================================

Another name than the first is noted, two names of one element, or an element twice, are refused.
Matrices are OpenCV's or ROS's (rows, cols, data) or lists, nested or not.  What else a file holds
(a rectification, a projection matrix, how it was calibrated) is not used, and noted.
"""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path

import cv2
import numpy as np
from numpy.typing import NDArray

from virtual_sensor.calls import public
from virtual_sensor.devices.calibration_files import CalibrationFile, camera_in, put_camera
from virtual_sensor.display import Displayed, place
from virtual_sensor.errors import InputError, naming
from virtual_sensor.files import path_of
from virtual_sensor.optics.ray_families import Pinhole
from virtual_sensor.optics.sensor_geometry import Sensor, check_geometry

Array = NDArray[np.float64]


@dataclass(frozen=True)
class Plane(Displayed):
    """A laser plane in Hessian form.

    Attributes
    ----------
    normal : ndarray of shape (3,)
        Unit normal, world.
    offset_mm : float
        normal . x on the plane.
    """

    normal: Array
    offset_mm: float

    def _line(self) -> str:
        return f"normal {place(self.normal)}, {self.offset_mm:.6g} mm from the origin"

    @property
    def plane(self) -> tuple[Array, float]:
        """Normal and offset."""
        return self.normal, self.offset_mm

    @property
    def target_mm(self) -> Array:
        """Its point nearest to the world's origin, (3,)."""
        return self.normal * self.offset_mm


@public
@dataclass(frozen=True)
class Calibration(Displayed):
    """All that `triangulate` needs of a sensor: a camera and a laser plane in one world.

    Attributes
    ----------
    camera : Pinhole
    laser : Plane
    notes : tuple of str
        What a file's reader assumed or did not use.
    """

    camera: Pinhole
    laser: Plane
    notes: tuple[str, ...] = ()

    def _line(self) -> str:
        angle = f"laser plane {self.triangulation_angle_deg:.4g}° to the camera's axis"
        return f"{angle}; camera {self.camera._line()}"

    @property
    def triangulation_angle_deg(self) -> float:
        """Angle between the camera's axis and the laser plane."""
        sine = float(self.camera.pose.rotation[:, 2] @ self.laser.normal)
        return float(np.degrees(np.arcsin(min(abs(sine), 1.0))))


def calibration_of(sensor: Sensor) -> Calibration:
    """The calibration that a perfect calibration of a simulated sensor would give."""
    normal, offset = sensor.laser.plane
    return Calibration(sensor.camera, Plane(normal, offset))


def calibration_text(calibration: Calibration, file_name: str) -> str:
    """The text of a calibration file; its name's ending says whether YAML, XML or JSON.

    A mirrored camera, whose axes are left-handed, has a negative f and right-handed axes there.

    Raises
    ------
    InputError
        Where a mirrored camera distorts, for which OpenCV has no model.
    """
    storage = cv2.FileStorage(file_name, cv2.FILE_STORAGE_WRITE | cv2.FILE_STORAGE_MEMORY)
    put_camera(storage, calibration.camera)
    normal, offset = calibration.laser.plane
    storage.write("laser_plane", np.append(normal, offset))
    return str(storage.releaseAndGetString())


@public
def read_calibration(path: str | Path) -> Calibration:
    """Read a sensor's calibration: a file of OpenCV or ROS (YAML, XML or JSON).

    Parameters
    ----------
    path : str or Path

    Raises
    ------
    InputError
        Naming the file, the element and what it should be.
    """
    path = path_of("read_calibration: path", path)
    file = CalibrationFile.read(path)
    camera = camera_in(file)
    *normal, offset = file.numbers("laser_plane", (4,))
    length = float(np.linalg.norm(normal))
    if not length > 0.0:
        raise InputError(f"{path}: 'laser_plane' has no normal; give n_x, n_y, n_z, d")
    plane = Plane(np.array(normal) / length, float(offset) / length)
    calibration = Calibration(camera, plane, file.all_notes())
    with naming(path):
        check_geometry(calibration)
    return calibration
