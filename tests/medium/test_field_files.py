"""Field files: the shipped one, what can be in one, and everything that can be wrong in it."""

import gc
from pathlib import Path

import numpy as np
import pytest
from scipy.io import netcdf_file

from virtual_sensor.errors import InputError
from virtual_sensor.medium.air import air_refractivity
from virtual_sensor.medium.description import MediumDescription
from virtual_sensor.medium.index_field import IndexField
from virtual_sensor.medium.netcdf import field_times

SHIPPED = Path(__file__).parents[2] / "scenes" / "fields" / "hot_cylinder_1250C_quarter.nc"
SHAPE = (5, 4, 6)


def write_nc(path, **changes):
    """Write a small field of 400 K air; `changes` replace entries of the description below."""
    spec = {
        "dimensions": ("x", "y", "z"),
        "coordinates": {axis: np.arange(n) * 2.0 for axis, n in zip("xyz", SHAPE, strict=True)},
        "coordinate_units": "mm",
        "name": "temperature",
        "type": "f8",
        "values": np.full(SHAPE, 400.0),
        "variable_attributes": {"units": "K"},
        "file_attributes": {},
        "solid": None,
    } | changes
    with netcdf_file(path, "w") as nc:
        for axis, nodes in spec["coordinates"].items():
            nc.createDimension(axis, len(nodes))
            coordinate = nc.createVariable(axis, "f8", (axis,))
            coordinate[:] = nodes
            if spec["coordinate_units"]:
                coordinate.units = "s" if axis == "time" else spec["coordinate_units"]
        for name in np.atleast_1d(spec["name"]):
            variable = nc.createVariable(str(name), spec["type"], spec["dimensions"])
            variable[:] = spec["values"]
            for key, value in spec["variable_attributes"].items():
                setattr(variable, key, value)
        if spec["solid"] is not None:
            nc.createVariable("solid", "i1", spec["dimensions"])[:] = spec["solid"]
        for key, value in spec["file_attributes"].items():
            setattr(nc, key, value)
    return path


@pytest.fixture
def path(tmp_path):
    return tmp_path / "field.nc"


@pytest.fixture(scope="module")
def shipped():
    return IndexField.read(SHIPPED)


def test_the_shipped_field_is_hot_at_the_wall_and_cool_far_off(shipped):
    """1250 degC gives 5.26e-5; the far corner is the ambient air of the laboratory."""
    hottest = air_refractivity(temperature_c=1250.0)
    assert shipped.nodes.min() == pytest.approx(hottest, rel=5e-4)
    assert shipped.ambient == air_refractivity()
    assert shipped.refractivity([[115.0, 35.0, 0.0]]) == pytest.approx(shipped.ambient, rel=1e-4)
    assert "rhoPimpleFoam" in shipped.source


@pytest.mark.parametrize("celsius", [900, 1100, 1250])
def test_shipped_fields_say_how_they_are_remade(celsius):
    """Rationale: without the command a field is a riddle; at most 2 MB each, and hot as named."""
    path = SHIPPED.with_name(f"hot_cylinder_{celsius}C_quarter.nc")
    assert path.stat().st_size <= 2e6
    air = IndexField.read(path)
    assert air.nodes.min() == pytest.approx(air_refractivity(temperature_c=celsius), rel=5e-3)
    history = netcdf_file(path, mmap=False).history.decode()
    assert "virtual-sensor field simulate" in history
    assert (f"--temperature {celsius} " in history) == (celsius != 1250)  # the default


def test_the_shipped_field_has_the_centre_temperatures_of_a_converged_mesh(shipped):
    """Published with the project's facts for a mesh of 0.5 mm at 1 s: within 2 %, in K."""
    converged = {6.0: 1206.0, 20.0: 912.0, 40.0: 752.0, 80.0: 618.0, 120.0: 557.0}
    refractivity = shipped.refractivity([[0.0, 0.0, z] for z in converged])
    kelvin = 293.15 * shipped.ambient / refractivity
    np.testing.assert_allclose(kelvin, list(converged.values()), rtol=0.02)


