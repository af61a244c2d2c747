"""A sweep's files: the table over all cases, a picture of it, a page with a link to each case."""

from __future__ import annotations

from collections.abc import Callable, Iterable, Mapping, Sequence
from dataclasses import dataclass
from itertools import product
from pathlib import Path
from urllib.parse import quote

import matplotlib
import numpy as np
from matplotlib.axes import Axes
from numpy.typing import NDArray

from virtual_sensor.files import RESULTS_SIGN
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
from virtual_sensor.reporting.words import counted, in_words, listed
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
Rows = Sequence[int]

_UNITS = {"degrees": "°", "degree": "°", "deg": "°", "degC": "°C", "um": "µm"}
_UNITS |= {unit: unit for unit in ("mm", "px", "s", "nm", "K", "W", "%", "e")}
_USUAL_UNITS = {  # of parameters of which the scene says nothing
    **dict.fromkeys(("alpha", "beta", "tilt", "fan"), "°"),
    **dict.fromkeys(("along", "line_length", "line_radius", "step", "blur"), "mm"),
    **{"temperature": "°C", "time": "s", "width": "px", "height": "px", "tolerance": "px"},
}
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
    for part in parameter.words.replace(";", ",").replace(":", ",").split(","):
        if part.strip() in _UNITS:
            return _UNITS[part.strip()]
    return "" if parameter.words else _USUAL_UNITS.get(parameter.name, "")


def _with_unit(value: str, unit: str) -> str:
    """A value as a label has it: "15°", "900 °C"."""
    text = drawable(value) or "none"
    return (
        f"{text}{'' if unit == '°' else ' '}{unit}" if unit and _number(value) is not None else text
    )


def _number(value: str) -> float | None:
    try:
        number = float(value)
    except ValueError:
        return None
    return number if np.isfinite(number) else None


# The picture.


@dataclass(frozen=True)
class _Quantity:
    """What a panel shows over the parameters."""

    title: str
    label: str
    values: Array
    colour: str

    @property
    def known(self) -> Array:
        return self.values[np.isfinite(self.values)]


@dataclass(frozen=True)
class _Axis:
    """A swept parameter along an axis: numbers at their place, words side by side."""

    name: str
    unit: str
    values: tuple[str, ...]
    numeric: bool

    @staticmethod
    def of(parameter: SweptParameter) -> _Axis:
        numeric = all(_number(value) is not None for value in parameter.values)
        values = tuple(sorted(parameter.values, key=float)) if numeric else parameter.values
        return _Axis(parameter.name, unit_of(parameter), values, numeric)

    @property
    def label(self) -> str:
        return drawable(self.name) + (f" in {self.unit}" if self.unit else "")

    def place(self, value: str) -> float:
        return float(value) if self.numeric else float(self.values.index(value))

    def label_of(self, value: str) -> str:
        return _with_unit(value, self.unit)


def draw(result: Sweep) -> Picture:
    """Draw a sweep: curves over one parameter, one for each value of a second, or heat maps.

    Further parameters make a panel for each combination.
    """
    quantities = _quantities(result.table)
    axes = [_Axis.of(parameter) for parameter in result.summary.swept]
    panels: list[Panel] = []
    first, second, rest, mapped = _arranged(axes)
    facets = list(_facets(result.table, rest))
    for words, rows in facets[:_MOST_FACETS]:  # sweep.csv and the page's table have all
        for quantity in quantities if len(facets) == 1 else quantities[::2]:
            title = quantity.title + (f"\n{words}" if words else "")
            alt = f"{_alt(quantity, rows, first, second)}{f', {words}' if words else ''}"
            if mapped and first and second:
                panel = _heat_map(result.table, quantity, rows, first, second)
            else:
                panel = _curves(result.table, quantity, rows, first, second)
            panels.append(Panel(title, panel, alt))
    name = Path(result.summary.scene).stem
    over = listed([drawable(axis.name) for axis in axes])
    return draw_picture(f"Sweep of {drawable(name)}" + (f" over {over}" if over else ""), panels)


