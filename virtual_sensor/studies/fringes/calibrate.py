"""Calibrate a scene's camera and projector by rendered frames of a target: the truth is known.

The target stands in the part's place in several poses.  In each of them a lamp shows its marks, the
projector throws its patterns on it, and the camera sees both, straight or through the part's hot
air.  What is found from these frames is compared with the scene's own camera and projector.
"""

from __future__ import annotations

import time
from collections.abc import Callable, Mapping
from dataclasses import dataclass, field, replace
from typing import Any

import numpy as np
from numpy.typing import NDArray
from scipy.spatial.transform import Rotation

from virtual_sensor.arrays import number_within, whole_number
from virtual_sensor.devices.exposure_time import AUTO
from virtual_sensor.display import Displayed, listed
from virtual_sensor.errors import InputError
from virtual_sensor.imaging.fringe_recording import FringeRecording
from virtual_sensor.imaging.plate import PlateScenes, plate_scenes
from virtual_sensor.imaging.scene import Scene
from virtual_sensor.metrology.deviation import UM_PER_MM, euclidean
from virtual_sensor.metrology.fringes.calibration import (
    COEFFICIENTS,
    COUNTS,
    FringeCalibration,
    calibrate_fringes,
    meeting_mm,
    nearest_points,
    turn_between,
)
from virtual_sensor.metrology.fringes.codec import Codec
from virtual_sensor.metrology.fringes.codecs import codec_of
from virtual_sensor.metrology.fringes.target import (
    CalibrationTarget,
    Marks,
    MarkStatus,
    find_marks,
    projector_marks,
)
from virtual_sensor.metrology.truth import rms
from virtual_sensor.optics.ray_families import Pinhole
from virtual_sensor.poses import Pose
from virtual_sensor.records import Record, Table, counts_in_words, counts_of, status_names
from virtual_sensor.studies.provenance import SceneFacts, scene_facts

Array = NDArray[np.float64]
Report = Callable[[str, float], None]

_URAD = 1e6
_GOLDEN_DEG = 137.507764  # poses' tilts are about axes that lie so far apart
_TILTS = (0.4, 1.0, 0.7)  # of the largest, one after another; the first pose faces both devices
_STEEPEST_DEG, _MOST_TILT_DEG = 62.0, 30.0
_DEEP = 0.03  # of the distance, by which poses are nearer or farther
_FILLED = 0.95  # of the smaller field of view, by the target's marks
_LAMP_W_MM2 = 1.0


@dataclass(frozen=True)
class CalibrationSettings(Displayed):
    """How a scene's devices are calibrated.

    Attributes
    ----------
    codec : str or Codec
        Of the patterns, along both axes; as `codec_of` takes it.
    target : str
        "checkerboard" or "dots".
    poses : int
        Of the target.
    distortion : int
        Coefficients that are fitted for each device.
    hot : bool
        Whether the part's hot air is there.
    spp : int, optional
        Samples per pixel; the scene's own if not given.
    recording : FringeRecording
        Of the frames of the patterns; those with the lamp, which is as bright as suits, are exposed
        automatically.
    pitch_mm : float, optional
        From mark to mark; by default such that the marks fill the field of view.
    lift_mm : float
        Of the target towards the devices, clear of the part.
    """

    codec: str | Codec = "phase 4 16,128,1280 uv"
    target: str = "checkerboard"
    poses: int = 12
    distortion: int = 4
    hot: bool = False
    spp: int | None = None
    recording: FringeRecording = field(default_factory=FringeRecording)
    pitch_mm: float | None = None
    lift_mm: float = 0.0


@dataclass(frozen=True)
class EstimatedNumber(Record):
    """A parameter as it was found, beside the truth.

    Attributes
    ----------
    name : str
        Its unit is at the end.
    value, truth, sigma, error : float
        As found; as the scene has it; standard deviation by the fit; found less truth.
    sigmas : float
        The error by its standard deviation.
    """

    name: str
    value: float
    truth: float
    sigma: float
    error: float
    sigmas: float


