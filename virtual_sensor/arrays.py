"""Numbers and arrays that a caller gives, checked before anything computes with them."""

import math
import operator
import sys
from typing import Any

import numpy as np
from numpy.typing import ArrayLike, NDArray

from virtual_sensor.errors import InputError

LARGEST = sys.float_info.max
SMALLEST = math.ulp(0.0)
"""Of all positive numbers; with `LARGEST` the bounds of what is positive and finite."""


def whole_number(name: str, value: Any, least: int, most: int) -> int:
    """The value as int; raises InputError, naming it, if it is none within the bounds."""
    try:
        whole = operator.index(value)
    except TypeError:
        whole = least - 1
    if not least <= whole <= most:
        raise InputError(
            f"{name} must be a whole number from {least} to {most}, not {short(value)}"
        )
    return whole


def number_within(name: str, value: Any, least: float, most: float, advice: str) -> float:
    """The value as float; raises InputError, naming it, if it is no number within the bounds."""
    try:
        # Texts, and arrays of one number, would pass for it.
        number = (
            float(value)
            if hasattr(value, "__float__") and not getattr(value, "shape", ())
            else None
        )
    except (TypeError, ValueError, OverflowError):
        number = None
    if number is None or not least <= number <= most:
        raise InputError(f"{name} is {short(value)}; give {advice}")
    return number


def numbers_of(name: str, values: Any) -> NDArray[np.float64]:
    """The values as an array of float; raises InputError, naming them, if they are no numbers."""
    array = np.asarray(values)
    if array.dtype.kind not in "bufi":
        raise InputError(f"{name} is of type {array.dtype}; give an array of real numbers")
    return array.astype(float)


def short(value: Any) -> str:
    """How a value is written in a message, however long it is."""
    try:
        text = repr(value)
    except ValueError:  # of an integer with too many digits
        text = f"a {type(value).__name__}"
    return text if len(text) <= 40 else f"{text[:37]}..."


def unmasked(values: ArrayLike) -> NDArray:
    """An array without a mask: NaN where a NumPy mask hides values."""
    if not np.ma.is_masked(values):
        return np.asarray(values)
    masked: Any = np.ma.asarray(values)
    kind = np.float32 if masked.dtype in (np.uint8, np.uint16, np.float32) else np.float64
    return masked.astype(kind).filled(np.nan)
