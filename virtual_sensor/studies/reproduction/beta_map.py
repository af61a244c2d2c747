"""What the paper could not do: the deviation of the whole line over all poses of the sensor."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from virtual_sensor.studies.measure import Report
from virtual_sensor.studies.reproduction.curves import Setting, searched
from virtual_sensor.studies.reproduction.settings import SCAN, Broadening, Scenes

Array = NDArray[np.float64]

BETAS_DEG = np.linspace(0.0, 90.0, 31)
LINE_MM = np.linspace(-11.0, 11.0, 45)


@dataclass(frozen=True)
class BetaMap:
    """Deviation of the measured points over beta and y.

    Attributes
    ----------
    air : str
    temperature_c : float
    beta_deg : ndarray of shape (M,)
        Turn of the sensor, from above (0) to the side (90).
    y_mm : ndarray of shape (N,)
        Position along the laser line.
    measured_um : ndarray of shape (M, N, 3)
        B_m - A_m, world; NaN where one of the two was not found.
    pixel_px : ndarray of shape (M, N, 2)
        Hot minus cold pixel.
    """

    air: str
    temperature_c: float
    beta_deg: Array
    y_mm: Array
    measured_um: Array
    pixel_px: Array


def beta_map(
    scenes: Scenes,
    air: str,
    broadening: Broadening,
    temperature_c: float = 1250.0,
    beta_deg: Array = BETAS_DEG,
    y_mm: Array = LINE_MM,
    report: Report = lambda stage, fraction: None,
) -> BetaMap:
    """Search the whole line from pose to pose."""
    found = []
    for number, beta in enumerate(beta_deg):
        report(f"all poses, {air} air", number / len(beta_deg))
        scene = scenes.scene(temperature_c, float(beta), broadening)
        setting = Setting(air, temperature_c, float(beta))
        found.append(searched(scene, setting, y_mm, SCAN, helper=False).exact)
    return BetaMap(
        air,
        temperature_c,
        beta_deg,
        y_mm,
        np.stack([d.measured_um for d in found]),
        np.stack([d.pixel_px for d in found]),
    )
