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
from typing import Any

from virtual_sensor.engine import dr, mi
from virtual_sensor.errors import InputError
from virtual_sensor.optics.ray_status import RayStatus
from virtual_sensor.optics.rays import BentRays, Field, March, Straight, Variation
from virtual_sensor.optics.steppers import CONTROLLED, STEPPERS, Rhs, Step, Vectors
from virtual_sensor.optics.surfaces import NoSurface, Surface, slab

LAST_PIECE_MM = 0.05
"""The last, straight segment of a ray onto a surface: so short that Mitsuba's float32 is exact."""

_BORDER_MM = 1e-3  # rays overstep the border by this, so that rounding can't hold them there
_SAFETY, _FACTOR = 0.9, 5.0  # of the step that the error estimate asks for; its largest change
_OVERLAP_MM = 1e-3  # chords overlap by this, so that no ray slips through between two


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
    variations: tuple[Variation, ...] = (),
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
    variations : tuple of Variation
        Derivatives of the field, and of its ambient, by any parameters; at least as large as its
        box.  Each gives one more tangent, of rays whose start stays.
    active : mask
        The rays to march; the others stay where they are with status LEFT.

    Raises
    ------
    InputError
        If a variation is moved otherwise than the field.
    """
    if field and any(variation.pose != field.pose for variation in variations):
        raise InputError("bend: a field and its variations must be moved by the same motions")
    width = dr.width(line.start)
    mask = dr.full(mi.Mask, True, width) & active
    zero = dr.zeros(march.scalar, width)
    none = dr.zeros(march.vector, width)
    tangents = (*tangents, *((none, none) for _ in variations))
    task = _Task(surface, line, march, remaining, tangents)
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
        air = _Air(field, march)
        varied = [_Varied(each, air, march) for each in variations]
        near, far = air.crossings(ray.position(line), line.direction)
        meets = mask & (near < far) & (far > 0.0)
        gap = dr.select(meets & (near > 0.0), near + _BORDER_MM, 0.0)
        ray, stopped = _run_straight(task, ray, gap, meets)
        meets &= ~stopped
        ray = _march(field.ambient, air, varied, task, ray, meets)
        mask &= ~stopped & (ray.status == int(RayStatus.LEFT))
    ray, _ = _run_straight(task, ray, never(line, ray), mask)
    against = dr.dot(line.direction, ray.tangent(line)) < 0.0
    ray.status[(ray.status == int(RayStatus.LEFT)) & against] = int(RayStatus.TURNED_BACK)
    return ray


@dataclass(frozen=True)
class _Task:
    """What is marched, and where to; see `bend`."""

    surface: Surface
    line: Straight
    march: March
    remaining: Remaining
    tangents: tuple[tuple[Any, Any], ...]


class _Air:
    """A field as rays of the world meet it: one that was moved is looked up in its own frame."""

    def __init__(self, field: Variation, march: March) -> None:
        self._lookup: Any = field.lookup(march.precision)
        # Opaque: one kernel for all boxes and poses.
        low, high = (dr.opaque(march.vector(*map(float, corner))) for corner in field.box)
        self._box = low, high
        self._axes: Any = None  # the columns of a matrix
        if field.pose is not None:
            self._axes = dr.opaque(dr.matrix_t(march.vector)(field.pose.rotation.tolist()))
            self._origin = dr.opaque(march.vector(*map(float, field.pose.origin_mm)))

    @property
    def diagonal_mm(self) -> Any:
        return dr.norm(self._box[1] - self._box[0])

    def crossings(self, p: Any, direction: Any) -> tuple[Any, Any]:
        """Where lines enter and leave it, in units of the direction's length."""
        if self._axes is not None:
            direction = self._axes.T @ direction
        return slab(self.local(p), direction, self._box)

    def delta_and_gradient(self, p: Any) -> tuple[Any, Any]:
        """See `Lookup`."""
        f, g = self._lookup.delta_and_gradient(self.local(p))
        return f, self.in_world(g)

    def delta_gradient_hessian(self, p: Any) -> tuple[Any, Any, Any]:
        """See `Lookup`."""
        f, g, hessian = self._lookup.delta_gradient_hessian(self.local(p))
        if self._axes is None:
            return f, g, hessian
        return f, self._axes @ g, self._axes @ hessian @ self._axes.T

    def local(self, p: Any) -> Any:
        """Points of the world in the field's frame."""
        return p if self._axes is None else self._axes.T @ (p - self._origin)

    def in_world(self, v: Any) -> Any:
        """Vectors of the field's frame in the world's."""
        return v if self._axes is None else self._axes @ v


