"""Frames: what a camera records, with the ground truth of every pixel that a source lights."""

from __future__ import annotations

import weakref
from collections.abc import Callable, Mapping
from dataclasses import dataclass, replace
from functools import cached_property
from pathlib import Path
from typing import Any, ClassVar

import numpy as np
from numpy.typing import NDArray
from virtual_sensor_plugins.drift import Drift
from virtual_sensor_plugins.exposure import ONE_FRAME
from virtual_sensor_plugins.lit_pixels import Columns
from virtual_sensor_plugins.lit_pixels import RenderReport as RenderReport
from virtual_sensor_plugins.renderer import DIRECT as DIRECT
from virtual_sensor_plugins.renderer import Arrangement, Fluxes, Prepared

from virtual_sensor.arrays import number_for, shares, to_numpy, whole_number
from virtual_sensor.arrays import truth_of as boolean
from virtual_sensor.calls import public
from virtual_sensor.devices.device import Device
from virtual_sensor.devices.laser import LaserLine
from virtual_sensor.devices.patterns import Uniform
from virtual_sensor.devices.projector import Projector
from virtual_sensor.display import Displayed, listed
from virtual_sensor.errors import InputError
from virtual_sensor.imaging.layers import GhostColumns, GhostTruth, ghost_columns
from virtual_sensor.imaging.scene import Scene
from virtual_sensor.optics.illumination import LightStatus
from virtual_sensor.optics.map_cache import MAPS
from virtual_sensor.optics.sight import check_progress, scene_of
from virtual_sensor.records import Described, status_names, vectors, write_layers

Image = NDArray[np.float32]

_MOST_SAMPLES = 1 << 20  # a pixel's are in flight at once
_LARGEST_SEED = 2**32 - 1

DIRECT_SHARE = 0.2
"""Of the time that a frame takes whose light bounces, what its direct light takes."""

_MOST_PREPARED = 4
_PREPARED: dict[tuple[object, ...], Prepared] = {}  # used under ONE_FRAME


@dataclass(frozen=True, eq=False)
class PixelTruth(Displayed):
    """The pixels of a frame that may be lit, and the truth at their centres.

    Attributes
    ----------
    index : ndarray of shape (N,)
        Row-major numbers of the pixels.
    point_mm : ndarray of shape (N, 3)
        Where the bent line of sight meets the surface, world; NaN where no source reaches.
    depth_mm : ndarray of shape (N,)
        Of that point along the camera's axis.
    source_coordinates : dict
        By the sources' names, ndarray of shape (N, 2): (s, t) of the source's ray that lights the
        pixel: across the sheet and along the line of a laser, (p, q) of a projector; NaN where it
        does not reach.
    status : dict
        By the sources' names, ndarray of shape (N,): `LightStatus`.
    report : RenderReport
    """

    _statuses: ClassVar = {"status": LightStatus}

    index: NDArray[np.uint32]
    point_mm: Image
    depth_mm: Image
    source_coordinates: Mapping[str, Image]
    status: Mapping[str, NDArray[np.uint8]]
    report: RenderReport

    def _line(self) -> str:
        lit = int(np.isfinite(self.depth_mm).sum())
        return f"{self.index.size} pixels that may be lit, {lit} are"

    def _columns(self) -> dict[str, Any]:
        found: dict[str, Any] = {"index": self.index}
        found |= vectors("point_mm", self.point_mm, "xyz") | {"depth_mm": self.depth_mm}
        for name, coordinates in self.source_coordinates.items():
            found |= vectors(name, coordinates, "st")
            found[f"{name}_status"] = status_names(self.status[name], LightStatus)
        return found


