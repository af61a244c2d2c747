"""How fine a field's grid is: its narrowest structures in nodes, and what fewer nodes lose."""

from collections.abc import Callable
from dataclasses import dataclass, field

import numpy as np
from numpy.typing import NDArray
from scipy import ndimage

from virtual_sensor.medium.index_field import IndexField
from virtual_sensor.medium.spline import MIN_NODES
from virtual_sensor.records import Record

Array = NDArray[np.float64]
Mask = NDArray[np.bool_]

COARSE_PX = 0.1
"""Error that a grid may cause: what a measurement must resolve; `FINE_PX` is what it can."""

WALL_NODES = 4
"""Air within so many nodes of the solid is the wall layer: there a spline feels the fill inside."""

_NOTABLE = 0.1  # of the largest difference from ambient: what is less is no structure to resolve


@dataclass(frozen=True)
class Structure(Record):
    """The narrowest rise or dip of n - 1 along one axis.

    Attributes
    ----------
    axis : str
        Of the grid.
    at_wall : bool
        Whether its peak lies in the wall layer or in the air beyond.
    half_width_mm : float
        From its peak to where half of the difference from ambient is left.
    half_width_nodes : float
        The same in distances of nodes.
    peak_mm : ndarray
        Where its peak is, in the field's frame.
    """

    axis: str
    at_wall: bool
    half_width_mm: float
    half_width_nodes: float
    peak_mm: Array


@dataclass(frozen=True)
class Richardson(Record):
    """What is lost with fewer nodes, and by Richardson's extrapolation what the present ones lose.

    With an error C h^p the changes are C h^p (2^p - 1) and C h^p (4^p - 1).

    Attributes
    ----------
    every_2nd, every_4th : float
        Change with every second and with every fourth node; nothing if there are too few nodes.
    order : float
        The observed p; nothing if the two changes don't show one.
    present : float
        Error of the present grid, with p between 1 and a cubic spline's gradient's 3.
    """

    every_2nd: float
    every_4th: float
    order: float = field(init=False)
    present: float = field(init=False)

    def __post_init__(self) -> None:
        with np.errstate(divide="ignore", invalid="ignore"):
            order = float(np.log2(np.divide(self.every_4th, self.every_2nd) - 1.0))
        likely = np.clip(np.nan_to_num(order, nan=1.0, posinf=3.0, neginf=1.0), 1.0, 3.0)
        object.__setattr__(self, "order", order)
        object.__setattr__(self, "present", float(self.every_2nd / (2.0**likely - 1.0)))

    @property
    def converges(self) -> bool:
        """False where structures are as narrow as the grid, such as kinks and noise."""
        return not self.every_4th < 3.0 * self.every_2nd


@dataclass(frozen=True)
class Loss(Record):
    """What a field loses when it is stored with fewer nodes along some axes.

    Attributes
    ----------
    axes : str
        Such as "y", or "xyz" for all together.
    largest_refractivity : float
        Change of n - 1 with every second node: largest, in the air beyond the wall layer.
    rms_refractivity : Richardson
        Root mean square of the same.
    shift_px : Richardson or None
        Largest shift of the probe rays' pixels; None without a scene.
    """

    axes: str
    largest_refractivity: float
    rms_refractivity: Richardson
    shift_px: Richardson | None


def beyond_wall(field: IndexField, solid: Mask | None) -> Mask:
    """Nodes (nx, ny, nz) in the air beyond the wall layer."""
    if solid is None or not solid.any():
        return np.ones(field.shape, bool)
    return np.asarray(ndimage.distance_transform_edt(~solid) > WALL_NODES)


def narrowest_structures(field: IndexField, solid: Mask | None) -> tuple[Structure, ...]:
    """The narrowest structure along each axis, in the wall layer and beyond it."""
    difference = np.abs(field.nodes - field.ambient)
    beyond = beyond_wall(field, solid)
    air = np.ones(field.shape, bool) if solid is None else ~solid
    found = [
        _narrowest(field, np.where(air, difference, np.nan), peaks, axis, at_wall)
        for at_wall, peaks in ((False, beyond), (True, air & ~beyond))
        for axis in range(3)
    ]
    return tuple(structure for structure in found if structure)


def _narrowest(
    field: IndexField, difference: Array, peaks: Mask, axis: int, at_wall: bool
) -> Structure | None:
    """The narrowest structure along an axis among those whose peak is in a mask."""
    allowed = np.where(peaks, difference, -np.inf)
    if not allowed.max() > 0.0:
        return None
    lines, heights = (np.moveaxis(a, axis, 0) for a in (difference, allowed))
    shape, unfolded = lines.shape[1:], 0
    if field.mirror[axis]:
        unfolded = len(lines) - 1
        lines, heights = (np.concatenate([a[:0:-1], a]) for a in (lines, heights))
    lines, heights = (a.reshape(len(a), -1) for a in (lines, heights))
    peak = heights.argmax(axis=0)
    height = heights.max(axis=0)
    # A wall layer's flank that reaches into the mask is no structure of its own.
    beside = np.pad(lines, ((1, 1), (0, 0)), constant_values=np.nan)
    column = np.arange(len(peak))
    is_peak = ~(beside[peak, column] > height) & ~(beside[peak + 2, column] > height)
    is_peak &= height >= _NOTABLE * allowed.max()
    sides = np.stack(
        [_to_half(lines, peak, height), _to_half(lines[::-1], len(lines) - 1 - peak, height)]
    )
    known = np.isfinite(sides)
    width = np.where(known, sides, 0.0).sum(axis=0) / np.maximum(known.sum(axis=0), 1)
    width[~is_peak | ~known.any(axis=0)] = np.inf
    best = int(width.argmin())
    if not np.isfinite(width[best]):
        return None
    node = np.insert(np.array(np.unravel_index(best, shape)), axis, abs(peak[best] - unfolded))
    return Structure(
        "xyz"[axis],
        at_wall,
        float(width[best] * field.spacing[axis]),
        float(width[best]),
        field.origin + node * field.spacing,
    )


