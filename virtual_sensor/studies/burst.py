"""A burst of frames of air that moves: how much the line and the points measured on it sway."""

from __future__ import annotations

import time
from collections import Counter
from collections.abc import Callable, Iterator, Sequence
from contextlib import contextmanager
from dataclasses import dataclass
from enum import IntEnum
from functools import cached_property
from typing import TYPE_CHECKING, Any

import numpy as np
from numpy.typing import ArrayLike, NDArray

from virtual_sensor.display import Displayed, listed
from virtual_sensor.errors import InputError, NothingFoundError
from virtual_sensor.imaging.checks import check_scene
from virtual_sensor.imaging.recording_options import RecordingOptions
from virtual_sensor.imaging.render import Frame
from virtual_sensor.imaging.scene import Scene
from virtual_sensor.medium.netcdf import field_times
from virtual_sensor.metrology.centres import LineCentres, Status
from virtual_sensor.metrology.deviation import UM_PER_MM
from virtual_sensor.metrology.line_peaks import line_centres
from virtual_sensor.metrology.triangulation import triangulate
from virtual_sensor.optics.ray_search import FoundPixels, SearchStatus, ray_search
from virtual_sensor.records import Record, Table, status_names
from virtual_sensor.studies.ghosts import GhostFacts, bounces, ghost_facts
from virtual_sensor.studies.measure import Report
from virtual_sensor.studies.notes import coarse_grid, unlit_rays
from virtual_sensor.studies.probes import probe_rays
from virtual_sensor.studies.provenance import SceneFacts, scene_facts
from virtual_sensor.studies.section import Section, SectionErrors, section_errors, true_section

if TYPE_CHECKING:
    from virtual_sensor.imaging.recording import RecordedFrame

MIN_FRAMES = 3
"""With fewer frames a standard deviation says nothing: it is NaN."""

_VIEWS = 3  # frames that are shown
_MARGIN_PX = 12  # around what is lit in them

Array = NDArray[np.float64]
Image = NDArray[np.float32]
EachFrame = Callable[[int, float, Frame, "RecordedFrame | None"], None]
"""Called with each frame's number and instant in s, the frame itself, and as it was recorded."""


@dataclass(frozen=True)
class Spread(Displayed):
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
class Views(Displayed):
    """Some frames of a burst, cut to what is lit, and the mean of all frames there.

    Attributes
    ----------
    first_row, first_column : int
        Of the cut.
    mean : ndarray of shape (H, W)
        Radiance, W/(mm^2 sr), averaged over all frames.
    radiance : dict of ndarray of shape (H, W)
        Of some frames, by their instants in s.
    """

    first_row: int
    first_column: int
    mean: Image
    radiance: dict[float, Image]


@dataclass(frozen=True)
class SwayTable(Table):
    """Mean and standard deviation of the line's centre and its point, a row for each image column.

    Attributes
    ----------
    column : ndarray of int of shape (W,)
        Of the image.
    frames : ndarray of int of shape (W,)
        Frames in which a centre was found; of fewer than three there are no figures.
    mean_v_px, std_v_px : ndarray of shape (W,)
        Row of the line's centre, its mean and standard deviation.
    y_mm : ndarray of shape (W,)
        Position of the mean point along the line, as that of probe rays.
    mean_mm : ndarray of shape (W, 3)
        The measured point, world, averaged.
    mean_height_mm : ndarray of shape (W,)
        Height of the measured point against the laser's axis, averaged.
    std_um : ndarray of shape (W, 3)
        Standard deviation of the measured point.
    std_height_um : ndarray of shape (W,)
        Standard deviation of the measured point's height.
    static_error_um : ndarray of shape (W,)
        Distance of the mean point from the part's true section, positive outside the part.
    std_ideal_v_px : ndarray of shape (W,)
        Of recorded frames: standard deviation of the centre in the ideal ones, by moving air alone.
    std_noise_v_px : ndarray of shape (W,)
        Of recorded frames: standard deviation of the centre minus that in the ideal one, by the
        sensor alone.
    status : ndarray of str of shape (W,)
        "ok", or what most frames have there: another centre ("clipped", "corrected"), or none.
    """

    column: NDArray[np.int64]
    frames: NDArray[np.int64]
    mean_v_px: Array
    std_v_px: Array
    y_mm: Array
    mean_mm: Array
    mean_height_mm: Array
    std_um: Array
    std_height_um: Array
    static_error_um: Array
    std_ideal_v_px: Array | None
    std_noise_v_px: Array | None
    status: NDArray[np.str_]


