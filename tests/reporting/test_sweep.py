"""A sweep's picture and page say what its table says, whatever is swept and whatever failed."""

import csv
import json
from dataclasses import replace
from itertools import product
from urllib.parse import unquote

import numpy as np
import pytest
from data_dictionary import undocumented
from matplotlib.figure import Figure

from virtual_sensor.reporting import sweep as module
from virtual_sensor.reporting.sweep import FILES, draw, lead, page, save, table, unit_of
from virtual_sensor.reporting.tables import Link
from virtual_sensor.studies.provenance import made_with
from virtual_sensor.studies.sweep import MARK, Case, CaseStatus, Finished
from virtual_sensor.studies.sweep_table import Sweep, SweepSummary, SweepTable, SweptParameter

WORDS = {
    "beta": "sensor round the cylinder's axis, degrees",
    "temperature": "of the part, degC: so",
}
NASTY = "<script>alert(1)</script> $x$ a|b"


def swept(choices, failed=(), folder=None, hot=True, scene="hot_cylinder"):
    """A sweep's results without a measurement: the error is 100 um times the case's number."""
    names = list(choices)
    rows = [dict(zip(names, values, strict=True)) for values in product(*choices.values())]
    count = len(rows)
    status = ["failed" if i in failed else "ok" for i in range(count)]
    known = np.array([100.0 * (i + 1) if s == "ok" else np.nan for i, s in enumerate(status)])
    nothing = np.full(count, np.nan)
    finished, folders = [], []
    for i, (row, how) in enumerate(zip(rows, status, strict=True)):
        name = "_".join(f"{n}={v}" for n, v in row.items()) or "scene"
        folders.append(f"cases/case {i} #1-0f" if how == "ok" else "")
        place = folder / folders[-1] if folder and folders[-1] else None
        if place:
            place.mkdir(parents=True)
            (place / "report.html").touch()
        why = "no light" if how == "failed" else ""
        case = Case(scene, row, row, name, f"{i}")
        finished.append(Finished(case, place, CaseStatus(how), why, False))
    names_of_states = [n for n in SweepTable.__dataclass_fields__ if n.startswith(("hot", "cold"))]
    columns = dict.fromkeys(names_of_states, nothing)
    state = "hot" if hot else "cold"
    columns |= {f"{state}_centres": known, f"{state}_line_rms_px": known / 1e5}
    columns |= {f"{state}_section_rms_um": known}
    figures = SweepTable(
        parameters={name: tuple(row[name] for row in rows) for name in names},
        status=tuple(status),
        **columns,
        rays_lit=known,
        largest_incidence_shift_um=known if hot else nothing,
        largest_hot_error_um=known if hot else nothing,
        largest_measured_shift_um=known / 2.0 if hot else nothing,
        folder=tuple(folders),
        message=tuple(end.message for end in finished),
    )
    summary = SweepSummary(
        scene=scene,
        swept=tuple(
            SweptParameter(n, WORDS.get(n, ""), tuple(v)) for n, v in choices.items() if len(v) > 1
        ),
        cases=count,
        failed={e.case.name: e.message for e in finished if e.status == CaseStatus.FAILED},
        nothing_found=(),
        notes=(),
        program="0f",
        made_with=made_with(),
    )
    return Sweep(tuple(finished), figures, summary)


@pytest.fixture
def axes_of(monkeypatch, unpainted_test):
    """A function that draws a sweep and gives the axes of its panels, by their titles."""
    figures = []
    make = module.draw_picture

    def drawn(title, panels, **options):
        for panel in panels:
            axes = Figure(layout="constrained").add_subplot()
            axes.set_title(panel.title)
            panel.draw(axes)
            figures.append(axes)
        return make(title, panels, **options)

    monkeypatch.setattr(module, "draw_picture", drawn)

    def axes_of(result):
        figures.clear()
        draw(result)
        return {axes.get_title(): axes for axes in figures}

    return axes_of


ERROR = "Error of the section measured hot"


def test_a_parameter_has_the_unit_that_the_scene_says():
    """Rationale: an axis without a unit is a guess; where the scene is silent, the usual one."""
    units = {
        "of the cylinder, degC: chooses the field": "°C",
        "flow time of the air, s; empty: the field's last": "s",
        "film, px; alone it leaves the field of view": "px",
        "um; where given, film_width is width times it": "µm",
        "of the laser, nm": "nm",
        "degrees; unless given, it follows from focal_length": "°",
        "of the part at the wavelength: 0, no glow; oxidised steel: 0.8": "",
        "mm": "mm",
    }
    found = {words: unit_of(SweptParameter("x", words, ())) for words in units}
    assert found == units
    assert unit_of(SweptParameter("beta", "", ())) == "°"
    assert unit_of(SweptParameter("beta", "a ratio", ())) == ""