def _to_half(lines: Array, peak: NDArray[np.int64], height: Array) -> Array:
    """Nodes from each line's peak upward to half its height; infinite if it ends before that."""
    number = np.arange(len(lines))[:, None]
    ended = ~(lines >= 0.5 * height) & (number > peak)
    there, column = ended.argmax(axis=0), np.arange(lines.shape[1])
    inner, outer = lines[there - 1, column], lines[there, column]
    with np.errstate(divide="ignore", invalid="ignore"):
        reach = there - 1 + (inner - 0.5 * height) / (inner - outer) - peak
    return np.where(ended.any(axis=0) & np.isfinite(outer), reach, np.inf)


def pixel_loss(
    field: IndexField, solid: Mask | None, pixels: Callable[[IndexField], Array]
) -> Richardson:
    """What a field's grid loses along all axes together, in px of some rays.

    `solid` are the nodes that come from the air around, if any; `pixels` gives the pixels (N, 2) of
    the rays through a field, or what of their shifts counts.
    """
    every = _thinner(field, solid)
    whole = every(1)
    assert whole
    same = (whole.interpolation, whole.dimensions) == (field.interpolation, field.dimensions)
    # The field itself is prepared for rays already.
    through_whole = pixels(field if same and np.array_equal(whole.nodes, field.nodes) else whole)

    def shift(k: int) -> float:
        fewer = every(k)
        return furthest(pixels(fewer) - through_whole) if fewer else np.nan

    return Richardson(shift(2), shift(4))


def furthest(moved: Array) -> float:
    """Largest of some shifts (N, C); NaN if no ray is found."""
    return float(np.fmax.reduce(np.linalg.norm(moved, axis=1), initial=np.nan))


def _thinner(field: IndexField, solid: Mask | None) -> Callable[..., IndexField | None]:
    """A function that gives the field of every k-th node along some axes, None if they are too few.

    Cut to whole cells of the widest grid, so that all the fields have the same box; `solid` are the
    nodes that are filled again.
    """
    widest = {
        k: [k if (n - 1) // k + 1 >= MIN_NODES else 1 for n in field.shape] for k in (1, 2, 4)
    }
    cells = np.max(list(widest.values()), axis=0)
    common = tuple(slice((n - 1) // k * k + 1) for n, k in zip(field.shape, cells, strict=True))

    def every(k: int, axes: str = "xyz") -> IndexField | None:
        steps = [s if axis in axes else 1 for axis, s in zip("xyz", widest[k], strict=True)]
        if max(steps) < k:
            return None
        some = tuple(slice(None, None, step) for step in steps)
        return field.with_nodes(
            field.nodes[common][some],
            spacing_mm=field.spacing * steps,
            solid=None if solid is None else solid[common][some],
        )

    return every


def grid_losses(
    field: IndexField,
    solid: Mask | None,
    filled: bool,
    pixels: Callable[[IndexField], Array] | None,
    report: Callable[[float], None] = lambda fraction: None,
) -> tuple[Loss, ...]:
    """What a field loses with every second and fourth node, along each axis and along all.

    Parameters
    ----------
    field : IndexField
    solid : ndarray of bool of shape (nx, ny, nz) or None
        Of the part, as far as it is known.
    filled : bool
        Whether the solid's nodes come from the air around, as they will again with fewer nodes; or
        from the file.
    pixels : callable or None
        Gives the pixels (N, 2) of some rays through a field.
    report : callable
        Called with the fraction done.
    """
    every = _thinner(field, solid if filled else None)
    whole = every(1)
    assert whole
    kept = tuple(map(slice, whole.shape))
    compared = beyond_wall(whole, None if solid is None else solid[kept])
    points = whole.to_world(whole.origin + np.argwhere(compared) * whole.spacing)
    values = whole.nodes[compared]
    pixels_of = pixels or (lambda other: np.full((1, 2), np.nan))
    through_whole = pixels_of(whole)

    def change(axes: str, k: int) -> tuple[float, float, float]:
        """Return largest and rms change of n - 1, and the largest shift in px."""
        fewer = every(k, axes)
        if fewer is None:
            return np.nan, np.nan, np.nan
        delta = np.abs(fewer.refractivity(points) - values)
        shift = furthest(pixels_of(fewer) - through_whole)
        return float(delta.max()), float(np.sqrt(np.mean(delta**2))), shift

    losses = []
    for number, axes in enumerate(("x", "y", "z", "xyz")):
        report(number / 4.0)
        second, fourth = change(axes, 2), change(axes, 4)
        shift_px = Richardson(second[2], fourth[2]) if pixels else None
        losses.append(Loss(axes, second[0], Richardson(second[1], fourth[1]), shift_px))
    return tuple(losses)
