"""Points through bent light with their derivatives: against searches, tables and differences."""

from dataclasses import dataclass, replace
from functools import cache, partial
from types import SimpleNamespace
from typing import Any

import numpy as np
import pytest
from artificial import HeldScene, paper_sensor
from oracles import unit
from scipy.spatial.transform import Rotation

import virtual_sensor as vs
from virtual_sensor.devices.sensor import SensorModel
from virtual_sensor.errors import InputError
from virtual_sensor.imaging.scene_file import shipped_scenes
from virtual_sensor.medium.exact_fields import hot_spot
from virtual_sensor.medium.field_family import FieldFamily
from virtual_sensor.medium.index_field import IndexField
from virtual_sensor.metrology.triangulation import triangulated_points
from virtual_sensor.optics.bent_points import bent_points
from virtual_sensor.optics.crossing_status import CrossingStatus
from virtual_sensor.optics.crossings import crossings
from virtual_sensor.optics.field_border import cover_words
from virtual_sensor.optics.ray_families import Pinhole, Sheet
from virtual_sensor.optics.surfaces import Cylinder, NoSurface
from virtual_sensor.poses import Pose

Y = np.linspace(-9.83, 9.64, 8)  # on no knot of the spline
AXIS = np.array([0.0, 0.0, -13.5])
PIVOT = np.array([1.0, 2.0, 3.0])
TILTED_LENS = np.array([-0.9, 0.5, 1e-2, -2e-2, 0, 0, 0, 0, 0, 0, 0, 0, 0.05, -0.1])
AGREEMENT = 1e-4  # of the largest derivative, where a difference shows steps and knots


@cache
def family():
    folder = shipped_scenes() / "fields"
    names = {float(t): f"hot_cylinder_{t}C_quarter.nc" for t in (900, 1100, 1250)}
    return FieldFamily({t: IndexField.read(folder / name) for t, name in names.items()})


def turned(pose, turn_deg, pivot_mm, shift_mm):
    """A pose after a turn about a world point, and a shift; by SciPy's rotations."""
    turn = Rotation.from_rotvec(turn_deg, degrees=True).as_matrix()
    return Pose(turn @ pose.rotation, turn @ (pose.origin_mm - pivot_mm) + pivot_mm + shift_mm)


def moved(scene, parts, turn_deg=(0.0, 0.0, 0.0), pivot_mm=PIVOT, shift_mm=(0.0, 0.0, 0.0)):
    """The scene with parts of its sensor moved."""
    bodies = {"camera": scene.sensor.camera, "laser": scene.sensor.laser}
    for name in parts:
        pose = turned(bodies[name].pose, turn_deg, pivot_mm, np.asarray(shift_mm))
        bodies[name] = bodies[name].with_pose(pose)
    return replace(scene, sensor=SensorModel(**bodies))


@cache
def held(kind="upright"):
    """The paper's scene; turned with nothing left to symmetry; or behind a lens that distorts."""
    scene = HeldScene(paper_sensor(fan_deg=6.0), family().fields[1250.0], Cylinder())
    if kind == "upright":
        return scene
    scene = moved(scene, ("camera", "laser"), (8.0, 1.0, 3.0), AXIS, (0.7, 0.4, -1.1))
    if kind == "turned":
        return scene
    camera = replace(scene.sensor.camera, distortion=TILTED_LENS)
    return replace(scene, sensor=replace(scene.sensor, camera=camera))


def moved_air(scene):
    """A scene whose field, a mirrored quarter, is turned and moved against the world's axes."""
    turn = Rotation.from_rotvec([0.0, 0.0, 4.0], degrees=True).as_matrix()
    pose = Pose(turn, np.array([2.0, 0.8, -0.3]))
    return replace(scene, medium=replace(scene.medium, pose=pose))


@pytest.mark.parametrize("kind", ["upright", "turned", "lens", "moved air", "cold"])
def test_searched_pixels_give_back_their_points(kind):
    """Newton's search goes from the source to the pixel: it shares no step with the way back."""
    scene = (
        moved_air(held()) if kind == "moved air" else held("lens" if kind == "lens" else "turned")
    )
    scene = replace(scene, medium=None) if kind == "cold" else scene
    seen = vs.ray_search(scene, Y, "newton")
    found = bent_points(scene, seen.pixel)
    assert (found.status == CrossingStatus.OK).all()
    np.testing.assert_allclose(found.point_mm, seen.laser_point_mm, rtol=0, atol=2e-8)
    np.testing.assert_allclose(found.along_mm, Y, rtol=0, atol=2e-8)


