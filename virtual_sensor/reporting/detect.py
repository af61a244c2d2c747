"""What was found in images, as files: centres as CSV, points as PLY, pictures and a page."""

from __future__ import annotations

from collections import Counter
from collections.abc import Callable, Iterable, Sequence
from dataclasses import dataclass
from functools import partial
from pathlib import Path
from urllib.parse import quote

import numpy as np
from matplotlib.axes import Axes
from numpy.typing import NDArray

from virtual_sensor.errors import printable
from virtual_sensor.files import RESULTS_SIGN, folder_written_whole
from virtual_sensor.metrology.centres import FOUND_NAMES, Status
from virtual_sensor.metrology.detectors import STEGER
from virtual_sensor.records import Record, plain, write_csv, write_ply
from virtual_sensor.reporting.files import FileOf, write_results
from virtual_sensor.reporting.page import PAGE, Content, Page, Section
from virtual_sensor.reporting.pictures import (
    CELL_IN,
    Panel,
    PanelPicture,
    Picture,
    coarser,
    draw_picture,
)
from virtual_sensor.reporting.style import (
    BLACK,
    GREEN,
    ORANGE,
    PURPLE,
    SKY,
    YELLOW,
    colour,
    drawable,
    write_on_line,
)
from virtual_sensor.reporting.tables import Column, Link, TextTable, pair_table, text_table
from virtual_sensor.reporting.words import (
    anchor,
    counted,
    heading,
    in_words,
    time_in_words,
    unbroken,
)
from virtual_sensor.studies.detect import (
    CentreTable,
    Detected,
    ImageSummary,
    Settings,
    Skipped,
    joined_notes,
)
from virtual_sensor.studies.provenance import Versions, versions

Window = tuple[int, int, int, int]
"""The first column and that behind the last, and such rows."""
MOST_WHOLE_PICTURES = 20
"""Of more images than that, the page shows one panel each; the picture files have all."""

_ON_PAGES = {"size", "median_width_px", "time_s"}
"""Columns for which the console has no room."""
_PEAKS = (GREEN, SKY, ORANGE, PURPLE, YELLOW)
_POINTS = 72.0  # of an inch
_MARGIN_PX, _CLOSE_UP_PX = 12, (48, 30)
_MOST_STRETCH, _LEAST_STRETCH = 50.0, 1.5
_PANEL_SHAPE = 0.62  # height over width of a panel's axes


@dataclass(frozen=True)
class Summary(Record):
    """What a command found in all its images.

    Attributes
    ----------
    command : str
        The exact command that was given.
    made_with : Versions
        Versions.
    settings : Settings
        How the line was sought.
    calibration : Path or None
        File that the points come by.
    dark : Path or None
        Image, or folder of them, that was subtracted.
    images : dict of str to ImageSummary
        By the name that their files have.
    skipped : dict of str to str
        Files that could not be used, and why.
    notes : tuple of str
        What was converted, assumed or left out.
    """

    command: str
    made_with: Versions
    settings: Settings
    calibration: Path | None
    dark: Path | None
    images: dict[str, ImageSummary]
    skipped: dict[str, str]
    notes: tuple[str, ...]

    @property
    def centres(self) -> int:
        """Of all images."""
        return sum(each.centres for each in self.images.values())


FILES = (
    FileOf(PAGE, "Page with the table of all images and their pictures."),
    FileOf("*.png", "Picture of an image: centres, statuses, predicted errors."),
    FileOf("*.csv", "Line centres of an image.", CentreTable),
    FileOf("*.ply", "Points of an image by --calibration: world, mm, with the line's height."),
    FileOf(RESULTS_SIGN, "Settings, and what was found in each image.", Summary),
)


def names_of(paths: Sequence[Path]) -> list[str]:
    """A name for each image's files, all different: its own, of letters that print."""
    names: list[str] = []
    for path in paths:
        stem = "".join(c if c.isprintable() else "_" for c in path.stem)
        name, number = stem, 2
        while name in names:
            name, number = f"{stem}_{number}", number + 1
        names.append(name)
    return names


