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
_LEAST = 1e-3  # of the brightest pixel: less is rounding
_PIXELS = 1e6  # are enough to tell
_RIM_PX = 13  # a clipped line is white, and coloured beside it
_CORE = 90.0  # percentile of what lies so near, beside which the line is


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
    """The colour in which a line stands out most; green, if the image has no coloured line.

    It is that of the laser, but where that is clipped, or lost in its own scattered light.
    """
    planes = {name: _coarse(channels[name]) for name in COLOURS}
    top = max(float(np.abs(plane).max()) for plane in planes.values()) or 1.0
    heights = {name: _heights((plane / top).astype(np.float32)) for name, plane in planes.items()}
    grey = sum(heights.values()) / np.float32(3.0)
    excess = {name: 1.5 * (height - grey) for name, height in heights.items()}
    most = {name: float(np.percentile(each, _PART)) for name, each in excess.items()}
    laser = max(COLOURS, key=most.__getitem__)
    highest = max(float(np.percentile(height, _PART)) for height in heights.values())
    if most[laser] <= max(_COLOURED * highest, _LEAST):
        return "green"  # of which sensors have the most pixels
    coloured = (excess[laser] >= 0.5 * most[laser]).astype(np.uint8)
    near = cv2.dilate(coloured, np.ones((_RIM_PX, _RIM_PX), np.uint8)) > 0
    return max(COLOURS, key=lambda name: float(np.percentile(heights[name][near], _CORE)))


def _coarse(plane: NDArray) -> NDArray[np.float64]:
    """A large image's mean over cells, which show as well where a line is; missing pixels are 0."""
    cells = int(max((plane.size / _PIXELS) ** 0.5, 1.0))
    values = plane.astype(np.float64)
    values[~np.isfinite(values)] = 0.0
    if cells == 1:
        return values
    height, width = (max(side // cells, 1) for side in plane.shape)
    return cv2.resize(values, (width, height), interpolation=cv2.INTER_AREA)


def _heights(plane: NDArray[np.float32]) -> NDArray[np.float32]:
    """How far each pixel stands out of what is around it, as a line does."""
    line, around = (cv2.GaussianBlur(plane, (0, 0), sigma) for sigma in (_LINE_PX, _AROUND_PX))
    return line - around
