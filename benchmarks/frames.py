"""Frames: ours through hot air beside the stock `direct` integrator's without any.

By itself, `python benchmarks/frames.py`, it prints their ratios, with no marched frames; then what
the frames of a sequence of fringes cost beside one.
"""

from __future__ import annotations

import argparse
import itertools
import time
from collections.abc import Callable, Iterator
from dataclasses import dataclass
from functools import partial
from typing import Any

import numpy as np

from virtual_sensor.devices.patterns import Sine
from virtual_sensor.engine import dr
from virtual_sensor.imaging.render import render, render_frame, render_uncached
from virtual_sensor.imaging.scene import Scene, load_scene
from virtual_sensor.imaging.sequence import render_sequence
from virtual_sensor.studies.chart.frames import SCENE, frame_direct, with_lamp

STOCK = "stock direct, cold"

# Marched rays to every pixel of a lit scene take minutes a frame, and tell nothing of speed.
LIGHTS: dict[str, tuple[Callable[..., Scene], tuple[str, ...]]] = {
    "laser only": (partial(load_scene, SCENE), ("tabulated", "marched")),
    "whole scene": (with_lamp, ("tabulated",)),
}


@dataclass(frozen=True)
class FrameRow:
    """One kind of frame: seconds (wall and processor), and how many times the stock one's."""

    light: str
    renderer: str
    seconds: float
    cpu_s: float
    times_stock: float


def measured(film_px: int, spp: int, runs: int, marched: bool = True) -> Iterator[FrameRow]:
    """The stock frame and ours, under the laser alone and with the whole scene lit.

    They are taken in turn, so that all suffer from the same load; least times count.
    """
    size = {"width": film_px, "height": film_px, "spp": spp}
    seeds = itertools.count()
    for light, (load, transports) in LIGHTS.items():
        scenes = {name: load(transport=name, **size) for name in transports}
        scene = scenes["tabulated"]
        frames: dict[str, Callable[[], Any]] = {STOCK: partial(frame_direct, scene)}
        for name in transports if marched else ("tabulated",):
            frames[f"ours, hot, {name}"] = partial(render_uncached, scenes[name])
        again = "ours, hot, tabulated, same scene, another seed"
        frames[again] = lambda scene=scene: render_frame(scene, seed=next(seeds))
        seconds = _timed(frames, runs)
        for renderer, (wall, cpu) in seconds.items():
            yield FrameRow(light, renderer, wall, cpu, wall / seconds[STOCK][0])


def of_sequence(film_px: int, spp: int, runs: int, count: int = 12) -> dict[str, float]:
    """Processor seconds, cold and hot, of so many frames of fringes over those of one."""
    scene = load_scene("fringe_cylinder", width=film_px, height=film_px, spp=spp)
    patterns = [Sine("u", 16.0, 2.0 * np.pi * k / count) for k in range(count)]
    ratios = {}
    for state, each in {"cold": scene.cold(), "hot": scene}.items():
        frames = {"one": partial(render, each), "all": partial(render_sequence, each, patterns)}
        seconds = _timed(frames, runs)
        ratios[state] = seconds["all"][1] / seconds["one"][1]
    return ratios


def _timed(frames: dict[str, Callable[[], Any]], runs: int) -> dict[str, tuple[float, float]]:
    """Least wall and processor time of each, s, after one that warms up."""
    walls: dict[str, list[float]] = {name: [] for name in frames}
    cpus: dict[str, list[float]] = {name: [] for name in frames}
    for number in range(runs + 1):
        for name, frame in frames.items():
            wall, cpu = time.perf_counter(), time.process_time()
            frame()
            dr.sync_thread()
            if number:
                walls[name].append(time.perf_counter() - wall)
                cpus[name].append(time.process_time() - cpu)
    return {name: (float(np.min(walls[name])), float(np.min(cpus[name]))) for name in frames}


if __name__ == "__main__":
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--film", type=int, default=2048, help="px")
    parser.add_argument("--spp", type=int, default=16, help="samples a pixel")
    parser.add_argument("--runs", type=int, default=5)
    asked = parser.parse_args()
    for row in measured(asked.film, asked.spp, asked.runs, marched=False):
        print(
            f"{row.light:12s} {row.renderer:48s} {1e3 * row.seconds:6.0f} ms,"
            f" {1e3 * row.cpu_s:6.0f} of processors; {row.times_stock:.3f} times stock"
        )
    for state, times in of_sequence(asked.film, asked.spp, asked.runs).items():
        print(f"12 frames of fringes, {state}: {times:.2f} times one")
