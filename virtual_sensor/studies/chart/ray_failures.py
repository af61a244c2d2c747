"""Where bent rays fail: turned back, grazing, lost in float32, out of steps, from nowhere."""

from __future__ import annotations

from typing import Any

import numpy as np
from numpy.typing import NDArray

from virtual_sensor.arrays import to_numpy, to_vectors
from virtual_sensor.engine import dr, mi
from virtual_sensor.errors import InputError
from virtual_sensor.imaging.scene import load_scene
from virtual_sensor.medium.exact_fields import ExactField, hot_spot, linear
from virtual_sensor.optics.eikonal import Field, March, Straight, bend, never
from virtual_sensor.optics.ray_status import RayStatus
from virtual_sensor.optics.surfaces import Cylinder, NoSurface, Surface
from virtual_sensor.optics.trace import trace
from virtual_sensor.studies.chart import air_failures
from virtual_sensor.studies.chart.air_failures import TOO_MUCH_PX, HotAir
from virtual_sensor.studies.chart.ray_bundles import MM_PER_PX
from virtual_sensor.studies.chart.rung import Failure, Report

Array = NDArray[np.float64]

SCENE = "hot_cylinder"
METHODS = (
    March(0.05, "euler", "double"),
    March(2.0, "leapfrog", "double"),
    March(2.0, "leapfrog", "single"),
    March(2.0, "sharma", "double"),
    March(2.0, "rk4", "double"),
    March(10.0, "dopri5", "double"),
    March(10.0, "dopri5", "single"),
)

# n^2 falls linearly from 1 at z = -40 mm to 0.2 at z = 40: a ray is thrown back like a stone.
_G = 0.01
_FLOOR_MM, _CEILING_MM = -40.0, 40.0

_DEPTH, _WIDTH_MM = 4e-4, 5.0  # of a ball of hot air


def failures(report: Report, quick: bool = False) -> list[Failure]:
    """Measure where rays fail, and how that is told.

    Parameters
    ----------
    report : callable
    quick : bool
        Few rays and settings.
    """
    methods = METHODS[1::3] if quick else METHODS
    report("rays: turned back, grazing", 0.0)
    found = [turned_back(march, 11 if quick else 101) for march in methods]
    found += [grazing(march, 2 if quick else 3) for march in methods]
    report("rays: float32, steps, places", 0.1)
    found += [single_precision(), out_of_steps(), from_nowhere()]
    return found + air_failures.failures(HotAir(load_scene(SCENE), quick), report, quick)


def march_rays(
    field: Field, starts: Array, directions: Array, march: March, surface: Surface
) -> tuple[Array, NDArray[np.uint32]]:
    """Positions (N, 3) in mm and status (N,) of rays that run on until something stops them."""
    line = Straight.through(to_vectors(starts), to_vectors(directions), march)
    ray = bend(field, surface, line, march, remaining=never)
    dr.eval(ray)
    return to_numpy(ray.position(line)), np.array(ray.status)


# ------------------------------------------------------------------------------------ turning rays


def throwing_field() -> ExactField:
    """Total reflection in a field: its rays are parabolas."""
    box = np.array([[-900.0, -900.0, _FLOOR_MM], [900.0, 900.0, _CEILING_MM]])
    return linear(float(np.sqrt(1.0 + _G * _FLOOR_MM)), (0.0, 0.0, -_G), box=box)


def turned_back(march: March, count: int) -> Failure:
    """Which way rays near the critical angle go, and where."""
    wrong, miss_px = thrown(march, count)
    return Failure(
        "turned back by total reflection",
        str(march),
        f"{wrong.sum()} rays with a wrong status" if wrong.any() else "",
        f"{count} rays round the critical angle, in n^2 from 1 to 0.2 over 80 mm",
        "TURNED_BACK, and LEFT beyond the angle",
        int(wrong.sum()),
        count,
        f"those turned back leave within {np.nanmax(miss_px):.1e} px of the parabola",
    )


