"""What a correction gives: points with their uncertainty, and the figures that judge it."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, fields
from functools import cached_property
from typing import Any, ClassVar

import numpy as np
from numpy.typing import NDArray

from virtual_sensor.display import Displayed, listed, tally
from virtual_sensor.imaging.scene import Scene
from virtual_sensor.medium.air_model import AirModel
from virtual_sensor.medium.index_field import IndexField
from virtual_sensor.metrology.air_estimate import AirEstimate
from virtual_sensor.metrology.centres import Status
from virtual_sensor.metrology.covariance import variance_along
from virtual_sensor.metrology.deviation import UM_PER_MM, euclidean
from virtual_sensor.metrology.error_budget import ErrorBudget, PointBudget
from virtual_sensor.metrology.identifiability import EstimateStatus
from virtual_sensor.metrology.truth import largest, rms
from virtual_sensor.optics.crossing_status import CrossingStatus
from virtual_sensor.records import Record, Table, counts_of, status_names
from virtual_sensor.studies.correct.scene_part import ScenePart
from virtual_sensor.studies.correct.surface import CorrectedSurface, SurfaceErrors
from virtual_sensor.studies.provenance import MadeWith, made_with
from virtual_sensor.studies.section import SectionErrors, section_errors

Array = NDArray[np.float64]

_PAIRS = (("xx", 0, 0), ("yy", 1, 1), ("zz", 2, 2), ("xy", 0, 1), ("xz", 0, 2), ("yz", 1, 2))


@dataclass(frozen=True)
class CorrectedTable(Table):
    """Corrected points, a row for each line centre, dot or block of fringes that was given.

    Attributes
    ----------
    measurement : ndarray of str of shape (N,)
        Its name.
    column_px, row_px : ndarray of shape (N,)
        (u, v) of the centre; empty where there is none.
    sigma_px : ndarray of shape (N,)
        Its standard deviation, across the line.
    centre_status : ndarray of str of shape (N,)
        "ok", "clipped" or "corrected", or why there is no centre.
    status : ndarray of str of shape (N,)
        "ok", or why there is no corrected point.
    point_mm : ndarray of shape (N, 3)
        Corrected, world.
    uncorrected_mm : ndarray of shape (N, 3)
        As if light ran straight, world.
    moved_um : ndarray of shape (N, 3)
        Corrected minus uncorrected.
    cov_xx_um2, cov_yy_um2, cov_zz_um2, cov_xy_um2, cov_xz_um2, cov_yz_um2 : ndarray of shape (N,)
        Covariance of the corrected point, world.
    sigma_um : ndarray of shape (N,)
        Standard deviation of the corrected point along the normal of the scene's part.
    distance_um : ndarray of shape (N,)
        Of the corrected point from the scene's part, positive outside; empty at edges.
    distance_uncorrected_um : ndarray of shape (N,)
        The same of the uncorrected point.
    """

    measurement: NDArray[np.str_]
    column_px: Array
    row_px: Array
    sigma_px: Array
    centre_status: NDArray[np.str_]
    status: NDArray[np.str_]
    point_mm: Array
    uncorrected_mm: Array
    moved_um: Array
    cov_xx_um2: Array
    cov_yy_um2: Array
    cov_zz_um2: Array
    cov_xy_um2: Array
    cov_xz_um2: Array
    cov_yz_um2: Array
    sigma_um: Array
    distance_um: Array
    distance_uncorrected_um: Array


@dataclass(frozen=True)
class EstimateTable(Table):
    """What was estimated, a row for each parameter of each estimate.

    Attributes
    ----------
    measurement : ndarray of str of shape (N,)
        From which it comes; the first of several that share an air.
    measurements : ndarray of int of shape (N,)
        How many share it.
    parameter, unit : ndarray of str of shape (N,)
        Its name and unit.
    value, sigma : ndarray of shape (N,)
        What was found, and the standard deviation that noise and priors leave.
    sigma_total : ndarray of shape (N,)
        With errors of poses and of the model too.
    bound : ndarray of shape (N,)
        Cramer and Rao's, of the images alone; infinite where they leave a choice.
    status : ndarray of str of shape (N,)
        "found", or why not.
    rms_px : ndarray of shape (N,)
        What the estimate leaves in the images.
    """

    measurement: NDArray[np.str_]
    measurements: NDArray[np.int64]
    parameter: NDArray[np.str_]
    unit: NDArray[np.str_]
    value: Array
    sigma: Array
    sigma_total: Array
    bound: Array
    status: NDArray[np.str_]
    rms_px: Array


@dataclass(frozen=True)
class Corrected(Displayed):
    """One measurement, corrected; N line centres or dots, as they were given.

    Attributes
    ----------
    name : str
        Of the folder or file.
    scene : Scene
        With the air that the correction took.
    pixel : ndarray of shape (N, 2)
        (u, v) in px; NaN where there is no centre.
    sigma_px : ndarray of shape (N,)
        Standard deviation across the line.
    centre_status : ndarray of shape (N,)
        `metrology.centres.Status`.
    status : ndarray of shape (N,)
        `CrossingStatus` of the corrected points.
    point_uncorrected_mm : ndarray of shape (N, 3)
        As if light ran straight, world.
    point_mm : ndarray of shape (N, 3)
        Through the air, world; NaN unless OK.
    budget : PointBudget
        What makes the points uncertain.
    part : ScenePart
        The scene's part, where its file has it.
    residual_px : ndarray of shape (N,) or None
        What an estimate leaves: distance from the shape, or along the light, in px.
    estimate : AirEstimate or None
        That its air comes from.
    whole_budget : ErrorBudget or None
        Of all measurements of the estimate, and of its parameters.
    surface : CorrectedSurface or None
        Of fringes, a point for each pixel of the camera.
    """

    _statuses: ClassVar = {"centre_status": Status, "status": CrossingStatus}

    name: str
    scene: Scene
    pixel: Array
    sigma_px: Array
    centre_status: NDArray[np.uint8]
    status: NDArray[np.uint8]
    point_uncorrected_mm: Array
    point_mm: Array
    budget: PointBudget
    part: ScenePart
    residual_px: Array | None = None
    estimate: AirEstimate | None = None
    whole_budget: ErrorBudget | None = None
    surface: CorrectedSurface | None = None

    def _line(self) -> str:
        moved = f"moved by {rms(euclidean(self.moved_um)):.3g} µm rms"
        return listed(self.name, tally(self.status, CrossingStatus.OK), moved)

    def _columns(self) -> dict[str, NDArray[Any]]:
        return self.table.columns()

    @property
    def points(self) -> int:
        """How many corrected points there are."""
        return int(np.isfinite(self.point_mm).all(axis=1).sum())

    @property
    def covariance_mm2(self) -> Array:
        """Covariance (N, 3, 3) of the corrected points, of all sources of error together."""
        return self.budget.total_mm2

    @cached_property
    def moved_um(self) -> Array:
        """By how much (N, 3) the correction moves each point, world."""
        return UM_PER_MM * (self.point_mm - self.point_uncorrected_mm)

    @cached_property
    def along_mm(self) -> Array:
        """Position (N,) of the corrected points along the line."""
        return self.part.along_mm(self.point_mm)

    @cached_property
    def distance_um(self) -> Array:
        """Distances (N,) of the corrected points from the scene's part: positive outside."""
        return self.part.distance_um(self.point_mm)

    @cached_property
    def distance_uncorrected_um(self) -> Array:
        """Distances (N,) of the uncorrected points from the scene's part."""
        return self.part.distance_um(self.point_uncorrected_mm)

    @cached_property
    def sigma_um(self) -> Array:
        """Standard deviation (N,) of the corrected points along the normal of the scene's part."""
        variance = variance_along(self.part.normals(self.point_mm), self.covariance_mm2)
        sigma: Array = UM_PER_MM * np.sqrt(np.maximum(variance, 0.0))  # less by rounding
        return sigma

    @cached_property
    def table(self) -> CorrectedTable:
        """All of it, a row for each centre."""
        covariance = {
            f"cov_{name}_um2": UM_PER_MM**2 * self.covariance_mm2[:, i, j] for name, i, j in _PAIRS
        }
        return CorrectedTable(
            measurement=np.full(len(self.pixel), self.name),
            column_px=self.pixel[:, 0],
            row_px=self.pixel[:, 1],
            sigma_px=self.sigma_px,
            centre_status=status_names(self.centre_status, Status),
            status=status_names(self.status, CrossingStatus),
            point_mm=self.point_mm,
            uncorrected_mm=self.point_uncorrected_mm,
            moved_um=self.moved_um,
            **covariance,
            sigma_um=self.sigma_um,
            distance_um=self.distance_um,
            distance_uncorrected_um=self.distance_uncorrected_um,
        )

    @cached_property
    def summary(self) -> CorrectedSummary:
        """Its figures."""
        moved, sigma = euclidean(self.moved_um), self.sigma_um[np.isfinite(self.sigma_um)]
        return CorrectedSummary(
            scene=str(self.scene.path),
            parameters=dict(self.scene.parameters),
            points=self.points,
            moved_rms_um=rms(moved),
            moved_largest_um=largest(moved),
            median_sigma_um=float(np.median(sigma)) if sigma.size else np.nan,
            distance=section_errors(self.part, self.point_mm),
            distance_uncorrected=section_errors(self.part, self.point_uncorrected_mm),
            centre_status=counts_of(self.centre_status, Status),
            status=counts_of(self.status, CrossingStatus),
            surface=self.surface.errors if self.surface else None,
        )


