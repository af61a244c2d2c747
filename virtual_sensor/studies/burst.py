"""A burst of frames of air that moves: how much the line and the points measured on it sway."""

import time
from collections import Counter
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from dataclasses import dataclass
from enum import IntEnum
from typing import Any

import numpy as np
from numpy.typing import ArrayLike, NDArray

from virtual_sensor.errors import InputError
from virtual_sensor.imaging.checks import check_scene
from virtual_sensor.imaging.render import render_frame
from virtual_sensor.imaging.scene import Scene
from virtual_sensor.medium.netcdf import field_times
from virtual_sensor.metrology.centres import LineCentres, Status
from virtual_sensor.metrology.deviation import UM_PER_MM
from virtual_sensor.metrology.line_peaks import line_centres
from virtual_sensor.metrology.triangulation import triangulate
from virtual_sensor.optics.ray_search import FoundPixels, SearchStatus, ray_search
from virtual_sensor.studies.measure import Report
from virtual_sensor.studies.notes import coarse_grid, unlit_rays
from virtual_sensor.studies.probes import probe_rays
from virtual_sensor.studies.provenance import made_with
from virtual_sensor.studies.tables import status_names

MIN_FRAMES = 3
"""With fewer frames a standard deviation says nothing: it is NaN."""

Array = NDArray[np.float64]


@dataclass(frozen=True)
class Spread:
    """Mean and standard deviation over the frames of a burst, of N quantities of K components.

    Attributes
    ----------
    mean, std : ndarray of shape (N, K)
        The deviation's denominator is the number of frames less one; both NaN where there are fewer
        than `MIN_FRAMES`.
    frames : ndarray of int of shape (N,)
        Frames in which the quantity has a value.
    """

    mean: Array
    std: Array
    frames: NDArray[np.int64]


@dataclass(frozen=True)
class Burst:
    """Frames at F equally spaced instants.

    Attributes
    ----------
    scene : Scene
    time_s : ndarray of shape (F,)
        Flow time of the frames, s.
    stored_s : ndarray of shape (S,)
        Flow time of the instants in the field's file.
    lines : tuple of F LineCentres
        The rendered line in every column.
    rays : tuple of F FoundPixels
        The probe rays, by Newton's search.
    probe_y_mm : ndarray of shape (N,)
        Their positions along the line.
    notes : tuple of str
        What the user should know.
    seconds : dict
        Spent on field, render, centres and search, over all frames.
    """

    scene: Scene
    time_s: Array
    stored_s: Array
    lines: tuple[LineCentres, ...]
    rays: tuple[FoundPixels, ...]
    probe_y_mm: Array
    notes: tuple[str, ...]
    seconds: dict[str, float]

    @property
    def up(self) -> Array:
        """Unit vector (3,), world, against the laser's axis: in it heights are measured."""
        return -self.scene.sensor.laser.pose.rotation[:, 2]

    @property
    def centres_px(self) -> Array:
        """(u, v) of the line in every column of every frame; shape (F, W, 2)."""
        return np.stack([line.pixel for line in self.lines])

    @property
    def points_mm(self) -> Array:
        """Triangulated from them, world, mm; shape (F, W, 3)."""
        return triangulate(self.scene.sensor, self.centres_px)

    @property
    def rays_px(self) -> Array:
        """Pixels that see the probe rays; shape (F, N, 2)."""
        return np.stack([found.pixel for found in self.rays])

    @property
    def incidence_mm(self) -> Array:
        """The probe rays' points B on the part, world, mm; shape (F, N, 3)."""
        return np.stack([found.laser_point_mm for found in self.rays])

    @property
    def measured_mm(self) -> Array:
        """The probe rays' measured points B_m, world, mm; shape (F, N, 3)."""
        return triangulate(self.scene.sensor, self.rays_px)

    @property
    def column_status(self) -> NDArray[np.str_]:
        """Per column "ok", or why most frames have no centre there; shape (W,)."""
        return _commonest(np.stack([line.status for line in self.lines]), Status)

    @property
    def ray_status(self) -> NDArray[np.str_]:
        """Per ray "found", or why most frames have no pixel for it; shape (N,)."""
        return _commonest(np.stack([found.status for found in self.rays]), SearchStatus)

    def with_height(self, points_mm: Array) -> Array:
        """Points (F, N, 3) with their height, along `up`, as a fourth component; mm."""
        return np.concatenate([points_mm, (points_mm @ self.up)[..., None]], axis=-1)


