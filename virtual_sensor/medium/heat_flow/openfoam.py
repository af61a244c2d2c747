"""OpenFOAM on this machine: where it is, which one, and how a tool of it is run and understood."""

from __future__ import annotations

import os
import re
import shutil
import subprocess
import sys
from collections.abc import Iterator, Mapping
from contextlib import contextmanager
from dataclasses import dataclass
from pathlib import Path

from virtual_sensor.errors import InputError
from virtual_sensor.files import scratch_folder
from virtual_sensor.medium.heat_flow import attendant

SOLVER = "rhoPimpleFoam"
TOOLS = (
    "blockMesh",
    "mirrorMesh",
    "surfaceFeatureExtract",
    "snappyHexMesh",
    "checkMesh",
    "decomposePar",
    "reconstructPar",
    SOLVER,
)
OLDEST = 1912
PLACES = ("/usr/share/openfoam", "/usr/lib/openfoam/openfoam*", "/opt/openfoam*")
WANTED = f"v{OLDEST} or a later one of openfoam.com is wanted (Debian: apt-get install openfoam)"

_REMEDIES = {
    "without the": "the library is a dummy in this installation; choose another method",
    "etc entry": "set WM_PROJECT_DIR to the folder that holds etc/controlDict",
    "administrator rights": "leave #calc and #codeStream out, or do not run as root",
    "Maximum number of iterations exceeded": "the temperatures have run away",
}


@dataclass(frozen=True)
class OpenFoam:
    """An installation that can be worked with.

    Attributes
    ----------
    version : str
        Such as "1912".
    environment : Mapping of str to str
        For its tools; those of `launcher` too.
    launcher : tuple of str
        The command that starts a program on several processes, up to their number.
    """

    version: str
    environment: Mapping[str, str]
    launcher: tuple[str, ...] = ()

    def environment_in(self, folder: Path) -> dict[str, str]:
        """For a tool at work in a folder, which goes by the folder's name as given here."""
        return {**self.environment, "PWD": f"{folder.absolute()}"}

    def command(self, folder: Path, tool: str, *arguments: str, processes: int = 1) -> list[str]:
        """Words of the command line for a tool at work in a folder."""
        if processes == 1:
            return [tool, *arguments]
        named = ("env", f"PWD={folder.absolute()}")  # mpirun would name another path of it
        return [*self.launcher, str(processes), *named, tool, *arguments, "-parallel"]


def find_openfoam(parallel: bool = False) -> OpenFoam:
    """Find OpenFOAM: its tools on the PATH, its settings by WM_PROJECT_DIR or in known places.

    Raises
    ------
    InputError
        If there is none, it is too old, it is the OpenFOAM Foundation's, or `parallel` is asked
        for and there is no mpirun.
    """
    roots = [p for place in PLACES for p in sorted(Path("/").glob(place[1:]), reverse=True)]
    if named := os.environ.get("WM_PROJECT_DIR"):
        roots.insert(0, Path(named))
    root = next((p for p in roots if (p / "etc/controlDict").is_file()), None)
    missing = [tool for tool in TOOLS if not shutil.which(tool)]
    if root and missing and (root / "etc/bashrc").is_file() and len(missing) == len(TOOLS):
        raise InputError(
            f"OpenFOAM is in {root}, but its tools are not on the PATH; source {root}/etc/bashrc"
        )
    if missing:
        raise InputError(
            f"OpenFOAM is not there: no {', '.join(missing)} on the PATH; apt-get install openfoam,"
            " or source the etc/bashrc of your own"
        )
    if not root:
        raise InputError(
            f"OpenFOAM's settings are not there: no etc/controlDict in WM_PROJECT_DIR"
            f" ({named or 'not set'}), {', '.join(PLACES)}; set WM_PROJECT_DIR to its folder"
        )
    environment = {**os.environ, "WM_PROJECT_DIR": f"{root}", "FOAM_SIGFPE": "true"}
    version = _version(environment)
    return OpenFoam(version, environment, _launcher() if parallel else ())


def available_processes() -> int:
    """On how many a small mesh is solved fastest: of each core one, up to four; 1 without MPI."""
    return min(len(os.sched_getaffinity(0)), 4) if shutil.which("mpirun") else 1


