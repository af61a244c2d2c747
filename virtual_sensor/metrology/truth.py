"""Where a line truly is in an image, and how far what was found is from it.

The truth comes from a ray search along the line, from the coordinates of the light that each pixel
of a frame sees, or from whoever drew the image.  One function compares line centres with it; it
says how many it left out, and why.
"""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass, replace
from typing import Any, ClassVar

import numpy as np
from numpy.typing import ArrayLike, NDArray
from scipy.interpolate import CubicSpline
from scipy.ndimage import distance_transform_edt

from virtual_sensor.arrays import LARGEST, number_within, numbers_of, truth_of
from virtual_sensor.calls import public
from virtual_sensor.devices.sheet_rows import crossings, sees_whole_profile
from virtual_sensor.display import Displayed
from virtual_sensor.errors import InputError, short
from virtual_sensor.metrology.centres import LineCentres, Status
from virtual_sensor.metrology.dot_peaks import DotCentres, DotStatus
from virtual_sensor.statuses import StatusEnum

Array = NDArray[np.float64]
Index = NDArray[np.intp]
Mask = NDArray[np.bool_]

WRONG_PX, WRONG_SIGMAS = 0.1, 10.0
"""A centre that is OK and off by more is wrong..."""
FINE_PX = 0.02
"""...but for what no measurement resolves: without noise a sigma may be 0.0001 px."""

_LONGEST_STEP = 4.0  # times the usual one between neighbouring rays
_FEWEST_RAYS = 4  # of a cubic
_SAME_LINE_PX = 3.0  # in adjoining columns
_DOT_REACH_PX = 3.0


class TruthStatus(StatusEnum):
    """What is known of a line in a column, or why a centre there is compared with nothing."""

    KNOWN = 0, "The line's true row is known."
    NO_LINE = 1, "The line does not cross the column: nothing is to be found there."
    BROKEN = (
        2,
        "The line is parted here, by an edge or by rays that the camera does not see: these "
        "columns are not compared.",
    )
    FOLDED = (
        3,
        "The searched line turns back, as behind a caustic a column sees it twice: these columns "
        "are not compared.",
    )
    FEW_RAYS = 4, "A part of the searched line of fewer than four rays: search more of them."
    CUT = (
        5,
        "The row is known, but an edge hides a part of the profile, whose centre then is another: "
        "these columns are not compared.",
    )
    NEAR_END = (
        6,
        "Nearer to an end of the line than a comparison allows: these columns are not compared.",
    )


