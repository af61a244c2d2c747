"""Field files that are written: what went in comes out, at every instant, or nothing is written."""

from pathlib import Path

import numpy as np
import pytest
from scipy.io import netcdf_file

from virtual_sensor.errors import InputError
from virtual_sensor.medium.air import air_refractivity
from virtual_sensor.medium.index_field import IndexField
from virtual_sensor.medium.netcdf import GriddedQuantity, field_times, write_quantity

SHAPE = (5, 4, 6)
SOLID = np.zeros(SHAPE, dtype=bool)
SOLID[2:4, :2, 1:3] = True


@pytest.fixture
def path(tmp_path):
    return tmp_path / "field.nc"


@pytest.mark.parametrize("mirror", [(False, False, False), (False, True, True)])
def test_a_written_field_comes_back_bit_for_bit(path, mirror):
    """Values in full float64, with ambient, mirror planes and the source."""
    rng = np.random.default_rng(1)
    field = IndexField.from_arrays(
        1e-4 * rng.random(SHAPE),
        [-1.7, 0.1, 1e-5],
        [0.3, 1.0 / 3.0, 2.0],
        ambient=2.7e-4,
        mirror=mirror,
        solid=SOLID,
        source="a test, 20 °C",
    )
    field.write(path)
    back = IndexField.read(path)
    np.testing.assert_array_equal(back.nodes, field.nodes)
    np.testing.assert_array_equal(back.solid, SOLID)
    np.testing.assert_array_equal(back.origin, field.origin)
    np.testing.assert_allclose(back.spacing, field.spacing, rtol=1e-15)
    assert (back.ambient, back.mirror, back.source) == (field.ambient, mirror, field.source)
    assert [p.name for p in path.parent.iterdir()] == ["field.nc"]


