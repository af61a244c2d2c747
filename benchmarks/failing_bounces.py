"""Where light that bounces fails: smooth metal, few points of the lit stripe, few bounces."""

from __future__ import annotations

from collections.abc import Iterator
from functools import cache, partial
from typing import Any

import numpy as np
from numpy.typing import NDArray
from worsening import WRONG_PX, Case, Outcome

from virtual_sensor.imaging.render import DIRECT, render
from virtual_sensor.imaging.scene import Scene, load_scene
from virtual_sensor.metrology.centres import Status, is_found
from virtual_sensor.metrology.line_peaks import line_centres
from virtual_sensor.metrology.truth import TrueLine, compare_line
from virtual_sensor.studies.chart.bounces import SCENE, reference

_FILM = {"width": 384, "height": 384, "spp": 4, "line_radius": 0.5}
_STEEL = "ground_steel"
_ROUGH, _POINTS, _BOUNCES = 0.2, 16, 1
_BEST = 64, 6  # points of the stripe, and frames of which the mean is
_SHARE = 0.05  # of the columns
_CONDITIONS = (
    f"v_groove of {_STEEL}, film of {_FILM['width']} px; columns whose line is twice as bright as"
    " what is reflected there"
)


def cases() -> Iterator[Case]:
    """All of them."""
    more = {"share": _SHARE, "silent": True}
    yield Case(
        "smooth metal",
        f"light that bounces, {_POINTS} points",
        (0.5, 0.4, 0.3, 0.2, 0.15, 0.1, 0.07, 0.05),
        "roughness",
        lambda roughness: _beside(roughness, _BOUNCES, _POINTS),
        _CONDITIONS,
        "choose indirect_samples by --tolerance",
        **more,
    )
    yield Case(
        "too few points of the stripe",
        "light that bounces",
        (64, 16, 4, 1),
        "points a sample",
        lambda points: _beside(_ROUGH, _BOUNCES, int(points)),
        f"{_CONDITIONS}; roughness {_ROUGH}",
        "choose by --tolerance",
        **more,
    )
    yield Case(
        "too few bounces",
        "light that bounces",
        (3, 2, 1, 0),
        "bounces",
        lambda bounces: _beside(_ROUGH, int(bounces), _BEST[0], 3),
        f"{_CONDITIONS}; roughness {_ROUGH}",
        "measure notes a part that lights itself",
        **more,
    )


def _load(roughness: float, **parameters: Any) -> Scene:
    return load_scene(SCENE, **_FILM, material=_STEEL, roughness=roughness, **parameters)


@cache
def _reference(roughness: float, bounces: int) -> tuple[Scene, NDArray[np.bool_], TrueLine]:
    return reference(partial(_load, roughness), bounces, *_BEST)


def _beside(roughness: float, bounces: int, points: int, of_truth: int = 0) -> Outcome:
    """The line of a frame beside that of many frames, by as many bounces unless others are said."""
    _, near, truth = _reference(roughness, of_truth or bounces)
    scene = _load(roughness, max_depth=DIRECT + bounces, indirect_samples=points)
    errors = compare_line(line_centres(render(scene) * near), truth)
    lost = ~is_found(errors.lost)
    names = [Status(number).name for number in np.unique(errors.lost[lost])]
    wrong = np.append(np.abs(errors.error_px) > WRONG_PX, ~lost)
    return Outcome(np.append(np.zeros(errors.count, bool), lost), wrong, names, errors.largest_px)
