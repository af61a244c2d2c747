"""Profiles across the points of lines of any direction, judged as columns of an image are."""

import cv2
import numpy as np
from numpy.typing import NDArray

from virtual_sensor.metrology.centres import Status
from virtual_sensor.metrology.line_profiles import Array, Index, Noise, Peaks
from virtual_sensor.metrology.line_shapes import shapes

_SEEN_ACROSS = 5.0  # widths either side
_WIDEST = 30_000


def across(
    grey: NDArray[np.float32], pixel: Array, found: Array, noise: Noise, max_sigma: float
) -> Index:
    """Status of points (N,) by their profiles across the line, as of columns of an image.

    A step of the background does not count.
    """
    _, _, width, amplitude, background, angle = found
    half = int(np.ceil(_SEEN_ACROSS * width.max(initial=1.0)))
    away = np.arange(-half, half + 1)[:, None]
    normal = np.radians(angle)
    places = [
        (middle + away * step).astype(np.float32)
        for middle, step in zip(pixel.T, (np.cos(normal), np.sin(normal)), strict=True)
    ]
    parts = [  # OpenCV's images may be no wider
        cv2.remap(grey, u, v, cv2.INTER_CUBIC, borderMode=cv2.BORDER_REPLICATE)
        for u, v in zip(
            *(np.array_split(p, len(pixel) // _WIDEST + 1, 1) for p in places), strict=True
        )
    ]
    blank = np.full((4, len(pixel)), np.nan)
    number, middle = np.arange(len(pixel)), np.full(len(pixel), half)
    shape_of_each = (width, amplitude, background, background, np.zeros(len(pixel)), *blank)
    peaks = Peaks(number, np.zeros_like(number), middle, middle.astype(float), *shape_of_each)
    column = np.clip(np.rint(pixel[:, 0]).astype(int), 0, noise.dark.size - 1)
    own = Noise(noise.dark[column], noise.gain, known=True)
    shape = shapes(np.ascontiguousarray(np.concatenate(parts, axis=1)), peaks, own, max_sigma)
    wrong = (shape.skewed | shape.flat) & ~shape.stepped
    reasons = {Status.CUT: wrong & shape.sharp, Status.SKEWED: wrong}
    return np.select(list(reasons.values()), list(reasons), Status.OK)


def along_lines(pixel: Array, shape: tuple[int, ...]) -> Index:
    """An order of points (N,) in which those of one line follow each other."""
    u, v = np.rint(pixel).astype(int).T
    mask = np.zeros(shape, np.uint8)
    mask[v, u] = 1
    label = cv2.connectedComponents(mask)[1][v, u]
    slant = np.zeros(len(pixel))
    for line in np.unique(label):
        own = label == line
        extent = np.ptp(pixel[own], axis=0)
        slant[own] = pixel[own, int(extent[1] > extent[0])]
    return np.lexsort((slant, label))
