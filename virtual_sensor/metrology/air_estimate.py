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
from functools import cached_property
from typing import Any, ClassVar

import numpy as np
from numpy.lib.stride_tricks import sliding_window_view
from numpy.typing import ArrayLike, NDArray
from scipy.optimize import lsq_linear

from virtual_sensor.arrays import (
    LARGEST,
    SMALLEST,
    number_within,
    numbers_of,
    points_of,
    whole_number,
)
from virtual_sensor.calls import public
from virtual_sensor.display import Displayed, listed
from virtual_sensor.errors import InputError, few, nearest, short
from virtual_sensor.metrology.centres import LineCentres
from virtual_sensor.metrology.shapes import Shape
from virtual_sensor.optics.crossing_status import CrossingStatus
from virtual_sensor.poses import Pose
from virtual_sensor.statuses import StatusEnum

Array = NDArray[np.float64]
Mask = NDArray[np.bool_]

SIGMA_PX = 0.02
"""Noise of a line's centre where nobody says another one."""
MAX_STEPS = 60
"""Of a fit."""
MAX_CONDITION = 1e4
"""Condition of the problem, its columns of equal length, from which on it is taken as singular."""

_ALIKE = 0.95  # correlation from which on two parameters are named as hard to tell apart
_ADDS_NOTHING = 0.9  # of the prior's standard deviation: data that leave more have told nothing
_INVISIBLE = 1e-9  # changes of all residuals, in noise per unit of a parameter
_TELLS_LITTLE = 0.5  # likewise, of a usual value that stands in where the data leave a choice
_IN_GROUP = 0.3  # of the largest component of a singular vector: what takes part in it
_OUTLIER = 6.0  # robust standard deviations
_NEIGHBOURS = 5  # of which the median is taken
_MOST_ROUNDS = 5
_LONGEST = 5.0  # usual standard deviations of the air, in a step
_LEAST_DAMPED, _MOST_DAMPED = 1e-6, 1e2  # of unit columns
_ROUNDING = 1e-12  # bounds that are no interval are refused
_FLAT, _MOST_FLAT = 1e-3, 4  # steps that lower the sum of squares by less, until it is left
_STALLED = 100.0  # tolerances: steps no longer that make nothing better are at rounding's end
_STEP_MM = 0.5  # of marches on the way: they err by 3e-4 um on the shipped fields
_SAME_WEIGHTS = 1e-3
_BLIND = 1e-3  # cosine between noise and a residual's gradient: below it a pixel tells nothing
_EXCESS = 1.5  # of residuals over their noise, from which on the model is doubted
_PLANE_UNITS = {"laser_offset": "mm", "laser_tilt": "°", "laser_roll": "°"}


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


@public
@dataclass(frozen=True)
class Prior(Displayed):
    """What is known of a parameter before anything is measured.

    Attributes
    ----------
    value, sigma : float
        Mean and standard deviation, in the parameter's unit.
    """

    value: float
    sigma: float

    def __post_init__(self) -> None:
        number_within("Prior: value", self.value, -LARGEST, LARGEST, "a finite number")
        number_within("Prior: sigma", self.sigma, SMALLEST, LARGEST, "a positive number")

    def _line(self) -> str:
        return f"{self.value:.6g} ± {self.sigma:.2g}"