def save(
    found: Iterable[Detected | Skipped],
    paths: Sequence[Path],
    settings: Settings,
    folder: Path,
    command: str,
    overwrite: bool = False,
    calibration: Path | None = None,
    dark: Path | None = None,
    notes: Sequence[str] = (),
    report: Callable[[str, float], None] = lambda stage, fraction: None,
) -> Summary:
    """Write tables, pictures and page of the images while they are found; all of them or none.

    Parameters
    ----------
    found : iterable of Detected or Skipped
        One for each path, in order; none stays in memory.
    paths : sequence of Path
    settings : Settings
        With which it was found.
    folder : Path
    command : str
        The exact command that was given.
    overwrite : bool
        Whether earlier results are replaced.
    calibration : Path, optional
        That gave the points.
    dark : Path, optional
        That was subtracted.
    notes : sequence of str
        Beside the images' own.
    report : callable
        Gets the image's name, and the fraction done.

    Raises
    ------
    InputError
        If an image can't be read, or the folder can't be written.
    """
    names = names_of(paths)
    skipped: dict[str, str] = {}
    images: dict[str, ImageSummary] = {}
    shown: dict[str, Picture | PanelPicture] = {}
    remarks = []
    with folder_written_whole(folder, overwrite) as place:
        report(names[0], 0.0)
        for number, (name, each) in enumerate(zip(names, found, strict=True), 1):
            report(name, number / len(paths))
            if isinstance(each, Skipped):
                skipped[f"{each.path}"] = each.reason
                continue
            write_csv(place / f"{name}.csv", each.centres)
            if each.points_mm is not None:
                points = each.points_mm.reshape(-1, 3)
                write_ply(place / f"{name}.ply", points, each.line.amplitude.ravel())
            picture = draw(each, name, settings)
            picture.write(place / f"{name}.png")
            shown[name] = picture if len(paths) <= MOST_WHOLE_PICTURES else picture.panels[0]
            images[name] = each.summary
            remarks.append((each.path, each.remarks))
        said = (*notes, *joined_notes(remarks))
        summary = Summary(
            *(command, versions(), settings, calibration, dark, images, skipped, said)
        )
        write_results(place, FILES, {PAGE: page(summary, shown), RESULTS_SIGN: summary})
    return summary


def table(summary: Summary, page: bool = False) -> TextTable:
    """The images one by one: what was found, and what became of the other columns.

    On a page it has links to the images' pictures, and more columns.
    """
    rows, many = [], page and len(summary.images) > 1
    for number, (name, image) in enumerate(summary.images.items(), 1):
        others = {s: n for s, n in image.statuses.items() if s not in FOUND_NAMES}
        more = {
            "name": Link(name, f"#{anchor(_title(number, name))}") if many else name,
            "size": unbroken(f"{image.columns} x {image.rows} px"),
            "centres": _centres(image.statuses) if page else image.centres,
            "others": _most(others, len(others) if page else 2),
        }
        rows.append(plain(image) | more)
    columns = [
        Column("name", "image"),
        Column("size"),
        Column("centres", shape="{}"),
        Column("median_sigma_px", "sigma in px", nothing="none"),
        Column("median_width_px", "width in px", "{:.2f}", nothing="none"),
        Column("others", "without a centre"),
        Column("time_s", "detector's time", lambda seconds: unbroken(time_in_words(seconds))),
    ]
    if not page:
        columns = [each for each in columns if each.name not in _ON_PAGES]
    searched = {each.along for each in summary.images.values()}
    return text_table(rows, columns, caption=f"{described(summary.settings, searched)}; medians")


def _centres(statuses: dict[str, int]) -> str:
    """How many, and how many of them are clipped or corrected."""
    numbers = {name: statuses[name] for name in FOUND_NAMES if name in statuses}
    said = [f"{n} {_words(name)}" for name, n in numbers.items() if name != FOUND_NAMES[0]]
    of_them = f" ({', '.join(map(unbroken, said))})" if said else ""
    return f"{sum(numbers.values())}{of_them}"


def skipped(summary: Summary) -> TextTable:
    """The images that could not be used."""
    return pair_table(("skipped", "why"), summary.skipped)


