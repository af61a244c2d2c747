"""Correction through air that is not the model's, and whether its error budget holds what is left.

python benchmarks/correction.py [--noise 0.02] [--draws 8] [--trials 2000] [-o FOLDER]

Truths are pixels of the ray search through air of another family; the model is the field of
1100 degC, scaled and widened. With --trials instead: the air is drawn from the prior that the
fit uses, and it is counted how often intervals of 95 % hold the truth.
"""

from __future__ import annotations

import argparse
import time
from collections.abc import Callable, Iterator, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray
from scipy import ndimage

import virtual_sensor as vs
from virtual_sensor.files import written_whole
from virtual_sensor.metrology.covariance import WITHIN_95, variance_along
from virtual_sensor.poses import Pose
from virtual_sensor.records import write_csv

Array = NDArray[np.float64]

LASER_Y_MM = np.linspace(-10.9, 10.9, 61)
BETAS = (0, 15, 30)
RADIUS_MM, AXIS_Z_MM = 13.5, -13.5
FREE = ("radius_mm", "y_mm", "z_mm")
POSE = tuple(f"sensor_{turn}{axis}" for turn in ("", "turn_") for axis in "xyz")
POSE_SIGMA = dict(zip(POSE, [0.01] * 3 + [np.degrees(50e-6)] * 3, strict=True))
PRIORS = {"scale": (1.0, 0.1), "width": (1.0, 0.1), "offset": (0.0, 0.3)}
LEAN_DEG, LEAN_FROM_MM = 2.0, 5.0


def leaning(field: vs.IndexField) -> vs.IndexField:
    """The air as a draught leans it: above the part, each height is shifted along y."""
    whole = np.concatenate([field.nodes[:, :0:-1], field.nodes], axis=1) - field.ambient
    z = np.maximum(field.origin[2] + field.spacing[2] * np.arange(whole.shape[2]), 0.0)
    shift = np.tan(np.radians(LEAN_DEG)) * (z - LEAN_FROM_MM * (1.0 - np.exp(-z / LEAN_FROM_MM)))
    moved = [
        ndimage.shift(whole[:, :, k], (0.0, shift[k] / field.spacing[1])) for k in range(len(z))
    ]
    origin = field.origin - [0.0, field.spacing[1] * (field.shape[1] - 1), 0.0]
    return vs.IndexField.from_arrays(
        field.ambient + np.stack(moved, axis=2),
        origin,
        field.spacing,
        ambient=field.ambient,
        mirror=(field.mirror[0], False, field.mirror[2]),
    )


TRUTHS: dict[str, tuple[dict[str, float], Callable[[Any], Any]]] = {
    "1250 degC": ({}, lambda field: field),
    "1250 degC, blurred 2 mm": ({"blur": 2.0}, lambda field: field),
    "widened 2.75, blurred 7.2 mm": ({"widen": 2.75, "blur": 7.2}, lambda field: field),
    "1250 degC, leaning 2 degrees": ({}, leaning),
}
"""Parameters of the scene, and what is done to its air then."""


@dataclass(frozen=True)
class Seen:
    """What a pose sees of a truth.

    Attributes
    ----------
    pixel : ndarray of shape (N, 2)
    point_mm : ndarray of shape (N, 3)
    """

    pixel: Array
    point_mm: Array


def seen_from(truth: str, beta: float) -> Seen:
    """Search the line through the truth's air."""
    parameters, changed = TRUTHS[truth]
    scene = vs.load_scene("hot_cylinder", temperature=1250, beta=beta, **parameters)
    scene = scene.with_medium(changed(scene.medium))
    found = vs.ray_search(scene, LASER_Y_MM, "newton")
    return Seen(found.pixel, found.laser_point_mm)


@dataclass(frozen=True)
class Row:
    """One fit.

    Attributes
    ----------
    what, truth : str
    radius_um, half_um, uncorrected_um : float
        Error of the radius, half its interval of 95 %, and the error without a correction.
    point_um, surface_um, point_uncorrected_um, surface_uncorrected_um : float
        Root mean square of what is left: distance from the true point, and along the normal.
    model_holds, holds, space_holds : float
        Share of points whose error along the normal the model's term alone holds (95 %), the
        whole interval holds, and whose error in space the model's term holds.
    residual_px, seconds : float
    """

    what: str
    truth: str
    radius_um: float
    half_um: float
    uncorrected_um: float
    point_um: float
    surface_um: float
    point_uncorrected_um: float
    surface_uncorrected_um: float
    model_holds: float
    holds: float
    space_holds: float
    residual_px: float
    seconds: float


