"""A trial's tables, pictures and page; its headline chooses a detector for the task."""

import csv
import json
import sys
from concurrent.futures import ThreadPoolExecutor
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
from data_dictionary import undocumented
from typer.testing import CliRunner

from virtual_sensor.cli.commands import app
from virtual_sensor.errors import InputError
from virtual_sensor.reporting import trial as reporting
from virtual_sensor.reporting.style import colours
from virtual_sensor.studies.machine import machine
from virtual_sensor.studies.trial import trial as study
from virtual_sensor.studies.trial.hard import Sample, hard_condition
from virtual_sensor.studies.trial.images import STATED, Condition
from virtual_sensor.studies.trial.scores import PHASES, Phases, Score
from virtual_sensor.studies.trial.trial import Trial, conditions

OWN = "my_package.a_module_of_a_very_long_name:<my> $detector|"
NAMES = ("gaussian", "steger", OWN)


def score(condition, detector, ratio=1.2, time_us=5.0, lost=0.0, outliers=0.0):
    """A score whose error is so many times a bound of 0.01 px."""
    error = 0.01 * ratio
    return Score(
        *(condition.kind, condition.width_px, condition.column_electrons),
        *(condition.read_noise_electrons, detector, 0.0, error, error, error, 0.01),
        *(outliers, lost, outliers, 0.0, 0, np.nan, 100, time_us),
        amount=condition.amount,
    )


def of(*task, harder=()):
    """A trial with such scores in the task, and the same in all clean images."""
    clean = [c for c in conditions(STATED, quick=True) if c.kind == "clean"]
    scores = [replace(each, **vars(c)) for c in clean for each in task]
    biases = {(each.detector, 1.0): 0.01 * np.sin(2 * np.pi * PHASES) for each in task}
    return Trial(
        scores=(*scores, *harder, *task),
        phases=Phases.of(biases),
        samples=(),
        task=STATED,
        seed=1,
        columns=100,
        machine=machine(),
        time_s=3.0,
    )


@pytest.fixture(scope="module")
def drawn(tmp_path_factory):
    """A trial of three detectors, one of them a user's, and its folder."""
    figures = zip(NAMES, (1.05, 0.4, 1.9), (5, 60, 2), strict=True)
    task = [score(STATED, name, ratio, time_us) for name, ratio, time_us in figures]
    hard = Condition("speckle", 2.0, 6320.0, 2.0)
    harder = [score(hard, name, np.nan if name == OWN else 2.0, lost=0.2) for name in NAMES]
    clipped = [hard_condition("clipped frame", amount) for amount in (2.0, 8.0)]
    harder += [
        score(at, name, 3.0, outliers=0.1 * (name == OWN)) for at in clipped for name in NAMES
    ]
    trial = of(*task, harder=harder)
    grey = np.arange(600, dtype=np.uint16).reshape(20, 30)
    row = np.full(30, 9.5)
    sample = Sample(clipped[1], OWN, grey, row, np.arange(30.0), row)
    trial = replace(trial, samples=(sample,))
    folder = tmp_path_factory.mktemp("trial") / "out"
    reporting.save(trial, folder, "virtual-sensor trial --detector '<my>'")
    return trial, folder


def test_every_file_is_there_and_documented(drawn):
    """Six pictures, two tables, a page, its Markdown and a summary."""
    _, folder = drawn
    assert undocumented(folder, reporting.FILES) == []
    assert {p.name for p in folder.iterdir()} == {each.pattern for each in reporting.FILES}
    summary = json.loads((folder / "summary.json").read_text(encoding="utf-8"))
    assert summary["recommended"]["detector"] == "gaussian"
    assert summary["front"] == [OWN, "gaussian", "steger"]
    assert summary["task"]["width_px"] == 1.5
    with (folder / "phases.csv").open(encoding="utf-8") as file:
        rows = [row for row in csv.DictReader(file) if row["detector"] == OWN]
    np.testing.assert_allclose([float(r["phase_px"]) for r in rows], PHASES, atol=1e-12)
    bias = [float(r["bias_px"]) for r in rows]
    np.testing.assert_allclose(bias, 0.01 * np.sin(2 * np.pi * PHASES), atol=1e-12)


def test_the_page_opens_and_a_users_name_is_a_name(drawn, faults_of):
    """In a browser; the user's own detector stands beside ours in table and headline."""
    _, folder = drawn
    assert faults_of(folder / "report.html") == []
    page = (folder / "report.html").read_text(encoding="utf-8")
    assert "<my>" not in page
    assert page.count("&lt;my&gt;") > 3
    assert page.count("<img ") == 2 + 1 + 3 + 1 + 1 + 1 + 1
    table = (folder / "table.md").read_text(encoding="utf-8")
    assert "&lt;my> $detector\\| | 0.0190 | 1.90 |" in table


