"""Line centres: what every detector gives, and why a centre is missing."""

from __future__ import annotations

from dataclasses import dataclass, replace
from typing import Any, ClassVar

import numpy as np
from numpy.typing import ArrayLike, NDArray

from virtual_sensor.calls import public
from virtual_sensor.display import Displayed, listed, span, tally
from virtual_sensor.statuses import StatusEnum

Array = NDArray[np.float64]


class Status(StatusEnum):
    """Why there is a centre, or none."""

    OK = 0, "The centre was found."
    NO_PEAK = (
        1,
        "No line stands out of the noise: expose longer, lower min_amplitude, or turn the sensor "
        "if the surface reflects the laser past the camera.",
    )
    SATURATED = (
        2,
        "Pixels of the line are clipped, and what is left of it shows no centre: expose less, or "
        "state the grey value at which the camera clips (saturation).",
    )
    TOO_NARROW = (
        3,
        "The line is too narrow for the pixels, below 0.5 px sigma: use more pixels (width, "
        "height), a wider line (line_radius) or some defocus.",
    )
    AT_BORDER = (
        4,
        "The line reaches the image's border: move the part or the camera to see it whole.",
    )
    LINE_END = (
        5,
        "The line ends here, where its profile is another one: leave these columns out, or use a "
        "longer line.",
    )
    POOR_FIT = (
        6,
        "The profile is no line's, or broader than max_sigma: look for stray light, or raise "
        "max_sigma.",
    )
    BAD_PIXELS = (
        7,
        "Pixels of the line are missing (NaN, infinite or masked): give the image without holes "
        "there.",
    )
    SKEWED = (
        8,
        "The profile is lopsided, as a second line in its skirt or a step of the background shifts "
        "the centre: remove reflections and stray light.",
    )
    DOUBLED = (
        9,
        "There are two peaks of much the same height, apart or merged into a flat one: ask for "
        "both (peaks=2), or remove the reflection.",
    )
    CUT = (
        10,
        "An edge hides a part of the profile, and what is left has another centre: look from "
        "another side, or leave these columns out.",
    )
    OVERLAPPING = (
        11,
        "The line of another source lies in the same pixels, or next to them: switch the sources "
        "on one after the other.",
    )
    CLIPPED = (
        12,
        "Pixels of the line are clipped, and the centre was found by what is left of its profile: "
        "mind its larger sigma, or expose less.",
    )
    CORRECTED = (
        13,
        "The reflectance of the surface changes within the line, and the centre is corrected for "
        "it: mind its larger sigma.",
    )
    GHOST = (
        14,
        "This is light of the line by a reflection, or another light, and not the line: its row is "
        "where that light is.",
    )


FOUND = (Status.OK, Status.CLIPPED, Status.CORRECTED)
"""What a centre of the line may have; all others say why there is none."""

FOUND_NAMES = tuple(status.name.lower() for status in FOUND)


def is_found(status: ArrayLike) -> NDArray[np.bool_]:
    """Where statuses are those of a centre of the line."""
    return _is_one_of(status, FOUND)


def is_measured(status: ArrayLike) -> NDArray[np.bool_]:
    """Where statuses are those of a peak whose numbers are known: the line's, or a ghost's."""
    return _is_one_of(status, (*FOUND, Status.GHOST))


def _is_one_of(status: ArrayLike, some: tuple[Status, ...]) -> NDArray[np.bool_]:
    status = np.asarray(status)
    return np.logical_or.reduce([status == each for each in some])


def found_in_words(status: ArrayLike) -> str:
    """How many centres are ok, and how many not quite: "902 of 2048 ok, 70 clipped"."""
    status = np.asarray(status)
    numbers = {each.name.lower(): np.sum(status == each) for each in (*FOUND[1:], Status.GHOST)}
    others = (f"{number} {name}" for name, number in numbers.items() if number)
    return listed(tally(status, Status.OK), *others)


