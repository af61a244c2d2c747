"""Detectors in closed form: each centre is the ratio of two sums over the pixels near the peak.

With weights P and Q on the grey values f_i of a few rows (or on their logarithms) the centre is

    row = row_0 + sum(P_i f_i) / sum(Q_i f_i),

so that one formula passes the noise on: d row / d f_i = (P_i - (row - row_0) Q_i) / sum(Q_j f_j).
A detector's own bias is what it errs by on a pixel-integrated Gaussian of the line's width.

Sources: Fisher and Naidu 1996, "A comparison of algorithms for subpixel peak detection" (centre of
gravity, linear interpolation, parabola, Gaussian); Blais and Rioux 1986, "Real-time numerical peak
detector", Signal Processing 11, 145 (FIR filters of order 4 and 8).
"""

from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from virtual_sensor.metrology.line_profiles import (
    Array,
    Index,
    Noise,
    Peaks,
    Profile,
    pixel_means,
    pixels,
)

MAX_NOISE = 0.2  # of the denominator, relative: beyond it the noise is not passed on linearly
_GRAVITY_REACH = 3.0  # sigma either side that the centre of gravity counts
_SEARCH = 3  # rows either side of the peak in which the derivative is to vanish


class Ratio(NamedTuple):
    """The weights P and Q (n, L) of rows (n, L), counted from `origin` (L,); `reach`: how far."""

    origin: Index
    rows: Index
    P: Array
    Q: Array
    reach: float | Array = 1.0


def centre_of_gravity(image: NDArray, at: Peaks, noise: Noise, max_sigma: float) -> Profile:
    """Centre of gravity above the fitted level beside the line (Fisher and Naidu 1996)."""
    origin = np.rint(at.row).astype(int)
    reach = _GRAVITY_REACH * np.maximum(at.sigma, 1.0)
    half = int(np.ceil(reach.max(initial=1.0))) + 1
    offset = np.arange(-half, half + 1)[:, None]
    # Pixels count as far as they lie in a window about the peak: as much of either skirt.
    counts = np.clip(reach + 0.5 - np.abs(origin + offset - at.row), 0.0, 1.0)
    ratio = Ratio(origin, origin + offset, offset * counts, counts, reach)
    return _measured(image, at, noise, ratio, level=at.background)


def linear_interpolation(image: NDArray, at: Peaks, noise: Noise, max_sigma: float) -> Profile:
    """Two straight flanks of one slope, through the highest row (Fisher and Naidu 1996)."""
    top, rows = _highest(image, at)
    before, _, after = pixels(image, rows, at.column)
    rising = after > before
    P = np.repeat([[-0.5], [0.0], [0.5]], top.size, axis=1)
    Q = np.stack([-1.0 * rising, np.ones(top.size), -1.0 * ~rising])
    return _measured(
        image, at, noise, Ratio(top, rows, P, Q), curvature=_second_difference(top.size)
    )


def parabola(image: NDArray, at: Peaks, noise: Noise, max_sigma: float) -> Profile:
    """Vertex of the parabola through the highest row and its neighbours (Fisher and Naidu 1996)."""
    return _measured(image, at, noise, _vertex(image, at))


def log_parabola(image: NDArray, at: Peaks, noise: Noise, max_sigma: float) -> Profile:
    """Three-point Gaussian: a parabola through the logarithms (Fisher and Naidu 1996).

    Its bias is d (1 - 4 d^2)/(1440 s^6) px at sub-pixel offset d and width s^2 = sigma^2 + 1/12.
    """
    return _measured(image, at, noise, _vertex(image, at), level=at.level, logarithmic=True)


def fir4(image: NDArray, at: Peaks, noise: Noise, max_sigma: float) -> Profile:
    """Zero of the derivative by 1 1 0 -1 -1 (Blais and Rioux 1986, fourth order)."""
    return _measured(image, at, noise, _vanishing(image, at, 2))


def fir8(image: NDArray, at: Peaks, noise: Noise, max_sigma: float) -> Profile:
    """Zero of the derivative by 1 1 1 1 0 -1 -1 -1 -1 (Blais and Rioux 1986, eighth order)."""
    return _measured(image, at, noise, _vanishing(image, at, 4))


def _highest(image: NDArray, at: Peaks) -> tuple[Index, Index]:
    """The highest row near each peak, and the three rows about it."""
    near = np.clip(at.peak + np.arange(-2, 3)[:, None], 1, max(len(image) - 2, 1))
    near = np.minimum(near, len(image) - 1)
    top = near[pixels(image, near, at.column).argmax(axis=0), np.arange(at.peak.size)]
    return top, top + np.arange(-1, 2)[:, None]


