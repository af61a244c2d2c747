"""A user's own sequence of images of fringes: read, put in order, decoded."""

from __future__ import annotations

import re
import time
from collections.abc import Callable, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from virtual_sensor.devices.image_sensor import LinearGrey
from virtual_sensor.display import Displayed, listed
from virtual_sensor.errors import InputError, few, nearest
from virtual_sensor.imaging.image_files import Image, find_images, read_image
from virtual_sensor.imaging.line_colours import COLOURS
from virtual_sensor.metrology.fringes.codec import LEAST_MODULATION, Codec
from virtual_sensor.metrology.fringes.codecs import codec_of
from virtual_sensor.metrology.fringes.decoded import DecodedFringes, FringeStatus
from virtual_sensor.metrology.fringes.frame_order import (
    STEPS_BACKWARDS,
    Order,
    check_order,
    missing_patterns,
    order_named,
    orders_of,
    same_images,
    spare_images,
)
from virtual_sensor.metrology.fringes.phase_shift import PhaseShift
from virtual_sensor.metrology.line_profiles import known_of
from virtual_sensor.records import Record, Table
from virtual_sensor.studies.detect import joined_notes
from virtual_sensor.studies.fringes.decoded_facts import DecodedFacts

Array = NDArray[np.float64]
Report = Callable[[str, float], None]

AUTO, USUAL = "auto", "usual"

_MOST_NAMED = 4  # files in a message
_DOUBTFUL = 0.125  # disorder from which on two images that are alike are a slip
_MUCH = 0.01  # of the lit pixels, from which on a status is noted


@dataclass(frozen=True)
class DecodeSettings(Record):
    """How a sequence is decoded: see `codec_of`, `read_image` and `PhaseShift.decode`.

    Attributes
    ----------
    codec : str
        Of the patterns, such as "phase 4 16,128,1280 uv".
    size_px : tuple of int
        Width and height of the projector.
    order : str
        "usual": the codec's; a name of another, such as "coarse-first"; numbers with commas: of
        each pattern its image, from 1 on; "auto": what the images tell.
    channel : str or None
        Of colour images.
    bits : int or None
        Of the camera, where the files have more.
    noise : float or None
        Standard deviation of dark grey values; None: as the files say, else as the images show.
    gain : float
        Grey values per electron, for the shot noise; 0: as the files say, else none.
    black : float or None
        Grey value of a pixel without light; None: as the files say, else 0.
    saturation : float or None
        Grey value from which on pixels are clipped; None: as the files say.
    least_modulation : float
        Amplitude of the weakest fringes, relative to the image's strongest.
    border_px : float
        Of the projector's image: that is left out.
    """

    codec: str
    size_px: tuple[int, int] = (1280, 800)
    order: str = USUAL
    channel: str | None = None
    bits: int | None = None
    noise: float | None = None
    gain: float = 0.0
    black: float | None = None
    saturation: float | None = None
    least_modulation: float = LEAST_MODULATION
    border_px: float = 0.0


@dataclass(frozen=True)
class SequenceTable(Table):
    """The images of a sequence, pattern by pattern.

    Attributes
    ----------
    pattern : sequence of str
        What was projected.
    file : sequence of str
        Name of its image.
    mean_grey, largest_grey : ndarray of shape (K,)
        Of the image's grey values.
    clipped_percent : ndarray of shape (K,)
        Share of its pixels that are clipped.
    """

    pattern: Sequence[str]
    file: Sequence[str]
    mean_grey: Array
    largest_grey: Array
    clipped_percent: Array


@dataclass(frozen=True)
class SequenceSummary(DecodedFacts):
    """What a sequence shows.

    Attributes
    ----------
    images : int
    size_px : tuple of int
        Width and height of an image.
    columns, rows : tuple of float or None
        Least and largest projector coordinate; None without.
    noise : float
        Standard deviation of the grey values, as given or as the images show it.
    wrong_orders : float
        Expected share of the pixels whose fringe order is wrong, by the noise.
    disorder : float or None
        How much the images contradict the codec: 0, not at all, to 1; None where they can't tell.
    absolute : bool
        False where coordinates lack whole periods.
    time_s : float
        That decoding took.
    """

    images: int
    size_px: tuple[int, int]
    columns: tuple[float, float] | None
    rows: tuple[float, float] | None
    noise: float
    wrong_orders: float
    disorder: float | None
    absolute: bool
    time_s: float


