"""Numbers and arrays that a caller gives: checked, and brought into Dr.Jit's memory and back.

Dr.Jit is imported by the functions that need it, so that the checks serve without a renderer.
"""

from __future__ import annotations

import operator
import sys
from collections.abc import Callable, Iterable, Iterator
from dataclasses import fields, is_dataclass, replace
from typing import TYPE_CHECKING, Any, TypeVar

import numpy as np
from numpy.typing import ArrayLike, NDArray

from virtual_sensor.errors import InputError, nearest, short
from virtual_sensor.seeds import LARGEST_SEED

if TYPE_CHECKING:
    from virtual_sensor.engine import mi

Result = TypeVar("Result")

LARGEST = sys.float_info.max
SMALLEST = sys.float_info.min
"""With `LARGEST` the bounds of what is positive and finite: what is less counts as 0 in threads of
Mitsuba, which flush it."""

GOLDEN = 0.6180339887498949
"""Of the golden section: what is left of its multiples beyond whole numbers lies evenly."""

_SHARE = 1 << 13
_PACKET = 64  # numbers: more than any processor's vectors hold
_ALIGNMENT = 64  # bytes: the most that Dr.Jit asks for


def whole_number(name: str, value: Any, least: int, most: int) -> int:
    """The value as int; raises InputError, naming it, if it is none within the bounds."""
    try:
        whole = least - 1 if isinstance(value, bool | np.bool_) else operator.index(value)
    except TypeError:
        whole = least - 1
    if not least <= whole <= most:
        raise InputError(
            f"{name} must be a whole number from {least} to {most}, not {short(value)}"
        )
    return whole


def number_within(name: str, value: Any, least: float, most: float, advice: str) -> float:
    """The value as float; raises InputError, naming it, if it is no number within the bounds."""
    try:
        # Texts, and arrays of one number, would pass for it.
        number = (
            float(value)
            if hasattr(value, "__float__")
            and not (getattr(value, "shape", ()) or isinstance(value, bool | np.bool_))
            else None
        )
    except (TypeError, ValueError, OverflowError):
        number = None
    if number is None or not least <= number <= most:
        raise InputError(f"{name} is {short(value)}; give {advice}")
    return number


def size_of(name: str, value: Any, most: int) -> tuple[int, int]:
    """Width and height, px; raises InputError, naming it, if these are none from 1 to `most`."""
    try:
        width, height = value
    except (TypeError, ValueError):
        raise InputError(f"{name} is {short(value)}; give (width, height) in px") from None
    sides = {"width": width, "height": height}
    width, height = (whole_number(f"{name}: {side}", n, 1, most) for side, n in sides.items())
    return width, height


def one_of(name: str, value: Any, known: Iterable[str]) -> str:
    """The value, a word; raises InputError, naming it, if it is none of the known ones."""
    known = tuple(known)
    if not isinstance(value, str) or value not in known:
        raise InputError(
            f"{name} is {short(value)}; take one of {', '.join(known)}{nearest(value, known)}"
        )
    return value


def truth_of(name: str, value: Any) -> bool:
    """The value as bool; raises InputError, naming it, unless it is True or False."""
    if not isinstance(value, bool | np.bool_):
        raise InputError(f"{name} is {short(value)}; give True or False")
    return bool(value)


def numbers_of(name: str, values: Any) -> NDArray[np.float64]:
    """The values as an array of float; raises InputError, naming them, if they are no numbers."""
    array = unmasked(values)
    if array.dtype.kind not in "bufi":
        what = short(values) if array.dtype.kind in "OUS" else f"of type {array.dtype}"
        raise InputError(f"{name} is {what}; give an array of real numbers")
    return array.astype(float)


def vector_of(name: str, values: Any) -> NDArray[np.float64]:
    """Three finite numbers, such as a point (x, y, z); raises InputError, naming them, else."""
    vector = numbers_of(name, values)
    if vector.shape != (3,) or not np.isfinite(vector).all():
        raise InputError(f"{name} is {short(values)}; give three finite numbers (x, y, z)")
    return vector


def image_of(name: str, values: ArrayLike, least: float = -LARGEST) -> NDArray[np.float64]:
    """The values as an image (H, W) of float; raises InputError, naming it, if it is none.

    A mask hides numbers, and what is not finite, or is below `least`, is none.
    """
    image = numbers_of(name, values)
    wanted = f"finite numbers{f' from {least:g} on' if least > -LARGEST else ''}"
    wanted = f"give an image (height, width) of {wanted}"
    if image.ndim != 2:
        raise InputError(f"{name} is of shape {image.shape}; {wanted}")
    if missing := int(np.sum(~np.isfinite(image))):
        raise InputError(f"{name}: {missing} of its {image.size} values are not finite; {wanted}")
    if (lowest := image.min(initial=np.inf)) < least:
        raise InputError(f"{name}: its values go down to {lowest:g}; {wanted}")
    return image


