"""What observations say of parameters at some values: residuals, and their exact derivatives."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace
from functools import cached_property
from typing import Any

import numpy as np
from numpy.lib.stride_tricks import sliding_window_view
from numpy.typing import ArrayLike, NDArray

from virtual_sensor.arrays import LARGEST, number_within, vector_of
from virtual_sensor.errors import InputError, few, nearest, short
from virtual_sensor.metrology.covariance import SIGMA_BY_MEDIAN, carried
from virtual_sensor.metrology.observations import Observation, Prior
from virtual_sensor.metrology.shapes import Shape
from virtual_sensor.metrology.unknowns import Unknown, of_air, of_poses, of_shape, with_priors
from virtual_sensor.poses import Pose

Array = NDArray[np.float64]
Mask = NDArray[np.bool_]
_OUTLIER = 6.0  # robust standard deviations
_FEW, _MOST_OUT = 20, 0.1  # of so few pixels no larger part can be told from what the model lacks
_NEIGHBOURS = 5  # of which the median is taken
_LONGEST = 5.0  # usual standard deviations of the air, in a step
_STEP_MM = 0.5  # of marches on the way: they err by 3e-4 um on the shipped fields
_SAME_WEIGHTS = 1e-3
_BLIND = 1e-3  # cosine between noise and a residual's gradient: below it a pixel tells nothing


def problem_of(
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
) -> Problem:
    """What is sought in what, checked."""
    seen = _named([observations] if isinstance(observations, Observation) else observations)
    names, each = _words("names", names), _words("each", each)
    free, pose_names = _words("free", free), _words("pose_names", pose_names)
    known = {
        name: number_within(f"estimate_air: known: {name}", value, -LARGEST, LARGEST, "a number")
        for name, value in mapping_of("known", known).items()
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
    unknowns = [u for name in names for u in of_air(model, name, seen if name in each else None)]
    unknowns += [*of_shape(shape, free), *of_poses(pose_names, seen)]
    return Problem(
        tuple(seen),
        model,
        known,
        shape,
        with_priors(unknowns, mapping_of("priors", priors)),
        vector_of("estimate_air: pivot_mm", pivot_mm),
        progress,
    )


@dataclass(frozen=True, eq=False)
class Problem:
    """What is sought, in which observations, of which air and shape.

    Attributes
    ----------
    observations : tuple of Observation
    model : AirModel or None
    known : dict from str to float
        Parameters of the air that are given.
    shape : Shape or None
    unknowns : tuple of Unknown
        P of them.
    pivot_mm : ndarray of shape (3,)
        World point that turns of poses are about.
    progress : callable or None
    step_mm : float or None
        Of marches; None: the searches' own.
    near : tuple of BentPoints
        Of each observation, from which marches start; () where nothing is known.
    """

    observations: tuple[Observation, ...]
    model: Any
    known: dict[str, float]
    shape: Shape | None
    unknowns: tuple[Unknown, ...]
    pivot_mm: Array
    progress: Any = None
    step_mm: float | None = _STEP_MM
    near: tuple[Any, ...] = ()

    @cached_property
    def motions(self) -> dict[str, Any]:
        """Pose parameters by name."""
        from virtual_sensor.optics.carried_rays import pose_parameters

        return pose_parameters(self.pivot_mm)

    def at(self, x: Array, before: State | None = None) -> State:
        """Everything at some values of the unknowns; `before` gives points that are near."""
        shape = self._shape(x)
        media: list[Any] = []
        found = []
        for i in range(len(self.observations)):
            if self.own_air or not media:
                medium, by_air = self._air(x, i)
            media.append(medium)
            found.append(self._observed(i, x, medium, by_air, shape, before))
        return State(x, tuple(media), shape, *(tuple(each) for each in zip(*found, strict=True)))

    def reshaped(self, x: Array, before: State) -> State:
        """Everything at values that differ from those before by the shape alone."""
        shape = self._shape(x)
        linear = tuple(
            residuals(seen, points, shape, old.point_by, old.along_by, self._of_shape)
            for seen, points, old in zip(
                self.observations, before.points, before.linear, strict=True
            )
        )
        return replace(before, x=x, shape=shape, linear=linear)

    @property
    def _of_shape(self) -> dict[int, str]:
        """Which of the unknowns are the shape's own."""
        return {k: u.parameter for k, u in enumerate(self.unknowns) if u.kind == "shape"}

    def _shape(self, x: Array) -> Shape | None:
        return self.shape.with_values(**self._of("shape", x)) if self.shape else None

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
        before: State | None,
    ) -> tuple[Any, Linear]:
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
            **self._expected(i, x, before),
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
        return points, residuals(seen, points, shape, point_by, along_by, self._of_shape)

    def _expected(self, i: int, x: Array, before: State | None) -> dict[str, Any]:
        """Where `bent_points` is to start, if anything is known of it."""
        if before:
            return before.expected(i, x)
        near = self.near[i] if self.near else None
        return {"start_mm": near.point_mm, "start_along_mm": near.along_mm} if near else {}

    def _motion(self, seen: Observation, unknown: Unknown) -> Any:
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
        rows = [(k, p) for k, u in enumerate(self.unknowns) if (p := u.applied) is not None]
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

    def weighed(self, state: State) -> State:
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
                spread = np.maximum(1.0, SIGMA_BY_MEDIAN * np.median(np.abs(white[known]), axis=0))
                near = (np.abs(np.nan_to_num(white)) <= _OUTLIER * spread).all(axis=1)
                out, count = (known & ~near).sum(), known.sum()
                if count >= _FEW or out <= _MOST_OUT * count:
                    known = known & near
            used.append(known)
        return replace(state, factor=tuple(factors), used=tuple(used))


