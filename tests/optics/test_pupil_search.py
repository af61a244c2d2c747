"""The search through a lens: against SciPy's rays from the pupil, and against blurred frames."""

from dataclasses import replace

import numpy as np
import oracles
import pytest

import virtual_sensor as vs
from virtual_sensor.errors import InputError
from virtual_sensor.optics.lens import Lens

F4 = Lens.of_f_number(75.0, 300.0, 4.0)
Y = np.array([-8.0, 0.0, 5.0])


@pytest.fixture(scope="module")
def hot():
    return vs.load_scene("hot_cylinder")


def test_lines_of_sight_from_the_pupil_are_scipys(hot):
    """Rays that a thin lens refracts by hand, and SciPy bends, meet the laser's points."""
    found = vs.pupil_search(hot, Y[:1], points=2, lens=F4)
    assert np.all(found.status == vs.PupilStatus.FOUND)
    field, camera = hot.field, hot.camera
    index = oracles.spline_index(field.nodes, field.origin, field.spacing, field.mirror)
    for at, pixel in zip(found.at_mm[1:], found.pixels[1:], strict=True):
        # A chief ray's slope is the pixel's; by 1/F - 1/b the lens bends the ray from A to it.
        p, q = ((pixel - camera.matrix[:2, 2]) / camera.matrix[0, 0]).T
        bends = at * (1.0 / F4.focal_length_mm - 1.0 / F4.image_distance_mm)
        slope = np.column_stack([p - bends[0], q - bends[1], np.ones(len(p))])
        sight = oracles.unit(slope @ camera.pose.rotation.T)
        origin = camera.pose.to_world(np.append(at, 0.0))
        with np.errstate(divide="ignore"):
            crossings = (field.box[:, None] - origin) / sight
        start = origin + crossings.min(axis=0).max(axis=1, keepdims=True) * sight
        away = np.linalg.norm(found.laser_point_mm - start, axis=1)
        rays = oracles.integrate(index, start, sight, away.max() + 1.0)

        def depth(points):
            return (points - found.laser_point_mm) @ camera.pose.rotation[:, 2]

        arcs = rays.arcs_to(depth, away.min() - 1.0, away.max() + 1.0)
        ends = np.array([rays.position(s)[i] for i, s in enumerate(arcs)])
        aside = (ends - found.laser_point_mm) @ camera.pose.rotation[:, :2]
        assert np.abs(aside).max() * camera.matrix[0, 0] / 300.0 < 1e-5  # px


def test_in_cold_air_the_spread_is_that_of_the_disc(hot):
    cold, lens = hot.with_medium(None), Lens.of_f_number(75.0, 290.0, 8.0)
    found = vs.pupil_search(cold, Y, lens=lens)
    wide = vs.circle_of_confusion_px(cold, found.laser_point_mm, lens=lens)
    np.testing.assert_allclose(4.0 * found.pixels.std(axis=0), wide, rtol=1e-9)
    np.testing.assert_allclose(4.0 * found.spread, wide, rtol=1e-4)
    chief = vs.ray_search(cold, Y, "newton").pixel
    np.testing.assert_allclose(found.pixels.mean(axis=0), chief, atol=1e-9)
    assert "3 of 3 " in repr(found)
    assert vs.circle_of_confusion_px(cold, found.laser_point_mm).max() == 0.0  # a pinhole's


def test_hot_air_blurs_what_is_in_focus_and_maps_find_the_same(hot):
    newton = vs.pupil_search(hot, Y, points=5, lens=F4)
    maps = vs.pupil_search(hot, Y, "tabulated", points=5, lens=F4, tolerance_px=1e-3)
    np.testing.assert_allclose(maps.pixels, newton.pixels, atol=1e-3)
    cold = vs.pupil_search(hot.with_medium(None), Y, points=5, lens=F4)
    assert cold.spread[1].max() < 0.01  # the middle of the line is in focus
    assert newton.spread[1, 1] > 0.1
    shift = newton.pixel - vs.ray_search(hot, Y, "newton").pixel
    assert np.abs(shift[:, 1]).max() > 0.05


