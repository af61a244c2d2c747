"""A trial of line detectors as files: scores and biases as CSV, pictures, and a page."""

from __future__ import annotations

from collections import Counter
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from functools import partial
from pathlib import Path
from typing import Any

import numpy as np
from matplotlib.axes import Axes

from virtual_sensor.errors import printable
from virtual_sensor.files import RESULTS_SIGN, folder_written_whole
from virtual_sensor.metrology.detectors import NAMES, STEGER
from virtual_sensor.records import Record, record_columns
from virtual_sensor.reporting.files import FileOf, write_results
from virtual_sensor.reporting.page import PAGE, Content, Details, Page, Section
from virtual_sensor.reporting.pictures import Panel, Picture, draw_picture
from virtual_sensor.reporting.style import (
    LINES,
    MARKERS,
    colour,
    colours,
    decimal_ticks,
    drawable,
    write_beside,
)
from virtual_sensor.reporting.tables import Column, TextTable, text_table
from virtual_sensor.reporting.words import time_in_words, unbroken
from virtual_sensor.studies.machine import Machine
from virtual_sensor.studies.trial.hard import Sample
from virtual_sensor.studies.trial.images import AMOUNTS, Condition
from virtual_sensor.studies.trial.scores import (
    MOST_WRONG,
    OUTLIER_BOUNDS,
    OUTLIER_PX,
    WRONG_SIGMAS,
    Phases,
    Score,
)
from virtual_sensor.studies.trial.trial import Trial, front

TABLE = "table.md"
_SHOWN_APART = ("task", "clean", *AMOUNTS)  # have pictures of their own
_LONGEST_NAME = 22
_HOW = (
    "Every detector sees the same images, and knows the camera's noise and gain. Clean lines are"
    " Gaussian profiles, integrated over each pixel, that wander over all sub-pixel places, in shot"
    " noise and read noise, with one grey value an electron.",
    f"Outliers are off by more than {OUTLIER_PX:g} px and {OUTLIER_BOUNDS:g} bounds. They are"
    " counted, and are not in the errors.",
    "The Cramer-Rao bound is the smallest error that an unbiased estimate from one column can have:"
    " var >= 1/sum((d mu/d row)^2/(mu + sigma_d^2 + 1/12)). A detector that also uses neighbouring"
    " columns, as steger does, may go below it, and rounds off what is sharp.",
    "Times are the processor's for one column, the best of three runs or more, while all cores do"
    " the same.",
    "Saturated lines are clipped at half their height. Speckle is of an aperture of f/5.6 at"
    " 532 nm, pixels of 5.5 µm and light of both polarisations. Ambient light has 100 electrons a"
    " pixel."
    " Frames are of the hot cylinder, rendered; their truth is where the laser's axis meets the"
    " surface.",
    "Hard frames are rendered too: of a flat plate, with the line's peak at 80 % of a full well of"
    " 10,000 e and read noise of 3 e. The clipped ones are so many times over-exposed. Edges of the"
    " reflectance run through the line slowly, each from four of its standard deviations below it"
    " to as many above, bright above or below. Speckle is of the f-number given. Ambient light is"
    " uneven, on a plate in patches. Ghosts are of a V-groove of ground steel, whose walls reflect"
    " the line once; its median column's peak lies at a quarter of the full well. Sparks of spatter"
    " are up to three times the line's height.",
    f"A detector breaks the rule where more than {MOST_WRONG:.0%} of a line's columns have a centre"
    f" that counts as found and is off by more than {WRONG_SIGMAS:g} of the sigmas that it predicts"
    " (and 0.02 px), or that is of no line. Where it predicts no error it promises none.",
)
_SECTIONS = {
    "speed": (
        "Which detector to take",
        "Rms error, the same over the Cramér-Rao bound, the error that the detector predicts, and"
        " the time of a column. Emphasised: no other detector is both faster and more accurate. A"
        " clean line is not all: the harder images below show what each makes of speckle and"
        " ambient light.",
    ),
    "signal": (
        "Error against signal",
        "1 is the Cramér-Rao bound of one column: nothing unbiased that uses one column errs less."
        " Where a curve ends, the detector finds no centre.",
    ),
    "phase": (
        "Bias against sub-pixel phase",
        "Without noise. Linear between -0.0001 and 0.0001 px, logarithmic beyond.",
    ),
    "troubles": (
        "Harder images",
        "Shares of the columns with a line; in words, the rms error of those that are right.",
    ),
    "hard": (
        "Hard frames",
        "Share of the columns with a line whose centre is right, over what makes the frame hard.",
    ),
    "frames": (
        "What hard frames look like",
        "A part of the hardest of each kind: the line's true row, and the centres that a detector"
        " counts as found.",
    ),
}
"""Titles and words of the pictures on the page."""


