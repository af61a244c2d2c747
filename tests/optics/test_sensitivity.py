"""Forward derivatives of the line's place in the image: against differences, and closed forms."""

from dataclasses import dataclass, replace
from functools import cache
from typing import Any

import numpy as np
import oracles
import pytest
from artificial import HeldScene, paper_sensor
from scipy.interpolate import BarycentricInterpolator
from scipy.optimize import brentq
from scipy.spatial.transform import Rotation

import virtual_sensor as vs
from virtual_sensor import ray_search
from virtual_sensor.arrays import to_numpy, to_vectors
from virtual_sensor.devices.sensor import SensorModel
from virtual_sensor.engine import dr, mi
from virtual_sensor.errors import InputError
from virtual_sensor.imaging.scene_file import shipped_scenes
from virtual_sensor.medium.exact_fields import linear, selfoc
from virtual_sensor.medium.field_family import FieldFamily
from virtual_sensor.medium.index_field import IndexField
from virtual_sensor.metrology.line_peaks import Status
from virtual_sensor.optics.eikonal import bend, in_plane
from virtual_sensor.optics.ray_search import REFERENCE, SearchStatus
from virtual_sensor.optics.rays import March, Straight
from virtual_sensor.optics.sensitivity import laser_y_at, line_sensitivity
from virtual_sensor.optics.surfaces import Cylinder, NoSurface, SceneSurface
from virtual_sensor.poses import Pose

AGREEMENT = 1e-4  # of the largest derivative along the line
Y = np.linspace(-9.83, 9.64, 8)  # on no knot of the spline: its third derivative jumps there
FINE = March(0.025, "leapfrog")
"""Where a difference shows the steps: they begin at other places in it when the sensor moves."""
AXIS = np.array([0.0, 0.0, -13.5])  # a point on the cylinder's
BOTH = ("camera", "laser")


def turned(pose, turn_deg, pivot_mm, shift_mm):
    """A pose after a turn about a world point, and a shift; by SciPy's rotations."""
    turn = Rotation.from_rotvec(turn_deg, degrees=True).as_matrix()
    return Pose(turn @ pose.rotation, turn @ (pose.origin_mm - pivot_mm) + pivot_mm + shift_mm)


def moved(scene, parts, turn_deg=(0, 0, 0), pivot_mm=(0, 0, 0), shift_mm=(0, 0, 0)):
    """The scene with parts of its sensor moved."""
    motion = (np.array(x, float) for x in (turn_deg, pivot_mm, shift_mm))
    motion = tuple(motion)
    places = {
        name: part.with_pose(turned(part.pose, *motion)) if name in parts else part
        for name, part in (("camera", scene.sensor.camera), ("laser", scene.sensor.laser))
    }
    return replace(scene, sensor=SensorModel(**places))


@cache
def fields():
    """The shipped fields, by wall temperature."""
    folder = shipped_scenes() / "fields"
    return {
        float(t): IndexField.read(folder / f"hot_cylinder_{t}C_quarter.nc")
        for t in (900, 1100, 1250)
    }


@pytest.fixture(scope="module")
def family():
    return FieldFamily(fields())


@pytest.fixture(scope="module")
def scene(family):
    """The paper's, but with nothing left to symmetry: turned, and the laser fanned out."""
    paper = HeldScene(paper_sensor(fan_deg=6.0), family.fields[1250.0], Cylinder())
    return moved(paper, BOTH, (8.0, 1.0, 3.0), AXIS, (0.7, 0.4, -1.1))


@pytest.fixture(scope="module")
def exact(scene):
    return line_sensitivity(scene, Y, pivot_mm=(1.0, 2.0, 3.0))


def assert_agree(found, ends, step, march=REFERENCE):
    """Derivatives (N, 2) of the pixels that see the laser rays, against central differences."""
    plus, minus = (ray_search(end, Y, "newton", march=march) for end in ends)
    for each in (plus, minus):
        np.testing.assert_array_equal(each.status, SearchStatus.FOUND)
    expected = (plus.pixel - minus.pixel) / (2.0 * step)
    np.testing.assert_allclose(found, expected, rtol=0, atol=AGREEMENT * abs(expected).max())


# ------------------------------------------------------------------------------------------- pose


