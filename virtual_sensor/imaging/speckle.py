"""Laser speckle on a frame: coherent imaging of a rough surface by a round aperture.

The surface scatters the light with random phase: its field is the square root of the ideal frame
times circular complex Gaussian noise, without correlation.  The aperture passes the field's
frequencies up to 1/(2 lambda N), N the working f-number; the intensity is the field's square, and
the pixels integrate it.  Contrast and grain so follow from aperture and wavelength, and the mean of
many frames is the ideal frame blurred by diffraction.  Goodman 2007, "Speckle phenomena in optics",
chapters 3 to 5.

Limits: fully developed speckle of a surface at rest, one wavelength, no aberration or defocus; a
laser line's columns are as alike as the aperture makes them.  Light that the surface depolarises
makes two patterns, which add: `polarisations`.  Light of other sources is added afterwards.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from itertools import pairwise

import numpy as np
from numpy.typing import ArrayLike, NDArray
from scipy.fft import fft2, fftfreq, ifft2, next_fast_len
from scipy.integrate import quad
from scipy.special import j1, struve

from virtual_sensor.arrays import (
    LARGEST,
    SMALLEST,
    generator_of,
    image_of,
    number_within,
    whole_number,
)
from virtual_sensor.calls import public
from virtual_sensor.display import Displayed
from virtual_sensor.errors import InputError, short

Array = NDArray[np.float64]

_APRON_GRAINS = 8  # about what is lit, and about each strip; 1 % of the light is scattered farther
_MOST_SAMPLES = 1 << 23  # of a strip
_MOST_FINE = 32  # samples per pixel's side
_DARK = 1e-30  # of the brightest pixel
_AIRY_ZERO = 1.2197  # of 2 J1(pi x)/(pi x)


@public
@dataclass(frozen=True)
class Aperture(Displayed):
    """What the camera's lens lets through.

    Attributes
    ----------
    f_number : float
    wavelength_nm : float
    pixel_um : float
        Pitch of the pixels.
    magnification : float
        Image over object; the working f-number is N (1 + m).
    polarisations : int
        Patterns that add: 1, or 2 where the surface depolarises.
    """

    f_number: float
    wavelength_nm: float = 532.0
    pixel_um: float = 5.5
    magnification: float = 0.0
    polarisations: int = 1

    def __post_init__(self) -> None:
        for name in ("f_number", "wavelength_nm", "pixel_um"):
            number_within(f"aperture: {name}", getattr(self, name), SMALLEST, LARGEST, "it above 0")
        number_within("aperture: magnification", self.magnification, 0.0, LARGEST, "it from 0 on")
        whole_number("aperture: polarisations", self.polarisations, 1, 2)

    @property
    def resolution_px(self) -> float:
        """Wavelength times working f-number, lambda N, in px: the inverse of the cutoff."""
        working = self.f_number * (1.0 + self.magnification)
        return self.wavelength_nm * 1e-3 * working / self.pixel_um

    @property
    def grain_px(self) -> float:
        """Radius of a speckle: first zero of the intensity's correlation, 1.22 lambda N."""
        return _AIRY_ZERO * self.resolution_px

    def correlation(self, distance_px: ArrayLike) -> Array:
        """Correlation of the intensity on the sensor, |2 J1(x)/x|^2: Goodman 2007, 5.2."""
        x = np.pi * np.asarray(distance_px, float) / self.resolution_px
        small = np.abs(x) < 1e-6
        return np.where(small, 1.0, (2.0 * j1(x) / np.where(small, 1.0, x)) ** 2)

    @property
    def contrast(self) -> float:
        """Standard deviation over mean of the pixels' grey values where the light is even.

        C^2 = integral of (1 - |x|)(1 - |y|) |2 J1/r|^2 over the pixel, over the polarisations:
        Goodman 2007, 4.6.  The sum over directions is done first, so that one integral is left.
        """

        def ring(r: float) -> float:
            """Integral of the triangles over a circle of radius r."""
            if r <= 1.0:
                return r * (2.0 * np.pi - 8.0 * r + 2.0 * r**2)
            low = np.arccos(1.0 / r)
            if low >= np.pi / 4.0:
                return 0.0
            ends = np.array([low, np.pi / 2.0 - low])
            parts = ends - r * (np.sin(ends) - np.cos(ends)) + 0.5 * r**2 * np.sin(ends) ** 2
            return 4.0 * r * float(parts[1] - parts[0])

        edges = np.clip(np.arange(0.0, 3.0, 0.5 * self.resolution_px), 0.0, np.sqrt(2.0))
        ends = [*edges, 1.0, np.sqrt(2.0)]
        total = _integral(lambda r: ring(r) * float(self.correlation(r)), ends)
        return float(np.sqrt(total / self.polarisations))


