"""Calibrations by OpenCV's own writer and by hand, with points that OpenCV projects."""

from __future__ import annotations

import io
import json
from dataclasses import dataclass
from typing import Any

import cv2
import numpy as np
import yaml
from hostile.cases import Case, Result
from hostile.mutations import (
    ENCODINGS,
    GARBAGE,
    cut,
    encoded,
    flipped,
    lines_changed,
    numbers_changed,
    words_changed,
)
from hypothesis import strategies as st

SIZE = (640, 480)
NEAR_MM = 1e-3
FAR_MM = 1e7  # a pixel whose line of sight is nearly in the laser's plane has a point so far away
K = np.array([[900.0, 0.0, 322.5], [0.0, 905.0, 238.25], [0.0, 0.0, 1.0]])
_TURN = np.array([[0.1], [0.35], [-0.2]])
_SHIFT = np.array([[5.0], [-3.0], [400.0]])
_PLANE = np.array([0.0, 0.3, 1.0, 2.0])
_RADIAL = np.array([[-0.1, 0.02, 0.001, -0.0005, 0.003]])
_FISHEYE = np.array([[0.05, -0.02, 0.01, -0.003]])


@dataclass(frozen=True)
class Model:
    """What a calibration says, and what it means.

    Attributes
    ----------
    elements : dict
        By name.
    points, pixels : ndarray
        On the laser plane, world, mm; and where OpenCV sees them.
    plain : bool
        Whether it must be read.
    """

    elements: dict[str, Any]
    points: np.ndarray
    pixels: np.ndarray
    plain: bool
    label: str


def _model(
    lens: str, posed: bool, names: dict[str, str], more: dict[str, Any], label: str
) -> Model:
    turn, shift = (_TURN, _SHIFT) if posed else (np.zeros((3, 1)), np.zeros((3, 1)))
    plane = _PLANE if posed else np.array([0.6, 0.0, 0.8, 240.0])
    grid = np.stack(np.meshgrid([-60.0, 0.0, 45.0], [-50.0, 10.0, 40.0]), -1).reshape(-1, 2)
    points = np.column_stack([grid, (plane[3] - grid @ plane[:2]) / plane[2]])
    if lens == "fisheye":
        pixels = cv2.fisheye.projectPoints(points[:, None], turn, shift, K, _FISHEYE[0])[0]
    else:
        pixels = cv2.projectPoints(points, turn, shift, K, _RADIAL if lens else None)[0]
    elements: dict[str, Any] = {"image_width": SIZE[0], "image_height": SIZE[1]}
    elements["camera_matrix"] = K
    if lens:
        elements["distortion_coefficients"] = _FISHEYE if lens == "fisheye" else _RADIAL
    if posed:
        elements["rotation"] = cv2.Rodrigues(turn)[0] if label != "vector" else turn
        elements["translation"] = shift
    elements["laser_plane"] = plane
    renamed = {names.get(name, name): value for name, value in elements.items()}
    plain = not names and not more
    return Model(renamed | more, points, pixels.reshape(-1, 2), plain, label)


MODELS = (
    _model("radial", True, {}, {}, "radial"),
    _model("radial", True, {}, {}, "vector"),
    _model("", True, {}, {}, "pinhole"),
    _model("radial", False, {}, {}, "no pose"),
    _model("fisheye", True, {}, {"fisheye_model": 1}, "fisheye"),
    _model("fisheye", True, {}, {"distortion_model": "equidistant"}, "equidistant"),
    _model("radial", True, {}, {"distortion_model": "plumb_bob"}, "plumb_bob"),
    _model("radial", True, {"distortion_coefficients": "dist_coeffs"}, {}, "dist_coeffs"),
    _model("radial", True, {"rotation": "R", "translation": "T"}, {}, "R T"),
    _model("radial", True, {"camera_matrix": "K"}, {}, "K"),
    _model("radial", True, {"translation": "shift"}, {}, "no translation"),
    _model("radial", True, {"rotation": "turn"}, {}, "no rotation"),
    _model("radial", True, {}, {"distortion_model": "rational_magic"}, "unknown model"),
    _model("radial", True, {}, {"camera_name": "é", "rectification_matrix": np.eye(3)}, "more"),
)


def opencv(elements: dict[str, Any], ending: str) -> str:
    """By `cv2.FileStorage`."""
    storage = cv2.FileStorage(ending, cv2.FILE_STORAGE_WRITE | cv2.FILE_STORAGE_MEMORY)
    for name, value in elements.items():
        storage.write(name, value)
    return storage.releaseAndGetString()


def ros(elements: dict[str, Any], ending: str) -> str:
    """As ROS writes it, by PyYAML or Python's json: matrices as rows, cols and data."""
    plain: dict[str, Any] = {}
    for name, value in elements.items():
        if isinstance(value, np.ndarray) and value.ndim == 2:
            rows, cols = value.shape
            plain[name] = {"rows": rows, "cols": cols, "data": value.ravel().tolist()}
        else:
            plain[name] = value.tolist() if isinstance(value, np.ndarray) else value
    if ending == ".json":
        return json.dumps(plain, indent=1)
    file = io.StringIO()
    yaml.safe_dump(plain, file, sort_keys=False, default_flow_style=None)
    return file.getvalue()


