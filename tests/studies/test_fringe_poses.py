"""Poses of a fringe sensor, and a laser line beside it: by searches, with points on the part."""

from dataclasses import replace
from types import SimpleNamespace

import cv2
import numpy as np
import pytest
from typer.testing import CliRunner

import virtual_sensor as vs
from virtual_sensor.cli.commands import app
from virtual_sensor.errors import InputError
from virtual_sensor.optics.ray_families import Telecentric
from virtual_sensor.studies.fringes.poses import (
    DeviationFigures,
    PoseFigures,
    compare_poses,
    pose_maps,
    scored,
    weights_of,
)
from virtual_sensor.studies.fringes.sections import line_sensor, off_part_um, sections

SMALL = {"temperature": ["1250"], "width": ["256"], "height": ["256"]}
GRID = 6


@pytest.fixture(scope="module")
def compared():
    """Two poses of the hot scene on a coarse grid."""
    return compare_poses("fringe_cylinder", SMALL | {"beta": ["0", "30"]}, grid=GRID)


def test_known_air_leaves_nothing_and_straight_light_an_error_that_a_turn_escapes(compared):
    """Rationale: the paper's remedy is to measure beside the plume; the truth is the search's."""
    above, beside = (each.figures for each in compared.poses)
    assert above.name == "beta=0"
    assert above.bent.rms_um < 0.05 > beside.bent.rms_um
    assert above.straight.rms_um > 50.0 > 10.0 > beside.straight.rms_um
    assert above.straight.radius_error_um < -100.0
    assert abs(above.bent.radius_error_um) < 0.1
    assert above.epipolar_px > 30 * beside.epipolar_px
    shape = compared.poses[0].straight_um.shape
    assert shape == (GRID, GRID)
    known = np.isfinite(compared.poses[0].straight_um)
    assert known.sum() == above.points == round(above.coverage * above.pixels)


def test_the_figures_of_a_pose_are_those_of_its_geometry(compared):
    """Rationale: on the top line, 300 mm off, light and sight come in at 30 degrees each."""
    figures, pose = compared.poses[0].figures, compared.poses[0]
    top = np.unravel_index(np.nanargmax(pose.point_mm[..., 2]), (GRID, GRID))
    y, z = pose.point_mm[top][1:]
    assert abs(np.hypot(y, z + 13.5) - 13.5) < 1e-6  # on the part
    points = pose.point_mm[np.isfinite(pose.point_mm[..., 0])]
    normal = (points - np.array([0.0, 0.0, -13.5])) * [0.0, 1.0, 1.0] / 13.5
    devices = pose.scene.camera, pose.scene.projector
    told = figures.incidence_deg, figures.light_incidence_deg
    for device, mean_deg in zip(devices, told, strict=True):
        towards = device.pose.origin_mm - points
        cosine = np.sum(towards * normal, axis=1) / np.linalg.norm(towards, axis=1)
        assert np.degrees(np.arccos(cosine)).mean() == pytest.approx(mean_deg, abs=1e-3)
        assert 30.0 < mean_deg < 60.0
    assert 300.0 < figures.mean_distance_mm < 306.0
    pixel_um = 45.056e3 / 256
    assert pixel_um < figures.resolution_um < 1.6 * pixel_um
    # By the cylinder's own area: of the width that is seen at half its length.
    assert 0.5 * 45.0 * 27.0 < figures.area_mm2 < 1.5 * 45.0 * np.pi * 13.5