@dataclass(frozen=True)
class DecodedSequence(Displayed):
    """A sequence of images and what was decoded.

    Attributes
    ----------
    codec : PhaseShift, GrayCode or SingleShot
    paths : tuple of Path
        Of the images, in the codec's order.
    images : ndarray of shape (K, H, W)
        In that order.
    decoded : DecodedFringes
    table : SequenceTable
    summary : SequenceSummary
    notes : tuple of str
        What was converted, assumed or is doubtful.
    """

    codec: Codec
    paths: tuple[Path, ...]
    images: NDArray[Any]
    decoded: DecodedFringes
    table: SequenceTable
    summary: SequenceSummary
    notes: tuple[str, ...]

    def _line(self) -> str:
        return listed(f"{len(self.paths)} images", self.decoded._line())


def sequence_files(places: Sequence[Path]) -> tuple[list[Path], tuple[str, ...]]:
    """Images in the order given; those of a folder by name, with numbers in them by their value.

    Raises
    ------
    InputError
        If a place does not exist, or a folder holds no image.
    """
    found: list[Path] = []
    notes: tuple[str, ...] = ()
    for place in places:
        paths, said = find_images([place])
        found += sorted(paths, key=lambda path: _by_number(path.name))
        notes += said
    return list(dict.fromkeys(found)), notes


def decode_sequence(
    paths: Sequence[Path],
    settings: DecodeSettings,
    report: Report = lambda stage, fraction: None,
) -> DecodedSequence:
    """Decode a sequence of images.

    Parameters
    ----------
    paths : sequence of Path
        In the order of the patterns, or of `settings.order`.
    settings : DecodeSettings
    report : callable
        Gets what is done and the fraction done.

    Raises
    ------
    InputError
        If there are too few images or too many, with those that are missing or spare if the images
        tell; if they are in another order, with its name; if one can't be read, or is of another
        size.
    """
    codec = codec_of(settings.codec, settings.size_px)
    images, largest, known, remarks = _read(paths, settings, report)
    saturation = largest if settings.saturation is None else min(settings.saturation, largest)
    if len(images) != len(codec):
        raise InputError(_wrong_number(codec, paths, images))
    order = _asked_order(codec, settings.order)
    report("checking the order", 0.6)
    in_order = [images[n] for n in order]
    check = check_order(codec, in_order, saturation)
    names = [paths[n].name for n in order]
    notes = list(joined_notes(remarks))
    if check.codec is not None:
        if settings.order != AUTO:
            raise InputError(f"the images are not those of '{codec.text}': {check.words}")
        notes.append(f"The images are of another codec: {check.words}.")
        codec = check.codec
    elif check.order is not None:
        words = _better_order(codec, check.order, names)
        if settings.order != AUTO:
            raise InputError(f"the images are not in the order of '{codec.text}': {words[0]}")
        notes.append(f"The images are in another order than the codec's: {words[1]}.")
    elif check.disorder > _DOUBTFUL and (same := same_images(in_order)):
        first, second = (f"{names[n]} ('{codec.names[n]}')" for n in same)
        said = f"{first} and {second} are the same image, but for noise"
        if settings.order != AUTO:
            raise InputError(f"{said}: take one of them again; --order auto decodes them all")
        notes.append(f"{said}: take one of them again.")
    elif check.words:
        notes.append(
            f"The images contradict '{codec.text}' (disorder {check.disorder:.2f}): {check.words}"
        )
    if check.order is not None:
        order = tuple(order[n] for n in check.order)
    stack = np.stack([images[n] for n in order])
    report("decoding", 0.7)
    began = time.perf_counter()
    decoded = codec.decode(
        LinearGrey(stack, known),
        noise=settings.noise,
        gain=settings.gain,
        black=settings.black,
        saturation=saturation,
        least_modulation=settings.least_modulation,
        border_px=settings.border_px,
    )
    time_s = time.perf_counter() - began
    chosen = tuple(paths[n] for n in order)
    table = _table(codec, chosen, stack, saturation)
    notes += [*decoded.notes, *_doubts(codec, table, decoded)]
    summary = _summary(stack, decoded, check.disorder, time_s)
    return DecodedSequence(codec, chosen, stack, decoded, table, summary, tuple(notes))


