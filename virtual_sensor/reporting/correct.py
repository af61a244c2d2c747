"""A correction's results: points, what was removed, the error budget, the air found, and a page."""

from __future__ import annotations

from collections.abc import Iterator, Mapping, Sequence
from itertools import cycle
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np
from matplotlib.axes import Axes
from matplotlib.colors import to_hex
from numpy.typing import NDArray

from virtual_sensor.files import RESULTS_SIGN, folder_written_whole
from virtual_sensor.metrology.centres import FOUND_NAMES, Status
from virtual_sensor.metrology.covariance import WITHIN_95
from virtual_sensor.metrology.deviation import euclidean
from virtual_sensor.metrology.truth import rms
from virtual_sensor.optics.crossing_status import CrossingStatus
from virtual_sensor.records import unit_of, write_ply
from virtual_sensor.reporting.corrected_surfaces import (
    LAYERS,
    surface_panels,
    surface_table,
    write_surface,
)
from virtual_sensor.reporting.files import FileOf, write_results
from virtual_sensor.reporting.page import PAGE, Content, Details, Page, Section
from virtual_sensor.reporting.pictures import (
    Panel,
    PanelPicture,
    Picture,
    beside,
    draw_picture,
    from_side,
    key_above,
    side_of,
)
from virtual_sensor.reporting.style import ALONG, CYCLE, GREY, LINES, colour, drawable, letters_on
from virtual_sensor.reporting.tables import Column, TextTable, pair_table, text_table
from virtual_sensor.reporting.words import counted, listed, micrometres
from virtual_sensor.studies.correct.correction import (
    Corrected,
    CorrectedTable,
    Correction,
    CorrectionSummary,
    EstimateTable,
    FrameSway,
)
from virtual_sensor.studies.section import SectionErrors

if TYPE_CHECKING:  # measurements through known air need no estimate
    from virtual_sensor.metrology.air_estimate import AirEstimate
    from virtual_sensor.metrology.error_budget import ErrorBudget, PointBudget
    from virtual_sensor.metrology.identifiability import Identifiability

Array = NDArray[np.float64]

AIR = "air.nc"
"""The estimated air, as `--medium` and a scene's parameter `field` read it."""

_NAMED = 6  # measurements that a key names
_MOST_BARS = 12  # measurements whose error budgets are drawn
_FEW = 60  # points that are marked one by one
_SPOKES = 24  # from uncorrected to corrected points, of a measurement
_LONGEST = 0.15  # enlarged error, of the points' extent
_WRITTEN = 8  # parameters whose correlations are written
_STEPS = (1.0, 2.0, 5.0)

FILES = (
    FileOf(PAGE, "The page to open first."),
    FileOf("report.png", "The correction at a glance."),
    FileOf(RESULTS_SIGN, "The figures of the correction.", CorrectionSummary),
    FileOf("points.csv", "All points with their covariance.", CorrectedTable),
    FileOf("estimates.csv", "What was estimated, and how well.", EstimateTable),
    FileOf(
        "corrected.ply",
        "The corrected points, mm, world; their intensity is how far they were moved, in µm, and"
        " their property measurement counts the measurements from 1.",
    ),
    FileOf("uncorrected.ply", "The same points as if light ran straight."),
    FileOf(
        "surface_*.exr",
        "Of fringes, all pixels of a surface before and after, by the measurement's name.",
        LAYERS,
    ),
    FileOf(AIR, "The air that was estimated: correct --medium and measure -D field= read it."),
)


# The files.


def save(
    result: Correction, folder: Path, command: str, overwrite: bool = False
) -> CorrectionSummary:
    """Write a correction's files (`FILES`), all of them or none, and give its summary.

    `command` is the exact one that the results come from.

    Raises
    ------
    InputError
        If the folder exists (and `overwrite` is not set) or can't be written.
    """
    with folder_written_whole(folder, overwrite) as place:
        moved = np.concatenate([euclidean(each.moved_um) for each in result.measurements])
        lengths = [len(each.pixel) for each in result.measurements]
        number = np.repeat(np.arange(1, len(lengths) + 1), lengths)
        for name, points in (("corrected", "point_mm"), ("uncorrected", "point_uncorrected_mm")):
            joined = np.concatenate([getattr(each, points) for each in result.measurements])
            write_ply(place / f"{name}.ply", joined, moved, measurement=number)
        for each in result.measurements:
            if each.surface is not None:
                write_surface(place / f"surface_{each.name}.exr", each.surface)
        if result.estimate is not None and result.medium is not None:
            result.medium.write(place / AIR)
        contents: dict[str, Any] = {"points.csv": result.table}
        if result.estimates:
            contents["estimates.csv"] = result.estimate_table
        panels: Mapping[str, PanelPicture] = {}
        if result.points:
            contents["report.png"], panels = picture(result)
        contents[PAGE] = page(result, panels, command)
        contents[RESULTS_SIGN] = result.summary
        write_results(place, FILES, contents)
    return result.summary