def test_the_figures_of_a_wide_view_are_those_of_its_solid_angles():
    """By hand, cold: lines of sight to the cylinder by its formula, the light by OpenCV.

    A pixel sees its solid angle (Van Oosterom and Strackee 1983) times r^2 over the cosine.
    """
    scene = vs.load_scene("fringe_cylinder", width=64, height=48, fov=24.0, beta=15).cold()
    figures = pose_maps(scene, "cold", {}, grid=32).figures
    camera, projector = scene.camera, scene.projector.family
    centre, focal = camera.pose.origin_mm, 32.0 / np.tan(np.radians(12.0))

    def toward(u, v):
        along = np.stack([u - 31.5, v - 23.5, np.full_like(u, focal)], axis=-1)
        return along @ camera.pose.rotation.T / np.linalg.norm(along, axis=-1, keepdims=True)

    u, v = (each.ravel() for each in np.meshgrid(np.arange(0.5, 64, 2), np.arange(0.5, 48, 2)))
    sight = toward(u, v)
    y, z = centre[1], centre[2] + 13.5
    a, b = sight[:, 1] ** 2 + sight[:, 2] ** 2, y * sight[:, 1] + z * sight[:, 2]
    with np.errstate(invalid="ignore"):
        length = (-b - np.sqrt(b**2 - a * (y**2 + z**2 - 13.5**2))) / a
    hit = np.flatnonzero(length > 0.0)
    point = centre + length[hit, None] * sight[hit]
    normal = (point - [0.0, 0.0, -13.5]) / 13.5 * [0.0, 1.0, 1.0]
    light = projector.pose.origin_mm - point
    turn, shift = projector.pose.rotation.T, -projector.pose.rotation.T @ projector.pose.origin_mm
    pixel = cv2.projectPoints(point, cv2.Rodrigues(turn)[0], shift, projector.matrix, None)[0]
    lit = (np.sum(light * normal, axis=1) > 0.0) & projector.inside(pixel[:, 0])
    lit &= np.abs(point[:, 0]) < 85.0
    hit, normal = hit[lit], normal[lit]
    assert figures.points == len(hit) > 30
    assert figures.coverage == pytest.approx(len(hit) / len(u))
    assert figures.mean_distance_mm == pytest.approx(length[hit].mean())
    cosine = -np.sum(sight[hit] * normal, axis=1)
    assert figures.incidence_deg == pytest.approx(np.degrees(np.arccos(cosine)).mean())
    one, two, three, four = (
        toward(u[hit] + x, v[hit] + y)
        for x, y in ((-0.5, -0.5), (0.5, -0.5), (0.5, 0.5), (-0.5, 0.5))
    )
    area = np.zeros(len(hit))
    for e, f, g in ((one, two, three), (one, three, four)):
        volume = np.sum(e * np.cross(f, g), axis=1)
        edges = 1.0 + np.sum(e * f, axis=1) + np.sum(f * g, axis=1) + np.sum(g * e, axis=1)
        area += 2.0 * np.arctan2(np.abs(volume), edges) * length[hit] ** 2 / cosine
    assert figures.resolution_um == pytest.approx(1e3 * np.sqrt(area.mean()), rel=1e-4)
    assert figures.area_mm2 == pytest.approx(4.0 * area.sum(), rel=2e-4)


def test_line_and_fringes_agree_through_the_air_and_differ_without(compared):
    """The issue's line is 0.5 um; by the search they agree but for rounding."""
    section = compared.poses[0].figures.section
    assert section.bent.difference_largest_um < 0.01
    assert 5.0 < section.straight.difference_rms_um < 20.0
    cold = vs.load_scene("fringe_cylinder").cold()
    found = sections(cold, rays=11)
    assert set(found.line_um) == {"straight"}
    assert found.figures.straight.difference_largest_um < 0.01
    assert found.figures.straight.areal_rms_um < 0.01


def test_the_line_sensor_stands_where_that_of_hot_cylinder_does():
    """Rationale: then line and areal sensor are compared on the paper's own set-up."""
    here = line_sensor(vs.load_scene("fringe_cylinder", beta=15)).laser
    there = vs.load_scene("hot_cylinder", beta=15).laser
    np.testing.assert_allclose(here.pose.origin_mm, there.pose.origin_mm, atol=1e-4)
    np.testing.assert_allclose(abs(here.plane[0] @ there.plane[0]), 1.0, atol=1e-9)
    assert here.length_mm == pytest.approx(37.5, rel=0.01)


def test_a_decoded_image_is_read_between_its_pixels():
    """Rationale: the line's pixels are no whole ones."""
    scene = vs.load_scene("fringe_cylinder", width=64, height=64).cold()
    v, u = np.mgrid[:64, :64]
    found = vs.projector_pixels(scene, np.stack([u.ravel(), v.ravel()], axis=1))
    column, row = np.moveaxis(found.projector_pixel.reshape(64, 64, 2), -1, 0)
    decoded = SimpleNamespace(column=column, row=row)
    there = sections(scene, decoded=decoded, rays=21)
    assert np.isfinite(there.areal_um["straight"]).sum() > 10
    assert there.figures.straight.difference_rms_um < 50.0  # pixels of 700 um
    decoded.column = None
    with pytest.raises(InputError, match="along u"):
        sections(scene, decoded=decoded)


def pose(name, **figures):
    """A pose with some figures."""
    nothing = DeviationFigures(0.0, 1.0, 0.0, None, None)
    usual = {"mean_distance_mm": 300.0, "resolution_um": 30.0, "incidence_deg": 45.0}
    others = {"coverage": 0.5, "straight": nothing, "bent": None, "section": None}
    rest = {"pixels": 9, "points": 5, "area_mm2": 1.0, "light_incidence_deg": 45.0}
    return PoseFigures(
        **{"name": name, "parameters": {}, "epipolar_px": 0.0} | usual | others | rest | figures
    )


def test_the_score_is_the_weighted_mean_of_ratios_to_the_best():
    """Rationale: by hand, 1/distance 300/400, and of all the others 1."""
    near, far = pose("near"), pose("far", mean_distance_mm=400.0)
    assert scored([near, far], weights_of({})) == pytest.approx([1.0, (0.75 + 3.0) / 4.0])
    assert scored([near, far], weights_of({"distance": 2.0, "coverage": 1.0})) == pytest.approx(
        [1.0, (2 * 0.75 + 1.0) / 3.0]
    )
    hot = replace(near, straight=replace(near.straight, rms_um=100.0))
    assert scored([near, hot], weights_of({"air": 1.0})) == pytest.approx([1.0, 0.01])


