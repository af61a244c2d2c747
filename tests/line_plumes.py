"""The plume over a cylinder: its centre, its width, and how they change with height.

A steady laminar line plume is similar to itself at all heights x over a virtual origin, with the
excess temperature on its centre line going as x^(-3/5), the velocity as x^(1/5) and the width as
x^(2/5) [1]_. Of a gas much hotter than its surroundings this holds if the width is counted in mass,
dY = rho/rho_ambient dy, and density times viscosity is the same everywhere: in Y the equations are
then those of constant density. In y the plume is wider where it is hotter. Air's density times
viscosity falls by a third from 20 to 700 degC, so that some deviation remains.

References
----------
.. [1] B. Gebhart, L. Pera, A. W. Schorr, "Steady laminar natural convection plumes above a
   horizontal line heat source", Int. J. Heat Mass Transfer 13, 161-171 (1970).
"""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path

import numpy as np
from numpy.typing import NDArray
from scipy.interpolate import CubicSpline

from virtual_sensor.errors import InputError
from virtual_sensor.medium.heat_flow.setup import HeatFlow
from virtual_sensor.medium.imports.meshes import read_openfoam
from virtual_sensor.medium.imports.sources import Mesh, split_units

Array = NDArray[np.float64]

SIMILARITY = {"temperature": -0.6, "velocity": 0.2, "width": 0.4}
"""Exponents of height of a line plume."""

_FINE = 2000  # points of a row in which its half width is searched
_LAYER_MM = 1e-3


@dataclass(frozen=True)
class Plume:
    """The plume in the middle of a cylinder; shapes (n,), by ascending height.

    Attributes
    ----------
    height_mm : ndarray
        Above the cylinder's top, mm.
    excess_k : ndarray
        Temperature of the centre over the surroundings', K.
    velocity : ndarray
        Upwards, in the centre, m/s.
    half_width_mm : ndarray
        Distance from the centre at which half of `excess_k` is left, mm.
    mass_width_mm : ndarray
        The same, of the air in between had it the surroundings' density, mm.
    """

    height_mm: Array
    excess_k: Array
    velocity: Array
    half_width_mm: Array
    mass_width_mm: Array


def plume(flow: HeatFlow, case: Path, time_s: float | None = None) -> Plume:
    """Read the plume of an instant from the cells over the cylinder, from one radius upwards.

    Parameters
    ----------
    flow : HeatFlow
        What was simulated: a cylinder, in a half or a quarter.
    case : Path
        The OpenFOAM case.
    time_s : float, optional
        A saved flow time, s; the last by default.

    Raises
    ------
    InputError
        If PyVista is missing, or the case has no such time.
    """
    source = read_openfoam(case, time_s)
    if not isinstance(source.geometry, Mesh):
        raise InputError(f"{case}: holds no mesh of cells; run it again")
    data = source.geometry.cells.cell_data
    fields = {split_units(name)[0]: np.asarray(data[name], dtype=np.float64) for name in data}
    centres = 1e3 * np.asarray(source.geometry.cells.cell_centers().points, dtype=np.float64)
    over = (centres[:, 2] > flow.radius_mm) & (centres[:, 0] < centres[:, 0].min() + _LAYER_MM)
    y, z = centres[over, 1], centres[over, 2]
    excess, velocity = fields["T"][over] - flow.ambient_k, fields["U"][over, 2]

    order = np.lexsort((y, z))
    rows = np.split(order, np.flatnonzero(np.diff(z[order]) > _LAYER_MM) + 1)
    found = [
        (z[row].mean(), *_across(flow.ambient_k, y[row], excess[row], velocity[row]))
        for row in rows
    ]
    return Plume(*np.array(found).T)


def _across(
    ambient_k: float, y: Array, excess: Array, velocity: Array
) -> tuple[float, float, float, float]:
    """Centre's excess and velocity, half width and mass width, of one row of cells beside it."""
    both = np.concatenate([-y[::-1], y])
    hot, up = (CubicSpline(both, np.concatenate([f[::-1], f])) for f in (excess, velocity))
    fine = np.linspace(0.0, y[-1], _FINE)
    profile = hot(fine)
    half = int(np.argmax(profile < 0.5 * profile[0]))
    mass = np.trapezoid(ambient_k / (ambient_k + profile[: half + 1]), fine[: half + 1])
    return float(profile[0]), float(up(0.0)), float(fine[half]), float(mass)


def plume_exponents(
    plume: Plume, lowest_mm: float, highest_mm: float
) -> tuple[dict[str, float], float]:
    """Exponents of height over the virtual origin, by least squares in logarithms.

    The virtual origin is where the straight line through (mass width)^(5/2) meets zero, so that
    temperature and velocity, which did not choose it, show whether the plume is similar to itself.

    Parameters
    ----------
    plume : Plume
        As read.
    lowest_mm, highest_mm : float
        Range of heights above the top to fit, mm.

    Returns
    -------
    exponents : dict
        Keys as in `SIMILARITY`.
    origin_mm : float
        Height of the virtual origin above the top, mm.

    Raises
    ------
    InputError
        If fewer than five heights are in the range.
    """
    height = plume.height_mm
    chosen = (height >= lowest_mm) & (height <= highest_mm)
    if chosen.sum() < 5:
        raise InputError(
            f"a plume has {chosen.sum()} rows of cells between {lowest_mm:g} and {highest_mm:g} mm;"
            " an exponent takes five"
        )
    height = height[chosen]
    slope, offset = np.polyfit(height, plume.mass_width_mm[chosen] ** 2.5, 1)
    origin = -offset / slope
    logarithm = np.log(height - origin)
    measured = (plume.excess_k, plume.velocity, plume.mass_width_mm)
    return {
        name: float(np.polyfit(logarithm, np.log(values[chosen]), 1)[0])
        for name, values in zip(SIMILARITY, measured, strict=True)
    }, float(origin)
