"""Where line detectors fail: thin, clipped, broken, doubled and cut lines, and the border.

A centre is wrong, though its column is called OK, where it is farther from the truth than three of
its own standard errors and 0.05 px.
"""

from __future__ import annotations

from collections.abc import Callable, Iterable, Iterator, Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from virtual_sensor.metrology.centres import Status
from virtual_sensor.metrology.detectors import COLUMNWISE
from virtual_sensor.metrology.line_peaks import line_centres
from virtual_sensor.metrology.truth import TrueLine, compare_line
from virtual_sensor.studies.chart.detectors import gaussian_lines
from virtual_sensor.studies.chart.rung import Failure, Report

Array = NDArray[np.float64]

SIGMA_PX = 2.0
NOISE = 0.005
"""Of the line's height: what can't be told from noise is no failure of the statuses."""

WRONG_PX, WRONG_ERRORS = 0.05, 3.0
_HEIGHT_PX = 64
_COLUMNS, _QUICK_COLUMNS = 400, 60
_FEW = 0.02  # of the columns: more than three standard errors happen by chance


@dataclass(frozen=True)
class Trouble:
    """Something wrong with lines, more and more of it.

    Attributes
    ----------
    what : str
    amounts : sequence of float
        From none to much.
    unit : str
    draw : callable
        (amount, rows of the lines' centres (W,)) to an image (64, W).
    saturation : float or None
        Of the camera.
    """

    what: str
    amounts: Sequence[float]
    unit: str
    draw: Callable[[float, Array], Array]
    saturation: float | None = None


def failures(report: Report, quick: bool = False) -> list[Failure]:
    """Raise each trouble until columns are refused, and count what is wrong but called OK.

    Parameters
    ----------
    report : callable
    quick : bool
        Few columns.
    """
    work = [(trouble, method) for trouble in troubles() for method in COLUMNWISE]
    found = []
    for number, (trouble, method) in enumerate(work):
        report(trouble.what, number / len(work))
        found.append(_first(trouble, method, _QUICK_COLUMNS if quick else _COLUMNS))
    return found


def troubles() -> Iterator[Trouble]:
    """What may be wrong with a line."""
    yield Trouble("line thinner than a pixel", (0.6, 0.5, 0.4, 0.3, 0.2), "px sigma", _thin)
    yield Trouble(
        "line saturated", (0.0, 0.02, 0.1, 0.3, 0.6), "of its height clipped", _clipped, 1
    )
    yield Trouble("line broken", (0, 1, 3, 10), "columns dark of 20", _broken)
    for ratio in (1.0, 0.9, 0.5, 0.2):
        yield Trouble(
            f"line doubled, the second of {ratio:g} times the height",
            (0.0, 0.25, 0.5, 0.75, 1.0, 1.25, 1.5, 2.0, 2.5, 3.0, 4.0, 6.0, 10.0),
            "sigma apart",
            _doubled(ratio),
        )
    yield Trouble("line cut by an edge", (4.0, 3.0, 2.0, 1.0, 0.0, -1.0), "sigma beyond it", _cut)
    yield Trouble(
        "line on an edge of the background",
        (6.0, 4.0, 3.0, 2.0, 1.0, 0.0),
        "sigma from it",
        _on_step,
    )
    yield Trouble("line at the border", (5.0, 3.0, 2.0, 1.0, 0.0, -1.0), "sigma inside", _at_border)


def examples(trouble: Trouble, amount: float, columns: int) -> tuple[Array, Array]:
    """An image of `columns` lines with so much trouble, in some noise, and the true rows."""
    rng = np.random.default_rng(8)
    truth = rng.uniform(29.5, 30.5, columns)
    if trouble.draw is _at_border:
        truth = truth - 30.0 + amount * SIGMA_PX
    image = trouble.draw(amount, truth)
    noisy = image + rng.normal(0.0, NOISE, image.shape)
    return np.minimum(noisy, trouble.saturation or np.inf), truth


def _first(trouble: Trouble, method: str, columns: int) -> Failure:
    """The first amount at which columns are refused, and at which some are wrong all the same."""
    refused, mistaken, told, count = "", [], set[str](), 0
    for amount in trouble.amounts:
        image, truth = examples(trouble, amount, columns)
        line = line_centres(image, method, saturation=trouble.saturation)
        bad = line.status != Status.OK
        errors = compare_line(line, TrueLine.of_rows(truth))
        # Neither near the truth nor within its stated error.
        share = errors.wrong(np.inf, WRONG_ERRORS, WRONG_PX).sum() / columns
        if share > _FEW:
            mistaken.append((amount, share, errors.largest_px))
        if bad.mean() > _FEW:
            told |= {Status(s).name for s in np.unique(line.status[bad])}
            refused = refused or f"{amount:g} {trouble.unit}"
            count = count or int(bad.sum())
    return Failure(
        trouble.what,
        method,
        refused,
        f"{_list(trouble.amounts)} {trouble.unit}; sigma {SIGMA_PX:g} px, noise {NOISE:.1%}",
        ", ".join(sorted(told)),
        count,
        columns,
        _mistakes(mistaken, trouble.unit),
    )


def _mistakes(found: Sequence[tuple[float, float, float]], unit: str) -> str:
    """In words, what is called OK and is wrong."""
    if not found:
        return "none called OK is wrong"
    share, most = max(s for _, s, _ in found), max(error for *_, error in found)
    amounts = _list(amount for amount, *_ in found)
    return f"not told at {amounts} {unit}: up to {share:.0%} of the columns, {most:.2g} px off"


def _list(numbers: Iterable[float]) -> str:
    return ", ".join(f"{number:g}" for number in numbers)


def _lines(truth: Array, sigma: float | Array = SIGMA_PX, amplitude: float | Array = 1.0) -> Array:
    return gaussian_lines(truth, sigma, _HEIGHT_PX, amplitude)


def _thin(sigma: float, truth: Array) -> Array:
    image = _lines(truth, sigma)
    return image / image.max()


def _clipped(share: float, truth: Array) -> Array:
    return _lines(truth, amplitude=0.95 if share == 0.0 else 1.0 / (1.0 - share))


def _broken(dark: float, truth: Array) -> Array:
    return _lines(truth, amplitude=np.where(np.arange(truth.size) % 20 < dark, 0.0, 1.0))


def _doubled(ratio: float) -> Callable[[float, Array], Array]:
    def draw(apart: float, truth: Array) -> Array:
        return _lines(truth) + ratio * _lines(truth + apart * SIGMA_PX)

    return draw


def _cut(beyond: float, truth: Array) -> Array:
    rows = np.arange(_HEIGHT_PX)[:, None]
    return np.where(rows <= np.rint(30.0 + beyond * SIGMA_PX), _lines(truth), 0.0)


def _on_step(away: float, truth: Array) -> Array:
    rows = np.arange(_HEIGHT_PX)[:, None]
    return _lines(truth) + 0.5 * (rows > np.rint(30.0 + away * SIGMA_PX))


def _at_border(inside: float, truth: Array) -> Array:
    return _lines(truth)
