"""The paper's forthcoming work: a cylinder scanned line by line, fitted cold and hot.

It also asks what an earlier experiment of the authors found (their reference 15): does refraction
make a hot cylinder measure too small?
"""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import ArrayLike, NDArray

from virtual_sensor.devices.laser import LaserLine
from virtual_sensor.devices.sensor import SensorModel
from virtual_sensor.display import Displayed
from virtual_sensor.errors import InputError
from virtual_sensor.imaging.scene import Scene
from virtual_sensor.metrology.cylinder_fit import (
    CylinderFit,
    FitStatus,
    fit_cylinder,
    radius_interval,
)
from virtual_sensor.metrology.deviation import UM_PER_MM
from virtual_sensor.metrology.triangulation import triangulate
from virtual_sensor.optics.ray_families import Pinhole
from virtual_sensor.optics.ray_search import ray_search
from virtual_sensor.optics.surfaces import Cylinder
from virtual_sensor.poses import Pose
from virtual_sensor.records import Table, status_names
from virtual_sensor.studies.reproduction.settings import SCAN, Setting

Array = NDArray[np.float64]

ALONG_MM = np.linspace(-60.0, 60.0, 13)
ARCS_MM = (5.0, 8.0, 11.0)
STATES = ("cold", "hot")

_OF_FITS = ("radius_mm", "residual_std_um", "axis_point_mm", "axis_direction", "count", "status")
_BLOCKS = 10
"""The rays of a line fall into so many blocks for the interval.  A residual's correlation with its
neighbours along the line falls to 1/e within an eighth of the line and to zero within a fifth."""


@dataclass(frozen=True)
class Reconstruction(Displayed):
    """M lines of K rays, cold and hot, and the cylinders through A arcs of them.

    World frame.  Axes of length 2 are the cold and the hot state.

    Attributes
    ----------
    along_mm : ndarray of shape (M,)
        Where the sensor stood along the cylinder's axis.
    y_mm : ndarray of shape (K,)
        Positions of the rays along the laser line.
    points_mm : ndarray of shape (2, M * K, 3)
        Measured points A_m and B_m, line by line; NaN where a ray's pixel was not found.
    true_mm : ndarray of shape (3,)
        The cylinder's radius, and y and z of its axis.
    arc_mm : ndarray of shape (A,)
        Rays of at most this abs(y) take part, ascending.
    radius_mm, residual_std_um : ndarray of shape (A, 2)
    interval_mm : ndarray of shape (A, 2, 2)
        Lower and upper bound of the radius, 95 %.
    axis_point_mm, axis_direction : ndarray of shape (A, 2, 3)
    count, status : ndarray of shape (A, 2)
        Points that took part, and `FitStatus`.
    """

    along_mm: Array
    y_mm: Array
    points_mm: Array
    true_mm: Array
    arc_mm: Array
    radius_mm: Array
    residual_std_um: Array
    interval_mm: Array
    axis_point_mm: Array
    axis_direction: Array
    count: NDArray[np.int64]
    status: NDArray[np.int64]

    @property
    def error_um(self) -> Array:
        """Fitted minus true radius, shape (A, 2)."""
        return UM_PER_MM * (self.radius_mm - self.true_mm[0])

    @property
    def interval_um(self) -> Array:
        """Bounds of the same, 95 %, shape (A, 2, 2)."""
        return UM_PER_MM * (self.interval_mm - self.true_mm[0])

    @property
    def axis_shift_um(self) -> Array:
        """Fitted minus true axis in y and z, in the middle of the points; shape (A, 2, 2)."""
        return UM_PER_MM * (self.axis_point_mm[..., 1:] - self.true_mm[1:])

    @property
    def tilt_mrad(self) -> Array:
        """Angle between the fitted and the true axis, shape (A, 2)."""
        across = np.hypot(self.axis_direction[..., 1], self.axis_direction[..., 2])
        return 1e3 * np.arctan2(across, np.abs(self.axis_direction[..., 0]))

    def radial_residual_um(self, state: int) -> Array:
        """Distance (K,) of the points from the cylinder through the widest arc, mean of all lines.

        Positive outside; NaN where no line has a point or nothing was fitted.
        """
        points = self.points_mm[state] - self.axis_point_mm[-1, state]
        axis = self.axis_direction[-1, state]
        across = points - (points @ axis)[:, None] * axis
        residual = UM_PER_MM * (np.linalg.norm(across, axis=1) - self.radius_mm[-1, state])
        by_line = residual.reshape(len(self.along_mm), len(self.y_mm))
        known = np.isfinite(by_line)
        total = np.where(known, by_line, 0.0).sum(axis=0)
        return np.asarray(total / np.where(known.any(axis=0), known.sum(axis=0), np.nan))


