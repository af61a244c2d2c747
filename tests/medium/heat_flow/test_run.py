"""Runs of real OpenFOAM on a coarse section: killed and gone on with, spread, spoilt."""

import json
import re
import shutil
import signal
import subprocess
import sys
from pathlib import Path

import numpy as np
import pytest

from virtual_sensor.errors import InputError
from virtual_sensor.medium.heat_flow import run
from virtual_sensor.medium.heat_flow.case import whole_step
from virtual_sensor.medium.heat_flow.prepare import (
    make_mesh,
    prepare_case,
    reconstruct,
    set_parameters,
)
from virtual_sensor.medium.heat_flow.run import Progress, next_leg, run_case
from virtual_sensor.medium.heat_flow.saved import series, times
from virtual_sensor.medium.heat_flow.setup import HeatFlow
from virtual_sensor.medium.heat_flow.solver import Step, Watch

FLOW = HeatFlow(section=True, cell_mm=4.0)
END, INTERVAL = 0.3, 0.1
# Of 1230 K. What is left: at the first step again, the solver's change of kinetic energy is 0.
SAME_K = 1e-4


PERIOD_S = 0.01  # these coarse sections take milliseconds a step: check them often


@pytest.fixture(autouse=True)
def _closely_watched(monkeypatch):
    monkeypatch.setattr(run, "PERIOD_S", PERIOD_S)


@pytest.fixture(scope="session")
def meshed(openfoam, tmp_path_factory):
    """A case with its mesh, not yet run."""
    folder = tmp_path_factory.mktemp("meshed") / "case"
    prepare_case(FLOW, folder, END, INTERVAL)
    make_mesh(openfoam, folder)
    return folder


@pytest.fixture(scope="session")
def uninterrupted(meshed, tmp_path_factory):
    """A case that was run in one go, and the progress reported meanwhile."""
    folder = copied(meshed, tmp_path_factory.mktemp("uninterrupted"))
    told = []
    end = run_case(folder, END, report=told.append)
    assert (end.time_s, end.stopped) == (END, False)
    return folder, told


def copied(folder, place):
    return Path(shutil.copytree(folder, place / "case"))


def temperature(folder, time="0.3"):
    """Temperatures of the cells, K."""
    content = (folder / time / "T").read_bytes()
    head = re.search(rb"internalField\s+nonuniform List<scalar>\s*(\d+)\s*\(", content)
    return np.frombuffer(content, count=int(head[1]), offset=head.end())


def names(folder):
    return [saved.name for saved in times(folder)]


def poison(folder):
    """Have the flow diverge: air of negative viscosity."""
    set_parameters(folder, sutherlandA="-1e-3")


def test_a_run_writes_its_times_and_tells_its_progress(uninterrupted):
    """Rationale: a run of hours that says nothing is a run that gets killed."""
    folder, told = uninterrupted
    assert names(folder) == ["0", "0.1", "0.2", "0.3"]
    assert np.ptp(temperature(folder)) > 1000.0
    assert [p.stage for p in told[:3]] == ["meshing", "distributing", "solving"]
    solving = [p for p in told if p.stage == "solving"]
    assert [p.time_s for p in solving] == sorted({p.time_s for p in solving})
    last = solving[-1]
    assert (last.time_s, last.end_s, last.seconds_left) == (END, END, 0.0)
    assert 0.0 < last.step.courant < 9.0
    assert {"Uy", "Uz", "h", "p"} <= last.step.residuals.keys()
    when, columns = series(folder, "extremes")
    assert when[-1] > 0.2
    assert columns["max(T)"][-1] == pytest.approx(293.15 + 1230.0 * when[-1] / 0.25, abs=1e-3)


RUN = """
import signal, sys
from pathlib import Path
from virtual_sensor.medium.heat_flow import run
from virtual_sensor.medium.heat_flow.run import Interrupted, run_case
run.PERIOD_S = float(sys.argv[3])
signal.signal(signal.SIGTERM, lambda number, _: sys.exit(128 + number))
def told(progress):
    print(progress.time_s, flush=True)
try:
    run_case(Path(sys.argv[1]), 0.3, processes=int(sys.argv[2]), report=told)
except Interrupted as interrupted:
    print(interrupted, flush=True)
    raise
"""


