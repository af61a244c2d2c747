"""The ray search through a lens: where a blurred frame shows a line, and how wide.

Seen from each point of the pupil a laser's ray has a pixel of its own, which `ray_search` finds
along a bent line of sight.  Where all is in focus and the air is cold they are one.  Their mean is
the centre of gravity of the blurred image, and what they scatter by is its width.

They don't count alike: a surface that is seen aslant looks larger from one side of the pupil than
from the other.  A diffuse point P with the normal n gives the image that is seen from A light in
proportion to n . (P - A) / z^3, z its depth: radiance times the area that it has there.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from pathlib import Path
from typing import Any, ClassVar

import numpy as np
from numpy.typing import ArrayLike, NDArray

from virtual_sensor.arrays import numbers_of, one_of, points_of, whole_number
from virtual_sensor.calls import public
from virtual_sensor.display import Displayed, listed, tally
from virtual_sensor.errors import InputError, naming, short
from virtual_sensor.optics.lens import (
    MOST_POINTS,
    USUAL_SUB_PUPILS,
    Lens,
    PupilPoint,
    circle_of_confusion,
)
from virtual_sensor.optics.ray_families import Pinhole
from virtual_sensor.optics.ray_search import March, SearchStatus, ray_search
from virtual_sensor.optics.rays import Field
from virtual_sensor.optics.sight import (
    SearchScene,
    check_progress,
    chosen,
    scene_of,
    with_projector,
)
from virtual_sensor.optics.sources import Source
from virtual_sensor.optics.surfaces import Cylinder, SceneSurface, Surface
from virtual_sensor.statuses import StatusEnum

Array = NDArray[np.float64]


class PupilStatus(StatusEnum):
    """Which part of the pupil sees what a ray of laser or projector lights."""

    FOUND = 0, "Seen from all points of the pupil."
    PART = (
        1,
        "Seen from some points of the pupil only, whose mean and spread are given: an edge of the "
        "part or of the image shades the others, so move the camera, or stop the lens down.",
    )
    NONE = 2, "Seen from no point of the pupil: ask ray_search, which says why of the chief ray."


@dataclass(frozen=True)
class PupilPixels(Displayed):
    """Where N rays' incidence points are seen from K points of the pupil.

    Attributes
    ----------
    at_mm : ndarray of shape (K, 2)
        The points of the pupil, from its middle, in the camera's frame.
    laser_point_mm : ndarray of shape (N, 3)
        The incidence points, world; NaN where a ray meets nothing, or has no light.
    pixel : ndarray of shape (N, 2)
        Mean (u, v) of those below, by their light: the centre of gravity of the blurred image of
        each point.
    spread : ndarray of shape (N, 2)
        Their standard deviation along u and along v: a disc of diameter D has D/4.
    pixels : ndarray of shape (K, N, 2)
        (u, v) as seen from each point; NaN where it isn't.
    light : ndarray of shape (K, N)
        What each point of the pupil gets of a diffuse surface's light, over what the middle gets;
        NaN where it sees none.
    column_light : ndarray of shape (K, N)
        Likewise of a line's light in the column of each pixel, in a unit that all rays have in
        common: the more of it, the slower columns change along the line.
    status : ndarray of shape (N,)
        `PupilStatus`.
    """

    _field_units: ClassVar = {"pixel": "px", "spread": "px", "pixels": "px"}
    _statuses: ClassVar = {"status": PupilStatus}

    at_mm: Array
    laser_point_mm: Array
    pixel: Array
    spread: Array
    pixels: Array
    light: Array
    column_light: Array
    status: NDArray[np.uint8]

    def _line(self) -> str:
        count = f"from {len(self.at_mm)} points of the pupil"
        spread = self.spread[np.isfinite(self.spread[:, 1]), 1]
        wide = f"spread along v up to {spread.max():.3g} px" if spread.size else ""
        return listed(tally(self.status, PupilStatus.FOUND), count, wide)

    def _columns(self) -> dict[str, Any]:
        names = {"u": self.pixel[:, 0], "v": self.pixel[:, 1]}
        spread = {"spread_u": self.spread[:, 0], "spread_v": self.spread[:, 1]}
        return names | spread | {"status": self.status}

    def rows_at(self, column: ArrayLike) -> tuple[Array, Array]:
        """Where a blurred frame shows the line in columns, and by how much it is wider there.

        The line as each point of the pupil sees it is a cubic spline through its pixels, whose
        columns must rise or fall along the rays.

        Parameters
        ----------
        column : array_like of shape (M,)
            u, px.

        Returns
        -------
        row, spread : ndarray of shape (M,)
            Mean and standard deviation, px, over the points of the pupil, by the light of each in
            the column; NaN beside the line as any of them sees it.
        """
        from scipy.interpolate import CubicSpline

        at = numbers_of("rows_at: column", column)
        found = np.full((2, len(self.pixels), *at.shape), np.nan)
        for number, (pixel, light) in enumerate(zip(self.pixels, self.column_light, strict=True)):
            known = np.isfinite(light)
            u = pixel[known, 0]
            order = np.argsort(u)
            u, both = u[order], np.stack([pixel[known, 1], light[known]])[:, order]
            if len(u) < 2 or not np.all(np.diff(u) > 0.0):
                continue
            within = (at >= u[0]) & (at <= u[-1])
            found[:, number] = np.where(within, CubicSpline(u, both, axis=1)(at), np.nan)
        return weighted(*found)


def weighted(values: Array, weights: Array) -> tuple[Array, Array]:
    """Mean and standard deviation over the first axis; NaN where a value or weight is."""
    total = weights.sum(axis=0)
    with np.errstate(invalid="ignore"):
        mean = (weights * values).sum(axis=0) / total
        return mean, np.sqrt((weights * (values - mean) ** 2).sum(axis=0) / total)


@dataclass(frozen=True)
class _SeenFrom:
    """A scene with another camera."""

    camera: Pinhole
    source: Source
    medium: Field | None
    surface: Surface


@public
def pupil_search(
    scene: SearchScene | str | Path,
    laser_y_mm: ArrayLike | None = None,
    method: str = "newton",
    *,
    projector_pixel: ArrayLike | None = None,
    points: int | None = None,
    lens: Lens | None = None,
    march: March | None = None,
    tolerance_px: float = 1e-3,
    camera: str | None = None,
    source: str | None = None,
    progress: Callable[[float], None] | None = None,
) -> PupilPixels:
    """Find where incidence points are seen through a lens, in bent air: `ray_search` for its pupil.

    >>> seen = vs.pupil_search(scene, [-6.0, 0.0, 6.0], points=64)
    >>> seen.pixel, seen.spread      # where the blurred frame has the line, and its width

    Parameters
    ----------
    scene, laser_y_mm, method, projector_pixel, march, tolerance_px, camera, source
        See `ray_search`; the paper's method is for chief rays alone.
    points : int, optional
        Of the pupil; by default as many as frames are rendered through.
    lens : Lens, optional
        In place of the camera's own.
    progress : callable, optional
        Called with the fraction of the points that are done.

    Returns
    -------
    PupilPixels

    Raises
    ------
    InputError
        If the camera has no lens and none is given; or as `ray_search`.
    """
    loaded: SearchScene = scene_of("pupil_search", scene)
    if projector_pixel is None:
        seen = chosen(loaded, camera, source)
    else:
        with naming("pupil_search: projector_pixel"):
            seen = with_projector(loaded, camera, source)
    check_progress("pupil_search", progress)
    one_of("pupil_search: method", method, ("newton", "tabulated"))
    chief, lens = seen.camera, _lens("pupil_search", lens, seen.camera)
    if lens is None:
        raise InputError(
            "pupil_search: the camera has no lens; give its element lens_camera an f_number and a"
            " focus_distance, or give a Lens (lens=)"
        )
    if points is None:
        points = getattr(chief, "sub_pupils", USUAL_SUB_PUPILS)
    at = lens.pupil(whole_number("pupil_search: points", points, 1, MOST_POINTS))
    found = []
    for number, place in enumerate(at):
        view = _SeenFrom(PupilPoint.of(chief, lens, place), seen.source, seen.medium, seen.surface)
        rays = {"projector_pixel": projector_pixel, "march": march, "tolerance_px": tolerance_px}
        found.append(ray_search(view, laser_y_mm, method, **rays))  # type: ignore[arg-type]
        if progress:
            progress((number + 1) / len(at))
    pixels = np.stack([each.pixel for each in found])
    used = np.stack([each.status == SearchStatus.FOUND for each in found])
    pixels = np.where(used[..., None], pixels, np.nan)
    count = used.sum(axis=0)
    points_mm = found[0].laser_point_mm
    light, depth = _light(seen, lens, at, points_mm)
    light, in_column = (np.where(used, each, np.nan) for each in (light, light * depth))
    given: ArrayLike = [] if laser_y_mm is None else laser_y_mm
    y = np.atleast_1d(numbers_of("pupil_search: laser_y_mm", given))
    if len(y) > 1 and np.all(np.diff(y) != 0.0):
        straight = np.stack([PupilPoint.of(chief, lens, place).project(points_mm) for place in at])
        with np.errstate(divide="ignore", invalid="ignore"):
            in_column = in_column / np.abs(np.gradient(straight[..., 0], y, axis=1))
    shares = np.where(used, light, 0.0)[..., None]
    with np.errstate(invalid="ignore"):
        mean, spread = weighted(np.nan_to_num(pixels), shares)
    status = np.select([count == len(at), count > 0], [PupilStatus.FOUND, PupilStatus.PART], 2)
    seen_by = status.astype(np.uint8)
    return PupilPixels(at, points_mm, mean, spread, pixels, light, in_column, seen_by)


def _light(seen: SearchScene, lens: Lens, at_mm: Array, points_mm: Array) -> tuple[Array, Array]:
    """What points (K, 2) of a pupil get of the light of points (N, 3) of a surface: shape (K, N).

    By straight lines of sight, over that of the middle; and that of the middle (N,) in any unit.
    Of no surface all get the same.  In frames pixels count each point of the pupil alike, so that
    on a tilted sensor, where the image is larger as seen from one side, there is more of its light.
    """
    surface, pose = seen.surface, seen.camera.pose
    sight = points_mm - pose.origin_mm
    tilted = 1.0 / (1.0 + at_mm @ lens.lean)[:, None]
    if not isinstance(surface, Cylinder | SceneSurface) or not len(sight):
        return tilted * np.ones(len(sight)), np.ones(len(sight))
    known = np.isfinite(sight).all(axis=1)
    normal = np.zeros(sight.shape)
    heading = sight[known] / np.linalg.norm(sight[known], axis=1, keepdims=True)
    normal[known] = surface.normals(points_mm[known], heading)
    length = np.linalg.norm(normal, axis=1)
    known &= length > 0.0
    normal /= np.where(known, length, 1.0)[:, None]
    facing = np.where(known, np.sum(normal * np.nan_to_num(sight), axis=1), np.inf)
    aside = at_mm @ (normal @ pose.rotation[:, :2]).T
    light = tilted * np.maximum(1.0 - aside / facing, 0.0)
    return light, np.where(known, np.abs(facing) / (sight @ pose.rotation[:, 2]) ** 3, 1.0)


@public
def circle_of_confusion_px(
    scene: SearchScene | str | Path,
    points_mm: ArrayLike,
    *,
    lens: Lens | None = None,
    camera: str | None = None,
) -> Array:
    """How wide a lens out of focus shows points, by the formula of the thin lens, in cold air.

    Parameters
    ----------
    scene : Scene, str or Path
        From `load_scene`, or its name or path.
    points_mm : array_like of shape (N, 3)
        World, mm.
    lens : Lens, optional
        In place of the camera's own; a camera without one shows points as points.
    camera : str, optional
        Its name, where the scene has several.

    Returns
    -------
    ndarray of shape (N, 2)
        Diameters along u and along v, px; NaN behind the camera.
    """
    points = points_of("circle_of_confusion_px: points_mm", points_mm)
    if points.shape[-1:] != (3,):
        raise InputError(
            f"circle_of_confusion_px: points_mm has the shape {points.shape}; give it (N, 3)"
        )
    seeing = chosen(scene_of("circle_of_confusion_px", scene), camera, None).camera
    lens = _lens("circle_of_confusion_px", lens, seeing)
    return circle_of_confusion(lens or Lens(1.0, 1.0, 0.0), seeing, points)


def _lens(asker: str, lens: Any, camera: Pinhole) -> Lens | None:
    """The lens that is given, or the camera's, if it has one."""
    if lens is not None and not isinstance(lens, Lens):
        raise InputError(f"{asker}: lens is {short(lens)}; give a vs.Lens, or leave it out")
    found: Lens | None = getattr(camera, "lens", None) if lens is None else lens
    return found
