"""The chart as people see it: how little is enough, named in picture, page, table and console."""

import csv
import io
import json
from dataclasses import replace
from unittest import mock

import invented_charts
import numpy as np
import pytest
from command_line import command
from data_dictionary import undocumented
from invented_charts import NASTY, measured
from matplotlib.colors import to_rgb
from matplotlib.figure import Figure
from PIL import Image

from virtual_sensor.errors import InputError
from virtual_sensor.reporting import chart as words
from virtual_sensor.reporting.chart import (
    FILES,
    TITLES,
    configuration_in_words,
    draw_chart,
    draw_other_tasks,
    front_table,
    headline,
    numbered,
    save,
)
from virtual_sensor.reporting.style import MARKERS
from virtual_sensor.studies.chart import chart as charting
from virtual_sensor.studies.chart.benchmark import enough, with_fronts
from virtual_sensor.studies.chart.chart import PANELS

TABLES = {"configurations.csv", "failures.csv", "scaling.csv", "front.md"}
NAMES = TABLES | {"chart.png", "report.html", "summary.json"}


@pytest.fixture(scope="module")
def example():
    return invented_charts.chart()


@pytest.fixture(scope="module")
def picture(example):
    return draw_chart(example)


@pytest.fixture(scope="module")
def saved(example, picture, tmp_path_factory):
    """Its folder."""
    folder = tmp_path_factory.mktemp("chart") / "charted"
    with mock.patch.object(words, "draw_chart", return_value=picture):
        save(example, folder, f"virtual-sensor chart -o '{NASTY}'")
    return folder


def pixels(png):
    """A picture (H, W, 3)."""
    return np.asarray(Image.open(io.BytesIO(png)).convert("RGB"))


def in_colour(image, colour):
    """How many pixels have a colour."""
    return int((image == np.rint(255 * np.array(to_rgb(colour)))).all(axis=-1).sum())


# ------------------------------------------------------------------------------------------ words


def test_settings_are_named_in_plain_words():
    """Rationale: four marks called 'marched', or bare numbers, say nothing."""
    expected = {
        "tabulated, 16 samples per pixel": measured("tabulated", samples_per_pixel=16),
        "marched, 1 sample per pixel, 2-D field": measured(
            "marched", samples_per_pixel=1, dimensions=2
        ),
        "leapfrog, 0.5 mm steps, float32": measured("leapfrog", step_mm=0.5, precision="single"),
        "RK4, 4 mm steps, float64, linear field": measured(
            "rk4", step_mm=4.0, precision="double", interpolation="linear"
        ),
        "Dormand-Prince 5(4), tolerance 1e-06 mm": measured("dopri5", tolerance_mm=1e-6),
        "tabulated, tolerance 0.05 px, GPU": measured(
            "tabulated", tolerance_px=0.05, variant="cuda_ad_mono"
        ),
        "paper's search, 0.5 mm steps, grid of 32 px, 15 halvings": measured(
            "paper", step_mm=0.5, grid_px=32.0, halvings=15
        ),
        "Newton ray by ray, leapfrog, 8 mm steps": measured(
            "newton_by_ray", method="leapfrog", step_mm=8.0
        ),
        "centre of gravity": measured("centre_of_gravity"),
    }
    assert [configuration_in_words(each) for each in expected.values()] == list(expected)


def test_the_headline_names_what_is_enough_for_each_job(example):
    """Rationale: this is what a reader comes for; where noise bounds the error, it says so."""
    rows = [
        measured("straight", 1e-9, 11.0),
        measured("tabulated", 3e-7, 1e-3, tolerance_px=0.05),
        measured("rk4", 1e-5, 1e-6),
        measured("gaussian", 2e-6, 0.0215, "lines", bound_px=0.02),
        measured("straight", 1e-9, 11.0, "search"),
    ]
    assert headline(replace(example, measured=with_fronts(rows))) == (
        "How little is enough for 0.01 px? Rays: tabulated, tolerance 0.05 px (300 ns). Laser"
        " points: nothing errs less than 0.01 px. Line centres: Gaussian fit (2 µs; the noise"
        " allows 0.02 px)."
    )


