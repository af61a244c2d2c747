"""A sweep's files: the table over all cases, a picture of it, a page with a link to each case."""

from __future__ import annotations

import re
from collections.abc import Iterable, Mapping, Sequence
from dataclasses import dataclass
from functools import partial
from itertools import product
from math import ceil
from pathlib import Path
from typing import Any
from urllib.parse import quote

import matplotlib
import numpy as np
from matplotlib.axes import Axes
from numpy.typing import NDArray

from virtual_sensor.files import RESULTS_SIGN
from virtual_sensor.records import UNITS
from virtual_sensor.reporting.files import FileOf, write_results
from virtual_sensor.reporting.page import PAGE, Details, Listing, Page, Section
from virtual_sensor.reporting.pictures import Panel, Picture, draw_picture
from virtual_sensor.reporting.style import (
    LINES,
    MARKERS,
    colour,
    colours,
    decimal_ticks,
    drawable,
    letters_on,
)
from virtual_sensor.reporting.tables import Column, Link, TextTable, text_table
from virtual_sensor.reporting.words import counted, listed
from virtual_sensor.studies.sweep import CASES, MARK, CaseStatus
from virtual_sensor.studies.sweep_table import Sweep, SweepSummary, SweepTable, SweptParameter

TABLE, PICTURE = "sweep.csv", "sweep.png"
FILES = (
    FileOf(TABLE, "The table over all cases.", SweepTable),
    FileOf(PICTURE, "Errors and centres over the swept parameters."),
    FileOf(PAGE, "The same as a page, with a link to each case."),
    FileOf(
        RESULTS_SIGN, "What was swept, which cases failed, all notes; written last.", SweepSummary
    ),
    FileOf(MARK, "Says whose folder it is; written first."),
    FileOf(f"{CASES}/*", "A folder for each case, with all files that measure writes."),
)

Array = NDArray[np.float64]
Rows = list[int]

_SPOKEN = {"degree": "deg", "degrees": "deg", "degC": "c", "%": "percent", "e": "electrons"}
_USUAL_UNITS = {  # of parameters of which the scene says nothing
    **dict.fromkeys(("alpha", "beta", "tilt", "fan"), "°"),
    **dict.fromkeys(("along", "line_length", "line_radius", "step", "blur"), "mm"),
    **{"temperature": "°C", "time": "s", "width": "px", "height": "px", "tolerance": "px"},
}
_FIGURES = ("section_rms_um", "line_rms_px", "dots_largest_u_px", "dots_largest_v_px", "centres")
_STATUS_WORDS = {
    CaseStatus.OK.value: "measured",
    CaseStatus.NOTHING_FOUND.value: "no line found",
    CaseStatus.FAILED.value: "failed",
}
_SIGNS = {CaseStatus.FAILED.value: ("x", "×"), CaseStatus.NOTHING_FOUND.value: ("o", "○")}
_HEAT_MAP = 4  # values of both parameters, from which on two of them make a heat map
_MOST_CURVES, _MOST_FACETS = 8, 6  # that a reader can distinguish in one panel; panels of one kind
_WRITTEN_CELLS = 100  # of a heat map with numbers in them
_SAME = 0.015  # of the axis: curves that are no farther apart coincide
_BESIDE = 0.06  # of a word's place: marks of several curves
_WIDER = 1.1  # widths of lines, from which on they are shown
_LOGARITHMIC = 30.0  # largest over least value, from which on an axis is so
_SHOWN_NOTES = 10


def save(result: Sweep, folder: Path, command: str) -> None:
    """Write table, picture, page and, last, the summary beside the cases.

    The table holds no times: the same cases give the same bytes.

    Raises
    ------
    InputError
        If the files can't be written.
    """
    picture = draw(result)
    contents = {
        TABLE: result.table,
        PICTURE: picture,
        PAGE: page(result, picture, command),
        RESULTS_SIGN: result.summary,
    }
    write_results(folder, FILES, contents)