def test_curves_go_through_the_table_and_say_which_they_are(axes_of):
    """Rationale: numbers at their place in whatever order, labels at the ends, a unit."""
    axes = axes_of(swept({"beta": ["30", "0", "10"], "temperature": ["900", "1250"]}))[ERROR]
    assert axes.get_xlabel() == "beta in °"
    cold, hot = axes.lines
    np.testing.assert_array_equal(cold.get_xdata(), [0.0, 10.0, 30.0])
    np.testing.assert_array_equal(cold.get_ydata(), [300.0, 500.0, 100.0])
    np.testing.assert_array_equal(hot.get_ydata(), [400.0, 600.0, 200.0])
    assert (cold.get_marker(), cold.get_linestyle()) != (hot.get_marker(), hot.get_linestyle())
    labels = {text.get_text() for text in axes.texts}
    assert labels == {"900 °C", "1250 °C", "temperature"}


def test_curves_that_coincide_have_one_label(axes_of):
    """Rationale: two labels on one curve are read as two curves."""
    result = swept({"beta": ["0", "15", "30"], "transport": ["marched", "tabulated"]})
    same = np.repeat([1.0, 2.0, 3.0], 2)
    object.__setattr__(result.table, "hot_section_rms_um", same)
    labels = {text.get_text() for text in axes_of(result)[ERROR].texts}
    assert labels == {"all alike", "transport"}


def test_words_stand_side_by_side_with_nothing_between(axes_of):
    """Rationale: between two transports there is no third."""
    axes = axes_of(swept({"transport": ["straight", "marched", "tabulated"]}))[ERROR]
    assert [t.get_text() for t in axes.get_xticklabels()] == ["straight", "marched", "tabulated"]
    [line] = axes.lines
    assert line.get_linestyle() == "None"
    assert axes.get_xlabel() == "transport"


def test_two_parameters_of_many_values_make_a_map(axes_of):
    """Rationale: eight curves that cross are no picture; and a failed cell is no small value."""
    numbers = ["0", "10", "20", "30"]
    axes = axes_of(swept({"beta": numbers, "alpha": numbers[::-1]}, failed=(3,)))[ERROR]
    [image] = axes.images
    expected = 100.0 * np.arange(1, 17).reshape(4, 4)[:, ::-1].T
    expected[0, 0] = np.nan
    np.testing.assert_array_equal(np.ma.filled(image.get_array(), np.nan), expected)
    assert (axes.get_xlabel(), axes.get_ylabel()) == ("beta in °", "alpha in °")
    assert "failed" in [text.get_text() for text in axes.texts]


def test_further_parameters_make_panels_on_one_scale(axes_of):
    """Rationale: small multiples are compared, which needs one scale and a title each."""
    panels = axes_of(
        swept({"beta": ["0", "5", "9"], "temperature": ["900", "1250"], "method": ["a", "b"]})
    )
    of_error = {title: axes for title, axes in panels.items() if title.startswith(ERROR)}
    assert list(of_error) == [f"{ERROR}\nmethod a", f"{ERROR}\nmethod b"]
    assert len({axes.get_ylim() for axes in of_error.values()}) == 1


def test_failed_cases_are_seen(axes_of):
    """Rationale: a gap resembles a case that nobody asked for."""
    axes = axes_of(swept({"beta": ["0", "15", "30"]}, failed=(1,)))[ERROR]
    crosses = [line for line in axes.lines if line.get_marker() == "x"]
    assert [line.get_xdata().tolist() for line in crosses] == [[15.0]]
    assert axes.get_xlabel() == "beta in °   (× failed)"
    none = axes_of(swept({"beta": ["0", "5", "9"], "alpha": ["30", "60"]}, failed=(1, 3, 5)))[ERROR]
    assert {text.get_text() for text in none.texts} == {"30°", "60°: none", "alpha"}


def test_every_kind_of_sweep_can_be_drawn():
    """Rationale: cold parts, one case, nothing but failures, names that are code."""
    for result in (
        swept({}, hot=False),
        swept({"beta": ["0", "1"]}, failed=(0, 1)),
        swept({"beta": ["0", "1"], "field": [NASTY, "", "x" * 200]}, hot=False),
        swept({NASTY: ["0", "1"]}, scene=f"/tmp/{NASTY}.xml"),
    ):
        picture = draw(result)
        assert picture.png.startswith(b"\x89PNG")
        assert all(panel.alt for panel in picture.panels)


