"""A range image as triangles, none of which bridges an edge."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import NDArray

from virtual_sensor.arrays import number_within
from virtual_sensor.display import Displayed

Array = NDArray[np.float64]

STEEPEST_DEG = 80.0
"""To the camera's axis, triangles' normals lean by no more, unless another limit is given."""


@dataclass(frozen=True)
class RangeMesh(Displayed):
    """Triangles between the points of neighbouring pixels.

    Attributes
    ----------
    vertices : ndarray of shape (N, 3)
        World, mm.
    faces : ndarray of int of shape (M, 3)
        Rows of the vertices, counter-clockwise as the camera sees them.
    index : ndarray of int of shape (N,)
        Row-major number of each vertex' pixel.
    """

    vertices: Array
    faces: NDArray[np.int32]
    index: NDArray[np.int64]

    def _line(self) -> str:
        return f"{len(self.vertices)} vertices, {len(self.faces)} triangles"


def mesh_of(image: Any, steepest_deg: float = STEEPEST_DEG) -> RangeMesh:
    """The triangles of a range image.

    Two in each square of four pixels that have points, one where three have.  Those are left out
    that span a jump: more depth than a surface would that leans by `steepest_deg`.

    Parameters
    ----------
    image : RangeImage
    steepest_deg : float
        From the camera's axis to the normal of the steepest triangle that is kept.
    """
    number_within("mesh: steepest_deg", steepest_deg, 1.0, 89.9, "degrees from 1 to 89.9")
    height, width = image.depth_mm.shape
    depth, ok = image.depth_mm, np.isfinite(image.depth_mm)
    numbers = np.arange(height * width, dtype=np.int32).reshape(height, width)
    corners = [
        numbers[rows, columns].ravel()
        for rows in (slice(None, -1), slice(1, None))
        for columns in (slice(None, -1), slice(1, None))
    ]
    flat, there = depth.ravel(), ok.ravel()
    enough = sum(there[each].astype(np.int8) for each in corners) >= 3
    a, b, c, d = (each[enough] for each in corners)
    most = np.tan(np.radians(steepest_deg)) * _pitch(image)
    # The square a b over c d is cut along the diagonal over which the depth changes less; where
    # a corner lacks, along the one that leaves the other three.
    with np.errstate(invalid="ignore"):
        across = np.abs(flat[a] - flat[d]) <= np.abs(flat[b] - flat[c])
    across = np.where(there[a] & there[d], across | ~(there[b] & there[c]), False)
    triangles = np.concatenate(
        [
            np.stack([a, c, d], axis=1)[across],
            np.stack([a, d, b], axis=1)[across],
            np.stack([a, c, b], axis=1)[~across],
            np.stack([b, c, d], axis=1)[~across],
        ]
    )
    triangles = triangles[there[triangles].all(axis=1)]
    at = flat[triangles]
    triangles = triangles[np.ptp(at, axis=1) <= most * at.mean(axis=1)]
    used = np.zeros(height * width, bool)
    used[triangles] = True
    index = np.flatnonzero(used)
    faces = (np.cumsum(used, dtype=np.int32) - 1)[triangles]
    return RangeMesh(image.point_mm.reshape(-1, 3)[index], faces, index)


def _pitch(image: Any) -> float:
    """Angle between pixels next to each other, rad: points' distance across the axis by depth."""
    pitches = []
    for axis in (0, 1):
        apart = np.diff(image.point_mm, axis=axis)
        deeper = np.diff(image.depth_mm, axis=axis)
        depth = np.delete(image.depth_mm, 0, axis=axis)
        across = np.sqrt(np.maximum(np.sum(apart**2, axis=2) - deeper**2, 0.0))
        pitches.append((across / depth)[np.isfinite(deeper)])
    together = np.concatenate(pitches)
    return float(np.median(together)) if together.size else 0.0
