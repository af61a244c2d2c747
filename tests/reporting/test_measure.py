"""A measurement's picture and page: what a reader sees of it, for every kind of scene."""

import contextlib
import csv
import json
import re
import shutil
from dataclasses import replace

import cv2
import numpy as np
import pytest
from command_line import command
from data_dictionary import undocumented
from matplotlib.figure import Figure

from virtual_sensor.engine import activate
from virtual_sensor.imaging.image_files import read_image
from virtual_sensor.imaging.recording_options import RecordingOptions
from virtual_sensor.imaging.scene import load_scene
from virtual_sensor.imaging.scene_file import find_scene
from virtual_sensor.poses import Pose
from virtual_sensor.reporting import measure as reporting
from virtual_sensor.reporting.error_split import known_splits
from virtual_sensor.reporting.files import file_of
from virtual_sensor.reporting.page import page_html
from virtual_sensor.reporting.pictures import _lines
from virtual_sensor.reporting.words import micrometres
from virtual_sensor.studies.correct.correct import correct
from virtual_sensor.studies.correct.measured import Scenes, read_measured
from virtual_sensor.studies.measure import measure, summary

FILM = {"width": 256, "height": 256, "spp": 1, "line_radius": 0.4}
SCENES = {
    "hot": ("hot_cylinder", {}),
    "cold": ("cold_cylinder", {}),
    "shaft": ("stepped_shaft", {"line_radius": 0.25}),
    "dots": ("hot_cylinder", {"dots": "-3, 0, 4"}),
    "nothing": ("hot_cylinder", {"line_radius": 0.03}),
    "recorded": ("hot_cylinder", {}),
}
RECORDED = RecordingOptions("cmos_5um5", seed=1)


@pytest.fixture(scope="module")
def measured(tmp_path_factory, without_paint):
    """By kind: the measurement, its summary and its folder; some have pictures without paint."""
    place = tmp_path_factory.mktemp("measured")
    found = {}
    for kind, (name, given) in SCENES.items():
        recording = RECORDED if kind == "recorded" else None
        result = measure(load_scene(name, **FILM | given), recording=recording)
        with without_paint() if kind in ("cold", "dots") else contextlib.nullcontext():
            figures = reporting.save(result, place / kind, f"virtual-sensor measure {name}")
        found[kind] = result, figures, place / kind
    return found


def drawn(panel):
    """The axes of a panel."""
    axes = Figure(figsize=(12.0, 4.0)).add_subplot()
    panel.draw(axes)
    return axes


def test_all_files_columns_and_keys_are_in_the_data_dictionary(measured):
    """Rationale: what nobody documents, users guess at."""
    for kind, (_, _, folder) in measured.items():
        assert undocumented(folder, reporting.FILES) == [], kind


def test_pages_stand_in_a_browser(measured, faults_of):
    """Rationale: on a phone and a desk, with all pictures, links and words."""
    for _, _, folder in measured.values():
        assert faults_of(folder / "report.html") == []


def test_the_page_bears_the_version_of_llvm_and_no_path_of_this_machine(measured):
    """Rationale: where a library lies says nothing of the results, and something of their user."""
    library = activate().llvm
    for _, figures, folder in measured.values():
        assert figures.made_with.llvm == (library and library.version)
        if library:
            html = (folder / "report.html").read_text(encoding="utf-8")
            assert f"llvm: {library.version};" in html
            assert str(library.path.parent) not in html


def test_the_page_begins_with_how_wrong_the_section_is(measured):
    """Rationale: this is what its reader came for; that two programs agree is a check."""
    for kind, (_, figures, folder) in measured.items():
        html = (folder / "report.html").read_text(encoding="utf-8")
        lead = re.search(r'<p class="lead">(.*?)</p>', html)[1]
        name = "cold" if kind == "cold" else "hot"
        section = figures.states[name].section
        if kind == "nothing":
            assert lead.startswith("In hot air no point is measured")
            continue
        assert lead.startswith(f"In {name} air the measured section is wrong by ")
        assert f"{section.rms_um:.3g} µm rms" in lead
        assert f"y = {section.largest_y_mm:.3g} mm".replace("-", "\N{MINUS SIGN}") in lead