def instants(
    scene: Scene, start_s: float | None = None, duration_s: float = 1.0, frames: int = 11
) -> tuple[Array, Array]:
    """Equally spaced instants of a burst, by default the last of the field; and those stored.

    Returns
    -------
    tuple of ndarray of shape (F,) and (S,)
        Flow times of the frames and of the field file's instants, s.

    Raises
    ------
    InputError
        If the scene's field does not hold such a burst.
    """
    file = scene.air.path
    if file is None:
        raise InputError(f"{scene.path}: light runs straight; a burst needs a field that moves")
    if scene.parameters.get("time"):
        raise InputError(
            f"{scene.path}: time={scene.parameters['time']} picks one instant; leave it out, and"
            " choose those of a burst by its start and its duration"
        )
    stored = field_times(file)
    if stored is None or len(stored) < 2:
        raise InputError(
            f"{file}: holds one instant; a burst needs a field with a time axis, a dimension 'time'"
            " of two instants or more (in a scene that comes along, name it by -D field=FILE)"
        )
    if frames < MIN_FRAMES or not duration_s > 0.0:
        raise InputError(
            f"a burst of {frames} frames in {duration_s:g} s has no standard deviation; give at"
            f" least {MIN_FRAMES} frames and a positive duration"
        )
    first, last = float(stored[0]), float(stored[-1])
    start = last - duration_s if start_s is None else start_s
    doubt = 1e-9 * (abs(first) + abs(last))
    if not (start >= first - doubt and start + duration_s <= last + doubt):
        raise InputError(
            f"{file}: holds {first:g} to {last:g} s, and the burst would last from {start:g} to"
            f" {start + duration_s:g} s; give another start or a shorter duration"
        )
    return np.clip(np.linspace(start, start + duration_s, frames), first, last), stored


def burst(
    scene: Scene,
    start_s: float | None = None,
    duration_s: float = 1.0,
    frames: int = 11,
    report: Report = lambda stage, fraction: None,
    y_mm: ArrayLike | None = None,
) -> Burst:
    """Render frames of moving air, find the line in each, and search the probe rays.

    Parameters
    ----------
    scene : Scene
        With a field that has a time axis.
    start_s : float, optional
        Flow time of the first frame, s; by default so that the last frame is the field's last
        instant.
    duration_s : float
        From the first frame to the last, s.
    frames : int
        Their number.
    report : callable
        Told what is being done, and which fraction of the whole is.
    y_mm : array_like of shape (N,), optional
        Positions of the probe rays along the line, mm; by default the scene's own (`probe_rays`).

    Raises
    ------
    InputError
        If the field does not hold such a burst, the scene can't be measured at one of its instants
        (see `imaging.checks`), or its frames show no line.
    """
    laser = scene.sensor.laser
    times, stored = instants(scene, start_s, duration_s, frames)
    if laser.dots_mm.size:
        raise InputError(f'{scene.path}: a burst follows a line; take the dots away (-D dots="")')
    seconds = dict.fromkeys(("field", "search", "render", "centres"), 0.0)
    lines, rays = [], []
    y = probe_rays(scene, y_mm)
    notes = [*scene.notes, *unlit_rays(laser, y), *coarse_grid(scene)]
    notes += _coarse_instants(times, stored)
    at_border: list[str] = []
    for number, instant in enumerate(times):

        def tell(part: float, number: int = number, instant: float = instant) -> None:
            report(f"frame {number + 1} of {frames}, {instant:.3f} s", (number + part) / frames)

        line, found, border = _one_frame(scene, y, float(instant), tell, seconds)
        lines.append(line)
        rays.append(found)
        # At one instant: at the others it is much the same.
        at_border = at_border or [f"at {instant:g} s: {text}" for text in border]
    notes += at_border
    return Burst(scene, times, stored, tuple(lines), tuple(rays), y, tuple(notes), seconds)


def _one_frame(
    scene: Scene, y: Array, instant: float, tell: Callable[[float], None], seconds: dict[str, float]
) -> tuple[LineCentres, FoundPixels, list[str]]:
    """Line, probe rays and notes of one instant; `seconds` grows by what each part took."""
    tell(0.0)
    with _timed(seconds, "field"):
        now = scene.at(instant)
    with _timed(seconds, "search"):
        notes = check_scene(now)
        found = ray_search(now, y, "newton")
    tell(0.1)
    with _timed(seconds, "render"):
        frame = render_frame(now, progress=lambda part: tell(0.3 + 0.7 * part))
    with _timed(seconds, "centres"):
        line = line_centres(frame.radiance)
    if not np.any(line.status == Status.OK):
        raise InputError(
            f"{scene.path}: no line in the frame at {instant:g} s; give a wider or longer line"
            " (line_radius, line_length), or more samples (spp)"
        )
    return line, found, notes


