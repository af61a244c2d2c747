"""Measure a part's whole surface by fringes: cold and hot, beside a search of rays."""

from __future__ import annotations

import time
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from dataclasses import dataclass, field, replace
from pathlib import Path
from typing import Any

import cv2
import numpy as np
from numpy.typing import NDArray

from virtual_sensor.child import physical_memory
from virtual_sensor.display import Displayed
from virtual_sensor.engine import dr
from virtual_sensor.errors import InputError
from virtual_sensor.imaging.checks import check_scene
from virtual_sensor.imaging.fringe_recording import FringeRecording
from virtual_sensor.imaging.scene import Scene
from virtual_sensor.imaging.sequence import render_sequence
from virtual_sensor.medium.index_field import IndexField
from virtual_sensor.metrology.deviation import UM_PER_MM
from virtual_sensor.metrology.fringes.codec import Codec
from virtual_sensor.metrology.fringes.codecs import codec_of
from virtual_sensor.metrology.fringes.decoded import COORDINATES, DecodedFringes, FringeStatus
from virtual_sensor.metrology.range_image import FAR_BETTER, depth_in_axes, reconstruct
from virtual_sensor.metrology.shape_fits import fit_shape
from virtual_sensor.metrology.shapes import CylinderShape, PartShape, Shape
from virtual_sensor.metrology.truth import farthest, largest, mean, rms
from virtual_sensor.optics.crossing_status import CrossingStatus
from virtual_sensor.optics.epipolar import epipolar_residual
from virtual_sensor.optics.projector_pixels import (
    ProjectorPixelStatus,
    pixel_grid,
    projector_pixels,
)
from virtual_sensor.optics.surfaces import Cylinder
from virtual_sensor.records import counts_in_words, counts_of
from virtual_sensor.studies.fringes.decoded_facts import DecodedFacts
from virtual_sensor.studies.fringes.result import (
    AxisAgreement,
    EpipolarFacts,
    FramesFacts,
    FringeMeasurement,
    FringeState,
    FringeStateSummary,
    FringeSummary,
    SearchAgreement,
    SearchedGrid,
    ShapeFit,
    Surface,
    SurfaceFacts,
)
from virtual_sensor.studies.notes import frame_notes
from virtual_sensor.studies.provenance import scene_facts

Array = NDArray[np.float64]
Report = Callable[[str, float], None]
"""Called with what is being done, and the fraction of the whole that is done."""

_FRAME_BYTES = 4  # a pixel, in each frame
_STATE_BYTES = 250  # a pixel, of what is decoded and found: half of the film lit, that is measured

SHRUNK_PX = 512
"""Along the longer side of frames that are not kept in full."""
SEARCHED = 2500
"""Pixels of the camera, at most, that are searched for, on a grid over the whole frame."""

_AT_EDGES, _OUTSIDE = FringeStatus.EDGE.name.lower(), FringeStatus.OUTSIDE.name.lower()
_MANY = 0.1  # of the pixels: that so many are missing is a caveat
_FITTED = 40_000  # points that a shape is fitted to, about
_KINDS = {"Rectangle": "plane", "Disk": "plane", "Sphere": "sphere"}  # by Mitsuba's shapes
_OFF_PX, _OFF = 0.01, 1.5  # px, and predicted sigmas, off the search: noise alone makes less
_EXACT = ("tabulated", "marched")  # transports whose light is that of the search
_FEW_BITS = 8  # of a camera, whose rounding is no white noise
_SHARES = {"rendering": 0.35, "decoding": 0.15, "searching": 0.2, "finding the points": 0.3}


@dataclass(frozen=True)
class Settings(Displayed):
    """How a scene is measured by fringes.

    Attributes
    ----------
    codec : str or Codec
        As `codec_of` takes it, for the size of the scene's projector.
    spp : int, optional
        Samples per pixel; the scene's own if not given.
    recording : FringeRecording
    medium : IndexField, str or Path, optional
        Through which points of the hot part are found; by default the scene's own.
    cold : bool
        Whether the cold part alone is measured.
    frames : bool
        Whether the frames are kept in full, which of 2048 x 2048 px take 0.4 GB a state; if not,
        small ones are, as a report shows them.
    """

    codec: str | Codec = "phase 4"
    spp: int | None = None
    recording: FringeRecording = field(default_factory=FringeRecording)
    medium: IndexField | str | Path | None = None
    cold: bool = False
    frames: bool = True


