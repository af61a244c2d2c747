"""A field in three cuts, with the light's ways drawn in."""

import textwrap
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np
from matplotlib.axes import Axes
from matplotlib.colors import PowerNorm
from matplotlib.figure import Figure
from matplotlib.layout_engine import ConstrainedLayoutEngine
from matplotlib.lines import Line2D
from matplotlib.patches import Patch, Rectangle
from numpy.typing import NDArray

from virtual_sensor.files import written_whole
from virtual_sensor.studies.field_info import FieldInfo, inside_part
from virtual_sensor.studies.field_words import facts, verdicts

Array = NDArray[np.float64]

_COLOURS = {"laser": "#35e06a", "camera": "#4fd2ff"}
_BORDER = "0.6"
_WAYS = 5  # drawn of each kind of light
_PIXELS = 400  # of the longest cut
_CUTS_IN = 8.5  # the larger of width and height of the three cuts together
_TEXT_IN = 3.6
_LEAST_IN = 1.8
_THROUGH = "where it passes the level cut"
_GAMMA = 0.5  # of the colours, so that a plume is seen beside a far hotter wall
_MARGIN = 0.06  # round the field, of its longest side


@dataclass(frozen=True)
class Cut:
    """A plane of the field.

    Attributes
    ----------
    across, up, normal : int
        Axes of the world that run along the picture's edges and out of it.
    place_mm : float
        Along the normal.
    side_mm, rise_mm : ndarray of shape (W,) and (H,)
    refractivity : ndarray of shape (H, W)
        n - 1.
    solid : ndarray of bool of shape (H, W)
    """

    across: int
    up: int
    place_mm: float
    side_mm: Array
    rise_mm: Array
    refractivity: Array
    solid: NDArray[np.bool_]

    @property
    def normal(self) -> int:
        """The axis that the plane is square to."""
        return 3 - self.across - self.up


def draw_field(info: FieldInfo, path: Path) -> None:
    """Draw the cuts x = 0, y = 0 (or through the middle) and a level one, as a PNG."""
    low, high = info.field.box
    middle = np.where((low < 0.0) & (high > 0.0), 0.0, 0.5 * (low + high))
    cuts = {
        "yz": make_cut(info, 1, 2, middle[0]),
        "xz": make_cut(info, 0, 2, middle[1]),
        "xy": make_cut(info, 0, 1, level_mm(info)),
    }
    x, y, z = high - low + 2.0 * _MARGIN * (high - low).max()
    inches = _CUTS_IN / max(x + y, y + z)
    widths, heights = (np.maximum(np.array(mm) * inches, _LEAST_IN) for mm in ((y, x), (z, y)))
    figure = Figure(
        figsize=(widths.sum() + _TEXT_IN + 1.6, heights.sum() + 2.2),
        dpi=110,
        layout=ConstrainedLayoutEngine(h_pad=0.12, w_pad=0.08),
    )
    axes = figure.subplot_mosaic(
        [["yz", "xz", "text"], ["key", "xy", "text"]],
        width_ratios=[*widths, _TEXT_IN],
        height_ratios=[*heights],
    )
    celsius = info.contents.kind != "refractivity" and info.temperature_range_c is not None
    shown = info.temperature_c if celsius else _times_1e5
    gamma = _GAMMA if celsius else 1.0
    norm = PowerNorm(gamma, *sorted(map(float, shown(np.array(info.refractivity_range)))))
    for name, cut in cuts.items():
        drawn = _draw_cut(axes[name], info, cut, shown(cut.refractivity), norm)
    scale = axes["key"].inset_axes((0.0, 0.72, 1.0, 0.12))
    ticks = norm.inverse(np.linspace(0.0, 1.0, 5))
    bar = figure.colorbar(drawn, cax=scale, orientation="horizontal", ticks=ticks)
    bar.set_ticklabels([f"{tick:.0f}" if celsius else f"{tick:.4g}" for tick in ticks])
    bar.set_label("temperature in °C" if celsius else "$10^5\\,(n-1)$")
    _draw_key(axes["key"], info)
    _write(axes["text"], info)
    instant = "" if info.time_s is None else f", flow time {info.time_s:g} s"
    figure.suptitle(f"{info.path.name}{instant}", fontsize=13)
    with written_whole(path) as temporary:
        figure.savefig(temporary, format="png")


def _times_1e5(refractivity: Array) -> Array:
    return 1e5 * refractivity


def level_mm(info: FieldInfo) -> float:
    """Height of the level cut: a quarter of the way from the part's top to the field's."""
    floor, top = info.field.box[:, 2]
    if info.solid is not None and info.solid.any():
        highest = np.flatnonzero(info.solid.any(axis=(0, 1)))[-1]
        floor = info.field.origin[2] + highest * info.field.spacing[2]
    return float(floor + 0.25 * (top - floor))


