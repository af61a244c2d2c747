"""Rays in, rays out, as NumPy arrays: the march for people who want just that."""

from dataclasses import dataclass

import numpy as np
from numpy.typing import ArrayLike, NDArray

from virtual_sensor.engine import dr, mi
from virtual_sensor.errors import InputError
from virtual_sensor.medium.lookups import in_own_memory
from virtual_sensor.optics.eikonal import Field, March, Straight, after_length, bend
from virtual_sensor.optics.ray_status import RayStatus
from virtual_sensor.optics.surfaces import NoSurface


@dataclass(frozen=True)
class Rays:
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

    position: NDArray[np.float64]
    direction: NDArray[np.float64]
    optical_path_mm: NDArray[np.float64]
    status: NDArray[np.uint32]


def trace(
    field: Field,
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
    field : IndexField or ExactField
    origins_mm, directions : array_like of shape (N, 3)
        World; directions of any length but zero.
    length_mm : float or array_like of shape (N,)
        Arc length.  Outside the field's box rays go straight.
    step_mm, method, precision, tolerance_mm
        See `March`.

    Raises
    ------
    InputError
        If shapes do not match, a number is not finite, a direction is zero or a length negative.
    """
    origins, directions = (np.atleast_2d(np.asarray(x, float)) for x in (origins_mm, directions))
    if origins.shape != directions.shape or origins.shape[1:] != (3,) or not len(origins):
        raise InputError(
            f"trace: origins {origins.shape} and directions {directions.shape} must both be (N, 3)"
        )
    longest = np.abs(directions).max(axis=1)
    with np.errstate(invalid="ignore", divide="ignore"):
        scaled = directions / longest[:, None]  # a square of 1e300 is infinite
    norm = np.linalg.norm(scaled, axis=1)
    lengths = np.asarray(length_mm, float)
    if lengths.shape not in ((), norm.shape):
        raise InputError(f"trace: length_mm {lengths.shape} must be one number or ({len(norm)},)")
    if not (np.isfinite(origins).all() and np.isfinite(norm).all() and np.all(norm > 0.0)):
        raise InputError("trace: origins and directions must be finite, and directions not zero")
    if not (np.isfinite(lengths).all() and np.all(lengths >= 0.0)):
        raise InputError("trace: lengths must be finite and not negative")
    lengths = np.broadcast_to(lengths, norm.shape)
    march = March(step_mm, method, precision, tolerance_mm=tolerance_mm)
    o, d = to_vectors(origins), to_vectors(scaled / norm[:, None])
    line = Straight.through(o, d, march)
    ends = after_length(march.scalar(to_scalars(lengths)))
    ray = bend(field, NoSurface(), line, march, remaining=ends)
    dr.eval(ray)
    position = to_numpy(ray.position(line))
    status = np.array(ray.status)
    low, high = field.box
    outside = np.any((position < low) | (position > high), axis=1)
    backwards = np.einsum("ij,ij->i", to_numpy(ray.tangent(line)), directions) < 0.0
    ended = status == RayStatus.ENDED
    status[ended & outside] = RayStatus.LEFT
    status[ended & outside & backwards] = RayStatus.TURNED_BACK
    tangent = to_numpy(ray.tangent(line))
    relative = np.array(ray.t, float) - np.array(line.start, float) + np.array(ray.path, float)
    return Rays(
        position,
        tangent / np.linalg.norm(tangent, axis=1, keepdims=True),
        relative * (1.0 + field.ambient),
        status,
    )


def to_scalars(values: NDArray[np.float64]) -> mi.Float64:
    """Numbers (N,) in Dr.Jit's own memory: how NumPy's is aligned would be compiled in."""
    return in_own_memory(values, mi.Float64)


def to_vectors(points: NDArray[np.float64]) -> mi.Array3f64:
    """Points (N, 3) as Dr.Jit vectors."""
    held = np.array(points.T, float, order="C")
    vectors = mi.Array3f64(held)
    dr.eval(vectors)  # into columns: kernels that gather them compile anew for every number N
    dr.sync_thread()  # see `in_own_memory`
    return vectors


def to_numpy(vectors: object) -> NDArray[np.float64]:
    """Dr.Jit vectors of any precision as points (N, 3)."""
    return np.array(vectors, float).T
