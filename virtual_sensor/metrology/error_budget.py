"""How far corrected points, and what is fitted to them, may be wrong, and by what.

To first order a point errs by

    dP = A e + G dx + model,

with e its pixel's noise, A its derivative by the pixel, dx the errors of the parameters (of air,
shape and poses), which an estimate has in part from the same noise, and G the derivatives by them.
The sources are

- detection: A S A^T, with S the covariance of the pixel's noise;
- air, pose: G C G^T over the parameters of the air, and over those of poses and the laser's plane,
  with C their covariance. Parameters that were not fitted, but are not known exactly either, move
  the points and, through the residuals, the estimate;
- correlation: what is left of the covariance of A e + G dx, which may be negative: an estimate
  follows the noise;
- model: the true air is of another kind than the model's. No covariance knows of that, and a small
  residual does not exclude it. It is judged in two ways:

  *By structure.* Residuals that are larger than the noise, or like their neighbours, are no noise.
  The long-run variance, variance times the length of correlation, replaces that of the noise in the
  parameters' covariance; the excess itself is an error of each point.

  *By other families.* The fit is repeated with further parameters of the air, each with its usual
  prior. The points move by d and lose certainty. If the wider family is right, the narrower one is
  wrong by d d^T + C_wide - C on the average. The families are added as independent sources. One
  of them is the estimate's own with the usual priors of its parameters, and data trusted as far
  as they contradict those: where the data leave almost a choice, another one.

An interval of 95 % is 1.96 standard deviations of all sources together, about the value found.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field, fields, replace
from functools import cached_property
from typing import Any, ClassVar

import numpy as np
from numpy.typing import NDArray

from virtual_sensor.arrays import LARGEST, number_within, vector_of
from virtual_sensor.calls import public
from virtual_sensor.display import Displayed, listed, with_spreads
from virtual_sensor.errors import InputError, few, nearest, short
from virtual_sensor.metrology.air_estimate import AirEstimate, estimate_near
from virtual_sensor.metrology.air_problem import air_model_of, residuals
from virtual_sensor.metrology.covariance import WITHIN_95, carried, variance_along
from virtual_sensor.metrology.deviation import UM_PER_MM
from virtual_sensor.metrology.observations import Observation, Prior
from virtual_sensor.metrology.shapes import Shape

Array = NDArray[np.float64]

KINDS = ("air", "shape", "pose")
SOURCES = ("detection", "air", "pose", "correlation", "model")

_WIDER = (("blur",), ("height",), ("offset",), ("lean",), ("temperature",))
_MOST_PIXELS = 250  # of an observation that take part in the fits of other families
_MOST_NODES = 21  # along x, to be quick: a plume hardly changes along the part
_TOLERANCE, _MOST_STEPS = 0.01, 40  # of the noise: so far those fits go, and no further
_FAR = 5.0  # usual standard deviations
_SIGNIFICANT = 2.0  # standard deviations from which on variance and correlation aren't noise's


@dataclass(frozen=True, eq=False)
class PointBudget(Displayed):
    """What N points may be wrong by, by source; NaN where there is no point.

    Attributes
    ----------
    point_mm : ndarray of shape (N, 3)
        World.
    normal : ndarray of shape (N, 3)
        Unit vectors along which errors are told: the shape's, or the scene's part's normals.
    covariance_mm2 : dict from str to ndarray of shape (N, 3, 3)
        By source, of `SOURCES`; of an estimate "correlation" too. Their sum is that of the point.
    parameter_um : dict from str to ndarray of shape (N,)
        By how much one standard deviation of each parameter, alone, moves the points along the
        normal. They are correlated, and don't add up.
    """

    _by_row: ClassVar = True

    point_mm: Array
    normal: Array
    covariance_mm2: dict[str, Array]
    parameter_um: dict[str, Array]
    _shared_mm: dict[str, dict[str, Array]] = field(default_factory=dict, repr=False)

    def _line(self) -> str:
        each = (f"{source} {_median(um):.2g}" for source, um in self.sigma_um.items())
        return listed(f"{_median(self.total_um):.2g} µm along the normal", *each)

    def _columns(self) -> dict[str, Array]:
        columns = dict(zip(("x_mm", "y_mm", "z_mm"), self.point_mm.T, strict=True))
        columns |= {f"sigma_{source}_um": um for source, um in self.sigma_um.items()}
        return columns | {"sigma_um": self.total_um, "interval_95_um": self.interval_um}

    @cached_property
    def total_mm2(self) -> Array:
        """Covariance (N, 3, 3) of all sources together."""
        total: Array = np.sum(list(self.covariance_mm2.values()), axis=0)
        return total

    @cached_property
    def sigma_um(self) -> dict[str, Array]:
        """Standard deviation (N,) along the normal, by source; negative of a negative variance."""
        found = {}
        for source, covariance in self.covariance_mm2.items():
            variance = variance_along(self.normal, covariance)
            found[source] = UM_PER_MM * np.sign(variance) * np.sqrt(np.abs(variance))
        return found

    @cached_property
    def total_um(self) -> Array:
        """Standard deviation (N,) along the normal, of all sources together."""
        variance = np.maximum(variance_along(self.normal, self.total_mm2), 0.0)
        total: Array = UM_PER_MM * np.sqrt(variance)
        return total

    @property
    def interval_um(self) -> Array:
        """Half the interval (N,) that holds the true surface with a probability of 95 %."""
        return WITHIN_95 * self.total_um


@dataclass(frozen=True, eq=False)
class Structure(Displayed):
    """What the residuals of one observation say of the model.

    Attributes
    ----------
    excess : float
        Variance of the residuals beyond that of the noise, in units of it; 0 where it may be
        chance.
    correlated : float
        Points in a row that err alike: 1 of noise.
    long_run : float
        Variance times correlation, in units of the noise's: 1 of noise.
    """

    excess: float
    correlated: float
    long_run: float


@dataclass(frozen=True, eq=False)
class OtherFamily(Displayed):
    """The same measurement in a wider family of air.

    Attributes
    ----------
    added : tuple of str
        Parameters of the air that the estimate leaves at their defaults; () where its own have
        their usual priors.
    estimate : AirEstimate or None
        None where there is none.
    note : str
        Why not.
    """

    added: tuple[str, ...]
    estimate: AirEstimate | None
    note: str = ""

    def _line(self) -> str:
        found = f"{self.estimate.rms_px:.3g} px rms left" if self.estimate else self.note
        return listed(f"with {' and '.join(self.added) or 'usual priors'}", found)


@dataclass(frozen=True, eq=False)
class ErrorBudget(Displayed):
    """How far an estimate and its points may be wrong, by source.

    Attributes
    ----------
    names, units : tuple of str
        Of the estimate's P parameters.
    values : ndarray of shape (P,)
    sigma : dict from str to ndarray of shape (P,)
        Standard deviations by source: "noise" (and priors), "pose" (that was not fitted), "model".
    points : tuple of PointBudget
        Of each observation.
    structure : tuple of Structure
        Of each observation's residuals.
    families : tuple of OtherFamily
    notes : tuple of str
        Why the intervals may be too small.
    """

    names: tuple[str, ...]
    units: tuple[str, ...]
    values: Array
    sigma: dict[str, Array]
    points: tuple[PointBudget, ...]
    structure: tuple[Structure, ...]
    families: tuple[OtherFamily, ...]
    notes: tuple[str, ...] = ()
    _behind: _Behind | None = field(default=None, repr=False)

    def of_shape(self, shape: Shape, free: Sequence[str] | None = None) -> ErrorBudget:
        """Tell what a shape may be wrong by that is fitted to all points afterwards.

        The air's error is one and the same in all points, and ends in the shape as a whole.

        Parameters
        ----------
        shape : Shape
            As `CylinderShape`, near the points.
        free : sequence of str, optional
            Parameters that are fitted; all by default.

        Returns
        -------
        ErrorBudget
            Of the shape's parameters alone; without points.
        """
        fit = _ShapeFit.of([each.point_mm for each in self.points], shape, free)
        return replace(
            fit.budget(self._behind.of_fit(fit.weights) if self._behind else {}),
            structure=self.structure,
            families=self.families,
            notes=self.notes,
        )

    def _line(self) -> str:
        half = WITHIN_95 * self.total
        return listed("95 %", *with_spreads(self.names, self.units, half, self.values))

    def _columns(self) -> dict[str, Any]:
        low, high = self.interval.T
        found: dict[str, Any] = {"parameter": self.names, "unit": self.units, "value": self.values}
        found |= {f"sigma_{source}": sigma for source, sigma in self.sigma.items()}
        return found | {"sigma": self.total, "low_95": low, "high_95": high}

    @property
    def total(self) -> Array:
        """Standard deviations (P,) of all sources together."""
        total: Array = np.sqrt(np.sum([sigma**2 for sigma in self.sigma.values()], axis=0))
        return total

    @property
    def interval(self) -> Array:
        """Intervals (P, 2) of 95 %."""
        return self.values[:, None] + WITHIN_95 * self.total[:, None] * [-1.0, 1.0]


@public
def error_budget(
    estimate: AirEstimate,
    *,
    sigmas: Mapping[str, float] | None = None,
    families: Sequence[Sequence[str]] | None = None,
    pivot_mm: Any = (0.0, 0.0, 0.0),
    progress: Any = None,
) -> ErrorBudget:
    """Tell what an estimate, and the points through its air, may be wrong by.

    Parameters
    ----------
    estimate : AirEstimate
    sigmas : mapping from str to float, optional
        Standard deviations of pose parameters that were not fitted, in mm and degrees
        (`pose_parameters`): independent ones of each observation, as ``sensor_x``.
    families : sequence of sequences of str, optional
        Parameters of the air to fit as well, in turn. By default blur, height, offset,
        lean and temperature, those that the model has and the estimate has not, and its own with
        their usual priors; () for none at all.
    pivot_mm : array_like of shape (3,)
        World point that turns are about, as in `estimate_air`.
    progress : callable, optional
        Is given the fraction that is done.

    Raises
    ------
    InputError
        If there is no such parameter, or no family to compare with has it.
    """
    from virtual_sensor.optics.sight import check_progress

    if not isinstance(estimate, AirEstimate):
        raise InputError(
            f"error_budget: estimate is {short(estimate)}; give an AirEstimate of estimate_air"
        )
    if estimate.model is not None and estimate.medium is None:
        raise InputError(
            "error_budget: in this estimate observations have airs of their own (each=); estimate"
            " them one by one, with the shape of all as a prior, and give one of these"
        )
    check_progress("error_budget", progress)
    known = _sigmas("error_budget", sigmas, estimate.observations[0].scene, ())
    pivot = vector_of("error_budget: pivot_mm", pivot_mm)
    others = _families(estimate, families, progress or (lambda fraction: None))
    structure = tuple(
        _structure(residual[used] / seen.sigma_px[used])
        for residual, used, seen in zip(
            estimate.residual_px, estimate.used, estimate.observations, strict=True
        )
    )
    gains = [estimate.by_pixel(i) for i in range(len(estimate.observations))]
    moved = _by_poses(estimate, gains, known, pivot)
    spread = _spread_by_misfit(estimate, gains, structure)
    narrow = others[0].estimate if others else None
    apart = [
        _parted(estimate, narrow, other)
        for other in others[1:]
        if narrow is not None and other.estimate is not None
    ]
    return ErrorBudget(
        estimate.names,
        estimate.units,
        estimate.values,
        {
            "noise": estimate.sigma,
            "pose": np.sqrt(np.sum([change**2 for change, _ in moved], axis=0))
            + np.zeros(len(estimate.names)),
            "model": np.sqrt(np.diag(spread) + _added([each.of_values for each in apart])),
        },
        tuple(
            _point_budget(estimate, i, moved, spread, structure[i], apart)
            for i in range(len(estimate.observations))
        ),
        structure,
        others[1:],
        (*_far_off(estimate), *_unfinished(others), *(each.note for each in others if each.note)),
        _Behind(estimate, gains, moved, spread, structure, apart),
    )


@public
def known_air_budget(
    observation: Observation,
    model: Any = None,
    sigmas: Mapping[str, float] | None = None,
    *,
    pivot_mm: Any = (0.0, 0.0, 0.0),
    **values: float,
) -> PointBudget:
    """Tell what points through air that is given may be wrong by.

    Parameters
    ----------
    observation : Observation
        Its scene's air is taken where there is no model.
    model : AirModel, optional
        Family of the air, which has the parameters `values`.
    sigmas : mapping from str to float
        Standard deviations of its parameters and of the pose's, such as
        ``{"scale": 0.02, "camera_x": 0.01}``; in mm, degrees, and the air's units.
    pivot_mm : array_like of shape (3,)
        World point that turns are about.
    **values : float
        Of the air's parameters.

    Raises
    ------
    InputError
        If there is no such parameter.
    """
    from virtual_sensor.optics.bent_points import bent_points

    if not isinstance(observation, Observation):
        raise InputError(
            f"known_air_budget: observation is {short(observation)}; give an Observation"
        )
    scene = observation.scene
    model = air_model_of("known_air_budget", scene.medium if model is None else model)
    if values and model is None:
        raise InputError(f"known_air_budget: there is no air with a '{min(values)}'; give a model")
    known = _sigmas("known_air_budget", sigmas, scene, model.names if model else ())
    of_air = [name for name in known if model is not None and name in model.names]
    points = bent_points(
        scene.with_medium(model.at(**values) if model else None),
        observation.pixel,
        [name for name in known if name not in of_air],
        variations=model.derivatives(of_air, **values) if of_air else None,
        coordinate=observation.coordinate,
        pivot_mm=vector_of("known_air_budget: pivot_mm", pivot_mm),
    )
    columns = {name: sigma * points.point_by[name] for name, sigma in known.items()}
    normal = _normals(observation, points.point_mm, None)
    noise, direct = observation.covariance_px2, points.point_by_pixel
    covariance = {
        "detection": carried(direct, noise),
        "air": _outer([columns[name] for name in of_air], points.point_mm),
        "pose": _outer(
            [column for name, column in columns.items() if name not in of_air], points.point_mm
        ),
    }
    told = {name: UM_PER_MM * np.sum(normal * column, axis=1) for name, column in columns.items()}
    shared = {
        "air": {name: columns[name] for name in of_air},
        "pose": {name: column for name, column in columns.items() if name not in of_air},
    }
    return PointBudget(points.point_mm, normal, covariance, told, shared)


def known_air_shape_budget(
    points: Sequence[PointBudget], shape: Shape, free: Sequence[str] | None = None
) -> ErrorBudget:
    """Tell what a shape may be wrong by that is fitted to points through air that is given.

    Errors of the air are the same in all observations, those of poses each one's own.

    Parameters
    ----------
    points : sequence of PointBudget
        Of `known_air_budget`, one for each observation.
    shape, free
        As those of `ErrorBudget.of_shape`.
    """
    fit = _ShapeFit.of([each.point_mm for each in points], shape, free)
    noise, pose = np.zeros((2, len(fit.names)))
    moved: dict[str, Array] = {}
    for each, weight in zip(points, fit.weights, strict=True):
        noise += _squares(weight, each.covariance_mm2["detection"])
        shared = {
            source: {
                name: np.einsum("kni,ni->k", weight, np.nan_to_num(c)) for name, c in of.items()
            }
            for source, of in each._shared_mm.items()
        }
        pose += _added([change**2 for change in shared.get("pose", {}).values()])
        for name, change in shared.get("air", {}).items():
            moved[name] = moved.get(name, 0.0) + change
    air = _added([change**2 for change in moved.values()])
    return fit.budget({"noise": noise, "air": air, "pose": pose})


# ------------------------------------------------------------------- shapes that points determine


@dataclass(frozen=True, eq=False)
class _ShapeFit:
    """A shape through points, and its derivatives (K, N, 3) by each observation's."""

    names: tuple[str, ...]
    shape: Shape
    weights: tuple[Array, ...]

    @staticmethod
    def of(points_mm: Sequence[Array], shape: Shape, free: Sequence[str] | None) -> _ShapeFit:
        points = np.concatenate(points_mm)
        names = shape.checked(shape.names if free is None else free)
        nearest_one = shape.fitted(points, names)
        off = nearest_one.distance(points)
        by = np.column_stack([off.by_parameter[name] for name in names])
        known = np.isfinite(by).all(axis=1) & np.isfinite(off.by_point).all(axis=1)
        weights = np.zeros((len(names), *points.shape))
        weights[:, known] = -np.linalg.pinv(by[known])[:, :, None] * off.by_point[known]
        ends = np.cumsum([len(each) for each in points_mm])[:-1]
        return _ShapeFit(names, nearest_one, tuple(np.split(weights, ends, axis=1)))

    def budget(self, variances: Mapping[str, Array]) -> ErrorBudget:
        """By the sources' variances (K,), in mm and degrees."""
        return ErrorBudget(
            self.names,
            tuple("mm" if name.endswith("_mm") else "°" for name in self.names),
            np.array([self.shape.values[name] for name in self.names]),
            {
                source: np.sqrt(np.maximum(each, 0.0)) + np.zeros(len(self.names))
                for source, each in variances.items()
            },
            (),
            (),
            (),
        )