@dataclass(frozen=True)
class Summary(Record):
    """A trial in figures.

    Attributes
    ----------
    command : str
        The exact command that was given.
    machine : Machine
        What the times were measured on.
    task : Condition
        The line and camera that a detector is to be chosen for.
    recommended : Score or None
        The fastest within a tenth of the task's bound, or else the most accurate.
    front : list of str
        Detectors that no other beats in both time and error in the task, the fastest first.
    breaches : int
        Scores of detectors that promise more than they keep: `wrong_share` is above 1 %.
    seed, columns : int
        Of the images.
    time_s : float
        Of the trial.
    """

    command: str
    machine: Machine
    task: Condition
    recommended: Score | None
    front: list[str]
    breaches: int
    seed: int
    columns: int
    time_s: float


FILES = (
    FileOf("scores.csv", "Each detector on each image.", Score),
    FileOf("phases.csv", "Bias against sub-pixel phase.", Phases),
    FileOf(RESULTS_SIGN, "The recommended detector, and how to repeat the trial.", Summary),
    FileOf(TABLE, "The detectors in the task, as Markdown."),
    FileOf("speed.png", "Error and time of the detectors in the task."),
    FileOf("signal.png", "Error over its bound against the signal, for each width of the line."),
    FileOf("phase.png", "Bias against sub-pixel phase, for each width of the line."),
    FileOf("troubles.png", "Columns that are right, wrong and lost in harder images."),
    FileOf("hard.png", "Columns that are right in hard frames, over what makes them hard."),
    FileOf("frames.png", "Parts of hard frames, the line's truth and what was found."),
    FileOf(PAGE, "Page with all of it."),
)


def save(trial: Trial, folder: Path, command: str, overwrite: bool = False) -> None:
    """Write tables, pictures and page; all of them or none.

    Raises
    ------
    InputError
        If the folder exists (and `overwrite` is not set) or can't be written.
    """
    pictures = draw(trial)
    summary = Summary(
        command=command,
        machine=trial.machine,
        task=trial.task,
        recommended=trial.recommended,
        front=[each.detector for each in front(trial.of("task"))],
        breaches=len(trial.breaches),
        seed=trial.seed,
        columns=trial.columns,
        time_s=trial.time_s,
    )
    contents = {
        "scores.csv": record_columns(Score, trial.scores),
        "phases.csv": trial.phases,
        **{f"{name}.png": picture for name, picture in pictures.items()},
        TABLE: markdown(trial),
        PAGE: page(trial, pictures, command),
        RESULTS_SIGN: summary,
    }
    with folder_written_whole(folder, overwrite) as place:
        write_results(place, FILES, contents)


def table(scores: Sequence[Score], caption: str = "", narrow: bool = False) -> TextTable:
    """Scores on one image, the most accurate first; the front is emphasised.

    A narrow one, for the console, is without the predicted errors and what they miss.
    """
    columns = (
        Column("detector"),
        Column("rms_px", shape="{:.4f}"),
        Column("ratio", "/ bound", "{:.2f}"),
        Column("predicted_px", "predicted", "{:.4f}"),
        Column("outlier_share", "outliers", "{:.1%}"),
        Column("lost_share", "no centre", "{:.1%}"),
        Column("wrong_share", "ok, over 6 sigma", "{:.1%}"),
        Column("marked_wrong_share", "clipped or corrected, over 6 sigma", "{:.1%}"),
        Column("time_us", "time", _time),
    )
    left_out = ("predicted_px", "wrong_share", "marked_wrong_share") if narrow else ()
    shown = [each for each in columns if each.name not in left_out]
    ordered = sorted(scores, key=lambda s: (not np.isfinite(s.rms_px), s.rms_px))
    best = {each.detector for each in front(scores)}
    return text_table(ordered, shown, caption, [each.detector in best for each in ordered])


