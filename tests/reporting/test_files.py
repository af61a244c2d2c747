"""The data dictionary lists every file, column and key, and finds those that it does not."""

import json
from dataclasses import dataclass

import numpy as np

from virtual_sensor.records import Described, Record, Table, write_csv, write_json
from virtual_sensor.reporting.files import FileOf, dictionary, file_table, undocumented


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
    """Rationale: a name with a space must lead there, and a pattern to the folder it is in."""
    files = (*FILES, FileOf("report.html", "This page."), FileOf("cases/*", "Cases."))
    named = file_table(files, ["points_a b.csv", "report.html", "unknown.txt"])
    [(link, words)] = named.rows
    assert (link.text, link.url, words) == ("points_a b.csv", "points_a%20b.csv", "Points.")
    first, *_, last = file_table(files).rows
    assert (first[0], last[0].url) == ("points_*.csv", "cases/")
    assert len(file_table(files).rows) == len(files) - 1


def test_the_dictionary_lists_names_units_and_words():
    """Rationale: a reader finds the column of a CSV by its name."""
    text = dictionary({"measure": FILES})
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
