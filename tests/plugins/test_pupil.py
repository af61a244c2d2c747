"""Frames through a lens: against the thin lens's closed forms, and against frames of other ways."""

from dataclasses import replace

import numpy as np
import pytest
from scipy.special import j1
from virtual_sensor_plugins.pupil import Pupil, shifts_within
from virtual_sensor_plugins.renderer import Prepared

import virtual_sensor as vs
from virtual_sensor.devices.camera import with_tilt
from virtual_sensor.imaging.render import arrangement, render_uncached
from virtual_sensor.optics.lens import Lens, circle_of_confusion
from virtual_sensor.optics.map_cache import MAPS
from virtual_sensor.studies.notes import frame_notes

FOV = 8.588941972 / 32  # of 64 pixels as large as those of 2048


def through(scene, lens, points=16):
    name = scene.camera_name
    return replace(scene, cameras={name: replace(scene.camera, lens=lens, sub_pupils=points)})


def lens(f_number, focus_mm=300.0):
    return Lens.of_f_number(75.0, focus_mm, f_number)


def part(name="cold_cylinder", **parameters):
    return vs.load_scene(name, **{"width": 64, "height": 64, "fov": FOV} | parameters)


def moments(image):
    """Centre and variance of each column, px."""
    v, light = np.arange(len(image))[:, None], np.asarray(image, float)
    centre = (v * light).sum(axis=0) / light.sum(axis=0)
    return centre, ((v - centre) ** 2 * light).sum(axis=0) / light.sum(axis=0)


def test_a_line_out_of_focus_is_wider_by_the_thin_lenss_circle_of_confusion():
    """A disc of diameter D has the variance D^2/16 along any line through it."""
    scene = part(line_radius=0.05)  # a thick sheet lies at several depths
    sharp = vs.render_frame(scene, spp=256)
    centre, variance = moments(sharp.radiance)
    seen = sharp.point_mm[round(centre[32]), 32]
    for focus_mm in (285.0, 300.0, 315.0):
        blurs = lens(8.0, focus_mm)
        blurred, wider = moments(vs.render(through(scene, blurs)))
        more = (wider - variance)[20:44].mean()
        wanted = circle_of_confusion(blurs, scene.camera, seen[None])[0, 1]
        if focus_mm == 300.0:
            assert abs(more) < 5e-4  # of a variance of 1.4 px^2
        else:
            assert 4.0 * np.sqrt(more) == pytest.approx(wanted, rel=0.01)
        # The line's centre stays but for the change of its size with the direction of sight.
        np.testing.assert_allclose(blurred[20:44], centre[20:44], atol=0.03)


def test_as_much_light_arrives_and_a_frame_is_the_same_to_the_bit():
    bare = part("hot_cylinder")
    scene = through(bare, lens(4.0, 305.0), points=6)
    first = vs.render_frame(scene)
    assert first.report.samples > 0
    assert first.report.marched_samples == 0
    MAPS.clear()
    np.testing.assert_array_equal(render_uncached(scene), first.radiance)
    np.testing.assert_array_equal(vs.render(scene), first.radiance)
    sharp = vs.render_frame(bare)
    assert first.radiance[:, 20:44].sum() == pytest.approx(sharp.radiance[:, 20:44].sum(), rel=2e-3)
    middle = vs.render(through(bare, lens(4.0, 305.0), points=1))
    np.testing.assert_array_equal(middle, sharp.radiance)  # one point is the middle of the pupil
    np.testing.assert_array_equal(first.lit, sharp.lit)


def test_marched_and_tabulated_frames_agree():
    tabulated = through(part("hot_cylinder"), lens(4.0, 304.0), points=4)
    marched = replace(tabulated, transport=tabulated.transport.by("marched"))
    one, other = (vs.render(each, spp=4) for each in (tabulated, marched))
    np.testing.assert_allclose(moments(one)[0], moments(other)[0], atol=1e-3)


