"""Objects in a notebook: a line, a table of their fields and a small picture, as HTML.

It is read on white as on black: letters of the page's own colour, pictures without a ground.
"""

from __future__ import annotations

import base64
import dataclasses
import io
from collections import Counter
from collections.abc import Iterator, Mapping
from html import escape
from itertools import islice
from typing import Any

import numpy as np
from matplotlib import rc_context
from matplotlib.backends.backend_agg import FigureCanvasAgg
from matplotlib.figure import Figure

from virtual_sensor.display import Displayed, brief
from virtual_sensor.errors import a
from virtual_sensor.records import unit_of
from virtual_sensor.reporting.objects import drawing_of
from virtual_sensor.reporting.style import style
from virtual_sensor.statuses import StatusEnum

_MIDDLE_GREY = "#808080"  # letters and axes that are read on white as well as on black
_LETTERS = dict.fromkeys(
    ("text.color", "axes.labelcolor", "axes.edgecolor", "xtick.color", "ytick.color"), _MIDDLE_GREY
)
_SMALL_IN, _SMALL_DPI, _SHOWN_PX = (4.4, 2.8), 160, 420
_MARGINS = {"left": 0.17, "right": 0.97, "bottom": 0.18, "top": 0.93}
_MOST_NUMBERS = 1 << 20  # whose range is looked for
_MOST_ROWS, _MOST_KEYS, _WHOLE = 24, 6, 4
"""Rows of a table, keys of a mapping, and numbers of an array that are shown one by one."""


def html_of(thing: Displayed) -> str:
    """An object for a notebook: its line, its fields, and a small picture; it never raises."""
    line = f"<div><strong>{escape(type(thing).__name__)}</strong>{_rest(thing)}</div>"
    parts = []
    for make in (_table, _picture):
        try:
            parts.append(make(thing))
        except Exception:  # a notebook shows what it can
            continue
    return (
        '<div style="font-size:13px; line-height:1.4">'
        f'{line}<div style="display:flex; flex-wrap:wrap; gap:16px; align-items:flex-start">'
        f"{''.join(parts)}</div></div>"
    )


def _rest(thing: object) -> str:
    return escape(repr(thing).removeprefix(type(thing).__name__))


def _table(thing: Displayed) -> str:
    cell = "padding:1px 10px 1px 0; text-align:left; vertical-align:top; border:0"
    body = "".join(
        f'<tr style="background:none"><td style="{cell}; opacity:0.7">{escape(name)}</td>'
        f'<td style="{cell}">{escape(words)}</td></tr>'
        for name, words in islice(_rows(thing), _MOST_ROWS)
    )
    look = "margin:4px 0; border:0; font-size:inherit; color:inherit"
    # As wide as is left beside the picture.
    return f'<div style="flex:1 1 18em; max-width:32em"><table style="{look}">{body}</table></div>'


def _rows(thing: Displayed) -> Iterator[tuple[str, str]]:
    """The names of an object's fields, and what is in them."""
    for each in dataclasses.fields(thing):  # type: ignore[arg-type]
        if each.name.startswith("_") or each.metadata.get("internal"):
            continue
        value, kind = getattr(thing, each.name), thing._statuses.get(each.name)
        unit = thing._field_units.get(each.name, unit_of(each.name))
        if kind is None:
            yield each.name, _shown(value, unit)
            continue
        for key, numbers in (value if isinstance(value, Mapping) else {"": value}).items():
            name = f"{each.name} of {key}" if key else each.name
            yield from ((name, words) for words in _counted(numbers, kind))


def _counted(status: Any, kind: type[StatusEnum]) -> Iterator[str]:
    """How many have each status, with what it means."""
    for member, number in kind.counts(status).items():
        count = f"{number} " if np.ndim(status) else ""
        yield f"{count}{member.name.lower()}: {member.message}"


def _shown(value: Any, unit: str = "") -> str:
    """A value in a cell: of an array its shape and its range, of an object its line."""
    if value is None or (isinstance(value, tuple | list | Mapping | str) and not value):
        return "none"
    if isinstance(value, Mapping):
        named = (f"{key}: {_shown(each)}" for key, each in islice(value.items(), _MOST_KEYS))
        more = f" and {len(value) - _MOST_KEYS} more" if len(value) > _MOST_KEYS else ""
        return "; ".join(named) + more
    if isinstance(value, Displayed):
        return repr(value)
    if isinstance(value, np.ndarray) and not value.size:
        return "none"
    if not isinstance(value, np.ndarray) or not value.ndim:
        return f"{brief(value)} {unit}".rstrip()
    if value.size <= _WHOLE and value.dtype.kind in "bufi":
        return (
            f"({', '.join(f'{number:.5g}' for number in value.ravel().tolist())}) {unit}".rstrip()
        )
    words = brief(value)
    if value.dtype.kind == "U" and len(counts := Counter(value.ravel().tolist())) <= _MOST_KEYS:
        return ", ".join(f"{number} {word}" for word, number in counts.most_common())
    if value.dtype.kind not in "uif":
        return words
    sample = value.ravel()[:: max(1, value.size // _MOST_NUMBERS)]
    finite = sample[np.isfinite(sample)]
    if not finite.size:
        return f"{words} all NaN"
    missing = 1.0 - finite.size / sample.size
    gaps = f", {100.0 * missing:.2g} % NaN" if missing else ""
    return f"{words} {finite.min():.5g} to {finite.max():.5g} {unit}".rstrip() + gaps


def _picture(thing: Displayed) -> str:
    """The picture as an image within the page, on whatever ground the page has."""
    draw = drawing_of(thing)
    if draw is None:
        return ""
    with style(), rc_context({**_LETTERS, "font.size": 9.0, "grid.color": f"{_MIDDLE_GREY}40"}):
        figure = Figure(figsize=_SMALL_IN, dpi=_SMALL_DPI, layout=None)
        FigureCanvasAgg(figure)
        figure.subplots_adjust(**_MARGINS)
        axes = figure.add_subplot()
        axes.patch.set_alpha(0.0)
        draw(axes, thing)
        file = io.BytesIO()
        figure.savefig(file, format="png", transparent=True)
    coded = base64.b64encode(file.getvalue()).decode("ascii")
    name = escape(f"picture of {a(type(thing).__name__)}")
    return (
        f'<img alt="{name}" style="width:{_SHOWN_PX}px; max-width:100%; background:none"'
        f' src="data:image/png;base64,{coded}">'
    )
