"""Air that leans to one side, as a plume does that sways: held at the part, and free above it."""

import math
from dataclasses import replace

import numpy as np
from numpy.typing import NDArray
from scipy.interpolate import CubicSpline

from virtual_sensor.errors import InputError
from virtual_sensor.medium.index_field import IndexField

Array = NDArray[np.float64]

STEEPEST_DEG = 45.0


def leaned(field: IndexField, angle_deg: float) -> IndexField:
    """Shear a field along its y, by an angle from the vertical: what lies at z = 0 stays.

    The air at height z moves by z times the angle's tangent, what lies in the solid included. The
    box grows by as much on both sides; mirror planes in y and z end.

    Parameters
    ----------
    field : IndexField
    angle_deg : float
        Towards +y above z = 0; 0: the same field object.

    Raises
    ------
    InputError
        If the angle is steeper than `STEEPEST_DEG`.
    """
    if angle_deg == 0.0:
        return field
    source = f"{field.source}, leaned by {angle_deg:g} degrees".removeprefix(", ")
    return replace(_sheared(field, angle_deg), source=source)


def lean_derivative(field: IndexField, angle_deg: float) -> IndexField:
    """The derivative of `leaned` by the angle, 1/deg, as a field in surroundings of zero.

    Parameters
    ----------
    field, angle_deg
        As those of `leaned`.

    Raises
    ------
    InputError
        As of `leaned`.
    """
    return replace(_sheared(field, angle_deg, derivative=True), ambient=0.0)


def _sheared(field: IndexField, angle_deg: float, *, derivative: bool = False) -> IndexField:
    """The sheared field or its derivative; along y the spline through the nodes is taken."""
    if not abs(angle_deg) <= STEEPEST_DEG:
        raise InputError(
            f"lean: the angle is {angle_deg:g} degrees; give one of at most {STEEPEST_DEG:g}"
        )
    slope = math.tan(math.radians(angle_deg))
    whole = _unfolded(field)
    steps, layers = (np.arange(count) for count in whole.shape[1:])
    z = whole.origin[2] + whole.spacing[2] * layers
    shift = slope * z / whole.spacing[1]
    beside = math.ceil(np.abs(shift).max())
    # In steps from the first node: where each new node of each layer lay before.
    place = np.arange(-beside, len(steps) + beside)[:, None] - shift
    piece = np.clip(np.floor(place).astype(int), 0, len(steps) - 2)
    spline = CubicSpline(steps, whole.nodes - whole.ambient, axis=1)
    if derivative:
        spline = spline.derivative()
    value: Array = np.zeros(())
    for coefficients in spline.c:  # of falling powers
        value = value * (place - piece)[..., None] + coefficients[piece, :, layers]
    if derivative:
        by_angle = math.radians(1.0) * (1.0 + slope**2) / whole.spacing[1]
        value *= -by_angle * z[:, None]
    held = (place >= 0.0) & (place <= len(steps) - 1)
    nodes = np.moveaxis(np.where(held[..., None], value, 0.0), -1, 0)
    origin = whole.origin - [0.0, beside * whole.spacing[1], 0.0]
    return whole.with_nodes(nodes + (0.0 if derivative else whole.ambient), origin)


def _unfolded(field: IndexField) -> IndexField:
    """The same field without mirror planes in y and z."""
    nodes, origin = field.nodes, field.origin.copy()
    for axis in (1, 2):
        if field.mirror[axis]:
            other = np.flip(np.delete(nodes, 0, axis), axis)
            nodes = np.concatenate([other, nodes], axis)
            origin[axis] -= other.shape[axis] * field.spacing[axis]
    whole = IndexField.from_arrays(
        nodes,
        origin,
        field.spacing,
        ambient=field.ambient,
        mirror=(field.mirror[0], False, False),
        source=field.source,
    )
    return replace(whole, pose=field.pose)