def unit_of(parameter: SweptParameter) -> str:
    """Unit of a parameter, from what the scene says of it ("of the part, degC: chooses ...")."""
    for part in re.split("[,;:]", parameter.words):
        word = part.strip()
        if unit := UNITS.get(_SPOKEN.get(word, word.lower())):
            return unit
    return "" if parameter.words else _USUAL_UNITS.get(parameter.name, "")


def _is_number(value: str) -> bool:
    try:
        return bool(np.isfinite(float(value)))
    except ValueError:
        return False


@dataclass(frozen=True)
class _Quantity:
    """A figure of each case, and what panels say of it."""

    title: str
    label: str
    values: Array
    shape: str = "{:.3g}"
    signed: bool = False

    @property
    def known(self) -> Array:
        return self.values[np.isfinite(self.values)]


def _state(table: SweepTable) -> str:
    """The state whose figures are shown: hot, or cold of parts that are only measured cold."""
    return "hot" if np.isfinite(table.hot_centres).any() else "cold"


def _quantities(table: SweepTable) -> dict[str, _Quantity]:
    """What is shown of each case, by the heading of its column; the user's first question first."""
    state = _state(table)
    error, line, u, v, centres = (getattr(table, f"{state}_{name}") for name in _FIGURES)
    dots = np.fmax(u, v)
    of_dots = bool(np.isfinite(dots).any() and not np.isfinite(line).any())
    size, things, count = (
        ("largest", "Dots", "dots") if of_dots else ("rms", "Line centres", "centres")
    )
    shift, apart = table.largest_measured_shift_um, np.where(np.isfinite(line), line, dots)
    return {
        "error, µm": _Quantity(f"Error of the section measured {state}", "rms in µm", error),
        "shift, µm": _Quantity(
            "Shift of the probe rays' points by hot air", "largest in µm", shift
        ),
        f"{size}, px": _Quantity(
            f"Found minus ray search, {state}", f"{size} in px", apart, "{:.4f}"
        ),
        count: _Quantity(f"{things} found, {state}", "number", centres, "{:.0f}"),
        **_of_profiles(table, state),
    }


def _of_profiles(table: SweepTable, state: str) -> dict[str, _Quantity]:
    """What blur and noise make of the line, where frames are recorded or its width is another."""
    width, shift, noise, speckle = (
        getattr(table, f"{state}_{name}_px")
        for name in ("line_width", "line_shift", "noise", "speckle")
    )
    known = width[np.isfinite(width)]
    recorded = np.isfinite(noise).any()
    if not recorded and not (known.size and known.max() > _WIDER * known.min()):
        return {}
    found = {
        "width, px": _Quantity(f"Width of the line, {state}", "standard deviation in px", width),
        "shift, px": _Quantity(
            f"Line minus ray search, {state}", "mean in px", shift, "{:+.4f}", signed=True
        ),
        "noise, px": _Quantity(f"What noise makes of it, {state}", "rms in px", noise),
        "speckle, px": _Quantity(f"What speckle makes of it, {state}", "rms in px", speckle),
    }
    return {head: each for head, each in found.items() if each.known.size}


# The picture.


@dataclass(frozen=True)
class _Axis:
    """A swept parameter along an axis: numbers at their place, words side by side."""

    name: str
    unit: str
    values: tuple[str, ...]
    numeric: bool

    @staticmethod
    def of(parameter: SweptParameter) -> _Axis:
        numeric = all(map(_is_number, parameter.values))
        values = tuple(sorted(parameter.values, key=float)) if numeric else parameter.values
        return _Axis(parameter.name, unit_of(parameter), values, numeric)

    @property
    def label(self) -> str:
        return drawable(self.name) + (f" in {self.unit}" if self.unit else "")

    def label_of(self, value: str) -> str:
        """A value as a label has it: "15°", "900 °C"."""
        unit = self.unit if _is_number(value) else ""
        return (drawable(value) or "none") + (unit if unit in ("", "°") else f" {unit}")

    def given(self, table: SweepTable) -> tuple[str, ...]:
        """Its value in each case."""
        return table.parameters.get(self.name, ("",) * len(table))

    def places(self, table: SweepTable) -> Array:
        """Where each case lies along the axis."""
        given = self.given(table)
        return np.array([float(v) if self.numeric else self.values.index(v) for v in given], float)


