"""Camera and projector from a planar target in several poses: OpenCV's models, one joint fit.

A projector is a camera turned round: its pixel at a mark of the target comes from the phases of its
patterns there (`target.projector_marks`), and then both are calibrated alike.  OpenCV's
`calibrateCamera` gives a start for each; all parameters are then fitted to all marks at once, by
Levenberg and Marquardt's method with the derivatives of OpenCV's `projectPoints`.  Unlike
`stereoCalibrate`, whose minimum it is where every mark has both pixels and both are as good, the
fit takes marks that only the camera sees, weights camera and projector by their own residuals, and
has a covariance.
"""

from __future__ import annotations

from dataclasses import dataclass, field, replace
from pathlib import Path
from typing import Any, ClassVar

import cv2
import numpy as np
from numpy.typing import ArrayLike, NDArray
from scipy.optimize import least_squares
from scipy.spatial.transform import Rotation

from virtual_sensor.arrays import numbers_of, points_of, size_of
from virtual_sensor.calls import public
from virtual_sensor.devices.calibration_files import (
    LARGEST_PX,
    distortion_row,
    put_camera,
    read_camera_and_projector,
)
from virtual_sensor.display import Displayed, listed
from virtual_sensor.errors import InputError, short
from virtual_sensor.files import path_of, written_whole
from virtual_sensor.metrology.covariance import SIGMA_BY_MEDIAN, carried
from virtual_sensor.metrology.fringes.target import MarkStatus
from virtual_sensor.optics.ray_families import Pinhole
from virtual_sensor.poses import Pose

Array = NDArray[np.float64]

COEFFICIENTS = ("k_1", "k_2", "p_1", "p_2", "k_3", "k_4", "k_5", "k_6", "s_1", "s_2", "s_3", "s_4")
"""Of a distortion, in OpenCV's order."""

COUNTS = (0, 1, 2, 4, 5, 8, 12)
"""How many of them may be fitted."""

_LEAST_VIEWS, _LEAST_MARKS = 3, 6
_UNDETERMINED = 1e9  # condition of the scaled Jacobian from which on the poses leave a choice
_MOST_DOUBT = 0.02  # standard deviation of a focal length, relative
_OUTLIER = 6.0  # robust standard deviations
_NEAR_PX = 0.05  # nothing nearer is an outlier, however exact the others are
_LEAST_PX = 1e-6  # residuals below are rounding: they give no weight
_ROUNDS = 6  # of weights and outliers
_STEADY = 0.02  # change of the weights that ends them
_PARALLEL = 1e-12
_TINY = 1e-6  # rad and mm, for differences of poses


