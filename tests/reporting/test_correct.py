"""A correction's picture, page and files: what a reader sees, for every kind of measurement."""

import json
from dataclasses import replace

import numpy as np
import pytest
from data_dictionary import undocumented
from matplotlib.figure import Figure

from virtual_sensor.imaging.scene import load_scene
from virtual_sensor.medium.air_model import AirModel
from virtual_sensor.medium.index_field import IndexField
from virtual_sensor.metrology.air_estimate import estimate_air
from virtual_sensor.metrology.centres import Status
from virtual_sensor.metrology.error_budget import PointBudget, error_budget
from virtual_sensor.metrology.observations import Observation, Prior
from virtual_sensor.metrology.shapes import CylinderShape
from virtual_sensor.optics.ray_search import ray_search
from virtual_sensor.reporting import correct as reporting
from virtual_sensor.reporting.pictures import key_above
from virtual_sensor.studies.correct.correct import correct
from virtual_sensor.studies.correct.measured import Measured

Y_MM = np.linspace(-10.0, 10.0, 21)
AGAIN = "virtual-sensor correct measured"


def searched(name, scene="hot_cylinder", **given):
    """A measurement of searched pixels, without one of them."""
    loaded = load_scene(scene, **given)
    pixel = np.array(ray_search(loaded, Y_MM, "newton").pixel)
    pixel[3] = np.nan
    status = np.where(np.isfinite(pixel[:, 0]), Status.OK, Status.NO_PEAK).astype(np.uint8)
    return Measured(name, loaded, pixel, np.full(21, 0.02), np.full(21, 90.0), status)


@pytest.fixture(scope="module")
def corrections():
    flat, turned = searched("flat"), searched("turned $a$ <b>", beta=30)
    none = replace(flat, pixel=np.full((21, 2), np.nan))
    only = np.arange(21) == 7
    one = replace(flat, pixel=np.where(only[:, None], flat.pixel, np.nan))
    many = [replace(flat, name=f"frame {n}") for n in range(9)]
    shaft = searched("shaft", "stepped_shaft")
    given = {"one": [flat], "two": [flat, turned], "many": many, "shaft": [shaft]}
    given |= {"none": [none], "one point": [one]}
    made = {name: correct(each) for name, each in given.items()}
    return made | {"estimated": estimated(made["two"])}


def estimated(result):
    """The same with the air that is estimated from it: twice as strong, for whoever looks."""
    seen = [Observation(each.scene, each.pixel, name=each.name) for each in result.measurements]
    model, priors = AirModel.of(result.medium), {"offset": Prior(0.0, 1e-4)}
    found = estimate_air(seen, model, ("scale", "offset"), shape=CylinderShape(), priors=priors)
    each = zip(result.measurements, found.residual_px, strict=True)
    budget = error_budget(found, sigmas={"camera_x": 0.01}, families=())
    return replace(
        result,
        measurements=tuple(
            replace(one, residual_px=px, estimate=found, whole_budget=budget) for one, px in each
        ),
        estimate=found,
        medium=model.at(scale=2.0),
    )


@pytest.fixture(scope="module")
def folders(corrections, tmp_path_factory, without_paint):
    place = tmp_path_factory.mktemp("corrected")
    for name, result in corrections.items():
        with without_paint():
            reporting.save(result, place / name, AGAIN)
    return {name: place / name for name in corrections}


def test_all_files_columns_and_keys_are_in_the_data_dictionary(folders):
    for name, folder in folders.items():
        assert undocumented(folder, reporting.FILES) == [], name


def test_pages_stand_in_a_browser(folders, faults_of):
    for name in ("estimated", "none"):
        assert faults_of(folders[name] / "report.html") == []


def test_the_page_begins_with_what_is_left(corrections, folders):
    """Rationale: the reader came for it; a fit's small residual is no news."""
    lead = reporting.lead(corrections["two"].summary)
    figures = json.loads((folders["two"] / "summary.json").read_text(encoding="utf-8"))
    errors = [
        figures["measurements"][name]["distance_uncorrected"] for name in figures["measurements"]
    ]
    before = np.sqrt(np.mean([each["rms_um"] ** 2 for each in errors]))
    assert f"rms off the scene's part; uncorrected, {before:.3g} µm." in lead
    assert f"uncorrected, {-figures['circle_uncorrected']['radius_error_um']:.3g} µm below" in lead
    assert reporting.lead(corrections["none"].summary) == "No point could be corrected."


def test_points_are_written_with_the_number_and_name_of_their_measurement(corrections, folders):
    table = (folders["two"] / "points.csv").read_text(encoding="utf-8").splitlines()
    assert table[0].startswith("measurement,column_px,row_px,")
    names = [row.split(",")[0] for row in table[1:]]
    assert names == ["flat"] * 21 + ["turned $a$ <b>"] * 21
    for name, points in (("corrected", "point_mm"), ("uncorrected", "point_uncorrected_mm")):
        head, _, data = (folders["two"] / f"{name}.ply").read_bytes().partition(b"end_header\n")
        assert b"element vertex 40\n" in head
        kinds = [*((each, "<f4") for each in "xyzm"), ("measurement", "<i4")]
        vertex = np.frombuffer(data, kinds)
        assert vertex["measurement"].tolist() == [1] * 20 + [2] * 20
        both = [getattr(each, points) for each in corrections["two"].measurements]
        true = np.concatenate(both)[:, 1]
        np.testing.assert_allclose(vertex["y"], true[np.isfinite(true)], atol=1e-5)


