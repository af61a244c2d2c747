"""The chart as pictures: error over time, with the front marked, and labels that keep apart."""

from __future__ import annotations

from collections import defaultdict
from collections.abc import Mapping, Sequence
from itertools import pairwise
from pathlib import Path
from typing import Any

import numpy as np
from matplotlib import rc_context
from matplotlib.axes import Axes
from matplotlib.backends.backend_agg import FigureCanvasAgg
from matplotlib.figure import Figure
from matplotlib.lines import Line2D
from matplotlib.ticker import LogFormatterSciNotation, LogLocator, NullLocator
from matplotlib.transforms import Bbox

from virtual_sensor.files import written_whole
from virtual_sensor.studies.chart.chart import PANELS, Chart
from virtual_sensor.studies.chart.rung import Rung

PICTURE = "chart.png"
DPI = 100

# Okabe and Ito's colours, told apart by those who see no red or no green; the yellow is too pale.
_COLOURS = ("#0072b2", "#d55e00", "#009e73", "#cc79a7", "#56b4e9", "#e69f00", "#000000")
_MARKERS = "osD^vPX*<>phd"
_BEST = {"color": "0.25", "lw": 1.6}
_OTHERS = {"color": "0.55", "lw": 0.9, "ls": "--"}
_NARROW = 100.0  # an axis over less than this has ticks between powers of ten
_HARDLY = 0.97  # of the error of the one before: no reason for a name
_SMALLEST_PX = 1e-12  # what a logarithmic axis shows of an error of 0
_PREFIXES = ((1e-9, "ns"), (1e-6, "µs"), (1e-3, "ms"), (1.0, "s"))
_AROUND = [(0.0, 1.0), (0.7, 0.7), (1.0, 0.0), (0.7, -0.7), (0.0, -1.0), (-0.7, -0.7), (-1.0, 0.0)]


def draw_chart(chart: Chart, folder: Path) -> list[str]:
    """Draw all panels together, and each alone, larger.

    Returns
    -------
    list of str
        Names of the files, the one with all panels first.
    """
    names = chart.panels
    rows = (len(names) + 1) // 2
    columns = min(len(names), 2) or 1
    figure = Figure(figsize=(8.0 * columns, 0.6 + 6.4 * max(rows, 1)), dpi=DPI)
    figure.suptitle("Speed against accuracy on this machine", fontsize=14)
    for number, name in enumerate(names):
        _place(figure, rows, columns, number, chart, name)
    _write(figure, folder / PICTURE)
    written = [PICTURE]
    for name in names:
        alone = Figure(figsize=(12.0, 8.5), dpi=DPI)
        _place(alone, 1, 1, 0, chart, name)
        _write(alone, folder / f"{name}.png")
        written.append(f"{name}.png")
    return written


def label(rung: Rung, others: Sequence[Rung]) -> str:
    """A rung's name with those of its settings in which it differs from its namesakes."""
    same = [r for r in others if r.name == rung.name]
    differing = [
        key
        for key, value in rung.settings.items()
        if any(r.settings.get(key) != value for r in same)
    ]
    return ", ".join([rung.name, *(f"{key} {rung.settings[key]}" for key in differing)])


def family(rung: Rung) -> str:
    """What a rung is a variety of: its name up to the first comma; on the GPU, a family apart."""
    name = rung.name.partition(",")[0]
    on_gpu = str(rung.settings.get("variant", "")).startswith("cuda")
    return f"{name}, GPU" if on_gpu else name


def _place(figure: Figure, rows: int, columns: int, number: int, chart: Chart, name: str) -> None:
    """Draw one panel in its cell, with its key below it."""
    axes = figure.add_subplot(rows, columns, number + 1)
    height = figure.get_figheight()
    figure.subplots_adjust(
        left=0.85 / figure.get_figwidth(),
        right=1.0 - 0.85 / figure.get_figwidth(),
        top=1.0 - (0.95 if rows * columns > 1 else 0.5) / height,
        bottom=1.75 / height,
        wspace=0.3,
        hspace=0.5,
    )
    draw_panel(axes, chart.of(name), chart.fronts(name), name)


