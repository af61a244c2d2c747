"""Sequences: what a camera sees while a projector shows one pattern after the other.

Patterns change no ray.  While nothing moves, each sample's rays are traced once; what it keeps, its
coordinates of the projector and how its surface scatters, gives the light of all patterns.
"""

from __future__ import annotations

from collections.abc import Callable, Iterable, Iterator, Sequence
from dataclasses import dataclass, replace
from functools import cached_property
from pathlib import Path
from typing import Any, ClassVar

import numpy as np
from numpy.typing import NDArray
from virtual_sensor_plugins.exposure import ONE_FRAME
from virtual_sensor_plugins.renderer import Fluxes, Prepared

from virtual_sensor.arrays import where
from virtual_sensor.calls import public
from virtual_sensor.child import physical_memory
from virtual_sensor.devices.patterns import Pattern, Uniform, pattern_of
from virtual_sensor.devices.projector import Projector
from virtual_sensor.display import Displayed, listed
from virtual_sensor.errors import InputError, naming, short
from virtual_sensor.imaging.render import (
    Frame,
    Image,
    PixelTruth,
    RenderReport,
    checked,
    part_of,
    prepared_for,
    truth_of,
)
from virtual_sensor.imaging.scene import Scene
from virtual_sensor.medium.index_field import IndexField, field_of
from virtual_sensor.optics.sight import check_progress, scene_of

_BYTES = 4  # of a radiance
_HALF = 0.5  # of the memory: the rest is for what makes the frames


@dataclass(frozen=True, eq=False)
class PatternFrames(Displayed):
    """Frames of a sequence of K patterns.

    >>> codec = vs.PhaseShift(steps=4)
    >>> frames = vs.render_sequence("fringe_cylinder", codec.patterns)
    >>> grey = vs.grey_values(frames, peak_e=8000)  # (K, H, W)
    >>> decoded = codec.decode(grey)

    Attributes
    ----------
    radiance : ndarray of shape (K, H, W)
        W/(mm^2 sr), averaged over each pixel.
    patterns : tuple of K Pattern
    source : str
        Name of the projector that shows them.
    projector : Projector
        It, as the first frame has it.
    truth : PixelTruth
        The truth at the pixels' centres: of the first frame, if something moves.
    traces : int
        How often rays were traced: once, if nothing moves.
    report : RenderReport
        How the frames were made; of several traces all reasons, the largest errors and the sums of
        samples.
    """

    _field_units: ClassVar = {"radiance": "W/(mm² sr)"}

    radiance: Image
    patterns: tuple[Pattern, ...]
    source: str
    projector: Projector
    truth: PixelTruth
    traces: int
    report: RenderReport

    def __len__(self) -> int:
        return len(self.patterns)

    def __array__(self, dtype: Any = None, copy: bool | None = None) -> NDArray:
        """The radiances, wherever images are asked for."""
        return np.array(self.radiance, dtype) if copy else np.asarray(self.radiance, dtype)

    def _line(self) -> str:
        count, height, width = self.radiance.shape
        traces = "traced once" if self.traces == 1 else f"traced {self.traces} times"
        brightest = f"up to {self.radiance.max(initial=0.0):.4g} W/(mm² sr)"
        return listed(f"{count} of {width} x {height} px", traces, brightest)

    def _columns(self) -> dict[str, Any]:
        return {
            "frame": np.arange(len(self)),
            "pattern": np.array([f"{pattern.text}" for pattern in self.patterns]),
            "mean": self.radiance.mean(axis=(1, 2)),
            "brightest": self.radiance.max(axis=(1, 2)),
        }

    def frame(self, number: int) -> Frame:
        """One of the frames, with the truth."""
        return Frame(self.radiance[number], self.truth, {}, self.report)

    @cached_property
    def projector_pixel(self) -> NDArray[np.float64]:
        """Pixel of the projector that lights each pixel's centre, (H, W, 2); NaN where none does.

        Of the first frame, if something moves.
        """
        s, t = self.truth.source_coordinates[self.source].T.astype(float)
        pixels = np.full((self.radiance[0].size, 2), np.nan)
        pixels[self.truth.index] = np.stack(self.projector.pixels_of(s, t), axis=-1)
        return pixels.reshape(*self.radiance.shape[1:], 2)


