"""Where bent rays fail: each failure has a status, or a stated way in which it is told."""

import numpy as np
import pytest
from oracles import integrate

import virtual_sensor as vs
from virtual_sensor import IndexField, RayStatus
from virtual_sensor.arrays import to_numpy, to_vectors
from virtual_sensor.imaging.checks import JUMP_REFUSED_PX
from virtual_sensor.optics.eikonal import March
from virtual_sensor.studies.chart import ray_failures
from virtual_sensor.studies.chart.air_failures import (
    TOO_MUCH_PX,
    HotAir,
    border_of_slab,
    cropped,
    kinked,
    noisy,
    thinned,
    too_coarse,
    too_long,
)
from virtual_sensor.studies.chart.ray_failures import METHODS, lost_in_single, silhouette, thrown


@pytest.fixture(scope="module")
def air():
    return HotAir(vs.load_scene("hot_cylinder"), quick=True)


# ------------------------------------------------------------------------------- rays with a status


@pytest.mark.parametrize("march", METHODS, ids=str)
def test_rays_are_turned_back_where_total_reflection_says(march):
    """TURNED_BACK under the critical angle and LEFT over it; on the parabola's other foot.

    The border, which is overstepped by up to 2 um, costs 0.02 px in so strong a field.
    """
    wrong, miss_px = thrown(march, 101)
    assert not wrong.any()
    assert np.isfinite(miss_px).sum() > 50
    assert np.nanmax(miss_px) < (3.0 if march.method == "euler" else 0.1)


@pytest.mark.parametrize("march", METHODS, ids=str)
def test_no_ray_both_meets_and_misses_the_silhouette(march):
    """The last HIT is at Bouguer's n(R) R, all beyond are LEFT, and no third thing happens."""
    miss_px, unfit, of = silhouette(march, 3)
    assert (unfit, of) == (0, 3003)
    assert miss_px < TOO_MUCH_PX


def test_straight_rays_do_not_find_the_silhouette(monkeypatch):
    """They miss it by much more than is allowed above: there, the layer must bend them."""
    cold = ray_failures.layer_round_a_cylinder(1e-12)
    monkeypatch.setattr(ray_failures, "layer_round_a_cylinder", lambda depth: cold)
    for march in METHODS[1:3]:
        miss_px, unfit, _ = silhouette(march, 3)
        assert unfit == 0
        assert miss_px > 10 * TOO_MUCH_PX


def test_scipys_ray_grazes_the_cylinder_where_bouguer_says():
    """The silhouette's n(R) R, by another integrator in the same layer of hot air."""
    radius_mm, depth, width_mm, axis_z_mm = 13.5, 5e-4, 8.0, -13.5

    def layer(p):
        across = p * [0.0, 1.0, 1.0] - [0.0, 0.0, axis_z_mm]
        rho2 = np.sum(across**2, axis=1)
        dip = depth * np.exp((radius_mm**2 - rho2) / (2.0 * width_mm**2))
        n = np.sqrt(1.0 - dip)
        return n, across * (dip / (2.0 * width_mm**2 * n))[:, None]

    points = np.random.default_rng(3).uniform(-30.0, 30.0, (50, 3))
    marched = ray_failures.layer_round_a_cylinder(depth).delta_and_gradient(to_vectors(points))
    np.testing.assert_allclose(marched[0], layer(points)[0] - 1.0, rtol=0, atol=1e-15)
    np.testing.assert_allclose(to_numpy(marched[1]), layer(points)[1], rtol=0, atol=1e-16)
    start = [0.0, -100.0, axis_z_mm + radius_mm * np.sqrt(1.0 - depth)]
    ray = integrate(layer, [start], [[0.0, 1.0, 0.0]], 200.0)
    arcs = np.linspace(90.0, 110.0, 2001)
    path = np.array([ray.position(arc)[0] for arc in arcs])
    nearest = np.hypot(path[:, 1], path[:, 2] - axis_z_mm).min()
    assert nearest == pytest.approx(radius_mm, abs=1e-5)


