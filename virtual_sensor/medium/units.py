"""Units, as files and people spell them."""

from __future__ import annotations

import unicodedata
from collections.abc import Iterable

ZERO_CELSIUS_K = 273.15
ATMOSPHERE_PA = 101325.0
LEAST_PA, MOST_PA = 10e3, 140e3
PRESSURES = f"{LEAST_PA:g} to {MOST_PA:g} Pa (1 hPa is 100 Pa)"
"""Of air, for messages: for more and less there is no formula of its refractivity."""

# The name that is used here, and how else it is spelt, without blanks, _, ^, * and dots.
_SPELLINGS = {
    "K": "kelvin kelvins degk °k degkelvin degreekelvin degreeskelvin",
    "degC": "c °c oc celsius degcelsius degreec degreesc degreecelsius degreescelsius centigrade",
    "kg/m3": "kgm-3 kg/m³ kgm⁻³ g/l g/dm3",
    "g/cm3": "gcm-3 g/cm³ gcm⁻³ g/cc g/ml kg/l kg/dm3",
    "1": "dimensionless unitless",
    "mm": "millimeter millimeters millimetre millimetres",
    "cm": "centimeter centimeters centimetre centimetres",
    "m": "meter meters metre metres",
    "um": "μm micron microns micrometer micrometers micrometre micrometres",
    "inch": "inches in",
    "s": "sec second seconds",
    "ms": "msec millisecond milliseconds",
    "min": "minute minutes",
    "h": "hr hour hours",
}


def _bare(text: str) -> str:
    plain = unicodedata.normalize("NFKC", text.replace("˚", "°")).replace("\N{MINUS SIGN}", "-")
    return "".join(c for c in plain.casefold() if c not in "_^*.·⋅" and not c.isspace())


_NAMES = {
    _bare(spelt): name for name, others in _SPELLINGS.items() for spelt in (name, *others.split())
}


def unit_of(text: str, known: Iterable[str]) -> str | None:
    """The one of the known units that a text means, such as "K" of "Kelvin"; None if none."""
    name = _NAMES.get(_bare(text), text)
    return name if name in known else None
