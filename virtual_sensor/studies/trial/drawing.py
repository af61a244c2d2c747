"""A trial's charts: error against signal, bias against phase, speed against accuracy."""

from __future__ import annotations

from collections.abc import Sequence
from pathlib import Path

import numpy as np
from matplotlib import colormaps
from matplotlib.axes import Axes
from matplotlib.figure import Figure
from matplotlib.ticker import LogFormatter

from virtual_sensor.files import written_whole
from virtual_sensor.studies.pareto import not_beaten
from virtual_sensor.studies.trial.scores import PHASES, Score
from virtual_sensor.studies.trial.trial import Trial

DPI = 100
_MARKERS = "osD^vP*X<>"
_FRONT_WIDTH_PX, _FRONT_ELECTRONS = 2.0, 2000.0


def draw_trial(trial: Trial, folder: Path) -> dict[str, str]:
    """Draw all charts into a folder; their files' names and what they show."""
    charts = {
        "signal.png": ("Error against signal", _signal),
        "phase.png": ("Bias against sub-pixel phase", _phase),
        "speed.png": ("Speed against accuracy", _speed),
        "troubles.png": ("Troubles, and rendered frames", _troubles),
    }
    written = {}
    for name, (title, draw) in charts.items():
        figure = draw(trial)
        if figure is None:
            continue
        with written_whole(folder / name) as temporary:
            figure.savefig(temporary, format="png", dpi=DPI)
        written[name] = title
    return written


def front(scores: Sequence[Score]) -> list[Score]:
    """Those that no other beats in both time and error, the fastest first."""
    known = [s for s in scores if np.isfinite(s.rms_px) and s.failures + s.outliers < 0.1]
    return not_beaten(known, lambda s: (s.seconds, s.rms_px))


def chosen_for_front(trial: Trial) -> list[Score]:
    """The scores that the chart of speed compares: one clean image that all detectors had."""
    clean = trial.of("clean")
    near = min(
        (each.condition for each in clean),
        key=lambda c: (
            abs(np.log(c.width_px / _FRONT_WIDTH_PX))
            + abs(np.log(c.column_electrons / _FRONT_ELECTRONS)),
            c.read_noise_electrons,
        ),
    )
    return [each for each in clean if each.condition == near]


def _look(trial: Trial, detector: str) -> dict[str, object]:
    number = trial.detectors.index(detector)
    colour = colormaps["tab10"](number % 10)
    return {"color": colour, "marker": _MARKERS[number % len(_MARKERS)], "ms": 5, "lw": 1.2}


