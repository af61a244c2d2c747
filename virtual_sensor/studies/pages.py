"""What the pages of results share: their look, their tables, times in words."""

from collections.abc import Sequence
from html import escape

import numpy as np

_PREFIXES = ((1.0, "s"), (1e-3, "ms"), (1e-6, "µs"), (1e-9, "ns"))
_STYLE = """\
body { font: 15px/1.45 sans-serif; max-width: 90em; margin: 2em auto; padding: 0 1em; color: #222; }
table { border-collapse: collapse; font-size: 13px; margin-bottom: 1.5em; }
td, th { border: 1px solid #ccc; padding: 3px 7px; text-align: left; vertical-align: top; }
th { background: #f2f2f2; }
tr.front td { font-weight: bold; background: #eef6fb; }
img { max-width: 100%; border: 1px solid #ddd; margin: 0.5em 0 1.5em; }
"""


def html_head(title: str) -> list[str]:
    """The lines with which a page begins, its title included."""
    return [
        "<!DOCTYPE html>",
        '<html lang="en"><head><meta charset="utf-8">',
        f"<title>{escape(title)}</title><style>{_STYLE}</style></head><body>",
        f"<h1>{escape(title)}</h1>",
    ]


def told_time(seconds: float) -> str:
    """A time with three digits, in the unit that it is best read in."""
    if not np.isfinite(seconds):
        return "unknown"
    scale, unit = next((p for p in _PREFIXES if abs(seconds) >= p[0]), _PREFIXES[-1])
    return f"{seconds / scale:.3g} {unit}"


def html_table(
    head: Sequence[str], rows: Sequence[Sequence[str]], bold: Sequence[bool] | None = None
) -> str:
    """A table; its rows that are to be seen first in bold."""
    marks = ['<tr class="front">' if b else "<tr>" for b in bold or [False] * len(rows)]
    lines = ["<table><tr>" + "".join(f"<th>{escape(text)}</th>" for text in head) + "</tr>"]
    lines += [
        mark + "".join(f"<td>{escape(text)}</td>" for text in row) + "</tr>"
        for mark, row in zip(marks, rows, strict=True)
    ]
    return "\n".join([*lines, "</table>"])
