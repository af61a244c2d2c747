"""Rays and how to march them: the straight ray, the bent one beside it, and what bends it."""

from dataclasses import dataclass, replace
from typing import Any, Protocol

import numpy as np
from numpy.typing import NDArray

from virtual_sensor.arrays import LARGEST, SMALLEST, number_within, one_of, whole_number
from virtual_sensor.display import Displayed
from virtual_sensor.engine import dr, mi
from virtual_sensor.errors import InputError
from virtual_sensor.optics.steppers import CONTROLLED, STEPPERS, Vectors
from virtual_sensor.poses import Pose

Array = NDArray[np.float64]

_MOST_STEPS = 2**31 - 1


class ValueLookup(Protocol):
    """Values at points in a field's box and frame, in Dr.Jit."""

    def delta_and_gradient(self, p: Any) -> tuple[Any, Any]:
        """Value, and gradient in 1/mm."""
        ...


class Lookup(ValueLookup, Protocol):
    """Difference of n - 1 from the surroundings at points in a field's box and frame, in Dr.Jit."""

    def delta_gradient_hessian(self, p: Any) -> tuple[Any, Any, Any]:
        """Value, gradient in 1/mm, and Hessian in 1/mm^2."""
        ...


class Variation(Protocol):
    """What a ray needs to know of a field's derivative by a parameter."""

    @property
    def box(self) -> np.ndarray:
        """Lower and upper corner in the field's frame in mm, shape (2, 3)."""
        ...

    @property
    def pose(self) -> Pose | None:
        """Of its frame; None: the world's."""
        ...

    @property
    def ambient(self) -> float:
        """Outside the box: the refractivity of a field, or its derivative."""
        ...

    def lookup(self, precision: str) -> ValueLookup:
        """Evaluator for "single" or "double", in the field's frame."""
        ...


class Field(Variation, Protocol):
    """What a ray needs to know of a field: `IndexField` and the closed-form fields have it."""

    def lookup(self, precision: str) -> Lookup:
        """Evaluator for "single" or "double", in the field's frame."""
        ...

    def to_local(self, points_mm: Array) -> Array:
        """World points (N, 3) in the field's frame, mm."""
        ...

    def axes(self) -> Array:
        """Axes of the field's frame, world, as columns: (3, 3)."""
        ...


@dataclass(frozen=True)
class March(Displayed):
    """How to march.

    Attributes
    ----------
    step_mm : float
        Step in t: the arc length where n is that of the surroundings.  The longest one, for
        methods that control it.
    method : str
        A key of `steppers.STEPPERS`.
    precision : str
        "single" or "double".
    first_order : bool
        Light is deflected by the gradient along the straight ray: the deflection integral.
    tolerance_mm : float
        Error allowed in each step, by the estimate of methods that control it (`CONTROLLED`).
    max_steps : int
        A ray still in the field after so many steps, rejected ones too, gets status OUT_OF_STEPS.

    Raises
    ------
    InputError
        If one of them can't be marched with.
    """

    step_mm: float = 1.0
    method: str = "rk4"
    precision: str = "double"
    first_order: bool = False
    tolerance_mm: float = 1e-6
    max_steps: int = 20_000

    def __post_init__(self) -> None:
        for name in ("step_mm", "tolerance_mm"):
            advice = "it positive and finite"
            number_within(name, getattr(self, name), SMALLEST, LARGEST, advice)
        whole_number("max_steps", self.max_steps, 1, _MOST_STEPS)
        one_of("method", self.method, STEPPERS)
        one_of("precision", self.precision, ("single", "double"))

    def _line(self) -> str:
        return f"{self}"

    def check(self, field: Field | None) -> None:
        """Ask whether steps so long, or so short, get through a field.

        Raises
        ------
        InputError
            If one step is longer than the field, or all that a ray may take end within it.
        """
        if field is None:
            return
        sides = np.ptp(np.asarray(field.box, float), axis=0)
        if self.step_mm > sides.min():
            raise InputError(
                f"a step of {self.step_mm:g} mm is longer than the field's shortest side,"
                f" {sides.min():g} mm; give a shorter one, such as 2 mm"
            )
        longest = float(sides.max())
        if self.method not in CONTROLLED and self.step_mm * self.max_steps < longest:
            raise InputError(
                f"{self.max_steps} steps of {self.step_mm:g} mm end within the field, which is"
                f" {longest:.0f} mm long; give steps of {longest / self.max_steps:.2g} mm or more"
            )

    def __str__(self) -> str:
        steps = f"steps of {self.step_mm:g} mm"
        if self.method in CONTROLLED:
            steps = f"{steps} at most, each to {self.tolerance_mm:g} mm"
        order = ", first order" if self.first_order else ""
        return f"{self.method}, {steps}, {self.precision} precision{order}"

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
    """Rays being marched; every member is a Dr.Jit array over the rays.

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
        """The same rays a straight segment further on."""
        offset = tuple(x + v * dt for x, v in zip(self.offset, self.tau, strict=True))
        return replace(self, t=self.t + dt, offset=offset)
