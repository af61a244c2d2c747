"""Epipolar geometry of a camera and a projector: the part of an error that no shape can explain.

Where light runs straight, the camera sees all points of one ray of the projector on one line, its
epipolar line, whatever the shape that the ray meets.  How far a pixel lies from the line of the
projector's pixel that it sees is what the air has done, across the line; along it air and shape
look alike.
"""

from __future__ import annotations

from typing import Any

import numpy as np
from numpy.typing import ArrayLike, NDArray

from virtual_sensor.arrays import in_own_memory, number_for, points_of, shares, sqrt
from virtual_sensor.calls import public
from virtual_sensor.errors import InputError, short
from virtual_sensor.optics.distortion import undistorted
from virtual_sensor.optics.ray_families import Pinhole, PixelFamily, RayFamily

Array = NDArray[np.float64]

_MANY, _NODES = 20_000, 33  # pixels that are worth a kernel; and where a lens is tried, each way


@public
def epipolar_residual(
    camera: Pinhole, projector: PixelFamily, pixel: ArrayLike, projector_pixel: ArrayLike
) -> Array:
    """How far camera pixels lie from the straight epipolar lines of their projector pixels, px.

    Parameters
    ----------
    camera : Pinhole
    projector : PixelFamily
        `scene.projector.family`, or that of a calibration.
    pixel : array_like of shape (..., 2)
        (u, v) of the camera, integers at pixel centres.
    projector_pixel : array_like of shape (..., 2)
        (u, v) of the projector that these pixels see.

    Returns
    -------
    ndarray of shape (...)
        In px of the camera's image without its distortion.  Positive on the right of the line as
        it runs from the projector's near end to the far one, u to the right and v down.  NaN where
        either pixel is, or where the ray goes through the camera's centre and has no line.

    Raises
    ------
    InputError
        If these are no pixels, or not equally many.
    """
    for name, family in (("camera", camera), ("projector", projector)):
        if not isinstance(family, PixelFamily):
            raise InputError(
                f"epipolar_residual: {name} is {short(family)}; give rays that have pixels, such as"
                " scene.camera and the family of its projector"
            )
    seen = points_of("epipolar_residual: pixel", pixel, 2)
    lit = points_of("epipolar_residual: projector_pixel", projector_pixel, 2)
    if seen.shape != lit.shape or seen.shape[-1:] != (2,):
        raise InputError(
            f"epipolar_residual: pixel has the shape {seen.shape} and projector_pixel"
            f" {lit.shape}; give both (N, 2)"
        )
    sight = coordinates_of(camera, seen.reshape(-1, 2))
    light = coordinates_of(projector, lit.reshape(-1, 2))
    return across_lines(camera, projector, sight, light).reshape(seen.shape[:-1])


def coordinates_of(family: PixelFamily, pixel: Array) -> Array:
    """Coordinates (N, 2) of the rays of pixels (N, 2): `of_pixels` of millions, quickly."""
    rays = np.empty(pixel.shape)
    if family.distorts and len(pixel) >= _MANY and _unfolded(family):
        return _by_formula(family, pixel)
    a, b, c, d, e, f = np.linalg.inv(family.matrix)[:2].ravel()
    for some in shares(len(pixel)):
        if family.distorts:
            rays[some] = np.stack(family.of_pixels(pixel[some]), axis=1)
        else:  # without a matrix product, which waits for threads
            u, v = pixel[some].T
            rays[some, 0], rays[some, 1] = a * u + b * v + c, d * u + e * v + f
    return rays


def _unfolded(family: PixelFamily) -> bool:
    """Whether a lens that OpenCV's formula describes shows one thing at each place of its image."""
    ends = np.array(family.size) - 0.5
    nodes = np.stack(np.meshgrid(*(np.linspace(-0.5, end, _NODES) for end in ends)), axis=-1)
    return not family.fisheye and bool(np.isfinite(family.of_pixels(nodes)).all())


def _by_formula(family: PixelFamily, pixel: Array) -> Array:
    """The same in Dr.Jit; one by one beside the image, where it may fold."""
    from virtual_sensor.engine import mi

    a, b, c, d, e, f = np.linalg.inv(family.matrix)[:2].ravel()
    u, v = (in_own_memory(column, mi.Float64) for column in pixel.T)
    rays = np.empty(pixel.shape)
    a, b, c, d, e, f = (number_for(u, float(k)) for k in (a, b, c, d, e, f))
    s, t = undistorted(a * u + b * v + c, d * u + e * v + f, family.distortion)
    rays[:, 0], rays[:, 1] = np.array(s), np.array(t)
    beside = np.flatnonzero(~family.inside(pixel) & np.isfinite(pixel).all(axis=1))
    rays[beside] = np.stack(family.of_pixels(pixel[beside]), axis=1)
    return rays


def across_lines(
    camera: Pinhole, projector: PixelFamily, sight: Array, light: Array
) -> NDArray[np.float64]:
    """`epipolar_residual` of lines of sight (N, 2) and the projector's rays (N, 2)."""
    residual = np.empty(len(sight))
    with np.errstate(all="ignore"):
        for some in shares(len(sight)):
            residual[some] = across_line(camera, projector, *sight[some].T, *light[some].T)
    return np.where(np.isfinite(residual), residual, np.nan)


def across_line(camera: Pinhole, projector: RayFamily, p: Any, q: Any, s: Any, t: Any) -> Any:
    """`epipolar_residual` of lines of sight (p, q) and rays (s, t).

    Of NumPy's arrays as of Dr.Jit's in double precision.  With o a point of the projector's ray and
    d its direction, in the camera's frame, the line is that of the (p, q, 1) square to o x d.
    """
    turn = camera.pose.rotation.T @ projector.pose.rotation
    shift = camera.pose.to_local(projector.pose.origin_mm)
    rows = [[number_for(p, float(v)) for v in (*m, b)] for m, b in zip(turn, shift, strict=True)]
    (x, y), (along_x, along_y) = projector.foot(s, t), projector.slope(s, t)
    o = [m[0] * x + m[1] * y + m[3] for m in rows]
    d = [m[0] * along_x + m[1] * along_y + m[2] for m in rows]
    a = o[1] * d[2] - o[2] * d[1]
    b = o[2] * d[0] - o[0] * d[2]
    c = o[0] * d[1] - o[1] * d[0]
    by_u, by_v = (number_for(p, 1.0 / float(f)) for f in np.diag(camera.matrix)[:2])
    return (a * p + b * q + c) / sqrt(a * by_u * (a * by_u) + b * by_v * (b * by_v))
