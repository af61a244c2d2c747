"""Shapes through many points: the true one comes back, with the spread that noise gives it."""

import numpy as np
import pytest

import virtual_sensor as vs
from virtual_sensor.metrology.cylinder_fit import FitStatus
from virtual_sensor.metrology.shape_fits import fit_shape

TURN = vs.Pose.turn(20.0, [0.3, 1.0, -0.2]).rotation
CENTRE = np.array([40.0, -25.0, 310.0])


def patch(kind, rng, count):
    """Points of a patch of a shape, in a frame that is turned and moved."""
    x, a = rng.uniform(-20.0, 20.0, count), rng.uniform(-0.9, 0.9, count)
    if kind == "cylinder":
        local = np.column_stack([x, 13.5 * np.sin(a), 13.5 * np.cos(a)])
    elif kind == "sphere":
        b = rng.uniform(-0.9, 0.9, count)
        local = 13.5 * np.column_stack([np.sin(a), np.cos(a) * np.sin(b), np.cos(a) * np.cos(b)])
    else:
        local = np.column_stack([x, 20.0 * a, 0.0 * x])
    return local @ TURN.T + CENTRE, local


def normals(kind, local):
    if kind == "plane":
        return np.tile(TURN[:, 2], (len(local), 1))
    return (local * ([0, 1, 1] if kind == "cylinder" else 1)) @ TURN.T / 13.5


@pytest.mark.parametrize("kind", ["cylinder", "plane", "sphere"])
def test_the_true_shape_comes_back_with_its_spread(kind):
    """Over many draws of noise, values err by the sigma that each fit says."""
    rng = np.random.default_rng(3)
    points, local = patch(kind, rng, 3000)
    exact = fit_shape(points, kind)
    assert exact.status == FitStatus.FITTED
    assert np.abs(exact.residual_um).max() < 1e-4
    if kind == "plane":
        np.testing.assert_allclose(np.abs(exact.shape.axis[1] @ TURN[:, 2]), 1.0, atol=1e-12)
    else:
        np.testing.assert_allclose(exact.shape.radius_mm, 13.5, atol=1e-9)
        centre = exact.shape.axis[0] if kind == "cylinder" else [*exact.shape.values.values()][1:]
        off = np.asarray(centre) - CENTRE
        if kind == "cylinder":
            np.testing.assert_allclose(np.abs(exact.shape.axis[1] @ TURN[:, 0]), 1.0, atol=1e-12)
            off -= (off @ TURN[:, 0]) * TURN[:, 0]
        np.testing.assert_allclose(off, 0.0, atol=1e-7)

    outwards = normals(kind, local)
    noisy = points + 0.01 * rng.normal(size=(len(points), 1)) * outwards
    fit = fit_shape(noisy.reshape(30, 100, 3), kind)
    assert fit.residual_um.shape == (30, 100)
    np.testing.assert_allclose(fit.residual_std_um, 10.0, rtol=0.05)
    errors = []
    for _ in range(40):
        noisy = points + 0.01 * rng.normal(size=(len(points), 1)) * outwards
        start = exact.shape  # in one frame, so that values of all draws mean the same
        again = fit_shape(noisy, start)
        errors.append([again.shape.values[n] - start.values[n] for n in again.sigma])
    spread = np.sqrt(np.mean(np.square(errors), axis=0)) / [*again.sigma.values()]
    assert np.all((spread > 0.7) & (spread < 1.35))


def test_large_clouds_are_fitted_as_small_ones_are(monkeypatch):
    """Rationale: the start comes from a sample, and the sums from shares."""
    from virtual_sensor import arrays
    from virtual_sensor.metrology import shape_fits

    rng = np.random.default_rng(5)
    points, local = patch("cylinder", rng, 1500)
    points += 0.005 * rng.normal(size=(1500, 1)) * normals("cylinder", local)
    whole = vs.fit_cylinder(points)
    monkeypatch.setattr(arrays, "_SHARE", 400)
    monkeypatch.setattr(shape_fits, "_SAMPLE", 300)
    fit = fit_shape(points)
    np.testing.assert_allclose(fit.shape.radius_mm, whole.radius_mm, atol=1e-8)
    np.testing.assert_allclose(fit.residual_std_um, whole.residual_std_um, rtol=1e-8)
    np.testing.assert_allclose(fit.residual_um, whole.residual_um, atol=1e-5)
    held = fit_shape(points, direction=TURN[:, 0])
    along = vs.fit_cylinder(points, direction=TURN[:, 0])
    np.testing.assert_allclose(held.shape.radius_mm, along.radius_mm, atol=1e-8)
    assert [*held.sigma] == ["radius_mm", "y_mm", "z_mm"]


def test_no_shape_without_a_reason():
    few = fit_shape(np.zeros((3, 3)), "sphere")
    assert (few.status, few.shape) == (FitStatus.TOO_FEW, None)
    line = np.linspace(0.0, 1.0, 50)[:, None] * [[1.0, 2.0, 3.0]]
    for kind in ("cylinder", "plane", "sphere"):
        fit = fit_shape(line, kind)
        assert fit.status == FitStatus.UNDETERMINED, kind
        assert np.isnan(fit.residual_um).all()
    assert fit_shape(np.full((5, 6, 3), np.nan)).count == 0
    for wrong, word in (
        ({"shape": "cone"}, "cylinder, plane, sphere"),
        ({"shape": "plane", "direction": [1, 0, 0]}, "leave it out"),
        ({"shape": "sphere", "free": ["radius"]}, "did you mean 'radius_mm'"),
    ):
        with pytest.raises(vs.InputError, match=word):
            fit_shape(patch("plane", np.random.default_rng(0), 9)[0], **wrong)
