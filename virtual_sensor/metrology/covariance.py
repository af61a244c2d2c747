"""Covariance carried to first order, and what it says along a direction and of an interval."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

Array = NDArray[np.float64]

WITHIN_95 = 1.959964
"""Standard deviations of a normal distribution that hold 95 % of it on both sides."""


def carried(by: Array, covariance: Array) -> Array:
    """Covariance (..., K, K) of what has the derivatives `by` (..., K, P) by P numbers with one."""
    found: Array = by @ covariance @ np.swapaxes(by, -1, -2)
    return found


SIGMA_BY_MEDIAN = 1.4826
"""Standard deviation of a normal distribution over the median distance from its mean."""


def variance_along(direction: Array, covariance: Array) -> Array:
    """Variance (N,) along vectors (N, K) of covariances (N, K, K); that of rounding may be < 0."""
    found: Array = np.einsum("ni,nij,nj->n", direction, covariance, direction)
    return found