def measure_fringes(
    scene: Scene, settings: Settings | None = None, report: Report = lambda stage, fraction: None
) -> FringeMeasurement:
    """Render the codec's patterns, decode, find the points, search: first cold, then hot.

    Parameters
    ----------
    scene : Scene
        With one camera and one projector; its other sources shine too.
    settings : Settings, optional
    report : callable
        Called with what is being done, and the fraction of the whole that is done.

    Raises
    ------
    InputError
        If the scene can't be measured, its projector can't show the patterns, or the results don't
        fit in the memory.
    """
    started = time.perf_counter()
    settings = settings or Settings()
    report("checking the scene", 0.0)
    codec = codec_of(settings.codec, scene.projector.size)
    if not codec.absolute:
        raise InputError(
            f"--codec '{codec.text}': knows the projector's pixels but for whole periods, which"
            " give no points; project a second period, or Gray code: 'phase 4 16,128,1280'"
        )
    alone = scene.only(None, scene.projector_name)
    notes: list[str] = [*scene.loading_notes, *check_scene(alone)]
    medium = None
    if settings.medium is not None and (settings.cold or scene.medium is None):
        why = "the cold part alone is asked for" if settings.cold else f"{scene.path} has no air"
        raise InputError(
            f"--medium {settings.medium}: {why}, so that no light is bent; leave it out"
        )
    if scene.medium is not None and not settings.cold:
        medium = scene.medium
        if settings.medium is not None:
            medium = scene.with_medium(settings.medium).medium
    _check_memory(scene, len(codec), settings, 2 if medium else 1)
    share = 0.4 if medium else 1.0

    def state(name: str, scene: Scene, low: float, high: float) -> FringeState:
        def inner(stage: str, part: float) -> None:
            report(f"{name} part: {stage}", low + (high - low) * part)

        return _measure_state(
            scene, codec, settings, medium if name == "hot" else None, inner, name
        )

    states = {"cold": state("cold", scene.cold(), 0.02, share)}
    if medium:
        states["hot"] = state("hot", scene, share, 1.0)
    caveats: list[str] = []
    for name, each in states.items():
        judged = state_notes(each, codec)
        notes += [f"{name}: {note}" for note in judged]
        caveats += [f"{name}: {note}" for note, poor in judged.items() if poor]
    summary = FringeSummary(
        **vars(scene_facts(alone, tuple(dict.fromkeys(notes)))),
        codec=codec.text,
        medium=medium.source if medium else None,
        states={name: each.summary for name, each in states.items()},
        caveats=tuple(caveats),
        time_s=round(time.perf_counter() - started, 2),
    )
    return FringeMeasurement(states["cold"], states.get("hot"), codec, summary)


def _check_memory(scene: Scene, frames: int, settings: Settings, states: int) -> None:
    """Refuse what would end a process without a word, an hour after it began."""
    width, height = scene.camera.size
    kept = states if settings.frames else 1
    needed = width * height * (kept * frames * _FRAME_BYTES + states * _STATE_BYTES)
    if needed > physical_memory():
        raise InputError(
            f"{scene.path}: {frames} frames of {width} x {height} px and what is found of them take"
            f" {needed / 1e9:.3g} GB or more, and this machine has {physical_memory() / 1e9:.3g};"
            " give a smaller film (-D width, height)"
        )


