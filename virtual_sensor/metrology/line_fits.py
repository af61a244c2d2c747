"""Detectors that fit a pixel-integrated Gaussian on a level background, all columns at once.

Gauss-Newton (Bjorck 1996, "Numerical methods for least squares problems", 9.2) in a window that
follows the line's width.  They differ in their weights:

- full least squares: none but the window's;
- weighted: by the noise of each pixel by its own grey value (Bevington 1969, 6.4);
- maximum likelihood under shot and read noise: by the noise of the fitted line.  That is
  the scoring of a Poisson law with the read noise's variance added to mean and data (Huang et al.
  2013, Nature Methods 10, 653, equation 2), whose information is the Cramer-Rao bound's.
"""

from collections.abc import Callable

import numpy as np
from numpy.typing import NDArray

from virtual_sensor.metrology.line_profiles import (
    REACH,
    Array,
    Noise,
    Peaks,
    Profile,
    pixel_gaussian,
    window,
)

TOLERANCE = 1e-5  # in sigma: the last Gauss-Newton step
MAX_STEPS = 40
_BLOCK = 700  # peaks at a time, so that a core's cache holds their windows
_LEAST_VARIANCE = 1e-4  # of a pixel, relative to the peak's: none may weigh more

Variance = Callable[[Array, Array, Peaks], Array]
"""(grey values, fitted signal) above the background, (n, L) each, of peaks, to their variance."""


def fit_gaussian(image: NDArray, at: Peaks, noise: Noise, max_sigma: float) -> Profile:
    """Full least squares: every pixel counts the same (Bjorck 1996)."""
    return _fitted(image, at, noise, max_sigma, lambda values, *_: np.ones_like(values))


def fit_weighted(image: NDArray, at: Peaks, noise: Noise, max_sigma: float) -> Profile:
    """Least squares weighted by the measured grey values' noise (Bevington 1969)."""
    return _fitted(
        image, at, noise, max_sigma, lambda values, _, at: noise.variance(values, at.column)
    )


def fit_likeliest(image: NDArray, at: Peaks, noise: Noise, max_sigma: float) -> Profile:
    """Maximum likelihood under shot and read noise (Huang et al. 2013)."""
    return _fitted(
        image, at, noise, max_sigma, lambda _, signal, at: noise.variance(signal, at.column)
    )


def _fitted(
    image: NDArray, at: Peaks, noise: Noise, max_sigma: float, variance: Variance
) -> Profile:
    if at.column.size > _BLOCK:
        parts = np.array_split(np.arange(at.column.size), -(-at.column.size // _BLOCK))
        fits = [_fitted(image, at.take(part), noise, max_sigma, variance) for part in parts]
        return Profile(*np.concatenate(fits, axis=1))
    result = np.full((len(Profile._fields), at.column.size), np.nan)
    index = np.arange(at.column.size)
    for number in range(MAX_STEPS):
        profile, step = gauss_newton(image, at, noise, variance)
        done = step < TOLERANCE + 0.02 * profile.row_error / profile.sigma
        result[:, index[done]] = np.array(profile)[:, done]
        near = np.abs(profile.row - at.peak) < REACH * np.maximum(at.sigma, 1.0)
        going = ~done & near & (profile.sigma < 2.0 * max_sigma)
        if not going.any():
            break
        # In noise the window and the fit inside it can chase each other in a cycle of two.
        damping = 1.0 if number < 6 else 0.5
        at = at._replace(
            row=at.row + damping * (profile.row - at.row),
            sigma=at.sigma + damping * (profile.sigma - at.sigma),
            amplitude=profile.amplitude,
            background=profile.background,
        ).take(going)
        index = index[going]
    return Profile(*result)


def gauss_newton(
    image: NDArray, at: Peaks, noise: Noise, variance: Variance
) -> tuple[Profile, Array]:
    """Take one step; return the new profile and the length of the step in sigma.

    Fitting b + A G + p sigma dG/drow + q sigma dG/dsigma is linear; p/A and q/A are the step.
    """
    rows, inside, values = window(image, at)
    basis = pixel_gaussian(rows, at.row, at.sigma)
    taper = inside * np.clip(REACH - np.abs(rows - at.row) / np.maximum(at.sigma, 1.0), 0.0, 1.0)
    signal = at.amplitude * basis[1]
    spread = variance(values - at.background, signal, at)
    least = np.maximum(_LEAST_VARIANCE * spread.max(axis=0), np.finfo(float).tiny)
    weight = taper / np.maximum(spread, least)
    weight /= weight.max(axis=0)

    weighted = weight * basis
    normal = np.einsum("inl,jnl->lij", weighted, basis) + 1e-12 * np.eye(4)  # never singular
    covariance = np.linalg.inv(normal)
    coefficients = np.einsum("lij,jl->il", covariance, np.einsum("jnl,nl->jl", weighted, values))
    background, amplitude, p, q = coefficients
    amplitude = np.maximum(amplitude, 0.05 * at.amplitude)  # a peak stays a peak between steps
    shift = np.clip(p / amplitude, -0.5, 0.5)
    growth = np.clip(q / amplitude, -0.3, 0.5)

    if noise.known:
        by_pixel = np.einsum("lj,jnl->nl", covariance[:, 2], weighted)
        shift_variance = (by_pixel**2 * noise.variance_near(at, signal)).sum(axis=0)
    else:
        misfit = values - np.einsum("il,inl->nl", coefficients, basis)
        free = np.maximum(taper.sum(axis=0) - 4.0, 1.0)
        shift_variance = (weight * misfit**2).sum(axis=0) / free * covariance[:, 2, 2]
    profile = Profile(
        row=at.row + at.sigma * shift,
        row_error=at.sigma / amplitude * np.sqrt(shift_variance),
        sigma=np.maximum(at.sigma * (1.0 + growth), 0.1),
        amplitude=amplitude,
        background=background,
    )
    return profile, np.hypot(shift, growth)
