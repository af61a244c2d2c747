"""Frames of several cameras and lasers, or lamps alone: as sums, and by Mitsuba's own `direct`."""

import numpy as np
import pytest
from several import two_by_two

import virtual_sensor as vs
from virtual_sensor.engine import mi
from virtual_sensor.imaging.render import render_frame

PLANE = """<scene version="3.0.0">
    <integrator type="refractive"/>
    CAMERAS
    LIGHTS
    <bsdf type="diffuse" id="grey"><float name="reflectance" value="0.5"/></bsdf>
    <shape type="rectangle"><transform name="to_world"><scale value="12"/></transform>
        <ref id="grey"/></shape>
</scene>"""
CAMERA = """<sensor type="perspective" id="{id}"><float name="fov" value="4"/>
    <transform name="to_world"><lookat origin="{origin}" target="0, 0, 0" up="0, 1, 0"/></transform>
    <film type="hdrfilm"><integer name="width" value="{width}"/><integer name="height" value="48"/>
    <string name="pixel_format" value="luminance"/><rfilter type="box"/></film>
    <sampler type="stratified"><integer name="sample_count" value="16"/>
    <boolean name="jitter" value="false"/></sampler></sensor>"""
LASER = """<emitter type="laser_line" id="{id}"><float name="length" value="10"/>
    <float name="radius" value="1"/><float name="power" value="{power}"/>
    <transform name="to_world"><lookat origin="{origin}" target="{target}" up="0, 1, 0"/>
    </transform></emitter>"""
CAMERAS = CAMERA.format(id="left", origin="-90, 0, 280", width=48) + CAMERA.format(
    id="right", origin="120, 0, 260", width=64
)
RED = LASER.format(id="red", power=0.1, origin="0, 0, 300", target="-3, 0, 0")
BLUE = LASER.format(id="blue", power=0.05, origin="150, 0, 260", target="3, 1, 0")
LAMP = '<emitter type="point" id="lamp"><point name="position" x="80" y="50" z="90"/></emitter>'


@pytest.fixture
def plane(tmp_path):
    """A plane seen by the cameras, in given light."""

    def load(lights, cameras=CAMERAS):
        path = tmp_path / "plane.xml"
        text = PLANE.replace("CAMERAS", cameras).replace("LIGHTS", lights)
        path.write_text(text, encoding="utf-8")
        return vs.load_scene(path)

    return load


@pytest.fixture(scope="module")
def two(tmp_path_factory):
    return two_by_two(tmp_path_factory.mktemp("two"), spp=1)


@pytest.fixture(scope="module")
def frames(two):
    """Of each camera, by its name and the source's; None: of both sources."""
    return {
        (camera, source): render_frame(two, camera=camera, source=source)
        for camera in two.cameras
        for source in (None, *two.sources)
    }


def direct(scene, camera, spp):
    """Mitsuba's own picture (H, W)."""
    sensor = scene.only(camera=camera).mitsuba_camera
    image = mi.load_dict({"type": "direct"}).render(scene.mitsuba, sensor, spp=spp)
    return np.array(image)[..., 0]


@pytest.mark.parametrize(
    ("name", "width"), [("left", 48), pytest.param("right", 64, marks=pytest.mark.slow)]
)
def test_both_lasers_give_mitsubas_own_picture(plane, name, width):
    """Of each camera, whatever its film; `direct` chooses a laser at random for each sample."""
    scene = plane(RED + BLUE)
    image, expected = vs.render(scene, camera=name, spp=1024), direct(scene, name, 4096)
    assert image.shape == (48, width)
    np.testing.assert_allclose(image, expected, atol=0.1 * expected.max())
    bright = expected > 0.1 * expected.max()
    assert np.mean(image[bright] / expected[bright]) == pytest.approx(1.0, abs=3e-3)


