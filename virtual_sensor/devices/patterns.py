"""Patterns that a projector shows: grey values over its pixels, plain data and formulas.

Pixels are (u, v): column and row, integers at pixel centres as in OpenCV, so that an image of
W x H px spans [-0.5, W - 0.5] x [-0.5, H - 0.5].  Grey values are 0 (no light) to 1 (all of it).
A pattern is a function of all (u, v), between pixel centres too; whether a projector shows that
function or its values at pixel centres is the projector's matter.
"""

from __future__ import annotations

import math
from abc import ABC, abstractmethod
from collections.abc import Callable
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any, Literal, get_args

import cv2
import numpy as np
from numpy.typing import NDArray

from virtual_sensor.arrays import (
    Table,
    cos,
    floor,
    image_of,
    number_for,
    number_within,
    one_of,
    truth_of,
    where,
    whole_number,
)
from virtual_sensor.calls import public
from virtual_sensor.display import Displayed, listed
from virtual_sensor.errors import InputError, naming, nearest, short
from virtual_sensor.files import exists

Axis = Literal["u", "v"]
"""Along which a pattern varies: columns or rows."""

AXES: tuple[Axis, ...] = get_args(Axis)

_MOST_BITS = 16
_FAR = 1e6  # px and rad: beyond, float32 has no fractions
_LENGTH = 1e-3, 1e9, "a length in px, from 0.001 on"
_LIGHT = "a grey value from 0 (black) to 1 (white)"


class Pattern(Displayed, ABC):
    """What a projector shows; subclasses are frozen dataclasses.

    Attributes
    ----------
    axis : "u", "v" or None
        Along which it varies, if it is the same along the other; None if it is not so.
    """

    axis: Axis | None

    @abstractmethod
    def grey(self, u: Any, v: Any) -> Any:
        """Grey values at places in px, of NumPy's arrays as of Dr.Jit's."""

    @property
    @abstractmethod
    def text(self) -> str:
        """The pattern as `pattern_of` takes it."""

    def image(self, size: tuple[int, int]) -> NDArray[np.float64]:
        """Grey values (H, W) at the pixel centres of a projector of (W, H) px."""
        u, v = np.meshgrid(*(np.arange(float(n)) for n in size))
        return np.asarray(self.grey(u, v), float)

    def _along(self, u: Any, v: Any) -> Any:
        """The coordinate that it varies along, from the image's border on."""
        return (u if self.axis == "u" else v) + 0.5


@public
@dataclass(frozen=True)
class Uniform(Pattern):
    """The same grey everywhere: 1 is all white, 0 all black.

    Attributes
    ----------
    level : float
        The grey value.
    """

    level: float = 1.0

    axis = None

    def __post_init__(self) -> None:
        number_within("Uniform: level", self.level, 0.0, 1.0, _LIGHT)

    def grey(self, u: Any, v: Any) -> Any:
        """The level."""
        return 0.0 * u + number_for(u, self.level)

    @property
    def text(self) -> str:
        """The pattern as `pattern_of` takes it."""
        return {0.0: "black", 1.0: "white"}.get(self.level, f"uniform {self.level:.12g}")


@public
@dataclass(frozen=True)
class Sine(Pattern):
    """A fringe: mean + amplitude cos(2 pi (x + 0.5)/period - phase), x being u or v.

    The phase of the fringes is 0 at the image's left or top border.

    Attributes
    ----------
    axis : "u" or "v"
    period_px : float
    phase_rad : float
        Of step k of N equal steps: 2 pi k/N.
    mean, amplitude : float
        Grey values; they stay within 0 to 1.
    """

    axis: Axis
    period_px: float
    phase_rad: float = 0.0
    mean: float = 0.5
    amplitude: float = 0.5

    def __post_init__(self) -> None:
        one_of("Sine: axis", self.axis, AXES)
        number_within("Sine: period_px", self.period_px, *_LENGTH)
        number_within("Sine: phase_rad", self.phase_rad, -_FAR, _FAR, "an angle in rad")
        number_within("Sine: mean", self.mean, 0.0, 1.0, _LIGHT)
        most = min(self.mean, 1.0 - self.mean)
        within = f"at most {most:g}, so that grey values stay within 0 to 1"
        number_within("Sine: amplitude", self.amplitude, 0.0, most * (1.0 + 1e-9), within)

    def grey(self, u: Any, v: Any) -> Any:
        """By the formula."""
        per_px = number_for(u, 2.0 * math.pi / self.period_px)
        mean, amplitude = number_for(u, self.mean), number_for(u, self.amplitude)
        return mean + amplitude * cos(self._along(u, v) * per_px - number_for(u, self.phase_rad))

    @property
    def text(self) -> str:
        """The pattern as `pattern_of` takes it."""
        levels = f" {self.mean:.12g} {self.amplitude:.12g}"
        own = levels * ((self.mean, self.amplitude) != (0.5, 0.5))
        return f"sine {self.axis} {self.period_px:.12g} {self.phase_rad:.12g}{own}"