@dataclass(frozen=True)
class FittedCylinders(Table):
    """Fitted cylinders: a row for each state of a setting, and of scans for each arc.

    Attributes
    ----------
    air : sequence of str
        resolved, blurred or widened.
    temperature_c, beta_deg : sequence of float
        Temperature of the cylinder; turn of the sensor, 0 from above.
    state : sequence of str
        cold or hot.
    points : sequence of int
        How many points took part.
    radius_mm, radius_error_um : sequence of float
        The fitted radius; fitted minus true radius.
    radius_error_low_um, radius_error_high_um : sequence of float
        Bounds of the error, 95 %.
    residual_std_um : sequence of float
        Standard deviation of the points' distances from the fitted cylinder.
    arc_mm : sequence of float
        Rays of at most this abs(y) took part.
    status : sequence of str
        How the fit ended.
    hot_minus_cold_um : sequence of float
        Hot minus cold radius error; of hot rows.
    axis_y_um, axis_z_um, tilt_mrad : sequence of float
        Fitted minus true axis in the middle of the points, and the angle between the two.
    """

    air: Sequence[str]
    temperature_c: Sequence[float]
    beta_deg: Sequence[float]
    state: Sequence[str]
    points: Sequence[int]
    radius_mm: Sequence[float]
    radius_error_um: Sequence[float]
    radius_error_low_um: Sequence[float]
    radius_error_high_um: Sequence[float]
    residual_std_um: Sequence[float]
    arc_mm: Sequence[float] | None = None
    status: Sequence[str] | None = None
    hot_minus_cold_um: Sequence[float] | None = None
    axis_y_um: Sequence[float] | None = None
    axis_z_um: Sequence[float] | None = None
    tilt_mrad: Sequence[float] | None = None


@dataclass(frozen=True)
class _Moved:
    """What a search needs of a scene, with the sensor moved: nothing is loaded again."""

    camera: Pinhole
    source: LaserLine
    medium: Any
    surface: Any