def _vertex(image: NDArray, at: Peaks) -> Ratio:
    top, rows = _highest(image, at)
    P = np.repeat([[0.5], [0.0], [-0.5]], top.size, axis=1)
    return Ratio(top, rows, P, _second_difference(top.size))


def _second_difference(count: int) -> Array:
    """Its weights on three rows, for each of so many peaks: (3, L)."""
    return np.repeat([[1.0], [-2.0], [1.0]], count, axis=1)


def _vanishing(image: NDArray, at: Peaks, half: int) -> Ratio:
    """Between which two rows the filtered derivative vanishes, and where on the line between."""
    first = np.rint(at.row).astype(int) - _SEARCH
    rows = first + np.arange(-half, 2 * _SEARCH + half + 1)[:, None]
    values = pixels(image, rows, at.column).astype(float)
    total = np.concatenate([np.zeros((1, at.row.size)), np.cumsum(values, axis=0)])
    here = slice(half, half + 2 * _SEARCH + 1)
    before = total[here] - total[: 2 * _SEARCH + 1]
    after = total[2 * half + 1 :] - total[half + 1 : half + 2 * _SEARCH + 2]
    slope = before - after
    zero = (slope[:-1] < 0.0) & (slope[1:] >= 0.0)
    away = np.abs(first + np.arange(2 * _SEARCH)[:, None] + 0.5 - at.row)
    chosen = np.where(zero, away, np.inf).argmin(axis=0)
    origin = first + chosen

    weights = np.concatenate([np.ones(half), [0.0], -np.ones(half)])
    g, next_g = np.append(weights, 0.0)[:, None], np.append(0.0, weights)[:, None]
    found = np.where(zero.any(axis=0), 1.0, np.nan)
    offset = np.arange(-half, half + 2)[:, None]
    return Ratio(origin, origin + offset, g * found, (g - next_g) * found, reach=1.5)


def _measured(
    image: NDArray,
    at: Peaks,
    noise: Noise,
    ratio: Ratio,
    level: Array | float = 0.0,
    logarithmic: bool = False,
    curvature: Array | None = None,
) -> Profile:
    """The centres with their noise and bias, which are those of the Gaussian at `at`.

    The grey values are taken above `level`.
    The noise is passed on where it hardly changes the denominator, or the `curvature` by which the
    highest row and the lower flank are chosen.
    """
    values = pixels(image, ratio.rows, at.column) - level
    usable: NDArray[np.bool_] = np.ones(at.row.size, bool)
    if logarithmic:
        usable &= (values > 0.0).all(axis=0)
        values = np.log(np.where(usable, values, 1.0))
    offset, bottom = _divided(ratio, values)
    if logarithmic:
        usable &= bottom < 0.0  # a peak is convex
    if ratio.rows.min(initial=0) < 0 or ratio.rows.max(initial=0) >= len(image):
        counts = (ratio.P != 0.0) | (ratio.Q != 0.0)
        usable &= ~(counts & ((ratio.rows < 0) | (ratio.rows >= len(image)))).any(axis=0)
    usable &= np.abs(offset) <= ratio.reach
    row = np.where(usable, ratio.origin + offset, np.nan)

    # Of the Gaussian at `at`, not of the grey values: with their noise they would judge themselves.
    expected = at.amplitude * pixel_means(ratio.rows, np.where(usable, row, at.row), at.sigma)
    variance = noise.variance_near(at, expected)
    if logarithmic:
        expected = np.maximum(expected, 1e-3 * at.amplitude)
        variance = variance / expected**2
        expected = np.log(expected)
    elif level is not at.background:
        expected += at.background
    modelled, bottom = _divided(ratio, expected)
    by_pixel = (ratio.P - modelled * ratio.Q) / bottom
    bias = ratio.origin + modelled - row
    error = np.sqrt(_summed(by_pixel, by_pixel, variance) + bias**2)
    Q = ratio.Q if curvature is None else curvature
    linear = _summed(Q, Q, variance) < (MAX_NOISE * _summed(Q, expected)) ** 2
    return Profile(row, np.where(linear, error, np.nan), at.sigma, at.amplitude, at.background)


def _divided(ratio: Ratio, values: Array) -> tuple[Array, Array]:
    """The ratio, NaN where it has no denominator, and the denominator; (L,) each."""
    bottom = _summed(ratio.Q, values)
    bottom = np.where(bottom != 0.0, bottom, np.nan)
    return _summed(ratio.P, values) / bottom, bottom


def _summed(*factors: Array) -> Array:
    """Sum over the rows of the product of arrays (n, L)."""
    return np.einsum(",".join(["nl"] * len(factors)) + "->l", *factors)