_NO_AXIS = _Axis("", "", ("",), numeric=False)


def draw(result: Sweep) -> Picture:
    """Draw a sweep: curves over one parameter, one for each value of a second, or heat maps.

    Further parameters make a panel for each combination.
    """
    title = f"Sweep of {drawable(Path(result.summary.scene).stem)}"
    over = listed([drawable(parameter.name) for parameter in result.summary.swept])
    return draw_picture(f"{title} over {over}" if over else title, panels_of(result))


def panels_of(result: Sweep) -> list[Panel]:
    """Its panels: the quantities that are known, for each combination of further parameters."""
    table, swept = result.table, result.summary.swept
    quantities = list(_quantities(table).values())
    quantities = [each for each in quantities if each.known.size] or quantities[-1:]
    first, second, rest, mapped = _arranged(swept)
    facets = list(_facets(table, rest))
    return [
        Panel(
            "\n".join(filter(None, (quantity.title, words))),
            partial(
                _draw_map if mapped else _draw_curves,
                table=table,
                quantity=quantity,
                rows=rows,
                first=first,
                second=second,
            ),
            ", ".join(filter(None, (_alt(quantity, rows, first, second), words))),
        )
        for words, rows in facets[:_MOST_FACETS]  # sweep.csv and the page's table have all
        for quantity in (quantities if len(facets) == 1 else quantities[::2])
    ]


def _arranged(swept: Sequence[SweptParameter]) -> tuple[_Axis, _Axis, list[_Axis], bool]:
    """Which parameter lies along the axis, which makes curves, and the others.

    Two of many numbers make a map; then the last is True.
    """
    axes = [_Axis.of(parameter) for parameter in swept]
    many = [axis for axis in axes if axis.numeric and len(axis.values) >= _HEAT_MAP]
    if mapped := len(many) >= 2:
        first, second = many[:2]
    else:
        numeric = [axis for axis in axes if axis.numeric and len(axis.values) > 2]
        first = max(numeric or axes, key=lambda axis: len(axis.values), default=_NO_AXIS)
        few = [axis for axis in axes if axis != first and len(axis.values) <= _MOST_CURVES]
        second = few[0] if few else _NO_AXIS
    return first, second, [axis for axis in axes if axis not in (first, second)], mapped


def _undrawn(result: Sweep) -> list[str]:
    """Says that there are more combinations than panels, if so."""
    rest = _arranged(result.summary.swept)[2]
    count = len(list(_facets(result.table, rest)))
    if count <= _MOST_FACETS:
        return []
    names = listed([axis.name for axis in rest])
    return [f"The first {_MOST_FACETS} of {count} combinations of {names} are drawn."]


def _facets(table: SweepTable, rest: Sequence[_Axis]) -> Iterable[tuple[str, Rows]]:
    """Each combination of the other parameters that there is, in words, and its rows."""
    given = list(zip(*(axis.given(table) for axis in rest), strict=True)) or [()] * len(table)
    for values in product(*(axis.values for axis in rest)):
        if rows := [row for row, each in enumerate(given) if each == values]:
            pairs = zip(rest, values, strict=True)
            yield ", ".join(f"{drawable(a.name)} {a.label_of(value)}" for a, value in pairs), rows


def _alt(quantity: _Quantity, rows: Rows, first: _Axis, second: _Axis) -> str:
    known = quantity.values[rows][np.isfinite(quantity.values[rows])]
    over = listed([axis.name for axis in (first, second) if axis.name])
    words = f"{quantity.title} over {over}" if over else quantity.title
    if not known.size:
        return f"{words}: no case has a value"
    return f"{words}, {quantity.label}: {known.min():.3g} to {known.max():.3g}"


