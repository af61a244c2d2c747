"""Is a tolerance kept?  Random scenes, the rung chosen for each, beside a reference in float64."""

import time
from collections.abc import Callable
from dataclasses import dataclass, replace
from statistics import median
from typing import Any

import numpy as np
from numpy.typing import NDArray

from virtual_sensor.engine import dr
from virtual_sensor.errors import InputError
from virtual_sensor.imaging.checks import check_scene
from virtual_sensor.imaging.render import render_uncached
from virtual_sensor.imaging.scene import Scene, load_scene
from virtual_sensor.metrology.truth import TrueLine
from virtual_sensor.optics.rays import March
from virtual_sensor.optics.transports import Transport
from virtual_sensor.studies.tolerance import (
    SAMPLES,
    STEPS_MM,
    Rung,
    choose,
    groups,
    largest_error,
    line_of,
    scene_on,
    search_line,
    whole_columns,
)

Array = NDArray[np.float64]
Index = NDArray[np.intp]

TOLERANCES_PX = (0.003, 0.3)
NOISE_S = 0.02
"""Times that differ by less are taken for the same."""

_FIELD_OF_VIEW_MM = 45.056
_TILT_DEG = -30.0
_LEAST_SIGMA_PX = 0.55  # of the line; narrower ones have no centres, whatever the rung
_REFERENCE = March(0.5, "leapfrog", "double")  # within 2e-6 px of RK4 by 0.25 mm
_REFERENCE_SPP = 25  # within 1e-4 px of 900
_BESIDE = 3  # columns: a centre is found beside others only
_GROUPS = 8  # of columns that the error is taken in: the line's ends, the others anywhere
_RUNS = 3


@dataclass(frozen=True)
class Trial:
    """A tolerance asked of a scene, and what came of it.

    Attributes
    ----------
    parameters : dict
        Of the scene `hot_cylinder`.
    tolerance_px : float
    rung : Rung or None
        None if none was found.
    error_px : float
        The true one: the largest of the columns that have a centre in the reference and by the
        rung; infinite if the rung finds too few.
    seconds : float
        For a frame by the rung.
    cheapest : str
        What of all that was tried keeps the tolerance in the least time; "" if nothing does.
    cheapest_seconds : float
    failure : str
        Why there is no rung; "" if there is one.
    """

    parameters: dict[str, Any]
    tolerance_px: float
    rung: Rung | None
    error_px: float = float("nan")
    seconds: float = float("nan")
    cheapest: str = ""
    cheapest_seconds: float = float("nan")
    failure: str = ""

    @property
    def error_ratio(self) -> float:
        """The true error over the tolerance."""
        return self.error_px / self.tolerance_px

    @property
    def cost_ratio(self) -> float:
        """The rung's time over that of the cheapest that would have done."""
        if self.seconds - self.cheapest_seconds < NOISE_S:
            return 1.0
        return self.seconds / self.cheapest_seconds


def random_scene(rng: np.random.Generator) -> tuple[Scene, dict[str, Any]]:
    """A `hot_cylinder` that can be measured, and the parameters drawn for it."""
    while True:
        film = int(rng.choice([512, 768]))
        drawn: dict[str, Any] = {
            "beta": rng.uniform(-60.0, 90.0),
            "temperature": int(rng.choice([900, 1100, 1250])),
            "blur": rng.uniform(0.0, 12.0),
            "widen": rng.uniform(1.0, 2.5),
            "along": rng.uniform(-60.0, 60.0),
            "line_radius": rng.uniform(0.08, 0.4),
            "alpha": rng.uniform(40.0, 75.0),
        }
        drawn = {name: round(value, 4) for name, value in drawn.items()}
        drawn |= {"width": film, "height": film}
        if _sigma_px(drawn) < _LEAST_SIGMA_PX:
            continue
        scene = load_scene("hot_cylinder", **drawn)
        try:
            check_scene(scene)
        except InputError:
            continue
        return scene, drawn


def random_tolerance(rng: np.random.Generator) -> float:
    """A tolerance in px, as likely in each octave."""
    low, high = np.log(TOLERANCES_PX)
    return round(float(np.exp(rng.uniform(low, high))), 5)


