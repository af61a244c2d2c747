"""A part that is larger when it is hot: shapes that grow with their temperature.

The `glow` of a shape, which has its ``temperature`` in degC, may have the property ``expansion``,
the shape's linear coefficient of thermal expansion in 1/K, and, if that is not the world's origin,
a point ``fixed_point`` that stays where it is.  What the shape is at 20 degC then becomes, evenly
everywhere,

    1 + expansion (temperature - 20)

times as large.
"""

from __future__ import annotations

from typing import Any

import numpy as np

from virtual_sensor.engine import mi
from virtual_sensor.errors import InputError

COLD_C = 20.0
"""Of the part as its drawing has it."""
_MOST_PER_K = 1e-3  # ten times what any metal has


def growth(expansion_per_k: float, temperature_c: float) -> float:
    """Factor of a length from 20 degC to a temperature."""
    return 1.0 + expansion_per_k * (temperature_c - COLD_C)


def grow(shape: Any, glow: Any, where: str) -> str:
    """Put a shape's expansion into its `to_world`, and give a note of it; "" without one.

    Parameters
    ----------
    shape, glow
        Mitsuba's nodes, as they were parsed.
    where : str
        The glow stands in its file, for messages.

    Raises
    ------
    InputError
        If the coefficient is one that nothing has.
    """
    props, of_glow = shape.props, glow.props
    if "expansion" not in of_glow or "temperature" not in of_glow:
        return ""
    per_k, temperature_c = float(of_glow["expansion"]), float(of_glow["temperature"])
    fixed = np.array(of_glow.get("fixed_point", [0.0, 0.0, 0.0]), float)
    if not abs(per_k) <= _MOST_PER_K:
        raise InputError(
            f"{where}: an expansion of {per_k:g} 1/K; steel has 12e-6, nothing more than"
            f" {_MOST_PER_K:g}"
        )
    factor = growth(per_k, temperature_c)
    if factor == 1.0:
        return ""
    larger = np.diag([factor, factor, factor, 1.0])
    larger[:3, 3] = fixed * (1.0 - factor)
    if "to_world" in props:
        larger = larger @ np.array(props["to_world"].matrix, float).reshape(4, 4)
        del props["to_world"]
    props["to_world"] = mi.ScalarAffineTransform4d(larger)
    about = ", ".join(f"{x:g}" for x in fixed)
    return (
        f"parts of {temperature_c:g} degC are {100.0 * (factor - 1.0):.4g} % larger than at"
        f" {COLD_C:g} degC (expansion {per_k:g} 1/K, about ({about}) mm)"
    )
