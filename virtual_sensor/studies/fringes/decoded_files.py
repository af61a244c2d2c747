"""Decoded fringes as files: float32 layers of OpenEXR, which are read again to the bit."""

from __future__ import annotations

import json
from collections.abc import Mapping
from pathlib import Path
from typing import Any

import numpy as np
import OpenEXR
from numpy.typing import NDArray

from virtual_sensor.errors import InputError
from virtual_sensor.files import readable
from virtual_sensor.metrology.fringes.decoded import DecodedFringes
from virtual_sensor.records import Described, plain, write_layers

Image = NDArray[np.float32]

LAYERS = (
    Described(
        "projector.u, projector.v",
        "px",
        "Column and row of the projector's image, integers at its pixel centres; NaN where there is"
        " none. An axis that was not projected has no layer, nor those below.",
    ),
    Described("sigma.u, sigma.v", "px", "Their predicted standard deviations."),
    Described("phase.u, phase.v", "rad", "Wrapped phases of the finest period, 0 to 2 pi."),
    Described("modulation", "", "Amplitude of the finest fringes, as grey values."),
    Described("mean", "", "Mean grey value."),
    Described("status", "", "Number of the `FringeStatus`: why there is a projector pixel."),
)
"""Layers of a file of decoded fringes, float32."""

_FACTS = "virtual_sensor/decoded"  # attribute of the file: what is no image, as JSON


def write_decoded(
    path: Path,
    decoded: DecodedFringes,
    more: Mapping[str, Image] | None = None,
    header: Mapping[str, str] | None = None,
) -> None:
    """Write decoded fringes, with more layers (H, W) and attributes beside them.

    Raises
    ------
    InputError
        If the file can't be written.
    """
    layers: dict[str, NDArray[Any] | None] = {
        "projector.u": decoded.column,
        "projector.v": decoded.row,
        "sigma.u": decoded.sigma_column,
        "sigma.v": decoded.sigma_row,
        **{f"phase.{axis}": phase for axis, phase in decoded.phase.items()},
        "modulation": decoded.modulation,
        "mean": decoded.mean,
        "status": decoded.status,
        **(more or {}),
    }
    facts = {name: getattr(decoded, name) for name in _NO_IMAGES}
    write_layers(path, layers, {_FACTS: json.dumps(plain(facts)), **(header or {})})


_NO_IMAGES = ("size_px", "absolute", "wrong_orders", "noise", "notes")


def holds_decoded(path: Path) -> bool:
    """Whether a file is one of decoded fringes."""
    try:
        return _FACTS in OpenEXR.File(str(readable(path)), header_only=True).header()
    except (InputError, RuntimeError, KeyError):
        return False


def read_decoded(path: Path) -> DecodedFringes:
    """Read what `write_decoded` wrote.

    Raises
    ------
    InputError
        If the file can't be read, or is another.
    """
    try:
        file = OpenEXR.File(str(readable(path)), separate_channels=True)
        layers = {name: channel.pixels for name, channel in file.channels().items()}
        facts = json.loads(file.header()[_FACTS])
        modulation, mean, status = (layers[name] for name in ("modulation", "mean", "status"))
    except InputError:
        raise
    except (RuntimeError, KeyError, ValueError, TypeError) as error:
        raise InputError(
            f"{path}: holds no decoded fringes ({error}); give the .exr file of a folder of"
            " `fringes`"
        ) from None
    others: dict[str, Any] = {
        name: tuple(v) if isinstance(v := facts[name], list) else v for name in _NO_IMAGES
    }
    column, row = (layers.get(f"projector.{axis}") for axis in "uv")
    return DecodedFringes(
        column=None if column is None else column.astype(float),
        row=None if row is None else row.astype(float),
        sigma_column=layers.get("sigma.u"),
        sigma_row=layers.get("sigma.v"),
        modulation=modulation,
        mean=mean,
        phase={axis: layers[f"phase.{axis}"] for axis in "uv" if f"phase.{axis}" in layers},
        status=status.astype(np.uint8),
        **others,
    )
