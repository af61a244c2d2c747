"""What is true of a laser's line in each column of a recorded frame."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray
from scipy.special import ndtr

from virtual_sensor.devices.camera import LensCamera
from virtual_sensor.devices.sheet_rows import crossings, run_of
from virtual_sensor.imaging.render import Frame
from virtual_sensor.optics.lens import circle_of_confusion
from virtual_sensor.records import Table

Array = NDArray[np.float64]

_DISC = 4.0  # diameters of an evenly lit disc in its standard deviation along an axis


@dataclass(frozen=True)
class ColumnTruth(Table):
    """The line in each column that it crosses; where a column sees it twice, it has two rows.

    Attributes
    ----------
    column : ndarray of int of shape (N,)
        Of the image.
    row_px : ndarray of shape (N,)
        v of the sheet's middle at the column's middle, along chief rays.
    width_px : ndarray of shape (N,)
        Standard deviation along the column of a sharp line with the laser's radius and a Gaussian
        profile; without the smear of a part that moves.
    blur_px : ndarray of shape (N,)
        Standard deviation of the lens's blur along the column, out of focus; 0 of a pinhole.
    electrons : ndarray of shape (N,)
        Mean electrons of the line's direct light in the column, where lamps and glow are known
        without theirs; light of other lasers that falls there is in it.
    visibility : ndarray of shape (N,)
        Which part of a Gaussian profile the camera sees there: less than 1 at edges.
    """

    column: NDArray[np.int64]
    row_px: Array
    width_px: Array
    blur_px: Array
    electrons: Array
    visibility: Array


def column_truth(
    frame: Frame, camera: LensCamera, light: NDArray[np.floating], source: str
) -> ColumnTruth:
    """The truth of a source's line.

    Parameters
    ----------
    frame : Frame
        The ideal one.
    camera : LensCamera
        That sees it.
    light : ndarray of shape (H, W)
        The line's, of which `electrons` are the sums: mean electrons of each pixel.
    source : str
        A laser line's name.
    """
    truth, width = frame.truth, light.shape[1]
    if not truth.index.size:
        return ColumnTruth(np.zeros(0, int), *np.zeros((5, 0)))
    top = int(truth.index.min()) // width  # rows that see light are few
    height = int(truth.index.max()) // width + 1 - top
    pixel = np.zeros((height, width), int)  # its number among those that the truth is known of
    pixel.ravel()[truth.index - top * width] = np.arange(truth.index.size)
    across = np.full((height, width), np.nan, np.float32)
    across.ravel()[truth.index - top * width] = truth.source_coordinates[source][:, 0]
    radius_mm = frame.radius_mm[source]

    number, column, row = crossings(across, radius_mm)
    order = np.lexsort((number, column))
    number, column, row = number[order], column[order], row[order]
    slope = across[number + 1, column].astype(float) - across[number, column]
    # One layer for each time that a column sees the line.
    count = np.bincount(column, minlength=width)
    layer = np.arange(column.size) - (np.cumsum(count) - count)[column]
    rows = np.full((max(int(count.max(initial=1)), 1), width), np.nan)
    rows[layer, column] = row
    first, last = (ends[layer, column] for ends in run_of(rows, across, radius_mm))

    # Out to the outer edges of the run's last pixels, half a pixel beyond their middles.
    low, high = (across[at, column].astype(float) for at in (first, last))
    half = 0.5 * np.abs(slope)
    low, high = np.minimum(low, high) - half, np.maximum(low, high) + half
    deviation_mm = 0.5 * radius_mm
    blur = _blur_px(camera, truth.point_mm[pixel[number, column]])
    reach = np.ceil(0.5 * _DISC * np.nan_to_num(blur)).astype(int)
    begin = np.maximum(first + top - reach, 0)
    end = np.minimum(last + top + 1 + reach, len(light))
    above = int(begin.min(initial=len(light)))
    below = int(end.max(initial=above))
    sums = np.zeros((below - above + 1, width))
    np.cumsum(light[above:below], axis=0, out=sums[1:])
    return ColumnTruth(
        column=column,
        row_px=row + top,
        width_px=deviation_mm / np.abs(slope),
        blur_px=blur,
        electrons=sums[end - above, column] - sums[begin - above, column],
        visibility=ndtr(high / deviation_mm) - ndtr(low / deviation_mm),
    )


def _blur_px(camera: LensCamera, points_mm: NDArray[np.floating]) -> Array:
    """Standard deviation along v of the discs that a lens makes of points (N, 3)."""
    if camera.lens is None or not len(points_mm):
        return np.zeros(len(points_mm))
    return circle_of_confusion(camera.lens, camera, points_mm.astype(float))[:, 1] / _DISC
