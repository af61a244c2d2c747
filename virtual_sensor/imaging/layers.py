"""What a frame's indirect light is: by how many reflections it came, and of which rays.

A ghost is light of a source that a pixel sees by a reflection from another place of the part.  Its
truth is where in the source it started: the rays that light the pixel through so many reflections.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from typing import Any, ClassVar

import numpy as np
from numpy.typing import NDArray

from virtual_sensor.display import Displayed, listed
from virtual_sensor.records import Table, status_names
from virtual_sensor.statuses import StatusEnum

Array = NDArray[np.float64]
Image = NDArray[np.float32]

_VISIBLE = 0.01  # of the line's peak in a column: a ghost that is as bright counts as seen
_CLEAR = 2.0  # times what is reflected there: so bright is a line that stands out
_FAINT = 1e-4  # of the brightest column


class GhostStatus(StatusEnum):
    """Whether a source lights a pixel by so many reflections."""

    LIT = 0, "Light of the source arrives by so many reflections; its rays are given."
    DARK = (
        1,
        "No light of the source was found that arrives by so many reflections: for fainter light, "
        "use more indirect_samples.",
    )


@dataclass(frozen=True, eq=False)
class GhostTruth(Displayed):
    """Which rays of the sources make a frame's indirect light, B bounces at N pixels.

    A pixel may see light of many rays by one number of reflections: given are their mean, weighted
    by the radiance they make, and the standard deviation about it.

    Attributes
    ----------
    index : ndarray of shape (N,)
        Row-major numbers of the pixels that any indirect light reaches.
    radiance : dict
        By the sources' names, ndarray of shape (B, N): W/(mm^2 sr) by one reflection between, by
        two, ...
    source_coordinates : dict
        Likewise of shape (B, N, 2): mean (s, t) of the rays, as a `PixelTruth` has them.
    spread : dict
        Likewise: standard deviation of their s and t.
    status : dict
        Likewise of shape (B, N): `GhostStatus`.
    """

    _statuses: ClassVar = {"status": GhostStatus}

    index: NDArray[np.uint32]
    radiance: Mapping[str, Image]
    source_coordinates: Mapping[str, Image]
    spread: Mapping[str, Image]
    status: Mapping[str, NDArray[np.uint8]]

    @staticmethod
    def of(moments: Mapping[str, NDArray[np.floating]]) -> GhostTruth:
        """From each source's images of radiance, and of radiance times s, t, s^2 and t^2.

        Parameters
        ----------
        moments : Mapping
            By the sources' names, ndarray of shape (B, 5, ...) over the pixels.
        """
        flat = {name: each.reshape(*each.shape[:2], -1) for name, each in moments.items()}
        lit = [np.any(each[:, 0] > 0.0, axis=0) for each in flat.values()]
        index = np.flatnonzero(np.any(lit, axis=0)) if lit else np.zeros(0, np.intp)
        found: dict[str, list[Any]] = {
            name: [_ghost(bounce[:, index].astype(np.float64)) for bounce in each]
            for name, each in flat.items()
        }
        parts: Any = (
            {name: np.stack([each[part] for each in bounces]) for name, bounces in found.items()}
            for part in range(4)
        )
        return GhostTruth(index.astype(np.uint32), *parts)

    @property
    def bounces(self) -> int:
        """Most reflections between."""
        return max((len(each) for each in self.status.values()), default=0)

    def _line(self) -> str:
        names = ", ".join(self.status) or "no source"
        lit = [(each == GhostStatus.LIT).sum(axis=1) for each in self.status.values()]
        counts = np.sum(lit, axis=0) if lit else []
        seen = (
            f"{count} pixels by {number} bounce{'s' * (number > 1)}"
            for number, count in enumerate(counts, 1)
        )
        return listed(f"light of {names}", *seen)

    def _columns(self) -> dict[str, Any]:
        found: dict[str, Any] = {"index": self.index}
        for name, status in self.status.items():
            for bounce in range(len(status)):
                stem = f"{name}_indirect{bounce + 1}"
                found[f"{stem}_radiance"] = self.radiance[name][bounce]
                for axis, letter in enumerate("st"):
                    found[f"{stem}_{letter}"] = self.source_coordinates[name][bounce, :, axis]
                    found[f"{stem}_{letter}_spread"] = self.spread[name][bounce, :, axis]
                found[f"{stem}_status"] = status_names(status[bounce], GhostStatus)
        return found


def _ghost(moments: Array) -> tuple[Image, Image, Image, NDArray[np.uint8]]:
    """Radiance, mean, spread and status of pixels by their five moments (5, N)."""
    power, *sums = moments
    shines = power > 0.0
    with np.errstate(divide="ignore", invalid="ignore"):
        s, t, ss, tt = (np.where(shines, total / power, np.nan) for total in sums)
    middle = np.stack([s, t], axis=-1)
    variance = np.stack([ss, tt], axis=-1) - middle**2
    spread = np.sqrt(np.maximum(variance, 0.0))
    status = np.where(shines, GhostStatus.LIT, GhostStatus.DARK)
    kinds = np.float32, np.float32, np.float32, np.uint8
    each = zip((power, middle, spread, status), kinds, strict=True)
    radiance, mean, deviation, judged = (values.astype(kind) for values, kind in each)
    return radiance, mean, deviation, judged


@dataclass(frozen=True, eq=False)
class GhostColumns(Table):
    """The brightest ghost in each column of a frame that has a line.

    A column whose direct light is less than a ten-thousandth of the brightest column's has none.

    Attributes
    ----------
    column : ndarray of shape (N,)
        Of the image.
    line_radiance : ndarray of shape (N,)
        The brightest direct light of the column, W/(mm^2 sr).
    ghost_radiance : ndarray of shape (N,)
        The brightest indirect light where it is stronger than the direct; 0 where it is nowhere.
    ghost_row_px : ndarray of shape (N,)
        The row of that; NaN where there is none.
    over_line : ndarray of shape (N,)
        The ghost over the line.
    """

    column: NDArray[np.int64]
    line_radiance: Array
    ghost_radiance: Array
    ghost_row_px: Array
    over_line: Array

    @property
    def seen(self) -> NDArray[np.bool_]:
        """Which ghosts have a hundredth of the line or more."""
        return self.over_line >= _VISIBLE

    def _line(self) -> str:
        seen = self.over_line[self.seen]
        most = f"up to {seen.max():.2g} of the line" if seen.size else ""
        return listed(f"ghosts in {seen.size} of {self.column.size} columns", most)


def stands_out(direct: Image, indirect: Image) -> NDArray[np.bool_]:
    """Columns (W,) whose line is twice as bright as what is reflected there: images (H, W)."""
    clear: NDArray[np.bool_] = direct.max(axis=0) > _CLEAR * indirect.max(axis=0)
    return clear


def ghost_columns(direct: Image, indirect: Image) -> GhostColumns:
    """How bright ghosts are beside the line, column by column.

    Off the line is where the indirect light is stronger than the direct.

    Parameters
    ----------
    direct : ndarray of shape (H, W)
        Radiance that sources make directly.
    indirect : ndarray of shape (B, H, W)
        Likewise by one reflection between, by two, ...
    """
    whole = indirect.sum(axis=0)
    ghost = np.where(whole > direct, whole, np.float32(0.0))
    brightest = direct.max(axis=0, initial=0.0)
    column = np.flatnonzero(brightest > _FAINT * brightest.max(initial=0.0))
    if not column.size:
        return GhostColumns(column, *(np.zeros(0) for _ in range(4)))
    line = direct[:, column].max(axis=0).astype(float)
    row = ghost[:, column].argmax(axis=0)
    peak = ghost[row, column].astype(float)
    return GhostColumns(column, line, peak, np.where(peak > 0.0, row, np.nan), peak / line)
