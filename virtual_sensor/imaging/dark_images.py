"""Images with the laser on, free of all other light by one of the same scene with the laser off."""

from __future__ import annotations

import math
from collections.abc import Iterator, Mapping, Sequence
from dataclasses import replace
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from virtual_sensor.errors import InputError
from virtual_sensor.imaging.image_files import Image, find_images

_SETTINGS = {"exposure_s": "s", "iso_speed": ""}  # of a camera, that metadata or EXIF say
_SAME = 0.02  # of an exposure: cameras round it
_DARKEST = 5.0  # percentile, which is nearly black in many scenes
_BRIGHT = 0.5  # of the dark frame's own light, from which on pixels are compared
_LEAST, _NOISES = 100, 8.0  # such pixels, and so far above the noise
_ALIKE = 0.1  # of the light


def find_dark(place: Path, paths: Sequence[Path]) -> dict[Path, Path]:
    """Of each image its dark frame: one file for all, or that of its name in a folder.

    An image for which a folder has none is left out.

    Raises
    ------
    InputError
        If the place does not exist, or is a folder without an image.
    """
    found, _ = find_images([place])
    if len(found) == 1:
        return dict.fromkeys(paths, found[0])
    by_name, by_stem = ({getattr(each, key): each for each in found} for key in ("name", "stem"))
    darks = {path: by_name.get(path.name, by_stem.get(path.stem)) for path in paths}
    return {path: dark for path, dark in darks.items() if dark is not None}


def without_other_light(on: Image, off: Image) -> Image:
    """An image with the laser on minus one with it off.

    Returns
    -------
    Image
        Of float32, negative pixels too.  Where it is clipped it is at `largest`; where the other
        light alone is, nothing is known (NaN).  The noise, if it is known, is that of both.  Its
        notes say where they don't go together.

    Raises
    ------
    InputError
        If they are one and the same, or differ in size, or in what their files say of the exposure.
    """
    if on.pixels.shape != off.pixels.shape:
        here, there = (f"{each.pixels.shape[1]} x {each.pixels.shape[0]} px" for each in (on, off))
        raise InputError(f"is {here}, but its dark frame is {there}; take both alike")
    for name, unit in _SETTINGS.items():
        said = [each.metadata.get(name) for each in (on, off)]
        values = [float(value) for value in said if isinstance(value, int | float)]
        if len(values) == 2 and not math.isclose(*values, rel_tol=_SAME):
            here, there = (f"{value:.4g} {unit}".strip() for value in values)
            raise InputError(
                f"says its {name.removesuffix('_s').replace('_', ' ')} is {here}, but its dark"
                f" frame's {there}; take both alike, without the camera's automatic exposure"
            )
    if np.array_equal(on.pixels, off.pixels):
        raise InputError("is the same image as its dark frame; give one with the laser off")
    one, other = on.linear_grey, off.linear_grey
    light, dark = (each.pixels.astype(np.float32) for each in (one, other))
    white = min((each.largest for each in (one, other) if each.largest is not None), default=None)
    pixels = light - dark
    if white is not None:
        pixels[light >= white] = white
        pixels[dark >= white] = np.nan  # else a lamp's glare would be a clipped line
    return replace(
        on,
        pixels=pixels,
        largest=white,
        notes=(*on.notes, *_doubts(light, dark)),
        detector_options=_of_both(one.detector_options, other.detector_options, white, dark),
        metadata={name: value for name, value in on.metadata.items() if name != "sensor"},
    )


def _of_both(
    on: Mapping[str, float],
    off: Mapping[str, float],
    white: float | None,
    dark: NDArray[np.float32],
) -> dict[str, float]:
    """What detectors are to know of the difference: the noise of both, and of the other light."""
    known = {"gain": on["gain"]} if "gain" in on else {}
    if white is not None:
        known["saturation"] = white
    if "noise" in on:
        other = max(float(np.nanmedian(dark)) - on.get("black", 0.0), 0.0)
        squares = on["noise"] ** 2 + off.get("noise", on["noise"]) ** 2
        known["noise"] = math.sqrt(squares + 2.0 * other * on.get("gain", 0.0))
    return known


def _doubts(light: NDArray[np.float32], dark: NDArray[np.float32]) -> Iterator[str]:
    """Whether two images are of one scene, where the dark one is bright."""
    floor, own_floor = (float(np.nanpercentile(each, _DARKEST)) for each in (light, dark))
    noise = max(float(np.nanmedian(np.abs(np.diff(dark, axis=1)))), 0.5)
    own = dark - own_floor
    bright = own > max(_BRIGHT * float(np.nanpercentile(own, 99.0)), _NOISES * noise)
    if np.count_nonzero(bright) < _LEAST:
        return
    ratio = float(np.nanmedian((light[bright] - floor) / own[bright]))
    if abs(ratio - 1.0) > _ALIKE:
        yield (
            f"the image has {ratio:.2g} times the light of its dark frame, where that is brightest:"
            " exposure or other light changed in between, and a part of it is left."
        )
