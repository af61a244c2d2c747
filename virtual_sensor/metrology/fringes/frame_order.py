"""Whether images are those of a codec's patterns, in their order: the images themselves tell.

In the right order the steps of each period lie on a cosine about one mean, the periods agree on the
fringe order, and each bit of Gray code and its inverse add up to the same.  In another order they
do not.  What a mirrored or turned projector would show as well, they can't always tell: all steps
the other way round, or columns and rows exchanged.
"""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from dataclasses import dataclass, replace
from itertools import combinations, pairwise
from typing import Any

import numpy as np
from numpy.typing import NDArray

from virtual_sensor.devices.patterns import GrayBit, Pattern, Sine
from virtual_sensor.display import Displayed
from virtual_sensor.metrology.fringes.codec import Codec
from virtual_sensor.metrology.fringes.gray_code import GrayCode, position
from virtual_sensor.metrology.fringes.phase_shift import PhaseShift

Grey = NDArray[np.float64]
Order = tuple[int, ...]
"""Of each pattern, the number of its image."""

RIGHT, WRONG = 0.25, 0.45
"""Disorder up to which an order is right, and from which on it is wrong."""

STEPS_BACKWARDS = "steps-backwards"
"""The order of sequences whose step k shows A + B cos(phi + theta_k): their first steps agree."""

_PIXELS = 1000
_LIT = 0.3  # of the strongest change from image to image: pixels that change less are no witnesses
_FEWEST_PIXELS = 30
_APART = 0.6  # half periods by which orders disagree
_BY_CHANCE = 1.0 - _APART
_FIRST_DEG = (180.0, -90.0, 90.0)  # phases that sequences start with, other than 0 and a step
_TOGETHER = 0.7  # mean of unit vectors of the differences from which on they are much the same
_EVEN = 0.02  # disorders that differ by no more are equal
_ALIKE = 0.25  # of the next least difference: images that differ by less show the same
_ROOM = 1.1  # of codes, or of the periods' range, over the image: then places may lie beyond it


@dataclass(frozen=True)
class OrderCheck(Displayed):
    """What images say of their order.

    Attributes
    ----------
    disorder : float
        0: all agree with the codec; 1: as images in any order; NaN where they can't tell.
    order : tuple of int or None
        Of each pattern, the number of its image, of a better order; None if there is none.
    words : str
        What is wrong, and the better order or codec; empty if all is right.
    codec : PhaseShift or None
        Whose fringes start with another phase, and which they fit, in `order` where there is one;
        None if there is none.
    """

    disorder: float
    order: Order | None
    words: str
    codec: PhaseShift | None = None


def check_order(
    codec: Codec, images: Sequence[NDArray[Any]], saturation: float = np.inf
) -> OrderCheck:
    """Check images' order, and look for a better one among those that are usual.

    Parameters
    ----------
    codec : Codec
    images : sequence of ndarrays of shape (H, W)
        As many as the codec has patterns.
    saturation : float
        Grey value from which on pixels are clipped: they are no witnesses.
    """
    grey = witnesses(images, saturation)
    usual = tuple(range(len(codec)))
    disorder = disorder_of(codec, grey, usual)
    if not disorder > RIGHT:
        return OrderCheck(disorder, None, "")
    if isinstance(codec, PhaseShift):
        step = 360.0 / codec.steps
        turned = _steps_backwards(codec)
        # The other way round, steps that start with cosines are an order of their own: see below.
        for order, extra in ((usual, ""), (turned, f" with --order {STEPS_BACKWARDS}")):
            for first in dict.fromkeys((*_FIRST_DEG, -step, step)):
                other = replace(codec, first_phase_deg=first)
                if disorder_of(other, grey, order) <= RIGHT:
                    words = f"their fringes start with another phase: they fit '{other.text}'"
                    better = order if extra else None
                    return OrderCheck(disorder, better, words + extra, other)
    scored = [(disorder_of(codec, grey, order), name, order) for name, order in orders_of(codec)]
    if all(each[0] > RIGHT for each in scored):
        scored += [(disorder_of(codec, grey, order), name, order) for name, order in _swaps(codec)]
    least = min((each[0] for each in scored), default=disorder)
    # Several may fit, some of them mirrored: the simplest stands first.
    good = (each for each in scored if each[0] <= least + _EVEN)
    best, name, order = next(good, (disorder, "", usual))
    if best < min(RIGHT, 0.5 * disorder):
        words = f"they agree with it in another order: {name}"
        return OrderCheck(disorder, order, words)
    if disorder < WRONG:
        return OrderCheck(disorder, None, "")
    return OrderCheck(
        disorder,
        None,
        "they contradict it in any order that is usual: are they of other steps, periods or another"
        " size of the projector, did something move, or drown in noise?",
    )