def test_what_can_not_be_compared_is_named():
    """Rationale: each with the remedy, before anything is searched."""
    for named, words in (
        ({"weights": {"coverge": 1.0}}, "did you mean 'coverage'"),
        ({"weights": {"coverage": -1.0}}, "0 or more"),
        ({"weights": {"coverage": 0.0}}, "all are 0"),
        ({"over": {"betta": ["0", "1"]}}, "beta"),
        ({"over": {"beta": [f"{i}" for i in range(999)]}}, "at most"),
    ):
        with pytest.raises(InputError, match=words):
            compare_poses("fringe_cylinder", **named)
    with pytest.raises(InputError, match="pattern_projector"):
        compare_poses("hot_cylinder", {"beta": ["0"]})


def test_the_command_writes_maps_and_figures_once(tmp_path):
    """Rationale: cold it has no bent figures; a folder is not replaced without being told."""
    words = "fringes poses fringe_cylinder -D beta=0 -D field= -D width=64 -D height=64 --grid 4"
    words = [*words.split(), "-o", str(tmp_path / "poses")]
    done = CliRunner().invoke(app, words)
    assert done.exit_code == 0, done.output
    files = {each.name for each in (tmp_path / "poses").iterdir()}
    assert files == {"report.html", "report.png", "poses.csv", "maps.npz", "summary.json"}
    with np.load(tmp_path / "poses" / "maps.npz") as maps:
        assert maps["straight_um"].shape == (1, 4, 4)
        assert np.nanmax(np.abs(maps["straight_um"])) < 0.01
    again = CliRunner().invoke(app, words)
    assert isinstance(again.exception, InputError)
    wrong = CliRunner().invoke(app, [*words, "--overwrite", "--weights", "coverage"])
    assert "NAME=WEIGHT" in str(wrong.exception)


def test_a_step_of_the_part_has_the_distance_of_the_face_that_is_seen():
    """Rationale: beside a wall the nearest face is another one, millimetres off."""
    size = {"width": ["128"], "height": ["128"]}
    there = compare_poses(
        "fringe_stepped_shaft", size | {"beta": ["0"], "temperature": ["1250"]}, grid=16
    )
    (pose,) = there.poses
    assert pose.figures.bent.rms_um < 2.0
    assert abs(pose.figures.bent.largest_um) < 20.0
    assert pose.figures.straight.radius_error_um is None
    assert np.isnan(there.table.bent_fit_std_um).all()


def test_points_before_the_part_are_outside():
    """Of all faces that the camera sees: 50 um towards it, and beyond."""
    scene = vs.load_scene("fringe_stepped_shaft", width=64, height=64).cold()
    pixel = np.column_stack([np.full(20, 32.0), np.linspace(4.0, 60.0, 20)])
    points = vs.projector_pixels(scene, pixel).point_mm
    towards = scene.camera.pose.origin_mm - points
    towards /= np.linalg.norm(towards, axis=1, keepdims=True)
    off_um = off_part_um(scene, points + 0.05 * towards, points)
    assert np.isfinite(off_um).sum() > 10
    assert np.nanmin(off_um) > 0.0
    assert np.nanmax(off_um) < 50.001
    assert np.nanmax(off_part_um(scene, points - 0.05 * towards, points)) < 0.0


@pytest.mark.slow
def test_rendered_fringes_agree_with_a_line_along_it():
    """The issue's line is 0.5 um, of 2048 px; here pixels are four times as wide."""
    scene = vs.load_scene("fringe_cylinder", width=512, height=512, pixels="false")
    codec = vs.codec_of("phase 3 64,1280 u", scene.projector.size)
    frames = vs.render_sequence(scene, codec.patterns, spp=1)
    found = sections(scene, decoded=codec.decode(frames.radiance, noise=0.0)).figures
    assert found.bent.points > 60
    assert found.bent.difference_rms_um < 0.5
    assert 5.0 < found.straight.difference_rms_um < 20.0


def test_a_telecentric_projector_differs_from_a_line_in_nothing():
    """Rationale: its light is the sheet's; what differs hot is a pinhole's spread alone."""
    scene = vs.load_scene("fringe_cylinder", width=256, height=256)
    matrix = np.array([[1280 / 60, 0.0, 639.5], [0.0, 1280 / 60, 399.5], [0.0, 0.0, 1.0]])
    family = Telecentric(matrix, scene.projector.pose, scene.projector.size)
    same = replace(scene.projector, family=family)
    found = sections(replace(scene, sources={scene.source_name: same}), rays=21).figures
    assert found.straight.line_rms_um > 50.0
    assert found.straight.difference_largest_um < 1e-3
