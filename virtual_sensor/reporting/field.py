"""What a field file holds and does to light: console, picture and page."""

from __future__ import annotations

from dataclasses import dataclass, replace
from functools import partial
from pathlib import Path
from typing import Any

import numpy as np
from matplotlib.axes import Axes
from matplotlib.colors import PowerNorm
from matplotlib.patches import Patch, Rectangle
from numpy.typing import NDArray

from virtual_sensor.errors import printable
from virtual_sensor.files import written_whole
from virtual_sensor.metrology.truth import FINE_PX
from virtual_sensor.optics.field_border import JUMP_REFUSED_PX, JUMP_TOLD_PX
from virtual_sensor.records import write_json
from virtual_sensor.reporting.files import FileOf
from virtual_sensor.reporting.page import Content, Details, Page, Section, page_html
from virtual_sensor.reporting.pictures import Panel, Picture, draw_picture, write_vector
from virtual_sensor.reporting.style import ALONG, BLACK, colour, drawable, key
from virtual_sensor.reporting.tables import Column, TextTable, pair_table, text_table
from virtual_sensor.reporting.words import capital, counted, in_words, listed
from virtual_sensor.studies.field_grid import COARSE_PX
from virtual_sensor.studies.field_info import Border, FieldInfo, Grid, inside_part

Array = NDArray[np.float64]

COMMAND = "field info"
FILES = (
    FileOf("*.png", "Cuts through the field, and what it does to light (-o; also .svg, .pdf)."),
    FileOf("*.html", "Page with the same, the tables and the file's own texts (-o)."),
    FileOf("*.json", "Every figure (--json).", FieldInfo),
)

PICTURES = (".png", ".svg", ".pdf")
"""Formats of the picture."""

_FINE_ENOUGH = {
    Grid.FINE: f"fine enough for {FINE_PX:g} px",
    Grid.FAIR: f"fine enough for {COARSE_PX:g} px but not for {FINE_PX:g} px",
    Grid.TOO_COARSE: f"not fine enough for {COARSE_PX:g} px",
}
_UNJUDGED = {
    Grid.TOO_FEW_NODES: "the grid has too few nodes to be judged",
    Grid.UNKNOWN: "whether the grid is fine enough is unknown without a scene's light",
}
_COLUMNS = 3
_LEAST_PX = 1e-4  # as far as a march is good for
_LONG_TEXT = 300
_CUT_PX = 400  # along the longest side
_GAMMA = 0.5  # of the colours, so that a plume is seen beside a far hotter wall
_MARGIN = 0.06  # round the field, of its longest side
_LIGHT_RAYS = 5  # drawn of the laser and of the camera
_BORDER = "0.6"


def page_beside(picture: Path) -> Path:
    """The page that belongs to a picture's file."""
    return picture.with_suffix(".html")


def save(
    info: FieldInfo, command: str, picture: Path | None = None, figures: Path | None = None
) -> None:
    """Write the picture with its page beside it, and the figures as JSON; each whole or not at all.

    Raises
    ------
    InputError
        If a file can't be written.
    """
    if picture:
        panels = panels_of(info)
        drawn = draw_picture(title(info), panels, _COLUMNS)
        html = page_html(page(info, drawn, command))
        with written_whole(page_beside(picture)) as text:
            text.write_text(html, encoding="utf-8", errors="backslashreplace")
            if picture.suffix.lower() == ".png":
                drawn.write(picture)
            else:
                write_vector(picture, title(info), panels, _COLUMNS)
    if figures:
        write_json(figures, info)


# Words


def lead(info: FieldInfo) -> str:
    """What a reader wants to know first: what it does to light, and whether it can be trusted."""
    said = _air(info)
    if light := info.light:
        angle = max(light.laser_angle_mrad, light.camera_angle_mrad)
        said += (
            f" turns the light of {light.scene.stem} by up to {angle:.2g} mrad, which shifts what"
            f" the camera sees of a ray by up to {_pixels(light.largest_shift_px)} px, along the"
            " line and across it"
        )
    grid = _UNJUDGED.get(info.grid) or f"the grid is {_FINE_ENOUGH[info.grid]}"
    if info.border == Border.UNKNOWN:
        return f"{said}. {capital(grid)}."
    return f"{said}. The border is {info.border.name.lower().replace('_', ' ')}; {grid}."


