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

import json
import re
from collections.abc import Iterable
from contextlib import suppress
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any
from xml.etree import ElementTree

import cv2
import numpy as np
import yaml  # type: ignore[import-untyped]
from numpy.typing import NDArray

from virtual_sensor.calls import public
from virtual_sensor.display import Displayed, place
from virtual_sensor.errors import InputError, few, naming
from virtual_sensor.files import path_of, readable
from virtual_sensor.optics.ray_families import Pinhole
from virtual_sensor.optics.sensor_geometry import Sensor, check_geometry
from virtual_sensor.poses import Pose

Array = NDArray[np.float64]

_COEFFICIENTS = (0, 4, 5, 8, 12, 14)
_ALSO = {
    "camera_matrix": ("cameraMatrix", "K", "mtx"),
    "distortion_coefficients": (
        *("dist_coeffs", "dist_coefs", "distCoeffs", "distortion_coeffs"),
        *("distortion", "dist", "D"),
    ),
    "rotation": ("R", "rvec", "rotation_matrix", "rotation_vector"),
    "translation": ("T", "t", "tvec", "translation_vector"),
}
_FLAGS = {"0": False, "1": True}  # fisheye?
_MODELS = {
    **dict.fromkeys(("plumb_bob", "radtan", "rational_polynomial"), False),
    **dict.fromkeys(("equidistant", "fisheye"), True),
}
_ORTHOGONAL = 1e-4
_ZERO = 1e-9  # px
_LARGEST_PX = 2**20
_LARGEST = 1e12  # products of a few such numbers are finite
_LARGEST_BYTES = 2**22
_DEEPEST = 100
_MOST_NUMBERS = 100
_MOST_NAMES = 10
_NUMBER = re.compile(r"[-+]?(\d+\.?\d*|\.\d+)([eE][-+]?\d+)?")


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
    camera = calibration.camera
    to_camera, matrix = camera.pose.rotation.T, camera.matrix
    if np.linalg.det(to_camera) < 0.0:
        if camera.distorts:
            raise InputError("calibration: of a mirrored camera that distorts there is no file")
        mirror = np.diag([-1.0, 1.0, 1.0])
        to_camera, matrix = mirror @ to_camera, matrix @ mirror
    storage = cv2.FileStorage(file_name, cv2.FILE_STORAGE_WRITE | cv2.FILE_STORAGE_MEMORY)
    storage.write("image_width", camera.size[0])
    storage.write("image_height", camera.size[1])
    storage.write("camera_matrix", matrix)
    distortion = camera.distortion if camera.distortion.size else np.zeros(5)
    storage.write("distortion_coefficients", distortion.reshape(1, -1))
    if camera.fisheye:
        storage.write("fisheye_model", 1)
    storage.write("rotation", np.ascontiguousarray(to_camera))
    storage.write("translation", -(to_camera @ camera.pose.origin_mm))
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
    notes: list[str] = []
    file = _File(path, _elements(path, notes), notes=notes)
    size = (_pixels(file, "image_width"), _pixels(file, "image_height"))
    matrix = file.numbers("camera_matrix", (9,)).reshape(3, 3)
    f = matrix[[0, 1], [0, 1]]
    zeros = np.abs([matrix[0, 1], matrix[1, 0], *(matrix[2] - [0.0, 0.0, 1.0])])
    if not (f.max() > 0.0 and f.min() != 0.0 and zeros.max() < _ZERO):
        raise InputError(
            f"{path}: 'camera_matrix' must be [f_x 0 c_x; 0 f_y c_y; 0 0 1] with positive f, in px"
            " (one negative where the image is mirrored); OpenCV's model has no skew"
        )
    if f.min() < 0.0:
        file.notes.append("'camera_matrix' has a negative f: the image is taken as mirrored")
    fisheye = _is_fisheye(file)
    counts = (4,) if fisheye else _COEFFICIENTS
    distortion = file.numbers("distortion_coefficients", counts, None if fisheye else np.zeros(0))
    if file.find("distortion_coefficients") is None:
        file.notes.append("has no 'distortion_coefficients': the lens is taken as ideal")
    if not (fisheye or distortion.any()):
        distortion = np.zeros(0)
    camera = Pinhole(matrix, _pose(file), size, distortion, fisheye)
    *normal, offset = file.numbers("laser_plane", (4,))
    length = float(np.linalg.norm(normal))
    if not length > 0.0:
        raise InputError(f"{path}: 'laser_plane' has no normal; give n_x, n_y, n_z, d")
    plane = Plane(np.array(normal) / length, float(offset) / length)
    calibration = Calibration(camera, plane, file.all_notes())
    with naming(path):
        check_geometry(calibration)
    return calibration


