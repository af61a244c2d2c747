"""From a rendered frame to what its camera stores: speckle, exposure, noise, bits, and the truth.

    radiance --speckle--> --lens, exposure--> photons --sensor--> grey values

The irradiance of the sensor is E = pi L tau/(4 N_w^2), N_w = N (1 + m) the working f-number: Born
and Wolf 1999, 4.8.3, on the axis.  A pinhole has no aperture and so no exposure time: `auto` gives
its brightest pixel a share of the saturation, as a camera's automatic exposure does.

One seed makes a frame, whatever was recorded before it: the sensor's noise follows from it.  The
rough surface that speckles is the same while the part, the camera and the light are at rest.
"""

from __future__ import annotations

import importlib
import math
import zlib
from collections.abc import Mapping
from dataclasses import asdict, dataclass, field, replace
from functools import cached_property
from importlib.metadata import version
from pathlib import Path
from typing import Any, ClassVar

import numpy as np
from numpy.typing import ArrayLike, NDArray

from virtual_sensor.arrays import SMALLEST, number_within, truth_of, unmasked, whole_number
from virtual_sensor.calls import public
from virtual_sensor.devices.camera import LensCamera
from virtual_sensor.devices.coherence import Coherence
from virtual_sensor.devices.exposure_time import AUTO, LONGEST_S, SHORTEST_S, exposure_time_s
from virtual_sensor.devices.image_sensor import ImageSensor, LinearGrey, image_sensor
from virtual_sensor.devices.laser import LaserLine
from virtual_sensor.display import Displayed, listed, span
from virtual_sensor.errors import InputError, short
from virtual_sensor.imaging.column_truth import ColumnTruth, column_truth
from virtual_sensor.imaging.exposures import ExposedFrame
from virtual_sensor.imaging.grey_values import grey_values, image_irradiance, photons
from virtual_sensor.imaging.render import Frame, arrangement, light_of_sources
from virtual_sensor.imaging.scene import Scene
from virtual_sensor.imaging.sequence import PatternFrames
from virtual_sensor.imaging.speckle import Aperture, speckled
from virtual_sensor.optics.lens import circle_of_confusion
from virtual_sensor.optics.sight import scene_of
from virtual_sensor.seeds import LARGEST_SEED, part_seed

Ideal = Frame | PatternFrames | NDArray[np.floating]
Image = NDArray[np.float32]

PEAK = 0.8
"""Of the saturation is where automatic exposure puts the brightest pixel."""

_MOST_PEAK = 1e6  # times the saturation: far over-exposed
_COHERENCE_NAMES = {"roughness": "-D rq=10, um", "linewidth": "-D linewidth=2, nm"}
_MANY = 0.5  # of the line's columns
_SOME_POINTS = 256  # of a frame
_SAME_DEPTH = 1e-4  # of it
_BENT = 0.05  # of the image: farther than hot air moves what is seen
_SAME_PIXEL = 0.01
_SAME_TIME = 0.01  # of an exposure
_DETOUR_MM = 1.0  # by so much at least light's way is longer that was reflected in between


