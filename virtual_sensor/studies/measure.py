"""The main job: measure a part cold and hot by rendered frames, beside the ray-by-ray search.

The line is found in the ideal frames or, if a recording is asked for, in the grey values that the
camera's sensor makes of them; then the error of what is measured is split into its parts.
"""

from __future__ import annotations

import time
from collections.abc import Callable, Mapping
from dataclasses import asdict, dataclass, field, fields, replace
from functools import cached_property
from typing import TYPE_CHECKING, Annotated, Any

import numpy as np
from numpy.typing import ArrayLike, NDArray

from virtual_sensor.display import Displayed, listed
from virtual_sensor.errors import InputError
from virtual_sensor.imaging.checks import check_scene
from virtual_sensor.imaging.dark_frames import why_dark
from virtual_sensor.imaging.recording_options import RecordingOptions
from virtual_sensor.imaging.render import Frame, RenderReport
from virtual_sensor.imaging.scene import Scene
from virtual_sensor.medium.index_field import IndexField
from virtual_sensor.metrology.centres import LineCentres, Status
from virtual_sensor.metrology.deviation import (
    LETTERS,
    Deviation,
    deviations,
    euclidean,
    round_pixel,
    separate_paths,
)
from virtual_sensor.metrology.dot_peaks import dot_centres
from virtual_sensor.metrology.line_peaks import line_centres
from virtual_sensor.metrology.triangulation import triangulate
from virtual_sensor.metrology.truth import (
    DotErrors,
    LineErrors,
    TrueLine,
    TruthStatus,
    compare_dots,
    compare_line,
    largest,
    rms,
)
from virtual_sensor.optics.field_border import FACES
from virtual_sensor.optics.pupil_search import PupilPixels, pupil_search
from virtual_sensor.optics.ray_search import FoundPixels, SearchStatus, ray_search
from virtual_sensor.records import WITH_NORM, Record, Table, counts_of, status_names
from virtual_sensor.studies.error_split import (
    ErrorSplit,
    SplitSummary,
    half_a_pixel_lower,
    in_16_bits,
    nearest_rows,
    rows_through_pupil,
    split_error,
    split_summary,
)
from virtual_sensor.studies.ghosts import GhostFacts, bounces, ghost_facts
from virtual_sensor.studies.notes import (
    beside_solid,
    centre_notes,
    coarse_grid,
    frame_notes,
    unlit_rays,
    unsplit,
    upright_line,
)
from virtual_sensor.studies.probes import dense_rays, probe_rays
from virtual_sensor.studies.provenance import SceneFacts, scene_facts
from virtual_sensor.studies.section import (
    Section,
    SectionErrors,
    longest_gap,
    section_errors,
    true_section,
)

if TYPE_CHECKING:
    from virtual_sensor.imaging.recording import RecordedFrame

Array = NDArray[np.float64]
Texts = NDArray[np.str_]
Report = Callable[[str, float], None]
"""Called with what is being done, and the fraction of the whole that is done."""

ROUNDED_PX = 0.25
"""Step of the paper's sub-pixel detection (section 4.2)."""


