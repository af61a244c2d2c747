"""A sweep makes each case once, whatever is killed meanwhile, and to the same bits everywhere."""

import csv
import json
import os
import re
import shlex
import shutil
import signal
import socket
import subprocess
import sys
from pathlib import Path
from typing import Any
from urllib.parse import unquote

import numpy as np
import pytest
import typer
from command_line import command
from several import two_by_two

from virtual_sensor import cli
from virtual_sensor.cli.sweep import values
from virtual_sensor.errors import InputError
from virtual_sensor.imaging.recording_options import RecordingOptions
from virtual_sensor.reporting.measure import save as save_case
from virtual_sensor.studies import cluster, finished_cases, sweep_table
from virtual_sensor.studies.sweep import MARK, CaseStatus, cases, plan, run

FILM = {"width": ["256"], "height": ["256"], "spp": ["1"], "line_radius": ["0.5"]}
OPTIONS = [word for name, [value] in FILM.items() for word in ("-D", f"{name}={value}")]
TIMED = {"report.png", "report.html", "summary.json", "table.md"}
"""Files of a measurement that tell how long it took."""


def table(folder):
    """Rows of a sweep's table."""
    with (folder / "sweep.csv").open(encoding="utf-8", newline="") as file:
        return list(csv.DictReader(file))


def marks(folder):
    """What tells a finished case from one that was made again."""
    cases = (case for case in (folder / "cases").iterdir() if not case.name.startswith("."))
    files = (file for case in cases for file in [case, *case.iterdir()])
    return {file: (file.stat().st_ino, file.stat().st_mtime_ns) for file in files}


def contents(folder):
    """Files of a sweep that hold no times, with what is in them."""
    files = [p for p in folder.rglob("*") if p.is_file() and p.name not in TIMED]
    return {str(p.relative_to(folder)): p.read_bytes() for p in files}


# Planning: no light, no disk.


def test_all_combinations_are_planned_the_last_parameter_changing_fastest():
    """Rationale: the order of a table's rows is part of what it says."""
    planned = plan("hot_cylinder", {"beta": ["0", "15"], "temperature": ["900", "1250"]})
    assert plan("hot_cylinder", {"beta": (0, 15), "temperature": [900, 1250]}) == planned
    assert plan("hot_cylinder", {"beta": 15}) == plan("hot_cylinder", {"beta": ["15"]})
    assert [case.name for case in planned] == [
        "beta=0_temperature=900",
        "beta=0_temperature=1250",
        "beta=15_temperature=900",
        "beta=15_temperature=1250",
    ]
    assert len({case.key for case in planned}) == 4
    assert planned[0].values["field"] == "fields/hot_cylinder_900C_quarter.nc"


def test_a_list_of_cases_is_named_by_what_differs():
    """Rationale: in a list of lines and dots a case is found by what it has of its own."""
    listed = [{"beta": "0", "spp": "4"}, {"beta": "0", "spp": "4", "dots": "0,-5,-10"}]
    plain, dotted = cases("hot_cylinder", listed)
    assert (plain.name, dotted.name) == ("dots=", "dots=0,-5,-10")
    assert [c.name for c in cases("hot_cylinder", listed, ["line", "../a b"])] == ["line", "a-b"]


def test_a_value_given_and_the_same_by_default_are_the_same_case():
    """Rationale: extended by a parameter at its default, a sweep must not start again."""
    [plain] = plan("hot_cylinder", {"beta": ["15"]})
    [given] = plan("hot_cylinder", {"beta": ["15"], "temperature": ["1250"]})
    assert plain.key == given.key


def test_the_scene_and_what_it_refers_to_are_in_the_key(tmp_path, monkeypatch):
    """Rationale: results of a field or a mesh that has changed since are wrong results."""
    scene, part = tmp_path / "scene.xml", tmp_path / "part.ply"
    scene.write_text(
        '<scene version="3.0.0"><default name="mesh" value="part"/>'
        '<shape type="ply"><string name="filename" value="$mesh.ply"/></shape></scene>'
    )
    keys = []
    for text in ("a", "bb"):
        part.write_text(text)
        keys.append(plan(scene, {"mesh": ["part"]})[0].key)
    scene.write_text(scene.read_text().replace("</scene>", "<!-- --></scene>"))
    keys.append(plan(scene, {"mesh": ["part"]})[0].key)
    assert len(set(keys)) == 3
    monkeypatch.chdir(tmp_path)
    assert plan("scene.xml", {"mesh": ["part"]})[0].key == keys[-1]  # as seen from elsewhere


