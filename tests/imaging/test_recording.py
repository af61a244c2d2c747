"""A recorded frame: exposure by the lens, seeds of its own, the truth in each column."""

import json
import pickle
from concurrent.futures import ThreadPoolExecutor
from dataclasses import replace

import cv2
import numpy as np
import pytest
from scipy import constants
from several import text_of

import virtual_sensor as vs
from virtual_sensor.devices.coherence import Coherence
from virtual_sensor.errors import InputError
from virtual_sensor.imaging.fringe_recording import FringeRecording
from virtual_sensor.imaging.recording import aperture_of, blur_px_of, surface_of
from virtual_sensor.imaging.recording_options import RecordingOptions
from virtual_sensor.imaging.render import light_of_sources
from virtual_sensor.imaging.speckle import Aperture
from virtual_sensor.optics.lens import Lens
from virtual_sensor.seeds import part_seed
from virtual_sensor.studies.error_split import in_16_bits

QUIET = vs.ImageSensor(dark_noise_e=0.0, dsnu_e=0.0, prnu=0.0, pixel_um=5.5, full_well_e=1e5)


@pytest.fixture(scope="module")
def scene():
    return vs.load_scene(
        "hot_cylinder", width=160, height=160, spp=4, emissivity=0.8, line_radius=0.6
    )


@pytest.fixture(scope="module")
def frame(scene):
    return vs.render_frame(scene, background=True)


def with_lens(scene, f_number=8.0, **changes):
    """The scene with the thin lens of the paper's set-up before its sensor."""
    lens = Lens.of_f_number(75.0, 300.0, f_number)
    camera = replace(scene.camera, lens=lens, **changes)
    return replace(scene, cameras={scene.camera_name: camera})


def test_a_lens_and_a_time_make_as_many_electrons_as_photons_carry_energy(scene):
    """E = pi L tau/(4 N_w^2) by hand, with CODATA's constants: N = 8, m = 1/4, 2 ms."""
    radiance = np.full((160, 160), 1e-5)  # W/(mm^2 sr)
    shot = vs.record(with_lens(scene, transmission=0.9), radiance, sensor=QUIET, exposure_s="2ms")
    joules = np.pi * 10.0 * 0.9 / (4.0 * 10.0**2) * (5.5e-6) ** 2 * 2e-3  # 10 W/(m^2 sr)
    expected = 0.62 * joules * 532e-9 / (constants.h * constants.c)
    assert 1000.0 < expected < 10_000.0
    np.testing.assert_allclose(shot.electrons, expected, rtol=1e-6)
    found = (shot.grey.mean() - 64.0) / 0.37
    assert found == pytest.approx(expected, abs=4.0 * np.sqrt(expected) / 160.0 + 0.01)
    assert shot.exposure_s == 0.002


def test_automatic_exposure_finds_the_time_that_makes_the_brightest_pixel_so_bright(scene, frame):
    lens = with_lens(scene)
    auto = vs.record(lens, frame, 5, sensor=QUIET)
    assert auto.electrons.max() == pytest.approx(0.8 * (4095.0 - 64.0) / 0.37, rel=1e-6)
    again = vs.record(lens, frame, 5, sensor=QUIET, exposure_s=auto.exposure_s)
    np.testing.assert_array_equal(again.grey, auto.grey)
    pinhole = vs.record(scene, frame, 5, sensor=QUIET)
    np.testing.assert_array_equal(pinhole.grey, auto.grey)
    assert pinhole.exposure_s is None
    wide = with_lens(scene, f_number=4.0)
    assert vs.record(wide, frame, sensor=QUIET).exposure_s == pytest.approx(auto.exposure_s / 4.0)


def test_beyond_a_knee_the_brightest_pixel_still_lies_at_its_share_of_the_grey_values(scene, frame):
    sensor = replace(QUIET, knee=(0.5, 6.0), full_well_e=10_000.0)
    shot = vs.record(scene, frame, sensor=sensor, peak=0.75)
    assert shot.grey.max() == pytest.approx(64.0 + 0.75 * 3700.0, abs=150.0)


