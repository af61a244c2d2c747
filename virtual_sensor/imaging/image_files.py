"""Images of cameras and of renderers as arrays: PNG, TIFF, JPEG, BMP, OpenEXR, WebP and others.

`save_png` and `save_tiff` write grey values as a camera gives them.  One image (H, W) of a file is
read by `read_image`, its grey values as the camera gave them.  `KINDS` says which files are known;
a file's content says which it is.  What the formats say:

===================================  =============================================================
another kind than the name's         used and noted
grey, RGB, palettes                  used: where colours differ one is chosen by `channel`, by the
                                     laser's wavelength, or as the line shows it, and noted
8 and 16 bits, 32- and 64-bit float  used; half, 32-bit and signed integers become floats
BitsPerSample (10, 12, 14), sBIT     used: the grey values and the level of clipping are theirs
"Camera bits" (PNG, by `save_png`)   used likewise
"virtual_sensor" (PNG, TIFF, EXR)    used: noise, gain, saturation, black level, as by
                                     `image_metadata`; and what a JSON file beside says of them
largest value (PGM, PPM, PAM)        used: the grey values and the level of clipping are theirs
PNG of 1, 2, 4 bits                  noted: spread to 0 ... 255
white is zero (TIFF)                 used and noted
planes, tiles, compression (TIFF)    used; big-endian and BigTIFF too
GDAL_NODATA                          used: missing pixels, NaN
orientation (TIFF, EXIF)             used and noted: turned as viewers show it
data window (EXR)                    used and noted: beside it pixels are missing, NaN
parts and layers (EXR)               used: `channel` is "name" or "part.name"; others are noted
further pages, frames, thumbnails    noted and ignored: the first full image is read
alpha, samples without a meaning     noted and ignored
gamma, colour profiles               noted and ignored
MaxSampleValue                       noted and ignored: it may be the image's own
pixels that are not square (EXR)     noted and ignored
loss (JPEG, WebP, AVIF, in TIFF)     noted; so are colours of fewer pixels (JPEG); pixels count as
                                     clipped from where they pile up
CMYK, YCbCr (TIFF), Bayer mosaics    refused, as are volumes, complex and 64-bit integers
deep, subsampled channels (EXR)      refused
more than 179 million pixels         refused; truncated and damaged files as well
===================================  =============================================================
"""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from dataclasses import asdict, dataclass, field, fields, replace
from io import BytesIO
from pathlib import Path
from typing import Any

import cv2
import numpy as np
import tifffile
from numpy.typing import ArrayLike, NDArray
from PIL.PngImagePlugin import putchunk

from virtual_sensor.arrays import (
    LARGEST,
    SMALLEST,
    number_within,
    truth_of,
    unmasked,
    whole_number,
)
from virtual_sensor.calls import public
from virtual_sensor.devices.image_sensor import ImageSensor
from virtual_sensor.display import Displayed, listed, span
from virtual_sensor.errors import InputError, few, naming, short
from virtual_sensor.files import exists, path_of, readable, written_whole
from virtual_sensor.imaging.image_formats import (
    CAMERA_BITS,
    ENDINGS,
    KINDS,
    StoredImage,
    Wanted,
    kind_of,
    read_stored,
)
from virtual_sensor.imaging.image_metadata import (
    BITS,
    KEY,
    bits_of,
    detector_options_of,
    read_sidecar,
    sidecar_of,
    text_of,
)
from virtual_sensor.imaging.line_colours import colour_at

_MOST_NAMES = 5  # of files in a note
_FEWEST_BITS = 8  # of a camera whose grey values lie at the top of 16
_PILE, _PILED = 240, 3.0  # from there on clipped pixels pile up, so much higher than usual
_BELOW_PILE, _ABOVE_PILE = slice(150, 220), 10  # where the usual number lies, and that pile ends
_TOPS = {2.0**bits - 1.0: bits for bits in (10, 12, 14)}  # where cameras clip, in files of 16
_USUAL_BITS = 12
_EXPOSED = 0.9  # of the grey values is where the brightest pixel lies, unless a white is given
_PNG_HEADER = 33  # bytes before the first chunk that may describe the image
_TURNS: dict[int, Callable[[NDArray], NDArray]] = {
    1: lambda a: a,
    2: lambda a: a[:, ::-1],
    3: lambda a: a[::-1, ::-1],
    4: lambda a: a[::-1],
    5: lambda a: a.T,
    6: lambda a: a[::-1].T,
    7: lambda a: a[::-1, ::-1].T,
    8: lambda a: a[:, ::-1].T,
}


