"""Images of a line at a known row, by real writers and byte by byte."""

from __future__ import annotations

import io
import struct
import tempfile
import zlib
from dataclasses import dataclass, field
from functools import partial
from pathlib import Path

import cv2
import numpy as np
import OpenEXR
import tifffile
from hypothesis import strategies as st
from PIL import Image

SIGMA_PX = 2.0


@dataclass(frozen=True)
class Picture:
    """A drawn image: a line at row = first + slope * column, of so many grey values.

    Attributes
    ----------
    shape : tuple of two int
    first, slope : float
    top : float
        Grey values of the line; the background is a twentieth of it.
    """

    shape: tuple[int, int]
    first: float
    slope: float
    top: float

    def row(self, column):
        """Where the line is, px."""
        return self.first + self.slope * column

    def grey(self, dtype=np.float64, top=None):
        """Its pixels (H, W)."""
        rows, columns = np.indices(self.shape)
        away = (rows - self.row(columns)) / SIGMA_PX
        values = (top or self.top) * (0.05 + 0.9 * np.exp(-0.5 * away**2))
        return (np.rint(values) if np.dtype(dtype).kind in "ui" else values).astype(dtype)


@st.composite
def pictures(draw):
    height, width = draw(st.integers(24, 72)), draw(st.integers(9, 60))
    first = draw(st.floats(9.0, height - 10.0, allow_nan=False).map(lambda v: round(v, 3)))
    slope = (draw(st.floats(8.0, height - 9.0).map(lambda v: round(v, 3))) - first) / width
    return Picture((height, width), first, slope, 1.0)


@dataclass(frozen=True)
class Written:
    """A whole file.

    Attributes
    ----------
    name : str
    data : bytes
    truths : tuple of ndarray
        What its pixels may be read as; NaN beyond a data window.
    options : dict
    sealed : bool
        Whether a checksum guards all of it.
    plain : bool
        Whether it must be read, without a note.
    loss : float
        Grey values by which a lossy codec may differ.
    excused : tuple of ndarray
        What they may be read as if there is a note.
    upright : bool
        Whether the line is where the picture says, and fine enough for its centres.
    label : str
    """

    name: str
    data: bytes
    truths: tuple[np.ndarray, ...]
    options: dict[str, str] = field(default_factory=dict)
    sealed: bool = False
    plain: bool = False
    loss: float = 0.0
    excused: tuple[np.ndarray, ...] = ()
    upright: bool = True
    label: str = ""


def png(grey, depth, chunks=(), claimed=None):
    """A grey PNG of so many bits, byte by byte, with further chunks before the pixels."""
    height, width = claimed or grey.shape
    if depth == 16:
        rows = [row.astype(">u2").tobytes() for row in grey]
    else:
        bits = np.unpackbits(grey.astype(np.uint8)[:, :, None], axis=2)[:, :, 8 - depth :]
        rows = [np.packbits(row.ravel()).tobytes() for row in bits]
    head = struct.pack(">IIBBBBB", width, height, depth, 0, 0, 0, 0)
    pixels = zlib.compress(b"".join(b"\0" + row for row in rows))
    parts = ((b"IHDR", head), *chunks, (b"IDAT", pixels), (b"IEND", b""))
    return b"\x89PNG\r\n\x1a\n" + b"".join(
        struct.pack(">I", len(body)) + kind + body + struct.pack(">I", zlib.crc32(kind + body))
        for kind, body in parts
    )


def tiff(pages, order="<"):
    """A TIFF byte by byte: a list of (tags, strips); `tags` is {number: (type, values)}.

    Returns
    -------
    bytes
        Strip offsets and counts are added.
    """
    head = b"II*\0" if order == "<" else b"MM\0*"
    letters = {1: "B", 2: "c", 3: "H", 4: "I", 5: "II", 12: "d"}
    body, offset, links = b"", 8, [4]
    for tags, strips in pages:
        starts = [offset + len(body) + sum(map(len, strips[:i])) for i in range(len(strips))]
        body += b"".join(strips) + b"\0" * (sum(map(len, strips)) % 2)
        tags = tags | {273: (4, starts), 279: (4, [len(s) for s in strips])}
        entries, outside = b"", b""
        begin = offset + len(body)
        after = begin + 2 + 12 * len(tags) + 4
        for number, (kind, values) in sorted(tags.items()):
            raw = struct.pack(f"{order}{len(values)}{letters[kind]}", *values)
            if len(raw) > 4:
                place = struct.pack(f"{order}I", after + len(outside))
                outside += raw + b"\0" * (len(raw) % 2)
            else:
                place = raw.ljust(4, b"\0")
            entries += struct.pack(f"{order}HHI", number, kind, len(values)) + place
        links.append(begin + 2 + 12 * len(tags))
        body += struct.pack(f"{order}H", len(tags)) + entries + bytes(4) + outside
        head_or_body = (links[-2], struct.pack(f"{order}I", begin))
        if links[-2] == 4:
            head += head_or_body[1]
        else:
            at = links[-2] - offset
            body = body[:at] + head_or_body[1] + body[at + 4 :]
    return head + body


