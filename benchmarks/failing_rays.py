"""Where bent rays fail: turned back, grazing, lost in float32, by their step or by the grid."""

from __future__ import annotations

from collections.abc import Iterator
from functools import cache, partial
from typing import Any

import numpy as np
from numpy.typing import NDArray
from worsening import Case, Outcome, judged

from virtual_sensor.arrays import to_vectors
from virtual_sensor.engine import dr, mi
from virtual_sensor.errors import InputError
from virtual_sensor.imaging.checks import check_scene
from virtual_sensor.imaging.scene import load_scene
from virtual_sensor.medium.exact_fields import ExactField, hot_spot, linear
from virtual_sensor.medium.index_field import IndexField
from virtual_sensor.optics.eikonal import Field, March, Straight, bend, never
from virtual_sensor.optics.ray_status import RayStatus
from virtual_sensor.optics.sight import incidence_points, lines_of_sight, seen_points
from virtual_sensor.optics.surfaces import Cylinder, NoSurface, Surface
from virtual_sensor.optics.trace import trace

Array = NDArray[np.float64]

SCENE = "hot_cylinder"
MM_PER_PX = 0.022  # of its camera on the part
MARCHES = (
    March(0.05, "euler", "double"),
    March(2.0, "leapfrog", "double"),
    March(2.0, "leapfrog", "single"),
    March(2.0, "sharma", "double"),
    March(2.0, "rk4", "double"),
    March(10.0, "dopri5", "double"),
    March(10.0, "dopri5", "single"),
)
_RAYS = 1000
_GOOD = (RayStatus.ENDED, RayStatus.LEFT, RayStatus.HIT)

# n^2 falls linearly from 1 at z = -40 mm to 0.2 at z = 40: a ray is thrown back like a stone.
_FALL_PER_MM, _FLOOR_MM, _CEILING_MM = 0.01, -40.0, 40.0
_THROWING = linear(
    float(np.sqrt(1.0 + _FALL_PER_MM * _FLOOR_MM)),
    (0.0, 0.0, -_FALL_PER_MM),
    box=np.array([[-900.0, -900.0, _FLOOR_MM], [900.0, 900.0, _CEILING_MM]]),
)
_DIP, _WIDTH_MM = 5e-4, 8.0  # of a hot layer round the paper's cylinder


def cases() -> Iterator[Case]:
    """All of them."""
    for march in MARCHES:
        yield Case(
            "turned back by total reflection",
            f"{march.method}, {march.step_mm:g} mm, {march.precision}",
            (10.0, 1.0, 0.1, 0.01, 1e-3, 1e-4),
            "mm from the apex of a ray to the field's border",
            partial(_thrown, march),
            "n^2 from 1 to 0.2 over 80 mm, a strong field; wrong are rays with the other status",
            "the march oversteps a border by some um",
        )
    for march in MARCHES:
        yield Case(
            "grazing rays at the silhouette",
            f"{march.method}, {march.step_mm:g} mm, {march.precision}",
            tuple(10.0**-k for k in range(-1, 7)),
            "px from the silhouette",
            partial(_grazing, march),
            "a hot layer round a cylinder; by Bouguer's law rays with b < n(R) R meet it",
            silent=True,
        )
    yield Case(
        "rays that start far away",
        "leapfrog in float32",
        (300.0, 3e3, 3e4, 3e5, 3e6),
        "mm from the field",
        _far,
        "a ball of hot air; beside the same in float64, steps of 0.5 mm",
        silent=True,
    )
    yield Case(
        "steps too short for the field",
        "every method",
        (1.0, 0.1, 0.01, 0.001),
        "mm a step",
        lambda step: judged(
            trace(_THROWING, [[0.0, 0.0, 0.0]], [[1.0, 0.0, 0.0]], 50.0, step).status, _GOOD, [0.0]
        ),
        "a ray of 50 mm with 20,000 steps allowed",
    )
    yield Case(
        "a start that is not a number",
        "trace",
        (0.0, 1.0),
        "coordinates that are NaN",
        _from_nowhere,
        "one ray",
    )
    yield from _plume_cases()
    yield Case(
        "jump of n at a flat border",
        "every method",
        tuple(10.0**-k for k in range(8, 3, -1)),
        "of n",
        _slab,
        "uniform air, 100 mm deep, at 45 degrees; beside Snell's law",
        "the march goes straight across; a scene with such a border is refused",
        silent=True,
    )


def _marched(
    field: Field, starts: Array, directions: Array, march: March, surface: Surface
) -> NDArray[np.uint32]:
    """Status (N,) of rays that run on until something stops them."""
    line = Straight.through(to_vectors(starts), to_vectors(directions), march)
    ray = bend(field, surface, line, march, remaining=never)
    dr.eval(ray.status)
    return np.array(ray.status)


