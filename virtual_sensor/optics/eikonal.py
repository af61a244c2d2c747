"""Bent rays: the eikonal march through a field of refractivity, in Dr.Jit.

With dt = ds/n the ray equation d/ds (n dr/ds) = grad n reads

    dr/dt = T,    dT/dt = n grad n,    |T| = n.

One code serves float32 and float64, because what is carried is the *difference* from the straight
ray, r = anchor + t d + delta and T = d + tau, which stays below a millimetre in hot air: float32
resolves it to a nanometre.  The index is taken relative to the surroundings, so that |T| = 1
outside the field, where a ray moves in one jump.  The border itself does not refract here; a field
that does not fade to its surroundings there is reported when a scene is measured.
"""

from collections.abc import Callable
from dataclasses import dataclass, replace
from typing import Any, Protocol

import numpy as np

from virtual_sensor.engine import dr, mi
from virtual_sensor.errors import InputError
from virtual_sensor.optics.ray_status import RayStatus
from virtual_sensor.optics.steppers import STEPPERS, Vectors
from virtual_sensor.optics.surfaces import Surface

LAST_PIECE_MM = 0.05
"""The last, straight piece of a ray onto a surface: so short that Mitsuba's float32 is exact."""

_BORDER_MM = 1e-3  # rays overstep the border by this, so that rounding can't hold them there
_OVERLAP_MM = 1e-3  # chords overlap by this, so that no ray slips through between two


class Lookup(Protocol):
    """Difference of n - 1 from the surroundings at points in a field's box, in Dr.Jit."""

    def delta_and_gradient(self, p: Any) -> tuple[Any, Any]:
        """Value, and gradient in 1/mm."""
        ...

    def delta_gradient_hessian(self, p: Any) -> tuple[Any, Any, Any]:
        """Value, gradient in 1/mm, and Hessian in 1/mm^2."""
        ...


class Field(Protocol):
    """What a ray needs to know of a field: `IndexField` and the closed-form fields have it."""

    @property
    def box(self) -> np.ndarray:
        """Lower and upper corner in mm, shape (2, 3)."""
        ...

    @property
    def ambient(self) -> float:
        """Refractivity outside the box."""
        ...

    def lookup(self, precision: str) -> Lookup:
        """Evaluator for "single" or "double"."""
        ...


@dataclass(frozen=True)
class March:
    """How to march.

    Attributes
    ----------
    step_mm : float
        Step in t: the arc length where n is that of the surroundings.
    method : str
        A key of `steppers.STEPPERS`.
    precision : str
        "single" or "double".
    max_steps : int
        A ray still in the field after so many steps gets status OUT_OF_STEPS.

    Raises
    ------
    InputError
        If one of them can't be marched with.
    """

    step_mm: float = 1.0
    method: str = "rk4"
    precision: str = "double"
    max_steps: int = 20_000

    def __post_init__(self) -> None:
        if not self.step_mm > 0.0:
            raise InputError(f"step_mm must be positive, not {self.step_mm}")
        if self.method not in STEPPERS:
            raise InputError(f"method '{self.method}' is none of {', '.join(STEPPERS)}")
        if self.precision not in ("single", "double"):
            raise InputError(f"precision must be single or double, not '{self.precision}'")

    def __str__(self) -> str:
        return f"{self.method}, steps of {self.step_mm:g} mm, {self.precision} precision"

    @property
    def vector(self) -> Any:
        """Dr.Jit's 3-vector in this precision."""
        return mi.Array3f if self.precision == "single" else mi.Array3f64

    @property
    def scalar(self) -> Any:
        """Dr.Jit's float in this precision."""
        return mi.Float if self.precision == "single" else mi.Float64