def make_cut(info: FieldInfo, across: int, up: int, place_mm: float) -> Cut:
    """Evaluate a field in a plane across its whole box, mirror images included."""
    low, high = info.field.box
    step = (high - low).max() / _PIXELS
    side, rise = (
        np.linspace(low[i], high[i], int((high[i] - low[i]) / step) + 2) for i in (across, up)
    )
    points = np.full((len(rise), len(side), 3), place_mm)
    points[..., across], points[..., up] = side, rise[:, None]
    flat = points.reshape(-1, 3)
    n, solid = info.field.refractivity(info.field.to_world(flat)), _solid(info, flat)
    shape = points.shape[:2]
    return Cut(across, up, place_mm, side, rise, n.reshape(shape), solid.reshape(shape))


def _solid(info: FieldInfo, points_mm: Array) -> NDArray[np.bool_]:
    """Which points of the field's frame are solid: by the scene's part, else the nearest node."""
    field = info.field
    if info.scene:
        return inside_part(info.scene, field.to_world(points_mm))
    if info.solid is None:
        return np.zeros(len(points_mm), bool)
    offset = points_mm - field.origin
    node = np.rint(np.where(field.mirror, np.abs(offset), offset) / field.spacing).astype(int)
    return np.asarray(info.solid[tuple(np.clip(node, 0, np.array(field.shape) - 1).T)])


def _draw_cut(axes: Axes, info: FieldInfo, cut: Cut, shown: Array, norm: PowerNorm) -> Any:
    """Draw a cut, coloured by what is to be shown of it; give what the colour bar needs."""
    low, high = info.field.box
    drawn = axes.pcolormesh(
        cut.side_mm,
        cut.rise_mm,
        shown,
        cmap="inferno" if norm.gamma < 1.0 else "inferno_r",  # warm air is bright
        norm=norm,
        shading="nearest",
        rasterized=True,
    )
    if cut.solid.any():
        where = cut.side_mm, cut.rise_mm, cut.solid
        axes.contourf(*where, levels=[0.5, 1.5], colors=["0.75"], hatches=["////"])
        axes.contour(*where, levels=[0.5], colors="k", linewidths=1.0)
    edges = [cut.across, cut.up]
    axes.add_patch(
        Rectangle(tuple(low[edges]), *(high - low)[edges], fill=False, ls="--", ec=_BORDER, lw=1.5)
    )
    _draw_ways(axes, info, cut)
    margin = _MARGIN * (high - low).max()
    axes.set_xlim(low[cut.across] - margin, high[cut.across] + margin)
    axes.set_ylim(low[cut.up] - margin, high[cut.up] + margin)
    axes.set_aspect("equal")
    across, up, normal = ("xyz"[i] for i in (cut.across, cut.up, cut.normal))
    axes.set(xlabel=f"{across} in mm", ylabel=f"{up} in mm")
    title = f"cut {normal} = {cut.place_mm:.3g} mm"
    axes.set_title(title + (", from above" if cut.normal == 2 else ""), fontsize=10)
    return drawn


def _draw_ways(axes: Axes, info: FieldInfo, cut: Cut) -> None:
    """Draw the straight ways of light to the lit line, as seen along the cut's normal."""
    if not (info.scene and info.line):
        return
    sensor, line = info.scene.sensor, info.line
    chosen = np.unique(np.linspace(0, len(line.y_mm) - 1, _WAYS).astype(int))
    ends = line.points_mm[chosen]
    for who, family in (("laser", sensor.laser.family), ("camera", sensor.camera)):
        ways = np.stack([info.field.to_local(place) for place in (family.origins(ends), ends)])
        axes.plot(ways[..., cut.across], ways[..., cut.up], color=_COLOURS[who], lw=0.9)
        if cut.normal == 2:
            along = ways[1] - ways[0]
            share = (cut.place_mm - ways[0, :, 2]) / along[:, 2]
            through = ways[0] + share[:, None] * along
            axes.plot(through[:, 0], through[:, 1], "o", ms=3, color=_COLOURS[who])


def _draw_key(axes: Axes, info: FieldInfo) -> None:
    handles: list[Any] = [
        Line2D([], [], color=_BORDER, ls="--", lw=1.5, label="the field's border")
    ]
    if info.line:
        handles += [
            Line2D([], [], color=colour, label=f"{who}'s light, unbent")
            for who, colour in _COLOURS.items()
        ]
        handles.append(Line2D([], [], color="k", ls="", marker="o", ms=3, label=_THROUGH))
    if info.solid is not None and info.solid.any():
        handles.append(Patch(fc="0.75", ec="k", hatch="////", label="solid"))
    axes.legend(handles=handles, loc="lower center", fontsize=8, frameon=False)
    axes.set_axis_off()


def _write(axes: Axes, info: FieldInfo) -> None:
    """Write the figures that a reader asks for first beside the cuts."""
    told = facts(info)
    names = ("source", "grid", "extent", "n - 1", "implied temperature", "effect")
    paragraphs = [f"{name}: {told[name]}" for name in names if name in told] + verdicts(info)
    paragraphs += [f"Note: {text}." for text in info.notes]
    lines = "\n\n".join(textwrap.fill(paragraph, 46) for paragraph in paragraphs)
    text = axes.text(0.0, 1.0, lines, va="top", fontsize=8.5, parse_math=False)
    text.set_in_layout(False)
    axes.set_axis_off()
