"""The sensor `lens_camera`: equal to Mitsuba's where it is a pinhole."""

import numpy as np
import pytest

import virtual_sensor as vs
from virtual_sensor.engine import mi

SCENE = """<scene version="3.0.0">
    <integrator type="refractive"/>
    <sensor type="{kind}">
        <float name="fov" value="7"/> <string name="fov_axis" value="{axis}"/>
        <float name="principal_point_offset_x" value="0.1"/>
        <float name="principal_point_offset_y" value="-0.05"/>
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
    <emitter type="constant"/>
    <shape type="cylinder">
        <point name="p0" x="-85" y="0" z="-13.5"/> <point name="p1" x="85" y="0" z="-13.5"/>
        <float name="radius" value="13.5"/>
    </shape>
</scene>"""


@pytest.fixture
def load(tmp_path):
    """A scene with the sensor of some kind."""

    def loaded(kind="lens_camera", axis="x"):
        path = tmp_path / f"{kind}_{axis}.xml"
        path.write_text(SCENE.format(kind=kind, axis=axis))
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