@dataclass(frozen=True, eq=False)
class RecordedFrame(Displayed):
    """What a camera stored of a frame, or of a sequence, and all that made it.

    >>> frame = vs.render_frame(scene)
    >>> shot = vs.record(scene, frame, seed=1, sensor="cmos_5um5")
    >>> line = vs.line_centres(shot)  # knows gain, noise, saturation, black level
    >>> vs.compare_line(line, shot).rms_px

    Attributes
    ----------
    grey : ndarray of shape (H, W) or (K, H, W)
        Grey values, uint8 or uint16.
    ideal : Frame, PatternFrames or ndarray
        As rendered.
    sensor : ImageSensor
    exposure_s : float or None
        None where a pinhole was exposed automatically: without an aperture there is no time.
    electrons_per_radiance : float
        Mean electrons of a pixel for 1 W/(mm^2 sr).
    seed : int
        Of this frame.
    drawn : Mapping
        All that was drawn from the seed, by name: the seeds of its parts.
    parameters : Mapping
        The scene's.
    scene : Path
        Its file.
    camera : LensCamera
        That saw it.
    notes : tuple of str
    speckled : ndarray or None
        Radiance with speckle; None without.
    """

    _field_units: ClassVar = {"electrons_per_radiance": "e mm² sr/W"}

    grey: NDArray[np.uint8] | NDArray[np.uint16]
    ideal: Ideal
    sensor: ImageSensor
    exposure_s: float | None
    electrons_per_radiance: float
    seed: int
    drawn: Mapping[str, Any]
    parameters: Mapping[str, str]
    scene: Path
    camera: LensCamera
    notes: tuple[str, ...] = ()
    speckled: Image | None = field(default=None, repr=False)

    def __post_init__(self) -> None:
        for name in ("drawn", "parameters"):
            object.__setattr__(self, name, dict(getattr(self, name)))

    def _line(self) -> str:
        *count, height, width = self.grey.shape
        size = f"{f'{count[0]} of ' if count else ''}{width} x {height} px"
        time = f"{self.exposure_s * 1e3:.4g} ms" if self.exposure_s else ""
        return listed(size, f"{self.sensor.bit_depth} bits", span("", self.grey), time)

    def _columns(self) -> dict[str, Any]:
        """The truth of the only line in each column; else a row for each frame."""
        if isinstance(self.ideal, Frame) and len(self.ideal.radius_mm) == 1:
            (name,) = self.ideal.radius_mm
            return self.line_truth(name).columns()
        frames = self.grey.reshape(-1, *self.grey.shape[-2:])
        return {
            "frame": np.arange(len(frames)),
            "mean": frames.mean(axis=(1, 2)),
            "brightest": frames.max(axis=(1, 2)),
            "saturated": self.saturated.reshape(frames.shape).sum(axis=(1, 2)),
        }

    def __array__(self, dtype: Any = None, copy: bool | None = None) -> NDArray:
        """The grey values, wherever an image is asked for."""
        return np.array(self.grey, dtype) if copy else np.asarray(self.grey, dtype)

    def __len__(self) -> int:
        return len(self.grey)

    @property
    def shape(self) -> tuple[int, ...]:
        """Of the grey values."""
        return self.grey.shape

    @property
    def dtype(self) -> Any:
        """Of the grey values."""
        return self.grey.dtype

    @property
    def specimen(self) -> ImageSensor:
        """The sensor with the fixed pattern of the camera: each of several has its own."""
        return replace(self.sensor, pattern_seed=self.drawn["pattern"])

    @cached_property
    def electrons(self) -> Image:
        """Mean electrons of each pixel, without noise and before clipping; as `grey` in shape."""
        return self.light * np.float32(self.electrons_per_radiance)

    @property
    def light(self) -> NDArray[np.floating]:
        """Radiance that was exposed: with speckle, where there is some."""
        return _radiance(self.ideal) if self.speckled is None else self.speckled

    @cached_property
    def saturated(self) -> NDArray[np.bool_]:
        """Which pixels are clipped, by the well or by the converter."""
        return self.grey >= self.sensor.saturation

    @cached_property
    def truth(self) -> ColumnTruth:
        """What is true of the only laser's line in each column."""
        return self.line_truth()

    def line_truth(self, source: str | None = None) -> ColumnTruth:
        """What is true of a laser's line in each column; without a name, of the only source's.

        Raises
        ------
        InputError
            If there is no such laser line, or there are several, or no frame with its truth was
            recorded.
        """
        if not isinstance(self.ideal, Frame):
            raise InputError(
                "the recorded frame has no line: what was recorded is a sequence, whose truth is"
                " ideal.projector_pixel, or a radiance alone; record a Frame (render_frame)"
            )
        name = self.ideal.source_name(source)
        if name not in self.ideal.radius_mm:
            raise InputError(f"the source '{name}' is no laser line, and its frame has no line")
        light, bounced = self.electrons, self.ideal.indirect
        for other in (self.ideal.background, *(() if bounced is None else bounced)):
            if other is not None:
                light = light - other * np.float32(self.electrons_per_radiance)
        return column_truth(self.ideal, self.camera, light, name)

    @property
    def detector_options(self) -> dict[str, float]:
        """The sensor's, with the dark current of the exposure: see `ImageSensor`."""
        dark_e = self.sensor.dark_current * (self.exposure_s or 0.0)
        return self.sensor.detector_options_above(dark_e)

    @cached_property
    def linear_grey(self) -> RecordedFrame | LinearGrey:
        """What detectors are given: grey values in proportion to the light, without a knee-point.

        Those that are, are the frame's own.
        """
        if self.sensor.knee is None:
            return self
        return self.sensor.linear(self.grey, self.detector_options)

    @property
    def metadata(self) -> dict[str, Any]:
        """What made it, as files carry it: ``vs.record`` of the same frame makes the same bits."""
        lens = self.camera.lens
        return {
            "software": f"virtual_sensor {version('virtual-sensor')}",
            "scene": str(self.scene),
            "parameters": dict(self.parameters),
            "sensor": asdict(self.sensor),
            "lens": None if lens is None else {**asdict(lens), "f_number": lens.f_number},
            "exposure_s": self.exposure_s,
            "electrons_per_radiance": self.electrons_per_radiance,
            "seed": self.seed,
            "drawn": dict(self.drawn),
            **self.detector_options,
            "notes": list(self.notes),
        }

    def write(self, path: str | Path, images: str = "png", *, overwrite: bool = False) -> Path:
        """Write it: grey values alone to a file, or with ideal frame and truth into a folder.

        Parameters
        ----------
        path : str or Path
            Of an image that ends with .png or .tif, which carries noise, gain, saturation, black
            level and all else that is known (`read_image` reads them); or of a folder, of which
            `imaging.recording_files` says what it holds.
        images : {"png", "tif"}
            What the grey values in a folder are written as.
        overwrite : bool
            Whether what exists is replaced.

        Returns
        -------
        Path
            Of the file or the folder, which are written whole or not at all.

        Raises
        ------
        InputError
            If it exists, can't be written, or a sequence is to be one image.
        """
        files: Any = importlib.import_module("virtual_sensor.imaging.recording_files")
        written: Path = files.write_recording(self, path, images, overwrite)
        return written


