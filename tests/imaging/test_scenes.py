"""Scenes as they are loaded: the paper's numbers, parameters, the shipped parts, and refusals."""

import os
import re
import subprocess
import sys

import numpy as np
import pytest
from virtual_sensor_scenes.make_stepped_shaft import profile, revolved

import virtual_sensor as vs
from virtual_sensor.engine import dr, mi
from virtual_sensor.imaging.scene_file import shipped_scenes
from virtual_sensor.medium.netcdf import GriddedQuantity, write_quantity
from virtual_sensor.optics.ray_families import Sheet
from virtual_sensor.optics.ray_search import SearchStatus
from virtual_sensor.optics.surfaces import Cylinder, SceneSurface

SHIPPED = ["cold_cylinder", "hot_cylinder", "stepped_shaft"]


MATERIAL = '<include filename="materials/$material.xml"/>'


def shipped_text(name):
    """A shipped scene's XML."""
    return (shipped_scenes() / f"{name}.xml").read_text(encoding="utf-8")


def element(text, tag):
    """The first element of a tag, as text."""
    return re.search(rf" *<{tag} .*?</{tag}>\n", text, re.DOTALL).group()


@pytest.mark.parametrize("name", SHIPPED)
def test_sensor_model_is_the_papers(name):
    """Table 1: f = 75 mm, 2048 pixels of 5.5 um, 300 mm away, 60 degrees between the axes."""
    sensor = vs.load_scene(name).sensor
    camera, laser = sensor.camera, sensor.laser
    focal_px = 75.0 / 5.5e-3
    expected = [[focal_px, 0.0, 1023.5], [0.0, focal_px, 1023.5], [0.0, 0.0, 1.0]]
    np.testing.assert_allclose(camera.matrix, expected, rtol=1e-7)
    assert camera.size == (2048, 2048)
    assert sensor.triangulation_angle_deg == pytest.approx(60.0, abs=1e-4)
    for pose, x in ((camera.pose, 150.0), (laser.pose, -150.0)):
        np.testing.assert_allclose(pose.origin_mm, [x, 0, 150 * np.sqrt(3)], atol=1e-4)
        np.testing.assert_allclose(pose.rotation[:, 2], -pose.origin_mm / 300.0, atol=1e-6)
        np.testing.assert_allclose(pose.rotation.T @ pose.rotation, np.eye(3), atol=1e-12)
        assert np.linalg.det(pose.rotation) == pytest.approx(1.0)
    # u runs along +y, and so does the laser line.
    np.testing.assert_allclose(camera.pose.rotation[:, 0], [0, 1, 0], atol=1e-6)
    np.testing.assert_allclose(laser.pose.rotation[:, 1], [0, 1, 0], atol=1e-6)
    assert isinstance(laser.family, Sheet)
    assert (laser.family.distance_mm, laser.length_mm) == (300.0, 22.0)
    assert laser.power_w == pytest.approx(0.1)


@pytest.mark.parametrize("beta", [15.0, -30.0])
def test_beta_turns_the_sensor_round_the_parts_axis(beta):
    """Camera and laser as one body, about y = 0, z = -13.5."""
    upright, turned = (vs.load_scene("cold_cylinder", beta=b).sensor for b in (0.0, beta))
    c, s = np.cos(np.radians(beta)), np.sin(np.radians(beta))
    about_x = np.array([[1.0, 0.0, 0.0], [0.0, c, -s], [0.0, s, c]])
    axis = np.array([0.0, 0.0, -13.5])
    for before, after in ((upright.camera, turned.camera), (upright.laser, turned.laser)):
        expected = axis + about_x @ (before.pose.origin_mm - axis)
        np.testing.assert_allclose(after.pose.origin_mm, expected, atol=1e-4)
        np.testing.assert_allclose(after.pose.rotation, about_x @ before.pose.rotation, atol=1e-6)


@pytest.mark.parametrize("name", SHIPPED)
def test_along_moves_the_sensor_along_the_parts_axis(name):
    """Rationale: a scan is the same sensor at other x, turned by beta or not."""
    here, there = (vs.load_scene(name, beta=20, along=x).sensor for x in (0.0, -37.5))
    for a, b in ((here.camera.pose, there.camera.pose), (here.laser.pose, there.laser.pose)):
        np.testing.assert_allclose(b.origin_mm - a.origin_mm, [-37.5, 0.0, 0.0], atol=1e-4)
        np.testing.assert_allclose(b.rotation, a.rotation, atol=1e-6)