@dataclass(frozen=True)
class CorrectedSummary(Record):
    """The figures of one corrected measurement.

    Attributes
    ----------
    scene : str
        Its file.
    parameters : dict
        The scene's parameters as they were used.
    points : int
        Corrected points.
    moved_rms_um, moved_largest_um : float
        By how much the correction moves them.
    median_sigma_um : float
        Of the points' standard deviations along the normal of the scene's part.
    distance, distance_uncorrected : SectionErrors
        Of corrected and uncorrected points from the scene's part.
    centre_status, status : dict
        How many centres, and corrected points, have each status.
    surface : SurfaceErrors or None
        Of fringes, all pixels of the camera; points are the middles of blocks of them.
    """

    scene: str
    parameters: dict[str, str]
    points: int
    moved_rms_um: float
    moved_largest_um: float
    median_sigma_um: float
    distance: SectionErrors
    distance_uncorrected: SectionErrors
    centre_status: dict[str, int]
    status: dict[str, int]
    surface: SurfaceErrors | None = None


@dataclass(frozen=True)
class RadiusFit(Record):
    """A circle through the points of all measurements of a cylinder along x.

    Attributes
    ----------
    radius_mm, y_mm, z_mm : float
        The circle's radius and its centre, world.
    true_radius_mm : float
        Of the scene's part.
    radius_error_um : float
        Radius minus that.
    rms_um : float
        Of the points' distances from the circle.
    points : int
    interval_95_um : float or None
        Half the radius's interval of 95 %, by what is known of noise, air, poses and the model;
        None of points without a correction, and where measurements have airs of their own.
    """

    radius_mm: float
    y_mm: float
    z_mm: float
    true_radius_mm: float
    radius_error_um: float
    rms_um: float
    points: int
    interval_95_um: float | None = None


