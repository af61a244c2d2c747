"""How a field changes with a parameter, at every place: exact, without nodes of its own if it can.

A change of contrast, and one that stretches or moves the air, are made of the field's own value,
gradient and Hessian, which its spline has exactly.
"""

from __future__ import annotations

from dataclasses import dataclass, replace
from typing import Any

import numpy as np

from virtual_sensor.display import listed
from virtual_sensor.engine import dr, mi
from virtual_sensor.medium.evaluated import Evaluated
from virtual_sensor.medium.index_field import IndexField
from virtual_sensor.poses import Pose


@dataclass(frozen=True, eq=False)
class FieldDerivative(Evaluated):
    """The derivative of n - 1 by a parameter, where the field is D more than its surroundings.

    At a place r of the field's frame it is ``share D + (stretch r + shift) . grad D``, and what
    `nodes` adds to that. `refractivity` and `gradient` give it and its gradient at points; the
    march of rays takes it as it takes a field.

    Attributes
    ----------
    field : IndexField
        At which it is taken.
    share : float
        Per unit of the parameter.
    stretch : ndarray of shape (3,)
        Along x, y and z, per unit of the parameter: -1/w of a field widened by w.
    shift : ndarray of shape (3,)
        Per unit of the parameter, mm: -1 along y of a field that moves along y.
    nodes : IndexField or None
        On the field's grid, in surroundings of zero: what changes at the nodes.
    ambient : float
        Derivative of the surroundings' n - 1.
    """

    field: Any  # or what else has a lookup
    share: float = 0.0
    stretch: np.ndarray | None = None
    shift: np.ndarray | None = None
    nodes: IndexField | None = None
    ambient: float = 0.0

    def _line(self) -> str:
        moves = self.stretch is not None or self.shift is not None
        parts = ["contrast"] * bool(self.share) + ["place"] * moves
        parts += ["nodes"] * (self.nodes is not None)
        return listed(f"by {' and '.join(parts) or 'nothing'}", f"of {self.field!r}")

    @property
    def box(self) -> np.ndarray:
        """Lowest and highest corner in the field's frame: (2, 3), mm."""
        box: np.ndarray = self.field.box
        return box

    @property
    def pose(self) -> Pose | None:  # type: ignore[override]
        """The field's."""
        pose: Pose | None = self.field.pose
        return pose

    def moved(self, motion: Pose) -> FieldDerivative:
        """The derivative of the moved field."""
        return replace(self, field=self.field.moved(motion))

    def lookup(self, precision: str) -> _Lookup:
        """See `IndexField.lookup`."""
        return _Lookup(self, precision)


class _Lookup:
    """See `GridLookup`: positions are those of the field's frame, inside the box."""

    def __init__(self, of: FieldDerivative, precision: str) -> None:
        vector = mi.Array3f64 if precision == "double" else mi.Array3f
        scalar = mi.Float64 if precision == "double" else mi.Float
        self._vector = vector
        self._field = of.field.lookup(precision)
        self._nodes = of.nodes.lookup(precision) if of.nodes is not None else None
        # Opaque: one kernel for any numbers, and for all changes without nodes.
        self._share = dr.opaque(scalar, of.share)
        self._stretch, self._shift = (
            dr.opaque(vector(*(np.zeros(3) if each is None else each).tolist()))
            for each in (of.stretch, of.shift)
        )

    def delta(self, p: Any) -> Any:
        """The derivative, less that of the surroundings."""
        return self.delta_and_gradient(p)[0]

    def delta_and_gradient(self, p: Any) -> tuple[Any, Any]:
        """It, and its gradient, in a vector of `p`'s type."""
        f, g, hessian = self._field.delta_gradient_hessian(p)
        by = type(p)(*(self._stretch[i] * p[i] + self._shift[i] for i in range(3)))
        by_stretch = type(p)(*(self._stretch[i] * g[i] for i in range(3)))
        value = dr.fma(self._share, f, dr.dot(by, g))
        gradient = g * self._share + hessian @ by + by_stretch
        if self._nodes is not None:
            f, g = self._nodes.delta_and_gradient(p)
            value, gradient = value + f, gradient + g
        return value, gradient
