"""Ray maps are made once while medium, device, march and tolerance stay the same.

A map is of a medium and of where a family's rays run in it: a device and a medium that are moved
together by one rigid motion have the same maps, a device that is moved in still air has others.
What a device shines with, what a camera records with and which part stands there do not count.

A map's box is the one asked for, made larger to a lattice: another part or source near by finds its
place in it.  The device's pose in the medium is rounded to a lattice too, since one that was moved
with it is where it was but for rounding; and the map is made there, in the medium's own frame.  So
a map depends on what is asked and on nothing that was asked before, and frames are equal to the bit
in whatever order they are made.
"""

import threading
import weakref
from collections import OrderedDict
from collections.abc import Callable, Hashable
from dataclasses import dataclass, replace
from typing import Any

import numpy as np
from numpy.typing import NDArray

from virtual_sensor.engine import mi
from virtual_sensor.optics.ray_families import Pose, RayFamily
from virtual_sensor.optics.ray_maps import (
    CausticError,
    ForwardMap,
    InverseMap,
    MapRequest,
    NoMapError,
    RayMap,
    forward_map,
    inverse_map,
)
from virtual_sensor.optics.rays import Field

Array = NDArray[np.float64]

_MOST_BYTES = 512 << 20
_MOST_MAPS = 256  # failures, which take no memory, among them
_LATTICE = np.array([4.0, 4.0, 1.0])  # steps of a box's lattice that it has at least
_POSE_MM, _POSE_TURN = 2.0**-30, 2.0**-38  # the lattice of poses: 1e-9 mm at 300 mm
_PER_OCTAVE = 4.0  # tolerances: the next tighter one is taken
_AT = np.linspace(0.0, 1.0, 4)  # of the box: a family is known by its rays there


@dataclass
class _Entry:
    """A map, or why there is none."""

    medium: Any  # a weak reference, or None
    found: RayMap | NoMapError


class MapCache:
    """Ray maps of a process, bounded in memory; threads may share it.

    Parameters
    ----------
    most_bytes : int
        Of all maps; the one that was used longest ago goes first.
    forward, inverse : callable
        What makes them.
    lattice : ndarray of shape (3,)
        Steps of a box's lattice that the box has at least, halved: fewer make it larger.
    """

    def __init__(
        self,
        most_bytes: int = _MOST_BYTES,
        forward: Callable[[MapRequest], ForwardMap] = forward_map,
        inverse: Callable[[MapRequest], InverseMap] = inverse_map,
        lattice: Array = _LATTICE,
    ) -> None:
        self._most_bytes = most_bytes
        self._forward, self._inverse = forward, inverse
        self._lattice = lattice
        self._entries: OrderedDict[Hashable, _Entry] = OrderedDict()
        self._lock = threading.RLock()

    def forward(self, asked: MapRequest) -> ForwardMap:
        """A map as `forward_map` makes it, of a box that holds the one asked for."""
        found = self._found(self._forward, asked)
        assert isinstance(found, ForwardMap)
        return found

    def inverse(self, asked: MapRequest) -> InverseMap:
        """A map as `inverse_map` makes it, of a box that holds the one asked for."""
        found = self._found(self._inverse, asked)
        assert isinstance(found, InverseMap)
        return found

    @property
    def bytes(self) -> int:
        """Memory of all maps."""
        with self._lock:
            maps = (entry.found for entry in self._entries.values())
            return sum(found.table.bytes for found in maps if isinstance(found, RayMap))

    def clear(self) -> None:
        """Forget all maps."""
        with self._lock:
            self._entries.clear()

    def _found(self, make: Callable[[MapRequest], RayMap], asked: MapRequest) -> RayMap:
        """The map of the roomier box; where there is none, that of the box itself."""
        # A pixel's size on the part changes a little with whatever is seen of it.
        steps = np.floor(_PER_OCTAVE * np.log2(asked.tolerance_mm) + 1e-9)
        asked = replace(asked, tolerance_mm=float(2.0 ** (steps / _PER_OCTAVE)))
        low, high = roomier(asked.low, asked.high, self._lattice)
        try:
            return self._one(make, replace(asked, low=low, high=high))
        except NoMapError:
            return self._one(make, asked)

    def _one(self, make: Callable[[MapRequest], RayMap], asked: MapRequest) -> RayMap:
        whose, by_value = _medium(asked.field)
        there = _in_own_frame(asked)
        quality = asked.march, asked.tolerance_mm, asked.most_nodes
        places = asked.low.tobytes(), asked.high.tobytes(), _rays(there).tobytes()
        key = id(whose), make, by_value, quality, places, mi.variant()
        with self._lock:
            # A medium that is gone may have left its number to another.
            for other, entry in list(self._entries.items()):
                if entry.medium is not None and entry.medium() is None:
                    del self._entries[other]
            if key in self._entries:
                self._entries.move_to_end(key)
                return _of(self._entries[key].found, asked.family)
            found: RayMap | NoMapError
            try:
                found = make(there)
            except NoMapError as why:
                found = why.with_traceback(None)
            reference = None if whose is None else weakref.ref(whose)
            self._entries[key] = _Entry(reference, found)
            while len(self._entries) > 1 and (
                self.bytes > self._most_bytes or len(self._entries) > _MOST_MAPS
            ):
                self._entries.popitem(last=False)
            return _of(found, asked.family)


