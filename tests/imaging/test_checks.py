"""Scenes that make no sense are refused before any work, with the file, the element, the remedy."""

import re

import numpy as np
import pytest
from scipy.io import netcdf_file

from virtual_sensor.errors import InputError
from virtual_sensor.imaging.checks import check_scene
from virtual_sensor.imaging.scene import load_scene
from virtual_sensor.imaging.scene_file import shipped_scenes
from virtual_sensor.medium.index_field import IndexField
from virtual_sensor.optics.field_border import JUMP_REFUSED_PX, JUMP_TOLD_PX

AMBIENT = 2.7e-4
TOP_MM = 100.0
CAMERA = '<lookat origin="0, 0, $distance" target="0, 0, 0" up="-1, 0, 0"/>'
LASER = '<lookat origin="0, 0, $distance" target="0, 0, 0" up="0, 1, 0"/>'


@pytest.fixture
def changed(tmp_path):
    """Write a copy of a shipped scene with some text replaced; give its path."""

    def write(name, *replacements):
        text = (shipped_scenes() / f"{name}.xml").read_text(encoding="utf-8")
        for old, new in replacements:
            assert text.count(old) == 1
            text = text.replace(old, new)
        path = tmp_path / "changed.xml"
        path.write_text(text, encoding="utf-8")
        return path

    return write


@pytest.fixture
def with_field(changed):
    """Write hot_cylinder.xml with another field file; give its path."""

    def write(field):
        return changed("hot_cylinder", ("fields/hot_cylinder_$temperatureC_quarter.nc", str(field)))

    return write


@pytest.fixture
def slab(tmp_path, with_field):
    """Write a scene whose air differs from the surroundings by a jump; give it loaded."""

    def load(jump, half_width_mm=60.0):
        high = np.array([200.0, half_width_mm, TOP_MM])
        low = np.array([-200.0, -half_width_mm, -20.0])
        field = IndexField.from_arrays(
            np.full((4, 4, 4), AMBIENT + jump), low, (high - low) / 3.0, ambient=AMBIENT
        )
        field.write(tmp_path / "slab.nc")
        return load_scene(with_field(tmp_path / "slab.nc"))

    return load


def refusal(path, **parameters):
    """Message with which a scene is refused; it begins with the scene's file."""
    with pytest.raises(InputError) as refused:
        check_scene(load_scene(path, **parameters))
    assert str(refused.value).startswith(str(path))
    return str(refused.value)


def looking(lookat, origin=(0, 0, 300), target=(0, 0, 0)):
    """A `lookat` with another origin and target."""
    for name, point in (("origin", origin), ("target", target)):
        lookat = re.sub(f'{name}="[^"]*"', f'{name}="{point[0]}, {point[1]}, {point[2]}"', lookat)
    return lookat


@pytest.mark.parametrize("beta", [0, 15, 30, 60])
@pytest.mark.parametrize("name", ["hot_cylinder", "cold_cylinder", "stepped_shaft"])
def test_the_scenes_that_come_along_are_sound(name, beta):
    """Rationale: a check that complains of the paper's own set-up would be ignored."""
    assert check_scene(load_scene(name, beta=beta)) == []


@pytest.mark.parametrize("alpha", [0, 180])
def test_a_camera_in_the_laser_plane_is_refused(alpha):
    """Rationale: the line of sight runs along the plane, and no depth can be measured."""
    words = refusal(shipped_scenes() / "cold_cylinder.xml", alpha=alpha)
    assert f"alpha = {alpha} deg" in words
    assert "turn the camera out of the plane" in words


@pytest.mark.parametrize(
    ("lookat", "element"), [(CAMERA, '<sensor id="camera">'), (LASER, '<emitter id="laser">')]
)
def test_what_stands_inside_the_part_is_refused(changed, lookat, element):
    """Rationale: it would see the steel from within, and never be right."""
    words = refusal(changed("cold_cylinder", (lookat, looking(lookat, origin=(0, 0, -10)))))
    assert re.search(rf"{element} at \(.*\) mm is inside the part; move it out", words)


def test_a_camera_inside_a_mesh_is_refused(changed):
    """Rationale: a mesh has no formula for its inside; its normals tell."""
    path = changed(
        "stepped_shaft",
        (CAMERA, looking(CAMERA, origin=(0, 0, -10))),
        ("meshes/", f"{shipped_scenes()}/meshes/"),
        ("fields/", f"{shipped_scenes()}/fields/"),
    )
    assert '<sensor id="camera"> at' in refusal(path)