def points_of(name: str, values: ArrayLike, length: int = 3) -> NDArray[np.float64]:
    """The values as an array of float, whose shape is the caller's to check; [] as (0, length).

    Raises
    ------
    InputError
        Naming them, if they are no real numbers.
    """
    try:
        array = unmasked(values)
        if array.dtype.kind not in "bufiO" or (array.dtype.kind == "O" and not array.shape):
            raise TypeError
        array = array.astype(float, copy=False)
    except (TypeError, ValueError):
        wanted = f"real numbers, an array of shape (N, {length})"
        raise InputError(f"{name} is {short(values)}; give {wanted}") from None
    return array.reshape(0, length) if array.shape == (0,) else array


def generator_of(name: str, seed: Any) -> np.random.Generator:
    """A generator of random numbers by its seed, or itself; None: another each time.

    Raises
    ------
    InputError
        Naming it, if it is neither.
    """
    if seed is None or isinstance(seed, np.random.Generator):
        return np.random.default_rng(seed)
    return np.random.default_rng(whole_number(name, seed, 0, LARGEST_SEED))


def unmasked(values: ArrayLike) -> NDArray:
    """An array without a mask: NaN where a NumPy mask hides values.

    What is none, such as rows of different lengths, is an object.
    """
    if not np.ma.is_masked(values):
        try:
            return np.asarray(values)
        except ValueError:
            return np.array(None)
    masked: Any = np.ma.asarray(values)
    kind = np.float32 if masked.dtype in (np.uint8, np.uint16, np.float32) else np.float64
    return masked.astype(kind).filled(np.nan)


def shares(count: int) -> Iterator[slice]:
    """So many rows, a few thousand at once; one share of none.

    They stay in the processor's cache; and products of their points with matrices are too small
    for the threads of linear algebra, whose waiting for each other takes longer than the product.
    """
    return (slice(first, first + _SHARE) for first in range(0, max(count, 1), _SHARE))


# --------------------------------------------------------------------- into Dr.Jit and back


def in_own_memory(array: np.ndarray, scalar: Any) -> Any:
    """Numbers in C order, flat, as Dr.Jit's own of type `scalar`: Float, Float64 or UInt32.

    The product copies: an aliased NumPy array may be aligned too poorly for packet gathers, and how
    it is aligned would be compiled in.  The copying is waited for with the array held.
    """
    from virtual_sensor.engine import dr

    held = _with_room(array, _numpy_type(scalar)).ravel()
    own = scalar(held) * dr.opaque(scalar, 1)
    dr.eval(own)
    dr.sync_thread()
    return own


def to_scalars(values: NDArray[np.float64]) -> mi.Float64:
    """Numbers (N,) as Dr.Jit's in double precision."""
    from virtual_sensor.engine import mi

    return in_own_memory(values, mi.Float64)


def to_vectors(points: NDArray[np.float64]) -> mi.Array3f64:
    """Points (N, 3) as Dr.Jit vectors in double precision."""
    from virtual_sensor.engine import dr, mi

    held = in_own_memory(points.T, mi.Float64)
    # N is opaque, and the columns are evaluated: else kernels compile again for every number N.
    row, count = dr.arange(mi.UInt32, len(points)), dr.opaque(mi.UInt32, len(points))
    vectors = mi.Array3f64(*(dr.gather(mi.Float64, held, row + k * count) for k in range(3)))
    dr.eval(vectors)
    return vectors


def to_numpy(vectors: Any) -> NDArray[np.float64]:
    """Dr.Jit vectors of any precision, and of any length C, as rows (N, C).

    Column by column: to put them side by side in Dr.Jit compiles a kernel for every number N.
    """
    from virtual_sensor.engine import dr

    dr.eval(vectors)
    columns = (np.array(column, float) for column in vectors)
    return np.stack(np.broadcast_arrays(*columns), axis=1)  # a constant one has one row


def by_rows(compute: Callable[..., Result], *arrays: np.ndarray) -> Result:
    """What `compute` makes of arrays of equally many rows, be they none or one.

    Dr.Jit knows no empty array, and one row alone would be a constant to it, which compiles a
    kernel of its own: `compute` is given two rows at least, and the spare rows of its result are
    cut off.

    Parameters
    ----------
    compute : callable
        Gives an array of as many rows, or such arrays within tuples, dicts and dataclasses.
    arrays : ndarray of shape (N, ...)
    """
    count = len(arrays[0])
    result = compute(*map(_two, arrays))
    return result if count > 1 else _first_rows(result, count)


