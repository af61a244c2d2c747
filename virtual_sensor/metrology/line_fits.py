"""Line detectors: where the centre of a profile lies, and what the profile is."""

from collections.abc import Callable
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from virtual_sensor.metrology.line_profiles import (
    REACH,
    Array,
    Peaks,
    Profile,
    pixel_gaussian,
    window,
)

TOLERANCE = 1e-5  # in sigma: the last Gauss-Newton step
MAX_STEPS = 40


class Noise(NamedTuple):
    """What a detector is told of the image's noise.

    Attributes
    ----------
    dark : float
        Standard deviation where it is dark, in the image's unit.
    shot : float
        Growth of the variance per unit of signal, relative to that in the dark.
    """

    dark: float
    shot: float


def fit_gaussian(image: NDArray, at: Peaks, noise: Noise, max_sigma: float) -> Profile:
    """Fit pixel-integrated Gaussians by Gauss-Newton, all columns at once."""
    result = np.full((len(Profile._fields), at.column.size), np.nan)
    index = np.arange(at.column.size)
    for number in range(MAX_STEPS):
        profile, step = gauss_newton(image, at, noise.shot)
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
        ).take(going)
        index = index[going]
    return Profile(*result)


def gauss_newton(image: NDArray, at: Peaks, shot_noise: float) -> tuple[Profile, Array]:
    """Take one step; return the new profile and the length of the step in sigma.

    Fitting b + A G + p sigma dG/drow + q sigma dG/dsigma is linear; p/A and q/A are the step.
    """
    rows, inside, values = window(image, at)
    basis = pixel_gaussian(rows, at.row, at.sigma)
    taper = inside * np.clip(REACH - np.abs(rows - at.row) / np.maximum(at.sigma, 1.0), 0.0, 1.0)
    weight = taper / (1.0 + shot_noise * at.amplitude * basis[1])

    weighted = weight * basis
    normal = np.einsum("inl,jnl->lij", weighted, basis) + 1e-12 * np.eye(4)  # never singular
    covariance = np.linalg.inv(normal)
    coefficients = np.einsum("lij,jnl,nl->il", covariance, weighted, values, optimize=True)
    background, amplitude, p, q = coefficients
    amplitude = np.maximum(amplitude, 0.05 * at.amplitude)  # a peak stays a peak on its way
    shift = np.clip(p / amplitude, -0.5, 0.5)
    growth = np.clip(q / amplitude, -0.3, 0.5)

    misfit = values - np.einsum("il,inl->nl", coefficients, basis)
    free = np.maximum(taper.sum(axis=0) - 4.0, 1.0)
    variance = (weight * misfit**2).sum(axis=0) / free
    profile = Profile(
        row=at.row + at.sigma * shift,
        sigma=np.maximum(at.sigma * (1.0 + growth), 0.1),
        amplitude=amplitude,
        background=background,
        row_error=at.sigma / amplitude * np.sqrt(variance * covariance[:, 2, 2]),
        residual=np.sqrt((taper * misfit**2).sum(axis=0) / free),
    )
    return profile, np.hypot(shift, growth)


def log_parabola(image: NDArray, at: Peaks, noise: Noise, max_sigma: float) -> Profile:
    """Three-point Gaussian: a parabola through the logarithms round the highest row."""
    near = np.clip(at.peak + np.arange(-2, 3)[:, None], 1, len(image) - 2)
    top = np.take_along_axis(near, image[near, at.column].argmax(axis=0)[None], axis=0)[0]
    above = image[top + np.arange(-1, 2)[:, None], at.column] - at.background
    usable = (above > 0.0).all(axis=0)
    above = np.where(usable, above, 1.0)
    left, middle, right = np.log(above)
    curvature = left - 2.0 * middle + right
    curvature = np.where(usable & (curvature < 0.0), curvature, np.nan)
    offset = (left - right) / (2.0 * curvature)
    offset = np.where(np.abs(offset) <= 1.0, offset, np.nan)

    broadened = -1.0 / curvature  # s^2 = sigma^2 + 1/12: the pixel adds the variance of its width
    sigma = np.sqrt(np.maximum(broadened - 1.0 / 12.0, 0.01))
    slopes = np.stack([0.5 - offset, 2.0 * offset, -0.5 - offset]) / curvature
    return Profile(
        row=top + offset,
        sigma=np.where(usable, sigma, 0.0),  # fewer than three rows stand out
        amplitude=np.exp(middle - curvature * offset**2 / 2.0) * np.sqrt(broadened) / sigma,
        background=at.background,
        row_error=noise.dark * np.linalg.norm(slopes / above, axis=0),
        residual=np.zeros_like(offset),
    )


METHODS: dict[str, Callable[[NDArray, Peaks, Noise, float], Profile]] = {
    "gaussian": fit_gaussian,
    "log_parabola": log_parabola,
}
"""Detectors by name: (image, peaks, noise, broadest line in px) to profiles."""