def described(settings: Settings, searched: Iterable[str | None]) -> str:
    """The detector, what was searched, and the settings that are not the usual ones."""
    usual = plain(Settings())
    said = [
        f"{heading(name)} {value}"
        for name, value in plain(settings).items()
        if name not in ("detector", "along") and value != usual[name]
    ]
    along = _either(searched)
    return ", ".join([settings.detector, *([f"along {along}"] if along else []), *said])


def _either(searched: Iterable[str | None]) -> str:
    """Columns, rows, or both; nothing where lines of any direction were sought."""
    return " or ".join(sorted({along for along in searched if along}))


def page(summary: Summary, shown: dict[str, Picture | PanelPicture]) -> Page:
    """The page: the table of all images, then the picture of each."""
    many = len(summary.images) > 1
    name = next(iter(summary.images))
    sections = [Section("Images" if many else "Result", table(summary, page=True))]
    if summary.skipped:
        sections.append(Section("Skipped", skipped(summary)))
    for number, (each, picture) in enumerate(shown.items(), 1):
        content: list[Content] = [picture]
        if isinstance(picture, PanelPicture):
            content.append(Link(f"All panels: {each}.png", f"{quote(each)}.png"))
        content.append(Link(f"Centres as a table: {each}.csv", f"{quote(each)}.csv"))
        sections.append(Section(_title(number, each) if many else "Picture", *content))
    settings = {heading(name): value for name, value in plain(summary.settings).items()}
    settings |= {"calibration": plain(summary.calibration), "dark": plain(summary.dark)}
    sections.append(Section("Settings", pair_table(("setting", "value"), settings, "not given")))
    return Page(
        title=f"Line centres in {counted(len(summary.images), 'image') if many else name}",
        lead=lead(summary),
        sections=tuple(sections),
        command=summary.command,
        made_with=summary.made_with,
        notes=summary.notes,
    )


def lead(summary: Summary) -> str:
    """What a reader wants to know first: how many centres there are, how good, and why not more."""
    images = summary.images.values()
    reasons = sum((Counter(each.statuses) for each in images), Counter[str]())
    totals, lines = reasons.copy(), reasons.total()
    for name in FOUND_NAMES:
        reasons.pop(name, None)
    why = _most(reasons, 3)
    skipped = len(summary.skipped)
    left = f" {counted(skipped, 'image')} could not be used." if skipped else ""
    if not summary.centres:
        return f"No line centre was found{f': {why}' if why else ''}.{left}"
    sigma = np.array([each.median_sigma_px for each in images])
    known = sigma[np.isfinite(sigma)]
    error = f", with a predicted error of {np.median(known):.2g} px (median)" if known.size else ""
    searched = _either(each.along for each in images)
    of = f" of {lines} {searched}" if searched else ""
    if summary.settings.peaks > 1:
        of = f" of {lines} peaks at most"
    hard = [f"{totals[name]} {_words(name)}" for name in FOUND_NAMES[1:] if totals[name]]
    of_them = f" ({' and '.join(hard)})" if hard else ""
    missing = f" Without a centre: {why}." if why else ""
    return f"{counted(summary.centres, 'line centre')}{of_them}{of}{error}.{missing}{left}"


def draw(found: Detected, name: str, settings: Settings) -> Picture:
    """The picture of an image: its centres, close up too, their statuses and predicted errors."""
    line, summary, view = found.line, found.summary, _View(found)
    stretch, window = view.along()
    shape = "square pixels" if stretch == 1.0 else _stretched(stretch)
    name_of_each = "row" if view.upright else "column"
    if settings.detector == STEGER:
        name_of_each = "point"
    by_peak = ", peak by peak" if settings.peaks > 1 else ""
    counted_ok = counted(summary.centres, "centre")
    statuses = ", ".join(f"{n} {_words(s)}" for s, n in summary.statuses.items())
    whole = Panel(
        "Whole image (square pixels)",
        partial(view.draw, window=view.whole),
        f"The whole image with {counted_ok} on it.",
    )
    along = Panel(
        f"Along the line ({shape})",
        partial(view.draw, window=window, stretch=stretch),
        f"The part of the image that holds the line, with {counted_ok} on it.",
    )
    close = Panel(
        "Close-up of the line's middle (square pixels)",
        partial(view.draw, window=view.close_up(), close=True),
        "Pixels about the middle of the line, with the centres and their predicted errors.",
    )
    status = Panel(
        f"Status of each {name_of_each}{by_peak}",
        partial(_draw_statuses, view),
        f"Which have a centre, and why others have none: {statuses}.",
    )
    panels = [whole, along, close, status] if summary.centres else [whole, status]
    figures = (
        ("Predicted error of the centres", line.sigma, "sigma in px", summary.median_sigma_px),
        ("Width of the line", line.width, "width (sigma) in px", summary.median_width_px),
    )
    for title, values, label, median in figures if summary.centres else ():
        said = in_words(median, "{:.3g} px", "not known")
        alt = f"{title}, a standard deviation, over the place along it: median {said}."
        draw = partial(_draw_over, view, values, label)
        panels.append(Panel(title, draw, alt, layout=None))
    title = f"{drawable(name)}: {counted_ok}; {drawable(described(settings, [summary.along]))}"
    return draw_picture(title, panels, columns=2)


