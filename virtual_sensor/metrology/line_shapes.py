"""Is a profile that of one line?  Two lines that merge, or an edge across one, shift its centre."""

import numpy as np
from numpy.typing import NDArray

from virtual_sensor.metrology.line_fits import Noise, gauss_newton
from virtual_sensor.metrology.line_profiles import (
    REACH,
    Array,
    Peaks,
    Profile,
    pixel_gaussian,
    window,
)

MAX_SKEW = 0.02  # of the third Hermite term; a skewed profile's centre is off by as many px or more
MAX_FLAT = 0.03  # of the fourth: two lines of the same height, 2 sigma apart or more
MAX_STEP = 0.1  # of the level below the line from one side to the other, relative to its height
SIGNIFICANCE = 3.0  # times the noise, beyond these
_OUTER = 2.5  # sigma from the centre on which the level below the line is seen
_ROUGH_FROM_PX = 1.5  # sigma from which on rows next to each other tell noise from shape
_CLOSE, _MOST_STEPS = 0.05, 4  # in sigma: how near the best Gaussian the shape is judged


def skewed_and_flat(
    image: NDArray, found: Profile, at: Peaks, noise: Noise
) -> tuple[NDArray[np.bool_], NDArray[np.bool_]]:
    """Tell which profiles lean to a side, and which are flatter than one line can be.

    Parameters
    ----------
    image : ndarray of shape (H, W)
    found : Profile
        What a detector says of L columns.
    at : Peaks
        The same columns.
    noise : Noise

    Returns
    -------
    two ndarrays of bool of shape (L,)
    """
    good = np.isfinite(found.row) & np.isfinite(found.sigma) & (found.amplitude > 0.0)
    refined = _refined(image, found, at, good, noise)
    rows, inside, values = window(image, refined)
    z = (rows - refined.row) / refined.sigma
    gaussian = pixel_gaussian(rows, refined.row, refined.sigma)
    hermite = [(z**3 - 3.0 * z) * gaussian[1], (z**4 - 6.0 * z**2 + 3.0) * gaussian[1]]
    basis = np.concatenate([gaussian, hermite])
    reach = np.maximum(refined.sigma, 1.0)
    taper = np.clip(REACH - np.abs(rows - refined.row) / reach, 0.0, 1.0) * inside
    weighted = taper * basis
    normal = np.einsum("inl,jnl->lij", weighted, basis, optimize=True) + 1e-12 * np.eye(6)
    covariance = np.linalg.inv(normal)
    coefficients = np.einsum("lij,jnl,nl->il", covariance, weighted, values, optimize=True)
    misfit = values - np.einsum("il,inl->nl", coefficients, basis)
    variance = np.maximum(_noise_variance(misfit, taper, refined.sigma), noise.dark**2)

    height = np.where(coefficients[1] > 0.0, coefficients[1], np.nan)
    skew, flat = coefficients[4] / height, -coefficients[5] / height
    skew_error, flat_error = (np.sqrt(variance * covariance[:, k, k]) / height for k in (4, 5))
    step, step_error = _step(refined, rows, inside & (taper > 0.0), values, variance)
    leans = np.abs(skew) > MAX_SKEW + SIGNIFICANCE * skew_error
    leans |= np.abs(step) > (MAX_STEP * height + SIGNIFICANCE * step_error)
    return good & leans, good & (flat > MAX_FLAT + SIGNIFICANCE * flat_error)


def _refined(
    image: NDArray, found: Profile, at: Peaks, good: NDArray[np.bool_], noise: Noise
) -> Peaks:
    """The peaks at the Gaussians that fit best: what else a centre may be would seem a shape."""
    row, sigma, amplitude = (
        np.where(good, new, old)
        for new, old in (
            (found.row, at.row),
            (found.sigma, at.sigma),
            (found.amplitude, at.amplitude),
        )
    )
    index = np.arange(len(row))
    for _ in range(_MOST_STEPS):
        here = at.take(index)._replace(
            row=row[index], sigma=sigma[index], amplitude=amplitude[index]
        )
        better, step = gauss_newton(image, here, noise.shot)
        index = index[step > _CLOSE]
        if not index.size:
            break
        row[index], sigma[index], amplitude[index] = (
            values[step > _CLOSE] for values in (better.row, better.sigma, better.amplitude)
        )
    return at._replace(row=row, sigma=sigma, amplitude=amplitude)


def _noise_variance(misfit: Array, taper: Array, sigma: Array) -> Array:
    """Of the noise alone: of rows next to each other, in which a wrong shape hardly shows.

    Narrow lines have too few rows for that; there all of the misfit counts.
    """
    pair = np.sqrt(taper[1:] * taper[:-1])
    rough = (pair * np.diff(misfit, axis=0) ** 2).sum(axis=0)
    rough /= np.maximum(2.0 * pair.sum(axis=0) - 6.0, 1.0)
    whole = (taper * misfit**2).sum(axis=0) / np.maximum(taper.sum(axis=0) - 6.0, 1.0)
    return np.where(sigma < _ROUGH_FROM_PX, np.maximum(rough, whole), rough)


def _step(
    at: Peaks, rows: NDArray[np.intp], seen: NDArray[np.bool_], values: Array, variance: Array
) -> tuple[Array, Array]:
    """By how much the level below the line differs from side to side, and the error of that."""
    far = _OUTER * np.maximum(at.sigma, 1.0)
    sides = [seen & (rows - at.row > far), seen & (at.row - rows > far)]
    counts = [side.sum(axis=0) for side in sides]
    with np.errstate(invalid="ignore"):
        levels = [
            np.where(side, values, 0.0).sum(axis=0) / np.where(count > 0, count, np.nan)
            for side, count in zip(sides, counts, strict=True)
        ]
        error = np.sqrt(variance * sum(1.0 / np.maximum(count, 1) for count in counts))
    return levels[0] - levels[1], error
