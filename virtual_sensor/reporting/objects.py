"""Pictures of objects: what `plot` draws in a user's axes, a notebook shows, and a file holds.

A drawing is found by its class's name, so that nobody imports what they don't use.
"""

from __future__ import annotations

import re
from collections.abc import Callable, Mapping, Sequence
from itertools import product
from pathlib import Path
from typing import TYPE_CHECKING, Any

import cv2
import numpy as np
from matplotlib.axes import Axes
from matplotlib.collections import PolyCollection
from matplotlib.colors import PowerNorm, to_rgb
from matplotlib.figure import Figure
from matplotlib.patches import Patch, PathPatch
from matplotlib.path import Path as Outline
from numpy.typing import NDArray

from virtual_sensor.display import names_of
from virtual_sensor.errors import InputError, a
from virtual_sensor.files import written_whole
from virtual_sensor.records import unit_of
from virtual_sensor.reporting.maps import draw_frames, draw_map, window_of
from virtual_sensor.reporting.pictures import coarser, from_side, side_of
from virtual_sensor.reporting.style import (
    ALONG,
    BLUE,
    CYCLE,
    GREY,
    VERMILION,
    colour,
    drawable,
    style,
    write_beside,
)

if TYPE_CHECKING:  # what they are, not what is imported
    from virtual_sensor.devices.image_sensor import ImageSensor
    from virtual_sensor.devices.patterns import Pattern
    from virtual_sensor.devices.projector import Projector
    from virtual_sensor.imaging.recording import RecordedFrame
    from virtual_sensor.imaging.render import Frame
    from virtual_sensor.imaging.sequence import PatternFrames
    from virtual_sensor.medium.index_field import IndexField
    from virtual_sensor.metrology.centres import LineCentres
    from virtual_sensor.metrology.cylinder_fit import CylinderFit
    from virtual_sensor.metrology.dot_peaks import DotCentres
    from virtual_sensor.metrology.fringes.decoded import DecodedFringes
    from virtual_sensor.metrology.range_image import RangeImage
    from virtual_sensor.metrology.truth import DotErrors, LineErrors, TrueLine
    from virtual_sensor.optics.lens import Lens
    from virtual_sensor.optics.ray_families import Pinhole, RayFamily
    from virtual_sensor.optics.sensitivity import Sensitivity
    from virtual_sensor.optics.trace import Rays
    from virtual_sensor.poses import Pose
    from virtual_sensor.records import Table

Array = NDArray[np.float64]
Draw = Callable[[Axes, Any], object]

_U, _V = "u in px", "v in px"
_DRAWINGS: dict[str, Draw] = {}
_USUAL_PX = 1280, 800  # of a projector
_DECIMALS = re.compile(r"(\.\d\d)\d+")
_BESIDE_IN = 2.0  # of axes: their numbers, and a colour bar
_MOST_PX = 600  # of an image along a side
_MOST_DOTS = 20_000  # points that are drawn
_MOST_TRIANGLES = 10_000
_SILHOUETTE_PX = 300  # of a fine mesh, along its longer side
_EDGE_ON = 0.95  # of a plane's normal that lies in the picture
_MARGIN_PX = 20  # about what is lit
_GHOST = 1e-3  # of a frame's brightest light: where less is reflected in between, is not shown
_DIM = 0.25  # power of their brightness, so that weak ghosts show too
_TINY = 1e-30
_HALF_FIELD = 0.08  # slope of the rays that a lens is drawn with
_LEAST_NEARNESS = 0.2  # of the depth in focus on the axis: what is in focus behind it is not drawn
_TURN = np.linspace(0.0, 2.0 * np.pi, 60)
_RING = np.stack([np.cos(_TURN), np.sin(_TURN), np.zeros(60)], axis=1)
_ROUND_SHAPES = {  # of Mitsuba, in their own frame
    "Cylinder": np.concatenate([_RING, _RING + np.array([0.0, 0.0, 1.0])]),
    "Disk": _RING,
    "Sphere": np.concatenate([np.roll(_RING, axis, axis=1) for axis in range(3)]),
}


def draws(*classes: str) -> Callable[[Draw], Draw]:
    """Have a function draw objects of these classes, such as "metrology.centres.LineCentres"."""

    def register(draw: Draw) -> Draw:
        _DRAWINGS.update(dict.fromkeys(classes, draw))
        return draw

    return register


def drawn_classes() -> list[str]:
    """Names of the classes that have a picture."""
    return list(_DRAWINGS)


def drawing_of(thing: object) -> Draw | None:
    """What draws an object, if there is something to see."""
    return next((_DRAWINGS[name] for name in names_of(thing) if name in _DRAWINGS), None)


def plot(thing: object, axes: Axes | None = None) -> Axes:
    """Draw an object; see `Displayed.plot`."""
    draw = drawing_of(thing)
    kind = type(thing).__name__
    if draw is None:
        raise InputError(f"plot: {a(kind)} has no picture; to_dataframe() gives its numbers")
    if axes is None:
        from matplotlib import pyplot

        # The first figure starts the user's backend, which sets what our style would take back.
        figure = pyplot.figure(layout="constrained")
        with style():
            axes = figure.add_subplot()
            draw(axes, thing)
        if axes.get_aspect() != "auto" and axes.get_adjustable() == "box":  # no blank beside it
            (left, right), (low, high) = sorted(axes.get_xlim()), sorted(axes.get_ylim())
            wide, tall = figure.get_size_inches()
            width = _BESIDE_IN + (tall - 1.0) * (right - left) / (high - low)
            figure.set_size_inches(float(np.clip(width, 0.5 * wide, wide)), tall)
        return axes
    if not isinstance(axes, Axes):
        given = type(axes).__name__
        raise InputError(f"plot: ax is {a(given)}; give an Axes of matplotlib, or none")
    draw(axes, thing)
    return axes