@public
def record(
    scene: Scene | str | Path,
    frame: Frame | PatternFrames | ArrayLike,
    seed: int = 0,
    *,
    sensor: ImageSensor | str | Path | None = None,
    exposure_s: float | str | None = None,
    speckle: bool | Aperture = False,
    surface_seed: int = 0,
    peak: float = PEAK,
    camera: str | None = None,
) -> RecordedFrame:
    """Record a rendered frame as the scene's camera stores it.

    >>> scene = vs.load_scene("hot_cylinder")
    >>> shot = vs.record(scene, vs.render_frame(scene), seed=3, sensor="cmos_5um5")

    Parameters
    ----------
    scene : Scene, str or Path
        Which the frame shows: its camera has the lens, and may have a sensor and an exposure.
    frame : Frame, PatternFrames or array_like
        The ideal one: from `render_frame` or `render_sequence`, or a radiance in W/(mm^2 sr) of
        shape (H, W) or (K, H, W).  All frames of a sequence are exposed alike.
    seed : int
        Of this frame: the same gives the same bits, alone or among a thousand.  Several cameras of
        a scene have noise and fixed patterns of their own, whatever seed they share.
    sensor : ImageSensor, str or Path, optional
        Or its name, or its file; by default the camera's, else `ImageSensor()`.
    exposure_s : float or str, optional
        Exposure time in s, or a text such as "2ms"; by default that of a frame that took time
        (`render_exposure`), else the camera's; "auto" puts the brightest pixel at `peak`.  A time
        needs a lens with an f-number.
    speckle : bool or Aperture
        Whether the laser's light is speckled, by the camera's lens; or by that aperture.
    surface_seed : int
        Of the rough surface.  A part at rest keeps its speckle from frame to frame, whatever their
        seeds, and one that has moved has another: see `surface_of`.
    peak : float
        Share of the saturation at which "auto" puts the brightest pixel.
    camera : str, optional
        Its name; it can be left out where the scene has one.

    Raises
    ------
    InputError
        If the frame is of another size than the camera's image, was seen from another pose, or
        holds what is negative or no number; a time is given without a lens, or speckle asked for
        without one; or one of the others can't be used.

    Notes
    -----
    Left out are the fall of light towards the corners (vignetting, cos^4), diffraction where there
    is no speckle, aberrations other than distortion, colour, and lens breathing where the image
    distance is given.
    """
    loaded: Scene = scene_of("record", scene)
    scene = loaded.only(camera)
    seed = whole_number("record: seed", seed, 0, LARGEST_SEED)
    ideal = _ideal(scene, frame)
    chosen = sensor_of(scene, sensor)
    drawn: dict[str, Any] = _seeds_of(scene, chosen, seed)
    light, shown = _radiance(ideal), None
    if speckle is not False:
        number = whole_number("record: surface_seed", surface_seed, 0, LARGEST_SEED)
        drawn |= {"surface_seed": number, "surface": surface_of(scene, number)}
        aperture = aperture_of(scene, ideal, chosen, speckle)
        light = shown = _speckled(scene, ideal, aperture, drawn["surface"])
    taken_s = ideal.exposure_s if isinstance(ideal, ExposedFrame) else None
    if exposure_s is None and taken_s is not None:
        exposure_s = AUTO if scene.camera.lens_with_pupil is None else taken_s
    said = scene.camera.exposure_s if exposure_s is None else exposure_s
    automatic = exposure_time_s("record: exposure_s", said) is None
    factor, time_s, notes = exposure_of(scene, chosen, light, said, peak)
    if taken_s and time_s and not math.isclose(time_s, taken_s, rel_tol=_SAME_TIME):
        notes = (
            *notes,
            f"the part moves for {taken_s:g} s in this frame, and it is exposed for {time_s:.4g} s;"
            " render it by vs.render_exposure with that time",
        )
    if isinstance(ideal, ExposedFrame):
        notes = (*notes, *_skew(ideal))
    own = replace(chosen, pattern_seed=drawn["pattern"])
    grey = grey_of_radiance(light, factor, own, drawn["noise"], time_s)
    shot = RecordedFrame(
        grey,
        ideal,
        chosen,
        time_s,
        factor,
        seed,
        drawn,
        scene.parameters,
        scene.path,
        scene.camera,
        notes,
        shown,
    )
    coherent = _of_coherence(scene) if speckle is True else []
    return replace(shot, notes=(*notes, *coherent, *_doubts(shot, automatic)))


