"""Ray families in Dr.Jit: the formulas of `ray_families` with opaque poses and parameters."""

import copy
from dataclasses import dataclass, fields
from typing import Any

from virtual_sensor.display import Displayed
from virtual_sensor.engine import dr
from virtual_sensor.optics.ray_families import RayFamily


@dataclass(frozen=True)
class FamilyFrame(Displayed):
    """A family's rays and frame for one of Dr.Jit's vector types.

    Attributes
    ----------
    family : RayFamily
        With Dr.Jit's numbers for parameters: its formulas serve Dr.Jit's arrays.
    x, y, z : vector
        Unit axes of the frame, world; z along the light or the sight.
    centre : tuple of three scalars
        The frame's origin along each axis, mm.
    """

    family: RayFamily
    x: Any
    y: Any
    z: Any
    centre: tuple[Any, Any, Any]

    @staticmethod
    def of(family: RayFamily, vector: Any, *, opaque: bool = True) -> "FamilyFrame":
        """Take over a family in the precision of a vector type.

        Opaque, one kernel serves all poses and parameters of a kind of family; within a kernel that
        is being recorded, numbers can't be made opaque.
        """
        scalar = type(vector().x)

        def number(value: float) -> Any:
            return dr.opaque(scalar, float(value)) if opaque else scalar(float(value))

        parameters = copy.copy(family)
        for f in fields(family):  # type: ignore[arg-type]
            value = getattr(family, f.name)
            if isinstance(value, int | float) and not isinstance(value, bool):
                object.__setattr__(parameters, f.name, number(value))
        rotation = family.pose.rotation
        x, y, z = (vector(*(number(v) for v in rotation[:, i])) for i in range(3))
        a, b, c = (number(v) for v in family.pose.origin_mm @ rotation)
        return FamilyFrame(parameters, x, y, z, (a, b, c))

    def local(self, p: Any) -> tuple[Any, Any, Any]:
        """x, y and depth of world points, mm."""
        x, y, z = self.centre
        return dr.dot(self.x, p) - x, dr.dot(self.y, p) - y, dr.dot(self.z, p) - z

    def world(self, x: Any, y: Any, depth: Any) -> Any:
        """World points of places in the frame, mm."""
        a, b, c = self.centre
        return self.x * (x + a) + self.y * (y + b) + self.z * (depth + c)

    def coordinates(self, p: Any) -> tuple[Any, Any, Any]:
        """(s, t, depth) of the straight rays through world points."""
        x, y, depth = self.local(p)
        return *self.family.straight(x, y, depth), depth

    def heading(self, along_x: Any, along_y: Any) -> Any:
        """Unit directions, world, of slopes dx/dz and dy/dz."""
        return dr.normalize(self.z + self.x * along_x + self.y * along_y)

    def rays(self, s: Any, t: Any) -> tuple[Any, Any, tuple[tuple[Any, Any], tuple[Any, Any]]]:
        """Origins and unit directions, world, and the derivatives of both by s and by t."""
        none = type(self.z.x)(0.0) * (s + t)  # all are as wide as the coordinates
        x, y = self.family.foot(s, t)
        along_x, along_y = self.family.slope(s, t)
        slope = self.z + self.x * (along_x + none) + self.y * along_y
        length = dr.norm(slope)
        unit = slope / length
        near, turn = self.family.starts_by_coordinates(s, t)

        def derivative(i: int) -> tuple[Any, Any]:
            shift, change = (self.x * (by[i] + none) + self.y * by[i + 2] for by in (near, turn))
            change = change / length
            return shift, change - unit * dr.dot(unit, change)

        return self.world(x + none, y, 0.0), unit, (derivative(0), derivative(1))