def write_picture(path: Path, thing: object) -> None:
    """Write an object's picture as PNG, SVG or PDF, by the suffix."""
    draw = drawing_of(thing)
    assert draw, "it has a picture"
    with style(), written_whole(path) as temporary:
        figure = Figure(figsize=(6.4, 4.4), dpi=150, layout="constrained")
        draw(figure.add_subplot(), thing)
        figure.savefig(temporary, format=path.suffix.lower().lstrip("."), bbox_inches="tight")


# ------------------------------------------------------------------------------ lines and dots


@draws("metrology.centres.LineCentres")
def _line_centres(axes: Axes, line: LineCentres) -> None:
    """The centres and ghosts as the camera sees them; below, which of them are not ok."""
    _dots(axes, line.pixel, color=colour("line"), label="found")
    ghost = line.status == line._statuses["status"].GHOST
    _dots(axes, np.stack([line.column[ghost], line.row[ghost]], axis=-1), color=colour("ghost"))
    by_row = line.normal_deg.size and np.all(line.normal_deg == 0.0)
    places = line.row if by_row else line.column
    height = 0.0
    for status, count in line._statuses["status"].counts(line.status).items():
        if status:
            height += 0.035
            at = np.asarray(places)[line.status == status]
            name, edge = status.name.lower(), np.full(at.size, height)
            where, xy = axes.get_xaxis_transform(), (at, edge)
            if by_row:
                where, xy = axes.get_yaxis_transform(), (edge, at)
            look = {"marker": "_" if by_row else "|", "ls": "", "ms": 3.0, "color": colour(name)}
            axes.plot(*xy, transform=where, label=f"{name}: {count}", **look)
    _as_image(axes)
    if height:
        axes.legend(markerscale=2.0, fontsize="small")


@draws("metrology.observations.Observation")
def _observation(axes: Axes, seen: Any) -> None:
    _dots(axes, seen.pixel, color=colour("line"))
    _as_image(axes)


@draws("metrology.dot_peaks.DotCentres")
def _dot_centres(axes: Axes, dots: DotCentres) -> None:
    """The dots, their areas as their flux."""
    flux = np.nan_to_num(dots.flux)
    size = 20.0 + 80.0 * flux / flux.max(initial=1e-300)
    axes.scatter(*dots.pixel.T, s=size, color=colour("line"))
    _as_image(axes)


@draws("metrology.truth.TrueLine")
def _true_line(axes: Axes, line: TrueLine) -> None:
    for number, row in enumerate(line.row):
        axes.plot(row, color=CYCLE[number % len(CYCLE)])
    _as_image(axes)


@draws(
    "optics.ray_search.FoundPixels",
    "optics.projection.ProjectedPoints",
    "optics.pupil_search.PupilPixels",
    "studies.search.SearchTable",
)
def _pixels(axes: Axes, found: Any) -> None:
    _dots(axes, found.pixel, ms=5.0, color=BLUE)
    _as_image(axes)


@draws("metrology.truth.LineErrors")
def _line_errors(axes: Axes, errors: LineErrors) -> None:
    """Found minus true, and the sigma that was predicted."""
    axes.axhline(0.0, color=GREY, lw=0.8)
    axes.plot(errors.column, errors.error_px, ".", ms=2.5, color=VERMILION, label="error")
    if np.isfinite(errors.sigma).any():
        order = np.argsort(errors.column)
        u, sigma = errors.column[order], errors.sigma[order]
        axes.plot(
            u, np.stack([sigma, -sigma], 1), color=BLUE, lw=0.8, label=["predicted sigma", ""]
        )
        axes.legend()
    axes.set(xlabel=_U, ylabel="found minus true in px")


@draws("metrology.truth.DotErrors")
def _dot_errors(axes: Axes, errors: DotErrors) -> None:
    axes.axhline(0.0, color=GREY, lw=0.8)
    for axis, marker, error in zip("uv", "os", errors.error_px.T, strict=True):
        axes.plot(errors.true_pixel[:, 0], error, marker, color=colour(axis), label=axis)
    axes.legend()
    axes.set(xlabel=_U, ylabel="found minus true in px")


# -------------------------------------------------------------------------------------- images


@draws("imaging.render.Frame")
def _frame(axes: Axes, frame: Frame) -> None:
    """The part of the frame that is lit; light that was reflected in between in colour."""
    window = _lit(frame)
    _image(axes, frame.radiance, window)
    if frame.indirect is None or frame.direct is None or window is None:
        return
    indirect = frame.indirect.sum(axis=0)[window]
    share = indirect / np.maximum(indirect + frame.direct[window], _TINY)
    brightness = indirect / max(float(frame.radiance.max()), _TINY)
    opacity, _ = coarser(share * brightness**_DIM, _MOST_PX)
    tint = np.zeros((*opacity.shape, 4))
    tint[..., :3], tint[..., 3] = to_rgb(VERMILION), np.clip(opacity, 0.0, 1.0)
    (picture,) = axes.images
    axes.imshow(tint, extent=picture.get_extent(), aspect="auto", interpolation="nearest")
    bounces = len(frame.indirect)
    words = f"by {bounces} reflection{'s' * (bounces > 1)} or fewer in between"
    axes.legend(handles=[Patch(color=VERMILION, label=words)], labelcolor="linecolor")