def _of_coherence(scene: Scene) -> list[str]:
    """Notes of lasers that speckle fully, or whose linewidth changes nothing without a depth."""
    notes = []
    for name, laser in scene.sources.items():
        if not isinstance(laser, LaserLine):
            continue
        if laser.coherence == Coherence():
            notes.append(
                f"the laser '{name}' is fully coherent, with the strongest speckle there is; a"
                " diode's on a rough surface is milder (-D linewidth=1 -D rq=10), and so is light"
                " that the surface depolarises (-D polarisations=2)"
            )
        broad, rough = laser.coherence.linewidth_nm, laser.coherence.roughness_um
        if bool(broad) != bool(rough):
            has, lacks = ("linewidth", "roughness") if broad else ("roughness", "linewidth")
            notes.append(
                f"the {has} of the laser '{name}' alone changes no speckle: it does so together"
                f" with its {lacks} ({_COHERENCE_NAMES[lacks]}), which is 0"
            )
    return notes


def _skew(frame: ExposedFrame) -> list[str]:
    """A note of a moving part that a rolling shutter skews."""
    rows = np.flatnonzero(frame.lit.any(axis=1))
    if not rows.size or not frame.row_time_s or not frame.velocity_mm_s.any():
        return []
    span_s = abs(frame.row_time_s) * np.ptp(rows)
    way_mm = float(np.linalg.norm(frame.velocity_mm_s)) * span_s
    return [
        f"the part moves by {way_mm:.2g} mm from the first lit row's exposure to the last one's:"
        " the line is skewed against that of the part at rest"
    ]