def hard_table(trial: Trial) -> TextTable:
    """The best detector on each hard frame: it keeps the rule, and is right in most columns."""
    conditions = dict.fromkeys(each.condition for each in trial.of(*AMOUNTS))
    rows = []
    for condition in conditions:
        own = [each for each in trial.scores if each.condition == condition]
        best = max(own, key=lambda e: (not e.breaks_the_rule, round(e.right_share, 2), -e.rms_px))
        broken = sum(each.breaks_the_rule for each in own)
        rows.append(
            {
                "image": _of_amount(condition),
                "best": best.detector,
                "rms_px": best.rms_px,
                "sigma_ratio": best.sigma_ratio,
                "right": best.right_share,
                "broken": f"{broken} of {len(own)}" if broken else "none",
            }
        )
    columns = (
        Column("image"),
        Column("best", "best detector"),
        Column("rms_px", shape="{:.3f}"),
        Column("sigma_ratio", "predicted / rms", "{:.2f}"),
        Column("right", shape="{:.1%}"),
        Column("broken", "promise too much"),
    )
    return text_table(rows, columns, "Hard frames")


def honesty(trial: Trial) -> str:
    """Whether centres are within six of the sigmas that their detectors predict."""
    rule = f"off by more than {WRONG_SIGMAS:g} of the sigmas that it predicts"
    if not trial.breaches:
        return f"In no image are more than {MOST_WRONG:.0%} of a detector's centres OK and {rule}."
    worst = trial.breaches[0]
    found = {name: sum(e.detector == name for e in trial.breaches) for name in trial.detectors}
    counts = ", ".join(f"{name} in {n}" for name, n in found.items() if n)
    images = len({each.condition for each in trial.scores})
    return (
        f"Of {images} images, more than {MOST_WRONG:.0%} of a detector's centres are OK and {rule}:"
        f" {counts}; most, {worst.wrong_share:.1%}, of {worst.detector} in the"
        f" {described(worst.condition)}."
    )


def _of_amount(condition: Condition) -> str:
    """What a hard frame is of: its kind, and how hard it is."""
    return f"{condition.kind}, {AMOUNTS[condition.kind][0].format(condition.amount)}"


def _time(us: float) -> str:
    return unbroken(time_in_words(1e-6 * us))


def markdown(trial: Trial) -> str:
    """The scores in the task, as the documentation shows them."""
    shown = table(trial.of("task")).markdown()
    return f"{shown}\nThe task: {described(trial.task)}. Made by `virtual-sensor trial`.\n"


def described(condition: Condition) -> str:
    """What an image is like, in words."""
    kind = "line" if condition.kind in ("task", "clean") else condition.kind
    if kind in AMOUNTS:
        kind = f"{_of_amount(condition)}: a line"
    sensor = f", recorded by {Path(condition.sensor).stem}" if condition.sensor else ""
    return (
        f"{kind} of sigma {condition.width_px:.3g} px with {condition.peak_electrons:,.0f} e at its"
        f" peak and {condition.read_noise_electrons:g} e of read noise{sensor}"
    )


def lead(trial: Trial) -> str:
    """Which detector to take for the task, and how far it is from the bound."""
    best = trial.recommended
    if best is None:
        return f"No detector finds a {described(trial.task)}."

    def about(score: Score) -> str:
        time = time_in_words(1e-6 * score.time_us)
        # Of an rms by chance, where columns err by themselves: others' errors are correlated.
        chance = score.ratio / np.sqrt(2.0 * max(score.right_share * score.columns, 1.0))
        alone = score.detector in NAMES and score.detector != STEGER
        ratio = f"{score.ratio:.2f}" + f" ± {chance:.2f}" * alone
        return f"{ratio} times the Cramér-Rao bound of one column, {time} a column"

    task = trial.of("task")
    words = [
        f"For a {described(trial.task)}, take {best.detector}: {best.rms_px:.2g} px rms,"
        f" {about(best)}."
    ]
    least = min(front(task), key=lambda each: each.rms_px)
    others = [each for each in task if each.detector not in NAMES or each is least]
    for other in others:
        along = "; it also uses neighbouring columns" if other.detector == STEGER else ""
        if not np.isfinite(other.rms_px):
            words.append(f"{other.detector} finds no centre.")
        elif other is not best:
            words.append(f"{other.detector}: {about(other)}{along}.")
    return " ".join(words)


