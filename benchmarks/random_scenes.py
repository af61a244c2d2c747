"""Does `--tolerance` keep its promise?  Random scenes against a float64 reference."""

import argparse
import csv
import sys
import time
from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace
from pathlib import Path
from statistics import median
from typing import Any

import numpy as np
from numpy.typing import NDArray

from virtual_sensor.engine import dr
from virtual_sensor.errors import InputError
from virtual_sensor.files import written_whole
from virtual_sensor.imaging.checks import check_scene
from virtual_sensor.imaging.render import render_uncached
from virtual_sensor.imaging.scene import Scene, load_scene
from virtual_sensor.metrology.truth import TrueLine
from virtual_sensor.optics.rays import March
from virtual_sensor.optics.transports import Transport
from virtual_sensor.studies.tolerance import (
    SAMPLES,
    STEPS_MM,
    Configuration,
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

EXAMPLES = """examples:
  python benchmarks/random_scenes.py
  python benchmarks/random_scenes.py --scenes 20 --seed 7 -o few
  python benchmarks/random_scenes.py --clock cpu     # on a machine that others use
  python benchmarks/random_scenes.py --clock none    # errors only, three times as fast
"""
CLOCKS = {"wall": time.perf_counter, "cpu": time.process_time, "none": None}

WITHIN = 0.99  # of the scenes have an error within the tolerance...
WORST = 3.0  # ...and none has one this many times as large
COST = 1.5  # no configuration takes so many times as long as the cheapest that would have done

TOLERANCES_PX = (0.003, 0.3)
NOISE_S = 0.02
"""Times that differ by less are taken for the same."""

_FIELD_OF_VIEW_MM = 45.056
_TILT_DEG = -30.0
_LEAST_SIGMA_PX = 0.55  # of the line; narrower ones have no centres, whatever the configuration
_REFERENCE = March(0.5, "leapfrog", "double")  # within 2e-6 px of RK4 by 0.25 mm
_REFERENCE_SPP = 25  # within 1e-4 px of 900
_BESIDE = 3  # columns: a centre is found beside others only
_GROUPS = 8  # of columns that the error is taken in: the line's ends, the others anywhere
_RUNS = 3


@dataclass(frozen=True)
class Check:
    """A tolerance asked of a scene, and what came of it.

    Attributes
    ----------
    parameters : dict
        Of the scene `hot_cylinder`.
    tolerance_px : float
    configuration : Configuration or None
        None if none was found.
    error_px : float
        The true one: the largest of the columns that have a centre in the reference and by the
        configuration; infinite if the configuration finds too few.
    seconds : float
        For a frame by the configuration.
    cheapest : str
        What of all that was tried keeps the tolerance in the least time; "" if nothing does.
    cheapest_seconds : float
    failure : str
        Why there is no configuration; "" if there is one.
    """

    parameters: dict[str, Any]
    tolerance_px: float
    configuration: Configuration | None
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
        """The configuration's time over that of the cheapest that would have done."""
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


def check(
    scene: Scene,
    parameters: dict[str, Any],
    tolerance_px: float,
    rng: np.random.Generator,
    clock: Callable[[], float] | None = time.perf_counter,
) -> Check:
    """Choose a configuration, and compare it with the reference and with all that would have done.

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
        configuration = choose(scene, tolerance_px)
    except InputError as error:
        return Check(parameters, tolerance_px, None, failure=str(error))
    middle = np.concatenate([[0.0, 1.0], rng.random(_GROUPS - 2)])
    truth = _reference(scene, middle)
    chosen = scene_on(scene, configuration.transport, configuration.step_mm, configuration.table_px)
    columns = _columns(truth)
    error = largest_error(line_of(chosen, columns, configuration.spp), truth)
    result = Check(parameters, tolerance_px, configuration, error)
    if clock is None:
        return result
    others = {
        f"{tried.transport.name}, {tried.transport.march.step_mm:g} mm, {spp} spp": (tried, spp)
        for tried, spp in _that_would_do(scene, truth, tolerance_px)
    }
    seconds = _seconds([(chosen, configuration.spp), *others.values()], clock)
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
    return TrueLine.of_rows(line_of(best, column, _REFERENCE_SPP).pixel[:, 1])


def _columns(truth: TrueLine) -> Index:
    """The columns that have a true centre, and some beside them."""
    return np.unique(truth.columns()[:, None] + np.arange(-_BESIDE, _BESIDE + 1))


def _that_would_do(scene: Scene, truth: TrueLine, tolerance_px: float) -> list[tuple[Scene, int]]:
    """What keeps the tolerance, none with both shorter steps and more samples than another."""

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


def _seconds(configurations: list[tuple[Scene, int]], clock: Callable[[], float]) -> list[float]:
    """Median times of whole frames, warm; taken in turn, so that all suffer from the same load."""
    taken: list[list[float]] = [[] for _ in configurations]
    for run in range(_RUNS + 1):
        for (scene, spp), times in zip(configurations, taken, strict=True):
            dr.sync_thread()
            began = clock()
            render_uncached(scene, spp)
            dr.sync_thread()
            if run:
                times.append(clock() - began)
    return [median(times) for times in taken]


def main(arguments: Sequence[str] | None = None) -> int:
    """Run it; the exit status is 1 if a bound does not hold."""
    parser = argparse.ArgumentParser(
        description=__doc__, epilog=EXAMPLES, formatter_class=argparse.RawDescriptionHelpFormatter
    )
    parser.add_argument("--scenes", type=int, default=200, help="how many (200)")
    parser.add_argument("--seed", type=int, default=0, help="of the draws (0)")
    parser.add_argument("--first", type=int, default=0, help="number of the first scene (0)")
    parser.add_argument(
        "--clock",
        choices=CLOCKS,
        default="wall",
        help="what a frame's cost is measured in (wall); none: costs are left out",
    )
    parser.add_argument(
        "-o",
        "--output",
        type=Path,
        default=Path("random_scenes"),
        help="folder for checks.csv and summary.txt (random_scenes)",
    )
    given = parser.parse_args(arguments)
    if given.scenes < 1:
        parser.error("--scenes must be at least 1")
    given.output.mkdir(parents=True, exist_ok=True)
    began, checks = time.perf_counter(), []
    for number in range(given.first, given.first + given.scenes):
        rng = np.random.default_rng((given.seed, number))  # a scene can be looked at by itself
        scene, parameters = random_scene(rng)
        done = check(scene, parameters, random_tolerance(rng), rng, CLOCKS[given.clock])
        checks.append(done)
        spent = time.perf_counter() - began
        left = spent / len(checks) * (given.scenes - len(checks))
        print(f"{number}: {_words(done)}; {left:.0f} s left", file=sys.stderr, flush=True)
        _write(given.output / "checks.csv", checks, given.first)
    words, hold = summary(checks)
    with written_whole(given.output / "summary.txt") as file:
        file.write_text(words + "\n", encoding="utf-8")
    print(words)
    return 0 if hold else 1


def summary(checks: list[Check]) -> tuple[str, bool]:
    """What came of all checks in words, and whether the bounds hold."""
    chosen = [t for t in checks if t.configuration]
    error = np.array([t.error_ratio for t in chosen])
    cost = np.array([t.cost_ratio for t in chosen if t.cheapest])
    within = float(np.mean(error <= 1.0)) if chosen else 0.0
    worst = float(error.max(initial=0.0))
    names = [t.configuration.transport for t in chosen if t.configuration]
    by_name = {name: names.count(name) for name in ("straight", "tabulated")}
    lines = [
        f"{len(checks)} scenes; {len(checks) - len(chosen)} without a configuration;"
        f" {', '.join(f'{count} {name}' for name, count in by_name.items())}",
        f"error within the tolerance: {100.0 * within:.1f} % of {len(chosen)};"
        f" largest {worst:.2f} times it; median {np.median(error):.2f}",
    ]
    hold = bool(chosen) and within >= WITHIN and worst <= WORST
    if cost.size:
        shares = "  ".join(f"{p} %: {np.percentile(cost, p):.2f}" for p in (50, 90, 95, 99, 100))
        lines.append(
            f"cost beside the cheapest that would have done ({cost.size} scenes; less than"
            f" {1e3 * NOISE_S:.0f} ms apart counts as the same): {shares};"
            f" over {COST}: {np.sum(cost > COST)}"
        )
        hold = hold and bool(cost.max() <= COST)
    return "\n".join([*lines, "all bounds hold" if hold else "a bound does NOT hold"]), hold


def _words(done: Check) -> str:
    if done.configuration is None:
        return f"{done.tolerance_px:g} px: {done.failure}"
    cost = f"; cost {done.cost_ratio:.2f} times that of {done.cheapest}" if done.cheapest else ""
    miss = "" if done.error_ratio <= 1.0 else " MISSED"
    found = f"{done.error_ratio:.2f} of it{miss}, by {done.configuration}"
    return f"{done.tolerance_px:g} px: {found}{cost}"


def _write(path: Path, checks: list[Check], first: int) -> None:
    """A row per scene."""
    with written_whole(path) as part, part.open("w", newline="", encoding="utf-8") as file:
        rows = csv.DictWriter(file, list(_row(0, checks[0])))
        rows.writeheader()
        rows.writerows(_row(number, done) for number, done in enumerate(checks, first))


def _row(number: int, done: Check) -> dict[str, Any]:
    used = done.configuration
    return {
        "scene": number,
        **done.parameters,
        "tolerance_px": done.tolerance_px,
        "transport": used.transport if used else "",
        "step_mm": used.step_mm if used else "",
        "spp": used.spp if used else "",
        "estimate_px": used.error_px if used else "",
        "estimates": "; ".join(f"{k} {v:.3g}" for k, v in used.estimate_px.items()) if used else "",
        "error_px": done.error_px,
        "error_ratio": done.error_ratio,
        "seconds": done.seconds,
        "cheapest": done.cheapest,
        "cheapest_seconds": done.cheapest_seconds,
        "cost_ratio": done.cost_ratio,
        "failure": done.failure,
    }


if __name__ == "__main__":
    sys.exit(main())
