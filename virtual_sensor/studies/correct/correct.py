"""Correct measurements through air that is known, or found from the same measurements."""

from __future__ import annotations

import re
import time
from collections.abc import Callable, Iterable, Iterator, Mapping, Sequence
from contextlib import contextmanager
from dataclasses import replace
from itertools import count
from typing import Any

import numpy as np
from numpy.typing import NDArray

from virtual_sensor.errors import InputError, few, nearest
from virtual_sensor.imaging.scene import Scene
from virtual_sensor.medium.air_model import AirModel
from virtual_sensor.metrology.air_estimate import AirEstimate, estimate_air
from virtual_sensor.metrology.centres import Status
from virtual_sensor.metrology.covariance import WITHIN_95, carried
from virtual_sensor.metrology.cylinder_fit import FitStatus, fit_cylinder
from virtual_sensor.metrology.deviation import UM_PER_MM
from virtual_sensor.metrology.error_budget import (
    ErrorBudget,
    PointBudget,
    error_budget,
    known_air_budget,
    known_air_shape_budget,
)
from virtual_sensor.metrology.observations import Observation, Prior
from virtual_sensor.metrology.shapes import CylinderShape
from virtual_sensor.metrology.triangulation import triangulate
from virtual_sensor.metrology.truth import rms
from virtual_sensor.optics.bent_points import BentPoints, bent_points
from virtual_sensor.optics.crossing_status import CrossingStatus
from virtual_sensor.optics.field_border import JUMP_TOLD_PX, cover_words
from virtual_sensor.optics.surfaces import Cylinder
from virtual_sensor.studies.air_models import air_model_of
from virtual_sensor.studies.correct.asked import Settings, full_name, shape_of
from virtual_sensor.studies.correct.correction import (
    AirFacts,
    Corrected,
    Correction,
    FrameSway,
    RadiusFit,
)
from virtual_sensor.studies.correct.measured import Measured
from virtual_sensor.studies.correct.scene_part import ScenePart
from virtual_sensor.studies.correct.surface import CorrectedSurface

Array = NDArray[np.float64]
Report = Callable[[str, float], None]

USUAL = Settings()

_EVALUATIONS = 10  # of a usual estimate
_OF_A_FRAME = 60  # centres of a frame in the fit of all frames together
_TOGETHER_PX = 1e-3  # tolerance of that fit: each frame's own goes on from there
_POSES = "camera_", "laser_", "sensor_"  # what parameters of poses begin with
_FAR_UM = 1000.0  # off the scene's part: no air does that
_FURTHER, _FURTHER_UM = 1.2, 5.0  # off it than uncorrected points


