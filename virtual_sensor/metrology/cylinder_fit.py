"""A cylinder through measured points, and how sure its radius is.

The sum of squared distances to the surface is least (geometric or orthogonal least squares).  Frame
and unit are those of the points, the world's in mm.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import ClassVar

import numpy as np
from numpy.typing import ArrayLike, NDArray
from scipy.optimize import OptimizeResult, least_squares
from scipy.special import ndtri, stdtrit

from virtual_sensor.arrays import numbers_of, points_of
from virtual_sensor.calls import public
from virtual_sensor.display import Displayed, listed, place
from virtual_sensor.errors import InputError
from virtual_sensor.metrology.deviation import UM_PER_MM
from virtual_sensor.statuses import StatusEnum

Array = NDArray[np.float64]

_UNDETERMINED = 1e7  # condition of the scaled Jacobian from which on the points leave a choice
_FLAT = 1e-4  # spread square to a plane below which points lie in it, by the widest spread...
_FLAT_NOISE = 3.0  # ...and by the residuals' spread
_TRIED, _REFINED = 60, 6  # directions of the axis that are tried out for a start; the best ones
_SAMPLED = 100  # points that take part in that


class FitStatus(StatusEnum):
    """How a fit ended."""

    FITTED = 0, "The shape was found."
    TOO_FEW = 1, "There are no more points than unknowns: give more finite points."
    UNDETERMINED = (
        2,
        "More than one such shape goes through the points, which lie on a line or a plane, or all "
        "in one section while the direction is free: give the axis (direction), or points that "
        "span more of the surface.",
    )
    NOT_CONVERGED = 3, "The fit did not converge: look for outliers, or give the axis (direction)."


@dataclass(frozen=True)
class CylinderFit(Displayed):
    """The cylinder nearest to N points; NaN in all numbers where there is none.

    Attributes
    ----------
    radius_mm : float
    axis_point_mm : ndarray of shape (3,)
        Of the axis, the point nearest to the mean of the points.
    axis_direction : ndarray of shape (3,)
        Unit vector whose largest component is positive; or the one that was given.
    residual_um : ndarray of shape (N,)
        Distance of each point from the surface, positive outside; NaN where there is no point.
    residual_std_um : float
        Root of the sum of squared residuals by the degrees of freedom, count minus unknowns.
    count : int
        Of the finite points, which are the ones that took part.
    status : int
        `FitStatus`.
    """

    _statuses: ClassVar = {"status": FitStatus}

    radius_mm: float
    axis_point_mm: Array
    axis_direction: Array
    residual_um: Array
    residual_std_um: float
    count: int
    status: int

    def _line(self) -> str:
        if self.status != FitStatus.FITTED:
            return f"none, {FitStatus(self.status).name.lower()}: {self.count} points"
        spread = f"residuals of {self.residual_std_um:.3g} µm"
        axis = f"axis {place(self.axis_direction)} through {place(self.axis_point_mm)} mm"
        return listed(f"radius {self.radius_mm:.7g} mm", f"{self.count} points", spread, axis)


@public
def fit_cylinder(points_mm: ArrayLike, *, direction: ArrayLike | None = None) -> CylinderFit:
    """Fit a circular cylinder by orthogonal least squares.

    Parameters
    ----------
    points_mm : array_like of shape (N, 3)
        Points that are not finite are left out.
    direction : array_like of shape (3,), optional
        Of the axis, of any length.  Where it is given, only the radius and the axis' place are
        fitted, 3 unknowns instead of 5: for points of one section, which do not determine it.

    Returns
    -------
    CylinderFit

    Raises
    ------
    InputError
        If the points are no (N, 3), or the direction is not one.

    Notes
    -----
    Levenberg and Marquardt's method (MINPACK) with exact derivatives.  It starts from the best of
    many directions, each with the circle of Kasa's linear fit (1976) in the plane across: a short
    arc has several minima.
    """
    points, held = _points(points_mm), _direction(direction)
    finite = np.isfinite(points).all(axis=1)
    used = points[finite]
    unknowns = 5 if held is None else 3
    if len(used) <= unknowns:
        return _no_fit(points, FitStatus.TOO_FEW)
    middle = used.mean(axis=0)
    centred = used - middle
    # At random: every so many of a scan's points may lie in one section.
    sample = np.random.default_rng(0).permutation(len(used))[:_SAMPLED]
    starts = _starts(centred[np.sort(sample)], held)
    if not starts:
        return _no_fit(points, FitStatus.UNDETERMINED)
    _, axis, start = min(starts, key=lambda tried: tried[0])
    across = square_to(axis)
    found = _least(centred, axis, across, start[:unknowns])
    depth = np.linalg.svd(centred, compute_uv=False)
    flat = held is None and depth[2] < max(
        _FLAT * depth[0], _FLAT_NOISE * np.linalg.norm(found.fun)
    )
    if flat or not _determined(found.jac):
        return _no_fit(points, FitStatus.UNDETERMINED)
    if found.status <= 0 or not found.x[0] > 0.0:
        return _no_fit(points, FitStatus.NOT_CONVERGED)
    x = _all(found.x)
    turned = axis + x[3:] @ across
    turned /= np.linalg.norm(turned)
    if held is None:
        turned = turned * np.sign(turned[np.argmax(np.abs(turned))])
    place = x[1:3] @ across
    residual_um = np.full(len(points), np.nan)
    residual_um[finite] = UM_PER_MM * found.fun
    freedom = len(used) - unknowns
    return CylinderFit(
        float(found.x[0]),
        middle + place - turned * (place @ turned),
        turned,
        residual_um,
        float(np.sqrt(np.nansum(residual_um**2) / freedom)),
        len(used),
        int(FitStatus.FITTED),
    )


def radius_interval(
    points_mm: ArrayLike,
    block: int,
    *,
    direction: ArrayLike | None = None,
    fit: CylinderFit | None = None,
    level: float = 0.95,
    resamples: int = 400,
    seed: int = 0,
) -> tuple[float, float]:
    """Confidence interval of a fitted radius, from residuals that depend on their neighbours.

    A block bootstrap: the residuals are drawn again in blocks of consecutive ones, the ends
    joined to a ring, and the radius is fitted again to each such set.  The fit is linear in so
    small changes: one step of Gauss and Newton's method from the fitted cylinder does it.

    Parameters
    ----------
    points_mm : array_like of shape (N, 3)
        In such an order that the residuals of neighbours depend on each other, if any do.
    block : int
        Points in a block: twice as many as the dependence reaches, and few enough to leave some ten
        blocks; 1 where residuals are independent.
    direction : array_like of shape (3,), optional
        As in `fit_cylinder`.
    fit : CylinderFit, optional
        Of these very points and this direction, where it is known already.
    level : float
        Probability with which the interval is to hold the true radius.
    resamples, seed : int
        How many sets are drawn, and the start of their random numbers: the same call gives the same
        bits.

    Returns
    -------
    tuple of float
        Lower and upper bound, mm; NaN where there is no fit.

    Raises
    ------
    InputError
        As in `fit_cylinder`, and if the block, the level or the resamples are no possible ones.

    Notes
    -----
    Politis and Romano 1992, "A circular block-resampling procedure for stationary data".  With b
    blocks and p unknowns the spread is that of b - p independent numbers at most: it is enlarged by
    sqrt(b/(b - p)), and by Student's quantile over the normal one.  On 201 points of an arc of 109
    degrees, direction given, intervals of 95 % held the true radius in 93 % of 200 trials with
    white residuals (block 1) and in 91 to 94 % with neighbours correlated to 0.5, 0.8 and 0.9 and
    some ten blocks.

    The interval knows of random errors of the residuals' spread and correlation.  An error that is
    itself another cylinder, as of refraction that bulges a whole line, leaves no residuals and is
    not in it.
    """
    points, held = _points(points_mm), _direction(direction)
    unknowns = 5 if held is None else 3
    longest = max(1, int(np.isfinite(points).all(axis=1).sum()) // (unknowns + 2))
    if not (1 <= block <= longest and resamples >= 2 and 0.0 < level < 1.0):
        raise InputError(
            f"radius_interval: block {block}, level {level}, {resamples} resamples; give a block of"
            f" 1 to {longest} of these points, a level between 0 and 1, and at least 2 resamples"
        )
    fit = fit or fit_cylinder(points, direction=direction)
    if fit.status != FitStatus.FITTED:
        return np.nan, np.nan
    used = points[np.isfinite(points).all(axis=1)]
    x = np.array([fit.radius_mm, 0.0, 0.0, 0.0, 0.0])
    across = square_to(fit.axis_direction)
    residual, jacobian = _distance(used - fit.axis_point_mm, x, fit.axis_direction, across)
    gain = -np.linalg.pinv(jacobian[:, :unknowns])[0]  # change of the radius by each residual's

    n, blocks = len(used), len(used) / block
    tails = np.array([1.0 - level, 1.0 + level]) / 2.0
    few = np.sqrt(blocks / (blocks - unknowns)) * stdtrit(blocks - unknowns, tails[1])
    starts = np.random.default_rng(seed).integers(n, size=(resamples, -(-n // block)))
    places = (starts[:, :, None] + np.arange(block)).reshape(resamples, -1)[:, :n] % n
    changes = (residual - residual.mean())[places] @ gain
    low, high = fit.radius_mm + np.quantile(changes, tails) * few / ndtri(tails[1])
    return float(low), float(high)


def _points(points_mm: ArrayLike) -> Array:
    points = points_of("fit_cylinder: points_mm", points_mm)
    if points.ndim != 2 or points.shape[1] != 3:
        raise InputError(f"fit_cylinder: points_mm has the shape {points.shape}; give (N, 3)")
    return points


def _direction(direction: ArrayLike | None) -> Array | None:
    if direction is None:
        return None
    given = numbers_of("fit_cylinder: direction", direction)
    length = np.linalg.norm(given)
    if given.shape != (3,) or not 0.0 < length < np.inf:
        raise InputError(
            f"fit_cylinder: direction {given.tolist()}; give three finite numbers, not all zero"
        )
    return given / length


def _no_fit(points: Array, status: FitStatus) -> CylinderFit:
    none = np.full(3, np.nan)
    count = int(np.isfinite(points).all(axis=1).sum())
    return CylinderFit(np.nan, none, none, np.full(len(points), np.nan), np.nan, count, int(status))


def _all(x: Array) -> Array:
    """The five unknowns, of which the axis' turn is zero where its direction is held."""
    return np.concatenate([x, np.zeros(5 - len(x))])


