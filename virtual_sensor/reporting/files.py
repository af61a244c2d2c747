"""What the data dictionary knows of the files that a command writes."""

from __future__ import annotations

from dataclasses import dataclass


@dataclass(frozen=True)
class FileOf:
    """A file that a command writes.

    Attributes
    ----------
    pattern : str
        Its name, with ``*`` where it varies: "line_*.csv".
    words : str
        What it holds.
    kind : type or None
        The `Record` or `Table` whose documented fields it holds; None of pictures and pages.
    """

    pattern: str
    words: str
    kind: type | None = None
