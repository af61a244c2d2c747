"""What observations can tell of the air, a shape and poses, before anything is fitted."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace
from typing import Any, ClassVar

import numpy as np
from numpy.typing import ArrayLike, NDArray

from virtual_sensor.arrays import LARGEST, number_within
from virtual_sensor.calls import public
from virtual_sensor.display import Displayed, listed, with_spreads
from virtual_sensor.errors import InputError, few
from virtual_sensor.metrology.air_problem import Problem, State, problem_of
from virtual_sensor.metrology.normal_equations import (
    INVISIBLE,
    bound_of,
    condition_of,
    correlation_of,
    covariance_of,
    singular,
    taking_part,
    unit_columns,
)
from virtual_sensor.metrology.observations import Observation, Prior
from virtual_sensor.metrology.shapes import Shape
from virtual_sensor.optics.crossing_status import CrossingStatus
from virtual_sensor.statuses import StatusEnum

Array = NDArray[np.float64]
MAX_CONDITION = 1e4
"""Condition of the problem, its columns of equal length, from which on it is taken as singular."""
_ALIKE = 0.95  # correlation from which on two parameters are named as hard to tell apart
_ADDS_NOTHING = 0.9  # of the prior's standard deviation: data that leave more have told nothing
_TELLS_LITTLE = 0.5  # likewise, of a usual value that stands in where the data leave a choice


class EstimateStatus(StatusEnum):
    """What became of a parameter."""

    FOUND = 0, "The data tell its value."
    PRIOR = (
        1,
        "The data add nothing to its prior: measure from a second pose, or leave it out.",
    )
    NOT_TOLD_APART = (
        2,
        "The data can't tell it from the others, and it is held at its usual value: measure from a"
        " second pose, give a prior, or leave it out.",
    )
    AT_BOUND = (
        3,
        "The best value lies at the end of what is allowed: the air is of another kind than the"
        " model, or the start was far off.",
    )


@dataclass(frozen=True, eq=False)
class Identifiability(Displayed):
    """What data can tell of P parameters, whatever they turn out to be: told before any fit.

    Attributes
    ----------
    names, units : tuple of str
    bound : ndarray of shape (P,)
        Cramer and Rao's, of the data alone: no unbiased estimate has a smaller standard deviation.
        Infinite where the data leave a choice.
    alone : ndarray of shape (P,)
        The same if all other parameters were known.
    bound_with_priors : ndarray of shape (P,)
        The Bayesian one, with the priors' knowledge.
    correlation : ndarray of shape (P, P)
        Of the estimates, with the priors.
    singular_values : ndarray of shape (P,)
        Of the data's derivatives, columns of unit length; falling.
    condition : float
        Largest over smallest of these singular values; that of data and priors together is
        `condition_with_priors`.
    condition_with_priors : float
    status : ndarray of shape (P,)
        `EstimateStatus`.
    notes : tuple of str
        Which parameters can't be told apart.
    """

    _statuses: ClassVar = {"status": EstimateStatus}

    names: tuple[str, ...]
    units: tuple[str, ...]
    bound: Array
    alone: Array
    bound_with_priors: Array
    correlation: Array
    singular_values: Array
    condition: float
    condition_with_priors: float
    status: NDArray[np.int64]
    notes: tuple[str, ...] = ()

    def _columns(self) -> dict[str, Any]:
        found = {"parameter": self.names, "unit": self.units, "bound": self.bound}
        return found | {
            "alone": self.alone,
            "bound_with_priors": self.bound_with_priors,
            "status": self.status,
        }

    def _line(self) -> str:
        each = with_spreads(self.names, self.units, self.bound_with_priors)
        return listed(*each, f"condition {self.condition:.3g}")


@public
def identifiability(
    observations: Observation | Sequence[Observation],
    model: Any = None,
    names: Sequence[str] = ("scale", "width"),
    *,
    each: Sequence[str] = (),
    shape: Shape | None = None,
    free: Sequence[str] = (),
    pose_names: Sequence[str] = (),
    priors: Mapping[str, Prior] | None = None,
    known: Mapping[str, float] | None = None,
    max_condition: float = MAX_CONDITION,
    pivot_mm: ArrayLike = (0.0, 0.0, 0.0),
) -> Identifiability:
    """Tell what observations can say of parameters, without fitting any.

    Their pixels may be simulated ones, of a measurement that is planned.

    Parameters
    ----------
    observations, model, names, each, shape, free, pose_names, priors, known, pivot_mm
    max_condition
        As those of `estimate_air`.

    Raises
    ------
    InputError
        As `estimate_air` does.
    """
    problem = problem_of(
        *(observations, model, names, each, shape, free, pose_names, priors, known, pivot_mm), None
    )
    return begun(problem, max_condition)[2]


def begun(problem: Problem, max_condition: float) -> tuple[Problem, State, Identifiability]:
    """The problem with parameters held that the data leave open, and where the fit starts."""
    number_within("estimate_air: max_condition", max_condition, 1.0, LARGEST, "a condition")
    state = problem.at(np.array([u.start for u in problem.unknowns]))
    _check_points(problem, state.points, [each.residual for each in state.linear])
    problem, state = _near_shape(problem, state)
    state = problem.weighed(state)
    _check_points(problem, state.points, [np.where(used, 0.0, np.nan) for used in state.used])
    problem, told = _told(problem, state, max_condition)
    return problem, state, told


def _check_points(problem: Problem, points: Sequence[Any], residuals: Sequence[Array]) -> None:
    """Raise InputError unless each observation has something to tell."""
    for seen, found, residual in zip(problem.observations, points, residuals, strict=True):
        if np.isfinite(residual).any():
            continue
        why = next(iter(CrossingStatus.counts(found.status)), None)
        said = why.message if why is not None else "It has no pixels."
        if why == CrossingStatus.OK:
            said = (
                "Its points lie nowhere near the shape, or the shape lies in the laser's plane:"
                " check shape, place and pose."
            )
        raise InputError(
            f"estimate_air: observation '{seen.name}' has no point that counts. {said}"
        )


def _near_shape(problem: Problem, state: State) -> tuple[Problem, State]:
    """Start from the shape that is nearest to the points, if they determine it."""
    free = [u.parameter for u in problem.unknowns if u.kind == "shape"]
    if not free or problem.shape is None:
        return problem, state
    points = np.concatenate([each.point_mm for each in state.points])
    off = problem.shape.distance(points)
    points = points[np.isfinite(off.distance_mm)]
    by = np.column_stack([off.by_parameter[name] for name in free])
    by = by[np.isfinite(off.distance_mm)]
    size = np.linalg.norm(by, axis=0)
    if (
        len(points) < len(free)
        or not size.min() > INVISIBLE
        or np.linalg.cond(by / size) > MAX_CONDITION
    ):
        return problem, state
    near = problem.shape.fitted(points, free).values
    unknowns = tuple(
        replace(u, start=near[u.parameter]) if u.kind == "shape" else u for u in problem.unknowns
    )
    problem = replace(problem, unknowns=unknowns)
    return problem, problem.reshaped(np.array([u.start for u in unknowns]), state)


def _told(problem: Problem, state: State, max_condition: float) -> tuple[Problem, Identifiability]:
    """What the data tell, with those parameters of the air held that they don't."""
    names = [u.name for u in problem.unknowns]
    notes: list[str] = []
    _, by = state.rows()
    while True:
        both = np.concatenate([by, problem.priors(state.x)[1]])
        unit, _ = unit_columns(both)
        values, vectors = singular(unit)
        open_ = [
            k for k, u in enumerate(problem.unknowns) if u.applied is None and u.usual is not None
        ]
        if not names:
            break
        if values[0] > max_condition * values[-1]:
            group = taking_part(vectors[-1])
            those = [k for k in open_ if k in group]
            if not those:
                raise InputError(_refusal([names[k] for k in group], condition_of(values)))
        else:
            sigma = np.sqrt(np.diag(covariance_of(both)))
            those = [k for k in open_ if sigma[k] > problem.unknowns[k].usual.sigma]  # type: ignore[union-attr]
            if not those:
                break
            those = [max(those, key=lambda k: sigma[k] / problem.unknowns[k].usual.sigma)]  # type: ignore[union-attr]
            share = np.abs(correlation_of(covariance_of(both))[those[0]])
            group = np.flatnonzero(share > _ALIKE).tolist()
        held = max(those)
        usual = problem.unknowns[held].usual
        others = [names[k] for k in group if k != held]
        like = f"can't be told from {' and '.join(others)}" if others else "hardly shows"
        notes.append(
            f"{names[held]} {like} in these images: it is held at its usual"
            f" {usual.value:g} ± {usual.sigma:.2g}; measure from a second pose, or give a prior of"  # type: ignore[union-attr]
            " your own"
        )
        unknowns = list(problem.unknowns)
        unknowns[held] = replace(unknowns[held], held=True)
        problem = replace(problem, unknowns=tuple(unknowns))
    covariance = covariance_of(both)
    sigma = np.sqrt(np.diag(covariance))
    own, size = unit_columns(by)
    own_values, _ = singular(own)
    with np.errstate(divide="ignore"):
        alone = 1.0 / size
    correlation = correlation_of(covariance)
    return problem, Identifiability(
        tuple(names),
        tuple(u.unit for u in problem.unknowns),
        bound_of(by),
        alone,
        sigma,
        correlation,
        own_values,
        condition_of(own_values),
        condition_of(values),
        statuses_of(problem, state.x, sigma),
        (*notes, *alike(names, correlation)),
    )


