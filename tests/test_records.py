"""Tables and point clouds say to other programs what they said to us."""

import csv
import dataclasses
import json
import sys
from collections.abc import Mapping
from dataclasses import dataclass
from enum import IntEnum
from pathlib import Path
from typing import Annotated

import numpy as np
import pytest

from virtual_sensor import records
from virtual_sensor.errors import InputError
from virtual_sensor.records import (
    WITH_NORM,
    Record,
    Table,
    counts_of,
    documented,
    plain,
    status_names,
    unit_of,
    vectors,
    write_csv,
    write_json,
    write_ply,
)

SOURCES = Path(records.__file__).parent


class Status(IntEnum):
    """How something ends."""

    OK = 0
    NO_PEAK = 1


def read_ply(path):
    """Read the vertices of a binary PLY file, as the format's description says (Turk 1994)."""
    header, _, body = path.read_bytes().partition(b"end_header\n")
    lines = [line.split() for line in header.decode("ascii").splitlines()]
    assert lines[:2] == [["ply"], ["format", "binary_little_endian", "1.0"]]
    [count] = [int(words[2]) for words in lines if words[:2] == ["element", "vertex"]]
    properties = [words for words in lines if words[0] == "property"]
    assert {words[1] for words in properties} == {"float"}
    names = [words[2] for words in properties]
    values = np.frombuffer(body, "<f4")
    assert values.size == count * len(names)
    return dict(zip(names, values.reshape(count, len(names)).T, strict=True))


def test_a_table_reads_back_to_thirteen_digits(tmp_path):
    """Rationale: a pixel of 1234.567 must keep its 1e-9 px, and a number stay a number."""
    numbers = np.random.default_rng(5).normal(size=50) * 10.0 ** np.arange(-25, 25)
    write_csv(tmp_path / "t.csv", {"value": numbers, "column": np.arange(50)})
    read = np.genfromtxt(tmp_path / "t.csv", delimiter=",", names=True)
    np.testing.assert_allclose(read["value"], numbers, rtol=5e-13)
    np.testing.assert_array_equal(read["column"], np.arange(50))


def test_float32_reads_back_as_it_was_and_no_longer(tmp_path):
    """Rationale: nine digits tell every float32; more would tell of its rounding only."""
    numbers = np.random.default_rng(6).normal(size=200).astype(np.float32)
    write_csv(tmp_path / "t.csv", {"value": np.append(numbers, np.float32(0.1))})
    cells = (tmp_path / "t.csv").read_text().split()[1:]
    np.testing.assert_array_equal(np.array(cells[:-1], np.float32), numbers)
    assert max(len(cell.lstrip("-").replace(".", "").lstrip("0")) for cell in cells) <= 9


def test_text_with_commas_stays_in_its_cell(tmp_path):
    """Rationale: a list of dots, or a message, would shift all columns after it."""
    texts = ["0,-5", 'a "b"', "two\nlines", "plain"]
    write_csv(tmp_path / "t.csv", {"text": texts, "number": np.arange(4)})
    with (tmp_path / "t.csv").open(encoding="utf-8", newline="") as file:
        assert [row["text"] for row in csv.DictReader(file)] == texts
    assert (tmp_path / "t.csv").read_text().endswith("plain,3\n")


@pytest.mark.parametrize("kind", [np.float64, np.float32])
def test_nan_is_an_empty_cell(tmp_path, kind):
    """Rationale: every program takes an empty cell for a missing value, 'nan' not every one."""
    columns = {"u": np.array([1.5, np.nan, 2.5], kind), "status": ["ok", "no_peak", "ok"]}
    write_csv(tmp_path / "t.csv", columns)
    with (tmp_path / "t.csv").open(encoding="utf-8", newline="") as file:
        rows = list(csv.DictReader(file))
    assert [row["u"] for row in rows] == ["1.5", "", "2.5"]
    assert [row["status"] for row in rows] == ["ok", "no_peak", "ok"]
    read = np.genfromtxt(tmp_path / "t.csv", None, delimiter=",", names=True, encoding="utf-8")
    np.testing.assert_array_equal(read["u"], [1.5, np.nan, 2.5])


def test_a_table_without_rows_has_its_header(tmp_path):
    """Rationale: no result is a result, and its columns still have names."""
    write_csv(tmp_path / "t.csv", {"u": np.empty(0), "v": np.empty(0)})
    assert (tmp_path / "t.csv").read_text() == "u,v\n"


def test_columns_of_different_length_are_a_mistake_that_writes_nothing(tmp_path):
    """Rationale: cut to the shortest, rows would belong to no ray."""
    with pytest.raises(ValueError, match="shorter"):
        write_csv(tmp_path / "t.csv", {"u": np.zeros(3), "v": np.zeros(2)})
    assert list(tmp_path.iterdir()) == []


def test_a_table_without_a_place_is_the_users_error(tmp_path):
    """Rationale: a full path in the message is worth more than a traceback."""
    (tmp_path / "file").touch()
    with pytest.raises(InputError, match=r"file/t\.csv: can't be written"):
        write_csv(tmp_path / "file" / "t.csv", {"u": [1.0]})


