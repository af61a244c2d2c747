"""Where searches fail: coupled axes, small grids, few steps, undercuts, the limb, no map.

What a search calls FOUND is checked: its pixel must be Newton's to within r_max.
"""

from __future__ import annotations

from collections.abc import Iterator
from functools import cache, partial
from typing import Any

import numpy as np
from numpy.typing import NDArray
from worsening import Case, Outcome, judged

from virtual_sensor.imaging.scene import Scene, load_scene
from virtual_sensor.optics.ray_search import METHODS, FoundPixels, March, SearchStatus, ray_search

Array = NDArray[np.float64]

SCENE = "hot_cylinder"
MARCH = March(0.5, "leapfrog", "double")
"""1e-5 px off: what is looked for here is a thousand times as large."""

R_MAX_PX = 1.0 / 22.0  # a micrometre, of pixels of 22 um
_MAGNIFIED = 1.1  # air under the search's radius moves the pixel by so much more, at most
_RADIUS_MM = 13.5  # of the cylinder
_HIDDEN_MM = (7.4, 8.5)  # of abs(y): the part of the stepped shaft's line that its ledge hides


def cases() -> Iterator[Case]:
    """All of them."""
    for method in METHODS:
        yield Case(
            "the axes u and v couple",
            f"{method} search",
            (0.0, 10.0, 20.0, 30.0),
            "degrees of beta, at most",
            partial(_coupled, method),
            "2,500 random rays of 5 random poses; wrong is a pixel off by more than r_max",
        )
    y = np.random.default_rng(5).uniform(-10.4, 10.4, 500)
    for trouble, option, amounts, unit in (
        ("grid too small", "grid_px", [2.0**k for k in range(6, -2, -1)], "px"),
        ("too few steps", "k_stop", [float(k) for k in range(20, 4, -1)], "steps"),
    ):
        yield Case(
            trouble,
            "paper search",
            amounts,
            unit,
            lambda amount, option=option: _outcome(
                _scene(), y, "paper", **{option: (amount,) * 2 if option == "grid_px" else amount}
            ),
            "500 random rays of hot_cylinder",
            share=0.01,
        )
    for method in METHODS:
        yield Case(
            "undercut points accepted by z_max",
            f"{method} search",
            (0.1, 0.2, 0.5, 1.0),
            "mm of z_max",
            partial(_undercut, method),
            "points of stepped_shaft behind its ledge",
            "seen_point_mm shows it",
        )
    for method in ("newton", "tabulated"):
        yield Case(
            "at the limb",
            f"{method} search",
            (0.5, 0.2, 0.1, 0.05, 0.02, 0.01),
            "mm from the limb, at most",
            partial(_limb, method),
            "100 laser rays on the side of hot_cylinder",
        )
    yield Case(
        "no map for the tolerance",
        "tabulated search",
        tuple(10.0**-k for k in range(2, 10)),
        "px",
        partial(_no_map, y),
        "500 random rays of hot_cylinder",
        "such rays are searched by Newton's method, slower and no less right",
    )


@cache
def _scene(name: str = SCENE, **parameters: Any) -> Scene:
    return load_scene(name, **parameters)


def _judged(scene: Scene, found: FoundPixels, y_mm: Array) -> Outcome:
    """FOUND pixels beside Newton's root of the same point."""
    root = ray_search(scene, y_mm, "newton", march=MARCH)
    right = np.where((root.status == SearchStatus.FOUND)[:, None], root.pixel, np.nan)
    error = np.linalg.norm(found.pixel - right, axis=1)
    return judged(found.status, [SearchStatus.FOUND], error, _MAGNIFIED * R_MAX_PX)


def _outcome(scene: Scene, y_mm: Array, method: str, **options: Any) -> Outcome:
    options = {"march": MARCH} | options
    if "k_stop" in options:
        options["k_stop"] = int(options["k_stop"])
    return _judged(scene, ray_search(scene, y_mm, method, **options), y_mm)


def _coupled(method: str, beta_deg: float) -> Outcome:
    """Random rays of random poses: u and v are halved together, so one may overtake the other."""
    rng = np.random.default_rng(4)
    each = []
    for along, beta in zip(rng.uniform(-20, 20, 5), np.linspace(-1, 1, 5), strict=True):
        scene = _scene(beta=beta * beta_deg, along=along)
        each.append(_outcome(scene, rng.uniform(-9.0, 9.0, 500), method))
    reported, wrong = (np.concatenate([getattr(o, k) for o in each]) for k in ("reported", "wrong"))
    names = sorted({name for outcome in each for name in outcome.reports})
    return Outcome(reported, wrong, names, max(outcome.largest_px for outcome in each))


def _undercut(method: str, z_max_mm: float) -> Outcome:
    """All these points are hidden: each pixel that is FOUND is another point's."""
    y = np.linspace(*_HIDDEN_MM, 200)
    found = ray_search(_scene("stepped_shaft").cold(), y, method, march=MARCH, z_max_mm=z_max_mm)
    depth = np.linalg.norm(found.seen_point_mm - found.laser_point_mm, axis=1)
    outcome = judged(found.status, [SearchStatus.FOUND], np.inf)
    good = ~outcome.reported
    largest = float(depth[good].max(initial=0.0)) / 0.022
    return Outcome(outcome.reported, good, outcome.reports, largest)


def _limb(method: str, distance_mm: float) -> Outcome:
    y = _RADIUS_MM - distance_mm * np.linspace(1.0, 0.5, 100)
    return _outcome(_scene(line_length=28), y, method)


def _no_map(y_mm: Array, tolerance_px: float) -> Outcome:
    found = ray_search(_scene(), y_mm, "tabulated", tolerance_px=tolerance_px)
    outcome = _judged(_scene(), found, y_mm)
    marched = found.iterations > 0
    names = [*outcome.reports, *["marched in place of the maps"] * bool(marched.any())]
    return Outcome(outcome.reported | marched, outcome.wrong, names, outcome.largest_px)
