"""Transports: how light gets from a camera to a surface, and from there to its sources."""

from dataclasses import dataclass, replace
from typing import Any

import numpy as np

from virtual_sensor.errors import InputError
from virtual_sensor.optics.rays import March

TRANSPORTS = ("tabulated", "marched", "first_order", "straight")
"""How bent rays are found, by name."""


@dataclass(frozen=True)
class Transport:
    """How bent rays are found.

    Attributes
    ----------
    name : str
        "tabulated": from maps of the bent rays; "marched": each sample's rays are marched, its
        source's ray found by Newton; "first_order": so, but deflected as if it ran straight;
        "straight": no refraction.
    march : March
        Its `first_order` is as the name says.
    tolerance_px : float
        Largest error of the maps.

    Raises
    ------
    InputError
        If there is no such transport, or the tolerance is no positive number.
    """

    name: str
    march: March
    tolerance_px: float = 0.003

    def __post_init__(self) -> None:
        if self.name not in TRANSPORTS:
            raise InputError(f"'transport' must be one of {', '.join(TRANSPORTS)}, not {self.name}")
        if not 0.0 < self.tolerance_px < np.inf:
            raise InputError(
                f"'tolerance' must be a positive number of px, not {self.tolerance_px}"
            )
        march = replace(self.march, first_order=self.name == "first_order")
        object.__setattr__(self, "march", march)

    def by(self, name: str | None = None, **march: Any) -> "Transport":
        """Another transport, or the same one with other settings of its march."""
        return replace(self, name=name or self.name, march=replace(self.march, **march))