@dataclass(frozen=True)
class Image(Displayed):
    """An image as a detector wants it.

    Attributes
    ----------
    pixels : ndarray of shape (H, W)
        uint8, uint16, float32 or float64; NaN where a pixel is missing.
    largest : float or None
        Grey value at which the camera clips, as far as the file says; None for floats.
    notes : tuple of str
        What was converted, assumed or left out, each with the file's name first.
    detector_options : dict
        What the file says of the grey values: noise, gain, saturation, black, as far as it does.
        `line_centres` and codecs heed it.
    metadata : dict
        All that it says: see `image_metadata`.
    channel : str or None
        That was read, of several that differ.
    """

    pixels: NDArray
    largest: float | None
    notes: tuple[str, ...] = ()
    detector_options: dict[str, float] = field(default_factory=dict)
    metadata: dict[str, Any] = field(default_factory=dict, repr=False)
    channel: str | None = None

    def _line(self) -> str:
        height, width = self.pixels.shape
        most = f"clips at {self.largest:g}" if self.largest else ""
        return listed(f"{width} x {height} px", f"{self.pixels.dtype}", span("", self.pixels), most)

    def __array__(self, dtype: Any = None, copy: bool | None = None) -> NDArray:
        """The pixels, wherever an array is asked for."""
        return np.array(self.pixels, dtype) if copy else np.asarray(self.pixels, dtype)

    @property
    def sensor(self) -> ImageSensor | None:
        """That made the grey values, if the file says which, and they are still its own."""
        said = self.metadata.get("sensor")
        if not (self.detector_options and isinstance(said, dict)):
            return None
        known = {each.name for each in fields(ImageSensor)}
        try:
            return ImageSensor(**{name: value for name, value in said.items() if name in known})
        except InputError:
            return None

    @property
    def linear_grey(self) -> Image:
        """What detectors are given: grey values in proportion to the light, without a knee-point.

        Those that are, are the image itself.
        """
        if self.sensor is None or self.sensor.knee is None:
            return self
        straight = self.sensor.linear(self.pixels, self.detector_options)
        largest = None if self.largest is None else float(self.sensor.without_knee(self.largest))
        options = dict(straight.detector_options)
        return replace(self, pixels=straight.grey, largest=largest, detector_options=options)


@public
def save_png(
    image: ArrayLike,
    path: str | Path,
    bits: int | None = None,
    *,
    white: float | None = None,
    sensor: ImageSensor | None = None,
    metadata: Mapping[str, Any] | None = None,
) -> Path:
    """Write a grey image as a PNG file, as a camera of so many bits gives it.

    Grey values of up to 8 bits are stored in 8, others in 16, at the bottom: those of 12 bits are
    0 ... 4095, as drivers of such cameras give them and `cv2.imread(path, -1)` reads them.  The
    file's text says its "Camera bits" and "White level"; `read_image` and ``virtual-sensor detect``
    know by them at which grey value the camera clips.

    Parameters
    ----------
    image : array_like of shape (H, W)
        Of integers: grey values, which are stored as they are.  Of floats, such as radiance: 0
        becomes 0 and `white` the largest grey value; brighter pixels are clipped to it.  A
        `RecordedFrame` brings its bits and metadata along.
    path : str or Path
        Ends with .png.  A file that is there is replaced.
    bits : int, optional
        From 1 to 16; by default the sensor's, else 12.
    white : float, optional
        In the image's unit; give the same for images that are to be compared.  By default no pixel
        is clipped: the brightest one gets nine tenths of the largest grey value.
    sensor : ImageSensor, optional
        That made the grey values: the file then says their noise, gain, saturation and black level.
    metadata : Mapping, optional
        What else the file is to say, for JSON.

    Returns
    -------
    Path
        Of the file.

    Raises
    ------
    InputError
        If the image has another shape, holds NaN, negative values, or integers of more bits; or the
        file can't be written.
    """
    path = path_of("save_png: path", path)
    if path.suffix.lower() != ".png":
        raise InputError(f"{path}: is no name of a PNG file; end it with .png")
    with naming("save_png"):
        stored = _to_store(image, bits, white, sensor, metadata)
        texts = {CAMERA_BITS: f"{stored.bits}", "White level": stored.level}
        if len(stored.metadata) > 1:  # the bits alone are said already
            texts[KEY] = text_of(stored.metadata)
        data = _png(stored.grey, texts)
    with written_whole(path) as temporary:
        temporary.write_bytes(data)
    return path


