"""What a renderer knows of a device that shines."""

from typing import Any, Protocol

import numpy as np
from numpy.typing import ArrayLike, NDArray

from virtual_sensor.optics.sources import Source

Array = NDArray[np.float64]


class Device(Source, Protocol):
    """A source with its radiometry."""

    def flux(self, s: Any, t: Any, depth: Any = None) -> Any:
        """Power per unit of both coordinates, W; none for NaN.

        Of light with a focus it depends on the depth in the family's frame.
        """
        ...


def irradiance(device: Device, points_mm: ArrayLike) -> Array:
    """Flux density (N,) square to a device's straight light at world points (N, 3), W/mm^2."""
    family = device.family
    s, t, depth = family.coordinates(points_mm).T
    cosine = family.rays(s, t)[1] @ family.pose.rotation[:, 2]
    found: Array = device.flux(s, t, depth) / (np.abs(family.spread(s, t, depth)) * cosine)
    return found