def correct(
    measured: Sequence[Measured],
    settings: Settings = USUAL,
    report: Report = lambda stage, fraction: None,
) -> Correction:
    """Give the points that measurements hold, along bent lines of sight and laser rays.

    Measurements in one air are corrected together; each frame of a burst has an air of its own, and
    all show one part.

    Parameters
    ----------
    measured : sequence of Measured
        See `read_measured`.
    settings : Settings
    report : callable
        Called with what is being done, and the fraction of the whole that is done.

    Raises
    ------
    InputError
        Where nothing can be corrected; it names the remedy.
    """
    began = time.perf_counter()
    notes = [note for each in measured for note in each.notes]
    own = {each.name: each.scene for each in measured}
    measured, air, said = _in_known_air(measured, settings)
    notes += said
    airs = {(each.scene.path, id(each.scene.medium)): each.scene for each in measured}
    notes += [note for scene in airs.values() for note in scene.loading_notes]
    found: list[Corrected] = []
    estimates: list[AirEstimate] = []
    groups = _groups(measured, bool(settings.estimate))
    caveats = _mixed(own.values(), measured) + (_apart(groups) if settings.estimate else [])
    shared, starts = 0, dict[str, dict[str, float]]()
    if settings.estimate and sum(each.one_of_many for each in measured) > 1:
        shared = 1
        together = _together(
            *(measured, own, settings),
            lambda stage, part: report(f"all frames: {stage}", part / (len(groups) + shared)),
        )
        settings, said = _with_shared_shape(settings, together)
        starts = _starts(together)
        notes += said
    for number, group in enumerate(groups):

        def tell(stage: str, part: float, number: int = number + shared) -> None:
            name = groups[number - shared][0].name
            report(f"{name}: {stage}", (number + part) / (len(groups) + shared))

        if settings.estimate:
            name = group[0].name
            estimate = _estimate(group, own[name], settings, tell, start=starts.get(name))
            estimates.append(estimate)
            told = [f"{group[0].name}: {n}" if len(groups) > 1 else n for n in estimate.notes]
            notes += told
            if not (shared and group[0].one_of_many):
                caveats += _from_one_pose(group, estimate)
            budget = error_budget(
                estimate,
                sigmas=_of_poses(settings),
                families=() if group[0].one_of_many else None,  # it takes seconds
                progress=lambda part, tell=tell: tell("error budget", (1.0 + part) / 2.0),
            )
            found += [_by_estimate(each, i, estimate, budget) for i, each in enumerate(group)]
        else:
            tell("points through the air", 0.0)
            found += [_through(each, own[each.name], settings) for each in group]
    notes = few_alike(notes)
    notes += _through_lenses(found)
    caveats += [*_lost(found), *_ends_early(found), *_doubts(found)]
    if estimates:
        air = replace(air, origin="estimate")
    frames = {each.name for each in measured if each.one_of_many}
    media = {id(each.scene.medium): each.scene.medium for each in found}
    one = estimates[0] if len(estimates) == 1 else None
    return Correction(
        tuple(found),
        air,
        next(iter(media.values())) if len(media) == 1 else None,
        one.model if one else None,
        one,
        _sure(_circle(found, [each.point_mm for each in found]), found),
        _circle(found, [each.point_uncorrected_mm for each in found]),
        tuple(dict.fromkeys([*notes, *caveats])),
        tuple(caveats),
        time.perf_counter() - began,
        FrameSway.of([each for each in found if each.name in frames]),
    )


def _in_known_air(
    measured: Sequence[Measured], settings: Settings
) -> tuple[list[Measured], AirFacts, list[str]]:
    """The measurements in the air that is known, or assumed at first; what it is, and notes."""
    first, notes, origin = measured[0].scene, [], "scene"
    medium: Any = None
    if settings.medium is not None:
        medium, origin = first.with_medium(settings.medium).medium, "medium"
    elif settings.temperature_c is not None:
        family = _family(first, settings.temperature_c)
        with _as_options("--temperature", "AirModel: temperature "):
            medium, origin = family.at(temperature=settings.temperature_c), "temperature"
    elif first.medium is None:
        origin = "none"
        if not settings.estimate:
            notes.append(f"{first.path}: light runs straight in it: nothing is to be corrected")
    elif not settings.estimate:
        notes.append(
            f"nothing is said of the air: the scene's own is taken ({first.air_name}); --medium"
            " names another, --estimate finds it from the measurements"
        )
    elif len(frames := [each for each in measured if each.one_of_many]) > 1:
        mean = _mean([each.scene.medium for each in frames])
        notes.append("the air of each frame is estimated by itself, from the mean air of the burst")
        measured = [
            replace(each, scene=each.scene.with_medium(mean)) if each.one_of_many else each
            for each in measured
        ]
    if medium is not None:
        measured = [replace(each, scene=each.scene.with_medium(medium)) for each in measured]
    if origin != "none" and not (settings.estimate or settings.priors):
        notes.append(
            "the air is taken for exact, and sigma is of the centres' noise alone; --prior"
            " scale=1:0.05, say, tells how well it is known"
        )
    air = medium or first.medium
    source = settings.medium or (first.air.path if medium is None else None)
    return [*measured], AirFacts(origin, f"{source or (air.source if air else '')}"), notes


def _family(scene: Scene, temperature_c: float | None = None) -> AirModel:
    """The scene's air at several wall temperatures."""
    model = air_model_of(scene)
    if "temperature" not in model.names:
        wanted = "" if temperature_c is None else f" of {temperature_c:g} degC"
        raise InputError(
            f"{scene.path}: has air of one temperature; give a field{wanted} by --medium"
            " (`virtual-sensor field simulate --temperature` makes one)"
        )
    return model


