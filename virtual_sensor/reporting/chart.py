"""The chart of speed against accuracy: its picture, tables, page and files."""

from __future__ import annotations

from collections import defaultdict
from collections.abc import Callable, Sequence
from dataclasses import dataclass
from functools import partial
from itertools import groupby
from pathlib import Path
from typing import Any

import numpy as np
from matplotlib.axes import Axes
from matplotlib.figure import Figure
from matplotlib.ticker import FixedLocator, FuncFormatter, NullLocator
from numpy.typing import NDArray

from virtual_sensor.files import RESULTS_SIGN, folder_written_whole
from virtual_sensor.records import Record, record_columns
from virtual_sensor.reporting.files import FileOf, write_results
from virtual_sensor.reporting.page import PAGE, Content, Details, Page, Section
from virtual_sensor.reporting.pictures import DPI, Panel, PanelPicture, Picture, draw_picture
from virtual_sensor.reporting.style import GREY, MARKERS, colours, key, write_beside, write_on_line
from virtual_sensor.reporting.tables import TextTable, text_table
from virtual_sensor.reporting.words import capital, counted, in_words, time_in_words
from virtual_sensor.studies.chart.benchmark import (
    EFFECT_PX,
    RESOLVED_PX,
    Measured,
    enough,
    on_front,
)
from virtual_sensor.studies.chart.chart import Chart
from virtual_sensor.studies.chart.failures import Failures, made_by
from virtual_sensor.studies.chart.scaling import Scaling
from virtual_sensor.studies.machine import Machine

# ------------------------------------------------------------------------------------------ words

TITLES = {
    "rays": "Bent rays",
    "frames": "Rendered frames",
    "search": "Search for laser points",
    "correction": "Correction",
    "fringes": "Fringes",
    "camera": "Cameras with a lens",
    "bounces": "Light that bounces",
    "lines": "Line detectors",
}
_JOBS = {
    "rays": "Rays",
    "frames": "Frames",
    "search": "Laser points",
    "correction": "Corrected points",
    "fringes": "Decoded pixels",
    "camera": "Frames through a lens",
    "bounces": "Frames of a shiny groove",
    "lines": "Line centres",
}
ITEMS = {
    "rays": "ray",
    "frames": "frame",
    "search": "laser point",
    "correction": "point",
    "fringes": "pixel",
    "camera": "frame",
    "bounces": "frame",
    "lines": "column",
}
_METHODS = {
    "euler": "Euler",
    "rk4": "RK4",
    "sharma": "Sharma",
    "dopri5": "Dormand-Prince 5(4)",
    "direct": "Mitsuba's direct",
    "bounced": "with reflections",
    "paper": "paper's search",
    "newton_along_line": "Newton along the line",
    "newton_by_ray": "Newton ray by ray",
    "new_maps": "new ray maps",
    "cached_maps": "cached ray maps",
    "gaussian": "Gaussian fit",
    "weighted_gaussian": "weighted Gaussian fit",
    "max_likelihood": "maximum likelihood",
    "other_air": "air of 1100 °C",
    "own_air_new_maps": "own air, new maps",
    "own_air_cached_maps": "own air, cached maps",
    "own_air_marched": "own air, marched",
    "found_on_a_known_shape": "air found on a known shape",
    "found_from_one_pose": "air found from one pose",
    "found_from_two_poses": "air found from two poses",
    "phase": "phase shifting",
    "phase_heterodyne": "phase shifting with beats",
    "phase_gray": "phase shifting with Gray code",
    "gray": "Gray code",
    "single": "one image",
    "fir4": "FIR 4",
    "fir8": "FIR 8",
}
_SETTINGS: dict[str, Callable[[Any], str]] = {
    "samples_per_pixel": lambda number: f"{counted(number, 'sample')} per pixel",
    "sub_pupils": lambda number: counted(number, "sub-pupil"),
    "bounces": lambda number: counted(number, "bounce"),
    "indirect_samples": lambda number: f"{counted(number, 'point')} of the stripe",
    "images": lambda number: counted(number, "image"),
    "steps": "{} steps".format,
    "periods_px": lambda text: f"periods of {text.replace(',', ', ')} px",
    "step_mm": "{:g} mm steps".format,
    "tolerance_px": "tolerance {:g} px".format,
    "tolerance_mm": "tolerance {:g} mm".format,
    "grid_px": "grid of {:g} px".format,
    "halvings": lambda number: counted(number, "halving"),
    "precision": {"single": "float32", "double": "float64"}.__getitem__,
    "interpolation": "{} field".format,
    "dimensions": "{}-D field".format,
    "variant": lambda _: "GPU",
    "method": lambda name: method_in_words(name),
}


