"""The refractive integrator against Mitsuba's own, against closed forms and against itself."""

import numpy as np
import pytest
from virtual_sensor_plugins.lit_pixels import LitPixels, RenderReport
from virtual_sensor_plugins.renderer import Prepared

import virtual_sensor as vs
from virtual_sensor.engine import dr, mi
from virtual_sensor.imaging.render import arrangement, render_frame
from virtual_sensor.medium.broadening import blurred, widened
from virtual_sensor.optics.ray_maps import NoMapError

DIRECT = {"type": "direct"}
COARSE = {"width": 512, "height": 512, "spp": 4}

# A plane lit from above, with a screen 20 mm over its y = 2 ... 5 mm, seen from 30 degrees.
SCREENED = """<scene version="3.0.0">
    <default name="jitter" value="false"/>
    <default name="size" value="300"/>
    <default name="spp" value="4"/>
    <default name="fan" value="0"/>
    <integrator type="refractive"><float name="step" value="8"/></integrator>
    <sensor type="perspective">
        <float name="fov" value="8.6"/>
        <transform name="to_world">
            <lookat origin="150, 0, 260" target="0, 0, 0" up="-1, 0, 0"/></transform>
        <film type="hdrfilm">
            <integer name="width" value="$size"/><integer name="height" value="$size"/>
            <string name="pixel_format" value="luminance"/><rfilter type="box"/></film>
        <sampler type="stratified"><integer name="sample_count" value="$spp"/>
            <boolean name="jitter" value="$jitter"/></sampler>
    </sensor>
    <emitter type="laser_line">
        <float name="length" value="20"/><float name="radius" value="2"/>
        <float name="power" value="0.1"/><float name="fan" value="$fan"/>
        <transform name="to_world"><lookat origin="0, 0, 300" target="0, 0, 0" up="0, 1, 0"/>
        </transform>
    </emitter>
    OTHER_LIGHT
    <bsdf type="diffuse" id="grey"><float name="reflectance" value="0.5"/></bsdf>
    <shape type="rectangle"><transform name="to_world"><scale value="12"/></transform>
        <ref id="grey"/></shape>
    <shape type="rectangle"><transform name="to_world"><scale x="8" y="1.5"/>
        <translate y="3.5" z="20"/></transform><ref id="grey"/></shape>
</scene>"""
POINT = '<emitter type="point"><point name="position" x="80" y="50" z="90"/></emitter>'
AREA = """<shape type="rectangle"><transform name="to_world"><scale value="30"/>
    <lookat origin="60, -40, 80" target="0, 0, 0" up="0, 1, 0"/></transform>
    <emitter type="area"><float name="radiance" value="5e-3"/></emitter></shape>"""
CONSTANT = '<emitter type="constant"><float name="radiance" value="5e-4"/></emitter>'


def screened(folder, other_light="", **parameters):
    """That scene, in air that is the same everywhere but is marched through step by step."""
    path = folder / "screened.xml"
    path.write_text(SCREENED.replace("OTHER_LIGHT", other_light), encoding="utf-8")
    scene = vs.load_scene(path, **parameters)
    nothing = np.zeros((12, 12, 12))
    return scene.with_medium(vs.IndexField.from_arrays(nothing, [-44.0] * 3, [8.0] * 3))


def stock(scene, seed=0):
    """Radiance (H, W) by Mitsuba's own `direct` integrator."""
    return np.array(mi.render(scene.mitsuba, integrator=mi.load_dict(DIRECT), seed=seed))[..., 0]


def crop(scene, offset, size):
    """Crop the film of a loaded scene."""
    held = mi.traverse(scene.mitsuba.sensors()[0])
    held["film.crop_offset"] = mi.ScalarPoint2u(*offset)
    held["film.crop_size"] = mi.ScalarVector2u(*size)
    held.update()


def test_zero_field_gives_mitsubas_own_image(tmp_path):
    """The laser's samples have no chance in them: equal to rounding, marched or straight."""
    scene = screened(tmp_path)
    direct = stock(scene)
    for each in (scene, scene.cold()):
        image = vs.render(each)
        np.testing.assert_allclose(image, direct, rtol=1e-3, atol=1e-4 * direct.max())


