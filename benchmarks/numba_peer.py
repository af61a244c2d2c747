"""Numba: hand-written kernels, a ray at a time, over all cores.

Coefficients are padded and unfolded at mirror planes beforehand, so that the inner loops have no
branch; a lookup contracts 64 coefficients one axis at a time, four neighbours along z at once.
"""

from __future__ import annotations

from collections.abc import Callable

import numba
import numpy as np
from numba import njit, prange, uint64
from numpy.typing import NDArray
from problem import Peer, Problem
from splines import linear_nodes, spline_coefficients

Array = NDArray[np.float64]
STEPS_MM = (8.0, 6.0, 5.0, 4.0, 3.5, 3.0, 2.75, 2.5, 2.25, 2.0, 1.75, 1.5, 1.25, 1.0, 0.75, 0.5)

_inline = njit(fastmath=True, error_model="numpy")


@_inline
def _weights(t):
    """Of the four coefficients for the value, then for the slope."""
    s = 1.0 - t
    return (s * s * s / 6.0, 2.0 / 3.0 - t * t * (1.0 - 0.5 * t),
            2.0 / 3.0 - s * s * (1.0 - 0.5 * s), t * t * t / 6.0,
            -0.5 * s * s, t * (1.5 * t - 2.0), s * (2.0 - 1.5 * s), 0.5 * t * t)  # fmt: skip


@_inline
def _cubic(c, shape, origin, inverse, x, y, z):
    """Value and gradient of the spline.

    One flat array with unsigned indices avoids the check for negative ones, and contracting y first
    leaves four neighbours along z to the vector unit: 1.5 times as fast as the plain sum.
    """
    gx, gy, gz = (
        (x - origin[0]) * inverse[0],
        (y - origin[1]) * inverse[1],
        (z - origin[2]) * inverse[2],
    )
    i = uint64(min(max(gx, 0.0), shape[0] - 4.0))
    j = uint64(min(max(gy, 0.0), shape[1] - 4.0))
    k = uint64(min(max(gz, 0.0), shape[2] - 4.0))
    wx, wy, wz = _weights(gx - i), _weights(gy - j), _weights(gz - k)
    row = uint64(shape[2])
    slab = uint64(shape[1]) * row
    first = i * slab + j * row + k
    f = fx = fy = fz = 0.0
    for a in range(4):
        v = vy = vz = 0.0
        p0 = first + uint64(a) * slab
        p1, p2, p3 = p0 + row, p0 + row + row, p0 + row + row + row
        for e in range(4):
            at = uint64(e)
            c0, c1, c2, c3 = c[p0 + at], c[p1 + at], c[p2 + at], c[p3 + at]
            line = wy[0] * c0 + wy[1] * c1 + wy[2] * c2 + wy[3] * c3
            slope = wy[4] * c0 + wy[5] * c1 + wy[6] * c2 + wy[7] * c3
            v += wz[e] * line
            vy += wz[e] * slope
            vz += wz[e + 4] * line
        f += wx[a] * v
        fx += wx[a + 4] * v
        fy += wx[a] * vy
        fz += wx[a] * vz
    return f, fx * inverse[0], fy * inverse[1], fz * inverse[2]


@_inline
def _linear(c, shape, origin, inverse, x, y, z):
    """Value and gradient, each interpolated linearly."""
    gx, gy, gz = (
        (x - origin[0]) * inverse[0],
        (y - origin[1]) * inverse[1],
        (z - origin[2]) * inverse[2],
    )
    i = min(max(int(gx), 0), shape[0] - 2)
    j = min(max(int(gy), 0), shape[1] - 2)
    k = min(max(int(gz), 0), shape[2] - 2)
    tx, ty, tz = gx - i, gy - j, gz - k
    f = fx = fy = fz = 0.0
    for a in range(2):
        wa = tx if a else 1.0 - tx
        for b in range(2):
            wb = wa * (ty if b else 1.0 - ty)
            for e in range(2):
                w = wb * (tz if e else 1.0 - tz)
                at = uint64(4 * (((i + a) * shape[1] + j + b) * shape[2] + k + e))
                f += w * c[at]
                fx += w * c[at + uint64(1)]
                fy += w * c[at + uint64(2)]
                fz += w * c[at + uint64(3)]
    return f, fx, fy, fz


