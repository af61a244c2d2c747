"""Calibrations as OpenCV and ROS store them, YAML, XML or JSON: their elements, by any name.

What each element means stands in `metrology.calibration`, of a camera with a laser plane, and in
`metrology.fringes.calibration`, of a camera with a projector; here are those of one device.
"""

from __future__ import annotations

import json
import re
from collections.abc import Iterable, Mapping
from contextlib import suppress
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any
from xml.etree import ElementTree

import cv2
import numpy as np
import yaml  # type: ignore[import-untyped]
from numpy.typing import NDArray

from virtual_sensor.errors import InputError, few, nearest
from virtual_sensor.files import readable
from virtual_sensor.optics.distortion import COEFFICIENTS
from virtual_sensor.optics.ray_families import Pinhole
from virtual_sensor.poses import Pose

Array = NDArray[np.float64]

ALSO = {
    "camera_matrix": ("cameraMatrix", "K", "mtx"),
    "distortion_coefficients": (
        *("dist_coeffs", "dist_coefs", "distCoeffs", "distortion_coeffs"),
        *("distortion", "dist", "D"),
    ),
    "rotation": ("R", "rvec", "rotation_matrix", "rotation_vector"),
    "translation": ("T", "t", "tvec", "translation_vector"),
}
"""Other names of elements, in files of one camera."""

ALSO_OF_BOTH = {
    "image_width": ("frameWidth", "camera_width"),
    "image_height": ("frameHeight", "camera_height"),
    "camera_matrix": ("cam_K", "Kc", "cam_int", "M1", "K1", "cameraMatrix1", "cameraMatrix"),
    "distortion_coefficients": (
        *("cam_kc", "kc", "cam_dist", "D1", "distCoeffs1", "camera_distortion"),
        *("distCoeffs", "dist_coeffs"),
    ),
    "projector_width": ("screenResX", "projectorWidth"),
    "projector_height": ("screenResY", "projectorHeight"),
    "projector_matrix": (
        "proj_K",
        "Kp",
        "proj_int",
        "M2",
        "K2",
        "cameraMatrix2",
        "projectorMatrix",
    ),
    "projector_distortion": ("proj_kc", "kp", "proj_dist", "D2", "distCoeffs2"),
    "projector_rotation": ("R", "Rp", "rotation"),
    "projector_translation": ("T", "Tp", "translation"),
}
"""Other names of elements in files of a camera with a projector: of OpenCV's stereo calibration and
of programs for structured light (scan3d-capture, SLStudio, procam-calibration)."""

_FLAGS = {"0": False, "1": True}  # fisheye?
_MODELS = {
    **dict.fromkeys(("plumb_bob", "radtan", "rational_polynomial"), False),
    **dict.fromkeys(("equidistant", "fisheye"), True),
}
_ORTHOGONAL = 1e-4
_ZERO = 1e-9  # px
LARGEST_PX = 2**20
_LARGEST = 1e12  # products of a few such numbers are finite
_LARGEST_BYTES = 2**22
_DEEPEST = 100
_MOST_NUMBERS = 100
_MOST_NAMES = 10
_NUMBER = re.compile(r"[-+]?(\d+\.?\d*|\.\d+)([eE][-+]?\d+)?")


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
class CalibrationFile:
    """The elements of a file, by their names, and notes on them."""

    path: Path
    elements: dict[str, Any]
    also: Mapping[str, tuple[str, ...]] = field(default_factory=lambda: ALSO)
    used: set[str] = field(default_factory=set)
    notes: list[str] = field(default_factory=list)

    @staticmethod
    def read(path: Path, also: Mapping[str, tuple[str, ...]] = ALSO) -> CalibrationFile:
        """Read a file; `also` are other names of elements.

        Raises
        ------
        InputError
            If it can't be read, or is no file of OpenCV's or ROS's.
        """
        notes: list[str] = []
        return CalibrationFile(path, _elements(path, notes), also, notes=notes)

    def find(self, name: str) -> Any:
        """An element by any of its names; None where it is left out."""
        names = (name, *self.also.get(name, ()))
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
        most: int = _MOST_NUMBERS,
    ) -> Array:
        """The numbers of an element, as many as it may have."""
        found = self.find(name)
        if found is None:
            if default is None:
                raise InputError(
                    f"{self.path}: lacks '{name}'{nearest(name, self.elements) or '; add it'}"
                )
            return default
        try:
            values = np.array(_numbers(found, most))
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