def _integral(function: Callable[[float], float], edges: list[float]) -> float:
    """Integral of a function that is smooth between the edges, from the first to the last."""
    between = pairwise(np.unique(edges))
    return float(sum(quad(function, a, b, limit=200)[0] for a, b in between))


@public
def speckled(image: ArrayLike, aperture: Aperture, seed: int | np.random.Generator = 0) -> Array:
    """An image (H, W) as coherent light shows it: with speckle, in the same unit.

    What lies within 8 grains of lit pixels is computed, the rest is dark.  At the image's borders
    the light goes on outside as it is on them.

    Parameters
    ----------
    image : array_like of shape (H, W)
        The ideal frame, of incoherent light: the laser's alone.
    aperture : Aperture
    seed : int or numpy.random.Generator
        Of the surface: the same seed gives the same bits.

    Raises
    ------
    InputError
        Where the image has another shape, or holds what is negative or no number; where the grains
        are finer than a 16th of a pixel.
    """
    if not isinstance(aperture, Aperture):
        raise InputError(f"speckled: aperture is {short(aperture)}; give an Aperture")
    image = image_of("speckled: image", image, 0.0)
    fine = max(3, int(np.ceil(2.0 / aperture.resolution_px)))  # Nyquist, of the intensity
    if fine > _MOST_FINE:
        raise InputError(
            f"speckled: {fine} grains to a pixel's side are too many to simulate, and their "
            f"contrast is {aperture.contrast:.2g}; leave speckle out, or make f_number larger"
        )
    rng = generator_of("speckled: seed", seed)
    seen = np.zeros_like(image)
    brightest = image.max(initial=0.0)
    if not brightest:
        return seen
    light = image / brightest
    light[light < _DARK] = 0.0
    apron = int(np.ceil(_APRON_GRAINS * aperture.grain_px)) + 2
    rows, columns = (np.flatnonzero(light.any(axis=axis)) for axis in (1, 0))
    box = tuple(slice(max(lit[0] - apron, 0), lit[-1] + apron + 1) for lit in (rows, columns))
    light, result = light[box], seen[box]
    if light.shape[0] < light.shape[1]:  # strips go along the longer side
        light, result = light.T, result.T
    for _ in range(aperture.polarisations):
        result += _pattern(light, aperture, fine, apron, rng) / aperture.polarisations
    return seen * brightest


