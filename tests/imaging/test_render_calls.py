"""What `render` and `render_frame` are asked for: refused or done, and no call changes another."""

import threading

import numpy as np
import pytest

import virtual_sensor as vs
from virtual_sensor.engine import mi
from virtual_sensor.imaging.render import render_frame
from virtual_sensor.imaging.scene_file import shipped_scenes
from virtual_sensor.studies.notes import frame_notes

SMALL = {"width": 96, "height": 96, "line_radius": 0.6}
NAN, INF = float("nan"), float("inf")


def edited(tmp_path, *changes, name="cold_cylinder"):
    """A shipped scene with texts replaced."""
    text = (shipped_scenes() / f"{name}.xml").read_text(encoding="utf-8")
    for old, new in changes:
        assert old in text
        text = text.replace(old, new)
    path = tmp_path / "edited.xml"
    path.write_text(text, encoding="utf-8")
    return path


# -------------------------------------------------------------------- settings that make no sense


@pytest.mark.parametrize("ask", [vs.render, render_frame])
def test_impossible_samples_and_seeds_are_refused(ask, capfd):
    """Rationale: 7 samples were 9, and 0 were 1, while the summary said 7 and 0."""
    scene = vs.load_scene("cold_cylinder", **SMALL)
    for spp in (0, -1, 2.5, NAN, INF, "four", 2**21, 10**12):
        with pytest.raises(vs.InputError, match="spp must be a whole number from 1 to 1048576"):
            ask(scene, spp=spp)
    for seed in (-1, 0.5, NAN, 2**32):
        with pytest.raises(vs.InputError, match="seed must be a whole number from 0"):
            ask(scene, seed=seed)
    with pytest.raises(vs.InputError, match=r"7 samples per pixel: .* would take 9; give"):
        ask(scene, spp=7)
    assert capfd.readouterr() == ("", "")  # Mitsuba's own warning would say the same


@pytest.mark.parametrize(("spp", "taken"), [(0, 1), (7, 9), (10, 16)])
def test_a_scene_of_samples_that_its_sampler_lacks_is_refused(spp, taken):
    """Rationale: else its summary would keep a number that was never rendered."""
    with pytest.raises(vs.InputError, match=rf"line \d+.* sample_count of {spp}: .*take {taken};"):
        vs.load_scene("cold_cylinder", spp=spp)


def test_no_sample_at_all_is_refused_of_any_sampler(tmp_path):
    """Rationale: of the independent sampler it was a ZeroDivisionError; 7 are 7 there."""
    jitter = '<boolean name="jitter" value="false"/>'
    path = edited(tmp_path, ('"stratified"', '"independent"'), (jitter, ""))
    with pytest.raises(vs.InputError, match="sample_count of 0"):
        vs.load_scene(path, spp=0)
    assert vs.render(vs.load_scene(path, **SMALL, spp=7)).max() > 0.0


@pytest.mark.parametrize("value", ["nan", "inf", "-1", "0", "1e9", "1000", "73", "0.008", "1e-9"])
def test_a_step_that_gets_through_no_field_is_refused(value):
    """Rationale: 1000 mm gave 10 px rms and status 0; 0.008 mm a black frame.

    The field's box is 240 x 72 x 335 mm.
    """
    with pytest.raises(vs.InputError, match="step"):
        vs.load_scene("hot_cylinder", **SMALL, step=value)


def test_a_step_too_long_is_measured_and_noted():
    """Rationale: the note of a frame of 10 px rms said that all was well but for its tables."""
    errors_px, size = {}, {"width": 256, "height": 256, "line_radius": 0.5, "spp": 1}
    exact = render_frame(vs.load_scene("hot_cylinder", **size, step=0.5))
    for step in (2, 16, 48):
        frame = render_frame(vs.load_scene("hot_cylinder", **size, step=step))
        both = frame.lit & exact.lit
        apart_mm = np.abs(frame.coordinates() - exact.coordinates())[both].max(axis=-1)
        true_px = np.quantile(apart_mm, 0.99) / (45.056 / 256)
        errors_px[step] = frame.report.march_px
        assert 0.3 * true_px < frame.report.march_px < 5.0 * true_px + 2e-3
        notes = " ".join(frame_notes(frame.report))
        assert ("steps of the march are too long" in notes) == (step > 2)
    assert errors_px[48] > errors_px[16] > 0.05 > 0.005 > errors_px[2]