def test_where_a_blurred_frame_has_the_line_is_where_the_search_has_it(hot):
    """16 points of the pupil, by maps, against 48 that are marched: 0.002 px."""
    fine = vs.load_scene("hot_cylinder", width=64, height=64, fov=8.588941972 / 32)
    camera = replace(fine.camera, lens=F4)
    image = vs.render(replace(fine, cameras={"camera": camera})).astype(float)
    v = np.arange(64)[:, None]
    centre = (v * image).sum(axis=0) / image.sum(axis=0)
    wide = ((v - centre) ** 2 * image).sum(axis=0) / image.sum(axis=0)
    sharp = vs.render(fine).astype(float)
    straight = (v * sharp).sum(axis=0) / sharp.sum(axis=0)
    narrow = ((v - straight) ** 2 * sharp).sum(axis=0) / sharp.sum(axis=0)
    searched = vs.pupil_search(fine, np.linspace(-0.6, 0.6, 5), points=48, lens=F4)
    row, spread = searched.rows_at(np.arange(64))
    known = np.isfinite(row)
    assert known.sum() > 20
    np.testing.assert_allclose(centre[known], row[known], atol=0.002)
    np.testing.assert_allclose((wide - narrow)[known], (spread**2)[known], atol=0.05)
    assert np.isnan(searched.rows_at([-50.0, 500.0])).all()


def test_out_of_focus_an_inclined_surface_moves_the_line_by_what_it_looks_larger():
    scene = vs.load_scene("cold_cylinder", width=768, height=768, f_number=4, focus_distance=290)
    cold, camera = scene.with_medium(None), scene.camera
    pinhole = replace(scene, cameras={"camera": replace(camera, sub_pupils=1)})
    columns, v = np.array([260, 384, 500]), np.arange(768)[:, None]
    centre, sharp = (
        (v * image).sum(axis=0) / image.sum(axis=0)
        for image in (vs.render(each)[:, columns].astype(float) for each in (scene, pinhole))
    )
    y = np.linspace(-10.9, 10.9, 60)
    row, _ = vs.pupil_search(cold, y, points=64).rows_at(columns)
    chief, _ = vs.pupil_search(cold, y, points=1).rows_at(columns)
    np.testing.assert_allclose(centre - sharp, row - chief, atol=0.001)
    # The middle is seen 30 degrees aslant: from A by 1 + tan(30) A/300 more, and moved by M A.
    lens = camera.lens
    moved_px = camera.matrix[0, 0] * (1.0 / 290.0 - 1.0 / 300.0)
    expected = lens.pupil_radius_mm**2 / 4.0 * np.tan(np.radians(30.0)) / 300.0 * moved_px
    light = vs.pupil_search(cold, [0.0], points=64)
    np.testing.assert_allclose(abs(light.pixel[0, 1] - 383.5), expected, rtol=1e-3)


def test_a_pupil_that_sees_a_point_in_part_says_so(hot):
    """The line's ends at the image's border, and a ray that goes past the part."""
    near = vs.load_scene("cold_cylinder", width=64, height=64, fov=8.588941972 / 32)
    blurs = Lens.of_f_number(75.0, 310.0, 4.0)
    found = vs.pupil_search(near, [0.0, 0.7, 5.0], lens=blurs)
    assert found.status.tolist() == list(vs.PupilStatus)
    assert np.isfinite(found.pixel[:2]).all()
    assert np.isnan(found.pixel[2]).all()
    assert np.isnan(found.pixels[:, 1]).any()


def test_through_a_lens_a_projectors_pixels_are_searched_too():
    scene = vs.load_scene("fringe_cylinder", width=64, height=64)
    middle = np.array([np.array(scene.projector.family.size) / 2.0])
    found = vs.pupil_search(scene, projector_pixel=middle, points=3, lens=F4)
    assert np.isfinite(found.pixel).all()


def test_what_can_not_be_searched_is_refused(hot):
    with pytest.raises(InputError, match="has no lens"):
        vs.pupil_search(hot, Y)
    with pytest.raises(InputError, match="newton, tabulated"):
        vs.pupil_search(hot, Y, "paper", lens=F4)
    with pytest.raises(InputError, match="points"):
        vs.pupil_search(hot, Y, points=0, lens=F4)
    with pytest.raises(InputError, match=r"\(N, 3\)"):
        vs.circle_of_confusion_px(hot, [0.0, 1.0], lens=F4)