@dataclass(frozen=True, eq=False)
class _Behind:
    """What an estimate's budget is made of: errors that its points share."""

    estimate: AirEstimate
    gains: Sequence[Array]
    moved: Sequence[tuple[Array, Mapping[int, Array]]]
    spread: Array
    structure: Sequence[Structure]
    apart: Sequence[_Parted]

    def of_fit(self, weights: Sequence[Array]) -> dict[str, Array]:
        """Variances (K,), by source, of what changes with the points by weights (K, N, 3)."""
        estimate = self.estimate
        by = [estimate.points_by(i) for i in range(len(weights))]
        through = np.sum([_weighted(w, b) for w, b in zip(weights, by, strict=True)], axis=0)
        prior, noise = estimate.covariance.copy(), np.zeros(len(through))
        excess = np.zeros(len(through))
        for i, weight in enumerate(weights):
            covariance, direct = estimate.observations[i].covariance_px2, estimate.points[i]
            gain = self.gains[i]
            prior -= np.sum(carried(gain, covariance), axis=0)
            alone = np.einsum("kni,nij->knj", weight, np.nan_to_num(direct.point_by_pixel))
            noise += _squares(alone + np.einsum("kp,npj->knj", through, gain), covariance)
            each = self.structure[i]
            excess += each.excess * each.correlated * _squares(alone, covariance)
        noise += _form(through, prior)
        moved = [
            through @ change
            + _added([_weighted(weights[i], c[:, :, None])[:, 0] for i, c in own.items()])
            for change, own in self.moved
        ]
        model = excess + _form(through, self.spread)
        model += _added([each.of_fit(weights) for each in self.apart])
        return {"noise": noise, "pose": _added([c**2 for c in moved]), "model": model}


