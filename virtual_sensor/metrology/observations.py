"""What a fit is given: pixels that were measured, and what is known before."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import NDArray

from virtual_sensor.arrays import LARGEST, SMALLEST, number_within, numbers_of, points_of
from virtual_sensor.calls import public
from virtual_sensor.display import Displayed, listed
from virtual_sensor.errors import InputError
from virtual_sensor.metrology.centres import LineCentres
from virtual_sensor.optics.sources import first_coordinate

Array = NDArray[np.float64]
SIGMA_PX = 0.02
"""Noise of a line's centre where nobody says another one."""


@public
@dataclass(frozen=True)
class Prior(Displayed):
    """What is known of a parameter before anything is measured.

    Attributes
    ----------
    value, sigma : float
        Mean and standard deviation, in the parameter's unit.
    """

    value: float
    sigma: float

    def __post_init__(self) -> None:
        number_within("Prior: value", self.value, -LARGEST, LARGEST, "a finite number")
        number_within("Prior: sigma", self.sigma, SMALLEST, LARGEST, "a positive number")

    def _line(self) -> str:
        return f"{self.value:.6g} ± {self.sigma:.2g}"


@public
@dataclass(frozen=True, eq=False)
class Observation(Displayed):
    """Pixels that one sensor measured at one moment, and what is known of their light.

    Attributes
    ----------
    scene : Scene
        With one camera and one source, where they are thought to stand. Its air plays no role.
    pixel : ndarray of shape (N, 2)
        (u, v), integer at pixel centres. `LineCentres` may be given: their noise and its direction
        are then the detector's. What is not finite is left out.
    sigma_px : ndarray of shape (N,)
        Standard deviation of the pixels' noise; one number for all may be given.
    coordinate : ndarray of shape (N,)
        First coordinate s of the source's rays. By default 0, the middle of a laser's sheet; a
        projector has no such.
    along_mm : ndarray of shape (N,) or None
        Their second coordinate t, where it is known: of dots.
    name : str
    normal_deg : ndarray of shape (N,) or None
        Direction in which the pixels were measured, degrees from +u towards +v: 90 of a line whose
        columns were searched, as usual. None: both u and v were, as of dots.
    """

    scene: Any
    pixel: Any
    sigma_px: Any = None
    coordinate: Any = None
    along_mm: Any = None
    name: str = ""
    normal_deg: Any = "by kind"

    def __post_init__(self) -> None:
        line = self.pixel if isinstance(self.pixel, LineCentres) else None
        pixel = points_of("Observation: pixel", line.pixel if line else self.pixel, 2)
        pixel = pixel.reshape(-1, 2) if line else pixel
        if pixel.ndim != 2 or pixel.shape[1] != 2:
            raise InputError(
                f"Observation: pixel has shape {pixel.shape}; give (N, 2), (u, v) each"
            )
        sigma, normal = self.sigma_px, self.normal_deg
        if sigma is None:
            sigma = SIGMA_PX
            if line is not None:
                own = np.ravel(line.sigma)
                sigma = np.where(own > 0.0, own, SIGMA_PX)
        if isinstance(normal, str):
            normal = None if self.along_mm is not None else 90.0
            if line is not None and normal is not None:
                normal = np.ravel(line.normal_deg)
        sources = [*getattr(self.scene, "sources", {}).values(), None]
        coordinate = first_coordinate("Observation", sources[0], self.coordinate)
        given = {"sigma_px": sigma, "coordinate": coordinate}
        given |= {"along_mm": self.along_mm, "normal_deg": normal}
        for name, values in given.items():
            if values is not None:
                numbers = numbers_of(f"Observation: {name}", values)
                if numbers.shape not in ((), pixel.shape[:1]):
                    raise InputError(
                        f"Observation: {name} has shape {numbers.shape} for {len(pixel)} pixels;"
                        " give one number, or one for each"
                    )
                object.__setattr__(self, name, np.broadcast_to(numbers, pixel.shape[:1]))
            else:
                object.__setattr__(self, name, None)
        if not np.all(np.nan_to_num(self.sigma_px, nan=1.0) > 0.0):
            raise InputError("Observation: sigma_px must be positive: the pixels' noise in px")
        object.__setattr__(self, "pixel", pixel)

    def _line(self) -> str:
        kind = "pixels of a line" if self.along_mm is None else "dots"
        count = int(np.isfinite(self.pixel).all(axis=1).sum())
        sigma = f"noise {np.nanmedian(self.sigma_px):.3g} px" if count else ""
        return listed(self.name, f"{count} {kind}", sigma)

    @property
    def covariance_px2(self) -> Array:
        """Of the pixels' noise, (N, 2, 2)."""
        square = self.sigma_px[:, None, None] ** 2
        if self.normal_deg is None:
            return square * np.eye(2)
        angle = np.radians(self.normal_deg)
        normal = np.stack([np.cos(angle), np.sin(angle)], axis=1)
        return square * normal[:, :, None] * normal[:, None, :]
