"""Rays in, rays out, as NumPy arrays: the march for people who want just that."""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path
from typing import ClassVar

import numpy as np
from numpy.typing import ArrayLike, NDArray

from virtual_sensor.arrays import by_rows, numbers_of, points_of, to_numpy, to_scalars, to_vectors
from virtual_sensor.calls import public
from virtual_sensor.display import Displayed, listed, span
from virtual_sensor.engine import dr
from virtual_sensor.errors import InputError
from virtual_sensor.medium.index_field import field_of
from virtual_sensor.optics.eikonal import Field, March, Straight, after_length, bend
from virtual_sensor.optics.ray_status import RayStatus
from virtual_sensor.optics.surfaces import NoSurface

Array = NDArray[np.float64]


@dataclass(frozen=True)
class Rays(Displayed):
    """Where rays are after a march.

    Attributes
    ----------
    position : ndarray of shape (N, 3)
        World, mm.
    direction : ndarray of shape (N, 3)
        Unit vectors.
    optical_path_mm : ndarray of shape (N,)
        Integral of n ds since the start, with n the whole index, surroundings included.
    status : ndarray of shape (N,)
        `RayStatus`: ENDED in the field, LEFT, TURNED_BACK or OUT_OF_STEPS (the numbers are then
        those of the last step).
    """

    _field_units: ClassVar = {"position": "mm"}
    _statuses: ClassVar = {"status": RayStatus}
    _by_row: ClassVar = True

    position: Array
    direction: Array
    optical_path_mm: Array
    status: NDArray[np.uint32]

    def _line(self) -> str:
        counts = {s: int(np.sum(self.status == s)) for s in RayStatus}
        words = (f"{number} {s.name.lower()}" for s, number in counts.items() if number)
        return listed(f"{self.status.size} rays", *words, span("paths", self.optical_path_mm, "mm"))


@public
def trace(
    field: Field | str | Path,
    origins_mm: ArrayLike,
    directions: ArrayLike,
    length_mm: ArrayLike,
    step_mm: float = 1.0,
    method: str = "rk4",
    precision: str = "double",
    tolerance_mm: float = 1e-6,
) -> Rays:
    """March rays through a field for a given length of arc.

    Parameters
    ----------
    field : IndexField, ExactField, str or Path
        Or its file; or the name of one that comes with the program.
    origins_mm, directions : array_like of shape (N, 3)
        World; directions of any length but zero, or one for all, (3,).
    length_mm : float or array_like of shape (N,)
        Arc length.  Outside the field's box rays go straight.
    step_mm, method, precision, tolerance_mm
        See `March`.

    Raises
    ------
    InputError
        If shapes do not match, a number is not finite, a direction is zero or a length negative.
    """
    air: Field | None = field_of("trace: field", field)
    if air is None:
        raise InputError("trace: field is None, homogeneous air; rays are straight in it")
    origins = np.atleast_2d(points_of("trace: origins_mm", origins_mm))
    directions = np.atleast_2d(points_of("trace: directions", directions))
    if directions.shape == (1, 3) and origins.ndim == 2:
        directions = np.repeat(directions, len(origins), axis=0)
    if origins.shape != directions.shape or origins.shape[1:] != (3,):
        raise InputError(
            f"trace: origins_mm {origins.shape} and directions {directions.shape} must both be"
            " (N, 3)"
        )
    longest = np.abs(directions).max(axis=1)
    with np.errstate(invalid="ignore", divide="ignore"):
        scaled = directions / longest[:, None]  # a square of 1e300 is infinite
    norm = np.linalg.norm(scaled, axis=1)
    lengths = numbers_of("trace: length_mm", length_mm)
    if lengths.shape not in ((), norm.shape):
        raise InputError(f"trace: length_mm {lengths.shape} must be one number or ({len(norm)},)")
    if not (np.isfinite(origins).all() and np.isfinite(norm).all() and np.all(norm > 0.0)):
        raise InputError("trace: origins_mm and directions must be finite, and directions not zero")
    if not (np.isfinite(lengths).all() and np.all(lengths >= 0.0)):
        raise InputError("trace: length_mm must be finite and not negative")
    lengths = np.broadcast_to(lengths, norm.shape)
    march = March(step_mm, method, precision, tolerance_mm=tolerance_mm)
    unit = scaled / norm[:, None]
    return by_rows(lambda *rays: _marched(air, march, *rays), origins, unit, lengths)


def _marched(field: Field, march: March, origins: Array, directions: Array, lengths: Array) -> Rays:
    """March rays in unit directions."""
    line = Straight.through(to_vectors(origins), to_vectors(directions), march)
    ends = after_length(march.scalar(to_scalars(lengths)))
    ray = bend(field, NoSurface(), line, march, remaining=ends)
    dr.eval(ray)
    position, tangent = to_numpy(ray.position(line)), to_numpy(ray.tangent(line))
    status = np.array(ray.status)
    low, high = field.box
    local = field.to_local(position)
    outside = np.any((local < low) | (local > high), axis=1)
    backwards = np.einsum("ij,ij->i", tangent, directions) < 0.0
    ended = status == RayStatus.ENDED
    status[ended & outside] = RayStatus.LEFT
    status[ended & outside & backwards] = RayStatus.TURNED_BACK
    relative = np.array(ray.t, float) - np.array(line.start, float) + np.array(ray.path, float)
    return Rays(
        position,
        tangent / np.linalg.norm(tangent, axis=1, keepdims=True),
        relative * (1.0 + field.ambient),
        status,
    )
