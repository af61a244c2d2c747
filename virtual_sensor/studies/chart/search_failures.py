"""Where searches fail: coupled axes, small grids, few steps, undercuts, the limb, no map.

What a search calls FOUND is checked: its pixel must be Newton's to within r_max.
"""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from typing import Any

import numpy as np
from numpy.typing import NDArray

from virtual_sensor.imaging.scene import Scene, load_scene
from virtual_sensor.optics.ray_search import METHODS, FoundPixels, March, SearchStatus, ray_search
from virtual_sensor.poses import Pose
from virtual_sensor.studies.chart.rung import Failure, Report
from virtual_sensor.studies.chart.searches import HALF_LINE_MM, SCENE, UM_PER_PX

Array = NDArray[np.float64]

MARCH = March(0.5, "leapfrog", "double")
"""1e-5 px off: what is looked for here is a thousand times as large."""

R_MAX_UM = 1.0
_MAGNIFIED = 1.1  # air under the search's radius moves the pixel by so much more, at most
_AXIS_MM = (0.0, -13.5)  # y and z of the cylinder's axis
_UNDERCUTS = "stepped_shaft"


def failures(report: Report, quick: bool = False) -> list[Failure]:
    """Count how searches end, setting by setting.

    Parameters
    ----------
    report : callable
    quick : bool
        Fewer rays and settings.
    """
    scene = load_scene(SCENE)
    rng = np.random.default_rng(5)
    poses, rays = (2, 100) if quick else (20, 500)
    found = []
    for number, method in enumerate(METHODS):
        report(f"search: coupled axes, {method}", 0.1 + 0.15 * number)
        found.append(coupled(scene, method, np.random.default_rng(4), poses, rays))
    y = rng.uniform(-HALF_LINE_MM, HALF_LINE_MM, 60 if quick else 500)
    report("search: grids too small, steps too few", 0.6)
    found.append(grid_too_small(scene, y, (32.0, 4.0, 1.0) if quick else _halved(64.0, 0.5)))
    found.append(too_few_steps(scene, y, (15, 8) if quick else range(20, 4, -1)))
    report("search: undercuts", 0.8)
    y = rng.uniform(-HALF_LINE_MM, HALF_LINE_MM, 100 if quick else 1000)
    for method in METHODS:
        found.append(undercut(method, y, (0.1, 1.0) if quick else (0.1, 0.2, 0.5, 1.0)))
    report("search: at the limb", 0.9)
    wide = load_scene(SCENE, line_length=28)  # beyond the sides
    for method in ("newton", "tabulated"):
        found.append(limb(wide, method, np.linspace(13.0, 13.6, 31 if quick else 301)))
    report("search: tolerances of maps", 0.95)
    y = rng.uniform(-HALF_LINE_MM, HALF_LINE_MM, 60 if quick else 500)
    found.append(no_map(scene, y, (1e-3, 1e-9) if quick else tuple(10.0**-k for k in range(2, 10))))
    return found


def wrong(scene: Scene, found: FoundPixels, y_mm: Array) -> NDArray[np.bool_]:
    """Which FOUND pixels are farther than r_max from Newton's root, or see another point."""
    root = ray_search(scene, y_mm, "newton", march=MARCH)
    apart = np.linalg.norm(found.pixel - root.pixel, axis=1) * UM_PER_PX
    right = (root.status == SearchStatus.FOUND) & (apart <= _MAGNIFIED * R_MAX_UM)
    return (found.status == SearchStatus.FOUND) & ~right


def coupled(scene: Scene, method: str, rng: np.random.Generator, poses: int, rays: int) -> Failure:
    """Random rays of random poses: u and v are halved together, so one may overtake the other."""
    status, mistaken, distance = [], 0, []
    for _ in range(poses):
        there = moved(scene, rng.uniform(-30.0, 30.0), rng.uniform(-20.0, 20.0))
        y = rng.uniform(-9.0, 9.0, rays)
        found = ray_search(there, y, method, march=MARCH)
        status.append(found.status)
        distance.append(found.distance_um)
        mistaken += int(wrong(there, found, y).sum())
    bad = np.concatenate(status) != SearchStatus.FOUND
    largest = np.nanmax(np.concatenate(distance))
    return Failure(
        "search: the two axes couple",
        f"{method} search",
        f"grid of 32 px, k_stop 15: {bad.mean():.2%} of the rays" if bad.any() else "",
        f"{bad.size} random rays, {poses} poses with beta within 30 degrees",
        _told(np.concatenate(status)),
        int(bad.sum()),
        bad.size,
        f"largest distance {largest:.3g} um; {mistaken} of those FOUND are wrong",
    )


def grid_too_small(scene: Scene, y_mm: Array, grids_px: Sequence[float]) -> Failure:
    """The search reaches no farther than its grid's width from the straight projection."""
    choices = {f"{grid:g} px": {"grid_px": (grid, grid)} for grid in grids_px}
    return _first(scene, y_mm, "search: grid too small", choices, "grids")


def too_few_steps(scene: Scene, y_mm: Array, k_stops: Sequence[int]) -> Failure:
    """The last step must be shorter than r_max."""
    choices = {f"k_stop {k}": {"k_stop": k} for k in k_stops}
    return _first(scene, y_mm, "search: too few steps", choices, "steps")


