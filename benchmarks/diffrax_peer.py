"""JAX and diffrax: Tsit5 with step control, or fixed steps, through a cubic spline in jax.numpy.

As in our march, what is integrated is the difference from the straight ray, so that float32 loses
nothing on long paths; rays are shared out over as many host devices as there are cores.
"""

from __future__ import annotations

import os
from collections.abc import Callable

CORES = len(os.sched_getaffinity(0)) if hasattr(os, "sched_getaffinity") else os.cpu_count() or 1
os.environ.setdefault("XLA_FLAGS", f"--xla_force_host_platform_device_count={CORES}")
os.environ.setdefault("JAX_PLATFORMS", "cpu")

import diffrax  # noqa: E402
import jax  # noqa: E402
import jax.numpy as jnp  # noqa: E402
import numpy as np  # noqa: E402
from numpy.typing import NDArray  # noqa: E402
from problem import Grid, Peer, Problem  # noqa: E402
from splines import linear_nodes, spline_coefficients  # noqa: E402

jax.config.update("jax_enable_x64", True)

Array = NDArray[np.float64]

RTOL = tuple(10.0 ** (-0.5 * k) for k in range(8, 19))  # 1e-4 to 1e-9
STEPS_MM = (8.0, 6.0, 5.0, 4.0, 3.5, 3.0, 2.5, 2.0, 1.5, 1.0)
_MOST_STEPS = 4096


def _weights(t):
    s = 1.0 - t
    value = jnp.stack([
        s**3 / 6.0, 2.0 / 3.0 - t * t * (1.0 - t / 2.0),
        2.0 / 3.0 - s * s * (1.0 - s / 2.0), t**3 / 6.0,
    ])  # fmt: skip
    slope = jnp.stack([-s * s / 2.0, t * (1.5 * t - 2.0), s * (2.0 - 1.5 * s), t * t / 2.0])
    return value, slope


def cubic_lookup(grid: Grid, dtype: type) -> Callable:
    """Value and gradient at one point of the spline through the nodes."""
    coefficients, origin = spline_coefficients(grid)
    c = jnp.asarray(coefficients, dtype)
    origin, inverse = jnp.asarray(origin, dtype), jnp.asarray(1.0 / grid.spacing, dtype)
    top = jnp.asarray(np.array(coefficients.shape) - 4)

    def lookup(p):
        g = (p - origin) * inverse
        cell = jnp.clip(jnp.floor(g).astype(jnp.int32), 0, top)
        t = g - cell
        block = jax.lax.dynamic_slice(c, (cell[0], cell[1], cell[2]), (4, 4, 4))
        (wx, dx), (wy, dy), (wz, dz) = (_weights(t[axis]) for axis in range(3))
        along, slope = block @ wz, block @ dz
        value, vy, vz = along @ wy, along @ dy, slope @ wy
        return wx @ value, jnp.stack([dx @ value, wx @ vy, wx @ vz]) * inverse

    return lookup


def linear_lookup(grid: Grid, dtype: type) -> Callable:
    """Value and gradient at one point, each interpolated linearly from the nodes."""
    nodes, origin = linear_nodes(grid)
    c = jnp.asarray(nodes, dtype)
    origin, inverse = jnp.asarray(origin, dtype), jnp.asarray(1.0 / grid.spacing, dtype)
    top = jnp.asarray(np.array(nodes.shape[:3]) - 2)

    def lookup(p):
        g = (p - origin) * inverse
        cell = jnp.clip(jnp.floor(g).astype(jnp.int32), 0, top)
        t = g - cell
        block = jax.lax.dynamic_slice(c, (cell[0], cell[1], cell[2], 0), (2, 2, 2, 4))
        for axis in range(3):
            block = block[0] * (1.0 - t[axis]) + block[1] * t[axis]
        return block[0], block[1:]

    return lookup


def solver(
    lookup_of: Callable = cubic_lookup, dtype: type = np.float64, fixed: bool = False
) -> Callable[[Problem, float], Callable[[], Array]]:
    """Peer's `prepare`; the setting is a relative tolerance or, if `fixed`, a step in mm."""

    def prepare(problem: Problem, setting: float) -> Callable[[], Array]:
        lookup = lookup_of(problem.grid, dtype)
        longest = float(problem.lengths.max())

        def slope(s, state, ray):
            start, d, length = ray
            offset, tau = state
            n, gradient = lookup(start + d * (s * length) + offset)
            return tau * length, gradient * (1.0 + n) * length

        if fixed:
            first, control = setting / longest, diffrax.ConstantStepSize()
        else:
            first, control = None, diffrax.PIDController(rtol=setting, atol=setting * 0.1)

        def one(start, d, length):
            state = jnp.zeros_like(start), d * lookup(start)[0]
            found = diffrax.diffeqsolve(
                diffrax.ODETerm(slope),
                diffrax.Tsit5(),
                dtype(0.0),
                dtype(1.0),
                None if first is None else dtype(first),
                state,
                args=(start, d, length),
                saveat=diffrax.SaveAt(t1=True),
                stepsize_controller=control,
                max_steps=_MOST_STEPS,
                throw=False,
            )
            return found.ys[0][0], found.ys[1][0]

        devices = jax.devices()
        count = len(problem)
        padded = -(-count // len(devices)) * len(devices)
        rays = [
            jnp.asarray(np.resize(x, (padded, *x.shape[1:])), dtype).reshape(
                len(devices), -1, *x.shape[1:]
            )
            for x in (problem.starts, problem.directions, problem.lengths)
        ]
        solve = jax.pmap(jax.vmap(one))

        def work() -> Array:
            offset, tau = (
                np.asarray(x, float).reshape(padded, 3)[:count]
                for x in jax.block_until_ready(solve(*rays))
            )
            d = problem.directions
            position = problem.starts + d * problem.lengths[:, None] + offset
            return problem.in_plane(position, d + tau)

        return work

    return prepare


def peers() -> list[Peer]:
    """Tsit5 under step control and with fixed steps, and what linear gradients come to."""
    found = []
    for name, dtype in (("float64", np.float64), ("float32", np.float32)):
        controlled, fixed = solver(dtype=dtype), solver(dtype=dtype, fixed=True)
        found += [
            Peer(f"diffrax Tsit5, PID control, {name}", "cubic spline", RTOL, "rtol", controlled,
                 4000, 501),
            Peer(f"diffrax Tsit5, fixed steps, {name}", "cubic spline", STEPS_MM, "mm", fixed,
                 4000, 501),
        ]  # fmt: skip
    linear = solver(linear_lookup, fixed=True)
    name = "diffrax Tsit5, linear gradients"
    found.append(Peer(name, "linear gradients", STEPS_MM[::3], "mm", linear, 1000, 501))
    return found
