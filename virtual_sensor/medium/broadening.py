"""Air that is broader than it was computed, as a coarse mesh makes it."""

import math
from collections.abc import Sequence
from dataclasses import replace

import numpy as np
from scipy import ndimage

from virtual_sensor.errors import InputError
from virtual_sensor.medium.index_field import IndexField

_REACH = 4  # standard deviations at which the Gaussian is cut off: 6e-5 of its weight lies beyond
_ACROSS = (1, 2)  # the axes y and z; along x, the cylinder's, a plume hardly changes


def blurred(field: IndexField, sigma_mm: float, reach: float = _REACH) -> IndexField:
    """Blur a field along its y and z, as a coarse mesh blurs a plume; not along x.

    The difference from the surrounding air is convolved with a Gaussian, so that its sum over all
    space stays the same.  Outside its box a field is the surrounding air: the box grows by what the
    Gaussian reaches on every side in y and z that is no mirror plane, and the blurred field ends at
    zero there, also where the one given ends with a jump.

    The smooth filling inside the solid is blurred along with the air, as if it were hot air too:
    next to the wall the field is no longer a solution of any flow.

    Parameters
    ----------
    field : IndexField
    sigma_mm : float
        Standard deviation of the Gaussian, mm; at most the field's extent in y and in z.  Below
        the distance of nodes the grid cannot show the blur well.  0: the same field object.
    reach : float
        Standard deviations at which the Gaussian is cut off, and scaled so that its weight is one.

    Raises
    ------
    InputError
        If the standard deviation is negative, not finite, or larger than the field.

    Notes
    -----
    Beermann et al. 2018 simulated on a mesh of several mm ("Broadened air" in
    `docs/how_to/own_air.md`).
    """
    if sigma_mm == 0.0:
        return field
    _check(field, sigma_mm)
    source = _told(field.source, f"blurred by {sigma_mm:g} mm")
    return replace(_filtered(field, sigma_mm, reach), source=source)


def blur_derivative(
    field: IndexField, sigma_mm: float, reach: float, axes: Sequence[int] = _ACROSS
) -> IndexField:
    """The derivative of `blurred`'s n - 1 by its standard deviation, 1/mm, as a field.

    Parameters
    ----------
    field, sigma_mm, reach
        As those of `blurred`.  Without a blur the derivative is zero: a small one acts by its
        square.
    axes : sequence of int
        Along which the standard deviation changes: 1 and 2, of y and z, or one of them.

    Raises
    ------
    InputError
        As of `blurred`.
    """
    if sigma_mm == 0.0:
        return replace(field.with_nodes(np.zeros(field.shape)), ambient=0.0)
    _check(field, sigma_mm)
    first, *others = (_filtered(field, sigma_mm, reach, axis) for axis in axes)
    nodes = sum((other.nodes for other in others), start=first.nodes)
    return replace(first.with_nodes(nodes), ambient=0.0)


def _check(field: IndexField, sigma_mm: float) -> None:
    extent = (field.box[1] - field.box[0])[list(_ACROSS)]
    if not 0.0 < sigma_mm <= extent.min():
        raise InputError(
            f"blur: the standard deviation is {sigma_mm:g} mm; give 0 (none) or a positive one of"
            f" at most {extent.min():g} mm, the field's extent"
        )


def _filtered(
    field: IndexField, sigma_mm: float, reach: float, by: int | None = None
) -> IndexField:
    """The blurred field; or its derivative by the standard deviation along one axis, 1/mm.

    The derivative's surroundings are those of the field still, but its nodes are around zero.
    """
    difference, origin = field.nodes - field.ambient, field.origin.copy()
    for axis in _ACROSS:
        step = field.spacing[axis]
        sigma = sigma_mm / step
        # One node more than the filter reaches: what it finds beyond the last is zero too.
        margin = math.ceil(reach * sigma) + 1
        before = 0 if field.mirror[axis] else margin
        width = [(0, 0)] * 3
        width[axis] = (before, margin)
        squares = np.arange(-int(reach * sigma + 0.5), int(reach * sigma + 0.5) + 1) ** 2
        weights = np.exp(-0.5 / sigma**2 * squares)
        weights /= weights.sum()
        if by == axis:
            weights *= (squares - weights @ squares) / (sigma**3 * step)
        difference = ndimage.correlate1d(np.pad(difference, width), weights, axis, mode="mirror")
        origin[axis] -= before * step
    return field.with_nodes(difference + (field.ambient if by is None else 0.0), origin)


def widened(field: IndexField, factor: float) -> IndexField:
    """Stretch a field along its y about y = 0: a wider plume whose middle stays as hot.

    Everything is stretched, the layer at the solid's wall and the filling inside the solid too,
    and the sum of the difference from the surrounding air grows by the factor.

    Parameters
    ----------
    field : IndexField
    factor : float
        Positive; 1: the same field object.

    Raises
    ------
    InputError
        If the factor is not positive and finite.
    """
    if factor == 1.0:
        return field
    if not 0.0 < factor < math.inf:
        raise InputError(f"widen: the factor is {factor:g}; give a positive one, 1 for none")
    source = _told(field.source, f"widened {factor:g} times along y")
    return IndexField.sum_of([(1.0, field)], stretch=(1.0, factor, 1.0), source=source)


def _told(source: str, what: str) -> str:
    return f"{source}, {what}" if source else what
