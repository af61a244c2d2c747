"""The statements of section 5 of Beermann et al. 2018, and whether our curves bear them out.

``paper.toml`` holds the statements. Each is checked, in each of our airs, by one of six kinds of
check over named series of the nine rays. Numbers are met within 15 %, bounds exactly.
"""

from __future__ import annotations

import tomllib
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass
from importlib import resources
from typing import Any

import numpy as np
from numpy.typing import NDArray

from virtual_sensor.display import Displayed
from virtual_sensor.records import Table
from virtual_sensor.studies.reproduction.curves import SEARCHED, Curves
from virtual_sensor.studies.reproduction.settings import AIRS, BETAS_DEG, TEMPERATURES_C, Setting

Array = NDArray[np.float64]
_SETTINGS = {"temperature_c": TEMPERATURES_C, "beta_deg": BETAS_DEG}
_TAKE: dict[str, Callable[[Array], Any]] = {
    "": np.atleast_1d,
    "largest": np.max,
    "least": np.min,
    "mean": np.mean,
    "middle": lambda x: (np.min(x) + np.max(x)) / 2.0,  # of what "varies round" a value
    "size": lambda x: np.max(np.abs(x)),
    "bends": lambda x: np.abs(np.diff(x, 2)).sum(),  # how much a curve bends from ray to ray
}


@dataclass(frozen=True)
class Quantity(Displayed):
    """Values of the nine rays in an air; see ``paper.toml``.

    Attributes
    ----------
    series : str
        Of `Rays.of`.
    take : str
        What number is taken of all rays; "" for each ray's own.
    y_mm : float, sequence of two, or None
        The rays: one, or those between two positions; None for all.
    temperature_c, beta_deg : float
        The setting.
    step_px : float
        To which pixels are rounded; 0 for none.
    change_from_c : float or None
        The values are magnitudes of differences from those at this temperature.
    """

    series: str
    take: str = ""
    y_mm: float | Sequence[float] | None = None
    temperature_c: float = TEMPERATURES_C[-1]
    beta_deg: float = BETAS_DEG[0]
    step_px: float = 0.0
    change_from_c: float | None = None

    def values(self, curves: Curves, air: str, **other: float) -> Array:
        """The values, shape (K,), K = 1 if one is taken; `other` replaces temperature or pose."""

        def series(**at: float) -> tuple[Array, Array]:
            curve = curves.nine[Setting(air, **at), SEARCHED]
            return curve.y_mm, curve.rays(self.step_px).of(self.series)

        at = {"temperature_c": self.temperature_c, "beta_deg": self.beta_deg} | other
        y, values = series(**at)
        if self.change_from_c is not None:
            _, before = series(**at | {"temperature_c": self.change_from_c})
            values = np.abs(values - before)
        if isinstance(self.y_mm, Sequence):
            first, last = self.y_mm
            values = values[(y <= first + 1e-9) & (y >= last - 1e-9)]
        elif self.y_mm is not None:
            values = values[[np.argmin(np.abs(y - self.y_mm))]]
        return np.atleast_1d(_TAKE[self.take](values))


@dataclass(frozen=True)
class Statement(Displayed):
    """A statement of the paper's; ``paper.toml`` says what its fields mean."""

    where: str
    claim: str
    paper: str
    check: str
    found: str
    of: Quantity = Quantity("")
    with_: Quantity = Quantity("")
    less: tuple[Quantity, ...] = ()
    more: tuple[Quantity, ...] = ()
    also: Quantity = Quantity("")
    over: str = ""
    going: str = ""
    number: float | None = None
    below: float | None = None
    above: float | None = None
    at_most: float | None = None
    times: float = 1.0
    opposed: str = ""
    extreme: str = ""
    at_mm: float = np.nan
    rays: int = 0
    why: str = ""
    panel: str = ""
    fitted: bool = False

    @property
    def stated(self) -> float:
        """The paper's number, or bound."""
        numbers = (self.number, self.below, self.above, self.at_most)
        return next((each for each in numbers if each is not None), np.nan)

    def residual(self, ours: float) -> float:
        """Relative difference of ours from the paper's number; 0 where a bound is met."""
        apart = ours / self.stated - 1.0
        if self.number is not None:
            return apart
        return min(apart, 0.0) if self.above is not None else max(apart, 0.0)

    def met(self, ours: float) -> bool:
        """Whether a number is the paper's within the tolerance, or meets its bound."""
        return abs(self.residual(ours)) <= (0.0 if self.number is None else TOLERANCE)