def _air(info: FieldInfo) -> str:
    if np.isnan(info.lowest_temperature_c):
        return f"n - 1 of {info.lowest_refractivity:.3g} to {info.highest_refractivity:.3g}"
    low, high = (f"{t:.0f}" for t in (info.lowest_temperature_c, info.highest_temperature_c))
    return f"Air of {low} °C" if low == high else f"Air of {low} to {high} °C"


def border_words(info: FieldInfo) -> str:
    """Whether the field fades out early enough, in a sentence; "" if no light shows it."""
    if info.border == Border.UNKNOWN:
        return ""
    worst = max(info.faces, key=lambda face: face.shift_px)
    shift = f"The jump of n at {worst.name} moves the image by {_pixels(worst.shift_px)} px"
    if info.border == Border.SOUND:
        return (
            "Border: sound. The jump of n where light enters moves the image by"
            f" {_pixels(worst.shift_px)} px at most; from {JUMP_TOLD_PX:g} px on it would matter."
        )
    if info.border == Border.TOLERABLE:
        return f"Border: tolerable. {shift}; every measurement in this field has a note of it."
    return (
        f"Border: too close. {shift}; above {JUMP_REFUSED_PX:g} px no measurement is made. Give a"
        " field that reaches further out."
    )


def grid_words(info: FieldInfo) -> str:
    """Whether the grid is fine enough, in a sentence or two."""
    if info.grid == Grid.UNKNOWN:
        return "Grid: unknown in px, as no scene's light passes through the field."
    if info.grid == Grid.TOO_FEW_NODES:
        return "Grid: unknown, as there are too few nodes along each axis to compare with fewer."
    together = info.losses[-1].shift_px
    assert together  # of a grid that is judged
    error = f"interpolation between its nodes errs by {_pixels(together.present)} px"
    words = f"Grid: {_FINE_ENOUGH[info.grid]}; {error}."
    if info.rough_axes:
        words += (
            f" Along {listed(info.rough_axes)} the error does not fall as the grid gets finer: the"
            " field has structures as narrow as the grid, such as the kinks that linear"
            " interpolation from a coarser mesh leaves, so this is an order of magnitude only."
        )
    return words


def _pixels(shift: float) -> str:
    """Two digits of a shift in px, as far as a march is good for."""
    if np.isnan(shift):
        return ""
    return f"{shift:.2g}" if shift >= _LEAST_PX else f"< {_LEAST_PX:g}"


# Tables


def facts(info: FieldInfo) -> TextTable:
    """What the file holds, under a short name each."""
    planes = [
        f"{axis} = {start:g}"
        for axis, start, even in zip("xyz", info.field.origin, info.mirrored, strict=True)
        if even
    ]
    box = zip("xyz", *info.box_mm, strict=True)
    extent = ", ".join(f"{axis} {low:g} to {high:g}" for axis, low, high in box) + " mm"
    times = "one instant, no time axis"
    if info.times_s is not None:
        first, last = info.times_s[0], info.times_s[-1]
        times = f"{counted(len(info.times_s), 'instant')} from {first:g} to {last:g} s"
        times += f"; all figures are of {info.time_s:g} s"
    steps = " x ".join(f"{step:g}" for step in info.spacing_mm)
    found = {
        "file": f"{info.file}, {info.size_mb:.3g} MB, holds {info.quantity}",
        "times": times,
        "grid": f"{' x '.join(map(str, info.nodes))} nodes (x, y, z), {steps} mm apart",
        "extent": extent + (f", mirrored at {listed(planes)} mm" if planes else ""),
        "n - 1": f"{info.lowest_refractivity:.4g} to {info.highest_refractivity:.4g} in the air,"
        f" ambient {info.ambient_refractivity:.4g}, at {info.wavelength_nm:g} nm",
    }
    if not np.isnan(info.lowest_temperature_c):
        found["temperature"] = (
            f"{info.lowest_temperature_c:.0f} to {info.highest_temperature_c:.0f} °C (of an ideal"
            f" gas at ambient pressure), ambient {info.ambient_temperature_c:g} °C"
        )
    if light := info.light:
        found["shift"] = (
            f"up to {_pixels(light.largest_shift_px)} px, hot minus cold, of what the camera of"
            f" {light.scene.stem} sees of the probe rays; at y = {light.largest_shift_y_mm:g} mm"
        )
        found["angle"] = (
            f"the laser's light is turned by up to {light.laser_angle_mrad:.2g} mrad, the camera's"
            f" lines of sight by up to {light.camera_angle_mrad:.2g} mrad"
        )
    return pair_table(("field", ""), found)