# The console.


def on_console(result: Correction) -> list[TextTable | str]:
    """What the command prints: how far points were off the part before and after, and the air."""
    shown: list[TextTable | str] = [measurement_table(result.summary)]
    if surface := surface_table(result.summary.measurements):
        shown.append(surface)
    if result.circle:
        shown.append(radius_table(result.summary))
    if result.estimate is not None:
        shown.append(estimate_table(result.estimate, result.budget))
    elif result.estimates:
        shown.append(estimates_table(result.estimate_table))
    if result.sway is not None:
        shown.append(sway_words(result.sway))
    return shown


def sway_words(sway: FrameSway) -> str:
    """How much a burst's frames sway, before and after."""
    return (
        f"Over {sway.frames} frames the distance from the part sways by"
        f" {micrometres(sway.before_um)} before and {micrometres(sway.after_um)} after the"
        " correction (standard deviation at equal columns, rms along the line)."
    )


def measurement_table(figures: CorrectionSummary) -> TextTable:
    """Each measurement before and after."""
    rows = [{"name": name, **vars(each)} for name, each in figures.measurements.items()]
    return text_table(
        rows,
        (
            Column("name", "measurement"),
            Column("points", "points", "{}"),
            Column("distance_uncorrected.rms_um", "before", nothing="none"),
            Column("distance.rms_um", "after", nothing="none"),
            Column("median_sigma_um", "sigma"),
            Column("moved_rms_um", "moved"),
        ),
        "Distance from the scene's part, rms, in µm",
    )


def missing(figures: CorrectionSummary) -> list[Details]:
    """Why centres or points are missing, where some are."""
    found: list[tuple[str, str, str]] = []
    total = lost = 0
    for name, each in figures.measurements.items():
        total += sum(each.centre_status.values())
        centres = {s: n for s, n in each.centre_status.items() if s not in FOUND_NAMES}
        points = dict(each.status)
        points["no_pixel"] -= sum(centres.values())  # said of the centre already
        for kind, counts in ((Status, centres), (CrossingStatus, points)):
            for status, count in counts.items():
                if status != "ok" and count > 0:
                    found.append((name, f"{count}", kind[status.upper()].message))
                    lost += count
    table = TextTable(("measurement", "missing", "why"), tuple(found))
    why = f"Why {lost} of {total} rows of points.csv have no point"
    return [Details(why, (table,))] if found else []


def radius_table(figures: CorrectionSummary) -> TextTable:
    """The fitted radius before and after."""
    circles = {"before": figures.circle_uncorrected, "after": figures.circle}
    rows = [{"points": name, "fit": fit} for name, fit in circles.items() if fit]
    return text_table(
        rows,
        (
            Column("points", " "),
            Column("fit.radius_mm", "radius, mm", "{:.4f}"),
            Column("fit.radius_error_um", "off the part, µm", "{:+.3g}"),
            Column("fit.interval_95_um", "95 %, ± µm", "{:.2g}"),
            Column("fit.rms_um", "residuals, µm"),
        ),
        "A circle through all points",
    )


