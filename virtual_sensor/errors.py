"""The errors that a user is meant to read: each names the file, the element and the remedy."""

import unicodedata
from pathlib import Path


def printable(text: str) -> str:
    """Escape what a terminal would obey in text from a file; ends of lines and tabs stay."""
    return "".join(
        c if c in "\n\t" or (unicodedata.category(c) not in ("Cc", "Zl", "Zp") and c not in TURNS)
        else c.encode("unicode_escape").decode()
        for c in text
    )  # fmt: skip


TURNS = "\u202a\u202b\u202c\u202d\u202e\u2066\u2067\u2068\u2069"  # of the writing direction


class InputError(ValueError):
    """A scene, a field, an option or an output folder that the program cannot work with."""

    def __str__(self) -> str:
        return printable(super().__str__())


class EngineError(RuntimeError):
    """Dr.Jit or Mitsuba cannot run on this machine as things stand."""


class Interrupted(SystemExit):
    """A simulation was stopped by Ctrl-C or a signal, in good order: the same command goes on.

    Attributes
    ----------
    folder : Path
        Of the case.
    time_s : float
        Flow time reached, s.
    code : int
        Status to exit with.
    """

    def __init__(self, folder: Path, time_s: float, code: int) -> None:
        super().__init__(code)
        self.folder = folder
        self.time_s = time_s

    def __str__(self) -> str:
        return f"stopped at {self.time_s:.8g} s of flow; the same command goes on ({self.folder})"
