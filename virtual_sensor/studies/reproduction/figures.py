"""The columns of the paper's figures 6 to 11: one tidy table each.

The pictures are drawn from these tables, so that a picture and its CSV file can't disagree.
"""

from __future__ import annotations

import dataclasses
from collections.abc import Callable, Mapping, Sequence
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from virtual_sensor.metrology.deviation import euclidean
from virtual_sensor.studies.reproduction.curves import DOTS, LINE, SEARCHED, Curve, Curves
from virtual_sensor.studies.tables import write_csv

Array = NDArray[np.float64]
Table = Mapping[str, NDArray[np.generic]]
"""Columns of equal length by name; none at all where no curve is there."""

WAYS = (SEARCHED, DOTS, LINE)
FROM_ABOVE = ((1250.0, 0.0),)
HOTTER = ((900.0, 0.0), (1100.0, 0.0), (1250.0, 0.0))
TURNED = ((900.0, 0.0), (900.0, 15.0), (900.0, 30.0))
"""Settings of the figures: temperature in degC, beta in degrees."""

SEEN_RAY_MM = -7.5
"""The laser ray whose displacement figures 9(d) to 9(f) show on the sensor."""

_PARALLEL = 1e-6  # cosine: below it a world axis is square to the image's u


def write_figures(curves: Curves, airs: Sequence[str], folder: Path) -> None:
    """Write ``figure_7a_resolved.csv`` and so on: what there is of each figure in each air.

    Raises
    ------
    InputError
        If a file can't be written.
    """
    for air in airs:
        for name, columns in FIGURES.items():
            if table := columns(curves, air):
                write_csv(folder / f"figure_{name}_{air}.csv", table)


def _figure(
    columns: Callable[[Curve], dict[str, Array]],
    settings: Sequence[tuple[float, float]] = FROM_ABOVE,
    ways: Sequence[str] = WAYS,
    ray_mm: float | None = None,
) -> Callable[[Curves, str], Table]:
    """A figure whose rows are the rays of some curves, or the one ray next to `ray_mm`."""

    def table(curves: Curves, air: str) -> Table:
        parts: list[Table] = []
        for way in ways:
            for temperature_c, beta_deg in settings:
                try:
                    curve = curves.rays(air, temperature_c, beta_deg, way)
                except KeyError:  # not rendered in this air
                    continue
                if ray_mm is not None:
                    curve = _one_ray(curve, ray_mm)
                named = {"temperature_c": temperature_c, "beta_deg": beta_deg}
                parts.append(
                    {"y_mm": curve.y_mm, "way": np.full(len(curve.y_mm), way)}
                    | {k: np.full(len(curve.y_mm), v) for k, v in named.items() if settings[1:]}
                    | columns(curve)
                )
        names = parts[0] if parts else ()
        return {name: np.concatenate([part[name] for part in parts]) for name in names}

    return table


def _one_ray(curve: Curve, y_mm: float) -> Curve:
    place = int(np.argmin(np.abs(curve.y_mm - y_mm)))
    names = ("y_mm", "A_mm", "B_mm", "pixel_A", "pixel_B", "helper_um")
    return dataclasses.replace(curve, **{n: getattr(curve, n)[place : place + 1] for n in names})


def _points(curve: Curve, difference_um: Array) -> dict[str, Array]:
    """Columns of a difference (N, 3) of points and its norm.

    A line's image tells nothing along u: NaN in the world's axes that u has a part in.
    """
    along_u = np.abs(curve.sensor.camera.pose.rotation[:, 0]) > _PARALLEL
    known = np.where(along_u & (curve.way == LINE), np.nan, difference_um)
    return {f"d{x}_um": known[:, i] for i, x in enumerate("xyz")} | {"d_um": euclidean(known)}


def _pixels(curve: Curve, difference_px: Array) -> dict[str, Array]:
    """Columns of a difference (N, 2) of pixels and its norm; of a line only v is known."""
    known = _seen(curve, difference_px)
    return {"du_px": known[:, 0], "dv_px": known[:, 1], "d_px": euclidean(known)}


