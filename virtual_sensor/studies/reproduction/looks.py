"""What we find for the statements of section 5: each function looks at the curves of one air."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from virtual_sensor.metrology.deviation import euclidean
from virtual_sensor.studies.reproduction.curves import ROUNDED_PX, Curve, Curves
from virtual_sensor.studies.reproduction.numbers import LAST, STATED_RAY, TOLERANCE
from virtual_sensor.studies.reproduction.settings import BETAS_DEG, TEMPERATURES_C

Array = NDArray[np.float64]


@dataclass(frozen=True)
class Found:
    """What we find for a statement in one air: in words, and whether it bears the statement out."""

    words: str
    met: bool


Look = Callable[[Curves, str], Found]
"""Given all curves and the air."""


def from_above(look: Callable[[Curve], tuple[bool, str]]) -> Look:
    """A look at the nine rays that most statements are about: 1250 degC, beta = 0."""

    def looked(curves: Curves, air: str) -> Found:
        met, words = look(curves.rays(air, 1250.0, 0.0))
        return Found(words, bool(met))

    return looked


def measured(curve: Curve) -> Array:
    """|B_m - A_m| of each ray, um: d_euclid,xyz of figure 7(c)."""
    return euclidean(curve.exact.measured_um)


def displaced(curve: Curve) -> Array:
    """Displacement of each ray's pixel, px: d_euclid,uv of figure 7(d)."""
    return euclidean(curve.exact.pixel_px)


def _cold(curve: Curve) -> Array:
    return euclidean(curve.rounded.cold_um)


def _tiny(value: float, bound: float, unit: str) -> str:
    """A residue in words: what is below the bound is rounding, whose digits say nothing."""
    return f"below {bound:g} {unit}" if abs(value) < bound else f"{value:.2g} {unit}"


def steps(values: Callable[[Curve], Array], sign: float) -> Look:
    """Whether a curve goes one way from each of the nine rays to the next."""

    def look(curve: Curve) -> tuple[bool, str]:
        of = values(curve)
        right = int(np.sum(sign * np.diff(of) > 0.0))
        first = 0.0 if abs(of[0]) < 1e-9 else of[0]
        words = f"{right} of {len(of) - 1} steps, {first:.3g} to {of[-1]:.3g}"
        return right == len(of) - 1, words

    return from_above(look)


@from_above
def helper(curve: Curve) -> tuple[bool, str]:
    """Figure 6: the paper's search arrives."""
    largest = float(np.max(curve.helper_um))
    return largest < 1.0, f"{largest:.2f} µm"


@from_above
def flat_top(curve: Curve) -> tuple[bool, str]:
    """At y = 0 the surface is level: the spot moves along the axis only."""
    moved = curve.exact.incidence_um
    first, last = (float(np.hypot(*moved[ray, 1:])) for ray in (0, LAST))
    words = f"{_tiny(first, 1e-6, 'µm')} across the axis, {last:.3g} µm at y = -10 mm"
    return first < 0.1 * last, words


@from_above
def not_negligible(curve: Curve) -> tuple[bool, str]:
    """Each ray's deviation is at least twice what rounding does to the cold part."""
    hot, cold = float(euclidean(curve.exact.hot_um).min()), float(_cold(curve).max())
    return hot > 2.0 * cold, f"at least {hot:.3g} µm, {hot / cold:.2g} times the rounding's"


@from_above
def cold_distance(curve: Curve) -> tuple[bool, str]:
    """Figure 7(e): the largest distance of a rounded cold point."""
    largest = float(_cold(curve).max())
    return abs(largest / 2.7 - 1.0) <= TOLERANCE, f"{largest:.3g} µm"


@from_above
def cold_axis(curve: Curve) -> tuple[bool, str]:
    """The same along an axis of the sensor, where half a step is the bound."""
    axes = curve.sensor.camera.pose.rotation[:, :2]
    largest = float(np.abs(curve.rounded.cold_um @ axes).max())
    return abs(largest / 2.75 - 1.0) <= TOLERANCE, f"{largest:.3g} µm"


@from_above
def cold_exact(curve: Curve) -> tuple[bool, str]:
    """Without rounding there is nothing left."""
    largest = float(euclidean(curve.exact.cold_um).max())
    return largest < 1e-3, f"{_tiny(largest, 1e-6, 'µm')} without rounding"


@from_above
def maximum_at_0(curve: Curve) -> tuple[bool, str]:
    """|B_m - A_m| of all nine rays is largest at y = 0."""
    d = measured(curve)
    most = int(np.argmax(d))
    return most == 0, f"{d[0]:.3g} µm; largest {d[most]:.3g} µm at y = {curve.y_mm[most]:g} mm"


@from_above
def dip(curve: Curve) -> tuple[bool, str]:
    """Down from y = 0 without a break to an inner least value, and up from there to -10 mm."""
    d = measured(curve)
    least = int(np.argmin(d))
    falls, rises = np.all(np.diff(d[: least + 1]) < 0.0), np.all(np.diff(d[least:]) > 0.0)
    values = f"{d[0]:.3g}, {d[least]:.3g}, {d[LAST]:.3g} µm"
    words = f"{values} at y = 0, {curve.y_mm[least]:g}, -10 mm"
    return bool(0 < least < LAST and falls and rises), words


@from_above
def region_2(curve: Curve) -> tuple[bool, str]:
    """The least |B_m - A_m| is at y = -7.5 mm, or at a ray beside it."""
    least = int(np.argmin(measured(curve)))
    return abs(least - STATED_RAY) <= 1, f"least at y = {curve.y_mm[least]:g} mm"


@from_above
def alike(curve: Curve) -> tuple[bool, str]:
    """The norms of figures 7(c) and 7(d) go together."""
    r = float(np.corrcoef(measured(curve), displaced(curve))[0, 1])
    return r > 0.9, f"correlation {r:.3f}"