def _weighted(weight: Array, by: Array) -> Array:
    """Sums (K, P) of derivatives (N, 3, P) of points by weights (K, N, 3)."""
    found: Array = np.einsum("kni,nip->kp", weight, np.nan_to_num(by))
    return found


def _squares(weight: Array, covariance: Array) -> Array:
    """Variance (K,) of a sum by weights (K, N, D) of independent errors of covariance (N, D, D)."""
    found: Array = np.einsum("kni,nij,knj->k", weight, np.nan_to_num(covariance), weight)
    return found


def _form(rows: Array, covariance: Array) -> Array:
    found: Array = np.einsum("kp,pq,kq->k", rows, covariance, rows)
    return found


# ------------------------------------------------------------------------------ what was fitted


def _point_budget(
    estimate: AirEstimate,
    i: int,
    moved: Sequence[tuple[Array, Mapping[int, Array]]],
    spread: Array,
    structure: Structure,
    apart: Sequence[_Parted],
) -> PointBudget:
    """The budget of an observation's points."""
    points, seen, by = estimate.points[i], estimate.observations[i], estimate.points_by(i)
    kinds = _kinds(estimate)
    normal = _normals(seen, points.point_mm, estimate.shape)
    noise, direct = seen.covariance_px2, points.point_by_pixel
    detection = carried(direct, noise)
    covariance = {"detection": detection}
    for source in ("air", "pose"):
        some = [k for k, kind in enumerate(kinds) if kind == source]
        part = by[:, :, some]
        covariance[source] = carried(part, estimate.covariance[np.ix_(some, some)])
    # After what the noise does in both ways, poses that were not fitted.
    known = covariance["detection"] + covariance["air"] + covariance["pose"]
    covariance["correlation"] = estimate.covariance_of_points(i) - known
    columns = [by @ change + direct_mm.get(i, 0.0) for change, direct_mm in moved]
    covariance["pose"] = covariance["pose"] + _outer(columns, points.point_mm)
    excess = structure.excess * variance_along(normal, detection)[:, None, None]
    excess = excess * normal[:, :, None] * normal[:, None, :]
    covariance["model"] = (
        carried(by, spread) + excess + _added([each.of_points[i] for each in apart])
    )
    told = {
        name: UM_PER_MM * estimate.sigma[k] * np.sum(normal * by[:, :, k], axis=1)
        for k, name in enumerate(estimate.names)
        if kinds[k] != "shape"
    }
    return PointBudget(points.point_mm, normal, covariance, told)


