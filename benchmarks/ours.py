"""Our own march, and the problem as it stands in the shipped scene."""

from __future__ import annotations

from collections.abc import Callable

import numpy as np
from numpy.typing import NDArray
from problem import Grid, Peer, Problem

from virtual_sensor.imaging.scene import Scene
from virtual_sensor.optics.eikonal import March
from virtual_sensor.studies.chart.ray_bundles import (
    FINEST,
    Bundle,
    camera_bundle,
    ends_of,
    prepare,
    tabulated_ends,
)

Array = NDArray[np.float64]
STEPS_MM = (8.0, 6.0, 5.0, 4.0, 3.5, 3.0, 2.75, 2.5, 2.25, 2.0, 1.75, 1.5, 1.25, 1.0, 0.75, 0.5)
TOLERANCES_MM = tuple(10.0 ** (-0.5 * k) for k in range(4, 15))
_LONGEST_MM = 24.0

REFERENCE = f"float64 march, {FINEST.method} of {FINEST.step_mm:g} mm"


def problem_of(scene: Scene, rays: int, judged: int) -> Problem:
    """The camera's rays towards the laser's line, from the border of the field on."""
    field = scene.field
    assert field is not None
    bundle = camera_bundle(scene, rays)
    truth = np.full_like(bundle.targets, np.nan)
    truth[bundle.sample(judged)] = ends_of(field, bundle.some(judged), FINEST)
    low, high = field.box
    faces = np.where(bundle.directions > 0.0, low, high) - bundle.origins
    across = bundle.directions != 0.0  # the others meet no face of that axis
    reached = np.divide(faces, bundle.directions, where=across, out=np.full_like(faces, -np.inf))
    enter = reached.max(axis=1) + 1e-9  # a picometre inside
    starts = bundle.origins + bundle.directions * enter[:, None]
    lengths = np.einsum("ij,ij->i", bundle.targets - starts, bundle.directions)
    relative = (field.nodes - field.ambient) / (1.0 + field.ambient)
    grid = Grid(relative, field.origin.copy(), field.spacing.copy(), field.mirror)
    return Problem(grid, starts, bundle.directions, lengths, bundle.targets, bundle.normal, truth)


def marching(
    scene: Scene, method: str, precision: str
) -> Callable[[Problem, float], Callable[[], Array]]:
    """Peer's `prepare`; the setting is a step, or for dopri5 a tolerance, both in mm."""

    def prepared(problem: Problem, setting: float) -> Callable[[], Array]:
        controlled = method == "dopri5"
        march = March(
            _LONGEST_MM if controlled else setting,
            method,
            precision,
            tolerance_mm=setting if controlled else 1e-6,
        )
        rays = Bundle(problem.starts, problem.directions, problem.targets, problem.normal)
        work = prepare(scene.field, rays, march)
        return lambda: work().positions()  # peers hand over NumPy arrays too

    return prepared


def peers(scene: Scene) -> list[Peer]:
    """Our configurations."""
    found = []
    for precision in ("single", "double"):
        for method in ("leapfrog", "sharma", "rk4", "dopri5"):
            controlled = method == "dopri5"
            found.append(
                Peer(
                    f"ours: {method}, {precision}",
                    "cubic spline",
                    TOLERANCES_MM if controlled else STEPS_MM,
                    "mm tolerance" if controlled else "mm",
                    marching(scene, method, precision),
                    200_000,
                    2001,
                )
            )
    return found + _tabulated(scene)


def _tabulated(scene: Scene) -> list[Peer]:
    """The tabulated transport, the making of the table included."""

    def prepared(problem: Problem, setting: float) -> Callable[[], Array]:
        rays = Bundle(problem.starts, problem.directions, problem.targets, problem.normal)
        return tabulated_ends(scene, rays, setting)[0]

    settings = (0.05, 0.02, 0.01, 0.005, 0.002, 0.001)
    return [
        Peer("ours: tabulated", "cubic spline", settings, "px tolerance", prepared, 200_000, 2001)
    ]