def page(trial: Trial, pictures: Mapping[str, Picture], command: str) -> Page:
    """The page: the task first, then each quantity, then all tables."""
    sections = []
    for name, picture in pictures.items():
        title, words = _SECTIONS[name]
        own: tuple[Content, ...] = ()
        if name == "speed":
            own = (table(trial.of("task"), described(trial.task)),)
        elif name == "hard":
            own = (hard_table(trial), honesty(trial))
        sections.append(Section(title, words, *own, picture))
    conditions = dict.fromkeys(each.condition for each in trial.scores)
    all_tables = tuple(
        table([each for each in trial.scores if each.condition == condition], described(condition))
        for condition in conditions
    )
    sections.append(
        Section("All scores", Details(f"Tables of {len(all_tables)} images", all_tables))
    )
    sections.append(Section("How it was done", *_HOW))
    return Page(
        title="A trial of line detectors",
        lead=lead(trial),
        sections=tuple(sections),
        command=command,
        made_with={"seed": trial.seed, "columns": trial.columns, "machine": trial.machine},
    )


def draw(trial: Trial) -> dict[str, Picture]:
    """The pictures by the names of their files."""
    key = _Key(trial.detectors)
    drawn = {"speed": _speed(trial, key)}
    if trial.of("clean"):
        drawn["signal"] = _signal(trial, key)
    if len(trial.phases):
        drawn["phase"] = _phase(trial, key)
    if any(each.kind not in _SHOWN_APART for each in trial.scores):
        drawn["troubles"] = _troubles(trial, key)
    if trial.of(*AMOUNTS):
        drawn["hard"] = _hard(trial, key)
    if trial.samples:
        drawn["frames"] = _frames(trial, key)
    return drawn


