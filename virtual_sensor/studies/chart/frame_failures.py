"""Where frames fail: folds, shadows, too few samples, too long steps, too thin a line."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import NDArray

from virtual_sensor.imaging.render import lit_pixels, render_frame, render_uncached
from virtual_sensor.imaging.scene import Scene, load_scene
from virtual_sensor.medium.index_field import IndexField
from virtual_sensor.metrology.centres import Status
from virtual_sensor.metrology.line_peaks import line_centres
from virtual_sensor.metrology.truth import compare_line
from virtual_sensor.optics.illumination import LightStatus
from virtual_sensor.optics.ray_search import incidence_points
from virtual_sensor.studies.chart.frames import (
    QUICK_FILM_PX,
    SCENE,
    Reference,
    reference,
)
from virtual_sensor.studies.chart.rung import Failure, Report

TRANSPORTS = ("marched", "tabulated")
CONTRASTS = (1, 2, 5, 10, 20, 50, 100)
QUICK_CONTRASTS = (10, 20)
_THIN_MM = 0.1  # 1/e^2 radius of a line that is little wider than a pixel of the small film
TOO_MUCH_PX = 0.01
"""An error above which a frame counts as failed, where no status can tell it."""

LIT = LightStatus.LIT
_FILM = {"width": QUICK_FILM_PX, "height": QUICK_FILM_PX}


def failures(report: Report, quick: bool = False) -> list[Failure]:
    """Raise the trouble step by step, and note where it first shows, and how it is told."""
    contrasts = QUICK_CONTRASTS if quick else CONTRASTS
    found = []
    for number, name in enumerate(TRANSPORTS):
        report(f"{name} frames in air of ever more contrast", 0.3 * number)
        found.append(folding(name, contrasts, 1.5 if quick else 1.05))
    report("frames with shadows", 0.6)
    found.append(shadowed())
    report("frames of too few samples, too long steps", 0.65)
    found += _too_rough(quick)
    report("frames of thin lines", 0.9)
    return [
        *found,
        thin_line((0.15, 0.05) if quick else (0.15, 0.12, 0.09, 0.08, 0.07, 0.05, 0.03)),
    ]


def contrasted(field: IndexField, factor: float) -> IndexField:
    """The same air, its difference from the surroundings `factor` times as large."""
    return field.with_nodes(
        field.ambient + factor * (field.nodes - field.ambient),
        source=f"{field.source}, {factor:g} times the contrast",
    )


@dataclass(frozen=True)
class Told:
    """What a frame tells of its pixels.

    Attributes
    ----------
    counts : dict
        How many pixels have each `LightStatus`.
    hidden : int
        How many of those that are not lit have a true laser coordinate all the same.
    centres : int
        Columns in which a line was found.
    lit_y_mm : ndarray of shape (N,)
        y on the part of the pixels that are lit.
    reason : str
        Why the frame was not made by the transport that was asked for; "" if it was.
    """

    counts: dict[LightStatus, int]
    hidden: int
    centres: int
    lit_y_mm: NDArray[np.float32]
    reason: str


def told_by(scene: Scene) -> Told:
    """Render a scene, and count what it tells."""
    frame = render_frame(scene)
    (status,) = frame.truth.status.values()
    unlit = frame.truth.index[status != LightStatus.LIT]
    known = np.isfinite(frame.coordinates()[:, :, 0]).ravel()[unlit]
    line = line_centres(frame.radiance)
    return Told(
        {member: int(np.sum(status == member)) for member in LightStatus},
        int(known.sum()),
        int(np.sum(line.status == Status.OK)),
        frame.point_mm[:, :, 1][frame.lit],
        frame.account.reason,
    )


def folding(transport: str, contrasts: Sequence[float], doubt: float = 1.05) -> Failure:
    """Raise the air's contrast until the laser's map folds: a caustic.

    The contrast of the first fold is then found to the factor `doubt`.
    """
    scene = load_scene(SCENE, transport=transport, spp=4, **_FILM)
    air = scene.field
    assert air is not None
    usual = told_by(scene)

    def folds(factor: float) -> bool:
        (status,) = lit_pixels(scene.with_medium(contrasted(air, factor))).status.values()
        lit = int(np.sum(status == LightStatus.LIT))
        # Where all is folded, no pixel is taken for one that the laser may reach.
        return bool(np.any(status == LightStatus.FOLDED)) or lit < 0.1 * usual.counts[LIT]

    first = _first(folds, contrasts, doubt)
    true = _first(lambda factor: bool(_back(_heights(scene, air, factor))), contrasts, doubt)
    told = told_by(scene.with_medium(contrasted(air, first or contrasts[-1])))
    last = told_by(scene.with_medium(contrasted(air, contrasts[-1])))
    pieces = [
        f"{told.hidden} of the unlit pixels have a truth all the same",
        f"{told.centres} columns with a line, {usual.centres} at the usual contrast",
        f"at {contrasts[-1]:g} times: {last.counts[LightStatus.FOLDED]} pixels folded,"
        f" {last.counts[LIT]} lit, {last.centres} columns with a line",
        "the laser line on the part runs back over itself from"
        f" {f'{true:.3g} times on' if true else 'none of them on'}",
    ]
    if true:
        beyond = 1.25 * true
        y = told_by(scene.with_medium(contrasted(air, beyond))).lit_y_mm
        twice = np.zeros(y.shape, bool)
        for low, high in _back(_heights(scene, air, beyond)):
            twice |= (y > low) & (y < high)
        pieces.append(
            f"at {beyond:.3g} times {twice.sum()} of {twice.size} pixels that are told to be lit"
            " get more than one laser ray, of which one is counted"
        )
    if told.reason:
        pieces.append(f"marched: {told.reason}")
    return Failure(
        what="laser's map folds (a caustic)",
        method=f"{transport} frame",
        first_at=f"{first:.3g} times the air's contrast" if first else "",
        tried=f"contrast times {contrasts[0]:g} to {contrasts[-1]:g}; 1250 degC, film of 512 px",
        status="FOLDED: the pixel gets no laser light, its truth is NaN",
        failed=told.counts[LightStatus.FOLDED],
        of=sum(told.counts.values()),
        note="; ".join(pieces),
    )


def _first(fails: Callable[[float], bool], values: Sequence[float], doubt: float) -> float | None:
    """The first of ascending values that fails, found to a factor between it and the one before."""
    first = next(filter(fails, values), None)
    if first is None:
        return None
    sound = max((value for value in values if value < first), default=first)
    while first > doubt * sound:
        middle = float(np.sqrt(sound * first))
        sound, first = (sound, middle) if fails(middle) else (middle, first)
    return first


def _heights(scene: Scene, air: IndexField, factor: float) -> NDArray[np.float64]:
    """Where the laser line's rays meet the part: y in mm, from one end of the line to the other."""
    half = 0.5 * scene.sensor.laser.length_mm
    hotter = scene.with_medium(contrasted(air, factor))
    return incidence_points(hotter, np.linspace(-half, half, 2001))[:, 1]