class _View:
    """An image with its centres, and the parts of it that are shown."""

    def __init__(self, found: Detected) -> None:
        line = found.line
        self.image = found.image
        from_u = np.abs((line.normal_deg + 90.0) % 180.0 - 90.0)
        self.upright = from_u.size > 0 and float(np.median(from_u)) < 45.0
        self.pixel = line.pixel if line.status.ndim > 1 else line.pixel[None]
        self.sigma = line.sigma.reshape(self.pixel.shape[:2])
        self.status = line.status.reshape(self.pixel.shape[:2])
        along = line.row if self.upright else line.column
        self.place = np.asarray(along, float).reshape(self.pixel.shape[:2])
        height, width = found.image.shape
        self.whole = (0, width, 0, height)
        self.limits = (-0.5, (height if self.upright else width) - 0.5)
        self.label = "v in px" if self.upright else "u in px"
        self.good = self.pixel[np.isfinite(self.pixel[..., 0])]
        ghost = line.status == Status.GHOST
        self.ghosts = np.stack([line.column[ghost], line.row[ghost]], axis=-1)

    def along(self) -> tuple[float, Window]:
        """By how much the image is stretched across the line to fill a panel, and which part."""
        if not self.good.size:
            return 1.0, self.whole
        size = self.image.shape[::-1]
        low = np.maximum(np.floor(self.good.min(axis=0)) - _MARGIN_PX, 0)
        high = np.minimum(np.ceil(self.good.max(axis=0)) + _MARGIN_PX + 1, size)
        (left, top), (right, bottom) = low.astype(int), high.astype(int)
        shape = (bottom - top) / (right - left)
        stretch = float(np.clip(_PANEL_SHAPE / shape, 1.0 / _MOST_STRETCH, _MOST_STRETCH))
        if 1.0 / _LEAST_STRETCH < stretch < _LEAST_STRETCH:
            stretch = 1.0
        return stretch, (left, right, top, bottom)

    def close_up(self) -> Window:
        """A few pixels about the centre that is in the middle of those along the line."""
        size, good = np.array(self.image.shape[::-1]), self.good
        middle = size / 2.0
        if good.size:
            middle = good[np.argsort(good[:, 1 if self.upright else 0])[len(good) // 2]]
        part = np.minimum(_CLOSE_UP_PX, size)
        (left, top) = first = np.clip(np.round(middle - part / 2), 0, size - part).astype(int)
        right, bottom = first + part
        return left, right, top, bottom

    def draw(
        self,
        axes: Axes,
        window: Window,
        stretch: float = 1.0,
        close: bool = False,
    ) -> None:
        """A part of the image with the centres; rows are drawn so many times as high as columns."""
        left, right, top, bottom = window
        shown, block = coarser(self.image[top:bottom, left:right])
        behind = (left + block[1] * shown.shape[1] - 0.5, top + block[0] * shown.shape[0] - 0.5)
        extent = (left - 0.5, behind[0], behind[1], top - 0.5)
        axes.imshow(shown, cmap="gray", extent=extent, interpolation="nearest", aspect=stretch)
        axes.set(xlabel="u in px", ylabel="v in px")
        axes.set(xlim=(left - 0.5, right - 0.5), ylim=(bottom - 0.5, top - 0.5))
        axes.grid(visible=False)
        for rank, (centres, sigma) in enumerate(zip(self.pixel, self.sigma, strict=True)):
            dots = {"color": _PEAKS[rank % len(_PEAKS)], "label": f"peak {rank + 1}"}
            if close:
                error = {"xerr" if self.upright else "yerr": np.nan_to_num(sigma)}
                axes.errorbar(
                    *centres.T, **error, fmt="o", ms=4, lw=1.2, mec=BLACK, mew=0.4, **dots
                )
            else:
                axes.plot(*centres.T, ".", ms=2.0, **dots)
        inside = ((self.ghosts > (left, top)) & (self.ghosts < (right, bottom))).all(axis=1)
        if inside.any():
            ghosts = {"color": colour("ghost"), "label": "ghosts"}
            axes.plot(*self.ghosts[inside].T, "x", ms=5.0 if close else 2.0, mew=0.6, **ghosts)
        if len(self.pixel) > 1 or inside.any():
            axes.figure.legend(loc="outside lower center", ncols=5, markerscale=1 if close else 5)


def _draw_statuses(view: _View, axes: Axes) -> None:
    """A row for each status that occurs, with a mark where a column, row or point has it."""
    present = [s for s in Status if np.any(view.status == s)]
    peaks = len(view.status)
    broad = max(_POINTS * axes.get_position().width * CELL_IN[0] / np.ptp(view.limits), 0.8)
    for number, status in enumerate(present):
        mark = {"color": colour(status.name.lower()), "lw": broad, "capstyle": "butt"}
        for rank, here in enumerate(view.status == status):
            middle = number + 0.8 * ((rank + 0.5) / peaks - 0.5)
            at, half = view.place[rank, here], 0.36 / peaks
            axes.vlines(at, middle - half, middle + half, **mark)
        if not np.isfinite(view.place[view.status == status]).any():
            axes.text(np.mean(view.limits), number, "place not known", ha="center", va="center")
    names = [f"{_words(s.name.lower())}: {int(np.sum(view.status == s))}" for s in present]
    axes.set_yticks(range(len(present)), names)
    axes.set(xlabel=view.label, xlim=view.limits, ylim=(max(len(present), 6) - 0.5, -0.5))
    axes.grid(visible=False)


def _draw_over(view: _View, values: NDArray[np.float64], label: str, axes: Axes) -> None:
    """A figure of each centre over its place along the line, but for the largest hundredth."""
    known = values[np.isfinite(values)]
    for rank, row in enumerate(values.reshape(view.status.shape)):
        axes.plot(view.place[rank], row, ".", ms=2.5, color=_PEAKS[rank % len(_PEAKS)])
    axes.set(xlabel=view.label, ylabel=label, xlim=view.limits)
    if not known.size:
        axes.set(ylim=(0.0, 1.0), yticks=[])
        axes.text(0.5, 0.5, "not known", ha="center", transform=axes.transAxes)
        return
    axes.set_ylim(0.0, 1.3 * max(float(np.percentile(known, 99.0)), 1e-12))
    median = float(np.median(known))
    axes.axhline(median, color=colour("truth"), lw=1.0, ls="--")
    behind = {"facecolor": "white", "edgecolor": "none", "alpha": 0.8, "pad": 1}
    write_on_line(axes, f"median {median:.3g} px", median, right=True, bbox=behind)


def _stretched(stretch: float) -> str:
    return f"v stretched {stretch:.2g} x" if stretch > 1.0 else f"u stretched {1 / stretch:.2g} x"


def _title(number: int, name: str) -> str:
    """Of an image's section: the number makes it another than all others."""
    return f"{number}: {printable(name)}"


def _most(statuses: dict[str, int], count: int) -> str:
    """The statuses that most columns have, so many of them, and how many have others."""
    ordered = sorted(statuses.items(), key=lambda item: -item[1])
    said = [f"{n} {_words(status)}" for status, n in ordered[:count]]
    rest = sum(n for _, n in ordered[count:])
    more = [f"{rest} more"] if rest else []
    return ", ".join(map(unbroken, [*said, *more]))


def _words(status: str) -> str:
    return status.replace("_", " ")
