"""The air, and the part's shape, found from what images hold.

A pixel (u, v) and a source's coordinate s give, through assumed air, a point P and the ray's second
coordinate t.  What is known beside them makes a residual of each pixel:

- of a line, the distance of P from a shape, which may be known or to be found;
- of a dot, whose t is known, t minus it: the epipolar residual, which no shape can cause.

Over its derivative by the pixel, a residual is one in px.  Several observations (poses,
temperatures, frames of a burst) are further rows; the air, the shape and the laser's plane are
theirs together, a pose is each one's own.  Priors are rows too.  Gauss and Newton's method with
exact derivatives finds the least sum of squares, of residuals over their noise, and the same
derivatives say, before it starts, what can be found at all (Cramer and Rao's bound).
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field, replace
from typing import Any, ClassVar

import numpy as np
from numpy.typing import ArrayLike, NDArray
from scipy.optimize import lsq_linear

from virtual_sensor.arrays import LARGEST, number_within, whole_number
from virtual_sensor.calls import public
from virtual_sensor.display import Displayed, listed, with_spreads
from virtual_sensor.errors import InputError, few, nearest
from virtual_sensor.metrology.air_problem import Problem, State, mapping_of, problem_of
from virtual_sensor.metrology.covariance import carried, variance_along
from virtual_sensor.metrology.identifiability import (
    MAX_CONDITION,
    EstimateStatus,
    Identifiability,
    alike,
    begun,
    statuses_of,
)
from virtual_sensor.metrology.normal_equations import (
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

Array = NDArray[np.float64]
Mask = NDArray[np.bool_]
MAX_STEPS = 60
"""Of a fit."""
_MOST_ROUNDS = 5
_LEAST_DAMPED, _MOST_DAMPED = 1e-6, 1e2  # of unit columns
_ROUNDING = 1e-12  # bounds that are no interval are refused
_FLAT, _MOST_FLAT = 1e-3, 4  # steps that lower the sum of squares by less, until it is left
_STALLED = 100.0  # tolerances: steps no longer that make nothing better are at rounding's end
_AGAINST = 3.0  # standard deviations off its prior, from which on data contradict it
_EXCESS = 1.5  # of residuals over their noise, from which on the model is doubted


@dataclass(frozen=True, eq=False)
class AirEstimate(Displayed):
    """Parameters of the air, of a shape and of poses as found, and how sure they are.

    Attributes
    ----------
    names, units : tuple of str
        Of P parameters: the air's, the shape's, the laser plane's, and those of poses, which bear
        the observation's name ("2.sensor_x").
    values, sigma : ndarray of shape (P,)
        With the standard deviation that the pixels' noise and the priors leave; it knows nothing of
        air that is of another family than the model's.
    status : ndarray of shape (P,)
        `EstimateStatus`.
    covariance, correlation : ndarray of shape (P, P)
    bound : ndarray of shape (P,)
        Cramer and Rao's, of the data alone; infinite where they leave a choice.
    singular_values : ndarray of shape (P,)
        Of the data's derivatives, columns of unit length.
    condition : float
        Of data and priors together, columns of unit length.
    before : Identifiability
        What was known of all this before the fit.
    priors : dict from str to Prior
        That took part, among them those of parameters that are NOT_TOLD_APART.
    known : dict from str to float
        Parameters of the air that were given.
    model : AirModel or None
    medium : IndexField or None
        The air as found; None where each observation has an air of its own.
    media : tuple of IndexField or None
        The air of each observation.
    shape : Shape or None
        As found.
    observations : tuple of Observation
    points : tuple of BentPoints
        Of each observation, through this air and from these poses.
    used : tuple of ndarray of bool of shape (N,)
        Which pixels took part: those with a point that are no outliers.
    residual_px : tuple of ndarray of shape (N,)
        Of each observation: of dots the epipolar residual, of a line its distance from the shape,
        over its derivative in the direction of noise. NaN where there is no point.
    distance_mm : tuple of ndarray of shape (N,)
        Of the points from the shape; NaN where there is none.
    rms_px : float
        Root mean square of the residuals that took part.
    chi2 : float
        Sum of squared residuals over their noise, by the degrees of freedom: about 1 where nothing
        but the noise is left.
    iterations : int
    converged : bool
    notes : tuple of str
    """

    _statuses: ClassVar = {"status": EstimateStatus}

    names: tuple[str, ...]
    units: tuple[str, ...]
    values: Array
    sigma: Array
    status: NDArray[np.int64]
    covariance: Array
    correlation: Array
    bound: Array
    singular_values: Array
    condition: float
    before: Identifiability
    priors: dict[str, Prior]
    known: dict[str, float]
    model: Any
    medium: Any
    media: tuple[Any, ...]
    shape: Any
    observations: tuple[Observation, ...]
    points: tuple[Any, ...]
    used: tuple[Mask, ...]
    residual_px: tuple[Array, ...]
    distance_mm: tuple[Array, ...]
    rms_px: float
    chi2: float
    iterations: int
    converged: bool
    notes: tuple[str, ...] = ()
    _linear: tuple[Any, ...] = field(default=(), repr=False)

    def _columns(self) -> dict[str, Any]:
        found = {"parameter": self.names, "unit": self.units, "value": self.values}
        return found | {"sigma": self.sigma, "bound": self.bound, "status": self.status}

    def _line(self) -> str:
        each = with_spreads(self.names, self.units, self.sigma, self.values)
        return listed(f"residual {self.rms_px:.3g} px rms", *each)

    def __getitem__(self, name: str) -> float:
        """A parameter's value."""
        return float(self.values[self._at(name)])

    def sigma_of(self, name: str) -> float:
        """A parameter's standard deviation."""
        return float(self.sigma[self._at(name)])

    def _at(self, name: str) -> int:
        if name not in self.names:
            raise KeyError(f"{name}; there are {', '.join(self.names)}")
        return self.names.index(name)

    def points_by(self, i: int) -> Array:
        """Derivatives (N, 3, P) of an observation's points by the parameters."""
        by: Array = self._linear[i].point_by
        return by

    def by_pixel(self, i: int) -> Array:
        """Derivatives (N, P, 2) of the parameters as found by an observation's pixels (u, v)."""
        each = self._linear[i]
        moved = np.einsum("nkp,nkj->npj", each.by, each.by_pixel)
        found: Array = -np.einsum("pq,nqj->npj", self.covariance, moved)
        return np.where(self.used[i][:, None, None], found, 0.0)

    def covariance_of_points(self, i: int) -> Array:
        """Covariance (N, 3, 3) in mm^2 of an observation's points: of noise, priors and estimate.

        A pixel's noise moves its point directly, and through the parameters that were found with
        its help: both are added with their correlation.
        """
        noise, direct = self.observations[i].covariance_px2, self.points[i].point_by_pixel
        by = self.points_by(i)
        through = by @ self.by_pixel(i)
        both = direct @ noise @ np.swapaxes(through, 1, 2)
        each = carried(direct, noise) + carried(by, self.covariance)
        return each + both + np.swapaxes(both, 1, 2)


