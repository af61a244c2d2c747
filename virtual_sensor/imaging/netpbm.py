"""Netpbm's images: PBM, PGM, PPM and PAM, in bytes or in digits, and PFM, of floats.

They are read here, as OpenCV spreads a PGM's digits to 0 ... 255, exchanges a PAM's colours and
divides a PFM's floats by its scale, of which only the sign has a meaning.

Source: https://netpbm.sourceforge.net/doc; of PFM https://www.pauldebevec.com/Research/HDR/PFM
"""

from __future__ import annotations

import re
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from virtual_sensor.errors import InputError

_GAP = rb"(?:\s|#[^\n]*\n)+"
_COMMENT = rb"#[^\n]*(?:\n|$)"
_SAMPLES = {b"1": 1, b"2": 1, b"3": 3, b"4": 1, b"5": 1, b"6": 3, b"f": 1, b"F": 3}
_BITMAPS, _FLOATS, _DIGITS = (b"1", b"4"), (b"f", b"F"), (b"1", b"2", b"3")
_PAM = (b"WIDTH", b"HEIGHT", b"DEPTH", b"MAXVAL")


class Header(NamedTuple):
    """What the file says first; of a PFM the sign of `largest` is the order of its bytes."""

    kind: bytes
    width: int
    height: int
    samples: int
    largest: float
    end: int


def read_header(data: bytes) -> Header:
    """The header of a file, whose pixels begin at its end.

    Raises
    ------
    InputError
        If it is not whole, or says what can't be.
    """
    kind = data[1:2]
    if kind == b"7":
        text, ends, _ = data[:4096].partition(b"ENDHDR\n")
        said = dict(re.findall(rb"^([A-Z]+)[ \t]+(\d{1,9})\s*$", text, re.MULTILINE))
        if not ends or not said.keys() >= {*_PAM}:
            raise InputError("its header is not whole")
        width, height, samples, most = (int(said[name]) for name in _PAM)
        header = Header(kind, width, height, samples, most, len(text) + len(ends))
    else:
        last = b"()" if kind in _BITMAPS else _GAP + rb"(-?[\d.eE+-]{1,30})"
        found = re.match(rb"P." + 2 * (_GAP + rb"(\d{1,9})") + last + rb"\s", data)
        if not found:
            raise InputError("its header is not whole")
        try:
            largest = float(found[3] or 1.0)
        except ValueError:
            raise InputError(f"says its scale is {found[3].decode()}, no number") from None
        header = Header(*(kind, int(found[1]), int(found[2]), _SAMPLES[kind], largest, found.end()))
    if kind not in _FLOATS and not 1.0 <= header.largest <= 65535.0:
        raise InputError(f"says its largest value is {header.largest:g}; known are 1 to 65535")
    return header


def read_netpbm(data: bytes) -> tuple[NDArray, int | None]:
    """Pixels of shape (H, W, samples), and the largest grey value (None: floats).

    Raises
    ------
    InputError
        If the file holds fewer than its header says.
    """
    kind, width, height, samples, largest, begin = read_header(data)
    shape, stored = (height, width, samples), data[begin:]
    values: NDArray
    if kind in _DIGITS:
        digits = re.sub(_COMMENT, b" ", stored)
        words = [*re.sub(rb"\s", b"", digits).decode("latin-1")] if kind == b"1" else digits.split()
        values = np.array(words[: height * width * samples]).astype(np.uint16)
    elif kind == b"4":
        bytes_wide = (width + 7) // 8
        packed = np.frombuffer(stored, np.uint8, min(bytes_wide * height, len(stored)))
        whole = packed[: packed.size // bytes_wide * bytes_wide].reshape(-1, bytes_wide)
        values = np.unpackbits(whole, axis=1)[:, :width].ravel()
    else:
        one = "f4" if kind in _FLOATS else "u1" if largest < 256.0 else "u2"
        item = np.dtype(("<" if largest < 0.0 else ">") + one)
        values = np.frombuffer(stored, item, min(int(np.prod(shape)), len(stored) // item.itemsize))
    if values.size < np.prod(shape):
        raise InputError(f"holds {values.size} of {np.prod(shape)} values; copy it again")
    values = values.reshape(shape)
    if kind in _FLOATS:
        return values[::-1].astype(np.float32), None  # the lowest row comes first
    if kind in _BITMAPS:  # 1 is black
        return np.where(values == 0, np.uint8(255), np.uint8(0)), 255
    return values.astype(np.uint8 if largest < 256.0 else np.uint16), int(largest)