def killed(folder, blow, after_s, processes=1):
    """Kill a run once it is beyond some time; give status, that time and the last words."""
    line = [sys.executable, "-c", RUN, str(folder), str(processes), str(PERIOD_S)]
    with subprocess.Popen(line, stdout=subprocess.PIPE, text=True) as process:
        reached = next(t for t in map(float, process.stdout) if t > after_s)
        process.send_signal(blow)
        words = process.communicate()[0].splitlines()
    return process.returncode, reached, words[-1] if words else ""


@pytest.mark.parametrize(
    ("blow", "status"),
    [("SIGINT", 130), ("SIGTERM", 143), ("SIGKILL", -signal.SIGKILL)],
)
@pytest.mark.slow
def test_a_killed_run_goes_on_to_the_same_end(uninterrupted, meshed, tmp_path, blow, status):
    """Rationale: Ctrl-C, a batch queue's limit, the out-of-memory killer: no time step is lost."""
    folder = copied(meshed, tmp_path)
    returned, reached, words = killed(folder, getattr(signal, blow), 0.03)
    assert returned == status
    starts = []
    assert run_case(folder, END, report=lambda p: starts.append(p.time_s)).time_s == END
    assert reached <= starts[0] < END
    if blow != "SIGKILL":  # which leaves no time for words
        assert words.startswith(f"stopped at {starts[0]:.8g} s of flow; the same command goes on")
    assert {"0", "0.1", "0.2", "0.3", f"{starts[0]:.8g}"} <= set(names(folder))
    assert abs(temperature(folder) - temperature(uninterrupted[0])).max() < SAME_K
    assert series(folder, "part")[0] == pytest.approx(series(uninterrupted[0], "part")[0])


def test_half_written_times_are_removed_and_run_anew(uninterrupted, tmp_path):
    """Rationale: a machine that loses power leaves a time with half its fields."""
    folder = copied(uninterrupted[0], tmp_path)
    path = folder / "0.3/T"
    path.write_bytes(path.read_bytes()[:-50])  # the closing line
    (folder / "0.31/uniform").mkdir(parents=True)
    assert names(folder) == ["0", "0.1", "0.2"]
    starts = []
    run_case(folder, END, report=lambda p: starts.append(p.time_s))
    assert starts[0] == 0.2
    assert not (folder / "0.31").exists()
    assert abs(temperature(folder) - temperature(uninterrupted[0])).max() < SAME_K


def test_a_finished_run_goes_on_when_more_is_asked_for(uninterrupted, tmp_path):
    """Rationale: whether the flow is steady shows only after it was run; also between two times."""
    folder = copied(uninterrupted[0], tmp_path)
    assert run_case(folder, END).step is None  # nothing to do
    assert run_case(folder, 0.35).time_s == 0.35
    assert run_case(folder, 0.4).time_s == 0.4
    assert names(folder) == ["0", "0.1", "0.2", "0.3", "0.35", "0.4"]


def test_a_run_ends_early_when_that_will_do(meshed, tmp_path):
    """Rationale: the optical effect is steady long before the slowest eddy is."""
    folder = copied(meshed, tmp_path)
    asked = []
    far_s = 100.0 * END  # the solver must not be there before it is told
    end = run_case(folder, far_s, stop=lambda time_s: asked.append(time_s) or time_s >= 0.1)
    assert asked == [0.1]
    assert end.stopped
    assert 0.1 <= end.time_s < far_s
    assert times(folder)[-1].time_s == end.time_s


def test_the_mirrored_section_is_symmetric_at_first(openfoam, uninterrupted, tmp_path):
    """Rationale: the half mesh and its mirror image must meet without a wall between them."""
    folder = tmp_path / "whole"
    prepare_case(HeatFlow(section=True, whole=True, cell_mm=4.0), folder, 0.1, 0.1)
    set_parameters(folder, initialVelocity="(0 0 0)")  # no draught
    run_case(folder, 0.1)
    both, half = temperature(folder, "0.1"), temperature(uninterrupted[0], "0.1")
    assert both.size == 2 * half.size
    assert abs(both[: half.size] - both[half.size :]).max() < 0.1
    assert abs(both[: half.size] - half).max() < 1.0  # of 850 K


