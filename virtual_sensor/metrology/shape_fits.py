"""Shapes through millions of points: which one is nearest, how sure it is, and what is left.

The sum of squared distances to the surface is least (orthogonal least squares).  Points take part
in shares, of which only the normal equations are kept: Gauss and Newton's method, with the exact
derivatives that every `Shape` has.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from typing import Any, ClassVar

import numpy as np
from numpy.typing import ArrayLike, NDArray

from virtual_sensor.arrays import points_of, shares
from virtual_sensor.calls import public
from virtual_sensor.display import Displayed, listed, with_spreads
from virtual_sensor.errors import InputError, nearest, short
from virtual_sensor.metrology.cylinder_fit import FitStatus, fit_cylinder, square_to
from virtual_sensor.metrology.deviation import UM_PER_MM
from virtual_sensor.metrology.shapes import CylinderShape, PlaneShape, Shape, SphereShape
from virtual_sensor.poses import Pose

Array = NDArray[np.float64]

KINDS: Mapping[str, Shape] = {
    "cylinder": CylinderShape(),
    "plane": PlaneShape(),
    "sphere": SphereShape(1.0),
}

_SAMPLE = 2000  # points that a start is found from
_MOST_STEPS = 50
_SETTLED, _EXACT_MM = 1e-10, 1e-10  # of what was left: a step that changes so little is the last
_UNDETERMINED = 1e-12  # of scaled normal equations: eigenvalue over the largest one


@public
@dataclass(frozen=True)
class FittedShape(Displayed):
    """The shape nearest to points; NaN in all numbers where there is none.

    Attributes
    ----------
    shape : Shape or None
        `CylinderShape`, `PlaneShape`, `SphereShape` or what was given, with the values found.
    sigma : dict from str to float
        Standard deviations of the values that were free, as if the residuals were independent:
        mm and degrees.
    residual_um : ndarray of shape (...)
        Distance of each point from the shape, positive outside; NaN where there is no point.
    residual_std_um : float
        Root of the sum of squared residuals by the degrees of freedom, count minus unknowns.
    count : int
        Of the points that took part, which are the finite ones.
    status : int
        `FitStatus`.
    """

    _statuses: ClassVar = {"status": FitStatus}

    shape: Shape | None
    sigma: Mapping[str, float]
    residual_um: Array
    residual_std_um: float
    count: int
    status: int

    def _line(self) -> str:
        if self.shape is None:
            return f"none, {FitStatus(self.status).name.lower()}: {self.count} points"
        kind = type(self.shape).__name__.removesuffix("Shape").lower()
        units = ("mm" if name.endswith("_mm") else "°" for name in self.sigma)
        values = (self.shape.values[name] for name in self.sigma)
        found = with_spreads(self.sigma, units, self.sigma.values(), values)
        spread = f"residuals of {self.residual_std_um:.3g} µm"
        return listed(kind, *found[:1], f"{self.count} points", spread)


@public
def fit_shape(
    points_mm: Any,
    shape: str | Shape = "cylinder",
    *,
    free: Sequence[str] | None = None,
    direction: ArrayLike | None = None,
) -> FittedShape:
    """Fit a cylinder, a plane, a sphere or any shape by orthogonal least squares.

    Parameters
    ----------
    points_mm : RangeImage, or array_like of shape (..., 3)
        World; those that are not finite are left out.
    shape : str or Shape
        "cylinder", "plane" or "sphere", found from nothing; or a shape near the points, such as
        ``PartShape.of(scene)``, to start from.
    free : sequence of str, optional
        Parameters that are to be found, the others stay; all by default.
    direction : array_like of shape (3,), optional
        Of a cylinder's axis, of any length: it is known, and not fitted.

    Returns
    -------
    FittedShape

    Raises
    ------
    InputError
        If these are no points, or there is no such shape or parameter.
    """
    given = getattr(points_mm, "point_mm", points_mm)
    points = points_of("fit_shape: points_mm", given)
    if points.shape[-1:] != (3,):
        raise InputError(f"fit_shape: points_mm has the shape {points.shape}; give it (..., 3)")
    if not isinstance(shape, Shape) and (not isinstance(shape, str) or shape not in KINDS):
        raise InputError(
            f"fit_shape: shape is {short(shape)}; give {', '.join(KINDS)}, or a Shape"
            f"{nearest(shape, KINDS)}"
        )
    if direction is not None and shape != "cylinder":
        raise InputError("fit_shape: direction is that of a cylinder's axis; leave it out")
    rows = points.reshape(-1, 3)
    known = np.isfinite(rows).all(axis=1)
    used = rows[known]
    listed_names = isinstance(free, list | tuple) and all(isinstance(n, str) for n in free)
    if free is not None and not listed_names:
        raise InputError(f"fit_shape: free is {short(free)}; give a list of parameters' names")
    if free is None and direction is not None:
        free = ("radius_mm", "y_mm", "z_mm")
    kind = KINDS[shape] if isinstance(shape, str) else shape
    names = kind.checked(kind.names if free is None else free)
    start = _started(used, shape, direction) if isinstance(shape, str) else shape
    if isinstance(start, FitStatus):
        return _none(points, len(used), start)
    found, covariance, status = _least(used, start, names)
    if status != FitStatus.FITTED:
        return _none(points, len(used), status)
    residual = np.full(len(rows), np.nan)
    residual[known] = np.concatenate(
        [found.distance(used[some]).distance_mm for some in shares(len(used))]
    )
    near = np.isfinite(residual)  # a known part may be nowhere near a point
    found = _at_rest(found) if isinstance(shape, str) else found
    freedom = int(near.sum()) - len(names)
    std_mm = float(np.sqrt(np.nansum(residual**2) / freedom))
    sigma = dict(zip(names, std_mm * np.sqrt(np.diag(covariance)), strict=True))
    return FittedShape(
        found,
        {name: float(value) for name, value in sigma.items()},
        UM_PER_MM * residual.reshape(points.shape[:-1]),
        UM_PER_MM * std_mm,
        int(near.sum()),
        int(FitStatus.FITTED),
    )


def _started(points: Array, kind: str, direction: ArrayLike | None) -> Shape | FitStatus:
    """A shape of a kind near points (N, 3), from a sample of them; or why there is none."""
    sample = points
    if len(points) > _SAMPLE:
        rows = np.random.default_rng(0).choice(len(points), _SAMPLE, replace=False)
        sample = points[np.sort(rows)]
    if kind == "cylinder":
        fit = fit_cylinder(sample, direction=direction)
        if fit.status != FitStatus.FITTED:
            return FitStatus(fit.status)
        return _cylinder(fit.radius_mm, fit.axis_point_mm, fit.axis_direction)
    if len(sample) < (4 if kind == "plane" else 5):
        return FitStatus.TOO_FEW
    middle = sample.mean(axis=0)
    around = sample - middle
    if kind == "plane":
        normal = np.linalg.svd(around, full_matrices=False)[2][2]
        return _plane(middle, normal * np.sign(normal[np.argmax(np.abs(normal))]))
    columns = np.column_stack([2.0 * around, np.ones(len(around))])
    solution, _, rank, _ = np.linalg.lstsq(columns, (around**2).sum(axis=1), rcond=1e-9)
    if rank < 4:
        return FitStatus.UNDETERMINED
    radius = np.sqrt(solution[3] + solution[:3] @ solution[:3])
    return SphereShape(float(radius), *(middle + solution[:3]).tolist())


def _cylinder(radius_mm: float, point: Array, direction: Array) -> CylinderShape:
    """A cylinder that says in its own frame no more than its radius."""
    return CylinderShape(radius_mm, 0.0, 0.0, 0.0, 0.0, _frame(direction, point, 0))


def _plane(point: Array, normal: Array) -> PlaneShape:
    return PlaneShape(0.0, 0.0, 0.0, _frame(normal, point, 2))


def _at_rest(shape: Shape) -> Shape:
    """A shape found from nothing, in a frame of its own: what was found lies in its pose."""
    if isinstance(shape, CylinderShape):
        return _cylinder(shape.radius_mm, *shape.axis)
    return _plane(*shape.axis) if isinstance(shape, PlaneShape) else shape


def _frame(axis: Array, origin: Array, column: int) -> Pose:
    """A right-handed frame at a point, one of whose axes is given."""
    columns = np.roll([axis, *square_to(axis)], column, axis=0)
    return Pose(columns.T, origin)


def _least(points: Array, start: Shape, names: tuple[str, ...]) -> tuple[Shape, Array, FitStatus]:
    """The nearest shape, (J^T J)^-1 of its free values, and how that ended."""
    shape, before = start, np.inf
    for _ in range(_MOST_STEPS):
        normal, right, squares, count = _normal_equations(points, shape, names)
        if count <= len(names):
            return shape, normal, FitStatus.TOO_FEW
        size = np.sqrt(np.diag(normal))
        if not (size > 0.0).all():
            return shape, normal, FitStatus.UNDETERMINED
        scaled = normal / np.outer(size, size)
        values = np.linalg.eigvalsh(scaled)
        if names and values[0] < _UNDETERMINED * values[-1]:
            return shape, normal, FitStatus.UNDETERMINED
        covariance = np.linalg.inv(scaled) / np.outer(size, size)
        if not names or abs(before - squares) <= _SETTLED * squares + count * _EXACT_MM**2:
            return shape, covariance, FitStatus.FITTED
        step = -covariance @ right
        shape = shape.with_values(
            **{name: shape.values[name] + d for name, d in zip(names, step, strict=True)}
        )
        before = squares
    return shape, covariance, FitStatus.NOT_CONVERGED


def _normal_equations(
    points: Array, shape: Shape, names: tuple[str, ...]
) -> tuple[Array, Array, float, int]:
    """J^T J, J^T r, r^T r and the number of residuals r, over all points near the shape."""
    normal, right = np.zeros((len(names), len(names))), np.zeros(len(names))
    squares, count = 0.0, 0
    for some in shares(len(points)):
        found = shape.distance(points[some])
        near = np.isfinite(found.distance_mm)
        r = found.distance_mm[near]
        J = np.empty((len(r), len(names)))
        for column, name in zip(J.T, names, strict=True):
            column[:] = found.by_parameter[name][near]
        normal += J.T @ J
        right += J.T @ r
        squares += float(r @ r)
        count += len(r)
    return normal, right, squares, count


def _none(points: Array, count: int, status: FitStatus) -> FittedShape:
    residual = np.full(points.shape[:-1], np.nan)
    return FittedShape(None, {}, residual, np.nan, count, int(status))