def _kernels(lookup):
    """Leapfrog and RK4 with one lookup."""

    @_inline
    def pull(c, m, o, q, x, y, z):
        f, fx, fy, fz = lookup(c, m, o, q, x, y, z)
        return fx * (1.0 + f), fy * (1.0 + f), fz * (1.0 + f)

    @_inline
    def leapfrog(c, m, o, q, x, y, z, u, v, w, h, count):
        x, y, z = x + 0.5 * h * u, y + 0.5 * h * v, z + 0.5 * h * w
        for number in range(count):
            ax, ay, az = pull(c, m, o, q, x, y, z)
            u, v, w = u + h * ax, v + h * ay, w + h * az
            drift = h if number < count - 1 else 0.5 * h
            x, y, z = x + drift * u, y + drift * v, z + drift * w
        return x, y, z, u, v, w

    @_inline
    def rk4(c, m, o, q, x, y, z, u, v, w, h, count):
        g, s = 0.5 * h, h * h / 6.0
        for _ in range(count):
            ax, ay, az = pull(c, m, o, q, x, y, z)
            bx, by, bz = pull(c, m, o, q, x + g * u, y + g * v, z + g * w)
            x2, y2, z2 = x + g * (u + g * ax), y + g * (v + g * ay), z + g * (w + g * az)
            cx, cy, cz = pull(c, m, o, q, x2, y2, z2)
            x3, y3, z3 = x + h * (u + g * bx), y + h * (v + g * by), z + h * (w + g * bz)
            dx, dy, dz = pull(c, m, o, q, x3, y3, z3)
            x += h * u + s * (ax + bx + cx)
            y += h * v + s * (ay + by + cy)
            z += h * w + s * (az + bz + cz)
            u += h / 6.0 * (ax + 2.0 * bx + 2.0 * cx + dx)
            v += h / 6.0 * (ay + 2.0 * by + 2.0 * cy + dy)
            w += h / 6.0 * (az + 2.0 * bz + 2.0 * cz + dz)
        return x, y, z, u, v, w

    return {"leapfrog": _parallel(lookup, leapfrog), "RK4": _parallel(lookup, rk4)}


def _parallel(lookup, march):
    """All rays, shared out over the threads."""

    @_inline
    def one(c, m, o, q, start, d, length, step):
        x, y, z = start[0], start[1], start[2]
        n = 1.0 + lookup(c, m, o, q, x, y, z)[0]
        count = int(np.ceil(length / step))
        return march(c, m, o, q, x, y, z, n * d[0], n * d[1], n * d[2], length / count, count)

    @njit(parallel=True, fastmath=True, error_model="numpy")
    def kernel(c, m, o, q, starts, directions, lengths, step, position, tangent):
        for ray in prange(len(lengths)):
            x, y, z, u, v, w = one(c, m, o, q, starts[ray], directions[ray], lengths[ray], step)
            position[ray, 0], position[ray, 1], position[ray, 2] = x, y, z
            tangent[ray, 0], tangent[ray, 1], tangent[ray, 2] = u, v, w

    return kernel


_CUBIC, _LINEAR = _kernels(_cubic), _kernels(_linear)


def solver(
    method: str, cubic: bool = True, dtype: type = np.float64
) -> Callable[[Problem, float], Callable[[], Array]]:
    """Peer's `prepare`; `dtype` is that of the grid, the rays are float64."""
    kernel = (_CUBIC if cubic else _LINEAR)[method]

    def prepare(problem: Problem, step_mm: float) -> Callable[[], Array]:
        grid = problem.grid
        c, origin = (spline_coefficients if cubic else linear_nodes)(grid)
        shape = np.array(c.shape[:3])
        flat = np.ascontiguousarray(c, dtype).ravel()
        rays = [np.ascontiguousarray(x) for x in (problem.starts, problem.directions)]
        position, tangent = np.empty_like(rays[0]), np.empty_like(rays[0])

        def work() -> Array:
            inverse = 1.0 / grid.spacing
            kernel(flat, shape, origin, inverse, *rays, problem.lengths, step_mm, position, tangent)
            return problem.in_plane(position, tangent)

        return work

    return prepare


def peers(threads: int) -> list[Peer]:
    """The kernels on all cores, with the grid in both precisions, and on linear gradients."""
    numba.set_num_threads(threads)
    found = []
    for method in ("leapfrog", "RK4"):
        for name, dtype in (("float64", np.float64), ("float32", np.float32)):
            prepare, name = solver(method, dtype=dtype), f"numba {method}, {name} grid"
            found.append(Peer(name, "cubic spline", STEPS_MM, "mm", prepare, 100_000, 2001))
    fine = (8.0, 4.0, 2.0, 1.0, 0.5, 0.25, 0.125)
    linear = solver("RK4", cubic=False)
    name = "numba RK4, linear gradients"
    found.append(Peer(name, "linear gradients", fine, "mm", linear, 20_000, 2001))
    return found