def thrown(march: March, count: int) -> tuple[NDArray[np.bool_], Array]:
    """Rays round the angle of total reflection, T_z^2 = g (ceiling - floor), like stones.

    Returns
    -------
    wrong : ndarray of bool of shape (N,)
        Rays with another status than they should have.
    miss_px : ndarray of shape (N,)
        Distance from the parabola where they leave; NaN for those that are not turned back.
    """
    T_z = np.sqrt(_G * (_CEILING_MM - _FLOOR_MM)) + np.linspace(-0.15, 0.05, count)
    directions = np.stack([np.sqrt(1.0 - T_z**2), 0.0 * T_z, T_z], axis=1)
    starts = [-100.0, 0.0, _FLOOR_MM] - 10.0 * directions
    position, status = march_rays(throwing_field(), starts, directions, march, NoSurface())
    apex_mm = T_z**2 / _G + _FLOOR_MM
    back = apex_mm < _CEILING_MM
    clear = abs(apex_mm - _CEILING_MM) > 0.01  # the border is overstepped by some um
    wrong = clear & (status != np.where(back, RayStatus.TURNED_BACK, RayStatus.LEFT))
    # The range of a stone; it ends a little under the floor, along its last slope.
    reached = -100.0 + 4.0 * T_z * directions[:, 0] / _G
    reached += (_FLOOR_MM - position[:, 2]) * directions[:, 0] / T_z
    miss_px = abs(position[:, 0] - reached) * T_z / MM_PER_PX
    return wrong, np.where(back & clear, miss_px, np.nan)


# ----------------------------------------------------------------------------------- grazing rays


def layer_round_a_cylinder(depth: float, width_mm: float = 8.0) -> ExactField:
    """n^2 = 1 - depth exp(-(rho^2 - R^2) / 2w^2) round the paper's cylinder: a hot layer."""
    part = Cylinder()

    def n_squared(p: Any) -> tuple[Any, Any, Any]:
        across = type(p)(0.0, p.y - part.axis_y_mm, p.z - part.axis_z_mm)
        dip = depth * dr.exp((part.radius_mm**2 - dr.squared_norm(across)) / (2.0 * width_mm**2))
        matrix = mi.Matrix3f64 if dr.type_v(p) == dr.VarType.Float64 else mi.Matrix3f
        return 1.0 - dip, across * (dip / width_mm**2), dr.zeros(matrix)  # no derivatives asked

    box = np.array([[-100.0, -70.0, -83.5], [100.0, 70.0, 56.5]])
    return ExactField(n_squared, box=box)


def grazing(march: March, rounds: int) -> Failure:
    """Rays past the silhouette, closer and closer."""
    miss_px, unfit, of = silhouette(march, rounds)
    return Failure(
        "grazing rays at the silhouette",
        str(march),
        f"off by {miss_px:.2g} px" if miss_px > TOO_MUCH_PX else "",
        f"{of // rounds} rays either side of the silhouette, {rounds} times closer each",
        "HIT or LEFT, and never HIT beyond a ray that missed",
        unfit,
        of,
        f"the silhouette is found within {miss_px:.1e} px of Bouguer's n(R) R",
    )


def silhouette(
    march: March, rounds: int, depth: float = 5e-4, count: int = 1001
) -> tuple[float, int, int]:
    """Find the ray that grazes: by Bouguer's law those with b < n(R) R meet the cylinder.

    Returns
    -------
    miss_px : float
        Of the b where HIT becomes LEFT, from n(R) R.
    unfit, of : int
        Rays with another status, or HIT beyond one that missed by more than rounding; of how many.
    """
    part = Cylinder()
    field = layer_round_a_cylinder(depth)
    expected = part.radius_mm * np.sqrt(1.0 - depth)
    low, high = expected - 0.5, expected + 0.5
    rounding_mm = 1e-5 if march.precision == "single" else 1e-12  # of positions near the part
    unfit = 0
    for _ in range(rounds):
        b = np.linspace(low, high, count)
        starts = np.stack([0.0 * b, 0.0 * b - 100.0, part.axis_z_mm + b], axis=1)
        directions = np.tile([0.0, 1.0, 0.0], (count, 1))
        _, status = march_rays(field, starts, directions, march, part)
        hit = status == RayStatus.HIT
        unfit += int(np.sum(~hit & (status != RayStatus.LEFT)))
        missed = np.append(b[~hit], np.inf)[0]
        unfit += int(np.sum(hit & (b > missed + rounding_mm)))
        last = int(np.flatnonzero(hit)[-1]) if hit.any() else 0
        low, high = b[max(last - 1, 0)], b[min(last + 2, count - 1)]
    return abs(0.5 * (low + high) - expected) / MM_PER_PX, unfit, count * rounds


# -------------------------------------------------------------------------- precision, limits, NaN