MAPS = MapCache()
"""Of this process."""


def roomier(low: Array, high: Array, lattice: Array = _LATTICE) -> tuple[Array, Array]:
    """The box of a lattice that holds one of (s, t, depth); its rays start no later than asked."""
    extent = np.maximum(high - low, 1e-9)
    step = 2.0 ** np.ceil(np.log2(extent / (2.0 * lattice)))
    first, last = np.floor(low / step) * step, np.ceil(high / step) * step
    while first[2] <= 0.0 < low[2]:  # rays of a pinhole don't differ at depth 0
        step[2] /= 2.0
        first[2] = np.floor(low[2] / step[2]) * step[2]
    return first, last


def _medium(medium: Field | None) -> tuple[Any, Hashable]:
    """What a medium is by identity and by value: the nodes of one that has them."""
    if medium is None:
        return None, None
    nodes = getattr(medium, "nodes", None)
    if nodes is None:
        return medium, None
    field: Any = medium
    lattice = field.origin.tobytes(), field.spacing.tobytes(), field.mirror
    return nodes, (*lattice, field.ambient, field.interpolation, field.dimensions)


def _in_own_frame(asked: MapRequest) -> MapRequest:
    """A medium that was never moved, and the family where it is in it, on the lattice of poses."""
    medium, pose = asked.field, asked.family.pose
    still = medium
    if medium is not None and medium.pose is not None:
        turn = medium.pose.rotation.T
        pose = Pose(turn @ pose.rotation, medium.pose.to_local(pose.origin_mm))
        still = replace(medium, pose=None)  # type: ignore[type-var]
    on_lattice = _rounded(pose.rotation, _POSE_TURN), _rounded(pose.origin_mm, _POSE_MM)
    return replace(asked, field=still, family=asked.family.with_pose(Pose(*on_lattice)))


def _rounded(numbers: Array, step: float) -> Array:
    rounded: Array = np.rint(numbers / step) * step + 0.0  # without -0.0, whose bytes are others
    return rounded


def _rays(asked: MapRequest) -> Array:
    """Where a family's rays and its frame are, mm: numbers to compare."""
    family, low, high = asked.family, asked.low, asked.high
    s, t = (a.ravel() for a in np.meshgrid(*(low[:2] + _AT[:, None] * (high - low)[:2]).T))
    origins, directions = family.rays(s, t)
    ends = origins + directions * max(high[2], 1.0)
    frame = family.pose.to_world(np.vstack([np.zeros(3), max(high[2], 1.0) * np.eye(3)]))
    return np.concatenate([origins, ends, frame])


def _of(found: RayMap | NoMapError, family: RayFamily) -> RayMap:
    """A map for a family that may have another pose in the world, with its medium."""
    if isinstance(found, NoMapError):
        kind = CausticError if isinstance(found, CausticError) else NoMapError
        raise kind(str(found))
    return found if found.family is family else replace(found, family=family)
