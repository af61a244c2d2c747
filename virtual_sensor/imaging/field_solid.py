"""Whether a field of air belongs to the scene's part: its solid is compared with the part."""

from dataclasses import dataclass
from functools import lru_cache
from pathlib import Path

import numpy as np
from numpy.typing import NDArray
from scipy import ndimage

from virtual_sensor.arrays import in_own_memory
from virtual_sensor.engine import dr, mi
from virtual_sensor.errors import InputError
from virtual_sensor.imaging.scene import Scene
from virtual_sensor.medium.netcdf import read_field_file

Array = NDArray[np.float64]

NOTED, REFUSED = 0.1, 0.5
"""Share of the field's solid that lies outside the part: noted from, and refused from."""

_CELLS_FAR = 3.0  # diagonals of a cell from the field's solid: there the part stands in the open
_MOST_NODES = 20_000


@dataclass(frozen=True)
class _Solid:
    """The solid of a field's file, in the field's frame.

    `nodes_mm` (N, 3) are some of its nodes, those next to the air left out; `away_mm` (nx, ny, nz)
    is each node's distance to the solid; `cell_mm` the diagonal of a cell.
    """

    nodes_mm: Array
    away_mm: NDArray[np.float32]
    origin_mm: Array
    spacing_mm: Array
    mirror: tuple[bool, ...]

    @property
    def cell_mm(self) -> float:
        return float(np.linalg.norm(self.spacing_mm))

    def away_from(self, points_mm: Array) -> Array:
        """Distance of points (N, 3) to the solid, mm; NaN outside the field."""
        from_origin = points_mm - self.origin_mm
        index = np.rint(np.where(self.mirror, np.abs(from_origin), from_origin) / self.spacing_mm)
        inside = np.all((index >= 0) & (index < self.away_mm.shape), axis=1)
        away = np.full(len(index), np.nan)
        away[inside] = self.away_mm[tuple(index[inside].astype(int).T)]
        return away


def check_solid(scene: Scene, lit_mm: Array) -> list[str]:
    """Compare the solid in a scene's field file with the part; `lit_mm` (N, 3) is lit on it.

    Returns
    -------
    list of str
        A note, if the two differ by far; none where the file marks no solid.

    Raises
    ------
    InputError
        If they have little in common.
    """
    file, field = scene.air.path, scene.medium
    if file is None or field is None:
        return []
    solid = _solid_of(file, file.stat().st_mtime_ns)
    if solid is None:
        return []
    name = f'<integrator type="refractive">: the field {file.name}'
    share = float(np.mean(_in_front(scene, field.to_world(solid.nodes_mm), solid.cell_mm)))
    if share > NOTED:
        text = f"{name} is not of this part: {share:.0%} of its solid lies outside the part"
        if share > REFUSED:
            raise InputError(f"{text}; give a field of this part, or none")
        return [f"{text}, where the air is made up"]
    away = solid.away_from(field.to_local(lit_mm))
    if not np.nanmedian(away) > solid.cell_mm:
        return []
    text = (
        f"{name} is not of this part: the laser's line lies {np.nanmedian(away):.2g} mm from its"
        " solid"
    )
    if np.nanmedian(away) > _CELLS_FAR * solid.cell_mm:
        raise InputError(f"{text}; give a field of this part, or none")
    return [text]


def _in_front(scene: Scene, nodes_mm: Array, cell_mm: float) -> NDArray[np.bool_]:
    """Which nodes (N, 3) of the solid are not behind the part's surface, as the sensor sees it."""
    sensor = scene.sensor
    up = -sensor.camera.pose.rotation[:, 2] - sensor.laser.pose.rotation[:, 2]
    up = up / np.linalg.norm(up)
    origin = mi.Point3f(*(in_own_memory(column, mi.Float) for column in nodes_mm.T))
    direction = [dr.opaque(mi.Float, float(x), len(nodes_mm)) for x in up]
    covered = scene.mitsuba.ray_test(mi.Ray3f(origin, mi.Vector3f(*direction)))
    below = mi.Ray3f(origin, mi.Vector3f(*(-x for x in direction)))
    below.maxt = dr.opaque(mi.Float, cell_mm, len(nodes_mm))
    near = scene.mitsuba.ray_test(below)
    return ~(covered | near).numpy().astype(bool)


@lru_cache(maxsize=4)
def _solid_of(file: Path, modified: int) -> _Solid | None:
    """The solid that a field's file marks; None if it marks none."""
    air = read_field_file(file, 532.0)
    if air.solid is None or not air.solid.any():
        return None
    even = [(1, 0) if mirror else (0, 0) for mirror in air.mirror]
    core = ndimage.binary_erosion(np.pad(air.solid, even, mode="reflect"), border_value=1)
    core = core[tuple(slice(first, None) for first, _ in even)]
    index = np.argwhere(core if core.any() else air.solid)
    index = index[:: -(-len(index) // _MOST_NODES)]
    away = ndimage.distance_transform_edt(~air.solid, sampling=air.spacing_mm)
    return _Solid(
        air.origin_mm + index * air.spacing_mm,
        away.astype(np.float32),
        air.origin_mm,
        air.spacing_mm,
        air.mirror,
    )
