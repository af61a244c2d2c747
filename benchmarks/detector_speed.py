"""How many profiles of 2048 columns x 32 rows each detector takes in a second, on all cores.

python benchmarks/detector_speed.py            a minute; leave the machine idle meanwhile

Each core works at profiles of its own, as of a sensor's stream; the best of some rounds.
"""

import os
import sys
import time
from multiprocessing import get_context

import cv2
import numpy as np
from threadpoolctl import threadpool_limits

from virtual_sensor.metrology import line_fits
from virtual_sensor.metrology.detectors import COLUMNWISE
from virtual_sensor.metrology.drawn_lines import line_shares
from virtual_sensor.metrology.line_peaks import line_centres

COLUMNS, ROWS, WIDTH_PX, PEAK = 2048, 32, 2.0, 180.0
ROUNDS = 5


def profiles_per_second(method: str) -> float:
    """Of one core, in one round."""
    cv2.setNumThreads(1)
    rng = np.random.default_rng(0)
    shares, _ = line_shares(rng.uniform(14.0, 18.0, COLUMNS), WIDTH_PX, ROWS)
    mean = PEAK * np.sqrt(2.0 * np.pi) * WIDTH_PX * shares
    image = np.clip(rng.poisson(mean + 5.0), 0, 255).astype(np.uint8)
    count = 20 if COLUMNWISE[method].__module__ == line_fits.__name__ else 60
    with threadpool_limits(1):
        line_centres(image, method)
        began = time.perf_counter()
        for _ in range(count):
            line_centres(image, method)
        return count / (time.perf_counter() - began)


def main() -> int:
    """Measure and print a table."""
    cores = len(os.sched_getaffinity(0))
    print(f"| detector | profiles a second, {cores} cores | of one |\n|---|---|---|")
    with get_context("spawn").Pool(cores) as pool:
        pool.map(profiles_per_second, ["parabola"] * cores, chunksize=1)
        for method in COLUMNWISE:
            rounds = [
                sum(pool.map(profiles_per_second, [method] * cores, chunksize=1))
                for _ in range(ROUNDS)
            ]
            alone = max(pool.apply(profiles_per_second, (method,)) for _ in range(ROUNDS))
            print(f"| {method} | {max(rounds):.0f} | {alone:.0f} |", flush=True)
    return 0


if __name__ == "__main__":
    sys.exit(main())