@public
@dataclass(frozen=True, eq=False)
class Observation(Displayed):
    """Pixels that one sensor measured at one moment, and what is known of their light.

    Attributes
    ----------
    scene : Scene
        With one camera and one source, where they are thought to stand. Its air plays no role.
    pixel : ndarray of shape (N, 2)
        (u, v), integer at pixel centres. `LineCentres` may be given: their noise and its direction
        are then the detector's. What is not finite is left out.
    sigma_px : ndarray of shape (N,)
        Standard deviation of the pixels' noise; one number for all may be given.
    coordinate : ndarray of shape (N,)
        First coordinate s of the source's rays; 0 is the middle of a laser's sheet.
    along_mm : ndarray of shape (N,) or None
        Their second coordinate t, where it is known: of dots.
    name : str
    normal_deg : ndarray of shape (N,) or None
        Direction in which the pixels were measured, degrees from +u towards +v: 90 of a line whose
        columns were searched, as usual. None: both u and v were, as of dots.
    """

    scene: Any
    pixel: Any
    sigma_px: Any = None
    coordinate: Any = 0.0
    along_mm: Any = None
    name: str = ""
    normal_deg: Any = "by kind"

    def __post_init__(self) -> None:
        line = self.pixel if isinstance(self.pixel, LineCentres) else None
        pixel = points_of("Observation: pixel", line.pixel if line else self.pixel, 2)
        pixel = pixel.reshape(-1, 2) if line else pixel
        if pixel.ndim != 2 or pixel.shape[1] != 2:
            raise InputError(
                f"Observation: pixel has shape {pixel.shape}; give (N, 2), (u, v) each"
            )
        sigma, normal = self.sigma_px, self.normal_deg
        if sigma is None:
            sigma = SIGMA_PX
            if line is not None:
                own = np.ravel(line.sigma)
                sigma = np.where(own > 0.0, own, SIGMA_PX)
        if isinstance(normal, str):
            normal = None if self.along_mm is not None else 90.0
            if line is not None and normal is not None:
                normal = np.ravel(line.normal_deg)
        given = {"sigma_px": sigma, "coordinate": self.coordinate}
        given |= {"along_mm": self.along_mm, "normal_deg": normal}
        for name, values in given.items():
            if values is not None:
                numbers = numbers_of(f"Observation: {name}", values)
                if numbers.shape not in ((), pixel.shape[:1]):
                    raise InputError(
                        f"Observation: {name} has shape {numbers.shape} for {len(pixel)} pixels;"
                        " give one number, or one for each"
                    )
                object.__setattr__(self, name, np.broadcast_to(numbers, pixel.shape[:1]))
            else:
                object.__setattr__(self, name, None)
        if not np.all(np.nan_to_num(self.sigma_px, nan=1.0) > 0.0):
            raise InputError("Observation: sigma_px must be positive: the pixels' noise in px")
        object.__setattr__(self, "pixel", pixel)

    def _line(self) -> str:
        kind = "pixels of a line" if self.along_mm is None else "dots"
        count = int(np.isfinite(self.pixel).all(axis=1).sum())
        sigma = f"noise {np.nanmedian(self.sigma_px):.3g} px" if count else ""
        return listed(self.name, f"{count} {kind}", sigma)

    @property
    def covariance_px2(self) -> Array:
        """Of the pixels' noise, (N, 2, 2)."""
        square = self.sigma_px[:, None, None] ** 2
        if self.normal_deg is None:
            return square * np.eye(2)
        angle = np.radians(self.normal_deg)
        normal = np.stack([np.cos(angle), np.sin(angle)], axis=1)
        return square * normal[:, :, None] * normal[:, None, :]


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

    def _line(self) -> str:
        each = (
            f"{name} ± {sigma:.2g}{f' {unit}' * bool(unit)}"
            for name, unit, sigma in zip(
                self.names, self.units, self.bound_with_priors, strict=True
            )
        )
        return listed(*each, f"condition {self.condition:.3g}")


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

    def _line(self) -> str:
        each = (
            f"{name} {value:.6g} ± {sigma:.2g}{f' {unit}' * bool(unit)}"
            for name, unit, value, sigma in zip(
                self.names, self.units, self.values, self.sigma, strict=True
            )
        )
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
        spread: Array = direct @ noise @ np.swapaxes(direct, 1, 2)
        return (
            spread + both + np.swapaxes(both, 1, 2) + by @ self.covariance @ np.swapaxes(by, 1, 2)
        )


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
    problem = _problem(
        *(observations, model, names, each, shape, free, pose_names, priors, known, pivot_mm),
        progress,
    )
    problem = _started(problem, _mapping("start", start))
    whole_number("estimate_air: max_steps", max_steps, 1, 10_000)
    problem, state, before = _begun(problem, max_condition)
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
    problem = _problem(
        *(observations, model, names, each, shape, free, pose_names, priors, known, pivot_mm), None
    )
    return _begun(problem, max_condition)[2]


# ------------------------------------------------------------------------------ what is sought


@dataclass(frozen=True)
class _Unknown:
    """A parameter that is sought.

    Attributes
    ----------
    name, unit : str
        For the user.
    kind : str
        "air", "shape", "plane" or "pose".
    parameter : str
        Its name where it belongs.
    observation : int or None
        Whose pose it is; None: of all.
    start, low, high : float
    prior : Prior or None
    usual : Prior or None
        Which stands in where the data leave a choice.
    held : bool
        Whether it does.
    """

    name: str
    unit: str
    kind: str
    parameter: str
    observation: int | None = None
    start: float = 0.0
    low: float = -np.inf
    high: float = np.inf
    prior: Prior | None = None
    usual: Prior | None = None
    held: bool = False


@dataclass(frozen=True, eq=False)
class _Assumed:
    """What a search needs of a scene: a sensor where it is thought to stand, in assumed air."""

    camera: Any
    source: Any
    medium: Any
    surface: Any


@dataclass(frozen=True, eq=False)
class _Linear:
    """K residuals of each of N pixels, and their derivatives; mm, then over their noise.

    Attributes
    ----------
    residual : ndarray of shape (N, K)
    by_pixel : ndarray of shape (N, K, 2)
    by : ndarray of shape (N, K, P)
    point_by : ndarray of shape (N, 3, P)
    """

    residual: Array
    by_pixel: Array
    by: Array
    point_by: Array

    def whitened(self, factor: Array) -> _Linear:
        """Over their noise, by factors (N, K, K)."""
        return replace(
            self,
            residual=(factor @ self.residual[:, :, None])[:, :, 0],
            by_pixel=factor @ self.by_pixel,
            by=factor @ self.by,
        )