@dataclass(frozen=True)
class TargetPoseFacts(Record):
    """The target in one of its poses.

    Attributes
    ----------
    position_mm : tuple of float
        Of its middle, in the scene's world.
    tilt_deg : float
        Of its face from the middle between camera and projector.
    marks : dict
        How many of its marks have each status.
    camera_rms_px, projector_rms_px : float
        Of its marks from where the fit has them; NaN where the pose took no part.
    """

    position_mm: tuple[float, float, float]
    tilt_deg: float
    marks: dict[str, int]
    camera_rms_px: float
    projector_rms_px: float


@dataclass(frozen=True)
class CalibrationSummary(SceneFacts):
    """A calibration by rendered frames, beside the truth.

    Attributes
    ----------
    target : str
        Its kind: "checkerboard" or "dots".
    columns, rows : int
        Its marks.
    pitch_mm : float
        From mark to mark.
    codec : str
        Of the patterns.
    hot : bool
        Whether the part's hot air was there.
    frames : int
        That were rendered.
    electrons : float or None
        Of the brightest pixel; None: frames without noise.
    bits : int or None
        Of the camera's grey values; None: they are not rounded.
    seed : int
        Of the noise.
    sensor : str or None
        Name of the image sensor that recorded them, "usual" of the one that is taken by default;
        None of frames without noise.
    exposure_s : float or None
        Exposure time; None of a pinhole, which has none.
    marks : dict
        How many marks of all poses have each status.
    camera_rms_px, projector_rms_px : float
        Root of the mean squared distance between marks and where the fit has them.
    camera_error_px, projector_error_px : float
        The same between marks and where the true devices have them by straight light: of the search
        for marks and of the decoding, cold; hot, of the air too.
    position_error_um : tuple of float
        Of the projector in the camera's frame, x, y, z: found less truth.
    position_sigma_um : tuple of float
        Standard deviations by the fit.
    turn_error_urad : tuple of float
        Of the projector about the camera's axes.
    turn_sigma_urad : tuple of float
        Standard deviations by the fit.
    largest_sigmas : float
        Largest of these six errors by its standard deviation.
    volume_rms_um, volume_largest_um : float
        How far the calibrated devices find the target's marks from where they are, by the true
        pixels of straight light: what the calibration does to a measurement.
    shape_rms_um : float
        What is left of it when all marks are moved as one to where they are: its effect on shapes.
    seen_rms_um, seen_by_truth_rms_um : float
        The same of the pixels as they were seen, by the calibrated and by the true devices.
    estimated : tuple of EstimatedNumber
        All parameters that were fitted.
    poses : tuple of TargetPoseFacts
        The target's.
    time_s : float
        That it took.
    """

    target: str
    columns: int
    rows: int
    pitch_mm: float
    codec: str
    hot: bool
    frames: int
    electrons: float | None
    bits: int | None
    seed: int
    sensor: str | None
    exposure_s: float | None
    marks: dict[str, int]
    camera_rms_px: float
    projector_rms_px: float
    camera_error_px: float
    projector_error_px: float
    position_error_um: tuple[float, ...]
    position_sigma_um: tuple[float, ...]
    turn_error_urad: tuple[float, ...]
    turn_sigma_urad: tuple[float, ...]
    largest_sigmas: float
    volume_rms_um: float
    volume_largest_um: float
    shape_rms_um: float
    seen_rms_um: float
    seen_by_truth_rms_um: float
    estimated: tuple[EstimatedNumber, ...]
    poses: tuple[TargetPoseFacts, ...]
    time_s: float


@dataclass(frozen=True)
class CalibrationMarks(Table):
    """The marks of the target in all its poses.

    Attributes
    ----------
    pose, mark : ndarray of shape (N,)
        Numbers from 0.
    status : ndarray of shape (N,)
        `MarkStatus`.
    target_mm : ndarray of shape (N, 3)
        On the target.
    camera_px, projector_px : ndarray of shape (N, 2)
        As found.
    camera_residual_px, projector_residual_px : ndarray of shape (N, 2)
        Found less fitted.
    camera_error_px, projector_error_px : ndarray of shape (N, 2)
        Found less where the true devices have them by straight light.
    """

    pose: NDArray[np.int64]
    mark: NDArray[np.int64]
    status: NDArray[np.str_]
    target_mm: Array
    camera_px: Array
    projector_px: Array
    camera_residual_px: Array
    projector_residual_px: Array
    camera_error_px: Array
    projector_error_px: Array


