"""Parameters that a fit seeks: of the air, of a shape, of the laser's plane and of poses."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace
from typing import Any

import numpy as np

from virtual_sensor.errors import InputError, few, nearest, short
from virtual_sensor.metrology.observations import Observation, Prior
from virtual_sensor.metrology.shapes import Shape

_PLANE = ("laser_offset", "laser_tilt", "laser_roll")


@dataclass(frozen=True)
class Unknown:
    """A parameter that is sought.

    Attributes
    ----------
    name, unit : str
        For the user.
    kind : str
        "air", "shape", "plane" or "pose".
    parameter : str
        Its name where it belongs.
    observation : int or None
        Whose pose it is; None: of all.
    start, low, high : float
    prior : Prior or None
    usual : Prior or None
        Which stands in where the data leave a choice.
    held : bool
        Whether it does.
    """

    name: str
    unit: str
    kind: str
    parameter: str
    observation: int | None = None
    start: float = 0.0
    low: float = -np.inf
    high: float = np.inf
    prior: Prior | None = None
    usual: Prior | None = None
    held: bool = False

    @property
    def applied(self) -> Prior | None:
        """What is taken as known before: its prior, or the usual one that stands in."""
        return self.prior or (self.usual if self.held else None)

    def is_vague(self, sigma: float) -> bool:
        """Whether a standard deviation leaves at least what is usual."""
        return self.usual is not None and not sigma < self.usual.sigma

    def is_at_bound(self, value: float) -> bool:
        """Whether a value lies at an end of what is allowed."""
        return min(value - self.low, self.high - value) <= 1e-6 * max(abs(value), 1e-3)


def of_air(model: Any, name: str, seen: Sequence[Observation] | None) -> list[Unknown]:
    """A parameter of the air: one for all, or one for each of the observations."""
    if name not in model.names:
        raise InputError(
            f"estimate_air: names: the air has no '{name}'; it has {', '.join(model.names)}"
            f"{nearest(name, model.names)}"
        )
    p = model.parameters[name]
    usual = Prior(p.default, p.sigma)
    one = Unknown(name, p.unit, "air", name, None, p.start, p.low, p.high, None, usual)
    if seen is None:
        return [one]
    return [replace(one, name=f"{s.name}.{name}", observation=i) for i, s in enumerate(seen)]


def of_shape(shape: Shape | None, free: Sequence[str]) -> list[Unknown]:
    """Parameters of a shape, which start as it has them."""
    return [
        Unknown(name, _unit(name), "shape", name, start=float(getattr(shape, name)))
        for name in (shape.checked(free) if shape else ())
    ]


def of_poses(names: Sequence[str], seen: Sequence[Observation]) -> list[Unknown]:
    """Parameters of poses, each observation's own, and of the laser's plane, the same in all."""
    if not names:
        return []
    from virtual_sensor.optics.carried_rays import pose_parameters

    known, found = [*pose_parameters(), *_PLANE], []
    for name in names:
        owner, _, parameter = name.rpartition(".")
        owners = [i for i, each in enumerate(seen) if owner in ("", each.name)]
        if parameter not in known or not owners or (owner and parameter in _PLANE):
            raise InputError(
                f"estimate_air: pose_names: no '{name}'; there are {few(known, 99)}, also of one"
                f" observation, by its name and a dot before: {few([s.name for s in seen], 9)}"
            )
        if parameter in _PLANE:
            found.append(Unknown(parameter, _unit(parameter), "plane", parameter))
            continue
        one = Unknown(parameter, _unit(parameter), "pose", parameter)
        found += [replace(one, name=f"{seen[i].name}.{parameter}", observation=i) for i in owners]
    return list({unknown.name: unknown for unknown in found}.values())


def with_priors(unknowns: Sequence[Unknown], priors: dict[str, Any]) -> tuple[Unknown, ...]:
    """The unknowns with their priors, from whose means air starts."""
    unused, found = {f"{name}" for name in priors}, []
    for unknown in unknowns:
        prior = priors.get(unknown.name, priors.get(unknown.parameter))
        unused -= {unknown.name, unknown.parameter}
        if prior is not None and not isinstance(prior, Prior):
            raise InputError(
                f"estimate_air: the prior of {unknown.name} is {short(prior)}; give a Prior,"
                " of value and sigma"
            )
        start = prior.value if prior and unknown.kind == "air" else unknown.start
        start = float(np.clip(start, unknown.low, unknown.high))
        found.append(replace(unknown, prior=prior, start=start))
    if unused:
        name, names = min(unused), [unknown.name for unknown in unknowns]
        raise InputError(
            f"estimate_air: priors has one of '{name}', which is not sought; sought are"
            f" {few(names, 20) or 'none'}{nearest(name, names)}"
        )
    return tuple(found)


def _unit(name: str) -> str:
    """Of a parameter of a shape or a pose."""
    return "°" if any(word in name for word in ("turn", "tilt", "roll")) else "mm"
