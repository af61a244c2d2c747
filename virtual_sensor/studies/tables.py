"""Results as files that other programs read: CSV, JSON and PLY; and figures as people do."""

import json
from collections.abc import Mapping, Sequence
from enum import IntEnum
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import ArrayLike, NDArray

from virtual_sensor.files import written_whole

_SPECIAL = set(',"\r\n')


def write_csv(path: Path, columns: Mapping[str, ArrayLike]) -> None:
    """Write columns of equal length under their names; NaN stays empty.

    Numbers have 13 digits, in which a pixel of 1000 keeps its 1e-9 px; float32 has its nine.
    """
    cells = [[_cell(value) for value in np.asarray(values)] for values in columns.values()]
    lines = [",".join(columns), *(",".join(row) for row in zip(*cells, strict=True))]
    with written_whole(path) as temporary:
        temporary.write_text("\n".join(lines) + "\n", encoding="utf-8")


def _cell(value: object) -> str:
    if isinstance(value, (float, np.floating)):
        digits = 9 if isinstance(value, np.float32) else 13
        return "" if np.isnan(value) else f"{value:.{digits}g}"
    text = str(value)
    return '"' + text.replace('"', '""') + '"' if _SPECIAL & set(text) else text


def write_json(path: Path, value: Any) -> None:
    """Write dictionaries, sequences, texts and numbers, NumPy's too; NaN and infinity are null."""
    text = json.dumps(_valid(value), indent=2, ensure_ascii=False, allow_nan=False)
    with written_whole(path) as temporary:
        temporary.write_text(text + "\n", encoding="utf-8", errors="backslashreplace")


def _valid(value: Any) -> Any:
    """The same as JSON knows it."""
    if isinstance(value, np.ndarray | np.generic):
        value = value.tolist()
    if isinstance(value, Mapping):
        return {str(key): _valid(each) for key, each in value.items()}
    if isinstance(value, list | tuple):
        return [_valid(each) for each in value]
    if isinstance(value, float) and not np.isfinite(value):
        return None
    return value


def in_words(value: float | None, shape: str = "{:.4f}") -> str:
    """A figure as people read it; "none" where there is no answer."""
    return "none" if value is None or np.isnan(value) else shape.format(value)


def status_names(status: ArrayLike, kind: type[IntEnum]) -> NDArray[np.str_]:
    """Names of status numbers, in lower case."""
    return np.array([kind(n).name.lower() for n in np.asarray(status).ravel()], np.str_)


def vectors(name: str, values: NDArray[np.floating], axes: Sequence[str]) -> dict[str, ArrayLike]:
    """Columns ``name_x``, ... of an array (N, len(axes))."""
    return {f"{name}_{axis}": values[:, i] for i, axis in enumerate(axes)}


def write_ply(path: Path, points_mm: NDArray[np.floating], intensity: NDArray[np.floating]) -> None:
    """Write the finite points (N, 3) in mm, world frame, with an intensity (N,) as binary PLY."""
    kept = np.isfinite(points_mm).all(axis=1)
    vertex = np.zeros(int(kept.sum()), [(n, "<f4") for n in ("x", "y", "z", "intensity")])
    for i, name in enumerate("xyz"):
        vertex[name] = points_mm[kept, i]
    vertex["intensity"] = intensity[kept]
    header = (
        "ply\nformat binary_little_endian 1.0\ncomment points in mm, world frame\n"
        f"element vertex {len(vertex)}\n"
        + "".join(f"property float {name}\n" for name in vertex.dtype.names or ())
        + "end_header\n"
    )
    with written_whole(path) as temporary:
        temporary.write_bytes(header.encode("ascii") + vertex.tobytes())