@dataclass(frozen=True)
class State(Displayed):
    """One measurement, of the part cold or hot.

    Attributes
    ----------
    scene : Scene
    frame : Frame
    line : LineCentres
    paper, newton : FoundPixels
        The probe rays, by the paper's search and by Newton's.
    dense : FoundPixels
        Rays along the whole line, or one at each dot, by Newton's search.
    by_frame : LineErrors
        The line centres beside the frame's own truth, those that an edge cuts among them.
    compared : LineErrors or DotErrors
        Rendered line minus dense search, through the lens where there is one; or of a laser that
        makes dots, their centroids minus it.
    section : Section
        The true one.
    search_time_s, render_time_s : float
    shot : RecordedFrame or None
        The frame as it was recorded, in which the line was found; None: in the ideal one.
    split : ErrorSplit or None
        What the error of the points is made of; None where nothing was recorded.
    record_time_s : float or None
        Time that recording took.
    """

    scene: Scene
    frame: Frame
    line: LineCentres
    paper: FoundPixels
    newton: FoundPixels
    dense: FoundPixels
    by_frame: LineErrors
    compared: LineErrors | DotErrors
    section: Section
    search_time_s: float
    render_time_s: float
    shot: RecordedFrame | None = None
    split: ErrorSplit | None = None
    record_time_s: float | None = None

    def _line(self) -> str:
        return listed(self.line._line(), f"rendered in {self.render_time_s:.3g} s")

    def _columns(self) -> dict[str, NDArray[Any]]:
        return (dot_table(self) if self.dots else line_table(self)).columns()

    @property
    def dots(self) -> DotErrors | None:
        """The dots beside the search; None of a line."""
        return self.compared if isinstance(self.compared, DotErrors) else None

    @property
    def by_search(self) -> LineErrors | None:
        """The line beside the search; None of dots."""
        return self.compared if isinstance(self.compared, LineErrors) else None

    @property
    def centres_px(self) -> Array:
        """What the image gives, (u, v): the line's centre in each column, or the dots; (N, 2)."""
        return self.dots.pixel if self.dots else self.line.pixel

    @property
    def brightness(self) -> Array:
        """How bright the line is there, or the dots; (N,)."""
        return self.dots.flux if self.dots else self.line.amplitude

    @property
    def centres(self) -> int:
        """How many of them were found."""
        return int(np.isfinite(self.centres_px[:, 1]).sum())

    @cached_property
    def points_mm(self) -> Array:
        """Triangulated from them, world, mm; (N, 3)."""
        return triangulate(self.scene.sensor, self.centres_px)

    @cached_property
    def section_error_um(self) -> Array:
        """Their distances (N,) from the true section: positive outside the part."""
        return self.section.distance_um(self.points_mm)

    @cached_property
    def searched_mm(self) -> Array:
        """Triangulated from the pixels of the dense search, (M, 3)."""
        return triangulate(self.scene.sensor, self.dense.pixel)

    @cached_property
    def searched_error_um(self) -> Array:
        """Their distances (M,) from the true section."""
        return self.section.distance_um(self.searched_mm)

    @property
    def gap_y_mm(self) -> tuple[float, float]:
        """Ends of the longest stretch of the line on which no point is measured."""
        return longest_gap(*map(self.section.along_mm, (self.searched_mm, self.points_mm)))

    @cached_property
    def laser_path_um(self) -> Array:
        """What they would be (M,) if the laser's light alone were bent."""
        straight = self.scene.sensor.camera.project(self.dense.laser_point_mm)
        straight[np.isnan(self.dense.pixel)] = np.nan
        return self.section.distance_um(triangulate(self.scene.sensor, straight))

    @property
    def camera_path_um(self) -> Array:
        """What the camera's bent lines of sight add to that, (M,)."""
        return self.searched_error_um - self.laser_path_um


@dataclass(frozen=True)
class Measurement(Displayed):
    """The part measured cold and, if the scene has a field, hot.

    Attributes
    ----------
    cold : State
    hot : State or None
    probe_y_mm, dense_y_mm : ndarray
        The rays' positions along the line.
    notes : tuple of str
        What the user should know.
    caveats : tuple of str
        Those of the notes that make the figures worth little.
    time_s : float
        Of the whole.
    """

    cold: State
    hot: State | None
    probe_y_mm: Array
    dense_y_mm: Array
    notes: tuple[str, ...]
    caveats: tuple[str, ...]
    time_s: float

    def _line(self) -> str:
        found = (f"{name} {state.centres} centres" for name, state in self.states.items())
        notes = f"{len(self.notes)} notes" if self.notes else ""
        return listed(self.scene.path.name, *found, f"{self.time_s:.3g} s", notes)

    def _columns(self) -> dict[str, NDArray[Any]]:
        columns = [state._columns() for state in self.states.values()]
        lengths = [len(next(iter(each.values()))) for each in columns]
        named = {name: np.concatenate([each[name] for each in columns]) for name in columns[0]}
        return {"state": np.repeat([*self.states], lengths), **named}

    @property
    def scene(self) -> Scene:
        """The scene that was given."""
        return (self.hot or self.cold).scene

    @property
    def rays(self) -> int:
        """Rays that were searched in each state."""
        return 2 * len(self.probe_y_mm) + len(self.dense_y_mm)

    @property
    def states(self) -> dict[str, State]:
        """The states by name."""
        return {"cold": self.cold} | ({"hot": self.hot} if self.hot else {})

    @property
    def centres(self) -> int:
        """Line centres, or dots, that were found in all."""
        return sum(state.centres for state in self.states.values())


