"""How a laser line's light is spread: across its sheet, along it, and with the distance.

Places across the sheet are in 1/e^2 radii of the sheet, so that a focus changes none of the
formulas; all are for NumPy's arrays as for Dr.Jit's.
"""

from __future__ import annotations

import math
from abc import ABC, abstractmethod
from collections.abc import Sequence
from dataclasses import dataclass
from functools import cached_property
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import ArrayLike, NDArray

from virtual_sensor.arrays import (
    LARGEST,
    SMALLEST,
    Table,
    exp,
    floor,
    number_for,
    number_within,
    numbers_of,
    sqrt,
    where,
)
from virtual_sensor.display import Displayed
from virtual_sensor.errors import InputError, naming, short
from virtual_sensor.files import exists

Array = NDArray[np.float64]

FAINT = 1e-6
"""Light below this fraction of the peak is taken as none."""

_NODES = 2048  # of a measured profile, between which it is linear
_EDGE = 0.05  # of the peak: a table that ends above it is cut off
_FEWEST_ROWS = 5
_LARGEST_MM = 1e6
_NM_PER_MM = 1e6


class Profile(Displayed, ABC):
    """Intensity across a laser sheet; subclasses are frozen dataclasses."""

    @property
    @abstractmethod
    def peak(self) -> float:
        """Power per radius at the highest place, of a sheet with the power 1."""

    @property
    @abstractmethod
    def reach(self) -> float:
        """Distance from the middle beyond which there is no light that counts, in radii."""

    @abstractmethod
    def at(self, x: Any, radius: float) -> Any:
        """Intensity over the highest, at distances across a sheet of this radius."""


@dataclass(frozen=True)
class Gaussian(Profile):
    """The profile of an ideal laser: exp(-2 (x/w)^2)."""

    @property
    def peak(self) -> float:
        """Of the integral of a Gaussian."""
        return math.sqrt(2.0 / math.pi)

    @property
    def reach(self) -> float:
        """2.6 radii."""
        return float(np.sqrt(-np.log(FAINT) / 2.0))

    def at(self, x: Any, radius: float) -> Any:
        """It falls to 1/e^2 at the radius."""
        return exp(number_for(x, -2.0 / radius**2) * (x * x))


@dataclass(frozen=True)
class TailedGaussian(Profile):
    """A Gaussian core with tails: a second, wider Gaussian that has a part of the power.

    Real lines have 0.02-0.06 of their peak at 3 standard deviations of the core, and 0.007-0.025 at
    4, where a Gaussian has 0.011 and 0.0003; 0.12 of the power at 2.5 radii gives 0.035 and 0.015.

    Attributes
    ----------
    tail_power : float
        Of the whole power, in the tails.
    tail_radius : float
        1/e^2 radius of the tails, in radii of the core.
    """

    tail_power: float = 0.12
    tail_radius: float = 2.5

    def __post_init__(self) -> None:
        number_within("the tails' part of the power", self.tail_power, 0.0, 1.0, "0 to 1")
        number_within("the tails' radius", self.tail_radius, 1.0, 100.0, "1 to 100 core radii")

    @property
    def _in_middle(self) -> tuple[float, float]:
        """Intensity there of core and tails, of the power 1 and in units of a Gaussian's."""
        return 1.0 - self.tail_power, self.tail_power / self.tail_radius

    @property
    def peak(self) -> float:
        """Of both together."""
        return Gaussian().peak * sum(self._in_middle)

    @property
    def reach(self) -> float:
        """Of the wider one, if it counts there."""
        core, tails = self._in_middle
        faint = FAINT * (core + tails)
        far = self.tail_radius * math.sqrt(max(-math.log(faint / tails), 0.0) / 2.0) if tails else 0
        return max(Gaussian().reach, far)

    def at(self, x: Any, radius: float) -> Any:
        """The sum of the two."""
        core, tails = (part / sum(self._in_middle) for part in self._in_middle)
        narrow, wide = Gaussian().at(x, radius), Gaussian().at(x, radius * self.tail_radius)
        return number_for(x, core) * narrow + number_for(x, tails) * wide