@public
def save_tiff(
    image: ArrayLike,
    path: str | Path,
    bits: int | None = None,
    *,
    packed: bool = False,
    white: float | None = None,
    sensor: ImageSensor | None = None,
    metadata: Mapping[str, Any] | None = None,
) -> Path:
    """Write a grey image as a TIFF file, as a camera of so many bits gives it.

    The file's ImageDescription says bits and metadata, which `read_image` and ``virtual-sensor
    detect`` know.

    Parameters
    ----------
    image : array_like of shape (H, W)
        As of `save_png`.
    path : str or Path
        Ends with .tif or .tiff.  A file that is there is replaced.
    bits, white, sensor, metadata
        As of `save_png`.
    packed : bool
        Whether pixels take as many bits as they have, one behind the other, as BitsPerSample says:
        12 bits three quarters of the room of 16.  Not all programs read that.

    Returns
    -------
    Path
        Of the file.

    Raises
    ------
    InputError
        As `save_png`.
    """
    path = path_of("save_tiff: path", path)
    if path.suffix.lower() not in (".tif", ".tiff"):
        raise InputError(f"{path}: is no name of a TIFF file; end it with .tif")
    with naming("save_tiff"):
        packed = truth_of("packed", packed)
        stored = _to_store(image, bits, white, sensor, metadata)
        text = text_of({KEY: stored.metadata, "White level": stored.level})
    with written_whole(path) as temporary:
        tifffile.imwrite(
            temporary,
            stored.grey,
            photometric="minisblack",
            metadata=None,
            description=text,
            software="virtual_sensor",
            bitspersample=stored.bits if packed else None,
        )
    return path


@dataclass(frozen=True)
class _ToStore:
    """Grey values of so many bits, in words what their largest is, and what else is to be known."""

    grey: NDArray[np.uint8] | NDArray[np.uint16]
    bits: int
    level: str
    metadata: dict[str, Any]


def _to_store(
    image: Any,
    bits: int | None,
    white: float | None,
    sensor: ImageSensor | None,
    metadata: Mapping[str, Any] | None,
) -> _ToStore:
    said: dict[str, Any] = {}
    for name, each in (("metadata", metadata), ("metadata", getattr(image, "metadata", None))):
        if isinstance(each, Mapping):
            said = {**each, **said}
        elif each is not None and each is metadata:
            raise InputError(f"{name} is {short(each)}; give a mapping of names to values")
    sensor = getattr(image, "sensor", None) if sensor is None else sensor
    if isinstance(sensor, ImageSensor):
        bits = sensor.bit_depth if bits is None else bits
        said = {**sensor.detector_options, "sensor": asdict(sensor), **said}
    elif sensor is not None:
        raise InputError(f"sensor is {short(sensor)}; give an ImageSensor, or leave it out")
    bits = whole_number("bits", _USUAL_BITS if bits is None else bits, 1, 16)
    largest = 2**bits - 1
    values = _grey_values(image)
    if values.dtype.kind == "f" and isinstance(sensor, ImageSensor):
        raise InputError(
            "sensor is of grey values, and the image holds floats; give grey_values(image, sensor)"
        )
    if values.dtype.kind in "iu":
        if white is not None:
            raise InputError(
                "white is of floats, and these integers are stored as they are; leave it out, or"
                " give image.astype(float)"
            )
        if (brightest := int(values.max())) > largest:
            raise InputError(
                f"image has grey values up to {brightest}, but {bits} bits end at {largest}; give"
                f" more bits, or np.clip(image, 0, {largest})"
            )
        level = f"{largest}, stored as it is"
    else:
        if white is None:
            white = float(values.max()) / _EXPOSED or 1.0
        white = number_within("white", white, SMALLEST, LARGEST, "a level above 0")
        with np.errstate(over="ignore"):  # far above a white that is tiny
            values = np.rint(np.minimum(values / white, 1.0) * largest)
        level = f"{largest} is {white:.9g} of the image"
    kind: type[np.uint8 | np.uint16] = np.uint8 if bits <= 8 else np.uint16
    grey: NDArray[Any] = values.astype(kind)
    return _ToStore(grey, bits, level, {**said, BITS: bits})