def measure(
    scene: Scene,
    report: Report = lambda stage, fraction: None,
    y_mm: ArrayLike | None = None,
    recording: RecordingOptions | None = None,
) -> Measurement:
    """Render, record, find the line, triangulate, search: first cold, then hot.

    Parameters
    ----------
    scene : Scene
    report : callable
        Called with what is being done, and the fraction of the whole that is done.
    y_mm : array_like of shape (N,), optional
        Positions of the probe rays along the line, mm; by default the scene's own (`probe_rays`).
    recording : RecordingOptions, optional
        How the frames are recorded; by default as the scene's camera says, ideally if it has no
        sensor.

    Raises
    ------
    InputError
        If a ray's position is not finite, the scene can't be measured (see `imaging.checks`), its
        frame stays black, or can't be recorded so.
    """
    started = time.perf_counter()
    report("checking the scene", 0.0)
    laser = scene.sensor.laser
    notes, caveats = [*scene.loading_notes, *check_scene(scene)], []
    probe_y = probe_rays(scene, y_mm)
    coarse = coarse_grid(scene)
    options = recording or RecordingOptions()
    notes += [*unlit_rays(laser, probe_y), *coarse, *options.unheeded(scene), *bounces(scene)]
    caveats += [note for note, poor in coarse.items() if poor]
    dense_y = laser.dots_mm if laser.dots_mm.size else dense_rays(scene)
    section = true_section(scene)
    share = 0.15 if scene.field else 1.0  # of the time that the cold part takes

    def state(name: str, scene: Scene, low: float, high: float) -> State:
        return _measure_state(
            scene,
            probe_y,
            dense_y,
            section,
            lambda stage, part: report(f"{name} part: {stage}", low + (high - low) * part),
            options,
            name,
            None if name == "cold" else cold.dense,
        )

    cold = state("cold", scene.cold(), 0.0, share)
    hot = state("hot", scene, share, 1.0) if scene.field else None
    beside = beside_solid(scene, cold.dense.laser_point_mm)
    notes, caveats = [*notes, *beside], [*caveats, *beside]
    of_states: dict[str, list[str]] = {}
    for name, each in (("cold", cold), ("hot", hot)):
        if each:
            words = [] if each.dots else upright_line(each.dense, each.scene.camera_element)
            words += [*frame_notes(each.frame.report), *(each.shot.notes if each.shot else ())]
            beside_truth = each.line, each.compared, each.by_frame, each.gap_y_mm
            speckled = each.shot is not None and each.shot.speckled is not None
            judged = centre_notes(*beside_truth, speckled)
            words += unsplit(each.split) if each.split else []
            for word in [*words, *judged]:
                of_states.setdefault(word, []).append(name)
            caveats += [f"{name}: {word}" for word, poor in judged.items() if poor]
    for word, names in of_states.items():
        own = [f"{name}: {word}" for name in names]
        notes += own if len(own) == 1 or set(own) & set(caveats) else [word]
    seconds = time.perf_counter() - started
    return Measurement(cold, hot, probe_y, dense_y, tuple(notes), tuple(caveats), seconds)


def _measure_state(
    scene: Scene,
    probe_y: Array,
    dense_y: Array,
    section: Section,
    report: Report,
    recording: RecordingOptions,
    name: str,
    straight: FoundPixels | None,
) -> State:
    """Measure a state; `straight` are the rays of the dense search in cold air, if this is hot."""
    clock = time.perf_counter
    report("searching, ray by ray", 0.0)
    began = clock()
    searches = (probe_y, "paper"), (probe_y, "newton"), (dense_y, "newton")
    paper, newton, dense = (ray_search(scene, y, method) for y, method in searches)
    search_s = clock() - began
    report("finding the lit pixels", 0.2)
    began = clock()
    frame = recording.rendered(scene, lambda part: report("rendering", 0.5 + 0.3 * part))
    render_s = clock() - began
    if not np.any(frame.radiance > 0.0):
        raise InputError(f"{scene.path}: the frame is black. {why_dark(scene)}")
    report("recording", 0.8)
    began = clock()
    shot = recording.recorded(scene, frame, name, scene.camera_name, scene.source_name)
    record_s = clock() - began if shot else None
    seen = frame if shot is None else shot
    line = line_centres(seen)
    laser, across_mm = scene.sensor.laser, frame.coordinates()[:, :, 0]
    blurred = frame.report.pupil_points > 0
    pupil = pupil_search(scene, dense_y, "tabulated") if blurred else None
    truth = _through_lens(TrueLine.of_frame(frame), pupil) if pupil else frame
    by_frame = compare_line(line, truth, cut=True)
    compared: LineErrors | DotErrors
    if laser.dots_mm.size:
        compared = compare_dots(dot_centres(seen), (pupil or dense).pixel)
    else:
        searched = searched_line(scene, dense).seen_in(across_mm, laser.working_radius_mm)
        compared = compare_line(line, _through_lens(searched, pupil) if pupil else searched)
    found = line, paper, newton, dense, by_frame, compared
    state = State(scene, frame, *found, section, search_s, render_s, shot, None, record_s)
    if shot is not None:
        report("splitting the error", 0.9)
        state = replace(state, split=_split(state, straight or dense, pupil, recording))
    report("done", 1.0)
    return state


def _through_lens(line: TrueLine, pupil: PupilPixels) -> TrueLine:
    """A line that chief rays see, where all points of a pupil together show it."""
    rows, whole = map(np.array, zip(*(rows_through_pupil(pupil, r) for r in line.row), strict=True))
    known = np.isfinite(line.row)
    status = np.where(known & ~whole, TruthStatus.NO_LINE, line.status).astype(np.uint8)
    return replace(line, row=np.where(known & whole, rows, np.nan), status=status)


