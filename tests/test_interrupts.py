"""Ctrl-C and SIGTERM at fixed points of all commands: 130 or 143, one line, nothing is left."""

import os
import signal
import subprocess
import sys

import numpy as np
import OpenEXR
import pytest
from command_line import PROGRESS

from virtual_sensor import interrupts

RUN = """
import importlib, os, signal, sys
signal.signal(signal.SIGINT, signal.default_int_handler)  # which a background job's shell ignores
number, point, *sys.argv[1:] = sys.argv[1:]
module, function = point.split(":")

def trace(frame, event, _):  # of calls alone: a profile function would get returns too
    if frame.f_code.co_name == function and frame.f_globals.get("__name__") == module:
        sys.settrace(None)
        signal.raise_signal(int(number))

sys.argv[0] = "virtual-sensor"
from virtual_sensor.cli import main
if module and function != "<module>":
    import virtual_sensor.imaging.render  # untraced, which is much faster
    importlib.import_module(module)
sys.settrace(trace)
main()
"""
STATUS = {signal.SIGINT: 130, signal.SIGTERM: 143}
LINE = {signal.SIGINT: "Stopped by Ctrl-C", signal.SIGTERM: "Stopped by SIGTERM"}
SMALL = ["-D", "width=128", "-D", "height=128", "-D", "spp=1", "-D", "line_radius=1"]


def started(folder, number, point, words, program=RUN):
    """Begin a command that gets a signal when it first calls a function, ``module:function``."""
    command = [sys.executable, "-c", program, str(int(number)), point, *words]
    return subprocess.Popen(
        command,
        cwd=folder,
        env=os.environ | {"VIRTUAL_SENSOR_THREADS": "1", "TMPDIR": str(folder)},
        stdin=subprocess.DEVNULL,
        stdout=subprocess.PIPE,
        stderr=subprocess.PIPE,
        text=True,
    )


@pytest.fixture
def stopped(tmp_path):
    """Have commands stopped side by side; each must end with its status and in one line.

    Before it stands only how far they were, every 10 s. What they leave is given back.
    """

    def run(number, cases, program=RUN, more=""):
        runs = []
        for case, (point, command) in enumerate(cases):
            folder = tmp_path / f"{number.name}_{case}"
            folder.mkdir()
            runs.append((point, folder, started(folder, number, point, command.split(), program)))
        left = []
        for point, folder, process in runs:
            out, err = process.communicate(timeout=300)
            err = PROGRESS.sub("", err)
            assert (point, process.returncode, out) == (point, STATUS[number], ""), err
            assert err.startswith(LINE[number] + more), (point, err)
            assert err.count("\n") == 1, (point, err)
            left.append(sorted(str(p.relative_to(folder)) for p in folder.rglob("*")))
        return left

    return run


MEASURE = " ".join(["measure", "hot_cylinder", *SMALL])
SWEEP = " ".join(["sweep", "hot_cylinder", *SMALL, "-D", "beta=0,15"])
TRIAL = "trial --quick --no-frames --detector parabola --columns 100 --workers 1"
LOADING = "virtual_sensor.medium.index_field:from_arrays"  # called by Mitsuba, from C++
MARCHING = "virtual_sensor.optics.eikonal:body"  # called by Dr.Jit's loop
IMPORTS = ["numpy:<module>", "mitsuba:<module>", "cv2:<module>"]
WRITING = ["virtual_sensor.records:write_csv", "virtual_sensor.reporting.pictures:_pixels"]


@pytest.fixture
def inputs(tmp_path):
    """An image of a line, a point cloud of temperatures, and a field with a time axis."""
    image = np.exp(-(((np.arange(60)[:, None] - 30) / 2) ** 2) / 2) + np.zeros(80)
    pixels = {"Y": image.astype(np.float32)}
    OpenEXR.File({"type": OpenEXR.scanlineimage}, pixels).write(str(tmp_path / "line.exr"))
    x, y, z = (axis.ravel() for axis in np.meshgrid(*3 * [np.arange(4.0)]))
    rows = np.stack([x, y, z, 300.0 + z], axis=1)
    np.savetxt(tmp_path / "air.csv", rows, delimiter=",", header="x,y,z,T", comments="")
    return tmp_path


@pytest.mark.parametrize(
    ("number", "points"),
    [
        (signal.SIGINT, [LOADING]),
        pytest.param(signal.SIGINT, [MARCHING, *WRITING], marks=pytest.mark.slow),
        pytest.param(signal.SIGTERM, [LOADING, MARCHING, *WRITING], marks=pytest.mark.slow),
    ],
)
def test_a_signal_while_measuring_ends_it_in_one_line_and_leaves_nothing(stopped, number, points):
    """Rationale: an exception would be lost in C++, blamed on the scene, or abort an import."""
    assert stopped(number, [(point, MEASURE) for point in points]) == [[]] * len(points)


@pytest.mark.parametrize(
    ("number", "points"),
    [
        (signal.SIGINT, ["mitsuba:<module>"]),
        pytest.param(signal.SIGINT, IMPORTS, marks=pytest.mark.slow),
        pytest.param(signal.SIGTERM, IMPORTS, marks=pytest.mark.slow),
    ],
)
def test_a_signal_while_libraries_are_imported_ends_the_command_in_one_line(
    stopped, number, points
):
    """Rationale: Mitsuba's extension aborted the process when Ctrl-C came in its import."""
    assert stopped(number, [(point, MEASURE) for point in points]) == [[]] * len(points)


