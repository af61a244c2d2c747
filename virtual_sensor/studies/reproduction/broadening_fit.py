"""How broad was the paper's plume?  One parameter, fitted to the numbers that the paper states."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray
from scipy.optimize import minimize_scalar

from virtual_sensor.studies.measure import Report
from virtual_sensor.studies.reproduction.curves import BLURRED, WIDENED, Setting, searched
from virtual_sensor.studies.reproduction.numbers import STATED
from virtual_sensor.studies.reproduction.settings import NINE_RAYS_MM, SCAN, Broadening, Scenes

Array = NDArray[np.float64]


@dataclass(frozen=True)
class Family:
    """One way to broaden.

    Attributes
    ----------
    air : str
        BLURRED or WIDENED.
    unit : str
        Of its parameter.
    tried : tuple of float
        First looked at, before the least cost among them is refined.
    of : callable
        The broadening of a parameter.
    """

    air: str
    unit: str
    tried: tuple[float, ...]
    of: Callable[[float], Broadening]


WIDEN = 2.75
"""A plume widened so much and then blurred also keeps the paper's *orders*, which no blur alone
does; found by trying factors from 1 to 3.5 (docs/reproduction.md)."""

FAMILIES = {
    BLURRED: Family(BLURRED, "mm", (4.0, 6.0, 8.0, 10.0), lambda s: Broadening(s)),
    WIDENED: Family(WIDENED, "mm", (4.0, 6.0, 8.0, 10.0), lambda s: Broadening(s, WIDEN)),
}
FINENESS = 0.1
"""A fitted parameter is rounded to so much: the paper's numbers have one or two digits."""


@dataclass(frozen=True)
class Fit:
    """A broadening fitted to the paper's numbers.

    Attributes
    ----------
    air, unit : str
        Of the family.
    tried, cost : ndarray of shape (K,)
        Parameters that were looked at, ascending, and the sum of squares of relative residuals.
    fitted : float
        The parameter of least cost, rounded to `FINENESS`.
    names, kind : tuple of J str
        The numbers, as `numbers.STATED` has them.
    paper, ours, resolved, residual : ndarray of shape (J,)
        The paper's, ours at `fitted` and in the air as simulated, and relative differences of ours.
    """

    air: str
    unit: str
    tried: Array
    cost: Array
    fitted: float
    names: tuple[str, ...]
    kind: tuple[str, ...]
    paper: Array
    ours: Array
    resolved: Array
    residual: Array

    @property
    def broadening(self) -> Broadening:
        """What was fitted."""
        return FAMILIES[self.air].of(self.fitted)


def fit_broadening(
    scenes: Scenes, family: Family, report: Report = lambda stage, fraction: None
) -> Fit:
    """Fit one parameter: bracket the least cost, refine it by a bounded search, round it.

    The cost is the sum of squared relative residuals; a bound that is kept adds nothing.
    """
    looked_at: dict[float, Array] = {}
    expected = len(family.tried) + 5

    def cost(parameter: float) -> float:
        if parameter not in looked_at:
            report(f"fitting {family.air} air", min(0.99, len(looked_at) / expected))
            looked_at[parameter] = stated(scenes, family.of(parameter))
            scenes.forget(family.of(parameter))
        return float(np.sum(_residuals(looked_at[parameter]) ** 2))

    least = int(np.argmin([cost(p) for p in family.tried]))
    low, high = family.tried[max(least - 1, 0)], family.tried[min(least + 1, len(family.tried) - 1)]
    found = minimize_scalar(
        cost, bounds=(low, high), method="bounded", options={"xatol": FINENESS, "maxiter": 5}
    )
    fitted = round(float(found.x) / FINENESS) * FINENESS
    fitted = float(f"{fitted:.6g}")
    cost(fitted)
    ours = looked_at[fitted]
    tried = np.array(sorted(looked_at))
    return Fit(
        family.air,
        family.unit,
        tried,
        np.array([cost(float(p)) for p in tried]),
        fitted,
        tuple(f"{s.name}, {s.unit}" for s in STATED),
        tuple(s.kind.value for s in STATED),
        np.array([s.paper for s in STATED]),
        ours,
        stated(scenes, Broadening()),
        _residuals(ours),
    )


def stated(scenes: Scenes, broadening: Broadening) -> Array:
    """Our values of the stated numbers in some air; shape (J,)."""
    curves = {}
    for pose in {(s.temperature_c, s.beta_deg) for s in STATED}:
        scene = scenes.scene(*pose, broadening)
        curves[pose] = searched(scene, Setting("", *pose), NINE_RAYS_MM, SCAN, helper=False)
    return np.array([s.ours(curves[s.temperature_c, s.beta_deg]) for s in STATED])


def _residuals(ours: Array) -> Array:
    return np.array([s.residual(value) for s, value in zip(STATED, ours, strict=True)])