@pytest.mark.parametrize("place", [{"target": (0, 0, 600)}, {"origin": (0, 90, 300)}])
def test_a_laser_that_misses_the_part_is_refused(changed, place):
    """Rationale: turned away, or beside the part: the frame would be black."""
    place.setdefault("target", (0, 90, 0))
    words = refusal(changed("cold_cylinder", (LASER, looking(LASER, **place))))
    assert '<emitter id="laser">: the laser misses the part; turn it' in words


@pytest.mark.parametrize("target", [(0, 60, 0), (0, 0, 600)])
def test_a_camera_that_looks_elsewhere_is_refused(changed, target):
    """Rationale: beside the part, or away from it, where projection alone would find pixels too."""
    words = refusal(changed("cold_cylinder", (CAMERA, looking(CAMERA, target=target))))
    assert '<sensor id="camera">: the camera\'s image does not hold the laser line; turn' in words


def test_a_camera_that_looks_from_behind_is_refused(changed):
    """Rationale: the line projects into the image, but the part stands before it."""
    beneath = '<translate z="13.5"/><rotate x="1" angle="180"/><translate z="-13.5"/>'
    words = refusal(changed("cold_cylinder", (CAMERA, CAMERA + beneath)))
    assert '<sensor id="camera">: the part hides the laser line from the camera; turn' in words


@pytest.mark.parametrize("beta", [120, -120])
def test_a_sensor_under_the_floor_is_refused(beta):
    """Rationale: the field ends 36 mm below the top line, and the light would come through it."""
    words = refusal(shipped_scenes() / "hot_cylinder.xml", beta=beta)
    assert "under the floor of the air's field, z = -36 mm; turn the sensor less (beta" in words
    assert check_scene(load_scene("cold_cylinder", beta=beta)) == []


def test_a_temperature_below_absolute_zero_is_refused():
    """Rationale: -300 degC is negative in K; the file that would hold it is not the point."""
    words = refusal(shipped_scenes() / "hot_cylinder.xml", temperature=-300)
    assert "temperature=-300 degC is below absolute zero" in words
    assert "give the part's temperature in degC" in words


def test_a_field_that_does_not_reach_the_line_is_refused(slab):
    """Rationale: the hottest air is at the part; without it the rest means nothing."""
    words = refusal(slab(0.0, half_width_mm=10.9).path)
    assert '<integrator type="refractive">: the field slab.nc from (-200, -10.9, -20) to' in words
    assert "the laser meets the part at (3.276, -11, -5.674) mm, 0.1 mm beyond its end" in words
    assert "give a larger field, make one of this part (virtual-sensor field simulate" in words
    assert check_scene(slab(0.0, half_width_mm=11.1)) == []


def test_a_field_in_metres_is_recognised(tmp_path):
    """Rationale: 240 mm said to be 0.24 mm; "give a larger field" sent users to the solver."""
    air = IndexField.read("hot_cylinder_1250C_quarter")
    field = tmp_path / "air.nc"
    air.with_nodes(air.nodes, air.origin / 1000.0, air.spacing / 1000.0).write(field)
    with pytest.raises(InputError, match=r"lengths seem to be in m: .*--length-units m"):
        check_scene(load_scene("hot_cylinder", field=field))


def shift_by_snell(scene, jump, who="laser"):
    """Pixels by which rays from camera or laser miss the line, at most, if they break at TOP_MM.

    Snell's law to the letter: what of n times the direction lies in the border stays the same.
    """
    sensor = scene.sensor
    y = np.linspace(-11.0, 11.0, 33)
    z = np.sqrt(13.5**2 - y**2) - 13.5
    line = np.stack([-z * np.tan(np.radians(30.0)), y, z], axis=1)
    start = getattr(sensor, who).pose.origin_mm + (who == "laser") * line * [0.0, 1.0, 0.0]
    ray = (line - start) / np.linalg.norm(line - start, axis=1, keepdims=True)
    entry = start + ray * ((TOP_MM - start[..., 2]) / ray[:, 2])[:, None]
    along = ray[:, :2] * (1.0 + AMBIENT) / (1.0 + AMBIENT + jump)
    broken = np.column_stack([along, -np.sqrt(1.0 - (along**2).sum(axis=1))])
    miss = np.linalg.norm(np.cross(line - entry, broken), axis=1)
    camera = sensor.camera.pose.origin_mm
    depth = (camera - line) @ camera / np.linalg.norm(camera)
    return np.max(miss * 75.0 / 5.5e-3 / depth)


