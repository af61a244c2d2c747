"""What makes the error of a recorded measurement: the parts that each stage of the sensor adds.

A point is measured from the pixel in which the line is found.  Stage by stage, from straight light
to grey values, that place moves; what a stage adds is the distance from the true section after it
minus the one before it, so that the parts of each point add up to its whole error.

===========  ======================================================================================
Part         The line's place after it
===========  ======================================================================================
refraction   where the search finds the bent light's middle, without any image
lens         its mean over the points of a lens's pupil, by the same search: each has a line of
             sight of its own through the air
detector     where it is found in the ideal frame: by blur, slope and curvature another place; the
             mean of two frames, the pixels of one half a pixel lower
pixels       where it is found in the ideal frame itself
speckle      where it is found in light that is speckled, and not yet recorded
noise        where it is found in grey values of 16 bits: shot noise, dark noise, dark current and
             fixed pattern, clipping and knee
rounding     where it is found in the recorded grey values, of the sensor's own bits
===========  ======================================================================================
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, replace
from itertools import pairwise
from typing import TYPE_CHECKING, Annotated, Any, ClassVar

import numpy as np
from numpy.typing import NDArray

from virtual_sensor.display import Displayed, listed
from virtual_sensor.imaging.scene import Scene
from virtual_sensor.metrology.triangulation import triangulate
from virtual_sensor.metrology.truth import TrueLine, rms
from virtual_sensor.optics.pupil_search import PupilPixels, weighted
from virtual_sensor.records import Record, Table
from virtual_sensor.studies.section import Section

if TYPE_CHECKING:
    from virtual_sensor.imaging.recording import RecordedFrame

Array = NDArray[np.float64]
PARTS = ("refraction", "lens", "detector", "pixels", "speckle", "noise", "rounding")

_HALF_PX = 0.5
_MOST_BITS = 16  # of an image sensor


@dataclass(frozen=True)
class ErrorSplit(Displayed):
    """The error of N points, split into what each stage adds to it; NaN where a stage has no place.

    Attributes
    ----------
    pixel : ndarray of shape (N, 2)
        Where the line, or a dot, is found at last, (u, v).
    y_mm : ndarray of shape (N,)
        Position along the line of the point that is measured there.
    error_um : ndarray of shape (N,)
        Distance of that point from the true section: positive outside the part.
    parts_um : dict of ndarray of shape (N,)
        By the stage, what it adds to that distance.
    parts_px : dict of ndarray of shape (N,)
        By the stage, how far it moves the place across the line, along v.
    """

    _field_units: ClassVar = {"pixel": "px"}

    pixel: Array
    y_mm: Array
    error_um: Array
    parts_um: Mapping[str, Array]
    parts_px: Mapping[str, Array]

    def _line(self) -> str:
        parts = [f"{name} {rms(each[self.known]):.3g} um" for name, each in self.parts_um.items()]
        return listed(f"{self.known.sum()} points", *parts)

    def _columns(self) -> dict[str, NDArray[Any]]:
        return self.table.columns()

    @property
    def table(self) -> SplitTable:
        """Each point's error and its parts."""
        return SplitTable(self.pixel, self.y_mm, self.error_um, self.parts_um, self.parts_px)

    @property
    def known(self) -> NDArray[np.bool_]:
        """Of which points all parts are known, (N,)."""
        return np.asarray(np.isfinite([*self.parts_um.values()]).all(axis=0))

    @property
    def total_px(self) -> Array:
        """How far the places lie from those of straight light, (N,)."""
        return np.sum([*self.parts_px.values()], axis=0)

    @classmethod
    def of_places(
        cls, scene: Scene, section: Section, straight: Array, places: Mapping[str, Array]
    ) -> ErrorSplit:
        """Split by the places (N, 2) after each stage, in order; `straight` are before all."""
        points = {name: triangulate(scene.sensor, pixel) for name, pixel in places.items()}
        distance = [np.zeros(len(straight)), *map(section.distance_um, points.values())]
        row = [straight[:, 1], *(pixel[:, 1] for pixel in places.values())]
        last = list(places)[-1]
        um, px = (
            {
                name: after - before
                for name, (before, after) in zip(places, pairwise(each), strict=True)
            }
            for each in (distance, row)
        )
        return cls(places[last], section.along_mm(points[last]), distance[-1], um, px)


def split_error(
    scene: Scene,
    section: Section,
    straight: Array,
    searched: Array,
    lower: Array,
    places: Mapping[str, Array],
    through_lens: Array | None = None,
) -> ErrorSplit:
    """Split the error of a recorded frame.

    Parameters
    ----------
    scene : Scene
        Of the frame, with one camera and one source.
    section : Section
        The true one.
    straight, searched : ndarray of shape (N, 2)
        Where straight and where bent light is searched: in each column, or of each dot.
    lower : ndarray of shape (N, 2)
        Where the line or the dots are found in the ideal image of `half_a_pixel_lower`.
    places : mapping of ndarray of shape (N, 2)
        By the parts' names, where they are found after them: of "pixels", in the ideal frame, and
        on.
    through_lens : ndarray of shape (N, 2), optional
        Where bent light is searched through the lens's pupil; None of a pinhole.
    """
    before = {"refraction": searched}
    if through_lens is not None:
        before["lens"] = through_lens
    before["detector"] = 0.5 * (places["pixels"] + lower - [0.0, _HALF_PX])
    return ErrorSplit.of_places(scene, section, straight, {**before, **places})


