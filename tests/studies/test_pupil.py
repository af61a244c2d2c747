"""The study of blur through air, where the air is a lens of known power."""

import numpy as np
import pytest

import virtual_sensor as vs
from virtual_sensor.errors import InputError
from virtual_sensor.studies.measure import measure
from virtual_sensor.studies.pupil import blur_through_air

LOW_MM, HIGH_MM, BEND = 80.0, 160.0, 2e-6


@pytest.fixture(scope="module")
def scene():
    """Air whose n rises by BEND y^2/2 and fades in z: a lens that diverges along u alone."""
    x, y, z = np.linspace(-120, 120, 5), np.linspace(-20, 20, 41), np.linspace(LOW_MM, HIGH_MM, 65)
    fades = np.sin(np.pi * (z - LOW_MM) / (HIGH_MM - LOW_MM)) ** 2
    more = 0.5 * BEND * y[:, None] ** 2 * fades
    field = vs.IndexField.from_arrays(
        np.broadcast_to(2.7e-4 + more, (5, 41, 65)).copy(),
        (x[0], y[0], z[0]),
        (x[1] - x[0], y[1] - y[0], z[1] - z[0]),
        ambient=2.7e-4,
    )
    return vs.load_scene("cold_cylinder").with_medium(field)


def test_air_that_is_a_lens_moves_the_focus_as_that_lens_does(scene):
    """Two thin lenses one behind the other, of which the air's has the power of its path."""
    study = blur_through_air(scene, [4.0, 16.0], [-2.0, 0.0, 2.0], points=8)
    sight = scene.camera.pose.rotation[:, 2]
    path = 0.5 * (HIGH_MM - LOW_MM) / abs(sight[2])  # the mean of sin^2 is a half
    to_air = 0.5 * (HIGH_MM + LOW_MM) / abs(sight[2])
    seems = 1.0 / (1.0 / to_air + BEND * path)  # nearer: it diverges
    for line in study.lines:
        np.testing.assert_allclose(line.focus_shift_mm[1], [seems - to_air, 0.0], atol=0.04)
        np.testing.assert_allclose(line.left_px, 0.0, atol=0.02)  # it has no other errors
        np.testing.assert_allclose(line.shift_px["hot"][1], 0.0, atol=0.02)
    assert seems - to_air < -1.0
    assert study.lenses[0].focus_distance_mm == pytest.approx(300.0, abs=0.01)
    assert len(study.to_dataframe()) == 6
    assert "f/4: up to" in repr(study)


def test_blur_grows_with_the_pupil_and_the_shift_with_its_square():
    hot = vs.load_scene("hot_cylinder")
    wide, narrow = blur_through_air(hot, [8.0, 16.0], np.linspace(-6.0, 6.0, 5), points=6).lines
    blur = wide.spread_px["hot"][1] / narrow.spread_px["hot"][1]
    shift = wide.shift_px["hot"][1] / narrow.shift_px["hot"][1]
    assert blur == pytest.approx(2.0, rel=0.15)
    assert shift == pytest.approx(4.0, rel=0.3)  # and with its fourth power, a little
    assert np.abs(wide.shift_px["cold"][1]) < 0.002


def test_what_can_not_be_studied_is_refused():
    cold = vs.load_scene("cold_cylinder", width=64, height=64)
    with pytest.raises(InputError, match="no hot air"):
        blur_through_air(cold)
    with pytest.raises(InputError, match="points"):
        blur_through_air(vs.load_scene("hot_cylinder", width=64, height=64), points=1)


def test_measure_checks_the_line_through_the_lens():
    """Rationale: beside the chief rays' line, a lens in hot air moved the check by 0.24 px."""
    scene = vs.load_scene(
        "hot_cylinder",
        width=256,
        height=256,
        f_number=8,
        sub_pupils=6,
        line_radius=0.6,
        line_length=16,
    )
    result = measure(scene)
    for state, most in ((result.cold, 0.003), (result.hot, 0.02)):
        assert state.frame.report.pupil_points == 6
        assert state.compared.count > 70
        assert state.compared.rms_px < most
        assert state.by_frame.wrong().sum() == 0
