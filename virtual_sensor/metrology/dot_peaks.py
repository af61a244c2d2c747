"""Centroids of laser dots: the paper's discrete laser rays as a camera sees them."""

from __future__ import annotations

from dataclasses import dataclass
from typing import ClassVar

import cv2
import numpy as np
from numpy.typing import ArrayLike, NDArray

from virtual_sensor.arrays import SMALLEST, number_within, whole_number
from virtual_sensor.calls import public
from virtual_sensor.display import Displayed, listed, span, tally
from virtual_sensor.metrology.line_profiles import (
    QUARTILE,
    checked_image,
    linear_of,
    saturation_level,
)
from virtual_sensor.statuses import StatusEnum

Array = NDArray[np.float64]

SMOOTHING_PX = 1.0  # sigma of the filter that the search for dots runs on
SIGNIFICANCE = 6.0  # a dot stands out by so many sigma of the smoothed image's noise
SAMPLE = 1 << 18  # so many pixels are enough for background and noise
SPLITS = (0.35, 0.5, 0.65, 0.8)  # relative heights at which two merged dots come apart


class DotStatus(StatusEnum):
    """Why a dot has a centre, or has none."""

    OK = 0, "The centre was found."
    TOO_SMALL = (
        1,
        "The dot has fewer pixels than min_area: lower it, or use larger dots or more pixels.",
    )
    AT_BORDER = (
        2,
        "The dot reaches the image's border: move the part or the camera so that it is seen whole.",
    )
    OVERLAPPING = 3, "Another dot is too near: use fewer or smaller dots."
    SATURATED = (
        4,
        "Pixels of the dot are clipped: expose less, or state the grey value at which the camera "
        "clips (saturation).",
    )
    BAD_PIXELS = (
        5,
        "Pixels of the dot are missing (NaN, infinite or masked): give the image without holes "
        "there.",
    )
    NO_CENTRE = (
        6,
        "Its surroundings are as bright as the dot, so there is no light whose centroid it would "
        "be: lower the background.",
    )


@dataclass(frozen=True)
class DotCentres(Displayed):
    """M dots by rising u; `pixel` and `flux` are NaN where `status` is not OK.

    Attributes
    ----------
    pixel : ndarray of shape (M, 2)
        Centroid (u, v) in px, integer at pixel centres.
    flux : ndarray of shape (M,)
        Sum over the dot above its background, in the image's unit.
    status : ndarray of shape (M,)
        `DotStatus` of each dot.
    """

    _field_units: ClassVar = {"pixel": "px"}
    _statuses: ClassVar = {"status": DotStatus}
    _by_row: ClassVar = True

    pixel: Array
    flux: Array
    status: NDArray[np.uint8]

    def _line(self) -> str:
        return listed(tally(self.status, DotStatus.OK), span("columns", self.pixel[:, 0]))


