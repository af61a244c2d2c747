"""The chart: fronts that hold what is best, tables that hold everything, and nothing hidden."""

import csv
import json
import subprocess
import sys
import types
from dataclasses import replace
from pathlib import Path

import cv2
import numpy as np
import pytest
from command_line import command

from virtual_sensor.errors import InputError
from virtual_sensor.studies.chart import chart as charting
from virtual_sensor.studies.chart.chart import PANELS, Chart, chart
from virtual_sensor.studies.chart.drawing import draw_chart, family, label
from virtual_sensor.studies.chart.pareto import pareto
from virtual_sensor.studies.chart.report import page, save_chart
from virtual_sensor.studies.chart.rows import read_rungs, rung_columns
from virtual_sensor.studies.chart.rung import Failure, Rung, Scaling, timed
from virtual_sensor.studies.tables import write_csv

TABLES = {"rungs.csv", "failures.csv", "scaling.csv", "front.md"}
FILES = TABLES | {"chart.png", "index.html", "summary.json"}


def rung(panel="rays", name="leapfrog", seconds=1e-6, error=1e-3, items=1000, failed=0, **settings):
    """An invented rung."""
    um = 22.0 * error if panel != "lines" else np.nan
    values = (error, 3.0 * error, um, seconds, PANELS[panel].counted, items, failed)
    return Rung(panel, name, settings, *values, "float64, say", 'a "note", with a comma')


def failure(what, method="leapfrog"):
    """An invented failure."""
    return Failure(what, method, "8 mm", "1 to 8 mm", "OUT_OF_STEPS <& counted>", 3, 10, "a note")


@pytest.fixture
def invented(monkeypatch):
    """Two panels whose modules give two rungs and a failure each; gives what they were asked."""
    asked = []

    def module(name, **functions):
        made = types.ModuleType(f"virtual_sensor.studies.chart.{name}")
        made.__dict__.update(functions)
        monkeypatch.setitem(sys.modules, made.__name__, made)

    for panel in ("rays", "search"):

        def rungs(report, quick=False, panel=panel):
            asked.append((panel, quick))
            report("half", 0.5)
            return [rung(panel), rung(panel, "RK4", 4e-6, 1e-6, step=np.float64(2.0))]

        def failures(report, quick=False, panel=panel):
            report("all", 1.0)
            return [failure(f"trouble of {panel}")]

        module(PANELS[panel].rungs, rungs=rungs)
        module(PANELS[panel].failures, failures=failures)
    monkeypatch.setattr(charting, "cuda_found", lambda: False)
    return asked


@pytest.fixture(scope="module")
def example():
    """A chart of four panels with one rung that nobody knows the error of."""
    rng = np.random.default_rng(3)
    rungs = [
        rung(panel, f"{name}, {kind}", 10.0 ** rng.uniform(-7, -4), 10.0 ** rng.uniform(-5, 0), h=h)
        for panel in PANELS
        for name in ("Euler", "RK4", "marched")
        for kind in ("single", "double")
        for h in (1, 2, 4)
    ]
    rungs.append(rung("rays", "unknown", error=np.nan))
    scalings = [Scaling("frame, samples", 0.8, ((1.0, 0.5), (4.0, 1.5)), "about")]
    failures = [failure("trouble one"), failure("trouble <two>")]
    return Chart(rungs, failures, scalings, {"processor": "an <abacus>"}, ("told so",), 12.0)


@pytest.fixture(scope="module")
def saved(example, tmp_path_factory):
    """Its folder."""
    folder = tmp_path_factory.mktemp("chart") / "charted"
    save_chart(example, folder)
    return folder


def dominated(one, others):
    """Whether another is at least as good in both, and better in one."""
    return any(
        o.seconds <= one.seconds
        and o.error_px <= one.error_px
        and (o.seconds, o.error_px) != (one.seconds, one.error_px)
        for o in others
    )


@pytest.mark.parametrize("seed", range(5))
def test_the_front_is_what_nothing_else_beats(seed):
    """Rationale: against the definition, all pairs tried; on a coarse grid, so that many tie."""
    times, errors = np.random.default_rng(seed).integers(1, 12, (2, 40)).astype(float)
    rungs = [
        rung(name=str(i), seconds=t, error=e)
        for i, (t, e) in enumerate(zip(times, errors, strict=True))
    ]
    expected = {r.name for r in rungs if not dominated(r, rungs)}
    found = pareto(rungs)
    assert {r.name for r in found} == expected
    assert [r.seconds for r in found] == sorted(r.seconds for r in found)
    assert [r.error_px for r in found] == sorted((r.error_px for r in found), reverse=True)


