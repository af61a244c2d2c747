"""Frames that take time: the sensor or the part moves while the shutter is open.

A frame is the mean of instants: two Gauss points in each of equal parts of the exposure, so that
the smear of a line has the right width however few they are.  Instants close to each other share
the lit pixels and the ray maps of one of them, and see the part from where they are themselves.
"""

from __future__ import annotations

import math
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, replace
from itertools import pairwise
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import ArrayLike, NDArray
from virtual_sensor_plugins.drift import Drift
from virtual_sensor_plugins.exposure import ONE_FRAME
from virtual_sensor_plugins.renderer import Prepared

from virtual_sensor.arrays import number_within, vector_of, whole_number
from virtual_sensor.arrays import truth_of as boolean
from virtual_sensor.calls import public
from virtual_sensor.devices.exposure_time import exposure_time_s
from virtual_sensor.display import listed
from virtual_sensor.errors import InputError
from virtual_sensor.imaging.render import (
    DIRECT,
    DIRECT_SHARE,
    Frame,
    Image,
    PixelTruth,
    RenderReport,
    arrangement,
    checked,
    on_and_off,
    part_of,
    prepared_for,
    radii_mm,
    truth_of,
    with_layers,
)
from virtual_sensor.imaging.scene import Scene
from virtual_sensor.imaging.sequence import report_of_all
from virtual_sensor.optics.sight import check_progress
from virtual_sensor.poses import Pose

Array = NDArray[np.float64]

_GAUSS = 0.5 / math.sqrt(3.0)  # the two points of an interval of length 1, from its middle
_FEWEST = 2  # samples of an instant along each side of a pixel, if it has as many at rest
# Where instants with one sample have it within pixels: at Gauss points too, in an order in which
# neither coordinate goes with the time, nor with the other.
_WITHIN = _GAUSS * np.array([[1, 1, -1, -1, -1, -1, 1, 1], [1, -1, -1, 1, 1, -1, -1, 1]])
_STRATUM_PX = 1.0  # the image moves by no more within a part of the exposure
_DRIFT_PX = 4.0  # nor by more to either side of where lit pixels and maps are made
_MOST_INSTANTS = 4096
_MOST_BOUNCED = 64  # places from which light that bounces is rendered
_LONGEST_S = 3600.0
_FASTEST_MM_S = 1e7


@dataclass(frozen=True, eq=False)
class ExposedFrame(Frame):
    """A frame that took time, and the truth at the middle of each row's exposure.

    Attributes
    ----------
    radiance : ndarray of shape (H, W)
        W/(mm^2 sr), the mean over the pixel and the time in which its row was exposed.
    truth : PixelTruth
        Where the part was in the middle of each row's exposure, and what lit it then.
    radius_mm, report, background, direct, indirect, ghosts
        As those of a `Frame`; of ghosts the mean over the time.
    exposure_s : float
        Of each row.
    velocity_mm_s : ndarray of shape (3,)
        Of the part, world.
    row_time_s : float
        From the start of a row's exposure to the next row's; 0: a global shutter.
    instants : int
        Of each row, of which the frame is the mean.
    traces : int
        Places for which lit pixels were searched.
    """

    exposure_s: float = 0.0
    velocity_mm_s: Array = None  # type: ignore[assignment]
    row_time_s: float = 0.0
    instants: int = 1
    traces: int = 1

    def _line(self) -> str:
        speed = float(np.linalg.norm(self.velocity_mm_s))
        moved = f"{speed * self.exposure_s:.4g} mm of motion in {1e3 * self.exposure_s:.4g} ms"
        shutter = f"rows {1e6 * self.row_time_s:g} us apart" if self.row_time_s else ""
        return listed(super()._line(), moved, shutter, f"{self.instants} instants")