@public
def dot_centres(
    image: ArrayLike,
    *,
    threshold: float = 0.1,
    min_area: int = 5,
    saturation: float | None = None,
) -> DotCentres:
    """Find the intensity-weighted centroids of bright dots.

    A dot is a connected set of pixels above the threshold.  Its window is their box, grown by half
    its size on every side so that it holds the dot's skirt; the background is the median along the
    window's rim.  A dot with another within its box's size is OVERLAPPING, and so is one that comes
    apart at a greater height.

    Parameters
    ----------
    image : array_like of shape (H, W)
        Grey values: uint8, uint16, float32 or float64.  NaN and infinity mark missing pixels,
        as a NumPy mask does.
    threshold : float
        Height above the image's median at which a dot begins, relative to the brightest.
    min_area : int
        Fewest pixels of a dot above the threshold.
    saturation : float, optional
        Grey value from which on pixels are clipped; by default that of an integer image's type.

    Raises
    ------
    InputError
        Where the image is not a grey image of a known type, or `threshold` is not in (0, 1).
    """
    image = linear_of(image)
    clipped = saturation_level(image, saturation)
    image = checked_image(image)
    below_1 = np.nextafter(1.0, 0.0)
    number_within("dot_centres: threshold", threshold, SMALLEST, below_1, "it 0 < threshold < 1")
    whole_number("dot_centres: min_area", min_area, 1, 2**31 - 1)
    finite = np.isfinite(image)
    filled = np.where(finite, image, image[finite].min(initial=0)).astype(float)
    smooth = cv2.GaussianBlur(filled, (0, 0), SMOOTHING_PX, borderType=cv2.BORDER_REFLECT_101)
    some = smooth.ravel()[:: smooth.size // SAMPLE | 1]
    background = np.median(some)
    noise = np.median(np.abs(some - background)) / QUARTILE
    contrast = smooth - background
    rounding = 16.0 * np.finfo(float).eps * np.abs(smooth).max()
    lowest = max(threshold * contrast.max(), SIGNIFICANCE * noise, rounding)
    lit = (contrast > lowest).astype(np.uint8)
    count, label, boxes, _ = cv2.connectedComponentsWithStats(lit, connectivity=8)

    pixel, flux = np.full((count - 1, 2), np.nan), np.full(count - 1, np.nan)
    middle, status = np.zeros(count - 1), np.zeros(count - 1, np.uint8)
    for dot, box in enumerate(boxes[1:]):
        middle[dot] = box[cv2.CC_STAT_LEFT] + (box[cv2.CC_STAT_WIDTH] - 1) / 2.0
        window, in_view = _grown(box, 0.5, image.shape)
        surroundings, _ = _grown(box, 1.0, image.shape)
        others = lit[surroundings] & (label[surroundings] != dot + 1)
        if not finite[window].all():
            status[dot] = DotStatus.BAD_PIXELS
        elif (image[window] >= clipped).any():
            status[dot] = DotStatus.SATURATED
        elif box[cv2.CC_STAT_AREA] < min_area:
            status[dot] = DotStatus.TOO_SMALL
        elif not in_view:
            status[dot] = DotStatus.AT_BORDER
        elif others.any() or _comes_apart(contrast[window]):
            status[dot] = DotStatus.OVERLAPPING
        else:
            grey = image[window].astype(float)
            (u, v), light = _centroid(grey)
            inside = 0.0 <= u <= grey.shape[1] - 1 and 0.0 <= v <= grey.shape[0] - 1
            if not (light > 0.0 and inside):
                status[dot] = DotStatus.NO_CENTRE
                continue
            middle[dot] = window[1].start + u
            pixel[dot], flux[dot] = (middle[dot], window[0].start + v), light

    order = np.argsort(middle, kind="stable")
    return DotCentres(pixel[order], flux[order], status[order])


def _grown(box: NDArray, share: float, shape: tuple[int, ...]) -> tuple[tuple[slice, slice], bool]:
    """Grow a box by a share of its size on every side, and say whether the image holds it all."""
    left, top, width, height, _ = box
    rows, columns = int(np.ceil(share * height)), int(np.ceil(share * width))
    window = (
        slice(max(top - rows, 0), min(top + height + rows, shape[0])),
        slice(max(left - columns, 0), min(left + width + columns, shape[1])),
    )
    held = (window[0].stop - window[0].start, window[1].stop - window[1].start)
    return window, held == (height + 2 * rows, width + 2 * columns)


def _centroid(window: Array) -> tuple[Array, float]:
    """Centroid (u, v) within a window, and the flux, above the median of the window's rim."""
    rim = np.concatenate([window[0], window[-1], window[1:-1, 0], window[1:-1, -1]])
    signal = window - np.median(rim)
    flux = signal.sum()
    v, u = np.indices(window.shape)
    moments = np.array([(u * signal).sum(), (v * signal).sum()])
    return moments / (flux or np.nan), flux


def _comes_apart(contrast: Array) -> bool:
    """Whether the peak in a window falls into several at some height."""
    heights = contrast.max() * np.array(SPLITS)
    counts = (cv2.connectedComponents((contrast > h).astype(np.uint8))[0] for h in heights)
    return any(count > 2 for count in counts)
