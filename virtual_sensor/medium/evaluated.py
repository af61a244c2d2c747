"""Values of a field at points of the world."""

from __future__ import annotations

from typing import Any

import numpy as np
from numpy.typing import ArrayLike

from virtual_sensor.arrays import points_of, to_numpy, to_vectors
from virtual_sensor.calls import public
from virtual_sensor.errors import InputError
from virtual_sensor.poses import Movable


class Evaluated(Movable):
    """A field in a box, and a uniform one outside: `lookup` gives what is added to that inside."""

    ambient: float

    @property
    def box(self) -> np.ndarray:
        """Lowest and highest corner in the field's frame: (2, 3), mm."""
        raise NotImplementedError

    def lookup(self, precision: str) -> Any:
        """Its values in Dr.Jit, in the field's frame: `delta` and `delta_and_gradient`."""
        raise NotImplementedError

    @public
    def refractivity(self, points_mm: ArrayLike) -> np.ndarray:
        """Refractivity n - 1 at world positions.

        Parameters
        ----------
        points_mm : array_like of shape (N, 3)
            World positions, mm.

        Returns
        -------
        ndarray of shape (N,)
            n - 1; that of the surrounding air outside the box, NaN at NaN positions.
        """
        local, inside = self._locate(points_mm)
        result = np.where(np.isnan(local).any(axis=1), np.nan, self.ambient)
        if inside.any():
            delta = self.lookup("double").delta(to_vectors(local[inside]))
            result[inside] += delta.numpy()
        return result

    @public
    def gradient(self, points_mm: ArrayLike) -> np.ndarray:
        """Gradient of n at world positions.

        Parameters
        ----------
        points_mm : array_like of shape (N, 3)
            World positions, mm.

        Returns
        -------
        ndarray of shape (N, 3)
            Gradient, 1/mm; zero outside the box, NaN at NaN positions.
        """
        local, inside = self._locate(points_mm)
        result = np.where(np.isnan(local).any(axis=1, keepdims=True), np.nan, np.zeros((1, 3)))
        if inside.any():
            _, gradient = self.lookup("double").delta_and_gradient(to_vectors(local[inside]))
            result[inside] = to_numpy(gradient) @ self.axes().T
        return result

    def _locate(self, points_mm: ArrayLike) -> tuple[np.ndarray, np.ndarray]:
        """World points (N, 3) in the field's frame, and which of them are in the box."""
        points = np.atleast_2d(points_of("points_mm", points_mm))
        if points.ndim != 2 or points.shape[1] != 3:
            raise InputError(f"points_mm must have the shape (N, 3), not {points.shape}")
        low, high = self.box
        local = self.to_local(points)
        return local, ((local >= low) & (local <= high)).all(axis=1)