def _split(
    state: State, straight: FoundPixels, pupil: PupilPixels | None, recording: RecordingOptions
) -> ErrorSplit:
    """What the error of a recorded state is made of; `straight` are its rays in cold air."""
    from virtual_sensor.imaging.difference import DifferenceFrame

    scene, shot, found = state.scene, state.shot, state.centres_px
    assert shot is not None

    def centres(image: Any) -> Array:
        if state.dots:
            return compare_dots(dot_centres(image), state.dense.pixel).pixel
        return line_centres(image).pixel

    through_lens = pupil.pixel if pupil else None
    if state.dots:
        before, after = straight.pixel, state.dense.pixel
    else:
        column, row = state.line.column, state.line.pixel[:, 1]
        before, after = (
            np.stack([column, nearest_rows(searched_line(scene, rays), row)], axis=1)
            for rays in (straight, state.dense)
        )
        if pupil:
            rows, _ = rows_through_pupil(pupil, after[:, 1])
            through_lens = np.stack([column, rows], axis=1)

    def without_off(frame: Frame, light: Any) -> Any:
        """What a difference leaves of light: that of the laser."""
        return light - frame.background if isinstance(shot, DifferenceFrame) else light

    images: dict[str, Any] = {"pixels": without_off(state.frame, state.frame.radiance)}
    if shot.speckled is not None:
        images["speckle"] = without_off(state.frame, shot.speckled)
    images["noise"] = in_16_bits(shot)
    places = {name: centres(image) for name, image in images.items()} | {"rounding": found}
    lower_frame = recording.rendered(half_a_pixel_lower(scene))
    lower = centres(without_off(lower_frame, lower_frame.radiance))
    return split_error(scene, state.section, before, after, lower, places, through_lens)


def searched_line(scene: Scene, found: FoundPixels) -> TrueLine:
    """The line where a search along it found it."""
    width = scene.sensor.camera.size[0]
    return TrueLine.of_search(found.pixel, found.status == SearchStatus.FOUND, width)


def probe_deviations(result: Measurement, step_px: float | None = None) -> Deviation:
    """The paper's differences for the probe rays, by Newton's search; pixels rounded if asked.

    Of a part that is measured only cold, the hot points are NaN.
    """
    cold, hot = result.cold.newton, result.hot.newton if result.hot else None
    nothing = np.full_like(cold.laser_point_mm, np.nan)
    pixel_A, pixel_B = cold.pixel, hot.pixel if hot else nothing[:, :2]
    if step_px:
        pixel_A, pixel_B = round_pixel(pixel_A, step_px), round_pixel(pixel_B, step_px)
    sensor = result.cold.scene.sensor
    return deviations(
        cold.laser_point_mm,
        hot.laser_point_mm if hot else nothing,
        triangulate(sensor, pixel_A),
        triangulate(sensor, pixel_B),
        pixel_A,
        pixel_B,
    )


# The summary.


@dataclass(frozen=True)
class LineAgreement(Record):
    """The rendered line's centres minus the ray search, across the columns.

    Attributes
    ----------
    rms_px, largest_px, mean_px : float
        Of the centres that were compared.
    compared : int
        Centres that were compared.
    centres : int
        Columns that have a centre.
    expected : int
        Columns on the searched line from edge to edge, that see its whole profile.
    cut : int
        Columns that would be expected if no edge of the part hid some of the profile.
    cut_centres : int
        Centres that were left out for that.
    stray_centres : int
        Centres that were left out as the search knows no row in their column.
    """

    rms_px: float
    largest_px: float
    mean_px: float
    compared: int
    centres: int
    expected: int
    cut: int
    cut_centres: int
    stray_centres: int


@dataclass(frozen=True)
class DotAgreement(Record):
    """The rendered dots' centroids minus the ray search.

    Attributes
    ----------
    rms_px : float
        Of the distances.
    largest_u_px, largest_v_px : float
        Largest magnitude along and across the line.
    found : int
        Dots that were found.
    dots : int
        Dots that the laser makes.
    """

    rms_px: float
    largest_u_px: float
    largest_v_px: float
    found: int
    dots: int


@dataclass(frozen=True)
class TruthAgreement(Record):
    """The line's centres beside the frame's own truth.

    Attributes
    ----------
    compared : int
        Centres that are ok, and whose truth is known.
    wrong : int
        Those of them that are off by over 0.1 px; or by over 10 of their sigmas and 0.02 px.
    largest_px : float
        Largest magnitude of the error.
    """

    compared: int
    wrong: int
    largest_px: float