def _mean(media: Sequence[Any]) -> Any:
    """The mean of fields on one grid."""
    first = media[0]
    total = np.zeros(first.shape)
    for each in media:
        total += each.nodes
    return first.with_nodes(total / len(media), source="mean of the burst's instants")


def _groups(measured: Sequence[Measured], estimated: bool) -> list[list[Measured]]:
    """Measurements in one air, together; each frame of a burst by itself."""
    if not estimated:
        return [[each] for each in measured]
    groups: dict[Any, list[Measured]] = {}
    for number, each in enumerate(measured):
        key = number if each.one_of_many else f"in {id(each.scene.medium)}"
        groups.setdefault(key, []).append(each)
    return list(groups.values())


def _mixed(own: Iterable[Scene], measured: Sequence[Measured]) -> list[str]:
    """A caveat where air is assumed for measurements of scenes in which light runs straight."""
    airs = zip(own, measured, strict=True)
    cold = [each.name for scene, each in airs if scene.medium is None is not each.scene.medium]
    if not 0 < len(cold) < len(measured):
        return []
    return [
        f"{few(cold, 3)}: light runs straight in the scene, and is taken for bent as in the others;"
        " leave out what was measured cold"
    ]


def _apart(groups: Sequence[Sequence[Measured]]) -> list[str]:
    """A caveat where measurements that could share their air are said to be in several."""
    single = [group for group in groups if not group[0].one_of_many]
    if len(single) < 2:
        return []
    airs = "; ".join(few([each.name for each in group], 3) for group in single[:4])
    return [
        f"the measurements are of scenes in {len(single)} kinds of air ({airs}), each of which is"
        " estimated by itself; if they were in one, say from which to start: --medium FILE"
    ]


def _together(
    measured: Sequence[Measured], own: Mapping[str, Scene], settings: Settings, report: Report
) -> AirEstimate:
    """All frames of a burst, by some of their centres: an air for each, and one shape."""
    frames = [_thinned(each) for each in measured if each.one_of_many]
    rough = replace(settings, tolerance_px=max(settings.tolerance_px, _TOGETHER_PX))
    return _estimate(frames, own[frames[0].name], rough, report, each_air=True)


def _with_shared_shape(settings: Settings, together: AirEstimate) -> tuple[Settings, list[str]]:
    """Settings that know the shape which all frames of a burst show together, and notes.

    One frame can't tell shape and air apart; in many the air is different, and the shape the same.
    """
    shape = together.shape
    free = [name for name in together.names if shape is not None and name in shape.names]
    if not free:
        return settings, []
    # Of noise alone, as the weights of each frame's pixels: the shape is as good as held.
    found = {name: Prior(together[name], together.sigma_of(name)) for name in free}
    said = ", ".join(f"{name} {each.value:.6g} ± {each.sigma:.2g}" for name, each in found.items())
    notes = [
        f"the shape of the part is that of all {len(together.observations)} frames together"
        f" ({said}, of noise alone), a prior of each frame's estimate"
    ]
    return replace(settings, priors=found | dict(settings.priors)), notes


def _starts(together: AirEstimate) -> dict[str, dict[str, float]]:
    """Values of each frame's own parameters, by the frame's name: near those of its own fit."""
    starts: dict[str, dict[str, float]] = {each.name: {} for each in together.observations}
    air = together.model.names
    for name, value in zip(together.names, together.values.tolist(), strict=True):
        frame, _, parameter = name.rpartition(".")
        if frame in starts:
            starts[frame][parameter if parameter in air else name] = value
    return starts


def _thinned(measured: Measured) -> Measured:
    """The same with some of its centres, as sure together as all: air is smooth along the line."""
    rows = np.flatnonzero(np.isfinite(measured.pixel).all(axis=1))
    all_rows = max(len(rows), 1)
    rows = rows[np.linspace(0, len(rows) - 1, min(len(rows), _OF_A_FRAME)).astype(int)]
    along = measured.along_mm
    return replace(
        measured,
        pixel=measured.pixel[rows],
        sigma_px=measured.sigma_px[rows] * np.sqrt(len(rows) / all_rows),
        normal_deg=measured.normal_deg[rows],
        centre_status=measured.centre_status[rows],
        along_mm=None if along is None else along[rows],
    )


