"""One channel of an image file as the file stores it, and what the file says of it.

`image_files` says which features of each format are heeded.
"""

import logging
import math
import os
import re
import warnings
from collections.abc import Iterator, Sequence
from contextlib import contextmanager, redirect_stdout
from dataclasses import dataclass, field
from io import BytesIO, StringIO
from pathlib import Path
from typing import Any

import cv2
import numpy as np
import OpenEXR
import PIL.Image
import tifffile
from numpy.typing import NDArray
from PIL.JpegImagePlugin import get_sampling

from virtual_sensor.display import Displayed, listed, span
from virtual_sensor.errors import InputError, a, naming
from virtual_sensor.imaging.image_metadata import KEY, bits_of, described, metadata_of
from virtual_sensor.imaging.line_colours import COLOURS, colour_at, colour_of_line
from virtual_sensor.imaging.netpbm import read_header, read_netpbm
from virtual_sensor.imaging.piz import holds_its_claim

CAMERA_BITS = "Camera bits"
"""Keyword of a PNG file's text: so many bits of its grey values are the camera's, the lowest."""

KINDS = {
    "PNG": (rb"\x89PNG\r\n\x1a\n", (".png", ".apng")),
    "TIFF": (rb"II[*+]\0|MM\0[*+]", (".tif", ".tiff")),
    "JPEG": (rb"\xff\xd8\xff", (".jpg", ".jpeg", ".jpe")),
    "BMP": (rb"BM.{12}[\x0c\x28\x34\x38\x40\x6c\x7c]\0\0\0", (".bmp", ".dib")),
    "OpenEXR": (rb"v/1\x01", (".exr",)),
    "WebP": (rb"RIFF.{4}WEBP", (".webp",)),
    "Netpbm": (rb"P(?:[1-6fF][\s#]|7\n)", (".pgm", ".ppm", ".pbm", ".pnm", ".pam", ".pfm")),
    "JPEG 2000": (rb"\0\0\0\x0cjP  \r\n\x87\n|\xff\x4f\xff\x51", (".jp2", ".j2k")),
    "AVIF": (rb".{4}ftypavi[fs]", (".avif",)),
    "GIF": (rb"GIF8[79]a", (".gif",)),
    "Radiance": (rb"#\?(?:RADIANCE|RGBE)\n", (".hdr",)),
    "Sun raster": (rb"\x59\xa6\x6a\x95", (".ras", ".sr")),
}
"""By how a file begins its kind is known; and the endings of names that such files usually have."""

ENDINGS = tuple(ending for _, endings in KINDS.values() for ending in endings)

_BEGINNING = 32  # bytes that tell the kind
_MOST_PIXELS = 2 * 89_478_485  # Pillow's own limit
_PNG_END = b"IEND\xaeB`\x82"
_GREY = "grey"
_ALPHA = "alpha"
_PILLOWS = {
    "PNG": "PNG", "JPEG": "JPEG", "BMP": "BMP", "WebP": "WEBP", "JPEG 2000": "JPEG2000",
    "AVIF": "AVIF", "GIF": "GIF", "Sun raster": "SUN",
}  # fmt: skip
_LOSSY_KINDS = ("JPEG", "WebP", "AVIF", "JPEG 2000")
_BY_PILLOW = ("JPEG", "GIF", "Sun raster")  # of which OpenCV gives damaged ones too, or none
_ORIENTATION, _PHOTOGRAPH = 0x0112, 0x8769  # EXIF's tags: of the image, and of how it was taken
_TAKEN = {0x829A: "exposure_s", 0x8827: "iso_speed"}
_LOSSY = (6, 7, 33003, 33004, 33005, 34712, 34887, 34892, 50001, 50002)  # JPEG and its kin in TIFF

logging.getLogger("tifffile").addHandler(logging.NullHandler())  # it warns on the terminal


