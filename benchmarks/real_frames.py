"""Line centres in photographs of laser lines, against references that a person has drawn.

    python benchmarks/real_frames.py FOLDER [-o sheet.png] [--channel NAME] [--detector NAME]

FOLDER holds the frames of `FRAMES`, by the numbers that their names begin with; they are other
people's and no part of this project.  A polyline by hand says, to a few pixels, where each line is.
The reference is the half-height midpoint about it: of the mean of five profiles along the polyline,
the level beside the line and the largest one are taken, and between them the midpoint of the two
outermost places at half height.  It fits nothing and knows no line's shape; of a clipped symmetric
line it errs by less than 0.05 px.  The contact sheet shows polylines, references and centres.
"""

from __future__ import annotations

import argparse
import sys
from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path

import cv2
import numpy as np
from matplotlib.axes import Axes
from matplotlib.figure import Figure
from numpy.typing import NDArray

from virtual_sensor.imaging.image_files import read_image
from virtual_sensor.metrology.centres import Status
from virtual_sensor.studies.detect import Detected, Settings, detect

Array = NDArray[np.float64]

GROSS_PX, NEAR_PX = 3.0, 0.5
_ABOUT, _BESIDE = 8.0, 6.0  # px either side of the polyline; farther out is the level beside
_STEP = 0.25
_COLOURED = ("05", "08", "16")
_MEAN = 2  # profiles either side that are averaged


@dataclass(frozen=True)
class Frame:
    """What is known of a photograph: polylines of (place along, place across) px."""

    number: str
    what: str
    along: str
    lines: Sequence[Sequence[tuple[float, float]]]
    peaks: int = 1
    dark: str | None = None
    channel: str | None = None
    about_px: float = _ABOUT


FRAMES = (
    Frame(
        "02",
        "weld groove: plates",
        "columns",
        [[(4, 389), (514, 385)], [(1048, 394), (1276, 400)]],
    ),
    Frame(
        "02",
        "weld groove: flanks",
        "columns",
        [[(524, 391), (734, 582)], [(824, 582), (1038, 397)]],
    ),
    Frame(
        "05",
        "wall and cube",
        "rows",
        [[(4, 311), (140, 312)], [(176, 187), (296, 186)]],
        channel="green",
    ),
    Frame(
        "08",
        "wall and bear",
        "rows",
        [
            [(4, 550), (258, 550)],
            [
                *((268, 793), (275, 799), (300, 812), (314, 819), (325, 832), (350, 847)),
                *((375, 849), (400, 839), (425, 823), (440, 814), (450, 795), (475, 763)),
                *((486, 760), (500, 766), (525, 770), (550, 771), (600, 784), (675, 798)),
                *((700, 798), (725, 794), (750, 789), (775, 777), (800, 763), (822, 747)),
            ],
        ],
        dark="09",
        channel="green",
    ),
    Frame(
        "08",
        "floor",
        "rows",
        [[(836, 770), (850, 809), (1000, 1209), (1130, 1551)]],
        dark="09",
        channel="green",
        about_px=30.0,
    ),
    Frame(
        "16",
        "blocks on a carpet",
        "columns",
        [
            [(4, 252), (138, 263)],
            [(202, 249), (272, 250)],
            [(302, 264), (320, 259), (340, 253), (352, 251), (366, 252)],
            [(402, 274), (440, 275), (634, 279)],
        ],
    ),
    Frame(
        "21",
        "wall, bent plate, below",
        "rows",
        [
            [(122, 754), (476, 754)],
            [(548, 718), (690, 721)],
            [(702, 722), (840, 713)],
            [(852, 718), (930, 717)],
        ],
    ),
    Frame(
        "27",
        "two lines under a torch",
        "columns",
        [
            [(4, 253), (100, 282), (284, 338)],
            [(296, 336), (410, 302), (530, 269)],
            [(4, 210), (130, 291)],
            [(145, 300), (290, 390)],
            [(304, 386), (395, 308)],
            [(415, 292), (530, 192)],
        ],
        peaks=2,
        about_px=6.0,
    ),
)


def reference(
    image: Array, line: Sequence[tuple[float, float]], about: float
) -> tuple[Array, Array]:
    """Columns along a polyline, and the half-height midpoint in each; NaN where there is none."""
    places, across = np.array(line, float).T
    columns = np.arange(int(places[0]), int(places[-1]) + 1)
    middle = np.interp(columns, places, across)
    for reach in (about, about / 1.5):  # about the polyline, then about what was found
        offsets = np.arange(-2.0 * about, 2.0 * about + _STEP / 2, _STEP)
        rows = middle + offsets[:, None]
        profiles = cv2.remap(
            image.astype(np.float32),
            np.broadcast_to(columns, rows.shape).astype(np.float32),
            rows.astype(np.float32),
            cv2.INTER_LINEAR,
            borderMode=cv2.BORDER_REPLICATE,
        ).astype(float)
        mean = cv2.blur(profiles, (2 * _MEAN + 1, 1), borderType=cv2.BORDER_REPLICATE)
        level = np.median(mean[np.abs(offsets) > reach], axis=0)
        inside = np.where(np.abs(offsets)[:, None] <= reach, mean, -np.inf)
        half = 0.5 * (level + inside.max(axis=0))
        middle = middle + _midpoint(offsets, inside, half)
        known = np.isfinite(middle)
        middle = np.interp(columns, columns[known], middle[known]) if reach == about else middle
    return columns.astype(float), middle