@dataclass(frozen=True)
class Found(Displayed):
    """What was found for a statement in one air.

    Attributes
    ----------
    words : str
        Our value.
    met : bool
        Whether it bears the statement out.
    """

    words: str
    met: bool


@dataclass(frozen=True)
class Verdict(Displayed):
    """A statement with what was found in each air.

    Attributes
    ----------
    statement : Statement
    found : mapping
        `Found` by air.
    words : str
        The verdict.
    why : str
        Why ours differs; "" where all airs bear the statement out.
    """

    statement: Statement
    found: Mapping[str, Found]
    words: str
    why: str


@dataclass(frozen=True)
class StatementTable(Table):
    """The statements of the paper, our values and verdicts.

    Attributes
    ----------
    where, statement, paper : sequence of str
        Section and figure; what is stated; the paper's value, or how it says it.
    resolved, blurred, widened : sequence of str
        Our values in each air.
    resolved_met, blurred_met, widened_met : sequence of str
        Whether they bear the statement out: true or false.
    verdict, why : sequence of str
        The verdict over all airs; why ours differs.
    """

    where: Sequence[str]
    statement: Sequence[str]
    paper: Sequence[str]
    resolved: Sequence[str]
    resolved_met: Sequence[str]
    blurred: Sequence[str]
    blurred_met: Sequence[str]
    widened: Sequence[str]
    widened_met: Sequence[str]
    verdict: Sequence[str]
    why: Sequence[str]


def load_paper() -> tuple[tuple[Statement, ...], dict[str, str], float]:
    """The statements, the reasons by their keys, and the tolerance of a number."""
    text = resources.files(__package__).joinpath("paper.toml").read_text(encoding="utf-8")
    paper = tomllib.loads(text)
    return tuple(map(_statement, paper["statement"])), paper["reasons"], paper["tolerance"]


def _statement(entry: dict[str, Any]) -> Statement:
    entry = {"with_" if name == "with" else name: value for name, value in entry.items()}
    for name in ("of", "with_", "also"):
        if name in entry:
            entry[name] = Quantity(**entry[name])
    for name in ("less", "more"):
        if name in entry:
            each = entry[name] if isinstance(entry[name], list) else [entry[name]]
            entry[name] = tuple(Quantity(**one) for one in each)
    return Statement(**entry)


STATEMENTS, REASONS, TOLERANCE = load_paper()
FITTED = tuple(statement for statement in STATEMENTS if statement.fitted)
"""Those that the broadening is fitted to: what depends on the air and is stated as a number."""


def judge(
    curves: Curves, airs: Sequence[str] = AIRS, statements: Sequence[Statement] = STATEMENTS
) -> list[Verdict]:
    """Check all statements in some airs."""
    verdicts = []
    for statement in statements:
        found = {air: check(statement, curves, air) for air in airs}
        met = [air for air, each in found.items() if each.met]
        words = f"met in {' and '.join(met)} air only" if met else "differs"
        everywhere = len(met) == len(airs)
        why = "" if everywhere else REASONS.get(statement.why, "")
        verdicts.append(Verdict(statement, found, "met" if everywhere else words, why))
    return verdicts


def check(statement: Statement, curves: Curves, air: str) -> Found:
    """Whether the curves of an air bear a statement out."""
    met, values = _CHECKS[statement.check](statement, curves, air)
    if statement.also.series:
        values["also"] = statement.also.values(curves, air)
    words = {name: _number(value) for name, value in values.items()}
    return Found(statement.found.format(**words), bool(met))


Met = tuple[bool | np.bool_, dict[str, Any]]


