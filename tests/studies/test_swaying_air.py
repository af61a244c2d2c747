"""A plume that sways, of a simulated flow: what is left where each frame's air is estimated.

The fields in `air/` were simulated by the commands in their attributes `history`: a section whose
plume is free to sway, at five instants, and one with a mirror plane, in its steady state.
"""

from pathlib import Path

import numpy as np
import pytest

import virtual_sensor as vs
from virtual_sensor.errors import InputError
from virtual_sensor.medium.netcdf import field_times
from virtual_sensor.studies.correct.asked import Settings
from virtual_sensor.studies.correct.correct import correct
from virtual_sensor.studies.correct.measured import Measured

AIR = Path(__file__).parent / "air"
CYLINDER = vs.CylinderShape(13.5, 0.0, -13.5)


def errors_um(points, lit):
    """Distance (N, 2) from the surface, and along the line from where light met it."""
    surface = np.hypot(points[:, 1], points[:, 2] + 13.5) - 13.5
    return 1e3 * np.stack([surface, (points - lit)[:, 1]], axis=1)


def sway_um(errors):
    """Standard deviation over the frames (F, N, 2), rms along the line."""
    return np.sqrt(np.mean(np.var(errors, axis=0, ddof=1), axis=0))


@pytest.mark.slow
def test_two_parameters_of_each_frame_leave_a_third_of_the_sway_at_most():
    """Rationale: the plume leans, and moves aside above the part, which the mean air can't follow.

    The truth is searched in the flow's own air, by rays that no estimate knows.
    """
    swaying = AIR / "swaying_section.nc"
    scene = vs.load_scene("hot_cylinder", field=swaying)
    model = vs.AirModel.of(vs.IndexField.read(AIR / "steady_section.nc"))
    errors = {"straight": [], "lean": [], "offset": []}
    for instant in field_times(swaying):
        now = scene.at(float(instant))
        found = vs.ray_search(now, np.linspace(-10.9, 10.9, 25), "newton")
        lit, line = found.laser_point_mm, vs.Observation(now, found.pixel)
        errors["straight"].append(errors_um(vs.triangulate(now, found.pixel), lit))
        for name in ("lean", "offset"):
            air = vs.estimate_air(line, model, (name, "width"), shape=CYLINDER)
            errors[name].append(errors_um(air.points[0].point_mm, lit))
    sway = {name: sway_um(np.array(each)) for name, each in errors.items()}
    assert (sway["straight"] > [140.0, 340.0]).all()
    assert (sway["lean"] < sway["straight"] / 5.0).all()
    assert (sway["offset"] < sway["straight"] / 3.0).all()


TRUTHS = {"a": {"lean": 1.2, "width": 1.05}, "b": {"lean": -0.7, "width": 0.97}}
TRUTHS["c"] = {"lean": 0.1, "width": 1.0}
NAMES, FREE = ("lean", "width"), ("radius_mm", "y_mm", "z_mm")


@pytest.fixture(scope="module")
def still():
    """The scene in the steady air."""
    return vs.load_scene("hot_cylinder", field=AIR / "steady_section.nc")


@pytest.fixture(scope="module")
def pixels(still):
    """Searched in leaning air, by the names of `TRUTHS`."""
    model = vs.AirModel.of(still.medium)
    y = np.linspace(-10.0, 10.0, 15)
    return {
        name: vs.ray_search(still.with_medium(model.at(**values)), y, "newton").pixel
        for name, values in TRUTHS.items()
    }


def test_frames_of_one_part_in_airs_of_their_own_tell_both_apart(still, pixels):
    """Rationale: the shape is common, the air is not."""
    frames = [vs.Observation(still, pixels[name], name=name) for name in "ab"]
    asked = {"shape": vs.CylinderShape(13.0, 0.2, -13.0), "free": FREE}
    found = vs.estimate_air(frames, still.medium, NAMES, each=NAMES, **asked)
    for name in "ab":
        for parameter, value in TRUTHS[name].items():
            assert found[f"{name}.{parameter}"] == pytest.approx(value, abs=2e-4)
    assert found["radius_mm"] == pytest.approx(13.5, abs=2e-4)
    assert found.medium is None
    assert len({id(air) for air in found.media}) == 2
    with pytest.raises(InputError, match="each has 'offset', which is not sought; sought are lean"):
        vs.estimate_air(frames, still.medium, NAMES, each=("offset",), **asked)


@pytest.mark.slow
def test_the_frames_of_a_burst_are_corrected_as_views_of_one_part(still, pixels):
    """Rationale: one frame's shape and air pass for each other; all frames' shape is a prior."""
    frames = []
    for name, pixel in pixels.items():
        sigma, up = np.full(len(pixel), 0.02), np.full(len(pixel), 90.0)
        ok = np.full(len(pixel), vs.Status.OK, np.uint8)
        frames.append(Measured(name, still, pixel, sigma, up, ok, one_of_many=True))
    told = []
    result = correct(frames, Settings(estimate=NAMES), lambda *said: told.append(said))
    assert any("that of all 3 frames together (radius_mm 13.5 ±" in note for note in result.notes)
    assert all(abs(each.distance_um).max() < 0.3 for each in result.measurements)
    for each in result.measurements:
        assert each.estimate["lean"] == pytest.approx(TRUTHS[each.name]["lean"], abs=1e-3)
    assert result.summary.sway.frames == 3
    assert result.summary.sway.after_um < 0.3 < 10.0 < result.summary.sway.before_um
    stages, parts = zip(*told, strict=True)
    assert stages[0].startswith("all frames: estimating lean")
    assert stages[-1].startswith("c: estimating lean")
    assert max(parts) <= 1.0