def _lit(frame: Any) -> tuple[slice, slice] | None:
    """Rows and columns of a frame that hold what is lit, and ghosts; None where nothing is."""
    index = frame.truth.index.astype(int)
    if getattr(frame, "indirect", None) is not None:
        bright = frame.indirect.sum(axis=0) >= _GHOST * frame.radiance.max(initial=0.0)
        index = np.union1d(index, np.flatnonzero(bright & (frame.indirect.sum(axis=0) > 0.0)))
    at = np.divmod(index, frame.radiance.shape[1])
    rows, columns = (
        slice(max(i.min(initial=2**31) - _MARGIN_PX, 0), i.max(initial=-1) + 1 + _MARGIN_PX)
        for i in at
    )
    return (rows, columns) if index.size else None


@draws("imaging.recording.RecordedFrame")
def _recorded_frame(axes: Axes, shot: RecordedFrame) -> None:
    """Grey values where the part is lit, what is clipped in colour; of a sequence, all frames."""
    if shot.grey.ndim == 3:
        draw_frames(axes, shot.grey, [f"{number}" for number in range(len(shot.grey))], None)
        return
    window = _lit(shot.ideal) if hasattr(shot.ideal, "truth") else None
    _image(axes, shot.grey, window)
    limits = axes.axis()
    if shot.saturated.any():
        clipped = np.argwhere(shot.saturated)[:, ::-1]
        _dots(axes, clipped, color=colour("saturated"), label="saturated")
        axes.legend(markerscale=3.0, labelcolor="linecolor")
    axes.axis(limits)


@draws(
    "imaging.image_files.Image",
    "imaging.image_formats.StoredImage",
    "studies.trial.images.TrialImage",
)
def _whole_image(axes: Axes, image: Any) -> None:
    names = ("pixels", "values", "grey")
    _image(axes, next(getattr(image, name) for name in names if hasattr(image, name)))


@draws("studies.detect.Detected")
def _detected(axes: Axes, found: Any) -> None:
    _image(axes, found.image)
    _dots(axes, found.line.pixel, color=colour("line"))


def _image(axes: Axes, image: NDArray[Any], window: tuple[slice, slice] | None = None) -> None:
    """An image, or the rows and columns of a window, in brightness as the eye sees it."""
    axes.set(xlabel=_U, ylabel=_V)
    if not image.size:
        return
    rows, columns = window or (slice(0, None), slice(0, None))
    shown, (high, wide) = coarser(image[rows, columns], _MOST_PX)
    left, top = columns.start - 0.5, rows.start - 0.5
    extent = (left, left + wide * shown.shape[1], top + high * shown.shape[0], top)
    finite = shown[np.isfinite(shown)]
    low, most = (finite.min(), finite.max()) if finite.size else (0.0, 1.0)
    norm = PowerNorm(0.5, low, most if most > low else low + 1.0)
    axes.imshow(shown, "gray", norm, extent=extent, aspect="auto", interpolation="nearest")
    axes.grid(visible=False)


# ------------------------------------------------------------------------------------- fringes


@draws("devices.patterns.Pattern")
def _pattern(axes: Axes, pattern: Pattern) -> None:
    """What a projector of usual size shows, or the picture as it is."""
    values = getattr(pattern, "values", None)
    _whole(axes, pattern.image(_USUAL_PX) if values is None else values)


@draws("imaging.sequence.PatternFrames")
def _pattern_frames(axes: Axes, frames: PatternFrames) -> None:
    """All frames, small."""
    names = [_DECIMALS.sub(r"\1", drawable(each.text)) for each in frames.patterns]
    draw_frames(axes, frames.radiance, names, window_of(frames.projector_pixel[..., 0]))


@draws("metrology.fringes.decoded.DecodedFringes")
def _decoded(axes: Axes, decoded: DecodedFringes) -> None:
    """The column of the projector, or its row where there is none."""
    known = (("column", decoded.column), ("row", decoded.row))
    name, values = next((n, v) for n, v in known if v is not None)
    draw_map(axes, values, f"projector's {name} in px")


@draws("metrology.range_image.RangeImage")
def _range_image(axes: Axes, image: RangeImage) -> None:
    draw_map(axes, image.depth_mm, "camera's depth in mm")


@draws("studies.fringes.result.Surface")
def _surface(axes: Axes, surface: Any) -> None:
    """How far it is from the true one."""
    draw_map(axes, surface.deviation_um, "outside (+) or inside (−) the part in µm", "signed")


@draws("studies.fringes.result.FringeState")
def _fringe_state(axes: Axes, state: Any) -> None:
    _surface(axes, state.surfaces.get("bent", state.straight))


@draws("studies.fringes.result.FringeMeasurement")
def _fringe_measurement(axes: Axes, result: Any) -> None:
    """The surface as it is measured if light is taken for straight."""
    _surface(axes, (result.hot or result.cold).straight)


@draws("studies.fringes.result.SearchedGrid")
def _searched_grid(axes: Axes, grid: Any) -> None:
    """Decoded minus searched projector pixels."""
    axes.axhline(0.0, color=GREY, lw=0.8)
    for axis, marker, error in zip("uv", "os", grid.difference_px.T, strict=True):
        if np.isfinite(error).any():
            axes.plot(grid.pixel[:, 0], error, marker, ms=2.0, color=colour(axis), label=axis)
    axes.set(xlabel=_U, ylabel="decoded minus searched in projector px")
    if axes.lines[1:]:
        axes.legend(markerscale=2.0)