def test_how_frames_are_recorded_is_in_the_key_and_in_the_command(tmp_path, monkeypatch):
    """Rationale: results of another sensor, seed or data sheet are other results.

    A sensor's file is found from a worker's folder too.
    """
    monkeypatch.chdir(tmp_path)
    sheet = Path("mine.toml")

    def planned(**given):
        return plan("hot_cylinder", {"beta": [15]}, recording=RecordingOptions(**given))[0]

    sheet.write_text("gain = 0.5\n")
    ways = [{}, {"sensor_model": "cmos_5um5"}, {"sensor_model": "mine.toml"}]
    ways += [{"sensor_model": "cmos_5um5", "seed": 1}, {"exposure": "auto"}, {"speckle": True}]
    before = [planned(**way) for way in ways]
    sheet.write_text("gain = 0.25\n")
    assert len({case.key for case in [*before, planned(sensor_model="mine.toml")]}) == 7
    assert plan("hot_cylinder", {"beta": [15]})[0] == before[0]
    assert before[2].command.endswith(f" --sensor-model={tmp_path / 'mine.toml'}")
    assert before[3].command.endswith(" --sensor-model=cmos_5um5 --seed=1")
    assert before[5].command.endswith(" --speckle")
    with pytest.raises(InputError, match="cmos_5um"):
        planned(sensor_model="cmos_5um")


def test_a_recorded_sweep_has_columns_of_width_shift_and_noise(tmp_path):
    """Rationale: who chooses a sensor asks what its noise makes of the line, case by case.

    Half as wide a line has more noise in its columns of one brightest pixel: as the root of it.
    """
    film = {name: values for name, values in FILM.items() if name != "line_radius"}
    given = film | {"line_radius": ["0.8", "0.4"]}
    planned = plan("cold_cylinder", given, recording=RecordingOptions("cmos_5um5"))
    finished = run(planned, tmp_path / "swept", save_case)
    found = sweep_table.results(finished, tmp_path / "swept").table
    wide, narrow = found.cold_line_width_px
    assert wide / narrow == pytest.approx(2.0, rel=0.05)
    ratio = found.cold_noise_px[0] / found.cold_noise_px[1]
    assert ratio == pytest.approx(np.sqrt(2.0), rel=0.25)
    assert (np.abs(found.cold_line_shift_px) < found.cold_line_rms_px).all()
    assert np.isfinite(found.cold_detector_px).all()
    assert np.isnan([found.cold_speckle_px, found.hot_noise_px]).all()


def test_a_file_of_the_users_is_found_from_another_folder_too(tmp_path, monkeypatch):
    """Rationale: a worker runs in a folder of its own."""
    monkeypatch.chdir(tmp_path)
    Path("air.nc").touch()
    Path("0.5").touch()
    [case] = cases("hot_cylinder", [{"field": "air.nc", "line_radius": "0.5"}])
    assert case.parameters == {"field": str(tmp_path / "air.nc"), "line_radius": "0.5"}


@pytest.mark.parametrize(
    ("arguments", "told"),
    [
        ("hot_cylinder -D bate=0,15", "no parameter 'bate'; the scene has: along, alpha"),
        ("hot_cylinder -D beta", "-D beta: write it as NAME=VALUE"),
        ("nope -D beta=0", "nope: there is no such scene file"),
        ("hot_cylinder -D beta=0 -D beta=15", "twice; give all values at once, as -D beta=0,15"),
        (
            "hot_cylinder -D beta=0:30",
            "beta=0:30: write a range as START:STOP:STEP, such as 0:30:5",
        ),
        ("hot_cylinder -D beta=0:3O:5", "beta=0:3O:5: write a range as START:STOP:STEP"),
        ("hot_cylinder -D beta=0:inf:5", "beta=0:inf:5: write a range as START:STOP:STEP"),
        ("hot_cylinder -D beta=0:30:-5", "steps of -5 don't lead from 0 to 30; give 5"),
        ("hot_cylinder -D beta=0:30:0", "steps of 0 don't lead from 0 to 30; give another one"),
        ("hot_cylinder -D beta=0:1e9:1", "has 1000000001 values; give a longer step, for at most"),
    ],
)
def test_what_cannot_be_planned_is_told_before_any_work(arguments, told, tmp_path):
    """Rationale: not after the first hour."""
    status, out, err = command("sweep", *arguments.split(), "-o", tmp_path / "swept")
    assert (status, out) == (2, "")
    assert told in err
    assert list(tmp_path.iterdir()) == []


