"""Images that are whole or spoilt, and what is made up in what is read of them."""

from __future__ import annotations

import struct
import zlib
from collections.abc import Callable

import numpy as np
from hostile.cases import Case, Result
from hostile.image_files import Picture, Written, bmps, exrs, others, pictures, pngs, tiffs
from hostile.mutations import GARBAGE, cut, flipped, spliced, stamped
from hypothesis import strategies as st

NEAR_PX = 0.3  # 8 bits leave less than a tenth of it
MOST_PIXELS_PER_BYTE = 2000  # deflate packs 1032 bytes into one
OK = 0  # Status.OK


@st.composite
def cases(draw):
    """An image that is whole, or spoilt."""
    picture = draw(pictures())
    makers = (pngs, pngs, bmps, tiffs, tiffs, exrs, others)
    written = draw(draw(st.sampled_from(makers))(picture))
    return draw(spoilt(written, picture))


@st.composite
def spoilt(draw, written: Written, picture: Picture):
    """What becomes of a file."""
    how = draw(
        st.sampled_from(
            ("whole", "cut", "cut", "flipped", "stamped", "spliced", "claims", "garbage")
        )
    )
    data, judge = written.data, judged(written, picture)
    if how == "cut":
        data = draw(cut(data))
    elif how == "claims":
        rows = draw(st.integers(1, 5) | st.sampled_from((2**15, 2**30)))
        rows += 16 * ("tile" in written.label)  # a tile's rows beyond the image are there
        data = claiming_more(written, rows)
    elif how == "garbage":
        data = draw(GARBAGE)
        judge = possible(len(data))
    elif how != "whole":
        change = {"flipped": flipped, "stamped": stamped, "spliced": spliced}[how]
        data = draw(change(data))
        judge = judge if written.sealed else possible(len(data))
    options = dict(written.options)
    if draw(st.integers(0, 9)) == 0:
        options["channel"] = draw(st.sampled_from(("blue", "Z", "", "ré", "a" * 300)))
        judge = possible(len(data))
    return Case(
        "image",
        f"{written.label}/{how}",
        {written.name: data},
        written.name,
        judge,
        options,
        must_be_read=how == "whole" and written.plain and options == written.options,
    )


def claiming_more(written: Written, rows: int) -> bytes:
    """The file with a header that says so many more rows, if we know where."""
    data, name = written.data, written.name.lower()

    def more(at: int, code: str) -> bytes:
        """A number of the header, made larger."""
        (said,) = struct.unpack(code, data[at : at + 4])
        return data[:at] + struct.pack(code, min(said + rows, 2**31 - 1)) + data[at + 4 :]

    if name.endswith(".bmp") and data[:2] == b"BM":
        return more(22, "<i")
    if name.endswith(".png") and data[:4] == b"\x89PNG":
        data = more(20, ">I")
        return data[:29] + struct.pack(">I", zlib.crc32(data[12:29])) + data[33:]
    if name.endswith(".exr"):
        mark = b"dataWindow\0box2i\0" + struct.pack("<I", 16)
        return more(data.find(mark) + len(mark) + 12, "<i")
    for start, order in ((b"II*\0", "<"), (b"MM\0*", ">")):
        entry = struct.pack(f"{order}HHI", 257, 4, 1)
        if data[:4] == start and entry in data:
            return more(data.find(entry) + len(entry), f"{order}I")
    return data


def judged(written: Written, picture: Picture):
    """Whether pixels and centres are the drawn ones."""

    def judge(result: Result) -> str:
        found = np.asarray(result["pixels"])
        allowed = written.truths + (written.excused if result["notes"] else ())
        if not any(_same(found, truth, written.loss) for truth in allowed):
            shapes = " or ".join(str(t.shape) for t in written.truths) or "nothing without a note"
            return f"pixels are not those drawn: {found.dtype} {found.shape}, drawn {shapes}"
        good = (result["status"] == OK) & written.upright
        away = np.abs(result["row"] - picture.row(result["column"]))[good]
        if away.max(initial=0.0) > NEAR_PX:
            return f"a centre is {away.max():g} px off, and ok"
        return ""

    return judge


def _same(found, truth, loss):
    """Whether pixels are those drawn or NaN; beyond a data window (NaN) they are NaN or zero."""
    if found.shape != truth.shape:
        return False
    drawn = np.isfinite(truth)
    away = np.abs(found.astype(np.float64) - np.where(drawn, truth, 0.0))
    return bool(np.nanmax(away, initial=0.0) <= max(loss, 1e-6))


def possible(size: int) -> Callable[[Result], str]:
    """Whether an image that nobody knows is at least one that the file's bytes can hold."""

    def judge(result: Result) -> str:
        pixels = result["pixels"]
        if pixels.ndim != 2 or pixels.dtype not in (np.uint8, np.uint16, np.float32, np.float64):
            return f"an image of {pixels.dtype} {pixels.shape}"
        if pixels.nbytes > MOST_PIXELS_PER_BYTE * (size + 100):
            return f"{pixels.shape} pixels of a file of {size} bytes"
        good = result["status"] == OK
        for place, most in ((result["row"], pixels.shape[0]), (result["column"], pixels.shape[1])):
            if not np.all((place[good] >= -0.5) & (place[good] <= most - 0.5)):
                return "a centre outside the image is ok"
        return ""

    return judge