def grey_of_radiance(
    radiance: NDArray[np.floating],
    electrons_per_radiance: float,
    sensor: ImageSensor,
    seed: int,
    exposure_s: float | None,
) -> NDArray[np.uint8] | NDArray[np.uint16]:
    """Grey values of a radiance that is exposed as a recorded frame was."""
    falling = radiance * (electrons_per_radiance / sensor.quantum_efficiency)
    return grey_values(falling, sensor, seed, exposure_s=exposure_s)


def _seeds_of(scene: Scene, sensor: ImageSensor, seed: int) -> dict[str, int]:
    """Seeds of a frame's noise and of its sensor's fixed pattern.

    Several cameras of a scene have each their own, though one seed and one data sheet are given.
    """
    several = len(scene.mitsuba.sensors()) > 1
    name = (scene.camera_name,) if several else ()
    pattern = part_seed(sensor.pattern_seed, *name) if several else sensor.pattern_seed
    return {"noise": part_seed(seed, "noise", *name), "pattern": pattern}


def surface_of(scene: Scene, number: int = 0) -> int:
    """Seed of the rough surface as a camera sees it: one of many, by its number.

    It is another one as soon as the part, a camera or a source has moved, by 1 nm or more.  Air
    moves nothing, nor do lens, sensor and what else is not seen in the places of things.
    """
    boxes = [shape.bbox() for shape in scene.mitsuba.shapes()]
    corners = [np.ravel([box.min, box.max]) for box in boxes]
    poses = [np.ravel([*pose.rotation, pose.origin_mm]) for pose in scene.poses.values()]
    places = [np.round(each, 6) + 0.0 for each in (*corners, *poses)]
    digest = zlib.crc32(b"".join(place.tobytes() for place in places))
    return part_seed(number, "surface", digest)


def sensor_of(scene: Scene, sensor: ImageSensor | str | Path | None = None) -> ImageSensor:
    """The sensor that is given or named, else that of the scene's camera, else a usual one.

    Its quantum efficiency is that for the scene's light.
    """
    given = scene.camera.sensor if sensor is None else sensor
    found = ImageSensor() if given is None else given
    if isinstance(found, str | Path):
        found = image_sensor(found)
    if not isinstance(found, ImageSensor):
        raise InputError(
            f"record: sensor is {short(sensor)}; give an ImageSensor, or the name or file of one"
        )
    return found.at_wavelength(scene.air.wavelength_nm)


def pixel_um_of(scene: Scene, sensor: ImageSensor) -> float:
    """Pitch of the pixels, by the sensor's data sheet, else by the scene's camera.

    Raises
    ------
    InputError
        If neither says so.
    """
    pixel_um = sensor.pixel_um or scene.camera.pixel_um
    if pixel_um is None:
        raise InputError(
            f"{scene.path}: {scene.camera_element}: nothing says how large its pixels are; record"
            " by a sensor whose data sheet has pixel_um, such as cmos_5um5"
        )
    return float(pixel_um)


def _with_f_number(scene: Scene) -> str:
    """How a scene's camera gets an f-number."""
    if "f_number" in scene.parameters:
        return "give it one (-D f_number=8)"
    return 'give <float name="f_number" value="8"/> in a <sensor type="lens_camera">'


