"""Objects that say what they are: in one line, as a table with a picture, as a file, as data frame.

What is drawn and written stands in `reporting.objects`, `reporting.notebook` and
`reporting.object_files`; they are loaded when they are first asked for, and matplotlib or pandas
with them.
"""

from __future__ import annotations

import dataclasses
import importlib
import inspect
from collections.abc import Iterable, Iterator, Mapping
from enum import IntEnum
from itertools import repeat
from pathlib import Path
from typing import TYPE_CHECKING, Any, ClassVar

from virtual_sensor.errors import printable

if TYPE_CHECKING:  # NumPy takes a third of the time that `--help` does: functions load it
    from numpy.typing import ArrayLike

LONGEST_LINE = 200
"""No object's repr has more characters."""


class Displayed:
    """Mixin of a dataclass that a user meets; each may write a `_line` of its own.

    >>> line
    LineCentres: 972 of 2048 ok, rows 1021 to 1279
    >>> line.plot().set_title("my line")
    >>> line.save("line.csv")
    """

    _field_units: ClassVar[Mapping[str, str]] = {}
    """Of fields whose names don't end in their unit."""
    _statuses: ClassVar[Mapping[str, Any]] = {}
    """What the numbers of these fields stand for."""
    _by_row: ClassVar[bool] = False
    """Whether the arrays have a row for each of many things, so that they are a table's columns."""

    def __init_subclass__(cls, **kwargs: Any) -> None:
        super().__init_subclass__(**kwargs)
        if "__repr__" not in vars(cls):  # a dataclass would write its own over an inherited one
            cls.__repr__ = Displayed.__repr__  # type: ignore[method-assign]
        if cls.__eq__ is Displayed.__eq__:  # likewise
            cls.__eq__ = Displayed.__eq__  # type: ignore[method-assign]
            cls.__hash__ = Displayed.__hash__  # type: ignore[method-assign]

    def _line(self) -> str:
        """What a person wants to know of it, in a line behind its class's name."""
        fields = dataclasses.fields(self)  # type: ignore[arg-type]
        held = {each.name: getattr(self, each.name) for each in fields if each.repr}
        return listed(*(f"{name} {brief(value)}" for name, value in held.items() if _says(value)))

    def __repr__(self) -> str:
        name = type(self).__name__
        try:
            words = " ".join(printable(self._line()).split())
        except Exception:  # a debugger asks half-made objects too
            return name
        line = f"{name}: {words}" if words else name
        return line if len(line) <= LONGEST_LINE else f"{line[: LONGEST_LINE - 3].rstrip()}..."

    def __eq__(self, other: object) -> bool:
        """Whether it is of the same class and all its fields are equal; NaN is equal to NaN."""
        if self is other:
            return True
        if type(self) is not type(other) or not dataclasses.is_dataclass(self):
            return NotImplemented
        return all(equal(one, getattr(other, name)) for name, one in _compared(self))

    def __hash__(self) -> int:
        if not dataclasses.is_dataclass(self):
            return object.__hash__(self)
        return hash((type(self), *(_hash(value) for _, value in _compared(self))))

    def _repr_html_(self) -> str:
        html: str = _reporting("notebook").html_of(self)
        return html

    def plot(self, ax: Any = None) -> Any:
        """Draw it and give the axes: matplotlib's `Axes` that are given, or those of a new figure.

        Raises
        ------
        InputError
            If there is nothing to see in it.
        """
        return _reporting("objects").plot(self, ax)

    def save(self, path: str | Path) -> Path:
        """Write it to a file whose suffix says what it is, whole or not at all; give the path.

        All have .json and .npz (the fields) and .csv (the columns of `to_dataframe`); what can be
        drawn has .png, .svg and .pdf; points have .ply, fields .nc, frames .exr and .tif.

        Raises
        ------
        InputError
            If it has no such format, with those that it has; or it can't be written.
        """
        written: Path = _reporting("object_files").save(self, path)
        return written

    def to_dataframe(self) -> Any:
        """It as a `pandas.DataFrame`: a row for each centre, ray, point, ...; or one of all.

        Raises
        ------
        InputError
            If pandas is not installed, or it has no table.
        """
        return _reporting("object_files").data_frame(self)


def _reporting(module: str) -> Any:
    """A module that lies above: it is only known to whoever asks an object for its picture."""
    return importlib.import_module(f"virtual_sensor.reporting.{module}")


def equal(one: Any, other: Any) -> bool:
    """Whether two values are equal: arrays element by element, NaN equal to NaN."""
    import numpy as np

    if one is other:
        return True
    if isinstance(one, np.ndarray) or isinstance(other, np.ndarray):
        numbers = np.result_type(one, other).kind in "fc" if _numeric(one, other) else False
        return np.array_equal(one, other, equal_nan=numbers)
    if isinstance(one, Mapping) and isinstance(other, Mapping):
        return one.keys() == other.keys() and all(equal(one[key], other[key]) for key in one)
    if isinstance(one, list | tuple) and type(one) is type(other):
        return len(one) == len(other) and all(map(equal, one, other))
    return bool(one == other) or (one != one and other != other)