def _elements(path: Path, notes: list[str]) -> dict[str, Any]:
    """The elements of a file by their names: numbers and words as text, lists, dictionaries."""
    try:
        if readable(path).stat().st_size > _LARGEST_BYTES:
            raise InputError(f"{path}: is too large for a calibration, over {_LARGEST_BYTES} bytes")
        text = path.read_text(encoding="utf-8-sig", errors="replace").lstrip()
    except OSError as error:
        raise InputError(f"{path}: can't be read as a calibration ({error.strerror})") from None
    if _nesting(text) > _DEEPEST:
        raise InputError(f"{path}: is nested over {_DEEPEST} levels deep; no calibration is")
    try:
        elements = _xml(ElementTree.fromstring(text)) if text.startswith("<") else _yaml(text)
    except (ValueError, ElementTree.ParseError, yaml.YAMLError, RecursionError) as error:
        reason = " ".join(f"{error}".split())[:200]
        raise InputError(f"{path}: is not OpenCV's YAML, XML or JSON ({reason})") from None
    if not isinstance(elements, dict):
        raise InputError(
            f"{path}: is not OpenCV's YAML, XML or JSON; write it with cv2.FileStorage"
        )
    if text[-1] not in "\n]}>":
        notes.append("ends within a line, as a file that is not whole does")
    return elements


class _Loader(getattr(yaml, "CBaseLoader", yaml.BaseLoader)):  # type: ignore[misc]
    """YAML whose numbers stay text, since 010 is no 8 and 1e-5 is a number; tags are not read."""

    def construct_mapping(self, node: Any, deep: bool = True) -> dict[str, Any]:
        return _once(
            (f"{key.value}", self.construct_object(value, True)) for key, value in node.value
        )


def _yaml(text: str) -> Any:
    """What a YAML or JSON text holds."""
    if text.startswith("{"):
        with suppress(json.JSONDecodeError):
            return json.loads(text, object_pairs_hook=_once)
    start = text.startswith("%YAML") and text.find("\n") + 1  # OpenCV's has a colon in it
    return yaml.load(text[int(start) :], Loader=_Loader)


def _xml(element: ElementTree.Element) -> Any:
    """What an XML element of OpenCV's holds."""
    if all(child.tag == "_" for child in element):
        words = [word.strip('"') for word in (element.text or "").split()]
        return [_xml(child) for child in element] or (words[0] if len(words) == 1 else words)
    return _once((child.tag, _xml(child)) for child in element)


def _once(pairs: Iterable[tuple[str, Any]]) -> dict[str, Any]:
    """A dictionary of names that are there once each."""
    known: dict[str, Any] = {}
    for name, value in pairs:
        if name in known:
            raise ValueError(f"'{name}' is there twice")
        known[name] = value
    return known


def _nesting(text: str) -> int:
    """Levels of brackets, tags and YAML's indents and dashes: as many as there are, or more."""
    deepest = max(len(start) for start in re.findall(r"^[ \t?-]*", text, re.MULTILINE)) // 10
    level = 0
    for sign in re.findall(r"[][{}]|</?|/>", text):
        level += 1 if sign in "[{<" else -1
        deepest = max(deepest, level)
    return deepest