def square_to(axis: Array) -> Array:
    """Two unit vectors (2, 3) square to an axis and to each other."""
    first = np.cross(axis, np.eye(3)[np.argmin(np.abs(axis))])
    first /= np.linalg.norm(first)
    return np.stack([first, np.cross(axis, first)])


def _distance(points: Array, x: Array, axis: Array, across: Array) -> tuple[Array, Array]:
    """Distance (N,) from a cylinder, and its derivatives (N, 5) by the unknowns x.

    These are the radius, the axis' place along the two vectors across, and its turn towards them.
    """
    long = axis + x[3:] @ across
    length = np.linalg.norm(long)
    d = long / length
    q = points - x[1:3] @ across
    depth = q @ d
    w = q - depth[:, None] * d
    from_axis = np.linalg.norm(w, axis=1)
    u = w / np.where(from_axis > 0.0, from_axis, 1.0)[:, None]
    toward = u @ across.T
    jacobian = np.column_stack([-np.ones(len(q)), -toward, -depth[:, None] / length * toward])
    return from_axis - x[0], jacobian


def _least(points: Array, axis: Array, across: Array, start: Array) -> OptimizeResult:
    """Least squares from the first 3 or all 5 unknowns, by Levenberg and Marquardt."""
    return least_squares(
        lambda x: _distance(points, _all(x), axis, across)[0],
        start,
        lambda x: _distance(points, _all(x), axis, across)[1][:, : len(start)],
        method="lm",
        x_scale="jac",
        xtol=1e-12,
        ftol=1e-15,
        gtol=1e-12,
        max_nfev=200,
    )


