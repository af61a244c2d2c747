"""The lines of a scene's sources in one image of one camera, separated."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import cv2
import numpy as np
from numpy.typing import ArrayLike, NDArray

from virtual_sensor.arrays import number_within
from virtual_sensor.calls import public
from virtual_sensor.devices.projector import Projector
from virtual_sensor.errors import InputError
from virtual_sensor.imaging.render import lit_pixels
from virtual_sensor.imaging.scene import Scene
from virtual_sensor.metrology.bands import lines_in_bands
from virtual_sensor.metrology.centres import LineCentres
from virtual_sensor.metrology.detectors import Foreign
from virtual_sensor.metrology.line_profiles import checked_image
from virtual_sensor.optics.sight import scene_of

MARGIN_PX = 2.0


@public
def lines_by_source(
    scene: Scene | str | Path,
    image: ArrayLike,
    method: str | Foreign = "gaussian",
    *,
    camera: str | None = None,
    margin_px: float = MARGIN_PX,
    **options: Any,
) -> dict[str, LineCentres]:
    """Find the line of each source where the scene expects its light, through its air.

    Parameters
    ----------
    scene : Scene, str or Path
        With any number of sources; or its name or path.
    image : array_like of shape (H, W)
        Of one of its cameras: rendered, or recorded.
    camera : str, optional
        Its name; it can be left out where the scene has one.
    margin_px : float
        By so much the image may differ from the scene: by the lens's blur, a part or a pose that is
        known to so much.
    method, **options
        See `line_centres`.  `choose` is "highest", unless it is given: the scene tells which light
        is the line's.

    Returns
    -------
    dict from str to LineCentres
        By the sources' names.  Columns in which the light of two meets are OVERLAPPING: a laser's
        line is lit out to 2.5 of its 1/e^2 radii on both sides, and `margin_px` is added to both.

    Raises
    ------
    InputError
        If the scene has several cameras and none is named, or a projector, the image is not of its
        size, or as `line_centres` does.
    """
    seen = scene_of("lines_by_source", scene).only(camera=camera)
    if projectors := [n for n, each in seen.sources.items() if isinstance(each, Projector)]:
        raise InputError(
            f"lines_by_source: {', '.join(projectors)} lights a surface, and lines on it are not"
            " told from it; give a scene with laser lines alone, or decode fringes"
        )
    number_within("lines_by_source: margin_px", margin_px, 0.0, 1e3, "px, 0 or more")
    (width, height), shape = seen.camera.size, checked_image(image).shape
    if shape != (height, width):
        raise InputError(
            f"lines_by_source: the image is of shape {shape}, the camera's of {(height, width)};"
            " give its image, or load the scene with the image's width and height"
        )
    bands = expected_light(seen, margin_px)
    return lines_in_bands(image, bands, method, **options)


def expected_light(scene: Scene, margin_px: float = MARGIN_PX) -> dict[str, NDArray[np.bool_]]:
    """By source, the pixels (H, W) of the scene's camera that it lights, and those near them."""
    width, height = scene.camera.size
    truth = lit_pixels(scene)
    across = 2 * int(np.ceil(margin_px)) + 1
    near = cv2.getStructuringElement(cv2.MORPH_ELLIPSE, (across, across))
    bands = {}
    for name, coordinates in truth.source_coordinates.items():
        lit = np.zeros(height * width, np.uint8)
        lit[truth.index] = np.isfinite(coordinates[:, 0])
        bands[name] = cv2.dilate(lit.reshape(height, width), near).astype(bool)
    return bands
