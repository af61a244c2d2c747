"""Laser rays that differ in y only, cold and hot, in one setting of part, sensor and air.

They come from the ray search, from rendered dots (both axes of the image) or from a rendered line
(across the line only: along it, an image of a line tells nothing).
"""

from __future__ import annotations

import csv
from collections.abc import Iterable, Mapping
from dataclasses import dataclass, field, fields, replace
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray
from scipy.interpolate import CubicSpline

from virtual_sensor.devices.sensor import SensorModel
from virtual_sensor.display import Displayed
from virtual_sensor.imaging.scene import Scene
from virtual_sensor.metrology.centres import FOUND_NAMES
from virtual_sensor.metrology.deviation import deviations, euclidean, round_pixel
from virtual_sensor.metrology.triangulation import triangulate
from virtual_sensor.optics.ray_search import REFERENCE, March, ray_search
from virtual_sensor.records import Table
from virtual_sensor.studies.reproduction.settings import Setting

Array = NDArray[np.float64]

ROUNDED_PX = 0.25
"""The paper's discretisation of pixels (section 4.2)."""
METHODS = SEARCHED, DOTS, LINE = "searched", "rendered dots", "rendered line"
"""How rays are found."""
_PARALLEL = 1e-6  # cosine: below it a world axis is square to the image's u


@dataclass(frozen=True)
class Rays(Table):
    """What is drawn of N laser rays, and judged of them; NaN where it is not known.

    Attributes
    ----------
    y_mm : ndarray of shape (N,)
        Positions along the laser line: the paper's discharge locations.
    method : ndarray of shape (N,)
        How the ray was found: searched, rendered dots or rendered line.
    air : ndarray of shape (N,)
        resolved, blurred or widened.
    temperature_c, beta_deg : ndarray of shape (N,)
        Temperature of the cylinder; turn of the sensor, 0 from above.
    search_distance_um : ndarray of shape (N,)
        h_d_min, with which the paper's search ended, hot (figure 6); of searched rays.
    incidence_shift_um : ndarray of shape (N, 3)
        B - A: hot minus cold incidence point (figure 7a); of searched rays.
    hot_error_um : ndarray of shape (N, 3)
        B - B_m: incidence point minus measured point, hot (figure 7b).
    measured_minus_real_um : ndarray of shape (N, 3)
        B_m - B: the same, turned round.
    measured_shift_um : ndarray of shape (N, 3)
        B_m - A_m: hot minus cold measured point (figure 7c).
    pixel_shift_px : ndarray of shape (N, 2)
        Hot minus cold pixel (figure 7d).
    cold_error_um : ndarray of shape (N, 3)
        A - A_m: incidence point minus measured point, cold (figure 7e).
    cold_error_image_um : ndarray of shape (N, 2)
        The same along the axes of the camera's image.
    laser_to_object_px : ndarray of shape (N, 2)
        The part of the pixel's shift that bending of the laser's light makes (figure 9a).
    object_to_camera_px : ndarray of shape (N, 2)
        The part that bending on the line of sight makes (figure 9b).
    laser_to_camera_px : ndarray of shape (N, 2)
        Both together (figure 9c).
    paths_minus_whole_px : ndarray of shape (N, 2)
        Sum of the two parts minus the pixel's shift.
    rounding_px : ndarray of shape (N, 2)
        What rounding of pixels adds to their shift.
    pixel_cold, pixel_straight, pixel_hot : ndarray of shape (N, 2)
        Where the camera sees A, where it would see B without air, and where it sees B.
    """

    y_mm: Array
    method: NDArray[np.str_]
    air: NDArray[np.str_]
    temperature_c: Array
    beta_deg: Array
    search_distance_um: Array
    incidence_shift_um: Array
    hot_error_um: Array
    measured_minus_real_um: Array
    measured_shift_um: Array
    pixel_shift_px: Array
    cold_error_um: Array
    cold_error_image_um: Array
    laser_to_object_px: Array
    object_to_camera_px: Array
    laser_to_camera_px: Array
    paths_minus_whole_px: Array
    rounding_px: Array
    pixel_cold: Array
    pixel_straight: Array
    pixel_hot: Array

    def of(self, name: str) -> Array:
        """A series by its name, and its component behind a point.

        Components are ``x y z`` or ``u v``, ``norm``, ``size`` (the largest magnitude of one) and
        ``across`` (the distance across the cylinder's axis).
        """
        series, _, component = name.partition(".")
        values: Array = getattr(self, series)
        match component:
            case "":
                return values
            case "norm":
                return euclidean(values)
            case "size":
                return np.asarray(np.abs(values).max(axis=1))
            case "across":
                return np.hypot(values[:, 1], values[:, 2])
        return values[:, ("xyz" if values.shape[1] == 3 else "uv").index(component)]

    def columns_of(self, *names: str) -> dict[str, NDArray[Any]]:
        """Columns of some series, those of differences with their norms."""
        every = self.columns()
        found: dict[str, NDArray[Any]] = {}
        for name in names:
            found |= {k: v for k, v in every.items() if k == name or k[:-2] == name}
            if f"{name}_u" in every or f"{name}_x" in every:
                found[f"{name}_norm"] = self.of(f"{name}.norm")
        return found


