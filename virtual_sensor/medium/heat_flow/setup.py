"""What is to be simulated: a hot part in still air, and how finely."""

from __future__ import annotations

from dataclasses import dataclass, field
from pathlib import Path

from virtual_sensor.display import Displayed
from virtual_sensor.errors import InputError
from virtual_sensor.medium.units import (
    ATMOSPHERE_PA,
    LEAST_PA,
    MOST_PA,
    PRESSURES,
    ZERO_CELSIUS_K,
)

GAS_CONSTANT = 8.314462618  # J/(mol K)
MOLAR_MASS = 28.9647e-3  # kg/mol, dry air
GRAVITY = 9.81  # m/s^2
HEAT_CAPACITY = 1005.0  # J/(kg K)
SUTHERLAND_A, SUTHERLAND_T = 1.4792e-6, 116.0  # kg/(m s sqrt(K)), K

RAMP_S = 0.25  # in which the wall heats up
MELTED_C, COLDEST_C = 2000.0, -50.0
CELLS_IN_WALL_LAYER = 6
"""Fewer cells than this in the layer of hot air at the wall do not resolve it."""


@dataclass(frozen=True)
class HeatFlow(Displayed):
    """A hot part in still air: natural convection, laminar, with the air's density varying.

    The world frame: x along the cylinder's axis, z up, the origin on its top line.
    A cylinder is simulated in a quarter (x, y >= 0), a `section` in half of the plane across it;
    a part from an STL file as a whole, in the frame of the file.

    Attributes
    ----------
    temperature_c : float
        Of the part's surface, degC; held constant after a ramp of 0.25 s.
    radius_mm : float
        Of the cylinder, mm.
    length_mm : float
        Of the cylinder, mm.
    stl : Path or None
        Surface of another part, mm, z up, in place of a cylinder.
    light_mm : tuple of three float
        Of another part: where light comes down to it, x and y, and the height z up to which the
        air is simulated, mm.
    section : bool
        Only the plane across an endless cylinder: some minutes.
    whole : bool
        A section without its mirror plane, so that the plume may sway; a draught of 2 cm/s across
        it at the start breaks the symmetry.
    unsteady : bool
        Small time steps that follow the flow's own motion, for bursts. Else large implicit ones,
        which damp it and lead to the steady state.
    ambient_c : float
        Of the surrounding air, degC.
    pressure_pa : float
        Of the surrounding air, Pa.
    cell_mm : float
        Width of a mesh cell across the plume, mm; all others scale with it.
    quick : bool
        A first look at the air in a minute or two: wide cells, long steps, little flow time. What
        it does to light is right to some tenths, and wrong where bent paths cancel.
    time_step_s : float or None
        Longest time step, s; None is one that suits parts hotter than the air by hundreds of K.
        Slower flows take longer ones.
    """

    temperature_c: float = field(default=1250.0, metadata={"internal": True})
    radius_mm: float = 13.5
    length_mm: float = 170.0
    stl: Path | None = None
    light_mm: tuple[float, float, float] = field(
        default=(0.0, 0.0, 305.0), metadata={"internal": True}
    )
    section: bool = False
    whole: bool = False
    unsteady: bool = False
    ambient_c: float = 20.0
    pressure_pa: float = ATMOSPHERE_PA
    cell_mm: float = field(default=0.8, metadata={"internal": True})
    quick: bool = False
    time_step_s: float | None = field(default=None, metadata={"internal": True})

    def __post_init__(self) -> None:
        hot, air = self.temperature_c, self.ambient_c
        if not COLDEST_C <= air < hot <= MELTED_C:
            raise InputError(
                f"a part of {hot:g} degC in air of {air:g} degC: the part must be the hotter one,"
                f" and both between {COLDEST_C:g} and {MELTED_C:g} degC"
            )
        if min(self.radius_mm, self.length_mm, self.cell_mm) <= 0.0:
            raise InputError("radius, length and cell width must be positive")
        if not LEAST_PA <= self.pressure_pa <= MOST_PA:
            raise InputError(f"the pressure is {self.pressure_pa:g} Pa; give {PRESSURES}")
        if self.time_step_s is not None and self.time_step_s <= 0.0:
            raise InputError("the time step must be positive")
        if self.stl and (self.section or self.whole):
            raise InputError(
                "a section is one of a cylinder; leave the STL file or the section out"
            )
        if self.quick and self.unsteady:
            raise InputError("a first look damps the flow; leave --quick or --unsteady out")
        if self.whole and not self.section:
            raise InputError("the whole plume, free to sway, is simulated in a section only")

    @property
    def wall_k(self) -> float:
        """Temperature of the part's surface, K."""
        return self.temperature_c + ZERO_CELSIUS_K

    @property
    def ambient_k(self) -> float:
        """Temperature of the surrounding air, K."""
        return self.ambient_c + ZERO_CELSIUS_K

    @property
    def film_k(self) -> float:
        """Mean of wall and surrounding air, K."""
        return (self.wall_k + self.ambient_k) / 2.0

    def density(self, temperature_k: float) -> float:
        """Density of the air as an ideal gas, kg/m^3."""
        return self.pressure_pa * MOLAR_MASS / (GAS_CONSTANT * temperature_k)


@dataclass(frozen=True)
class Until(Displayed):
    """When a simulation ends.

    Attributes
    ----------
    at_most_s, at_least_s : float
        Flow time at which it ends in any case, and before which it does not, s.
    steady_px_per_s : float
        In between it ends once the pixels of the scene's probe rays move by less than this per
        second of flow; 0: it does not.
    """

    at_most_s: float = 15.0
    at_least_s: float = 2.0
    steady_px_per_s: float = 0.05

    def __post_init__(self) -> None:
        if not 0.0 <= self.at_least_s <= self.at_most_s or self.at_most_s == 0.0:
            raise InputError(
                f"--at-least {self.at_least_s:g} s, --time {self.at_most_s:g} s: the first must not"
                " be longer than the second"
            )