@dataclass(frozen=True)
class SearchFacts(Record):
    """A search of the probe rays.

    Attributes
    ----------
    found : int
        Rays that were found.
    largest_distance_um : float
        From the point that the pixel sees to the one that is lit, parallel to the sensor.
    iterations : int
        Marches of a camera's ray, at most.
    """

    found: int
    largest_distance_um: float
    iterations: int


@dataclass(frozen=True)
class PathErrors(Record):
    """What each bent light path has to do with the section's error; of the searched rays.

    Attributes
    ----------
    laser_rms_um, laser_largest_um : float
        The section's error if only the laser's light were bent.
    camera_rms_um, camera_largest_um : float
        What the bent lines of sight add to it.
    """

    laser_rms_um: float
    laser_largest_um: float
    camera_rms_um: float
    camera_largest_um: float


@dataclass(frozen=True)
class RecordingFacts(Record):
    """How a frame was recorded: `vs.record` with these makes the same bits.

    Attributes
    ----------
    sensor : dict
        Its data sheet.
    exposure_s : float or None
        None where a pinhole was exposed automatically: without an aperture there is no time.
    electrons_per_radiance : float
        Mean electrons of a pixel for 1 W/(mm² sr).
    seed : int
        Of this frame.
    drawn : dict
        The seeds of its parts, which follow from it.
    speckled : bool
        Whether the laser's light was speckled.
    saturated_columns : int
        Columns of the line that have clipped pixels.
    """

    sensor: dict[str, Any]
    exposure_s: float | None
    electrons_per_radiance: float
    seed: int
    drawn: dict[str, Any]
    speckled: bool
    saturated_columns: int


@dataclass(frozen=True)
class StateSummary(Record):
    """The figures of the part measured cold, or hot.

    Attributes
    ----------
    section : SectionErrors
        The measured section beside the true one.
    paths : PathErrors or None
        Which light path is to blame; None where light runs straight.
    line_minus_search : LineAgreement or None
        The check of renderer and detector by the ray search; None of dots.
    dots_minus_search : DotAgreement or None
        The same of dots.
    line_minus_truth : TruthAgreement
        The line's centres beside the frame's truth.
    line_width_px : float
        Median of the widths of the line's profile: their standard deviations.
    split : SplitSummary or None
        What the error of the section is made of; None where nothing was recorded.
    recording : RecordingFacts or None
        How the frame was recorded; None where it was not.
    line_status : dict
        How many of the frame's columns have each status.
    search_status : dict
        How many of the searched rays have each status.
    paper_search, newton_search : SearchFacts
        The probe rays, by both methods.
    frame : RenderReport
        How the frame was made.
    ghosts : GhostFacts or None
        What of the light was reflected in between; None where direct light alone was rendered.
    render_time_s, search_time_s : float
        Time that rendering and searching took.
    record_time_s : float or None
        Time that recording took; None where nothing was recorded.
    """

    section: SectionErrors
    paths: PathErrors | None
    line_minus_search: LineAgreement | None
    dots_minus_search: DotAgreement | None
    line_minus_truth: TruthAgreement
    line_width_px: float
    split: SplitSummary | None
    recording: RecordingFacts | None
    line_status: dict[str, int]
    search_status: dict[str, int]
    paper_search: SearchFacts
    newton_search: SearchFacts
    frame: RenderReport
    ghosts: GhostFacts | None
    render_time_s: float
    search_time_s: float
    record_time_s: float | None


@dataclass(frozen=True)
class ProbeRays(Record):
    """The largest differences of the probe rays' points; null where the part has no hot ones.

    A and B are where a ray meets the cold and the hot part, A_m and B_m what is measured there.

    Attributes
    ----------
    rays, lit : int
        Probe rays, and those of them that the laser lights.
    largest_incidence_shift_um : float
        |B - A|: hot air moves the point that is lit.
    largest_hot_error_um : float
        |B - B_m|: the measured point beside the lit one, in hot air.
    largest_measured_shift_um : float
        |B_m - A_m|: hot air moves the measured point.
    largest_cold_error_um : float
        |A - A_m|: the measured point beside the lit one, in cold air.
    largest_cold_error_rounded_um : float
        The same with pixels rounded to 0.25 px.
    largest_cold_error_rounded_axis_um : float
        The same along an axis of the sensor.
    """

    rays: int
    lit: int
    largest_incidence_shift_um: float
    largest_hot_error_um: float
    largest_measured_shift_um: float
    largest_cold_error_um: float
    largest_cold_error_rounded_um: float
    largest_cold_error_rounded_axis_um: float


@dataclass(frozen=True)
class FieldPlace(Record):
    """Where a field was moved to.

    Attributes
    ----------
    rotation : list
        Its axes, as columns of a matrix.
    shift_mm : list
        Where its origin went.
    """

    rotation: Array
    shift_mm: Array