def _whole(axes: Axes, image: NDArray[Any]) -> None:
    """An image of a projector, black to white."""
    height, width = image.shape
    extent = (-0.5, width - 0.5, height - 0.5, -0.5)
    axes.imshow(image, "gray", vmin=0.0, vmax=1.0, extent=extent, interpolation="antialiased")
    axes.grid(visible=False)
    axes.set(xlabel="projector's u in px", ylabel="projector's v in px")


# ------------------------------------------------------------------------------------ in space


@draws(
    "metrology.triangulation.TriangulatedPoints",
    "optics.bent_points.BentPoints",
    "optics.crossings.Crossings",
    "optics.ray_maps.RayPoints",
    "imaging.render.PixelTruth",
)
def _points(axes: Axes, found: Any) -> None:
    """Points from the side from which most is seen of them."""
    points = np.asarray(found.point_mm, float).reshape(-1, 3)
    points = points[np.isfinite(points).all(axis=1)][:: max(1, len(points) // _MOST_DOTS)]
    across, up = side_of(points)
    axes.plot(points[:, across], points[:, up], ".", ms=2.5, color=BLUE)
    from_side(axes, across, up)


@draws("imaging.checks.LitLine")
def _lit_line(axes: Axes, line: Any) -> None:
    across, up = side_of(line.points_mm)
    axes.plot(*line.points_mm[:, [across, up]].T, color=colour("laser"))
    from_side(axes, across, up)


@draws("optics.trace.Rays")
def _rays(axes: Axes, rays: Rays) -> None:
    """Where rays ended, and the straight paths there in the direction in which they ended."""
    known = np.isfinite(rays.position).all(axis=1)
    step = max(1, int(known.sum()) // 500)
    end, direction = rays.position[known][::step], rays.direction[known][::step]
    path = rays.optical_path_mm[known][::step, None]  # as long as they are, but for 3e-4
    start = end - np.where(path > 0.0, path, 1.0) * direction
    across, up = side_of(np.concatenate([start, end]))
    both = np.stack([start, end])[..., [across, up]]
    axes.plot(both[..., 0], both[..., 1], color=BLUE, lw=0.8)
    axes.plot(*both[1].T, ".", ms=5.0, color=VERMILION)
    from_side(axes, across, up)


@draws("imaging.parts.Part")
def _part(axes: Axes, part: Any) -> None:
    _shaded(axes, part.vertices, part.faces)


@draws("imaging.part_survey.Mesh")
def _mesh(axes: Axes, mesh: Any) -> None:
    _shaded(axes, mesh.places_mm, mesh.faces)


@draws("imaging.scene.Scene")
def _scene(axes: Axes, scene: Any) -> None:
    """The part in its air, the cameras and the sources, from the side."""
    families = {name: source.family for name, source in scene.sources.items()}
    outlines = [_outline(shape) for shape in scene.mitsuba.shapes()]
    _devices(axes, scene.cameras, families, scene.sources, outlines, scene.medium)


@draws("devices.sensor.SensorModel")
def _sensor(axes: Axes, sensor: Any) -> None:
    laser = sensor.laser
    _devices(axes, {"camera": sensor.camera}, {"laser": laser.family}, {"laser": laser})


@draws("optics.ray_families.Pinhole")
def _camera(axes: Axes, camera: Pinhole) -> None:
    _devices(axes, {"camera": camera})


@draws("devices.laser.LaserLine")
def _laser(axes: Axes, laser: Any) -> None:
    _devices(axes, {}, {"laser": laser.family}, {"laser": laser})


@draws("devices.projector.Projector")
def _projector(axes: Axes, projector: Projector) -> None:
    _devices(axes, {}, {"projector": projector.family}, {"projector": projector})


@draws("metrology.fringes.calibration.FringeCalibration")
def _fringe_calibration(axes: Axes, calibration: Any) -> None:
    """Camera and projector, where their axes are nearest to each other."""
    from virtual_sensor.metrology.fringes.calibration import meeting_mm

    both = {"camera": calibration.camera, "projector": calibration.projector}
    middle = meeting_mm(*both.values())
    _devices(axes, both, towards=middle if np.isfinite(middle).all() else None)


@draws("optics.ray_families.Sheet")
def _sheet(axes: Axes, sheet: RayFamily) -> None:
    _devices(axes, {}, {"sheet": sheet})


@draws("metrology.calibration.Calibration")
def _calibration(axes: Axes, calibration: Any) -> None:
    """The camera, and its laser plane where the plane is seen edge-on."""
    camera, (normal, offset) = calibration.camera, calibration.laser.plane
    target = normal * offset
    across, up = _devices(axes, {"camera": camera}, towards=target)
    along = np.array([-normal[up], normal[across]])
    if (length := np.linalg.norm(along)) > _EDGE_ON:
        reach = 0.5 * np.linalg.norm(camera.pose.origin_mm - target)
        ends = target[[across, up]] + np.array([[-1.0], [1.0]]) * along / length * reach
        axes.plot(*ends.T, color=colour("laser"), label="laser plane")
        write_beside(axes, "laser plane", tuple(ends[np.argmax(ends[:, 1])]), (-7.0, -3.0))


@draws("poses.Pose")
def _pose(axes: Axes, pose: Pose) -> None:
    """Its axes in the world."""
    origin = np.asarray(pose.origin_mm, float)
    size = 0.3 * float(np.linalg.norm(origin)) or 1.0
    ends = origin + size * np.asarray(pose.rotation, float).T
    across, up = side_of(np.stack([np.zeros(3), *ends, origin]))
    axes.plot(0.0, 0.0, "+", color=GREY, ms=9.0)
    write_beside(axes, "world's origin", (0.0, 0.0), (6.0, 6.0), color=GREY)
    for axis, end in zip("xyz", ends, strict=True):
        line = np.stack([origin, end])[:, [across, up]]
        axes.plot(*line.T, color=colour(axis), lw=2.0)
        if np.ptp(line, axis=0).max() > 0.02 * size:
            write_beside(axes, axis, tuple(line[1]), (5.0, 5.0), color=colour(axis))
    from_side(axes, across, up)


def _devices(
    axes: Axes,
    cameras: Mapping[str, Pinhole],
    families: Mapping[str, RayFamily] | None = None,
    sources: Mapping[str, Any] | None = None,
    outlines: Sequence[Sequence[Array] | Array] = (),
    medium: Any = None,
    towards: Array | None = None,
) -> tuple[int, int]:
    """Cameras and sources with their light, about a part, from the side; gives the two axes."""
    lights = {}
    for name, family in (families or {}).items():
        source = (sources or {}).get(name)
        low, high = source.extent if source else (np.array([0.0, -5.0]), np.array([0.0, 5.0]))
        starts, directions = family.rays(*np.array(list(product(*np.stack([low, high], 1)))).T)
        reach = _reach(family.pose, towards)
        lights[name] = starts, starts + reach * directions
    targets = [ends.mean(axis=0) for _, ends in lights.values()]
    target = np.mean(targets, axis=0) if targets else towards
    sights, sharp = {}, []
    for name, camera in cameras.items():
        width, height = camera.size
        corners = np.array([[0, 0], [width, 0], [width, height], [0, height]]) - 0.5
        lens = getattr(camera, "lens", None)
        if lens and lens.pupil_radius_mm:
            sharp.append(_in_focus(camera, lens, corners))
        reach = _reach(camera.pose, target)
        lines = camera.lines_of_sight(corners)
        sights[name] = camera.pose.origin_mm, camera.pose.origin_mm + reach * np.nan_to_num(lines)
    seen = [
        *(np.concatenate(each) for each in lights.values()),
        *(np.stack([o, *far]) for o, far in sights.values()),
    ]
    across, up = side_of(np.concatenate(seen))
    flat = [across, up]
    if medium is not None:
        corners = medium.to_world(np.array(list(product(*np.asarray(medium.box).T))))
        _hull(axes, corners[:, flat], facecolor="none", edgecolor=GREY, ls=":", lw=1.0)
        top = corners[corners[:, up] == corners[:, up].max()]
        write_beside(axes, "air", tuple(top[:, flat].min(axis=0)), (4.0, -8.0), color=GREY)
    for outline in outlines:
        if len(outline) > _MOST_TRIANGLES:
            shadow = _silhouette(np.asarray(outline)[..., flat])
            axes.add_patch(PathPatch(shadow, color=GREY, lw=0.4))
            continue
        polygons = [_hull_of(each[:, flat]) for each in outline]
        axes.add_collection(PolyCollection(polygons, facecolor=GREY, edgecolor=GREY, lw=0.4))
    for name, (starts, ends) in lights.items():
        paint = colour("laser")
        outline = np.concatenate([starts, ends])[:, flat]
        _hull(axes, outline, facecolor=(paint, 0.3), edgecolor=paint)
        _name(axes, name, starts.mean(axis=0)[flat], paint, "s")
    for name, (origin, far) in sights.items():
        _hull(axes, np.stack([origin, *far])[:, flat], facecolor=(colour("camera"), 0.3))
        _name(axes, name, origin[flat], colour("camera"), "o")
    for points in sharp:
        _hull(axes, points[:, flat], facecolor="none", edgecolor=BLUE, lw=2.0, label="in focus")
        left = points[np.argmin(points[:, across])]
        write_beside(axes, "in focus", tuple(left[flat]), (-6.0, 2.0), color=BLUE)
    axes.autoscale_view()
    from_side(axes, across, up)
    axes.margins(0.12)
    return across, up


def _in_focus(camera: Pinhole, lens: Lens, pixels: Array) -> Array:
    """What a lens sees sharply in pixels (N, 2): points (N, 3), world, mm."""
    p, q = camera.of_pixels(pixels)
    nearness = np.maximum(lens.in_focus(p, q), _LEAST_NEARNESS / lens.focus_distance_mm)
    points: Array = camera.pose.to_world(np.stack([p, q, np.ones_like(p)], 1) / nearness[:, None])
    return points[np.isfinite(points).all(axis=1)]


def _reach(pose: Pose, target: Array | None) -> float:
    """How far a device's light is drawn: to a target, or to the point nearest to the origin."""
    forward = np.asarray(pose.rotation, float)[:, 2]
    origin = np.asarray(pose.origin_mm, float)
    depth = float(((np.zeros(3) if target is None else target) - origin) @ forward)
    return depth if depth > 0.0 else float(np.linalg.norm(origin)) or 100.0


def _name(axes: Axes, name: str, at: Array, paint: str, marker: str) -> None:
    axes.plot(*at, marker, color=paint, ms=7.0)
    write_beside(axes, drawable(name), tuple(at), (0.0, 10.0))


def _silhouette(triangles: Array) -> Outline:
    """The outline of triangles (N, 3, 2), holes and all, within a three hundredth of its size.

    They are painted on pixels, where most of a fine mesh are as one another.
    """
    low = triangles.min(axis=(0, 1))
    pixel = max(float(np.ptp(triangles, axis=(0, 1)).max()) / _SILHOUETTE_PX, 1e-9)
    places = np.rint((triangles - low) / pixel).astype(np.int64)
    corners = np.sort(places[..., 0] * (_SILHOUETTE_PX + 1) + places[..., 1], axis=1)
    base = (_SILHOUETTE_PX + 1) ** 2
    once = np.unique(corners @ [base**2, base, 1], return_index=True)[1]
    mask = np.zeros((_SILHOUETTE_PX + 1,) * 2, np.uint8)
    for triangle in places[once].astype(np.int32):
        cv2.fillConvexPoly(mask, triangle, 1)
    found, _ = cv2.findContours(mask, cv2.RETR_CCOMP, cv2.CHAIN_APPROX_SIMPLE)
    closed = [np.append(each, each[:1], axis=0)[:, 0] * pixel + low for each in found]
    return Outline.make_compound_path(*(Outline(each, closed=True) for each in closed))


def _outline(shape: Any) -> Sequence[Array] | Array:
    """Convex pieces (N, 3) of a shape of Mitsuba's, world, mm: its triangles, or one hull."""
    from virtual_sensor.engine import mi

    held = mi.traverse(shape)
    if shape.is_mesh():
        vertices = np.array(held["vertex_positions"], float).reshape(-1, 3)
        faces = np.array(held["faces"]).reshape(-1, 3)
        found: Array = vertices[faces]
        return found
    box = shape.bbox()
    low, high = np.array(box.min, float), np.array(box.max, float)
    if (local := _ROUND_SHAPES.get(shape.class_name())) is None:
        return [np.array(list(product(*zip(low, high, strict=True))))]
    if "to_world" not in held:
        return [0.5 * (low + high + (high - low) * local)]
    matrix = np.array(held["to_world"].matrix, float).reshape(-1)[:16].reshape(4, 4)
    return [local @ matrix[:3, :3].T + matrix[:3, 3]]


def _shaded(axes: Axes, vertices: NDArray[Any], faces: NDArray[Any]) -> None:
    """Triangles as they are seen obliquely from above, lit from the left."""
    turn = np.radians(-35.0)
    forward = np.array([np.sin(turn) * 0.8, np.cos(turn) * 0.8, -0.6])
    right = np.array([np.cos(turn), -np.sin(turn), 0.0])
    view = np.stack([right, np.cross(right, forward), forward])
    vertices, faces = _finer(
        np.asarray(vertices, float), faces[:: -(-len(faces) // _MOST_TRIANGLES)]
    )
    corner = (vertices @ view.T)[faces]
    # The view is left-handed: right, up, away.
    normal = np.cross(corner[:, 2] - corner[:, 0], corner[:, 1] - corner[:, 0])
    length = np.linalg.norm(normal, axis=1, keepdims=True)
    normal = normal / np.where(length > 0.0, length, 1.0)
    front = normal[:, 2] <= 0.0
    light = 0.35 + 0.6 * np.clip(normal @ [-0.4, 0.6, -0.7], 0.0, 1.0)
    order = np.argsort(-corner[..., 2].mean(axis=1))
    order = order[front[order]] if front.any() else order
    shade = np.repeat(light[order, None], 3, axis=1)
    axes.add_collection(
        PolyCollection(corner[order][..., :2], facecolors=shade, edgecolors=shade, lw=0.3)
    )
    axes.autoscale_view()
    axes.set_aspect("equal")
    axes.set_axis_off()


def _finer(vertices: Array, faces: NDArray[Any]) -> tuple[Array, NDArray[Any]]:
    """Triangles cut into smaller ones, which can be drawn one in front of the other."""
    from trimesh.remesh import subdivide_to_size

    corner = vertices[faces]
    longest = np.linalg.norm(corner - np.roll(corner, 1, axis=1), axis=2).max(axis=1)
    size = np.linalg.norm(np.ptp(vertices, axis=0))
    edge = max(size / 80.0, float(np.sqrt(np.sum(longest**2) / _MOST_TRIANGLES)))
    finer: tuple[Array, NDArray[Any]] = subdivide_to_size(vertices, faces, edge, max_iter=20)
    return finer


def _hull_of(points: Array) -> Array:
    """Corners (M, 2) of the convex hull of points in a plane."""
    if len(points) <= 3:
        return points
    hull: Array = cv2.convexHull(points.astype(np.float32)).reshape(-1, 2).astype(float)
    return hull


def _hull(axes: Axes, points: Array, **style: Any) -> None:
    axes.fill(*_hull_of(points).T, **style)


@draws("optics.lens.Lens")
def _lens(axes: Axes, lens: Lens) -> None:
    """From the side: the pupil, the sensor behind it, what is in focus before it, and its light.

    The side is the one in which the sensor is tilted the most.
    """
    b, g, r = lens.image_distance_mm, lens.focus_distance_mm, lens.pupil_radius_mm
    lean = lens.lean[np.argmax(np.abs(lens.lean))]
    p = _HALF_FIELD * np.array([-1.0, 0.0, 1.0])
    nearness = np.maximum(1.0 / g - lean * p, _LEAST_NEARNESS / g)  # 1/z of what is in focus
    sharp = np.stack([p, np.ones(3)]) / nearness
    sensor = -np.stack([p, np.ones(3)]) * b / (1.0 + b * lean * p)
    for rim in (-r, 0.0, r):
        through = np.array([np.full(3, rim), np.zeros(3)])
        light = np.stack([sharp, through, sensor])
        axes.plot(light[:, 1], light[:, 0], color=VERMILION, lw=0.7, alpha=0.8)
    for (height, along), words in ((sharp, "in focus"), (sensor, "sensor")):
        axes.plot(along, height, color=BLUE, lw=2.0)
        top = int(np.argmax(height))
        write_beside(axes, words, (along[top], height[top]), (0.0, 8.0), ha="center", color=BLUE)
    half = max(r, _HALF_FIELD * 0.1 * g)
    axes.annotate("", (0.0, -half), (0.0, half), arrowprops={"arrowstyle": "<->", "lw": 1.5})
    axes.axhline(0.0, color=GREY, lw=0.8, ls="-.")
    axes.margins(y=0.15)
    axes.set(xlabel="along the axis in mm", ylabel="from the axis in mm, enlarged")


# -------------------------------------------------------------------------------------- fields


@draws("medium.index_field.IndexField")
def _field(axes: Axes, field: IndexField) -> None:
    """The section of the field across its x."""
    node = 0 if field.mirror[0] else field.shape[0] // 2
    section, ends = field.nodes[node], []
    for axis in (0, 1):
        low, high = field.box[:, axis + 1]
        ends += [low, high]
        if field.mirror[axis + 1]:
            back = np.flip(section, axis).take(range(section.shape[axis] - 1), axis)
            section = np.concatenate([back, section], axis)
    step = [-(-size // _MOST_PX) for size in section.shape]
    drawn = axes.imshow(
        1e5 * section[:: step[0], :: step[1]].T, origin="lower", extent=ends, cmap="inferno_r"
    )
    axes.grid(visible=False)
    bar = axes.figure.colorbar(drawn, ax=axes, shrink=0.9)
    bar.set_label("10⁵ (n − 1)")
    place = field.origin[0] + node * field.spacing[0]
    own = "the field's " if field.pose else ""
    if 2.0 * (ends[1] - ends[0]) < ends[3] - ends[2]:
        axes.set_xticks(ends[:2])  # there is room for no more
    axes.set(xlabel=f"{own}y in mm, at x = {place:.4g} mm", ylabel=f"{own}z in mm")


@draws("medium.field_family.FieldFamily")
def _family(axes: Axes, family: Any) -> None:
    _field(axes, family.fields[max(family.fields)])


@draws("medium.air_model.AirModel")
def _air_model(axes: Axes, model: Any) -> None:
    _field(axes, model.at())


@draws("studies.field_info.FieldInfo")
def _field_info(axes: Axes, info: Any) -> None:
    _field(axes, info.field)


# ----------------------------------------------------------------------------------- quantities


@draws("devices.image_sensor.ImageSensor")
def _image_sensor(axes: Axes, sensor: ImageSensor) -> None:
    """Noise over signal, and what it is made of: EMVA 1288's photon transfer.

    Of a sensor with a knee, both are those of the light: beyond it less of them is read.
    """
    signal = np.geomspace(1.0, sensor.light_e(sensor.full_well_e), 200)
    read = np.where(signal > sensor.knee_e, sensor.beyond_knee, 1.0)  # per electron of light
    parts = {
        "dark": sensor.dark_noise_e / read,
        "shot": np.sqrt(signal / read),
        "PRNU": sensor.prnu * signal,
        "DSNU": sensor.dsnu_e / read,
        "rounding": 1.0 / np.sqrt(12.0) / sensor.gain / read,
    }
    whole = np.sqrt(sum(part**2 for part in parts.values()))
    axes.loglog(signal, whole, color=BLUE, lw=2.0, label="in all")
    for number, (name, part) in enumerate(parts.items()):
        if part.max() > 0.0:
            axes.loglog(signal, part, "--", lw=1.0, color=CYCLE[1 + number], label=name)
    axes.set(xlabel="signal in electrons", ylabel="noise in electrons")
    axes.set_ylim(bottom=max(float(whole.min()) / 20.0, 1e-6))
    axes.legend(fontsize="small")


@draws("metrology.cylinder_fit.CylinderFit")
def _cylinder_fit(axes: Axes, fit: CylinderFit) -> None:
    axes.axhline(0.0, color=GREY, lw=0.8)
    axes.plot(fit.residual_um, ".", ms=2.5, color=BLUE)
    axes.set(xlabel="point", ylabel="distance from the cylinder in µm")


@draws("metrology.deviation.Deviation", "metrology.deviation.PathDisplacement")
def _differences(axes: Axes, found: Any) -> None:
    """The length of each difference, ray by ray; of those in space, if there are any."""
    held = {name: values for name, values in vars(found).items() if name.endswith("_um")} or vars(
        found
    )
    for number, (name, values) in enumerate(held.items()):
        words = name.rpartition("_")[0].replace("_", " ")
        length = np.linalg.norm(values, axis=1)
        axes.plot(length, "o-", ms=3.5, color=CYCLE[number], label=words)
    unit = unit_of(next(iter(held)))
    axes.set(xlabel="ray", ylabel=f"length in {unit}")
    axes.legend(fontsize="small")


@draws("optics.sensitivity.Sensitivity")
def _sensitivity(axes: Axes, found: Sensitivity) -> None:
    """By how much pixels move with the parameters that move them most."""
    sizes = {name: np.linalg.norm(by, axis=1) for name, by in found.of_pixel.items()}
    largest = {n: np.nanmax(s) for n, s in sizes.items() if np.isfinite(s).any()}
    for number, name in enumerate(sorted(largest, key=lambda name: -largest[name])[:6]):
        axes.semilogy(found.laser_y_mm, sizes[name], ".-", color=CYCLE[number], label=name)
    axes.set(xlabel=ALONG, ylabel="px per unit")
    if largest:
        axes.legend(fontsize="small")


@draws("records.Table")
def _table(axes: Axes, table: Table) -> None:
    """The first column of measured numbers over the first of numbers; of a vector, all of it."""
    columns = {n: c for n, c in table.columns().items() if np.asarray(c).dtype.kind in "uif"}
    (first, x), *others = columns.items()
    measured = [name for name, y in others if np.asarray(y).dtype.kind == "f"]
    if not measured:
        raise InputError(f"plot: {a(type(table).__name__)} has no column of measured numbers")
    stem, _, axis = measured[0].rpartition("_")
    vector = [f"{stem}_{each}" for each in ("xyz" if axis in "xyz" else "uv")]
    names = [name for name in vector if name in columns] if axis in [*"xyzuv"] else measured[:1]
    marks = ".-" if np.all(np.diff(x) > 0) else "."
    for number, name in enumerate(names):
        axes.plot(x, columns[name], marks, ms=3.0, color=CYCLE[number], label=name)
    axes.set(xlabel=first, ylabel=stem if len(names) > 1 else names[0])
    if len(names) > 1:
        axes.legend(fontsize="small")


# ------------------------------------------------------------------------------------- studies


@draws("metrology.air_estimate.AirEstimate", "metrology.identifiability.Identifiability")
def _estimate(axes: Axes, found: Any) -> None:
    """Which of the parameters look alike."""
    from virtual_sensor.reporting.correct import draw_correlation

    draw_correlation(axes, found)
    axes.set_title("correlations of what is estimated")


@draws("metrology.error_budget.PointBudget")
def _budget(axes: Axes, budget: Any) -> None:
    """What makes each point uncertain."""
    from virtual_sensor.reporting.correct import draw_budget

    draw_budget(axes, budget, np.arange(float(len(budget.point_mm))))
    axes.set_xlabel("point")
    axes.legend(fontsize="small")


@draws("studies.correct.correction.Correction")
def _correction(axes: Axes, result: Any) -> None:
    """How far the points are from the part, before and after."""
    from virtual_sensor.reporting.correct import draw_distances

    draw_distances(axes, result.measurements)
    if axes.get_legend_handles_labels()[0]:  # of few measurements
        axes.legend(fontsize="small")


@draws("studies.correct.correction.Corrected")
def _corrected(axes: Axes, each: Any) -> None:
    from virtual_sensor.reporting.correct import draw_distances

    draw_distances(axes, [each])
    axes.legend(fontsize="small")


@draws("studies.measure.Measurement")
def _measurement(axes: Axes, result: Any) -> None:
    """How far the measured section is from the true one."""
    axes.axhline(0.0, color=GREY, lw=0.8)
    for name, state in result.states.items():
        along = state.section.along_mm(state.points_mm)
        axes.plot(along, state.section_error_um, ".", ms=2.5, color=colour(name), label=name)
    axes.set(xlabel=ALONG, ylabel="measured minus true in µm")
    axes.legend(markerscale=3.0)


@draws("studies.measure.State")
def _state(axes: Axes, state: Any) -> None:
    _frame(axes, state.frame)
    limits = axes.axis()
    _dots(axes, state.centres_px, color=colour("line"))
    axes.axis(limits)


@draws("studies.section.Section")
def _section(axes: Axes, section: Any) -> None:
    points = np.array(section.point_mm, float)
    steps = np.flatnonzero(~section.joined[: len(points) - 1]) + 1
    axes.plot(*np.insert(points, steps, np.nan, axis=0).T, color=BLUE)
    axes.set(xlabel=ALONG, ylabel="away from the laser in mm")
    axes.invert_yaxis()


@draws("studies.search.Search")
def _search(axes: Axes, found: Any) -> None:
    _pixels(axes, found.rays)


@draws("studies.burst.Burst")
def _burst(axes: Axes, burst: Any) -> None:
    from virtual_sensor.reporting.burst import draw_over_time

    draw_over_time(axes, burst)


@draws("studies.sweep_table.Sweep")
def _sweep(axes: Axes, sweep: Any) -> None:
    from virtual_sensor.reporting.sweep import panels_of

    panel = panels_of(sweep)[0]
    panel.draw(axes)
    axes.set_title(panel.title)


@draws("studies.chart.chart.Chart")
def _chart(axes: Axes, chart: Any) -> None:
    from virtual_sensor.reporting.chart import draw_errors

    panel = chart.panels[0]
    draw_errors(axes, chart.of(panel))
    axes.set_title(panel)


@draws("studies.trial.trial.Trial")
def _trial(axes: Axes, trial: Any) -> None:
    """Error over time of the detectors, on the image that they are to be chosen for."""
    for number, name in enumerate(trial.detectors):
        scores = [each for each in trial.scores if each.detector == name]
        x, y = ([getattr(each, field) for each in scores] for field in ("time_us", "rms_px"))
        axes.loglog(x, y, "o", color=CYCLE[number % len(CYCLE)], label=name)
    axes.set(xlabel="time a column in µs", ylabel="rms error in px")
    axes.legend(fontsize="small")


# --------------------------------------------------------------------------------------- parts


def _dots(axes: Axes, pixel: NDArray[Any], **style: Any) -> None:
    """Pixels (..., 2) as dots, those that there are."""
    flat = np.asarray(pixel, float).reshape(-1, 2)
    flat = flat[np.isfinite(flat).all(axis=1)]
    flat = flat[:: max(1, len(flat) // _MOST_DOTS)]
    axes.plot(*flat.T, ".", **{"ms": 2.5, **style})


def _as_image(axes: Axes) -> None:
    """Axes of an image: v downwards."""
    axes.set(xlabel=_U, ylabel=_V)
    if not axes.yaxis_inverted():
        axes.invert_yaxis()
