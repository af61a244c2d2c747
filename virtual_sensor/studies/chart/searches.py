"""Panel "search": the paper's halving search, Newton's and maps, error against time per point."""

from __future__ import annotations

from collections.abc import Callable, Iterator
from dataclasses import dataclass, field
from typing import Any

import numpy as np
from numpy.typing import NDArray

from virtual_sensor.imaging.scene import Scene, load_scene
from virtual_sensor.optics import covering_maps
from virtual_sensor.optics.ray_search import (
    REFERENCE,
    FoundPixels,
    March,
    SearchStatus,
    ray_search,
)
from virtual_sensor.studies.chart.rung import Report, Rung, timed

Array = NDArray[np.float64]

SCENE = "hot_cylinder"
FINEST = March(0.02, "leapfrog", "double")
"""The reference: 1e-8 px from Runge-Kutta's method with steps of 0.025 mm."""

HALF_LINE_MM = 10.4  # the line that all of the scene's points of are seen
UM_PER_PX = 22.0

_POINTS, _QUICK_POINTS = 10_000, 40
_JUDGED, _QUICK_JUDGED = 501, 10
_WARM_UP = 16  # points that load the kernels
_RUNS = 3
_SLOW_MM = 0.6  # a search with shorter steps takes seconds and is timed once


@dataclass(frozen=True)
class Choice:
    """A way of searching, as a user would choose it: `ray_search`'s method, march and options.

    `anew` has the maps made within the time that is measured, as for a scene that is new.
    """

    name: str
    method: str
    march: March | None
    options: dict[str, Any] = field(default_factory=dict)
    anew: bool = False

    def find(self, scene: Scene, y_mm: Array) -> FoundPixels:
        """Search."""
        if self.anew:
            covering_maps.MAPS.clear()
        return ray_search(scene, y_mm, self.method, march=self.march, **self.options)

    @property
    def settings(self) -> dict[str, Any]:
        """What was chosen, for the tables."""
        if self.method == "tabulated":
            return dict(self.options)
        if self.march is None:
            return {"march": "default"} | self.options
        march = {"method": self.march.method, "step": self.march.step_mm}
        return march | {"precision": self.march.precision} | self.options


def rungs(report: Report, quick: bool = False) -> list[Rung]:
    """Search for many laser points in every way.

    Parameters
    ----------
    report : callable
    quick : bool
        Few rungs and points.
    """
    scene = load_scene(SCENE)
    rng = np.random.default_rng(0)
    y = rng.uniform(-HALF_LINE_MM, HALF_LINE_MM, _QUICK_POINTS if quick else _POINTS)
    at = np.linspace(0, y.size - 1, _QUICK_JUDGED if quick else _JUDGED).astype(int)
    report("search: the reference", 0.0)
    truth = ray_search(scene, y[at], "newton", march=FINEST).pixel
    choices = list(_quick_choices() if quick else _choices())
    found = []
    for number, choice in enumerate(choices):
        report(f"search: {choice.name}", (number + 1) / (len(choices) + 1))
        found.append(_measured(scene, choice, y, at, truth))
    return found


def _papers(march: March = REFERENCE, grid_px: float = 32.0, k_stop: int = 15) -> Choice:
    options = {"grid_px": (grid_px, grid_px), "k_stop": k_stop}
    return Choice("paper's search", "paper", march, options)


def _newtons(march: March) -> Choice:
    return Choice("Newton's, ray by ray", "newton", march)


def _by_maps(tolerance_px: float, anew: bool) -> Choice:
    name = "maps, made anew" if anew else "maps, kept"
    return Choice(name, "tabulated", None, {"tolerance_px": tolerance_px}, anew)


def _choices() -> Iterator[Choice]:
    for anew in (True, False):
        for tolerance in (1e-2, 1e-3, 1e-4):
            yield _by_maps(tolerance, anew)
    for step in (0.1, 0.5, 2.0, 8.0):
        yield _papers(March(step, "leapfrog", "double"))
    for grid in (8.0, 64.0):
        yield _papers(March(0.5, "leapfrog", "double"), grid)
    for k_stop in (8, 20):
        yield _papers(March(0.5, "leapfrog", "double"), k_stop=k_stop)
    yield Choice("Newton's, along the line", "newton", None)
    for step in (0.1, 0.5, 2.0, 8.0):
        yield _newtons(March(step, "leapfrog", "double"))
    yield _newtons(March(2.0, "leapfrog", "single"))
    for step in (0.5, 2.0):
        yield _newtons(March(step, "sharma", "double"))


def _quick_choices() -> Iterator[Choice]:
    yield _papers(March(2.0, "leapfrog", "double"))
    yield _papers(March(2.0, "leapfrog", "double"), grid_px=1.0)
    yield Choice("Newton's, along the line", "newton", None)
    yield _newtons(March(2.0, "leapfrog", "double"))
    yield _by_maps(1e-3, True)
    yield _by_maps(1e-3, False)


def _measured(
    scene: Scene, choice: Choice, y_mm: Array, at: NDArray[np.intp], truth: Array
) -> Rung:
    """Time a choice, and judge it at some of its points."""
    choice.find(scene, y_mm[:_WARM_UP])
    kept: list[FoundPixels] = []
    work: Callable[[], None] = lambda: kept.append(choice.find(scene, y_mm))  # noqa: E731
    slow = choice.march is not None and choice.march.step_mm < _SLOW_MM
    seconds = timed(work, 1, 0) if slow else timed(work, _RUNS)
    found = kept[-1]
    error = np.linalg.norm(found.pixel[at] - truth, axis=1)
    known = error[np.isfinite(error)]
    rms = float(np.sqrt(np.mean(known**2))) if known.size else np.nan
    marched = found.iterations[found.status != SearchStatus.LASER_MISSED]
    return Rung(
        panel="search",
        name=choice.name,
        settings=choice.settings,
        error_px=rms,
        largest_px=float(known.max()) if known.size else np.nan,
        error_um=rms * UM_PER_PX,
        seconds=seconds / y_mm.size,
        item="laser point",
        items=y_mm.size,
        failed=int(np.sum(found.status != SearchStatus.FOUND)),
        reference=f"Newton's search in float64, {FINEST.method} of {FINEST.step_mm:g} mm",
        note=f"{np.mean(marched):.3g} marches of the camera's ray for each point",
    )
