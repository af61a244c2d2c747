"""Light as eyes see it: lumen of a wavelength in watts."""

import numpy as np

from virtual_sensor.errors import InputError

LUMEN_PER_WATT = 683.0  # of 540 THz, 555 nm: the SI's definition of the candela
_FIRST_NM, _STEP_NM = 380.0, 10.0
_EFFICIENCY = (  # CIE 1931's y, which is the luminous efficiency V of 1924, from 380 nm on
    *(0.000039, 0.00012, 0.000396, 0.00121, 0.0040, 0.0116, 0.0230, 0.0380, 0.0600, 0.09098),
    *(0.13902, 0.20802, 0.3230, 0.5030, 0.7100, 0.8620, 0.9540, 0.99495, 0.9950, 0.9520),
    *(0.8700, 0.7570, 0.6310, 0.5030, 0.3810, 0.2650, 0.1750, 0.1070, 0.0610, 0.0320),
    *(0.0170, 0.00821, 0.004102, 0.002091, 0.001047, 0.00052, 0.000249, 0.00012, 0.00006),
    *(0.00003, 0.000015),
)


def luminous_efficiency(wavelength_nm: float) -> float:
    """V of a wavelength, by day: 1 at 555 nm, 0.88 at 532.

    Raises
    ------
    InputError
        Where nothing is seen: beyond 380 to 780 nm.
    """
    from scipy.interpolate import CubicSpline

    known_nm = _FIRST_NM + _STEP_NM * np.arange(len(_EFFICIENCY))
    if not known_nm[0] <= wavelength_nm <= known_nm[-1]:
        raise InputError(
            f"light of {wavelength_nm:g} nm is invisible and has no lumen; give its power in W"
        )
    return float(np.exp(CubicSpline(known_nm, np.log(_EFFICIENCY))(wavelength_nm)))


def watts_of(lumen: float, wavelength_nm: float) -> float:
    """Power in W of light of one wavelength."""
    return lumen / (LUMEN_PER_WATT * luminous_efficiency(wavelength_nm))
