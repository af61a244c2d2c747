"""Surfaces that fringes measured, corrected: beside a search, which knows what light was seen."""

import json
from dataclasses import replace

import cv2
import numpy as np
import OpenEXR
import pytest
from typer.testing import CliRunner

import virtual_sensor as vs
from virtual_sensor.cli.commands import app
from virtual_sensor.errors import InputError
from virtual_sensor.optics.rays import March
from virtual_sensor.records import write_json
from virtual_sensor.reporting.correct import save
from virtual_sensor.studies.correct.asked import Settings
from virtual_sensor.studies.correct.correct import correct
from virtual_sensor.studies.correct.measured import Scenes, of_fringes, read_measured
from virtual_sensor.studies.correct.surface import CorrectedSurface
from virtual_sensor.studies.fringes.decoded_files import write_decoded
from virtual_sensor.studies.provenance import scene_facts

SIDE = 48
SIGMA_PX = 0.02
QUICK = March(0.5, "leapfrog", "double")


@pytest.fixture(scope="module")
def searched():
    """A hot scene, and what each of its pixels sees of the projector's image."""
    scene = vs.load_scene("fringe_cylinder", width=SIDE, height=SIDE)
    v, u = np.mgrid[:SIDE, :SIDE]
    found = vs.projector_pixels(scene, np.stack([u.ravel(), v.ravel()], axis=1), march=QUICK)
    column, row = np.moveaxis(found.projector_pixel.reshape(SIDE, SIDE, 2), -1, 0)
    sigma, nothing = (np.full(column.shape, n, np.float32) for n in (SIGMA_PX, 1.0))
    status = np.where(np.isfinite(column), 0, 1).astype(np.uint8)
    rest = {"modulation": nothing, "mean": nothing, "phase": {}, "size_px": (1280, 800)}
    decoded = vs.DecodedFringes(column, row, sigma, sigma, status=status, **rest)
    return scene, decoded


@pytest.fixture
def folder(tmp_path, searched):
    """A folder as `fringes` writes it."""
    scene, decoded = searched
    (tmp_path / "fringed").mkdir()
    write_decoded(tmp_path / "fringed" / "hot.exr", decoded)
    facts = {**scene_facts(scene, ()).to_dict(), "states": {"cold": {}, "hot": {}}}
    write_json(tmp_path / "fringed" / "summary.json", facts | {"codec": "phase 4"})
    return tmp_path / "fringed"


def test_known_air_leaves_nothing_of_a_surface(searched):
    """The issue's line is 0.2 um rms; the pixels are the search's own."""
    scene, decoded = searched
    surface = CorrectedSurface.of(scene, decoded)
    errors = surface.errors
    assert errors.pixels == int(np.isfinite(decoded.column).sum())
    assert errors.rms_um < 0.2 < 100.0 < errors.uncorrected_rms_um
    assert errors.epipolar_px > 0.05
    cold = CorrectedSurface.of(scene.cold(), decoded)
    assert cold.errors.rms_um == errors.uncorrected_rms_um


@pytest.mark.slow
def test_a_folder_of_fringes_is_corrected_by_air_from_its_epipolar_residual(folder, tmp_path):
    """Rationale: no shape is sought; the air is the scene's, scaled by 1, and it is all told."""
    (measured,) = read_measured([str(folder)], Scenes())
    assert measured.name == "fringed"
    assert measured.along_mm is not None
    result = correct([measured], Settings(estimate=("scale", "width")))
    (estimate,) = result.estimates
    assert estimate.shape is None
    assert abs(estimate["scale"] - 1.0) < 5e-3 > abs(estimate["width"] - 1.0)
    (each,) = result.measurements
    assert each.surface.errors.rms_um < 3.0
    assert "fringes of one pose" in result.caveats[0]
    save(result, tmp_path / "corrected", "virtual-sensor correct fringed")
    file = OpenEXR.File(str(tmp_path / "corrected/surface_fringed.exr"), separate_channels=True)
    distance = file.channels()["distance"].pixels
    np.testing.assert_array_equal(distance, each.surface.corrected_um)
    figures = json.loads((tmp_path / "corrected/summary.json").read_text(encoding="utf-8"))
    assert figures["measurements"]["fringed"]["surface"]["pixels"] == each.surface.errors.pixels
    page = (tmp_path / "corrected/report.html").read_text(encoding="utf-8")
    assert "epipolar residual" in page


