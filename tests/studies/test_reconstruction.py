"""The scanned cylinder: against scenes loaded for each line, and against its own words."""

import numpy as np
import pytest

import virtual_sensor as vs
from virtual_sensor.metrology.cylinder_fit import FitStatus
from virtual_sensor.optics.eikonal import March
from virtual_sensor.records import write_csv
from virtual_sensor.studies.reproduction.reconstruction import (
    fit_section,
    fitted_cylinders,
    reconstruct,
)
from virtual_sensor.studies.reproduction.settings import Setting

ALONG = (-60.0, -20.0, 40.0)
RAYS = 41


@pytest.fixture(scope="module")
def scanned():
    """The hot cylinder from above and from the side, scanned in three lines."""
    return {
        beta: reconstruct(vs.load_scene("hot_cylinder", beta=beta), ALONG, RAYS)
        for beta in (0.0, 20.0)
    }


def test_a_cold_cylinder_is_measured_as_it_is(scanned):
    """Rationale: without refraction a fit that errs, errs by itself; in any pose, on any arc."""
    for result in scanned.values():
        np.testing.assert_allclose(result.error_um[:, 0], 0.0, atol=1e-6)
        np.testing.assert_allclose(result.interval_um[:, 0], 0.0, atol=1e-6)
        np.testing.assert_allclose(result.axis_shift_um[:, 0], 0.0, atol=1e-5)
        np.testing.assert_allclose(result.tilt_mrad[:, 0], 0.0, atol=1e-6)
        assert result.residual_std_um[:, 0].max() < 1e-6
        np.testing.assert_array_equal(result.status, FitStatus.FITTED)


def test_a_hot_cylinder_measures_too_small_from_above(scanned):
    """Rationale: the plume over it is a diverging lens; the finding of the earlier experiment.

    Hundreds of um, the more the less of the arc is seen; from 20 degrees beside it, tens at most.
    """
    above, beside = scanned[0.0].error_um[:, 1], scanned[20.0].error_um[:, 1]
    assert above[0] < above[1] < above[2] < -300.0
    assert np.abs(beside).max() < 50.0
    assert scanned[0.0].interval_um[2, 1, 1] < 0.0
    for result in scanned.values():
        bounds, error = result.interval_um[:, 1], result.error_um[:, 1]
        assert np.all((bounds[:, 0] < error) & (error < bounds[:, 1]))


@pytest.mark.parametrize("beta", [0.0, 20.0])
def test_points_are_those_of_scenes_loaded_line_by_line(scanned, beta):
    """Rationale: the sensor is moved without loading; the scene's own `along` must say the same.

    To 0.05 um: Mitsuba holds poses in float32, and the reference marches in other steps.
    """
    result = scanned[beta]
    by_line = result.points_mm.reshape(2, len(ALONG), RAYS, 3)
    for number, x in enumerate(ALONG):
        scene = vs.load_scene("hot_cylinder", beta=beta, along=x)
        for state, air in enumerate((scene.cold(), scene)):
            march = March(1.0, "rk4", "double")
            found = vs.ray_search(air, result.y_mm, "newton", march=march)
            expected = vs.triangulate(scene.sensor, found.pixel)
            np.testing.assert_allclose(by_line[state, number], expected, atol=5e-5)


def test_arcs_take_the_rays_that_they_name(scanned):
    """Rationale: of 41 rays over 22 mm, 19, 29 and all lie within 5, 8 and 11 mm."""
    counts = np.array([19, 29, 41]) * len(ALONG)
    np.testing.assert_array_equal(scanned[0.0].count, np.stack([counts, counts], axis=1))


def test_a_reconstruction_repeats(scanned):
    """Rationale: the radius error is to repeat to 0.01 um from run to run."""
    again = reconstruct(vs.load_scene("hot_cylinder"), ALONG, RAYS)
    np.testing.assert_allclose(again.error_um, scanned[0.0].error_um, atol=0.01)
    np.testing.assert_allclose(again.interval_um, scanned[0.0].interval_um, atol=0.01)


def test_the_table_holds_every_fit(scanned, tmp_path):
    """Rationale: what the sentence says must be found in the file, cold and hot, arc by arc."""
    results = {Setting("resolved", 1250.0, beta): r for beta, r in scanned.items()}
    write_csv(tmp_path / "fits.csv", fitted_cylinders(results))
    table = np.genfromtxt(tmp_path / "fits.csv", delimiter=",", names=True, dtype=None)
    assert len(table) == 2 * 3 * 2
    row = table[(table["beta_deg"] == 0) & (table["arc_mm"] == 8) & (table["state"] == "hot")]
    expected = scanned[0.0]
    assert row["radius_error_um"] == pytest.approx(expected.error_um[1, 1], rel=1e-8)
    assert row["radius_error_low_um"] == pytest.approx(expected.interval_um[1, 1, 0], rel=1e-8)
    assert row["radius_error_high_um"] == pytest.approx(expected.interval_um[1, 1, 1], rel=1e-8)
    assert row["hot_minus_cold_um"] == pytest.approx(expected.error_um[1, 1], rel=1e-6)
    assert row["axis_z_um"] == pytest.approx(expected.axis_shift_um[1, 1, 1], rel=1e-8)
    assert row["status"] == "fitted"
    assert np.isnan(table["hot_minus_cold_um"][table["state"] == "cold"]).all()


def test_a_section_is_fitted_with_its_direction_held():
    """Rationale: a rendered line is one slanted section, with lost columns at its ends."""
    y = np.linspace(-11.0, 11.0, 900)
    depth = np.sqrt(13.4**2 - y**2)
    noise = np.random.default_rng(1).normal(0.0, 1e-3, y.shape)
    points = np.column_stack([-0.577 * depth, y, depth - 13.5 + noise])
    points[:40] = np.nan
    fit, (low, high) = fit_section(points)
    assert fit.count == 860
    assert fit.radius_mm == pytest.approx(13.4, abs=2e-3)
    assert low < 13.4 < high
    assert high - low < 4e-3
    assert fit.residual_std_um == pytest.approx(0.86, abs=0.1)  # noise in z, less square to it
    nothing, interval = fit_section(np.full((900, 3), np.nan))
    assert nothing.status == FitStatus.TOO_FEW
    assert np.isnan(interval).all()


def test_a_line_beside_the_part_gives_no_number():
    """Rationale: past the end face there is nothing to scan; NaN and a status, not a radius."""
    result = reconstruct(vs.load_scene("cold_cylinder"), [200.0], 11)
    np.testing.assert_array_equal(result.status, FitStatus.TOO_FEW)
    assert np.isnan(result.radius_mm).all()
    assert np.isnan(result.interval_mm).all()
    assert np.isnan(result.points_mm).all()


def test_only_cylinders_are_reconstructed():
    """Rationale: a stepped shaft has no one radius to compare with."""
    with pytest.raises(vs.InputError, match=r"stepped_shaft\.xml: the part is no cylinder"):
        reconstruct(vs.load_scene("stepped_shaft"))


@pytest.mark.parametrize(
    "arguments", [{"along_mm": [np.nan]}, {"along_mm": []}, {"rays": 1}, {"arcs_mm": [0.0]}]
)
def test_unfit_scans_are_refused(arguments):
    """Rationale: before any light is followed."""
    with pytest.raises(vs.InputError, match="give finite places, at least 2 rays"):
        reconstruct(vs.load_scene("cold_cylinder"), **arguments)