def test_the_readmes_table_marks_what_is_enough(example):
    """Rationale: one row for each of the fronts, and no settings without their names."""
    text = front_table(example).markdown()
    fronts = [example.front(panel, example.tasks(panel)[0]) for panel in PANELS]
    assert text.count("\n") == 2 + sum(map(len, fronts))
    for front in fronts:
        assert f"{configuration_in_words(enough(front))} (enough)" in text


def test_what_is_enough_has_a_number_and_nearly_equals_share_one():
    """Rationale: a key of ten lines that differ by a per cent hides the two that matter."""
    errors = (1.0, 0.9, 0.0101, 0.0099, 0.0098, 1e-3)
    rows = with_fronts([measured(f"{i}", 1.0 + i, e) for i, e in enumerate(errors)])
    assert [each.name for each in numbered(rows)] == ["0", "2", "3", "5"]
    assert enough(rows).name == "3"


# ---------------------------------------------------------------------------------------- picture


def test_the_picture_has_a_panel_for_each_job_and_rings_what_is_enough(picture):
    """Rationale: each can be read alone, on a phone; the ring is what one wants first."""
    assert [panel.title for panel in picture.panels] == list(TITLES.values())
    assert pixels(picture.png).shape[1] == 1280
    for panel in picture.panels:
        assert panel.width_px == 640
        assert "Enough: " in panel.alt
        assert in_colour(pixels(panel.png), words._ENOUGH) > 200
        assert in_colour(pixels(panel.png), "#0072B2") > 100  # marched, on every page


def test_other_tasks_stand_beside_each_other_and_not_on_the_same_axes(example):
    """Rationale: errors against different references do not compare."""
    for panel in PANELS:
        (other,) = draw_other_tasks(example, panel).panels
        assert other.title.startswith("Another job")
    main = with_fronts([m for m in example.measured if m.task == "the main job"])
    assert draw_other_tasks(replace(example, measured=main), "rays") is None


def test_a_panel_without_any_error_is_drawn(example):
    """Rationale: a GPU may give none; the other panels must come out all the same."""
    lost = replace(example, measured=(measured(error_px=np.nan),))
    (panel,) = draw_chart(lost).panels
    assert "nothing errs less than 0.01 px" in panel.alt
    (front,) = words.front_tables(lost)
    assert front.rows == ()


def test_what_the_gpu_measured_looks_like_its_kind_and_is_told_apart():
    """Rationale: the same colours and markers; a legend of twice as many would hide the panel."""
    rows = [measured(n, t, 1e-3 / t) for n, t in (("euler", 1.0), ("rk4", 2.0))]
    rows += [replace(r, time_s=r.time_s / 2.0, chosen={"variant": "cuda_ad_mono"}) for r in rows]
    axes = Figure().add_subplot()
    words._draw_small(with_fronts(rows), axes)
    legend = [text.get_text() for text in axes.get_legend().get_texts()]
    assert legend == ["Euler", "RK4", "half: on the GPU"]
    marks = [line for line in axes.lines if line.get_marker() in MARKERS[:2] and line.get_ms() < 10]
    assert [line.get_fillstyle() for line in marks] == ["full", "full", "left", "left"]
    assert [line.get_marker() for line in marks] == [*MARKERS[:2], *MARKERS[:2]]


def test_ticks_are_few_and_hold_what_a_sensor_resolves():
    """Rationale: 0.01 px is the one line of the chart that everybody needs."""
    for low, high in ((1e-8, 30.0), (5e-5, 20.0), (0.008, 0.07), (9e-3, 1.2e-2), (2e-9, 3e-4)):
        ticks = words._ticks(low, high)
        assert 1 <= len(ticks) <= 8
        assert all(low <= tick <= high for tick in ticks)
        assert any(np.isclose(ticks, 0.01)) == (low < 0.01 < high)


# ------------------------------------------------------------------------------------------ files


