"""Line centres in images that users bring, and points where they bring a calibration too."""

from __future__ import annotations

import time
from collections.abc import Iterable, Iterator, Mapping, Sequence
from dataclasses import dataclass, fields, replace
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from virtual_sensor.display import Displayed
from virtual_sensor.errors import InputError
from virtual_sensor.imaging.dark_images import find_dark, without_other_light
from virtual_sensor.imaging.image_files import Image, read_image
from virtual_sensor.imaging.line_colours import COLOURS
from virtual_sensor.metrology.calibration import Calibration
from virtual_sensor.metrology.centres import LineCentres, Status
from virtual_sensor.metrology.detectors import STEGER
from virtual_sensor.metrology.line_peaks import line_centres
from virtual_sensor.metrology.triangulation import triangulate
from virtual_sensor.records import Record, Table, counts_of, status_names

Array = NDArray[np.float64]

_FEW, _SOME = 0.5, 0.1  # of the columns or rows
_LOST = 0.02  # of them: if more are saturated, other colours are looked at


@dataclass(frozen=True)
class Settings(Record):
    """How the line is sought: see `line_centres` and `read_image`.

    Attributes
    ----------
    detector : str
        Its name.
    along : str
        "columns", which the line crosses where it lies flat, "rows", or "auto": which show more of
        it.
    peaks : int
        Sought in each column or row, the line first.
    choose : str
        What is the line, of several peaks: "path", which continues best, or "highest".
    channel : str or None
        Of a colour image; None: that of the wavelength, or the one in which the line stands out.
    wavelength_nm : float or None
        Of the laser, for the colour that is read.
    bits : int or None
        Of the camera, where the file has more.
    saturation : float or None
        Grey value from which on pixels are clipped; None: as the file says.
    noise : float or None
        Standard deviation of dark grey values; None: as the file says, else as the image shows.
    gain : float
        Grey values per electron, for the shot noise; 0: as the file says, else none.
    min_amplitude : float
        Smallest height of a line, relative to the highest of the image.
    max_width_px : float
        Broadest line, standard deviation.
    """

    detector: str = "gaussian"
    along: str = "auto"
    peaks: int = 1
    choose: str = "path"
    channel: str | None = None
    wavelength_nm: float | None = None
    bits: int | None = None
    saturation: float | None = None
    noise: float | None = None
    gain: float = 0.0
    min_amplitude: float = 0.01
    max_width_px: float = 32.0

    def knowing(self, known: Mapping[str, float]) -> tuple[Settings, tuple[str, ...]]:
        """The settings with what a file says of its grey values, and a remark on it."""
        asked = {"noise": self.noise, "gain": self.gain or None}
        used: dict[str, Any] = {
            name: known[name] for name in asked if asked[name] is None and name in known
        }
        if not used:
            return self, ()
        words = " and ".join(f"{name} {value:.4g}" for name, value in used.items())
        return replace(self, **used), (f"says that it has {words}, which are used.",)

    def centres(self, image: NDArray) -> LineCentres:
        """Find the line in an image (H, W).

        Raises
        ------
        InputError
            If a setting is out of its range.
        """
        return line_centres(
            image,
            self.detector,
            along=self.along,
            peaks=self.peaks,
            choose=self.choose,
            saturation=self.saturation,
            noise=self.noise,
            gain=self.gain,
            min_amplitude=self.min_amplitude,
            max_sigma=self.max_width_px,
        )


@dataclass(frozen=True)
class CentreTable(Table):
    """Line centres, one in a row; with several peaks, peak by peak.

    Attributes
    ----------
    peak : ndarray of int or None
        0 is the line; None where only one is sought.
    found : ndarray of int
        1 where there is a centre of the line; 0 where it is missing, or a ghost's.
    column_px, row_px : ndarray
        (u, v), integers at pixel centres; nothing where there is no centre; of
        a "ghost", where that light is.
    sigma_px : ndarray
        Standard deviation of the centre that the detector predicts.
    width_px : ndarray
        Standard deviation of the line's profile.
    amplitude, background : ndarray
        Height of the profile above its background, and that, in grey values.
    normal_deg : ndarray
        Direction in which the centre was sought, from +u towards +v.
    status : ndarray of str
        Why there is a centre ("ok", "clipped", "corrected"), or none.
    point_mm : ndarray of shape (N, 3) or None
        Triangulated, world; None without a calibration.
    """

    peak: NDArray[np.intp] | None
    found: NDArray[np.uint8]
    column_px: Array
    row_px: Array
    sigma_px: Array
    width_px: Array
    amplitude: Array
    background: Array
    normal_deg: Array
    status: NDArray[np.str_]
    point_mm: Array | None

    @classmethod
    def of(cls, line: LineCentres, points_mm: Array | None = None) -> CentreTable:
        """The table of a line, and of its points (..., 3)."""
        peaks = line.status.shape[0] if line.status.ndim > 1 else None
        return cls(
            peak=None if peaks is None else np.repeat(np.arange(peaks), line.status.shape[1]),
            found=np.ravel(line.found).astype(np.uint8),
            column_px=np.ravel(line.column),
            row_px=np.ravel(line.row),
            sigma_px=np.ravel(line.sigma),
            width_px=np.ravel(line.width),
            amplitude=np.ravel(line.amplitude),
            background=np.ravel(line.background),
            normal_deg=np.ravel(line.normal_deg),
            status=status_names(line.status, Status),
            point_mm=None if points_mm is None else points_mm.reshape(-1, 3),
        )