def single_precision(step_mm: float = 0.5) -> Failure:
    """Absolute positions in float32, against the difference from the straight ray."""
    miss_px = lost_in_single(step_mm)
    worst = miss_px["absolute"]
    return Failure(
        "float32",
        "absolute positions, leapfrog in NumPy",
        f"steps of {step_mm:g} mm" if worst.max() > TOO_MUCH_PX else "",
        "rays that start 300 mm off, through a ball of hot air",
        "no status; not done here: the difference from the straight ray errs by"
        f" {miss_px['difference'].max():.1e} px",
        int(np.sum(worst > TOO_MUCH_PX)),
        worst.size,
        f"absolute positions err by {worst.max():.1e} px at most against their own float64",
    )


def lost_in_single(step_mm: float) -> dict[str, Array]:
    """What float32 costs rays (N,) in px, by "difference" and "absolute"; both by leapfrog."""
    y = np.linspace(-10.0, 10.0, 201)
    starts = np.stack([0.0 * y - 300.0, y + 20.0, 0.0 * y + 7.0], axis=1)
    directions = np.tile([1.0, -20.0 / 300.0, -6.0 / 300.0], (y.size, 1))
    directions /= np.linalg.norm(directions, axis=1, keepdims=True)
    miss_px = {}
    for way, run in (("difference", _carried), ("absolute", _absolute)):
        single, double = (
            run(starts.astype(dtype), directions.astype(dtype), step_mm)
            for dtype in (np.float32, np.float64)
        )
        along = np.einsum("ij,ij->i", single - double, directions)[:, None] * directions
        miss_px[way] = np.linalg.norm(single - double - along, axis=1) / MM_PER_PX
    return miss_px


def _carried(starts: Array, directions: Array, step_mm: float) -> Array:
    """What the march carries: the offset from the straight ray, 100 mm behind the middle."""
    field = hot_spot(_DEPTH, _WIDTH_MM, box=np.array([[-60.0] * 3, [60.0] * 3]))
    precision = "single" if starts.dtype == np.float32 else "double"
    march = March(step_mm, "leapfrog", precision)
    exact = to_vectors(starts.astype(float)), to_vectors(directions.astype(float))
    line = Straight.through(*exact, march)
    ray = bend(field, NoSurface(), line, march)
    dr.eval(ray)
    return (
        to_numpy(ray.offset[0]) + to_numpy(ray.tau[0]) * (100.0 - np.array(ray.t, float))[:, None]
    )


def _absolute(starts: Array, directions: Array, step_mm: float) -> Array:
    """What one writes first: r and T themselves, step by step, all in one precision."""
    r, T = starts, directions
    h, limit, w2, depth = (starts.dtype.type(x) for x in (step_mm, 60.0, _WIDTH_MM**2, _DEPTH))
    for _ in range(int(400.0 / step_mm)):
        r = r + T * (h / 2)
        inside = np.all(abs(r) < limit, axis=1)[:, None]
        dip = depth * np.exp(-np.sum(r**2, axis=1, keepdims=True) / (2 * w2))
        T = T + np.where(inside, r * (dip / (2 * w2)) * h, 0).astype(starts.dtype)
        r = r + T * (h / 2)
    return r.astype(float)


def out_of_steps() -> Failure:
    """A field so wide, or a step so short, that the steps allowed do not cross it."""
    rays = trace(throwing_field(), [[0.0, 0.0, 0.0]], [[1.0, 0.0, 0.0]], 50.0, 0.001)
    lost = rays.status == RayStatus.OUT_OF_STEPS
    return Failure(
        "out of steps",
        "every method",
        "50 mm in steps of 0.001 mm",
        "a ray of 50 mm with 20,000 steps allowed",
        RayStatus(int(rays.status[0])).name,
        int(lost.sum()),
        1,
        f"its numbers are those of the last step, {np.linalg.norm(rays.position[0]):.0f} mm off",
    )


def from_nowhere() -> Failure:
    """A start that is no number."""
    field = throwing_field()
    nowhere = np.array([[np.nan, 0.0, 0.0]])
    try:
        trace(field, nowhere, [[1.0, 0.0, 0.0]], 10.0)
        told = "not refused"
    except InputError as error:
        told = f"refused (InputError): {error}"
    position, status = march_rays(field, nowhere, np.array([[1.0, 0, 0]]), METHODS[1], NoSurface())
    silent = int(np.sum(np.isfinite(position).all(axis=1) | (status == RayStatus.HIT)))
    return Failure(
        "a start that is not a number",
        "trace",
        "NaN",
        "one coordinate of one ray",
        told,
        silent,
        1,
        "within the program such a ray stays NaN, and never gets HIT",
    )
