"""How coherent a laser's light is when a surface gives it back: how many speckle patterns add."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from virtual_sensor.arrays import number_within, whole_number
from virtual_sensor.display import Displayed

_FWHM = 2.0 * np.sqrt(2.0 * np.log(2.0))  # of a Gaussian, in standard deviations
_MOST = 1e6


@dataclass(frozen=True, kw_only=True)
class Coherence(Displayed):
    """What makes several speckle patterns of one: they add, and the contrast falls.

    Attributes
    ----------
    polarisations : int
        Patterns that add: 1, or 2 where the surface depolarises.
    linewidth_nm : float
        Full width of the laser's spectrum at half its height; 0: one wavelength.
    roughness_um : float
        Standard deviation of the depths from which light comes back: Rq of a rough surface, the
        depth of penetration of paint, paper or ceramics.
    modes : float
        Of the laser, incoherent to each other, whose patterns differ; 1 of a single-mode one.
    """

    polarisations: int = 1
    linewidth_nm: float = 0.0
    roughness_um: float = 0.0
    modes: float = 1.0

    def __post_init__(self) -> None:
        whole_number("polarisations", self.polarisations, 1, 2)
        for name in ("linewidth_nm", "roughness_um"):
            number_within(name, getattr(self, name), 0.0, _MOST, f"it from 0 to {_MOST:g}")
        number_within("modes", self.modes, 1.0, _MOST, f"it from 1 to {_MOST:g}")

    def patterns_at(self, wavelength_nm: float) -> float:
        """Number of equal patterns that would have the contrast of all, which is 1/sqrt(it).

        Of a Gaussian spectrum and Gaussian depths, square to light and sight, the patterns of all
        wavelengths together have a squared contrast of 1/sqrt(1 + (4 sigma_h sigma_k)^2), sigma_h
        the spread of depths and sigma_k that of 2 pi/lambda: Parry 1974; Goodman 2007, 5.3.
        """
        spread = 2.0 * np.pi * self.linewidth_nm / _FWHM * 1e3 / wavelength_nm**2  # 1/um
        of_depth = np.sqrt(1.0 + (4.0 * self.roughness_um * spread) ** 2)
        return float(self.polarisations * self.modes * of_depth)


def weights_of(patterns: float) -> NDArray[np.float64]:
    """Parts of the light of the fewest patterns with the contrast of so many equal ones.

    All are alike but the last, which has less where the number is not whole.
    """
    many = int(np.ceil(patterns * (1.0 - 1e-12))) - 1
    if not many:
        return np.ones(1)
    rest = max(1.0 - (1.0 + 1.0 / many) * (1.0 - 1.0 / patterns), 0.0)
    each = (1.0 + np.sqrt(rest)) / (1.0 + many)
    return np.array([each] * many + [1.0 - many * each])
