"""What optics knows of a device that shines; `devices` has them, with their radiometry."""

from typing import Any, Protocol

import numpy as np
from numpy.typing import ArrayLike, NDArray

from virtual_sensor.arrays import numbers_of
from virtual_sensor.errors import InputError
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

    def reaches(
        self, s: Any, t: Any, margin: tuple[Any, Any] = (0.0, 0.0), depth: Any = None
    ) -> Any:
        """Mask of the coordinates with light that counts, or near it; NaN has none.

        Light with a focus reaches farther from its middle at some depths than at others.
        """
        ...


def first_coordinate(asker: str, source: Any, given: ArrayLike | None) -> Array:
    """First coordinates s of rays, as given: by default 0, the middle of a laser's sheet.

    Raises
    ------
    InputError
        If they are no numbers; or left out of a projector, whose light is everywhere.
    """
    if given is not None:
        return numbers_of(f"{asker}: coordinate", given)
    if hasattr(source, "pixels_of"):
        raise InputError(
            f"{asker}: the source is a projector; give the coordinate s of the ray that each pixel"
            " sees, or give decoded fringes to vs.reconstruct"
        )
    return np.asarray(0.0)
