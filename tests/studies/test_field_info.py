"""What is told of a field: figures that are known beforehand come out, and so does the verdict."""

import json
import re

import cv2
import numpy as np
import pytest
from typer.testing import CliRunner

from virtual_sensor import cli
from virtual_sensor.errors import InputError
from virtual_sensor.imaging.scene import load_scene
from virtual_sensor.medium.index_field import IndexField
from virtual_sensor.medium.netcdf import GriddedQuantity, write_quantity
from virtual_sensor.optics.ray_search import ray_search
from virtual_sensor.studies.field_grid import Convergence, grid_losses, narrowest_structures
from virtual_sensor.studies.field_info import field_info
from virtual_sensor.studies.field_picture import draw_field
from virtual_sensor.studies.field_words import border_table, facts, figures, verdicts
from virtual_sensor.studies.probes import probe_rays

AMBIENT = 2.7e-4
LOW, HIGH = np.array([-120.0, -48.0, -36.0]), np.array([120.0, 48.0, 300.0])


def air(nodes, difference, low=LOW, high=HIGH, mirror=(False, False, False)):
    """Field of AMBIENT + difference(x, y, z) on so many nodes between two corners."""
    axes = [np.linspace(*ends) for ends in zip(low, high, nodes, strict=True)]
    x, y, z = np.meshgrid(*axes, indexing="ij")
    values = AMBIENT + difference(x, y, z) * np.ones(x.shape)
    spacing = (np.array(high) - low) / (np.array(nodes) - 1)
    return IndexField.from_arrays(values, low, spacing, ambient=AMBIENT, mirror=mirror)


@pytest.fixture
def stored(tmp_path):
    """Write a field; give its path."""

    def write(field, name="air.nc"):
        field.write(tmp_path / name)
        return tmp_path / name

    return write


def warm_sheet(x, y, z, half_width=12.0):
    """Air above the cylinder that is warm near y = 0 and fades towards all borders but below."""
    window = np.cos(0.5 * np.pi * x / 120.0) ** 2 * np.cos(0.5 * np.pi * (z + 36.0) / 336.0) ** 2
    return -5e-5 * window * np.exp(-np.log(2.0) * (y / half_width) ** 2)


def swaying_quantity():
    """Air of 300 K, at two instants 350 and 450 K in its middle; a quarter, by two mirrors."""
    values = np.full((2, 5, 6, 7), 300.0)
    values[0, :2, :2, 3], values[1, :2, :2, 3] = 350.0, 450.0
    return GriddedQuantity(
        kind="temperature",
        values=values,
        origin_mm=np.array([0.0, 0.0, -30.0]),
        spacing_mm=np.array([30.0, 10.0, 50.0]),
        time_s=np.array([2.0, 3.0]),
        ambient={"ambient_temperature": 300.0},
        mirror=(True, True, False),
        attributes={"title": "Air that sways", "history": "made for a test"},
    )


def test_what_the_file_holds_is_told(tmp_path):
    """Rationale: whose field, how large, when: in the file, and yet not seen by looking at it."""
    path = tmp_path / "swaying.nc"
    write_quantity(path, swaying_quantity())
    told = facts(field_info(path))
    assert re.match(rf"{path}, 0\.0\d MB, holds temperature", told["file"])
    assert (told["title"], told["history"]) == ("Air that sways", "made for a test")
    assert told["times"] == "2 from 2 to 3 s; what follows is at 3 s"
    assert told["grid"] == "5 x 6 x 7 nodes (x, y, z), spacing 30 x 10 x 50 mm"
    assert told["extent"].startswith("x -120 to 120, y -50 to 50, z -30 to 270 mm, mirror images")


@pytest.mark.parametrize(("time_s", "hottest_k"), [(None, 450.0), (2.0, 350.0), (2.5, 400.0)])
def test_the_temperatures_are_those_of_the_file_at_that_instant(tmp_path, time_s, hottest_k):
    """Rationale: n - 1 is told, but a temperature is what a user knows."""
    write_quantity(tmp_path / "swaying.nc", swaying_quantity())
    info = field_info(tmp_path / "swaying.nc", time_s=time_s)
    assert info.temperature_range_c == pytest.approx((26.85, hottest_k - 273.15), abs=0.01)


def test_thin_air_is_hot_air(stored):
    """Rationale: without any temperature in the file half of n - 1 still means twice 293.15 K."""
    field = air((5, 5, 5), lambda x, y, z: np.where(np.abs(y) < 1.0, -0.5 * AMBIENT, 0.0))
    assert field_info(stored(field)).temperature_range_c == pytest.approx((20.0, 313.15))


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
    assert y.nodes == pytest.approx(y.half_width_mm)  # of 1 mm
    assert (x.place_mm[0], y.place_mm[1]) == pytest.approx((0.0, 0.0), abs=1e-9)


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
    assert abs(found[True].place_mm[1]) == pytest.approx(wall)
    assert found[False].half_width_mm == pytest.approx(plume * np.sqrt(2.0 * np.log(2.0)), rel=0.01)


