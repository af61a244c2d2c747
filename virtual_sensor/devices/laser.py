"""The laser line generator: which rays of a family are lit, and by how much."""

from dataclasses import dataclass, field, replace
from functools import reduce
from operator import add, or_
from typing import Any

import numpy as np
from numpy.typing import ArrayLike, NDArray

from virtual_sensor.arrays import number_for, where
from virtual_sensor.devices.coherence import Coherence
from virtual_sensor.devices.device import irradiance
from virtual_sensor.devices.laser_profile import Focus, Gaussian, Profile, Uniformity
from virtual_sensor.display import Displayed, listed, place
from virtual_sensor.errors import InputError
from virtual_sensor.optics.ray_families import RayFamily
from virtual_sensor.poses import Pose

Array = NDArray[np.float64]


@dataclass(frozen=True)
class LaserLine(Displayed):
    """A laser line, by default Gaussian across and even along; or a row of laser dots.

    Its sizes are in the unit of the family's coordinates: mm of a sheet's reference plane.

    Attributes
    ----------
    family : RayFamily
        Its rays: s across the sheet, t along the line.
    length_mm : float
        Length of the line.
    radius_mm : float
        Distance across the sheet at which the intensity falls to 1/e^2; with a focus, in its waist.
    power_w : float
    dots_mm : ndarray of shape (M,)
        Where the light is a row of round Gaussian beams: their t; empty for a line.
    profile : Profile
        Across the sheet; of dots it is `Gaussian`.
    uniformity : Uniformity or None
        Along the line; None: even.
    focus : Focus or None
        How the sheet's thickness changes with the depth; None: not at all.
    coherence : Coherence
        Of its light from the lit surface: how strong its speckle is, where frames are recorded
        with it.
    """

    family: RayFamily
    length_mm: float
    radius_mm: float
    power_w: float
    dots_mm: Array
    profile: Profile = field(default_factory=Gaussian)
    uniformity: Uniformity | None = None
    focus: Focus | None = None
    coherence: Coherence = field(default_factory=Coherence)

    def __post_init__(self) -> None:
        plain = self.profile == Gaussian() and self.uniformity is None
        if np.size(self.dots_mm) and not plain:
            raise InputError(
                "'dots' are round Gaussian beams; leave out 'profile' and 'uniformity', or 'dots'"
            )

    def _line(self) -> str:
        dots = self.dots_mm.size
        size = f"{dots} dots" if dots else f"{self.length_mm:g} mm long"
        kind = type(self.family).__name__.lower()
        radius = f"radius {self.radius_mm:g} mm"
        start = f"{kind} from {place(self.pose.origin_mm)} mm"
        profile = "" if self.profile == Gaussian() else f"{self.profile}"
        focus = f"waist {self.focus.distance_mm:g} mm from its exit" if self.focus else ""
        return listed(size, radius, profile, focus, f"{self.power_w:g} W", start)

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
        """How far across the sheet, and round a dot, there is light that counts.

        With a focus the farthest up to twice the working distance.
        """
        widest = 1.0
        if self.focus:
            far_mm = 2.0 * getattr(self.family, "distance_mm", self.focus.distance_mm)
            widest = float(np.max(self.focus.widening(np.array([0.0, far_mm]))))
        return self._waist_reach_mm * widest

    @property
    def _waist_reach_mm(self) -> float:
        return self.profile.reach * self.radius_mm

    @property
    def working_radius_mm(self) -> float:
        """The radius where things are measured, in the depth of `target_mm`."""
        return float(self.radius_at(self.target_mm[None])[0])

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

    def reaches(
        self, s: Any, t: Any, margin: tuple[Any, Any] = (0.0, 0.0), depth: Any = None
    ) -> Any:
        """Mask of the coordinates with light that counts, or near it; NaN has none.

        Of NumPy's arrays as of Dr.Jit's.  Without the depth, where there is any at some depth.
        """
        wide = self.reach_mm / self._waist_reach_mm
        if self.focus and depth is not None:
            wide = self.focus.widening(depth)
        return self._reaches(s, t, margin, wide)

    def _reaches(self, s: Any, t: Any, margin: tuple[Any, Any], wide: Any) -> Any:
        """Likewise where the sheet is so many times as wide as in its waist."""
        reach = number_for(s, self._waist_reach_mm) * wide
        if self.dots_mm.size:
            near = reach + margin[1]
            along = reduce(or_, (abs(t - dot) <= near for dot in self.dots_mm.tolist()))
        else:
            along = abs(t) <= number_for(t, self.length_mm / 2.0) + margin[1]
        return along & (abs(s) <= reach + margin[0])

    def flux(self, s: Any, t: Any, depth: Any = None) -> Any:
        """Power per unit of both coordinates: W/mm^2 of a sheet's reference plane.

        Of NumPy's arrays as of Dr.Jit's.  The irradiance square to the light is this over the
        tube's spread and the cosine of the light to the family's axis.  With a focus it depends on
        the depth; without the depth it is that of the waist.
        """
        wide = self.focus.widening(depth) if self.focus and depth is not None else 1.0
        lit, s = self._reaches(s, t, (0.0, 0.0), wide), s / wide
        per_mm = self.profile.peak / self.radius_mm
        if self.dots_mm.size:
            peak = self.power_w / self.dots_mm.size * per_mm**2
            dots = self.dots_mm.tolist()
            along = reduce(add, (self._profile((t - dot) / wide) for dot in dots)) / wide
        else:
            peak, along = self.power_w / self.length_mm * per_mm, 1.0
        light = number_for(s, peak) * self._profile(s) * along
        if self.uniformity:
            light = light * self.uniformity.at(t * number_for(t, 2.0 / self.length_mm))
        return where(lit, light / wide, 0.0)

    def irradiance(self, points_mm: ArrayLike) -> Array:
        """Flux density (N,) square to the straight light at world points (N, 3), W/mm^2."""
        return irradiance(self, points_mm)

    def radius_at(self, points_mm: ArrayLike) -> Array:
        """1/e^2 radius (N,) across the straight sheet at world points (N, 3), mm."""
        coordinates = self.family.coordinates(points_mm)
        x_s, _, y_s, _ = self.family.by_coordinates(*coordinates.T)
        wide = self.focus.widening(coordinates[..., 2]) if self.focus else 1.0
        return self.radius_mm * np.hypot(x_s, y_s) * wide * np.ones(coordinates.shape[:-1])

    def _profile(self, x: Any) -> Any:
        return self.profile.at(x, self.radius_mm)
