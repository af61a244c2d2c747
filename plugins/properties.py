"""What the plugins of devices read alike of an element's properties."""

from collections.abc import Iterable
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from virtual_sensor.engine import mi
from virtual_sensor.errors import InputError
from virtual_sensor.optics.distortion import COEFFICIENTS
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
            "'to_world' scales or shears, which a device can't; give rotations and translations"
            f" alone, and its size by {sizes}"
        )
    return Pose.from_matrix(matrix)


def positive(props: mi.Properties, name: str, default: float | None = None) -> float:
    """A property that is a positive number."""
    value = float(props.get(name, default))
    if not 1.0 / LARGEST < value < LARGEST:
        raise InputError(f"'{name}' must be a positive number, not {value:g}")
    return value


def finite(props: mi.Properties, name: str, default: float) -> float:
    """A property that is a finite number."""
    value = float(props.get(name, default))
    if not abs(value) < LARGEST:
        raise InputError(f"'{name}' is {value:g}; give a finite number")
    return value


def optional(props: mi.Properties, name: str, wanted: str) -> float | None:
    """A number that a text has, or that is one; None of an empty text."""
    text = str(props.get(name, ""))
    try:
        return float(text) if text else None
    except ValueError:
        raise InputError(f"'{name}' must be {wanted}, not \"{text}\"") from None


def optional_positive(props: mi.Properties, name: str, wanted: str) -> float | None:
    """Likewise a positive one."""
    value = optional(props, name, wanted)
    if value is not None and not 1.0 / LARGEST < value < LARGEST:
        raise InputError(f"'{name}' is {value:g}; give {wanted}")
    return value


def numbers_in(text: str) -> NDArray[np.float64] | None:
    """The finite numbers that a text lists; None if it has something else."""
    try:
        values = np.array([float(word) for word in text.replace(",", " ").split()])
    except ValueError:
        return None
    return values if np.isfinite(values).all() else None


def distortion_of(text: str) -> NDArray[np.float64]:
    """OpenCV's coefficients that a text lists; none of an ideal lens."""
    values = numbers_in(text)
    if values is None or values.size not in COEFFICIENTS:
        raise InputError(
            f"'distortion' is \"{text[:80]}\"; give 4, 5, 8, 12 or 14 numbers with commas, as"
            " OpenCV has them"
        )
    return values if values.any() else np.zeros(0)


def refuse_both(props: mi.Properties, name: str, others: Iterable[str]) -> None:
    """Raise InputError if an element that has a property has others that say the same."""
    if both := [other for other in others if other in props]:
        raise InputError(f"has a '{name}' and {', '.join(map(repr, both))}; give one of them")


def folders_of_files() -> list[Path]:
    """Where a scene's files are: in its folder, in its <path>s, or where one stands."""
    mitsubas = Path(mi.__file__).parent
    folders = [Path(str(folder)).absolute() for folder in mi.file_resolver()]
    return [folder for folder in folders if folder != mitsubas]


def listed_file(name: str, file: str) -> Path:
    """The file that a property names."""
    there = (folder / file for folder in folders_of_files())
    if (path := next((each for each in there if each.is_file()), None)) is None:
        raise InputError(f"there is no file \"{file}\" where '{name}' says; correct it")
    return path
