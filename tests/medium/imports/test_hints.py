"""What a message advises must then be accepted, and give the right field."""

import numpy as np
import pytest
from command_line import command
from import_checks import HEADER, ROWS, X, Y, Z, imported, refused, rows, same, temperature, written

from virtual_sensor.medium.imports.sources import LENGTHS, UNITS
from virtual_sensor.medium.index_field import IndexField
from virtual_sensor.medium.units import unit_of


def test_degc_said_to_be_k_is_read_in_degc_when_told(tmp_path):
    """Rationale: one message advised --units degC, and the next one to leave it out."""
    celsius = np.subtract(ROWS, [0, 0, 0, 273.15])
    path = written(tmp_path / "a.csv", HEADER + rows(values=celsius))
    refused(path, "degC, said to be K. Say --units degC")
    made = imported(path, units="degC")
    same(made)
    assert any("which its values can't be; they are read in degC" in n for n in made.notes)
    sound = written(tmp_path / "b.csv", HEADER + rows())
    refused(sound, "the file says that 'T' is in K; leave --units degC out", units="degC")


def test_mm_said_to_be_m_is_read_in_mm_when_told(tmp_path):
    """Rationale: the same for lengths."""
    path = written(tmp_path / "a.csv", HEADER.replace("mm", "m") + rows())
    refused(path, "coordinates in mm, said to be in m. Say --length-units mm")
    same(imported(path, length_units="mm"))


def test_zeros_where_there_are_no_data_are_no_degc(tmp_path):
    """Rationale: --units degC, which was advised, made a field of 0 to 593 degC of it."""
    blank = np.array(ROWS)
    blank[100:110, 3] = 0.0
    path = written(tmp_path / "a.csv", HEADER + rows(values=blank))
    refused(path, "0 K at 10 places, .*no data there. Write NaN")


@pytest.mark.parametrize(
    ("name", "spellings"),
    {
        "K": "K kelvin Kelvin KELVIN degK kelvins",
        "degC": "degC °C C celsius Celsius deg_C degrees_Celsius ℃ ºC",
        "kg/m3": "kg/m3 kg/m^3 kg*m^-3 kg.m-3 kg/m³ kg·m⁻³",
        "g/cm3": "g/cm3 g/cm^3 g/cc",
        "mm": "mm MM millimeter Millimetres",
        "m": "m M meter metres",
        "um": "um µm μm micron",
        "inch": "inch in inches",
    }.items(),
)
def test_units_are_known_in_all_spellings(name, spellings):
    """Rationale: a file says Kelvin, and a user writes celsius."""
    known = [*LENGTHS, *(unit for units in UNITS.values() for unit in units)]
    assert {unit_of(text, known) for text in spellings.split()} == {name}
    assert unit_of("F", known) is None


def test_the_documented_cross_section_is_imported(tmp_path, monkeypatch):
    """Rationale: --extrude -180,180 begins as an option does."""
    monkeypatch.chdir(tmp_path)
    points = np.stack(np.meshgrid(Y, Z, indexing="ij"), axis=-1).reshape(-1, 2)
    values = temperature(np.column_stack([np.zeros(len(points)), points]))
    table = rows(values=np.column_stack([points, values]))
    written(tmp_path / "plane.csv", "x [mm],y [mm],T [K]\n" + table)
    line = "field import plane.csv --axes z,x,y --extrude -180,180 -o air.nc"
    status, _, err = command(*line.split())
    assert (status, err) == (0, "")
    field = IndexField.read(tmp_path / "air.nc")
    np.testing.assert_allclose(field.box, [[-180, -24, 0], [180, 24, 40]])
    assert len(X) == 5