def test_states_are_named_in_lower_case():
    """Rationale: numbers of an enumeration mean nothing in a table."""
    np.testing.assert_array_equal(
        status_names(np.array([0, 1, 0], np.uint8), Status), ["ok", "no_peak", "ok"]
    )


def test_vectors_become_one_column_per_axis():
    """Rationale: a cell holds one number, and its name says along which axis."""
    columns = vectors("pixel", np.array([[1.0, 2.0], [3.0, 4.0]]), "uv")
    assert {name: list(values) for name, values in columns.items()} == {
        "pixel_u": [1.0, 3.0],
        "pixel_v": [2.0, 4.0],
    }


def test_a_point_cloud_holds_the_points_that_there_are(tmp_path):
    """Rationale: a viewer draws NaN at the origin, or not at all; intensities stay with points."""
    points = np.random.default_rng(2).normal(scale=10.0, size=(6, 3))
    intensity = np.arange(6.0)
    points[1], points[4, 2] = np.nan, np.nan
    write_ply(tmp_path / "points.ply", points, intensity)
    read = read_ply(tmp_path / "points.ply")
    kept = [0, 2, 3, 5]
    np.testing.assert_array_equal(read["intensity"], intensity[kept])
    read_points = np.stack([read[axis] for axis in "xyz"], axis=1)
    np.testing.assert_allclose(read_points, points[kept], atol=1e-6)


def test_a_point_cloud_without_points_is_a_file_all_the_same(tmp_path):
    """Rationale: a part that no column shows gives an empty cloud, not a missing file."""
    write_ply(tmp_path / "points.ply", np.full((3, 3), np.nan), np.full(3, np.nan))
    assert read_ply(tmp_path / "points.ply")["x"].size == 0


def test_json_is_valid_where_there_is_no_answer(tmp_path):
    """Rationale: `NaN` is no JSON; 72 of 199 scenes wrote it; only Python reads it."""
    given = {
        "nothing": [np.nan, np.inf, float("nan"), np.float32("nan")],
        "array": np.array([[1.5, np.nan]]),
        "number": np.float64(0.25),
        "count": np.int64(3),
        "notes": ("25 °C",),
        2.5: None,
    }
    write_json(tmp_path / "a.json", given)

    def refuse(word):
        raise AssertionError(f"{word} is no JSON")

    text = (tmp_path / "a.json").read_text(encoding="utf-8")
    assert json.loads(text, parse_constant=refuse) == {
        "nothing": [None] * 4,
        "array": [[1.5, None]],
        "number": 0.25,
        "count": 3,
        "notes": ["25 °C"],
        "2.5": None,
    }


def test_all_json_of_results_comes_from_one_writer():
    """Rationale: the next study would write `NaN` again."""
    dumping = [
        file.relative_to(SOURCES).as_posix()
        for file in SOURCES.rglob("*.py")
        if "json.dumps(" in file.read_text(encoding="utf-8")
    ]
    keys_and_cells = {"studies/finished_cases.py", "studies/simulate.py", "reporting/chart.py"}
    cases = {"medium/heat_flow/case.py"}
    headers = {"studies/fringes/decoded_files.py", "imaging/image_metadata.py"}  # of what is plain
    assert set(dumping) <= {"records.py"} | keys_and_cells | cases | headers


@dataclass(frozen=True)
class Line(Table):
    """A line.

    Attributes
    ----------
    column_px : ndarray of shape (N,)
        Column of the image.
    point_mm, normal : ndarray of shape (N, 3)
        In the world.
    pixel : ndarray of shape (N, 2)
        Where it is seen,
        to a hundredth.
    status : sequence of str
        What became of it.
    dots : ndarray of shape (N,) or None
        None of a line.
    """

    column_px: np.ndarray
    point_mm: np.ndarray
    normal: np.ndarray
    pixel: np.ndarray
    status: list[str]
    dots: np.ndarray | None = None


@dataclass(frozen=True)
class Found(Record):
    """What was found.

    Attributes
    ----------
    rms_px : float
        Error.
    status : Status
        Of all.
    """

    rms_px: float
    status: Status


@dataclass(frozen=True)
class Summary(Record):
    """A summary.

    Attributes
    ----------
    states : dict of Found
        By name.
    hot : Found or None
        None of a cold part.
    path : Path
        Of the scene.
    """

    states: dict[str, Found]
    hot: Found | None
    path: Path


def line(number=4):
    """A table of some rows."""
    values = np.arange(float(number))
    three = values[:, None] + [0.0, 0.1, 0.2]
    return Line(values, three, three, three[:, :2], ["ok"] * number)