@dataclass(frozen=True)
class StoredImage(Displayed):
    """One channel (H, W) as it is stored, its bits (None: floats), and notes on it.

    `scaled`: its grey values are of fewer bits, spread over those of the array's type.
    `metadata`: what the file says of them, see `image_metadata`.
    `channel`: its name, where the file has several that differ.
    `lossy`: whether pixels may differ from those that the camera gave.
    """

    values: NDArray
    bits: int | None = None
    scaled: bool = False
    orientation: int = 1
    remarks: list[str] = field(default_factory=list)
    metadata: dict[str, Any] = field(default_factory=dict)
    channel: str | None = None
    lossy: bool = False

    def _line(self) -> str:
        height, width = self.values.shape
        bits = f"{self.bits} bits" if self.bits else ""
        return listed(f"{width} x {height} px", f"{self.values.dtype}", bits, span("", self.values))


@dataclass(frozen=True)
class Wanted(Displayed):
    """Which channel of several is to be read: by its name, or that of a laser's light, nm."""

    channel: str | None = None
    wavelength_nm: float | None = None


def kind_of(path: Path) -> str | None:
    """What kind of image a file is, by its content; None if it is none that is known here."""
    with path.open("rb") as file:
        begins = file.read(_BEGINNING)
    return next((k for k, (sign, _) in KINDS.items() if re.match(sign, begins, re.DOTALL)), None)


def read_stored(path: Path, kind: str, wanted: Wanted) -> StoredImage:
    """One channel of a file of such a kind.

    Raises
    ------
    InputError
        Naming the file and the remedy.
    """
    reader = {"TIFF": read_tiff, "OpenEXR": read_exr, "Netpbm": read_pnm, "Radiance": read_hdr}
    stored = reader[kind](path, wanted) if kind in reader else read_picture(path, kind, wanted)
    ending = path.suffix.lower()
    if ending in ENDINGS and ending not in KINDS[kind][1]:
        stored.remarks.insert(0, f"is {a(kind)}, whatever its name says")
    return stored


def _channel(path: Path, channels: dict[str, NDArray], wanted: Wanted, remarks: list[str]) -> str:
    """Name of the one that is asked for, or the only one, or any where all are the same.

    Of colours it is else the one in which a line stands out most.
    """
    alpha = channels.pop(_ALPHA, None) if len(channels) > 1 else None
    if alpha is not None and (alpha != alpha.flat[0]).any():
        remarks.append("its alpha channel is left out: transparent pixels count as any")
    names, channel = ", ".join(channels), wanted.channel
    if channel is None:
        name, first = next(iter(channels.items()))
        if "Y" in channels:
            return "Y"
        if all(np.array_equal(first, other, equal_nan=True) for other in channels.values()):
            channels[_GREY] = first
            return _GREY
        if set(channels) != set(COLOURS):
            raise InputError(
                f"{path}: say which channel: {names} (channel='{name}', or --channel {name})"
            )
        if wanted.wavelength_nm is not None:
            name = colour_at(wanted.wavelength_nm)
            why = f"that of {wanted.wavelength_nm:g} nm"
        else:
            name = colour_of_line(channels)
            why = "in which a line stands out most; --wavelength or --channel say otherwise"
        remarks.append(f"is a colour image: its {name} channel is read, {why}")
        return name
    if list(channels) == [_GREY]:
        remarks.append(f"is grey: --channel {channel} is not needed")
        return _GREY
    letters = {colour[0]: colour for colour in COLOURS}
    for name in (channel, letters.get(channel.lower(), ""), channel.lower()):
        if name in channels:
            return name
    raise InputError(f"{path}: has no channel '{channel}'; take {names}")


def _check_size(path: Path, *sizes: int) -> None:
    if not (min(sizes) > 0 and np.prod([float(n) for n in sizes]) <= _MOST_PIXELS):
        claimed = " x ".join(map(str, sizes))
        raise InputError(
            f"{path}: says it has {claimed} px; give an image of 1 to {_MOST_PIXELS} px, or cut it"
        )


@contextmanager
def _silent() -> Iterator[None]:
    """Suppress what a library in C++ prints on the terminal."""
    with redirect_stdout(StringIO()), Path(os.devnull).open("wb") as nowhere:
        said = os.dup(2)
        os.dup2(nowhere.fileno(), 2)
        try:
            yield
        finally:
            os.dup2(said, 2)
            os.close(said)


