"""Error budgets against draws of noise, air and poses, and against truths of other families."""

import functools

import numpy as np
import pytest

import virtual_sensor as vs
from virtual_sensor.metrology.covariance import WITHIN_95
from virtual_sensor.metrology.error_budget import _structure, known_air_shape_budget
from virtual_sensor.poses import Pose

ALONG = np.linspace(-10.0, 10.0, 31)
FREE = ("radius_mm", "y_mm", "z_mm")
CYLINDER = vs.CylinderShape(13.5, 0.0, -13.5)
SIGMA_PX = 0.02


@functools.cache
def scene(temperature=1100, **parameters):
    return vs.load_scene(
        "hot_cylinder", temperature=temperature, width=1024, height=1024, **parameters
    )


@functools.cache
def model():
    air = scene().medium
    return vs.AirModel.of(air.with_nodes(air.nodes[::4], spacing_mm=air.spacing * [4.0, 1.0, 1.0]))


@functools.cache
def searched(beta=0.0, field=None, **truth):
    lit = scene(beta=beta, **truth)
    found = vs.ray_search(lit if field is None else lit.with_medium(field), ALONG, "newton")
    return found.pixel, found.laser_point_mm


def line(pixel, beta=0.0, **options):
    return vs.Observation(scene(beta=beta), pixel, SIGMA_PX, name=f"beta{beta:g}", **options)


@functools.cache
def fitted(**truth):
    """One pose, a cylinder of unknown radius, in air of the 1100 degC field."""
    pixel, _ = searched(**truth)
    return vs.estimate_air(line(pixel), model(), shape=CYLINDER, free=FREE)


def test_known_air_spreads_as_draws_of_noise_air_and_pose_do():
    pixel, _ = searched()
    sigmas = {"scale": 0.02, "sensor_y": 0.01}
    budget = vs.known_air_budget(line(pixel), sigmas=sigmas)
    air, rows = scene().medium, slice(None, None, 6)

    def points(field, pixel=pixel, lit=None):
        return vs.triangulate(lit or scene(), pixel, medium=field)

    noise = np.random.default_rng(1).normal(0.0, SIGMA_PX, (400, 1)) * [0.0, 1.0]
    drawn = points(air, pixel[rows, None] + noise)
    spread = np.array([np.cov(each.T) for each in drawn])
    detection = budget.covariance_mm2["detection"][rows]
    np.testing.assert_allclose(
        np.trace(spread, axis1=1, axis2=2), np.trace(detection, axis1=1, axis2=2), rtol=0.25
    )
    by_scale = points(vs.AirModel.of(air).at(scale=1.02)) - points(air)
    moved = scene().with_sensor_moved(Pose.shift((0.0, 0.01, 0.0)))
    by_pose = points(air, lit=moved) - points(air)
    for source, by in (("air", by_scale), ("pose", by_pose)):
        along = 1e3 * np.abs(np.sum(budget.normal * by, axis=1))
        np.testing.assert_allclose(budget.sigma_um[source], along, rtol=0.03, atol=0.02)
    np.testing.assert_allclose(
        budget.parameter_um["sensor_y"] ** 2, budget.sigma_um["pose"] ** 2, rtol=1e-9, atol=1e-9
    )
    parts = [np.sign(um) * um**2 for um in budget.sigma_um.values()]
    np.testing.assert_allclose(budget.total_um**2, np.sum(parts, axis=0), rtol=1e-9)


def test_noise_of_an_estimate_is_in_the_points_once():
    budget = vs.error_budget(fitted(), families=())
    estimate, (points,) = fitted(), budget.points
    of_noise = points.total_mm2 - points.covariance_mm2["model"]
    np.testing.assert_allclose(of_noise, estimate.covariance_of_points(0), rtol=1e-9, atol=1e-15)
    assert not budget.sigma["model"].any()  # own air, without noise
    np.testing.assert_allclose(budget.interval[:, 1] - budget.values, WITHIN_95 * estimate.sigma)
    assert (points.sigma_um["correlation"] < 0.0).any()


def test_a_pose_that_is_not_fitted_moves_the_estimate_as_a_second_fit_says():
    seen = [line(searched(beta=beta)[0], beta) for beta in (0.0, 30.0)]

    def fit(observations):
        return vs.estimate_air(observations, model(), shape=CYLINDER, free=FREE)

    estimate = fit(seen)
    budget = vs.error_budget(estimate, sigmas={"sensor_y": 0.002}, families=())
    changes = []
    for i, each in enumerate(seen):
        moved = each.scene.with_sensor_moved(Pose.shift((0.0, 0.002, 0.0)))
        observations = list(seen)
        observations[i] = vs.Observation(moved, each.pixel, SIGMA_PX, name=each.name)
        changes.append(fit(observations).values - estimate.values)
    np.testing.assert_allclose(
        budget.sigma["pose"], np.sqrt(np.sum(np.square(changes), axis=0)), rtol=0.05, atol=1e-6
    )


def test_residuals_show_what_noise_cannot_do():
    random = np.random.default_rng(3)
    white = [_structure(random.normal(size=200)) for _ in range(50)]
    assert sum(each.long_run > 1.0 for each in white) < 10
    wave = 2.0 * np.sin(np.arange(200) / 8.0) + random.normal(size=200)
    found = _structure(wave)
    assert abs(found.excess - 2.0) < 0.7
    assert found.correlated > 5.0
    assert _structure(3.0 * random.normal(size=200)).long_run > 6.0


