"""Which pixel sees a laser point through bent light: the paper's search, and Newton's.

Beermann et al. 2018, section 4.2: a laser ray is traced to its incidence point B_l; then the
camera's pixel is sought whose bent line of sight meets the surface there.  Everything is float64
and batched over all laser rays at once.
"""

from dataclasses import dataclass, replace
from enum import IntEnum
from typing import Any, Protocol

import numpy as np
from numpy.typing import ArrayLike, NDArray

from virtual_sensor.engine import dr
from virtual_sensor.errors import InputError
from virtual_sensor.optics.eikonal import Field, March, Straight, bend, in_plane
from virtual_sensor.optics.ray_status import RayStatus
from virtual_sensor.optics.sensor_model import Camera, SensorModel
from virtual_sensor.optics.surfaces import NoSurface, Surface
from virtual_sensor.optics.trace import to_numpy, to_scalars, to_vectors

Array = NDArray[np.float64]

REFERENCE = March(step_mm=0.1, method="leapfrog", precision="double")
"""The march of the search: some 1e-6 px from converged on the field that comes with the program,
and one lookup a step keeps its kernels small."""


_LEAN = 5e-3  # a bent line of sight leans from the straight one by some milliradians


class SearchStatus(IntEnum):
    """How a laser ray's search ended."""

    FOUND = 0
    """The pixel is good to r_max."""
    ABOVE_RADIUS = 1
    """The best pixel's distance is above r_max: the paper's first warning."""
    UNDERCUT = 2
    """The pixel sees something else in front of the point, or behind it: not used."""
    LASER_MISSED = 3
    """The laser ray meets no surface."""
    OUTSIDE_IMAGE = 4
    """The pixel would lie outside the sensor."""


@dataclass(frozen=True)
class FoundPixels:
    """What a search found, one row per laser ray.

    Attributes
    ----------
    laser_point_mm : ndarray of shape (N, 3)
        Incidence point on the surface, world: the paper's A (cold) or B (hot); NaN if missed.
    pixel : ndarray of shape (N, 2)
        (u, v) that sees it; NaN unless FOUND, or ABOVE_RADIUS and within z_max.
    seen_point_mm : ndarray of shape (N, 3)
        Where that pixel's line of sight meets the surface: B_k,min.
    distance_um : ndarray of shape (N,)
        Between the two, parallel to the sensor: h_d_min.
    iterations : ndarray of shape (N,)
        Marches of the camera ray that were spent.
    status : ndarray of shape (N,)
        `SearchStatus`.
    """

    laser_point_mm: Array
    pixel: Array
    seen_point_mm: Array
    distance_um: Array
    iterations: NDArray[np.int64]
    status: NDArray[np.int64]


class SearchScene(Protocol):
    """What a search needs of a scene."""

    @property
    def sensor(self) -> SensorModel: ...  # noqa: D102
    @property
    def field(self) -> Field | None: ...  # noqa: D102
    @property
    def surface(self) -> Surface: ...  # noqa: D102


def ray_search(
    scene: SearchScene,
    laser_y_mm: ArrayLike,
    method: str = "paper",
    *,
    grid_px: tuple[float, float] = (32.0, 32.0),
    k_stop: int = 15,
    r_max_um: float = 1.0,
    z_max_mm: float = 0.1,
    march: March = REFERENCE,
) -> FoundPixels:
    """Find the pixels that see laser rays' incidence points.

    Parameters
    ----------
    scene : Scene
        From `load_scene`.
    laser_y_mm : array_like of shape (N,)
        Positions of the rays along the line, in the laser's reference plane (the paper's discharge
        locations y).
    method : str
        "paper": step 2 of section 4.2 to the letter.  "newton": the same root by Newton's method,
        to 1e-6 px.
    grid_px : tuple of float
        Width and height of the paper's search grid, w_sg and h_sg.
    k_stop : int
        The paper's largest number of steps.
    r_max_um, z_max_mm : float
        Largest distance parallel to the sensor, and along the camera's axis, that are accepted.
    march : March

    Returns
    -------
    FoundPixels

    Raises
    ------
    InputError
        If the method is neither.
    """
    if method not in ("paper", "newton"):
        raise InputError(f"ray_search: method must be paper or newton, not '{method}'")
    b = np.atleast_1d(np.asarray(laser_y_mm, float))
    target = incidence_points(scene, b, march)
    if method == "paper":
        found = _paper(scene, target, grid_px, k_stop, r_max_um, march)
    else:
        found = _newton(scene, target, march)
    return _checked(scene.sensor.camera, found, r_max_um, z_max_mm)


