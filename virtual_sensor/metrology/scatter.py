"""Errors that neighbours along a line show: of a grainy line each profile knows too little.

To a fit a bright grain of speckle is a narrow line of little noise; that its centre is off by a
part of the line's width, only the columns beside it tell: there the widths scatter by more than
the predicted errors.  The rows may scatter too, and be right: the part may be rough.
"""

import numpy as np
from numpy.typing import NDArray
from scipy.ndimage import median_filter

from virtual_sensor.metrology.line_profiles import QUARTILE, Array, running_scatter

NEIGHBOURS = 31
GRAINY = 0.1  # relative scatter of neighbours' widths: far more than noise makes of a good line
# How much more widths scatter than centres are predicted to err, by more than noise makes them:
# where it is known at most 1.5 times; where a fit's own residuals predict, the median is low.
_MORE_THAN_KNOWN, _MORE_THAN_RESIDUALS = 1.8, 2.6
_OF_WIDTHS = 0.8  # centres err by about so much of what widths scatter,
_OF_USUAL = 0.8  # and none by much less than its neighbours, of noise that is known
# A ridge's width is smoothed along the line: it scatters by half of what the centre errs.
_MORE_OF_RIDGE, _OF_RIDGE_WIDTHS = 2.0, 2.0
_RIDGE_NEIGHBOURS = 101  # points next to each other share their noise
_FEWEST = 8  # columns that can tell
_MAY = 0.6  # of a scatter: so much less may a few blocks of columns show of it
_ROUGH = 0.25  # relative scatter of the widths of a line that is nothing but grains


def is_rough(width: Array) -> bool:
    """Whether a line (W,) is nothing but grains: profiles that neighbours share are of grains too.

    Parameters
    ----------
    width : ndarray of shape (W,)
        Of the Gaussian that fits each column best; NaN where there is none.
    """
    known = width[np.isfinite(width)]
    if known.size < _FEWEST or not _may_scatter(known, _ROUGH):
        return False
    middle, away = running_scatter(known, NEIGHBOURS)
    return bool(np.median(away / middle) > _ROUGH)


def with_scatter(sigma: Array, width: Array, found: NDArray[np.bool_], known: bool) -> Array:
    """Predicted errors (..., W), no less than the scatter of neighbours' widths shows.

    They stay as they are where the widths scatter no more than noise makes them.

    Parameters
    ----------
    sigma, width : ndarray of shape (..., W)
        Predicted errors, and widths of the line, px.
    found : ndarray of bool of shape (..., W)
        Where there is a centre.
    known : bool
        Whether the errors come from the image's noise; else a fit's own residuals predict them.
    """
    if sigma.ndim > 1:
        each = zip(sigma, width, found, strict=True)
        return np.stack([with_scatter(*line, known) for line in each])
    there = np.flatnonzero(found & np.isfinite(sigma) & np.isfinite(width))
    if there.size < _FEWEST or not _may_scatter(width[there], GRAINY):
        return sigma
    middle, away = running_scatter(width[there], NEIGHBOURS)
    grainy = away > GRAINY * middle
    if not grainy.any():
        return sigma
    usual = median_filter(sigma[there], NEIGHBOURS, mode="nearest")
    more = _MORE_THAN_KNOWN if known else _MORE_THAN_RESIDUALS
    least = np.where(away > more * usual, _OF_WIDTHS * away, _OF_USUAL * usual * known)
    honest = sigma.copy()
    honest[there] = np.maximum(sigma[there], np.where(grainy, least, 0.0))
    return honest


def with_scatter_of_ridge(sigma: Array, width: Array, known: bool) -> Array:
    """Likewise of points (N,) that follow each other along lines, by Steger's detector.

    Whose errors the noise alone predicts: shot noise too shows in the widths, where it isn't known.
    """
    if sigma.size < _FEWEST:
        return sigma
    _, away = running_scatter(width, _RIDGE_NEIGHBOURS)
    usual = median_filter(sigma, _RIDGE_NEIGHBOURS, mode="nearest")
    more = _MORE_OF_RIDGE if known else 1.0
    least = np.where(away > more * usual, _OF_RIDGE_WIDTHS * away, 0.0)
    return np.maximum(sigma, least)


def _may_scatter(width: Array, share: float) -> bool:
    """Whether widths may scatter by that share: of most lines they don't, which is soon seen."""
    blocks = np.resize(width, (-(-width.size // NEIGHBOURS), NEIGHBOURS))
    middle = np.median(blocks, axis=1)
    away = np.median(np.abs(blocks - middle[:, None]), axis=1) / QUARTILE
    return bool(np.any(away > _MAY * share * middle))
