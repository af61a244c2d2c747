"""Modelling no more than a scene needs: the cheapest settings whose error is within a tolerance.

The error is that of the line centres, in px, the largest of all columns.  It is estimated in parts,
each by a few rays or a few columns of the very scene:

* refraction left out: how far the searched line moves from cold to hot;
* the march's step: bent rays by this step beside those by a quarter of the finest;
* the tables: their own estimate;
* samples: line centres of some columns by so many samples, beside those by many;
* light that bounces, where the scene has it: its noise in the line's centres, by so many points of
  the lit stripe for each sample;
* the lens, where there is one: the same by so many sub-pupils, and so many samples of a pixel
  through each.  Its blur is never left out: it makes the line's width, and so its noise.
"""

from collections.abc import Mapping
from dataclasses import dataclass, replace
from typing import Self

import numpy as np
from numpy.typing import NDArray

from virtual_sensor.errors import InputError
from virtual_sensor.imaging.checks import check_scene
from virtual_sensor.imaging.layers import stands_out
from virtual_sensor.imaging.render import DIRECT, indirect_columns, lit_pixels, render_columns
from virtual_sensor.imaging.scene import Scene
from virtual_sensor.metrology.centres import LineCentres
from virtual_sensor.metrology.line_peaks import line_centres
from virtual_sensor.metrology.truth import TrueLine, compare_line
from virtual_sensor.optics.ray_maps import NoMapError, displaced
from virtual_sensor.optics.ray_search import FoundPixels, ray_search
from virtual_sensor.optics.rays import Field, March
from virtual_sensor.records import Record

Array = NDArray[np.float64]
Index = NDArray[np.intp]

STEPS_MM = (8.0, 4.0, 2.0, 1.0, 0.5)
"""Steps of the march that are tried, coarsest first."""
SAMPLES = (1, 4, 9, 16, 36)
"""Samples per pixel that are tried, fewest first."""

SUB_PUPILS = ((4, 1), (9, 1), (16, 1), (16, 4), (36, 4))
"""Sub-pupils of a lens that are tried, and samples of a pixel through each, fewest first."""

INDIRECT_SAMPLES = (1, 4, 16, 64)
"""Points of the lit stripe for each sample of light that bounces that are tried, fewest first."""

_MANY_SAMPLES = 100
_MANY_FRAMES = 8  # by the most points of the stripe
_MANY_SUB_PUPILS = 64, 4
_RAYS = 33  # along the line
_GROUPS = 16  # of columns, the line's ends among them
_BESIDE = 2  # columns each side: one with none beside it is taken for the line's end
_SHARE = {"march": 0.2, "tables": 0.3}  # of the tolerance, at most
_WHOLE_PX = 1.0  # from the searched line's ends: its flanks end as much as half a pixel sooner
_LOST = 0.1  # of the columns: a configuration that finds fewer centres does not do


