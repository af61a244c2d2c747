"""Whether a pixel's line of sight meets the rays of a source, and if not, why."""

from enum import IntEnum


class CrossingStatus(IntEnum):
    """How the search for a pixel's point ended."""

    OK = 0
    """There is a point."""
    NO_PIXEL = 1
    """Pixel or coordinate are not finite, or the lens shows nothing there."""
    NO_CROSSING = 2
    """The line of sight runs beside the source's rays, or meets them behind camera or source."""
    FOLDED = 3
    """A caustic of the source's light: there may be more than one point, or none."""
