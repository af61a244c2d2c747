"""Pictures made of panels, drawn once: the whole as one PNG, and each panel for a page.

A page shows the panels below each other, as wide as its reader's screen; the file beside it shows
them all at a glance.
"""

from __future__ import annotations

import textwrap
import warnings
from collections.abc import Callable, Mapping, Sequence
from concurrent.futures import ThreadPoolExecutor
from dataclasses import dataclass
from math import ceil
from pathlib import Path
from typing import Any, Literal

import cv2
import numpy as np
from matplotlib.axes import Axes
from matplotlib.backends.backend_agg import FigureCanvasAgg
from matplotlib.figure import Figure, FigureBase
from matplotlib.lines import Line2D
from numpy.typing import NDArray

from virtual_sensor.display import Displayed
from virtual_sensor.files import written_whole
from virtual_sensor.reporting.style import style

Image8 = NDArray[np.uint8]
DPI = 100
CELL_IN = (6.0, 4.2)
"""Width and height of a panel of one cell, inches."""
_MARGINS_IN = (0.8, 0.2, 0.6, 0.4)
"""Left, right, bottom and top of a panel's axes, without a layout engine."""
_PAD_IN = 0.1
_LINE_PX, _LETTER_PX = 26, 12.5
_SEEN = 5.0  # points: dots of a key that show their colour


@dataclass(frozen=True)
class Panel(Displayed):
    """What one panel shows, and how it is drawn.

    Attributes
    ----------
    title : str
    draw : callable
        Gets the panel's axes; or, if `axes` is False, its figure.
    alt : str
        Alternative text: what a reader sees who can't see it.
    width, height : int
        Cells that it takes.
    axes : bool
        Whether `draw` wants one axes; else it gets the panel's figure, and makes its own in it.
    layout : "constrained" or None
        None sets fixed margins, which fit labels of usual length: a layout engine draws all of it
        twice, to see how large the letters are.
    """

    title: str
    draw: Callable[[Any], object]
    alt: str
    width: int = 1
    height: int = 1
    axes: bool = True
    layout: Literal["constrained"] | None = "constrained"


@dataclass(frozen=True)
class PanelPicture(Displayed):
    """A panel as it was drawn.

    Attributes
    ----------
    title, alt : str
    png : bytes
    width_px, height_px : int
    """

    title: str
    alt: str
    png: bytes
    width_px: int
    height_px: int

    def _line(self) -> str:
        return f"{self.title}, {self.width_px} x {self.height_px} px"


@dataclass(frozen=True)
class Picture(Displayed):
    """A drawn picture.

    Attributes
    ----------
    title : str
    png : bytes
        All of it.
    panels : tuple of PanelPicture
        The same, cut into its panels.
    """

    title: str
    png: bytes
    panels: tuple[PanelPicture, ...]

    def _line(self) -> str:
        return f"{self.title}, {len(self.panels)} panels"

    def write(self, path: Path) -> None:
        """Write the whole as a PNG file.

        Raises
        ------
        InputError
            If it can't be written.
        """
        with written_whole(path) as temporary:
            temporary.write_bytes(self.png)


def draw_picture(
    title: str,
    panels: Sequence[Panel],
    columns: int = 2,
    cell_in: tuple[float, float] = CELL_IN,
) -> Picture:
    """Draw panels in rows of so many cells, each where the next one fits.

    Parameters
    ----------
    title : str
        Above them all; "" for none. A user's text goes through `style.drawable` first.
    panels : sequence of Panel
    columns : int
        Cells of a row; of fewer panels fewer.
    cell_in : pair of float
        Width and height of a cell, inches.
    """
    rows, columns, places = _arranged(panels, columns)
    wide, high = (round(inches * DPI) for inches in cell_in)
    parts, coded = [], []
    with style(), ThreadPoolExecutor() as aside:
        for panel in panels:
            parts.append(_drawn(panel, (panel.width * wide, panel.height * high)))
            coded.append(aside.submit(_png, parts[-1]))  # while the next one is drawn
        head = _title(title, columns * wide)
    whole = np.full((len(head) + rows * high, columns * wide, 3), 255, np.uint8)
    whole[: len(head)] = head
    for part, (row, column) in zip(parts, places, strict=True):
        top, left = len(head) + row * high, column * wide
        whole[top : top + part.shape[0], left : left + part.shape[1]] = part
    cut = tuple(
        PanelPicture(panel.title, panel.alt, png.result(), part.shape[1], part.shape[0])
        for panel, part, png in zip(panels, parts, coded, strict=True)
    )
    return Picture(title, _png(whole), cut)


