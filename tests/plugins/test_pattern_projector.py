"""The projector as an emitter: against Mitsuba's own, its power, and its light through hot air."""

import re

import cv2
import numpy as np
import pytest

import virtual_sensor as vs
from virtual_sensor.devices.patterns import Picture
from virtual_sensor.devices.photometry import watts_of
from virtual_sensor.devices.projector import Projector
from virtual_sensor.engine import dr, mi
from virtual_sensor.imaging.render import lit_pixels
from virtual_sensor.imaging.scene_file import shipped_scenes
from virtual_sensor.optics.ray_families import Pinhole, Telecentric
from virtual_sensor.optics.rays import March

SIZE = W, H = 24, 16
FOV = 12.0
T = mi.ScalarTransform4f
DOWN = T().look_at([0, 0, 300], [0, 0, 0], [0, 1, 0])
ASLANT = T().look_at([30, 20, 300], [2, 1, 0], [0, 1, 0.1])
LENS = "-0.4, 0.3, 0.02, -0.03, 0.05"


def emitter(**properties):
    given = {"width": W, "height": H, "to_world": DOWN, **properties}
    if not {"fov", "focal_length", "image_width", "calibration"} & given.keys():
        given["fov"] = FOV
    return mi.load_dict({"type": "pattern_projector", **given})


def light_at(projector, x, y, z):
    """Direction to the projector and flux density as Mitsuba's integrators ask for them."""
    it = dr.zeros(mi.Interaction3f, x.size)
    it.p = mi.Point3f(*(mi.Float(np.ravel(v).astype(np.float32)) for v in (x, y, z)))
    sample, weight = projector.sample_direction(it, mi.Point2f(0.5))
    return np.array(sample.d), np.array(weight[0])


def power_through(projector, z, half_mm=40.0, cells=500):
    """Power through a plane of constant z."""
    places = half_mm * ((np.arange(cells) + 0.5) * 2.0 / cells - 1.0)
    x, y = np.meshgrid(places, places)
    direction, density = light_at(projector, x, y, np.full(x.shape, z))
    return float(np.sum(density * direction[2]) * (2.0 * half_mm / cells) ** 2)


@pytest.fixture
def grey(tmp_path):
    """A picture of the projector's size, and its file."""
    values = np.random.default_rng(1).integers(0, 256, (H, W)).astype(np.uint8)
    cv2.imwrite(str(tmp_path / "picture.png"), values)
    return values / 255.0, str(tmp_path / "picture.png")


def test_straight_light_is_that_of_mitsubas_own_projector(grey):
    """By any integrator: places, orientation, pixels and brightness.

    Mitsuba's is pi times as bright as the irradiance that it is given.
    """
    values, file = grey
    focal = W / 2.0 / np.tan(np.radians(FOV) / 2.0)
    power = 3.0 * W * H / focal**2
    view = T().look_at([-60, 0, 260], [0, 0, 0], [0, 1, 0])
    film = {
        "type": "hdrfilm",
        "width": 48,
        "height": 32,
        "pixel_format": "luminance",
        "rfilter": {"type": "box"},
    }
    sensor = {
        "type": "perspective",
        "fov": 16.0,
        "to_world": view,
        "film": film,
        "sampler": {"type": "stratified", "sample_count": 16, "jitter": False},
    }
    wall = {"type": "rectangle", "to_world": T().rotate([0, 1, 0], 20).scale(100)}
    wall |= {"bsdf": {"type": "diffuse", "reflectance": 0.5}}
    light = {"to_world": ASLANT, "fov": FOV}
    ours = {"type": "pattern_projector", "width": W, "height": H, "pattern": file, "power": power}
    for integrator in ("direct", "path", "refractive"):
        tensor = mi.TensorXf((values[..., None] * 3.0 / np.pi).astype(np.float32))
        bitmap = {"type": "bitmap", "data": tensor, "raw": True, "filter_type": "nearest"}
        images = []
        for one in ({"type": "projector", "irradiance": bitmap, **light}, {**ours, **light}):
            with_mitsubas = integrator == "refractive" and one["type"] == "projector"
            chosen = "direct" if with_mitsubas else integrator
            given = {"sensor": sensor, "wall": wall, "light": one}
            scene = mi.load_dict({"type": "scene", "integrator": {"type": chosen}, **given})
            images.append(np.array(mi.render(scene), float)[..., 0])
        theirs, own = images
        beside = np.abs(own - theirs) > 1e-3 * theirs.max()  # a sample on an edge of pixels
        assert beside.mean() < 0.01, integrator
        assert np.sum(own) == pytest.approx(np.sum(theirs), rel=1e-4), integrator


