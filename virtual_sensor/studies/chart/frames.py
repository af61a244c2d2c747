"""Panel "frames": the line's centres in rendered frames, against the time that a frame takes."""

from __future__ import annotations

import time
from collections.abc import Callable, Iterator
from dataclasses import dataclass
from functools import partial
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from virtual_sensor.engine import dr, mi
from virtual_sensor.files import scratch_folder
from virtual_sensor.imaging.render import render_columns, render_uncached
from virtual_sensor.imaging.scene import Scene, find_scene, load_scene
from virtual_sensor.metrology.centres import Status
from virtual_sensor.metrology.line_peaks import line_centres
from virtual_sensor.metrology.triangulation import error_um
from virtual_sensor.metrology.truth import TrueLine, compare_line, rms
from virtual_sensor.optics.ray_search import ray_search
from virtual_sensor.studies.chart.rung import Report, Rung, timed

Array = NDArray[np.float64]
Settings = dict[str, Any]

SCENE = "hot_cylinder"
FILM_PX, QUICK_FILM_PX = 2048, 512
DIRECT = "stock direct, cold"
LAMP = "laser and lamp"

_SPP = (1, 4, 9, 16, 64)
_RUNS, _LONG_RUNS = 5, 3  # of which the median is told; frames of over 1 s are long
_END_PX, _INNER_PX = 16, 10  # columns of the reference's windows, at the line's ends and between
_CUT_PX = 2  # columns beside a window's cut are taken for a line's end
_LOST = 0.02  # a frame that loses this share of the columns has failed
_LAMP = (  # so faint that it moves no line, and costs what any lamp does
    '<emitter type="point"><point name="position" x="0" y="0" z="300"/>'
    '<spectrum name="intensity" value="0.1"/></emitter>'
)


@dataclass(frozen=True)
class Reference:
    """The line's centres as they should be, in some columns.

    Attributes
    ----------
    scene : Scene
        That they were rendered from.
    line : TrueLine
    words : str
        How they were made.
    """

    scene: Scene
    line: TrueLine
    words: str


def reference(film_px: int, spp: int = 64, step_mm: float = 1.0, **settings: Any) -> Reference:
    """Render the line in float64 by marched rays, in windows at its ends and between.

    The whole line would take minutes, and shows no more than these windows do.
    """
    best = {"transport": "marched", "method": "rk4", "precision": "double", "step": step_mm}
    scene = load_scene(SCENE, width=film_px, height=film_px, spp=spp, **(best | settings))
    half = 0.5 * scene.sensor.laser.length_mm
    seen = ray_search(scene, [-half, half], "newton").pixel[:, 0]
    first, last = int(np.floor(seen.min())), int(np.ceil(seen.max()))
    image = np.zeros((film_px, film_px), np.float32)
    keep = np.zeros(film_px, bool)
    for left, right in _windows(first, last, inner=6 if film_px > QUICK_FILM_PX else 1):
        image[:, left:right] = render_columns(scene, np.arange(left, right), spp)[:, left:right]
        sound = slice(left + _CUT_PX * (left >= first), right - _CUT_PX * (right <= last))
        keep[sound] = True
    line = line_centres(image)
    row = np.where(keep & (line.status == Status.OK), line.row, np.nan)
    words = f"marched rays in float64, RK4 of {step_mm:g} mm, {spp} samples a pixel"
    return Reference(scene, TrueLine.of_rows(row), words)


def _windows(first: int, last: int, inner: int) -> Iterator[tuple[int, int]]:
    """Columns [left, right) of the windows on a line from column `first` to `last`."""
    beyond = _END_PX // 3
    yield first - beyond, first - beyond + _END_PX
    for middle in np.linspace(first, last, inner + 2)[1:-1].astype(int):
        yield int(middle) - _INNER_PX // 2, int(middle) + _INNER_PX // 2
    yield last + beyond - _END_PX, last + beyond


def ladder(quick: bool = False) -> list[tuple[str, Settings]]:
    """The rungs' names and their scene parameters."""
    each: list[tuple[str, Settings]]
    if quick:
        each = [("marched", {"transport": "marched", "spp": spp}) for spp in (1, 4)]
        return [
            *each,
            *((name, {"transport": name, "spp": 4}) for name in ("straight", "tabulated")),
        ]
    spps: dict[str, tuple[int, ...]] = dict.fromkeys(("straight", "tabulated"), _SPP)
    # These two take long: the first of them never gets better by more samples.
    spps |= {"first_order": (1,), "marched": (1, 4, 16)}
    each = [
        (name.replace("_", " "), {"transport": name, "spp": spp})
        for name, chosen in spps.items()
        for spp in chosen
    ]
    table: Settings = {"transport": "tabulated", "spp": 16}
    marched: Settings = {"transport": "marched", "spp": 1}
    each += [("tabulated", table | {"tolerance": t}) for t in (0.1, 0.01)]
    varied: list[tuple[str, Settings]] = [
        ("Euler", {"method": "euler"}),
        ("leapfrog", {"method": "leapfrog", "step": 8}),
        ("leapfrog", {"method": "leapfrog", "step": 4}),
        ("leapfrog", {"method": "leapfrog", "step": 1}),
        ("Sharma", {"method": "sharma", "step": 4}),
        ("RK4", {"method": "rk4", "step": 4}),
        ("Dormand-Prince", {"method": "dopri5"}),
        ("double", {"precision": "double"}),
        ("linear", {"interpolation": "linear"}),
        ("2-D", {"dimensions": 2}),
    ]
    for name, choices in varied:
        if name != "linear":  # its kinks let no table keep the tolerance
            each.append((f"tabulated, {name}", table | choices))
        if name in ("RK4", "double", "linear", "2-D"):
            each.append((f"marched, {name}", marched | choices))
    return each