def trial(
    scene: Scene,
    parameters: dict[str, Any],
    tolerance_px: float,
    rng: np.random.Generator,
    clock: Callable[[], float] | None = time.perf_counter,
) -> Trial:
    """Choose a rung, and compare it with the reference and with all that would have done.

    Parameters
    ----------
    scene, parameters
        See `random_scene`.
    tolerance_px : float
    rng : numpy.random.Generator
        Draws the columns that are compared.
    clock : callable, optional
        Tells the time in s.  None: the cost is left out, and the cheapest is not looked for.
    """
    try:
        rung = choose(scene, tolerance_px)
    except InputError as told:
        return Trial(parameters, tolerance_px, None, failure=str(told))
    middle = np.concatenate([[0.0, 1.0], rng.random(_GROUPS - 2)])
    truth = _reference(scene, middle)
    chosen = scene_on(scene, rung.transport, rung.step_mm, rung.table_px)
    columns = _columns(truth)
    error = largest_error(line_of(chosen, columns, rung.spp), truth)
    result = Trial(parameters, tolerance_px, rung, error)
    if clock is None:
        return result
    others = {
        f"{tried.transport.name}, {tried.transport.march.step_mm:g} mm, {spp} spp": (tried, spp)
        for tried, spp in _that_would_do(scene, truth, tolerance_px)
    }
    seconds = _seconds([(chosen, rung.spp), *others.values()], clock)
    if not others:
        return replace(result, seconds=seconds[0])
    best = int(np.argmin(seconds[1:]))
    return replace(
        result,
        seconds=seconds[0],
        cheapest=list(others)[best],
        cheapest_seconds=seconds[1 + best],
    )


def _sigma_px(drawn: dict[str, Any]) -> float:
    """About how wide the line is in the image, across, in standard deviations."""
    seen, lit = (np.cos(np.radians(angle)) for angle in (_TILT_DEG + drawn["alpha"], _TILT_DEG))
    return float(drawn["line_radius"] / 2.0 * seen / lit / _FIELD_OF_VIEW_MM * drawn["width"])


def _reference(scene: Scene, middle: Array) -> TrueLine:
    """The line by marched rays in float64, in some columns."""
    column = groups(whole_columns(search_line(scene)), middle)
    best = scene.with_transport(Transport("marched", _REFERENCE, 1.0))
    return TrueLine.of_rows(line_of(best, column, _REFERENCE_SPP).row)


def _columns(truth: TrueLine) -> Index:
    """The columns that have a true centre, and some beside them."""
    return np.unique(truth.columns()[:, None] + np.arange(-_BESIDE, _BESIDE + 1))


def _that_would_do(scene: Scene, truth: TrueLine, tolerance_px: float) -> list[tuple[Scene, int]]:
    """Rungs that keep the tolerance, none of which has both shorter steps and more samples."""

    def fewest(tried: Scene, choices: tuple[int, ...]) -> int | None:
        for spp in choices:
            if largest_error(line_of(tried, columns, spp), truth) <= tolerance_px:
                return spp
        return None

    columns = _columns(truth)
    straight = scene_on(scene, "straight", STEPS_MM[0], tolerance_px)
    if spp := fewest(straight, SAMPLES):
        return [(straight, spp)]
    found: list[tuple[Scene, int]] = []
    choices: tuple[int, ...] = SAMPLES
    for step in STEPS_MM:
        tried = scene_on(scene, "tabulated", step, tolerance_px)
        if spp := fewest(tried, choices):
            found.append((tried, spp))
            choices = tuple(s for s in SAMPLES if s < spp)
        if not choices:
            break
    return found


def _seconds(rungs: list[tuple[Scene, int]], clock: Callable[[], float]) -> list[float]:
    """Median times of whole frames, warm; taken in turn, so that all suffer from the same load."""
    taken: list[list[float]] = [[] for _ in rungs]
    for run in range(_RUNS + 1):
        for (scene, spp), times in zip(rungs, taken, strict=True):
            dr.sync_thread()
            began = clock()
            render_uncached(scene, spp)
            dr.sync_thread()
            if run:
                times.append(clock() - began)
    return [median(times) for times in taken]