@dataclass
class Straight:
    """Straight rays, to which bent ones are the difference: r = anchor + t direction."""

    anchor: Any
    direction: Any
    start: Any  # t at the ray's origin

    @staticmethod
    def through(origin: Any, direction: Any, march: March) -> "Straight":
        """Rays from origins (mm, world) along unit directions, either in any precision.

        The anchor is the point nearest to the world's origin, where the part is: positions near the
        part are then free of the rounding of a far start.
        """
        o, d = mi.Array3f64(origin), mi.Array3f64(direction)
        start = dr.dot(o, d)
        return Straight(march.vector(o - d * start), march.vector(d), march.scalar(start))


@dataclass
class BentRays:
    """Rays on their way; every member is a Dr.Jit array over the rays.

    Attributes
    ----------
    t : scalar
    offset : tuple of vectors
        First the ray's offset from its straight ray in mm, then derivatives of its position.
    tau : tuple of vectors
        First T minus the straight direction, then derivatives of T.
    arc, path : scalar
        Arc length since the start minus elapsed t; likewise optical path, relative to the
        surroundings.  In mm.
    status : int
        `RayStatus`.
    """

    t: Any
    offset: Vectors
    tau: Vectors
    arc: Any
    path: Any
    status: Any

    def position(self, line: Straight) -> Any:
        """World position in mm."""
        return line.anchor + line.direction * self.t + self.offset[0]

    def tangent(self, line: Straight) -> Any:
        """T = n dr/ds, relative to the surroundings."""
        return line.direction + self.tau[0]

    def moved(self, dt: Any) -> "BentRays":
        """The same rays a straight piece further on."""
        offset = tuple(x + v * dt for x, v in zip(self.offset, self.tau, strict=True))
        return replace(self, t=self.t + dt, offset=offset)


Remaining = Callable[[Straight, BentRays], Any]
"""Signed dt to the place where a ray is asked to end, exact where light runs straight."""


def never(line: Straight, ray: BentRays) -> Any:
    """Rays run on until they meet something or leave."""
    return dr.full(type(ray.t), dr.inf, dr.width(ray.t))


def after_length(length: Any) -> Remaining:
    """Rays end after an arc length in mm."""

    def remaining(line: Straight, ray: BentRays) -> Any:
        return (length - (ray.t - line.start) - ray.arc) / dr.norm(ray.tangent(line))

    return remaining


def in_plane(normal: Any, offset_mm: Any) -> Remaining:
    """Rays end in the plane normal . (r - anchor) = offset_mm, with each ray's own anchor."""

    def remaining(line: Straight, ray: BentRays) -> Any:
        gone = ray.t * dr.dot(normal, line.direction) + dr.dot(normal, ray.offset[0])
        return (offset_mm - gone) / dr.dot(normal, ray.tangent(line))

    return remaining


def bend(
    field: Field | None,
    surface: Surface,
    line: Straight,
    march: March,
    *,
    remaining: Remaining = never,
    tangents: tuple[tuple[Any, Any], ...] = (),
    active: Any = True,
) -> BentRays:
    """March rays until they meet the surface, end, or leave for good.

    Parameters
    ----------
    field : Field or None
        None: light runs straight.
    surface : Surface
        What stops rays.
    line : Straight
        The rays as they start.
    remaining : callable
        Where they end otherwise.
    tangents : tuple of (vector, vector)
        Derivatives of the start's position and direction by any parameters; they are carried along
        exactly, by the field's Hessian.
    active : mask
        The rays to march; the others stay where they are with status LEFT.
    """
    width = dr.width(line.start)
    mask = dr.full(mi.Mask, True, width) & active
    zero = dr.zeros(march.scalar, width)
    none = dr.zeros(march.vector, width)
    ray = BentRays(
        march.scalar(line.start),
        (none, *(x for x, _ in tangents)),
        (none, *(v for _, v in tangents)),
        zero,
        zero,
        dr.full(mi.UInt32, int(RayStatus.LEFT), width),
    )
    inside = mask & surface.starts_inside(ray.position(line), line.direction)
    ray.status[inside] = int(RayStatus.STARTED_INSIDE)
    mask &= ~inside
    if field is not None:
        near, far = _slab(ray.position(line), line.direction, _box(field, march))
        meets = mask & (near < far) & (far > 0.0)
        gap = dr.select(meets & (near > 0.0), near + _BORDER_MM, 0.0)
        ray, stopped = _run_straight(line, ray, gap, surface, remaining, meets)
        meets &= ~stopped
        ray = _march(field, surface, line, ray, march, remaining, meets)
        mask &= ~stopped & (ray.status == int(RayStatus.LEFT))
    ray, _ = _run_straight(line, ray, never(line, ray), surface, remaining, mask)
    against = dr.dot(line.direction, ray.tangent(line)) < 0.0
    ray.status[(ray.status == int(RayStatus.LEFT)) & against] = int(RayStatus.TURNED_BACK)
    return ray