def main() -> None:
    """Run what is asked for, and print it."""
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("--noise", type=float, default=0.02, help="of the line's centres, px")
    parser.add_argument("--draws", type=int, default=8, help="of noise, and of wrong poses")
    parser.add_argument("--only", default="", help="truths whose name has this text")
    parser.add_argument("--trials", type=int, default=0, help="count coverage in so many trials")
    parser.add_argument("--betas", type=float, nargs="+", default=[0.0], help="poses of a trial")
    parser.add_argument("--seed", type=int, default=0)
    parser.add_argument("-o", "--output", type=Path, help="CSV of all rows")
    given = parser.parse_args()
    if given.trials:
        trials(given.trials, given.betas, given.noise, given.seed)
        return
    rows = []
    for truth in (name for name in TRUTHS if given.only in name):
        for row in rows_of(truth, given.noise, given.draws):
            rows.append(row)
            print(line_of(row), flush=True)
    if given.output:
        with written_whole(given.output) as path:
            write_csv(path, {key: [vars(row)[key] for row in rows] for key in vars(rows[0])})


def rows_of(truth: str, noise_px: float, draws: int) -> Iterator[Row]:
    """All fits of a truth."""
    rng = np.random.default_rng(4)
    air = vs.load_scene("hot_cylinder", temperature=1100).medium
    scenes = {beta: vs.load_scene("hot_cylinder", temperature=1100, beta=beta) for beta in BETAS}
    seen = {beta: seen_from(truth, beta) for beta in BETAS}

    def fitted(
        what: str,
        betas: Sequence[float],
        noise: float = 0.0,
        wrong: Callable[[Any], Any] = lambda scene: scene,
        shape: Any = None,
        sigmas: Any = None,
        dots: bool = False,
        **more: Any,
    ) -> Row:
        """A fit; `wrong` gives the scene of the second pose as it is believed to stand."""
        observations = []
        for number, beta in enumerate(betas):
            scene = scenes[beta] if number == 0 else wrong(scenes[beta])
            shift = rng.normal(0.0, noise, (len(LASER_Y_MM), 2)) * ([1.0, 1.0] if dots else [0, 1])
            observations.append(
                vs.Observation(
                    scene,
                    seen[beta].pixel + shift,
                    noise_px,
                    along_mm=LASER_Y_MM if dots else None,
                    name=f"beta {beta:g}",
                )
            )
        start = time.perf_counter()
        estimate = vs.estimate_air(observations, air, shape=shape, **more)
        seconds = time.perf_counter() - start
        budget = vs.error_budget(estimate, sigmas=sigmas)
        true = [seen[beta].point_mm for beta in betas]
        return row_of(what, truth, estimate, budget, true, seconds)

    cylinder = vs.CylinderShape(RADIUS_MM, 0.0, AXIS_Z_MM)
    free = {"shape": cylinder, "free": FREE}
    yield fitted("shape known, beta 0", (0,), shape=cylinder)
    yield fitted("epipolar residual, beta 0", (0,), dots=True)
    for betas in ((0,), (0, 30), (0, 15)):
        what = f"line, beta {' and '.join(map(str, betas))}"
        yield fitted(what, betas, **free)
        for _ in range(draws):
            yield fitted(f"{what}, noise", betas, noise_px, **free)
    for betas in ((0, 30), (0, 15)):
        what = f"line, beta {' and '.join(map(str, betas))}, poses"
        priors = {name: vs.Prior(0.0, sigma) for name, sigma in POSE_SIGMA.items()}
        second = [f"beta {betas[1]}.{name}" for name in POSE]
        for _ in range(draws):
            wrong = misplaced(rng)
            yield fitted(f"{what} wrong", betas, noise_px, wrong, sigmas=POSE_SIGMA, **free)
            yield fitted(
                f"{what} unknown", betas, noise_px, wrong, pose_names=second, priors=priors, **free
            )


def misplaced(rng: np.random.Generator) -> Callable[[Any], Any]:
    """A scene whose sensor is believed to stand a little beside its place."""
    shift, turn = rng.normal(0.0, 0.01, 3), rng.normal(0.0, np.degrees(50e-6), 3)
    angle = float(np.linalg.norm(turn))
    motion = Pose.turn(angle, turn / angle).moved(Pose.shift(shift))
    return lambda scene: scene.with_sensor_moved(motion)


def row_of(
    what: str, truth: str, estimate: Any, budget: Any, true: Sequence[Array], seconds: float
) -> Row:
    """What a fit leaves, and whether its budget holds it."""
    points = np.concatenate([each.point_mm for each in estimate.points])
    straight = np.concatenate(
        [vs.triangulate(each.scene, each.pixel) for each in estimate.observations]
    )
    target = np.concatenate(true)
    normal = (target - [0.0, 0.0, AXIS_Z_MM]) * [0.0, 1.0, 1.0] / RADIUS_MM
    off, off_straight = (1e3 * (each - target) for each in (points, straight))
    surface = np.sum(normal * off, axis=1)
    model = np.concatenate([each.covariance_mm2["model"] for each in budget.points])
    along = 1e3 * np.sqrt(variance_along(normal, model))
    in_space = 1e3 * np.sqrt(np.trace(model, axis1=1, axis2=2))
    whole = np.concatenate([each.interval_um for each in budget.points])
    half = np.nan
    if "radius_mm" in budget.names:
        half = 1e3 * WITHIN_95 * budget.total[budget.names.index("radius_mm")]
    return Row(
        what,
        truth,
        1e3 * (circle(points)[2] - RADIUS_MM),
        half,
        1e3 * (circle(straight)[2] - RADIUS_MM),
        rms(np.linalg.norm(off, axis=1)),
        rms(surface),
        rms(np.linalg.norm(off_straight, axis=1)),
        rms(np.sum(normal * off_straight, axis=1)),
        float(np.mean(np.abs(surface) <= WITHIN_95 * along)),
        float(np.mean(np.abs(surface) <= whole)),
        float(np.mean(np.linalg.norm(off, axis=1) <= WITHIN_95 * in_space)),
        estimate.rms_px,
        seconds,
    )