def estimate_table(estimate: AirEstimate, budget: ErrorBudget | None = None) -> TextTable:
    """What was estimated, and how well: by noise and priors, and by all sources of error."""
    from virtual_sensor.metrology.identifiability import EstimateStatus

    rows = []
    for i, name in enumerate(estimate.names):
        prior, unit = estimate.priors.get(name), estimate.units[i]
        whole = float(budget.total[i] if budget else estimate.sigma[i])
        rows.append(
            {
                "name": _with_unit(name, unit),
                "value": f"{estimate.values[i]:.{_digits(whole)}f}",
                "whole": whole,
                "noise": float(estimate.sigma[i]),
                "bound": float(estimate.bound[i]),
                "prior": f"{prior.value:g} ± {prior.sigma:.2g}" if prior else "none",
                "status": EstimateStatus(estimate.status[i]).name.lower(),
            }
        )
    return text_table(
        rows,
        (
            Column("name", "parameter"),
            "value",
            Column("whole", "sigma", "{:.2g}"),
            *([Column("noise", "by noise", "{:.2g}")] if budget else []),
            Column("bound", "images alone", lambda v: f"{v:.2g}" if v < np.inf else "nothing"),
            "prior",
            "status",
        ),
        f"Estimated; what is left in the images: {estimate.rms_px:.2g} px rms",
    )


def estimates_table(table: EstimateTable) -> TextTable:
    """How several estimates of a parameter spread, such as of the frames of a burst."""
    rows = []
    for name in dict.fromkeys(table.parameter.tolist()):
        mine = table.parameter == name
        values, sigma = table.value[mine], float(np.median(table.sigma[mine]))
        spread = float(values.std(ddof=1)) if len(values) > 1 else np.nan
        unit, digits = table.unit[mine][0], _digits(sigma)
        rows.append(
            {
                "name": _with_unit(name, unit),
                "count": len(values),
                "mean": f"{values.mean():.{digits}f}",
                "least": f"{values.min():.{digits}f}",
                "largest": f"{values.max():.{digits}f}",
                "spread": spread,
                "sigma": sigma,
            }
        )
    return text_table(
        rows,
        (
            Column("name", "parameter"),
            Column("count", "estimates", "{}"),
            *("mean", "least", "largest"),
            Column("spread", "spread", "{:.2g}"),
            Column("sigma", "sigma of one", "{:.2g}"),
        ),
        "Estimated, measurement by measurement",
    )


def _with_unit(name: str, unit: str) -> str:
    """A parameter's name without its unit at the end, and the unit."""
    stem = name.rpartition("_")[0] if unit_of(name) else name
    return f"{stem}, {unit}" if unit else stem


def _digits(sigma: float) -> int:
    """Decimals down to the second digit of a standard deviation."""
    return int(np.clip(1 - np.floor(np.log10(sigma)), 0, 9)) if 0.0 < sigma < np.inf else 4


# The page.


def lead(figures: CorrectionSummary) -> str:
    """How far the points are off the part, before and after; or that there are none."""
    measured = list(figures.measurements.values())
    if not any(each.points for each in measured):
        return "No point could be corrected."
    sentences = []
    before, after = (
        _joined([getattr(each, name) for each in measured])
        for name in ("distance_uncorrected", "distance")
    )
    if np.isfinite(after):
        sentences.append(
            f"Corrected, the points lie {micrometres(after)} rms off the scene's part; uncorrected,"
            f" {micrometres(before)}."
        )
    else:
        moved = max(each.moved_rms_um for each in measured if each.points)
        sentences.append(f"The correction moves points by up to {micrometres(moved)} rms.")
    if figures.circle and figures.circle_uncorrected:
        errors = figures.circle.radius_error_um, figures.circle_uncorrected.radius_error_um
        sentences.append(
            f"The fitted radius is {_over(errors[0])} the part's; uncorrected, {_over(errors[1])}."
        )
    return " ".join(sentences)


def _over(error_um: float) -> str:
    return f"{micrometres(abs(error_um))} {'above' if error_um >= 0.0 else 'below'}"


def _joined(errors: Sequence[SectionErrors]) -> float:
    """The rms of all points of several measurements."""
    known = [each for each in errors if each.points]
    count = sum(each.points for each in known)
    return float(np.sqrt(sum(e.points * e.rms_um**2 for e in known) / count)) if count else np.nan