def test_what_was_removed_is_what_is_left_beside_what_was_there(corrections):
    """Rationale: signs. Uncorrected, the middle lies above the part, and what is removed too."""
    (flat,) = corrections["one"].measurements
    axes = Figure().add_subplot()
    reporting.removed_panel([flat]).draw(axes)
    along, towards = (line.get_ydata() for line in axes.lines[:2])
    error = 1e3 * (flat.point_uncorrected_mm - flat.point_mm)
    np.testing.assert_allclose(along, error[:, 1], atol=1e-9)
    assert towards[10] > 50 < flat.distance_uncorrected_um[10]


def test_many_measurements_are_drawn_alike_and_unnamed(corrections):
    """Rationale: a key of a hundred frames leaves no room for them."""
    for kind, labels in (("two", 2), ("many", 0)):
        axes = Figure().add_subplot()
        reporting.draw_distances(axes, corrections[kind].measurements)
        assert len(axes.get_legend_handles_labels()[1]) == labels


def test_a_key_shows_the_colour_of_small_dots():
    axes = Figure().add_subplot()
    axes.plot([0.0, 1.0], ".", ms=2.0, label="dots")
    key_above(axes)
    assert axes.get_legend().legend_handles[0].get_markersize() >= 5.0
    assert axes.lines[0].get_markersize() == 2.0


def test_what_is_missing_is_said_once_with_its_reason(corrections):
    (folded,) = reporting.missing(corrections["two"].summary)
    assert folded.summary == "Why 2 of 42 rows of points.csv have no point"
    assert [row[:2] for row in folded.content[0].rows] == [("flat", "1"), ("turned $a$ <b>", "1")]
    (lost,) = reporting.missing(corrections["none"].summary)
    assert sum(int(row[1]) for row in lost.content[0].rows) == 21


def test_objects_are_drawn(corrections):
    for name, result in corrections.items():
        for each in (result, result.measurements[0]):
            assert each.plot(Figure().add_subplot()).get_xlabel(), name


def test_an_estimate_is_shown_with_what_tells_how_sure_it_is(corrections):
    found, budget = corrections["estimated"].estimate, corrections["estimated"].budget
    table = reporting.on_console(corrections["estimated"])[2]
    assert [row[0] for row in table.rows] == ["scale", "offset, mm"]
    assert float(table.rows[0][1]) == pytest.approx(found["scale"], abs=0.1 * budget.total[0])
    assert [float(cell) for cell in table.rows[0][2:4]] == pytest.approx(
        [budget.total[0], found.sigma[0]], rel=0.05
    )
    assert [row[5:] for row in table.rows] == [("none", "found"), ("0 ± 0.0001", "prior")]
    axes = found.plot(Figure().add_subplot())
    written = {(text.get_position(), text.get_text()) for text in axes.texts}
    assert ((0, 0), "1.00") in written
    assert len(written) == 4


def test_the_error_budget_adds_up_to_the_interval(corrections):
    """Rationale: shares of the variance; an estimate that follows the noise takes some off."""
    parts = {"detection": [3.0, 3.0], "air": [4.0, 5.0], "correlation": [-3.0, 0.0]}
    along = np.array([[0.0, 0.0, 1.0]] * 2)
    square = {n: np.einsum("n,ni,nj->nij", np.sign(u) * np.square(u), along, along) * 1e-6
              for n, u in ((n, np.array(um)) for n, um in parts.items())}  # fmt: skip
    budget = PointBudget(np.zeros((2, 3)), along, square, {})
    np.testing.assert_allclose(sum(reporting.shares(budget).values()), [4.0, np.sqrt(34.0)])
    axes = budget.plot(Figure().add_subplot())
    assert axes.get_legend_handles_labels()[1] == [*parts, "in all"]
    each = replace(corrections["one"].measurements[0], budget=budget, point_mm=np.zeros((2, 3)))
    for several, labels in (([each], [*parts, "in all"]), ([each, each], [*parts])):
        axes = Figure().add_subplot()
        reporting.budget_panel(several).draw(axes)
        assert axes.get_legend_handles_labels()[1] == labels


def test_estimates_of_many_frames_are_summed_up(corrections):
    """Rationale: of a burst each frame has its own; how they spread is what its user asks."""
    one = corrections["estimated"]
    found = [
        replace(one.estimate, values=one.estimate.values + np.array([0.0, d])) for d in (-1.0, 3.0)
    ]
    both = zip(one.measurements, found, strict=True)
    many = replace(one, measurements=tuple(replace(m, estimate=e) for m, e in both), estimate=None)
    table = reporting.on_console(many)[2]
    assert [row[:2] for row in table.rows] == [("scale", "2"), ("offset, mm", "2")]
    assert [float(cell) for cell in table.rows[1][2:6]] == pytest.approx(
        [1.0, -1.0, 3.0, 2.8], abs=0.01
    )
    figure = Figure()
    reporting.estimates_panel(many.estimate_table).draw(figure)
    assert [axes.get_ylabel() for axes in figure.axes] == ["scale", "offset, mm"]


def test_the_estimated_air_can_be_taken_for_the_next_correction(corrections, folders):
    there = corrections["estimated"].measurements[0].point_mm[10:11] + np.array([0.0, 0.0, 2.0])
    field = IndexField.read(folders["estimated"] / "air.nc")
    before = corrections["two"].medium
    of_air = field.refractivity(there) - field.ambient, before.refractivity(there) - before.ambient
    assert of_air[0] == pytest.approx(2.0 * of_air[1], rel=1e-4)


def test_the_console_says_before_and_after(corrections):
    first, circle = reporting.on_console(corrections["two"])
    assert first.head == ("measurement", "points", "before", "after", "sigma", "moved")
    assert [row[1] for row in first.rows] == ["20", "20"]
    assert [row[0] for row in circle.rows] == ["before", "after"]
    (alone,) = reporting.on_console(corrections["none"])
    assert alone.rows[0][1:4] == ("0", "none", "none")
