"""Field files: packing, missing values and limits as CF says, and fields that cannot be."""

import numpy as np
import pytest
from command_line import command
from scipy.io import netcdf_file

from virtual_sensor.errors import InputError
from virtual_sensor.imaging.scene import load_scene
from virtual_sensor.imaging.scene_file import shipped_scenes
from virtual_sensor.medium import netcdf
from virtual_sensor.medium.index_field import IndexField
from virtual_sensor.medium.netcdf import read_field_file

SHAPE = (5, 4, 6)
T = 300.0 + np.arange(np.prod(SHAPE)).reshape(SHAPE)
X = np.arange(5) * 2.0
STEP, OFFSET = 0.01, 290.0


def written(path, values=T, kind="f8", name="temperature", x=X, file=(), axis=(), **attributes):
    """A small field; attributes of its variable, of its file and of its axis x."""
    with netcdf_file(path, "w", version=2) as nc:
        for key, nodes in (("x", np.asarray(x)), ("y", np.arange(4.0)), ("z", np.arange(6.0))):
            nc.createDimension(key, len(nodes))
            coordinate = nc.createVariable(key, nodes.dtype.str[1:], (key,))
            coordinate[:] = nodes
            coordinate.units = "mm"
            for more, value in dict(axis).items() if key == "x" else ():
                setattr(coordinate, more, value)
        variable = nc.createVariable(name, kind, ("x", "y", "z"))
        variable[:] = values
        for key, value in ({"units": "K"} | attributes).items():
            setattr(variable, key, value)
        for key, value in dict(file).items():
            setattr(nc, key, value)
    return path


def temperatures(path):
    """By the ideal gas, of the file's n - 1; K."""
    f = read_field_file(path, 532.0)
    return f.ambient * 293.15 / f.refractivity


def packed():
    return np.rint((T - OFFSET) / STEP)


PACKING = {"scale_factor": STEP, "add_offset": OFFSET}
HOLE = (2, 1, 3)


def with_hole(array, value):
    array = np.array(array)
    array[HOLE] = value
    return array


@pytest.mark.parametrize(
    ("kind", "values", "attributes"),
    [
        ("i2", packed(), PACKING),
        ("i2", (packed() + 30000).astype("u2").view("i2"),
         {"scale_factor": STEP, "add_offset": OFFSET - 300.0, "_Unsigned": "true"}),
        ("i1", (T - 300.0).astype("u1").view("i1"), {"add_offset": 300.0, "_Unsigned": "true"}),
        ("i4", packed(), PACKING),
        ("f4", T, {}),
        ("f8", T - 273.15, {"units": "celsius"}),
        ("f8", T, {"units": "Kelvin"}),
        ("f8", T - 273.15, {"units": "degrees_Celsius"}),
    ],
)  # fmt: skip
def test_the_values_are_those_of_their_packing(kind, values, attributes, tmp_path):
    """Rationale: an unsigned short read as signed was wrong by 1.4 of the ambient."""
    path = written(tmp_path / "a.nc", values, kind, **attributes)
    np.testing.assert_allclose(temperatures(path), T, atol=1e-3)


@pytest.mark.parametrize(
    ("kind", "values", "attributes"),
    [
        ("f8", with_hole(T, np.nan), {}),
        ("f8", with_hole(T, -1.0), {"_FillValue": -1.0}),
        ("f4", with_hole(T, 1e20), {"_FillValue": 1e20}),
        ("f8", with_hole(T, -2.0), {"missing_value": np.array([-1.0, -2.0])}),
        ("f8", with_hole(T, 9.969209968386869e36), {}),
        ("i4", with_hole(packed(), -2147483647), PACKING),
        ("i2", with_hole(packed(), -32000),
         PACKING | {"valid_range": np.array([-31000, 31000], "i2")}),
        ("i2", with_hole(packed(), 32000), PACKING | {"valid_max": np.int16(31000)}),
        ("i2", with_hole(packed(), -32000), PACKING | {"valid_min": np.int16(0)}),
        ("i2", with_hole(packed(), 32000), PACKING | {"valid_range": np.array([280.0, 600.0])}),
        ("i2", with_hole(packed() + 30000, 65535).astype("u2").view("i2"),
         {"scale_factor": STEP, "add_offset": OFFSET - 300.0, "_Unsigned": "true",
          "valid_range": np.array([0, 65534], "u2").view("i2")}),
        ("f8", with_hole(T, 5000.0), {"valid_max": 4000.0}),
    ],
)  # fmt: skip
def test_what_is_not_valid_is_no_data(kind, values, attributes, tmp_path):
    """Rationale: a fill value taken for air bends light as nothing does."""
    path = written(tmp_path / "a.nc", values, kind, **attributes)
    with np.errstate(invalid="ignore"):
        found = temperatures(path)
    np.testing.assert_array_equal(np.argwhere(np.isnan(found)), [HOLE])
    known = np.isfinite(found)
    np.testing.assert_allclose(found[known], T[known], atol=2e-3)
    with pytest.raises(InputError, match=r"1 nodes have no finite value, the first is \[2, 1, 3\]"):
        IndexField.read(path)