@dataclass(frozen=True, eq=False)
class State:
    """Where the fit stands: parameters, and what follows from them, of each observation."""

    x: Array
    media: tuple[Any, ...]
    shape: Shape | None
    points: tuple[Any, ...]
    linear: tuple[Linear, ...]
    factor: tuple[Array, ...] = ()
    used: tuple[Mask, ...] = ()

    def expected(self, i: int, x: Array) -> dict[str, Array]:
        """Where `bent_points` finds an observation's points at values near these, nearly."""
        points, by, step = self.points[i], self.linear[i], x - self.x
        return {
            "start_mm": points.point_mm + by.point_by @ step,
            "start_along_mm": points.along_mm + by.along_by @ step,
        }

    def like(self, other: State) -> bool:
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
class Linear:
    """K residuals of each of N pixels, and their derivatives; mm, then over their noise.

    Attributes
    ----------
    residual : ndarray of shape (N, K)
    by_pixel : ndarray of shape (N, K, 2)
    by : ndarray of shape (N, K, P)
    point_by : ndarray of shape (N, 3, P)
    along_by : ndarray of shape (N, P)
    """

    residual: Array
    by_pixel: Array
    by: Array
    point_by: Array
    along_by: Array

    def whitened(self, factor: Array) -> Linear:
        """Over their noise, by factors (N, K, K)."""
        return replace(
            self,
            residual=(factor @ self.residual[:, :, None])[:, :, 0],
            by_pixel=factor @ self.by_pixel,
            by=factor @ self.by,
        )


@dataclass(frozen=True, eq=False)
class _Assumed:
    """What a search needs of a scene: a sensor where it is thought to stand, in assumed air."""

    camera: Any
    source: Any
    medium: Any
    surface: Any


def residuals(
    seen: Observation,
    points: Any,
    shape: Shape | None,
    point_by: Array,
    along_by: Array,
    of_shape: Mapping[int, str] | None = None,
) -> Linear:
    """An observation's residuals: of dots along the light, and the distance from a shape.

    Parameters
    ----------
    seen : Observation
    points : BentPoints
        Of its pixels.
    shape : Shape or None
    point_by, along_by : ndarray of shape (N, 3, P), of shape (N, P)
        Derivatives of the points, and of their second coordinates, by P parameters.
    of_shape : mapping from int to str, optional
        Which of these are the shape's own.
    """
    rows: list[tuple[Array, Array, Array]] = []
    if seen.along_mm is not None:
        rows.append((points.along_mm - seen.along_mm, points.along_by_pixel, along_by))
    if shape is not None:
        off = shape.distance(points.point_mm)
        by = np.einsum("ni,nip->np", off.by_point, point_by)
        for k, name in (of_shape or {}).items():
            by[:, k] += off.by_parameter[name]
        by_pixel = np.einsum("ni,nij->nj", off.by_point, points.point_by_pixel)
        rows.append((off.distance_mm, by_pixel, by))
    residual, by_pixel, by_unknown = (np.stack(r, axis=1) for r in zip(*rows, strict=True))
    return Linear(residual, by_pixel, by_unknown, point_by, along_by)


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
    spread = carried(by_pixel, seen.covariance_px2)
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


def mapping_of(name: str, given: Any) -> dict[str, Any]:
    """The dict that is given, checked; empty where none is."""
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