def _refusal(group: Sequence[str], condition: float) -> str:
    what = " and ".join(group)
    cant = f"can't tell {what} apart" if len(group) > 1 else f"say nothing of {what}"
    size = f"{condition:.1g}" if np.isfinite(condition) else "infinite"
    return (
        f"estimate_air: the images {cant} (condition {size}); leave out {group[-1]}, give it a"
        " prior (priors={name: Prior(value, sigma)}), or measure from a second pose"
    )


def statuses_of(problem: Problem, x: Array, sigma: Array) -> NDArray[np.int64]:
    """`EstimateStatus` (P,) of values with these standard deviations."""
    found = []
    for unknown, value, spread in zip(problem.unknowns, x, sigma, strict=True):
        status, prior = EstimateStatus.FOUND, unknown.applied
        if unknown.is_at_bound(value):
            status = EstimateStatus.AT_BOUND
        elif prior and spread > _ADDS_NOTHING * prior.sigma:
            status = EstimateStatus.PRIOR
        if unknown.held and spread > _TELLS_LITTLE * prior.sigma:  # type: ignore[union-attr]
            status = EstimateStatus.NOT_TOLD_APART
        found.append(int(status))
    return np.array(found, np.int64)


def alike(names: Sequence[str], correlation: Array) -> list[str]:
    """Pairs that are hard to tell apart, in words."""
    pairs = [
        f"{one} and {names[j]} ({correlation[i, j]:+.3f})"
        for i, one in enumerate(names)
        for j in range(i + 1, len(names))
        if abs(correlation[i, j]) > _ALIKE
    ]
    return [f"hard to tell apart (correlation): {few(pairs, 8)}"] if pairs else []