def incidence_points(scene: SearchScene, b: Array, march: March = REFERENCE) -> Array:
    """Step 1: trace laser rays at b (N,) to the surface, (N, 3) in mm; NaN where they miss."""
    origins, directions = scene.sensor.laser.rays(0.0, b)
    line = Straight.through(to_vectors(origins), to_vectors(directions), march)
    ray = bend(scene.field, scene.surface, line, march)
    dr.eval(ray)
    hit = np.array(ray.status) == RayStatus.HIT
    return np.where(hit[:, None], to_numpy(ray.position(line)), np.nan)


def _sight(camera: Camera, pixel: Array, march: March) -> Straight:
    """Lines of sight of pixels (N, 2), as they leave the projection centre (step 2.2)."""
    directions = camera.lines_of_sight(np.nan_to_num(pixel))
    origins = np.broadcast_to(camera.pose.origin_mm, directions.shape)
    return Straight.through(to_vectors(origins), to_vectors(directions), march)


def _seen_points(scene: SearchScene, pixel: Array, march: March) -> Array:
    """Step 2.3: trace lines of sight to the surface; NaN where they miss."""
    line = _sight(scene.sensor.camera, pixel, march)
    ray = bend(scene.field, scene.surface, line, march)
    hit = (np.array(ray.status) == RayStatus.HIT) & np.isfinite(pixel).all(axis=1)
    return np.where(hit[:, None], to_numpy(ray.position(line)), np.nan)


def _paper(
    scene: SearchScene,
    target: Array,
    grid_px: tuple[float, float],
    k_stop: int,
    r_max_um: float,
    march: March,
) -> FoundPixels:
    """Step 2 of section 4.2: halve the step, keep the best."""
    camera = scene.sensor.camera
    pixel = camera.project(target)  # 2.1: the start pixel u_s
    best = FoundPixels(
        target,
        pixel,
        np.full_like(target, np.nan),
        np.full(len(target), np.inf),
        np.zeros(len(target), int),
        np.zeros(len(target), int),
    )
    toward = np.ones_like(pixel)  # signs of h_delta_B_xy,min
    for k in range(1, k_stop + 1):
        searching = np.isfinite(target[:, 0]) & ~(best.distance_um < r_max_um)
        if not searching.any():
            break
        seen = _seen_points(scene, pixel, march)  # 2.3
        delta = ((seen - target) @ camera.pose.rotation)[:, :2] * 1e3
        distance = np.linalg.norm(delta, axis=1)  # 2.4
        better = searching & (distance < best.distance_um)
        best = replace(
            best,
            pixel=np.where(better[:, None], pixel, best.pixel),
            seen_point_mm=np.where(better[:, None], seen, best.seen_point_mm),
            distance_um=np.where(better, distance, best.distance_um),
            iterations=np.where(searching, k, best.iterations),
        )
        toward = np.where(better[:, None], delta, toward)
        step = np.array(grid_px) / 2.0**k  # 2.5
        pixel = best.pixel + np.where(toward <= 0.0, step, -step)
    return best