@dataclass(frozen=True, eq=False)
class _State:
    """Where the fit stands: parameters, and what follows from them, of each observation."""

    x: Array
    media: tuple[Any, ...]
    shape: Shape | None
    points: tuple[Any, ...]
    linear: tuple[_Linear, ...]
    factor: tuple[Array, ...] = ()
    used: tuple[Mask, ...] = ()

    def like(self, other: _State) -> bool:
        """Whether the same pixels take part, with the same weights."""
        pairs = zip(self.used, other.used, self.factor, other.factor, strict=True)
        return all(
            np.array_equal(one, two) and np.allclose(a[one], b[one], rtol=_SAME_WEIGHTS, atol=0.0)
            for one, two, a, b in pairs
        )

    def rms_px(self, observations: Sequence[Observation], white: Array) -> float:
        """Root mean square, in px, of changes of `rows`, those of priors behind them."""
        parts = zip(observations, self.used, self.factor, strict=True)
        sigma = [np.repeat(o.sigma_px[used], f.shape[1]) for o, used, f in parts]
        noise = np.concatenate(sigma)
        return float(np.sqrt(np.mean((white[: len(noise)] * noise) ** 2))) if noise.size else 0.0

    def rows(self) -> tuple[Array, Array]:
        """Residuals (M,) over their noise, and derivatives (M, P), of pixels that take part."""
        white = [each.whitened(f) for each, f in zip(self.linear, self.factor, strict=True)]
        residual = [w.residual[u].ravel() for w, u in zip(white, self.used, strict=True)]
        by = [
            np.concatenate(w.by[u]) if u.any() else w.by[:0, 0]
            for w, u in zip(white, self.used, strict=True)
        ]
        return np.concatenate(residual), np.concatenate(by)


@dataclass(frozen=True, eq=False)
class _Problem:
    observations: tuple[Observation, ...]
    model: Any
    known: dict[str, float]
    shape: Shape | None
    unknowns: tuple[_Unknown, ...]
    pivot_mm: Array
    progress: Any = None
    step_mm: float | None = _STEP_MM  # of marches; None: the searches' own

    @cached_property
    def motions(self) -> dict[str, Any]:
        """Pose parameters by name."""
        from virtual_sensor.optics.carried_rays import pose_parameters

        return pose_parameters(self.pivot_mm)

    def at(self, x: Array, before: _State | None = None) -> _State:
        """Everything at some values of the unknowns; `before` gives points that are near."""
        shape = self.shape.with_values(**self._of("shape", x)) if self.shape else None
        media: list[Any] = []
        found = []
        for i in range(len(self.observations)):
            if self.own_air or not media:
                medium, by_air = self._air(x, i)
            media.append(medium)
            found.append(self._observed(i, x, medium, by_air, shape, before))
        return _State(x, tuple(media), shape, *(tuple(each) for each in zip(*found, strict=True)))

    @property
    def own_air(self) -> bool:
        """Whether a parameter of the air is each observation's own."""
        return any(u.kind == "air" and u.observation is not None for u in self.unknowns)

    def _air(self, x: Array, i: int) -> tuple[Any, Mapping[str, Any]]:
        """The air of an observation, and its derivatives by what is sought of it."""
        values = self._of("air", x, i)
        air = self.known | values
        medium = self.model.at(**air) if self.model else None
        return medium, self.model.derivatives(list(values), **air) if values else {}

    def _of(self, kind: str, x: Array, i: int | None = None) -> dict[str, float]:
        """Values of all unknowns of a kind, or of all that are of an observation."""
        pairs = zip(self.unknowns, x.tolist(), strict=True)
        return {
            u.parameter: value
            for u, value in pairs
            if u.kind == kind and u.observation in (None, i)
        }

    def _observed(
        self,
        i: int,
        x: Array,
        medium: Any,
        by_air: Mapping[str, Any],
        shape: Shape | None,
        before: _State | None,
    ) -> tuple[Any, _Linear]:
        from virtual_sensor.optics.bent_points import bent_points
        from virtual_sensor.optics.sight import REFERENCE

        seen = self.observations[i]
        poses = [
            (k, self._motion(seen, u))
            for k, u in enumerate(self.unknowns)
            if u.kind in ("plane", "pose") and u.observation in (None, i)
        ]
        scene = self._assumed(seen, [(x[k], motion) for k, motion in poses], medium)
        bodies = dict.fromkeys(_body(motion) for _, motion in poses)
        axes = [
            f"{body}_{turn}{axis}" for body in bodies for turn in ("", "turn_") for axis in "xyz"
        ]
        points = bent_points(
            scene,
            seen.pixel,
            axes,
            variations=by_air,
            coordinate=seen.coordinate,
            pivot_mm=self.pivot_mm,
            march=replace(REFERENCE, step_mm=self.step_mm) if self.step_mm else REFERENCE,
            start_mm=before.points[i].point_mm if before else None,
        )
        count = len(points.point_mm)
        point_by = np.zeros((count, 3, len(self.unknowns)))
        along_by = np.zeros((count, len(self.unknowns)))
        for k, unknown in enumerate(self.unknowns):
            if unknown.kind == "air" and unknown.observation in (None, i):
                point_by[:, :, k] = points.point_by[unknown.parameter]
                along_by[:, k] = points.along_by[unknown.parameter]
        for k, motion in poses:
            for axis, share in _shares(motion):
                point_by[:, :, k] += share * points.point_by[axis]
                along_by[:, k] += share * points.along_by[axis]
        return points, self._residuals(seen, points, shape, point_by, along_by)

    def _residuals(
        self, seen: Observation, points: Any, shape: Shape | None, point_by: Array, along_by: Array
    ) -> _Linear:
        rows: list[tuple[Array, Array, Array]] = []
        if seen.along_mm is not None:
            rows.append((points.along_mm - seen.along_mm, points.along_by_pixel, along_by))
        if shape is not None:
            off = shape.distance(points.point_mm)
            by = np.einsum("ni,nip->np", off.by_point, point_by)
            for k, unknown in enumerate(self.unknowns):
                if unknown.kind == "shape":
                    by[:, k] += off.by_parameter[unknown.parameter]
            by_pixel = np.einsum("ni,nij->nj", off.by_point, points.point_by_pixel)
            rows.append((off.distance_mm, by_pixel, by))
        residual, by_pixel, by_unknown = (np.stack(r, axis=1) for r in zip(*rows, strict=True))
        return _Linear(residual, by_pixel, by_unknown, point_by)

    def _motion(self, seen: Observation, unknown: _Unknown) -> Any:
        """The motion of a pose parameter; of the laser's plane in the laser's own frame."""
        if unknown.kind == "pose":
            return self.motions[unknown.parameter]
        laser = seen.scene.source
        across, along, forward = laser.pose.rotation.T
        none, turn = np.zeros(3), {"laser_tilt": along, "laser_roll": forward}
        motion = self.motions["laser_x"]
        if unknown.parameter == "laser_offset":
            return replace(motion, shift_mm=across)
        turn_rad = np.radians(1.0) * turn[unknown.parameter]
        # About the target, which is a turn about the pivot and a shift.
        shift = np.cross(turn_rad, self.pivot_mm - laser.target_mm)
        return replace(motion, shift_mm=shift + none, turn_rad=turn_rad)

    def _assumed(
        self, seen: Observation, moved: Sequence[tuple[float, Any]], medium: Any
    ) -> _Assumed:
        devices = {"camera": seen.scene.camera, "laser": seen.scene.source}
        for part, device in devices.items():
            mine = [(value, m) for value, m in moved if part in m.parts]
            turn = np.sum([value * m.turn_rad for value, m in mine], axis=0) + np.zeros(3)
            shift = np.sum([value * m.shift_mm for value, m in mine], axis=0) + np.zeros(3)
            angle = float(np.linalg.norm(turn))
            pose = device.pose
            if angle:
                pose = pose.moved(Pose.turn(np.degrees(angle), turn, self.pivot_mm))
            if shift.any():
                pose = pose.moved(Pose.shift(shift))
            devices[part] = device.with_pose(pose) if pose is not device.pose else device
        return _Assumed(devices["camera"], devices["laser"], medium, seen.scene.surface)

    def priors(self, x: Array) -> tuple[Array, Array]:
        """Residuals of the priors over their standard deviations, and their derivatives."""
        rows = [(k, p) for k, u in enumerate(self.unknowns) if (p := _prior(u)) is not None]
        by = np.zeros((len(rows), len(x)))
        for row, (k, prior) in enumerate(rows):
            by[row, k] = 1.0 / prior.sigma
        return np.array([(x[k] - p.value) / p.sigma for k, p in rows]), by

    def reach(self, x: Array) -> tuple[Array, Array]:
        """Between which values (P,) a step from there may end: bounds, and trust in linearity."""
        ends = []
        for unknown, value in zip(self.unknowns, x.tolist(), strict=True):
            far = _LONGEST * unknown.usual.sigma if unknown.usual else np.inf
            low, high = value - far, value + far
            if unknown.low > 0.0:  # a factor
                low, high = max(low, value / 2.0), min(high, value * 2.0)
            ends.append((max(low, unknown.low), min(high, unknown.high)))
        low, high = np.array(ends).reshape(-1, 2).T
        return low, high

    def weighed(self, state: _State) -> _State:
        """The state with each residual's noise at its points, and with the pixels that take part.

        Outliers lie far beyond the spread of the others of the same observation; before a fit,
        when all residuals are large, far beyond their neighbours along the line.
        """
        factors, used = [], []
        for seen, points, linear in zip(self.observations, state.points, state.linear, strict=True):
            factor = _whitening(linear.by_pixel, seen, points)
            known: Any = np.isfinite(factor).all(axis=(1, 2))
            known = known & np.isfinite(linear.by).all(axis=(1, 2))
            factors.append(np.where(known[:, None, None], factor, 0.0))
            if known.any():
                white = linear.whitened(factor).residual
                if not state.used:
                    white = white - _of_neighbours(white, points.along_mm, known)
                spread = np.maximum(1.0, 1.4826 * np.median(np.abs(white[known]), axis=0))
                known = known & (np.abs(np.nan_to_num(white)) <= _OUTLIER * spread).all(axis=1)
            used.append(known)
        return replace(state, factor=tuple(factors), used=tuple(used))