def _seen(curve: Curve, pixel: Array) -> Array:
    return np.where(np.array([curve.way == LINE, False]), np.nan, pixel)


def _ways_on_the_sensor(curve: Curve) -> tuple[Array, Array, Array]:
    """Pixels (N, 2) of figure 8: A and B seen straight, and B seen through the hot air.

    The cold frame shows A, seen straight; B seen straight no frame shows, it comes from the search.
    """
    project = curve.sensor.camera.project
    A_straight = project(curve.A_mm) if curve.way == SEARCHED else curve.pixel_A
    return A_straight, project(curve.B_mm), curve.pixel_B


def _laser_to_object(curve: Curve) -> dict[str, Array]:
    A, B, _ = _ways_on_the_sensor(curve)
    return _pixels(curve, B - A)


def _arrow(start: int, end: int) -> Callable[[Curve], dict[str, Array]]:
    """Columns of the arrow between two of the three points on the sensor."""

    def columns(curve: Curve) -> dict[str, Array]:
        points = _ways_on_the_sensor(curve)
        ends = {
            f"{name}_{axis}_px": _seen(curve, points[number])[:, i]
            for name, number in (("from", start), ("to", end))
            for i, axis in enumerate("uv")
        }
        return ends | _pixels(curve, points[end] - points[start])

    return columns


def _rounded(curve: Curve) -> dict[str, Array]:
    moved = curve.rounded
    return _pixels(curve, moved.pixel_px) | _points(curve, moved.measured_um)


def _exact(curve: Curve) -> dict[str, Array]:
    moved = curve.exact
    return _pixels(curve, moved.pixel_px) | _points(curve, moved.measured_um)


FIGURES: Mapping[str, Callable[[Curves, str], Table]] = {
    "6": _figure(lambda c: {"h_d_min_um": c.helper_um}, ways=(SEARCHED,)),
    "7a": _figure(lambda c: _points(c, c.exact.incidence_um), ways=(SEARCHED,)),
    "7b": _figure(lambda c: _points(c, c.exact.hot_um)),
    "7c": _figure(lambda c: _points(c, c.exact.measured_um)),
    "7d": _figure(lambda c: _pixels(c, c.exact.pixel_px)),
    "7e": _figure(lambda c: _points(c, c.rounded.cold_um)),
    "9a": _figure(_laser_to_object),
    "9b": _figure(lambda c: _pixels(c, c.paths.object_to_camera_px)),
    "9c": _figure(lambda c: _pixels(c, c.paths.laser_to_camera_px)),
    "9d": _figure(_arrow(0, 1), ray_mm=SEEN_RAY_MM),
    "9e": _figure(_arrow(1, 2), ray_mm=SEEN_RAY_MM),
    "9f": _figure(_arrow(0, 2), ray_mm=SEEN_RAY_MM),
    "10b": _figure(_rounded),
    "11a": _figure(lambda c: _points(c, c.exact.measured_um), HOTTER),
    "11b": _figure(lambda c: _points(c, c.rounded.measured_um), HOTTER),
    "11c": _figure(lambda c: _pixels(c, c.exact.pixel_px), HOTTER),
    "11d": _figure(_exact, TURNED),
}
"""Tables by the paper's names; each is called with the curves and an air.

Columns are y_mm, way, temperature_c and beta_deg where there are several, components and norm.

===== ==========================================================================================
6     h_d_min, where the paper's search ended; only the search has it
7a    B - A: no frame shows these points, so only the search has them
7b    B - B_m
7c    B_m - A_m
7d    pixel of B minus pixel of A
7e    A - A_m, pixels rounded to 0.25 px; all others but 10b and 11b are quasi-continuous
9a-c  pixel displacement by the way laser -> object, object -> camera, and by both
9d-f  the same for one ray: where on the sensor the arrow starts and ends
10b   as 7d and 7c, pixels rounded
11a-b \\|B_m - A_m\\| of three temperatures, quasi-continuous and rounded: (a.1) and (a.2)
11c   pixel displacement of three temperatures
11d   pixel displacement of three poses, and B_m - A_m, of which the paper states the size only
===== ==========================================================================================
"""
