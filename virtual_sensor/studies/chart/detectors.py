"""Panel "lines": line detectors, error of the centre against time for each column."""

from __future__ import annotations

from collections.abc import Iterator
from functools import partial
from typing import Any

import numpy as np
from numpy.typing import NDArray

from virtual_sensor.imaging.render import render
from virtual_sensor.imaging.scene import load_scene
from virtual_sensor.metrology.centres import LineCentres, Status
from virtual_sensor.metrology.detectors import COLUMNWISE
from virtual_sensor.metrology.drawn_lines import line_shares
from virtual_sensor.metrology.line_peaks import line_centres
from virtual_sensor.metrology.truth import TrueLine, compare_line, rms
from virtual_sensor.optics.ray_search import ray_search
from virtual_sensor.studies.chart.benchmark import Configuration, Score, Task
from virtual_sensor.studies.measure import searched_line
from virtual_sensor.studies.trial.images import STATED, Condition, drawn_line

SCENE = "hot_cylinder"

_WIDTHS_PX, _PEAKS_ELECTRONS = (0.7, 1.5, 3.0, 6.0), (5_000.0, 200.0)
_COLUMNS, _QUICK_COLUMNS = 2048, 256
_FILM_PX, _QUICK_FILM_PX = 2048, 512
_FIELD_OF_VIEW_UM = 45_056.0
_ENDS_PX = 3.0  # next to the line's ends, whose columns are partly lit
_HEIGHT_PX = 128
_DRAWN = "the rows that the lines were drawn at"


def tasks(quick: bool = False) -> Iterator[Task]:
    """Drawn lines of several widths and signals, and a rendered frame.

    The stated task comes first.
    """
    columns = _QUICK_COLUMNS if quick else _COLUMNS
    widths = _WIDTHS_PX[1:2] if quick else _WIDTHS_PX
    noise = STATED.read_noise_electrons
    others = [Condition.of_peak(STATED.kind, w, e, noise) for e in _PEAKS_ELECTRONS for w in widths]
    for condition in dict.fromkeys([STATED, *others]):
        yield _noisy(condition, columns)
    for width in widths:
        yield _noiseless(width, columns)
    yield _frame(_QUICK_FILM_PX if quick else _FILM_PX)


def _noisy(condition: Condition, columns: int) -> Task:
    """A drawn line, as a camera records it."""
    line = drawn_line(condition, columns, seed=7)
    name = (
        f"line of sigma {condition.width_px:g} px, {condition.peak_electrons:,.0f} e at its peak,"
        f" read noise {condition.read_noise_electrons:g} e"
    )
    bound = rms(line.bound_px)
    return _task(name, _DRAWN, line.grey, line.truth, bound_px=bound, **line.options)


def _noiseless(width_px: float, columns: int) -> Task:
    """A drawn line in numbers that are exact but for float32."""
    row = np.random.default_rng(7).uniform(-2.0, 2.0, columns) + _HEIGHT_PX / 2.0
    image = line_shares(row, width_px, _HEIGHT_PX)[0].astype(np.float32)
    return _task(f"line of sigma {width_px:g} px, no noise", _DRAWN, image, TrueLine.of_rows(row))


def _frame(film_px: int) -> Task:
    """The hot scene as it is rendered by default, against the ray search."""
    scene = load_scene(SCENE, width=film_px, height=film_px)
    half = 0.5 * scene.sensor.laser.length_mm
    found = ray_search(scene, np.linspace(-half, half, 401), "newton")
    image, truth = np.asarray(render(scene), np.float32), searched_line(scene, found)
    name = f"a rendered frame of {film_px} px"
    return _task(name, "Newton's search", image, truth, _FIELD_OF_VIEW_UM / film_px)


def _task(
    name: str,
    reference: str,
    image: NDArray[Any],
    truth: TrueLine,
    um_per_px: float = np.nan,
    bound_px: float = 0.0,
    **options: Any,
) -> Task:
    """An image (H, W) with its truth, for every detector that searches columns."""

    def score(line: LineCentres) -> Score:
        errors = compare_line(line, truth, end_px=_ENDS_PX)
        lost = [f"{Status(s).name} {np.sum(errors.lost == s)}" for s in np.unique(errors.lost)]
        note = "; ".join([f"predicts {rms(errors.sigma):.2g} px", *lost])
        um = um_per_px * errors.error_px
        return Score(errors.error_px, um, errors.lost.size, note)

    def prepare(method: str) -> partial[LineCentres]:
        return partial(line_centres, image, method, **options)

    choices = [Configuration(name, name, partial(prepare, name)) for name in COLUMNWISE]
    return Task(name, reference, image.shape[1], score, choices, bound_px)