def nested(elements: dict[str, Any], _: str) -> str:
    """JSON of lists in lists."""
    return json.dumps(
        {n: v.tolist() if isinstance(v, np.ndarray) else v for n, v in elements.items()}
    )


@st.composite
def texts(draw, model: Model):
    """A whole text, its name's ending, and whether it must be read."""
    order = draw(st.permutations(list(model.elements)))
    elements = {name: model.elements[name] for name in order}
    writer = draw(st.sampled_from((opencv, opencv, ros, nested)))
    endings = {opencv: (".yaml", ".yml", ".xml", ".json"), ros: (".yaml", ".json")}
    ending = draw(st.sampled_from(endings.get(writer, (".json",))))
    return writer(elements, ending), ending, writer is opencv and model.plain


def judged(model: Model, removed: str = ""):
    """Whether the points are those that OpenCV projected; a note may say what is not used.

    `removed`: a note must name it, where the points differ.
    """

    def judge(result: Result) -> str:
        away = np.linalg.norm(result["points"] - model.points, axis=1)
        if not (away > NEAR_MM).any():
            return ""
        if result["notes"] and not removed:
            return ""
        if removed and any(removed in note for note in result["notes"]):
            return ""
        return f"points are up to {np.nanmax(away):.3g} mm off; notes {result['notes']}"

    return judge


def possible(result: Result) -> str:
    """Whether they are points at all."""
    points = result["points"]
    if np.isinf(points).any():
        return "a point is infinitely far away"
    return ""


HOSTILE = (
    b"%YAML:1.0\n---\na: &a [*a]\n",
    b"%YAML:1.0\n---\nimage_width: !!binary |\n  AAAA\n",
    b"<?xml version='1.0'?><!DOCTYPE a [<!ENTITY b 'c'>]><opencv_storage>&b;</opencv_storage>",
    b"<?xml version='1.0'?><opencv_storage><a type_id='opencv-matrix'/></opencv_storage>",
    b'{"camera_matrix": {"type_id": "opencv-matrix", "rows": 99999, "cols": 99999, "dt": "d",'
    b' "data": [1]}}',
    b'{"camera_matrix": {"type_id": "opencv-matrix", "rows": -1, "cols": 3, "dt": "q", "data": 1}}',
)


@st.composite
def deep(draw):
    """A hundred thousand brackets, or fewer."""
    depth = draw(st.sampled_from((10, 200, 1000, 100_000)))
    ending = draw(st.sampled_from((".json", ".yaml", ".xml")))
    if ending == ".json":
        text = '{"camera_matrix": ' + "[" * depth + "]" * depth + "}"
    elif ending == ".yaml":
        text = "%YAML:1.0\n---\ncamera_matrix: " + "[" * depth + "]" * depth
    else:
        depth = min(depth, 20_000)
        inside = "<a>" * depth + "</a>" * depth
        text = f"<?xml version='1.0'?>\n<opencv_storage>{inside}</opencv_storage>"
    return text.encode(), ending


@st.composite
def cases(draw):
    """A calibration that is whole, or spoilt."""
    model = draw(st.sampled_from(MODELS))
    text, ending, plain = draw(texts(model))
    hows = ("whole", "cut", "cut", "keys", "edited", "edited", "encoded", "garbage", "deep")
    how = draw(st.sampled_from(hows))
    judge, data = judged(model), text.encode()
    if how == "cut":
        data = draw(cut(data))
        judge = judged(model)
    elif how == "keys":
        name = draw(st.sampled_from(list(model.elements)))
        letter = draw(st.integers(0, len(name) - 1))
        other = name[:letter] + draw(st.sampled_from("xq_1")) + name[letter + 1 :]
        data = text.replace(name, other).encode()
    elif how == "edited":
        change = draw(st.sampled_from((numbers_changed, words_changed, lines_changed, flipped)))
        made = draw(change(data if change is flipped else text))
        data, judge = made if isinstance(made, bytes) else made.encode("utf-8", "replace"), possible
    elif how == "encoded":
        if draw(st.booleans()):
            data = text.encode(draw(st.sampled_from(ENCODINGS)))
        else:
            data, judge = draw(encoded(text)), possible
    elif how == "garbage":
        data, judge = draw(GARBAGE | st.sampled_from(HOSTILE)), possible
    elif how == "deep":
        (data, ending), judge = draw(deep()), possible
    return Case(
        "calibration",
        f"{model.label}/{how}",
        {f"sensor{ending}": data},
        f"sensor{ending}",
        judge,
        {"pixels": model.pixels},
        must_be_read=how == "whole" and plain,
    )