def _back(y: NDArray[np.float64]) -> list[tuple[float, float]]:
    """Ranges over which a line runs back: their places get light from before and after, too."""
    runs = _runs(np.diff(y) < 0.0)  # no step from or to a ray that met nothing
    return [(float(y[run + 1].min()), float(y[run].max())) for run in runs]


def _runs(mask: NDArray[np.bool_]) -> list[NDArray[np.intp]]:
    """Indices of each unbroken run of True."""
    index = np.flatnonzero(mask)
    return [run for run in np.split(index, np.flatnonzero(np.diff(index) > 1) + 1) if run.size]


def shadowed() -> Failure:
    """Points that the camera sees and the laser does not reach: behind a shoulder."""
    told = told_by(load_scene("stepped_shaft", spp=4, **_FILM))
    hidden = told.counts[LightStatus.SHADOWED]
    return Failure(
        what="undercut: the part shades itself",
        method="frame of stepped_shaft",
        first_at="the scene as it is" if hidden else "",
        tried="the scene as it is",
        status="SHADOWED: the pixel gets no laser light, its truth is NaN",
        failed=hidden,
        of=sum(told.counts.values()),
        note=f"{told.hidden} of the unlit pixels have a truth all the same",
    )


def _too_rough(quick: bool) -> list[Failure]:
    """Frames that no status can tell to be wrong: the error grows with the roughness."""
    thin: dict[str, Any] = {"line_radius": _THIN_MM}
    truth = reference(QUICK_FILM_PX, 4 if quick else 64, 2.0, **thin)
    spps = (4, 1) if quick else (16, 9, 4, 1)
    settings = {"transport": "tabulated", **thin}
    what = f"too few samples of a line of {_THIN_MM:g} mm"
    found = [_first_above(truth, what, "tabulated frame", settings, "spp", spps, "samples")]
    truth = reference(QUICK_FILM_PX, *(4, 2.0) if quick else (16, 1.0))
    lengths = (2, 32) if quick else (1, 2, 4, 8, 16, 32)
    methods = ("leapfrog",) if quick else ("euler", "leapfrog", "sharma", "rk4")
    tried = [("tabulated", method) for method in methods]
    for transport, method in tried if quick else [*tried, ("marched", "leapfrog")]:
        settings = {"transport": transport, "method": method, "spp": 4}
        name = f"{transport} frame, {method}"
        found.append(_first_above(truth, "step too long", name, settings, "step", lengths, "mm"))
    return found


