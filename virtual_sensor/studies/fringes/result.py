"""What a measurement by fringes gives: images for each state of the part, and their figures."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, field
from typing import Annotated, Any

import numpy as np
from numpy.typing import NDArray

from virtual_sensor.display import Displayed, listed
from virtual_sensor.imaging.render import RenderReport
from virtual_sensor.imaging.scene import Scene
from virtual_sensor.metrology.fringes.decoded import COORDINATES, FringeStatus
from virtual_sensor.optics.projector_pixels import ProjectorPixelStatus
from virtual_sensor.records import Record, Table, status_names
from virtual_sensor.studies.fringes.decoded_facts import DecodedFacts
from virtual_sensor.studies.provenance import SceneFacts

Array = NDArray[np.float64]
Texts = NDArray[np.str_]


@dataclass(frozen=True)
class Surface(Displayed):
    """A surface that was measured.

    Attributes
    ----------
    range_image : RangeImage
        A point for each pixel.
    deviation_um : ndarray of shape (H, W)
        Of the points from the true surface, along its normal: positive outside the part; NaN
        where there is no point, and at the part's edges.
    facts : SurfaceFacts
    """

    range_image: Any
    deviation_um: NDArray[np.float32]
    facts: SurfaceFacts

    def _line(self) -> str:
        return listed(f"{self.facts.points} points", f"{self.facts.rms_um:.3g} um rms")


@dataclass(frozen=True)
class SearchedGrid(Displayed):
    """Camera pixels of a grid, and the projector pixels that a search of rays finds for them.

    Attributes
    ----------
    pixel : ndarray of shape (N, 2)
        (u, v) of the camera, whole numbers.
    found : ProjectorPixels
        By the search.
    decoded_px : ndarray of shape (N, 2)
        (u, v) of the projector as decoded there; NaN without, and along an axis without patterns.
    compared : ndarray of bool of shape (N,)
        Whether both are good.
    straight_um : ndarray of shape (N,)
        Distances from the true surface of the points that the searched pixels give as if light ran
        straight.
    epipolar_px, decoded_epipolar_px : ndarray of shape (N,)
        Epipolar residual of searched and decoded pixels, camera px.
    """

    pixel: Array
    found: Any
    decoded_px: Array
    compared: NDArray[np.bool_]
    straight_um: Array
    epipolar_px: Array
    decoded_epipolar_px: Array

    @property
    def row_column(self) -> tuple[NDArray[np.int64], NDArray[np.int64]]:
        """Row and column (N,) of the pixels: the index of an image there."""
        column, row = np.rint(self.pixel).astype(np.int64).T
        return row, column

    @property
    def difference_px(self) -> Array:
        """Decoded minus searched (N, 2); NaN of pixels that are not compared."""
        difference = self.decoded_px - self.found.projector_pixel
        return np.where(self.compared[:, None], difference, np.nan)


@dataclass(frozen=True)
class FringeState(Displayed):
    """The part measured cold, or hot.

    Attributes
    ----------
    scene : Scene
    images : ndarray of shape (K, H, W)
        What was decoded, a frame for each of the codec's patterns: radiance, or a camera's grey
        values.  Where frames are not kept in full (`Settings.frames`), H and W are smaller.
    decoded : DecodedFringes
    straight : Surface
        Found as if light ran straight.
    bent : Surface or None
        Found through the air; None where light runs straight.
    grid : SearchedGrid
    summary : FringeStateSummary
    metadata : Mapping
        Of recorded frames, as their files carry it; empty of others.
    """

    scene: Scene
    images: NDArray[Any]
    decoded: Any
    straight: Surface
    bent: Surface | None
    grid: SearchedGrid
    summary: FringeStateSummary
    metadata: Mapping[str, Any] = field(default_factory=dict, repr=False)

    @property
    def surfaces(self) -> dict[str, Surface]:
        """By "straight" and "bent"."""
        return {"straight": self.straight} | ({"bent": self.bent} if self.bent else {})

    def _columns(self) -> dict[str, NDArray[Any]]:
        return search_table(self).columns()

    def _line(self) -> str:
        return listed(f"{len(self.images)} frames", f"{self.summary.decoded.pixels} pixels decoded")


@dataclass(frozen=True)
class FringeMeasurement(Displayed):
    """The part measured cold and, if the scene has a field, hot.

    Attributes
    ----------
    cold : FringeState
    hot : FringeState or None
    codec : PhaseShift, GrayCode or SingleShot
        What the patterns are made and decoded by.
    summary : FringeSummary
    """

    cold: FringeState
    hot: FringeState | None
    codec: Any
    summary: FringeSummary

    @property
    def scene(self) -> Scene:
        """The scene that was given."""
        return (self.hot or self.cold).scene

    @property
    def states(self) -> dict[str, FringeState]:
        """The states by name."""
        return {"cold": self.cold} | ({"hot": self.hot} if self.hot else {})

    def _columns(self) -> dict[str, NDArray[Any]]:
        columns = [state._columns() for state in self.states.values()]
        lengths = [len(each["pixel_u"]) for each in columns]
        named = {name: np.concatenate([each[name] for each in columns]) for name in columns[0]}
        return {"state": np.repeat([*self.states], lengths), **named}

    def _line(self) -> str:
        found = (
            f"{name} {each.summary.decoded.pixels} pixels" for name, each in self.states.items()
        )
        return listed(self.scene.path.name, *found, f"{self.summary.time_s:.3g} s")


@dataclass(frozen=True)
class FramesFacts(Record):
    """The frames of a state.

    Attributes
    ----------
    frames : int
        Patterns that were projected.
    size_px : tuple of int
        Width and height of a frame.
    samples_per_pixel : int
    report : RenderReport
        How they were rendered.
    electrons : float or None
        Of the brightest pixel; None of frames without noise.
    bits : int or None
        Of the camera; None of grey values that are not rounded.
    seed : int
        Of the camera's noise.
    sensor : str or None
        Name of the image sensor that recorded them, "usual" of the one that is taken by default;
        None of frames without noise.
    exposure_s : float or None
        Exposure time; None of a pinhole, which has none.
    recording_notes : tuple of str
        What is to be known of the exposure.
    """

    frames: int
    size_px: tuple[int, int]
    samples_per_pixel: int
    report: RenderReport
    electrons: float | None
    bits: int | None
    seed: int
    sensor: str | None
    exposure_s: float | None
    recording_notes: tuple[str, ...]


@dataclass(frozen=True)
class AxisAgreement(Record):
    """Decoded minus searched projector pixels along an axis, on a grid of the camera's pixels.

    Attributes
    ----------
    rms_px, largest_px : float
        Of the pixels that were compared.
    compared : int
    """

    rms_px: float
    largest_px: float
    compared: int


@dataclass(frozen=True)
class SearchAgreement(Record):
    """The check of renderer and decoder: decoded projector pixels beside the search of rays.

    Attributes
    ----------
    column, row : AxisAgreement or None
        None of an axis without patterns.
    searched : int
        Pixels of the grid whose projector pixel was found.
    only_searched : dict
        Pixels that the search finds and the decoder does not, by the decoder's status.
    only_decoded : dict
        Pixels that are decoded and not searched for with success, by the search's status.
    """

    column: AxisAgreement | None
    row: AxisAgreement | None
    searched: int
    only_searched: dict[str, int]
    only_decoded: dict[str, int]


@dataclass(frozen=True)
class EpipolarFacts(Record):
    """Epipolar residual: distance of a camera's pixel from its projector pixel's epipolar line.

    Attributes
    ----------
    rms_px, largest_px : float
        Of the decoded pixels, camera px.
    pixels : int
    searched_rms_px, searched_largest_px : float
        Of the searched pixels of the grid.
    difference_rms_px : float
        Decoded minus searched, of the pixels that have both.
    """

    rms_px: float
    largest_px: float
    pixels: int
    searched_rms_px: float
    searched_largest_px: float
    difference_rms_px: float


@dataclass(frozen=True)
class ShapeFit(Record):
    """The shape that was fitted to the points.

    Attributes
    ----------
    kind : str
        cylinder, plane or sphere.
    radius_mm : float or None
        None of a plane.
    radius_error_um : float or None
        Fitted minus true radius; None of a plane, or where the true radius is not known.
    std_um : float
        Standard deviation of the points' distances from it.
    points : int
        That took part.
    """

    kind: str
    radius_mm: float | None
    radius_error_um: float | None
    std_um: float
    points: int


@dataclass(frozen=True)
class SurfaceFacts(Record):
    """The measured surface beside the true one.

    Attributes
    ----------
    points : int
        Pixels that have a point.
    compared : int
        Those of them that lie before the true surface, away from its edges.
    mean_um, rms_um, largest_um : float
        Of their distances from it, positive outside the part; the largest with its sign.
    sigma_um : float
        Predicted standard deviation of a point along the line of sight, median.
    fit : ShapeFit or None
        None of a part that is no such shape.
    """

    points: int
    compared: int
    mean_um: float
    rms_um: float
    largest_um: float
    sigma_um: float
    fit: ShapeFit | None


@dataclass(frozen=True)
class FringeStateSummary(Record):
    """The figures of the part measured cold, or hot.

    Attributes
    ----------
    frames : FramesFacts
    decoded : DecodedFacts
    decoded_minus_search : SearchAgreement
    epipolar : EpipolarFacts or None
        None where one axis alone was projected.
    straight : SurfaceFacts
        Points found as if light ran straight.
    bent : SurfaceFacts or None
        Points found through the air; None where light runs straight.
    searched_rms_um : float
        Of the searched pixels' points, found as if light ran straight, from the true surface.
    straight_minus_search_um : float
        Straight points' distances from the true surface minus those of the searched pixels, rms.
    times_s : dict
        By what was done.
    """

    frames: FramesFacts
    decoded: DecodedFacts
    decoded_minus_search: SearchAgreement
    epipolar: EpipolarFacts | None
    straight: SurfaceFacts
    bent: SurfaceFacts | None
    searched_rms_um: float
    straight_minus_search_um: float
    times_s: dict[str, float]


@dataclass(frozen=True)
class FringeSummary(SceneFacts):
    """What shows whether a measurement by fringes is sound, and how good it is.

    Attributes
    ----------
    codec : str
        Of the patterns, as `--codec` takes it.
    medium : str or None
        Air through which bent points are found; None of a cold scene.
    states : dict of FringeStateSummary
        By "cold" and "hot".
    caveats : tuple of str
        Those of the notes that make the figures worth little.
    time_s : float
        Of the whole measurement, without the writing of results.
    """

    codec: str
    medium: str | None
    states: dict[str, FringeStateSummary]
    caveats: tuple[str, ...]
    time_s: float


BothAxes = Annotated[Mapping[str, Array], "column", "row"]


@dataclass(frozen=True)
class FringeSearchTable(Table):
    """Camera pixels of the search's grid, a row for each.

    Attributes
    ----------
    pixel : ndarray of shape (N, 2)
        Of the camera.
    searched_px, decoded_px : ndarrays of shape (N,)
        Projector pixel, by the search of rays and from the frames.
    difference_px : ndarrays of shape (N,)
        Decoded minus searched; empty where they are not compared.
    point_mm : ndarray of shape (N, 3)
        Where the line of sight meets the part, world.
    search_status, decoded_status : ndarray of str of shape (N,)
        Why there is a projector pixel, or none.
    """

    pixel: Array
    searched_px: BothAxes
    decoded_px: BothAxes
    difference_px: BothAxes
    point_mm: Array
    search_status: Texts
    decoded_status: Texts


def search_table(state: FringeState) -> FringeSearchTable:
    """A state's searched pixels."""
    grid = state.grid
    names = COORDINATES.values()

    def by_axis(values: Array) -> dict[str, Array]:
        columns = dict(zip(names, values.T, strict=True))
        return {n: c for n, c in columns.items() if getattr(state.decoded, n) is not None}

    return FringeSearchTable(
        pixel=grid.pixel,
        searched_px=by_axis(grid.found.projector_pixel),
        decoded_px=by_axis(grid.decoded_px),
        difference_px=by_axis(grid.difference_px),
        point_mm=grid.found.point_mm,
        search_status=status_names(grid.found.status, ProjectorPixelStatus),
        decoded_status=status_names(state.decoded.status[grid.row_column], FringeStatus),
    )