def _two(rows: np.ndarray) -> np.ndarray:
    """Two rows at least: the first again; where there is none, ones, which are a direction too."""
    if len(rows) > 1:
        return rows
    return np.repeat(rows if len(rows) else np.ones((1, *rows.shape[1:]), rows.dtype), 2, axis=0)


def _first_rows(tree: Any, count: int) -> Any:
    if isinstance(tree, np.ndarray):
        return tree[:count]
    if isinstance(tree, tuple):
        return tuple(_first_rows(leaf, count) for leaf in tree)
    if isinstance(tree, dict):
        return {name: _first_rows(leaf, count) for name, leaf in tree.items()}
    if is_dataclass(tree) and not isinstance(tree, type):
        leaves = {f.name: _first_rows(getattr(tree, f.name), count) for f in fields(tree)}
        return replace(tree, **leaves)
    return tree


def _with_room(array: np.ndarray, kind: Any) -> np.ndarray:
    """A copy in C order, aligned for vectors, with memory of its own behind its end.

    Dr.Jit's kernels read whole packets of numbers, the last one beyond the end of an array that is
    NumPy's: where a page ends there, the process ends by signal 11. An array without numbers would
    end it at the first kernel that reads it. The alignment is compiled in: left to chance, the same
    work would now and then compile another kernel.
    """
    if not array.size:
        raise ValueError("Dr.Jit knows no empty array: compute `by_rows`")
    room = np.empty(array.size + 2 * _PACKET, kind)
    start = -room.ctypes.data % _ALIGNMENT // room.itemsize
    held = room[start : start + array.size].reshape(array.shape)
    held[...] = array
    return held


def _numpy_type(scalar: Any) -> Any:
    from virtual_sensor.engine import dr

    return {
        dr.VarType.Float32: np.float32,
        dr.VarType.Float64: np.float64,
        dr.VarType.UInt32: np.uint32,
    }[dr.type_v(scalar)]


# -------------------------------------------------------- formulas for NumPy's and Dr.Jit's arrays


def _of_either(name: str) -> Callable[[Any], Any]:
    """A function of an array of either, which both libraries have by a name."""

    def function(x: Any) -> Any:
        if isinstance(x, float | np.ndarray):
            return getattr(np, name)(x)
        from virtual_sensor.engine import dr

        return getattr(dr, name)(x)

    return function


exp, cos, sqrt = (_of_either(name) for name in ("exp", "cos", "sqrt"))
floor = _of_either("floor")
"""Of its argument's own type."""


def where(mask: Any, x: Any, y: Any) -> Any:
    """As `numpy.where`, of arrays of either."""
    if isinstance(x, float | np.ndarray):
        return np.where(mask, x, y)
    from virtual_sensor.engine import dr

    return dr.select(mask, x, y)


def number_for(x: Any, value: float) -> Any:
    """A number for formulas with an array of either: one kernel of Dr.Jit's serves any value."""
    if isinstance(x, float | np.ndarray):
        return value
    from virtual_sensor.engine import dr

    recording = dr.flag(dr.JitFlag.SymbolicScope)  # within which nothing can be made opaque
    return value if recording else dr.opaque(type(x), value)


class Table:
    """Numbers (N,) that formulas look up by their rows, with NumPy's arrays as with Dr.Jit's.

    Within a kernel that is being recorded, they must have been looked up once before: numbers can't
    be brought into Dr.Jit's memory there.
    """

    def __init__(self, numbers: NDArray[np.float64]) -> None:
        self._numbers = numbers
        self._own: dict[type, Any] = {}

    def at(self, row: Any) -> Any:
        """The numbers of rows, which are whole numbers of a floating type."""
        if isinstance(row, float | np.ndarray):
            return self._numbers[np.asarray(row).astype(np.intp)]
        from virtual_sensor.engine import dr

        kind = type(row)
        if kind not in self._own:
            self._own[kind] = in_own_memory(self._numbers, kind)
        return dr.gather(kind, self._own[kind], dr.uint32_array_t(kind)(row))


def determinant(entries: Any) -> Any:
    """Of 2 x 2 matrices, whose four entries are given by rows."""
    a, b, c, d = entries
    return a * d - b * c


def solved(entries: Any, x: Any, y: Any) -> tuple[Any, Any]:
    """The two unknowns of 2 x 2 systems with the right sides x and y, by Cramer's rule."""
    a, b, c, d = entries
    area = determinant(entries)
    return (d * x - b * y) / area, (a * y - c * x) / area