def _kinds(estimate: AirEstimate) -> list[str]:
    """What each parameter belongs to: "air", "shape" or "pose"."""
    air = estimate.model.names if estimate.model else ()
    shape = estimate.shape.names if estimate.shape else ()
    return [
        "air" if name in air else "shape" if name in shape else "pose" for name in estimate.names
    ]


def _normals(seen: Observation, points: Array, shape: Any) -> Array:
    """Unit vectors (N, 3) along which errors are told; towards the camera where nothing is near."""
    from virtual_sensor.metrology.shapes import PartShape

    if shape is None and hasattr(seen.scene, "towards_sensors"):
        shape = PartShape.of(seen.scene)
    towards = seen.scene.camera.pose.origin_mm - points
    towards /= np.linalg.norm(towards, axis=1, keepdims=True)
    if shape is None:
        return towards
    normal = shape.distance(points).by_point
    found: Array = np.where(np.isfinite(normal), normal, towards)
    return found


# ------------------------------------------------------------------------- poses, not fitted


def _by_poses(
    estimate: AirEstimate, gains: Sequence[Array], sigmas: dict[str, float], pivot_mm: Array
) -> list[tuple[Array, dict[int, Array]]]:
    """What one standard deviation of each pose parameter does, in one observation after the other.

    The change (P,) of the estimate, and of the observation's points (N, 3) beside it.
    """
    from virtual_sensor.optics.bent_points import bent_points

    fitted = [name for name in sigmas for each in estimate.names if each.endswith(f".{name}")]
    if fitted:
        raise InputError(
            f"error_budget: '{fitted[0]}' was fitted; say by its prior (estimate_air: priors) how"
            " well it is known"
        )
    found: list[tuple[Array, dict[int, Array]]] = []
    for i, seen in enumerate(estimate.observations if sigmas else ()):
        points = bent_points(
            seen.scene.with_medium(estimate.medium),
            seen.pixel,
            list(sigmas),
            coordinate=seen.coordinate,
            pivot_mm=pivot_mm,
            start_mm=estimate.points[i].point_mm,
            start_along_mm=estimate.points[i].along_mm,
        )
        point_by = np.stack([points.point_by[name] for name in sigmas], axis=2)
        along_by = np.stack([points.along_by[name] for name in sigmas], axis=1)
        linear = residuals(seen, points, estimate.shape, point_by, along_by)
        used = estimate.used[i]
        # A pose acts on the estimate as a shift of the pixels that makes the same residuals.
        shift = np.linalg.pinv(linear.by_pixel[used]) @ linear.by[used]
        changes = np.einsum("npj,njk->pk", gains[i][used], shift)
        for k, (name, sigma) in enumerate(sigmas.items()):
            change = sigma * changes[:, k]
            found.append((change, {i: sigma * points.point_by[name]}))
    return found