def test_the_command_takes_a_folder_of_fringes(folder, tmp_path):
    """Rationale: known air by default, as of a line."""
    done = CliRunner().invoke(app, ["correct", str(folder), "-o", str(tmp_path / "corrected")])
    assert done.exit_code == 0, done.output
    assert "All pixels of the surface" in done.output


@pytest.mark.slow
def test_a_column_alone_needs_a_shape_and_has_no_residual(searched):
    """Rationale: fringes along one axis are what most systems have."""
    scene, decoded = searched
    alone = of_fringes("columns", scene, replace(decoded, row=None, sigma_row=None))
    assert alone.along_mm is None
    settings = Settings(estimate=("scale",), shape="cylinder", free=())
    result = correct([alone], settings)
    assert abs(result.estimate["scale"] - 1.0) < 0.05
    assert result.measurements[0].surface.errors.epipolar_px is None


def test_a_sequence_of_ones_own_is_taken_with_its_scene(searched, tmp_path):
    """Rationale: `fringes decode` knows no scene."""
    scene, decoded = searched
    write_decoded(tmp_path / "decoded.exr", decoded)
    write_json(tmp_path / "summary.json", {"settings": {}})
    size = {"width": f"{SIDE}", "height": f"{SIDE}"}
    for given in (tmp_path, tmp_path / "decoded.exr"):
        (measured,) = read_measured([str(given)], Scenes("fringe_cylinder", size))
        np.testing.assert_allclose(measured.pixel, of_fringes("", scene, decoded).pixel, atol=1e-3)
        with pytest.raises(InputError, match="--scene"):
            read_measured([str(given)], Scenes())


def calibration(scene, path, shift_mm=0.0, turn_deg=0.0):
    """A file of OpenCV's camera and projector as the scene has them, the world the camera's."""
    camera, projector = scene.camera, scene.projector.family
    pose = projector.pose.moved(vs.Pose.turn(turn_deg, [0, 1, 0], projector.pose.origin_mm))
    turn = pose.rotation.T @ camera.pose.rotation
    place = pose.rotation.T @ (camera.pose.origin_mm - pose.origin_mm) + [shift_mm, 0, 0]
    file = cv2.FileStorage(str(path), cv2.FILE_STORAGE_WRITE)
    for name, value in (
        ("camera_matrix", camera.matrix),
        ("projector_matrix", projector.matrix),
        ("R", turn),
        ("T", place.reshape(3, 1)),
    ):
        file.write(name, value)
    file.release()
    return path


def test_a_calibration_of_camera_and_projector_takes_the_scenes_place(searched, folder, tmp_path):
    """Rationale: its world is the camera's, which stands where the scene's does."""
    scene, _ = searched
    same = calibration(scene, tmp_path / "same.yaml")
    (measured,) = read_measured([str(folder)], Scenes(), same)
    np.testing.assert_allclose(
        measured.scene.projector.pose.origin_mm, scene.projector.pose.origin_mm, atol=1e-6
    )
    assert not measured.notes
    near = calibration(scene, tmp_path / "near.yaml", shift_mm=0.1)
    (measured,) = read_measured([str(folder)], Scenes(), near)
    assert "the calibration's are taken" in measured.notes[0]
    far = calibration(scene, tmp_path / "far.yaml", turn_deg=5.0)
    with pytest.raises(InputError, match="not the calibration's"):
        read_measured([str(folder)], Scenes(), far)


def test_what_does_not_go_together_is_named(folder, searched, tmp_path):
    """Rationale: each with the remedy."""
    scene, decoded = searched
    with pytest.raises(InputError, match="no projector"):
        read_measured([str(folder)], Scenes("hot_cylinder", {"width": "48", "height": "48"}))
    with pytest.raises(InputError, match="48 x 48 px"):
        read_measured([str(folder)], Scenes(given={"width": "32"}))
    line = tmp_path / "line.csv"
    line.write_text("u,v\n30,30\n", encoding="utf-8")
    with pytest.raises(InputError, match="laser line"):
        read_measured([str(line)], Scenes("fringe_cylinder"))
    (folder / "hot.exr").unlink()
    with pytest.raises(InputError, match=r"hot\.exr"):
        read_measured([str(folder)], Scenes())
    twice = [of_fringes(name, scene, decoded) for name in ("one", "two")]
    with pytest.raises(InputError, match="very centres"):
        correct(twice, Settings(estimate=("scale",)))
