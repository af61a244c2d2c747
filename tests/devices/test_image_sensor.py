"""Data sheets of image sensors: those that come with the program, and a user's own."""

import pytest

import virtual_sensor as vs
from virtual_sensor.devices.image_sensor import shipped_sensors

OWN = """
description = "mine"
pixel_um = 4.8
full_well_e = 9000
knee = [0.5, 6]
[quantum_efficiency]
650 = 0.5
450 = 0.3
"""


@pytest.fixture
def sheet(tmp_path):
    """A user's data sheet, with other words in place of some of its own."""

    def written(old="", new=""):
        path = tmp_path / "mine.toml"
        path.write_text(OWN.replace(old, new) if old else OWN, encoding="utf-8")
        return path

    return written


def test_each_shipped_sensor_is_of_its_class():
    """Their names are pixel pitches; their wells and converters fit each other."""
    assert vs.image_sensors() == ("cmos_3um45", "cmos_5um5", "profile_sensor")
    pitches = [vs.image_sensor(name).pixel_um for name in vs.image_sensors()]
    assert pitches == [3.45, 5.5, 6.0]
    for name in vs.image_sensors():
        sensor = vs.image_sensor(name)
        assert sensor.name == name
        assert sensor.saturation > 0.9 * sensor.white
        assert sensor.at_wavelength(405.0).quantum_efficiency < sensor.quantum_efficiency
        assert sensor.at_wavelength(532.0) == sensor
        assert (shipped_sensors() / f"{name}.toml").read_text().startswith("# Generic")


def test_a_users_own_data_sheet(sheet):
    """By its path; rows by wavelength are sorted, what is not said is as usual."""
    sensor = vs.image_sensor(sheet())
    assert (sensor.name, sensor.pixel_um, sensor.knee) == ("mine", 4.8, (0.5, 6.0))
    assert sensor.at_wavelength(550.0).quantum_efficiency == pytest.approx(0.4)
    assert sensor.gain == vs.ImageSensor().gain
    assert vs.image_sensor(sensor) is sensor
    assert repr(sensor).startswith("ImageSensor: mine, 12 bits, 4.8 um, full well 9000 e, knee at")


def test_dark_current_doubles_with_the_temperature():
    """By the data sheet's degrees; at its own temperature it is what it says."""
    sensor = vs.ImageSensor(dark_current_e_s=10.0, doubling_c=7.0)
    assert sensor.dark_current == pytest.approx(10.0)
    warm = vs.ImageSensor(dark_current_e_s=10.0, doubling_c=7.0, temperature_c=46.0)
    assert warm.dark_current == pytest.approx(80.0)
    extreme = vs.ImageSensor(dark_current_e_s=1.0, doubling_c=1.0, temperature_c=200.0)
    assert vs.grey_values([[0.0]], extreme, exposure_s=1e9) == extreme.saturation
    with pytest.raises(vs.InputError, match=r"doubling_c is 0\.0; give the rise"):
        vs.ImageSensor(doubling_c=0.0)


def test_a_data_sheet_that_can_not_be_is_refused_by_file_key_and_remedy(sheet):
    """Rationale: a file is written by hand."""
    for old, new, says in (
        (
            "full_well_e = 9000",
            "full_well = 9000",
            "no key 'full_well'; did you mean 'full_well_e'",
        ),
        ("full_well_e = 9000", "full_well_e = '9000'", "full_well_e is '9000'; give a number"),
        ("pixel_um = 4.8", "pixel_um = -1", "pixel_um is -1; give the pitch"),
        ("pixel_um = 4.8", "pixel_um = 0.0048", "in um, such as 3.45"),
        ("pixel_um = 4.8", "prnu = 1.5", "prnu is 1.5; give it up to 1, a part"),
        ("[0.5, 6]", "[0.5]", r"knee is \[0.5\]; give \(share of the full well"),
        ("[0.5, 6]", "[0.5, 0.5]", "knee's range is 0.5; give it above 1"),
        ("650 = 0.5", "red = 0.5", "has the key 'red'; give wavelengths in nm"),
        ("650 = 0.5", "650 = 50", "at 650 nm is 50.0; give it above 0 and up to 1"),
        ("pixel_um", "pixel um", "is no TOML file"),
    ):
        with pytest.raises(vs.InputError, match=rf"mine\.toml: .*{says}"):
            vs.image_sensor(sheet(old, new))
    with pytest.raises(vs.InputError, match="450 to 650 nm"):
        vs.image_sensor(sheet()).at_wavelength(808.0)
    with pytest.raises(vs.InputError, match="cmos_5um5"):
        vs.image_sensor("cmos_5um")
