"""A measurement by fringes: its figures beside the search, and what it says when it goes wrong."""

from pathlib import Path

import numpy as np
import pytest

import virtual_sensor as vs
from virtual_sensor.errors import InputError
from virtual_sensor.imaging.fringe_recording import FringeRecording
from virtual_sensor.imaging.scene_file import find_scene
from virtual_sensor.metrology.fringes.decoded import FringeStatus
from virtual_sensor.optics.projector_pixels import ProjectorPixelStatus
from virtual_sensor.studies.correct.measured import of_fringes
from virtual_sensor.studies.fringes import measure
from virtual_sensor.studies.fringes.measure import Settings, measure_fringes
from virtual_sensor.studies.fringes.poses import pose_maps
from virtual_sensor.studies.fringes.result import search_table

FINE = {"width": 160, "height": 160, "pixel": 5.5, "spp": 1, "pixels": "false"}
"""The middle of the default frame, pixel for pixel."""


@pytest.fixture(autouse=True)
def few_rays(monkeypatch):
    """Searched pixels, fewer than by default."""
    monkeypatch.setattr(measure, "SEARCHED", 200)


@pytest.fixture(scope="module")
def measured():
    """Cold and hot, without noise, of patterns that are shown between the pixels' centres too."""
    with pytest.MonkeyPatch.context() as patch:
        patch.setattr(measure, "SEARCHED", 400)
        return measure_fringes(vs.load_scene("fringe_cylinder", **FINE))


def test_decoded_projector_pixels_are_those_of_the_search(measured):
    """Of both axes, cold and hot: renderer and decoder on one side, marched rays on the other."""
    for state in measured.states.values():
        found = state.summary.decoded_minus_search
        for axis in (found.column, found.row):
            assert axis.compared > 300
            assert axis.rms_px < 0.002
            assert axis.largest_px < 0.01
        table = search_table(state)
        compared = table.columns()["difference_column_px"]
        assert np.isfinite(compared).sum() == found.column.compared
        decoded, searched = (table.columns()[f"{name}_row_px"] for name in ("decoded", "searched"))
        assert np.nanmax(np.abs(decoded - searched)) < 0.01


def test_a_measurement_is_a_table_of_searched_pixels(measured):
    table = measured.to_dataframe()
    assert set(table["state"]) == {"cold", "hot"}
    assert len(table) == sum(len(state.grid.pixel) for state in measured.states.values())
    assert table["difference_column_px"].abs().max() < 0.01
    assert repr(measured).startswith("FringeMeasurement: fringe_cylinder.xml, cold 25600 pixels")


def test_the_epipolar_residual_is_the_airs(measured):
    """Rationale: no shape makes it; in cold air there is none."""
    cold, hot = (state.summary.epipolar for state in measured.states.values())
    assert cold.rms_px < 0.003
    assert cold.searched_rms_px < 1e-9
    assert hot.searched_rms_px > 0.05
    assert hot.difference_rms_px < 0.003
    assert hot.rms_px == pytest.approx(hot.searched_rms_px, rel=0.05)  # grid and whole image


def test_straight_points_are_as_wrong_as_the_search_says_and_bent_ones_right(measured):
    cold, hot = (state.summary for state in measured.states.values())
    assert cold.straight.rms_um < 0.1
    assert cold.bent is None
    assert hot.straight.rms_um > 10.0
    assert hot.straight_minus_search_um < 0.5
    assert hot.bent.rms_um < 0.2
    assert hot.bent.fit.kind == "cylinder"
    assert hot.bent.fit.std_um < 0.2
    assert abs(hot.straight.fit.radius_error_um) > 10.0 * abs(hot.bent.fit.radius_error_um)
    assert measured.hot.bent.deviation_um.shape == (160, 160)


def test_noise_is_predicted(measured):
    """Points of noisy frames scatter about those without noise by the sigma that they state."""
    scene = vs.load_scene("fringe_cylinder", **FINE)
    settings = Settings(
        "phase 4 u", recording=FringeRecording(electrons=8000.0, bits=12, seed=3), cold=True
    )
    state = measure_fringes(scene, settings).cold
    assert state.images.dtype == np.uint16
    error = state.decoded.column - measured.cold.decoded.column
    pull = error / state.decoded.sigma_column
    assert np.nanstd(pull) == pytest.approx(1.0, abs=0.05)
    assert state.summary.decoded_minus_search.row is None
    assert state.summary.epipolar is None
    assert state.summary.frames.electrons == 8000.0
    assert np.nanstd(
        state.straight.deviation_um - measured.cold.straight.deviation_um
    ) == pytest.approx(state.summary.straight.sigma_um, rel=0.5)