def beside(panels: Mapping[str, PanelPicture], *names: str) -> Picture:
    """Those of the panels that there are, beside each other on a page where there is room."""
    return Picture("", b"", tuple(panels[name] for name in names if name in panels))


def write_vector(
    path: Path,
    title: str,
    panels: Sequence[Panel],
    columns: int = 2,
    cell_in: tuple[float, float] = CELL_IN,
) -> None:
    """Write a picture as curves and letters, by its suffix as SVG or PDF; see `draw_picture`.

    Raises
    ------
    InputError
        If it can't be written.
    """
    rows, columns, places = _arranged(panels, columns)
    with style(), written_whole(path) as temporary:
        lines = _lines(title, round(columns * cell_in[0] * DPI))
        figure = Figure(figsize=(columns * cell_in[0], rows * cell_in[1]), layout="constrained")
        grid = figure.add_gridspec(rows, columns)
        for panel, (row, column) in zip(panels, places, strict=True):
            part = figure.add_subfigure(
                grid[row : row + panel.height, column : column + panel.width]
            )
            _draw_in(part, panel)
        if lines:
            figure.suptitle("\n".join(lines), x=0.01, ha="left", fontsize=14, fontweight="bold")
        with warnings.catch_warnings():
            warnings.filterwarnings("ignore", "Glyph")
            figure.savefig(temporary, format=path.suffix.lower().lstrip("."))


def key_above(axes: Axes) -> None:
    """A legend above the axes, beside the title, where it covers nothing."""
    handles, _ = axes.get_legend_handles_labels()
    if not handles:
        return
    wide = axes.figure.get_figwidth() > 8.0
    key = axes.legend(
        loc="lower right" if wide else "lower left",
        bbox_to_anchor=(1.0, 1.0) if wide else (-0.02, 1.0),
        ncols=len(handles),
        columnspacing=1.0,
        handlelength=1.6,
        borderaxespad=0.2,
    )
    for each in key.legend_handles:
        if isinstance(each, Line2D):  # whose colour a small dot does not show
            each.set_markersize(max(each.get_markersize(), _SEEN))
    if not wide:
        axes.set_title(axes.get_title(loc="left"), pad=24)
        axes.figure.subplots_adjust(top=1.0 - 0.62 / axes.figure.get_figheight())


def side_of(points: NDArray[np.float64]) -> tuple[int, int]:
    """The two of the axes x, y, z along which points extend farthest, z upwards if it is one."""
    known = points[np.isfinite(points).all(axis=1)] if len(points) else np.zeros((1, 3))
    extent = np.ptp(known, axis=0) if len(known) else np.zeros(3)
    across, up = sorted(np.argsort(extent, kind="stable")[1:].tolist())
    return across, up


def from_side(axes: Axes, across: int, up: int) -> None:
    """The words of axes that show two of x, y, z, with one scale."""
    axes.set(xlabel=f"{'xyz'[across]} in mm", ylabel=f"{'xyz'[up]} in mm")
    axes.set_aspect("equal", adjustable="datalim")


