"""A rendered line beside the ray search: how far the image's centres are from the search's."""

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray
from scipy.interpolate import CubicSpline

from virtual_sensor.metrology.centres import LineCentres, Status
from virtual_sensor.metrology.dot_peaks import DotCentres, DotStatus
from virtual_sensor.optics.ray_search import FoundPixels, SearchStatus

Array = NDArray[np.float64]

WRONG_PX, WRONG_SIGMAS = 0.1, 10.0
"""A centre that is OK and off by more is wrong..."""
FINE_PX = 0.02
"""...but for what no measurement resolves: without noise a sigma may be 0.0001 px."""

_PROFILE = 1.5  # seen out to so many 1/e^2 radii on both sides, the profile is whole
_DOT_REACH_PX = 3.0
_BREAK = 4.0  # a step between neighbouring rays this many times the usual one parts the line


@dataclass(frozen=True)
class Agreement:
    """Image minus search, across the line.

    Attributes
    ----------
    column : ndarray of shape (N,)
        Columns that have a line centre, lie on the searched line and see the whole profile.
    difference_px : ndarray of shape (N,)
        Row of the line centre minus row of the searched line there.
    expected : int
        Columns that lie wholly on the searched line and see the whole profile.
    cut : int
        Columns on the searched line where an edge hides part of the profile: they are left out,
        since the centre of what is left is not that of the line.
    cut_centres, stray_centres : int
        Line centres that are left out: in such columns, and in columns off the searched line.
    lost : ndarray of uint8 of shape (M,)
        `Status` of those of the expected columns that have no centre.
    """

    column: Array
    difference_px: Array
    expected: int
    cut: int
    cut_centres: int
    stray_centres: int
    lost: NDArray[np.uint8]

    @property
    def count(self) -> int:
        """Number of columns."""
        return self.column.size

    @property
    def rms_px(self) -> float:
        """Root mean square; NaN if there is no column."""
        return _rms(self.difference_px)

    @property
    def largest_px(self) -> float:
        """Largest magnitude; NaN if there is no column."""
        return _largest(self.difference_px)


def compare(
    line: LineCentres, found: FoundPixels, across_mm: NDArray[np.floating], radius_mm: float
) -> Agreement:
    """Set the centres of a rendered line beside a dense search along it.

    Between searched rays the line is a cubic spline, piece by piece where the surface breaks it.

    Parameters
    ----------
    line : LineCentres
    found : FoundPixels
    across_mm : ndarray of shape (H, W)
        The true coordinate a across the sheet of each pixel; NaN where no light is.
    radius_mm : float
        The laser's 1/e^2 radius.
    """
    pieces = _pieces(found)
    row = np.full(line.column.shape, np.nan)
    covered = np.zeros(line.column.shape, bool)
    for u, v in pieces:
        on = (line.column >= u[0]) & (line.column <= u[-1])
        row[on] = CubicSpline(u, v)(line.column[on])
        covered |= (line.column - 0.5 >= u[0]) & (line.column + 0.5 <= u[-1])
    whole = _sees_whole_profile(row, across_mm, radius_mm)
    centre = line.status == Status.OK
    both = centre & whole  # which needs a row
    return Agreement(
        line.column[both].astype(float),
        (line.row - row)[both],
        int(np.sum(covered & whole)),
        int(np.sum(covered & ~whole)),
        int(np.sum(centre & np.isfinite(row) & ~whole)),
        int(np.sum(centre & np.isnan(row))),
        line.status[covered & whole & ~centre],
    )


def _jump(across_mm: NDArray[np.floating], radius_mm: float) -> float:
    """The step of a between two pixels, mm, from which on it is an edge: on a coarse film more."""
    steps = np.abs(np.diff(across_mm, axis=0))
    known = steps[np.isfinite(steps)]
    return max(radius_mm, 2.0 * float(np.median(known))) if known.size else radius_mm


@dataclass(frozen=True)
class Sound:
    """What a frame's own truth says of the line centres that are OK.

    Attributes
    ----------
    known : int
        Those in whose column the middle of the sheet is seen.
    wrong : int
        Those of them that are off by more than `WRONG_PX`, or by more than `WRONG_SIGMAS` of their
        own sigma where that is more than `FINE_PX`.
    largest_px : float
        Largest error; NaN if none is known.
    """

    known: int
    wrong: int
    largest_px: float


def sound(line: LineCentres, across_mm: NDArray[np.floating], radius_mm: float) -> Sound:
    """Set the OK centres of a rendered line beside the truth at the frame's pixels.

    Parameters
    ----------
    line : LineCentres
    across_mm : ndarray of shape (H, W)
        The true coordinate a across the sheet of each pixel; NaN where no light is.
    radius_mm : float
        The laser's 1/e^2 radius.
    """
    centre = line.status == Status.OK
    error = np.abs(_nearest_middle(np.where(centre, line.row, np.nan), across_mm, radius_mm))
    wrong = (error > WRONG_PX) | (error > np.maximum(WRONG_SIGMAS * line.sigma, FINE_PX))
    return Sound(int(np.isfinite(error).sum()), int(wrong.sum()), _largest(error))