@public
@dataclass(frozen=True)
class TrueLine(Displayed):
    """A line's true rows: arrays of shape (K, W), as a column may see the line up to K times.

    Attributes
    ----------
    row : ndarray of shape (K, W)
        v in px at the columns' middles; NaN where `status` is neither KNOWN nor CUT.
    end_px : ndarray of shape (K, W)
        From the column's middle along u to the nearer end of this part of the line; infinite where
        it ends at none within the image.
    status : ndarray of uint8 of shape (K, W)
        `TruthStatus` of each.
    """

    _field_units: ClassVar = {"row": "px"}
    _statuses: ClassVar = {"status": TruthStatus}

    row: Array
    end_px: Array
    status: NDArray[np.uint8]

    def _line(self) -> str:
        counts = {s: n for s in TruthStatus if (n := (self.status == s).any(axis=0).sum())}
        words = ", ".join(f"{number} {s.name.lower()}" for s, number in counts.items())
        return f"of {self.row.shape[1]} columns {words or 'none'}"

    def _columns(self) -> dict[str, Any]:
        peak, column = np.indices(self.row.shape)
        layers = {"peak": peak, "column": column, **vars(self)}
        return {name: values.ravel() for name, values in layers.items()}

    @classmethod
    def of_rows(cls, row: ArrayLike) -> TrueLine:
        """A line that was drawn at a row in each of W columns; NaN where it is not."""
        rows = np.atleast_2d(np.asarray(row, float))
        known = np.isfinite(rows)
        begun, ended = (np.maximum.accumulate(known[:, ::step], 1)[:, ::step] for step in (1, -1))
        status = np.where(begun & ended, TruthStatus.BROKEN, TruthStatus.NO_LINE)
        status[known] = TruthStatus.KNOWN
        return cls(rows, _to_ends(rows, np.inf), status.astype(np.uint8))

    @classmethod
    def of_search(
        cls, pixel: Array, found: Mask, width: int, longest_step: float = _LONGEST_STEP
    ) -> TrueLine:
        """A line along which laser rays were searched: a cubic spline through their pixels.

        It is parted where the surface breaks it, and not continued beyond the rays.

        Parameters
        ----------
        pixel : ndarray of shape (N, 2)
            (u, v) that see the rays, in order along the line; NaN where nothing sees them.
        found : ndarray of bool of shape (N,)
            Which of them are used.
        width : int
            Columns of the image.
        longest_step : float
            Times the usual one: rays farther apart in the image are not of the same part.
        """
        column = np.arange(width)
        why = np.full(width, TruthStatus.NO_LINE)
        layers: list[Array] = []  # rows and distances to the ends
        parts = list(_parts(pixel, found, longest_step))
        ends = np.array([[u.min(), u.max()] for u, _ in parts]).reshape(-1, 2)
        if len(ends):
            why[(column >= ends.min()) & (column <= ends.max())] = TruthStatus.BROKEN
        for (first, last), (u, v) in zip(ends, parts, strict=True):
            on = (column >= first) & (column <= last)
            if len(u) < _FEWEST_RAYS or not np.all(np.diff(u) > 0.0):
                few = len(u) < _FEWEST_RAYS
                why[on] = TruthStatus.FEW_RAYS if few else TruthStatus.FOLDED
                continue
            free = [layer for layer in layers if np.isnan(layer[0, on]).all()]
            if not free:
                layers.append(np.full((2, width), np.nan))
                free = layers[-1:]
            free[0][0, on] = CubicSpline(u, v)(column[on])
            free[0][1, on] = np.minimum(column - first, last - column)[on]
        rows, to_ends = np.array(layers or [np.full((2, width), np.nan)]).swapaxes(0, 1)
        status = np.full(rows.shape, TruthStatus.NO_LINE, np.uint8)
        status[0] = why
        status[np.isfinite(rows)] = TruthStatus.KNOWN
        return cls(rows, to_ends, status)

    @classmethod
    def of_coordinates(cls, across_mm: NDArray[np.floating], radius_mm: float) -> TrueLine:
        """A line in a frame whose pixels know which light they see.

        The middle of the sheet is where the coordinate across it goes through zero.

        Parameters
        ----------
        across_mm : ndarray of shape (H, W)
            Coordinate across the sheet of each pixel; NaN where no light is.
        radius_mm : float
            The laser's 1/e^2 radius.
        """
        number, column, place = crossings(across_mm, radius_mm)
        width = across_mm.shape[1]
        count = np.bincount(column, minlength=width)
        order = np.lexsort((number, column))
        rank = np.arange(column.size) - (np.cumsum(count) - count)[column[order]]
        row = np.full((max(int(count.max(initial=1)), 1), width), np.nan)
        row[rank, column[order]] = place[order]
        status = np.full(row.shape, TruthStatus.NO_LINE, np.uint8)
        status[0, np.isfinite(across_mm).any(axis=0)] = TruthStatus.BROKEN
        status[np.isfinite(row)] = TruthStatus.KNOWN
        return cls(row, _to_ends(row, _SAME_LINE_PX), status).seen_in(across_mm, radius_mm)

    @classmethod
    def of_frame(cls, frame: Any, source: str | None = None) -> TrueLine:
        """A source's line in a rendered `Frame`; the name can be left out where it is the only one.

        Of a `RecordedFrame` it is that of its ideal one.

        Raises
        ------
        InputError
            If there is no such source, or there are several; or it is no laser line.
        """
        frame = _ideal(frame)
        name = frame.source_name(source)
        if name not in frame.radius_mm:
            raise InputError(f"the source '{name}' is no laser line; a frame of fringes has none")
        return cls.of_coordinates(frame.coordinates(name)[:, :, 0], frame.radius_mm[name])

    def seen_in(self, across_mm: NDArray[np.floating], radius_mm: float) -> TrueLine:
        """The same line, CUT where a frame shows that an edge hides a part of its profile."""
        known = np.isfinite(self.row)
        whole = sees_whole_profile(self.row, across_mm, radius_mm)
        return replace(self, status=np.where(known & ~whole, TruthStatus.CUT, self.status))

    def band(self, height: int, half_px: float) -> Mask:
        """Pixels (height, W) within `half_px` of the line, along columns and beyond its ends."""
        v = np.arange(height)[:, None]
        near = np.zeros((height, self.row.shape[1]), bool)
        for row in self.row[np.isfinite(self.row).any(axis=1)]:
            known = np.isfinite(row)
            distance, (nearest,) = distance_transform_edt(~known, return_indices=True)
            near |= (np.abs(v - row[nearest]) <= half_px) & (distance <= half_px)
        return near

    def moved(self, rows_px: float) -> TrueLine:
        """The same line in an image that begins so many rows earlier."""
        return replace(self, row=self.row + rows_px)

    def columns(self, end_px: float = 0.0) -> Index:
        """Columns whose row is known, not nearer to an end of the line than a margin."""
        return np.flatnonzero(self._known(end_px).any(axis=0))

    def centres(self, end_px: float = 0.0) -> LineCentres:
        """What a detector without any error would find, not nearer to the ends than a margin.

        Of shape (W,): where a column sees the line more than once, the first is taken.
        """
        good = self._known(end_px)
        first = np.take_along_axis(self.row, good.argmax(axis=0)[None], 0)[0]
        return LineCentres.of_rows(np.where(good.any(axis=0), first, np.nan))

    def _known(self, end_px: float) -> Mask:
        """Where the row is known (K, W), not nearer to an end of the line than a margin."""
        return (self.status == TruthStatus.KNOWN) & (self.end_px >= end_px)


