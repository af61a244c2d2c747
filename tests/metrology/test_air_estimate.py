"""Air, radius and poses from images: truths are searched pixels, in air of the model or not."""

import functools
import json
from dataclasses import replace
from types import SimpleNamespace

import numpy as np
import pytest
from scipy.interpolate import CubicSpline

import virtual_sensor as vs
from virtual_sensor.errors import InputError
from virtual_sensor.metrology.air_problem import problem_of
from virtual_sensor.metrology.identifiability import EstimateStatus

ALONG = np.linspace(-10.0, 10.0, 31)
FREE = ("radius_mm", "y_mm", "z_mm")
START = vs.CylinderShape(13.0, 0.3, -13.0)
RADIUS = 13.5


@functools.cache
def scene(temperature=1100, **parameters):
    return vs.load_scene("hot_cylinder", temperature=temperature, **parameters)


@functools.cache
def model():
    return vs.AirModel.of(scene().medium)


@functools.cache
def own_air():
    return model().at(scale=1.1, width=1.04)


def searched(lit, noise=0.0, seed=1):
    pixel = np.asarray(vs.ray_search(lit, ALONG, "newton").pixel)
    return pixel + np.c_[0.0 * ALONG, noise * np.random.default_rng(seed).normal(size=ALONG.size)]


@functools.cache
def line_in_own_air(beta=0):
    return vs.Observation(scene(beta=beta), searched(scene(beta=beta).with_medium(own_air())))


def moved(lit, pose, part="source"):
    """A scene whose camera or laser is moved; quicker than loading it again."""
    devices = {"camera": lit.camera, "source": lit.source}
    device = devices[part]
    devices[part] = device.with_pose(device.pose.moved(pose))
    return SimpleNamespace(medium=lit.medium, surface=lit.surface, **devices)


def test_two_poses_make_air_of_an_unknown_family_visible():
    """Rationale: the headline. One pose explains the same line by another radius."""
    truth = {"temperature": 1250, "widen": 2.75, "blur": 7.2}
    lines = [
        vs.Observation(scene(beta=beta), searched(scene(beta=beta, **truth), 0.01, beta))
        for beta in (0, 30)
    ]
    found = vs.estimate_air(lines, model(), shape=START, free=FREE)
    assert abs(found["radius_mm"] - RADIUS) < 2e-3
    assert found.converged
    alone = vs.estimate_air(lines[0], model(), shape=START, free=FREE)
    assert abs(alone["radius_mm"] - RADIUS) > 50e-3
    assert alone.rms_px < found.rms_px  # a small residual proves nothing


def test_air_of_the_models_own_family_is_found():
    line = line_in_own_air()
    dots = replace(line, along_mm=ALONG, normal_deg=None)
    for seen, options in (
        (line, {"shape": START, "free": FREE}),
        (dots, {}),  # no shape at all
        (dots, {"shape": START, "free": FREE}),
    ):
        found = vs.estimate_air(seen, model(), **options)
        assert abs(found["scale"] - 1.1) < 1e-5
        assert abs(found["width"] - 1.04) < 1e-5
        assert (found.status == EstimateStatus.FOUND).all()
        assert found.rms_px < 1e-5
        truth = vs.ray_search(scene().with_medium(own_air()), ALONG, "newton").laser_point_mm
        assert np.abs(found.points[0].point_mm - truth).max() < 1e-5
    assert abs(found["radius_mm"] - RADIUS) < 1e-5


@pytest.mark.slow
def test_derivatives_are_those_of_differences():
    """Rationale: a wrong one makes a fit slow, and what it tells of its errors wrong."""
    poses = ["camera_x", "camera_turn_z", "sensor_y", "sensor_turn_x", "laser_turn_y"]
    poses += ["laser_offset", "laser_tilt", "laser_roll"]
    dots = replace(line_in_own_air(30), along_mm=ALONG + 0.1, normal_deg=None)
    names, pivot = ["scale", "offset", "blur"], (1.0, 2.0, 3.0)
    problem = problem_of([dots], model(), names, [], START, FREE, poses, None, None, pivot, None)
    problem = replace(problem, step_mm=None)
    x = np.array([u.start for u in problem.unknowns])
    at = problem.at(x)
    for k, unknown in enumerate(problem.unknowns):
        size = 3e-2 if unknown.kind == "air" else 1e-3
        step = np.where(np.arange(len(x)) == k, size, 0.0)
        ends = [problem.at(x + sign * step, at).linear[0].residual for sign in (1.0, -1.0)]
        change = (ends[0] - ends[1]) / (2.0 * size)
        by = at.linear[0].by[:, :, k]
        assert np.allclose(by, change, rtol=0.0, atol=1e-3 * np.abs(by).max()), unknown.name


def test_a_prior_that_the_data_contradict_is_told():
    """Rationale: all intervals rest on it, and held none of the truth, without a word."""
    part = vs.CylinderShape(RADIUS, 0.0, -RADIUS)
    for value, wrong in ((1.0, True), (1.1, False)):
        priors = {"scale": vs.Prior(value, 0.01)}
        found = vs.estimate_air(line_in_own_air(), model(), shape=part, priors=priors)
        assert any("off its prior" in note for note in found.notes) == wrong


