r"""Is the heat right? Nusselt number, heat balance, and cells in the layer of air at the wall.

The simulated air: Sutherland's viscosity, Eucken's conductivity in its modified form, a constant
heat capacity. Its Prandtl number is 0.690 at every temperature.

The mean Nusselt number of a long horizontal cylinder in still air is correlated by [1]_, for one
beta (T_wall - T_ambient). A gas several times hotter than its surroundings needs a rule for beta:
[2]_ solved a gas's boundary layer as it is, and found that of constant properties again with those
at film temperature and **beta = 1/T_ambient**. The usual 1/T_film is as good for small differences,
but makes Nu 20 to 25 % too small at 900 to 1250 degC.

References
----------
.. [1] T. H. Kuehn, R. J. Goldstein, "Correlating equations for natural convection heat transfer
   between horizontal circular cylinders", Int. J. Heat Mass Transfer 19, 1127-1134 (1976).
.. [2] E. M. Sparrow, J. L. Gregg, "The variable fluid-property problem in free convection",
   Trans. ASME 80, 879-886 (1958).
"""

from __future__ import annotations

import math
from dataclasses import dataclass, replace
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from virtual_sensor.display import Displayed
from virtual_sensor.errors import InputError
from virtual_sensor.medium.heat_flow.mesh import SECTION_MM, cylinder_mesh
from virtual_sensor.medium.heat_flow.saved import series
from virtual_sensor.medium.heat_flow.setup import (
    CELLS_IN_WALL_LAYER,
    GAS_CONSTANT,
    GRAVITY,
    HEAT_CAPACITY,
    MOLAR_MASS,
    SUTHERLAND_A,
    SUTHERLAND_T,
    HeatFlow,
)
from virtual_sensor.medium.heat_flow.snapped_mesh import read_part, wall_faces_mm

_SPECIFIC_R = GAS_CONSTANT / MOLAR_MASS  # J/(kg K)
_EUCKEN = (HEAT_CAPACITY - _SPECIFIC_R) * 1.32 + 1.77 * _SPECIFIC_R  # J/(kg K), OpenFOAM's

PRANDTL = HEAT_CAPACITY / _EUCKEN
"""Of the simulated air, at every temperature."""


def viscosity(temperature_k: float) -> float:
    """Dynamic viscosity of the simulated air, Pa s."""
    return SUTHERLAND_A * temperature_k**1.5 / (temperature_k + SUTHERLAND_T)


def conductivity(temperature_k: float) -> float:
    """Thermal conductivity of the simulated air, W/(m K)."""
    return viscosity(temperature_k) * _EUCKEN


def rayleigh_number(flow: HeatFlow, expansion_per_k: float | None = None) -> float:
    """Rayleigh number on the diameter, with properties at film temperature.

    Parameters
    ----------
    flow : HeatFlow
        The cylinder and its air.
    expansion_per_k : float, optional
        Coefficient of expansion beta, 1/K; by default 1/T_ambient.
    """
    nu = viscosity(flow.film_k) / flow.density(flow.film_k)
    beta = expansion_per_k or 1.0 / flow.ambient_k
    diameter = 2e-3 * flow.radius_mm
    return GRAVITY * beta * (flow.wall_k - flow.ambient_k) * diameter**3 * PRANDTL / nu**2


def kuehn_goldstein(rayleigh: float, prandtl: float = PRANDTL) -> float:
    """Mean Nusselt number of a long isothermal horizontal cylinder, after Kuehn and Goldstein 1976.

    Parameters
    ----------
    rayleigh, prandtl : float
        On the diameter.
    """
    laminar = 0.518 * rayleigh**0.25 * (1.0 + (0.559 / prandtl) ** 0.6) ** (-5.0 / 12.0)
    turbulent = 0.1 * rayleigh ** (1.0 / 3.0)
    return 2.0 / math.log1p(2.0 / (laminar**15 + turbulent**15) ** (1.0 / 15.0))


