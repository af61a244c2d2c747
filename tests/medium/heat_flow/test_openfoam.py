"""Which OpenFOAM is there, and what its words mean."""

import os
import signal
import subprocess
import sys
import time
from pathlib import Path

import pytest

from virtual_sensor.errors import InputError
from virtual_sensor.medium.heat_flow import openfoam
from virtual_sensor.medium.heat_flow.openfoam import (
    TOOLS,
    OpenFoam,
    fatal_error,
    find_openfoam,
    plain_path,
    run_tool,
    tied,
)

UPSTREAM = "Using: OpenFOAM-v{0} ({0}) - visit www.openfoam.com"


@pytest.fixture
def machine(tmp_path, monkeypatch):
    """A machine whose PATH and settings are ours to fill."""
    monkeypatch.setenv("PATH", f"{tmp_path / 'bin'}")
    monkeypatch.delenv("WM_PROJECT_DIR", raising=False)
    monkeypatch.delenv("WM_PROJECT_VERSION", raising=False)
    monkeypatch.setattr(openfoam, "PLACES", (f"{tmp_path}/share/openfoam*",))
    (tmp_path / "bin").mkdir()
    return tmp_path


def install(machine, told, tools=TOOLS, settings="share/openfoam"):
    """Put tools on the PATH that tell about themselves, and the settings in their place."""
    for tool in tools:
        path = machine / "bin" / tool
        path.write_text(f"#!/bin/sh\necho '{told}'\n")
        path.chmod(0o755)
    if settings:
        (machine / settings / "etc").mkdir(parents=True)
        (machine / settings / "etc/controlDict").touch()


@pytest.mark.parametrize(
    ("told", "version"),
    [("Using: OpenFOAM- (1912) - visit www.openfoam.com", "1912"), (UPSTREAM.format(2312), "2312")],
)
def test_debians_and_later_ones_of_upstream_are_found(machine, told, version):
    """Rationale: Debian's names its version otherwise than upstream's do."""
    install(machine, told)
    found = find_openfoam()
    assert found.version == version
    assert found.environment["WM_PROJECT_DIR"] == f"{machine}/share/openfoam"
    assert found.environment["FOAM_SIGFPE"] == "true"


@pytest.mark.parametrize(
    ("told", "message"),
    [
        (UPSTREAM.format(1806), "v1806 is too old; v1912"),
        ("Using: OpenFOAM-11 (see https://openfoam.org)", "11 is the OpenFOAM Foundation's"),
        ("no such option", r"does not show OpenFOAM's version \(no such option\); v1912"),
    ],
)
def test_a_wrong_version_is_told_with_the_wanted_one(machine, told, message):
    """Rationale: the Foundation's solvers and dictionaries have other names and fail obscurely."""
    install(machine, told)
    with pytest.raises(InputError, match=message):
        find_openfoam()


def test_no_openfoam_is_told_with_the_package_that_brings_it(machine):
    """Rationale: the first command on a new machine."""
    with pytest.raises(InputError, match=r"no blockMesh.*rhoPimpleFoam.*apt-get install openfoam"):
        find_openfoam()
    install(machine, UPSTREAM.format(2312), TOOLS[:-1])
    with pytest.raises(InputError, match="no rhoPimpleFoam on the PATH"):
        find_openfoam()


def test_an_installation_that_was_not_sourced_is_told_so(machine):
    """Rationale: upstream's packages put no tool on the PATH by themselves."""
    install(machine, "", tools=(), settings="share/openfoam2312")
    (machine / "share/openfoam2312/etc/bashrc").touch()
    with pytest.raises(InputError, match=r"source .*/share/openfoam2312/etc/bashrc"):
        find_openfoam()


def test_tools_without_settings_are_told_what_was_looked_for(machine, monkeypatch):
    """Rationale: without etc/controlDict each tool dies with a message about an 'etc entry'."""
    monkeypatch.setenv("WM_PROJECT_DIR", "/nowhere")
    install(machine, UPSTREAM.format(2312), settings=None)
    with pytest.raises(InputError, match=r"WM_PROJECT_DIR \(/nowhere\), .*/share/openfoam"):
        find_openfoam()


def test_several_processes_need_mpirun(machine):
    """Rationale: to be reported before anything is decomposed."""
    install(machine, UPSTREAM.format(2312))
    with pytest.raises(InputError, match=r"mpirun.*apt-get install openmpi-bin"):
        find_openfoam(parallel=True)