@from_above
def oddly(curve: Curve) -> tuple[bool, str]:
    """Somewhere along the rays the spot moves further on the part, the measured point less."""
    spot, point = np.diff(euclidean(curve.exact.incidence_um)), np.diff(measured(curve))
    count = int(np.sum((spot > 0.0) & (point < 0.0)))
    return count > 0, f"in {count} of {len(spot)} steps"


@from_above
def opposed(curve: Curve) -> tuple[bool, str]:
    """Along u, the two paths displace the pixel to opposite sides."""
    laser, camera = curve.paths.laser_to_object_px, curve.paths.object_to_camera_px
    against = laser[1:, 0] * camera[1:, 0] < 0.0
    return bool(against.all()), f"in {int(against.sum())} of the {len(against)} rays off y = 0"


@from_above
def same_sum(curve: Curve) -> tuple[bool, str]:
    """The sum of the separated paths is the whole."""
    both = curve.paths.laser_to_object_px + curve.paths.object_to_camera_px
    apart = float(np.abs(both - curve.exact.pixel_px).max())
    return apart < 1e-9, f"sum minus whole: {_tiny(apart, 1e-9, 'px')}"


@from_above
def reduced(curve: Curve) -> tuple[bool, str]:
    """At y = -7.5 mm both paths together displace the pixel less than either alone."""
    paths = curve.paths
    one, two, both = (
        float(np.linalg.norm(path[STATED_RAY]))
        for path in (paths.laser_to_object_px, paths.object_to_camera_px, paths.laser_to_camera_px)
    )
    return both < min(one, two), f"{one:.3g} and {two:.3g} px make {both:.3g} px"


def _rounding(curve: Curve, step_px: float) -> float:
    return float(np.abs(curve.deviation(step_px).pixel_px - curve.exact.pixel_px).max())


@from_above
def slightly(curve: Curve) -> tuple[bool, str]:
    """Rounding changes the displacement by a step at most."""
    largest = _rounding(curve, ROUNDED_PX)
    return largest <= ROUNDED_PX, f"at most {largest:.2f} px"


@from_above
def coarser(curve: Curve) -> tuple[bool, str]:
    """Rounding to twice the step changes it by more."""
    fine, coarse = (_rounding(curve, step) for step in (ROUNDED_PX, 2.0 * ROUNDED_PX))
    return coarse > fine, f"{coarse:.2f} px in place of {fine:.2f}"


@from_above
def marginal(curve: Curve) -> tuple[bool, str]:
    """At y = 0 symmetry keeps the spot at y = 0."""
    moved = abs(float(curve.exact.incidence_um[0, 1]))
    return moved < 1.0, f"{_tiny(moved, 1e-6, 'µm')} in y"


@from_above
def above(curve: Curve) -> tuple[bool, str]:
    """At y = 0 the measured point floats above the part."""
    x, _, z = -curve.exact.hot_um[0]
    return z > 0.0, f"B_m - B: {z:+.3g} µm in z, {x:+.2f} µm in x"


@from_above
def steppier(curve: Curve) -> tuple[bool, str]:
    """A rounded curve bends more from ray to ray."""
    smooth, stepped = (
        float(np.abs(np.diff(euclidean(d.measured_um), 2)).sum())
        for d in (curve.exact, curve.rounded)
    )
    return stepped > smooth, f"bends {stepped / smooth:.2f} times as much from ray to ray"


def hotter(norms: Callable[[Curve], Array]) -> Look:
    """Hotter is more for each of the rays from y = 0 to -5 mm."""

    def look(curves: Curves, air: str) -> Found:
        d = np.stack([norms(curves.rays(air, t))[:5] for t in TEMPERATURES_C])
        rising = np.all(np.diff(d, axis=0) > 0.0, axis=0)
        return Found(f"in {int(rising.sum())} of the 5 rays", bool(rising.all()))

    return look


def _increase(curves: Curves, air: str) -> Array:
    """Of |B_m - A_m| from 900 to 1250 degC, um."""
    return measured(curves.rays(air, 1250.0)) - measured(curves.rays(air, 900.0))


def no_difference(curves: Curves, air: str) -> Found:
    """Between y = -5 and -10 mm temperature makes less than half the difference of 0 to -5 mm."""
    more = np.abs(_increase(curves, air))
    inner, outer = float(more[:5].mean()), float(more[5:LAST].mean())
    words = f"{outer:.2g} µm beyond y = -5 mm, {inner:.2g} µm up to there"
    return Found(words, outer < 0.5 * inner)


def except_last(curves: Curves, air: str) -> Found:
    """At y = -10 mm it makes more of a difference than at the ray before."""
    more = np.abs(_increase(curves, air))
    words = f"{more[LAST]:.2g} µm at y = -10 mm, {more[LAST - 1]:.2g} µm next to it"
    return Found(words, bool(more[LAST] > more[LAST - 1]))


def turned(curves: Curves, air: str) -> Found:
    """The largest displacement of a pixel shrinks from pose to pose, at 900 degC."""
    largest = [float(displaced(curves.rays(air, 900.0, beta)).max()) for beta in BETAS_DEG]
    words = ", ".join(f"{value:.3g}" for value in largest) + " px"
    return Found(words, bool(np.all(np.diff(largest) < 0.0)))


def sideways(curves: Curves, air: str) -> Found:
    """From beta = 30 deg the deviation is less than from above, at any temperature."""
    ratio = max(
        float(measured(curves.rays(air, t, 30.0)).max() / measured(curves.rays(air, t)).max())
        for t in TEMPERATURES_C
    )
    return Found(f"at most {100 * ratio:.0f} % of the deviation from above", ratio < 1.0)