def spread(values: Array) -> Spread:
    """Mean and standard deviation of values (F, N, K) over the frames in which they are finite."""
    known = np.isfinite(values).all(axis=-1, keepdims=True)
    frames = known.sum(axis=0)
    divisor = np.where(frames >= MIN_FRAMES, frames, np.nan)
    mean = np.where(known, values, 0.0).sum(axis=0) / divisor
    squares = np.where(known, values - mean, 0.0) ** 2
    return Spread(mean, np.sqrt(squares.sum(axis=0) / (divisor - 1.0)), frames[:, 0])


def summary(result: Burst) -> dict[str, Any]:
    """The figures of a burst, for `summary.json`."""
    line = spread(result.centres_px)
    points = spread(result.with_height(result.points_mm))
    rays = spread(result.rays_px)
    measured = spread(result.with_height(result.measured_mm))
    frames = len(result.time_s)
    return {
        "scene": str(result.scene.path),
        "parameters": dict(result.scene.parameters),
        "field": {
            "file": str(result.scene.air.path),
            "source": result.scene.field.source if result.scene.field else "",
            "instants stored": len(result.stored_s),
            "first and last, s": [float(result.stored_s[0]), float(result.stored_s[-1])],
        },
        "notes": result.notes,
        "frames": frames,
        "first and last frame, s": [float(result.time_s[0]), float(result.time_s[-1])],
        "columns": dict(Counter(result.column_status.tolist())),
        "columns seen in every frame": int(np.sum(line.frames == frames)),
        "standard deviation along the line": {
            "v, px": _middle_and_largest(line.std[:, 1]),
            "y, um": _middle_and_largest(points.std[:, 1] * UM_PER_MM),
            "height along the laser's axis, um": _middle_and_largest(points.std[:, 3] * UM_PER_MM),
        },
        "standard deviation of the probe rays": {
            "u, px": _middle_and_largest(rays.std[:, 0]),
            "v, px": _middle_and_largest(rays.std[:, 1]),
            "B_m's height along the laser's axis, um": _middle_and_largest(
                measured.std[:, 3] * UM_PER_MM
            ),
            "rays": dict(Counter(result.ray_status.tolist())),
        },
        "seconds": {name: round(value, 2) for name, value in result.seconds.items()},
        "seconds per frame": round(sum(result.seconds.values()) / frames, 2),
        "made_with": made_with(result.scene),
    }


def _middle_and_largest(values: Array) -> dict[str, float | None]:
    """Median and maximum of the finite ones; None where there are none."""
    known = values[np.isfinite(values)]
    return {
        "median": float(np.median(known)) if known.size else None,
        "largest": float(np.max(known)) if known.size else None,
    }


def _coarse_instants(times: Array, stored: Array) -> list[str]:
    """Tell of instants so far apart that the frames between them sway too little."""
    first = np.searchsorted(stored, times[0], "right") - 1
    last = np.searchsorted(stored, times[-1], "left")
    gap = float(np.max(np.diff(stored[first : last + 1])))
    spacing = float(times[1] - times[0])
    if gap <= spacing * (1.0 + 1e-6):
        return []
    return [
        f"the field's instants are up to {gap:.3g} s apart and the frames {spacing:.3g} s: between"
        " instants the air is interpolated, and sways less than it would"
    ]


def _commonest(status: NDArray[np.integer], kind: type[IntEnum]) -> NDArray[np.str_]:
    """Per column of status (F, N) the sound one, 0, if it is in enough frames, else the usual."""
    counts = np.stack([np.sum(status == member, axis=0) for member in kind])
    counts[0] = np.where(counts[0] >= MIN_FRAMES, len(status) + 1, 0)
    return status_names(np.array(list(kind))[counts.argmax(axis=0)], kind)


@contextmanager
def _timed(seconds: dict[str, float], what: str) -> Iterator[None]:
    """Add the time spent to `seconds`."""
    started = time.perf_counter()
    yield
    seconds[what] += time.perf_counter() - started
