"""What the error of a recorded measurement is made of, as a table, a picture and in words."""

from collections.abc import Mapping
from typing import Any

import numpy as np
from matplotlib.axes import Axes

from virtual_sensor.reporting.pictures import Panel
from virtual_sensor.reporting.style import colour
from virtual_sensor.reporting.tables import Column, TextTable, pair_table, text_table
from virtual_sensor.reporting.words import NIL_UM, counted, listed
from virtual_sensor.studies.error_split import PartErrors, SplitSummary

Splits = Mapping[str, SplitSummary]
"""By "cold" and "hot"."""

PART_WORDS = {
    "refraction": "hot air bends the light: by the ray search, without an image",
    "lens": "the points of the lens's pupil see through other air: by the ray search",
    "detector": "the detector, in ideal frames, wherever the pixels lie: blur, slope, curvature",
    "pixels": "where the pixels happen to lie below the line: half a pixel lower it is the reverse",
    "speckle": "the laser's light is speckled",
    "noise": "shot noise, dark noise and current, fixed pattern, clipping",
    "rounding": "grey values of the sensor's bits, in place of 16",
}
_WHOLE = "whole error"
_LEAST_SHOWN = 1e-3  # of the largest part, on a logarithmic axis
_SMALL_UM = 1e-3
_HALF = 0.38  # of a bar's place


def known_splits(splits: Splits) -> dict[str, SplitSummary]:
    """Those of which there are figures to show."""
    return {state: split for state, split in splits.items() if split.largest}


def split_table(splits: Splits) -> TextTable:
    """Each part's rms and mean on the points and in the image, cold and hot."""
    columns = [Column("part", " ")]
    for state in splits:
        columns += [
            Column(f"{state}_rms_um", f"{state}: rms, µm", _short, "none"),
            Column(f"{state}_mean_um", "mean, µm", _signed, "none"),
            Column(f"{state}_rms_px", "rms, px", "{:.4f}", "none"),
        ]
    caption = "What the error of the measured section is made of"
    rows = _rows(splits)
    return text_table(rows, columns, caption, [*(False for _ in rows[1:]), True])


def part_table(splits: Splits) -> TextTable:
    """What each part is."""
    words = {name: PART_WORDS[name] for name in _parts(splits)}
    return pair_table(("part", "what makes it"), words)


def split_on_console(splits: Splits) -> TextTable:
    """Each part's rms, in a table that a console has room for."""
    columns = [Column("part", " ")]
    for state in splits:
        columns += [
            Column(f"{state}_rms_um", f"{state}: µm", _short, "none"),
            Column(f"{state}_rms_px", "px", "{:.4f}", "none"),
        ]
    return text_table(_rows(splits), columns, "What that error is made of, rms")


def _parts(splits: Splits) -> list[str]:
    """Names of the parts of any of them."""
    return list(dict.fromkeys(name for each in splits.values() for name in each.parts))


def _errors(split: SplitSummary) -> dict[str, PartErrors]:
    return {**split.parts, _WHOLE: split.whole}


def _rows(splits: Splits) -> list[dict[str, Any]]:
    """The figures of each part and of the whole error, by the state and their names."""
    rows = []
    for part in (*_parts(splits), _WHOLE):
        row: dict[str, Any] = {"part": part}
        for state, split in splits.items():
            if each := _errors(split).get(part):
                row |= {f"{state}_{name}": value + 0.0 for name, value in vars(each).items()}
        rows.append(row)
    return rows


def split_words(splits: Splits) -> list[str]:
    """Sentences on which part is the largest, cold and hot."""
    said = []
    for state, split in known_splits(splits).items():
        sizes = {name: part.rms_um for name, part in split.parts.items()}
        ordered = sorted(sizes, key=lambda name: -sizes[name])
        parts = listed([f"{name} {_short(sizes[name])}" for name in ordered])
        whole = _short(split.whole.rms_um)
        others = f" Of {counted(split.others, 'point')} more not all parts are known."
        said.append(
            f"In {state} air the error of {whole} µm rms is made of: {parts} µm."
            + others * bool(split.others)
        )
    return said


def _signed(mean_um: float) -> str:
    """A mean with its sign, which rounding to 0 takes away."""
    text = f"{mean_um:+.2f}"
    return text if float(text) else text[1:]


def _short(size_um: float) -> str:
    """A size with three digits; the smallest ones without."""
    if 0.0 < size_um < _SMALL_UM:
        return f"below {_SMALL_UM:g}" if size_um >= NIL_UM else "0"
    return f"{size_um:.3g}"


def split_panel(splits: Splits, width: int = 1) -> Panel:
    """Bars of the parts, cold and hot, on a logarithmic axis."""
    names = [*_parts(splits), _WHOLE]

    def draw(axes: Axes) -> None:
        rows = np.arange(len(names))[::-1]
        thick = 2.0 * _HALF / max(len(splits), 1)
        errors = {state: _errors(split) for state, split in splits.items()}
        largest = max((_rms(e) for each in errors.values() for e in each.values()), default=0.0)
        left = max(largest * _LEAST_SHOWN, NIL_UM)
        for number, (state, each) in enumerate(errors.items()):
            rms_um = np.array([_rms(each.get(name)) for name in names])
            at = rows + _HALF - thick * (number + 0.5)
            shown = np.maximum(rms_um, left)
            axes.barh(at, shown - left, left=left, height=thick, color=colour(state), label=state)
            for place, size, end in zip(at, rms_um, shown, strict=True):
                beside: dict[str, Any] = {"va": "center", "fontsize": 9}
                axes.annotate(
                    _short(size), (end, place), (3, 0), textcoords="offset points", **beside
                )
        axes.axhline(0.5, color="0.6", lw=0.8)
        axes.set_yticks(rows, names)
        axes.set(xscale="log", xlim=(left, 4.0 * max(largest, 2.0 * left)))
        axes.set_xlabel("error of the section, rms, µm")
        axes.grid(False, axis="y")
        axes.legend(loc="lower right", bbox_to_anchor=(1.0, 1.0), ncols=2, borderaxespad=0.2)

    said = listed([f"{name}: {split.largest or 'none'}" for name, split in splits.items()])
    return Panel(
        "What the error is made of",
        draw,
        f"The parts of the measured section's error, rms, as bars. The largest part: {said}.",
        width,
    )


def _rms(part: PartErrors | None) -> float:
    return 0.0 if part is None or np.isnan(part.rms_um) else part.rms_um