def _estimate(
    group: Sequence[Measured],
    own: Scene,
    settings: Settings,
    report: Report,
    *,
    each_air: bool = False,
    start: Mapping[str, float] | None = None,
) -> AirEstimate:
    """The air of measurements, from them; `own` is the scene of the first, in its own air.

    With `each_air` every one has an air of its own.
    """
    _check_that_they_differ(group)
    scene = group[0].scene
    if scene.medium is None:
        raise InputError(
            f"{scene.path}: has no air whose parameters could be found; give a field that is like"
            " it (--medium FILE, or -D field=FILE)"
        )
    model = AirModel.of(scene.medium)
    if "temperature" in settings.estimate and settings.medium is None:
        model = _family(own)
        if settings.temperature_c is not None:
            model = replace(model, temperature_c=settings.temperature_c)
    _check_names(settings, model)
    shape, free = shape_of(settings, group, [_straight(m) for m in group])
    if shape is not None:
        _check_that_they_show_one_part(group)
    stage = f"estimating {', '.join(settings.estimate)}"
    report(stage, 0.0)
    of_air = [name for name in settings.estimate if name in model.names]
    done = (number / (number + _EVALUATIONS) for number in count(1))
    with _as_options("--estimate", "estimate_air: "):
        return estimate_air(
            [_observation(each) for each in group],
            model,
            of_air,
            each=of_air if each_air else (),
            shape=shape,
            free=free,
            pose_names=[name for name in settings.estimate if name not in model.names],
            priors={
                full_name(name, shape): prior
                for name, prior in settings.priors.items()
                if name not in _of_poses(settings)
            },
            start=start,
            tolerance_px=settings.tolerance_px,
            progress=lambda _: report(stage, 0.5 * next(done)),
        )


def _check_that_they_differ(group: Sequence[Measured]) -> None:
    """Refuse one measurement that is given twice, which would count as two."""
    for i, one in enumerate(group):
        for other in group[:i]:
            frames = one.one_of_many and other.one_of_many
            if not frames and np.array_equal(one.pixel, other.pixel, equal_nan=True):
                raise InputError(
                    f"{one.name}: holds the very centres of {other.name}; give each measurement"
                    " once, or an estimate takes itself for surer than it is"
                )


def _check_that_they_show_one_part(group: Sequence[Measured]) -> None:
    """Refuse measurements of several parts, of which one shape is sought."""
    first, *others = group
    for each in others:
        if _outline(each.scene) != _outline(first.scene):
            raise InputError(
                f"{each.name}: is of another part ({each.scene.path.name}) than {first.name}"
                f" ({first.scene.path.name}), and an estimate is of one; correct them one by one,"
                " or give the scene of both (--scene)"
            )


def _outline(scene: Scene) -> Any:
    """What tells parts apart: a cylinder, or the box of a mesh to a micrometre."""
    surface: Any = scene.surface
    if isinstance(surface, Cylinder):
        return surface
    return np.round(np.array(surface.corners, np.float64), 3).ravel().tolist()


def _check_names(settings: Settings, model: AirModel) -> None:
    """Refuse names that are neither the air's nor like a pose's or the laser plane's."""
    for name in settings.estimate:
        poses = name.rpartition(".")[2].startswith(_POSES)
        if name not in model.names and not poses:
            hint = nearest(name, model.names)
            if name == "temperature":
                hint = " alone, of one field; leave out --medium, and the scene's own are taken"
            raise InputError(f"--estimate {name}: the air has {', '.join(model.names)}{hint}")


@contextmanager
def _as_options(option: str, python: str) -> Iterator[None]:
    """Have errors of a function name the command's options, not its arguments."""
    try:
        yield
    except InputError as error:
        said = f"{error}".removeprefix(python).replace("priors has", "--prior has")
        said = said.replace("tolerance_px is", "--tolerance is")
        said = said.replace("priors={name: Prior(value, sigma)}", "--prior NAME=VALUE:SIGMA")
        raise type(error)(f"{option}: {said}") from None