def method_in_words(name: str) -> str:
    """A method's name as people read it."""
    return _METHODS.get(name, name.replace("_", " "))


def setting_in_words(name: str, value: Any) -> str:
    """A setting as people read it: "16 samples per pixel", "2 mm steps"."""
    words = _SETTINGS.get(name, f"{name.replace('_', ' ')} {{}}".format)
    return words(value)


def configuration_in_words(measured: Measured) -> str:
    """A configuration as people read it: "tabulated, 16 samples per pixel"."""
    settings = (setting_in_words(name, value) for name, value in measured.chosen.items())
    return ", ".join([method_in_words(measured.name), *settings])


def error_in_words(px: float) -> str:
    """An error with two digits."""
    if not np.isfinite(px):
        return "unknown"
    return f"{px:.2g} px" if px >= 1e-4 or px == 0.0 else f"{px:.1e} px".replace("e-0", "e-")


def _micrometres(um: float) -> str:
    if not np.isfinite(um):
        return ""
    return f"{um:.2g} µm" if um < 100.0 else f"{um:.0f} µm"


def enough_in_words(measured: Sequence[Measured]) -> str:
    """What is enough for one task, and what it costs; or that nothing is."""
    best = enough(measured)
    if best is None:
        return f"nothing errs less than {RESOLVED_PX:g} px"
    bound = f"; the noise allows {best.bound_px:.2g} px" if best.rms_px > RESOLVED_PX else ""
    return f"{configuration_in_words(best)} ({time_in_words(best.time_s)}{bound})"


def headline(chart: Chart) -> str:
    """The cheapest of each panel whose error no sensor resolves."""
    found = [f"{_JOBS[panel]}: {enough_in_words(chart.of(panel))}." for panel in chart.panels]
    return f"How little is enough for {RESOLVED_PX:g} px? {' '.join(found)}"


# ---------------------------------------------------------------------------------------- picture

PICTURE = "chart.png"
_CELL_IN = (6.4, 7.2)
_KEY_PX, _BELOW_PX, _ABOVE_PX = 21.0, 70.0, 138.0  # a line of the key; below and above the axes
_KEY_LETTERS = 49  # that fit into a line of the key
_FEWEST_KEYS = 5  # lines that a panel has room for: axes beside each other hardly differ in height
_HARDLY = 0.8  # of the error of the one before: no reason for a number
_SMALLEST_PX = 1e-12  # what a logarithmic axis shows of an error of 0
_TICKS = ((1.0,), (1.0, 3.0), (1.0, 2.0, 5.0), (1.0, 1.5, 2.0, 3.0, 5.0, 7.0))
"""Times powers of ten: where ticks may be, the fewest first."""
_ENOUGH, _EFFECT = "#00714F", GREY


def draw_chart(chart: Chart) -> Picture:
    """All panels, each with the task that it is about."""
    panels = []
    for name in chart.panels:
        draw = partial(_draw_large, chart.of(name))
        alt = _alt(chart.of(name))
        panels.append(Panel(TITLES[name], draw, alt, axes=False, layout=None))
    return draw_picture(headline(chart), panels, cell_in=_CELL_IN)


def draw_other_tasks(chart: Chart, panel: str) -> Picture | None:
    """A panel's other tasks as small multiples; None where it has no others."""
    tasks = {task: chart.of(panel, task) for task in chart.tasks(panel)[1:]}
    panels = [Panel(capital(t), partial(_draw_small, of), _alt(of)) for t, of in tasks.items()]
    return draw_picture("", panels) if panels else None