@dataclass(frozen=True)
class ImageSummary(Record):
    """What was found in an image.

    Attributes
    ----------
    file : Path
        Its path.
    columns, rows : int
        Of the image.
    along : str or None
        What was searched, "columns" or "rows"; None of lines of any direction.
    centres : int
        That were found.
    median_sigma_px : float
        Of the standard deviations that the detector predicts for them.
    median_width_px : float
        Of the line's profile, standard deviation.
    time_s : float
        That the detector took.
    statuses : dict of str to int
        How many columns, rows or points have each status; only those that occur.
    """

    file: Path
    columns: int
    rows: int
    along: str | None
    centres: int
    median_sigma_px: float
    median_width_px: float
    time_s: float
    statuses: dict[str, int]


@dataclass(frozen=True)
class Detected(Displayed):
    """One image and what was found in it.

    Attributes
    ----------
    path : Path
    image : ndarray of shape (H, W)
    line : LineCentres
    points_mm : ndarray of shape (..., 3) or None
        World, NaN where there is no centre; None without a calibration.
    time_s : float
        That the detector took.
    remarks : tuple of str
        What was converted, assumed or left out, without the image's name.
    """

    path: Path
    image: NDArray
    line: LineCentres
    points_mm: Array | None
    time_s: float
    remarks: tuple[str, ...] = ()

    def _line(self) -> str:
        return f"{self.path.name}, {self.line._line()}"

    def _columns(self) -> dict[str, NDArray[Any]]:
        return self.centres.columns()

    @property
    def centres(self) -> CentreTable:
        """The centres as a table."""
        return CentreTable.of(self.line, self.points_mm)

    @property
    def summary(self) -> ImageSummary:
        """Counts, medians and the time."""
        counts = counts_of(self.line.status, Status, occurring=True)
        found = self.line.found
        return ImageSummary(
            file=self.path,
            columns=self.image.shape[1],
            rows=self.image.shape[0],
            along=_along(self.line),
            centres=int(found.sum()),
            median_sigma_px=_median(self.line.sigma[found]),
            median_width_px=_median(self.line.width[found]),
            time_s=self.time_s,
            statuses=counts,
        )


@dataclass(frozen=True)
class Skipped(Displayed):
    """An image that can't be used, and why, without its name."""

    path: Path
    reason: str


def detect(
    paths: Sequence[Path],
    settings: Settings,
    calibration: Calibration | None = None,
    dark: Path | None = None,
) -> Iterator[Detected | Skipped]:
    """Find the line in each image, one after the other; of several those that can be read.

    Parameters
    ----------
    paths : sequence of Path
        Images: see `find_images`.
    settings : Settings
        `saturation` is taken as no more than an image's file allows.
    calibration : Calibration, optional
        With it there are points.
    dark : Path, optional
        An image of the same scene with the laser off, which is subtracted from each; or a folder
        that has one of each image's name.

    Raises
    ------
    InputError
        Naming the image, if none can be read, or is of the calibration's size, or has a dark frame
        like it; or a setting that is out of its range.
    """
    darks = find_dark(dark, paths) if dark else None
    skipped: list[Skipped] = []
    for path in paths:
        try:
            image = _read(path, settings, calibration, darks)
        except InputError as error:
            skipped.append(Skipped(path, f"{error}".removeprefix(f"{path}: ")))
            if len(skipped) == len(paths):
                more = len(paths) - 1
                others = f"the other {more} images" if more > 1 else "the other image"
                others = f"; nor can {others} be used" if more else ""
                raise InputError(f"{path}: {skipped[-1].reason}{others}") from None
            yield skipped[-1]
        else:
            yield _detected(path, image, settings, calibration, darks)