def page(result: Correction, panels: Mapping[str, PanelPicture], command: str) -> Page:
    """The page of a correction."""
    figures = result.summary
    names = {Path(each.scene).stem for each in figures.measurements.values()}
    sections = [
        Section(
            "What was removed",
            *([beside(panels, "distance", "removed", "part")] if panels else []),
            measurement_table(figures),
            *_of_surfaces(figures, panels),
            *([sway_words(result.sway)] if result.sway else []),
            *missing(figures),
            "The scene's part is as its file has it. Where a part of your own differs from it, so"
            " do the corrected points.",
        ),
    ]
    if result.circle:
        sections.append(Section("The radius", radius_table(figures)))
    if panels:
        sections.append(Section("How far to trust it", *_trust(result, panels)))
    sections.append(Section("The air", *_air(result, panels)))
    return Page(
        f"{', '.join(sorted(names))}: {counted(len(result.measurements), 'measurement')} corrected",
        lead(figures),
        tuple(sections),
        command,
        figures.made_with,
        tuple(note for note in figures.notes if note not in figures.caveats),
        figures.caveats,
    )


def _of_surfaces(
    figures: CorrectionSummary, panels: Mapping[str, PanelPicture]
) -> Iterator[Content]:
    """Maps and figures of whole surfaces, where fringes were measured."""
    table = surface_table(figures.measurements)
    if table is None:
        return
    yield table
    names = [name for name in panels if name.startswith(("before_", "after_", "epipolar_"))]
    if names:
        yield beside(panels, *names)
    yield (
        "The points of the other tables and pictures are the middles of blocks of these pixels."
        " The epipolar residual is what no shape can cause."
    )


def _air(result: Correction, panels: Mapping[str, PanelPicture]) -> Iterator[Content]:
    facts = {"where it is from": result.air.origin, "field": Path(result.air.source).name or "none"}
    yield pair_table(("the air", ""), facts)
    if result.estimate is not None:
        yield estimate_table(result.estimate, result.budget)
        yield beside(panels, "correlation", "residual")
        yield _condition(result.estimate)
    elif result.estimates:
        yield estimates_table(result.estimate_table)
        yield beside(panels, "estimates", "residual")
    if result.estimates:
        yield (
            "A small residual does not show that the air is right: air of another kind can leave as"
            " little. Two poses of the sensor tell most of it apart."
        )


def _condition(estimate: AirEstimate) -> str:
    """What the problem's numbers say, in words."""
    values = ", ".join(f"{value:.2g}" for value in estimate.singular_values)
    return (
        f"Singular values of the images' derivatives, columns of unit length: {values}; condition"
        f" with priors {estimate.condition:.3g}. Chi² of what is left in the images:"
        f" {estimate.chi2:.3g} for each degree of freedom, 1 where nothing but noise is left."
    )


def _trust(result: Correction, panels: Mapping[str, PanelPicture]) -> Iterator[Content]:
    yield beside(panels, "left", "budget")
    if "budget" in panels:
        yield (
            "The interval of 95 % holds what all sources of error make together. What a source adds"
            " is its share in the variance; an estimate follows the noise, which may take some of"
            " it off again (correlation)."
        )
    else:
        yield (
            "The interval of 95 % is that of the centres' noise. It knows nothing of how well air"
            " and pose are known: say so by --prior, such as scale=1:0.02 or camera_x=0:0.01."
        )


# The picture.


def picture(result: Correction) -> tuple[Picture, dict[str, PanelPicture]]:
    """Draw a correction: the whole picture, and its panels by name."""
    shown = result.measurements
    panels = {"removed": removed_panel(shown), "part": part_panel(shown)}
    if any(each.summary.distance.points for each in shown):
        panels = {"distance": distance_panel(shown)} | panels | {"left": left_panel(shown)}
    panels = surface_panels(shown) | panels
    if any(each.budget is not None and len(shares(each.budget)) > 1 for each in shown):
        panels |= {"budget": budget_panel(shown)}
    if result.estimates:
        panels |= {"residual": residual_panel(shown)}
    if result.estimate is None and result.estimates:
        panels |= {"estimates": estimates_panel(result.estimate_table)}
    elif result.estimate is not None and len(result.estimate.names) > 1:
        panels |= {"correlation": correlation_panel(result.estimate)}
    names = ", ".join(dict.fromkeys(drawable(each.scene.path.stem) for each in shown))
    drawn = draw_picture(f"{names}: {lead(result.summary)}", list(panels.values()), columns=3)
    return drawn, dict(zip(panels, drawn.panels, strict=True))


