"""The errors that a user is meant to read: each names the file, the element and the remedy."""

import math
import operator
import sys
import unicodedata
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray


def printable(text: str) -> str:
    """Escape what a terminal would obey in text from a file; ends of lines and tabs stay."""
    return "".join(
        c if c in "\n\t" or (unicodedata.category(c) not in ("Cc", "Zl", "Zp") and c not in TURNS)
        else c.encode("unicode_escape").decode()
        for c in text
    )  # fmt: skip


TURNS = "\u202a\u202b\u202c\u202d\u202e\u2066\u2067\u2068\u2069"  # of the writing direction


class InputError(ValueError):
    """A scene, a field, an option or an output folder that the program cannot work with."""

    def __str__(self) -> str:
        return printable(super().__str__())


class EngineError(RuntimeError):
    """Dr.Jit or Mitsuba cannot run on this machine as things stand."""


class Interrupted(SystemExit):
    """A simulation was stopped by Ctrl-C or a signal, in good order: the same command goes on.

    Attributes
    ----------
    folder : Path
        Of the case.
    time_s : float
        Flow time reached, s.
    code : int
        Status to exit with.
    """

    def __init__(self, folder: Path, time_s: float, code: int) -> None:
        super().__init__(code)
        self.folder = folder
        self.time_s = time_s

    def __str__(self) -> str:
        return f"stopped at {self.time_s:.8g} s of flow; the same command goes on ({self.folder})"


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


LARGEST = sys.float_info.max
SMALLEST = math.ulp(0.0)
"""Of all positive numbers; with `LARGEST` the bounds of what is positive and finite."""


def short(value: Any) -> str:
    """How a value is written in a message, however long it is."""
    try:
        text = repr(value)
    except ValueError:  # of an integer with too many digits
        text = f"a {type(value).__name__}"
    return text if len(text) <= 40 else f"{text[:37]}..."