def _quantities(table: SweepTable) -> list[_Quantity]:
    """What there is to draw, the user's first question first."""
    state = _state(table)
    apart, of_dots = _apart(table, state)
    shift = table.largest_measured_shift_um
    found = [
        (f"Error of the section measured {state}", "rms in µm", _error(table, state)),
        ("Shift of the probe rays' points by hot air", "largest in µm", shift),
        (f"Rendered minus ray search, {state}", "largest in px" if of_dots else "rms in px", apart),
        (
            f"{'Dots' if of_dots else 'Line centres'} found, {state}",
            "number",
            getattr(table, f"{state}_centres"),
        ),
    ]
    quantities = [_Quantity(*each, state) for each in found]
    return [each for each in quantities if each.known.size] or quantities[-1:]


def _state(table: SweepTable) -> str:
    """The state whose figures are shown: hot, or cold of parts that are only measured cold."""
    return "hot" if np.isfinite(table.hot_centres).any() else "cold"


def _error(table: SweepTable, state: str) -> Array:
    """Error of the measured section, um rms."""
    error: Array = getattr(table, f"{state}_section_rms_um")
    return error


def _apart(table: SweepTable, state: str) -> tuple[Array, bool]:
    """Rendered minus searched: rms of lines, of dots the largest; and whether all are dots."""
    line, *dots = (
        getattr(table, f"{state}_{name}_px")
        for name in ("line_rms", "dots_largest_u", "dots_largest_v")
    )
    largest = np.fmax(*dots)
    known = np.isfinite(line)
    return np.where(known, line, largest), bool(np.isfinite(largest).any() and not known.any())


def _arranged(axes: list[_Axis]) -> tuple[_Axis | None, _Axis | None, list[_Axis], bool]:
    """Which parameter lies along the axis, which makes curves or a heat map, and the others."""
    if not axes:
        return None, None, [], False
    many = [axis for axis in axes if axis.numeric and len(axis.values) >= _HEAT_MAP]
    if len(many) >= 2:
        return many[0], many[1], [axis for axis in axes if axis not in many[:2]], True
    numeric = [axis for axis in axes if axis.numeric and len(axis.values) > 2]
    along = max(numeric or axes, key=lambda axis: len(axis.values))
    others = [axis for axis in axes if axis is not along]
    second = next((axis for axis in others if len(axis.values) <= _MOST_CURVES), None)
    return along, second, [axis for axis in others if axis is not second], False


def _undrawn(result: Sweep) -> list[str]:
    """Says that there are more combinations than panels, if so."""
    rest = _arranged([_Axis.of(parameter) for parameter in result.summary.swept])[2]
    count = len(list(_facets(result.table, rest)))
    if count <= _MOST_FACETS:
        return []
    names = listed([axis.name for axis in rest])
    return [f"The first {_MOST_FACETS} of {count} combinations of {names} are drawn."]


def _facets(table: SweepTable, rest: Sequence[_Axis]) -> Iterable[tuple[str, Rows]]:
    """Each combination of the other parameters that there is, in words, and its rows."""
    for values in product(*(axis.values for axis in rest)):
        pairs = list(zip(rest, values, strict=True))
        rows = [
            row
            for row in range(len(table))
            if all(table.parameters[axis.name][row] == value for axis, value in pairs)
        ]
        if rows:
            words = (f"{drawable(axis.name)} {axis.label_of(value)}" for axis, value in pairs)
            yield ", ".join(words), rows


def _alt(quantity: _Quantity, rows: Rows, first: _Axis | None, second: _Axis | None) -> str:
    known = quantity.values[list(rows)]
    known = known[np.isfinite(known)]
    over = [axis.name for axis in (first, second) if axis]
    words = quantity.title + (f" over {listed(over)}" if over else "")
    if not known.size:
        return f"{words}: no case has a value"
    low, high = (in_words(float(value), "{:.3g}") for value in (known.min(), known.max()))
    return f"{words}, {quantity.label}: {low} to {high}"