def test_rounding_without_noise():
    scene = vs.load_scene("fringe_cylinder", **FINE)
    settings = Settings("phase 4 u", recording=FringeRecording(bits=8), cold=True)
    state = measure_fringes(scene, settings).cold
    assert state.images.max() in (229, 230)  # nine tenths of 255
    assert 0.001 < state.summary.decoded_minus_search.column.rms_px < 0.1


def test_what_noise_does_not_explain_is_named():
    """Rationale: the sigma is the noise's; steps of square pixels, say, are far more."""
    noted = {}
    for name, changed in {"none": {}, "pixels": {"pixels": "true"}}.items():
        scene = vs.load_scene("fringe_cylinder", **{**FINE, "width": 64, "height": 64, **changed})
        noted[name] = measure_fringes(scene, Settings("phase 4 u", cold=True)).summary.notes
    assert noted["none"] == ()
    (note,) = noted["pixels"]
    assert "where noise makes 0 px: the projector's square pixels are steps" in note
    first = {**FINE, "width": 64, "height": 64, "pixel": 44, "transport": "first_order"}
    result = measure_fringes(vs.load_scene("fringe_cylinder", **first), Settings("phase 4 u"))
    assert any("light was first_order (transport=marched" in note for note in result.summary.notes)


def test_patterns_that_tell_little_of_the_depth_are_named():
    small = {**FINE, "width": 48, "height": 48}
    scene = vs.load_scene("fringe_cylinder", **small)
    (caveat,) = measure_fringes(scene, Settings("phase 4 v", cold=True)).summary.caveats
    assert "rows tell little of the depth" in caveat
    assert "project patterns along u" in caveat


def test_a_projector_that_is_turned_is_measured_by_its_rows(tmp_path):
    """Rationale: by columns its points through hot air are millimetres off, or none."""
    text = Path(find_scene("fringe_cylinder")).read_text()
    text = text.replace('up="0, -1, 0"', 'up="1, 0, 0"')
    (tmp_path / "turned.xml").write_text(text)
    small = {**FINE, "width": 48, "height": 48}
    scene = vs.load_scene(tmp_path / "turned.xml", **small)
    result = measure_fringes(scene)
    assert result.summary.caveats == ()
    assert any("points are found by rows" in note for note in result.summary.notes)
    assert result.summary.states["hot"].bent.rms_um < 0.2
    with pytest.raises(InputError, match=r"rows tell the depth.*turn the projector by 90 degrees"):
        pose_maps(scene, "turned", {})
    with pytest.raises(InputError, match="rows tell the depth"):
        of_fringes("turned", scene, result.hot.decoded)


def test_the_blurred_border_of_the_projectors_image_is_left_out(monkeypatch):
    """Rationale: dark mixes with its light, and moved what was decoded there by 2 px unseen."""
    monkeypatch.setattr(measure, "SEARCHED", 1000)
    blurred = {**FINE, "projector_height": 60, "defocus": 4.0}
    scene = vs.load_scene("fringe_cylinder", **blurred)
    result = measure_fringes(scene, Settings("phase 4 uv", cold=True))
    found = result.summary.states["cold"].decoded_minus_search
    assert found.column.compared > 20
    assert max(found.column.largest_px, found.row.largest_px) < 0.03
    assert any("12 px along the border" in note for note in result.summary.notes)


def test_a_part_that_nobody_lights_or_sees_has_statuses_and_no_points():
    """Rationale: a frame half of background, and a projector that lights a corner of it."""
    far = {**FINE, "width": 64, "height": 64, "pixel": 176, "projector_fov": 2.0}
    result = measure_fringes(vs.load_scene("fringe_cylinder", **far), Settings(cold=True))
    grid, decoded = result.cold.grid, result.cold.decoded
    assert (decoded.status[grid.row_column] == FringeStatus.BLACK).any()
    assert (grid.found.status == ProjectorPixelStatus.OUTSIDE).any()
    assert (grid.found.status == ProjectorPixelStatus.MISSED).any()
    assert np.isnan(grid.difference_px[~grid.compared]).all()
    assert (grid.found.status[grid.compared] == ProjectorPixelStatus.OK).all()
    ok = result.cold.straight.range_image.ok
    assert np.array_equal(np.isfinite(result.cold.straight.deviation_um), ok)
    assert ok.sum() == result.cold.summary.straight.points <= decoded.ok.sum()