def distance_panel(measurements: Sequence[Corrected]) -> Panel:
    """Distances from the part, before and after."""

    def draw(axes: Axes) -> None:
        draw_distances(axes, measurements)
        key_above(axes)

    dashed = "" if len(measurements) == 1 else " (dashed: uncorrected)"
    alt = "Distance of the uncorrected and of the corrected points from the part, along the line."
    return Panel(f"Distance from the part{dashed}", draw, alt, width=2, layout=None)


def draw_distances(axes: Axes, measurements: Sequence[Corrected]) -> None:
    """Distances from the part over y along the line, before (dashed) and after."""
    for each, paint, label in _marked(measurements):
        before, after, *labels = paint, paint, None, label
        if len(measurements) == 1:
            errors = each.distance_uncorrected_um, each.distance_um
            words = zip(("uncorrected", "corrected"), errors, strict=True)
            labels = [f"{word}: {micrometres(rms(error))} rms" for word, error in words]
            before, after = colour("hot"), colour("cold")
        # Each where it lies: an uncorrected point is aside of its corrected one.
        y = each.part.along_mm(each.point_uncorrected_mm)
        style = {"color": before, "label": labels[0], "lw": 1.1} | _style(each, 1)
        axes.plot(y, each.distance_uncorrected_um, **style)
        axes.plot(each.along_mm, each.distance_um, color=after, label=labels[1], **_style(each))
    axes.axhline(0.0, color="0.5", lw=0.8)
    axes.set(xlabel=_along(measurements), ylabel="outside (+) or inside the part (−), µm")


def removed_panel(measurements: Sequence[Corrected]) -> Panel:
    """How far uncorrected points are from the corrected ones: along the line, and in height."""

    def draw(axes: Axes) -> None:
        for each, paint, label in _marked(measurements):
            _, along, away = each.part.source.pose.rotation.T
            error = -each.moved_um
            alone = len(measurements) == 1
            paints = (colour("y"), colour("z")) if alone else (paint, paint)
            labels = ("along the line", "towards the light") if alone else (None, label)
            for number, moved in ((1, error @ along), (0, -error @ away)):
                style = {"color": paints[1 - number], "label": labels[1 - number]}
                axes.plot(each.along_mm, moved, **style | _style(each, number))
        axes.axhline(0.0, color="0.5", lw=0.8)
        axes.set(xlabel=_along(measurements), ylabel="uncorrected minus corrected, µm")
        key_above(axes)

    dashed = "" if len(measurements) == 1 else " (dashed: along the line)"
    alt = "Uncorrected minus corrected points, along the line and towards the light."
    return Panel(f"What was removed{dashed}", draw, alt, layout=None)


def left_panel(measurements: Sequence[Corrected]) -> Panel:
    """What is left, with the interval in which 95 % of it is expected."""

    def draw(axes: Axes) -> None:
        for each, paint, label in _marked(measurements):
            band = WITHIN_95 * each.budget.total_um
            dots = {"ms": 2.0 if each.points > _FEW else 5.0, "color": paint, "label": label}
            axes.plot(each.along_mm, each.distance_um, ".", **dots)
            if label and not each.part.areal:
                axes.fill_between(each.along_mm, -band, band, color=paint, alpha=0.15, lw=0)
            _draw_band(axes, each, band, paint)
        axes.axhline(0.0, color="0.5", lw=0.8)
        axes.set(xlabel=_along(measurements), ylabel="corrected minus part, µm")
        if len(measurements) > 1:
            key_above(axes)

    alt = "Distance of the corrected points from the part, with their interval of 95 %."
    return Panel("What is left, and its 95 % interval", draw, alt, layout=None)


def budget_panel(measurements: Sequence[Corrected]) -> Panel:
    """What makes the points uncertain: along the line, or of several measurements their medians."""

    def draw(axes: Axes) -> None:
        if len(measurements) == 1 and not measurements[0].part.areal:
            draw_budget(axes, measurements[0].budget, measurements[0].along_mm)
            axes.set_xlabel(_along(measurements))
        else:
            _budget_bars(axes, measurements)
        key_above(axes)

    alt = "Shares that sources of error have in the standard deviation of the corrected points."
    return Panel("What makes them uncertain", draw, alt, layout=None)