@pytest.mark.slow
def test_every_command_ends_in_one_line(stopped, inputs):
    """Rationale: a user presses Ctrl-C in any of them."""
    line, air = inputs / "line.exr", inputs / "air.csv"
    cases = [
        ("virtual_sensor.optics.ray_search:ray_search", "search cold_cylinder"),
        ("virtual_sensor.studies.burst:burst", "burst cold_cylinder"),
        (LOADING, "chart --quick --panel frames"),
        ("concurrent.futures.process:submit", TRIAL),
        ("virtual_sensor.reporting.trial:save", TRIAL),
        ("virtual_sensor.reporting.detect:draw", f"detect {line}"),
        ("virtual_sensor.medium.imports.import_field:import_field", f"field import {air}"),
        ("virtual_sensor.studies.field_info:field_info", "field info none.nc"),
        ("virtual_sensor.reporting.doctor:report", "doctor"),
    ]
    assert stopped(signal.SIGINT, cases) == [[]] * len(cases)


@pytest.mark.slow
@pytest.mark.parametrize("number", [signal.SIGINT, signal.SIGTERM])
def test_a_sweep_does_not_call_a_case_failed_that_was_stopped(stopped, number):
    """Rationale: what C++ passes on looked like a fault of the scene, and the sweep went on."""
    [left] = stopped(number, [(LOADING, SWEEP)], more="; finished cases stay, and the same")
    assert left == ["swept", "swept/SWEEP.txt"]


@pytest.mark.slow
def test_a_reproduction_that_is_stopped_keeps_what_is_finished(stopped):
    """Rationale: it takes long, and the same command goes on."""
    [left] = stopped(signal.SIGTERM, [(LOADING, "reproduce")])
    assert left[:2] == ["reproduced", "reproduced/REPRODUCTION.txt"]
    assert not any("unfinished" in name for name in left)


SWALLOWED = RUN.replace(
    "        signal.raise_signal(int(number))",
    """
        class Gone:
            def __del__(self):  # an exception in it is printed and ignored
                signal.raise_signal(int(number))
        Gone()
""",
)
LATE = "import atexit, signal, sys\natexit.register(signal.raise_signal, int(sys.argv[1]))\n" + RUN


@pytest.mark.slow
def test_a_signal_is_not_swallowed_where_python_ignores_exceptions(stopped):
    """Rationale: Ctrl-C in a destructor was printed as "Exception ignored in", and work went on."""
    assert stopped(signal.SIGINT, [(LOADING, MEASURE)], SWALLOWED) == [[]]


def test_a_signal_while_python_shuts_down_ends_in_one_line(tmp_path):
    """Rationale: libraries that are just being taken apart abort at an exception."""
    late = started(tmp_path, signal.SIGINT, ":", ["--version"], LATE)
    out, err = late.communicate(timeout=60)
    assert (late.returncode, out.count("\n"), err) == (130, 1, "Stopped by Ctrl-C.\n")


def test_a_second_signal_ends_at_once(stopped):
    """Rationale: cleaning up may hang too, on a disk that has gone."""
    twice = RUN.replace(
        "main()\n",
        "import os, virtual_sensor.interrupts as interrupts\n"
        "interrupts._actions.append(lambda: os.kill(os.getpid(), int(number)))\n"
        "interrupts._actions.append(lambda: os.write(2, b'Stopped by Ctrl-C; cleaning up\\n'))\n"
        "main()\n",
    )
    assert stopped(signal.SIGINT, [("numpy:<module>", MEASURE)], twice) == [[]]


@pytest.mark.parametrize("number", [signal.SIGINT, signal.SIGTERM])
def test_ignored_signals_stay_ignored(monkeypatch, number):
    """Rationale: `nohup` and a shell's background jobs ask for that."""
    installed = []
    monkeypatch.setattr(signal, "getsignal", lambda n: n == number and signal.SIG_IGN)
    monkeypatch.setattr(signal, "signal", lambda n, _: installed.append(n))
    interrupts.install()
    assert set(installed) == set(interrupts.SIGNALS) - {number}


def test_ctrl_c_in_a_scenes_load_stays_ctrl_c_in_python(monkeypatch):
    """Rationale: a notebook has no handler of ours; Mitsuba makes a RuntimeError of it."""
    import virtual_sensor as vs
    from virtual_sensor.medium import index_field

    for kind, raised in [(KeyboardInterrupt, KeyboardInterrupt), (SystemExit(143), SystemExit)]:

        def interrupted(*_, kind=kind):
            raise kind

        monkeypatch.setattr(index_field, "fill_solid", interrupted)
        with pytest.raises(raised):
            vs.load_scene("hot_cylinder", widen=1.0123)  # air that no other test reads


@pytest.mark.slow
def test_a_sweep_on_a_cluster_ends_in_one_line_while_it_waits(stopped):
    """Rationale: the client waits in threads of its own, and its workers are not its children."""
    distributed = pytest.importorskip("distributed", reason="needs virtual-sensor[cluster]")
    with distributed.LocalCluster(
        n_workers=1, threads_per_worker=1, dashboard_address=":0", processes=True
    ) as cluster:
        words = f"{SWEEP} --scheduler {cluster.scheduler_address}"
        [left] = stopped(signal.SIGINT, [("distributed.client:wait_for_workers", words)])
    assert left == ["swept", "swept/SWEEP.txt"]