@pytest.mark.parametrize("light", [POINT + AREA, CONSTANT], ids=["point and area", "constant"])
def test_stock_lights_give_mitsubas_image_within_its_noise(light, tmp_path):
    """Welch's z of every pixel over independent renders, background included."""
    scene = screened(tmp_path, light, size=48, spp=16, jitter="true")
    runs, mean, variance = 10, [], []
    for number, render in enumerate((stock, vs.render)):
        images = [render(scene, seed=runs * number + k) for k in range(runs)]
        mean.append(np.mean(images, axis=0))
        variance.append(np.var(images, axis=0, ddof=1) / runs)
    difference, spread = mean[1] - mean[0], np.sqrt(sum(variance))
    noisy = spread > 1e-5 * mean[0].max()
    z = difference[noisy] / spread[noisy]
    assert np.count_nonzero(noisy) > 500
    assert np.abs(z).max() < 7.0  # Student's t of 18 degrees of freedom: one in a million
    assert np.mean(z**2) < 1.4  # 1.125 in the mean
    np.testing.assert_allclose(difference[~noisy], 0.0, atol=1e-4 * mean[0].max())


@pytest.mark.parametrize("temperature", ["cold", "hot"])
def test_no_lit_pixel_is_overlooked(temperature):
    """Beside a step, too, where a pixel's centre may look past the edge, or be bent past it.

    The tables' image is the marched one's within a thousandth; but a sample that the edge of a
    shadow passes within a nanometre may fall on either side of it.
    """
    scene = vs.load_scene("stepped_shaft", width=1024, height=1024, spp=4)
    scene = scene if temperature == "hot" else scene.cold()
    size = (80, 128)
    crop(scene, (330, 490), size)
    every, given = np.arange(size[0] * size[1], dtype=np.uint32), arrangement(scene)
    sight, _ = given.marched.sight(given.view.centres(every))
    lit = LitPixels(every, tuple(given.sources), given.marched, RenderReport("marched"), sight)
    whole, found = Prepared(given, lit).exposed(4, 0)[0].images()[0], vs.render(scene)
    inner = np.s_[1:-1, 1:-1]  # light beside the crop is not looked for
    found, whole = found[inner], whole[inner]
    lit = whole > 1e-3 * whole.max()
    assert np.all(found[lit] > 0.0)
    apart = np.abs(found - whole) > 1e-3 * whole.max()
    assert np.count_nonzero(apart) < 0.03 * np.count_nonzero(lit)


@pytest.fixture(scope="module", params=["cold", "hot"])
def coarse(request):
    """The cylinder on a coarse film, and its image."""
    scene = vs.load_scene(f"{request.param}_cylinder", **COARSE, line_length=21.7)
    return scene, vs.render(scene)


def test_mirrored_scene_gives_mirrored_image(coarse):
    """Nothing tells +y from -y: column u is column W - 1 - u, to float32's rounding."""
    _, image = coarse
    np.testing.assert_allclose(image, image[:, ::-1], atol=1e-5 * image.max())


def test_cropping_changes_no_pixel(coarse):
    """The same samples of the same rays, to the tolerance of the tables, which are others."""
    scene, image = coarse
    crop(scene, (140, 250), (101, 37))
    part = vs.render(scene)
    assert np.count_nonzero(part) > 500
    np.testing.assert_allclose(part, image[250:287, 140:241], atol=5e-4 * image.max())


@pytest.fixture(scope="module")
def screened_frame(tmp_path_factory):
    """The screened plane's frame."""
    return render_frame(screened(tmp_path_factory.mktemp("screened")))


def test_nothing_is_lit_behind_a_screen(screened_frame):
    """The plane is lit along the whole line, except in the screen's shadow."""
    y, z = screened_frame.point_mm[..., 1], screened_frame.point_mm[..., 2]
    shining = screened_frame.radiance > 1e-3 * screened_frame.radiance.max()
    on_plane, on_screen = y[shining & (np.abs(z) < 0.1)], y[shining & (np.abs(z - 20.0) < 0.1)]
    assert not np.any((on_plane > 2.0) & (on_plane < 5.0))
    assert np.all(np.abs(on_screen - 3.5) < 1.51)
    pixel_mm = 0.16
    assert np.diff(np.sort(on_plane)).max() == pytest.approx(3.0, abs=2.0 * pixel_mm)
    assert np.abs(on_plane).max() == pytest.approx(10.0, abs=pixel_mm)


