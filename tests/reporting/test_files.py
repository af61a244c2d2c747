"""The data dictionary lists every file, column and key, and finds those that it does not."""

import json
from dataclasses import dataclass

import numpy as np
from data_dictionary import maker, undocumented

from virtual_sensor.records import (
    Described,
    Record,
    Table,
    record_columns,
    write_csv,
    write_json,
)
from virtual_sensor.reporting.files import (
    FileOf,
    file_table,
    write_results,
)
from virtual_sensor.reporting.page import Page, Section
from virtual_sensor.reporting.pictures import Panel, draw_picture


@dataclass(frozen=True)
class Point(Table):
    """A table.

    Attributes
    ----------
    point_mm : ndarray of shape (N, 3)
        Where | it is.
    status : list of str
        What became of it.
    """

    point_mm: np.ndarray
    status: list[str]


@dataclass(frozen=True)
class State(Record):
    """A state.

    Attributes
    ----------
    rms_px : float
        Error.
    counts : dict of int
        By status.
    """

    rms_px: float
    counts: dict[str, int]


@dataclass(frozen=True)
class Summary(Record):
    """A summary.

    Attributes
    ----------
    states : dict of State
        By name.
    seconds : float
        Of all.
    """

    states: dict[str, State]
    seconds: float


FILES = (
    FileOf("points_*.csv", "Points.", Point),
    FileOf("summary.json", "Figures.", Summary),
    FileOf("*.exr", "Frames.", (Described("Y", "W", "Radiance."),)),
    FileOf("report.png", "Picture."),
)


def written(folder):
    """A folder with all of them."""
    write_csv(folder / "points_hot.csv", Point(np.zeros((2, 3)), ["ok", "ok"]))
    write_json(folder / "summary.json", Summary({"hot": State(0.1, {"ok": 2})}, 1.0))
    (folder / "report.png").touch()
    return folder


def test_what_is_listed_is_found_documented(tmp_path):
    """Rationale: the check must not cry wolf."""
    assert undocumented(written(tmp_path), FILES) == []


def test_a_file_a_column_and_a_key_that_no_dictionary_lists_are_found(tmp_path):
    """Rationale: what nobody documents, users guess at."""
    folder = written(tmp_path)
    write_csv(folder / "points_cold.csv", {"point_mm_x": [1.0], "other_px": [2.0]})
    (folder / "new.txt").touch()
    summary = json.loads((folder / "summary.json").read_text())
    summary["states"]["hot"]["largest_px"] = 1.0
    summary["rms"] = 2.0
    (folder / "summary.json").write_text(json.dumps(summary))
    assert undocumented(folder, FILES) == [
        "new.txt",
        "points_cold.csv: other_px",
        "summary.json: states.hot.largest_px",
        "summary.json: rms",
    ]


def test_the_files_of_a_page_are_links_with_words():
    """Rationale: a name with a space must lead there, and many names to the folder they are in."""
    files = (*FILES, FileOf("report.html", "This page."), FileOf("cases/*", "Cases."))
    many = [f"{folder}{number}.csv" for number in range(4) for folder in ("points_", "cases/")]
    [(link, words)] = file_table(files, ["points_a b.csv", "report.html", "unknown.txt"]).rows
    assert (link.text, link.url, words) == ("points_a b.csv", "points_a%20b.csv", "Points.")
    (points, _), (cases, _) = file_table(files, many).rows
    assert (points, cases.text, cases.url) == ("points_*.csv", "cases/*", "cases/")


def test_each_result_is_written_as_what_it_is_and_the_page_lists_them_all(tmp_path):
    """Rationale: a file that no page mentions is found by nobody."""
    (tmp_path / "cold.exr").touch()
    state = State(0.1, {"ok": 2})
    picture = draw_picture("", [Panel("P", lambda axes: axes.plot([1]), "a line")])
    files = (*FILES, FileOf("table.md", "Table."), FileOf("report.html", "Page."))
    contents = {
        "points_hot.csv": record_columns(State, [state]),
        "report.png": picture,
        "table.md": "µm\ud800\n",
        "report.html": Page("T", "Lead.", (Section("One", "text"),), "c", {"of": {"a": 1}}),
        "summary.json": Summary({"hot": state}, 1.0),
    }
    write_results(tmp_path, files, contents)
    assert (tmp_path / "points_hot.csv").read_text() == 'rms_px,counts\n0.1,"{""ok"": 2}"\n'
    assert (tmp_path / "report.png").read_bytes() == picture.png
    assert (tmp_path / "table.md").read_text() == "µm\\ud800\n"
    assert json.loads((tmp_path / "summary.json").read_text())["seconds"] == 1.0
    html = (tmp_path / "report.html").read_text()
    assert "a: 1" in html
    for name in {"cold.exr", *contents} - {"report.html"}:
        assert f'href="{name}"' in html


def test_the_dictionary_lists_names_units_and_words():
    """Rationale: a reader finds the column of a CSV by its name."""
    text = maker().dictionary({"measure": FILES})
    for line in (
        "## measure",
        "### points_\\*.csv",
        "| `point_mm` | mm | Where \\| it is. |",
        "| `states` |  | By name. [State](#state) |",
        "### State",
        "| `rms_px` | px | Error. |",
        "| `Y` | W | Radiance. |",
    ):
        assert line in text.splitlines()