def test_a_frame_is_the_same_alone_and_among_many_in_any_order_and_thread(scene, frame):
    options = RecordingOptions(sensor_model="cmos_5um5", seed=7)
    alone = options.recorded(scene, frame, "hot", 3)
    with ThreadPoolExecutor(3) as pool:
        numbers = [4, 3, 0, 1]
        many = pool.map(lambda number: options.recorded(scene, frame, "hot", number), numbers)
    many = dict(zip(numbers, many, strict=True))
    np.testing.assert_array_equal(many[3].grey, alone.grey)
    assert np.mean(many[4].grey != alone.grey) > 0.5
    direct = vs.record(scene, frame, alone.seed, sensor="cmos_5um5")  # by what its file says
    np.testing.assert_array_equal(direct.grey, alone.grey)
    assert many[3].drawn == alone.drawn
    assert (
        len({part_seed(7, *parts) for parts in [(), (3,), ("hot", 3), ("hot",), ("cold", 3)]}) == 5
    )


def test_the_background_is_the_frame_without_its_sources_and_changes_no_bit(scene, frame):
    np.testing.assert_array_equal(vs.render_frame(scene).radiance, frame.radiance)
    np.testing.assert_allclose(vs.render(replace(scene, sources={})), frame.background, rtol=1e-5)
    assert frame.background.max() > 0.0
    assert vs.render_frame(scene.cold(), background=True).background.max() == 0.0
    np.testing.assert_array_equal(light_of_sources(scene), frame.radiance - frame.background)


def test_laser_light_alone_is_speckled(scene, frame):
    aperture = Aperture(16.0, magnification=0.25)
    shot = vs.record(scene, frame, 2, sensor=QUIET, speckle=aperture)
    dark = ~cv2.dilate(frame.lit.astype(np.uint8), np.ones((81, 81))).astype(bool)
    assert np.any(frame.background[dark])
    np.testing.assert_array_equal(shot.speckled[dark], frame.background[dark])
    same = vs.record(scene, frame, 3, sensor=QUIET, speckle=aperture, surface_seed=9)
    still = vs.record(scene, frame, 4, sensor=QUIET, speckle=aperture, surface_seed=9)
    np.testing.assert_array_equal(same.speckled, still.speckled)
    assert np.any(same.grey != still.grey)
    lens = with_lens(scene, f_number=16.0)
    by_lens = vs.record(lens, frame, 2, sensor=QUIET, speckle=True)
    np.testing.assert_array_equal(by_lens.speckled, shot.speckled)


def test_a_part_at_rest_keeps_its_speckle_and_one_that_moved_has_another(scene, frame):
    """Neither the frame's seed nor the air moves it; its own number, its place and its light do."""
    aperture = Aperture(16.0, magnification=0.25)

    def seen(where, seed=0, **others):
        return vs.record(where, frame, seed, sensor=QUIET, speckle=aperture, **others).speckled

    first = seen(scene)
    told = vs.record(scene, frame, sensor=QUIET, speckle=aperture, surface_seed=7).drawn
    assert told["surface_seed"] == 7
    assert told["surface"] == surface_of(scene, 7) != surface_of(scene)
    for still in (seen(scene, 5), seen(scene.cold()), seen(with_lens(scene, f_number=4.0))):
        np.testing.assert_array_equal(still, first)
    pose = scene.laser.pose
    turned = scene.with_pose(
        "laser", replace(pose, origin_mm=np.add(pose.origin_mm, [1e-3, 0.0, 0.0]))
    )
    parameters = {**scene.parameters, "along": "0.001"}
    moved = vs.load_scene("hot_cylinder", **parameters)
    for other in (seen(scene, surface_seed=1), seen(turned), seen(moved)):
        shared = np.corrcoef(other[frame.lit], first[frame.lit])[0, 1]
        alike = np.corrcoef(frame.radiance[frame.lit], first[frame.lit])[0, 1]
        assert shared < alike


