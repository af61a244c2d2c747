"""Whether a pixel's line of sight meets the rays of a source, and if not, why."""

from virtual_sensor.statuses import StatusEnum


class CrossingStatus(StatusEnum):
    """How the search for a pixel's point ended."""

    OK = 0, "The pixel's point was found."
    NO_PIXEL = (
        1,
        "Pixel or coordinate are not finite, or the lens shows nothing there: look at the status "
        "of the line's centres, or of the decoded fringes.",
    )
    NO_CROSSING = (
        2,
        "The line of sight runs beside the source's rays: check the pixel (u, v) and the sensor's "
        "pose.",
    )
    FOLDED = (
        3,
        "A caustic of the source's light, where there may be more than one point or none: leave "
        "these pixels out.",
    )
    BEHIND = (
        4,
        "The line of sight meets the source's rays behind camera or source only: check the pixel "
        "(u, v) and the sensor's pose.",
    )
    OFF = (
        5,
        "Bent light meets, if at all, farther from where straight light does than was searched: "
        "check that the air is this scene's and lies where it should.",
    )
    UNCOVERED = (
        6,
        "On the way to the point the air's field ends where it has not faded to its surroundings: "
        "give a field that reaches further out.",
    )