@dataclass(frozen=True)
class PoseFrames(Displayed):
    """What was recorded of the target in one of its poses.

    Attributes
    ----------
    lit : ndarray of shape (H, W)
        By the lamp.
    patterns : ndarray of shape (K, H, W)
        By the projector.
    metadata : tuple of Mapping
        Of the one and of the others, as their files carry it; empty where nothing is recorded.
    """

    lit: NDArray[Any]
    patterns: NDArray[Any]
    metadata: tuple[Mapping[str, Any], Mapping[str, Any]] = field(default=({}, {}), repr=False)


@dataclass(frozen=True)
class VirtualCalibration(Displayed):
    """A calibration by rendered frames.

    Attributes
    ----------
    scene : Scene
    target : CalibrationTarget
    calibration : FringeCalibration
        In the scene's world: its camera stands where the scene's does.
    marks : CalibrationMarks
    summary : CalibrationSummary
    first : PoseFrames
        The frames of the first pose.
    """

    scene: Scene
    target: CalibrationTarget
    calibration: FringeCalibration
    marks: CalibrationMarks
    summary: CalibrationSummary
    first: PoseFrames

    def _line(self) -> str:
        rms = f"rms {self.summary.camera_rms_px:.3g} and {self.summary.projector_rms_px:.3g} px"
        return listed(self.scene.path.name, f"{len(self.summary.poses)} poses", rms)


def calibrate_scene(
    scene: Scene,
    settings: CalibrationSettings,
    report: Report = lambda stage, fraction: None,
    keep: Callable[[int, PoseFrames], None] | None = None,
) -> VirtualCalibration:
    """Render a target in several poses, find its marks, and calibrate camera and projector.

    Parameters
    ----------
    scene : Scene
        With one camera and one projector.
    settings : CalibrationSettings
    report : callable
        Called with what is being done, and the fraction that is done.
    keep : callable, optional
        Is given each pose's number and frames.

    Raises
    ------
    InputError
        If the scene has no projector, or its devices can't be calibrated so.
    """
    started = time.perf_counter()
    camera, projector = scene.camera, scene.projector
    if not isinstance(projector.family, Pinhole):
        raise InputError(f"{scene.path}: a projector that is no pinhole can't be calibrated so")
    if settings.hot and scene.medium is None:
        raise InputError(f"{scene.path}: --hot: the scene has no hot air; give it a field")
    codec = codec_of(settings.codec, projector.size)
    _check(settings, codec)
    truth = camera, projector.family
    target = target_for(truth, settings)
    poses = target_poses(truth, settings.poses, settings.lift_mm)
    scene = scene if settings.hot else scene.cold()
    found: list[tuple[Marks, Marks]] = []
    first: PoseFrames | None = None
    with plate_scenes(scene, target.drawn(), target.size_mm) as plates:
        for number, pose in enumerate(poses):
            stage = f"target in pose {number + 1} of {len(poses)}"

            def part(fraction: float, stage: str = stage, number: int = number) -> None:
                report(stage, 0.02 + 0.93 * (number + fraction) / len(poses))

            part(0.0)
            frames, decoded, recorded = _recorded(plates, pose, codec, settings, number, part)
            if keep:
                keep(number, frames)
            first = first or frames
            seen = find_marks(frames.lit, target, camera.project(pose.to_world(target.points_mm)))
            lit = projector_marks(seen, target, decoded.column, decoded.row)
            found.append((seen, lit))
    report("calibrating", 0.96)
    seen_px, lit_px = (np.stack([each[i].pixel for each in found]) for i in range(2))
    status = np.stack([lit.status for _, lit in found])
    calibration = calibrate_fringes(
        target.points_mm,
        seen_px,
        lit_px,
        camera.size,
        projector.size,
        distortion=settings.distortion,
        status=status,
    ).placed(camera.pose)
    assert first is not None
    marks = _marks(target, poses, truth, calibration, (seen_px, lit_px))
    frames_each = len(first.patterns) + 1
    notes = [*scene.loading_notes, *_notes(calibration)]
    if settings.hot:
        notes.append(
            "the target stands in the air of the part, which is not there; within the part's place"
            " the field continues it (--lift moves the target clear of it)"
        )
    facts = scene_facts(scene, tuple(notes))
    if settings.spp:
        facts = replace(facts, made_with=replace(facts.made_with, samples_per_pixel=settings.spp))
    summary = CalibrationSummary(
        **vars(facts),
        target=target.kind,
        columns=target.columns,
        rows=target.rows,
        pitch_mm=target.pitch_mm,
        codec=codec.text,
        hot=settings.hot,
        frames=frames_each * len(poses),
        **recorded,
        marks=counts_of(calibration.status, MarkStatus),
        camera_rms_px=calibration.camera_rms_px,
        projector_rms_px=calibration.projector_rms_px,
        camera_error_px=_length_rms(marks.camera_error_px),
        projector_error_px=_length_rms(marks.projector_error_px),
        **_beside_truth(truth, calibration),
        **_effects(target, poses, truth, calibration, (seen_px, lit_px)),
        poses=_pose_facts(truth, poses, calibration),
        time_s=round(time.perf_counter() - started, 2),
    )
    return VirtualCalibration(scene, target, calibration, marks, summary, first)