def _march(
    field: Field,
    surface: Surface,
    line: Straight,
    ray: BentRays,
    march: March,
    remaining: Remaining,
    active: Any,
) -> BentRays:
    """From the border (or from inside) through the field, step by step."""
    rhs = _right_hand_side(field, line, march)
    stepper = STEPPERS[march.method]
    box = _box(field, march)
    close = 1e-4 if march.precision == "single" else 1e-9

    def step(ray: BentRays, h: Any) -> BentRays:
        offset, tau, arc, path = stepper(rhs, ray.t, ray.offset, ray.tau, h)
        return replace(
            ray, t=ray.t + h, offset=offset, tau=tau, arc=ray.arc + arc, path=ray.path + path
        )

    def body(ray: BentRays, moving: Any, chord: Any, count: Any) -> tuple[Any, ...]:
        _, out = _slab(ray.position(line), ray.tangent(line), box)
        h = dr.minimum(march.step_mm, out + 2.0 * _BORDER_MM)
        left = remaining(line, ray)
        h = dr.select(left < h, dr.maximum(left, -march.step_mm), h)
        ahead = step(ray, h)
        secant = line.direction * h + (ahead.offset[0] - ray.offset[0])
        length = dr.norm(secant)
        met = surface.distance(
            ray.position(line), secant / length, length + _OVERLAP_MM, moving & (h > 0.0)
        )
        hit = moving & (h > 0.0) & (met <= length + _OVERLAP_MM)
        chord = dr.select(hit, h * met / length, chord)
        ray = dr.select(moving & ~hit, ahead, ray)
        arrived = moving & ~hit & (dr.abs(remaining(line, ray)) <= close)
        ray.status = dr.select(hit, int(RayStatus.HIT), ray.status)
        ray.status = dr.select(arrived, int(RayStatus.ENDED), ray.status)
        moving = moving & ~hit & ~arrived & _within(ray.position(line), ray.tangent(line), box)
        return ray, moving, chord, count + 1

    f, g = field.lookup(march.precision).delta_and_gradient(ray.position(line))
    f, g = f / (1.0 + field.ambient), g / (1.0 + field.ambient)
    d = line.direction
    at_start = (  # T = n d, and its derivatives
        ray.tau[0] + d * f,
        *(v + v * f + d * dr.dot(g, x) for x, v in zip(ray.offset[1:], ray.tau[1:], strict=True)),
    )
    ray = dr.select(active, replace(ray, tau=at_start), ray)
    ray, moving, chord, _ = dr.while_loop(
        (ray, active, dr.zeros(march.scalar, dr.width(active)), mi.UInt32(0)),
        lambda ray, moving, chord, count: moving & (count < march.max_steps),
        body,
        labels=("ray", "moving", "chord", "count"),
    )
    ray.status[moving] = int(RayStatus.OUT_OF_STEPS)
    hit = active & (ray.status == int(RayStatus.HIT))
    ray = dr.select(hit, _onto_surface(line, step(ray, chord), surface, hit), ray)
    ended = active & (ray.status == int(RayStatus.ENDED))
    ray = dr.select(ended, ray.moved(remaining(line, ray)), ray)
    out = active & (ray.status == int(RayStatus.LEFT))
    return dr.select(out, _unit_tangent(line, ray), ray)