@pytest.mark.parametrize("name", ["tolerance", "wavelength"])
def test_numbers_of_the_integrator_must_be_positive_and_finite(name):
    """Rationale: each is named in the message."""
    for value in ("nan", "inf", "-1", "0"):
        with pytest.raises(vs.InputError, match=name):
            vs.load_scene("hot_cylinder", **SMALL, **{name: value})


# ----------------------------------------------------------------------- where things can't stand


def test_a_laser_can_only_be_turned_and_moved():
    """Rationale: a scale or a shear was left out in silence; a turn and a move are taken."""
    turned = mi.ScalarTransform4f().look_at([0, 0, 300], [40, 0, 0], [0, 1, 0])
    size = {"type": "laser_line", "length": 22.0, "radius": 0.15}
    axis = mi.load_dict(size | {"to_world": turned}).source.pose.rotation[:, 2]
    np.testing.assert_allclose(axis, np.array([40.0, 0.0, -300.0]) / np.hypot(40, 300), atol=1e-6)
    shear = mi.ScalarTransform4f([[1, 0.1, 0, 0], [0, 1, 0, 0], [0, 0, 1, 0], [0, 0, 0, 1]])
    scale = mi.ScalarTransform4f().scale
    for bad in (scale(2.0), scale([1.0, 1.01, 1.0]), shear):
        for to_world in (bad @ turned, turned @ bad):
            with pytest.raises(Exception, match="laser_line: 'to_world' scales or shears"):
                mi.load_dict(size | {"to_world": to_world})


def test_a_laser_has_a_size_that_float32_can_tell():
    """Rationale: lengths beyond a kilometre, and 20,000 dots, which took 200 s."""
    for name, value in (("line_length", 1e9), ("line_radius", 2e6), ("dots", "1e20")):
        with pytest.raises(vs.InputError, match=r"laser_line: .*1e\+06 mm"):
            vs.load_scene("cold_cylinder", **{name: value})
    with pytest.raises(vs.InputError, match="8000 'dots'; give at most 1000"):
        vs.load_scene("cold_cylinder", dots=" ".join(map(str, range(8000))))


def test_a_camera_on_the_part_is_refused(tmp_path):
    """Rationale: it stood at no distance of what it saw: ZeroDivisionError."""
    on = (
        'origin="0, 0, $distance" target="0, 0, 0" up="-1, 0, 0"',
        'origin="{}" target="0, 0, 301"',
    )
    for height, refused in ((0.0, True), (0.005, True), (0.5, False)):
        at = (on[0], on[1].format(f"0, 0, {height}") + ' up="1, 0, 0"')
        path = edited(tmp_path, at)
        if refused:
            with pytest.raises(vs.InputError, match='<sensor id="camera">: the camera stands on'):
                vs.load_scene(path, **SMALL)
        else:
            assert vs.render(vs.load_scene(path, **SMALL)).max() == 0.0


def test_a_line_much_longer_than_the_image_costs_no_more():
    """Rationale: 500 mm took 225 s, for tables of light that no pixel sees."""
    size = {"width": 256, "height": 256, "line_radius": 0.5}
    frames = [
        render_frame(vs.load_scene("hot_cylinder", **size, line_length=x)) for x in (100, 500)
    ]
    for table in ("camera", "laser"):
        nodes = [frame.report.map_nodes[table] for frame in frames]
        assert nodes[0] == nodes[1]
    assert frames[1].report.transport == "tabulated"
    np.testing.assert_allclose(5.0 * frames[1].radiance, frames[0].radiance, rtol=1e-4, atol=1e-9)


# --------------------------------------------------------------------- calls beside one another