def _first_above(
    truth: Reference,
    what: str,
    method: str,
    settings: dict[str, Any],
    name: str,
    values: Sequence[float],
    unit: str,
) -> Failure:
    """Take one setting from good to bad, up to where the error is too large."""
    errors: dict[float, str] = {}
    first, told, lost = "", "", 0
    for value in values:
        scene = load_scene(SCENE, **_FILM, **settings, **{name: value})
        found = compare_line(line_centres(render_uncached(scene)), truth.line)
        lost, told = found.lost.size, _told_lost(found.lost)
        errors[value] = f"{found.largest_px:.2g} px" if found.count else "no line"
        if not found.largest_px <= TOO_MUCH_PX:
            first = f"{value:g} {unit}"
            break
    return Failure(
        what=what,
        method=method,
        first_at=first,
        tried=f"{', '.join(f'{v:g}' for v in values)} {unit}; film of {QUICK_FILM_PX} px",
        status=told or f"none can tell: the largest error passes {TOO_MUCH_PX:g} px of the film",
        failed=lost,
        of=truth.line.columns().size,
        note=", ".join(f"{error} at {value:g}" for value, error in errors.items()),
    )


def _told_lost(status: NDArray[np.uint8]) -> str:
    """The statuses of columns that have no centre, each once; "" if all have one."""
    names = {Status(number).name for number in status if number != Status.OK}
    return f"{', '.join(sorted(names))}: the column has no centre" if names else ""


def thin_line(radii_mm: Sequence[float]) -> Failure:
    """A line that gets thinner than a pixel, of 0.088 mm here."""
    seen: dict[float, NDArray[np.uint8]] = {}
    first = ""
    for radius in radii_mm:
        scene = load_scene(SCENE, spp=16, line_radius=radius, **_FILM)
        seen[radius] = line_centres(render_uncached(scene)).status
        if np.any(seen[radius] == Status.TOO_NARROW):
            first = f"1/e^2 radius of {radius:g} mm"
            break
    status = seen[radius]
    narrow = int(np.sum(status == Status.TOO_NARROW))
    return Failure(
        what="line thinner than a pixel",
        method="frame and Gaussian fit",
        first_at=first,
        tried=f"1/e^2 radii of {', '.join(f'{r:g}' for r in radii_mm)} mm, pixels of 0.088 mm",
        status="TOO_NARROW: the column has no centre",
        failed=narrow,
        of=int(np.sum(status != Status.NO_PEAK)),
    )
