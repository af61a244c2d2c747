"""Bundles of rays whose ends are known: what methods of bending rays are judged by."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray

from virtual_sensor.arrays import to_numpy, to_scalars, to_vectors
from virtual_sensor.display import Displayed
from virtual_sensor.engine import dr, mi
from virtual_sensor.imaging.scene import Scene
from virtual_sensor.medium.exact_fields import ExactField, fish_eye, selfoc
from virtual_sensor.optics.eikonal import Field, March, Straight, bend, in_plane
from virtual_sensor.optics.family_frames import FamilyFrame
from virtual_sensor.optics.ray_maps import ForwardMap, MapRequest, forward_map
from virtual_sensor.optics.ray_status import RayStatus
from virtual_sensor.optics.sight import incidence_points, lines_of_sight
from virtual_sensor.optics.surfaces import NoSurface

Array = NDArray[np.float64]

FINEST = March(0.05, "rk4", "double")
"""The reference where there is no closed form: 1e-8 px from half that step on the shipped field."""

MM_PER_PX = 0.022  # of hot_cylinder's camera on the part

_ROWS = 11  # a bundle covers the line's row and five on either side, as its light does
_MARGIN = np.array([1e-6, 1e-6, 1e-3])  # round what a table is for: p, q, and depth in mm
_LENGTH_MM = 240.0  # of the closed-form rays: what the camera's run in the plume


@dataclass(frozen=True)
class Bundle(Displayed):
    """Rays in a world of mm that end in parallel planes, one for each ray.

    Attributes
    ----------
    origins, directions : ndarray of shape (N, 3)
        Directions are of length 1.
    targets : ndarray of shape (N, 3)
        Where straight rays end: each ray's plane holds its target.
    normal : ndarray of shape (3,)
        Of the planes.
    """

    origins: Array
    directions: Array
    targets: Array
    normal: Array

    def some(self, count: int) -> Bundle:
        """Some `count` of the rays, evenly taken."""
        at = self.sample(count)
        return replace(
            self, origins=self.origins[at], directions=self.directions[at], targets=self.targets[at]
        )

    def sample(self, count: int) -> NDArray[np.intp]:
        """Numbers of those rays."""
        return np.linspace(0, len(self.targets) - 1, count).astype(np.intp)


def camera_bundle(scene: Scene, count: int) -> Bundle:
    """Lines of sight towards the laser's line on the part, to where they meet the cold part.

    Neighbours in the bundle are neighbours along the line, as they are in a frame.
    """
    half = 0.5 * scene.sensor.laser.length_mm
    camera = scene.sensor.camera
    cold = scene.cold()
    line = camera.project(incidence_points(cold, np.linspace(-half, half, 401)))
    line = line[np.argsort(line[:, 0])]
    u = np.linspace(line[0, 0], line[-1, 0], count)
    across = np.arange(count) // max(count // _ROWS, 1) % _ROWS - _ROWS // 2
    v = np.interp(u, *line.T) + across
    origins, directions = lines_of_sight(camera, np.stack([u, v], axis=1))
    straight = Straight.through(to_vectors(origins), to_vectors(directions), FINEST)
    met = bend(None, scene.surface, straight, FINEST)
    dr.eval(met)
    hit = np.array(met.status) == RayStatus.HIT
    targets = to_numpy(met.position(straight))[hit]
    return Bundle(origins[hit], directions[hit], targets, camera.pose.rotation[:, 2])


def prepare(field: Field | None, bundle: Bundle, march: March) -> Callable[[], Ends]:
    """The marching of a bundle as a function to be timed: it holds the rays in Dr.Jit's memory."""
    line = Straight.through(to_vectors(bundle.origins), to_vectors(bundle.directions), march)
    normal = dr.opaque(march.vector(*map(float, bundle.normal)))
    dr.eval(line.anchor, line.direction, line.start)
    # From the anchor as rounded: float32's rounding of the straight ray is not the march's error.
    offset = (bundle.targets - to_numpy(line.anchor)) @ bundle.normal
    ends = in_plane(normal, march.scalar(to_scalars(offset)))
    dr.eval(ends)

    def work() -> Ends:
        ray = bend(field, NoSurface(), line, march, remaining=ends)
        dr.eval(ray.t, ray.offset, ray.tau, ray.status)
        return Ends(line, ray.t, ray.offset[0], ray.status)

    return work


@dataclass(frozen=True)
class Ends(Displayed):
    """Where a bundle's rays ended, in Dr.Jit's memory."""

    line: Straight
    t: object
    offset: object
    status: object

    def positions(self) -> Array:
        """Positions (N, 3) in mm; NaN for rays that did not reach their plane."""
        straight, offset = (to_numpy(v) for v in (self.line.anchor, self.offset))
        along = to_numpy(self.line.direction) * np.array(self.t, float)[:, None]
        ended = np.array(self.status) == RayStatus.ENDED
        return np.where(ended[:, None], straight + along + offset, np.nan)