@dataclass(frozen=True)
class RayTable(Table):
    """Mean and standard deviation of the probe rays' pixels and points, a row for each ray.

    Attributes
    ----------
    y_mm : ndarray of shape (N,)
        Position along the line.
    frames : ndarray of int of shape (N,)
        Frames in which a pixel was found.
    mean_px, std_px : ndarray of shape (N, 2)
        The pixel that sees the ray, its mean and standard deviation.
    mean_incidence_mm : ndarray of shape (N, 3)
        B, where the ray meets the part, world, averaged.
    mean_incidence_height_mm : ndarray of shape (N,)
        Height of B against the laser's axis, averaged.
    std_incidence_um : ndarray of shape (N, 3)
        Standard deviation of B.
    std_incidence_height_um : ndarray of shape (N,)
        Standard deviation of the height of B.
    mean_measured_mm : ndarray of shape (N, 3)
        B_m, the point measured of it, world, averaged.
    mean_measured_height_mm : ndarray of shape (N,)
        Height of B_m against the laser's axis, averaged.
    std_measured_um : ndarray of shape (N, 3)
        Standard deviation of B_m.
    std_measured_height_um : ndarray of shape (N,)
        Standard deviation of the height of B_m.
    mean_error_um, std_error_um : ndarray of shape (N,)
        Height of B_m above B, its mean and standard deviation.
    status : ndarray of str of shape (N,)
        "found", or why most frames have no pixel for it.
    """

    y_mm: Array
    frames: NDArray[np.int64]
    mean_px: Array
    std_px: Array
    mean_incidence_mm: Array
    mean_incidence_height_mm: Array
    std_incidence_um: Array
    std_incidence_height_um: Array
    mean_measured_mm: Array
    mean_measured_height_mm: Array
    std_measured_um: Array
    std_measured_height_um: Array
    mean_error_um: Array
    std_error_um: Array
    status: NDArray[np.str_]


@dataclass(frozen=True)
class FrameTable(Table):
    """Every frame's centres and points, a row for each frame and column.

    Attributes
    ----------
    time_s : ndarray of shape (M,)
        Flow time of the frame.
    column : ndarray of int of shape (M,)
        Of the image.
    row, sigma : ndarray of shape (M,)
        The line's centre, px, and the standard deviation that its detector expects of it.
    point_mm : ndarray of shape (M, 3)
        The measured point, world.
    status : ndarray of str of shape (M,)
        "ok", "clipped" or "corrected", or why there is no centre.
    """

    time_s: Array
    column: NDArray[np.int64]
    row: Array
    sigma: Array
    point_mm: Array
    status: NDArray[np.str_]


@dataclass(frozen=True)
class Sway(Record):
    """Standard deviations over the frames of one quantity, in that quantity's unit.

    Attributes
    ----------
    median, largest : float
        Along the line.
    largest_y_mm : float
        Where the largest is: y along the line, from its middle.
    largest_frames : int
        In how many frames there is a value there.
    """

    median: float
    largest: float
    largest_y_mm: float
    largest_frames: int


@dataclass(frozen=True)
class LineSway(Record):
    """The sway of the line that is found in the frames.

    Attributes
    ----------
    v_px : Sway
        Of the centre's row.
    y_um, height_um : Sway
        Of the measured point: along y, world, and against the laser's axis.
    ideal_v_px, noise_v_px : Sway or None
        Of the centre's row by moving air alone, and by the sensor alone; None where nothing was
        recorded.
    """

    v_px: Sway
    y_um: Sway
    height_um: Sway
    ideal_v_px: Sway | None
    noise_v_px: Sway | None


@dataclass(frozen=True)
class RaySway(Record):
    """The sway of the probe rays.

    Attributes
    ----------
    u_px, v_px : Sway
        Of the pixel that sees a ray.
    measured_height_um : Sway
        Of the measured point's height, against the laser's axis.
    status : dict
        How many rays have each status.
    """

    u_px: Sway
    v_px: Sway
    measured_height_um: Sway
    status: dict[str, int]


@dataclass(frozen=True)
class BurstField(Record):
    """The field of a burst.

    Attributes
    ----------
    file, source : str
        Its path, and where it says that it comes from.
    instants : int
        That it holds.
    first_s, last_s : float
        Flow time of the first and the last of them.
    """

    file: str
    source: str
    instants: int
    first_s: float
    last_s: float