@pytest.mark.parametrize("axis", "xyz")
@pytest.mark.parametrize("body", ["camera", "laser", "sensor"])
def test_a_shift_of_the_sensor(scene, exact, body, axis):
    """Against the search from shifted poses, which knows no derivative by them; px per mm.

    Along the cylinder only the air sees the whole sensor's shift: that is 1000 times smaller.
    """
    parts = BOTH if body == "sensor" else (body,)
    e = 0.002
    shift = np.eye(3)["xyz".index(axis)] * e
    ends = [moved(scene, parts, shift_mm=s * shift) for s in (1, -1)]
    march = FINE if (body, axis) == ("sensor", "x") else REFERENCE
    assert_agree(exact.of_pixel[f"{body}_{axis}"], ends, e, march)


@pytest.mark.parametrize("axis", "xyz")
@pytest.mark.parametrize("body", ["camera", "laser", "sensor"])
def test_a_turn_of_the_sensor(scene, exact, body, axis):
    """Likewise about axes through the given pivot, by SciPy's rotations; px per degree."""
    parts = BOTH if body == "sensor" else (body,)
    e = 0.0005
    turn = np.eye(3)["xyz".index(axis)] * e
    ends = [moved(scene, parts, s * turn, (1.0, 2.0, 3.0)) for s in (1, -1)]
    assert_agree(exact.of_pixel[f"{body}_turn_{axis}"], ends, e)


def test_a_turn_about_the_cylinders_axis(scene, exact):
    """The paper's beta, as `<rotate x="1" angle="$beta"/>` counts it."""
    e = 0.0005
    ends = [moved(scene, BOTH, (s * e, 0, 0), AXIS) for s in (1, -1)]
    assert_agree(exact.of_pixel["beta"], ends, e)


def test_a_step_along_the_line(scene, exact):
    """d(u, v)/db in px per mm, against neighbouring laser rays."""
    e = 0.002
    plus, minus = (ray_search(scene, Y + s * e, "newton").pixel for s in (1, -1))
    expected = (plus - minus) / (2.0 * e)
    atol = AGREEMENT * abs(expected).max()
    np.testing.assert_allclose(exact.along_line, expected, rtol=0, atol=atol)


@pytest.mark.parametrize("name", ["camera_z", "laser_z", "sensor_y"])
def test_air_that_ends_before_it_has_faded(scene, name):
    """Rays of other starts enter it sooner or later: without that, 1e-3 of it is wrong."""
    field, low = scene.medium, 41  # nodes: up to z = 14 mm, where it is hot
    assert field.origin[2] + low * field.spacing[2] < 16.0
    where = {"ambient": field.ambient, "mirror": field.mirror}
    cut = IndexField.from_arrays(field.nodes[:, :, :low], field.origin, field.spacing, **where)
    assert cut.border_jump()[5] > 1e-4
    cropped, e = replace(scene, medium=cut), 0.002
    body, axis = name.split("_")
    shift = np.eye(3)["xyz".index(axis)] * e
    parts = BOTH if body == "sensor" else (body,)
    ends = [moved(cropped, parts, shift_mm=s * shift) for s in (1, -1)]
    assert_agree(line_sensitivity(cropped, Y, [name]).of_pixel[name], ends, e)


@pytest.mark.parametrize("parameter", ["camera_x", "laser_turn_y", "along_line"])
def test_through_a_lens_that_distorts(scene, parameter):
    """A tilted sensor behind a lens of four terms: pixels answer with its stretch, too."""
    terms = np.array([-0.9, 0.5, 1e-2, -2e-2, 0, 0, 0, 0, 0, 0, 0, 0, 0.05, -0.1])
    camera = replace(scene.sensor.camera, distortion=terms)
    bent = replace(scene, sensor=replace(scene.sensor, camera=camera))
    found = line_sensitivity(bent, Y)
    if parameter == "along_line":
        e = 0.002
        plus, minus = (ray_search(bent, Y + s * e, "newton").pixel for s in (1, -1))
        expected = (plus - minus) / (2.0 * e)
        atol = AGREEMENT * abs(expected).max()
        np.testing.assert_allclose(found.along_line, expected, rtol=0, atol=atol)
        return
    e = 0.0005 if "turn" in parameter else 0.002
    body, axis = parameter.split("_", 1)
    step = np.eye(3)["xyz".index(axis[-1])] * e
    moves = [(s * step, (0, 0, 0)) if "turn" in axis else ((0, 0, 0), s * step) for s in (1, -1)]
    ends = [moved(bent, (body,), turn, shift_mm=shift) for turn, shift in moves]
    assert_agree(found.of_pixel[parameter], ends, e)