def test_power_arrives_whole_through_every_plane():
    """In watts or lumen, with a distorting lens, out of focus or telecentric."""
    for given in (
        {"power": 0.2},
        {"lumen": 683.0 * 0.2 * 0.8847, "wavelength": 532.0},
        {"power": 0.2, "distortion": LENS},
        {"power": 0.2, "defocus": 0.7, "principal_point_offset_y": 0.1},
        {"power": 0.2, "telecentric": True, "image_width": 60.0},
        {"power": 0.2, "focal_length": 24.0, "pixel": 200.0},
        {"power": 0.1, "pattern": "checker 4", "gamma": 2.2},
        {"power": 0.19047619, "pattern": "black", "contrast": 2.0},
    ):
        expected = 0.2 if "pattern" not in given else 0.5 * given["power"]
        projector = emitter(**given)
        for z in (-40.0, 20.0):
            assert power_through(projector, z) == pytest.approx(expected, rel=8e-3), given


def test_lumen_are_those_of_the_eye():
    """By the candela's definition 683 lm are a watt at 555 nm; at 507 nm day sees 0.444 of it."""
    assert watts_of(683.0, 555.0) == pytest.approx(1.0, rel=1e-3)
    assert watts_of(683.0, 507.0) == pytest.approx(1.0 / 0.444, rel=5e-3)
    with pytest.raises(vs.InputError, match="invisible"):
        watts_of(1.0, 905.0)


def test_pixels_on_a_plane_are_opencvs(grey):
    """A point's brightness is that of the pixel that OpenCV projects it to."""
    values, file = grey
    for lens in ("", LENS):
        projector = emitter(pattern=file, to_world=ASLANT, distortion=lens)
        family = projector.source.family
        points = np.random.default_rng(2).uniform([-20, -12, -5], [20, 12, 5], (500, 3))
        rvec = cv2.Rodrigues(family.pose.rotation.T)[0]
        tvec = -family.pose.rotation.T @ family.pose.origin_mm
        pixel = cv2.projectPoints(points, rvec, tvec, family.matrix, family.distortion)[0][:, 0]
        inner = np.all(np.abs(pixel - np.round(pixel)) < 0.49, axis=1)  # beside edges float32 errs
        inner &= np.all((pixel > -0.4) & (pixel < np.array(SIZE) - 0.6), axis=1)
        white = emitter(to_world=ASLANT, distortion=lens)
        share = light_at(projector, *points.T)[1] / light_at(white, *points.T)[1]
        column, row = np.round(pixel[inner]).astype(int).T
        assert inner.sum() > 200
        np.testing.assert_allclose(share[inner], values[row, column], rtol=0, atol=1e-4)


def test_a_calibration_file_says_it_all(tmp_path):
    """Matrix, size, distortion and pose; a pose in the scene goes before the file's."""
    family = emitter(to_world=ASLANT, distortion=LENS).source.family
    file = tmp_path / "projector.yml"
    storage = cv2.FileStorage(str(file), cv2.FILE_STORAGE_WRITE)
    storage.write("image_width", W)
    storage.write("image_height", H)
    storage.write("camera_matrix", family.matrix)
    storage.write("distortion_coefficients", family.distortion[None])
    storage.write("rotation", np.ascontiguousarray(family.pose.rotation.T))
    storage.write("translation", -family.pose.rotation.T @ family.pose.origin_mm)
    storage.release()
    given = {"type": "pattern_projector", "calibration": str(file)}
    read = mi.load_dict(given).source.family
    np.testing.assert_allclose(read.matrix, family.matrix)
    np.testing.assert_allclose(read.pose.rotation, family.pose.rotation, atol=1e-6)
    np.testing.assert_allclose(read.pose.origin_mm, family.pose.origin_mm, atol=1e-4)
    np.testing.assert_allclose(read.distortion, family.distortion)
    assert read.size == SIZE
    moved = mi.load_dict({**given, "to_world": DOWN}).source.family
    np.testing.assert_allclose(moved.pose.origin_mm, [0, 0, 300], atol=1e-4)


