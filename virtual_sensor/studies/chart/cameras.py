"""Panel "camera": the line's centres through a lens, as light and as it is recorded.

The first task shows how many sub-pupils a lens needs; the others what is left of their accuracy
behind a sensor's noise, and in speckle: the same frames, recorded, against the same truth.
"""

from __future__ import annotations

import math
from collections.abc import Callable, Iterator
from functools import partial
from typing import Any

import numpy as np
from numpy.typing import NDArray

from virtual_sensor.devices.image_sensor import image_sensor
from virtual_sensor.imaging.recording import RecordedFrame, record
from virtual_sensor.imaging.render import render, render_frame, render_uncached
from virtual_sensor.imaging.scene import Scene, load_scene
from virtual_sensor.metrology.line_peaks import line_centres
from virtual_sensor.metrology.triangulation import error_um
from virtual_sensor.metrology.truth import TrueLine, compare_line, rms
from virtual_sensor.studies.chart.benchmark import Configuration, Score, Task
from virtual_sensor.studies.chart.frames import line_in_windows

Image = NDArray[np.float32]
Load = Callable[..., Scene]
Pupils = tuple[tuple[int, int], ...]
Settings = dict[str, Any]

SCENE = "hot_cylinder"
LENS = {"f_number": 8}
SENSOR = "cmos_5um5"
DIODE: Settings = {"linewidth": 2, "rq": 30, "polarisations": 2, "modes": 2.25}
"""A laser and a surface whose speckle is as real frames have it."""

FILM: Settings = {"width": 2048, "height": 2048}
QUICK_FILM: Settings = {"width": 512, "height": 512, "line_radius": 0.3}
SUB_PUPILS = (4, 1), (9, 1), (16, 1), (16, 4), (36, 4), (64, 4)
"""Of the lens's pupil, and samples of a pixel through each."""
QUICK_SUB_PUPILS = (4, 1), (16, 4)

_FROM_ENDS_PX = 24  # the last columns hold the end of the line, blurred along it
_BEST, _QUICK_BEST = (256, 4), (64, 4)
# A frame that loses this share of the columns has failed; the line's ends are out of focus.
_LOST, _LOST_IN_NOISE = 0.1, 0.5


def tasks(quick: bool = False) -> Iterator[Task]:
    """A frame through a lens, and the same recorded: with noise, and with speckle too."""
    film, chosen = (QUICK_FILM, QUICK_SUB_PUPILS) if quick else (FILM, SUB_PUPILS)
    best = _QUICK_BEST if quick else _BEST
    load = partial(load_scene, SCENE, **film)
    scene = load(**_settings(*best), transport="marched")
    score = partial(_score, scene, line_in_windows(scene, math.prod(best), _FROM_ENDS_PX))
    lens = f"f/{LENS['f_number']:g}, {film['width']} x {film['height']} px"
    words = f"marched rays, {best[0]} sub-pupils, {best[1]} samples of a pixel through each"
    for name, configurations in (
        ("a frame through a lens", _ideal(load, chosen)),
        ("a frame with a sensor's noise", _recorded(load, chosen, speckle=False)),
        ("a frame with noise and speckle", _recorded(load, chosen, speckle=True)),
    ):
        yield Task(f"{name}, {lens}", words, 1, score, list(configurations))


def _settings(sub_pupils: int, each: int) -> Settings:
    """The scene's parameters: a lens, and so many samples of a pixel through each sub-pupil."""
    return LENS | {"sub_pupils": sub_pupils, "spp": sub_pupils * each}


def _ideal(load: Load, pupils: Pupils) -> Iterator[Configuration]:
    """Light alone: the pinhole in the lens's place, maps that are kept or made anew, marches."""
    yield Configuration(
        "pinhole",
        "tabulated",
        partial(_rendering, render, partial(load, spp=16)),
        {"samples_per_pixel": 16},
        note=lambda: "a pupil of no width",
    )
    for each in pupils:
        for name, by in (("new_maps", render_uncached), ("cached_maps", render)):
            through = partial(load, **_settings(*each))
            yield Configuration(
                name, "tabulated", partial(_rendering, by, through), _chosen(*each), LENS
            )
    for each in pupils[:1]:
        through = partial(load, **_settings(*each), transport="marched")
        prepare = partial(_rendering, render_uncached, through)
        yield Configuration("marched", "marched", prepare, _chosen(*each), LENS)


def _chosen(sub_pupils: int, each: int) -> Settings:
    return {"sub_pupils": sub_pupils, "samples_per_pixel": sub_pupils * each}


def _rendering(by: Callable[[Scene], Image], load: Load) -> Callable[[], Image]:
    return partial(by, load())


def _recorded(load: Load, pupils: Pupils, speckle: bool) -> Iterator[Configuration]:
    """Frames as they are stored, the maps kept."""
    for each in pupils:
        through = partial(load, **_settings(*each), **DIODE)
        used = LENS | {"sensor_model": SENSOR} | (DIODE if speckle else {})
        yield Configuration(
            "recorded", "tabulated", partial(_recording, through, speckle), _chosen(*each), used
        )


def _recording(load: Load, speckle: bool) -> Callable[[], RecordedFrame]:
    scene, sensor = load(), image_sensor(SENSOR)

    def work() -> RecordedFrame:
        return record(scene, render_frame(scene), sensor=sensor, speckle=speckle)

    return work


def _score(scene: Scene, truth: TrueLine, image: Image | RecordedFrame) -> Score:
    """Errors of the centres; a frame that loses too many of them has failed."""
    line = line_centres(image)
    errors = compare_line(line, truth)
    lost, columns = errors.lost.size, errors.expected
    notes = [f"{lost} of {columns} columns lost"] if lost else []
    recorded = isinstance(image, RecordedFrame)
    if recorded:
        notes.append(f"predicts {rms(errors.sigma):.2g} px")
    share = _LOST_IN_NOISE if recorded else _LOST
    um = error_um(scene.sensor, errors)
    return Score(errors.error_px, um, int(lost > share * columns), "; ".join(notes))
