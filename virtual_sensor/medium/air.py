"""Refractivity n - 1 of air from temperature, pressure, humidity and CO2, or from density.

Sources
-------
P. E. Ciddor, "Refractive index of air: new equations for the visible and near infrared",
Appl. Opt. 35, 1566-1573 (1996); the equation numbers below are this paper's.
"""

from __future__ import annotations

import numpy as np
from numpy.typing import ArrayLike

from virtual_sensor.arrays import numbers_of
from virtual_sensor.calls import public
from virtual_sensor.errors import InputError
from virtual_sensor.medium.units import ATMOSPHERE_PA, LEAST_PA, MOST_PA, ZERO_CELSIUS_K

_R = 8.314510  # J/(mol K), the value that Ciddor's constants go with
_M_WATER = 0.018015  # kg/mol
_RHO_WATER_STANDARD = 0.00985938  # kg/m^3, pure vapour at 20 degC, 1333 Pa
_Z_STANDARD = 0.9995922115  # compressibility of dry air at 15 degC, 1 atm
_HOTTEST_FIT_C = 100.0  # the equations are fitted up to here
_IDEAL_FROM_C = 200.0  # from here on the air is an ideal gas


@public
def air_refractivity(
    wavelength_nm: ArrayLike = 532.0,
    temperature_c: ArrayLike = 20.0,
    pressure_pa: ArrayLike = ATMOSPHERE_PA,
    relative_humidity: ArrayLike = 0.0,
    co2_ppm: ArrayLike = 450.0,
) -> float | np.ndarray:
    """Refractivity n - 1 of air: Ciddor's equation, continued above 100 degC.

    Above 100 degC n - 1 is linear in density (n = 1 at density 0), the vapour's mole fraction stays
    what the humidity makes it at 100 degC (the saturation fit diverges), and the air is an ideal
    gas: the compressibility, 1.00007 at 100 degC and 1 atm, goes linearly to 1 at 200 degC, which
    keeps n - 1 continuous. Real air stays within 1e-4 of an ideal gas there. For air heated from
    humid surroundings, scale the surroundings' n - 1 with the density instead.

    Parameters
    ----------
    wavelength_nm : array_like
        Vacuum wavelength, 300 to 1700 nm.
    temperature_c : array_like
        Temperature, degC, from -40 degC up.
    pressure_pa : array_like
        Total pressure, 10e3 to 140e3 Pa.
    relative_humidity : array_like
        0 to 1, over water (below 0 degC over ice).
    co2_ppm : array_like
        CO2 content, 0 to 2000 ppm.

    Returns
    -------
    float or ndarray
        n - 1; a float if all inputs are scalars, else an array of their broadcast shape.

    Raises
    ------
    InputError
        If an input is out of range or not finite, or there is more vapour than pressure.
    """
    wavelength = _within("wavelength_nm", wavelength_nm, 300.0, 1700.0)
    t = _within("temperature_c", temperature_c, -40.0, 1e4)
    p = _within("pressure_pa", pressure_pa, LEAST_PA, MOST_PA)
    h = _within("relative_humidity", relative_humidity, 0.0, 1.0)
    x_c = _within("co2_ppm", co2_ppm, 0.0, 2000.0)

    shapes = [values.shape for values in (wavelength, t, p, h, x_c)]
    try:
        np.broadcast_shapes(*shapes)
    except ValueError:
        raise InputError(
            f"air_refractivity: the shapes {', '.join(map(str, shapes))} of wavelength_nm,"
            " temperature_c, ... do not go together; give single numbers, or arrays of one shape"
        ) from None
    t_fit = np.minimum(t, _HOTTEST_FIT_C)
    x = _vapour_fraction(t_fit, p, h)
    if np.any(x > 1.0):
        raise InputError(
            "relative_humidity: at this temperature and pressure the vapour alone would exceed the "
            "total pressure; give a lower humidity"
        )
    still_real = np.clip((_IDEAL_FROM_C - t) / (_IDEAL_FROM_C - _HOTTEST_FIT_C), 0.0, 1.0)
    Z = 1.0 + (_compressibility(t_fit, p, x) - 1.0) * still_real

    molar_density = p / (Z * _R * (t + ZERO_CELSIUS_K))  # mol/m^3
    rho_air = molar_density * _molar_mass(x_c) * (1.0 - x)
    rho_water = molar_density * _M_WATER * x
    refractivity = (
        rho_air * _standard_air(wavelength, x_c) / _standard_density(x_c)
        + rho_water * _standard_vapour(wavelength) / _RHO_WATER_STANDARD
    )  # Eq. (5)
    return float(refractivity) if np.ndim(refractivity) == 0 else refractivity