def _alt(measured: Sequence[Measured]) -> str:
    return (
        f"Error in px over time per {ITEMS[measured[0].panel]} of {len(measured)} configurations."
        f" Enough: {enough_in_words(measured)}."
    )


def numbered(measured: Sequence[Measured]) -> list[Measured]:
    """Those of a front that get a number: what is enough, and what is clearly more accurate."""
    found: list[Measured] = []
    best = enough(measured)
    for each in on_front(measured):
        if not found or each is best or each.rms_px <= _HARDLY * found[-1].rms_px:
            found.append(each)
    return found


def _draw_large(measured: Sequence[Measured], figure: Figure) -> None:
    """A panel: its task, the axes, and below them the key of the front's numbers."""
    width, height = figure.get_size_inches() * DPI
    numbers, best = numbered(measured), enough(measured)
    keys = max(len(numbers), _FEWEST_KEYS)
    bottom = _BELOW_PX + _KEY_PX * keys
    size = (width - 100.0) / width, (height - bottom - _ABOVE_PX) / height
    axes = figure.add_axes((84.0 / width, bottom / height, *size))
    draw_errors(axes, measured)
    _legend(axes, measured, ncols=3, loc="lower left", bbox_to_anchor=(-0.15, 1.0))
    _number(axes, numbers, measured)

    def write(x: float, y: float, text: str, **style: Any) -> None:
        figure.text(x / width, y / height, text, va="center", **style)

    write(13.0, height - 42.0, capital(measured[0].task), fontsize=11, color="0.3")
    for number, each in enumerate(numbers, 1):
        style: dict[str, Any] = {"fontsize": 10.2}
        if each is best:
            style |= {"fontweight": "bold", "color": _ENOUGH}
        y = 10.0 + _KEY_PX * (keys - number + 0.5)
        write(28.0, y, f"{number}", ha="right", **style)
        words = configuration_in_words(each)
        write(38.0, y, words, **style | {"fontsize": 10.2 * min(1.0, _KEY_LETTERS / len(words))})
        write(width - 88.0, y, error_in_words(each.rms_px), ha="right", **style)
        write(width - 12.0, y, time_in_words(each.time_s), ha="right", **style)


def _draw_small(measured: Sequence[Measured], axes: Axes) -> None:
    draw_errors(axes, measured)
    _legend(axes, measured, loc="upper left", bbox_to_anchor=(1.0, 1.0))


def draw_errors(axes: Axes, measured: Sequence[Measured]) -> None:
    """One task: hollow marks, filled ones on the front, its steps, the bands, the bound."""
    shown = [m for m in measured if np.isfinite([m.rms_px, m.time_s]).all() and m.time_s > 0.0]
    axes.set(xscale="log", yscale="log")
    if not shown:
        axes.text(0.5, 0.5, "no error is known", transform=axes.transAxes, ha="center")
        return
    marks = _marks(shown)
    series: dict[tuple[str, ...], list[Measured]] = defaultdict(list)
    for each in shown:
        words = (v for v in each.chosen.values() if isinstance(v, str))
        series[(each.name, *words)].append(each)  # they differ in numbers only
    for line in series.values():
        times, errors = [m.time_s for m in line], [_error(m) for m in line]
        axes.plot(times, errors, color=marks[line[0].name][0], lw=0.8, alpha=0.4)
    best = enough(measured)
    if best:
        axes.plot(best.time_s, _error(best), "o", ms=19, mfc="none", mec=_ENOUGH, mew=2.5)
    for each in shown:
        colour, marker = marks[each.name]
        size, order, edge = (8.5, 4, "black") if each.on_front else (5.5, 3, colour)
        style: dict[str, Any] = {"ms": size, "zorder": order, "mec": edge, "mew": 1.0}
        axes.plot(each.time_s, _error(each), marker=marker, **style, **_filled(each, colour))
    _limits(axes, shown)
    front = on_front(shown)
    times = [*(m.time_s for m in front), axes.get_xlim()[1]]
    errors = [*map(_error, front), *map(_error, front[-1:])]
    axes.step(times[: len(errors)], errors, where="post", color="0.2", lw=1.5, zorder=2)
    _bands(axes, shown[0].bound_px)
    axes.set_xlabel(f"time per {ITEMS[shown[0].panel]}", fontsize=11)
    axes.set_ylabel("error in px, rms", fontsize=11)


