"""A scene's parameters of its camera: the field of view follows from focal length and film.

Mitsuba's XML has no arithmetic, and its cameras have a field of view.  In a scene that declares
`focal_length`, `film_width`, `width` and `fov` as parameters, the last is worked out here:

==============  ====  ========================================================================
Parameter       Unit  What becomes of it
==============  ====  ========================================================================
`focal_length`  mm    of the pinhole: from the projection centre to the film
`film_width`    mm    of the whole film; without another word it stays, whatever its `width`
`pixel`         um    its pitch; where it is given, `film_width` is `width` times it
`fov`           deg   2 atan(film_width / 2 / focal_length); where it is given, `focal_length`
                      follows from it
`calibration`         a file that has the place of `focal_length` and `fov`
==============  ====  ========================================================================
"""

import math
from collections.abc import Mapping

from virtual_sensor.errors import InputError

_NEEDED = ("focal_length", "film_width", "width", "fov")
_SAME = 1e-6  # of two values that were given and say the same, but for typed digits


def with_field_of_view(values: Mapping[str, str], given: Mapping[str, str]) -> dict[str, str]:
    """The values of a scene's parameters, those of its camera in accord with each other.

    Parameters
    ----------
    values : Mapping
        Of all parameters, defaults included.
    given : Mapping
        Those that are no defaults, which are kept.

    Raises
    ------
    InputError
        If one is no positive number, or two that are given contradict each other.
    """
    if not all(name in values for name in _NEEDED):
        return dict(values)
    if values.get("calibration") and (both := [n for n in ("focal_length", "fov") if n in given]):
        raise InputError(f"{both[0]}: calibration={values['calibration']} has it; give one of them")
    width_px = _positive("width", values["width"])
    found: dict[str, float] = {}
    if "pixel" in given or not values["film_width"]:
        found["film_width"] = width_px * _positive("pixel", values.get("pixel", "")) / 1000.0
    film_mm = found.get("film_width") or _positive("film_width", values["film_width"])
    if "pixel" in values:
        found["pixel"] = 1000.0 * film_mm / width_px
    if "fov" in given:
        fov = math.radians(_positive("fov", values["fov"], below=180.0))
        found["focal_length"] = film_mm / 2.0 / math.tan(fov / 2.0)
    else:
        focal_mm = _positive("focal_length", values["focal_length"])
        found["fov"] = math.degrees(2.0 * math.atan(film_mm / 2.0 / focal_mm))
    for name, other in (("film_width", "pixel"), ("focal_length", "fov")):
        if name in given and name in found:
            if abs(float(given[name]) / found[name] - 1.0) > _SAME:
                raise InputError(
                    f"{name}={given[name]} contradicts {other}={given[other]}, which makes it"
                    f" {found[name]:.6g}; give one of them"
                )
            del found[name]
    return {**values, **{name: f"{value:.10g}" for name, value in found.items()}}


def _positive(name: str, text: str, below: float = 1e9) -> float:
    try:
        value = float(text)
    except ValueError:
        value = math.nan
    if not 0.0 < value < below:
        raise InputError(f"{name}={text[:40]} is no number above 0 and below {below:g}; give one")
    return value
