"""Images of cameras and of renderers as arrays: PNG, TIFF, BMP and OpenEXR."""

from collections.abc import Sequence
from pathlib import Path

import cv2
import numpy as np
import OpenEXR
from numpy.typing import NDArray

from virtual_sensor.errors import InputError

ENDINGS = (".png", ".tif", ".tiff", ".bmp", ".exr")
COLOURS = ("blue", "green", "red")  # in OpenCV's order

_PNG_END = b"IEND\xaeB`\x82"


def find_images(places: Sequence[Path]) -> list[Path]:
    """Image files, and those that folders hold, in the order given and then by name.

    Raises
    ------
    InputError
        If a place does not exist, or a folder holds no image.
    """
    found: list[Path] = []
    for place in places:
        if place.is_dir():
            inside = sorted(p for p in place.iterdir() if p.suffix.lower() in ENDINGS)
            if not inside:
                raise InputError(f"{place}: holds no image; known are {', '.join(ENDINGS)}")
            found += inside
        elif place.is_file():
            found.append(place)
        else:
            raise InputError(f"{place}: there is no such image or folder")
    return list(dict.fromkeys(found))


def read_image(path: Path, channel: str | None = None) -> NDArray:
    """Read one grey channel (H, W): uint8, uint16, float32 or float64.

    Parameters
    ----------
    path : Path
    channel : str, optional
        Of a colour image: "red", "green" or "blue", of an EXR file its name there.  By default the
        only one, an EXR file's "Y", or any where all colours are the same.

    Raises
    ------
    InputError
        Naming the file and the remedy.
    """
    if path.suffix.lower() not in ENDINGS:
        raise InputError(f"{path}: is none of {', '.join(ENDINGS)}; convert it to TIFF or PNG")
    image = _exr(path, channel) if path.suffix.lower() == ".exr" else _picture(path, channel)
    if image.dtype not in (np.uint8, np.uint16, np.float32, np.float64):
        raise InputError(
            f"{path}: its pixels are {image.dtype}; save it as 8 or 16 bit, or as 32-bit float"
        )
    return image


def _picture(path: Path, channel: str | None) -> NDArray:
    try:
        data = path.read_bytes()
    except OSError as error:
        raise InputError(f"{path}: can't be read ({error.strerror})") from None
    # OpenCV fills what is missing of a PNG with black, and says so to the terminal only.
    if path.suffix.lower() == ".png" and not data.rstrip(b"\0").endswith(_PNG_END):
        raise InputError(f"{path}: is not a whole PNG file; copy it again")
    level = cv2.utils.logging.getLogLevel()
    cv2.utils.logging.setLogLevel(cv2.utils.logging.LOG_LEVEL_SILENT)
    try:
        image = cv2.imdecode(np.frombuffer(data, np.uint8), cv2.IMREAD_UNCHANGED) if data else None
    except cv2.error:
        image = None
    finally:
        cv2.utils.logging.setLogLevel(level)
    if image is None:
        raise InputError(f"{path}: can't be decoded; is it whole, and what its name says?")
    if image.ndim == 2:
        return image
    colours = image[:, :, :3]  # without an alpha channel
    if channel is None:
        if colours.shape[2] < 3 or (colours == colours[:, :, :1]).all():
            return colours[:, :, 0]
        raise InputError(f"{path}: is a colour image; say which --channel: red, green or blue")
    if channel not in COLOURS:
        raise InputError(f"{path}: has no channel '{channel}'; take red, green or blue")
    return colours[:, :, COLOURS.index(channel)]


def _exr(path: Path, channel: str | None) -> NDArray:
    try:
        with OpenEXR.File(str(path), separate_channels=True) as file:
            channels = {name: np.array(held.pixels) for name, held in file.channels().items()}
    except (RuntimeError, OSError, ValueError) as error:
        raise InputError(f"{path}: can't be read as OpenEXR ({str(error).strip()})") from None
    letters = {colour[0].upper(): colour for colour in COLOURS}
    named = {letters.get(name, name): values for name, values in channels.items()}
    if channel is None:
        channel = next((n for n in ("Y", *named) if n in named), "")
        if len(named) > 1 and channel != "Y":
            raise InputError(f"{path}: say which --channel: {', '.join(named)}")
    if channel not in named:
        raise InputError(f"{path}: has no channel '{channel}'; it has {', '.join(named) or 'none'}")
    values = named[channel]
    return values.astype(np.float32) if values.dtype == np.float16 else values