@dataclass(frozen=True)
class BurstSummary(SceneFacts):
    """What sways how much.

    Attributes
    ----------
    field : BurstField
        The air.
    frames : int
        Their number.
    first_frame_s, last_frame_s : float
        Their flow times.
    columns : dict
        How many of the image's columns have each status.
    columns_in_every_frame : int
        Columns in which every frame has a centre.
    line : LineSway
        The line that is found in the frames.
    rays : RaySway
        The probe rays.
    ghosts : GhostFacts or None
        What of the first frame's light was reflected in between; None of direct light alone.
    static_error : SectionErrors
        The mean points beside the part's true section: the error that stays.
    static_error_at_largest_um : float
        Distance of the mean point from the true section where the height sways most.
    stage_s : dict
        Time spent on field, search, render and centres, in all frames.
    time_per_frame_s : float
        Time spent on a frame, all stages together.
    """

    field: BurstField
    frames: int
    first_frame_s: float
    last_frame_s: float
    columns: dict[str, int]
    columns_in_every_frame: int
    line: LineSway
    rays: RaySway
    ghosts: GhostFacts | None
    static_error: SectionErrors
    static_error_at_largest_um: float
    stage_s: dict[str, float]
    time_per_frame_s: float


@dataclass(frozen=True)
class Burst(Displayed):
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
    views : Views
    notes : tuple of str
        What the user should know.
    stage_s : dict
        Time spent on field, render, record, centres and search, over all frames, s.
    ideal : tuple of F LineCentres
        The line in the ideal frames, where they were recorded; else empty.
    ghosts : GhostFacts or None
        What of the first frame's light was reflected in between; None of direct light alone.
    """

    scene: Scene
    time_s: Array
    stored_s: Array
    lines: tuple[LineCentres, ...]
    rays: tuple[FoundPixels, ...]
    probe_y_mm: Array
    views: Views
    notes: tuple[str, ...]
    stage_s: dict[str, float]
    ideal: tuple[LineCentres, ...] = ()
    ghosts: GhostFacts | None = None

    def _line(self) -> str:
        span_s = f"{self.time_s.min():g} to {self.time_s.max():g} s" if self.time_s.size else ""
        return listed(self.scene.path.name, f"{self.time_s.size} frames", span_s)

    def _columns(self) -> dict[str, NDArray[Any]]:
        return self.sway_table.columns()

    @property
    def up(self) -> Array:
        """Unit vector (3,), world, against the laser's axis: in it heights are measured."""
        return -self.scene.sensor.laser.pose.rotation[:, 2]

    @property
    def centres_px(self) -> Array:
        """(u, v) of the line in every column of every frame; shape (F, W, 2)."""
        return _stacked(self.lines, "pixel")

    @cached_property
    def points_mm(self) -> Array:
        """Triangulated from them, world, mm; shape (F, W, 3)."""
        return triangulate(self.scene.sensor, self.centres_px)

    @property
    def rays_px(self) -> Array:
        """Pixels that see the probe rays; shape (F, N, 2)."""
        return _stacked(self.rays, "pixel")

    @cached_property
    def sway_table(self) -> SwayTable:
        """The line's sway in every column."""
        line, points = spread(self.centres_px), _of_points("", self.points_mm, self.up)
        ideal_px = _stacked(self.ideal, "pixel") if self.ideal else None
        return SwayTable(
            column=self.lines[0].column,
            frames=line.frames,
            mean_v_px=line.mean[:, 1],
            std_v_px=line.std[:, 1],
            y_mm=self._section.along_mm(points["mean_mm"]),
            **points,
            static_error_um=self._section.distance_um(points["mean_mm"]),
            std_ideal_v_px=None if ideal_px is None else spread(ideal_px).std[:, 1],
            std_noise_v_px=None
            if ideal_px is None
            else spread(self.centres_px - ideal_px).std[:, 1],
            status=_commonest(_stacked(self.lines, "status"), Status),
        )

    @cached_property
    def ray_table(self) -> RayTable:
        """The sway of the probe rays."""
        pixel = spread(self.rays_px)
        incidence_mm = _stacked(self.rays, "laser_point_mm")
        measured_mm = triangulate(self.scene.sensor, self.rays_px)
        error = spread((measured_mm - incidence_mm) @ self.up[:, None] * UM_PER_MM)
        return RayTable(
            y_mm=self.probe_y_mm,
            frames=pixel.frames,
            mean_px=pixel.mean,
            std_px=pixel.std,
            **_of_points("incidence_", incidence_mm, self.up),
            **_of_points("measured_", measured_mm, self.up),
            mean_error_um=error.mean[:, 0],
            std_error_um=error.std[:, 0],
            status=_commonest(_stacked(self.rays, "status"), SearchStatus),
        )

    @cached_property
    def frame_table(self) -> FrameTable:
        """All centres and points."""
        return FrameTable(
            time_s=np.repeat(self.time_s, len(self.lines[0].column)),
            column=_stacked(self.lines, "column").ravel(),
            row=_stacked(self.lines, "row").ravel(),
            sigma=_stacked(self.lines, "sigma").ravel(),
            point_mm=self.points_mm.reshape(-1, 3),
            status=status_names(_stacked(self.lines, "status"), Status),
        )

    @cached_property
    def summary(self) -> BurstSummary:
        """The figures of the burst, from its tables."""
        line, rays, frames = self.sway_table, self.ray_table, len(self.time_s)
        height = _sway(line, line.std_height_um)
        at = np.flatnonzero(line.std_height_um == height.largest)
        return BurstSummary(
            **vars(scene_facts(self.scene, self.notes)),
            field=BurstField(
                file=str(self.scene.air.path),
                source=self.scene.field.source if self.scene.field else "",
                instants=len(self.stored_s),
                first_s=float(self.stored_s[0]),
                last_s=float(self.stored_s[-1]),
            ),
            frames=frames,
            first_frame_s=float(self.time_s[0]),
            last_frame_s=float(self.time_s[-1]),
            columns=dict(Counter(line.status.tolist())),
            columns_in_every_frame=int(np.sum(line.frames == frames)),
            line=LineSway(
                v_px=_sway(line, line.std_v_px),
                y_um=_sway(line, line.std_um[:, 1]),
                height_um=height,
                ideal_v_px=_of_column(line, line.std_ideal_v_px),
                noise_v_px=_of_column(line, line.std_noise_v_px),
            ),
            rays=RaySway(
                u_px=_sway(rays, rays.std_px[:, 0]),
                v_px=_sway(rays, rays.std_px[:, 1]),
                measured_height_um=_sway(rays, rays.std_measured_height_um),
                status=dict(Counter(rays.status.tolist())),
            ),
            ghosts=self.ghosts,
            static_error=section_errors(self._section, line.mean_mm),
            static_error_at_largest_um=float(line.static_error_um[at[0]]) if at.size else np.nan,
            stage_s={name: round(value, 2) for name, value in self.stage_s.items()},
            time_per_frame_s=round(sum(self.stage_s.values()) / frames, 2),
        )

    @cached_property
    def _section(self) -> Section:
        return true_section(self.scene)