def _thrown(march: March, distance_mm: float) -> Outcome:
    """Rays whose apex, T_z^2 / fall, lies so far before the border, and as far beyond it."""
    away = distance_mm * np.linspace(-1.0, 1.0, 20)
    away += np.copysign(distance_mm, away)
    T_z = np.sqrt(_FALL_PER_MM * (_CEILING_MM + away - _FLOOR_MM))
    directions = np.stack([np.sqrt(1.0 - T_z**2), 0.0 * T_z, T_z], axis=1)
    starts = [-100.0, 0.0, _FLOOR_MM] - 10.0 * directions
    status = _marched(_THROWING, starts, directions, march, NoSurface())
    expected = np.where(away < 0.0, RayStatus.TURNED_BACK, RayStatus.LEFT)
    back = status == RayStatus.TURNED_BACK
    return Outcome(back, status != expected, [RayStatus.TURNED_BACK.name])


def _layer() -> ExactField:
    """n^2 = 1 - dip exp(-(rho^2 - R^2) / 2w^2) round the cylinder."""
    part = Cylinder()

    def n_squared(p: Any) -> tuple[Any, Any, Any]:
        across = type(p)(0.0, p.y - part.axis_y_mm, p.z - part.axis_z_mm)
        dip = _DIP * dr.exp((part.radius_mm**2 - dr.squared_norm(across)) / (2.0 * _WIDTH_MM**2))
        matrix = mi.Matrix3f64 if dr.type_v(p) == dr.VarType.Float64 else mi.Matrix3f
        return 1.0 - dip, across * (dip / _WIDTH_MM**2), dr.zeros(matrix)  # no derivatives asked

    return ExactField(n_squared, box=np.array([[-100.0, -70.0, -83.5], [100.0, 70.0, 56.5]]))


def _grazing(march: March, distance_px: float) -> Outcome:
    part = Cylinder()
    away = distance_px * MM_PER_PX * np.concatenate([np.linspace(-1, -0.5), np.linspace(0.5, 1)])
    b = part.radius_mm * np.sqrt(1.0 - _DIP) + away
    starts = np.stack([0.0 * b, 0.0 * b - 100.0, part.axis_z_mm + b], axis=1)
    status = _marched(_layer(), starts, np.tile([0.0, 1.0, 0.0], (b.size, 1)), march, part)
    expected = np.where(away < 0.0, RayStatus.HIT, RayStatus.LEFT)
    return Outcome(np.zeros(b.size, bool), status != expected)


def _far(distance_mm: float) -> Outcome:
    """Rays towards a ball of hot air, in single precision beside double."""
    field = hot_spot(4e-4, 5.0, box=np.array([[-60.0] * 3, [60.0] * 3]))
    y = np.linspace(-10.0, 10.0, 201)
    direction = np.array([15.0, -1.0, -0.3]) / np.linalg.norm([15.0, -1.0, -0.3])
    starts = np.stack([0.0 * y, y, 0.0 * y], axis=1) - distance_mm * direction
    directions = np.tile(direction, (y.size, 1))
    single, double = (
        trace(field, starts, directions, distance_mm + 100.0, 0.5, "leapfrog", precision)
        for precision in ("single", "double")
    )
    return judged(single.status, _GOOD, _apart_px(single.position, double.position, directions))


def _from_nowhere(number: float) -> Outcome:
    start = np.where(np.arange(3) < number, np.nan, 0.0)
    try:
        rays = trace(_THROWING, [start], [[1.0, 0.0, 0.0]], 10.0)
    except InputError:
        return Outcome(np.array([True]), np.array([False]), ["InputError"])
    return judged(rays.status, _GOOD, [0.0 if number == 0.0 else np.inf])


def _slab(jump: float) -> Outcome:
    """Uniform air behind a flat border: Snell's law turns a ray there."""
    ambient, sine, depth_mm = 2.7e-4, np.sqrt(0.5), 100.0
    nodes = np.full((4, 4, 4), ambient - jump)
    field = IndexField.from_arrays(nodes, [-200.0, -200.0, 0.0], [150.0] * 3, ambient=ambient)
    direction = np.array([sine, 0.0, sine])
    inside = sine * (1.0 + ambient) / (1.0 + ambient - jump)
    ray = trace(field, [-10.0 * direction], [direction], 10.0 + depth_mm / sine)
    snells = depth_mm * inside / np.sqrt(1.0 - inside**2)
    return judged(ray.status, _GOOD, np.abs(ray.position[:, 0] - snells) * sine / MM_PER_PX)


def _apart_px(one: Array, other: Array, directions: Array) -> Array:
    """Distances (N,) square to the rays, px."""
    apart = one - other
    apart = apart - directions * np.einsum("ij,ij->i", apart, directions)[:, None]
    return np.linalg.norm(apart, axis=1) / MM_PER_PX