def test_a_circle_through_the_points_is_as_sure_as_the_one_that_was_fitted_with_the_air():
    budget = vs.error_budget(fitted(), sigmas={"sensor_y": 0.002}, families=())
    circle = budget.of_shape(CYLINDER, FREE)
    k = [budget.names.index(name) for name in FREE]
    np.testing.assert_allclose(circle.values, budget.values[k], atol=2e-5)
    for source in ("noise", "pose"):
        np.testing.assert_allclose(
            circle.sigma[source], budget.sigma[source][k], rtol=0.05, atol=1e-5
        )


def test_a_circle_through_known_air_moves_with_it_as_a_whole():
    pixel, points = searched()
    air, known = scene().medium, {"scale": 0.02, "sensor_y": 0.01}
    circle = known_air_shape_budget(
        [vs.known_air_budget(line(pixel), sigmas=known)], CYLINDER, FREE
    )
    hotter = vs.triangulate(scene(), pixel, medium=vs.AirModel.of(air).at(scale=1.02))
    moved = scene().with_sensor_moved(Pose.shift((0.0, 0.01, 0.0)))
    for source, other in (("air", hotter), ("pose", vs.triangulate(moved, pixel, medium=air))):
        change = CYLINDER.fitted(other, FREE), CYLINDER.fitted(points, FREE)
        off = [getattr(change[0], name) - getattr(change[1], name) for name in FREE]
        np.testing.assert_allclose(circle.sigma[source], np.abs(off), rtol=0.05, atol=2e-4)
    random, drawn = np.random.default_rng(2), []
    for _ in range(200):
        noise = random.normal(0.0, SIGMA_PX, (len(pixel), 1)) * [0.0, 1.0]
        drawn.append(CYLINDER.fitted(vs.triangulate(scene(), pixel + noise), FREE).radius_mm)
    assert np.std(drawn) == pytest.approx(circle.sigma["noise"][0], rel=0.2)


def test_parameters_that_contradict_what_is_known_widen_the_interval():
    """In one line a wrong kind of air leaves no residual: only its parameters look strange."""
    usual, strange = fitted(), fitted(widen=2.75, blur=7.2)
    budgets = [vs.error_budget(each, families=()) for each in (usual, strange)]
    k = usual.names.index("radius_mm")
    assert budgets[0].sigma["model"][k] == 0.0
    off = strange["radius_mm"] - 13.5
    assert abs(off) > 2.0 * WITHIN_95 * strange.sigma[k]
    assert abs(off) < WITHIN_95 * budgets[1].total[k]
    assert strange.rms_px < SIGMA_PX


@pytest.mark.slow
def test_the_models_term_holds_what_air_of_another_family_leaves():
    y = np.linspace(-10.9, 10.9, 61)
    found = vs.ray_search(vs.load_scene("hot_cylinder", temperature=1250, blur=2), y, "newton")
    true, random = found.laser_point_mm, np.random.default_rng(5)
    noisy = found.pixel + random.normal(0.0, SIGMA_PX, (len(y), 1)) * [0.0, 1.0]
    seen = vs.Observation(vs.load_scene("hot_cylinder", temperature=1100), noisy, SIGMA_PX)
    estimate = vs.estimate_air(seen, model(), shape=CYLINDER, free=FREE)
    budget = vs.error_budget(estimate)
    k = budget.names.index("radius_mm")
    assert abs(estimate["radius_mm"] - 13.5) > 0.02
    assert abs(estimate["radius_mm"] - 13.5) < WITHIN_95 * budget.total[k]
    assert abs(estimate["radius_mm"] - 13.5) > 5.0 * estimate.sigma[k]
    (points,) = budget.points
    off = 1e3 * np.sum(points.normal * (points.point_mm - true), axis=1)
    assert np.mean(np.abs(off) <= WITHIN_95 * points.sigma_um["model"]) >= 0.9


def test_what_no_budget_has_is_refused():
    for sigmas, families, says in (
        ({"sensor_q": 1.0}, (), "sensor_q"),
        ({}, [("scale",)], "not fitted"),
        ({}, ["blur"], "lists of parameters"),
    ):
        with pytest.raises(vs.InputError, match=says):
            vs.error_budget(fitted(), sigmas=sigmas, families=families)
    with pytest.raises(vs.InputError, match="sensor_q"):
        vs.known_air_budget(line(searched()[0]), sigmas={"sensor_q": 1.0})


@pytest.mark.slow
def test_estimates_scatter_as_their_covariance_says():
    """Rationale: `benchmarks/correction.py --trials 2000` does the same at length."""
    random = np.random.default_rng(8)
    prior = {"scale": vs.Prior(1.0, 0.1), "width": vs.Prior(1.0, 0.1)}
    shape = {"radius_mm": 13.5, "y_mm": 0.0, "z_mm": -13.5}
    squares = []
    for _ in range(16):
        drawn = {name: random.normal(each.value, each.sigma) for name, each in prior.items()}
        pixel = vs.ray_search(scene().with_medium(model().at(**drawn)), ALONG, "newton").pixel
        pixel = pixel + random.normal(0.0, SIGMA_PX, (len(pixel), 1)) * [0.0, 1.0]
        found = vs.estimate_air(line(pixel), model(), shape=CYLINDER, free=FREE, priors=prior)
        off = found.values - [(drawn | shape)[name] for name in found.names]
        squares.append(off @ np.linalg.solve(found.covariance, off))
    # 16 times 5 numbers of unit variance: 99.9 % of such sums.
    assert 44.0 < np.sum(squares) < 130.0
