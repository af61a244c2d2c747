"""The chart: one benchmark for all panels, fronts that hold what is best, nothing hidden."""

import subprocess
import sys
from dataclasses import replace

import numpy as np
import pytest
from invented_charts import failures, measured

from virtual_sensor.errors import InputError
from virtual_sensor.studies.chart import chart as charting
from virtual_sensor.studies.chart.benchmark import (
    Configuration,
    Score,
    Task,
    enough,
    front,
    measure,
    timed,
    with_fronts,
)
from virtual_sensor.studies.chart.chart import chart


def task(*configurations, name="a job", items=4, error_px=(0.3, -0.4, np.nan, np.nan)):
    """Four items, of which two have no result; 22 um are a pixel."""
    errors = np.array(error_px)
    score = lambda result: Score(result * errors, 22.0 * result * errors, 2, "as found")  # noqa: E731
    return Task(name, "the truth", items, score, configurations, 0.01)


@pytest.fixture
def clock(monkeypatch):
    """A clock that stands still; gives a function that makes work of so many seconds."""
    now = [0.0]
    monkeypatch.setattr("virtual_sensor.studies.chart.benchmark.time.perf_counter", lambda: now[0])

    def work(*seconds):
        lasts = iter(seconds)

        def run():
            now[0] += next(lasts)
            return now[0]

        return run

    return work


@pytest.fixture
def invented(monkeypatch):
    """Panels of two configurations each, that take no time; gives what they were asked."""
    asked = []

    def tasks_of(panel, quick):
        asked.append((panel, quick))
        names = ("leapfrog", "rk4")
        settings = {"step_mm": np.float64(2.0)}
        return [task(*(Configuration(n, "marched", lambda: lambda: 1.0, settings) for n in names))]

    monkeypatch.setattr(charting, "tasks_of", tasks_of)
    monkeypatch.setattr(charting, "cuda_found", lambda: False)
    monkeypatch.setattr(charting, "failures", lambda panels: failures())
    return asked


def dominated(one, others):
    """Whether another is at least as good in both, and better in one."""
    return any(
        o.time_s <= one.time_s
        and o.rms_px <= one.rms_px
        and (o.time_s, o.rms_px) != (one.time_s, one.rms_px)
        for o in others
    )


# -------------------------------------------------------------------------------------- benchmark


def test_times_are_medians_of_warm_runs(clock):
    """Rationale: the first run compiles, and one disturbed run must not count."""
    work = clock(50.0, 0.5, 0.9, 0.1, 0.2, 0.3)
    found = measure(
        "rays",
        task(Configuration("it", "marched", lambda: work)),
        *[Configuration("it", "marched", lambda: work)],
    )
    assert found.time_s == pytest.approx(0.3 / 4)


def test_long_work_runs_less_often(clock):
    """Rationale: a search of minutes must not be repeated five times."""
    assert timed(clock(4.0), limit_s=3.0) == (4.0, 4.0)
    assert timed(clock(1.0, 1.2, 1.1), limit_s=3.0)[0] == pytest.approx(1.1)


def test_a_cheaper_warm_up_takes_the_place_of_the_work(clock):
    """Rationale: as above; it must not be timed, and the work not be run for it."""
    warmed = []
    each = Configuration(
        "it", "marched", lambda: clock(2.0, 2.0, 2.0), warm_up=lambda: warmed.append(1)
    )
    assert measure("search", task(each), each).time_s == pytest.approx(2.0 / 4)
    assert warmed == [1]


def test_errors_and_counts_are_those_of_the_score():
    """Rationale: rms of 0.3 and 0.4, by hand; items without a result are counted, not judged."""
    each = Configuration(
        "rk4", "marched", lambda: lambda: 1.0, {"step_mm": 2}, {"a": 1}, note=lambda: "and more"
    )
    found = measure("rays", task(each), each)
    assert found.rms_px == pytest.approx(np.sqrt(0.125))
    assert found.largest_px == pytest.approx(0.4)
    assert found.rms_um == pytest.approx(22.0 * np.sqrt(0.125))
    assert (found.items, found.failed, found.bound_px) == (4, 2, 0.01)
    assert (found.panel, found.task, found.name, found.reference) == (
        "rays",
        "a job",
        "rk4",
        "the truth",
    )
    assert (found.chosen, found.defaults) == ({"step_mm": 2}, {"a": 1})
    assert found.note == "as found; and more"


# ------------------------------------------------------------------------------------------ front


