"""Whatever the commands print goes through here, and can be printed.

Control characters are escaped, what an encoding lacks is written otherwise, a stream that can't be
written ends no command, and no number in a table is cut.
"""

import codecs
import errno
import io
import logging
import os
import sys
from collections.abc import Iterator
from contextlib import contextmanager, suppress
from pathlib import Path
from typing import Any, TextIO

from rich.console import Console as RichConsole
from rich.table import Table
from rich.text import Text

from virtual_sensor.errors import printable

_LONGEST_NUMBER = 24
"""Cells up to this length, in characters, are not wrapped."""

_IN_ASCII = {"µ": "u", "μ": "u", "°": "deg", "±": "+-", "×": "x", "·": "*", "²": "^2", "–": "-"}
_IN_ASCII |= {"σ": "sigma", "≤": "<=", "≥": ">=", "…": "...", "→": "->", "•": "*", "−": "-"}


def one_line(text: str) -> str:
    """A text whose line ends are escapes too."""
    return printable(text.strip()).replace("\n", "\\n")


class Console(RichConsole):
    """A console for paths and messages that may hold [brackets], :colons: and control characters.

    A table that does not fit without cutting a number is printed as a list.
    """

    def __init__(self, **options: Any) -> None:
        super().__init__(markup=False, emoji=False, highlight=False, **options)

    def render_str(self, text: str, **options: Any) -> Text:
        """Turn a string, of a table's cell too, into what is printed."""
        return super().render_str(printable(text), **options)

    def print(self, *objects: Any, **options: Any) -> None:
        """Print tables, and texts, which the terminal wraps: so their paths can be copied."""
        for each in objects:
            if isinstance(each, Table) and not _fits(each, self.width):
                for text in _as_list(each):
                    super().print(text, soft_wrap=True)
            else:
                super().print(each, **{"soft_wrap": isinstance(each, str)} | options)


console = Console()
errors = Console(stderr=True)


def _fits(table: Table, width: int) -> bool:
    """Whether a table can be printed without cutting a word; its short cells are not wrapped."""
    needed = 1
    for column in table.columns:
        texts = [str(text) for text in (column.header, *column.cells)]
        column.overflow = "fold"
        column.no_wrap = max(map(len, texts)) <= _LONGEST_NUMBER and len(table.columns) > 1
        words = texts if column.no_wrap else [word for text in texts for word in text.split()]
        # Of a longer word, such as a path, some lines can be read.
        needed += 3 + min(max(map(len, words), default=0), _LONGEST_NUMBER)
    return needed <= width


def _as_list(table: Table) -> Iterator[str]:
    """The rows of a table below each other, a line for each cell."""
    if table.title:
        yield f"{table.title}"
    first, *others = table.columns
    for number, name in enumerate(first.cells):
        yield " ".join(filter(None, (str(first.header), str(name))))
        for column in others:
            heading = f"{column.header}: " if column.header else ""
            yield f"  {heading}{list(column.cells)[number]}"


class _Stream:
    """A text stream that never fails: what it can't write is dropped, and the reason recorded."""

    def __init__(self, stream: TextIO) -> None:
        if isinstance(stream, io.TextIOWrapper):
            stream.reconfigure(errors="virtual_sensor")
        self._stream = stream
        self.fault: OSError | None = None

    def write(self, text: str) -> int:
        self._attempt(lambda: self._stream.write(text))
        return len(text)

    def flush(self) -> None:
        self._attempt(self._stream.flush)

    def _attempt(self, act: Any) -> None:
        try:
            act()
        except OSError as error:
            self.fault = self.fault or error
            # What is still in the buffer would fail again when Python ends.
            with suppress(OSError, ValueError):
                nowhere = os.open(os.devnull, os.O_WRONLY)
                os.dup2(nowhere, self._stream.fileno())
                os.close(nowhere)

    def __getattr__(self, name: str) -> Any:
        return getattr(self._stream, name)


def _nowhere() -> TextIO:
    """Where to write if the program was started without a stream."""
    return Path(os.devnull).open("w", encoding="utf-8")


class _Notes(logging.Handler):
    """Prints what the program logs, as notes."""

    def emit(self, record: logging.LogRecord) -> None:
        console.print(f"Note: {record.getMessage()}", style="yellow")


@contextmanager
def streams() -> Iterator[list[OSError]]:
    """Make standard output and error accept any text; give what went wrong with the output.

    A pipe whose reader has gone is nothing wrong.
    """
    codecs.register_error("virtual_sensor", _otherwise)
    faults: list[OSError] = []
    before = sys.stdout, sys.stderr
    safe = [_Stream(stream or _nowhere()) for stream in before]
    sys.stdout, sys.stderr = safe
    notes, log = _Notes(), logging.getLogger("virtual_sensor")
    log.addHandler(notes)
    try:
        yield faults
    finally:
        for stream in safe:
            stream.flush()
        if safe[0].fault and safe[0].fault.errno != errno.EPIPE:
            faults.append(safe[0].fault)
        log.removeHandler(notes)
        sys.stdout, sys.stderr = before


def _otherwise(error: UnicodeError) -> tuple[str, int]:
    """Write characters that an encoding lacks otherwise: in ASCII, or as an escape."""
    assert isinstance(error, UnicodeEncodeError)
    lacking = error.object[error.start : error.end]
    plain = "".join(_IN_ASCII.get(c) or c.encode("unicode_escape").decode() for c in lacking)
    return plain, error.end
