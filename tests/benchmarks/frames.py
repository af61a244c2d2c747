"""Frames: ours through hot air beside the stock `direct` integrator's without any."""

from __future__ import annotations

from collections.abc import Callable, Iterator
from dataclasses import dataclass
from functools import partial
from typing import Any

import numpy as np
from problem import timed

from virtual_sensor.engine import dr
from virtual_sensor.imaging.render import frame_anew
from virtual_sensor.imaging.scene import Scene, load_scene
from virtual_sensor.studies.chart.frames import SCENE, frame_direct, with_lamp

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


def measured(film_px: int, spp: int, runs: int) -> Iterator[FrameRow]:
    """The stock frame, then ours, under the laser alone and with the whole scene lit."""
    size = {"width": film_px, "height": film_px, "spp": spp}
    for light, (load, transports) in LIGHTS.items():
        stock, cpu = _timed(partial(frame_direct, load(**size)), runs)
        yield FrameRow(light, "stock direct, cold", stock, cpu, 1.0)
        for name in transports:
            seconds, cpu = _timed(partial(frame_anew, load(transport=name, **size)), runs)
            yield FrameRow(light, f"ours, hot, {name}", seconds, cpu, seconds / stock)


def _timed(frame: Callable[[], Any], runs: int) -> tuple[float, float]:
    def work() -> None:
        np.asarray(frame())
        dr.sync_thread()

    return timed(work, runs)
