"""A rendered line beside the ray search: how far the image's centres are from the search's."""

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray
from scipy.interpolate import CubicSpline

from virtual_sensor.metrology.line_peaks import LineCentres, Status
from virtual_sensor.optics.ray_search import FoundPixels, SearchStatus

Array = NDArray[np.float64]

_BREAK = 4.0  # a step between neighbouring rays this many times the usual one parts the line


@dataclass(frozen=True)
class Agreement:
    """Image minus search, across the line.

    Attributes
    ----------
    column : ndarray of shape (N,)
        Columns that have a line centre and lie on the searched line.
    difference_px : ndarray of shape (N,)
        Row of the line centre minus row of the searched line there.
    expected : int
        Columns that lie wholly on the searched line.
    """

    column: Array
    difference_px: Array
    expected: int

    @property
    def rms_px(self) -> float:
        """Root mean square; NaN if there is no column."""
        return float(np.sqrt(np.mean(self.difference_px**2))) if self.column.size else np.nan

    @property
    def largest_px(self) -> float:
        """Largest magnitude; NaN if there is no column."""
        return (
            float(np.max(np.abs(self.difference_px), initial=0.0)) if self.column.size else np.nan
        )


def compare(line: LineCentres, found: FoundPixels) -> Agreement:
    """Set the centres of a rendered line beside a dense search along it.

    Between searched rays the line is a cubic spline, piece by piece where the surface breaks it.
    """
    pieces = _pieces(found)
    row = np.full(line.column.shape, np.nan)
    whole = np.zeros(line.column.shape, bool)
    for u, v in pieces:
        on = (line.column >= u[0]) & (line.column <= u[-1])
        row[on] = CubicSpline(u, v)(line.column[on])
        whole |= (line.column - 0.5 >= u[0]) & (line.column + 0.5 <= u[-1])
    both = (line.status == Status.OK) & np.isfinite(row)
    return Agreement(line.column[both].astype(float), (line.row - row)[both], int(whole.sum()))


def _pieces(found: FoundPixels) -> list[tuple[Array, Array]]:
    """Unbroken pieces of the searched line as (u, v), u ascending."""
    usable = found.status == SearchStatus.FOUND
    steps = np.linalg.norm(np.diff(found.pixel, axis=0), axis=1)
    usual = np.nanmedian(steps) if np.isfinite(steps).any() else np.nan
    joined = np.isfinite(steps) & (steps < _BREAK * usual)
    pieces = []
    for run in np.split(np.arange(len(usable)), np.flatnonzero(~joined) + 1):
        pixel = found.pixel[run[usable[run]]]
        order = np.argsort(pixel[:, 0])
        u, v = pixel[order].T
        if len(u) >= 4 and np.all(np.diff(u) > 0.0):
            pieces.append((u, v))
    return pieces