@dataclass(frozen=True)
class Configuration(Record):
    """Settings to render frames with, and why.

    Attributes
    ----------
    transport : str
        How light is carried through the air.
    step_mm : float
        Of the march.
    spp : int
        Samples per pixel.
    table_px : float
        Tolerance of the ray maps.
    sub_pupils : int
        Of the lens; 0 where the camera is a pinhole.
    indirect_samples : int
        Points of the lit stripe for each sample of light that bounces; 0 of direct light alone.
    estimate_px : dict
        The parts of its estimated error.
    why : list of str
        What was weighed, in words.
    """

    transport: str
    step_mm: float
    spp: int
    table_px: float
    sub_pupils: int
    indirect_samples: int
    estimate_px: dict[str, float]
    why: list[str]

    @property
    def error_px(self) -> float:
        """The sum of the parts."""
        return float(sum(self.estimate_px.values()))

    @property
    def parameters(self) -> dict[str, str]:
        """The scene's parameters that choose it."""
        also = {"sub_pupils": self.sub_pupils, "indirect_samples": self.indirect_samples}
        return {
            "transport": self.transport,
            "step": f"{self.step_mm:g}",
            "spp": str(self.spp),
            "tolerance": f"{self.table_px:g}",
            **{name: str(number) for name, number in also.items() if number},
        }

    def knowing(self, words: str, estimate_px: Mapping[str, float] | None = None) -> Self:
        """The same with what was found out, and parts of its error."""
        estimate = {**self.estimate_px, **(estimate_px or {})}
        return replace(self, estimate_px=estimate, why=[*self.why, words])

    def __str__(self) -> str:
        parts = ", ".join(f"{name} {px:.2g}" for name, px in self.estimate_px.items())
        step = f", step {self.step_mm:g} mm" if self.transport != "straight" else ""
        maps = f", tolerance {self.table_px:.2g} px" if self.transport == "tabulated" else ""
        lens = f", {self.sub_pupils} sub-pupils" if self.sub_pupils else ""
        stripe = f", {self.indirect_samples} indirect samples" if self.indirect_samples else ""
        settings = f"transport {self.transport}{step}{maps}, spp {self.spp}{lens}{stripe}"
        return f"{settings}: about {self.error_px:.2g} px ({parts})"


def choose(scene: Scene, tolerance_px: float) -> Configuration:
    """The cheapest configuration whose estimated error keeps a tolerance.

    Straight light is cheapest, then tables, then marching; fewer samples, or sub-pupils of a lens,
    before more.

    Parameters
    ----------
    scene : Scene
    tolerance_px : float
        Of the line centres.

    Raises
    ------
    InputError
        If the tolerance is no positive number, the scene has no line whose centres could be judged,
        or no configuration keeps it.
    """
    if not (np.isfinite(tolerance_px) and tolerance_px > 0.0):
        raise InputError(f"tolerance {tolerance_px}: give a positive number of px")
    if scene.sensor.laser.dots_mm.size:
        raise InputError(f"{scene.path}: a tolerance is of a line's centres; the laser makes dots")
    hot, cold = (search_line(s) for s in (scene, scene.cold()))
    whole = whole_columns(hot)
    if not whole.size:
        check_scene(scene)  # may know why
        raise InputError(f"{scene.path}: the laser's line fills no column of the image")
    column = groups(whole, np.linspace(0.0, 1.0, _GROUPS))
    step_mm = scene.transport.march.step_mm
    sub_pupils, spp = _tried(scene)[-1]
    found = Configuration("straight", step_mm, spp, tolerance_px, sub_pupils, 0, {}, [])
    if scene.field is None:
        found = found.knowing("no field: light runs straight")
    else:
        moved = _moved(hot, cold, scene.sensor.camera.size[0])
        words = f"refraction moves the line by up to {moved:.2g} px"
        found = found.knowing(words, {"refraction left out": moved})
    first = found
    if found.error_px <= tolerance_px:
        straight = scene_on(scene, "straight", step_mm, tolerance_px)
        found = _with_samples(straight, found, tolerance_px, column)
    if scene.field is not None and found.error_px > tolerance_px:
        found = _bent(scene, scene.field, hot, tolerance_px, column, first)
    if found.error_px > tolerance_px:
        raise InputError(
            f"tolerance {tolerance_px:g} px: the best that was found is {found}; ask for more, or"
            f" set method, step{', sub_pupils' if found.sub_pupils else ''}"
            f"{', max_depth' if found.indirect_samples else ''} and spp (-D) yourself"
        )
    return found