def _curves(
    table: SweepTable, quantity: _Quantity, rows: Rows, first: _Axis | None, second: _Axis | None
) -> Callable[[Axes], None]:
    """A curve over the first parameter for each value of the second."""

    def draw(axes: Axes) -> None:
        curves = _curve_rows(table, rows, second)
        shades = _shades(quantity, list(curves), second)
        drawn: dict[str, tuple[Array, Array]] = {}
        for number, (value, each) in enumerate(curves.items()):
            behind = len(curves) - 1 - number  # coinciding curves frame one another
            x = np.array([_place(table, first, row) for row in each])
            order = np.argsort(x, kind="stable")
            x, y = x[order], quantity.values[list(each)][order]
            drawn[value] = x, y
            words = first is None or not first.numeric  # between which there is nothing
            axes.plot(
                x + (_BESIDE * (number - (len(curves) - 1) / 2.0) if words else 0.0),
                y,
                color=shades[value],
                ls="" if words else LINES[number % len(LINES)],
                lw=min(1.2 + 0.8 * behind, 4.0),
                marker=MARKERS[number % len(MARKERS)],
                ms=6.0 if words else 4.0 + 1.5 * behind,
                mfc="white" if len(curves) > 1 else shades[value],
            )
        _scale(axes, quantity)
        key = _mark_failed(axes, table, first, curves, shades)
        _ticks(axes, first, key)
        axes.set_ylabel(quantity.label)
        if second:
            labels = {value: second.label_of(value) for value in curves}
            _label_ends(axes, drawn, labels, shades, drawable(second.name))

    return draw


def _curve_rows(table: SweepTable, rows: Rows, second: _Axis | None) -> dict[str, list[int]]:
    found: dict[str, list[int]] = {value: [] for value in (second.values if second else ("",))}
    for row in rows:
        found[table.parameters[second.name][row] if second else ""].append(row)
    return {value: each for value, each in found.items() if each}


def _shades(quantity: _Quantity, values: list[str], second: _Axis | None) -> dict[str, str]:
    """Colours of curves: numbers from dark to light, words as on every page, one as its state."""
    if second is None:
        return dict.fromkeys(values, colour(quantity.colour))
    if not second.numeric:
        return colours(values)
    scale = matplotlib.colormaps["cividis"]
    steps = np.linspace(0.0, 0.8, len(values))
    return {
        value: matplotlib.colors.to_hex(scale(step))
        for value, step in zip(values, steps, strict=True)
    }


def _place(table: SweepTable, axis: _Axis | None, row: int) -> float:
    return axis.place(table.parameters[axis.name][row]) if axis else 0.0


def _ticks(axes: Axes, axis: _Axis | None, key: str) -> None:
    if axis is None:
        axes.set(xticks=[0.0], xticklabels=["the scene"], xlim=(-1.0, 1.0), xlabel=key)
        return
    axes.set_xlabel(axis.label + (f"   ({key})" if key else ""))
    if not axis.numeric:
        words = [drawable(Path(value).name[-24:]) or "none" for value in axis.values]
        long = sum(map(len, words)) > 50
        axes.set_xticks(
            range(len(words)), words, rotation=25 if long else 0, ha="right" if long else "center"
        )
        axes.set_xlim(-0.5, len(words) - 0.5)
    elif len(axis.values) <= 8:
        axes.set_xticks([float(value) for value in axis.values], [drawable(v) for v in axis.values])


def _scale(axes: Axes, quantity: _Quantity) -> None:
    """The same in all panels: from 0, or logarithmic where a linear axis would hide the least."""
    known = quantity.known
    if _wide(known):
        axes.set(yscale="log", ylim=(known.min() / 1.3, known.max() * 1.3))
        decimal_ticks(axes.yaxis, fine=True)
    else:
        axes.set_ylim(0.0, 1.12 * (known.max() if known.size and known.max() > 0.0 else 1.0))


def _wide(known: Array) -> bool:
    """Whether values span more than a linear axis shows."""
    return bool(known.size and known.min() > 0.0 and known.max() > _LOGARITHMIC * known.min())


def _mark_failed(
    axes: Axes,
    table: SweepTable,
    first: _Axis | None,
    curves: Mapping[str, list[int]],
    shades: Mapping[str, str],
) -> str:
    """Crosses at the foot for cases that failed, rings for those without a line; and their key."""
    seen: dict[str, str] = {}
    for number, (value, rows) in enumerate(curves.items()):
        for status, (marker, sign) in _SIGNS.items():
            x = [_place(table, first, row) for row in rows if table.status[row] == status]
            if x:
                seen[status] = f"{sign} {_STATUS_WORDS[status]}"
                axes.plot(
                    *(x, np.full(len(x), 0.03 + 0.055 * number)),
                    marker=marker,
                    ls="",
                    ms=7,
                    mew=2,
                    mfc="none",
                    color=shades[value],
                    transform=axes.get_xaxis_transform(),
                    clip_on=False,
                )
    return ", ".join(seen.values())