@public
@dataclass(frozen=True)
class LineCentres(Displayed):
    """Centres of a laser line; NaN where `status` is none of `FOUND`, nor GHOST.

    The arrays have one shape: (W,) where each of W columns is searched for the line, or each of W
    rows; (K, W) where up to K peaks are, the line first; (N,) where N points of lines of any
    direction were found.

    Attributes
    ----------
    column, row : ndarray
        (u, v) in px, integer at pixel centres.  Where columns are searched, `column` is 0 ... W-1
        and `row` is what is measured; where rows are searched, the reverse.
    sigma : ndarray
        Predicted standard deviation in px of the centre, across the line: the image's noise as the
        detector passes it on, and the detector's own bias for such a line.  NaN too where the
        detector can't predict it.
    width : ndarray
        Standard deviation of the line's profile in px, before the pixels integrate it.
    amplitude, background : ndarray
        Height of that profile above the level below it, and that level, in the image's unit.
    normal_deg : ndarray
        Direction in which the centre was sought, degrees from +u towards +v: 90 along columns,
        0 along rows, the line's normal where it may have any direction.
    status : ndarray of uint8
        `Status` of each: ``Status.of(line.status)`` gives the members, which have a message.
        Whether the line was found there, `found` says.
    """

    _field_units: ClassVar = dict.fromkeys(("column", "row", "sigma", "width"), "px")
    _statuses: ClassVar = {"status": Status}
    _by_row: ClassVar = True

    column: NDArray[Any]
    row: NDArray[Any]
    sigma: Array
    width: Array
    amplitude: Array
    background: Array
    normal_deg: Array
    status: NDArray[np.uint8]

    @classmethod
    def of_rows(cls, row: ArrayLike) -> LineCentres:
        """Centres (W,) at a row in each column, of which no more is known; NO_PEAK where NaN."""
        row = np.asarray(row, float)
        blank, along = np.full(row.size, np.nan), np.full(row.size, 90.0)
        status = np.where(np.isnan(row), Status.NO_PEAK, Status.OK).astype(np.uint8)
        return cls(np.arange(row.size), row, blank, blank, blank, blank, along, status)

    def _line(self) -> str:
        along = self.normal_deg.size and np.all(self.normal_deg == 0.0)
        u, v = np.moveaxis(self.pixel, -1, 0)
        where = span("columns", u) if along else span("rows", v)
        return listed(found_in_words(self.status), where)

    @property
    def found(self) -> NDArray[np.bool_]:
        """Where there is a centre of the line: its status is OK, CLIPPED or CORRECTED."""
        return is_found(self.status)

    @property
    def pixel(self) -> Array:
        """The centres as pixels (u, v), shape (..., 2); NaN where the line was not found."""
        there = self.found[..., None]
        return np.where(there, np.stack([self.column, self.row], axis=-1), np.nan)

    @property
    def searched(self) -> tuple[str, int]:
        """Whether columns or rows of an image were searched ("columns", "rows"), and how many.

        Of lines of any direction, and of a part of a line's centres, no columns: 0.
        """
        for name, places, normal in (("columns", self.column, 90.0), ("rows", self.row, 0.0)):
            numbers = np.arange(places.shape[-1] if places.ndim else 0)
            if np.all(self.normal_deg == normal) and np.array_equal(
                places, np.broadcast_to(numbers, places.shape)
            ):
                return name, numbers.size
        return "columns", 0

    @property
    def transposed(self) -> LineCentres:
        """The same centres in the transposed image: rows are columns there."""
        turned = 90.0 - self.normal_deg
        return replace(self, column=self.row, row=self.column, normal_deg=turned)

    def judged(self, status: NDArray[np.integer]) -> LineCentres:
        """The same centres with another `status`, their numbers NaN where nothing is measured."""
        there, names = is_measured(status), ("row", "sigma", "width", "amplitude", "background")
        measured = {name: np.where(there, getattr(self, name), np.nan) for name in names}
        return replace(self, status=status.astype(np.uint8), **measured)
