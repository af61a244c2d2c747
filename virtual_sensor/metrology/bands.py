"""Lines of several sources in one image, separated by the bands in which they are expected.

The light of the others is taken out of the image before the line of one is sought, so that
detectors find what they would find in an image of that one alone.  Where two bands meet, it is
unknown whose light a pixel has: such columns are OVERLAPPING.
"""

from collections.abc import Mapping
from functools import reduce
from typing import Any

import numpy as np
from numpy.typing import ArrayLike, NDArray
from scipy.ndimage import maximum_filter1d

from virtual_sensor.errors import InputError
from virtual_sensor.metrology.centres import LineCentres, Status, is_measured
from virtual_sensor.metrology.detectors import COLUMNWISE, Foreign
from virtual_sensor.metrology.line_peaks import line_centres
from virtual_sensor.metrology.line_profiles import checked_image, saturation_level

Mask = NDArray[np.bool_]
Index = NDArray[np.intp]


def lines_in_bands(
    image: ArrayLike,
    bands: Mapping[str, ArrayLike],
    method: str | Foreign = "gaussian",
    *,
    along: str = "columns",
    saturation: float | None = None,
    **options: Any,
) -> dict[str, LineCentres]:
    """Find the line of each source within its band.

    Parameters
    ----------
    image : array_like of shape (H, W)
    bands : mapping from str to array_like of bool of shape (H, W)
        By source, the pixels in which its light is expected: wide enough for the whole profile and
        for what is not known of its place.  See `TrueLine.band`, or a frame's pixels that are lit.
    method, along, saturation, **options
        See `line_centres`.

    Returns
    -------
    dict from str to LineCentres
        By source.  Columns in which two bands meet are OVERLAPPING in both; what is found off its
        own band is NO_PEAK.

    Raises
    ------
    InputError
        Where a band is not of the image's shape, or as `line_centres` does.
    """
    saturation = saturation_level(image, saturation)
    image = checked_image(image)
    masks = {name: _checked(name, band, image.shape) for name, band in bands.items()}
    if along == "rows":
        image, masks = image.T, {name: band.T for name, band in masks.items()}
    goes_along = not (isinstance(method, str) and method in COLUMNWISE)
    found = {}
    for name, own in masks.items():
        others = [band for other, band in masks.items() if other != name]
        hidden = reduce(np.logical_or, others, np.zeros_like(own))
        meets = _meets(own, hidden)
        # What is left of a line where others are taken out would be called cut, and its neighbours.
        lit = _without(image, hidden | (own & meets), hidden | own)
        # The band tells which light is the line's.
        line = line_centres(lit, method, saturation=saturation, **{"choose": "highest", **options})
        if goes_along:  # within a band's breadth of where the line is taken out
            breadth = int(own.sum(axis=0).max(initial=0))
            meets = maximum_filter1d(meets, 2 * breadth + 1)
        line = _within(line, own, meets)
        found[name] = line.transposed if along == "rows" else line
    return found


def _checked(name: str, band: ArrayLike, shape: tuple[int, ...]) -> Mask:
    mask: Mask = np.asarray(band)
    if mask.shape != shape or mask.dtype != bool:
        raise InputError(
            f"lines_in_bands: the band of '{name}' is of shape {mask.shape} and type {mask.dtype};"
            f" give a mask (bool) of the image's shape, {shape}"
        )
    return mask


def _meets(own: Mask, others: Mask) -> Mask:
    """Columns (W,) in which pixels of the one lie next to those of the others, or are the same."""
    meeting = own & others
    meeting[:-1] |= own[:-1] & others[1:]
    meeting[1:] |= own[1:] & others[:-1]
    found: Mask = np.logical_or.reduce(meeting)
    return found


def _without(image: NDArray, hidden: Mask, bands: Mask) -> NDArray:
    """The image with hidden pixels filled by what lies beside them in their columns, mirrored.

    So they are as bright and as noisy as their surroundings. What lies in a band is not mirrored.
    """
    height = len(image)
    column, at = np.nonzero(hidden.T)
    begins = np.diff(at + (height + 1) * column, prepend=-2) != 1  # a run of hidden pixels
    ends = np.append(begins[1:], True)[: at.size]
    run = np.cumsum(begins) - 1
    up, down = at[begins][run] - 1, at[ends][run] + 1
    nearer = (at - up <= down - at) & (up >= 0) | (down == height)
    edges = np.where(nearer, up, down), np.where(nearer, down, up)
    source = edges[0].clip(0, height - 1)  # where nothing else is left
    for edge in edges[::-1]:  # what is better is written last
        mirrored = 2 * edge - at + np.sign(at - edge)
        usable = (edge >= 0) & (edge < height) & (mirrored >= 0) & (mirrored < height)
        usable &= ~bands[mirrored.clip(0, height - 1), column]
        source = np.where(usable, mirrored, source)
    filled = image.copy()
    filled[at, column] = np.where(hidden[source, column], 0, image[source, column])
    return filled


def _within(line: LineCentres, own: Mask, meets: Mask) -> LineCentres:
    """The centres within their own band; columns in which it meets another are OVERLAPPING."""
    height, width = own.shape
    status = line.status.copy()
    column = np.rint(np.nan_to_num(line.column)).astype(int).clip(0, width - 1)
    row = np.rint(np.nan_to_num(line.row)).astype(int).clip(0, height - 1)
    expected: Mask = np.logical_or.reduce(own)
    off = is_measured(status) & ~own[row, column] | ~expected[column]
    status[off] = Status.NO_PEAK
    status[meets[column]] = Status.OVERLAPPING
    return line.judged(status)