def _grey_values(image: ArrayLike) -> NDArray:
    """An image (H, W) of integers or floats, none of them negative or missing."""
    values = unmasked(image)
    values = values[..., 0] if values.ndim == 3 and values.shape[2] == 1 else values
    if values.dtype.kind not in "iuf":
        raise InputError(f"image is of type {values.dtype}; give grey values: integers, or floats")
    if values.ndim != 2 or not values.size:
        colours = "; of a colour image take one channel, such as image[..., 1]" * (values.ndim == 3)
        raise InputError(f"image has the shape {values.shape}; give (height, width){colours}")
    if values.dtype.kind == "f":
        values = values.astype(np.float32) if values.dtype.itemsize == 2 else values
        if missing := int(np.sum(~np.isfinite(values))):
            raise InputError(
                f"image has {missing} pixels that are NaN or infinite, which a file of grey values"
                " can't hold; give them a value, such as np.nan_to_num(image)"
            )
    if (darkest := values.min()) < 0:
        raise InputError(
            f"image has negative values, down to {darkest:g}, which a file of grey values can't"
            " hold; add a black level, or np.maximum(image, 0)"
        )
    return values


def _png(grey: NDArray, texts: Mapping[str, str]) -> bytes:
    """A PNG file's bytes: OpenCV compresses quicker than Pillow, which writes texts."""
    coded, data = cv2.imencode(".png", grey)
    if not coded:
        raise InputError(f"OpenCV can't encode an image of the shape {grey.shape}")
    described, encoded = BytesIO(), data.tobytes()
    described.write(encoded[:_PNG_HEADER])
    for name, text in texts.items():
        putchunk(described, b"tEXt", f"{name}\0{text}".encode("latin-1"))
    described.write(encoded[_PNG_HEADER:])
    return described.getvalue()


def find_images(places: Sequence[Path]) -> tuple[list[Path], tuple[str, ...]]:
    """Image files, and those that folders hold, in the order given and then by name.

    Returns
    -------
    paths : list of Path
    notes : tuple of str
        What of a folder is left out.

    Raises
    ------
    InputError
        If a place does not exist, or a folder holds no image.
    """
    found: list[Path] = []
    notes: list[str] = []
    for place in places:
        if not exists(place):
            raise InputError(f"{place}: there is no such image or folder")
        if place.is_dir():
            try:
                entries = sorted(p for p in place.iterdir() if not p.name.startswith("."))
            except OSError as error:
                raise InputError(f"{place}: can't be read ({error.strerror})") from None
            inside = [p for p in entries if is_image(p)]
            if not inside:
                raise InputError(f"{place}: holds no image; known are {', '.join(KINDS)}")
            known = {*inside, *map(sidecar_of, inside)}
            if others := [p.name for p in entries if p not in known]:
                names = few(others, _MOST_NAMES)
                notes.append(f"{place}: left out, as no images known here: {names}.")
            found += inside
        else:
            found.append(place)
    return list(dict.fromkeys(found)), tuple(notes)


def is_image(path: Path) -> bool:
    """By its content; by its name too, so that damaged ones are named."""
    if not exists(path) or not path.is_file():  # whoever opens a pipe waits for a writer
        return False
    try:
        return path.suffix.lower() in ENDINGS or kind_of(path) is not None
    except OSError:
        return False


