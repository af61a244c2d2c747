"""Panel "correction": error left against time, by what is known of the air that light went through.

Nothing; a field of another temperature; the air itself, by maps and by marches; and air that is
found from the pixels, in a family that doesn't hold the true one: of one pose, and of two.
"""

from __future__ import annotations

from collections.abc import Callable, Iterator
from functools import partial
from typing import Any

import numpy as np
from numpy.typing import NDArray

from virtual_sensor.imaging.scene import Scene, load_scene
from virtual_sensor.metrology.air_estimate import estimate_air
from virtual_sensor.metrology.deviation import UM_PER_MM, euclidean
from virtual_sensor.metrology.observations import Observation
from virtual_sensor.metrology.shapes import CylinderShape
from virtual_sensor.metrology.triangulation import triangulate, triangulated_points
from virtual_sensor.optics import covering_maps
from virtual_sensor.optics.bent_points import bent_points
from virtual_sensor.optics.ray_search import ray_search
from virtual_sensor.optics.rays import March
from virtual_sensor.studies.chart.benchmark import Configuration, Score, Task

Array = NDArray[np.float64]

SCENE = "hot_cylinder"
FINEST = March(0.02, "leapfrog", "double")
"""Of the pixels and points that are given: finer than any that is charted."""

HALF_LINE_MM = 10.0
OTHER_C = 1100.0
"""Wall temperature of the air that is assumed, or scaled and widened: the true one's is 1250."""

_POINTS, _QUICK_POINTS = 401, 21
_TURNED_DEG = 30.0
_START = CylinderShape(radius_mm=13.0, z_mm=-13.0)
"""Where the search for the shape begins: half a millimetre off."""
_FREE = ("radius_mm", "y_mm", "z_mm")


def tasks(quick: bool = False) -> Iterator[Task]:
    """Points of a line, from above, where air moves them most, and from beside the plume."""
    for beta, words in ((0.0, "from above"), (_TURNED_DEG, f"turned by {_TURNED_DEG:g}°")):
        yield _task(beta, f"points of a line in air of 1250 °C, {words}", quick)


def _task(beta_deg: float, name: str, quick: bool) -> Task:
    """Searched pixels of one pose, whose points are known; the other pose helps the estimates."""
    y_mm = np.linspace(-HALF_LINE_MM, HALF_LINE_MM, _QUICK_POINTS if quick else _POINTS)
    poses = (beta_deg, _TURNED_DEG - beta_deg)
    scenes = [load_scene(SCENE, beta=beta) for beta in poses]
    searched = [ray_search(scene, y_mm, "newton", march=FINEST) for scene in scenes]
    pixels = [each.pixel for each in searched]
    scene, pixel, truth = scenes[0], pixels[0], searched[0].laser_point_mm
    mm_per_px = scene.camera.pixel_mm(truth)
    other = load_scene(SCENE, temperature=OTHER_C).medium

    def score(points: Array) -> Score:
        off_mm = euclidean(points - truth)
        return Score(off_mm / mm_per_px, UM_PER_MM * off_mm, int(np.sum(np.isnan(off_mm))))

    def by_maps(medium: Any, tolerance_px: float, before: Callable[[], object]) -> Array:
        before()
        options = {"medium": medium, "method": "tabulated", "tolerance_px": tolerance_px}
        return triangulated_points(scene, pixel, **options).point_mm

    def choices() -> Iterator[Configuration]:
        yield _configuration("not_corrected", "straight", partial(triangulate, scene, pixel))
        cached, new = (lambda: None), covering_maps.MAPS.clear
        work = partial(by_maps, other, 1e-3, cached)
        yield _configuration("other_air", "assumed air", work)
        for kind, before in (("new_maps", new), ("cached_maps", cached)):
            for px in (1e-3,) if quick else (1e-2, 1e-3, 1e-4):
                work = partial(by_maps, scene.medium, px, before)
                yield _configuration(f"own_air_{kind}", "own air", work, tolerance_px=px)
        for step in (2.0,) if quick else (0.1, 0.5, 2.0):
            march = March(step, "leapfrog", "double")
            work = partial(_marched, scene, pixel, march)
            yield _configuration("own_air_marched", "own air", work, step_mm=step)
        for words, count, free in (
            ("found_on_a_known_shape", 1, ()),
            ("found_from_one_pose", 1, _FREE),
            ("found_from_two_poses", 2, _FREE),
        ):
            seen = [Observation(*pair) for pair in zip(scenes[:count], pixels, strict=False)]
            for px in (1e-3,) if quick else (1e-1, 1e-3, 1e-5):
                work = partial(_estimated, seen, other, free, px)
                yield _configuration(words, "air that is found", work, tolerance_px=px)

    reference = f"points that a search went out from, {FINEST.method} of {FINEST.step_mm:g} mm"
    return Task(name, reference, len(y_mm), score, list(choices()))


def _configuration(name: str, kind: str, work: Callable[[], Array], **chosen: Any) -> Configuration:
    return Configuration(name, kind, lambda: work, chosen)


def _marched(scene: Scene, pixel: Array, march: March) -> Array:
    """By Newton's method on marched rays, with all derivatives."""
    return bent_points(scene, pixel, march=march).point_mm


def _estimated(seen: list[Observation], air: Any, free: tuple[str, ...], px: float) -> Array:
    """Of the first pose, in air that is scaled and widened; on the true shape, or on one found."""
    shape = _START if free else CylinderShape()
    found = estimate_air(seen, air, shape=shape, free=free, tolerance_px=px)
    points: Array = found.points[0].point_mm
    return points
