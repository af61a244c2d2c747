"""Maps: numbers for each pixel as colours, with the bar that says what they mean."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from math import ceil
from typing import Any, Literal

import cv2
import numpy as np
from matplotlib import colormaps
from matplotlib.axes import Axes
from matplotlib.colors import ListedColormap, Normalize
from matplotlib.figure import FigureBase
from matplotlib.patches import Patch
from matplotlib.ticker import FuncFormatter
from numpy.typing import NDArray

from virtual_sensor.reporting.pictures import Panel
from virtual_sensor.reporting.style import colour
from virtual_sensor.statuses import StatusEnum

Kind = Literal["signed", "size", "span", "phase"]
Window = tuple[slice, slice]
"""Rows and columns."""

NO_VALUE = "#D9D9D9"
"""Colour of pixels without a value."""

_COLOURS = {"signed": "RdBu_r", "size": "cividis", "span": "cividis", "phase": "twilight"}
_SHARE = 0.5  # percent of the values at either end that may lie beyond the colours
_NEAR = 1.5  # times the colours' range: within it all values have a colour of their own
_MOST_PX = 600  # of a map along a side
_MOST_VALUES = 1 << 18  # of which a scale is found
_MARGIN = 0.03  # about what is known, of its size
_NARROWEST = 0.5  # side of what is shown, by the other
_LEFT_IN, _LOW_IN, _BAR_IN = 0.75, 0.55, 1.2  # beside a map: its numbers, and the bar with its own
_BESIDE_BAR = 0.87  # of the width of axes, where the bar's words need the rest
_KEY_IN = 2.1  # beside a map of statuses
_BRIEF = (", step ", " "), (" of ", "/"), ("Gray bit", "bit"), ("inverted", "inv.")
_RAISED = str.maketrans("-0123456789", "⁻⁰¹²³⁴⁵⁶⁷⁸⁹")
_THUMB_PX = 150
_LABEL_PX = 0.16  # strip above a thumbnail, of its height


@dataclass(frozen=True)
class Scale:
    """What the colours of one or several maps mean.

    Attributes
    ----------
    kind : "signed", "size", "span" or "phase"
        Signed about zero; from zero on; from the least to the largest; 0 to 2 pi, round a circle.
    low, high : float
        What the first and the last colour stand for.
    beyond : "neither", "min", "max" or "both"
        At which ends there are values beyond the colours, as `colorbar(extend=...)` has it.
    """

    kind: Kind
    low: float
    high: float
    beyond: Literal["neither", "min", "max", "both"] = "neither"


def scale_of(kind: Kind, *maps: NDArray[Any]) -> Scale:
    """The scale that several maps share: a few values far off the others leave it as it is."""
    if kind == "phase":
        return Scale(kind, 0.0, 2.0 * np.pi)
    values = np.concatenate([_known(each) for each in maps]) if maps else np.zeros(0)
    if not values.size:
        return Scale(kind, -1.0 if kind == "signed" else 0.0, 1.0)
    least, most = float(values.min()), float(values.max())
    if kind == "signed":
        high = _within(max(-least, most), np.percentile(np.abs(values), 100.0 - _SHARE))
        low = -high
    else:
        low, high = np.percentile(values, (_SHARE, 100.0 - _SHARE))
        wide = high - low
        low = 0.0 if kind == "size" else least if high - least <= _NEAR * wide else low
        high = most if most - low <= _NEAR * (high - low) else high
    if not high > low:
        high = low + (abs(low) or 1.0)
        low = -high if kind == "signed" else low
    below, above = least < low, most > high
    beyond = "both" if below and above else "min" if below else "max" if above else "neither"
    return Scale(kind, float(low), float(high), beyond)  # type: ignore[arg-type]


def window_of(*maps: NDArray[Any]) -> Window:
    """Rows and columns in which any of the maps (H, W) has a value, with a margin; all, if none.

    A strip is shown with what is beside it: a map has room for the words on its bar.
    """
    known = np.any([np.isfinite(each) for each in maps], axis=0)
    if not known.any():
        return slice(0, known.shape[0]), slice(0, known.shape[1])
    ends = [np.flatnonzero(known.any(axis=1 - axis))[[0, -1]] for axis in (0, 1)]
    least = _NARROWEST * max(last - first for first, last in ends)
    found = []
    for (first, last), size in zip(ends, known.shape, strict=True):
        long = last - first
        margin = max(round(_MARGIN * long), ceil((least - long) / 2), 1)
        found.append(slice(max(int(first) - margin, 0), min(int(last) + 1 + margin, size)))
    return found[0], found[1]


def within(window: Window, shape: tuple[int, ...], whole: tuple[int, ...]) -> Window:
    """A window of whole images (H, W) in images of the same that are shrunk to a shape."""
    rows, columns = (
        slice(each.start * few // many, -(-each.stop * few // many))
        for each, few, many in zip(window, shape, whole, strict=True)
    )
    return rows, columns


def map_panel(
    title: str,
    values: NDArray[Any],
    words: str,
    scale: Scale | Kind = "span",
    window: Window | None = None,
    alt: str = "",
) -> Panel:
    """A panel with a map and its bar; for what is not said see `draw_map`."""
    window = window or window_of(values)

    def draw(figure: FigureBase) -> None:
        axes, (left, low, wide, high) = _placed(figure, window)
        bar = figure.add_axes((left + wide + 0.02, low + 0.04 * high, 0.025, 0.92 * high))
        draw_map(axes, values, words, scale, window, bar)

    alt = alt or f"{title}: {words}, pixel by pixel."
    return Panel(title, draw, alt, axes=False, layout=None)


def status_panel(title: str, status: NDArray[Any], kind: type[StatusEnum], alt: str) -> Panel:
    """A panel with what became of each pixel (H, W)."""

    def draw(figure: FigureBase) -> None:
        whole = slice(0, status.shape[0]), slice(0, status.shape[1])
        draw_statuses(_placed(figure, whole, _KEY_IN)[0], status, kind)

    return Panel(title, draw, alt, axes=False, layout=None)


def frames_panel(
    title: str, images: NDArray[Any], names: Sequence[str], window: Window | None, alt: str
) -> Panel:
    """A panel with small pictures of frames (K, H, W)."""

    def draw(figure: FigureBase) -> None:
        draw_frames(figure.add_axes((0.02, 0.02, 0.96, 0.86)), images, names, window)

    return Panel(title, draw, alt, axes=False, layout=None)


def _placed(
    figure: FigureBase, window: Window, beside_in: float = _BAR_IN
) -> tuple[Axes, tuple[float, float, float, float]]:
    """Axes as high as a panel and as wide as the pixels of a window then are, at its left."""
    width, height = (size / figure.dpi for size in (figure.bbox.width, figure.bbox.height))
    left, low, right, top = _LEFT_IN / width, _LOW_IN / height, 1.0 - beside_in / width, 0.9
    high_px, wide_px = (each.stop - each.start for each in window)
    wide = min((top - low) * height / width * wide_px / max(high_px, 1), right - left)
    high = min(wide * width / height * high_px / max(wide_px, 1), top - low)
    place = left, top - high, wide, high
    return figure.add_axes(place), place


def draw_map(
    axes: Axes,
    values: NDArray[Any],
    words: str,
    scale: Scale | Kind = "span",
    window: Window | None = None,
    bar: Axes | None = None,
) -> None:
    """Draw numbers (H, W) for each pixel; those without one are grey.

    Parameters
    ----------
    axes : Axes
    values : ndarray of shape (H, W)
        Of a large map every so many-th pixel is drawn.
    words : str
        What they are and their unit, beside the bar.
    scale : Scale, or its kind
        Of maps that are compared, one scale; a kind makes one of these values.
    window : pair of slice
        Rows and columns that are shown; by default those with values.
    bar : Axes, optional
        For the bar; by default beside `axes`, in their place.
    """
    window = window or window_of(values)
    scale = scale if isinstance(scale, Scale) else scale_of(scale, values[window])
    colours = colormaps[_COLOURS[scale.kind]].with_extremes(bad=NO_VALUE)
    drawn = _draw(axes, values, window, cmap=colours, norm=Normalize(scale.low, scale.high))
    place: dict[str, Any] = {"cax": bar}
    if bar is None:
        place = {"ax": axes, "shrink": 0.92, "aspect": 24}
        if axes.get_figure(root=True).get_layout_engine() is None:  # which makes room for words
            left, low, wide, high = axes.get_position(original=True).bounds
            axes.set_position((left, low, _BESIDE_BAR * wide, high))
            place |= {"use_gridspec": False}
    key = axes.figure.colorbar(drawn, extend=scale.beyond, **place)
    key.outline.set_linewidth(0.5)
    power = _power(scale)
    if power:
        key.formatter = FuncFormatter(lambda value, _: f"{value / 10.0**power:.10g}")
        words += f" in 10{str(power).translate(_RAISED)}"
    key.set_label(words)
    if scale.kind == "phase":
        key.set_ticks([0.0, np.pi, 2.0 * np.pi], labels=["0", "π", "2π"])
    if not np.isfinite(values[window]).any():
        axes.text(0.5, 0.5, "no values", transform=axes.transAxes, ha="center", va="center")


def draw_statuses(
    axes: Axes, status: NDArray[Any], kind: type[StatusEnum], window: Window | None = None
) -> None:
    """Draw what became of each pixel (H, W), with how many there are of each beside it."""
    counts = kind.counts(status)
    members = sorted(counts)
    paints = [colour(each.name.lower()) for each in members]
    number = np.searchsorted([int(each) for each in members], status).astype(float)
    window = window or (slice(0, status.shape[0]), slice(0, status.shape[1]))
    norm = Normalize(-0.5, len(members) - 0.5)
    _draw(axes, number, window, cmap=ListedColormap(paints), norm=norm)
    labels = [f"{each.name.lower()}: {_spaced(counts[each])}" for each in members]
    axes.legend(
        handles=[
            Patch(color=paint, label=label) for paint, label in zip(paints, labels, strict=True)
        ],
        loc="center left",
        bbox_to_anchor=(1.02, 0.5),
    )


def draw_frames(
    axes: Axes, images: NDArray[Any], names: Sequence[str], window: Window | None = None
) -> None:
    """Draw images (K, H, W) small and beside each other, each with its name above, of one white."""
    window = window or (slice(0, images.shape[1]), slice(0, images.shape[2]))
    images = images[:, window[0], window[1]]
    count, high, wide = images.shape
    shrink = min(_THUMB_PX / max(high, wide), 1.0)
    size = max(round(wide * shrink), 1), max(round(high * shrink), 1)
    columns = _columns(count, size[0] / (size[1] * (1.0 + _LABEL_PX)))
    rows, label = ceil(count / columns), max(round(_LABEL_PX * size[1]), 1)
    step_x, step_y = size[0] + 4, size[1] + label
    white = max((float(np.nanmax(each[::8, ::8], initial=0.0)) for each in images), default=0.0)
    names = [_brief(name) for name in names]
    across, up = columns * step_x - 4, rows * step_y
    place = axes.get_position(original=True)
    wide_pt, high_pt = (72.0 / axes.figure.dpi * size for size in axes.figure.bbox.size)
    room = step_x * min(place.width * wide_pt / across, place.height * high_pt / up)
    letters = float(np.clip(room / (0.6 * max(map(len, names), default=1)), 3.0, 8.0))
    sheet = np.full((up, across), np.nan)
    for number, (image, name) in enumerate(zip(images, names, strict=True)):
        top, left = number // columns * step_y + label, number % columns * step_x
        small = cv2.resize(
            np.nan_to_num(image.astype(np.float32)), size, interpolation=cv2.INTER_AREA
        )
        sheet[top : top + size[1], left : left + size[0]] = small / (white or 1.0)
        axes.text(left, top - 0.2 * label, name, fontsize=letters, va="bottom")
    colours = colormaps["gray"].with_extremes(bad=(1.0, 1.0, 1.0, 0.0))
    axes.imshow(sheet, colours, vmin=0.0, vmax=1.0, interpolation="nearest")
    axes.set_axis_off()


def _brief(name: str) -> str:
    """A pattern's name above a small picture: "u 16 px 2/4", "u bit 3 inv."."""
    for words, short in _BRIEF:
        name = name.replace(words, short)
    return name


