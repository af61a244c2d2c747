"""Panel "search": the paper's search, Newton's and maps, error against time for each point."""

from __future__ import annotations

from collections.abc import Callable, Iterator
from dataclasses import replace
from typing import Any

import numpy as np
from numpy.typing import NDArray

from virtual_sensor.imaging.scene import Scene, load_scene
from virtual_sensor.optics import covering_maps
from virtual_sensor.optics.ray_search import FoundPixels, March, SearchStatus, ray_search
from virtual_sensor.studies.chart.benchmark import Configuration, Score, Task

Array = NDArray[np.float64]

SCENE = "hot_cylinder"
FINEST = March(0.02, "leapfrog", "double")
"""The reference: 1e-8 px from Runge-Kutta's method with steps of 0.025 mm."""

HALF_LINE_MM = 10.4  # the line that all of the scene's points of are seen
UM_PER_PX = 22.0

_POINTS, _QUICK_POINTS = 10_000, 40
_JUDGED, _QUICK_JUDGED = 501, 10
_WARM_UP = 16  # points that load the kernels


def tasks(quick: bool = False) -> Iterator[Task]:
    """Many laser points, searched for by every method."""
    scene = load_scene(SCENE)
    count = _QUICK_POINTS if quick else _POINTS
    y_mm = np.random.default_rng(0).uniform(-HALF_LINE_MM, HALF_LINE_MM, count)
    at = np.linspace(0, count - 1, _QUICK_JUDGED if quick else _JUDGED).astype(int)
    truth = ray_search(scene, y_mm[at], "newton", march=FINEST).pixel

    def score(found: FoundPixels) -> Score:
        error = np.linalg.norm(found.pixel[at] - truth, axis=1)
        marched = found.iterations[found.status != SearchStatus.LASER_MISSED]
        return Score(
            error,
            UM_PER_PX * error,
            int(np.sum(found.status != SearchStatus.FOUND)),
            f"{np.mean(marched):.3g} marches of the camera's ray for each point"
            if np.any(marched)
            else "",
        )

    yield Task(
        "the pixels that see given laser points",
        f"Newton's search in float64, {FINEST.method} of {FINEST.step_mm:g} mm",
        count,
        score,
        [
            *_by_maps(scene, y_mm, quick),
            *_papers(scene, y_mm, quick),
            *_newtons(scene, y_mm, quick),
        ],
    )


def _configuration(
    name: str,
    kind: str,
    scene: Scene,
    y_mm: Array,
    method: str,
    before: Callable[[], object] = lambda: None,
    **options: Any,
) -> Configuration:
    def find(y_mm: Array) -> FoundPixels:
        before()
        return ray_search(scene, y_mm, method, **options)

    used = {key: value for key, value in options.items() if key != "march"}
    return Configuration(
        name,
        kind,
        lambda: lambda: find(y_mm),
        defaults=used | _march(options.get("march")),
        warm_up=lambda: find(y_mm[:_WARM_UP]),
    )


def _march(march: March | None) -> dict[str, Any]:
    if march is None:
        return {}
    return {"method": march.method, "step_mm": march.step_mm, "precision": march.precision}


def _by_maps(scene: Scene, y_mm: Array, quick: bool) -> Iterator[Configuration]:
    """By maps that are made within the time, as for a scene that is new; and by those it has."""
    for name, before in (("new_maps", covering_maps.MAPS.clear), ("cached_maps", lambda: None)):
        for px in (1e-3,) if quick else (1e-2, 1e-3, 1e-4):
            found = _configuration(
                name, "tabulated", scene, y_mm, "tabulated", before=before, tolerance_px=px
            )
            yield replace(found, chosen={"tolerance_px": px})


def _papers(scene: Scene, y_mm: Array, quick: bool) -> Iterator[Configuration]:
    """The paper's halving search, with its march, its grid and its number of halvings varied."""
    if quick:
        choices = [(2.0, 32.0, 15), (2.0, 1.0, 15)]
    else:
        choices = [(step, 32.0, 15) for step in (0.1, 0.5, 2.0, 8.0)]
        choices += [(0.5, 8.0, 15), (0.5, 64.0, 15), (0.5, 32.0, 8), (0.5, 32.0, 20)]
    for step, grid, halvings in choices:
        found = _configuration(
            "paper",
            "paper",
            scene,
            y_mm,
            "paper",
            march=March(step, "leapfrog"),
            grid_px=(grid, grid),
            k_stop=halvings,
        )
        yield replace(found, chosen={"step_mm": step, "grid_px": grid, "halvings": halvings})


def _newtons(scene: Scene, y_mm: Array, quick: bool) -> Iterator[Configuration]:
    """Newton's, along the line with a march of its own, and ray by ray."""
    yield _configuration("newton_along_line", "newton", scene, y_mm, "newton")
    marches = [March(step, "leapfrog") for step in (0.1, 0.5, 2.0, 8.0)]
    marches += [March(2.0, "leapfrog", "single"), *(March(s, "sharma") for s in (0.5, 2.0))]
    for march in [March(2.0, "leapfrog")] if quick else marches:
        found = _configuration("newton_by_ray", "newton", scene, y_mm, "newton", march=march)
        yield replace(found, chosen=_march(march))
