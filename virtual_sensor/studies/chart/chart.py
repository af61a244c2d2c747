"""Error against time, for every configuration of every job, as this machine does it."""

from __future__ import annotations

import os
import pickle
import subprocess
import sys
import time
from collections.abc import Iterable, Sequence
from dataclasses import dataclass, replace
from importlib import import_module
from pathlib import Path
from typing import Any

from virtual_sensor import engine
from virtual_sensor.display import Displayed
from virtual_sensor.errors import InputError
from virtual_sensor.files import scratch_folder
from virtual_sensor.records import Record, record_columns
from virtual_sensor.studies.chart.benchmark import (
    Measured,
    Report,
    Task,
    measure_all,
    on_front,
    with_fronts,
)
from virtual_sensor.studies.chart.failures import Failures, failures
from virtual_sensor.studies.chart.scaling import Scaling
from virtual_sensor.studies.machine import Machine, cuda_found, machine

CUDA_VARIANT = "cuda_ad_mono"
_CUDA_LIMIT_S = 1800.0
_ON_GPU = (
    "import sys; from virtual_sensor.studies.chart.chart import hand_over;"
    " hand_over(sys.argv[1], sys.argv[2].split(','), sys.argv[3] == 'quick')"
)


@dataclass(frozen=True)
class Panel(Displayed):
    """One of the chart's panels.

    Attributes
    ----------
    module : str
        In this folder, with a function `tasks`.
    share : float
        Of the time that all panels take, roughly.
    on_gpu : bool
        Whether a GPU gets rows of its own.
    """

    module: str
    share: float
    on_gpu: bool = False


PANELS = {
    "rays": Panel("rays", 0.35, on_gpu=True),
    "frames": Panel("frames", 0.5, on_gpu=True),
    "search": Panel("searches", 0.12),
    "correction": Panel("corrections", 0.1),
    "fringes": Panel("fringes", 0.1),
    "camera": Panel("cameras", 0.15),
    "bounces": Panel("bounces", 0.15),
    "lines": Panel("detectors", 0.03),
}


@dataclass(frozen=True)
class Chart(Record):
    """All that was measured.

    Attributes
    ----------
    measured : tuple of Measured
        Every configuration.
    scalings : tuple of Scaling
        How times grow with the size of the work, point by point.
    failures : Failures
        Where methods fail, as it comes with this version.
    frame_memory_mb : float
        Peak memory of a process that renders a frame; NaN where no frames were asked for.
    machine : Machine
        What it was measured on.
    notes : tuple of str
        What the reader should know besides.
    time_s : float
        Of the whole.
    """

    measured: tuple[Measured, ...]
    scalings: tuple[Scaling, ...]
    failures: Failures
    frame_memory_mb: float
    machine: Machine
    notes: tuple[str, ...]
    time_s: float

    def _line(self) -> str:
        count = f"{len(self.measured)} configurations"
        return f"{count} of {', '.join(self.panels)}, in {self.time_s:.3g} s"

    def _columns(self) -> dict[str, Any]:
        return record_columns(Measured, self.measured)

    @property
    def panels(self) -> list[str]:
        """Names of the panels that were measured, in the chart's order."""
        return [name for name in PANELS if any(m.panel == name for m in self.measured)]

    def tasks(self, panel: str) -> list[str]:
        """Names of a panel's tasks, the one that its picture shows first."""
        return list(dict.fromkeys(m.task for m in self.measured if m.panel == panel))

    def of(self, panel: str, task: str = "") -> list[Measured]:
        """What was measured of a task; by default of that which the panel's picture shows."""
        task = task or self.tasks(panel)[0]
        return [m for m in self.measured if (m.panel, m.task) == (panel, task)]

    def front(self, panel: str, task: str = "") -> list[Measured]:
        """The Pareto front of the same, the fastest first."""
        return on_front(self.of(panel, task))


def check_panels(panels: Sequence[str]) -> list[str]:
    """The panels asked for, each once, in the chart's order; all of them if none is named.

    Raises
    ------
    InputError
        If there is no such panel.
    """
    unknown = [name for name in panels if name not in PANELS]
    if unknown:
        raise InputError(f"--panel {unknown[0]}: the chart has {', '.join(PANELS)}")
    return [name for name in PANELS if name in panels or not panels]


