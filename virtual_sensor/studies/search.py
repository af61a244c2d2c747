"""The ray search alone, without any image."""

from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import ArrayLike

from virtual_sensor.imaging.checks import check_scene
from virtual_sensor.imaging.scene import Scene
from virtual_sensor.metrology.triangulation import triangulate
from virtual_sensor.optics.ray_search import SearchStatus, ray_search
from virtual_sensor.studies.probes import probe_rays
from virtual_sensor.studies.tables import status_names, vectors


@dataclass(frozen=True)
class Search:
    """What was searched for.

    Attributes
    ----------
    columns : dict
        Of a table, one row per ray.
    notes : tuple of str
        What the user should know of the scene.
    """

    columns: dict[str, Any]
    notes: tuple[str, ...]

    @property
    def found(self) -> int:
        """How many rays have a pixel that is good."""
        return int(np.sum(self.columns["status"] == "found"))


def search(
    scene: Scene, method: str, y_mm: ArrayLike | None = None, rays: int | None = None
) -> Search:
    """Search the pixels of laser rays at y_mm, of so many along the line, or of the probe rays.

    Raises
    ------
    InputError
        If a number is not finite, or the scene can't be measured (see `imaging.checks`).
    """
    sensor = scene.sensor
    if rays:
        y_mm = np.linspace(-0.5, 0.5, rays) * sensor.laser.length_mm
    notes = (*scene.notes, *check_scene(scene))
    y = probe_rays(scene, y_mm)
    found = ray_search(scene, y, method)
    columns = {
        "y_mm": y,
        **vectors("laser_point_mm", found.laser_point_mm, "xyz"),
        **vectors("pixel", found.pixel, "uv"),
        **vectors("measured_point_mm", triangulate(sensor, found.pixel), "xyz"),
        "distance_um": found.distance_um,
        "marches": found.iterations,
        "status": status_names(found.status, SearchStatus),
    }
    return Search(columns, notes)
