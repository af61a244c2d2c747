"""Whether a camera's image shows the lines of several lasers apart from each other."""

from itertools import combinations

import numpy as np
from numpy.typing import NDArray

from virtual_sensor.imaging.scene import Scene
from virtual_sensor.optics.ray_search import ray_search

_SAMPLES = 201  # rays of a line
_MARGIN_PX = 2.0  # that `lines_by_source` adds to the light of each

Array = NDArray[np.float64]


def close_lines(scene: Scene) -> list[str]:
    """Notes of lasers whose light meets in a camera's image of the cold part."""
    notes = []
    for name in scene.cameras:
        lines = {source: _line(scene.only(name, source)) for source in scene.sources}
        for (one, (row, half)), (other, (row_2, half_2)) in combinations(lines.items(), 2):
            apart = np.abs(row - row_2)
            reach_px = half + half_2
            both, meet = np.isfinite(apart).sum(), (apart < reach_px).sum()
            if meet:
                image = f" in the image of {name}" if len(scene.cameras) > 1 else ""
                notes.append(
                    f"the lines of {one} and {other} lie within {reach_px:.0f} px of each other"
                    f" in {meet} of {both} columns{image}, where their light meets: use"
                    " --laser-offset, or one laser at a time (measure --source)"
                )
    return notes


def _line(scene: Scene) -> tuple[Array, float]:
    """Row of a laser's line in each column (W,), NaN where it is not, and half its breadth."""
    found = ray_search(
        scene.cold(), scene.laser.along(_SAMPLES), k_stop=1, method="paper", r_max_um=np.inf
    )
    seen = np.isfinite(found.pixel).all(axis=1)
    column, blank = np.arange(scene.camera.size[0]), np.full(scene.camera.size[0], np.nan)
    if seen.sum() < 2:
        return blank, 0.0
    u, v = found.pixel[seen].T
    order = np.argsort(u)
    away_mm = np.linalg.norm(found.laser_point_mm[seen] - scene.camera.pose.origin_mm, axis=1)
    px_per_mm = scene.camera.matrix[0, 0] / np.median(away_mm)
    row = np.interp(column, u[order], v[order], left=np.nan, right=np.nan)
    return row, float(scene.laser.reach_mm * px_per_mm) + _MARGIN_PX
