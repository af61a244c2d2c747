"""Thermal radiation of a hot surface, after Planck's law."""

import numpy as np

from virtual_sensor.medium.units import ZERO_CELSIUS_K

# Defining constants of the SI; scipy.constants has them too, and takes a tenth of a second to load.
c = 299_792_458.0  # speed of light, m/s
h = 6.626_070_15e-34  # Planck constant, J s
k = 1.380_649e-23  # Boltzmann constant, J/K

_M_PER_NM = 1e-9
_M2_PER_MM2 = 1e-6


def spectral_radiance(wavelength_nm: float, temperature_c: float) -> float:
    """Of a black body, W/(mm^2 sr nm): 2 h c^2/lambda^5/(exp(h c/(lambda k T)) - 1)."""
    wavelength = wavelength_nm * _M_PER_NM
    kelvin = temperature_c + ZERO_CELSIUS_K
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