@public
@dataclass(frozen=True)
class FringeCalibration(Displayed):
    """A camera and a projector in one world, with the covariance of what was found.

    Attributes
    ----------
    camera : Pinhole
        Of a calibration its frame is the world, unless it was `placed`.
    projector : Pinhole
        Its rays run the other way; pixels (u, v) as a camera's.
    covariance : ndarray of shape (P, P)
        Of the parameters that were fitted: intrinsic ones of both, then the projector's place in
        the camera's frame, mm, and its turns about the camera's axes, rad.  Empty: not known.
    parameters : tuple of str
        Their names, such as "camera_f_x_px", "projector_k_1", "projector_z_mm".
    camera_rms_px, projector_rms_px : float
        Root of the mean squared distance between marks and where they are found.
    target_pose : tuple of Pose
        The target's, in the camera's frame; empty where a file was read.
    status : ndarray of shape (V, N)
        `MarkStatus` of the target's N marks in its V poses.
    camera_residual_px, projector_residual_px : ndarray of shape (V, N, 2)
        Found minus fitted; NaN where a mark took no part.
    notes : tuple of str
    """

    _statuses: ClassVar = {"status": MarkStatus}

    camera: Pinhole
    projector: Pinhole
    covariance: Array
    parameters: tuple[str, ...] = ()
    camera_rms_px: float = np.nan
    projector_rms_px: float = np.nan
    target_pose: tuple[Pose, ...] = ()
    status: NDArray[np.uint8] = field(default_factory=lambda: np.zeros((0, 0), np.uint8))
    camera_residual_px: Array = field(default_factory=lambda: np.zeros((0, 0, 2)))
    projector_residual_px: Array = field(default_factory=lambda: np.zeros((0, 0, 2)))
    notes: tuple[str, ...] = ()

    def _line(self) -> str:
        apart = float(np.linalg.norm(self.baseline_mm))
        poses = f"{len(self.target_pose)} poses" if self.target_pose else ""
        rms = f"rms {self.camera_rms_px:.3g} and {self.projector_rms_px:.3g} px"
        angle = f"{self.triangulation_angle_deg:.4g}° between their axes"
        rms = rms if np.isfinite(self.camera_rms_px) else ""
        return listed(f"camera and projector {apart:.6g} mm apart", angle, poses, rms)

    @property
    def baseline_mm(self) -> Array:
        """The projector's place in the camera's frame, (3,)."""
        return self.camera.pose.to_local(self.projector.pose.origin_mm)

    @property
    def triangulation_angle_deg(self) -> float:
        """Angle between the two axes."""
        return self.camera.pose.axes_angle_deg(self.projector.pose)

    @property
    def sigma(self) -> dict[str, float]:
        """Standard deviations of the parameters, by their names."""
        spread = np.sqrt(np.diag(self.covariance))
        return dict(zip(self.parameters, spread.tolist(), strict=True))

    @staticmethod
    def read(
        path: str | Path,
        camera_size: tuple[int, int] | None = None,
        projector_size: tuple[int, int] | None = None,
    ) -> FringeCalibration:
        """Read a file of OpenCV's: YAML, XML or JSON.

        Parameters
        ----------
        path : str or Path
        camera_size, projector_size : pair of int, optional
            Width and height, px, where the file does not have them, as many programs' files don't.

        Raises
        ------
        InputError
            Naming the file, the element and what it should be.
        """
        path = path_of("FringeCalibration.read: path", path)
        if camera_size is not None:
            camera_size = size_of("FringeCalibration.read: camera_size", camera_size, LARGEST_PX)
        if projector_size is not None:
            name = "FringeCalibration.read: projector_size"
            projector_size = size_of(name, projector_size, LARGEST_PX)
        camera, projector, file = read_camera_and_projector(path, camera_size, projector_size)
        camera_rms, projector_rms = (
            float(file.numbers(f"{name}_rms_px", (1,), np.array([np.nan]))[0])
            for name in ("camera", "projector")
        )
        words = file.find("parameters") or ""
        names = tuple(words if isinstance(words, list) else f"{words}".split())
        held = file.numbers("covariance", (len(names) ** 2,), np.zeros(0), most=len(names) ** 2)
        covariance = held.reshape(len(names), len(names)) if held.size else np.zeros((0, 0))
        names = names if held.size else ()
        notes = file.all_notes()
        rms = camera_rms, projector_rms
        return FringeCalibration(camera, projector, covariance, names, *rms, notes=notes)

    def write(self, path: str | Path) -> Path:
        """Write a file of OpenCV's, YAML, XML or JSON by its ending, whole or not at all.

        ===========================  ============================================================
        image_width, _height         of the camera, px
        camera_matrix,               K and OpenCV's coefficients of the camera
        distortion_coefficients
        rotation, translation        from the world to the camera, mm
        projector_width, _height     px
        projector_matrix,            the same of the projector
        projector_distortion
        projector_rotation,          from the camera to the projector, R and T of `stereoCalibrate`
        projector_translation
        camera_rms_px,               of the marks
        projector_rms_px
        parameters, covariance       names with spaces between, and their covariance
        ===========================  ============================================================

        Raises
        ------
        InputError
            If it can't be written.
        """
        path = path_of("FringeCalibration.write: path", path)
        if path.suffix.lower() not in (".yaml", ".yml", ".xml", ".json"):
            raise InputError(f"{path}: a calibration is written as .yaml, .yml, .xml or .json")
        storage = cv2.FileStorage(path.name, cv2.FILE_STORAGE_WRITE | cv2.FILE_STORAGE_MEMORY)
        put_camera(storage, self.camera)
        camera, projector = self.camera.pose, self.projector
        turn = projector.pose.rotation.T @ camera.rotation
        storage.write("projector_width", projector.size[0])
        storage.write("projector_height", projector.size[1])
        storage.write("projector_matrix", projector.matrix)
        storage.write("projector_distortion", distortion_row(projector))
        storage.write("projector_rotation", np.ascontiguousarray(turn))
        storage.write("projector_translation", -(turn @ self.baseline_mm))
        if np.isfinite(self.camera_rms_px):
            storage.write("camera_rms_px", self.camera_rms_px)
            storage.write("projector_rms_px", self.projector_rms_px)
        if self.parameters:
            storage.write("parameters", " ".join(self.parameters))
            storage.write("covariance", self.covariance)
        text = str(storage.releaseAndGetString())
        with written_whole(path) as temporary:
            temporary.write_text(text, encoding="utf-8")
        return path

    def placed(self, camera_pose: Pose) -> FringeCalibration:
        """The same in a world where the camera stands at another place."""
        before = self.camera.pose
        turn = camera_pose.rotation @ before.rotation.T
        motion = Pose(turn, camera_pose.origin_mm - turn @ before.origin_mm)
        projector = self.projector.with_pose(self.projector.pose.moved(motion))
        return replace(self, camera=self.camera.with_pose(camera_pose), projector=projector)


