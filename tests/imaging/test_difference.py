"""Laser on minus laser off: no bias of other light, noise as said, and what can't be subtracted."""

from dataclasses import replace
from functools import lru_cache

import numpy as np
import pytest

import virtual_sensor as vs
from virtual_sensor.errors import InputError
from virtual_sensor.imaging.recording_options import RecordingOptions

SMALL = {"width": 96, "height": 96, "film_width": 1.056, "line_radius": 0.2, "spp": 4}
ROW = np.arange(96)[:, None]


@lru_cache
def lit(other=0.5):
    """A scene, and its frame with a background of this part of the laser's peak, brighter above."""
    scene = vs.load_scene("cold_cylinder", **SMALL)
    frame = vs.render_frame(scene, background=True)
    rows = (2.0 - ROW / 63.0) * np.ones(96)
    background = (other * frame.radiance.max() * rows).astype(np.float32)
    return scene, replace(frame, radiance=frame.radiance + background, background=background)


def test_ambient_light_leaves_no_bias():
    """The mean of 40 differences, in grey values; a single frame is off by hundreds."""
    scene, frame = lit()
    for sensor in ("cmos_5um5", "cmos_3um45", "profile_sensor"):
        errors = []
        for seed in range(40):
            shot = vs.difference(vs.record(scene, frame, seed, sensor=sensor))
            light = (frame.radiance - frame.background) * shot.electrons_per_radiance
            errors.append(shot.grey - shot.pedestal - light * shot.sensor.gain)
        mean = np.mean(errors, axis=0)
        for part in (frame.lit, ~frame.lit & (ROW < 30), ~frame.lit & (ROW > 65)):
            chance = 4.0 * mean[part].std() / np.sqrt(part.sum())
            assert abs(mean[part].mean()) < max(1.0, chance), sensor
        assert np.abs(shot.on_grey[~frame.lit] - shot.on.sensor.black_level).mean() > 20.0


def test_detectors_are_told_the_noise_of_both():
    scene, frame = lit(0.2)
    flat = replace(frame, background=np.full_like(frame.background, frame.background.mean()))
    flat = replace(flat, radiance=frame.radiance - frame.background + flat.background)
    shot = vs.difference(vs.record(scene, flat, 3, sensor="cmos_5um5"))
    dark = ~flat.lit
    assert shot.detector_options["noise"] == pytest.approx(np.std(shot.grey[dark] * 1.0), rel=0.03)
    line = vs.line_centres(shot)
    errors = vs.compare_line(line, flat)
    assert errors.lost.size == 0
    assert np.std(errors.error_px / errors.sigma) == pytest.approx(1.0, abs=0.3)
    assert shot.on.grey is shot.on_grey
    assert shot.on.detector_options["black"] < shot.detector_options["black"]


def test_a_given_off_frame_is_subtracted_if_it_was_exposed_alike():
    scene, frame = lit()
    on = vs.record(scene, frame, 1, sensor="cmos_5um5")
    same = vs.record(scene, frame, 2, sensor="cmos_5um5")
    nothing = vs.difference(on, same)
    assert abs(np.mean(nothing.grey - nothing.pedestal)) < 0.5
    for off, said in (
        (vs.record(scene, frame, 2, sensor="cmos_3um45"), "two sensors"),
        (vs.record(scene, frame, 2, sensor="cmos_5um5", peak=0.4), "exposed 0.5 times"),
        (np.zeros((96, 96)), "give a recorded frame"),
    ):
        with pytest.raises(InputError, match=said):
            vs.difference(on, off)
    with pytest.raises(InputError, match="background=True"):
        vs.difference(vs.record(scene, frame.radiance))
    with pytest.raises(InputError, match="one recorded frame"):
        vs.difference(frame)


def test_a_folder_holds_both_frames_beside_their_difference(tmp_path):
    scene, frame = lit()
    shot = vs.difference(vs.record(scene, frame, 1, sensor="cmos_5um5"))
    folder = shot.write(tmp_path / "pair", "tif")
    for name, held in (("_on", shot.on), ("_off", shot.on), ("", shot)):
        image = vs.read_image(folder / f"frame{name}.tif")
        np.testing.assert_array_equal(image.pixels, getattr(shot, f"{name[1:]}_grey", shot.grey))
        assert image.detector_options == pytest.approx(held.detector_options)


def test_saturated_pixels_stay_saturated():
    scene, frame = lit()
    shot = vs.difference(vs.record(scene, frame, sensor="cmos_5um5", peak=3.0))
    clipped = shot.on_grey >= shot.on.sensor.saturation
    assert clipped.any()
    assert np.all(shot.saturated[clipped])
    assert np.all(vs.line_centres(shot).status != vs.Status.OK)


def test_options_of_a_command_make_it_and_motion():
    """A frame of a moving part is exposed as long as it moves; without a time it is refused."""
    scene = vs.load_scene(
        "hot_cylinder", field="", f_number=8, sub_pupils=1, emissivity=0.8, **SMALL
    )
    options = RecordingOptions(
        exposure="200us", velocity="0,0,300", difference=True, sensor_model="cmos_5um5"
    )
    frame = options.rendered(scene)
    shot = options.recorded(scene, frame, "hot")
    assert isinstance(frame, vs.ExposedFrame)
    assert isinstance(shot, vs.DifferenceFrame)
    assert shot.exposure_s == frame.exposure_s == 2e-4
    assert shot.drawn["off"] != shot.drawn["noise"]
    assert "--velocity=0,0,300" in options.words
    other = vs.record(scene, frame, exposure_s=1e-3)
    assert any("the part moves for 0.0002 s" in note for note in other.notes)
    assert not any("skewed" in note for note in shot.notes)
    sensor = replace(vs.image_sensor("cmos_5um5"), row_time_us=15.0)
    rolling = replace(options, difference=False, sensor_model=sensor).rendered(scene)
    assert isinstance(rolling, vs.ExposedFrame)
    assert rolling.row_time_s == pytest.approx(15e-6)
    warm = replace(sensor, dark_current_e_s=1e6)  # which is in both frames, and cancels
    dark = vs.difference(vs.record(scene, frame, sensor=warm))
    unlit = frame.radiance <= frame.background
    noise = dark.detector_options["noise"] / np.sqrt(unlit.sum())
    assert dark.grey[unlit].mean() == pytest.approx(dark.pedestal, abs=5.0 * noise + 0.5)
    assert any("skewed" in note for note in vs.record(scene, rolling).notes)
    pinhole = vs.load_scene("cold_cylinder", **SMALL)
    assert vs.record(pinhole, vs.render_exposure(pinhole, 1e-4)).exposure_s is None
    with pytest.raises(InputError, match="--exposure 2ms"):
        RecordingOptions(velocity="0,0,1").rendered(scene)
    for wrong in ("1,2", "a,b,c", "1,2,nan"):
        with pytest.raises(InputError, match="x, y, z in mm/s"):
            RecordingOptions(velocity=wrong)