def _prior(unknown: _Unknown) -> Prior | None:
    return unknown.prior or (unknown.usual if unknown.held else None)


def _body(motion: Any) -> str:
    return motion.parts[0] if len(motion.parts) == 1 else "sensor"


def _shares(motion: Any) -> list[tuple[str, float]]:
    """A motion as a sum of shifts in mm along, and turns in degrees about the world's axes."""
    shift = zip("xyz", motion.shift_mm, strict=True)
    turn = zip("xyz", np.degrees(motion.turn_rad), strict=True)
    named = [(axis, share) for axis, share in shift] + [(f"turn_{a}", share) for a, share in turn]
    return [(f"{_body(motion)}_{name}", float(share)) for name, share in named if share]


def _whitening(by_pixel: Array, seen: Observation, points: Any) -> Array:
    """Factors (N, K, K) that make residuals (N, K) independent, of unit noise; NaN: blind ones."""
    spread = by_pixel @ seen.covariance_px2 @ np.swapaxes(by_pixel, 1, 2)
    steep = np.sum(by_pixel**2, axis=2)
    felt = np.diagonal(spread, axis1=1, axis2=2) > steep * (seen.sigma_px[:, None] * _BLIND) ** 2
    good: Any = np.isfinite(spread).all(axis=(1, 2))
    good = good & felt.all(axis=1)
    # A shape that the light runs along, such as its own plane, is nearer and farther nowhere.
    good = good & (
        steep > (_BLIND**2 * np.sum(points.point_by_pixel**2, axis=(1, 2)))[:, None]
    ).all(axis=1)
    if spread.shape[1] == 2:
        good[good] = np.linalg.det(spread[good]) > 0.0
    factor = np.full_like(spread, np.nan)
    factor[good] = np.linalg.inv(np.linalg.cholesky(spread[good]))
    return factor


