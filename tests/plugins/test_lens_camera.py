"""The sensor `lens_camera`: equal to Mitsuba's where it is a pinhole."""

import numpy as np
import pytest

import virtual_sensor as vs
from virtual_sensor.engine import mi

SCENE = """<scene version="3.0.0">
    <integrator type="refractive"/>
    <sensor type="{kind}">
        {field_of_view}
        <float name="principal_point_offset_x" value="0.1"/>
        <float name="principal_point_offset_y" value="-0.05"/> {more}
        <transform name="to_world">
            <lookat origin="80, 0, 280" target="0, 0, 0" up="-1, 0, 0"/>
        </transform>
        <film type="hdrfilm"><integer name="width" value="96"/> <integer name="height" value="64"/>
            <string name="pixel_format" value="luminance"/> <rfilter type="box"/></film>
        <sampler type="stratified"><integer name="sample_count" value="4"/></sampler>
    </sensor>
    <emitter type="laser_line">
        <float name="length" value="20"/> <float name="radius" value="0.5"/>
        <transform name="to_world">
            <lookat origin="0, 0, 300" target="0, 0, 0" up="0, 1, 0"/>
        </transform>
    </emitter>
    {emitter}
    <shape type="cylinder">
        <point name="p0" x="-85" y="0" z="-13.5"/> <point name="p1" x="85" y="0" z="-13.5"/>
        <float name="radius" value="13.5"/>
    </shape>
</scene>"""

FOV = '<float name="fov" value="7"/> <string name="fov_axis" value="{}"/>'
NEAR = '<float name="near_clip" value="270"/>'
BENT = f'{NEAR} <string name="distortion" value="-10, 0, 0.4, 0"/>'
LENS = f"""{NEAR} <float name="pixel" value="50"/> <float name="f_number" value="2"/>
    <float name="focus_distance" value="200"/>"""


@pytest.fixture
def load(tmp_path):
    """A scene with the sensor of some kind."""

    def loaded(
        kind="lens_camera", axis="x", more="", emitter='<emitter type="constant"/>', fov=FOV
    ):
        path, seen = tmp_path / "scene.xml", fov.format(axis)
        path.write_text(SCENE.format(kind=kind, field_of_view=seen, more=more, emitter=emitter))
        return vs.load_scene(path)

    return loaded


def test_a_pinhole_is_mitsubas_perspective_to_the_bit(load):
    """By our integrator and by another, whatever axis the field of view is of."""
    for axis in ("x", "y", "diagonal"):
        one, other = load("perspective", axis), load("lens_camera", axis)
        assert one.camera == other.camera
        np.testing.assert_array_equal(vs.render(one), vs.render(other))
    path = mi.load_dict({"type": "direct"})
    images = [np.array(mi.render(scene.mitsuba, integrator=path)) for scene in (one, other)]
    assert images[0].max() > 0.0
    np.testing.assert_array_equal(*images)


def test_other_integrators_see_through_the_lens_too(load):
    """Mitsuba's own, by samples of the pupil: as wide and in the same place as ours.

    Its rays start near the cylinder: from afar, its float32 hits shadow themselves.
    """
    direct = mi.load_dict({"type": "direct"})
    row, found = np.arange(64), {}
    for more in ("", BENT, LENS):
        scene = load(more=more, emitter="")
        theirs = np.array(mi.render(scene.mitsuba, integrator=direct, spp=256))[:, :, 0]
        for whose, image in (("ours", vs.render(scene, spp=64)), ("theirs", theirs)):
            light = image[:, 40:56].sum(axis=1).astype(float)
            middle = row @ light / light.sum()
            found[more, whose] = middle, np.sqrt((row - middle) ** 2 @ light / light.sum())
    assert abs(found[BENT, "ours"][0] - found["", "ours"][0]) > 0.05
    assert found[LENS, "ours"][1] > 5.0 * found["", "ours"][1]
    for more, px in ((BENT, 0.01), (LENS, 0.15)):  # of 5 px of blur, which are noisy
        np.testing.assert_allclose(found[more, "theirs"], found[more, "ours"], atol=px)


def test_an_image_distance_is_a_field_of_view_and_the_lens_may_take_light(load):
    """With the same shift of the film; 96 pixels of 50 um see 7 degrees."""
    image_mm = 48 * 0.05 / np.tan(np.radians(3.5))
    given = (
        f'<float name="image_distance" value="{image_mm:.12f}"/><float name="pixel" value="50"/>'
    )
    camera = load(fov=given, more='<float name="transmission" value="0.9"/>').camera
    np.testing.assert_allclose(camera.matrix, load("perspective").camera.matrix, rtol=1e-6)
    assert camera.transmission == 0.9


def test_samples_of_the_pupil_meet_in_the_plane_in_focus(load):
    """Of a pixel, in the point that its chief ray has in focus, where the sensor is tilted too."""
    scene = load(more=f'{LENS} <string name="tilt" value="20, 30"/>')
    (sensor,), camera = scene.mitsuba.sensors(), scene.camera
    pixel = np.repeat([[5.0, 9.0], [90.0, 9.0], [20.0, 60.0]], 3, axis=0)
    place = mi.Point2f(((pixel + 0.5) / camera.size).T)  # Mitsuba's, of the whole film
    aperture = mi.Point2f(np.tile([[0.5, 0.5], [0.1, 0.8], [0.9, 0.3]], (3, 1)).T)
    ray, _ = sensor.sample_ray(0.0, 0.5, place, aperture)
    origin, ahead = (np.array(each, float).T for each in (ray.o, ray.d))
    depth = 1.0 / camera.lens.in_focus(*camera.of_pixels(pixel))
    start, slope = camera.pose.to_local(origin)[:, 2], (ahead @ camera.pose.rotation)[:, 2]
    met = origin + ahead * ((depth - start) / slope)[:, None]
    np.testing.assert_allclose(camera.project(met), pixel, atol=0.01)