@dataclass(frozen=True)
class AirFacts(Record):
    """The air that the correction took.

    Attributes
    ----------
    origin : str
        "scene", "medium" (a file), "temperature", "estimate", or "none" where light runs straight.
    source : str
        File or description of the field.
    """

    origin: str
    source: str


@dataclass(frozen=True)
class EstimateFacts(Record):
    """What was found of the air, of a shape and of poses, and how sure it is.

    Attributes
    ----------
    measurements : tuple of str
        From which it comes.
    values, sigma : dict of float
        By the parameters' names: found, and the standard deviation by noise and priors.
    units : dict of str
        "" of a plain factor.
    status : dict of str
        "found", or why it is none ("prior", "not_told_apart", "at_bound").
    sigma_total : dict of float
        With errors of poses and of the model too (`ErrorBudget`).
    bound : dict of float
        Cramer and Rao's: the least standard deviation that the data alone allow; null: none.
    priors : dict of dict
        Value and sigma of those that took part.
    correlation : list
        Of the parameters, in the order of their names.
    condition : float
        Of data and priors together.
    shape : str
        That the part was taken to have; "" of dots.
    rms_px : float
        Of the residuals.
    chi2 : float
        Residuals over their noise, squared, by the degrees of freedom.
    iterations : int
    """

    measurements: tuple[str, ...]
    values: dict[str, float]
    sigma: dict[str, float]
    sigma_total: dict[str, float]
    units: dict[str, str]
    status: dict[str, str]
    bound: dict[str, float]
    priors: dict[str, dict[str, float]]
    correlation: Array
    condition: float
    shape: str
    rms_px: float
    chi2: float
    iterations: int

    @classmethod
    def of(cls, estimate: AirEstimate, budget: ErrorBudget | None) -> EstimateFacts:
        """The facts of an estimate."""

        def named(values: Any) -> dict[str, Any]:
            return dict(zip(estimate.names, values, strict=True))

        return cls(
            tuple(each.name for each in estimate.observations),
            named(estimate.values.tolist()),
            named(estimate.sigma.tolist()),
            named((budget.total if budget else np.full(len(estimate.names), np.nan)).tolist()),
            named(estimate.units),
            named(status_names(estimate.status, EstimateStatus).tolist()),
            named(estimate.bound.tolist()),
            {name: {"value": p.value, "sigma": p.sigma} for name, p in estimate.priors.items()},
            estimate.correlation,
            estimate.condition,
            "" if estimate.shape is None else type(estimate.shape).__name__,
            estimate.rms_px,
            estimate.chi2,
            estimate.iterations,
        )