def _of_neighbours(white: Array, along: Array, known: Mask) -> Array:
    """The median (N, K) of residuals and of their neighbours along the line; NaN where unknown."""
    found, order = np.full_like(white, np.nan), np.argsort(along[known], kind="stable")
    if len(order) <= _NEIGHBOURS:
        return np.where(known[:, None], np.median(white[known], axis=0), np.nan)
    rows, half = np.flatnonzero(known)[order], _NEIGHBOURS // 2
    padded = np.pad(white[rows], ((half, half), (0, 0)), mode="reflect", reflect_type="odd")
    found[rows] = np.median(sliding_window_view(padded, _NEIGHBOURS, axis=0), axis=-1)
    return found


# ------------------------------------------------------------------------- set up, before a fit


def _problem(
    observations: Observation | Sequence[Observation],
    model: Any,
    names: Sequence[str],
    each: Sequence[str],
    shape: Shape | None,
    free: Sequence[str],
    pose_names: Sequence[str],
    priors: Mapping[str, Prior] | None,
    known: Mapping[str, float] | None,
    pivot_mm: ArrayLike,
    progress: Any,
) -> _Problem:
    """What is sought in what, checked."""
    seen = _named([observations] if isinstance(observations, Observation) else observations)
    names, each, free, pose_names = (
        _words(name, given)
        for name, given in (
            *(("names", names), ("each", each)),
            *(("free", free), ("pose_names", pose_names)),
        )
    )
    known = {
        name: number_within(f"estimate_air: known: {name}", value, -LARGEST, LARGEST, "a number")
        for name, value in _mapping("known", known).items()
    }
    if progress is not None and not callable(progress):
        raise InputError(f"estimate_air: progress is {short(progress)}; give a function")
    if not (shape is None or isinstance(shape, Shape)):
        raise InputError(
            f"estimate_air: shape is {short(shape)}; give a shape, such as CylinderShape(13.5)"
        )
    if shape is None and (free or any(each.along_mm is None for each in seen)):
        raise InputError(
            "estimate_air: lines say nothing without a shape; give the part's (shape=), a known one"
            " or one with free parameters, such as shape=CylinderShape(13.5), free=['radius_mm']"
        )
    model = air_model_of("estimate_air", model)
    if model is None and (names or known):
        raise InputError(
            "estimate_air: there is no air to estimate; give a model, or names=() and no known"
        )
    for name in names:
        if name in known:
            raise InputError(f"estimate_air: '{name}' is both known and to be found; leave out one")
    if strange := [name for name in each if name not in names]:
        raise InputError(
            f"estimate_air: each has '{strange[0]}', which is not sought; sought are"
            f" {few(names, 20) or 'none'}{nearest(strange[0], names)}"
        )
    unknowns = [u for name in names for u in _of_air(model, name, seen if name in each else None)]
    for name in shape.checked(free) if shape else ():
        start = float(getattr(shape, name))
        unknowns.append(_Unknown(name, _unit(name), "shape", name, start=start))
    unknowns += _of_poses(pose_names, seen)
    pivot = numbers_of("estimate_air: pivot_mm", pivot_mm)
    if pivot.shape != (3,) or not np.isfinite(pivot).all():
        raise InputError(f"estimate_air: pivot_mm is {short(pivot_mm)}; give three finite numbers")
    with_priors = _with_priors(unknowns, _mapping("priors", priors))
    return _Problem(tuple(seen), model, known, shape, with_priors, pivot, progress)


def air_model_of(asker: str, model: Any) -> Any:
    """The model of air that is given, or that of a field; None of none.

    Raises
    ------
    InputError
        If it is neither.
    """
    if model is None or hasattr(model, "derivatives"):
        return model
    from virtual_sensor.medium.air_model import AirModel

    try:
        return AirModel.of(model)
    except InputError:
        raise InputError(
            f"{asker}: model is {short(model)}; give an AirModel, or an IndexField"
        ) from None


def _words(name: str, given: Any) -> tuple[str, ...]:
    """Names, each once; one alone is one."""
    if isinstance(given, str):
        return (given,)
    if not isinstance(given, list | tuple | set) or not all(isinstance(g, str) for g in given):
        raise InputError(f"estimate_air: {name} is {short(given)}; give a list of names")
    return tuple(dict.fromkeys(given))


def _mapping(name: str, given: Any) -> dict[str, Any]:
    if given is not None and not isinstance(given, Mapping):
        raise InputError(f"estimate_air: {name} is {short(given)}; give a dict by names")
    return dict(given or {})