def packed(values, bits):
    """Rows of values in so many bits each, the highest first; rows begin at a byte."""
    every = (values[:, :, None] >> np.arange(bits)[::-1]) & 1
    return [np.packbits(row.ravel()).tobytes() for row in every.astype(np.uint8)]


def grey_tags(shape, bits, rows_per_strip, **more):
    """The tags of a grey TIFF: {number: (type, values)}."""
    height, width = shape
    tags = {256: (4, [width]), 257: (4, [height]), 258: (3, [bits]), 259: (3, [1]), 262: (3, [1])}
    tags |= {277: (3, [1]), 278: (4, [rows_per_strip])}
    return tags | {int(k[1:]): v for k, v in more.items()}


def _cv(ending, image, *parameters):
    made, data = cv2.imencode(ending, image, parameters)
    assert made
    return data.tobytes()


def _pil(image, form, **options):
    file = io.BytesIO()
    image.save(file, form, **options)
    return file.getvalue()


def _tifffile(image, **options):
    file = io.BytesIO()
    tifffile.imwrite(file, image, **options)
    return file.getvalue()


def exr(parts):
    """An EXR of (header, channels) parts."""
    with tempfile.TemporaryDirectory() as folder:
        path = Path(folder) / "made.exr"
        made = [
            OpenEXR.Part(head, channels, f"part{i}") for i, (head, channels) in enumerate(parts)
        ]
        OpenEXR.File(made).write(str(path))
        return path.read_bytes()


def _decoy(grey):
    """Another line, upside down."""
    return np.ascontiguousarray(grey[::-1])