@pytest.mark.slow
def test_processes_share_a_case_and_hand_it_on(parallel_openfoam, meshed, uninterrupted, tmp_path):
    """Rationale: a run is begun on a laptop and gone on with on a server, or back again."""
    folder = copied(meshed, tmp_path)
    returned, reached, words = killed(folder, signal.SIGINT, 0.03, processes=2)
    assert returned == 130
    stopped = re.match(r"stopped at (\S+) s of flow", words)[1]
    assert reached <= float(stopped) < END
    assert run_case(folder, END, processes=2).time_s == END
    assert {"0.1", "0.2", "0.3", stopped} == {saved.name for saved in times(folder)[1:]}
    assert all(saved.decomposed for saved in times(folder)[1:])
    reconstruct(parallel_openfoam, folder)
    assert abs(temperature(folder) - temperature(uninterrupted[0])).max() < 0.5  # of 1230 K
    assert run_case(folder, 0.35).time_s == 0.35
    assert not list(folder.glob("processor*"))
    assert not any(saved.decomposed for saved in times(folder))
    assert run_case(folder, 0.36, processes=3).time_s == 0.36
    assert len(list(folder.glob("processor*"))) == 3


def test_a_diverging_run_keeps_its_last_sound_time(uninterrupted, tmp_path):
    """Rationale: hours of sound flow must not go with the seconds that blew up."""
    folder = copied(uninterrupted[0], tmp_path)
    poison(folder)
    with pytest.raises(
        InputError, match=r"diverged at 0\.3\d* s.*sound time is 0\.3 s.*maxCourant"
    ):
        run_case(folder, 1.0)
    assert names(folder)[-1] == "0.3"


def test_a_solver_that_fails_is_quoted(meshed, tmp_path):
    """Rationale: the cause stands somewhere in a long log, with file and line."""
    folder = copied(meshed, tmp_path)
    set_parameters(folder, heatCapacity="nonsense")
    with pytest.raises(InputError, match=r"failed at 0 s.*'nonsense'.*Properties.*at line \d+"):
        run_case(folder, END)


def test_fields_that_could_not_be_written_end_the_run(meshed, tmp_path):
    """Rationale: on a full disk the solver computes on and writes nothing."""
    folder = copied(meshed, tmp_path)

    def hinder(time_s):
        (folder / "0.2/T").mkdir(parents=True, exist_ok=True)
        return False

    with pytest.raises(InputError, match=r"at 0\.2 s were not written.*goes on from 0\.1 s"):
        run_case(folder, 1.0, stop=hinder)
    assert names(folder) == ["0", "0.1"]
    assert run_case(folder, 0.2).time_s == 0.2


@pytest.mark.parametrize(
    ("interval_s", "longest_s", "count"),
    [(0.1, 8e-3, 13), (0.25, 8e-3, 32), (0.2, 0.1 / 13, 26), (0.1, 0.05, 2), (0.1, 0.1, 1)],
)
def test_time_steps_fit_the_interval_of_writing(interval_s, longest_s, count):
    """Rationale: half a step too many, and rounding picks other steps after a stop than before."""
    step = float(whole_step(interval_s, longest_s))
    assert interval_s / step == pytest.approx(count, abs=1e-9)
    assert step <= longest_s * (1.0 + 1e-9)
    assert float(whole_step(interval_s, step)) == step
    assert float(whole_step(0.1, 0.3)) == 0.3  # one step may be longer than a short interval


def test_one_run_at_a_time(meshed, tmp_path):
    """Rationale: two solvers in one folder write each other's times over."""
    folder = copied(meshed, tmp_path)
    told = []

    def second(progress: Progress):
        if not told:
            with pytest.raises(InputError, match="another run is at work in it"):
                run_case(folder, 0.01)
            told.append(progress)

    run_case(folder, 0.01, report=second)
    assert told


def test_another_set_up_is_not_gone_on_with(tmp_path):
    """Rationale: a result that is half of one part and half of another."""
    folder = tmp_path / "case"
    prepare_case(FLOW, folder, END, INTERVAL)
    prepare_case(FLOW, folder, 1.0, 0.2)
    assert re.search(r"^writeInterval\s+0\.2;", (folder / "parameters").read_text(), re.M)
    with pytest.raises(InputError, match=r"with temperature_c = 1250.0, not 900.0"):
        prepare_case(HeatFlow(900.0, section=True, cell_mm=4.0), folder, END, INTERVAL)
    with pytest.raises(InputError, match="is not a case of ours"):
        prepare_case(FLOW, tmp_path, END, INTERVAL)
    with pytest.raises(InputError, match="is not a case of ours"):
        run_case(tmp_path, END)
    (folder / "setup.json").write_text(json.dumps({"cell_mm": 4.0})[:-1])
    with pytest.raises(InputError, match=r"setup\.json: can't be read"):
        prepare_case(FLOW, folder, END, INTERVAL)


