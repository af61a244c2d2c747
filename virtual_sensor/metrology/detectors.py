"""The detectors by their names; a user's own join them by an entry point, or are given as such.

A detector of one's own is a function of the image (H, W) that returns the line's row in each column
(W,), NaN where there is none, or a whole `LineCentres`.  A package makes it known by

    [project.entry-points."virtual_sensor.detectors"]
    mine = "my_package.my_module:my_function"
"""

import importlib
import traceback
from collections.abc import Callable
from importlib import metadata

import numpy as np
from numpy.typing import NDArray

from virtual_sensor.errors import InputError, nearest, short
from virtual_sensor.metrology import closed_forms, line_fits
from virtual_sensor.metrology.centres import LineCentres, Status, is_measured
from virtual_sensor.metrology.line_profiles import Noise, Peaks, Profile

ENTRY_POINTS = "virtual_sensor.detectors"

Estimate = Callable[[NDArray, Peaks, Noise, float], Profile]
"""(image, peaks, noise, broadest line in px) to profiles; its docstring names its source."""

Foreign = Callable[[NDArray], NDArray | LineCentres]


COLUMNWISE: dict[str, Estimate] = {
    "gaussian": line_fits.fit_gaussian,
    "weighted_gaussian": line_fits.fit_weighted,
    "max_likelihood": line_fits.fit_likeliest,
    "log_parabola": closed_forms.log_parabola,
    "parabola": closed_forms.parabola,
    "linear_interpolation": closed_forms.linear_interpolation,
    "centre_of_gravity": closed_forms.centre_of_gravity,
    "fir4": closed_forms.fir4,
    "fir8": closed_forms.fir8,
}
"""Detectors that search columns one by one, or rows."""

STEGER = "steger"
"""The detector of lines of any direction: `ridges`."""

NAMES = (*COLUMNWISE, STEGER)


def find_detector(name: str) -> Foreign:
    """A user's detector: of an installed package's entry point, or ``package.module:function``.

    Raises
    ------
    InputError
        If there is none of that name, or it can't be loaded.
    """
    if not isinstance(name, str):
        raise InputError(
            f"line_centres: method is {short(name)}; give a detector's name, or a function"
        )
    known = {point.name: point for point in metadata.entry_points(group=ENTRY_POINTS)}
    if name not in known and ":" not in name:
        raise InputError(
            f"line_centres: no method '{name}'; take {', '.join([*NAMES, *known])}, or a function"
            f" of your own as package.module:function{nearest(name, [*NAMES, *known])}"
        )
    try:
        if name in known:
            found = known[name].load()
        else:
            module, _, function = name.partition(":")
            found = getattr(importlib.import_module(module), function)
    except (ImportError, AttributeError, ValueError) as error:
        raise InputError(
            f"detector '{name}': can't be loaded ({error}); install its package, set PYTHONPATH, or"
            " go to the folder that holds it"
        ) from None
    if not callable(found):
        raise InputError(f"detector '{name}': is not a function; give one of the image (H, W)")
    return found


def by_foreign(image: NDArray, detector: Foreign) -> LineCentres:
    """What a user's detector finds, with what lies off the image, or is no number, refused.

    Raises
    ------
    InputError
        Naming the detector, and the line at which it failed, or what it should give.
    """
    name = getattr(detector, "__name__", repr(detector))
    try:
        answer = detector(image)
    except Exception as error:
        place = traceback.extract_tb(error.__traceback__)[-1]
        raise InputError(
            f"detector {name}: fails on an image of {image.shape} {image.dtype} with"
            f" {type(error).__name__}: {error} ({place.filename}, line {place.lineno})"
        ) from error
    if not isinstance(answer, LineCentres):
        answer = _from_rows(image, answer, name)
    shapes = {values.shape for values in vars(answer).values()}
    if len(shapes) != 1:
        raise InputError(
            f"detector {name}: its LineCentres has arrays of shapes {sorted(shapes)}; give them one"
        )
    inside = [
        (place >= -0.5) & (place <= size - 0.5)
        for place, size in zip((answer.column, answer.row), image.shape[::-1], strict=True)
    ]
    off = is_measured(answer.status) & ~(inside[0] & inside[1])
    return answer.judged(np.where(off, Status.POOR_FIT, answer.status))


def _from_rows(image: NDArray, rows: NDArray, name: str) -> LineCentres:
    try:
        row = np.asarray(rows, float)
    except (TypeError, ValueError):
        row = np.empty(0)
    if row.shape != image.shape[1:]:
        raise InputError(
            f"detector {name}: gives {type(rows).__name__} of shape {np.shape(row)}; give a row for"
            f" each of the {image.shape[1]} columns, or a LineCentres"
        )
    return LineCentres.of_rows(row)