def missing_patterns(codec: Codec, images: Sequence[NDArray[Any]]) -> tuple[str, ...]:
    """Names of the patterns one of which has no image, where there is one image too few.

    A bit of Gray code can't be told from its inverse: two names. Empty if the images can't tell.
    """
    grey, count = witnesses(images), len(codec)
    scored = []
    for gap, name in enumerate(codec.names):
        order = tuple(n - (n > gap) if n != gap else -1 for n in range(count))
        scored.append((disorder_of(codec, grey, order), name))
    scored.sort()
    return _clear(scored, 2)


def spare_images(codec: Codec, images: Sequence[NDArray[Any]]) -> Order:
    """Numbers of the images that are none of the patterns', where there are some too many.

    One may be anywhere, two are at the ends.
    """
    grey, spare = witnesses(images), len(images) - len(codec)
    count, last = range(len(images)), len(images) - 1
    ends: dict[int, list[Order]] = {
        1: [(n,) for n in count],
        2: [(0, 1), (last - 1, last), (0, last)],
    }
    scored = []
    for others in ends.get(spare, []):
        order = tuple(n for n in count if n not in others)
        scored.append((disorder_of(codec, grey, order), others))
    scored.sort()
    return next(iter(_clear(scored, 1)), ())


def same_images(images: Sequence[NDArray[Any]]) -> tuple[int, int] | None:
    """Numbers of two images that show the same, but for noise; None if there are none."""
    grey = witnesses(images)
    pairs = combinations(range(len(images)), 2)
    apart = sorted((float(np.sqrt(np.mean((grey[a] - grey[b]) ** 2))), (a, b)) for a, b in pairs)
    if grey.shape[1] < _FEWEST_PIXELS or len(apart) < 2:
        return None
    (least, same), (others, _) = apart[:2]
    return same if least == 0.0 or least < _ALIKE * others else None


def _clear(scored: list[tuple[float, Any]], most: int) -> tuple[Any, ...]:
    """What is right, where that is clearly better than the rest."""
    good = [each for each in scored if each[0] <= min(RIGHT, scored[0][0] + _EVEN)]
    others = scored[len(good) :]
    if not good or len(good) > most or (others and others[0][0] < 2.0 * good[-1][0] + _EVEN):
        return ()
    return tuple(each for _, each in good)


