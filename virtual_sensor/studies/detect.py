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
from virtual_sensor.metrology.line_peaks import line_centres
from virtual_sensor.metrology.triangulation import triangulate

Array = NDArray[np.float64]


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
) -> None:
    """Find the line in each image, and hand over what was found, and its number.

    Parameters
    ----------
    paths : sequence of Path
        Images: see `find_images`.
    method : str
        The detector.
    options : dict
        For `line_centres`.
    channel : str or None
        See `read_image`.
    calibration : Calibration or None
    each : callable
        Takes each result; none is kept.

    Raises
    ------
    InputError
        Naming the image that can't be read, or is not of the calibration's size.
    """
    for number, path in enumerate(paths):
        image = read_image(path, channel)
        if calibration and image.shape != calibration.camera.size[::-1]:
            width, height = calibration.camera.size
            raise InputError(
                f"{path}: is {image.shape[1]} x {image.shape[0]} px, but the calibration is of"
                f" {width} x {height} px; take the one that belongs to it"
            )
        began = time.perf_counter()
        line = line_centres(image, method, **options)
        seconds = time.perf_counter() - began
        points = triangulate(calibration, line.pixel) if calibration else None
        each(Detected(path, image, line, points, seconds), number)