def _newton(scene: SearchScene, target: Array, march: March) -> FoundPixels:
    """Newton's method on where the line of sight crosses the plane through B_l, then one look.

    The marches carry the derivatives by u and v; the last one goes to the surface.
    """
    camera = scene.sensor.camera
    axis = camera.pose.rotation[:, 2]
    pixel = camera.project(target)
    known = np.isfinite(pixel).all(axis=1)
    marches = 0
    for _ in range(5):
        line = _sight(camera, pixel, march)
        normal = dr.opaque(march.vector(*map(float, axis)))  # one kernel for all poses
        offset = march.scalar(to_scalars(np.nan_to_num(target) @ axis))
        ends = in_plane(normal, offset - dr.dot(normal, line.anchor))
        ray = bend(
            scene.field,
            NoSurface(),
            line,
            march,
            remaining=ends,
            tangents=_pixel_tangents(camera, pixel),
        )
        dr.eval(ray)
        T = to_numpy(ray.tangent(line))
        crossing = to_numpy(ray.position(line))
        columns = []
        for vector in ray.offset[1:]:
            w = to_numpy(vector)
            columns.append(w - T * ((w @ axis) / (T @ axis))[:, None])
        jacobian = camera.pose.rotation[:, :2].T @ np.stack(columns, axis=-1)
        miss = (target - crossing) @ camera.pose.rotation[:, :2]
        change = np.full_like(pixel, np.nan)
        change[known] = np.linalg.solve(jacobian[known], miss[known][:, :, None])[:, :, 0]
        pixel = pixel + change
        marches += 1
        if not known.any() or np.nanmax(np.abs(change)) < 1e-4:  # quadratic: 1e-8 px remain
            break
    seen = _seen_points(scene, pixel, march)
    delta = ((seen - target) @ camera.pose.rotation)[:, :2] * 1e3
    return FoundPixels(
        target,
        pixel,
        seen,
        np.linalg.norm(delta, axis=1),
        np.where(known, marches + 1, 0),
        np.zeros(len(target), int),
    )


def _pixel_tangents(camera: Camera, pixel: Array) -> tuple[tuple[Any, Any], ...]:
    """Derivatives of a line of sight's start and unit direction by u and by v."""
    direction = camera.lines_of_sight(np.nan_to_num(pixel))
    inverse = np.linalg.inv(camera.matrix)
    homogeneous = np.concatenate([np.nan_to_num(pixel), np.ones((len(pixel), 1))], axis=1)
    norm = np.linalg.norm(homogeneous @ inverse.T, axis=1, keepdims=True)
    tangents = []
    for column in (0, 1):
        raw = np.broadcast_to(camera.pose.rotation @ inverse[:, column], direction.shape) / norm
        across = raw - direction * np.einsum("ij,ij->i", raw, direction)[:, None]
        tangents.append((to_vectors(np.zeros_like(across)), to_vectors(across)))
    return tuple(tangents)


def _checked(camera: Camera, found: FoundPixels, r_max_um: float, z_max_mm: float) -> FoundPixels:
    """Step 3.1: the quality check.

    A point too far along the camera's axis is not used.  It is an undercut if the search did
    arrive: the points coincide parallel to the sensor, or lie on one line of sight.
    """
    delta = (found.seen_point_mm - found.laser_point_mm) @ camera.pose.rotation
    depth_um = np.abs(delta[:, 2]) * 1e3
    near = depth_um <= z_max_mm * 1e3
    apart_px = camera.project(found.seen_point_mm) - camera.project(found.laser_point_mm)
    um_per_px = camera.pose.to_local(found.laser_point_mm)[:, 2] / camera.matrix[0, 0] * 1e3
    apart_um = np.linalg.norm(apart_px, axis=1) * um_per_px
    in_line = apart_um <= r_max_um + _LEAN * depth_um
    close = found.distance_um <= r_max_um
    missed = np.isnan(found.laser_point_mm[:, 0])
    status = np.select(
        [
            missed,
            ~camera.inside(found.pixel),
            ~near & (in_line | close),
            ~close,
        ],
        [
            SearchStatus.LASER_MISSED,
            SearchStatus.OUTSIDE_IMAGE,
            SearchStatus.UNDERCUT,
            SearchStatus.ABOVE_RADIUS,
        ],
        SearchStatus.FOUND,
    )
    used = near & np.isin(status, (SearchStatus.FOUND, SearchStatus.ABOVE_RADIUS))
    return replace(
        found,
        pixel=np.where(used[:, None], found.pixel, np.nan),
        distance_um=np.where(missed, np.nan, found.distance_um),
        status=status,
    )
