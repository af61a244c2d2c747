"""Which colour of an image shows a laser line."""

from __future__ import annotations

from collections.abc import Mapping

import cv2
import numpy as np
from numpy.typing import NDArray

from virtual_sensor.arrays import number_within

COLOURS = ("red", "green", "blue")

_SHORTEST_NM, _LONGEST_NM = 300.0, 1200.0  # that a silicon sensor sees
_CROSSINGS_NM = (490.0, 580.0)  # of the colour filters on sensors: blue to green, green to red
_LINE_PX, _AROUND_PX = 1.5, 12.0  # a line stands out in the one and is lost in the other
_PART = 99.9  # percentile: a line has more than a thousandth of the pixels
_COLOURED = 0.25  # of the line's height is what a coloured one has more than other colours


def colour_at(wavelength_nm: float) -> str:
    """The colour whose filter lets light of a wavelength through best.

    Raises
    ------
    InputError
        If no silicon sensor sees it.
    """
    nm = number_within(
        "wavelength_nm", wavelength_nm, _SHORTEST_NM, _LONGEST_NM, "it in nm, from 300 to 1200"
    )
    return COLOURS[2 - int(np.searchsorted(_CROSSINGS_NM, nm))]


def colour_of_line(channels: Mapping[str, NDArray]) -> str:
    """The colour that a line has more of than the others; green, if it has none.

    Where it is clipped, all colours may be; its flanks have its colour.
    """
    planes = {name: np.nan_to_num(channels[name].astype(np.float32)) for name in COLOURS}
    grey = sum(planes.values()) / np.float32(3.0)
    excess = {name: 1.5 * _height(plane - grey) for name, plane in planes.items()}
    most = max(COLOURS, key=excess.__getitem__)
    coloured = excess[most] > _COLOURED * max(map(_height, planes.values()))
    return most if coloured else "green"  # of which sensors have the most pixels


def _height(plane: NDArray[np.float32]) -> float:
    """How far a line stands out of what is around it."""
    line, around = (cv2.GaussianBlur(plane, (0, 0), sigma) for sigma in (_LINE_PX, _AROUND_PX))
    return float(np.percentile(line - around, _PART))