@dataclass(frozen=True)
class FieldFacts(Record):
    """The air that bends the light.

    Attributes
    ----------
    source : str
        Where it comes from.
    ambient_refractivity : float
        n - 1 of the air around.
    box_mm : list
        Lowest and highest corner.
    moved : FieldPlace or None
        Where the field was moved to.
    largest_border_jump : dict
        Of n - 1, by the face.
    """

    source: str
    ambient_refractivity: float
    box_mm: Array
    moved: FieldPlace | None
    largest_border_jump: dict[str, float]


@dataclass(frozen=True)
class Summary(SceneFacts):
    """What shows whether a measurement is sound, and how good it is.

    Attributes
    ----------
    field : FieldFacts or None
        The air; None of a cold scene.
    states : dict of StateSummary
        By "cold" and "hot".
    probe_rays : ProbeRays
        How far hot air moves points.
    caveats : tuple of str
        Those of the notes that make the figures worth little.
    time_s : float
        Of the whole measurement, without the writing of results.
    """

    field: FieldFacts | None
    states: dict[str, StateSummary]
    probe_rays: ProbeRays
    caveats: tuple[str, ...]
    time_s: float


def summary(result: Measurement) -> Summary:
    """The figures that show whether the measurement is sound, for ``summary.json``."""
    scene = result.scene
    return Summary(
        **vars(scene_facts(scene, result.notes)),
        field=_field_facts(scene.field) if scene.field else None,
        states={name: _state_summary(state) for name, state in result.states.items()},
        probe_rays=_probe_rays(result),
        caveats=result.caveats,
        time_s=round(result.time_s, 2),
    )


def _probe_rays(result: Measurement) -> ProbeRays:
    exact, rounded = probe_deviations(result), probe_deviations(result, ROUNDED_PX)
    sensor = result.cold.scene.sensor
    along_axes = rounded.cold_error_um @ sensor.camera.pose.rotation[:, :2]
    return ProbeRays(
        rays=len(result.probe_y_mm),
        lit=int(np.sum(sensor.laser.reaches(0.0, result.probe_y_mm))),
        **{f"largest_{name}": largest(euclidean(getattr(exact, name))) for name in LETTERS},
        largest_cold_error_rounded_um=largest(euclidean(rounded.cold_error_um)),
        largest_cold_error_rounded_axis_um=largest(along_axes),
    )


def _field_facts(field: IndexField) -> FieldFacts:
    jumps = zip(FACES, field.border_jump(), strict=True)
    return FieldFacts(
        source=field.source,
        ambient_refractivity=field.ambient,
        box_mm=field.box,
        moved=FieldPlace(field.axes(), field.to_world(np.zeros(3))) if field.pose else None,
        largest_border_jump={face: float(jump) for face, jump in jumps},
    )


def _state_summary(state: State) -> StateSummary:
    return StateSummary(
        section=section_errors(state.section, state.points_mm),
        paths=_path_errors(state) if state.scene.field else None,
        line_minus_search=_line_agreement(state.by_search, state.centres)
        if state.by_search
        else None,
        dots_minus_search=_dot_agreement(state.dots) if state.dots else None,
        line_minus_truth=TruthAgreement(
            state.by_frame.count, int(state.by_frame.wrong().sum()), state.by_frame.largest_px
        ),
        line_width_px=_median(state.line.width),
        split=split_summary(state.split) if state.split else None,
        recording=_recording_facts(state.shot) if state.shot else None,
        line_status=counts_of(state.line.status, Status),
        search_status=counts_of(state.dense.status, SearchStatus),
        paper_search=_search_facts(state.paper),
        newton_search=_search_facts(state.newton),
        frame=state.frame.report,
        ghosts=ghost_facts(state.frame),
        render_time_s=round(state.render_time_s, 3),
        search_time_s=round(state.search_time_s, 3),
        record_time_s=None if state.record_time_s is None else round(state.record_time_s, 3),
    )


def _recording_facts(shot: RecordedFrame) -> RecordingFacts:
    from virtual_sensor.imaging.difference import DifferenceFrame

    clipped = shot.saturated & np.asarray(getattr(shot.ideal, "lit", False))
    return RecordingFacts(
        sensor=asdict(shot.on_sensor if isinstance(shot, DifferenceFrame) else shot.sensor),
        exposure_s=shot.exposure_s,
        electrons_per_radiance=shot.electrons_per_radiance,
        seed=shot.seed,
        drawn=dict(shot.drawn),
        speckled=shot.speckled is not None,
        saturated_columns=int(clipped.any(axis=0).sum()),
    )


def _median(values: Array) -> float:
    known = values[np.isfinite(values)]
    return float(np.median(known)) if known.size else np.nan