def reconstruct(
    scene: Scene,
    along_mm: ArrayLike = ALONG_MM,
    rays: int = 201,
    arcs_mm: Sequence[float] = ARCS_MM,
    report: Callable[[str, float], None] = lambda stage, fraction: None,
) -> Reconstruction:
    """Scan the scene's cylinder along its axis, cold and hot, and fit cylinders to the points.

    Parameters
    ----------
    scene : Scene
        Of a cylinder; its sensor may be turned round it.
    along_mm : array_like of shape (M,)
        Where the sensor goes, mm along x from where the scene has it.
    rays : int
        On each line, over its whole length.
    arcs_mm : sequence of float
        Largest abs(y) of the rays that take part in a fit, ascending.
    report : callable
        Called with what is being done, and which fraction of the whole is.

    Raises
    ------
    InputError
        If the part is no cylinder, or a number is unfit.
    """
    part, along = scene.surface, np.atleast_1d(np.asarray(along_mm, float))
    arcs = np.atleast_1d(np.asarray(arcs_mm, float))
    if not isinstance(part, Cylinder):
        raise InputError(f"{scene.path}: the part is no cylinder along x; reconstruct one that is")
    if not (np.isfinite(along).all() and along.size and rays >= 2 and (arcs > 0.0).all()):
        raise InputError(
            f"reconstruct: along {along.tolist()} mm, {rays} rays, arcs {arcs.tolist()} mm; give"
            " finite places, at least 2 rays and positive arcs"
        )
    y = np.linspace(-0.5, 0.5, rays) * scene.sensor.laser.length_mm
    points = np.empty((2, len(along), rays, 3))
    for state, air in enumerate((None, scene.field)):
        for number, x in enumerate(along):
            done = (state * len(along) + number) / (2 * len(along))
            report(f"scanning the {STATES[state]} cylinder", 0.7 * done)
            sensor = _moved(scene.sensor, float(x))
            there = _Moved(sensor.camera, sensor.laser, air, part)
            found = ray_search(there, y, "newton", march=SCAN)
            points[state, number] = triangulate(sensor, found.pixel)

    fits: list[CylinderFit] = []
    intervals = []
    for number, arc in enumerate(arcs):
        report("fitting cylinders", 0.7 + 0.3 * number / len(arcs))
        taken = points[:, :, np.abs(y) <= arc * (1.0 + 1e-9)]
        for state in range(2):
            # All lines' points of a ray, then the next ray's: lines repeat each other's residuals,
            # and only points some distance apart along the line are independent.
            fit, interval = _fitted(np.swapaxes(taken[state], 0, 1).reshape(-1, 3))
            fits.append(fit)
            intervals.append(interval)

    def of(name: str) -> NDArray[Any]:
        values = np.array([getattr(fit, name) for fit in fits])
        return values.reshape(len(arcs), 2, *values.shape[1:])

    return Reconstruction(
        along_mm=along,
        y_mm=y,
        points_mm=points.reshape(2, -1, 3),
        true_mm=np.array([part.radius_mm, part.axis_y_mm, part.axis_z_mm]),
        arc_mm=arcs,
        interval_mm=np.reshape(intervals, (len(arcs), 2, 2)),
        **{name: of(name) for name in _OF_FITS},
    )


def fit_section(points_mm: ArrayLike) -> tuple[CylinderFit, tuple[float, float]]:
    """Fit the points (N, 3) of one line, such as a rendered one's, by a cylinder along x.

    The line's own direction says nothing of the axis', which is held.  Also returns the 95 %
    interval of the radius, mm.

    Raises
    ------
    InputError
        If the points are no (N, 3).
    """
    return _fitted(np.asarray(points_mm, float), direction=(1.0, 0.0, 0.0))


def _fitted(
    points_mm: Array, direction: ArrayLike | None = None
) -> tuple[CylinderFit, tuple[float, float]]:
    """A fit, and the interval of its radius in blocks of a tenth of the points."""
    fit = fit_cylinder(points_mm, direction=direction)
    if fit.status != FitStatus.FITTED:
        return fit, (np.nan, np.nan)
    block = max(1, fit.count // _BLOCKS)
    return fit, radius_interval(points_mm, block, direction=direction, fit=fit)


def _moved(sensor: SensorModel, along_mm: float) -> SensorModel:
    """The same sensor, moved along x."""
    motion = Pose(np.eye(3), np.array([along_mm, 0.0, 0.0]))
    return SensorModel(
        sensor.camera.with_pose(sensor.camera.pose.moved(motion)),
        sensor.laser.with_pose(sensor.laser.pose.moved(motion)),
    )


def fitted_cylinders(results: Mapping[Setting, Reconstruction]) -> FittedCylinders:
    """One row for each setting, arc and state."""
    rows: list[tuple[Any, ...]] = []
    for setting, r in results.items():
        error, bounds, shift, tilt = r.error_um, r.interval_um, r.axis_shift_um, r.tilt_mrad
        for i in np.ndindex(r.radius_mm.shape):
            arc, state = i
            apart = error[i] - error[arc, 0] if state else np.nan
            status = status_names(r.status[i], FitStatus)[0]
            fit = r.count[i], r.radius_mm[i], error[i], *bounds[i], r.residual_std_um[i]
            scan = r.arc_mm[arc], status, apart, *shift[i], tilt[i]
            rows.append((*vars(setting).values(), STATES[state], *fit, *scan))
    return FittedCylinders(*zip(*rows, strict=True))