@public
def render_sequence(
    scene: Scene | str | Path,
    patterns: Iterable[Pattern | str | Path],
    *,
    spp: int | None = None,
    seed: int = 0,
    media: Iterable[IndexField | str | Path | None] | None = None,
    scenes: Iterable[Scene] | None = None,
    progress: Callable[[float], None] | None = None,
    camera: str | None = None,
    source: str | None = None,
) -> PatternFrames:
    """Render a camera's images while a projector shows patterns.

    Other sources of the scene shine too, and its lamps, and what glows.  Where a scene has several
    projectors, `source` says which one shines.

    >>> steps = [f"sine u 16 {2 * np.pi * k / 4}" for k in range(4)]
    >>> frames = vs.render_sequence("fringe_cylinder", steps)
    >>> moved = (scene.at(time_s) for time_s in (1.0, 1.1, 1.2, 1.3))
    >>> frames = vs.render_sequence(scene, steps, scenes=moved)

    Parameters
    ----------
    scene : Scene, str or Path
        From `load_scene`, or its name or path.
    patterns : iterable of K Pattern, str or Path
        In the order in which they are shown; texts and image files as `pattern_of` takes them.
    spp, seed, camera, source
        As those of `render`; each frame has the same samples.
    media : iterable of K IndexField, str, Path or None, optional
        The air in each frame: fields, their files or names; None: no hot air, and a cold part.
    scenes : iterable of K Scene, optional
        The scene in each frame: where its part, its glow, a pose, or its air of another instant
        (`Scene.at`) changes.  Rays are traced again where a frame's differs from the one before.
    progress : callable, optional
        Is called with the fraction of the samples done.

    Raises
    ------
    InputError
        If a pattern is none, or of another size than the projector; the scene has no projector;
        `media` or `scenes` are not K; frames differ in size; or they don't fit in the memory.
    EngineError
        If the scene was loaded under another Mitsuba variant.
    """
    check_progress("render_sequence", progress)
    shown = _patterns(patterns)
    scene, samples, seed = checked("render_sequence", scene, spp, seed, camera, source)
    name = scene.projector_name
    _check_memory(scene, len(shown))
    images, reports, first_truth = [], [], None
    for each, first, last in _groups(scene, len(shown), media, scenes):
        each = each.only(camera, source)
        if each.camera.size != scene.camera.size:
            raise InputError(
                f"render_sequence: scenes: frame {first} is of {_size(each)} px, and the scene of"
                f" {_size(scene)}; give scenes whose images are of one size"
            )
        devices = [each.projector.with_pattern(pattern) for pattern in shown[first:last]]
        with ONE_FRAME:
            prepared = prepared_for(each)
            tell = part_of(progress, first / len(shown), last / len(shown))
            fluxes = {each.projector_name: _fluxes(devices)}
            frames = last - first
            exposure, report = prepared.exposed(samples, seed, tell, frames=frames, fluxes=fluxes)
            images.append(exposure.images())
            if prepared.bounces:
                images[-1] = images[-1] + _indirect(prepared, each.projector_name, devices, seed)
            reports.append(report)
            if first_truth is None:
                first_truth = each.projector.with_pattern(Uniform()), truth_of(prepared)
    radiance = images[0] if len(images) == 1 else np.concatenate(images)
    assert first_truth is not None
    return PatternFrames(radiance, shown, name, *first_truth, len(reports), report_of_all(reports))


def _patterns(patterns: Iterable[Pattern | str | Path]) -> tuple[Pattern, ...]:
    if isinstance(patterns, Pattern | str | Path):
        patterns = [patterns]
    try:
        given = list(patterns)
    except TypeError:
        given = []
    if not given:
        raise InputError(
            f"render_sequence: patterns is {short(patterns)}; give one Pattern or text for each"
            " frame, such as ['sine u 16 0', 'white']"
        )
    shown = []
    for number, each in enumerate(given):
        with naming(f"render_sequence: patterns: number {number}"):
            shown.append(pattern_of(each))
    return tuple(shown)