def test_parameters_reach_the_scene():
    """Each parameter moves what it names, and what is used is listed, defaults included."""
    scene = vs.load_scene(
        "hot_cylinder",
        **{"alpha": 45, "tilt": -20, "line_length": 8, "line_radius": 0.2, "dots": "0, -1.5"},
        **{"width": 400, "height": 300, "spp": 4, "step": 1.5, "method": "rk4", "fan": 1},
        precision="double",
    )
    sensor, march = scene.sensor, scene.transport.march
    assert sensor.triangulation_angle_deg == pytest.approx(45.0, abs=1e-4)
    tilt = np.degrees(np.arcsin(sensor.laser.pose.origin_mm[0] / 300.0))
    assert tilt == pytest.approx(-20.0, abs=1e-4)
    assert sensor.laser.length_mm == pytest.approx(8.0)
    assert sensor.laser.radius_mm == pytest.approx(0.2)
    ends = sensor.laser.family.rays(0.0, [-4.0, 4.0])[1]
    assert np.degrees(np.arcsin(np.linalg.norm(np.cross(*ends)))) == pytest.approx(1.0)
    np.testing.assert_allclose(sensor.laser.dots_mm, [0.0, -1.5])
    assert sensor.camera.size == (400, 300)
    assert sensor.camera.matrix[0, 0] == pytest.approx(75.0 / 5.5e-3 * 400 / 2048, rel=1e-6)
    np.testing.assert_allclose(sensor.camera.matrix[:2, 2], [199.5, 149.5])
    assert scene.mitsuba.sensors()[0].sampler().sample_count() == 4
    assert (march.step_mm, march.method, march.precision) == (1.5, "rk4", "double")
    assert scene.parameters["alpha"] == "45"
    assert scene.parameters["temperature"] == "1250"


def test_air_is_the_scenes():
    """The hot scene's field holds hot air at the cylinder's top; cold() and the cold scene none."""
    hot = vs.load_scene("hot_cylinder")
    above, far = hot.field.refractivity([[0.0, 0.0, 2.0], [0.0, 100.0, 100.0]])
    assert above < 0.5 * far
    assert hot.field.ambient == pytest.approx(vs.air_refractivity(), rel=1e-3)
    assert hot.cold().field is None
    assert vs.load_scene("cold_cylinder").field is None


@pytest.fixture
def gusty(tmp_path):
    """Field file of two instants, hot at 1 s and hotter at 3 s."""
    x, y = np.meshgrid(np.linspace(-90, 90, 9), np.linspace(-20, 20, 21), indexing="ij")
    shape = np.exp(-((x / 30) ** 2) - (y / 6) ** 2)[..., None]
    fading = np.linspace(1.0, 0.0, 9) ** 2
    kelvin = 293.15 + np.array([400.0, 800.0])[:, None, None, None] * shape * fading
    origin, spacing = np.array([-90.0, -20.0, -16.0]), np.array([22.5, 2.0, 14.5])
    path = tmp_path / "gusty.nc"
    write_quantity(
        path, GriddedQuantity("temperature", kelvin, origin, spacing, np.array([1.0, 3.0]))
    )
    return path


def test_a_time_picks_an_instant_of_the_field(gusty):
    """The last without one; and from a loaded scene any other, with all else as it was."""
    last, first, between = (
        vs.load_scene("hot_cylinder", field=gusty, **time)
        for time in ({}, {"time": 1}, {"time": "2.0"})
    )
    p = [[0.0, 0.0, 5.0], [3.0, 2.0, 40.0]]
    n_last, n_first, n_between = (s.field.refractivity(p) for s in (last, first, between))
    assert (n_last < n_between).all()
    assert (n_between < n_first).all()
    other = last.at(2.0)
    np.testing.assert_array_equal(other.field.refractivity(p), n_between)
    np.testing.assert_array_equal(other.at(1.0).field.refractivity(p), n_first)
    np.testing.assert_array_equal(last.field.refractivity(p), n_last)
    assert other.mitsuba is last.mitsuba
    assert (other.sensor, other.surface) == (last.sensor, last.surface)
    assert other.transport == last.transport
    assert other.parameters == between.parameters | {"time": "2"}
    wider = other.with_parameters(width=100)
    np.testing.assert_array_equal(wider.field.refractivity(p), n_between)
    assert wider.parameters == other.parameters | {"width": "100", "pixel": "112.64"}