@public
def render_exposure(
    scene: Scene | str | Path,
    exposure_s: float | str | None = None,
    velocity_mm_s: ArrayLike = (0.0, 0.0, 0.0),
    *,
    row_time_s: float | None = None,
    instants: int | None = None,
    spp: int | None = None,
    seed: int = 0,
    background: bool = False,
    progress: Callable[[float], None] | None = None,
    camera: str | None = None,
    source: str | None = None,
) -> ExposedFrame:
    """Render a frame while the part moves past the sensor: smeared by its way, skewed by rows.

    The part is where the scene has it in the middle of the exposure of the film's middle row.  Its
    air and the scene's lamps move with it.  A sensor that moves by v over a part at rest sees the
    same as one at rest that the part passes by -v.

    >>> frame = vs.render_exposure("stepped_shaft", 2e-3, velocity_mm_s=(0, 100, 0))
    >>> rolling = vs.render_exposure(scene, 1e-3, (50, 0, 0), row_time_s=15e-6)

    Parameters
    ----------
    scene, spp, seed, camera, source
        As those of `render`; the instants share the samples of a pixel, and each has four at least,
        or as many as the scene has if these are fewer.
    exposure_s : float or str, optional
        How long each row is exposed, in s, or a text such as "2ms"; by default as the scene's
        camera says.
    velocity_mm_s : array_like of shape (3,)
        Of the part, world.
    row_time_s : float, optional
        From the start of a row's exposure to the next row's, as of a rolling shutter; of a negative
        one the last row is the first.  By default that of the camera's image sensor, else 0.
    instants : int, optional
        Of each row: by default so many that the image moves by half a pixel in between.
    background : bool
        Whether the frame's `background` is wanted: without the sources, as if they were off.
    progress : callable, optional
        Is called with the fraction done.

    Raises
    ------
    InputError
        As `render` does; and if a time or the velocity is no number, no exposure time is known, or
        the image would smear by thousands of px.
    EngineError
        If the scene was loaded under another Mitsuba variant.
    """
    check_progress("render_exposure", progress)
    boolean("render_exposure: background", background)
    scene, samples, seed = checked("render_exposure", scene, spp, seed, camera, source)
    known = scene.camera
    exposure_s = known.exposure_s if exposure_s is None else exposure_s
    if row_time_s is None:
        row_time_s = known.sensor.row_time_s if known.sensor else 0.0
    motion = _motion(exposure_s, velocity_mm_s, row_time_s)
    pixel_mm = _pixel_mm(scene)
    smear_px = motion.speed_mm_s * motion.exposure_s / pixel_mm
    if instants is None:
        instants = 2 * math.ceil(smear_px / _STRATUM_PX) if motion.speed_mm_s else 1
        if instants > _WITHIN.shape[1] / 2:
            instants = _WITHIN.shape[1] * math.ceil(instants / _WITHIN.shape[1])
        if instants > _MOST_INSTANTS:
            raise InputError(
                f"render_exposure: the image would smear by {smear_px:.0f} px; shorten exposure_s,"
                f" or say how many instants are to be rendered, up to {_MOST_INSTANTS}"
            )
    count = whole_number("render_exposure: instants", instants, 1, _MOST_INSTANTS)
    reach_mm = _DRIFT_PX * pixel_mm
    return _exposed(scene, motion, count, reach_mm, (samples, seed), background, progress)


@dataclass(frozen=True)
class _Motion:
    """How the part moves (world), and when rows are exposed."""

    exposure_s: float
    velocity_mm_s: Array
    row_time_s: float

    @property
    def speed_mm_s(self) -> float:
        return float(np.linalg.norm(self.velocity_mm_s))

    def middles_s(self, rows: int) -> Array:
        """When the middle of each row's exposure is, (rows,); 0 for the film's middle."""
        rows_from_middle = np.arange(rows, dtype=np.float64) - (rows - 1) / 2.0
        return rows_from_middle * self.row_time_s

    def sensor_shift_mm(self, time_s: float) -> Array:
        """Where the sensor is then, as seen from the part."""
        return -self.velocity_mm_s * time_s

    def drift(self, rows: slice, height: int, offset_s: float, from_s: float) -> Drift:
        """The sensor's way from where it is at an instant to where it is for each row.

        `offset_s` is the time after the middle of a row's exposure.
        """
        first_s = self.middles_s(height)[0] + offset_s - from_s
        per_row_mm = self.sensor_shift_mm(self.row_time_s)
        return Drift(self.sensor_shift_mm(first_s), per_row_mm, rows)


def _motion(exposure_s: Any, velocity_mm_s: Any, row_time_s: Any) -> _Motion:
    name = "render_exposure"
    exposure = exposure_time_s(f"{name}: exposure_s", exposure_s)
    if exposure is None:
        raise InputError(f"{name}: how long the part moves is not known; give exposure_s, as 2ms")
    velocity = vector_of(f"{name}: velocity_mm_s", velocity_mm_s)
    if np.linalg.norm(velocity) > _FASTEST_MM_S:
        raise InputError(f"{name}: velocity_mm_s is {velocity_mm_s}; give mm per s")
    row_time = number_within(
        f"{name}: row_time_s", row_time_s, -_LONGEST_S, _LONGEST_S, "a time in s, such as 15e-6"
    )
    return _Motion(exposure, velocity, row_time)