def circle(points: Array) -> Array:
    """Centre and radius (y, z, R) of the circle nearest to points."""
    fit = vs.fit_cylinder(points, direction=(1.0, 0.0, 0.0))
    return np.array([*fit.axis_point_mm[1:], fit.radius_mm])


def rms(values: Array) -> float:
    """Root mean square."""
    return float(np.sqrt(np.mean(values**2)))


def line_of(row: Row) -> str:
    """A row as it is printed."""
    radius = f"dR {row.radius_um:7.1f} +- {row.half_um:5.1f} um ({row.uncorrected_um:6.1f})"
    points = f"points {row.point_um:5.1f} um ({row.point_uncorrected_um:.0f})"
    surface = f"surface {row.surface_um:5.1f} um ({row.surface_uncorrected_um:.0f})"
    model = f"held by the model's term {row.model_holds:.2f} (in space {row.space_holds:.2f})"
    return (
        f"{row.truth:30s} {row.what:36s} {radius}, {points}, {surface}, {model}, by all"
        f" {row.holds:.2f}; {row.residual_px:.4f} px, {row.seconds:.1f} s"
    )


def trials(count: int, betas: Sequence[float], noise_px: float, seed: int) -> None:
    """Count how often intervals hold the truth, and compare the scatter with the bound."""
    rng = np.random.default_rng(seed)
    air = vs.load_scene("hot_cylinder", temperature=1100).medium
    thin = air.with_nodes(air.nodes[::4], spacing_mm=air.spacing * [4.0, 1.0, 1.0])
    model = vs.AirModel.of(thin)
    scenes = [vs.load_scene("hot_cylinder", temperature=1100, beta=beta) for beta in betas]
    priors = {name: vs.Prior(*prior) for name, prior in PRIORS.items()}
    shape = vs.CylinderShape(RADIUS_MM, 0.0, AXIS_Z_MM)
    known = {"radius_mm": RADIUS_MM, "y_mm": 0.0, "z_mm": AXIS_Z_MM}
    off, held = [], []
    for number in range(count):
        drawn = {name: rng.normal(*prior) for name, prior in PRIORS.items()}
        medium, observations, true = model.at(**drawn), [], []
        for beta, scene in zip(betas, scenes, strict=True):
            found = vs.ray_search(scene.with_medium(medium), LASER_Y_MM, "newton")
            noise = rng.normal(0.0, noise_px, len(LASER_Y_MM))
            pixel = found.pixel + noise[:, None] * [0.0, 1.0]
            observations.append(vs.Observation(scene, pixel, noise_px, name=f"{beta:g}"))
            true.append(found.laser_point_mm)
        estimate = vs.estimate_air(
            observations,
            model,
            tuple(PRIORS),
            shape=shape,
            free=FREE,
            priors=priors,
            tolerance_px=1e-3,
        )
        truth = np.array([(drawn | known)[name] for name in estimate.names])
        off.append((estimate.values - truth) / estimate.sigma)
        held.append([np.mean(np.abs(off[-1]) <= WITHIN_95), _points_held(estimate, true)])
        if number + 1 == count or (number + 1) % 50 == 0:
            table = np.array(off)
            inside = np.mean(np.abs(table) <= WITHIN_95, axis=0)
            scatter = np.sqrt(np.mean(table**2, axis=0))
            each = (
                f"{name} {100 * share:.1f} % held, scatter {ratio:.3f} of the bound"
                for name, share, ratio in zip(estimate.names, inside, scatter, strict=True)
            )
            whole = 100 * np.mean(held, axis=0)
            print(
                f"{number + 1} trials: {'; '.join(each)}; all parameters {whole[0]:.1f} %,"
                f" points {whole[1]:.1f} %",
                flush=True,
            )


def _points_held(estimate: Any, true: Sequence[Array]) -> float:
    """Share of points whose error along the normal lies within 95 %, by noise and priors alone."""
    shares = []
    for i, target in enumerate(true):
        normal = (target - [0.0, 0.0, AXIS_Z_MM]) * [0.0, 1.0, 1.0] / RADIUS_MM
        covariance = estimate.covariance_of_points(i)
        sigma = np.sqrt(variance_along(normal, covariance))
        off = np.sum(normal * (estimate.points[i].point_mm - target), axis=1)
        shares.append(np.mean(np.abs(off) <= WITHIN_95 * sigma))
    return float(np.mean(shares))


if __name__ == "__main__":
    main()