def test_where_no_map_holds_the_whole_film_its_pixels_are_marched(tmp_path, monkeypatch):
    """Rationale: light that is not the laser's must not be lost with the map, a note says why."""
    scene = screened(tmp_path, POINT, size=64)
    expected = render_frame(scene)
    assert not expected.report.reason

    def refuse(*given):
        raise NoMapError("too rough")

    monkeypatch.setattr("virtual_sensor_plugins.whole_film.WholeFilm.of", refuse)
    frame = render_frame(screened(tmp_path, POINT, size=64))
    assert "too rough" in frame.report.reason
    apart = np.abs(frame.radiance - expected.radiance)
    assert np.mean(apart > 1e-3 * expected.radiance.max()) < 0.005


def test_radiance_of_a_diffuse_plane_is_lamberts(screened_frame):
    """L = rho E / pi with E = P / (length w) sqrt(2/pi) in the middle of a line square to it."""
    a, b = np.moveaxis(screened_frame.coordinates(), -1, 0)
    middle = (np.abs(a) < 0.5) & (np.abs(b) < 1.0)
    density = 0.1 / 20.0 / 2.0 * np.sqrt(2.0 / np.pi) * np.exp(-2.0 * (a[middle] / 2.0) ** 2)
    np.testing.assert_allclose(screened_frame.radiance[middle], 0.5 / np.pi * density, rtol=0.002)


@pytest.mark.parametrize("transport", ["tabulated", "marched"])
@pytest.mark.parametrize(
    ("hot", "fan"), [(False, 3.5), pytest.param(True, 0, marks=pytest.mark.slow), (True, 3.5)]
)
def test_radiance_is_the_light_between_neighbouring_rays(hot, fan, transport, tmp_path):
    """Rays of neighbouring pixels carry what lies between their coordinates, onto the area seen.

    By differences of the truth: it knows nothing of a tube's spread, nor of light that hot air or
    a fan concentrates, nor of how aslant it falls.
    """
    scene = screened(tmp_path, fan=fan, spp=1)
    scene = scene.with_transport(scene.transport.by(transport, step_mm=1.0))
    if hot:
        scene = scene.with_medium(vs.load_scene("hot_cylinder").medium)
    frame = render_frame(scene)
    (coordinates,) = frame.source_coordinates.values()
    (s_v, s_u), (t_v, t_u) = (np.gradient(coordinates[..., i].astype(float)) for i in (0, 1))
    point_v, point_u = np.gradient(frame.point_mm.astype(float), axis=(0, 1))
    share = np.abs(s_u * t_v - s_v * t_u) / np.linalg.norm(np.cross(point_u, point_v), axis=-1)
    flux = 0.1 / 20.0 / 2.0 * np.sqrt(2.0 / np.pi) * np.exp(-0.5 * coordinates[..., 0] ** 2)
    inner = (np.abs(coordinates[..., 0]) < 2.0) & (np.abs(coordinates[..., 1]) < 9.5)
    inner &= np.isfinite(share)
    inner &= point_u[..., 2] ** 2 + point_v[..., 2] ** 2 < 1e-4  # not at the screen's edge
    assert {0, 20} == set(np.rint(frame.point_mm[inner, 2]))
    assert np.count_nonzero(inner) > 1000
    expected = 0.5 / np.pi * flux[inner] * share[inner]
    np.testing.assert_allclose(frame.radiance[inner], expected, rtol=0.01)
    assert np.ptp(share[inner]) > 0.04


def test_a_scene_can_have_its_air_broadened():
    """Rationale: the paper's coarse air must be an option of the scene, seen by every study."""
    plain, broad = (vs.load_scene("hot_cylinder", **p) for p in ({}, {"widen": 1.5, "blur": "7.5"}))
    expected = blurred(widened(plain.field, 1.5), 7.5)
    np.testing.assert_array_equal(broad.field.nodes, expected.nodes)
    np.testing.assert_array_equal(broad.field.box, expected.box)
    assert broad.field.source == expected.source