@dataclass(frozen=True, eq=False)
class Frame(Displayed):
    """A rendered frame, and the truth at its pixels' centres.

    Attributes
    ----------
    radiance : ndarray of shape (H, W)
        W/(mm^2 sr), averaged over each pixel.
    truth : PixelTruth
        The truth where there is one; `point_mm` and its kin are images of it.
    radius_mm : dict
        By source that is a laser line, its 1/e^2 radius where things are measured.
    report : RenderReport
        How the frame was made: the transport, the maps' nodes and error, samples marched.
    background : ndarray of shape (H, W) or None
        The radiance that lamps and glow alone make, where it was asked for, or there are layers.
    direct : ndarray of shape (H, W) or None
        The radiance that sources make directly; None unless the scene's `max_depth` is above 2.
        `radiance` is the sum of all layers.
    indirect : ndarray of shape (B, H, W) or None
        Likewise the radiance that they make by one reflection between, by two, ...
    ghosts : GhostTruth or None
        Likewise which of the sources' rays make that.
    """

    _field_units: ClassVar = dict.fromkeys(
        ("radiance", "background", "direct", "indirect"), "W/(mm² sr)"
    )

    radiance: Image
    truth: PixelTruth
    radius_mm: Mapping[str, float]
    report: RenderReport
    background: Image | None = None
    direct: Image | None = None
    indirect: Image | None = None
    ghosts: GhostTruth | None = None

    def _line(self) -> str:
        height, width = self.radiance.shape
        lit = int(np.isfinite(self.truth.depth_mm).sum())
        brightest = self.radiance.max(initial=0.0)
        number = 0 if self.indirect is None else len(self.indirect)
        bounces = f"{number} bounce{'s' * (number > 1)}" if number else ""
        size = f"{width} x {height} px"
        return listed(size, f"{lit} lit", f"up to {brightest:.4g} W/(mm² sr)", bounces)

    def _columns(self) -> dict[str, Any]:
        row, column = np.divmod(self.truth.index.astype(np.int64), self.radiance.shape[1])
        radiance = self.radiance.ravel()[self.truth.index]
        columns = {"column": column, "row": row, "radiance": radiance, **self.truth._columns()}
        return {name: values for name, values in columns.items() if name != "index"}

    def __array__(self, dtype: Any = None, copy: bool | None = None) -> NDArray:
        """The radiance, wherever an image is asked for."""
        return np.array(self.radiance, dtype) if copy else np.asarray(self.radiance, dtype)

    @cached_property
    def point_mm(self) -> Image:
        """World point that the bent line of sight meets, (H, W, 3); NaN where no source reaches."""
        return self._image(self.truth.point_mm)

    @cached_property
    def depth_mm(self) -> Image:
        """Depth of that point along the camera's axis, (H, W)."""
        return self._image(self.truth.depth_mm)

    @cached_property
    def source_coordinates(self) -> dict[str, Image]:
        """By source, (s, t) of its ray that lights the pixel, (H, W, 2); NaN where none does."""
        return {name: self._image(st) for name, st in self.truth.source_coordinates.items()}

    def ghost_coordinates(self, bounce: int = 1, source: str | None = None) -> Image:
        """(s, t) of the rays that light pixels by so many reflections between, (H, W, 2).

        The mean of those that make a pixel's light; NaN where none does.  `ghosts` knows how far
        they are apart, and how bright each source's are.

        Raises
        ------
        InputError
            If the frame has no such layer, or as `coordinates` does.
        """
        name = self.source_name(source)
        if self.ghosts is None:
            raise InputError(
                "the frame has direct light alone; render a scene with max_depth=3, or more"
            )
        number = whole_number("bounce", bounce, 1, self.ghosts.bounces)
        return self._image(self.ghosts.source_coordinates[name][number - 1], self.ghosts.index)

    @cached_property
    def ghost_columns(self) -> GhostColumns | None:
        """How bright its ghosts are beside its line, by column; None without layers."""
        if self.direct is None or self.indirect is None:
            return None
        return ghost_columns(self.direct, self.indirect)

    def coordinates(self, source: str | None = None) -> Image:
        """(s, t) of one source's rays, (H, W, 2); without a name, of the only source.

        Raises
        ------
        InputError
            If there is no such source, or there are several.
        """
        return self.source_coordinates[self.source_name(source)]

    def source_name(self, source: str | None = None) -> str:
        """The name of a source, or of the only one; an InputError where that is none."""
        held = self.truth.source_coordinates
        name = next(iter(held)) if source is None and len(held) == 1 else source
        if name is None or name not in held:
            raise InputError(
                f"the frame has the sources {', '.join(held) or '(none)'}, and not '{source}'; say"
                " which (source=)"
            )
        return name

    @cached_property
    def lit(self) -> NDArray[np.bool_]:
        """Whether a source reaches the pixel's centre, (H, W)."""
        lit = np.zeros(self.radiance.shape, bool)
        lit.ravel()[self.truth.index] = np.isfinite(self.truth.depth_mm)
        return lit

    def _image(self, values: Image, index: NDArray[np.uint32] | None = None) -> Image:
        """An image of numbers (N, ...) at pixels, channel by channel as files want it.

        By default at the lit ones.
        """
        index = self.truth.index if index is None else index
        channels = values.reshape(len(values), -1).T
        height, width = self.radiance.shape
        image = np.full((len(channels), height * width), np.nan, np.float32)
        for channel, numbers in zip(image, channels, strict=True):
            channel[index] = numbers
        image = np.moveaxis(image.reshape(-1, height, width), 0, -1)
        return image if values.ndim > 1 else image[:, :, 0]