def test_what_a_grid_loses_is_what_a_finer_one_shows(stored):
    """Rationale: the loss is told without the finer grid; here there is one that knows it.

    It is to be a bound, as the observed order is still below the spline's.  Of few rays the largest
    loss may be another ray's on the finer grid.
    """
    fine, coarse = (air((17, n, 33), warm_sheet) for n in (65, 33))
    y = np.linspace(-10.0, 10.0, 81)
    true, told = (field_info(stored(f), y_mm=y).losses for f in (fine, coarse))
    for finer, coarser in zip(true, told, strict=True):
        if finer.axes == "y":
            assert 1.0 < coarser.pixel.present / finer.pixel.twice < 3.0
            assert 1.0 < coarser.rms.present / finer.rms.twice < 3.0
            assert finer.pixel.twice > 1e-4


def test_kinks_as_narrow_as_the_grid_are_found_out(stored):
    """Rationale: linear interpolation from a coarser mesh looks fine, and bends light in steps."""
    mesh = np.linspace(-48.0, 48.0, 29)

    def kinked(x, y, z):
        return np.interp(y, mesh, warm_sheet(0.0, mesh, -36.0)) / 5e-5 * -warm_sheet(x, 0.0, z)

    smooth, rough = (field_info(stored(air((17, 65, 33), f))) for f in (warm_sheet, kinked))
    by_axis = {loss.axes: loss.pixel for loss in rough.losses}
    assert not by_axis["y"].converges
    assert by_axis["x"].converges
    assert all(loss.pixel.converges for loss in smooth.losses)
    words = (
        "Along y every 4th node is hardly worse than every 2nd: the field has structures as narrow"
    )
    assert words in verdicts(rough)[1]
    assert words not in verdicts(smooth)[1]


def test_the_known_order_and_error_come_out():
    """Rationale: errors of C h^p give changes of C h^p (2^p - 1) and C h^p (4^p - 1)."""
    for p in (1.5, 2.0, 3.0):
        convergence = Convergence(0.3 * (2.0**p - 1.0), 0.3 * (4.0**p - 1.0))
        assert convergence.order == pytest.approx(p)
        assert convergence.present == pytest.approx(0.3)


@pytest.mark.parametrize(
    ("twice", "fourfold", "present"), [(0.3, 0.2, 0.3), (0.3, np.nan, 0.3), (0.7, 90.0, 0.1)]
)
def test_what_the_order_does_not_tell_is_not_made_small(twice, fourfold, present):
    """Rationale: without convergence all of the change may be lost; a gradient's order is 3."""
    assert Convergence(twice, fourfold).present == pytest.approx(present)


def test_axes_with_few_nodes_are_not_thinned():
    """Rationale: a spline takes four nodes; a field of a plane has no more along one axis."""
    losses = grid_losses(air((4, 33, 9), warm_sheet), None, False, None)
    known = {
        loss.axes: np.isfinite([loss.rms.twice, loss.rms.fourfold]).tolist() for loss in losses
    }
    assert known == {
        "x": [False, False],
        "y": [True, True],
        "z": [True, False],
        "xyz": [True, True],
    }