def _numeric(*values: Any) -> bool:
    import numpy as np

    return all(isinstance(v, np.ndarray) and v.dtype.kind in "bufic" for v in values)


def _hash(value: Any) -> int:
    """Equal for equal values, and quick: of an array only its shape.

    Nothing is imported: weak references to an object are dropped, by its hash, at shutdown too.
    """
    if type(value).__hash__ is None and hasattr(value, "shape"):  # an array
        return hash(value.shape)
    if isinstance(value, Mapping):
        return hash(frozenset(value))
    if isinstance(value, list | tuple):
        return hash(tuple(map(_hash, value)))
    return 0 if value != value else hash(value)


def _compared(thing: Any) -> Iterator[tuple[str, Any]]:
    """The fields that make an object what it is; private ones are caches."""
    for each in dataclasses.fields(thing):
        if each.compare and not each.name.startswith("_"):
            yield each.name, getattr(thing, each.name)


def names_of(thing: object) -> Iterator[str]:
    """The names of an object's class and of its bases, with their modules below the package."""
    for each in type(thing).__mro__:
        yield f"{each.__module__}.{each.__qualname__}".removeprefix("virtual_sensor.")


def brief(value: Any) -> str:
    """A value in a few characters: an array by its shape, a mapping by its keys."""
    import numpy as np

    if isinstance(value, np.ndarray) and value.ndim:
        return f"({', '.join(map(str, value.shape))}{',' if value.ndim == 1 else ''})"
    if isinstance(value, IntEnum):
        return value.name.lower()
    if isinstance(value, float | np.floating):
        return f"{value:.6g}"
    if isinstance(value, Path):
        return value.name
    if isinstance(value, Mapping):
        return _few(value)
    if isinstance(value, list | tuple):
        return f"{len(value)} x {type(value[0]).__name__}" if len(value) > 4 else _bracketed(value)
    if dataclasses.is_dataclass(value):
        return type(value).__name__
    text = str(value)
    return text if len(text) <= 60 else f"{text[:57]}..."


def _says(value: Any) -> bool:
    return not (value is None or (isinstance(value, str | tuple | list | Mapping) and not value))


def _bracketed(values: list[Any] | tuple[Any, ...]) -> str:
    return f"({', '.join(map(brief, values))})"


def _few(names: Mapping[Any, Any]) -> str:
    shown = ", ".join(f"{name}" for name in list(names)[:4])
    return f"{{{shown}{', ...' if len(names) > 4 else ''}}}"


def tally(status: ArrayLike, good: IntEnum) -> str:
    """How many of them are good: "972 of 2048 ok"."""
    import numpy as np

    status = np.asarray(status)
    return f"{np.sum(status == good)} of {status.size} {good.name.lower()}"


def span(name: str, values: ArrayLike, unit: str = "") -> str:
    """From the least to the largest finite one: "rows 1021 to 1279"; "" where none is finite."""
    import numpy as np

    values = np.asarray(values, float)
    finite = values[np.isfinite(values)]
    if not finite.size:
        return ""
    low, high = (_rounded(number) for number in (finite.min(), finite.max()))
    words = f"{name} {low}" if low == high else f"{name} {low} to {high}"
    return f"{words} {unit}".rstrip()


def _rounded(number: float) -> str:
    return f"{number:.0f}" if 1e3 <= abs(number) < 1e7 else f"{number:.4g}"


def place(vector: ArrayLike) -> str:
    """A point or a direction: "(0, -12.5, 400)"."""
    import numpy as np

    return f"({', '.join(f'{x + 0.0:.5g}' for x in np.round(np.asarray(vector, float), 6))})"


def with_spreads(
    names: Iterable[str],
    units: Iterable[str],
    spreads: Iterable[float],
    values: Iterable[float] | None = None,
) -> list[str]:
    """Parameters with what follows their ± sign and, where there are values, these before it."""
    before = repeat("") if values is None else (f" {value:.6g}" for value in values)
    return [
        f"{name}{value} ± {spread:.2g}{f' {unit}' * bool(unit)}"
        for name, unit, spread, value in zip(names, units, spreads, before, strict=False)
    ]


def listed(*parts: str) -> str:
    """Parts of a line, those that say something."""
    return ", ".join(filter(None, parts))


def attribute_words(kind: type) -> dict[str, str]:
    """Words of the fields, from the numpydoc section "Attributes" of the class and its bases."""
    found: dict[str, str] = {}
    for each in reversed(kind.__mro__):
        lines = inspect.cleandoc(each.__doc__ or "").splitlines()
        if "Attributes" not in lines or not dataclasses.is_dataclass(each):
            continue
        names: list[str] = []
        for line in lines[lines.index("Attributes") + 2 :]:
            if line.startswith(" "):
                for name in names:
                    found[name] = f"{found[name]} {line.strip()}".strip()
            elif ":" in line:
                names = [name.strip() for name in line.split(":")[0].split(",")]
                found |= dict.fromkeys(names, "")
            elif line:
                break  # another section
    return found