def _measure_state(
    scene: Scene,
    codec: Codec,
    settings: Settings,
    medium: IndexField | None,
    report: Report,
    state: str,
) -> FringeState:
    times: dict[str, float] = {}

    @contextmanager
    def doing(stage: str) -> Iterator[Callable[[float], None]]:
        done = sum(_SHARES[name] for name in times)
        report(stage, done)
        began = time.perf_counter()
        yield lambda part: report(stage, done + _SHARES[stage] * part)
        times[stage] = round(time.perf_counter() - began, 3)

    name, alone = scene.projector_name, scene.only(None, scene.projector_name)
    with doing("rendering") as part:
        frames = render_sequence(
            scene, codec.patterns, spp=settings.spp, progress=part, source=name
        )
    made = frames.report
    dr.flush_malloc_cache()  # samples' memory, of which nothing is asked again until the next state
    with doing("decoding"):
        shot = settings.recording.shot(scene, frames, state)
        del frames
        border_px = scene.projector.blurred_border_px
        decoded = settings.recording.decoded(codec, shot, border_px=border_px)
        recorded, told = settings.recording.facts(shot), getattr(shot, "notes", ())
        images, metadata = np.asarray(shot), getattr(shot, "metadata", {})
        del shot
        if not settings.frames:
            images = shrunk(images)
    with doing("searching"):
        grid = searched_grid(alone, decoded)
    with doing("finding the points"):
        straight = _surface(alone, decoded, None)
        bent = _surface(alone, decoded, medium) if medium else None
    facts = FringeStateSummary(
        frames=FramesFacts(
            frames=len(images),
            size_px=scene.camera.size,
            samples_per_pixel=settings.spp or int(scene.mitsuba_camera.sampler().sample_count()),
            report=made,
            **recorded,
            recording_notes=told,
        ),
        decoded=DecodedFacts.of(decoded),
        decoded_minus_search=_agreement(grid, decoded),
        epipolar=_epipolar_facts(straight, grid),
        straight=straight.facts,
        bent=bent.facts if bent else None,
        searched_rms_um=rms(grid.straight_um),
        straight_minus_search_um=rms(
            np.where(
                grid.compared, straight.deviation_um[grid.row_column] - grid.straight_um, np.nan
            )
        ),
        times_s=times,
    )
    return FringeState(scene, images, decoded, straight, bent, grid, facts, metadata)


def shrunk(images: NDArray[Any]) -> NDArray[Any]:
    """Images (K, H, W) whose longer side has `SHRUNK_PX` at most, of means over their pixels."""
    high, wide = images.shape[1:]
    share = min(SHRUNK_PX / max(high, wide), 1.0)
    size = max(round(wide * share), 1), max(round(high * share), 1)
    return np.stack([cv2.resize(each, size, interpolation=cv2.INTER_AREA) for each in images])


# From light to projector pixels.


def searched_grid(scene: Scene, decoded: DecodedFringes) -> SearchedGrid:
    """Pixels on a grid, searched for beside what was decoded."""
    places = pixel_grid(scene.camera.size, SEARCHED)
    (u, v), pixel = places.T, places.astype(float)
    found = projector_pixels(scene, pixel)
    at, status = decoded.pixel[v, u], decoded.status[v, u]
    compared = (status == FringeStatus.OK) & (found.status == ProjectorPixelStatus.OK)
    family = scene.projector.family
    epipolar, decoded_epipolar = (
        epipolar_residual(scene.camera, family, pixel, lit) for lit in (found.projector_pixel, at)
    )
    straight_um = _straight_um(scene, decoded, found.projector_pixel, (v, u))
    return SearchedGrid(pixel, found, at, compared, straight_um, epipolar, decoded_epipolar)


def _straight_um(
    scene: Scene,
    decoded: DecodedFringes,
    projector_pixel: Array,
    place: tuple[NDArray[np.int64], NDArray[np.int64]],
) -> Array:
    """Distances (N,) from the true surface of the straight points of searched pixels."""
    given: dict[str, Any] = {"absolute": True}
    for axis, name in enumerate(COORDINATES.values()):
        if getattr(decoded, name) is not None:
            given[name] = np.full(decoded.status.shape, np.nan)
            given[name][place] = projector_pixel[:, axis]
    searched = reconstruct(scene, replace(decoded, **given))
    return searched.deviation_um(_true_surface(scene))[place].astype(float)


# From projector pixels to the surface.


def _true_surface(scene: Scene) -> Shape:
    """The scene's part; a cylinder as such, whose distances take a quarter of the time."""
    part = scene.surface
    if isinstance(part, Cylinder):
        return CylinderShape(part.radius_mm, part.axis_y_mm, part.axis_z_mm)
    return PartShape.of(scene)


