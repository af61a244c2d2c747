"""The tables of a run, as CSV and as Markdown."""

from __future__ import annotations

import json
import math
from collections.abc import Sequence
from dataclasses import asdict
from pathlib import Path
from typing import Any

from frames import FrameRow
from problem import Row

from virtual_sensor.files import RESULTS_SIGN, folder_written_whole
from virtual_sensor.records import write_csv


def write(
    output: Path,
    rows: Sequence[Row],
    frames: Sequence[FrameRow],
    facts: dict[str, str],
    overwrite: bool,
) -> None:
    """Write peers.csv, frames.csv, peers.md and summary.json into a folder, or nothing."""
    with folder_written_whole(output, overwrite) as folder:
        for name, table in (("peers.csv", rows), ("frames.csv", frames)):
            if table:
                columns = [asdict(row) for row in table]
                write_csv(folder / name, {key: [c[key] for c in columns] for key in columns[0]})
        (folder / "peers.md").write_text("\n".join(lines(rows, frames, facts)) + "\n", "utf-8")
        (folder / RESULTS_SIGN).write_text(json.dumps(facts, indent=2) + "\n", "utf-8")


def lines(rows: Sequence[Row], frames: Sequence[FrameRow], facts: dict[str, str]) -> list[str]:
    """Everything in Markdown."""
    text = ["# Side by side with peers", ""]
    text += _rays_table([row for row in rows if row.chosen])
    text += _floors([row for row in rows if row.field == "linear gradients"])
    never = {row.peer for row in rows} - {row.peer for row in rows if row.chosen}
    never -= {row.peer for row in rows if row.field == "linear gradients"}
    text += [f"Never within the stated error: {', '.join(sorted(never))}.", ""] if never else []
    text += _frames_table(frames)
    return text + [f"- {name}: {fact}" for name, fact in facts.items()]


def _rays_table(chosen: Sequence[Row]) -> list[str]:
    """The loosest setting of each that keeps the error, and how many times as fast ours is."""
    if not chosen:
        return []
    ours = [row for row in chosen if row.peer.startswith("ours") and "tab" not in row.peer]
    best = max(ours, key=lambda row: row.rays_per_s) if ours else None
    thrifty = min(ours, key=lambda row: row.cpu_us) if ours else None
    text = [
        "Bent rays, each at the loosest setting that keeps the stated error. Ratios: how many times"
        " as many rays as this the fastest of our marches bends, by the clock and by CPU time.",
        "",
        "| | setting | rms px | largest px | rays/s | CPU us/ray | ratio | CPU ratio |",
        "|---|---|---|---|---|---|---|---|",
    ]
    for row in sorted(chosen, key=lambda row: -row.rays_per_s):
        ratio = _number(best.rays_per_s / row.rays_per_s) if best else ""
        spared = _number(row.cpu_us / thrifty.cpu_us) if thrifty else ""
        text.append(
            f"| {row.peer} | {row.setting:.3g} {row.unit} | {row.rms_px:.1e} | {row.largest_px:.1e}"
            f" | {row.rays_per_s:.3g} | {row.cpu_us:.3g} | {ratio} | {spared} |"
        )
    return [*text, ""]


def _floors(rows: Sequence[Row]) -> list[str]:
    """Linear gradients: the error against the setting, which stops falling."""
    if not rows:
        return []
    text = [
        "Gradients by differences at the nodes, interpolated linearly: the error in px rms"
        " (largest) stops falling, whatever the setting.",
        "",
    ]
    for peer in dict.fromkeys(row.peer for row in rows):
        each = (
            f"{row.setting:.3g} {row.unit}: {row.rms_px:.3g} ({row.largest_px:.3g})"
            for row in rows
            if row.peer == peer
        )
        text.append(f"- {peer}: {', '.join(each)}")
    return [*text, ""]


def _frames_table(frames: Sequence[FrameRow]) -> list[str]:
    if not frames:
        return []
    text = ["| light | renderer | s/frame | CPU s | times stock |", "|---|---|---|---|---|"]
    text += [
        f"| {f.light} | {f.renderer} | {f.seconds:.3f} | {f.cpu_s:.3f} | {f.times_stock:.2f} |"
        for f in frames
    ]
    return [*text, ""]


def _number(value: Any) -> str:
    return "" if math.isnan(value) else f"{value:.3g}"