@public
def read_image(
    path: str | Path,
    channel: str | None = None,
    bits: int | None = None,
    *,
    wavelength_nm: float | None = None,
) -> Image:
    """Read one grey image, or a colour of it: PNG, TIFF, JPEG, OpenEXR, others.

    Parameters
    ----------
    path : str or Path
        What kind of file it is, its content says, whatever its name.
    channel : str, optional
        Of a colour image: "red", "green" or "blue", or R, G, B; of an EXR file its name there, with
        "part." before it where several parts have one; of a TIFF of several samples its number.  By
        default the only one, an EXR file's "Y", or any where all colours are the same; else the
        colour in which a line stands out most, which is noted.
    bits : int, optional
        Of the camera, where the file has more and does not say so.
    wavelength_nm : float, optional
        Of the laser: its colour is read, unless `channel` names another.

    Raises
    ------
    InputError
        Naming the file and the remedy.
    """
    path = path_of("read_image: path", path)
    if bits is not None:
        bits = whole_number("read_image: bits", bits, 1, 32)
    if wavelength_nm is not None:
        with naming("read_image"):
            colour_at(wavelength_nm)
    if not readable(path).stat().st_size:
        raise InputError(f"{path}: is empty; copy it again")
    kind = kind_of(path)
    if kind is None:
        raise InputError(
            f"{path}: begins like none of {', '.join(KINDS)}; is it damaged? Else convert it to"
            " TIFF or PNG"
        )
    stored = read_stored(path, kind, Wanted(channel, wavelength_nm))
    stored = _plain(path, stored)
    stored = replace(stored, metadata=stored.metadata | (read_sidecar(path) or {}))
    stored, largest = _levelled(stored, bits)
    remarks = list(stored.remarks)
    known = _known(stored, bits, largest, remarks)
    if "saturation" in known:
        largest = min(known["saturation"], np.inf if largest is None else largest)
    turn = _TURNS.get(stored.orientation)
    if turn is None:
        remarks.append(f"its orientation, {stored.orientation}, means nothing and is not used")
    elif stored.orientation != 1:
        remarks.append(
            f"is turned as its orientation tag ({stored.orientation}) says: (u, v) are those of the"
            " turned image"
        )
    pixels = np.ascontiguousarray(turn(stored.values) if turn else stored.values)
    notes = tuple(f"{path}: {remark}." for remark in remarks)
    return Image(pixels, largest, notes, known, stored.metadata, stored.channel)


def _known(
    stored: StoredImage, bits: int | None, largest: float | None, remarks: list[str]
) -> dict[str, float]:
    """What the metadata say of the grey values, unless these have been changed since."""
    own = bits_of(stored.metadata)
    known = detector_options_of(stored.metadata, remarks)
    if not known:
        return {}
    top = 2.0**own - 1.0 if own else known.get("saturation", np.inf)
    brightest = float(np.max(stored.values, initial=0.0, where=np.isfinite(stored.values)))
    names = " and ".join([", ".join([*known][:-1]), [*known][-1]] if len(known) > 1 else known)
    if own and bits is not None and bits != own:
        remarks.append(f"says its {names} for {own} bits, not {bits}: they are not used")
        return {}
    if brightest > top:
        remarks.append(
            f"says its {names} for grey values up to {top:g}, but has {brightest:g}: was it changed"
            " since? They are not used"
        )
        return {}
    return known


def _plain(path: Path, stored: StoredImage) -> StoredImage:
    """The same with pixels of a type that detectors take: integers of others become floats."""
    values = stored.values
    values = values.astype(values.dtype.newbyteorder("="), copy=False)
    kind, size = values.dtype.kind, values.dtype.itemsize
    if kind == "u" and size <= 2:
        return replace(stored, values=values, bits=stored.bits or 8 * size)
    if kind == "f" and size <= 8:
        unfit = np.isnan(values)  # a NaN that signals would warn wherever it is converted
        values = np.where(unfit, values.dtype.type(np.nan), values)
        return replace(stored, values=values.astype(np.float32) if size == 2 else values)
    if kind in "iu" and size <= 4:
        largest_bits = 8 * size - (kind == "i")
        return replace(stored, values=values.astype(np.float64), bits=largest_bits)
    raise InputError(
        f"{path}: its pixels are {values.dtype}; save it as 8 or 16 bit, or as 32-bit float"
    )


