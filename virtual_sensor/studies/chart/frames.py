"""Panel "frames": the line's centres in rendered frames, error against time for each frame."""

from __future__ import annotations

from collections.abc import Callable, Iterator
from functools import partial
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from virtual_sensor.engine import mi
from virtual_sensor.files import scratch_folder
from virtual_sensor.imaging.render import render_columns, render_uncached
from virtual_sensor.imaging.scene import Scene, load_scene
from virtual_sensor.imaging.scene_file import find_scene
from virtual_sensor.metrology.line_peaks import line_centres
from virtual_sensor.metrology.triangulation import error_um
from virtual_sensor.metrology.truth import TrueLine, compare_line
from virtual_sensor.optics.ray_search import ray_search
from virtual_sensor.studies.chart.benchmark import Configuration, Score, Task

Array = NDArray[np.float64]
Settings = dict[str, Any]

SCENE = "hot_cylinder"
FILM_PX, QUICK_FILM_PX = 2048, 512

_SPP = (1, 4, 9, 16, 64)
_END_PX, _INNER_PX = 16, 10  # columns of the reference's windows, at the line's ends and between
_CUT_PX = 2  # columns beside a window's cut are taken for a line's end
_LOST = 0.02  # a frame that loses this share of the columns has failed
_LAMP = (  # so faint that it moves no line, and costs what any lamp does
    '<emitter type="point"><point name="position" x="0" y="0" z="300"/>'
    '<spectrum name="intensity" value="0.1"/></emitter>'
)
_NAMES = {"spp": "samples_per_pixel", "step": "step_mm", "tolerance": "tolerance_px"}
"""What scene parameters are called among results."""


def _reference(film_px: int, spp: int, step_mm: float) -> tuple[Scene, TrueLine, str]:
    """The line by marched rays in float64, and that in words."""
    best = {"transport": "marched", "method": "rk4", "precision": "double", "step": step_mm}
    scene = load_scene(SCENE, width=film_px, height=film_px, spp=spp, **best)
    words = f"marched rays in float64, RK4 of {step_mm:g} mm, {spp} samples per pixel"
    return scene, line_in_windows(scene, spp), words


def line_in_windows(scene: Scene, spp: int, from_ends_px: int = 0) -> TrueLine:
    """The line of a frame in windows at its ends, or so far from them, and between.

    The whole line would take minutes, and shows no more than these windows do.
    """
    width, height = scene.camera.size
    half = 0.5 * scene.sensor.laser.length_mm
    seen = ray_search(scene, [-half, half], "newton").pixel[:, 0]
    first, last = int(np.floor(seen.min())), int(np.ceil(seen.max()))
    image = np.zeros((height, width), np.float32)
    inside = np.zeros(width, bool)
    ends = first + from_ends_px, last - from_ends_px
    for left, right in _windows(*ends, inner=6 if width > QUICK_FILM_PX else 1):
        image[:, left:right] = render_columns(scene, np.arange(left, right), spp)[:, left:right]
        sound = slice(left + _CUT_PX * (left >= first), right - _CUT_PX * (right <= last))
        inside[sound] = True
    line = line_centres(image)
    return TrueLine.of_rows(np.where(inside, line.pixel[:, 1], np.nan))


def _windows(first: int, last: int, inner: int) -> Iterator[tuple[int, int]]:
    """Columns [left, right) of the windows on a line from column `first` to `last`."""
    beyond = _END_PX // 3
    yield first - beyond, first - beyond + _END_PX
    for middle in np.linspace(first, last, inner + 2)[1:-1].astype(int):
        yield int(middle) - _INNER_PX // 2, int(middle) + _INNER_PX // 2
    yield last + beyond - _END_PX, last + beyond


def tasks(quick: bool = False) -> Iterator[Task]:
    """A frame lit by the laser alone, and one of which each pixel is lit."""
    film_px = QUICK_FILM_PX if quick else FILM_PX
    scene, truth, words = _reference(film_px, *(4, 2.0) if quick else (64, 1.0))

    def score(image: NDArray[np.float32]) -> Score:
        errors = compare_line(line_centres(image), truth)
        lost, columns = errors.lost.size, errors.expected
        note = f"{lost} of {columns} columns lost" if lost else ""
        um = error_um(scene.sensor, errors)
        return Score(errors.error_px, um, int(lost > _LOST * columns), note)

    def task(
        name: str, load: Callable[..., Scene], choices: list[Settings], spps: tuple[int, ...]
    ) -> Task:
        film = {"width": film_px, "height": film_px}
        found = [_configuration(partial(load, **film), film, choice) for choice in choices]
        found += [_direct(partial(load, **film), film, spp) for spp in spps]
        return Task(f"{name}, {film_px} x {film_px} px", words, 1, score, found)

    few = (4,) if quick else (1, 4, 16)
    yield task("a frame of the laser line", partial(load_scene, SCENE), settings(quick), few)
    lit = [{"transport": "tabulated", "spp": spp} for spp in few]
    yield task("a frame with every pixel lit", with_lamp, lit, few)


def settings(quick: bool = False) -> list[Settings]:
    """Scene parameters of the configurations."""
    # Marched rays take long; the first order never gets better by more samples.
    spps: dict[str, tuple[int, ...]] = {"straight": _SPP, "tabulated": _SPP}
    spps |= {"first_order": (1,), "marched": (1, 4, 16)}
    if quick:
        spps = {"marched": (1, 4), "straight": (4,), "tabulated": (4,)}
    by_samples: list[Settings] = [
        {"transport": name, "spp": spp} for name, chosen in spps.items() for spp in chosen
    ]
    if quick:
        return by_samples
    either: list[Settings] = [
        {"method": "rk4", "step": 4},
        {"precision": "double"},
        {"dimensions": 2},
    ]
    of_tables: list[Settings] = [
        {"tolerance": 0.1},
        {"tolerance": 0.01},
        {"method": "euler"},
        *({"method": "leapfrog", "step": step} for step in (8, 4, 1)),
        {"method": "sharma", "step": 4},
        {"method": "dopri5"},
    ]
    # No table meets its tolerance in a linear field: its gradient jumps at each node.
    of_marches: list[Settings] = [{"interpolation": "linear"}]
    tables = [{"transport": "tabulated", "spp": 16} | varied for varied in of_tables + either]
    marches = [{"transport": "marched", "spp": 1} | varied for varied in of_marches + either]
    return by_samples + tables + marches


def _configuration(load: Callable[..., Scene], film: Settings, chosen: Settings) -> Configuration:
    def prepare() -> Callable[[], NDArray[np.float32]]:
        return partial(render_uncached, load(**chosen))

    march = load_scene(SCENE, **chosen).transport.march
    used = {"step": march.step_mm, "method": march.method, "precision": march.precision}
    transport = chosen["transport"]
    rest = {name: value for name, value in chosen.items() if name != "transport"}
    return Configuration(transport, transport, prepare, _named(rest), _named(film | used | chosen))


def _direct(load: Callable[..., Scene], film: Settings, spp: int) -> Configuration:
    """The baseline: straight light by Mitsuba's own integrator."""
    return Configuration(
        "direct",
        "straight",
        lambda: partial(frame_direct, load(spp=spp)),
        _named({"spp": spp}),
        _named(film),
        note=lambda: "baseline: straight light, no hot air",
    )


def _named(parameters: Settings) -> Settings:
    return {_NAMES.get(name, name): value for name, value in parameters.items()}


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