def test_a_line_out_of_focus_is_speckled_by_a_pupil_that_is_out_of_focus(scene):
    """More noise than the blurred light itself would have; the light stays that of the frame."""
    lens = Lens.of_f_number(75.0, 290.0, 8.0)
    narrow = vs.load_scene("cold_cylinder", width=128, height=96, spp=16, pixel=5.5)
    blurred = replace(narrow, cameras={"camera": replace(narrow.camera, lens=lens)})
    frame = vs.render_frame(blurred)
    radius = lens.pupil_radius_mm * (1.0 / 290.0 - 1.0 / 300.0) * 75.0 / 5.5e-3
    assert np.median(blur_px_of(blurred, frame)[frame.lit]) == pytest.approx(radius, rel=0.03)
    v = np.arange(96)[:, None]
    near = np.abs(v - (v * frame.radiance).sum(axis=0) / frame.radiance.sum(axis=0)) < 15

    def centres(seen):
        return (v * seen * near).sum(axis=0) / (seen * near).sum(axis=0)

    numbers = range(8)
    shots = [vs.record(blurred, frame, speckle=True, surface_seed=n).speckled for n in numbers]
    aperture = aperture_of(blurred, frame, vs.ImageSensor(pixel_um=5.5), True)
    flat = [vs.speckled(frame.radiance, aperture, n) for n in numbers]
    found, of_flat = ([centres(seen) for seen in each] for each in (shots, flat))
    assert np.std(found, axis=0).mean() > 1.1 * np.std(of_flat, axis=0).mean()
    assert np.mean(found) == pytest.approx(centres(frame.radiance).mean(), abs=0.15)
    assert np.sum(shots) / len(shots) == pytest.approx(frame.radiance.sum(), rel=0.05)


def test_the_lasers_coherence_makes_the_contrast_and_projected_light_has_none(scene, frame):
    lens = with_lens(scene, f_number=16.0)
    laser = replace(scene.laser, coherence=Coherence(polarisations=2, modes=4.0))
    partly = replace(lens, sources={"laser": laser})
    aperture = aperture_of(partly, frame, QUIET, True)
    assert aperture.patterns == 8.0
    assert aperture.resolution_px == pytest.approx(0.532 * 16.0 * 1.25 / 5.5, rel=1e-6)
    dark = replace(lens, sources={})
    with pytest.raises(InputError, match="laser light alone is speckled"):
        vs.record(dark, frame, sensor=QUIET, speckle=True)


def test_motion_during_the_exposure_adds_patterns(scene):
    """0.2 m/s along the line for 1 ms at magnification 1/4: 50 um in the image."""
    lens = with_lens(scene, f_number=16.0, sub_pupils=1)
    frame = vs.render_exposure(lens, 1e-3, velocity_mm_s=(0.0, 200.0, 0.0))
    pixel_um = 11_264 / 160
    sensor = replace(QUIET, pixel_um=pixel_um)
    still, moved = (aperture_of(lens, f, sensor, True) for f in (vs.render_frame(lens), frame))
    path = 50.0 / (0.532 * 16.0 * 1.25) / (32.0 / (3.0 * np.pi**2))  # in grains
    assert still.patterns == 1.0
    assert moved.patterns == pytest.approx(path, rel=0.2)


def test_detectors_are_told_what_the_sensor_knows(scene, frame):
    shot = vs.record(scene, frame, 1, sensor="cmos_5um5")
    told = {name: shot.detector_options[name] for name in ("noise", "gain", "saturation")}
    for method in ("gaussian", "max_likelihood"):
        assert vs.line_centres(shot, method) == vs.line_centres(shot.grey, method, **told)
    assert vs.line_centres(shot, noise=50.0) == vs.line_centres(
        shot.grey, noise=50.0, gain=told["gain"], saturation=told["saturation"]
    )
    errors = vs.compare_line(vs.line_centres(shot), shot)
    assert errors == vs.compare_line(vs.line_centres(shot), frame)
    assert errors.count > 0