def _read(
    paths: Sequence[Path], settings: DecodeSettings, report: Report
) -> tuple[list[NDArray[Any]], float, dict[str, float], list[tuple[Path, Sequence[str]]]]:
    """All images, the least level at which one is clipped, what all files say, and remarks."""
    images: list[NDArray[Any]] = []
    known: list[Image] = []
    remarks: list[tuple[Path, Sequence[str]]] = []
    for number, path in enumerate(paths):
        report(f"reading {path.name}", 0.6 * number / len(paths))
        read = read_image(path, settings.channel, settings.bits)
        if read.channel in COLOURS and settings.channel is None:
            raise InputError(
                f"{path}: is a colour image; say which channel: {', '.join(COLOURS)} (--channel"
                " green)"
            )
        if images and read.pixels.shape != images[0].shape:
            (here, there) = (
                f"{each.shape[1]} x {each.shape[0]} px" for each in (read.pixels, images[0])
            )
            raise InputError(
                f"{path}: is {here}, but {paths[0].name} is {there}; give the images of one"
                " sequence alone"
            )
        if images and read.pixels.dtype != images[0].dtype:
            (here, there) = (f"{each.dtype}" for each in (read.pixels, images[0]))
            raise InputError(
                f"{path}: holds {here}, but {paths[0].name} {there}; save the images of one"
                " sequence alike"
            )
        known.append(read.linear_grey)
        images.append(known[-1].pixels)
        remarks.append((path, [note.removeprefix(f"{path}: ") for note in read.notes]))
    levels = (np.inf if each.largest is None else each.largest for each in known)
    return images, min(levels), known_of(known), remarks


def _wrong_number(codec: Codec, paths: Sequence[Path], images: Sequence[NDArray[Any]]) -> str:
    """What to say of a sequence with too few images, or too many."""
    names = [path.name for path in paths]
    said = f"{len(images)} images, but '{codec.text}' has {len(codec)} patterns"
    remedy = "give one image of each, in its order, or another --codec"
    if len(images) > len(codec) and (same := same_images(images)):
        first, second = (names[n] for n in same)
        return f"{said}: {first} and {second} are the same image; leave one out"
    missing = missing_patterns(codec, images) if len(images) == len(codec) - 1 else ()
    if missing:
        gap = codec.names.index(missing[0])
        between = " and ".join(names[max(gap - 1, 0) : gap + 1])
        place = f"between {between}" if 0 < gap < len(names) else f"beside {between}"
        which = " or ".join(f"'{name}'" for name in missing)
        return f"{said}: {which} is missing, {place}; add it"
    spare = [names[n] for n in spare_images(codec, images)]
    if spare:
        which = "it" if len(spare) == 1 else "them"
        return f"{said}: {' and '.join(spare)} fit none of them; leave {which} out"
    return f"{said}: {few(list(codec.names), _MOST_NAMED)}; {remedy}"


def _asked_order(codec: Codec, text: str) -> Order:
    """Of each pattern the number of its image, as `--order` says."""
    order = order_named(codec, USUAL if text == AUTO else text)
    if order is None:
        known = [USUAL, AUTO, *(name for name, _ in orders_of(codec))]
        raise InputError(
            f"--order {text}: take one of {', '.join(known)}{nearest(text, known)}; or of each"
            f" pattern the number of its image, from 1 to {len(codec)}, with commas"
        )
    return order


def _better_order(codec: Codec, order: Order, names: Sequence[str]) -> tuple[str, str]:
    """What is wrong, with its remedy; and what was taken instead."""
    moved = [n for n, image in enumerate(order) if image != n]
    if len(moved) == 2:
        first, second = (names[n] for n in moved)
        said = f"{first} and {second} are exchanged"
        return f"{said}; rename them, or say --order auto", said
    known = {found: name for name, found in orders_of(codec)}
    name = known.get(order, ",".join(str(n + 1) for n in order))
    return f"they fit it as '{name}'; say --order {name}", f"'{name}' was taken"


