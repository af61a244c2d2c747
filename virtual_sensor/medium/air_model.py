"""Air with a few free parameters: a family of fields, and what makes others of them."""

from __future__ import annotations

from collections.abc import Iterable, Mapping
from dataclasses import dataclass, field, replace
from typing import Any

import numpy as np

from virtual_sensor.arrays import number_within
from virtual_sensor.calls import public
from virtual_sensor.display import Displayed, listed
from virtual_sensor.errors import InputError, nearest, short
from virtual_sensor.medium.broadening import blur_derivative, blurred, widened
from virtual_sensor.medium.field_derivative import FieldDerivative
from virtual_sensor.medium.field_family import FieldFamily
from virtual_sensor.medium.index_field import IndexField
from virtual_sensor.medium.leaning import STEEPEST_DEG, lean_derivative, leaned
from virtual_sensor.medium.units import LEAST_PA, MOST_PA
from virtual_sensor.poses import Pose

_REACH = 6.0  # standard deviations: where the Gaussian ends, its weight is 2e-9, and none is felt


@dataclass(frozen=True)
class AirParameter(Displayed):
    """What can be asked of air, and what is known of it before an image is seen.

    Attributes
    ----------
    name : str
    unit : str
        "" of a plain factor.
    default : float
        At which the fields stay what they are.
    start : float
        Where an estimate starts: where the default is one at which nothing changes with it.
    low, high : float
        Least and largest value that is allowed.
    sigma : float
        Standard deviation of a prior about the default, for whoever knows no better.
    words : str
        What it does.
    """

    name: str
    unit: str
    default: float
    start: float
    low: float
    high: float
    sigma: float
    words: str

    def _line(self) -> str:
        unit = f" {self.unit}".rstrip()
        return (
            f"{self.name} {self.default:g}{unit} (of {self.low:g} to {self.high:g}), {self.words}"
        )