def _first(
    scene: Scene, y_mm: Array, what: str, choices: dict[str, dict[str, Any]], noun: str
) -> Failure:
    """The first setting at which more than 1 % of the rays end above r_max."""
    mistaken, told, first, count = 0, [], "", 0
    for name, options in choices.items():
        found = ray_search(scene, y_mm, "paper", march=MARCH, **options)
        mistaken += int(wrong(scene, found, y_mm).sum())
        bad = found.status != SearchStatus.FOUND
        if bad.mean() > 0.01 and not first:
            first, count, told = name, int(bad.sum()), [_told(found.status)]
    names = list(choices)
    return Failure(
        what,
        "paper search",
        first,
        f"{noun} from {names[0]} down to {names[-1]}",
        told[0] if told else "",
        count,
        y_mm.size,
        f"{mistaken} of those FOUND are wrong",
    )


def undercut(method: str, y_mm: Array, z_max_mm: Sequence[float]) -> Failure:
    """A ledge hides the line's points in the groove; z_max tells, until it is deeper than that."""
    shaft = load_scene(_UNDERCUTS).cold()
    strict = ray_search(shaft, y_mm, method, march=MARCH, z_max_mm=min(z_max_mm))
    hidden = strict.status == SearchStatus.UNDERCUT
    root = ray_search(shaft, y_mm, "newton", march=MARCH, z_max_mm=np.inf).pixel
    first, count, ends = "", 0, "none was accepted"
    for z_max in sorted(z_max_mm):
        found = ray_search(shaft, y_mm, method, march=MARCH, z_max_mm=z_max)
        accepted = hidden & np.isfinite(found.pixel[:, 0])
        if accepted.any() and not first:
            first, count = f"z_max {z_max:g} mm", int(accepted.sum())
            apart = np.linalg.norm(found.pixel - root, axis=1)[accepted].max()
            good = int(np.sum(found.status[accepted] == SearchStatus.FOUND))
            ends = f"{good} are FOUND there, up to {apart:.2g} px from the hidden points' own"
    return Failure(
        "search: undercut points accepted by z_max",
        f"{method} search",
        first,
        f"z_max of {', '.join(f'{z:g}' for z in sorted(z_max_mm))} mm on a stepped shaft",
        f"UNDERCUT {int(hidden.sum())} where z_max is small",
        count,
        int(hidden.sum()),
        f"{ends}; seen_point_mm tells it",
    )


def no_map(scene: Scene, y_mm: Array, tolerances_px: Sequence[float]) -> Failure:
    """Tolerances that no map keeps: the rays are searched by Newton's method, and slower."""
    first, count, mistaken = "", 0, 0
    for tolerance in tolerances_px:
        found = ray_search(scene, y_mm, "tabulated", tolerance_px=tolerance)
        mistaken += int(wrong(scene, found, y_mm).sum())
        marched = int(np.sum(found.iterations > 0))
        if marched and not first:
            first, count = f"{tolerance:g} px", marched
    return Failure(
        "search: no map for the tolerance",
        "tabulated search",
        first,
        f"tolerances from {tolerances_px[0]:g} px down to {tolerances_px[-1]:g} px",
        "marched in place of the maps" if first else "",
        count,
        y_mm.size,
        f"{mistaken} of those FOUND are wrong",
    )


def limb(scene: Scene, method: str, y_mm: Array) -> Failure:
    """Rays that graze the side, whose points the camera sees at a grazing angle too."""
    found = ray_search(scene, y_mm, method, march=MARCH)
    bad = found.status != SearchStatus.FOUND
    at = f"y = {y_mm[bad].min():.3f} mm" if bad.any() else ""
    return Failure(
        "search: at the limb",
        f"{method} search",
        at,
        f"rays at y = {y_mm[0]:g} to {y_mm[-1]:g} mm on a cylinder of radius 13.5 mm",
        _told(found.status),
        int(bad.sum()),
        bad.size,
        f"{int(wrong(scene, found, y_mm).sum())} of those FOUND are wrong",
    )


def moved(scene: Scene, beta_deg: float, along_mm: float) -> Scene:
    """The scene with its sensor turned round the cylinder's axis, and shifted along it."""
    angle = np.radians(beta_deg)
    c, s = np.cos(angle), np.sin(angle)
    turn = np.array([[1.0, 0.0, 0.0], [0.0, c, -s], [0.0, s, c]])
    axis = np.array([0.0, *_AXIS_MM])
    motion = Pose(turn, axis - turn @ axis + [along_mm, 0.0, 0.0])
    for name, pose in scene.poses.items():
        scene = scene.with_pose(name, pose.moved(motion))
    return scene


def _halved(first: float, last: float) -> list[float]:
    return [first / 2.0**k for k in range(int(np.log2(first / last)) + 1)]


def _told(status: NDArray[np.int64]) -> str:
    """The statuses that are not good, and how often each is given."""
    return ", ".join(_counts(status))


def _counts(status: NDArray[np.int64]) -> Iterator[str]:
    for each in SearchStatus:
        count = int(np.sum(status == each))
        if count and each != SearchStatus.FOUND:
            yield f"{each.name} {count}"