def test_kinds_of_projectors():
    assert isinstance(emitter().source, Projector)
    assert isinstance(emitter().source.family, Pinhole)
    parallel = emitter(telecentric=True, image_width=48.0).source
    assert isinstance(parallel.family, Telecentric)
    assert parallel.pixels_of(24.0, 0.0)[0] == pytest.approx(W - 0.5)
    by_lens = emitter(focal_length=24.0, pixel=7.6).source.family
    assert by_lens.matrix[0, 0] == pytest.approx(24.0 / 7.6e-3)
    for axis, across in (("y", H), ("diagonal", np.hypot(W, H)), ("smaller", H), ("larger", W)):
        focal = emitter(fov=FOV, fov_axis=axis).source.family.matrix[0, 0]
        assert focal == pytest.approx(across / 2.0 / np.tan(np.radians(FOV) / 2.0)), axis


def test_what_can_not_be_thrown_is_refused(tmp_path, grey):
    small = tmp_path / "small.png"
    cv2.imwrite(str(small), np.zeros((4, 4), np.uint8))
    for given, said in (
        ({"pattern": str(small)}, "small.png is 4 x 4 px, and the projector has 24 x 16 px"),
        ({"pattern": "sinus u 3"}, "did you mean 'sine'"),
        ({"fov": 190.0}, "'fov'"),
        ({"fov": FOV, "image_width": 3.0}, "'fov' and 'image_width'"),
        ({"image_width": 3.0}, "give 'fov'"),
        ({"telecentric": True, "fov": FOV}, "is telecentric"),
        ({"telecentric": True, "image_width": 60.0, "fov_axis": "x"}, "no 'fov' that it is of"),
        ({"focal_length": 24.0}, "'pixel'"),
        ({"fov": FOV, "fov_axis": "z"}, "fov_axis"),
        ({"distortion": "1, 2"}, "4, 5, 8"),
        ({"distortion": "a, b, c, d"}, "4, 5, 8"),
        ({"distortion": "-400, 0, 0, 0"}, "folds"),
        ({"power": 1.0, "lumen": 2.0}, "both"),
        ({"lumen": 2.0, "wavelength": 905.0}, "invisible"),
        ({"power": 0.0}, "'power'"),
        ({"contrast": 0.5}, "contrast"),
        ({"gamma": 0.0}, "gamma"),
        ({"bits": 99}, "bits"),
        ({"defocus": -1.0}, "defocus"),
        ({"width": 0}, "'width'"),
        ({"calibration": "none.yml"}, "none.yml"),
        ({"to_world": T().scale(2.0)}, "scales"),
    ):
        if "calibration" in given:
            given = {"type": "pattern_projector", **given}
            with pytest.raises(RuntimeError) as caught:
                mi.load_dict(given)
        else:
            with pytest.raises(RuntimeError) as caught:
                emitter(**given)
        assert said in str(caught.value), given


SMALL = {"width": 96, "height": 96, "spp": 4, "pixels": False, "pattern": "sine u 160 0"}


def test_a_pixel_knows_which_of_the_projectors_it_sees():
    """Cold, the truth of a frame is the straight projection of its points."""
    scene = vs.load_scene("fringe_cylinder", **SMALL)
    frame = vs.render_frame(scene.cold())
    p, q = (x[frame.lit].astype(float) for x in np.moveaxis(frame.coordinates(), -1, 0))
    seen = np.stack(scene.projector.pixels_of(p, q), axis=1)
    expected = scene.projector.family.project(frame.point_mm[frame.lit])
    assert frame.lit.sum() > 2000
    assert np.abs(seen - expected).max() < 2e-3


def test_maps_and_marches_throw_the_same_fringes():
    """Hot, against Newton's search for each sample."""
    scene = vs.load_scene("fringe_cylinder", **SMALL)
    by_maps, by_marches = (
        vs.render_frame(scene.with_transport(scene.transport.by(name)))
        for name in ("tabulated", "marched")
    )
    assert by_maps.report.transport == "tabulated"
    brightest = by_marches.radiance.max()
    apart = np.abs(by_maps.radiance - by_marches.radiance) / brightest
    assert np.sqrt(np.mean(apart**2)) < 2e-4
    both = by_maps.lit & by_marches.lit
    assert both.sum() > 0.99 * by_marches.lit.sum()
    pixels = [
        np.stack(scene.projector.pixels_of(*np.moveaxis(f.coordinates()[both].astype(float), 1, 0)))
        for f in (by_maps, by_marches)
    ]
    assert np.sqrt(np.mean((pixels[0] - pixels[1]) ** 2)) < 5e-3
    cold = vs.render(scene.cold())
    assert np.abs(cold - by_maps.radiance).max() > 0.1 * brightest  # the air moves fringes