def aperture_of(
    scene: Scene, ideal: Ideal, sensor: ImageSensor, speckle: bool | Aperture
) -> Aperture:
    """What makes a frame's speckle: the lens of the scene's camera, the pixels, the laser's light.

    Of several lasers it is the most coherent one.  Patterns of a part that moves during the
    exposure add.

    Raises
    ------
    InputError
        If the camera is a pinhole, or no laser lights the frame.
    """
    if isinstance(speckle, Aperture):
        return speckle
    truth_of("record: speckle", speckle)
    lens = scene.camera.lens_with_pupil
    if lens is None:
        raise InputError(
            f"{scene.path}: {scene.camera_element}: a pinhole has no aperture, and speckle needs"
            f" its f-number; {_with_f_number(scene)}, or an Aperture (speckle=)"
        )
    wavelength_nm = scene.air.wavelength_nm
    shining = ideal.truth.source_coordinates if isinstance(ideal, Frame) else scene.sources
    sources = (source for name, source in scene.sources.items() if name in shining)
    lasers = [source.coherence for source in sources if isinstance(source, LaserLine)]
    if not lasers:
        raise InputError(
            f"{scene.path}: no laser lights this frame, and laser light alone is speckled; leave"
            " speckle out, or give an Aperture (speckle=)"
        )
    coherence = min(lasers, key=lambda each: each.patterns_at(wavelength_nm))
    aperture = Aperture.of(lens, pixel_um_of(scene, sensor), wavelength_nm, coherence)
    return aperture.moved(_path_px(scene, ideal)) if isinstance(ideal, ExposedFrame) else aperture


def _path_px(scene: Scene, frame: ExposedFrame) -> float:
    """How far the part moves in the image while a row is exposed, px: the mean of what is lit."""
    lit = frame.truth.point_mm[np.isfinite(frame.truth.depth_mm)].astype(float)
    step_mm = frame.velocity_mm_s * frame.exposure_s
    ends = (scene.camera.project(lit + share * step_mm) for share in (-0.5, 0.5))
    paths = np.linalg.norm(np.subtract(*ends), axis=1)
    paths = paths[np.isfinite(paths)]
    return float(paths.mean()) if paths.size else 0.0


def _ideal(scene: Scene, frame: Any) -> Ideal:
    """The frame, of the size of the camera's image."""
    if isinstance(frame, RecordedFrame):
        raise InputError("record: frame is recorded already; give its ideal one, frame.ideal")
    ideal = frame if isinstance(frame, Frame | PatternFrames) else unmasked(frame)
    light = _radiance(ideal)
    width, height = scene.camera.size
    if light.dtype.kind not in "iuf" or light.ndim not in (2, 3):
        raise InputError(
            f"record: frame is {short(frame)}; give a Frame (render_frame), PatternFrames"
            " (render_sequence), or a radiance (height, width)"
        )
    if light.shape[-2:] != (height, width) or not light.size:
        size = " x ".join(map(str, light.shape[::-1]))
        raise InputError(
            f"record: frame is of {size} px, and {scene.camera_element} of {width} x {height};"
            " give a frame of this scene"
        )
    if not (light.min() >= 0.0 and light.max() < np.inf):
        raise InputError(
            "record: frame holds what is negative, or not finite; give a radiance from 0 on, such"
            " as np.nan_to_num(frame)"
        )
    if isinstance(ideal, Frame):
        _check_camera(scene, ideal)
    return ideal