def test_what_fails_or_is_unknown_is_not_on_the_front():
    """Rationale: an error over the easy half of the items would beat every honest one."""
    honest = rung(name="honest", seconds=5.0, error=1.0, failed=5)
    others = [
        rung(name="unknown error", seconds=1.0, error=np.nan),
        rung(name="unknown time", seconds=np.nan, error=0.1),
        rung(name="all failed", seconds=1.0, error=0.1, failed=1000),
        rung(name="half failed", seconds=1.0, error=0.1, failed=500),
    ]
    assert pareto([honest, *others]) == [honest]
    assert pareto(others[:3]) == []
    assert pareto(others) == [others[3]]  # where all fail as often, it is the task that is hard


def test_all_panels_come_together(invented):
    """Rationale: what a panel measures must reach the chart, with the variant it ran under."""
    told = []
    made = chart(["search", "rays"], quick=True, report=lambda *now: told.append(now))
    assert invented == [("rays", True), ("search", True)]
    assert made.panels == ["rays", "search"]
    assert [f.what for f in made.failures] == ["trouble of rays", "trouble of search"]
    assert all(r.settings["variant"] == made.machine["variant"] for r in made.rungs)
    assert [r.name for r in made.front("rays")] == ["leapfrog", "RK4"]
    fractions = [fraction for _, fraction in told]
    assert fractions == sorted(fractions)
    assert fractions[-1] <= 1.0
    assert {"processor", "cores", "threads", "mitsuba", "date"} <= made.machine.keys()
    assert made.scalings == []
    assert any("quick" in words for words in made.notes)


def test_an_unknown_panel_is_refused_with_all_names(tmp_path):
    """Rationale: who mistypes a name wants to see the right ones, before minutes of measuring."""
    with pytest.raises(InputError, match="wheels: the chart has rays, frames, search, lines"):
        chart(["rays", "wheels"])
    status, out, err = command("chart", "--panel", "wheels", "-o", tmp_path / "c")
    assert (status, out) == (2, "")
    assert "--panel wheels: the chart has rays, frames, search, lines" in err
    assert list(tmp_path.iterdir()) == []


def test_the_command_writes_everything_and_tells_the_fronts(invented, tmp_path):
    """Rationale: the folder is what the help promises, and another run replaces it if asked."""
    folder = tmp_path / "charted"
    status, out, err = command("chart", "--quick", "--panel", "rays", "-o", folder)
    assert (status, err) == (0, "")
    assert {path.name for path in folder.iterdir()} == FILES | {"rays.png"}
    assert f"look at {folder}/index.html first" in out
    assert "Bent rays: the front" in out
    assert "RK4" in out
    assert invented == [("rays", True)]
    status, _, err = command("chart", "--panel", "rays", "-o", folder)
    assert status == 2
    assert "say --overwrite" in err
    assert len(invented) == 1  # refused before any work
    options = ["--panel", "rays", "--panel", "search", "-o", folder, "--overwrite"]
    assert command("chart", *options)[0] == 0
    assert {path.name for path in folder.iterdir()} == FILES | {"rays.png", "search.png"}


def test_a_panel_that_fails_leaves_no_folder(invented, monkeypatch, tmp_path):
    """Rationale: half a chart would be taken for a whole one."""

    def broken(report, quick=False):
        raise InputError("no such field")

    module = sys.modules["virtual_sensor.studies.chart.ray_failures"]
    monkeypatch.setattr(module, "failures", broken)
    status, _, err = command("chart", "--panel", "rays", "-o", tmp_path / "charted")
    assert status == 2
    assert "no such field" in err
    assert list(tmp_path.iterdir()) == []


def test_rungs_are_read_back_as_they_were(example, tmp_path):
    """Rationale: the table is how another process hands its rows over, and what users plot."""
    odd = rung("lines", "Steger", settings_of='a, "b"', values=np.arange(3), h=np.float32(0.5))
    rungs = [*example.rungs, odd]
    write_csv(tmp_path / "rungs.csv", rung_columns(rungs, example.front("rays")))
    back = read_rungs(tmp_path / "rungs.csv")
    expected = [*rungs[:-1], replace(odd, settings=odd.settings | {"values": [0, 1, 2], "h": 0.5})]
    for one, other in zip(back, expected, strict=True):
        for name, value in vars(other).items():
            if isinstance(value, float):
                assert getattr(one, name) == pytest.approx(value, rel=1e-12, nan_ok=True)
            else:
                assert getattr(one, name) == value
    (tmp_path / "other.csv").write_text("panel,name\nrays,x\n")
    with pytest.raises(InputError, match=r"other\.csv: can't be read as a table of rungs"):
        read_rungs(tmp_path / "other.csv")