def test_a_shift_along_the_section_is_told_from_one_across_it(measured):
    """Rationale: "up to 615 um" beside an error of 18 um baffles."""
    for largest_um, along in ((1.0, True), (-90.0, False)):
        figures = measured["hot"][1]
        hot = figures.states["hot"]
        hot = replace(hot, section=replace(hot.section, largest_um=largest_um))
        rays = replace(figures.probe_rays, largest_measured_shift_um=100.0)
        figures = replace(figures, states={"hot": hot}, probe_rays=rays)
        assert (
            "100 µm: mostly along the section, where it does no harm (" in reporting.why(figures)[1]
        ) == along


def test_a_measurement_that_is_worth_little_says_so_beside_the_result(measured):
    """Rationale: of a film of 256 px 8 of 108 columns had a centre, and the lead was their rms."""
    result, good, folder = measured["hot"]
    assert good.caveats == ()
    assert reporting.findings(good) == reporting.headline(good)
    poor = replace(good, caveats=("hot: few",), notes=("hot: few", "cold: another"))
    told = f"{reporting.headline(good)}. What limits these figures: hot: few"
    assert reporting.findings(poor) == told
    page = reporting.page(result, poor, {}, "virtual-sensor measure")
    assert page.lead.startswith("In hot air the measured section")
    assert (page.caveats, page.notes) == (("hot: few",), ("cold: another",))
    box = re.search(r'<ul class="notes">.*?</ul>', page_html(page))[0]
    assert box.startswith(
        '<ul class="notes"><li><strong>What limits these figures:</strong><ul><li>hot: few'
    )
    many = replace(good, caveats=(f"my_air.nc: {'long ' * 90}; remedy",) * 3)
    drawn, _ = reporting.picture(result, many)
    assert "remedy" not in drawn.title
    assert "my_air.nc" in drawn.title
    assert len(_lines(drawn.title, 1800)) <= 3
    html = (folder.parent / "nothing/report.html").read_text(encoding="utf-8")
    assert re.search(r"In hot air no point is measured: the columns are .*too_narrow \d+", html)


def test_the_command_prints_caveats_first(tmp_path):
    """Rationale: who sees an rms first believes it."""
    given = ["-Dwidth=256", "-Dheight=256", "-Dspp=4"]
    status, out, err = command("measure", "cold_cylinder", *given, "-o", tmp_path / "out")
    assert (status, err) == (0, "")
    assert re.match(r"Note: cold: \d+ of 1\d\d columns that see the whole line have no centre", out)
    assert re.search(r"none has one from y = -1\d\.\d to 1\d\.\d mm; a finer film \(width", out)
    assert out.count("columns that see the whole line") == 1


def test_a_cold_part_has_fewer_panels_and_none_that_is_empty(measured, unpainted_test):
    """Rationale: empty panels, and zigzags of 1e-11 um, made readers ask what they had missed."""
    result, figures, _ = measured["cold"]
    _, panels = reporting.picture(result, figures)
    assert list(panels) == ["section", "check", "frame"]
    _, panels = reporting.picture(*measured["hot"][:2])
    assert {"section", "paths", "frame", "air", "probes", "letters", "check"} == set(panels)
    _, panels = reporting.picture(*measured["nothing"][:2])
    assert "check" not in panels
    assert micrometres(5e-11) == "below 1e-6 µm"
    assert micrometres(-0.5) == "\N{MINUS SIGN}0.5 µm"
    assert micrometres(None) == "none"


def test_a_recorded_measurement_says_what_its_error_is_made_of(measured, unpainted_test):
    """Rationale: a designer who sees only the whole mends what does not matter.

    In hot air that is refraction, in cold air the noise.
    """
    result, figures, folder = measured["recorded"]
    splits = {name: state.split for name, state in figures.states.items()}
    assert {name: split.largest for name, split in splits.items()} == {
        "cold": "noise",
        "hot": "refraction",
    }
    html = (folder / "report.html").read_text(encoding="utf-8")
    sizes = [each.parts[each.largest].rms_um for each in splits.values()]
    wholes = [each.whole.rms_um for each in splits.values()]
    for state, whole, first in zip(("cold", "hot"), wholes, sizes, strict=True):
        part = splits[state].largest
        assert (
            f"In {state} air the error of {whole:.3g} µm rms is made of: {part} {first:.3g},"
            in html
        )
    assert "Recorded line minus ray search, rms" in html
    assert "split" in reporting.picture(result, figures)[1]
    with (folder / "split_hot.csv").open(encoding="utf-8") as file:
        rows = [row for row in csv.DictReader(file) if row["whole_um"]]
    assert len(rows) == splits["hot"].points
    for row in rows:
        parts = [float(value) for name, value in row.items() if re.fullmatch("part_.*_um", name)]
        assert len(parts) == 5
        assert sum(parts) == pytest.approx(float(row["whole_um"]), abs=1e-6)
    plain = measured["hot"]
    assert "made of" not in (plain[2] / "report.html").read_text(encoding="utf-8")
    assert plain[1].states["hot"].split is None


