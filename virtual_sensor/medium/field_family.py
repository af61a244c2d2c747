"""Air at a wall temperature between those that were computed, and how it changes with it."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass

import numpy as np
from numpy.polynomial import Polynomial

from virtual_sensor.display import Displayed
from virtual_sensor.errors import InputError
from virtual_sensor.medium.index_field import IndexField

_BEYOND = 0.05  # of the temperatures' span


@dataclass(frozen=True)
class FieldFamily(Displayed):
    """Fields of one flow at several wall temperatures, on one grid and in the same surroundings.

    Between them, and a twentieth of their span beyond, every node follows the polynomial through
    its values, in Lagrange's form. The bound of its error is there no larger than in between; an
    estimate of the temperature of the hottest field has room on both sides.

    Attributes
    ----------
    fields : mapping from float to IndexField
        By wall temperature in degC; at least two.

    Raises
    ------
    InputError
        If they are too few, or do not share grid, mirror planes and ambient.
    """

    fields: Mapping[float, IndexField]

    def __post_init__(self) -> None:
        if len(self.fields) < 2:
            raise InputError("a family of fields needs those of two wall temperatures at least")
        (at, first), *others = self.fields.items()
        for temperature, field in others:
            kinds = [(each.shape, each.mirror, each.pose) for each in (field, first)]
            if kinds[0] != kinds[1] or not np.allclose(
                [*field.box.ravel(), *field.spacing],
                [*first.box.ravel(), *first.spacing],
                rtol=1e-9,
                atol=1e-9,
            ):
                raise InputError(
                    f"the fields of {at:g} and {temperature:g} degC differ in their grids (shape,"
                    " origin, spacing, mirror planes or pose); bring them onto one grid first"
                )
            if not np.isclose(field.ambient, first.ambient, rtol=1e-9, atol=0.0):
                raise InputError(
                    f"the fields of {at:g} and {temperature:g} degC have different surroundings:"
                    f" n - 1 is {first.ambient:.6g} and {field.ambient:.6g}; give the same air"
                )

    def _line(self) -> str:
        temperatures = ", ".join(f"{temperature:g}" for temperature in self.fields)
        return f"fields at {temperatures} degC"

    @property
    def limits(self) -> tuple[float, float]:
        """Lowest and highest wall temperature that it has air of, degC."""
        low, high = min(self.fields), max(self.fields)
        beyond = _BEYOND * (high - low)
        return low - beyond, high + beyond

    def at(self, temperature_c: float) -> IndexField:
        """The field at a wall temperature, degC.

        Raises
        ------
        InputError
            If it is not within `limits`.
        """
        weights = [float(p(temperature_c)) for p in self._weights(temperature_c)]
        known = ", ".join(f"{t:g}" for t in self.fields)
        source = f"by those of {known} degC: {temperature_c:g}"
        parts = [*zip(weights, self.fields.values(), strict=True)]
        return IndexField.sum_of(parts, source=source)

    def derivative(self, temperature_c: float) -> IndexField:
        """The derivative of n - 1 by the wall temperature, 1/K, there, as a field.

        Raises
        ------
        InputError
            If the temperature is not within `limits`.
        """
        weights = [float(p.deriv()(temperature_c)) for p in self._weights(temperature_c)]
        return IndexField.sum_of([*zip(weights, self.fields.values(), strict=True)], ambient=0.0)

    def _weights(self, temperature_c: float) -> list[Polynomial]:
        """Lagrange's polynomials, one for each of the family's temperatures."""
        low, high = self.limits
        if not low <= temperature_c <= high:
            raise InputError(
                f"{temperature_c:g} degC is not between {low:g} and {high:g} degC, what the fields"
                f" of {', '.join(f'{t:g}' for t in sorted(self.fields))} degC allow; give a field"
                " beyond it"
            )
        others = {t: [other for other in self.fields if other != t] for t in self.fields}
        roots = {t: Polynomial.fromroots(each) for t, each in others.items()}
        return [roots[t] / roots[t](t) for t in self.fields]