def test_outliers_and_what_is_not_finite_change_nothing():
    line = line_in_own_air()
    random = np.random.default_rng(2)
    pixel = line.pixel + np.c_[0.0 * ALONG, random.normal(0.0, 0.02, ALONG.size)]
    options = {"shape": START, "free": FREE}
    clean = vs.estimate_air(replace(line, pixel=pixel), model(), **options)
    pixel = np.concatenate([pixel, pixel[[4, 15, 27]] + [0.0, 5.0], np.full((2, 2), np.nan)])
    bad = vs.Observation(line.scene, pixel)
    found = vs.estimate_air(bad, model(), **options)
    assert found.used[0].sum() == ALONG.size
    assert np.allclose(found.values, clean.values, rtol=0.0, atol=1e-6)
    assert any("3 of 34 points left out" in note for note in found.notes)
    assert np.isnan(found.residual_px[0][-2:]).all()


def test_few_dots_that_the_model_does_not_fit_all_take_part():
    """Rationale: two of nine were left out as outliers, and the budget told 0.5 um of 11."""
    y_mm = np.linspace(-10.0, 10.0, 9)
    truth = vs.ray_search(scene(temperature=1250, blur=2), y_mm, "newton")
    found = vs.estimate_air(vs.Observation(scene(), truth.pixel, along_mm=y_mm), model())
    assert found.used[0].all()
    assert found.chi2 > 2.0


def test_standard_deviations_are_what_noise_does():
    """By another fit, with one pixel moved, which does not use the formula."""
    lines = [line_in_own_air(beta) for beta in (0, 30)]
    options = {"shape": START, "free": FREE, "tolerance_px": 1e-9}
    found = vs.estimate_air(lines, model(), **options)
    pixel = lines[1].pixel.copy()
    pixel[6, 1] += 0.01
    again = vs.estimate_air([lines[0], replace(lines[1], pixel=pixel)], model(), **options)
    expected = 0.01 * found.by_pixel(1)[6, :, 1]
    assert np.allclose(again.values - found.values, expected, rtol=5e-3, atol=1e-8)
    change = again.points[1].point_mm[6] - found.points[1].point_mm[6]
    direct = found.points[1].point_by_pixel[6, :, 1] + found.points_by(1)[6] @ expected / 0.01
    assert np.allclose(change, 0.01 * direct, atol=1e-8)
    noise = 0.0
    for i, line in enumerate(lines):
        gain = found.by_pixel(i)
        noise = noise + (gain @ line.covariance_px2 @ gain.transpose(0, 2, 1)).sum(axis=0)
    assert np.allclose(noise, found.covariance, rtol=1e-6, atol=1e-16)
    of_points = found.covariance_of_points(1)
    assert (np.linalg.eigvalsh(of_points) > -1e-15).all()


def test_a_wrong_pose_is_found_with_its_prior():
    shift = vs.Pose.shift((0.0, 0.006, -0.008))
    truth = moved(scene(beta=30).with_medium(own_air()), shift)
    truth = moved(truth, shift, "camera")
    lines = [line_in_own_air(), vs.Observation(scene(beta=30), searched(truth), name="b")]
    options = {"shape": START, "free": FREE}
    wrong = vs.estimate_air(lines, model(), **options)
    assert abs(wrong["radius_mm"] - RADIUS) > 2e-3
    found = vs.estimate_air(
        lines,
        model(),
        **options,
        pose_names=["b.sensor_y", "b.sensor_z"],
        priors={"sensor_y": vs.Prior(0.0, 0.01), "sensor_z": vs.Prior(0.0, 0.01)},
    )
    assert abs(found["radius_mm"] - RADIUS) < 1e-4
    assert abs(found["b.sensor_y"] - 0.006) < 1e-4
    assert abs(found["b.sensor_z"] + 0.008) < 1e-4


def test_the_lasers_plane_is_found_on_a_known_shape():
    cold = scene().cold()
    x, y, _ = cold.source.pose.rotation.T
    target = cold.source.target_mm
    motion = vs.Pose.turn(0.05, y, target).moved(vs.Pose.shift(0.1 * x))
    seen = vs.Observation(cold, searched(moved(cold, motion)))
    options = {"shape": vs.PartShape.of(cold), "pose_names": ["laser_offset", "laser_tilt"]}
    found = vs.estimate_air(seen, None, (), **options)
    assert abs(found["laser_offset"] - 0.1) < 1e-5
    assert abs(found["laser_tilt"] - 0.05) < 1e-5