def test_a_fatal_error_becomes_one_line_with_its_place():
    """Rationale: the cause stands in the middle of the log, on lines of its own."""
    told = (
        "[1] \n[1] --> FOAM FATAL IO ERROR: \n[1] Unknown patchField type nonsense\n[1] \n"
        "[1] file: /case/0/T.boundaryField.part at line 20.\n[1] \n"
        "[1]     From function New\n[1]     in file x.C at line 1.\nFOAM parallel run exiting\n"
    )
    cause = "Unknown patchField type nonsense; file: /case/0/T.boundaryField.part at line 20."
    assert fatal_error(f"Create time\n{told}") == cause
    assert fatal_error("Create time\nEnd\n") == ""


def test_a_tied_program_does_not_outlive_its_parent(tmp_path):
    """Rationale: a solver that computes on unseen would write into the next run's case."""
    path = tmp_path / "pid"
    program = "import os, time; print(os.getpid(), flush=True); time.sleep(60)"
    code = (
        "import subprocess, sys, time\n"
        "from virtual_sensor.medium.heat_flow.openfoam import tied\n"
        f"words = tied([sys.executable, '-c', {program!r}], {int(signal.SIGKILL)})\n"
        f"subprocess.Popen(words, stdout=open({str(path)!r}, 'w'))\n"
        "time.sleep(60)"
    )
    with subprocess.Popen([sys.executable, "-c", code]) as parent:
        waited(lambda: path.exists() and path.read_text().endswith("\n"))
        parent.kill()
    waited(lambda: gone(Path("/proc", path.read_text().strip())))


# As OpenFOAM's solvers do: they end in good order at the first signal, and die of a second.
SOLVES = """
import signal, time
told = []
def first(number, _):
    signal.signal(number, signal.SIG_DFL)
    told.append(number)
signal.signal(signal.SIGUSR2, first)
print("ready", flush=True)
while not told:
    time.sleep(0.01)
time.sleep(0.3)
print("written", flush=True)
raise SystemExit(3)
"""


def test_a_tied_program_is_told_once():
    """Rationale: the kernel tells the death of each of the parent's threads; the step was lost."""
    words = tied([sys.executable, "-c", SOLVES], signal.SIGUSR2)
    with subprocess.Popen(words, stdout=subprocess.PIPE, text=True) as run:
        assert run.stdout.readline() == "ready\n"
        for _ in range(3):
            run.send_signal(signal.SIGUSR2)
            time.sleep(0.05)
        assert run.stdout.read() == "written\n"
    assert run.returncode == 3


def test_how_a_tied_program_was_killed_is_passed_on():
    """Rationale: want of memory is known from the status."""
    words = tied([sys.executable, "-c", "import os; os.kill(os.getpid(), 9)"], signal.SIGKILL)
    assert subprocess.run(words).returncode == 137


def gone(place):
    """Whether a process has ended, reaped or not."""
    try:
        return (place / "stat").read_text().rpartition(")")[2].split()[0] == "Z"
    except OSError:
        return True


def waited(true, limit_s=20.0):
    """Wait for something to come true."""
    end = time.monotonic() + limit_s
    while not true():
        assert time.monotonic() < end
        time.sleep(0.02)


def test_a_program_whose_parent_is_gone_already_does_not_start(tmp_path):
    """Rationale: the parent may die between the two."""
    words = tied([sys.executable, "-c", f"open({str(tmp_path / 'made')!r}, 'w')"], signal.SIGKILL)
    words[words.index(str(os.getpid()))] = "1"
    assert subprocess.run(words).returncode == 1
    assert not (tmp_path / "made").exists()


def test_a_case_may_lie_in_a_folder_of_any_name(machine):
    """Rationale: OpenFOAM ends on a blank or an umlaut in its working folder's name."""
    install(machine, "")
    tool = machine / "bin/blockMesh"
    tool.write_text(
        '#!/bin/sh\ncase "$PWD" in *[!-A-Za-z0-9_/.]*) exit 1;; esac\n/bin/echo "$PWD"\n'
    )
    folder = machine / "größe 1"
    folder.mkdir()
    foam = OpenFoam("1912", dict(os.environ))
    with plain_path(folder) as place:
        said = run_tool(foam, place, "blockMesh")
        assert Path(said.strip()) == place
    assert (folder / "log.blockMesh").exists()
    assert not place.exists()
    with pytest.raises(InputError, match="größe 1: blockMesh failed"), plain_path(folder) as place:
        run_tool(foam, place.resolve(), "blockMesh")
    with plain_path(machine / "bin") as place:
        assert place == machine / "bin"