@public
def calibrate_fringes(
    target_mm: ArrayLike,
    camera_px: ArrayLike,
    projector_px: ArrayLike,
    camera_size: tuple[int, int],
    projector_size: tuple[int, int],
    *,
    distortion: int = 4,
    projector_distortion: int | None = None,
    status: ArrayLike | None = None,
) -> FringeCalibration:
    """Calibrate camera and projector by the marks of a plane in several poses.

    Parameters
    ----------
    target_mm : array_like of shape (N, 3)
        The marks on the target, z = 0: `CalibrationTarget.points_mm`.
    camera_px : array_like of shape (V, N, 2)
        (u, v) of the marks in V poses of the target, as `find_marks` gives them; NaN where a mark
        was not found.
    projector_px : array_like of shape (V, N, 2)
        The projector's pixels there, as `projector_marks` gives them; NaN where there is none.
    camera_size, projector_size : pair of int
        Width and height, px.
    distortion : int
        How many of OpenCV's coefficients k_1, k_2, p_1, p_2, k_3, ... are fitted for the camera:
        0, 1, 2, 4, 5, 8 or 12; the others are 0.  Each more of them makes focal length, principal
        point and pose less certain where the field of view is narrow.
    projector_distortion : int, optional
        The same for the projector; by default as many.
    status : array_like of shape (V, N), optional
        `MarkStatus` of marks that were not found, to be handed on.

    Returns
    -------
    FringeCalibration
        In the camera's frame.

    Raises
    ------
    InputError
        If shapes don't fit, there are too few marks or poses, or these leave a choice.
    """
    points = points_of("calibrate_fringes: target_mm", target_mm)
    seen = points_of("calibrate_fringes: camera_px", camera_px, 2)
    lit = points_of("calibrate_fringes: projector_px", projector_px, 2)
    shaped = points.ndim == 2 and points.shape[1] == 3 and len(points) >= _LEAST_MARKS
    if not shaped or not np.isfinite(points).all():
        raise InputError(
            f"calibrate_fringes: target_mm has the shape {points.shape}; give finite numbers (N, 3)"
            f" of {_LEAST_MARKS} marks or more"
        )
    if np.ptp(points[:, 2]) > 0.0:
        raise InputError("calibrate_fringes: target_mm is no plane z = 0; give a planar target")
    for name, pixels in (("camera_px", seen), ("projector_px", lit)):
        if pixels.ndim != 3 or pixels.shape[1:] != (len(points), 2) or len(pixels) != len(seen):
            raise InputError(
                f"calibrate_fringes: {name} has the shape {pixels.shape}; give it"
                f" (poses, {len(points)}, 2)"
            )
    if projector_distortion is None:
        projector_distortion = distortion
    free = distortion, projector_distortion
    for name, count in zip(("distortion", "projector_distortion"), free, strict=True):
        if type(count) is not int or count not in COUNTS:
            known = ", ".join(map(str, COUNTS))
            raise InputError(f"calibrate_fringes: {name} is {short(count)}; give one of {known}")
    sizes = (
        size_of("calibrate_fringes: camera_size", camera_size, LARGEST_PX),
        size_of("calibrate_fringes: projector_size", projector_size, LARGEST_PX),
    )
    found = _statuses(seen, lit, status)
    used, notes = _poses_used(found)
    problem = _Problem(points, seen[used], lit[used], free, found[used])
    fit = _fitted(problem, _start(problem, sizes))
    focal = [0, 1, 4 + distortion, 5 + distortion]
    doubt = float(np.max(np.sqrt(np.diag(fit.covariance)[focal]) / np.abs(fit.x[focal])))
    if not doubt < _MOST_DOUBT:
        raise _undetermined(f"focal lengths would be known to {100.0 * doubt:.2g} % only")
    all_status, residuals = found.copy(), np.full((2, *seen.shape), np.nan)
    all_status[used] = fit.problem.status
    residuals[:, used] = fit.problem.by_mark(fit.problem.residuals(fit.x))
    outliers = int(np.sum(all_status == MarkStatus.OUTLIER))
    if outliers:
        notes.append(
            f"{outliers} of {int(np.sum(np.isfinite(seen[..., 0])))} marks are over {_OUTLIER:g}"
            " standard deviations off and were left out"
        )
    return _calibration(fit, sizes, all_status, residuals, tuple(notes))