def test_a_ray_out_of_steps_says_so():
    failure = ray_failures.out_of_steps()
    assert failure.status == "OUT_OF_STEPS"
    assert failure.failed == 1


def test_a_start_that_is_no_number_is_refused_and_never_hits():
    failure = ray_failures.from_nowhere()
    assert failure.status.startswith("refused (InputError)")
    assert failure.failed == 0


# ------------------------------------------------------------------------- what no status tells


def test_absolute_positions_in_float32_lose_what_the_difference_keeps():
    """Thousands of times as much: the reason why the march carries the difference."""
    miss_px = lost_in_single(0.5)
    assert miss_px["absolute"].max() > TOO_MUCH_PX
    assert miss_px["difference"].max() < 1e-4


def test_long_steps_are_wrong_by_more_and_more(air):
    """Leapfrog's 2 mm are fine, and 16 mm are not; the failure names the first that is not."""
    errors = [air.errors_px(air.field, March(step, "leapfrog")).max() for step in (2.0, 16.0)]
    assert errors[0] < TOO_MUCH_PX < errors[1]
    failure = too_long(air, "leapfrog", quick=True)
    assert failure.first_at not in ("", "2 mm")
    assert failure.failed > 0


def test_coarse_grids_are_wrong_by_more_and_more(air):
    """Cubic loses to thinning, and linear is lost with all nodes; nothing but comparing tells."""
    errors = [air.errors_px(thinned(air.field, k), March(2.0)).max() for k in (1, 2, 4)]
    assert errors[0] < TOO_MUCH_PX < errors[1] < errors[2]
    assert too_coarse(air, "linear", (1,)).first_at == "every node"


def test_noise_spoils_numbers_but_no_status(air):
    """Every ray still ends in its plane, at a place that is off in proportion to the noise."""
    assert noisy(air, (1e-5,)).first_at == ""
    failure = noisy(air, (1e-2, 1e-1))
    assert failure.first_at == "0.01"
    assert "0 rays end with another" in failure.status


def test_a_trilinear_gradient_costs_the_order_and_leaves_a_floor(air):
    """Shorter steps do not help: 0.1 px and more remain, and order 4 is lost."""
    linear = air.field.simplified("linear")
    errors = [air.errors_px(linear, March(step)).max() for step in (2.0, 0.5)]
    assert min(errors) > 0.1
    assert errors[0] == pytest.approx(errors[1], rel=0.1)
    failure = kinked(air, (2.0, 1.0, 0.5))
    assert float(failure.note.split()[-1]) < 2.5


def test_a_cropped_plume_is_refused(air):
    """The march leaves the jump out and is off; the scene is refused before it is measured."""
    failure = cropped(air)
    assert failure.failed > 0
    assert failure.status.startswith("refused (InputError)")
    assert "does not fade to ambient" in failure.status


def test_a_flat_border_does_not_refract():
    """The march goes straight where Snell's law turns: known, and more than the check lets pass."""
    failure = border_of_slab()
    assert failure.failed == 1
    assert float(failure.note.split()[2]) > JUMP_REFUSED_PX


def test_noise_does_not_stop_rays():
    """In a field of pure noise, of the strength of hot air, all rays come out."""
    rng = np.random.default_rng(8)
    field = IndexField.from_arrays(1e-4 * rng.normal(size=(20, 20, 20)), [-10.0] * 3, [1.0] * 3)
    starts = np.stack([np.full(50, -20.0), *rng.uniform(-8.0, 8.0, (2, 50))], axis=1)
    for method in ("leapfrog", "dopri5"):
        rays = vs.trace(field, starts, np.tile([1.0, 0, 0], (50, 1)), 60.0, 1.0, method, "single")
        assert np.all(rays.status == RayStatus.LEFT)
        assert np.isfinite(rays.position).all()


@pytest.mark.slow
def test_every_failure_is_told():
    """The chart's rows: each is measured, and says by which status or in which way it shows."""
    found = ray_failures.failures(lambda *_: None, quick=True)
    assert len({failure.what for failure in found}) == 11
    assert all(failure.status and failure.tried and failure.of for failure in found)