def test_the_headline_takes_the_fastest_within_a_tenth_of_the_bound():
    """Or the most accurate; never one that fails in every tenth column; or says that none finds."""
    fast = score(STATED, "fir8", 1.09, 3.0)
    near = score(STATED, "gaussian", 1.0, 5.0)
    poor = score(STATED, "parabola", 3.0, 1.0)
    broken = score(STATED, "fir4", 0.9, 0.5, lost=0.1)
    lost = score(STATED, "steger", np.nan, lost=1.0)
    for scores, best in (
        ((near, fast, poor, broken), "fir8"),
        ((poor, broken), "parabola"),
        ((lost,), None),
    ):
        trial = of(*scores)
        assert (trial.recommended.detector if best else trial.recommended) == best
        said = f"take {best}: " if best else "No detector finds a line of sigma 1.5 px"
        assert said in reporting.lead(trial)
    said = reporting.lead(of(fast, near))
    assert "with 5,000 e at its peak and 2 e of read noise, take fir8: 0.011 px rms, 1.09 ±" in said
    assert "gaussian: 1.00 ± 0.07 times the Cramér-Rao bound" in said


def test_hard_frames_have_a_table_and_what_breaks_its_promise_is_named(drawn):
    """The best is right in most columns, and keeps its promise; the others are counted."""
    trial, folder = drawn
    (first, last) = reporting.hard_table(trial).rows
    assert first[:2] == ("clipped frame, 2 times the full well", "gaussian")
    assert last[-1] == "1 of 3"
    said = reporting.honesty(trial)
    assert f"{OWN} in 2; most, 10.0%" in said
    summary = json.loads((folder / "summary.json").read_text(encoding="utf-8"))
    assert summary["breaches"] == 2
    assert reporting.honesty(replace(trial, scores=trial.scores[:3])).startswith("In no image")


def test_detectors_are_told_apart_by_colour_and_keep_it():
    """Ten of ours and two of a user's, whichever of them are asked for."""
    from virtual_sensor.metrology.detectors import NAMES as OURS

    all_of_them = colours((*OURS, "a:mine", "b:mine"))
    assert len(set(all_of_them.values())) == 12
    assert all(colours((name,))[name] == all_of_them[name] for name in OURS)
    own = reporting._Key(("gaussian", "a:mine")).colours
    assert own["a:mine"] not in {all_of_them[name] for name in OURS}
    key = reporting._Key((*OURS, "a:mine", "b:mine", OWN))
    assert len(set(key.names.values())) == 13
    assert key.names["a:mine"] == "a:mine"
    marks = {(key.line(n)["marker"], key.line(n)["ls"]) for n in key.detectors}
    assert len(marks) == 13


@pytest.fixture
def quick_trial(tmp_path, monkeypatch):
    """Run a quick trial of a detector of ours and a user's: its scores, summary and output."""
    monkeypatch.chdir(tmp_path)
    monkeypatch.setattr(sys, "path", list(sys.path))
    own = "def brightest(image): return image.argmax(axis=0)\n"
    Path("test_trial_mine.py").write_text(own, encoding="utf-8")
    monkeypatch.setattr(reporting, "draw", lambda trial: {})
    options = ["--quick", "--no-frames", "--columns", "100", "--seed", "3"]
    options += ["--detector", "centre_of_gravity", "--detector", "test_trial_mine:brightest"]

    def run(workers):
        folder = tmp_path / f"with_{workers}"
        ended = CliRunner().invoke(
            app, ["trial", *options, "--workers", str(workers), "-o", str(folder)]
        )
        assert ended.exit_code == 0, ended.output
        assert "Bold" not in ended.output  # a pipe has none
        with (folder / "scores.csv").open(encoding="utf-8") as file:
            scores = [{**row, "time_us": ""} for row in csv.DictReader(file)]
        return scores, json.loads((folder / "summary.json").read_text()), ended.output

    return run


def test_a_quick_trial_scores_all_kinds_of_images(quick_trial, monkeypatch):
    """With any detector: a user's own is found beside the command."""
    monkeypatch.setattr(study, "_pool", ThreadPoolExecutor)  # to start a process takes a second
    scores, summary, said = quick_trial(1)
    assert {row["detector"] for row in scores} == {
        "centre_of_gravity",
        "test_trial_mine:brightest",
    }
    kinds = {"clean", "task", "saturated", "speckle", "ambient light"}
    assert {row["kind"] for row in scores} == kinds
    assert summary["seed"] == 3
    assert "take centre_of_gravity" in said


@pytest.mark.slow
def test_a_quick_trial_is_the_same_for_any_number_of_processes(quick_trial):
    """The command's scores do not depend on who computed them; a user's own is found beside it."""
    scores = [quick_trial(workers)[0] for workers in (1, 2)]
    assert len(scores[0]) > 20
    assert scores[0] == scores[1]


def test_a_task_that_no_camera_has_and_a_files_name_are_refused_before_any_work(tmp_path):
    """In a line that says what to give."""
    for option, value, says in (
        ("--width", "nan", "width of the line is nan; give 0.3 to 8 px"),
        ("--peak", "1e6", "electrons at the peak is"),
        ("--read-noise", "-1", "read noise is -1"),
        ("-o", "scores.csv", "name a folder, such as -o scores"),
    ):
        ended = CliRunner().invoke(app, ["trial", "-o", str(tmp_path / "a"), option, value])
        assert isinstance(ended.exception, InputError), option
        assert says in str(ended.exception)
    assert list(tmp_path.iterdir()) == []