def _signal(trial: Trial) -> Figure:
    """Rms error over the electrons of a column, a panel for each width; the bound in black."""
    clean = trial.of("clean")
    dark = min(each.condition.read_noise_electrons for each in clean)
    clean = [each for each in clean if each.condition.read_noise_electrons == dark]
    widths = sorted({each.condition.width_px for each in clean})
    columns = min(4, len(widths))
    rows = -(-len(widths) // columns)
    figure = Figure(figsize=(4.3 * columns, 0.9 + 3.6 * rows))
    panels = figure.subplots(rows, columns, squeeze=False, sharex=True)
    for axes, width in zip(panels.flat, widths, strict=False):
        here = [each for each in clean if each.condition.width_px == width]
        for name in trial.detectors:
            own = sorted(
                (each for each in here if each.detector == name),
                key=lambda s: s.condition.column_electrons,
            )
            signal = [each.condition.column_electrons for each in own]
            axes.loglog(signal, [e.rms_px for e in own], label=name, **_look(trial, name))
        bound = {each.condition.column_electrons: each.bound_px for each in here}
        axes.loglog(*zip(*sorted(bound.items()), strict=True), "k--", lw=2, label="bound")
        axes.set(title=f"line of {width:g} px", ylabel="rms error in px")
        axes.grid(alpha=0.3, which="both")
    for axes in panels.flat[len(widths) :]:
        axes.set_axis_off()
    for axes in panels[-1]:
        axes.set_xlabel("electrons of a column")
    _key(figure, panels.flat[0])
    figure.subplots_adjust(top=1.0 - 0.85 / figure.get_figheight())
    figure.suptitle(
        f"Error against signal, read noise {dark:g} e; dashed: the Cramer-Rao bound of one column"
        " (Steger's detector looks at several)"
    )
    return figure


def _phase(trial: Trial) -> Figure | None:
    """Bias of each detector over the sub-pixel phase, a panel for each width."""
    widths = sorted({width for _, width in trial.phases})
    if not widths:
        return None
    figure = Figure(figsize=(4.3 * len(widths), 4.9))
    panels = figure.subplots(1, len(widths), squeeze=False)
    for axes, width in zip(panels.flat, widths, strict=True):
        for name in trial.detectors:
            bias = trial.phases.get((name, width))
            if bias is not None:
                look = _look(trial, name) | {"ms": 2.5}
                axes.plot(PHASES, bias, label=name, **look)
        axes.set_yscale("symlog", linthresh=1e-4)
        axes.set(title=f"line of {width:g} px", xlabel="sub-pixel phase", ylabel="bias in px")
        axes.grid(alpha=0.3)
    _key(figure, panels.flat[0])
    figure.subplots_adjust(top=1.0 - 0.85 / figure.get_figheight())
    figure.suptitle("Bias against sub-pixel phase, without noise (linear within 1e-4 px)")
    return figure


def _speed(trial: Trial) -> Figure:
    """Error over the time of a column; the larger marks are the front."""
    scores = chosen_for_front(trial)
    condition = scores[0].condition
    figure = Figure(figsize=(10.0, 6.6))
    axes = figure.add_subplot()
    best = front(scores)
    for each in scores:
        look = _look(trial, each.detector) | {"ls": "none"}
        look["ms"] = 11 if each in best else 7
        axes.loglog(each.seconds * 1e6, each.rms_px, label=each.detector, **look)
    axes.loglog([e.seconds * 1e6 for e in best], [e.rms_px for e in best], color="0.4", lw=1.4)
    axes.axhline(scores[0].bound_px, color="k", ls="--", lw=1.5)
    axes.annotate(
        "Cramer-Rao bound of one column",
        (0.985, scores[0].bound_px),
        xycoords=("axes fraction", "data"),
        xytext=(0, 4),
        textcoords="offset points",
        ha="right",
        fontsize=9,
    )
    axes.xaxis.set_major_formatter(LogFormatter())  # 3, not 3 x 10^0
    axes.xaxis.set_minor_formatter(LogFormatter(minor_thresholds=(2.0, 0.5)))
    axes.margins(0.08)
    axes.set(
        xlabel="time of a column on one core, µs",
        ylabel="rms error, px",
        title=f"Speed against accuracy: line of {condition.width_px:g} px,"
        f" {condition.column_electrons:g} electrons a column,"
        f" read noise {condition.read_noise_electrons:g} e",
    )
    axes.grid(alpha=0.3, which="both")
    _key(figure, axes)
    return figure


def _troubles(trial: Trial) -> Figure | None:
    """What becomes of the columns: right, outliers, without a centre; and the error."""
    kinds = list(dict.fromkeys(e.condition for e in trial.scores if e.condition.kind != "clean"))
    if not kinds:
        return None
    columns = min(3, len(kinds))
    rows = -(-len(kinds) // columns)
    figure = Figure(figsize=(5.2 * columns, 0.6 + 3.1 * rows))
    panels = figure.subplots(rows, columns, squeeze=False, sharey=True)
    place = np.arange(len(trial.detectors))
    for axes, condition in zip(panels.flat, kinds, strict=False):
        own = {e.detector: e for e in trial.scores if e.condition == condition}
        shares = np.array(
            [(own[n].outliers, own[n].failures) for n in trial.detectors if n in own]
        ).T
        axes.barh(place, 1.0 - shares.sum(axis=0), color="#2e9e4f", label="right")
        axes.barh(place, shares[0], left=1.0 - shares.sum(axis=0), color="#c92a2a", label="outlier")
        axes.barh(place, shares[1], left=1.0 - shares[1], color="#dddddd", label="no centre")
        for number, name in enumerate(trial.detectors):
            error = own[name].rms_px
            words = f"{error:.3g} px" if np.isfinite(error) else "no centre"
            axes.text(0.02, number, words, va="center", fontsize=8, color="k")
        unit = "e at the brightest" if "frame" in condition.kind else "e a column"
        axes.set(yticks=place, yticklabels=trial.detectors, xlim=(0.0, 1.0))
        axes.set_title(
            f"{condition.kind}: {condition.width_px:g} px, {condition.column_electrons:g} {unit}",
            fontsize=10,
        )
        axes.invert_yaxis() if not axes.yaxis_inverted() else None
    for axes in panels.flat[len(kinds) :]:
        axes.set_axis_off()
    _key(figure, panels.flat[0], share=0.9)
    figure.subplots_adjust(top=1.0 - 0.85 / figure.get_figheight())
    figure.suptitle("What becomes of the columns, and the rms error of those that are right")
    return figure


def _key(figure: Figure, axes: Axes, share: float = 1.0) -> None:
    """One key below all panels, for which room is made."""
    height = figure.get_figheight()
    figure.legend(
        *axes.get_legend_handles_labels(), loc="lower center", ncols=6, fontsize=9, frameon=False
    )
    figure.tight_layout(pad=1.6, rect=(0.0, 0.62 / height * share, 1.0, 1.0 - 0.12 / height))
