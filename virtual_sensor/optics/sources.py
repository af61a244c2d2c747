"""What optics knows of a device that shines; `devices` has them, with their radiometry."""

from typing import Any, Protocol

import numpy as np
from numpy.typing import NDArray

from virtual_sensor.optics.ray_families import RayFamily

Array = NDArray[np.float64]


class Source(Protocol):
    """A source of light: its rays, and which of them are lit."""

    @property
    def family(self) -> RayFamily:
        """Its rays."""
        ...

    @property
    def extent(self) -> tuple[Array, Array]:
        """Lowest and highest (s, t) with light that counts, each of shape (2,)."""
        ...

    def reaches(self, s: Any, t: Any, margin: tuple[Any, Any] = (0.0, 0.0)) -> Any:
        """Mask of the coordinates with light that counts, or near it; NaN has none."""
        ...
