"""One benchmark for all panels: configurations are timed on tasks whose answers are known."""

from __future__ import annotations

import statistics
import time
from collections.abc import Callable, Iterable, Iterator, Sequence
from dataclasses import dataclass, field, replace
from typing import Any

import numpy as np
from numpy.typing import NDArray

from virtual_sensor.display import Displayed
from virtual_sensor.engine import dr
from virtual_sensor.metrology.truth import largest, rms
from virtual_sensor.records import Record
from virtual_sensor.studies.pareto import not_beaten

Array = NDArray[np.float64]
Report = Callable[[str, float], None]
"""Gets what is being done, and which fraction of the whole is."""

RESOLVED_PX = 0.01
"""What a good sensor resolves: a smaller error of the computation shows in no measurement."""
EFFECT_PX = 10.0
"""What the hot air of the shipped scene moves its line by."""
UNUSUAL = 0.01
"""A configuration that fails in this share of its items more than the best is on no front."""
_NEAR_BOUND = 1.1  # times the bound: no detector can do much better


@dataclass(frozen=True)
class Configuration(Displayed):
    """A method with its settings, as a user would choose it.

    Attributes
    ----------
    name : str
        Of the method: "leapfrog", "tabulated", "newton", "gaussian".
    kind : str
        What the method is a variety of: its transport, its search, its detector.
    prepare : callable
        Makes ready what need not be timed, and returns the work: a function of nothing that
        evaluates all that it computes.
    chosen : dict
        The settings in which it differs from others of its name.
    defaults : dict
        The other settings that it used.
    warm_up : callable, optional
        Compiles what the work needs, in less time than the work takes.
    note : callable, optional
        Asked after the work.
    """

    name: str
    kind: str
    prepare: Callable[[], Callable[[], Any]]
    chosen: dict[str, Any] = field(default_factory=dict)
    defaults: dict[str, Any] = field(default_factory=dict)
    warm_up: Callable[[], object] | None = None
    note: Callable[[], str] | None = None


@dataclass(frozen=True)
class Score(Displayed):
    """How wrong a result is.

    Attributes
    ----------
    error_px, error_um : ndarray of shape (N,)
        Of the items that are judged, in the camera's pixels and on the part; NaN of those without
        a result.
    failed : int
        Items with a status that is not good.
    note : str
    """

    error_px: Array
    error_um: Array
    failed: int
    note: str = ""


@dataclass(frozen=True)
class Task(Displayed):
    """Work whose right answer is known.

    Attributes
    ----------
    name : str
        What is done.  Errors of one task compare, those of others do not.
    reference : str
        What the errors are against.
    items : int
        Rays, frames, points or columns that a run holds.
    score : callable
        A work's result to a `Score`.
    configurations : sequence of Configuration
    bound_px : float
        Smallest rms error that is possible; 0 where nothing bounds it.
    """

    name: str
    reference: str
    items: int
    score: Callable[[Any], Score]
    configurations: Sequence[Configuration]
    bound_px: float = 0.0


@dataclass(frozen=True)
class Measured(Record):
    """A configuration as it was measured on this machine.

    Attributes
    ----------
    panel : str
        "rays", "frames", "search", "correction", "fringes", "camera", "bounces" or "lines".
    task : str
        What was done: errors of one task compare, those of others do not.
    name : str
        Of the method.
    kind : str
        What the method is a variety of: its transport, its search, its detector.
    chosen : dict
        The settings in which it differs from others of its name.
    defaults : dict
        The other settings that it used.
    rms_px : float
        Rms error, in the camera's pixels.
    largest_px : float
        Largest error.
    rms_um : float
        Rms error on the part; NaN where there is no part.
    time_s : float
        For one item: warm, synchronised, the median of several runs.
    items : int
        Rays, frames, laser points or columns that a run holds.
    failed : int
        Items with a status that is not good.
    reference : str
        What the errors are against.
    bound_px : float
        Smallest rms error that is possible in this task; 0 where nothing bounds it.
    on_front : bool
        Whether no other of its task is both faster and more accurate.
    note : str
        What else is to be known.
    """

    panel: str
    task: str
    name: str
    kind: str
    chosen: dict[str, Any]
    defaults: dict[str, Any]
    rms_px: float
    largest_px: float
    rms_um: float
    time_s: float
    items: int
    failed: int
    reference: str
    bound_px: float = 0.0
    on_front: bool = False
    note: str = ""