@contextmanager
def _refusing(path: Path, kind: str) -> Iterator[None]:
    """Raise an InputError for what a library raises at a damaged file; suppress its warnings."""
    try:
        with warnings.catch_warnings():
            warnings.simplefilter("ignore")
            yield
    except InputError:
        raise
    except Exception as error:
        reason = f"{error}".strip().splitlines() or [type(error).__name__]
        raise InputError(f"{path}: can't be read as {kind} ({reason[-1]}); is it whole?") from None


def read_picture(path: Path, kind: str, wanted: Wanted) -> StoredImage:
    """PNG, JPEG, BMP, WebP and their kin.

    Pillow reads what the file says of itself, OpenCV pixels of all depths.
    """
    remarks: list[str] = []
    with _refusing(path, kind):
        data, formats = path.read_bytes(), (_PILLOWS[kind],)
        with PIL.Image.open(BytesIO(data), formats=formats) as header:
            _check_size(path, *header.size)
            orientation, taken = 1, {}
            try:
                exif = header.getexif()
                orientation = int(exif.get(_ORIENTATION, 1))
                photograph = exif.get_ifd(_PHOTOGRAPH)
                taken = {
                    name: float(photograph[n]) for n, name in _TAKEN.items() if n in photograph
                }
            except Exception:  # whatever is wrong with a block that only describes the image
                remarks.append("its EXIF block is damaged and not used")
            frames = getattr(header, "n_frames", 1)
            if kind == "JPEG":
                halved = get_sampling(header) not in (0, -1)
                colours = "; its colours have fewer pixels than its brightness" if halved else ""
                remarks.append(
                    f"is a JPEG: its loss may move centres, and it may not be linear{colours}"
                )
                if header.mode not in ("L", "RGB"):
                    raise InputError(f"{path}: is {header.mode}; save it as grey or RGB")
            elif kind in _LOSSY_KINDS and data[12:16] != b"VP8L":
                remarks.append(f"is {a(kind)}: if it was not saved without loss, centres may move")
            if {"gamma", "srgb", "icc_profile"} & header.info.keys() and kind != "JPEG":
                remarks.append("names a gamma or colour profile, which is not applied")
            if kind == "PNG":
                with PIL.Image.open(BytesIO(data), formats=formats) as whole:
                    whole.verify()
                if not data.rstrip(b"\0").endswith(_PNG_END):
                    raise InputError(f"{path}: is not a whole PNG file; copy it again")
            if kind in _BY_PILLOW:
                image = np.asarray(header.convert("RGB") if header.mode == "P" else header)
                image = image[..., ::-1] if image.ndim > 2 else image  # OpenCV's order
            else:
                image = _decoded(path, data)
    if frames > 1:
        remarks.append(f"has {frames} frames; the first is read, the others are left out")
    bits, scaled = None, False
    said = f"{header.info.get(CAMERA_BITS, '')}"
    if said.isdecimal() and len(said) < 3 and 0 < int(said) <= 8 * image.itemsize:
        bits = int(said)
    elif kind == "PNG":
        depth, significant = data[24], _significant_bits(data)
        if depth < 8 and data[25] != 3:  # no palette
            remarks.append(f"its {depth} bits are spread to 0 ... 255")
        elif significant and 0 < significant < 8 * image.itemsize:
            bits, scaled = significant, True
    channels = _by_name(image, COLOURS[::-1])
    return _stored(
        *(path, channels, wanted, remarks),
        bits=bits,
        scaled=scaled,
        orientation=orientation,
        lossy=kind in _LOSSY_KINDS,
        metadata=taken | (metadata_of(header.info.get(KEY)) or {}),
    )


def read_pnm(path: Path, wanted: Wanted) -> StoredImage:
    """PGM, PPM and the other kinds of `netpbm`."""
    with _refusing(path, "Netpbm"), naming(path):
        data = path.read_bytes()
        header = read_header(data)
        _check_size(path, header.width, header.height, header.samples)
        image, largest = read_netpbm(data)
    bits = largest.bit_length() if largest else None
    metadata: dict[str, Any] = {}
    if largest and largest + 1 != 1 << largest.bit_length():
        metadata = {"saturation": float(largest)}
    return _stored(path, _by_name(image, COLOURS), wanted, remarks=[], bits=bits, metadata=metadata)


