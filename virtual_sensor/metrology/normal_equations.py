"""Linear least squares of parameters: covariance, bounds, and what can't be told apart.

The derivatives `by` (M, P) are of M residuals, over their noise, by P parameters.
"""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

Array = NDArray[np.float64]
INVISIBLE = 1e-9
"""Changes of all residuals, in noise per unit of a parameter, that are rounding's."""
_IN_GROUP = 0.3  # of the largest component of a singular vector: what takes part in it


def unit_columns(by: Array) -> tuple[Array, Array]:
    """Derivatives (M, P) with columns of unit length; and their lengths, 0 of rounding's alone."""
    size = np.linalg.norm(by, axis=0)
    size = np.where(size > INVISIBLE, size, 0.0)
    with np.errstate(divide="ignore", invalid="ignore"):
        return np.where(size > 0.0, by / size, 0.0), size


def singular(unit: Array) -> tuple[Array, Array]:
    """Singular values (P,), falling, and the right vectors as rows."""
    count = unit.shape[1]
    spare = np.zeros((max(count - len(unit), 0), count))
    _, values, vectors = np.linalg.svd(np.concatenate([unit, spare]), full_matrices=False)
    return values, vectors


def taking_part(vector: Array) -> list[int]:
    """Which parameters make up a singular vector."""
    share = np.abs(vector)
    found: list[int] = np.flatnonzero(share > _IN_GROUP * share.max()).tolist()
    return found


def condition_of(values: Array) -> float:
    """Largest over smallest of singular values that fall; 1 of none."""
    if not values.size:
        return 1.0
    return float(values[0] / values[-1]) if values[-1] > 0.0 else np.inf


def covariance_of(by: Array) -> Array:
    """Inverse of the normal matrix, (P, P)."""
    unit, size = unit_columns(by)
    if not size.size:
        return np.zeros((0, 0))
    values, vectors = singular(unit)
    with np.errstate(divide="ignore", invalid="ignore"):  # infinite where the data leave a choice
        root = vectors.T / values
        found: Array = (root @ root.T) / np.outer(size, size)
    return found


def bound_of(by: Array) -> Array:
    """Cramer and Rao's bound (P,); infinite where the data leave a choice."""
    unit, size = unit_columns(by)
    if not size.size:
        return size
    values, vectors = singular(unit)
    open_ = values <= 1e-9 * values[0]
    square = np.sum((vectors[~open_] / values[~open_, None]) ** 2, axis=0)
    choice = (np.abs(vectors[open_]) > 1e-6).any(axis=0) | (size == 0.0)
    found: Array = np.where(choice, np.inf, np.sqrt(square) / np.where(size > 0.0, size, 1.0))
    return found


def correlation_of(covariance: Array) -> Array:
    """Correlation (P, P) of a covariance."""
    sigma = np.sqrt(np.diag(covariance))
    return covariance / np.outer(sigma, sigma)