def test_steps_of_a_part_are_edges_by_both():
    """Rationale: pixels that see two faces have a mean of both; others are as good as anywhere."""
    film = {"width": 160, "height": 160, "spp": 1, "pixels": "false"}
    state = measure_fringes(vs.load_scene("fringe_stepped_shaft", **film), Settings(cold=True)).cold
    assert (state.decoded.status == FringeStatus.EDGE).any()
    found = state.summary.decoded_minus_search
    assert found.column.compared > 20
    assert found.column.largest_px < 0.01
    assert (state.grid.found.status[state.grid.compared] == ProjectorPixelStatus.OK).all()
    assert set(found.only_searched) <= {"edge", "low_modulation", "order"}
    assert state.summary.straight.fit is None


def test_what_the_memory_does_not_hold_is_refused_beforehand(monkeypatch):
    """Rationale: frames of 8192 px fit in 16 GB, but not what is found of them."""
    scene = vs.load_scene("fringe_cylinder", **{**FINE, "width": 64, "height": 64})
    monkeypatch.setattr(measure, "render_sequence", lambda *a, **b: pytest.fail("was begun"))
    monkeypatch.setattr(measure, "physical_memory", lambda: 64 * 64 * (24 * 4 + 2 * 250) - 1)
    with pytest.raises(InputError, match=r"24 frames of 64 x 64 px .* 0.00244 GB .*-D width"):
        measure_fringes(scene, Settings("phase 4", frames=False))
    monkeypatch.setattr(measure, "physical_memory", lambda: 64 * 64 * (24 * 4 + 2 * 250))
    with pytest.raises(InputError, match=r"0\.00283 GB"):  # of both states
        measure_fringes(scene, Settings("phase 4", frames=True))
    with pytest.raises(pytest.fail.Exception, match="was begun"):
        measure_fringes(scene, Settings("phase 4", frames=False))


def test_wrong_requests_are_refused():
    scene = vs.load_scene("fringe_cylinder", **FINE)
    for settings, words in (
        (Settings("phase 4 16,100"), "longest, 100 px, is shorter"),
        (Settings("face 4"), "codec 'face 4' is none"),
        (Settings("single 16 u"), "whole periods"),
        (Settings(medium="hot_cylinder_900C_quarter", cold=True), "no light is bent"),
    ):
        with pytest.raises(InputError, match=words):
            measure_fringes(scene, settings)
    with pytest.raises(InputError, match="--electrons"):
        FringeRecording(electrons=-1.0)
    with pytest.raises(InputError, match="pattern_projector"):
        measure_fringes(vs.load_scene("cold_cylinder"))


def test_a_data_sheet_records_the_frames_and_is_named_beside_the_figures(measured, tmp_path):
    scene = vs.load_scene("fringe_cylinder", **FINE)
    recording = FringeRecording(sensor_model="cmos_5um5", seed=2)
    state = measure_fringes(scene, Settings("phase 4 u", recording=recording, cold=True)).cold
    facts = state.summary.frames
    assert (facts.sensor, facts.bits, facts.exposure_s) == ("cmos_5um5", 12, None)
    sheet = vs.image_sensor("cmos_5um5")
    assert facts.electrons == pytest.approx(0.8 * sheet.full_well_e, rel=0.01)
    pull = (state.decoded.column - measured.cold.decoded.column) / state.decoded.sigma_column
    assert np.nanstd(pull) == pytest.approx(1.0, abs=0.1)
    path = vs.save_png(state.images[0], tmp_path / "0.png", facts.bits, metadata=state.metadata)
    assert vs.read_image(path).detector_options == sheet.detector_options


def test_options_of_recording_that_contradict_each_other_are_told():
    for options in (
        {"bits": 8, "sensor_model": "cmos_5um5"},
        {"electrons": 8000.0, "exposure": "2ms"},
    ):
        with pytest.raises(InputError, match="leave out"):
            FringeRecording(**options)