def _check(settings: CalibrationSettings, codec: Codec) -> None:
    """Refuse beforehand what would fail once all frames are rendered."""
    whole_number("--poses", settings.poses, 3, 200)
    number_within("--lift", settings.lift_mm, -1e4, 1e4, "mm towards the devices")
    if settings.distortion not in COUNTS:
        known = ", ".join(map(str, COUNTS))
        raise InputError(f"--distortion {settings.distortion}: give one of {known}")
    if sorted(codec.axes) != ["u", "v"]:
        raise InputError(
            f"--codec '{codec.text}': has no patterns along both axes, which a calibration"
            " needs; say uv"
        )


# ------------------------------------------------------------------------ target and poses


def _frame(truth: tuple[Pinhole, Pinhole]) -> Pose:
    """Of a target that faces both devices where their axes are nearest: x along the camera's u."""
    middle = meeting_mm(*truth)
    if not np.isfinite(middle).all():
        raise InputError("fringes calibrate: camera and projector look the same way; turn one")
    z = truth[0].pose.rotation[:, 2] + truth[1].pose.rotation[:, 2]
    z /= np.linalg.norm(z)
    x = truth[0].pose.rotation[:, 0]
    x = x - z * (x @ z)
    x /= np.linalg.norm(x)
    return Pose(np.column_stack([x, np.cross(z, x), z]), middle)


def target_for(truth: tuple[Pinhole, Pinhole], settings: CalibrationSettings) -> CalibrationTarget:
    """A target whose marks fill what camera and projector both see."""
    target = CalibrationTarget(settings.target)
    if settings.pitch_mm is not None:
        number_within("--pitch", settings.pitch_mm, 1e-3, 1e5, "mm from mark to mark, positive")
        return CalibrationTarget(settings.target, pitch_mm=settings.pitch_mm)
    frame = _frame(truth)
    fields = []
    for device in truth:
        middle, x, y = device.project(frame.to_world([[0, 0, 0], [1, 0, 0], [0, 1, 0]]))
        by = np.abs(np.stack([x - middle, y - middle]))  # px/mm, of u and v
        fields.append((np.array(device.size) / np.maximum(by, 1e-9)).min(axis=1))
    across = float(np.min(fields))
    pitch = _FILLED * across / (max(target.columns, target.rows) - 1)
    return CalibrationTarget(settings.target, pitch_mm=float(f"{pitch:.2g}"))


