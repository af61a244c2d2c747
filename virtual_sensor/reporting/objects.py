"""How an object is seen: its picture in a user's axes, and its line, table and picture as HTML.

A drawing is found by its class's name, so that nobody imports what they don't use.
"""

from __future__ import annotations

import base64
import dataclasses
import io
from collections.abc import Callable, Iterator, Mapping
from html import escape
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np
from matplotlib import rc_context
from matplotlib.axes import Axes
from matplotlib.backends.backend_agg import FigureCanvasAgg
from matplotlib.figure import Figure

from virtual_sensor.display import Displayed, brief
from virtual_sensor.errors import InputError
from virtual_sensor.files import written_whole
from virtual_sensor.records import unit_of
from virtual_sensor.reporting.style import YELLOW, style

if TYPE_CHECKING:
    from virtual_sensor.metrology.centres import LineCentres

Draw = Callable[[Axes, Any], object]

_DRAWINGS: dict[str, Draw] = {}
_MIDDLE_GREY = "#808080"  # letters and axes that are read on white as well as on black
_LETTERS = dict.fromkeys(
    ("text.color", "axes.labelcolor", "axes.edgecolor", "xtick.color", "ytick.color"), _MIDDLE_GREY
)
_SMALL_IN, _SMALL_DPI, _SHOWN_PX = (4.4, 2.8), 160, 440
_MOST_NUMBERS = 1 << 20  # whose range is looked for
_MOST_ROWS = 24


def draws(*classes: str) -> Callable[[Draw], Draw]:
    """Have a function draw objects of these classes, such as "metrology.centres.LineCentres"."""

    def register(draw: Draw) -> Draw:
        _DRAWINGS.update(dict.fromkeys(classes, draw))
        return draw

    return register


def names_of(thing: object) -> Iterator[str]:
    """The names of an object's class and of its bases, with their modules below the package."""
    for each in type(thing).__mro__:
        yield f"{each.__module__}.{each.__qualname__}".removeprefix("virtual_sensor.")


def drawing_of(thing: object) -> Draw | None:
    """What draws an object, if there is something to see."""
    return next((_DRAWINGS[name] for name in names_of(thing) if name in _DRAWINGS), None)


def plot(thing: object, axes: Axes | None = None) -> Axes:
    """Draw an object; see `Displayed.plot`."""
    draw = drawing_of(thing)
    kind = type(thing).__name__
    if draw is None:
        raise InputError(f"a {kind} has no picture; to_dataframe() gives its numbers")
    if axes is None:
        from matplotlib import pyplot

        with style():
            _, axes = pyplot.subplots(layout="constrained")
            draw(axes, thing)
        return axes
    if not isinstance(axes, Axes):
        raise InputError(
            f"plot: ax is a {type(axes).__name__}; give an Axes of matplotlib, or none"
        )
    draw(axes, thing)
    return axes


def write_picture(path: Path, thing: object) -> None:
    """Write an object's picture as PNG, SVG or PDF, by the suffix."""
    draw = drawing_of(thing)
    assert draw, "it has a picture"
    with style(), written_whole(path) as temporary:
        figure = Figure(figsize=(6.4, 4.4), dpi=150, layout="constrained")
        draw(figure.add_subplot(), thing)
        figure.savefig(temporary, format=path.suffix.lower().lstrip("."))


# ---------------------------------------------------------------------------------------- HTML


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
    rows = []
    for each in dataclasses.fields(thing):  # type: ignore[arg-type]
        if each.name.startswith("_") or each.metadata.get("internal"):
            continue
        value, kind = getattr(thing, each.name), thing._statuses.get(each.name)
        unit = thing._field_units.get(each.name, unit_of(each.name))
        if kind is None:
            rows.append((each.name, f"{_shown(value)} {unit}".rstrip()))
            continue
        by_key = value if isinstance(value, Mapping) else {"": value}
        for key, numbers in by_key.items():
            name = f"{each.name} of {key}" if key else each.name
            rows += [(name, words) for words in _counted(numbers, kind)]
    cell = "padding:1px 10px 1px 0; text-align:left; vertical-align:top; border:0"
    body = "".join(
        f'<tr style="background:none"><td style="{cell}; opacity:0.7">{escape(name)}</td>'
        f'<td style="{cell}">{escape(words)}</td></tr>'
        for name, words in rows[:_MOST_ROWS]
    )
    return f'<table style="margin:4px 0; border:0; max-width:34em">{body}</table>'


def _counted(status: Any, kind: Any) -> Iterator[str]:
    """How many have each status, with what it means."""
    status = np.asarray(status)
    for member in kind:
        if number := int(np.sum(status == member)):
            words = getattr(member, "message", "")
            yield f"{number} {member.name.lower()}{f': {words}' if words else ''}"


def _shown(value: Any) -> str:
    """A value in a cell: of an array its shape and its range."""
    if not isinstance(value, np.ndarray) or not value.ndim:
        return brief(value)
    if value.size <= 4 and value.dtype.kind in "bufi":
        return f"({', '.join(f'{number:.5g}' for number in value.ravel().tolist())})"
    words = brief(value)
    if value.dtype.kind not in "uif" or not value.size:
        return words
    sample = value.ravel()[:: max(1, value.size // _MOST_NUMBERS)]
    finite = sample[np.isfinite(sample)]
    if not finite.size:
        return f"{words} all NaN"
    missing = 1.0 - finite.size / sample.size
    gaps = f", {100.0 * missing:.2g} % NaN" if missing else ""
    return f"{words} {finite.min():.5g} to {finite.max():.5g}{gaps}"


def _picture(thing: Displayed) -> str:
    """The picture as an image within the page, on whatever ground the page has."""
    draw = drawing_of(thing)
    if draw is None:
        return ""
    with style(), rc_context({**_LETTERS, "font.size": 9.0, "grid.color": f"{_MIDDLE_GREY}40"}):
        figure = Figure(figsize=_SMALL_IN, dpi=_SMALL_DPI, layout="constrained")
        FigureCanvasAgg(figure)
        axes = figure.add_subplot()
        axes.patch.set_alpha(0.0)
        draw(axes, thing)
        file = io.BytesIO()
        figure.savefig(file, format="png", transparent=True)
    coded = base64.b64encode(file.getvalue()).decode("ascii")
    name = escape(f"picture of a {type(thing).__name__}")
    return (
        f'<img alt="{name}" style="width:{_SHOWN_PX}px; max-width:100%; background:none"'
        f' src="data:image/png;base64,{coded}">'
    )


# ------------------------------------------------------------------------------------- drawings


@draws("metrology.centres.LineCentres")
def _line_centres(axes: Axes, line: LineCentres) -> None:
    pixel = line.pixel.reshape(-1, 2)
    axes.plot(pixel[:, 0], pixel[:, 1], ".", markersize=2.0, color=YELLOW)
    axes.invert_yaxis()
    axes.set_xlabel("u, px")
    axes.set_ylabel("v, px")