def read_hdr(path: Path, wanted: Wanted) -> StoredImage:
    """Radiance's RGBE, of floats."""
    with _refusing(path, "Radiance"):
        data = path.read_bytes()
        sizes = re.search(rb"\n[-+][XY] (\d{1,9}) [-+][XY] (\d{1,9})\n", data[:65536])
        if not sizes:
            raise InputError(f"{path}: its header is not whole; write it again")
        _check_size(path, *map(int, sizes.groups()))
        image = _decoded(path, data)
    return _stored(path, _by_name(image, COLOURS[::-1]), wanted, remarks=[])


def _by_name(image: NDArray, colours: Sequence[str]) -> dict[str, NDArray]:
    """The channels of an image (H, W) or (H, W, samples) whose colours come in such an order."""
    if image.ndim == 2:
        return {_GREY: image}
    names = (_GREY, _ALPHA) if image.shape[2] < 3 else (*colours, _ALPHA)
    if image.shape[2] > len(names):
        names = tuple(f"{n}" for n in range(1, image.shape[2] + 1))
    named = {name: image[:, :, n] for n, name in enumerate(names[: image.shape[2]])}
    return {name: named[name] for name in (*COLOURS, *names) if name in named}


def _stored(
    path: Path, channels: dict[str, NDArray], wanted: Wanted, remarks: list[str], **said: Any
) -> StoredImage:
    """The channel that is wanted, with what the file says of it."""
    name = _channel(path, channels, wanted, remarks)
    channel = None if name == _GREY else name
    return StoredImage(channels[name], remarks=remarks, channel=channel, **said)


def _decoded(path: Path, data: bytes) -> NDArray:
    """Pixels by OpenCV, which reports faults on the terminal only, as libpng does."""
    with _silent():
        image = cv2.imdecode(np.frombuffer(data, np.uint8), cv2.IMREAD_UNCHANGED)
    if image is None:
        raise InputError(f"{path}: can't be decoded; is it whole?")
    return image


def _significant_bits(data: bytes) -> int | None:
    """What a PNG's sBIT chunk says of its colours, where it says the same of all."""
    at = 8
    while at + 8 <= len(data) and data[at + 4 : at + 8] != b"IDAT":
        size = int.from_bytes(data[at : at + 4], "big")
        if data[at + 4 : at + 8] == b"sBIT":
            colours = set(data[at + 8 : at + 8 + size][: 3 if size > 2 else 1])
            return colours.pop() if len(colours) == 1 else None
        at += 12 + size
    return None