def target_poses(truth: tuple[Pinhole, Pinhole], count: int, lift_mm: float = 0.0) -> list[Pose]:
    """Poses of a target where camera and projector look: tilted, turned, nearer and farther."""
    frame = _frame(truth)
    between = truth[0].pose.axes_angle_deg(truth[1].pose)
    steepest = min(_MOST_TILT_DEG, _STEEPEST_DEG - between / 2.0)
    if steepest < 5.0:
        raise InputError(
            f"fringes calibrate: camera and projector stand at {between:.3g} degrees to each other:"
            " no target can be tilted so that both see it; bring them nearer together"
        )
    away = float(np.linalg.norm(frame.origin_mm - truth[0].pose.origin_mm))
    poses = []
    for number in range(count):
        tilt = steepest * (_TILTS[number % len(_TILTS)] if number else 0.0)
        about = np.radians(number * _GOLDEN_DEG)
        turned = Pose.turn(tilt, (np.cos(about), np.sin(about), 0.0)).rotation
        turned = turned @ Pose.turn(90.0 * (number % 4) if number else 0.0, (0, 0, 1)).rotation
        deep = _DEEP * away * ((number * 0.618034) % 1.0 - 0.5) * 2.0 if number else 0.0
        place = frame.to_world([[0.0, 0.0, deep - lift_mm]])[0]
        poses.append(Pose(frame.rotation @ turned, place))
    return poses


# ------------------------------------------------------------------------------ the frames


def _recorded(
    plates: PlateScenes,
    pose: Pose,
    codec: Codec,
    settings: CalibrationSettings,
    number: int,
    part: Callable[[float], None],
) -> tuple[PoseFrames, Any, dict[str, Any]]:
    """The frames of the target in a pose, and what the patterns decode to, and how recorded."""
    from virtual_sensor.imaging.render import render
    from virtual_sensor.imaging.sequence import render_sequence

    lit = render(plates.at(pose, _LAMP_W_MM2), settings.spp)
    part(0.2)
    scene = plates.at(pose)
    shown = render_sequence(
        scene,
        codec.patterns,
        spp=settings.spp,
        progress=lambda done: part(0.2 + 0.6 * done),
    )
    part(0.85)
    recording = settings.recording
    lamp = replace(recording, exposure=None if recording.exposure is None else AUTO)
    of_lamp = lamp.shot(scene, lit, number, "lamp")
    of_patterns = recording.shot(scene, shown, number, "patterns")
    decoded = recording.decoded(codec, of_patterns, edges=False)
    said = getattr(of_lamp, "metadata", {}), getattr(of_patterns, "metadata", {})
    frames = PoseFrames(np.asarray(of_lamp), np.asarray(of_patterns), said)
    return frames, decoded, recording.facts(of_patterns)


# ------------------------------------------------------------------------- beside the truth


def _marks(
    target: CalibrationTarget,
    poses: list[Pose],
    truth: tuple[Pinhole, Pinhole],
    calibration: FringeCalibration,
    found: tuple[Array, Array],
) -> CalibrationMarks:
    points = target.points_mm
    true = [np.stack([d.project(pose.to_world(points)) for pose in poses]) for d in truth]
    pose, mark = np.divmod(np.arange(len(poses) * len(points)), len(points))
    rows = [
        *found,
        calibration.camera_residual_px,
        calibration.projector_residual_px,
        *(each - at for each, at in zip(found, true, strict=True)),
    ]
    names = status_names(calibration.status, MarkStatus)
    columns = [np.asarray(each).reshape(-1, 2) for each in rows]
    return CalibrationMarks(pose, mark, names, points[mark], *columns)


def _beside_truth(truth: tuple[Pinhole, Pinhole], calibration: FringeCalibration) -> dict[str, Any]:
    """The parameters that were found, their standard deviations and errors."""
    camera, projector = truth
    true: dict[str, float] = {}
    value: dict[str, float] = {}
    for name, real, known in (
        ("camera", camera, calibration.camera),
        ("projector", projector, calibration.projector),
    ):
        for of, device in ((true, real), (value, known)):
            K, lens = device.matrix, np.pad(device.distortion, (0, 14 - device.distortion.size))
            each = (K[0, 0], K[1, 1], K[0, 2], K[1, 2])
            keys = ("f_x_px", "f_y_px", "c_x_px", "c_y_px")
            of |= {f"{name}_{k}": float(v) for k, v in zip(keys, each, strict=True)}
            of |= {f"{name}_{k}": float(v) for k, v in zip(COEFFICIENTS, lens[:12], strict=True)}
    # In the camera's frame, wherever the cameras stand.
    real_pose, pose = (
        _within(c.pose, p.pose) for c, p in (truth, (calibration.camera, calibration.projector))
    )
    turn = turn_between(real_pose, pose)
    for i, axis in enumerate("xyz"):
        true[f"projector_{axis}_mm"] = float(real_pose.origin_mm[i])
        value[f"projector_{axis}_mm"] = float(pose.origin_mm[i])
        true[f"projector_turn_{axis}_rad"] = 0.0
        value[f"projector_turn_{axis}_rad"] = float(turn[i])
    numbers = []
    for name, sigma in calibration.sigma.items():
        error = value[name] - true[name]
        numbers.append(
            EstimatedNumber(name, value[name], true[name], sigma, error, abs(error) / sigma)
        )
    place, turns = numbers[-6:-3], numbers[-3:]
    return {
        "position_error_um": tuple(UM_PER_MM * n.error for n in place),
        "position_sigma_um": tuple(UM_PER_MM * n.sigma for n in place),
        "turn_error_urad": tuple(_URAD * n.error for n in turns),
        "turn_sigma_urad": tuple(_URAD * n.sigma for n in turns),
        "largest_sigmas": max(n.sigmas for n in (*place, *turns)),
        "estimated": tuple(numbers),
    }