def timed(work: Callable[[], Any], runs: int = 5, limit_s: float = 3.0) -> tuple[float, Any]:
    """Median time in s of some runs of `work`, and what the last one gave.

    Dr.Jit's threads are waited for.  No run starts after the limit.
    """
    times: list[float] = []
    while len(times) < runs and sum(times) < limit_s:
        dr.sync_thread()
        began = time.perf_counter()
        result = work()
        dr.sync_thread()
        times.append(time.perf_counter() - began)
    return statistics.median(times), result


def measure(panel: str, task: Task, configuration: Configuration, runs: int = 5) -> Measured:
    """Time a configuration, warm, and judge what it gives."""
    work = configuration.prepare()
    (configuration.warm_up or work)()
    seconds, result = timed(work, runs)
    score = task.score(result)
    notes = [score.note, configuration.note() if configuration.note else ""]
    return Measured(
        panel,
        task.name,
        configuration.name,
        configuration.kind,
        configuration.chosen,
        configuration.defaults,
        rms(score.error_px),
        largest(score.error_px),
        rms(score.error_um),
        seconds / task.items,
        task.items,
        score.failed,
        task.reference,
        task.bound_px,
        note="; ".join(filter(None, notes)),
    )


def measure_all(
    panel: str, tasks: Iterable[Task], report: Report, runs: int = 5
) -> Iterator[Measured]:
    """Measure every configuration of every task of a panel."""
    work = [(task, each) for task in tasks for each in task.configurations]
    for number, (task, each) in enumerate(work):
        report(f"{panel}: {each.name.replace('_', ' ')}", number / len(work))
        yield measure(panel, task, each, runs)


def front(measured: Sequence[Measured]) -> list[Measured]:
    """The Pareto front of one task's configurations, the fastest first.

    A configuration is on it if no other is at least as fast and at least as accurate, and better in
    one of the two.  Those whose error or time is unknown are not on it, nor are those that fail
    much more often than others: an error over the easy items alone says too little.
    """
    known = [m for m in measured if np.isfinite([m.rms_px, m.time_s]).all() and m.failed < m.items]
    least = min((m.failed / m.items for m in known), default=0.0)
    usual = [m for m in known if m.failed / m.items <= least + UNUSUAL]
    return not_beaten(usual, lambda m: (m.time_s, m.rms_px))


def with_fronts(measured: Sequence[Measured]) -> tuple[Measured, ...]:
    """The same, each with the word whether it is on the front of its task."""
    tasks: dict[tuple[str, str], list[Measured]] = {}
    for each in measured:
        tasks.setdefault((each.panel, each.task), []).append(each)
    best = {id(each) for task in tasks.values() for each in front(task)}
    return tuple(replace(each, on_front=id(each) in best) for each in measured)


def on_front(measured: Iterable[Measured]) -> list[Measured]:
    """Those that `with_fronts` found on a front, the fastest first."""
    return sorted((m for m in measured if m.on_front), key=lambda m: m.time_s)


def enough_px(measured: Measured) -> float:
    """Error in px that is as good as none: what a sensor resolves, or what no detector beats."""
    return max(RESOLVED_PX, _NEAR_BOUND * measured.bound_px)


def enough(measured: Sequence[Measured]) -> Measured | None:
    """The fastest of one task's front whose error is as good as none."""
    return next((m for m in on_front(measured) if m.rms_px <= enough_px(m)), None)