def camera_in(
    file: CalibrationFile,
    *,
    matrix: str = "camera_matrix",
    distortion: str = "distortion_coefficients",
    size: tuple[int, int] | None = None,
    pose: Pose | None = None,
) -> Pinhole:
    """The camera that a file describes, or a projector, by the names of its elements.

    Parameters
    ----------
    file : CalibrationFile
    matrix, distortion : str
        Names of elements.
    size : pair of int, optional
        Width and height, px; by default the file's `image_width` and `image_height`.
    pose : Pose, optional
        By default the file's.

    Raises
    ------
    InputError
        Naming the file, the element and what it should be.
    """
    if size is None:
        size = pixels_in(file, "image_width"), pixels_in(file, "image_height")
    K = file.numbers(matrix, (9,)).reshape(3, 3)
    f = K[[0, 1], [0, 1]]
    zeros = np.abs([K[0, 1], K[1, 0], *(K[2] - [0.0, 0.0, 1.0])])
    if not (f.max() > 0.0 and f.min() != 0.0 and zeros.max() < _ZERO):
        raise InputError(
            f"{file.path}: '{matrix}' must be [f_x 0 c_x; 0 f_y c_y; 0 0 1] with positive f, in px"
            " (one negative where the image is mirrored); OpenCV's model has no skew"
        )
    if f.min() < 0.0:
        file.notes.append(f"'{matrix}' has a negative f: the image is taken as mirrored")
    fisheye = _is_fisheye(file)
    counts = (4,) if fisheye else COEFFICIENTS
    lens = file.numbers(distortion, counts, None if fisheye else np.zeros(0))
    if file.find(distortion) is None:
        file.notes.append(f"has no '{distortion}': the lens is taken as ideal")
    if not (fisheye or lens.any()):
        lens = np.zeros(0)
    return Pinhole(K, pose_in(file) if pose is None else pose, size, lens, fisheye)


def read_camera_and_projector(
    path: Path,
    camera_size: tuple[int, int] | None = None,
    projector_size: tuple[int, int] | None = None,
) -> tuple[Pinhole, Pinhole, CalibrationFile]:
    """A camera and a projector in one world, and the file that describes them.

    Where it has `projector_rotation` and `projector_translation` by these names, `rotation` and
    `translation` are the camera's in the world.  In others' files R and T, whatever their names, go
    from camera to projector, and the world is the camera's.

    Parameters
    ----------
    path : Path
    camera_size, projector_size : pair of int, optional
        Width and height, px, of files that don't have them.

    Raises
    ------
    InputError
        Naming the file, the element and what it should be.
    """
    file = CalibrationFile.read(path, ALSO_OF_BOTH)
    own = "projector_rotation" in file.elements
    if own:
        also = {k: v for k, v in ALSO_OF_BOTH.items() if not k.startswith("projector_")}
        file.also = also
    camera_pose = pose_in(file) if own else Pose(np.eye(3), np.zeros(3))
    between = pose_in(file, ("projector_rotation", "projector_translation"))
    if file.find("projector_rotation") is None:
        raise InputError(
            f"{path}: lacks 'projector_rotation' and 'projector_translation', from camera to"
            " projector (R and T of stereoCalibrate); add them"
        )
    camera = camera_in(file, size=_size(file, "image", camera_size), pose=camera_pose)
    projector = camera_in(
        file,
        matrix="projector_matrix",
        distortion="projector_distortion",
        size=_size(file, "projector", projector_size),
        pose=between.moved(camera_pose),
    )
    return camera, projector, file