def _error(measured: Measured) -> float:
    return max(measured.rms_px, _SMALLEST_PX)


def _marks(measured: Sequence[Measured]) -> dict[str, tuple[str, str]]:
    """Colour and marker of each method: the colour is that of its kind on every page."""
    by_kind = colours(list(dict.fromkeys(m.kind for m in measured)))
    names = {m.name: by_kind[m.kind] for m in measured}
    return {
        name: (colour, MARKERS[number % len(MARKERS)])
        for number, (name, colour) in enumerate(names.items())
    }


def _filled(measured: Measured, colour: str) -> dict[str, Any]:
    """Full on the front, half on the GPU, else hollow."""
    if on_gpu(measured):
        return {"fillstyle": "left", "mfc": colour, "mfcalt": "white"}
    return {"mfc": colour if measured.on_front else "white"}


def on_gpu(measured: Measured) -> bool:
    """Whether a configuration was measured on the GPU, beside those of the processor."""
    return "variant" in measured.chosen


def _limits(axes: Axes, shown: Sequence[Measured]) -> None:
    """Room round all marks, and up to what the bands mean where that is near."""
    times, errors = [m.time_s for m in shown], [_error(m) for m in shown]
    bound = shown[0].bound_px
    low, high = min(errors), max(errors)
    if high > 0.1 * EFFECT_PX:
        high = max(high, 2.0 * EFFECT_PX)
    if bound:
        low = min(low, bound, RESOLVED_PX)
    if low < RESOLVED_PX:
        high = max(high, 1.5 * RESOLVED_PX)
    for axis, set_limits, limits, words in (
        (axes.xaxis, axes.set_xlim, (min(times), max(times)), time_in_words),
        (axes.yaxis, axes.set_ylim, (low, high), _power),
    ):
        room = max(limits[1] / limits[0], 2.0) ** 0.1
        low, high = limits[0] / room, limits[1] * room
        set_limits(low, high)
        axis.set_major_locator(FixedLocator(_ticks(low, high)))
        axis.set_major_formatter(FuncFormatter(lambda value, _, words=words: words(value)))
        axis.set_minor_locator(NullLocator())  # they take half of the time of such a picture


def _ticks(low: float, high: float) -> list[float]:
    """Ticks of a logarithmic axis, 0.01 among them: three or more where that goes, and not many."""
    decades = np.arange(np.floor(np.log10(low)), np.ceil(np.log10(high)) + 1.0)
    for factors in _TICKS:
        ticks = [float(f * 10.0**n) for n in decades for f in factors]
        inside = [tick for tick in ticks if low <= tick <= high]
        if len(inside) >= 3:
            break
    every = 1 + len(inside) // 8
    first = next((i for i, tick in enumerate(inside) if np.isclose(tick, RESOLVED_PX)), 0)
    return inside[first % every :: every]


def _power(value: float) -> str:
    return f"{value:g}" if value >= 9e-4 else f"$10^{{{round(np.log10(value))}}}$"


def _bands(axes: Axes, bound_px: float) -> None:
    """What a sensor resolves, what the effect amounts to, what no detector beats."""
    low, high = axes.get_ylim()
    if low < RESOLVED_PX:
        axes.axhspan(low, RESOLVED_PX, color=_ENOUGH, alpha=0.12, lw=0)
        write_on_line(axes, "finer than a sensor resolves", low, color=_ENOUGH)
    if high > EFFECT_PX:
        axes.axhspan(EFFECT_PX, high, color=_EFFECT, alpha=0.12, lw=0)
        write_on_line(axes, "as wrong as without hot air", EFFECT_PX, right=True, color=_EFFECT)
    if bound_px:
        axes.axhline(bound_px, color="black", lw=1.3, ls="--")
        write_on_line(axes, f"Cramér-Rao bound: {bound_px:.2g} px", bound_px, right=True)
    axes.set_ylim(low, high)