@dataclass(frozen=True)
class FrameSway(Record):
    """How much points of a burst's frames sway, before and after their correction.

    Attributes
    ----------
    frames : int
        Of the burst.
    before_um, after_um : float
        Standard deviation over the frames of the distance from the scene's part, at equal columns;
        its root mean square along the line. After: what of it is left. The points themselves sway,
        since light falls on other places; their distance from the part does not.
    """

    frames: int
    before_um: float
    after_um: float

    @staticmethod
    def of(frames: Sequence[Corrected]) -> FrameSway | None:
        """Of frames with centres in the same columns; None of fewer than three."""
        from virtual_sensor.studies.burst import MIN_FRAMES, spread  # which renders

        if len(frames) < MIN_FRAMES or len({len(each.pixel) for each in frames}) > 1:
            return None
        before, after = (
            rms(spread(np.array([getattr(each, name) for each in frames])[..., None]).std)
            for name in ("distance_uncorrected_um", "distance_um")
        )
        return FrameSway(len(frames), before, after)


@dataclass(frozen=True)
class CorrectionSummary(Record):
    """What shows whether a correction is sound, and how good it is.

    Attributes
    ----------
    air : AirFacts
        That the correction took.
    measurements : dict of CorrectedSummary
        By name.
    estimates : list of EstimateFacts
        One, or of a burst one for each frame; none where the air is known.
    circle, circle_uncorrected : RadiusFit or None
        Through all corrected, and uncorrected, points; None where the part is no cylinder.
    sway : FrameSway or None
        Of the frames of a burst.
    notes : tuple of str
        What the user should know.
    caveats : tuple of str
        Those of the notes that make the figures worth little.
    made_with : MadeWith
        Engine and versions.
    time_s : float
        Of the correction, without the writing of results.
    """

    air: AirFacts
    measurements: dict[str, CorrectedSummary]
    estimates: tuple[EstimateFacts, ...]
    circle: RadiusFit | None
    circle_uncorrected: RadiusFit | None
    sway: FrameSway | None
    notes: tuple[str, ...]
    caveats: tuple[str, ...]
    made_with: MadeWith
    time_s: float


