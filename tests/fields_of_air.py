"""Air whose effect on light is known, as fields and as what field files hold."""

import numpy as np

from virtual_sensor.medium.index_field import IndexField
from virtual_sensor.medium.netcdf import GriddedQuantity

AMBIENT = 2.7e-4
LOW, HIGH = np.array([-120.0, -48.0, -36.0]), np.array([120.0, 48.0, 300.0])


def air(nodes, difference, low=LOW, high=HIGH, mirror=(False, False, False)):
    """Field of AMBIENT + difference(x, y, z) on so many nodes between two corners."""
    axes = [np.linspace(*ends) for ends in zip(low, high, nodes, strict=True)]
    x, y, z = np.meshgrid(*axes, indexing="ij")
    values = AMBIENT + difference(x, y, z) * np.ones(x.shape)
    spacing = (np.array(high) - low) / (np.array(nodes) - 1)
    return IndexField.from_arrays(values, low, spacing, ambient=AMBIENT, mirror=mirror)


def warm_sheet(x, y, z, half_width=12.0):
    """Air above the cylinder that is warm near y = 0 and fades towards all borders but below."""
    window = np.cos(0.5 * np.pi * x / 120.0) ** 2 * np.cos(0.5 * np.pi * (z + 36.0) / 336.0) ** 2
    return -5e-5 * window * np.exp(-np.log(2.0) * (y / half_width) ** 2)


def swaying_quantity():
    """Air of 300 K, at two instants 350 and 450 K in its middle; a quarter, by two mirrors."""
    values = np.full((2, 5, 6, 7), 300.0)
    values[0, :2, :2, 3], values[1, :2, :2, 3] = 350.0, 450.0
    return GriddedQuantity(
        kind="temperature",
        values=values,
        origin_mm=np.array([0.0, 0.0, -30.0]),
        spacing_mm=np.array([30.0, 10.0, 50.0]),
        time_s=np.array([2.0, 3.0]),
        ambient={"ambient_temperature": 300.0},
        mirror=(True, True, False),
        attributes={"title": "Air that sways", "history": "made for a test"},
    )