def _stacked(frames: Sequence[LineCentres | FoundPixels], name: str) -> NDArray[Any]:
    """What is known of each frame under a name; (F, ...)."""
    return np.stack([getattr(each, name) for each in frames])


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
            " of two instants or more (in a shipped scene, name it by -D field=FILE)"
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
    each_frame: EachFrame = lambda number, instant_s, frame, shot: None,
    recording: RecordingOptions | None = None,
) -> Burst:
    """Render frames of moving air, record them, find the line in each, and search the probe rays.

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
        Called with what is being done, and the fraction of the whole that is done.
    y_mm : array_like of shape (N,), optional
        Positions of the probe rays along the line, mm; by default the scene's own (`probe_rays`).
    each_frame : callable
        Called with each frame (see `EachFrame`); afterwards it is gone.
    recording : RecordingOptions, optional
        How the frames are recorded, each with noise of its own, all of one surface; by default as
        the scene's camera says, ideally if it has no sensor.

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
    recording = recording or RecordingOptions()
    stage_s = dict.fromkeys(("field", "search", "render", "record", "centres"), 0.0)
    lines, rays, ideal, of_shots = [], [], [], list[str]()
    y = probe_rays(scene, y_mm)
    notes = [*scene.loading_notes, *unlit_rays(laser, y), *coarse_grid(scene)]
    notes += [*_coarse_instants(times, stored), *recording.unheeded(scene), *bounces(scene)]
    at_border, ghosts = list[str](), None
    shown = np.linspace(0, frames - 1, _VIEWS).round()
    total, some = np.zeros(scene.camera.size[::-1]), dict[float, Image]()
    for number, instant in enumerate(times.tolist()):

        def tell(part: float, number: int = number, instant: float = instant) -> None:
            report(f"frame {number + 1} of {frames}, {instant:.3f} s", (number + part) / frames)

        one = _one_frame(scene, y, instant, tell, stage_s, recording, number)
        frame, shot, line, without_noise, found, border = one
        lines.append(line)
        if shot is not None:
            ideal.append(without_noise)
            of_shots += [f"at {instant:g} s: {text}" for text in shot.notes]
        rays.append(found)
        total += frame.radiance
        ghosts = ghosts if number else ghost_facts(frame)
        if number in shown:
            some[instant] = frame.radiance
        each_frame(number, instant, frame, shot)
        # At one instant: at the others it is much the same.
        at_border = at_border or [f"at {instant:g} s: {text}" for text in border]
    notes += [*at_border, *of_shots[:1]]
    if len(of_shots) > 1:
        notes.append(f"so it is of {len(of_shots)} frames; expose them otherwise")
    views = _views(total / frames, some)
    found_lines = tuple(lines), tuple(rays)
    of_frames = *found_lines, y, views, tuple(notes)
    return Burst(scene, times, stored, *of_frames, stage_s, tuple(ideal), ghosts)


def _one_frame(
    scene: Scene,
    y: Array,
    instant: float,
    tell: Callable[[float], None],
    stage_s: dict[str, float],
    recording: RecordingOptions,
    number: int,
) -> tuple[Frame, RecordedFrame | None, LineCentres, LineCentres, FoundPixels, list[str]]:
    """Frame, as recorded, its line, that of the ideal frame, probe rays and notes of one instant.

    `stage_s` grows by what each part took.
    """
    tell(0.0)
    with _timed(stage_s, "field"):
        now = scene.at(instant)
    with _timed(stage_s, "search"):
        notes = check_scene(now)
        found = ray_search(now, y, "newton")
    tell(0.1)
    with _timed(stage_s, "render"):
        frame = recording.rendered(now, lambda part: tell(0.3 + 0.6 * part))
    with _timed(stage_s, "record"):
        shot = recording.recorded(now, frame, number, now.camera_name, now.source_name)
    with _timed(stage_s, "centres"):
        ideal = line_centres(frame.radiance)
        line = ideal if shot is None else line_centres(shot)
    tell(1.0)
    if not line.found.any():
        why = f" (of the recorded one: {', '.join(shot.notes)})" if shot and shot.notes else ""
        raise NothingFoundError(
            f"{scene.path}: no line in the frame at {instant:g} s{why}; give a wider or longer line"
            " (line_radius, line_length), or more samples (spp)"
        )
    return frame, shot, line, ideal, found, notes


def _views(mean: Array, some: dict[float, Image]) -> Views:
    """Frames and the mean of all, cut to what is lit."""
    rows, columns = (
        slice(max(int(lit.min()) - _MARGIN_PX, 0), int(lit.max()) + _MARGIN_PX + 1)
        for lit in np.nonzero(mean > 0.01 * mean.max())
    )
    cut = {instant_s: radiance[rows, columns] for instant_s, radiance in some.items()}
    return Views(rows.start, columns.start, mean[rows, columns].astype(np.float32), cut)


def spread(values: Array) -> Spread:
    """Mean and standard deviation of values (F, N, K) over the frames in which they are finite."""
    known = np.isfinite(values).all(axis=-1, keepdims=True)
    frames = known.sum(axis=0)
    divisor = np.where(frames >= MIN_FRAMES, frames, np.nan)
    mean = np.where(known, values, 0.0).sum(axis=0) / divisor
    squares = np.where(known, values - mean, 0.0) ** 2
    return Spread(mean, np.sqrt(squares.sum(axis=0) / (divisor - 1.0)), frames[:, 0])


def _of_points(of: str, points_mm: Array, up: Array) -> dict[str, Array]:
    """Columns of a table for points (F, N, 3): mean and deviation, of their height too."""
    points = spread(np.concatenate([points_mm, (points_mm @ up)[..., None]], axis=-1))
    std_um = points.std * UM_PER_MM
    return {
        f"mean_{of}mm": points.mean[:, :3],
        f"mean_{of}height_mm": points.mean[:, 3],
        f"std_{of}um": std_um[:, :3],
        f"std_{of}height_um": std_um[:, 3],
    }


def _sway(table: SwayTable | RayTable, std: Array) -> Sway:
    """Median and maximum of the finite ones, and where that is; NaN where there are none."""
    known = np.flatnonzero(np.isfinite(std))
    if not known.size:
        return Sway(np.nan, np.nan, np.nan, 0)
    at = known[np.argmax(std[known])]
    median = float(np.median(std[known]))
    return Sway(median, float(std[at]), float(table.y_mm[at]), int(table.frames[at]))


def _of_column(table: SwayTable, std: Array | None) -> Sway | None:
    return None if std is None else _sway(table, std)


def _coarse_instants(times: Array, stored: Array) -> list[str]:
    """Note of instants so far apart that the frames between them sway too little."""
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
def _timed(stage_s: dict[str, float], what: str) -> Iterator[None]:
    """Add the time spent to `stage_s`."""
    started = time.perf_counter()
    yield
    stage_s[what] += time.perf_counter() - started