def test_what_images_do_not_tell_is_named_or_refused():
    line = line_in_own_air()
    options = {"shape": START, "free": FREE}
    both = vs.identifiability(line, model(), ["scale", "pressure"], **options)
    assert both.status.tolist()[:2] == [EstimateStatus.FOUND, EstimateStatus.NOT_TOLD_APART]
    assert any("pressure can't be told from scale" in note for note in both.notes)
    assert np.isinf(both.bound[:2]).all() or both.condition > 1e3
    prior = {"scale": vs.Prior(1.0, 1e-6)}
    known = vs.estimate_air(line, model(), ["scale"], **options, priors=prior)
    assert known.status[0] == EstimateStatus.PRIOR
    for wrong, options in {
        "lines say nothing without a shape": {},
        "did you mean 'scale'": {"shape": START, "names": ["scal"]},
        "'sensor_q'": {"shape": START, "pose_names": ["sensor_q"]},
        "not sought": {"shape": START, "priors": {"blur": vs.Prior(1.0, 1.0)}},
        "both known and": {"shape": START, "known": {"scale": 1.0}},
    }.items():
        with pytest.raises(InputError, match=wrong):
            vs.estimate_air(line, model(), **options)
    cold, plane = scene().cold(), vs.PlaneShape()
    straight = cold.camera.project(np.c_[0.0 * ALONG, ALONG, 0.0 * ALONG])
    flat = vs.Observation(cold, straight)
    with pytest.raises(InputError, match="say nothing of turn_y_deg"):
        vs.estimate_air(flat, None, (), shape=plane, free=plane.names)
    none = vs.Observation(line.scene, np.full((4, 2), np.nan), name="dark")
    with pytest.raises(InputError, match="'dark' has no point"):
        vs.estimate_air([line, none], model(), shape=START)


def test_bounds_are_those_of_an_independent_computation():
    """Figures of the project's facts, by other derivatives: 850 columns, 0.02 px, 1250 degC."""
    lit = scene(1250)
    along = np.linspace(-11.0, 11.0, 101)
    pixel = np.asarray(vs.ray_search(lit, along, "newton").pixel)
    seen = np.isfinite(pixel).all(axis=1)
    u, v = pixel[seen].T
    columns = np.round(np.median(u)) + np.arange(-425, 425)
    order = np.argsort(u)
    line = vs.Observation(lit, np.c_[columns, CubicSpline(u[order], v[order])(columns)])
    air, part = vs.AirModel.of(lit.medium), vs.CylinderShape()
    alone = vs.identifiability(line, air, ["scale"], shape=part)
    assert alone.bound[0] == pytest.approx(0.012e-2, rel=0.05)
    free = vs.identifiability(line, air, shape=part, free=FREE)
    expected = {"scale": 0.10e-2, "width": 0.05e-2, "radius_mm": 0.9e-3}
    bounds = dict(zip(free.names, free.bound, strict=True))
    for name, bound in expected.items():
        assert bounds[name] == pytest.approx(bound, rel=0.2), name


@pytest.mark.slow
def test_what_is_vague_where_it_was_found_is_not_called_found():
    """Rationale: near no blur at all its derivative is none, though it was told at the start."""
    own = model().at(width=1.02)
    seen = vs.Observation(scene(), searched(scene().with_medium(own))[::6])
    found = vs.estimate_air(seen, model(), ["scale", "width", "blur"], shape=vs.CylinderShape())
    assert found.status[2] in (EstimateStatus.NOT_TOLD_APART, EstimateStatus.AT_BOUND)
    assert found.sigma_of("blur") <= model().parameters["blur"].sigma
    assert any("blur" in note for note in found.notes)
    assert np.isfinite(found.covariance).all()


def test_a_table_has_a_row_for_each_parameter_and_a_file_no_nodes_of_air(tmp_path):
    """Rationale: it was one row of a hundred columns, and JSON of 230 MB."""
    seen = vs.Observation(scene(), searched(scene().with_medium(own_air()))[::3])
    found = vs.estimate_air(seen, model(), ["scale"], shape=START, free=["radius_mm"])
    for thing in (found, found.before, vs.error_budget(found, families=())):
        rows = thing.to_dataframe()
        assert rows.parameter.tolist() == ["scale", "radius_mm"], type(thing)
        assert rows.unit.tolist() == ["", "mm"], type(thing)
    rows = found.to_dataframe()
    assert rows.value.tolist() == [found["scale"], found["radius_mm"]]
    assert rows.sigma.tolist() == [found.sigma_of("scale"), found.sigma_of("radius_mm")]
    assert set(rows.status) <= {"found", "at_bound"}
    path = found.save(tmp_path / "found.json")
    assert path.stat().st_size < 1e6
    assert json.loads(path.read_text())["media"] == [repr(found.medium)]


def test_a_fit_that_leaves_nothing_over_is_told():
    part = vs.CylinderShape()
    seen = vs.Observation(scene(), searched(scene().with_medium(own_air()))[3:25:7])
    two = replace(seen, pixel=seen.pixel[:2], sigma_px=0.02, coordinate=0.0, normal_deg=90.0)
    for each, said in ((two, True), (seen, False)):
        found = vs.estimate_air(each, model(), ["scale", "width"], shape=part)
        assert any("2 parameters of 2 residuals" in note for note in found.notes) == said