def test_the_recorded_frame_lies_beside_the_ideal_one(measured):
    """Rationale: what a camera would have stored is there for other programs, as it was measured.

    The ideal frame is the one of the measurement that is not recorded.
    """
    result, _, folder = measured["recorded"]
    for name, state in result.states.items():
        stored = read_image(folder / f"recorded_{name}.png")
        np.testing.assert_array_equal(stored.pixels, state.shot.grey)
        assert stored.detector_options == state.shot.detector_options
        with (folder / f"truth_{name}.csv").open(encoding="utf-8") as file:
            truth = {int(row["column"]): float(row["row_px"]) for row in csv.DictReader(file)}
        found = dict(zip(state.line.column, state.line.row, strict=True))
        apart = [found[column] - row for column, row in truth.items() if column in found]
        assert np.nanmedian(np.abs(apart)) < 0.02
        ideal = measured["hot"][0].states[name]
        np.testing.assert_array_equal(state.frame.radiance, ideal.frame.radiance)
        assert not np.array_equal(state.line.row, ideal.line.row, equal_nan=True)
        assert "recorded" in file_of(reporting.FILES, f"recorded_{name}.png").words


def test_the_page_shows_the_recorded_frame_and_tables_only_what_is_known(measured):
    """Rationale: of a frame without noise nobody sees why its line was lost.

    A difference of pixels is not counted in thousands of 0.001 px.
    """
    result, figures, _ = measured["recorded"]
    (shown,) = drawn(reporting._frame_panel(result, 2)).get_images()
    grey = result.hot.shot.grey
    assert np.isin(shown.get_array(), grey).all()
    assert shown.get_array().max() == grey.max()
    compared = result.cold.compared
    for more_px, unit in ((0.0, "0.001 px"), (1.0, "in v, px")):
        far = replace(compared, true_row=compared.true_row + more_px)
        state = replace(result.cold, compared=far)
        axes = drawn(reporting._check_panel(replace(result, cold=state)))
        assert unit in axes.get_ylabel()
    split = figures.states["cold"].split
    unknown = replace(split, points=0, largest="")
    assert list(known_splits({"cold": unknown, "hot": split})) == ["hot"]
    states = {name: replace(state, split=unknown) for name, state in figures.states.items()}
    said = reporting.on_console(replace(figures, states=states))
    assert "made of" not in " ".join(map(str, said))
    assert any("made of" in str(each) for each in reporting.on_console(figures))


def test_a_recorded_measurement_is_corrected_down_to_its_noise(measured):
    """Rationale: what `correct` leaves over is what the sensor adds, as the split says beforehand.

    The recorded image alone says as much as the folder: its file knows gain, noise and saturation.
    """
    result, figures, folder = measured["recorded"]
    places = [str(folder), str(folder / "recorded_hot.png")]
    by_folder, by_image = read_measured(places, Scenes())
    np.testing.assert_allclose(by_image.pixel, by_folder.pixel, atol=1e-9)
    np.testing.assert_allclose(by_image.sigma_px, by_folder.sigma_px, rtol=1e-9)
    np.testing.assert_allclose(by_folder.pixel, result.hot.centres_px, atol=1e-9)
    [corrected] = correct([by_folder]).measurements
    left_um = np.sqrt(np.nanmean(corrected.distance_um**2))
    parts = figures.states["hot"].split.parts
    noise_um = np.hypot(parts["noise"].rms_um, parts["detector"].rms_um)
    assert left_um == pytest.approx(noise_um, rel=0.2)
    assert parts["refraction"].rms_um > 20.0 * left_um