def shares(budget: PointBudget) -> dict[str, Array]:
    """What each source adds (N,) to the standard deviation along the normal, in µm.

    It is the source's share in the variance: they add up to the standard deviation.
    """
    whole = np.where(budget.total_um > 0.0, budget.total_um, np.nan)
    return {name: um * np.abs(um) / whole for name, um in budget.sigma_um.items() if np.any(um)}


def draw_budget(axes: Axes, budget: PointBudget, along: Array) -> None:
    """The shares of the sources along a line, on top of each other; what they take off, below."""
    above = below = np.zeros(len(along))
    for name, share in shares(budget).items():
        up, down = above + np.maximum(share, 0.0), below + np.minimum(share, 0.0)
        style = {"color": colour(name), "lw": 0, "label": name}
        axes.fill_between(along, above, up, **style)
        axes.fill_between(along, below, down, **style | {"label": None})
        above, below = up, down
    axes.plot(along, budget.total_um, color=colour("norm"), lw=1.0, label="in all")
    axes.set(ylabel="standard deviation, µm")


def _budget_bars(axes: Axes, measurements: Sequence[Corrected]) -> None:
    """Medians of the shares, a bar for each of the first measurements."""
    shown = measurements[:_MOST_BARS]
    medians = [{n: float(np.nanmedian(s)) for n, s in shares(e.budget).items()} for e in shown]
    rows, left, right = np.arange(len(shown)), np.zeros(len(shown)), np.zeros(len(shown))
    for name in dict.fromkeys(name for each in medians for name in each):
        size = np.array([each.get(name, 0.0) for each in medians])
        start = np.where(size < 0.0, left, right)
        axes.barh(rows, size, left=start, color=colour(name), label=name, height=0.6)
        left, right = left + np.minimum(size, 0.0), right + np.maximum(size, 0.0)
    axes.set_yticks(rows, [drawable(each.name) for each in shown])
    axes.invert_yaxis()
    axes.set(xlabel="standard deviation, median along the line, µm")