def test_dark_current_is_a_part_of_black_and_of_noise(scene):
    sensor = replace(QUIET, dark_noise_e=3.0, dark_current_e_s=1e5)
    dark = vs.record(with_lens(scene), np.zeros((160, 160)), sensor=sensor, exposure_s=0.01)
    told = dark.detector_options
    assert dark.grey.mean() == pytest.approx(told["black"], abs=0.3)
    assert dark.grey.std() == pytest.approx(told["noise"], rel=0.02)


def test_fringes_decode_with_what_their_recording_says():
    scene = vs.load_scene(
        "fringe_cylinder", width=64, height=64, spp=4, projector_width=320, projector_height=200
    )
    codec = vs.codec_of("phase 4 20,320 u", scene.projector.size)
    frames = vs.render_sequence(scene.cold(), codec.patterns)
    shot = vs.record(scene, frames, 1)
    assert shot.grey.shape == frames.radiance.shape
    assert np.any(shot.grey[0] != shot.grey[4])
    expected = codec.decode(shot.grey, sensor=shot.sensor)
    assert codec.decode(shot) == expected
    assert expected.ok.any()
    with pytest.raises(InputError, match=r"ideal\.projector_pixel"):
        _ = shot.truth


def test_fringes_are_exposed_by_electrons_in_steps_of_any_bits(scene):
    """From black to white, and below black; by a converter that is full before the well too."""
    usual, coarse = vs.ImageSensor(), FringeRecording(electrons=8000.0, bits=8).of(scene)
    assert coarse.white == 255
    assert coarse.saturation_e == pytest.approx(usual.saturation_e)
    assert coarse.black_level / coarse.gain == pytest.approx(usual.black_level / usual.gain)
    clipped = vs.ImageSensor(gain=1.0, bit_depth=8)  # by the converter, far below the well
    camera = replace(scene.camera, sensor=clipped)
    seen = replace(scene, cameras={scene.camera_name: camera})
    options, even = FringeRecording(electrons=150.0), np.full((1, 160, 160), 2e-5)
    assert options.electrons_of(seen, 2e-5) == pytest.approx(150.0)
    cold, hot, again = (options.shot(seen, even, name).grey for name in ("cold", "hot", "hot"))
    np.testing.assert_array_equal(hot, again)
    assert np.any(cold != hot)  # each sequence has noise of its own


def test_the_truth_of_a_column_is_that_of_a_search_and_of_its_light(scene, frame):
    """Row against searched rays; width and electrons against the ideal profile's moments."""
    shot = vs.record(scene, frame)
    truth, width = shot.truth, 160
    y_mm = np.linspace(-10.0, 10.0, 101)
    found = vs.ray_search(scene, y_mm, "newton")
    searched = vs.TrueLine.of_search(found.pixel, found.status == vs.SearchStatus.FOUND, width)
    inner = (truth.visibility > 0.999) & np.isfinite(searched.row[0, truth.column])
    at = truth.column[inner]
    assert inner.sum() > 50
    assert np.abs(truth.row_px[inner] - searched.row[0, at]).max() < 0.01
    light = (frame.radiance - frame.background)[:, at].astype(float)
    v = np.arange(width)[:, None]
    row = (v * light).sum(0) / light.sum(0)
    sigma = np.sqrt((((v - row) ** 2) * light).sum(0) / light.sum(0))
    assert np.median(truth.width_px[inner] / np.sqrt(sigma**2 - 1.0 / 12.0)) == pytest.approx(
        1.0, abs=0.05
    )
    electrons = light.sum(0) * shot.electrons_per_radiance
    np.testing.assert_allclose(truth.electrons[inner], electrons, rtol=1e-4)
    assert np.all(truth.blur_px == 0.0)


