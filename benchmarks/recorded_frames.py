"""What a recorded frame costs: lens, speckle, noise; and how long each part of it takes.

By itself, `python benchmarks/recorded_frames.py`, it prints the seconds of frames of the hot
cylinder through a lens, of their speckle and of their grey values, after one that warms up.
"""

from __future__ import annotations

import argparse
import time
from collections.abc import Callable
from typing import Any

import numpy as np

from virtual_sensor.engine import dr
from virtual_sensor.imaging.grey_values import grey_values
from virtual_sensor.imaging.recording import aperture_of, record, sensor_of
from virtual_sensor.imaging.render import render_frame
from virtual_sensor.imaging.scene import load_scene
from virtual_sensor.imaging.speckle import speckled

SCENE = "hot_cylinder"
SURFACE = {"linewidth": 2, "rq": 30, "polarisations": 2, "modes": 2}
"""Of frames like real ones: ten patterns add."""


Times = tuple[float, float]


def measured(film_px: int, f_number: float, runs: int) -> dict[str, Times]:
    """Least wall and processor time of each part, s, and of all: a frame and its recording."""
    size = {"width": film_px, "height": film_px, "pixel": 5.5}
    pinhole = load_scene(SCENE, **size)
    scene = load_scene(SCENE, **size, f_number=f_number, **SURFACE)
    begun = time.perf_counter(), time.process_time()
    frame = render_frame(scene)
    first = time.perf_counter() - begun[0], time.process_time() - begun[1]
    sensor = sensor_of(scene, "cmos_5um5")
    aperture = aperture_of(scene, frame, sensor, True)
    light = 8000.0 * frame.radiance / frame.radiance.max()

    def recorded(seed: int) -> None:
        record(scene, render_frame(scene, seed=seed), seed, sensor=sensor, speckle=True)

    parts: dict[str, Callable[[int], Any]] = {
        "pinhole frame": lambda seed: render_frame(pinhole, seed=seed),
        "frame through the lens": lambda seed: render_frame(scene, seed=seed),
        f"speckle of {aperture.patterns:.3g} patterns": lambda seed: speckled(
            frame.radiance, aperture, seed
        ),
        "grey values": lambda seed: grey_values(light, sensor, seed),
        "recorded frame, all together": recorded,
    }
    return {"first frame through the lens": first} | {
        name: _least_s(part, runs) for name, part in parts.items()
    }


def _least_s(part: Callable[[int], Any], runs: int) -> Times:
    """Wall and processor time, each the least, after one that warms up."""
    walls, cpus = [], []
    for seed in range(runs + 1):
        wall, cpu = time.perf_counter(), time.process_time()
        part(seed)
        dr.sync_thread()
        walls.append(time.perf_counter() - wall)
        cpus.append(time.process_time() - cpu)
    return float(np.min(walls[1:])), float(np.min(cpus[1:]))


if __name__ == "__main__":
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--film", type=int, nargs="+", default=[1024, 2048], help="px")
    parser.add_argument("--f-number", type=float, default=16.0)
    parser.add_argument("--runs", type=int, default=4)
    asked = parser.parse_args()
    for film_px in asked.film:
        for name, (wall, cpu) in measured(film_px, asked.f_number, asked.runs).items():
            print(
                f"{film_px} px, f/{asked.f_number:g}: {name:32s} {1e3 * wall:6.0f} ms,"
                f" {1e3 * cpu:6.0f} of processors"
            )