def chart(
    panels: Sequence[str] = (), quick: bool = False, report: Report = lambda stage, fraction: None
) -> Chart:
    """Measure every configuration of some panels.

    Parameters
    ----------
    panels : sequence of str
        Names out of `PANELS`; all of them if there is none.
    quick : bool
        Few configurations on small tasks: to see that all works, not to judge by.
    report : callable

    Raises
    ------
    InputError
        If there is no such panel.
    """
    chosen = check_panels(panels)
    began = time.perf_counter()
    found, notes, scalings, memory_mb = machine(), list[str](), list[Scaling](), float("nan")
    if quick:
        notes.append("quick: few configurations on small tasks, which show that all works")
    measured = measure_panels(chosen, quick, lambda stage, done: report(stage, 0.9 * done))
    if "frames" in chosen:
        # Imported only now: those who ask for no frames need not wait for what makes them.
        from virtual_sensor.studies.chart import scaling

        scalings += scaling.by_samples(measured)
        scalings += scaling.by_field(lambda stage, part: report(stage, 0.9 + 0.06 * part), quick)
        report("the memory of a frame", 0.96)
        memory_mb = scaling.frame_memory_mb(quick)
    if engine.activate().backend == "llvm" and cuda_found():
        report("the same on the GPU", 0.97)
        more, words = on_gpu([name for name in chosen if PANELS[name].on_gpu], quick)
        measured += more
        notes += words
    return Chart(
        with_fronts(measured),
        tuple(scalings),
        failures(chosen),
        memory_mb,
        found,
        tuple(notes),
        time.perf_counter() - began,
    )


def measure_panels(
    panels: Sequence[str], quick: bool, report: Report = lambda stage, fraction: None
) -> list[Measured]:
    """Every configuration of some panels, by this process."""
    measured: list[Measured] = []
    whole, done = sum(PANELS[name].share for name in panels), 0.0
    for name in panels:
        share = PANELS[name].share / whole

        def on(stage: str, part: float, start: float = done, share: float = share) -> None:
            report(stage, start + share * part)

        on(f"{name}: references", 0.0)
        measured += measure_all(name, tasks_of(name, quick), on, 1 if quick else 5)
        done += share
    variant = {"variant": engine.activate().variant}
    return [replace(each, defaults=each.defaults | variant) for each in measured]


def tasks_of(panel: str, quick: bool) -> Iterable[Task]:
    """The tasks of a panel, whose module is imported only where it is asked for."""
    tasks: Iterable[Task] = import_module(f"{__package__}.{PANELS[panel].module}").tasks(quick)
    return tasks


def on_gpu(panels: Sequence[str], quick: bool) -> tuple[list[Measured], list[str]]:
    """What a process that computes on the GPU measures of some panels, and what failed there."""
    if not panels:
        return [], []
    with scratch_folder() as folder:
        place = Path(folder, "measured")
        words = [f"{place}", ",".join(panels), "quick" if quick else "whole"]
        try:
            ended = subprocess.run(
                [sys.executable, "-c", _ON_GPU, *words],
                env=os.environ | {"VIRTUAL_SENSOR_VARIANT": CUDA_VARIANT},
                capture_output=True,
                text=True,
                errors="replace",
                timeout=_CUDA_LIMIT_S,
            )
        except (OSError, subprocess.TimeoutExpired) as error:
            return [], [f"no rows of the GPU: {error}"]
        if ended.returncode != 0:
            last = (ended.stderr.strip().splitlines() or ["it printed nothing"])[-1]
            return [], [f"no rows of the GPU: its process ended with {ended.returncode}: {last}"]
        return received(place), []


def hand_over(path: str, panels: Sequence[str], quick: bool) -> None:
    """Measure some panels, and write what `received` reads in another process."""
    Path(path).write_bytes(pickle.dumps(measure_panels(panels, quick)))


def received(path: Path) -> list[Measured]:
    """What another process of this program measured, as chosen to be on its variant."""
    rows: list[Measured] = pickle.loads(path.read_bytes())
    return [replace(row, chosen=row.chosen | {"variant": row.defaults["variant"]}) for row in rows]