def _statuses(seen: Array, lit: Array, status: ArrayLike | None) -> NDArray[np.uint8]:
    """Of marks, by what is finite; a status that is given says why a mark is not."""
    no_camera, no_projector = (~np.isfinite(pixels).all(axis=2) for pixels in (seen, lit))
    given = np.zeros(no_camera.shape)
    if status is not None:
        given = numbers_of("calibrate_fringes: status", status)
    if given.shape != no_camera.shape:
        raise InputError(
            f"calibrate_fringes: status has the shape {given.shape}; give {no_camera.shape}"
        )
    unseen = np.where(given == MarkStatus.FOUND, MarkStatus.NOT_FOUND, given)
    dark = np.where(given == MarkStatus.FOUND, MarkStatus.NO_PHASE, given)
    found = np.where(no_projector, dark, MarkStatus.FOUND)
    return np.where(no_camera, unseen, found).astype(np.uint8)


def _seen(status: NDArray[np.uint8]) -> NDArray[np.bool_]:
    """Marks whose camera pixel takes part."""
    return np.isin(status, (MarkStatus.FOUND, MarkStatus.NO_PHASE))


def _poses_used(status: NDArray[np.uint8]) -> tuple[NDArray[np.intp], list[str]]:
    """The poses with enough marks of both, and notes of the others."""
    both = np.sum(status == MarkStatus.FOUND, axis=1)
    used = np.flatnonzero(both >= _LEAST_MARKS)
    notes = [
        f"pose {number} of the target is left out: {count} of its marks have a pixel of camera and"
        f" projector, fewer than {_LEAST_MARKS}"
        for number, count in enumerate(both)
        if count < _LEAST_MARKS
    ]
    if len(used) < _LEAST_VIEWS:
        raise InputError(
            f"calibrate_fringes: {len(used)} poses of the target have {_LEAST_MARKS} marks or more"
            f" that camera and projector see; give at least {_LEAST_VIEWS}, tilted differently"
        )
    return used, notes


# ------------------------------------------------------------------------------- the fit


