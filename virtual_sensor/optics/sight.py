"""Bent laser rays and lines of sight, from the sensor to the surface: what searches march."""

import importlib
from collections.abc import Callable
from pathlib import Path
from typing import Any, Protocol

import numpy as np
from numpy.typing import NDArray

from virtual_sensor.arrays import by_rows, to_numpy, to_scalars, to_vectors
from virtual_sensor.engine import dr
from virtual_sensor.errors import InputError, short
from virtual_sensor.optics.eikonal import bend, in_plane
from virtual_sensor.optics.ray_families import Pinhole
from virtual_sensor.optics.ray_status import RayStatus
from virtual_sensor.optics.rays import Field, March, Straight
from virtual_sensor.optics.sources import Source
from virtual_sensor.optics.surfaces import NoSurface, Surface

Array = NDArray[np.float64]

REFERENCE = March(step_mm=0.1, method="leapfrog", precision="double")
"""The march of the searches: it errs by 3e-7 px on the shipped field, less than
methods of higher order with as many lookups, and one lookup a step keeps its kernels small."""


class SearchScene(Protocol):
    """What a search needs of a scene; `source` only where it asks for its rays s = 0."""

    @property
    def camera(self) -> Pinhole: ...  # noqa: D102
    @property
    def source(self) -> Source: ...  # noqa: D102
    @property
    def medium(self) -> Field | None: ...  # noqa: D102
    @property
    def surface(self) -> Surface: ...  # noqa: D102


def chosen(scene: SearchScene, camera: str | None, source: str | None) -> SearchScene:
    """The scene with the one camera and the one source of these names; None: it has only one.

    Raises
    ------
    InputError
        If there are none of these names, or several to choose from.
    """
    if camera is None and source is None:
        return scene
    only: Callable[[str | None, str | None], SearchScene] = scene.only  # type: ignore[attr-defined]
    return only(camera, source)


def scene_of(asker: str, scene: Any) -> Any:
    """The scene that is given, or that is loaded by the name or path that is.

    Raises
    ------
    InputError
        If it is neither.
    """
    if isinstance(scene, str | Path):  # who loads scenes lies above, and is asked by name alone
        return importlib.import_module("virtual_sensor.imaging.scene").load_scene(scene)
    if not all(hasattr(scene, name) for name in ("medium", "surface")):
        raise InputError(
            f"{asker}: scene is {short(scene)}; give a scene of load_scene, or its name or path"
        )
    return scene


def with_projector(scene: SearchScene, camera: str | None, source: str | None) -> SearchScene:
    """As `chosen`; of a scene with lasers too, its projector, if there is only one."""
    if source is None:
        source = getattr(scene, "projector_name", None)
    return chosen(scene, camera, source)


def pixel_family(asker: str, scene: SearchScene) -> Any:
    """The rays of a scene's projector, which have pixels as a camera's have.

    Raises
    ------
    InputError
        If its source has none: it is a laser line.
    """
    family = scene.source.family
    if not hasattr(family, "of_pixels"):
        raise InputError(
            f"{asker}: the source has no pixels, as a laser line has none; give a scene with a"
            " projector, or name it (source=)"
        )
    return family


def check_progress(asker: str, progress: object) -> None:
    """Raise InputError unless it can be told how much is done."""
    if progress is not None and not callable(progress):
        raise InputError(
            f"{asker}: progress is {short(progress)}; give a function of the fraction done, such as"
            " print"
        )


def incidence_points(
    scene: SearchScene, t: Array, march: March = REFERENCE, s: Array | float = 0.0
) -> Array:
    """Trace the source's rays (s, t), each (N,), to the surface, (N, 3) in mm; NaN: they miss."""
    origins, directions = scene.source.family.rays(s, t)
    return _to_surface(scene, origins, directions, march)


def seen_points(scene: SearchScene, pixel: Array, march: March = REFERENCE) -> Array:
    """Trace lines of sight of pixels (N, 2) to the surface, (N, 3) in mm; NaN where they miss."""
    seen = _to_surface(scene, *lines_of_sight(scene.camera, pixel), march)
    return np.where(np.isfinite(pixel).all(axis=1, keepdims=True), seen, np.nan)


def misses(scene: SearchScene, target: Array, pixel: Array, march: March = REFERENCE) -> Array:
    """By how much lines of sight miss points, parallel to the sensor, whatever stands before them.

    Parameters
    ----------
    target : ndarray of shape (N, 3)
        World, mm.
    pixel : ndarray of shape (N, 2)

    Returns
    -------
    ndarray of shape (N, 2)
        From where the line of sight crosses the plane through the point to the point, in the
        camera's x and y, mm; NaN where either argument is.
    """
    camera = scene.camera
    axis = camera.pose.rotation[:, 2]
    normal = dr.opaque(march.vector(*map(float, axis)))  # one kernel for all poses

    def to_plane(target: Array, pixel: Array) -> Array:
        line = _line(*lines_of_sight(camera, pixel), march)
        offset = march.scalar(to_scalars(np.nan_to_num(target) @ axis))
        ends = in_plane(normal, offset - dr.dot(normal, line.anchor))
        ray = bend(scene.medium, NoSurface(), line, march, remaining=ends)
        dr.eval(ray)
        return to_numpy(ray.position(line))

    miss = (target - by_rows(to_plane, target, pixel)) @ camera.pose.rotation[:, :2]
    return np.where(np.isfinite(pixel).all(axis=1, keepdims=True), miss, np.nan)


def lines_of_sight(camera: Pinhole, pixel: Array) -> tuple[Array, Array]:
    """Origins and directions (N, 3) of lines of sight, as they leave the projection centre."""
    return camera.rays(*camera.of_pixels(np.nan_to_num(pixel)))


def _line(origins: Array, directions: Array, march: March) -> Straight:
    return Straight.through(to_vectors(origins), to_vectors(directions), march)


def _to_surface(scene: SearchScene, origins: Array, directions: Array, march: March) -> Array:
    def hits(origins: Array, directions: Array) -> Array:
        line = _line(origins, directions, march)
        ray = bend(scene.medium, scene.surface, line, march)
        dr.eval(ray)  # once: each part evaluated alone would be marched again
        hit = np.array(ray.status) == RayStatus.HIT
        return np.where(hit[:, None], to_numpy(ray.position(line)), np.nan)

    return by_rows(hits, origins, directions)
