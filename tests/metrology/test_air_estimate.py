"""Air, radius and poses from images: truths are searched pixels, in air of the model or not."""

import functools

import numpy as np

import virtual_sensor as vs
from virtual_sensor.metrology.air_estimate import EstimateStatus

ALONG = np.linspace(-10.0, 10.0, 31)
FREE = ("radius_mm", "y_mm", "z_mm")
START = vs.CylinderShape(13.0, 0.3, -13.0)


@functools.cache
def scene(temperature=1100, **parameters):
    return vs.load_scene(
        "hot_cylinder", temperature=temperature, width=1024, height=1024, **parameters
    )


@functools.cache
def model():
    return vs.AirModel.of(scene().medium)


@functools.cache
def searched(beta=0.0, field=None, **truth):
    lit = scene(beta=beta, **truth)
    lit = lit if field is None else lit.with_medium(field)
    return np.asarray(vs.ray_search(lit, ALONG, "newton").pixel)


def line(beta, pixel, **options):
    return vs.Observation(scene(beta=beta), pixel, **{"name": f"beta{beta}", **options})


def test_two_poses_make_air_of_an_unknown_family_visible():
    random = np.random.default_rng(1)
    for truth in ({"temperature": 1250}, {"temperature": 1250, "widen": 2.75, "blur": 7.2}):
        seen = [searched(beta, **truth) for beta in (0, 30)]
        seen = [uv + np.c_[0 * uv[:, 0], random.normal(0.0, 0.01, len(uv))] for uv in seen]
        lines = [line(beta, uv) for beta, uv in zip((0, 30), seen, strict=True)]
        found = vs.estimate_air(lines, model(), shape=START, free=FREE)
        assert abs(found["radius_mm"] - 13.5) < 2e-3
        assert found.converged
        alone = vs.estimate_air(lines[0], model(), shape=START, free=FREE)
        assert abs(alone["radius_mm"] - 13.5) > 20e-3


def test_air_of_the_models_own_family_is_found():
    truth = {"scale": 1.1, "width": 1.04}
    lines = [line(0, searched(0, model().at(**truth)))]
    found = vs.estimate_air(lines, model(), shape=START, free=FREE)
    assert abs(found["scale"] - 1.1) < 1e-4
    assert abs(found["width"] - 1.04) < 1e-4
    assert abs(found["radius_mm"] - 13.5) < 1e-4
    assert (found.status == EstimateStatus.FOUND).all()
    dots = [line(0, searched(0, model().at(**truth)), along_mm=ALONG)]
    found = vs.estimate_air(dots, model())  # no shape at all
    assert abs(found["scale"] - 1.1) < 1e-4
    assert abs(found["width"] - 1.04) < 1e-4
