"""Arguments of the search and of the march that make no sense; none at all; and NaN."""

import numpy as np
import pytest

import virtual_sensor as vs
from virtual_sensor.optics.ray_search import SearchStatus
from virtual_sensor.optics.rays import March
from virtual_sensor.optics.sensitivity import line_sensitivity

NAN, INF = float("nan"), float("inf")


@pytest.fixture(scope="module")
def scene():
    """The cold cylinder."""
    return vs.load_scene("cold_cylinder", width=64, height=64)


@pytest.mark.parametrize("method", ["paper", "newton"])
def test_a_search_of_no_rays_finds_none(scene, method):
    """Rationale: it was a RuntimeError of Dr.Jit."""
    found = vs.ray_search(scene, [], method)
    assert found.laser_point_mm.shape == found.seen_point_mm.shape == (0, 3)
    assert found.pixel.shape == (0, 2)
    for values in (found.distance_um, found.iterations, found.status):
        assert values.shape == (0,)


def test_no_rays_have_no_sensitivity(scene):
    """Rationale: it was a RuntimeError of Dr.Jit; and no ray is OK without a number."""
    none = line_sensitivity(scene, [], ["camera_x"])
    assert none.pixel.shape == none.of_pixel["camera_x"].shape == (0, 2)
    assert none.status.shape == (0,)
    some = line_sensitivity(scene, [NAN, 0.0, 40.0], ["camera_x"])
    finite = np.isfinite(some.of_pixel["camera_x"]).all(axis=1)
    np.testing.assert_array_equal(some.status == SearchStatus.FOUND, finite)
    np.testing.assert_array_equal(finite, [False, True, False])


@pytest.mark.parametrize(
    ("name", "values"),
    [
        ("laser_y_mm", [[[1.0, 2.0]], np.zeros((0, 2)), ["a"], [None, {}], [1j]]),
        ("k_stop", [-3, 0, 2.5, NAN, INF, 10**6, "five"]),
        ("grid_px", [(0, 32), (-1, 32), (NAN, 32), (32, INF), 32, (1, 2, 3), "ab"]),
        ("r_max_um", [-1, 0, NAN]),
        ("z_max_mm", [-1, 0, NAN]),
        ("method", ["", "Newton", None]),
    ],
)
def test_searches_that_make_no_sense_are_refused(scene, name, values):
    """Rationale: k_stop=-3 was taken, and found nothing; each message names the argument."""
    for value in values:
        with pytest.raises(vs.InputError, match=f"ray_search: {name}"):
            vs.ray_search(scene, **({"laser_y_mm": [0.0]} | {name: value}))


@pytest.mark.parametrize("method", ["paper", "newton"])
def test_a_ray_that_is_no_number_is_not_found_and_leaves_the_others_alone(scene, method):
    """Rationale: a status other than 0 beside every NaN."""
    found = vs.ray_search(scene, [NAN, 0.0, INF, -INF], method)
    alone = vs.ray_search(scene, [0.0], method)
    lost = [0, 2, 3]
    assert np.all(np.isin(found.status[lost], [SearchStatus.LASER_MISSED, SearchStatus.UNLIT]))
    for name, values in vars(found).items():
        if name not in ("iterations", "status"):
            assert np.all(np.isnan(values[lost]))
        np.testing.assert_allclose(values[1], getattr(alone, name)[0])


@pytest.mark.parametrize(
    ("name", "values"),
    [
        ("step_mm", [0.0, -1.0, NAN, INF]),
        ("tolerance_mm", [0.0, -1.0, NAN, INF]),
        ("max_steps", [0, -1, 2.5, NAN, INF, 2**31]),
    ],
)
def test_marches_that_make_no_sense_are_refused(name, values):
    """Rationale: whatever is marched, by the name of the attribute."""
    for value in values:
        with pytest.raises(vs.InputError, match=name):
            March(**{name: value})


def test_a_march_that_ends_within_the_field_is_refused():
    """Rationale: rays that ran out of steps were said to meet no surface.

    The box is 240 x 72 x 335 mm: 20,000 steps of 0.01675 mm.
    """
    scene = vs.load_scene("hot_cylinder", width=64, height=64)
    for step in (0.0167, 1e-9):
        with pytest.raises(vs.InputError, match=r"335 mm long; give steps of 0.017 mm or more"):
            vs.ray_search(scene, [0.0], march=March(step_mm=step))
    with pytest.raises(vs.InputError, match="longer than the field's shortest side, 72 mm"):
        vs.ray_search(scene, [0.0], march=March(step_mm=72.5))
    March(step_mm=0.0168).check(scene.field)
    March(step_mm=1e-6, method="dopri5").check(scene.field)
    March(step_mm=1e6).check(None)