def test_on_mitsubas_film_are_the_same_pixels():
    """With glow, whose light is seen in all pixels, and without."""
    glowing = {"emissivity": 0.8, "temperature": 1250.0}
    for parameters in ({}, glowing):
        scene = through(part("hot_cylinder", **parameters), lens(4.0, 305.0), points=3)
        prepared = Prepared.of(arrangement(scene))
        images = [prepared.exposed(4, 0, on_film=on)[0].images()[0] for on in (False, True)]
        np.testing.assert_allclose(*images, rtol=1e-5, atol=1e-9)
    assert images[0].min() > 0.0


def test_a_glowing_edge_is_blurred_by_the_disc():
    """The derivative of an edge has the disc's variance, D^2/16; lamps' light is seen so too."""
    cold = {"transport": "straight", "fov": FOV * 32, "width": 96, "height": 9}
    scene = part("hot_cylinder", emissivity=0.8, temperature=1250.0, line_length=1.0, **cold)
    blurs = lens(2.0, 270.0)
    along = np.arange(39) + 0.5

    def edge(scene):
        spread = np.diff(vs.render(scene, spp=16)[4, :40].astype(float))
        centre = (spread * along).sum() / spread.sum()
        return centre, (spread * (along - centre) ** 2).sum() / spread.sum(), spread.sum()

    sharp, blurred = edge(scene), edge(through(scene, blurs, points=16))
    # The middle row looks at x = -z tan 30 degrees, and its silhouette lies where sight is tangent.
    z = -13.5 + 13.5**2 / (300.0 * np.cos(np.radians(30.0)) + 13.5)
    silhouette = np.array([[-z * np.tan(np.radians(-30.0)), 13.5, z]])
    wide = circle_of_confusion(blurs, scene.camera, silhouette)[0, 0]
    assert 4.0 * np.sqrt(blurred[1] - sharp[1]) == pytest.approx(wide, rel=0.03)
    assert blurred[2] == pytest.approx(sharp[2], rel=0.01)
    assert blurred[0] == pytest.approx(sharp[0], abs=0.1)


def test_fringes_lose_the_contrast_that_a_disc_takes():
    """A disc of diameter D leaves 2 J1(x)/x of a fringe of period P, x = pi D/P."""
    scene = vs.load_scene("fringe_cylinder", width=32, height=32, fov=0.4).with_medium(None)
    period = 16.0
    steps = [f"sine u {period} {k * np.pi / 2}" for k in range(4)]
    blurs = lens(4.0, 290.0)

    def amplitude(scene):
        a, b, c, d = vs.render_sequence(scene, steps, spp=16).radiance[:, 14:18, 14:18]
        return np.hypot(a - c, b - d).mean() / (a + b + c + d).mean()

    frame = vs.render_frame(scene)
    at = circle_of_confusion(blurs, scene.camera, frame.point_mm[16, 16][None])[0]
    u = vs.render_sequence(scene, steps[:1]).projector_pixel[14:18, 14:18, 0]
    by_v, by_u = (np.mean(each) for each in np.gradient(u))
    x = np.pi * np.hypot(by_u * at[0], by_v * at[1]) / period
    left = amplitude(through(scene, blurs, points=16)) / amplitude(scene)
    assert left == pytest.approx(2.0 * j1(x) / x, abs=0.01)
    assert 0.1 < left < 0.9


def test_samples_within_pixels_go_with_no_place_in_the_pupil():
    for count in (2, 5, 16, 64):
        at = tuple(map(tuple, Lens(75.0, 300.0, 1.0).pupil(count).tolist()))
        shifts = np.array(shifts_within(at))
        for along in shifts.T:  # one in each of so many rows and columns
            np.testing.assert_allclose(np.diff(np.sort(along)), 1.0 / count)
        places = np.array(at)
        if count in (16, 64):
            assert np.abs(shifts.T @ places).max() / count < 0.01
            even = np.stack([places[:, 0] ** 2, places[:, 0] * places[:, 1], places[:, 1] ** 2])
            np.testing.assert_allclose(even @ shifts, 0.0, atol=1e-12)
            assert abs(np.prod(shifts, axis=1).mean()) < 0.15 / 12.0  # no diagonal


