"""Codecs by their texts, as a command line gives them."""

from __future__ import annotations

from typing import Any

from virtual_sensor.calls import public
from virtual_sensor.errors import InputError, naming, nearest, short
from virtual_sensor.metrology.fringes.codec import Codec
from virtual_sensor.metrology.fringes.gray_code import GrayCode
from virtual_sensor.metrology.fringes.phase_shift import UNWRAP, PhaseShift
from virtual_sensor.metrology.fringes.single_shot import SingleShot

FORMS = (
    "phase STEPS [PERIOD,PERIOD,...] [uv|u|v] [hierarchical|heterodyne|gray|spatial|none]"
    " [FIRSTdeg]",
    "gray [uv|u|v] [single]",
    "single [PERIOD] [u|v|uv]",
)
_AXES = ("uv", "vu", "u", "v")


@public
def codec_of(text: str | Codec, size_px: tuple[int, int] = (1280, 800)) -> Codec:
    """A codec from its text.

    Parameters
    ----------
    text : str
        ``phase 4 16,128,1280 uv``: steps, periods in projector px, axes; then how fringe orders are
        found, if not by the periods (hierarchical): heterodyne, gray, spatial or none; and the
        phase at the image's border in the first step, if it is not 0: ``180deg``.  Without periods
        there are the default ones.  ``gray uv``: Gray code with inverses, ``gray uv
        single`` without.  ``single 16 u``: one image.  A codec is given back as it is.
    size_px : tuple of int
        (W, H) of the projector.

    Raises
    ------
    InputError
        If there is no such codec, or its periods can't be unwrapped.
    """
    if isinstance(text, Codec):
        return text
    if not isinstance(text, str) or not text.split():
        raise InputError(f"text of the codec is {short(text)}; write {', or '.join(FORMS)}")
    kind, *words = text.lower().split()
    make = {"phase": _phase, "gray": _gray, "single": _single}.get(kind)
    if make is None:
        meant = nearest(kind, ("phase", "gray", "single"))
        raise InputError(f"codec '{text}' is none; write {', or '.join(FORMS)}{meant}")
    with naming(f"codec '{text}'"):
        return make(words, size_px)


def _phase(words: list[str], size_px: tuple[int, int]) -> PhaseShift:
    starts = [word for word in words if word.endswith("deg")]
    numbers, named = _sorted_words([w for w in words if w not in starts], UNWRAP, FORMS[0])
    if starts:
        named["first_phase_deg"] = _number(starts[0].removesuffix("deg"), "degrees")
    if numbers and not _is_whole(numbers[0]):
        numbers.insert(0, "4")
    if len(numbers) > 2:
        raise InputError(f"more than steps and periods; write {FORMS[0]}")
    given: dict[str, Any] = {"steps": int(numbers[0])} if numbers else {}
    if len(numbers) == 2:
        given["periods_px"] = tuple(map(_number, filter(None, numbers[1].split(","))))
    return PhaseShift(size_px=size_px, **given, **named)


def _gray(words: list[str], size_px: tuple[int, int]) -> GrayCode:
    numbers, named = _sorted_words(words, ("single", "inverted"), FORMS[1])
    if numbers:
        raise InputError(f"Gray code has no numbers; write {FORMS[1]}")
    alone = named.pop("unwrap", "inverted") == "single"
    return GrayCode(size_px=size_px, inverted=not alone, **named)


def _single(words: list[str], size_px: tuple[int, int]) -> SingleShot:
    numbers, named = _sorted_words(words, (), FORMS[2])
    if len(numbers) > 1:
        raise InputError(f"one period, not {len(numbers)}; write {FORMS[2]}")
    given: dict[str, Any] = {"period_px": _number(numbers[0])} if numbers else {}
    return SingleShot(size_px=size_px, **given, **named)


def _sorted_words(
    words: list[str], known: tuple[str, ...], form: str
) -> tuple[list[str], dict[str, Any]]:
    """The numbers among words, and the axes and the word that is known by their names."""
    numbers: list[str] = []
    named: dict[str, Any] = {}
    for word in words:
        name = "axes" if word in _AXES else "unwrap" if word in known else ""
        if name in named:
            raise InputError(f"'{word}' after '{named[name]}'; give one of them")
        if name:
            named[name] = word
        elif word[0].isdigit():
            numbers.append(word)
        else:
            raise InputError(f"'{word}' means nothing; write {form}{nearest(word, known)}")
    return numbers, named


def _is_whole(word: str) -> bool:
    return word.isdecimal()


def _number(word: str, unit: str = "px") -> float:
    try:
        return float(word)
    except ValueError:
        raise InputError(f"'{word}' is no number of {unit}") from None
