"""A calibration by rendered frames beside the scene's own camera and projector."""

import json
from dataclasses import replace

import numpy as np
import pytest
from command_line import command
from data_dictionary import undocumented

import virtual_sensor as vs
from virtual_sensor.errors import InputError
from virtual_sensor.reporting.fringe_calibration import FILES
from virtual_sensor.studies.fringes.calibrate import (
    CalibrationSettings,
    calibrate_scene,
    target_for,
    target_poses,
)

CODEC = "phase 3 128,1280 uv"


@pytest.fixture(scope="module")
def scene():
    return vs.load_scene("fringe_cylinder", width=192, height=192, spp=16, pixels="false")


def settings(**named):
    given = {"codec": CODEC, "poses": 4, "distortion": 0}
    return CalibrationSettings(**{**given, **named})


def test_poses_of_the_target_are_seen_by_both_devices(scene):
    """Expected: nine tenths of the marks on camera and projector, their faces to both."""
    truth = scene.camera, scene.projector.family
    target = target_for(truth, settings())
    poses = target_poses(truth, 20)
    inside = []
    for pose in poses:
        points = pose.to_world(target.points_mm)
        inside.append(np.all([each.inside(each.project(points)) for each in truth], axis=0))
        for each in truth:
            towards = pose.origin_mm - each.pose.origin_mm
            assert towards @ pose.rotation[:, 2] > 0.4 * np.linalg.norm(towards)
        assert np.linalg.det(pose.rotation) == pytest.approx(1.0)
    assert np.mean(inside) > 0.9
    lifted = target_poses(truth, 3, 10.0)
    up = lifted[0].origin_mm - poses[0].origin_mm
    assert up @ scene.towards_sensors == pytest.approx(10.0, abs=1e-3)


@pytest.mark.slow
def test_a_calibration_finds_the_scenes_own_devices(scene):
    """Expected: what the marks' own scatter allows, four standard deviations."""
    shots = []
    found = calibrate_scene(scene, settings(target="dots"), keep=lambda n, each: shots.append(each))
    summary = found.summary
    assert summary.camera_error_px < 0.03
    assert summary.projector_error_px < 0.15  # 3.5 projector pixels are one of this camera's
    assert summary.largest_sigmas < 4.0
    assert summary.shape_rms_um < 10.0
    assert summary.seen_by_truth_rms_um < 20.0
    assert len(shots) == 4
    assert shots[0].patterns.shape == (12, 192, 192)
    assert sum(summary.marks.values()) == len(found.marks) == 4 * 99
    assert found.calibration.camera.pose == scene.camera.pose
    assert summary.frames == 4 * 13


@pytest.mark.slow
def test_hot_air_moves_what_is_calibrated_beyond_what_its_sigmas_know(scene):
    """Rationale: the fit bends its lenses after the air, and its residuals don't tell all of it."""
    cold = calibrate_scene(scene, settings(distortion=4, poses=8)).summary
    hot = calibrate_scene(scene, settings(distortion=4, poses=8, hot=True)).summary
    assert hot.camera_error_px > 10.0 * cold.camera_error_px
    assert hot.shape_rms_um > 10.0 * cold.shape_rms_um
    assert "--lift" in hot.notes[-1]


@pytest.mark.usefixtures("unpainted_test")
def test_the_command_writes_what_is_documented(tmp_path):
    options = ["-D", "width=128", "-D", "height=128", "-D", "pixels=false", "--target", "dots"]
    options += ["--codec", "phase 3 80,1280 uv", "--poses", "3", "--distortion", "0"]
    options += ["--electrons", "9000", "--spp", "4"]
    folder = tmp_path / "found"
    status, said, _ = command(
        "fringes", "calibrate", "fringe_cylinder", *options, "--frames", "-o", folder
    )
    assert status == 0
    assert "µrad" in said
    assert undocumented(folder, FILES) == []
    assert len(list((folder / "frames").iterdir())) == 3 * 13
    read = vs.FringeCalibration.read(folder / "calibration.yaml")
    summary = json.loads((folder / "summary.json").read_text(encoding="utf-8"))
    assert read.projector_rms_px == pytest.approx(summary["projector_rms_px"])
    assert summary["electrons"] == 9000
    found = {each["name"]: each["value"] - each["truth"] for each in summary["estimated"]}
    place = [1e3 * found[f"projector_{axis}_mm"] for axis in "xyz"]
    turns = [1e6 * found[f"projector_turn_{axis}_rad"] for axis in "xyz"]
    assert summary["position_error_um"] == pytest.approx(place, abs=1e-6)
    assert summary["turn_error_urad"] == pytest.approx(turns, abs=1e-6)
    assert read.camera.size == (128, 128)
    assert read.projector.size == (1280, 800)


def test_what_can_not_be_calibrated_is_told(scene):
    for wrong, said in (
        ({"hot": True}, "no hot air"),
        ({"poses": 2}, "--poses"),
        ({"target": "stripes"}, "stripes"),
        ({"pitch_mm": -1.0}, "--pitch"),
        ({"distortion": 3}, "--distortion 3"),
        ({"codec": "phase 3 1280 u"}, "say uv"),
    ):
        with pytest.raises(InputError, match=said):
            calibrate_scene(scene.cold(), settings(**wrong))
    laser = vs.load_scene("hot_cylinder", width=64, height=64)
    with pytest.raises(InputError, match="projector"):
        calibrate_scene(laser, settings())


def test_a_calibrations_file_serves_as_a_scenes_projector_and_in_a_scenes_place(scene, tmp_path):
    """Expected: what is written of the true devices gives the scene's own points."""
    lens = replace(scene.projector.family, distortion=np.array([-0.1, 0.2, 1e-3, -2e-3]))
    file = tmp_path / "both.yaml"
    for projector in (scene.projector.family, lens):
        vs.FringeCalibration(scene.camera, projector, np.zeros((0, 0))).write(file)
        text = scene.path.read_text(encoding="utf-8")
        head, _, tail = text.partition('<emitter type="pattern_projector"')
        emitter = f'<emitter type="pattern_projector"><string name="calibration" value="{file}"/>'
        own = tmp_path / "own.xml"
        own.write_text(head + emitter + tail[tail.index("</emitter>") :], encoding="utf-8")
        other = vs.load_scene(own, width=64, height=64, field="").projector
        np.testing.assert_allclose(other.family.matrix, projector.matrix, rtol=1e-14)
        np.testing.assert_allclose(other.pose.origin_mm, projector.pose.origin_mm, atol=1e-9)
        np.testing.assert_array_equal(other.family.distortion, projector.distortion)
    vs.FringeCalibration(scene.camera, scene.projector.family, np.zeros((0, 0))).write(file)
    v, u = np.mgrid[:192.0, :192.0]
    maps = [500.0 + 2.0 * v, 300.0 + u, *[np.full((192, 192), 0.1, np.float32)] * 4]
    decoded = vs.DecodedFringes(
        *maps, phase={}, status=np.zeros((192, 192), np.uint8), size_px=(1280, 800)
    )
    by_file = vs.reconstruct(vs.FringeCalibration.read(file), decoded).point_mm
    np.testing.assert_array_equal(vs.reconstruct(file, decoded).point_mm, by_file)
    np.testing.assert_allclose(by_file, vs.reconstruct(scene.cold(), decoded).point_mm, atol=1e-9)
    assert np.isfinite(by_file).mean() > 0.5