def _nearest_middle(row: Array, across_mm: NDArray[np.floating], radius_mm: float) -> Array:
    """From rows (W,) to the nearest place where the middle of the sheet is seen, px; shape (W,).

    Between two pixels the coordinate across the sheet is taken to be linear.
    """
    upper, lower = across_mm[:-1], across_mm[1:]
    with np.errstate(invalid="ignore"):
        near = np.abs(lower - upper) < _jump(across_mm, radius_mm)
        crosses = (upper * lower <= 0.0) & near & (lower != upper)
    number, column = np.nonzero(crosses)
    a, b = upper[number, column], lower[number, column]
    away = number + a / (a - b) - row[column]
    nearest = np.full(row.shape, np.nan)
    order = np.argsort(-np.abs(away), kind="stable")  # of several the nearest is written last
    nearest[column[order]] = away[order]
    return nearest


def _sees_whole_profile(
    row: Array, across_mm: NDArray[np.floating], radius_mm: float
) -> NDArray[np.bool_]:
    """Columns that see the profile round a row from edge to edge, on one piece of the surface."""
    known = np.isfinite(row)
    light = np.flatnonzero(np.isfinite(across_mm).any(axis=1))
    if not light.size:
        return np.zeros_like(known)
    top = max(light[0] - 1, 0)  # a dark row on each side stands for all those beyond
    across_mm = across_mm[top : light[-1] + 2]
    middle = np.where(known, np.rint(row) - top, 0).astype(int).clip(0, len(across_mm) - 1)
    column = np.arange(across_mm.shape[1])
    number = np.arange(len(across_mm))[:, None]
    # A pixel starts a new piece where there was no light before, or that of another place.
    starts = np.ones(across_mm.shape, bool)
    starts[1:] = ~(np.abs(np.diff(across_mm, axis=0)) < _jump(across_mm, radius_mm))
    ends = np.ones(across_mm.shape, bool)
    ends[:-1] = starts[1:]
    first = np.maximum.accumulate(np.where(starts, number, 0), axis=0)[middle, column]
    backwards = np.where(ends, number, len(across_mm) - 1)[::-1]
    last = np.minimum.accumulate(backwards, axis=0)[::-1][middle, column]
    a = np.stack([across_mm[first, column], across_mm[last, column]])
    reach = _PROFILE * radius_mm
    return known & (a.min(axis=0) < -reach) & (a.max(axis=0) > reach)


@dataclass(frozen=True)
class DotAgreement:
    """Centroids of rendered dots beside the searched pixels of their laser rays.

    Attributes
    ----------
    pixel : ndarray of shape (M, 2)
        Centroid (u, v) of each laser ray's dot; NaN where none was found near the searched pixel.
    flux : ndarray of shape (M,)
        Sum of the dot's pixels.
    searched : ndarray of shape (M, 2)
    """

    pixel: Array
    flux: Array
    searched: Array

    @property
    def found(self) -> NDArray[np.bool_]:
        """Which laser rays have a dot; shape (M,)."""
        return np.isfinite(self.pixel[:, 0])

    @property
    def difference_px(self) -> Array:
        """Centroid minus searched pixel, shape (M, 2)."""
        return self.pixel - self.searched

    @property
    def count(self) -> int:
        """Number of dots found."""
        return int(self.found.sum())

    @property
    def rms_px(self) -> float:
        """Root mean square of the distances; NaN if there is no dot."""
        return _rms(np.linalg.norm(self.difference_px, axis=1))

    @property
    def largest_px(self) -> float:
        """Largest distance; NaN if there is no dot."""
        return _largest(np.linalg.norm(self.difference_px, axis=1))


def match_dots(dots: DotCentres, found: FoundPixels) -> DotAgreement:
    """Give each searched laser ray the dot nearest to its pixel, if there is one within reach."""
    pixel, flux = np.full_like(found.pixel, np.nan), np.full(len(found.pixel), np.nan)
    sound = dots.status == DotStatus.OK
    for i, searched in enumerate(found.pixel):
        distance = np.linalg.norm(dots.pixel[sound] - searched, axis=1)
        if distance.size and np.min(distance) < _DOT_REACH_PX:
            nearest = np.argmin(distance)
            pixel[i], flux[i] = dots.pixel[sound][nearest], dots.flux[sound][nearest]
    return DotAgreement(pixel, flux, found.pixel)


def _pieces(found: FoundPixels) -> list[tuple[Array, Array]]:
    """Unbroken pieces of the searched line as (u, v), u ascending; not those that fold back."""
    usable = found.status == SearchStatus.FOUND
    steps = np.linalg.norm(np.diff(found.pixel, axis=0), axis=1)
    usual = np.nanmedian(steps) if np.isfinite(steps).any() else np.nan
    joined = np.isfinite(steps) & (steps < _BREAK * usual)
    pieces = []
    for run in np.split(np.arange(len(usable)), np.flatnonzero(~joined) + 1):
        u, v = found.pixel[run[usable[run]]].T
        if len(u) and u[0] > u[-1]:
            u, v = u[::-1], v[::-1]
        if len(u) >= 4 and np.all(np.diff(u) > 0.0):
            pieces.append((u, v))
    return pieces


def _rms(values: Array) -> float:
    """Root mean square of those that are not NaN; NaN if there are none."""
    known = values[np.isfinite(values)]
    return float(np.sqrt(np.mean(known**2))) if known.size else np.nan


def _largest(values: Array) -> float:
    """Largest magnitude of those that are not NaN; NaN if there are none."""
    known = values[np.isfinite(values)]
    return float(np.max(np.abs(known))) if known.size else np.nan
