"""The task that all peers get: a grid, rays, where they must end, and a stated error."""

from __future__ import annotations

import time
from collections.abc import Callable, Iterator
from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import ArrayLike, NDArray

Array = NDArray[np.float64]

MM_PER_PX = 0.022
"""A pixel of hot_cylinder's camera on the part."""


@dataclass(frozen=True)
class Grid:
    """Refractivity at the nodes of a regular grid, relative to the air around it, in mm.

    Attributes
    ----------
    nodes : ndarray of shape (nx, ny, nz)
        n / n_ambient - 1.
    origin, spacing : ndarray of shape (3,)
    mirror : tuple of three bool
        Whether the field is even about the plane through an axis's first node.
    """

    nodes: Array
    origin: Array
    spacing: Array
    mirror: tuple[bool, ...]

    def unfolded(self) -> tuple[Array, Array]:
        """The nodes with their mirror images, and the first one's place."""
        values, origin = self.nodes, self.origin.copy()
        for axis, even in enumerate(self.mirror):
            if even:
                image = np.flip(values.take(range(1, values.shape[axis]), axis), axis)
                origin[axis] -= self.spacing[axis] * image.shape[axis]
                values = np.concatenate([image, values], axis)
        return values, origin


@dataclass(frozen=True)
class Problem:
    """Rays that start on the border of the grid.

    dr/dt = T and dT/dt = n grad n from t = 0, with T = n d at the start; after `lengths`, a ray has
    reached its plane but for a millionth, and goes the rest straight.

    Attributes
    ----------
    grid : Grid
    starts, directions : ndarray of shape (N, 3)
    lengths : ndarray of shape (N,)
        mm.
    targets : ndarray of shape (N, 3)
        Where straight rays end; each ray's plane goes through its own.
    normal : ndarray of shape (3,)
        Of all planes.
    truth : ndarray of shape (N, 3)
        Where bent rays end, by the float64 reference; NaN for rays that are only timed.
    """

    grid: Grid
    starts: Array
    directions: Array
    lengths: Array
    targets: Array
    normal: Array
    truth: Array

    def __len__(self) -> int:
        return len(self.lengths)

    def some(self, count: int) -> Problem:
        """Some `count` of the rays, evenly taken."""
        return self.part(np.linspace(0, len(self) - 1, min(count, len(self))).astype(int))

    def part(self, at: ArrayLike) -> Problem:
        """The rays of these numbers."""
        return Problem(
            self.grid,
            self.starts[at],
            self.directions[at],
            self.lengths[at],
            self.targets[at],
            self.normal,
            self.truth[at],
        )

    def in_plane(self, position: Array, tangent: Array) -> Array:
        """Positions (N, 3) moved straight into the rays' planes."""
        rest = (self.targets - position) @ self.normal / (tangent @ self.normal)
        return position + tangent * rest[:, None]

    def error_px(self, position: Array) -> Array:
        """Distances (N,) from the reference square to the rays, in the camera's pixels."""
        apart = position - self.truth
        along = np.einsum("ij,ij->i", apart, self.directions)[:, None]
        return np.linalg.norm(apart - self.directions * along, axis=1) / MM_PER_PX


@dataclass(frozen=True)
class Peer:
    """A method that solves the problem.

    Attributes
    ----------
    name : str
    field : str
        How it interpolates.
    settings : tuple
        From the loosest to the tightest: steps in mm or relative tolerances.
    unit : str
        Of the settings.
    prepare : callable
        ``prepare(problem, setting)`` returns a function of nothing that returns where the rays end,
        (N, 3), and can be called again.
    rays : int
        So many are timed: enough for its best throughput, or as many as there is patience for.
    judged : int
        So many are judged, out of those whose end is known.
    """

    name: str
    field: str
    settings: tuple[float, ...]
    unit: str
    prepare: Callable[[Problem, float], Callable[[], Array]]
    rays: int
    judged: int


@dataclass(frozen=True)
class Row:
    """One setting of one peer, as measured.

    Attributes
    ----------
    rms_px, largest_px : float
    rays_per_s : float
        NaN where it was only judged.
    cpu_us : float
        Processor time for a ray, all cores together: what other processes hardly change.
    chosen : bool
        The loosest setting that keeps the stated error.
    """

    peer: str
    field: str
    setting: float
    unit: str
    rms_px: float
    largest_px: float
    rays_per_s: float
    cpu_us: float
    rays: int
    chosen: bool


def measured(peer: Peer, problem: Problem, stated_px: float, runs: int) -> Iterator[Row]:
    """Judge a peer's settings from the loosest on; time the first one that keeps the error.

    If none does, the last one is timed.
    """
    known = problem.part(np.flatnonzero(np.isfinite(problem.truth[:, 0])))
    judged = known.some(peer.judged)
    for number, setting in enumerate(peer.settings):
        error = judged.error_px(peer.prepare(judged, setting)())
        rms = float(np.sqrt(np.mean(error**2)))
        good = rms <= stated_px
        seconds, cpu, rays = np.nan, np.nan, len(judged)
        if good or number == len(peer.settings) - 1:
            timed_rays = problem.some(peer.rays)
            seconds, cpu = timed(peer.prepare(timed_rays, setting), runs)
            rays = len(timed_rays)
        yield Row(
            peer.name,
            peer.field,
            setting,
            peer.unit,
            rms,
            float(error.max()),
            rays / seconds,
            cpu / rays * 1e6,
            rays,
            good,
        )
        if good:
            return


def timed(work: Callable[[], Any], runs: int) -> tuple[float, float]:
    """Medians of wall and processor time, s, of some runs after a first that warms up."""
    walls, cpus = [], []
    for number in range(runs + 1):
        wall, cpu = time.perf_counter(), time.process_time()
        work()
        if number:
            walls.append(time.perf_counter() - wall)
            cpus.append(time.process_time() - cpu)
    return float(np.median(walls)), float(np.median(cpus))