def tabulated_ends(
    scene: Scene, bundle: Bundle, tolerance_px: float
) -> tuple[Callable[[], Array], Callable[[], ForwardMap]]:
    """The same by maps, as functions to be timed: all of it, and making the map alone."""
    family = scene.sensor.camera
    place = family.coordinates(bundle.targets)
    held, targets = to_vectors(place), to_vectors(bundle.targets)  # as `prepare` holds its rays
    low, high = place.min(axis=0) - _MARGIN, place.max(axis=0) + _MARGIN
    march, error_mm = scene.transport.march, tolerance_px * MM_PER_PX

    def make() -> ForwardMap:
        return forward_map(MapRequest(scene.field, family, low, high, march, error_mm))

    def work() -> Array:
        frame = FamilyFrame.of(family, mi.Array3f64)
        x, y, _, _ = make().linear.at(held)
        return to_numpy(targets + frame.x * mi.Float64(x) + frame.y * mi.Float64(y))

    return work, make


def ends_of(field: Field | None, bundle: Bundle, march: March) -> Array:
    """Positions (N, 3) in mm where a bundle's rays end; NaN for those that don't."""
    return prepare(field, bundle, march)().positions()


def apart_px(positions: Array, reference: Array, bundle: Bundle) -> Array:
    """Distances (N,) square to the rays, in the camera's pixels."""
    apart = positions - reference
    d = bundle.directions
    apart = apart - d * np.einsum("ij,ij->i", apart, d)[:, None]
    return np.linalg.norm(apart, axis=1) / MM_PER_PX


def fibre(count: int) -> tuple[ExactField, Bundle, Array]:
    """Rays along a fibre that bends them as hot air does: 0.3 mm at its edge; and their true ends.

    Born and Wolf: n^2 = n0^2 (1 - a^2 (y^2 + z^2)), where rays swing harmonically.
    """
    a = 1e-3
    box = np.array([[-_LENGTH_MM, -12.0, -12.0], [1.0, 12.0, 12.0]])
    origins, directions = _fan(count, np.array([-_LENGTH_MM, 0.0, 0.0]))
    n = np.sqrt(1.0 - (a * np.linalg.norm(origins[:, 1:], axis=1)) ** 2)
    tangent = _scaled(directions, n)
    t = _LENGTH_MM / tangent[:, 0:1]  # nothing pulls along x
    ends = origins * np.cos(a * t) + tangent * np.sin(a * t) / a
    ends[:, 0] = 0.0
    return selfoc(1.0, a, box=box), _to_plane(origins, directions, 0.0), ends


def fish_eye_of_hot_air(count: int) -> tuple[ExactField, Bundle, Array]:
    """Maxwell's fish-eye, so weak that it bends as hot air does, and its rays' true ends.

    Born and Wolf, section 4.2.2: a ray is the circle through its start r0 and -a^2 r0 / r0^2.
    """
    a = 4000.0
    half = _LENGTH_MM / 2.0
    box = np.array([[-half - 1.0, -50.0, -50.0], [half + 1.0, 50.0, 50.0]])
    origins, directions = _fan(count, np.array([-half, 30.0, 0.0]))
    image = -origins * (1.0 + a**2 / np.einsum("ij,ij->i", origins, origins))[:, None]
    along = np.einsum("ij,ij->i", image, directions)[:, None]
    towards = image - directions * along
    towards /= np.linalg.norm(towards, axis=1, keepdims=True)
    radius = np.einsum("ij,ij->i", image, image) / (2.0 * np.einsum("ij,ij->i", image, towards))
    # On r0 + R (d sin w + e (1 - cos w)), w where x is that of the plane, by Newton.
    w = _LENGTH_MM / directions[:, 0] / radius
    for _ in range(5):
        x = directions[:, 0] * np.sin(w) + towards[:, 0] * 2.0 * np.sin(w / 2.0) ** 2
        slope = directions[:, 0] * np.cos(w) + towards[:, 0] * np.sin(w)
        w = w - (x - _LENGTH_MM / radius) / slope
    sag = 2.0 * np.sin(w / 2.0) ** 2
    arc = directions * np.sin(w)[:, None] + towards * sag[:, None]
    return (
        fish_eye(1.0, a, box=box),
        _to_plane(origins, directions, half),
        origins + _scaled(arc, radius),
    )


def _fan(count: int, middle: Array) -> tuple[Array, Array]:
    """Rays from a line of starts, 20 mm across, nearly along x."""
    s = np.linspace(-1.0, 1.0, count)
    origins = middle + np.stack([0.0 * s, 10.0 * s, 4.0 * np.sin(5.0 * s)], axis=1)
    directions = np.stack([np.ones_like(s), -0.005 * s, 0.004 * np.cos(3.0 * s)], axis=1)
    return origins, directions / np.linalg.norm(directions, axis=1, keepdims=True)


def _to_plane(origins: Array, directions: Array, x_mm: float) -> Bundle:
    """A bundle that ends in a plane square to x."""
    length = (x_mm - origins[:, 0]) / directions[:, 0]
    targets = origins + directions * length[:, None]
    return Bundle(origins, directions, targets, np.array([1.0, 0.0, 0.0]))


def _scaled(vectors: Array, factors: Array) -> Array:
    return vectors * factors[:, None]