def coarser(image: NDArray[Any], most_px: int = 900) -> tuple[NDArray[np.float32], tuple[int, int]]:
    """An image of so many pixels a side at most, for a picture; and how many became one.

    Blocks of pixels are taken as one, their brightest: so a line of a pixel is seen in any size.
    The other two numbers are the blocks' rows and columns.
    """
    block = tuple(max(-(-size // most_px), 1) for size in image.shape)
    values = np.where(np.isfinite(image), image, np.nan).astype(np.float32)
    spare = [(0, -size % step) for size, step in zip(image.shape, block, strict=True)]
    padded = np.pad(values, spare, mode="edge")
    rows, columns = padded.shape
    blocks = padded.reshape(rows // block[0], block[0], columns // block[1], block[1])
    return np.fmax.reduce(np.fmax.reduce(blocks, axis=3), axis=1), (block[0], block[1])


def _arranged(panels: Sequence[Panel], most: int) -> tuple[int, int, list[tuple[int, int]]]:
    """Rows and columns of a picture of at most so many columns, and the place of each panel."""
    columns = max(min(most, sum(p.width for p in panels)), *(p.width for p in panels))
    places = _places(panels, columns)
    rows = max(row + panel.height for (row, _), panel in zip(places, panels, strict=True))
    return rows, columns, places


def _drawn(panel: Panel, size_px: tuple[int, int]) -> Image8:
    """A panel of some width and height as pixels (H, W, 3)."""
    figure = _figure(size_px, panel.layout)
    if panel.axes:
        axes = figure.add_subplot()
        if panel.layout is None:
            width, height = size_px[0] / DPI, size_px[1] / DPI
            left, right, bottom, top = _MARGINS_IN
            figure.subplots_adjust(
                left=left / width,
                right=1.0 - right / width,
                bottom=bottom / height,
                top=1.0 - top / height,
            )
        _draw_in(figure, panel, axes)
    else:
        _draw_in(figure, panel)
    return _pixels(figure)


def _draw_in(figure: FigureBase, panel: Panel, axes: Axes | None = None) -> None:
    """Draw a panel in its figure, or in axes of it."""
    if panel.axes:
        axes = axes or figure.add_subplot()
        axes.set_title(panel.title, wrap=panel.layout is not None)  # its lines find their room
        panel.draw(axes)
    else:
        figure.suptitle(panel.title, x=0.02, ha="left", fontsize=11, fontweight="bold")
        panel.draw(figure)


def _title(title: str, width_px: int) -> Image8:
    """The picture's title as a strip of pixels; lines that are too long are broken."""
    if not title:
        return np.zeros((0, width_px, 3), np.uint8)
    lines = _lines(title, width_px)
    figure = _figure((width_px, _LINE_PX * len(lines) + 12), None)
    text = "\n".join(lines)
    figure.text(12 / width_px, 0.5, text, va="center", fontsize=14, fontweight="bold")
    return _pixels(figure)


def _lines(title: str, width_px: int) -> list[str]:
    """A title in lines, without the backticks that mark code in other texts."""
    return textwrap.wrap(title.replace("`", ""), max(round(width_px / _LETTER_PX), 20))


def _figure(size_px: tuple[int, int], layout: Literal["constrained"] | None) -> Figure:
    figure = Figure(figsize=(size_px[0] / DPI, size_px[1] / DPI), dpi=DPI, layout=layout)
    if engine := figure.get_layout_engine():
        engine.set(w_pad=_PAD_IN, h_pad=_PAD_IN)
    return figure


def _pixels(figure: Figure) -> Image8:
    canvas = FigureCanvasAgg(figure)
    with warnings.catch_warnings():
        warnings.filterwarnings("ignore", "Glyph")  # letters of a name that the font lacks
        canvas.draw()
    return np.array(canvas.buffer_rgba())[..., :3]


def _places(panels: Sequence[Panel], columns: int) -> list[tuple[int, int]]:
    """Row and column of each panel: the first free place from above left that holds it."""
    taken: set[tuple[int, int]] = set()
    places = []
    for panel in panels:
        at = next(
            (row, column)
            for row in range(ceil(len(taken) / columns) + len(panels) + 1)
            for column in range(columns - panel.width + 1)
            if not taken & _cells(panel, row, column)
        )
        taken |= _cells(panel, *at)
        places.append(at)
    return places


def _cells(panel: Panel, row: int, column: int) -> set[tuple[int, int]]:
    return {(row + i, column + j) for i in range(panel.height) for j in range(panel.width)}


def _png(image: Image8) -> bytes:
    done, data = cv2.imencode(".png", image[..., ::-1])
    assert done
    return bytes(data)