@dataclass(frozen=True)
class LineErrors(Displayed):
    """Centres of a line beside the truth; N of them are compared.

    Attributes
    ----------
    column, row : ndarray of shape (N,)
        (u, v) of the centres, px.
    true_row : ndarray of shape (N,)
        Of the line at that u.
    sigma : ndarray of shape (N,)
        Which the detector predicts for them.
    expected : int
        Columns that lie on the line from edge to edge, and see its whole profile.
    lost : ndarray of uint8 of shape (M,)
        `Status` of those of them that have no centre.
    cut : int
        Columns that would be expected if no edge hid a part of the profile.
    left_out : dict from TruthStatus to int
        Centres that are OK and were not compared, by the reason; only those that occur.
    """

    _field_units: ClassVar = dict.fromkeys(("column", "row", "true_row", "sigma"), "px")
    _statuses: ClassVar = {"lost": Status}

    column: Array
    row: Array
    true_row: Array
    sigma: Array
    expected: int
    lost: NDArray[np.uint8]
    cut: int
    left_out: dict[TruthStatus, int]

    def _line(self) -> str:
        left = ", ".join(f"{number} {why.name.lower()}" for why, number in self.left_out.items())
        return (
            f"{self.count} centres, rms {self.rms_px:.2g} px, at most {self.largest_px:.2g} px;"
            f" {self.lost.size} of {self.expected} columns lost"
            f"{'; left out: ' + left if left else ''}"
        )

    def _columns(self) -> dict[str, Any]:
        names = ("column", "row", "true_row", "sigma", "error_px")
        return {name: getattr(self, name) for name in names}

    @property
    def error_px(self) -> Array:
        """Found minus true, across the columns; shape (N,)."""
        return self.row - self.true_row

    @property
    def count(self) -> int:
        """Centres that were compared."""
        return self.column.size

    @property
    def rms_px(self) -> float:
        """Root mean square; NaN if there is no centre."""
        return rms(self.error_px)

    @property
    def largest_px(self) -> float:
        """Largest magnitude; NaN if there is no centre."""
        return largest(self.error_px)

    @property
    def cut_centres(self) -> int:
        """Centres that were left out because an edge hides a part of the profile."""
        return self.left_out.get(TruthStatus.CUT, 0)

    @property
    def stray_centres(self) -> int:
        """Centres that were left out because no row of the line is known in their column."""
        known = (TruthStatus.CUT, TruthStatus.NEAR_END)
        return sum(number for why, number in self.left_out.items() if why not in known)

    def wrong(self) -> Mask:
        """Which are off by more than `WRONG_PX`, or `WRONG_SIGMAS` of their own and `FINE_PX`."""
        error = np.abs(self.error_px)
        return (error > WRONG_PX) | (error > np.maximum(WRONG_SIGMAS * self.sigma, FINE_PX))