def _draw_curves(
    axes: Axes, table: SweepTable, quantity: _Quantity, rows: Rows, first: _Axis, second: _Axis
) -> None:
    """A curve over the first parameter for each value of the second.

    Crosses at the foot are cases that failed, rings those without a line.
    """
    given, place, words = second.given(table), first.places(table), not first.numeric
    curves = {value: [row for row in rows if given[row] == value] for value in second.values}
    curves = {value: each for value, each in curves.items() if each}
    shades = _shades(list(curves), second, _state(table))
    drawn: dict[str, tuple[Array, Array]] = {}
    seen: dict[str, str] = {}
    for number, (value, each) in enumerate(curves.items()):
        behind = len(curves) - 1 - number  # coinciding curves frame one another
        ordered = np.array(each)[np.argsort(place[each], kind="stable")]
        drawn[value] = x, y = place[ordered], quantity.values[ordered]
        axes.plot(
            x + (_BESIDE * (number - (len(curves) - 1) / 2.0) if words else 0.0),
            y,
            color=shades[value],
            ls="" if words else LINES[number % len(LINES)],  # between words there is nothing
            lw=min(1.2 + 0.8 * behind, 4.0),
            marker=MARKERS[number % len(MARKERS)],
            ms=6.0 if words else 4.0 + 1.5 * behind,
            mfc="white" if len(curves) > 1 else shades[value],
        )
        for status, (marker, sign) in _SIGNS.items():
            if marked := [row for row in each if table.status[row] == status]:
                seen[status] = f"{sign} {_STATUS_WORDS[status]}"
                axes.plot(
                    *(place[marked], np.full(len(marked), 0.03 + 0.055 * number)),
                    marker=marker,
                    ls="",
                    ms=7,
                    mew=2,
                    mfc="none",
                    color=shades[value],
                    transform=axes.get_xaxis_transform(),
                    clip_on=False,
                )
    known = quantity.known
    if _wide(known) and not quantity.signed:
        axes.set(yscale="log", ylim=(known.min() / 1.3, known.max() * 1.3))
        decimal_ticks(axes.yaxis, fine=True)
    elif quantity.signed:
        axes.axhline(0.0, color="0.6", lw=0.8)
    else:
        axes.set_ylim(0.0, 1.12 * (known.max(initial=0.0) or 1.0))
    _ticks(axes, first)
    signs = f"({', '.join(seen.values())})" if seen else ""
    axes.set(xlabel="   ".join(filter(None, (first.label, signs))), ylabel=quantity.label)
    if second.name:
        _label_ends(axes, drawn, second, shades)


def _shades(values: list[str], second: _Axis, state: str) -> dict[str, str]:
    """Colours of curves: numbers from dark to light, words as on every page, one as its state."""
    if not second.name:
        return dict.fromkeys(values, colour(state))
    if not second.numeric:
        return colours(values)
    scale = matplotlib.colormaps["cividis"](np.linspace(0.0, 0.8, len(values)))
    return dict(zip(values, map(matplotlib.colors.to_hex, scale), strict=True))


def _ticks(axes: Axes, axis: _Axis) -> None:
    if axis.numeric and len(axis.values) <= 8:
        axes.set_xticks([float(value) for value in axis.values], [*map(drawable, axis.values)])
    elif not axis.numeric:
        nothing = "none" if axis.name else "the scene"
        words = [drawable(Path(value).name[-24:]) or nothing for value in axis.values]
        turned = {"rotation": 25, "ha": "right"} if sum(map(len, words)) > 50 else {}
        axes.set_xticks(range(len(words)), words, **turned)
        axes.set_xlim(-0.5, len(words) - 0.5)


def _wide(known: Array) -> bool:
    """Whether values span more than a linear axis shows: it would hide the least."""
    return bool(known.size and known.min() > 0.0 and known.max() > _LOGARITHMIC * known.min())