@pytest.mark.parametrize("jump", [2e-5, -2e-5, 5e-6])
def test_the_jump_at_the_border_is_told_in_pixels(slab, jump):
    """Rationale: pixels are what a user can judge; two digits are told."""
    scene = slab(jump)
    told = check_scene(scene)
    assert len(told) == 2
    for who, text in zip(("camera", "laser"), told, strict=True):
        assert f"does not fade to ambient where the {who}'s light enters it" in text
        assert f"a jump of {abs(jump):.1e} in n - 1" in text
        assert re.search(rf"at \(-?5\d\.\d+, \S+, {TOP_MM:g}\) mm", text)
        shift = float(re.search(r"by about (\S+) px", text)[1])
        assert shift == pytest.approx(shift_by_snell(scene, jump, who), rel=0.03)


@pytest.mark.parametrize(
    ("shift_px", "verdict"),
    [(0.0025, "silent"), (0.0035, "told"), (0.095, "told"), (0.105, "refused")],
)
def test_the_jump_is_told_above_0_003_px_and_refused_above_0_1_px(slab, shift_px, verdict):
    """Rationale: the first is what the rendered line may differ by from the search."""
    assert (JUMP_TOLD_PX, JUMP_REFUSED_PX) == (0.003, 0.1)
    jump = 1e-5 * shift_px / shift_by_snell(slab(1e-5), 1e-5)
    scene = slab(jump)
    if verdict == "refused":
        words = refusal(scene.path)
        assert '<integrator type="refractive">: the field slab.nc does not fade to ambient' in words
        assert "its ambient 0.00027: was the ambient forgotten?" in words
        assert f"{scene.path}: {words.partition(': ')[2]}" in scene.notes
        (given,) = scene.with_medium(scene.medium).notes
        assert "the given air does not fade to ambient" in given
    else:
        assert bool(check_scene(scene)) == (verdict == "told")


def write_field(
    path, dimensions=("x", "y", "z"), units="K", value=400.0, axis_units="mm", step=2.0
):
    """Write air of one temperature, but for node [1, 1, 1], on a grid of 5 x 5 x 5."""
    with netcdf_file(path, "w") as nc:
        for axis in "xyz":
            nc.createDimension(axis, 5)
            coordinate = nc.createVariable(axis, "f8", (axis,))
            coordinate[:] = np.arange(5) * (step if axis == "y" else 2.0)
            if axis_units:
                coordinate.units = axis_units
        temperature = nc.createVariable("temperature", "f8", dimensions)
        temperature[:] = np.full((5, 5, 5), 400.0)
        temperature[1, 1, 1] = value
        if units:
            temperature.units = units
    return path


@pytest.mark.parametrize(
    ("fault", "complaint"),
    [
        ({"value": np.nan}, r"1 nodes have no finite value, the first is \[1, 1, 1\]; give them"),
        ({"value": -5.0}, r"variable 'temperature' is -5 K at node \[1, 1, 1\].* check its units"),
        ({"units": "degF"}, "variable 'temperature' has units 'degF'; give one of: K, "),
        ({"units": None}, "variable 'temperature' has no attribute 'units'; give one of: K, "),
        ({"axis_units": None}, "variable 'x' has no attribute 'units'; give one of: mm, "),
        ({"step": -2.0}, "coordinate 'y' does not ascend; reverse it"),
        (
            {"dimensions": ("z", "y", "x")},
            r"'temperature' has the dimensions \(z, y, x\).* reorder",
        ),
    ],
    ids=lambda value: "-".join(value) if isinstance(value, dict) else "",
)
def test_a_bad_field_file_is_refused_through_the_scene(tmp_path, with_field, fault, complaint):
    """Rationale: Mitsuba loads the plugins; our words must come through it, with both files."""
    field = write_field(tmp_path / "air.nc", **fault)
    path = with_field(field)
    assert re.search(rf"changed\.xml, line \d+: {field}: .*{complaint}", refusal(path))


def test_a_field_file_that_is_not_there_is_named_with_those_that_are(tmp_path, with_field):
    """Rationale: what a temperature without a field needs is the list of those with one."""
    write_field(tmp_path / "air_900.nc")
    words = refusal(with_field(tmp_path / "air_800.nc"))
    assert "air_800.nc: there is no such field file" in words
    assert "air_900.nc" in words


def test_a_projector_is_checked_as_a_laser_is():
    """Rationale: its scene has no laser line, and none of the notes may say that it needs one."""
    assert load_scene("fringe_cylinder").notes == ()
    (glowing,) = check_scene(load_scene("fringe_cylinder", emissivity=0.8))
    assert "of the projector's light" in glowing
    refused = {
        '<emitter id="projector">: the projector misses the part': {"along": 200},
        "e-06 mm from the projector's axis": {"alpha": 0},
    }
    for words, given in refused.items():
        with pytest.raises(InputError, match=re.escape(words)):
            check_scene(load_scene("fringe_cylinder", **given))