def _named(given: Any) -> list[Observation]:
    """The observations, each with a name of its own."""
    seen = list(given) if isinstance(given, list | tuple) else []
    if not seen or not all(isinstance(each, Observation) for each in seen):
        raise InputError(f"estimate_air: observations is {short(given)}; give Observations")
    named = [replace(each, name=each.name or f"{i}") for i, each in enumerate(seen, 1)]
    names = [each.name for each in named]
    if twice := [name for name in names if names.count(name) > 1]:
        raise InputError(f"estimate_air: two observations are named '{twice[0]}'; name them apart")
    return named


def _of_air(model: Any, name: str, seen: Sequence[Observation] | None) -> list[_Unknown]:
    """A parameter of the air: one for all, or one for each of the observations."""
    if name not in model.names:
        raise InputError(
            f"estimate_air: names: the air has no '{name}'; it has {', '.join(model.names)}"
            f"{nearest(name, model.names)}"
        )
    p = model.parameters[name]
    usual = Prior(p.default, p.sigma)
    one = _Unknown(name, p.unit, "air", name, None, p.start, p.low, p.high, None, usual)
    if seen is None:
        return [one]
    return [replace(one, name=f"{s.name}.{name}", observation=i) for i, s in enumerate(seen)]


def _unit(name: str) -> str:
    return next((unit for end, unit in (("_mm", "mm"), ("_deg", "°")) if name.endswith(end)), "")


def _of_poses(names: Sequence[str], seen: Sequence[Observation]) -> list[_Unknown]:
    if not names:
        return []
    from virtual_sensor.optics.carried_rays import pose_parameters

    known, found = [*pose_parameters(), *_PLANE_UNITS], []
    for name in names:
        owner, _, parameter = name.rpartition(".")
        owners = [i for i, each in enumerate(seen) if owner in ("", each.name)]
        if parameter not in known or not owners or (owner and parameter in _PLANE_UNITS):
            raise InputError(
                f"estimate_air: pose_names: no '{name}'; there are {few(known, 99)}, also of one"
                f" observation, by its name and a dot before: {few([s.name for s in seen], 9)}"
            )
        if parameter in _PLANE_UNITS:
            found.append(_Unknown(parameter, _PLANE_UNITS[parameter], "plane", parameter))
            continue
        unit = "°" if "turn" in parameter else "mm"
        found += [
            _Unknown(f"{seen[i].name}.{parameter}", unit, "pose", parameter, i) for i in owners
        ]
    return list({unknown.name: unknown for unknown in found}.values())


def _with_priors(unknowns: Sequence[_Unknown], priors: dict[str, Any]) -> tuple[_Unknown, ...]:
    """The unknowns with their priors, from whose means air starts."""
    unused, found = {f"{name}" for name in priors}, []
    for unknown in unknowns:
        prior = priors.get(unknown.name, priors.get(unknown.parameter))
        unused -= {unknown.name, unknown.parameter}
        if prior is not None and not isinstance(prior, Prior):
            raise InputError(
                f"estimate_air: the prior of {unknown.name} is {short(prior)}; give a Prior,"
                " of value and sigma"
            )
        start = prior.value if prior and unknown.kind == "air" else unknown.start
        start = float(np.clip(start, unknown.low, unknown.high))
        found.append(replace(unknown, prior=prior, start=start))
    if unused:
        name, names = min(unused), [unknown.name for unknown in unknowns]
        raise InputError(
            f"estimate_air: priors has one of '{name}', which is not sought; sought are"
            f" {few(names, 20) or 'none'}{nearest(name, names)}"
        )
    return tuple(found)


def _started(problem: _Problem, start: dict[str, Any]) -> _Problem:
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


def _begun(problem: _Problem, max_condition: float) -> tuple[_Problem, _State, Identifiability]:
    """The problem with parameters held that the data leave open, and where the fit starts."""
    number_within("estimate_air: max_condition", max_condition, 1.0, LARGEST, "a condition")
    state = problem.at(np.array([u.start for u in problem.unknowns]))
    _check_points(problem, state.points, [each.residual for each in state.linear])
    problem, state = _near_shape(problem, state)
    state = problem.weighed(state)
    _check_points(problem, state.points, [np.where(used, 0.0, np.nan) for used in state.used])
    problem, told = _told(problem, state, max_condition)
    return problem, state, told


def _check_points(problem: _Problem, points: Sequence[Any], residuals: Sequence[Array]) -> None:
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


def _near_shape(problem: _Problem, state: _State) -> tuple[_Problem, _State]:
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
        or not size.min() > _INVISIBLE
        or np.linalg.cond(by / size) > MAX_CONDITION
    ):
        return problem, state
    near = problem.shape.fitted(points, free).values
    unknowns = tuple(
        replace(u, start=near[u.parameter]) if u.kind == "shape" else u for u in problem.unknowns
    )
    problem = replace(problem, unknowns=unknowns)
    return problem, problem.at(np.array([u.start for u in unknowns]), state)


