"""A real sensor's calibration, as OpenCV stores it: YAML, XML or JSON of `cv2.FileStorage`.

====================================  ==============================================================
image_width, image_height             px
camera_matrix                         K, 3 x 3, integer at pixel centres
distortion_coefficients               4, 5, 8, 12 or 14 of OpenCV's; left out: none
rotation, translation                 from the world to the camera, x_c = R x_w + t, mm; R as 3 x 3
                                      or as Rodrigues' vector; left out: the world is the camera's
laser_plane                           n_x, n_y, n_z, d with n . x = d in the world, mm
====================================  ==============================================================
"""

from dataclasses import dataclass
from pathlib import Path

import cv2
import numpy as np
from numpy.typing import NDArray

from virtual_sensor.errors import InputError
from virtual_sensor.files import readable
from virtual_sensor.metrology.triangulation import Sensor, check_geometry
from virtual_sensor.optics.sensor_model import Camera, Pose

Array = NDArray[np.float64]

_COEFFICIENTS = (0, 4, 5, 8, 12, 14)
_ORTHOGONAL = 1e-4
_ZERO = 1e-9  # px
_LARGEST_PX = 2**20


@dataclass(frozen=True)
class Plane:
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

    @property
    def plane(self) -> tuple[Array, float]:
        """Normal and offset."""
        return self.normal, self.offset_mm

    @property
    def target_mm(self) -> Array:
        """Its point nearest to the world's origin, (3,)."""
        return self.normal * self.offset_mm


@dataclass(frozen=True)
class Calibration:
    """All that `triangulate` needs of a sensor: a camera and a laser plane in one world."""

    camera: Camera
    laser: Plane

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
    """The text of a calibration file; its name's ending says whether YAML, XML or JSON."""
    camera = calibration.camera
    storage = cv2.FileStorage(file_name, cv2.FILE_STORAGE_WRITE | cv2.FILE_STORAGE_MEMORY)
    storage.write("image_width", camera.size[0])
    storage.write("image_height", camera.size[1])
    storage.write("camera_matrix", camera.matrix)
    if camera.distortion.size:
        storage.write("distortion_coefficients", camera.distortion.reshape(1, -1))
    storage.write("rotation", np.ascontiguousarray(camera.pose.rotation.T))
    storage.write("translation", -(camera.pose.rotation.T @ camera.pose.origin_mm))
    normal, offset = calibration.laser.plane
    storage.write("laser_plane", np.append(normal, offset))
    return str(storage.releaseAndGetString())


def read_calibration(path: Path) -> Calibration:
    """Read a calibration.

    Raises
    ------
    InputError
        Naming the file, the element and what it should be.
    """
    readable(path)
    try:
        text = path.read_text(encoding="utf-8")
    except (OSError, UnicodeDecodeError) as error:
        raise InputError(f"{path}: can't be read as a calibration ({error})") from None
    try:
        storage = cv2.FileStorage(text, cv2.FILE_STORAGE_READ | cv2.FILE_STORAGE_MEMORY)
        opened = storage.isOpened() and storage.root().isMap()
    except (cv2.error, SystemError) as error:
        reason = str(error.__cause__ or error).strip().splitlines()[-1]
        raise InputError(f"{path}: is not OpenCV's YAML, XML or JSON ({reason})") from None
    if not opened:
        raise InputError(
            f"{path}: is not OpenCV's YAML, XML or JSON; write it with cv2.FileStorage"
        )

    def element(name: str, sizes: tuple[int, ...], default: Array | None = None) -> Array:
        node = storage.getNode(name)
        if node.empty():
            if default is None:
                raise InputError(f"{path}: lacks '{name}'; add it (see metrology/calibration.py)")
            return default
        values = _numbers(node)
        if values.size not in sizes or not np.isfinite(values).all():
            wanted = " or ".join(map(str, sizes))
            raise InputError(f"{path}: '{name}' must hold {wanted} finite numbers")
        return values

    def pixels(name: str) -> int:
        (value,) = element(name, (1,))
        if not (1.0 <= value <= _LARGEST_PX and value == int(value)):
            raise InputError(f"{path}: '{name}' is {value:g}; give a whole number of px, from 1")
        return int(value)

    size = (pixels("image_width"), pixels("image_height"))
    matrix = element("camera_matrix", (9,)).reshape(3, 3)
    zeros = np.abs([matrix[0, 1], matrix[1, 0], *(matrix[2] - [0.0, 0.0, 1.0])])
    if not (min(matrix[0, 0], matrix[1, 1]) > 0.0 and zeros.max() < _ZERO):
        raise InputError(
            f"{path}: 'camera_matrix' must be [f_x 0 c_x; 0 f_y c_y; 0 0 1] with positive f, in px;"
            " OpenCV's model has no skew"
        )
    distortion = element("distortion_coefficients", _COEFFICIENTS, np.zeros(0))
    rotation = element("rotation", (3, 9), np.eye(3).ravel())
    to_camera = cv2.Rodrigues(rotation)[0] if rotation.size == 3 else rotation.reshape(3, 3)
    if not np.allclose(to_camera @ to_camera.T, np.eye(3), atol=_ORTHOGONAL):
        raise InputError(f"{path}: 'rotation' is no rotation; give a matrix with R R^T = 1")
    if np.linalg.det(to_camera) < 0.0:
        raise InputError(f"{path}: 'rotation' is a reflection; its determinant must be +1")
    pose = np.eye(4)
    pose[:3, :3] = to_camera.T
    turned = Pose.from_matrix(pose).rotation  # a file of few digits holds no exact rotation
    translation = element("translation", (3,), np.zeros(3))
    *normal, offset = element("laser_plane", (4,))
    length = float(np.linalg.norm(normal))
    if not length > 0.0:
        raise InputError(f"{path}: 'laser_plane' has no normal; give n_x, n_y, n_z, d")
    camera = Camera(matrix, Pose(turned, -turned @ translation), size, distortion)
    calibration = Calibration(camera, Plane(np.array(normal) / length, float(offset) / length))
    try:
        check_geometry(calibration)
    except InputError as error:
        raise InputError(f"{path}: {error}") from None
    return calibration


def _numbers(node: cv2.FileNode) -> Array:
    """Numbers of a matrix, a sequence or a single one; none where something else is among them.

    Not by `node.mat()`: where a matrix lacks its `cols`, that writes past its memory (OpenCV 5.0).
    """
    if node.isMap():
        node = node.getNode("data")
    parts = [node.at(i) for i in range(node.size())] if node.isSeq() else [node]
    if not all(part.isInt() or part.isReal() for part in parts):
        return np.zeros(0)
    return np.array([part.real() for part in parts])