def test_another_instant_is_as_broad(gusty):
    """Rationale: a burst through broadened air must not sharpen from its second frame on."""
    broad = {"field": gusty, "widen": 1.5, "blur": 4}
    last, first = (vs.load_scene("hot_cylinder", **broad, time=t) for t in (3, 1))
    for again, expected in ((last.at(1.0), first), (last.at(1.0).at(3.0), last)):
        np.testing.assert_array_equal(again.field.nodes, expected.field.nodes)
        np.testing.assert_array_equal(again.field.box, expected.field.box)


def test_another_instant_runs_the_same_kernels(gusty):
    """What changes with the air is data; a kernel compiled for each instant would cost seconds."""
    scene = vs.load_scene(
        "hot_cylinder", field=gusty, width=128, height=128, line_radius=0.5, spp=1
    )

    def seen(time_s):
        now = scene.at(time_s)
        return vs.render(now), vs.ray_search(now, [0.0, -4.0], "newton").pixel

    one, pixel_of_one = seen(1.0)
    with dr.scoped_set_flag(dr.JitFlag.KernelHistory, True):
        dr.kernel_history_clear()
        other, pixel_of_other = seen(2.7)
        kernels = [k for k in dr.kernel_history() if k["type"] == dr.KernelType.JIT]
    large = [k for k in kernels if k["operation_count"] > 50]  # copying depends on the alignment
    assert large
    assert all(k["cache_hit"] for k in large)
    assert np.abs(other - one).max() > 0.01 * one.max()
    assert np.abs(pixel_of_other - pixel_of_one).max() > 1e-3


@pytest.mark.parametrize(
    ("parameters", "expected"),
    [
        ({"time": "late"}, "'time' must be a flow time in s, or empty for the last, not \"late\""),
        ({"time": 3.5}, "gusty.nc: it has no instant at 3.5 s; give a time from 1 to 3 s"),
        ({"time": "nan"}, "gusty.nc: it has no instant at nan s; give a time from 1 to 3 s"),
        (
            {"time": 1, "field": "fields/hot_cylinder_1250C_quarter.nc"},
            "one instant without a time",
        ),
        ({"time": 1, "field": ""}, "'time' is one of a field's; give the 'field', or no time"),
    ],
)
def test_a_time_that_the_field_has_not_is_refused(gusty, parameters, expected):
    """With the scene, the line in it, the field's file and its range."""
    with pytest.raises(vs.InputError, match=re.escape(expected)) as refusal:
        vs.load_scene("hot_cylinder", **({"field": gusty} | parameters))
    assert re.search(r"hot_cylinder\.xml, line \d+: ", str(refusal.value))
    assert str(refusal.value).count("refractive: ") <= 1


def test_only_a_field_file_has_instants(gusty):
    """In homogeneous air, or air of another file, there is nothing to choose from."""
    scene = vs.load_scene("hot_cylinder", field=gusty)
    with pytest.raises(
        vs.InputError, match=r"hot_cylinder\.xml: .*gusty\.nc: it has no instant at 9"
    ):
        scene.at(9.0)
    with pytest.raises(vs.InputError, match=r"hot_cylinder\.xml: there is no 'field'"):
        scene.cold().at(1.0)


def test_a_field_of_ones_own_is_named_from_where_one_stands(gusty, monkeypatch):
    """-D field=FILE, from the file's folder; without it, temperature chooses among the shipped."""
    monkeypatch.chdir(gusty.parent)
    scene = vs.load_scene("hot_cylinder", field="gusty.nc")
    assert scene.air.path == gusty
    monkeypatch.chdir("/")
    assert scene.at(1.0).field.shape == scene.field.shape
    shipped = vs.load_scene("hot_cylinder")
    assert shipped.air.path.name == "hot_cylinder_1250C_quarter.nc"
    assert shipped.parameters["field"] == "fields/hot_cylinder_1250C_quarter.nc"


def test_cylinder_is_recognised():
    """The reference figures want it analytic."""
    assert vs.load_scene("cold_cylinder").surface == Cylinder(13.5, 85.0, 0.0, -13.5)
    assert not isinstance(vs.load_scene("stepped_shaft").surface, Cylinder)


@pytest.mark.slow
def test_shipped_scenes_are_found_from_anywhere(tmp_path):
    """By name, from a folder that knows nothing of the checkout."""
    program = "import virtual_sensor as vs; print(vs.load_scene('stepped_shaft').path.name)"
    environment = {k: v for k, v in os.environ.items() if k != "PYTHONPATH"}
    run = subprocess.run(
        [sys.executable, "-c", program], cwd=tmp_path, env=environment, capture_output=True
    )
    assert run.stdout.split() == [b"stepped_shaft.xml"], run.stderr.decode()