def difference(change, e, pixel, **options):
    """Central differences of points and t, of scenes changed by +e and -e."""
    plus, minus = (bent_points(change(x), pixel, **options) for x in (e, -e))
    return (plus.point_mm - minus.point_mm) / (2 * e), (plus.along_mm - minus.along_mm) / (2 * e)


def assert_agrees(of_point, of_along, expected, agreement=AGREEMENT):
    for found, known in zip((of_point, of_along), expected, strict=True):
        scale = np.abs(expected[0]).max()
        np.testing.assert_allclose(found, known, rtol=0, atol=agreement * scale)


@pytest.mark.parametrize("kind", ["turned", "lens"])
def test_derivatives_by_pixel_and_coordinate(kind):
    """Against differences; what decoded columns lie on is a plane beside the laser's middle."""
    scene = held(kind)
    pixel, e = vs.ray_search(scene, Y, "newton").pixel, 0.01
    found = bent_points(scene, pixel, coordinate=0.4)
    for i, step in enumerate(np.eye(2)):
        ends = [bent_points(scene, pixel + x * step, coordinate=0.4) for x in (e, -e)]
        known = [(a - b) / (2 * e) for a, b in zip(*map(values, ends), strict=True)]
        assert_agrees(found.point_by_pixel[..., i], found.along_by_pixel[:, i], known)
    ends = [bent_points(scene, pixel, coordinate=0.4 + x) for x in (e, -e)]
    known = [(a - b) / (2 * e) for a, b in zip(*map(values, ends), strict=True)]
    assert_agrees(found.point_by_coordinate, found.along_by_coordinate, known)


def values(found):
    return found.point_mm, found.along_mm


@pytest.mark.parametrize("body", ["camera", "laser", "sensor"])
def test_derivatives_by_the_pose(body):
    """Shifts and turns about a pivot, by SciPy's rotations; and beta about the cylinder's axis."""
    scene, parts = held("turned"), ("camera", "laser") if body == "sensor" else (body,)
    pixel = vs.ray_search(scene, Y, "newton").pixel
    names = [f"{body}_{turn}{axis}" for turn in ("", "turn_") for axis in "xyz"]
    found = bent_points(scene, pixel, [*names, "beta"], pivot_mm=PIVOT)

    def changed(x, name):
        how = "turn_deg" if "turn" in name else "shift_mm"
        return moved(scene, parts, **{how: x * np.eye(3)["xyz".index(name[-1])]})

    for name in names:
        known = difference(partial(changed, name=name), 1e-3, pixel)
        assert_agrees(found.point_by[name], found.along_by[name], known, 3 * AGREEMENT)
    known = difference(lambda x: moved(scene, parts, (x, 0, 0), AXIS), 1e-3, pixel)
    if body == "sensor":
        assert_agrees(found.point_by["beta"], found.along_by["beta"], known)


def test_derivatives_by_the_air():
    """Its scale, and its wall's temperature by a family; a mirrored quarter field that is moved.

    Of every other node, which is quicker, and as good for a difference.
    """
    thinned = FieldFamily(
        {
            t: IndexField.from_arrays(
                field.nodes[::2, ::2, ::2],
                field.origin,
                2 * np.asarray(field.spacing),
                ambient=field.ambient,
                mirror=field.mirror,
            )
            for t, field in family().fields.items()
        }
    )
    t, upright = 1180.0, held()
    scene = moved_air(replace(upright, medium=thinned.at(t)))
    pose, field = scene.medium.pose, scene.medium
    pixel = vs.ray_search(scene, Y, "newton").pixel
    variations = {"temperature": replace(thinned.derivative(t), pose=pose)}
    found = bent_points(scene, pixel, ["field_scale"], variations=variations)

    def warmer(x):
        return replace(scene, medium=replace(thinned.at(t + x), pose=pose))

    def scaled(x):
        nodes = field.nodes + x * (field.nodes - field.ambient)
        return replace(scene, medium=field.with_nodes(nodes))

    for name, change, e in (("temperature", warmer, 1.0), ("field_scale", scaled, 1e-3)):
        known = difference(change, e, pixel)
        assert_agrees(found.point_by[name], found.along_by[name], known)