def test_packed_coordinates_are_unpacked(tmp_path):
    """Rationale: CF packs coordinates as it packs everything."""
    axis = {"scale_factor": 0.5, "add_offset": -3.0}
    path = written(tmp_path / "a.nc", x=np.arange(5, dtype="i2"), axis=axis)
    field = IndexField.read(path)
    assert (field.origin[0], field.spacing[0]) == (-3.0, 0.5)


DENSITY = {"name": "density", "values": 1.1, "units": "kg/m3"}
INDEX = {"name": "refractivity", "values": 2e-4, "units": "1"}


@pytest.mark.parametrize(
    ("changes", "match"),
    [
        ({"values": b"a", "kind": "c"}, "'temperature' holds text, no numbers"),
        ({"x": np.array([b"a", b"b", b"c", b"d", b"e"])}, "'x' holds text, no numbers"),
        ({"_FillValue": np.array([1.0, 2.0])}, "'_FillValue' must be one number"),
        ({"missing_value": "none"}, "'missing_value' must be numbers"),
        ({"valid_range": 3.0}, "'valid_range' must be 2 numbers"),
        ({"scale_factor": np.array([1.0, 2.0])}, "'scale_factor' must be a number, not '1.0, 2.0'"),
        ({"scale_factor": 0.0}, "its scale_factor is 0"),
        ({"fill_value_means": "solid"}, "and has no _FillValue; give it one"),
        ({"ambient_pressure": np.array([], "f8")}, "'ambient_pressure' must be a number"),
        ({"ambient_pressure": -5.0}, "'ambient_pressure' is -5 Pa, outside"),
        ({"ambient_temperature": 1e9}, "'ambient_temperature' is 1e.09 K, outside"),
        (DENSITY | {"ambient_density": -1.0}, "'ambient_density' is -1 kg/m3, outside"),
        (DENSITY | {"ambient_density": 3e38}, "'ambient_density' is 3e.38 kg/m3, outside"),
        (INDEX | {"ambient_refractivity": -0.5}, "'ambient_refractivity' is -0.5, outside"),
        (INDEX | {"ambient_refractivity": 1e9}, "'ambient_refractivity' is 1e.09, outside"),
        ({"file": {"mirror_planes": "x=nan"}}, "mirror plane x=nan is not at the first node"),
        ({"values": with_hole(T, 1e-30)}, "1e-30 K at node"),
        ({"x": X * 1e150}, "'x' runs from 0 to 8e.150 mm"),
        ({"x": X * 1e-150}, "'x' runs from 0 to 8e-150 mm"),
        ({"x": X + 1e12}, "'x' runs from 1e.12"),
    ],
)
def test_a_field_that_cannot_be_is_refused(changes, match, tmp_path):
    """Rationale: each was a traceback, or a field that bends light like nothing on earth."""
    path = written(tmp_path / "a.nc", **changes)
    with pytest.raises(InputError, match=match) as caught:
        IndexField.read(path)
    assert f"{caught.value}".startswith(f"{path}: ")
    assert "\n" not in f"{caught.value}"


def test_a_terminal_obeys_no_text_of_a_file(tmp_path):
    """Rationale: an escape sequence in an attribute could retitle a window, or worse."""
    told = "\x1b]0;OWNED\x07\x1b[31mred"
    path = written(tmp_path / "a.nc", file={"source": told, "title": told})
    assert IndexField.read(path).source == r"\x1b]0;OWNED\x07\x1b[31mred"
    status, out, err = command("field", "info", path)
    assert status == 0, err
    assert "OWNED" in out
    assert not {"\x1b", "\x07"} & set(out + err)
    bad = written(tmp_path / "b.nc", units=told)
    with pytest.raises(InputError) as caught:
        IndexField.read(bad)
    assert "\x1b" not in f"{caught.value}"


def test_variables_that_are_ignored_are_noted_by_the_field_and_by_its_scene(tmp_path):
    """Rationale: such as the velocity of the air beside its temperature."""
    shipped = shipped_scenes() / "fields/hot_cylinder_900C_quarter.nc"
    path = tmp_path / "air.nc"
    path.write_bytes(shipped.read_bytes())
    assert IndexField.read(path).notes == ()
    with netcdf_file(path, "a") as nc:
        for name in ("v", "u"):
            nc.createVariable(name, "f4", ("x", "y", "z"))[:] = 0.0
    (note,) = IndexField.read(path).notes
    assert note == f"{path}: ignored: u, v"
    scene = load_scene("hot_cylinder", field=path, blur=2)
    assert scene.field.notes == (note,)
    assert note in scene.notes


def test_the_docstring_tells_each_feature():
    """Rationale: what this file tests is promised there, and nothing else."""
    for feature in (
        "_Unsigned",
        "valid_range",
        "missing_value",
        "default fill value",
        "add_offset",
    ):
        assert feature in netcdf.__doc__