def test_an_exposure_that_saturates_or_hides_the_whole_line_is_told(scene, frame):
    assert vs.record(scene, frame).notes == ()
    (bright,) = vs.record(scene, frame, peak=20.0).notes
    assert "all lit columns are saturated" in bright
    assert "a lower peak" in bright  # it was exposed automatically
    (faint,) = vs.record(scene, frame, peak=5e-4).notes
    assert "a higher peak" in faint
    for time, advice in (("1s", "a shorter time"), ("1ns", "a longer time")):
        *_, note = vs.record(with_lens(scene), frame, sensor=QUIET, exposure_s=time).notes
        assert f"expose for {advice}, or leave it to auto" in note
    (none,) = vs.record(scene, np.zeros((160, 160))).notes
    assert "dark" in none


def test_options_record_if_they_or_the_camera_ask_for_it(scene, frame):
    assert RecordingOptions().of(scene) is None
    assert RecordingOptions(seed=3).recorded(scene, frame) is None
    assert RecordingOptions(exposure="auto").of(scene) == vs.ImageSensor()
    assert RecordingOptions().of(with_lens(scene, sensor=QUIET)) == QUIET
    assert RecordingOptions("profile_sensor").of(scene).name == "profile_sensor"


def test_what_is_said_of_recording_and_changes_nothing_is_told(scene, frame):
    """Rationale: who sets a linewidth and sees the same speckle believes that it is small."""
    assert RecordingOptions().unheeded(scene) == []
    assert "--seed" in RecordingOptions(seed=1).unheeded(scene)[0]
    assert RecordingOptions("cmos_5um5", seed=1).unheeded(scene) == []
    assert "exposure" in RecordingOptions().unheeded(with_lens(scene, exposure_s=1.0))[0]
    for given, known in (({"linewidth_nm": 2.0}, 1), ({"roughness_um": 9.0}, 1), ({"modes": 2}, 0)):
        lit = with_lens(scene, f_number=32.0)
        laser = replace(scene.laser, coherence=Coherence(**given))
        lit = replace(lit, sources={scene.source_name: laser})
        (note,) = RecordingOptions("cmos_5um5").unheeded(lit)
        assert "--speckle" in note
        assert RecordingOptions(speckle=True).unheeded(lit) == []
        notes = vs.record(lit, frame, sensor=QUIET, speckle=True).notes
        assert sum("alone changes no speckle" in note for note in notes) == known
        assert not any("fully coherent" in note for note in notes)
    notes = vs.record(with_lens(scene, f_number=32.0), frame, sensor=QUIET, speckle=True).notes
    assert any("fully coherent" in note for note in notes)


def test_bad_input_is_told(scene, frame):
    lens, unscaled = with_lens(scene), with_lens(scene, pixel_um=None)
    plain = vs.render_frame(scene)
    for words, ask in {
        "-D f_number=8": lambda: vs.record(scene, frame, exposure_s=0.002),
        "pinhole has no aperture": lambda: vs.record(scene, frame, speckle=True),
        "background=True": lambda: vs.record(lens, plain, sensor=QUIET, speckle=True),
        "how large its pixels": lambda: vs.record(unscaled, frame, exposure_s=0.002),
        "160 x 160": lambda: vs.record(scene, np.ones((8, 8))),
        "give a Frame": lambda: vs.record(scene, "shot.png"),
        "negative, or not finite": lambda: vs.record(scene, np.full((160, 160), np.nan)),
        "holds what is negative": lambda: vs.record(scene, frame.radiance - 1.0),
        "recorded already": lambda: vs.record(scene, vs.record(scene, frame)),
        "ideal frame": lambda: vs.grey_values(vs.record(scene, frame), peak_e=1000),
        "grey values already": lambda: vs.speckled(vs.record(scene, frame), Aperture(8.0)),
        "bits end at 255": lambda: vs.record(
            scene, frame, sensor=vs.ImageSensor(bit_depth=8, black_level=300)
        ),
        "give an ImageSensor": lambda: vs.record(scene, frame, sensor=3),
        "no_such": lambda: vs.record(scene, frame, sensor="no_such"),
        "such as 2ms": lambda: vs.record(lens, frame, exposure_s="2 parsec"),
        "--exposure": lambda: RecordingOptions(exposure="-2ms"),
        "peak": lambda: vs.record(scene, frame, peak=0.0),
        "seed": lambda: vs.record(scene, frame, seed=-1),
    }.items():
        with pytest.raises(InputError, match=words):
            ask()