def _told(
    problem: _Problem, state: _State, max_condition: float
) -> tuple[_Problem, Identifiability]:
    """What the data tell, with those parameters of the air held that they don't."""
    names = [u.name for u in problem.unknowns]
    notes: list[str] = []
    _, by = state.rows()
    while True:
        both = np.concatenate([by, problem.priors(state.x)[1]])
        unit, _ = _unit_columns(both)
        values, vectors = _singular(unit)
        open_ = [
            k for k, u in enumerate(problem.unknowns) if _prior(u) is None and u.usual is not None
        ]
        if not names:
            break
        if values[0] > max_condition * values[-1]:
            group = _group(vectors[-1])
            those = [k for k in open_ if k in group]
            if not those:
                raise InputError(_refusal([names[k] for k in group], _condition(values)))
        else:
            sigma = np.sqrt(np.diag(_covariance(both)))
            those = [k for k in open_ if sigma[k] > problem.unknowns[k].usual.sigma]  # type: ignore[union-attr]
            if not those:
                break
            those = [max(those, key=lambda k: sigma[k] / problem.unknowns[k].usual.sigma)]  # type: ignore[union-attr]
            share = np.abs(_correlation(_covariance(both))[those[0]])
            group = np.flatnonzero(share > _ALIKE).tolist()
        held = max(those)
        usual = problem.unknowns[held].usual
        others = [names[k] for k in group if k != held]
        like = f"can't be told from {' and '.join(others)}" if others else "hardly shows"
        notes.append(
            f"{names[held]} {like} in these images: it is held at {usual}, its usual value; measure"
            f" from a second pose, or give a prior of your own"
        )
        unknowns = list(problem.unknowns)
        unknowns[held] = replace(unknowns[held], held=True)
        problem = replace(problem, unknowns=tuple(unknowns))
    covariance = _covariance(both)
    sigma = np.sqrt(np.diag(covariance))
    own, size = _unit_columns(by)
    own_values, _ = _singular(own)
    with np.errstate(divide="ignore"):
        alone = 1.0 / size
    correlation = _correlation(covariance)
    return problem, Identifiability(
        tuple(names),
        tuple(u.unit for u in problem.unknowns),
        _bound(by),
        alone,
        sigma,
        correlation,
        own_values,
        _condition(own_values),
        _condition(values),
        _statuses(problem, state.x, sigma),
        (*notes, *_alike(names, correlation)),
    )


def _refusal(group: Sequence[str], condition: float) -> str:
    what = " and ".join(group)
    cant = f"can't tell {what} apart" if len(group) > 1 else f"say nothing of {what}"
    size = f"{condition:.1g}" if np.isfinite(condition) else "infinite"
    return (
        f"estimate_air: the images {cant} (condition {size}); leave out {group[-1]}, give it a"
        " prior (priors={name: Prior(value, sigma)}), or measure from a second pose"
    )


# -------------------------------------------------------------------------------- linear algebra


def _unit_columns(by: Array) -> tuple[Array, Array]:
    """Derivatives (M, P) with columns of unit length; and their lengths, 0 of rounding's alone."""
    size = np.linalg.norm(by, axis=0)
    size = np.where(size > _INVISIBLE, size, 0.0)
    with np.errstate(divide="ignore", invalid="ignore"):
        return np.where(size > 0.0, by / size, 0.0), size


def _singular(unit: Array) -> tuple[Array, Array]:
    """Singular values (P,), falling, and the right vectors as rows."""
    count = unit.shape[1]
    spare = np.zeros((max(count - len(unit), 0), count))
    _, values, vectors = np.linalg.svd(np.concatenate([unit, spare]), full_matrices=False)
    return values, vectors


def _group(vector: Array) -> list[int]:
    """Which parameters make up a singular vector."""
    share = np.abs(vector)
    found: list[int] = np.flatnonzero(share > _IN_GROUP * share.max()).tolist()
    return found


def _condition(values: Array) -> float:
    if not values.size:
        return 1.0
    return float(values[0] / values[-1]) if values[-1] > 0.0 else np.inf


def _covariance(by: Array) -> Array:
    """Inverse of the normal matrix, (P, P)."""
    unit, size = _unit_columns(by)
    if not size.size:
        return np.zeros((0, 0))
    values, vectors = _singular(unit)
    with np.errstate(divide="ignore", invalid="ignore"):  # infinite where the data leave a choice
        root = vectors.T / values
        found: Array = (root @ root.T) / np.outer(size, size)
    return found


def _bound(by: Array) -> Array:
    """Cramer and Rao's bound (P,); infinite where the data leave a choice."""
    unit, size = _unit_columns(by)
    if not size.size:
        return size
    values, vectors = _singular(unit)
    open_ = values <= 1e-9 * values[0]
    square = np.sum((vectors[~open_] / values[~open_, None]) ** 2, axis=0)
    choice = (np.abs(vectors[open_]) > 1e-6).any(axis=0) | (size == 0.0)
    found: Array = np.where(choice, np.inf, np.sqrt(square) / np.where(size > 0.0, size, 1.0))
    return found


def _correlation(covariance: Array) -> Array:
    sigma = np.sqrt(np.diag(covariance))
    return covariance / np.outer(sigma, sigma)


def _alike(names: Sequence[str], correlation: Array) -> list[str]:
    """Pairs that are hard to tell apart, in words."""
    pairs = [
        f"{one} and {names[j]} ({correlation[i, j]:+.3f})"
        for i, one in enumerate(names)
        for j in range(i + 1, len(names))
        if abs(correlation[i, j]) > _ALIKE
    ]
    return [f"hard to tell apart (correlation): {few(pairs, 8)}"] if pairs else []


def _is_vague(unknown: _Unknown, sigma: float) -> bool:
    return unknown.usual is not None and not sigma < unknown.usual.sigma