# -------------------------------------------------------------------------------------------- air


def with_nodes(field, nodes):
    """The field with other values at its nodes."""
    where = {"ambient": field.ambient, "mirror": field.mirror}
    return IndexField.from_arrays(nodes, field.origin, field.spacing, **where)


def scaled(field, factor):
    """The field with another contrast to its surroundings."""
    return with_nodes(field, field.ambient + factor * (field.nodes - field.ambient))


def test_the_fields_scale(scene, exact):
    """Against the search in fields that were scaled node by node; px per unit."""
    e = 0.005
    ends = [replace(scene, medium=scaled(scene.medium, 1.0 + s * e)) for s in (1, -1)]
    assert_agree(exact.of_pixel["field_scale"], ends, e)
    assert abs(exact.of_pixel["field_scale"]).max() > 1.0  # px: there is something to agree on


def test_the_walls_temperature(scene, family):
    """Against the search in fields that SciPy interpolates between the shipped ones; px per K."""
    known = fields()
    between = BarycentricInterpolator(list(known), [f.nodes for f in known.values()])
    temperature_c, e = 1000.0, 2.0
    minus, at, plus = between([temperature_c - e, temperature_c, temperature_c + e])
    here = replace(scene, medium=family.at(temperature_c))
    np.testing.assert_allclose(here.medium.nodes, at, rtol=1e-12)
    variations = {"wall_temperature": family.derivative(temperature_c)}
    found = line_sensitivity(here, Y, [], variations=variations)
    assert list(found.of_pixel) == ["wall_temperature"]
    ends = [replace(scene, medium=with_nodes(known[900.0], nodes)) for nodes in (plus, minus)]
    assert_agree(found.of_pixel["wall_temperature"], ends, e)


# ----------------------------------------------------------------------------------- closed forms


@dataclass(frozen=True)
class Variation:
    """Derivative of an exact field's n by a parameter: d(n^2)/dp / 2n, and its gradient."""

    field: Any
    of_n_squared: Any  # (d(n^2)/dp, its gradient) at points

    box = np.array([[-1e3] * 3, [1e3] * 3])
    ambient = 0.0
    pose = None

    def lookup(self, precision):
        return self

    def delta_and_gradient(self, p):
        f, g = self.field.delta_and_gradient(p)
        n = 1.0 + f
        value, gradient = self.of_n_squared(p)
        return value / (2.0 * n), gradient / (2.0 * n) - g * (value / (2.0 * n * n))


STARTS = np.array([[-12.0, 3.0, 1.0], [-10.0, -4.0, 5.0], [-14.0, 0.5, -2.0]])
DIRECTIONS = oracles.unit([[1.0, 0.2, -0.1], [1.0, 0.0, 0.3], [1.0, -0.3, 0.2]])
PLANE_X = 25.0


def carried(field, variation, march):
    """Derivative (N, 3) in the plane x = PLANE_X, by a march that starts inside the field."""
    line = Straight.through(to_vectors(STARTS), to_vectors(DIRECTIONS), march)
    ends = in_plane(march.vector(1, 0, 0), PLANE_X - line.anchor.x)
    ray = bend(field, NoSurface(), line, march, remaining=ends, variations=(variation,))
    dr.eval(ray)
    w, T = to_numpy(ray.offset[1]), to_numpy(ray.tangent(line))
    return w - T * (w[:, :1] / T[:, :1])


def in_plane_of(path):
    """Where a closed-form path crosses the plane."""
    return path.position(brentq(lambda t: path.position(t)[0] - PLANE_X, 0.0, 100.0, xtol=1e-14))


def known(path_of, p, e):
    """Derivative (N, 3) of closed-form crossings, by differences of 8th-digit accuracy."""
    ends = [
        [in_plane_of(path_of(p + s * e, r, d)) for r, d in zip(STARTS, DIRECTIONS, strict=True)]
        for s in (1, -1)
    ]
    return (np.array(ends[0]) - np.array(ends[1])) / (2.0 * e)


@pytest.mark.parametrize(("method", "tolerance"), [("rk4", 1e-8), ("leapfrog", 1e-8)])
def test_a_parabola_follows_its_slope(method, tolerance):
    """n^2 = n0^2 + s g.r: from a start inside, the tangent's length changes with s as well."""
    g = np.array([0.004, -0.01, 0.006])
    field = linear(1.2, tuple(g.tolist()))
    variation = Variation(field, lambda p: (dr.dot(type(p)(*g.tolist()), p), type(p)(*g.tolist())))
    found = carried(field, variation, March(0.5, method))
    expected = known(lambda s, r, d: oracles.linear(1.2, s * g, r, d), 1.0, 1e-4)
    np.testing.assert_allclose(found, expected, rtol=0, atol=tolerance * abs(expected).max())