def _table(
    codec: Codec, paths: Sequence[Path], stack: NDArray[Any], saturation: float
) -> SequenceTable:
    with np.errstate(all="ignore"):
        return SequenceTable(
            pattern=codec.names,
            file=tuple(path.name for path in paths),
            mean_grey=np.array([float(np.nanmean(image)) for image in stack]),
            largest_grey=np.array([float(np.nanmax(image, initial=0.0)) for image in stack]),
            clipped_percent=np.array([100.0 * np.mean(image >= saturation) for image in stack]),
        )


def _doubts(codec: Codec, table: SequenceTable, decoded: DecodedFringes) -> list[str]:
    """Notes on what the images, or what was decoded, make doubtful."""
    notes = []
    counts = FringeStatus.counts(decoded.status)
    lit = decoded.status.size - counts.get(FringeStatus.BLACK, 0)
    for status in (FringeStatus.SATURATED, FringeStatus.ORDER, FringeStatus.OUTSIDE):
        share, name = counts.get(status, 0) / max(lit, 1), status.name.lower()
        if share > _MUCH:
            notes.append(f"{share:.0%} of the lit pixels are {name}: {status.message}")
    if "uv" in (codec.axes, codec.axes[::-1]) and _turned(decoded):
        notes.append(
            "Columns grow along the images' v, rows along u: is the camera turned by 90 degrees, or"
            " are columns and rows exchanged?"
        )
    elif isinstance(codec, PhaseShift) and (falling := _falling(decoded)):
        notes.append(
            f"{falling} fall from pixel to pixel: is the projector or the camera upside down, or"
            " seen in a mirror? If not, the steps run the other way, as A + B cos(phi + theta):"
            f" see --order, {STEPS_BACKWARDS}."
        )
    if not decoded.absolute:
        notes.append(
            "Coordinates may lack whole periods, as many for each connected region: project longer"
            " periods or Gray code too where they are to be triangulated."
        )
    return notes


def _growth(coordinate: Array | None, axis: int) -> float:
    """From pixel to pixel: the median."""
    steps = np.zeros(0) if coordinate is None else np.diff(coordinate, axis=axis)
    known = steps[np.isfinite(steps)]
    return float(np.median(known)) if known.size else 0.0


def _turned(decoded: DecodedFringes) -> bool:
    """Whether columns change along v more than along u."""
    u, v = (abs(_growth(decoded.column, axis)) for axis in (1, 0))
    return v > 3.0 * u


def _falling(decoded: DecodedFringes) -> str:
    """What falls along the images' own axis: columns, rows or both."""
    each = (("Columns", decoded.column, 1), ("Rows", decoded.row, 0))
    names = [name for name, coordinate, axis in each if _growth(coordinate, axis) < 0.0]
    return " and ".join(names).capitalize()


def _summary(
    stack: NDArray[Any], decoded: DecodedFringes, disorder: float, time_s: float
) -> SequenceSummary:
    return SequenceSummary.of(
        decoded,
        images=len(stack),
        size_px=(stack.shape[2], stack.shape[1]),
        columns=_range(decoded.column),
        rows=_range(decoded.row),
        noise=decoded.noise,
        wrong_orders=decoded.wrong_orders,
        disorder=None if np.isnan(disorder) else disorder,
        absolute=decoded.absolute,
        time_s=time_s,
    )


def _range(values: Array | None) -> tuple[float, float] | None:
    known = () if values is None else values[np.isfinite(values)]
    return (float(np.min(known)), float(np.max(known))) if len(known) else None


def _by_number(name: str) -> list[tuple[int, int, str]]:
    """A key that sorts names with the numbers in them by their value: 2 before 10."""
    parts = re.split(r"(\d+)", name)
    return [(0, int(p), "") if p.isdecimal() else (1, 0, p) for p in parts]