@public
@dataclass(frozen=True)
class AirModel(Displayed):
    """Fields as data, and transforms that make other air of them, with exact derivatives.

    In this order, in the field's own frame:

    1. ``temperature``, degC: the field of this wall temperature, by those of a family;
    2. ``lean``, degrees: the air is sheared along y, and stays where z = 0, as a plume that sways;
    3. ``width``, a factor: then stretched along y about y = 0;
    4. ``blur``, mm: then blurred in y and z by a Gaussian of this standard deviation;
    5. ``offset`` and ``height``, mm: then moved along y and z, what lies in the solid included;
    6. ``scale``, a factor at the difference from the surrounding air;
    7. ``pressure``, Pa: n - 1 goes with it, of the surrounding air too; the flow stays.

    Attributes
    ----------
    fields : FieldFamily or IndexField
        Fields of several wall temperatures, or one field.
    temperature_c : float or None
        Of the wall, unless another is given; by default the middle of the family's.

    Raises
    ------
    InputError
        If there is no field of nodes, or the temperature is not within the family's limits.

    Examples
    --------
    >>> fields = {t: vs.IndexField.read(f"hot_cylinder_{t}C_quarter") for t in (900, 1100, 1250)}
    >>> model = vs.AirModel.of(fields)
    >>> field = model.at(temperature=1180, width=1.1)
    >>> by = model.derivatives(["temperature", "offset"], temperature=1180, width=1.1)
    """

    fields: FieldFamily | IndexField
    temperature_c: float | None = None
    _made: dict[tuple[float, ...], IndexField] = field(
        default_factory=dict, repr=False, compare=False
    )

    def __post_init__(self) -> None:
        if not isinstance(self.fields, FieldFamily | IndexField):
            raise InputError(
                f"AirModel: fields is {short(self.fields)}; give an IndexField, or a FieldFamily of"
                " several wall temperatures"
            )
        if isinstance(self.fields, IndexField):
            if self.temperature_c is not None:
                raise InputError(
                    "AirModel: temperature_c is that of a family of fields, and there is one"
                    " field; give several by their temperatures, or leave it out"
                )
            return
        low, high = self.fields.limits
        middle = (low + high) / 2.0
        here = middle if self.temperature_c is None else self.temperature_c
        between = f"one from {low:g} to {high:g} degC, as the family has"
        here = number_within("AirModel: temperature_c", here, low, high, between)
        object.__setattr__(self, "temperature_c", here)

    def __getstate__(self) -> dict[str, object]:
        """What is pickled: all but what was made."""
        return vars(self) | {"_made": {}}

    @classmethod
    @public
    def of(
        cls,
        fields: IndexField | FieldFamily | Mapping[float, IndexField] | Mapping[int, IndexField],
        *,
        temperature_c: float | None = None,
    ) -> AirModel:
        """A model of one field, or of fields by their wall temperatures in degC.

        Raises
        ------
        InputError
            If they are no fields, or do not go together (`FieldFamily`).
        """
        if isinstance(fields, Mapping):
            by_temperature: dict[Any, IndexField] = dict(fields)
            fields = FieldFamily(by_temperature)
        return cls(fields, temperature_c)

    def _line(self) -> str:
        known = ", ".join(f"{t:g}" for t in self._temperatures())
        return listed(f"fields at {known} degC" if known else "one field", ", ".join(self.names))

    @property
    def parameters(self) -> dict[str, AirParameter]:
        """Those that it has, by name."""
        low, high = self._first.box
        most_blur, pressure = min(20.0, (high - low)[1:].min()), self._first.pressure_pa
        known = [
            AirParameter(
                *("scale", "", 1.0, 1.0, 0.01, 10.0, 0.1),
                "what n - 1 differs by from that of the surrounding air, times so much",
            ),
            AirParameter(*("width", "", 1.0, 1.0, 0.1, 10.0, 0.2), "stretched along y so much"),
            AirParameter(*("offset", "mm", 0.0, 0.0, -50.0, 50.0, 1.0), "moved along y"),
            AirParameter(
                *("lean", "°", 0.0, 0.0, -STEEPEST_DEG, STEEPEST_DEG, 1.0),
                "sheared along y, from z towards y, about z = 0",
            ),
            AirParameter(*("height", "mm", 0.0, 0.0, -50.0, 50.0, 2.0), "moved along z"),
            AirParameter(
                *("blur", "mm", 0.0, 1.0, 0.0, float(most_blur), 2.0),
                "standard deviation of a Gaussian, in y and z",
            ),
            AirParameter(
                *("pressure", "Pa", pressure, pressure, LEAST_PA, MOST_PA, 1000.0),
                "which n - 1 goes with",
            ),
        ]
        if isinstance(self.fields, FieldFamily):
            here, ends = self.temperature_c or 0.0, self.fields.limits
            known.append(
                AirParameter("temperature", "degC", here, here, *ends, 20.0, "of the wall")
            )
        return {each.name: each for each in known}

    @property
    def names(self) -> tuple[str, ...]:
        """Of its parameters."""
        return tuple(self.parameters)

    @property
    def defaults(self) -> dict[str, float]:
        """Values at which the air is that of the field itself, by the parameters' names."""
        return {name: each.default for name, each in self.parameters.items()}

    @public
    def at(self, **values: float) -> IndexField:
        """The air where parameters have these values, and the others their defaults.

        With all at their defaults it is the field itself.

        Raises
        ------
        InputError
            If there is no such parameter, or its value is out of its range.
        """
        v = self._checked(values)
        key = tuple(v.values())
        if key not in self._made:
            wall = self._leaning(v)
            made = self._shaped(wall, v)
            made = made if made is wall else self._named(made, v)
            self._made.clear()  # the last one is what derivatives are asked at
            self._made[key] = made
        return self._made[key]

    @public
    def derivatives(self, names: Iterable[str], **values: float) -> dict[str, FieldDerivative]:
        """Derivatives of n - 1 by parameters, at the same values as `at`; by their names.

        They are exact, and stand where a field stands: in `line_sensitivity` as variations, and in
        `refractivity` at points.

        Raises
        ------
        InputError
            As of `at`.
        """
        v, here = self._checked(values), self.at(**values)
        return {name: self._derivative(name, here, v) for name in names}

    @property
    def _first(self) -> IndexField:
        family = self.fields
        return next(iter(family.fields.values())) if isinstance(family, FieldFamily) else family

    def _temperatures(self) -> list[float]:
        return sorted(self.fields.fields) if isinstance(self.fields, FieldFamily) else []

    def _checked(self, values: Mapping[str, Any]) -> dict[str, float]:
        """All parameters' values, in the order of their names."""
        known = self.parameters
        for name, value in values.items():
            self._check_name(name)
            each = known[name]
            limits = f"{each.low:g} to {each.high:g}{f' {each.unit}'.rstrip()}"
            number_within(f"AirModel: {name}", value, each.low, each.high, limits)
        return {name: float(values.get(name, each.default)) for name, each in known.items()}

    def _check_name(self, name: str) -> None:
        if name not in self.names:
            lack = " (it needs fields of several temperatures)" if name == "temperature" else ""
            raise InputError(
                f"AirModel: the air has no parameter '{name}'{lack}; there are:"
                f" {', '.join(self.names)}{nearest(name, self.names)}"
            )

    def _at_wall(self, v: Mapping[str, float]) -> IndexField:
        """The field of the wall's temperature."""
        if not isinstance(self.fields, FieldFamily):
            return self.fields
        known = self.fields.fields.get(v["temperature"])
        return self.fields.at(v["temperature"]) if known is None else known

    def _leaning(self, v: Mapping[str, float]) -> IndexField:
        """That field, leaning."""
        return leaned(self._at_wall(v), v["lean"])

    def _shaped(self, air: IndexField, v: Mapping[str, float]) -> IndexField:
        """The transforms, one after the other."""
        air = blurred(widened(air, v["width"]), v["blur"], _REACH)
        return self._seen(self._placed(air, v))

    def _named(self, made: IndexField, v: Mapping[str, float]) -> IndexField:
        """With words of what is not at its default."""
        changed = [
            f"{name} {v[name]:.6g}{f' {each.unit}'.rstrip()}"
            for name, each in self.parameters.items()
            if v[name] != each.default
        ]
        return replace(made, source=", ".join(filter(None, [self._first.source, *changed])))

    def _seen(self, air: IndexField) -> IndexField:
        """With the interpolation and the dimensions that the model's fields have."""
        kinds = [(each.interpolation, each.dimensions) for each in (air, self._first)]
        return air if kinds[0] == kinds[1] else air.simplified(*kinds[1])

    def _placed(self, air: IndexField, v: Mapping[str, float]) -> IndexField:
        """Air that has its shape: moved, and with its contrast."""
        if v["offset"] or v["height"]:
            stands = air.pose or Pose(np.eye(3), np.zeros(3))
            shifted = stands.to_world([0.0, v["offset"], v["height"]])
            air = replace(air, pose=Pose(stands.rotation, shifted))
        if v["scale"] != 1.0:
            air = IndexField.sum_of([(v["scale"], air)], ambient=air.ambient, source=air.source)
        return air.at_pressure(v["pressure"])

    def _derivative(self, name: str, here: IndexField, v: Mapping[str, float]) -> FieldDerivative:
        self._check_name(name)
        if name == "scale":
            return FieldDerivative(here, share=1.0 / v["scale"])
        if name == "pressure":
            per = 1.0 / v["pressure"]
            return FieldDerivative(here, share=per, ambient=here.ambient * per)
        if name in ("offset", "height"):
            axis = 1 if name == "offset" else 2
            return FieldDerivative(here, shift=-np.eye(3)[axis])
        if name == "width":
            stretch = np.array([0.0, -1.0 / v["width"], 0.0])
            if not v["blur"]:
                return FieldDerivative(here, stretch=stretch)
            # The wider the grid's cells, the less of them a blur reaches.
            less = blur_derivative(widened(self._leaning(v), v["width"]), v["blur"], _REACH, (1,))
            nodes = less.with_nodes(less.nodes * (-v["blur"] / v["width"]))
            return FieldDerivative(here, stretch=stretch, nodes=self._seen(self._placed(nodes, v)))
        if name == "blur":
            by = blur_derivative(widened(self._leaning(v), v["width"]), v["blur"], _REACH)
            return FieldDerivative(here, nodes=self._seen(self._placed(by, v)))
        if name == "lean":
            by = lean_derivative(self._at_wall(v), v["lean"])
        else:
            assert isinstance(self.fields, FieldFamily)
            by = leaned(self.fields.derivative(v["temperature"]), v["lean"])
        by = blurred(widened(by, v["width"]), v["blur"], _REACH)
        return FieldDerivative(here, nodes=self._seen(self._placed(by, v)))