def test_the_folder_holds_every_configuration_and_every_failure(example, saved):
    """Rationale: CSV for programs, a page for people; neither may lose a row."""
    assert {path.name for path in saved.iterdir()} == NAMES | {f"{panel}.png" for panel in PANELS}
    assert undocumented(saved, FILES) == []
    tables = {}
    for name in ("configurations", "failures", "scaling"):
        with (saved / f"{name}.csv").open(encoding="utf-8", newline="") as file:
            tables[name] = list(csv.DictReader(file))
    rows = tables["configurations"]
    assert len(rows) == len(example.measured)
    for row, each in zip(rows, example.measured, strict=True):
        assert json.loads(row["chosen"]) == each.chosen
        assert float(row["time_s"]) == pytest.approx(each.time_s, rel=1e-12)
        assert float(row["rms_px"] or "nan") == pytest.approx(each.rms_px, rel=1e-12, nan_ok=True)
        assert row["on_front"] == ("yes" if each.on_front else "no")
        assert (row["task"], row["note"]) == (each.task, each.note)
    assert [f["trouble"] for f in tables["failures"]] == ["trouble one", f"trouble {NASTY}"]
    assert [row["size"] for row in tables["scaling"]] == ["1", "4", "1"]
    figures = json.loads((saved / "summary.json").read_text(encoding="utf-8"))
    assert sum(map(len, figures["fronts"].values())) == sum(m.on_front for m in example.measured)
    assert figures["enough"]["rays"]["name"] == enough(example.of("rays", "the main job")).name


def test_the_page_hides_nothing(example, saved):
    """Rationale: each failure, each configuration, the machine; and no raw < of theirs."""
    text = (saved / "report.html").read_text(encoding="utf-8")
    assert "<script>" not in text
    for said in ("trouble one", "trouble &lt;script&gt;", "OUT_OF_STEPS", "an &lt;script&gt;"):
        assert said in text
    assert "a note &lt;script&gt;" in text
    for panel, title in TITLES.items():
        section = text.split(f">{title}</h2>")[1].split("</section>")[0]
        front = example.front(panel, "the main job")
        every = [m for m in example.measured if m.panel == panel]
        assert section.count("<tr") == 3 + len(front) + len(every)
        assert section.count("<img") == 2
    assert ">unknown<" in text
    assert ">nan" not in text


def test_the_page_opens_in_a_browser(saved, faults_of):
    """Rationale: on a phone and a desk, light and dark."""
    assert faults_of(saved / "report.html") == []


# ---------------------------------------------------------------------------------------- command


@pytest.fixture
def invented(monkeypatch, example):
    """A chart that takes no time; gives what was asked of it."""
    asked = []

    def chart(panels, quick, report):
        asked.append((list(panels), quick))
        report("half", 0.5)
        names = panels or list(PANELS)
        return replace(example, measured=tuple(m for m in example.measured if m.panel in names))

    monkeypatch.setattr(charting, "chart", chart)
    return asked


def test_the_command_writes_everything_and_prints_the_fronts(invented, tmp_path, unpainted_test):
    """Rationale: the folder is what the help promises, and another run replaces it if asked."""
    folder = tmp_path / "charted"
    status, out, err = command("chart", "--quick", "--panel", "rays", "-o", folder)
    assert (status, err) == (0, "")
    assert {path.name for path in folder.iterdir()} == NAMES | {"rays.png"}
    assert "Bent rays: the Pareto front" in out
    assert "How little is enough for 0.01 px? Rays: " in out
    assert "mm steps, float" in out
    assert f"open {folder}/report.html first" in out
    assert invented == [(["rays"], True)]
    status, _, err = command("chart", "--panel", "rays", "-o", folder)
    assert status == 2
    assert "say --overwrite" in err
    assert len(invented) == 1  # refused before any work
    options = ["--panel", "rays", "--panel", "search", "-o", folder, "--overwrite"]
    assert command("chart", *options)[0] == 0
    assert {path.name for path in folder.iterdir()} == NAMES | {"rays.png", "search.png"}


def test_a_panel_that_fails_leaves_no_folder(monkeypatch, tmp_path):
    """Rationale: half a chart would be taken for a whole one."""

    def broken(panel, quick):
        raise InputError("no such field")

    monkeypatch.setattr(charting, "tasks_of", broken)
    status, _, err = command("chart", "--panel", "rays", "-o", tmp_path / "charted")
    assert status == 2
    assert "no such field" in err
    assert list(tmp_path.iterdir()) == []


def test_an_unknown_panel_ends_the_command(tmp_path):
    """Rationale: who mistypes a name wants to see the right ones."""
    status, out, err = command("chart", "--panel", "wheels", "-o", tmp_path / "c")
    assert (status, out) == (2, "")
    assert (
        "--panel wheels: the chart has rays, frames, search, correction, fringes, camera, bounces,"
        " lines" in err
    )
    assert list(tmp_path.iterdir()) == []