@public
def compare_line(
    line: LineCentres,
    truth: Any,
    *,
    source: str | None = None,
    end_px: float = 0.0,
    cut: bool = False,
) -> LineErrors:
    """Compare the centres that are OK with the truth.

    Where a column sees the line more than once, a centre is compared with the nearest row. Between
    columns, where a detector of lines of any direction has its points, the truth is linear.

    Parameters
    ----------
    line : LineCentres
        Of an image whose columns are searched, or of lines of any direction.
    truth : TrueLine, Frame, RecordedFrame or array_like of shape (W,)
        A rendered frame knows its line; an array has its row in each column, NaN where none is.
    source : str, optional
        Of a frame: the source whose line it is, where the frame has several.
    end_px : float
        Centres nearer to an end of the line are left out.
    cut : bool
        Whether columns are compared in which an edge hides a part of the profile.

    Raises
    ------
    InputError
        If the frame has no such source, or the truth is of another image.
    """
    if not hasattr(line, "status"):
        raise InputError(f"compare_line: line is {short(line)}; give LineCentres")
    number_within("compare_line: end_px", end_px, -LARGEST, LARGEST, "a distance in px")
    truth_of("compare_line: cut", cut)
    truth = _ideal(truth)
    is_frame = hasattr(truth, "source_coordinates")
    truth = _true_line(truth, source)
    width = truth.row.shape[1]
    searched, count = line.searched
    if searched == "columns" and count not in (0, width):
        given = "frame" if is_frame else "truth"
        raise InputError(
            f"compare_line: the line has {count} columns, the {given} {width}; compare images of"
            " one size"
        )
    status = truth.status
    if cut:
        status = np.where(status == TruthStatus.CUT, TruthStatus.KNOWN, status)
    near = np.isfinite(truth.row) & ~(truth.end_px >= end_px)

    good = line.found.ravel()
    u, v, sigma = (np.ravel(x)[good].astype(float) for x in (line.column, line.row, line.sigma))
    column = np.rint(u).astype(int)
    inside = (column >= 0) & (column < width)
    at = column.clip(0, width - 1)
    true, layer = _nearest(truth.row, u, v, at)
    why = np.where(near[layer, at], TruthStatus.NEAR_END, status[layer, at])
    why[~inside] = TruthStatus.NO_LINE
    compared = why == TruthStatus.KNOWN

    whole = truth.end_px >= max(end_px, 0.5)
    expected = ((status == TruthStatus.KNOWN) & whole).any(axis=0)
    is_cut = ((status == TruthStatus.CUT) & whole).any(axis=0) & ~expected
    seen = np.zeros(width, bool)
    seen[at[inside]] = True
    return LineErrors(
        u[compared],
        v[compared],
        true[compared],
        sigma[compared],
        int(expected.sum()),
        _status_of_columns(line, width)[expected & ~seen],
        int(is_cut.sum()),
        {s: int(n) for s in TruthStatus if s != TruthStatus.KNOWN and (n := np.sum(why == s))},
    )