def test_distorted_and_parallel_light_through_hot_air(tmp_path):
    """The projector's pixels in a frame against those that a search of marched rays finds."""
    folder = shipped_scenes()
    text = (folder / "fringe_cylinder.xml").read_text(encoding="utf-8")
    text = text.replace('"fields/', f'"{folder}/fields/')
    fov = re.search(r'<string name="fov_axis" value="x"/>\n *<float name="fov" .*_fov"/>', text)[0]
    parallel = '<boolean name="telecentric" value="true"/><float name="image_width" value="60"/>'
    distorts = f'{fov}<string name="distortion" value="-2, 1, 0.01, -0.02"/>'
    for lens in (parallel, distorts):
        path = tmp_path / "own.xml"
        path.write_text(text.replace(fov, lens), encoding="utf-8")
        scene = vs.load_scene(path, **SMALL)
        frame = vs.render_frame(scene)
        row, column = np.argwhere(frame.lit)[:: frame.lit.sum() // 60].T
        s, t = frame.coordinates()[row, column].T.astype(float)
        found = vs.projector_pixels(scene, np.stack([column, row], axis=1)).projector_pixel
        apart = np.abs(np.stack(scene.projector.pixels_of(s, t), axis=1) - found)
        assert np.isfinite(apart).all(axis=1).sum() > 55
        assert np.nanmedian(apart) < 2e-3
        assert np.nanmax(apart) < 0.05  # a coarse camera's pixels are 0.5 mm


def test_brightness_through_hot_air_is_a_pixels_power_over_the_area_that_it_lights():
    """Rationale: air concentrates light, and loses none.

    A camera pixel's corners, by the search, lie on so much of the projector's image and of the
    cylinder, unrolled; 0.1 W are spread evenly over 1280 x 800 px, and steel reflects half.
    """
    scene = vs.load_scene("fringe_cylinder", width=128, height=128)
    pixel = np.array([[u, v] for u in (48, 64, 75) for v in (20, 41, 63, 84, 100)])
    around = np.array([[-0.5, -0.5], [0.5, -0.5], [0.5, 0.5], [-0.5, 0.5]])
    corners = (pixel[:, None] + around).reshape(-1, 2)
    march = March(1.0, "leapfrog", "double")
    found = {
        each: vs.projector_pixels(each, corners, march=march) for each in (scene, scene.cold())
    }

    def areas(places):
        x, y = np.moveaxis(places.reshape(-1, 4, 2), -1, 0)
        return 0.5 * np.abs(np.sum(x * np.roll(y, -1, 1) - np.roll(x, -1, 1) * y, axis=1))

    expected = []
    for each, lit in found.items():
        x, y, z = lit.point_mm.T
        unrolled = np.stack([x, 13.5 * np.arctan2(y, z + 13.5)], axis=1)
        per_mm2 = areas(lit.projector_pixel) / areas(unrolled)
        expected.append(0.1 / (1280 * 800) * per_mm2 * 0.5 / np.pi)
        image = vs.render(each)
        np.testing.assert_allclose(image[pixel[:, 1], pixel[:, 0]], expected[-1], rtol=3e-4)
    assert np.abs(expected[0] / expected[1] - 1.0).max() > 3e-3  # or air does nothing to it


@pytest.mark.slow
def test_maps_of_wide_light_do_not_see_the_marches_own_error():
    """Of a coarse step that error differs from ray to ray, and no table would hold it."""
    scene = vs.load_scene("fringe_cylinder", **SMALL, tolerance=3e-4)
    assert lit_pixels(scene).report.transport == "tabulated"


def test_a_picture_of_the_user_is_thrown(tmp_path):
    """A file beside the scene, of the projector's size, is found and read."""
    values = np.zeros((800, 1280), np.uint8)
    values[:, 640:] = 255
    cv2.imwrite(str(tmp_path / "half.png"), values)
    scene = vs.load_scene("fringe_cylinder", **{**SMALL, "pattern": tmp_path / "half.png"}).cold()
    assert isinstance(scene.projector.pattern, Picture)
    frame = vs.render_frame(scene)
    column = scene.projector.pixels_of(*np.moveaxis(frame.coordinates(), -1, 0).astype(float))[0]
    bright = frame.radiance > 0.05 * frame.radiance.max()
    with np.errstate(invalid="ignore"):
        clear = np.abs(column - 639.5) > 30.0
    assert np.array_equal(bright[clear & frame.lit], column[clear & frame.lit] > 640)