@dataclass(frozen=True)
class Curve(Displayed):
    """N laser rays, cold and hot.

    Attributes
    ----------
    setting : Setting
    method : str
        SEARCHED, DOTS or LINE.
    sensor : SensorModel
    y_mm : ndarray of shape (N,)
        Positions along the laser line.
    incidence_cold_mm, incidence_hot_mm : ndarray of shape (N, 3)
        The paper's A and B, where the ray meets the part, world.
    pixel_cold, pixel_hot : ndarray of shape (N, 2)
        Where the camera sees them, px: quasi-continuous, as the paper calls it.
    search_distance_um : ndarray of shape (N,)
        The paper's h_d_min (figure 6).
    """

    setting: Setting
    method: str
    sensor: SensorModel
    y_mm: Array
    incidence_cold_mm: Array
    incidence_hot_mm: Array
    pixel_cold: Array
    pixel_hot: Array
    search_distance_um: Array

    def rays(self, step_px: float = 0.0) -> Rays:
        """All series of these rays; with pixels rounded to a step, if one is given."""
        exact = self.pixel_cold, self.pixel_hot
        cold, hot = (round_pixel(p, step_px) for p in exact) if step_px else exact
        A, B = self.incidence_cold_mm, self.incidence_hot_mm
        sensor, camera = self.sensor, self.sensor.camera
        d = deviations(A, B, triangulate(sensor, cold), triangulate(sensor, hot), cold, hot)
        # The cold frame shows A seen straight; B seen straight no frame shows: the search has it.
        start = camera.project(A) if self.method == SEARCHED else cold
        straight = camera.project(B)
        to_object, to_camera = straight - start, hot - straight
        axes = camera.pose.rotation
        found = self.method == SEARCHED
        pixels: dict[str, Any] = {
            "pixel_shift_px": d.pixel_shift_px,
            "laser_to_object_px": to_object,
            "object_to_camera_px": to_camera,
            "laser_to_camera_px": d.pixel_shift_px,
            "paths_minus_whole_px": to_object + to_camera - d.pixel_shift_px,
            "rounding_px": d.pixel_shift_px - (self.pixel_hot - self.pixel_cold),
            "pixel_cold": start,
            "pixel_straight": straight,
            "pixel_hot": hot,
        }
        points: dict[str, Any] = {
            "incidence_shift_um": d.incidence_shift_um if found else np.full_like(A, np.nan),
            "hot_error_um": d.hot_error_um,
            "measured_minus_real_um": -d.hot_error_um,
            "measured_shift_um": d.measured_shift_um,
            "cold_error_um": d.cold_error_um,
        }
        if self.method == LINE:  # unknown is u, and all world axes that u has a part in
            pixels = {k: np.where([True, False], np.nan, v) for k, v in pixels.items()}
            along_u = np.abs(axes[:, 0]) > _PARALLEL
            points = {k: np.where(along_u, np.nan, v) for k, v in points.items()}
        constant: dict[str, Any] = vars(self.setting) | {"method": self.method}
        return Rays(
            y_mm=self.y_mm,
            **{name: np.full(len(self.y_mm), value) for name, value in constant.items()},
            search_distance_um=self.search_distance_um,
            cold_error_image_um=points["cold_error_um"] @ axes[:, :2],
            **pixels,
            **points,
        )