@public
def estimate_air(
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
    start: Mapping[str, float] | None = None,
    max_condition: float = MAX_CONDITION,
    tolerance_px: float = 1e-5,
    max_steps: int = MAX_STEPS,
    pivot_mm: ArrayLike = (0.0, 0.0, 0.0),
    progress: Any = None,
) -> AirEstimate:
    """Find parameters of the air, of a shape and of the sensor's poses in what images hold.

    Parameters
    ----------
    observations : Observation or sequence of Observation
        All in the same air and of the same part.
    model : AirModel or IndexField, optional
        The family of air; None: light runs straight.
    names : sequence of str
        Parameters of the air to be found; () where it is known.
    each : sequence of str
        Those of them that every observation has for itself, such as frames of a plume that sways;
        they bear its name ("2.lean").
    shape : Shape, optional
        That points of lines lie on. Needed unless all observations are dots, whose residual is
        then the epipolar one alone.
    free : sequence of str
        Parameters of the shape to be found; the others stay.
    pose_names : sequence of str
        Of poses, to be found: ``sensor_x`` ... ``camera_turn_z`` (see `pose_parameters`), in mm and
        degrees beside the scenes' poses, each observation's own; ``NAME.sensor_x`` is that of one
        observation. And the laser's plane, the same in all: ``laser_offset`` (mm, across),
        ``laser_tilt`` and ``laser_roll`` (degrees about the line's and the light's direction).
    priors : mapping from str to Prior, optional
        Of any parameter; ``sensor_x`` is that of all observations' own.
    known : mapping from str to float, optional
        Further parameters of the air, which have these values.
    start : mapping from str to float, optional
        Values from which parameters of the air and of poses start. By default the priors', or
        those of air and scenes as they are given; a shape starts where it is nearest to the points.
    max_condition : float
        Condition of the problem, columns of unit length, from which on parameters are not told
        apart.
    tolerance_px : float
        Change of the residuals, rms, below which the fit ends.
    max_steps : int
        After which it ends anyway.
    pivot_mm : array_like of shape (3,)
        World point that turns of poses are about.
    progress : callable, optional
        Is given the number of evaluations so far.

    Raises
    ------
    InputError
        If a name is unknown; too few pixels have a point; or the data leave a choice among
        parameters that have no prior, which it names.
    """
    number_within("estimate_air: tolerance_px", tolerance_px, 1e-12, 1e3, "a positive number of px")
    problem = problem_of(
        *(observations, model, names, each, shape, free, pose_names, priors, known, pivot_mm),
        progress,
    )
    problem = _started(problem, mapping_of("start", start))
    whole_number("estimate_air: max_steps", max_steps, 1, 10_000)
    problem, state, before = begun(problem, max_condition)
    count, converged = 0, True
    for _ in range(_MOST_ROUNDS):
        found, steps, converged = _least(problem, state, tolerance_px, max_steps - count)
        count += steps
        exact = replace(problem, step_mm=None)
        again = exact.weighed(replace(exact.at(found.x, found), used=found.used))
        moved = again.rows()[0] - replace(again, linear=found.linear).rows()[0]
        moved_px = again.rms_px(problem.observations, moved)
        settled = again.like(state) and moved_px <= tolerance_px
        problem, state = exact, again
        if settled or count >= max_steps:
            break
    return _result(problem, state, before, count, converged, max_condition)