def _bent(
    scene: Scene,
    field: Field,
    hot: FoundPixels,
    tolerance_px: float,
    column: Index,
    straight: Configuration,
) -> Configuration:
    """Bent light by tables, marched where there are none, with the fewest samples that do."""
    table_px = _SHARE["tables"] * tolerance_px
    found = replace(straight, transport="tabulated", step_mm=min(STEPS_MM), table_px=table_px)
    found = replace(found, estimate_px={})
    try:
        step, error = _step(scene, field, hot, _SHARE["march"] * tolerance_px)
        words = f"a step of {step:g} mm errs by {error:.2g} px"
        found = replace(found, step_mm=step).knowing(words, {"march": error})
    except NoMapError as no_rays:  # the march by samples has a status for each
        words = f"the march's error is not known, so its step is the shortest: {no_rays}"
        found = found.knowing(words)
    if found.error_px > tolerance_px:
        return found  # it won't do
    tried = scene_on(scene, "tabulated", found.step_mm, table_px)
    made = lit_pixels(tried).report
    if made.transport == "tabulated":
        words = f"the ray maps err by {made.map_error_px:.2g} px"
        found = found.knowing(words, {"tables": made.map_error_px})
    else:
        found = replace(found, transport=made.transport).knowing(f"no tables: {made.reason}")
    return _with_samples(tried, found, tolerance_px, column)


def configured(scene: Scene, configuration: Configuration) -> Scene:
    """The scene with a configuration's parameters and transport.

    Raises
    ------
    InputError
        If the scene has no such parameters.
    """
    again = scene.with_parameters(**configuration.parameters)
    return scene_on(again, configuration.transport, configuration.step_mm, configuration.table_px)


def search_line(scene: Scene) -> FoundPixels:
    """Search some rays all along the line."""
    line_y = np.linspace(-0.5, 0.5, _RAYS) * scene.sensor.laser.length_mm
    return ray_search(scene, line_y, "newton")


def scene_on(scene: Scene, name: str, step_mm: float, table_px: float) -> Scene:
    """The scene with the same air and another transport through it."""
    transport = replace(scene.transport.by(name, step_mm=step_mm), tolerance_px=table_px)
    return scene.with_transport(transport)


def whole_columns(found: FoundPixels) -> Index:
    """Columns that lie wholly on a searched line: only these can have its centre."""
    u = found.pixel[np.isfinite(found.pixel[:, 0]), 0]
    if not u.size:
        return np.zeros(0, np.intp)
    first, last = np.ceil(u.min() + _WHOLE_PX), np.floor(u.max() - _WHOLE_PX)
    return np.arange(first, last + 1.0).astype(np.intp)


def groups(column: Index, middle: Array) -> Index:
    """Some of the columns, five side by side: a centre with none beside it is held for an end's.

    `middle` are the groups' places among the columns, from 0 to 1: from end to end.
    """
    at = np.rint(_BESIDE + middle * (column.size - 1 - 2 * _BESIDE)).astype(int)
    beside = at[:, None] + np.arange(-_BESIDE, _BESIDE + 1)
    return np.unique(column.take(beside, mode="clip"))


def line_of(scene: Scene, column: Index, spp: int) -> LineCentres:
    """The line's centres in some columns of a frame."""
    return line_centres(render_columns(scene, column, spp))


def largest_error(line: LineCentres, truth: TrueLine) -> float:
    """Largest error of the centres, px; infinite if too many columns are lost."""
    errors = compare_line(line, truth)
    enough = errors.count and errors.count >= (1.0 - _LOST) * errors.expected
    return errors.largest_px if enough else float("inf")


def _moved(one: FoundPixels, other: FoundPixels, width: int) -> float:
    """Largest distance in v of two searched lines, at the same u; infinite where they fold."""
    lines = []
    for found in (one, other):
        pixel = found.pixel[np.isfinite(found.pixel[:, 0])]
        lines.append(TrueLine.of_search(pixel, np.ones(len(pixel), bool), width, np.inf))
    errors = compare_line(lines[0].centres(_WHOLE_PX), lines[1], end_px=_WHOLE_PX)
    return errors.largest_px if errors.count else float("inf")


