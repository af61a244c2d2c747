"""Where the march fails by its step or by the field's grid, measured on the shipped hot air."""

from __future__ import annotations

from collections.abc import Iterable
from dataclasses import replace

import numpy as np
from numpy.typing import NDArray

from virtual_sensor.errors import InputError
from virtual_sensor.imaging.checks import check_scene
from virtual_sensor.imaging.scene import Scene
from virtual_sensor.medium.index_field import IndexField
from virtual_sensor.optics.eikonal import Field, March
from virtual_sensor.optics.trace import trace
from virtual_sensor.studies.chart.ray_bundles import (
    FINEST,
    MM_PER_PX,
    Bundle,
    apart_px,
    camera_bundle,
    ends_of,
)
from virtual_sensor.studies.chart.rung import Failure, Report

Array = NDArray[np.float64]

TOO_MUCH_PX = 0.01
"""An error above which a ray counts as failed, where no status can tell it."""

STEPS_MM: tuple[float, ...] = (
    0.05,
    0.125,
    0.25,
    0.5,
    1.0,
    1.5,
    2.0,
    2.5,
    3.0,
    4.0,
    5.0,
    6.0,
    8.0,
    12.0,
    16.0,
)
TOLERANCES_MM = (1e-7, 1e-6, 3e-6, 1e-5, 3e-5, 1e-4)
_LONGEST_MM = 24.0
_MARCH = March(1.0, "rk4", "double")
_RAYS, _QUICK_RAYS = 1000, 60


class HotAir:
    """The camera's rays through the shipped plume, and where they truly end."""

    def __init__(self, scene: Scene, quick: bool) -> None:
        assert scene.field is not None
        self.scene, self.field = scene, scene.field
        self.bundle: Bundle = camera_bundle(scene, _QUICK_RAYS if quick else _RAYS)
        march = replace(FINEST, step_mm=0.2) if quick else FINEST
        self.truth = ends_of(self.field, self.bundle, march)

    def errors_px(self, field: Field, march: March, truth: Array | None = None) -> Array:
        """Error (N,) of each ray; infinite for those whose status is not ENDED."""
        ends = ends_of(field, self.bundle, march)
        errors = apart_px(ends, self.truth if truth is None else truth, self.bundle)
        return np.where(np.isnan(errors), np.inf, errors)


def failures(air: HotAir, report: Report, quick: bool = False) -> list[Failure]:
    """Steps, grids, noise, jumps of the gradient and of n."""
    report("rays: steps too long", 0.2)
    methods = ("leapfrog",) if quick else ("euler", "leapfrog", "sharma", "rk4")
    found = [too_long(air, method, quick) for method in methods]
    found.append(too_tolerant(air, quick))
    report("rays: grids too coarse", 0.5)
    found += [
        too_coarse(air, interpolation, (1, 8) if quick else (1, 2, 4, 8))
        for interpolation in ("cubic", "linear")
    ]
    report("rays: noise on the field", 0.6)
    found.append(noisy(air, (1e-4, 1e-1) if quick else (1e-4, 1e-3, 3e-3, 1e-2, 3e-2, 1e-1)))
    report("rays: jumps of the gradient and of n", 0.7)
    found.append(kinked(air, (2.0, 1.0) if quick else (2.0, 1.0, 0.5, 0.25, 0.125)))
    return [*found, cropped(air), border_of_slab()]


def _first_above(
    tried: Iterable[tuple[str, Array]],
) -> tuple[str, int, int, list[str]]:
    """The first setting at which an error is too large; how many rays of how many; all errors."""
    first, failed, of, told = "", 0, 0, []
    for name, errors in tried:
        too_large = int(np.sum(~(errors <= TOO_MUCH_PX)))
        told.append(f"{name}: {errors.max():.1e} px")
        if too_large and not first:
            first, failed = name, too_large
        of = len(errors)
    return first, failed, of, told


def too_long(air: HotAir, method: str, quick: bool) -> Failure:
    """Fixed steps, from short to long."""
    steps = STEPS_MM if method == "euler" else STEPS_MM[4:]
    steps = steps[-9::4] if quick else steps
    tried = [
        (f"{step:g} mm", air.errors_px(air.field, March(step, method, "double"))) for step in steps
    ]
    first, failed, of, told = _first_above(tried)
    return Failure(
        "steps too long",
        method,
        first,
        f"steps of {steps[0]:g} to {steps[-1]:g} mm",
        "no status can tell: halve the step and compare",
        failed,
        of,
        "largest errors: " + ", ".join(told),
    )


def too_tolerant(air: HotAir, quick: bool) -> Failure:
    """Controlled steps, by their tolerance."""
    tolerances = TOLERANCES_MM[1::2] if quick else TOLERANCES_MM
    marches = [
        March(_LONGEST_MM, "dopri5", "double", tolerance_mm=tolerance) for tolerance in tolerances
    ]
    tried = [(f"{m.tolerance_mm:g} mm", air.errors_px(air.field, m)) for m in marches]
    first, failed, of, told = _first_above(tried)
    return Failure(
        "tolerance too wide",
        "dopri5",
        first,
        f"tolerances of {tolerances[0]:g} to {tolerances[-1]:g} mm a step",
        "no status: the estimate is of one smooth step, and the spline's cells are shorter",
        failed,
        of,
        "largest errors: " + ", ".join(told),
    )