@dataclass(frozen=True)
class Correction(Displayed):
    """Measurements, corrected through known or estimated air.

    Attributes
    ----------
    measurements : tuple of Corrected
    air : AirFacts
    medium : IndexField or None
        The air, where all measurements share one; None where light runs straight, and of a burst.
    model : AirModel or None
        The family of airs that was estimated in.
    estimate : AirEstimate or None
        Where all measurements share one; of a burst each frame has its own.
    circle, circle_uncorrected : RadiusFit or None
        Through all corrected, and uncorrected, points; None where the part is no cylinder.
    notes : tuple of str
        What the user should know.
    caveats : tuple of str
        Those of the notes that make the figures worth little.
    time_s : float
    sway : FrameSway or None
        Of the frames of a burst.
    """

    measurements: tuple[Corrected, ...]
    air: AirFacts
    medium: IndexField | None
    model: AirModel | None
    estimate: AirEstimate | None
    circle: RadiusFit | None
    circle_uncorrected: RadiusFit | None
    notes: tuple[str, ...]
    caveats: tuple[str, ...]
    time_s: float
    sway: FrameSway | None = None

    def _line(self) -> str:
        names = f"{len(self.measurements)} measurements, air from {self.air.origin}"
        moved = rms(euclidean(np.concatenate([each.moved_um for each in self.measurements])))
        return listed(names, f"{self.points} points", f"moved by {moved:.3g} µm rms")

    def _columns(self) -> dict[str, NDArray[Any]]:
        return self.table.columns()

    @cached_property
    def table(self) -> CorrectedTable:
        """All points of all measurements."""
        tables = [each.table for each in self.measurements]
        names = [each.name for each in fields(CorrectedTable)]
        joined = {name: np.concatenate([getattr(t, name) for t in tables]) for name in names}
        return CorrectedTable(**joined)

    @property
    def estimate_table(self) -> EstimateTable:
        """What was estimated; each row is a parameter."""
        rows = [
            (
                each.observations[0].name,
                len(each.observations),
                name,
                each.units[i],
                each.values[i],
                each.sigma[i],
                budget.total[i] if budget else np.nan,
                each.bound[i],
                EstimateStatus(each.status[i]).name.lower(),
                each.rms_px,
            )
            for each, budget in self._estimates()
            for i, name in enumerate(each.names)
        ]
        return EstimateTable(*(np.array(column) for column in zip(*rows, strict=True)))

    @property
    def points(self) -> int:
        """Corrected points of all measurements."""
        return sum(each.points for each in self.measurements)

    @property
    def estimates(self) -> list[AirEstimate]:
        """All estimates, each once, in the order of the measurements."""
        return [estimate for estimate, _ in self._estimates()]

    @property
    def budget(self) -> ErrorBudget | None:
        """Of the one estimate, where all measurements share one."""
        return self.measurements[0].whole_budget if self.estimate is not None else None

    def _estimates(self) -> list[tuple[AirEstimate, ErrorBudget | None]]:
        found = {id(m.estimate): (m.estimate, m.whole_budget) for m in self.measurements}
        return [(estimate, budget) for estimate, budget in found.values() if estimate is not None]

    @cached_property
    def summary(self) -> CorrectionSummary:
        """The figures, for ``summary.json``."""
        return CorrectionSummary(
            air=self.air,
            measurements={each.name: each.summary for each in self.measurements},
            estimates=tuple(EstimateFacts.of(*each) for each in self._estimates()),
            circle=self.circle,
            circle_uncorrected=self.circle_uncorrected,
            sway=self.sway,
            notes=self.notes,
            caveats=self.caveats,
            made_with=made_with(self.measurements[0].scene),
            time_s=round(self.time_s, 3),
        )
