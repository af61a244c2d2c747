"""NetCDF-4 and CDF-5 field files: the same fields as from NetCDF-3, and nothing that kills."""

import importlib.util
import sys
from contextlib import suppress
from pathlib import Path

import numpy as np
import pytest
from scipy.io import netcdf_file

from virtual_sensor.errors import InputError
from virtual_sensor.medium import netcdf_elements
from virtual_sensor.medium.netcdf import field_times, read_field_file

Dataset = pytest.importorskip("netCDF4", reason="comes with the extra 'netcdf4'").Dataset

SHIPPED = Path(__file__).parents[2] / "scenes" / "fields" / "hot_cylinder_900C_quarter.nc"
FORMATS = ("NETCDF4", "NETCDF4_CLASSIC", "NETCDF3_64BIT_DATA")


def copied(source, target, kind):
    """The same content in another format, as `nccopy` makes it, attribute by attribute."""
    with netcdf_file(source, mmap=False) as old, Dataset(target, "w", format=kind) as new:
        for name, value in old._attributes.items():
            new.setncattr(name, value.decode() if isinstance(value, bytes) else value)
        for name, size in old.dimensions.items():
            new.createDimension(name, size)
        for name, variable in old.variables.items():
            attributes = dict(variable._attributes)
            fill = attributes.pop("_FillValue", None)
            made = new.createVariable(
                name, variable.data.dtype.str[1:], variable.dimensions, fill_value=fill
            )
            made.set_auto_maskandscale(False)
            for key, value in attributes.items():
                made.setncattr(key, value.decode() if isinstance(value, bytes) else value)
            made[...] = variable.data
    return target


@pytest.fixture
def written(tmp_path):
    """A small field of two instants with a solid, written by netCDF4; changes as in `with`."""

    def write(kind="NETCDF4", temperature="f8", scale=None, fill=None, name="temperature"):
        path = tmp_path / "field.nc"
        values = 300.0 + np.arange(2 * 3 * 4 * 5).reshape(2, 3, 4, 5)
        with Dataset(path, "w", format=kind) as file:
            file.source = "by hand, °C"
            file.mirror_planes = "x=0"
            for axis, size in (("time", 2), ("x", 3), ("y", 4), ("z", 5)):
                file.createDimension(axis, None if axis == "time" else size)
                coordinate = file.createVariable(axis, "f8", (axis,))
                coordinate[:] = 2.0 * np.arange(size)
                coordinate.units = "s" if axis == "time" else "mm"
            made = file.createVariable(
                name, temperature, ("time", "x", "y", "z"), fill_value=fill, zlib=kind == "NETCDF4"
            )
            made.set_auto_maskandscale(False)
            made.units = "K"
            stored = values if scale is None else (values - 300.0) / scale
            if scale is not None:
                made.scale_factor, made.add_offset = scale, 300.0
            if fill is not None:
                made.fill_value_means = "solid"
                stored[:, 0, 0, 0] = fill
            made[:] = stored
            other = file.createVariable("note", str if kind == "NETCDF4" else "S1", ())
            other[...] = "n"
        return path, values

    return write


@pytest.mark.parametrize("kind", FORMATS)
def test_the_shipped_field_is_the_same_in_every_format(tmp_path, kind):
    """To the bit: packed, with a solid of fill values, a mirror and its story."""
    before, after = (
        read_field_file(path, 532.0)
        for path in (SHIPPED, copied(SHIPPED, tmp_path / "copy.nc", kind))
    )
    np.testing.assert_array_equal(after.refractivity, before.refractivity)
    np.testing.assert_array_equal(after.solid, before.solid)
    np.testing.assert_array_equal(after.spacing_mm, before.spacing_mm)
    assert (after.ambient, after.mirror) == (before.ambient, before.mirror)
    assert after.source == before.source != ""
    assert after.notes == ()


@pytest.mark.parametrize("kind", FORMATS)
def test_instants_and_remarks_are_read(written, kind):
    """An unlimited dimension, text of several bytes a letter, and a variable that is no field's."""
    path, values = written(kind)
    np.testing.assert_array_equal(field_times(path), [0.0, 2.0])
    first, last = (read_field_file(path, 532.0, time_s=time) for time in (0.0, 2.0))
    ratio = last.refractivity / first.refractivity
    np.testing.assert_allclose(ratio, values[0] / values[1], rtol=1e-12)
    assert first.source == "by hand, °C"
    assert first.mirror == (True, False, False)
    assert "ignored: note" in first.notes[0]


@pytest.mark.parametrize("stored", ["u1", "u2", "i8"])
def test_integers_that_netcdf_3_has_not_are_unpacked(written, stored):
    """Unsigned as such, and of 64 bits; the fill value marks the solid."""
    path, values = written(temperature=stored, scale=1.0, fill=200)
    field = read_field_file(path, 532.0, time_s=0.0)
    assert np.argwhere(field.solid).tolist() == [[0, 0, 0]]
    air = ~field.solid
    relative = field.refractivity[air] * values[0][air]
    np.testing.assert_allclose(relative, relative[0], rtol=1e-12)  # n - 1 goes as 1/T


@pytest.mark.parametrize("name", ["pressure", "values"])
def test_what_is_no_field_is_refused_as_of_netcdf_3(written, name):
    path, _ = written(name=name)
    with pytest.raises(InputError, match=r"field\.nc: must hold exactly one of the variables"):
        read_field_file(path, 532.0)


@pytest.mark.parametrize("kind", ["NETCDF4", "NETCDF3_64BIT_DATA"])
def test_a_damaged_file_is_refused_by_name(written, kind):
    """Cut off anywhere, or with bytes of its own changed: an error, or numbers; never a crash."""
    path, _ = written(kind)
    content = path.read_bytes()
    rng = np.random.default_rng(3)
    for end in rng.integers(8, len(content), 12):
        path.write_bytes(content[:end])
        with pytest.raises(InputError, match=r"field\.nc: "):
            read_field_file(path, 532.0)
    for _ in range(12):
        changed = np.frombuffer(content, np.uint8).copy()
        changed[rng.integers(8, len(content), 20)] = rng.integers(0, 256, 20)
        path.write_bytes(changed.tobytes())
        with suppress(InputError):  # naming the file, as above
            read_field_file(path, 532.0)


def test_more_than_fits_into_memory_is_refused(tmp_path):
    """A file of some kB may claim petabytes, all fill values."""
    path = tmp_path / "huge.nc"
    with Dataset(path, "w") as file:
        for axis in "xyz":
            file.createDimension(axis, 100_000)
        made = file.createVariable("temperature", "f8", ("x", "y", "z"), chunksizes=(1, 1, 1000))
        made.units = "K"
    with pytest.raises(InputError, match=r"huge\.nc: .*(memory|damaged)"):
        read_field_file(path, 532.0)


def test_without_the_package_the_extra_is_named(written, monkeypatch):
    """And the remedy without it."""
    path, _ = written()
    monkeypatch.setattr(importlib.util, "find_spec", lambda name: None)
    with pytest.raises(InputError, match=r"field\.nc: .*virtual-sensor\[netcdf4\].*nccopy -3"):
        read_field_file(path, 532.0)


def test_the_package_is_loaded_in_no_process_of_the_users(written):
    """Rationale: it takes half a second, and a damaged file may kill who reads it."""
    path, _ = written()
    before = set(sys.modules)
    read_field_file(path, 532.0)
    assert "virtual_sensor.medium.netcdf4" not in sys.modules.keys() - before
    assert netcdf_elements.run_in_child is not None