def too_coarse(air: HotAir, interpolation: str, factors: tuple[int, ...]) -> Failure:
    """Every n-th node along each axis, against the field as it is."""
    tried = [
        (
            f"every {k}. node" if k > 1 else "every node",
            air.errors_px(thinned(air.field, k).simplified(interpolation), _MARCH),
        )
        for k in factors
    ]
    first, failed, of, told = _first_above(tried)
    spacing = " x ".join(f"{s:g}" for s in air.field.spacing)
    return Failure(
        "grid too coarse",
        f"{interpolation} field",
        first,
        f"every {', '.join(f'{k}.' for k in factors)} node along each axis; all: {spacing} mm",
        "no status can tell: leave out every second node and compare",
        failed,
        of,
        "largest errors: " + ", ".join(told),
    )


def thinned(field: IndexField, factor: int) -> IndexField:
    """Every n-th node along each axis, from the first."""
    nodes = field.nodes[::factor, ::factor, ::factor]
    return field.with_nodes(nodes, spacing_mm=field.spacing * factor)


def noisy(air: HotAir, levels: Iterable[float]) -> Failure:
    """Noise on the nodes, relative to what they differ by from the surroundings."""
    rng = np.random.default_rng(5)
    tried = []
    levels = tuple(levels)
    for level in levels:
        factor = 1.0 + level * rng.normal(size=air.field.shape)
        difference = (air.field.nodes - air.field.ambient) * factor
        field = air.field.with_nodes(air.field.ambient + difference)
        tried.append((f"{level:g}", air.errors_px(field, _MARCH)))
    first, failed, of, told = _first_above(tried)
    lost = sum(int(np.isinf(errors).sum()) for _, errors in tried)
    return Failure(
        "noise on the field",
        "cubic field, rk4",
        first,
        f"relative noise of {levels[0]:g} to {levels[-1]:g} in n - n_ambient at the nodes",
        f"no status can tell; {lost} rays end with another one than in the clean field",
        failed,
        of,
        "largest errors: " + ", ".join(told),
    )


def kinked(air: HotAir, steps_mm: tuple[float, ...]) -> Failure:
    """The gradient of trilinear interpolation: what it costs, whatever the step."""
    linear = air.field.simplified("linear")
    limit = ends_of(linear, air.bundle, replace(_MARCH, step_mm=steps_mm[-1] / 8.0))
    tried, own = [], []
    for step in steps_mm:
        march = replace(_MARCH, step_mm=step)
        tried.append((f"{step:g} mm", air.errors_px(linear, march)))
        own.append(float(np.sqrt(np.mean(air.errors_px(linear, march, limit) ** 2))))
    first, failed, of, told = _first_above(tried)
    order = float(np.polyfit(np.log(steps_mm), np.log(own), 1)[0])
    return Failure(
        "jump of a trilinear gradient",
        "linear field, rk4",
        first,
        f"steps of {steps_mm[0]:g} to {steps_mm[-1]:g} mm",
        "no status can tell: the error against the cubic field does not fall with the step",
        failed,
        of,
        f"largest errors: {', '.join(told)}; towards its own limit the method of order 4 has order"
        f" {order:.1f}",
    )


def cropped(air: HotAir) -> Failure:
    """The field cut off within the plume: what the march leaves out, and what the check says."""
    keep = air.field.shape[2] // 5
    field = air.field.with_nodes(air.field.nodes[:, :, :keep])
    errors = air.errors_px(field, _MARCH)
    top = field.box[1, 2]
    return Failure(
        "jump of n at the border",
        "rk4",
        f"cut off at z = {top:g} mm",
        "the plume cut off at a fifth of its height",
        refusal(air.scene.with_medium(field)) or "not refused",
        int(np.sum(~(errors <= TOO_MUCH_PX))),
        len(errors),
        f"largest error {errors.max():.2g} px",
    )


def refusal(scene: Scene) -> str:
    """With which message a scene is refused or told of; "" for neither."""
    try:
        told = check_scene(scene)
    except InputError as error:
        return f"refused (InputError): {error}"
    return f"told of: {'; '.join(told)}" if told else ""


def border_of_slab(
    jump: float = -2e-4, angle_deg: float = 45.0, depth_mm: float = 100.0
) -> Failure:
    """Uniform air behind a flat border: Snell's law turns a ray there, the march does not."""
    ambient = 2.7e-4
    nodes = np.full((4, 4, 4), ambient + jump)
    field = IndexField.from_arrays(nodes, [-200.0, -200.0, 0.0], [150.0] * 3, ambient=ambient)
    sine = np.sin(np.radians(angle_deg))
    direction = np.array([sine, 0.0, np.sqrt(1.0 - sine**2)])
    inside = sine * (1.0 + ambient) / (1.0 + ambient + jump)
    length = depth_mm / direction[2]
    ray = trace(field, [[0.0, 0.0, 0.0] - 10.0 * direction], [direction], 10.0 + length)
    snells = depth_mm * inside / np.sqrt(1.0 - inside**2)
    miss = abs(ray.position[0, 0] - snells) * direction[2] / MM_PER_PX
    return Failure(
        "jump of n at the border",
        "every method",
        f"a jump of {abs(jump):g} at {angle_deg:g} deg",
        f"uniform air behind a flat border, {depth_mm:g} mm deep",
        "no status of a ray: the scene is refused before, by the shift that Snell's law gives",
        int(miss > TOO_MUCH_PX),
        1,
        f"off by {miss:.2g} px from Snell's law",
    )