def _ideal(frame: Any) -> Any:
    """The rendered frame, with its truth, of a recorded one; others as they are."""
    ideal = getattr(frame, "ideal", frame)
    if ideal is not frame and not hasattr(ideal, "source_coordinates"):
        raise InputError(
            "the recorded frame knows no line: what was recorded is a sequence, or a radiance"
            " alone; record a Frame (render_frame), or give the line's row in each column"
        )
    return ideal


def _true_line(truth: Any, source: str | None) -> TrueLine:
    """The truth, however it is given."""
    if isinstance(truth, TrueLine):
        return truth
    if hasattr(truth, "source_coordinates"):
        return TrueLine.of_frame(truth, source)
    rows = numbers_of("compare_line: truth", truth)
    if rows.ndim not in (1, 2) or not rows.size:
        raise InputError(
            f"compare_line: truth has shape {rows.shape}; give a frame (render_frame), or the"
            " line's row in each column"
        )
    return TrueLine.of_rows(rows)


def _nearest(rows: Array, u: Array, v: Array, column: Index) -> tuple[Array, Index]:
    """The true row (N,) at each u that is nearest to v, and its number among the K of the column.

    `column` are the nearest to u; towards the one beyond, the row nearest to theirs is the same
    part of the line.
    """
    here = rows[:, column]
    layer = np.where(np.isfinite(here), np.abs(here - v), np.inf).argmin(axis=0)
    true = here[layer, np.arange(column.size)]
    aside = u - column
    between = np.abs(aside) > 1e-9  # the truth of drawn lines may jump from column to column
    if between.any():
        beside = rows[:, (column + np.sign(aside).astype(int)).clip(0, rows.shape[1] - 1)]
        step = np.where(np.isfinite(beside), beside - true, np.inf)
        step = np.take_along_axis(step, np.abs(step).argmin(axis=0)[None], 0)[0]
        true = true + np.where(between & np.isfinite(step), step, 0.0) * np.abs(aside)
    return true, layer


def _status_of_columns(line: LineCentres, width: int) -> NDArray[np.uint8]:
    """Why a column has no centre: the status of its first peak; (W,)."""
    reason = np.full(width, Status.NO_PEAK, np.uint8)
    column = np.ravel(line.column)[::-1].astype(float)  # the first is written last
    status = np.ravel(line.status)[::-1]
    known = (column > -0.5) & (column < width - 0.5)
    reason[np.rint(column[known]).astype(int)] = status[known]
    return reason


@dataclass(frozen=True)
class DotErrors(Displayed):
    """Centroids of dots beside the pixels where M dots truly are.

    Attributes
    ----------
    pixel : ndarray of shape (M, 2)
        Centroid (u, v) of each dot; NaN where none was found within reach.
    flux : ndarray of shape (M,)
        Sum of the dot's pixels.
    true_pixel : ndarray of shape (M, 2)
        NaN where it is not known.
    stray : int
        Dots that are OK and belong to none of them.
    """

    _field_units: ClassVar = {"pixel": "px", "true_pixel": "px"}
    _by_row: ClassVar = True

    pixel: Array
    flux: Array
    true_pixel: Array
    stray: int

    def _line(self) -> str:
        return (
            f"{self.count} of {len(self.pixel)} dots, rms {self.rms_px:.2g} px, at most"
            f" {self.largest_px:.2g} px; {self.stray} dots of none"
        )

    @property
    def found(self) -> Mask:
        """Which of the M dots were found; shape (M,)."""
        return np.isfinite(self.pixel[:, 0])

    @property
    def error_px(self) -> Array:
        """Centroid minus true pixel, shape (M, 2)."""
        return self.pixel - self.true_pixel

    @property
    def count(self) -> int:
        """Number of dots found."""
        return int(self.found.sum())

    @property
    def rms_px(self) -> float:
        """Root mean square of the distances; NaN if there is no dot."""
        return rms(np.linalg.norm(self.error_px, axis=1))

    @property
    def largest_px(self) -> float:
        """Largest distance; NaN if there is no dot."""
        return largest(np.linalg.norm(self.error_px, axis=1))


