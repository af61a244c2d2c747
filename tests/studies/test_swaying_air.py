"""A plume that sways, of a simulated flow: what is left where each frame's air is estimated.

The fields in `air/` were simulated by the commands in their attributes `history`: a section whose
plume is free to sway, at five instants, and one with a mirror plane, in its steady state.
"""

from pathlib import Path

import numpy as np
import pytest

import virtual_sensor as vs
from virtual_sensor.medium.netcdf import field_times

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
