"""How time and memory grow: with the samples of a pixel, and with the nodes of the field."""

from __future__ import annotations

import os
import subprocess
import sys
from collections import defaultdict
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from functools import partial
from pathlib import Path

import numpy as np
from scipy.ndimage import zoom

from virtual_sensor import engine
from virtual_sensor.imaging.render import render_uncached
from virtual_sensor.imaging.scene import load_scene
from virtual_sensor.medium.index_field import IndexField
from virtual_sensor.records import Record
from virtual_sensor.studies.chart.benchmark import Measured, Report, timed
from virtual_sensor.studies.chart.frames import FILM_PX, QUICK_FILM_PX, SCENE

TRANSPORTS = ("marched", "tabulated")
_MEMORY_SPP = 64

_MEMORY = """
import sys
from pathlib import Path
from virtual_sensor.imaging.render import render_frame
from virtual_sensor.imaging.scene import load_scene
name, film, spp = sys.argv[1:]
render_frame(load_scene(name, width=film, height=film, spp=spp))
status = Path("/proc/self/status")
if status.is_file():
    print(next(l.split()[1] for l in status.read_text().splitlines() if l.startswith("VmHWM:")))
else:
    import resource
    unit = 1024 if sys.platform == "darwin" else 1
    print(resource.getrusage(resource.RUSAGE_SELF).ru_maxrss / unit)
"""


@dataclass(frozen=True)
class Scaling(Record):
    """A time of some size of work, and how times grow with it.

    Attributes
    ----------
    name : str
        What is made, and what is varied.
    size : float
        How much of it.
    time_s : float
        How long it took.
    exponent : float
        Slope of log(time) over log(size) by least squares, the same for all sizes of a name; NaN of
        fewer than two sizes.
    note : str
        What else is to be known.
    """

    name: str
    size: float
    time_s: float
    exponent: float
    note: str = ""


def power(name: str, times_s: Mapping[float, float], note: str = "") -> list[Scaling]:
    """Fit a power law to times by their sizes."""
    exponent = np.nan
    if len(times_s) > 1:
        exponent = float(np.polyfit(np.log([*times_s]), np.log([*times_s.values()]), 1)[0])
    return [Scaling(name, size, seconds, exponent, note) for size, seconds in times_s.items()]


def by_samples(measured: Sequence[Measured]) -> list[Scaling]:
    """Time over samples per pixel, of frames that differ in nothing else.

    A part of it is the same for any number of samples, which a power law does not know: the note
    gives it, and what each sample costs, by a straight line.
    """
    groups: dict[tuple[str, str], dict[float, float]] = defaultdict(dict)
    for each in measured:
        if each.panel == "frames":
            same = {k: v for k, v in each.chosen.items() if k != "samples_per_pixel"}
            name = f"{each.name}: samples per pixel of {each.task}"
            groups[name, repr(same)][each.chosen["samples_per_pixel"]] = each.time_s
    found: list[Scaling] = []
    for (name, _), times in groups.items():
        if len(times) > 2:
            sizes, seconds = np.array([*times]), np.array([*times.values()])
            # Relative errors count alike: else the longest time alone would decide.
            slope, fixed = np.polyfit(sizes, seconds, 1, w=1.0 / seconds)
            off = np.abs((fixed + slope * sizes) / seconds - 1.0).max()
            note = (
                f"{fixed:.3g} s and {1e3 * slope:.3g} ms for each sample of a pixel,"
                f" within {100.0 * off:.0f} %"
            )
            found += power(name, times, note)
    return found


def resampled(field: IndexField, factor: int) -> IndexField:
    """The same air on a grid `factor` times finer, or, of a negative factor, coarser.

    Finer: by the cubic spline through the nodes; coarser: every so many-th node.
    """
    if factor < 0:
        nodes, spacing = field.nodes[(slice(None, None, -factor),) * 3], field.spacing * -factor
    else:
        finer = [(n - 1) * factor + 1 for n in field.shape]
        ratio = [new / old for new, old in zip(finer, field.shape, strict=True)]
        nodes, spacing = zoom(field.nodes, ratio, order=3, mode="nearest"), field.spacing / factor
    source = f"{field.source}, resampled by {factor}"
    return field.with_nodes(nodes, spacing_mm=spacing, source=source)


def by_field(report: Report, quick: bool = False) -> list[Scaling]:
    """Time of a frame over the nodes of the field: every 2nd node, all, and 8 times as many."""
    film = QUICK_FILM_PX if quick else FILM_PX
    factors = (-2, 1) if quick else (-2, 1, 2)
    found: list[Scaling] = []
    for number, name in enumerate(TRANSPORTS):
        scene = load_scene(SCENE, width=film, height=film, transport=name, spp=4)
        field = scene.field
        assert field is not None
        times = {}
        for i, factor in enumerate(factors):
            done = (number + i / len(factors)) / len(TRANSPORTS)
            report(f"{name} frames in finer and coarser fields", done)
            air = resampled(field, factor)
            work = partial(render_uncached, scene.with_medium(air))
            work()
            times[float(np.prod(air.shape))] = timed(work, 1 if quick else 3)[0]
        found += power(f"{name}: nodes of the field", times, "frames of 4 samples per pixel")
    return found


def frame_memory_mb(quick: bool = False) -> float:
    """Peak memory, MB, of a process that renders one frame."""
    film, spp = (QUICK_FILM_PX, 4) if quick else (FILM_PX, _MEMORY_SPP)
    return peak_memory_mb(film, spp)


def peak_memory_mb(film_px: int, spp: int) -> float:
    """Most memory, MB, that a process of its own ever holds to render one frame; NaN if unknown.

    Linux's own record of the process is asked: `getrusage` gives the parent's, too.
    """
    ended = subprocess.run(
        [sys.executable, "-c", _MEMORY, SCENE, str(film_px), str(spp)],
        env=os.environ | {"VIRTUAL_SENSOR_VARIANT": engine.activate().variant},
        cwd=Path.cwd(),
        capture_output=True,
        text=True,
    )
    return float(ended.stdout) * 1024e-6 if ended.returncode == 0 else np.nan