@public
@dataclass(frozen=True)
class GrayBit(Pattern):
    """A bit of the Gray code of columns or rows: of the pixel's number n, n xor n/2.

    Attributes
    ----------
    axis : "u" or "v"
    bit : int
        From 0, the finest.
    inverted : bool
        White and black exchanged.
    """

    axis: Axis
    bit: int
    inverted: bool = False

    def __post_init__(self) -> None:
        one_of("GrayBit: axis", self.axis, AXES)
        whole_number("GrayBit: bit", self.bit, 0, _MOST_BITS - 1)
        truth_of("GrayBit: inverted", self.inverted)

    def grey(self, u: Any, v: Any) -> Any:
        """Bits b and b + 1 of n differ where floor((n + 2^b)/2^(b + 1)) is odd."""
        width = 2.0**self.bit
        along = self._along(u, v) + number_for(u, width)
        odd = _odd(floor(along * number_for(u, 0.5 / width)))
        return 1.0 - odd if self.inverted else odd

    @property
    def text(self) -> str:
        """The pattern as `pattern_of` takes it."""
        return f"gray {self.axis} {self.bit}{' inverted' * self.inverted}"


@public
@dataclass(frozen=True)
class Checker(Pattern):
    """A checkerboard of square fields, the one in the upper left corner white.

    Attributes
    ----------
    square_px : float
        Length of a field's side.
    """

    square_px: float

    axis = None

    def __post_init__(self) -> None:
        number_within("Checker: square_px", self.square_px, *_LENGTH)

    def grey(self, u: Any, v: Any) -> Any:
        """White where the fields' column and row are both even, or both odd."""
        per_px = number_for(u, 1.0 / self.square_px)
        column, row = (floor((x + 0.5) * per_px) for x in (u, v))
        return 1.0 - _odd(column + row)

    @property
    def text(self) -> str:
        """The pattern as `pattern_of` takes it."""
        return f"checker {self.square_px:.12g}"


@public
@dataclass(frozen=True)
class Stripe(Pattern):
    """A white stripe on black.

    Attributes
    ----------
    axis : "u" or "v"
        Across which it is narrow.
    middle_px, width_px : float
    """

    axis: Axis
    middle_px: float
    width_px: float

    def __post_init__(self) -> None:
        one_of("Stripe: axis", self.axis, AXES)
        number_within("Stripe: middle_px", self.middle_px, -_FAR, _FAR, "a place in px")
        number_within("Stripe: width_px", self.width_px, *_LENGTH)

    def grey(self, u: Any, v: Any) -> Any:
        """White up to half its width from its middle."""
        beside = abs(self._along(u, v) - number_for(u, self.middle_px + 0.5))
        return where(beside < number_for(u, 0.5 * self.width_px), 0.0 * u + 1.0, 0.0 * u)

    @property
    def text(self) -> str:
        """The pattern as `pattern_of` takes it."""
        return f"stripe {self.axis} {self.middle_px:.12g} {self.width_px:.12g}"


@public
@dataclass(frozen=True)
class Picture(Pattern):
    """An image of the projector's size.

    Attributes
    ----------
    values : ndarray of shape (H, W)
        Grey values 0 to 1 at pixel centres; between them they are interpolated linearly, and
        beyond the outermost they stay.
    name : str
        Of the file from which it was read; empty if from none.
    """

    values: NDArray[np.float64]
    name: str = field(default="", compare=False)
    _table: Table = field(init=False, repr=False, compare=False)

    axis = None

    def __post_init__(self) -> None:
        values = image_of("Picture: values", self.values, 0.0)
        if not values.size or values.max() > 1.0:
            highest = f"go up to {values.max():g}" if values.size else "are none"
            raise InputError(f"Picture: its values {highest}; give grey values from 0 to 1")
        values.flags.writeable = False
        object.__setattr__(self, "values", values)
        object.__setattr__(self, "_table", Table(values.ravel()))

    def _line(self) -> str:
        height, width = self.values.shape
        return listed(Path(self.name).name, f"{width} x {height} px")

    def grey(self, u: Any, v: Any) -> Any:
        """Bilinear between pixel centres."""
        height, width = self.values.shape
        column, right = _cell(u, width)
        row, low = _cell(v, height)
        first = row * width + column
        beside, below = min(1, width - 1), width * min(1, height - 1)
        (a, b), (c, d) = (
            (self._table.at(start), self._table.at(start + beside))
            for start in (first, first + below)
        )
        upper, lower = a + (b - a) * right, c + (d - c) * right
        return upper + (lower - upper) * low

    @property
    def text(self) -> str:
        """Its file."""
        return self.name


