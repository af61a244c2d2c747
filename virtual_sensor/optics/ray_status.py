"""Why a ray stopped."""

from enum import IntEnum


class RayStatus(IntEnum):
    """One per ray, beside its numbers."""

    HIT = 0
    """It met the surface."""
    ENDED = 1
    """It went the asked length, or reached the asked plane."""
    LEFT = 2
    """It left the field and met nothing."""
    TURNED_BACK = 3
    """It left the field against the direction in which it set out."""
    OUT_OF_STEPS = 4
    """It was still in the field after the last step allowed."""
    STARTED_INSIDE = 5
    """It set out inside the solid."""