def estimate_near(
    points: Sequence[Any],
    observations: Sequence[Observation],
    model: Any,
    names: Sequence[str],
    *,
    shape: Shape | None,
    free: Sequence[str],
    pose_names: Sequence[str],
    priors: Mapping[str, Prior],
    known: Mapping[str, float],
    start: Mapping[str, float],
    tolerance_px: float,
    max_steps: int,
) -> AirEstimate:
    """`estimate_air` for many fits beside one another: quick, by the marches of its way alone.

    Parameters
    ----------
    points : sequence of BentPoints
        Near those that are sought, of each observation.
    observations, model, names, shape, free, pose_names, priors, known, start, tolerance_px
    max_steps
        As those of `estimate_air`.

    Raises
    ------
    InputError
        As `estimate_air` does.
    """
    problem = problem_of(
        *(observations, model, names, (), shape, free, pose_names, priors, known, np.zeros(3)),
        None,
    )
    problem = replace(_started(problem, dict(start)), near=tuple(points))
    problem, state, before = begun(problem, MAX_CONDITION)
    state, steps, converged = _least(problem, state, tolerance_px, max_steps)
    return _result(problem, state, before, steps, converged, MAX_CONDITION)


def _started(problem: Problem, start: dict[str, Any]) -> Problem:
    """The problem, some of whose unknowns start from these values."""
    names = [unknown.name for unknown in problem.unknowns]
    for name, value in start.items():
        if name not in names:
            raise InputError(
                f"estimate_air: start has '{name}', which is not sought; sought are"
                f" {few(names, 20) or 'none'}{nearest(name, names)}"
            )
        number_within(f"estimate_air: start: {name}", value, -LARGEST, LARGEST, "a number")
    return replace(
        problem,
        unknowns=tuple(
            replace(u, start=float(np.clip(start.get(u.name, u.start), u.low, u.high)))
            for u in problem.unknowns
        ),
    )