def _at_bound(unknown: _Unknown, value: float) -> bool:
    return min(value - unknown.low, unknown.high - value) <= 1e-6 * max(abs(value), 1e-3)


def _statuses(problem: _Problem, x: Array, sigma: Array) -> NDArray[np.int64]:
    """`EstimateStatus` (P,) of values with these standard deviations."""
    found = []
    for unknown, value, spread in zip(problem.unknowns, x, sigma, strict=True):
        status, prior = EstimateStatus.FOUND, _prior(unknown)
        if _at_bound(unknown, value):
            status = EstimateStatus.AT_BOUND
        elif prior and spread > _ADDS_NOTHING * prior.sigma:
            status = EstimateStatus.PRIOR
        if unknown.held and spread > _TELLS_LITTLE * prior.sigma:  # type: ignore[union-attr]
            status = EstimateStatus.NOT_TOLD_APART
        found.append(int(status))
    return np.array(found, np.int64)


# --------------------------------------------------------------------------------- fit and result


def _least(
    problem: _Problem, start: _State, tolerance_px: float, max_steps: int
) -> tuple[_State, int, bool]:
    """The state of least squares with the start's weights and pixels, and in how many steps.

    Gauss and Newton's method: each step is that of the linear problem, within the bounds and no
    longer than the air's usual spread allows; damped as Levenberg and Marquardt's while steps make
    nothing better.
    """
    lost = 10.0 + 2.0 * np.abs(start.rows()[0]).max(initial=0.0)  # dearer than any that is there

    def rows(state: _State) -> tuple[Array, Array]:
        (white, by), (off, by_prior) = state.rows(), problem.priors(state.x)
        white = np.where(np.isfinite(white), white, lost)
        return np.concatenate([white, off]), np.concatenate([np.nan_to_num(by), by_prior])

    state, damping, flat, moves_px = start, 0.0, 0, 0.0
    gained: Any
    residual, by = rows(state)
    for steps in range(max_steps + 1 if problem.unknowns else 1):
        unit, size = _unit_columns(by)
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
    problem: _Problem,
    state: _State,
    before: Identifiability,
    steps: int,
    converged: bool,
    max_condition: float,
) -> AirEstimate:
    white, by = state.rows()
    # At a bound, or where it tells less than its usual spread, that stands in: what derivatives say
    # of a blur near 0 is nothing.
    spread = _bound(np.concatenate([by, problem.priors(state.x)[1]]))
    vague = [
        u.prior is None and (_at_bound(u, value) or _is_vague(u, sigma))
        for u, value, sigma in zip(problem.unknowns, state.x.tolist(), spread, strict=True)
    ]
    pairs = zip(problem.unknowns, vague, strict=True)
    unknowns = [replace(u, held=u.held or is_vague) for u, is_vague in pairs]
    problem = replace(problem, unknowns=tuple(unknowns))
    off_prior, by_prior = problem.priors(state.x)
    both = np.concatenate([by, by_prior])
    covariance = _covariance(both)
    sigma = np.sqrt(np.diag(covariance))
    correlation = _correlation(covariance)
    residual_px, distance_mm = [], []
    for seen, linear in zip(problem.observations, state.linear, strict=True):
        slope = linear.by_pixel[:, 0]
        noise = np.einsum("ni,nij,nj->n", slope, seen.covariance_px2, slope)
        with np.errstate(divide="ignore", invalid="ignore"):
            residual_px.append(linear.residual[:, 0] * seen.sigma_px / np.sqrt(noise))
        none = np.full(len(seen.pixel), np.nan)
        distance_mm.append(linear.residual[:, -1] if problem.shape else none)
    used_px = np.concatenate([r[u] for r, u in zip(residual_px, state.used, strict=True)])
    freedom = max(len(white) + len(off_prior) - len(state.x), 1)
    chi2 = float((white @ white + off_prior @ off_prior) / freedom)
    names, x = tuple(u.name for u in problem.unknowns), state.x
    status = _statuses(problem, x, sigma)
    values, vectors = _singular(_unit_columns(both)[0])
    condition = _condition(values)
    blurred = []
    if condition > max_condition:
        group = _group(vectors[-1])
        status[group] = EstimateStatus.NOT_TOLD_APART
        blurred = [
            f"the images can't tell {' and '.join(names[k] for k in group)} apart where they were"
            f" found (condition {condition:.1g}): measure from a second pose"
        ]
    notes = [note for note in before.notes if not note.startswith("hard to tell")]
    notes += blurred
    notes += _alike(names, correlation)
    notes += _of_pixels(problem.observations, state)
    for name, each in zip(names, status, strict=True):
        if each != EstimateStatus.FOUND and not any(note.startswith(f"{name} ") for note in notes):
            notes.append(f"{name}: {EstimateStatus(each).message}")
    if chi2 > _EXCESS:
        notes.append(
            f"the residuals are {np.sqrt(chi2):.2g} times their noise: air or shape are not of the"
            " model's kind, and the standard deviations, which know of noise alone, are too small"
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
        _bound(by),
        _singular(_unit_columns(by)[0])[0],
        condition,
        before,
        {u.name: p for u in problem.unknowns if (p := _prior(u)) is not None},
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


def _of_pixels(observations: Sequence[Observation], state: _State) -> list[str]:
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