def _label_ends(
    axes: Axes,
    drawn: Mapping[str, tuple[Array, Array]],
    labels: Mapping[str, str],
    shades: Mapping[str, str],
    heading: str,
) -> None:
    """Write each curve's value at its right end; curves that coincide have one label."""
    groups: list[list[str]] = []
    for value in drawn:
        same = [group for group in groups if _coincide(axes, drawn[group[0]], drawn[value])]
        (same[0].append(value)) if same else groups.append([value])
    ends: list[tuple[float, tuple[float, float] | None, list[str]]] = []
    for group in groups:
        x, y = drawn[group[0]]
        known = np.flatnonzero(np.isfinite(y))
        at = (float(x[known[-1]]), float(y[known[-1]])) if known.size else None
        ends.append((_height(axes, at[1]) if at else 0.0, at, group))
    ends.sort(key=lambda end: end[0])
    places = _spread([height for height, *_ in ends], 0.07)
    for (_, at, group), place in zip(ends, places, strict=True):
        alike = len(group) == len(drawn) > 1
        words = "all alike" if alike else "\n= ".join(labels[value] for value in group)
        axes.annotate(
            *(words if at else f"{words}: none", at or (1.0, place)),
            xytext=(1.045, place),
            xycoords="data" if at else "axes fraction",
            textcoords="axes fraction",
            va="center",
            fontsize=9.5,
            color="black" if alike else _dark(shades[group[0]]),
            arrowprops={"arrowstyle": "-", "lw": 0.6, "color": "#999999", "shrinkB": 5},
            annotation_clip=False,
        )
    axes.text(1.045, places[-1] + 0.07, heading, transform=axes.transAxes, fontsize=9.5)


def _coincide(axes: Axes, one: tuple[Array, Array], other: tuple[Array, Array]) -> bool:
    if not np.array_equal(one[0], other[0]):
        return False
    heights = [np.array([_height(axes, value) for value in y]) for _, y in (one, other)]
    missing = [np.isnan(height) for height in heights]
    apart = np.abs(heights[0] - heights[1])[~missing[0]]
    return bool(np.array_equal(*missing)) and bool(np.all(apart <= _SAME))


def _height(axes: Axes, value: float) -> float:
    """Where a value lies on the axis, from 0 to 1."""
    low, high = axes.get_ylim()
    if axes.get_yscale() == "log":
        low, high, value = np.log(low), np.log(high), np.log(value)
    return float((value - low) / (high - low))


def _spread(places: Sequence[float], gap: float) -> list[float]:
    """Ascending places moved apart to a gap at least, as little as can be."""
    moved: list[float] = []
    for place in places:
        moved.append(max(place, moved[-1] + gap) if moved else place)
    for i in range(len(moved) - 1, -1, -1):
        ceiling = 1.0 if i == len(moved) - 1 else moved[i + 1] - gap
        moved[i] = min(moved[i], ceiling)
    return moved


def _dark(shade: str) -> str:
    """A colour that letters on white can have."""
    return shade if letters_on(shade) == "white" else "#333333"