def test_the_tables_agree():
    """The maps of triangulation, and their differences by the pixel, on the scene that ships."""
    scene = vs.load_scene("hot_cylinder", beta=30)
    pixel, e = vs.ray_search(scene, Y, "newton").pixel, 0.5
    found = bent_points(scene, pixel)
    options = {"medium": scene.medium, "tolerance_px": 1e-5}
    tabulated = triangulated_points(scene, pixel, **options)
    np.testing.assert_allclose(found.point_mm, tabulated.point_mm, rtol=0, atol=1e-6)
    for i, step in enumerate(np.eye(2)):
        plus, minus = (
            triangulated_points(scene, pixel + x * step, **options).point_mm for x in (e, -e)
        )
        known = (plus - minus) / (2 * e)
        atol = 1e-4 * np.abs(known).max()
        np.testing.assert_allclose(found.point_by_pixel[..., i], known, rtol=0, atol=atol)


def test_a_start_close_by_leads_to_the_same():
    scene = held("turned")
    pixel = vs.ray_search(scene, Y, "newton").pixel
    found = bent_points(scene, pixel, ["beta"])
    near = found.point_mm + np.random.default_rng(1).normal(0.0, 0.1, found.point_mm.shape)
    near[3] = np.nan
    far = near + np.array([0.0, 20.0, 0.0])
    for start in (near, far):
        for along in (None, found.along_mm + 0.01):
            again = bent_points(scene, pixel, ["beta"], start_mm=start, start_along_mm=along)
            np.testing.assert_allclose(again.point_mm, found.point_mm, rtol=0, atol=1e-7)
            by, known = again.point_by["beta"], found.point_by["beta"]
            np.testing.assert_allclose(by, known, rtol=0, atol=1e-5)


def test_lost_pixels_have_no_point_and_disturb_no_other():
    """NaN with a status; no pixel at all and a single one are lists as well."""
    scene = held("turned")
    pixel = np.vstack([vs.ray_search(scene, Y, "newton").pixel, [np.nan, 5.0], [np.inf, 0.0]])
    found = bent_points(scene, pixel, ["field_scale"])
    np.testing.assert_array_equal(found.status[-2:], CrossingStatus.NO_PIXEL)
    assert (found.status[:-2] == CrossingStatus.OK).all()
    for value in (found.point_mm, found.point_by_pixel, found.point_by["field_scale"]):
        assert np.isfinite(value[:-2]).all()
        assert np.isnan(value[-2:]).all()
    one = bent_points(scene, pixel[:1], ["field_scale"])
    np.testing.assert_allclose(one.point_mm, found.point_mm[:1], rtol=0, atol=1e-9)
    none = bent_points(scene, np.empty((0, 2)), ["field_scale"])
    assert none.point_by["field_scale"].shape == (0, 3)


def test_what_cannot_be_asked_is_refused():
    scene = held()
    pixel = np.full((2, 2), 1000.0)
    for options, said in (
        ({"parameters": ["width"]}, "no parameter 'width'"),
        ({"coordinate": [0.0, 1.0, 2.0]}, "coordinate has shape"),
        ({"start_mm": np.zeros((3, 3))}, "start_mm has shape"),
        (
            {"start_mm": np.zeros((len(pixel), 3)), "start_along_mm": np.zeros(3)},
            "start_along_mm has shape",
        ),
    ):
        with pytest.raises(InputError, match=said):
            bent_points(scene, pixel, **options)
    with pytest.raises(InputError, match="pixel has shape"):
        bent_points(scene, pixel.T[:1].T)
    cold = replace(scene, medium=None)
    with pytest.raises(InputError, match="no field that could vary"):
        bent_points(cold, pixel, variations={"width": scene.medium})


# ------------------------------------------------------------------------------------- statuses


@dataclass(frozen=True)
class Pair:
    """A camera and a source's rays in a medium, with no part."""

    camera: Any
    source: Any
    medium: Any
    surface = NoSurface()


def pair(camera, family, medium):
    return Pair(camera, SimpleNamespace(family=family), medium)


def looking_at_origin(origin, beside=(0.0, 1.0, 0.0)):
    z = -unit(origin)
    x = unit(np.cross(beside, z))
    return Pose(np.stack([x, np.cross(z, x), z], axis=1), np.asarray(origin, float))