def _label_ends(
    axes: Axes,
    drawn: Mapping[str, tuple[Array, Array]],
    second: _Axis,
    shades: Mapping[str, str],
) -> None:
    """Write each curve's value at its right end; curves that coincide have one label."""
    axes.autoscale_view()  # now, as the places of its points are asked for
    to_axes = axes.transData - axes.transAxes
    points = {value: to_axes.transform(np.column_stack(curve)) for value, curve in drawn.items()}
    groups: dict[str, list[str]] = {}
    for value, curve in points.items():
        same = (each for each in groups if _coincide(curve, points[each]))
        groups.setdefault(next(same, value), []).append(value)
    known = {value: points[value][np.isfinite(points[value][:, 1])] for value in groups}
    heights = {value: each[-1, 1] if len(each) else 0.0 for value, each in known.items()}
    ordered = sorted(groups, key=lambda value: heights[value])
    places = _spread(np.array([heights[value] for value in ordered]), 0.07)
    for value, place in zip(ordered, places, strict=True):
        alike = len(groups[value]) == len(drawn) > 1
        words = "all alike" if alike else "\n= ".join(map(second.label_of, groups[value]))
        shade = shades[value] if letters_on(shades[value]) == "white" else "#333333"
        axes.annotate(
            words if len(known[value]) else f"{words}: none",
            known[value][-1] if len(known[value]) else (1.0, place),
            xytext=(1.045, place),
            xycoords="axes fraction",
            va="center",
            fontsize=9.5,
            color="black" if alike else shade,
            arrowprops={"arrowstyle": "-", "lw": 0.6, "color": "#999999", "shrinkB": 5},
            annotation_clip=False,
        )
    heading = drawable(second.name)
    axes.text(1.045, places[-1] + 0.07, heading, transform=axes.transAxes, fontsize=9.5)


def _coincide(one: Array, other: Array) -> bool:
    """Whether curves of points (N, 2), in shares of the axes, can't be told apart."""
    same = one.shape == other.shape
    return same and np.allclose(one, other, rtol=0.0, atol=_SAME, equal_nan=True)


def _spread(places: Array, gap: float) -> Array:
    """Ascending places moved apart to a gap at least, as little as can be, and none above 1."""
    steps = gap * np.arange(len(places))
    return np.minimum(np.maximum.accumulate(places - steps) + steps, 1.0 - steps[::-1])


def _draw_map(
    axes: Axes, table: SweepTable, quantity: _Quantity, rows: Rows, first: _Axis, second: _Axis
) -> None:
    """A cell for each pair of values, with the number in it where there is room."""
    cells = np.full((len(second.values), len(first.values)), np.nan)
    places = {
        row: (second.values.index(second.given(table)[row]), first.values.index(value))
        for row, value in enumerate(first.given(table))
        if row in rows
    }
    for row, at in places.items():
        cells[at] = quantity.values[row]
    wide, few = _wide(quantity.known) and not quantity.signed, cells.size <= _WRITTEN_CELLS
    drawn = axes.imshow(cells, aspect="auto", origin="lower", norm="log" if wide else "linear")
    if np.isfinite(cells).any():
        drawn.set_clim(quantity.known.min(), quantity.known.max())
    bar = axes.figure.colorbar(drawn, ax=axes, label=quantity.label, pad=0.02)
    if wide:
        decimal_ticks(bar.ax.yaxis, fine=True)
    axes.grid(False)
    for row, at in places.items():
        style: dict[str, Any] = {"ha": "center", "va": "center"}
        if table.status[row] != CaseStatus.OK:
            words = _STATUS_WORDS[table.status[row]] if few else "×"
            axes.text(*at[::-1], words, color=colour("failed"), **style)
        if few and np.isfinite(cells[at]):
            shade = matplotlib.colors.to_hex(drawn.cmap(drawn.norm(cells[at])))
            style |= {"fontsize": 8.5, "color": letters_on(shade)}
            axes.text(*at[::-1], f"{cells[at]:.3g}", **style)
    for axis, set_ticks in ((first, axes.set_xticks), (second, axes.set_yticks)):
        some = range(0, len(axis.values), ceil(len(axis.values) / 9))
        set_ticks(some, [drawable(axis.values[i]) for i in some])
    axes.set(xlabel=first.label, ylabel=second.label)