@pytest.mark.parametrize(
    ("reached", "end", "leg"),
    [
        (0.0, 2.0, (2.0, 0.25)),
        (0.5, 2.0, (2.0, 0.25)),
        (0.49999999, 2.0, (2.0, 0.25)),  # eight digits of a half
        (0.6, 2.0, (0.75, 0.15)),
        (0.6, 0.7, (0.7, 0.1)),
        (0.5, 0.7, (0.7, 0.2)),
        (0.25, 0.7, (0.5, 0.25)),
        (2.0, 2.0, None),
        (1.99999999, 2.0, None),
        (2.1, 2.0, None),
    ],
)
def test_legs_lead_back_to_the_times_of_writing(reached, end, leg):
    """Rationale: a burst is sampled at equal intervals, wherever its run was stopped."""
    assert next_leg(reached, end, 0.25) == (leg and pytest.approx(leg))


def watch_of(folder, records, sound_until_s=0.0):
    place = folder / "postProcessing/extremes/0"
    place.mkdir(parents=True)
    (place / "fieldMinMax.dat").write_text("# Time min(T) max(T)\n" + records)
    return Watch(ambient_k=293.15, wall_k=1523.15, max_courant=8.0, sound_until_s=sound_until_s)


@pytest.mark.parametrize(
    ("record", "trouble"),
    [
        ("0.2 236.0 1523.15\n", ""),  # as coarse cells undershoot, for good
        ("0.2 293.0 1600.0\n", ""),
        ("0.2 40.0 1523.15\n", "40 K, below the surrounding air's 293 K"),
        ("0.2 293.0 2900.0\n", "2900 K, above the wall's 1523 K"),
        ("0.2 nan nan\n", "nan K"),
        ("0.2 293.0 2900", ""),  # not yet written to its end
    ],
)
def test_impossible_temperatures_show_divergence(tmp_path, record, trouble):
    """Rationale: they come steps before the solver itself gives up."""
    watch = watch_of(tmp_path, "0.1 293 400\n" + record)
    assert watch.check(tmp_path, []).startswith(trouble)
    assert watch.sound_until_s == (0.0 if trouble else 0.1 if record.endswith("0") else 0.2)


@pytest.mark.parametrize(
    ("courant", "length_s", "trouble"),
    [(9.0, 1e-3, ""), (85.0, 1e-3, "Courant number 85"), (8.0, 1e-8, "shrunk to 1e-08 s")],
)
def test_steps_out_of_hand_show_divergence(tmp_path, courant, length_s, trouble):
    """Rationale: a step that collapses computes for ever and gets nowhere."""
    watch = watch_of(tmp_path, "0.2 293 400\n")
    told = watch.check(tmp_path, [Step(0.2, length_s, courant, {})])
    assert trouble in told
    assert bool(trouble) == bool(told)


def test_what_follows_the_first_unrest_is_not_called_sound(tmp_path):
    """Rationale: velocities run away before temperatures do."""
    watch = watch_of(tmp_path, "0.2 293 400\n", sound_until_s=0.1)
    assert watch.check(tmp_path, [Step(0.2, 1e-3, 30.0, {})]) == ""
    assert watch.check(tmp_path, [Step(0.21, 1e-3, 8.0, {})]) == ""
    assert watch.sound_until_s == 0.1


def test_series_join_over_restarts(tmp_path):
    """Rationale: each run writes a file of its own, and repeats what the killed one had lost."""
    parts = {"0": "0.1 part 1\n0.2 part 2\n0.3 part -1\n", "0.2": "0.3 part 3\n0.4 part 4\n0.5 pa"}
    for start, rows in parts.items():
        place = tmp_path / "postProcessing/heat" / start
        place.mkdir(parents=True)
        (place / "heat.dat").write_text("# Heat\n# Time  \tpatch  \tflux\n" + rows)
    when, columns = series(tmp_path, "heat")
    assert when.tolist() == [0.1, 0.2, 0.3, 0.4]
    assert {name: values.tolist() for name, values in columns.items()} == {"flux": [1, 2, 3, 4]}
    with pytest.raises(InputError, match="no records in postProcessing/other"):
        series(tmp_path, "other")
