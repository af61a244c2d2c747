"""Which rungs are worth choosing: no other is both faster and more accurate."""

from collections.abc import Callable, Iterable, Sequence
from typing import TypeVar

import numpy as np

from virtual_sensor.studies.chart.rung import Rung

Item = TypeVar("Item")

UNUSUAL = 0.01
"""A rung that fails in this share of its items more than the panel's most reliable is left out."""


def pareto(rungs: Sequence[Rung]) -> list[Rung]:
    """The front of one panel's rungs, the fastest first.

    A rung is on it if no other is at least as fast and at least as accurate, and better in one of
    the two.  Rungs whose error or time is unknown are not on it, nor are those that fail much more
    often than others: an error over the easy items alone says too little.

    Parameters
    ----------
    rungs : sequence of Rung
        Of one panel.
    """
    known = [r for r in rungs if np.isfinite([r.error_px, r.seconds]).all() and r.failed < r.items]
    least = min((_share(r) for r in known), default=0.0)
    usual = [r for r in known if _share(r) <= least + UNUSUAL]
    return not_beaten(usual, lambda r: (r.seconds, r.error_px))


def not_beaten(items: Iterable[Item], cost: Callable[[Item], tuple[float, float]]) -> list[Item]:
    """Those that no other beats in both parts of their cost, by the first; equals stay together."""
    front: list[Item] = []
    for item in sorted(items, key=cost):
        if not front or cost(item)[1] < cost(front[-1])[1] or cost(item) == cost(front[-1]):
            front.append(item)
    return front


def _share(rung: Rung) -> float:
    """Which share of its items fails."""
    return rung.failed / rung.items
