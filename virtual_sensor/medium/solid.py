"""Values inside the solid, where there is no air: made up smoothly from the air around."""

import numpy as np
from scipy import ndimage

from virtual_sensor.errors import InputError

SMOOTHING_SWEEPS = 40  # inside the solid; the air near it sees two nodes


def fill_solid(nodes: np.ndarray, solid: np.ndarray, spacing: np.ndarray) -> np.ndarray:
    """Fill the nodes inside the solid smoothly from the air, which stays as it is.

    Each takes the value of the nearest air node, then a few sweeps of Jacobi's iteration for
    Laplace's equation smooth the seams, so that no spline next to the wall sees the steel.

    Parameters
    ----------
    nodes : ndarray of shape (nx, ny, nz)
        Values; those inside the solid may be anything.
    solid : ndarray of bool of shape (nx, ny, nz)
        True inside the solid.
    spacing : ndarray of shape (3,)
        Distance of nodes, mm.

    Returns
    -------
    ndarray of shape (nx, ny, nz)

    Raises
    ------
    InputError
        If the shapes differ or there is no air.
    """
    if solid.shape != nodes.shape or solid.all():
        raise InputError(
            f"solid must have the field's shape {nodes.shape} and leave some air; "
            f"its shape is {solid.shape}, {solid.sum() / max(solid.size, 1):.0%} of it solid"
        )
    if not solid.any():
        return nodes
    # Only the box round the solid takes part, one node wider: the nearest air is in it.
    around = tuple(
        slice(max(s.start - 1, 0), s.stop + 1) for s in ndimage.find_objects(solid.astype(int))[0]
    )
    filled = nodes.copy()
    part, inside = filled[around], solid[around]
    nearest = ndimage.distance_transform_edt(
        inside, sampling=spacing, return_distances=False, return_indices=True
    )
    part[:] = part[tuple(nearest)]
    weights = 0.5 / spacing**2 / (1.0 / spacing**2).sum()
    for _ in range(SMOOTHING_SWEEPS):
        mean = sum(
            ndimage.correlate1d(part, [w, 0.0, w], axis=axis, mode="mirror")
            for axis, w in enumerate(weights)
        )
        part[inside] = mean[inside]
    return filled
