"""Where corrections fail: fields that end too early, strong and wrong air, poses that are wrong.

Searched pixels without noise; a point with the status OK that is off by more than a bound is wrong.
"""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from functools import cache, partial
from typing import Any

import numpy as np
from numpy.typing import NDArray
from worsening import Case, Outcome, judged

from virtual_sensor.imaging.scene import Scene, load_scene
from virtual_sensor.medium.air_model import AirModel
from virtual_sensor.metrology.air_estimate import estimate_air
from virtual_sensor.metrology.observations import Observation
from virtual_sensor.metrology.shapes import CylinderShape
from virtual_sensor.metrology.triangulation import triangulated_points
from virtual_sensor.optics.crossing_status import CrossingStatus
from virtual_sensor.optics.ray_search import FoundPixels, SearchStatus, ray_search
from virtual_sensor.poses import Pose

Array = NDArray[np.float64]

Y_MM = np.linspace(-10.0, 10.0, 61)
WRONG_PX = 0.1
"""Of points through air that is estimated, or known not quite."""
NOISE_PX = 0.02
SEEN_CHI2 = 0.5
"""By so much a model's own error raises chi2 above the 1 of noise alone: that is seen."""

_FREE = ("radius_mm", "y_mm", "z_mm")
_START = CylinderShape(radius_mm=13.0, z_mm=-13.0)
_ESTIMATES = {
    "air found on a known shape": ((0.0,), ()),
    "air found from one pose": ((0.0,), _FREE),
    "air found from two poses": ((0.0, 30.0), _FREE),
}


def cases() -> Iterator[Case]:
    """All of them."""
    points = f"{len(Y_MM)} points of hot_cylinder"
    for words, method in (("maps", "tabulated"), ("marched rays", "newton")):
        yield Case(
            "the air's field ends too early",
            f"known air, by {words}",
            (265.0, 230.0, 200.0, 180.0, 170.0, 160.0, 150.0, 140.0, 130.0, 100.0, 60.0, 30.0),
            "mm above the part where it ends",
            partial(_cut, method),
            points,
            "give a field that reaches up to where it has faded, or to camera and laser",
        )
        yield Case(
            "air that bends light too sharply",
            f"known air, by {words}",
            (1.0, 2.0, 5.0, 10.0, 20.0, 50.0),
            "times the contrast of 1250 °C",
            partial(_strong, method),
            f"{points} that have a pixel",
            "caustics are named",
        )
    yield Case(
        "air known wrong",
        "known air",
        (1e-4, 1e-3, 1e-2, 1e-1),
        "of its contrast",
        _wrong_contrast,
        f"{points}; wrong is a point off by more than {WRONG_PX:g} px",
        "nothing in one line shows it",
        silent=True,
        factor=1.5,
    )
    conditions = f"{points}; scale and width are found; wrong is a point off by {WRONG_PX:g} px"
    for method, (betas, free) in _ESTIMATES.items():
        yield Case(
            "air of another family",
            method,
            (0.25, 0.5, 1.0, 2.0, 4.0, 8.0),
            "mm of blur that the model does not know",
            partial(_blurred, betas, free),
            conditions,
            "a small residual proves nothing: measure from two poses",
        )
    yield Case(
        "a pose known wrong",
        "air found from two poses",
        (1.0, 3.0, 10.0, 30.0, 100.0, 300.0),
        "µm along y that the second sensor stands beside its place",
        _misplaced,
        conditions,
        "let the pose be found, too, with a prior",
    )


@cache
def _scene(beta: float) -> Scene:
    return load_scene("hot_cylinder", beta=beta)


@cache
def _searched(beta: float, **air: float) -> FoundPixels:
    """The pixels in the scene's air, with parameters of its model changed."""
    scene = _scene(beta)
    return ray_search(scene.with_medium(_air(**air)) if air else scene, Y_MM, "newton")


@cache
def _air(scale: float = 1.0, **changed: float) -> Any:
    """The scene's air with another contrast, and other parameters of its model."""
    air = AirModel.of(_scene(0.0).medium).at(**changed)
    return air.with_nodes(air.ambient + scale * (air.nodes - air.ambient))


def _known(found: FoundPixels, medium: Any, method: str, wrong_px: float) -> Outcome:
    """Points through a field, of those laser rays that have a pixel."""
    has = found.status == SearchStatus.FOUND
    points = triangulated_points(_scene(0.0), found.pixel[has], medium=medium, method=method)
    error = _error_px(points.point_mm, found.laser_point_mm[has])
    return judged(points.status, [CrossingStatus.OK], error, wrong_px)


def _error_px(points: Array, truth: Array) -> Array:
    mm: Array = np.linalg.norm(points - truth, axis=1)
    return mm / _scene(0.0).camera.pixel_mm(truth)


def _cut(method: str, top_mm: float) -> Outcome:
    field = _scene(0.0).medium
    nodes = round((top_mm - field.origin[2]) / field.spacing[2]) + 1
    return _known(_searched(0.0), field.with_nodes(field.nodes[:, :, :nodes]), method, 0.01)


def _strong(method: str, factor: float) -> Outcome:
    return _known(_searched(0.0, scale=factor), _air(scale=factor), method, 0.01)


def _wrong_contrast(share: float) -> Outcome:
    return _known(_searched(0.0), _air(scale=1.0 + share), "newton", WRONG_PX)


def _estimated(seen: Sequence[Observation], free: tuple[str, ...], truth: Array) -> Outcome:
    """Points of the first pose; a residual beyond the noise reports them all."""
    shape = _START if free else CylinderShape()
    found = estimate_air(list(seen), _scene(0.0).medium, shape=shape, free=free)
    error = _error_px(found.points[0].point_mm, truth)
    reported = np.full(len(error), found.chi2 > SEEN_CHI2)
    wrong = ~reported & ~(error <= WRONG_PX)
    names = ["a residual beyond the noise"] * bool(reported.any())
    return Outcome(reported, wrong, names, 0.0 if reported.all() else float(error.max()))


def _blurred(betas: tuple[float, ...], free: tuple[str, ...], blur_mm: float) -> Outcome:
    found = [_searched(beta, blur=blur_mm) for beta in betas]
    seen = [
        Observation(_scene(beta), each.pixel, NOISE_PX)
        for beta, each in zip(betas, found, strict=True)
    ]
    return _estimated(seen, free, found[0].laser_point_mm)


def _misplaced(shift_um: float) -> Outcome:
    """The second sensor is thought to stand beside its place."""
    betas, free = _ESTIMATES["air found from two poses"]
    found, scenes = [_searched(beta) for beta in betas], [_scene(beta) for beta in betas]
    scenes[1] = scenes[1].with_sensor_moved(Pose(np.eye(3), np.array([0.0, shift_um / 1e3, 0.0])))
    seen = [
        Observation(scene, each.pixel, NOISE_PX) for scene, each in zip(scenes, found, strict=True)
    ]
    return _estimated(seen, free, found[0].laser_point_mm)
