"""The numbers that section 5 of Beermann et al. 2018 states, and ours for them."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from enum import Enum

import numpy as np
from numpy.typing import NDArray

from virtual_sensor.metrology.deviation import euclidean
from virtual_sensor.studies.reproduction.curves import Curve

TOLERANCE = 0.15
"""A stated number is met within so much of it."""


class Kind(Enum):
    """What a number is stated as."""

    VALUE = "about"
    BELOW = "below"
    ABOVE = "above"


@dataclass(frozen=True)
class Stated:
    """A number that the paper states of the nine rays in one setting, quasi-continuous.

    Attributes
    ----------
    name, unit : str
    where : str
        In the paper.
    paper : float
    kind : Kind
    temperature_c, beta_deg : float
        The setting.
    ours : callable
        The number of a curve.
    """

    name: str
    unit: str
    where: str
    paper: float
    kind: Kind
    temperature_c: float
    beta_deg: float
    ours: Callable[[Curve], float]

    def residual(self, ours: float) -> float:
        """Relative difference; 0 where a bound is kept."""
        apart = ours / self.paper - 1.0
        if self.kind is Kind.BELOW:
            return max(apart, 0.0)
        if self.kind is Kind.ABOVE:
            return min(apart, 0.0)
        return apart

    def met(self, ours: float) -> bool:
        """Within the tolerance; a bound is kept or it is not."""
        return abs(self.residual(ours)) <= (TOLERANCE if self.kind is Kind.VALUE else 0.0)


def _middle(values: NDArray[np.float64]) -> float:
    """Of what "varies round" a value."""
    return float(values.min() + values.max()) / 2.0


LAST, STATED_RAY = 8, 6
"""Places of y = -10 and -7.5 mm among the nine rays."""

STATED = (
    Stated(
        "largest |B - B_m|",
        "µm",
        "5.1, fig. 7(b)",
        75.0,
        Kind.VALUE,
        1250.0,
        0.0,
        lambda c: float(np.max(euclidean(c.exact.hot_um))),
    ),
    Stated(
        "Δu laser → object at y = -10 mm",
        "px",
        "5.2, fig. 9(a)",
        -4.0,
        Kind.VALUE,
        1250.0,
        0.0,
        lambda c: float(c.paths.laser_to_object_px[LAST, 0]),
    ),
    Stated(
        "largest Δu object → camera",
        "px",
        "5.2, fig. 9(b)",
        2.0,
        Kind.ABOVE,
        1250.0,
        0.0,
        lambda c: float(np.max(c.paths.object_to_camera_px[:, 0])),
    ),
    Stated(
        "Δu laser → camera, middle of its range",
        "px",
        "5.2, fig. 9(c)",
        -0.5,
        Kind.VALUE,
        1250.0,
        0.0,
        lambda c: _middle(c.paths.laser_to_camera_px[:, 0]),
    ),
    Stated(
        "largest |B_m - A_m| at beta = 15 deg",
        "µm",
        "5.3",
        20.0,
        Kind.BELOW,
        900.0,
        15.0,
        lambda c: float(np.max(euclidean(c.exact.measured_um))),
    ),
    Stated(
        "largest |B_m - A_m| at beta = 30 deg",
        "µm",
        "5.3",
        7.0,
        Kind.BELOW,
        900.0,
        30.0,
        lambda c: float(np.max(euclidean(c.exact.measured_um))),
    ),
)
"""Those that depend on the air; what is stated of the cold cylinder and of the search does not."""