def test_the_folder_holds_every_rung_and_every_failure(example, saved):
    """Rationale: CSV for programs, a page for people; neither may lose a row."""
    assert {path.name for path in saved.iterdir()} == FILES | {f"{panel}.png" for panel in PANELS}
    tables = {}
    for name in ("rungs", "failures", "scaling"):
        with (saved / f"{name}.csv").open(encoding="utf-8", newline="") as file:
            tables[name] = list(csv.DictReader(file))
    assert len(tables["rungs"]) == len(example.rungs)
    assert [f["what"] for f in tables["failures"]] == ["trouble one", "trouble <two>"]
    assert [row["size"] for row in tables["scaling"]] == ["1", "4"]
    front = [r for panel in PANELS for r in example.front(panel)]
    best = [row for row in tables["rungs"] if row["on_front"] == "yes"]
    assert [(row["panel"], row["name"]) for row in best] == [
        (r.panel, r.name) for r in example.rungs if r in front
    ]
    figures = json.loads((saved / "summary.json").read_text(encoding="utf-8"))
    assert sum(map(len, figures["fronts"].values())) == len(front)


def test_the_page_hides_nothing(example):
    """Rationale: each failure and its status, each rung, the machine; and no raw < of theirs."""
    text = page(example)
    for words in ("trouble one", "trouble &lt;two&gt;", "OUT_OF_STEPS &lt;&amp; counted&gt;"):
        assert words in text
    assert "an &lt;abacus&gt;" in text
    assert "told so" in text
    assert text.count('<tr class="front">') == sum(len(example.front(p)) for p in PANELS)
    for panel in PANELS:
        section = text.split(f"<h2>{PANELS[panel].title}</h2>")[1].split("<h2>")[0]
        assert section.count("<tr") == 1 + len(example.of(panel))
        assert f'src="{panel}.png"' in section
    assert ">unknown</td>" in text
    assert "nan" not in text


def test_pictures_are_as_wide_as_promised_and_show_the_front(example, saved, tmp_path):
    """Rationale: 1600 px for four panels; drawn even where a panel has nothing to draw."""
    picture = cv2.imread(str(saved / "chart.png"))
    assert picture.shape[1] == 1600
    blue = (picture == [0xB2, 0x72, 0x00]).all(axis=-1)  # the first family's, BGR
    assert blue.sum() > 500
    lost = replace(example, rungs=[rung(error=np.nan)])
    assert draw_chart(lost, tmp_path) == ["chart.png", "rays.png"]


def test_labels_tell_namesakes_apart():
    """Rationale: four marks called 'marched' say nothing; settings that all share say nothing."""
    rungs = [rung(name="marched", spp=spp, step=2) for spp in (1, 4)]
    rungs += [rung(name="straight", spp=1), rung(name="marched", spp=1, step=2, variant="cuda_x")]
    assert [label(r, rungs[:3]) for r in rungs[:3]] == [
        "marched, spp 1",
        "marched, spp 4",
        "straight",
    ]
    assert label(rungs[3], rungs) == "marched, spp 1, variant cuda_x"
    assert family(rung(name="marched, linear")) == "marched"
    assert family(rungs[3]) == "marched, GPU"


def test_the_gpus_rows_are_added_and_its_faults_told(invented, monkeypatch):
    """Rationale: another process measures them; if it fails, what the CPU gave stays."""
    seen = []

    def process(words, **options):
        seen.append(words)
        folder = Path(words[words.index("-o") + 1])
        folder.mkdir()
        rows = [rung("rays", "leapfrog", 1e-9, variant="cuda_ad_mono")]
        write_csv(folder / "rungs.csv", rung_columns(rows, rows))
        return subprocess.CompletedProcess(words, 0, "", "")

    monkeypatch.setattr(charting, "cuda_found", lambda: True)
    monkeypatch.setattr(charting.subprocess, "run", process)
    made = chart(["rays", "search"], quick=True)
    assert [r.settings["variant"] for r in made.of("rays")][-1] == "cuda_ad_mono"
    assert len(made.rungs) == 5
    (words,) = seen
    assert words[-1] == "--quick"
    assert [words[i + 1] for i, word in enumerate(words) if word == "--panel"] == ["rays"]
    assert words[words.index("--variant") + 1] == "cuda_ad_mono"
    gone = subprocess.CompletedProcess([], 1, "", "a\nout of memory\n")
    monkeypatch.setattr(charting.subprocess, "run", lambda *_, **__: gone)
    made = chart(["rays"])
    assert len(made.rungs) == 2
    assert any("its process ended with 1: out of memory" in words for words in made.notes)


def test_times_are_medians_of_warm_runs(monkeypatch):
    """Rationale: the first run compiles, and one disturbed run must not count."""
    now, lasts = [0.0], iter([50.0, 1.0, 9.0, 2.0])
    monkeypatch.setattr("virtual_sensor.studies.chart.rung.time.perf_counter", lambda: now[0])

    def work():
        now[0] += next(lasts)

    assert timed(work, runs=3) == 2.0
