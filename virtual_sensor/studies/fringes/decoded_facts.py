"""The figures of decoded fringes."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any, Self

import numpy as np
from numpy.typing import NDArray

from virtual_sensor.metrology.fringes.decoded import DecodedFringes, FringeStatus
from virtual_sensor.records import Record, counts_of


@dataclass(frozen=True)
class DecodedFacts(Record):
    """What was decoded.

    Attributes
    ----------
    pixels : int
        That have a projector pixel.
    status : dict
        How many of the frame's pixels have each status.
    modulation_median : float
        Of the pixels that have a projector pixel, as their grey values.
    sigma_column_px, sigma_row_px : float or None
        Predicted standard deviation of the projector pixel, median; None of an axis without
        patterns.
    """

    pixels: int
    status: dict[str, int]
    modulation_median: float
    sigma_column_px: float | None
    sigma_row_px: float | None

    @classmethod
    def of(cls, decoded: DecodedFringes, **more: Any) -> Self:
        """Of an image; `more` are fields of a kind that has more."""
        ok = decoded.ok

        def median(image: NDArray[Any]) -> float:
            return float(np.median(image[ok])) if ok.any() else np.nan

        return cls(
            pixels=int(ok.sum()),
            status=counts_of(decoded.status, FringeStatus),
            modulation_median=median(decoded.modulation),
            sigma_column_px=None if decoded.sigma_column is None else median(decoded.sigma_column),
            sigma_row_px=None if decoded.sigma_row is None else median(decoded.sigma_row),
            **more,
        )