def test_a_frame_of_another_pose_is_refused_and_one_of_other_air_is_not(scene, frame):
    vs.record(scene.cold(), frame)  # bent by up to 3 px
    turned = vs.Pose.turn(2.0, [1, 0, 0], about_mm=[0, 0, -13.5])
    for motion in (turned, vs.Pose.shift([0.1, 0, 0]), vs.Pose.shift([0, 4, 0])):
        with pytest.raises(InputError, match="the scene that rendered it"):
            vs.record(scene.with_sensor_moved(motion), frame)


def test_times_are_read_with_their_units():
    from virtual_sensor.devices.exposure_time import exposure_time_s

    for text, seconds in {
        "2ms": 0.002,
        "500us": 5e-4,
        "500 µs": 5e-4,
        "0.1": 0.1,
        1e-5: 1e-5,
    }.items():
        assert exposure_time_s("t", text) == seconds, text
    assert exposure_time_s("t", "auto") is exposure_time_s("t", "") is exposure_time_s("t", None)
    for text in ("0", "-1ms", "2m", "nan", "1e9", "ms", "inf"):
        with pytest.raises(InputError, match="such as 2ms"):
            exposure_time_s("t", text)


def test_grey_values_beyond_a_knee_are_stretched_back_in_proportion_to_the_light():
    """Rationale: means of even light, over its whole range: six full wells."""
    sensor = vs.ImageSensor(knee=(0.5, 6.0), prnu=0.0, dsnu_e=0.0)
    electrons = np.array([0.1, 0.4, 0.7, 2.0, 4.0, 5.5]) * sensor.full_well_e
    light = np.broadcast_to(electrons[:, None, None] / sensor.quantum_efficiency, (6, 64, 64))
    grey = vs.grey_values(light, sensor)
    linear = sensor.without_knee(grey).mean(axis=(1, 2)) - sensor.black_level
    np.testing.assert_allclose(linear, sensor.gain * electrons, rtol=0.01)
    assert grey[-1].mean() - sensor.black_level < 0.2 * sensor.gain * electrons[-1]
    plain = vs.ImageSensor()
    np.testing.assert_array_equal(plain.without_knee(grey), grey)


def test_columns_that_a_knee_leaves_clipped_have_that_status(tmp_path):
    """Rationale: single and double precision parted the image from its saturation: DOUBLED."""
    rows = np.arange(64)[:, None] - np.linspace(30.0, 33.0, 40)
    for black in (4.0, 5.0, 6.0, 7.0):
        sensor = replace(vs.image_sensor("profile_sensor"), black_level=black)
        brim = sensor.light_e(sensor.full_well_e) / sensor.quantum_efficiency
        grey = vs.grey_values(3.0 * brim * np.exp(-(rows**2) / 8.0), sensor)
        vs.save_png(grey, tmp_path / "shot.png", sensor=sensor)
        for shot in (
            sensor.linear(grey, sensor.detector_options),
            vs.read_image(tmp_path / "shot.png"),
        ):
            line = vs.line_centres(shot)
            assert np.all(line.status == vs.Status.CLIPPED), line