@pytest.mark.parametrize(
    ("method", "step", "tolerance"),
    [("rk4", 0.5, 1e-7), ("sharma", 0.5, 1e-7), ("leapfrog", 0.05, 3e-6)],
)
def test_a_fibres_swing_follows_its_strength(method, step, tolerance):
    """n^2 = n0^2 (1 - a^2 (y^2 + z^2)), by a: rays swing faster, and start with another n."""
    n0, a = 1.5, 0.03
    field = selfoc(n0, a)

    def by_a(p):
        across = type(p)(0.0, p.y, p.z)
        return -2.0 * n0**2 * a * dr.squared_norm(across), across * (-4.0 * n0**2 * a)

    found = carried(field, Variation(field, by_a), March(step, method))
    expected = known(lambda a, r, d: oracles.parabolic(n0, [0.0, n0 * a, n0 * a], r, d), a, 1e-6)
    np.testing.assert_allclose(found, expected, rtol=0, atol=tolerance * abs(expected).max())


def test_straight_light_follows_the_pinhole():
    """Cold, the camera's own shift moves pixels by K R^T dC alone, and the field by nothing."""
    cold = HeldScene(paper_sensor(), None, Cylinder())
    found = line_sensitivity(cold, Y)
    camera = cold.sensor.camera
    z = np.sqrt(13.5**2 - Y**2) - 13.5  # the laser's plane is z = -x tan(60 deg)
    local = camera.pose.to_local(np.column_stack([-z / np.tan(np.radians(60.0)), Y, z]))
    focal = camera.matrix[0, 0]
    for name, shift in zip("xyz", np.eye(3), strict=True):
        x, y, z = (-shift) @ camera.pose.rotation
        du = focal * (x / local[:, 2] - local[:, 0] * z / local[:, 2] ** 2)
        dv = focal * (y / local[:, 2] - local[:, 1] * z / local[:, 2] ** 2)
        expected = np.column_stack([du, dv])
        np.testing.assert_allclose(found.of_pixel[f"camera_{name}"], expected, atol=1e-9)
    np.testing.assert_array_equal(found.of_pixel["field_scale"], 0.0)
    np.testing.assert_allclose(found.of_pixel["sensor_x"], 0.0, atol=1e-9)


# ------------------------------------------------------------------------ the line in the image


@pytest.mark.parametrize(("name", "march"), [("beta", FINE), ("field_scale", REFERENCE)])
def test_the_centre_in_a_column_that_stays(scene, name, march):
    """Against the rows of the laser rays that the same columns see before and after; px per unit.

    The columns' laser rays are found with derivatives too, but that they are found is checked.
    """
    columns = [610.0, 733.0, 1160.5, 1430.25]
    e = 0.0005 if name == "beta" else 0.005
    rows = []
    for change in (e, -e):
        if name == "beta":
            end = moved(scene, BOTH, (change, 0, 0), AXIS)
        else:
            end = replace(scene, medium=scaled(scene.medium, 1.0 + change))
        u, v = ray_search(end, laser_y_at(end, columns, march), "newton", march=march).pixel.T
        np.testing.assert_allclose(u, columns, rtol=0, atol=1e-8)
        rows.append(v)
    expected = (rows[0] - rows[1]) / (2.0 * e)
    found = line_sensitivity(scene, laser_y_at(scene, columns), [name]).of_centre[name]
    np.testing.assert_allclose(found, expected, rtol=0, atol=AGREEMENT * abs(expected).max())


def test_a_column_beside_the_line_sees_no_laser_ray(scene):
    y = laser_y_at(scene, [10.0, 1000.0, 2040.0])
    np.testing.assert_array_equal(np.isfinite(y), [False, True, False])