def both_ways(scene, pixel):
    """Statuses of the marched and of the tabulated points."""
    field, camera, family = scene.medium, scene.camera, scene.source.family
    tabulated = crossings(field, camera, family, pixel, np.zeros(len(pixel)), 1e-2)
    found = bent_points(scene, pixel)
    assert np.isnan(found.point_mm[found.status != CrossingStatus.OK]).all()
    return found.status, tabulated.status


def test_beyond_a_caustic_no_point_is_made_up():
    """A ball lens turns the source's rays over, or the lines of sight: several may meet there."""
    lens = hot_spot(-0.5, 8.0, box=np.array([[-60.0] * 3, [60.0] * 3]))
    sheet = Sheet(looking_at_origin((0.0, 0.0, 140.0)), 140.0)
    matrix = np.array([[500.0, 0.0, 64.0], [0.0, 500.0, 64.0], [0.0, 0.0, 1.0]])
    view = Pinhole(matrix, looking_at_origin((200.0, 0.0, -60.0)), (128, 128))
    y = np.linspace(-0.2, 0.2, 5)
    for z, expected in ((30.0, CrossingStatus.OK), (-50.0, CrossingStatus.FOLDED)):
        pixel = view.project(np.column_stack([0.0 * y, y, 0.0 * y + z]))
        for status in both_ways(pair(view, sheet, lens), pixel):
            np.testing.assert_array_equal(status, expected)
    through = Pinhole(matrix, looking_at_origin((0.0, 0.0, 140.0), (1.0, 0.0, 0.0)), (128, 128))
    beside = Sheet(
        Pose(looking_at_origin((200.0, 0.0, 0.0)).rotation, np.array([200.0, 0.0, -110.0])), 200.0
    )
    pixel = through.project(np.column_stack([0.0 * y, y, 0.0 * y - 110.0]))
    found = bent_points(pair(through, beside, lens), pixel)
    np.testing.assert_array_equal(found.status, CrossingStatus.FOLDED)


def test_a_field_that_ends_too_early_is_told():
    """Cut where it is hot it would leave 77 um, with no word; cut above, it corrects."""
    scene, field = held(), held().medium
    pixel = vs.ray_search(scene, Y, "newton").pixel
    for nodes, expected in ((134, CrossingStatus.UNCOVERED), (201, CrossingStatus.OK)):
        cut = replace(scene, medium=field.with_nodes(field.nodes[:, :, :nodes]))
        for status in both_ways(cut, pixel):
            np.testing.assert_array_equal(status, expected)
        assert (way_not_held(scene, cut.medium, pixel) == "") == (expected == CrossingStatus.OK)
    cut = field.with_nodes(field.nodes[:, :, :134])
    assert "it ends on the camera's side" in way_not_held(scene, cut, pixel)
    short = field.with_nodes(field.nodes[:, :, 30:], [*field.origin[:2], field.origin[2] + 37.5])
    for status in both_ways(replace(scene, medium=short), pixel):  # begins above the part
        np.testing.assert_array_equal(status, CrossingStatus.UNCOVERED)
    assert "it ends before 8 of 8 points" in way_not_held(scene, short, pixel)
    far = replace(field, pose=Pose(np.eye(3), np.array([0.0, 1000.0, 0.0])))
    for status in both_ways(replace(scene, medium=far), pixel):
        np.testing.assert_array_equal(status, CrossingStatus.OK)


def way_not_held(scene, field, pixel):
    points = bent_points(replace(scene, medium=None), pixel).point_mm
    return cover_words(field, scene.camera, scene.source.family, points)


def test_lines_of_sight_that_meet_no_ray_ahead():
    """Beside the sheet, and behind the camera."""
    scene = vs.load_scene("hot_cylinder")
    good = vs.ray_search(scene, [1.0], "newton").pixel[0]
    ahead = scene.camera.pose.origin_mm + 300.0 * scene.source.pose.rotation[:, 2]
    parallel = scene.camera.project(ahead[None])[0]
    marched, tabulated = both_ways(scene, np.array([good, 2.0 * parallel - good]))
    np.testing.assert_array_equal(marched, [CrossingStatus.OK, CrossingStatus.BEHIND])
    np.testing.assert_array_equal(tabulated, marched)