def test_a_line_that_a_knee_flattens_is_found_as_wide_as_it_is(scene, frame):
    """Rationale: flat profiles are no line's; of wider lines no column had a centre."""
    shot = vs.record(scene, frame, sensor="profile_sensor")
    found, flat, ideal = map(vs.line_centres, (shot, shot.grey, frame))
    width = np.nanmedian(found.width / ideal.width)
    assert width == pytest.approx(1.0, abs=0.02)
    assert np.nanmedian(flat.width / ideal.width) > 1.2
    errors = vs.compare_line(found, frame)
    assert errors.count > 0.9 * errors.expected
    assert errors.rms_px < 0.05
    ordinary = vs.record(scene, frame)
    assert ordinary.linear_grey is ordinary


def test_a_folder_holds_the_frame_its_ideal_one_the_truth_and_what_made_them(
    scene, frame, tmp_path
):
    shot = vs.record(scene, frame, 6, sensor="cmos_5um5")
    for images in ("png", "tif"):
        folder = shot.write(tmp_path / images, images)
        names = sorted(each.name for each in folder.iterdir())
        assert names == sorted([f"frame.{images}", "ideal.exr", "summary.json", "truth.csv"])
        image = vs.read_image(folder / f"frame.{images}")
        np.testing.assert_array_equal(image.pixels, shot.grey)
        assert image.detector_options == pytest.approx(shot.detector_options)
        assert image.metadata["drawn"] == shot.drawn
        assert vs.line_centres(image) == vs.line_centres(shot)
    np.testing.assert_array_equal(vs.read_image(folder / "ideal.exr").pixels, frame.radiance)
    rows = np.genfromtxt(folder / "truth.csv", delimiter=",", names=True)
    np.testing.assert_allclose(rows["row_px"], shot.truth.row_px, rtol=1e-12)
    said = json.loads((folder / "summary.json").read_text(encoding="utf-8"))
    again = vs.record(
        vs.load_scene(said["scene"], **said["parameters"]),
        frame,
        said["seed"],
        sensor=said["sensor"]["name"],
    )
    np.testing.assert_array_equal(again.grey, shot.grey)
    with pytest.raises(InputError, match="exists"):
        shot.write(folder)
    assert shot.write(folder, overwrite=True) == folder
    assert vs.read_image(shot.write(tmp_path / "one.tif")).detector_options["gain"] == 0.29


def test_files_of_sequences_and_radiances(scene, tmp_path):
    both = np.stack([np.full((160, 160), level) for level in (1.0, 2.0)])
    shots = vs.record(scene, both)
    folder = shots.write(tmp_path / "two")
    names = sorted(each.name for each in folder.iterdir())
    ends = ("00", "01")
    images = [f"frame_{n}.png" for n in ends] + [f"ideal_{n}.exr" for n in ends]
    assert names == [*images, "summary.json"]
    np.testing.assert_array_equal(vs.read_image(folder / "frame_01.png").pixels, shots.grey[1])
    for words, path in {"name a folder": "a.png", "without a suffix": "a.jpg"}.items():
        with pytest.raises(InputError, match=words):
            shots.write(tmp_path / path)
    assert sorted(each.name for each in tmp_path.iterdir()) == ["two"]


def test_a_scene_of_other_pixels_than_its_sensors_is_told(scene, frame):
    small = replace(QUIET, name="small", width_px=64, height_px=200, pixel_um=3.45)
    lens = with_lens(scene, pixel_um=5.5)
    size, pitch = vs.record(lens, frame, sensor=small).notes
    assert "160 x 160 px, and small 64 x 200" in size
    assert "5.5 um wide in the scene, and 3.45 um" in pitch
    assert vs.record(lens, frame, sensor=QUIET).notes == ()


def test_a_recorded_frame_goes_to_other_processes_and_into_tables(scene, frame):
    shot = vs.record(scene, frame, 1)
    assert pickle.loads(pickle.dumps(shot)) == shot
    assert list(shot.to_dataframe()["column"]) == list(shot.truth.column)
    (row,) = vs.record(scene, frame.radiance, peak=2.0).to_dataframe().to_dict("records")
    assert row["brightest"] == shot.sensor.saturation
    assert row["saturated"] > 0


