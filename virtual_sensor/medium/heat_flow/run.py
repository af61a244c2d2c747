"""Run a case: solve, watch, stop, and go on without losing a time step.

The solver starts from the latest whole
time, and writes at multiples of the interval of writing. It reckons those from where it starts: one
that was stopped in between first does a leg to the next of them, set by the file `system/leg`.
"""

from __future__ import annotations

import fcntl
import math
import os
import shutil
import time
from collections import deque
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from dataclasses import dataclass
from pathlib import Path

from virtual_sensor import interrupts
from virtual_sensor.display import Displayed
from virtual_sensor.errors import InputError, Interrupted
from virtual_sensor.medium.heat_flow import saved
from virtual_sensor.medium.heat_flow.openfoam import OpenFoam, find_openfoam, plain_path
from virtual_sensor.medium.heat_flow.prepare import (
    distribute,
    make_mesh,
    parameters,
    set_parameters,
    setup_of,
)
from virtual_sensor.medium.heat_flow.solver import LOG, Solver, Step, Watch

SAME_TIME = 1e-6  # of the interval of writing; the names of times have eight digits
PERIOD_S = 0.1  # at which the solver is polled
PACE_WINDOW_S = 30.0  # over which its pace is taken
FIRST_STEPS = 8.0  # lengths of a step; while it grows by a fifth each time, all before are six
FULL_DISK_MB = 10.0
PATIENCE_S = 120.0  # with the solver of a killed run, which writes its last step


@dataclass(frozen=True)
class Progress(Displayed):
    """How far a run is.

    Attributes
    ----------
    stage : str
        What is being done.
    time_s, end_s : float
        Flow time reached and to be reached, s.
    seconds_left : float or None
        Estimate, s; None while there is nothing to base it on.
    step : Step or None
        The last time step, with Courant number and residuals.
    """

    stage: str
    time_s: float
    end_s: float
    seconds_left: float | None = None
    step: Step | None = None


@dataclass(frozen=True)
class RunEnd(Displayed):
    """Flow time at the end, s; this run's last step, if any; whether `stop` ended it."""

    time_s: float
    step: Step | None
    stopped: bool


def run_case(
    folder: Path,
    end_s: float,
    *,
    processes: int = 1,
    report: Callable[[Progress], None] = lambda _: None,
    stop: Callable[[float], bool] = lambda _: False,
) -> RunEnd:
    """Run a case from where it is up to a flow time.

    Parameters
    ----------
    folder : Path
        A case that `write_case` wrote.
    end_s : float
        Flow time, s; later than an earlier run's end, that one is gone on with.
    processes : int
        On which it is solved, over MPI if several; may change from run to run.
    report : callable
        Called with the progress, a few times a second at most.
    stop : callable
        Is asked after each saved time, s, whether this will do.

    Raises
    ------
    InputError
        If the folder is no case, another run is at work in it, OpenFOAM is not there or fails, or
        the run diverges; all sound times stay.
    Interrupted
        On KeyboardInterrupt or SystemExit, after the solver has written the current step.
    """
    made = setup_of(folder)
    foam = find_openfoam(processes > 1)
    try:
        with interrupts.raising(), plain_path(folder) as place, _alone(folder) as lock:
            saved.remove_unfinished(folder)
            report(Progress("meshing", _reached(folder), end_s))
            make_mesh(foam, place)
            report(Progress("distributing", _reached(folder), end_s))
            distribute(foam, place, processes, bool(made.get("section")))
            set_parameters(folder, endTime=f"{end_s:g}")
            return _Run(foam, place, end_s, processes, report, stop, lock).to_the_end()
    except BaseException as error:
        code = error.code if isinstance(error, SystemExit) else interrupts.exit_status(error)
        if code is None:
            raise
        raise Interrupted(folder, _reached(folder), code if isinstance(code, int) else 1) from error