def _surface(scene: Scene, decoded: DecodedFringes, medium: IndexField | None) -> Surface:
    """The surface of what was decoded, straight or through a medium."""
    found = reconstruct(scene, decoded, medium=medium)
    deviation_um = found.deviation_um(_true_surface(scene))
    known = deviation_um[np.isfinite(deviation_um)].astype(float)
    sigma = found.sigma_um[np.isfinite(found.sigma_um)]
    facts = SurfaceFacts(
        points=int(found.ok.sum()),
        compared=known.size,
        mean_um=mean(known),
        rms_um=rms(known),
        largest_um=farthest(known),
        sigma_um=float(np.median(sigma)) if sigma.size else np.nan,
        fit=_fit(scene, found.point_mm[found.ok]),
    )
    return Surface(found, deviation_um, facts)


def _fit(scene: Scene, points_mm: Array) -> ShapeFit | None:
    """The part's own shape through the points, if it is a cylinder, a plane or a sphere."""
    part = scene.surface
    shapes = [shape.class_name() for shape in scene.mitsuba.shapes()]
    kind = "cylinder" if isinstance(part, Cylinder) else _KINDS.get(shapes[0])
    if kind is None or (len(shapes) > 1 and kind != "cylinder"):
        return None
    fit = fit_shape(points_mm[:: max(1, len(points_mm) // _FITTED)], kind)
    radius_mm = getattr(fit.shape, "radius_mm", None)
    error_um = None
    if isinstance(part, Cylinder) and radius_mm is not None:
        error_um = UM_PER_MM * (radius_mm - part.radius_mm)
    return ShapeFit(kind, radius_mm, error_um, fit.residual_std_um, fit.count)


# Figures.


def _agreement(grid: SearchedGrid, decoded: DecodedFringes) -> SearchAgreement:
    status = decoded.status[grid.row_column]
    found = grid.found.status == ProjectorPixelStatus.OK
    ok = status == FringeStatus.OK
    axes = {
        name: None
        if getattr(decoded, name) is None
        else AxisAgreement(rms(error), largest(error), int(np.isfinite(error).sum()))
        for name, error in zip(COORDINATES.values(), grid.difference_px.T, strict=True)
    }
    return SearchAgreement(
        **axes,
        searched=int(found.sum()),
        only_searched=counts_of(status[found & ~ok], FringeStatus, occurring=True),
        only_decoded=counts_of(
            grid.found.status[ok & ~found], ProjectorPixelStatus, occurring=True
        ),
    )


def _beyond_noise(state: FringeState) -> list[str]:
    """Note of decoded pixels that are off the search by more than noise makes, with the causes."""
    facts, projector, grid = state.summary, state.scene.projector, state.grid
    found = {}
    for name in COORDINATES.values():
        of_search = getattr(facts.decoded_minus_search, name)
        sigma = getattr(state.decoded, f"sigma_{name}")
        if of_search is None:
            continue
        noise_px = rms(sigma[grid.row_column][grid.compared])
        if of_search.rms_px > max(_OFF_PX, _OFF * noise_px):
            found[name] = of_search.rms_px, noise_px
    transport, bits = facts.frames.report.transport, facts.frames.bits
    causes = {
        f"the frames' light was {transport} (transport=marched is exact)": transport not in _EXACT,
        "the projector's square pixels are steps (pixels=false shows what lies between them,"
        " defocus smooths them)": projector.pixels and not projector.defocus_px,
        f"its gamma is {projector.gamma:g} (more steps make it matter less)": projector.gamma
        != 1.0,
        f"its grey values have {projector.bits} bits": projector.bits,
        f"the camera's grey values have {bits} bits": bits is not None and bits <= _FEW_BITS,
    }
    why = "; ".join(words for words, holds in causes.items() if holds)
    if not found:
        return []
    off = " and ".join(
        f"{name} by {rms_px:.2g} px rms, where noise makes {sigma:.2g} px"
        for name, (rms_px, sigma) in found.items()
    )
    return [f"decoded pixels are off the search, {off}" + f": {why}" * bool(why)]


def _edges_words(state: FringeState) -> str:
    """Which edges there are, and what has fewer of them."""
    if not state.scene.projector.pixels:
        return (
            "steps or strong bends of the part, or alone among pixels without a phase; a finer film"
            " (width, height) has fewer"
        )
    return (
        "steps of the part, or of the projector's own pixels, where the camera's are not much"
        " smaller; a finer film (width, height) has fewer, and so have continuous patterns"
        " (pixels=false)"
    )


def _depth_note(state: FringeState) -> dict[str, bool]:
    """That points come from rows, or from the axis that tells next to nothing of their depth."""
    grid, decoded = state.grid, state.decoded
    per_mm = depth_in_axes(
        state.scene.camera, state.scene.projector.family, grid.pixel, grid.found.projector_pixel
    )
    by = dict(zip(COORDINATES.values(), per_mm.tolist(), strict=True))
    used, other = ("row", "column") if decoded.column is None else ("column", "row")
    if not by[other] > FAR_BETTER * by[used]:
        return {}
    if getattr(decoded, other) is not None:
        why = f"points are found by rows: along a line of sight they change by {by[other]:.2g}"
        return {f"{why} px/mm, columns by {by[used]:.2g}": False}
    along = {name: axis for axis, name in COORDINATES.items()}
    return {
        f"{used}s tell little of the depth, {by[used]:.2g} px/mm along a line of sight, {other}s"
        f" {by[other]:.2g}: project patterns along {along[other]} (--codec), or turn the projector"
        " by 90 degrees": True
    }


def _epipolar_facts(straight: Surface, grid: SearchedGrid) -> EpipolarFacts | None:
    residual = straight.range_image.epipolar_px
    if residual is None:
        return None
    both = np.where(grid.compared, grid.decoded_epipolar_px - grid.epipolar_px, np.nan)
    searched = np.where(grid.found.status == ProjectorPixelStatus.OK, grid.epipolar_px, np.nan)
    return EpipolarFacts(
        rms_px=rms(residual),
        largest_px=largest(residual),
        pixels=int(np.isfinite(residual).sum()),
        searched_rms_px=rms(searched),
        searched_largest_px=largest(searched),
        difference_rms_px=rms(both),
    )


def state_notes(state: FringeState, codec: Codec) -> dict[str, bool]:
    """What the user should know of a state; of each whether the figures are worth little for it."""
    facts, decoded, agreement = state.summary, state.decoded, state.summary.decoded_minus_search
    notes = dict.fromkeys([*frame_notes(facts.frames.report), *decoded.notes], False)
    notes |= dict.fromkeys(facts.frames.recording_notes, False)
    if not facts.decoded.pixels:
        return {**notes, f"no pixel has a phase: {counts_in_words(facts.decoded.status)}": True}
    seen = {name: n for name, n in agreement.only_searched.items() if name != _AT_EDGES}
    if (lost := sum(seen.values())) > _MANY * agreement.searched:
        notes[
            f"{lost} of {agreement.searched} searched pixels are not decoded:"
            f" {counts_in_words(seen)}"
        ] = True
    if facts.decoded.status[_OUTSIDE] and (border_px := state.scene.projector.blurred_border_px):
        notes[
            f"{border_px:.2g} px along the border of the projector's image are left out (outside):"
            " its blur mixes their light with the dark beside it"
        ] = False
    edges = facts.decoded.status[_AT_EDGES]
    if edges > _MANY * (edges + facts.decoded.pixels):
        notes[
            f"{edges} of {edges + facts.decoded.pixels} pixels with a phase are left out as edges:"
            f" {_edges_words(state)}"
        ] = False
    for light, surface in state.surfaces.items():
        status = surface.range_image.status[decoded.ok]
        counts = counts_of(status[status != CrossingStatus.OK], CrossingStatus)
        if missing := sum(counts.values()):
            poor = missing > _MANY * facts.decoded.pixels
            notes[
                f"{missing} of {facts.decoded.pixels} decoded pixels have no {light} point:"
                f" {counts_in_words(counts)}"
            ] = poor
    notes |= _depth_note(state)
    notes |= dict.fromkeys(_beyond_noise(state), False)
    period = min((getattr(each, "period_px", np.inf) for each in codec.patterns), default=np.inf)
    wrong = np.abs(state.grid.difference_px) > 0.5 * period
    if count := int(np.any(wrong, axis=1).sum()):
        notes[
            f"{count} of {int(state.grid.compared.sum())} compared pixels are off the search by"
            f" more than half a period of {period:g} px: wrong fringe orders; take more steps, or"
            " periods nearer to each other"
        ] = True
    return notes
