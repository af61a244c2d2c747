"""Thermal radiation of a hot surface, after Planck's law."""

import numpy as np
from scipy.constants import c, convert_temperature, h, k

_M_PER_NM = 1e-9
_M2_PER_MM2 = 1e-6


def spectral_radiance(wavelength_nm: float, temperature_c: float) -> float:
    """Of a black body, W/(mm^2 sr nm): 2 h c^2/lambda^5/(exp(h c/(lambda k T)) - 1)."""
    wavelength = wavelength_nm * _M_PER_NM
    kelvin = float(convert_temperature(temperature_c, "Celsius", "Kelvin"))
    if kelvin <= 0.0:
        return 0.0
    exponent = h * c / (wavelength * k * kelvin)
    # Written so that a cold body's exponential does not overflow.
    per_metre = 2.0 * h * c**2 / wavelength**5 * np.exp(-exponent) / -np.expm1(-exponent)
    return float(per_metre * _M_PER_NM * _M2_PER_MM2)


def band_radiance(wavelength_nm: float, bandwidth_nm: float, temperature_c: float) -> float:
    """Of a black body through a filter that passes a band, all of it: W/(mm^2 sr).

    Parameters
    ----------
    wavelength_nm : float
        Middle of the band.
    bandwidth_nm : float
        From its one edge to the other.
    temperature_c : float
        degC.
    """
    from scipy.integrate import quad

    half = bandwidth_nm / 2.0
    ends = max(wavelength_nm - half, 1.0), wavelength_nm + half
    return float(quad(spectral_radiance, *ends, args=(temperature_c,), epsrel=1e-10)[0])