def test_the_shipped_field_is_a_quarter(shipped):
    """Its title says where it is mirrored; the other three quarters must be there."""
    np.testing.assert_allclose(shipped.box, [[-120.0, -36.0, -36.0], [120.0, 36.0, 299.0]])
    p = np.random.default_rng(0).uniform([0, 0, 1], [110, 30, 290], (300, 3))
    for sign in ([-1, 1, 1], [1, -1, 1], [-1, -1, 1]):
        np.testing.assert_allclose(
            shipped.refractivity(p * sign), shipped.refractivity(p), rtol=1e-13
        )
        np.testing.assert_allclose(
            shipped.gradient(p * sign) * sign, shipped.gradient(p), atol=1e-15
        )


def test_the_shipped_field_refracts_only_where_the_plume_leaves(shipped):
    """The plume goes through the lid, the other faces are quiet."""
    jump = shipped.border_jump()
    assert jump[5] > 5e-5
    assert (jump[:5] < 2e-6).all()


def test_temperature_becomes_refractivity_by_density(path):
    """An ideal gas at equal pressure: 586.3 K has half the density of 293.15 K."""
    field = IndexField.read(write_nc(path, values=np.full(SHAPE, 2 * 293.15)), wavelength_nm=633.0)
    np.testing.assert_allclose(field.nodes, 0.5 * air_refractivity(633.0), rtol=1e-13)
    assert field.ambient == air_refractivity(633.0)


def test_units_and_packing_do_not_matter(path):
    """The same field in degC and m, packed in 16 bits."""
    field = IndexField.read(write_nc(path))
    other = write_nc(
        path.with_name("packed.nc"),
        coordinates={axis: np.arange(n) * 0.002 for axis, n in zip("xyz", SHAPE, strict=True)},
        coordinate_units="m",
        type="i2",
        values=np.full(SHAPE, 2685),
        variable_attributes={
            "units": "degC",
            "scale_factor": np.float32(0.01),
            "add_offset": np.float32(100.0),
        },
    )
    packed = IndexField.read(other)
    np.testing.assert_allclose(packed.nodes, field.nodes, rtol=1e-14)
    np.testing.assert_allclose(packed.spacing, field.spacing, rtol=1e-14)


def test_ambient_air_can_be_described(path):
    """On the variable or on the file; a temperature in the variable's own units."""
    warm = write_nc(
        path,
        values=np.full(SHAPE, 30.0),
        variable_attributes={"units": "degC", "ambient_temperature": 30.0},
        file_attributes={"ambient_pressure": 95e3, "ambient_relative_humidity": 0.4},
    )
    field = IndexField.read(warm)
    assert field.ambient == pytest.approx(air_refractivity(532.0, 30.0, 95e3, 0.4), rel=1e-14)
    np.testing.assert_allclose(field.nodes, field.ambient, rtol=1e-14)


@pytest.mark.parametrize(
    ("name", "units", "value", "ambient", "expected"),
    [
        ("density", "kg/m3", 0.6, {"ambient_density": 1.2}, (0.6 * 2.27024e-4, 1.2 * 2.27024e-4)),
        ("density", "kg m-3", 1.2041, {}, (2.73359e-4, 2.73359e-4)),
        ("refractivity", "1", 1e-4, {"ambient_refractivity": 2e-4}, (1e-4, 2e-4)),
        ("refractivity", "1", 1e-4, {}, (1e-4, 2.734492e-4)),
    ],
)
def test_density_and_refractivity_are_read_too(path, name, units, value, ambient, expected):
    """K = 2.27024e-4 m3/kg at 532 nm; a refractivity stands as it is."""
    attributes = {"units": units} | ambient
    field = IndexField.read(
        write_nc(path, name=name, values=np.full(SHAPE, value), variable_attributes=attributes)
    )
    assert (field.nodes[0, 0, 0], field.ambient) == pytest.approx(expected, rel=1e-5)


def test_a_time_axis_of_one_is_no_hindrance(path):
    """Solvers write one, with a coordinate or without; only with one it can be asked for."""
    coordinates = {"time": [2.0]} | {a: np.arange(n) for a, n in zip("xyz", SHAPE, strict=True)}
    timed = {
        "coordinates": coordinates,
        "dimensions": ("time", "x", "y", "z"),
        "values": np.full((1, *SHAPE), 400.0),
    }
    write_nc(path, **timed)
    assert IndexField.read(path).shape == SHAPE
    assert IndexField.read(path, time_s=2.0).shape == SHAPE
    np.testing.assert_array_equal(field_times(path), [2.0])
    with pytest.raises(InputError, match="give a time from 2 to 2 s"):
        IndexField.read(path, time_s=1.0)

    with netcdf_file(path, "a") as nc:
        nc.variables["time"].units = "days since 1970-01-01"
    assert field_times(path) is None
    assert IndexField.read(path).shape == SHAPE


