"""The refractivity of air against published values, compared as n - 1, never as n."""

import numpy as np
import pytest

from virtual_sensor.errors import InputError
from virtual_sensor.medium.air import air_refractivity, refractivity_of_density


@pytest.mark.parametrize(
    ("temperature_c", "pressure_pa", "published"),
    [
        (20, 80e3, 21458.0),
        (20, 100e3, 26824.4),
        (20, 120e3, 32191.6),
        (10, 100e3, 27774.7),
        (30, 100e3, 25937.2),
    ],
)
def test_dry_air_is_as_ciddor_printed_it(temperature_c, pressure_pa, published):
    """Table 1 of Ciddor (1996): 1e8 (n - 1) at 633 nm, 450 ppm CO2."""
    refractivity = air_refractivity(633.0, temperature_c, pressure_pa)
    assert 1e8 * refractivity == pytest.approx(published, rel=1e-5)


def test_moist_air_is_as_nist_computes_it():
    """NIST's Engineering Metrology Toolbox (Ciddor): 20 degC, 101325 Pa, 50 % humidity."""
    wavelength_nm = [321.456, 500.0, 600.1234, 633.0, 700.0, 1000.987, 1500.8, 1700.0]
    nist = [283543, 273781, 271818, 271373, 270657, 269038, 268190, 268041]
    refractivity = air_refractivity(wavelength_nm, relative_humidity=0.5)
    np.testing.assert_allclose(1e9 * refractivity, nist, rtol=5e-6)


def test_the_laser_line_has_the_projects_reference_values():
    """532 nm, 20 degC, 1 atm, dry and at 50 %: computed for the project from the paper's text."""
    assert 1e8 * air_refractivity() == pytest.approx(27344.92, abs=0.01)
    assert 1e8 * air_refractivity(relative_humidity=0.5) == pytest.approx(27302.70, abs=0.01)


def test_hot_air_is_an_ideal_gas():
    """Reference values at 1 atm; above 200 degC n - 1 is inversely proportional to T."""
    hot_c = np.array([500.0, 900.0, 1100.0, 1250.0])
    refractivity = air_refractivity(temperature_c=hot_c)
    np.testing.assert_allclose(1e5 * refractivity, [10.364, 6.831, 5.836, 5.261], atol=5.1e-4)
    np.testing.assert_allclose(np.ptp(refractivity * (hot_c + 273.15)), 0.0, atol=1e-15)


@pytest.mark.parametrize("relative_humidity", [0.0, 0.3])
def test_hot_air_continues_cool_air_without_a_step(relative_humidity):
    """A step at the end of the fit, 100 degC, or of the transition, 200 degC, would refract."""
    t = np.arange(90.0, 210.0, 0.01)
    refractivity = air_refractivity(temperature_c=t, relative_humidity=relative_humidity)
    steps = -np.diff(refractivity)
    assert (steps > 0.0).all()
    assert steps.max() < 3e-5 * refractivity.max() * (10.0 if relative_humidity else 1.0)


@pytest.mark.parametrize("co2_ppm", [0.0, 1000.0, 2000.0])
def test_carbon_dioxide_raises_refractivity_as_birch_and_downs_say(co2_ppm):
    """Their equation (1994) is another than ours: 1 + 0.5327e-6 (x - 400), x in ppm."""
    more, usual = air_refractivity(co2_ppm=np.array([co2_ppm, 450.0]))
    expected = (1.0 + 0.5327e-6 * (co2_ppm - 400.0)) / (1.0 + 0.5327e-6 * 50.0)
    assert more / usual == pytest.approx(expected, abs=3e-6)


def test_humidity_below_freezing_counts_over_ice():
    """At -20 degC vapour saturates at 103.3 Pa over ice, not at 125 Pa as over water.

    The vapour's effect is checked with Birch and Downs' (1993) term, at 633 nm.
    """
    dry, wet = air_refractivity(633.0, -20.0, relative_humidity=np.array([0.0, 1.0]))
    per_pascal = (292.75 / 253.15) * (3.7345 - 0.0401 / 0.633**2) * 1e-10
    assert (dry - wet) / per_pascal == pytest.approx(103.3, rel=0.02)


def test_density_gives_refractivity():
    """The project's constant at 532 nm, and the standard atmosphere: 1.225 kg/m3 at 15 degC."""
    assert refractivity_of_density(1.0) == pytest.approx(2.27024e-4, rel=1e-5)
    assert refractivity_of_density(1.225) == pytest.approx(
        air_refractivity(temperature_c=15.0), rel=1e-3
    )
    np.testing.assert_array_equal(refractivity_of_density([0.0, 0.0]), [0.0, 0.0])


def test_inputs_broadcast_and_scalars_stay_scalars():
    """Users sweep one quantity or make tables of two."""
    assert isinstance(air_refractivity(), float)
    assert isinstance(refractivity_of_density(1.2), float)
    table = air_refractivity([[532.0], [633.0]], [0.0, 20.0, 40.0])
    assert table.shape == (2, 3)
    assert table[1, 2] == air_refractivity(633.0, 40.0)


@pytest.mark.parametrize(
    "wrong",
    [
        {"wavelength_nm": 250.0},
        {"wavelength_nm": 0.532},
        {"temperature_c": -300.0},
        {"temperature_c": [20.0, np.nan]},
        {"pressure_pa": 1013.25},
        {"relative_humidity": 50.0},
        {"relative_humidity": 1.0, "temperature_c": 99.0, "pressure_pa": 50e3},
        {"co2_ppm": -1.0},
    ],
)
def test_what_the_equation_does_not_cover_is_refused(wrong):
    """Wrong units (um, hPa, per cent) are the usual reason, so the message names the argument."""
    with pytest.raises(InputError, match=next(iter(wrong))):
        air_refractivity(**wrong)