def part_panel(measurements: Sequence[Corrected]) -> Panel:
    """Points over the part, and the uncorrected ones with their error enlarged."""
    points = np.concatenate([each.point_mm for each in measurements])
    across, up = side_of(points)
    flat = [across, up]
    errors = [each.point_uncorrected_mm - each.point_mm for each in measurements]
    longest = float(np.nanmax(np.linalg.norm(np.concatenate(errors), axis=1), initial=0.0))
    known = points[np.isfinite(points).all(axis=1)]
    extent = float(np.ptp(known, axis=0).max(initial=0.0)) if len(known) else 0.0
    enlarged = _rounded_down(_LONGEST * extent / longest) if longest > 0.0 < extent else 1.0

    def draw(axes: Axes) -> None:
        for (each, paint, label), error in zip(_marked(measurements), errors, strict=True):
            end = each.point_mm[:, flat]
            start = end + enlarged * error[:, flat]
            rows = np.flatnonzero(np.isfinite(start).all(axis=1))
            rows = rows[:: -(-len(rows) // _SPOKES) or 1]
            both = np.stack([start[rows], end[rows]])
            axes.plot(both[..., 0], both[..., 1], color=paint, lw=0.6, alpha=0.6)
            axes.plot(*start.T, color=paint, lw=1.0, **_style(each, 1))
            axes.plot(*end.T, color=paint, lw=2.2, label=label, **_style(each))
        from_side(axes, across, up)
        if len(measurements) > 1:
            key_above(axes)

    off = f"uncorrected, {enlarged:g} times as far off" if enlarged != 1.0 else "uncorrected"
    alt = f"The points from the side; dashed: {off}."
    return Panel(f"The points; dashed: {off}", draw, alt, layout=None)


def residual_panel(measurements: Sequence[Corrected]) -> Panel:
    """What the estimate leaves in the images, and the noise that is expected there."""

    def draw(axes: Axes) -> None:
        for each, paint, label in _marked(measurements):
            if each.residual_px is None:
                continue
            dots = {"ms": 2.0 if each.points > _FEW else 5.0, "color": paint, "label": label}
            axes.plot(each.along_mm, each.residual_px, ".", **dots)
            _draw_band(axes, each, WITHIN_95 * each.sigma_px, paint)
        axes.axhline(0.0, color="0.5", lw=0.8)
        axes.set(xlabel=_along(measurements), ylabel="px")
        if len(measurements) > 1:
            key_above(axes)

    alt = "What the estimate leaves in the images, with the interval of 95 % of the noise."
    return Panel("What is left in the images, and 95 % of noise", draw, alt, layout=None)


def estimates_panel(table: EstimateTable) -> Panel:
    """Several estimates one after the other, with their intervals of 95 %."""
    names = list(dict.fromkeys(table.parameter.tolist()))

    def draw(figure: Any) -> None:
        rows = figure.subplots(len(names), 1, sharex=True, squeeze=False)[:, 0]
        for axes, name, paint in zip(rows, names, cycle(CYCLE), strict=False):
            mine = table.parameter == name
            number, value = np.arange(1, mine.sum() + 1), table.value[mine]
            half = WITHIN_95 * table.sigma[mine]
            axes.errorbar(number, value, half, fmt="o", color=paint, ms=3.0, capsize=1.5)
            axes.set_ylabel(_with_unit(name, table.unit[mine][0]))
            axes.xaxis.get_major_locator().set_params(integer=True)
        rows[-1].set_xlabel("estimate, in the order of the measurements")

    alt = f"Estimates of {listed(names)}, one after the other, with their intervals of 95 %."
    return Panel("What was estimated", draw, alt, height=-(-len(names) // 3), axes=False)


def correlation_panel(estimate: AirEstimate) -> Panel:
    """The correlation matrix of what was estimated."""
    alt = "The correlation matrix of the parameters that were estimated."
    return Panel("Correlations", lambda axes: draw_correlation(axes, estimate), alt)


def draw_correlation(axes: Axes, estimate: AirEstimate | Identifiability) -> None:
    """The correlation matrix of what is estimated, with its numbers."""
    names, matrix = estimate.names, estimate.correlation
    drawn = axes.imshow(matrix, cmap="RdBu_r", vmin=-1.0, vmax=1.0)
    if len(names) <= _WRITTEN:
        for (row, column), value in np.ndenumerate(matrix):
            paint = letters_on(to_hex(drawn.cmap(drawn.norm(value))))
            words = f"{round(value, 2) + 0.0:.2f}".replace("-", "\N{MINUS SIGN}")
            axes.text(column, row, words, ha="center", va="center", color=paint)
    else:
        axes.figure.colorbar(drawn, ax=axes)
    axes.set_xticks(range(len(names)), names, rotation=30, ha="right", rotation_mode="anchor")
    axes.set_yticks(range(len(names)), names)
    axes.grid(False)


def _rounded_down(value: float) -> float:
    """1, 2 or 5 times a power of ten, at most the value."""
    power = 10.0 ** np.floor(np.log10(value))
    return float(max(step for step in _STEPS if step * power <= value) * power)


def _along(measurements: Sequence[Corrected]) -> str:
    """What measurements are drawn over."""
    areal = all(each.part.areal for each in measurements)
    return "y of the projector, from its middle, in mm" if areal else ALONG


def _draw_band(axes: Axes, each: Corrected, half: Array, paint: str) -> None:
    """Both ends (N,) of an interval about zero."""
    ends = np.stack([half, -half], axis=1)
    line = {"ls": "none", "marker": ","} if each.part.areal else {"lw": 0.8}
    axes.plot(each.along_mm, ends, color="0.4" if each.part.areal else paint, **line)


def _style(each: Corrected, number: int = 0) -> dict[str, Any]:
    """How the curve of some number is drawn; few points bear marks, as no line goes through one."""
    if each.part.areal:  # beside each other in two directions
        return {"ls": "none", "marker": ".,"[number], "ms": 2.0}
    marks = {"marker": ".", "ms": 5.0} if each.points <= _FEW else {}
    return {"ls": LINES[number]} | marks


def _marked(measurements: Sequence[Corrected]) -> Iterator[tuple[Corrected, str, str | None]]:
    """Measurements with a colour and a label each; many alike have one colour and no label."""
    few = len(measurements) <= _NAMED
    for each, paint in zip(measurements, cycle(CYCLE if few else (GREY,)), strict=False):
        yield each, paint, drawable(each.name) if few else None