def _least(
    problem: Problem, start: State, tolerance_px: float, max_steps: int
) -> tuple[State, int, bool]:
    """The state of least squares with the start's weights and pixels, and in how many steps.

    Gauss and Newton's method: each step is that of the linear problem, within the bounds and no
    longer than the air's usual spread allows; damped as Levenberg and Marquardt's while steps make
    nothing better.
    """
    lost = 10.0 + 2.0 * np.abs(start.rows()[0]).max(initial=0.0)  # dearer than any that is there

    def rows(state: State) -> tuple[Array, Array]:
        (white, by), (off, by_prior) = state.rows(), problem.priors(state.x)
        white = np.where(np.isfinite(white), white, lost)
        return np.concatenate([white, off]), np.concatenate([np.nan_to_num(by), by_prior])

    state, damping, flat, moves_px = start, 0.0, 0, 0.0
    gained: Any
    residual, by = rows(state)
    for steps in range(max_steps + 1 if problem.unknowns else 1):
        unit, size = unit_columns(by)
        size = np.where(size > 0.0, size, 1.0)
        low, high = problem.reach(state.x)
        ends = (low - state.x) * size - _ROUNDING, (high - state.x) * size + _ROUNDING
        damped = np.concatenate([unit, np.sqrt(damping) * np.eye(len(size))])
        step = lsq_linear(damped, np.concatenate([-residual, 0.0 * size]), ends).x / size
        moves_px = start.rms_px(problem.observations, by @ step)
        if moves_px <= tolerance_px or damping > _MOST_DAMPED or flat > _MOST_FLAT:
            break
        if steps == max_steps:  # the last, which is only looked at
            break
        if problem.progress:
            problem.progress(steps)
        try:
            tried = problem.at(np.clip(state.x + step, low, high), state)
            tried = replace(tried, factor=start.factor, used=start.used)
            found, found_by = rows(tried)
            gained = 1.0 - (found @ found) / (residual @ residual)
        except InputError:  # no such air
            gained = -np.inf
        if gained > 0.0:
            flat = flat + 1 if gained < _FLAT else 0
            damping = damping / 10.0 if damping > _LEAST_DAMPED else 0.0
            state, residual, by = tried, found, found_by
        else:
            damping = max(10.0 * damping, _LEAST_DAMPED)
    return state, steps, moves_px <= _STALLED * tolerance_px