def _path_errors(state: State) -> PathErrors:
    laser, camera = state.laser_path_um, state.camera_path_um
    return PathErrors(rms(laser), largest(laser), rms(camera), largest(camera))


def _line_agreement(compared: LineErrors, centres: int) -> LineAgreement:
    return LineAgreement(
        rms_px=compared.rms_px,
        largest_px=compared.largest_px,
        mean_px=float(compared.error_px.mean()) if compared.count else np.nan,
        compared=compared.count,
        centres=centres,
        expected=compared.expected,
        cut=compared.cut,
        cut_centres=compared.cut_centres,
        stray_centres=compared.stray_centres,
    )


def _dot_agreement(dots: DotErrors) -> DotAgreement:
    return DotAgreement(
        rms_px=dots.rms_px,
        largest_u_px=largest(dots.error_px[:, 0]),
        largest_v_px=largest(dots.error_px[:, 1]),
        found=dots.count,
        dots=len(dots.pixel),
    )


def _search_facts(found: FoundPixels) -> SearchFacts:
    return SearchFacts(
        found=int(np.sum(found.status == SearchStatus.FOUND)),
        largest_distance_um=largest(found.distance_um),
        iterations=int(found.iterations.max(initial=0)),
    )


# The tables.


@dataclass(frozen=True)
class LineTable(Table):
    """The line's centres, a row for each of the image's columns.

    Attributes
    ----------
    column_px, row_px : ndarray of shape (N,)
        (u, v) of the centre, integers at pixel centres; empty where there is none.
    sigma_px : ndarray of shape (N,)
        Predicted standard deviation of the row.
    width_px : ndarray of shape (N,)
        Standard deviation of the line's profile.
    amplitude : ndarray of shape (N,)
        Height of the profile, W/(mm² sr).
    status : ndarray of str of shape (N,)
        Why there is a centre, or none.
    point_mm : ndarray of shape (N, 3)
        The point measured there, world.
    section_error_um : ndarray of shape (N,)
        Its distance from the true section: positive outside the part; none at the part's edges.
    """

    column_px: Array
    row_px: Array
    sigma_px: Array
    width_px: Array
    amplitude: Array
    status: Texts
    point_mm: Array
    section_error_um: Array


def line_table(state: State) -> LineTable:
    """A state's line."""
    line = state.line
    points = triangulate(state.scene.sensor, line.pixel)
    return LineTable(
        line.column,
        line.row,
        line.sigma,
        line.width,
        line.amplitude,
        status_names(line.status, Status),
        points,
        state.section.distance_um(points),
    )


@dataclass(frozen=True)
class DotTable(Table):
    """The laser's dots, a row for each.

    Attributes
    ----------
    y_mm : ndarray of shape (N,)
        The dot's position along the line.
    pixel : ndarray of shape (N, 2)
        Its centroid, px; empty where it was not found.
    flux : ndarray of shape (N,)
        Sum of its pixels.
    searched_pixel : ndarray of shape (N, 2)
        Where the ray search finds it, px.
    point_mm : ndarray of shape (N, 3)
        The point measured there, world.
    section_error_um : ndarray of shape (N,)
        Its distance from the true section: positive outside the part; none at the part's edges.
    status : ndarray of str of shape (N,)
        Whether it was found.
    search_status : ndarray of str of shape (N,)
        How the ray's search ended.
    """

    y_mm: Array
    pixel: Array
    flux: Array
    searched_pixel: Array
    point_mm: Array
    section_error_um: Array
    status: Texts
    search_status: Texts


def dot_table(state: State) -> DotTable:
    """A state's dots."""
    dots = state.dots
    assert dots is not None
    return DotTable(
        state.scene.sensor.laser.dots_mm,
        dots.pixel,
        dots.flux,
        dots.true_pixel,
        state.points_mm,
        state.section_error_um,
        np.where(dots.found, "ok", "not_found"),
        status_names(state.dense.status, SearchStatus),
    )


ByState = Annotated[Mapping[str, Array], "cold", "hot"]
TextByState = Annotated[Mapping[str, Texts], "cold", "hot"]
ByPixel = Annotated[Mapping[str, Array], "", "rounded"]


@dataclass(frozen=True, kw_only=True)
class SearchedRays(Table):
    """Laser rays that were searched, a row for each.

    In the paper's letters the incidence points are A (cold) and B (hot), the measured ones A_m and
    B_m. The hot columns are missing from a part that is measured only cold.

    Attributes
    ----------
    y_mm : ndarray of shape (N,)
        The ray's position along the line.
    incidence_mm : ndarrays of shape (N, 3)
        A and B: where the ray meets the part, world.
    pixel : ndarrays of shape (N, 2)
        Pixels that see these points, by Newton's search, px.
    status : ndarrays of str of shape (N,)
        How that search ended.
    """

    y_mm: Array
    incidence_mm: ByState
    pixel: ByState
    status: TextByState