def _within(frame: Pose, pose: Pose) -> Pose:
    """A pose in another frame than the world's."""
    return Pose(frame.rotation.T @ pose.rotation, frame.to_local(pose.origin_mm))


def _effects(
    target: CalibrationTarget,
    poses: list[Pose],
    truth: tuple[Pinhole, Pinhole],
    calibration: FringeCalibration,
    found: tuple[Array, Array],
) -> dict[str, Any]:
    """What the calibration does to points: distances of the marks from where they are."""
    devices = calibration.camera, calibration.projector
    places = np.concatenate([pose.to_world(target.points_mm) for pose in poses])
    true_px = tuple(device.project(places) for device in truth)
    seen_px = tuple(each.reshape(-1, 2) for each in found)

    def points(by: tuple[Pinhole, Pinhole], pixel: tuple[Array, ...]) -> Array:
        rays = [d.rays(*d.of_pixels(p)) for d, p in zip(by, pixel, strict=True)]
        return nearest_points(rays[0][0], rays[1][0], rays[0][1], rays[1][1])[0]

    inside = np.all([d.inside(p) for d, p in zip(truth, true_px, strict=True)], axis=0)
    straight, where = points(devices, true_px)[inside], places[inside]
    off_um = UM_PER_MM * (straight - where)
    turn, _ = Rotation.align_vectors(where - where.mean(axis=0), straight - straight.mean(axis=0))
    moved = turn.apply(straight - straight.mean(axis=0)) + where.mean(axis=0)
    return {
        "volume_rms_um": _length_rms(off_um),
        "volume_largest_um": float(np.linalg.norm(off_um, axis=1).max()),
        "shape_rms_um": _length_rms(UM_PER_MM * (moved - where)),
        "seen_rms_um": _length_rms(UM_PER_MM * (points(devices, seen_px) - places)),
        "seen_by_truth_rms_um": _length_rms(UM_PER_MM * (points(truth, seen_px) - places)),
    }


def _pose_facts(
    truth: tuple[Pinhole, Pinhole], poses: list[Pose], calibration: FringeCalibration
) -> tuple[TargetPoseFacts, ...]:
    frame = _frame(truth)
    facts = []
    for number, pose in enumerate(poses):
        tilt = pose.axes_angle_deg(frame)
        x, y, height = pose.origin_mm.tolist()
        marks = counts_of(calibration.status[number], MarkStatus)
        of_pose = (calibration.camera_residual_px, calibration.projector_residual_px)
        camera_px, projector_px = (_length_rms(each[number]) for each in of_pose)
        facts.append(TargetPoseFacts((x, y, height), tilt, marks, camera_px, projector_px))
    return tuple(facts)


def _length_rms(vectors: Array) -> float:
    """Root of the mean squared length of vectors (N, K); NaN of none."""
    return rms(euclidean(vectors))


def _notes(calibration: FringeCalibration) -> list[str]:
    notes = [*calibration.notes]
    lost = calibration.status[calibration.status != MarkStatus.FOUND]
    if words := counts_in_words(counts_of(lost, MarkStatus)):
        notes.append(f"marks that took no part, or of the camera alone: {words}")
    return notes