class _Varied:
    """A derivative of the air, as rays meet it: of the index relative to the surroundings.

    It stands where the air stands, so that both look up the same place, only once.
    """

    def __init__(self, derivative: Variation, air: _Air, march: March) -> None:
        self._lookup = derivative.lookup(march.precision)
        self._air = air
        by_ambient = derivative.ambient
        self._by_ambient = dr.opaque(march.scalar, by_ambient) if by_ambient else None

    def of_relative(self, p: Any, f: Any, g: Any) -> tuple[Any, Any]:
        """Value and gradient, times 1 + ambient, where those of the air, relative, are f and g."""
        by_f, by_g = self._lookup.delta_and_gradient(self._air.local(p))
        by_g = self._air.in_world(by_g)
        if self._by_ambient is None:
            return by_f, by_g
        return by_f - self._by_ambient * f, by_g - self._by_ambient * g


def _march(
    ambient: float, air: _Air, varied: list[_Varied], task: _Task, ray: BentRays, active: Any
) -> BentRays:
    """From the border (or from inside) through the field, step by step."""
    surface, line, march, remaining = task.surface, task.line, task.march, task.remaining
    rhs = _right_hand_side(ambient, air, varied, task)
    controlled = march.method in CONTROLLED
    stops = not isinstance(surface, NoSurface)  # where nothing does, a tenth of a step is spared
    longest = dr.opaque(march.scalar, march.step_mm)  # one kernel for any step
    tolerance = dr.opaque(march.scalar, march.tolerance_mm)
    lever = air.diagonal_mm  # a wrong slope leads astray far beyond
    close = 1e-4 if march.precision == "single" else 1e-9

    def step(ray: BentRays, h: Any) -> BentRays:
        return _ahead(ray, h, STEPPERS[march.method](rhs, ray.t, ray.offset, ray.tau, h))

    def controlled_step(ray: BentRays, h: Any, pace: "_Pace") -> tuple[BentRays, Any, "_Pace"]:
        """The step, whether it is good enough to be taken, and how to go on."""
        taken, (apart, turned), last = CONTROLLED[march.method](
            rhs, ray.t, ray.offset, ray.tau, h, pace.slope
        )
        error = dr.maximum(apart, turned * lever)
        good = error <= tolerance  # not so where it is NaN
        ratio = dr.maximum(error, 1e-30) / tolerance
        stride = dr.abs(h) * dr.clip(_SAFETY * ratio**-0.2, 1 / _FACTOR, _FACTOR)
        cut = good & (dr.abs(h) < pace.stride)  # by a border or an end: no reason to slow down
        stride = dr.select(cut, pace.stride, dr.minimum(stride, longest))
        return _ahead(ray, h, taken), good, _Pace(stride, dr.select(good, last, pace.slope))

    def ahead_of(ray: BentRays) -> tuple[Any, Any]:
        """Signed dt to the place where a ray is asked to end; dt to the border, above 0 inside."""
        return remaining(line, ray), air.crossings(ray.position(line), ray.tangent(line))[1]

    def body(
        ray: BentRays, moving: Any, chord: Any, count: Any, pace: Any, left: Any, out: Any
    ) -> tuple[Any, ...]:
        stride = pace.stride if controlled else longest
        h = dr.minimum(stride, out + 2.0 * _BORDER_MM)
        h = dr.select(left < h, dr.maximum(left, -stride), h)
        if controlled:
            ahead, good, pace = controlled_step(ray, h, pace)
        else:
            ahead, good = step(ray, h), True
        if stops:
            secant = line.direction * h + (ahead.offset[0] - ray.offset[0])
            length = dr.norm(secant)
            forward = moving & good & (h > 0.0)
            met = surface.distance(
                ray.position(line), secant / length, length + _OVERLAP_MM, forward
            )
            hit = forward & (met <= length + _OVERLAP_MM)
            chord = dr.select(hit, h * met / length, chord)
            ray.status = dr.select(hit, int(RayStatus.HIT), ray.status)
            moving = moving & ~hit
        ray = dr.select(moving & good, replace(ahead, status=ray.status), ray)
        left, out = ahead_of(ray)
        arrived = moving & (dr.abs(left) <= close)
        ray.status = dr.select(arrived, int(RayStatus.ENDED), ray.status)
        return ray, moving & ~arrived & ~(out <= 0.0), chord, count + 1, pace, left, out

    f, g = air.delta_and_gradient(ray.position(line))
    f, g = f / (1.0 + ambient), g / (1.0 + ambient)
    d = line.direction
    at_start = [  # T = n d, and its derivatives
        ray.tau[0] + d * f,
        *(v + v * f + d * dr.dot(g, x) for x, v in zip(ray.offset[1:], ray.tau[1:], strict=True)),
    ]
    for i, variation in enumerate(varied, start=len(at_start) - len(varied)):
        by_f, _ = variation.of_relative(ray.position(line), f, g)
        at_start[i] = at_start[i] + d * (by_f / (1.0 + ambient))
    ray = dr.select(active, replace(ray, tau=tuple(at_start)), ray)
    pace = _Pace(longest + 0.0 * ray.t, rhs(ray.t, ray.offset)) if controlled else ()
    most = dr.opaque(mi.UInt32, march.max_steps)
    chord = dr.zeros(march.scalar, dr.width(active)) if stops else ()
    ray, moving, chord, *_ = dr.while_loop(
        (ray, active, chord, mi.UInt32(0), pace, *ahead_of(ray)),
        lambda ray, moving, chord, count, *_: moving & (count < most),
        body,
        labels=("ray", "moving", "chord", "count", "pace", "left", "out"),
    )
    ray.status[moving] = int(RayStatus.OUT_OF_STEPS)
    if stops:
        hit = active & (ray.status == int(RayStatus.HIT))
        ray = dr.select(hit, _onto_surface(line, step(ray, chord), surface, hit), ray)
    ended = active & (ray.status == int(RayStatus.ENDED))
    ray = dr.select(ended, ray.moved(remaining(line, ray)), ray)
    out = active & (ray.status == int(RayStatus.LEFT))
    return dr.select(out, _unit_tangent(line, ray), ray)