@pytest.mark.slow
def test_the_detected_line_follows_too():
    """Rendered and detected: its row in each column moves by beta and by the field's scale.

    What is left is the noise of frames of 16 samples per pixel, and the lopsided line's own change:
    measured 0.5 % of the largest derivative by beta, 0.04 % by the scale.
    """
    options = {"width": 1024, "height": 1024, "precision": "double", "step": 0.5}
    at_5 = vs.load_scene("hot_cylinder", beta=5, **options)
    field, e = at_5.medium, {"beta": 0.04, "field_scale": 0.05}
    ends = {
        "beta": [vs.load_scene("hot_cylinder", beta=5 + s * e["beta"], **options) for s in (1, -1)],
        "field_scale": [
            at_5.with_medium(scaled(field, 1.0 + s * e["field_scale"])) for s in (1, -1)
        ],
    }
    columns = np.arange(270, 760)
    exact = line_sensitivity(at_5, laser_y_at(at_5, columns), ["beta", "field_scale"])
    for name, (plus, minus) in ends.items():
        lines = [vs.line_centres(vs.render(end)) for end in (plus, minus)]
        assert all(np.all(line.status[columns] == Status.OK) for line in lines)
        found = (lines[0].row - lines[1].row)[columns] / (2.0 * e[name])
        expected = exact.of_centre[name]
        np.testing.assert_allclose(found, expected, rtol=0, atol=0.01 * abs(expected).max())


# -------------------------------------------------------------------------------- other surfaces


def mitsubas_cylinder():
    """The tube of the paper's cylinder as a Mitsuba shape."""
    shape = {"type": "cylinder", "p0": [-85, 0, -13.5], "p1": [85, 0, -13.5], "radius": 13.5}
    return SceneSurface(mi.load_dict({"type": "scene", "part": shape}))


def test_mitsubas_shapes_do_as_well(scene, exact):
    """The same cylinder in Mitsuba's float32: its normals are good to 1e-6."""
    here = replace(scene, surface=mitsubas_cylinder())
    found = line_sensitivity(here, Y, pivot_mm=(1.0, 2.0, 3.0))
    assert "beta" not in found.of_pixel  # it has no axis to know of
    for name, expected in exact.of_pixel.items():
        if name != "beta":
            atol = 1e-5 * max(1.0, abs(expected).max())
            np.testing.assert_allclose(found.of_pixel[name], expected, rtol=0, atol=atol)


def test_an_end_face_has_a_normal_of_its_own():
    """A laser ray along the axis meets it: shifts across move the point, a shift along does not."""
    paper = paper_sensor()
    pose = Pose(
        np.array([[0.0, 0.0, -1.0], [0.0, 1.0, 0.0], [1.0, 0.0, 0.0]]), np.array([300.0, 0, -5])
    )
    camera = replace(
        paper.camera, pose=replace(paper.camera.pose, origin_mm=np.array([235.0, 0, 254.8]))
    )
    cold = HeldScene(
        replace(paper, camera=camera, laser=paper.laser.with_pose(pose)), None, Cylinder()
    )
    found = line_sensitivity(cold, [0.5], ["laser_x", "laser_y", "laser_z"])
    np.testing.assert_allclose(found.laser_point_mm, [[85.0, 0.5, -5.0]], atol=1e-9)
    project = camera.project
    for name, moves in (("laser_x", [0, 0, 0]), ("laser_y", [0, 1, 0]), ("laser_z", [0, 0, 1])):
        e = 1e-4 * np.array(moves)
        by = (project(found.laser_point_mm + e) - project(found.laser_point_mm - e)) / 2e-4
        np.testing.assert_allclose(found.of_pixel[name], by, atol=1e-5)


@pytest.mark.parametrize("surface", [Cylinder(), "Mitsuba's"], ids=["cylinder", "shapes"])
def test_a_ray_that_misses_has_no_derivative(scene, surface):
    """NaN with a status, and its neighbour goes undisturbed."""
    surface = surface if isinstance(surface, Cylinder) else mitsubas_cylinder()
    found = line_sensitivity(replace(scene, surface=surface), [-4.0, 20.0])
    np.testing.assert_array_equal(found.status, [SearchStatus.FOUND, SearchStatus.LASER_MISSED])
    for by in (*found.of_pixel.values(), found.along_line, *found.of_centre.values()):
        assert np.all(np.isfinite(by[0]))
        assert np.all(np.isnan(by[1]))


def test_what_cannot_vary_is_refused(scene, family):
    with pytest.raises(InputError, match="no parameter 'gamma'; there are: camera_x"):
        line_sensitivity(scene, Y, ["gamma"])
    air = {"wall_temperature": family.derivative(1000.0)}
    with pytest.raises(InputError, match="no field that could vary"):
        line_sensitivity(replace(scene, medium=None), Y, [], variations=air)