@dataclass
class _Run:
    """A run of several legs: what it works with, and what it knows of its pace."""

    foam: OpenFoam
    folder: Path
    end_s: float
    processes: int
    report: Callable[[Progress], None]
    stop: Callable[[float], bool]
    lock: int

    def to_the_end(self) -> RunEnd:
        interval = float(parameters(self.folder)["writeInterval"])
        leg_file = self.folder / "system/leg"
        last: Step | None = None
        stopped = False
        try:
            while not stopped and (leg := next_leg(_reached(self.folder), self.end_s, interval)):
                leg_file.write_text(f"endTime {leg[0]:.10g};\nwriteInterval {leg[1]:.10g};\n")
                step, stopped = self._leg(leg[0])
                last = step or last
        finally:
            leg_file.unlink(missing_ok=True)
        return RunEnd(_reached(self.folder), last, stopped)

    def _leg(self, end_s: float) -> tuple[Step | None, bool]:
        """Run the solver once; give its last step, and whether `stop` ended it."""
        folder, start = self.folder, _reached(self.folder)
        saved.remove_series_from(folder, start)
        values = parameters(folder)
        names = ("ambientTemperature", "wallTemperature", "maxCourant")
        ambient, wall, courant = (float(values[name]) for name in names)
        watch = Watch(ambient, wall, courant, sound_until_s=start)
        pace: deque[tuple[float, float]] = deque([(time.monotonic(), start)])
        known, last, trouble, stopped = start, None, "", False
        with Solver(self.foam, folder, self.processes, self.lock) as solver:
            running = True
            while running and not (trouble or stopped):
                running = solver.running  # asked first, so that the last words are heard too
                steps = solver.read()
                trouble = watch.check(folder, steps)
                if steps:
                    last = steps[-1]
                    self.report(self._progress(pace, last))
                    known, stopped = self._ask(known, last)
                time.sleep(PERIOD_S if running else 0.0)
            if trouble:
                solver.kill()
        cause = solver.failure if not (stopped or trouble) else ""
        if trouble or cause:
            raise InputError(self._failed(watch, last.time_s if last else start, trouble, cause))
        if not stopped and _reached(folder) < end_s - SAME_TIME * end_s:
            raise InputError(self._unwritten(end_s))
        return last, stopped

    def _ask(self, known: float, step: Step) -> tuple[float, bool]:
        """Ask `stop` about times saved since; make sure that they are whole."""
        place = next(iter(saved.processor_folders(self.folder)), self.folder)
        newest = max(saved.time_folders(place).values(), default=0.0)
        if newest <= known:
            return known, False
        whole = [s.time_s for s in saved.times(self.folder) if s.time_s > known]
        if newest not in whole and step.time_s > newest + 2.0 * step.length_s:
            raise InputError(self._unwritten(newest))
        for when in whole:
            if self.stop(when):
                return when, True
        return max(whole, default=known), False

    def _progress(self, pace: deque[tuple[float, float]], step: Step) -> Progress:
        now = time.monotonic()
        pace.append((now, step.time_s))
        while len(pace) > 2 and pace[0][0] < now - PACE_WINDOW_S:
            pace.popleft()
        gone = step.time_s - pace[0][1]
        # The first steps are short, and each is longer than the one before: they show no pace.
        begun = gone > FIRST_STEPS * step.length_s
        left = (self.end_s - step.time_s) * (now - pace[0][0]) / gone if begun else None
        return Progress("solving", step.time_s, self.end_s, left, step)

    def _failed(self, watch: Watch, when: float, trouble: str, cause: str) -> str:
        """Put the folder in order after a failure, and describe it."""
        saved.remove_unfinished(self.folder)
        diverged = trouble or any(s in cause for s in ("floating point", "number of iterations"))
        if diverged:
            saved.remove_later(self.folder, watch.sound_until_s)
        left = f"the last sound time is {_reached(self.folder):.8g} s"
        if not diverged:
            full = "the disk is full; " if _free_mb(self.folder) < FULL_DISK_MB else ""
            what = f"the solver failed at {when:.8g} s of flow: {full}{cause}"
            return f"{self.folder}: {what}; {left}; see {LOG}"
        return (
            f"{self.folder}: diverged at {when:.8g} s of flow: {trouble or cause}; {left}; use"
            f" smaller time steps (maxCourant in {self.folder / 'parameters'}) or other cells"
        )

    def _unwritten(self, when: float) -> str:
        free = _free_mb(self.folder)
        saved.remove_unfinished(self.folder)
        return (
            f"{self.folder}: the fields at {when:.8g} s were not written; {free:.0f} MB of the"
            " disk are free. Make room; the same command goes on from"
            f" {_reached(self.folder):.8g} s"
        )


def next_leg(reached_s: float, end_s: float, interval_s: float) -> tuple[float, float] | None:
    """End and interval of writing, s, of the solver's next run; None if nothing is left to do."""
    if reached_s >= end_s - SAME_TIME * interval_s:
        return None
    written = math.floor(reached_s / interval_s + SAME_TIME)
    if reached_s - written * interval_s > SAME_TIME * interval_s:
        end = min((written + 1) * interval_s, end_s)
    else:
        last = math.floor(end_s / interval_s + SAME_TIME)
        end = last * interval_s if last > written else end_s
        if last > written:
            return end, interval_s
    return end, end - reached_s


def _free_mb(folder: Path) -> float:
    """Free room on the folder's disk, MB."""
    return shutil.disk_usage(folder).free / 1e6


def _reached(folder: Path) -> float:
    """The latest whole time, s."""
    return max((s.time_s for s in saved.times(folder)), default=0.0)


@contextmanager
def _alone(folder: Path) -> Iterator[int]:
    """Hold the case's lock, which the solver inherits: one run at a time."""
    try:
        lock = os.open(folder / ".lock", os.O_RDWR | os.O_CREAT, 0o644)
    except OSError as error:
        raise InputError(f"{folder}: can't be written ({error.strerror})") from error
    try:
        patience = time.monotonic() + PATIENCE_S
        while not _locked(lock):
            holder = int(os.pread(lock, 20, 0) or b"0")
            if Path(f"/proc/{holder}").exists():
                raise InputError(f"{folder}: another run is at work in it (process {holder})")
            if time.monotonic() > patience:
                raise InputError(f"{folder}: the solver of a killed run is still at work in it")
            time.sleep(PERIOD_S)
        os.pwrite(lock, f"{os.getpid():<20}".encode(), 0)
        yield lock
    finally:
        os.close(lock)


def _locked(lock: int) -> bool:
    try:
        fcntl.flock(lock, fcntl.LOCK_EX | fcntl.LOCK_NB)
    except BlockingIOError:
        return False
    return True
