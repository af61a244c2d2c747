"""Panel "bounces": the line's centres where a shiny part lights itself, by bounces and samples.

What reflections leave out, or make noisy, moves the line's centres: each frame is judged beside the
line's own light, so that a ghost beside it in a column counts for nothing, in columns whose line
stands out of the ghost beneath.
"""

from __future__ import annotations

from collections.abc import Callable, Iterator
from functools import partial
from typing import Any

import numpy as np
from numpy.typing import NDArray

from virtual_sensor.imaging.layers import stands_out
from virtual_sensor.imaging.render import DIRECT, lit_pixels, render
from virtual_sensor.imaging.scene import Scene, load_scene
from virtual_sensor.metrology.line_peaks import line_centres
from virtual_sensor.metrology.triangulation import error_um
from virtual_sensor.metrology.truth import TrueLine, compare_line
from virtual_sensor.studies.chart.benchmark import Configuration, Score, Task

Image = NDArray[np.float32]
Settings = dict[str, Any]

SCENE = "v_groove"
MATERIAL: Settings = {"material": "ground_steel", "roughness": 0.2}
FILM: Settings = {"width": 512, "height": 512, "spp": 4, "line_radius": 0.4}
QUICK_FILM: Settings = {"width": 192, "height": 192, "spp": 4, "line_radius": 0.4}

BOUNCES, QUICK_BOUNCES = (0, 1, 2, 3), (0, 1)
SAMPLES, QUICK_SAMPLES = (1, 4, 16), (4,)
"""Points of the lit stripe for each sample of a pixel's indirect light."""

_BEST, _QUICK_BEST = (3, 16, 6), (1, 64, 4)  # bounces, such points, and frames of which the mean is
_LOST = 0.1  # a frame that loses this share of the columns has failed


def tasks(quick: bool = False) -> Iterator[Task]:
    """A frame of a V-groove in ground steel."""
    film = QUICK_FILM if quick else FILM
    load = partial(load_scene, SCENE, **film, **MATERIAL)
    bounces, samples, frames = best = _QUICK_BEST if quick else _BEST
    direct, near, truth = reference(load, *best)
    words = f"{bounces} bounces, {samples} points of the stripe, mean of {frames} frames"
    of_material = " ".join(f"{value}" for value in MATERIAL.values()).replace("_", " ")
    yield Task(
        f"a V-groove of {of_material}, {film['width']} x {film['height']} px",
        words,
        1,
        partial(_score, direct, near, truth),
        list(
            _configurations(load, *(QUICK_BOUNCES, QUICK_SAMPLES) if quick else (BOUNCES, SAMPLES))
        ),
    )


def reference(
    load: Callable[..., Scene], bounces: int, samples: int, frames: int
) -> tuple[Scene, NDArray[np.bool_], TrueLine]:
    """The scene of direct light, pixels near its line, and the line's true rows.

    By the mean of frames of so many bounces, and points of the stripe for each sample.
    """
    best = load(max_depth=DIRECT + bounces, indirect_samples=samples)
    direct = load(max_depth=DIRECT)
    near = near_line(direct)
    mean = np.mean([render(best, seed=1 + number) for number in range(frames)], axis=0) * near
    line = render(direct) * near
    clear = stands_out(line, mean - line)
    return direct, near, TrueLine.of_rows(np.where(clear, line_centres(mean).row, np.nan))


def near_line(scene: Scene) -> NDArray[np.bool_]:
    """Pixels (H, W) that a scene's sources light directly, or may."""
    width, height = scene.camera.size
    near = np.zeros(height * width, bool)
    near[lit_pixels(scene).index] = True
    return near.reshape(height, width)


def _configurations(
    load: Callable[..., Scene], bounces: tuple[int, ...], samples: tuple[int, ...]
) -> Iterator[Configuration]:
    for number in bounces:
        for points in samples if number else samples[:1]:
            scene = {"max_depth": DIRECT + number, "indirect_samples": points}
            chosen = {"bounces": number, "indirect_samples": points} if number else {}
            yield Configuration(
                "bounced" if number else "direct_light",
                "tabulated",
                partial(_rendering, partial(load, **scene)),
                chosen,
                MATERIAL,
            )


def _rendering(load: Callable[[], Scene]) -> Callable[[], Image]:
    return partial(render, load())


def _score(scene: Scene, near: NDArray[np.bool_], truth: TrueLine, image: Image) -> Score:
    """Errors of the centres; a frame that loses too many of them has failed."""
    errors = compare_line(line_centres(image * near), truth)
    lost, columns = errors.lost.size, errors.expected
    note = f"{lost} of {columns} columns lost" if lost else ""
    um = error_um(scene.sensor, errors)
    return Score(errors.error_px, um, int(lost > _LOST * columns), note)
