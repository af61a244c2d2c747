"""The laser line generator: which rays of a family are lit, and by how much."""

import math
from dataclasses import dataclass, replace
from functools import reduce
from operator import add, or_
from typing import Any

import numpy as np
from numpy.typing import ArrayLike, NDArray

from virtual_sensor.arrays import exp, number_for, where
from virtual_sensor.devices.device import irradiance
from virtual_sensor.display import Displayed, listed, place
from virtual_sensor.optics.ray_families import RayFamily
from virtual_sensor.poses import Pose

Array = NDArray[np.float64]

_FAINT = 1e-6  # light below this fraction of the peak is taken as none: 2.6 radii out
_REACH = float(np.sqrt(-np.log(_FAINT) / 2.0))  # the same in 1/e^2 radii


@dataclass(frozen=True)
class LaserLine(Displayed):
    """A laser line whose intensity is Gaussian across and even along; or a row of laser dots.

    Its sizes are in the unit of the family's coordinates: mm of a sheet's reference plane.

    Attributes
    ----------
    family : RayFamily
        Its rays: s across the sheet, t along the line.
    length_mm : float
        Length of the line.
    radius_mm : float
        Distance across the sheet at which the intensity falls to 1/e^2.
    power_w : float
    dots_mm : ndarray of shape (M,)
        Where the light is a row of round Gaussian beams: their t; empty for a line.
    """

    family: RayFamily
    length_mm: float
    radius_mm: float
    power_w: float
    dots_mm: Array

    def _line(self) -> str:
        dots = self.dots_mm.size
        size = f"{dots} dots" if dots else f"{self.length_mm:g} mm long"
        kind = type(self.family).__name__.lower()
        radius = f"radius {self.radius_mm:g} mm"
        start = f"{kind} from {place(self.pose.origin_mm)} mm"
        return listed(size, radius, f"{self.power_w:g} W", start)

    @property
    def pose(self) -> Pose:
        """Of the generator's exit."""
        return self.family.pose

    def with_pose(self, pose: Pose) -> "LaserLine":
        """The same in another place."""
        return replace(self, family=self.family.with_pose(pose))

    @property
    def plane(self) -> tuple[Array, float]:
        """Unit normal (3,) and offset of the plane of its middle rays: normal . x = offset."""
        normal, offset = self.family.plane(0.0)
        return normal, float(offset)

    @property
    def target_mm(self) -> Array:
        """About where things are measured: the middle ray's point nearest to the world's origin."""
        origin, direction = self.family.rays(0.0, 0.0)
        return origin - (origin @ direction) * direction

    @property
    def reach_mm(self) -> float:
        """How far across the sheet, and round a dot, there is light that counts."""
        return _REACH * self.radius_mm

    @property
    def extent(self) -> tuple[Array, Array]:
        """Lowest and highest (s, t) with light that counts, each of shape (2,)."""
        ends = np.array([-0.5, 0.5]) * self.length_mm
        if self.dots_mm.size:
            ends = np.array([self.dots_mm.min(), self.dots_mm.max()])
            ends += [-self.reach_mm, self.reach_mm]
        return np.array([-self.reach_mm, ends[0]]), np.array([self.reach_mm, ends[1]])

    def along(self, count: int) -> Array:
        """The t of rays in the middle of the sheet: of the dots, or of `count` over the line."""
        if self.dots_mm.size:
            return self.dots_mm
        return np.linspace(-0.5, 0.5, count) * self.length_mm

    def reaches(self, s: Any, t: Any, margin: tuple[Any, Any] = (0.0, 0.0)) -> Any:
        """Mask of the coordinates with light that counts, or near it; NaN has none.

        Of NumPy's arrays as of Dr.Jit's.
        """
        reach = number_for(s, self.reach_mm)
        if self.dots_mm.size:
            near = reach + margin[1]
            along = reduce(or_, (abs(t - dot) <= near for dot in self.dots_mm.tolist()))
        else:
            along = abs(t) <= number_for(t, self.length_mm / 2.0) + margin[1]
        return along & (abs(s) <= reach + margin[0])

    def flux(self, s: Any, t: Any) -> Any:
        """Power per unit of both coordinates: W/mm^2 of a sheet's reference plane.

        Of NumPy's arrays as of Dr.Jit's.  The irradiance square to the light is this over the
        tube's spread and the cosine of the light to the family's axis.
        """
        per_mm = math.sqrt(2.0 / math.pi) / self.radius_mm
        if self.dots_mm.size:
            peak = self.power_w / self.dots_mm.size * per_mm**2
            along = reduce(add, (self._profile(t - dot) for dot in self.dots_mm.tolist()))
        else:
            peak, along = self.power_w / self.length_mm * per_mm, 1.0
        light = number_for(s, peak) * self._profile(s) * along
        return where(self.reaches(s, t), light, 0.0)

    def irradiance(self, points_mm: ArrayLike) -> Array:
        """Flux density (N,) square to the straight light at world points (N, 3), W/mm^2."""
        return irradiance(self, points_mm)

    def radius_at(self, points_mm: ArrayLike) -> Array:
        """1/e^2 radius (N,) across the straight sheet at world points (N, 3), mm."""
        x_s, _, y_s, _ = self.family.by_coordinates(*self.family.coordinates(points_mm).T)
        return self.radius_mm * np.hypot(x_s, y_s)

    def _profile(self, x: Any) -> Any:
        return exp(number_for(x, -2.0 / self.radius_mm**2) * (x * x))