def _legend(axes: Axes, measured: Sequence[Measured], **place: Any) -> None:
    hollow: dict[str, Any] = {"ls": "none", "mfc": "white", "ms": 6}
    handles = [
        key(method_in_words(name), color=colour, marker=marker, **hollow)
        for name, (colour, marker) in _marks(measured).items()
    ]
    if gpu := next(filter(on_gpu, measured), None):
        half = {"color": "0.3", "marker": "o", "ls": "none"} | _filled(gpu, "0.3")
        handles.append(key("half: on the GPU", **half))
    axes.legend(handles=handles, fontsize=9.5, handletextpad=0.1, labelspacing=0.2, **place)


def _number(axes: Axes, numbers: Sequence[Measured], measured: Sequence[Measured]) -> None:
    """Write the key's numbers beside their marks, below the front, where nothing else lies."""

    def pixels(each: Measured) -> NDArray[np.float64]:
        return np.asarray(axes.transData.transform((each.time_s, _error(each))))

    best = enough(measured)
    taken = [pixels(each) for each in on_front(measured)]
    angles = np.radians((225.0, 180.0, 270.0, 200.0, 250.0, 45.0))
    round_it = np.stack([np.cos(angles), np.sin(angles)], axis=1)
    for number, each in enumerate(numbers, 1):
        at, first = pixels(each), 24.0 if each is best else 16.0
        offsets = np.concatenate([(first + more) * round_it for more in (0.0, 8.0, 16.0)])
        apart = np.linalg.norm((at + offsets)[:, None] - np.array(taken), axis=2)
        offset = offsets[np.argmin(np.maximum(15.0 - apart, 0.0).sum(axis=1))]
        taken.append(at + offset)
        place, (right, up) = (each.time_s, _error(each)), offset * 72.0 / DPI
        shade = _ENOUGH if each is best else "black"
        style = {"ha": "center", "fontsize": 10.5, "fontweight": "bold", "color": shade}
        write_beside(axes, f"{number}", place, (right, up), **style, zorder=6)


# ----------------------------------------------------------------------------------------- tables


@dataclass(frozen=True)
class Summary(Record):
    """What a program wants to know of a chart: `summary.json`.

    Attributes
    ----------
    enough : dict
        By panel, the fastest configuration whose error is as good as none.
    fronts : dict
        By panel, the Pareto fronts of its tasks, the fastest first.
    exponents : dict
        By what is varied, the power of the size with which the time grows.
    frame_memory_mb : float
        Peak memory of a process that renders a frame; null where no frames were asked for.
    machine : Machine
        What it was measured on.
    notes : tuple of str
        What the reader should know besides.
    time_s : float
        Of the whole.
    """

    enough: dict[str, Measured | None]
    fronts: dict[str, tuple[Measured, ...]]
    exponents: dict[str, float]
    frame_memory_mb: float
    machine: Machine
    notes: tuple[str, ...]
    time_s: float


def summary(chart: Chart) -> Summary:
    """The fronts, what is enough, and the machine."""
    panels = chart.panels
    return Summary(
        {panel: enough(chart.of(panel)) for panel in panels},
        {p: tuple(m for task in chart.tasks(p) for m in chart.front(p, task)) for p in panels},
        {each.name: each.exponent for each in chart.scalings},
        *(chart.frame_memory_mb, chart.machine, chart.notes, chart.time_s),
    )


def measured_table(measured: Sequence[Measured], caption: str, whole: bool = False) -> TextTable:
    """Configurations of one task; `whole`: with all that is known of them, the front in bold.

    Else what is enough is in bold.
    """
    rows = [
        {
            "configuration": configuration_in_words(m),
            "error, rms": error_in_words(m.rms_px),
            "largest": error_in_words(m.largest_px),
            "on the part": _micrometres(m.rms_um),
            f"time per {ITEMS[m.panel]}": time_in_words(m.time_s),
            "failed": f"{m.failed} of {m.items}" if m.failed else "",
            "note": m.note,
        }
        for m in measured
    ]
    hidden = set() if whole else {"failed", "note"}
    if not any(np.isfinite(m.rms_um) for m in measured):
        hidden.add("on the part")
    columns = [name for name in (rows[0] if rows else ["configuration"]) if name not in hidden]
    best = enough(measured)
    first = [m.on_front if whole else m is best for m in measured]
    return text_table(rows, columns, caption, first)