def _columns(count: int, shape: float) -> int:
    """In how many columns so many cells, width by height, fill a panel best; even rows first."""
    wanted = max((1.55 * count / shape) ** 0.5, 1.0)
    even = [n for n in range(1, count + 1) if count % n == 0 and 0.6 <= n / wanted <= 1.7]
    return min(even, key=lambda n: abs(np.log(n / wanted))) if even else ceil(wanted)


def _power(scale: Scale) -> int:
    """Of ten, that the numbers of very small or large values leave out; 0: none."""
    power = int(np.floor(np.log10(max(abs(scale.low), abs(scale.high)))))
    return 0 if -3 <= power <= 4 else power


def _draw(axes: Axes, values: NDArray[Any], window: Window, **style: Any) -> Any:
    """The rows and columns of a window, every so many-th of them, in the axes of the image."""
    shown = values[window]
    step = max(ceil(max(shown.shape) / _MOST_PX), 1)
    left, top = window[1].start - 0.5, window[0].start - 0.5
    extent = (left, left + shown.shape[1], top + shown.shape[0], top)
    drawn = axes.imshow(
        shown[::step, ::step], extent=extent, aspect="equal", interpolation="nearest", **style
    )
    axes.grid(visible=False)
    axes.set(xlabel="u in px", ylabel="v in px")
    return drawn


def _known(values: NDArray[Any]) -> NDArray[Any]:
    """Finite values; of many every so many-th."""
    flat = np.asarray(values).ravel()
    flat = flat[:: max(flat.size // _MOST_VALUES, 1)]
    return flat[np.isfinite(flat)].astype(float)


def _within(most: float, usual: float) -> float:
    """The most, if it is not far off what is usual."""
    return most if most <= _NEAR * usual else float(usual)


def _spaced(count: int) -> str:
    """A number with its thousands apart."""
    return f"{count:,}".replace(",", "\N{NARROW NO-BREAK SPACE}")