def test_lines_of_several_lasers_have_a_truth_each(tmp_path):
    path = tmp_path / "two.xml"
    path.write_text(text_of("hot_cylinder", [("eye", 0, 1)], [("one", 0, 0), ("two", 5, 6)]))
    scene = vs.load_scene(path, width=128, height=128, spp=1)
    frame = vs.render_frame(scene)
    shot = vs.record(scene, frame)
    with pytest.raises(InputError, match="one, two"):
        _ = shot.truth
    rows = [shot.line_truth(name).row_px.mean() for name in ("one", "two")]
    assert abs(rows[0] - rows[1]) > 2.0
    names = {each.name for each in shot.write(tmp_path / "out").iterdir()}
    assert {"truth_0_one.csv", "truth_1_two.csv"} < names
    # Their speckle is that of the more coherent one.
    modes = zip(scene.sources.items(), (2.0, 5.0), strict=True)
    lit = {n: replace(each, coherence=Coherence(modes=many)) for (n, each), many in modes}
    assert aperture_of(replace(with_lens(scene), sources=lit), frame, QUIET, True).patterns == 2.0


def test_two_cameras_have_noise_pattern_and_speckle_of_their_own_by_one_seed(tmp_path):
    """Rationale: noise that two cameras share would vanish from what is matched between them."""
    path = tmp_path / "two.xml"
    path.write_text(text_of("hot_cylinder", [("left", 0, 1), ("right", -60, 1)], [("one", 0, 0)]))
    scene = vs.load_scene(path, width=64, height=64, spp=1, f_number=40, pixel=5.5)
    flat = np.ones((64, 64), np.float32)
    uneven = replace(QUIET, prnu=0.05)
    for sensor in (vs.image_sensor("cmos_5um5"), uneven):
        shots = [vs.record(scene, flat, 3, sensor=sensor, camera=name) for name in scene.cameras]
        again = vs.record(scene.only("right"), flat, 3, sensor=sensor)
        left, right = (shot.grey.ravel().astype(float) for shot in shots)
        assert abs(np.corrcoef(left, right)[0, 1]) < 0.05
        np.testing.assert_array_equal(again.grey, shots[1].grey)
    assert surface_of(scene.only("left")) != surface_of(scene.only("right"))
    dark = vs.record(scene, 0 * flat, 3, sensor=replace(QUIET, dsnu_e=9.0), camera="left")
    assert np.abs(in_16_bits(dark).grey / 16.0 - dark.grey).max() < 0.6  # of the same pattern


def test_the_width_of_a_blurred_line_is_that_of_its_sharp_profile_and_the_lenss_disc():
    """Beside the second moments of what is rendered through the pupil, 8 mm out of focus."""
    scene = vs.load_scene(
        "cold_cylinder", width=128, height=128, f_number=4, focus_distance=292, line_radius=0.6
    )
    tall = scene.camera.matrix * [[1.0], [1.5], [1.0]] - [[0.0] * 3, [0.0, 0.0, 32.0], [0.0] * 3]
    scene = scene.with_camera(replace(scene.camera, matrix=tall))  # a blur is wider along v
    frame = vs.render_frame(scene, spp=16)
    truth = vs.record(scene, frame).truth
    middle = np.abs(truth.column - 63.5) < 6.0  # where the line lies along the rows
    light = frame.radiance[:, truth.column[middle]].astype(float)
    v = np.arange(128)[:, None]
    row = (v * light).sum(0) / light.sum(0)
    sigma = np.sqrt(((v - row) ** 2 * light).sum(0) / light.sum(0) - 1.0 / 12.0)
    found = np.hypot(truth.width_px, truth.blur_px)[middle]
    assert middle.sum() > 10
    assert np.all(truth.blur_px[middle] > 0.2)
    np.testing.assert_allclose(found, sigma, rtol=0.01)