def _pixel_mm(scene: Scene) -> float:
    """A pixel's size on the part, about."""
    source = next(iter(scene.sources.values()), None)
    target = np.zeros(3) if source is None else source.target_mm
    size = float(scene.camera.pixel_mm(target[None])[0])
    return abs(size) or 1.0


def _instants(count: int) -> Array:
    """Of an exposure from -1/2 to 1/2: of an even number two Gauss points in each part."""
    if count % 2:
        return (np.arange(count) + 0.5) / count - 0.5
    middles = np.arange(count // 2)[:, None] + 0.5 + np.array([-_GAUSS, _GAUSS])
    return middles.ravel() / (count // 2) - 0.5


def _runs(number: NDArray[np.intp]) -> list[tuple[int, slice]]:
    """Runs of rows with the same number."""
    ends = [0, *(np.flatnonzero(np.diff(number)) + 1).tolist(), len(number)]
    return [(int(number[first]), slice(first, last)) for first, last in pairwise(ends)]


def _exposed(
    scene: Scene,
    motion: _Motion,
    count: int,
    reach_mm: float,
    sampling: tuple[int, int],
    background: bool,
    progress: Callable[[float], None] | None,
) -> ExposedFrame:
    """The frame: place by place of the sensor, the rows and instants that are near each."""
    width, height = scene.camera.size
    middles = motion.middles_s(height)
    moves = motion.speed_mm_s > 0.0
    window_s = 2.0 * reach_mm / motion.speed_mm_s if moves else math.inf
    offsets = motion.exposure_s * _instants(count)

    def places(offset_s: float) -> list[tuple[int, slice]]:
        return _runs(np.rint((middles + offset_s) / window_s).astype(int))

    work: dict[int, list[tuple[int, slice]]] = {}
    for number, offset in enumerate(offsets.tolist()):
        for place, rows in places(offset):
            work.setdefault(place, []).append((number, rows))
    truths = dict(places(0.0))
    bounces = scene.max_depth > DIRECT
    times_s = _bounced_times(motion, height, reach_mm / _DRIFT_PX) if bounces else np.zeros(0)
    apart = background or (bounces and bool(arrangement(scene).lamps))
    total = np.zeros((1 + apart, height, width), np.float32)
    known: list[PixelTruth] = []
    reports: list[RenderReport] = []
    done, whole = 0, count * height
    for place in sorted(work.keys() | truths.keys()):
        at_s = place * window_s if moves else 0.0
        moved = _moved(scene, motion.sensor_shift_mm(at_s))
        with ONE_FRAME:
            prepared = prepared_for(moved, drift_mm=reach_mm if moves else 0.0)
            for number, rows in work.get(place, ()):
                drift = motion.drift(rows, height, float(offsets[number]), at_s)
                image, report = _instant(prepared, sampling, count, number, drift, apart)
                total[:, rows] += image[:, rows]
                reports.append(report)
                done += rows.stop - rows.start
                if progress:
                    progress((DIRECT_SHARE if bounces else 1.0) * done / whole)
            if place in truths:
                drift = motion.drift(truths[place], height, 0.0, at_s)
                known.append(_at_rest(truth_of(prepared, drift), motion.sensor_shift_mm(at_s)))
    total /= count
    frame = ExposedFrame(
        total[0],
        _joined(known),
        radii_mm(scene),
        report_of_all(reports),
        total[1] if apart else None,
        exposure_s=motion.exposure_s,
        velocity_mm_s=motion.velocity_mm_s,
        row_time_s=motion.row_time_s,
        instants=count,
        traces=len(work),
    )
    if not bounces:
        return frame
    tell = part_of(progress, DIRECT_SHARE, 1.0)
    layered = with_layers(frame, _bounced(scene, motion, times_s, sampling[1], tell))
    assert isinstance(layered, ExposedFrame)
    return layered


def _bounced_times(motion: _Motion, height: int, pixel_mm: float) -> Array:
    """Ends of the times in which light that bounces is rendered once: the image moves by a pixel.

    Raises
    ------
    InputError
        If they are too many.
    """
    starts = motion.middles_s(height) - motion.exposure_s / 2.0
    first, last = float(starts.min()), float(starts.max()) + motion.exposure_s
    count = math.ceil((last - first) * motion.speed_mm_s / pixel_mm) or 1
    if count > _MOST_BOUNCED:
        raise InputError(
            f"render_exposure: while the frame is exposed the image moves by {count} px, and light"
            f" that bounces is rendered anew for each, up to {_MOST_BOUNCED}; give a shorter"
            " exposure_s, a slower part, a global shutter (row_time_s=0), or direct light alone"
            " (max_depth=2)"
        )
    return np.linspace(first, last, count + 1)


def _bounced(
    scene: Scene,
    motion: _Motion,
    times_s: Array,
    seed: int,
    progress: Callable[[float], None] | None,
) -> dict[str, Image]:
    """Moments of the light that bounces, by source: the mean over each row's exposure.

    From where the sensor is in the middle of times, each for the rows that are exposed in it.
    """
    starts = motion.middles_s(scene.camera.size[1]) - motion.exposure_s / 2.0
    total: dict[str, Image] = {}
    for number, (start, end) in enumerate(pairwise(times_s.tolist())):
        moved = _moved(scene, motion.sensor_shift_mm((start + end) / 2.0))
        ends = number / (times_s.size - 1), (number + 1) / (times_s.size - 1)
        with ONE_FRAME:
            moments = prepared_for(moved).indirect(seed, part_of(progress, *ends), moments=True)
        open_s = np.minimum(end, starts + motion.exposure_s) - np.maximum(start, starts)
        share = np.maximum(open_s / motion.exposure_s, 0.0).astype(np.float32)[:, None]
        for name, each in moments.items():
            total[name] = total.get(name, np.float32(0.0)) + share * each
    return total


def _moved(scene: Scene, shift_mm: Array) -> Scene:
    """The scene with all its devices moved; Mitsuba's own stay, and what is rendered is ours."""
    if not shift_mm.any():
        return scene
    motion = Pose.shift(shift_mm)

    def moved(devices: Mapping[str, Any]) -> dict[str, Any]:
        return {name: each.with_pose(each.pose.moved(motion)) for name, each in devices.items()}

    return replace(scene, cameras=moved(scene.cameras), sources=moved(scene.sources))


def _instant(
    prepared: Prepared,
    sampling: tuple[int, int],
    count: int,
    number: int,
    drift: Drift,
    background: bool,
) -> tuple[Image, RenderReport]:
    """The images of one of so many instants, (frames, H, W), by its share of the samples."""
    spp, seed = sampling
    spp = spp or int(prepared.arrangement.sensor.sampler().sample_count())
    share = max(math.ceil(math.sqrt(spp / count)), min(_FEWEST, math.isqrt(spp))) ** 2
    if count == 1:
        share = spp
    elif prepared.pupil is not None:  # whose points cover a pixel
        pass
    elif share == 1:
        u, v = _WITHIN[:, number % _WITHIN.shape[1]].tolist()
        drift = replace(drift, within_px=(u, v))
    else:  # such that they cover a pixel as all its samples on a grid would
        drift = replace(drift, spread=math.sqrt((1.0 - 1.0 / spp) / (1.0 - 1.0 / share)))
    fluxes = {n: on_and_off(each) for n, each in prepared.arrangement.sources.items() if background}
    exposure, report = prepared.exposed(
        share, seed, frames=1 + background, fluxes=fluxes, drift=drift
    )
    return exposure.images(), report


def _at_rest(truth: PixelTruth, shift_mm: Array) -> PixelTruth:
    """The truth as seen by the sensor where the scene has it."""
    point = (truth.point_mm - shift_mm).astype(np.float32)
    return replace(truth, point_mm=point)


def _joined(truths: Sequence[PixelTruth]) -> PixelTruth:
    """The truth of the rows of several."""
    first = truths[0]
    if len(truths) == 1:
        return first
    index = np.concatenate([each.index for each in truths])
    order = np.argsort(index, kind="stable")

    def joined(parts: Sequence[NDArray]) -> NDArray:
        return np.concatenate(parts)[order]

    return PixelTruth(
        index[order],
        joined([each.point_mm for each in truths]),
        joined([each.depth_mm for each in truths]),
        {n: joined([t.source_coordinates[n] for t in truths]) for n in first.source_coordinates},
        {n: joined([t.status[n] for t in truths]) for n in first.status},
        report_of_all([each.report for each in truths]),
    )
