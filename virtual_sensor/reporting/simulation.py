"""How a simulation of the air ended, in a few lines."""

import numpy as np

from virtual_sensor.studies.simulate import Simulation


def outcome(result: Simulation) -> list[str]:
    """When it ended, and how sound it is: heat balance, Nusselt number, wall layer."""
    end = f"ended at {result.end.time_s:g} s of flow"
    if np.isfinite(result.drift_px_per_s):
        end += f", when the probe rays moved by {result.drift_px_per_s:.2g} px per s of flow"
    balance = result.balance
    lines = [
        end,
        f"heat: {balance.wall_w:.4g} W given off, {balance.outflow_w:.4g} W carried out"
        f" ({balance.mismatch:+.1%})",
    ]
    if np.isfinite(result.nusselt):
        lines.append(f"mean Nusselt number {result.nusselt:.3g}, by air of film temperature")
    return [*lines, f"cells in the wall layer: {result.wall_layer_cells}"]