def test_a_point_of_the_pupil_that_sees_no_light_adds_none():
    scene = through(part(), lens(4.0, 305.0), points=4)
    prepared = Prepared.of(arrangement(scene))
    assert isinstance(prepared.pupil, Pupil)
    first, *others = prepared.pupil.points
    dark = replace(first, lit=replace(first.lit, index=first.lit.index[:0], sight=None, names=()))
    less = replace(prepared, pupil=Pupil((dark, *others)))
    whole, rest = (each.exposed(4, 0)[0].images()[0].sum() for each in (prepared, less))
    assert rest == pytest.approx(0.75 * whole, rel=0.02)


def test_a_pupil_of_too_few_points_for_its_blur_is_told():
    """Two points show a line twice, as far apart as they are in the blur's disc."""
    scene, blurs = part(line_radius=0.05), lens(4.0, 310.0)
    frame = vs.render_frame(through(scene, blurs, points=2))
    at = blurs.pupil(2)
    wide = circle_of_confusion(blurs, scene.camera, np.zeros((1, 3)))[0, 1]
    gap = wide * np.abs(at[1] - at[0]).max() / (2.0 * blurs.pupil_radius_mm)
    assert frame.report.pupil_gap_px == pytest.approx(gap, rel=0.02)
    assert "sub_pupils" in " ".join(frame_notes(frame.report))
    lit = frame.radiance[:, 32]
    assert (
        np.sum((lit[1:-1] > lit[:-2]) & (lit[1:-1] > lit[2:]) & (lit[1:-1] > 0.1 * lit.max())) == 2
    )
    many = vs.render_frame(through(scene, blurs, points=36)).report
    assert many.pupil_points == 36
    assert frame_notes(many) == []
    assert np.isnan(vs.render_frame(scene).report.pupil_gap_px)


def test_scheimpflugs_tilt_keeps_the_line_as_sharp_along_the_depth():
    """By tan phi' = m tan phi 8.2 degrees: m is 0.25, the laser plane 30 degrees off the lens's."""
    scene = part(width=256, height=256, fov=FOV * 32, line_radius=0.6)
    camera = replace(scene.camera, lens=lens(4.0), pixel_um=44.0)
    tilted = camera.focused_on(*scene.laser.family.plane(0.0))
    angle = np.hypot(*tilted.lens.sensor_tilt_deg)
    assert angle == pytest.approx(np.degrees(np.arctan(0.25 * np.tan(np.radians(30.0)))), abs=0.02)

    def widths(camera, points):
        seen = replace(scene, cameras={"camera": replace(camera, sub_pupils=points)})
        return np.sqrt(moments(vs.render(seen, spp=16)[:, 70:186])[1])

    sharp, blurred = widths(tilted, 1), widths(tilted, 16)
    np.testing.assert_allclose(blurred, sharp, rtol=0.02)
    assert (widths(camera, 16) / widths(camera, 1)).max() > 1.02  # a sensor square to the axis


def test_through_a_tilted_lens_that_distorts_the_line_is_where_the_search_has_it():
    scene = part("hot_cylinder", line_radius=0.05)
    bends = (-0.2, 0.1, 1e-3, -2e-3, 0.0)
    camera = replace(scene.camera, lens=lens(8.0, 301.0), pixel_um=5.5, distortion=np.array(bends))
    camera = with_tilt(camera, (8.2, 3.0))
    seen = replace(scene, cameras={"camera": camera})
    row, spread = vs.pupil_search(seen, np.linspace(-0.6, 0.6, 5)).rows_at(np.arange(64))
    known = np.isfinite(row)
    assert known.sum() > 20
    centre, _ = moments(vs.render(seen))
    np.testing.assert_allclose(centre[known], row[known], atol=0.003)
    assert spread[known].min() > 0.1
