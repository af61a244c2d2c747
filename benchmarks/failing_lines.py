"""Where line detectors fail: thin, clipped, broken, doubled and cut lines, and the border.

And on shiny metal: edges of the reflectance in the line, ghosts that cross it, spatter.

A centre is wrong, though its column is called OK, where it is farther from the truth than three of
its own standard errors and 0.05 px.
"""

from __future__ import annotations

from collections.abc import Callable, Iterator, Sequence

import numpy as np
from numpy.typing import ArrayLike, NDArray
from scipy.stats import norm
from worsening import Case, Outcome, judged

from virtual_sensor.metrology.centres import FOUND
from virtual_sensor.metrology.detectors import COLUMNWISE
from virtual_sensor.metrology.line_peaks import line_centres
from virtual_sensor.studies.trial.hard import sparks

Array = NDArray[np.float64]
Draw = Callable[[float, Array], Array]

SIGMA_PX = 2.0
NOISE = 0.005
"""Of the line's height: what can't be distinguished from noise is no failure of the statuses."""

HEIGHT_PX = 64
_COLUMNS = 400
_rows = np.arange(HEIGHT_PX)[:, None]
_GHOST_ROW = 30.0 + 0.15 * (np.arange(_COLUMNS) - 200.0)
_GHOSTLY = (np.abs(np.arange(_COLUMNS) - 200) < 100).astype(float)  # in half of the columns

_DOUBLED = (0.0, 0.25, 0.5, 0.75, 1.0, 1.25, 1.5, 2.0, 2.5, 3.0, 4.0, 6.0, 10.0)
TROUBLES: list[tuple[str, Sequence[float], str, Draw]] = [
    (
        "line thinner than a pixel",
        (0.6, 0.5, 0.4, 0.3, 0.2),
        "px sigma",
        lambda sigma, v: thin(sigma, v),
    ),
    (
        "line saturated",
        (0.95, 1.02, 2.0, 4.0, 8.0, 16.0, 64.0, 256.0),
        "times the saturation",
        lambda times, v: lines(v, amplitude=times),
    ),
    (
        "line broken",
        (0, 1, 3, 10),
        "columns dark of 20",
        lambda dark, v: lines(v, amplitude=np.arange(v.size) % 20 >= dark),
    ),
    *(
        (
            f"line doubled, the second of {ratio:g} times the height",
            _DOUBLED,
            "sigma apart",
            lambda apart, v, ratio=ratio: lines(v) + ratio * lines(v + apart * SIGMA_PX),
        )
        for ratio in (1.0, 0.9, 0.5, 0.2)
    ),
    (
        "line cut by an edge",
        (4.0, 3.0, 2.0, 1.0, 0.0, -1.0),
        "sigma beyond it",
        lambda beyond, v: np.where(_rows <= np.rint(30.0 + beyond * SIGMA_PX), lines(v), 0.0),
    ),
    (
        "line on an edge of the background",
        (6.0, 4.0, 3.0, 2.0, 1.0, 0.0),
        "sigma from it",
        lambda away, v: lines(v) + 0.5 * (_rows > np.rint(30.0 + away * SIGMA_PX)),
    ),
    (
        "line at the border",
        (5.0, 3.0, 2.0, 1.0, 0.0, -1.0),
        "sigma inside",
        lambda inside, v: lines(v + inside * SIGMA_PX - 30.0),
    ),
    (
        "edge of the reflectance in the line",
        (1.0, 1.05, 1.2, 1.5, 2.0, 5.0, 10.0, 100.0),
        "times as bright above it",
        lambda ratio, v: edged(v, 30.0, 1.0 / ratio),
    ),
    (
        "edge to a tenth of the reflectance",
        (6.0, 4.0, 3.0, 2.0, 1.0, 0.5),
        "sigma from the line",
        lambda away, v: edged(v, 30.0 + away * SIGMA_PX, 0.1),
    ),
    (
        "ghost that crosses the line",
        (0.0, 0.1, 0.3, 0.5, 0.8, 1.0, 1.25, 2.0, 4.0),
        "times its height",
        lambda times, v: lines(v) + lines(_GHOST_ROW, amplitude=times * _GHOSTLY),
    ),
    (
        "spatter",
        (0.0, 10.0, 30.0, 100.0, 300.0),
        "sparks in 1000 columns",
        lambda count, v: (
            lines(v)
            + sparks((HEIGHT_PX, v.size), round(count * v.size / 1000.0), np.random.default_rng(4))
        ),
    ),
]
SHINY = ("edge ", "ghost", "spatter")
SHINY_METHODS = ("gaussian", "max_likelihood", "centre_of_gravity", "parabola")
"""Of troubles that begin so, the methods that stand for all."""


def cases() -> Iterator[Case]:
    """All of them."""
    for trouble, amounts, unit, draw in TROUBLES:
        for method in SHINY_METHODS if trouble.startswith(SHINY) else COLUMNWISE:
            yield Case(
                trouble,
                method,
                amounts,
                unit,
                lambda amount, trouble=trouble, draw=draw, method=method: _detected(
                    trouble, amount, draw, method
                ),
                f"{_COLUMNS} columns, sigma {SIGMA_PX:g} px, noise {NOISE:.1%}; wrong is a centre"
                " off by more than 0.05 px and three of its own standard errors",
                "nearer lines are one broader line" if "doubled" in trouble else "",
                share=0.02,  # more than three standard errors happen by chance
            )


def lines(row: Array, sigma: float = SIGMA_PX, amplitude: ArrayLike = 1.0) -> Array:
    """Image (64, W) of Gaussian lines at rows (W,), integrated over each pixel."""
    share = norm.cdf(_rows + 0.5, row, sigma) - norm.cdf(_rows - 0.5, row, sigma)
    return np.asarray(amplitude) * np.sqrt(2.0 * np.pi) * sigma * share


def edged(row: Array, edge: float, dark: float) -> Array:
    """Lines of the usual width on a surface that reflects only so much of them below a row."""
    above = np.clip(edge - _rows + 0.5, 0.0, 1.0)  # of each pixel

    def light(start: Array, extent: Array) -> Array:
        return norm.cdf(start + extent, row, SIGMA_PX) - norm.cdf(start, row, SIGMA_PX)

    share = light(_rows - 0.5, above) + dark * light(_rows - 0.5 + above, 1.0 - above)
    return np.sqrt(2.0 * np.pi) * SIGMA_PX * share


def thin(sigma: float, row: Array) -> Array:
    """Lines so thin, of the usual height."""
    image = lines(row, sigma)
    return image / image.max()


def _detected(trouble: str, amount: float, draw: Draw, method: str) -> Outcome:
    rng = np.random.default_rng(8)
    row = rng.uniform(29.5, 30.5, _COLUMNS)
    image = draw(amount, row)
    image = image + rng.normal(0.0, NOISE, image.shape)
    saturation = 1.0 if trouble == "line saturated" else None
    line = line_centres(np.minimum(image, saturation or np.inf), method, saturation=saturation)
    if trouble == "line at the border":
        row = row + amount * SIGMA_PX - 30.0
    error = np.abs(line.row - row)
    found = judged(line.status, FOUND, error)
    wrong = ~found.reported & (error > 0.05) & (error > 3.0 * line.sigma)
    return Outcome(found.reported, wrong, found.reports, found.largest_px)