def test_the_front_is_what_nothing_else_beats():
    """Rationale: against the definition, all pairs tried; on a coarse grid, so that many tie."""
    for seed in range(5):
        times, errors = np.random.default_rng(seed).integers(1, 12, (2, 40)).astype(float)
        rows = [measured(f"{i}", t, e) for i, (t, e) in enumerate(zip(times, errors, strict=True))]
        expected = {r.name for r in rows if not dominated(r, rows)}
        found = front(rows)
        assert {r.name for r in found} == expected
        assert [r.time_s for r in found] == sorted(r.time_s for r in found)
        assert [r.rms_px for r in found] == sorted((r.rms_px for r in found), reverse=True)


def test_what_fails_or_is_unknown_is_not_on_the_front():
    """Rationale: an error over the easy half of the items would beat every honest one."""
    honest = measured("honest", 5.0, 1.0, failed=5)
    others = [
        measured("unknown error", 1.0, np.nan),
        measured("unknown time", np.nan, 0.1),
        measured("all failed", 1.0, 0.1, failed=1000),
        measured("half failed", 1.0, 0.1, failed=500),
    ]
    assert front([honest, *others]) == [honest]
    assert front(others[:3]) == []
    assert front(others) == [others[3]]  # where all fail as often, it is the task that is hard


def test_tasks_have_fronts_of_their_own():
    """Rationale: errors against different references do not compare."""
    rows = [measured("good", 1.0, 1e-6), measured("bad", 2.0, 1.0, task="another")]
    rows += [measured("worse", 3.0, 2.0, task="another"), measured("bad", 2.0, 1.0, panel="search")]
    assert [r.on_front for r in with_fronts(rows)] == [True, True, False, True]


def test_enough_is_the_cheapest_that_no_sensor_tells_from_exact():
    """Rationale: below 0.01 px; where noise bounds the error, within a tenth of the bound."""
    rows = with_fronts(
        [measured("a", 1.0, 5.0), measured("b", 2.0, 9e-3), measured("c", 3.0, 1e-6)]
    )
    assert enough(rows).name == "b"
    assert enough(rows[:1]) is None
    noisy = [measured("a", 1.0, 0.030, bound_px=0.02), measured("b", 2.0, 0.0215, bound_px=0.02)]
    assert enough(with_fronts(noisy)).name == "b"


# ------------------------------------------------------------------------------------------ chart


def test_all_panels_come_together(invented):
    """Rationale: what a panel measures must reach the chart, with the variant it ran under."""
    said = []
    made = chart(["search", "rays"], quick=True, report=lambda *now: said.append(now))
    assert invented == [("rays", True), ("search", True)]
    assert made.panels == ["rays", "search"]
    assert made.tasks("rays") == ["a job"]
    assert [m.name for m in made.of("search", "a job")] == ["leapfrog", "rk4"]
    assert {m.defaults["variant"] for m in made.measured} == {made.machine.made_with.variant}
    assert all(made.front(panel, "a job") for panel in made.panels)
    fractions = [fraction for _, fraction in said]
    assert fractions == sorted(fractions)
    assert fractions[-1] <= 1.0
    assert made.scalings == ()
    assert any("quick" in words for words in made.notes)


def test_an_unknown_panel_is_refused_with_all_names():
    """Rationale: who mistypes a name wants to see the right ones, before minutes of measuring."""
    with pytest.raises(
        InputError,
        match="wheels: the chart has rays, frames, search, correction, fringes, camera, bounces, l",
    ):
        chart(["rays", "wheels"])


def test_the_gpus_rows_are_added_and_its_faults_told(invented, monkeypatch):
    """Rationale: another process measures them; if it fails, what the CPU gave stays."""
    seen = []

    def process(words, env, **options):
        seen.append((words, env["VIRTUAL_SENSOR_VARIANT"]))
        charting.hand_over(words[3], words[4].split(","), words[5] == "quick")
        return subprocess.CompletedProcess(words, 0, "", "")

    monkeypatch.setattr(charting, "cuda_found", lambda: True)
    monkeypatch.setattr(charting.subprocess, "run", process)
    made = chart(["rays", "search"], quick=True)
    assert len(made.measured) == 6
    ours, theirs = made.measured[:2], made.measured[4:]
    assert all("variant" not in m.chosen for m in ours)
    assert all("variant" in m.chosen for m in theirs)
    for one, other in zip(ours, theirs, strict=True):
        same = {"time_s": 0.0, "chosen": {}, "defaults": {}, "on_front": False}
        assert replace(one, **same) == replace(other, **same)
    ((words, variant),) = seen
    assert (words[0], words[4:], variant) == (sys.executable, ["rays", "quick"], "cuda_ad_mono")
    gone = subprocess.CompletedProcess([], 1, "", "a\nout of memory\n")
    monkeypatch.setattr(charting.subprocess, "run", lambda *_, **__: gone)
    made = chart(["rays"])
    assert len(made.measured) == 2
    assert any("its process ended with 1: out of memory" in words for words in made.notes)
    assert charting.on_gpu([], quick=True) == ([], [])
