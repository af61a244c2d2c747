"""A field's figures: those that are known beforehand come out, and so does the verdict."""

import numpy as np
import pytest
import trimesh
from fields_of_air import AMBIENT, HIGH, LOW, air, swaying_quantity, warm_sheet

import virtual_sensor as vs
from virtual_sensor.errors import InputError
from virtual_sensor.imaging.scene import load_scene
from virtual_sensor.medium.netcdf import write_quantity
from virtual_sensor.optics.ray_search import ray_search
from virtual_sensor.poses import Pose
from virtual_sensor.studies.field_grid import Richardson, grid_losses, narrowest_structures
from virtual_sensor.studies.field_info import Border, Grid, field_info
from virtual_sensor.studies.probes import probe_rays


@pytest.fixture
def stored(tmp_path):
    """Write a field; give its path."""

    def write(field, name="air.nc"):
        field.write(tmp_path / name)
        return tmp_path / name

    return write


def test_what_the_file_holds_is_found(tmp_path):
    """Rationale: whose field, how large, when: in the file, and yet not seen by looking at it."""
    path = tmp_path / "swaying.nc"
    write_quantity(path, swaying_quantity())
    info = field_info(path)
    assert (info.file, info.quantity) == (path, "temperature")
    assert info.size_mb == pytest.approx(path.stat().st_size / 1e6)
    assert info.attributes["title"] == "Air that sways"
    assert info.attributes["history"] == "made for a test"
    assert (info.times_s.tolist(), info.time_s) == ([2.0, 3.0], 3.0)
    assert info.nodes == (5, 6, 7)
    assert info.spacing_mm.tolist() == [30.0, 10.0, 50.0]
    assert info.mirrored == (True, True, False)
    assert info.box_mm.tolist() == [[-120.0, -50.0, -30.0], [120.0, 50.0, 270.0]]


@pytest.mark.parametrize(("time_s", "hottest_k"), [(None, 450.0), (2.0, 350.0), (2.5, 400.0)])
def test_the_temperatures_are_those_of_the_file_at_that_instant(tmp_path, time_s, hottest_k):
    """Rationale: n - 1 is stored, but a temperature is what a user knows."""
    write_quantity(tmp_path / "swaying.nc", swaying_quantity())
    info = field_info(tmp_path / "swaying.nc", time_s=time_s)
    assert info.lowest_temperature_c == pytest.approx(26.85, abs=0.01)
    assert info.highest_temperature_c == pytest.approx(hottest_k - 273.15, abs=0.01)


def test_thin_air_is_hot_air(stored):
    """Rationale: without any temperature in the file half of n - 1 still means twice 293.15 K."""
    field = air((5, 5, 5), lambda x, y, z: np.where(np.abs(y) < 1.0, -0.5 * AMBIENT, 0.0))
    info = field_info(stored(field))
    found = info.lowest_temperature_c, info.highest_temperature_c
    assert found == pytest.approx((20.0, 313.15))


@pytest.mark.parametrize("mirrored", [False, True])
@pytest.mark.parametrize("sigma", [4.0, 9.0])
def test_the_narrowest_structure_is_a_plumes_half_width(mirrored, sigma):
    """Rationale: a Gaussian's is sqrt(2 ln 2) of its standard deviation, along y as along x."""

    def plume(x, y, z):
        return -1e-4 * np.exp(-((x / 40.0) ** 2 + (y / sigma) ** 2) / 2.0) * np.cos(z / 400.0)

    low = np.where([False, mirrored, False], 0.0, LOW)
    field = air((61, 49 if mirrored else 97, 8), plume, low=low, mirror=(False, mirrored, False))
    x, y = narrowest_structures(field, None)
    assert (x.axis, y.axis) == ("x", "y")
    assert x.half_width_mm == pytest.approx(np.sqrt(2.0 * np.log(2.0)) * 40.0, rel=0.01)
    assert y.half_width_mm == pytest.approx(np.sqrt(2.0 * np.log(2.0)) * sigma, rel=0.01)
    assert y.half_width_nodes == pytest.approx(y.half_width_mm)  # of 1 mm
    assert (x.peak_mm[0], y.peak_mm[1]) == pytest.approx((0.0, 0.0), abs=1e-9)