def _sigmas(asker: str, sigmas: Any, scene: Any, of_air: Sequence[str]) -> dict[str, float]:
    """Standard deviations by the names of parameters, checked."""
    from virtual_sensor.optics.carried_rays import pose_parameters
    from virtual_sensor.optics.surfaces import Cylinder

    if not (sigmas is None or isinstance(sigmas, Mapping)):
        raise InputError(f"{asker}: sigmas is {short(sigmas)}; give a dict by parameters' names")
    known = [*of_air, *pose_parameters()]
    known += ["beta"] if isinstance(scene.surface, Cylinder) else []
    found = {}
    for name, sigma in (sigmas or {}).items():
        if name not in known:
            raise InputError(
                f"{asker}: sigmas has '{name}', which is no parameter{nearest(f'{name}', known)};"
                f" there are {few(known, 12)}"
            )
        about = f"{asker}: sigmas: {name}"
        found[name] = number_within(about, sigma, 0.0, LARGEST, "a standard deviation")
    return found


# --------------------------------------------------------------------------- the model's error


def _structure(white: Array) -> Structure:
    """What residuals (N,) over their noise, in the order of the line, have beyond white noise."""
    count = len(white)
    if count < 4:
        return Structure(0.0, 1.0, 1.0)
    variance = float(np.mean(white**2))
    excess = variance - 1.0
    if excess < _SIGNIFICANT * np.sqrt(2.0 / count):
        excess = 0.0
    centred = white - white.mean()
    correlated = 1.0
    for lag in range(1, count // 2):
        alike = float(np.mean(centred[lag:] * centred[:-lag])) / max(centred.var(), 1e-30)
        if alike < _SIGNIFICANT / np.sqrt(count):
            break
        correlated += 2.0 * alike
    long_run = max(1.0, variance * correlated if excess or correlated > 1.0 else 1.0)
    return Structure(max(excess, 0.0), correlated, long_run)


def _far_off(estimate: AirEstimate) -> list[str]:
    """Notes on parameters of the air that are nothing like usual."""
    usual = estimate.model.parameters if estimate.model else {}
    found = []
    for name, value in zip(estimate.names, estimate.values.tolist(), strict=True):
        each = usual.get(name)
        if each is None or name in estimate.priors or not each.sigma:
            continue
        if abs(value - each.default) > _FAR * each.sigma:
            found.append(
                f"{name} {value:.4g} is far from its usual {each.default:.4g} ± {each.sigma:.2g}:"
                " the air is of another kind than the model, and intervals may be too small;"
                " measure from a second pose, or give a prior"
            )
    return found


def _unfinished(others: Sequence[OtherFamily]) -> list[str]:
    """Notes on fits of other families that ended before they converged."""
    return [
        f"{each._line()}: this fit did not converge; it counts as far as it came, and intervals may"
        " be too small; measure from a second pose, or give priors"
        for each in others
        if each.estimate is not None and not each.estimate.converged
    ]


def _conflict(estimate: AirEstimate) -> float:
    """By how much the data contradict what is known of the parameters, beyond chance: of chi2."""
    usual = estimate.model.parameters if estimate.model else {}
    known = {name: Prior(p.default, p.sigma) for name, p in usual.items() if p.sigma}
    known |= estimate.priors
    rows = [k for k, name in enumerate(estimate.names) if name in known]
    if not rows:
        return 0.0
    priors = [known[estimate.names[k]] for k in rows]
    off = estimate.values[rows] - [each.value for each in priors]
    # A prior that took part has drawn the value, whose covariance is no longer the data's.
    own = np.array([float(estimate.names[k] not in estimate.priors) for k in rows])
    spread = estimate.covariance[np.ix_(rows, rows)] * np.outer(own, own)
    spread = spread + np.diag([each.sigma**2 for each in priors])
    return max(float(off @ np.linalg.solve(spread, off)) - len(rows), 0.0)


def _spread_by_misfit(
    estimate: AirEstimate, gains: Sequence[Array], structure: Sequence[Structure]
) -> Array:
    """Covariance (P, P) that the parameters have beyond the noise's: by structure, by conflict."""
    spread, conflict = np.zeros_like(estimate.covariance), _conflict(estimate)
    for gain, seen, each in zip(gains, estimate.observations, structure, strict=True):
        of_noise = np.sum(carried(gain, seen.covariance_px2), axis=0)
        spread += (each.long_run - 1.0 + conflict) * of_noise
    return spread


def _families(
    estimate: AirEstimate, families: Sequence[Sequence[str]] | None, progress: Any
) -> tuple[OtherFamily, ...]:
    """The fit in the estimate's own family, in that with its usual priors, and in wider ones."""
    known = {*estimate.names, *estimate.known}
    has = estimate.model.names if estimate.model else ()
    if families is None:
        fits = "air" in _kinds(estimate)
        families = [each for each in _WIDER if fits and {*each} <= {*has} - known]
    lists = (list, tuple)
    for added in families if isinstance(families, lists) else [families]:
        if not (
            isinstance(added, lists)
            and added
            and all(isinstance(name, str) and name in has for name in added)
            and known.isdisjoint(added)
        ):
            raise InputError(
                f"error_budget: families has {short(added)}; give lists of parameters of the air"
                f" that were not fitted: {few([n for n in has if n not in known], 9) or 'none'}"
            )
    if not families:
        return ()
    model, count = _quicker(estimate.model), 2 + len(families)
    found = [_refitted(estimate, model, ())]
    for number, added in enumerate([(), *families], 1):
        progress(number / count)
        found.append(_refitted(estimate, model, tuple(added), usual=not added))
    return tuple(found)


def _quicker(model: Any) -> Any:
    """The model on fewer nodes along x."""

    def thinned(field: Any) -> Any:
        last = field.shape[0] - 1
        step = max(
            k
            for k in range(1, last + 1)
            if last % k == 0 and last // k >= min(last, _MOST_NODES - 1)
        )
        nodes = field.with_nodes(
            field.nodes[::step], spacing_mm=field.spacing * [step, 1.0, 1.0], source=field.source
        )
        return nodes.simplified(field.interpolation, field.dimensions)

    fields = model.fields
    if hasattr(fields, "fields"):
        thin = {temperature: thinned(field) for temperature, field in fields.fields.items()}
        return replace(model, fields=replace(fields, fields=thin), _made={})
    return replace(model, fields=thinned(fields), _made={})


def _thinned(seen: Observation) -> Observation:
    """Every so many of its pixels, as sure together as all."""
    step = _step(seen.pixel)
    rows = _every(seen, step)
    return replace(rows, sigma_px=rows.sigma_px / np.sqrt(step))


def _step(rows: Array) -> int:
    return -(-len(rows) // _MOST_PIXELS)


def _every(table: Any, step: int) -> Any:
    """The rows of a dataclass's arrays, every so many."""
    arrays = {f.name: getattr(table, f.name) for f in fields(table)}
    return replace(
        table,
        **{name: each[::step] for name, each in arrays.items() if isinstance(each, np.ndarray)},
    )


def _refitted(
    estimate: AirEstimate, model: Any, added: tuple[str, ...], usual: bool = False
) -> OtherFamily:
    """The fit of the same pixels with further parameters, or with the usual priors of its own.

    The latter's noise is larger by what the data contradict those.
    """
    trust = np.sqrt(1.0 + _conflict(estimate)) if usual else 1.0
    seen = [_thinned(each) for each in estimate.observations]
    seen = [replace(each, sigma_px=each.sigma_px * trust) for each in seen]
    kinds = _kinds(estimate)
    of = {k: [n for n, kind in zip(estimate.names, kinds, strict=True) if kind == k] for k in KINDS}
    values = dict(zip(estimate.names, estimate.values.tolist(), strict=True))
    more = {name: model.parameters[name] for name in (*added, *(of["air"] if usual else ()))}
    priors = {name: Prior(p.default, p.sigma) for name, p in more.items()} | estimate.priors
    start = {name: values[name] for name in (*of["air"], *of["pose"])}
    try:
        found = estimate_near(
            [_every(points, _step(points.point_mm)) for points in estimate.points],
            seen,
            model,
            [*of["air"], *added],
            shape=estimate.shape,
            free=of["shape"],
            pose_names=of["pose"],
            priors=priors,
            known=estimate.known,
            start={name: p.start for name, p in more.items()} | ({} if usual else start),
            tolerance_px=_TOLERANCE * _noise(estimate),
            max_steps=_MOST_STEPS,
        )
    except InputError as error:
        return OtherFamily(added, None, str(error))
    return OtherFamily(added, found)


@dataclass(frozen=True)
class _Parted:
    """Mean square (P,) of the estimate's error, and (N, 3, 3) of the points', in a wider family."""

    of_values: Array
    of_points: tuple[Array, ...]
    narrow: AirEstimate
    wider: AirEstimate

    def of_fit(self, weights: Sequence[Array]) -> Array:
        """Mean square (K,) of the error of what changes with all points by weights (K, N, 3)."""
        moved: Any = 0.0
        sums: list[Array] = [np.zeros(0), np.zeros(0)]
        for i, weight in enumerate(weights):
            count = weight.shape[1]
            change = self.wider.points[i].point_mm - self.narrow.points[i].point_mm
            moved = moved + _weighted(weight, _between(change[:, :, None], count))[:, 0]
            for k, each in enumerate((self.wider, self.narrow)):
                part = _weighted(weight, _between(each.points_by(i), count))
                sums[k] = sums[k] + part if i else part
        wide, slim = (
            _form(rows, each.covariance)
            for rows, each in zip(sums, (self.wider, self.narrow), strict=True)
        )
        found: Array = moved**2 + np.maximum(wide - slim, 0.0)
        return found


def _parted(estimate: AirEstimate, narrow: AirEstimate, other: OtherFamily) -> _Parted:
    """What another family says of a narrow one, both fitted to the same pixels."""
    wider: Any = other.estimate
    if not other.added:  # no wider one; what data are worth that contradict it is counted apart
        wider = replace(wider, covariance=0.0 * wider.covariance)
    at = [wider.names.index(name) for name in narrow.names]
    lost = np.diag(wider.covariance)[at] - np.diag(narrow.covariance)
    of_points = []
    for i, seen in enumerate(estimate.observations):
        moved = wider.points[i].point_mm - narrow.points[i].point_mm
        wide, slim = (carried(each.points_by(i), each.covariance) for each in (wider, narrow))
        error = moved[:, :, None] * moved[:, None, :] + _positive(wide - slim)
        of_points.append(_between(error, len(seen.pixel)))
    of_values = (wider.values[at] - narrow.values) ** 2 + np.maximum(lost, 0.0)
    return _Parted(of_values, tuple(of_points), narrow, wider)


def _between(few_rows: Array, count: int) -> Array:
    """Rows (N, ...) of all points from those of every so many, which change little between."""
    if len(few_rows) == count:
        return few_rows
    at = np.arange(len(few_rows)) * -(-count // _MOST_PIXELS)
    known = np.isfinite(few_rows).all(axis=(1, 2))
    flat, shape = few_rows[known].reshape(known.sum(), -1), few_rows.shape[1:]
    if not len(flat):
        return np.full((count, *shape), np.nan)
    columns = [np.interp(np.arange(count), at[known], column) for column in flat.T]
    return np.stack(columns, axis=-1).reshape(count, *shape)


def _added(mean_squares: Sequence[Array]) -> Array:
    """Mean squares of independent sources, together; what a source doesn't know is left out."""
    total: Array = np.sum([np.nan_to_num(each) for each in mean_squares], axis=0)
    return total


# --------------------------------------------------------------------------------- arithmetic


def _outer(columns: Sequence[Array], points: Array) -> Array:
    """Sum (N, 3, 3) of independent errors' (N, 3) squares; NaN where there is no point."""
    found = np.where(np.isfinite(points), 0.0, np.nan)[:, :, None] * np.ones(3)
    for column in columns:
        found = found + column[:, :, None] * column[:, None, :]
    return found


def _positive(covariance: Array) -> Array:
    """The nearest matrices (N, 3, 3) without negative variances."""
    known: Any = np.isfinite(covariance).all(axis=(1, 2))
    values, vectors = np.linalg.eigh(np.where(known[:, None, None], covariance, 0.0))
    found: Array = carried(vectors, np.maximum(values, 0.0)[:, :, None] * np.eye(3))
    return found


def _noise(estimate: AirEstimate) -> float:
    """The pixels' noise, px."""
    sigma = np.concatenate([each.sigma_px for each in estimate.observations])
    return float(np.nanmedian(sigma))


def _median(values: Array) -> float:
    known = values[np.isfinite(values)]
    return float(np.median(known)) if known.size else np.nan