def draw_panel(
    axes: Axes, rungs: Sequence[Rung], fronts: Mapping[str, Sequence[Rung]], name: str
) -> None:
    """Draw a panel: filled marks for the front, hollow ones for what it beats.

    Of several references, the first one's front is named; the others' are small and dashed.
    """
    main = next(iter(fronts), "")
    panel = PANELS[name]
    shown = [r for r in rungs if np.isfinite([r.error_px, r.seconds]).all() and r.seconds > 0.0]
    unit_s, unit = _unit([r.seconds for r in shown])
    looks = _looks(shown)
    axes.set(xscale="log", yscale="log")
    ladders: dict[tuple[str, ...], list[tuple[float, float]]] = defaultdict(list)
    for rung in shown:
        at = (rung.seconds / unit_s, _error(rung))
        words = (str(value) for value in rung.settings.values() if isinstance(value, str))
        ladders[family(rung), rung.name, rung.reference, *words].append(
            at
        )  # they differ in numbers only
        colour, marker = looks[family(rung)]
        best = rung in fronts[rung.reference]
        size = (9 if best else 6) if rung.reference == main else (6 if best else 4)
        look: dict[str, Any] = {"marker": marker, "ls": "none", "color": colour}
        look |= {"mfc": colour if best else "white", "mec": "black" if best else colour}
        axes.plot(*at, **look, ms=size, mew=1.1, zorder=4 if best else 3)
    for (group, *_), points in ladders.items():
        axes.plot(*zip(*points, strict=True), color=looks[group][0], lw=0.8, alpha=0.45, zorder=1)
    axes.set_title(panel.title, fontsize=12, y=1.0)  # one that need not be looked for
    axes.set_xlabel(f"time for one {panel.counted} in {unit}")
    axes.set_ylabel("error in px, rms")
    axes.grid(which="major", alpha=0.3)
    axes.margins(0.12)
    axes.autoscale()
    axes.autoscale_view()
    for axis in (axes.xaxis, axes.yaxis):
        low, high = axis.get_view_interval()
        narrow = high < _NARROW * low
        axis.set_major_locator(LogLocator(subs=(1.0, 2.0, 5.0) if narrow else (1.0,), numticks=12))
        axis.set_major_formatter("{x:g}" if narrow else LogFormatterSciNotation())
        axis.set_minor_locator(NullLocator())  # they take half of the time of such a picture
    _micrometres(axes, shown)
    _key(axes, looks, list(fronts))
    axes.autoscale(False)
    for reference, front in fronts.items():
        points = [(r.seconds / unit_s, _error(r)) for r in front]
        corners = _steps(points, axes.get_xlim()[1])
        if reference != main:
            axes.plot(*zip(*corners, strict=True), **_OTHERS, zorder=1)
        elif front:
            axes.plot(*zip(*corners, strict=True), **_BEST, zorder=2)
            names = [label(r, rungs) for r in front]
            marks = [(r.seconds / unit_s, _error(r)) for r in shown]
            _name_front(axes, names, points, corners, marks)


def _steps(points: Sequence[tuple[float, float]], end: float) -> list[tuple[float, float]]:
    """Corners of a front: each error holds until the next one begins."""
    corners = list(points[:1])
    for x, y in points[1:]:
        corners += [(x, corners[-1][1]), (x, y)]
    return [*corners, *((end, y) for _, y in corners[-1:])]


def _error(rung: Rung) -> float:
    return max(rung.error_px, _SMALLEST_PX)


def _unit(seconds: Sequence[float]) -> tuple[float, str]:
    """The unit in which times in the middle are 1 or more, if there is one."""
    middle = float(np.median(seconds)) if len(seconds) else 1.0
    fitting = [each for each in _PREFIXES if each[0] <= middle]
    return fitting[-1] if fitting else _PREFIXES[0]


def _looks(rungs: Sequence[Rung]) -> dict[str, tuple[str, str]]:
    """Colour and marker of each family, in the order in which they come."""
    names = list(dict.fromkeys(map(family, rungs)))
    return {
        name: (_COLOURS[i % len(_COLOURS)], _MARKERS[i % len(_MARKERS)])
        for i, name in enumerate(names)
    }


