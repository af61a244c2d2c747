"""Error against time, for every rung of the ladder, as this machine does it; and the failures."""

from __future__ import annotations

import subprocess
import sys
import time
from collections.abc import Sequence
from dataclasses import dataclass, replace
from importlib import import_module
from pathlib import Path

from virtual_sensor import engine
from virtual_sensor.errors import InputError
from virtual_sensor.files import scratch_folder
from virtual_sensor.studies.chart.machine import cuda_found, machine
from virtual_sensor.studies.chart.pareto import pareto
from virtual_sensor.studies.chart.rows import RUNGS, read_rungs
from virtual_sensor.studies.chart.rung import Failure, Report, Rung, Scaling

_ROOM = "virtual_sensor.studies.chart"
CUDA_VARIANT = "cuda_ad_mono"
_CUDA_LIMIT_S = 1800.0
_MEMORY = "peak memory of a frame"


@dataclass(frozen=True)
class Panel:
    """One of the chart's panels.

    Attributes
    ----------
    title : str
    rungs, failures : str
        Modules of this room with a function of the same name.
    counted : str
        What the time is for.
    share : float
        Of the time that all panels take, roughly.
    on_gpu : bool
        Whether a GPU gets rows of its own.
    """

    title: str
    rungs: str
    failures: str
    counted: str
    share: float
    on_gpu: bool = False


PANELS = {
    "rays": Panel("Bent rays", "rays", "ray_failures", "ray", 0.35, on_gpu=True),
    "frames": Panel("Rendered frames", "frames", "frame_failures", "frame", 0.5, on_gpu=True),
    "search": Panel("Search for laser points", "searches", "search_failures", "laser point", 0.12),
    "lines": Panel("Line detectors", "detectors", "line_failures", "column", 0.03),
}


@dataclass(frozen=True)
class Chart:
    """All that was measured.

    Attributes
    ----------
    rungs : list of Rung
    failures : list of Failure
    scalings : list of Scaling
    machine : dict
        Facts of the machine, by their names.
    notes : tuple of str
        What the reader should know besides.
    seconds : float
        Of the whole.
    """

    rungs: list[Rung]
    failures: list[Failure]
    scalings: list[Scaling]
    machine: dict[str, str]
    notes: tuple[str, ...]
    seconds: float

    @property
    def panels(self) -> list[str]:
        """Names of the panels that have rungs, in the chart's order."""
        return [name for name in PANELS if self.of(name)]

    def of(self, panel: str) -> list[Rung]:
        """The rungs of one panel."""
        return [rung for rung in self.rungs if rung.panel == panel]

    def fronts(self, panel: str) -> dict[str, list[Rung]]:
        """For each reference, its rungs that no other beats in time and error, fastest first.

        Errors against other references are of other tasks, which do not compare.  The reference of
        most rungs comes first.
        """
        tasks: dict[str, list[Rung]] = {}
        for rung in self.of(panel):
            tasks.setdefault(rung.reference, []).append(rung)
        ordered = sorted(tasks.items(), key=lambda task: -len(task[1]))
        return {reference: pareto(rungs) for reference, rungs in ordered}

    def front(self, panel: str) -> list[Rung]:
        """All fronts of a panel, one after the other."""
        return [rung for front in self.fronts(panel).values() for rung in front]


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
    panels: Sequence[str] = (),
    quick: bool = False,
    report: Report = lambda stage, fraction: None,
) -> Chart:
    """Measure every rung of some panels, and where their methods fail.

    Parameters
    ----------
    panels : sequence of str
        Names out of `PANELS`; all of them if there is none.
    quick : bool
        Few rungs on small tasks: to see that all works, not to judge by.
    report : callable

    Raises
    ------
    InputError
        If there is no such panel.
    """
    chosen = check_panels(panels)
    started = time.perf_counter()
    facts, notes = machine(), list[str]()
    variant = facts["variant"]
    rungs: list[Rung] = []
    failures: list[Failure] = []
    scalings: list[Scaling] = []
    if quick:
        notes.append("quick: few rungs on small tasks, which show that all works and no more")
    whole, done = 1.1 * sum(PANELS[name].share for name in chosen), 0.0
    for name in chosen:
        panel, share = PANELS[name], PANELS[name].share / whole
        for kind, first, part in (("rungs", 0.0, 0.7), ("failures", 0.7, 0.3)):
            start = done + first * share

            def on(
                stage: str, fraction: float, start: float = start, part: float = part * share
            ) -> None:
                report(stage, start + part * fraction)

            made = getattr(import_module(f"{_ROOM}.{getattr(panel, kind)}"), kind)(on, quick)
            (rungs if kind == "rungs" else failures).extend(made)
        done += share
    rungs = [replace(r, settings={"variant": variant} | r.settings) for r in rungs]
    if "frames" in chosen:
        # Imported only now: those who ask for no frames need not wait for what makes them.
        scaling = import_module(f"{_ROOM}.scaling")
        scalings += scaling.by_samples(rungs)
        scalings += scaling.by_field(lambda stage, part: report(stage, done + 0.06 * part), quick)
        report("the memory of a frame", done + 0.06)
        film, spp = scaling.memory_task(quick)
        facts[_MEMORY] = (
            f"{scaling.peak_memory_mb(film, spp):.0f} MB, of {film} x {film} px with {spp} samples"
            " a pixel, in a process of its own"
        )
    if engine.activate().backend == "llvm" and cuda_found():
        report("the same on the GPU", 0.97)
        more, words = on_gpu([name for name in chosen if PANELS[name].on_gpu], quick)
        rungs += more
        notes += words
    return Chart(rungs, failures, scalings, facts, tuple(notes), time.perf_counter() - started)


def on_gpu(panels: Sequence[str], quick: bool) -> tuple[list[Rung], list[str]]:
    """The same panels' rungs by a process that computes on the GPU, and what went wrong there."""
    if not panels:
        return [], []
    options = [word for name in panels for word in ("--panel", name)]
    with scratch_folder() as folder:
        place = Path(folder, "gpu")
        command = [sys.executable, "-c", "from virtual_sensor.cli import main; main()"]
        command += ["--variant", CUDA_VARIANT, "chart", *options, "-o", f"{place}"]
        try:
            ended = subprocess.run(
                [*command, *(["--quick"] if quick else [])],
                capture_output=True,
                text=True,
                errors="replace",
                timeout=_CUDA_LIMIT_S,
            )
        except (OSError, subprocess.TimeoutExpired) as error:
            return [], [f"no rows of the GPU: {error}"]
        if ended.returncode != 0:
            said = (ended.stderr.strip().splitlines() or ["nothing was said"])[-1]
            return [], [f"no rows of the GPU: its process ended with {ended.returncode}: {said}"]
        return read_rungs(place / RUNGS), []
