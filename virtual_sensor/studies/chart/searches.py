"""Panel "search": the paper's search, Newton's and maps, error against time for each point."""

from __future__ import annotations

from collections.abc import Callable, Iterator
from functools import partial
from typing import Any

import numpy as np
from numpy.typing import NDArray

from virtual_sensor.imaging.scene import load_scene
from virtual_sensor.optics import covering_maps
from virtual_sensor.optics.ray_search import FoundPixels, March, SearchStatus, ray_search
from virtual_sensor.studies.chart.benchmark import Configuration, Score, Task

Array = NDArray[np.float64]
Make = Callable[..., Configuration]

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
        failed = int(np.sum(found.status != SearchStatus.FOUND))
        marched = found.iterations[found.status != SearchStatus.LASER_MISSED]
        marches = f"{np.mean(marched):.3g} marches of the camera's ray for each point"
        return Score(error, UM_PER_PX * error, failed, marches if np.any(marched) else "")

    def configuration(
        name: str,
        kind: str,
        method: str,
        chosen: dict[str, Any] | None = None,
        before: Callable[[], object] = lambda: None,
        **options: Any,
    ) -> Configuration:
        def find(y_mm: Array) -> FoundPixels:
            before()
            return ray_search(scene, y_mm, method, **options)

        used = {key: value for key, value in options.items() if key != "march"}
        used |= _settings(options["march"]) if "march" in options else {}
        warm_up = partial(find, y_mm[:_WARM_UP])
        return Configuration(name, kind, lambda: partial(find, y_mm), chosen or {}, used, warm_up)

    kinds = (_by_maps, _papers, _newtons)
    choices = [each for kind in kinds for each in kind(configuration, quick)]
    reference = f"Newton's search in float64, {FINEST.method} of {FINEST.step_mm:g} mm"
    yield Task("the pixels that see given laser points", reference, count, score, choices)


def _settings(march: March) -> dict[str, Any]:
    return {"method": march.method, "step_mm": march.step_mm, "precision": march.precision}


def _by_maps(make: Make, quick: bool) -> Iterator[Configuration]:
    """By maps that are made within the time, as for a scene that is new; and by those it has."""
    for name, before in (("new_maps", covering_maps.MAPS.clear), ("cached_maps", lambda: None)):
        for px in (1e-3,) if quick else (1e-2, 1e-3, 1e-4):
            chosen = {"tolerance_px": px}
            yield make(name, "tabulated", "tabulated", chosen, before, tolerance_px=px)


def _papers(make: Make, quick: bool) -> Iterator[Configuration]:
    """The paper's halving search, with its march, its grid and its number of halvings varied."""
    choices = [(step, 32.0, 15) for step in (0.1, 0.5, 2.0, 8.0)]
    choices += [(0.5, 8.0, 15), (0.5, 64.0, 15), (0.5, 32.0, 8), (0.5, 32.0, 20)]
    for step, grid, halvings in [(2.0, 32.0, 15), (2.0, 1.0, 15)] if quick else choices:
        chosen = {"step_mm": step, "grid_px": grid, "halvings": halvings}
        options = {"march": March(step, "leapfrog"), "grid_px": (grid, grid), "k_stop": halvings}
        yield make("paper", "paper", "paper", chosen, **options)


def _newtons(make: Make, quick: bool) -> Iterator[Configuration]:
    """Newton's, along the line with a march of its own, and ray by ray."""
    yield make("newton_along_line", "newton", "newton")
    marches = [March(step, "leapfrog") for step in (0.1, 0.5, 2.0, 8.0)]
    marches += [March(2.0, "leapfrog", "single"), *(March(s, "sharma") for s in (0.5, 2.0))]
    for march in [March(2.0, "leapfrog")] if quick else marches:
        yield make("newton_by_ray", "newton", "newton", _settings(march), march=march)