def refractivity_of_density(
    density_kg_m3: ArrayLike, wavelength_nm: ArrayLike = 532.0
) -> float | np.ndarray:
    """Refractivity n - 1 of dry air (450 ppm CO2) of a given density, to which it is proportional.

    Parameters
    ----------
    density_kg_m3 : array_like
        Density, kg/m^3.
    wavelength_nm : array_like
        Vacuum wavelength, 300 to 1700 nm.

    Returns
    -------
    float or ndarray
        n - 1, of the inputs' broadcast shape.

    Raises
    ------
    InputError
        If the wavelength is out of range, or a density is negative or not finite.
    """
    wavelength = _within("wavelength_nm", wavelength_nm, 300.0, 1700.0)
    density = _within("density_kg_m3", density_kg_m3, 0.0, 1e3)
    refractivity = density * _standard_air(wavelength, 450.0) / _standard_density(450.0)
    return float(refractivity) if np.ndim(refractivity) == 0 else refractivity


def _within(name: str, values: ArrayLike, low: float, high: float) -> np.ndarray:
    """`values` as float64, all of them within [low, high] (a NaN is not)."""
    array = numbers_of(name, values)
    outside = ~((array >= low) & (array <= high))
    if outside.any():
        raise InputError(f"{name} = {array[outside][0]:g} is outside {low:g} to {high:g}")
    return array


def _standard_air(wavelength_nm: np.ndarray, x_c: float | np.ndarray) -> np.ndarray:
    """Refractivity of dry air at 15 degC, 101325 Pa and `x_c` ppm CO2, Eqs. (1), (2)."""
    s2 = (1e3 / wavelength_nm) ** 2  # 1/um^2
    n_as = 1e-8 * (5792105.0 / (238.0185 - s2) + 167917.0 / (57.362 - s2))
    return n_as * (1.0 + 0.534e-6 * (x_c - 450.0))


def _standard_vapour(wavelength_nm: np.ndarray) -> np.ndarray:
    """Refractivity of water vapour at 20 degC and 1333 Pa, Eq. (3)."""
    s2 = (1e3 / wavelength_nm) ** 2
    return 1.022e-8 * (295.235 + 2.6422 * s2 - 0.032380 * s2**2 + 0.004028 * s2**3)


def _standard_density(x_c: float | np.ndarray) -> float | np.ndarray:
    """Density of dry air at 15 degC and 101325 Pa, kg/m^3, Eq. (4)."""
    return ATMOSPHERE_PA * _molar_mass(x_c) / (_Z_STANDARD * _R * (15.0 + ZERO_CELSIUS_K))


def _molar_mass(x_c: float | np.ndarray) -> float | np.ndarray:
    """Molar mass of dry air, kg/mol."""
    return 1e-3 * (28.9635 + 12.011e-6 * (x_c - 400.0))


def _vapour_fraction(t: np.ndarray, p: np.ndarray, h: np.ndarray) -> np.ndarray:
    """Mole fraction of water vapour at relative humidity `h`: saturation pressure, enhancement."""
    T = t + ZERO_CELSIUS_K
    over_water = np.exp(1.2378847e-5 * T**2 - 1.9121316e-2 * T + 33.93711047 - 6343.1645 / T)
    over_ice = 10.0 ** (12.537 - 2663.5 / T)
    f = 1.00062 + 3.14e-8 * p + 5.6e-7 * t**2
    return f * h * np.where(t >= 0.0, over_water, over_ice) / p


def _compressibility(t: np.ndarray, p: np.ndarray, x: np.ndarray) -> np.ndarray:
    """Z of moist air with vapour mole fraction `x`, Eq. (12)."""
    p_T = p / (t + ZERO_CELSIUS_K)
    first = (
        (1.58123e-6 - 2.9331e-8 * t + 1.1043e-10 * t**2)
        + (5.707e-6 - 2.051e-8 * t) * x
        + (1.9898e-4 - 2.376e-6 * t) * x**2
    )
    return 1.0 - p_T * first + p_T**2 * (1.83e-11 - 0.765e-8 * x**2)