@public
def render(
    scene: Scene | str | Path,
    spp: int | None = None,
    seed: int = 0,
    camera: str | None = None,
    source: str | None = None,
) -> Image:
    """Render a camera's image: radiance in W/(mm^2 sr), shape (H, W).

    Parameters
    ----------
    scene : Scene, str or Path
        From `load_scene`, or its name or path.
    spp : int, optional
        Samples per pixel; the scene's own if not given.
    seed : int
        Of the sampler; the installed scenes sample on a regular grid, whatever the seed.
    camera : str, optional
        Its name; it can be left out where the scene has one.
    source : str, optional
        Name of the only source that shines; all do if not given.

    Raises
    ------
    InputError
        If it is no scene, it has no such camera or source, or one of the numbers can't be used.
    EngineError
        If the scene was loaded under another Mitsuba variant.
    """
    scene, samples, seed = checked("render", scene, spp, seed, camera, source)
    with ONE_FRAME:
        return image_of(prepared_for(scene), samples, seed)


@public
def render_frame(
    scene: Scene | str | Path,
    spp: int | None = None,
    seed: int = 0,
    progress: Callable[[float], None] | None = None,
    camera: str | None = None,
    source: str | None = None,
    *,
    background: bool = False,
) -> Frame:
    """Render a camera's image together with its ground truth.

    Parameters
    ----------
    scene, spp, seed, camera, source
        As those of `render`.
    progress : callable, optional
        Is called with the fraction of the samples done.
    background : bool
        Whether the light of lamps and glow alone is given too: of the same rays, while no source
        shines.

    Raises
    ------
    InputError, EngineError
        As `render` does.
    """
    check_progress("render_frame", progress)
    boolean("render_frame: background", background)
    scene, samples, seed = checked("render_frame", scene, spp, seed, camera, source)
    with ONE_FRAME:
        prepared = prepared_for(scene)
        bounces = bool(prepared.bounces)
        apart = background or (bounces and bool(prepared.arrangement.lamps))
        fluxes = {name: on_and_off(each) for name, each in scene.sources.items() if apart}
        exposure, report = prepared.exposed(
            samples,
            seed,
            part_of(progress, 0.0, DIRECT_SHARE) if bounces else progress,
            frames=1 + apart,
            fluxes=fluxes,
        )
        radiance, *other = exposure.images()
        frame = Frame(radiance, truth_of(prepared), radii_mm(scene), report, *other)
        if not bounces:
            return frame
        moments = prepared.indirect(seed, part_of(progress, DIRECT_SHARE, 1.0), moments=True)
        return with_layers(frame, moments)


def radii_mm(scene: Scene) -> dict[str, float]:
    """By source that is a laser line, its 1/e^2 radius where things are measured."""
    lines = {n: each for n, each in scene.sources.items() if isinstance(each, LaserLine)}
    return {name: line.working_radius_mm for name, line in lines.items()}


def with_layers(frame: Frame, moments: Mapping[str, NDArray[np.floating]]) -> Frame:
    """A frame of direct light with its layers, by the moments of its indirect light.

    They are as `GhostTruth.of` takes them.
    """
    shape = frame.radiance.shape
    layers = [each[:, 0] for each in moments.values()]
    indirect: Image = np.zeros((0, *shape), np.float32)
    if layers:
        indirect = np.sum(layers, axis=0, dtype=np.float32)
    background, direct = frame.background, frame.radiance
    if background is None:
        background = np.zeros_like(direct)
    else:
        direct = np.maximum(direct - background, np.float32(0.0))
    return replace(
        frame,
        radiance=frame.radiance + indirect.sum(axis=0, dtype=np.float32),
        background=background,
        direct=direct,
        indirect=indirect,
        ghosts=GhostTruth.of(moments),
    )


def image_of(prepared: Prepared, spp: int, seed: int) -> Image:
    """The radiance of all light."""
    image: Image = prepared.exposed(spp, seed)[0].images()[0]
    return image + prepared.bounced_light(seed) if prepared.bounces else image


def part_of(
    progress: Callable[[float], None] | None, first: float, last: float
) -> Callable[[float], None] | None:
    """Progress of a part of the whole."""
    return progress and (lambda part: progress(first + (last - first) * part))


def on_and_off(device: Device) -> Fluxes:
    """The flux of a source in a frame in which it shines, and in one in which it does not."""

    def fluxes(s: Any, t: Any, depth: Any) -> list[Any]:
        return [device.flux(s, t, depth), number_for(s, 0.0)]

    return fluxes