@dataclass(frozen=True)
class _Problem:
    """Marks, and what of the two devices is fitted.

    The unknowns are f_x, f_y, c_x, c_y and the distortion of camera and projector; rotation vector
    and translation from camera to projector; and those from the target to the camera, by poses.
    """

    points: Array
    seen: Array
    lit: Array
    free: tuple[int, int]
    status: NDArray[np.uint8]
    sigma: tuple[float, float] = (1.0, 1.0)

    @property
    def devices(self) -> tuple[slice, slice]:
        """Where the intrinsic parameters of camera and projector are among the unknowns."""
        camera = 4 + self.free[0]
        return slice(0, camera), slice(camera, camera + 4 + self.free[1])

    @property
    def common(self) -> int:
        """How many unknowns there are beside the target's poses."""
        return self.devices[1].stop + 6

    def rows(self) -> tuple[NDArray[np.bool_], NDArray[np.bool_]]:
        """Marks (V, N) whose pixels of camera and of projector take part."""
        return _seen(self.status), self.status == MarkStatus.FOUND

    def residuals(self, x: Array) -> Array:
        """Found minus fitted by sigma, of all marks that take part."""
        return self._evaluated(x)[0]

    def jacobian(self, x: Array) -> Array:
        """Their derivatives by the unknowns."""
        return self._evaluated(x)[1]

    def by_mark(self, residuals: Array) -> Array:
        """Residuals in px (2, V, N, 2) of camera and projector; NaN where one takes no part."""
        found = np.full((2, *self.seen.shape), np.nan)
        rows = np.stack(self.rows())
        # As `_evaluated` has them: by poses, the camera before the projector.
        order = np.moveaxis(rows, 1, 0)
        by_pose = np.full((*order.shape, 2), np.nan)
        by_pose[order] = residuals.reshape(-1, 2)
        found[:] = np.moveaxis(by_pose, 0, 1)
        return found * np.reshape(self.sigma, (2, 1, 1, 1))

    def _evaluated(self, x: Array) -> tuple[Array, Array]:
        camera, projector = self.devices
        between = slice(projector.stop, projector.stop + 6)
        values, derivatives = [], []
        for number, rows in enumerate(zip(*self.rows(), strict=True)):
            own = slice(self.common + 6 * number, self.common + 6 * number + 6)
            pose = x[own]
            composed = cv2.composeRT(pose[:3], pose[3:], x[between][:3], x[between][3:])
            lit_pose = np.concatenate(composed[:2]).ravel()
            by_own = np.block([[composed[2], composed[3]], [composed[6], composed[7]]])
            by_between = np.block([[composed[4], composed[5]], [composed[8], composed[9]]])
            turns = (pose, np.eye(6), None), (lit_pose, by_own, by_between)
            found = self.seen[number], self.lit[number]
            for device, row, pixel, (rt, of_pose, of_between), sigma in zip(
                (camera, projector), rows, found, turns, self.sigma, strict=True
            ):
                fitted, by_rt, by_device = _projected(self.points[row], x[device], rt)
                jacobian = np.zeros((2 * int(row.sum()), x.size))
                jacobian[:, device] = -by_device / sigma
                jacobian[:, own] = -by_rt @ of_pose / sigma
                if of_between is not None:
                    jacobian[:, between] = -by_rt @ of_between / sigma
                values.append((pixel[row] - fitted).ravel() / sigma)
                derivatives.append(jacobian)
        return np.concatenate(values), np.concatenate(derivatives)


def _projected(points: Array, device: Array, rt: Array) -> tuple[Array, Array, Array]:
    """Pixels of points (N, 3), and derivatives (2 N, ...) by the pose and by the device."""
    if not len(points):
        return np.zeros((0, 2)), np.zeros((0, 6)), np.zeros((0, device.size))
    distortion = np.zeros(next(n for n in (4, 5, 8, 12) if n >= device.size - 4))
    distortion[: device.size - 4] = device[4:]
    pixel, by = cv2.projectPoints(points, rt[:3], rt[3:], _matrix(device), distortion)[:2]
    return pixel.reshape(-1, 2), by[:, :6], by[:, 6 : 6 + device.size]


def _matrix(device: Array) -> Array:
    f_x, f_y, c_x, c_y = device[:4]
    return np.array([[f_x, 0.0, c_x], [0.0, f_y, c_y], [0.0, 0.0, 1.0]])