def _midpoint(offsets: Array, profiles: Array, half: Array) -> Array:
    """Between the places either side of the highest one where the profile falls below half."""
    found = np.full(half.size, np.nan)
    for column, level in enumerate(half):
        profile = profiles[:, column]
        ends = []
        for step in (-1, 1):
            at = int(np.argmax(profile))
            if profile[at] <= level:
                break
            while 0 < at < profile.size - 1 and profile[at] >= level:
                at += step
            if not np.isfinite(profile[at]) or profile[at] >= level:
                break
            high = profile[at - step]
            ends.append(offsets[at] - step * _STEP * (level - profile[at]) / (high - profile[at]))
        if len(ends) == 2:
            found[column] = 0.5 * sum(ends)
    return found


@dataclass(frozen=True)
class Score:
    """Of the columns, or rows, that have a reference: shares, and the rms of those near it."""

    columns: int
    found: float
    near: float
    gross: float
    rms_px: float
    statuses: dict[str, int]


def score(found: Detected, frame: Frame, references: Sequence[tuple[Array, Array]]) -> Score:
    """Centres held against the references; of several peaks the nearest, be it called a ghost."""
    line = found.line if frame.along == "columns" else found.line.transposed
    counts = line.found if frame.peaks == 1 else np.isfinite(line.row)
    rows = np.atleast_2d(np.where(counts, line.row, np.nan))
    ranks = np.atleast_2d(found.line.status)
    errors, statuses = [], []
    for columns, places in references:
        known = np.isfinite(places)
        at = columns[known].astype(int)
        apart = rows[:, at] - places[known]
        nearest = np.nanargmin(np.where(np.isnan(apart), 1e9, np.abs(apart)), axis=0)
        errors.append(np.take_along_axis(apart, nearest[None], 0)[0])
        statuses.append(np.take_along_axis(ranks[:, at], nearest[None], 0)[0])
    error, there = np.concatenate(errors), np.isfinite(np.concatenate(errors))
    near = np.abs(error) <= NEAR_PX
    ends = {s.name.lower(): n for s, n in Status.counts(np.concatenate(statuses)).items()}
    return Score(
        error.size,
        float(there.mean()),
        float(near.mean()),
        float((np.abs(error[there]) > GROSS_PX).mean()) if there.any() else np.nan,
        float(np.sqrt(np.mean(error[near] ** 2))) if near.any() else np.nan,
        ends,
    )


def file_of(folder: Path, number: str) -> Path:
    """The frame whose name begins so."""
    found = sorted(folder.glob(f"{number}_*.*"))
    if not found:
        raise SystemExit(f"{folder}: has no frame {number}_*")
    return found[0]


def draw(
    axes: Axes, found: Detected, frame: Frame, references: Sequence[tuple[Array, Array]]
) -> None:
    """The image about the lines, turned so that they lie flat."""
    turned = frame.along == "rows"
    image, line = found.image, found.line
    if turned:
        image, line = image.T, line.transposed
    axes.imshow(image, cmap="gray", vmin=0, vmax=255, aspect="auto")
    each = (np.atleast_2d(values) for values in (line.column, line.row, line.found))
    for rank, (column, row, good) in enumerate(zip(*each, strict=True)):
        axes.plot(column[good], row[good], ".", ms=1.5, color=("tab:cyan", "tab:orange")[rank % 2])
    for columns, places in references:
        axes.plot(columns, places, "-", lw=0.5, color="tab:red")
    rows = np.concatenate([places for _, places in references])
    axes.set(ylim=(np.nanmax(rows) + 25, np.nanmin(rows) - 25))
    axes.set_title(f"{frame.number} {frame.what}, along {frame.along}")


def main() -> int:
    """Print the table, and draw the sheet."""
    parser = argparse.ArgumentParser(description="Line centres in photographs of laser lines.")
    parser.add_argument("folder", type=Path)
    parser.add_argument("-o", "--output", type=Path, help="contact sheet, PNG")
    parser.add_argument("--channel", help="of colour images; by default as `detect` chooses")
    parser.add_argument("--detector", default="gaussian")
    given = parser.parse_args()
    figure = Figure(figsize=(16, 5 * len(FRAMES)), layout="constrained")
    print("| frame | lines | found | within 0.5 px | gross, of the found | rms, px | statuses |")
    print("|---|---|---|---|---|---|---|")
    for number, frame in enumerate(FRAMES, 1):
        path = file_of(given.folder, frame.number)
        drawn = read_image(path, frame.channel).pixels.astype(float)
        dark = file_of(given.folder, frame.dark) if frame.dark else None
        if dark:
            drawn -= read_image(dark, frame.channel).pixels
        turned = drawn.T if frame.along == "rows" else drawn
        references = [reference(turned, line, frame.about_px) for line in frame.lines]
        channel = given.channel if frame.number in _COLOURED else None
        settings = Settings(given.detector, along=frame.along, peaks=frame.peaks, channel=channel)
        for off in (None, dark) if dark else (None,):
            (found,) = detect([path], settings, dark=off)
            got = score(found, frame, references)
            most = sorted(got.statuses.items(), key=lambda item: -item[1])[:4]
            print(
                f"| {frame.number} {frame.what}{' less dark' * bool(off)} | {got.columns}"
                f" | {got.found:.1%} | {got.near:.1%} | {got.gross:.1%} | {got.rms_px:.2f}"
                f" | {', '.join(f'{n} {status}' for status, n in most)} |",
                flush=True,
            )
        draw(figure.add_subplot(len(FRAMES), 1, number), found, frame, references)
    if given.output:
        figure.savefig(given.output, dpi=80)
    return 0


if __name__ == "__main__":
    sys.exit(main())