def test_a_foreign_folder_is_refused(tmp_path):
    """Rationale: a user's folder must not fill with ours."""
    (tmp_path / "thesis.tex").touch()
    status, _, err = command("sweep", "cold_cylinder", "-o", tmp_path)
    assert (status, err.count("\n")) == (2, 1)
    assert "holds other files" in err
    assert [p.name for p in tmp_path.iterdir()] == ["thesis.tex"]


def test_a_repeated_value_is_taken_once():
    """Rationale: 0:30:15,15.0 names a case twice, and a table must not."""
    planned = plan("hot_cylinder", {"beta": ["0", "15", "15.0", "0", "30"], "dots": ["", ""]})
    assert [case.values["beta"] for case in planned] == ["0", "15", "30"]


def test_a_range_gives_decimal_numbers_without_drift():
    """Rationale: 0.30000000000000004 names no folder, and is no other case than 0.3."""
    given = {
        "0:1:0.1": "0 0.1 0.2 0.3 0.4 0.5 0.6 0.7 0.8 0.9 1",
        "0:30:5": "0 5 10 15 20 25 30",
        "0:31:15": "0 15 30",
        "15:-15:-15": "15 0 -15",
        "-0.2:0.2:0.1": "-0.2 -0.1 0 0.1 0.2",
        "1e-3:3e-3:1e-3": "0.001 0.002 0.003",
        "900:1250:350": "900 1250",
        "5:5:1": "5",
        "0:30:15, 7,45:50:5": "0 15 30 7 45 50",
        "a:b:c": "a:b:c",
        "0:1:1;2": "0 1 2",
    }
    assert {text: " ".join(values("beta", text)) for text in given} == given


def test_more_cases_than_anyone_waits_for_are_refused():
    """Rationale: three ranges of a thousand values would fill the memory first."""
    numbers = [str(i) for i in range(1000)]
    with pytest.raises(InputError, match="1000000000 cases; give at most 100000"):
        plan("hot_cylinder", dict.fromkeys(("beta", "along", "tilt"), numbers))


def test_a_scene_with_several_cameras_is_refused_once(tmp_path):
    """Rationale: not case by case, in a hundred rows."""
    two_by_two(tmp_path)
    scene, folder = tmp_path / "two_hot_cylinder.xml", tmp_path / "swept"
    status, out, err = command("sweep", scene, "-D", "beta=0,15", "-o", folder)
    assert (status, out, err.count("\n")) == (2, "", 1)
    assert "the scene has 2 cameras: near, far; say which" in err
    status, out, err = command("sweep", scene, "--camera", "nope", "-D", "beta=0,15", "-o", folder)
    assert (status, out, err.count("\n")) == (2, "", 1)
    assert "nope" in err
    assert [path.name for path in folder.rglob("*")] == [MARK]


def test_a_case_names_the_command_that_measures_it_alone():
    """Rationale: its page shows it, and what is shown can be typed."""
    given = [{"dots": "0,-5", "beta": "15"}]
    [case] = cases("hot_cylinder", given, y_mm=[-1.5, 2.0], camera="camera", source="laser")
    words = shlex.split(case.command)[1:]
    group: Any = typer.main.get_command(cli.app)
    typed = group.commands["measure"].make_context("measure", words[1:]).params
    assert typed["define"] == ["dots=0,-5", "beta=15"]
    assert (typed["y"], typed["camera"], typed["source"]) == ([-1.5, 2.0], "camera", "laser")


# In this process.


@pytest.fixture(scope="module")
def swept(tmp_path_factory):
    """Folder of a sweep with a case that can't be measured, status, and what was said."""
    folder = tmp_path_factory.mktemp("sweep") / "swept"
    status, out, err = command(
        "sweep", "cold_cylinder", "-D", "alpha=60,0,50", *OPTIONS, "-o", folder
    )
    assert err == ""
    shutil.copytree(folder, folder.with_name("copied"))
    return folder, status, out