def _start(problem: _Problem, sizes: Any) -> Array:
    """Unknowns to start from: each device by OpenCV, without distortion."""
    devices, poses = [], []
    for pixels, row, size in zip((problem.seen, problem.lit), problem.rows(), sizes, strict=True):
        # Marks that both have: so the poses of both belong together.
        some = row & problem.rows()[1]
        objects = [problem.points[each].astype(np.float32)[:, None] for each in some]
        images = [p[each].astype(np.float32)[:, None] for p, each in zip(pixels, some, strict=True)]
        flags = cv2.CALIB_ZERO_TANGENT_DIST | cv2.CALIB_FIX_K1 | cv2.CALIB_FIX_K2
        flags |= cv2.CALIB_FIX_K3 | cv2.CALIB_FIX_ASPECT_RATIO
        try:
            found = cv2.calibrateCamera(objects, images, size, np.eye(3), np.zeros(5), flags=flags)
        except cv2.error as error:
            raise _undetermined(f"OpenCV finds no start ({error.err or error})") from None
        matrix = found[1]
        if not np.isfinite(matrix).all() or not matrix[0, 0] > 0.0:
            raise _undetermined("OpenCV finds no start")
        devices.append(matrix[[0, 1, 0, 1], [0, 1, 2, 2]])
        poses.append([np.concatenate(rt).ravel() for rt in zip(found[3], found[4], strict=True)])
    turns, shifts = [], []
    for of_camera, of_projector in zip(*poses, strict=True):
        turn = Rotation.from_rotvec(of_projector[:3]) * Rotation.from_rotvec(of_camera[:3]).inv()
        turns.append(turn.as_quat())
        shifts.append(of_projector[3:] - turn.apply(of_camera[3:]))
    between = [Rotation.from_quat(turns).mean().as_rotvec(), np.median(shifts, axis=0)]
    both = [np.append(f_c, np.zeros(n)) for f_c, n in zip(devices, problem.free, strict=True)]
    return np.concatenate([*both, *between, *poses[0]])


@dataclass(frozen=True)
class _Fit:
    problem: _Problem
    x: Array
    covariance: Array


def _fitted(problem: _Problem, x: Array) -> _Fit:
    """Fit again with the weights of the residuals, without outliers, until that is steady."""
    for _ in range(_ROUNDS):
        found = least_squares(
            problem.residuals, x, problem.jacobian, method="lm", x_scale="jac", xtol=1e-12,
            ftol=1e-14, gtol=1e-14, max_nfev=100,
        )  # fmt: skip
        if found.status <= 0:
            raise _undetermined("the fit did not converge")
        x = found.x
        residuals = problem.by_mark(problem.residuals(x))
        size = np.linalg.norm(residuals, axis=3)
        usual = (float(np.nanmedian(np.abs(each))) for each in residuals)
        spread = [max(SIGMA_BY_MEDIAN * each, _LEAST_PX) for each in usual]
        limit = np.maximum(_OUTLIER * np.reshape(spread, (2, 1, 1)), _NEAR_PX)
        far = (size > limit).any(axis=0)
        sigma = _spreads(problem, np.where(far[..., None], np.nan, residuals))
        steady = np.allclose(sigma, problem.sigma, rtol=_STEADY)
        status = np.where(far, MarkStatus.OUTLIER, problem.status).astype(np.uint8)
        problem = replace(problem, sigma=sigma, status=status)
        if steady and not far.any():
            break
    jacobian = problem.jacobian(x)
    length = np.linalg.norm(jacobian, axis=0)
    values = np.linalg.svd(jacobian / length, compute_uv=False)
    if len(jacobian) <= x.size or not values[-1] * _UNDETERMINED > values[0]:
        raise _undetermined("the poses of the target leave a choice")
    scaled = np.linalg.inv((jacobian / length).T @ (jacobian / length))
    return _Fit(problem, x, scaled / np.outer(length, length))


def _spreads(problem: _Problem, residuals: Array) -> tuple[float, float]:
    """Standard deviation of pixels of camera and projector, by residuals (2, V, N, 2).

    Of the unknowns each takes its share of the poses' and all of its own.
    """
    count = np.sum(np.isfinite(residuals), axis=(1, 2, 3))
    poses = problem.common - 6 + 6 * len(problem.seen) + 6
    unknowns = poses * count / count.sum()
    squared = np.nansum(residuals**2, axis=(1, 2, 3))
    spread = np.sqrt(squared / np.maximum(count - unknowns, 1.0))
    camera, projector = np.maximum(spread, _LEAST_PX)
    return float(camera), float(projector)


def _undetermined(why: str) -> InputError:
    return InputError(
        f"calibrate_fringes: {why}; give more poses of the target, tilted by 10 to 30 degrees about"
        " different axes, or fit fewer coefficients (distortion)"
    )


# --------------------------------------------------------------------------- the result


