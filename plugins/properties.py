"""What the plugins of sources read alike of an element's properties."""

import numpy as np

from virtual_sensor.engine import mi
from virtual_sensor.errors import InputError
from virtual_sensor.poses import Pose, keeps_lengths

LARGEST = 1e30
"""Numbers reach up to here, and positive ones down to its inverse: float32 ends at 3e38."""


def pose_of(props: mi.Properties, sizes: str = "its own properties") -> Pose:
    """Pose of an element's frame as Mitsuba has it: a rotation and a place.

    Raises
    ------
    InputError
        Of other transforms, with the properties that give sizes (`sizes`).
    """
    matrix = np.asarray(props["to_world"].matrix, float).reshape(4, 4)
    if not np.isfinite(matrix).all():
        raise InputError("'to_world' is no rotation; give a <lookat> whose up and direction differ")
    if not keeps_lengths(matrix[:3, :3]):
        raise InputError(
            "'to_world' scales or shears, which a source can't; give rotations and translations"
            f" alone, and its size by {sizes}"
        )
    return Pose.from_matrix(matrix)


def positive(props: mi.Properties, name: str, default: float | None = None) -> float:
    """A property that is a positive number."""
    value = float(props.get(name, default))
    if not 1.0 / LARGEST < value < LARGEST:
        raise InputError(f"'{name}' must be a positive number, not {value:g}")
    return value