def test_stepped_shaft_is_closed_and_faces_outward():
    """Each edge has two triangles that run along it in opposite directions; the volume is right."""
    vertices, faces = revolved(profile())
    points, same = np.unique(vertices[:, :3], axis=0, return_inverse=True)
    faces = same.ravel()[faces]
    edges = np.concatenate([faces[:, [i, (i + 1) % 3]] for i in range(3)])
    there = set(map(tuple, edges.tolist()))
    assert len(there) == len(edges)
    assert there == {(end, start) for start, end in there}
    corner = points.astype(float)[faces]
    volume = np.einsum("ij,ij->", corner[:, 0], np.cross(corner[:, 1], corner[:, 2])) / 6.0
    x, r = profile().T
    exact = np.pi * np.sum(r[1:-1:2] ** 2 * (x[2::2] - x[1:-1:2]))
    assert volume == pytest.approx(exact, rel=1e-4)


def test_stepped_shaft_is_round_to_half_a_micrometre():
    """Its facets' chords lie no deeper in the true circle; the largest touches z = 0."""
    vertices, faces = revolved(profile())
    start, end = vertices[faces, :3].astype(float), vertices[np.roll(faces, 1, axis=1), :3]
    radius, other, middle = (
        np.hypot(p[..., 1], p[..., 2] + 13.5) for p in (start, end, (start + end) / 2.0)
    )
    chord = (start[..., 0] == end[..., 0]) & (np.abs(radius - other) < 1e-5)
    assert (radius - middle)[chord].max() < 5e-4
    assert radius.max() == pytest.approx(13.5)
    assert vertices[:, 2].max() == pytest.approx(0.0, abs=1e-6)


def test_shipped_shaft_is_what_its_script_makes():
    """No stale mesh."""
    file = shipped_scenes() / "meshes" / "stepped_shaft.ply"
    mesh = mi.traverse(mi.load_dict({"type": "ply", "filename": str(file)}))
    vertices, faces = revolved(profile())
    np.testing.assert_array_equal(np.ravel(mesh["faces"]), faces.ravel())
    places = np.reshape(mesh["vertex_positions"], (-1, 3))
    np.testing.assert_allclose(places, vertices[:, :3], atol=1e-5)


@pytest.mark.parametrize("temperature", ["cold", "hot"])
def test_search_sees_the_shafts_steps_and_not_into_its_groove(temperature):
    """The radii that laser rays meet by the drawing, and which of these points the camera sees."""
    scene = vs.load_scene("stepped_shaft")
    y = np.array([0.0, -2.0, 3.4, -4.1, 5.2, 5.9, -6.8, 7.5, -7.6, 8.2, -9.1, 10.9])
    radius = np.array([13.5] * 3 + [13.0] * 2 + [12.0] * 4 + [np.nan] + [12.5] * 2)
    scene = scene if temperature == "hot" else scene.cold()
    found = vs.ray_search(scene, y, "newton")
    met = np.hypot(found.laser_point_mm[:, 1], found.laser_point_mm[:, 2] + 13.5)
    wall = np.isnan(radius)
    np.testing.assert_allclose(met[~wall], radius[~wall], atol=5e-4)
    np.testing.assert_allclose(found.laser_point_mm[wall, 0], 2.6, atol=1e-4)
    hidden = (np.abs(y) > 7.4) & (np.abs(y) < 8.4)
    np.testing.assert_array_equal(
        found.status, np.where(hidden, SearchStatus.UNDERCUT, SearchStatus.FOUND)
    )
    np.testing.assert_array_equal(np.isnan(found.pixel[:, 0]), hidden)


COLD = shipped_text("cold_cylinder")
LASER, CAMERA, INTEGRATOR = (element(COLD, each) for each in ("emitter", "sensor", "integrator"))
STRAIGHT = '<integrator type="refractive"/>'
AIR = '<string name="field" value="air.nc"/>'
CAMERA_WITHOUT = re.sub(r"\s*<(string|float) .*?/>", "", CAMERA)