def attributes(info: FieldInfo) -> TextTable:
    """The file's own texts; long ones are cut."""
    texts = {printable(name): _cut(words) for name, words in info.attributes.items()}
    return pair_table(("attribute", "text in the file"), texts)


def _cut(words: str) -> str:
    words = " ".join(words.split())
    return words if len(words) <= _LONG_TEXT else f"{words[:_LONG_TEXT]} ... ({len(words)} letters)"


def border_table(info: FieldInfo) -> TextTable:
    """Jump of n at each face of the border, and by how much light that crosses it moves."""
    rows = []
    for face in info.faces:
        crossing = (
            ("laser", face.laser_jump, face.laser_shift_px),
            ("camera", face.camera_jump, face.camera_shift_px),
        )
        met = [each for each in crossing if not np.isnan(each[1])]
        jumps = ", ".join(f"{jump:.1e}" for _, jump, _ in met)
        shifts = ", ".join(f"{of} {_pixels(shift)} px" for of, _, shift in met)
        rows.append((face.name, f"{face.largest_jump:.1e}", jumps, shifts))
    head = ("face", "largest jump of n", "where light enters", "moves the image by")
    return TextTable(head, tuple(rows), "Jump of n at the field's border")


def structure_table(info: FieldInfo) -> TextTable:
    """The narrowest structures, in mm and nodes."""
    rows = [
        structure.to_dict()
        | {
            "where": "at the wall" if structure.at_wall else "in free air",
            "peak": "({:g}, {:g}, {:g})".format(*structure.peak_mm),
        }
        for structure in info.structures
    ]
    columns = (
        Column("axis", "along"),
        Column("where"),
        Column("half_width_mm", "half width, mm", "{:.2f}"),
        Column("half_width_nodes", "in nodes", "{:.1f}"),
        Column("peak", "peak at, mm"),
    )
    return text_table(rows, columns, "Narrowest structures")


def grid_table(info: FieldInfo) -> TextTable:
    """What fewer nodes would change, and by how much the present grid errs."""
    in_px = info.light is not None
    rows = []
    for loss in info.losses:
        found = loss.shift_px if in_px else loss.rms_refractivity
        assert found  # with light, there is a shift
        shown = _pixels if in_px else lambda value: in_words(value, "{:.1e}", "")
        figures = {name: shown(value) for name, value in vars(found).items()}
        rows.append(figures | {"axes": loss.axes, "order": found.order})
    columns = (
        Column("axes", "nodes along"),
        Column("every_2nd", "every 2nd"),
        Column("every_4th", "every 4th"),
        Column("order", "order", "{:.1f}"),
        Column("present", "all (extrapolated)"),
    )
    of = "of the probe rays, px" if in_px else "of n - 1, rms in free air"
    return text_table(rows, columns, f"Error {of}, by the nodes that are used")


def tables(info: FieldInfo) -> list[TextTable]:
    """All of them, for the console; those that would be empty are left out."""
    found = (facts, attributes, border_table, structure_table, grid_table)
    return [table for table in (make(info) for make in found) if table.rows]


def verdicts(info: FieldInfo) -> list[str]:
    """Whether the border and the grid are sound, in a sentence or two each."""
    return [words for words in (border_words(info), grid_words(info)) if words]


# Page


def page(info: FieldInfo, picture: Picture, command: str) -> Page:
    """The page: what the field does to light, the cuts, the grid, and what the file says."""
    light: list[Content] = [border_words(info)] if info.line else []
    if info.light:
        given = info.light.parameters
        rays = text_table(
            [
                {"y_mm": y, "shift_u_px": u, "shift_v_px": v}
                for y, (u, v) in zip(info.light.probe_y_mm, info.light.shift_px, strict=True)
            ],
            (Column("y_mm"), Column("shift_u_px", "along u, px"), Column("shift_v_px", "v, px")),
            "Shift of the probe rays' pixels, hot minus cold",
        )
        settings = pair_table(("parameter", "value"), given)
        light = [
            replace(picture, panels=picture.panels[3:]),
            *light,
            Details("Probe rays", (rays,)),
            Details(f"Parameters of {info.light.scene}", (settings,)),
        ]
    long = [
        Details(name, (words,)) for name, words in info.attributes.items() if _cut(words) != words
    ]
    sections = [
        Section(
            "What it does to light" if info.light else "The border",
            *light,
            border_table(info),
        ),
        Section("The air", replace(picture, panels=picture.panels[:3])),
        Section(
            "Is the grid fine enough?",
            grid_words(info),
            grid_table(info),
            *([structure_table(info)] if info.structures else []),
            "The error of the simulation's own mesh is not among these figures: a finer simulation"
            " shows it (virtual-sensor field convergence).",
        ),
        Section("The file", facts(info), *([attributes(info)] if info.attributes else []), *long),
    ]
    return Page(
        title=f"Field {info.file.name}",
        lead=lead(info),
        sections=tuple(sections),
        command=command,
        made_with=info.made_with,
        notes=info.notes,
    )