def nusselt_number(flow: HeatFlow, wall_w: float) -> float:
    """Mean Nusselt number of the cylinder's simulated part, end face included.

    Parameters
    ----------
    flow : HeatFlow
        What was simulated.
    wall_w : float
        Heat that the simulated part gives off, W.

    Returns
    -------
    float
        Of the diameter and the conductivity at film temperature.
    """
    R, half = 1e-3 * flow.radius_mm, 1e-3 * flow.length_mm / 2.0
    around = math.pi * R * (2.0 if flow.whole else 1.0)
    area = around * 1e-3 * SECTION_MM if flow.section else around * (half + R / 2.0)
    per_kelvin = wall_w / (area * (flow.wall_k - flow.ambient_k))
    return per_kelvin * 2.0 * R / conductivity(flow.film_k)


@dataclass(frozen=True)
class HeatBalance(Displayed):
    """Heat over the last part of a run.

    Attributes
    ----------
    wall_w : float
        Given off by the simulated part, mean, W.
    outflow_w : float
        Carried out by the air, mean, W. OpenFOAM counts its enthalpy from 0 K, and of that the air
        in the domain stores p V cp/R, whatever its temperature: no change in time is left out.
    change : float
        Largest relative departure of the wall's heat from its mean.
    """

    wall_w: float
    outflow_w: float
    change: float

    @property
    def mismatch(self) -> float:
        """Outflow's excess over the wall's heat, relative."""
        return self.outflow_w / self.wall_w - 1.0


def heat_balance(case: Path, over_s: float) -> HeatBalance:
    """Balance the heat over the last seconds of a run.

    Parameters
    ----------
    case : Path
        Its folder.
    over_s : float
        How long to average, s: several records, and the sway of a 3-D flow.

    Raises
    ------
    InputError
        If the case has fewer than three records in that time.
    """

    def last(name: str, column: str) -> NDArray[np.float64]:
        times, columns = series(case, name)
        return columns[column][times >= times[-1] - over_s]

    wall = last("part", "areaIntegrate(wallHeatFlux)")
    if len(wall) < 3:
        raise InputError(
            f"{case}: {len(wall)} records of heat in the last {over_s:g} s; a mean takes three"
        )
    mean = float(wall.mean())
    out = sum(float(last(side, "weightedSum(h)").mean()) for side in ("top", "open"))
    return HeatBalance(mean, out, float(np.abs(wall / mean - 1.0).max()))


def wall_cells(flow: HeatFlow, nusselt: float | None = None) -> int:
    """Count the cells in the wall layer, D/Nu thick, below the part, where the layer is thinnest.

    A part from an STL file has, roughly, the layer of a cylinder as high as it is.

    Parameters
    ----------
    flow : HeatFlow
        The part, its air and its mesh.
    nusselt : float, optional
        As simulated; before that, what Kuehn and Goldstein expect.
    """
    return _wall_cells(flow, _wall_layer_mm(flow, nusselt))


def check_wall_layer(flow: HeatFlow, nusselt: float | None = None) -> None:
    """Refuse a mesh that does not resolve the layer of hot air at the wall; see `wall_cells`.

    Raises
    ------
    InputError
        If it has fewer than 6 cells there.
    """
    layer_mm = _wall_layer_mm(flow, nusselt)
    cells = _wall_cells(flow, layer_mm)
    if cells >= CELLS_IN_WALL_LAYER:
        return
    width = flow.cell_mm
    while _wall_cells(replace(flow, cell_mm=width), layer_mm) < CELLS_IN_WALL_LAYER:
        width = float(f"{0.95 * width:.2g}")
    raise InputError(
        f"a mesh of {flow.cell_mm:g} mm resolves the wall layer with {cells} cells; at least"
        f" {CELLS_IN_WALL_LAYER} are needed: take {width:g} mm or less, or say --coarse or --quick"
    )


def _wall_layer_mm(flow: HeatFlow, nusselt: float | None) -> float:
    if flow.stl:
        flow = replace(flow, stl=None, radius_mm=read_part(flow.stl).height_mm / 2.0)
    return 2.0 * flow.radius_mm / (nusselt or kuehn_goldstein(rayleigh_number(flow)))


def _wall_cells(flow: HeatFlow, layer_mm: float) -> int:
    faces_mm = wall_faces_mm(flow.cell_mm) if flow.stl else cylinder_mesh(flow).wall_faces_mm
    return int((faces_mm <= layer_mm).sum())
