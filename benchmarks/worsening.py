"""Make it worse until it fails: a trouble is raised, amount by amount, until a method fails."""

from __future__ import annotations

import math
from collections.abc import Callable, Sequence
from dataclasses import dataclass
from enum import IntEnum
from typing import Any

import numpy as np
from numpy.typing import ArrayLike, NDArray

Mask = NDArray[np.bool_]

WRONG_PX = 0.01
"""An error above which a result is wrong that counts as good."""


@dataclass(frozen=True)
class Outcome:
    """What came of one amount of a trouble, item by item.

    Attributes
    ----------
    reported : ndarray of bool of shape (N,)
        Items that a status, or an error, reports not to be good.
    wrong : ndarray of bool of shape (N,)
        Items that count as good, and are not.
    reports : sequence of str
        Names of the statuses or errors.
    largest_px : float
        Largest error of the items that count as good; NaN where it isn't measured.
    """

    reported: Mask
    wrong: Mask
    reports: Sequence[str] = ()
    largest_px: float = math.nan


@dataclass(frozen=True)
class Case:
    """A trouble for a method.

    Attributes
    ----------
    trouble, method : str
    amounts : sequence of float
        The mildest first.
    unit : str
    measure : callable
        From the amount to its `Outcome`.
    conditions : str
        What else was chosen.
    note : str
    share : float
        So many items may fail by chance.
    silent : bool
        Nothing can report it: the search ends where results are wrong.
    factor : float
        The first amount that fails is found to this factor between those given.
    """

    trouble: str
    method: str
    amounts: Sequence[float]
    unit: str
    measure: Callable[[float], Outcome]
    conditions: str
    note: str = ""
    share: float = 0.0
    silent: bool = False
    factor: float = math.inf


def judged(
    status: NDArray[Any], good: Sequence[IntEnum], error_px: ArrayLike, wrong_px: float = WRONG_PX
) -> Outcome:
    """Outcome of items (N,) with a status and, where it is good, an error; NaN counts as wrong."""
    reported = ~np.isin(status, good)
    error = np.where(reported, 0.0, np.nan_to_num(error_px, nan=np.inf))
    names = [type(good[0])(number).name for number in np.unique(status[reported])]
    return Outcome(reported, error > wrong_px, names, float(error.max(initial=0.0)))


def worsen(case: Case) -> dict[str, Any]:
    """Raise a trouble until the method fails: a row of the table of failures."""
    outcomes: dict[float, Outcome] = {}

    def share(kind: str, amount: float) -> float:
        if amount not in outcomes:
            outcomes[amount] = case.measure(amount)
        return float(np.mean(getattr(outcomes[amount], kind)))

    first = {
        kind: math.nan
        if case.silent and kind == "reported"
        else first_failing(lambda x, k=kind: share(k, x) > case.share, case.amounts, case.factor)
        for kind in ("wrong", "reported")
    }
    wrong, reported = (outcomes.get(first[kind]) for kind in ("wrong", "reported"))
    largest = [wrong] if wrong else outcomes.values()
    return {
        "trouble": case.trouble,
        "method": case.method,
        "unit": case.unit,
        "mildest": case.amounts[0],
        "severest": case.amounts[-1],
        "reported_from": first["reported"],
        "reported": int(reported.reported.sum()) if reported else 0,
        "reports": ", ".join(reported.reports) if reported else "",
        "wrong_from": first["wrong"],
        "wrong": int(wrong.wrong.sum()) if wrong else 0,
        "largest_error_px": float(f"{max(outcome.largest_px for outcome in largest):.3g}"),
        "items": (wrong or reported or next(iter(outcomes.values()))).wrong.size,
        "conditions": case.conditions,
        "note": case.note,
    }


def first_failing(
    fails: Callable[[float], bool], amounts: Sequence[float], factor: float = math.inf
) -> float:
    """The first amount that fails; NaN if none does.

    It is found to a factor between it and the one before, by halving on a logarithmic scale.
    """
    number = next((i for i, amount in enumerate(amounts) if fails(amount)), None)
    if number is None:
        return math.nan
    sound, first = amounts[max(number - 1, 0)], amounts[number]
    while math.isfinite(factor) and max(sound / first, first / sound) > factor:
        middle = float(f"{math.sqrt(sound * first):.3g}")
        sound, first = (sound, middle) if fails(middle) else (middle, first)
    return first