def front_tables(chart: Chart) -> list[TextTable]:
    """The front of each panel's picture, as the console shows it."""
    return [
        measured_table(chart.front(panel), f"{TITLES[panel]}: the Pareto front")
        for panel in chart.panels
    ]


def front_table(chart: Chart) -> TextTable:
    """The front of each panel's picture: the table of the README."""
    rows = []
    for panel in chart.panels:
        front = chart.front(panel)
        for m in front:
            words = configuration_in_words(m) + (" (enough)" if m is enough(front) else "")
            errors = error_in_words(m.rms_px), error_in_words(m.largest_px)
            cost = f"{time_in_words(m.time_s)} per {ITEMS[panel]}"
            rows.append((TITLES[panel] if m is front[0] else "", words, *errors, cost))
    return TextTable(("job", "configuration", "error, rms", "largest", "time"), tuple(rows))


def failure_table(failures: Failures, panel: str) -> TextTable:
    """Where a panel's methods fail; methods that fail alike share a row."""
    methods: dict[tuple[str, ...], list[str]] = defaultdict(list)
    for r in failures.rows():
        if r["panel"] == panel:
            reported, wrong = (
                f"{r[name]:g}" if np.isfinite(r[name]) else "never"
                for name in ("reported_from", "wrong_from")
            )
            tried = f"{r['mildest']:g} to {r['severest']:g} {r['unit']}".strip()
            note = "; ".join(filter(None, [r["conditions"], r["note"]]))
            row = (r["trouble"], tried, f"{reported} {r['reports']}".strip(), wrong, note)
            methods[row].append(str(r["method"]))
    rows = tuple((row[0], "; ".join(names), *row[1:]) for row, names in methods.items())
    return TextTable(("trouble", "method", "tried", "reported from", "wrong from", "note"), rows)


def scaling_table(scalings: Sequence[Scaling]) -> TextTable:
    """How times grow, a row for each name."""
    rows = []
    for name, group in groupby(scalings, key=lambda each: each.name):
        points = list(group)
        times = ", ".join(f"{each.size:.3g}: {time_in_words(each.time_s)}" for each in points)
        exponent = in_words(points[0].exponent, "{:.2f}")
        rows.append((name, exponent, times, points[0].note))
    return TextTable(("time of", "exponent", "size: time", "note"), tuple(rows))


# ------------------------------------------------------------------------------------------ files

FRONT_TABLE = "front.md"
FILES = (
    FileOf(PAGE, "The page to open first: pictures, tables, failures, the machine."),
    FileOf(PICTURE, "All panels."),
    *(FileOf(f"{name}.png", f"The panel '{title}' alone.") for name, title in TITLES.items()),
    FileOf("configurations.csv", "Every configuration: its errors, its time.", Measured),
    FileOf("failures.csv", "Where methods fail, as `benchmarks/failures.py` found.", Failures),
    FileOf("scaling.csv", "Times over samples per pixel and nodes of the field.", Scaling),
    FileOf(FRONT_TABLE, "The fronts of the panels as a table in Markdown."),
    FileOf(RESULTS_SIGN, "The fronts, what is enough, the machine.", Summary),
)


def save(chart: Chart, folder: Path, command: str, overwrite: bool = False) -> None:
    """Write picture, page and tables; all of them or none.

    Parameters
    ----------
    chart : Chart
    folder : Path
    command : str
        That was given, for the page.
    overwrite : bool
        Whether a folder that exists is replaced.

    Raises
    ------
    InputError
        If the folder exists (and `overwrite` is not set) or can't be written.
    """
    picture = draw_chart(chart)
    contents = {
        "configurations.csv": record_columns(Measured, chart.measured),
        "failures.csv": chart.failures,
        "scaling.csv": record_columns(Scaling, chart.scalings),
        PICTURE: picture,
        **{f"{n}.png": p.png for n, p in zip(chart.panels, picture.panels, strict=True)},
        FRONT_TABLE: front_text(chart),
        PAGE: page(chart, picture, command),
        RESULTS_SIGN: summary(chart),
    }
    with folder_written_whole(folder, overwrite) as place:
        write_results(place, FILES, contents)