def _version(environment: Mapping[str, str]) -> str:
    """The version, if it is one that can be worked with."""
    asked = subprocess.run(
        [SOLVER, "-help"],
        env=environment,
        stdin=subprocess.DEVNULL,
        capture_output=True,
        text=True,
        errors="replace",
        timeout=60,
    )
    output = asked.stdout + asked.stderr
    if numbered := re.search(r"OpenFOAM-\S*\s+\(v?(\d{4})\)", output):
        if int(numbered[1]) >= OLDEST:
            return numbered[1]
        raise InputError(f"OpenFOAM v{numbered[1]} is too old; {WANTED}")
    named = re.search(r"OpenFOAM-(\S+)", output)
    which = named[1] if named else environment.get("WM_PROJECT_VERSION", "")
    if not which:
        last = (output.strip().splitlines() or ["it says nothing"])[-1]
        raise InputError(f"{SOLVER} -help does not show OpenFOAM's version ({last}); {WANTED}")
    raise InputError(
        f"OpenFOAM {which} is the OpenFOAM Foundation's (openfoam.org), whose cases are written"
        f" otherwise; {WANTED}"
    )


def _launcher() -> tuple[str, ...]:
    """The command for several processes, up to their number."""
    if not shutil.which("mpirun"):
        raise InputError(
            "several processes need mpirun, which is not on the PATH; apt-get install openmpi-bin,"
            " or ask for one process"
        )
    asked = subprocess.run(["mpirun", "--version"], capture_output=True, text=True, timeout=60)
    if "Open MPI" not in asked.stdout:
        return ("mpirun", "-np")
    passed = ("-x", "WM_PROJECT_DIR", "-x", "FOAM_SIGFPE")
    root = ("--allow-run-as-root",) if os.geteuid() == 0 else ()
    # Bound, two runs would share a core while others idle; waiting idly, they would block it.
    sharing = ("--oversubscribe", "--bind-to", "none", "--mca", "mpi_yield_when_idle", "1")
    return ("mpirun", *root, *sharing, *passed, "-np")


def tied(command: list[str], signal_number: int) -> list[str]:
    """The command, such that the program gets the signal when this process dies: once."""
    words = (attendant.__file__, signal_number, os.getpid())
    return [sys.executable, "-IS", *map(str, words), *command]


@contextmanager
def plain_path(folder: Path) -> Iterator[Path]:
    """Give a path of a folder that OpenFOAM takes: it refuses blanks, umlauts and the like."""
    if re.fullmatch(r"[\w./+~-]*", f"{folder.absolute()}", re.ASCII):
        yield folder
        return
    with scratch_folder() as place:
        link = place / "case"
        link.symlink_to(folder.absolute(), target_is_directory=True)
        try:
            yield link
        except InputError as error:
            raise type(error)(f"{error}".replace(f"{link}", f"{folder}")) from error


def run_tool(foam: OpenFoam, folder: Path, tool: str, *arguments: str) -> str:
    """Run a tool in a case, its output in `log.<tool>`, and give that output.

    Raises
    ------
    InputError
        If it fails, with the cause from its output.
    """
    log = folder / f"log.{tool}"
    with log.open("wb") as stream:
        ended = subprocess.run(
            tied(foam.command(folder, tool, *arguments), 9),
            cwd=folder,
            env=foam.environment_in(folder),
            stdin=subprocess.DEVNULL,
            stdout=stream,
            stderr=subprocess.STDOUT,
            start_new_session=True,
        )
    text = log.read_text(encoding="utf-8", errors="replace")
    cause = fatal_error(text)
    if ended.returncode or cause:
        raise InputError(f"{folder}: {tool} failed: {cause or ending(text, ended.returncode)}")
    return text


def fatal_error(text: str) -> str:
    """The cause that a log gives with FOAM FATAL, in a line with file, line and remedy; or ""."""
    lines = [re.sub(r"^\[\d+\] ?", "", line).strip() for line in text.splitlines()]
    starts = [i for i, line in enumerate(lines) if line.startswith("--> FOAM FATAL")]
    if not starts:
        return ""
    said: list[str] = []
    for line in lines[starts[0] + 1 :]:
        if line.startswith(("From ", "FOAM exiting", "FOAM aborting", "FOAM parallel run")):
            break
        said += [line] if line else []
    cause = "; ".join(said)
    remedies = [remedy for sign, remedy in _REMEDIES.items() if sign in cause]
    return "; ".join([cause, *remedies])


def ending(text: str, status: int) -> str:
    """How a program ended that gives no cause: by which signal, and its last line."""
    if status in (-9, 137):
        return "it was killed; if not by you, then for want of memory"
    if status in (-8, 136) or "sigFpe::sigHandler" in text:
        return "floating point exception"
    lines = [line for line in text.splitlines() if line.strip(" *-/\\")]
    return f"exit status {status}; the log's last line: {lines[-1].strip() if lines else 'none'}"
