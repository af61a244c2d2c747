"""What the chart is made of: rungs, with their error and their time, and where methods fail."""

import statistics
import time
from collections.abc import Callable
from dataclasses import dataclass
from typing import Any

from virtual_sensor.engine import dr

Report = Callable[[str, float], None]
"""Told what is being done, and which fraction of the whole is."""


@dataclass(frozen=True)
class Rung:
    """One way of doing something, as it was measured on this machine.

    Attributes
    ----------
    panel : str
        "rays", "frames", "search" or "lines".
    name : str
        Of the method, as a user would choose it.
    settings : dict
        All that the method was given.
    error_px, largest_px : float
        Rms and largest error of what was found, in the camera's pixels.
    error_um : float
        The rms on the part, um; NaN where it means nothing.
    seconds : float
        For one item: warm, synchronised, the median of several runs.
    item : str
        What is counted: "ray", "frame", "laser point" or "column".
    items, failed : int
        How many of them a run holds, and how many got a status that is not good.
    reference : str
        What the errors are against.
    note : str
    """

    panel: str
    name: str
    settings: dict[str, Any]
    error_px: float
    largest_px: float
    error_um: float
    seconds: float
    item: str
    items: int
    failed: int
    reference: str
    note: str = ""


@dataclass(frozen=True)
class Failure:
    """Where a method first fails, and how it is told.

    Attributes
    ----------
    what : str
        The trouble: "laser's map folds", "steps too long".
    method : str
    first_at : str
        The setting at which it first fails, with its unit; "" if never within what was tried.
    tried : str
        The settings tried, in words.
    status : str
        The status that tells of it, or how the error grows where none can.
    failed, of : int
        How many items failed there, of how many.
    note : str
    """

    what: str
    method: str
    first_at: str
    tried: str
    status: str
    failed: int
    of: int
    note: str = ""


@dataclass(frozen=True)
class Scaling:
    """How a time grows with the size of the work.

    Attributes
    ----------
    name : str
        "marched frame, samples per pixel".
    exponent : float
        Slope of log(time) over log(size), by least squares; NaN of fewer than two points.
    points : tuple of pairs
        (size, seconds).
    note : str
    """

    name: str
    exponent: float
    points: tuple[tuple[float, float], ...]
    note: str = ""


def timed(work: Callable[[], Any], runs: int = 5, warm_ups: int = 1) -> float:
    """Median time in s of some runs of `work`, which must evaluate what it computes.

    It is warmed up first, and Dr.Jit's threads are waited for.
    """
    seconds = []
    for number in range(runs + warm_ups):
        dr.sync_thread()
        began = time.perf_counter()
        work()
        dr.sync_thread()
        if number >= warm_ups:
            seconds.append(time.perf_counter() - began)
    return statistics.median(seconds)
