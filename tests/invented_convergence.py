"""A convergence study whose outcome is known."""

from itertools import product

from virtual_sensor.studies.convergence import Change, Convergence, Setting
from virtual_sensor.studies.provenance import MadeWith

CELLS, TIMES, GRIDS = (2.0, 0.8), (1.0, 4.0), ((1.5, 2.5), (0.5, 1.25))
MADE = MadeWith("3.11", "0.5", "2", "5", "llvm_ad_mono", None, 2, "3.9", "1.5")


def invented():
    """A study in which every step back costs a known error and saves a known time."""
    changes = []
    for cell, time_s, grid in product(CELLS, TIMES, GRIDS):
        error = 0.3 * (cell > 1.0) + 0.05 * (time_s < 2.0) + 0.01 * (grid[0] > 1.0)
        seconds = time_s / cell**2
        figures = (
            error,
            error / 2,
            error,
            20 * error,
            8 * error,
            16 * error,
            seconds,
            9,
            1 / grid[0],
        )
        changes.append(Change(cell, time_s, *grid, *figures))
    longer = Change(2.0, 15.0, *GRIDS[-1], 0.001, 0.001, 0.001, 0.01, 0.004, 0.008, 9.0, 9, 2.0)
    finest = Setting(CELLS[-1], TIMES[-1], *GRIDS[-1])
    return Convergence(1250.0, finest, longer, MADE, (), tuple(changes))