def test_a_case_that_fails_does_not_keep_the_others_from_it(swept):
    """Rationale: one bad value in a night's sweep must cost one row."""
    folder, status, out = swept
    assert status == 1
    assert "turn the camera out of the plane" in out
    rows = table(folder)
    assert [row["alpha"] for row in rows] == ["60", "0", "50"]
    assert [row["status"] for row in rows] == ["ok", "failed", "ok"]
    assert "turn the camera" in rows[1]["message"]
    assert (rows[1]["folder"], rows[1]["cold_line_rms_px"], rows[1]["cold_centres"]) == ("", "", "")
    assert json.loads((folder / "summary.json").read_text())["failed"].keys() == {"alpha=0"}
    assert (folder / "sweep.png").stat().st_size > 0
    page = (folder / "report.html").read_text(encoding="utf-8")
    links = [unquote(link) for link in re.findall(r'href="(cases/[^"]+)"', page)]
    assert links == [f"{row['folder']}/report.html" for row in rows[::2]]
    assert all((folder / link).exists() for link in links)


def test_the_table_says_what_the_measurements_say(swept):
    """Rationale: its figures are those of each case's own summary, in the same row."""
    folder = swept[0]
    for row in table(folder)[::2]:
        summary = json.loads((folder / row["folder"] / "summary.json").read_text())
        assert summary["parameters"]["alpha"] == row["alpha"]
        state = summary["states"]["cold"]
        line = state["line_minus_search"]
        assert float(row["cold_line_rms_px"]) == pytest.approx(line["rms_px"], rel=1e-12)
        assert float(row["cold_line_largest_px"]) == pytest.approx(line["largest_px"], rel=1e-12)
        assert int(row["cold_centres"]) == state["line_status"]["ok"] > 0
        assert row["hot_centres"] == row["largest_incidence_shift_um"] == ""  # never measured hot


def test_an_extended_sweep_makes_only_what_is_new(swept):
    """Rationale: cases of hours must not be made again for one more."""
    folder = swept[0]
    before = marks(folder)
    rows = table(folder)
    words = ["cold_cylinder", "-D", "alpha=50,55,60", "-D", "beta=0", *OPTIONS, "-o", folder]
    status, out, _ = command("sweep", *words)
    assert status == 0
    assert "3 cases: 1 measured, 2 already there, 0 failed" in out
    after = marks(folder)
    assert after.items() > before.items()
    again = table(folder)
    assert [row["alpha"] for row in again] == ["50", "55", "60"]
    figures = [name for name in rows[0] if name != "beta"]
    assert [again[i][n] for i in (2, 0) for n in figures] == [
        r[n] for r in rows[::2] for n in figures
    ]
    table_before = (folder / "sweep.csv").read_bytes()
    status, out, _ = command("sweep", *words)
    assert "3 cases: 0 measured, 3 already there, 0 failed" in out
    assert (folder / "sweep.csv").read_bytes() == table_before
    assert marks(folder) == after


def test_results_of_another_program_are_told_and_make_room(swept, monkeypatch):
    """Rationale: after an update they must be made again, not used, and not fill the disk."""
    folder = swept[0].with_name("copied")  # before it was extended
    words = ["cold_cylinder", *OPTIONS, "-o", folder]
    earlier = sorted(path.name for path in (folder / "cases").iterdir())
    for module in (finished_cases, sweep_table):
        monkeypatch.setattr(module, "fingerprint", lambda: "0" * 8)
    status, out, _ = command("sweep", *words, "-D", "alpha=60")
    assert status == 0
    assert "1 case: 1 measured, 0 already there, 0 failed" in out
    notes = json.loads((folder / "summary.json").read_text())["notes"]
    assert notes[0].startswith("1 cases were measured again, since this program or a package")
    assert notes[1].startswith("cases/ holds 1 results of another version of this program")
    assert all(f"Note: {note}" in out for note in notes)
    later = sorted(path.name for path in (folder / "cases").iterdir())
    [again] = [name for name in later if name.endswith("-00000000")]
    assert later == sorted([earlier[0], again])
    assert earlier[0].startswith("alpha=50-")


def test_values_with_commas_are_parted_by_semicolons(tmp_path):
    """Rationale: a laser's dots are a list themselves."""
    words = ["cold_cylinder", "-D", "dots=-5,5; 0;", *OPTIONS, "-o", tmp_path / "dots"]
    assert command("sweep", *words)[0] == 0
    rows = table(tmp_path / "dots")
    assert [(row["dots"], row["cold_centres"]) for row in rows] == [("-5,5", "2"), ("0", "1")]
    assert all(float(row["cold_dots_largest_v_px"]) < 0.1 for row in rows)
    assert all(row["cold_line_rms_px"] == "" for row in rows)