def _heat_map(
    table: SweepTable, quantity: _Quantity, rows: Rows, first: _Axis, second: _Axis
) -> Callable[[Axes], None]:
    """A cell for each pair of values, with the number in it where there is room."""

    def draw(axes: Axes) -> None:
        shape = len(second.values), len(first.values)
        few = shape[0] * shape[1] <= _WRITTEN_CELLS
        cells, failed = np.full(shape, np.nan), {}
        for row in rows:
            at = (
                second.values.index(table.parameters[second.name][row]),
                first.values.index(table.parameters[first.name][row]),
            )
            cells[at] = quantity.values[row]
            if table.status[row] != CaseStatus.OK:
                failed[at] = _STATUS_WORDS[table.status[row]] if few else "×"
        known = cells[np.isfinite(cells)]
        wide = _wide(quantity.known)
        drawn = axes.imshow(cells, aspect="auto", origin="lower", norm="log" if wide else "linear")
        if known.size:
            drawn.set_clim(quantity.known.min(), quantity.known.max())
        bar = axes.figure.colorbar(drawn, ax=axes, label=quantity.label, pad=0.02)
        if wide:
            decimal_ticks(bar.ax.yaxis, fine=True)
        axes.grid(False)
        for (row, column), words in failed.items():
            axes.text(column, row, words, ha="center", va="center", color=colour("failed"))
        if few and known.size:
            for (row, column), value in np.ndenumerate(cells):
                if np.isfinite(value):
                    shade = matplotlib.colors.to_hex(drawn.cmap(drawn.norm(value)))
                    text = f"{value:.3g}"
                    letters = {"ha": "center", "va": "center", "color": letters_on(shade)}
                    axes.text(column, row, text, fontsize=8.5, **letters)
        for axis, set_ticks in ((first, axes.set_xticks), (second, axes.set_yticks)):
            step = max(1, -(-len(axis.values) // 9))
            places = range(0, len(axis.values), step)
            set_ticks(places, [drawable(axis.values[i]) for i in places])
        axes.set(xlabel=first.label, ylabel=second.label)

    return draw


# The page.


def table(result: Sweep, links: bool = False) -> TextTable:
    """The figures of all cases that a reader asks for first; on a page with links to the cases."""
    found, swept, state = result.table, result.summary.swept, _state(result.table)
    apart, of_dots = _apart(found, state)
    rows = [
        {
            "case": _link(end.case.name, found.folder[i]) if links else end.case.name,
            "parameters": {p.name: found.parameters[p.name][i] for p in swept},
            "status": _STATUS_WORDS[found.status[i]],
            "error": _error(found, state)[i],
            "shift": found.largest_measured_shift_um[i],
            "apart": apart[i],
            "centres": getattr(found, f"{state}_centres")[i],
        }
        for i, end in enumerate(result.finished)
    ]
    figures = (
        Column("error", "error, µm"),
        *([Column("shift", "shift, µm")] if links else []),  # 80 letters of a console hold no more
        Column("apart", "largest, px" if of_dots else "rms, px", "{:.4f}"),
        Column("centres", "dots" if of_dots else "centres", "{:.0f}"),
    )
    names = [] if swept and not links else [Column("case")]
    given = [Column(f"parameters.{p.name}", _Axis.of(p).label.replace(" in ", ", ")) for p in swept]
    known = [c for c in figures if any(np.isfinite(row[c.name]) for row in rows)]
    return text_table(
        rows,
        [*names, *given, Column("status"), *known],
        emphasised=[status != CaseStatus.OK.value for status in found.status],
    )


_TABLE_WORDS = (
    "Error: distance of the measured points from the part's true section, rms. Shift: how far hot"
    " air moves the measured points of the probe rays, at most. In px: rendered line (or dots)"
    " minus ray search. A case's name leads to its own page."
)


def _link(name: str, folder: str) -> str | Link:
    return Link(name, quote(f"{folder}/{PAGE}")) if folder else name


def lead(result: Sweep) -> str:
    """How many cases there are, where the error is largest, and where least."""
    summary, state = result.summary, _state(result.table)
    error = _error(result.table, state)
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
        f"{words} The section measured {state} is wrong by {error[most]:.3g} µm rms at {worst},"
        f" where it is worst, and by {error[least]:.3g} µm at {best}, where it is best."
    )


def page(result: Sweep, picture: Picture, command: str) -> Page:
    """The page of a sweep."""
    summary = result.summary
    swept = [
        {
            "parameter": parameter.name,
            "unit": unit_of(parameter),
            "values": ", ".join(value or "(empty)" for value in parameter.values),
            "words": parameter.words,
        }
        for parameter in summary.swept
    ]
    sections = [
        Section("Over the parameters", *_undrawn(result), picture),
        Section("Cases", _TABLE_WORDS, table(result, links=True)),
    ]
    if summary.failed:
        why = tuple(f"{name}: {message}" for name, message in summary.failed.items())
        sections.append(Section("Cases that failed", Listing(why)))
    if swept:
        heads = [
            Column("parameter"),
            Column("unit"),
            Column("values"),
            Column("words", "the scene's words"),
        ]
        sections.append(Section("Parameters", text_table(swept, heads)))
    if summary.notes:
        notes = Listing(summary.notes)
        many = len(summary.notes) > _SHOWN_NOTES
        shown = Details(f"All {len(summary.notes)} notes", (notes,)) if many else notes
        sections.append(Section("Notes", shown))
    name = Path(summary.scene).stem
    return Page(f"Sweep of {name}", lead(result), tuple(sections), command, summary.made_with)