def _monotone(s: Statement, curves: Curves, air: str) -> Met:
    """Each step rises, or falls; over settings, each ray's or the taken number's."""
    if s.over:
        x = np.stack([s.of.values(curves, air, **{s.over: v}) for v in _SETTINGS[s.over]])
    else:
        x = s.of.values(curves, air)[:, None]
    turn = int(np.argmin(x)) if s.going == "falls then rises" else -1
    falls = np.arange(len(x) - 1) < turn if turn >= 0 else np.full(len(x) - 1, s.going == "falls")
    right = np.where(falls[:, None], -1.0, 1.0) * np.diff(x, axis=0) > 0.0
    each = right.all(axis=0) if x.shape[1] > 1 else right
    values: dict[str, Any] = {"right": int(each.sum()), "count": each.size, "values": x[:, 0]}
    values |= {"first": x[0, 0], "last": x[-1, 0], "least": x[turn, 0]}
    if turn >= 0:
        values["least_mm"] = _places(curves, air)[turn]
    return right.all() and turn not in (0, len(x) - 1), values


def _bound(s: Statement, curves: Curves, air: str) -> Met:
    """All values are below or above a bound."""
    x = s.of.values(curves, air)
    met = x > s.stated if s.above is not None else x < s.stated
    met |= (x == s.stated) & (s.at_most is not None)
    return met.all(), {"value": x, "largest": x.max(), "least": x.min()}


def _about(s: Statement, curves: Curves, air: str) -> Met:
    """A value is the paper's, within the tolerance."""
    ours = s.of.values(curves, air).item()
    return s.met(ours), {"value": ours}


def _compare(s: Statement, curves: Curves, air: str) -> Met:
    """Some values are below others, also if multiplied."""
    settings = [{s.over: value} for value in _SETTINGS[s.over]] if s.over else [{}]
    less, more = (
        np.concatenate([q.values(curves, air, **each) for q in side for each in settings])
        for side in (s.less, s.more)
    )
    ratio = more / less if less.all() else np.array([np.inf])
    values = {"less": less, "more": more, "ratio": ratio.min(), "percent": 100.0 / ratio.min()}
    return (s.times * less < more).all(), values


def _correlate(s: Statement, curves: Curves, air: str) -> Met:
    """Two series go together; or against each other, in all rays or in some steps."""
    one, other = (q.values(curves, air) for q in (s.of, s.with_))
    if not s.opposed:
        coefficient = float(np.corrcoef(one, other)[0, 1])
        return coefficient > s.stated, {"coefficient": coefficient}
    if s.opposed == "rays":
        against = one * other < 0.0
        met = against.all()
    else:
        against = (np.diff(one) > 0.0) & (np.diff(other) < 0.0)
        met = against.any()
    return met, {"number": int(against.sum()), "count": len(against)}


def _locate(s: Statement, curves: Curves, air: str) -> Met:
    """The extreme value is at a ray, or so many rays beside it."""
    x, y = s.of.values(curves, air), _places(curves, air)
    place = int(np.argmax(x) if s.extreme == "largest" else np.argmin(x))
    stated = int(np.argmin(np.abs(y - s.at_mm)))
    values = {"value": x[place], "value_mm": y[place], "there": x[stated]}
    return abs(place - stated) <= s.rays, values


_KINDS = (_monotone, _bound, _about, _compare, _correlate, _locate)
_CHECKS = {kind.__name__.strip("_"): kind for kind in _KINDS}


def _places(curves: Curves, air: str) -> Array:
    return curves.nine[Setting(air), SEARCHED].y_mm


class _Number(float):
    """A number whose shape may begin with a bound: "1e-6|.2g" says "below 1e-06" of less."""

    def __format__(self, shape: str) -> str:
        bound, bar, rest = shape.rpartition("|")
        if bar and abs(self) < float(bound):
            return f"below {float(bound):g}"
        return format(float(self) if abs(self) > 1e-9 else 0.0, rest)  # less is rounding


class _Numbers(list[_Number]):
    """Several of them, with commas."""

    def __format__(self, shape: str) -> str:
        return ", ".join(format(each, shape) for each in self)


def _number(value: Any) -> Any:
    if isinstance(value, int):
        return value
    return _Numbers(map(_Number, np.atleast_1d(value).tolist()))
