"""Does `tolerance` keep what it promises?  Random scenes against a float64 reference."""

import argparse
import csv
import sys
import time
from collections.abc import Sequence
from pathlib import Path
from typing import Any

import numpy as np

from virtual_sensor.files import written_whole
from virtual_sensor.studies.chart.trials import (
    NOISE_S,
    Trial,
    random_scene,
    random_tolerance,
    trial,
)

EXAMPLES = """examples:
  python benchmarks/random_scenes.py
  python benchmarks/random_scenes.py --scenes 20 --seed 7 -o few
  python benchmarks/random_scenes.py --clock cpu     # on a machine that others use
  python benchmarks/random_scenes.py --clock none    # errors only, three times as fast
"""
CLOCKS = {"wall": time.perf_counter, "cpu": time.process_time, "none": None}

KEPT = 0.99  # of the scenes have an error within the tolerance...
WORST = 3.0  # ...and none has one this many times as large
COST = 1.5  # no rung takes so many times as long as the cheapest that would have done


def main(arguments: Sequence[str] | None = None) -> int:
    """Run it; the exit status is 1 if a bound is not kept."""
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
        help="folder for trials.csv and summary.txt (random_scenes)",
    )
    given = parser.parse_args(arguments)
    if given.scenes < 1:
        parser.error("--scenes must be at least 1")
    given.output.mkdir(parents=True, exist_ok=True)
    began, trials = time.perf_counter(), []
    for number in range(given.first, given.first + given.scenes):
        rng = np.random.default_rng((given.seed, number))  # a scene can be looked at by itself
        scene, parameters = random_scene(rng)
        done = trial(scene, parameters, random_tolerance(rng), rng, CLOCKS[given.clock])
        trials.append(done)
        spent = time.perf_counter() - began
        left = spent / len(trials) * (given.scenes - len(trials))
        print(f"{number}: {_words(done)}; {left:.0f} s left", file=sys.stderr, flush=True)
        _write(given.output / "trials.csv", trials, given.first)
    told, kept = summary(trials)
    with written_whole(given.output / "summary.txt") as file:
        file.write_text(told + "\n", encoding="utf-8")
    print(told)
    return 0 if kept else 1


def summary(trials: list[Trial]) -> tuple[str, bool]:
    """What came of all trials in words, and whether the bounds are kept."""
    chosen = [t for t in trials if t.rung]
    error = np.array([t.error_ratio for t in chosen])
    cost = np.array([t.cost_ratio for t in chosen if t.cheapest])
    within = float(np.mean(error <= 1.0)) if chosen else 0.0
    worst = float(error.max(initial=0.0))
    by_name = {n: sum(t.rung.transport == n for t in chosen) for n in ("straight", "tabulated")}
    lines = [
        f"{len(trials)} scenes; {len(trials) - len(chosen)} without a rung;"
        f" {', '.join(f'{count} {name}' for name, count in by_name.items())}",
        f"error within the tolerance: {100.0 * within:.1f} % of {len(chosen)};"
        f" largest {worst:.2f} times it; median {np.median(error):.2f}",
    ]
    kept = bool(chosen) and within >= KEPT and worst <= WORST
    if cost.size:
        shares = "  ".join(f"{p} %: {np.percentile(cost, p):.2f}" for p in (50, 90, 95, 99, 100))
        lines.append(
            f"cost beside the cheapest that would have done ({cost.size} scenes; less than"
            f" {1e3 * NOISE_S:.0f} ms apart counts as the same): {shares};"
            f" over {COST}: {np.sum(cost > COST)}"
        )
        kept = kept and bool(cost.max() <= COST)
    return "\n".join([*lines, "all bounds are kept" if kept else "a bound is NOT kept"]), kept


def _words(done: Trial) -> str:
    if done.rung is None:
        return f"{done.tolerance_px:g} px: {done.failure}"
    cost = f"; cost {done.cost_ratio:.2f} times that of {done.cheapest}" if done.cheapest else ""
    miss = "" if done.error_ratio <= 1.0 else " MISSED"
    return f"{done.tolerance_px:g} px: {done.error_ratio:.2f} of it{miss}, by {done.rung}{cost}"


def _write(path: Path, trials: list[Trial], first: int) -> None:
    """A row per scene."""
    with written_whole(path) as part, part.open("w", newline="", encoding="utf-8") as file:
        rows = csv.DictWriter(file, list(_row(0, trials[0])))
        rows.writeheader()
        rows.writerows(_row(number, done) for number, done in enumerate(trials, first))


def _row(number: int, done: Trial) -> dict[str, Any]:
    rung = done.rung
    return {
        "scene": number,
        **done.parameters,
        "tolerance_px": done.tolerance_px,
        "transport": rung.transport if rung else "",
        "step_mm": rung.step_mm if rung else "",
        "spp": rung.spp if rung else "",
        "estimate_px": rung.error_px if rung else "",
        "estimates": "; ".join(f"{k} {v:.3g}" for k, v in rung.estimate_px.items()) if rung else "",
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
