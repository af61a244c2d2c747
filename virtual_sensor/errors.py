"""The errors that a user is meant to read: each names the file, the element and the remedy."""

import unicodedata
from collections.abc import Iterable, Iterator, Sequence
from contextlib import contextmanager
from pathlib import Path
from typing import Any

LONGEST_MESSAGE = 600  # behind its place, in characters


def printable(text: str) -> str:
    r"""A text whose control characters are escapes, such as ``\x1b``; line ends and tabs stay."""
    if text.isprintable():
        return text
    return "".join(c if _is_harmless(c) else c.encode("unicode_escape").decode() for c in text)


def _is_harmless(character: str) -> bool:
    return character.isprintable() or character in "\n\t" or unicodedata.category(character) == "Zs"


def cause_of(error: Exception) -> str:
    """The first line of what a library's error says; its kind if it says nothing."""
    return f"{error}".partition("\n")[0][:200] or type(error).__name__


def few(names: Sequence[str], most: int) -> str:
    """Names for a message: so many at most, and how many more there are."""
    more = f" and {len(names) - most} more" if len(names) > most else ""
    return f"{', '.join(names[:most])}{more}"


def a(noun: str) -> str:
    """A noun with its article: "a Frame", "an IndexField"."""
    return f"{'an' if noun[:1].lower() in 'aeiou' else 'a'} {noun}"


def short(value: Any) -> str:
    """How a value is written in a message, however long it is."""
    try:
        text = " ".join(repr(value).split())
    except ValueError:  # of an integer with too many digits
        text = a(type(value).__name__)
    return text if len(text) <= 40 else f"{text[:37]}..."


def nearest(name: object, names: Iterable[str]) -> str:
    """A question for a message, "; did you mean 'beta'?", if a name is like another; else ""."""
    from difflib import get_close_matches  # few names are wrong

    by_lower = {known.lower(): known for known in names}
    found = get_close_matches(f"{name}".lower(), by_lower, 1)
    return f"; did you mean '{by_lower[found[0]]}'?" if found else ""


class InputError(ValueError):
    """A scene, a field, an option or an output folder that the program cannot work with."""

    def __str__(self) -> str:
        return printable(super().__str__())


class NothingFoundError(InputError):
    """An image without a line, where there are no results without one."""


@contextmanager
def naming(place: object) -> Iterator[None]:
    """Put a place, such as a file or an element of it, before the words of an InputError, once.

    A long text, such as a damaged file may make, is quoted in part.
    """
    try:
        yield
    except InputError as error:
        said = f"{error}"
        if said.startswith(f"{place}: "):
            raise
        if len(said) > LONGEST_MESSAGE:
            said = f"{said[: LONGEST_MESSAGE - 100]}...{said[-100:]}"
        raise type(error)(f"{place}: {said}") from None


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