def nearest_rows(line: TrueLine, row: Array) -> Array:
    """Rows (W,) of a line in each column, those next to others (W,) where it has several."""
    known = np.isfinite(line.row)
    away = np.where(known, np.abs(line.row - np.nan_to_num(row)), np.inf)
    rows: Array = np.take_along_axis(line.row, away.argmin(axis=0)[None], 0)[0]
    return rows


def half_a_pixel_lower(scene: Scene) -> Scene:
    """The same scene, in whose image all lies half a pixel lower."""
    camera = scene.camera
    matrix = camera.matrix + np.array([[0.0, 0.0, 0.0], [0.0, 0.0, _HALF_PX], [0.0, 0.0, 0.0]])
    return replace(scene, cameras={scene.camera_name: replace(camera, matrix=matrix)})


def in_16_bits(shot: RecordedFrame) -> RecordedFrame:
    """A frame as its sensor would record it with 16 bits: the same electrons, finer grey values."""
    from virtual_sensor.imaging.difference import DifferenceFrame, difference
    from virtual_sensor.imaging.recording import grey_of_radiance

    on = shot.on if isinstance(shot, DifferenceFrame) else shot
    finest = replace(on, sensor=on.sensor.with_bits(_MOST_BITS))
    grey = grey_of_radiance(
        on.light, on.electrons_per_radiance, finest.specimen, on.drawn["noise"], on.exposure_s
    )
    finest = replace(finest, grey=grey)
    return finest if on is shot else difference(finest)


def rows_through_pupil(seen: PupilPixels, row: Array) -> tuple[Array, NDArray[np.bool_]]:
    """Rows (W,) of a line in each column, those next to others (W,), and whether they are whole.

    They are means over the points of the pupil that see the line there, by the light of each; whole
    where all do.
    """
    from scipy.spatial import KDTree

    rows, light = np.full((2, len(seen.pixels), len(row)), np.nan)
    for number, (pixel, share) in enumerate(zip(seen.pixels, seen.column_light, strict=True)):
        line = TrueLine.of_search(pixel, np.isfinite(pixel[:, 0]), len(row))
        rows[number] = nearest_rows(line, row)
        column, lit = np.flatnonzero(np.isfinite(rows[number])), np.isfinite(share)
        if column.size and lit.any():  # the nearest ray's light is meant
            at = np.stack([column, rows[number, column]], axis=1)
            light[number, column] = share[lit][KDTree(pixel[lit]).query(at)[1]]
    known = np.isfinite(light)
    mean, _ = weighted(np.where(known, rows, 0.0), np.where(known, light, 0.0))
    return mean, np.isfinite(rows).all(axis=0)


@dataclass(frozen=True)
class PartErrors(Record):
    """What one part of the error comes to along the line.

    Attributes
    ----------
    rms_um, mean_um : float
        Of what it adds to the points' distances from the true section.
    rms_px, mean_px : float
        Of how far it moves the line's place in the image, across the line.
    """

    rms_um: float
    mean_um: float
    rms_px: float
    mean_px: float


@dataclass(frozen=True)
class SplitSummary(Record):
    """The error of a recorded measurement, and what it is made of.

    Attributes
    ----------
    points : int
        Of which all parts are known; the figures are of these.
    others : int
        Points whose error is known, and not all of its parts: where an edge cuts the line, say, the
        ideal frame may have no centre.
    whole : PartErrors
        The whole error.
    parts : dict of PartErrors
        By "refraction", "lens" (of one with a pupil), "detector", "pixels", "speckle" (where light
        is speckled), "noise" and "rounding".
    largest : str
        The part whose rms is largest; "" where none is known.
    """

    points: int
    others: int
    whole: PartErrors
    parts: dict[str, PartErrors]
    largest: str


def split_summary(split: ErrorSplit) -> SplitSummary:
    """The figures of a split error."""
    known = split.known

    def errors(um: Array, px: Array) -> PartErrors:
        um, px = um[known], px[known]
        if not um.size:
            return PartErrors(*[float("nan")] * 4)
        return PartErrors(rms(um), float(um.mean()), rms(px), float(px.mean()))

    parts = {name: errors(um, split.parts_px[name]) for name, um in split.parts_um.items()}
    largest = max(parts, key=lambda name: parts[name].rms_um) if known.any() else ""
    whole = errors(split.error_um, split.total_px)
    others = int((np.isfinite(split.error_um) & ~known).sum())
    return SplitSummary(int(known.sum()), others, whole, parts, largest)


ByPart = Annotated[
    Mapping[str, Array],
    "refraction",
    "lens",
    "detector",
    "pixels",
    "speckle",
    "noise",
    "rounding",
]


@dataclass(frozen=True)
class SplitTable(Table):
    """The error of each measured point and its parts, a row for each column of the image, or dot.

    Attributes
    ----------
    pixel : ndarray of shape (N, 2)
        Where the line, or the dot, is found; empty where it is not.
    y_mm : ndarray of shape (N,)
        Position of the point along the line.
    whole_um : ndarray of shape (N,)
        Its distance from the true section: positive outside the part.
    part_um : ndarrays of shape (N,)
        What each stage adds to that distance; they add up to it.
    part_px : ndarrays of shape (N,)
        How far each stage moves the place across the line, along v.
    """

    pixel: Array
    y_mm: Array
    whole_um: Array
    part_um: ByPart
    part_px: ByPart
