"""The ray search alone, without any image."""

from collections.abc import Callable
from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import ArrayLike, NDArray

from virtual_sensor.display import Displayed
from virtual_sensor.imaging.checks import check_scene
from virtual_sensor.imaging.scene import Scene
from virtual_sensor.metrology.triangulation import triangulate
from virtual_sensor.optics.ray_search import METHODS as METHODS
from virtual_sensor.optics.ray_search import SearchStatus, ray_search
from virtual_sensor.records import Table, status_names
from virtual_sensor.studies.probes import probe_rays

Array = NDArray[np.float64]


@dataclass(frozen=True)
class SearchTable(Table):
    """Laser rays and the pixels that see their light, a row for each ray.

    Attributes
    ----------
    y_mm : ndarray of shape (N,)
        The ray's position along the line.
    laser_point_mm : ndarray of shape (N, 3)
        Where it meets the part, world.
    pixel : ndarray of shape (N, 2)
        The pixel that sees this point, px.
    measured_point_mm : ndarray of shape (N, 3)
        Measured from that pixel by triangulation, world.
    distance_um : ndarray of shape (N,)
        From the point that the pixel sees to the one that is lit, parallel to the sensor.
    marches : ndarray of shape (N,)
        Marches of the camera's ray that were spent.
    status : ndarray of str of shape (N,)
        How the search ended.
    """

    y_mm: Array
    laser_point_mm: Array
    pixel: Array
    measured_point_mm: Array
    distance_um: Array
    marches: NDArray[np.int64]
    status: NDArray[np.str_]


@dataclass(frozen=True)
class Search(Displayed):
    """What was searched for.

    Attributes
    ----------
    rays : SearchTable
    notes : tuple of str
        What the user should know of the scene.
    """

    rays: SearchTable
    notes: tuple[str, ...]

    def _line(self) -> str:
        return f"{self.found} of {len(self.rays)} found"

    def _columns(self) -> dict[str, NDArray[Any]]:
        return self.rays.columns()

    @property
    def found(self) -> int:
        """How many rays have a pixel that is good."""
        return int(np.sum(self.rays.status == "found"))


def search(
    scene: Scene,
    method: str,
    y_mm: ArrayLike | None = None,
    rays: int | None = None,
    report: Callable[[str, float], None] = lambda stage, fraction: None,
) -> Search:
    """Search the pixels of laser rays at y_mm, of so many along the line, or of the probe rays.

    `report` is called with what is being done, and the fraction of the whole that is done.

    Raises
    ------
    InputError
        If a number is not finite, or the scene can't be measured (see `imaging.checks`).
    """
    sensor = scene.sensor
    if rays:
        y_mm = np.linspace(-0.5, 0.5, rays) * sensor.laser.length_mm
    report("checking the scene", 0.0)
    notes = (*scene.loading_notes, *check_scene(scene))
    y = probe_rays(scene, y_mm)
    found = ray_search(
        scene, y, method, progress=lambda part: report("searching, ray by ray", 0.1 + 0.9 * part)
    )
    table = SearchTable(
        y_mm=y,
        laser_point_mm=found.laser_point_mm,
        pixel=found.pixel,
        measured_point_mm=triangulate(sensor, found.pixel),
        distance_um=found.distance_um,
        marches=found.iterations,
        status=status_names(found.status, SearchStatus),
    )
    result = Search(table, notes)
    if not y.size or result.found:
        return result
    statuses = ", ".join(sorted(set(table.status)))
    return Search(table, (*notes, f"no ray was found: {statuses}"))
