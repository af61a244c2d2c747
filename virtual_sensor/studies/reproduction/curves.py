"""The curves of the paper's figures 6 to 11: laser rays cold and hot, searched or rendered.

A curve is what happens to laser rays that differ in y only, in one setting of part, sensor and air.
It comes from the ray search, from rendered dots (both axes of the image) or from a rendered line
(across the line only: along it, an image of a line tells nothing).
"""

from __future__ import annotations

import csv
from collections.abc import Mapping
from dataclasses import dataclass
from pathlib import Path

import numpy as np
from numpy.typing import NDArray
from scipy.interpolate import CubicSpline

from virtual_sensor.devices.sensor import SensorModel
from virtual_sensor.imaging.scene import Scene
from virtual_sensor.metrology.deviation import (
    Deviation,
    PathDisplacement,
    deviations,
    round_pixel,
    separate_paths,
)
from virtual_sensor.metrology.triangulation import triangulate
from virtual_sensor.optics.ray_search import REFERENCE, March, ray_search

Array = NDArray[np.float64]

ROUNDED_PX = 0.25
"""The paper's discretisation of pixels (section 4.2)."""

SEARCHED, DOTS, LINE = "searched", "rendered dots", "rendered line"
"""The ways to a curve."""
RESOLVED, BLURRED, WIDENED = "resolved", "blurred", "widened"
"""The airs: as simulated, smeared by a Gaussian, stretched across the plume."""


@dataclass(frozen=True, order=True)
class Setting:
    """What a curve was taken in.

    Attributes
    ----------
    air : str
        RESOLVED, BLURRED or WIDENED.
    temperature_c : float
        Of the cylinder, degC.
    beta_deg : float
        Turn of the sensor round the cylinder's axis.
    """

    air: str
    temperature_c: float
    beta_deg: float

    def __str__(self) -> str:
        return f"{self.air}, {self.temperature_c:g} degC, beta = {self.beta_deg:g} deg"


@dataclass(frozen=True)
class Curve:
    """N laser rays, cold and hot.

    Attributes
    ----------
    setting : Setting
    way : str
        SEARCHED, DOTS or LINE.
    sensor : SensorModel
    y_mm : ndarray of shape (N,)
        Positions along the laser line: the paper's discharge locations.
    A_mm, B_mm : ndarray of shape (N, 3)
        Incidence points, cold and hot, world.
    pixel_A, pixel_B : ndarray of shape (N, 2)
        Where the camera sees them, px: quasi-continuous, as the paper calls it.
    helper_um : ndarray of shape (N,)
        Distance h_d_min in the helper frame that the paper's search ended with, hot (figure 6).
    """

    setting: Setting
    way: str
    sensor: SensorModel
    y_mm: Array
    A_mm: Array
    B_mm: Array
    pixel_A: Array
    pixel_B: Array
    helper_um: Array

    def deviation(self, step_px: float | None = None) -> Deviation:
        """Differences of points and pixels; pixels rounded to a step, if one is given."""
        A, B = self.pixel_A, self.pixel_B
        if step_px:
            A, B = round_pixel(A, step_px), round_pixel(B, step_px)
        return deviations(
            self.A_mm, self.B_mm, triangulate(self.sensor, A), triangulate(self.sensor, B), A, B
        )

    @property
    def exact(self) -> Deviation:
        """Quasi-continuous."""
        return self.deviation()

    @property
    def rounded(self) -> Deviation:
        """With pixels rounded to 0.25 px."""
        return self.deviation(ROUNDED_PX)

    @property
    def paths(self) -> PathDisplacement:
        """The pixel's displacement, split by light path (figures 8 and 9)."""
        return separate_paths(self.sensor.camera, self.A_mm, self.B_mm, self.pixel_A, self.pixel_B)


def searched(
    scene: Scene, setting: Setting, y_mm: Array, march: March = REFERENCE, helper: bool = True
) -> Curve:
    """A curve by Newton's search; h_d_min by the paper's own, if asked for."""
    cold = ray_search(scene.cold(), y_mm, "newton", march=march)
    hot = ray_search(scene, y_mm, "newton", march=march)
    papers = ray_search(scene, y_mm, "paper", march=march).distance_um if helper else None
    return Curve(
        setting,
        SEARCHED,
        scene.sensor,
        np.asarray(y_mm, float),
        cold.laser_point_mm,
        hot.laser_point_mm,
        cold.pixel,
        hot.pixel,
        np.full(len(y_mm), np.nan) if papers is None else papers,
    )


def from_dots(curve: Curve, folder: Path) -> Curve:
    """The curve with its pixels from a measurement's rendered dots, which are at the same y."""
    cold, hot = (_pixels(read_columns(folder / f"dots_{s}.csv")) for s in ("cold", "hot"))
    return _seen_otherwise(curve, DOTS, cold, hot)


def from_line(curve: Curve, folder: Path) -> Curve:
    """The curve with v from a measurement's rendered line, at the u that the search gives.

    So u has the search's displacement: what can be compared is across the line only.
    """
    pixels = []
    for name, pixel in (("cold", curve.pixel_A), ("hot", curve.pixel_B)):
        line = read_columns(folder / f"line_{name}.csv")
        good = line["status"] == "ok"
        column, row = line["column_px"][good].astype(float), line["row_px"][good].astype(float)
        inside = (pixel[:, 0] >= column[0]) & (pixel[:, 0] <= column[-1])
        v = np.where(inside, CubicSpline(column, row)(pixel[:, 0]), np.nan)
        pixels.append(np.stack([pixel[:, 0], v], axis=1))
    return _seen_otherwise(curve, LINE, *pixels)


def _seen_otherwise(curve: Curve, way: str, pixel_A: Array, pixel_B: Array) -> Curve:
    return Curve(
        curve.setting,
        way,
        curve.sensor,
        curve.y_mm,
        curve.A_mm,
        curve.B_mm,
        pixel_A,
        pixel_B,
        np.full(len(curve.y_mm), np.nan),
    )


def read_columns(path: Path) -> dict[str, NDArray[np.generic]]:
    """Columns of a CSV file by name: numbers where all are, else text; NaN where empty."""
    with path.open(encoding="utf-8", newline="") as file:
        names, *rows = csv.reader(file)
    columns: dict[str, NDArray[np.generic]] = {}
    for name, cells in zip(names, zip(*rows, strict=True), strict=True):
        try:
            columns[name] = np.array([float(cell) if cell else np.nan for cell in cells])
        except ValueError:
            columns[name] = np.array(cells)
    return columns


def _pixels(columns: Mapping[str, NDArray[np.generic]]) -> Array:
    return np.stack([columns["pixel_u"], columns["pixel_v"]], axis=1).astype(float)


@dataclass(frozen=True)
class Curves:
    """All curves of the reproduction.

    Attributes
    ----------
    nine : dict
        The paper's nine rays, by setting and way.
    whole : dict
        The whole line on both sides, by setting, searched.
    """

    nine: Mapping[tuple[Setting, str], Curve]
    whole: Mapping[Setting, Curve]

    def rays(
        self, air: str, temperature_c: float = 1250.0, beta_deg: float = 0.0, way: str = SEARCHED
    ) -> Curve:
        """The nine rays in one setting; KeyError if that was not asked for."""
        return self.nine[Setting(air, float(temperature_c), float(beta_deg)), way]