@st.composite
def pngs(draw, picture):
    """PNG: sealed by its checksums."""
    bits = draw(st.sampled_from((1, 2, 4, 8, 8, 16, 16)))
    grey = picture.grey(np.uint16 if bits == 16 else np.uint8, 2**bits - 1)
    grey8 = picture.grey(np.uint8, 255)
    kind = draw(st.sampled_from(("cv", "hand", "rgb", "rgba", "la", "same", "palette", "top12")))
    made = partial(Written, "line.png", sealed=True, label=f"png {kind} {bits}")
    if kind == "top12":
        grey = picture.grey(np.uint16, 4095)
        return made(png(grey << 4, 16, [(b"sBIT", bytes([12]))]), (grey, grey << 4))
    if kind == "hand" or bits < 8:
        chunks = draw(st.sampled_from(((), ((b"tEXt", b"a\0b"),), ((b"gAMA", b"\0\0\xb1\x8f"),))))
        spread = (grey * (255 // (2**bits - 1))).astype(np.uint8) if bits < 8 else grey
        return made(png(grey, bits, chunks), (spread, grey), plain=bits >= 8, upright=bits >= 8)
    if kind == "palette":
        coded = Image.fromarray(grey8).convert("P")
        return made(_pil(coded, "PNG"), (np.asarray(coded.convert("L")),), upright=False)
    if kind == "la":
        both = np.dstack([grey8, np.full_like(grey8, 255)])
        return made(_pil(Image.fromarray(both, "LA"), "PNG"), (grey8,))
    if kind == "same":
        return made(_cv(".png", np.dstack([grey] * 3)), (grey,), plain=True)
    if kind in ("rgb", "rgba"):
        colour = np.dstack([_decoy(grey)] * 2 + [grey])  # OpenCV's order: red is the last
        if kind == "rgba":
            colour = np.dstack([colour, np.full_like(grey, 2**bits - 1)])
        return made(_cv(".png", colour), (grey,), {"channel": "red"}, plain=True)
    return made(_cv(".png", grey), (grey,), plain=True)


@st.composite
def bmps(draw, picture):
    """BMP: guarded by nothing."""
    grey = picture.grey(np.uint8, 255)
    kind = draw(st.sampled_from(("grey", "colour", "pil", "alpha")))
    made = partial(Written, "line.bmp", label=f"bmp {kind}")
    if kind == "grey":
        return made(_cv(".bmp", grey), (grey,), plain=True)
    if kind == "pil":
        return made(_pil(Image.fromarray(grey), "BMP"), (grey,), plain=True)
    colour = np.dstack([_decoy(grey)] * 2 + [grey])
    if kind == "alpha":
        colour = np.dstack([colour, np.full_like(grey, 255)])
    return made(_cv(".bmp", colour), (grey,), {"channel": "red"})


_BY_TIFFFILE = (
    {"compression": "zlib"},
    {"compression": "zlib", "predictor": 2},
    {"bigtiff": True},
    {"tile": (16, 16)},
    {"rowsperstrip": 5},
    {"photometric": "miniswhite"},
)


@st.composite
def tiffs(draw, picture):
    """TIFF by OpenCV, Pillow and tifffile, and byte by byte."""
    kinds = ("cv", "float", "lib", "pil", "packed", "white0", "planar", "pages", "turned", "hand")
    kind = draw(st.sampled_from(kinds))
    grey8, grey16 = picture.grey(np.uint8, 255), picture.grey(np.uint16, 65535)
    grey = draw(st.sampled_from((grey8, grey16)))
    height = picture.shape[0]
    rows = draw(st.sampled_from((1, 7, height)))
    order = draw(st.sampled_from("<>"))
    name = draw(st.sampled_from(("line.tif", "line.tiff", "LINE.TIF")))
    made = partial(Written, name, label=f"tiff {kind}")
    top = np.iinfo(grey.dtype).max
    if kind == "cv":
        return made(_cv(".tif", grey), (grey,), plain=True)
    if kind == "float":
        grey = picture.grey(draw(st.sampled_from((np.float32, np.float64))))
        return made(_tifffile(grey, byteorder=order), (grey,))
    if kind == "lib":
        options = draw(st.sampled_from(_BY_TIFFFILE))
        made = partial(made, label=f"tiff {' '.join(options)}")
        data = _tifffile(grey, byteorder=order, **options)
        if "photometric" in options:
            return made(data, (top - grey,), excused=(grey,), upright=False)
        return made(data, (grey,))
    if kind == "pil":
        how = draw(st.sampled_from(("tiff_lzw", "packbits", "tiff_deflate", "jpeg", "group4")))
        if how == "group4":
            bilevel = Image.fromarray(grey8).convert("1", dither=Image.Dither.NONE)
            bits = np.asarray(bilevel).astype(np.uint8)
            data = _pil(bilevel, "TIFF", compression=how)
            return made(data, (bits, bits * 255), upright=False)
        data = _pil(Image.fromarray(grey8), "TIFF", compression=how)
        return made(data, (grey8,), loss=40.0 if how == "jpeg" else 0.0, upright=how != "jpeg")
    if kind == "packed":
        bits = draw(st.sampled_from((10, 12, 14)))
        grey = picture.grey(np.uint16, 2**bits - 1)
        lines = packed(grey, bits)
        strips = [b"".join(lines[i : i + rows]) for i in range(0, height, rows)]
        return made(tiff([(grey_tags(picture.shape, bits, rows), strips)], order), (grey,))

    def strips_of(values):
        values = np.ascontiguousarray(values).astype(f"{order}u{grey.dtype.itemsize}")
        return [values[i : i + rows].tobytes() for i in range(0, height, rows)]

    bits = 8 * grey.dtype.itemsize
    tags = grey_tags(picture.shape, bits, rows)
    if kind == "white0":
        data = tiff([(tags | {262: (3, [0])}, strips_of(top - grey))], order)
        return made(data, (grey,), excused=(top - grey,))
    if kind == "planar":
        tags |= {258: (3, [bits] * 3), 262: (3, [2]), 277: (3, [3]), 284: (3, [2])}
        strips = strips_of(grey) + 2 * strips_of(_decoy(grey))
        return made(tiff([(tags, strips)], order), (grey,), {"channel": "red"})
    if kind == "pages":
        data = tiff([(tags, strips_of(grey)), (tags, strips_of(_decoy(grey)))], order)
        return made(data, (), excused=(grey,))
    if kind == "turned":
        turn = draw(st.integers(1, 8))
        data = tiff([(tags | {274: (3, [turn])}, strips_of(grey))], order)
        truth = np.ascontiguousarray(_turned(grey, turn))
        return made(data, (truth,), excused=(grey,), upright=turn == 1)
    return made(tiff([(tags, strips_of(grey))], order), (grey,), plain=True)


def _turned(grey, orientation):
    """The image that TIFF's orientation tag means."""
    image = grey.T if orientation >= 5 else grey
    across, down = orientation in (2, 3, 6, 7), orientation in (3, 4, 7, 8)
    return image[:: -1 if down else 1, :: -1 if across else 1]


_CODECS = (
    OpenEXR.NO_COMPRESSION,
    OpenEXR.RLE_COMPRESSION,
    OpenEXR.ZIPS_COMPRESSION,
    OpenEXR.ZIP_COMPRESSION,
    OpenEXR.PIZ_COMPRESSION,
    OpenEXR.PXR24_COMPRESSION,
)


@st.composite
def exrs(draw, picture):
    """OpenEXR: channels, windows, parts and tiles."""
    codec = draw(st.sampled_from(_CODECS))
    grey = picture.grey(draw(st.sampled_from((np.float32, np.float16))))
    head = {"compression": codec, "type": OpenEXR.scanlineimage}
    kind = draw(st.sampled_from(("Y", "named", "rgb", "window", "parts", "tiles", "uint", "three")))
    loss = 1e-3 if codec == OpenEXR.PXR24_COMPRESSION else 0.0
    made = partial(Written, "line.exr", loss=loss, label=f"exr {kind}")
    truth = grey.astype(np.float32)
    if kind == "tiles":
        head |= {"type": OpenEXR.tiledimage, "tiles": OpenEXR.TileDescription()}
        return made(exr([(head, {"Y": grey})]), (truth,))
    if kind == "named":
        name = draw(st.sampled_from(("R", "line", "laser.a")))
        options = {"channel": name} if draw(st.booleans()) else {}
        return made(exr([(head, {name: grey})]), (truth,), options, plain=True)
    if kind == "rgb":
        channels = {"R": grey, "G": _decoy(grey), "B": _decoy(grey)}
        return made(
            exr([(head, channels)]), (truth,), {"channel": draw(st.sampled_from(("red", "R")))}
        )
    if kind == "three":
        return made(exr([(head, dict.fromkeys("RGB", grey))]), (truth,))
    if kind == "uint":
        counts = picture.grey(np.uint32, 60000)
        return made(exr([(head, {"Y": counts})]), (counts,))
    if kind == "parts":
        parts = [(dict(head), {"Y": grey}), (dict(head), {"Y": _decoy(grey)})]
        return made(exr(parts), (), excused=(truth,))
    if kind == "window":
        u, v = draw(st.tuples(st.integers(-9, 30), st.integers(-9, 30)))
        height, width = picture.shape
        last = np.array([u + width - 1, v + height - 1], np.int32)
        head |= {"dataWindow": (np.array([u, v], np.int32), last)}
        head |= {"displayWindow": (np.zeros(2, np.int32), np.full(2, 99, np.int32))}
        shown = np.full((100, 100), np.nan, np.float32)
        part = truth[max(-v, 0) : 100 - v, max(-u, 0) : 100 - u]
        shown[max(v, 0) : max(v, 0) + part.shape[0], max(u, 0) : max(u, 0) + part.shape[1]] = part
        data = exr([(head, {"Y": grey})])
        return made(data, (shown,), excused=(truth,), upright=False)
    return made(exr([(head, {"Y": grey})]), (truth,), plain=True)


@st.composite
def others(draw, picture):
    """What has the wrong name, or isn't known."""
    grey = picture.grey(np.uint8, 255)
    kinds = ("jpg", "jpeg in png", "jpeg in tif", "png in bmp", "npy", "webp", "pgm", "pgm of 12")
    kind = draw(st.sampled_from(kinds))
    name = {"jpg": "line.jpg", "jpeg in png": "line.png", "jpeg in tif": "line.tif"}.get(kind)
    if name:
        return Written(name, _cv(".jpg", grey), (grey,), loss=40.0, upright=False, label=kind)
    if kind == "npy":
        file = io.BytesIO()
        np.save(file, grey)
        return Written("line.npy", file.getvalue(), (grey,), label=kind)
    if kind == "png in bmp":
        return Written("line.bmp", _cv(".png", grey), (grey,), label=kind)
    if kind.startswith("pgm"):
        top, kept = (255, ">u1") if kind == "pgm" else (4095, ">u2")
        grey = picture.grey(np.uint16, top)
        data = b"P5 %d %d %d\n" % (*grey.shape[::-1], top) + grey.astype(kept).tobytes()
        return Written("line.pgm", data, (grey,), plain=True, label=kind)
    data = _pil(Image.fromarray(grey), "WEBP")
    return Written("line.webp", data, (grey,), loss=60.0, upright=False, label=kind)
