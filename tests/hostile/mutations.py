"""What is done to whole files: strategies that take bytes and give a label and other bytes."""

from __future__ import annotations

import re
import struct
from collections.abc import Sequence

from hypothesis import strategies as st

Span = tuple[int, int]
"""First byte, and the one after the last."""

HUGE = (0, 1, 2, -1, 255, 2**15, 2**16 - 1, 2**31 - 1, 2**31, 2**32 - 1, 2**40, 2**63 - 1, -(2**31))
NUMBERS = (
    "nan", "inf", "-inf", "-0", "0", "1e308", "1e999", "-1e300", "1e-320", "9" * 400, "-1", "1e20",
    "2147483648", "99999999999999999999", "0x10", "1,5", "", " ", "1e", "--1", "1_0", "٣", "1e5000",
    "true", "NULL", "None", "1+2i", "nan(ind)", "\x00", "1.5.2",
)  # fmt: skip
WORDS = (
    "", " ", "x", "é", "日本", "\x1b[31mred", "a" * 5000, "../../etc/passwd", "%s%n", "$x", "&",
    "<", "{", "[", '"', "'", "\\", "\x00", "\x07", "\u202e", "\ud7ff", "-", "nan", "0", "C:\\air",
)  # fmt: skip


@st.composite
def cut(draw, data: bytes):
    """The file without its end."""
    kept = draw(
        st.one_of(
            st.integers(0, max(len(data) - 1, 0)),
            st.integers(1, min(len(data), 64)).map(lambda lost: len(data) - lost),
        )
    )
    return data[:kept]


@st.composite
def flipped(draw, data: bytes, spans: Sequence[Span] | None = None):
    """One to four bits flipped, within the spans."""
    spans = [s for s in spans or [(0, len(data))] if s[0] < s[1]]
    changed = bytearray(data)
    for _ in range(draw(st.integers(1, 4))):
        first, end = draw(st.sampled_from(spans))
        changed[draw(st.integers(first, end - 1))] ^= 1 << draw(st.integers(0, 7))
    return bytes(changed)


@st.composite
def stamped(draw, data: bytes, span: Span | None = None):
    """A number of 1, 2, 4 or 8 bytes put over what is there: sizes, counts, offsets, types."""
    first, end = span or (0, len(data))
    size = draw(st.sampled_from((1, 2, 4, 8)))
    place = draw(st.integers(first, max(end - size, first)))
    number = draw(st.sampled_from(HUGE) | st.integers(-(2**63), 2**63 - 1))
    order = draw(st.sampled_from(("little", "big")))
    new = (number % (1 << 8 * size)).to_bytes(size, order)
    if size == 8 and draw(st.booleans()):
        value = draw(st.sampled_from((float("nan"), float("inf"), -1e308, 1e-320)))
        new = struct.pack("<d" if order == "little" else ">d", value)
    return data[:place] + new + data[place + size :]


@st.composite
def spliced(draw, data: bytes):
    """A block lost, doubled, made zero or put at another place."""
    a, b, c = sorted(draw(st.tuples(*[st.integers(0, len(data))] * 3)))
    return draw(
        st.sampled_from(
            (
                data[:a] + data[b:],
                data[:b] + data[a:],
                data[:a] + bytes(b - a) + data[b:],
                data[:a] + data[b:c] + data[a:b] + data[c:],
                bytes(min(a, 1000)) + data,
                data + data[a:b],
            )
        )
    )


@st.composite
def numbers_changed(draw, text: str, among: str = r"-?\d+\.?\d*(?:[eE][-+]?\d+)?"):
    """Numbers of a text put in place of others."""
    places = list(re.finditer(among, text))
    for _ in range(draw(st.integers(1, 3)) if places else 0):
        places = list(re.finditer(among, text))
        if not places:
            break
        at = draw(st.sampled_from(places))
        new = draw(st.sampled_from(NUMBERS) | st.integers(-5, 5000).map(str))
        text = text[: at.start()] + new + text[at.end() :]
    return text


@st.composite
def words_changed(draw, text: str):
    """Words of a text put in place of others, lost, or swapped."""
    for _ in range(draw(st.integers(1, 2))):
        places = list(re.finditer(r"[\w.:$-]+", text))
        if not places:
            break
        at, other = draw(st.sampled_from(places)), draw(st.sampled_from(places))
        new = draw(st.sampled_from((*WORDS, other[0])))
        text = text[: at.start()] + new + text[at.end() :]
    return text


@st.composite
def lines_changed(draw, text: str):
    """Lines of a text lost, doubled, swapped or put in."""
    lines = text.splitlines(keepends=True)
    for _ in range(draw(st.integers(1, 3))):
        if not lines:
            break
        i, j = draw(st.tuples(*[st.integers(0, len(lines) - 1)] * 2))
        change = draw(st.sampled_from(("lose", "double", "swap", "put", "cut")))
        if change == "lose":
            del lines[i]
        elif change == "double":
            lines.insert(j, lines[i])
        elif change == "swap":
            lines[i], lines[j] = lines[j], lines[i]
        elif change == "put":
            lines.insert(i, draw(st.sampled_from((*WORDS, *NUMBERS))) + "\n")
        else:
            lines[i] = lines[i][: draw(st.integers(0, len(lines[i])))]
    return "".join(lines)


ENCODINGS = ("utf-8", "utf-8-sig", "utf-16", "utf-16-le", "utf-32", "latin-1", "cp037")


@st.composite
def encoded(draw, text: str):
    """A text in another encoding, with other ends of lines, or with bytes that are no text."""
    ends = draw(st.sampled_from(("\n", "\r\n", "\r", "\n\n", "\x85", "\u2028")))
    text = text.replace("\n", ends)
    data = text.encode(draw(st.sampled_from(ENCODINGS)), "replace")
    return data + draw(st.sampled_from((b"", b"\xff", b"\x00", b"\x1a", b"\xed\xa0\x80")))


GARBAGE = st.one_of(
    st.just(b""),
    st.binary(max_size=300),
    st.sampled_from(
        (b"\x00", b"\n", b"{}", b"[]", b"<a/>", b"nan\n", b"\x89PNG\r\n\x1a\n", b"II*\0")
    ),
    st.integers(1, 2000).map(lambda n: b"[" * n),
)
"""What was never such a file."""