def _from_one_pose(group: Sequence[Measured], estimate: AirEstimate) -> list[str]:
    """A caveat where air is found from one pose, and no part is known."""
    shown = estimate.shape.names if estimate.shape else ()
    free = [name for name in estimate.names if name in shown]
    poses = {tuple(each.scene.camera.pose.rotation.round(6).ravel()) for each in group}
    dots = any(each.along_mm is not None for each in group)
    epipolar = "fringes" if any(each.fringes is not None for each in group) else "dots"
    if len(poses) > 1 or (dots if estimate.shape else not dots) or not (free or dots):
        return []
    found = (
        f"air is found from the {epipolar} of one pose, where air of another kind can leave as"
        " little"
        if dots
        else f"air and shape ({', '.join(free)}) are found from one pose, where one can pass for"
        " the other however small the residual is"
    )
    return [
        f"{found} (tens of um of radius); measure from a second pose, 15 or 30 degrees further, and"
        " give both"
    ]


def _observation(measured: Measured) -> Observation:
    either = np.isnan(measured.normal_deg).any()
    return Observation(
        measured.scene,
        measured.pixel,
        measured.sigma_px,
        measured.coordinate,
        measured.along_mm,
        measured.name,
        None if either else measured.normal_deg,
    )


def _straight(measured: Measured) -> Array:
    """Its points (N, 3) as if light ran straight."""
    return triangulate(measured.scene, measured.pixel, coordinate=measured.coordinate)


def _of_poses(settings: Settings) -> dict[str, float]:
    """Standard deviations of pose parameters that are not estimated."""
    return {
        name: prior.sigma
        for name, prior in settings.priors.items()
        if name.startswith(_POSES) and name not in settings.estimate
    }


def _by_estimate(
    measured: Measured, i: int, estimate: AirEstimate, budget: ErrorBudget
) -> Corrected:
    """One of the measurements that an estimate comes from."""
    scene = measured.scene.with_medium(estimate.medium)
    found = _corrected(measured, scene, estimate.points[i], budget.points[i])
    return replace(
        found, residual_px=estimate.residual_px[i], estimate=estimate, whole_budget=budget
    )


def _through(measured: Measured, own: Scene, settings: Settings) -> Corrected:
    """One measurement through its scene's air, which is as sure as the priors say.

    Of the wall's temperature they say it where one is given, of the air of `own`.
    """
    seen, scene = _observation(measured), measured.scene
    points = bent_points(scene, measured.pixel, coordinate=measured.coordinate)
    if settings.priors:
        sigmas = {name: prior.sigma for name, prior in settings.priors.items()}
        model = None
        if "temperature" in sigmas and settings.temperature_c is not None:
            model = replace(_family(own), temperature_c=settings.temperature_c)
        with _as_options("--prior", "known_air_budget: "):
            budget = known_air_budget(seen, model, sigmas)
    else:
        covariance = carried(points.point_by_pixel, seen.covariance_px2)
        normals = ScenePart.of(scene).normals(points.point_mm)
        budget = PointBudget(points.point_mm, normals, {"detection": covariance}, {})
    return _corrected(measured, scene, points, budget)


def _corrected(
    measured: Measured, scene: Scene, points: BentPoints, budget: PointBudget
) -> Corrected:
    return Corrected(
        measured.name,
        scene,
        measured.pixel,
        measured.sigma_px,
        measured.centre_status,
        points.status,
        _straight(measured),
        points.point_mm,
        budget,
        ScenePart.of(scene),
        surface=CorrectedSurface.of(scene, measured.fringes) if measured.fringes else None,
    )


def _lost(found: Iterable[Corrected]) -> list[str]:
    """Notes on centres without a corrected point, and on measurements without a centre.

    Raises
    ------
    InputError
        If a measurement has centres, and no corrected point.
    """
    notes = []
    for each in found:
        if not np.isfinite(each.pixel).any():
            counts = Status.counts(each.centre_status).items()
            why = ", ".join(
                f"{status.name.lower()} {number}" for status, number in counts if number
            )
            notes.append(f"{each.name}: holds no centre ({why or 'no row'})")
        for status, number in CrossingStatus.counts(each.status).items():
            if status in (CrossingStatus.OK, CrossingStatus.NO_PIXEL):
                continue
            why = f"{status.message}{_where(each, status)}"
            if not each.points:
                raise InputError(f"{each.name}: none of {number} centres has a point. {why}")
            notes.append(f"{each.name}: {number} centres have no point. {why}")
    return notes


