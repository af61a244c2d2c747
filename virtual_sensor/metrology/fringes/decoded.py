"""Decoded fringes: what every codec gives, and why a pixel has no projector coordinate."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from typing import ClassVar

import numpy as np
from numpy.typing import NDArray

from virtual_sensor.calls import public
from virtual_sensor.display import Displayed, listed, span, tally
from virtual_sensor.statuses import StatusEnum

COORDINATES = {"u": "column", "v": "row"}
"""Of the projector's image: what is decoded along each axis."""


class FringeStatus(StatusEnum):
    """Why a pixel has a projector coordinate, or none."""

    OK = 0, "The projector's pixel was found."
    BLACK = (
        1,
        "The pixel sees no light of the projector: a shadow, the background, or a surface that is "
        "too dark; expose longer.",
    )
    LOW_MODULATION = (
        2,
        "The pixel is lit, but the fringes hardly show, or drown in noise: expose longer, shut out "
        "other light, focus the projector, or take a longer period.",
    )
    SATURATED = (
        3,
        "The pixel is clipped in at least one image: expose less, or state the grey value at which "
        "the camera clips (saturation).",
    )
    EDGE = (
        4,
        "The pixel mixes the light of unlike places: neighbours jump or are dark, or the surface "
        "bends, or its light changes, too much within a pixel; use smaller pixels.",
    )
    ORDER = (
        5,
        "The periods disagree on the fringe order: look for motion, gamma or noise, take more "
        "steps, or periods nearer to each other.",
    )
    OUTSIDE = (
        6,
        "The decoded place lies outside the projector's image, or in the border that is left out: "
        "check its size, and the order of the images.",
    )
    NOT_FINITE = (
        7,
        "A grey value is missing (NaN, infinite or masked): give images without holes there.",
    )


@public
@dataclass(frozen=True)
class DecodedFringes(Displayed):
    """The projector's pixel at each camera pixel; NaN where `status` is not OK.

    Attributes
    ----------
    column, row : ndarray of shape (H, W) or None
        The projector's (u, v) in px, integers at its pixel centres; None of an axis that was not
        projected.
    sigma_column, sigma_row : ndarray of shape (H, W) or None
        Predicted standard deviations in px, of the images' noise alone.
    modulation, mean : ndarray of shape (H, W)
        Amplitude of the finest fringes, the lower one of two axes, and the mean grey value, in the
        images' unit; NaN where a grey value is missing.
    phase : dict of str to ndarray of shape (H, W)
        Wrapped phase of the finest period by axis, "u" and "v", in rad from 0 to 2 pi; none of Gray
        code.
    status : ndarray of uint8 of shape (H, W)
        `FringeStatus` of each pixel.
    size_px : tuple of int
        (W, H) of the projector.
    absolute : bool
        Whether the coordinates are the projector's own.  If not, as of a single period that was
        unwrapped in space, whole periods may be missing: as many for each connected region.
    wrong_orders : float
        Expected share of the pixels that are OK whose fringe order is wrong, by the noise.
    noise : float
        Standard deviation of the grey values that sigmas were predicted from, as given or as the
        images show it.
    notes : tuple of str
        What is doubtful, each with its remedy.
    """

    _field_units: ClassVar = dict.fromkeys(("column", "row", "sigma_column", "sigma_row"), "px")
    _statuses: ClassVar = {"status": FringeStatus}
    _by_row: ClassVar = True

    column: NDArray[np.float64] | None
    row: NDArray[np.float64] | None
    sigma_column: NDArray[np.float32] | None
    sigma_row: NDArray[np.float32] | None
    modulation: NDArray[np.float32]
    mean: NDArray[np.float32]
    phase: Mapping[str, NDArray[np.float32]]
    status: NDArray[np.uint8]
    size_px: tuple[int, int]
    absolute: bool = True
    wrong_orders: float = 0.0
    noise: float = 0.0
    notes: tuple[str, ...] = ()

    def _line(self) -> str:
        found = (("columns", self.column), ("rows", self.row))
        spans = [span(name, values) for name, values in found if values is not None]
        relative = "" if self.absolute else "but for whole periods"
        return listed(tally(self.status, FringeStatus.OK), *spans, relative)

    @property
    def ok(self) -> NDArray[np.bool_]:
        """Mask (H, W) of the pixels that have coordinates."""
        return self.status == FringeStatus.OK

    @property
    def pixel(self) -> NDArray[np.float64]:
        """The projector's pixels (u, v), shape (H, W, 2); NaN where there is none, or no axis."""
        none = np.full(self.status.shape, np.nan)
        pair = (none if each is None else each for each in (self.column, self.row))
        return np.stack(list(pair), axis=-1)
