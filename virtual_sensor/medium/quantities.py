"""The quantities that a field can hold: their units, and values that are none of air's."""

import numpy as np
from numpy.typing import ArrayLike

from virtual_sensor.errors import InputError
from virtual_sensor.medium.units import ZERO_CELSIUS_K

# What must be added to a value in these units to have it in K, kg/m3, 1; the first is written.
UNITS = {
    "temperature": {"K": 0.0, "degC": ZERO_CELSIUS_K},
    "density": {"kg/m3": 0.0},
    "refractivity": {"1": 0.0},
}
# Values beyond these are not such a field; n itself, stored instead of n - 1, is the common one.
LIMITS = {
    "temperature": (50.0, 6000.0, " K"),
    "density": (0.0, 100.0, " kg/m3"),
    "refractivity": (-1.0, 0.9, ""),
}
AMBIENT_LIMITS = {
    "ambient_temperature": (50.0, 6000.0, " K"),
    "ambient_pressure": (1.0, 1e7, " Pa"),
    "ambient_relative_humidity": (-np.inf, np.inf, ""),  # Ciddor's formula knows its range
    "ambient_density": (0.0, 100.0, " kg/m3"),
    "ambient_refractivity": (-0.01, 0.9, ""),
}


def check_limits(kind: str, values: np.ndarray, name: str = "", remedy: str = "") -> None:
    """Refuse values that can't be such a field's; NaN passes.

    `name` and `remedy` are for messages: by default those of a file's variable.
    """
    low, high, unit = LIMITS[kind]
    wrong = (values <= low) | (values >= high)
    if wrong.any():
        of_file = "check its units and packing"
        if kind == "refractivity":
            of_file += " (n - 1 is wanted, not n)"
        name = name or f"variable '{kind}'"
        raise InputError(
            f"{name} is {values[wrong][0]:g}{unit} at node {np.argwhere(wrong)[0].tolist()},"
            f" outside {low:g} to {high:g}{unit}; {remedy or of_file}"
        )


def possible_ambient(name: str, value: float) -> float:
    """Give an ambient value back if the surrounding air can have it."""
    low, high, unit = AMBIENT_LIMITS[name]
    if not low <= value <= high:
        raise InputError(
            f"attribute '{name}' is {value:g}{unit}, outside {low:g} to {high:g}{unit}; correct it"
        )
    return value


def implied_temperature_c(refractivity: ArrayLike, ambient: float, ambient_c: float) -> np.ndarray:
    """Temperature in degC of an ideal gas at ambient pressure with these n - 1."""
    kelvin = ambient / np.asarray(refractivity, float) * (ambient_c + ZERO_CELSIUS_K)
    return np.asarray(kelvin - ZERO_CELSIUS_K)