def front_text(chart: Chart) -> str:
    """What is enough, the fronts as Markdown, and what made them."""
    made = chart.machine.made_with
    return (
        f"{headline(chart)}\n\n{front_table(chart).markdown()}\nMade by `virtual-sensor chart` in"
        f" {chart.time_s:.0f} s; {chart.machine.processor}, {counted(made.threads, 'thread')},"
        f" {made.variant}.\n"
    )


# ------------------------------------------------------------------------------------------- page

_HOW = (
    "Each time is the median of up to five runs of the whole work, warmed up before, with Dr.Jit's"
    " threads waited for; work that takes seconds runs less often. Errors are against rays in"
    " closed form where there are some, and else against float64 at its finest: each task names its"
    " reference, and errors of one task compare with no other's.",
    "The Pareto front (filled marks, the stepped line) holds the configurations that no"
    " other of the task beats in both time and error. What fails in 1 % of its items more often"
    " than the most reliable is not on it. Settings that are not named are as the scene has them.",
    f"Enough is an error below {RESOLVED_PX:g} px, which no sensor resolves; where the noise of a"
    " detector's task allows no such error, one within 10 % of the Cramér-Rao bound. Without any"
    f" hot air in the computation the line is wrong by about {EFFECT_PX:g} px. One pixel is 22 µm"
    " on the part.",
)


_FAIL = (
    "Each trouble was made worse step by step until a status, an error or a note reported it, and"
    " until results that count as good were wrong. Where the second comes first, nothing warns. It"
    " belongs to the methods and not to the machine: the tables come with the program."
)
_GROW = "Time grows as the size to the power of the exponent."


def page(chart: Chart, picture: Picture, command: str) -> Page:
    """The page; `picture` is that of `draw_chart`."""
    sections = [
        Section(TITLES[name], *_panel(chart, name, panel))
        for name, panel in zip(chart.panels, picture.panels, strict=True)
    ]
    failed = tuple(
        Details(TITLES[name], (failure_table(chart.failures, name),)) for name in chart.panels
    )
    sections.append(Section("Where methods fail", _FAIL, f"Made by {made_by()}.", *failed))
    if chart.scalings:
        table = scaling_table(chart.scalings)
        megabytes = in_words(chart.frame_memory_mb, "{:.0f} MB", "unknown")
        memory = f"Peak memory of a process that renders a frame: {megabytes}."
        sections.append(Section("How time and memory grow", _GROW, table, memory))
    sections.append(Section("How it was measured", *_HOW))
    made = {"machine": chart.machine, "time of the chart": time_in_words(chart.time_s)}
    title = "Speed against accuracy"
    return Page(title, headline(chart), tuple(sections), command, made, chart.notes)


def _panel(chart: Chart, name: str, panel: PanelPicture) -> list[Content]:
    """A panel's picture and front, its other tasks, and all that was measured."""
    tasks = {task: chart.of(name, task) for task in chart.tasks(name)}
    main, reference = chart.tasks(name)[0], chart.of(name)[0].reference
    content: list[Content] = [
        f"{capital(main)}. Errors are against {reference}.",
        panel,
        measured_table(chart.front(name), "The Pareto front, the fastest first"),
    ]
    if picture := draw_other_tasks(chart, name):
        content.append(Details(counted(len(tasks) - 1, "other task"), (picture,)))
    tables = []
    for task, measured in tasks.items():
        ordered = sorted(measured, key=lambda m: (not np.isfinite(m.rms_px), m.rms_px))
        caption = f"{capital(task)}, against {measured[0].reference}"
        tables.append(measured_table(ordered, caption, whole=True))
    count = sum(map(len, tasks.values()))
    words = f"All {count} that were measured, the most accurate first"
    return [*content, Details(words, tuple(tables))]