def light_of_sources(
    scene: Scene, spp: int | None = None, seed: int = 0, *, bounces: bool = True
) -> Image:
    """Radiance (H, W) that a scene's sources make, without that of its lamps and its glow.

    Without `bounces` what they make directly.
    """
    scene, samples, seed = checked("light_of_sources", scene, spp, seed)
    fluxes = {name: on_and_off(each) for name, each in scene.sources.items()}
    with ONE_FRAME:
        prepared = prepared_for(scene)
        exposure, _ = prepared.exposed(samples, seed, others=False, frames=2, fluxes=fluxes)
        on, off = exposure.images()
        light: Image = np.maximum(on - off, np.float32(0.0))
        return light + prepared.bounced_light(seed) if bounces and prepared.bounces else light


def render_columns(scene: Scene, column: Columns, spp: int, seed: int = 0) -> Image:
    """Radiance (H, W) of the direct light of pixels that sources light in some columns.

    Zero in all others.
    """
    scene, samples, seed = checked("render_columns", scene, spp, seed)
    with ONE_FRAME:
        exposure, _ = prepared_for(scene, column).exposed(samples, seed, others=False)
        return exposure.images()[0]


def indirect_columns(scene: Scene, column: Columns, indirect_samples: int, seed: int = 0) -> Image:
    """Likewise of the light that bounces, by so many points of the lit stripe a sample."""
    with ONE_FRAME:
        prepared = prepared_for(scene, column)
        given = replace(prepared.arrangement, indirect_samples=indirect_samples)
        return replace(prepared, arrangement=given).bounced_light(seed, of_lit=True)


def render_uncached(scene: Scene, spp: int | None = None) -> Image:
    """Render a scene with nothing cached, as if for the first time."""
    scene, samples, seed = checked("render_uncached", scene, spp, 0)
    with ONE_FRAME:
        MAPS.clear()
        prepared = Prepared.of(arrangement(scene))
        image = image_of(prepared, samples, seed)
        _ = truth_of(prepared)
        return image


def lit_pixels(scene: Scene) -> PixelTruth:
    """The pixels that the sources light, with the truth at their centres, and no frame."""
    scene = scene_of("lit_pixels", scene)
    with ONE_FRAME:
        return truth_of(prepared_for(scene))


def arrangement(scene: Scene, drift_mm: float = 0.0) -> Arrangement:
    """What the renderer is given of a scene, whose sensor may drift by up to a distance."""
    return Arrangement(
        scene.mitsuba,
        scene.mitsuba_camera,
        scene.camera,
        scene.sources,
        scene.medium,
        scene.transport,
        scene.hot,
        drift_mm,
        scene.max_depth,
        scene.indirect_samples,
    )


def prepared_for(scene: Scene, column: Columns | None = None, drift_mm: float = 0.0) -> Prepared:
    """What frames of a scene need: cached while the scene lives and stays as it is.

    A frame is equal to the bit to a first one, as its samples are of the same rays by the same
    maps.  What is cached is found by identity: what a scene consists of never changes.
    """
    given = arrangement(scene, drift_mm)
    film = given.sensor.film()
    parts = scene.loaded, given.sensor, given.camera, given.medium, *given.sources.values()
    window = (*film.crop_offset(), *film.crop_size())
    columns = None if column is None else np.asarray(column).tobytes()
    what = tuple(given.sources), window, given.transport, given.hot, columns, drift_mm
    key = *(id(part) for part in parts), what
    prepared = _PREPARED.pop(key, None)
    if prepared is None:
        prepared = Prepared.of(given, column)  # it holds its parts, so that no id is given again
        weakref.finalize(scene.loaded, _PREPARED.pop, key, None).atexit = False
    _PREPARED[key] = prepared  # the latest last
    for old in list(_PREPARED)[:-_MOST_PREPARED]:
        _PREPARED.pop(old, None)
    return prepared