BySetting = Mapping[tuple[Setting, str], Curve]
"""Curves by their setting and method."""


def together(parts: Iterable[Rays]) -> Rays:
    """Rays of several curves, one after the other."""
    parts = list(parts)
    columns = {f.name: np.concatenate([getattr(p, f.name) for p in parts]) for f in fields(Rays)}
    return Rays(**columns)


def near(curve: Curve, y_mm: float) -> Curve:
    """The one ray of a curve that is next to a position."""
    place = int(np.argmin(np.abs(curve.y_mm - y_mm)))
    arrays: dict[str, Any] = {
        k: v[place : place + 1] for k, v in vars(curve).items() if isinstance(v, np.ndarray)
    }
    return replace(curve, **arrays)


def searched(
    scene: Scene, setting: Setting, y_mm: Array, march: March = REFERENCE, paper: bool = True
) -> Curve:
    """A curve by Newton's search; with h_d_min of the paper's own, if asked for."""
    cold = ray_search(scene.cold(), y_mm, "newton", march=march)
    hot = ray_search(scene, y_mm, "newton", march=march)
    distance = ray_search(scene, y_mm, "paper", march=march).distance_um if paper else None
    return Curve(
        setting,
        SEARCHED,
        scene.sensor,
        np.asarray(y_mm, float),
        cold.laser_point_mm,
        hot.laser_point_mm,
        cold.pixel,
        hot.pixel,
        np.full(len(y_mm), np.nan) if distance is None else distance,
    )


def from_dots(curve: Curve, folder: Path) -> Curve:
    """The curve with its pixels from a measurement's rendered dots, which are at the same y."""
    pixels = []
    for state in ("cold", "hot"):
        dots = read_columns(folder / f"dots_{state}.csv")
        pixels.append(np.stack([dots["pixel_u"], dots["pixel_v"]], axis=1).astype(float))
    return _rendered(curve, DOTS, *pixels)


def from_line(curve: Curve, folder: Path) -> Curve:
    """The curve with v from a measurement's rendered line, at the u that the search gives.

    So u has the search's displacement: what can be compared is across the line only.
    """
    pixels = []
    for state, pixel in (("cold", curve.pixel_cold), ("hot", curve.pixel_hot)):
        line = read_columns(folder / f"line_{state}.csv")
        good = np.isin(line["status"], FOUND_NAMES)
        column, row = line["column_px"][good].astype(float), line["row_px"][good].astype(float)
        inside = (pixel[:, 0] >= column[0]) & (pixel[:, 0] <= column[-1])
        v = np.where(inside, CubicSpline(column, row)(pixel[:, 0]), np.nan)
        pixels.append(np.stack([pixel[:, 0], v], axis=1))
    return _rendered(curve, LINE, *pixels)


def _rendered(curve: Curve, method: str, pixel_cold: Array, pixel_hot: Array) -> Curve:
    unknown = np.full(len(curve.y_mm), np.nan)
    return replace(
        curve, method=method, pixel_cold=pixel_cold, pixel_hot=pixel_hot, search_distance_um=unknown
    )


def read_columns(path: Path) -> dict[str, NDArray[Any]]:
    """Columns of a CSV file by name: numbers where all are, else text; NaN where empty."""
    with path.open(encoding="utf-8", newline="") as file:
        names, *rows = csv.reader(file)
    columns: dict[str, NDArray[Any]] = {}
    for name, cells in zip(names, zip(*rows, strict=True), strict=True):
        try:
            columns[name] = np.array([float(cell) if cell else np.nan for cell in cells])
        except ValueError:
            columns[name] = np.array(cells)
    return columns


@dataclass(frozen=True)
class Curves(Displayed):
    """All curves of the reproduction, by setting and method.

    Attributes
    ----------
    nine : dict
        The paper's nine rays.
    whole : dict
        The whole line on both sides, searched.
    poses : dict
        The same at the highest temperature, from all poses between above and the side.
    """

    nine: BySetting
    whole: BySetting = field(default_factory=dict)
    poses: BySetting = field(default_factory=dict)