# Picture


@dataclass(frozen=True)
class Cut:
    """A plane of the field.

    Attributes
    ----------
    normal : int
        The axis of the field that the plane is square to.
    place_mm : float
        Along the normal.
    side_mm, rise_mm : ndarray of shape (W,) and (H,)
    refractivity : ndarray of shape (H, W)
        n - 1.
    solid : ndarray of bool of shape (H, W)
    """

    normal: int
    place_mm: float
    side_mm: Array
    rise_mm: Array
    refractivity: Array
    solid: NDArray[np.bool_]

    @property
    def edges(self) -> list[int]:
        """Axes of the field that run along the picture's edges: across and up."""
        return [axis for axis in range(3) if axis != self.normal]


def panels_of(info: FieldInfo) -> list[Panel]:
    """Cuts through the line's or the solid's middle, and a level one; the shift of probe rays."""
    middle = _middle_mm(info)
    celsius = info.quantity != "refractivity" and not np.isnan(info.lowest_temperature_c)
    of = "temperature" if celsius else "n - 1"
    panels = []
    for normal, place_mm in enumerate((middle[0], middle[1], level_mm(info))):
        place = f"{'xyz'[normal]} = {place_mm:.4g} mm"
        cut = make_cut(info, normal, place_mm)
        panels.append(
            Panel(
                f"{capital(of) if celsius else of} at {place}",
                partial(_draw_cut, info=info, cut=cut, celsius=celsius),
                f"Cut through the field at {place}, coloured by {of}: {_air(info)}"
                + (", with the laser's light and the camera's lines of sight." * bool(info.line)),
                height=1 if normal == 2 else 2,
            )
        )
    if light := info.light:
        panels.append(
            Panel(
                "Shift of the image by the air",
                partial(_draw_shift, info=info),
                "Shift of the probe rays' pixels over their place along the line, up to"
                f" {_pixels(light.largest_shift_px)} px.",
            )
        )
    return panels


def _middle_mm(info: FieldInfo) -> Array:
    """Where the upright cuts meet, in the field's frame: the middle of the scene's line.

    Without one, the origin where the solid (or the field) is about it, else that one's middle.
    """
    box = low, high = info.box_mm
    if info.line and np.isfinite(world := info.line.middle_mm).all():
        line = info.field.to_local(world)
        return np.asarray(np.clip(np.round(line, 6) + 0.0, *box))
    if info.solid is not None and info.solid.any():
        nodes = np.argwhere(info.solid)
        start, spacing = info.field.origin, info.field.spacing
        low, high = start + nodes.min(axis=0) * spacing, start + nodes.max(axis=0) * spacing
        low = np.where(info.field.mirror, 2.0 * start - high, low)
    return np.where((low < 0.0) & (high > 0.0), 0.0, 0.5 * (low + high))


def title(info: FieldInfo) -> str:
    """Above all panels."""
    instant = "" if info.time_s is None else f", flow time {info.time_s:g} s"
    return f"{drawable(info.file.name)}{instant}: {lead(info)}"


def level_mm(info: FieldInfo) -> float:
    """Height of the level cut: a quarter of the height from the part's top to the field's."""
    floor, top = info.box_mm[:, 2]
    if info.solid is not None and info.solid.any():
        highest = np.flatnonzero(info.solid.any(axis=(0, 1)))[-1]
        floor = info.field.origin[2] + highest * info.field.spacing[2]
    return float(floor + 0.25 * (top - floor))


def make_cut(info: FieldInfo, normal: int, place_mm: float) -> Cut:
    """Evaluate a field in a plane across its whole box, mirror images included."""
    low, high = info.box_mm
    step = (high - low).max() / _CUT_PX
    axes = [np.linspace(a, b, int((b - a) / step) + 2) for a, b in zip(low, high, strict=True)]
    axes[normal] = np.array([place_mm])
    points = np.stack(np.meshgrid(*axes, indexing="ij"), axis=-1).reshape(-1, 3)
    across, up = (axis for i, axis in enumerate(axes) if i != normal)
    n, solid = info.field.refractivity(info.field.to_world(points)), _solid(info, points)
    shape = len(across), len(up)
    return Cut(normal, place_mm, across, up, n.reshape(shape).T, solid.reshape(shape).T)


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