def read_tiff(path: Path, wanted: Wanted) -> StoredImage:
    """TIFF by tifffile, which undoes packing, planes and compression as the tags say."""
    remarks: list[str] = []
    with _refusing(path, "TIFF"), tifffile.TiffFile(path) as file:
        pages: Any = file.pages
        page = next((p for p in pages if not p.is_reduced), pages[0])
        count = max(len(pages), int((file.imagej_metadata or {}).get("images", 1)))
        samples = page.samplesperpixel * page.imagedepth
        _check_size(path, page.imagewidth, page.imagelength, samples)
        segments = list(zip(page.dataoffsets, page.databytecounts, strict=True))
        end = file.filehandle.size
        claimed = math.prod(page.chunked)  # tifffile fills absent strips with 0
        present = all(size and at + size <= end for at, size in segments)
        broken = InputError(f"{path}: is not a whole TIFF file; copy it again")
        file.filehandle.seek(pages.next_page_offset or 0)
        ends = file.filehandle.read(file.tiff.offsetsize) == bytes(file.tiff.offsetsize)
        if not (ends and segments and present and len(segments) >= claimed):
            raise broken
        photometric = page.photometric.name
        known = ("MINISBLACK", "MINISWHITE", "RGB", "PALETTE")
        jpeg = photometric == "YCBCR" and page.compression in (6, 7)  # decoded to RGB
        if page.imagedepth != 1 or not (photometric in known or jpeg):
            what = f"of {photometric}" if page.imagedepth == 1 else "a volume"
            raise InputError(f"{path}: is {what}; save it as one grey or RGB image")
        values = page.asarray()
        if values.size != page.size:  # nothing of it can be decoded
            raise broken
        values = np.moveaxis(values, page.axes.index("S"), -1) if "S" in page.axes else values
        values = values.reshape(page.imagelength, page.imagewidth, -1)
        values = values.astype(np.uint8) if values.dtype == bool else values
        bits = int(page.bitspersample)
        if photometric == "MINISWHITE":
            if values.dtype.kind != "u":
                raise InputError(f"{path}: white is zero, but its pixels are {values.dtype}")
            values = ~values if bits == 8 * values.itemsize else 2**bits - 1 - values
            remarks.append("its white is zero: the grey values are turned round")
        if photometric == "PALETTE":
            values = np.moveaxis(page.colormap, 0, -1)[values[:, :, 0]]
            bits = 16
        names = list(COLOURS) if photometric in ("RGB", "PALETTE") or jpeg else [_GREY]
        for number, kind in enumerate(page.extrasamples, len(names) + 1):
            names.append(_ALPHA if int(kind) else f"{number}")
        if len(names) != values.shape[2] or len(set(names)) < len(names):
            names = [f"{n}" for n in range(1, values.shape[2] + 1)]
        channels = {name: values[:, :, n] for n, name in enumerate(names)}
        name = _channel(path, channels, wanted, remarks)
        chosen = channels[name]
        tags = {tag.name: tag.value for tag in page.tags.values()}
        metadata = described(page.description) or {}
        most = float(np.max(tags.get("MaxSampleValue", 0)))
        orientation = int(tags.get("Orientation", 1))
        if chosen.dtype.kind != "u":
            bits = 0
        elif 0 < most < 2**bits - 1:
            remarks.append(
                f"says its largest value is {most:g}, which is not taken as clipped; give --bits"
            )
        if "GDAL_NODATA" in tags and photometric in ("MINISBLACK", "RGB"):
            chosen = _without(chosen, str(tags["GDAL_NODATA"]))
        elif "GDAL_NODATA" in tags:
            remarks.append("its mark for missing pixels is not used")
    if page.compression in _LOSSY:
        remarks.append("its compression may lose something: centres may move")
    if tags.get("SubIFDs"):
        remarks.append("has images within its page, which are left out")
    if count > 1:
        remarks.append(f"has {count} pages; one is read, the others are left out")
    said = bits_of(metadata) or bits
    bits = said if bits and said <= 8 * chosen.itemsize else bits
    channel = None if name == _GREY else name
    return StoredImage(chosen, bits or None, False, orientation, remarks, metadata, channel)


def _without(values: NDArray, mark: str) -> NDArray:
    """Pixels of the value that marks missing ones become NaN."""
    try:
        missing = values == float(mark)
    except ValueError:
        return values
    return np.where(missing, np.nan, values) if missing.any() else values


