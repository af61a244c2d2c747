"""Laser rays that stand for a scene: a study reports by how much hot air moves them."""

import numpy as np
from numpy.typing import ArrayLike, NDArray

from virtual_sensor.errors import InputError
from virtual_sensor.imaging.scene import Scene
from virtual_sensor.optics.ray_search import SearchStatus, ray_search

PROBES = 9
"""Probe rays along a line."""

DENSE_RAYS = 401
"""Rays of the search that a rendered line is compared with."""

_BESIDE = 0.1  # of what is seen, on either side: hot air may show more of it

Array = NDArray[np.float64]


def probe_rays(scene: Scene, y_mm: ArrayLike | None = None) -> Array:
    """Positions y (N,) in mm of a scene's probe rays.

    By default the laser's dots; of a line, `PROBES` rays that the camera sees on the cold part,
    evenly spread over all that it sees. Otherwise `y_mm`, as given.

    Raises
    ------
    InputError
        If a number is not finite.
    """
    if y_mm is not None:
        y = np.atleast_1d(np.asarray(y_mm, float))
        if not np.isfinite(y).all():
            raise InputError(f"the rays' y are {y.tolist()}; give finite numbers in mm")
        return y
    dots = scene.sensor.laser.dots_mm
    if dots.size:
        return dots
    y = dense_rays(scene)
    seen = y[_seen(scene, y)]
    some = seen if seen.size else y
    middles = (np.arange(PROBES) + 0.5) / PROBES * some.size
    return some[np.unique(middles.astype(int))]


def dense_rays(scene: Scene) -> Array:
    """Positions y (N,) of `DENSE_RAYS` rays along what is seen of the line on the cold part, mm.

    Spread over a line that is much longer than the part they would lie too far apart.
    """
    ends = np.array([-0.5, 0.5]) * scene.sensor.laser.length_mm
    while True:
        y = np.linspace(ends[0], ends[1], DENSE_RAYS)
        seen = y[_seen(scene, y)]
        margin = _BESIDE * np.ptp(seen) if seen.size > 1 else 0.0
        closer = np.clip([seen.min() - margin, seen.max() + margin], *ends) if margin else ends
        if np.ptp(closer) > 0.5 * np.ptp(ends):
            return y
        ends = closer


def _seen(scene: Scene, y: Array) -> NDArray[np.bool_]:
    """Which rays the camera sees on the cold part."""
    return ray_search(scene.cold(), y, "newton").status == SearchStatus.FOUND
