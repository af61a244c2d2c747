"""A first look at a hot part's air within a minute or two, and what it costs in accuracy.

The mesh has so few cells, and the flow so little time, that a sensor's correction has the right
size and shape and no more; `docs/how_to/own_air.md` compares it with finer runs.
"""

from __future__ import annotations

import math
from dataclasses import replace

from virtual_sensor.errors import InputError
from virtual_sensor.medium.heat_flow.mesh import cylinder_mesh
from virtual_sensor.medium.heat_flow.setup import HeatFlow
from virtual_sensor.medium.heat_flow.snapped_mesh import Part, expected_cells, snapped_mesh

CELLS = 45_000
"""Of a first look's mesh."""

_WIDEST_MM, _FINEST_MM = 16.0, 0.05
_STEP = 1.03
_MOST_CELLS = 500_000
_OF_RADIUS = 0.09  # of a section's cylinder: six cells in the wall layer of 1250 degC
_OF_THICKNESS = 1.5  # of a thin part's: the cells at its wall are half as wide
QUICK_HEIGHT_MM = 360.0
_FLOW_S, _HOT_K = 2.0, 880.0  # in that time a plume so hot and so high stands


def quick_cell_mm(flow: HeatFlow, part: Part | None) -> float:
    """Width of cells across the plume, mm: as fine as `CELLS` allow; finer for a thin part.

    Raises
    ------
    InputError
        If the part is so thin that the look would take hours.
    """

    def cells(width: float) -> float:
        if part is None:
            return float(cylinder_mesh(replace(flow, cell_mm=width)).cells)
        return expected_cells(part, snapped_mesh(part, width, flow.light_mm[2], most=math.inf))

    if flow.section:
        return float(f"{_OF_RADIUS * flow.radius_mm:.2g}")
    width = _WIDEST_MM if part else min(flow.radius_mm / 4.0, _WIDEST_MM / 4.0)
    while width > _FINEST_MM and cells(width / _STEP) < CELLS:
        width /= _STEP
    if part:
        width = min(width, _OF_THICKNESS * part.thickness_mm)
        if (expected := cells(width)) > _MOST_CELLS:
            raise InputError(
                f"walls of some {part.thickness_mm:.2g} mm need narrow cells, about"
                f" {expected / 1e6:.1f} million: no quick look. For the air alone a thicker part"
                " does (--stl thick.stl beside --scene), or give --cell"
            )
    return float(f"{width:.2g}")


def quick_time_s(flow: HeatFlow, height_mm: float = QUICK_HEIGHT_MM) -> float:
    """Flow time, s, in which the plume of a part comes to stand, `height_mm` of air high.

    The air's speed goes with the root of height and difference of temperature.
    """
    slower = math.sqrt(height_mm / QUICK_HEIGHT_MM * _HOT_K / (flow.wall_k - flow.ambient_k))
    return float(f"{_FLOW_S * slower:.2g}")
