"""An exposure time, as scenes and options say it: "2ms", "500us", "0.002", or "auto"."""

from __future__ import annotations

import re

from virtual_sensor.errors import InputError, short

AUTO = "auto"
SHORTEST_S, LONGEST_S = 1e-9, 1e4

_EXPONENTS = {"s": 0, "ms": -3, "us": -6, "µs": -6, "μs": -6, "ns": -9}
_TIME = re.compile(r"(\d+\.?\d*|\.\d+)\s*([A-Za-zµμ]*)")


def exposure_time_s(where: str, said: object) -> float | None:
    """Seconds of an exposure time: a number of them, or a text with a unit; None is automatic.

    Raises
    ------
    InputError
        Naming it, if it is no time, or none that a camera has: 1 ns to 10,000 s.
    """
    text = "" if said is None else f"{said}".strip()
    if text.lower() in ("", AUTO):
        return None
    try:
        seconds = float(text)
    except ValueError:
        found = _TIME.fullmatch(text)
        exponent = _EXPONENTS.get(found[2].lower()) if found else None
        # As one decimal number: 500us is 0.0005 to the last bit.
        seconds = 0.0 if found is None or exponent is None else float(f"{found[1]}e{exponent}")
    if not SHORTEST_S <= seconds <= LONGEST_S:
        raise InputError(
            f"{where} is {short(said)}; give an exposure time with its unit, such as 2ms, 500us or"
            " 0.002s, or auto"
        )
    return seconds
