"""Cases, answers and verdicts: what a reader may do with a hostile file, and what is a failure.

A **case** is files, which of them is read, and options. A child process reads it (`reader.py`), as
the commands would, and gives an **answer**: accepted with arrays, refused with an `InputError`, or
something else. The **verdict** is a failure if the reader

- died of a signal (*crash*), gave no answer within `runner.LIMIT_S` (*hang*), raised anything but
  an `InputError` (*traceback*), among it a warning, or a library printed something (*printed*);
- refused without naming the file, in several lines, with control characters or with a traceback in
  its message, as the commands print it (*message*);
- gave different bits when it read the same files twice (*unsteady*). Between the two, glibc is set
  to fill fresh memory with other bytes, so that whatever a library leaves unset differs;
- gave a **made-up number**.

A made-up number is recognised by what is known of the case before anybody reads it, never by our
own readers. Every file is first made whole, by another library or byte by byte, of a formula: a
line at a known row, a temperature that is linear in x, y and z, points that OpenCV projects, a part
and a laser in closed form. Then something is done to it, and one of these rules holds:

whole, cut, claims, sealed
    The file is untouched, or has lost its end, or says that it holds more than it does, or is
    changed where a checksum guards it. Whatever is accepted must be the formula's, at the places
    that the result itself claims, or NaN. (Two losses cannot be seen and are no failure: the end of
    the last number of a text that ends there, within the tolerance of the last row, and elements
    that a text format may leave out, if a note says that they are absent.)
listed
    The file says something of itself (units, orientation, distortion by another name ...) that a
    reader may heed, refuse, or ignore with a note: the formula, or a refusal, or a note.
edited
    Bytes, digits or words are changed where nothing guards them. A flipped bit of a pixel is a
    legitimate other pixel, and nobody can tell: it is no made-up number. What is accepted must
    still be *possible*: finite or NaN, within the limits of its kind, no more of it than the file's
    bytes can hold, centres of lines inside the image. Where the place of the change is known to be
    inside the values, no more values than were changed may differ from the formula's.
"""

from __future__ import annotations

import re
from collections.abc import Callable, Mapping
from dataclasses import dataclass, field
from typing import Any

Result = Mapping[str, Any]
Judge = Callable[[Result], str]
"""What of an accepted result is made up, in words; empty if nothing is."""

MOST_CHARACTERS = 1200  # of a message, its file's name not counted


@dataclass(frozen=True)
class Case:
    """Something to read.

    Attributes
    ----------
    kind : str
        One of `reader.READERS`.
    label : str
        How it was made, such as "png/cut".
    files : dict
        Contents by name; a `str` in place of bytes is "fifo", "folder" or "loop".
    main : str
        The name of the file that is read; empty where none is.
    options : dict
        What the user says.
    judge : callable
        Finds what is made up in an accepted result.
    must_be_read, must_be_refused : bool
        The other outcome is a failure: the file is a whole one of a documented kind, or one that
        nobody can make sense of.
    """

    kind: str
    label: str
    files: dict[str, bytes | str]
    main: str
    judge: Judge
    options: dict[str, Any] = field(default_factory=dict)
    must_be_read: bool = False
    must_be_refused: bool = False

    def __repr__(self) -> str:
        sizes = ", ".join(f"{n} ({len(f)} bytes)" for n, f in self.files.items())
        return f"{self.kind} {self.label}: {sizes} {self.options}"


@dataclass(frozen=True)
class Answer:
    """What came of reading a case.

    Attributes
    ----------
    outcome : str
        "accepted", "refused", "raised", "died" or "hung".
    text : str
        The message, or the traceback.
    result : dict
        Of an accepted one: arrays and notes.
    printed : str
        What appeared on the terminal.
    steady : bool
        Whether both readings gave the same.
    """

    outcome: str
    text: str = ""
    result: dict[str, Any] = field(default_factory=dict)
    printed: str = ""
    steady: bool = True


def verdict(case: Case, answer: Answer) -> str:
    """Say what failed, in a word and its reason; empty if nothing did."""
    if answer.outcome in ("died", "hung", "raised"):
        word = {"died": "crash", "hung": "hang", "raised": "traceback"}[answer.outcome]
        return f"{word}: {answer.text}"
    if not answer.steady:
        return f"unsteady: two readings differ {answer.text}"
    if answer.outcome == "refused":
        if case.must_be_read:
            return f"refused although it is whole: {answer.text}"
        failed = _poor(case, answer.text)
    elif case.must_be_refused:
        failed = f"accepted although nobody can: {_short(answer.result)}"
    else:
        made_up = case.judge(answer.result)
        failed = f"made up: {made_up}" if made_up else ""
    if not failed and answer.printed.strip():
        failed = f"printed: {answer.printed.strip()[:500]!r}"
    return failed


def _short(result: Result) -> str:
    return ", ".join(f"{name} {value!r:.60}" for name, value in result.items())


def _poor(case: Case, text: str) -> str:
    """What is wrong with a refusal's message."""
    name = (
        case.main.rpartition("/")[2] if case.kind != "command" else ""
    )  # there an option is named
    if not text.strip():
        return "message: it is empty"
    if "\n" in text or "\r" in text:
        return f"message: has several lines: {text!r}"
    if re.search(r"[\x00-\x1f\x7f-\x9f]", text):
        return f"message: has control characters: {text!r}"
    if name.isprintable() and name not in text:
        return f"message: does not name {name}: {text!r}"
    if "Traceback" in text:
        return f"message: holds a traceback: {text!r}"
    if len(text) - len(name) > MOST_CHARACTERS:
        return f"message: is {len(text)} characters long: {text[:200]!r}"
    return ""