def test_a_jumps_effect_is_that_of_rays_traced_with_and_without_it(stored):
    """Rationale: told by Snell's law; traced in air that fades within 8 mm beyond the border.

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
    assert (face.jump, face.crossed_jump["camera"]) == pytest.approx((jump, jump), rel=1e-5)
    assert face.shift_px["camera"] == pytest.approx(traced, rel=0.05)
    assert 0.1 < traced < 0.3
    laser = next(face for face in info.faces if face.name == "x-")
    assert laser.shift_px["laser"] == pytest.approx(0.0, abs=1e-6)
    assert ("x+", "1.0e-05", "1.0e-05", f"camera {face.largest_px:.2g} px") in border_table(info)[1]


@pytest.mark.parametrize(
    ("jump", "verdict"), [(1e-8, "sound"), (5e-6, "tolerable"), (1e-4, "too close")]
)
def test_whether_the_border_matters_is_said(stored, jump, verdict):
    """Rationale: the same limits as those by which a measurement tells or refuses."""
    field = air((4, 4, 4), lambda x, y, z: jump)
    assert verdicts(field_info(stored(field)))[0].startswith(f"Border: {verdict}.")


@pytest.mark.parametrize(
    ("strength", "verdict"),
    [
        (0.2, "fine enough for 0.02 px:"),
        (1.0, "fine enough for 0.1 px but not for 0.02 px:"),
        (5.0, "not fine enough for 0.1 px:"),
    ],
)
def test_whether_the_grid_is_fine_enough_is_said(stored, strength, verdict):
    """Rationale: the answer to the question for which the figures are asked."""
    field = air((17, 25, 33), lambda *place: strength * warm_sheet(*place, half_width=10.0))
    assert verdicts(field_info(stored(field)))[1].startswith(f"Grid: {verdict}")


def test_the_effect_on_the_probe_rays_is_that_of_the_search(stored):
    """Rationale: hot minus cold, by the ray search that everything else is compared with."""
    field = air((17, 33, 33), warm_sheet)
    info = field_info(stored(field), "hot_cylinder", {"beta": "15"})
    scene = load_scene("hot_cylinder", beta=15)
    hot, cold = (
        ray_search(s, probe_rays(scene), "newton").pixel
        for s in (scene.with_medium(field), scene.cold())
    )
    np.testing.assert_allclose(info.effect_px, hot - cold, atol=1e-6)
    assert np.abs(info.effect_px).max() > 0.01


def test_a_field_that_suits_no_scene_is_told_of_all_the_same(stored, tmp_path):
    """Rationale: a field of another part is a field; what can't be said of it is said."""
    aside = np.array([0.0, 500.0, 0.0])
    field = air((9, 17, 9), warm_sheet, low=LOW + aside, high=HIGH + aside)
    info = field_info(stored(field))
    assert (info.scene, info.effect_px) == (None, None)
    assert "does not suit a scene (" in info.notes[0]
    assert "does not cover the light path" in info.notes[0]
    assert "neither the file nor a scene tells the solid" in info.notes[1]
    assert verdicts(info) == ["Grid: how much its loss is in px can't be told without light."]
    assert {row[2:] for row in border_table(info)[1]} == {("", "")}
    draw_field(info, tmp_path / "air.png")
    assert not light_in(tmp_path / "air.png")


def light_in(path):
    """Whether a picture shows the laser's light."""
    blue_green_red = cv2.imread(str(path)).astype(int)
    assert blue_green_red.shape[0] > 600 < blue_green_red.shape[1]
    return bool((np.abs(blue_green_red - [0x6A, 0xE0, 0x35]).max(axis=2) < 3).any())


def test_a_scene_that_is_asked_for_must_fit(stored):
    """Rationale: to leave out what was asked for would pass for an answer."""
    path = stored(air((9, 17, 9), warm_sheet, high=np.array([120.0, 5.0, 300.0])))
    with pytest.raises(InputError) as refused:
        field_info(path, "hot_cylinder")
    assert str(refused.value).startswith(f"{path}: does not suit the scene: ")
    assert "the laser meets the part at" in str(refused.value)


@pytest.mark.parametrize(
    ("content", "told"),
    [(None, "there is no such file"), (b"a picture", "is not a NetCDF-3 file")],
)
def test_what_is_no_field_is_named(tmp_path, content, told):
    """Rationale: one line with the file's name, before anything is drawn."""
    path = tmp_path / "air.nc"
    if content:
        path.write_bytes(content)
    ended = CliRunner().invoke(cli.app, ["field", "info", str(path), "-o", str(tmp_path / "a.png")])
    assert isinstance(ended.exception, InputError)
    assert str(ended.exception).startswith(f"{path}: ")
    assert told in str(ended.exception)
    assert not (tmp_path / "a.png").exists()


def test_the_command_tells_draws_and_writes(stored, tmp_path):
    """Rationale: the terminal for people, the picture for strangers, the file for programs."""
    path, picture, file = (
        stored(air((17, 17, 17), warm_sheet)),
        tmp_path / "a.png",
        tmp_path / "a.json",
    )
    command = ["field", "info", str(path), "-o", str(picture), "--json", str(file)]
    ended = CliRunner().invoke(cli.app, command, env={"COLUMNS": "120"}, catch_exceptions=False)
    for words in ("largest jump of n", "narrowest structure", "every 2nd", "Border: ", "Grid: "):
        assert words in ended.output
    assert light_in(picture)
    info = field_info(path)
    assert json.loads(file.read_text(encoding="utf-8")) == json.loads(json.dumps(figures(info)))
    assert sorted(p.name for p in tmp_path.iterdir()) == ["a.json", "a.png", "air.nc"]
    again = CliRunner().invoke(cli.app, command)
    assert "a.png: exists" in str(again.exception)


def test_even_air_can_be_drawn(stored, tmp_path):
    """Rationale: a field without any structure is where scales divide by zero."""
    draw_field(field_info(stored(air((5, 5, 5), lambda x, y, z: 0.0))), tmp_path / "even.png")
    assert light_in(tmp_path / "even.png")
