"""The main job: measure a part cold and hot by rendered frames, beside the ray-by-ray search."""

import platform
import time
from collections.abc import Callable
from dataclasses import dataclass
from importlib import metadata
from typing import Any

import numpy as np
from numpy.typing import ArrayLike, NDArray

from virtual_sensor import engine
from virtual_sensor.errors import InputError
from virtual_sensor.imaging.checks import check_scene
from virtual_sensor.imaging.dark_frames import why_dark
from virtual_sensor.imaging.render import Account, Frame, render_frame
from virtual_sensor.imaging.scene import Scene
from virtual_sensor.medium.index_field import IndexField
from virtual_sensor.metrology.centres import LineCentres, Status
from virtual_sensor.metrology.deviation import Deviation, deviations, euclidean, round_pixel
from virtual_sensor.metrology.dot_peaks import dot_centres
from virtual_sensor.metrology.line_peaks import line_centres
from virtual_sensor.metrology.triangulation import triangulate
from virtual_sensor.metrology.truth import (
    DotErrors,
    LineErrors,
    TrueLine,
    compare_dots,
    compare_line,
)
from virtual_sensor.optics.ray_search import FoundPixels, SearchStatus, ray_search
from virtual_sensor.studies.notes import (
    TRUTH,
    WRONG,
    coarse_grid,
    counts_of,
    frame_notes,
    unlit_rays,
    upright_line,
)
from virtual_sensor.studies.probes import dense_rays, probe_rays

Array = NDArray[np.float64]
Report = Callable[[str, float], None]
"""Told what is being done, and which fraction of the whole is."""