def _through_lenses(found: Iterable[Corrected]) -> Iterator[str]:
    """A note where hot air moves what a lens sees beside the ray through its middle."""
    for scene in {id(each.scene.camera): each.scene for each in found}.values():
        if scene.camera.blurs and scene.medium is not None:
            yield (
                f"{scene.camera_element} sees through a lens, and points are corrected along the"
                " rays through its middle: what the air does across the pupil is left in; `measure"
                " --sensor-model` says how much (the part lens of its error)"
            )


def _ends_early(found: Iterable[Corrected]) -> Iterator[str]:
    """Notes on fields that have not quite faded where light of corrected points enters them."""
    for each in found:
        scene = each.scene
        points = each.point_mm[np.isfinite(each.point_mm).all(axis=1)]
        if scene.medium is not None and len(points):
            lights = scene.camera, scene.source.family
            if words := cover_words(scene.medium, *lights, points, JUMP_TOLD_PX):
                yield (
                    f"{each.name}: the field of the air is short: {words}, and what it lacks may"
                    " move it by several times as much; give one that reaches further out"
                )


def _doubts(found: Iterable[Corrected]) -> list[str]:
    """Caveats where points are off the part by more than air could do, or than before."""
    notes = []
    for each in found:
        before, after = (rms(e) for e in (each.distance_uncorrected_um, each.distance_um))
        if not np.isfinite(after):
            continue
        if after > _FAR_UM:
            notes.append(
                f"{each.name}: the points lie {after / UM_PER_MM:.2g} mm rms off the part of"
                f" {each.scene.path.name}: part or sensor do not stand where the scene has them"
            )
        elif after > _FURTHER * before and after > _FURTHER_UM:
            notes.append(
                f"{each.name}: the correction moves points off the scene's part, from {before:.3g}"
                f" to {after:.3g} um rms: is this the air, and is the sensor's pose the scene's?"
            )
    return notes


def few_alike(notes: Iterable[str]) -> list[str]:
    """Notes, each once; of those that differ in numbers alone, such as a burst's, the first."""
    alike: dict[str, list[str]] = {}
    for note in dict.fromkeys(notes):
        alike.setdefault(re.sub(r"\d[\d.e+-]*", "0", note), []).append(note)
    return [
        first + (f" (and {len(others)} more like this)" if others else "")
        for first, *others in alike.values()
    ]


def _where(corrected: Corrected, status: CrossingStatus) -> str:
    """Where a field ends too early, in words."""
    scene, lost = corrected.scene, corrected.status == status
    points = corrected.point_uncorrected_mm[lost]
    points = points[np.isfinite(points).all(axis=1)]
    if status != CrossingStatus.UNCOVERED or scene.medium is None or not len(points):
        return ""
    words = cover_words(scene.medium, scene.camera, scene.source.family, points)
    return f" Of {scene.air_name}: {words}." if words else ""


def _sure(circle: RadiusFit | None, found: Sequence[Corrected]) -> RadiusFit | None:
    """The circle through corrected points, and what its radius may be wrong by."""
    budget = found[0].whole_budget
    if circle is None or any(each.whole_budget is not budget for each in found):
        return circle
    shape = CylinderShape(circle.radius_mm, circle.y_mm, circle.z_mm)
    free = ("radius_mm", "y_mm", "z_mm")
    if budget is None:
        of_circle = known_air_shape_budget([each.budget for each in found], shape, free)
    else:
        of_circle = budget.of_shape(shape, free)
    half = WITHIN_95 * of_circle.total[0]
    return replace(circle, interval_95_um=float(UM_PER_MM * half))


def _circle(found: Sequence[Corrected], points: Sequence[Array]) -> RadiusFit | None:
    """A circle through all points of a cylinder along x; None of other parts, and of few points."""
    part = found[0].scene.surface
    if not isinstance(part, Cylinder) or any(each.scene.surface != part for each in found):
        return None
    fit = fit_cylinder(np.concatenate(points), direction=(1.0, 0.0, 0.0))
    if fit.status != FitStatus.FITTED:
        return None
    _, y, z = fit.axis_point_mm
    error = UM_PER_MM * (fit.radius_mm - part.radius_mm)
    left = rms(fit.residual_um)
    return RadiusFit(fit.radius_mm, float(y), float(z), part.radius_mm, error, left, fit.count)
