"""The solver at work: its process, its log as it grows, and the signs that it diverges."""

from __future__ import annotations

import re
import signal
import subprocess
import time
from dataclasses import dataclass, field
from pathlib import Path

from virtual_sensor.errors import InputError
from virtual_sensor.medium.heat_flow.openfoam import SOLVER, OpenFoam, ending, fatal_error, tied
from virtual_sensor.medium.heat_flow.saved import last_record

LOG = f"log.{SOLVER}"
TEMPERATURE_MARGIN = 0.15  # of wall less ambient; coarse cells undershoot by 0.05, and stay there
TEMPERATURE_MARGIN_K = 50.0  # at least
SHORTEST_STEP_S = 1e-7
UNEASY, EXPLODED = 3.0, 10.0  # times the largest Courant number that was asked for
STOP_LIMIT_S = 60.0  # for the current step and its files, or 30 such steps
_COURANT = re.compile(r"Courant Number mean: \S+ max: (\S+)")
_RESIDUAL = re.compile(r"Solving for (\w+), Initial residual = ([^,\s]+)")


@dataclass(frozen=True)
class Step:
    """A finished time step: flow time and length in s, initial residuals of its last iteration."""

    time_s: float
    length_s: float
    courant: float
    residuals: dict[str, float]


@dataclass
class SolverLog:
    """A log that is followed while it grows."""

    path: Path
    start: int  # where this run's part begins, bytes
    stops_on_signal: bool = False
    _place: int = -1
    _rest: str = ""
    _time_s: float = 0.0
    _length_s: float = 0.0
    _courant: float = 0.0
    _residuals: dict[str, float] = field(default_factory=dict)

    def read(self) -> list[Step]:
        """Read on; give the steps that were finished since the last time."""
        with self.path.open("rb") as stream:
            self._place = stream.seek(max(self._place, self.start))
            more = stream.read()
        self._place += len(more)
        *lines, self._rest = (self._rest + more.decode(errors="replace")).split("\n")
        return [step for line in lines if (step := self._take(line))]

    def text(self) -> str:
        """The last part of what this run has written."""
        with self.path.open("rb") as stream:
            end = stream.seek(0, 2)
            stream.seek(max(self.start, end - 200_000))
            return stream.read().decode(errors="replace")

    def _take(self, line: str) -> Step | None:
        if found := _RESIDUAL.search(line):
            self._residuals[found[1]] = _number(found[2])
        elif found := _COURANT.match(line):
            self._courant = _number(found[1])
        elif line.startswith("deltaT = "):
            self._length_s = _number(line[9:])
        elif line.startswith("Time = "):
            self._time_s = _number(line[7:])
            self._residuals = {}
        elif line.startswith("sigStopAtWriteNow"):
            self.stops_on_signal = True
        elif line.startswith("ExecutionTime"):
            return Step(self._time_s, self._length_s, self._courant, self._residuals)
        return None


class Solver:
    """The solver's process in a case; as a context, ended in good order whatever happens.

    It belongs to this process: when this one is killed, it writes its fields and stops.
    """

    def __init__(self, foam: OpenFoam, folder: Path, processes: int, lock: int) -> None:
        path = folder / LOG
        self.log = SolverLog(path, path.stat().st_size if path.exists() else 0)
        self._steps = 0
        self._begun = time.monotonic()
        command = foam.command(folder, SOLVER, processes=processes)
        with path.open("ab") as stream:
            self._process = subprocess.Popen(
                tied(command, signal.SIGUSR2),
                cwd=folder,
                env=foam.environment_in(folder),
                stdin=subprocess.DEVNULL,
                stdout=stream,
                stderr=subprocess.STDOUT,
                start_new_session=True,  # a Ctrl-C is for us, who end it in good order
                pass_fds=(lock,),
            )

    def __enter__(self) -> Solver:
        return self

    def __exit__(self, kind: type[BaseException] | None, *_: object) -> None:
        try:
            if not (kind and issubclass(kind, InputError)):
                self.stop()
        finally:
            self.kill()

    @property
    def running(self) -> bool:
        """Whether it is at work."""
        return self._process.poll() is None

    def read(self) -> list[Step]:
        """Give the steps that were finished since the last time."""
        steps = self.log.read()
        self._steps += len(steps)
        return steps

    def stop(self) -> None:
        """Let it finish its step, write and end; what has not begun to step just ends."""
        self.read()
        if not (self.running and self.log.stops_on_signal and self._steps):
            return self.kill()
        self._process.send_signal(signal.SIGUSR2)
        pace = (time.monotonic() - self._begun) / self._steps
        try:
            self._process.wait(max(STOP_LIMIT_S, 30.0 * pace))
        except subprocess.TimeoutExpired:
            self.kill()
        return None

    def kill(self) -> None:
        """End it at once; mpirun needs a moment to end the others."""
        if self.running:
            self._process.terminate()
            try:
                self._process.wait(10.0)
            except subprocess.TimeoutExpired:
                self._process.kill()
                self._process.wait()

    @property
    def failure(self) -> str:
        """The log's cause, once it has ended otherwise than well; or ""."""
        status = self._process.returncode
        text = self.log.text()
        return fatal_error(text) or (ending(text, status) if status else "")


@dataclass
class Watch:
    """Watches for signs that a run diverges, and knows until when it was sound.

    Attributes
    ----------
    ambient_k, wall_k : float
        Between them all temperatures must lie, but for a margin, K.
    max_courant : float
        As it was asked for.
    sound_until_s : float
        Flow time, s, up to which nothing was amiss.
    """

    ambient_k: float
    wall_k: float
    max_courant: float
    sound_until_s: float
    _uneasy: bool = field(default=False, init=False)

    def check(self, folder: Path, steps: list[Step]) -> str:
        """Check new steps and the newest extremes; give what shows divergence, or ""."""
        limit = max(self.max_courant, 1.0)
        for step in steps:
            self._uneasy |= not step.courant <= UNEASY * limit
            if not step.courant <= EXPLODED * limit:
                return (
                    f"Courant number {step.courant:.3g}, where {self.max_courant:g} was asked for"
                )
            if not step.length_s >= SHORTEST_STEP_S:
                return f"the time step has shrunk to {step.length_s:.2g} s"
        record = last_record(folder, "extremes")
        if not record:
            return ""
        when, coldest, hottest = record[:3]
        margin = max(TEMPERATURE_MARGIN * (self.wall_k - self.ambient_k), TEMPERATURE_MARGIN_K)
        if not coldest >= self.ambient_k - margin:
            return f"{coldest:.0f} K, below the surrounding air's {self.ambient_k:.0f} K"
        if not hottest <= self.wall_k + margin:
            return f"{hottest:.0f} K, above the wall's {self.wall_k:.0f} K"
        if not self._uneasy:
            self.sound_until_s = max(self.sound_until_s, when)
        return ""


def _number(text: str) -> float:
    """A number of the log; one that is garbled, as by a crash, is none."""
    try:
        return float(text)
    except ValueError:
        return float("nan")
