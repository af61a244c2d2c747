"""Why a ray stopped."""

from virtual_sensor.statuses import StatusEnum


class RayStatus(StatusEnum):
    """How a ray's march ended."""

    HIT = 0, "The ray met the surface."
    ENDED = 1, "The ray went the asked length, or reached the asked plane."
    LEFT = 2, "The ray left the field and met nothing."
    TURNED_BACK = (
        3,
        "The ray left the field against the direction in which it set out: check the field's "
        "values and units.",
    )
    OUT_OF_STEPS = (
        4,
        "The ray was still in the field after the last step allowed: use longer steps (step_mm), "
        "or a larger tolerance.",
    )
    STARTED_INSIDE = 5, "The ray set out inside the solid: move its origin out of the part."