def _pattern(
    light: Array, aperture: Aperture, fine: int, apron: int, rng: np.random.Generator
) -> Array:
    """One polarisation's intensity, strip by strip; strips share the surface where they overlap."""
    surface = np.pad(light, apron, mode="edge")
    width = fine * surface.shape[1]
    overlap = 2 * apron

    def scatterers(rows: int) -> NDArray[np.complex64]:
        pairs = rng.standard_normal((rows * fine, 2 * width), np.float32)
        return pairs.view(np.complex64) * np.float32(np.sqrt(0.5))

    most = max(_MOST_SAMPLES // (fine * width) - overlap, apron)
    seen = np.empty_like(light)
    noise = scatterers(overlap)
    for top in range(0, len(light), most):
        strip = surface[top : top + most + overlap]
        noise = np.concatenate([noise[-overlap * fine :], scatterers(len(strip) - overlap)])
        field = np.sqrt(_finer(_finer(strip, fine).T, fine).T).astype(np.float32) * noise
        imaged = _integrated(_integrated(_intensity(field, aperture, fine), fine).T, fine).T
        seen[top : top + most] = imaged[apron:-apron, apron:-apron]
    return seen


def _finer(image: Array, fine: int) -> Array:
    """Split each row in `fine` whose mean it is, smoothly and without going below 0.

    The running sum is interpolated by monotone cubics (Fritsch and Butland 1984): between rows its
    slope is their harmonic mean. In closed form, as rows are as far apart as others.
    """
    s = (np.arange(fine + 1) / fine)[:, None]
    of_row, of_slope, of_next = (
        fine * np.diff(basis, axis=0)
        for basis in (s**2 * (3.0 - 2.0 * s), s * (1.0 - s) ** 2, s**2 * (s - 1.0))
    )
    around = np.pad(image, ((1, 1), (0, 0)), mode="edge")
    both = around[:-1] + around[1:]
    slope = 2.0 * around[:-1] * around[1:] / np.where(both > 0.0, both, 1.0)
    row, before, after = image[:, None], slope[:-1, None], slope[1:, None]
    parts = of_row * row + of_slope * before + of_next * after
    return np.maximum(parts, 0.0).reshape(fine * len(image), -1)


def _intensity(field: NDArray[np.complex64], aperture: Aperture, fine: int) -> NDArray[np.float32]:
    """Intensity behind the aperture, which keeps the light's power."""
    shape = [next_fast_len(n) for n in field.shape]
    squared = [(fftfreq(n) * fine) ** 2 for n in shape]
    passed = squared[0][:, None] + squared[1] <= (0.5 / aperture.resolution_px) ** 2
    spectrum = fft2(field, shape, workers=-1)
    spectrum *= passed / np.float32(np.sqrt(passed.mean()))
    seen = ifft2(spectrum, workers=-1, overwrite_x=True)[: field.shape[0], : field.shape[1]]
    return seen.real**2 + seen.imag**2


def _integrated(samples: NDArray, fine: int) -> NDArray:
    """Integrate each `fine` rows of samples: midpoint rule with its h^2 term, i + i''/24."""
    curved = np.zeros_like(samples)
    curved[1:-1] = samples[2:] - 2.0 * samples[1:-1] + samples[:-2]
    return (samples + curved / 24.0).reshape(-1, fine, samples.shape[1]).mean(axis=1)


def broad_line_noise_px(aperture: Aperture, width_px: float) -> float:
    """Standard deviation of each column's centre of gravity of a line much broader than a speckle.

    `width_px` is the Gaussian line's standard deviation in the image.  A column holds independent
    grains of length S = integral of the intensity's correlation along v, averaged over the pixel's
    width: var = S w/(4 sqrt(pi)), from S integral of x^2 I^2 over (integral of I)^2 with
    I = exp(-x^2/(2 w^2)), over the polarisations (the correlation: Goodman 2007, 5.2).  The noise
    grows with the line's width.  Along v, |2 J1/r|^2 adds up to 4 H1(2x)/x^2, H1 Struve's: the
    diffraction image of a line.
    """

    def line_spread(u: float) -> float:
        x = np.pi * u / aperture.resolution_px
        return float(4.0 * struve(1, 2.0 * x) / x**2) if x > 1e-6 else 32.0 / (3.0 * np.pi)

    edges = np.clip(np.array([0.0, 1.0, 4.0, 16.0]) * aperture.resolution_px, 0.0, 1.0)
    overlap = _integral(lambda u: 2.0 * (1.0 - u) * line_spread(u), [*edges, 1.0])
    length = aperture.resolution_px / np.pi * overlap
    return float(np.sqrt(length * width_px / (4.0 * np.sqrt(np.pi)) / aperture.polarisations))