def test_light_sees_broadened_air_weaker_than_the_computed():
    """Rationale: a flank of half the slope bends half as much; the middle ray stays in the middle.

    The laser's ray at y = -8 mm meets the part within three quarters of what it is moved by in the
    plume as computed.
    """
    shift = {}
    for name, choice in {"plain": {}, "blurred": {"blur": 8}, "wide": {"widen": 3}}.items():
        scene = vs.load_scene("hot_cylinder", **choice)
        hot, cold = (vs.ray_search(s, [0.0, -8.0], "newton") for s in (scene, scene.cold()))
        shift[name] = np.abs(hot.laser_point_mm - cold.laser_point_mm)[:, 1]
    for name, (middle, flank) in shift.items():
        assert middle < 1e-4 < flank, name
    assert max(shift["blurred"][1], shift["wide"][1]) < 0.75 * shift["plain"][1]


def test_another_blur_runs_the_same_kernels():
    """Rationale: each blur has a box of its own; a kernel for each would cost seconds.

    The second may still compile one, for arrays that NumPy aligned otherwise; the third must not.
    """
    scene = vs.load_scene("hot_cylinder")

    def seen(sigma_mm):
        air = scene.with_medium(blurred(scene.field, sigma_mm))
        return vs.ray_search(air, [0.0, -8.0], "newton").pixel

    seen(5.0)
    one = seen(6.0)
    with dr.scoped_set_flag(dr.JitFlag.KernelHistory, True):
        dr.kernel_history_clear()
        other = seen(9.0)
        kernels = [k for k in dr.kernel_history() if k["type"] == dr.KernelType.JIT]
    large = [k for k in kernels if k["operation_count"] > 50]  # copies are of NumPy's alignment
    assert large
    assert all(k["cache_hit"] for k in large)
    assert np.abs(other - one).max() > 1e-3


@pytest.mark.parametrize(
    ("parameters", "expected"),
    [
        ({"blur": -1}, r"quarter\.nc: blur: the standard deviation is -1 mm"),
        ({"widen": 0}, r"quarter\.nc: widen: the factor is 0"),
        ({"field": "", "blur": 7}, "'widen' and 'blur' are of a field; give the 'field'"),
        ({"field": "", "widen": 2}, "'widen' and 'blur' are of a field; give the 'field'"),
        ({"field": "", "pressure": 9e4}, "'pressure' is that of a field's air; give the 'field'"),
        ({"pressure": 950}, r"'pressure' is 950.*; give 10000 to 140000 Pa \(1 hPa is 100 Pa\)"),
        ({"pressure": "low"}, "'pressure' must be of air in Pa, or empty for the field's"),
    ],
)
def test_air_that_cannot_be_is_refused(parameters, expected):
    """Rationale: with the scene and the line in it, as for any other property."""
    with pytest.raises(vs.InputError, match=expected) as refusal:
        vs.load_scene("hot_cylinder", **parameters)
    assert "hot_cylinder.xml, line " in str(refusal.value)


def test_thinner_air_bends_light_less():
    """Rationale: n - 1 is proportional to pressure, and at 90 % of it the line lies 0.6 px back."""
    hot, thin = (vs.load_scene("hot_cylinder", pressure=p) for p in ("", 0.9 * 101325))
    assert hot.medium is vs.load_scene("hot_cylinder").medium
    assert thin.medium.ambient == pytest.approx(vs.air_refractivity(pressure_pa=91192.5), rel=1e-4)
    y = np.linspace(-9.5, 9.5, 9)
    full, less, cold = (vs.ray_search(s, y, "newton").pixel for s in (hot, thin, hot.cold()))
    shift = np.linalg.norm(full - less, axis=1)
    np.testing.assert_allclose(shift, 0.1 * np.linalg.norm(full - cold, axis=1), rtol=0.15)
    assert 0.5 < np.sqrt(np.mean(shift**2)) < 0.7


def test_another_transport_keeps_the_air_and_what_is_said_of_it():
    """Rationale: of a burst by --tolerance the file was unknown, and another instant less broad."""
    scene = vs.load_scene("hot_cylinder", widen=1.2, blur=3)
    other = scene.with_transport(scene.transport.by("marched"))
    assert other.medium is scene.medium
    assert other.air == scene.air
    assert (other.air.widen, other.air.blur_mm) == (1.2, 3.0)
    assert other.air.path.is_file()
    straight = scene.with_medium(None)
    assert (straight.air.widen, straight.air.blur_mm, straight.air.path) == (1.0, 0.0, None)