def test_no_call_changes_what_another_gives():
    """Rationale: render(scene, spp=1) stuck to later render(scene)."""
    scene = vs.load_scene("hot_cylinder", **SMALL)
    first, sampler = vs.render(scene), scene.mitsuba.sensors()[0].sampler()
    for change in ({"spp": 1}, {"seed": 7}, {"spp": 25, "seed": 3}):
        vs.render(scene, **change)
        render_frame(scene, **change)
        vs.render(scene.cold(), **change)
        assert sampler.sample_count() == 16
        np.testing.assert_array_equal(vs.render(scene), first)
    assert np.abs(vs.render(scene, spp=1) - first).max() > 0.01 * first.max()


def test_threads_that_share_a_scene_get_the_frames_of_one():
    """Rationale: hot and cold states share a film: 14 of 510 frames mixed, centres 0.7 px off."""
    hot = vs.load_scene("hot_cylinder", **SMALL)
    scenes = {"hot": hot, "cold": hot.cold(), "hot again": hot}
    alone = {name: (vs.render(scene), render_frame(scene)) for name, scene in scenes.items()}
    made = {name: [] for name in scenes}

    def work(name):
        for _ in range(6):
            made[name].append((vs.render(scenes[name]), render_frame(scenes[name])))

    threads = [threading.Thread(target=work, args=(name,)) for name in scenes]
    for thread in threads:
        thread.start()
    for thread in threads:
        thread.join()
    for name, frames in made.items():
        assert len(frames) == 6
        for image, frame in frames:
            np.testing.assert_array_equal(image, alone[name][0])
            np.testing.assert_array_equal(frame.radiance, alone[name][1].radiance)
            np.testing.assert_array_equal(frame.coordinates(), alone[name][1].coordinates())


def test_a_name_or_a_path_stands_for_its_scene(tmp_path):
    """Rationale: it is the first thing that is tried; it was an AttributeError."""
    small = shipped_scenes() / "cold_cylinder.xml"
    own = tmp_path / "my scene ä.xml"
    own.write_text(small.read_text().replace('"2048"', '"64"'), encoding="utf-8")
    scene = vs.load_scene(own)
    for given in (own, str(own), str(own.with_suffix(""))):
        np.testing.assert_array_equal(vs.render(given), vs.render(scene))
    assert vs.render_frame(own).radiance.shape == (64, 64)
    np.testing.assert_array_equal(vs.ray_search(own, 0.0).pixel, vs.ray_search(scene, 0.0).pixel)
    point = [0.0, 1.0, 0.0]
    np.testing.assert_array_equal(vs.project(own, point), vs.project(scene, point))
    np.testing.assert_array_equal(
        vs.triangulate(str(own), [3.0, 5.0]), vs.triangulate(scene, [3.0, 5.0])
    )


def test_what_is_no_scene_is_refused():
    """Rationale: an error that names the argument is mended at once."""
    asked = (vs.render, render_frame, lambda scene: vs.ray_search(scene, [0.0]))
    for ask in asked:
        for given in (None, 7, np.zeros((2, 2))):
            with pytest.raises(vs.InputError, match=r"scene is .*; give a scene of load_scene"):
                ask(given)
        with pytest.raises(vs.InputError, match=r"my/scene.xml: there is no such scene file"):
            ask("my/scene.xml")


def test_a_scene_of_another_variant_says_so_and_works_again_under_its_own():
    """Rationale: it was "0 emitters of type laser_line", for ever."""
    own = mi.variant()
    scene = vs.load_scene("cold_cylinder", **SMALL)
    shaft = vs.load_scene("stepped_shaft", **SMALL).cold()
    image = vs.render(scene)
    try:
        mi.set_variant("llvm_ad_rgb")
        for ask in (lambda: vs.render(scene), lambda: vs.ray_search(shaft, [0.0])):
            with pytest.raises(vs.EngineError, match="variant than 'llvm_ad_rgb'"):
                ask()
        other = vs.render(vs.load_scene("cold_cylinder", **SMALL))
    finally:
        mi.set_variant(own)
    np.testing.assert_array_equal(vs.render(scene), image)
    np.testing.assert_allclose(other, image, rtol=1e-5, atol=1e-6 * image.max())