def _check_camera(scene: Scene, frame: Frame) -> None:
    """Refuse a frame whose points are at other places in the image of the scene's camera.

    Depths are the same to rounding, whatever the air.  Air moves points in the image by little.
    """
    truth = frame.truth
    lit = np.flatnonzero(np.isfinite(truth.depth_mm))
    some = lit[:: max(lit.size // _SOME_POINTS, 1)]
    if not some.size:
        return
    points_mm = truth.point_mm[some].astype(float)
    depth_mm = scene.camera.pose.to_local(points_mm)[:, 2]
    deeper = np.median(np.abs(depth_mm / truth.depth_mm[some] - 1.0))
    row, column = np.divmod(truth.index[some].astype(int), scene.camera.size[0])
    off_px = scene.camera.project(points_mm) - np.column_stack([column, row])
    farthest_px = _BENT * max(scene.camera.size)
    off = np.nanmedian(np.linalg.norm(off_px, axis=1))
    if not (deeper < _SAME_DEPTH and off < farthest_px):
        raise InputError(
            f"record: frame was seen by another camera than {scene.camera_element} of {scene.path},"
            " or from another pose; give the scene that rendered it"
        )


def _radiance(ideal: Ideal) -> NDArray[np.floating]:
    return ideal if isinstance(ideal, np.ndarray) else ideal.radiance


def _speckled(scene: Scene, ideal: Ideal, aperture: Aperture, seed: int) -> Image:
    """Radiance with the laser's light speckled; light of lamps and glow stays as it is.

    Light that was reflected in between is speckled by itself where it is not coherent to the rest.
    """
    light = _radiance(ideal)
    if light.ndim != 2:
        raise InputError(
            "record: speckle is of a laser's line, and this is a sequence; record its frames one"
            " by one, or leave speckle out"
        )
    background = getattr(ideal, "background", None)
    if background is None and arrangement(scene).lamps:
        raise InputError(
            "record: lamps, or the part's glow, light this frame too, and laser light alone is"
            " speckled; render it by vs.render_frame(scene, background=True)"
        )
    layers = _speckling_apart(scene, ideal, aperture)
    if layers is None:
        layers = [light if background is None else np.maximum(light - background, 0.0)]
    blur_px = blur_px_of(scene, ideal)
    seen = np.zeros(light.shape)
    for number, layer in enumerate(layers):
        own = part_seed(seed, "indirect", number) if number else seed
        if number or blur_px.max() <= aperture.resolution_px:
            seen += speckled(layer, aperture, own)
            continue
        in_focus = {scene.camera_name: replace(scene.camera, sub_pupils=1)}
        sharp = light_of_sources(replace(scene, cameras=in_focus), bounces=len(layers) == 1)
        seen += speckled(layer, aperture, own, blur_px, sharp)
    return seen.astype(np.float32) + (0.0 if background is None else background)


def _speckling_apart(scene: Scene, ideal: Ideal, aperture: Aperture) -> list[Image] | None:
    """Layers of a frame's laser light whose speckle patterns add; None if all is one light.

    Light that was reflected in between has come by another way: one that is longer by more than
    what the light is coherent over, lambda^2 over the linewidth (Goodman 2007, 5.3).
    """
    direct, indirect = (getattr(ideal, name, None) for name in ("direct", "indirect"))
    if direct is None or indirect is None or not aperture.linewidth_nm:
        return None
    coherent_mm = 1e-6 * aperture.wavelength_nm**2 / aperture.linewidth_nm
    return [direct, *indirect] if coherent_mm < _DETOUR_MM else None


def blur_px_of(scene: Scene, ideal: Ideal) -> NDArray[np.float64]:
    """Radius (H, W) of the circle of confusion with which a frame was rendered; 0 in the dark."""
    width, height = scene.camera.size
    blur = np.zeros(height * width)
    lens = scene.camera.lens_with_pupil
    if lens and scene.camera.blurs and isinstance(ideal, Frame):
        wide = circle_of_confusion(lens, scene.camera, ideal.truth.point_mm).mean(axis=1)
        blur[ideal.truth.index] = np.nan_to_num(wide) / 2.0
    return blur.reshape(height, width)


def exposure_of(
    scene: Scene,
    sensor: ImageSensor,
    light: NDArray[np.floating],
    exposure_s: float | str | None = None,
    peak: float = PEAK,
) -> tuple[float, float | None, tuple[str, ...]]:
    """Electrons for 1 W/(mm^2 sr), the exposure time if there is one, and notes."""
    given = scene.camera.exposure_s if exposure_s is None else exposure_s
    time_s = exposure_time_s("record: exposure_s", given)
    lens = scene.camera.lens_with_pupil
    per_second = None
    if lens is not None:
        falls = image_irradiance(1.0, lens.working_f_number, scene.camera.transmission)
        each = photons(falls, 1.0, pixel_um_of(scene, sensor), scene.air.wavelength_nm)
        per_second = float(each) * sensor.quantum_efficiency
    if time_s is not None:
        if per_second is None:
            raise InputError(
                f"{scene.path}: {scene.camera_element}: a pinhole has no aperture, and the time"
                f" exposure_s = {short(given)} needs its f-number; {_with_f_number(scene)}, or"
                " leave the exposure to auto"
            )
        return per_second * time_s, time_s, ()
    number_within("record: peak", peak, SMALLEST, _MOST_PEAK, "a share of the saturation above 0")
    if sensor.saturation_e <= 0.0:
        raise InputError(
            f"record: sensor: {sensor.bit_depth} bits end at {sensor.white}, and its black_level is"
            f" {sensor.black_level:g}; give a lower one"
        )
    brightest = float(light.max(initial=0.0))
    if not brightest:
        return 0.0, None, ("the frame is dark: automatic exposure found no light",)
    factor = sensor.light_e(peak * sensor.saturation_e) / brightest
    if per_second is None:
        return factor, None, ()
    time_s = factor / per_second
    kept = min(max(time_s, SHORTEST_S), LONGEST_S)
    notes = (
        ()
        if kept == time_s
        else (
            f"automatic exposure stops at {kept:g} s, where the brightest pixel has"
            f" {kept / time_s * peak:.2g} of the saturation",
        )
    )
    return per_second * kept, kept, notes


def _doubts(shot: RecordedFrame, automatic: bool) -> list[str]:
    """Notes of a recorded frame whose line is clipped, or drowns, or that is of other pixels."""
    notes = _of_other_pixels(shot)
    lit = getattr(shot.ideal, "lit", None)
    if lit is None or not lit.any():
        return notes
    columns = lit.any(axis=0)
    clipped = (shot.saturated & lit).any(axis=0)
    share = float(clipped.sum() / columns.sum())
    if share > _MANY:
        which = "all" if share == 1.0 else f"{share:.0%} of the"
        shorter = (
            "give automatic exposure a lower peak, or the sensor a smaller prnu"
            if automatic
            else "expose for a shorter time, or leave it to auto"
        )
        notes.append(f"{which} lit columns are saturated: their centres are less sure; {shorter}")
    brightest = max(float(shot.grey[lit].max()) - shot.sensor.black_level, 0.0)
    if brightest < 6.0 * shot.sensor.grey_noise:
        longer = (
            f"give automatic exposure a higher peak, or a sensor that holds more than"
            f" {shot.sensor.saturation_e:.3g} electrons (full_well_e)"
            if automatic
            else "expose for a longer time, or leave it to auto"
        )
        notes.append(
            f"the line is at most {brightest:.3g} grey values above black, and the noise"
            f" {shot.sensor.grey_noise:.3g}: {longer}"
        )
    return notes


def _of_other_pixels(shot: RecordedFrame) -> list[str]:
    """Notes of a scene whose image is no part of its sensor's."""
    sensor, camera, notes = shot.sensor, shot.camera, []
    name = sensor.name or "the sensor"
    whole = sensor.width_px, sensor.height_px
    if any(most and size > most for size, most in zip(camera.size, whole, strict=True)):
        sizes = (" x ".join(map(str, size)) for size in (camera.size, whole))
        notes.append("the image has {} px, and {name} {}".format(*sizes, name=name))
    counted = shot.exposure_s is not None or shot.speckled is not None
    seen, own = camera.pixel_um, sensor.pixel_um
    if counted and seen and own and abs(seen / own - 1.0) > _SAME_PIXEL:
        notes.append(
            f"pixels are {seen:.4g} um wide in the scene, and {own:.4g} um by the data sheet of"
            f" {name}, by which photons and speckle are counted; set the scene's (-D pixel={own:g})"
        )
    return notes