def test_the_solid_of_a_file_is_filled(path):
    """Fill values and steel alike, as long as the mask marks them."""
    values = np.full(SHAPE, 400.0)
    values[2, 1, 2:4] = [-999.0, 0.0]
    solid = np.zeros(SHAPE)
    solid[2, 1, 2:4] = 1
    attributes = {"units": "K", "_FillValue": -999.0}
    field = IndexField.read(
        write_nc(path, values=values, solid=solid, variable_attributes=attributes)
    )
    np.testing.assert_allclose(field.nodes, field.nodes[0, 0, 0], rtol=1e-14)


def test_mirror_planes_come_from_attribute_argument_or_title(path):
    """The argument outranks the attribute, the attribute the title."""
    write_nc(path, file_attributes={"mirror_planes": "x=0 z=0", "title": "mirror at y=0"})
    assert IndexField.read(path).mirror == (True, False, True)
    assert IndexField.read(path, mirror=(False, True, False)).mirror == (False, True, False)
    write_nc(path, file_attributes={"title": "a half (mirror at y=0)"})
    assert IndexField.read(path).mirror == (False, True, False)
    write_nc(path, file_attributes={"title": "a whole"})
    assert IndexField.read(path).mirror == (False, False, False)


AXES = {axis: np.arange(n) * 2.0 for axis, n in zip("xyz", SHAPE, strict=True)}
HOLE = np.full(SHAPE, 400.0)
HOLE[1, 2, 3] = np.nan
COLD = np.full(SHAPE, 400.0)
COLD[1, 2, 3] = 0.0


@pytest.mark.parametrize(
    ("changes", "message"),
    [
        ({"coordinate_units": ""}, "'x' has no attribute 'units'; give one of: mm"),
        ({"coordinate_units": "inch"}, "'x' has units 'inch'; give one of: mm"),
        ({"variable_attributes": {}}, "'temperature' has no attribute 'units'"),
        ({"variable_attributes": {"units": "F"}}, "'temperature' has units 'F'; give one of: K"),
        ({"coordinates": AXES | {"y": [3.0, 2.0, 1.0, 0.0]}}, "'y' does not ascend"),
        ({"coordinates": AXES | {"y": [0.0, 1.0, 2.0, 3.1]}}, "'y' is unevenly spaced"),
        ({"coordinates": AXES | {"y": [0.0, 1.0, np.nan, 3.0]}}, "'y' needs .* finite"),
        ({"coordinates": AXES | {"y": [0.0, 1.0, 2.0]}, "values": 400.0}, "at least 4 nodes"),
        ({"coordinates": {"lat": [0.0, 1.0]} | AXES, "dimensions": ("lat", "y", "z"),
          "values": 400.0}, r"dimensions \(lat, y, z\), not \(x, y, z\)"),
        ({"dimensions": ("z", "y", "x"), "values": 400.0}, r"dimensions \(z, y, x\), not"),
        ({"coordinates": {"time": [1.0, 1.0]} | AXES, "dimensions": ("time", "x", "y", "z"),
          "values": 400.0}, "'time' must hold .* ascending"),
        ({"coordinates": {"time": [0.0, 1.0]} | AXES, "dimensions": ("time", "x", "y", "z"),
          "values": 400.0, "solid": np.zeros((2, *SHAPE))}, "'solid' changes with time"),
        ({"coordinates": {"x": [0.0, 1.0]}, "dimensions": ("x",), "values": 400.0},
         "no coordinate variable 'y'"),
        ({"name": "pressure"}, "exactly one of .* it holds pressure$"),
        ({"name": ["temperature", "density"]}, "it holds temperature and density"),
        ({"values": HOLE}, r"1 nodes have no finite value, the first is \[1, 2, 3\]"),
        ({"values": COLD}, r"0 K at node \[1, 2, 3\]"),
        ({"values": COLD, "variable_attributes": {"units": "K", "_FillValue": 0.0}},
         "1 nodes have no finite value"),
        ({"name": "refractivity", "values": 1.0003, "variable_attributes": {"units": "1"}},
         r"1\.0003 at node .*n - 1 is wanted, not n"),
        ({"values": HOLE, "solid": np.zeros(SHAPE)}, "1 nodes have no finite value"),
        ({"solid": np.full(SHAPE, 2)}, "'solid' must be 0 in the air and 1"),
        ({"file_attributes": {"mirror_planes": "x=2"}}, "x=2 is not at the first node of x, 0 mm"),
        ({"file_attributes": {"mirror_planes": "left"}}, "cannot read 'left'"),
        ({"file_attributes": {"ambient_temperature": "cool"}}, "'ambient_temperature' must be a n"),
        ({"file_attributes": {"ambient_relative_humidity": 50.0}},
         "relative_humidity = 50 is outside"),
    ],
)  # fmt: skip
def test_an_unfit_file_is_refused_by_name(path, changes, message):
    """The message names the file, the element in it and the remedy."""
    write_nc(path, **changes)
    with pytest.raises(InputError, match=message) as error:
        IndexField.read(path)
    assert str(error.value).startswith(f"{path}: ")