def test_the_wall_layer_is_told_apart(stored):
    """Rationale: it is the narrowest by far, and hardly matters to light that runs through it."""
    wall, layer, plume = 20.0, 3.0, 15.0

    def warm(x, y, z):
        at_wall = np.exp(-np.maximum(np.abs(y) - wall, 0.0) / layer) * (z < 0.0)
        return -1e-4 * (at_wall + np.exp(-(y**2) / (2.0 * plume**2)) * (z > 100.0))

    field = air((5, 193, 29), warm)
    places = LOW + np.indices(field.shape).reshape(3, -1).T * field.spacing
    solid = ((np.abs(places[:, 1]) < wall) & (places[:, 2] < 0.0)).reshape(field.shape)
    found = {s.at_wall: s for s in narrowest_structures(field, solid) if s.axis == "y"}
    assert found[True].half_width_mm == pytest.approx(layer * np.log(2.0), rel=0.03)
    assert abs(found[True].peak_mm[1]) == pytest.approx(wall)
    assert found[False].half_width_mm == pytest.approx(plume * np.sqrt(2.0 * np.log(2.0)), rel=0.01)


def test_what_a_grid_loses_is_what_a_finer_one_shows(stored):
    """Rationale: the loss is found without the finer grid; here there is one that knows it.

    It is to be a bound, as the observed order is still below the spline's.  Of few rays the largest
    loss may be another ray's on the finer grid.
    """
    fine, coarse = (air((17, n, 33), warm_sheet) for n in (65, 33))
    y = np.linspace(-10.0, 10.0, 41)
    true, found = (field_info(stored(f), y_mm=y).losses for f in (fine, coarse))
    for finer, coarser in zip(true, found, strict=True):
        if finer.axes == "y":
            assert 1.0 < coarser.shift_px.present / finer.shift_px.every_2nd < 3.0
            assert 1.0 < coarser.rms_refractivity.present / finer.rms_refractivity.every_2nd < 3.0
            assert finer.shift_px.every_2nd > 1e-4


def test_kinks_as_narrow_as_the_grid_are_found_out(stored):
    """Rationale: linear interpolation from a coarser mesh seems fine, and bends light in steps."""
    mesh = np.linspace(-48.0, 48.0, 29)

    def kinked(x, y, z):
        return np.interp(y, mesh, warm_sheet(0.0, mesh, -36.0)) / 5e-5 * -warm_sheet(x, 0.0, z)

    smooth, rough = (field_info(stored(air((17, 65, 33), f))) for f in (warm_sheet, kinked))
    by_axis = {loss.axes: loss.shift_px for loss in rough.losses}
    assert not by_axis["y"].converges
    assert by_axis["x"].converges
    assert all(loss.shift_px.converges for loss in smooth.losses)
    assert (rough.rough_axes, smooth.rough_axes) == (["y"], [])


def test_the_known_order_and_error_come_out():
    """Rationale: errors of C h^p give changes of C h^p (2^p - 1) and C h^p (4^p - 1)."""
    for p in (1.5, 2.0, 3.0):
        found = Richardson(0.3 * (2.0**p - 1.0), 0.3 * (4.0**p - 1.0))
        assert found.order == pytest.approx(p)
        assert found.present == pytest.approx(0.3)


@pytest.mark.parametrize(
    ("every_2nd", "every_4th", "present"), [(0.3, 0.2, 0.3), (0.3, np.nan, 0.3), (0.7, 90.0, 0.1)]
)
def test_what_the_order_does_not_tell_is_not_made_small(every_2nd, every_4th, present):
    """Rationale: without convergence all of the change may be lost; a gradient's order is 3."""
    assert Richardson(every_2nd, every_4th).present == pytest.approx(present)


