"""Where frames fail: folds, shadows, too few samples, too long steps, too thin a line."""

from __future__ import annotations

from collections.abc import Iterator
from functools import cache, partial
from typing import Any

import numpy as np
from numpy.typing import NDArray
from worsening import WRONG_PX, Case, Outcome

from virtual_sensor.imaging.render import lit_pixels, render_uncached
from virtual_sensor.imaging.scene import Scene, load_scene
from virtual_sensor.medium.index_field import IndexField
from virtual_sensor.metrology.centres import Status, is_found
from virtual_sensor.metrology.line_peaks import line_centres
from virtual_sensor.metrology.truth import TrueLine, compare_line
from virtual_sensor.optics.illumination import LightStatus
from virtual_sensor.optics.ray_search import SearchStatus, incidence_points, ray_search

SCENE = "hot_cylinder"
FILM_PX = 512
_FILM = f"film of {FILM_PX} px"
_THIN_MM = 0.1  # 1/e^2 radius of a line that is little wider than a pixel of this film
_PX_MM = 0.088


def cases() -> Iterator[Case]:
    """All of them."""
    for transport in ("marched", "tabulated"):
        yield Case(
            "the laser's light folds (a caustic)",
            f"{transport} frame",
            (1, 2, 5, 10, 20, 50, 100),
            "times the air's contrast",
            partial(folding, transport),
            f"1250 degC, {_FILM}; wrong are lit pixels that get several laser rays, one of which"
            " is counted, and unlit ones with a laser coordinate",
            factor=1.05,
        )
    yield Case(
        "undercut: the part shades itself",
        "frame of stepped_shaft",
        (1.0,),
        "the scene as it is",
        lambda _: _lit(_scene("stepped_shaft"), LightStatus.SHADOWED),
        _FILM,
    )
    yield Case(
        "too few samples",
        "tabulated frame",
        (16, 9, 4, 1),
        "samples a pixel",
        lambda spp: _beside(_best(line_radius=_THIN_MM), line_radius=_THIN_MM, spp=int(spp)),
        f"{_FILM}, line of {_THIN_MM:g} mm",
        "choose by --tolerance",
    )
    tried = [("tabulated", method) for method in ("euler", "leapfrog", "sharma", "rk4")]
    for transport, method in [*tried, ("marched", "leapfrog")]:
        yield Case(
            "steps too long",
            f"{transport} frame, {method}",
            (1, 2, 4, 8, 16, 32),
            "mm a step",
            lambda step, transport=transport, method=method: _beside(
                _best(), transport=transport, method=method, step=step
            ),
            _FILM,
            "choose by --tolerance",
        )
    yield Case(
        "line thinner than a pixel",
        "frame and Gaussian fit",
        (0.15, 0.12, 0.09, 0.08, 0.07, 0.05, 0.03),
        "mm of 1/e^2 radius",
        _thin,
        f"{_FILM} of {_PX_MM:g} mm each; beside the ray search",
    )


def _scene(name: str = SCENE, **parameters: Any) -> Scene:
    return load_scene(name, **({"width": FILM_PX, "height": FILM_PX, "spp": 4} | parameters))


def contrasted(field: IndexField, factor: float) -> IndexField:
    """The same air, its difference from the surroundings `factor` times as large."""
    return field.with_nodes(field.ambient + factor * (field.nodes - field.ambient))


def folding(transport: str, factor: float) -> Outcome:
    """Multiply the air's contrast: neighbouring laser rays cross."""
    scene = _scene(transport=transport)
    assert scene.field is not None
    hotter = scene.with_medium(contrasted(scene.field, factor))
    return _lit(hotter, LightStatus.FOLDED, _usually_lit(transport) // 10)


@cache
def _usually_lit(transport: str) -> int:
    (status,) = lit_pixels(_scene(transport=transport)).status.values()
    return int(np.sum(status == LightStatus.LIT))


def _lit(scene: Scene, reported_as: LightStatus, at_least: int = 0) -> Outcome:
    """Pixels that may be lit.

    Where all light is folded, no pixel is taken for one: those missing from `at_least` count, too.
    """
    found = lit_pixels(scene)
    (status,), (place,) = found.status.values(), found.source_coordinates.values()
    lit = status == LightStatus.LIT
    y = found.point_mm[:, 1]
    wrong = ~lit & np.isfinite(place[:, 0])
    for low, high in runs_back(scene):
        wrong |= lit & (y > low) & (y < high)
    missing = max(at_least - int(lit.sum()), 0)
    reported = np.append(status == reported_as, np.ones(missing, bool))
    return Outcome(reported, np.append(wrong, np.zeros(missing, bool)), [reported_as.name])


def runs_back(scene: Scene) -> list[tuple[float, float]]:
    """Ranges of y, mm, over which the laser line on the part runs back over itself."""
    half = 0.5 * scene.source.length_mm
    y = incidence_points(scene, np.linspace(-half, half, 2001))[:, 1]
    back = np.flatnonzero(np.diff(y) < 0.0)  # no step from or to a ray that met nothing
    runs = np.split(back, np.flatnonzero(np.diff(back) > 1) + 1)
    return [(float(y[run + 1].min()), float(y[run].max())) for run in runs if run.size]


@cache
def _best(**parameters: Any) -> TrueLine:
    """The line's centres by marched rays in float64, RK4 of 1 mm and 64 samples a pixel."""
    march = {"transport": "marched", "method": "rk4", "precision": "double", "step": 1.0}
    line = line_centres(render_uncached(_scene(spp=64, **march, **parameters)))
    return TrueLine.of_rows(line.pixel[:, 1])


def _beside(truth: TrueLine, **parameters: Any) -> Outcome:
    """The line of a frame beside the truth, column by column."""
    image = render_uncached(_scene(**{"transport": "tabulated"} | parameters))
    return _compared(image, truth, WRONG_PX)


def _compared(image: NDArray[Any], truth: TrueLine, wrong_px: float, end_px: float = 0) -> Outcome:
    errors = compare_line(line_centres(image), truth, end_px=end_px)
    reported = np.append(np.zeros(errors.count, bool), ~is_found(errors.lost))
    wrong = np.append(np.abs(errors.error_px) > wrong_px, is_found(errors.lost))
    names = [Status(number).name for number in np.unique(errors.lost) if not is_found(number)]
    return Outcome(reported, wrong, names, errors.largest_px)


def _thin(radius_mm: float) -> Outcome:
    scene = _scene(spp=16, line_radius=radius_mm)
    half = 0.5 * scene.source.length_mm
    found = ray_search(scene, np.linspace(-half, half, 401), "newton")
    truth = TrueLine.of_search(found.pixel, found.status == SearchStatus.FOUND, FILM_PX)
    return _compared(render_uncached(scene), truth, 0.05, end_px=2.0)