@dataclass
class _File:
    """The elements of a file, by their names, and notes on them."""

    path: Path
    elements: dict[str, Any]
    used: set[str] = field(default_factory=set)
    notes: list[str] = field(default_factory=list)

    def find(self, name: str) -> Any:
        """An element by any of its names; None where it is left out."""
        names = (name, *_ALSO.get(name, ()))
        there = [n for n in names if n in self.elements]
        if len(there) > 1:
            both = " and ".join(f"'{n}'" for n in there)
            raise InputError(f"{self.path}: has {both}, which mean the same; leave one")
        if not there:
            return None
        if there != [name]:
            self.notes.append(f"'{there[0]}' is taken as '{name}'")
        self.used.add(there[0])
        return self.elements[there[0]]

    def numbers(
        self,
        name: str,
        counts: tuple[int, ...],
        default: Array | None = None,
        below: float = _LARGEST,
    ) -> Array:
        """The numbers of an element, as many as it may have."""
        found = self.find(name)
        if found is None:
            if default is None:
                raise InputError(
                    f"{self.path}: lacks '{name}'; add it (see metrology/calibration.py)"
                )
            return default
        try:
            values = np.array(_numbers(found))
        except (ValueError, TypeError, OverflowError, RecursionError):
            values = np.array([np.nan])
        if values.size not in counts or not (np.abs(values) < below).all():
            wanted = " or ".join(map(str, counts))
            raise InputError(
                f"{self.path}: '{name}' must hold {wanted} finite numbers, below {below:g}"
            )
        return values

    def word(self, name: str) -> str:
        """A word or a number as text; "" where it is left out."""
        found = self.find(name)
        return f"{found:g}" if isinstance(found, int | float) else f"{found or ''}"

    def all_notes(self) -> tuple[str, ...]:
        """All notes, one on the names that were not used among them."""
        others = sorted(self.elements.keys() - self.used)
        if others:
            self.notes.append(f"not used: {few([f'{n!r}' for n in others], _MOST_NAMES)}")
        return tuple(f"{self.path}: {note}." for note in dict.fromkeys(self.notes))


def _pixels(file: _File, name: str) -> int:
    (value,) = file.numbers(name, (1,), below=np.inf)
    if not (1.0 <= value <= _LARGEST_PX and value == int(value)):
        raise InputError(f"{file.path}: '{name}' is {value:g}; give a whole number of px, from 1")
    return int(value)


def _is_fisheye(file: _File) -> bool:
    """Whether the lens model is OpenCV's fisheye: said by OpenCV or ROS, who must agree."""
    flag, model = file.word("fisheye_model"), file.word("distortion_model").lower()
    said = {_FLAGS.get(flag), _MODELS.get(model)} - {None}
    if (flag and flag not in _FLAGS) or (model and model not in _MODELS) or len(said) > 1:
        raise InputError(
            f"{file.path}: 'fisheye_model' {flag or 'left out'} and 'distortion_model'"
            f" {model or 'left out'} name no lens model known here; known are 0 or 1, and"
            f" {', '.join(_MODELS)}"
        )
    if file.find("xi") is not None:
        raise InputError(
            f"{file.path}: 'xi' is of an omnidirectional lens, which is not known here"
        )
    return True in said


def _pose(file: _File) -> Pose:
    """Where the camera stands: the inverse of the file's rotation and translation."""
    given = [file.find(name) is not None for name in ("rotation", "translation")]
    if given.count(True) == 1:
        has, lacks = ("rotation", "translation")[:: 1 if given[0] else -1]
        raise InputError(
            f"{file.path}: has '{has}' but no '{lacks}'; give both, or none where the world is the"
            " camera's"
        )
    if not any(given):
        file.notes.append("has no 'rotation' and 'translation': the world is the camera's")
    rotation = file.numbers("rotation", (3, 9), np.eye(3).ravel())
    to_camera = cv2.Rodrigues(rotation)[0] if rotation.size == 3 else rotation.reshape(3, 3)
    if not np.allclose(to_camera @ to_camera.T, np.eye(3), atol=_ORTHOGONAL):
        raise InputError(f"{file.path}: 'rotation' is no rotation; give a matrix with R R^T = 1")
    if np.linalg.det(to_camera) < 0.0:
        raise InputError(f"{file.path}: 'rotation' is a reflection; its determinant must be +1")
    pose = np.eye(4)
    pose[:3, :3] = to_camera.T
    turned = Pose.from_matrix(pose).rotation  # a file of few digits holds no exact rotation
    return Pose(turned, -turned @ file.numbers("translation", (3,), np.zeros(3)))


def _numbers(value: Any) -> list[float]:
    """Numbers of a matrix, of lists within lists or a single one.

    Raises
    ------
    ValueError
        Where something else is among them, rows differ in length, or there are too many.
    """
    if isinstance(value, dict):
        value = value.get("data")
    if not isinstance(value, list):
        if isinstance(value, str) and not _NUMBER.fullmatch(value):
            raise ValueError(value)
        return [float(value)]
    rows: list[list[float]] = []
    for each in value:
        rows.append(_numbers(each))
        length = len(rows[0])
        if not 0 < length <= _MOST_NUMBERS // len(rows) or len(rows[-1]) != length:
            raise ValueError("rows")  # YAML's references make much out of little
    return [number for row in rows for number in row]