def rungs(report: Report, quick: bool = False) -> list[Rung]:
    """Measure the ladder, the same with a lamp that lights the whole scene, and the baseline."""
    film_px = QUICK_FILM_PX if quick else FILM_PX
    report("the frames' reference", 0.0)
    truth = reference(film_px, *(4, 2.0) if quick else ())
    chosen = ladder(quick)
    lit = [{"transport": "tabulated", "spp": spp} for spp in ((4,) if quick else (1, 4, 16))]
    spps = (4,) if quick else (1, 4, 16)
    total, done, made = len(chosen) + len(lit) + 2 * len(spps), 0, []

    def measured(name: str, scene: Scene, work: Callable[[], Any], settings: Settings) -> None:
        nonlocal done
        done += 1
        report(f"frames: {name}, {settings['spp']} samples", done / total)
        made.append(measure(truth, name, scene, work, settings, 1 if quick else _RUNS))

    for name, settings in chosen:
        scene = load_scene(SCENE, width=film_px, height=film_px, **settings)
        measured(name, scene, partial(render_uncached, scene), settings)
    for settings in lit:
        scene = with_lamp(width=film_px, height=film_px, **settings)
        settings |= {"light": LAMP}
        measured("tabulated, whole scene lit", scene, partial(render_uncached, scene), settings)
    for light, load in (("", partial(load_scene, SCENE)), (LAMP, with_lamp)):
        for spp in spps:
            scene = load(width=film_px, height=film_px, spp=spp)
            settings = {"spp": spp} | ({"light": light} if light else {})
            measured(DIRECT, scene, partial(frame_direct, scene), settings)
    return made


def frame_direct(scene: Scene) -> NDArray[np.float32]:
    """A frame by Mitsuba's own `direct` integrator, which knows no hot air."""
    image = mi.load_dict({"type": "direct"}).render(scene.mitsuba, scene.mitsuba_camera)
    width, height = scene.sensor.camera.size
    return np.array(image, np.float32).reshape(height, width, -1)[:, :, 0]


def with_lamp(**settings: Any) -> Scene:
    """The scene with a lamp, so that all of it is lit, and every pixel is to be rendered."""
    path = find_scene(SCENE)
    if "field" not in settings:
        settings["field"] = load_scene(SCENE).air.path
    with scratch_folder() as folder:
        lit = Path(folder, f"{SCENE}.xml")
        text = path.read_text(encoding="utf-8").replace("</scene>", f"{_LAMP}</scene>")
        lit.write_text(text, encoding="utf-8")
        return load_scene(lit, **settings)


def measure(
    truth: Reference,
    name: str,
    scene: Scene,
    work: Callable[[], NDArray[np.float32]],
    settings: Settings,
    runs: int = _RUNS,
) -> Rung:
    """Measure one rung: `work` makes its frame's radiance (H, W)."""
    work()  # else kernels would be compiled within what is measured
    began = time.perf_counter()
    image = work()
    dr.sync_thread()
    seconds = time.perf_counter() - began
    if runs > 1:
        seconds = timed(work, runs if seconds < 1.0 else min(runs, _LONG_RUNS), warm_ups=0)
    errors = compare_line(line_centres(image), truth.line)
    lost, columns = errors.lost.size, errors.expected
    baseline = name == DIRECT
    march = scene.transport.march
    used = {"step": march.step_mm, "method": march.method, "precision": march.precision}
    given = {"film": f"{image.shape[1]} x {image.shape[0]}"} | ({} if baseline else used) | settings
    told = ["baseline: straight light, no hot air"] if baseline else []
    return Rung(
        panel="frames",
        name=name,
        settings=given,
        error_px=errors.rms_px,
        largest_px=errors.largest_px,
        error_um=rms(error_um(truth.scene.sensor, errors)),
        seconds=seconds,
        item="frame",
        items=1,
        failed=int(lost > _LOST * columns),
        reference=truth.words,
        note="; ".join([*told, *[f"{lost} of {columns} columns lost"] * (lost > 0)]),
    )