def _micrometres(axes: Axes, rungs: Sequence[Rung]) -> None:
    """A second scale on the right, where errors mean something on the part."""
    both = [(r.error_um, r.error_px) for r in rungs if r.error_um > 0.0 and r.error_px > 0.0]
    if both:
        um = float(np.median([um / px for um, px in both]))
        right = axes.secondary_yaxis("right", functions=(lambda y: um * y, lambda y: y / um))
        right.set_ylabel(f"µm on the part (1 px is about {um:.3g} µm)")
        right.yaxis.set_minor_locator(NullLocator())


def _key(axes: Axes, looks: Mapping[str, tuple[str, str]], references: Sequence[str]) -> None:
    handles = [
        Line2D([], [], color=colour, marker=marker, ls="none", mfc="white", label=name)
        for name, (colour, marker) in looks.items()
    ]
    if looks:
        handles.append(Line2D([], [], marker="o", mfc="0.6", mec="k", label="the front", **_BEST))
    if looks and references[1:]:
        words = f"against other references: {len(references) - 1}"
        handles.append(Line2D([], [], label=words, **_OTHERS))
    axes.legend(
        handles=handles,
        loc="upper center",
        bbox_to_anchor=(0.5, -0.13),
        ncols=4,
        fontsize=8.5,
        frameon=False,
        columnspacing=1.2,
        handletextpad=0.4,
    )


def _name_front(
    axes: Axes,
    names: Sequence[str],
    points: Sequence[tuple[float, float]],
    corners: Sequence[tuple[float, float]],
    marks: Sequence[tuple[float, float]],
) -> None:
    """Write the names of a front beside its marks, where they cover no mark, step or name.

    What is hardly more accurate than the one named before it has no name of its own.
    """
    figure = axes.figure
    renderer = FigureCanvasAgg(figure).get_renderer()  # only it knows how large letters are
    places = axes.transData.transform(marks)
    taken = [Bbox.from_bounds(x - 8.0, y - 8.0, 16.0, 16.0) for x, y in places]
    for a, b in pairwise(axes.transData.transform(corners)):
        taken.append(Bbox([np.minimum(a, b), np.maximum(a, b)]).padded(1.5))
    last = np.inf
    for text, (x, y) in zip(names, points, strict=True):
        if y > _HARDLY * last:
            continue
        last = y
        at = axes.transData.transform((x, y))
        note = axes.annotate(text, (x, y), (0, 0), textcoords="offset points", fontsize=8.5)
        size = note.get_window_extent(renderer)
        box, middle = _free_place(at, size.width, size.height, taken, axes.bbox)
        taken.append(box)
        note.remove()
        axes.annotate(
            text,
            (x, y),
            (middle - at) * 72.0 / figure.dpi,
            textcoords="offset points",
            fontsize=8.5,
            ha="center",
            va="center",
            arrowprops={"arrowstyle": "-", "lw": 0.6, "color": "0.45", "shrinkA": 0, "shrinkB": 4},
            bbox={"fc": "white", "ec": "none", "alpha": 0.75, "pad": 0.8},
            zorder=5,
        )


def _free_place(
    at: np.ndarray, width: float, height: float, taken: Sequence[Bbox], frame: Bbox
) -> tuple[Bbox, np.ndarray]:
    """The nearest place for a box round a point that covers no other and stays in the frame."""
    best: tuple[float, Bbox, np.ndarray] | None = None
    for distance in np.arange(8.0, 220.0, 7.0):
        for dx, dy in _AROUND:
            away = np.array([dx * (distance + width / 2.0), dy * (distance + height / 2.0)])
            middle = at + away
            box = Bbox.from_bounds(middle[0] - width / 2, middle[1] - height / 2, width, height)
            out = max(frame.x0 - box.x0, box.x1 - frame.x1, frame.y0 - box.y0, box.y1 - frame.y1)
            crossed = sum(box.overlaps(other) for other in taken) + max(out, 0.0)
            if best is None or crossed < best[0]:
                best = (crossed, box, middle)
        if best and best[0] == 0.0:
            break
    assert best is not None
    return best[1], best[2]


def _write(figure: Figure, path: Path) -> None:
    # Hinted letters take a fifth of the time of such a picture, and look no better.
    with written_whole(path) as temporary, rc_context({"text.hinting": "none"}):
        figure.savefig(temporary, format="png", dpi=DPI)