def _levelled(stored: StoredImage, bits: int | None) -> tuple[StoredImage, float | None]:
    """Grey values on the camera's own scale, and the largest that it can give."""
    values, has = stored.values, stored.bits
    brightest = float(np.max(values, initial=0.0, where=np.isfinite(values)))
    if has is None:
        if bits is None:
            return stored, None
        if brightest <= 1.0:
            remark = f"holds floats from 0 to 1, but {bits} bits are clipped at {2**bits - 1}"
            stored = replace(stored, remarks=[*stored.remarks, f"{remark}: give --saturation"])
        return stored, 2.0**bits - 1.0
    remarks = list(stored.remarks)
    if bits is not None and bits > has:
        remarks.append(f"has {has} bits, not the {bits} that were said: clipped at {2**has - 1}")
        bits = None
    said, largest = (bits or has), 2.0 ** (bits or has) - 1.0
    if values.dtype.kind != "u":  # of more than 16 bits, or signed
        shift = 0
    elif stored.scaled:
        shift = 8 * values.dtype.itemsize - said
    else:
        shift = has - said if brightest > largest else 0
    if shift > 0 and _at_the_top(values, said, shift):
        remarks.append(f"its {said} bits lie at the top of {said + shift}: they are brought down")
        values = values >> shift
    elif brightest > largest:
        remarks.append(
            f"has grey values above {largest:.0f}, the largest of {said} bits: they count as"
            " clipped"
        )
    elif bits is None and has == 16 and brightest in _TOPS:
        likely = _TOPS[brightest]
        remarks.append(
            f"has no value above {brightest:.0f}: is it of a camera of {likely} bits? Then say"
            f" bits={likely} (--bits {likely}); now {largest:.0f} counts as clipped"
        )
    elif stored.lossy and values.dtype == np.uint8 and (level := _pile(values)):
        largest = level
        remarks.append(
            f"its brightest pixels pile up from {level:.0f} on, as where a camera clips: they count"
            " as clipped"
        )
    elif values.dtype == np.uint16 and brightest:
        low = _bits_unused(values)
        if bits is not None and low >= has - bits > 0:
            remarks.append(
                f"has multiples of {2 ** (has - bits)} only, but none above {largest:.0f}: taken as"
                f" {bits} bits at the bottom; if they lie at the top, leave --bits out"
            )
        elif bits is None and 0 < low <= has - _FEWEST_BITS:
            largest -= 2.0**low - 1.0
            if brightest == largest:
                remarks.append(
                    f"has multiples of {2**low} only, as of {has - low} bits at the top of {has}:"
                    f" clipped from {largest:.0f} on"
                )
    return replace(stored, values=values, remarks=remarks), largest


def _pile(values: NDArray[np.uint8]) -> float | None:
    """Grey value from which on pixels pile up at the top: what was 255 before a lossy codec."""
    counts = np.bincount(values.ravel(), minlength=256).astype(float)
    smooth = np.convolve(np.pad(counts, 1, "edge"), np.ones(3) / 3.0, "valid")
    mode = _PILE + int(np.argmax(smooth[_PILE:]))
    usual = max(float(np.median(counts[_BELOW_PILE])), 1.0)
    if smooth[mode] < _PILED * usual or counts[mode + _ABOVE_PILE :].sum() > usual * _ABOVE_PILE:
        return None
    level = mode
    while smooth[level - 1] > max(2.0 * usual, 0.2 * smooth[mode]):
        level -= 1
    return float(level) if level < 255 and np.any(values >= level) else None


def _at_the_top(values: NDArray, bits: int, shift: int) -> bool:
    """Whether grey values are of so many bits, shifted up or multiplied to fill all of them."""
    down = (values >> shift).astype(np.float64)
    full = down * ((2.0 ** (bits + shift) - 1.0) / (2.0**bits - 1.0))
    return bool(
        np.array_equal(values >> shift << shift, values) or np.abs(values - full).max() <= 1.0
    )


def _bits_unused(values: NDArray) -> int:
    """How many of the lowest bits are nowhere set."""
    used = int(np.bitwise_or.reduce(values, axis=None))
    return (used & -used).bit_length() - 1
