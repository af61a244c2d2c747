"""What was found in an image, as files: centres as CSV, points as PLY, and a picture."""

import warnings
from collections.abc import Sequence
from pathlib import Path
from typing import Any

import numpy as np
from matplotlib.axes import Axes
from matplotlib.colors import ListedColormap
from matplotlib.figure import Figure
from matplotlib.patches import Patch
from numpy.typing import NDArray

from virtual_sensor.files import written_whole
from virtual_sensor.metrology.centres import LineCentres, Status
from virtual_sensor.studies.detect import Detected
from virtual_sensor.studies.tables import status_names, vectors, write_csv, write_ply

_MARGIN_PX = 15
_POINTS = 72  # of an inch
_PEAKS = ("#ff3030", "#30c8ff", "#ffd030", "#c060ff", "#60ff60")
_STATUS = ListedColormap(
    (
        *("#2e9e4f", "#dddddd", "#e8590c", "#845ef7", "#495057"),
        *("#f59f00", "#c92a2a", "#000000", "#d6336c", "#1971c2", "#0b7285"),
    )
)


def names_of(paths: Sequence[Path]) -> list[str]:
    """A name for each image's files, all different: its own, of letters that print."""
    names: list[str] = []
    for path in paths:
        stem = _printable(path.stem)
        name, number = stem, 2
        while name in names:
            name, number = f"{stem}_{number}", number + 1
        names.append(name)
    return names


def _printable(name: str) -> str:
    """A file's name without control characters, and without bytes that are no UTF-8."""
    return "".join(c if c.isprintable() else "_" for c in name)


def save_detected(found: Detected, name: str, folder: Path) -> None:
    """Write ``name.csv``, ``name.png`` and, with a calibration, ``name.ply`` into a folder."""
    write_csv(folder / f"{name}.csv", centre_table(found))
    if found.points_mm is not None:
        points = found.points_mm.reshape(-1, 3)
        write_ply(folder / f"{name}.ply", points, found.line.amplitude.ravel())
    draw_overlay(found, folder / f"{name}.png")


def centre_table(found: Detected) -> dict[str, Any]:
    """Columns of one row for each centre; with several peaks, peak by peak."""
    line = found.line
    table: dict[str, Any] = {}
    if line.status.ndim > 1:
        table["peak"] = np.repeat(np.arange(line.status.shape[0]), line.status.shape[1])
    for name in ("column", "row", "sigma", "width", "amplitude", "background", "normal_deg"):
        table[name] = np.ravel(getattr(line, name))
    table["status"] = status_names(line.status, Status)
    if found.points_mm is not None:
        table |= vectors("point_mm", found.points_mm.reshape(-1, 3), "xyz")
    return table


def draw_overlay(found: Detected, path: Path) -> None:
    """Draw the image with the centres on it, what became of each column, and their sigma."""
    line, image = found.line, found.image
    figure = Figure(figsize=(11.0, 7.0), dpi=110)
    top, middle, bottom = figure.subplots(3, 1, height_ratios=(5.0, 0.45, 1.5))
    figure.subplots_adjust(left=0.08, right=0.985, bottom=0.07, top=0.93, hspace=0.42)
    good = line.status == Status.OK
    figure.suptitle(
        f"{_printable(found.path.name)}: {int(good.sum())} centres", fontsize=12, parse_math=False
    )
    _image(top, image, line)
    many = line.status.ndim > 1
    pixel = line.pixel if many else line.pixel[None]
    for rank, centres in enumerate(pixel):
        label = f"peak {rank + 1}" if many else "centres"
        colour = _PEAKS[rank % len(_PEAKS)]
        top.plot(*centres.T, ".", ms=1.6, color=colour, label=label)
    if good.any():
        top.legend(loc="upper right", markerscale=6, fontsize=8)
    upright = bool(np.all(line.normal_deg == 0.0)) and line.status.size > 0
    place = line.row if upright else line.column
    place = np.asarray(place, float).reshape(pixel.shape[:2])
    status = line.status.reshape(pixel.shape[:2])
    for strip in (middle, bottom):  # as far as the image above goes
        strip.set_xlim(sorted(top.get_ylim()) if upright else top.get_xlim())
    _statuses(middle, place, status)
    for rank, sigma in enumerate(line.sigma.reshape(pixel.shape[:2])):
        bottom.plot(place[rank], sigma, ".", ms=2, color=_PEAKS[rank % len(_PEAKS)])
    told = line.sigma[np.isfinite(line.sigma)]
    if told.size:
        bottom.set_ylim(0.0, 1.3 * max(float(np.percentile(told, 99.0)), 1e-12))
        bottom.ticklabel_format(axis="y", style="sci", scilimits=(-2, 3))
    else:
        bottom.text(0.5, 0.5, "no sigma is known", ha="center", transform=bottom.transAxes)
    bottom.set(ylabel="sigma in px", title="standard deviation that the detector predicts")
    bottom.set_xlabel("v in px" if upright else "u in px")
    with written_whole(path) as temporary, warnings.catch_warnings():
        warnings.filterwarnings("ignore", "Glyph")  # letters of a name that the font lacks
        figure.savefig(temporary, format="png", pil_kwargs={"compress_level": 1})


def _image(axes: Axes, image: NDArray, line: LineCentres) -> None:
    """The part of the image in which there is something of a line, or all of it."""
    height, width = image.shape
    there = line.status != Status.NO_PEAK
    left, right = _range(line.column[there], width)
    top, bottom = _range(line.row[there], height)
    shown = image[top:bottom, left:right].astype(float)
    shown[~np.isfinite(shown)] = np.nan
    extent = (left - 0.5, right - 0.5, bottom - 0.5, top - 0.5)
    axes.imshow(shown, cmap="gray", aspect="auto", extent=extent, interpolation="nearest")
    axes.set(xlim=extent[:2], ylim=extent[2:], ylabel="v in px")


def _range(place: NDArray, size: int) -> tuple[int, int]:
    """First pixel, and that behind the last, about places along one axis of the image."""
    place = place[np.isfinite(place)]
    if not place.size:
        return 0, size
    first, last = int(np.floor(place.min())), int(np.ceil(place.max()))
    return max(first - _MARGIN_PX, 0), min(last + _MARGIN_PX + 1, size)


def _statuses(axes: Axes, place: NDArray, status: NDArray) -> None:
    """A strip that tells what became of each column or row, or of each point."""
    columns = np.ptp(axes.get_xlim())
    width = _POINTS * axes.get_window_extent().width / axes.figure.dpi
    broad = max(1.2 * width / columns, 1.5)  # not finer than the picture's pixels: it would gap
    for rank in range(len(status)):
        axes.scatter(
            place[rank],
            np.full(place.shape[1], rank),
            c=status[rank],
            cmap=_STATUS,
            vmin=-0.5,
            vmax=len(Status) - 0.5,
            marker="|",
            s=120,
            linewidths=broad,
        )
    present = [s for s in Status if np.any(status == s)]
    handles = [
        Patch(color=_STATUS(int(s)), label=f"{s.name.lower()}: {int(np.sum(status == s))}")
        for s in present
    ]
    axes.set(yticks=[], ylim=(len(status) - 0.5, -0.5))
    if handles:
        axes.legend(
            handles=handles,
            loc="lower left",
            bbox_to_anchor=(0.0, 1.0),
            ncols=6,
            fontsize=7.5,
            frameon=False,
        )
