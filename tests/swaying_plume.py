"""The hot cylinder in a plume that sways as a known formula says."""

import numpy as np

from virtual_sensor.imaging.scene import load_scene
from virtual_sensor.medium.netcdf import GriddedQuantity, write_quantity

FILM = {"width": 512, "height": 512, "spp": 4, "line_length": 20}
X, Y, Z = np.arange(-96.0, 97.0, 12.0), np.arange(-24.0, 25.0, 1.5), np.arange(-16.0, 161.0, 8.0)
ORIGIN, SPACING = [-96.0, -24.0, -16.0], [12.0, 1.5, 8.0]
AMPLITUDE_MM = 1.5
STORED_S = np.linspace(4.0, 6.0, 17)


def shift_mm(time_s):
    """Where the plume stands across the cylinder: a sine of 0.8 s."""
    return AMPLITUDE_MM * np.sin(2.0 * np.pi * time_s / 0.8)


def plume_kelvin(centre_mm):
    """Temperature of a plume about y = centre_mm that fades in x, y and z; (nx, ny, nz)."""
    x, y, z = np.meshgrid(X, Y, Z, indexing="ij")
    fading = np.cos(np.pi / 320.0 * np.clip(z, 0.0, 160.0)) ** 2
    across = np.exp(-0.5 * ((y - centre_mm) / 4.0) ** 2)
    return 293.15 + 900.0 * across * np.exp(-((x / 32.0) ** 2)) * fading


def scene_of(path, temperatures, times, **parameters):
    """The hot cylinder in air of these temperatures (nt, nx, ny, nz)."""
    quantity = GriddedQuantity("temperature", temperatures, ORIGIN, SPACING, times)
    write_quantity(path, quantity)
    return load_scene("hot_cylinder", field=path, **FILM, **parameters)


def swaying_scene(path):
    """The scene in the swaying plume, written to a file."""
    return scene_of(path, np.array([plume_kelvin(shift_mm(t)) for t in STORED_S]), STORED_S)
