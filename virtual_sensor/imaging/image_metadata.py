"""What an image's file says of how its grey values came about, as JSON.

=======================  ========================================================================
PNG                      text "virtual_sensor"
TIFF                     ImageDescription: an object with the key "virtual_sensor"
OpenEXR                  attribute "virtual_sensor"
``NAME.json`` beside it  NAME being the image's with its ending: the object itself; for files of
                         any kind, and of any camera.  What it says goes before the image's own
=======================  ========================================================================

Detectors want of it `noise` (standard deviation of dark grey values), `gain` (grey values per
electron), `saturation` (grey value from which on pixels are clipped) and `black` (grey value in the
dark); `bits` are the camera's.
"""

from __future__ import annotations

import json
from collections.abc import Mapping
from pathlib import Path
from typing import Any

from virtual_sensor.arrays import number_within, whole_number
from virtual_sensor.errors import InputError, short
from virtual_sensor.files import exists, readable
from virtual_sensor.records import plain

KEY = "virtual_sensor"
BITS = "bits"

_LEAST = {"noise": 0.0, "gain": 0.0, "saturation": 0.0, "black": -1e9}
_MOST = 1e9
_MOST_BYTES = 1 << 24


def text_of(metadata: Mapping[str, Any]) -> str:
    """The metadata as a line of JSON, ASCII.

    Raises
    ------
    InputError
        If JSON can't say it.
    """
    try:
        return json.dumps(plain(metadata), allow_nan=False)
    except (TypeError, ValueError, RecursionError) as error:
        raise InputError(f"metadata can't be written as JSON ({error})") from None


def metadata_of(text: Any) -> dict[str, Any] | None:
    """The metadata that a text holds; None if it holds none."""
    if not isinstance(text, str) or not text.lstrip().startswith("{"):
        return None
    try:
        found = json.loads(text)
    except (ValueError, RecursionError):
        return None
    return found if isinstance(found, dict) else None


def described(text: Any) -> dict[str, Any] | None:
    """The metadata in a TIFF's description; other programs write JSON there too."""
    found = (metadata_of(text) or {}).get(KEY)
    return found if isinstance(found, dict) else None


def sidecar_of(path: Path) -> Path:
    """File beside an image that describes it."""
    return path.with_name(f"{path.name}.json")


def read_sidecar(path: Path) -> dict[str, Any] | None:
    """What a file beside an image says of it; None if there is none.

    Raises
    ------
    InputError
        If it can't be read.
    """
    beside = sidecar_of(path)
    if not exists(beside):
        return None
    text = ""
    if readable(beside).stat().st_size <= _MOST_BYTES:
        try:
            text = beside.read_text(encoding="utf-8")
        except UnicodeDecodeError:
            text = ""
    found = metadata_of(text)
    if found is None:
        raise InputError(
            f'{beside}: is no JSON object, such as {{"noise": 2.4, "gain": 0.37}}; mend it, or'
            f" take it away from beside {path.name}"
        )
    return found


def detector_options_of(metadata: Mapping[str, Any], remarks: list[str]) -> dict[str, float]:
    """What detectors want of it; a remark on what can't be."""
    found: dict[str, float] = {}
    for name, least in _LEAST.items():
        value = metadata.get(name)
        if value is None:
            continue
        try:
            found[name] = number_within(name, value, least, _MOST, "")
        except InputError:
            remarks.append(f"says that its {name} is {short(value)}, which can't be: not used")
    return found


def bits_of(metadata: Mapping[str, Any]) -> int | None:
    """The camera's, if they are said."""
    try:
        return whole_number(BITS, metadata.get(BITS), 1, 32)
    except InputError:
        return None