def test_lamps_alone_give_mitsubas_own_picture(plane):
    """A scene without a laser is one, with as many cameras as it likes."""
    scene = plane(LAMP)
    for name in scene.cameras:
        expected = direct(scene, name, 64)
        assert expected.max() > 0.0
        image = vs.render(scene, camera=name, spp=64)
        np.testing.assert_allclose(image, expected, atol=0.02 * expected.max())
        frame = render_frame(scene, camera=name)
        assert not frame.lit.any()
        assert dict(frame.source_coordinates) == {}


def test_without_any_light_the_picture_is_black(plane):
    for name in ("left", "right"):
        assert not vs.render(plane(""), camera=name).any()


def test_a_lamp_shines_beside_the_one_source(plane):
    """`only` is about cameras and sources: what is neither stays as it is."""
    scene = plane(RED + BLUE + LAMP)
    lamp, red = (
        vs.render(s, spp=16)
        for s in (plane(LAMP).only("left"), plane(RED + BLUE).only("left", "red"))
    )
    both = vs.render(scene, camera="left", source="red", spp=16)
    np.testing.assert_allclose(both, lamp + red, atol=0.02 * both.max())


@pytest.mark.parametrize("state", ["hot", "cold"])
@pytest.mark.parametrize("transport", ["tabulated", "marched"])
def test_a_frame_is_the_sum_of_those_with_one_laser(two, frames, state, transport):
    """Light adds up: each camera's frame, to what its maps may err by."""
    assert two.transport.name == "tabulated"
    scene = two.with_transport(two.transport.by(transport))
    scene = scene if state == "hot" else scene.cold()
    for camera in scene.cameras:
        whole, *parts = (
            frames[camera, source].radiance
            if (transport, state) == ("tabulated", "hot")
            else vs.render(scene, camera=camera, source=source)
            for source in (None, *scene.sources)
        )
        assert all(part.max() > 0.2 * whole.max() for part in parts)
        np.testing.assert_allclose(whole, sum(parts), atol=2e-3 * whole.max())


def test_the_truth_of_each_laser_is_that_of_its_own_frame(two, frames):
    """By name: where it lights the part, and with which of its rays."""
    for camera in two.cameras:
        both = frames[camera, None]
        assert list(both.source_coordinates) == ["red", "blue"]
        lit = np.zeros_like(both.lit)
        for source in two.sources:
            alone = frames[camera, source]
            (expected,) = alone.source_coordinates.values()
            found = both.source_coordinates[source]
            np.testing.assert_array_equal(np.isnan(found), np.isnan(expected))
            np.testing.assert_allclose(found, expected, atol=2e-4)
            known = alone.lit
            np.testing.assert_allclose(both.point_mm[known], alone.point_mm[known], atol=2e-4)
            lit |= known
        np.testing.assert_array_equal(both.lit, lit)


def test_rendered_lines_of_each_pair_are_searched_ones(two):
    """Rationale: the right camera with the right laser, in hot air, to a hundredth of a pixel."""
    for camera in two.cameras:
        for source in two.sources:
            pair = two.only(camera, source)
            line = vs.line_centres(vs.render(pair, spp=16))
            y = np.linspace(-8.0, 8.0, 33)
            u, v = vs.ray_search(pair, y, "newton").pixel.T
            order = np.argsort(u)
            good = np.flatnonzero(np.isfinite(line.row))
            good = good[(good > u.min() + 1) & (good < u.max() - 1)]
            assert good.size > 35
            apart = line.row[good] - np.interp(good, u[order], v[order])
            assert np.sqrt(np.mean(apart**2)) < 0.02


@pytest.mark.parametrize("ask", [vs.render, render_frame])
def test_a_frame_asks_for_its_camera(two, ask):
    """And says which there are; an unknown laser is refused as well."""
    with pytest.raises(vs.InputError, match=r"2 cameras: near, far; say which \(camera=, or"):
        ask(two)
    with pytest.raises(vs.InputError, match="no source 'green'; the scene has: red, blue"):
        ask(two, camera="near", source="green")
