"""Numbers, times and names of data in the words that people read."""

from __future__ import annotations

import re
from collections.abc import Callable
from typing import Any

import numpy as np

from virtual_sensor.errors import printable
from virtual_sensor.records import unit_of

NIL_UM = 1e-6
"""Below this, lengths are rounding: drawn as zero."""

_PREFIXES = ((1.0, "s"), (1e-3, "ms"), (1e-6, "µs"), (1e-9, "ns"))


def in_words(
    value: object, shape: str | Callable[[Any], str] = "{:.4f}", nothing: str = "none"
) -> str:
    """A figure as people read it; `nothing` where there is no answer (None or NaN).

    Texts stay as they are, True and False are yes and no.
    """
    if isinstance(value, str):
        return printable(value)
    if isinstance(value, bool | np.bool_):
        return "yes" if value else "no"
    if value is None or (isinstance(value, float | np.floating) and np.isnan(value)):
        return nothing
    return shape.format(value) if isinstance(shape, str) else shape(value)


def rounded(value: float, digits: int = 3) -> str:
    """A number with few digits, and a true minus."""
    return f"{value:.{digits}g}".replace("-", "\N{MINUS SIGN}")


def micrometres(value_um: float | None) -> str:
    """A length as people read it: what is only rounding is called so."""
    if value_um is not None and abs(value_um) < NIL_UM:
        return "below 1e-6 µm"
    return "none" if value_um is None or np.isnan(value_um) else f"{rounded(value_um)} µm"


def time_in_words(seconds: float | None) -> str:
    """A time with three digits, in the unit that it is best read in; minutes from two on."""
    if seconds is None or not np.isfinite(seconds):
        return "unknown"
    if seconds >= 120.0:
        return f"{seconds / 60.0:.3g} min"
    scale, unit = next((p for p in _PREFIXES if abs(seconds) >= p[0]), _PREFIXES[-1])
    return f"{seconds / scale:.3g} {unit}"


def counted(number: int, thing: str, things: str | None = None) -> str:
    """A number with what it counts: "1 column", "3 columns"."""
    return f"{number} {thing if number == 1 else things or thing + 's'}"


def capital(text: str) -> str:
    """A text as a sentence begins; a name of a file or of an element that it begins with stays."""
    name = re.match(r"\S*\w[._]\w", text)
    return text if name else text[:1].upper() + text[1:]


def unbroken(text: str) -> str:
    """A text of which no line ends between its words."""
    return text.replace(" ", "\N{NO-BREAK SPACE}")


def heading(name: str) -> str:
    """A column's or key's name as a heading: "rms_px" is "rms in px"."""
    unit = unit_of(name)
    words = [word for word in name.split("_") if word]
    if not unit:
        return " ".join(words)
    for end in range(len(words), 0, -1):  # the unit, before an axis or "norm"
        for start in reversed(range(end)):
            if unit_of("_".join(words[start:end])) == unit and unit_of(words[end - 1]):
                rest = [*words[:start], *words[end:]]
                return f"{' '.join(rest)} in {unit}".strip()
    return " ".join(words)


def listed(items: list[str] | tuple[str, ...], last: str = "and") -> str:
    """Items with commas in between, and a word before the last."""
    *others, end = items or [""]
    return f"{', '.join(others)} {last} {end}" if others else end


def anchor(title: str) -> str:
    """A title as the name that a link within its page leads to."""
    return re.sub(r"[^a-z0-9]+", "-", title.lower()).strip("-") or "section"