def witnesses(images: Sequence[NDArray[Any]], saturation: float = np.inf) -> Grey:
    """Grey values (K, P) of pixels that change much from image to image, and are never clipped."""
    height, width = images[0].shape
    step = max(1, int(np.sqrt(height * width / (20.0 * _PIXELS))))
    grey = np.stack([np.asarray(each[::step, ::step], float).ravel() for each in images])
    grey = grey[:, (np.isfinite(grey) & (grey < saturation)).all(axis=0)]
    change = np.ptp(grey, axis=0)
    seen = change > _LIT * np.percentile(change, 99.0) if change.size else np.zeros(0, bool)
    grey = grey[:, seen & (change > 0.0)]
    return grey[:, :: max(1, grey.shape[1] // _PIXELS)]


def disorder_of(codec: Codec, grey: Grey, order: Order) -> float:
    """How much grey values (K, P) contradict a codec, 0 to 1; NaN where they can't.

    `order` says which image is of each pattern; -1: none.
    """
    if grey.shape[1] < _FEWEST_PIXELS:
        return np.nan
    if isinstance(codec, PhaseShift):
        found = [*_of_phases(codec, grey, order)]
    elif isinstance(codec, GrayCode) and codec.inverted:
        found = [*_of_bits(codec, grey, order)]
    else:
        found = []
    return max((each for each in found if each == each), default=np.nan) if found else np.nan


def _of_phases(codec: PhaseShift, grey: Grey, order: Order) -> Iterator[float]:
    """Misfit of all steps about one mean, and disagreement on the fringe order by axis."""
    there = [(pattern, n) for pattern, n in zip(codec.patterns, order, strict=True) if n >= 0]
    sines = [(pattern, n) for pattern, n in there if isinstance(pattern, Sine)]
    groups = list(dict.fromkeys((pattern.axis, pattern.period_px) for pattern, _ in sines))
    design = np.zeros((len(sines), 1 + 2 * len(groups)))
    design[:, 0] = 1.0
    for row, (pattern, _) in enumerate(sines):
        column = 1 + 2 * groups.index((pattern.axis, pattern.period_px))
        design[row, column : column + 2] = np.cos(pattern.phase_rad), np.sin(pattern.phase_rad)
    shown = grey[[n for _, n in sines]]
    if np.linalg.matrix_rank(design) < design.shape[1]:
        yield np.nan
        return
    fitted = np.linalg.pinv(design) @ shown
    left = np.sqrt(np.mean((shown - design @ fitted) ** 2, axis=0))
    strength = np.hypot(fitted[1::2], fitted[2::2])
    whole = np.sqrt(np.mean((shown - shown.mean(axis=0)) ** 2, axis=0))
    free = len(sines) - design.shape[1]
    if free > 0:
        by_chance = np.sqrt(free / max(len(sines) - 1, 1))
        yield float(np.median(left / np.maximum(whole, 1e-300)) / by_chance)
    yield float(np.mean(strength.min(axis=0) < 0.1 * strength.max(axis=0)))
    if not codec.absolute:
        return
    turns = (np.arctan2(fitted[2::2], fitted[1::2]) / (2.0 * np.pi) % 1.0).astype(np.float32)
    for axis in codec.axes:
        size = codec.axis_px(axis)
        mine = sorted((period, n) for n, (of, period) in enumerate(groups) if of == axis)
        here = [turns[n] for _, n in mine]
        if codec.unwrap == "gray":
            bits = [n for p, n in there if isinstance(p, GrayBit) and p.axis == axis]
            if len(bits) < len(codec.bits_of(axis)):
                yield np.nan
                continue
            place, _ = position(grey[bits] > fitted[0], codec.bits_of(axis))
            off = place / np.float32(mine[0][0]) - here[0]
            off -= np.rint(off)
            yield float(np.mean(2.0 * np.abs(off) > _APART) / _BY_CHANCE)
            yield _offset(off)
            yield _beyond(place, size, 2.0 ** (codec.bits_of(axis)[0] + 1))
        elif len(here) > 1:
            length, disagreement = codec.chains[axis].orders(here, size)
            yield float(np.mean(disagreement > _APART) / _BY_CHANCE)
            periods = [period for period, _ in mine]
            pairs = pairwise(zip(periods, here, strict=True))
            for (fine, phase), (coarse, place) in pairs:
                yield _offset(place * np.float32(coarse / fine) - phase)
            yield _beyond(mine[0][0] * length, size, codec.chains[axis].range_px)


def _offset(off: NDArray[Any]) -> float:
    """How far orders are off by the same, as where fringes start with another phase; in turns x 4.

    Where they are off by this and that, it is 0.
    """
    mean = complex(np.mean(np.exp(2j * np.pi * off)))
    return 4.0 * abs(np.angle(mean)) / (2.0 * np.pi) if abs(mean) > _TOGETHER else 0.0


def _of_bits(codec: GrayCode, grey: Grey, order: Order) -> Iterator[float]:
    """How much the sums of bits and their inverses differ, and what lies beyond the image."""
    pairs = [(a, b) for a, b in zip(order[::2], order[1::2], strict=True) if a >= 0 and b >= 0]
    sums = np.stack([grey[a] + grey[b] for a, b in pairs])
    apart = np.stack([np.abs(grey[a] - grey[b]) for a, b in pairs])
    off = np.abs(sums - np.median(sums, axis=0))
    yield float(np.mean(off > 0.5 * np.median(apart, axis=0)) * 2.0)
    if len(pairs) < len(order) // 2:
        return
    for axis in codec.axes:
        mine = order[codec.images_of(axis)]
        bright = grey[list(mine[::2])] > grey[list(mine[1::2])]
        place, _ = position(bright, codec.bits_of(axis))
        yield _beyond(place, codec.axis_px(axis), 2.0 ** len(codec.bits_of(axis)))


def _beyond(place: NDArray[Any], size: int, range_px: float) -> float:
    """Share of the places beyond an image, over that of places anywhere within a range."""
    if range_px < _ROOM * size:
        return 0.0
    return float(np.mean((place < -1.0) | (place > size + 1.0)) / (1.0 - size / range_px))


def orders_of(codec: Codec) -> Iterator[tuple[str, Order]]:
    """Orders that sequences have, by their names: which image is of each pattern."""
    count = len(codec)
    patterns, usual = codec.patterns, tuple(range(count))
    keys = {
        "coarse-first": lambda p: (_axis(p), _is_bit(p), -_period(p), _phase(p)),
        "fine-first": lambda p: (_axis(p), _is_bit(p), _period(p), _phase(p)),
        "steps-first": lambda p: (_axis(p), _is_bit(p), _phase(p), usual_of(p)),
        "gray-first": lambda p: (_axis(p), not _is_bit(p), usual_of(p)),
        "rows-first": lambda p: (-ord(_axis(p)), usual_of(p)),
        "fine-bits-first": lambda p: (_axis(p), _is_bit(p), _bit(p), usual_of(p)),
    }

    def usual_of(pattern: Pattern) -> int:
        return patterns.index(pattern)

    named = [("", usual)]
    for name, key in keys.items():
        shot = sorted(range(count), key=lambda n, key=key: key(patterns[n]))  # type: ignore[misc]
        for label, sequence in ((name, shot), (f"{name} backwards", shot[::-1])):
            named.append((label, tuple(sequence.index(n) for n in range(count))))
    named.append(("backwards", usual[::-1]))
    by_text = sorted(range(1, count + 1), key=str)
    named.append(("by-text", tuple(by_text.index(n) for n in range(1, count + 1))))
    named.append(("by-number", tuple(n - 1 for n in by_text)))
    turned = _steps_backwards(codec)
    named += [
        (f"{name} {STEPS_BACKWARDS}".strip(), tuple(order[n] for n in turned))
        for name, order in named
        if "backwards" not in name
    ]
    seen = {usual}
    for name, order in named:
        if order not in seen:
            seen.add(order)
            yield name, order


def _steps_backwards(codec: Codec) -> Order:
    """The first step of all fringes, then the others in falling order, as of cos(phi + theta)."""
    found = list(range(len(codec)))
    of: dict[tuple[str, float], list[int]] = {}
    for n, pattern in enumerate(codec.patterns):
        if isinstance(pattern, Sine):
            of.setdefault((pattern.axis, pattern.period_px), []).append(n)
    for first, *others in of.values():
        found[first : first + 1 + len(others)] = [first, *reversed(others)]
    return tuple(found)


def _swaps(codec: Codec) -> Iterator[tuple[str, Order]]:
    """Two images exchanged."""
    names = codec.names
    for a, b in combinations(range(len(codec)), 2):
        order = list(range(len(codec)))
        order[a], order[b] = b, a
        yield f"'{names[a]}' and '{names[b]}' exchanged", tuple(order)


def order_named(codec: Codec, text: str) -> Order | None:
    """An order by its name, or by numbers from 1 on with commas: of each pattern its image."""
    usual = tuple(range(len(codec)))
    if text == "usual":
        return usual
    words = text.replace(" ", "").split(",")
    if all(word.isdecimal() for word in words):
        order = tuple(int(word) - 1 for word in words)
        return order if sorted(order) == list(usual) else None
    return dict(orders_of(codec)).get(text)


def _axis(pattern: Pattern) -> str:
    return pattern.axis or "u"


def _is_bit(pattern: Pattern) -> bool:
    return isinstance(pattern, GrayBit)


def _period(pattern: Pattern) -> float:
    return pattern.period_px if isinstance(pattern, Sine) else 0.0


def _phase(pattern: Pattern) -> float:
    return pattern.phase_rad if isinstance(pattern, Sine) else 0.0


def _bit(pattern: Pattern) -> int:
    return pattern.bit if isinstance(pattern, GrayBit) else 0