def _step(
    scene: Scene, field: Field, found: FoundPixels, tolerance_px: float
) -> tuple[float, float]:
    """The longest step whose bent rays err by less than a tolerance, and that error in px.

    Raises
    ------
    NoMapError
        If a ray does not get to the line.
    """
    point = found.laser_point_mm[np.isfinite(found.pixel[:, 0])]
    camera, march = scene.sensor.camera, scene.transport.march
    laser = scene.sensor.laser.family
    seen, lit = camera.coordinates(point), laser.coordinates(point)
    pixel_mm = camera.pixel_mm(point)

    def moved_px(march: March) -> Array:
        camera_mm = displaced(field, camera, march, seen)[:, :2]
        laser_mm = displaced(field, laser, march, lit)[:, :2]
        return np.hstack([camera_mm, laser_mm]) / pixel_mm[:, None]

    best = moved_px(March(STEPS_MM[-1] / 4.0, "leapfrog", "double"))
    for step in STEPS_MM:
        wrong = np.abs(moved_px(replace(march, step_mm=step)) - best)
        error = float(wrong[:, :2].max() + wrong[:, 2:].max())
        if error <= tolerance_px:
            break
    return step, error


def _with_samples(
    scene: Scene, found: Configuration, tolerance_px: float, column: Index
) -> Configuration:
    """The configuration with the fewest samples per pixel that keep what is left of a tolerance.

    Through a lens, the fewest sub-pupils.
    """
    sub_pupils, spp = _MANY_SUB_PUPILS if scene.camera.blurs else (0, _MANY_SAMPLES)
    spp *= sub_pupils or 1
    best = TrueLine.of_rows(line_of(through(scene, sub_pupils), column, spp).pixel[:, 1])
    if not best.columns().size:
        raise InputError(
            "no column has a line centre with which a tolerance could be judged; give a wider line"
            " (line_radius) or a finer film (width, height)"
        )
    for sub_pupils, spp in _tried(scene):
        error = largest_error(line_of(through(scene, sub_pupils), column, spp), best)
        if error <= tolerance_px - found.error_px:
            break
    samples = f"{spp} sample{'s' * (spp != 1)} per pixel"
    by = f"{sub_pupils} sub-pupils and {samples}" if sub_pupils else samples
    words = f"an error of {error:.2g} px by {by}"
    part = {"lens" if sub_pupils else "samples": error}
    found = replace(found, spp=spp, sub_pupils=sub_pupils).knowing(words, part)
    if scene.max_depth == DIRECT or found.error_px > tolerance_px:
        return found
    return _with_indirect_samples(through(scene, sub_pupils), found, tolerance_px, column)


def _with_indirect_samples(
    scene: Scene, found: Configuration, tolerance_px: float, column: Index
) -> Configuration:
    """The configuration with the fewest points of the stripe that keep what is left.

    In columns whose line stands out of the light that bounces.
    """
    direct = render_columns(scene, column, found.spp)
    most = INDIRECT_SAMPLES[-1]
    many = [indirect_columns(scene, column, most, 1 + seed) for seed in range(_MANY_FRAMES)]
    mean = np.mean(many, axis=0)
    clear = stands_out(direct, mean)
    best = TrueLine.of_rows(np.where(clear, line_centres(direct + mean).row, np.nan))
    for number in INDIRECT_SAMPLES:
        noisy = direct + indirect_columns(scene, column, number)
        error = largest_error(line_centres(noisy), best)
        if error <= tolerance_px - found.error_px:
            break
    words = f"light that bounces errs by {error:.2g} px by {number} points of the stripe a sample"
    return replace(found, indirect_samples=number).knowing(words, {"light that bounces": error})


def _tried(scene: Scene) -> list[tuple[int, int]]:
    """Sub-pupils, 0 of a pinhole, and samples per pixel, the fewest first."""
    if scene.camera.blurs:
        return [(number, number * each) for number, each in SUB_PUPILS]
    return [(0, spp) for spp in SAMPLES]


def through(scene: Scene, sub_pupils: int) -> Scene:
    """The scene, seen through so many sub-pupils of its camera's lens; 0: as it is."""
    if not sub_pupils:
        return scene
    return scene.with_camera(replace(scene.camera, sub_pupils=sub_pupils))