def test_the_command_records_by_the_sensor_that_is_named(tmp_path):
    """Rationale: what can't be recorded so is told before any work, with the remedy."""
    film = [f"-D{name}={value}" for name, value in FILM.items()]
    place = tmp_path / "out"

    def told(*options):
        return command("measure", "cold_cylinder", *film, "-o", place, *options)

    status, out, err = told("--sensor-model", "cmos_3um45", "--seed", "5")
    assert (status, err) == (0, "")
    assert "What that error is made of, rms" in out
    assert re.search(r"In cold air the error of \S+ µm rms is made of: noise \S+,", out)
    assert "Check: recorded line minus ray search" in out
    shutil.rmtree(place)
    for options, words in (
        (["--sensor-model", "cmos"], "there is no such image sensor"),
        (["--sensor-model", "cmos_5um5", "--exposure", "2ms"], "f_number"),
        (["--sensor-model", "cmos_5um5", "--speckle"], "f_number"),
        (["--exposure", "soon"], "--exposure is 'soon'; give an exposure time with its unit"),
        (["--seed", "-1"], "seed"),
    ):
        status, out, err = told(*options)
        assert (status, words in err, place.exists()) == (2, True, False), err


def test_lengths_that_are_rounding_are_drawn_as_zero(measured):
    """Rationale: of the probe rays A - A_m is 1e-11 um, and looked like a curve on a cold scene."""
    axes = drawn(reporting._probe_panel(measured["hot"][0]))
    [cold] = [line for line in axes.lines if line.get_label() == "A − Aₘ"]
    assert (cold.get_ydata() == 0.0).all()
    axes = drawn(reporting._section_panel(*measured["cold"][:2]))
    [searched] = [line for line in axes.lines if line.get_label() == "by ray search"]
    assert (searched.get_ydata() == 0.0).all()


def test_no_line_is_drawn_across_a_gap(measured):
    """Rationale: where the shaft's line breaks off, curves went on, with spikes of 1.2 mm."""
    result, figures, _ = measured["shaft"]
    axes = drawn(reporting._section_panel(result, figures))
    [hot] = [line for line in axes.lines if str(line.get_label()).startswith("hot")]
    y, error = np.asarray(hot.get_xdata()), np.asarray(hot.get_ydata())
    joined = np.isfinite(error[1:]) & np.isfinite(error[:-1])
    pixel_mm = 45.056 / 256
    assert 0 < joined.sum() < result.hot.centres
    assert np.abs(np.diff(y)[joined]).max() < 2.0 * pixel_mm
    axes = drawn(reporting._check_panel(result))
    for line in axes.lines[:2]:
        steps = np.diff(np.asarray(line.get_xdata()))
        assert (steps[np.isfinite(steps)] < 1.5).all()


def test_the_frame_shows_the_cold_line_too(measured):
    """Rationale: the crop was of the hot light, and cut the cold line off."""
    for kind in ("hot", "shaft", "dots"):
        result = measured[kind][0]
        axes = drawn(reporting._frame_panel(result, 2))
        left, right = sorted(axes.get_xlim())
        top, bottom = sorted(axes.get_ylim())
        for state in result.states.values():
            u, v = state.centres_px[np.isfinite(state.centres_px).all(axis=1)].T
            assert ((u > left) & (u < right) & (v > top) & (v < bottom)).all()


def test_no_key_lies_on_a_panel_s_curves(measured):
    """Rationale: a legend covered the light paths."""
    result, figures, _ = measured["hot"]
    for panel in (
        reporting._section_panel(result, figures),
        reporting._frame_panel(result, 2),
        reporting._probe_panel(result),
        reporting._check_panel(result),
    ):
        axes = drawn(panel)
        axes.figure.canvas.draw()
        key = axes.get_legend().get_window_extent()
        assert key.y0 >= axes.get_window_extent().y1 - 1.0, panel.title


def test_the_light_paths_are_whole(measured):
    """Rationale: the laser's path was cut off where the field ends."""
    result, figure = measured["hot"][0], Figure()
    panel = reporting._air_panel(result, result.hot)
    panel.draw(figure)
    for axes in figure.axes[:2]:
        left, right = axes.get_xlim()
        bottom, top = axes.get_ylim()
        ends = np.concatenate([line.get_xydata() for line in axes.lines])
        assert (ends >= [left, bottom]).all()
        assert (ends <= [right, top]).all()