class Plume:
    """Lines of sight through the shipped hot air towards the laser's line on the part."""

    def __init__(self, rays: int = _RAYS) -> None:
        self.scene = load_scene(SCENE)
        assert self.scene.field is not None
        self.field = self.scene.field
        cold, camera = self.scene.cold(), self.scene.camera
        half = 0.5 * self.scene.source.length_mm - 0.5  # its last rays see the part's sides
        pixel = camera.project(incidence_points(cold, np.linspace(-half, half, rays)))
        pixel[:, 1] += np.arange(rays) % 11 - 5  # the line's row and five on either side
        self.rays = lines_of_sight(camera, pixel)
        self.length_mm = np.linalg.norm(seen_points(cold, pixel) - self.rays[0], axis=1)
        self.truth = self.ends(self.field, 0.05).position

    def ends(self, field: Field, step_mm: float = 1.0, method: str = "rk4", **march: Any) -> Any:
        """The rays' ends."""
        return trace(field, *self.rays, self.length_mm, step_mm, method, **march)

    def errors(self, field: Field, step_mm: float = 1.0, method: str = "rk4", **march: Any) -> Any:
        """Outcome of marching in one field with one setting."""
        rays = self.ends(field, step_mm, method, **march)
        error = _apart_px(rays.position, self.truth, self.rays[1])
        return judged(rays.status, _GOOD, error)


@cache
def plume() -> Plume:
    """The rays of all cases."""
    return Plume()


def _plume_cases() -> Iterator[Case]:
    """Steps, tolerances, grids, noise, jumps of the gradient, and a cut."""
    hot_air = f"{_RAYS} rays through hot air of 1250 degC"
    steps = (1.0, 1.5, 2.0, 2.5, 3.0, 4.0, 5.0, 6.0, 8.0, 12.0, 16.0)
    for method in ("euler", "leapfrog", "sharma", "rk4"):
        yield Case(
            "steps too long",
            method,
            (0.05, 0.125, 0.25, 0.5, *steps) if method == "euler" else steps,
            "mm a step",
            lambda step, method=method: plume().errors(plume().field, step, method),
            hot_air,
            "halve the step and compare",
            silent=True,
        )
    yield Case(
        "tolerance too wide",
        "dopri5",
        (1e-7, 1e-6, 3e-6, 1e-5, 3e-5, 1e-4),
        "mm a step",
        lambda mm: plume().errors(plume().field, 24.0, "dopri5", tolerance_mm=mm),
        hot_air,
        "its estimate is of one smooth step, and the spline's cells are shorter",
        silent=True,
    )
    for kind in ("cubic", "linear"):
        yield Case(
            "grid too coarse",
            f"{kind} interpolation",
            (1, 2, 4, 8),
            "times the grid's spacing",
            lambda k, kind=kind: plume().errors(thinned(plume().field, k).simplified(kind)),
            hot_air,
            "leave out every second node and compare",
            silent=True,
        )
    yield Case(
        "noise on the field",
        "cubic interpolation",
        (1e-5, 1e-4, 1e-3, 3e-3, 1e-2, 3e-2, 1e-1),
        "of n - n_ambient at the nodes",
        lambda level: plume().errors(noisy(plume().field, level)),
        hot_air,
    )
    yield Case(
        "jumps of a trilinear gradient",
        "linear interpolation",
        (0.125, 0.25, 0.5, 1.0, 2.0),
        "mm a step",
        lambda step: plume().errors(plume().field.simplified("linear"), step),
        hot_air,
        "the error does not fall with the step",
        silent=True,
    )
    yield Case(
        "field cut off within hot air",
        "check of the scene, rk4",
        (0.0, 0.1, 0.2, 0.4, 0.6, 0.8),
        "of the field's height",
        _cut,
        hot_air,
    )


def _cut(share: float) -> Outcome:
    """The field without the upper part of its height, as the check and the march find it."""
    field = plume().field
    height = field.shape[2]
    left = field.with_nodes(field.nodes[:, :, : height - round(share * height)])
    try:
        reports = ["a note"] if check_scene(plume().scene.with_medium(left)) else []
    except InputError:
        reports = ["InputError"]
    if reports:
        everything = np.ones(len(plume().length_mm), bool)
        return Outcome(everything, ~everything, reports)
    return plume().errors(left)


def thinned(field: IndexField, factor: float) -> IndexField:
    """Every n-th node along each axis, from the first."""
    k = int(factor)
    return field.with_nodes(field.nodes[::k, ::k, ::k], spacing_mm=field.spacing * k)


def noisy(field: IndexField, level: float) -> IndexField:
    """The field with noise, relative to its difference from the surroundings."""
    factor = 1.0 + level * np.random.default_rng(5).normal(size=field.shape)
    return field.with_nodes(field.ambient + (field.nodes - field.ambient) * factor)