def compare_dots(
    dots: DotCentres, true_pixel: Array, *, reach_px: float = _DOT_REACH_PX
) -> DotErrors:
    """Give each true pixel (M, 2) the dot nearest to it, if that is within reach and no other's."""
    good = np.flatnonzero(dots.status == DotStatus.OK)
    pixel, flux = np.full_like(true_pixel, np.nan), np.full(len(true_pixel), np.nan)
    apart = np.linalg.norm(dots.pixel[good] - true_pixel[:, None], axis=2)  # (M, dots)
    apart[~(apart < reach_px)] = np.inf
    if not apart.size:
        return DotErrors(pixel, flux, true_pixel, good.size)
    nearest = apart.argmin(axis=1)
    mutual = apart.argmin(axis=0)[nearest] == np.arange(len(true_pixel))
    own = np.flatnonzero(mutual & np.isfinite(apart.min(axis=1)))
    pixel[own], flux[own] = dots.pixel[good[nearest[own]]], dots.flux[good[nearest[own]]]
    return DotErrors(pixel, flux, true_pixel, good.size - own.size)


def rms(values: Array) -> float:
    """Root mean square of those that are not NaN; NaN if there are none."""
    known = values[np.isfinite(values)]
    return float(np.sqrt(np.mean(known**2))) if known.size else np.nan


def largest(values: Array) -> float:
    """Largest magnitude of those that are not NaN; NaN if there are none."""
    known = values[np.isfinite(values)]
    return float(np.max(np.abs(known))) if known.size else np.nan


def mean(values: Array) -> float:
    """Mean of those that are not NaN; NaN if there are none."""
    known = values[np.isfinite(values)]
    return float(known.mean()) if known.size else np.nan


def farthest(values: Array) -> float:
    """The value farthest from 0, with its sign; NaN if all are NaN."""
    known = values[np.isfinite(values)]
    return float(known[np.abs(known).argmax()]) if known.size else np.nan


def _parts(pixel: Array, found: Mask, longest_step: float) -> Iterator[tuple[Array, Array]]:
    """Unbroken parts of a searched line as (u, v), u ascending from end to end."""
    steps = np.linalg.norm(np.diff(pixel, axis=0), axis=1)
    usual = np.nanmedian(steps) if np.isfinite(steps).any() else np.nan
    joined = np.isfinite(steps) & ((steps < longest_step * usual) | np.isinf(longest_step))
    for run in np.split(np.arange(len(pixel)), np.flatnonzero(~joined) + 1):
        u, v = pixel[run[found[run]]].T
        if u.size:
            yield (u[::-1], v[::-1]) if u[0] > u[-1] else (u, v)


def _to_ends(row: Array, longest_px: float) -> Array:
    """From each column's middle to the nearer end of its run of columns, px; like `row` (K, W).

    Rows farther apart in adjoining columns are of two runs. The columns at a run's ends are covered
    whole. The image's border is no end.
    """
    width = row.shape[1]
    known = np.isfinite(row)
    joined = np.abs(np.diff(row, axis=1)) <= longest_px
    column = np.arange(width)
    begins, ends = known.copy(), known.copy()
    begins[:, 1:] &= ~joined
    ends[:, :-1] &= ~joined
    left = np.maximum.accumulate(np.where(begins, column - 0.5, -np.inf), axis=1)
    right = np.minimum.accumulate(np.where(ends, column + 0.5, np.inf)[:, ::-1], axis=1)[:, ::-1]
    left[left == -0.5] = -np.inf
    right[right == width - 0.5] = np.inf
    return np.where(known, np.minimum(column - left, right - column), np.nan)