def _searched(found: Mapping[str, FoundPixels]) -> dict[str, Any]:
    """Columns of `SearchedRays`, by the states' names."""
    return {
        "incidence_mm": {name: each.laser_point_mm for name, each in found.items()},
        "pixel": {name: each.pixel for name, each in found.items()},
        "status": {name: status_names(each.status, SearchStatus) for name, each in found.items()},
    }


@dataclass(frozen=True, kw_only=True)
class ProbeTable(SearchedRays):
    """The probe rays; columns with "rounded" are from pixels rounded to 0.25 px.

    Attributes
    ----------
    paper_pixel : ndarrays of shape (N, 2)
        Pixels that see the points, by the paper's search, px.
    paper_distance_um : ndarrays of shape (N,)
        How near that search came, parallel to the sensor.
    paper_status : ndarrays of str of shape (N,)
        How it ended.
    incidence_shift_um : ndarrays of shape (N, 3)
        B - A: hot air moves the point that is lit.
    hot_error_um : ndarrays of shape (N, 3)
        B - B_m: lit minus measured point in hot air.
    measured_shift_um : ndarrays of shape (N, 3)
        B_m - A_m: hot air moves the measured point.
    cold_error_um : ndarrays of shape (N, 3)
        A - A_m: lit minus measured point in cold air.
    pixel_shift_px : ndarrays of shape (N, 2)
        Hot minus cold pixel.
    laser_path_px : ndarray of shape (N, 2)
        The part of the pixel's shift that the laser's bent path makes: B and A, both seen straight.
    camera_path_px : ndarray of shape (N, 2)
        The part that the camera's bent line of sight makes.
    """

    paper_pixel: ByState
    paper_distance_um: ByState
    paper_status: TextByState
    incidence_shift_um: ByPixel = field(metadata=WITH_NORM)
    hot_error_um: ByPixel = field(metadata=WITH_NORM)
    measured_shift_um: ByPixel = field(metadata=WITH_NORM)
    cold_error_um: ByPixel = field(metadata=WITH_NORM)
    pixel_shift_px: ByPixel = field(metadata=WITH_NORM)
    laser_path_px: Array | None = None
    camera_path_px: Array | None = None


def probe_table(result: Measurement) -> ProbeTable:
    """The probe rays of a measurement."""
    paper = {name: state.paper for name, state in result.states.items()}
    newton = {name: state.newton for name, state in result.states.items()}
    found = _searched(paper)
    columns = _searched(newton) | {
        "paper_pixel": found["pixel"],
        "paper_distance_um": {name: each.distance_um for name, each in paper.items()},
        "paper_status": found["status"],
    }
    exact, rounded = probe_deviations(result), probe_deviations(result, ROUNDED_PX)
    for each in fields(Deviation):
        both = {"": getattr(exact, each.name), "rounded": getattr(rounded, each.name)}
        columns[each.name] = both if result.hot or each.name == "cold_error_um" else {}
    if result.hot:
        A, B = newton.values()
        camera = result.hot.scene.sensor.camera
        paths = separate_paths(camera, A.laser_point_mm, B.laser_point_mm, A.pixel, B.pixel)
        columns["laser_path_px"] = paths.laser_to_object_px
        columns["camera_path_px"] = paths.object_to_camera_px
    return ProbeTable(y_mm=result.probe_y_mm, **columns)


@dataclass(frozen=True, kw_only=True)
class DenseTable(SearchedRays):
    """The rays that were searched along the line, or at the dots.

    Attributes
    ----------
    measured_mm : ndarrays of shape (N, 3)
        A_m and B_m: the points measured from the pixels, world.
    section_error_um : ndarrays of shape (N,)
        Their distances from the true section: positive outside; none at the part's edges.
    laser_path_um : ndarray of shape (N,)
        What the hot distance would be if only the laser's light were bent.
    camera_path_um : ndarray of shape (N,)
        What the bent line of sight adds to it.
    """

    measured_mm: ByState
    section_error_um: ByState
    laser_path_um: Array | None = None
    camera_path_um: Array | None = None


def dense_table(result: Measurement) -> DenseTable:
    """The searched rays of a measurement."""
    states, hot = result.states.items(), result.hot
    return DenseTable(
        y_mm=result.dense_y_mm,
        **_searched({name: state.dense for name, state in states}),
        measured_mm={name: state.searched_mm for name, state in states},
        section_error_um={name: state.searched_error_um for name, state in states},
        laser_path_um=hot.laser_path_um if hot else None,
        camera_path_um=hot.camera_path_um if hot else None,
    )