def test_a_failed_write_leaves_the_old_file(path, monkeypatch):
    """The disk fills up halfway: the file of before stays whole, and no debris beside it."""
    field = IndexField.from_arrays(np.zeros(SHAPE), 3 * [0.0], 3 * [1.0])
    field.write(path)
    before = path.read_bytes()

    def half_written(self, data):
        with self.open("wb") as file:
            file.write(data[: len(data) // 2])
        raise OSError("No space left on device")

    monkeypatch.setattr(Path, "write_bytes", half_written)
    with pytest.raises(InputError, match="No space"):
        field.write(path)
    assert path.read_bytes() == before
    assert [p.name for p in path.parent.iterdir()] == ["field.nc"]


def test_a_missing_folder_is_named(tmp_path):
    """Folders are not made behind the user's back."""
    field = IndexField.from_arrays(np.zeros(SHAPE), 3 * [0.0], 3 * [1.0])
    with pytest.raises(InputError, match="there is no folder"):
        field.write(tmp_path / "nowhere" / "field.nc")


def gridded(kind="temperature", **changes):
    """A field of three instants that differ at every node, in its kind's usual range."""
    low, high = {"temperature": (293.15, 1500.0), "density": (0.23, 1.2)}.get(kind, (5e-5, 2.7e-4))
    values = np.random.default_rng(2).uniform(low, high, (3, *SHAPE))
    return GriddedQuantity(
        kind,
        **{"values": values, "origin_mm": np.array([-4.0, 0.5, 1.0])}
        | {"spacing_mm": np.array([2.0, 1.5, 0.25]), "time_s": np.array([0.5, 1.0, 3.0])}
        | changes,
    )


def nodes_of(kind, values):
    """N - 1 of dry air at 20 degC and 1 atm that becomes as hot, or as thin, as told."""
    if kind == "temperature":
        return air_refractivity() * 293.15 / values
    return 2.27024e-4 * values if kind == "density" else values


@pytest.mark.parametrize("kind", ["temperature", "density", "refractivity"])
@pytest.mark.parametrize("packed", [False, True])
def test_a_written_quantity_comes_back_at_every_instant(path, kind, packed):
    """In float64 as it was; packed, within half a quantum of 65535 across the range."""
    quantity = gridded(kind)
    write_quantity(path, quantity, packed)
    np.testing.assert_array_equal(field_times(path), quantity.time_s)
    quantum = np.ptp(quantity.values) / 65534 if packed else 0.0
    for time, values in zip(quantity.time_s, quantity.values, strict=True):
        field = IndexField.read(path, time_s=time)
        expected, other = nodes_of(kind, values), nodes_of(kind, values + 0.5001 * quantum)
        doubt = abs(other - expected) * 1.001 + expected * (1e-5 if kind == "density" else 1e-13)
        assert (abs(field.nodes - expected) <= doubt).all()
        np.testing.assert_allclose(field.origin, quantity.origin_mm)
        np.testing.assert_allclose(field.spacing, quantity.spacing_mm)


def test_between_two_instants_the_stored_quantity_is_interpolated(path):
    """Temperature, not its reciprocal n - 1: a quarter of the time from 1.0 s to 3.0 s."""
    quantity = gridded()
    write_quantity(path, quantity, packed=False)
    between = 0.75 * quantity.values[1] + 0.25 * quantity.values[2]
    field = IndexField.read(path, time_s=1.5)
    np.testing.assert_allclose(field.nodes, nodes_of("temperature", between), rtol=1e-13)


def test_without_a_time_the_last_instant_is_read(path):
    """The most developed flow; a float32 coordinate's rounding is no other instant."""
    write_quantity(path, gridded(), packed=False)
    last = IndexField.read(path).nodes
    np.testing.assert_array_equal(last, IndexField.read(path, time_s=3.0).nodes)
    np.testing.assert_array_equal(last, IndexField.read(path, time_s=3.0000001).nodes)


@pytest.mark.parametrize("time_s", [0.4, 3.1, -1.0, float("nan")])
def test_an_instant_outside_the_range_is_refused(path, time_s):
    """Nothing is extrapolated, and the message tells the range."""
    write_quantity(path, gridded())
    with pytest.raises(InputError, match=r"field\.nc: .* give a time from 0\.5 to 3 s"):
        IndexField.read(path, time_s=time_s)


def test_a_file_of_one_instant_has_no_other(path):
    """A time that is silently ignored would be a lie."""
    write_quantity(path, gridded(values=np.full(SHAPE, 400.0), time_s=None))
    assert field_times(path) is None
    with pytest.raises(InputError, match=r"one instant without a time axis, so not that at 1\.5 s"):
        IndexField.read(path, time_s=1.5)


@pytest.mark.parametrize("packed", [False, True])
def test_the_solid_of_a_quantity_does_not_matter(path, packed):
    """Steel at 0 K or NaN: the range that is packed is the air's, and reading fills the hole."""
    values = np.random.default_rng(3).uniform(300.0, 301.0, (3, *SHAPE))
    solid = np.zeros(SHAPE, dtype=bool)
    solid[2, 1, 2:4] = True
    values[:, 2, 1, 2], values[:, 2, 1, 3] = 0.0, np.nan
    write_quantity(path, gridded(values=values, solid=solid), packed)
    field = IndexField.read(path, time_s=1.0)
    expected = nodes_of("temperature", values[1][~solid])
    np.testing.assert_allclose(field.nodes[~solid], expected, rtol=1e-7)
    assert expected.min() <= field.nodes[solid].min() <= field.nodes[solid].max() <= expected.max()


def test_ambient_mirror_and_provenance_are_kept(path):
    """Who finds the file later can tell what it is, and what made it."""
    quantity = gridded(
        ambient={"ambient_temperature": 300.0, "ambient_pressure": 95e3},
        mirror=(False, True, False),
        attributes={"title": "mirror at x=0 of a café", "source": "a test", "history": "made"},
    )
    write_quantity(path, quantity)
    field = IndexField.read(path)
    assert (field.mirror, field.source) == ((False, True, False), "a test")
    assert field.ambient == pytest.approx(air_refractivity(532.0, 26.85, 95e3), rel=1e-13)
    with netcdf_file(path, mmap=False) as nc:
        assert (nc.title.decode(), nc.history.decode()) == ("mirror at x=0 of a café", "made")

    # No plane is written as such: nothing is looked for in the title.
    write_quantity(path, gridded(attributes={"title": "mirror at x=-4.0"}))
    assert IndexField.read(path).mirror == (False, False, False)


WITH_HOLE = np.full((3, *SHAPE), 400.0)
WITH_HOLE[1, 2, 3, 4] = np.nan


@pytest.mark.parametrize(
    ("changes", "message"),
    [
        ({"kind": "pressure"}, "kind 'pressure': give one of temperature, density, refractivity"),
        ({"values": WITH_HOLE}, r"1 nodes in the air .* the first is \[1, 2, 3, 4\]; fill them"),
        ({"values": WITH_HOLE, "solid": np.zeros(SHAPE, bool)}, "1 nodes in the air"),
        ({"values": 0.0 * WITH_HOLE[:1]}, "time_s must hold the 1 instants"),
        ({"values": np.full(SHAPE, 400.0)}, r"with time_s \(nt, nx, ny, nz\)"),
        ({"time_s": None}, r"give \(nx, ny, nz\)"),
        ({"time_s": np.array([0.0, 2.0, 1.0])}, "finite, ascending"),
        ({"values": np.full((3, *SHAPE), 0.0)}, "0 K at node"),
        ({"kind": "refractivity", "values": np.full((3, *SHAPE), 1.0003)}, "not n"),
        ({"ambient": {"ambient_density": 1.2}}, "'ambient_density' does not go with a temperature"),
        ({"solid": np.ones(SHAPE, bool)}, "leave some air"),
        ({"solid": np.zeros((2, 2, 2), bool)}, r"solid must have the shape \(5, 4, 6\)"),
    ],
)
def test_an_unfit_quantity_is_not_written(path, changes, message):
    """What could not be read back is refused now, when it can still be mended."""
    with pytest.raises(InputError, match=message) as error:
        write_quantity(path, gridded(**changes))
    assert str(error.value).startswith(f"{path}: ")
    assert not path.exists()


def test_air_of_another_pressure(tmp_path):
    """Against files of the same temperatures that say so, by Ciddor's formula; there and back."""
    hot = np.linspace(293.15, 1500.0, 120).reshape(4, 5, 6)
    made = {}
    for pressure in (101325.0, 90e3):
        ambient = {"ambient_temperature": 293.15, "ambient_pressure": pressure}
        quantity = GriddedQuantity("temperature", hot, np.zeros(3), np.ones(3), ambient=ambient)
        write_quantity(tmp_path / f"{pressure:.0f}.nc", quantity)
        made[pressure] = IndexField.read(tmp_path / f"{pressure:.0f}.nc")
        assert made[pressure].pressure_pa == pressure
    thin = made[101325.0].at_pressure(90e3)
    np.testing.assert_allclose(thin.nodes, made[90e3].nodes, rtol=1e-4)
    assert thin.ambient == pytest.approx(made[90e3].ambient, rel=1e-4)
    assert abs(thin.ambient / made[101325.0].ambient - 90 / 101.325) < 1e-12
    np.testing.assert_allclose(thin.at_pressure(101325).nodes, made[101325.0].nodes, rtol=1e-12)
    assert thin.at_pressure(90e3) is thin
    thin.write(tmp_path / "thin.nc")
    assert IndexField.read(tmp_path / "thin.nc").pressure_pa == 90e3
    flat = made[101325.0].simplified("linear").at_pressure(90e3)
    assert (flat.interpolation, flat.pressure_pa) == ("linear", 90e3)
    for wrong in (950, np.nan, "low", 2e5):
        with pytest.raises(InputError, match=r"pressure_pa is .*give 10000 to 140000 Pa"):
            thin.at_pressure(wrong)