def read_exr(path: Path, wanted: Wanted) -> StoredImage:
    """OpenEXR: a channel of any of its parts, where its display window has it."""
    name = os.fsencode(path)  # whatever its letters
    with _refusing(path, "OpenEXR"):
        with _silent(), OpenEXR.File(name, separate_channels=True, header_only=True) as file:
            heads = [dict(part.header) for part in file.parts]  # a closed file has none
        windows = [
            (*_window(head["dataWindow"]), *_window(head["displayWindow"])) for head in heads
        ]
        for head, (_, size, _, shown) in zip(heads, windows, strict=True):
            _check_size(path, *size)
            _check_size(path, *shown)
            _check_size(path, *size, len(head["channels"]))
            if head["type"] in (OpenEXR.deepscanline, OpenEXR.deeptile):
                raise InputError(f"{path}: is deep; flatten it to one value for each pixel")
        with _silent(), OpenEXR.File(name, separate_channels=True) as file:
            parts = [{n: np.array(c.pixels) for n, c in p.channels.items()} for p in file.parts]
        # OpenEXR leaves out what it can't read.
        if not heads or [len(p) for p in parts] != [len(h["channels"]) or 1 for h in heads]:
            raise InputError(f"{path}: its pixels are damaged or missing; write it again")
        if len(heads) == 1 and not _whole_piz(path, heads[0], windows[0][1], parts[0]):
            raise InputError(
                f"{path}: its header claims more pixels than its blocks hold; write it again"
            )
    remarks: list[str] = []
    names = [f"{head.get('name') or number}" for number, head in enumerate(heads, 1)]
    part, chosen, values = _exr_channel(path, names, parts, wanted, remarks)
    (left, top), (width, height), (left_shown, top_shown), shown = windows[part]
    if values.shape != (height, width):
        raise InputError(f"{path}: its channel is subsampled; choose another or save it in full")
    if heads[part].get("pixelAspectRatio", 1.0) != 1.0:
        remarks.append("its pixels are not square, which is not used")
    metadata = metadata_of(heads[part].get(KEY)) or {}
    if windows[part][:2] == windows[part][2:]:
        return StoredImage(values, remarks=remarks, metadata=metadata, channel=chosen)
    remarks.append(
        f"its data window of {width} x {height} px begins at ({left - left_shown},"
        f" {top - top_shown}) of its {shown[0]} x {shown[1]} px: pixels beside it are missing"
    )
    whole = np.full(shown[::-1], np.nan, np.result_type(values.dtype, np.float32))
    rows, columns = np.arange(height) + top - top_shown, np.arange(width) + left - left_shown
    inside = (rows >= 0) & (rows < shown[1]), (columns >= 0) & (columns < shown[0])
    whole[np.ix_(rows[inside[0]], columns[inside[1]])] = values[np.ix_(*inside)]
    return StoredImage(whole, remarks=remarks, metadata=metadata, channel=chosen)


def _whole_piz(
    path: Path, head: dict[str, Any], size: tuple[int, int], channels: dict[str, NDArray]
) -> bool:
    """Whether a part holds its data window, as far as OpenEXR leaves it to others to ask."""
    plain = head["type"] == OpenEXR.scanlineimage
    if not plain or head["compression"] != OpenEXR.PIZ_COMPRESSION:
        return True
    width, height = size
    if any(values.shape != (height, width) for values in channels.values()):  # subsampled
        return True
    line_bytes = sum(width * values.dtype.itemsize for values in channels.values())
    return holds_its_claim(path.read_bytes(), height, line_bytes)


def _window(box: tuple[NDArray, NDArray]) -> tuple[tuple[int, int], tuple[int, int]]:
    """First pixel and size of one of an EXR file's windows, (u, v)."""
    (left, top), (right, bottom) = ([int(n) for n in corner] for corner in box)
    return (left, top), (right - left + 1, bottom - top + 1)


def _exr_channel(
    path: Path,
    names: list[str],
    parts: list[dict[str, NDArray]],
    wanted: Wanted,
    remarks: list[str],
) -> tuple[int, str | None, NDArray]:
    """Number of the part, and name (None: all are the same) and pixels of the channel wanted."""
    channel = wanted.channel
    everywhere = [name for part in parts for name in part]
    aliases = dict(zip("RGBA", (*COLOURS, _ALPHA), strict=True))
    places = {
        f"{names[i]}.{name}" if everywhere.count(name) > 1 else aliases.get(name, name): (i, values)
        for i, part in enumerate(parts)
        for name, values in part.items()
    }
    if channel is not None and len(parts) > 1:  # "part.name" is known too where "name" would do
        prefix, _, own = channel.partition(".")
        if prefix in names and own in parts[names.index(prefix)]:
            return names.index(prefix), channel, parts[names.index(prefix)][own]
    named = {name: values for name, (_, values) in places.items()}
    name = _channel(path, named, wanted, remarks)
    chosen = named[name]
    part = next(i for i, values in places.values() if values is chosen)
    if len(parts) > 1 and channel is None:
        others = ", ".join(name for i, name in enumerate(names) if i != part)
        remarks.append(f"has {len(parts)} parts; '{names[part]}' is read, not {others}")
    return part, None if name == _GREY else name, chosen