@dataclass(frozen=True)
class SuperGaussian(Profile):
    """A flat top with steep sides: exp(-2 |x/w|^n).

    Attributes
    ----------
    order : float
        n; of 2 it is a Gaussian.
    """

    order: float = 4.0

    def __post_init__(self) -> None:
        number_within("a super-Gaussian's order", self.order, 1.0, 100.0, "a number from 1 to 100")

    @property
    def peak(self) -> float:
        """Of the integral by the gamma function."""
        return 2.0 ** (1.0 / self.order) / (2.0 * math.gamma(1.0 + 1.0 / self.order))

    @property
    def reach(self) -> float:
        """Nearer than a Gaussian's."""
        return (-math.log(FAINT) / 2.0) ** (1.0 / self.order)

    def at(self, x: Any, radius: float) -> Any:
        """It falls to 1/e^2 at the radius too."""
        near = abs(x) * number_for(x, 1.0 / radius)
        return exp(number_for(x, -2.0) * near ** number_for(x, self.order))


@dataclass(frozen=True, eq=False)
class MeasuredProfile(Profile):
    """A profile from a table, linear between its rows; its centre of gravity is the sheet's middle.

    Attributes
    ----------
    place_mm : ndarray of shape (N,)
        Distances across the sheet, ascending.
    intensity : ndarray of shape (N,)
        In any unit.
    """

    place_mm: Array
    intensity: Array

    def __post_init__(self) -> None:
        place, intensity = _checked_table("profile", self.place_mm, self.intensity)
        ends = max(intensity[0], intensity[-1]) / intensity.max()
        if ends > _EDGE:
            raise InputError(
                f"the profile still has {ends:.0%} of its peak where its table ends; measure"
                " further out, or take off the background"
            )
        object.__setattr__(self, "place_mm", place)
        object.__setattr__(self, "intensity", intensity)

    def _line(self) -> str:
        return f"measured at {self.place_mm.size} places, radius {self.radius_mm:.4g} mm"

    @cached_property
    def radius_mm(self) -> float:
        """Half the width at 1/e^2 of the peak."""
        level = self.intensity.max() * math.exp(-2.0)
        above = np.flatnonzero(self.intensity >= level)
        first, last = above[0], above[-1]
        x, y = self.place_mm, self.intensity
        left, right = x[first], x[last]
        if first:
            left = np.interp(level, y[first - 1 : first + 1], x[first - 1 : first + 1])
        if last + 1 < x.size:
            right = np.interp(level, y[last : last + 2][::-1], x[last : last + 2][::-1])
        return float(right - left) / 2.0

    @cached_property
    def _even(self) -> tuple[float, float, Array]:
        """Place of the first node and step, in radii; and the density there, of the power 1."""
        x, y = self.place_mm, self.intensity
        middle = _integral(x, y * x) / _integral(x, y)
        nodes = np.linspace(x[0], x[-1], _NODES)
        density = np.interp(nodes, x, y)
        nodes = (nodes - middle) / self.radius_mm
        density[[0, -1]] = 0.0
        step = float(nodes[1] - nodes[0])
        return float(nodes[0]), step, density / (density.sum() * step)

    @property
    def peak(self) -> float:
        """Of the highest place, as that in the middle may be dark."""
        return float(self._even[2].max())

    @property
    def reach(self) -> float:
        """To the farther end of the table."""
        first, step, _ = self._even
        return max(-first, first + step * (_NODES - 1))

    @cached_property
    def _table(self) -> Table:
        return Table(self._even[2] / self.peak)

    def at(self, x: Any, radius: float) -> Any:
        """Intensity over the highest; none beyond the table."""
        first, step, _ = self._even
        place = x * number_for(x, 1.0 / (radius * step)) - number_for(x, first / step)
        last = number_for(x, _NODES - 1.0)
        held = (place >= 0.0) & (place < last)
        place = where(held, place, 0.0 * last)
        row = floor(place)
        here, next_ = self._table.at(row), self._table.at(row + 1.0)
        return where(held, here + (place - row) * (next_ - here), 0.0)