def _starts(points: Array, held: Array | None) -> list[tuple[float, Array, Array]]:
    """Cost, axis and unknowns of cylinders to start from, in a sample of centred points.

    Where the direction is free, circles are fitted along many, and the best of them are refined:
    a good direction may have a bad circle.
    """
    if held is not None:
        return _circles(points, held[None])
    principal = np.linalg.svd(points, full_matrices=False)[2]
    tried = _circles(points, np.concatenate([principal, _hemisphere(_TRIED)]))
    refined = []
    for _, axis, start in sorted(tried, key=lambda each: each[0])[:_REFINED]:
        across = square_to(axis)
        found = _least(points, axis, across, start)
        turned = axis + found.x[3:] @ across
        turned /= np.linalg.norm(turned)
        # The same place on the new axis, in the vectors that go with it.
        place = square_to(turned) @ (found.x[1:3] @ across)
        refined.append((found.cost, turned, np.array([found.x[0], *place, 0.0, 0.0])))
    return refined


def _circles(points: Array, directions: Array) -> list[tuple[float, Array, Array]]:
    """Cost, axis and unknowns of Kasa's circles across some directions, where there are any."""
    found = []
    for axis in directions:
        p = points @ square_to(axis).T
        columns = np.column_stack([p, np.ones(len(p))])
        solution, _, rank, _ = np.linalg.lstsq(columns, (p**2).sum(axis=1), rcond=1e-9)
        centre = solution[:2] / 2.0
        squared = solution[2] + centre @ centre
        if rank == 3 and squared > 0.0:
            distance = np.linalg.norm(p - centre, axis=1) - np.sqrt(squared)
            start = np.array([np.sqrt(squared), *centre, 0.0, 0.0])
            found.append((float(distance @ distance), axis, start))
    return found


def _hemisphere(count: int) -> Array:
    """Directions (count, 3) spread evenly over a half sphere, on Fibonacci's spiral."""
    k = np.arange(count) + 0.5
    x, angle = k / count, np.pi * (1.0 + np.sqrt(5.0)) * k
    rim = np.sqrt(1.0 - x**2)
    return np.column_stack([x, rim * np.cos(angle), rim * np.sin(angle)])


def _determined(jacobian: Array) -> bool:
    """Whether derivatives (N, p), each scaled to the same size, are independent."""
    size = np.linalg.norm(jacobian, axis=0)
    if not np.isfinite(jacobian).all() or not (size > 0.0).all():
        return False
    values = np.linalg.svd(jacobian / size, compute_uv=False)
    return bool(values[0] < _UNDETERMINED * values[-1])