@dataclass(frozen=True)
class State:
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
        Rendered line minus dense search; or of a laser that makes dots, their centroids minus it.
    seconds : dict
        Of rendering and of searching.
    """

    scene: Scene
    frame: Frame
    line: LineCentres
    paper: FoundPixels
    newton: FoundPixels
    dense: FoundPixels
    by_frame: LineErrors
    compared: LineErrors | DotErrors
    seconds: dict[str, float]

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
    def centres(self) -> int:
        """How many of them were found."""
        return int(np.isfinite(self.centres_px[:, 1]).sum())

    @property
    def points_mm(self) -> Array:
        """Triangulated from them, world, mm; (N, 3)."""
        return triangulate(self.scene.sensor, self.centres_px)


@dataclass(frozen=True)
class Measurement:
    """The part measured cold and, if the scene has a field, hot.

    `probe_y_mm` and `dense_y_mm` are the rays' positions along the line, mm; `notes` hold what the
    user should know of the scene; `seconds` is the time of the whole.
    """

    cold: State
    hot: State | None
    probe_y_mm: Array
    dense_y_mm: Array
    notes: tuple[str, ...]
    seconds: float

    @property
    def rays(self) -> int:
        """Rays that were searched in each state."""
        return 2 * len(self.probe_y_mm) + len(self.dense_y_mm)

    @property
    def states(self) -> dict[str, State]:
        """The states by name."""
        return {"cold": self.cold} | ({"hot": self.hot} if self.hot else {})


def measure(
    scene: Scene,
    report: Report = lambda stage, fraction: None,
    y_mm: ArrayLike | None = None,
) -> Measurement:
    """Render, find the line, triangulate, search: first cold, then hot.

    Parameters
    ----------
    scene : Scene
    report : callable
        Told what is being done, and which fraction of the whole is.
    y_mm : array_like of shape (N,), optional
        Positions of the probe rays along the line, mm; by default the scene's own (`probe_rays`).

    Raises
    ------
    InputError
        If a ray's position is not finite, the scene can't be measured (see `imaging.checks`), or
        its frame stays black.
    """
    started = time.perf_counter()
    report("checking the scene", 0.0)
    laser = scene.sensor.laser
    notes = [*scene.notes, *check_scene(scene)]
    probe_y = probe_rays(scene, y_mm)
    notes += [*unlit_rays(laser, probe_y), *coarse_grid(scene)]
    dense_y = laser.dots_mm if laser.dots_mm.size else dense_rays(scene)
    share = 0.15 if scene.field else 1.0  # of the time that the cold part takes
    cold = _measure_state(
        scene.cold(),
        probe_y,
        dense_y,
        lambda stage, part: report(f"cold part: {stage}", share * part),
    )
    hot = None
    if scene.field:
        hot = _measure_state(
            scene,
            probe_y,
            dense_y,
            lambda stage, part: report(f"hot part: {stage}", share + (1.0 - share) * part),
        )
    states = {"cold": cold} | ({"hot": hot} if hot else {})
    for name, state in states.items():
        words = [] if state.dots else upright_line(state.dense, state.scene.camera_element)
        words += frame_notes(state.frame.account, state.line, state.compared, state.by_frame)
        notes += [f"{name}: {each}" for each in words]
    seconds = time.perf_counter() - started
    return Measurement(cold, hot, probe_y, dense_y, tuple(notes), seconds)


def _measure_state(scene: Scene, probe_y: Array, dense_y: Array, report: Report) -> State:
    clock = time.perf_counter
    report("searching, ray by ray", 0.0)
    at = clock()
    paper = ray_search(scene, probe_y, "paper")
    newton = ray_search(scene, probe_y, "newton")
    dense = ray_search(scene, dense_y, "newton")
    seconds = {"search": clock() - at}
    report("looking for the lit pixels", 0.2)
    at = clock()
    frame = render_frame(scene, progress=lambda part: report("rendering", 0.5 + 0.5 * part))
    seconds["render"] = clock() - at
    if not np.any(frame.radiance > 0.0):
        raise InputError(f"{scene.path}: the frame is black. {why_dark(scene)}")
    line = line_centres(frame.radiance)
    laser, across_mm = scene.sensor.laser, frame.coordinates()[:, :, 0]
    by_frame = compare_line(line, TrueLine.of_coordinates(across_mm, laser.radius_mm), cut=True)
    compared: LineErrors | DotErrors
    if laser.dots_mm.size:
        compared = compare_dots(dot_centres(frame.radiance), dense.pixel)
    else:
        searched = searched_line(scene, dense).seen_in(across_mm, laser.radius_mm)
        compared = compare_line(line, searched)
    return State(scene, frame, line, paper, newton, dense, by_frame, compared, seconds)


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


def summary(result: Measurement) -> dict[str, Any]:
    """The figures that tell whether the measurement is sound, for `summary.json`."""
    scene = (result.hot or result.cold).scene
    exact, rounded = probe_deviations(result), probe_deviations(result, 0.25)
    sensor_axes = scene.sensor.camera.pose.rotation[:, :2]
    return {
        "scene": str(scene.path),
        "camera": scene.camera_name,
        "source": scene.source_name,
        "parameters": dict(scene.parameters),
        "field": _field_summary(scene.field) if scene.field else None,
        "notes": result.notes,
        "states": {name: _state_summary(state) for name, state in result.states.items()},
        "rays lit": int(np.sum(scene.sensor.laser.reaches(0.0, result.probe_y_mm))),
        "probe_rays_um": {
            "largest |A - A_m|, cold": _largest(exact.cold_um),
            "largest |A - A_m|, cold, pixels rounded to 0.25": _largest(rounded.cold_um),
            "the same along a sensor axis": _largest(
                (rounded.cold_um @ sensor_axes).reshape(-1, 1)
            ),
            "largest |B - A|": _largest(exact.incidence_um),
            "largest |B - B_m|": _largest(exact.hot_um),
            "largest |B_m - A_m|": _largest(exact.measured_um),
        },
        "seconds": round(result.seconds, 2),
        "made_with": made_with(scene),
    }


def made_with(scene: Scene) -> dict[str, Any]:
    """The engine, the march and the versions that results come from."""
    running = engine.activate()
    return {
        "variant": running.variant,
        "llvm": str(running.llvm.path) if running.llvm else None,
        "threads": running.threads,
        "python": platform.python_version(),
        "transport": scene.transport.name,
        "samples per pixel": int(scene.mitsuba_camera.sampler().sample_count()),
        "step, mm": scene.transport.march.step_mm,
        "march": str(scene.transport.march),
        **{name: metadata.version(name) for name in ("virtual-sensor", "mitsuba", "drjit")},
    }


def _field_summary(field: IndexField) -> dict[str, Any]:
    jumps = zip(("x-", "x+", "y-", "y+", "z-", "z+"), field.border_jump(), strict=True)
    return {
        "source": field.source,
        "ambient n - 1": field.ambient,
        "box, mm": field.box.tolist(),
        "moved by": {
            "rotation": field.axes().tolist(),
            "shift, mm": field.to_world(np.zeros(3)).tolist(),
        }
        if field.pose
        else None,
        "largest jump of n - 1 at the border": {face: float(jump) for face, jump in jumps},
    }


def _state_summary(state: State) -> dict[str, Any]:
    searched, dots = state.by_search, state.dots
    return {
        "line": counts_of(state.line.status, Status),
        "search": counts_of(state.dense.status, SearchStatus),
        "rendered line minus search, px": {
            "rms": searched.rms_px,
            "largest": searched.largest_px,
            "columns compared": searched.count,
            "columns on the searched line": searched.expected,
            "columns where an edge cuts the line": searched.cut,
            "centres": state.centres,
            "centres cut by an edge": searched.cut_centres,
            "centres off the searched line": searched.stray_centres,
        }
        if searched
        else None,
        TRUTH: {
            "ok, truth known": state.by_frame.count,
            WRONG: int(state.by_frame.wrong().sum()),
            "largest, px": state.by_frame.largest_px,
        },
        "rendered dots minus search, px": {
            "rms": dots.rms_px,
            "found": state.centres,
            "of": len(dots.pixel),
            "largest in u": _largest(dots.error_px[:, :1]),
            "largest in v": _largest(dots.error_px[:, 1:]),
        }
        if dots
        else None,
        "paper's search, probe rays": {
            "largest distance, um": _largest(state.paper.distance_um[:, None]),
            "steps": int(state.paper.iterations.max(initial=0)),
            "found": int(np.sum(state.paper.status == SearchStatus.FOUND)),
        },
        "Newton's search, probe rays": {
            "largest distance, um": _largest(state.newton.distance_um[:, None]),
            "marches": int(state.newton.iterations.max(initial=0)),
            "found": int(np.sum(state.newton.status == SearchStatus.FOUND)),
        },
        "frame": frame_account(state.frame.account),
        "seconds": {name: round(value, 2) for name, value in state.seconds.items()},
    }


def frame_account(account: Account) -> dict[str, Any]:
    """How a frame was made, in words."""
    return {
        "transport": account.transport,
        "why not as asked": account.reason or None,
        "tables": {
            **{f"nodes of the {name}'s": nodes for name, nodes in account.nodes.items()},
            "estimated error, px": account.error_px,
        }
        if account.nodes
        else None,
        "samples": account.samples,
        "of them marched, where the tables could not tell": account.marched,
        "pixels of folded light, black": account.folded,
    }


def _largest(differences: Array) -> float | None:
    """Largest norm of the rows that have one."""
    norms = euclidean(differences)
    return float(np.nanmax(norms)) if np.isfinite(norms).any() else None