REFUSED = {
    "not XML": ("a scene", ["not well-formed", "line 1"]),
    "not closed": (COLD.replace("</scene>", ""), ["not well-formed"]),
    "not a scene": ("<mesh/>", ["<mesh>", "<scene>"]),
    "property misspelt": (
        COLD.replace('name="power"', 'name="pwoer"'),
        [
            f"line {COLD.partition(LASER)[0].count(chr(10)) + 1}: ",
            '<emitter type="laser_line">',
            '"pwoer"',
            "correct its name",
        ],
    ),
    "plugin misspelt": (
        COLD.replace(MATERIAL, '<bsdf type="difuse" id="steel"/>'),
        ["line ", '<bsdf type="difuse">', "correct its type"],
    ),
    "property missing": (
        COLD.replace('<float name="radius" value="$line_radius"/>', ""),
        ["laser_line", "'radius'", "mm"],
    ),
    "pose missing": (
        re.sub(r"(<emitter.*?)<transform.*?</transform>", r"\1", COLD, flags=re.DOTALL),
        ['<emitter type="laser_line">', '"to_world"', "add it"],
    ),
    "parameter undefined": (COLD.replace('"$tilt"', '"$tlit"', 1), ["line ", "$tlit", "<default>"]),
    "mesh missing": (
        shipped_text("stepped_shaft").replace("fields/", f"{shipped_scenes()}/fields/"),
        ['<shape type="ply">', "stepped_shaft.ply"],
    ),
    "field missing": (
        COLD.replace("</integrator>", f"{AIR}</integrator>"),
        ["line ", "air.nc", "no such field"],
    ),
    "no camera": (COLD.replace(CAMERA, ""), ["no camera", '<sensor type="lens_camera">']),
    "no integrator": (COLD.replace(INTEGRATOR, ""), [STRAIGHT]),
    "other integrator": (COLD.replace(INTEGRATOR, '<integrator type="direct"/>'), [STRAIGHT]),
    "other camera": (
        COLD.replace(CAMERA, CAMERA_WITHOUT.replace("lens_camera", "orthographic")),
        ['is no <sensor type="lens_camera">'],
    ),
}


@pytest.mark.parametrize("fault", REFUSED)
def test_faulty_scene_is_refused_with_file_element_and_remedy(fault, tmp_path):
    """One line that a user can act on, and never Mitsuba's or Python's own trace."""
    text, expected = REFUSED[fault]
    path = tmp_path / "faulty.xml"
    path.write_text(text, encoding="utf-8")
    with pytest.raises(vs.InputError) as refusal:
        vs.load_scene(path)
    message = str(refusal.value)
    for word in (str(path), *expected):
        assert word in message
    assert "Traceback" not in message
    assert "\n" not in message


@pytest.mark.parametrize(
    ("name", "value", "expected"),
    [
        ("tempreature", 900, "no parameter 'tempreature'; the scene has: along"),
        ("temp", 900, "no parameter 'temp'"),
        ("temperature", -300, "below absolute zero"),
        ("temperature", "warm", "not a number"),
        ("temperature", 17, "no such field"),
        ("line_radius", -0.1, "'radius' must be a positive number"),
        ("line_length", "nan", "'length' must be a positive number"),
        ("line_length", "long", '"long" is no floating point value'),
        ("dots", "0; 1", "'dots' must list positions in mm"),
        ("step", 0, "step_mm is 0.0; give it positive"),
        ("method", "heun", "one of euler, rk4, sharma, leapfrog, dopri5"),
        ("precision", "half", "single, double"),
        ("width", -3, "width"),
    ],
)
def test_wrong_parameter_is_refused(name, value, expected):
    """Naming the scene, the parameter and what it may be."""
    with pytest.raises(vs.InputError, match=re.escape(expected)) as refusal:
        vs.load_scene("hot_cylinder", **{name: value})
    assert "hot_cylinder.xml" in str(refusal.value)


def test_unknown_scene_is_refused_with_those_that_exist():
    """A misspelt name is not a path."""
    with pytest.raises(vs.InputError, match=r"hot_cylindre.*cold_cylinder, .*hot_cylinder"):
        vs.load_scene("hot_cylindre")


def test_only_a_closed_cylinder_along_x_is_the_analytic_one(tmp_path):
    """A disk that is no end face must still block rays."""
    text = shipped_text("cold_cylinder")
    assert isinstance(vs.load_scene("cold_cylinder").surface, Cylinder)
    path = tmp_path / "other.xml"
    for end in ('<translate x="85" z="-13.5"/>', '<scale value="13.5"/>'):
        path.write_text(text.replace(end, '<translate x="80" z="-13.5"/>'), encoding="utf-8")
        assert isinstance(vs.load_scene(path).surface, SceneSurface)