def _calibration(
    fit: _Fit,
    sizes: Any,
    status: NDArray[np.uint8],
    residuals: Array,
    notes: tuple[str, ...],
) -> FringeCalibration:
    """What was found, in the camera's frame."""
    problem, x = fit.problem, fit.x
    both = [x[device] for device in problem.devices]
    rt = x[problem.common - 6 : problem.common]
    poses = Pose(np.eye(3), np.zeros(3)), _inverse(rt)
    camera, projector = (
        Pinhole(_matrix(device), pose, size, _padded(device[4:]))
        for device, pose, size in zip(both, poses, sizes, strict=True)
    )
    count = problem.common
    by = np.eye(count)
    by[-6:, -6:] = _pose_derivatives(rt)
    names = [
        f"{name}_{each}"
        for name, number in zip(("camera", "projector"), problem.free, strict=True)
        for each in ("f_x_px", "f_y_px", "c_x_px", "c_y_px", *COEFFICIENTS[:number])
    ]
    names += [f"projector_{axis}_mm" for axis in "xyz"]
    names += [f"projector_turn_{axis}_rad" for axis in "xyz"]
    rms = np.sqrt(np.nanmean(np.sum(residuals**2, axis=3), axis=(1, 2)))
    targets = x[count:].reshape(-1, 6)
    return FringeCalibration(
        camera,
        projector,
        carried(by, fit.covariance[:count, :count]),
        tuple(names),
        float(rms[0]),
        float(rms[1]),
        tuple(Pose(Rotation.from_rotvec(each[:3]).as_matrix(), each[3:]) for each in targets),
        status,
        residuals[0],
        residuals[1],
        notes,
    )


def _padded(coefficients: Array) -> Array:
    """Coefficients of a distortion, as many as OpenCV's models have."""
    if not coefficients.size:
        return np.zeros(0)
    count = next(n for n in (4, 5, 8, 12) if n >= coefficients.size)
    return np.pad(coefficients, (0, count - coefficients.size))


def _inverse(rt: Array) -> Pose:
    """The pose of a device whose frame world points reach by a rotation vector and a shift."""
    turn = Rotation.from_rotvec(rt[:3]).as_matrix().T
    return Pose(turn, -turn @ rt[3:])


def turn_between(one: Pose, other: Pose) -> Array:
    """The rotation vector (3,), rad, that turns a pose into another, about the world's axes."""
    return np.asarray(Rotation.from_matrix(other.rotation @ one.rotation.T).as_rotvec())


def nearest_points(
    origin: Array, other_origin: Array, direction: Array, other_direction: Array
) -> tuple[Array, Array]:
    """Points half-way between pairs of rays where these are nearest, and how far apart they are.

    Parameters
    ----------
    origin, other_origin, direction, other_direction : ndarray of shape (N, 3)
        mm, and unit vectors.

    Returns
    -------
    point : ndarray of shape (N, 3)
        NaN of parallel rays.
    gap_mm : ndarray of shape (N,)
    """
    between = other_origin - origin
    cosine = np.sum(direction * other_direction, axis=1)
    along, other = (np.sum(between * d, axis=1) for d in (direction, other_direction))
    with np.errstate(all="ignore"):
        sine = np.where(1.0 - cosine**2 > _PARALLEL, 1.0 - cosine**2, np.nan)
        here = (along - cosine * other) / sine
        there = (cosine * along - other) / sine
    one = origin + here[:, None] * direction
    two = other_origin + there[:, None] * other_direction
    return (one + two) / 2.0, np.linalg.norm(two - one, axis=1)


def meeting_mm(camera: Pinhole, projector: Pinhole) -> Array:
    """Where two devices' axes are nearest to each other, world (3,); NaN if they are parallel."""
    origins = (each.pose.origin_mm[None] for each in (camera, projector))
    axes = (each.pose.rotation[:, 2][None] for each in (camera, projector))
    point: Array = nearest_points(*origins, *axes)[0][0]
    return point


def _pose_derivatives(rt: Array) -> Array:
    """Derivatives (6, 6) of a device's place and turns by rotation vector and shift."""
    middle = _inverse(rt)

    def change(step: Array) -> Array:
        moved = _inverse(rt + step)
        return np.append(moved.origin_mm - middle.origin_mm, turn_between(middle, moved))

    columns = [(change(_TINY * e) - change(-_TINY * e)) / (2.0 * _TINY) for e in np.eye(6)]
    return np.stack(columns, axis=1)
