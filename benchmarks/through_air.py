"""Points through hot air by maps beside Newton's method on marched lines of sight; prints ratios.

python benchmarks/through_air.py [points]
"""

from __future__ import annotations

import sys
import time
from collections.abc import Callable
from typing import Any

import numpy as np

import virtual_sensor as vs
from virtual_sensor.optics import covering_maps
from virtual_sensor.optics.projection import projected_points
from virtual_sensor.optics.sight import seen_points

RUNS = 3


def main(count: int) -> None:
    """Project points above the hot cylinder; search a line, and triangulate what was found."""
    scene = vs.load_scene("hot_cylinder")
    rng, camera = np.random.default_rng(0), scene.camera
    pixel = rng.uniform([0.0, 0.0], camera.size, (count, 2))
    sight = camera.lines_of_sight(pixel)
    depth = camera.pose.to_local(seen_points(scene.cold(), pixel))[:, 2]
    depth = np.where(np.isfinite(depth), depth, 305.0) - rng.uniform(0.0, 10.0, count)
    along = depth / (sight @ camera.pose.rotation[:, 2])
    points = camera.pose.origin_mm + sight * along[:, None]
    for tolerance in (2e-3, 1e-3):
        compare(
            f"project {count} points, {tolerance:g} px",
            lambda: projected_points(scene, points, method="newton").pixel,
            lambda t=tolerance: (
                projected_points(scene, points, method="tabulated", tolerance_px=t).pixel
            ),
            "px",
        )
    y = rng.uniform(-10.4, 10.4, count)
    compare(
        f"search {count} rays",
        lambda: vs.ray_search(scene, y, "newton").pixel,
        lambda: vs.ray_search(scene, y, "tabulated").pixel,
        "px",
    )
    found = vs.ray_search(scene, np.linspace(-11.0, 11.0, 401), "newton")
    covering_maps.MAPS.clear()
    for name, medium in (("straight", None), ("bent", scene.medium)):
        off = vs.triangulate(scene, found.pixel, medium=medium) - found.laser_point_mm
        print(f"triangulate 401 pixels, {name}: {1e3 * np.linalg.norm(off, axis=1).max():.4f} um")


def compare(what: str, newton: Callable[[], Any], maps: Callable[[], Any], unit: str) -> None:
    """Both by turns, and the least time of each."""
    best = {"newton": np.inf, "made": np.inf, "cached": np.inf}
    result: dict[str, Any] = {}
    for _ in range(RUNS):
        covering_maps.MAPS.clear()
        for name, job in (("newton", newton), ("made", maps), ("cached", maps)):
            start = time.perf_counter()
            result[name] = job()
            best[name] = min(best[name], time.perf_counter() - start)
    apart = np.nanmax(np.abs(result["cached"] - result["newton"]))
    ratios = ", ".join(f"{best['newton'] / best[name]:.1f} {name}" for name in ("made", "cached"))
    print(f"{what}: {best['newton']:.2f} s by Newton; times as fast {ratios}; {apart:.1e} {unit}")


if __name__ == "__main__":
    main(int(sys.argv[1]) if len(sys.argv) > 1 else 10_000)
