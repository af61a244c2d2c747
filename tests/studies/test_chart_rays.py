"""The chart's bent rays, and the benchmark beside peers: references, and that all of it runs."""

import importlib
from pathlib import Path

import numpy as np
import oracles
import pytest
from scipy.optimize import brentq

from virtual_sensor.imaging.scene import load_scene
from virtual_sensor.medium.index_field import IndexField
from virtual_sensor.medium.spline import bspline_coefficients
from virtual_sensor.optics.eikonal import March
from virtual_sensor.optics.steppers import STEPPERS
from virtual_sensor.studies.chart import rays
from virtual_sensor.studies.chart.benchmark import measure_all
from virtual_sensor.studies.chart.ray_bundles import (
    FINEST,
    MM_PER_PX,
    apart_px,
    camera_bundle,
    ends_of,
    fibre,
    fish_eye_of_hot_air,
)

BENCHMARKS = Path(__file__).parents[2] / "benchmarks"


@pytest.fixture(scope="module")
def scene():
    return load_scene("hot_cylinder")


@pytest.fixture(scope="module")
def coarse(scene):
    """The scene in a thinned-out field, whose splines SciPy makes at once."""
    field = scene.field
    thin = IndexField.from_arrays(
        field.nodes[::4, ::3, ::6],
        field.origin,
        field.spacing * [4, 3, 6],
        ambient=field.ambient,
        mirror=field.mirror,
    )
    return scene.with_medium(thin)


@pytest.fixture(scope="module")
def measured():
    said = []
    found = list(measure_all("rays", rays.tasks(quick=True), lambda *now: said.append(now), 1))
    return found, [fraction for _, fraction in said]


# ---------------------------------------------------------------------------------------- bundles


def test_a_pixel_of_the_bundle_is_the_cameras(scene):
    """Rationale: errors are in px; a neighbouring line of sight must be one of them apart."""
    camera = scene.sensor.camera
    u = np.array(camera.size) / 2.0
    d = camera.lines_of_sight(np.stack([u, [u[0] + 1.0, u[1]]]))
    distance = np.linalg.norm(camera.pose.origin_mm)  # the part's top line is the world's origin
    np.testing.assert_allclose(np.linalg.norm(d[1] - d[0]) * distance, MM_PER_PX, rtol=1e-3)


def test_straight_rays_of_the_bundle_end_on_the_laser_line(scene):
    """Rationale: the chart is about the rays that a measurement needs."""
    bundle = camera_bundle(scene, 220)
    normal, offset = scene.sensor.laser.plane
    beside_px = np.abs(bundle.targets @ normal - offset) / MM_PER_PX
    assert len(bundle.targets) == 220
    assert beside_px.max() < 12.0  # five rows, seen at an angle
    assert np.ptp(bundle.targets[:, 1]) == pytest.approx(scene.sensor.laser.length_mm, abs=0.2)
    on_part = np.hypot(bundle.targets[:, 1], bundle.targets[:, 2] + 13.5)
    np.testing.assert_allclose(on_part, 13.5, atol=1e-9)


def test_the_fibres_ends_are_those_of_a_harmonic_oscillator():
    """Rationale: the truth is written here and in the oracles, by different hands."""
    _, bundle, ends = fibre(5)
    for start, direction, end in zip(bundle.origins, bundle.directions, ends, strict=True):
        path = oracles.parabolic(1.0, [0.0, 1e-3, 1e-3], start, direction)
        t = brentq(lambda t, path=path: path.position(t)[0], 100.0, 300.0, xtol=1e-12)
        np.testing.assert_allclose(path.position(t), end, rtol=0, atol=1e-10)


def test_the_fish_eyes_ends_lie_on_its_circles():
    """Rationale: as above; the oracle goes by arc length, the chart to a plane."""
    _, bundle, ends = fish_eye_of_hot_air(5)
    for start, direction, end in zip(bundle.origins, bundle.directions, ends, strict=True):

        def at(length, start=start, direction=direction):
            return oracles.fish_eye(1.0, 4000.0, start, direction, length)[0]

        length = brentq(lambda s, at=at: at(s)[0] - 120.0, 100.0, 300.0, xtol=1e-12)
        np.testing.assert_allclose(at(length), end, rtol=0, atol=1e-8)


@pytest.mark.parametrize("made", [fibre, fish_eye_of_hot_air])
def test_closed_form_rays_are_met_and_bend_like_hot_air(made):
    """Rationale: what they show of a method must hold for the plume, whose rays move 0.3 mm."""
    field, bundle, ends = made(21)
    assert apart_px(ends_of(field, bundle, March(1.0, "rk4")), ends, bundle).max() < 1e-9
    assert 2.0 < apart_px(bundle.targets, ends, bundle).max() < 30.0
    coarse = apart_px(ends_of(field, bundle, March(8.0, "leapfrog")), ends, bundle).max()
    fine = apart_px(ends_of(field, bundle, March(4.0, "leapfrog")), ends, bundle).max()
    assert coarse / fine == pytest.approx(4.0, rel=0.1)