def _draw_cut(axes: Axes, info: FieldInfo, cut: Cut, celsius: bool) -> None:
    """A cut in colours, with the solid, the field's border, and straight light."""

    def shown(refractivity: Array) -> Array:
        return info.temperature_c(refractivity) if celsius else 1e5 * refractivity

    ends = shown(np.array([info.lowest_refractivity, info.highest_refractivity]))
    norm = PowerNorm(_GAMMA if celsius else 1.0, *sorted(map(float, ends)))
    drawn = axes.pcolormesh(
        cut.side_mm,
        cut.rise_mm,
        shown(cut.refractivity),
        cmap="inferno" if celsius else "inferno_r",  # warm air is bright
        norm=norm,
        shading="nearest",
        rasterized=True,
    )
    ticks = norm.inverse(np.linspace(0.0, 1.0, 5))
    where = "bottom" if cut.normal == 2 else "right"
    bar = axes.figure.colorbar(drawn, ax=axes, ticks=ticks, location=where, shrink=0.8)
    bar.set_ticklabels([f"{tick:.0f}" if celsius else f"{tick:.4g}" for tick in ticks])
    bar.set_label("°C" if celsius else "$10^5\\,(n-1)$")
    keys: list[Any] = [key("border", color=_BORDER, ls="--", lw=1.5)]
    if cut.solid.any():
        plane = cut.side_mm, cut.rise_mm, cut.solid
        axes.contourf(*plane, levels=[0.5, 1.5], colors=["0.75"], hatches=["////"])
        axes.contour(*plane, levels=[0.5], colors="k", linewidths=1.0)
        keys.append(Patch(fc="0.75", ec="k", hatch="////", label="solid"))
    low, high = info.box_mm[:, cut.edges]
    axes.add_patch(Rectangle(low, *(high - low), fill=False, ls="--", ec=_BORDER, lw=1.5))
    keys += _draw_light(axes, info, cut)
    margin = _MARGIN * np.ptp(info.box_mm, axis=0).max()
    (left, floor), (right, top) = low - margin, high + margin
    axes.set(xlim=(left, right), ylim=(floor, top), aspect="equal")
    axes.grid(visible=False)
    across, up = (f"{'xyz'[axis]} in mm" for axis in cut.edges)
    axes.set(xlabel=across, ylabel=up)
    axes.figure.legend(handles=keys, loc="outside lower center", ncols=4)


def _draw_light(axes: Axes, info: FieldInfo, cut: Cut) -> list[Any]:
    """Straight light to the lit line, as seen along the cut's normal; gives its key."""
    if not (info.scene and info.line):
        return []
    sensor, line, level = info.scene.sensor, info.line, cut.normal == 2
    chosen = np.unique(np.linspace(0, len(line.y_mm) - 1, _LIGHT_RAYS).astype(int))
    ends = line.points_mm[chosen]
    keys = []
    for of, family in (("laser", sensor.laser.family), ("camera", sensor.camera)):
        start, end = (info.field.to_local(place) for place in (family.origins(ends), ends))
        paths = np.stack([start, end])[..., cut.edges]
        for shade, width in (("white", 2.4), (colour(of), 1.3)):  # seen on bright and dark
            axes.plot(paths[..., 0], paths[..., 1], color=shade, lw=width)
        if level:  # where it passes
            share = (cut.place_mm - start[:, 2]) / (end - start)[:, 2]
            through = start + share[:, None] * (end - start)
            axes.plot(through[:, 0], through[:, 1], "o", ms=5, mec="white", color=colour(of))
        keys.append(key(f"{of}, straight", color=colour(of), marker="o" if level else "", ms=5))
    return keys


def _draw_shift(axes: Axes, info: FieldInfo) -> None:
    """Shift of the probe rays' pixels over their place along the line."""
    assert info.light
    y, shift = info.light.probe_y_mm, info.light.shift_px
    axes.axhline(0.0, color="0.4", lw=0.8)
    for i, (name, shade, marker) in enumerate((("u", BLACK, "s"), ("v", colour("hot"), "o"))):
        axes.plot(y, shift[:, i], marker + "-", color=shade, label=f"along {name}")
    axes.set(xlabel=ALONG, ylabel="hot minus cold in px")
    axes.figure.legend(loc="outside lower center", ncols=2)
