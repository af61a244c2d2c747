"""Gaussian lines drawn at known rows, and the smallest error that a centre can have in noise."""

import numpy as np
from numpy.typing import NDArray
from scipy.special import ndtr

Array = NDArray[np.float64]


def line_shares(row: Array, width_px: float | Array, height: int) -> tuple[Array, Array]:
    """Share of a Gaussian line's light that each pixel of a column integrates.

    Parameters
    ----------
    row : ndarray of shape (W,)
        v of the line in each column, px.
    width_px : float or ndarray of shape (W,)
        Standard deviation of its profile.
    height : int
        Rows of the image.

    Returns
    -------
    shares, slopes : ndarray of shape (height, W)
        They sum up to 1 where the image holds the whole profile; and d shares/d row, 1/px.
    """
    edges = (np.arange(height + 1)[:, None] - 0.5 - row) / width_px
    density = np.exp(-0.5 * edges**2) / (np.sqrt(2.0 * np.pi) * width_px)
    return np.diff(ndtr(edges), axis=0), -np.diff(density, axis=0)


def cramer_rao_px(electrons: Array, slope: Array, read_noise_electrons: float) -> Array:
    """Cramer-Rao bound of each column's centre: no unbiased estimate of it has a smaller error.

    The variance is at least 1/sum((d mu/d row)^2/(mu + sigma_d^2 + 1/12)), for shot noise, read
    noise and grey values of one electron.

    Parameters
    ----------
    electrons : ndarray of shape (H, W)
        That each pixel is expected to collect, mu.
    slope : ndarray of shape (H, W)
        Its derivative by the line's row, electrons/px.
    read_noise_electrons : float
        sigma_d.

    Returns
    -------
    ndarray of shape (W,)
        Standard deviation in px; NaN in a column without a line.
    """
    information = (slope**2 / (electrons + read_noise_electrons**2 + 1.0 / 12.0)).sum(axis=0)
    return np.where(information > 0.0, information, np.nan) ** -0.5