def _read(
    path: Path,
    settings: Settings,
    calibration: Calibration | None,
    darks: Mapping[Path, Path] | None,
) -> Image:
    """An image, without other light than the laser's if there are dark frames."""
    image = read_image(
        *(path, settings.channel, settings.bits), wavelength_nm=settings.wavelength_nm
    )
    if calibration and image.pixels.shape != calibration.camera.size[::-1]:
        width, height = calibration.camera.size
        raise InputError(
            f"{path}: is {image.pixels.shape[1]} x {image.pixels.shape[0]} px, but the calibration"
            f" is of {width} x {height} px; take the one that belongs to it"
        )
    if darks is None:
        return image
    if path not in darks:
        raise InputError(f"{path}: has no dark frame of its name; add it, or give one for all")
    if darks[path].samefile(path):
        raise InputError(f"{path}: is its own dark frame; give one with the laser off")
    off = read_image(darks[path], settings.channel or image.channel, settings.bits)
    return without_other_light(image, off)


def _known(path: Path, read: Image, settings: Settings) -> tuple[Settings, list[str]]:
    """The settings with what an image says, and remarks on it."""
    remarks = [note.removeprefix(f"{path}: ") for note in read.notes]
    here, said = settings.knowing(read.detector_options)
    remarks += said
    straight = read.linear_grey
    if read.largest is not None:
        asked = settings.saturation
        least = read.largest if asked is None else min(asked, read.largest)
        here = replace(here, saturation=least)
        if asked is not None and least < asked:
            remarks.append(f"can't reach a saturation of {asked:g}: taken as {read.largest:g}.")
    if straight is not read:
        remarks.append("has a knee-point: grey values beyond it are stretched back.")
        if here.saturation is not None and read.sensor:
            here = replace(here, saturation=float(read.sensor.without_knee(here.saturation)))
    return here, remarks


def _with_other_colours(
    path: Path,
    read: Image,
    settings: Settings,
    darks: Mapping[Path, Path] | None,
    line: LineCentres,
) -> tuple[LineCentres, list[str]]:
    """Where the colour that was chosen is clipped too far for a centre, that of another one."""
    said: list[str] = []
    chosen = settings.channel is None and settings.wavelength_nm is None
    if not chosen or settings.peaks > 1 or settings.detector == STEGER:
        return line, said
    for colour in COLOURS if read.channel in COLOURS else ():
        lost = line.status == Status.SATURATED
        if colour == read.channel or np.mean(lost) < _LOST:
            continue
        asked = replace(settings, channel=colour, along=line.searched[0])
        image = _read(path, asked, None, darks)
        other = _known(path, image, asked)[0].centres(image.linear_grey.pixels)
        better = lost & other.found
        if better.any():
            names = (each.name for each in fields(line))
            line = replace(
                line, **{n: np.where(better, getattr(other, n), getattr(line, n)) for n in names}
            )
            said.append(
                f"has {better.sum()} centres of its {colour} channel, where the {read.channel} one"
                f" is clipped too far: --channel {read.channel} leaves them out."
            )
    return line, said


def _detected(
    path: Path,
    read: Image,
    settings: Settings,
    calibration: Calibration | None,
    darks: Mapping[Path, Path] | None,
) -> Detected:
    """What is found in an image."""
    here, remarks = _known(path, read, settings)
    straight = read.linear_grey
    began = time.perf_counter()
    line = here.centres(straight.pixels)
    line, said = _with_other_colours(path, read, settings, darks, line)
    remarks += said
    time_s = time.perf_counter() - began
    other = {"columns": "rows", "rows": "columns"}.get(here.along)
    if (
        other
        and here.detector != STEGER
        and _lies_across(straight.pixels, line, replace(here, along=other))
    ):
        remarks.append(f"shows its line along the {other}: give --along {other}.")
    points = triangulate(calibration, line.pixel) if calibration else None
    return Detected(path, read.pixels, line, points, time_s, tuple(remarks))


def joined_notes(remarks: Iterable[tuple[Path, Sequence[str]]]) -> tuple[str, ...]:
    """The remarks on all images, each once, with the names of the images that it is of."""
    images: dict[str, list[Path]] = {}
    for path, texts in remarks:
        for text in texts:
            images.setdefault(text, []).append(path)
    return tuple(
        f"{first}{f' and {len(others)} more' if others else ''}: {text}"
        for text, (first, *others) in images.items()
    )


def _lies_across(image: NDArray, line: LineCentres, other: Settings) -> bool:
    """Whether few columns show a line, found or clipped, but with other settings twice as many."""
    here = _share(line)
    return here < _FEW and _share(other.centres(image)) > max(2.0 * here, _SOME)


def _along(line: LineCentres) -> str | None:
    """What was searched for a line that lies flat, or stands; None of one of any direction."""
    along, count = line.searched
    return along if count else None


def _share(line: LineCentres) -> float:
    """Of the columns, or rows, those that show a line."""
    shows = line.found | (line.status == Status.SATURATED)
    return float(np.mean(shows)) if shows.size else 0.0


def _median(values: NDArray[Any]) -> float:
    """Of those that are known; NaN if there are none."""
    known = values[np.isfinite(values)]
    return float(np.median(known)) if known.size else np.nan