@pytest.mark.slow
def test_the_reference_is_scipys(scene):
    """Rationale: all errors of the panel are against it: SciPy's order 8 at 1e-12, its own spline.

    They are to agree a thousand times better than the best configuration of the chart.
    """
    field = scene.field
    bundle = camera_bundle(scene, 4)
    ours = ends_of(field, bundle, FINEST)
    low, high = field.box
    faces = np.where(bundle.directions > 0.0, low, high) - bundle.origins
    enter = np.max(faces / bundle.directions, axis=1) + 1e-9
    starts = bundle.origins + bundle.directions * enter[:, None]
    index = oracles.spline_index(field.nodes, field.origin, field.spacing, field.mirror)
    longest = np.linalg.norm(bundle.targets - starts, axis=1).max() + 1.0
    solved = oracles.integrate(index, starts, bundle.directions, longest, rtol=1e-12)
    arcs = solved.arcs_to(lambda p: (p - bundle.targets) @ bundle.normal, longest - 20.0, longest)
    theirs = np.array([solved.position(s)[i] for i, s in enumerate(arcs)])
    assert apart_px(ours, theirs, bundle).max() < 1e-6


# ------------------------------------------------------------------------------------------ panel


def test_every_method_is_measured_on_the_plume_and_on_closed_forms(measured):
    """Rationale: the chart is to hold all that a user can choose."""
    found, said = measured
    plume = {m.name for m in found if m.reference.startswith("rays in float64")}
    exact = {m.name for m in found if m.reference == "rays in closed form"}
    assert plume == {*STEPPERS, "straight", "first_order", "tabulated"}
    assert [m.task for m in found if "tolerance_mm" in m.chosen] == ["through the hot plume"]
    models = [m.chosen for m in found if "interpolation" in m.chosen or "dimensions" in m.chosen]
    assert {(m.get("interpolation"), m.get("dimensions")) for m in models} == {
        ("linear", None),
        (None, 2),
    }
    assert exact == set(STEPPERS)
    assert said == sorted(said)
    assert said[-1] <= 1.0


def test_each_has_an_error_a_time_and_a_count(measured):
    """Rationale: each is a point in the chart, and none may hide rays that did not arrive."""
    for each in measured[0]:
        assert (each.panel, each.failed) == ("rays", 0)
        assert 0.0 < each.rms_px <= each.largest_px
        assert each.rms_um == pytest.approx(22.0 * each.rms_px)
        assert each.time_s > 0.0


def test_cruder_models_err_more(measured):
    """Rationale: whoever mixes up two of them breaks their order, which physics gives."""
    plume = [m for m in measured[0] if m.task == "through the hot plume"]
    error = {m.name: m.rms_px for m in plume if not {"interpolation", "dimensions"} & set(m.chosen)}
    linear, flat = (
        next(m.rms_px for m in plume if name in m.chosen)
        for name in ("interpolation", "dimensions")
    )
    assert error["leapfrog"] < error["first_order"] < error["straight"]
    assert error["leapfrog"] < flat < error["straight"]
    assert error["leapfrog"] < linear < error["straight"]
    assert error["rk4"] < error["leapfrog"] < error["euler"]


# ------------------------------------------------------------------------------------------ peers


@pytest.fixture
def benchmark(monkeypatch):
    """Import a module of the benchmark, as its own script finds it."""
    monkeypatch.syspath_prepend(BENCHMARKS)
    return importlib.import_module


def test_scipys_peer_bends_the_same_rays(benchmark, coarse):
    """Rationale: a ratio of times means something only if both solve the same problem."""
    problem = benchmark("ours").problem_of(coarse, 31, 7)  # the middle one stays in y = 0
    known = problem.part(np.flatnonzero(np.isfinite(problem.truth[:, 0])))
    scipy_peer = benchmark("scipy_peer")
    assert len(known) == 7
    for solve in (scipy_peer.all_rays, scipy_peer.ray_by_ray):
        ends = solve("DOP853", scipy_peer.spline_index)(known, 1e-9)()
        assert known.error_px(ends).max() < 1e-4


def test_linear_gradients_do_not_converge(benchmark, coarse):
    """Rationale: the benchmark says of peers that their error stops falling."""
    problem = benchmark("ours").problem_of(coarse, 6, 6)
    scipy_peer = benchmark("scipy_peer")
    solve = scipy_peer.all_rays("RK45", scipy_peer.linear_index)
    loose, tight = (problem.error_px(solve(problem, rtol)()).max() for rtol in (1e-6, 1e-8))
    assert tight > 0.05
    assert tight == pytest.approx(loose, rel=0.3)


def test_the_peers_spline_is_ours(benchmark, coarse):
    """Rationale: numba and diffrax get their coefficients by code that shares none with ours."""
    problem = benchmark("problem")
    field = coarse.field
    grid = problem.Grid(field.nodes, field.origin, field.spacing, field.mirror)
    theirs, origin = benchmark("splines").spline_coefficients(grid)
    ours = bspline_coefficients(field.nodes, field.mirror)
    part = theirs[tuple(slice(-n, None) for n in ours.shape)]
    np.testing.assert_allclose(part, ours, rtol=0, atol=1e-14)
    np.testing.assert_allclose(origin, field.box[0])


def test_the_loosest_setting_is_told(benchmark, coarse):
    """Rationale: peers are compared where each just keeps the stated error."""
    ours, problem = benchmark("ours"), benchmark("problem")
    task = ours.problem_of(coarse, 60, 20)
    prepare = ours.marching(coarse, "leapfrog", "double")
    peer = problem.Peer("p", "cubic spline", (64.0, 2.0, 1.0), "mm", prepare, 60, 20)
    rows = list(problem.measured(peer, task, 0.01, 1))
    assert [(row.setting, row.chosen) for row in rows] == [(64.0, False), (2.0, True)]
    assert rows[0].rms_px > 0.01 > rows[1].rms_px
    assert np.isnan(rows[0].rays_per_s)
    assert rows[1].rays_per_s > 0.0