class Uniformity(Displayed, ABC):
    """Intensity along a laser line, whose mean over the line is 1; frozen dataclasses."""

    @abstractmethod
    def at(self, place: Any) -> Any:
        """At places along the line: -1 and 1 at its ends."""


@dataclass(frozen=True)
class ParabolicUniformity(Uniformity):
    """Intensity that changes as a parabola from the middle to the ends.

    Attributes
    ----------
    ends : float
        Over that in the middle: below 1 of a cylindrical lens, above 1 of many a Powell lens.
    """

    ends: float

    def __post_init__(self) -> None:
        advice = "the ends' intensity over that in the middle, from 0 to 100"
        number_within("'uniformity'", self.ends, 0.0, 100.0, advice)

    def at(self, place: Any) -> Any:
        """Such that the power stays."""
        middle = 3.0 / (2.0 + self.ends)
        return number_for(place, middle) + number_for(place, middle * (self.ends - 1.0)) * (
            place * place
        )


@dataclass(frozen=True, eq=False)
class MeasuredUniformity(Uniformity):
    """Intensity along the line from a table, linear between its rows; it spans the line.

    Attributes
    ----------
    place : ndarray of shape (N,)
        Along the line, ascending, in any unit: the first is one end, the last the other.
    intensity : ndarray of shape (N,)
        In any unit.
    """

    place: Array
    intensity: Array

    def __post_init__(self) -> None:
        place, intensity = _checked_table("uniformity", self.place, self.intensity)
        object.__setattr__(self, "place", place)
        object.__setattr__(self, "intensity", intensity)

    def _line(self) -> str:
        return f"measured at {self.place.size} places"

    @cached_property
    def _table(self) -> Table:
        nodes = np.linspace(self.place[0], self.place[-1], _NODES)
        even = np.interp(nodes, self.place, self.intensity)
        return Table(even / (_integral(nodes, even) / (nodes[-1] - nodes[0])))

    def at(self, place: Any) -> Any:
        """Beyond the ends as at the ends."""
        last = number_for(place, _NODES - 1.0)
        at = (place + 1.0) * (0.5 * last)
        at = where(at > 0.0, at, 0.0 * last)  # of NaN too
        at = where(at < last, at, last)
        row = floor(at)
        row = where(row < last, row, last - 1.0)
        here, next_ = self._table.at(row), self._table.at(row + 1.0)
        return here + (at - row) * (next_ - here)


@dataclass(frozen=True)
class Focus(Displayed):
    """The focus of a laser beam: its radius grows from the waist as sqrt(1 + (z / z_R)^2).

    Attributes
    ----------
    distance_mm : float
        From the generator's exit to the waist.
    rayleigh_mm : float
        z_R, the distance from the waist at which the radius has grown by sqrt(2).
    """

    distance_mm: float
    rayleigh_mm: float

    def __post_init__(self) -> None:
        for name in ("distance_mm", "rayleigh_mm"):
            advice = "a positive number of mm"
            number_within(f"Focus: {name}", getattr(self, name), SMALLEST, LARGEST, advice)

    @staticmethod
    def of_beam(distance_mm: float, waist_mm: float, wavelength_nm: float, quality: float) -> Focus:
        """Of a beam whose quality is M^2: z_R = pi w^2 / (M^2 lambda) (ISO 11146-1)."""
        number_within("a beam's quality", quality, 1.0, LARGEST, "M^2, a number from 1 on")
        return Focus(distance_mm, math.pi * waist_mm**2 * _NM_PER_MM / (quality * wavelength_nm))

    def widening(self, depth: Any) -> Any:
        """Radius at depths over that of the waist."""
        if isinstance(depth, int | float):
            depth = np.float64(depth)
        away = (depth - number_for(depth, self.distance_mm)) * number_for(
            depth, 1.0 / self.rayleigh_mm
        )
        return sqrt(1.0 + away * away)