def test_axes_with_few_nodes_are_not_thinned():
    """Rationale: a spline takes four nodes; a field of a plane has no more along one axis."""
    losses = grid_losses(air((4, 33, 9), warm_sheet), None, False, None)
    rms = {loss.axes: loss.rms_refractivity for loss in losses}
    known = {axes: np.isfinite([r.every_2nd, r.every_4th]).tolist() for axes, r in rms.items()}
    assert known == {
        "x": [False, False],
        "y": [True, True],
        "z": [True, False],
        "xyz": [True, True],
    }


def test_a_jumps_effect_is_that_of_rays_traced_with_and_without_it(stored):
    """Rationale: found by Snell's law; traced in air that fades within 8 mm beyond the border.

    n rises along x from the laser's side, where it has no jump, to the camera's.
    """
    jump = 1e-5

    def ramp(x, y, z):
        return jump * (x + 120.0) / 240.0

    def with_fade(x, y, z):
        fade = 0.5 + 0.5 * np.cos(np.pi * np.clip((x - 120.0) / 8.0, 0.0, 1.0))
        return np.where(x > 120.0, jump * fade, ramp(x, y, z))

    cut = air((121, 4, 4), ramp)
    faded = air((133, 4, 4), with_fade, high=np.array([144.0, 48.0, 300.0]))
    scene = load_scene("hot_cylinder")
    y = probe_rays(scene)
    pixels = [ray_search(scene.with_medium(f), y, "newton").pixel for f in (cut, faded)]
    traced = np.linalg.norm(pixels[1] - pixels[0], axis=1).max()

    info = field_info(stored(cut))
    face = next(face for face in info.faces if face.name == "x+")
    assert (face.largest_jump, face.camera_jump) == pytest.approx((jump, jump), rel=1e-5)
    assert face.camera_shift_px == pytest.approx(traced, rel=0.05)
    assert 0.1 < traced < 0.3
    laser = next(face for face in info.faces if face.name == "x-")
    assert laser.laser_shift_px == pytest.approx(0.0, abs=1e-6)
    assert np.isnan([laser.camera_jump, face.laser_jump]).all()


@pytest.mark.parametrize(
    ("jump", "verdict"),
    [(1e-8, Border.SOUND), (5e-6, Border.TOLERABLE), (1e-4, Border.TOO_CLOSE)],
)
def test_whether_the_border_matters_is_found(stored, jump, verdict):
    """Rationale: the same limits as those by which a measurement has a note, or is refused."""
    assert field_info(stored(air((4, 4, 4), lambda x, y, z: jump))).border == verdict


@pytest.mark.parametrize(
    ("strength", "verdict"), [(0.2, Grid.FINE), (1.0, Grid.FAIR), (5.0, Grid.TOO_COARSE)]
)
def test_whether_the_grid_is_fine_enough_is_found(stored, strength, verdict):
    """Rationale: the answer to the question for which the figures are asked."""
    field = air((17, 25, 33), lambda *place: strength * warm_sheet(*place, half_width=10.0))
    assert field_info(stored(field)).grid == verdict


def test_the_effect_on_the_probe_rays_is_that_of_the_search(stored):
    """Rationale: hot minus cold, by the ray search that everything else is compared with."""
    field = air((17, 33, 33), warm_sheet)
    info = field_info(stored(field), "hot_cylinder", {"beta": "15"})
    scene = load_scene("hot_cylinder", beta=15)
    hot, cold = (
        ray_search(s, probe_rays(scene), "newton").pixel
        for s in (scene.with_medium(field), scene.cold())
    )
    np.testing.assert_allclose(info.light.shift_px, hot - cold, atol=1e-6)
    shift = np.linalg.norm(hot - cold, axis=1)
    assert info.light.largest_shift_px == pytest.approx(shift.max(), abs=1e-6)
    assert info.light.largest_shift_px > 0.01
    assert shift[info.light.probe_y_mm == info.light.largest_shift_y_mm] == pytest.approx(
        shift.max(), abs=1e-6
    )