def _groups(
    scene: Scene,
    count: int,
    media: Iterable[IndexField | str | Path | None] | None,
    scenes: Iterable[Scene] | None,
) -> Iterator[tuple[Scene, int, int]]:
    """The scene of frames, and the first of them and the one behind the last, while it is one.

    What is given is taken one by one: fields of moving air may be large.
    """
    if media is not None and scenes is not None:
        raise InputError("render_sequence: media and scenes are both given; give scenes alone")
    if media is None and scenes is None:
        yield scene, 0, count
        return
    name = "media" if scenes is None else "scenes"
    asker = f"render_sequence: {name}"
    given = _each(asker, media if scenes is None else scenes)
    first, before = 0, None
    for number in range(count):
        try:
            each = next(given)
        except StopIteration:
            raise InputError(_unequal(asker, number, count)) from None
        with naming(f"{asker}: number {number}"):
            if scenes is None:
                now = scene.with_medium(field_of("the air", each, scene.air.wavelength_nm))
            else:
                now = scene_of("render_sequence", each)
        if before is not None and now != before:
            yield before, first, number
            first = number
        before = now
    if next(given, given) is not given:
        raise InputError(_unequal(asker, count + 1, count))
    assert before is not None
    yield before, first, count


def _each(asker: str, given: Any) -> Iterator[Any]:
    try:
        return iter([given] if isinstance(given, str | Path | IndexField | Scene) else given)
    except TypeError:
        raise InputError(f"{asker} is {short(given)}; give a list, one for each frame") from None


def _unequal(asker: str, number: int, count: int) -> str:
    many = f"{number}" if number < count else f"more than {count}"
    return f"{asker}: {many} given for {count} patterns; give one for each"


def _indirect(prepared: Prepared, name: str, devices: Sequence[Projector], seed: int) -> Image:
    """Light that bounces while a projector shows patterns, (K, H, W): of each by itself."""
    given = prepared.arrangement
    shown = (replace(given, sources={**given.sources, name: each}) for each in devices)
    return np.stack([replace(prepared, arrangement=each).bounced_light(seed) for each in shown])


def _fluxes(devices: Sequence[Projector]) -> Fluxes:
    """The flux of one projector with several patterns: its pixels are found once."""
    first = devices[0]

    def fluxes(s: Any, t: Any, depth: Any) -> list[Any]:
        pixels, full, lit = first.pixels_of(s, t), first.density(s, t), first.reaches(s, t)
        return [where(lit, full * each.shown(*pixels), 0.0) for each in devices]

    return fluxes


def report_of_all(reports: Sequence[RenderReport]) -> RenderReport:
    """How frames of several traces were made: nothing that went otherwise than asked is lost."""
    first = reports[0]
    if len(reports) == 1:
        return first
    otherwise = next((each for each in reports if each.reason), first)
    reasons = dict.fromkeys(each.reason for each in reports if each.reason)

    def largest(name: str) -> float:
        return float(np.fmax.reduce([getattr(each, name) for each in reports]))

    return replace(
        first,
        transport=otherwise.transport,
        reason="; ".join(reasons) or None,
        samples=sum(each.samples for each in reports),
        marched_samples=sum(each.marched_samples for each in reports),
        folded_pixels=max(each.folded_pixels for each in reports),
        map_error_px=largest("map_error_px"),
        march_px=largest("march_px"),
        pupil_gap_px=largest("pupil_gap_px"),
    )


def _check_memory(scene: Scene, frames: int) -> None:
    width, height = scene.camera.size
    needed, memory = frames * width * height * _BYTES, physical_memory()
    if needed > _HALF * memory:
        most = int(_HALF * memory / (width * height * _BYTES))
        raise InputError(
            f"render_sequence: {frames} frames of {_size(scene)} px take {needed / 1e9:.3g} GB,"
            f" and this machine has {memory / 1e9:.3g}; render at most {most} at a time, or smaller"
            " ones"
        )


def _size(scene: Scene) -> str:
    width, height = scene.camera.size
    return f"{width} x {height}"
