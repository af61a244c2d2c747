"""The style of all pictures: colours that mean the same on every page, letters and lines.

The colours are those of Okabe and Ito (2008), which people with any colour vision tell apart; what
they stand for also differs by marker or line style where it is drawn as curves.
"""

from __future__ import annotations

from collections.abc import Iterator
from contextlib import contextmanager
from itertools import cycle, islice
from typing import Any

from matplotlib import rc_context
from matplotlib.axes import Axes
from matplotlib.axis import Axis
from matplotlib.colors import to_rgb
from matplotlib.lines import Line2D
from matplotlib.ticker import FuncFormatter, LogLocator, NullFormatter

from virtual_sensor.errors import printable

BLUE, VERMILION, GREEN, ORANGE = "#0072B2", "#D55E00", "#009E73", "#E69F00"
SKY, PURPLE, YELLOW, BLACK, GREY = "#56B4E9", "#CC79A7", "#C9B400", "#000000", "#7A7A7A"
MAGENTA, LIME, BROWN, NAVY = "#E6007E", "#7AB800", "#8C564B", "#2B3A67"
CYCLE = (BLUE, VERMILION, GREEN, ORANGE, SKY, PURPLE, YELLOW, GREY, MAGENTA, LIME)
MARKERS = ("o", "s", "^", "D", "v", "P", "X", "*")
LINES = ("-", "--", "-.", ":")

ALONG = "y along the line, from its middle, in mm"
"""Label of an axis: probe rays and points are counted so."""

COLOURS = {
    # the part, and what is compared
    "cold": BLUE,
    "hot": VERMILION,
    "search": BLACK,
    "truth": BLACK,
    "bound": BLACK,
    "laser": GREEN,
    "camera": SKY,
    "line": YELLOW,
    # transports of light
    "straight": GREY,
    "first_order": ORANGE,
    "marched": BLUE,
    "tabulated": VERMILION,
    # searches
    "paper": PURPLE,
    "newton": BLUE,
    # points lit and measured
    "incidence_shift_um": PURPLE,
    "hot_error_um": VERMILION,
    "measured_shift_um": ORANGE,
    "cold_error_um": BLUE,
    # what makes points uncertain
    "detection": GREY,
    "air": ORANGE,
    "pose": SKY,
    "correlation": PURPLE,
    "model": VERMILION,
    # components of differences, in space and on the sensor
    "x": YELLOW,
    "y": SKY,
    "z": GREEN,
    "u": SKY,
    "v": GREEN,
    "norm": BLACK,
    # airs of the reproduction
    "resolved": BLUE,
    "blurred": ORANGE,
    "widened": PURPLE,
    # line detectors
    "parabola": GREY,
    "log_parabola": ORANGE,
    "centre_of_gravity": SKY,
    "gaussian": BLUE,
    "max_likelihood": VERMILION,
    "steger": GREEN,
    "weighted_gaussian": NAVY,
    "linear_interpolation": YELLOW,
    "fir4": BROWN,
    "fir8": PURPLE,
    # what became of a column or a point
    "ok": GREEN,
    "failed": VERMILION,
    "no_peak": "#B5B5B5",
    "saturated": VERMILION,
    "too_narrow": SKY,
    "at_border": GREY,
    "line_end": "#4D4D4D",
    "poor_fit": ORANGE,
    "bad_pixels": BLACK,
    "skewed": PURPLE,
    "doubled": BLUE,
    "cut": YELLOW,
    "overlapping": BROWN,
    "clipped": ORANGE,
    "corrected": SKY,
    "ghost": PURPLE,
    "black": "#4D4D4D",
    "low_modulation": SKY,
    "edge": YELLOW,
    "order": PURPLE,
    "outside": "#B5B5B5",
    "not_finite": ORANGE,
}

_RC = {
    "font.family": "DejaVu Sans",
    "font.size": 10.0,
    "axes.titlesize": 11.0,
    "axes.titleweight": "bold",
    "axes.titlelocation": "left",
    "axes.titley": 1.0,  # else each title is placed again, beside all that was drawn above the axes
    "axes.labelsize": 10.0,
    "xtick.labelsize": 9.5,
    "ytick.labelsize": 9.5,
    "legend.fontsize": 9.0,
    "legend.frameon": False,
    "axes.spines.top": False,
    "axes.spines.right": False,
    "axes.grid": True,
    "grid.color": "#DDDDDD",
    "grid.linewidth": 0.6,
    "axes.axisbelow": True,
    "lines.linewidth": 1.3,
    "lines.markersize": 4.0,
    "image.cmap": "cividis",
    "text.hinting": "none",  # hinted letters take a fifth of a picture's time, and are no clearer
    "axes.unicode_minus": True,
}


@contextmanager
def style() -> Iterator[None]:
    """Draw within this: letters, lines and grid of all pictures."""
    with rc_context(_RC):
        yield


def colour(name: str) -> str:
    """Colour of a thing that has one on every page.

    A name that has none, such as a user's own detector, gets one of the cycle, always the same.
    """
    if name in COLOURS:
        return COLOURS[name]
    return CYCLE[sum(name.encode()) % len(CYCLE)]


def colours(names: list[str] | tuple[str, ...]) -> dict[str, str]:
    """Colours of several things, all different as far as there are colours.

    Those that have one on every page keep it, others get what is left of the cycle.
    """
    found = {name: COLOURS[name] for name in names if name in COLOURS}
    free = [each for each in CYCLE if each not in found.values()] or list(CYCLE)
    others = [name for name in names if name not in found]
    return found | dict(zip(others, islice(cycle(free), len(others)), strict=True))


def letters_on(background: str) -> str:
    """Black or white, whichever is better read on a colour."""
    red, green, blue = to_rgb(background)
    return "black" if 0.299 * red + 0.587 * green + 0.114 * blue > 0.5 else "white"


def drawable(text: str) -> str:
    """A user's text for a picture: no formula, no control characters, of a length that fits."""
    text = printable(text).replace("\n", " ")
    if len(text) > 60:
        text = f"{text[:28]} ... {text[-27:]}"
    return text.replace("$", r"\$")


def write_beside(
    axes: Axes,
    words: str,
    at: tuple[float, float],
    offset: tuple[float, float],
    **style: Any,
) -> None:
    """Write words so many printer's points to the right of a point and above it."""
    side = "center" if offset[0] == 0.0 else "left" if offset[0] > 0.0 else "right"
    style = {"ha": side, "va": "center", "fontsize": 9.5} | style
    axes.annotate(words, at, offset, textcoords="offset points", **style)


def write_on_line(axes: Axes, words: str, y: float, right: bool = False, **style: Any) -> None:
    """Write words above a horizontal line, at its left or right end."""
    at = (0.99 if right else 0.01, y)
    style = {"ha": "right" if right else "left", "va": "bottom"} | style
    write_beside(axes, words, at, (0.0, 3.0), xycoords=axes.get_yaxis_transform(), **style)


def key(label: str, **style: Any) -> Line2D:
    """An entry of a key, whose curves or marks may differ from it."""
    return Line2D([], [], label=label, **style)


def decimal_ticks(axis: Axis, fine: bool = False) -> None:
    """Have a logarithmic axis say 0.001, 0.01, 0.1, 1, 10 in place of powers; fine: 2 and 5 too."""
    if fine:
        axis.set_major_locator(LogLocator(subs=(1.0, 2.0, 5.0)))
    axis.set_major_formatter(FuncFormatter(lambda value, _: f"{value:.10g}"))
    axis.set_minor_formatter(NullFormatter())