def profile_of(text: str, folders: Sequence[Path] = (Path(),)) -> Profile:
    """A profile by its text, or the file of its table.

    Parameters
    ----------
    text : str
        "gaussian"; "tails POWER RADIUS", part of the power in the tails and their radius in radii
        of the core; "super ORDER"; or a file whose rows are a distance in mm and an intensity.
    folders : sequence of Path
        Where files are searched.

    Raises
    ------
    InputError
        If it is none of them, or the file can't be used.
    """
    word, *rest = text.split() or ["gaussian"]
    kinds: dict[str, tuple[type[Profile], int]] = {
        "gaussian": (Gaussian, 0),
        "tails": (TailedGaussian, 2),
        "super": (SuperGaussian, 1),
    }
    if word in kinds:
        kind, count = kinds[word]
        try:
            values = [float(each) for each in rest]
        except ValueError:
            values = [math.nan] * 3
        if len(values) not in (0, count) or not np.isfinite(values).all():
            raise InputError(
                f'\'profile\' is "{text[:80]}"; give "gaussian", "tails POWER RADIUS" such as'
                ' "tails 0.12 2.5", "super ORDER" such as "super 4", or the file of a table'
            )
        with naming("'profile'"):
            return kind(*values)
    columns = _read_table("profile", text, folders)
    if columns is None:
        raise InputError(
            f'\'profile\' is "{text[:80]}", and there is no such file; give "gaussian",'
            ' "tails POWER RADIUS", "super ORDER", or the file of a table'
        )
    measured: Profile = columns(MeasuredProfile)
    return measured


def uniformity_of(text: str, folders: Sequence[Path] = (Path(),)) -> Uniformity | None:
    """Intensity along a line by a number, the ends' over the middle's, or the file of a table.

    None of 1, of an even line.

    Raises
    ------
    InputError
        If it is neither, or the file can't be used.
    """
    try:
        ends = float(text or 1.0)
    except ValueError:
        columns = _read_table("uniformity", text, folders)
        if columns is None:
            raise InputError(
                f"'uniformity' is \"{text[:80]}\", no number, and there is no such file; give the"
                " ends' intensity over that in the middle, or the file of a table"
            ) from None
        measured: Uniformity = columns(MeasuredUniformity)
        return measured
    return None if ends == 1.0 else ParabolicUniformity(ends)


def _read_table(name: str, text: str, folders: Sequence[Path]) -> Any:
    """What makes a device of the two columns of a file; None if there is no such file."""
    from virtual_sensor.medium.imports.columns import is_numbers, numbers, read_lines

    path = next((f / text for f in folders if exists(f / text) and (f / text).is_file()), None)
    if path is None:
        return None
    with naming(path):
        lines = read_lines(path)
        start = next((i for i, line in enumerate(lines) if is_numbers(line)), len(lines))
        if start == len(lines):
            raise InputError(f"has no numbers; give rows of a place and an intensity for '{name}'")
        rows = [line for line in lines[start:] if line.strip()]
        columns = np.asarray(numbers(rows, start, 2), float)
        if columns.shape[1] != 2:
            raise InputError(
                f"its rows have the length {columns.shape[1]}; give two numbers in each, a place"
                " and an intensity, and where commas are decimal marks semicolons between them"
            )

    def made(kind: Any) -> Any:
        with naming(path):
            return kind(*columns.T)

    return made


def _checked_table(name: str, place: ArrayLike, intensity: ArrayLike) -> tuple[Array, Array]:
    x, y = numbers_of(f"{name}: places", place), numbers_of(f"{name}: intensities", intensity)
    if x.ndim != 1 or x.shape != y.shape or x.size < _FEWEST_ROWS:
        raise InputError(
            f"the {name} has {short(x.shape)} places and {short(y.shape)} intensities; give at"
            f" least {_FEWEST_ROWS} rows of both"
        )
    if not (np.isfinite(x).all() and np.all(np.diff(x) > 0.0)) or np.abs(x).max() > _LARGEST_MM:
        raise InputError(
            f"the places of the {name} don't ascend; give finite ones in order, in the first column"
        )
    if not (np.isfinite(y).all() and y.min() >= 0.0 and y.max() > 0.0):
        raise InputError(
            f"the intensities of the {name} are not all finite and from 0 on, or all are 0; take"
            " off the background, and set to 0 what falls below it"
        )
    return x, y


def _integral(x: Array, y: Array) -> float:
    return float(np.trapezoid(y, x))