def test_the_air_is_cut_through_the_middle_of_the_line(measured):
    """Rationale: of a part off the origin the planes y = 0 and x = 0 showed no plume."""
    result, by = measured["hot"][0], np.array([76.2, -50.8, 3.0])
    panel = reporting._air_panel(result, result.hot)
    assert "plane y = 0 mm and the plane x = 0 mm" in panel.alt
    field = result.hot.scene.field
    aside = field.moved(Pose.shift(by))
    here, box = reporting._air_plane(field, np.zeros(3), 0)
    there, moved_box = reporting._air_plane(aside, by, 0)
    np.testing.assert_allclose(there, here, atol=1e-3)
    np.testing.assert_allclose(moved_box - box, [by[[0, 2]]] * 2, atol=1e-9)
    assert np.ptp(here) > 10.0
    outside, _ = reporting._air_plane(aside, np.array([0.0, 1e4, 0.0]), 0)
    np.testing.assert_allclose(outside, 1e5 * field.ambient, rtol=1e-6)
    hot, cold = result.hot, result.cold
    dense = replace(cold.dense, laser_point_mm=cold.dense.laser_point_mm + by)
    off = replace(result, cold=replace(cold, dense=dense))
    assert "plane y = −50.8 mm and the plane x = 76.2 mm" in reporting._air_panel(off, hot).alt


def test_the_check_says_how_many_were_compared_and_why_others_were_not(measured):
    """Rationale: an rms without its count can be made as small as one likes."""
    for kind in ("hot", "shaft"):
        _, figures, folder = measured[kind]
        html = (folder / "report.html").read_text(encoding="utf-8")
        for name, state in figures.states.items():
            line = state.line_minus_search
            assert f"{name}: {line.compared} of {line.centres} centres were compared" in html
            if line.cut_centres:
                assert f"{line.cut_centres} in whose columns an edge of the part hides" in html
    assert measured["shaft"][1].states["hot"].line_minus_search.cut_centres > 0


def test_light_paths_explain_the_whole_error(measured):
    """Rationale: of two causes the parts must add up, and without air there is no laser's part."""
    hot = measured["hot"][0].hot
    table = reporting.dense_table(measured["hot"][0])
    np.testing.assert_allclose(
        table.laser_path_um + table.camera_path_um, table.section_error_um["hot"], atol=1e-9
    )
    assert np.abs(measured["hot"][0].cold.laser_path_um).max() < 1e-6
    paths = summary(measured["hot"][0]).states["hot"].paths
    assert paths.laser_largest_um == pytest.approx(np.nanmax(np.abs(hot.laser_path_um)))


NASTY = "<script>alert('1')</script> \"q\" & $x$"


def test_names_of_a_users_files_are_only_names(tmp_path, faults_of):
    """Rationale: a scene called <script> ran in the page of whoever opened it."""
    scene = tmp_path / "<script>alert('1')<" / 'script> "q" & $x_{$.xml'
    scene.parent.mkdir()
    scene.write_text(find_scene("cold_cylinder").read_text(encoding="utf-8"), encoding="utf-8")
    given = [f"-D{name}={value}" for name, value in FILM.items()]
    folder = tmp_path / 'a "b" | <i>'
    status, out, err = command("measure", scene, *given, "-o", folder)
    assert (status, err) == (0, "")
    assert faults_of(folder / "report.html") == []
    html = (folder / "report.html").read_text(encoding="utf-8")
    assert "<script" not in html
    assert "script&gt; &#34;q&#34; &amp; $x_{$" in html
    assert json.loads((folder / "summary.json").read_text())["scene"] == str(scene)
    assert cv2.imread(str(folder / "report.png")) is not None
    assert "<i>" in out


def test_where_no_centre_is_found_all_says_so(measured, tmp_path, unpainted_test):
    """Rationale: "none none 0" and exit status 0 let a script go on with nothing."""
    given = [f"-D{name}={value}" for name, value in (FILM | SCENES["nothing"][1]).items()]
    status, out, err = command("measure", "hot_cylinder", *given, "-o", tmp_path / "out")
    assert (status, err) == (3, "")
    assert re.search("Note: no line centres, the columns are .*too_narrow", out)
    html = (tmp_path / "out/report.html").read_text(encoding="utf-8")
    assert re.search(
        "hot: no line centre was found; the image&#39;s columns are: .*too_narrow", html
    )
    assert not re.search(r"\bnan\b", html + out)
    status, out, _ = command("search", "cold_cylinder", "-y", "14")
    assert status == 3
    assert "Note: no ray was found: laser_missed" in out