def _result(
    problem: Problem,
    state: State,
    before: Identifiability,
    steps: int,
    converged: bool,
    max_condition: float,
) -> AirEstimate:
    white, by = state.rows()
    # At a bound, or where it tells less than its usual spread, that stands in: what derivatives say
    # of a blur near 0 is nothing.
    spread = bound_of(np.concatenate([by, problem.priors(state.x)[1]]))
    vague = [
        u.prior is None and (u.is_at_bound(value) or u.is_vague(sigma))
        for u, value, sigma in zip(problem.unknowns, state.x.tolist(), spread, strict=True)
    ]
    pairs = zip(problem.unknowns, vague, strict=True)
    unknowns = [replace(u, held=u.held or is_vague) for u, is_vague in pairs]
    problem = replace(problem, unknowns=tuple(unknowns))
    off_prior, by_prior = problem.priors(state.x)
    both = np.concatenate([by, by_prior])
    covariance = covariance_of(both)
    sigma = np.sqrt(np.diag(covariance))
    correlation = correlation_of(covariance)
    residual_px, distance_mm = [], []
    for seen, linear in zip(problem.observations, state.linear, strict=True):
        slope = linear.by_pixel[:, 0]
        noise = variance_along(slope, seen.covariance_px2)
        with np.errstate(divide="ignore", invalid="ignore"):
            residual_px.append(linear.residual[:, 0] * seen.sigma_px / np.sqrt(noise))
        none = np.full(len(seen.pixel), np.nan)
        distance_mm.append(linear.residual[:, -1] if problem.shape else none)
    used_px = np.concatenate([r[u] for r, u in zip(residual_px, state.used, strict=True)])
    freedom = max(len(white) + len(off_prior) - len(state.x), 1)
    chi2 = float((white @ white + off_prior @ off_prior) / freedom)
    names, x = tuple(u.name for u in problem.unknowns), state.x
    status = statuses_of(problem, x, sigma)
    values, vectors = singular(unit_columns(both)[0])
    condition = condition_of(values)
    blurred = []
    if condition > max_condition:
        group = taking_part(vectors[-1])
        status[group] = EstimateStatus.NOT_TOLD_APART
        blurred = [
            f"the images can't tell {' and '.join(names[k] for k in group)} apart where they were"
            f" found (condition {condition:.1g}): measure from a second pose"
        ]
    notes = [note for note in before.notes if not note.startswith("hard to tell")]
    notes += blurred
    notes += alike(names, correlation)
    notes += _of_pixels(problem.observations, state)
    for name, each in zip(names, status, strict=True):
        if each != EstimateStatus.FOUND and not any(note.startswith(f"{name} ") for note in notes):
            notes.append(f"{name}: {EstimateStatus(each).message}")
    for unknown, value in zip(problem.unknowns, x.tolist(), strict=True):
        prior = unknown.applied
        if prior and (off := abs(value - prior.value) / prior.sigma) > _AGAINST:
            notes.append(
                f"{unknown.name} {value:.4g} lies {off:.2g} standard deviations off its prior,"
                f" {prior.value:g} ± {prior.sigma:.2g}: the prior is wrong, or the air of another"
                " kind than the model, and all standard deviations are too small"
            )
    if 0 < len(white) + len(off_prior) <= len(x):
        notes.append(
            f"{len(x)} parameters of {len(white)} residuals: they fit whatever the truth is, and"
            " nothing tells whether the model is right"
        )
    if chi2 > _EXCESS:
        notes.append(
            f"the residuals are {np.sqrt(chi2):.2g} times their noise: air or shape are not of the"
            " model's kind, and the standard deviations by noise alone are too small"
        )
    if not converged:
        notes.append("the fit did not converge; give priors, or fewer parameters")
    return AirEstimate(
        names,
        tuple(u.unit for u in problem.unknowns),
        x,
        sigma,
        status,
        covariance,
        correlation,
        bound_of(by),
        singular(unit_columns(by)[0])[0],
        condition,
        before,
        {u.name: p for u in problem.unknowns if (p := u.applied) is not None},
        problem.known,
        problem.model,
        None if problem.own_air else state.media[0],
        state.media,
        state.shape,
        problem.observations,
        state.points,
        state.used,
        tuple(residual_px),
        tuple(distance_mm),
        float(np.sqrt(np.mean(used_px**2))) if used_px.size else np.nan,
        chi2,
        steps,
        converged,
        tuple(notes),
        tuple(w.whitened(f) for w, f in zip(state.linear, state.factor, strict=True)),
    )


def _of_pixels(observations: Sequence[Observation], state: State) -> list[str]:
    """Notes on pixels that did not take part."""
    notes = []
    for seen, points, used in zip(observations, state.points, state.used, strict=True):
        counts = CrossingStatus.counts(points.status)
        for status, count in counts.items():
            if status not in (CrossingStatus.OK, CrossingStatus.NO_PIXEL):
                notes.append(
                    f"observation '{seen.name}': {count} pixels without a point. {status.message}"
                )
        out = int(np.sum((points.status == CrossingStatus.OK) & ~used))
        if out:
            notes.append(
                f"observation '{seen.name}': {out} of {counts[CrossingStatus.OK]} points left out,"
                " which lie far off the others, or nowhere near the shape"
            )
    return notes