def _odd(whole: Any) -> Any:
    """1 of odd whole numbers, 0 of even ones."""
    return whole - 2.0 * floor(0.5 * whole)


def _cell(x: Any, count: int) -> tuple[Any, Any]:
    """The cell of a row of samples that holds x, and how far in it: both of x's own type."""
    last = number_for(x, count - 1.0)
    inside = where(x < last, x, last)
    inside = where(inside > 0.0, inside, 0.0)  # NaN too: what is not finite reads no memory
    cell = floor(where(inside < last, inside, last - min(1.0, count - 1.0)))
    return cell, where(x == x, inside - cell, x)


# --------------------------------------------------------------------- from texts


def _number_of(word: str) -> float:
    try:
        return float(word)
    except ValueError:
        raise InputError(f'"{word}" is not a number') from None


def _whole_of(word: str) -> int:
    try:
        return int(word)
    except ValueError:
        raise InputError(f'"{word}" is not a whole number') from None


def _axis_of(word: str) -> Any:
    return one_of("its axis", word, AXES)


def _inverted(word: str) -> bool:
    return one_of("its last word", word, ["inverted"]) == "inverted"


_NUMBER = _number_of
_KINDS: dict[str, tuple[Callable[..., Pattern], int, tuple[Callable[[str], Any], ...], str]] = {
    "white": (lambda: Uniform(1.0), 0, (), "white"),
    "black": (lambda: Uniform(0.0), 0, (), "black"),
    "uniform": (Uniform, 1, (_NUMBER,), "uniform LEVEL"),
    "sine": (Sine, 2, (_axis_of, *[_NUMBER] * 4), "sine u|v PERIOD [PHASE [MEAN AMPLITUDE]]"),
    "gray": (GrayBit, 2, (_axis_of, _whole_of, _inverted), "gray u|v BIT [inverted]"),
    "checker": (Checker, 1, (_NUMBER,), "checker SQUARE"),
    "stripe": (Stripe, 3, (_axis_of, _NUMBER, _NUMBER), "stripe u|v MIDDLE WIDTH"),
}
"""By the first word of a text: what makes the pattern, how many words it needs, and of what."""


@public
def pattern_of(text: str | Path | Pattern, folders: tuple[Path, ...] = ()) -> Pattern:
    """A pattern from its text.

    Parameters
    ----------
    text : str, Path or Pattern
        ``white``, ``black``, ``uniform 0.5``, ``sine u 16 0`` (axis, period in px, phase in rad;
        then mean and amplitude), ``gray u 3``, ``gray v 0 inverted``, ``checker 40`` (px), ``stripe
        u 640 8`` (middle and width in px), or an image file: PNG, TIFF, BMP or JPEG, grey.
    folders : tuple of Path
        Where files are looked for; the working folder if there is none.

    Raises
    ------
    InputError
        If there is no such pattern or file, or it can't be; it says what there is.
    """
    if isinstance(text, Pattern):
        return text
    if not isinstance(text, str | Path):
        raise InputError(f"pattern is {short(text)}; give its text, such as 'sine u 16 0'")
    words = str(text).replace(",", " ").split()
    if isinstance(text, str) and words and (kind := words[0].lower()) in _KINDS:
        make, needed, readers, form = _KINDS[kind]
        if not needed <= len(words) - 1 <= len(readers):
            raise InputError(f"pattern '{text}' has another number of words; write {form}")
        try:
            return make(*(read(word) for read, word in zip(readers, words[1:], strict=False)))
        except InputError as why:
            raise InputError(f"pattern '{text}': {why}; write {form}") from None
    for folder in folders or (Path(),):
        if words and exists(file := folder / str(text)) and file.is_file():
            with naming(file):
                return Picture(_read_picture(file), str(text))
    forms = ", ".join(form for *_, form in _KINDS.values())
    guess = nearest(words[0], _KINDS) if words else ""
    raise InputError(
        f"pattern {short(str(text))} is neither an image file nor one of: {forms}{guess}"
    )


def _read_picture(file: Path) -> NDArray[np.float64]:
    """Grey values 0 to 1, (H, W), of an image file."""
    try:
        data = np.frombuffer(file.read_bytes(), np.uint8)
    except OSError as why:
        raise InputError(f"can't be read: {why.strerror}") from None
    image = cv2.imdecode(data, cv2.IMREAD_UNCHANGED) if data.size else None
    if image is None:
        raise InputError("is no image that can be read; give a PNG, TIFF, BMP or JPEG")
    if image.ndim == 3:
        colours = image[:, :, : 1 if image.shape[2] == 2 else 3]
        if (colours != colours[:, :, :1]).any():
            raise InputError("is in colour; a pattern is grey: convert it")
        image = colours[:, :, 0]
    scale = float(np.iinfo(image.dtype).max) if image.dtype.kind in "ui" else 1.0
    return image.astype(float) / scale
