"""What a renderer knows of a device that shines."""

from typing import Any, Protocol

from virtual_sensor.optics.sources import Source


class Device(Source, Protocol):
    """A source with its radiometry."""

    def flux(self, s: Any, t: Any) -> Any:
        """Power per unit of both coordinates, W; none for NaN."""
        ...
