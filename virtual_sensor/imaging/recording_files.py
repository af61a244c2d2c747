"""A recorded frame as files: grey values, the ideal frame, the truth, and what made them.

===============  ==================================================================================
File             What it holds
===============  ==================================================================================
``frame.png``    Grey values, with their gain, noise, saturation and black level: `image_metadata`;
                 or ``frame.tif``.  Of a sequence ``frame_00.png``, ``frame_01.png``, ...; of a
                 difference also the two, ``frame_on.png`` and ``frame_off.png``
``ideal.exr``    Radiance and ground truth of the pixels: `render.EXR_LAYERS`.  Of a sequence
                 ``ideal_00.exr``, ...; those behind the first hold the radiance alone
``truth.csv``    The line in each column: `ColumnTruth`; of several lasers ``truth_0_NAME.csv``, ...
``summary.json`` What made it: `RecordedFrame.metadata`
===============  ==================================================================================
"""

from __future__ import annotations

import re
from pathlib import Path
from typing import Any

import numpy as np

from virtual_sensor.arrays import one_of, truth_of
from virtual_sensor.errors import InputError
from virtual_sensor.files import RESULTS_SIGN, check_output, folder_written_whole, path_of
from virtual_sensor.imaging.image_files import save_png, save_tiff
from virtual_sensor.imaging.image_metadata import text_of
from virtual_sensor.imaging.render import Frame, write_exr
from virtual_sensor.imaging.sequence import PatternFrames
from virtual_sensor.records import write_csv, write_json, write_layers

_WRITERS = {".png": save_png, ".tif": save_tiff, ".tiff": save_tiff}


def write_recording(
    shot: Any, path: str | Path, images: str = "png", overwrite: bool = False
) -> Path:
    """Write a `RecordedFrame`: see `RecordedFrame.write`."""
    path = path_of("write: path", path)
    truth_of("write: overwrite", overwrite)
    one_of("write: images", images, ("png", "tif"))
    if path.suffix.lower() in _WRITERS and not path.is_dir():
        if shot.grey.ndim != 2:
            raise InputError(
                f"{path}: holds one image, and these are {len(shot.grey)}; name a folder, such as"
                f" {path.with_suffix('')}"
            )
        check_output(path, overwrite)
        return _WRITERS[path.suffix.lower()](shot, path)
    if path.suffix and not path.is_dir():
        raise InputError(
            f"{path}: a recorded frame is written as .png or .tif, or with its truth into a folder:"
            " name one without a suffix"
        )
    with folder_written_whole(path, overwrite) as place:
        _fill(shot, place, images)
    return path


def _fill(shot: Any, place: Path, images: str) -> None:
    """Write all files into a folder."""
    ideal, grey, metadata = shot.ideal, shot.grey, shot.metadata
    header = {"scene": metadata["scene"], "parameters": text_of(metadata["parameters"])}
    many = grey.ndim == 3
    digits = max(2, len(f"{len(grey) - 1}"))
    names = [f"_{number:0{digits}d}" for number in range(len(grey))] if many else [""]
    write = _WRITERS[f".{images}"]
    for number, name in enumerate(names):
        one = grey[number] if many else grey
        write(one, place / f"frame{name}.{images}", sensor=shot.sensor, metadata=metadata)
        frame = ideal.frame(0) if isinstance(ideal, PatternFrames) and not number else ideal
        exr = place / f"ideal{name}.exr"
        if isinstance(frame, Frame):
            write_exr(exr, frame, header)
        else:
            radiance = np.asarray(frame)
            write_layers(exr, {"Y": radiance[number] if many else radiance}, header)
    for name in ("on", "off"):
        if (one := getattr(shot, f"{name}_grey", None)) is not None:
            known = shot.on.metadata
            write(one, place / f"frame_{name}.{images}", sensor=shot.on_sensor, metadata=known)
    lines = list(ideal.radius_mm) if isinstance(ideal, Frame) else []
    for number, line in enumerate(lines):
        own = f"_{number}_{re.sub(r'[^A-Za-z0-9-]', '_', line)}" if len(lines) > 1 else ""
        write_csv(place / f"truth{own}.csv", shot.line_truth(line))
    write_json(place / RESULTS_SIGN, metadata)