# The page.


def table(result: Sweep, links: bool = False) -> TextTable:
    """The figures of all cases that a reader asks for first; on a page with links to the cases."""
    found, swept = result.table, result.summary.swept
    shown = {head: each for head, each in _quantities(found).items() if each.known.size}
    if not links:
        shown.pop("shift, µm", None)  # 80 letters of a console hold no more
    rows = [
        {
            "case": _link(end.case.name, found.folder[i]) if links else end.case.name,
            "parameters": {p.name: found.parameters[p.name][i] for p in swept},
            "status": _STATUS_WORDS[found.status[i]],
        }
        | {head: quantity.values[i] for head, quantity in shown.items()}
        for i, end in enumerate(result.finished)
    ]
    names = [] if swept and not links else [Column("case")]
    given = [Column(f"parameters.{p.name}", _Axis.of(p).label.replace(" in ", ", ")) for p in swept]
    figures = [Column(head, head, quantity.shape) for head, quantity in shown.items()]
    return text_table(
        rows,
        [*names, *given, Column("status"), *figures],
        emphasised=[status != CaseStatus.OK.value for status in found.status],
    )


_TABLE_WORDS = (
    "Error: distance of the measured points from the part's true section, rms. Shift: how far hot"
    " air moves the measured points of the probe rays, at most. In px: the line (or dots) that was"
    " found minus ray search. A case's name leads to its own page."
)


def _link(name: str, folder: str) -> str | Link:
    return Link(name, quote(f"{folder}/{PAGE}")) if folder else name


def lead(result: Sweep) -> str:
    """How many cases there are, where the error is largest, and where least."""
    summary, error = result.summary, next(iter(_quantities(result.table).values())).values
    counts = {status: result.table.status.count(status) for status in _STATUS_WORDS}
    parts = [
        f"{counts[status]} {words}" for status, words in _STATUS_WORDS.items() if counts[status]
    ]
    over = listed([parameter.name for parameter in summary.swept])
    words = f"{counted(summary.cases, 'case')}{f' over {over}' if over else ''}: {listed(parts)}."
    if np.isfinite(error).sum() < 2:
        return words
    most, least = int(np.nanargmax(error)), int(np.nanargmin(error))
    worst, best = (
        ", ".join(f"{p.name}={result.table.parameters[p.name][row]}" for p in summary.swept)
        for row in (most, least)
    )
    return (
        f"{words} The section measured {_state(result.table)} is wrong by {error[most]:.3g} µm rms"
        f" at {worst}, where it is worst, and by {error[least]:.3g} µm at {best}, where it is best."
    )


def page(result: Sweep, picture: Picture, command: str) -> Page:
    """The page of a sweep."""
    summary = result.summary
    swept = [
        p.to_dict()
        | {"unit": unit_of(p), "values": ", ".join(value or "(empty)" for value in p.values)}
        for p in summary.swept
    ]
    sections = [
        Section("Over the parameters", *_undrawn(result), picture),
        Section("Cases", _TABLE_WORDS, table(result, links=True)),
    ]
    if summary.failed:
        why = tuple(f"{name}: {message}" for name, message in summary.failed.items())
        sections.append(Section("Cases that failed", Listing(why)))
    if swept:
        heads = {"name": "parameter", "unit": "", "values": "", "words": "the scene's words"}
        columns = [Column(name, head) for name, head in heads.items()]
        sections.append(Section("Parameters", text_table(swept, columns)))
    if summary.notes:
        notes = Listing(summary.notes)
        many = len(summary.notes) > _SHOWN_NOTES
        shown = Details(f"All {len(summary.notes)} notes", (notes,)) if many else notes
        sections.append(Section("Notes", shown))
    name = Path(summary.scene).stem
    return Page(f"Sweep of {name}", lead(result), tuple(sections), command, summary.made_with)
