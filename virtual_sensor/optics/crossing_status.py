"""Whether a pixel's line of sight meets the rays of a source, and if not, why."""

from virtual_sensor.statuses import StatusEnum


class CrossingStatus(StatusEnum):
    """How the search for a pixel's point ended."""

    OK = 0, "The pixel's point was found."
    NO_PIXEL = (
        1,
        "Pixel or coordinate are not finite, or the lens shows nothing there: look at the status "
        "of the line's centres.",
    )
    NO_CROSSING = (
        2,
        "The line of sight runs beside the source's rays, or meets them behind camera or source: "
        "check the pixel (u, v) and the sensor's pose.",
    )
    FOLDED = (
        3,
        "A caustic of the source's light, where there may be more than one point or none: leave "
        "these pixels out.",
    )
