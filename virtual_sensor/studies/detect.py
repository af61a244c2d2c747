"""Line centres in images that users bring, and points where they bring a calibration too."""

import time
from collections.abc import Callable, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from virtual_sensor.errors import InputError
from virtual_sensor.imaging.image_files import read_image
from virtual_sensor.metrology.calibration import Calibration
from virtual_sensor.metrology.centres import LineCentres, Status
from virtual_sensor.metrology.detectors import STEGER
from virtual_sensor.metrology.line_peaks import ALONG, line_centres
from virtual_sensor.metrology.triangulation import triangulate

Array = NDArray[np.float64]

_FEW, _SOME = 0.5, 0.1  # of the columns or rows


@dataclass(frozen=True)
class Detected:
    """One image and what was found in it.

    Attributes
    ----------
    path : Path
    image : ndarray of shape (H, W)
    line : LineCentres
    points_mm : ndarray of shape (..., 3) or None
        World, NaN where there is no centre; None without a calibration.
    seconds : float
        That the detector took.
    """

    path: Path
    image: NDArray
    line: LineCentres
    points_mm: Array | None
    seconds: float

    @property
    def counts(self) -> dict[str, int]:
        """How many centres have each status."""
        status = self.line.status
        return {s.name.lower(): int(np.sum(status == s)) for s in Status if np.any(status == s)}


def detect(
    paths: Sequence[Path],
    method: str,
    options: dict[str, Any],
    channel: str | None,
    calibration: Calibration | None,
    each: Callable[[Detected, int], None],
    bits: int | None = None,
) -> tuple[str, ...]:
    """Find the line in each image, and hand over what was found, and its number.

    Parameters
    ----------
    paths : sequence of Path
        Images: see `find_images`.
    method : str
        The detector.
    options : dict
        For `line_centres`.  `saturation` is no more than the image's file allows.
    channel : str or None
        See `read_image`.
    calibration : Calibration or None
    each : callable
        Takes each result; none is kept.
    bits : int, optional
        See `read_image`.

    Returns
    -------
    notes : tuple of str
        What was converted, assumed or left out; each is given once for all images that it is of.

    Raises
    ------
    InputError
        Naming the image that can't be read, or is not of the calibration's size.
    """
    said: dict[str, list[Path]] = {}
    for number, path in enumerate(paths):
        read = read_image(path, channel, bits)
        image = read.pixels
        if calibration and image.shape != calibration.camera.size[::-1]:
            width, height = calibration.camera.size
            raise InputError(
                f"{path}: is {image.shape[1]} x {image.shape[0]} px, but the calibration is of"
                f" {width} x {height} px; take the one that belongs to it"
            )
        here = dict(options)
        asked = here.get("saturation")
        if read.largest is not None:
            here["saturation"] = read.largest if asked is None else min(asked, read.largest)
        began = time.perf_counter()
        line = line_centres(image, method, **here)
        seconds = time.perf_counter() - began
        points = triangulate(calibration, line.pixel) if calibration else None
        each(Detected(path, image, line, points, seconds), number)
        remarks = [note.removeprefix(f"{path}: ") for note in read.notes]
        if asked is not None and here["saturation"] < asked:
            remarks.append(f"can't reach a saturation of {asked:g}: taken as {read.largest:g}.")
        other = next(way for way in ALONG if way != options.get("along", "columns"))
        if method != STEGER and _lies_across(image, line, here | {"along": other}):
            remarks.append(f"shows its line along the {other}: give --along {other}.")
        for remark in remarks:
            said.setdefault(remark, []).append(path)
    return tuple(
        f"{first}{f' and {len(others)} more' if others else ''}: {remark}"
        for remark, (first, *others) in said.items()
    )


def _lies_across(image: NDArray, line: LineCentres, options: dict[str, Any]) -> bool:
    """Whether few columns show a line, found or clipped, but with other options twice as many."""
    here = _share(line)
    return here < _FEW and _share(line_centres(image, **options)) > max(2.0 * here, _SOME)


def _share(line: LineCentres) -> float:
    """Of the columns, or rows, those that show a line."""
    shows = (line.status == Status.OK) | (line.status == Status.SATURATED)
    return float(np.mean(shows)) if shows.size else 0.0