def truth_of(prepared: Prepared, drift: Drift | None = None) -> PixelTruth:
    """The truth at the centres of lit pixels; a black pixel of a projector lights too.

    With a drift: of the rows that it exposes, with points as the camera sees them from where the
    arrangement has it.
    """
    lit, sources = prepared.lit, prepared.arrangement.sources
    index, sight = prepared.seen(drift)
    count = index.size
    coordinates = {name: np.full((count, 2), np.nan, np.float32) for name in sources}
    statuses = {name: np.full(count, LightStatus.NO_POINT, np.uint8) for name in sources}
    point, depth = np.full((count, 3), np.nan, np.float32), np.full(count, np.nan, np.float32)
    if sight is not None:
        reached = np.zeros(count, bool)
        for name, light in zip(lit.names, sight.lights, strict=True):
            flux = _white(sources[name]).flux(light.s, light.t, light.depth)
            power = flux * light.concentration
            shines = (power > 0.0).numpy()
            coordinates[name] = np.stack([light.s.numpy(), light.t.numpy()], 1)
            coordinates[name][~shines] = np.nan
            statuses[name] = np.array(light.status, np.uint8)
            reached |= shines
        points, camera = to_numpy(sight.point), prepared.arrangement.camera
        if drift is not None:
            points = points - drift.shifts(prepared.arrangement.view.row_of(index))
        for some in shares(count):
            point[some] = points[some]
            if camera:
                depth[some] = camera.pose.to_local(points[some])[:, 2]
        point[~reached], depth[~reached] = np.nan, np.nan
    return PixelTruth(index, point, depth, coordinates, statuses, lit.report)


def _white(source: Device) -> Device:
    """A source as it is at its brightest."""
    return source.with_pattern(Uniform()) if isinstance(source, Projector) else source


def checked(
    asker: str,
    scene: Scene | str | Path,
    spp: int | None,
    seed: int,
    camera: str | None = None,
    source: str | None = None,
) -> tuple[Scene, int, int]:
    """The scene of the named devices, samples per pixel (0: the scene's own), and seed."""
    loaded: Scene = scene_of(asker, scene)
    samples = 0 if spp is None else whole_number(f"{asker}: spp", spp, 1, _MOST_SAMPLES)
    seed = whole_number(f"{asker}: seed", seed, 0, _LARGEST_SEED)
    return loaded.only(camera, source), samples, seed


EXR_LAYERS = (
    Described("Y", "W/(mm² sr)", "Radiance, averaged over the pixel."),
    Described("point.X, point.Y, point.Z", "mm", "World point that the bent line of sight meets."),
    Described("depth.Z", "mm", "Depth of that point along the camera's axis."),
    Described("lit", "", "1 where the laser's irradiance is not nil, else 0."),
    Described(
        "SOURCE.a, SOURCE.b",
        "mm, or 1 of a pinhole",
        "Coordinates of the ray of the source of this name that lights the point: of a laser line"
        " a across it and b along it; NaN where none does.",
    ),
    Described(
        "background.Y",
        "W/(mm² sr)",
        "Radiance that lamps and glow alone make, where it was asked for, or light bounces.",
    ),
    Described(
        "direct.Y",
        "W/(mm² sr)",
        "Radiance that sources make directly; this and the next where the scene's max_depth is"
        " above 2.",
    ),
    Described(
        "indirect1.Y, indirect2.Y, ...",
        "W/(mm² sr)",
        "Radiance that sources make by one reflection between, by two, ...",
    ),
    Described(
        "SOURCE.indirect1.a, SOURCE.indirect1.b, ...",
        "mm, or 1 of a pinhole",
        "Mean coordinates of the rays of the source of this name that make that light; NaN where"
        " none do.",
    ),
)
"""Layers of a frame's EXR file, float32; the truth is that at the pixel's centre."""


def write_exr(path: Path, frame: Frame, header: dict[str, str]) -> None:
    """Write radiance and ground truth as float32 layers (`EXR_LAYERS`), with a header."""
    channels: dict[str, NDArray[Any]] = {
        "Y": frame.radiance,
        "point.X": frame.point_mm[:, :, 0],
        "point.Y": frame.point_mm[:, :, 1],
        "point.Z": frame.point_mm[:, :, 2],
        "depth.Z": frame.depth_mm,
        "lit": frame.lit,
    }
    for name, coordinates in frame.source_coordinates.items():
        channels |= {f"{name}.a": coordinates[:, :, 0], f"{name}.b": coordinates[:, :, 1]}
    if frame.background is not None:
        channels["background.Y"] = frame.background
    if frame.direct is not None:
        channels["direct.Y"] = frame.direct
    for number, layer in enumerate(() if frame.indirect is None else frame.indirect, 1):
        channels[f"indirect{number}.Y"] = layer
        for name in frame.ghosts.status if frame.ghosts else ():
            coordinates = frame.ghost_coordinates(number, name)
            stem = f"{name}.indirect{number}"
            channels |= {f"{stem}.a": coordinates[:, :, 0], f"{stem}.b": coordinates[:, :, 1]}
    write_layers(path, channels, header)