def _size(file: CalibrationFile, name: str, given: tuple[int, int] | None) -> tuple[int, int]:
    if given is not None:
        return given
    if file.find(f"{name}_width") is None:
        what = "camera" if name == "image" else name
        raise InputError(
            f"{file.path}: lacks '{name}_width' and '{name}_height'; add them, or give {what}_size"
        )
    return pixels_in(file, f"{name}_width"), pixels_in(file, f"{name}_height")


def put_camera(storage: Any, camera: Pinhole) -> None:
    """Write a camera's elements, as `camera_in` reads them.

    A mirrored camera, whose axes are left-handed, has a negative f and right-handed axes there.

    Raises
    ------
    InputError
        Where a mirrored camera distorts, for which OpenCV has no model.
    """
    to_camera, matrix = camera.pose.rotation.T, camera.matrix
    if np.linalg.det(to_camera) < 0.0:
        if camera.distorts:
            raise InputError("calibration: of a mirrored camera that distorts there is no file")
        mirror = np.diag([-1.0, 1.0, 1.0])
        to_camera, matrix = mirror @ to_camera, matrix @ mirror
    storage.write("image_width", camera.size[0])
    storage.write("image_height", camera.size[1])
    storage.write("camera_matrix", matrix)
    storage.write("distortion_coefficients", distortion_row(camera))
    if camera.fisheye:
        storage.write("fisheye_model", 1)
    storage.write("rotation", np.ascontiguousarray(to_camera))
    storage.write("translation", -(to_camera @ camera.pose.origin_mm))


def distortion_row(camera: Pinhole) -> Array:
    """A distortion as files have it, (1, n): five zeros for none."""
    distortion = camera.distortion if camera.distortion.size else np.zeros(5)
    return distortion.reshape(1, -1)


def pixels_in(file: CalibrationFile, name: str) -> int:
    """A number of px."""
    (value,) = file.numbers(name, (1,), below=np.inf)
    if not (1.0 <= value <= LARGEST_PX and value == int(value)):
        raise InputError(f"{file.path}: '{name}' is {value:g}; give a whole number of px, from 1")
    return int(value)


def _is_fisheye(file: CalibrationFile) -> bool:
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


def pose_in(file: CalibrationFile, names: tuple[str, str] = ("rotation", "translation")) -> Pose:
    """Where a device stands: the inverse of a file's rotation and translation."""
    given = [file.find(name) is not None for name in names]
    if given.count(True) == 1:
        has, lacks = names[:: 1 if given[0] else -1]
        raise InputError(
            f"{file.path}: has '{has}' but no '{lacks}'; give both, or none where the world is the"
            " camera's"
        )
    if not any(given):
        first, second = names
        file.notes.append(f"has no '{first}' and '{second}': the world is the camera's")
    rotation = file.numbers(names[0], (3, 9), np.eye(3).ravel())
    to_camera = cv2.Rodrigues(rotation)[0] if rotation.size == 3 else rotation.reshape(3, 3)
    if not np.allclose(to_camera @ to_camera.T, np.eye(3), atol=_ORTHOGONAL):
        raise InputError(f"{file.path}: '{names[0]}' is no rotation; give a matrix with R R^T = 1")
    if np.linalg.det(to_camera) < 0.0:
        raise InputError(f"{file.path}: '{names[0]}' is a reflection; its determinant must be +1")
    pose = np.eye(4)
    pose[:3, :3] = to_camera.T
    turned = Pose.from_matrix(pose).rotation  # a file of few digits holds no exact rotation
    return Pose(turned, -turned @ file.numbers(names[1], (3,), np.zeros(3)))


def _numbers(value: Any, most: int = _MOST_NUMBERS) -> list[float]:
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
        rows.append(_numbers(each, most))
        length = len(rows[0])
        if not 0 < length <= most // len(rows) or len(rows[-1]) != length:
            raise ValueError("rows")  # YAML's references make much out of little
    return [number for row in rows for number in row]