def test_a_tables_columns_are_its_documented_fields(tmp_path):
    """Rationale: a column that no dictionary lists must be guessed at."""
    columns = line().columns()
    assert list(columns) == [
        *("column_px", "point_mm_x", "point_mm_y", "point_mm_z"),
        *("normal_x", "normal_y", "normal_z", "pixel_u", "pixel_v", "status"),
    ]
    np.testing.assert_allclose(columns["point_mm_y"], np.arange(4) + 0.1)
    write_csv(tmp_path / "t.csv", line())
    with (tmp_path / "t.csv").open(encoding="utf-8", newline="") as file:
        rows = list(csv.DictReader(file))
    assert len(rows) == len(line()) == 4
    assert rows[3]["pixel_v"] == "3.1"
    words = {each.name: each.words for each in documented(Line)}
    assert words["point_mm"] == words["normal"] == "In the world."
    assert words["pixel"] == "Where it is seen, to a hundredth."


def test_a_table_is_a_data_frame():
    """Rationale: users of pandas should not have to read the CSV that we wrote."""
    frame = line().to_dataframe()
    assert list(frame.columns) == list(line().columns())
    assert frame["status"].tolist() == ["ok"] * 4


def test_without_pandas_the_remedy_is_named(monkeypatch):
    """Rationale: an ImportError names a module and no remedy."""
    monkeypatch.setitem(sys.modules, "pandas", None)
    with pytest.raises(InputError, match=r'pip install "virtual-sensor\[dataframe\]"'):
        line().to_dataframe()


def test_a_table_of_unequal_columns_is_a_mistake():
    """Rationale: cut to the shortest, rows would belong to no ray."""
    with pytest.raises(ValueError, match="different lengths"):
        dataclasses.replace(line(), status=["ok"]).columns()


@dataclass(frozen=True)
class Pairs(Table):
    """Values of two states.

    Attributes
    ----------
    shift_mm : ndarrays of shape (N, 2)
        From there to here.
    status : ndarrays of shape (N,)
        How it ended.
    """

    shift_mm: Annotated[Mapping[str, np.ndarray], "", "cold"] = dataclasses.field(
        metadata=WITH_NORM
    )
    status: Annotated[Mapping[str, np.ndarray], "cold", "hot"]


def test_a_mapping_makes_a_column_for_each_key():
    """Rationale: cold and hot columns are of one kind, said once; the unit still ends a name."""
    shift = np.array([[3.0, 4.0]])
    table = Pairs({"": shift, "cold": -shift}, {"cold": np.array(["ok"])})
    [row] = table.rows()
    assert row == {
        **{"shift_mm_u": 3.0, "shift_mm_v": 4.0, "shift_mm_norm": 5.0},
        **{"shift_cold_mm_u": -3.0, "shift_cold_mm_v": -4.0, "shift_cold_mm_norm": 5.0},
        "status_cold": "ok",
    }
    listed = {each.name: (each.unit, each.words) for each in documented(Pairs)}
    assert list(listed.items()) == [
        ("shift_mm", ("mm", "From there to here.")),
        ("shift_mm_norm", ("mm", "Its length.")),
        ("shift_cold_mm", ("mm", "From there to here.")),
        ("shift_cold_mm_norm", ("mm", "Its length.")),
        ("status_cold", ("", "How it ended.")),
        ("status_hot", ("", "How it ended.")),
    ]


def test_a_record_is_a_json_object(tmp_path):
    """Rationale: keys of files are the fields' names, and a status is a word."""
    summary = Summary({"cold": Found(np.nan, Status.NO_PEAK)}, None, Path("a/b.xml"))
    write_json(tmp_path / "s.json", summary)
    assert json.loads((tmp_path / "s.json").read_text()) == {
        "states": {"cold": {"rms_px": None, "status": "no_peak"}},
        "hot": None,
        "path": "a/b.xml",
    }
    assert summary.to_dict()["path"] == "a/b.xml"
    assert [(each.name, each.records) for each in documented(Summary)] == [
        ("states", (Found,)),
        ("hot", (Found,)),
        ("path", ()),
    ]
    assert [each.unit for each in documented(Found)] == ["px", ""]


def test_an_undocumented_field_is_found():
    """Rationale: the data dictionary is made of the fields' own words."""

    @dataclass(frozen=True)
    class Silent(Record):
        """No words.

        Attributes
        ----------
        other : float
            Is no field.
        """

        rms_px: float

    with pytest.raises(ValueError, match="rms_px"):
        documented(Silent)


def test_units_are_at_the_end_of_names():
    """Rationale: a number without its unit is a guess."""
    for name, unit in (
        ("rms_px", "px"),
        ("shift_um_norm", "µm"),
        ("point_mm_x", "mm"),
        ("gradient_per_mm", "1/mm"),
        ("temperature_c", "°C"),
        ("items", ""),
        ("status", ""),
    ):
        assert unit_of(name) == unit


def test_statuses_are_counted_by_name():
    """Rationale: those that never occurred are listed too: with 0."""
    assert counts_of([0, 1, 1], Status) == {"ok": 1, "no_peak": 2}
    assert plain({Status.OK: Status.NO_PEAK}) == {"ok": "no_peak"}