class _Key:
    """How each detector is drawn and called, in all panels alike."""

    def __init__(self, detectors: Sequence[str]) -> None:
        self.detectors = detectors
        self.all = (*NAMES, *(name for name in detectors if name not in NAMES))
        self.colours = colours(self.all)
        short = {name: _shortened(name.rpartition(":")[2] or name) for name in detectors}
        count = Counter(short.values())
        self.names = {n: short[n] if count[short[n]] == 1 else _shortened(n) for n in detectors}

    def line(self, detector: str) -> dict[str, Any]:
        """Colour, marker, line style and label; a user's own detector is drawn bolder."""
        number = self.all.index(detector)
        own = detector not in NAMES
        return {
            "color": self.colours[detector],
            "marker": MARKERS[number % len(MARKERS)],
            "ls": LINES[number // len(MARKERS) % len(LINES)],
            "lw": 2.4 if own else 1.3,
            "zorder": 4 if own else 3,
            "label": self.names[detector],
        }

    def name_rows(self, axes: Axes, scores: Sequence[Score]) -> None:
        """Have rows of bars from above say which detectors they are of."""
        axes.set_yticks(range(len(scores)), [self.names[each.detector] for each in scores])
        axes.invert_yaxis()
        axes.grid(visible=False)


def _shortened(name: str) -> str:
    name = printable(name).replace("\n", " ")
    if len(name) > _LONGEST_NAME:
        name = f"{name[: _LONGEST_NAME - 11]}...{name[-8:]}"
    return drawable(name)


def _speed(trial: Trial, key: _Key) -> Picture:
    """Error over the bound against time, and the same as bars."""
    task = [each for each in trial.of("task") if np.isfinite(each.rms_px)]
    ordered = sorted(task, key=lambda each: each.ratio)

    def scatter(axes: Axes) -> None:
        for each in ordered:
            mark = key.line(each.detector) | {"ls": "none"}
            axes.loglog(each.time_us, each.ratio, **mark, ms=12 if each is trial.recommended else 7)
        axes.axhline(1.0, color=colour("bound"), ls="--", label="bound of one column")
        axes.margins(0.1)
        decimal_ticks(axes.xaxis, fine=True)
        decimal_ticks(axes.yaxis, fine=True)
        axes.set(xlabel="processor time of a column in µs", ylabel="error over the bound")
        _key_beside(axes)

    def bars(axes: Axes) -> None:
        for row, each in enumerate(ordered):
            axes.barh(row, each.ratio, color=key.colours[each.detector])
            words = f"{each.ratio:.2f}  ({each.rms_px:.3g} px)"
            behind = {"facecolor": "white", "edgecolor": "none", "pad": 0.5}
            write_beside(axes, words, (each.ratio, row), (4, 0), bbox=behind)
        axes.axvline(1.0, color=colour("bound"), ls="--")
        most = max((each.ratio for each in ordered), default=1.0)
        axes.set(xlabel="error over the bound of one column", xlim=(0.0, 1.45 * most))
        key.name_rows(axes, ordered)

    listed = "; ".join(f"{e.detector} {e.ratio:.2f}" for e in ordered)
    panels = [
        Panel("Speed against accuracy (best: below left)", scatter, f"Over the bound: {listed}."),
        Panel("How near to the bound", bars, f"Error over the bound: {listed}."),
    ]
    return draw_picture(f"The task: {described(trial.task)}", panels)


def _signal(trial: Trial, key: _Key) -> Picture:
    """The bound against the signal, then the detectors' error over it for each width."""
    noise = min(each.read_noise_electrons for each in trial.of("clean"))
    clean = [each for each in trial.of("clean") if each.read_noise_electrons == noise]
    by_width = {
        w: [e for e in clean if e.width_px == w] for w in sorted({e.width_px for e in clean})
    }
    known = np.array([each.ratio for each in clean if np.isfinite(each.ratio)])
    limits = (0.8 * min(known.min(initial=0.9), 0.9), 1.25 * max(known.max(initial=2.0), 2.0))

    def bounds(axes: Axes) -> None:
        for number, (width, own) in enumerate(by_width.items()):
            bound = sorted({(each.column_electrons, each.bound_px) for each in own})
            shade = 0.75 * (1.0 - number / max(len(by_width) - 1, 1))
            axes.loglog(*np.transpose(bound), "o-", color=str(shade))
            write_beside(axes, f"{width:g} px", bound[-1], (6, 0))
        axes.margins(x=0.12)
        decimal_ticks(axes.xaxis)
        decimal_ticks(axes.yaxis)
        axes.set(xlabel="electrons of a column", ylabel="bound in px")

    def ratios(own: Sequence[Score], axes: Axes) -> None:
        for name in key.detectors:
            points = sorted((e.column_electrons, e.ratio) for e in own if e.detector == name)
            axes.loglog(*np.transpose(points), **key.line(name))
        axes.axhline(1.0, color=colour("bound"), ls="--", lw=1.6, label="bound")
        axes.set(xlabel="electrons of a column", ylabel="error over the bound", ylim=limits)
        decimal_ticks(axes.xaxis)
        decimal_ticks(axes.yaxis, fine=True)
        _key_beside(axes)

    panels = [Panel("The bound, for lines of each width", bounds, "Falls as the signal grows.")]
    for width, own in by_width.items():
        most = max(each.column_electrons for each in own)
        said = [f"{e.detector} {e.ratio:.2g}" for e in own if e.column_electrons == most]
        alt = f"Error over the bound with {most:g} electrons a column: {', '.join(said)}."
        panels.append(Panel(f"Line of sigma {width:g} px", partial(ratios, own), alt))
    title = f"Error over the Cramér-Rao bound of one column, read noise {noise:g} e"
    return draw_picture(title, panels, 3)


def _phase(trial: Trial, key: _Key) -> Picture:
    """Bias of each detector over the sub-pixel phase, a panel for each width."""

    def biases(curves: Mapping[str, Any], axes: Axes) -> None:
        for name, (phase, bias) in curves.items():
            axes.plot(phase, bias, **key.line(name), ms=3, markevery=4)
        axes.set_yscale("symlog", linthresh=1e-4)
        axes.set(xlabel="middle of the line from that of a pixel, px", ylabel="bias in px")
        _key_beside(axes)

    panels = []
    for width in sorted(set(trial.phases.width_px)):
        curves = {name: trial.phases.at(name, width) for name in key.detectors}
        said = [f"{name} {np.abs(bias).max():.2g} px" for name, (_, bias) in curves.items()]
        alt = f"Largest bias: {', '.join(said)}."
        panels.append(Panel(f"Line of sigma {width:g} px", partial(biases, curves), alt))
    return draw_picture("Bias against sub-pixel phase, without noise", panels, 3)


def _troubles(trial: Trial, key: _Key) -> Picture:
    """What becomes of the columns: right, outliers, without a centre; and the error."""

    def shares(own: Sequence[Score], axes: Axes) -> None:
        rows = np.arange(len(own))
        share = np.array([[e.right_share, e.outlier_share, e.lost_share] for e in own])
        start = np.cumsum(share, axis=1) - share
        parts = (("right", "ok", 0.55), ("outlier", "failed", 1.0), ("no centre", "no_peak", 1.0))
        for part, (label, name, alpha) in enumerate(parts):
            style = {"color": colour(name), "alpha": alpha, "label": label}
            axes.barh(rows, share[:, part], left=start[:, part], **style)
        for row, each in enumerate(own):
            words = f"{each.rms_px:.3g} px" if np.isfinite(each.rms_px) else "no centre"
            axes.text(0.02, row, words, va="center", fontsize=9.5)
        axes.set(xlim=(0.0, 1.0), xlabel="share of the columns")
        key.name_rows(axes, own)
        axes.figure.legend(loc="outside lower center", ncols=3)

    panels = []
    harder = [each for each in trial.scores if each.kind not in _SHOWN_APART]
    for at in dict.fromkeys(each.condition for each in harder):
        own = [each for each in harder if each.condition == at]
        said = ", ".join(f"{each.detector} {each.right_share:.0%}" for each in own)
        title = f"{at.kind}, {at.width_px:g} px, {at.peak_electrons:,.0f} e"
        panels.append(Panel(title, partial(shares, own), f"Right: {said}."))
    title = "Columns right, wrong and lost, and the rms error of those that are right"
    return draw_picture(title, panels, 3)


def _hard(trial: Trial, key: _Key) -> Picture:
    """Columns that are right against how hard the frame is, a panel for each kind."""

    def curves(own: Sequence[Score], axes: Axes) -> None:
        for name in key.detectors:
            points = sorted((e.amount, e.right_share) for e in own if e.detector == name)
            axes.plot(*np.transpose(points), **key.line(name), ms=5)
        axes.set(xscale="log", xlabel=AMOUNTS[own[0].kind][1])
        axes.set(ylim=(-0.03, 1.03), ylabel="share of the columns that is right")
        tried = sorted({e.amount for e in own})
        axes.set_xticks(tried, [f"{amount:g}" for amount in tried], minor=False)
        axes.set_xticks([], minor=True)
        _key_beside(axes)

    panels = []
    for kind in dict.fromkeys(each.kind for each in trial.of(*AMOUNTS)):
        own = trial.of(kind)
        most = max(each.amount for each in own)
        said = [f"{e.detector} {e.right_share:.0%}" for e in own if e.amount == most]
        alt = f"Right in the {_of_amount(own[-1])}: {', '.join(said)}."
        panels.append(Panel(kind[0].upper() + kind[1:], partial(curves, own), alt))
    return draw_picture("Columns that are right in hard frames", panels, 3)


def _frames(trial: Trial, key: _Key) -> Picture:
    """A part of each kind's hardest frame, with the truth and what was found."""

    def shown(sample: Sample, axes: Axes) -> None:
        top = float(np.percentile(sample.grey, 99.8))
        axes.imshow(sample.grey, cmap="gray", vmax=max(top, 1.0), aspect="auto")
        axes.plot(sample.true_row, color=colour("line"), lw=0.8, label="truth")
        mark = {"ls": "none", "marker": ".", "ms": 3, "color": colour("hot")}
        axes.plot(sample.column, sample.row, **mark, label=f"found by {key.names[sample.detector]}")
        axes.set(xlabel="u in px", ylabel="v in px")
        axes.grid(visible=False)
        axes.figure.legend(loc="outside lower center", ncols=2)

    panels = [
        Panel(
            _of_amount(sample.condition),
            partial(shown, sample),
            f"{sample.column.size} centres found in {sample.grey.shape[1]} columns.",
        )
        for sample in trial.samples
    ]
    return draw_picture("Parts of hard frames", panels)


def _key_beside(axes: Axes) -> None:
    axes.figure.legend(loc="outside right center", fontsize=9.0)