def _right_hand_side(field: Field, line: Straight, march: March) -> Callable[..., Any]:
    """The steppers' rhs: n grad n at the ray, and its derivative for each tangent."""
    lookup = field.lookup(march.precision)
    scale = 1.0 / (1.0 + field.ambient)

    def rhs(t: Any, x: Vectors) -> tuple[Vectors, Any]:
        p = line.anchor + line.direction * t + x[0]
        if len(x) == 1:
            f, g = lookup.delta_and_gradient(p)
            f, g = f * scale, g * scale
            return (g * (1.0 + f),), f
        f, g, hessian = lookup.delta_gradient_hessian(p)
        f, g, hessian = f * scale, g * scale, hessian * scale
        carried = ((hessian @ w) * (1.0 + f) + g * dr.dot(g, w) for w in x[1:])
        return (g * (1.0 + f), *carried), f

    return rhs


def _run_straight(
    line: Straight, ray: BentRays, gap: Any, surface: Surface, remaining: Remaining, active: Any
) -> tuple[BentRays, Any]:
    """Move rays straight by dt = gap at most; also returns which of them were stopped.

    Those that nothing stops in an infinite gap stay where they are.
    """
    T = ray.tangent(line)
    left = remaining(line, ray)
    reach = dr.minimum(gap, dr.maximum(left, 0.0))
    met = surface.distance(ray.position(line), T, reach, active)
    hit = active & dr.isfinite(met) & (met <= reach)
    ended = active & ~hit & dr.isfinite(left) & (left <= gap)
    moved = ray.moved(
        dr.select(hit, met, dr.select(ended, left, dr.select(dr.isinf(gap), 0.0, gap)))
    )
    ray = dr.select(active, moved, ray)
    ray.status = dr.select(hit, int(RayStatus.HIT), ray.status)
    ray.status = dr.select(ended, int(RayStatus.ENDED), ray.status)
    return dr.select(hit, _onto_surface(line, ray, surface, hit), ray), hit | ended


def _onto_surface(line: Straight, ray: BentRays, surface: Surface, active: Any) -> BentRays:
    """Put rays that are within a micrometre or so of a surface onto it, by a straight piece."""
    T = ray.tangent(line)
    back = ray.moved(-LAST_PIECE_MM)
    length = dr.norm(T)
    met = surface.distance(back.position(line), T / length, 2.0 * LAST_PIECE_MM, active) / length
    return dr.select(dr.isfinite(met), back.moved(met), ray)


def _unit_tangent(line: Straight, ray: BentRays) -> BentRays:
    """Take |T| = 1 outside the field, without float32's cancellation."""
    d, tau = line.direction, ray.tau[0]
    excess = 2.0 * dr.dot(d, tau) + dr.squared_norm(tau)
    excess = excess / (1.0 + dr.sqrt(1.0 + excess))  # |T| - 1
    return replace(ray, tau=((tau - d * excess) / (1.0 + excess), *ray.tau[1:]))


def _box(field: Field, march: March) -> tuple[Any, Any]:
    """Corners of the field's box in the march's precision; opaque: one kernel for any box."""
    low, high = (dr.opaque(march.vector(*map(float, corner))) for corner in field.box)
    return low, high


def _slab(p: Any, direction: Any, box: tuple[Any, Any]) -> tuple[Any, Any]:
    """Where lines enter and leave a box, in units of the direction's length."""
    inverse = dr.rcp(dr.select(direction == 0.0, 1e-30, direction))
    one, two = (box[0] - p) * inverse, (box[1] - p) * inverse
    return dr.max(dr.minimum(one, two)), dr.min(dr.maximum(one, two))


def _within(p: Any, heading: Any, box: tuple[Any, Any]) -> Any:
    """Not out of the box: beyond a face and heading outward, so that none can hover at a border."""
    out = ((p <= box[0]) & (heading < 0.0)) | ((p >= box[1]) & (heading > 0.0))
    return ~dr.any(out)