def test_the_angle_is_that_of_a_gradient_which_is_the_same_everywhere(stored):
    """Rationale: dn/dy = g turns light that runs square to y for a length L by g L."""
    gradient = 1e-7

    def slope(x, y, z):
        return gradient * y

    info = field_info(stored(air((4, 33, 4), slope)), y_mm=[0.0])
    sensor, points = info.scene.sensor, info.line.points_mm
    starts = sensor.laser.family.origins(points)
    inside = (points[:, 0] + 120.0) / (points - starts)[:, 0]  # it enters at x = -120 mm
    length = np.linalg.norm(points - starts, axis=1) * inside
    assert info.light.laser_angle_mrad == pytest.approx(1e3 * gradient * length.max(), rel=0.01)


def test_a_moved_field_loses_what_it_loses_at_rest(stored, tmp_path):
    """Rationale: a grid that moves along with its part is no finer and no coarser."""
    field = air((9, 33, 9), warm_sheet)
    moved = field.moved(Pose(np.roll(np.eye(3), 1, axis=0), np.array([30.0, 20.0, 10.0])))
    losses = [grid_losses(each, None, False, None) for each in (field, moved)]
    for one, other in zip(*losses, strict=True):
        assert other.largest_refractivity == pytest.approx(one.largest_refractivity, rel=1e-6)
        assert one.axes == "x" or one.largest_refractivity > 1e-9


def test_a_field_that_suits_no_scene_has_all_other_figures(stored):
    """Rationale: a field of another part is a field; what can't be found of it is noted."""
    aside = np.array([0.0, 500.0, 0.0])
    field = air((9, 17, 9), warm_sheet, low=LOW + aside, high=HIGH + aside)
    info = field_info(stored(field))
    assert (info.scene, info.light) == (None, None)
    assert "does not suit a scene (" in info.notes[0]
    assert "does not cover the light path" in info.notes[0]
    assert "neither the file nor a scene has the solid" in info.notes[1]
    assert (info.border, info.grid) == (Border.UNKNOWN, Grid.UNKNOWN)
    assert all(np.isnan([f.laser_jump, f.camera_jump]).all() for f in info.faces)


def test_a_scene_that_is_asked_for_must_fit(stored):
    """Rationale: to leave out what was asked for would pass for an answer."""
    path = stored(air((9, 17, 9), warm_sheet, high=np.array([120.0, 5.0, 300.0])))
    with pytest.raises(InputError) as refused:
        field_info(path, "hot_cylinder")
    assert str(refused.value).startswith(f"{path}: does not suit the scene: ")
    assert "the laser meets the part at" in str(refused.value)


def test_a_scene_of_a_mesh_has_its_own_field_examined(stored, tmp_path, monkeypatch):
    """Rationale: only the cylinder's were; what is solid there is found in the mesh."""
    monkeypatch.chdir(tmp_path)
    bar = trimesh.creation.box((64.0, 30.0, 22.0))
    bar.apply_translation((0.0, 0.0, -11.0))
    bar.export("bar.stl")
    stored(air((25, 25, 43), warm_sheet))
    scene = vs.new_scene("bar", part="bar.stl", field="air.nc", temperature_c=600.0)
    info = field_info(None, f"{scene}")
    assert info.file == tmp_path / "air.nc"
    assert info.light.largest_shift_px > 0.5
    low, high = info.field.origin, info.field.origin + info.solid.shape * info.field.spacing
    x, y, z = (np.arange(*ends) for ends in zip(low, high, info.field.spacing, strict=True))
    inside = [np.abs(x) < 32.0, np.abs(y) < 15.0, (z > -22.0) & (z < 0.0)]
    np.testing.assert_array_equal(info.solid, inside[0][:, None, None] & np.outer(*inside[1:]))
    assert "air.nc marks no solid" in info.notes[0]
    with pytest.raises(InputError, match="the scene has no field; name one"):
        field_info(None, "cold_cylinder")