@pytest.mark.parametrize(
    ("content", "message"),
    [
        (b"\x89HDF\r\n\x1a\n and so on", r"truncated or damaged|virtual-sensor\[netcdf4\]"),
        (b"CDF\x05 and so on", r"no coordinate variable 'x'|virtual-sensor\[netcdf4\]"),
        (b"x,y,z,T\n", "not a NetCDF file"),
        (b"", "not a NetCDF file"),
    ],
)
def test_other_formats_are_refused(path, content, message):
    """`test_netcdf4_files` has whole ones."""
    path.write_bytes(content)
    with pytest.raises(InputError, match=message):
        IndexField.read(path)


def test_a_truncated_file_is_refused_wherever_it_ends(path):
    """A download may stop anywhere, in the header or in the data."""
    content = SHIPPED.read_bytes()
    for end in [*range(5, 1100, 13), len(content) // 2, len(content) - 2]:
        path.write_bytes(content[:end])
        with pytest.raises(InputError, match=r"field\.nc: .*(truncated|NetCDF-3)"):
            IndexField.read(path)


def test_a_missing_file_is_answered_with_those_there(tmp_path):
    """A typing error in a scene is the usual reason."""
    write_nc(tmp_path / "one.nc")
    with pytest.raises(InputError, match=r"two\.nc: there is no such field.*there is one\.nc"):
        IndexField.read(tmp_path / "two.nc")
    with pytest.raises(InputError, match=r"looked in .*nowhere \(no folder\)"):
        IndexField.read(tmp_path / "nowhere" / "two.nc")


def test_attributes_may_have_the_names_of_what_reads_them(path, capfd):
    """SciPy makes them attributes of its own objects, "mode", "fp" and "variables" too."""
    names = ("mode", "fp", "variables", "dimensions", "_attributes", "version_byte")
    content = write_nc(path, file_attributes={n.upper(): "w" for n in names}).read_bytes()
    for name in names:
        content = content.replace(name.upper().encode(), name.encode())
    path.write_bytes(content)
    assert IndexField.read(path).shape == SHAPE
    gc.collect()
    assert capfd.readouterr() == ("", "")
    content = write_nc(path, variable_attributes={"units": "K", "DATA": "x"}).read_bytes()
    path.write_bytes(content.replace(b"DATA", b"data"))
    with pytest.raises(InputError, match=r"'temperature' has an attribute 'data'; rename it"):
        IndexField.read(path)


def test_scenes_of_the_same_air_share_one_field_until_its_file_changes(tmp_path):
    """Rationale: what is made of air, lookups and ray maps, is wanted in every pose of a part."""
    path = tmp_path / "air.nc"
    write_nc(path)
    air = MediumDescription(path)
    first = air.read()
    assert MediumDescription(path).read() is first
    assert MediumDescription(path, wavelength_nm=633.0).read() is not first
    assert MediumDescription(path, widen=2.0).read() is not first
    path.unlink()
    write_nc(path, values=np.full(SHAPE, 500.0))
    again = air.read()
    assert again is not first
    assert np.all(again.nodes < first.nodes)
    path.unlink()
    with pytest.raises(InputError, match="there is no such field file"):
        air.read()