def test_probe_rays_that_are_given_are_those_of_every_case(tmp_path):
    """Rationale: others than the scene's own are other results, and another key."""
    given = {"line_radius": ["0.5"]} | FILM
    [own], [other] = plan("cold_cylinder", given), plan("cold_cylinder", given, [3.0, -2.0])
    assert own.key != other.key
    [end] = run([other], tmp_path, save_case)
    with (end.folder / "probe_rays.csv").open(encoding="utf-8") as file:
        assert [float(row["y_mm"]) for row in csv.DictReader(file)] == [3.0, -2.0]


def test_progress_never_goes_back_and_names_the_case(tmp_path):
    """Rationale: a bar that jumps back is worse than none."""
    told = []
    planned = plan("cold_cylinder", {"alpha": ["60", "50"]} | FILM)
    run(planned, tmp_path, save_case, report=lambda stage, fraction: told.append((stage, fraction)))
    stages, fractions = zip(*told, strict=True)
    assert (np.diff(fractions) >= 0.0).all()
    assert (fractions[0], fractions[-1]) == (0.0, 1.0)
    assert any(0.5 < f < 1.0 and s.startswith("case 2 of 2 (alpha=50): ") for s, f in told)
    assert "case 1 of 2 (alpha=60): writing the results" in stages


def test_files_that_changed_since_the_plan_are_told(tmp_path):
    """Rationale: a worker with other files or another program must not make these results."""
    scene = tmp_path / "scene.xml"
    scene.write_text('<scene version="3.0.0"><default name="beta" value="0"/></scene>')
    planned = plan(scene, {"beta": ["0"]})
    scene.write_text('<scene version="3.0.0"><default name="beta" value="0"/> </scene>')
    [ended] = run(planned, tmp_path / "swept", save_case)
    assert (ended.status, ended.folder) == (CaseStatus.FAILED, None)
    assert "not those that the sweep was planned with" in ended.message


def test_cases_without_any_line_end_with_status_3(tmp_path):
    """Rationale: a script must know that there is nothing in its results."""
    film = ["-D", "width=64", "-D", "height=64", "-D", "spp=1", "-D", "line_radius=0.01"]
    words = ["cold_cylinder", "-D", "alpha=60,50", *film, "-o", tmp_path / "swept"]
    status, out, _ = command("sweep", *words)
    assert status == 3, out
    assert "no case has a line centre or a dot" in out
    assert [row["status"] for row in table(tmp_path / "swept")] == ["nothing_found"] * 2


STUCK = """
import time
from virtual_sensor import cli
from virtual_sensor.reporting import measure as results
save, saved = results.save, []

def stuck(*arguments, **options):
    save(*arguments, **options)
    saved.append(True)
    if len(saved) == 2:
        print("in the middle of the second", flush=True)
        time.sleep(600)

results.save = stuck
cli.main()
"""


@pytest.mark.slow
@pytest.mark.parametrize("number", [signal.SIGKILL, signal.SIGTERM, signal.SIGINT])
def test_a_killed_sweep_goes_on(tmp_path, number):
    """Rationale: a power cut after hours must cost one case."""
    words = ["sweep", "cold_cylinder", "-D", "alpha=60,50,55", *OPTIONS, "-o", "swept"]
    program = [sys.executable, "-c", STUCK, *words]
    process = subprocess.Popen(program, cwd=tmp_path, stdout=subprocess.PIPE, text=True)
    assert "in the middle" in process.stdout.readline()
    process.send_signal(number)
    process.communicate(timeout=120)
    assert process.returncode == (-9 if number == signal.SIGKILL else 128 + number)
    folder = tmp_path / "swept"
    unfinished = list((folder / "cases").glob(".*.unfinished"))
    assert len(unfinished) == (1 if number == signal.SIGKILL else 0)
    before = {file: mark for file, mark in marks(folder).items() if ".unfinished" not in str(file)}
    assert {file.parent.name.partition("-")[0] for file in before} >= {"alpha=60"}
    status, out, _ = command(*words[:-1], folder)
    assert status == 0
    assert "3 cases: 2 measured, 1 already there, 0 failed" in out
    after = marks(folder)
    assert after.items() > before.items()
    assert not list((folder / "cases").glob(".*"))


# On a cluster.


@pytest.fixture
def impatient(monkeypatch):
    """A short wait for a scheduler that does not come."""
    monkeypatch.setattr(cluster, "_PATIENCE_S", 0.5)
    monkeypatch.setattr(cluster, "_FIRST_WORKER_S", 0.5)