@dataclass
class _Pace:
    """How a ray goes on under step control: the next step in t, and the slope where it is."""

    stride: Any
    slope: Any


def _ahead(ray: BentRays, h: Any, step: Step) -> BentRays:
    """The rays after a step."""
    offset, tau, arc, path = step
    return replace(
        ray, t=ray.t + h, offset=offset, tau=tau, arc=ray.arc + arc, path=ray.path + path
    )


def _right_hand_side(ambient: float, air: _Air, varied: list[_Varied], task: _Task) -> Rhs:
    """The steppers' rhs: n grad n at the ray, and its derivative for each tangent."""
    line, march = task.line, task.march
    scale = 1.0 / (1.0 + ambient)
    starts = ((dr.zeros(march.vector), dr.zeros(march.vector)), *task.tangents)

    def rhs(t: Any, x: Vectors) -> tuple[Vectors, Any]:
        if march.first_order:  # where the straight ray is, and its neighbours
            x = tuple(x0 + v0 * (t - line.start) for x0, v0 in starts)
        p = line.anchor + line.direction * t + x[0]
        if len(x) == 1:
            f, g = air.delta_and_gradient(p)
            f, g = f * scale, g * scale
            return (g * (1.0 + f),), f
        f, g, hessian = air.delta_gradient_hessian(p)
        f, g, hessian = f * scale, g * scale, hessian * scale
        carried = [(hessian @ w) * (1.0 + f) + g * dr.dot(g, w) for w in x[1:]]
        for i, variation in enumerate(varied, start=len(carried) - len(varied)):
            by_f, by_g = variation.of_relative(p, f, g)
            carried[i] = carried[i] + (by_g * (1.0 + f) + g * by_f) * scale
        return (g * (1.0 + f), *carried), f

    return rhs


def _run_straight(task: _Task, ray: BentRays, gap: Any, active: Any) -> tuple[BentRays, Any]:
    """Move rays straight by dt = gap at most; also returns which of them were stopped.

    Those that nothing stops in an infinite gap stay where they are.
    """
    line, surface = task.line, task.surface
    T = ray.tangent(line)
    left = task.remaining(line, ray)
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
    """Put rays that are within a micrometre or so of a surface onto it, by a straight segment."""
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