def test_the_lead_says_where_the_error_is_largest_and_what_failed():
    """Rationale: it is what a reader wants to know first."""
    words = lead(swept({"beta": ["0", "15"], "line_radius": ["0.1", "0.2"]}, failed=(3,)))
    assert words.startswith("4 cases over beta and line_radius: 3 measured and 1 failed.")
    assert "wrong by 300 µm rms at beta=15, line_radius=0.1" in words
    assert "by 100 µm at beta=0, line_radius=0.1" in words


def test_the_table_links_each_case_that_was_measured():
    """Rationale: names with spaces and # must lead there; a case that failed has no page."""
    shown = table(swept({"beta": ["0", "15"]}, failed=(1,)), links=True)
    assert shown.head == (
        "case",
        "beta, °",
        "status",
        "error, µm",
        "shift, µm",
        "rms, px",
        "centres",
    )
    link, failed = (row[0] for row in shown.rows)
    assert isinstance(link, Link)
    assert unquote(link.url) == "cases/case 0 #1-0f/report.html"
    assert "#" not in link.url
    assert failed == "beta=15"
    assert [row[2] for row in shown.rows] == ["measured", "failed"]
    assert shown.rows[0][3:] == ("100", "50", "0.0010", "100")


def test_files_are_written_and_listed(tmp_path, faults_of):
    """Rationale: a page without faults in a browser, and no column that nobody documents."""
    result = swept({"beta": ["0", "15"], "field": [NASTY, "b"]}, failed=(1,), folder=tmp_path)
    (tmp_path / MARK).touch()
    save(result, tmp_path, f"virtual-sensor sweep '{NASTY}'")
    assert faults_of(tmp_path / "report.html") == []
    assert undocumented(tmp_path, FILES) == ["sweep.csv: beta", "sweep.csv: field"]
    with (tmp_path / "sweep.csv").open(encoding="utf-8", newline="") as file:
        rows = list(csv.DictReader(file))
    assert [row["field"] for row in rows] == [NASTY, "b"] * 2
    assert [row["largest_hot_error_um"] for row in rows] == ["100", "", "300", "400"]
    summary = json.loads((tmp_path / "summary.json").read_text(encoding="utf-8"))
    assert summary["failed"] == {"beta=0_field=b": "no light"}
    assert summary["swept"][0] == {
        "name": "beta",
        "words": WORDS["beta"],
        "values": ["0", "15"],
    }


def test_combinations_that_are_not_drawn_are_counted(unpainted_test):
    """Rationale: seven panels of twelve would be taken for all there is."""
    numbers = [str(i) for i in range(3)]
    result = swept({"beta": numbers, "method": ["a", "b"], "spp": numbers, "step": numbers})
    drawn = draw(result)
    assert len(drawn.panels) == 12
    words = page(result, drawn, "c").sections[0].content[0]
    assert words == "The first 6 of 9 combinations of spp and step are drawn."


def test_a_parameter_that_is_called_as_a_column_has_one_of_its_own():
    """Rationale: a scene's $status must not take the place of the cases'."""
    columns = swept({"status": ["0", "1"]}).table.columns()
    assert columns["parameter_status"].tolist() == ["0", "1"]
    assert columns["status"].tolist() == ["ok", "ok"]


def test_the_page_tells_failures_before_files(tmp_path, unpainted_test):
    """Rationale: why a case failed is asked before what the files are."""
    save(swept({"beta": ["0", "15"]}, failed=(1,)), tmp_path, "c")
    html = (tmp_path / "report.html").read_text()
    assert html.index("<h2>Cases that failed") < html.index("<h2>Files")


def test_what_blur_and_noise_make_of_the_line_is_shown_where_it_is_known():
    """Rationale: who sweeps a lens or a sensor looks for its width, its shift and its noise.

    Of an ideal sweep they are shown only where the width changes: else they are no news.
    """
    ideal = swept({"f_number": ["4", "8"]})
    heads = {"width, px", "shift, px", "noise, px", "speckle, px"}
    assert not heads & set(table(ideal).head)
    wide = replace(ideal.table, hot_line_width_px=np.array([3.0, 2.0]))
    assert heads & set(table(replace(ideal, table=wide)).head) == {"width, px"}
    noise, shift = np.array([0.02, 0.01]), np.array([-0.4, 0.1])
    known = replace(wide, hot_noise_px=noise, hot_line_shift_px=shift)
    recorded = replace(ideal, table=known)
    assert heads & set(table(recorded).head) == {"width, px", "shift, px", "noise, px"}
    titles = [panel.title for panel in draw(recorded).panels]
    assert "Width of the line, hot" in titles
    assert "What noise makes of it, hot" in titles
    assert "-0.4000" in str(table(recorded).rows)