@pytest.mark.parametrize("listens", [False, True])
def test_a_scheduler_that_does_not_answer_is_told(listens, impatient, tmp_path):
    """Rationale: a wrong address, or that of some other server, must not wait for ever."""
    with socket.socket() as other:
        other.bind(("127.0.0.1", 0))
        if listens:
            other.listen()
        address = f"tcp://127.0.0.1:{other.getsockname()[1]}"
        words = ["cold_cylinder", *OPTIONS, "--scheduler", address, "-o", tmp_path / "swept"]
        status, out, err = command("sweep", *words)
    assert (status, out, err.count("\n")) == (2, "", 1)
    assert f"--scheduler {address}: no Dask scheduler answers there" in err
    assert [p.name for p in (tmp_path / "swept").iterdir()] == [MARK]


def test_a_missing_package_is_told(tmp_path, monkeypatch):
    """Rationale: Dask's cluster is an extra, and its name is what one needs to know."""
    monkeypatch.setitem(sys.modules, "distributed", None)
    with pytest.raises(InputError, match=r"pip install 'virtual-sensor\[cluster\]'"):
        run(plan("cold_cylinder", FILM), tmp_path, save_case, "tcp://127.0.0.1:8786")


def workers(count):
    """A cluster of processes on this machine, one thread each, Dr.Jit's included."""
    distributed = pytest.importorskip("distributed", reason="needs virtual-sensor[cluster]")
    return distributed.LocalCluster(
        n_workers=count, threads_per_worker=1, processes=True, dashboard_address=":0"
    )


@pytest.fixture
def one_thread(monkeypatch):
    monkeypatch.setenv("VIRTUAL_SENSOR_THREADS", "1")


def test_a_cluster_without_workers_is_told(impatient, tmp_path):
    """Rationale: to wait for workers that nobody starts is to wait for ever."""
    with workers(0) as idle, pytest.raises(InputError, match="has no workers; start some with"):
        run(plan("cold_cylinder", FILM), tmp_path, save_case, idle.scheduler_address)


@pytest.mark.slow
def test_two_worker_processes_give_the_same_bits(tmp_path, one_thread):
    """Rationale: where a case was made must not be seen in it.

    The workers have one thread each; this process has all that the machine gives.
    """
    film = {"width": ["256"], "height": ["256"], "spp": ["9"], "line_radius": ["0.5"]}
    planned = plan("hot_cylinder", {"beta": ["0", "15"], "temperature": ["900", "1250"]} | film)
    words = [f"{name}={','.join(values)}" for name, values in film.items()]
    words += ["beta=0,15", "temperature=900,1250"]
    options = [word for pair in words for word in ("-D", pair)]
    with workers(2) as pair:
        far = tmp_path / "far"
        scheduler = ("--scheduler", pair.scheduler_address)
        status, out, _ = command("sweep", "hot_cylinder", *options, *scheduler, "-o", far)
        assert status == 0, out
    run_here = command("sweep", "hot_cylinder", *options, "-o", tmp_path / "near")
    assert run_here[0] == 0
    near, far = contents(tmp_path / "near"), contents(far)
    assert near.keys() == far.keys()
    assert len([name for name in near if name.endswith(".exr")]) == 2 * len(planned)
    assert [name for name in near if near[name] != far[name]] == []
    summaries = list((tmp_path / "far/cases").glob("*/summary.json"))
    assert {json.loads(p.read_text())["made_with"]["threads"] for p in summaries} == {1}


@pytest.mark.slow
def test_a_killed_worker_loses_no_finished_case(tmp_path, one_thread):
    """Rationale: machines of a cluster die; what they have finished stays, the rest is made."""
    planned = plan("cold_cylinder", {"alpha": ["60", "57", "54", "51", "48"]} | FILM)
    finished = {}

    def kill_one(stage, fraction):
        if stage.startswith("1 of 5 cases") and not finished:
            finished.update(marks(tmp_path))
            os.kill(pair.workers[0].pid, signal.SIGKILL)

    with workers(2) as pair:
        ended = run(planned, tmp_path, save_case, pair.scheduler_address, kill_one)
    assert [end.status for end in ended] == [CaseStatus.OK] * 5
    assert [end.case for end in ended] == planned
    assert any(file.name == "summary.json" for file in finished)
    whole = {file: mark for file, mark in finished.items() if ".unfinished" not in str(file)}
    assert marks(tmp_path).items() > whole.items()
    assert not list((tmp_path / "cases").glob(".*"))
