"""Whether the last block of a PIZ-compressed EXR file holds what its header claims.

OpenEXR does not ask: where the data window was enlarged within a block of 32 lines, it decodes
pixels that are none. A block's data are Huffman codes of 16-bit numbers and of runs: these are
counted here. `OpenEXR/src/lib/OpenEXRCore/internal_piz.c` and `internal_huf.c` have the format.
"""

import struct
from collections import defaultdict

_ROWS = 32  # of a block
_HEADER = 8  # magic number and version
_SEVERAL_PARTS = 0x1000  # in the version
_LONGEST_CODE = 58
_SHORT_RUN, _LONG_RUN = 59, 63  # in the table of code lengths: of symbols that do not occur
_NO_CODE = (_LONG_RUN - _SHORT_RUN) + 2  # the shortest of the long runs


def holds_its_claim(content: bytes, height: int, line_bytes: int) -> bool:
    """Whether the last block has as many numbers as its lines need.

    Parameters
    ----------
    content : bytes
        The file: of one part, in scan lines, compressed by PIZ. Others are not looked at.
    height : int
        Lines of the data window.
    line_bytes : int
        Of a line of all channels, uncompressed.
    """
    if struct.unpack_from("<I", content, 4)[0] & _SEVERAL_PARTS:
        return True
    blocks = -(-height // _ROWS)
    expected = (height - _ROWS * (blocks - 1)) * line_bytes
    try:
        (at,) = struct.unpack_from("<Q", content, _end_of_header(content) + 8 * (blocks - 1))
        (size,) = struct.unpack_from("<i", content, at + 4)
        block = content[at + 8 : at + 8 + size]
        return size == expected or 2 * _count(block) == expected
    except (struct.error, IndexError, KeyError, ValueError):
        return False


def _end_of_header(content: bytes) -> int:
    """Where the table of the blocks' places begins."""
    at = _HEADER
    while content[at]:
        for _ in ("name", "type"):
            at = content.index(b"\0", at) + 1
        at += 4 + struct.unpack_from("<i", content, at)[0]
    return at + 1


def _count(block: bytes) -> int:
    """How many 16-bit numbers a block holds."""
    first, last = struct.unpack_from("<HH", block)
    at = 4 + max(last - first + 1, 0) + 4  # behind the bitmap of numbers that occur, and a length
    low, run, _, bits, _ = struct.unpack_from("<5I", block, at)
    digits = "".join(f"{byte:08b}" for byte in block[at + 20 :])
    lengths, read = _code_lengths(digits, low, run)
    codes = _canonical(lengths)
    begin = -(-read // 8) * 8
    data = digits[begin : begin + bits]
    known = sorted({len(code) for code in codes})
    total = at = 0
    while at < len(data):
        symbol, at = next(
            (codes[code], at + length)
            for length in known
            if (code := data[at : at + length]) in codes
        )
        if symbol == run:  # the number before it, so many times again
            total += int(data[at : at + 8], 2)
            at += 8
        else:
            total += 1
    return total


def _code_lengths(digits: str, low: int, high: int) -> tuple[dict[int, int], int]:
    """Lengths of the codes by symbol, and how many digits their table has."""
    lengths: dict[int, int] = {}
    at, symbol = 0, low
    while symbol <= high:
        length = int(digits[at : at + 6], 2)
        at += 6
        if length == _LONG_RUN:
            symbol += int(digits[at : at + 8], 2) + _NO_CODE
            at += 8
        elif length >= _SHORT_RUN:
            symbol += length - _SHORT_RUN + 2
        else:
            if length:
                lengths[symbol] = length
            symbol += 1
    return lengths, at


def _canonical(lengths: dict[int, int]) -> dict[str, int]:
    """Symbols by their codes, in binary digits: the canonical code of these lengths."""
    by_length = defaultdict(list)
    for symbol, length in lengths.items():  # by rising symbol
        by_length[length].append(symbol)
    codes: dict[str, int] = {}
    code = 0
    for length in range(_LONGEST_CODE, 0, -1):
        for symbol in by_length[length]:
            codes[f"{code:0{length}b}"] = symbol
            code += 1
        code >>= 1
    return codes
